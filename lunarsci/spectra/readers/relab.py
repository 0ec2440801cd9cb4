"""RELAB spectra (`.asc`, `.tab`): the number of channels, then wavelength, reflectance and standard deviation."""

import re

from lunarsci import inputs
from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.readers.table import Column, SpectrumTable
from lunarsci.spectra.rows import Row, check_widths, number, numbers, quoted, split_lines

__all__ = ["looks_like_relab", "read_relab"]

_COUNT = re.compile(r"[0-9]+")


def looks_like_relab(text: str, *, named_so: bool) -> bool:
    """Whether the first line is a whole number alone, and the next has two or three numbers between blanks.

    The first line is enough for a file that is `named_so`.
    """
    lines = [line for _, line in split_lines(text[:2000])[0][:2]]
    if not lines or not _COUNT.fullmatch(lines[0]):
        return False
    fields = lines[1].split() if len(lines) > 1 else []
    return named_so or (len(fields) in (2, 3) and all(number(f) is not None for f in fields))


def read_relab(source: InputFile) -> SpectrumTable:
    """Read one RELAB spectrum; standard deviations that are all 0 mean that they are unknown.

    Raises DataError when the rows are not as many as the first line says, or are not two or three numbers each.
    """
    lines, comments = split_lines(inputs.text(source))
    rows = [Row(n, tuple(line.split())) for n, line in lines[1:]]
    if not lines or not _COUNT.fullmatch(lines[0][1]):
        first = quoted(lines[0][1]) if lines else "nothing"
        raise DataError(
            f"{source.name}: no RELAB file: it begins with {first}, not the number of channels; use --format text"
        )
    count = int(lines[0][1][:18])
    if count != len(rows) or not rows:
        raise DataError(
            f"{source.name}: line {lines[0][0]} announces {count} channels and {len(rows)} rows follow (truncated "
            "download?); fetch the file again"
        )
    width = check_widths(rows, source.name)
    if width not in (2, 3):
        raise DataError(f"{source.name}: {width} columns; RELAB has wavelength, reflectance and standard deviation")
    return _table(source, rows, width, [comment for _, comment in comments if comment])


def _table(source: InputFile, rows: list[Row], width: int, comments: list[str]) -> SpectrumTable:
    titles = ("wavelength", "reflectance", "standard deviation")[:width]
    wavelength, reflectance, *sigma = (
        Column(title, numbers(rows, k, repr(title), source.name), k + 1) for k, title in enumerate(titles)
    )
    places = tuple(f"line {row.line}" for row in rows)
    spectra = ((reflectance, sigma[0] if sigma else None),)
    return SpectrumTable(source, "relab", wavelength, spectra, places, {"comments": comments})
