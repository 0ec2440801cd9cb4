"""A motion of the rover that is given, as from localisation: where it was when, and what its wheels were told.

Motions that a measured one may have been: its errors, smooth along the drive, put on it.
"""

import dataclasses
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import LunarSciWarning, ParameterError, within_file
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.ranges import POSITIVE, check_range, refuse
from lunarsci.regolith.columns import check_written_for
from lunarsci.twin.plans.path import UNDER_WAY, commands_at, make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd


POSE_COLUMNS = ("time_s", "x_m", "y_m", "yaw_deg")
GAP = 5.0
"""Times the median step between poses from which on a step is a gap; assumed."""
CLOCK_S = 1.0
"""How far the clocks of motion, positions and plan may differ unsaid; assumed. [s]"""
STANDSTILL = 0.5
"""Share of the usual speed of the commanded rims below which it is a halt: nearer to none than to the usual one;
assumed."""
SIGMAS = ("x_m_sigma", "y_m_sigma", "yaw_deg_sigma")
CORRELATION_M = 0.5
"""Distance over which errors of a smoothed motion stay alike, where nothing tells it; assumed. [m]"""
WAVES = 48
"""Of which an error is made up; its covariance is exact for any number, with more it also is nearly normal."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Poses of the rover's origin, and commands of its wheels.

    Attributes
    ----------
    time_s : ascending. (n,) [s]
    x_m, y_m, yaw_deg : pose in the plane of the map, yaw from x to the left. (n,) [m, m, deg]
    steering_deg : steering angle of each wheel, positive to the left, -90 to 90. (n, wheels) [deg]
    speed_m_s : speed of each rim over ground, r_s omega, not 0 but at a halt; negative backwards. (n, wheels) [m/s]
    sigmas : standard errors of x, y and yaw, None where they are not known. (n, 3) [m, m, deg]
    halted : poses at a halt, None where there is none. (n,)

    Raises ParameterError for fewer than three poses, times that do not ascend, values that are not finite, or errors
    below 0.
    """

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_deg: FloatArray
    steering_deg: FloatArray
    speed_m_s: FloatArray
    sigmas: FloatArray | None = None
    halted: BoolArray | None = None

    def __post_init__(self) -> None:
        refuse(self._ill_made())

    def _ill_made(self) -> Iterator[str]:
        if len(self.time_s) < 3:
            yield f"the motion has {len(self.time_s)} poses; give at least 3"
        for name in ("time_s", "x_m", "y_m", "yaw_deg", "steering_deg", "speed_m_s"):
            if len(rows := np.argwhere(~np.isfinite(getattr(self, name)))):
                yield f"motion {name} is not finite at pose {rows[0][0]}; leave such poses out"
        if (late := np.flatnonzero(np.diff(self.time_s) <= 0)).size:
            yield f"motion time_s does not ascend after pose {late[0]}; sort it and drop duplicates"
        if (np.abs(self.steering_deg) > 90.0).any():
            yield "motion steering_deg is beyond 90 deg; a wheel that runs backwards has speed < 0"
        moving = np.ones(len(self.time_s), dtype=bool) if self.halted is None else ~self.halted
        if not moving.any() or (self.speed_m_s[moving] == 0).any():
            yield "motion speed_m_s is 0 somewhere; slip has no meaning for a wheel that does not turn"
        sigmas = np.zeros((len(self.time_s), 3)) if self.sigmas is None else self.sigmas
        if sigmas.shape != (len(self.time_s), 3):
            yield f"the motion's errors have shape {sigmas.shape}; {(len(self.time_s), 3)} is wanted"
        for name, column in zip(SIGMAS, sigmas.T, strict=True):
            if (wrong := np.flatnonzero(~(np.isfinite(column) & (column >= 0)))).size:
                yield f"motion {name} is {column[wrong[0]]:g} at pose {wrong[0]}; give 0 or more"

    @property
    def no_speed(self) -> BoolArray:
        """Poses whose speed the poses do not tell: at a halt, and beside a halt or a gap. (n,)"""
        still = np.zeros(len(self.time_s), dtype=bool) if self.halted is None else self.halted
        lost = still.copy()
        lost[1:] |= still[:-1]
        lost[:-1] |= still[1:]
        gap = np.diff(self.time_s) > GAP * np.median(np.diff(self.time_s))
        lost[1:] |= gap
        lost[:-1] |= gap
        return lost

    @property
    def rolled_m(self) -> FloatArray:
        """Mean distance that the rims have rolled since the first pose. (n,) [m]"""
        speed = np.abs(self.speed_m_s).mean(axis=1)
        steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(self.time_s)
        return np.concatenate([[0.0], np.cumsum(steps)])


