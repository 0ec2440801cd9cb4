"""Wheel loads along a prescribed motion: the rover is held where it was, and its wheels carry it there.

What they do not supply of force and moment is the residual wrench; the contact Jacobian says what one newton of each
wheel's forces adds to the net wrench. Both are of three totals: force ahead, force to the left, and moment about the
vertical. `held` names the loads of a rover that is held to the measured motion.

Wheel forces along a measured motion, with their uncertainty: soils and motions are drawn, and the totals balanced.

A soil has to be assumed: it says what a wheel with this slip pulls. What all wheels pull together needs no soil, since
they have to carry the rover against weight and slope. So forces are computed on many soils and motions, and their joint
law, taken as normal, is conditioned on the force and the moment that are missing being none (a Kalman update). The
totals are then known well; how they share out among the wheels remains the assumed soil's.

`alternate` finds loads and soil in turn: loads on the believed soil, the soil from measured states and these loads, and
so on. Forces that came from a soil cannot prove it. What is new is measured: sinkage under the load of each wheel, and
slip against what all wheels together have to pull. Only these two are used: the loads, and the totals of drawbar pulls
and lateral forces, which the balance tells nearly without the soil; not how the totals share out among the wheels.
Every round begins with the same belief, never with the last round's, so nothing is counted twice.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, IntArray, at_times
from lunarsci.compiled import each_in_threads
from lunarsci.errors import ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.ranges import CHANCE, check_range
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.inference.totals import BalancedStates, TotalsPosterior, infer_from_totals
from lunarsci.regolith.states import COLUMNS, read_state_table
from lunarsci.twin.ground.terrain import OVERRIDES, Terrain, soil_overrides
from lunarsci.twin.lanes import BODY, DIVERGED, FINISHED, GROUP, SANK, UNSETTLED, WHEEL, new_work, outcome_texts
from lunarsci.twin.plans.motion import CORRELATION_M, Motion, correlation_of, drawn_motions
from lunarsci.twin.plans.path import CREEP_M_S
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import HELD, shear_center
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.simulation.members import record, take_commands
from lunarsci.twin.simulation.settle import balance, settle, tread

if TYPE_CHECKING:
    import pandas as pd

FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")
"""Forces of a wheel, in the order of all arrays here."""
LARGEST_RESIDUAL = 0.05
"""Share of the weight: a residual beyond it says that the soil or the motion is not as given; assumed."""
FORCE_COLUMNS = [STATE_COLUMNS.index(name) for name in FORCES]
"""Places of `FORCES` in `STATE_COLUMNS`."""
MEASURED = ("sinkage_m", "slip_ratio", "side_slip_deg")
"""Columns of measured states that the soil may be learned from."""
DRAWS, FEWEST_DRAWS = 64, 16
"""Soils and motions on which forces are computed, by default and at least; assumed."""
BALANCE_ERROR = 0.005
"""Standard error of the balance as a share of the weight, for a slope that is off by 0.3 deg, and inertia; assumed."""
TOTALS = ("ahead", "left", "moment")
"""Of the forces of all wheels, in the order of all arrays here. [N, N, N m]"""
SOIL_STILL, FORCES_STILL = 0.1, 0.01
"""Largest move of the soil's mean, in what remains of its standard deviations, and of pulls and lateral forces as a
share of themselves, in a round that has converged; assumed."""
OPPOSITE, NOT_SMALLER = -0.5, 0.8
"""Cosine between two moves of the soil below which the second goes back, and the share of the first that it has at
least where the rounds do not calm down: after such moves more rounds end no nearer; assumed."""
MOST_ROUNDS, WORST_REDUCED = 50, 1.5
"""Rounds, and reduced chi-square of the states beyond which no soil explains them; assumed."""
ALIKE = math.sqrt(2.0 * math.pi)
"""Correlation lengths over which errors count as one: the integral of exp(-d^2 / 2)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PrescribedLoads:
    """What the wheels do along a given motion.

    Attributes
    ----------
    rover, terrain, motion : what it was computed from; n is the number of the motion's poses.
    paths : poses as the ground puts them, columns `PATH_COLUMNS`. (n, 6)
    states : columns `STATE_COLUMNS`. (n, wheels, 10)
    residual_n : force ahead and to the left that the wheels do not supply: what would have to hold the rover to its
        motion, were the ground as it is modelled. (n, 2) [N]
    residual_nm : the same as a moment about the vertical. (n,) [N m]
    outcome : index into `OUTCOMES`; where it is not 0 the row's forces are no numbers. (n,)
    axes : forward, left and normal axis of each wheel's contact. (n, wheels, 3, 3)
    arms : from the rover's origin to the wheels' centres. (n, wheels, 3) [m]
    """

    rover: Rover
    terrain: Terrain
    motion: Motion
    paths: FloatArray
    states: FloatArray
    residual_n: FloatArray
    residual_nm: FloatArray
    outcome: IntArray
    axes: FloatArray
    arms: FloatArray

    @property
    def with_forces(self) -> BoolArray:
        """Poses with forces: in equilibrium, and neither at a halt nor beside a halt or gap. (n,)"""
        return np.asarray((self.outcome == FINISHED) & ~self.motion.no_speed)

    @property
    def doubt(self) -> str:
        """Why the forces are not to be trusted; empty where they may be."""
        if failed := outcome_texts(self.outcome):
            return f"poses without equilibrium: {'; '.join(failed)}"
        if not self.residual_share > LARGEST_RESIDUAL:
            return ""
        return (
            f"the wheels' forces leave {100 * self.residual_share:.0f} % of the weight unexplained: the soil, the "
            "terrain or the motion is not as given"
        )

    @property
    def residual_share(self) -> float:
        """Root mean square of the residual force, as a share of the rover's weight; NaN without forces. [-]"""
        weight = self.rover.mass_kg * self.rover.gravity_m_s2
        rows = self.with_forces
        return float(np.sqrt((self.residual_n[rows] ** 2).sum(axis=1).mean()) / weight) if rows.any() else np.nan


