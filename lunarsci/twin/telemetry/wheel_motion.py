"""How the wheels turned between rows: which of their encoders, rates and commands tell it, by how well they agree.

Of a step an encoder counts, has begun anew after whole turns, or says nothing, as after a reset; a rate tells the turn
or says nothing; a command is obeyed or not. Each set of these has odds beforehand, and what it takes for true must
agree within its errors. The most probable set is taken for every step and wheel.
"""

import itertools
import math
import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.reading import Findings, Telemetry
from lunarsci.twin.telemetry.readings import between
from lunarsci.twin.telemetry.rests import TURNED_DEG, digit_of, held

SIGMA_DEG, RATE_SHARE, TOLD_SHARE = 1.0, 0.1, 0.2
"""Standard errors of turns between rows: of all [deg], of rates and of commands as shares; assumed."""
STAMP_S = 0.5
"""By how much rows may be stamped off; assumed. [s]"""
LN_NOTHING = {"angle": math.log(0.01), "rate": math.log(0.005), "told": math.log(0.02)}
"""Odds beforehand, of a step, that a witness says nothing of it; assumed."""
LN_WRAP, LN_CLOCK = math.log(0.02), math.log(1e-4)
"""Odds beforehand, of a step, that an encoder begins anew after whole turns, and that the clock jumps; assumed."""
STILL_SHARE = 0.05
"""Share of the usual rim speed below which a wheel stands; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WheelMotion:
    """How the rims moved between successive rows.

    Attributes
    ----------
    rim_m_s : mean speed of each rim r_s omega between rows, NaN where unknown. (n - 1, wheels) [m/s]
    measured : False where it is a command only. (n - 1, wheels)
    trusted : wheels and times whose own states can be given. (n - 1, wheels)
    usual_m_s : median speed of the rims while they turn. [m/s]
    told_share : rim speed measured over commanded, 1 where there is no command.
    """

    rim_m_s: FloatArray
    measured: BoolArray
    trusted: BoolArray
    usual_m_s: float
    told_share: float = 1.0

    @property
    def moving(self) -> BoolArray:
        """Whether any rim turns at more than a creep. (n - 1,)"""
        return np.asarray((np.abs(np.nan_to_num(self.rim_m_s)) > STILL_SHARE * self.usual_m_s).any(axis=1))


def wheel_motion(telemetry: Telemetry, rover: Rover, gaps: BoolArray, findings: Findings) -> WheelMotion:
    """Rim speeds from encoders, where these say nothing from rates, else from commands.

    `gaps` are steps between rows over which nothing was sent. (n - 1,) Readings that hang or say nothing, wraps, runs
    without a reading, and a clock that jumps against all encoders are said. Raises DataError where no wheel turns, and
    for rows that tell of none.
    """
    per_deg = np.radians(rover.wheel.shearing_radius_m)
    steps, resting = np.diff(telemetry.time_s)[:, None], resting_steps(telemetry)
    told = between(telemetry.speed_m_s) / per_deg * steps
    angle, rate = np.diff(telemetry.angle_deg, axis=0), between(telemetry.rate_deg_s) * steps
    # An encoder that hangs beside what its rate, else its command, says.
    expected, digits = _since_start(np.where(np.isfinite(rate), rate, told)), _digits(telemetry)
    hung = np.column_stack(
        [held(one, 1.0, *beside) for one, *beside in zip(telemetry.angle_deg.T, expected.T, digits, strict=True)]
    )
    # The step at which an encoder that hung moves on holds all it missed.
    angle[hung[1:] | hung[:-1]] = np.nan
    # Noise of a wheel that stands is no motion: over hours it would add up to one.
    for turn in (told, rate, angle):
        turn[resting] *= 0.0
    turns = {"told": told, "rate": rate, "angle": angle}
    rates = {"told": telemetry.speed_m_s / per_deg, "rate": telemetry.rate_deg_s}
    went = _turns(turns, _sigma(turns, rates, digits, steps), rover.max_speed_m_s / per_deg * (steps + STAMP_S), gaps)
    measured = np.where(went.counts, angle - 360.0 * went.wraps, np.where(went.tells, rate, np.nan)) / steps
    _say(telemetry, rover, went, hung[1:], ~np.isfinite(measured), findings)
    rim, known = per_deg * np.where(np.isfinite(measured), measured, told / steps), np.isfinite(measured)
    fast = np.abs(rim[np.isfinite(rim)])
    usual = float(np.median(fast[fast > STILL_SHARE * fast.max()])) if fast.size and fast.max() > 0 else 0.0
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
        measured=known,
        trusted=known if known.any() else np.isfinite(rim),
        usual_m_s=usual,
        told_share=_obedience(measured, told / steps),
    )


def resting_steps(telemetry: Telemetry) -> BoolArray:
    """Steps over which the rover stands: all wheels are told so, and none gets any further. (n - 1,)"""
    told = (telemetry.speed_m_s == 0).all(axis=1)
    resting = told[1:] & told[:-1]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(np.int8), [0]])))
    for begin, end in edges.reshape(-1, 2):
        turned = np.abs(telemetry.angle_deg[begin + 1 : end + 1] - telemetry.angle_deg[begin])
        resting[begin:end] = not (turned > TURNED_DEG).any()
    return np.asarray(resting | telemetry.rested)


def _since_start(turn_deg: FloatArray) -> FloatArray:
    return np.vstack([np.zeros_like(turn_deg[:1]), np.cumsum(np.nan_to_num(turn_deg), axis=0)])


def _digits(telemetry: Telemetry) -> FloatArray:
    """Standard error of the turn that each encoder says, by its last digit. (wheels,) [deg]"""
    digits = np.array([digit_of(column) for column in telemetry.angle_deg.T])
    return np.hypot(SIGMA_DEG, 0.5 * np.where(np.isfinite(digits), digits, 0.0))


class _Turns(NamedTuple):
    """What tells the turn of every step and wheel.

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
    for name, share in (("rate", RATE_SHARE), ("told", TOLD_SHARE)):
        changes = 0.5 * np.abs(np.nan_to_num(np.diff(rates_deg_s[name], axis=0))) * step_s
        sigma[name] = np.sqrt(SIGMA_DEG**2 + (share * np.nan_to_num(turns[name])) ** 2 + changes**2)
    return sigma


