"""The truth of the benchmark `loop.py`: MuJoCo drives as the twin does where it has the twin's formulas, and otherwise
as the stress integrals say.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest
from mujoco_rover import ACROSS, Driven, Law, fresh_ruts, press, push_of, rut_below
from other_physics import PHYSICS, RISE_N_M4, Physics, World, smooth_fields, true_drive, widths, world_of

from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.integrals import NODES, WEIGHTS, integrated_forces
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import ContactModel
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict

pytest.importorskip("mujoco")

MIDDLE = first_belief().mean
BEND = Plan(name="test", legs=(Leg(1.0, 0.25), Leg(1.0, -0.25)), speed_m_s=0.05)


def soil_of(theta: np.ndarray) -> Soil:
    return Soil(**dict(zip(PARAMETERS, map(float, values_of(first_belief().laws, theta)), strict=True)))


def column(driven: Driven, name: str) -> np.ndarray:
    """After the first two seconds: the rover has found its speed and its depth."""
    return driven.states[2:, :, STATE_COLUMNS.index(name)]


def by_integrals(world: World, driven: Driven, model: ContactModel) -> Any:
    states = [column(driven, name) for name in ("sinkage_m", "slip_ratio", "side_slip_deg")]
    return integrated_forces(world.rover.wheel, soil_of(world.middle), *states, model)


@pytest.fixture(scope="module")
def longji() -> Terrain:
    return synthetic_longji(rms_m=0.008)


@pytest.mark.slow
@pytest.mark.parametrize("heading", [0.0, 180.0], ids=["ahead", "backwards"])
def test_with_the_twins_formulas_it_drives_as_the_twin(yutu2: Rover, longji: Terrain, heading: float) -> None:
    """Steering that changes, wheels beside their steering axes, rough ground, and a soil that changes."""
    rover = dataclasses.replace(yutu2, steering_offset_m=0.05)
    legs = tuple(dataclasses.replace(leg, crab_deg=heading) for leg in BEND.legs)
    plan = dataclasses.replace(BEND, legs=legs, x_m=3.0, y_m=0.5, heading_deg=20.0)
    world = world_of(rover, longji, Physics(exact=False, spread=0.3), MIDDLE)
    twin = predict(rover, world.terrain, plan, sweep=(), time_step_s=0.005)
    truth = true_drive(world, plan, 0.002)
    assert truth.finished and twin.finished[0]
    assert np.allclose(truth.time_s, twin.time_s)
    off = np.abs(truth.poses - twin.paths[0])
    assert off[:, :3].max() < 0.4e-3 and off[:, 3:].max() < 0.01, off.max(axis=0)
    # The first record is the start, which the twin settles at a standstill.
    states = np.abs(truth.states - twin.states[0])[1:].max(axis=(0, 1))
    assert (states[:9] < [4e-4, 4e-4, 5e-5, 1e-3, 0.05, 0.1, 0.05, 0.05, 0.01]).all(), states
    assert np.ptp(world.terrain.soil[..., 0]) > 1e5


def test_forces_are_those_of_the_integrals_and_their_moments_turn_the_same_way(yutu2: Rover, longji: Terrain) -> None:
    world = world_of(yutu2, longji, PHYSICS["exact"], MIDDLE)
    driven = true_drive(world, BEND)
    forces = by_integrals(world, driven, ContactModel())
    for name in ("normal_force_n", "drawbar_pull_n", "lateral_force_n", "resistance_torque_nm"):
        assert column(driven, name) == pytest.approx(getattr(forces, name), rel=1e-5, abs=1e-5), name
    exact, closed = (
        np.array(push_of(Law(on, world.physics.law.model, 0.0), 0.02, 0.0, 0.045, 0.01, 0.05, yutu2.wheel.vector(),
                         np.array(soil_of(MIDDLE).vector()), NODES, WEIGHTS))
        for on in (True, False)
    )  # fmt: skip
    assert exact == pytest.approx(closed, rel=0.4)
    assert (closed[4:] < -0.1).all()


def test_bulldozing_holds_the_rover_on_a_side_slope(yutu2: Rover, slope: Any) -> None:
    """Forces are those of the integrals with side faces; the same weight needs less side slip, all the more in loose
    soil, where wheels are deep."""
    loose = MIDDLE - widths() * (1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    plan, drives = dataclasses.replace(BEND, legs=(Leg(2.0),)), {}
    for name in ("exact", "bulldozing"):
        world = world_of(yutu2, slope(0.0, 0.2), PHYSICS[name], loose)
        drives[name] = true_drive(world, plan)
        forces = by_integrals(world, drives[name], PHYSICS[name].model)
        assert column(drives[name], "lateral_force_n") == pytest.approx(forces.lateral_force_n, rel=1e-5, abs=1e-5)
    assert (by_integrals(world, drives["exact"], PHYSICS["bulldozing"].model).lateral_force_n
            < column(drives["exact"], "lateral_force_n") - 0.01).all()  # fmt: skip
    weight = [column(driven, "lateral_force_n").sum(axis=1).mean() for driven in drives.values()]
    assert weight[1] == pytest.approx(weight[0], rel=0.02)
    slid = [abs(driven.poses[-1, 1]) for driven in drives.values()]
    assert slid[0] > 0.02
    assert slid[1] < 0.99 * slid[0], slid


def test_wheels_that_follow_in_a_rut_deepen_it_by_less_than_a_quarter(yutu2: Rover, slope: Any) -> None:
    """Middle wheels load again what the front wheels pressed, by the line of Wong; the way back is along the ruts."""
    plan = dataclasses.replace(BEND, legs=(Leg(2.0),))
    world = world_of(yutu2, slope(), PHYSICS["multipass"], MIDDLE)
    there = true_drive(world, plan)
    fresh = true_drive(world_of(yutu2, slope(), PHYSICS["exact"], MIDDLE), plan)
    # When all wheels are in the ruts of those before them.
    first, middle, last = (column(there, "sinkage_m")[8:, 2 * k].mean() for k in range(3))
    assert first == pytest.approx(column(fresh, "sinkage_m")[8:, 0].mean(), rel=0.02)
    stiffness = soil_of(MIDDLE).vector()[0]
    rut = ContactModel(rut_m=first, reload_n_m3=stiffness, reload_rise_n_m4=RISE_N_M4)
    risen = first - stiffness * first / (stiffness + RISE_N_M4 * first)
    slip = column(there, "slip_ratio")[8:, 2].mean()
    normal = integrated_forces(yutu2.wheel, soil_of(MIDDLE), middle - risen, slip, 0.0, rut).normal_force_n
    assert normal == pytest.approx(column(there, "normal_force_n")[8:, 2].mean(), rel=0.03)
    back = dataclasses.replace(plan, legs=(Leg(2.0, 0.0, 180.0),), x_m=there.poses[-1, 0], y_m=there.poses[-1, 1])
    again = true_drive(world, back)
    passes = [first, middle, last, *(column(again, "sinkage_m")[8:, 2 * k].mean() for k in (2, 1, 0))]
    assert first < middle < last < passes[5] and (np.diff(passes) < 0.25 * first).all(), passes


def test_ruts_are_as_wide_as_the_wheel(slope: Any) -> None:
    ruts = fresh_ruts(slope())
    press(ruts, np.array([[x, 0.0, 0.0, 1.0, 0.01] for x in np.arange(0.0, 1.0, 0.01)]), 0.15)
    left = np.array([0.0, 1.0, 0.0])
    below = [rut_below(ruts, 0.5, y, left, 0.15, ACROSS) for y in (0.0, 0.075, 0.2)]
    assert below[0] == pytest.approx(0.01, rel=0.1)
    assert below[1] == pytest.approx(0.005, rel=0.35)
    assert below[2] == 0.0


def test_changing_soils_vary_as_stated(slope: Any) -> None:
    """Mean 0, variance 1, and exp(-1/2) between places one correlation length, 2 m, apart."""
    fields = np.stack([smooth_fields(slope(), seed) for seed in range(40)]).transpose(0, 3, 1, 2)
    one, other = fields[..., 16, 8].ravel(), fields[..., 16, 16].ravel()
    assert one.mean() == pytest.approx(0.0, abs=0.15)
    assert (one**2).mean() == pytest.approx(1.0, abs=0.2)
    assert (one * other).mean() == pytest.approx(np.exp(-0.5), abs=0.15)
