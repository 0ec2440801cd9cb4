"""The small tables that come with lunarsci: their rows, and their hashes for the provenance."""

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType

from lunarsci.provenance import sha256

SPECTRA_DATA = "lunarsci.spectra_data"


@cache
def table_rows(name: str, package: str = SPECTRA_DATA) -> tuple[Mapping[str, str], ...]:
    """Rows of a table in a package, by column name; read once, not to be changed."""
    text = (files(package) / name).read_text("utf-8")
    return tuple(MappingProxyType(row) for row in csv.DictReader(text.splitlines()))


def table_hashes(*names: str, package: str = SPECTRA_DATA) -> dict[str, str]:
    """Name to SHA-256 of tables in a package."""
    return {name: sha256((files(package) / name).read_bytes()) for name in names}
