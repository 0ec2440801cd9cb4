"""Driving the members of an ensemble: LANES at a time, in threads, with the ruts they leave."""

import dataclasses
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import each_in_threads
from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.commands import Commands, reach_m
from lunarsci.twin.plans.fixes import fix_errors, legs_from
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import (
    Schedule,
    all_commands,
    make_schedule,
    run_commands,
    start_motion,
    steps_of_runs,
)
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.drive import begin, drive
from lunarsci.twin.simulation.lanes import LANES, Work, new_work
from lunarsci.twin.simulation.outcomes import DIVERGED
from lunarsci.twin.simulation.ruts import SPACING_M, with_ruts

__all__ = ["MOST_STEPS", "Grounds", "Scene", "drive_all", "drive_finer", "scene_before"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MOST_STEPS = 1e7
"""Minutes of computing for a single member."""
FINER = (4, 16)
"""How many times shorter steps are where a soil is not held by the step asked for."""
OUTLINE = 2000
"""Places along a plan about which ruts are kept."""
STRAY_M = 1.5
"""How far from its plan a rover still meets ruts; assumed. [m]"""


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
class Scene:
    """What all members share: who drives where, when, and at which times it is stepped; or the ground of each.

    `only` are the numbers of the members, where it is not all of them.
    """

    rover: Rover
    terrain: Terrain
    schedule: Schedule
    times_s: FloatArray
    every: int
    seed: int
    grounds: Grounds | None = None
    ruts: bool = True
    only: IntArray | None = None

    @property
    def pressing(self) -> int:
        """Steps between marks in the ruts, at most one and a half spacings apart; 0 without ruts."""
        step = float(self.times_s[1]) * self.schedule.plan.speed_m_s
        return max(1, math.floor(1.5 * SPACING_M / step)) if self.ruts else 0


def scene_before(scene: Scene, plan: Plan, time_step_s: float) -> Scene:
    """The same, of a plan that was driven before; its drives are not kept."""
    schedule = make_schedule(plan, scene.rover)
    steps = max(1, math.ceil(schedule.duration_s / time_step_s))
    if steps > MOST_STEPS:
        raise ParameterError(f"the plan driven before takes over {MOST_STEPS:g} steps; give a longer time_step_s")
    times = np.linspace(0.0, schedule.duration_s, steps + 1)
    return dataclasses.replace(scene, schedule=schedule, times_s=times, every=steps)


def _fresh_work(scene: Scene, earlier: Scene | None) -> Work:
    """Scratch arrays, with undisturbed ground under the plans."""
    work: Work = new_work(len(scene.rover.wheels))
    if not scene.ruts:
        return work
    schedules = [part.schedule for part in (scene, earlier) if part is not None]
    places = np.concatenate([s.pose_at(np.linspace(0.0, s.duration_s, OUTLINE))[:, :2] for s in schedules])
    found = with_ruts(work, scene.schedule.poses[0], places, reach_m(scene.rover) + STRAY_M)
    if found is None:
        warnings.warn("the plan is too long for ruts, which are left out", LunarSciWarning, stacklevel=2)
    return found or work


def drive_all(
    scene: Scene,
    earlier: Scene | None,
    overrides: FloatArray,
    samples: int,
    progress: Callable[[int, int], None] | None,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Drive the members, LANES together and as many such groups at a time as numba has threads.

    The groups do not depend on the number of threads, and so neither do the results. Members with a ground of their own
    are a group each.
    """
    count, wheels = len(overrides), len(scene.rover.wheels)
    paths, states = np.zeros((count, samples, 6)), np.zeros((count, samples, wheels, 10))
    results = np.zeros((count, 2), dtype=np.int64)
    numbers = np.arange(count) if scene.only is None else scene.only
    shared, errors = scene.terrain.grid(), fix_errors(scene.schedule, int(numbers[-1]) + 1, scene.seed)[numbers]
    together = LANES if scene.grounds is None else 1
    groups = [slice(k, min(k + together, count)) for k in range(0, count, together)]
    common = all_commands(scene.rover, scene.schedule, scene.times_s) if scene.schedule.plan.fixes is None else None
    before = None if earlier is None else fix_errors(earlier.schedule, int(numbers[-1]) + 1, scene.seed)[numbers]

    def group(number: int) -> None:
        own = groups[number]
        lanes = np.minimum(np.arange(own.start, own.start + LANES), own.stop - 1)
        grid = shared if scene.grounds is None else scene.grounds.terrain(int(numbers[number])).grid()
        known = (scene.rover.vector(), scene.rover.wheel.vector(), grid, overrides[lanes])
        work = _fresh_work(scene, earlier)
        if earlier is not None and before is not None:
            size = own.stop - own.start
            unkept = (np.zeros((size, 2, 6)), np.zeros((size, 2, wheels, 10)), np.zeros((size, 2), dtype=np.int64))
            _drive_one(earlier, known, None, before[lanes], work, unkept)
        _drive_one(scene, known, common, errors[lanes], work, (paths[own], states[own], results[own]))

    def told(done: int, _: int) -> None:
        if progress is not None:
            progress(groups[done - 1].stop, count)

    each_in_threads(group, len(groups), told)
    return paths, states, results


def drive_finer(
    scene: Scene, earlier: Scene | None, overrides: FloatArray, kept: tuple[FloatArray, FloatArray, IntArray]
) -> IntArray:
    """Drive members again whose soil the step does not hold, with a shorter one; how many times shorter. (members,)"""
    paths, states, results = kept
    finer = np.ones(len(overrides), dtype=np.int64)
    for factor in FINER:
        again = np.flatnonzero(results[:, 0] == DIVERGED)
        if not again.size or (len(scene.times_s) - 1) * factor > MOST_STEPS:
            break
        steps = (len(scene.times_s) - 1) * factor
        times = np.linspace(0.0, scene.times_s[-1], steps + 1)
        own = dataclasses.replace(scene, times_s=times, every=scene.every * factor, only=again)
        found = drive_all(own, earlier, overrides[again], paths.shape[1], None)
        paths[again], states[again], results[again] = found
        finer[again] = factor
    return finer


def _begin(scene: Scene, known: tuple[Any, ...], commands: Commands, work: Work) -> None:
    start = np.tile(scene.schedule.poses[0], (LANES, 1))
    motion = np.array(start_motion(scene.schedule, scene.rover))
    begin(*known, start, motion, commands.steering_rad, commands.speed_m_s, work)


def _drive_one(
    scene: Scene,
    known: tuple[Any, ...],
    common: Commands | None,
    errors: FloatArray,
    work: Work,
    kept: tuple[Any, ...],
) -> None:
    """Drive a group's plan, run by run where each of it leads from where the rover then believes to be."""
    plan, pressing = scene.schedule.plan, scene.pressing if work.ruts.shape[1] > 1 else 0
    if plan.fixes is None:
        common = common or all_commands(scene.rover, scene.schedule, scene.times_s)
        _begin(scene, known, common, work)
        rims = (common.steering_rad, common.speed_m_s, scene.times_s[1])
        drive(*known, *rims, 0, scene.every, True, pressing, work, *kept)
        return
    commands: Commands | None = None
    legs: FloatArray | None = None
    pieces = steps_of_runs(scene.schedule, scene.times_s)
    for number, piece in enumerate(pieces):
        if commands is not None:
            legs = legs_from(scene.schedule, scene.rover, number, work, errors[:, number])
        times = scene.times_s[piece.start : piece.stop + 1]
        begins = commands is None
        commands = run_commands(scene.rover, scene.schedule, number, times, commands, legs)
        if begins:
            _begin(scene, known, commands, work)
        last = number == len(pieces) - 1
        driven = (*known, commands.steering_rad, commands.speed_m_s, scene.times_s[1], piece.start, scene.every)
        drive(*driven, last, pressing, work, *kept)
