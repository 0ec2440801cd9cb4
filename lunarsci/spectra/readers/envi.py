"""ENVI spectral libraries: a header of `key = value` lines (`.hdr`) beside a flat file of floats (`.sli`).

Why no library does it is said in `envi_header`.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, warn
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.spectra.readers.envi_header import NUMBERS, EnviHeader, data_names, header_names, is_header, partner
from lunarsci.spectra.readers.table import MAX_PERCENT, USUAL_SCALE, Column, SpectrumTable
from lunarsci.spectra.rows import quoted

DATA_SUFFIXES = (".sli", ".slb")
_LIBRARY = "envi spectral library"
_NOT_SPECTRA = re.compile(r"(wavelengths?|bandpass|resolution|fwhm)\b", re.IGNORECASE)
"""Records that the libraries of the USGS carry among their spectra."""
_MOST_VALUES = 1_000_000_000


def looks_like_envi(source: InputFile) -> bool:
    """Whether a file is one of the two of an ENVI library: by its suffix, or as a header by its first line."""
    return Path(source.name).suffix.lower() in DATA_SUFFIXES or is_header(source)


def without_headers(names: Sequence[str]) -> list[str]:
    """File names less the headers whose data file is among them."""
    data = {name for name in names if Path(name).suffix.lower() in DATA_SUFFIXES}
    taken = {candidate for name in data for candidate in header_names(name)}
    return [name for name in names if name not in taken]


def read_envi(source: InputFile) -> SpectrumTable:
    """Read an ENVI spectral library from its data file or its header; the other one lies beside it.

    Raises DataError when one of them is missing, the header is no spectral library's or contradicts itself, or the
    data file has another size than the header says.
    """
    if is_header(source):
        header, data = source, _partner(source.name, data_names(source.name, DATA_SUFFIXES), "data file (.sli)")
    else:
        header, data = _partner(source.name, header_names(source.name), "header (.hdr)"), source
    found = EnviHeader.of(header)
    channels, spectra = _size(found)
    names, scale = _names(found, spectra), found.scale()
    wavelength = found.numbers("wavelength", channels, "samples")
    if wavelength is None:
        raise DataError(f"{header.name}: has no 'wavelength'; a library needs one for each of its {channels} samples")
    values = _values(data, found, (spectra, channels))
    whole = values.dtype.kind in "iu"
    values = _reflectances(values, found, channels)
    kept = [k for k, name in enumerate(names) if not _NOT_SPECTRA.match(name)]
    if not kept:
        raise DataError(f"{header.name}: all {spectra} records are wavelengths or widths; it has no spectra")
    if len(kept) < spectra:
        warn(f"{header.name}: left out {spectra - len(kept)} records that are wavelengths or widths")
    unit, said = "fraction" if scale is not None else None, list[str]()
    if scale is None and whole and np.nanmax(np.abs(values[kept]), initial=0) > MAX_PERCENT:
        unit, values = "fraction", values / USUAL_SCALE
        said.append(f"whole numbers without a scale read as reflectance times {USUAL_SCALE:g}; give the header "
                    "'reflectance scale factor' for another")  # fmt: skip
    values = values if len(kept) == spectra else values[kept]
    columns = [Column(names[k], own, k + 1, unit) for k, own in zip(kept, values, strict=True)]
    return SpectrumTable(
        source,
        "envi",
        Column("wavelength", wavelength, 1, found.wavelength_unit()),
        tuple((column, None) for column in columns),
        tuple(f"channel {k + 1}" for k in range(channels)),
        {"inputs": {header.name: header.sha256, data.name: data.sha256}, **({"read_as": said} if said else {})},
        block=values,
    )


def _partner(name: str, candidates: Sequence[str], what: str) -> InputFile:
    if name == "<stdin>":
        raise DataError(f"{name}: an ENVI library is two files, .sli and .hdr; give the name of one of them")
    return read_input(partner(name, candidates, what))


def _size(header: EnviHeader) -> tuple[int, int]:
    """Channels and spectra. Raises DataError for a header of no library."""
    file, kind = header.file, header.fields.get("file type", "")
    if " ".join(kind.split()).lower() != _LIBRARY:
        is_what = quoted(kind) if kind else "of no file type"
        remedy = "give a library; of an image, `lunarsci spectra map` makes maps and takes spectra out"
        raise DataError(f"{file}: is an ENVI header {is_what}, not of an 'ENVI Spectral Library'; {remedy}")
    channels, spectra = header.whole("samples"), header.whole("lines")
    if header.whole("bands", "1") != 1:
        raise DataError(f"{file}: has bands = {header.fields['bands']}; a spectral library has 1")
    if channels < 1 or spectra < 1 or channels * spectra > _MOST_VALUES:
        raise DataError(f"{file}: samples = {channels} and lines = {spectra} are no possible library; check the header")
    return channels, spectra


def _names(header: EnviHeader, spectra: int) -> tuple[str, ...]:
    """Names of the spectra, empty where the header has none; a single one may hold commas."""
    text = " ".join(header.fields.get("spectra names", "").split())
    names = [name.strip() for name in text.split(",")] if spectra > 1 else [text]
    if not any(names):
        return ("",) * spectra
    names = names[:-1] if len(names) == spectra + 1 and not names[-1] else names
    header.count(names, spectra, "spectra names", "lines")
    return tuple(names)


def _values(data: InputFile, header: EnviHeader, shape: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Numbers of every record as they are stored, (spectra, channels)."""
    dtype = header.dtype(NUMBERS, "a library holds real numbers: 1 to 5 or 12 to 15")
    offset = header.whole("header offset", "0")
    wanted = offset + shape[0] * shape[1] * dtype.itemsize
    if len(data.data) != wanted:
        raise DataError(
            f"{data.name}: has {len(data.data)} bytes, {Path(header.file).name} announces {wanted} "
            f"({shape[0]} spectra of {shape[1]} channels); fetch both files again"
        )
    return np.frombuffer(data.data, dtype, offset=offset).reshape(shape)


def _reflectances(stored: np.ndarray[Any, Any], header: EnviHeader, channels: int) -> FloatArray:
    """The numbers, scaled, NaN where the header says that there is none."""
    values = stored.astype(float)
    if (ignored := header.number("data ignore value")) is not None:
        values[stored == stored.dtype.type(ignored)] = np.nan
    if (good := header.numbers("bbl", channels, "samples")) is not None:
        values[:, good == 0] = np.nan
    scale = header.scale()
    # A deleted channel, -1.23e34, must stay recognisable: no scale factor is that large.
    return values if scale is None else np.where(values < -1e30, values, values / scale)
