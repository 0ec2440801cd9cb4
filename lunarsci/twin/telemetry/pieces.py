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
from lunarsci.twin.telemetry.columns import UNIT, UNITS
from lunarsci.twin.telemetry.ros_columns import in_own_words

if TYPE_CHECKING:
    import pandas as pd

    from lunarsci.twin.telemetry.reading import Findings


SPELLED = {"deg_s": "deg/s", "rpm": "cycle/min", "turns": "cycle", "m2": "m2", "cm2": "cm2", "mm2": "mm2"}
"""Units that astropy spells otherwise than names of columns do."""


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
    for table in (in_own_words(stream.name, one) for one in tables):
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
    return frame.rename(columns={name: _in_unit(source.name, name, unit) for name, unit in units.items()})


def _in_unit(file: str, name: str, unit: str) -> str:
    """The name of a column that ends in the unit the file says, where that is another one than its name has."""
    from astropy import units as u

    match, said = UNIT.search(name), u.Unit(unit)
    if match is None:
        return name
    for own, others in UNITS.items():
        for end in (own, *others):
            if said == u.Unit(SPELLED.get(end, end.replace("_", "/"))):
                return f"{name[: match.start()]}_{end}{name[match.end() :]}"
    raise DataError(f"{file}: {name} is in {unit}; give it in {' or '.join(UNITS)}")


def _flat(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    import pandas as pd

    names = [str(name).strip() for name in table.columns]
    if twice := next((name for name, times in Counter(names).items() if times > 1), None):
        raise DataError(f"{file}: two columns are called '{twice}'; keep one of them")
    return table.set_axis(pd.Index(names), axis=1)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:120]
