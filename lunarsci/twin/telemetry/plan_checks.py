"""Telemetry beside the plan that is said to have been driven: clock, halts, commands, start.

Both are compared by the way of the rims, which neither a clock nor a halt moves. Where the commands are alike there,
what the times differ by is the clock's offset, and its jumps are halts.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.plans.path import RAMP_COUNTS_S, RAMP_S, Schedule, commands_at
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.checks import UNDER_WAY, taken
from lunarsci.twin.telemetry.nodes import Rows
from lunarsci.twin.telemetry.odometry import mean_speed
from lunarsci.twin.telemetry.reading import Findings, Telemetry
from lunarsci.twin.telemetry.wheel_motion import STILL_SHARE

STEERING_DEG, SPEED_SHARE = 2.0, 0.25
"""How far a row's commands may be off the plan's: steering, and rim speed as a share of the mean of the rims;
assumed."""
LN_OFF_M, LN_OFFSET = -16.0, -7.0
"""ln of the odds of a metre of way with other commands, and of another clock; assumed."""
SOME, MOST, COVERED = 0.01, 0.4, 0.6
"""Share of the way that may be off unsaid; beyond which it is another plan; and that must lie within the plan;
assumed."""
STEP_M, MOST_TRIED = 0.05, 500
"""Step between the ways tried, by which the way differs where the plan is right, and number of them, and of rows;
assumed. [m]"""
NEAR_M = 0.3
"""Way within which standstills are one halt; assumed. [m]"""
HALT = "unplanned halt"
"""Kind of a finding: states are right, and a soil learned with the plan is not."""
START_M, HEADING_DEG = 0.5, 10.0
"""How far the first position and heading may be from the plan's start; assumed. [m, deg]"""
EDGE_S = 5.0
"""How much of a plan may be missing at its ends, and a halt be longer than planned, unsaid, and how long a rover may
take to steer to its first leg without doubt; assumed. [s]"""
STOP_COSTS_S = 2.0 * (RAMP_S - RAMP_COUNTS_S)
"""What slowing down and speeding up again cost, beside the halt itself; of the ramps assumed. [s]"""


def by_the_plan(sent: Rows, rover: Rover, schedule: Schedule, findings: Findings) -> tuple[Rows, bool, float]:
    """Telemetry by the clock of a plan; whether its commands are the plan's, and how much longer it stood still. [s]

    Another clock is found by the commands, and said. So are halts that the plan does not have, and other commands.
    """
    if schedule.plan.fixes is not None or (beside := _Beside.of(sent, rover, schedule)) is None:
        return sent, False, 0.0
    late_s = _say_clock(sent.telemetry, beside, findings)
    # What was found, and what will be, is by the clock that all else of the result is by.
    beside.sent = beside.sent._replace(time_s=beside.sent.time_s - late_s)
    findings.entries[:] = [
        one if one.time_s is None else replace(one, time_s=one.time_s - late_s) for one in findings.entries
    ]
    halts = beside.halts() if beside.share_off <= MOST else ()
    _say_halts(halts, schedule, findings)
    as_planned = beside.share_off <= SOME or not _say_commands(beside, findings)
    return _later(sent, late_s), as_planned, sum(halt.longer_s for halt in halts)


def _later(sent: Rows, start_s: float) -> Rows:
    """The same by a clock that starts later, without what was before."""
    if not start_s:
        return sent
    telemetry, wheels, steering, gaps = sent
    first = int(np.searchsorted(telemetry.time_s, start_s))
    rows = taken(telemetry, np.arange(first, len(telemetry.time_s)))
    rests = tuple((begin - start_s, end - start_s) for begin, end in telemetry.rests_s)
    rows = replace(rows, time_s=rows.time_s - start_s, start_s=telemetry.start_s + start_s, rests_s=rests)
    steps = {name: getattr(wheels, name)[first:] for name in ("rim_m_s", "measured", "trusted")}
    return Rows(rows, replace(wheels, **steps), steering[first:], gaps[first:])


