"""Tables that say something of spectra by their ids."""

import csv
import io

from lunarsci import inputs
from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.readers.rows import separator_of, split_lines
from lunarsci.spectra.readers.table import quoted

__all__ = ["rows_by_id"]


def rows_by_id(source: InputFile) -> dict[str, tuple[int, dict[str, str]]]:
    """Line number and cells, by column name in lower case, of each `id`.

    Raises DataError for a table without ids or rows, a row of another length, and an id that is empty or comes twice.
    """
    rows: dict[str, tuple[int, dict[str, str]]] = {}
    for line, row in _rows(source):
        id = row["id"]
        if not id:
            raise DataError(f"{source.name}: line {line} has no id; complete it or delete the line")
        if id in rows:
            raise DataError(f"{source.name}: line {line}: {quoted(id)} comes twice; keep one")
        rows[id] = line, row
    return rows


def _rows(source: InputFile) -> list[tuple[int, dict[str, str]]]:
    lines = split_lines(inputs.text(source))[0]
    separator = separator_of(lines)
    reader = csv.reader(io.StringIO("\n".join(line for _, line in lines)), delimiter=separator, strict=True)
    try:
        header, *body = [[cell.strip() for cell in row] for row in reader]
    except csv.Error as error:
        raise DataError(f"{source.name}: cannot be split into cells ({error}); check its quotes") from error
    names = [name.casefold() for name in header]
    if "id" not in names:
        raise DataError(f"{source.name}: has no column 'id', only {', '.join(map(quoted, header[:5]))}; name it so")
    if not body:
        raise DataError(f"{source.name}: holds a header and no rows; check how it was made")
    for (line, _), row in zip(lines[1:], body, strict=False):
        if len(row) != len(names):
            raise DataError(f"{source.name}: line {line} has {len(row)} cells, the header {len(names)}; correct it")
    return [(line, dict(zip(names, row, strict=True))) for (line, _), row in zip(lines[1:], body, strict=False)]
