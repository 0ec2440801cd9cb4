"""Spectra in forms made for exchange: JCAMP-DX, JSON of columns or rows, VOTable, and the tables of the AAS.

JCAMP-DX: McDonald & Wilks (1988), Appl. Spectrosc. 42, 151, 10.1366/0003702884428734; the package `jcamp` reads it, but
neither counts points nor compares the check values. VOTable: Ochsenbein et al. (2019),
10.5479/ADS/bib/2019ivoa.spec.1021O. Tables: https://journals.aas.org/mrt-overview.
"""

import io
import re
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io import inputs
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.arrangements import on_one_grid
from lunarsci.spectra.readers.astropy_tables import one_line, spectrum_table
from lunarsci.spectra.readers.columns import assign_roles
from lunarsci.spectra.readers.table import Column, SpectrumTable, only_percent
from lunarsci.spectra.rows import quoted

_RECORD = re.compile(r"^##\s*([^=]*?)\s*=\s*(.*)$")
_FORM = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[Ee][+-]?\d+)?|[@A-Ia-i%J-Rj-rS-Zs]\d*|\?")
_SQUEEZED, _DIFFERENCE, _DUPLICATE = "@ABCDEFGHIabcdefghi", "%JKLMNOPQRjklmnopqr", "STUVWXYZs"
"""Letters for the first digit 0 to 9, then -1 to -9; of duplicates 1 to 9."""
MOST_POINTS = 10_000_000
"""Of a spectrum; assumed."""
_TABULAR = ("XYDATA", "XYPOINTS")
LIKE_JCAMP, LIKE_MRT = re.compile(r"##\s*(TITLE|JCAMP)", re.IGNORECASE), "Byte-by-byte Description of file"


def looks_like(text: str) -> str | None:
    """Which of these a text is by its beginning: 'jcamp', 'json', 'votable' or 'mrt', else None."""
    if LIKE_JCAMP.match(text):
        return "jcamp"
    if text[:1] in "{[" and text:
        return "json"
    if text.startswith("<") and re.search(r"<(\w+:)?VOTABLE\b", text[:2000]):
        return "votable"
    return "mrt" if LIKE_MRT in text[:20_000] else None


def read_jcamp(source: InputFile) -> SpectrumTable:
    """Read each block with `XYDATA` or `XYPOINTS`. Raises DataError for one with other points than it announces."""
    groups, keys = list[list[Column]](), dict[str, str]()
    for block in _blocks(inputs.text(source)):
        keys |= {key: value.split("\n")[0] for key, value in block.items() if key not in _TABULAR}
        if any(one in block for one in _TABULAR):
            try:
                groups.append(_spectrum(block, source.name, len(groups)))
            except DataError:
                raise
            except (ValueError, OverflowError) as error:
                raise DataError(f"{source.name}: broken JCAMP-DX ({str(error)[:80]}); fetch it again") from error
    if not groups:
        raise DataError(f"{source.name}: JCAMP-DX without XYDATA or XYPOINTS; export the spectrum as one of them")
    if len(groups) == 1:
        groups[0][1] = Column(keys.get("YUNITS", ""), groups[0][1].values, 2)
    return on_one_grid(groups, source, {"keys": keys}, f"{len(groups)} spectra of JCAMP-DX", "jcamp")


def _blocks(text: str) -> Iterator[dict[str, str]]:
    block, key = dict[str, str](), ""
    for line in text.splitlines():
        line = line.split("$$")[0].rstrip()
        if found := _RECORD.match(line):
            key = re.sub(r"[\s/_-]", "", found[1]).upper()
            if key == "TITLE":
                yield block
                block = {}
            block[key] = found[2]
        elif key:
            block[key] += f"\n{line}"
    yield block


