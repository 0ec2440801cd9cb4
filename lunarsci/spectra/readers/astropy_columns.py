"""From an astropy table to a `SpectrumTable`: roles by name and unit, units converted, masked values missing."""

from typing import Any

import numpy as np
from astropy import units as u

from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.readers.columns import assign_roles, is_not_a_spectrum, is_wavelength
from lunarsci.spectra.readers.table import Column, SpectrumTable
from lunarsci.spectra.readers.units import length_unit
from lunarsci.spectra.rows import quoted
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["one_line", "plain", "spectrum_table"]

_LISTS_KEPT = 200
_DIMENSIONLESS = {"fraction", "reflectance", "i/f", "unitless", "dimensionless", "none", "-"}


def spectrum_table(table: Any, source: InputFile, format: str) -> SpectrumTable:
    """Give the columns of an `astropy.table.Table` their roles. Raises DataError for these and for units."""
    names = [str(name) for name in table.colnames]
    if len(names) < 2 or len(table) == 0:
        what = f"{len(names)} columns and {len(table)} rows"
        raise DataError(f"{source.name}: {what}; a spectrum needs a wavelength and a reflectance column with values")
    units = [_unit(table[name], source.name) for name in names]
    roles = assign_roles(
        names,
        source,
        wavelength=_wavelength_place(names, units, source.name),
        left_out=[k for k, name in enumerate(names) if not _is_number_column(table[name]) or _is_physical(units[k])],
    )

    def values(k: int) -> FloatArray:
        return _values(table[names[k]], source.name)

    def reflectance(k: int) -> Column:
        return _reflectance(Column(names[k], values(k), k + 1), units[k])

    wavelength = Column(names[roles.wavelength], values(roles.wavelength), roles.wavelength + 1)
    return SpectrumTable(
        source,
        format,
        _wavelength(wavelength, units[roles.wavelength], source.name),
        tuple((reflectance(r), None if s is None else reflectance(s)) for r, s in roles.spectra),
        tuple(f"row {k + 1}" for k in range(len(table))),
        {"header": plain(dict(table.meta))} if table.meta else {},
        roles.systematic_columns(reflectance),
    )


def plain(value: Any) -> Any:
    """A header value as plain Python data."""
    if isinstance(value, str | bool | int | float) or value is None:
        return value
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value[:_LISTS_KEPT]]
    return str(value)


def one_line(error: object) -> str:
    """The first line of another library's message, shortened."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0][:120].rstrip(" .:;")


def _unit(column: Any, file: str) -> Any:
    if column.unit is None:
        return None
    if not isinstance(column.unit, u.UnrecognizedUnit):
        return u.Unit(column.unit)
    text = str(column.unit).strip().casefold()
    if text in _DIMENSIONLESS:
        return u.dimensionless_unscaled
    length = length_unit(text)
    if length is None and is_wavelength(str(column.name)):
        raise DataError(
            f"{file}: column {quoted(str(column.name))} has the unknown unit {quoted(str(column.unit))}; use nm or um"
        )
    return column.unit if length is None else u.Unit(length)


def _is_number_column(column: Any) -> bool:
    return getattr(getattr(column, "dtype", None), "kind", "O") in "fiu"


def _is_spectral(unit: Any) -> bool:
    return unit is not None and bool(unit.is_equivalent(u.nm, u.spectral()))


def _is_physical(unit: Any) -> bool:
    return unit is not None and not unit.is_equivalent(u.dimensionless_unscaled)


def _wavelength_place(names: list[str], units: list[Any], file: str) -> int | None:
    """Place of the one column with a spectral unit, or None where a name must decide."""
    if any(is_wavelength(name) for name in names):
        return None
    spectral = [k for k, unit in enumerate(units) if _is_spectral(unit) and not is_not_a_spectrum(names[k])]
    spectral = spectral or [k for k, unit in enumerate(units) if _is_spectral(unit) and "fwhm" not in names[k].lower()]
    if len(spectral) > 1:
        first, second = names[spectral[0]], names[spectral[1]]
        raise DataError(
            f"{file}: {quoted(first)} and {quoted(second)} both have a spectral unit; name the right one 'wavelength'"
        )
    return spectral[0] if spectral else None


def _values(column: Any, file: str) -> FloatArray:
    if not _is_number_column(column):
        raise DataError(f"{file}: column {quoted(str(column.name))} does not hold numbers; correct it in the file")
    if column.ndim != 1:
        raise DataError(
            f"{file}: column {quoted(str(column.name))} has {column.ndim - 1} more dimensions; give one value per row"
        )
    values = np.ma.filled(np.ma.asarray(column).astype(float), np.nan)
    return np.array(values, dtype=float)


def _wavelength(column: Column, unit: Any, file: str) -> Column:
    if unit is None:
        return column
    name = str(unit)
    if unit in (u.nm, u.um):
        return Column(column.name, column.values, column.position, "nm" if unit == u.nm else "um")
    if not _is_spectral(unit):
        raise DataError(
            f"{file}: column {quoted(str(column.name))} has the unit '{name}', which is no wavelength; use nm or um"
        )
    values = np.full(column.values.shape, np.nan)
    good = np.isfinite(column.values) & (column.values > 0)
    values[good] = (column.values[good] * unit).to_value(u.nm, u.spectral())
    return Column(column.name, values, column.position, "nm", name)


def _reflectance(column: Column, unit: Any) -> Column:
    if unit is None:
        return column
    if unit == u.percent:
        return Column(column.name, column.values, column.position, "percent")
    return Column(
        column.name, column.values * unit.to(u.dimensionless_unscaled), column.position, "fraction", str(unit)
    )
