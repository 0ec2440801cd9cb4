"""How the wheels turned between rows: which of their encoders, rates and commands tell it, by how well they agree.

Of a step an encoder counts, has begun anew after whole turns, or says nothing, as after a reset; a rate tells the turn
or says nothing; a command is obeyed or not. Each set of these has odds beforehand, and what it takes for true must
agree within its errors. The most probable set is taken for every step and wheel.

Wheels that follow waves go further than the rover seen from above, and lag or lead as it pitches. On a slope the wheels
must carry a part of the weight, and slip for it. A wheel's pull grows with its slip, and its side force with its side
slip, both as its load; so the three velocities of a rigid rover are those that fit all wheels best, weighed by their
loads, and those across by how much stiffer the ground is against side slip than against slip. This is the balance of
forces where slips are small, and inertia is none.
"""

import itertools
import warnings
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.simulation.prescribed_motion import PrescribedLoads
from lunarsci.twin.telemetry.filter import onto_map
from lunarsci.twin.telemetry.hypotheses import CLOCK_S, LN_ODDS, repeated, resolution_of
from lunarsci.twin.telemetry.reading import (
    OBEYED,
    RATE_SHARE,
    SIGMA_DEG,
    STILL,
    SURE,
    TURNED_DEG,
    UNDER_WAY,
    Findings,
    Telemetry,
    between,
)

