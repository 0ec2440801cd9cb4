"""How the columns of telemetry may be meant: each reading with its odds beforehand, and how probable it makes the file.

A reading is what a writer of such files may have done: another unit, another axis, another sense of turning. Wheels,
headings and positions tell of one motion, up to slips and errors, in the right one alone. The likelihood is coarse: the
displacement between positions and the turn between headings beside those of wheels without slip, with errors by
Student's law. One reading that is much more probable than all others is taken and said; readings that are alike are
refused, with both named. Where wheels turn the rover little, headings mirrored and axes exchanged look alike.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.telemetry.nuisances import MEAN_SIGMA
from lunarsci.twin.telemetry.reading import Findings, Telemetry
from lunarsci.twin.telemetry.smoother import FREEDOM

SLIPS = np.array(MEAN_SIGMA[:2])
"""Standard deviation of what slip makes of ways ahead and to the left throughout, as in `nuisances`."""
CHANGES, TURNS, TURNS_PER_M = 0.1, 0.1, math.radians(0.5)
"""The same of how it changes between positions, of a turn, and of a turn on a straight way; assumed. [-, -, rad/m]"""
APART_M, FEWEST = 0.4, 4
"""Way between positions that are compared, and how many there are at least; assumed. [m]"""
USUAL = np.array([0.15, 0.1])
"""The first ones for a reading that is not as the names say: it has to explain a drive by usual slips; assumed."""
SKID_TURNS = 0.5
"""The same of a turn for a rover that steers by its sides' speeds; see `nuisances.SKID_SIGMA`."""
ALIKE = math.log(20.0)
"""ln of the odds of the best reading against another up to which the two are alike; assumed."""
STRANGE, RARE = math.log(1e-6), math.log(1e-9)
"""ln of the odds of a reading that is not as the names say, and of one that fits whatever is there; assumed."""
ROLLED, FINEST_M = 0.003, 0.001
"""How well positions that were computed from the wheels repeat their way, as a share of it, and to which digit they are
written; assumed. [-, m]"""


def _same(values: FloatArray) -> FloatArray:
    return values.copy()


