"""Spectra whose numbers are likely not what they should be: told, a line for each kind; constant ones are refused."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from lunarsci.arrays import BoolArray, FloatArray, spans
from lunarsci.errors import DataError
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
STEP_CHANNELS, STEP_SURE, LEAST_STEP = 5, 10.0, 0.01
"""Channels on either side of a step, errors by which straight lines through them miss each other, and the least ratio
by which they do, in ln R. Assumed: none of 471 spectra of laboratories has one (7.9 at most), and steps of 3 % at
1000 nm and -3 % at 1400 nm put into them are found in 67 and 76 %, nine in ten where channels are 5 nm apart."""
STEP_SHARE, STEP_BESIDE, STEP_GAP = 0.6, 0.35, 3.0
"""Least share of a step that lies between two channels, the most that lies between those beside them, and how many
times the median channel distance they are apart at most; assumed."""
MOST_STEPS = 2
"""Steps of a spectrum: field spectrometers have three detectors at most; assumed."""
_AT_ONCE = 256
SAID = {
    "large_error": f"spectra with errors above {LARGE_ERROR:.0%} of most values; are errors in percent, values not?",
    "smooth": "spectra with errors 5 times their scatter from channel to channel and more, taken as independent; if "
    "channels share them, as those of samples, name the column NAME_systematic_samples",
    "bright": "spectra with a median reflectance above 1; are they in percent, or no reflectance?",
    "constant": "spectra with the same value in all channels",
    "step": "spectra with a step between two channels, as where detectors meet, read with the channels below it scaled "
    "to those above",
}


def unlikely(rows: SpectrumRows, file: str) -> list[str]:
    """A line for each kind of what is unlikely, with how many spectra and the first of them.

    Raises DataError where every spectrum of the file is constant.
    """
    found: dict[str, list[int]] = {name: [] for name in SAID}
    where = ""
    for block in spans(len(rows), _AT_ONCE):
        own = slice(block.start, block.stop)
        usable, values = ~rows.mask[own], rows.reflectance[own]
        sigma = None if rows.uncertainty is None else rows.uncertainty[own]
        for name, odd in _odd(values, usable, sigma).items():
            found[name] += (block.start + np.flatnonzero(odd)).tolist()
        for row, step, place in _steps(rows.wavelength_nm, values, usable):
            where = where or f" by {step:+.1%} at {place:.0f} nm"
            found["step"].append(block.start + row)
    if len(found["constant"]) == len(rows):
        raise DataError(f"{file}: the same value in all channels; give measured reflectances")
    return [
        f"{file}: {SAID[name]}: {len(k)}, first '{rows.ids[k[0]]}'{where if name == 'step' else ''}"
        for name, k in found.items()
        if k
    ]


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


def cleaned(parts: Sequence[SpectrumRows]) -> tuple[list[SpectrumRows], list[str]]:
    """The spectra without single channels far off their neighbours, and what to say of it."""
    kept, odd = list[SpectrumRows](), list[str]()
    for rows in parts:
        clean, which = without_lone(rows)
        kept.append(clean)
        odd += [rows.ids[row] for row in which]
    lone = "spectra with single channels a factor of 1.65 and more off both neighbours, which are left out"
    return kept, [f"{lone}: {len(odd)}, first '{odd[0]}'"] if odd else []


def without_steps(rows: SpectrumRows) -> SpectrumRows:
    """The spectra with what lies below a step scaled to what lies above, as detectors are spliced.

    The largest step of each, then the next, of `MOST_STEPS`.
    """
    values, scaled = rows.reflectance.copy(), dict[int, FloatArray]()
    for block in spans(len(rows), _AT_ONCE):
        own = slice(block.start, block.stop)
        for _ in range(MOST_STEPS):
            for row, step, place in _steps(rows.wavelength_nm, values[own], ~rows.mask[own]):
                gain = np.where(rows.wavelength_nm < place, 1.0 + step, 1.0)
                values[block.start + row] *= gain
                scaled[block.start + row] = scaled.get(block.start + row, 1.0) * gain
    sigma = None if rows.uncertainty is None else rows.uncertainty.copy()
    systematic = dict(rows.systematic)
    for row, gain in scaled.items():
        if sigma is not None:
            sigma[row] *= gain
        if row in systematic:
            systematic[row] = {name: one * gain for name, one in systematic[row].items()}
    return replace(rows, reflectance=values, uncertainty=sigma, systematic=systematic)


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


def _steps(wavelength_nm: FloatArray, values: FloatArray, usable: BoolArray) -> list[tuple[int, float, float]]:
    """Of spectra (n, c) those with a step: which row, the largest step as a share of the value, and where. [nm]"""
    found = []
    alike, which = np.unique(usable & (values > 0), axis=0, return_inverse=True)
    for kind, channels in enumerate(alike):
        if channels.sum() < 4 * STEP_CHANNELS:
            continue
        rows = np.flatnonzero(which.ravel() == kind)
        place = wavelength_nm[channels]
        sure, step = _step_at(place, np.log(values[np.ix_(rows, channels)]))
        for row, own, steps in zip(rows, sure, step, strict=True):
            if own[k := int(own.argmax())] > STEP_SURE:
                edge = k + STEP_CHANNELS - 1
                found.append((int(row), float(np.expm1(steps[k])), float(place[edge : edge + 2].mean())))
    return sorted(found)


def _step_at(place_nm: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How sure there is a step between two channels, in its errors, 0 where there is none, and the step. (n, gaps)

    `level` is ln R, (n, c). Straight lines through the channels on either side are compared in the middle.
    """
    size = STEP_CHANNELS
    x = sliding_window_view(place_nm, size)
    middle = x.mean(axis=1)
    away = x - middle[:, None]
    spread = (away**2).sum(axis=1)
    windows = sliding_window_view(level, size, axis=1)
    mean, slope = windows.mean(axis=2), (windows * away).sum(axis=2) / spread
    left_over = ((windows - mean[..., None] - slope[..., None] * away) ** 2).sum(axis=2)
    low = np.arange(len(place_nm) - 2 * size + 1)
    high, edge = low + size, low + size - 1
    at = 0.5 * (place_nm[edge] + place_nm[edge + 1])
    step = mean[:, high] + slope[:, high] * (at - middle[high])
    step = step - mean[:, low] - slope[:, low] * (at - middle[low])
    share = 2.0 / size + (at - middle[low]) ** 2 / spread[low] + (at - middle[high]) ** 2 / spread[high]
    variance = (left_over[:, low] + left_over[:, high]) / (2 * size - 4)
    usual = np.median(variance, axis=1, keepdims=True)
    apart, rise = np.diff(place_nm), np.diff(level, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        sure = np.abs(step) / np.sqrt(np.maximum(variance, usual) * share)
        inner = (rise[:, edge] - 0.5 * (slope[:, low] + slope[:, high]) * apart[edge]) / step
        beside = np.maximum(
            np.abs(rise[:, edge - 1] - slope[:, low] * apart[edge - 1]),
            np.abs(rise[:, edge + 1] - slope[:, high] * apart[edge + 1]),
        ) / np.abs(step)
    good = (np.abs(step) > LEAST_STEP) & (np.abs(inner - 1.1) < 1.1 - STEP_SHARE) & (beside < STEP_BESIDE)
    good &= apart[edge] < STEP_GAP * float(np.median(apart))
    return np.where(good, sure, 0.0), step


def _smooth(values: FloatArray, sigma: FloatArray) -> bool:
    """Whether errors are far larger than the scatter about straight lines between neighbours: 6 variances of it."""
    scatter = float(np.median(np.abs(np.diff(values, 2)))) / (0.6745 * 6**0.5)
    return 0 < scatter * TOO_SMOOTH < float(np.median(sigma))
