"""Wheel loads along a prescribed motion: the rover is held where it was, and its wheels carry it there.

What they do not supply of force and moment is the residual wrench; the contact Jacobian says what one newton of each
wheel's forces adds to the net wrench.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.compiled import each_in_threads
from lunarsci.errors import ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.states import COLUMNS, read_state_table
from lunarsci.twin.ground.terrain import OVERRIDES, Terrain
from lunarsci.twin.lanes import BODY, DIVERGED, FINISHED, GROUP, SANK, UNSETTLED, WHEEL, new_work, outcome_texts
from lunarsci.twin.plans.motion import CORRELATION_M, Motion, correlation_of
from lunarsci.twin.plans.path import CREEP_M_S
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import HELD, shear_center
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.simulation.members import record, take_commands
from lunarsci.twin.simulation.settle import balance, settle, tread

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PrescribedLoads:
    """What the wheels do along a given motion.

    Attributes
    ----------
    rover, terrain, motion : what it was computed from.
    paths : poses as the ground puts them, columns `PATH_COLUMNS`. (n, 6)
    states : columns `STATE_COLUMNS`. (n, wheels, 10)
    missing_n : force ahead and to the left that the wheels do not supply: what would have to hold the rover to its
        motion, were the ground as it is modelled. (n, 2) [N]
    missing_nm : the same as a moment about the vertical. (n,) [N m]
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
    def known(self) -> BoolArray:
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
        """Root mean square of the missing force, as a share of the rover's weight. [-]"""
        weight = self.rover.mass_kg * self.rover.gravity_m_s2
        known = self.known
        return float(np.sqrt((self.residual_n[known] ** 2).sum(axis=1).mean()) / weight) if known.any() else np.nan


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
    known = (rover.vector(), rover.wheel.vector(), terrain.grid(), override)
    poses, velocities = np.full((count, 10), np.nan), np.zeros((count, 9))
    paths, states, left = np.zeros((count, 6)), np.zeros((count, wheels, 10)), np.zeros((count, 3))
    outcome, frames = np.zeros(count, dtype=np.int64), np.zeros((count, wheels, 12))
    groups = [np.minimum(np.arange(k, k + GROUP), count - 1) for k in range(0, count, GROUP)]
    works = [new_work(wheels) for _ in groups]

    def rest(number: int) -> None:
        own, work = groups[number], works[number]
        _place(known, motion, own, work)
        outcome[own] = work.code
        pose = np.concatenate([BODY.view(work.body, name) for name in ("position", "quaternion", "joints")])
        poses[own] = np.where(work.code == FINISHED, pose, np.nan).T

    def carry(number: int) -> None:
        own, work = groups[number], works[number]
        share = np.zeros((GROUP, 3))
        balance(*known, HELD, velocities[own], share, work)
        outcome[own], left[own] = np.maximum(outcome[own], work.code), share
        seen = [WHEEL.view(work.wheels, name) for name in ("forward", "across", "upward", "arm")]
        frames[own] = np.concatenate(seen, axis=1).transpose(2, 0, 1)
        for lane, row in enumerate(own):
            record(work, lane, known[1], paths[row], states[row])

    each_in_threads(rest, len(groups))
    moving = _velocities(motion.time_s, poses)
    alone = ~np.isfinite(moving).all(axis=1)
    beside = np.maximum(np.append(outcome[1:], FINISHED), np.append(FINISHED, outcome[:-1]))
    outcome[:] = np.where(alone & (outcome == FINISHED), beside, outcome)
    velocities[~alone] = moving[~alone]
    each_in_threads(carry, len(groups))
    return _results(rover, terrain, motion, (paths, states, left, frames), outcome)


def _place(known: tuple[Any, Any, Any, Any], motion: Motion, own: IntArray, work: Any) -> None:
    """Let a group of rovers rest on the ground at its poses."""
    start = np.column_stack([motion.x_m, motion.y_m, np.radians(motion.yaw_deg)])[own]
    speed = np.where(motion.speed_m_s == 0, CREEP_M_S, motion.speed_m_s)
    tread(known[1], known[3], work)
    take_commands(work, np.radians(motion.steering_deg[own])[:, None], speed[own][:, None], 0)
    settle(*known, start, work)