def read_motion(
    source: InputFile | str | Path, rover: Rover, plan: Plan | None = None, member: int | None = None
) -> Motion:
    """Read a motion from CSV.

    Columns time_s, x_m, y_m, yaw_deg as in the `paths.csv` of a prediction; optionally member, of which one is read;
    and the commands of each wheel, `steering_FL_deg` and `speed_FL_m_s` and so on. Without these columns the commands
    are those of `plan` at the same times. Columns `x_m_sigma`, `y_m_sigma`, `yaw_deg_sigma` are standard errors. A
    `rover` with other wheels is refused. At a halt the rims turn at less than half their usual speed, or the plan is
    not under way. Raises DataError; warns of gaps and of poses outside the times of the plan.
    """
    file = source if isinstance(source, InputFile) else read_input(str(source))
    table = read_csv_table(file)
    check_written_for(file.name, table, rover.wheel, rover.name)
    with within_file(file.name):
        refuse(_lacking(table, rover, plan))
        table = _one_member(file.name, table, member)
        pose = {name: numbers_of(file.name, name, table[name]) for name in POSE_COLUMNS}
        steering, speed, halted = _commands(file.name, table, rover, plan, pose["time_s"])
        sigmas = None
        if SIGMAS[0] in table:
            sigmas = np.column_stack([numbers_of(file.name, name, table[name]) for name in SIGMAS])
        motion = Motion(**pose, steering_deg=steering, speed_m_s=speed, sigmas=sigmas, halted=halted)
    _warn_of_gaps(file.name, motion.time_s)
    return motion


def _command_columns(rover: Rover) -> list[list[str]]:
    """Names of the columns of steering angles, and of rim speeds."""
    return [[f"steering_{wheel}_deg" for wheel in rover.wheels], [f"speed_{wheel}_m_s" for wheel in rover.wheels]]


def _lacking(table: "pd.DataFrame", rover: Rover, plan: Plan | None) -> Iterator[str]:
    """Columns that a motion lacks, or has and should not."""
    for name in POSE_COLUMNS:
        if name not in table:
            yield f"no column {name}; a motion needs {', '.join(POSE_COLUMNS)}"
    commands = [name for columns in _command_columns(rover) for name in columns]
    for names, wanted in ((SIGMAS, "the errors of x, y and yaw, or of none"),
                          (commands, "the commands of all wheels, or a plan")):  # fmt: skip
        given, missing = ([name for name in names if (name in table) is there] for there in (True, False))
        if given and missing:
            yield f"no column {missing[0]}, but {given[0]}; give {wanted}"
    if commands[0] in table and plan is not None:
        yield f"has the commands of all wheels ({commands[0]}, ...); leave out the plan"
    if commands[0] not in table and plan is None:
        yield f"no columns {commands[0]}, {commands[len(rover.wheels)]}, ...; add the commands, or give the plan"


def _one_member(file: str, table: "pd.DataFrame", member: int | None) -> "pd.DataFrame":
    """The rows of one member, where there are several."""
    if "member" not in table:
        if member is not None:
            raise ParameterError(f"no column member to choose member {member} from; leave it out")
        return table
    given = numbers_of(file, "member", table["member"])
    numbers = np.unique(given[np.isfinite(given)])
    chosen = member if member is not None or len(numbers) != 1 else numbers[0]
    if chosen not in numbers:
        there = f"there are {numbers[0]:g} to {numbers[-1]:g}" if len(numbers) else "the column has no number"
        raise ParameterError(f"no member {chosen} in the column member, {there}; choose one with `member`")
    rows: pd.DataFrame = table[given == chosen]
    return rows


def _warn_of_gaps(file: str, time_s: FloatArray) -> None:
    steps = np.diff(time_s)
    usual, longest = float(np.median(steps)), int(np.argmax(steps))
    if steps[longest] > GAP * usual:
        text = (
            f"{file}: no pose for {steps[longest]:.4g} s after time_s {time_s[longest]:.6g}, {usual:.3g} s being "
            "usual; velocities beside a gap are means over it"
        )
        warnings.warn(text, LunarSciWarning, stacklevel=3)


