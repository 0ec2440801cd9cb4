"""Many drives over the same plan, each with another soil within its uncertainty."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.ranges import NOT_NEGATIVE, check_range
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.ground.illumination import SunDirection
from lunarsci.twin.ground.terrain import Terrain, soil_overrides
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.path import UNDER_WAY, Schedule, make_schedule
from lunarsci.twin.plans.plan import Plan, Sweep, check_plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import DEEPEST, SHALLOWEST
from lunarsci.twin.simulation.members import MOST_STEPS, DriveSetup, Grounds, drive_each

PATH_COLUMNS = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
"""Of a pose of the rover's origin; while drives are computed the angles are in rad."""
OFFSET_COLUMNS = ("offset_x_m", "offset_y_m")
"""How far from its path the physics' discrepancy has a member."""
MOST_BEYOND = 0.05
"""Share of the values of a drive that may be beyond the wheel model, after the end of the plan, or outliers; what rests
on more of them is in doubt. Assumed, one for all."""
STATE_COLUMNS = (
    "x_m",
    "y_m",
    "sinkage_m",
    "slip_ratio",
    "side_slip_deg",
    "normal_force_n",
    "drawbar_pull_n",
    "lateral_force_n",
    "resistance_torque_nm",
    "valid",
)
"""Of a wheel: x and y of its centre, states, forces, and 1 where the wheel model holds, else 0; while drives are
computed the side slip is in rad."""
LONGEST_STEP_S, LONGEST_SAMPLE_M = 0.2, 0.5
"""Measured: beyond these the time-step error reaches centimetres, and the largest slip or tilt falls between
samples."""
MOST_MEMBERS = 100_000
"""Of an ensemble; assumed."""
MOST_SAMPLES = 2_000_000
"""Members times samples, whose states fill 1 GB."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawnDiscrepancy:
    """Draws of a discrepancy.

    Attributes
    ----------
    law : they were drawn from.
    offsets_m : how far from its path each member is taken to be. (members, samples, 2) [m]
    shares : of wheel states, by quantity: what each member's were multiplied by, less 1. (members,) [-]
    """

    law: PhysicsDiscrepancy
    offsets_m: FloatArray
    shares: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PowerState:
    """What drives have of electrical power.

    Attributes
    ----------
    charge : of the battery at the start, one for all members or one for each, at most 1; below 0 where more was drawn
        before than there is. [-]
    sun : its direction; None for no light.

    Raises ParameterError.
    """

    charge: float | FloatArray = 1.0
    sun: SunDirection | None = None

    def __post_init__(self) -> None:
        single = np.ndim(self.charge) == 0
        if not np.all(np.less_equal(self.charge, 1.0)) or (single and self.charge < 0):
            raise ParameterError(f"charge is {np.max(self.charge):g}; give a share from 0 to 1")


@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False)
class Prediction:
    """Where the rover may go and what its wheels may meet, one row for each member of the ensemble.

    Attributes
    ----------
    rover, terrain, plan, seed : what it was computed from; `time_step_s` as used.
    parameters : swept soil parameters, name to value for each member. (members,)
    time_s : time of the samples. (samples,) [s]
    distance_m : their way along the plan, 0 to its length; it stands still in spot turns and stops. (samples,)
    planned : planned x, y, heading. (samples, 3) [m, m, rad]
    paths : rover's origin, columns `PATH_COLUMNS`; pitch is positive nose down. (members, samples, 6)
    states : wheels in the order of `rover.wheels`, columns `STATE_COLUMNS`; at a halt slip ratio and side slip are 0,
        as they would compare with a speed that is not there. (members, samples, wheels, 10)
    halted : samples at a halt. (samples,)
    recorded : samples that each member reached; later rows repeat its last one and are no prediction. (members,)
    outcome : index into `OUTCOMES`. (members,)
    grounds : what each member drove on, where they do not share the terrain's soil or one of `parameters`.
    ruts : whether the wheels of each member met what others had left. (members,)
    before : the plan that each member had driven on the same ground before, whose ruts it met.
    finer : how many times shorter the step was with which each member was driven; more than 1 where `time_step_s` did
        not hold its soil. (members,)
    draws : what the ground of each member was drawn by, `HeightErrors.draws`; None where heights are exact.
    discrepancy : what members were moved by, as the twin's physics is off; None where that was not asked. Their states
        hold it, their paths do not: see `places_m`.
    steered : length [m], curvature [1/m] and turn [rad] of each run of the plan's schedule as each member steered it
        after its position fix, 0 for the first run; None without fixes. (members, runs, 3)
    power : battery and light of the drives; None where these are not looked at.
    """

    rover: Rover
    terrain: Terrain
    plan: Plan
    seed: int
    time_step_s: float
    parameters: dict[str, FloatArray]
    time_s: FloatArray
    distance_m: FloatArray
    planned: FloatArray
    paths: FloatArray
    states: FloatArray
    halted: BoolArray
    recorded: IntArray
    outcome: IntArray
    grounds: Grounds | None = None
    ruts: BoolArray
    before: Plan | None = None
    finer: IntArray | None = None
    draws: FloatArray | None = None
    discrepancy: DrawnDiscrepancy | None = None
    steered: FloatArray | None = None
    power: PowerState | None = None

    @property
    def members(self) -> int:
        """Number of members."""
        return len(self.outcome)

    @property
    def finished(self) -> BoolArray:
        """Members that reached the end of the plan. (members,)"""
        return np.asarray(self.outcome == 0)

    @property
    def finer_members(self) -> int:
        """Members that were driven with a shorter step than `time_step_s`."""
        return 0 if self.finer is None else int((self.finer > 1).sum())

    @property
    def reached(self) -> BoolArray:
        """Samples that were driven, not repeated. (members, samples)"""
        return np.asarray(np.arange(len(self.distance_m)) < self.recorded[:, None])

    @property
    def places_m(self) -> FloatArray:
        """x, y of each member: of its path, and of what the physics is off by. (members, samples, 2) [m]"""
        places: FloatArray = self.paths[..., :2]
        return places if self.discrepancy is None else places + self.discrepancy.offsets_m

    @property
    def endpoints_m(self) -> FloatArray:
        """x, y where each member ended. (members, 2) [m]"""
        return self.places_m[:, -1]

    @property
    def destination_m(self) -> FloatArray:
        """x, y of where the drive shall end: the end of the plan. (2,) [m]"""
        destination: FloatArray = self.planned[-1, :2]
        return destination

    @property
    def miss_m(self) -> FloatArray:
        """Distance of each end from the destination. (members,) [m]"""
        return np.asarray(np.hypot(*(self.endpoints_m - self.destination_m).T))

    def outcome_text(self, member: int) -> str:
        """The outcome of one member in words."""
        return OUTCOMES[int(self.outcome[member])]


def member_parameters(sweep: tuple[Sweep, ...], members: int | None, seed: int) -> dict[str, FloatArray]:
    """Soil parameters of each member: the grid of all sweeps, or `members` Latin-hypercube samples of their ranges.

    Raises ParameterError for more than 100 000 members or a parameter swept twice.
    """
    names = [entry.name for entry in sweep]
    if len(set(names)) < len(names):
        raise ParameterError(f"a parameter is swept twice: {', '.join(names)}")
    count = math.prod(entry.count for entry in sweep) if members is None else members
    check_range("members", count, f"[1, {MOST_MEMBERS}]", "sweep fewer values")
    if members is not None and not sweep:
        raise ParameterError(
            f"{members} members but no soil parameter to sample; give `sweep` NAME=LOW:HIGH:N, or soils to draw from "
            "as `soil`: a belief, or priors for what is believed before any drive"
        )
    if members is None or not sweep:
        axes = [np.linspace(entry.low, entry.high, entry.count) for entry in sweep]
        values = [mesh.ravel() for mesh in np.meshgrid(*axes, indexing="ij")]
        return dict(zip(names, values, strict=True))
    from scipy.stats import qmc

    samples = qmc.LatinHypercube(len(sweep), rng=np.random.default_rng(seed)).random(members)
    return {entry.name: entry.low + (entry.high - entry.low) * samples[:, k] for k, entry in enumerate(sweep)}


def _given_parameters(
    samples: Mapping[str, npt.ArrayLike] | Mapping[str, FloatArray],
    sweep: tuple[Sweep, ...] | None,
    members: int | None,
) -> dict[str, FloatArray]:
    """Soils that are given, parameter to one value for each member. (members,)

    Raises ParameterError for a sweep or a number of members beside them, and for values that do not fit together.
    """
    if sweep is not None or members is not None:
        raise ParameterError("the soils are given; leave out the sweep and the number of members")
    values = {name: np.asarray(value, dtype=float) for name, value in samples.items()}
    shapes = {value.shape for value in values.values()}
    if len(shapes) != 1 or len(shape := shapes.pop()) != 1 or not 0 < shape[0] <= MOST_MEMBERS:
        raise ParameterError(f"give one value of each soil parameter for each of 1 to {MOST_MEMBERS} members")
    return values


def predict(
    rover: Rover,
    terrain: Terrain,
    plan: Plan,
    *,
    sweep: tuple[Sweep, ...] | None = None,
    members: int | None = None,
    samples: Mapping[str, npt.ArrayLike] | None = None,
    grounds: Grounds | None = None,
    seed: int = 0,
    time_step_s: float = 0.1,
    sample_m: float = 0.1,
    ruts: bool | BoolArray = False,
    before: Plan | None = None,
    draws: FloatArray | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Prediction:
    """Drive the plan once for each soil of the ensemble, each on ground of its own where heights have errors.

    Parameters
    ----------
    rover, terrain, plan : what drives where.
    sweep : uncertain soil parameters, the plan's by default; they replace the terrain's values at every node.
    members : number of Latin-hypercube samples of the sweeps' ranges; None takes the grid of all their values.
    samples : the soils themselves instead of a sweep: parameter to one value for each member.
    grounds : a terrain for each member instead, with the same nodes as `terrain`.
    seed : of the Latin hypercube and the errors of position fixes, >= 0.
    time_step_s : longest time step; shortened so that samples fall on steps, and for members whose soil it does not
        hold. 0.1 s puts the end of the embedded plan within 1.5 mm, which holds for no other ground: 5 m over a ramp
        10 cm high and long end 9 to 37 mm off. [s]
    sample_m : longest distance between samples; shortened so that the last is the end of the path. [m]
    ruts : whether wheels meet the ruts of those before them, as `lunarsci.twin.simulation.contact` has them, of all
        members or of each (members,); with `before` all of them must. What makes forces or soils of states takes every
        wheel's ground as undisturbed.
    before : a plan that each member has driven on the same ground before, so that it meets those ruts too. Where that
        drive did not end, this one has its outcome.
    draws : what the ground of each member is drawn by, instead of the terrain's own `HeightErrors.draws` by the seed;
        of one soil there are as many members.
    progress : called with members done and members in all, after each of them.

    Raises
    ------
    ParameterError for a plan the rover cannot follow or a value that is no step, seed or sweep.
    """
    _check_plans(plan, before, rover, ruts)
    check_range("seed", seed, NOT_NEGATIVE)
    if grounds is not None and samples is not None:
        raise ParameterError("samples and grounds are two ways to name the soils; give one")
    given = samples if grounds is None else grounds.parameters
    if given is None:
        parameters = member_parameters(plan.sweep if sweep is None else sweep, members, seed)
    else:
        parameters = _given_parameters(given, sweep, members)
    count = len(next(iter(parameters.values()))) if parameters else (1 if draws is None else len(draws))
    schedule = make_schedule(plan, rover)
    times, every = _steps(schedule, count, time_step_s, sample_m)
    overrides = soil_overrides(parameters if grounds is None else {}, count)
    if draws is None and terrain.errors is not None:
        draws = terrain.errors.draws(count, seed)
    met = np.array(np.broadcast_to(ruts, (count,)))
    scene = DriveSetup(rover, terrain, schedule, times, every, seed, grounds, bool(met.any()), draws=draws)
    scene = scene if before is None else scene.after(before, time_step_s)
    (paths, states, results, steered), finer = drive_each(scene, overrides, len(times[::every]), met, progress)
    halted = schedule.pace_at(times[::every]) < UNDER_WAY
    for_people(scene, paths, states, results[:, 1], halted)
    return Prediction(
        rover=rover,
        terrain=terrain,
        plan=plan,
        seed=seed,
        time_step_s=scene.time_step_s,
        parameters=parameters,
        time_s=times[::every],
        distance_m=schedule.distance_at(times[::every]),
        planned=schedule.pose_at(times[::every]),
        paths=paths,
        states=states,
        halted=halted,
        recorded=results[:, 1],
        outcome=results[:, 0],
        grounds=grounds,
        ruts=met,
        before=before,
        finer=finer,
        draws=draws,
        steered=None if plan.fixes is None else steered,
    )


def _steps(schedule: Schedule, members: int, time_step_s: float, sample_m: float) -> tuple[FloatArray, int]:
    """Times of all steps [s], and steps between samples. Raises ParameterError for too many of them."""
    check_range("time_step_s", time_step_s, f"(0, {LONGEST_STEP_S}]")
    check_range("sample_m", sample_m, f"(0, {LONGEST_SAMPLE_M}]")
    if schedule.duration_s / time_step_s > MOST_STEPS:
        raise ParameterError(f"the drive takes over {MOST_STEPS:g} steps; give a longer `time_step`")
    stops = max(1, math.ceil(schedule.duration_s * schedule.plan.speed_m_s / sample_m - 1e-9))
    if members * stops > MOST_SAMPLES:
        raise ParameterError(f"{members} members with {stops} samples do not fit into memory; give a longer sample_m")
    every = max(1, math.ceil(schedule.duration_s / stops / time_step_s - 1e-9))
    return np.linspace(0.0, schedule.duration_s, stops * every + 1), every


def _check_plans(plan: Plan, before: Plan | None, rover: Rover, ruts: bool | BoolArray) -> None:
    """Raises ParameterError for a plan that the rover cannot follow, and for one before where ruts are left out."""
    check_plan(plan, rover)
    if before is not None:
        check_plan(before, rover)
        if not np.all(ruts):
            raise ParameterError("a plan driven before leaves nothing but ruts, which are left out; ask for ruts, too")


def for_people(scene: DriveSetup, paths: FloatArray, states: FloatArray, recorded: IntArray, halted: BoolArray) -> None:
    """Halts without slip, drives that ended early filled up, angles in degrees; all in place.

    `paths` (members, samples, 6) and `states` (members, samples, wheels, 10) come with angles in rad; `recorded`
    (members,) and `halted` (samples,) are as in `Prediction`.
    """
    start, plan = scene.schedule.poses[0], scene.schedule.plan
    _calm_halts(states, halted, scene.rover.wheel.radius_m)
    _hold_last(paths, states, recorded, start, float(scene.terrain.height_at(plan.x_m, plan.y_m)))
    paths[..., 3:] = np.degrees(paths[..., 3:])
    paths[..., 5] = np.degrees(np.unwrap(np.radians(paths[..., 5]), axis=1))
    states[..., 4] = np.degrees(states[..., 4])


def _calm_halts(states: FloatArray, halted: BoolArray, radius_m: float) -> None:
    """Set slip and side slip to 0 at halts: they compare with a speed that is not there."""
    sinkage, slip, side_slip, valid = (
        STATE_COLUMNS.index(name) for name in ("sinkage_m", "slip_ratio", "side_slip_deg", "valid")
    )
    still = states[:, halted]
    still[..., [slip, side_slip]] = 0.0
    still[..., valid] = (still[..., sinkage] > SHALLOWEST) & (still[..., sinkage] <= DEEPEST * radius_m)
    states[:, halted] = still


def _hold_last(paths: FloatArray, states: FloatArray, recorded: IntArray, start: FloatArray, height: float) -> None:
    """Repeat the last sample of a drive that ended early; a drive that never began stays at the start, all forces 0.

    `start` is x, y, heading (3,) [m, m, rad], `height` the ground's there. [m]
    """
    for m in np.flatnonzero(recorded < paths.shape[1]):
        last = int(recorded[m])
        if last == 0:
            paths[m, :, :3] = start[0], start[1], height if math.isfinite(height) else 0.0
            paths[m, :, 5] = start[2]
        else:
            paths[m, last:], states[m, last:] = paths[m, last - 1], states[m, last - 1]
        states[m, last:, :, 9] = 0.0