def _velocities(time_s: FloatArray, poses: FloatArray) -> FloatArray:
    """Generalised velocities by differences of the poses, NaN beside poses that are. (n, 9)"""
    from scipy.spatial.transform import Rotation

    known: Any = np.isfinite(poses).all(axis=1)
    turned = Rotation.from_quat(np.where(known[:, None], poses[:, [4, 5, 6, 3]], [0.0, 0.0, 0.0, 1.0]))
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
    found: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    outcome: IntArray,
) -> PrescribedLoads:
    # What a speed that is not known leads to says nothing of the ground.
    outcome[motion.no_speed & np.isin(outcome, (DIVERGED, SANK, UNSETTLED))] = FINISHED
    for part in found:
        part[(outcome != FINISHED) | motion.no_speed] = np.nan
    paths, states, left, frames = found
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


FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")
"""Forces of a wheel, in the order of all arrays here."""
LARGEST_RESIDUAL = 0.05
"""Share of the weight: a residual beyond it says that the soil or the motion is not as given; assumed."""
FORCE_COLUMNS = [STATE_COLUMNS.index(name) for name in FORCES]


def contact_jacobian(found: PrescribedLoads) -> FloatArray:
    """What one newton of each wheel's forces adds to the totals. (n, 3 totals, wheels, 3 forces) [-, -, m]

    The forces act along the normal, ahead along and sideways against the contact axes at the wheel's centre; the
    lateral one where the shear stress is centred.
    """
    ahead, below = _shear_centers(found)
    e, d, n = (found.axes[:, :, k] for k in range(3))
    along = np.stack([n, e, -d], axis=2)  # (n, wheels, forces, xyz)
    turn = np.cross(found.arms[:, :, None], along)[..., 2]
    turn[..., 2] += -below * e[..., 2] - ahead * n[..., 2]
    yaw = np.radians(found.motion.yaw_deg)[:, None, None]
    forward = np.cos(yaw) * along[..., 0] + np.sin(yaw) * along[..., 1]
    left = np.cos(yaw) * along[..., 1] - np.sin(yaw) * along[..., 0]
    return np.stack([forward, left, turn], axis=1)


def residual_wrench(found: PrescribedLoads) -> FloatArray:
    """What the wheels do not supply of the totals. (n, 3) [N, N, N m]"""
    return np.column_stack([found.residual_n, found.residual_nm])


def net_wrench(found: PrescribedLoads, levers: FloatArray) -> FloatArray:
    """What drawbar pulls and lateral forces have to add up to for the motion: (n, 3) [N, N, N m]

    Weight and slope are in the normal forces; these follow from the levers of the suspension and hardly from the soil.
    """
    forces = found.states[..., FORCE_COLUMNS][..., 1:]
    return np.asarray(np.einsum("ntwf,nwf->nt", levers[..., 1:], forces) + residual_wrench(found))


def _shear_centers(found: PrescribedLoads) -> tuple[FloatArray, FloatArray]:
    sinkage, slip = (found.states[..., STATE_COLUMNS.index(name)] for name in ("sinkage_m", "slip_ratio"))
    ahead, below = shear_center(sinkage, slip, found.rover.wheel.vector())
    return ahead, below


MEASURED = ("sinkage_m", "slip_ratio", "side_slip_deg")


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
        found = np.full((2, len(times), wheels, 3), np.nan)
        rows = np.flatnonzero(self.valid)
        found[0, place[rows], self.wheel[rows]] = self.values[rows]
        found[1, place[rows], self.wheel[rows]] = self.sigmas[rows]
        return times, found[0], found[1]


def read_pose_states(source: InputFile, rover: Rover) -> PoseStates:
    """Read states from CSV: `time_s`, `wheel`, any of `MEASURED` with `NAME_sigma`, `valid`; others are only kept.

    Where no sigma is given it is that of `MeasurementErrors`. Raises DataError.
    """
    found = read_state_table(source, rover.wheel, measured=MEASURED, wheels=rover.wheels, rover=rover.name)
    wheel = np.array([rover.wheels.index(name) for name in found.wheels], dtype=np.int64)
    columns = [COLUMNS.index(name) for name in MEASURED]
    time = found.numbers("time_s")
    return PoseStates(found.table, time, wheel, found.values[:, columns], found.sigmas[:, columns], found.valid)


def correlation_length(motion: Motion, states: PoseStates | None) -> tuple[float, str]:
    """Distance over which the motion's errors stay alike [m], and what it rests on: `slip errors`, or `assumed`."""
    if states is None:
        return CORRELATION_M, "assumed"
    shown = states.valid & np.isin(states.time_s, motion.time_s[~motion.no_speed])
    found = correlation_of(motion, states.values[shown, 1], states.sigmas[shown, 1])
    return (CORRELATION_M, "assumed") if found is None else (found, "slip errors")