def check_ends(telemetry: Telemetry, schedule: Schedule, longer_s: float, findings: Findings) -> None:
    """Say where telemetry begins or ends otherwise than its plan, which halts made so much longer."""
    plan, end = schedule.plan, schedule.duration_s + longer_s
    first, last = float(telemetry.time_s[0]), float(telemetry.time_s[-1])
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
    known = np.flatnonzero(np.isfinite(telemetry.yaw_deg))
    if known.size and telemetry.time_s[known[0]] <= EDGE_S:
        off = float(np.remainder(telemetry.yaw_deg[known[0]] - plan.heading_deg + 180.0, 360.0) - 180.0)
        if abs(off) > HEADING_DEG:
            what = f"the first heading is {off:.3g} deg off the plan's: another frame, or another plan"
            findings.add("another start", what, "kept as it is", doubt=True)
    rows = np.flatnonzero(telemetry.fixed)
    if rows.size and telemetry.time_s[rows[0]] < EDGE_S:
        off = float(np.hypot(*(telemetry.fix_m[rows[0]] - [plan.x_m, plan.y_m])))
        sigma = float(np.sqrt(np.trace(telemetry.fix_covariance_m2[rows[0]])))
        if off > START_M + 5.0 * sigma:
            what = f"the first position is {off:.3g} m from the plan's start: another frame, or another plan"
            findings.add("another start", what, "kept as it is", doubt=True)


class _Halt(NamedTuple):
    """A standstill that the plan does not have, or of another length.

    Begin and end, and when by the plan [s]; how much longer than planned [s]; whether one was planned.
    """

    begin_s: float
    end_s: float
    planned_s: float
    longer_s: float
    planned: bool


class _AlongWay(NamedTuple):
    """Commands over the way of the rims, in rows or steps in which these move.

    Time (n,) [s]; way (n,) [m]; steering [deg], or where no wheel is steered speed of each rim over their mean
    (n, wheels); their usual speed [m/s].
    """

    time_s: FloatArray
    way_m: FloatArray
    command: FloatArray
    speed_m_s: float

    @classmethod
    def of(cls, time_s: FloatArray, speed_m_s: FloatArray, command: FloatArray, gaps: BoolArray) -> "_AlongWay | None":
        """From times (n,), mean speed of the rims between them and gaps (n - 1,), and commands; None where nothing
        moves."""
        fast = speed_m_s > UNDER_WAY * np.max(speed_m_s, initial=0.0)
        rows = np.append(fast & ~gaps, False)
        if rows.sum() < 2:
            return None
        # Noise of a wheel that stands is no way: over many rows it would add up to one.
        steps = speed_m_s * np.diff(time_s)
        way = np.append(0.0, np.cumsum(np.where(steps > STILL_SHARE * np.median(steps[fast]), steps, 0.0)))
        return cls(time_s[rows], way[rows], command[rows], float(np.median(speed_m_s[fast])))


class _Tried(NamedTuple):
    """A way in which telemetry may lie beside its plan: ln of its odds, the way of the rows, its offset behind that of
    the plan [m], and the pace of the drive."""

    ln: float
    sent: _AlongWay
    offset_m: float
    faster: float


