"""What every command promises to a shell script."""

import csv
import io
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from lunarsci.cli.shared.emit import Report, field_of
from typer import BadParameter

from lunarsci.errors import Failure
from lunarsci.parallel.blocks import SavedBlocks
from lunarsci.result import Doubt, Result

NUMBERS = re.compile(r"(?<![\w\"])-?\d[\d.e+-]*")
COMMANDS = {
    "bands": ("spectra", "bands"),
    "fit": ("spectra", "fit"),
    "match": ("spectra", "match"),
    "identify": ("regolith", "identify", "--rover", "yutu2"),
    "forces": ("regolith", "forces"),
}


@pytest.fixture
def command(request: pytest.FixtureRequest, rock: Path, states: Path) -> list[str]:
    """A command that works, with its input."""
    name = request.param
    craters = rock.parent / "two_craters.csv"
    craters.write_text(
        "name,latitude_deg,longitude_deg,diameter_km,olivine,olivine_sigma,orthopyroxene,orthopyroxene_sigma\n"
        "alike,-43,190,5,0.6,0.02,0.2,0.02\nunlike,-45,171,5,0.05,0.02,0.75,0.02\n"
    )
    modes = ["--modes", "ol=0.6:0.02,opx=0.2:0.02", "--craters", str(craters), "--site=-45.44,177.56"]
    modes += ["--crater-prior", "uniform", "--systematic", "0.02"]
    inputs = {"bands": [rock], "fit": [rock], "match": modes, "identify": [states], "forces": ["--sinkage", "0.008"]}
    return [*COMMANDS[name], *map(str, inputs[name])]


every_command = pytest.mark.parametrize("command", list(COMMANDS), indirect=True)


@every_command
def test_table_json_and_csv_are_the_only_thing_on_stdout(run, command: list[str]) -> None:
    table = run(*command)
    assert table.code == 0
    assert "─" in table.out
    assert table.err == []
    document = json.loads(run(*command, "--json").out)
    assert document["schema"].startswith("lunarsci/")
    assert document.keys() == {"schema", "result", "provenance"}
    rows = list(csv.DictReader(io.StringIO(run(*command, "--csv").out)))
    assert len(rows) >= 1
    assert all(None not in row and None not in row.values() for row in rows)


@every_command
def test_json_is_sorted_and_byte_identical_without_time(run, command: list[str]) -> None:
    first, second = (run(*command, "--json", "--no-time").out for _ in range(2))
    assert first == second
    layout = json.dumps(json.loads(first), sort_keys=True, indent=2, ensure_ascii=False) + "\n"
    assert NUMBERS.sub("0", first) == NUMBERS.sub("0", layout), "numbers may be written otherwise: 1e-05, 0.00001"
    assert "time_utc" in json.loads(run(*command, "--json").out)["provenance"]


@every_command
def test_provenance_says_what_went_in(run, command: list[str]) -> None:
    provenance = json.loads(run(*command, "--json").out)["provenance"]
    assert provenance["command"] == " ".join(["lunarsci", *command[:2]])
    assert {"version", "options", "inputs", "tables", "sources", "seed", "versions", "warnings"} <= provenance.keys()
    assert provenance["sources"]
    for used in (*provenance["inputs"], *provenance["tables"]):
        assert len(used["sha256"]) == 64


def test_input_hashes_are_those_of_the_file(run, rock: Path) -> None:
    import hashlib

    [used] = json.loads(run("spectra", "bands", rock, "--json").out)["provenance"]["inputs"]
    assert used == {"path": str(rock), "sha256": hashlib.sha256(rock.read_bytes()).hexdigest()}


def test_a_soil_of_the_user_is_hashed_too(run, tmp_path: Path) -> None:
    import hashlib
    from importlib.resources import files

    table = files("lunarsci.regolith") / "soils.toml"
    own = tmp_path / "soil.toml"
    own.write_text(table.read_text().split("[lunar-typical]")[1].split("[longji]")[0])
    arguments = ("regolith", "forces", "--sinkage", "0.01", "--json", "--soil")
    [used] = json.loads(run(*arguments, own).out)["provenance"]["inputs"]
    assert used == {"path": str(own), "sha256": hashlib.sha256(own.read_bytes()).hexdigest()}
    tables = json.loads(run(*arguments, "longji").out)["provenance"]["tables"]
    assert {"name": "soils.toml", "sha256": hashlib.sha256(table.read_bytes()).hexdigest()} in tables


