"""Clock, steering and pace of telemetry: rows in their order, each time once, gaps between.

How the wheels were steered is as measured, else as commanded, where the two agree.
"""

import dataclasses
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.plans.path import commands_at, make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import VALID_SLIP
from lunarsci.twin.telemetry.reading import Findings, Telemetry
from lunarsci.twin.telemetry.rests import GAP, held

LEAST_ROWS = 5
FAST = "fast slip"
"""Kind of a finding."""
MOST_FAST = 0.05
"""Share of states that slip beyond the range of the wheel model from which on a soil learned from the others is in
doubt; assumed."""


def taken(telemetry: Telemetry, rows: IndexArray | BoolArray) -> Telemetry:
    """Some rows of telemetry, as a mask or by number."""
    arrays: dict[str, Any] = {name: value[rows] for name, value in _arrays(telemetry).items()}
    return dataclasses.replace(telemetry, **arrays)


def _arrays(telemetry: Telemetry) -> dict[str, FloatArray]:
    """What has a row for each time, by name."""
    values = {field.name: getattr(telemetry, field.name) for field in dataclasses.fields(telemetry)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def ordered(telemetry: Telemetry, findings: Findings) -> Telemetry:
    """Rows that have a time, each time once, ascending.

    Rows without a time, and rows that repeat one to the last digit, are left out; rows out of their order by less than
    a gap are put into it; rows of one time are one, the first that has a value. All of it is said. Raises DataError
    where time runs backwards by more, and where fewer than five rows are left.
    """
    timed = np.isfinite(telemetry.time_s)
    if not timed.all():
        lost = int((~timed).sum())
        findings.add("no time", f"{lost} rows without a time_s", "left out", count=lost)
        telemetry = taken(telemetry, timed)
    if (np.diff(telemetry.time_s) <= 0).any():
        telemetry = _in_order(telemetry, findings)
    if len(telemetry.time_s) < LEAST_ROWS:
        raise DataError(f"{telemetry.file}: {len(telemetry.time_s)} rows with a time; give {LEAST_ROWS} or more")
    return telemetry


def _in_order(telemetry: Telemetry, findings: Findings) -> Telemetry:
    import pandas as pd

    content = np.column_stack([value.reshape(len(value), -1) for value in _arrays(telemetry).values()])
    again = pd.DataFrame(content).duplicated().to_numpy()
    if again.any():
        first, count = float(telemetry.time_s[int(np.argmax(again))]), int(again.sum())
        findings.add("repeated rows", f"{count} rows repeat another one", "left out", count=count, time_s=first)
        telemetry = taken(telemetry, ~again)
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
        telemetry = taken(telemetry, np.argsort(telemetry.time_s, kind="stable"))
    if not (np.diff(telemetry.time_s) == 0).any():
        return telemetry
    columns: dict[str, Any] = {}
    differ = np.zeros(len(telemetry.time_s), dtype=bool)
    for name, value in _arrays(telemetry).items():
        together = pd.DataFrame(value.reshape(len(value), -1)).groupby(telemetry.time_s)
        columns[name] = together.first().to_numpy(float).reshape(-1, *value.shape[1:])
        differ |= (together.transform("nunique") > 1).any(axis=1).to_numpy()
    if differ.any():
        first, count = float(telemetry.time_s[int(np.argmax(differ))]), int(differ.sum())
        what, done = f"{count} rows share their time and differ", "the first one of each time is taken"
        findings.add("rows of one time", what, done, count=count, time_s=first)
    return dataclasses.replace(telemetry, **columns)


def time_gaps(telemetry: Telemetry, findings: Findings) -> BoolArray:
    """Steps between rows that are gaps: longer than `GAP` times the median, but over rests. (n - 1,)"""
    steps, rested = np.diff(telemetry.time_s), telemetry.rested
    usual = float(np.median(steps[~rested]))
    gaps = np.asarray((steps > GAP * usual) & ~rested)
    if gaps.any():
        first = int(np.argmax(gaps))
        findings.add(
            "gap",
            f"nothing was sent for {steps[gaps].sum():.4g} s in all, {usual:.3g} s between rows being usual",
            "there are no states within gaps",
            count=int(gaps.sum()),
            time_s=float(telemetry.time_s[first]),
        )
    return gaps


OFF_DEG, STEERED_DEG = 5.0, 0.5
"""Difference of measured and commanded steering that no motor on its way makes, and standard error of one from the
other; assumed. [deg]"""


def steering_angles(telemetry: Telemetry, rover: Rover, findings: Findings) -> tuple[FloatArray, BoolArray]:
    """Steering of every row and wheel, and where it is known, not found from the rows beside. (n, wheels) [deg]

    Readings that hang or jump away from the command are replaced by it and said. Raises DataError for a wheel that has
    none, and for angles beyond 90 degrees.
    """
    measured, told = telemetry.steered_deg.copy(), telemetry.steering_deg
    for k, wheel in enumerate(rover.wheels):
        _mend(telemetry, k, wheel, measured, told, findings)
    angle = np.where(np.isfinite(measured), measured, told)
    known = np.isfinite(angle)
    for k, wheel in enumerate(rover.wheels):
        rows = known[:, k]
        if not rows.any():
            raise DataError(f"{telemetry.file}: no row has a steering angle of wheel {wheel}")
        if not rows.all():
            findings.add(
                "missing steering",
                f"rows without a steering angle of wheel {wheel}",
                "found from the rows beside; its states are not valid there",
                count=int((~rows).sum()),
                time_s=float(telemetry.time_s[int(np.argmin(rows))]),
            )
        angle[:, k] = np.interp(telemetry.time_s, telemetry.time_s[rows], angle[rows, k])
    if np.abs(angle).max() > 90.0:
        raise DataError(f"{telemetry.file}: steering angles reach {np.abs(angle).max():.4g} deg; give -90 to 90 deg")
    return angle, known


def _mend(telemetry: Telemetry, k: int, wheel: str, measured: FloatArray, told: FloatArray, findings: Findings) -> None:
    """Put the command in the place of readings that hang or spike, in one wheel's column of `measured`.

    Where most readings are off their commands, it is these that are others.
    """
    both = np.isfinite(measured[:, k]) & np.isfinite(told[:, k])
    if not both.any():
        return
    hung, off = np.zeros((2, len(both)), dtype=bool)
    hung[both] = held(measured[both, k], 1.0, told[both, k], STEERED_DEG)
    off[both] = np.abs(measured[both, k] - told[both, k]) > OFF_DEG
    off &= ~hung
    obeyed = not np.median(off[both])
    for kind, rows, what in (
        ("stuck", hung, f"the steering angle of wheel {wheel} stays the same while it is told to change"),
        ("odd steering", off, f"the steering angle of wheel {wheel} is over {OFF_DEG:g} deg off its command"),
    ):
        if rows.any():
            mended = kind == "stuck" or obeyed
            done = "the command is taken there" if mended else "the measured angle is taken"
            first = float(telemetry.time_s[int(np.argmax(rows))])
            findings.add(kind, what, done, count=int(rows.sum()), time_s=first, doubt=not mended)
            if mended:
                measured[rows, k] = told[rows, k]


PACE = 0.02
"""Share by which wheels may turn faster or slower than the plan says, unsaid: it is a slip of as much; assumed."""
PACE_ERRORS = 3.0
"""And in errors of the ratio; assumed."""
UNDER_WAY = 0.3
"""Share of the highest speed from which a wheel counts as under way; assumed."""
SHELL = 0.01
"""How near the ratio must come to r_s / r for the plan's speed to be taken for that of the shell; assumed."""
FEWEST_RATES = 5
AGAINST_PLAN = "wheels against plan"
"""Kind of the finding; a soil is found with a plan of its own, so that it does not stay with the states."""


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
        told = commands_at(rover, schedule, times_s).speed_m_s
        # From the first fix on the rover drives its legs from where it believes to be, not at the plan's speed.
        last_s = schedule.runs[0].end_s if plan.fixes else schedule.duration_s
        inside = (times_s >= 0.0) & (times_s <= last_s)
        turning = np.isfinite(rim_m_s) & inside[:, None] & (rim_m_s * told > 0.0)
        # Neither at a halt nor beside one, where a mean over some time is of both.
        half_s = np.gradient(times_s) / 2.0 if times_s.size > 1 else np.zeros(1)
        for at in (times_s - half_s, times_s, times_s + half_s):
            turning &= np.abs(commands_at(rover, schedule, at).speed_m_s) > UNDER_WAY * np.abs(told).max()
        turning &= np.abs(rim_m_s) > UNDER_WAY * np.max(np.abs(rim_m_s), where=turning, initial=0.0)
        # Of sums: a coarse encoder has steps of many sizes.
        rows = [(rim_m_s[on, k], told[on, k]) for k, on in enumerate(turning.T) if on.any()]
        if sum(rims.size for rims, _ in rows) < FEWEST_RATES:
            return None
        means = np.array([rims.sum() / planned.sum() for rims, planned in rows])
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
        return abs(self.ratio - 1.0) > max(PACE, PACE_ERRORS * self.sigma)

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
        if self.shell_ratio > 1.0 + SHELL and abs(self.ratio - self.shell_ratio) < max(SHELL, 2.0 * self.sigma):
            return (
                f"this is r_s / r: if the plan's speed is that of the wheel's radius alone, write speed_m_s = {right}; "
                "else check the radius"
            )
        return f"write speed_m_s = {right} in the plan, or mend the wheel's radius: both look alike"

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


def check_stands(stands: BoolArray, time_s: FloatArray, findings: Findings) -> None:
    """Say states at which the rover does not stand on the terrain."""
    if not stands.all():
        findings.add(
            "off the terrain",
            "the rover does not stand on the terrain there",
            "states there are left blank, not valid",
            count=int((~stands).sum()),
            time_s=float(time_s[int(np.argmin(stands))]),
            doubt=True,
        )


FAR_M = 1.0
"""Way by the wheels below which positions are never far apart; assumed. [m]"""


def check_far(rows: IndexArray, telemetry: Telemetry, way_m: FloatArray, findings: Findings) -> None:
    """Say where the rover rolls much farther than usual from one position to the next, or to either end."""
    ends = np.concatenate([[0], rows, [len(way_m) - 1]])
    ways = np.diff(way_m[ends])
    usual = float(np.median(ways[ways > 0])) if (ways > 0).any() else 0.0
    far = np.flatnonzero(ways > max(GAP * usual, FAR_M))
    if far.size:
        longest = int(far[np.argmax(ways[far])])
        begin, end = telemetry.time_s[ends[longest]], telemetry.time_s[ends[longest + 1]]
        findings.add(
            "far positions",
            f"no position between {begin:.6g} and {end:.6g} s, {ways[longest]:.3g} m by the wheels where {usual:.2g} m "
            "are usual",
            "slip there is told by one state or none; what it was on the way is not known",
            count=far.size,
            time_s=float(begin),
        )


def check_slips(slip: FloatArray, measured: BoolArray, time_s: FloatArray, findings: Findings) -> None:
    """Say states that slip beyond the range of the wheel model.

    `slip` and whether it is `measured` are of some times. (m, wheels), (m, wheels), (m,)
    """
    fast = measured & (np.abs(slip) > VALID_SLIP)
    count, whole = int(fast.sum()), int(measured.sum())
    if count:
        what = f"{count} of {whole} states slip by more than {VALID_SLIP:g}, beyond what the wheel model holds for"
        done = "kept here, in medians and ranges too, but marked not valid: `twin update` learns no soil from them"
        first = float(time_s[int(np.argmax(fast.any(axis=1)))])
        findings.add(FAST, what, done, count=count, time_s=first)
