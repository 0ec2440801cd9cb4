"""Tables: CSV as text and as numbers, refused where a row does not fit its header, and those of lunarsci.

pandas reads the cells; that rows have as many as the header it does not check: it pads short ones in silence.
"""

import codecs
import contextlib
import csv
import difflib
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, warn
from lunarsci.io.inputs import BEGINNING, InputFile, InputStream, csv_rows, open_input, read_input, text
from lunarsci.io.records import Codes, Records
from lunarsci.provenance import sha256
from lunarsci.units import columns_by_unit

if TYPE_CHECKING:
    import pandas as pd


MOST_CELLS = 50_000_000
"""Of a group of rows of Parquet, however small it is: 0.4 GB of numbers."""
PIECE_ROWS, LONGEST_LINE = 20_000, 1 << 26
"""Rows that are read at a time, and bytes of the longest line."""
DECIMAL_COMMA = re.compile(r"^(\s*[+-]?\d*),(\d+(?:[eE][+-]?\d+)?\s*)$")
UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
EXACT_POWER = 22
"""Up to this power of ten a float64 is exact."""
POWERS = np.array([float(f"1e{power}") for power in range(EXACT_POWER + 1)])
"""Of ten, up to that."""
PARQUET = b"PAR1"
"""How a file of Parquet begins."""
BLANK = ("nan", "na", "-", "")
_RARE = ('"', "#", "\r", "\v", "\f", "\x1c", "\x1d", "\x1e")
ALIKE = 0.72
"""Likeness of two names (difflib's ratio) from which one is taken for a slip of the pen of the other; assumed."""


def read_csv_table(source: InputFile | str | Path) -> "pd.DataFrame":
    """The cells of a table of CSV, or of Parquet, as text; lines that begin with # are left out, blanks around names
    are dropped.

    Where the header has semicolons and no comma these are between the cells, and a comma within a number is its point.

    Raises DataError for a file that cannot be read, rows of another length than the header, and equal column names.
    """
    file = source if isinstance(source, InputFile) else read_input(str(source))
    if _is_document(file.data):
        raise DataError(f"{file.name}: is JSON, no table; give the table itself, as -o DIR writes it")
    return _csv_cells(as_csv(file), dtype=str)


def _is_document(data: bytes) -> bool:
    """Whether a file is JSON by its first sign, as no table is."""
    return data[:64].lstrip().startswith(b"{")


def as_csv(file: InputFile) -> InputFile:
    """A table of Parquet as the CSV that it would be; any other file as it is."""
    if not file.data.startswith(PARQUET):
        return file
    with open_input(file) as stream:
        return InputFile(file.name, csv_bytes(parquet_tables(stream)))


def table_in(folder: Path, name: str) -> Path | None:
    """The file in a folder that has a table, in whichever of `TABLE_FORMS`; None where there is none.

    Raises DataError where there are two, one of which is of another run.
    """
    there = [path for form in TABLE_FORMS if (path := folder / f"{name}.{form}").is_file()]
    if len(there) > 1:
        raise DataError(f"{folder}: {' and '.join(path.name for path in there)} are both in it; remove the older one")
    return there[0] if there else None


