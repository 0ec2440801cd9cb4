"""Telemetry before its motion is found: rows in their order, gaps, steering, positions and headings of use, the plan.

Each time is there once. How the wheels were steered is as measured, else as commanded, where the two agree. A position
or heading is of use where its error is known and it does not only repeat the one before. Roll and pitch are set beside
those of a rover on the terrain.

Telemetry and the plan that should have been driven are compared by the way of the rims, which neither a clock nor a
halt moves. Where the commands are alike there, what the times differ by is the clock's offset, and its jumps are halts.
"""

import dataclasses
import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.plans.motion import GAP
from lunarsci.twin.plans.path import RAMP_COUNTS_S, RAMP_S, Schedule, commands_at, make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import VALID_SLIP
from lunarsci.twin.simulation.prescribed_motion import PrescribedLoads
from lunarsci.twin.telemetry.hypotheses import LN_ODDS, REPORTED, repeat_chance, repeated
from lunarsci.twin.telemetry.nodes import Rows
from lunarsci.twin.telemetry.reading import (
    LEAST_ROW_M,
    OBEYED,
    SIGMA_DEG,
    STILL,
    SURE,
    UNDER_WAY,
    Findings,
    Positions,
    Telemetry,
    between_readings,
    filled,
)
from lunarsci.twin.telemetry.wheel_motion import PACE, mean_speed

LEAST_ROWS = 5
FAST = "fast slip"
"""Kind of a finding."""
STEERED_DEG = 0.5
"""Standard error of one steering angle from another, as measured from commanded; assumed. [deg]"""
STEERING_DEG = STEERED_DEG * math.sqrt(
    2.0 * (math.log(360.0 / (math.sqrt(2.0 * math.pi) * STEERED_DEG)) - LN_ODDS["reading"])
)
"""Difference from which it is more probable, with errors as `STEERED_DEG` and odds as `LN_ODDS`, that one of the two
says nothing: it may be any angle then. [deg]"""
FEWEST_RATES = 5
AGAINST_PLAN = "wheels against plan"
"""Kind of the finding; a soil is found with a plan of its own, so that it does not stay with the states."""
STEP_M, MOST_TRIED = 0.05, 500
"""Step between the ways tried, by which the way differs where the plan is right, and up to which other commands are
unsaid; number of them, and of rows; assumed. [m]"""
HALT = "unplanned halt"
"""Kind of a finding: states are right, and a soil learned with the plan is not."""
START_M, HEADING_DEG = 0.5, 10.0
"""How far the first position and heading may be from the plan's start; assumed. [m, deg]"""
EDGE_S = 5.0
"""How much of a plan may be missing at its ends, and a halt be longer than planned, unsaid, and how long a rover may
take to steer to its first leg without doubt; assumed. [s]"""
STOP_COSTS_S = 2.0 * (RAMP_S - RAMP_COUNTS_S)
"""What slowing down and speeding up again cost, beside the halt itself, by the ramps of a schedule. [s]"""
ATTITUDE_DEG, FOLLOWS, MOUNTED_DEG = 1.5, 0.6, 3.0
"""Median difference of roll or pitch from the terrain's beyond which it is said [deg], or as a share of its slope where
that is more; and by how much their sensor may be turned on the rover [deg]; assumed."""


def subset(telemetry: Telemetry, rows: IndexArray | BoolArray) -> Telemetry:
    """Some rows of telemetry, as a mask or by number."""
    arrays: dict[str, Any] = {name: value[rows] for name, value in _arrays(telemetry).items()}
    return dataclasses.replace(telemetry, **arrays)


