"""What physics demands of slip, side slip and sinkage as soil and slope change.

A mass that is wrong: what of a soil depends on it, and whether motion could tell.
"""

import dataclasses
import math

import numpy as np
import pytest

from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.plans.plan import Leg, Plan, parse_sweep
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict


def steady(prediction: Prediction, name: str) -> np.ndarray:
    """Mean over the wheels at the end of each member's drive."""
    assert prediction.finished.all()
    return np.asarray(prediction.states[:, -1, :, STATE_COLUMNS.index(name)].mean(axis=1))


def test_a_rover_skids_downhill_and_slips_uphill(yutu2, slope, straight) -> None:  # type: ignore[no-untyped-def]
    gradients = (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1)
    slips = [steady(predict(yutu2, slope(g), straight(3.0), sweep=(), ruts=False), "slip_ratio")[0] for g in gradients]
    assert (np.diff(slips) > 0).all()
    assert slips[1] < 0.0 < slips[3] < slips[4]


def test_more_friction_needs_less_slip_uphill_and_less_skid_downhill(yutu2, slope, straight) -> None:  # type: ignore[no-untyped-def]
    sweep = (parse_sweep("friction_angle_deg=25:55:4"),)
    up = steady(predict(yutu2, slope(0.1), straight(3.0), sweep=sweep, ruts=False), "slip_ratio")
    assert (np.diff(up) < 0).all() and (up > 0).all()
    down = steady(predict(yutu2, slope(-0.2), straight(3.0), sweep=sweep, ruts=False), "slip_ratio")
    assert (np.diff(down) > 0).all() and (down < 0).all()


def test_side_slip_grows_with_the_lateral_modulus_and_with_the_slope(yutu2, slope, straight) -> None:  # type: ignore[no-untyped-def]
    sweep = (parse_sweep("lateral_modulus_mm=15:45:3"),)
    gentle, steep = (
        steady(predict(yutu2, slope(0.0, tilt), straight(3.0), sweep=sweep, ruts=False), "side_slip_deg")
        for tilt in (0.03, 0.06)
    )
    # Rising to the left pushes to the right; a modulus three times as long lets it slip three times as far.
    assert (np.diff(gentle) < 0).all() and (steep < gentle).all() and (gentle < 0).all()
    assert gentle[-1] / gentle[0] == pytest.approx(3.0, rel=0.02)


def test_sinkage_falls_with_stiffness_as_the_pressure_law_says(yutu2, slope, straight) -> None:  # type: ignore[no-untyped-def]
    """F_N grows with K_s z^(N + 1/2): at N = 1, eight times the stiffness sinks a quarter as deep."""
    sweep = (parse_sweep("stiffness_kpa_m_n=400:3200:3"),)
    sinkage = steady(predict(yutu2, slope(), straight(2.0), sweep=sweep, ruts=False), "sinkage_m")
    assert (np.diff(sinkage) < 0).all()
    assert sinkage[0] / sinkage[-1] == pytest.approx(4.0, rel=0.05)


def test_a_climb_at_large_slip_balances_and_its_end_settles_with_the_step(yutu2, slope, straight) -> None:  # type: ignore[no-untyped-def]
    """Where the step damps the slip most its steady state is still Newton's: sum F_DP = W sin a, sum F_N = W cos a."""
    angle = math.radians(24.0)
    runs = [
        predict(yutu2, slope(math.tan(angle)), straight(1.0), sweep=(), time_step_s=step, ruts=False)
        for step in (0.1, 0.05, 0.025)
    ]
    weight = yutu2.mass_kg * yutu2.gravity_m_s2
    slips = [steady(run, "slip_ratio")[0] for run in runs]
    assert slips[0] > 0.4 and slips == pytest.approx(3 * [slips[0]], rel=1e-6)
    for run in runs:
        assert 6 * steady(run, "drawbar_pull_n")[0] == pytest.approx(weight * math.sin(angle), rel=1e-6)
        assert 6 * steady(run, "normal_force_n")[0] == pytest.approx(weight * math.cos(angle), rel=1e-6)
    coarse, middle, fine = (run.endpoints_m[0, 0] for run in runs)
    assert (coarse - middle) / (middle - fine) == pytest.approx(2.0, abs=0.2), "an error of first order"
    assert abs(coarse - fine) < 0.003


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
