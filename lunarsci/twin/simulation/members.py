"""Drives of all members, sixteen at a time, here or on a cluster, and again in finer steps where a soil asks for it."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray, spans
from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES
from lunarsci.errors import ParameterError
from lunarsci.parallel.blocks import run_blocks, shared_out
from lunarsci.regolith.forces import slip_ratio
from lunarsci.twin.ground.terrain import STEEPEST, Grid, Terrain
from lunarsci.twin.lanes import BODY, CLIFF, DIVERGED, FINISHED, GROUP, LEFT, WHEEL, Work, new_work
from lunarsci.twin.plans.path import (
    Commands,
    Schedule,
    all_commands,
    fix_errors,
    legs_from,
    make_schedule,
    reach_m,
    run_commands,
    start_motion,
    steps_of_runs,
)
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import (
    DEEPEST,
    DRIVEN,
    SHALLOWEST,
    SLOWEST,
    SPACING_M,
    VALID_SLIP,
    RutGrid,
    press_ruts,
    rut_grid,
    with_ruts,
)
from lunarsci.twin.simulation.dynamics import FALLING, advance, assemble, check_sense, orient
from lunarsci.twin.simulation.settle import settle, tread

SLOW_PARTS = 4
"""Into how many parts a step is cut as the rover starts and stops, assumed. In whole steps wheels on slopes swing as
they start, and dig 4 mm deeper than in short ones."""
STEER, RIM = (WHEEL.first[name] for name in ("steer", "rim"))
RATIO = WHEEL.first["tread"] + 4
X_ROW, Y_ROW, Z_ROW = (BODY.first[name] for name in ("x_row", "y_row", "z_row"))
CENTER, SINKAGE, VELOCITY, NORMAL, DRAWBAR, SIDE, RESISTANCE, RUT = (
    WHEEL.first[name] for name in ("center", "sinkage", "velocity", "normal", "drawbar", "side", "resistance", "rut")
)
"""Rows of a wheel in `Work.wheels`, and of `Work.body`: the number of one lane in row k lies at k * GROUP + lane."""
MOST_STEPS = 1e7
"""Minutes of computing for a single member."""
SLOW = 0.4
"""Share of the full speed below which a step is one of a start or a stop, and made in `SLOW_PARTS`; assumed."""
OUTLINE = 2000
"""Places along a plan about which ruts are kept."""
STRAY_M = 1.5
"""How far from its plan a rover still meets ruts. Measured: half or twice of it leave the embedded plan's end the
same. [m]"""
FINER = (4, 16)
"""How many times shorter the steps are that are tried in turn where a soil is not held by those asked for."""


@compiled
def take_commands(work: Any, steering: Any, speed: Any, step: int) -> None:
    """Steering angle and rim speed of every wheel in a step; (rovers, steps, wheels), one rover stands for all.

    Speeds are of rims with the stated r_s; the wheels' own turn as fast.
    """
    last = len(steering) - 1
    for w in range(len(work.wheels)):
        for lane in range(GROUP):
            work.wheels[w, STEER * GROUP + lane] = steering[min(lane, last), step, w]
            rim = speed[min(lane, last), step, w] * work.wheels[w, RATIO * GROUP + lane]
            work.wheels[w, RIM * GROUP + lane] = rim


def roll_on(work: Work, ahead: float, left: float, turn: float) -> None:
    """Give all rovers the start velocity: as commanded, along the chassis' x and y [m/s] and about its z [rad/s]."""
    for lane in range(0, GROUP, LANES):
        orient(work.body, lane)
    axes = np.array([BODY.view(work.body, name) for name in ("x_row", "y_row", "z_row")])
    BODY.view(work.body, "speed")[:] = ahead * axes[:, 0] + left * axes[:, 1]
    BODY.view(work.body, "spin")[:] = turn * axes[:, 2]


