"""`lunarsci spectra unmix` for several spectra at once, with stated modes, opaques and iron."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.result import Abundance, MineralFraction, share_pages

Run = Callable[..., Any]
NM = np.arange(450.0, 2451.0, 10.0)
SHARES = {"a": (0.8, 0.2), "b": (0.6, 0.4), "c": (0.35, 0.65), "d": (0.1, 0.9)}
OPTIONS = ("--assemblage", "OL-OPX", "--starts", "1", "--quiet")


@pytest.fixture(scope="module")
def mixtures(tmp_path_factory: pytest.TempPathFactory, once: None) -> Path:
    """Four synthetic mixtures of one olivine and one orthopyroxene, mixed in -ln R; unmixed once for equal options."""
    library = {item.id: np.log(item.reflectance) for item in embedded_end_members(NM)}
    olivine, pyroxene = library["AG-TJM-008"], library["PE-CMP-030"]
    columns = [np.exp(a * olivine + b * pyroxene) for a, b in SHARES.values()]
    path = tmp_path_factory.mktemp("mixtures") / "mixtures.csv"
    rows = [f"{nm:g}," + ",".join(f"{v:.6f}" for v in row) for nm, row in zip(NM, np.transpose(columns), strict=True)]
    path.write_text("wavelength_nm," + ",".join(SHARES) + "\n" + "\n".join(rows) + "\n")
    return path


def found(run: Run, *arguments: object) -> dict[str, Any]:
    done = run("spectra", "unmix", *arguments, "--json")
    assert done.code == 0, done.err
    return {record["id"]: record["abundance"] for record in json.loads(done.out)["result"]["spectra"]}


def test_spectra_together_are_found_and_differ_from_one_by_one(run: Run, mixtures: Path) -> None:
    together = found(run, mixtures, *OPTIONS, "--together")
    alone = found(run, mixtures, *OPTIONS)
    errors = [abs(together[id]["olivine"]["fraction"] - share) for id, (share, _) in SHARES.items()]
    assert max(errors) < 0.12
    assert together["b"] != alone["b"]
    order = [together[id]["olivine"]["fraction"] for id in SHARES]
    assert order == sorted(order, reverse=True)


def test_known_modes_sharpen_the_others(run: Run, mixtures: Path, tmp_path: Path) -> None:
    known = tmp_path / "known.csv"
    known.write_text("id,olivine,vol_opx\na,0.8,0.2\nc,,\nd,0.1,0.9\n")
    told = found(run, mixtures, *OPTIONS, "--known", known)
    assert told["a"]["olivine"]["fraction"] == pytest.approx(0.8)
    assert told["a"]["status"] == "modes as stated"
    for id in ("b", "c"):
        assert told[id]["olivine"]["fraction"] == pytest.approx(SHARES[id][0], abs=0.03)
        assert told[id]["olivine"]["high"] - told[id]["olivine"]["low"] < 0.1
    done = run("spectra", "unmix", mixtures, *OPTIONS, "--known", known, "--json")
    inputs = json.loads(done.out)["provenance"]["inputs"]
    assert any(str(known) in str(item) for item in inputs)


def test_opaques_and_iron_are_terms_that_no_measurement_vouches_for(run: Run, mixtures: Path) -> None:
    together = found(run, mixtures, *OPTIONS, "--opaque", "--together")["a"]
    assert sum(together[name]["fraction"] for name in ("olivine", "orthopyroxene", "opaque")) == pytest.approx(1)
    with_opaque = found(run, mixtures, *OPTIONS, "--opaque")["a"]
    assert sum(with_opaque[name]["fraction"] for name in ("olivine", "orthopyroxene")) == pytest.approx(1)
    assert with_opaque["dark"]["phases"] == {"none": 0, "opaque": pytest.approx(1), "metal-troilite": 0, "glass": 0}
    with_iron = found(run, mixtures, *OPTIONS, "--iron")["a"]
    assert with_iron["dark"]["iron"]["nanophase"] == pytest.approx(1)
    for modes in (together, with_opaque, with_iron):
        assert modes["in_domain"] is False
        assert "no measured mixture" in modes["status"]


def test_what_is_dark_is_weighed_beside_the_shares(run: Run, mixtures: Path) -> None:
    modes = found(run, mixtures, *OPTIONS)["a"]
    for part in ("phases", "iron"):
        assert sum(modes["dark"][part].values()) == pytest.approx(1)
    assert modes["dark"]["low"] <= modes["dark"]["share"] <= modes["dark"]["high"]
    suites = len(modes["calibration"]["suites"])
    assert suites / (suites + 1) == pytest.approx(modes["calibration"]["certified"])
    text = run("spectra", "unmix", mixtures, *OPTIONS).out
    assert "what is dark beside the minerals" in text
    assert "intervals were tested on" in text


def test_the_picture_has_a_page_of_shares(run: Run, mixtures: Path, tmp_path: Path) -> None:
    pages = {}
    for command in ("fit", "unmix"):
        picture = tmp_path / f"{command}.pdf"
        assert run("spectra", command, mixtures, *OPTIONS, "--plot", picture).code == 0
        pages[command] = len(re.findall(rb"/Type /Page\b", picture.read_bytes()))
    assert pages == {"fit": 1, "unmix": 2}


def test_the_page_of_shares_names_spectra_and_minerals() -> None:
    share = [MineralFraction(name, 0.5, 0.4, 0.6, 0.3, 0.7) for name in ("olivine", "orthopyroxene")]
    [page] = share_pages([Abundance(id, "unmix", tuple(share), None, id == "a", "", 0.01) for id in ("a", "b")])
    assert [panel.get_title() for panel in page.axes] == ["olivine", "orthopyroxene"]
    assert [label.get_text() for label in page.axes[0].get_yticklabels()] == ["a", "b"]
    faces = [line.get_markerfacecolor() for line in page.axes[0].lines if line.get_marker() == "o"]
    assert faces[1] == "white" != faces[0]


@pytest.mark.parametrize(
    ("table", "options", "message"),
    [
        ("id,olivine,opx\nz,1,0\n", (), "none of its ids"),
        ("id,olivine,cpx\na,0.5,0.5\n", (), "holds clinopyroxene"),
        ("id,olivine,opx\na,0.5,0.2\n", (), "sum to 0.7"),
        ("id,olivine,opx\na,0.5\n", (), "line 2 has 2 cells"),
    ],
)
def test_tables_of_modes_that_do_not_fit_are_refused(
    run: Run, mixtures: Path, tmp_path: Path, table: str, options: tuple[str, ...], message: str
) -> None:
    known = tmp_path / "known.csv"
    known.write_text(table)
    done = run("spectra", "unmix", mixtures, *OPTIONS, "--known", known, *options)
    assert done.code == 1
    assert done.out == ""
    assert message in done.err[-1]


def test_iron_has_no_place_in_absorbance(run: Run, mixtures: Path) -> None:
    done = run("spectra", "unmix", mixtures, *OPTIONS, "--method", "absorbance", "--iron")
    assert done.code == 2
    assert "--iron needs" in done.err[-1]


def test_spectra_of_one_name_are_told_apart_but_not_by_a_table(run: Run, mixtures: Path, tmp_path: Path) -> None:
    twin = tmp_path / "twin.csv"
    twin.write_text(mixtures.read_text())
    done = run("spectra", "unmix", mixtures, twin, *OPTIONS, "--together", "--json")
    assert done.code == 0, done.err
    records = json.loads(done.out)["result"]["spectra"]
    assert [record["id"] for record in records] == [*SHARES, *SHARES]
    assert records[0]["abundance"]["olivine"] == pytest.approx(records[4]["abundance"]["olivine"], abs=0.03)
    known = tmp_path / "known.csv"
    known.write_text("id,olivine,opx\na,0.8,0.2\n")
    done = run("spectra", "unmix", mixtures, twin, *OPTIONS, "--known", known)
    assert done.code == 1
    assert "'a' is the id of two spectra" in done.err[-1]


@pytest.fixture(scope="module")
def soil(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dark and red with a shallow band, as mature soil is; synthetic."""
    path = tmp_path_factory.mktemp("soil") / "soil.csv"
    band = 1 - 0.08 * np.exp(-0.5 * ((NM - 960.0) / 90.0) ** 2)
    values = (0.055 + 0.09 * (NM - 450.0) / 1000.0) * band
    path.write_text(
        "wavelength_nm,soil\n" + "\n".join(f"{a:g},{b:.6f}" for a, b in zip(NM, values, strict=True)) + "\n"
    )
    return path


