"""Every row of every table, and every number of a rover, a camera or a soil, names its source or is called assumed."""

import csv
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "spectra_data"
NO_YEAR = ("Gazetteer of Planetary Nomenclature", "none: assumed", "measured for lunarsci", "spectra of CooperZZX")
"""Citations of things that carry no year."""
SAME_AS = re.compile(r"^as (\w+)")


def _load() -> ModuleType:
    path = ROOT / "docs/_extension/pages_of_sources.py"
    spec = importlib.util.spec_from_file_location("pages_of_sources", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PAGES = _load()


def lacking(source: str, *, assumed: bool = False) -> str:
    """What a source lacks: an author with a year, a DOI, or the word that it is assumed or measured; '' if nothing."""
    if not source.strip():
        return "there is no source"
    if assumed or PAGES.STATED.search(source) or SAME_AS.match(source) or source.startswith(NO_YEAR):
        return ""
    return f"'{source}' has no year, no DOI, and is not called assumed or measured"


@pytest.mark.parametrize(("source", "good"), [
    ("Wong (2008), Theory of Ground Vehicles", True), ("10.1016/j.asr.2008.07.006", True), ("width assumed", True),
    ("", False), ("a colleague", False), ("see there", False),
])  # fmt: skip
def test_what_counts_as_a_source(source: str, good: bool) -> None:
    assert (lacking(source) == "") is good


@pytest.mark.parametrize("kind", ["of_rovers", "of_soils", "of_published"])
def test_every_number_has_a_source(kind: str) -> None:
    stated = list(getattr(PAGES, kind)())
    assert len(stated) > 40 or kind == "of_published"
    wrong = [(row.file, row.name, why) for row in stated if (why := lacking(row.source, assumed=row.assumed))]
    assert wrong == []


def test_every_published_number_has_its_place_in_the_paper() -> None:
    with (ROOT / "lunarsci/reproduce/published.csv").open(newline="", encoding="utf-8") as file:
        places = [row["passage"] for row in csv.DictReader(file)]
    assert len(places) == 41
    assert [place for place in places if not re.match(r"Results|Discussion|Methods", place)] == []


def test_every_source_of_a_table_is_whole() -> None:
    entries = PAGES.of_tables()
    for name, entry in entries.items():
        assert lacking(f"{entry['citation']} {entry.get('doi', '')}") == "", name
        assert "doi" in entry or "url" in entry or "assumed" in entry["what"].lower() or not re.search(
            r"(?:199\d|20\d\d)\), (?!Mineralogy of asteroids)", entry["citation"]), f"{name}: give the DOI"  # fmt: skip
        assert re.fullmatch(r"10\.\d{4,9}/\S+", entry.get("doi", "10.1000/x")), name


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.csv")), ids=lambda path: path.name)
def test_every_row_of_a_table_leads_to_a_source(path: Path) -> None:
    """By its column of sources, or all rows by the one source of the table."""
    entries = PAGES.of_tables()
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = [name for name in rows[0] if name == "source" or name.endswith("_source")]
    own = {name for name, entry in entries.items() if entry["table"] == path.name}
    assert own
    for row in rows if own >= {row[name] for row in rows for name in columns if row[name]} else []:
        values = {name: row[name] for name in columns}
        assert not columns or values.get("source", "x"), row
        for place in ("position", "age"):
            assert row.get(f"{place}_source", "x"), row
        given = any(row.get(mineral) for mineral in ("olivine", "orthopyroxene", "bc1000_nm"))
        assert not given or row.get("composition_source", "x"), row
    used = {row[name] for row in rows for name in columns if row[name]}
    assert used <= own or path.name == "end_members.csv", used - own
    if path.name == "end_members.csv":
        assert used == {"relab", "usgs", "c-tape"} & used and len(own) == 1


def test_the_page_shows_every_source() -> None:
    page = PAGES.sources_text()
    for entry in PAGES.of_tables().values():
        assert entry["table"] in page
        assert entry.get("doi", "") in page
    for row in PAGES.of_soils():
        assert row.name in page