@compiled
def record(work: Any, lane: int, tyre: Any, path: Any, states: Any) -> None:
    """Pose (x, y, z, roll, pitch, yaw [m, rad]) and wheel states of one rover at this instant, one row of the results.

    Into `path` (6,) and `states` (wheels, 10), from the rover in this `lane` of a `Work`; `tyre` is `Wheel.vector()`.
    State: x, y, sinkage below the undisturbed ground, slip ratio, side slip [rad], F_N, F_DP, F_L, M_R, valid (1 or 0).
    A wheel that turns backwards is seen along its own direction of travel. The slip ratio is that of the stated r_s, as
    telemetry has it.
    """
    body = work.body[lane:]
    path[0], path[1], path[2] = body[0], body[GROUP], body[2 * GROUP]
    path[3] = math.atan2(body[(Z_ROW + 1) * GROUP], body[(Z_ROW + 2) * GROUP])
    path[4] = -math.asin(max(-1.0, min(1.0, body[Z_ROW * GROUP])))
    path[5] = math.atan2(body[Y_ROW * GROUP], body[X_ROW * GROUP])
    for w in range(len(states)):
        wheel, state = work.wheels[w, lane:], states[w]
        sinkage = wheel[SINKAGE * GROUP] + wheel[(RUT + 1) * GROUP]
        forward, across = wheel[VELOCITY * GROUP], wheel[(VELOCITY + 1) * GROUP]
        rim = abs(wheel[RIM * GROUP]) / wheel[RATIO * GROUP]
        slip = slip_ratio(forward / rim) if rim >= SLOWEST else 0.0
        state[0], state[1] = wheel[CENTER * GROUP], wheel[(CENTER + 1) * GROUP]
        state[2], state[3], state[4] = max(sinkage, 0.0), slip, math.atan2(across, abs(forward))
        state[5], state[6] = wheel[NORMAL * GROUP], wheel[DRAWBAR * GROUP]
        state[7], state[8] = wheel[SIDE * GROUP], wheel[RESISTANCE * GROUP]
        state[9] = 1.0 if SHALLOWEST < sinkage <= DEEPEST * tyre[0] and abs(slip) <= VALID_SLIP else 0.0


def begin(
    rover: Any, tyre: Any, grid: Any, override: Any, start: FloatArray, motion: FloatArray, steering: Any, speed: Any,
    work: Work,
) -> None:  # fmt: skip
    """Settle the rovers at `start`, steered by their first commands, and give them the velocity `motion`.

    `start` (GROUP, 3) is x, y, heading [m, m, rad], `motion` (3,) as in `roll_on`; others as in `drive`.
    """
    tread(tyre, override, work)
    take_commands(work, steering, speed, 0)
    settle(rover, tyre, grid, override, start, work)
    roll_on(work, *motion)


@compiled
def drive(
    rover: Any,
    tyre: Any,
    grid: Any,
    override: Any,
    steering: Any,
    speed: Any,
    time_step_s: float,
    first: int,
    every: int,
    last: bool,
    pressing: int,
    slow: Any,
    work: Any,
    paths: Any,
    states: Any,
    results: Any,
) -> None:
    """Drive up to GROUP rovers on from where they are.

    Parameters
    ----------
    rover, tyre, grid : `Rover.vector()`, `Wheel.vector()`, `Terrain.grid()`.
    override : (GROUP, 12) soil and wheels of each; lanes beyond the members repeat one of them.
    steering, speed : (rovers, steps, wheels) commanded angles and ground speeds; one rover stands for all.
    time_step_s, first : step [s], and number of the first one since the drive began.
    every : steps between records.
    last : whether the drive ends here, which is recorded too.
    pressing : steps between marks in the ruts of `work`; 0 where it has none.
    slow : steps of the whole drive in which the rover starts or stops. (all steps + 1,)
    work : `Work` of the group, at the state that the drive goes on from.
    paths, states : (members, samples, 6) and (members, samples, wheels, 10), filled on.
    results : (members, 2) outcome, and number of samples recorded so far.
    """
    members, steps, falling = len(paths), steering.shape[1], FALLING + np.abs(speed).max()
    # Lanes beyond the members need no ground; what becomes of them is not looked at.
    for m in range(members, GROUP):
        work.code[m] = LEFT
    for i in range(steps + (1 if last else 0)):
        under_way = 0
        for m in range(members):
            under_way += work.code[m] == FINISHED
        if under_way == 0:
            break
        take_commands(work, steering, speed, min(i, steps - 1))
        # The ground of a rut changes over a spacing, of which three steps are less than a half.
        work.frame[6] = 0.0 if pressing > 8 and (first + i) % 3 else 1.0
        parts = SLOW_PARTS if slow[first + i] and i < steps else 1
        step = time_step_s / parts
        for part in range(parts):
            assemble(rover, tyre, grid, override, step, DRIVEN, work)
            if part == 0:
                check_sense(work, rover, tyre, time_step_s, first + i == 0)
                if pressing > 0 and (first + i) % pressing == 0:
                    press_ruts(work, tyre[1])
                if (first + i) % every == 0:
                    for m in range(members):
                        if work.code[m] == FINISHED:
                            record(work, m, tyre, paths[m, results[m, 1]], states[m, results[m, 1]])
                            results[m, 1] += 1
            if i < steps:
                advance(work, step, rover.gravity * step, falling)
    work.frame[6] = 1.0
    for m in range(members):
        results[m, 0] = work.code[m]