def test_a_weathered_soil_is_not_unmixed(run: Run, soil: Path, tmp_path: Path) -> None:
    done = run("spectra", "unmix", soil, "--starts", "1", "--json", "--plot", tmp_path / "shares.pdf")
    assert done.code == 3
    assert "shares of soil are not determined: a surface that space has weathered" in done.err[-1] + done.err[0]
    [record] = json.loads(done.out)["result"]["spectra"]
    assert record["kind"]["weathered"] > 0.9
    for mineral in ("olivine", "orthopyroxene", "clinopyroxene"):
        share = record["abundance"][mineral]
        assert share["fraction"] is None
        assert (share["low"], share["high"]) == (0, 1)
    assert record["abundance"]["in_domain"] is False
    iron = record["normative"]["feo_wt"]
    assert iron["low95"] < iron["low"] < iron["value"] < iron["high"] < iron["high95"]
    text = run("spectra", "unmix", soil, "--starts", "1")
    assert "no modes of minerals" in text.out
    assert len(re.findall(rb"/Type /Page\b", (tmp_path / "shares.pdf").read_bytes())) == 3
    shown = run("spectra", "unmix", soil, "--starts", "1", "--csv")
    assert "unmix_olivine,unmix_olivine_low" in shown.out
    assert "normative_feo_wt,normative_feo_low_wt" in shown.out
    assert ",,0.0,1.0," in shown.out


