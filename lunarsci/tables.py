"""Tables: CSV as text and as numbers, refused where a row does not fit its header, and those of lunarsci."""

import csv
import difflib
import io
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile, csv_rows, read_input, text
from lunarsci.printable import cell
from lunarsci.provenance import sha256

if TYPE_CHECKING:
    import pandas as pd


MOST_CELLS = 250_000_000
"""Of a Parquet file, however small it is: 2 GB of numbers."""
BLANK = ("nan", "na", "-", "")
ALIKE = 0.72
"""Likeness of two names (difflib's ratio) from which one is taken for a slip of the pen of the other; assumed."""


def read_csv_table(source: InputFile | str | Path) -> "pd.DataFrame":
    """The cells of a CSV table as text; lines that begin with # are left out, blanks around names are dropped.

    Raises DataError for a file that cannot be read, rows of another length than the header, and equal column names.
    """
    import pandas as pd

    file = source if isinstance(source, InputFile) else read_input(str(source))
    content = text(file)
    _check_widths(file.name, content)
    try:
        table = pd.read_csv(io.StringIO(content), comment="#", skipinitialspace=True, dtype=str, index_col=False)
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise DataError(f"{file.name}: not a CSV table ({' '.join(str(error).split())})") from error
    table.columns = table.columns.str.strip()
    return table


def read_parquet_table(source: InputFile) -> "pd.DataFrame":
    """The columns of a Parquet file, without what pandas notes beside them: it may be damaged by itself.

    Raises DataError without pyarrow, for a file that cannot be read, and, before they are unpacked, for more rows than
    `MOST_ROWS` and more cells than `MOST_CELLS`.
    """
    try:
        import pyarrow
        from pyarrow.parquet import ParquetFile
    except ImportError as error:
        raise DataError(f"{source.name}: Parquet needs pyarrow; pip install 'lunarsci[parquet]'") from error
    try:
        file = ParquetFile(io.BytesIO(source.data))
        check_rows(source.name, file.metadata.num_rows)
        cells = file.metadata.num_rows * file.metadata.num_columns
        if cells <= MOST_CELLS:
            table: pd.DataFrame = file.read().replace_schema_metadata(None).to_pandas()
            return table
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        reason = " ".join(str(error).split())[:120]
        raise DataError(f"{source.name}: not a Parquet file that can be read ({reason})") from error
    raise DataError(
        f"{source.name}: {cells / 1e6:,.0f} million cells, and at most {MOST_CELLS / 1e6:.0f} million are read; cut "
        "out the drive, or leave out columns"
    )


def csv_bytes(table: "pd.DataFrame") -> bytes:
    """A table as CSV, nine significant digits."""
    words = table.select_dtypes(include=["object", "string"]).columns
    table = table.assign(**{name: table[name].map(_word) for name in words})
    text: str = table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return text.encode()


def _word(value: object) -> object:
    return cell(value) if isinstance(value, str) else value


MOST_ROWS = 500_000
"""Of telemetry; more are refused: 200,000 rows took 0.75 GB, in `tests/benchmarks/load.py`."""


def check_rows(file: str, rows: int) -> None:
    """Raises DataError for more rows than there is to be memory for."""
    if rows > MOST_ROWS:
        remedy = "give each drive in a file of its own, or take fewer rows a second"
        raise DataError(f"{file}: {rows:,} rows, and at most {MOST_ROWS:,} are read; {remedy}")


def numbers_of(name: str, column: str, cells: "pd.Series") -> FloatArray:
    """The cells of a column as numbers, NaN where blank. (n,) Raises DataError for text, with its row."""
    import pandas as pd

    numbers = pd.to_numeric(cells, errors="coerce")
    wrong = numbers.isna() & cells.notna() & ~cells.astype(str).str.strip().str.lower().isin(BLANK)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"{name}, row {row + 1}, {column}: '{cells.iloc[row]}' is no number")
    return numbers.to_numpy(float)


def check_columns(file: str, columns: Iterable[str], known: Sequence[str], needed: Sequence[str] = ()) -> list[str]:
    """Names of the columns that are not known.

    Raises DataError for one that is needed and missing, and for one that is nearly a known one, such as `sinkage_mm`:
    it would be left out without a word.
    """
    present = list(columns)
    unused = [name for name in present if name not in known]
    if missing := next((name for name in needed if name not in present), None):
        guess = difflib.get_close_matches(missing, unused, n=1)
        hint = f"is it '{guess[0]}'? rename it" if guess else f"there are: {', '.join(present)}"
        raise DataError(f"{file}: no column {missing}; {hint}")
    for name in unused:
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=ALIKE)
        if near and near[0] not in present:
            raise DataError(f"{file}: column '{name}' is unknown; if it is '{near[0]}', rename it and mind the unit")
    return unused


def without_repeats(file: str, table: "pd.DataFrame", keys: Sequence[str]) -> "pd.DataFrame":
    """Rows that are there twice count once, with a warning; DataError where rows of one key contradict each other."""
    kept = table.drop_duplicates()
    if len(kept) < len(table):
        text = f"{file}: {len(table) - len(kept)} of {len(table)} rows are there twice; each counts once"
        warnings.warn(text, LunarSciWarning, stacklevel=3)
    again = kept.duplicated(list(keys))
    if again.any():
        row = kept[again].iloc[0]
        said = ", ".join(f"{key} {row[key]}" for key in keys)
        raise DataError(f"{file}: two rows of {said} contradict each other; keep the right one")
    return kept.reset_index(drop=True)


def _check_widths(name: str, content: str) -> None:
    """Every row must have as many fields as the header: pandas would shift or pad the others in silence."""
    width = 0
    for number, row in enumerate(csv_rows(name, content.splitlines(), skipinitialspace=True), 1):
        if not row or row[0].lstrip().startswith("#"):
            continue
        if not width:
            _check_names(name, row)
        width = width or len(row)
        if len(row) != width:
            raise DataError(f"{name}, line {number}: {len(row)} fields, the header has {width}; is the file complete?")


def _check_names(name: str, header: list[str]) -> None:
    names = [column.strip() for column in header]
    if twice := next((column for column in names if names.count(column) > 1), None):
        raise DataError(f"{name}: two columns are called '{twice}'; keep one of them")


SPECTRA_DATA = "lunarsci.spectra_data"


@cache
def table_rows(name: str, package: str = SPECTRA_DATA) -> tuple[Mapping[str, str], ...]:
    """Rows of a table in a package, by column name; read once, not to be changed."""
    text = (files(package) / name).read_text("utf-8")
    return tuple(MappingProxyType(row) for row in csv.DictReader(text.splitlines()))


def table_hashes(*names: str, package: str = SPECTRA_DATA) -> dict[str, str]:
    """Name to SHA-256 of tables in a package."""
    return {name: sha256((files(package) / name).read_bytes()) for name in names}
