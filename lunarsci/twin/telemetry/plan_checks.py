"""Telemetry beside the plan that is said to have been driven: clock, halts, commands, start."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import RAMP_COUNTS_S, RAMP_S, Schedule, commands_at
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.checks import UNDER_WAY, taken
from lunarsci.twin.telemetry.reading import Findings, Telemetry

STEERING_DEG, SPEED_SHARE = 2.0, 0.25
"""How far a row's commands may be off the plan's: steering, and rim speed as a share of the plan's; assumed."""
LONGEST_SHIFT_S = 120.0
"""Clocks are looked for so far apart; assumed. [s]"""
SOME, FITS, MOST = 0.01, 0.15, 0.4
"""Share of rows that may be off; may be off at another time of the clock; beyond which it is another plan; assumed."""
NEAR_M, MOST_NEAR, FEW_NEAR = 0.3, 0.8, 0.5
"""Commands differ near the joins of arcs where so much of what differs lies so near to them or within a blend, and so
little of the drive at most does; assumed."""
BLEND = "blend_m is half before a join, half behind: give the plan as it was driven"
COVERED = 0.6
"""Share of rows that must lie within a plan for its clock to be told; assumed."""
START_M, HEADING_DEG = 0.5, 10.0
"""How far the first position and heading may be from the plan's start; assumed. [m, deg]"""
EDGE_S = 5.0
"""How much of a plan may be missing at its ends, and a halt be longer than planned, unsaid, and how long a rover may
take to steer to its first leg without doubt; assumed. [s]"""
STOP_COSTS_S = 2.0 * (RAMP_S - RAMP_COUNTS_S)
"""What slowing down and speeding up again cost, beside the halt itself; of the ramps assumed. [s]"""


def by_the_plan(
    telemetry: Telemetry, rover: Rover, schedule: Schedule, findings: Findings
) -> tuple[Telemetry, bool, float]:
    """Telemetry by the clock of a plan; whether its commands are the plan's, and how much longer it stood still. [s]

    Another clock is found by the commands, and said. So are halts that the plan does not have, and other commands.
    """
    plan, beside = schedule.plan, _Beside(telemetry, rover, schedule)
    halts = () if plan.fixes else beside.halts()
    if halts:
        _say_halts(halts, schedule, findings)
    elif plan.fixes is None:
        return *_clocked(telemetry, beside, findings), 0.0
    return telemetry, bool(halts), sum(halt.longer_s for halt in halts)


def check_ends(telemetry: Telemetry, schedule: Schedule, longer_s: float, findings: Findings) -> None:
    """Say where telemetry begins or ends otherwise than its plan, which halts made so much longer."""
    plan = schedule.plan
    _check_coverage(telemetry, schedule, longer_s, findings)
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


def _check_coverage(telemetry: Telemetry, schedule: Schedule, longer_s: float, findings: Findings) -> None:
    """Whether all of the plan is there, which halts made so much longer."""
    first, last, end = float(telemetry.time_s[0]), float(telemetry.time_s[-1]), schedule.duration_s + longer_s
    if first > EDGE_S:
        what = f"telemetry begins {first:.4g} s after the plan"
        findings.add("late begin", what, "there are no states before", time_s=first)
    if last < end - EDGE_S:
        what = f"telemetry ends {end - last:.4g} s before the plan: cut off, or the drive was stopped"
        findings.add("early end", what, "there are no states after", time_s=last)
    if last > end + EDGE_S:
        what = f"telemetry goes on for {last - end:.4g} s after the plan's end"
        done = "kept; is it the plan that was driven? `until` leaves out what was after"
        findings.add("late end", what, done, time_s=last)


class _Halt(NamedTuple):
    """A standstill that the plan does not have, or not so long.

    Begin and end, and when by the plan [s]; how much longer than planned [s]; whether one was planned.
    """

    begin_s: float
    end_s: float
    planned_s: float
    longer_s: float
    planned: bool


