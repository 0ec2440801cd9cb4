"""A user's solar spectrum: a text or ECSV table whose units its header states, or its integral tells."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, warn
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.arrangements import text_table
from lunarsci.spectra.readers.astropy_tables import one_line
from lunarsci.spectra.readers.columns import is_wavelength
from lunarsci.spectra.readers.table import length_unit, name_tokens, wavelength_unit_in
from lunarsci.spectra.readers.text import header_and_body
from lunarsci.spectra.rows import (
    DECIMAL_COMMA,
    Row,
    check_widths,
    is_missing,
    numbers,
    quoted,
    split_fields,
    split_lines,
)
from lunarsci.spectra.solar import COVERED_NM, SolarSpectrum

_INTEGRAL_W_M2 = 1157.0  # of ASTM G173 (2003) over COVERED_NM; ASTM E490 (2000) gives 1159
_REFUSED_OFF, _REMARKED_OFF = 0.2, 0.03  # assumed: the standards differ by 0.2 %, the Sun's distance changes 7 %
_NM = {"nm": 1.0, "um": 1000.0}
_IRRADIANCE = {"W m-2 nm-1": 1.0, "W m-2 um-1": 1e-3}
_IRRADIANCE_WORDS = {"irradiance", "extraterrestrial", "etr", "e0", "am0", "ssi", "flux"}
_BEGINS = re.compile(r"[-+.,;\d]")
_OTHER_WORDS = {"sigma", "std", "stdev", "error", "err", "unc", "uncertainty", "fwhm", "bandwidth", "flag", "quality"}


class _Table(NamedTuple):
    """Two columns of a file as they stand, (n,) each.

    `length` and `per` are the units that it states, of wavelength and irradiance (as `_NM` and `_IRRADIANCE`), None
    where it states none; `places` say where each row is ('line 12').
    """

    wavelength: FloatArray
    irradiance: FloatArray
    length: str | None
    per: str | None
    places: Sequence[str]


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
        warn(
            f"{source.name}: read as {length} and {per}, under which it integrates to {integral:.0f} W m-2 over "
            "430-2430 nm; the header does not say, name the columns wavelength_nm,irradiance_w_m-2_nm-1"
        )
    off = integral / _INTEGRAL_W_M2 - 1
    if abs(off) > _REMARKED_OFF:
        warn(
            f"{source.name}: its integral over 430-2430 nm, {integral:.0f} W m-2, is {off:+.1%} off that of ASTM G173, "
            "and reflectance changes by as much; check that it is at 1 AU"
        )
    wavelength, irradiance = _ascending(table, source.name)
    return SolarSpectrum(source.stem, wavelength * _NM[length], irradiance * _IRRADIANCE[per], source.name)


def _check_values(table: _Table, file: str) -> None:
    """Raises DataError for numbers that are not above 0 and for wavelengths that come twice."""
    order = np.argsort(table.wavelength, kind="stable")
    again = order[1:][np.diff(table.wavelength[order]) == 0]
    faults = [(k, f"a second {table.wavelength[k]:g}; keep one row per wavelength") for k in again[:1]]
    for what, values in (("irradiance", table.irradiance), ("wavelength", table.wavelength)):
        bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))[:1]
        faults += [
            (k, f"{what} is {values[k]:g}, it must be a number above 0; correct or delete that row") for k in bad
        ]
    if faults:
        raise DataError(f"{file}: {table.places[faults[-1][0]]}: {faults[-1][1]}")


def _ascending(table: _Table, file: str) -> tuple[FloatArray, FloatArray]:
    if not (np.diff(table.wavelength) > 0).all():
        warn(f"{file}: rows were sorted by wavelength")
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
    result = [(length, per, _integral(table, length) * _IRRADIANCE[per]) for length in lengths for per in pers]
    best = min(result, key=lambda choice: abs(np.log(choice[2] / _INTEGRAL_W_M2)))
    if abs(best[2] / _INTEGRAL_W_M2 - 1) > _REFUSED_OFF:
        raise DataError(
            f"{file}: integrates to {best[2]:.3g} W m-2 over 430-2430 nm if in {best[1]}, the Sun at 1 AU to 1157; "
            "give irradiance above the atmosphere in W m-2 nm-1 or W m-2 um-1"
        )
    return best


def _integral(table: _Table, length: str) -> float:
    """Irradiance from 430 to 2430 nm, of wavelengths in the unit `length`."""
    order = np.argsort(table.wavelength)
    wavelength, irradiance = table.wavelength[order] * _NM[length], table.irradiance[order]
    low, high = COVERED_NM
    inside = (wavelength > low) & (wavelength < high)
    grid = np.concatenate([[low], wavelength[inside], [high]])
    levels = np.interp(grid, wavelength, irradiance)
    return float(np.diff(grid) @ (levels[1:] + levels[:-1]) / 2)


def _from_text(content: str, file: str) -> _Table:
    """The table of a text. Raises DataError for one without two columns of numbers."""
    lines, comments = split_lines(content)
    if not any(map(_BEGINS.match, (line for _, line in lines))):
        raise DataError(f"{file}: no line begins with a number; a solar spectrum has a wavelength and an irradiance")
    table = text_table(lines, file)
    separator, names, numbered = table.separator, table.names, table.lines
    if not names:
        names, numbered = header_and_body(numbered, comments, separator, file)
    body = [Row(n, split_fields(line, separator, f"{file}: line {n}")) for n, line in numbered]
    width = check_widths(body, file)
    names = names if names and len(names) == width else None
    filled = [k for k in range(width) if not all(is_missing(row.fields[k]) for row in body)]
    wavelength, irradiance = _places(names or [""] * width, filled, file)

    def column(k: int) -> FloatArray:
        label = quoted(names[k]) if names else str(k + 1)
        return numbers(body, k, label, file, separator in DECIMAL_COMMA)

    length = wavelength_unit_in(names[wavelength], file) if names else None
    per = _irradiance_unit(names[irradiance]) if names else None
    places = [f"line {row.line}" for row in body]
    return _Table(column(wavelength), column(irradiance), length, per, places)


def _places(names: Sequence[str], filled: Sequence[int], file: str) -> tuple[int, int]:
    """Places of the wavelength and the irradiance: by name, or the first column and the only other one."""
    wavelength = next((k for k in filled if is_wavelength(names[k])), filled[0] if filled else 0)
    words = {k: set(name_tokens(names[k])) for k in filled if k != wavelength}
    others = [k for k in words if not words[k] & _OTHER_WORDS]
    named = [k for k in others if words[k] & _IRRADIANCE_WORDS]
    result = others if len(others) == 1 else named
    if len(result) != 1:
        raise DataError(
            f"{file}: {len(result) or 'no'} columns may be the irradiance; keep two columns, wavelength_nm and "
            "irradiance_w_m-2_nm-1"
        )
    return wavelength, result[0]


def _irradiance_unit(name: str) -> str | None:
    """The unit a name states, or None; 1 mW m-2 nm-1 is 1 W m-2 um-1."""
    words = name_tokens(name)
    lengths = {length_unit(word) for word in words} - {None}
    if lengths == {"nm"}:
        return "W m-2 um-1" if "mw" in words else "W m-2 nm-1"
    return "W m-2 um-1" if lengths == {"um"} else None


def _from_ecsv(content: str, file: str) -> _Table:
    """The table of an ECSV file, by astropy, its units converted. Raises DataError for one that is broken."""
    from astropy import units as u
    from astropy.io import ascii

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
