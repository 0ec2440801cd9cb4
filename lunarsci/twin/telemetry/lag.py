"""How much later the rover moves than its wheels say: positions and headings of another clock, or wheels that act late.

Where wheels steer over, turn the rover on the spot, start or stop, positions and headings say when the rover did so: a
lag after the columns of the wheels. Put back by the way and turn that the rover makes in a lag, they are the likelier
the nearer it is to the true one. All else of `filter` is linear, so that the logarithm of this is a parabola: its top
is the lag, its width the error (Tarantola & Valette 1982, 10.1029/RG020i002p00219). Along one arc at one speed a lag
moves all positions and headings alike. There it does not show, and slip does not depend on it.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, samples_about
from lunarsci.twin.telemetry.checks import ordered, taken
from lunarsci.twin.telemetry.far_lag import NEAR_S, FarLag
from lunarsci.twin.telemetry.filter import Nodes, filtered, linearised
from lunarsci.twin.telemetry.nodes import twist_at
from lunarsci.twin.telemetry.outliers import OUTLIER
from lunarsci.twin.telemetry.reading import WHEEL_COLUMNS, Findings, Telemetry
from lunarsci.twin.telemetry.smoother import SlipProcess, Smoothed, change_of, smooth

TRIED_S = 0.5
"""Lags about the top at which the parabola is measured: a clock or a motor is often late by as much; assumed. [s]"""
LONGEST_S = 10.0
"""Farthest that a lag is looked for; assumed. [s]"""
ROUNDS = 3
"""Of measuring the parabola about its own top."""
WITHIN_ROW = 0.1
"""Error of the lag as a share of the time between rows: wheels do not turn evenly within one; assumed, see
docs/validation/drive.md."""
SURE = 3.0
"""Errors of the lag from which on it is said; assumed."""
TOLD_S = 0.2
"""And how long it must be: commands of made-up drives are themselves 0.1 s early; assumed. [s]"""
HARM_M = 0.01
"""Way within a lag from which on states are in doubt, assumed: in drives by the twin with 2.5 cm of it 95 % intervals
of slip hold 81 % (docs/validation/drive.md). [m]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """By how much positions and headings are later than the columns of the wheels.

    Attributes
    ----------
    lag_s : positive where the rover moves later than its wheels say; 0 where the drive does not tell. [s]
    sigma_s : its standard error, infinite where the drive does not tell. [s]
    speed_m_s : median speed of the rims that turn. [m/s]
    farthest_s : how far a lag was looked for; the drive tells of none that is longer. [s]
    far : whether it is one of `far_lag`.
    """

    lag_s: float
    sigma_s: float
    speed_m_s: float
    farthest_s: float = NEAR_S
    far: bool = False

    @property
    def found(self) -> bool:
        """Whether there is one for sure."""
        return self.far or abs(self.lag_s) > max(TOLD_S, SURE * self.sigma_s)

    @property
    def way_m(self) -> float:
        """Way that the rims make in it. [m]"""
        return abs(self.lag_s) * self.speed_m_s

    def to_dict(self) -> dict[str, float | bool | None]:
        """For a result: without numbers where the drive does not tell."""
        told = math.isfinite(self.sigma_s)
        return {
            "lag_s": self.lag_s if told else None,
            "sigma_s": self.sigma_s if told else None,
            "found": self.found,
            "farthest_s": self.farthest_s,
        }

    @property
    def text(self) -> str:
        """What was measured."""
        late = "later" if self.lag_s > 0 else "earlier"
        return (
            f"the rover moves {abs(self.lag_s):.2f} \u00b1 {self.sigma_s:.2f} s {late} than its wheels say, "
            f"{100 * self.way_m:.2g} cm of way"
        )


def lag_of(nodes: Nodes, whole: Nodes, smoothed: Smoothed, row_s: float, far: FarLag) -> Lag:
    """The lag that makes positions and headings most probable.

    Parameters
    ----------
    nodes, whole : without positions and headings that fit no motion, and with them: those about a halt fit none if
        there is a lag. They count where a lag makes fewer of them odd.
    smoothed : the motion without a lag. Where there is one, how slip changes is found anew with it.
    row_s : median time between rows; what a column says within one is not known. [s]
    far : of many seconds, where turns tell one: that is it.
    """
    way = nodes.way_m / np.diff(nodes.time_s)
    speed = float(np.median(way[way > 0])) if (way > 0).any() else 0.0
    path, change = _path(nodes, smoothed), smoothed.change
    if far.lag_s:
        return Lag(lag_s=far.lag_s, sigma_s=far.sigma_s, speed_m_s=speed, farthest_s=far.farthest_s, far=True)
    lag = 0.0
    if _counted(nodes) < _counted(whole):
        lag, nodes = _with_odd(nodes, whole, path, smoothed)
    lag, sigma = _top(nodes, path, smoothed.state, change, lag)
    if abs(lag) > sigma:
        change = change_of(_moved(nodes, path, lag))
        lag, sigma = _top(nodes, path, smoothed.state, change, lag)
    sigma = math.hypot(sigma, WITHIN_ROW * row_s)
    return Lag(lag_s=lag, sigma_s=sigma, speed_m_s=speed, farthest_s=far.farthest_s)


def _top(
    nodes: Nodes, path: FloatArray, reference: FloatArray, change: SlipProcess, lag_s: float = 0.0
) -> tuple[float, float]:
    """Top and width of the parabola, by a few steps from a lag; 0 and infinity where there is none. [s]"""
    information = 0.0
    for _ in range(ROUNDS):
        before, here, after = (
            _ln_likelihood(_moved(nodes, path, lag_s + step), reference, change) for step in (-TRIED_S, 0.0, TRIED_S)
        )
        information = (2.0 * here - before - after) / TRIED_S**2
        if information * LONGEST_S**2 <= 1.0:
            return 0.0, math.inf
        lag_s = float(np.clip(lag_s + 0.5 * (after - before) / (TRIED_S * information), -LONGEST_S, LONGEST_S))
    return lag_s, information**-0.5


