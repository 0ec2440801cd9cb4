"""On a terminal a command shows its answer, a table and a few notes; all else is one option away."""

from pathlib import Path

import pytest
from lunarsci.cli.shared.table import TextTable, first_screen

SCREENS = {
    "bands": "spectra bands rock.ecsv",
    "indices": "spectra indices rock.ecsv",
    "fit": "spectra fit rock.ecsv",
    "choice of minerals": "spectra fit rock.ecsv --assemblage auto",
    "shares": "spectra unmix rock.ecsv",
    "forces": "regolith forces --sinkage 0.01",
    "soil": "regolith identify wheel_states.csv --lateral-modulus 20",
    "drive": "twin predict",
    "terrain": "twin terrain",
    "cameras": "images cameras rig.toml",
    "heights": "images dem left.png right.png --rig rig.toml",
    "file": "info rock.ecsv",
}


@pytest.fixture
def terminal(demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal of 80 columns in the demo's folder."""
    monkeypatch.chdir(demo / "lunarsci-demo")
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("lunarsci.cli.shared.emit.on_terminal", lambda: True)


@pytest.mark.parametrize("command", SCREENS.values(), ids=SCREENS)
def test_what_a_command_shows_at_first_fits_a_screen(run, terminal: None, command: str) -> None:
    done = run(*command.split(), "-q")
    lines = done.out.splitlines()
    assert done.code in (0, 3), done.err
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    assert lines[0] and not lines[0].startswith("─")


def test_the_rest_is_behind_verbose(run, terminal: None) -> None:
    short, whole = (run("spectra", "fit", "rock.ecsv", "-q", *more).out for more in ((), ("--verbose",)))
    assert "more lines: --verbose" in short and "more lines" not in whole
    assert "mineral shares" in whole and "mineral shares" not in short
    assert "What this says" in whole


def test_why_a_drive_is_no_go_is_said_once(run, terminal: None) -> None:
    done = run("twin", "predict", "--sweep", "friction_angle_deg=8:12:3", "-q")
    assert done.code == 3 and done.out.startswith("No-go for the drive") and not done.err
    assert run("twin", "predict", "--sweep", "friction_angle_deg=8:12:3", "-q", "--verbose").err


def test_each_of_a_few_spectra_has_its_sentence(run, terminal: None) -> None:
    lines = run("spectra", "bands", "rock.ecsv", *sorted(map(str, Path().glob("*SD_SCI*.2B"))), "-q").out.splitlines()
    assert sum(line.startswith("SYNTHETIC-CE4-0001: ") for line in lines) == 2 and len(lines) <= 24


def test_a_long_table_is_cut_and_says_so(run, terminal: None) -> None:
    lines = run("regolith", "forces", "--sinkage", "0.01", "--slip", "0:0.5:90", "-q").out.splitlines()
    assert len(lines) == 24 and "more rows" in lines[-1]


def test_a_pipe_gets_everything(run, terminal: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lunarsci.cli.shared.emit.on_terminal", lambda: False)
    assert "mineral shares" in run("spectra", "fit", "rock.ecsv", "-q").out


def test_a_file_whose_name_tells_no_form_is_said_to_be_text(run, tmp_path: Path) -> None:
    forces = ("regolith", "forces", "--sinkage", "0.01", "-o")
    said = {end: run(*forces, tmp_path / f"forces{end}").err[0] for end in (".xyz", ".txt", ".md")}
    assert "as text; .txt, .md, .tsv, .tex, .csv, .json at the end of its name give other forms" in said[".xyz"]
    assert said[".txt"].endswith("forces.txt") and said[".md"].endswith("forces.md")
    assert (tmp_path / "forces.xyz").read_bytes() == (tmp_path / "forces.txt").read_bytes()


def test_of_several_spectra_all_rows_come_before_sentences() -> None:
    verdicts = [f"rock {k}: {'a pyroxene is sure, which one is open, ' * 8}" for k in range(5)]
    table = TextTable(["rock", "assemblage"], [[f"rock {k}", "CPX"] for k in range(5)], notes=["a note"] * 30)
    lines = first_screen(verdicts, [table], 80).splitlines()
    assert sum(line.endswith("CPX") for line in lines) == 5 and len(lines) <= 24
    assert lines[0].startswith("rock 0: a pyroxene") and "more lines: --verbose" in lines[-1]


def test_rows_of_several_lines_are_shown_as_far_as_there_is_room() -> None:
    """As of rocks with a long verdict each: some rows, not the heading alone."""
    rows = [[f"rock {k}", f"verdict {k}: {'not decided, many remain, ' * 8}"] for k in range(8)]
    lines = first_screen(["Of 8 rocks 8: not decided."], [TextTable(["rock", "status"], rows)], 80).splitlines()
    assert sum(line.startswith("rock ") for line in lines[2:]) > 2 and "more rows" in lines[-1]
    assert len(lines) <= 24
