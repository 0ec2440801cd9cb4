"""Tables that astropy reads: ECSV (APE 6) and FITS; roles by name and unit, units converted, masked values missing.

A FITS binary table has one channel per row, or one row whose cells are whole spectra.
"""

import io
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, warn
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.columns import assign_roles, is_not_a_spectrum, is_wavelength
from lunarsci.spectra.readers.table import Column, SpectrumTable, length_unit
from lunarsci.spectra.rows import plain_numbers, quoted

_LONGEST_LIST = 200
_ERROR = re.compile(r"uncertainty|sigma|std\w*|error|err|flux_?err\w*", re.IGNORECASE)
"""Names of the errors beside spectra in vector cells; specutils writes `uncertainty`."""
_DIMENSIONLESS = {"fraction", "reflectance", "i/f", "unitless", "dimensionless", "none", "-", "---"}
_PERCENT = {"percent", "per cent", "pct", "%"}


def is_fits(source: InputFile, start: str) -> bool:
    return source.data.startswith(b"SIMPLE  =")


def is_ecsv(source: InputFile, start: str) -> bool:
    return start.startswith("# %ECSV")


def spectrum_table(table: Any, source: InputFile, format: str) -> SpectrumTable:
    """Give the columns of an `astropy.table.Table` their roles. Raises DataError for these and for units."""
    units = [_unit(table[name], source.name) for name in table.colnames]
    return _of_columns([*table.itercols()], [*map(str, table.colnames)], units, table.meta, source, format)


def _of_columns(
    columns: Any, names: Sequence[str], units: Sequence[Any], meta: Any, source: InputFile, format: str
) -> SpectrumTable:
    """The same of columns of numbers or texts, (rows,) each."""
    rows = len(columns[0]) if len(columns) else 0
    if len(names) < 2 or rows == 0:
        what = f"{len(names)} columns and {rows} rows"
        raise DataError(f"{source.name}: {what}; a spectrum needs a wavelength and a reflectance column with values")
    roles = assign_roles(
        names,
        source,
        wavelength=_wavelength_place(names, units, source.name),
        left_out=[k for k, one in enumerate(columns) if not _is_number_column(one) or _is_physical(units[k])],
    )

    def column(k: int) -> Column:
        numbers = Column(names[k], _values(columns[k], names[k], source.name), k + 1)
        return _wavelength(numbers, units[k], source.name) if k == roles.wavelength else _reflectance(numbers, units[k])

    about = {"header": plain(dict(meta))} if meta else {}
    return roles.table(source, format, column, tuple(f"row {k + 1}" for k in range(rows)), about)


def plain(value: Any) -> Any:
    """A header value as plain Python data."""
    if isinstance(value, str | bool | int | float) or value is None:
        return value
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value[:_LONGEST_LIST]]
    return str(value)


