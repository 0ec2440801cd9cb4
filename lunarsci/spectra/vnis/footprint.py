"""Radiance of the lit ground inside the SWIR field of view: mean, scatter and count over the image's pixels."""

from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.spectra.vnis.channels import JOIN_NM, VNIR_NM, footprint_mask
from lunarsci.spectra.vnis.observation import Cube

SHADOW_BAND_NM = 465.0
"""Shadows are told in this channel (Ding et al. 2024). [nm]"""
_PLATEAU_PIXELS = 20
"""So many pixels of exactly the largest value of a frame are a clipped frame; assumed."""
_MOST_LOST = 0.05
"""A channel in which more of the lit pixels than this share are clipped, or have no value, is not used; the pixels
clipped in the others are left out of all, so that every channel averages the same ground. Assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Statistics over the footprint's pixels.

    Attributes
    ----------
    inside, shadowed, invalid : shape (256, 256); the field of view, its shadowed pixels, its pixels that are not used
        since they have no value at 465 nm or are clipped in some channel.
    mean, scatter : shape (100,); mean and standard deviation of radiance over lit, valid pixels; NaN where too few.
        [W m-2 sr-1 nm-1]
    count : shape (100,); number of pixels in them.
    clipped : shape (100,); lit pixels that are saturated. negative : lit pixels left out in a channel for a
        radiance of 0 or below: holes of a download are zeros.
    constant : shape (100,); frames without any contrast, which no camera takes.
    dilution : mean over all valid pixels of the field of view over that of the lit ones, in the channels that both
        detectors have: what shadows take away from a detector that averages over the field of view. [-]
    """

    inside: BoolArray
    shadowed: BoolArray
    invalid: BoolArray
    mean: FloatArray
    scatter: FloatArray
    count: IntArray
    clipped: IntArray
    negative: IntArray
    constant: BoolArray
    dilution: float

    @property
    def lit(self) -> BoolArray:
        """Pixels of the field of view that are neither shadowed nor invalid; shape (256, 256)."""
        return self.inside & ~self.shadowed & ~self.invalid


def average_footprint(cube: Cube, shadow_radiance: float) -> Footprint:
    """Average the pixels inside the field of view that are brighter than `shadow_radiance` at 465 nm."""
    inside = footprint_mask()
    dark_band = cube[int(np.flatnonzero(VNIR_NM == SHADOW_BAND_NM)[0])]
    invalid = inside & ~np.isfinite(dark_band)
    with np.errstate(invalid="ignore"):
        shadowed = inside & ~invalid & (dark_band < shadow_radiance)
    limits, constant = saturated_pixels(cube)
    lit = inside & ~shadowed & ~invalid
    clipped, usable, clipped_counts = _clipped(cube, lit, limits)
    invalid |= clipped
    lit &= ~invalid
    values = cube[:, lit].astype(np.float64)
    with np.errstate(invalid="ignore"):
        negative = values <= 0
        valid = np.isfinite(values) & ~negative
    count = valid.sum(axis=1)
    enough = usable & (count >= max((1 - _MOST_LOST) * lit.sum(), 1))
    values[~valid] = 0
    size = np.where(enough, count, 1)
    mean = values.sum(axis=1) / size
    squares = np.einsum("ij,ij->i", values, values) / size
    scatter = np.sqrt(np.maximum(squares - mean**2, 0) * size / np.maximum(size - 1, 1))
    return Footprint(
        inside,
        shadowed,
        invalid,
        np.where(enough, mean, np.nan),
        np.where(enough, scatter, np.nan),
        count,
        clipped_counts,
        negative.sum(axis=1),
        constant,
        _dilution(cube, inside & ~invalid, lit),
    )


