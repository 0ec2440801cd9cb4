"""`lunarsci spectra calibrate` as a shell sees it: forms of output, bad neighbours, files of one's own, batches."""

import csv
import hashlib
import io
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.spectra.vnis.simulation.instrument import Instrument, simulate
from lunarsci.spectra.vnis.simulation.scene import Scene, SceneRock
from lunarsci.spectra.vnis.simulation.template import product_files

Files = dict[str, bytes]
COMMAND = ("spectra", "calibrate")
GRID = [450 + 5.0 * k for k in range(390)]


@pytest.fixture(scope="session")
def one() -> Files:
    """One synthetic observation, number 1."""
    return product_files(simulate(Scene(rock=SceneRock(), shadow_fraction=0.05), seed=3))


@pytest.fixture(scope="session")
def two() -> Files:
    """Another one, number 2, with less noise."""
    return product_files(simulate(Scene(sequence=2), Instrument(noise=0.5), seed=4))


def write(folder: Path, content: Mapping[str, bytes]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, data in content.items():
        (folder / name).write_bytes(data)
    return folder


def named(content: Mapping[str, bytes], kind: str = "SD", *, label: bool = True) -> str:
    return next(n for n in content if f"-{kind}_SCI" in n and n.endswith("L" if label else "B"))


@pytest.fixture
def label(tmp_path: Path, one: Files) -> Path:
    return write(tmp_path / "one", one) / named(one)


def result(done: Any) -> list[dict[str, Any]]:
    spectra: list[dict[str, Any]] = json.loads(done.out)["result"]["spectra"]
    return spectra


def reflectance(run, *arguments: object) -> np.ndarray:
    done = run(*COMMAND, *arguments, "--json")
    assert done.code == 0, done.err
    return np.array(result(done)[0]["reflectance"])


# -- Forms of output --------------------------------------------------------------------------------------------------


def test_the_table_says_what_was_done(run, label: Path) -> None:
    done = run(*COMMAND, label)
    assert (done.code, done.err) == (0, [])
    header, rule, row, *notes = done.out.splitlines()
    assert header.split()[0] == "observation"
    assert set(rule.strip()) <= {"─", " "}
    assert row.startswith("SYNTHETIC-CE4-0001 ")
    assert "of 9085" in row
    assert any(note.startswith("SWIR radiance divided by") for note in notes)


def test_json_has_every_number_with_its_unit(run, label: Path) -> None:
    done = run(*COMMAND, label, "--json")
    document = json.loads(done.out)
    assert document["schema"] == "lunarsci/spectra-calibrate/1"
    [spectrum] = document["result"]["spectra"]
    assert spectrum.keys() == {
        "id", "source", "synthetic", "status", "time_utc", "latitude_deg", "longitude_deg", "vnir", "swir",
        "photometry", "solar", "footprint", "splice", "channels", "channels_masked", "notes", "doubts", "wavelength_nm",
        "reflectance", "reflectance_sigma", "reflectance_systematic", "systematic",
    }  # fmt: skip
    assert spectrum["wavelength_nm"] == GRID
    assert all(len(spectrum[key]) == 390 for key in ("reflectance", "reflectance_sigma", "reflectance_systematic"))
    assert spectrum["footprint"]["pixels"] == 9085
    assert spectrum["photometry"] == {
        "disk": "lommel-seeliger", "phase": "sp-mid", "incidence_deg": 30.0, "emission_deg": 0.0, "phase_deg": 30.0,
    }  # fmt: skip
    assert {"incidence_deg", "emission_deg", "phase_deg", "sun_distance_au", "noise_excess", "channels_masked"} == (
        spectrum["swir"].keys()
    )
    assert spectrum["swir"]["sun_distance_au"] == pytest.approx(1.01482, abs=1e-5)


def test_csv_has_one_row_for_each_channel(run, label: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(run(*COMMAND, label, "--csv").out)))
    assert [float(row["wavelength_nm"]) for row in rows] == GRID
    assert {row["id"] for row in rows} == {"SYNTHETIC-CE4-0001"}
    wanted = result(run(*COMMAND, label, "--json"))[0]
    for key in ("reflectance", "reflectance_sigma", "reflectance_systematic"):
        assert [float(row[key]) for row in rows] == wanted[key]
    for name, mode in wanted["systematic"].items():
        assert [float(row[f"systematic_{name}"]) for row in rows] == mode


