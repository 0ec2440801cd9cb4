"""A lag of many seconds between positions and headings and the wheels, by how the wheels turn the rover.

`lag` follows one top from no lag on, with slips that are found without one: it finds a lag of a second or so. Here all
lags are tried: turns of the heading are held against those of wheels without slip, times a factor, some time before.
"""

from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.twin.telemetry.reading import Telemetry

FARTHEST_S, SHARE = 30.0, 0.25
"""Farthest that a lag is looked for, and as a share of the drive's time; assumed. [s]"""
NEAR_S = 1.5
"""How far `lag` is taken to find one where turns tell nothing; assumed. [s]"""
SPAN_S = 4.0
"""Over which turns are compared; assumed. Slips turn the rover as well: an honest drive of bends on slopes of 5 deg
looked half of that late. [s]"""
LEAST_SPANS = 0.75
"""Spans below which a lag is none; assumed, 1.5 times that bias."""
BETTER = 25.0
"""ln of how much more probable than no lag, of independent turns, from which on a lag is one; assumed."""
TOLD, EXPLAINED, LEFT = 0.5, 0.8, 0.6
"""Share of the square of the turns that wheels must explain to tell anything of a lag, and to tell one; and of what is
left without a lag that may be left with it; assumed: that drive had 0.9, by a clock 1 s late 0.7, 3 s late 0.5."""
FACTORS = (0.5, 1.5)
"""How many times as far as the wheels say the rover may turn: as for `heading against wheels`; assumed."""


class FarLag(NamedTuple):
    """Lag and its standard error, 0 and NaN where there is none of many seconds, and how far one was looked for. [s]"""

    lag_s: float
    sigma_s: float
    farthest_s: float


def far_lag(telemetry: Telemetry, turned_deg: FloatArray) -> FarLag:
    """A lag of many seconds, if turns of the heading tell one for sure.

    `turned_deg` is the turn that the wheels say until each row. (n,)
    """
    known = np.isfinite(telemetry.yaw_deg)
    times, yaw = telemetry.time_s[known], telemetry.yaw_deg[known]
    row = float(np.median(np.diff(times)))
    span = max(SPAN_S, 2.0 * row)
    farthest = min(FARTHEST_S, SHARE * float(times[-1] - times[0]))
    begins = np.arange(times[0] + farthest, times[-1] - farthest - span, row)
    none = FarLag(0.0, np.nan, NEAR_S)
    if len(begins) * row < 2.0 * span or farthest <= NEAR_S:
        return none
    turns = np.interp(begins + span, times, yaw) - np.interp(begins, times, yaw)
    whole = float(((turns - turns.mean()) ** 2).sum())
    step = min(row, 0.5)
    lags = step * np.arange(-np.floor(farthest / step), np.floor(farthest / step) + 1)
    left, factors = np.transpose([_misfit(begins - lag, span, turns, telemetry.time_s, turned_deg) for lag in lags])
    best, here = int(np.argmin(left)), len(lags) // 2
    if left[best] > (1.0 - TOLD) * whole:
        return none
    independent = len(begins) * row / span
    ln_likelihood = -0.5 * independent * np.log(left)
    sure = ln_likelihood[best] - ln_likelihood[here] > BETTER
    sure &= left[best] < min((1.0 - EXPLAINED) * whole, LEFT * left[here])
    inside = 0 < best < len(lags) - 1 and FACTORS[0] < factors[best] < FACTORS[1]
    if not sure or not inside or abs(lags[best]) < LEAST_SPANS * span:
        return FarLag(0.0, np.nan, farthest)
    before, top, after = ln_likelihood[best - 1 : best + 2]
    bend = 2.0 * top - before - after
    lag = float(lags[best] + 0.5 * step * (after - before) / bend)
    return FarLag(lag, float(np.hypot(step * bend**-0.5, 0.5 * span)), farthest)


def _misfit(
    begins_s: FloatArray, span_s: float, turns_deg: FloatArray, time_s: FloatArray, turned_deg: FloatArray
) -> tuple[float, float]:
    """Square of what turns are off those of the wheels about some times, times a factor and more or less a constant;
    and that factor."""
    wheels = np.interp(begins_s + span_s, time_s, turned_deg) - np.interp(begins_s, time_s, turned_deg)
    wheels, turns = wheels - wheels.mean(), turns_deg - turns_deg.mean()
    factor = float(wheels @ turns / max(wheels @ wheels, 1e-12))
    return float(((turns - factor * wheels) ** 2).sum()), factor
