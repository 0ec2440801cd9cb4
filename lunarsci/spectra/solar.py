"""Solar spectral irradiance at 1 AU: the two standards that come with lunarsci, a user's table, channel averages."""

import csv
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci import inputs
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.inputs import InputFile
from lunarsci.provenance import sha256
from lunarsci.spectra.readers.columns import is_wavelength
from lunarsci.spectra.readers.rows import (
    Row,
    check_widths,
    is_missing,
    number,
    numbers,
    separator_of,
    split_fields,
    split_lines,
)
from lunarsci.spectra.readers.table import quoted
from lunarsci.spectra.readers.units import length_unit, name_tokens, wavelength_unit_in
from lunarsci.spectra.spectrum import FloatArray

__all__ = [
    "COVERED_NM",
    "SOLAR_SPECTRA",
    "SolarSpectrum",
    "in_band_irradiance",
    "read_solar_spectrum",
    "solar_spectrum",
    "table_hash",
]

SOLAR_SPECTRA = {
    "g173": "ASTM G173-03, extraterrestrial (Gueymard 2004, Solar Energy 76, 423, doi 10.1016/j.solener.2003.08.039)",
    "e490": "ASTM E490-00a, air mass zero (doi 10.1520/E0490-00AR06)",
}
COVERED_NM = (430.0, 2430.0)
"""What a table must cover for the VNIS channels, 450-2395 nm and their responses. [nm]"""

_INTEGRAL_W_M2 = 1157.0  # of ASTM G173 over COVERED_NM; ASTM E490 gives 1159
_REFUSED_OFF = 0.2
_REMARKED_OFF = 0.03
_HALF_WIDTH_FWHM = 3.0
_FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
_NM = {"nm": 1.0, "um": 1000.0}
_IRRADIANCE = {"W m-2 nm-1": 1.0, "W m-2 um-1": 1e-3}
_IRRADIANCE_WORDS = {"irradiance", "extraterrestrial", "etr", "e0", "am0", "ssi", "flux"}
_OTHER_WORDS = {"sigma", "std", "stdev", "error", "err", "unc", "uncertainty", "fwhm", "bandwidth", "flag", "quality"}


@dataclass(frozen=True, slots=True, eq=False)
class SolarSpectrum:
    """Spectral irradiance of the Sun at 1 AU, linear between its samples.

    Attributes
    ----------
    name : `g173`, `e490`, or the stem of the user's file.
    wavelength_nm : shape (n,), n at least 2, finite, above 0, strictly ascending. [nm]
    irradiance : shape (n,), finite, above 0. [W m-2 nm-1]
    source : what to cite, or the user's file.

    Raises
    ------
    DataError when a rule above is broken; the message begins with the name.
    """

    name: str
    wavelength_nm: FloatArray
    irradiance: FloatArray
    source: str

    def __post_init__(self) -> None:
        wavelength = np.array(self.wavelength_nm, dtype=float)
        irradiance = np.array(self.irradiance, dtype=float)
        if wavelength.ndim != 1 or wavelength.size < 2 or irradiance.shape != wavelength.shape:
            raise DataError(f"{self.name}: a solar spectrum needs two or more wavelengths with one irradiance each")
        for what, values in (("a wavelength", wavelength), ("an irradiance", irradiance)):
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise DataError(f"{self.name}: {what} is missing or not above 0; correct or delete that row")
        if not (np.diff(wavelength) > 0).all():
            raise DataError(f"{self.name}: wavelengths are not strictly ascending; sort them and keep one row each")
        for attribute, values in (("wavelength_nm", wavelength), ("irradiance", irradiance)):
            values.setflags(write=False)
            object.__setattr__(self, attribute, values)


class _Table(NamedTuple):
    """Two columns of a file as they stand: the units it states, or None, and where each row is."""

    wavelength: FloatArray
    irradiance: FloatArray
    length: str | None
    per: str | None
    places: Sequence[str]


@cache
def solar_spectrum(name: str) -> SolarSpectrum:
    """A standard at its native sampling, 400-2600 nm: `g173` (ASTM G173-03) or `e490` (ASTM E490-00a).

    They differ by 0.6 % from channel to channel and by 0.24 % in the mean. `e490` is made of 1 and 2 nm averages;
    `g173` has 1 nm samples up to 1700 nm and 5 nm ones above 1705 nm. Raises ParameterError for any other name.
    """
    rows = csv.DictReader(_table_bytes(name).decode("utf-8").splitlines())
    columns = [(float(row["wavelength_nm"]), float(row["irradiance_w_m-2_nm-1"])) for row in rows]
    wavelength, irradiance = np.array(columns).T
    return SolarSpectrum(name, wavelength, irradiance, SOLAR_SPECTRA[name])