def test_a_masked_channel_is_null_and_an_empty_cell(run, tmp_path: Path, one: Files) -> None:
    table = named(one, label=False)
    rows = one[table].splitlines(keepends=True)
    rows[70] = rows[70].replace(b"0x00", b"0x01")
    folder = write(tmp_path / "one", one | {table: b"".join(rows)})
    done = run(*COMMAND, folder, "--json")
    [spectrum] = result(done)
    assert [k for k, value in enumerate(spectrum["reflectance"]) if value is None] == [160]
    assert (spectrum["channels_masked"], spectrum["reflectance_sigma"][160]) == (1, None)
    cells = list(csv.DictReader(io.StringIO(run(*COMMAND, folder, "--csv").out)))[160]
    assert (cells["reflectance"], cells["reflectance_sigma"]) == ("", "")
    # The other commands leave it out.
    assert run("spectra", "bands", folder / named(one), "--json").code == 0


@pytest.mark.parametrize("suffix", ["ecsv", "fits"])
def test_files_hold_the_spectra_and_the_provenance(run, label: Path, tmp_path: Path, suffix: str) -> None:
    target = tmp_path / f"out.{suffix}"
    done = run(*COMMAND, label, "-o", target, "--no-time")
    assert (done.code, done.out, done.err[0]) == (0, "", f"written: {target}")
    again = run(*COMMAND, label, "-o", target)
    assert again.code == 2
    assert "--force" in again.err[0]
    first = target.read_bytes()
    assert run(*COMMAND, label, "-o", target, "--no-time", "--force").code == 0
    assert target.read_bytes() == first
    assert hashlib.sha256(label.read_bytes()).hexdigest().encode() in first


def test_a_page_for_each_observation(run, tmp_path: Path, one: Files, two: Files) -> None:
    folder, target = write(tmp_path / "both", one | two), tmp_path / "both.pdf"
    assert run(*COMMAND, folder, "--plot", target, "-q").code == 0
    assert len(re.findall(rb"/Type */Page\b", target.read_bytes())) == 2


# -- Inputs -----------------------------------------------------------------------------------------------------------


def test_any_part_and_the_folder_give_the_same(run, tmp_path: Path, one: Files) -> None:
    folder = write(tmp_path / "one", one)
    wanted = run(*COMMAND, folder / named(one), "--field", "spectra.0.reflectance").out
    for path in (folder, folder / named(one, "VD"), folder / named(one, "VD", label=False), f"{folder}/*.2BL"):
        assert run(*COMMAND, path, "--field", "spectra.0.reflectance").out == wanted
    # Named several times over, it is calibrated once.
    assert len(result(run(*COMMAND, folder, folder / named(one), folder / named(one, "VD"), "--json"))) == 1


def test_a_folder_is_all_its_observations(run, tmp_path: Path, one: Files, two: Files) -> None:
    folder = write(tmp_path / "both", one | two | {"readme.txt": b"nothing"})
    done = run(*COMMAND, folder, "--json")
    assert (done.code, done.err) == (0, [])
    assert [spectrum["id"] for spectrum in result(done)] == ["SYNTHETIC-CE4-0001", "SYNTHETIC-CE4-0002"]
    table = run(*COMMAND, folder).out
    assert "(2 of 2 observations: SYNTHETIC-CE4-0001, SYNTHETIC-CE4-0002)" in table
    assert sum(line.startswith("SYNTHETIC-CE4-") for line in table.splitlines()) == 2


def broken(content: Files) -> Files:
    """With half a cube."""
    cube = named(content, "VD", label=False)
    return content | {cube: content[cube][: 13 * 2**20]}