class _Beside:
    """Rows of telemetry beside the commands of a plan."""

    def __init__(self, telemetry: Telemetry, rover: Rover, schedule: Schedule) -> None:
        self.file, self.start_s = telemetry.file, telemetry.start_s
        self.rover, self.schedule, self.times = rover, schedule, telemetry.time_s
        self.steering = np.where(np.isfinite(telemetry.steering_deg), telemetry.steering_deg, telemetry.steered_deg)
        rims = telemetry.rate_deg_s * np.radians(rover.wheel.shearing_radius_m)
        self.speed = telemetry.speed_m_s if np.isfinite(telemetry.speed_m_s).any() else rims
        slow = UNDER_WAY * schedule.plan.speed_m_s
        known = np.stack([telemetry.speed_m_s, rims])
        # Rates are of one moment, angles of the time between two rows.
        self.row_s = float(np.median(np.diff(self.times))) if np.isfinite(known).any() else 0.0
        if not self.row_s:
            step = np.diff(telemetry.angle_deg, axis=0) / np.diff(self.times)[:, None]
            turns = np.radians(np.abs(step)) * rover.wheel.shearing_radius_m
            known = np.minimum(np.concatenate([turns[:1], turns]), np.concatenate([turns, turns[-1:]]))[None]
        with np.errstate(invalid="ignore"):
            self.turning: BoolArray = (np.abs(known) > slow).any(axis=(0, 2))
        self.told = np.isfinite(known).any(axis=(0, 2))

    def share_off(self, times_s: FloatArray, rows: BoolArray) -> float:
        """Share of some rows whose commands are not those of the plan at these times; 1 where too few lie within it."""
        inside = self._inside(times_s) & rows
        driven = rows & self.under_way
        if (inside & driven).sum() < COVERED * driven.sum():
            return 1.0
        steered, fast = self._off(times_s[inside], inside)
        return float((steered | fast).any(axis=1).mean())

    def _inside(self, times_s: FloatArray) -> BoolArray:
        return (times_s >= 0) & (times_s <= self.schedule.duration_s)

    def _off(self, times_s: FloatArray, rows: BoolArray) -> tuple[BoolArray, BoolArray]:
        """Where steering and rim speeds of some rows are not those of the plan at these times. (rows, wheels)"""
        told = commands_at(self.rover, self.schedule, times_s)
        steered = np.abs(self.steering[rows] - np.degrees(told.steering_rad)) > STEERING_DEG
        fast = np.abs(self.speed[rows] - told.speed_m_s) > SPEED_SHARE * self.schedule.plan.speed_m_s
        # How fast a rover slows down to a halt and speeds up again is assumed.
        slow = [self.schedule.pace_at(times_s + step) < UNDER_WAY for step in (-RAMP_S, RAMP_S)]
        return steered, fast & (slow[0] == slow[1])[:, None]

    def first_off(self) -> tuple[float, str, bool]:
        """When commands are first not those of the plan [s], what they are there, and whether most such rows lie near
        joins of arcs. Some row must be off."""
        inside = self._inside(self.times)
        times = self.times[inside]
        steered, fast = self._off(times, inside)
        off = (steered | fast).any(axis=1)
        row = int(np.argmax(off))
        told = commands_at(self.rover, self.schedule, times[row : row + 1])
        if steered[row].any():
            wheel = int(np.argmax(steered[row]))
            now, meant = self.steering[inside][row, wheel], float(np.degrees(told.steering_rad[0, wheel]))
            what = f"steering of {self.rover.wheels[wheel]} is {now:.1f} deg, planned {meant:.1f}"
        else:
            wheel = int(np.argmax(fast[row]))
            now, meant = self.speed[inside][row, wheel], float(told.speed_m_s[0, wheel])
            what = f"rim of {self.rover.wheels[wheel]} is at {now:.3g} m/s, planned {meant:.3g}"
        near = self._near_joins(times)
        joins = near[off].mean() >= MOST_NEAR and near.mean() <= FEW_NEAR
        return float(times[row]), what, bool(joins)

    def last_off_s(self) -> float:
        """When commands are last not those of the plan. Some row must be off. [s]"""
        inside = self._inside(self.times)
        steered, fast = self._off(self.times[inside], inside)
        return float(self.times[inside][(steered | fast).any(axis=1)][-1])

    def _near_joins(self, times_s: FloatArray) -> BoolArray:
        """Whether the plan is near the join of two arcs at these times."""
        near, reach = np.zeros(len(times_s), dtype=bool), max(NEAR_M, self.schedule.plan.blend_m)
        for run in self.schedule.runs:
            on = (times_s >= run.begin_s) & (times_s <= run.end_s)
            way = run.share_at(times_s) * run.length_m
            for join in np.cumsum([leg.length_m for leg in run.legs])[:-1]:
                near |= on & (np.abs(way - join) <= reach)
        return near

    @property
    def under_way(self) -> BoolArray:
        """Rows from the first to the last turn of a wheel; all where none turns."""
        turning = np.flatnonzero(self.turning)
        rows = np.zeros(len(self.times), dtype=bool)
        rows[slice(turning[0], turning[-1] + 1) if turning.size else slice(None)] = True
        return rows

    def halts(self) -> "tuple[_Halt, ...]":
        """Halts that the plan does not have, where the rest is driven as planned; none where that is not so."""
        still = ~self.turning & self.told & self.under_way
        ends = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
        grid = np.arange(0.0, self.schedule.duration_s, 0.1)
        stands = self.schedule.pace_at(grid) < UNDER_WAY
        halts, by_plan = list[_Halt](), self.times.copy()
        for first, last in zip(ends[::2], ends[1::2] - 1, strict=True):
            begin, end = float(self.times[first]), float(self.times[last])
            planned_s = float(by_plan[first])
            meant = 0.1 * _standing_about(grid, stands, planned_s)
            longer = end - begin + self.row_s - meant
            if longer > EDGE_S and 0.0 < planned_s < self.schedule.duration_s:
                halts.append(_Halt(begin, end, planned_s, longer, meant > 0.0))
                by_plan[last + 1 :] -= longer
        if not halts or self.share_off(by_plan, ~still) > FITS:
            return ()
        return tuple(halts)


