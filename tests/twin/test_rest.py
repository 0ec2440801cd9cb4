"""Rest is rest: halts change nothing, small changes stay small, and what a step does not hold is said."""

import dataclasses
import math

import numpy as np
import pytest

from lunarsci.regolith.prior import PARAMETERS, default_prior, values_of
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Fixes, Leg, Plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict

SOILS, REST_S, SETTLED_S = 45, 300.0, 1.0
"""Rest begins when the rims have stood for a second: by then what is left of the motion is gone."""
PLAN = Plan(name="rest", x_m=-1.5, speed_m_s=0.04, legs=(Leg(0.8), Leg(stop_s=REST_S), Leg(0.4)), sweep=())


def soils() -> dict[str, np.ndarray]:
    """Drawn from the priors."""
    laws, random = default_prior(), np.random.default_rng(5)
    center, width = (np.array([getattr(laws[name], what) for name in PARAMETERS]) for what in ("center", "width"))
    values = values_of(laws, center + width * random.normal(size=(SOILS, len(PARAMETERS))))
    return {name: values[:, k] for k, name in enumerate(PARAMETERS)}


def ground(kind: str, soil: Soil) -> Terrain:
    """Waves of 1 to 4 m, or a plane of 15 deg."""
    x = np.arange(-5.0, 5.01, 0.05)
    across, along = np.meshgrid(x, x, indexing="ij")
    if kind == "rough":
        height = sum(
            a * np.sin(2.0 * math.pi * (along * math.cos(b) + across * math.sin(b)) / wave + 3.0 * b)
            for a, b, wave in ((0.02, 0.1, 1.3), (0.015, 1.5, 0.9), (0.02, 0.8, 2.1), (0.03, -0.5, 3.7))
        )
    else:
        azimuth = {"up": 0.0, "down": math.pi, "across": 0.5 * math.pi}[kind]
        height = math.tan(math.radians(15.0)) * (along * math.cos(azimuth) + across * math.sin(azimuth))
    return build_terrain(kind, -5.0, -5.0, 0.05, height, soil)


def holds(prediction: Prediction) -> np.ndarray:
    """Members that drive where their wheels roll before the halt; others slide off a slope that does not hold them."""
    before = int(np.searchsorted(prediction.distance_m, 0.5))
    moved = prediction.paths[:, before, :2] - prediction.paths[:, before - 2, :2]
    speed = moved / (prediction.time_s[before] - prediction.time_s[before - 2])
    slides = np.hypot(speed[:, 0] - prediction.plan.speed_m_s, speed[:, 1]) > 0.5 * prediction.plan.speed_m_s
    return np.asarray(prediction.finished & ~slides)


@pytest.mark.parametrize("kind", ["rough", "up", "down", "across"])
@pytest.mark.parametrize("name", ["yutu2", "small-four"])
def test_five_minutes_of_rest_change_nothing(name: str, kind: str, longji_soil: Soil) -> None:
    """Nor does the halt change the verdict of the way after it."""
    rover, drawn = build_rover(name), soils()
    out = predict(rover, ground(kind, longji_soil), PLAN, samples=drawn)
    stop = make_schedule(PLAN, rover).runs[1]
    still = (out.time_s > stop.begin_s + SETTLED_S) & (out.time_s < stop.end_s)
    held = holds(out)
    assert held.sum() >= 15
    assert np.ptp(out.paths[held][:, still, :3], axis=1).max() < 1e-4
    assert np.ptp(out.paths[held][:, still, 3:], axis=1).max() < 0.01
    load = out.states[held][:, still][..., 5]
    assert (np.ptp(load, axis=1) < 0.01 * load.mean(axis=1) + 1e-6).all()
    assert load.max() < 0.7 * rover.mass_kg * rover.gravity_m_s2
    # The same ground without the halt: as many drives end, and each soil alone gets the same verdict.
    through = predict(rover, out.terrain, dataclasses.replace(PLAN, legs=(Leg(0.8), Leg(0.4))), samples=drawn)
    assert np.array_equal(out.finished[held], through.finished[held])
    deepest = [drives.states[held][..., 2].max(axis=(1, 2)) for drives in (out, through)]
    assert np.quantile(np.abs(deepest[0] - deepest[1]), 0.9) < 2e-3
    assert judge(out, PLAN).verdict == judge(through, through.plan).verdict