def prescribed_loads(rover: Rover, terrain: Terrain, motion: Motion, soil: FloatArray | None = None) -> PrescribedLoads:
    """Sinkage, slip and forces of every wheel at each pose of a motion.

    At each pose the rover first rests on the ground; differences between poses give its velocity; then height, attitude
    and joints take their equilibrium under weight and wheel forces while x, y and yaw are held. The loads follow from
    the levers of the suspension, sinkages from the loads, slip from the motion. The inertia of speeding up is left out:
    at 0.05 m/s it is below a thousandth of the weight. `soil` takes the place of the terrain's at every node, a row of
    `soil_overrides`. (12,)

    Raises ParameterError where the motion has commands for another number of wheels.
    """
    count, wheels = len(motion.time_s), len(rover.wheels)
    if motion.speed_m_s.shape != (count, wheels) or motion.steering_deg.shape != (count, wheels):
        raise ParameterError(f"the motion's commands have shape {motion.speed_m_s.shape}; {(count, wheels)} is wanted")
    override = np.full((GROUP, len(OVERRIDES)), np.nan) if soil is None else np.tile(soil, (GROUP, 1))
    scene = (rover.vector(), rover.wheel.vector(), terrain.grid(), override)
    # Poses of the ten coordinates of `dynamics`, and nine velocities; `left` is what holds the rover, in x, y and yaw.
    poses, velocities = np.full((count, 10), np.nan), np.zeros((count, 9))
    paths, states, left = np.zeros((count, 6)), np.zeros((count, wheels, 10)), np.zeros((count, 3))
    outcome, frames = np.zeros(count, dtype=np.int64), np.zeros((count, wheels, 12))
    groups = [np.minimum(np.arange(k, k + GROUP), count - 1) for k in range(0, count, GROUP)]
    works = [new_work(wheels) for _ in groups]

    def rest(number: int) -> None:
        lanes, work = groups[number], works[number]
        _place(scene, motion, lanes, work)
        outcome[lanes] = work.code
        pose = np.concatenate([BODY.view(work.body, name) for name in ("position", "quaternion", "joints")])
        poses[lanes] = np.where(work.code == FINISHED, pose, np.nan).T

    def carry(number: int) -> None:
        lanes, work = groups[number], works[number]
        share = np.zeros((GROUP, 3))
        balance(*scene, HELD, velocities[lanes], share, work)
        outcome[lanes], left[lanes] = np.maximum(outcome[lanes], work.code), share
        seen = [WHEEL.view(work.wheels, name) for name in ("forward", "across", "upward", "arm")]
        frames[lanes] = np.concatenate(seen, axis=1).transpose(2, 0, 1)
        for lane, row in enumerate(lanes):
            record(work, lane, scene[1], paths[row], states[row])

    each_in_threads(rest, len(groups))
    moving = _velocities(motion.time_s, poses)
    alone = ~np.isfinite(moving).all(axis=1)
    beside = np.maximum(np.append(outcome[1:], FINISHED), np.append(FINISHED, outcome[:-1]))
    outcome[:] = np.where(alone & (outcome == FINISHED), beside, outcome)
    velocities[~alone] = moving[~alone]
    each_in_threads(carry, len(groups))
    return _results(rover, terrain, motion, (paths, states, left, frames), outcome)