def _standing_about(grid_s: FloatArray, stands: BoolArray, time_s: float) -> int:
    """Points of a grid over which the plan stands still, a ramp about a time at most; 0 where it drives on."""
    near = np.flatnonzero(stands & (np.abs(grid_s - time_s) <= RAMP_S))
    if not near.size:
        return 0
    drives = np.flatnonzero(~stands)
    after = drives[drives > near[0]]
    before = drives[drives < near[0]]
    return int((after[0] if after.size else len(grid_s)) - (before[-1] if before.size else -1) - 1)


def _say_halts(halts: tuple[_Halt, ...], schedule: Schedule, findings: Findings) -> None:
    for halt in halts:
        has = f"{halt.longer_s:.3g} s longer than the plan has it" if halt.planned else "and the plan has no halt there"
        what = f"the wheels stood still from {halt.begin_s:.6g} to {halt.end_s:.6g} s, {has}"
        done = f"times are kept as they are; before `twin update` {_remedy(halt, schedule)}"
        findings.add("unplanned halt", what, done, time_s=halt.begin_s, doubt=True)


def _remedy(halt: _Halt, schedule: Schedule) -> str:
    """What to write into the plan."""
    run = next(one for one in reversed(schedule.runs) if one.begin_s <= halt.planned_s)
    before = sum(len(one.legs) for one in schedule.runs if one.begin_s < run.begin_s)
    if halt.planned:
        begins = halt.planned_s < run.begin_s + EDGE_S
        last = before or len(run.legs) if begins else before + len(run.legs)
        for number, leg in enumerate(schedule.plan.legs[max(last - 1, 0) : last + 1], max(last, 1)):
            if leg.stop_s:
                return f"set stop_s = {leg.stop_s + halt.longer_s:.4g} in leg {number} of the plan"
        return f"put a [[leg]] with stop_s = {halt.longer_s:.4g} after leg {last} of the plan"
    share, stop_s = float(run.share_at(halt.planned_s)), max(halt.longer_s - STOP_COSTS_S, 1.0)
    ends = np.cumsum([leg.length_m for leg in run.legs])
    number = int(np.searchsorted(ends[:-1], share * run.length_m))
    leg = run.legs[number]
    way = f"{share * leg.turn_deg:.3g} deg"
    if leg.length_m:
        way = f"{share * run.length_m - (ends[number] - leg.length_m):.3g} m"
    return f"split leg {before + number + 1} of the plan after {way}, with a [[leg]] of stop_s = {stop_s:.4g} between"


