"""What was measured of a drive, and how far simulated drives are from it: residuals over their errors.

Of a drive states of the wheels are measured at times, and positions from localisation. What the twin's physics may be
off by, alike for all wheels or for one of them throughout a drive, is a bias of known size: residuals along it count as
much less as it widens their errors.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray, at_times, samples_about
from lunarsci.errors import LunarSciWarning, ParameterError, within_file
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, StateTable, read_state_table
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.path import UNDER_WAY, Schedule, make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import VALID_SLIP
from lunarsci.twin.simulation.discrepancy import exposed_turns, turn_lever
from lunarsci.twin.simulation.ensemble import MOST_BEYOND, STATE_COLUMNS, Prediction, predict
from lunarsci.twin.telemetry.checks import WheelPace
from lunarsci.twin.telemetry.reading import Positions, joint_m2, read_positions

if TYPE_CHECKING:
    import pandas as pd

OBSERVED = COLUMNS
"""Columns of the measured values: sinkage, slip ratio, side slip, normal force, drawbar pull, lateral force."""
MODEL_SHARES = {
    "sinkage_m": 0.06,
    "slip_ratio": 0.25,
    "side_slip_deg": 0.20,
    "drawbar_pull_n": 0.015,
    "lateral_force_n": 0.06,
}
"""Error that all wheels share, of each quantity, as a share of its size: what the closed form differs by from the full
stress integrals on the same soil, measured once, over nine hidden soils, with the truth of
`tests/benchmarks/other_physics.py`. Loads follow from the suspension's levers and are not concerned."""
SHARED = 0.5**0.5
"""Of an error's share for the part that is constant, and for the one that goes with the quantity; assumed."""
MODEL_ERRORS = {
    "sinkage_m": 5e-5,
    "slip_ratio": 0.002,
    "side_slip_deg": 0.1,
    "normal_force_n": 0.2,
    "drawbar_pull_n": 0.1,
    "lateral_force_n": 0.1,
}
"""Assumed, beside the measured errors: what the twin may be off by where a measured error is next to nothing.
Side slip in bends is off by 0.04 deg at a time step of 0.1 s."""
FIX_ERROR_M = 0.0015
"""Measured: what the time step of 0.1 s puts the end of the embedded plan off by, and more than the interpolation
between samples does; over obstacles it is more. [m]"""
STEP_S, SAMPLE_M = 0.1, 0.1
"""Of the simulated drives: on the embedded plan ends are off by 0.8 mm, states are interpolated in time."""
POSITION = "position"
"""Stands for a quantity's name where positions are meant."""
HUBER = 4.0
"""Standard deviations beyond which a value counts by size, not square, and as an outlier, and a soil as none of the
first laws: 1 in 16 000 by chance; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveRecord:
    """Measured states and positions.

    Attributes
    ----------
    time_s, wheel : when, since the start of the plan, and of which wheel each state is. (n,) [s]
    values, sigmas : columns `OBSERVED`, NaN where not measured. (n, 6) [m, -, deg, N, N, N]
    fix_time_s, fix_m, fix_covariance_m2 : positions of the rover's origin, and their errors. (f,), (f, 2), (f, 2, 2)
    fix_shared_m2 : covariance of each position's error with that of the one before; None where they are independent.
        (f, 2, 2)
    rim_m_s : measured speed of each state's rim, NaN where it is not, None where no state has it. (n,) [m/s]
    doubt : why the states are doubtful, as `twin states` says in their column of that name; empty where they are not.

    Raises ParameterError for shapes that do not fit, times that are no numbers or negative, and sigmas below 0.
    """

    time_s: FloatArray
    wheel: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    fix_time_s: FloatArray
    fix_m: FloatArray
    fix_covariance_m2: FloatArray
    fix_shared_m2: FloatArray | None = None
    rim_m_s: FloatArray | None = None
    doubt: str = ""

    def __post_init__(self) -> None:
        n, f = len(self.time_s), len(self.fix_time_s)
        shapes = (self.values.shape, self.sigmas.shape, self.fix_m.shape, self.fix_covariance_m2.shape)
        if shapes != ((n, 6), (n, 6), (f, 2), (f, 2, 2)) or len(self.wheel) != n:
            raise ParameterError(f"a record's states and positions have shapes {shapes}; they do not fit its times")
        times, sigmas = np.append(self.time_s, self.fix_time_s), self.sigmas[np.isfinite(self.values)]
        places = [np.isfinite(self.fix_m).all(), *(np.linalg.eigvalsh(c)[0] > 0 for c in self.fix_covariance_m2)]
        for sound, text in (
            ((times >= 0) & (times < np.inf), "times must be 0 or more: they count from the start of the plan"),
            ((sigmas >= 0) & (sigmas < np.inf), "sigmas must be 0 or more wherever a value is measured"),
            (places, "positions need finite places and positive definite covariances"),
        ):
            if not np.all(sound):
                raise ParameterError(f"a record's {text}")

    @property
    def fix_joint_m2(self) -> FloatArray:
        """Covariance of all positions. (2 f, 2 f)"""
        return joint_m2(self.fix_covariance_m2, self.fix_shared_m2)


def read_drive_states(states: InputFile, rover: Rover, errors: MeasurementErrors | None = None) -> StateTable:
    """The wheel states of one drive of a rover, as `read_record` takes them. Raises DataError."""
    return read_state_table(states, rover.wheel, wheels=rover.wheels, rover=rover.name, errors=errors)


def read_record(
    states: InputFile | StateTable,
    rover: Rover,
    *,
    positions: InputFile | None = None,
    errors: MeasurementErrors | None = None,
) -> DriveRecord:
    """Read a record from CSV, or take a table of `read_drive_states`.

    States have `time_s`, `wheel`, and any of the columns `OBSERVED` with their `NAME_sigma`; positions are those of
    `read_positions`. Where no sigma is given it is that of `errors`. States with `valid` false are left out with a
    warning. With positions, slip and side slip of states whose `slip_basis` is `positions` are left out with a warning:
    they would count what the positions say a second time. Rows that are there twice count once, with a warning. Raises
    DataError, also for rows that contradict each other, several members, columns that are nearly known ones, and
    sinkages of a wrong sign or unit.

    Errors of slip are without the part that all states share (`slip_ratio_shared`): it is that of the wheels' radius,
    which an update finds.
    """
    table = _valid_rows(read_drive_states(states, rover, errors) if isinstance(states, InputFile) else states)
    values, sigmas = table.values.copy(), _without_shared(table)
    if positions is not None:
        _forget_slips(table.file, table.table, values)
    fixes = Positions.none() if positions is None else read_positions(positions)
    with within_file(table.file):
        return DriveRecord(
            time_s=table.numbers("time_s"),
            wheel=table.wheels,
            values=values,
            sigmas=sigmas,
            fix_time_s=fixes.time_s,
            fix_m=fixes.place_m,
            fix_covariance_m2=fixes.covariance_m2,
            fix_shared_m2=fixes.shared_m2,
            rim_m_s=table.numbers("rim_m_s") if "rim_m_s" in table.table else None,
            doubt="; ".join(table.table["doubt"].dropna().unique()) if "doubt" in table.table else "",
        )


def _without_shared(table: StateTable) -> FloatArray:
    """Errors of the values, that of slip without what all states share. (n, 6)"""
    sigmas = table.sigmas.copy()
    if "slip_ratio_shared" in table.table:
        shared, k = np.nan_to_num(table.numbers("slip_ratio_shared")), OBSERVED.index("slip_ratio")
        sigmas[:, k] = np.sqrt(np.maximum(sigmas[:, k] ** 2 - shared**2, 0.0))
    return sigmas


def _valid_rows(table: StateTable) -> StateTable:
    """The states that are marked valid, with a warning where others are left out."""
    if table.valid.all():
        return table
    out = ~table.valid
    text = f"{table.file}: {int(out.sum())} of {len(out)} states left out, marked not valid"
    if fast := int((np.abs(table.values[out, OBSERVED.index("slip_ratio")]) > VALID_SLIP).sum()):
        text += f": {fast} slip by more than {VALID_SLIP:g}, beyond what the wheel model holds for"
    warnings.warn(text, LunarSciWarning, stacklevel=3)
    return table.subset(table.valid)


def _forget_slips(file: str, table: "pd.DataFrame", values: FloatArray) -> None:
    """Blank slip and side slip that were derived from the positions which are given too."""
    if "slip_basis" not in table:
        return
    derived = np.asarray(table["slip_basis"].fillna("").str.strip().str.lower() == "positions")
    columns = np.array([OBSERVED.index(name) for name in ("slip_ratio", "side_slip_deg")])
    used = int((np.isfinite(values[:, columns]) & derived[:, None]).any(axis=1).sum())
    if used:
        text = f"{file}: slip and side slip of {used} states derive from positions, which are given too; left out"
        warnings.warn(f"{text}, so that nothing counts twice", LunarSciWarning, stacklevel=3)
        values[np.ix_(derived, columns)] = np.nan


def pace_of(record: DriveRecord, rover: Rover, plan: Plan) -> WheelPace | None:
    """How fast the wheels of a record turned beside a plan; None where it does not say."""
    if record.rim_m_s is None or not len(record.time_s):
        return None
    times, row = np.unique(record.time_s, return_inverse=True)
    rims = np.full((len(times), len(rover.wheels)), np.nan)
    rims[row, wheel_numbers(record, rover.wheels)] = record.rim_m_s
    return WheelPace.of(rims, times, rover, plan)


def check_clock(record: DriveRecord, end_s: float, spacing_s: float) -> None:
    """Raises ParameterError for a record that goes on more than a sample after the end of the drive."""
    for what, times in (("states", record.time_s), ("positions", record.fix_time_s)):
        late = int((times > end_s + spacing_s).sum())
        if late > MOST_BEYOND * len(times):
            raise ParameterError(
                f"{late} of {len(times)} {what} are later than the end of the drive at {end_s:.0f} s; is it the plan "
                "that was driven, and time_s in seconds from its start?"
            )


def check_wheels(record: DriveRecord, wheels: Sequence[str], rover: str) -> None:
    """Raises ParameterError for wheels that the rover has not."""
    if strange := set(record.wheel) - set(wheels):
        raise ParameterError(f"'{min(strange)}' is no wheel of {rover}; it has {', '.join(wheels)}")


def wheel_numbers(record: DriveRecord, wheels: Sequence[str]) -> IntArray:
    """Which of the wheels each state is of. (n,)"""
    return np.array([wheels.index(name) for name in record.wheel], dtype=np.int64)


def states_at(record: DriveRecord, times_s: FloatArray, states: FloatArray, wheels: Sequence[str]) -> FloatArray:
    """Columns `OBSERVED` of states (members, samples, wheels, 10) at times and wheels of a record. (members, n, 6)"""
    columns, wheel = [STATE_COLUMNS.index(name) for name in OBSERVED], wheel_numbers(record, wheels)
    low, share = samples_about(times_s, record.time_s)
    before, after = states[:, low, wheel][..., columns], states[:, low + 1, wheel][..., columns]
    return np.asarray((1.0 - share[:, None]) * before + share[:, None] * after)


@dataclass(frozen=True, slots=True)
class DriveBias:
    """Standard deviations of errors that stay the same throughout a drive.

    Attributes
    ----------
    common : by quantity, of errors that all wheels share: one constant, as a share of the quantity's mean size, and one
        that goes with the quantity. [-]
    wheels : by quantity, of one that each wheel has of its own, in the errors of its values. [-]
    turns : of the share that all spot turns are off by, of what they are exposed to. [-]

    Raises ParameterError for negative shares and unknown quantities.
    """

    common: Mapping[str, float] = field(default_factory=lambda: MODEL_SHARES)
    wheels: Mapping[str, float] = field(default_factory=dict)
    turns: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (*self.common.items(), *self.wheels.items()):
            if name not in OBSERVED or not 0 <= value < np.inf:
                raise ParameterError(f"model error of '{name}' is {value}; give 0 or more of {', '.join(OBSERVED)}")

    def marginalised(
        self,
        values: FloatArray,
        sigma: FloatArray,
        wheel: IntArray,
        way: FloatArray,
        whitening: FloatArray,
        expected: FloatArray,
        turned: FloatArray | None = None,
    ) -> "MarginalisedBias":
        """For a record.

        Parameters
        ----------
        values, sigma, wheel : measured, NaN where they do not count; their errors; number of their wheel. (n, 6), (n,)
        way, whitening : from the start to each position; their whitening. (f, 2), (2 f, 2 f)
        expected : values without their noise, also of quantities that were not measured. (n, 6)
        turned : how far each position moves for a share of 1 of the spot turns; None without any. (f, 2) [m]

        An error of the slip that all wheels share shortens the way, one of the side slip turns it.
        """
        columns = []
        for k, name in enumerate(OBSERVED):
            counted, measured = np.isfinite(values[:, k]), np.isfinite(expected[:, k])
            if self.common.get(name) and measured.any():
                sizes = SHARED * self.common[name] * np.where(measured, expected[:, k], 0.0)
                for part in (np.full(len(sizes), np.abs(sizes[measured]).mean()), sizes):
                    states = _column(values.shape, k, counted * part / sigma[:, k])
                    moved = part[measured].mean() * _moved(name, way)
                    columns.append(np.append(states, whitening @ moved.ravel()))
            if self.wheels.get(name):
                for w in np.unique(wheel):
                    states = _column(values.shape, k, self.wheels[name] * (counted & (wheel == w)))
                    columns.append(np.append(states, np.zeros(way.size)))
        if self.turns and turned is not None:
            columns.append(np.append(np.zeros(values.size), whitening @ (self.turns * turned).ravel()))
        if not columns:
            return MarginalisedBias(np.zeros((values.size + way.size, 0)), np.zeros(0))
        left, sizes, _ = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
        return MarginalisedBias(left, sizes)


def _column(shape: tuple[int, ...], k: int, part: FloatArray) -> FloatArray:
    """Zeros of this shape (n, 6) but for column k (n,), row by row. (6 n,)"""
    column = np.zeros(shape)
    column[:, k] = part
    return column.ravel()


def _moved(name: str, way: FloatArray) -> FloatArray:
    """How far places move for a unit of a quantity that is off throughout; `way` is from the start. (f, 2) [m]"""
    if name == "slip_ratio":
        return -way
    if name == "side_slip_deg":
        return np.asarray(np.radians(1.0) * np.column_stack([-way[:, 1], way[:, 0]]))
    return np.zeros(way.shape)


@dataclass(frozen=True, slots=True, eq=False)
class MarginalisedBias:
    """Whitening of residuals whose covariance is I + B B^T.

    Residuals along B count as much less as their errors are larger than those of single values.

    Attributes
    ----------
    vectors, sizes : left singular vectors of B, and its singular values. (r, c), (c,)
    """

    vectors: FloatArray
    sizes: FloatArray

    def applied(self, rows: FloatArray) -> FloatArray:
        """Residuals, whitened by the errors of single values, whitened by these, too. (..., r)"""
        share = 1.0 - 1.0 / np.sqrt(1.0 + self.sizes**2)
        return np.asarray(rows - ((rows @ self.vectors) * share) @ self.vectors.T)

    def undone(self, rows: FloatArray) -> FloatArray:
        """The residuals that `applied` gave these of. (..., r)"""
        share = np.sqrt(1.0 + self.sizes**2) - 1.0
        return np.asarray(rows + ((rows @ self.vectors) * share) @ self.vectors.T)


def robust_cost(white: FloatArray) -> FloatArray:
    """Huber's (1964, 10.1214/aoms/1177703732) cost of whitened residuals, their square where they are small."""
    off = np.abs(white)
    return np.where(off < HUBER, off**2, HUBER * (2.0 * off - HUBER))


