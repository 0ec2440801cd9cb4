"""The small tables that come with lunarsci: their rows, and their hashes for the provenance."""

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType

from lunarsci.provenance import sha256

__all__ = ["table_hashes", "table_rows"]


@cache
def table_rows(name: str) -> tuple[Mapping[str, str], ...]:
    """Rows of a table in `spectra_data`, by column name; read once, not to be changed."""
    return tuple(MappingProxyType(row) for row in csv.DictReader(_bytes(name).decode("utf-8").splitlines()))


def table_hashes(*names: str) -> dict[str, str]:
    """Name to SHA-256 of tables in `spectra_data`."""
    return {name: sha256(_bytes(name)) for name in names}


def _bytes(name: str) -> bytes:
    return (files("lunarsci.spectra_data") / name).read_bytes()