ON_THE_SPOT = 0.1
"""Speed of the rover as a share of that of its rims below which it turns on the spot; assumed."""
PACE = 0.02
"""Share by which a wheel may turn faster or slower than the plan or the others say, unsaid: it is a slip of as much;
assumed."""
MOST_SCALE = 1.5
"""Farthest that an encoder's scale is off, as by another wheel or gear; assumed."""
BLOCK_M = 0.5
"""Way over which rims are averaged, as the last digits of encoders count less in it. Half or twice as much moves slips
by 0.05 of their errors at most, as measured. [m]"""
LEAST_LOAD = 0.05
"""Share of the mean load below which a wheel is not taken to be. Half or twice as much moves slips by 0.001 of their
errors at most, as measured."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WheelMotion:
    """How the rims moved between successive rows.

    Attributes
    ----------
    rim_m_s : mean speed of each rim r_s omega between rows, NaN where unknown. (n - 1, wheels) [m/s]
    measured : False where it is a command only. (n - 1, wheels)
    trusted : wheels and times whose own states can be given. (n - 1, wheels)
    usual_m_s : median speed of the rims while they turn. [m/s]
    obedience : rim speed measured over commanded, 1 where there is no command.
    """

    rim_m_s: FloatArray
    measured: BoolArray
    trusted: BoolArray
    usual_m_s: float
    obedience: float = 1.0

    @property
    def moving(self) -> BoolArray:
        """Whether any rim turns at more than a creep. (n - 1,)"""
        return np.asarray((np.abs(np.nan_to_num(self.rim_m_s)) > STILL * self.usual_m_s).any(axis=1))


def wheel_motion(telemetry: Telemetry, rover: Rover, gaps: BoolArray, findings: Findings) -> WheelMotion:
    """Rim speeds from encoders, where these say nothing from rates, else from commands.

    `gaps` are steps between rows over which nothing was sent. (n - 1,) Readings that hang or say nothing, wraps, runs
    without a reading, and a clock that jumps against all encoders are said. Raises DataError where no wheel turns, and
    for rows that tell of none.
    """
    per_deg = np.radians(rover.wheel.shearing_radius_m)
    steps, resting = np.diff(telemetry.time_s)[:, None], resting_steps(telemetry)
    sent_m_s, rate_deg_s, angle_deg = telemetry.of_wheels()
    command, rate = between(sent_m_s) / per_deg * steps, between(rate_deg_s) * steps
    angle = np.diff(angle_deg, axis=0)
    # An encoder that hangs beside what its rate, else its command, says.
    since_start = np.cumsum(np.nan_to_num(np.where(np.isfinite(rate), rate, command)), axis=0)
    expected = np.vstack([np.zeros_like(since_start[:1]), since_start])
    last = np.array([resolution_of(column) for column in telemetry.angle_deg.T])
    digits = np.hypot(SIGMA_DEG, 0.5 * np.where(np.isfinite(last), last, 0.0))
    hung = np.column_stack(
        [repeated(one, 1.0, *beside) for one, *beside in zip(telemetry.angle_deg.T, expected.T, digits, strict=True)]
    )
    # The step at which an encoder that hung moves on holds all it missed.
    angle[hung[1:] | hung[:-1]] = np.nan
    # Noise of a wheel that stands is no motion: over hours it would add up to one.
    for turn in (command, rate, angle):
        turn[resting] *= 0.0
    turns = {"command": command, "rate": rate, "angle": angle}
    rates = {"command": sent_m_s / per_deg, "rate": rate_deg_s}
    went = _turns(turns, _sigma(turns, rates, digits, steps), rover.max_speed_m_s / per_deg * (steps + CLOCK_S), gaps)
    measured = np.where(went.counts, angle - 360.0 * went.wraps, np.where(went.tells, rate, np.nan)) / steps
    _report(telemetry, rover, went, hung[1:], ~np.isfinite(measured), findings)
    rim, given = per_deg * np.where(np.isfinite(measured), measured, command / steps), np.isfinite(measured)
    fast = np.abs(rim[np.isfinite(rim)])
    usual = float(np.median(fast[fast > STILL * fast.max()])) if fast.size and fast.max() > 0 else 0.0
    if usual == 0:
        raise DataError(f"{telemetry.file}: no wheel turns; there is no slip to find")
    if (blank := ~np.isfinite(rim).any(axis=1)).any():
        begin, end = telemetry.time_s[[int(np.argmax(blank)), int(np.argmax(blank)) + 1]]
        raise DataError(
            f"{telemetry.file}: between {begin:.6g} and {end:.6g} s no wheel has an angle, a rate or a command of use, "
            f"in {int(blank.sum())} steps in all; leave these rows out, or give speed_W_m_s"
        )
    return WheelMotion(
        rim_m_s=rim,
        measured=given,
        trusted=given if given.any() else np.isfinite(rim),
        usual_m_s=usual,
        obedience=_obedience(measured, command / steps),
    )


def resting_steps(telemetry: Telemetry) -> BoolArray:
    """Steps over which the rover stands: all wheels are told so, and none gets any further. (n - 1,)"""
    command = (telemetry.speed_m_s == 0).all(axis=1)
    resting = command[1:] & command[:-1]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(np.int8), [0]])))
    for begin, end in edges.reshape(-1, 2):
        turned = np.abs(telemetry.angle_deg[begin + 1 : end + 1] - telemetry.angle_deg[begin])
        resting[begin:end] = not (turned > TURNED_DEG).any()
    return np.asarray(resting | telemetry.rested)


class _Turns(NamedTuple):
    """What tells the turn of every step and wheel.

    Attributes
    ----------
    counts, tells : whether the encoder does, and whether the rate. (n - 1, wheels)
    wraps : whole turns by which the encoder began anew. (n - 1, wheels)
    off_deg : by how much the encoder is off the rate, else the command. (n - 1, wheels) [deg]
    clock : how much more time went by than the clock says, 1 where it does not jump. (n - 1,)
    """

    counts: BoolArray
    tells: BoolArray
    wraps: FloatArray
    off_deg: FloatArray
    clock: FloatArray


def _sigma(
    turns: dict[str, FloatArray], rates_deg_s: dict[str, FloatArray], digits: FloatArray, step_s: FloatArray
) -> dict[str, FloatArray]:
    """Standard errors of turns: of rates and commands with what these change by over a step. (n - 1, wheels) [deg]"""
    sigma = {"angle": np.tile(digits, (len(step_s), 1))}
    for name, share in (("rate", RATE_SHARE), ("command", OBEYED)):
        changes = 0.5 * np.abs(np.nan_to_num(np.diff(rates_deg_s[name], axis=0))) * step_s
        sigma[name] = np.sqrt(SIGMA_DEG**2 + (share * np.nan_to_num(turns[name])) ** 2 + changes**2)
    return sigma


def _turns(
    turns: dict[str, FloatArray], sigma: dict[str, FloatArray], fastest_deg: FloatArray, gaps: BoolArray
) -> _Turns:
    """The most probable set of witnesses, of turns that commands, rates and encoders say. (n - 1, wheels) [deg]"""
    command, rate, angle = turns.values()
    given = np.isfinite(rate)
    likeliest = _likeliest(turns, sigma, fastest_deg, np.full(angle.shape[1], LN_ODDS["reading"]))
    # An encoder that wraps does so often; how many whole turns a gap hides nobody knows.
    wraps = (likeliest.wraps != 0).mean(axis=0)
    angle = np.where(gaps[:, None] & (wraps > 0), np.nan, angle)
    expected = np.where(given, rate, command)
    clock = _clock(angle, expected, np.hypot(sigma["angle"], np.where(given, sigma["rate"], sigma["command"])))
    turns = {"command": clock[:, None] * command, "rate": clock[:, None] * rate, "angle": angle}
    likeliest = _likeliest(turns, sigma, fastest_deg, np.maximum(np.log(np.maximum(wraps, 1e-300)), LN_ODDS["reading"]))
    return likeliest._replace(clock=clock, off_deg=angle - np.nan_to_num(clock[:, None] * expected))


def _ln_agree(off_deg: FloatArray, variance: FloatArray, any_deg: FloatArray | float = 360.0) -> FloatArray:
    """ln of how much more probable what differs so is where both tell the same than where one says nothing.

    What says nothing may be anything within a turn, or `any_deg`.
    """
    return np.asarray(np.log(any_deg) - 0.5 * (off_deg**2 / variance + np.log(2.0 * np.pi * variance)))


def _likeliest(
    turns: dict[str, FloatArray], sigma: dict[str, FloatArray], fastest_deg: FloatArray, ln_wrap: FloatArray
) -> _Turns:
    """For each step and wheel; beforehand a turn is about 0, with that of the fastest rover for standard deviation."""
    shape, widest = turns["angle"].shape, np.hypot(360.0, 4.0 * fastest_deg)
    best, counts, tells, wraps = np.full(shape, -np.inf), np.zeros(shape, bool), np.zeros(shape, bool), np.zeros(shape)
    for taken in itertools.product((True, False), repeat=3):
        ln, mean, turned = np.zeros((3, *shape))
        precision = np.broadcast_to(fastest_deg**-2, shape)
        for (name, turn), true in zip(turns.items(), taken, strict=True):
            given, value = np.isfinite(turn), np.nan_to_num(turn)
            if not true:
                ln += np.where(given, LN_ODDS["reading"], 0.0)
                continue
            variance, off = sigma[name] ** 2 + 1.0 / precision, value - mean
            agree = _ln_agree(off, variance, widest)
            if name == "angle":
                whole = np.rint(off / 360.0)
                anew = np.where(whole != 0, _ln_agree(off - 360.0 * whole, variance, widest) + ln_wrap, -np.inf)
                turned, agree = np.where(anew > agree, whole, 0.0), np.maximum(agree, anew)
            weight = sigma[name] ** -2
            mean = (precision * mean + weight * (value - 360.0 * turned)) / (precision + weight)
            precision, ln = precision + weight, np.where(given, ln + agree, -np.inf)
        better = ln > best
        best, wraps = np.where(better, ln, best), np.where(better, turned, wraps)
        counts, tells = np.where(better, taken[2], counts), np.where(better, taken[1], tells)
    return _Turns(counts, tells, wraps, np.full(shape, np.nan), np.ones(len(best)))


def _clock(angle: FloatArray, expected: FloatArray, sigma: FloatArray) -> FloatArray:
    """How much more time went by than the clock says, where most encoders together say so. (n - 1,)"""
    turning = np.isfinite(angle) & (np.abs(expected) > SURE * SIGMA_DEG)
    share = np.ones(angle.shape)
    share[turning] = angle[turning] / expected[turning]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        ratio = np.nan_to_num(np.nanmedian(np.where(turning, share, np.nan), axis=1), nan=1.0)

    def ln_of(off_deg: FloatArray) -> FloatArray:
        ln = np.logaddexp(_ln_agree(off_deg, sigma**2), LN_ODDS["reading"])
        return np.asarray(np.where(turning, ln, 0.0).sum(axis=1))

    gain = ln_of(np.nan_to_num(angle - ratio[:, None] * expected)) - ln_of(np.nan_to_num(angle - expected))
    most = turning.mean(axis=1) > 0.5
    return np.where(most & (gain + LN_ODDS["clock step"] > 0) & (ratio >= 0), ratio, 1.0)


def _report(
    telemetry: Telemetry, rover: Rover, went: _Turns, hung: BoolArray, lost: BoolArray, findings: Findings
) -> None:
    """Say what does not tell the turn of a wheel, or tells it otherwise."""
    blank = lost & ~hung
    if blank.all():
        done = "the commanded speeds are taken: slip holds as far as the wheels obeyed"
        findings.add("no encoders", "neither angles nor rates of the wheels", done, count=len(blank))
        return
    jumps, given = "the angle of wheel {} jumps by {:+.4g} deg against its rate", np.isfinite(went.off_deg)
    odd, rate = ~went.tells & went.counts, np.isfinite(between(telemetry.rate_deg_s))
    for kind, where, what, done in (
        ("stuck", hung, "the angle of wheel {} does not change while it is to turn: stuck wheel or sensor",
         "its rate is taken there; without one its states are not valid"),
        ("encoder wrap", went.counts & (went.wraps != 0), jumps, "whole turns added"),
        ("encoder reset", ~went.counts & given, jumps, "its rate, else the command, is taken for these steps"),
        ("odd rate", odd & rate, "the rate of wheel {} is denied by its angle",
         "left out; its angle is taken"),
        ("missing readings", blank, "neither angle nor rate of wheel {}", "its states are not valid there"),
    ):  # fmt: skip
        for k in np.flatnonzero(where.any(axis=0)):
            text = what.format(rover.wheels[k], went.off_deg[int(np.argmax(where[:, k])), k])
            findings.of_rows(kind, text, done, where[:, k], telemetry.time_s)
    jumped = went.clock != 1.0
    first = int(np.argmax(jumped))
    step_s = float(np.diff(telemetry.time_s)[first])
    what = f"the clock counts {step_s:.4g} s where the wheels turned for {went.clock[first] * step_s:.4g} s"
    done = "slip rests on the wheels' angles, but times after it may not fit those before"
    findings.of_rows("clock step", what, done, jumped, telemetry.time_s, doubt=True)


def _obedience(measured: FloatArray, command: FloatArray) -> float:
    """How fast wheels turn beside their commands, the median of the wheels; 1 where that is not known."""
    both = np.isfinite(measured) & np.isfinite(command)
    # Of sums: a coarse encoder has steps of many sizes.
    sums = [(np.abs(measured[on, k]).sum(), np.abs(command[on, k]).sum()) for k, on in enumerate(both.T)]
    return float(np.median([turned / wanted for turned, wanted in sums if turned and wanted] or [1.0]))


def mean_speed(rim_m_s: FloatArray) -> FloatArray:
    """Root mean square of the known rims. (n,)"""
    given = np.isfinite(rim_m_s)
    squares = np.where(given, np.nan_to_num(rim_m_s) ** 2, 0.0).sum(axis=1)
    return np.asarray(np.sqrt(squares / np.maximum(given.sum(axis=1), 1)))


def wheel_rows(rover: Rover, steering_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Speed of each wheel along and across its own plane for unit velocities of the rover's origin.

    Parameters
    ----------
    steering_rad : steering angle of each wheel. (n, wheels) [rad]

    Returns
    -------
    Rows for (ahead [m/s], left [m/s], turn [rad/s]); the speed along is that of the rim if nothing slips, so that the
    steering offset, whose wheel rolls about its axis, counts with it. (n, wheels, 3), (n, wheels, 3)
    """
    position, side = rover.wheel_positions_m, np.tile([1.0, -1.0], len(rover.pairs))
    offset = np.where(rover.steered_mask, rover.steering_offset_m * side, 0.0)
    x, y = position[:, 0], position[:, 1] - offset
    cos, sin = np.cos(steering_rad), np.sin(steering_rad)
    along = np.stack([cos, sin, x * sin - y * cos - offset], axis=-1)
    across = np.stack([-sin, cos, x * cos + y * sin], axis=-1)
    return along, across