def _place(scene: tuple[Any, Any, Any, Any], motion: Motion, lanes: IntArray, work: Any) -> None:
    """Let a group of rovers rest on the ground, each at one pose of the motion.

    `scene` is `Rover.vector()`, `Wheel.vector()`, `Terrain.grid()` and overrides (GROUP, 12); `lanes` the number of the
    pose of each rover (GROUP,). `work`, a `Work`, takes the poses and outcomes.
    """
    start = np.column_stack([motion.x_m, motion.y_m, np.radians(motion.yaw_deg)])[lanes]
    speed = np.where(motion.speed_m_s == 0, CREEP_M_S, motion.speed_m_s)
    tread(scene[1], scene[3], work)
    take_commands(work, np.radians(motion.steering_deg[lanes])[:, None], speed[lanes][:, None], 0)
    settle(*scene, start, work)


def _velocities(time_s: FloatArray, poses: FloatArray) -> FloatArray:
    """Generalised velocities by differences of poses (n, 10), NaN at and beside poses that are NaN. (n, 9)

    Coordinates as in `lunarsci.twin.simulation.dynamics`.
    """
    given: Any = np.isfinite(poses).all(axis=1)
    turned = Rotation.from_quat(np.where(given[:, None], poses[:, [4, 5, 6, 3]], [0.0, 0.0, 0.0, 1.0]))
    steps = np.diff(time_s)[:, None]
    spins = (turned[1:] * turned[:-1].inv()).as_rotvec() / steps
    # Weighed as `np.gradient` does: the nearer step counts the more.
    inner = (steps[:-1] * spins[1:] + steps[1:] * spins[:-1]) / (steps[1:] + steps[:-1])
    spin = np.concatenate([spins[:1], inner, spins[-1:]])
    rates = np.gradient(poses, time_s, axis=0)
    return np.column_stack([rates[:, :3], spin, rates[:, 7:]])


def _results(
    rover: Rover,
    terrain: Terrain,
    motion: Motion,
    result: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    outcome: IntArray,
) -> PrescribedLoads:
    """Angles in degrees, forces ahead and to the left, and no numbers where there was no equilibrium or no speed.

    `result` is paths (n, 6), states (n, wheels, 10), what holds the rover in x, y and yaw (n, 3) [N, N, N m], and axes
    and arms of the contacts (n, wheels, 12); it is changed in place, and so is `outcome` (n,).
    """
    # What a speed that is not known leads to says nothing of the ground.
    outcome[motion.no_speed & np.isin(outcome, (DIVERGED, SANK, UNSETTLED))] = FINISHED
    for part in result:
        part[(outcome != FINISHED) | motion.no_speed] = np.nan
    paths, states, left, frames = result
    paths[:, 3:5], states[..., 4] = np.degrees(paths[:, 3:5]), np.degrees(states[..., 4])
    paths[:, 5] = motion.yaw_deg
    yaw = np.radians(motion.yaw_deg)
    ahead = np.cos(yaw) * left[:, 0] + np.sin(yaw) * left[:, 1]
    aside = np.cos(yaw) * left[:, 1] - np.sin(yaw) * left[:, 0]
    return PrescribedLoads(
        rover=rover,
        terrain=terrain,
        motion=motion,
        paths=paths,
        states=states,
        residual_n=np.column_stack([ahead, aside]),
        residual_nm=left[:, 2],
        outcome=outcome,
        axes=frames[..., :9].reshape(*frames.shape[:2], 3, 3),
        arms=frames[..., 9:],
    )