def cost_of(drive: FloatArray, prior: FloatArray) -> FloatArray:
    """-2 ln of likelihood times prior of whitened residuals (points, r), (points, p), up to a constant. (points,)"""
    return np.asarray(robust_cost(drive).sum(axis=1) + (prior**2).sum(axis=1))


@dataclass(frozen=True, eq=False)
class DriveResiduals:
    """Simulated drives beside a measured one.

    Attributes
    ----------
    rover, terrain, plan, record, belief : as in `assimilate`.
    inflation : by quantity, or for `position`, what its errors are multiplied by, 1 where it is not named. [-]
    bias : errors that stay the same throughout a drive.
    expected : states without their noise, as of the best soil so far; None takes the measured ones. (n, 6)
    floor : multiple of `MODEL_ERRORS` that is added to the measured errors, above 0. [-]
    ruts : whether simulated wheels meet the ruts of those before them.

    Raises ParameterError for a record of another rover, or with fewer values than a soil has parameters.
    """

    rover: Rover
    terrain: Terrain
    plan: Plan
    record: DriveRecord
    belief: SoilBelief
    inflation: Mapping[str, float] = field(default_factory=dict)
    bias: DriveBias = field(default_factory=DriveBias)
    floor: float = 1.0
    expected: FloatArray | None = field(default=None, repr=False)
    ruts: bool = False

    def __post_init__(self) -> None:
        check_wheels(self.record, self.rover.wheels, self.rover.name)
        check_clock(self.record, self.schedule.duration_s, self.spacing_s)
        if (values := int(self.counted.sum()) + self.record.fix_m.size) < len(PARAMETERS):
            raise ParameterError(
                f"{values} values can be compared with a drive of the plan, fewer than a soil has parameters, "
                f"{len(PARAMETERS)}; are there states under way, and in time?"
            )

    @cached_property
    def schedule(self) -> Schedule:
        """When the rover was to be where."""
        return make_schedule(self.plan, self.rover)

    @property
    def spacing_s(self) -> float:
        """Time between samples of a simulated drive, at most. [s]"""
        return SAMPLE_M / self.plan.speed_m_s

    @cached_property
    def wheel(self) -> IntArray:
        """Number of the wheel of each state. (n,)"""
        return wheel_numbers(self.record, self.rover.wheels)

    @cached_property
    def counted(self) -> BoolArray:
        """Values that count: measured, under way, and from the second sample on. (n, 6)

        States between two samples are interpolated, and at the first one the simulated rover has not found its speed.
        """
        time, spacing, end = self.record.time_s, self.spacing_s, self.schedule.duration_s
        about = np.stack([time - spacing, time, time + spacing]).clip(spacing, end)
        moving = (self.schedule.pace_at(about) >= UNDER_WAY).all(axis=0) & (time > spacing) & (time <= end)
        return np.asarray(np.isfinite(self.record.values) & moving[:, None], dtype=np.bool_)

    @cached_property
    def sigma(self) -> FloatArray:
        """Their errors, 1 elsewhere. (n, 6)"""
        floor = self.floor * np.array([MODEL_ERRORS[name] for name in OBSERVED])
        factor = np.array([self.inflation.get(name, 1.0) for name in OBSERVED])
        return np.where(self.counted, factor * np.hypot(self.record.sigmas, floor), 1.0)

    @cached_property
    def whitening(self) -> FloatArray:
        """Matrix that makes the errors of all positions independent unit ones. (2 f, 2 f) [1/m]"""
        covariance = self.record.fix_joint_m2 + (self.floor * FIX_ERROR_M) ** 2 * np.eye(self.record.fix_m.size)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)) / self.inflation.get(POSITION, 1.0))

    @cached_property
    def marginalised(self) -> MarginalisedBias:
        """What whitens the errors that stay the same throughout the drive."""
        values = np.where(self.counted, self.record.values, np.nan)
        way = self.record.fix_m - (self.plan.x_m, self.plan.y_m)
        expected = values if self.expected is None else self.expected
        return self.bias.marginalised(values, self.sigma, self.wheel, way, self.whitening, expected, self.turned)

    @property
    def ln_errors(self) -> float:
        """Half of ln of the determinant of the covariance of all errors, which a likelihood is divided by."""
        _, whitened = np.linalg.slogdet(self.whitening)
        biases = 0.5 * np.log1p(self.marginalised.sizes**2).sum()
        return float(np.log(self.sigma[self.counted]).sum() - whitened + biases)

    @cached_property
    def turned(self) -> FloatArray | None:
        """How far each position moves for a share of 1 of what spot turns are exposed to. (f, 2) [m]

        They are exposed as on the soil of the belief's mean. None without turns.
        """
        if not any(leg.turn_deg for leg in self.plan.legs) or not self.record.fix_m.size:
            return None
        drive = self.simulated(self.belief.mean[None])
        share = float(exposed_turns(drive.planned, drive.paths[0, :, 5]))
        distance = self.schedule.distance_at(self.record.fix_time_s)
        levers = (turn_lever(self.plan, *pair) for pair in zip(distance, self.record.fix_m, strict=True))
        return share * np.array(list(levers))

    def simulated(self, transforms: FloatArray) -> Prediction:
        """Drives on soils, and wheels, of these transforms. (points, p)"""
        drive, samples = (self.rover, self.terrain, self.plan), self.belief.samples(transforms)
        return predict(*drive, samples=samples, time_step_s=STEP_S, sample_m=SAMPLE_M, ruts=self.ruts)

    @cached_property
    def within(self) -> tuple[FloatArray, FloatArray]:
        """Centres of the first laws, and how far from them soils are tried. (p,), (p,)"""
        center, width = np.array([(law.center, law.width) for law in self.belief.laws.values()]).T
        return center, HUBER * width

    def near(self, transforms: FloatArray) -> BoolArray:
        """Soils that are no farther from the first laws than `HUBER`. (points,)"""
        center, reach = self.within
        with np.errstate(invalid="ignore"):
            return np.asarray((np.abs(transforms - center) < reach).all(axis=1))

    def residuals(self, transforms: FloatArray) -> FloatArray:
        """Whitened residuals, simulated less measured, of states, then of positions. (points, r)

        What `bias` lets be the same throughout a drive is marginalised. Infinite for soils that are too far from the
        first laws, and drives that do not arrive.
        """
        rows = np.full((len(transforms), self.record.values.size + self.record.fix_m.size), np.inf)
        near = self.near(transforms)
        if near.any():
            rows[near] = self._of(self.simulated(transforms[near]))
        return rows

    def states_at(self, transforms: FloatArray) -> FloatArray:
        """Simulated states of one soil at the times of the measured ones. (n, 6)"""
        return np.asarray(self._states(self.simulated(transforms[None]))[0])

    def states_as_measured(self, residual: FloatArray) -> FloatArray:
        """Residuals of states over their errors, with nothing marginalised, from those of `residuals` (r,). (n, 6)"""
        return self.parts(self.marginalised.undone(residual))[0]

    def parts(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (r,) of states (n, 6), and of positions (2 f,), x and y in turn."""
        size = self.record.values.size
        return residual[:size].reshape(self.record.values.shape), residual[size:]

    def _of(self, drives: Prediction) -> FloatArray:
        """`residuals` of simulated drives. (members, r)"""
        record, count = self.record, len(drives.outcome)
        states = np.where(self.counted, (self._states(drives) - np.nan_to_num(record.values)) / self.sigma, 0.0)
        places = at_times(record.fix_time_s, drives.time_s, drives.paths[..., :2], axis=-2)
        white = (places - record.fix_m).reshape(count, -1) @ self.whitening.T
        rows = self.marginalised.applied(np.concatenate([states.reshape(count, -1), white], axis=1))
        rows[~drives.finished] = np.inf
        return rows

    def _states(self, drives: Prediction) -> FloatArray:
        """Simulated states at the times of the measured ones. (members, n, 6)"""
        return states_at(self.record, drives.time_s, drives.states, self.rover.wheels)