class Grounds(Protocol):
    """A terrain for each member, where they do not share one.

    Attributes
    ----------
    parameters : soil parameters that stand for each ground in tables, name to value. (members,)
    """

    @property
    def parameters(self) -> Mapping[str, FloatArray]: ...
    def __len__(self) -> int: ...

    def terrain(self, member: int) -> Terrain:
        """The ground of one member, of the shape of all others."""
        ...

    def only(self, member: int) -> Self:
        """One of them alone."""
        ...


@dataclass(frozen=True, slots=True)
class DriveSetup:
    """What all members share: who drives where, when, and at which times it is stepped; or the ground of each.

    Attributes
    ----------
    rover, terrain, schedule : who drives where, and when.
    times_s : ends of all steps, the start first; evenly spaced. (steps + 1,) [s]
    every : steps between samples.
    seed : of the errors of position fixes.
    grounds : a terrain for each of all members; None where they share one.
    ruts : whether wheels meet the ruts of others, and of the scene that was driven `earlier`.
    earlier : the drive before on the same ground; None without one.
    only : numbers of the members that drive, ascending; None for all of them.
    draws : what the ground of each of all members is drawn by; None where heights are exact. (members, modes + 2)
    """

    rover: Rover
    terrain: Terrain
    schedule: Schedule
    times_s: FloatArray
    every: int
    seed: int
    grounds: Grounds | None = None
    ruts: bool = False
    earlier: "DriveSetup | None" = None
    only: IntArray | None = None
    draws: FloatArray | None = None

    @property
    def time_step_s(self) -> float:
        """Between all steps."""
        return float(self.times_s[1])

    @property
    def pressing(self) -> int:
        """Steps between marks in the ruts, at most one and a half spacings apart; 0 without ruts."""
        step = self.time_step_s * self.schedule.plan.speed_m_s
        return max(1, math.floor(1.5 * SPACING_M / step)) if self.ruts else 0

    @property
    def slow(self) -> BoolArray:
        """Steps in which the rover starts or stops: slip, and with it the force, changes much with little motion."""
        pace = self.schedule.pace_at(self.times_s)
        return np.asarray((pace > 0.0) & (pace < SLOW))

    def after(self, plan: Plan, time_step_s: float) -> "DriveSetup":
        """The same where this plan was driven before."""
        schedule = make_schedule(plan, self.rover)
        steps = max(1, math.ceil(schedule.duration_s / time_step_s))
        if steps > MOST_STEPS:
            raise ParameterError(f"the plan driven before takes over {MOST_STEPS:g} steps; give a longer `time_step`")
        times = np.linspace(0.0, schedule.duration_s, steps + 1)
        earlier = dataclasses.replace(self, schedule=schedule, times_s=times, every=steps)
        return dataclasses.replace(self, earlier=earlier)

    def finer(self, factor: int, only: IntArray) -> "DriveSetup":
        """Some of its members in steps so many times shorter, with samples at the same times."""
        times = np.linspace(0.0, self.times_s[-1], (len(self.times_s) - 1) * factor + 1)
        earlier = self.earlier and self.earlier.finer(factor, only)
        return dataclasses.replace(self, times_s=times, every=self.every * factor, earlier=earlier, only=only)

    def fix_errors(self, members: int) -> FloatArray:
        """Errors of the position fixes of each member. (members, runs, 3) [m, m, rad]"""
        numbers = np.arange(members) if self.only is None else self.only
        return fix_errors(self.schedule, int(numbers[-1]) + 1, self.seed)[numbers]

    def commands(self) -> Commands | None:
        """Commands that all members share; None where each drives from where it believes to be."""
        if self.schedule.plan.fixes is not None:
            return None
        return all_commands(self.rover, self.schedule, self.times_s)

    def rut_grid(self) -> RutGrid | None:
        """Where ruts are kept, None without them. Raises ParameterError for a plan that is too long."""
        if not self.ruts:
            return None
        schedules = [self.schedule] if self.earlier is None else [self.schedule, self.earlier.schedule]
        places = np.concatenate([s.pose_at(np.linspace(0.0, s.duration_s, OUTLINE))[:, :2] for s in schedules])
        return rut_grid(self.schedule.poses[0], places, reach_m(self.rover) + STRAY_M)


def _begin(scene: DriveSetup, inputs: tuple[Any, Any, Any, Any], commands: Commands, work: Work) -> None:
    """Put a group at the start of its plan; `inputs` are rover, tyre, grid and override of `drive`."""
    start = np.tile(scene.schedule.poses[0], (GROUP, 1))
    motion = np.array(start_motion(scene.schedule, scene.rover))
    begin(*inputs, start, motion, commands.steering_rad, commands.speed_m_s, work)