def test_a_stated_kind_is_unmixed_and_told_what_is_missing(run: Run, soil: Path, tmp_path: Path) -> None:
    shallow = run("spectra", "unmix", soil, "--starts", "1", "--kind", "solid-rock")
    assert shallow.code == 3
    assert "no absorption near 1 um deep enough to tell minerals" in shallow.err[-1]
    values = (0.055 + 0.09 * (NM - 450.0) / 1000.0) * (1 - 0.25 * np.exp(-0.5 * ((NM - 960.0) / 90.0) ** 2))
    deep = tmp_path / "rock.csv"
    deep.write_text("wavelength_nm,rock\n" + "".join(f"{a:g},{b:.6f}\n" for a, b in zip(NM, values, strict=True)))
    done = run("spectra", "unmix", deep, "--starts", "1", "--kind", "solid-rock", "--json")
    rock = json.loads(done.out)["result"]["spectra"][0]["abundance"]
    assert [*rock["ratios"]] == ["olivine_in_mafic", "orthopyroxene_in_pyroxene"]
    for ratio in rock["ratios"].values():
        middle = [] if ratio["fraction"] is None else [ratio["fraction"]]
        ends = [0, ratio["low95"], ratio["low"], *middle, ratio["high"], ratio["high95"], 1]
        assert ends == sorted(ends)
        assert middle or ends == [0, 0, 0, 1, 1, 1], "what is not determined may be anything"
    assert rock["not_weighed"] == ["plagioclase"]
    assert rock["in_domain"] is False
    assert "not calibrated on rocks" in rock["status"]
    done = run("spectra", "unmix", soil, "--starts", "1", "--kind", "dark-rock-powder")
    assert done.code == 3
    assert "rather than dark-rock-powder" in done.out
