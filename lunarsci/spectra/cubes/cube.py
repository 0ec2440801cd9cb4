"""A cube: lines and samples of spectra on one set of channels, read in blocks of lines and never as a whole.

What a file may lie about is checked here for all formats: units of wavelengths, their order, scale, 8-bit pictures.
"""

import hashlib
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.compiled import compiled
from lunarsci.errors import DataError, LunarSciWarning, warn
from lunarsci.io.tables import MOST_CELLS
from lunarsci.spectra.readers.likely import unnamed_markers
from lunarsci.spectra.readers.pds import CALIBRATE
from lunarsci.spectra.readers.table import MAX_FRACTION, Column, WavelengthUnit, wavelength_nm

FLAGS = ("no_data", "left_out", "channels_missing", "channels_saturated", "channels_not_positive")
"""Bits of a pixel's flags, the first is 1: no channel can be used; outside of the region or mask; good channels without
a value; saturated; at or below 0."""
NO_DATA, LEFT_OUT, MISSING, SATURATED, NOT_POSITIVE = (1 << k for k in range(len(FLAGS)))
SYNTHETIC = "SYNTHETIC"
"""In the remarks of a cube that is made up."""
FEWEST_CHANNELS = 5
MOST_VALUES = 10**13
"""Of a cube; more are a broken header."""
LINES_LOOKED_AT = 16
"""Lines, evenly spread, from which the scale of the numbers is judged."""
_ROTATED = re.compile(r"^(pca?|mnf|ica?|principal component|minimum noise|eigen)\b.*\d", re.IGNORECASE)