def one_line(error: object) -> str:
    """The first line of another library's message, shortened."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0][:120].rstrip(" .:;")


_USUAL = {"": "fraction", "%": "percent", "nm": "nm", "um": "um"}
"""What units are called that need no astropy, which takes a third of a second to import."""


def _unit(column: Any, file: str) -> Any:
    """Unit of a column, one of `_USUAL` or of astropy; None for none. What astropy does not know may be one of ours."""
    from astropy import units as u

    if column.unit is None or str(column.unit) in _USUAL:
        return None if column.unit is None else _USUAL[str(column.unit)]
    if not isinstance(column.unit, u.UnrecognizedUnit):
        return u.Unit(column.unit)
    text = str(column.unit).strip().casefold()
    if text in _DIMENSIONLESS:
        return "fraction"
    return "percent" if text in _PERCENT else length_unit(text) or column.unit


def _is_number_column(column: Any) -> bool:
    return getattr(getattr(column, "dtype", None), "kind", "O") in "fiu"


def _is_spectral(unit: Any) -> bool:
    if unit is None or isinstance(unit, str):
        return unit in ("nm", "um")
    from astropy import units as u

    return bool(unit.is_equivalent(u.nm, u.spectral()))


def _is_physical(unit: Any) -> bool:
    return _is_spectral(unit) if unit is None or isinstance(unit, str) else not unit.is_equivalent("")


def _wavelength_place(names: Sequence[str], units: Sequence[Any], file: str) -> int | None:
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


def _values(column: Any, name: str, file: str) -> FloatArray:
    """A column as floats, (rows,), NaN where it is masked. Raises DataError for one of another kind."""
    if not _is_number_column(column) or column.ndim != 1:
        raise DataError(f"{file}: column {quoted(name)} does not hold one number a row; correct it")
    values = np.ma.filled(np.ma.asarray(column).astype(float), np.nan)
    return np.array(values, dtype=float)


def _wavelength(column: Column, unit: Any, file: str) -> Column:
    """A column with its values in nm or um. Raises DataError for a unit that is no wavelength."""
    ours = next((one for one in ("nm", "um") if unit == one), None)
    if unit is None or ours:
        return replace(column, unit=ours)
    if not _is_spectral(unit):
        name = next((text for text, ours in _USUAL.items() if ours == unit), str(unit))
        raise DataError(f"{file}: column {column.label} has the unit '{name}', which is no wavelength; use nm or um")
    from astropy import units as u

    values = np.full(column.values.shape, np.nan)
    good = np.isfinite(column.values) & (column.values > 0)
    values[good] = (column.values[good] * unit).to_value(u.nm, u.spectral())
    return Column(column.name, values, column.position, "nm", str(unit))


def _reflectance(column: Column, unit: Any) -> Column:
    """A column with its values as fractions or per cent, as far as its unit says."""
    if unit is None or isinstance(unit, str):
        return replace(column, unit=unit)
    return Column(column.name, column.values * unit.to(""), column.position, "fraction", str(unit))


_ECSV = re.compile(r"# %ECSV \d+\.\d+\n# ---\n(?:(?!.*!!omap)#.*\n|# meta: !!omap\n)*(?!#)")
"""The header of a table whose metadata have no order but that of their uppermost names."""
_COMMA = re.compile(r"^# delimiter: *['\"]?,", re.MULTILINE)


def read_ecsv(source: InputFile) -> SpectrumTable:
    """Read an ECSV table; column units and header metadata are kept. Raises DataError when it is broken."""
    text = inputs.text(source)
    usual = _usual_columns(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        table = _parsed(text, source.name) if usual is None else None
    _check_names(text, source.name)
    for message in caught:
        warn(f"{source.name}: {one_line(message.message)}")
    return spectrum_table(table, source, "ecsv") if usual is None else _of_columns(*usual, source, "ecsv")


def _usual_columns(text: str) -> tuple[FloatArray, list[str], list[str | None], dict[str, Any]] | None:
    """Columns, (n, rows), names, units and header of an ECSV table of doubles in units of `_USUAL`, none missing
    between blanks.

    None for any other, and where something is wrong: astropy reads it, or says what.
    """
    import yaml

    lines = [line for line in text.splitlines() if line.strip()]
    count = next((k for k, line in enumerate(lines) if not line.startswith("#")), len(lines))
    try:
        about = yaml.load("\n".join(line[2:] for line in lines[1:count]), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        names, kinds = ([one[key] for one in about["datatype"]] for key in ("name", "datatype"))
        units = [_USUAL[one["unit"]] if "unit" in one else None for one in about["datatype"]]
        meta, separator = dict(about.get("meta", ())), about.get("delimiter", " ")
        columns = np.array([plain_numbers(line, separator) for line in lines[count + 1 :]], float).T
        plainly = {*kinds} == {"float64"} and "subtype" not in text and _ECSV.match(text) is not None
        whole = separator == "," or (separator == " " and not np.isnan(columns).any())
        usual = plainly and whole and lines[count].split(separator) == names and len(columns) == len(names)
    except (yaml.YAMLError, LookupError, ValueError, TypeError, AttributeError):
        return None
    return (columns, names, units, meta) if usual and "__serialized_columns__" not in meta else None


def _check_names(text: str, file: str) -> None:
    # astropy renames the second of two columns of one name and says nothing.
    header = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    delimiter = "," if _COMMA.search(text) else " "
    names = next(inputs.csv_rows(file, [header], delimiter=delimiter), [])
    twice = [name for name, count in Counter(names).items() if name and count > 1]
    if twice:
        raise DataError(f"{file}: two columns are named {quoted(twice[0])}; give each column its own name")


def _parsed(text: str, file: str) -> Any:
    from astropy.io import ascii

    try:
        return ascii.read(text.splitlines(), format="ecsv", guess=False)
    # astropy and its YAML parser raise a dozen kinds of errors for a broken file, and document none of them.
    except Exception as error:
        raise DataError(f"{file}: broken ECSV table ({one_line(error)}); correct it or fetch the file again") from error


_BLOCK = 2880


def read_fits(source: InputFile) -> SpectrumTable:
    """Read the first table with two columns or more. Raises DataError when there is none, or the file is broken."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        table = _first_table(source)
    messages = [one_line(m.message) for m in caught]
    cut = any("truncated" in m.lower() for m in messages) or (table is None and len(source.data) % _BLOCK)
    if cut or table is None:
        what = f"truncated FITS file ({len(source.data)} bytes are too few); fetch it again"
        none = "no FITS table with two columns or more; store the spectra as a binary table"
        raise DataError(f"{source.name}: {what if cut else none}")
    for message in messages:
        warn(f"{source.name}: {message}")
    return spectrum_table(_unrolled(table, source.name), source, "fits")


