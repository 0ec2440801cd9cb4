"""A mass that is wrong: what of a soil depends on it, and whether motion could tell."""

import dataclasses

import numpy as np
import pytest

from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict

PLAN = Plan(name="arcs", legs=(Leg(1.5, 0.15), Leg(1.0, -0.13)), speed_m_s=0.05)
SOIL = {"stiffness_kpa_m_n": 900.0, "cohesion_pa": 600.0}


def heavier(rover: Rover, factor: float) -> Rover:
    return dataclasses.replace(
        rover,
        body_kg=factor * rover.body_kg,
        wheel_kg=factor * rover.wheel_kg,
        body_inertia_kg_m2=tuple(factor * moment for moment in rover.body_inertia_kg_m2),  # type: ignore[arg-type]
        joint_damping_n_m_s=factor * rover.joint_damping_n_m_s,
    )


@pytest.mark.parametrize("factor", [0.6, 1.4])
def test_a_heavier_rover_on_stiffer_soil_of_more_cohesion_drives_alike(yutu2: Rover, factor: float) -> None:
    """Stresses are proportional to stiffness and cohesion together, and so are all forces of the wheels."""
    ground = synthetic_longji()
    light = predict(yutu2, ground.with_soil(**SOIL), PLAN, sweep=())
    scaled = {name: factor * value for name, value in SOIL.items()}
    heavy = predict(heavier(yutu2, factor), ground.with_soil(**scaled), PLAN, sweep=())
    assert light.finished.all() and heavy.finished.all()
    assert np.abs(heavy.paths[..., :2] - light.paths[..., :2]).max() < 1e-3
    for name, alike in (("slip_ratio", 2e-3), ("sinkage_m", 2e-4), ("side_slip_deg", 0.1)):
        column = STATE_COLUMNS.index(name)
        assert np.abs(heavy.states[0, 5:, :, column] - light.states[0, 5:, :, column]).max() < alike
    load = STATE_COLUMNS.index("normal_force_n")
    ratio = heavy.states[0, 5:, :, load].sum(axis=1) / light.states[0, 5:, :, load].sum(axis=1)
    assert ratio == pytest.approx(factor, rel=1e-2)
    # On the soil as it was the heavier rover sinks otherwise: a drive tells the ratio, not the mass.
    other = predict(heavier(yutu2, factor), ground.with_soil(**SOIL), PLAN, sweep=())
    column = STATE_COLUMNS.index("sinkage_m")
    assert abs(float(np.median(other.states[0, 5:, :, column] / light.states[0, 5:, :, column])) - 1.0) > 0.1