class Source(Protocol):
    """Where the numbers of a cube are; it goes to other processes, so it holds no open file."""

    def read(self, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """Numbers as the file has them, shape (lines, samples, channels of the file)."""


@dataclass(frozen=True, slots=True)
class FlatFile:
    """Numbers in a flat file: `dtype` as NumPy names it, byte order included; `offset` bytes before the first; lines,
    samples and channels of the image; `interleave` bsq, bil or bip, the order in which they follow."""

    path: str
    dtype: str
    offset: int
    lines: int
    samples: int
    channels: int
    interleave: str

    @property
    def bytes(self) -> int:
        """Size that the file must have."""
        return self.offset + self.lines * self.samples * self.channels * np.dtype(self.dtype).itemsize

    def read(self, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """Numbers as the file has them, shape (lines, samples, channels)."""
        count, shape = self.channels, {
            "bsq": (self.channels, self.lines, self.samples),
            "bil": (self.lines, self.channels, self.samples),
            "bip": (self.lines, self.samples, self.channels),
        }[self.interleave]  # fmt: skip
        mapped = np.memmap(self.path, np.dtype(self.dtype), "r", self.offset, shape)
        if self.interleave == "bsq":
            return np.stack([mapped[k, lines, samples] for k in range(count)], axis=-1)
        block = mapped[lines, :, samples].swapaxes(1, 2) if self.interleave == "bil" else mapped[lines, samples]
        return np.array(block)


@dataclass(frozen=True, slots=True)
class Backplane:
    """A further number of each pixel, such as its longitude: band `channel` of a file of the same size."""

    source: Source
    channel: int
    long_name: str
    units: str

    def read(self, lines: slice, samples: slice) -> FloatArray:
        """Shape (lines, samples)."""
        return np.asarray(self.source.read(lines, samples)[..., self.channel], dtype=float)


@dataclass(frozen=True, slots=True)
class PixelFrame:
    """Where pixels lie: x = a s + b l + c, y = d s + e l + f of sample s and line l, corners counting from 0, and the
    coordinate system of x and y as WKT, '' where none is named."""

    transform: tuple[float, float, float, float, float, float]
    crs_wkt: str = ""

    def part(self, line: int, sample: int, step: int = 1) -> "PixelFrame":
        """The frame of every `step`-th pixel from one on; a pixel keeps its middle and grows."""
        a, b, c, d, e, f = self.transform
        shift = (step - 1) / 2
        s, row = sample - shift, line - shift
        moved = (a * step, b * step, a * s + b * row + c, d * step, e * step, d * s + e * row + f)
        return PixelFrame(moved, self.crs_wkt)

    @property
    def rotated(self) -> bool:
        """Whether lines and samples are not those of x and y."""
        return self.transform[1] != 0 or self.transform[3] != 0

    def middles(self, lines: FloatArray, samples: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x and y of middles of pixels."""
        a, b, c, d, e, f = self.transform
        s, row = samples + 0.5, lines + 0.5
        return a * s + b * row + c, d * s + e * row + f


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """What the user says of a cube where the file does not.

    `scale` : what numbers are divided by. `ignored` : number that stands for no value. `saturated` : number from which
    on a channel is saturated. `wavelengths`, `locations` : files; the second has longitude and latitude of each pixel.
    """

    wavelength_unit: WavelengthUnit | None = None
    scale: float | None = None
    ignored: float | None = None
    saturated: float | None = None
    wavelengths: str | None = None
    locations: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What a file says of itself, in its own order of its c channels and its own units; see `Cube`. None: not stated.

    Attributes
    ----------
    shape : lines and samples.
    wavelength, fwhm : (c,) in `unit`.
    bad : (c,) True for channels that the file calls bad.
    gain, offset : (c,) reflectance = gain number + offset.
    scale : what reflectances were multiplied by.
    ignored : numbers that stand for no value.
    names : of the channels.
    """

    name: str
    format: str
    source: Source
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    wavelength: FloatArray | None
    unit: str | None = None
    fwhm: FloatArray | None = None
    bad: BoolArray | None = None
    gain: FloatArray | None = None
    offset: FloatArray | None = None
    scale: float | None = None
    ignored: Sequence[float] = ()
    frame: PixelFrame | None = None
    names: Sequence[str] = ()
    backplanes: Mapping[str, Backplane] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    remarks: Sequence[str] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cube:
    """An image of spectra.

    Attributes
    ----------
    name, format : file, and `envi`, `m3`, `geotiff`, `netcdf` or `vnis`.
    shape : lines and samples.
    wavelength_nm, fwhm_nm : (c,) ascending; widths of the channels, None where unknown. [nm]
    bad : (c,) True for channels that the file calls bad.
    channels : (c,) place of each channel in the file.
    gain, offset : (c,) reflectance = gain number + offset.
    ignored, saturated : numbers that stand for no value; number from which on a channel is saturated, inf for none.
    frame : where pixels lie, None where the file does not say.
    backplanes : by name, further numbers of each pixel; `longitude` and `latitude` where they are known. [deg]
    inputs : name of each file to its SHA-256. remarks : what to know, one sentence each.
    """

    name: str
    format: str
    source: Source
    shape: tuple[int, int]
    wavelength_nm: FloatArray
    fwhm_nm: FloatArray | None
    bad: BoolArray
    channels: IndexArray
    gain: FloatArray
    offset: FloatArray
    ignored: tuple[float, ...]
    saturated: float
    frame: PixelFrame | None
    backplanes: Mapping[str, Backplane]
    inputs: Mapping[str, str]
    remarks: tuple[str, ...]

    @property
    def synthetic(self) -> bool:
        """Whether its file says that it is made up."""
        return any(SYNTHETIC in text for text in self.remarks)

    def read(self, lines: slice, samples: slice) -> tuple[FloatArray, npt.NDArray[np.uint8]]:
        """Reflectance (lines, samples, c), NaN where it cannot be used, and the flags of each pixel."""
        raw = self.source.read(lines, samples)
        values = np.ascontiguousarray(raw, dtype=np.float64)
        reflectance = np.empty((*values.shape[:2], self.channels.size))
        flags = np.empty(values.shape[:2], np.uint8)
        _decode(
            values.reshape(-1, values.shape[2]), self.channels, self.gain, self.offset, self.bad,
            np.array(self.ignored), self.saturated, reflectance.reshape(-1, self.channels.size), flags.reshape(-1),
        )  # fmt: skip
        return reflectance, flags


@compiled
def _decode(
    raw: FloatArray, channels: IndexArray, gain: FloatArray, offset: FloatArray, bad: BoolArray, ignored: FloatArray,
    saturated: float, reflectance: FloatArray, flags: npt.NDArray[np.uint8],
) -> None:  # fmt: skip
    """Fill reflectance (p, c) and flags (p,) from numbers (p, channels of the file)."""
    for p in range(raw.shape[0]):
        seen, flag = 0, 0
        for k in range(channels.size):
            number = raw[p, channels[k]]
            value = np.nan
            if not bad[k]:
                absent = not np.isfinite(number) or number <= -1e30
                for other in ignored:
                    absent = absent or number == other
                if absent:
                    flag |= 4
                elif number >= saturated:
                    flag |= 8
                else:
                    value = gain[k] * number + offset[k]
                    if value <= 0:
                        flag |= 16
                        value = np.nan
                    else:
                        seen += 1
            reflectance[p, k] = value
        flags[p] = flag if seen else flag | 1


def sha256_of(path: str) -> str:
    """Of a file that may not fit into memory."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def cube_of(layout: Layout, stated: Stated) -> Cube:
    """The cube of a file, checked: wavelengths in nm and ascending, numbers that are reflectances.

    Raises DataError for files without wavelengths or with those of several units, for stretched 8-bit pictures,
    rotated components, and numbers that are no reflectances; each with what to do.
    """
    _check_numbers(layout, stated)
    wavelength, remarks = _wavelengths(layout, stated)
    finite = np.isfinite(wavelength)
    order = np.argsort(np.where(finite, wavelength, np.inf), kind="stable")[: int(finite.sum())]
    gain = np.ones(finite.size) if layout.gain is None else layout.gain
    offset = np.zeros(finite.size) if layout.offset is None else layout.offset
    bad = np.zeros(finite.size, bool) if layout.bad is None else layout.bad
    in_nm = np.ones(finite.size) if layout.wavelength is None else wavelength / layout.wavelength
    divisor = stated.scale or layout.scale or 1.0
    marks = _as_stored([*layout.ignored, *([] if stated.ignored is None else [stated.ignored])], layout.dtype)
    parts = [layout.source.read(*where) for where in _looked_at(layout.shape)] if layout.dtype.kind == "f" else []
    if unnamed := unnamed_markers(parts, marks):
        remarks = [*remarks, f"{', '.join(f'{one:g}' for one in unnamed)} read as the mark of no data"]
    cube = Cube(
        name=layout.name, format=layout.format, source=layout.source, shape=layout.shape,
        wavelength_nm=wavelength[order],
        fwhm_nm=None if layout.fwhm is None else (layout.fwhm * in_nm)[order],
        bad=bad[order], channels=order.astype(np.intp),
        gain=gain[order] / divisor, offset=offset[order] / divisor,
        ignored=(*marks, *unnamed),
        saturated=_saturation(layout, stated), frame=layout.frame, backplanes=layout.backplanes,
        inputs=layout.inputs, remarks=(*layout.remarks, *remarks),
    )  # fmt: skip
    _check_order(cube)
    _check_level(cube, layout, stated)
    return cube


def _check_numbers(layout: Layout, stated: Stated) -> None:
    """Raise DataError for numbers that are no measurements, whatever their size."""
    lines, samples = layout.shape
    bands = 0 if layout.wavelength is None else len(layout.wavelength)
    scaled = stated.scale or layout.scale or layout.gain is not None
    rotated = next((name for name in layout.names if _ROTATED.match(name.strip())), "")
    for wrong, what in (
        (not 0 < min(lines, samples) <= lines * samples <= MOST_VALUES, f"{lines} lines and {samples} samples are no "
         "image; check the header"),
        (bands * samples > MOST_CELLS, f"{samples} samples of {bands} bands on a line, and at most "
         f"{MOST_CELLS / 1e6:.0f} million numbers are read of one; cut out a part, or check the header"),
        (layout.dtype.kind == "c", "holds complex numbers; a reflectance is a real one"),
        (layout.dtype.itemsize == 1 and not scaled, "holds 8-bit numbers without a scale: a picture stretched for "
         "display, whose numbers are no reflectances; get the file with physical values, or state `scale`"),
        (rotated, f"band '{rotated[:40]}' is a rotated component, no channel; give the cube before"),
    ):  # fmt: skip
        if wrong:
            raise DataError(f"{layout.name}: {what}")


def _wavelengths(layout: Layout, stated: Stated) -> tuple[FloatArray, list[str]]:
    """In the order of the file; NaN for channels without one. [nm]"""
    result = np.empty(0) if layout.wavelength is None else layout.wavelength
    finite = np.isfinite(result) & (result > 0)
    if finite.sum() < FEWEST_CHANNELS:
        raise DataError(
            f"{layout.name}: has {finite.sum() or 'no'} wavelengths; name a file with one for each band as "
            f"`wavelengths`, {FEWEST_CHANNELS} at least"
        )
    low, high = result[finite].min(), result[finite].max()
    if low < 100 < high and low * 50 < high:
        raise DataError(
            f"{layout.name}: wavelengths {low:g} to {high:g} are in several units; write all in nm, or name a file of "
            "them as `wavelengths`"
        )
    column = Column("wavelength", result[finite], 1, layout.unit)
    converted = np.full(result.shape, np.nan)
    try:
        converted[finite], _ = wavelength_nm(column, stated.wavelength_unit, layout.name)
    except DataError as error:
        if layout.unit is None or stated.wavelength_unit is not None:
            raise
        # A header that says micrometres over numbers of nanometres, or the other way round: the numbers decide.
        column = replace(column, unit=None)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LunarSciWarning)
            try:
                converted[finite], record = wavelength_nm(column, None, layout.name)
            except DataError:
                raise error from None
        unit = record["wavelength_unit"]
        warn(f"{layout.name}: says that wavelengths {low:g}-{high:g} are in {layout.unit}; read as {unit}")
    lost = int((~finite).sum())
    return converted, [f"{lost} channels without a wavelength are left out"] if lost else []


def _check_order(cube: Cube) -> None:
    """Raises DataError for wavelengths that come twice or too few good channels; warns of odd order."""
    same = np.flatnonzero(np.diff(cube.wavelength_nm) == 0)
    if same.size:
        value = cube.wavelength_nm[same[0]]
        raise DataError(
            f"{cube.name}: two bands have the wavelength {value:.10g} nm; mark one of them bad or leave it out"
        )
    steps = np.diff(cube.channels)
    if not ((steps > 0).all() or (steps < 0).all()):
        warn(f"{cube.name}: wavelengths are in no order; bands are sorted by them")
    if (~cube.bad).sum() < FEWEST_CHANNELS:
        raise DataError(f"{cube.name}: {(~cube.bad).sum()} good channels; a spectrum needs {FEWEST_CHANNELS}")


def _as_stored(values: Sequence[float], dtype: np.dtype[Any]) -> tuple[float, ...]:
    """Values as numbers of the file's type, so that they equal what stands there, less those that it cannot hold."""
    result = []
    for value in values:
        with np.errstate(over="ignore", invalid="ignore"):
            if dtype.kind == "f":
                result.append(float(np.asarray(value).astype(dtype)))
            elif np.isfinite(value) and np.iinfo(dtype).min <= value <= np.iinfo(dtype).max:
                result.append(float(value))
    return tuple(dict.fromkeys(result))


def _saturation(layout: Layout, stated: Stated) -> float:
    """What is stated, or the largest number that whole numbers of the file's type can be."""
    if stated.saturated is not None:
        return stated.saturated
    return float(np.iinfo(layout.dtype).max) if layout.dtype.kind in "iu" and layout.dtype.itemsize < 8 else np.inf


def _looked_at(shape: tuple[int, int]) -> list[tuple[slice, slice]]:
    """A few lines of an image, from its first to its last."""
    lines = np.unique(np.linspace(0, shape[0] - 1, LINES_LOOKED_AT).astype(int))
    return [(slice(line, line + 1), slice(0, shape[1])) for line in lines]


def _check_level(cube: Cube, layout: Layout, stated: Stated) -> None:
    """Raise DataError where numbers of a few lines are no reflectances."""
    seen = np.concatenate([cube.read(*where)[0].ravel() for where in _looked_at(cube.shape)])
    if not (seen := seen[np.isfinite(seen)]).size:
        return
    median = float(np.median(seen))
    whole = layout.dtype.kind in "iu" and not (stated.scale or layout.scale or layout.gain is not None)
    if median > MAX_FRACTION or whole:
        guess = "percent have `scale` 100; " if median < 100 and not whole else "10000 is common; "
        raise DataError(
            f"{cube.name}: has numbers of about {median:.4g}, no reflectances; scaled ones need `scale` ({guess}what "
            f"they were multiplied by); of radiance {CALIBRATE}"
        )
