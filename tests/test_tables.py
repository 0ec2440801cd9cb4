"""Tables that come with lunarsci: whole, unchangeable, hashed, and each with its source."""

import csv
import hashlib
import tomllib
from pathlib import Path

import pytest

from lunarsci.tables import table_hashes, table_rows

FOLDER = Path(__file__).parents[1] / "spectra_data"
NAMES = sorted(path.name for path in FOLDER.glob("*.csv"))


@pytest.mark.parametrize("name", NAMES)
def test_rows_and_hash_are_those_of_the_file(name: str) -> None:
    with (FOLDER / name).open(newline="", encoding="utf-8") as file:
        assert [dict(row) for row in table_rows(name)] == list(csv.DictReader(file))
    assert table_hashes(name) == {name: hashlib.sha256((FOLDER / name).read_bytes()).hexdigest()}


def test_every_table_has_a_source() -> None:
    sources = tomllib.loads((FOLDER / "sources.toml").read_text("utf-8")).values()
    assert set(NAMES) == {entry["table"] for entry in sources if "table" in entry}


def test_rows_cannot_be_changed_for_the_next_reader() -> None:
    with pytest.raises(TypeError):
        table_rows("mgm_bands.csv")[0]["center_nm"] = "0"  # type: ignore[index]