def _first_table(source: InputFile) -> Any:
    """The first table of a FITS file with two columns or more, else that of its first spectrum as an image, or None."""
    from astropy.io import fits
    from astropy.table import Table

    try:
        with fits.open(io.BytesIO(source.data), memmap=False) as hdus:
            for hdu in hdus:
                if isinstance(hdu, fits.BinTableHDU | fits.TableHDU) and len(hdu.columns) >= 2:
                    return Table.read(hdu)
            return next((table for hdu in hdus if (table := _of_image(hdu)) is not None), None)
    # A broken file makes astropy raise whatever its parts happen to raise: OSError, TypeError, ValueError, KeyError.
    except Exception as error:
        raise DataError(f"{source.name}: broken FITS file ({one_line(error)}; truncated?); fetch it again") from error


def _of_image(hdu: Any) -> Any:
    """The table of an image of one or two axes whose first is a linear wavelength, as specutils' `wcs1d-fits` has it.

    Greisen et al. (2006), A&A 446, 747, 10.1051/0004-6361:20053818; None for any other.
    """
    from astropy import units as u
    from astropy.table import Table
    from astropy.wcs import WCS

    if hdu.data is not None and hdu.data.ndim == 2 and "XUNITS" in hdu.header and len(hdu.data) in (2, 3, 4):
        return _of_spextool(hdu)
    kind = str(hdu.header.get("CTYPE1", "")).strip()[:4]
    if hdu.data is None or hdu.data.ndim not in (1, 2) or kind not in ("WAVE", "AWAV", "LINE", "LAMB"):
        return None
    values = np.atleast_2d(hdu.data)
    header = hdu.header.copy()
    header["CTYPE1"] = "WAVE"
    axis = WCS(header).sub([1])
    wavelength = axis.pixel_to_world_values(np.arange(values.shape[1])) * u.Unit(axis.wcs.cunit[0])
    names = (
        [str(hdu.header.get("OBJECT") or "flux")] if len(values) == 1 else [f"flux_{k + 1}" for k in range(len(values))]
    )
    return Table([wavelength, *values.astype(float)], names=["wavelength", *names], meta=dict(hdu.header))


