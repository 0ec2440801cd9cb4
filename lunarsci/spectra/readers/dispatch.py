"""Which reader a file needs: told by its content first, then by its suffix."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from lunarsci import inputs
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.inputs import InputFile, read_input
from lunarsci.spectra.readers.assemble import spectra_of
from lunarsci.spectra.readers.envi import looks_like_envi, read_envi
from lunarsci.spectra.readers.relab import looks_like_relab, read_relab
from lunarsci.spectra.readers.splib import looks_like_splib, read_splib
from lunarsci.spectra.readers.table import ReflectanceUnit, SpectrumTable, StatedUnits, WavelengthUnit
from lunarsci.spectra.readers.text import read_text
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.name import product_name

__all__ = ["FORMATS", "read_spectra"]

FORMATS = ("ecsv", "text", "relab", "fits", "envi", "splib")

_READERS = {"text": read_text, "relab": read_relab, "envi": read_envi, "splib": read_splib}
_PACKED = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
_FOREIGN = {b"\x89HDF": "an HDF5 or netCDF-4 file", b"CDF": "a netCDF file", b"%PDF": "a PDF", b"\x89PNG": "a picture"}
_FITS = b"SIMPLE  ="
_RELAB_SUFFIXES = {".tab", ".asc"}
_FITS_SUFFIXES = {".fits", ".fit", ".fts"}


def read_spectra(
    input: InputFile | str,
    *,
    wavelength_unit: WavelengthUnit | None = None,
    reflectance_unit: ReflectanceUnit | None = None,
    format: str | None = None,
) -> list[Spectrum]:
    """Read every spectrum of a file: wavelengths in nm, ascending; reflectance as a fraction of 1.

    A file of a VNIS product stands for its observation, whose other files lie beside it; one of the two files of an
    ENVI library stands for both; the wavelengths of a USGS splib07 spectrum are looked for beside it and one folder up.

    Parameters
    ----------
    input : a file already read, or a path, or '-' for standard input.
    wavelength_unit, reflectance_unit : used where the file states no unit, or one that its values contradict.
    format : one of `FORMATS`; told from content and suffix if left out.

    Raises
    ------
    DataError, one line with file, place and remedy, when the file cannot be used; ParameterError for an unknown unit
    or format. Whatever the reader should know about a result that stands is a LunarSciWarning; `metadata` records it.
    """
    _check("wavelength unit", wavelength_unit, get_args(WavelengthUnit))
    _check("reflectance unit", reflectance_unit, get_args(ReflectanceUnit))
    _check("format", format, FORMATS)
    source = read_input(input) if isinstance(input, str) else input
    if product_name(source.name) is not None:
        return [_calibrated(source.name)]
    table = _reader(format or _format_of(source))(source)
    return spectra_of(table, StatedUnits(wavelength_unit, reflectance_unit))


def _calibrated(path: str) -> Spectrum:
    """A VNIS product is calibrated on the way, as `lunarsci spectra calibrate` does it without options."""
    from lunarsci.spectra.vnis.calibrate import calibrate
    from lunarsci.spectra.vnis.observation import read_observation

    return calibrate(read_observation(path)).to_spectrum()


def _check(what: str, value: str | None, allowed: tuple[str, ...]) -> None:
    if value is not None and value not in allowed:
        raise ParameterError(f"{what} '{value}' is not known; use one of {', '.join(allowed)}")


def _reader(format: str) -> Callable[[InputFile], SpectrumTable]:
    # astropy takes longer to import than a CSV file to read: only files that need it pay for it.
    if format == "ecsv":
        from lunarsci.spectra.readers.ecsv import read_ecsv

        return read_ecsv
    if format == "fits":
        from lunarsci.spectra.readers.fits import read_fits

        return read_fits
    return _READERS[format]


def _format_of(source: InputFile) -> str:
    suffix = Path(source.name).suffix.lower()
    if source.data.startswith(_FITS):
        return "fits"
    if suffix in _FITS_SUFFIXES:
        raise DataError(
            f"{source.name}: is named FITS but does not begin with 'SIMPLE  ='; fetch it again or rename it"
        )
    _refuse_by_magic(source)
    if looks_like_envi(source):
        return "envi"
    # The reader decodes the text again and says what there is to say about it.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        text = inputs.text(source).lstrip()
    if text.startswith("# %ECSV"):
        return "ecsv"
    if suffix == ".ecsv":
        raise DataError(f"{source.name}: is named ECSV but has no '# %ECSV' line; rename it .csv, or write it as ECSV")
    if text.startswith("<"):
        raise DataError(f"{source.name}: is an HTML or XML page, not a table (an error page saved?); fetch it again")
    if text.startswith("{"):
        raise DataError(f"{source.name}: is JSON or the like, not a table; save the spectra as CSV or ECSV")
    if looks_like_splib(text):
        return "splib"
    return "relab" if looks_like_relab(text, named_so=suffix in _RELAB_SUFFIXES) else "text"


def _refuse_by_magic(source: InputFile) -> None:
    for magic, kind in _PACKED.items():
        if source.data.startswith(magic):
            raise DataError(f"{source.name}: is compressed ({kind}); unpack it first")
    for magic, kind in _FOREIGN.items():
        if source.data.startswith(magic):
            raise DataError(f"{source.name}: is {kind}, not a table of spectra; save the spectra as CSV or ECSV")