def _turns(
    turns: dict[str, FloatArray], sigma: dict[str, FloatArray], fastest_deg: FloatArray, gaps: BoolArray
) -> _Turns:
    """The most probable set of witnesses, of turns that commands, rates and encoders say. (n - 1, wheels) [deg]"""
    told, rate, angle = turns.values()
    known = np.isfinite(rate)
    found = _likeliest(turns, sigma, fastest_deg, np.full(angle.shape[1], LN_WRAP))
    # An encoder that wraps does so often; how many whole turns a gap hides nobody knows.
    wraps = (found.wraps != 0).mean(axis=0)
    angle = np.where(gaps[:, None] & (wraps > 0), np.nan, angle)
    expected = np.where(known, rate, told)
    clock = _clock(angle, expected, np.hypot(sigma["angle"], np.where(known, sigma["rate"], sigma["told"])))
    turns = {"told": clock[:, None] * told, "rate": clock[:, None] * rate, "angle": angle}
    found = _likeliest(turns, sigma, fastest_deg, np.log(np.maximum(wraps, math.exp(LN_WRAP))))
    return found._replace(clock=clock, off_deg=angle - np.nan_to_num(clock[:, None] * expected))


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
            known, value = np.isfinite(turn), np.nan_to_num(turn)
            if not true:
                ln += np.where(known, LN_NOTHING[name], 0.0)
                continue
            variance, off = sigma[name] ** 2 + 1.0 / precision, value - mean
            agree = _ln_agree(off, variance, widest)
            if name == "angle":
                whole = np.rint(off / 360.0)
                anew = np.where(whole != 0, _ln_agree(off - 360.0 * whole, variance, widest) + ln_wrap, -np.inf)
                turned, agree = np.where(anew > agree, whole, 0.0), np.maximum(agree, anew)
            weight = sigma[name] ** -2
            mean = (precision * mean + weight * (value - 360.0 * turned)) / (precision + weight)
            precision, ln = precision + weight, np.where(known, ln + agree, -np.inf)
        better = ln > best
        best, wraps = np.where(better, ln, best), np.where(better, turned, wraps)
        counts, tells = np.where(better, taken[2], counts), np.where(better, taken[1], tells)
    return _Turns(counts, tells, wraps, np.full(shape, np.nan), np.ones(len(best)))