def contact_jacobian(result: PrescribedLoads) -> FloatArray:
    """What one newton of each wheel's forces adds to the totals. (n, 3 totals, wheels, 3 forces) [-, -, m]

    The forces act along the normal, ahead along and sideways against the contact axes at the wheel's centre; the
    lateral one where the shear stress is centred.
    """
    ahead, below = _shear_centers(result)
    e, d, n = (result.axes[:, :, k] for k in range(3))  # forward, left, normal: (poses, wheels, xyz)
    along = np.stack([n, e, -d], axis=2)  # (poses, wheels, forces, xyz)
    turn = np.cross(result.arms[:, :, None], along)[..., 2]
    turn[..., 2] += -below * e[..., 2] - ahead * n[..., 2]
    yaw = np.radians(result.motion.yaw_deg)[:, None, None]
    forward = np.cos(yaw) * along[..., 0] + np.sin(yaw) * along[..., 1]
    left = np.cos(yaw) * along[..., 1] - np.sin(yaw) * along[..., 0]
    return np.stack([forward, left, turn], axis=1)


def residual_wrench(result: PrescribedLoads) -> FloatArray:
    """What the wheels do not supply of the totals. (n, 3) [N, N, N m]"""
    return np.column_stack([result.residual_n, result.residual_nm])


def net_wrench(result: PrescribedLoads, levers: FloatArray) -> FloatArray:
    """What drawbar pulls and lateral forces have to add up to for the motion. (n, 3) [N, N, N m]

    `levers` are those of `contact_jacobian`. (n, 3, wheels, 3)

    Weight and slope are in the normal forces; these follow from the levers of the suspension and hardly from the soil.
    """
    forces = result.states[..., FORCE_COLUMNS][..., 1:]
    return np.asarray(np.einsum("ntwf,nwf->nt", levers[..., 1:], forces) + residual_wrench(result))


def _shear_centers(result: PrescribedLoads) -> tuple[FloatArray, FloatArray]:
    """How far ahead of and below each wheel's axle the shear stress is centred. (n, wheels) [m]"""
    sinkage, slip = (result.states[..., STATE_COLUMNS.index(name)] for name in ("sinkage_m", "slip_ratio"))
    ahead, below = shear_center(sinkage, slip, result.rover.wheel.vector())
    return ahead, below