def table_hash(name: str) -> dict[str, str]:
    """Name and SHA-256 of the table of a standard, for the provenance. Raises ParameterError for an unknown name."""
    return {_table_name(name): sha256(_table_bytes(name))}


def _table_name(name: str) -> str:
    if name not in SOLAR_SPECTRA:
        raise ParameterError(f"solar spectrum '{name}' is unknown; choose one of {', '.join(SOLAR_SPECTRA)}")
    return f"solar_{name}.csv"


def _table_bytes(name: str) -> bytes:
    return (files("lunarsci.spectra_data") / _table_name(name)).read_bytes()


def in_band_irradiance(solar: SolarSpectrum, center_nm: npt.ArrayLike, fwhm_nm: npt.ArrayLike) -> FloatArray:
    """Irradiance as a channel sees it: the mean of E over the channel's response g. [W m-2 nm-1]

        E_band = int E g dl / int g dl,  g = exp(-4 ln 2 (l - center)^2 / fwhm^2),  |l - center| <= 3 fwhm

    The Gaussian shape is assumed: only the width is published for VNIS. The integral over the piecewise linear E is in
    closed form. The table's own resolution is not taken out.

    Parameters
    ----------
    solar : must reach 3 fwhm beyond every centre.
    center_nm, fwhm_nm : any shapes that broadcast; finite and above 0. [nm]

    Returns
    -------
    The broadcast shape. A LunarSciWarning says where the table's step exceeds the FWHM: lines are lost there.

    Raises
    ------
    ParameterError for a centre or width that is not finite and above 0, or a response the table does not cover.
    """
    centers, widths = np.broadcast_arrays(np.asarray(center_nm, dtype=float), np.asarray(fwhm_nm, dtype=float))
    if not all(np.isfinite(values).all() and (values > 0).all() for values in (centers, widths)):
        raise ParameterError("center_nm and fwhm_nm must be finite and above 0 nm; correct the channel table")
    _check_coverage(solar, centers, widths)
    found = np.empty(centers.shape)
    coarsest = (1.0, 0.0, 0.0)
    for at in np.ndindex(centers.shape):
        center, fwhm = float(centers[at]), float(widths[at])
        found[at], step = _gaussian_mean(solar, center, fwhm)
        coarsest = max(coarsest, (step / fwhm, center, step))
    if coarsest[0] > 1:
        message = (
            f"{solar.name}: its step of {coarsest[2]:.3g} nm at {coarsest[1]:g} nm exceeds the channel's FWHM of "
            f"{coarsest[2] / coarsest[0]:.3g} nm: solar lines are lost; use a spectrum with finer steps"
        )
        warnings.warn(message, LunarSciWarning, stacklevel=2)
    return found


def _check_coverage(solar: SolarSpectrum, centers: FloatArray, widths: FloatArray) -> None:
    first, last = solar.wavelength_nm[0], solar.wavelength_nm[-1]
    reach = _HALF_WIDTH_FWHM * widths
    outside = (centers - reach < first) | (centers + reach > last)
    if outside.any():
        center, half = centers[outside][0], reach[outside][0]
        raise ParameterError(
            f"{solar.name}: covers {first:g}-{last:g} nm, the channel at {center:g} nm needs {center - half:g}-"
            f"{center + half:g} nm; use a spectrum that covers it or leave the channel out"
        )


def _gaussian_mean(solar: SolarSpectrum, center: float, fwhm: float) -> tuple[float, float]:
    """Mean over one response, and the widest step of the table within it."""
    from scipy.special import ndtr

    low, high = center - _HALF_WIDTH_FWHM * fwhm, center + _HALF_WIDTH_FWHM * fwhm
    first = int(np.searchsorted(solar.wavelength_nm, low, side="right")) - 1
    last = int(np.searchsorted(solar.wavelength_nm, high, side="left")) + 1
    knots, levels = solar.wavelength_nm[first:last], solar.irradiance[first:last]
    sigma = fwhm / _FWHM_PER_SIGMA
    edges = (np.clip(knots, low, high) - center) / sigma
    # On each segment E = E(center) + slope (l - center): one part takes the Gaussian's area, one its first moment.
    slope = np.diff(levels) / np.diff(knots)
    at_center = levels[:-1] + slope * (center - knots[:-1])
    area = np.diff(ndtr(edges))
    moment = -sigma * np.diff(np.exp(-0.5 * edges**2)) / np.sqrt(2.0 * np.pi)
    return float((at_center @ area + slope @ moment) / area.sum()), float(np.diff(knots).max())