def _of_spextool(hdu: Any) -> Any:
    """The table of an image of wavelength, spectrum, its error and flags, as Spextool has them.

    Cushing et al. (2004), PASP 116, 362, 10.1086/382907.
    """
    from astropy import units as u
    from astropy.table import Table

    rows = hdu.data.astype(float)
    names = ["wavelength", "flux", "flux_sigma", "flags"][: len(rows)]
    table = Table([*rows], names=names, meta=dict(hdu.header))
    for name, key in (("wavelength", "XUNITS"), ("flux", "YUNITS"), ("flux_sigma", "YUNITS")):
        if name in names:
            table[name].unit = u.Unit(str(hdu.header.get(key, "")).strip(), parse_strict="silent") or None
    return table


def _unrolled(table: Any, file: str) -> Any:
    """A table with vector cells as one of scalar rows; scalar cells beside one row of vectors become metadata.

    Cells hold whole spectra, of one row or a row each, or one channel of several spectra, as specutils writes them.
    """
    from astropy.table import Table

    vectors = [name for name in table.colnames if table[name].ndim > 1]
    if not vectors:
        return table
    if any(_is_spectral(_unit(table[name], file)) or is_wavelength(name) for name in set(table.colnames) - {*vectors}):
        return _channels_in_rows(table, vectors)
    lengths = {name: table[name].shape[1:] for name in vectors}
    if len(set(lengths.values())) != 1:
        listed = ", ".join(f"{quoted(name)} {shape}" for name, shape in lengths.items())
        raise DataError(
            f"{file}: vector cells differ in shape ({listed[:80]}); give wavelengths and spectra one length"
        )
    if len(table) > 1:
        return _spectra_in_rows(table, vectors, file)
    scalars = {name: str(table[name][0]) for name in table.colnames if name not in vectors}
    unrolled = Table([table[name][0] for name in vectors], names=vectors, meta={**table.meta, **scalars})
    for name in vectors:
        unrolled[name].unit = table[name].unit
    return unrolled


def _channels_in_rows(table: Any, vectors: list[str]) -> Any:
    """A channel in each row, several spectra in its cells: a column for each, `flux_1` on."""
    from astropy.table import Table

    result = Table(meta=table.meta)
    for name in table.colnames:
        if name not in vectors:
            result[name] = table[name]
            continue
        cells = np.ma.asarray(table[name]).reshape(len(table), -1)
        error = _ERROR.fullmatch(name)
        for k in range(cells.shape[1]):
            title = f"{name}_{k + 1}" if error is None else f"flux_{k + 1}_sigma"
            result[title] = cells[:, k]
            result[title].unit = table[name].unit
    return result


def _spectra_in_rows(table: Any, vectors: list[str], file: str) -> Any:
    """A spectrum in each row: a column for each, by the name in a column of text; wavelengths are those of all.

    Raises DataError where rows have other wavelengths.
    """
    from astropy.table import Table

    waves = [name for name in vectors if is_wavelength(name) or _is_spectral(_unit(table[name], file))]
    others = [name for name in vectors if name not in waves]
    grid = np.asarray(table[waves[0]] if waves else np.arange(len(table)), dtype=float)
    if not waves or not others or not np.allclose(grid, grid[0], rtol=1e-9, equal_nan=True):
        raise DataError(f"{file}: {len(table)} rows of vectors without common wavelengths; give one channel per row")
    texts = [name for name in table.colnames if table[name].dtype.kind in "SU" and len({*table[name]}) == len(table)]
    ids = [str(one).strip() for one in table[texts[0]]] if texts else [str(k + 1) for k in range(len(table))]
    result = Table({waves[0]: grid[0]}, meta=table.meta)
    result[waves[0]].unit = table[waves[0]].unit
    for name in others:
        for id, row in zip(ids, np.ma.asarray(table[name]), strict=True):
            title = f"{id}_sigma" if _ERROR.fullmatch(name) else id if texts and len(others) < 3 else f"{name}_{id}"
            result[title] = row
            result[title].unit = table[name].unit
    return result
