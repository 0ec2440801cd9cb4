"""`spectra bands`: the chemistry beside the bands, and the plane of the centres."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

GRID = np.arange(450.0, 2451.0, 5.0)


def spectrum(first: float, second: float | None) -> np.ndarray:
    values = 0.3 * (1 - 0.4 * np.exp(-0.5 * ((GRID - first) / 80) ** 2))
    return values if second is None else values * (1 - 0.3 * np.exp(-0.5 * ((GRID - second) / 140) ** 2))


@pytest.fixture
def rocks(tmp_path: Path) -> Path:
    """Centres of an orthopyroxene with Fs 50, and of an olivine with Fo 60."""
    columns = (GRID, spectrum(926, 1963), spectrum(1066, None))
    rows = (",".join(f"{value:.8g}" for value in row) for row in zip(*columns, strict=True))
    path = tmp_path / "rocks.csv"
    path.write_text("wavelength_nm,pyroxene,olivine\n" + "\n".join(rows) + "\n")
    return path


def test_chemistry_is_beside_the_bands(run, rocks: Path) -> None:
    done = run("spectra", "bands", rocks, "--continuum", "hull", "--json")
    pyroxene, olivine = json.loads(done.out)["result"]["spectra"]
    assert pyroxene["bc1000_nm"] == pytest.approx(926, abs=3)
    iron = pyroxene["chemistry"]["fs_gaffey"]
    assert iron["value"] == pytest.approx(268.2 * pyroxene["bc2000_nm"] / 1000 - 483.7)
    assert (iron["quantity"], iron["unit"], iron["in_range"], iron["reason"]) == ("fs", "mol %", True, "")
    assert "temperature" in iron["caveat"]
    assert olivine["chemistry"]["fo_bc1000"]["value"] == pytest.approx(62, abs=12)
    assert olivine["chemistry"]["fs_gaffey"] is None
    provenance = json.loads(done.out)["provenance"]
    assert {table["name"] for table in provenance["tables"]} >= {"band_chemistry.csv", "pyroxene_plane.csv"}
    assert any("Gaffey" in source for source in provenance["sources"])


def test_fields_tables_and_csv_have_it(run, rocks: Path) -> None:
    value = run("spectra", "bands", rocks, "--continuum", "hull", "--field", "spectra.0.chemistry.fs_gaffey.value").out
    rows = list(csv.DictReader(io.StringIO(run("spectra", "bands", rocks, "--continuum", "hull", "--csv").out)))
    assert float(rows[0]["fs_gaffey"]) == float(value)
    assert float(rows[0]["fs_gaffey_sigma"]) > 5
    assert (rows[0]["fs_gaffey_in_range"], rows[1]["fs_gaffey"]) == ("true", "")
    table = run("spectra", "bands", rocks, "--continuum", "hull").out
    assert "Fs [mol %] Gaffey 2002" in table
    assert "Fo [mol %] 1 µm centre" in table


def test_one_spectrum_lists_the_regressions_that_apply_and_json_why_others_do_not(run, rock: Path) -> None:
    table = run("spectra", "bands", rock).out
    [record] = json.loads(run("spectra", "bands", rock, "--json").out)["result"]["spectra"]
    found = [item for item in record["chemistry"].values() if item]
    refused = [item["reason"] for item in found if item["reason"]]
    assert "from the bands" in table and "there is a 2 µm band: pyroxene" in refused
    assert f"{len(refused)} other regressions do not apply to it" in table
    assert sum(" if " in line for line in table.splitlines()) >= len(found) - len(refused) > 3


def test_the_plane_is_a_picture_of_its_own(run, rocks: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.svg", tmp_path / "b.svg"
    done = run("spectra", "bands", rocks, "--plane", first, "--plot", tmp_path / "p.pdf")
    assert (done.code, f"written: {first}" in done.err) == (0, True)
    assert run("spectra", "bands", rocks, "--plane", second).code == 0
    assert first.read_bytes() == second.read_bytes()
    assert "pyroxene" in first.read_text()


def test_the_plane_is_refused_like_every_picture(run, rocks: Path, tmp_path: Path) -> None:
    assert run("spectra", "bands", rocks, "--plane", tmp_path / "x.bmp").code == 2
    twice = tmp_path / "x.png"
    assert run("spectra", "bands", rocks, "--plane", twice, "--plot", twice).code == 2
    twice.write_text("mine")
    refused = run("spectra", "bands", rocks, "--plane", twice)
    assert (refused.code, len(refused.err)) == (2, 1)
    assert "--force" in refused.err[0]
    assert twice.read_text() == "mine"


def test_channels_that_show_neither_band_are_a_failure_as_of_a_fit(run, tmp_path: Path) -> None:
    short = tmp_path / "short.csv"
    short.write_text("wavelength_nm,a\n" + "\n".join(f"{nm},0.{20 + nm % 7}" for nm in range(500, 850, 5)) + "\n")
    for command in ("bands", "fit"):
        done = run("spectra", command, short)
        assert (done.code, done.out) == (1, "")
        assert done.err[-1].startswith(f"error: {short}: a: no result: the channels do not reach over 8")


def test_notes_of_a_batch_name_their_spectra(run, rocks: Path) -> None:
    said = run("spectra", "bands", rocks).out
    assert "(1 of 2 spectra: olivine)" in said