def read_solar_spectrum(source: InputFile) -> SolarSpectrum:
    """Read a user's solar spectrum: a text or ECSV table of wavelength (nm, um) and irradiance (W m-2 nm-1 or um-1).

    Units are those of the header where it states them; else those under which the integral over 430-2430 nm is the
    Sun's, and a LunarSciWarning says which. Another warning says that rows were sorted, or that the integral is more
    than 3 % off.

    Raises
    ------
    DataError for a table that is none, does not cover 430-2430 nm, has missing, negative or doubled values, or an
    integral more than 20 % off the 1157 W m-2 of ASTM G173 (surface spectra, other units, other distances).
    """
    content = inputs.text(source)
    table = _from_ecsv(content, source.name) if content.startswith("# %ECSV") else _from_text(content, source.name)
    _check_values(table, source.name)
    length, per, integral = _units(table, source.name)
    if table.length is None or table.per is None:
        _warn(
            f"{source.name}: read as {length} and {per}, under which it integrates to {integral:.0f} W m-2 over "
            "430-2430 nm; the header does not say, name the columns wavelength_nm,irradiance_w_m-2_nm-1"
        )
    off = integral / _INTEGRAL_W_M2 - 1
    if abs(off) > _REMARKED_OFF:
        _warn(
            f"{source.name}: its integral over 430-2430 nm, {integral:.0f} W m-2, is {off:+.1%} off that of ASTM G173, "
            "and reflectance changes by as much; check that it is at 1 AU"
        )
    wavelength, irradiance = _ascending(table, source.name)
    return SolarSpectrum(source.stem, wavelength * _NM[length], irradiance * _IRRADIANCE[per], source.name)


def _warn(message: str) -> None:
    warnings.warn(message, LunarSciWarning, stacklevel=3)


def _check_values(table: _Table, file: str) -> None:
    for what, values in (("wavelength", table.wavelength), ("irradiance", table.irradiance)):
        bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
        if bad.size:
            raise DataError(
                f"{file}: {table.places[bad[0]]}: {what} is {values[bad[0]]:g}, it must be a number above 0; correct "
                "or delete that row"
            )
    order = np.argsort(table.wavelength, kind="stable")
    again = np.flatnonzero(np.diff(table.wavelength[order]) == 0)
    if again.size:
        k = order[again[0] + 1]
        raise DataError(f"{file}: {table.places[k]}: a second {table.wavelength[k]:g}; keep one row per wavelength")


def _ascending(table: _Table, file: str) -> tuple[FloatArray, FloatArray]:
    if not (np.diff(table.wavelength) > 0).all():
        warnings.warn(f"{file}: rows were sorted by wavelength", LunarSciWarning, stacklevel=3)
    order = np.argsort(table.wavelength)
    return table.wavelength[order], table.irradiance[order]


def _units(table: _Table, file: str) -> tuple[str, str, float]:
    """Units of wavelength and irradiance, and the integral over COVERED_NM under them. [W m-2]"""
    low, high = float(table.wavelength.min()), float(table.wavelength.max())
    lengths = [
        unit
        for unit in ([table.length] if table.length else _NM)
        if low * _NM[unit] <= COVERED_NM[0] and COVERED_NM[1] <= high * _NM[unit]
    ]
    if not lengths:
        unit = f" {table.length}" if table.length else ""
        raise DataError(f"{file}: wavelengths {low:g}-{high:g}{unit} do not cover 430-2430 nm; use a wider spectrum")
    pers = [table.per] if table.per else list(_IRRADIANCE)
    found = [(length, per, _integral(table, length) * _IRRADIANCE[per]) for length in lengths for per in pers]
    best = min(found, key=lambda choice: abs(np.log(choice[2] / _INTEGRAL_W_M2)))
    if abs(best[2] / _INTEGRAL_W_M2 - 1) > _REFUSED_OFF:
        raise DataError(
            f"{file}: integrates to {best[2]:.3g} W m-2 over 430-2430 nm if in {best[1]}, the Sun at 1 AU to 1157; "
            "give irradiance above the atmosphere in W m-2 nm-1 or W m-2 um-1"
        )
    return best


def _integral(table: _Table, length: str) -> float:
    order = np.argsort(table.wavelength)
    wavelength, irradiance = table.wavelength[order] * _NM[length], table.irradiance[order]
    low, high = COVERED_NM
    inside = (wavelength > low) & (wavelength < high)
    grid = np.concatenate([[low], wavelength[inside], [high]])
    levels = np.interp(grid, wavelength, irradiance)
    return float(np.diff(grid) @ (levels[1:] + levels[:-1]) / 2)


