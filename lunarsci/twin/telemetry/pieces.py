"""Telemetry as tables of some thousand rows, read one after another: CSV, ECSV and Parquet."""

import io
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from lunarsci.errors import DataError
from lunarsci.inputs import InputFile, InputStream
from lunarsci.tables import csv_tables, line_pieces, parquet_tables

if TYPE_CHECKING:
    import pandas as pd

    from lunarsci.twin.telemetry.reading import Findings


def tables_of(stream: InputStream, findings: "Findings") -> "Iterator[pd.DataFrame]":
    """The rows of a table in pieces, by the ending of its file, numbered through. Raises DataError, also for no row."""

    def without_cut(cut: bytes, number: int) -> bytes:
        what = f"line {number} has no end ('{cut[-20:].decode(errors='replace')}'): the file may be cut there"
        findings.add("truncated", what, "the line is left out; end it with a new line if it is whole")
        return b""

    suffix, rows = Path(stream.name).suffix.lower(), 0
    tables: Iterator[pd.DataFrame]
    if suffix == ".parquet":
        tables = (_flat(stream.name, table) for table in parquet_tables(stream))
    elif suffix == ".ecsv":
        tables = (_read_ecsv(piece) for piece, _ in line_pieces(stream, lambda cut, _: cut))
    else:
        tables = csv_tables(stream, without_cut)
    for table in tables:
        yield table.set_axis(range(rows, rows + len(table)))
        rows += len(table)
    if not rows:
        raise DataError(f"{stream.name}: no rows; check how it was made or downloaded")


def _read_ecsv(source: InputFile) -> "pd.DataFrame":
    from astropy.table import Table

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = Table.read(io.BytesIO(source.data), format="ascii.ecsv")
            units = {name: str(table[name].unit) for name in table.colnames if table[name].unit is not None}
            frame = _flat(source.name, table.to_pandas())
    except Exception as error:
        raise DataError(f"{source.name}: not an ECSV table that can be read ({_line(error)})") from error
    for name, unit in units.items():
        _check_unit(source.name, name, unit)
    return frame


def _check_unit(file: str, name: str, unit: str) -> None:
    """A column must be in the unit that its name says."""
    from astropy import units as u

    ends = {"_m_s": "m/s", "_deg_s": "deg/s", "_m2": "m2", "_deg_sigma": "deg", "_deg": "deg", "_s": "s", "_m": "m"}
    wanted = next((text for end, text in ends.items() if name.endswith(end)), None)
    if wanted is not None and u.Unit(unit) != u.Unit(wanted):
        raise DataError(f"{file}: {name} is in {unit}, its name says {wanted}; convert it")


def _flat(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    import pandas as pd

    names = [str(name).strip() for name in table.columns]
    if twice := next((name for name, times in Counter(names).items() if times > 1), None):
        raise DataError(f"{file}: two columns are called '{twice}'; keep one of them")
    return table.set_axis(pd.Index(names), axis=1)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:120]