def drive_group(
    scene: DriveSetup,
    inputs: tuple[Any, Any, Any, Any],
    common: Commands | None,
    errors: FloatArray,
    work: Work,
    records: tuple[Any, ...],
    steered: FloatArray,
) -> None:
    """Drive a group's plan, run by run where each of it leads from where the rover then believes to be.

    Parameters
    ----------
    scene : what is driven.
    inputs : rover, tyre, grid and override of `drive`.
    common : commands that all members share; None where each has its own after its position fixes.
    errors : of these fixes. (GROUP, runs, 3) [m, m, rad]
    work : scratch arrays of the group, with the ruts so far.
    records : paths, states and results of `drive`.
    steered : takes the leg of each run after the first as each of the members steers it: length, curvature, turn.
        (members, runs, 3) [m, 1/m, rad]
    """
    slow = scene.slow
    if common is not None:
        _begin(scene, inputs, common, work)
        rims = (common.steering_rad, common.speed_m_s, scene.time_step_s)
        drive(*inputs, *rims, 0, scene.every, True, scene.pressing, slow, work, *records)
        return
    commands: Commands | None = None
    legs: FloatArray | None = None
    pieces = steps_of_runs(scene.schedule, scene.times_s)
    for number, piece in enumerate(pieces):
        if commands is not None:
            legs = legs_from(scene.schedule, scene.rover, number, work, errors[:, number])
            steered[:, number] = np.nan_to_num(legs[: len(steered)])
        times = scene.times_s[piece.start : piece.stop + 1]
        begins = commands is None
        commands = run_commands(scene.rover, scene.schedule, number, times, commands, legs)
        if begins:
            _begin(scene, inputs, commands, work)
        last = number == len(pieces) - 1
        driven = (*inputs, commands.steering_rad, commands.speed_m_s, scene.time_step_s, piece.start, scene.every)
        drive(*driven, last, scene.pressing, slow, work, *records)


Driven = tuple[FloatArray, FloatArray, IntArray, FloatArray]
"""Paths, states and results of `drive`, and legs as steered of `drive_group`, a row for each member."""


@dataclass(frozen=True, eq=False)
class MemberDrives:
    """The drives of some members, in groups that do not depend on who drives the others.

    Members with a ground of their own are a group each. Called with a block of members by `run_blocks`.

    Attributes
    ----------
    scene : what is driven.
    overrides : soil and wheels of each member, of `soil_overrides`. (members, 12)
    samples : of a drive.
    """

    scene: DriveSetup
    overrides: FloatArray
    samples: int

    def __reduce__(self) -> tuple[Any, ...]:
        return MemberDrives, (self.scene, self.overrides, self.samples)

    @cached_property
    def shared(self) -> tuple[Grid, RutGrid | None, list[tuple[DriveSetup, Commands | None, FloatArray]]]:
        """What all groups have: ground, ruts, and commands and errors of fixes of each drive."""
        scene, count = self.scene, len(self.overrides)
        parts = [part for part in (scene.earlier, scene) if part is not None]
        drives = [(part, part.commands(), part.fix_errors(count)) for part in parts]
        return scene.terrain.grid(scene.draws), scene.rut_grid(), drives

    @property
    def together(self) -> int:
        """Members of a group."""
        return GROUP if self.scene.grounds is None else 1

    def __call__(self, block: range) -> Driven:
        """What comes of the members of a block, which begins with a group."""
        scene, (shared, ruts, drives) = self.scene, self.shared
        whole = self.empty(len(block))
        numbers = np.arange(len(self.overrides)) if scene.only is None else scene.only
        for first in range(block.start, block.stop, self.together):
            rows = slice(first - block.start, min(first + self.together, block.stop) - block.start)
            lanes = np.minimum(np.arange(first, first + GROUP), block.start + rows.stop - 1)
            grid = shared if scene.grounds is None else scene.grounds.terrain(int(numbers[first])).grid(scene.draws)
            if scene.draws is not None:
                grid = grid._replace(draws=scene.draws[numbers[lanes]])
            inputs = (scene.rover.vector(), scene.rover.wheel.vector(), grid, self.overrides[lanes])
            work = new_work(len(scene.rover.wheels))
            work = work if ruts is None else with_ruts(work, ruts)
            size, before = rows.stop - rows.start, np.full(rows.stop - rows.start, FINISHED)
            for part, common, errors in drives:
                records = self.empty(size, part, 2)
                if part is scene:
                    records = (whole[0][rows], whole[1][rows], whole[2][rows], whole[3][rows])
                drive_group(part, inputs, common, errors[lanes], work, records[:3], records[3])
                records[2][:, 0] = np.where(before == FINISHED, records[2][:, 0], before)
                before = records[2][:, 0]
        return whole

    def empty(self, members: int, scene: DriveSetup | None = None, samples: int | None = None) -> Driven:
        """Zeros for so many members to be filled, of the scene or of another one."""
        setup = self.scene if scene is None else scene
        wheels, rows = len(setup.rover.wheels), self.samples if samples is None else samples
        runs = 0 if setup.schedule.plan.fixes is None else len(setup.schedule.runs)
        results = np.zeros((members, 2), dtype=np.int64)
        steered = np.zeros((members, runs, 3))
        return np.zeros((members, rows, 6)), np.zeros((members, rows, wheels, 10)), results, steered


