"""Channels of VNIS: wavelengths, widths, noise, the SWIR field of view, and whether all are where they should be.

Shifted or repeated channels, and blocks of another scale: limits are what 88 Chang'E-4 spectra have (none of them
exceeds one), with a margin; the figures below were found by spoiling these spectra.
"""

from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, robust_scatter
from lunarsci.errors import ParameterError
from lunarsci.io.tables import table_rows

Detector = Literal["vnir", "swir"]
VNIR_NM: FloatArray = np.arange(450.0, 946.0, 5.0)
"""The 100 channels of the CMOS imager: Li et al. (2019), Rev. Sci. Instrum. 90, 10.1063/1.5089737, and the product
labels. [nm]"""
SWIR_NM: FloatArray = np.arange(900.0, 2396.0, 5.0)
"""The 300 channels of the single-pixel detector: Li et al. (2019), 10.1063/1.5089737, and the product labels. [nm]"""
JOIN_NM = 900.0
"""First channel that the spliced spectrum takes from the SWIR detector; assumed. [nm]"""
SPLICED_NM: FloatArray = np.arange(450.0, 2396.0, 5.0)
"""The 390 channels of a spliced spectrum: 90 of the imager, 300 of the SWIR detector; see `JOIN_NM`. [nm]"""
SUB_BAND_STEP_NM = 1377.5
"""Between 1375 and 1380 nm the SWIR filter changes its sub-band, as its channels' times in the labels (CNSA 2020) and
`vnis_fwhm.csv` show. [nm]"""
VNIR_SUB_BANDS_NM = (632.5, 757.5)
"""So does that of VNIR, twice: measured, as steps of the 88 public spectra. [nm]"""
CUBE_SHAPE = (100, 256, 256)
"""Bands, lines, samples of the image cube."""
IMAGE_NM = 750.0
"""Channel of pictures and albedos, as that of the Moon mostly is: Lucey et al. (2000), 10.1029/1999JE001117. [nm]"""
FOOTPRINT = (127.0, 97.0, 53.8)
"""Line and sample (from 0) of the centre and radius of the SWIR field of view in the VNIR image, as the product labels
state it (CNSA 2020, Lunar and Planetary Data Release System; line 128, sample 98, counted from 1). [px]"""
TABLES = ("vnis_fwhm.csv", "vnis_noise.csv")
_FWHM, _NOISE = TABLES


_SHIFTS = (-2, -1, 1, 2)
_LARGEST_SHIFT = 2
_CLEARER, _SURE = 0.1, 4.0
"""How much better lines of the Sun must fit elsewhere, as a difference of correlations, and how well: in standard
deviations of what noise of n channels gives, 1 / sqrt(n). Measured: of the 88 spectra all fit best where they are, VNIR
by 0.059 at least, SWIR by 0.019. Shifted by a channel up or down, 85 and 85 of 88 are found in VNIR, 79 and 77 in SWIR.
[-]"""
_SITES_NM: dict[Detector, tuple[float, ...]] = {"vnir": VNIR_SUB_BANDS_NM, "swir": (SUB_BAND_STEP_NM,)}
_STEP = 16
"""Of every so many lines and samples the numbers are compared first; those that agree are compared whole."""
_RUN = 3
"""Rows of a run: fewer equal ones are found by chance; assumed."""