def test_a_note_names_the_observations_that_it_is_of(run, tmp_path: Path, one: Files, two: Files) -> None:
    """The second observation alone comes with labels of version 1."""
    done = run(*COMMAND, write(tmp_path / "both", one | early(two)))
    [note] = [line for line in done.out.splitlines() if "version 1" in line]
    assert note.endswith("(1 of 2 observations: SYNTHETIC-CE4-0002)")


def test_a_broken_one_is_one_line_and_the_others_are_printed(run, tmp_path: Path, one: Files, two: Files) -> None:
    folder = write(tmp_path / "both", broken(one) | two)
    missing = tmp_path / "CE4_GRAS_VNIS-SD_SCI_N_20200716031001_20200716100000_0136_B.2BL"
    done = run(*COMMAND, missing, folder, tmp_path / "nothing*.2BL", "--json")
    assert done.code == 1
    assert [spectrum["id"] for spectrum in result(done)] == ["SYNTHETIC-CE4-0002"]
    assert len(done.err) == 4
    assert all(line.startswith("error: ") for line in done.err[:3])
    assert done.err[3].startswith("1 spectrum with a result, 3 inputs without: ")
    assert sum("bytes: truncated, or another file" in line for line in done.err) == 1
    target = tmp_path / "out.ecsv"
    assert run(*COMMAND, folder, "-o", target).code == 1
    assert b"SYNTHETIC-CE4-0002" in target.read_bytes()


def test_all_broken_is_one_line_and_nothing_else(run, tmp_path: Path, one: Files, two: Files) -> None:
    folder = write(tmp_path / "both", broken(one) | broken(two))
    target, picture = tmp_path / "o.ecsv", tmp_path / "p.png"
    done = run(*COMMAND, folder, "-o", target, "--plot", picture)
    assert (done.code, done.out, len(done.err)) == (1, "", 1)
    assert done.err[0].endswith("(and 1 more inputs without a result)")
    assert not target.exists()
    assert not picture.exists()


@pytest.mark.parametrize("content", [{}, {"readme.txt": b"nothing"}])
def test_a_folder_without_products(run, tmp_path: Path, content: Files) -> None:
    done = run(*COMMAND, write(tmp_path / "empty", content))
    assert (done.code, done.out, len(done.err)) == (4, "", 1)
    assert "folder holds no files" in done.err[0] or "no VNIS product in it" in done.err[0]


@pytest.mark.parametrize("argument", ["-", "rock.csv", "missing.2BL", "nothing*.2BL"])
def test_what_is_no_product_is_refused(run, tmp_path: Path, argument: str) -> None:
    (tmp_path / "rock.csv").write_text("wavelength_nm,r\n450,0.1\n")
    done = run(*COMMAND, argument if argument == "-" else tmp_path / argument)
    assert (done.code, done.out, len(done.err)) == (4 if "*" in argument else 1, "", 1)
    assert done.err[0].startswith("error: ")
    if argument == "-":
        assert "cannot come from stdin" in done.err[0]


# -- The other commands -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("command", "suffix"), [("bands", "ecsv"), ("fit", "fits")])
def test_a_label_gives_the_numbers_of_its_calibrated_file(
    run, label: Path, tmp_path: Path, command: str, suffix: str
) -> None:
    target = tmp_path / f"out.{suffix}"
    assert run(*COMMAND, label, "-o", target).code == 0
    direct, through = (run("spectra", command, path, "--json") for path in (label, target))
    assert (direct.code, through.code) == (0, 0), (direct.err, through.err)
    [first], [second] = result(direct), result(through)
    assert first.pop("source") == str(label)
    assert second.pop("source") == str(target)
    assert first == second
    text = json.dumps(first)
    assert "calibration" in text
    assert first["id"] == "SYNTHETIC-CE4-0001"


def test_the_provenance_of_bands_names_all_parts(run, label: Path, one: Files) -> None:
    used = json.loads(run("spectra", "bands", label, "--json").out)["provenance"]["inputs"]
    assert {item["path"] for item in used} == {str(label.parent / n) for n in one if not n.endswith(".json")}


