"""Channels that cannot be radiances of lit ground: too bright, too dark, or far from their neighbours."""

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import BoolArray, FloatArray

__all__ = ["check_jumps", "outlying"]

_RANGE = (0.001, 2.0)
"""Reflectance factors that lit lunar ground may have; assumed. [-]"""
_NEIGHBOURS = 11
_FAR = 0.3
"""ln R this far from the median of eleven channels is no rock: the steepest of 172 laboratory spectra (RELAB, 5 nm)
deviates by less than 0.1. [-]"""
_SIDE = 5


def outlying(reflectance: FloatArray) -> BoolArray:
    """True for channels outside 0.001-2 or more than a third off the median of their neighbours; shape (n,)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        absurd = np.isfinite(reflectance) & ~((reflectance >= _RANGE[0]) & (reflectance <= _RANGE[1]))
        ln = np.log(np.where(absurd | ~(reflectance > 0), np.nan, reflectance))
    known = np.flatnonzero(np.isfinite(ln))
    if known.size < _NEIGHBOURS:
        return absurd
    padded = np.pad(ln[known], _NEIGHBOURS // 2, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS), axis=1)
    far = np.zeros_like(absurd)
    far[known] = np.abs(ln[known] - middle) > _FAR
    return np.asarray(absurd | far, dtype=np.bool_)


def check_jumps(id: str, name: str, wavelength_nm: FloatArray, reflectance: FloatArray) -> None:
    """Raise DataError where five channels and the next five differ by more than a third: blocks of another scale."""
    known = np.flatnonzero(np.isfinite(reflectance))
    if known.size < 2 * _SIDE:
        return
    middle = np.median(np.lib.stride_tricks.sliding_window_view(np.log(reflectance[known]), _SIDE), axis=1)
    jump = np.abs(middle[_SIDE:] - middle[:-_SIDE])
    worst = int(jump.argmax())
    if jump[worst] > _FAR:
        place = wavelength_nm[known[worst + _SIDE]]
        share = 100 * (np.exp(jump[worst]) - 1)
        raise DataError(
            f"{id}: {name} jumps by {share:.0f} % near {place:g} nm, which no rock does; fetch its data file again"
        )
