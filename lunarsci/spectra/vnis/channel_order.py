"""Whether channels are where they should be: shifted or repeated ones, and blocks of another scale.

Limits are what 88 Chang'E-4 spectra have (none of them exceeds one), with a margin; the figures below were found by
spoiling these spectra.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.spectra.vnis.channels import SUB_BAND_STEP_NM, VNIR_SUB_BANDS_NM, Detector

_SHIFTS = (-2, -1, 1, 2)
_LARGEST_SHIFT = 2
_CLIPPED = 4.0
"""Second differences beyond so many times their median are single outliers; assumed."""
_CLEARER, _SURE = 0.1, 4.0
"""How much better lines of the Sun must fit elsewhere, as a difference of correlations, and how well: in standard
deviations of what noise of n channels gives, 1 / sqrt(n). Measured: of the 88 spectra all fit best where they are, VNIR
by 0.059 at least, SWIR by 0.019. Shifted by a channel up or down, 85 and 85 of 88 are found in VNIR, 79 and 77 in SWIR.
[-]"""
_LEAST = 40
"""Channels that are needed to tell; assumed."""


def displaced_channels(radiance: FloatArray, irradiance: FloatArray) -> int:
    """By how many channels the lines of the Sun lie off their place, towards longer wavelengths; 0 if they do not.

    Radiance is sunlight times something smooth: second differences of ln L from channel to channel follow those of
    ln E0. `radiance` and `irradiance` have one shape (n,), NaN where a channel is not used; 1 and 2 are tried.
    """
    inner = slice(_LARGEST_SHIFT, radiance.size - _LARGEST_SHIFT)
    with np.errstate(invalid="ignore", divide="ignore"):
        bends = np.diff(np.log(radiance[inner]), n=2)
    good = np.isfinite(bends)
    if good.sum() < _LEAST:
        return 0
    limit = _CLIPPED * np.median(np.abs(bends[good]))
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
    """How a step is looked for: channels on either side, ln R that is too much, and what is too much beside the
    median step of the spectrum where it is also more than `least`."""

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
_SITES_NM: dict[Detector, tuple[float, ...]] = {"vnir": VNIR_SUB_BANDS_NM, "swir": (SUB_BAND_STEP_NM,)}
_AROUND_NM = 30.0
"""Around the ends of sub-bands, where steps are usual, none is looked for; assumed. [nm]"""


def scale_step(detector: Detector, wavelength_nm: FloatArray, reflectance: FloatArray) -> tuple[float, float]:
    """The largest step between neighbouring channels that no rock has, as ln R, and where; (0, 0) if there is none.

    A straight line with a jump is fitted to ln R of some channels on either side of every place but the ends of
    sub-bands. Arrays have one shape (n,), NaN where a channel is not used. [nm]
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        known = np.flatnonzero(np.isfinite(np.log(reflectance)))
    ln, nm = np.log(reflectance[known]), wavelength_nm[known]
    worst = (0.0, 0.0)
    for edge in _EDGES[detector]:
        side = edge.channels
        if ln.size < 4 * side:
            continue
        steps, at = _steps(ln, side), (nm[side - 1 : ln.size - side] + nm[side : ln.size - side + 1]) / 2
        free = np.all([np.abs(at - site) > _AROUND_NM for site in _SITES_NM[detector]], axis=0)
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
    found: FloatArray = np.lib.stride_tricks.sliding_window_view(ln, 2 * side) @ weights
    return found


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


_STEP = 16
"""Of every so many lines and samples the numbers are compared first; those that agree are compared whole."""


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


_RUN = 3
"""Rows of a run: fewer equal ones are found by chance; assumed."""


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