# -- Options ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("disk", ["none", "akimov", "mcewen", "lommel-seeliger"])
def test_photometry_is_chosen_by_name(run, label: Path, disk: str) -> None:
    done = run(*COMMAND, label, "--photometry", disk, "--phase", "sp-high", "--json")
    [spectrum] = result(done)
    assert spectrum["photometry"]["disk"] == disk
    assert spectrum["photometry"]["phase"] == ("none" if disk == "none" else "sp-high")
    assert ("photometry_1" in spectrum["systematic"]) == (disk != "none")
    tables = {table["name"] for table in json.loads(done.out)["provenance"]["tables"]}
    assert ("selene_sp_phase.csv" in tables) == (disk != "none")
    assert {"vnis_fwhm.csv", "vnis_noise.csv", "solar_e490.csv", "solar_g173.csv"} <= tables


def test_a_phase_function_of_ones_own(run, label: Path, tmp_path: Path) -> None:
    """Lommel-Seeliger by hand: (cos 64.4454 + cos 45.557) / (cos 30 + 1), times f(30) = 2 over f = 1 beyond 40 deg."""
    table = tmp_path / "phase.csv"
    table.write_text("phase_deg,f\n0,4\n30,2\n40,1\n170,1\n")
    corrected = reflectance(run, label, "--phase", table)
    level = (np.cos(np.radians(64.412 + 0.0334)) + np.cos(np.radians(45.557))) / (np.cos(np.radians(30)) + 1)
    plain = reflectance(run, label, "--photometry", "none")
    assert corrected[200:] == pytest.approx(2 * level * plain[200:], rel=1e-6)
    done = run(*COMMAND, label, "--phase", table, "--json")
    inputs = {item["path"]: item["sha256"] for item in json.loads(done.out)["provenance"]["inputs"]}
    assert inputs[str(table)] == hashlib.sha256(table.read_bytes()).hexdigest()