class _Beside:
    """Rows of telemetry in which wheels turn, beside the commands of a plan at the same way.

    Attributes
    ----------
    sent, told : both by their ways, that of the rows in the plan's metres.
    offset_m : of the way of the rows behind that of the plan, as it fits best.
    planned_s, late_s : when the plan has each row, and by how much the row is later at the drive's pace. (n,) [s]
    off : rows whose commands are not the plan's; `inside` are rows within the plan. (n,), (n,)
    share_off : of the way; 1 where too little of it lies within the plan.
    """

    def __init__(self, sent: _AlongWay, told: _AlongWay, schedule: Schedule, rover: Rover) -> None:
        self.rover, self.schedule, self.told = rover, schedule, told
        self.allowed = STEERING_DEG if rover.steered_mask.any() else SPEED_SHARE
        pace, end = sent.speed_m_s / told.speed_m_s, float(told.way_m[-1])
        begin, tried = float(np.interp(sent.time_s[0], told.time_s, told.way_m)), list[_Tried]()
        # Faster wheels go as far in less time, or are of another size and go farther.
        for scale, faster in ((1.0, pace), (pace, 1.0)):
            one = sent._replace(way_m=sent.way_m / scale)
            by_clock = begin - float(one.way_m[0])
            tried.append(_Tried(self._ln_of(one, by_clock), one, by_clock, faster))
        if max(one.ln for one in tried) < LN_OFFSET:
            for _, one, _, faster in tuple(tried):
                last = float(one.way_m[-1])
                step = max(STEP_M, (last + end) / MOST_TRIED)
                coarse = self._best(one, np.arange(-last, end, step))
                fine = self._best(one, coarse + np.arange(-step, step, STEP_M / 2.0))
                for offset_m in (0.0, coarse, fine):
                    tried.append(_Tried(self._ln_of(one, offset_m) + LN_OFFSET, one, offset_m, faster))
        _, self.sent, self.offset_m, faster = max(tried, key=lambda one: one.ln)
        way, length = self.sent.way_m, np.gradient(self.sent.way_m)
        self.off, self.inside = self._compared(self.sent, self.offset_m)
        self.planned_s = np.interp(way + self.offset_m, told.way_m, told.time_s)
        self.late_s = sent.time_s - self.planned_s / faster
        within = float(length[self.inside].sum())
        short = within < COVERED * min(float(length.sum()), end)
        self.share_off = 1.0 if short else float((length * self.off.any(axis=1))[self.inside].sum()) / within

    @classmethod
    def of(cls, sent: Rows, rover: Rover, schedule: Schedule) -> "_Beside | None":
        """Of all rows; None where no wheel turns."""
        telemetry, rims = sent.telemetry, sent.wheels.rim_m_s
        grid = np.linspace(0.0, schedule.duration_s, max(3, math.ceil(schedule.duration_s / 0.1)))
        commands = commands_at(rover, schedule, grid)
        means = mean_speed(rims), mean_speed(commands.speed_m_s[:-1])
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = [one / mean[:, None] for one, mean in zip((rims, commands.speed_m_s[:-1]), means, strict=True)]
        command = [np.vstack([one[:1], one]) for one in shares]
        if rover.steered_mask.any():
            steering = np.where(np.isfinite(telemetry.steering_deg), telemetry.steering_deg, telemetry.steered_deg)
            command = [steering, np.degrees(commands.steering_rad)]
        gaps = sent.gaps, np.zeros(len(grid) - 1, dtype=bool)
        made = [_AlongWay.of(*one) for one in zip((telemetry.time_s, grid), means, command, gaps, strict=True)]
        return None if made[0] is None or made[1] is None else cls(made[0], made[1], schedule, rover)

    def _best(self, sent: _AlongWay, offsets_m: FloatArray) -> float:
        return float(offsets_m[np.argmax([self._ln_of(sent, float(one)) for one in offsets_m])])

    def _ln_of(self, sent: _AlongWay, offset_m: float) -> float:
        """ln of how probable an offset is, up to a constant."""
        some = slice(None, None, 1 + len(sent.way_m) // MOST_TRIED)
        off, inside = self._compared(sent, offset_m, some)
        steps = np.gradient(sent.way_m)[some] * len(sent.way_m) / len(off)
        # Of the way in one, the part that is not in the other is as wrong as other commands are.
        missed = max(self.told.way_m[-1] - steps[inside].sum(), 0.0)
        return LN_OFF_M * float(steps[off.any(axis=1) | ~inside].sum() + missed)

    def _compared(self, sent: _AlongWay, offset_m: float, rows: slice = slice(None)) -> tuple[BoolArray, BoolArray]:
        """Rows and wheels whose command is not that of the plan, nor just before or behind; rows within the plan."""
        way, off = sent.way_m[rows] + offset_m, np.ones(sent.command[rows].shape, dtype=bool)
        for beside in (-STEP_M / 2.0, 0.0, STEP_M / 2.0):
            at = np.minimum(np.searchsorted(self.told.way_m, way + beside), len(self.told.way_m) - 1)
            off &= np.abs(sent.command[rows] - self.told.command[at]) > self.allowed
        return off, np.asarray((way >= -STEP_M) & (way <= self.told.way_m[-1] + STEP_M))

    def first_off(self) -> tuple[float, str]:
        """When commands are first not those of the plan [s], and what they are there. Some row must be off."""
        off = self.off & self.inside[:, None]
        row = int(np.argmax(off.any(axis=1)))
        wheel, planned = int(np.argmax(off[row])), int(np.argmin(np.abs(self.told.time_s - self.planned_s[row])))
        sent, told = (f"{one.command[k, wheel]:.3g}" for one, k in ((self.sent, row), (self.told, planned)))
        unit = " deg" if self.rover.steered_mask.any() else " of the mean speed"
        text = (
            f"{'steering' if unit == ' deg' else 'rim'} of {self.rover.wheels[wheel]} is {sent}{unit}, planned {told}"
        )
        return float(self.sent.time_s[row]), text

    def last_off_s(self) -> float:
        """When commands are last not those of the plan. Some row must be off. [s]"""
        return float(self.sent.time_s[self.off.any(axis=1) & self.inside][-1])

    def halts(self) -> "tuple[_Halt, ...]":
        """Where the rover stood longer, or less long, than the plan has it."""
        rows = np.flatnonzero(self.inside)
        times, planned, way = self.sent.time_s[rows], self.planned_s[rows], self.sent.way_m[rows]
        longer, found = np.diff(self.late_s[rows]), list[_Halt]()
        jumps = np.flatnonzero(np.abs(longer) > EDGE_S)
        for near in np.split(jumps, np.flatnonzero(np.diff(way[jumps]) > NEAR_M) + 1):
            total = float(longer[near].sum())
            if near.size and abs(total) > EDGE_S:
                first, last = int(near[np.argmax(np.abs(longer[near]))]), int(near[-1])
                stands = bool((np.diff(planned)[near[0] : last + 1] > EDGE_S / 2.0).any())
                begin = times[first] + min(planned[first + 1] - planned[first], times[first + 1] - times[first])
                found.append(_Halt(begin, times[first + 1], planned[first + 1], total, stands))
        return tuple(found)


def _say_halts(halts: tuple[_Halt, ...], schedule: Schedule, findings: Findings) -> None:
    for halt in halts:
        has = f"{abs(halt.longer_s):.3g} s {'longer' if halt.longer_s > 0 else 'less long'} than the plan has it"
        if not halt.planned:
            has = "and the plan has no halt there"
        what = f"the wheels stood still from {halt.begin_s:.6g} to {halt.end_s:.6g} s, {has}"
        done = f"times are kept as they are; before `twin update` {_remedy(halt, schedule)}"
        findings.add(HALT, what, done, time_s=halt.begin_s)


def _remedy(halt: _Halt, schedule: Schedule) -> str:
    """What to write into the plan."""
    run = next(one for one in reversed(schedule.runs) if one.begin_s <= halt.planned_s)
    before = sum(len(one.legs) for one in schedule.runs if one.begin_s < run.begin_s)
    if halt.planned:
        begins = halt.planned_s < run.begin_s + EDGE_S
        last = before or len(run.legs) if begins else before + len(run.legs)
        for number, leg in enumerate(schedule.plan.legs[max(last - 1, 0) : last + 1], max(last, 1)):
            if leg.stop_s:
                return f"set stop_s = {max(leg.stop_s + halt.longer_s, 0.0):.4g} in leg {number} of the plan"
        return f"put a [[leg]] with stop_s = {halt.longer_s:.4g} after leg {last} of the plan"
    share, stop_s = float(run.share_at(halt.planned_s)), max(halt.longer_s - STOP_COSTS_S, 1.0)
    ends = np.cumsum([leg.length_m for leg in run.legs])
    number = int(np.searchsorted(ends[:-1], share * run.length_m))
    leg = run.legs[number]
    way = f"{share * leg.turn_deg:.3g} deg"
    if leg.length_m:
        way = f"{share * run.length_m - (ends[number] - leg.length_m):.3g} m"
    return f"split leg {before + number + 1} of the plan after {way}, with a [[leg]] of stop_s = {stop_s:.4g} between"


def _say_clock(telemetry: Telemetry, beside: _Beside, findings: Findings) -> float:
    """By how much the clock is later than the plan's, said; 0 where it is not. [s]"""
    rows = beside.late_s[beside.inside]
    if beside.share_off > MOST or not rows.size:
        return 0.0
    # Until the first halt that one of them has alone.
    late = float(np.median(rows[: 1 + int(np.argmax(np.append(np.abs(np.diff(rows)) > EDGE_S, True)))]))
    if abs(late) * beside.schedule.plan.speed_m_s < STEP_M:
        return 0.0
    what = f"the commands are those of the plan if the clock is {abs(late):.12g} s {'late' if late > 0 else 'early'}"
    start = f"`start_time` {telemetry.start_s + late:.12g}"
    findings.add("clock offset", what, f"times count from there, as {start} has it")
    return late


def _say_commands(beside: _Beside, findings: Findings) -> bool:
    """Say that commands are not the plan's; whether that is a doubt."""
    off_s, what = beside.first_off()
    text = f"the commands of {100 * beside.share_off:.0f} % of the way are not those of the plan"
    done, doubt = "the telemetry's are taken; give the plan as it was driven", beside.last_off_s() > EDGE_S
    if not doubt:
        text += ", all of them at its start"
        done = "the telemetry's are taken; the plan begins as steered as its first leg is, the rover was not yet"
    elif beside.share_off > MOST:
        done += ", and its `rover`"
    else:
        done += " (`blend_m` is half before a join of arcs, half behind)"
    count = int((beside.off.any(axis=1) & beside.inside).sum())
    findings.add("other commands", f"{text}; first {what}", done, count=count, time_s=off_s, doubt=doubt)
    return doubt
