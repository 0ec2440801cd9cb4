"""Every command of the README runs and prints what the README shows, numbers to a few percent."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import typer
from lunarsci.cli import command_line, main
from lunarsci.cli.shared.aliases import ALIASES

from lunarsci.tables import table_rows

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text("utf-8")
CONSOLE = re.findall(r"```console\n\$ (.+?)\n(.*?)```", TEXT, re.DOTALL)
SHELL = re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL)
PYTHON = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
Shell = Callable[[str], subprocess.CompletedProcess[str]]
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?![\w.])")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder, in which the demo will run."""
    return tmp_path_factory.mktemp("readme")


@pytest.fixture(scope="module")
def shell(folder: Path, program: Path) -> Shell:
    """Runs a line in the folder, with `lunarsci` on the path."""
    environment = os.environ | {"PATH": f"{program}{os.pathsep}{os.environ['PATH']}", "PYTHONUTF8": "1"}

    def run(command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["sh", "-c", command], cwd=folder, env=environment, capture_output=True, text=True)

    return run


@pytest.fixture(scope="module")
def demo(shell: Shell) -> str:
    done = shell("lunarsci demo")
    assert done.returncode == 0, done.stderr
    return done.stdout


def same(shown: str, printed: str) -> None:
    """The same words and layout; numbers within 3 % or three units of the last digit shown."""
    words = [re.sub("─+", "─", NUMBER.sub("#", text)).split() for text in (shown, printed)]
    assert words[0] == words[1]
    for one, other in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        last_digit = 10.0 ** -len(one.partition(".")[2])
        assert float(other) == pytest.approx(float(one), rel=0.03, abs=3 * last_digit), (one, other)


def test_the_readme_has_examples() -> None:
    assert {command.split()[1] for command, _ in CONSOLE} == {"demo", "spectra", "regolith", "reproduce", "twin"}


@pytest.mark.slow
@pytest.mark.parametrize(("command", "shown"), CONSOLE, ids=[command for command, _ in CONSOLE])
def test_examples_print_what_they_show(command: str, shown: str, shell: Shell, request: pytest.FixtureRequest) -> None:
    if "demo" in command:
        demo = request.getfixturevalue("demo")
        if command == "lunarsci demo":
            same(shown, demo)
            return
    done = shell(command)
    assert done.returncode == 0, done.stderr
    same(shown, done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("script", [s for s in SHELL if "make" not in s])
def test_scripts_run(script: str, demo: str, shell: Shell) -> None:
    done = shell(f"set -e\n{script}")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("text", PYTHON)
def test_programs_run(text: str, demo: str, folder: Path) -> None:
    done = subprocess.run([sys.executable, "-c", text], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_make_targets_exist() -> None:
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {line.split()[1] for script in SHELL for line in script.splitlines() if line.startswith("make ")}
    assert named == {"demo", "test"}
    assert named <= targets


def commands_of(group: typer.Typer, above: str = "") -> list[str]:
    """Every command below a group, with the groups it is in."""
    own = [f"{above} {command.name}".strip() for command in group.registered_commands if command.name]
    below = [commands_of(inner.typer_instance, f"{above} {inner.name}") for inner in group.registered_groups]
    return [*own, *(name for names in below for name in names)]


def test_options_named_in_the_readme_exist(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every `--option` in the prose is one of some command."""
    monkeypatch.setenv("COLUMNS", "200")
    for command in commands_of(command_line()):
        assert main([*command.split(), "--help"]) == 0
    known = capfd.readouterr().out
    for option in set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", TEXT)):
        assert option in known or option in {alias.option for alias in ALIASES}, option


@pytest.mark.parametrize("path", [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")], ids=str)
def test_scripts_that_documents_run_exist(path: Path) -> None:
    named = re.findall(r"python ((?:tests|spectra_data)/[\w/]+\.py)", path.read_text("utf-8"))
    assert [script for script in named if not (ROOT / script).is_file()] == []


def test_the_calibration_of_shares_is_that_of_the_table() -> None:
    """What the README says of each class is what `make_abundance_calibration.py` measured."""
    rows = table_rows("abundance_calibration.csv")
    shown = [line.strip("| ").split(" | ") for line in TEXT.splitlines()]
    told = {cells[0]: cells[1:] for cells in shown if cells[0] in [row["name"] for row in rows]}
    assert len(told) == len(rows) == 3
    for row in rows:
        held = [f"{100 * float(row[name]):.0f} %" for name in ("held68", "held95")]
        assert told[row["name"]][:4] == [row["count"], str(len(row["suites"].split())), *held]
        assert told[row["name"]][4:] == [f"{float(row[name]):.2f}" for name in ("precision", "recall")]


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_files_and_targets_that_documents_name_exist(name: str) -> None:
    text = (ROOT / name).read_text("utf-8")
    here = [path.relative_to(ROOT).as_posix() for top in ("lunarsci", "cli", "spectra_data", "tests", "docs") 
            for path in (ROOT / top).rglob("*")]  # fmt: skip
    named = set(re.findall(r"`([\w./]+\.(?:py|csv|toml|md)|[\w/]+/[\w/]+)`", text)) - {
        "lunarsci/spectra/readers/NAME.py"
    }
    assert len(named) > 20
    known = ["/" + path for path in here] + ["/" + path.name for path in ROOT.iterdir()]
    missing = [path for path in named if not any(one.endswith("/" + path) for one in known)]
    assert missing == []
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    assert set(re.findall(r"`make (\w+)`", text)) <= set(targets)
    told = subprocess.run(["make", "-C", str(ROOT), "help"], capture_output=True, text=True, check=True).stdout
    assert {"help", "demo", "test", "quick", "check", "clean"} <= {line.split()[0] for line in told.splitlines()}