def _clipped(cube: Cube, lit: BoolArray, limits: FloatArray) -> tuple[BoolArray, BoolArray, IntArray]:
    """Pixels clipped in a channel that is used, shape (256, 256); channels used; count of clipped pixels by channel."""
    anywhere = np.zeros_like(lit)
    usable, counts = np.ones(len(cube), dtype=bool), np.zeros(len(cube), dtype=np.int64)
    for band in np.flatnonzero(np.isfinite(limits)):
        clipped = lit & (cube[band] >= limits[band])
        counts[band] = clipped.sum()
        usable[band] = counts[band] <= _MOST_LOST * lit.sum()
        if usable[band]:
            anywhere |= clipped
    return anywhere, usable, counts


def shadow_limit_shift(cube: Cube, footprint: Footprint, shadow_radiance: float) -> tuple[FloatArray, float]:
    """How ln of the mean, shape (100,), and of the dilution change by half the way from 0.5 to 1.5 times the limit. [-]

    Zero where no pixel lies between these limits, NaN where one of them leaves nothing lit.
    """
    dark_band = cube[int(np.flatnonzero(VNIR_NM == SHADOW_BAND_NM)[0])]
    candidates = footprint.inside & ~footprint.invalid
    low, high = (candidates & (dark_band >= factor * shadow_radiance) for factor in (0.5, 1.5))
    if (low == high).all():
        return np.zeros(len(cube)), 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.log(_finite_mean(cube[:, high]) / _finite_mean(cube[:, low])) / 2
        dilution = np.log(_dilution(cube, candidates, high) / _dilution(cube, candidates, low)) / 2
    return shift, float(dilution)


def registration_error(cube: Cube, footprint: Footprint) -> float:
    """Relative error of what SWIR sees for its field of view being known to a pixel only. [-]

    Root mean square change of the mean over all valid pixels when the field is moved by one pixel in four directions.
    """
    overlap = cube[VNIR_NM >= JOIN_NM]
    valid = np.isfinite(overlap).all(axis=0) & (overlap > 0).all(axis=0)
    brightness = np.where(valid, overlap.mean(axis=0, dtype=np.float64), 0.0)
    fields = [footprint.inside, *(np.roll(footprint.inside, step, axis) for axis in (0, 1) for step in (-1, 1))]
    means = np.array([brightness[field & valid].mean() if (field & valid).any() else np.nan for field in fields])
    return float(np.sqrt(np.mean((means[1:] / means[0] - 1) ** 2)))


def _dilution(cube: Cube, inside: BoolArray, lit: BoolArray) -> float:
    """NaN where nothing is lit, or no image from 900 nm on has a value; pixels without one are left out."""
    overlap = cube[VNIR_NM >= JOIN_NM]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = _finite_mean(overlap[:, inside]) / _finite_mean(overlap[:, lit])
    finite = np.isfinite(ratio)
    return float(np.median(ratio[finite])) if finite.any() else float("nan")


def _finite_mean(values: Cube) -> FloatArray:
    finite = np.isfinite(values)
    mean: FloatArray = np.where(finite, values, 0).sum(axis=1, dtype=np.float64) / finite.sum(axis=1)
    return mean


def saturated_pixels(cube: Cube) -> tuple[FloatArray, BoolArray]:
    """Radiance from which a frame is clipped, shape (100,), infinite where it is not; and which frames are flat.

    Clipping shows as many pixels of exactly the largest value. A frame of one value is not clipped but made up.
    """
    frames = cube.reshape(cube.shape[0], -1)
    largest = np.fmax.reduce(frames, axis=1)
    for band in np.flatnonzero(np.isposinf(largest)):  # one infinite pixel must not hide a clipped frame
        largest[band] = np.fmax.reduce(frames[band], where=np.isfinite(frames[band]), initial=-np.inf)
    flat = np.fmin.reduce(frames, axis=1) == largest
    plateau = (frames == largest[:, None]).sum(axis=1) >= _PLATEAU_PIXELS
    limits = np.where(plateau & ~flat & (largest > 0), largest.astype(np.float64), np.inf)
    return limits, flat