def _clock(angle: FloatArray, expected: FloatArray, sigma: FloatArray) -> FloatArray:
    """How much more time went by than the clock says, where most encoders together say so. (n - 1,)"""
    turning = np.isfinite(angle) & (np.abs(expected) > 3.0 * SIGMA_DEG)
    share = np.ones(angle.shape)
    share[turning] = angle[turning] / expected[turning]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        ratio = np.nan_to_num(np.nanmedian(np.where(turning, share, np.nan), axis=1), nan=1.0)

    def ln_of(off_deg: FloatArray) -> FloatArray:
        ln = np.logaddexp(_ln_agree(off_deg, sigma**2), LN_NOTHING["angle"])
        return np.asarray(np.where(turning, ln, 0.0).sum(axis=1))

    gain = ln_of(np.nan_to_num(angle - ratio[:, None] * expected)) - ln_of(np.nan_to_num(angle - expected))
    most = turning.mean(axis=1) > 0.5
    return np.where(most & (gain + LN_CLOCK > 0) & (ratio >= 0), ratio, 1.0)


def _say(
    telemetry: Telemetry, rover: Rover, went: _Turns, hung: BoolArray, lost: BoolArray, findings: Findings
) -> None:
    """Say what does not tell the turn of a wheel, or tells it otherwise."""
    blank = lost & ~hung
    if blank.all():
        done = "the commanded speeds are taken: slip holds as far as the wheels obeyed"
        findings.add("no encoders", "neither angles nor rates of the wheels", done, count=len(blank))
        return
    jumps, known = "the angle of wheel {} jumps by {:+.4g} deg against its rate", np.isfinite(went.off_deg)
    odd, rate = ~went.tells & went.counts, np.isfinite(between(telemetry.rate_deg_s))
    for kind, where, what, done in (
        ("stuck", hung, "the angle of wheel {} does not change while it is to turn: stuck wheel or sensor",
         "its rate is taken there; without one its states are not valid"),
        ("encoder wrap", went.counts & (went.wraps != 0), jumps, "whole turns added"),
        ("encoder reset", ~went.counts & known, jumps, "its rate, else the command, is taken for these steps"),
        ("odd rate", odd & rate, "the rate of wheel {} is denied by its angle",
         "left out; its angle is taken"),
        ("missing readings", blank, "neither angle nor rate of wheel {}", "its states are not valid there"),
    ):  # fmt: skip
        for k in np.flatnonzero(where.any(axis=0)):
            row = int(np.argmax(where[:, k]))
            text = what.format(rover.wheels[k], went.off_deg[row, k])
            findings.add(kind, text, done, count=int(where[:, k].sum()), time_s=float(telemetry.time_s[row]))
    if (jumped := went.clock != 1.0).any():
        first, step_s = int(np.argmax(jumped)), np.diff(telemetry.time_s)
        what = (
            f"the clock counts {step_s[first]:.4g} s where the wheels turned for {(went.clock * step_s)[first]:.4g} s"
        )
        done = "slip rests on the wheels' angles, but times after it may not fit those before"
        first_s = float(telemetry.time_s[first])
        findings.add("clock step", what, done, count=int(jumped.sum()), time_s=first_s, doubt=True)


def _obedience(measured: FloatArray, told: FloatArray) -> float:
    """How fast wheels turn beside their commands, the median of the wheels; 1 where that is not known."""
    both = np.isfinite(measured) & np.isfinite(told)
    # Of sums: a coarse encoder has steps of many sizes.
    sums = [(np.abs(measured[on, k]).sum(), np.abs(told[on, k]).sum()) for k, on in enumerate(both.T)]
    return float(np.median([own / whole for own, whole in sums if own and whole] or [1.0]))
