"""CSV tables as text and as numbers, refused where a row does not fit its header."""

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.inputs import InputFile, read_input, text

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["numbers_of", "read_csv_table"]

FloatArray = npt.NDArray[np.float64]
BLANK = ("nan", "na", "-", "")


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


def numbers_of(name: str, column: str, cells: "pd.Series") -> FloatArray:
    """The cells of a column as numbers, NaN where blank. (n,) Raises DataError for text, with its row."""
    import pandas as pd

    numbers = pd.to_numeric(cells, errors="coerce")
    wrong = numbers.isna() & cells.notna() & ~cells.astype(str).str.strip().str.lower().isin(BLANK)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"{name}, row {row + 1}, {column}: '{cells.iloc[row]}' is no number")
    return numbers.to_numpy(float)


def _check_widths(name: str, content: str) -> None:
    """Every row must have as many fields as the header: pandas would shift or pad the others in silence."""
    width = 0
    for number, row in enumerate(csv.reader(content.splitlines(), skipinitialspace=True), 1):
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