def _clocked(telemetry: Telemetry, beside: _Beside, findings: Findings) -> tuple[Telemetry, bool]:
    """Telemetry by the clock of the plan, and whether its commands are the plan's."""
    times, whole = beside.times, np.ones(len(beside.times), dtype=bool)
    now = beside.share_off(times, whole)
    if now <= SOME or now * len(times) < 3:
        return telemetry, True
    end = beside.schedule.duration_s
    far = bool(((times >= 0.0) & (times <= end))[beside.under_way].mean() < COVERED)
    first = float(times[beside.under_way][0])
    step = max(0.5, float(np.median(np.diff(times))))
    shifts = np.arange(-LONGEST_SHIFT_S, LONGEST_SHIFT_S + step / 2, step) + (first if far else 0.0)
    shares = np.array([beside.share_off(times - shift, whole) for shift in shifts])
    good = np.flatnonzero(shares <= shares.min() + 1e-12)
    best = int(good[np.argmin(np.abs(shifts[good] - (first if far else 0.0)))])
    start = f"`start_time` {beside.start_s + shifts[best]:.12g}"
    text = f"the commands of {100 * now:.0f} % of the rows are not those of the plan at their times"
    if shares[best] < min(FITS, 0.5 * now) and abs(shifts[best]) > step:
        way = "late" if shifts[best] > 0 else "early"
        what = f"{text}; they fit if the clock is {abs(shifts[best]):.12g} s {way}"
        near = abs(shifts[best]) * beside.schedule.plan.speed_m_s <= NEAR_M
        # Wheels that turn before the plan begins, or behind its end, are by another clock.
        if near and ((times >= 0.0) & (times <= end))[beside.turning].all() and beside.first_off()[2]:
            findings.add(
                "clock offset", what, f"times are kept as they are: give {start}; if the clock is right, {BLEND}",
                doubt=True,
            )  # fmt: skip
            return telemetry, False
        fits = bool(shares[best] <= SOME)
        findings.add("clock offset", what, f"times count from there, as {start} has it", doubt=not fits)
        rows = taken(telemetry, times >= shifts[best])
        return replace(rows, time_s=rows.time_s - shifts[best], start_s=beside.start_s + shifts[best]), fits
    if far:
        what = f"the plan ends {end:.4g} s after its start, and time_s goes from {times[0]:.12g} to {times[-1]:.12g}"
        done = (
            f"times are kept as they are: give the time_s of its start as `start_time`; wheels turn from {first:.12g}"
        )
        findings.add("another clock", what, done, doubt=True)
        return telemetry, False
    off_s, what, joins = beside.first_off()
    done, doubt = "the telemetry's are taken; give the plan that was driven", beside.last_off_s() > EDGE_S
    if not doubt:
        text += ", all of them at its start"
        done = "the telemetry's are taken; the plan begins as steered as its first leg is, the rover was not yet"
    elif now > MOST:
        done += ", and its `rover`"
    elif joins:
        text += ", most of them near joins of arcs"
        done = f"the telemetry's are taken; {BLEND}"
    said = f"{text}; first {what}"
    findings.add("other commands", said, done, count=round(now * len(times)), time_s=off_s, doubt=doubt)
    return telemetry, not doubt