def test_a_sun_of_ones_own(run, label: Path, tmp_path: Path) -> None:
    """2 % more light makes the ground 2 % darker."""
    header, *rows = (files("lunarsci.spectra_data") / "solar_e490.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    table = tmp_path / "sun.csv"
    table.write_text("\n".join([header, *(f"{w},{1.02 * float(e):.10g}" for w, e in cells)]) + "\n")
    wanted = reflectance(run, label) / 1.02
    assert reflectance(run, label, "--solar", table) == pytest.approx(wanted, rel=1e-6)
    [spectrum] = result(run(*COMMAND, label, "--solar", table, "--json"))
    assert spectrum["solar"] == "sun"
    assert reflectance(run, label, "--solar", "g173") != pytest.approx(1.02 * wanted, rel=1e-4)


def early(content: Files) -> Files:
    """The same with labels of version 1."""
    return {
        name: re.sub(rb"<version_id>2", b"<version_id>1", data, count=1) if name.endswith("L") else data
        for name, data in content.items()
    }


def factors(path: Path, swir: str = "1.1") -> Path:
    rows = [f"vnir,{450 + 5 * k},1.0" for k in range(100)] + [f"swir,{900 + 5 * k},{swir}" for k in range(300)]
    path.write_text("\n".join(["detector,wavelength_nm,factor", *rows]) + "\n")
    return path


def test_channel_factors(run, tmp_path: Path, two: Files, label: Path) -> None:
    """SWIR sets the level: factors of 1.1 lift everything by 10 %."""
    old = write(tmp_path / "old", early(two)) / named(two)
    without = run(*COMMAND, old, "--json")
    assert without.code == 0
    assert without.err == [f"warning: SYNTHETIC-CE4-0002: {result(without)[0]['notes'][0]}"]
    assert "version 1" in without.err[0]
    assert json.loads(without.out)["provenance"]["warnings"] == [without.err[0].removeprefix("warning: ")]
    assert run(*COMMAND, old, "-q").err == []
    table = factors(tmp_path / "factors.csv")
    done = run(*COMMAND, old, "--calibration", table, "--json")
    assert (done.code, done.err) == (0, [])
    assert result(done)[0]["reflectance"] == pytest.approx(1.1 * np.array(result(without)[0]["reflectance"]), rel=1e-6)
    inputs = {item["path"]: item["sha256"] for item in json.loads(done.out)["provenance"]["inputs"]}
    assert inputs[str(table)] == hashlib.sha256(table.read_bytes()).hexdigest()
    # Not for later products.
    [later] = result(run(*COMMAND, label, "--calibration", table, "--json"))
    assert any(note.startswith("channel factors not applied") for note in later["notes"])


@pytest.mark.parametrize(
    ("option", "content"),
    [
        ("--phase", None),
        ("--phase", "phase_deg,f\n0,1\n10,1\n"),
        ("--solar", None),
        ("--solar", "wavelength_nm,irradiance\n450,2.0\n460,2.1\n"),
        ("--calibration", None),
        ("--calibration", "detector,wavelength_nm,factor\nvnir,450,1.0\n"),
        ("--calibration", ""),
    ],
)
def test_bad_files_of_ones_own_are_one_line(run, label: Path, tmp_path: Path, option: str, content: str | None) -> None:
    table = tmp_path / "own.csv"
    if content is not None:
        table.write_text(content)
    done = run(*COMMAND, label, option, table)
    assert (done.code, done.out, len(done.err)) == (1, "", 1)
    assert str(table) in done.err[0]


@pytest.mark.parametrize(
    "arguments",
    [["--photometry", "hapke"], ["--vnir-steps", "both"], ["--shadow", "dark"], ["--json", "--csv"]],
)
def test_wrong_usage(run, label: Path, arguments: list[str]) -> None:
    done = run(*COMMAND, label, *arguments)
    assert (done.code, done.out, len(done.err)) == (2, "", 1)


# -- Batches ----------------------------------------------------------------------------------------------------------


def renumbered(content: Mapping[str, bytes], number: int) -> Files:
    """Names and labels of another sequence number; the cube left out."""
    made = {}
    for name, data in content.items():
        if len(data) < 1_000_000 and not name.endswith(".json"):
            data = data.replace(b"_0002_B", f"_{number:04d}_B".encode())
            data = data.replace(b"<sequence_id>0002", f"<sequence_id>{number:04d}".encode())
            made[name.replace("_0002_B", f"_{number:04d}_B")] = data
    return made


MANY = 12


@pytest.fixture
def many(tmp_path: Path, two: Files) -> Path:
    """Observations that share the bytes of one cube; number 7 has half a table."""
    folder, cube = tmp_path / "many", named(two, "VD", label=False)
    (tmp_path / "cube").write_bytes(two[cube])
    for number in range(1, MANY + 1):
        made = renumbered(two, number)
        if number == 7:
            table = named(made, label=False)
            made[table] = made[table][: len(made[table]) // 2]
        write(folder, made)
        os.link(tmp_path / "cube", folder / cube.replace("_0002_B", f"_{number:04d}_B"))
    return folder


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_many_observations_run_through_with_a_bar(many: Path, tmp_path: Path, drawn_on: Callable[[int], str]) -> None:
    import pty

    target = tmp_path / "all.csv"
    ours, theirs = pty.openpty()
    line = [sys.executable, "-m", "lunarsci.cli", *COMMAND, str(many), "-o", str(target)]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=theirs)
    os.close(theirs)
    drawn = drawn_on(ours)
    assert process.communicate()[0] == b""
    assert process.returncode == 1
    assert "calibrating" in drawn
    shares = [int(share) for share in re.findall(r"(\d+)%", drawn)]
    assert min(shares) == 0
    assert any(40 <= share <= 60 for share in shares)
    assert max(shares) >= 95
    said = [line for line in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r", "", drawn).splitlines() if "error: " in line]
    assert len(said) == 1
    assert "_0007_B" in said[0]
    ids = {line.partition(",")[0] for line in target.read_text().splitlines()[1:]}
    assert ids == {f"SYNTHETIC-CE4-{number:04d}" for number in range(1, MANY + 1) if number != 7}


def test_stdin_beside_a_label_does_not_stop_it(run, label: Path) -> None:
    done = run(*COMMAND, "-", label, "--json")
    assert (done.code, len(done.err), len(result(done))) == (1, 2, 1)
    assert done.err[1].startswith("1 spectrum with a result, 1 input without: ")