def test_at_rest_on_a_slope_the_wheels_carry_the_normal_part_of_the_weight(yutu2: Rover, longji_soil: Soil) -> None:
    """In the first sample, and the force along the surface is the rest of it."""
    plan = dataclasses.replace(PLAN, legs=(Leg(stop_s=5.0), Leg(0.2)))
    for kind in ("up", "across"):
        states = predict(yutu2, ground(kind, longji_soil), plan).states[0, 0]
        weight, slope = yutu2.mass_kg * yutu2.gravity_m_s2, math.radians(15.0)
        assert states[:, 5].sum() == pytest.approx(weight * math.cos(slope), rel=1e-6)
        assert np.hypot(states[:, 6].sum(), states[:, 7].sum()) == pytest.approx(weight * math.sin(slope), rel=5e-3)


LEGS = {
    "stop": (Leg(0.6, 0.3), Leg(stop_s=20.0), Leg(0.4, -0.3)),
    "back, then turn": (Leg(0.6), Leg(0.6, 0.0, 180.0), Leg(turn_deg=60.0), Leg(0.3)),
    "crab": (Leg(0.5, 0.0, 30.0), Leg(0.5, 0.0, -30.0)),
}


@pytest.mark.parametrize("legs", LEGS.values(), ids=LEGS)
def test_small_changes_stay_small_and_mirrored_drives_mirror(
    legs: tuple[Leg, ...], yutu2: Rover, longji_soil: Soil
) -> None:
    some = {name: values[:16] for name, values in soils().items()}
    rough = ground("rough", longji_soil)
    plan = dataclasses.replace(PLAN, x_m=-0.517, y_m=0.137, legs=legs)
    ends = predict(yutu2, rough, plan, samples=some).endpoints_m
    near = dataclasses.replace(plan, x_m=plan.x_m + 1e-12, y_m=plan.y_m - 1e-12)
    assert np.abs(predict(yutu2, rough, near, samples=some).endpoints_m - ends).max() < 1e-9
    turned = tuple(
        dataclasses.replace(
            leg, curvature_per_m=-leg.curvature_per_m, crab_deg=-leg.crab_deg, turn_deg=-leg.turn_deg
        )
        for leg in legs
    )  # fmt: skip
    mirror = dataclasses.replace(rough, height_m=rough.height_m[::-1].copy())
    other = predict(yutu2, mirror, dataclasses.replace(plan, y_m=-plan.y_m, legs=turned), samples=some)
    assert np.abs(other.endpoints_m * (1.0, -1.0) - ends).max() < 1e-9


def test_soils_that_the_step_does_not_hold_are_driven_finer_or_refused(yutu2: Rover, longji_soil: Soil) -> None:
    """Against a step of 8 ms: whatever finishes ends within a centimetre of it, the rest says that it diverged."""
    pairs = np.array([(5e5, 0.05), (5e5, 17.8), (5e4, 0.05), (5e4, 1.0), (1443.0, 0.2), (1443.0, 1.0), (1443.0, 17.8)])
    stiff = dict(
        zip(("stiffness_kpa_m_n", "shear_modulus_mm", "lateral_modulus_mm"), pairs[:, [0, 1, 1]].T, strict=True)
    )
    plan = dataclasses.replace(PLAN, legs=(Leg(0.4), Leg(stop_s=1.0), Leg(0.2)))
    flat = build_terrain("flat", -5.0, -5.0, 1.0, np.zeros((11, 11)), longji_soil)
    out = predict(yutu2, flat, plan, samples=stiff)
    exact = predict(yutu2, flat, plan, samples=stiff, time_step_s=0.008)
    both = out.finished & exact.finished
    assert out.finished[[1, 6]].all() and out.finer is not None and (out.finer[[1, 6]] == 1).all()
    assert np.hypot(*(out.endpoints_m - exact.endpoints_m)[both].T).max() < 0.01
    assert (out.finer[~out.finished] > 1).all()
    assert all(out.outcome_text(int(m)).startswith("diverged") for m in np.flatnonzero(~out.finished))
    assert out.states[out.finished][..., 5].max() < 2.0 * yutu2.mass_kg * yutu2.gravity_m_s2


def test_a_drive_does_not_depend_on_those_beside_it(yutu2: Rover, longji_soil: Soil) -> None:
    """Where each drives by its own commands, too, as after position fixes."""
    plan = dataclasses.replace(PLAN, legs=(Leg(0.4), Leg(0.4, 0.2)), fixes=Fixes(0.05, 1.0))
    some = {name: values[:3] for name, values in soils().items()}
    rough = ground("rough", longji_soil)
    alone = predict(yutu2, rough, plan, samples={name: values[:1] for name, values in some.items()})
    assert np.array_equal(predict(yutu2, rough, plan, samples=some).paths[0], alone.paths[0])