@every_command
def test_output_goes_to_a_file_and_never_over_one(run, command: list[str], tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    done = run(*command, "-o", target)
    assert (done.code, done.out) == (0, "")
    assert done.err[0] == f"written: {target}"
    # And what it says, for those who wait for the answer, and whether it is trusted.
    assert len(done.err) == 3 and done.err[2].startswith(("No check speaks against", "Composition decides"))
    if command[1] in ("bands", "fit"):
        assert done.err[1].startswith("synthetic_rock: ")
    assert len(run(*command, "-o", target, "--force", "-q").err) == 0
    before = target.read_bytes()
    again = run(*command, "-o", target)
    assert (again.code, again.out) == (2, "")
    assert "--force" in again.err[0]
    assert target.read_bytes() == before
    assert run(*command, "-o", target, "--force").code == 0
    assert json.loads(target.read_text())["result"]
    assert [path.name for path in tmp_path.glob(".*")] == []


# The names that matplotlib makes up stand in SVG only: that is where a picture would differ from run to run.
@pytest.mark.parametrize(
    ("command", "suffix"),
    [("bands", ".png"), ("bands", ".pdf"), *((name, ".svg") for name in COMMANDS)],
    indirect=["command"],
)
def test_pictures_are_written_and_repeatable(run, command: list[str], suffix: str, tmp_path: Path) -> None:
    magic = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    assert run(*command, "--plot", first, "-q").code == 0
    assert run(*command, "--plot", second, "-q").code == 0
    assert first.read_bytes().startswith(magic[suffix])
    assert first.read_bytes() == second.read_bytes()


def test_field_prints_one_bare_value(run, rock: Path) -> None:
    assert float(run("spectra", "bands", rock, "--field", "spectra.0.bc1000_nm").out) == pytest.approx(980, abs=15)
    assert run("spectra", "bands", rock, "--field", "result.spectra.0.id").out == "synthetic_rock\n"
    assert run("spectra", "fit", rock, "--field", "spectra.0.converged").out == "true\n"


def test_stdin_is_an_input(rock: Path, program: Path) -> None:
    done = subprocess.run(
        [program / "lunarsci", "spectra", "bands", "-", "--field", "spectra.0.bc1000_nm"],
        input=rock.read_bytes(),
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr
    assert 960 < float(done.stdout) < 1000


def test_config_sets_the_defaults_and_the_command_line_wins(run, rock: Path, tmp_path: Path) -> None:
    config = tmp_path / "run.toml"
    config.write_text('continuum = "hull"\nsmooth = 21\njson = true\n')
    options = json.loads(run("spectra", "bands", rock, "--config", config).out)["provenance"]["options"]
    assert (options["continuum"], options["smooth"]) == ("hull", 21)
    options = json.loads(run("spectra", "bands", rock, "--config", config, "--smooth", 11).out)["provenance"]["options"]
    assert options["smooth"] == 11


@pytest.mark.parametrize(
    ("text", "message"), [("smoth = 3\n", "smooth"), ("= 1", "TOML"), ("smooth = 'x'\n", "smooth")]
)
def test_a_bad_config_is_a_usage_error(run, rock: Path, tmp_path: Path, text: str, message: str) -> None:
    config = tmp_path / "run.toml"
    config.write_text(text)
    wrong = run("spectra", "bands", rock, "--config", config)
    assert (wrong.code, wrong.out, len(wrong.err)) == (2, "", 1)
    assert message in wrong.err[0]


@pytest.mark.parametrize(
    "arguments",
    [
        ["spectra", "bands"],
        ["spectra", "bands", "x.csv", "--smooth", "many"],
        ["spectra", "bands", "x.csv", "--continuum", "spline"],
        ["spectra", "bands", "x.csv", "--json", "--csv"],
        ["spectra", "bands", "x.csv", "--plot", "x.bmp"],
        ["spectra", "nonsense"],
        ["nonsense"],
        ["regolith", "forces"],
        ["regolith", "forces", "--sinkage", "0.01", "--load", "30"],
        ["regolith", "identify", "x.csv", "--lateral-modulus", "a,b"],
        ["regolith", "identify", "x.csv", "--draws", "1"],
        ["twin", "predict", "--members", "0"],
        ["--nonsense"],
    ],
)
def test_wrong_usage_is_one_line_and_exit_2(run, arguments: list[str]) -> None:
    wrong = run(*arguments)
    assert (wrong.code, wrong.out, len(wrong.err)) == (2, "", 1), wrong
    assert wrong.err[0].startswith("error: ")
    assert "--help" in wrong.err[0]


def test_no_help_has_a_unit_in_brackets() -> None:
    """Rich takes [m] for markup and prints nothing."""
    import typer.main
    from lunarsci.cli import command_line

    groups = [typer.main.get_command(command_line())]
    texts = []
    for command in groups:
        groups += getattr(command, "commands", {}).values()
        texts += [command.help or "", *(getattr(option, "help", None) or "" for option in command.params)]
    assert len(texts) > 100
    assert [text for text in texts if "[" in text] == []


def test_version(run) -> None:
    from importlib.metadata import version

    assert run("--version").out.strip() == version("lunarsci")


HEADER = "wavelength_nm,reflectance\n"
GRID = [450 + 5 * k for k in range(390)]


@pytest.fixture
def bad_spectra(tmp_path: Path) -> dict[str, Path]:
    contents = {
        "empty.csv": b"",
        "binary.csv": bytes(range(256)) * 40,
        "nan.csv": (HEADER + "".join(f"{w},nan\n" for w in GRID)).encode(),
        "text.csv": (HEADER + "450,bright\n").encode(),
        "units.csv": ("wavelength,reflectance\n" + "".join(f"{10 * w},0.1\n" for w in GRID)).encode(),
        "cut.csv": (HEADER + "".join(f"{w},0.1\n" for w in GRID) + "2400").encode(),
        "short.csv": (HEADER + "".join(f"{w},0.1\n" for w in GRID[:5])).encode(),
    }
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    return {name: tmp_path / name for name in contents} | {
        "missing.csv": tmp_path / "missing.csv",
        "folder": tmp_path / "e",
    }


@pytest.mark.parametrize(
    "name", ["empty.csv", "binary.csv", "nan.csv", "text.csv", "units.csv", "cut.csv", "short.csv", "missing.csv"]
)
@pytest.mark.parametrize("command", [("spectra", "bands"), ("spectra", "fit")])
def test_a_bad_spectrum_is_one_line_exit_1_and_nothing_written(
    run, bad_spectra: dict[str, Path], name: str, command: tuple[str, str], tmp_path: Path
) -> None:
    target, picture = tmp_path / "out.json", tmp_path / "out.png"
    failed = run(*command, bad_spectra[name], "-o", target, "--plot", picture, "-q")
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1), failed
    assert failed.err[0].startswith("error: ")
    assert not target.exists()
    assert not picture.exists()


STATES = "sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n\n"


@pytest.mark.parametrize(
    "content",
    [None, b"", bytes(range(256)) * 40, STATES + "nan,nan,nan,nan\n", "sinkage,slip\n1,2\n", STATES + ".008,0,-5,-1\n"],
    ids=["missing", "empty", "binary", "nan", "wrong column", "negative load"],
)
def test_a_bad_state_file_is_one_line_exit_1_and_nothing_written(
    run, tmp_path: Path, content: str | bytes | None
) -> None:
    file, target = tmp_path / "bad.csv", tmp_path / "out.json"
    if content is not None:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    failed = run("regolith", "identify", file, "-o", target, "-q")
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1), failed
    assert not target.exists()


