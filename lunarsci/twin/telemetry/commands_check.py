"""Telemetry beside the plan: the same commands, at the same times, from the same start."""

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import Schedule, commands_at, make_schedule
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.findings import Findings
from lunarsci.twin.telemetry.record import Telemetry

__all__ = ["check_against_plan"]

FloatArray = npt.NDArray[np.float64]
STEERING_DEG, SPEED_SHARE = 2.0, 0.25
"""How far a row's commands may be off the plan's: steering, and rim speed as a share of the plan's; assumed."""
LONGEST_SHIFT_S = 120.0
"""Clocks are looked for so far apart; assumed. [s]"""
SOME, FITS, MOST = 0.01, 0.15, 0.4
"""Share of rows that may be off; may be off at another time of the clock; beyond which it is another plan; assumed."""
COVERED = 0.6
"""Share of rows that must lie within a plan for its clock to be told; assumed."""
START_M, HEADING_DEG = 0.5, 10.0
"""How far the first position and heading may be from the plan's start; assumed. [m, deg]"""
EDGE_S = 5.0
"""How much of a plan may be missing at its ends unsaid; assumed. [s]"""


def check_against_plan(telemetry: Telemetry, rover: Rover, plan: Plan, findings: Findings) -> None:
    """Say where telemetry and plan differ: clock, commands, coverage, start.

    Raises DataError where the commands are those of another plan.
    """
    schedule = make_schedule(plan, rover)
    _check_coverage(telemetry, schedule, findings)
    if plan.fixes is None:
        _check_commands(telemetry, rover, schedule, findings)
    _check_heading(telemetry, plan, findings)
    rows = np.flatnonzero(telemetry.fixed)
    if rows.size and telemetry.time_s[rows[0]] < EDGE_S:
        off = float(np.hypot(*(telemetry.fix_m[rows[0]] - [plan.x_m, plan.y_m])))
        sigma = float(np.sqrt(np.trace(telemetry.fix_covariance_m2[rows[0]])))
        if off > START_M + 5.0 * sigma:
            what = f"the first position is {off:.3g} m from the plan's start: another frame, or another plan"
            findings.add("another start", what, "kept as it is", doubt=True)


def _check_heading(telemetry: Telemetry, plan: Plan, findings: Findings) -> None:
    known = np.flatnonzero(np.isfinite(telemetry.yaw_deg))
    if not known.size or telemetry.time_s[known[0]] > EDGE_S:
        return
    off = float(np.remainder(telemetry.yaw_deg[known[0]] - plan.heading_deg + 180.0, 360.0) - 180.0)
    if abs(off) > HEADING_DEG:
        what = f"the first heading is {off:.3g} deg off the plan's: another frame, or another plan"
        findings.add("another start", what, "kept as it is", doubt=True)


def _check_coverage(telemetry: Telemetry, schedule: Schedule, findings: Findings) -> None:
    first, last, end = float(telemetry.time_s[0]), float(telemetry.time_s[-1]), schedule.duration_s
    if first > EDGE_S:
        what = f"telemetry begins {first:.4g} s after the plan"
        findings.add("late begin", what, "there are no states before", time_s=first)
    if last < end - EDGE_S:
        what = f"telemetry ends {end - last:.4g} s before the plan: cut off, or the drive was stopped"
        findings.add("early end", what, "there are no states after", time_s=last)
    if last > end + EDGE_S:
        what = f"telemetry goes on for {last - end:.4g} s after the plan's end"
        findings.add("late end", what, "kept; is it the plan that was driven?", time_s=last)


def _check_commands(telemetry: Telemetry, rover: Rover, schedule: Schedule, findings: Findings) -> None:
    steering = np.where(np.isfinite(telemetry.steering_deg), telemetry.steering_deg, telemetry.steered_deg)
    speed = telemetry.speed_m_s
    if not np.isfinite(speed).any():
        speed = telemetry.rate_deg_s * np.radians(rover.wheel.shearing_radius_m)
    times = telemetry.time_s

    def share_off(shift: float) -> float:
        inside = (times - shift >= 0) & (times - shift <= schedule.duration_s)
        if inside.sum() < COVERED * len(times):
            return 1.0
        told = commands_at(rover, schedule, times[inside] - shift)
        off = np.abs(steering[inside] - np.degrees(told.steering_rad)) > STEERING_DEG
        off |= np.abs(speed[inside] - told.speed_m_s) > SPEED_SHARE * schedule.plan.speed_m_s
        return float(off.any(axis=1).mean())

    now = share_off(0.0)
    if now <= SOME or now * len(times) < 3:
        return
    step = max(0.5, float(np.median(np.diff(times))))
    shifts = np.arange(-LONGEST_SHIFT_S, LONGEST_SHIFT_S + step / 2, step)
    shares = np.array([share_off(float(shift)) for shift in shifts])
    good = np.flatnonzero(shares <= shares.min() + 1e-12)
    best = int(good[np.argmin(np.abs(shifts[good]))])
    text = f"the commands of {100 * now:.0f} % of the rows are not those of the plan at their times"
    if shares[best] < min(FITS, 0.5 * now) and abs(shifts[best]) > step:
        way = "late" if shifts[best] > 0 else "early"
        what = f"{text}; they fit if the clock is {abs(shifts[best]):.3g} s {way}"
        findings.add("clock offset", what, "times are kept as they are: mend them before `twin update`", doubt=True)
    elif now > MOST:
        raise DataError(f"{telemetry.file}: {text}, at no shift of the clock; give the plan that was driven")
    else:
        findings.add("other commands", text, "the telemetry's are taken", count=round(now * len(times)), doubt=True)
