"""README and the pages of `docs` name what is there: options, scripts, files, targets, links, measured tables."""

import re
import subprocess
from pathlib import Path

import pytest
import typer
from lunarsci.cli import command_line, main

from lunarsci.tables import table_rows

ROOT = Path(__file__).parents[1]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    *(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
]
LINK = re.compile(r"\]\(([^)\s]+)\)")
SCHEMES = ("http://", "https://", "mailto:")
COMMAND_PAGES = ROOT / "docs/reference/commands"


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def test_make_targets_exist() -> None:
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {name for page in PAGES for name in re.findall(r"^make (\w+)|`make (\w+)`", page.read_text("utf-8"))}
    assert {name for pair in named for name in pair if name} <= targets


def commands_of(group: typer.Typer, above: str = "") -> list[str]:
    """Every command below a group, with the groups it is in."""
    own = [f"{above} {command.name}".strip() for command in group.registered_commands if command.name]
    below = [commands_of(inner.typer_instance, f"{above} {inner.name}") for inner in group.registered_groups]
    return [*own, *(name for names in below for name in names)]


@pytest.fixture(scope="module")
def known() -> list[str]:
    return commands_of(command_line())


def test_options_named_in_pages_exist(
    known: list[str], capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every `--option` in the prose is one of some command, or of another program that the page runs."""
    monkeypatch.setenv("COLUMNS", "200")
    for command in known:
        assert main([*command.split(), "--help"]) == 0
    told = capfd.readouterr().out
    others = {"--repo", "--create-namespace", "--generate-name", "--scheduler-file", "--nworkers", "--nthreads"}
    others |= {"--extra-index-url", "--strict", "--write", "--small", "--seed", "--first", "--soils"}
    for page in PAGES:
        for option in set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", page.read_text("utf-8"))) - others:
            assert option in told, (name_of(page), option)


def test_every_command_has_its_place_in_the_reference(known: list[str]) -> None:
    text = "".join(page.read_text("utf-8") for page in COMMAND_PAGES.glob("*.md"))
    described = re.findall(r"^```\{command\} (.+)$", text, re.MULTILINE)
    assert sorted(described) == sorted(known)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files(page: Path) -> None:
    """Links within the project; those within the built documentation Sphinx checks."""
    links = [link for link in LINK.findall(page.read_text("utf-8")) if not link.startswith((*SCHEMES, "#", "doi:"))]
    made = {"reference/sources.md", "reference/json.md"}
    missing = [link for link in links if not (page.parent / link.partition("#")[0]).exists()]
    assert [link for link in missing if not link.endswith(tuple(made))] == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_scripts_that_pages_run_exist(page: Path) -> None:
    named = re.findall(r"python ((?:tests|spectra_data)/[\w/]+\.py)", page.read_text("utf-8"))
    assert [script for script in named if not (ROOT / script).is_file()] == []


def test_the_calibration_of_shares_is_that_of_the_table() -> None:
    """What the pages say of each class is what `make_abundance_calibration.py` measured."""
    rows = table_rows("abundance_calibration.csv")
    text = (ROOT / "docs/validation/rock.md").read_text("utf-8")
    shown = [line.strip("| ").split(" | ") for line in text.splitlines()]
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
    named = set(re.findall(r"`([\w./-]+\.(?:py|csv|toml|md)|[\w/]+/[\w/]+)`", text)) - {
        "lunarsci/spectra/readers/NAME.py"
    }
    assert len(named) > 20
    known = ["/" + path for path in here] + ["/" + path.name for path in ROOT.iterdir()]
    missing = [path for path in named if not any(one.endswith("/" + path) for one in known)]
    assert missing == []
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    assert set(re.findall(r"`make (\w+)`", text)) <= set(targets)
    told = subprocess.run(["make", "-C", str(ROOT), "help"], capture_output=True, text=True, check=True).stdout
    assert {"help", "demo", "test", "quick", "check", "docs", "clean"} <= {
        line.split()[0] for line in told.splitlines()
    }
