"""FITS binary tables: one channel per row, or one row whose cells are whole spectra."""

import io
import warnings
from typing import Any

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile
from lunarsci.spectra.readers.astropy_columns import one_line, spectrum_table
from lunarsci.spectra.readers.table import SpectrumTable
from lunarsci.spectra.rows import quoted

__all__ = ["read_fits"]

_BLOCK = 2880


def read_fits(source: InputFile) -> SpectrumTable:
    """Read the first table with two columns or more. Raises DataError when there is none, or the file is broken."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        table = _first_table(source)
    messages = [one_line(m.message) for m in said]
    if any("truncated" in m.lower() for m in messages) or (table is None and len(source.data) % _BLOCK):
        raise DataError(f"{source.name}: truncated FITS file ({len(source.data)} bytes are too few); fetch it again")
    if table is None:
        raise DataError(f"{source.name}: no FITS table with two columns or more; store the spectra as a binary table")
    for message in messages:
        warnings.warn(f"{source.name}: {message}", LunarSciWarning, stacklevel=2)
    return spectrum_table(_unrolled(table, source.name), source, "fits")


def _first_table(source: InputFile) -> Any:
    from astropy.io import fits
    from astropy.table import Table

    try:
        with fits.open(io.BytesIO(source.data), memmap=False) as hdus:
            for hdu in hdus:
                if isinstance(hdu, fits.BinTableHDU | fits.TableHDU) and len(hdu.columns) >= 2:
                    return Table.read(hdu)
            return None
    # A broken file makes astropy raise whatever its parts happen to raise: OSError, TypeError, ValueError, KeyError.
    except Exception as error:
        raise DataError(f"{source.name}: broken FITS file ({one_line(error)}; truncated?); fetch it again") from error


def _unrolled(table: Any, file: str) -> Any:
    """A table with one row of vector cells as one of scalar rows; its scalar cells become metadata."""
    from astropy.table import Table

    vectors = [name for name in table.colnames if table[name].ndim > 1]
    if not vectors:
        return table
    if len(table) != 1:
        raise DataError(f"{file}: {len(table)} rows of vector cells; give one row, or one channel per row")
    lengths = {name: table[name].shape[1:] for name in vectors}
    if len(set(lengths.values())) != 1:
        listed = ", ".join(f"{quoted(name)} {shape}" for name, shape in lengths.items())
        raise DataError(
            f"{file}: vector cells differ in shape ({listed[:80]}); give wavelengths and spectra one length"
        )
    scalars = {name: str(table[name][0]) for name in table.colnames if name not in vectors}
    unrolled = Table([table[name][0] for name in vectors], names=vectors, meta={**table.meta, **scalars})
    for name in vectors:
        unrolled[name].unit = table[name].unit
    return unrolled
