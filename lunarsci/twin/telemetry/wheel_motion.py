"""How the wheels turned: their encoders, checked against each other, the rates and the commands."""

from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.reading import Findings, Telemetry
from lunarsci.twin.telemetry.rests import TURNED_DEG
from lunarsci.twin.telemetry.wheel_readings import between

MISFIT = 0.25
"""Share of the expected turn, and [deg] `MISFIT_DEG`, by which an encoder's step may differ from its rate; assumed."""
MISFIT_DEG = 3.0
"""See `MISFIT`."""
CLOCK_SHARE = 0.4
"""Share of a step between rows by which the clock may differ from all wheels unsaid; assumed."""
STUCK_ROWS = 4
"""Equal readings in a row of something that moves are a sensor that hangs; assumed."""
STILL_SHARE = 0.05
"""Share of the usual rim speed below which a wheel stands; assumed."""
MOSTLY = 0.6
"""Share of equal readings above which a channel is merely coarse or free of noise; assumed."""


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


def wheel_motion(
    telemetry: Telemetry, rover: Rover, gaps: BoolArray, findings: Findings, *, planned: bool = False
) -> WheelMotion:
    """Rim speeds from encoders, where these fail from rates, else from commands.

    `gaps` are steps between rows over which nothing was sent (n - 1,); `planned` says that the clock will be compared
    with a plan too. Resets and wraps of an encoder, readings that hang, runs without a reading, and a clock that jumps
    against all encoders are said. Raises DataError where no wheel turns, and for rows that tell of none.
    """
    per_deg = np.radians(rover.wheel.shearing_radius_m)
    steps, resting = np.diff(telemetry.time_s)[:, None], resting_steps(telemetry)
    told = between(telemetry.speed_m_s) / per_deg
    angle = np.diff(telemetry.angle_deg, axis=0)
    hung = _hanging_angles(telemetry, rover, angle, np.where(np.isfinite(told), told, between(telemetry.rate_deg_s)))
    # The step at which an encoder that hung moves on holds all it missed.
    angle[hung | np.vstack([np.zeros_like(hung[:1]), hung[:-1]])] = np.nan
    rate = between(_sound_rates(telemetry, rover, angle / steps, told, findings, hung))
    # Noise of a wheel that stands is no motion: over hours it would add up to one.
    for turn in (told, rate, angle):
        turn[resting] *= 0.0
    expected = np.where(np.isfinite(rate), rate, told) * steps
    angle = _mended_steps(telemetry, rover, angle, expected, gaps, findings)
    measured = np.where(np.isfinite(angle), angle / steps, np.where(hung, np.nan, rate))
    _clock_steps(telemetry, angle, expected, gaps, findings, planned=planned)
    _missing(telemetry, rover, measured, hung, findings)
    told_share = _obedience(measured, told)
    rim = per_deg * np.where(np.isfinite(measured), measured, told)
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
    known = np.isfinite(measured)
    return WheelMotion(
        rim_m_s=rim,
        measured=known,
        trusted=known if known.any() else np.isfinite(rim),
        usual_m_s=usual,
        told_share=told_share,
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


def _mended_steps(
    telemetry: Telemetry,
    rover: Rover,
    step: FloatArray,
    expected: FloatArray,
    gaps: BoolArray,
    findings: Findings,
) -> FloatArray:
    """Turns between rows from the encoders, without wraps, NaN at resets. (n - 1, wheels) [deg]"""
    if not np.isfinite(step).any():
        return step
    if not np.isfinite(expected).any():
        return _nearest_turns(telemetry, rover, step, findings)
    step, off = step.copy(), step - expected
    wrong = np.abs(off) > _tolerance(expected)
    # Over a gap the wheels may have stopped: any turn up to the expected one may be right.
    wrong[gaps] &= (step * np.sign(expected) < -MISFIT_DEG)[gaps] | (np.abs(step) > 1.5 * np.abs(expected))[gaps]
    # What all wheels do at once, forwards, is the clock, not an encoder.
    wrong &= ~(np.sum(wrong, axis=1) > 0.5 * wrong.shape[1])[:, None] | (np.sign(step) != np.sign(expected))
    for k, wheel in enumerate(rover.wheels):
        rows = np.flatnonzero(wrong[:, k])
        if not rows.size:
            continue
        turns = off[rows, k] / 360.0
        wrapped = np.abs(turns - np.rint(turns)) * 360.0 < MISFIT_DEG + MISFIT * np.abs(expected[rows, k])
        wrapped &= np.rint(turns) != 0
        step[rows[wrapped], k] -= 360.0 * np.rint(turns[wrapped])
        step[rows[~wrapped], k] = np.nan
        if wrapped.any():
            # Nobody knows how many whole turns a gap hides.
            step[gaps, k] = np.nan
        for kind, which, done in (
            ("encoder wrap", wrapped, "whole turns added"),
            ("encoder reset", ~wrapped & ~gaps[rows], "its rate, else the command, is taken for these steps"),
            ("encoder over a gap", ~wrapped & gaps[rows], "its rate beside the gap is taken"),
        ):
            if which.any():
                row = rows[int(np.argmax(which))]
                what = f"the angle of wheel {wheel} jumps by {off[row, k]:+.4g} deg against its rate"
                first = float(telemetry.time_s[row + 1])
                findings.add(kind, what, done, count=int(which.sum()), time_s=first)
    return step


def _nearest_turns(telemetry: Telemetry, rover: Rover, step: FloatArray, findings: Findings) -> FloatArray:
    """The same where neither rates nor commands tell the turn: of an angle that stays within one turn the nearest."""
    step = step.copy()
    for k, wheel in enumerate(rover.wheels):
        angle, jumps = telemetry.angle_deg[:, k], np.abs(np.nan_to_num(step[:, k])) > 180.0
        if jumps.any() and np.nanmax(angle) - np.nanmin(angle) <= 360.0:
            first = float(telemetry.time_s[int(np.argmax(jumps)) + 1])
            step[jumps, k] -= 360.0 * np.rint(step[jumps, k] / 360.0)
            what = f"the angle of wheel {wheel} begins anew after each turn"
            findings.add("encoder wrap", what, "whole turns added", count=int(jumps.sum()), time_s=first)
    return step


def _tolerance(expected: FloatArray) -> FloatArray:
    """How far an encoder's step may be off. [deg]"""
    largest = float(np.max(np.abs(expected), where=np.isfinite(expected), initial=0.0))
    usual = float(np.nanmedian(np.abs(expected))) if np.isfinite(expected).any() else 0.0
    return np.maximum(MISFIT_DEG + MISFIT * np.abs(expected), 0.5 * min(usual, largest))


def _hanging_angles(telemetry: Telemetry, rover: Rover, step: FloatArray, wanted: FloatArray) -> BoolArray:
    """Steps at which an encoder repeats itself while its wheel should turn. (n - 1, wheels)"""
    largest = float(np.max(np.abs(wanted), where=np.isfinite(wanted), initial=0.0))
    should = np.abs(np.nan_to_num(wanted)) > 0.3 * largest
    hung = np.zeros(step.shape, dtype=bool)
    for k in range(step.shape[1]):
        hung[:, k] = _long_runs(should[:, k] & (step[:, k] == 0))
    return hung


def _sound_rates(
    telemetry: Telemetry,
    rover: Rover,
    turned: FloatArray,
    told: FloatArray,
    findings: Findings,
    stuck: BoolArray,
) -> FloatArray:
    """Rates without those that hang, or that encoder and command both deny. (n, wheels) [deg/s]"""
    rate = telemetry.rate_deg_s.copy()
    middles = between(rate)
    for k, wheel in enumerate(rover.wheels):
        hung = stuck[:, k]
        if hung.any():
            what = f"the angle of wheel {wheel} does not change while it is to turn: stuck wheel or sensor"
            first = float(telemetry.time_s[int(np.argmax(hung))])
            findings.add("stuck", what, "its states are not valid there", count=int(hung.sum()), time_s=first)
        same = np.append(False, np.diff(rate[:, k]) == 0)
        still = np.abs(np.nan_to_num(rate[:, k])) == 0
        runs = _long_runs(same & ~still) if same.mean() < MOSTLY else np.zeros(len(same), dtype=bool)
        both = np.abs(middles[:, k] - told[:, k]) > MISFIT_DEG + MISFIT * np.abs(told[:, k])
        both &= np.abs(turned[:, k] - told[:, k]) < MISFIT_DEG + MISFIT * np.abs(told[:, k])
        odd = np.zeros(len(same), dtype=bool)
        odd[:-1] |= both
        odd[1:] |= both
        odd &= ~runs
        for kind, rows, what in (
            ("stuck", runs, f"the rate of wheel {wheel} stays the same to the last digit"),
            ("odd rate", odd, f"the rate of wheel {wheel} is denied by its angle and by its command"),
        ):
            if rows.any():
                first = float(telemetry.time_s[int(np.argmax(rows))])
                other = bool(np.isfinite(turned[:, k]).any() or np.isfinite(told[:, k]).any())
                done = "left out; its angle or command is taken" if other else "kept, as nothing else tells its turn"
                findings.add(kind, what, done, count=int(rows.sum()), time_s=first)
                rate[rows, k] = np.nan if other else rate[rows, k]
    return rate


def _obedience(measured: FloatArray, told: FloatArray) -> float:
    """How fast wheels turn beside their commands; 1 where that is not known."""
    both = np.isfinite(measured) & np.isfinite(told)
    both &= np.abs(told) > 0.3 * np.max(np.abs(told), where=np.isfinite(told), initial=0.0)
    return float(np.median(measured[both] / told[both])) if both.any() else 1.0


def _long_runs(on: BoolArray, least: int = STUCK_ROWS) -> BoolArray:
    """Where something holds for at least so many steps in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    result = np.zeros(on.shape, dtype=bool)
    for begin, end in edges.reshape(-1, 2):
        result[begin:end] = end - begin >= least
    return result


def _clock_steps(
    telemetry: Telemetry,
    angle: FloatArray,
    expected: FloatArray,
    gaps: BoolArray,
    findings: Findings,
    *,
    planned: bool,
) -> None:
    """Steps at which all encoders together say that another time went by than the clock says."""
    steps = np.diff(telemetry.time_s)
    largest = float(np.max(np.abs(expected[~gaps]), where=np.isfinite(expected[~gaps]), initial=0.0))
    turning = np.isfinite(angle) & (np.abs(expected) > 0.3 * largest)
    enough = turning.sum(axis=1) >= 0.5 * turning.shape[1]
    if not enough.any():
        return
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(turning, angle / expected, np.nan)
    shares = np.ones(len(steps))
    shares[enough] = np.nanmedian(ratio[enough], axis=1)
    went, usual = shares * steps, float(np.median(steps))
    wrong = (
        enough & _steady(telemetry) & (np.abs(went - steps) > CLOCK_SHARE * np.maximum(np.minimum(steps, went), usual))
    )
    for kind, rows, why, doubt in (
        ("clock step", wrong & ~gaps, "", True),
        ("halt or clock step", wrong & gaps, ": they stopped within the gap, or the clock jumped", not planned),
    ):
        if rows.any():
            first = int(np.argmax(rows))
            findings.add(
                kind,
                f"the clock counts {steps[first]:.4g} s where the wheels turned for {went[first]:.4g} s{why}",
                "slip rests on the wheels' angles, but times after it may not fit those before",
                count=int(rows.sum()),
                time_s=float(telemetry.time_s[first]),
                doubt=doubt,
            )


def _steady(telemetry: Telemetry) -> BoolArray:
    """Steps over which the wheels keep their rates: a change of speed is no step of the clock. (n - 1,)"""
    rates = np.abs(telemetry.rate_deg_s)
    if not np.isfinite(rates).any():
        return np.ones(len(rates) - 1, dtype=bool)
    rate = np.median(np.nan_to_num(rates), axis=1)
    return np.asarray(np.abs(np.diff(rate)) <= 0.2 * np.maximum(rate[1:], rate[:-1]))


def _missing(telemetry: Telemetry, rover: Rover, measured: FloatArray, hung: BoolArray, findings: Findings) -> None:
    lost = ~np.isfinite(measured) & ~hung
    if not lost.any():
        return
    if lost.all():
        done = "the commanded speeds are taken: slip holds as far as the wheels obeyed"
        findings.add("no encoders", "neither angles nor rates of the wheels", done, count=len(lost))
        return
    for k, wheel in enumerate(rover.wheels):
        if lost[:, k].any():
            first = float(telemetry.time_s[int(np.argmax(lost[:, k]))])
            what = f"neither angle nor rate of wheel {wheel}"
            findings.add(
                "missing readings",
                what,
                "its states are not valid there",
                count=int(lost[:, k].sum()),
                time_s=first,
            )