@dataclass(frozen=True, slots=True, eq=False)
class PoseStates:
    """Measured states.

    Attributes
    ----------
    table : as read, a row for each state.
    time_s, wheel : of each row; the wheel by its place in the rover. (r,)
    values, sigmas : columns `MEASURED`, NaN where not measured. (r, 3) [m, -, deg]
    valid : rows not marked otherwise. (r,)
    """

    table: "pd.DataFrame"
    time_s: FloatArray
    wheel: IntArray
    values: FloatArray
    sigmas: FloatArray
    valid: BoolArray

    def by_pose(self, wheels: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times (p,), values and sigmas (p, wheels, 3) of all states that are valid; NaN where there is none."""
        times, place = np.unique(self.time_s, return_inverse=True)
        result = np.full((2, len(times), wheels, 3), np.nan)
        rows = np.flatnonzero(self.valid)
        result[0, place[rows], self.wheel[rows]] = self.values[rows]
        result[1, place[rows], self.wheel[rows]] = self.sigmas[rows]
        return times, result[0], result[1]


def read_pose_states(source: InputFile, rover: Rover) -> PoseStates:
    """Read states from CSV: `time_s`, `wheel`, any of `MEASURED` with `NAME_sigma`, `valid`; others are only kept.

    Where no sigma is given it is that of `MeasurementErrors`. Raises DataError.
    """
    result = read_state_table(source, rover.wheel, measured=MEASURED, wheels=rover.wheels, rover=rover.name)
    wheel = np.array([rover.wheels.index(name) for name in result.wheels], dtype=np.int64)
    columns = [COLUMNS.index(name) for name in MEASURED]
    time = result.numbers("time_s")
    return PoseStates(result.table, time, wheel, result.values[:, columns], result.sigmas[:, columns], result.valid)


def correlation_length(motion: Motion, states: PoseStates | None) -> tuple[float, str]:
    """Distance over which the motion's errors stay alike [m], and what it rests on: `slip errors`, or `assumed`."""
    if states is None:
        return CORRELATION_M, "assumed"
    shown = states.valid & np.isin(states.time_s, motion.time_s[~motion.no_speed])
    result = correlation_of(motion, states.values[shown, 1], states.sigmas[shown, 1])
    return (CORRELATION_M, "assumed") if result is None else (result, "slip errors")


@dataclass(frozen=True, slots=True)
class Shares:
    """Where the variance of a force comes from, over all wheels and poses: four shares that add up to 1.

    Attributes
    ----------
    soil, motion : what each brings alone. [-]
    balance : what the error of the totals brings. [-]
    together : what soil and motion bring only jointly, and sampling error; it may be below 0. [-]
    of_force : standard deviation that the soil brings, as a share of the force itself (root mean squares). [-]
    """

    soil: float
    motion: float
    balance: float
    together: float
    of_force: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadEnsemble:
    """Forces of all wheels at all poses, columns `FORCES`, before and after the balance of totals.

    Attributes
    ----------
    held : loads of the rover held to the measured motion itself, on the middle one of the soils.
    with_forces : poses with forces; at others the arrays below have no numbers, but `carried`. (n,)
    before, after : mean. (n, wheels, 3) [N]
    before_parts, after_parts : variances: soil alone, motion alone, balance, together. (4, n, wheels, 3) [N^2]
    residual_before, residual_after : mean of what the wheels do not supply of `TOTALS`. (n, 3) [N, N, N m]
    total_before, total_after : standard deviations of what all wheels supply of `TOTALS`. (n, 3) [N, N, N m]
    carried : share of the draws with an equilibrium, at each pose. (n,)
    surprise : chi-square of the residual before, for each of its three values, against the draws. (n,) [-]
    correlation_m : of the motion's errors. [m]
    """

    held: PrescribedLoads
    with_forces: BoolArray
    before: FloatArray
    after: FloatArray
    before_parts: FloatArray
    after_parts: FloatArray
    residual_before: FloatArray
    residual_after: FloatArray
    total_before: FloatArray
    total_after: FloatArray
    carried: FloatArray
    surprise: FloatArray
    correlation_m: float

    @property
    def doubt(self) -> str:
        """Why there are no forces, or none at some poses; empty where there are."""
        if failed := outcome_texts(self.held.outcome):
            return f"poses without equilibrium: {'; '.join(failed)}"
        if not self.with_forces.any():
            return "no pose has forces: all are at halts, or too few of the drawn soils carry the rover"
        return ""

    @property
    def doubt_of_soils(self) -> str:
        """Why the drawn soils are not those of the motion; empty where they may be. Needs poses with forces."""
        surprise = float(np.median(self.surprise[self.with_forces]))
        if surprise <= chdtri(len(TOTALS), SIGNIFICANCE) / len(TOTALS):
            return ""
        return (
            f"what the wheels do not supply is beyond the drawn soils (reduced chi-square {surprise:.1f}): the soil, "
            "the terrain or the motion is not as given"
        )

    @property
    def before_sigma(self) -> FloatArray:
        """Standard deviation before the balance. (n, wheels, 3) [N]"""
        return np.asarray(np.sqrt(np.maximum(self.before_parts.sum(axis=0), 0.0)))

    @property
    def after_sigma(self) -> FloatArray:
        """Standard deviation after the balance. (n, wheels, 3) [N]"""
        return np.asarray(np.sqrt(np.maximum(self.after_parts.sum(axis=0), 0.0)))

    def shares(self, force: int, *, balanced: bool) -> Shares:
        """Of one force, by its place in `FORCES`."""
        parts = (self.after_parts if balanced else self.before_parts)[..., force][:, self.with_forces].mean(axis=(1, 2))
        size = np.mean((self.after if balanced else self.before)[..., force][self.with_forces] ** 2)
        whole = max(float(parts.sum()), 1e-30)
        soil, motion, balance, together = (float(part) / whole for part in parts)
        return Shares(soil, motion, balance, together, float(np.sqrt(parts[0] / max(size, 1e-30))))


@dataclass(frozen=True, slots=True)
class _Drawn:
    """What was computed of some draws of soil, or motion, or both.

    Attributes
    ----------
    forces : columns `FORCES`. (draws, n, wheels, 3) [N]
    residual : what the wheels do not supply of `TOTALS`. (draws, n, 3) [N, N, N m]
    carried : poses with forces. (draws, n)
    """

    forces: FloatArray
    residual: FloatArray
    carried: BoolArray


def draw_loads(
    rover: Rover,
    terrain: Terrain,
    motion: Motion,
    soils: Mapping[str, FloatArray],
    middle: Mapping[str, float],
    *,
    correlation_m: float,
    balance_error: float = BALANCE_ERROR,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> LoadEnsemble:
    """Forces along a motion whose errors, and whose soil, are known by draws.

    Parameters
    ----------
    rover, terrain, motion : what was driven where; the motion's `sigmas` are its errors.
    soils : every parameter of `Soil` to one value for each draw, 16 or more. They replace those of the terrain.
    middle : the soil in their middle.
    correlation_m : distance over which the motion's errors stay alike, above 0. [m]
    balance_error : standard error of the totals as a share of the weight, above 0; of the moment with the rover's reach
        as the lever. [-]
    seed : of the drawn motions.
    progress : called with (done, total).

    Raises ParameterError for fewer draws, or an error of 0.

    References
    ----------
    Kalman (1960), J. Basic Eng. 82, 35, 10.1115/1.3662552; by draws: Evensen (2003), Ocean Dynamics 53, 343,
    10.1007/s10236-003-0036-9.
    """
    rows = soil_overrides(soils, len(next(iter(soils.values()))))
    check_range("draws", len(rows), f"[{FEWEST_DRAWS}, inf)")
    check_range("balance_error", balance_error, CHANCE)
    center = soil_overrides({name: np.array([value]) for name, value in middle.items()}, 1)[0]
    motions = list(drawn_motions(motion, len(rows), correlation_m, np.random.default_rng(seed)))
    still, same = [motion] * len(rows), np.tile(center, (len(rows), 1))
    pairs = [(motions, rows), (still, rows), (motions, same)] if motion.sigmas is not None else [(still, rows)]
    counted, total = iter(range(1, len(pairs) * len(rows) + 1)), len(pairs) * len(rows)

    def report() -> None:
        if progress is not None:
            progress(next(counted), total)

    drawn = [_along(rover, terrain, each, on, report) for each, on in pairs]
    held = prescribed_loads(rover, terrain, motion, center)
    reach = float(np.hypot(*rover.wheel_positions_m[:, :2].T).max())
    error = balance_error * rover.mass_kg * rover.gravity_m_s2 * np.array([1.0, 1.0, reach])
    return _balanced(held, drawn, error, correlation_m)


def _along(
    rover: Rover, terrain: Terrain, motions: list[Motion], rows: FloatArray, report: Callable[[], None]
) -> _Drawn:
    """Loads along each of some motions, on the soil in the same place of `rows` (draws, 12), of `soil_overrides`."""
    forces, residual, carried = [], [], []
    for motion, row in zip(motions, rows, strict=True):
        result = prescribed_loads(rover, terrain, motion, row)
        forces.append(result.states[..., FORCE_COLUMNS])
        residual.append(residual_wrench(result))
        carried.append(result.with_forces)
        report()
    return _Drawn(np.array(forces), np.array(residual), np.array(carried))


def _balanced(held: PrescribedLoads, drawn: list[_Drawn], error: FloatArray, correlation_m: float) -> LoadEnsemble:
    """Condition the forces on the balance of the totals, pose by pose.

    `drawn` is with soil and motion both drawn, then with the soil alone and the motion alone; only the first where the
    motion has no errors. `error` is that of the totals. (3,) [N, N, N m]
    """
    count, wheels = held.states.shape[:2]
    shape = (count, wheels, 3)
    # As the fields of `LoadEnsemble`, before the balance and after it: gap and left are residuals, total and rest
    # standard deviations of the totals.
    before, after = np.full(shape, np.nan), np.full(shape, np.nan)
    parts, used_parts = np.full((4, *shape), np.nan), np.full((4, *shape), np.nan)
    gap, left = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    total, rest, surprise = np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan)
    carried = np.all([part.carried for part in drawn], axis=0)
    levers = contact_jacobian(held)
    with_forces = held.with_forces & (np.median(carried, axis=0) > 0)
    for k in np.flatnonzero(with_forces):
        per_draw = [(part.forces[carried[:, k], k], part.residual[carried[:, k], k]) for part in drawn]
        flat = per_draw[0][0].reshape(len(per_draw[0][0]), -1)
        gain = _gain(flat, per_draw[0][1], error)
        moved = [
            (forces.reshape(len(flat), -1) - residual @ gain.T).reshape(forces.shape) for forces, residual in per_draw
        ]
        noise = ((gain * error) ** 2).sum(axis=1).reshape(wheels, 3)
        before[k], after[k] = per_draw[0][0].mean(axis=0), moved[0].mean(axis=0)
        parts[:, k] = _parts([forces for forces, _ in per_draw], np.zeros((wheels, 3)))
        # The gain was fitted to these draws: three numbers of their freedom are gone.
        used_parts[:, k] = _parts(moved, noise, (len(flat) - 1) / (len(flat) - 4))
        # What is missing shrinks by as much as the forces of all wheels grow.
        sums = np.einsum("twf,wfk->tk", levers[k], gain.reshape(wheels, 3, 3))
        gap[k] = per_draw[0][1].mean(axis=0)
        left[k] = gap[k] + sums @ gap[k]
        surprise[k] = gap[k] @ np.linalg.solve(np.cov(per_draw[0][1].T) + np.diag(error**2), gap[k]) / len(error)
        total[k] = np.einsum("twf,dwf->dt", levers[k], per_draw[0][0]).std(axis=0, ddof=1)
        spread = np.einsum("twf,dwf->dt", levers[k], moved[0]).var(axis=0, ddof=1)
        rest[k] = np.sqrt(spread + ((sums * error) ** 2).sum(axis=1))
    return LoadEnsemble(
        held=held,
        with_forces=with_forces,
        before=before,
        after=after,
        before_parts=parts,
        after_parts=used_parts,
        residual_before=gap,
        residual_after=left,
        total_before=total,
        total_after=rest,
        carried=carried.mean(axis=0),
        surprise=surprise,
        correlation_m=correlation_m,
    )


def _gain(forces: FloatArray, residual: FloatArray, error: FloatArray) -> FloatArray:
    """Kalman gain: how the forces follow the residual, by their covariance over that of the residual and its error.

    Of d draws of f forces (d, f), their residuals (d, 3), and the error of the totals (3,). (f, 3) [-, -, 1/m]
    """
    off, lacking = forces - forces.mean(axis=0), residual - residual.mean(axis=0)
    count = len(forces) - 1
    return np.asarray(np.linalg.solve(lacking.T @ lacking / count + np.diag(error**2), lacking.T @ off / count).T)


def _parts(forces: list[FloatArray], noise: FloatArray, fitted: float = 1.0) -> FloatArray:
    """Variances by soil, by motion, by the balance and together, as `LoadEnsemble` has them. (4, wheels, 3) [N^2]

    `forces` are of the draws of `_balanced`, at one pose. (draws, wheels, 3) each
    """
    whole = fitted * forces[0].var(axis=0, ddof=1)
    soil, motion = (part.var(axis=0, ddof=1) for part in forces[1:]) if len(forces) == 3 else (whole, 0 * whole)
    return np.stack([soil, motion, noise, whole - soil - motion])


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """What one round of `alternate` changed.

    Attributes
    ----------
    soil : largest entry of `step`, as in `SOIL_STILL`. [-]
    forces : move of pulls and lateral forces as a share of themselves, as in `FORCES_STILL`. [-]
    step : move of the soil's mean, by parameter, in the standard deviations that remain. (8,) [-]
    sd_ratio : by parameter, what remains of the standard deviations before any drive. [-]
    reduced_sinkages, reduced_totals : reduced chi-squares of the sinkages and of the totals. [-]
    """

    soil: float
    forces: float
    step: FloatArray
    sd_ratio: dict[str, float]
    reduced_sinkages: float
    reduced_totals: float


@dataclass(frozen=True, slots=True, eq=False)
class AlternatingEstimate:
    """What `alternate` arrives at.

    Attributes
    ----------
    posterior : the soil after the last round.
    forces : loads on that soil.
    rounds : what each round changed, the first one first.
    verdict : see `verdict_of`.
    """

    posterior: TotalsPosterior
    forces: LoadEnsemble
    rounds: tuple[Round, ...]
    verdict: str

    @property
    def converged(self) -> bool:
        """Whether the last round changed next to nothing."""
        return self.verdict == "converged"

    @property
    def doubt(self) -> str:
        """Why the soil is not to be trusted; empty where it may be."""
        if not self.converged:
            rounds = len(self.rounds)
            return f"forces and soil: {self.verdict} within {rounds} rounds; give more, or look at the states"
        if (worst := max(self.posterior.reduced)) <= WORST_REDUCED:
            return ""
        return f"no soil explains the states (reduced chi-square {worst:.1f}); look at their errors and at the terrain"


def alternate(
    rover: Rover,
    terrain: Terrain,
    motion: Motion,
    states: PoseStates,
    belief: SoilBelief,
    *,
    rounds: int,
    draws: int = DRAWS,
    correlation_m: float,
    balance_error: float = BALANCE_ERROR,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> AlternatingEstimate:
    """Forces and soil in turn, until a round changes next to nothing.

    Parameters
    ----------
    rover, terrain, motion, correlation_m, balance_error : as in `draw_loads`.
    states : measured states; sinkage and slip ratio are needed.
    belief : what is held of the soil before this drive, every round's beginning.
    rounds : at most, 1 to 50.
    draws : soils and motions on which the forces of each round are computed.
    seed : of these; the same in each round, so that rounds differ by their soils alone.
    progress : called with (done, total).

    Raises ParameterError for rounds out of range, and states without anything to learn from.
    """
    check_range("rounds", rounds, f"[1, {MOST_ROUNDS}]")

    def forces_on(soil: SoilBelief, number: int) -> LoadEnsemble:
        return draw_loads(
            rover,
            terrain,
            motion,
            soil.draws(draws, seed),
            {name: middle for name, (middle, _, _) in soil.intervals().items()},
            correlation_m=correlation_m,
            balance_error=balance_error,
            seed=seed,
            progress=lambda done, total: progress(number * total + done, (rounds + 1) * total) if progress else None,
        )

    forces, before, done = forces_on(belief, 0), belief, list[Round]()
    while True:
        result = infer_from_totals(balanced_states(forces, states, balance_error), rover.wheel, belief)
        after = forces_on(result.belief, len(done) + 1)
        done.append(_round(before, result, forces, after))
        forces, before = after, result.belief
        verdict = verdict_of(done)
        if verdict == "converged" or len(done) == rounds:
            return AlternatingEstimate(result, forces, tuple(done), verdict)


def verdict_of(rounds: list[Round]) -> str:
    """`converged`, `oscillates` or `does not converge`, after some rounds."""
    last = rounds[-1]
    if last.soil < SOIL_STILL and last.forces < FORCES_STILL:
        return "converged"
    if len(rounds) > 1:
        one, two = rounds[-2].step, last.step
        size = float(np.linalg.norm(one) * np.linalg.norm(two))
        if one @ two < OPPOSITE * size and np.linalg.norm(two) > NOT_SMALLER * np.linalg.norm(one):
            return "oscillates"
    return "does not converge"


def balanced_states(forces: LoadEnsemble, states: PoseStates, balance_error: float) -> BalancedStates:
    """Measured states with the loads and totals of their times.

    Errors of the motion, and of the slope in the balance, are alike over the correlation length; the states within it
    count together as one.
    """
    held, rover = forces.held, forces.held.rover
    times, values, sigmas = states.by_pose(len(rover.wheels))
    load, load_sigma = (part[..., 0] for part in (forces.after, forces.after_sigma))
    levers = contact_jacobian(held)
    parts = (load, load_sigma, levers[..., 1:], net_wrench(held, levers))
    masked = [np.where(forces.with_forces.reshape(-1, *([1] * (part.ndim - 1))), part, np.nan) for part in parts]
    load, load_sigma, levers, totals = (at_times(times, held.motion.time_s, part, beyond=False) for part in masked)
    reach = float(np.hypot(*rover.wheel_positions_m[:, :2].T).max())
    error = balance_error * rover.mass_kg * rover.gravity_m_s2 * np.array([1.0, 1.0, reach])
    used = np.isfinite(totals).all(axis=1) & np.isfinite(values[..., :2]).any(axis=(1, 2))
    rolled = np.interp(times[used], held.motion.time_s, held.motion.rolled_m)
    poses, way = int(used.sum()), float(np.ptp(rolled)) if used.any() else 0.0
    alike = float(np.clip(ALIKE * forces.correlation_m * (poses - 1) / way, 1.0, poses)) if way > 0 else max(1.0, poses)
    return BalancedStates(
        inputs=values,
        input_sigma=sigmas,
        load=load,
        load_sigma=np.nan_to_num(load_sigma),
        levers=np.nan_to_num(levers),
        totals=totals,
        totals_sigma=np.tile(error, (len(times), 1)),
        alike=alike,
    )


def _round(before: SoilBelief, result: TotalsPosterior, one: LoadEnsemble, two: LoadEnsemble) -> Round:
    """A round from the belief `before` it, with forces `one`, to `result`, with forces `two`."""
    sd = np.sqrt(np.diag(result.belief.covariance))
    step = (result.belief.mean - before.mean) / sd
    with_forces = one.with_forces & two.with_forces
    pulls = two.after[with_forces, :, 1:]
    moved = np.sqrt(np.mean((pulls - one.after[with_forces, :, 1:]) ** 2) / np.mean(pulls**2))
    sinkages, totals = result.reduced
    return Round(float(np.abs(step).max()), float(moved), step, result.belief.sd_ratio, sinkages, totals)