@pytest.mark.parametrize("target", ["nowhere/out.json", "file.txt/out.json"])
def test_an_impossible_output_folder_is_said_before_anything_is_computed(
    run, rock: Path, tmp_path: Path, target: str
) -> None:
    (tmp_path / "file.txt").write_text("in the way")
    failed = run("spectra", "fit", rock, "-o", tmp_path / target)
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_write_permission(run, rock: Path, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    failed = run("spectra", "bands", rock, "-o", locked / "out.json")
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1)
    assert "no permission" in failed.err[0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_stdout_is_one_line(rock: Path, program: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([program / "lunarsci", "spectra", "bands", rock], stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 1
    assert len(done.stderr.decode().splitlines()) == 1
    assert b"No space left" in done.stderr


def test_a_full_disk_leaves_no_partial_file(run, rock: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    failed = run("spectra", "bands", rock, "-o", tmp_path / "out.json")
    assert (failed.code, failed.out, len(failed.err)) == (1, "", 1)
    assert "No space left" in failed.err[0]
    assert {path.name for path in tmp_path.iterdir()} == {"rock.csv"}


def test_a_batch_goes_on_past_bad_inputs_and_exits_1(run, rock: Path, bad_spectra: dict[str, Path]) -> None:
    done = run("spectra", "bands", bad_spectra["empty.csv"], rock, bad_spectra["missing.csv"], "--json")
    assert done.code == 1
    assert [s["id"] for s in json.loads(done.out)["result"]["spectra"]] == ["synthetic_rock"]
    assert sum(line.startswith("error: ") for line in done.err) == 2
    empty, missing = (str(bad_spectra[name]) for name in ("empty.csv", "missing.csv"))
    assert done.err[-1].startswith(f"1 spectrum with a result, 2 inputs without: {empty}, {missing} (--failed FILE")
    listed = run("spectra", "bands", empty, rock, missing, "--field", "provenance.failures")
    assert listed.code == 1
    assert [why.split(": ")[0] for why in json.loads(listed.out)] == [empty, missing]


def test_reasons_name_options_as_they_are_typed(run, rock: Path, tmp_path: Path) -> None:
    percent, kept = tmp_path / "percent.csv", tmp_path / "failed"
    percent.write_text("wavelength_nm,R (%)\n" + "".join(f"{400 + 10 * k},{0.20 + 0.001 * k}\n" for k in range(90)))
    said = "give --reflectance-unit fraction or percent"
    alone = run("spectra", "bands", percent)
    done = run("spectra", "bands", percent, rock, "--json", "--failed", kept)
    assert (alone.code, done.code) == (1, 1) and said in alone.err[-1] and said in done.err[-2]
    assert said in kept.read_text() and said in json.loads(done.out)["provenance"]["failures"][0]


def test_read_as_names_options_as_they_are_typed(run, tmp_path: Path) -> None:
    percent = tmp_path / "percent.csv"
    percent.write_text("wavelength_nm,Reflectance\n" + "".join(f"{400 + 10 * k},{20 + 0.1 * k}\n" for k in range(90)))
    done = run("spectra", "bands", percent, "--json")
    said = "read as percent; --reflectance-unit decides otherwise"
    assert done.code == 0 and any(said in line for line in done.err)
    assert any(said in line for line in json.loads(done.out)["result"]["read_as"])


EMPTY_TAKEN = ("bands", "indices", "fit", "unmix", "calibrate", "match")
"""Commands of spectra that take folders."""


@pytest.mark.parametrize("command", EMPTY_TAKEN)
def test_an_inbox_without_files_has_its_own_exit_code(run, rock: Path, tmp_path: Path, command: str) -> None:
    inbox, kept = tmp_path / "inbox", tmp_path / "failed"
    inbox.mkdir()
    pattern = tmp_path / "inbox" / "*.csv"
    for given in ((inbox,), (pattern,), (inbox, pattern)):
        done = run("spectra", command, *given, "--failed", kept, "--force")
        assert (done.code, done.out) == (4, ""), done
        assert [line.split("\t")[0] for line in kept.read_text().splitlines()] == list(map(str, given))
    if command not in ("calibrate", "match"):
        (inbox / "readme.txt").write_text("what comes here")
        assert run("spectra", command, inbox).code == 4
        assert run("spectra", command, inbox, tmp_path / "none.csv").code == 1
        (inbox / "bad.csv").write_text("no spectrum")
        assert run("spectra", command, inbox).code == 1


def test_a_batch_lists_what_failed_in_a_file(run, rock: Path, bad_spectra: dict[str, Path]) -> None:
    listed = rock.parent / "bands.failed"
    empty, missing = bad_spectra["empty.csv"], bad_spectra["missing.csv"]
    assert run("spectra", "bands", rock, "--failed", listed).code == 0
    assert listed.read_bytes() == b""
    kept = run("spectra", "bands", empty, rock, "--failed", listed)
    assert kept.code == 2 and "--force" in kept.err[0] and listed.read_bytes() == b""
    short, only = rock.parent / "two: and, a\ttab.csv", rock.parent / "only.csv"
    only.write_text("wavelength_nm,none\n1000,0.1\n2000,0.2\n")
    rows = "".join(f"{nm},,{0.3 - 0.1 * math.exp(-(((nm - 950) / 90) ** 2))}\n" for nm in range(500, 2400, 10))
    short.write_text(f"wavelength_nm,none,good\n490,0.1,0.3\n495,0.2,0.3\n{rows}")
    for given, code in (((empty, rock, missing, short), 1), ((empty, missing, only), 1)):
        assert run("spectra", "bands", *given, "--failed", listed, "--force").code == code
        lines = [line.split("\t") for line in listed.read_text("utf-8").splitlines()]
        whole = [line for line in lines if not line[2]]
        assert [name for name, _, _ in whole] == [str(empty), str(missing), *([str(only)] if only in given else [])]
        assert all(reason and not reason.startswith(str(empty.parent)) for _, reason, _ in lines)
        assert [(name, spectrum) for name, _, spectrum in lines if spectrum] == (
            [(str(short).replace("\t", r"\x09"), "none")] if short in given else []
        )
    assert run("spectra", "bands", rock, "--failed", listed, "-o", listed, "--force").code == 2


def test_results_in_a_folder_of_inputs_are_left_out_and_said(run, rock: Path) -> None:
    folder = rock.parent / "in"
    folder.mkdir()
    (folder / "rock.csv").write_bytes(rock.read_bytes())
    for name in ("bands.json", "bands.csv"):
        assert run("spectra", "bands", rock, "-o", folder / name).code == 0
    assert run("spectra", "fit", rock, "--columns", "id,status", "-o", folder / "fit.csv").code == 0
    (folder / "own.json").write_text('{"schema": "mine/1"}')
    (folder / "night.failed").write_text("")
    done = run("spectra", "bands", folder, "--failed", rock.parent / "now.failed", "--json")
    assert [one["id"] for one in json.loads(done.out)["result"]["spectra"]] == ["synthetic_rock"]
    assert any(
        f"{folder}: left out, 3 results of lunarsci: bands.csv, bands.json, fit.csv" in line for line in done.err
    )
    assert (rock.parent / "now.failed").read_text("utf-8").startswith(f"{folder / 'own.json'}\t")
    (folder / "rock.csv").unlink()
    (folder / "own.json").unlink()
    alone = run("spectra", "bands", folder)
    assert alone.code == 4 and "nothing but results of lunarsci" in alone.err[-1]


def test_what_is_written_to_a_file_is_answered_in_a_sentence_with_its_trust(run, tmp_path: Path) -> None:
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    done = run("regolith", "forces", "--load", "36.5", "--slip", "0.1", "-o", one)
    assert done.err[1].startswith("At 12.4 mm sinkage and a slip of 0.1 a wheel carries 36.5 N, pulls with 4.93 N ")
    assert done.err[2:] == ["No check speaks against this result."]
    weak = ("twin", "predict", "--sweep", "friction_angle_deg=8:10:2")
    done = run(*weak, "-o", two)
    assert (done.code, done.out) == (3, "") and done.err[-2].startswith("No-go for the drive")
    assert not any("nothing against" in line for line in done.err)
    quiet = run(*weak, "-q", "-o", two, "--force")
    assert not any(line.startswith("No-go for the drive") for line in quiet.err)


def test_a_wrong_column_is_wrong_usage_and_the_nearest_is_named(run, rock: Path) -> None:
    for form in (["--csv"], []):
        left = rock.parent / "failed.txt"
        done = run("spectra", "bands", rock, *form, "--columns", "bc1000_mn", "--failed", left)
        assert not left.exists(), "nothing is written of what is refused"
        assert (done.code, done.out) == (2, "")
        assert "--columns: 'bc1000_mn' is not a column" in done.err[0] and "did you mean 'bc1000_nm'?" in done.err[0]


def test_blocks_of_another_computation_are_wrong_usage(run, rock: Path) -> None:
    target, partial = rock.parent / "out.csv", rock.parent / "out.csv.partial" / "bands"
    before = SavedBlocks(partial, {"options": "others"}, 20, 16)
    before.save(range(16), {"a": np.zeros(16)})
    before.close(remove=False)
    many = [rock.parent / f"{k}.csv" for k in range(20)]
    for name in many:
        name.write_bytes(rock.read_bytes())
    done = run("spectra", "bands", *many, "--csv", "-o", target)
    assert done.code == 2 and "another computation" in done.err[-1] and not target.exists()


def test_a_pattern_without_files_does_not_stop_a_batch(run, rock: Path) -> None:
    done = run("spectra", "bands", rock, rock.parent / "nothing*.csv", "--json")
    assert done.code == 1
    [spectrum] = json.loads(done.out)["result"]["spectra"]
    assert spectrum["source"] == str(rock)


def test_a_field_below_null_is_null_and_said(run, rock: Path) -> None:
    done = run("spectra", "fit", rock, "--assemblage", "OL", "--field", "spectra.0.nbsr.um1.opx")
    assert (done.code, done.out) == (3, "null\n")
    assert done.err[-1] == "--field spectra.0.nbsr.um1.opx: no value"


def test_a_field_that_other_spectra_have_is_missing_here(run, rock: Path) -> None:
    """A mineral that was not fitted is missing; a wrong name stays wrong usage."""
    fit = ("spectra", "fit", rock, "--assemblage", "OL", "--field")
    lacking = run(*fit, "spectra.0.compositions.fs.mean")
    assert (lacking.code, lacking.out) == (3, "null\n")
    assert lacking.err[-1] == "--field spectra.0.compositions.fs.mean: no value: no 'fs' here; there is: fo"
    for name in ("fss", "sigma"):
        wrong = run(*fit, f"spectra.0.compositions.{name}.mean")
        assert (wrong.code, wrong.out) == (2, "")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Listed(Result):
    record: dict[str, Any]

    def content(self) -> dict[str, Any]:
        return self.record

    def rows(self) -> list[dict[str, Any]]:
        return []


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Doubtful(Listed):
    @property
    def doubt(self) -> Doubt:
        return Doubt.of("give `rover`")

    @property
    def failures(self) -> list[Failure]:
        return [Failure.of("a.csv", "lacks `rover`")]


def test_a_report_words_all_its_reasons() -> None:
    record = {"read_as": ["as of `rover`"]}
    report = Report(Doubtful(record=record), (), worded=lambda text: text.replace("`rover`", "--rover"))
    assert report.untrusted == "give --rover"
    assert [*map(str, report.failures)] == ["a.csv: lacks --rover"]
    assert report.content == {"read_as": ["as of --rover"]} and record["read_as"] == ["as of `rover`"]


def test_names_of_other_things_of_a_list_could_be_here() -> None:
    result = {"rocks": [{"inner": {"a": 1}}, {"inner": {"b": 2}, "name": "second"}], "a": None}
    report = Report(Listed(record=result), ())
    assert field_of(report, "rocks.second.inner.b", {}) == ("2\n", "")
    with pytest.raises(BadParameter, match="there is: 0 to 1, or by name: second"):
        field_of(report, "rocks.third", {})
    assert field_of(report, "rocks.0.inner.a", {}) == ("1\n", "")
    text, doubt = field_of(report, "rocks.0.inner.b", {})
    assert text == "null\n"
    assert "no 'b' here; there is: a" in doubt
    for path in ("rocks.0.inner.c", "rocks.2.inner", "rocks.0.b", "b"):
        with pytest.raises(BadParameter):
            field_of(report, path, {})


def test_a_fit_that_explains_nothing_is_not_to_be_trusted(run, rock: Path) -> None:
    rock.write_text(HEADER + "".join(f"{w},{0.1 if k % 2 else 0.9}\n" for k, w in enumerate(GRID)))
    done = run("spectra", "fit", rock)
    assert done.code == 3
    assert "does not describe" in done.err[-1]


def test_a_folder_is_a_batch(run, rock: Path) -> None:
    (rock.parent / "second.csv").write_bytes(rock.read_bytes())
    for name in ("readme.txt", "rock.png"):
        (rock.parent / name).write_text("about the others")
    done = run("spectra", "bands", rock.parent, "--json")
    assert done.code == 0 and len(json.loads(done.out)["result"]["spectra"]) == 2
    assert done.err == [f"warning: {rock.parent}: left out, no data by name: readme.txt, rock.png"]
    assert run("spectra", "bands", rock.parent / "*", "--json").code == 1  # a pattern takes what it names


def test_what_is_not_to_be_trusted_is_printed_and_exits_3(run, states: Path) -> None:
    """Skidding at -0.075 with a pull of -1.30 N: no friction angle explains it under the physical reading."""
    states.write_text(states.read_text().replace("0.05", "-0.075"))
    done = run("regolith", "identify", states, "--json")
    assert done.code == 3
    assert json.loads(done.out)["result"]["shear"]["friction_angle_deg"]["value"] is None
    assert any(line.startswith("not to be trusted: ") for line in done.err)


def test_warnings_are_said_once_recorded_and_silenced_by_quiet(run, states: Path) -> None:
    arguments = ("regolith", "identify", states, "--rover", "yutu2", "--reading", "slip-branch", "--json")
    done = run(*arguments)
    assert [line for line in done.err if line.startswith("warning: ")] == done.err[:1]
    assert json.loads(done.out)["provenance"]["warnings"] == [done.err[0].removeprefix("warning: ")]
    assert not any(line.startswith("warning") for line in run(*arguments, "-q").err)


def test_the_seed_decides_the_draws(run, states: Path) -> None:
    field = ("--field", "bearing.stiffness_kpa_m_n.sigma")
    first, same, other = (run("regolith", "identify", states, "--seed", s, *field).out for s in (1, 1, 2))
    assert first == same != other


def test_a_traceback_only_when_asked_for(run, tmp_path: Path) -> None:
    assert len(run("spectra", "bands", tmp_path / "missing.csv").err) == 1
    assert any("Traceback" in line for line in run("spectra", "bands", tmp_path / "missing.csv", "-v").err)


def test_a_reader_that_leaves_early_is_no_traceback(rock: Path, program: Path) -> None:
    done = subprocess.run(f"'{program}/lunarsci' spectra fit '{rock}' --json | true", shell=True, capture_output=True)
    assert b"Traceback" not in done.stderr


def test_a_closed_stdout_is_one_line(rock: Path) -> None:
    command = f"'{sys.executable}' -m lunarsci.cli spectra bands '{rock}' >&-"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert (done.returncode, len(done.stderr.splitlines())) == (1, 1)
    assert "-o FILE" in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
@pytest.mark.parametrize(
    ("command", "field", "printed", "bar"),
    [
        ("spectra bands", "spectra.0.id", b"synthetic_rock\n", "measuring bands"),
        ("twin predict", "members", b"3\n", "driving"),
    ],
)
def test_progress_is_drawn_on_a_terminal_and_only_on_stderr(
    rock: Path,
    short_plan: Path,
    program: Path,
    drawn_on: Callable[[int], str],
    command: str,
    field: str,
    printed: bytes,
    bar: str,
) -> None:
    import pty

    ours, theirs = pty.openpty()
    given = {"spectra bands": [str(rock)], "twin predict": [str(short_plan), "--sweep", "friction_angle_deg=35:45:3"]}
    line = [program / "lunarsci", *command.split(), *given[command], "--field", field]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=theirs)
    os.close(theirs)
    drawn = drawn_on(ours)
    assert process.communicate()[0] == printed
    assert bar in drawn
    assert "%" in drawn


def test_a_signal_leaves_nothing_behind_and_names_itself(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "lunarsci.cli", "twin", "predict", "--time-step", "0.0005", "-o"]
    started = {
        name: subprocess.Popen(
            [*line, str(tmp_path / name)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            preexec_fn=lambda: [signal.signal(one, signal.SIG_DFL) for one in (signal.SIGINT, signal.SIGHUP)] and None,
        )  # The first is ignored in the background, the second under nohup.
        for name in ("SIGINT", "SIGTERM", "SIGHUP")
    }
    # Wherever it falls, in a destructor or while machine code is made, where Python loses it, once is enough.
    time.sleep(5)
    for name, process in started.items():
        number = getattr(signal, name)
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
        assert process.returncode == 128 + number, err
        assert out == b""
        assert err.decode().splitlines()[-1].startswith("interrupted")
    assert list(tmp_path.iterdir()) == []


def test_a_picture_that_fails_loses_no_other_file(run, rock: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was computed for a long time is written; the command fails all the same."""

    def fails(*_: object) -> bytes:
        raise ValueError("zip() argument 2 is shorter than argument 1")

    monkeypatch.setattr("lunarsci.figure.picture_bytes", fails)
    result, picture = rock.parent / "bands.json", rock.parent / "bands.png"
    done = run("spectra", "bands", rock, "-o", result, "--plot", picture)
    assert done.code == 1 and done.out == "" and "unexpected ValueError" in done.err[-1]
    assert json.loads(result.read_text())["result"] and not picture.exists() and f"written: {result}" in done.err


def test_a_field_that_lies_deeper_is_named(run, rock: Path) -> None:
    for asked in ("bc1000_nm", "spectra.bc1000_nm"):
        done = run("spectra", "bands", rock, "--field", asked)
        assert done.code == 2 and "did you mean 'spectra.0.bc1000_nm'?" in done.err[0]
    kept = rock.parent / "several.json"
    assert run("spectra", "bands", rock, rock, "-o", kept).code in (0, 3)
    done = run("info", kept, "--field", "result.spectra.1.fits.bc1000_nm")
    assert done.code == 2 and "did you mean 'result.spectra.1.bc1000_nm'?" in done.err[0]


def test_a_value_of_a_kept_result_is_read_without_computing_it_again(tmp_path: Path, run: Callable[..., Any]) -> None:
    """With the exit codes of the command that made it: no value, one of a shaky result, and wrong usage."""
    kept = {"spectra": [{"id": "a", "bc1000_nm": 931.5, "bc2000_nm": None}, {"id": "b"}]}
    files = {name: tmp_path / f"{name}.json" for name in ("good", "shaky")}
    for path, doubt in zip(files.values(), ("", "not to be trusted: no convergence for a"), strict=True):
        document = {"schema": "lunarsci/spectra-indices/1", "result": kept, "provenance": {"untrusted": doubt}}
        path.write_text(json.dumps(document), encoding="utf-8")
    asked = ("info", files["good"], "--field")
    found = run(*asked, "result.spectra.0.bc1000_nm")
    assert (found.code, found.out, found.err) == (0, "931.5\n", [])
    assert run(*asked, "kind").out == "result\n", "keys of the file itself"
    missing = run(*asked, "result.spectra.0.bc2000_nm")
    assert (missing.code, missing.out) == (3, "null\n") and "no value" in missing.err[0]
    other = run(*asked, "result.spectra.1.bc1000_nm")
    assert (other.code, other.out) == (3, "null\n") and "no 'bc1000_nm' here" in other.err[0]
    wrong = run(*asked, "result.spectra.0.bc1001_nm")
    assert (wrong.code, wrong.out) == (2, "") and "bc1000_nm" in " ".join(wrong.err)
    shaky = run("info", files["shaky"], "--field", "result.spectra.0.bc1000_nm")
    assert (shaky.code, shaky.out, shaky.err) == (3, "931.5\n", ["not to be trusted: no convergence for a"])


def test_a_value_of_a_kept_batch_is_trusted_as_its_own_spectrum_is(tmp_path: Path, run: Callable[..., Any]) -> None:
    """A bad spectrum beside a good one is nothing against that; all of them together are not to be trusted."""
    kept = tmp_path / "fit.json"
    good = {"status": "converged", "rms_ln": 0.01, "choice": {"strong": True}}
    bad = (
        {"status": "not converged after 5 iterations"},
        {"status": "converged; strained: OPX 1 lies far from where such bands are usual"},
        {"rms_ln": 0.3},
        {"choice": {"strong": False}},
    )
    spectra = [good | more | {"id": f"s{k}"} for k, more in enumerate(({}, *bad))]
    record = {"untrusted": "not to be trusted: no convergence for s1"}
    document = {"schema": "lunarsci/spectra-fit/1", "result": {"spectra": spectra}, "provenance": record}
    kept.write_text(json.dumps(document), encoding="utf-8")
    asked = [run("info", kept, "--field", f"result.spectra.{k}.rms_ln") for k in range(len(spectra))]
    assert [one.code for one in asked] == [0, 3, 3, 3, 3]
    assert asked[0].err == [] and "s4 is not to be trusted: the assemblage is not decided" in asked[4].err[0]
    assert run("info", kept, "--field", "result.spectra").code == 3
    assert [run("info", kept, "--field", f"result.spectra.s{k}.rms_ln").code for k in (0, 4)] == [0, 3]
    water = "no band: a narrow absorption at 1940 nm, 105 nm wide: water or hydroxyl"
    bands = [{"id": "a", "band2000_status": "ok"}, {"id": "b", "band2000_status": water}]
    result = {"spectra": [one | {"bc1000_nm": 931.5} for one in bands]}
    kept.write_text(json.dumps(document | {"schema": "lunarsci/spectra-bands/1", "result": result}), encoding="utf-8")
    assert [run("info", kept, "--field", f"result.spectra.{k}.bc1000_nm").code for k in "ab"] == [0, 3]


@pytest.mark.parametrize("quiet", [(), ("-q",)])
def test_a_batch_without_a_result_says_that_the_file_of_an_earlier_run_was_left(
    run, rock: Path, tmp_path: Path, quiet: tuple[str, ...]
) -> None:
    out, plot, failed, bad = (tmp_path / name for name in ("bands.json", "bands.png", "bands.failed", "bad.csv"))
    bad.write_text("no spectrum")
    command = ("spectra", "bands", bad, "--force", *quiet, "-o", out, "--failed", failed)
    first = run(*command)
    assert first.code == 1 and "earlier run" not in " ".join(first.err)
    assert run("spectra", "bands", rock, "-q", "-o", out, "--plot", plot).code == 0
    before = out.read_bytes()
    again = run(*command, "--plot", plot)
    assert again.code == 1
    assert f"{out} is of an earlier run and was left as it is" in again.err
    assert f"{plot} is of an earlier run and was left as it is" in again.err
    written = [] if quiet else [f"written: {failed}"]
    assert again.err[2:-1] == written and again.err[-1].startswith("error: ")
    assert out.read_bytes() == before
    part = run(*command, rock)
    assert part.code == 1 and "earlier run" not in " ".join(part.err)
    assert out.read_bytes() != before


def test_every_command_of_many_inputs_can_list_what_failed(run, bad_spectra: dict[str, Path]) -> None:
    missing = bad_spectra["missing.csv"]
    commands = ["bands", "fit", "unmix", "indices", "match", "calibrate", "library check"]
    for name in commands:
        listed = missing.parent / f"{name}.failed"
        done = run("spectra", *name.split(), missing, "--failed", listed)
        assert (done.code, done.out) == (1, ""), name
        assert listed.read_text("utf-8").split("\t")[0] == str(missing), name


def test_coarse_steps_and_samples_are_refused(run) -> None:
    for option in ("--sample", "--time-step"):
        done = run("twin", "predict", option, "5")
        assert (done.code, done.out, len(done.err)) == (1, "", 1)


def test_a_failed_input_decides_the_code_and_a_doubt_is_recorded_all_the_same() -> None:
    """As docs/reference/json.md says."""
    text = (Path(__file__).parents[2] / "docs/reference/json.md").read_text("utf-8")
    assert "`untrusted` (empty where the exit code is 0) and `failures` (where there are any, the exit code is" in text
    result: Any = SimpleNamespace(doubt="far off", failures=[Failure.of("a.csv", "is not there")])
    report = Report(result, [])
    assert (report.exit_code, report.untrusted) == (1, "far off")