def _scaled(factor: float) -> Callable[[FloatArray], FloatArray]:
    return lambda values: factor * values


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A way to read positions, headings and steering.

    Attributes
    ----------
    meaning : what it means, as a sentence; empty for as the names say.
    heading, place : from a column as written to what is meant. (n,) [deg], (n, 2) [m]
    metres : of a position's unit. Positions that are many times smaller than they seem fit any motion the better; so
        their density counts, and not that of headings, whose scatter tells nothing of a unit where a drive is straight.
    turn, rims : what it makes of the turn that the wheels say, as their steering is, and of how far they roll.
    errors : what is meant over what is written of the errors of positions.
    ln_odds : beforehand.
    way_sigma, least_m : share of the way, and length, by which positions scatter; None takes slips and stated errors.
    """

    meaning: str
    heading: Callable[[FloatArray], FloatArray] = _same
    place: Callable[[FloatArray], FloatArray] = _same
    metres: float = 1.0
    turn: float = 1.0
    rims: float = 1.0
    errors: float = 1.0
    ln_odds: float = STRANGE
    way_sigma: float | None = None
    least_m: float = 0.0


AS_NAMED = Reading(meaning="", ln_odds=0.0)
ROLLED_ALONE = Reading(meaning="x_m and y_m are computed from the wheels", way_sigma=ROLLED, least_m=FINEST_M)
ANY = Reading(meaning="another frame", way_sigma=2.0, turn=0.0, ln_odds=RARE)
READINGS = (
    AS_NAMED,
    ROLLED_ALONE,
    ANY,
    Reading(meaning="x_m and y_m are exchanged", place=lambda p: p[:, ::-1]),
    Reading(meaning="y_m points to the right of x_m", place=lambda p: p * [1.0, -1.0]),
    Reading(meaning="yaw_deg grows to the right, as in a frame with z down", heading=_scaled(-1.0)),
    Reading(meaning="yaw_deg is measured from y (north) clockwise", heading=lambda yaw: 90.0 - yaw),
    Reading(meaning="yaw_deg is measured from y", heading=lambda yaw: 90.0 + yaw),
    Reading(meaning="yaw_deg points backwards", heading=lambda yaw: yaw + 180.0),
    Reading(meaning="yaw_deg looks like rad", heading=np.degrees),
    Reading(
        meaning="x, y and yaw_deg are those of a frame with z down (x north, y east)",
        heading=_scaled(-1.0),
        place=lambda p: p * [1.0, -1.0],
    ),
    Reading(meaning="steering is positive to the right", turn=-1.0),
    Reading(meaning="the steering angles look like rad", turn=math.degrees(1.0)),
    Reading(meaning="the turns of the wheels look like rad", rims=math.degrees(1.0)),
    Reading(meaning="errors of positions look like mm", errors=1e-3),
    Reading(meaning="errors of positions look like cm", errors=1e-2),
    *(
        Reading(meaning=f"x_m and y_m look like {unit}", place=_scaled(metres), metres=metres)
        for unit, metres in (("dm", 0.1), ("cm", 0.01), ("mm", 0.001), ("km", 1000.0))
    ),
)
"""What writers of telemetry do; another frame is one that no reading explains."""


def as_meant(
    telemetry: Telemetry, twist: FloatArray, findings: Findings, *, skids: bool = False, as_planned: bool = False
) -> Telemetry:
    """Telemetry as it is most probably meant; said where that is not as its columns are named.

    `twist` is the velocity that wheels without slip say between rows (n - 1, 3), `skids` whether none is steered,
    `as_planned` whether steering is that of a plan. Raises DataError where several readings are alike.
    """
    readings = [one for one in READINGS if not as_planned or one.turn in (0.0, 1.0)]
    ln_probable = np.array(
        [one.ln_odds + _ln_likelihood(one, telemetry, twist, SKID_TURNS if skids else TURNS) for one in readings]
    )
    best = readings[int(np.argmax(ln_probable))]
    near = [one for one, own in zip(readings, ln_probable, strict=True) if own > ln_probable.max() - ALIKE]
    if AS_NAMED in near:
        return telemetry
    if best is ROLLED_ALONE:
        what = "x_m and y_m repeat the way of the wheels: no slip can be learned from them"
        findings.add("positions are odometry", what, "kept; give positions by pictures, lidar or radio", doubt=True)
    elif best is ANY:
        what = "positions, headings and wheels tell of different motions, in any frame and unit"
        findings.add("heading against motion", what, "kept as they are", doubt=True)
    elif len(near) > 1:
        told = ", or ".join(one.meaning for one in near)
        raise DataError(
            f"{telemetry.file}: {told}; x is to the right of the map, y up, yaw_deg from x towards y in degrees, "
            "steering positive to the left: convert it"
        )
    else:
        findings.add("read as", best.meaning, "taken so; x is east, y north, yaw_deg from x towards y in degrees")
        yaw = best.heading(telemetry.yaw_deg)
        known = np.isfinite(yaw)
        yaw[known] = np.unwrap(yaw[known], period=360.0)
        return dataclasses.replace(
            telemetry,
            yaw_deg=yaw,
            fix_m=best.place(telemetry.fix_m),
            fix_covariance_m2=best.errors**2 * telemetry.fix_covariance_m2,
            steering_deg=best.turn * telemetry.steering_deg,
            steered_deg=best.turn * telemetry.steered_deg,
            angle_deg=best.rims * telemetry.angle_deg,
            rate_deg_s=best.rims * telemetry.rate_deg_s,
        )
    return telemetry


def _ln_likelihood(reading: Reading, telemetry: Telemetry, twist: FloatArray, turns: float) -> float:
    """ln of how probable a reading makes positions and headings, up to a constant that all readings share."""
    rows, times, twist = _apart(telemetry, twist), telemetry.time_s, reading.rims * twist
    known = np.isfinite(telemetry.yaw_deg)
    yaw = np.radians(np.interp(times, times[known], reading.heading(telemetry.yaw_deg)[known]))
    steps, middle = np.diff(times), 0.5 * (yaw[1:] + yaw[:-1])
    ahead, left = twist[:, 0] * steps, twist[:, 1] * steps
    moved = np.column_stack(
        [np.cos(middle) * ahead - np.sin(middle) * left, np.sin(middle) * ahead + np.cos(middle) * left]
    )
    way = np.add.reduceat(np.hypot(ahead, left), rows[:-1])
    turned = np.add.reduceat(np.abs(twist[:, 2]) * steps, rows[:-1])
    turn = reading.turn * np.add.reduceat(twist[:, 2] * steps, rows[:-1])
    wanted = np.add.reduceat(moved, rows[:-1], axis=0)
    off = np.diff(reading.place(telemetry.fix_m[rows]), axis=0) - wanted
    course = np.arctan2(wanted[:, 1], wanted[:, 0])
    share = np.column_stack(
        [
            np.cos(course) * off[:, 0] + np.sin(course) * off[:, 1],
            np.cos(course) * off[:, 1] - np.sin(course) * off[:, 0],
        ]
    )
    variance = np.trace(telemetry.fix_covariance_m2[rows], axis1=1, axis2=2) / 2.0
    stated, rolled = reading.errors * np.sqrt(variance[1:] + variance[:-1]), way > 0.0
    if reading.way_sigma is not None:
        sigma, mean = np.hypot(reading.way_sigma * way, reading.least_m or stated), np.zeros(2)
    else:
        sigma = np.hypot(CHANGES * way, stated)
        # The slip that all ways have in common, as far as it is likely at all.
        mean = np.median(share[rolled] / way[rolled, None], axis=0) if rolled.any() else np.zeros(2)
        mean = np.clip(mean, -3.0 * SLIPS, 3.0 * SLIPS)
    ln_mean = float(-0.5 * ((mean / (USUAL if reading.meaning else SLIPS)) ** 2).sum())
    share = share - mean * way[:, None]
    yaw_sigma = math.sqrt(2.0) * math.radians(float(np.nanmedian(telemetry.yaw_deg_sigma)))
    turn_sigma = np.sqrt((turns * np.maximum(turned, np.abs(turn))) ** 2 + (TURNS_PER_M * way) ** 2 + yaw_sigma**2)
    parts = ((share[:, 0], sigma), (share[:, 1], sigma), (np.diff(yaw[rows]) - turn, turn_sigma))
    return (
        ln_mean + 2.0 * len(off) * math.log(reading.metres) + sum(_ln_student(value, sigma) for value, sigma in parts)
    )


def _apart(telemetry: Telemetry, twist: FloatArray) -> IndexArray:
    """Rows with a position, so far apart that slip shows between them; all where they are few."""
    rows = np.flatnonzero(telemetry.fixed)
    rolled = np.append(0.0, np.cumsum(np.hypot(twist[:, 0], twist[:, 1]) * np.diff(telemetry.time_s)))
    some = rows[np.unique(np.floor(rolled[rows] / APART_M), return_index=True)[1]]
    return some if len(some) >= FEWEST else rows


def _ln_student(off: FloatArray, sigma: FloatArray) -> float:
    """ln of Student's density, up to a constant."""
    return float((-np.log(sigma) - 0.5 * (FREEDOM + 1.0) * np.log1p((off / sigma) ** 2 / FREEDOM)).sum())
