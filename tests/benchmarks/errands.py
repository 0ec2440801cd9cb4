"""Errands for rovers on SYNTHETIC ground: a terrain, a start and a target, what is believed of the soil, and the truth.

What `chosen_drives.py` judges plans by. The truth is driven on soils drawn from the belief, either by the twin's own
physics, moved by a draw of what is believed it is off by, or by the rover of `quasi_static.py`, which shares no code
with the twin.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import quasi_static
from scipy.ndimage import distance_transform_edt

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import Traversability, assess, ground_maps, map_scales, read_mobility, rover_footprint
from lunarsci.twin.ground.synthetic import synthetic_terrain
from lunarsci.twin.judgement.keeping import extremes
from lunarsci.twin.plans.made_for_check import limits_of_rover
from lunarsci.twin.plans.plan import Limit, Plan, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import Prediction, predict

ROVER = "yutu2"
SIDE_M, SPACING_M = 14.0, 0.05
SLOPES_DEG, SHARES, ROUGHNESS_M = (0.0, 5.0), (0.0, 0.05), (0.002, 0.006)
CRATERS = (2, 16)
WAY_M = (4.5, 7.0)
KNOWN = (0.1, 0.4)
"""Standard deviations of the belief, in those of the first laws: between a few drives and one."""
TOLERANCE_M = 1.0
"""An end as far as this from the target is there."""
MOST_DRAWS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class Errand:
    """From where to where, on what ground, and what is believed of the soil; start in m, m, deg."""

    number: int
    rover: Rover
    surface: Traversability
    start: tuple[float, float, float]
    target: tuple[float, float]
    belief: SoilBelief
    limits: tuple[Limit, ...]


def errand(number: int, seed: int = 22) -> Errand:
    """The errand of that number: the same whoever plans it."""
    random = np.random.default_rng([seed, number])
    description = read_rover(ROVER)
    rover = build_rover(description)
    terrain = synthetic_terrain(
        seed=int(random.integers(1 << 30)),
        spacing_m=SPACING_M,
        extent_m=SIDE_M,
        slope_deg=random.uniform(*SLOPES_DEG),
        craters=int(random.integers(*CRATERS)),
        rock_share=random.uniform(*SHARES),
        rms_m=random.uniform(*ROUGHNESS_M),
    )
    surface = assess(terrain, ground_maps(terrain, *map_scales(rover)), read_mobility(description, rover))
    start, target = _ends(surface, rover, random)
    limits = limits_of_rover(read_plan().limits, rover)
    return Errand(
        number=number,
        rover=rover,
        surface=surface,
        start=start,
        target=target,
        belief=_belief(random),
        limits=tuple(limit for limit in limits if limit.quantity != "endpoint_miss_m"),
    )


def _belief(random: np.random.Generator) -> SoilBelief:
    """Narrower than the first one, about a soil drawn so that the hidden soils together have the first laws."""
    first, share = first_belief(), random.uniform(*KNOWN)
    moved = np.linalg.cholesky(first.covariance) @ random.standard_normal(len(first.mean))
    return dataclasses.replace(
        first, mean=first.mean + math.sqrt(1.0 - share**2) * moved, covariance=share**2 * first.covariance
    )


def _ends(
    surface: Traversability, rover: Rover, random: np.random.Generator
) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """Start and target with room for the rover, the start looking within 60 deg of the target."""
    terrain, closed = surface.terrain, surface.hazard | surface.unknown
    clear = distance_transform_edt(np.pad(~closed, 1))[1:-1, 1:-1] * terrain.spacing_m
    room = rover_footprint(rover).reach_m + surface.mobility.hazard_distance_m
    for _ in range(MOST_DRAWS):
        x, y = random.uniform(-0.3 * SIDE_M, 0.3 * SIDE_M, 2)
        way, toward = random.uniform(*WAY_M), random.uniform(-math.pi, math.pi)
        target = (x + way * math.cos(toward), y + way * math.sin(toward))
        nodes = [tuple(round((v + 0.5 * SIDE_M) / SPACING_M) for v in place) for place in ((x, y), target)]
        if all(0 <= i < clear.shape[0] and 0 <= j < clear.shape[1] and clear[i, j] > room for j, i in nodes):
            return (float(x), float(y), math.degrees(toward) + random.uniform(-60.0, 60.0)), target
    raise ParameterError("no room for start and target on this ground")


def truths(one: Errand, plan: Plan, count: int, seed: int, *, moved: bool = True) -> np.ndarray:
    """Whether a plan keeps all limits on each of some hidden soils, by the twin's physics. (count,)

    With `moved` each drive is off by a draw of the belief's discrepancy.
    """
    found = predict(one.rover, one.surface.terrain, plan, samples=one.belief.draws(count, seed), seed=seed)
    return kept(with_discrepancy(found, one.belief.discrepancy, seed) if moved else found, one)


def other_truths(one: Errand, plan: Plan, count: int, seed: int) -> np.ndarray:
    """The same by other physics, with choices of its own for each soil, on the first of the same soils. (count,)"""
    soils, results = one.belief.draws(count, seed), []
    for k in range(count):
        soil = {name: float(values[k]) for name, values in soils.items()}
        physics = quasi_static.draw_physics(seed + k)
        driven = quasi_static.drive(one.rover, one.surface.terrain, plan, soil, physics)
        results.append(driven.finished and bool(kept(_as_prediction(one, plan, driven), one)[0]))
    return np.array(results)


def _as_prediction(one: Errand, plan: Plan, driven: "quasi_static.Driven") -> Prediction:
    samples = len(driven.time_s)
    return Prediction(
        rover=one.rover,
        terrain=one.surface.terrain,
        plan=plan,
        seed=0,
        time_step_s=0.1,
        parameters={},
        time_s=driven.time_s,
        distance_m=np.zeros(samples),
        planned=np.zeros((samples, 3)),
        paths=driven.poses[None],
        states=driven.states[None],
        ruts=np.zeros(1, dtype=bool),
        halted=np.zeros(samples, dtype=bool),
        recorded=np.array([samples]),
        outcome=np.zeros(1, dtype=np.int64),
    )


def kept(prediction: Prediction, one: Errand) -> np.ndarray:
    """Drives that finish within the tolerance of the target, and keep every limit on the way. (members,)"""
    result = prediction.finished & (np.hypot(*(prediction.endpoints_m - one.target).T) <= TOLERANCE_M)
    for limit in one.limits:
        worst = extremes(prediction, limit.quantity)
        result &= ~(worst > limit.limit) if limit.sense == "at most" else ~(worst < limit.limit)
    return result