def _from_text(content: str, file: str) -> _Table:
    lines, comments = split_lines(content)
    separator = separator_of(lines) if lines else " "
    decimal_comma = separator == ";"
    rows = [Row(n, split_fields(line, separator, f"{file}: line {n}")) for n, line in lines]
    start = next((k for k, row in enumerate(rows) if not _is_heading(row, decimal_comma)), len(rows))
    body = rows[start:]
    if not body:
        raise DataError(f"{file}: no line begins with a number; a solar spectrum has a wavelength and an irradiance")
    width = check_widths(body, file)
    # A comment may hold the names too; any other remark of as many words must not pass for them.
    above = [line for n, line in comments if n < body[0].line and '"' not in line]
    headings = [line for line in above if is_wavelength((line.split() or [""])[0].split(separator)[0])]
    names = _names([*headings, *(line for _, line in lines[:start])], separator, width, file)
    filled = [k for k in range(width) if not all(is_missing(row.fields[k]) for row in body)]
    wavelength, irradiance = _places(names or [""] * width, filled, file)

    def column(k: int) -> FloatArray:
        label = quoted(names[k]) if names else str(k + 1)
        return numbers(body, k, label, file, decimal_comma)

    length = wavelength_unit_in(names[wavelength], file) if names else None
    per = _irradiance_unit(names[irradiance]) if names else None
    places = [f"line {row.line}" for row in body]
    return _Table(column(wavelength), column(irradiance), length, per, places)


def _is_heading(row: Row, decimal_comma: bool) -> bool:
    """A row above the data: it begins with a word or a blank, and does not go on in numbers as spoilt data would."""
    first, *others = (number(cell, decimal_comma) for cell in row.fields)
    if first is not None:
        return bool(np.isnan(first)) and None in others
    return not others or any(value is None or np.isnan(value) for value in others)


def _names(headings: Sequence[str], separator: str, width: int, file: str) -> list[str] | None:
    """Names from the lowest heading that has one for each column; where blanks part columns, two may part names."""
    for line in reversed(headings):
        splits = [split_fields(line, separator, f"{file}: heading")]
        if separator == " ":
            splits.append(tuple(re.split(r"\s{2,}|\t", line)))
        for fields in splits:
            if len(fields) == width:
                return list(fields)
    return None


def _places(names: Sequence[str], filled: Sequence[int], file: str) -> tuple[int, int]:
    """Places of the wavelength and the irradiance: by name, or the first column and the only other one."""
    wavelength = next((k for k in filled if is_wavelength(names[k])), filled[0] if filled else 0)
    words = {k: set(name_tokens(names[k])) for k in filled if k != wavelength}
    others = [k for k in words if not words[k] & _OTHER_WORDS]
    named = [k for k in others if words[k] & _IRRADIANCE_WORDS]
    found = others if len(others) == 1 else named
    if len(found) != 1:
        raise DataError(
            f"{file}: {len(found) or 'no'} columns may be the irradiance; keep two columns, wavelength_nm and "
            "irradiance_w_m-2_nm-1"
        )
    return wavelength, found[0]


def _irradiance_unit(name: str) -> str | None:
    """The unit a name states, or None; 1 mW m-2 nm-1 is 1 W m-2 um-1."""
    words = name_tokens(name)
    lengths = {length_unit(word) for word in words} - {None}
    if lengths == {"nm"}:
        return "W m-2 um-1" if "mw" in words else "W m-2 nm-1"
    return "W m-2 um-1" if lengths == {"um"} else None


def _from_ecsv(content: str, file: str) -> _Table:
    from astropy import units as u
    from astropy.io import ascii

    from lunarsci.spectra.readers.astropy_columns import one_line

    # astropy raises a dozen kinds of errors for a broken table, a wrong unit or a word among numbers.
    try:
        table = ascii.read(content.splitlines(), format="ecsv", guess=False)
        places = _places(table.colnames, range(len(table.colnames)), file)
        columns = [table[table.colnames[k]] for k in places]
        values = [
            np.array(np.ma.filled(np.ma.asarray(c).astype(float), np.nan)) * (c.unit.to(unit) if c.unit else 1.0)
            for c, unit in zip(columns, (u.nm, u.W / u.m**2 / u.nm), strict=True)
        ]
    except DataError:
        raise
    except Exception as error:
        raise DataError(f"{file}: unusable ECSV table ({one_line(error)}); correct it or save it as CSV") from error
    length = "nm" if columns[0].unit else wavelength_unit_in(columns[0].name, file)
    per = "W m-2 nm-1" if columns[1].unit else _irradiance_unit(columns[1].name)
    return _Table(values[0], values[1], length, per, [f"row {k + 1}" for k in range(len(table))])
