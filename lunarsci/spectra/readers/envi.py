"""ENVI spectral libraries: a header of `key = value` lines (`.hdr`) beside a flat file of floats (`.sli`).

Why no library does it is said in `envi_header`.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile, read_input
from lunarsci.spectra.readers.envi_header import NUMBERS, EnviHeader, data_names, header_names, is_header, partner
from lunarsci.spectra.readers.table import MAX_PERCENT, Column, SpectrumTable
from lunarsci.spectra.rows import quoted

DATA_SUFFIXES = (".sli", ".slb")
_LIBRARY = "envi spectral library"
_NOT_SPECTRA = re.compile(r"(wavelengths?|bandpass|resolution|fwhm)\b", re.IGNORECASE)
"""Records that the libraries of the USGS carry among their spectra."""
USUAL_SCALE = 10_000.0
"""What reflectances in whole numbers are multiplied by where a header is silent, as ATCOR, FLAASH and HyMap products
do; assumed."""
_MOST_VALUES = 1_000_000_000


@dataclass(frozen=True, slots=True)
class _Layout:
    """What the header says: channels, spectra, the type of the values, the bytes before them, and what they are."""

    channels: int
    spectra: int
    dtype: np.dtype[Any]
    offset: int
    wavelength: FloatArray
    unit: str | None
    names: tuple[str, ...]
    scale: float | None
    ignored: float | None
    bad: FloatArray | None


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
        names = data_names(source.name, DATA_SUFFIXES)
        header, data = source, _partner(source.name, names, "data file (.sli)")
    else:
        header, data = _partner(source.name, header_names(source.name), "header (.hdr)"), source
    layout = _layout(EnviHeader.of(header))
    values = _values(data, layout, header.name)
    wavelength = Column("wavelength", layout.wavelength, 1, layout.unit)
    kept = [k for k, name in enumerate(layout.names) if not _NOT_SPECTRA.match(name)]
    if not kept:
        raise DataError(f"{header.name}: all {layout.spectra} records are wavelengths or widths; it has no spectra")
    if len(kept) < layout.spectra:
        message = f"{header.name}: left out {layout.spectra - len(kept)} records that are wavelengths or widths"
        warnings.warn(message, LunarSciWarning, stacklevel=2)
    unit, said = "fraction" if layout.scale is not None else None, list[str]()
    if layout.scale is None and layout.dtype.kind in "iu" and np.nanmax(np.abs(values[kept]), initial=0) > MAX_PERCENT:
        unit, values = "fraction", values / USUAL_SCALE
        said.append(f"whole numbers without a scale read as reflectance times {USUAL_SCALE:g}; give the header "
                    "'reflectance scale factor' for another")  # fmt: skip
    values = values if len(kept) == layout.spectra else values[kept]
    columns = [Column(layout.names[k], own, k + 1, unit) for k, own in zip(kept, values, strict=True)]
    return SpectrumTable(
        source,
        "envi",
        wavelength,
        tuple((column, None) for column in columns),
        tuple(f"channel {k + 1}" for k in range(layout.channels)),
        {"inputs": {header.name: header.sha256, data.name: data.sha256}, **({"read_as": said} if said else {})},
        block=values,
    )


def _partner(name: str, candidates: Sequence[str], what: str) -> InputFile:
    if name == "<stdin>":
        raise DataError(f"{name}: an ENVI library is two files, .sli and .hdr; give the name of one of them")
    return read_input(partner(name, candidates, what))


def _layout(header: EnviHeader) -> _Layout:
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
    wavelength = header.numbers("wavelength", channels, "samples")
    if wavelength is None:
        raise DataError(f"{file}: has no 'wavelength'; a library needs one for each of its {channels} samples")
    return _Layout(
        channels, spectra, header.dtype(NUMBERS, "a library holds real numbers: 1 to 5 or 12 to 15"),
        header.whole("header offset", "0"), wavelength, header.wavelength_unit(), _names(header, spectra),
        header.scale(), header.number("data ignore value"), header.numbers("bbl", channels, "samples"),
    )  # fmt: skip


def _names(header: EnviHeader, spectra: int) -> tuple[str, ...]:
    """Names of the spectra, empty where the header has none; a single one may hold commas."""
    text = " ".join(header.fields.get("spectra names", "").split())
    names = [name.strip() for name in text.split(",")] if spectra > 1 else [text]
    if not any(names):
        return ("",) * spectra
    names = names[:-1] if len(names) == spectra + 1 and not names[-1] else names
    header.count(names, spectra, "spectra names", "lines")
    return tuple(names)


def _values(data: InputFile, layout: _Layout, header: str) -> FloatArray:
    """Reflectance of every record, shape (spectra, channels), NaN where the header says that there is none."""
    wanted = layout.offset + layout.channels * layout.spectra * layout.dtype.itemsize
    if len(data.data) != wanted:
        raise DataError(
            f"{data.name}: has {len(data.data)} bytes, {Path(header).name} announces {wanted} "
            f"({layout.spectra} spectra of {layout.channels} channels); fetch both files again"
        )
    raw = np.frombuffer(data.data, layout.dtype, offset=layout.offset)
    values = raw.reshape(layout.spectra, layout.channels).astype(float)
    if layout.ignored is not None:
        values[values == np.dtype(layout.dtype).type(layout.ignored)] = np.nan
    if layout.bad is not None:
        values[:, layout.bad == 0] = np.nan
    # A deleted channel, -1.23e34, must stay recognisable: no scale factor is that large.
    return values if layout.scale is None else np.where(values < -1e30, values, values / layout.scale)
