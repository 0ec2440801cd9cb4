"""README and the pages of `docs` name what is there: options, scripts, files, targets, links, measured tables."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from lunarsci.cli import command_line, main

from lunarsci.io.tables import table_rows

ROOT = Path(__file__).parents[1]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    *(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
]
LINK = re.compile(r"\]\(([^)\s]+)\)")
SCHEMES = ("http://", "https://", "mailto:")
COMMAND_PAGES = ROOT / "docs/reference/commands"
NO_PROSE = re.compile(r"^ *(`{3,}|:{3,}|\$\$).*?\1[ .,]*$", re.DOTALL | re.MULTILINE)
"""Blocks of code, directives and equations."""
BLOCK, LONG = "(block)", 90
"""What stands for such a block; characters from which on a sentence is not to be said twice."""


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def paragraphs(page: Path) -> list[str]:
    """Headings, tables, lists and paragraphs in their order; a block of code or an equation is one word."""
    text = NO_PROSE.sub(f"\n{BLOCK}\n", page.read_text("utf-8"))
    return [part.strip() for part in re.split(r"\n\s*\n", text) if part.strip()]


def test_every_paragraph_is_whole() -> None:
    """It begins as a sentence does and has an end; a colon is followed by what it announces."""
    for page, parts in ((page, paragraphs(page)) for page in PAGES):
        for part, after in zip(parts, [*parts[1:], "# "], strict=True):
            assert not part[0].islower() or part.startswith("lunarsci "), (page, part)
            assert not part.endswith((",", ";")), (page, part)
            assert not part.endswith(":") or re.match(r"[(|\-*`!<\[]|\d\.", after), (page, part, after)
            assert part.startswith(("#", "- ", "1. ")) or re.search(r"[.:?!)|>`*\"\]]$", part), (page, part)


def test_no_sentence_stands_in_two_pages() -> None:
    """What is said twice is changed once; the other place links to it."""
    pages: dict[str, str] = {}
    for page in PAGES:
        for part in paragraphs(page):
            for sentence in re.split(r"(?<=[.:;?]) ", " ".join(part.split())) if part[0] not in "#|" else ():
                if len(sentence) >= LONG and sentence.count(" ") > 8:
                    assert pages.setdefault(sentence, name_of(page)) == name_of(page), sentence


SENTENCE = re.compile(r"(?<=[.?!])[)*]* (?=[A-Z`*\[(\d$])")
LONGEST = 50
"""Words of a sentence; links, equations and tables are not counted."""


def test_no_sentence_is_too_long() -> None:
    for page in PAGES:
        prose = [part for part in paragraphs(page) if part[0] not in "#|"]
        items = [item for part in prose for item in re.split(r"\n *(?:-|\d+\.) ", part)]
        plain = [re.sub(r"\]\([^)]*\)|\$[^$]*\$", "] x", " ".join(item.split())) for item in items]
        assert [one for item in plain for one in SENTENCE.split(item) if len(one.split()) > LONGEST] == [], page


PRIVATE = re.compile(r"(?<![`\w])(suites?|vouch\w*|lopsided|stranger|hangs? together|of the norm|filed by)\b")
"""Words of our own for what the field has a word for: `docs/project/style.md`."""


def test_pages_use_the_words_of_the_field() -> None:
    for page in PAGES:
        assert page.name == "style.md" or PRIVATE.findall(page.read_text("utf-8")) == [], page


def test_tutorials_name_the_extra_of_a_page() -> None:
    pages = [page.read_text("utf-8") for page in (ROOT / "docs/tutorials").glob("*.md")]
    assert [page[:40] for page in pages if "lunarsci report" in page and "lunarsci[report]" not in page] == []


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
    assert PRIVATE.findall(told) == []
    others = {"--repo", "--create-namespace", "--generate-name", "--scheduler-file", "--nworkers", "--nthreads"}
    others |= {"--extra-index-url", "--strict", "--write", "--why", "--install-completion", "--show-completion"}
    others |= {"--count", "--only", "--nearest-only", "--small", "--seed", "--first", "--cut", "--halves", "--soils"}
    others |= {"--training", "--spoiled", "--rate", "--seeds"}
    for page in PAGES:
        for option in set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", page.read_text("utf-8"))) - others:
            assert option in told, (name_of(page), option)


def test_every_command_has_its_place_in_the_reference(known: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs/_extension"))
    import pages_of_commands

    placed = {page.stem: pages_of_commands.commands_of_page(page.stem) for page in COMMAND_PAGES.glob("*.md")}
    assert [page for page, commands in placed.items() if not commands] == []
    assert sorted(command for commands in placed.values() for command in commands) == sorted(known)
    for name in ("pages_of_commands", "pages_of_code"):
        sys.modules.pop(name, None)


def test_links_lead_to_files() -> None:
    """Links within the project; those within the built documentation Sphinx checks."""
    made = ("reference/sources.md", "reference/json.md")
    for page in PAGES:
        links = [link for link in LINK.findall(page.read_text("utf-8")) if not link.startswith((*SCHEMES, "#", "doi:"))]
        missing = [link for link in links if not (page.parent / link.partition("#")[0]).exists()]
        assert [link for link in missing if not link.endswith(made)] == [], page


def test_scripts_that_pages_run_exist() -> None:
    for page in PAGES:
        named = re.findall(r"python ((?:tests|spectra_data)/[\w/]+\.py)", page.read_text("utf-8"))
        assert [script for script in named if not (ROOT / script).is_file()] == [], page


def test_what_shares_are_worth_is_that_of_the_table() -> None:
    """The page has the rows of `share_validation.csv`, which `make_share_calibration.py` measured."""
    text = (ROOT / "docs/validation/rock.md").read_text("utf-8")
    shown = [line.strip("| ").split(" | ") for line in text.splitlines()]
    ways = {"all": "all four", "named": "named", "together": "named, together"}
    numbers = list(table_rows("share_validation.csv")[0])[7:]
    told = 0
    for row in (row for row in table_rows("share_validation.csv") if row["way"] in ways):
        minerals = ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase")
        rms = " / ".join(f"{100 * float(row[f'rms_{name}']):.0f}" for name in minerals)
        told += [ways[row["way"]], row["spectra"], row["count"], rms, *(row[name] for name in numbers)] in shown
    assert told == 9, "each kind of spectra with all minerals and with those named, and mixtures taken together"


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_files_and_targets_that_documents_name_exist(name: str) -> None:
    text = (ROOT / name).read_text("utf-8")
    here = [path.relative_to(ROOT).as_posix() for top in ("lunarsci", "cli", "spectra_data", "tests", "docs") 
            for path in (ROOT / top).rglob("*")]  # fmt: skip
    named = set(re.findall(r"`([\w./-]+\.(?:py|csv|toml|md)|[\w/]+/[\w/]+)`", text))
    named = {path for path in named if "NAME" not in path}
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