def _arrays(telemetry: Telemetry) -> dict[str, FloatArray]:
    """Fields with a row for each time, by name."""
    values = {field.name: getattr(telemetry, field.name) for field in dataclasses.fields(telemetry)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def ordered(telemetry: Telemetry, findings: Findings) -> Telemetry:
    """Rows that have a time, each time once, ascending.

    Rows without a time, and rows that repeat one to the last digit, are left out; rows out of their order by less than
    a gap are put into it; rows of one time are one, the first that has a value. All of it is said. Raises DataError
    where time runs backwards by more, and where fewer than five rows are left.
    """
    lost = ~np.isfinite(telemetry.time_s)
    if lost.any():
        findings.add("no time", f"{lost.sum()} rows without a time_s", "left out", count=int(lost.sum()))
        telemetry = subset(telemetry, ~lost)
    if (np.diff(telemetry.time_s) <= 0).any():
        telemetry = _in_order(telemetry, findings)
    if len(telemetry.time_s) < LEAST_ROWS:
        raise DataError(f"{telemetry.file}: {len(telemetry.time_s)} rows with a time; give {LEAST_ROWS} or more")
    return telemetry


def _in_order(telemetry: Telemetry, findings: Findings) -> Telemetry:
    import pandas as pd

    content = np.column_stack([value.reshape(len(value), -1) for value in _arrays(telemetry).values()])
    again = pd.DataFrame(content).duplicated().to_numpy()
    findings.of_rows("repeated rows", f"{again.sum()} rows repeat another one", "left out", again, telemetry.time_s)
    telemetry = subset(telemetry, ~again)
    steps = np.diff(telemetry.time_s)
    if (back := np.flatnonzero(steps < 0)).size:
        row = int(back[0])
        what = f"from {telemetry.time_s[row]:.6g} to {telemetry.time_s[row + 1]:.6g} s"
        if -steps.min() > GAP * np.median(steps[steps > 0]):
            raise DataError(
                f"{telemetry.file}: time runs backwards {back.size} times, first {what}: the clock was reset, or rows "
                "are out of order; split the file there, or sort it if the times are right"
            )
        findings.add("rows out of order", f"time runs backwards, first {what}", "sorted by time", count=back.size)
        telemetry = subset(telemetry, np.argsort(telemetry.time_s, kind="stable"))
    if not (np.diff(telemetry.time_s) == 0).any():
        return telemetry
    columns: dict[str, Any] = {}
    differ = np.zeros(len(telemetry.time_s), dtype=bool)
    for name, value in _arrays(telemetry).items():
        together = pd.DataFrame(value.reshape(len(value), -1)).groupby(telemetry.time_s)
        columns[name] = together.first().to_numpy(float).reshape(-1, *value.shape[1:])
        differ |= (together.transform("nunique") > 1).any(axis=1).to_numpy()
    what, done = f"{differ.sum()} rows share their time and differ", "the first one of each time is taken"
    findings.of_rows("rows of one time", what, done, differ, telemetry.time_s)
    return dataclasses.replace(telemetry, **columns)


def with_wheels(telemetry: Telemetry, findings: Findings) -> Telemetry:
    """Rows about which some wheel has an angle, a rate or a command; without any they would tell of no slip."""
    blank = np.asarray(~np.isfinite(telemetry.of_wheels()).any(axis=(0, 2)))
    what = "no wheel has an angle, a rate or a command"
    findings.of_rows("missing readings", what, "rows left out", blank, telemetry.time_s)
    return subset(telemetry, ~blank) if blank.any() and not blank.all() else telemetry


def time_gaps(telemetry: Telemetry, findings: Findings) -> BoolArray:
    """Steps between rows that are gaps: longer than `GAP` times the median, but over rests. (n - 1,)"""
    steps, rested = np.diff(telemetry.time_s), telemetry.rested
    usual = float(np.median(steps[~rested]))
    gaps = np.asarray((steps > GAP * usual) & ~rested)
    what = f"nothing was sent for {steps[gaps].sum():.4g} s in all; rows are usually {usual:.3g} s apart"
    findings.of_rows("gap", what, "there are no states within gaps", gaps, telemetry.time_s)
    return gaps


def steering_angles(telemetry: Telemetry, rover: Rover, findings: Findings) -> tuple[FloatArray, BoolArray]:
    """Steering of every row and wheel, and where it is known, not found from the rows beside. (n, wheels) [deg]

    Readings that hang or jump away from the command are replaced by it and said. Raises DataError for a wheel that has
    none.
    """
    measured = between_readings(telemetry.time_s, telemetry.steered_deg)
    commanded = between_readings(telemetry.time_s, telemetry.steering_deg, held=True)
    for k, wheel in enumerate(rover.wheels):
        _replace_faulty(telemetry, k, wheel, measured, commanded, findings)
    angle = np.where(np.isfinite(measured), measured, commanded)
    given = np.isfinite(angle)
    for k, (wheel, rows) in enumerate(zip(rover.wheels, given.T, strict=True)):
        if not rows.any():
            raise DataError(f"{telemetry.file}: no row has a steering angle of wheel {wheel}")
        what = f"rows lack the steering angle of wheel {wheel}"
        done = "it follows from the rows beside; its states are not valid there"
        findings.of_rows("missing steering", what, done, ~rows, telemetry.time_s)
        angle[:, k] = filled(telemetry.time_s, angle[:, k])
    return angle, given


def _replace_faulty(
    telemetry: Telemetry, k: int, wheel: str, measured: FloatArray, commanded: FloatArray, findings: Findings
) -> None:
    """Put the command in the place of readings that hang or spike, in one wheel's column of `measured`.

    Where most readings are off their commands, it is these that are others.
    """
    both = np.isfinite(measured[:, k]) & np.isfinite(commanded[:, k])
    if not both.any():
        return
    hung, off = np.zeros((2, len(both)), dtype=bool)
    hung[both] = repeated(measured[both, k], 1.0, commanded[both, k], STEERED_DEG)
    # A motor is on its way for a step.
    change = np.abs(np.diff(commanded[:, k], prepend=commanded[0, k], append=commanded[-1, k]))
    allowed = STEERING_DEG + np.nan_to_num(np.maximum(change[1:], change[:-1]))
    off[both] = np.abs(measured[both, k] - commanded[both, k]) > allowed[both]
    off &= ~hung
    obeyed = not np.median(off[both])
    for kind, rows, what, mended in (
        ("stuck", hung, f"the steering angle of wheel {wheel} stays the same while it is told to change", True),
        (
            "odd steering",
            off,
            f"the steering angle of wheel {wheel} is over {STEERING_DEG:.2g} deg off its command",
            obeyed,
        ),
    ):
        done = "the command is taken there" if mended else "the measured angle is taken"
        findings.of_rows(kind, what, done, rows, telemetry.time_s, doubt=not mended)
        measured[rows & mended, k] = commanded[rows & mended, k]


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class WheelPace:
    """How fast the wheels turned beside the plan that is said to have been driven.

    Attributes
    ----------
    ratio, sigma : rim speed measured over planned, the mean of the wheels, and its standard error. [-]
    speed_m_s : of the plan. [m/s]
    shell_ratio : r_s / r of the wheels. [-]
    """

    ratio: float
    sigma: float
    speed_m_s: float
    shell_ratio: float

    @classmethod
    def of(cls, rim_m_s: FloatArray, times_s: FloatArray, rover: Rover, plan: Plan) -> "WheelPace | None":
        """From rim speeds r_s omega, NaN where not measured (n, wheels), at times (n,); None where too few turn.

        The error is what wheels scatter by. Speed and radius cannot be told apart: both make the same ratio. With
        fixes the first leg alone counts.
        """
        schedule = make_schedule(plan, rover)
        planned = commands_at(rover, schedule, times_s).speed_m_s
        # From the first fix on the rover drives its legs from where it believes to be, not at the plan's speed.
        last_s = schedule.runs[0].end_s if plan.fixes else schedule.duration_s
        inside = (times_s >= 0.0) & (times_s <= last_s)
        turning = np.isfinite(rim_m_s) & inside[:, None] & (rim_m_s * planned > 0.0)
        # Neither at a halt nor beside one, where a mean over some time is of both.
        half_s = np.gradient(times_s) / 2.0 if times_s.size > 1 else np.zeros(1)
        for at in (times_s - half_s, times_s, times_s + half_s):
            turning &= np.abs(commands_at(rover, schedule, at).speed_m_s) > UNDER_WAY * np.abs(planned).max()
        turning &= np.abs(rim_m_s) > UNDER_WAY * np.max(np.abs(rim_m_s), where=turning, initial=0.0)
        # Of sums: a coarse encoder has steps of many sizes.
        rows = [(rim_m_s[on, k], planned[on, k]) for k, on in enumerate(turning.T) if on.any()]
        if sum(rims.size for rims, _ in rows) < FEWEST_RATES:
            return None
        means = np.array([rims.sum() / wanted.sum() for rims, wanted in rows])
        # Errors of one wheel's steps cancel in their sum, so that they would say too much of it.
        squared = means.var(ddof=1) if len(rows) > 1 else (rows[0][0] / rows[0][1]).var() / rows[0][0].size
        wheel = rover.wheel
        return cls(
            ratio=float(means.mean()),
            sigma=float(np.sqrt(squared / len(rows))),
            speed_m_s=plan.speed_m_s,
            shell_ratio=wheel.shearing_radius_m / wheel.radius_m,
        )

    @property
    def off(self) -> bool:
        """Whether the wheels surely turned otherwise than planned."""
        return abs(self.ratio - 1.0) > max(PACE, SURE * self.sigma)

    @property
    def text(self) -> str:
        """What was measured."""
        return (
            f"the wheels turned {self.ratio:.3f} \u00b1 {max(self.sigma, 0.001):.3f} times as fast as the plan's "
            f"speed_m_s {self.speed_m_s:g} says"
        )

    @property
    def remedy(self) -> str:
        """What it may come from, and what to do."""
        right = f"{self.ratio * self.speed_m_s:.4g}"
        if self.shell_ratio > 1.0 + PACE / 2 and abs(self.ratio - self.shell_ratio) < max(PACE / 2, SURE * self.sigma):
            return (
                f"this is r_s / r: if the plan's speed is that of the wheel's radius alone, write speed_m_s = {right}; "
                "else check the radius"
            )
        return (
            f"write speed_m_s = {right} in the plan, or mend the wheel's radius: both look alike; a drive that speeds "
            "up and slows down has no one speed"
        )

    @property
    def doubt(self) -> str:
        """Why a soil found with the plan is doubtful; empty where the wheels turned as planned."""
        return f"{self.text}; {self.remedy}" if self.off else ""

    def to_dict(self) -> dict[str, float | bool]:
        """For a result."""
        return {"ratio": self.ratio, "sigma": self.sigma, "off": self.off}


def check_pace(
    rim_m_s: FloatArray, measured: BoolArray, telemetry: Telemetry, rover: Rover, plan: Plan, findings: Findings
) -> WheelPace | None:
    """The pace of the wheels between rows (n - 1, wheels) beside the plan; said where it is off."""
    middles = 0.5 * (telemetry.time_s[1:] + telemetry.time_s[:-1])
    pace = WheelPace.of(np.where(measured, rim_m_s, np.nan), middles, rover, plan)
    if pace is not None and pace.off:
        findings.add(AGAINST_PLAN, pace.text, pace.remedy)
    return pace


def check_far(rows: IndexArray, telemetry: Telemetry, way_m: FloatArray, findings: Findings) -> None:
    """Say where the rover rolls much farther than usual from one position to the next, or to either end."""
    ends = np.concatenate([[0], rows, [len(way_m) - 1]])
    ways = np.diff(way_m[ends])
    usual = float(np.median(ways[ways > 0])) if (ways > 0).any() else 0.0
    far = np.flatnonzero(ways > GAP * max(usual, LEAST_ROW_M))
    if far.size:
        longest = int(far[np.argmax(ways[far])])
        begin, end = telemetry.time_s[ends[longest : longest + 2]]
        what = (
            f"no position between {begin:.6g} and {end:.6g} s, while the wheels roll {ways[longest]:.3g} m; "
            f"{usual:.2g} m are usual"
        )
        done = "at most one state shows the slip there"
        findings.add("far positions", what, done, count=far.size, time_s=float(begin))


def check_slips(slip: FloatArray, measured: BoolArray, time_s: FloatArray, findings: Findings) -> None:
    """Say states that slip beyond the range of the wheel model.

    `slip` and whether it is `measured` are of some times. (m, wheels), (m, wheels), (m,)
    """
    fast = measured & (np.abs(slip) > VALID_SLIP)
    count = f"{fast.sum()} of {measured.sum()} states"
    what = f"{count} slip by more than {VALID_SLIP:g}, where the wheel model no longer holds"
    done = "medians and ranges include them; `twin update` leaves them out, as their `valid` is false"
    findings.of_rows(FAST, what, done, fast, time_s)


def aligned_with_plan(sent: Rows, rover: Rover, schedule: Schedule, findings: Findings) -> tuple[Rows, bool, float]:
    """Telemetry by the clock of a plan; whether its commands are the plan's, and how much longer it stood still. [s]

    Another clock is found by the commands, and said. So are halts that the plan does not have, and other commands.
    """
    if schedule.plan.fixes is not None or (beside := _PlanMatch.of(sent, rover, schedule)) is None:
        return sent, False, 0.0
    late_s = _report_clock(sent.telemetry, beside, findings)
    # What was found, and what will be, is by the clock that all else of the result is by.
    beside.sent = beside.sent._replace(time_s=beside.sent.time_s - late_s)
    findings.entries[:] = [
        one if one.time_s is None else replace(one, time_s=one.time_s - late_s) for one in findings.entries
    ]
    halts = beside.halts() if beside.share_off <= REPORTED else ()
    _report_halts(halts, schedule, findings)
    as_planned = beside.off_m <= STEP_M or not _report_commands(beside, findings)
    return _starting_later(sent, late_s), as_planned, sum(halt.longer_s for halt in halts)


def _starting_later(sent: Rows, start_s: float) -> Rows:
    """The same by a clock that starts later, without what was before."""
    if not start_s:
        return sent
    telemetry, wheels, steering, gaps = sent
    first = int(np.searchsorted(telemetry.time_s, start_s))
    rows = subset(telemetry, np.arange(first, len(telemetry.time_s)))
    rests = tuple((begin - start_s, end - start_s) for begin, end in telemetry.rests_s)
    rows = replace(rows, time_s=rows.time_s - start_s, start_s=telemetry.start_s + start_s, rests_s=rests)
    steps = {name: getattr(wheels, name)[first:] for name in ("rim_m_s", "measured", "trusted")}
    return Rows(rows, replace(wheels, **steps), steering[first:], gaps[first:])


def check_ends(telemetry: Telemetry, schedule: Schedule, longer_s: float, findings: Findings) -> None:
    """Say where telemetry begins or ends otherwise than its plan, which halts made so much longer."""
    plan, end = schedule.plan, schedule.duration_s + longer_s
    first, last = float(telemetry.time_s[0]), float(telemetry.time_s[-1])
    for kind, off_s, time_s, what, done in (
        ("late begin", first, first, "begins {:.4g} s after the plan", "there are no states before"),
        ("early end", end - last, last, "ends {:.4g} s before the plan: cut off, or the drive was stopped",
         "there are no states after"),
        ("late end", last - end, last, "goes on for {:.4g} s after the plan's end",
         "kept; is it the plan that was driven? `until` leaves out what was after"),
    ):  # fmt: skip
        if off_s > EDGE_S:
            findings.add(kind, f"telemetry {what.format(off_s)}", done, time_s=time_s)
    wrong, early = list[str](), telemetry.time_s <= EDGE_S
    if (rows := np.flatnonzero(np.isfinite(telemetry.yaw_deg) & early)).size:
        off = float(np.remainder(telemetry.yaw_deg[rows[0]] - plan.heading_deg + 180.0, 360.0) - 180.0)
        wrong += [f"heading is {off:.3g} deg off the plan's"] * (abs(off) > HEADING_DEG)
    if (rows := np.flatnonzero(telemetry.fixed & early)).size:
        off = float(np.hypot(*(telemetry.fix_m[rows[0]] - [plan.x_m, plan.y_m])))
        sigma = float(np.sqrt(np.trace(telemetry.fix_covariance_m2[rows[0]])))
        wrong += [f"position is {off:.3g} m from the plan's start"] * (off > START_M + SURE * sigma)
    for what in wrong:
        findings.add("another start", f"the first {what}: another frame, or another plan", "kept as it is", doubt=True)


class _Halt(NamedTuple):
    """A standstill that the plan does not have, or of another length.

    Attributes
    ----------
    begin_s, end_s : by the clock of the telemetry. [s]
    planned_s : when it is by the plan. [s]
    longer_s : how much longer than planned. [s]
    planned : whether one was planned.
    """

    begin_s: float
    end_s: float
    planned_s: float
    longer_s: float
    planned: bool


class _CommandsAlongWay(NamedTuple):
    """Commands over the way of the rims, in rows or steps in which these move.

    Attributes
    ----------
    time_s, way_m : when, and mean way of the rims until then. (n,) [s], (n,) [m]
    command : steering [deg], or, where no wheel is steered, speed of each rim over their mean [-]. (n, wheels)
    speed_m_s : usual speed of the rims. [m/s]
    """

    time_s: FloatArray
    way_m: FloatArray
    command: FloatArray
    speed_m_s: float

    @classmethod
    def of(
        cls, time_s: FloatArray, speed_m_s: FloatArray, command: FloatArray, gaps: BoolArray
    ) -> "_CommandsAlongWay | None":
        """From times (n,), mean speed of the rims between them and gaps (n - 1,), and commands; None where nothing
        moves."""
        fast = speed_m_s > UNDER_WAY * np.max(speed_m_s, initial=0.0)
        rows = np.append(fast & ~gaps, False)
        if rows.sum() < 2:
            return None
        # Noise of a wheel that stands is no way: over many rows it would add up to one.
        steps = speed_m_s * np.diff(time_s)
        way = np.append(0.0, np.cumsum(np.where(steps > STILL * np.median(steps[fast]), steps, 0.0)))
        return cls(time_s[rows], way[rows], command[rows], float(np.median(speed_m_s[fast])))


class _PlanMatch:
    """Rows of telemetry in which wheels turn, beside the commands of a plan at the same way.

    Attributes
    ----------
    sent, plan : both by their ways, that of the rows in the plan's metres.
    offset_m : of the way of the rows behind that of the plan, as it fits best.
    planned_s, late_s : when the plan has each row, and by how much the row is later at the drive's pace. (n,) [s]
    off : rows whose commands are not the plan's; `inside` are rows within the plan. (n,), (n,)
    off_m, share_off : way with other commands [m], and its share; 1 where too little lies within the plan.
    """

    def __init__(self, sent: _CommandsAlongWay, plan: _CommandsAlongWay, schedule: Schedule, rover: Rover) -> None:
        self.rover, self.schedule, self.plan = rover, schedule, plan
        self.allowed = STEERING_DEG if rover.steered_mask.any() else OBEYED
        pace, end = sent.speed_m_s / plan.speed_m_s, float(plan.way_m[-1])
        begin = float(np.interp(sent.time_s[0], plan.time_s, plan.way_m))
        tried = list[tuple[float, _CommandsAlongWay, float, float]]()
        # Faster wheels go as far in less time, or are of another size and go farther.
        for scale, faster in ((1.0, pace), (pace, 1.0)):
            one = sent._replace(way_m=sent.way_m / scale)
            by_clock = begin - float(one.way_m[0])
            tried.append((self._ln_of(one, by_clock), one, by_clock, faster))
        if max(ln for ln, *_ in tried) < LN_ODDS["clock offset"]:
            for _, one, _, faster in tuple(tried):
                last = float(one.way_m[-1])
                step = max(STEP_M, (last + end) / MOST_TRIED)
                ln, offset_m = -np.inf, 0.0
                for offsets in (np.arange(-last, end, step), np.arange(-step, step, STEP_M / 2.0)):
                    near = offset_m + np.append(0.0, offsets)
                    values = np.array([self._ln_of(one, float(offset)) for offset in near])
                    # Of offsets that are as good the plan's begin, else the middle one.
                    ln, alike = float(values.max()), np.sort(near[values == values.max()])
                    offset_m = 0.0 if (alike == 0.0).any() else float(alike[len(alike) // 2])
                tried.append((ln + LN_ODDS["clock offset"], one, offset_m, faster))
        _, self.sent, self.offset_m, faster = max(tried, key=lambda one: one[0])
        way, length = self.sent.way_m, np.gradient(self.sent.way_m)
        self.off, self.inside = self._compared(self.sent, self.offset_m)
        self.planned_s = np.interp(way + self.offset_m, plan.way_m, plan.time_s)
        self.late_s = sent.time_s - self.planned_s / faster
        within = float(length[self.inside].sum())
        short = within < REPORTED * min(float(length.sum()), end)
        self.off_m = float((length * self.off.any(axis=1))[self.inside].sum())
        self.share_off = 1.0 if short else self.off_m / within

    @classmethod
    def of(cls, sent: Rows, rover: Rover, schedule: Schedule) -> "_PlanMatch | None":
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
        made = [_CommandsAlongWay.of(*one) for one in zip((telemetry.time_s, grid), means, command, gaps, strict=True)]
        return None if made[0] is None or made[1] is None else cls(made[0], made[1], schedule, rover)

    def _ln_of(self, sent: _CommandsAlongWay, offset_m: float) -> float:
        """ln of how probable an offset is, up to a constant."""
        some = slice(None, None, 1 + len(sent.way_m) // MOST_TRIED)
        off, inside = self._compared(sent, offset_m, some)
        steps = np.gradient(sent.way_m)[some] * len(sent.way_m) / len(off)
        # Of the way in one, the part that is not in the other is as wrong as other commands are.
        missed = max(self.plan.way_m[-1] - steps[inside].sum(), 0.0)
        return LN_ODDS["commands"] * float(steps[off.any(axis=1) | ~inside].sum() + missed)

    def _compared(
        self, sent: _CommandsAlongWay, offset_m: float, rows: slice = slice(None)
    ) -> tuple[BoolArray, BoolArray]:
        """Rows and wheels whose command is not that of the plan, nor just before or behind; rows within the plan."""
        way, off = sent.way_m[rows] + offset_m, np.ones(sent.command[rows].shape, dtype=bool)
        for beside in (-STEP_M / 2.0, 0.0, STEP_M / 2.0):
            at = np.minimum(np.searchsorted(self.plan.way_m, way + beside), len(self.plan.way_m) - 1)
            off &= np.abs(sent.command[rows] - self.plan.command[at]) > self.allowed
        return off, np.asarray((way >= -STEP_M) & (way <= self.plan.way_m[-1] + STEP_M))

    def halts(self) -> "tuple[_Halt, ...]":
        """Where the rover stood longer, or less long, than the plan has it."""
        rows = np.flatnonzero(self.inside)
        times, planned, way = self.sent.time_s[rows], self.planned_s[rows], self.sent.way_m[rows]
        longer, halts = np.diff(self.late_s[rows]), list[_Halt]()
        jumps = np.flatnonzero(np.abs(longer) > EDGE_S)
        for near in np.split(jumps, np.flatnonzero(np.diff(way[jumps]) > LEAST_ROW_M) + 1):
            total = float(longer[near].sum())
            if near.size and abs(total) > EDGE_S:
                first, last = int(near[np.argmax(np.abs(longer[near]))]), int(near[-1])
                stands = bool((np.diff(planned)[near[0] : last + 1] > EDGE_S / 2.0).any())
                begin = times[first] + min(planned[first + 1] - planned[first], times[first + 1] - times[first])
                halts.append(_Halt(begin, times[first + 1], planned[first + 1], total, stands))
        return tuple(halts)


def _report_halts(halts: tuple[_Halt, ...], schedule: Schedule, findings: Findings) -> None:
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
    done_m = float(run.way_at(np.array(share)))
    number = int(np.searchsorted(ends[:-1], done_m))
    leg = run.legs[number]
    way = f"{share * leg.turn_deg:.3g} deg"
    if leg.length_m:
        way = f"{done_m - (ends[number] - leg.length_m):.3g} m"
    return f"split leg {before + number + 1} of the plan after {way}, with a [[leg]] of stop_s = {stop_s:.4g} between"


def _report_clock(telemetry: Telemetry, beside: _PlanMatch, findings: Findings) -> float:
    """By how much the clock is later than the plan's, said; 0 where it is not. [s]"""
    rows = beside.late_s[beside.inside]
    if beside.share_off > REPORTED or not rows.size:
        return 0.0
    # Until the first halt that one of them has alone.
    late = float(np.median(rows[: 1 + int(np.argmax(np.append(np.abs(np.diff(rows)) > EDGE_S, True)))]))
    if abs(late) * beside.schedule.plan.speed_m_s < STEP_M:
        return 0.0
    what = f"the commands are those of the plan if the clock is {abs(late):.3f} s {'late' if late > 0 else 'early'}"
    start = f"`start_time` {telemetry.start_s + late:.12g}"
    findings.add("clock offset", what, f"times count from there, as {start} has it")
    return late


def _report_commands(beside: _PlanMatch, findings: Findings) -> bool:
    """Say that commands are not the plan's; whether that is a doubt. Some row must be off."""
    sent, plan, off = beside.sent, beside.plan, beside.off & beside.inside[:, None]
    rows = np.flatnonzero(off.any(axis=1))
    wheel = int(np.argmax(off[rows[0]]))
    planned = plan.command[int(np.argmin(np.abs(plan.time_s - beside.planned_s[rows[0]]))), wheel]
    what, unit = ("steering", " deg") if beside.rover.steered_mask.any() else ("rim", " of the mean speed")
    text = f"the commands of {100 * beside.share_off:.0f} % of the way are not those of the plan"
    done, doubt = "the telemetry's are taken; give the plan as it was driven", bool(sent.time_s[rows[-1]] > EDGE_S)
    if not doubt:
        text += ", all of them at its start"
        done = "the telemetry's are taken; a plan begins at its full speed, steered as its first leg is"
    elif beside.share_off > REPORTED:
        done += ", and its `rover`"
    else:
        done += " (`blend_m` is half before a join of arcs, half behind)"
    text += (
        f"; first {what} of {beside.rover.wheels[wheel]} is {sent.command[rows[0], wheel]:.3g}{unit}, "
        f"planned {planned:.3g}"
    )
    findings.add("other commands", text, done, count=len(rows), time_s=float(sent.time_s[rows[0]]), doubt=doubt)
    return doubt


def with_positions(telemetry: Telemetry, positions: Positions, file: str, findings: Findings) -> Telemetry:
    """Telemetry with positions from elsewhere in place of its own, in rows at their times.

    Between rows wheels, headings and attitude are taken to change evenly. Positions that are a gap or more before or
    after the telemetry are left out and said. `file` is where they come from.
    """
    telemetry = ordered(telemetry, findings)
    times = telemetry.time_s
    reach = GAP * float(np.median(np.diff(times)))
    good = (positions.time_s >= times[0] - reach) & (positions.time_s <= times[-1] + reach)
    if not good.all():
        what = f"{(~good).sum()} of {len(good)} positions of {file} are not within the times of the telemetry"
        findings.add("positions at other times", what, "they are left out", count=int((~good).sum()), doubt=True)
    at = np.clip(positions.time_s[good], times[0], times[-1])
    merged = np.union1d(times, at)
    columns: dict[str, Any] = {
        item.name: _between(merged, times, value)
        for item in dataclasses.fields(telemetry)
        if isinstance(value := getattr(telemetry, item.name), np.ndarray)
    }
    rows = np.searchsorted(merged, at)
    columns["fix_m"] = np.full((len(merged), 2), np.nan)
    columns["fix_covariance_m2"] = np.full((len(merged), 2, 2), np.nan)
    columns["fix_m"][rows], columns["fix_covariance_m2"][rows] = positions.place_m[good], positions.covariance_m2[good]
    if positions.shared_m2 is not None:
        shared = positions.shared_m2 * np.append(False, good[:-1])[:, None, None]
        columns["fix_shared_m2"] = np.zeros((len(merged), 2, 2))
        columns["fix_shared_m2"][rows] = shared[good]
    return dataclasses.replace(telemetry, **columns)


def _between(merged: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    """Values (n, ...) at more times: linear between two that are known and no half turn apart, else blank."""
    flat = values.reshape(len(times), -1)
    low = np.clip(np.searchsorted(times, merged, side="right") - 1, 0, len(times) - 1)
    high = np.minimum(low + (times[low] < merged), len(times) - 1)
    share = (merged - times[low]) / np.where(high > low, times[high] - times[low], 1.0)
    step = flat[high] - flat[low]
    step[np.abs(step) > 180.0] = np.nan
    result = np.where((high > low)[:, None], flat[low] + share[:, None] * step, flat[low])
    return np.asarray(result.reshape(len(merged), *values.shape[1:]))


def usable_positions(telemetry: Telemetry, way_m: FloatArray, findings: Findings) -> Telemetry:
    """Positions without those that have no proper covariance or only repeat the one before.

    `way_m` is the way of the rims until each row. (n,) Raises DataError where fewer than two are left.
    """
    given, value = telemetry.fixed, telemetry.fix_covariance_m2
    complete: BoolArray = np.asarray(np.isfinite(value).all(axis=(1, 2)))
    least = np.linalg.eigvalsh(np.where(complete[:, None, None], value, -np.eye(2)))[:, 0]
    sigma = np.where(least > 0, np.sqrt(np.abs(np.trace(value, axis1=1, axis2=2)) / 2.0), np.nan)
    bad = "bad covariance", "errors that are missing, 0, negative, or no covariance"
    used = _used("position", bad, telemetry, telemetry.fix_m, sigma, way_m, findings)
    check_far(np.flatnonzero(used), telemetry, way_m, findings)
    shared = telemetry.fix_shared_m2
    if shared is not None:
        before = np.flatnonzero(given)
        shared = shared.copy()
        shared[before[1:][~used[before[:-1]]]] = 0.0
    return dataclasses.replace(telemetry, fix_m=np.where(used[:, None], telemetry.fix_m, np.nan), fix_shared_m2=shared)


def usable_headings(telemetry: Telemetry, turned_deg: FloatArray, findings: Findings) -> Telemetry:
    """Headings without full turns between rows, and without those that only repeat the one before.

    `turned_deg` is the turn that the wheels say until each row. (n,) Raises DataError where fewer than two are left.
    """
    sigma = np.where(telemetry.yaw_deg_sigma > 0, telemetry.yaw_deg_sigma, np.nan)
    bad = "heading error", "yaw_deg_sigma is missing, 0 or negative"
    used = _used("heading", bad, telemetry, telemetry.yaw_deg[:, None], sigma, turned_deg, findings)
    blank = np.isnan(telemetry.yaw_deg)
    findings.of_rows(
        "missing headings", "rows lack yaw_deg", "their headings follow from other rows", blank, telemetry.time_s
    )
    yaw = np.where(used, telemetry.yaw_deg, np.nan)
    yaw[used] = _without_full_turns(yaw[used], turned_deg[used])
    return dataclasses.replace(telemetry, yaw_deg=yaw)


def _without_full_turns(yaw_deg: FloatArray, turned_deg: FloatArray) -> FloatArray:
    """Headings that go on over full turns, also where a rover spins by more than half of one between two of them. (n,)

    It turns by a share of what its wheels say, skid-steered ones by half; steps of a quarter turn or less tell it.
    """
    change, turn = (np.diff(yaw_deg) + 180.0) % 360.0 - 180.0, np.diff(turned_deg)
    sure = np.abs(turn) <= 90.0
    gain = (SIGMA_DEG**2 + change[sure] @ turn[sure]) / (SIGMA_DEG**2 + turn[sure] @ turn[sure])
    return gain * turned_deg + np.unwrap(yaw_deg - gain * turned_deg, period=360.0)


def _used(
    name: str, bad: tuple[str, str], telemetry: Telemetry, values: FloatArray, sigma: FloatArray, change: FloatArray,
    findings: Findings,
) -> BoolArray:  # fmt: skip
    """Measurements (n, m) whose error (n,) is known and that do not only repeat the one before, while `change` says by
    how much they should. (n,) Raises DataError where fewer than two are left."""
    given, same = np.isfinite(values).all(axis=1), np.zeros(len(values), dtype=bool)
    sound = np.asarray(given & np.isfinite(sigma))
    if sound.any():
        error = float(np.median(sigma[sound]))
        chance = repeat_chance(values[sound], error) ** values.shape[1]
        same[sound] = repeated(values[sound], chance, change[sound], math.sqrt(2.0) * error)
    again = f"repeated {name}", f"{name} repeats the one before to the last digit: sent again, or the sensor hangs"
    for rows, (kind, what) in ((given & ~sound, bad), (same, again)):
        findings.of_rows(kind, what, f"these {kind.split()[-1]}s are left out", rows, telemetry.time_s)
    used = sound & ~same
    if used.sum() < 2:
        raise DataError(
            f"{telemetry.file}: {used.sum()} {name}s of use among {given.sum()} ({(given & ~sound).sum()} have errors "
            f"that are missing or wrong, {same.sum()} repeat another); slip needs two or more"
        )
    return used


def check_attitude(telemetry: Telemetry, held: PrescribedLoads, rows: IndexArray, findings: Findings) -> None:
    """Roll and pitch are those of a rover that stands on this terrain; all alike off is their sensor's mounting."""
    for column, name in ((3, "roll_deg"), (4, "pitch_deg")):
        measured, stood = getattr(telemetry, name)[rows], held.paths[:, column]
        given = np.isfinite(measured) & np.isfinite(stood)
        if given.sum() < 5:
            continue
        a, b = measured[given], stood[given]

        def off(values: FloatArray, wanted: FloatArray = b) -> float:
            return float(np.median(np.abs(values - wanted)))

        if off(a) <= max(ATTITUDE_DEG, FOLLOWS * off(b, np.zeros(1))):
            continue
        mounted = float(np.median(a - b))
        turned = abs(mounted) < MOUNTED_DEG and off(a - mounted) < 0.5 * ATTITUDE_DEG
        cause = f"its sensor is turned by {mounted:.2g} deg" if turned else "it is of another terrain or frame"
        cause = "it has the other sign" if off(-a) < 0.4 * off(a) else cause
        cause = "it looks like rad" if off(np.degrees(a)) < 0.4 * off(a) else cause
        what = f"{name} differs from the terrain's by {off(a):.3g} deg in the median: {cause}"
        done = "the terrain's is taken"
        findings.add("attitude against terrain", what, done, count=int(given.sum()), doubt=not turned)