def drive_all(
    scene: DriveSetup, overrides: FloatArray, samples: int, progress: Callable[[int, int], None] | None
) -> Driven:
    """Drive the members, GROUP together, as many such groups at a time as there are threads, here or on a cluster.

    The groups do not depend on the number of threads, and so neither do the results. Members with a ground of their own
    are a group each. A member whose drive before did not end has the outcome of that.
    """
    drives, count = MemberDrives(scene, overrides, samples), len(overrides)
    result = drives.empty(count)
    for block, records in run_blocks(drives, spans(count, shared_out(count, drives.together)), progress=progress):
        for whole, part in zip(result, records, strict=True):
            whole[block.start : block.stop] = part
    return result


def drive_each(
    scene: DriveSetup,
    overrides: FloatArray,
    samples: int,
    ruts: BoolArray,
    progress: Callable[[int, int], None] | None,
) -> tuple[Driven, IntArray]:
    """Drive all members, those that meet `ruts` (members,) and the others, and again those that need shorter steps.

    With how many times shorter these are. (members,)
    """
    whole, finer, done = MemberDrives(scene, overrides, samples).empty(len(ruts)), np.ones(len(ruts), dtype=np.int64), 0
    for met in (True, False):
        some = np.flatnonzero(ruts == met)
        if not some.size:
            continue
        part = dataclasses.replace(scene, ruts=met, only=None if some.size == len(ruts) else some)

        def on(count: int, _: int, before: int = done) -> None:
            if progress is not None:
                progress(before + count, len(ruts))

        driven = drive_all(part, overrides[some], samples, None if progress is None else on)
        finer[some] = drive_finer(part, overrides[some], driven)
        for target, rows in zip(whole, driven, strict=True):
            target[some] = rows
        done += some.size
    return whole, finer


def drive_finer(scene: DriveSetup, overrides: FloatArray, driven: Driven) -> IntArray:
    """Drive members again whose soil the step does not hold, with a shorter one; how many times shorter. (members,)"""
    paths, states, results, steered = driven
    finer = np.ones(len(overrides), dtype=np.int64)
    numbers = np.arange(len(overrides)) if scene.only is None else scene.only
    for factor in FINER:
        again = np.flatnonzero(results[:, 0] == DIVERGED)
        if not again.size or (len(scene.times_s) - 1) * factor > MOST_STEPS:
            break
        records = drive_all(scene.finer(factor, numbers[again]), overrides[again], paths.shape[1], None)
        paths[again], states[again], results[again], steered[again] = records
        finer[again] = factor
    for member in np.flatnonzero((results[:, 0] == DIVERGED) & (results[:, 1] > 0)):
        ground = scene.terrain if scene.grounds is None else scene.grounds.terrain(int(numbers[member]))
        if _meets_cliff(scene, ground, states[member, results[member, 1] - 1, :, :2]):
            results[member, 0] = CLIFF
    return finer


def _meets_cliff(scene: DriveSetup, terrain: Terrain, wheels_m: FloatArray) -> bool:
    """Whether a wheel last seen there can have met ground too steep: its load is then the cliff's, not the step's."""
    sample_m = scene.schedule.plan.speed_m_s * scene.time_step_s * scene.every
    far, angles = scene.rover.wheel.radius_m + sample_m, np.linspace(0.0, 2.0 * math.pi, 33)[:-1]
    radii = np.linspace(0.0, far, math.ceil(4.0 * far / terrain.spacing_m) + 1)
    around = radii[:, None, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    x, y = np.moveaxis(wheels_m[:, None, None] + around, -1, 0)
    slopes = terrain.surface_at(x, y)[..., 1:]
    return bool((np.hypot(slopes[..., 0], slopes[..., 1]) > STEEPEST).any())
