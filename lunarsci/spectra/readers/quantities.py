"""Columns of what is computed from reflectance: log(1/R), apparent absorbance and the function of Kubelka and Munk.

Absorbance of a reflectance spectrum is log10(1/R); F = (1 - R)^2 / (2 R) is Kubelka & Munk (1931), Z. tech. Phys. 12,
593. Both are the usual forms of near-infrared spectrometers; no library of formats converts them.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.readers.likely import LARGE_ERROR
from lunarsci.spectra.readers.table import PERCENT_SIGN, Column, SpectrumTable, name_tokens


@dataclass(frozen=True, slots=True)
class ColumnQuantity:
    """What a column holds: its name, how a name says so, and the reflectance of it."""

    name: str
    words: re.Pattern[str]
    reflectance: Callable[[FloatArray], FloatArray]


def of_decadic(values: FloatArray) -> FloatArray:
    """R = 10^-x. [-]"""
    return np.asarray(10.0**-values)


def of_natural(values: FloatArray) -> FloatArray:
    """R = e^-x. [-]"""
    return np.asarray(np.exp(-values))


def of_kubelka_munk(values: FloatArray) -> FloatArray:
    """R = 1 + F - (F^2 + 2 F)^(1/2), the root of F = (1 - R)^2 / (2 R) below 1; F >= 0. [-]"""
    return np.asarray(1.0 + values - np.sqrt(values**2 + 2.0 * values))


_R = r"\(?r(ef\w*\.?)?\)?"
QUANTITIES = (
    ColumnQuantity("log10(1/R)", re.compile(rf"(?<![a-z])log(10)?[(\[]?1/{_R}|-log(10)?{_R}(?![a-z])"), of_decadic),
    ColumnQuantity("ln(1/R)", re.compile(rf"(?<![a-z])ln[(\[]?1/{_R}|-ln{_R}(?![a-z])"), of_natural),
    ColumnQuantity("ln R", re.compile(rf"(?<![a-z-])ln{_R}$"), lambda values: of_natural(-values)),
    ColumnQuantity("log10 R", re.compile(rf"(?<![a-z-])log(10)?{_R}$"), lambda values: of_decadic(-values)),
    ColumnQuantity(
        "the function of Kubelka and Munk",
        re.compile(r"kubelka|^k[-/]?m$|(?<![a-z])k-m(?![a-z])|^f\(r\W*\w*\)|^k/s$|remissionfunction"),
        of_kubelka_munk,
    ),
    ColumnQuantity("absorbance, log10(1/R)", re.compile(r"absorbance|^abs\.?([(\[].*)?$"), of_decadic),
)
"""What is known of, the first that fits a name in lower case without blanks."""


@lru_cache(maxsize=4096)
def quantity_of(name: str) -> ColumnQuantity | None:
    """What a column holds by its name; None for a reflectance, as far as the name says."""
    plain = re.sub(r"[\s_]", "", unicodedata.normalize("NFKC", name).replace("−", "-").casefold())
    return next((one for one in QUANTITIES if one.words.search(plain)), None)


def as_reflectance(table: SpectrumTable) -> tuple[SpectrumTable, list[str]]:
    """A table whose `block`, and errors, are reflectances where columns hold something else; and what to say."""
    spectra, said, reflectances = list(table.spectra), dict[str, str](), table.reflectances
    for row, (column, sigma) in enumerate(table.spectra):
        if (quantity := quantity_of(column.name)) is None:
            continue
        values = reflectances[row].copy()
        with np.errstate(invalid="ignore", over="ignore"):
            reflectances[row] = quantity.reflectance(values)
            spectra[row] = _named(column), None if sigma is None else _error(sigma, values, quantity)
        said.setdefault(
            quantity.name,
            f"column {column.label} read as {quantity.name} and made reflectance; if it is one already, name it so",
        )
    return replace(table, spectra=tuple(spectra), block=reflectances), list(said.values())


def _named(column: Column) -> Column:
    """A column of reflectance in its place."""
    return replace(column, unit="fraction", unit_text=column.name)


def _error(sigma: Column, values: FloatArray, quantity: ColumnQuantity) -> Column:
    """Half the way between the reflectances one standard deviation to either side."""
    up, down = quantity.reflectance(values - sigma.values), quantity.reflectance(values + sigma.values)
    return replace(sigma, values=np.abs(up - down) / 2, unit="fraction")


def with_absolute_errors(table: SpectrumTable) -> tuple[SpectrumTable, list[str]]:
    """A table whose relative errors are made errors of their reflectances; and what to say where no unit is named."""
    spectra, said = list(table.spectra), list[str]()
    for row, (column, sigma) in enumerate(table.spectra):
        if sigma is None or not _is_relative(sigma.name, column.name):
            continue
        share, named = sigma.values, PERCENT_SIGN.search(sigma.name) is not None
        in_percent = named or bool(np.nanmedian(share) > LARGE_ERROR)
        if not named:
            unit = "percent" if in_percent else "shares of 1"
            said.append(f"column {sigma.label} read as relative errors in {unit}; name its unit to decide otherwise")
        absolute = np.abs(table.reflectances[row]) * (share / 100 if in_percent else share)
        spectra[row] = column, replace(sigma, name="", values=absolute, unit=column.unit)
    return replace(table, spectra=tuple(spectra), block=table.reflectances), said


def _is_relative(name: str, of: str) -> bool:
    """Whether the name of errors says that they are relative, apart from what they are the errors of."""
    own = Counter(name_tokens(name)) - Counter(name_tokens(of))
    return any(re.fullmatch(r"rel|relativ\w*|rel(err|sd|std|unc)\w*|rsd", word) for word in own)