def _with_odd(kept: Nodes, whole: Nodes, path: FloatArray, smoothed: Smoothed) -> tuple[float, Nodes]:
    """A lag with which all positions and headings fit better than without, and those that do; else 0 and `kept`."""
    least, best = _misfit(whole, path, 0.0, smoothed.change)[0], (0.0, kept)
    lag = _top(whole, path, smoothed.state, smoothed.change)[0]
    for _ in range(ROUNDS):
        misfit, fitting = _misfit(whole, path, lag, smoothed.change)
        if misfit < least:
            least, best = misfit, (lag, fitting)
        lag = _top(fitting, path, smoothed.state, smoothed.change, lag)[0]
    return best


def _misfit(nodes: Nodes, path: FloatArray, lag_s: float, change: SlipProcess) -> tuple[float, Nodes]:
    """Squared distances of positions and headings from the motion if there is such a lag, none as more than that of an
    outlier, summed; and the nodes without those outliers."""
    found = smooth(_moved(nodes, path, lag_s), change)
    far = np.concatenate([found.squared_distance, found.yaw_squared_distance])
    with np.errstate(invalid="ignore"):
        odd, turned = found.squared_distance > OUTLIER, found.yaw_squared_distance > OUTLIER
    fix_m = np.where(odd[:, None], np.nan, nodes.fix_m)
    fitting = dataclasses.replace(nodes, fix_m=fix_m, yaw_rad=np.where(turned, np.nan, nodes.yaw_rad))
    return float(np.nansum(np.minimum(far, OUTLIER))), fitting


def _counted(nodes: Nodes) -> int:
    """Positions and headings."""
    return int(np.isfinite(nodes.fix_m).all(axis=1).sum() + np.isfinite(nodes.yaw_rad).sum())


def _path(nodes: Nodes, smoothed: Smoothed) -> FloatArray:
    """x, y and heading at the nodes as wheels and slips make them, and far before and behind at the speeds of the ends.

    Not as smoothed: errors of positions and headings would be moved along. (n + 2, 3) [m, m, rad]
    """
    twist, steps = twist_at(nodes, smoothed), np.diff(nodes.time_s)[:, None]
    yaw = smoothed.state[:, 2]
    ahead, left = twist[:, 0], twist[:, 1]
    rate = np.column_stack(
        [np.cos(yaw) * ahead - np.sin(yaw) * left, np.sin(yaw) * ahead + np.cos(yaw) * left, twist[:, 2]]
    )
    step = 0.5 * (rate[1:] + rate[:-1]) * steps
    path = np.vstack([np.zeros(3), np.cumsum(step, axis=0)])
    ends = 2.0 * LONGEST_S * rate[[0, -1]]
    return np.vstack([path[:1] - ends[:1], path, path[-1:] + ends[1:]])


def _moved(nodes: Nodes, path: FloatArray, lag_s: float) -> Nodes:
    """With positions and headings put back by a lag along a path of `_path`."""
    times = np.concatenate([nodes.time_s[:1] - 2.0 * LONGEST_S, nodes.time_s, nodes.time_s[-1:] + 2.0 * LONGEST_S])
    back = np.column_stack([np.interp(nodes.time_s - lag_s, times, column) for column in path.T]) - path[1:-1]
    return dataclasses.replace(nodes, fix_m=nodes.fix_m - back[:, :2], yaw_rad=nodes.yaw_rad - back[:, 2])


def _ln_likelihood(nodes: Nodes, reference: FloatArray, change: SlipProcess) -> float:
    model = linearised(nodes, reference, change.usual[None], change.usual_length_m[None])
    return float(filtered(model, kept=False)[2][0])


def check_lag(lag: Lag, findings: Findings) -> None:
    """Say a lag that is one for sure; slip and soil are in doubt where the rover is late and the wheels roll far in it.

    One that is early by less than `NEAR_S` is said alone: an honest drive may look so (docs/validation/drive.md).
    """
    if lag.found:
        done = (
            f"times are kept as they are: --lag {lag.lag_s:.2f} puts positions and headings back to their wheels, if "
            "they are by another clock or wheels act late; what steering and wheels did, measured by the clock of the "
            "positions (steered_W_deg, angle_W_deg), has no lag"
        )
        if lag.far:
            done += ". Slips turn the rover as well, so that this number is coarse: see which lag is left with it"
        findings.add("lag", lag.text, done, doubt=lag.far or (lag.way_m > HARM_M and not -NEAR_S < lag.lag_s < 0.0))


def without_lag(telemetry: Telemetry, lag_s: float, findings: Findings) -> Telemetry:
    """Rows with positions, headings and attitude put back to the time of the wheels that made them: a lag earlier.

    Columns of the wheels are taken to change evenly between rows. Rows before the first time or after the last one are
    left out.
    """
    if lag_s == 0.0:
        return telemetry
    telemetry = ordered(telemetry, findings)
    times = telemetry.time_s
    at = times - lag_s
    rows = np.flatnonzero((at >= times[0]) & (at <= times[-1]))
    found = taken(telemetry, rows)
    low, share = samples_about(times, at[rows])
    columns: dict[str, Any] = {"time_s": at[rows]}
    for name in WHEEL_COLUMNS:
        before, after = (getattr(telemetry, name)[row] for row in (low, low + 1))
        columns[name] = before + share[:, None] * (after - before)
    rests = tuple((begin - lag_s, end - lag_s) for begin, end in telemetry.rests_s)
    return dataclasses.replace(found, rests_s=rests, **columns)