def body_twist(rover: Rover, rim_m_s: FloatArray, steering_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity of the rover's origin that fits all rims best, with neither slip nor side slip.

    Parameters
    ----------
    rim_m_s : r_s omega, NaN where unknown: such a wheel still does not move sideways. (n, wheels) [m/s]
    steering_rad : (n, wheels) [rad]

    Returns
    -------
    Ahead [m/s], left [m/s], turn [rad/s] (n, 3), and root mean square of what the wheels differ from it. (n,) [m/s]
    """
    along, across = wheel_rows(rover, steering_rad)
    given = np.isfinite(rim_m_s)
    rows = np.where(given[..., None], along, 0.0)
    right = np.nan_to_num(rim_m_s)
    twist = fitted_twist(rows, across, right, np.zeros_like(right))
    off = np.concatenate([right - np.einsum("nki,ni->nk", rows, twist), np.einsum("nki,ni->nk", across, twist)], axis=1)
    return twist, np.sqrt((off**2).mean(axis=1))


def fitted_twist(
    along: FloatArray,
    across: FloatArray,
    v_x_m_s: FloatArray,
    v_y_m_s: FloatArray,
    weight: tuple[FloatArray, FloatArray] | None = None,
) -> FloatArray:
    """Velocity of the rover's origin that fits speeds of the wheels along and across their planes best.

    Parameters
    ----------
    along, across : rows of `wheel_rows`, zeros for what is not known. (n, wheels, 3)
    v_x_m_s, v_y_m_s : speeds along and across. (n, wheels) [m/s]
    weight : of each of these, positive; None takes all alike. (n, wheels), (n, wheels)

    Returns
    -------
    Ahead [m/s], left [m/s], turn [rad/s]. (n, 3)
    """
    rows = np.concatenate([along, across], axis=1)
    right = np.concatenate([v_x_m_s, v_y_m_s], axis=1)
    weights = np.ones_like(right) if weight is None else np.concatenate(weight, axis=1)
    normal = np.einsum("nk,nki,nkj->nij", weights, rows, rows)
    return np.asarray(np.linalg.solve(normal, np.einsum("nk,nki,nk->ni", weights, rows, right)[..., None])[..., 0])


def of_one_motion(
    wheels: WheelMotion,
    rover: Rover,
    steering_rad: FloatArray,
    step_s: FloatArray,
    findings: Findings,
    tested: Collection[str] = (),
) -> WheelMotion:
    """Wheels whose rims tell of the motions of one rigid rover, with the encoder mended that fits the others least.

    It is the wheel without which all others agree best; it turned as they say, times a scale, which is 1 where nothing
    is wrong. What all wheels have in common does not show here, nor which wheel of a side it is where none is steered.

    Parameters
    ----------
    steering_rad, step_s : between rows. (n - 1, wheels) [rad], (n - 1,) [s]
    tested : wheels that slip on purpose (`wheel_test` of the plan): what one of them does otherwise is no fault.
    """
    given = np.isfinite(wheels.rim_m_s).all(axis=1) & wheels.moving
    if not given.any() or not rover.steered_mask.any():
        return wheels
    # Steps without a halt between that make a block.
    way = np.cumsum(np.where(given, mean_speed(wheels.rim_m_s) * step_s, 0.0)) // BLOCK_M
    block = np.cumsum(np.append(True, (np.diff(way) > 0) | ~given[:-1]))[given]
    begins, weight = np.flatnonzero(np.append(True, np.diff(block) > 0)), step_s[given, None]

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(weight * values[given], begins) / np.add.reduceat(weight, begins))

    rims, steering = means(wheels.rim_m_s), means(steering_rad)
    along, _ = wheel_rows(rover, steering)
    left = []
    for k in range(len(rover.wheels)):
        others = rims.copy()
        others[:, k] = np.nan
        twist, off = body_twist(rover, others, steering)
        left.append((float(np.mean(off**2)), k, np.einsum("ni,ni->n", along[:, k], twist)))
    _, k, expected = min(left)
    if rover.wheels[k] in tested:
        return wheels
    turning = np.abs(expected) > UNDER_WAY * np.abs(expected).max()
    scale, trusted = float(np.median(rims[turning, k] / expected[turning])), wheels.trusted.copy()
    # A wheel that stands, or turns otherwise altogether, is no encoder that counts in another scale.
    counts = 1.0 / MOST_SCALE < scale < MOST_SCALE
    mended = np.where(np.arange(len(rover.wheels)) == k, scale if counts else np.nan, 1.0)
    trusted[:, k] &= counts
    off_m_s = float(np.median(body_twist(rover, rims / mended, steering)[1])) / wheels.usual_m_s
    if off_m_s > PACE:
        what = f"rims and steering of the wheels differ by {100 * off_m_s:.2g} % from any one motion"
        done = "their best fit is taken; are the wheels named as they should be?"
        findings.add("wheels disagree", what, done, doubt=True)
        return wheels
    if abs(scale - 1.0) > PACE:
        what = f"wheel {rover.wheels[k]} turns {scale:.3f} times as far as the others say"
        done = "its angles and rates are taken to be in that scale" if trusted[:, k].any() else "it is left out"
        findings.add("encoder scale", what, done)
    return replace(wheels, rim_m_s=wheels.rim_m_s / mended, trusted=trusted)


def shape_effect(rover: Rover, held: PrescribedLoads, over_m: FloatArray, stiffness: float) -> FloatArray:
    """Change of the twist that rims and steering say, by the shape of the ground. (n, 3) [m/s, m/s, rad/s]

    Parameters
    ----------
    held : the rover along a motion that is about right.
    over_m : where the point is that the wheels stand about (see `sway_m`). (n, 2) [m]
    stiffness : of the ground against side slip, as a share of that against slip. [-]
    """
    along, across = wheel_rows(rover, np.radians(held.motion.steering_deg))
    off_x, off_y = (np.nan_to_num(part) for part in ground_velocities(rover, held, over_m))
    rim, weight = held.motion.speed_m_s, _weights(held, stiffness)
    flat = fitted_twist(along, across, rim, np.zeros_like(rim))
    return fitted_twist(along, across, rim - off_x, -off_y, weight) - flat


def slope_effect(rover: Rover, held: PrescribedLoads, stiffness: float) -> FloatArray:
    """Deviation of ahead, left and turn where a wheel slips, or slips aside, as steep as its slope is. (n, 3, 2)

    Shares of the rims' speed, the turn in 1/m; the first column is of slopes along the wheels, the second across.
    """
    along, across = wheel_rows(rover, np.radians(held.motion.steering_deg))
    sign = np.where(held.motion.speed_m_s < 0, -1.0, 1.0)
    climb, lean = (np.nan_to_num(sign * held.axes[:, :, k, 2]) for k in (0, 1))
    still, weight = np.zeros_like(climb), _weights(held, stiffness)
    parts = (fitted_twist(along, across, -climb, still, weight), fitted_twist(along, across, still, -lean, weight))
    return np.stack(parts, axis=-1)


def _weights(held: PrescribedLoads, stiffness: float) -> tuple[FloatArray, FloatArray]:
    """Of speeds along and across: loads as shares of their mean, no less than `LEAST_LOAD`. (n, wheels) each"""
    load = held.states[..., STATE_COLUMNS.index("normal_force_n")]
    usual = float(np.nanmean(load)) if np.isfinite(load).any() else 1.0
    share = np.maximum(np.where(np.isfinite(load), load / usual, 1.0), LEAST_LOAD)
    return share, stiffness * share


def ground_velocities(rover: Rover, held: PrescribedLoads, over_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How much faster wheels move along and across their planes than those of a rover on a plane. (n, wheels) [m/s]

    As of `shape_effect`; forward is as the rover has it.
    """
    motion = held.motion
    along, across = wheel_rows(rover, np.radians(motion.steering_deg))
    twist = _twist(motion.time_s, over_m, np.radians(motion.yaw_deg))
    v_x, v_y = _seen_velocities(held)
    return v_x - np.einsum("nwi,ni->nw", along, twist), v_y - np.einsum("nwi,ni->nw", across, twist)


def _twist(time_s: FloatArray, place_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Velocity ahead, to the left, and turn, by the differences that `prescribed_loads` takes. (n, 3)"""
    rate = np.gradient(np.column_stack([place_m, yaw_rad]), time_s, axis=0)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack([cos * rate[:, 0] + sin * rate[:, 1], cos * rate[:, 1] - sin * rate[:, 0], rate[:, 2]])


def _seen_velocities(held: PrescribedLoads) -> tuple[FloatArray, FloatArray]:
    """Velocity of each wheel along and across its plane on the ground, forward as of the rover. (n, wheels) [m/s]"""
    slip, side = (held.states[..., STATE_COLUMNS.index(name)] for name in ("slip_ratio", "side_slip_deg"))
    speed = held.motion.speed_m_s
    travel = np.where(slip >= 0, 1.0 - slip, 1.0 / (1.0 + np.minimum(slip, 0.0)))
    v_x = travel * speed
    return v_x, np.sign(speed) * np.tan(np.radians(side)) * np.abs(v_x)


def sway_m(rover: Rover, paths: FloatArray) -> FloatArray:
    """How far the rover's origin is from above the point that its wheels stand about, by roll and pitch. (n, 2) [m]

    The wheels carry that point; the origin sways above it, which is no slip. Where how the rover stands is not known,
    as beside a halt, it stands as about there: a tilt left out would be a jump, and read as a slip.
    """
    height = rover.wheel.radius_m - float(rover.wheel_positions_m[:, 2].mean())
    given = np.flatnonzero(np.isfinite(paths[:, 3:5]).all(axis=1))
    tilts = paths[given, 3:5] if given.size else np.zeros((1, 2))
    roll, pitch = np.radians([np.interp(np.arange(len(paths)), given if given.size else [0], c) for c in tilts.T])
    yaw = np.radians(np.nan_to_num(paths[:, 5]))
    return height * onto_map(yaw, np.sin(pitch) * np.cos(roll), -np.sin(roll))
