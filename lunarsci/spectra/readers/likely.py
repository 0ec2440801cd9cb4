"""Spectra whose numbers are likely not what they should be: told, a line for each kind; constant ones are refused."""

from dataclasses import replace

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.kept_blocks import spans
from lunarsci.spectra.collection import SpectrumRows

LARGE_ERROR = 0.3
"""Of the value, in more than half of the channels. Assumed. [-]"""
BRIGHTEST = 1.0
"""Median reflectance factor; that of a perfectly white, diffuse surface, by definition. [-]"""
LONE_STEP = 0.5
"""How far ln R of a single channel lies from both its neighbours, to the same side: a factor of 1.65. Assumed; no
channel of 560 measured spectra of the Moon, of meteorites and minerals does. [-]"""
IN_STEPS = 10.0
"""And by how many median steps between neighbours, so that noise is not taken for single channels; assumed. [-]"""
FEWEST = 10
"""Usable channels of a spectrum that is judged at all."""
TOO_SMOOTH = 5.0
"""Times the scatter from channel to channel that errors are, in the median, before it is said that they cannot be
independent; assumed. Measured: 1.2 of calibrated spectra of VNIS, 12 to 95 of means of samples with their standard
deviation."""
_AT_ONCE = 256
SAID = {
    "large_error": f"spectra with errors above {LARGE_ERROR:.0%} of most values; are errors in percent, values not?",
    "smooth": "spectra with errors 5 times their scatter from channel to channel and more, taken as independent; if "
    "channels share them, as those of samples, name the column NAME_systematic_samples",
    "bright": "spectra with a median reflectance above 1; are they in percent, or no reflectance?",
    "constant": "spectra with the same value in all channels",
}


def unlikely(rows: SpectrumRows, file: str) -> list[str]:
    """A line for each kind of what is unlikely, with how many spectra and the first of them.

    Raises DataError where every spectrum of the file is constant.
    """
    found: dict[str, list[int]] = {name: [] for name in SAID}
    for block in spans(len(rows), _AT_ONCE):
        own = slice(block.start, block.stop)
        usable, values = ~rows.mask[own], rows.reflectance[own]
        sigma = None if rows.uncertainty is None else rows.uncertainty[own]
        for name, odd in _odd(values, usable, sigma).items():
            found[name] += (block.start + np.flatnonzero(odd)).tolist()
    if len(found["constant"]) == len(rows):
        raise DataError(f"{file}: the same value in all channels; give measured reflectances")
    return [f"{file}: {SAID[name]}: {len(k)}, first '{rows.ids[k[0]]}'" for name, k in found.items() if k]


def _odd(values: FloatArray, usable: BoolArray, sigma: FloatArray | None) -> dict[str, BoolArray]:
    """By kind, which of n spectra are so. (n,)"""
    count = usable.sum(axis=1)
    enough = count >= FEWEST
    with np.errstate(all="ignore"):
        lowest = np.where(usable, values, np.inf).min(axis=1, initial=np.inf)
        highest = np.where(usable, values, -np.inf).max(axis=1, initial=-np.inf)
        bright = 2 * (usable & (values > BRIGHTEST)).sum(axis=1) > count
        large = np.zeros(len(values), bool)
        if sigma is not None:
            large = 2 * (usable & (sigma > LARGE_ERROR * values)).sum(axis=1) > count
    odd = {"large_error": large, "bright": bright, "constant": lowest == highest}
    judged = {name: enough & each for name, each in odd.items()}
    if sigma is not None:
        judged["smooth"] = np.array(
            [n and _smooth(v[u], s[u]) for n, v, u, s in zip(enough, values, usable, sigma, strict=True)]
        )
    return judged


def without_lone(rows: SpectrumRows) -> tuple[SpectrumRows, list[int]]:
    """The spectra with single channels masked that lie far from both their neighbours, and which spectra had some.

    One such channel moves a band centre by ten times its error, if it lies in the band.
    """
    mask, odd = rows.mask, list[int]()
    for row, usable in enumerate(~rows.mask):
        if usable.sum() >= FEWEST and (found := _lone(rows.reflectance[row][usable])).any():
            mask = mask.copy() if not odd else mask
            mask[row, np.flatnonzero(usable)[found]] = True
            odd.append(row)
    return (replace(rows, mask=mask) if odd else rows), odd


def _lone(values: FloatArray) -> BoolArray:
    """Which channels lie far from both their neighbours, to the same side. (c,)"""
    step = np.diff(np.log(values))
    least = np.minimum(np.abs(step[:-1]), np.abs(step[1:]))
    far = least > max(LONE_STEP, IN_STEPS * float(np.median(np.abs(step))))
    return np.concatenate([[False], far & (step[:-1] * step[1:] < 0), [False]])


def _smooth(values: FloatArray, sigma: FloatArray) -> bool:
    """Whether errors are far larger than the scatter about straight lines between neighbours: 6 variances of it."""
    scatter = float(np.median(np.abs(np.diff(values, 2)))) / (0.6745 * 6**0.5)
    return 0 < scatter * TOO_SMOOTH < float(np.median(sigma))