def _commands(
    file: str, table: "pd.DataFrame", rover: Rover, plan: Plan | None, time_s: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Steering, speeds, and which poses are at a halt."""
    if plan is None:
        steering, speed = (
            np.column_stack([numbers_of(file, name, table[name]) for name in names])
            for names in _command_columns(rover)
        )
        return steering, speed, _standing(speed)
    schedule = make_schedule(plan, rover)
    _check_times(file, time_s, schedule.duration_s)
    commands = commands_at(rover, schedule, time_s)
    return np.degrees(commands.steering_rad), commands.speed_m_s, schedule.pace_at(time_s) < UNDER_WAY


def _standing(speed_m_s: FloatArray) -> BoolArray:
    mean = np.abs(speed_m_s).mean(axis=1)
    turning = mean[mean > 0]
    return np.asarray(mean < STANDSTILL * np.median(turning) if turning.size else mean == 0)


def _check_times(file: str, time_s: FloatArray, duration_s: float) -> None:
    outside = (time_s < -CLOCK_S) | (time_s > duration_s + CLOCK_S)
    if outside.all():
        raise ParameterError(
            f"time_s begins at {time_s[0]:g} s, but the plan lasts from 0 to {duration_s:.4g} s; count both from the "
            "start of the drive, or add the commands"
        )
    if outside.any():
        text = (
            f"{file}: {outside.sum()} of {len(time_s)} poses lie outside the 0 to {duration_s:.4g} s of the plan; "
            "they take its first or last commands"
        )
        warnings.warn(text, LunarSciWarning, stacklevel=4)


def correlation_of(motion: Motion, slip_ratio: FloatArray, slip_sigma: FloatArray) -> float | None:
    """Distance over which the motion's errors stay alike, as the errors of slips that were derived from it tell. [m]

    Errors of x and y of sigma, alike over a length l, are errors of sigma / l in the speed over ground as a share of
    the rims', and so of the slip ratio's travel v / (r_s omega) = 1 - s. None where motion or slips have no errors.

    Parameters
    ----------
    slip_ratio, slip_sigma : of any wheel states along the motion. (n,) [-]
    """
    given = np.isfinite(slip_ratio) & np.isfinite(slip_sigma) & (slip_sigma > 0)
    if motion.sigmas is None or not given.any():
        return None
    sigma = float(np.median(np.sqrt((motion.sigmas[:, :2] ** 2).mean(axis=1))))
    return sigma / float(np.median(slip_sigma[given])) if sigma > 0 else None


def drawn_motions(motion: Motion, count: int, correlation_m: float, rng: np.random.Generator) -> Iterator[Motion]:
    """Motions with errors of the given sigmas; without sigmas the motion itself, `count` times.

    Errors of x, y and yaw are independent normal processes over the distance that the rims rolled, with correlation
    exp(-d^2 / 2 l^2). They have to be smooth: errors of 5 mm that were independent from second to second would be
    errors of 7 mm/s of a rover that drives at 50 mm/s.

    Parameters
    ----------
    motion : as measured.
    count : how many, 1 or more.
    correlation_m : the length l, above 0. [m]
    rng : source of random numbers.

    Raises ParameterError. Waves of random length have that correlation on average (Rahimi & Recht 2007, Random features
    for large-scale kernel machines, NIPS 20, 1177).
    """
    check_range("draws of the motion", count, "[1, inf)")
    check_range("the errors' correlation length", correlation_m, POSITIVE)
    return _motions(motion, count, motion.rolled_m / correlation_m, rng)


def _motions(motion: Motion, count: int, place: FloatArray, rng: np.random.Generator) -> Iterator[Motion]:
    for _ in range(count):
        if motion.sigmas is None:
            yield motion
            continue
        wave, size = rng.standard_normal((3, WAVES, 1)), rng.standard_normal((2, 3, WAVES, 1)) / np.sqrt(WAVES)
        error = (size[0] * np.cos(wave * place) + size[1] * np.sin(wave * place)).sum(axis=1)
        x, y, yaw = error * motion.sigmas.T
        yield dataclasses.replace(motion, x_m=motion.x_m + x, y_m=motion.y_m + y, yaw_deg=motion.yaw_deg + yaw)