def fwhm_nm(wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Full width at half maximum of the channels of one detector. [nm]

    Parameters
    ----------
    wavelength_nm : shape (n,), within 450-945 nm (vnir) or 900-2395 nm (swir).

    Raises ParameterError outside these ranges. Source: `vnis-fwhm` in `sources.toml`.
    """
    names = ("cubic_nm_per_um3", "quadratic_nm_per_um2", "linear_nm_per_um", "constant_nm")
    a, b, c, d = _by_channel(_FWHM, wavelength_nm, detector, names)
    x = np.asarray(wavelength_nm, dtype=float) / 1000
    return ((a * x + b) * x + c) * x + d


def random_noise(wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Relative standard deviation of a footprint mean from one observation to the next; same rules as `fwhm_nm`. [-]"""
    return _by_channel(_NOISE, wavelength_nm, detector, ("random_relative",))[0]


def fixed_pattern(wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Relative standard deviation of what all spectra share, channel by channel; same rules as `fwhm_nm`. [-]"""
    return _by_channel(_NOISE, wavelength_nm, detector, ("fixed_pattern_relative",))[0]


def footprint_mask() -> BoolArray:
    """Pixels of the VNIR image that the SWIR detector sees; shape (256, 256), 9085 of them True."""
    line, sample, radius = FOOTPRINT
    lines, samples = np.ogrid[: CUBE_SHAPE[1], : CUBE_SHAPE[2]]
    mask: BoolArray = (lines - line) ** 2 + (samples - sample) ** 2 <= radius**2
    return mask


def footprint_ring() -> tuple[FloatArray, FloatArray]:
    """Samples and lines of the edge of the SWIR field of view in the VNIR image. (181,), (181,) [px]"""
    turn, (line, sample, radius) = np.linspace(0, 2 * np.pi, 181), FOOTPRINT
    return sample + radius * np.cos(turn), line + radius * np.sin(turn)


def _by_channel(table: str, wavelength_nm: FloatArray, detector: Detector, names: tuple[str, ...]) -> list[FloatArray]:
    """Columns of a table at channels, each from the row whose wavelengths hold it; of the shape of the channels."""
    wavelength = np.asarray(wavelength_nm, dtype=float)
    rows = [row for row in table_rows(table) if row["detector"] == detector]
    starts = np.array([float(row["from_nm"]) for row in rows])
    last = float(rows[-1]["to_nm"])
    if not ((wavelength >= starts[0]) & (wavelength <= last)).all():
        raise ParameterError(f"the {detector.upper()} detector has channels from {starts[0]:g} to {last:g} nm only")
    place = np.searchsorted(starts, wavelength, side="right") - 1
    return [np.array([float(row[name]) for row in rows])[place] for name in names]


def displaced_channels(radiance: FloatArray, irradiance: FloatArray) -> int:
    """By how many channels the lines of the Sun lie off their place, towards longer wavelengths; 0 if they do not.

    Radiance is sunlight times something smooth: second differences of ln L from channel to channel follow those of
    ln E0. `radiance` and `irradiance` have one shape (n,), NaN where a channel is not used; 1 and 2 are tried. Outliers
    count no more than what `SIGNIFICANCE` of normal ones exceed.
    """
    inner = slice(_LARGEST_SHIFT, radiance.size - _LARGEST_SHIFT)
    with np.errstate(invalid="ignore", divide="ignore"):
        bends = np.diff(np.log(radiance[inner]), n=2)
    good = np.isfinite(bends)
    if not good.any():
        return 0
    limit = NormalDist().inv_cdf(1 - SIGNIFICANCE / 2) * robust_scatter(bends[good], 0.0)
    seen = np.clip(bends[good], -limit, limit)
    fits = {}
    for shift in (0, *_SHIFTS):
        moved = irradiance[inner.start - shift : inner.stop - shift]
        sun = np.diff(np.log(moved), n=2)[good]
        size = float(np.sqrt((seen @ seen) * (sun @ sun)))
        fits[shift] = float(seen @ sun) / size if size > 0 else 0.0
    best = max(fits, key=lambda shift: fits[shift])
    sure = fits[best] > fits[0] + _CLEARER and fits[best] > _SURE / np.sqrt(good.sum())
    return best if sure else 0


@dataclass(frozen=True, slots=True)
class _Edge:
    """How a step is looked for, and from which size on it counts.

    Attributes
    ----------
    channels : on either side.
    most : size that is too much. [ln R]
    times, least : a step is too much, too, that is so many times the median step of the spectrum and more than `least`.
        [-, ln R]
    """

    channels: int
    most: float
    times: float = np.inf
    least: float = np.inf


_EDGES: dict[Detector, tuple[_Edge, ...]] = {
    "vnir": (_Edge(5, 0.21, 9.0, 0.08),),
    "swir": (_Edge(5, 0.09), _Edge(8, 0.065)),
}
"""Measured, largest of the 88 spectra: VNIR 0.185 and 8.2 times the median, SWIR 0.077 with 5 channels on either side
and 0.054 with 8; of 409 laboratory spectra at 5 nm 0.025 and 0.041. [-]"""


def scale_step(detector: Detector, wavelength_nm: FloatArray, reflectance: FloatArray) -> tuple[float, float]:
    """The largest step between neighbouring channels that no rock has, as ln R, and where; (0, 0) if there is none.

    A straight line with a jump is fitted to ln R of some channels on either side of every place, but where these reach
    over the end of a sub-band. Arrays have one shape (n,), NaN where a channel is not used. [nm]
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        finite = np.flatnonzero(np.isfinite(np.log(reflectance)))
    ln, nm = np.log(reflectance[finite]), wavelength_nm[finite]
    worst = (0.0, 0.0)
    for edge in _EDGES[detector]:
        side = edge.channels
        if ln.size < 4 * side:
            continue
        steps, at = _steps(ln, side), (nm[side - 1 : ln.size - side] + nm[side : ln.size - side + 1]) / 2
        free = np.all([np.abs(at - site) > 5 * side for site in _SITES_NM[detector]], axis=0)
        size = np.abs(steps[free])
        limit = min(edge.most, max(edge.least, edge.times * float(np.median(size))))
        place = int(size.argmax())
        if size[place] > max(limit, abs(worst[0])):
            worst = float(steps[free][place]), float(at[free][place])
    return worst


def _steps(ln: FloatArray, side: int) -> FloatArray:
    """The jump of a straight line with a jump through `side` channels and the next ones; shape (n - 2 side + 1,)."""
    x = np.arange(2 * side) - side + 0.5
    design = np.stack([np.ones(2 * side), x, (x > 0).astype(float)], axis=1)
    weights = np.linalg.pinv(design)[2]
    result: FloatArray = np.lib.stride_tricks.sliding_window_view(ln, 2 * side) @ weights
    return result


def channel_doubts(
    detector: Detector,
    wavelength_nm: FloatArray,
    radiance: FloatArray,
    irradiance: FloatArray,
    reflectance: FloatArray,
) -> list[str]:
    """What speaks against the channels of one detector, one sentence each; arrays have one shape (n,)."""
    doubts, name = [], detector.upper()
    if shift := displaced_channels(radiance, irradiance):
        far = "a channel" if abs(shift) == 1 else f"{abs(shift)} channels"
        doubts.append(f"lines of the Sun lie {far} off their place in {name}: its channels are shifted or mixed")
    step, at_nm = scale_step(detector, wavelength_nm, reflectance)
    if step:
        doubts.append(f"{name} changes by {100 * np.expm1(step):+.1f} % at {at_nm:g} nm, more than between channels")
    return doubts


def equal_frames(cube: npt.NDArray[np.float32]) -> tuple[int, int] | None:
    """Two images with the same numbers, by their places in the cube; None if all differ, or are of one value."""
    seen: dict[bytes, int] = {}
    for band, frame in enumerate(cube):
        sample = frame[::_STEP, ::_STEP]
        if not (sample != sample[0, 0]).any() or np.isnan(sample).all():
            continue
        other = seen.setdefault(sample.tobytes(), band)
        if other != band and np.array_equal(cube[other], frame, equal_nan=True):
            return other, band
    return None


def repeated_rows(radiance: FloatArray) -> tuple[int, int] | None:
    """First rows (from 0) of two runs of three or more equal numbers one after the other; None if there are none.

    Runs of one value, and what is no number or not above 0, do not count.
    """
    seen: dict[tuple[float, ...], int] = {}
    for row in range(radiance.size - _RUN + 1):
        run = tuple(radiance[row : row + _RUN].tolist())
        if len(set(run)) < _RUN or not all(value > 0 for value in run):
            continue
        other = seen.setdefault(run, row)
        if other != row:
            return other, row
    return None
