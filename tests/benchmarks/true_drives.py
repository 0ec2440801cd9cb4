"""True drives of the benchmark `loop.py`: out, back, and out and back again on one hidden soil, kept between runs.

A true drive costs seconds and does not depend on what the twin makes of it, so that one which lies in the folder of
`kept` is read, not driven again. The folder knows physics, seed, soil and terrains, not the code: empty it when the
code that drives changes.
"""

import dataclasses
import importlib
import pickle
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from mujoco_rover import Driven
from other_physics import PHYSICS, true_drive, widths, world_of

from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover

MOST_DRAWS = 20
QUASI_STATIC = "quasi-static"
"""A rover in equilibrium wherever it is, with a wheel-soil law of its own for each soil: `quasi_static.py`."""
DRIVEN_BY = (*PHYSICS, QUASI_STATIC)


@cache
def terrains(training: bool = False) -> dict[str, Terrain]:
    """Three grounds under the embedded plan: the stand-in for Longji, rougher, and flatter with other bumps.

    Those of `training` are others: what is set by hand or learned beforehand is set on them, never on the first three.
    """
    if training:
        bumps = synthetic_longji(seed=103)
        return {
            "taught": synthetic_longji(seed=101),
            "taught rough": synthetic_longji(seed=102, rms_m=0.009),
            "taught gentle": dataclasses.replace(bumps, height_m=0.6 * bumps.height_m),
        }
    bumps = synthetic_longji(seed=3)
    flat = dataclasses.replace(bumps, height_m=0.4 * bumps.height_m)
    return {"longji": synthetic_longji(), "rough": synthetic_longji(seed=7, rms_m=0.01), "gentle": flat}


def way_back(plan: Plan, out: Driven) -> Plan:
    """The same arcs backwards, from where the rover stands."""
    x, y, _, _, _, yaw = out.poses[-1]
    legs = tuple(Leg(leg.length_m, -leg.curvature_per_m, (leg.crab_deg + 180.0) % 360.0) for leg in reversed(plan.legs))
    return dataclasses.replace(plan, legs=legs, x_m=float(x), y_m=float(y), heading_deg=float(yaw), sweep=())


@dataclass(frozen=True, kw_only=True)
class Case:
    """One hidden soil by one physics: drawn by `seed` and `number`, the same for every physics."""

    physics: str
    number: int
    seed: int
    positions: tuple[str, ...] = ()
    model_error: float = 1.0
    training: bool = False
    drives: int = 2

    @property
    def ground(self) -> str:
        """Name of the terrain."""
        return list(terrains(self.training))[self.number % len(terrains(self.training))]

    def hidden(self, draw: int) -> np.ndarray:
        """Transforms of a soil drawn from the first laws."""
        random = np.random.default_rng([self.seed, self.number, draw])
        return first_belief().mean + widths() * random.normal(size=len(PARAMETERS))


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Drives one after the other on a hidden soil, each but the first the way back of the one before.

    Attributes
    ----------
    plans, drives : what was planned and what happened.
    thetas : transforms of the soil along each drive, on average. (8,)
    replaced : why soils drawn before this one were given up.
    drive_s : seconds that a drive took to compute.
    """

    plans: tuple[Plan, ...]
    drives: tuple[Driven, ...]
    thetas: tuple[np.ndarray, ...]
    replaced: tuple[str, ...]
    drive_s: float


def chain(case: Case, rover: Rover, plan: Plan, kept: Path | None = None) -> Chain:
    """The drives of a case, read from the folder `kept` where they lie there. The first two finish.

    A soil on which they do not is replaced by another draw. A chain ends early where a later drive does not finish.
    """
    file = None if kept is None else kept / f"{case.physics}-{case.seed}-{case.number}-{case.ground}.pickle"
    if file is not None and file.exists():
        found = pickle.loads(file.read_bytes())
        if isinstance(found, Chain) and len(found.drives) >= case.drives:
            return found
    found = driven_chain(case, rover, plan)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        part.write_bytes(pickle.dumps(found))
        part.replace(file)
    return found


class _Quasistatic:
    """As `World`, by the simulator that shares no code with the twin; its choices are drawn for each soil."""

    def __init__(self, case: Case, rover: Rover, draw: int) -> None:
        self.module = importlib.import_module("quasi_static")
        self.rover, self.terrain, self.theta = rover, terrains(case.training)[case.ground], case.hidden(draw)
        self.physics = self.module.draw_physics(case.seed + case.number)

    def drive(self, plan: Plan) -> Driven:
        values = values_of(first_belief().laws, self.theta)
        soil = dict(zip(PARAMETERS, map(float, values), strict=True))
        driven: Driven = self.module.drive(self.rover, self.terrain, plan, soil, self.physics)
        return driven

    def soil_along(self, driven: Driven) -> np.ndarray:
        return self.theta


class _Bodies:
    """A world of `other_physics.py`."""

    def __init__(self, case: Case, rover: Rover, draw: int) -> None:
        ground, physics, seed = terrains(case.training)[case.ground], PHYSICS[case.physics], case.seed + case.number
        self.world = world_of(rover, ground, physics, case.hidden(draw), seed=seed)
        self.soil_along = self.world.soil_along

    def drive(self, plan: Plan) -> Driven:
        return true_drive(self.world, plan)


def driven_chain(case: Case, rover: Rover, plan: Plan) -> Chain:
    """The drives of a case, driven now."""
    replaced: list[str] = []
    for draw in range(MOST_DRAWS):
        world = (_Quasistatic if case.physics == QUASI_STATIC else _Bodies)(case, rover, draw)
        begin, plans, drives = time.perf_counter(), [plan], [world.drive(plan)]
        while drives[-1].finished and len(drives) < max(case.drives, 2):
            plans.append(way_back(plans[-1], drives[-1]))
            drives.append(world.drive(plans[-1]))
        took = (time.perf_counter() - begin) / len(drives)
        finished = sum(drive.finished for drive in drives)
        if finished >= 2:
            return Chain(
                plans=tuple(plans[:finished]),
                drives=tuple(drives[:finished]),
                thetas=tuple(world.soil_along(drive) for drive in drives[:finished]),
                replaced=tuple(replaced),
                drive_s=took,
            )
        replaced.append(drives[-1].outcome)
    raise SystemExit(f"soil {case.number}: {MOST_DRAWS} draws, and the truth drives on none of them: {replaced}")
