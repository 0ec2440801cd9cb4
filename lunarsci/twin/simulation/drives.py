"""Drives of all members of an ensemble, here or on a cluster, and again in finer steps where a soil asks for it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray, spans
from lunarsci.parallel.blocks import run_blocks, shared_out
from lunarsci.twin.ground.terrain import STEEPEST, Grid, Terrain
from lunarsci.twin.lanes import CLIFF, DIVERGED, FINISHED, GROUP, new_work
from lunarsci.twin.plans.path import Commands
from lunarsci.twin.simulation.members import MOST_STEPS, DriveSetup, drive_group
from lunarsci.twin.simulation.ruts import RutGrid, with_ruts

Driven = tuple[FloatArray, FloatArray, IntArray, FloatArray]
"""Paths, states, results, and legs as steered after position fixes."""
FINER = (4, 16)
"""How many times shorter steps are where a soil is not held by the step asked for; assumed."""


@dataclass(frozen=True, eq=False)
class MemberDrives:
    """The drives of some members, in groups that do not depend on who drives the others.

    Members with a ground of their own are a group each.
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
            own = slice(first - block.start, min(first + self.together, block.stop) - block.start)
            lanes = np.minimum(np.arange(first, first + GROUP), block.start + own.stop - 1)
            grid = shared if scene.grounds is None else scene.grounds.terrain(int(numbers[first])).grid(scene.draws)
            if scene.draws is not None:
                grid = grid._replace(draws=scene.draws[numbers[lanes]])
            known = (scene.rover.vector(), scene.rover.wheel.vector(), grid, self.overrides[lanes])
            work = new_work(len(scene.rover.wheels))
            work = work if ruts is None else with_ruts(work, ruts)
            size, before = own.stop - own.start, np.full(own.stop - own.start, FINISHED)
            for part, common, errors in drives:
                kept = self.empty(size, part, 2)
                if part is scene:
                    kept = (whole[0][own], whole[1][own], whole[2][own], whole[3][own])
                drive_group(part, known, common, errors[lanes], work, kept[:3], kept[3])
                kept[2][:, 0] = np.where(before == FINISHED, kept[2][:, 0], before)
                before = kept[2][:, 0]
        return whole

    def empty(self, members: int, scene: DriveSetup | None = None, samples: int | None = None) -> Driven:
        """What is to be filled, of the scene or of another one."""
        own = self.scene if scene is None else scene
        wheels, rows = len(own.rover.wheels), self.samples if samples is None else samples
        runs = 0 if own.schedule.plan.fixes is None else len(own.schedule.runs)
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
    kept = drives.empty(count)
    for block, found in run_blocks(drives, spans(count, shared_out(count, drives.together)), progress=progress):
        for whole, part in zip(kept, found, strict=True):
            whole[block.start : block.stop] = part
    return kept


def drive_finer(scene: DriveSetup, overrides: FloatArray, kept: Driven) -> IntArray:
    """Drive members again whose soil the step does not hold, with a shorter one; how many times shorter. (members,)"""
    paths, states, results, steered = kept
    finer = np.ones(len(overrides), dtype=np.int64)
    for factor in FINER:
        again = np.flatnonzero(results[:, 0] == DIVERGED)
        if not again.size or (len(scene.times_s) - 1) * factor > MOST_STEPS:
            break
        found = drive_all(scene.finer(factor, again), overrides[again], paths.shape[1], None)
        paths[again], states[again], results[again], steered[again] = found
        finer[again] = factor
    for member in np.flatnonzero((results[:, 0] == DIVERGED) & (results[:, 1] > 0)):
        own = scene.terrain if scene.grounds is None else scene.grounds.terrain(int(member))
        if _meets_cliff(scene, own, states[member, results[member, 1] - 1, :, :2]):
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