def _spectrum(block: dict[str, str], file: str, before: int) -> list[Column]:
    """Wavelengths and ordinates of a block."""
    factor = [_real(block, key, file, 1.0) for key in ("XFACTOR", "YFACTOR")]
    title = f"spectrum of {quoted(block.get('TITLE', str(before + 1)))}"
    kind = next(one for one in _TABULAR if one in block)
    form, _, body = block[kind].partition("\n")
    if "++" in form:
        y = _ordinates(body, f"{file}: {title}") * factor[1]
        x = np.linspace(_real(block, "FIRSTX", file), _real(block, "LASTX", file), y.size)
    else:
        pairs = np.array([float(one) for one in re.findall(r"[+-]?[\d.]+(?:[Ee][+-]?\d+)?", body)])
        x, y = pairs[: pairs.size // 2 * 2].reshape(-1, 2).T * np.array(factor)[:, None]
    announced = int(_real(block, "NPOINTS", file, y.size))
    if announced != y.size:
        raise DataError(f"{file}: {title} has {y.size} points, NPOINTS says {announced} (truncated?); fetch it again")
    unit = block.get("YUNITS", "")
    name = f"{block.get('TITLE', '')} [%]" if only_percent(unit) else f"{block.get('TITLE', '')} {unit}"
    return [Column(block.get("XUNITS", ""), x, 1), Column(name.strip(), y, 2 + before)]


def _real(block: dict[str, str], key: str, file: str, other: float | None = None) -> float:
    try:
        return float(block[key]) if key in block or other is None else other
    except (KeyError, ValueError):
        raise DataError(f"{file}: JCAMP-DX without a number for {key}; export the spectrum again") from None


def _ordinates(body: str, what: str) -> FloatArray:
    """Numbers of lines of (X++(Y..Y)), plain or squeezed; a line after differences begins with a check of the last."""
    values, differences = list[float](), False
    for line in filter(str.strip, body.splitlines()):
        forms = _FORM.findall(line)[1:]
        if differences and forms:
            check = [*_number(forms.pop(0))]
            if check != values[-1:]:
                raise DataError(f"{what}: the check of a line is {check[0]:g}, not {values[-1]:g}; fetch it again")
        step, differences = 0.0, False
        for form in forms:
            if form[0] in _DUPLICATE:
                times = int(f"{_DUPLICATE.index(form[0]) + 1}{form[1:]}") - 1
                if len(values) + times > MOST_POINTS:
                    raise DataError(f"{what}: more than {MOST_POINTS} points; fetch it again")
                values += [values[-1] + step * (k + 1) for k in range(times)] if values else []
            elif form[0] in _DIFFERENCE:
                step, differences = _digits(form, _DIFFERENCE), True
                values.append((values or [0.0])[-1] + step)
            else:
                step, differences = 0.0, False
                values += _number(form)
    return np.array(values)


def _number(form: str) -> Iterator[float]:
    yield np.nan if form == "?" else _digits(form, _SQUEEZED) if form[0] in _SQUEEZED else float(form)


def _digits(form: str, letters: str) -> float:
    place = letters.index(form[0])
    return float(f"{place}{form[1:]}") if place < 10 else -float(f"{place - 9}{form[1:]}")


def read_json(source: InputFile) -> SpectrumTable:
    """Read lists by name, or a list of rows with names, as pandas writes them. Raises DataError for any other JSON."""
    try:
        found = json_document(inputs.text(source))
    except ValueError as error:
        raise DataError(f"{source.name}: broken JSON ({str(error)[:80]}); fetch it again") from error
    if isinstance(found, list) and found and all(isinstance(row, dict) for row in found):
        found = {name: [row.get(name) for row in found] for name in found[0]}
    lists = dict[str, list[Any]]()
    for name, values in found.items() if isinstance(found, dict) else ():
        own = list(values.values()) if isinstance(values, dict) else values
        if isinstance(own, list) and own and all(map(_is_number, own)):
            lists[str(name)] = own
    lists = {name: one for name, one in lists.items() if len(one) == max(map(len, lists.values()))}
    if len(lists) < 2:
        raise DataError(f"{source.name}: is JSON without two lists of numbers; save the spectra as CSV or ECSV")
    roles = assign_roles([*lists], source)

    def column(k: int) -> Column:
        name = [*lists][k]
        return Column(name, np.array([np.nan if one is None else one for one in lists[name]], float), k + 1)

    places = tuple(f"value {k + 1}" for k in range(len(next(iter(lists.values())))))
    spectra = tuple((column(r), None if s is None else column(s)) for r, s in roles.spectra)
    return SpectrumTable(source, "json", column(roles.wavelength), spectra, places)


def _is_number(cell: Any) -> bool:
    """Whether a value of JSON is a number that a float has, or none."""
    return cell is None or (type(cell) in (int, float) and abs(cell) < 1e308)


def read_with_astropy(source: InputFile, format: str) -> SpectrumTable:
    """Read a VOTable, or a machine-readable table of the AAS. Raises DataError where astropy cannot."""
    from astropy.table import Table

    given: Any = io.BytesIO(source.data) if format == "votable" else inputs.text(source)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = Table.read(given, format="votable" if format == "votable" else "ascii.mrt")
    # astropy raises a dozen kinds of errors for a broken file, and documents none of them.
    except Exception as error:
        raise DataError(f"{source.name}: broken {format} ({one_line(error)}); fetch the file again") from error
    if format == "mrt":
        for name in [name for name in table.colnames if name.startswith("e_") and name[2:] in table.colnames]:
            table.rename_column(name, f"{name[2:]}_sigma")
    return spectrum_table(table, source, format)