def _csv_cells(file: InputFile, before: int = 0, *, dtype: type[str] | None) -> "pd.DataFrame":
    import pandas as pd

    content = text(file)
    separator = separator_of(content)
    decimal = "," if separator == ";" and "," in content else "."
    _check_widths(file.name, content, separator, before)
    try:
        table = pd.read_csv(
            io.StringIO(content),
            sep=separator,
            decimal=decimal,
            comment="#",
            skipinitialspace=True,
            dtype=dtype,
            index_col=False,
            low_memory=False,
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise DataError(f"{file.name}: not a CSV table ({' '.join(str(error).split())})") from error
    table.columns = table.columns.str.strip()
    if decimal == ",":
        words = table.select_dtypes(include=["object", "string"]).columns
        table[words] = table[words].apply(lambda cells: cells.str.replace(DECIMAL_COMMA, r"\1.\2", regex=True))
    return table


def separator_of(content: str) -> str:
    """What is between the names of the header: a comma, or semicolons."""
    for line in content[:BEGINNING].splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return ";" if ";" in line and "," not in line else ","
    return ","


def csv_tables(stream: InputStream, mended: Callable[[bytes, int], bytes]) -> "Iterator[pd.DataFrame]":
    """A CSV table in pieces, as `read_csv_table` reads it, but with numbers in columns that hold nothing else.

    `mended` is given the last line where it does not end, with its number, and what it returns is read in its place.
    """
    for file, before in line_pieces(stream, mended):
        table = _csv_cells(file, before, dtype=None)
        # A piece of a column may hold true and false alone: text among numbers is to be said of.
        for name in table.select_dtypes(include="bool").columns:
            table[name] = table[name].astype(str)
        yield table


def line_pieces(stream: InputStream, mended: Callable[[bytes, int], bytes]) -> Iterator[tuple[InputFile, int]]:
    """Whole lines, each time below the header; and how many lines before them are not there.

    The header are the first lines, up to one that is neither blank nor begins with #. Raises DataError for a line of
    more than `LONGEST_LINE` bytes.
    """
    header, rest, before = b"", b"", 0
    for piece in stream.pieces():
        rest += piece
        if len(rest) > LONGEST_LINE:
            raise DataError(f"{stream.name}: a line of {LONGEST_LINE >> 20} MB, or UTF-16; save it as UTF-8")
        if rest.startswith(UTF16) and not header:
            continue
        if not header:
            header = _header(rest)
            rest = rest[len(header) :]
        whole, end, left = rest.rpartition(b"\n")
        if header and whole.strip():
            yield InputFile(stream.name, header + whole + end), before
            before, rest = before + whole.count(b"\n") + 1, left
    if header and rest.strip() and not rest.endswith(b"\r"):
        rest = mended(rest, header.count(b"\n") + before + 1)
    if rest or not before:
        yield InputFile(stream.name, header + rest), before


def _header(start: bytes) -> bytes:
    at = 0
    while (end := start.find(b"\n", at)) >= 0:
        line, at = start[at:end].removeprefix(b"\xef\xbb\xbf").strip(), end + 1
        if line and not line.startswith(b"#"):
            return start[:at]
    return b""


def parquet_tables(stream: InputStream) -> "Iterator[pd.DataFrame]":
    """A Parquet file in pieces of rows, without what pandas notes beside them: it may be damaged by itself.

    Raises DataError for a file that cannot be read, and, before they are unpacked, for a group of rows with more cells
    than `MOST_CELLS`.
    """
    import pyarrow
    from pyarrow.parquet import ParquetFile

    for _ in stream.pieces():
        pass
    try:
        file = ParquetFile(stream.file, buffer_size=1 << 20)
        data = file.metadata
        most = max((data.row_group(k).num_rows for k in range(data.num_row_groups)), default=0) * data.num_columns
        for batch in file.iter_batches(PIECE_ROWS) if most <= MOST_CELLS else ():
            table: pd.DataFrame = pyarrow.Table.from_batches([batch]).replace_schema_metadata(None).to_pandas()
            yield table
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        reason = " ".join(str(error).split())[:120]
        raise DataError(f"{stream.name}: not a Parquet file that can be read ({reason})") from error
    finally:
        # All of it was hashed before.
        if stream.file.seekable():
            stream.file.seek(0, io.SEEK_END)
    if most > MOST_CELLS:
        raise DataError(
            f"{stream.name}: {most / 1e6:,.0f} million cells in a group of rows, and at most {MOST_CELLS / 1e6:.0f} "
            "million are read; write it in smaller groups"
        )


def csv_bytes(table: "pd.DataFrame | Iterable[pd.DataFrame]") -> bytes:
    """A table as CSV, nine significant digits; also in pieces of rows, which need not be there together."""
    import pandas as pd

    written = io.BytesIO()
    for number, piece in enumerate([table] if isinstance(table, pd.DataFrame) else table):
        columns = {str(name): _written(piece[name]) for name in piece}
        if not number:
            head = io.StringIO()
            csv.writer(head, lineterminator="\n").writerow(columns)
            written.write(head.getvalue().encode())
        written.writelines(Records(columns).csv_chunks())
    return written.getvalue()


def parquet_bytes(table: "pd.DataFrame | Iterable[pd.DataFrame]") -> bytes:
    """A table as Parquet, every digit of its numbers; also in pieces of rows with the same kinds of columns."""
    import pandas as pd
    import pyarrow
    from pyarrow.parquet import ParquetWriter

    written, schema = io.BytesIO(), None
    with contextlib.ExitStack() as opened:
        for piece in [table] if isinstance(table, pd.DataFrame) else table:
            rows = pyarrow.Table.from_pandas(piece, schema, preserve_index=False)
            if schema is None:
                schema = rows.schema
                writer = opened.enter_context(ParquetWriter(written, schema, compression="zstd"))
            writer.write_table(rows)
    return written.getvalue()


TABLE_FORMS: Mapping[str, "Callable[[pd.DataFrame | Iterable[pd.DataFrame]], bytes]"] = MappingProxyType(
    {"csv": csv_bytes, "parquet": parquet_bytes}
)
"""Forms of the tables in a folder, which end their files' names, and what writes them."""


def _written(column: "pd.Series") -> Any:
    """A column as records have it."""
    if column.dtype.kind in "iu":
        return column.to_numpy()
    if column.dtype.kind == "f":
        return nine_digits(column.to_numpy(np.float64))
    codes, values = column.factorize()
    return Codes(np.where(codes < 0, len(values), codes), [*map(str, values), ""])


def nine_digits(values: FloatArray) -> FloatArray:
    """The nearest numbers of nine significant digits, (n,)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        power = np.floor(np.log10(np.abs(values))) - 8.0
        places = np.nan_to_num(power, nan=0.0, posinf=0.0, neginf=0.0).astype(int)
        up, down = (POWERS[np.clip(sign * places, 0, EXACT_POWER)] for sign in (-1, 1))
        rounded = np.round(values * up / down) / up * down
    rounded = np.where(np.isfinite(rounded), rounded, values)
    for row in np.flatnonzero(np.isfinite(power) & (np.abs(power) > EXACT_POWER)):
        rounded[row] = float(f"{values[row]:.9g}")
    return rounded


def numbers_of(name: str, column: str, cells: "pd.Series") -> FloatArray:
    """The cells of a column as numbers, NaN where blank. (n,) Raises DataError for text, with its row."""
    import pandas as pd

    numbers = pd.to_numeric(cells, errors="coerce")
    odd = cells[numbers.isna() & cells.notna()]
    wrong = odd[~odd.astype(str).str.strip().str.lower().isin(BLANK)]
    if len(wrong):
        raise DataError(f"{name}, row {int(wrong.index[0]) + 1}, {column}: '{wrong.iloc[0]}' is no number")
    return numbers.to_numpy(float)


def in_units(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    """A table of text with the columns that are meant in place of those that name another unit: x_m for x_mm.

    Raises DataError for text among numbers.
    """
    for meant, (name, size) in columns_by_unit([*map(str, table.columns)]).items():
        if meant not in table:
            values = size * numbers_of(file, name, table[name])
            table = table.assign(**{name: ["" if np.isnan(one) else repr(float(one)) for one in values]})
            table = table.rename(columns={name: meant})
    return table


def check_columns(
    file: str,
    columns: Iterable[str],
    expected: Sequence[str],
    needed: Sequence[str] = (),
    written: Mapping[str, str] = MappingProxyType({}),
) -> list[str]:
    """Names of the columns that are not known; `written` are names in the file of those that were renamed.

    Raises DataError for one that is needed and missing, and for one that is nearly a known one, such as `sinkage_mm`:
    it would be left out without a word.
    """
    present = list(columns)
    unused = [name for name in present if name not in expected]
    if missing := next((name for name in needed if name not in present), None):
        guess = difflib.get_close_matches(missing, unused, n=1)
        there = ", ".join(written.get(name, name) for name in present)
        hint = f"is it '{guess[0]}'? rename it" if guess else f"there are: {there}"
        raise DataError(f"{file}: no column {missing}; {hint}")
    for name in unused:
        near = difflib.get_close_matches(name.lower(), expected, n=1, cutoff=ALIKE)
        if near and near[0] not in present:
            raise DataError(f"{file}: column '{name}' is unknown; if it is '{near[0]}', rename it and mind the unit")
    return unused


def without_repeats(file: str, table: "pd.DataFrame", keys: Sequence[str]) -> "pd.DataFrame":
    """Rows that are there twice count once, with a warning; DataError where rows of one key contradict each other."""
    once = table.drop_duplicates()
    if len(once) < len(table):
        text = f"{file}: {len(table) - len(once)} of {len(table)} rows are there twice; each counts once"
        warn(text)
    again = once.duplicated(list(keys))
    if again.any():
        row = once[again].iloc[0]
        which = ", ".join(f"{key} {row[key]}" for key in keys)
        raise DataError(f"{file}: two rows of {which} contradict each other; keep the right one")
    return once.reset_index(drop=True)


def _check_widths(name: str, content: str, separator: str, before: int = 0) -> None:
    """Every row must have as many fields as the header: pandas would shift or pad the others in silence.

    So many lines after the header are not there.
    """
    if _is_even(content, separator):
        return
    width = 0
    lines = csv_rows(name, content.splitlines(), delimiter=separator, skipinitialspace=True)
    for number, row in enumerate(lines, 1):
        if not row or row[0].lstrip().startswith("#"):
            continue
        if not width:
            _check_names(name, row)
        width = width or len(row)
        if len(row) != width:
            commas = separator == "," and len(row) > width
            hint = " A decimal comma needs ';' between all columns" if commas else ""
            text = f"{len(row)} fields, the header has {width}; is the file complete?"
            raise DataError(f"{name}, line {number + before}: {text}{hint}")


def _is_even(content: str, separator: str) -> bool:
    """Whether all lines after the header have as many separators, of a text without quotes, remarks and rare breaks."""
    start = _header(content[:BEGINNING].encode()).decode()
    body = content[len(start) :]
    names = start.rstrip("\n").rpartition("\n")[2].rstrip("\r").split(separator)
    plain = content.isascii() and len(names) == len({name.strip() for name in names})
    if not start or not plain or any(sign in body for sign in _RARE) or '"' in start:
        return False
    signs = np.frombuffer(body.encode("ascii"), np.uint8)
    ends = np.flatnonzero(signs == ord("\n"))
    if body and not body.endswith("\n"):
        ends = np.append(ends, len(signs))
    commas = np.searchsorted(np.flatnonzero(signs == ord(separator)), ends)
    return bool((np.diff(commas, prepend=0) == len(names) - 1).all()) and len(names) > 1


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
