"""The rover under way: commanded arcs, balances of force, convergence in the time step, and every way to end."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.judgement.tables import state_table
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.plan import Plan, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

WEIGHT = 135.0 * 1.622


def column(prediction: Prediction, name: str) -> np.ndarray:
    """Values of the six wheels at the end of the drive."""
    return prediction.states[0, -1, :, STATE_COLUMNS.index(name)]


@pytest.mark.parametrize("curvature", [0.0, 0.154, -0.138])
def test_without_slip_the_rover_drives_the_commanded_arc(yutu2, longji_soil, slope, straight, curvature) -> None:  # type: ignore[no-untyped-def]
    """Ground that shears at no displacement, wheels without grousers: rolling without slip is the only balance."""
    rover = dataclasses.replace(yutu2, wheel=dataclasses.replace(yutu2.wheel, grouser_height_m=0.0))
    grip = longji_soil.replace(
        stiffness_kpa_m_n=1e6, shear_modulus_mm=0.02, lateral_modulus_mm=0.02, external_friction_angle_deg=42.0
    )
    plan = straight(6.0, curvature)
    result = predict(rover, slope(soil=grip), plan, sweep=())
    assert result.outcome_text(0) == "finished"
    turn = 6.0 * curvature
    exact = (math.sin(turn) / curvature, (1 - math.cos(turn)) / curvature) if curvature else (6.0, 0.0)
    assert result.endpoints_m[0] == pytest.approx(exact, abs=6e-3)
    assert result.paths[0, -1, 5] == pytest.approx(math.degrees(turn), abs=0.1)


@pytest.mark.parametrize("gradient", [0.0, -0.1, 0.08])
def test_steady_drive_on_a_slope_balances_the_weight(yutu2, longji_soil, slope, straight, gradient) -> None:  # type: ignore[no-untyped-def]
    result = predict(yutu2, slope(gradient), straight(5.0), sweep=(), ruts=False)
    angle = math.atan(gradient)
    assert column(result, "normal_force_n").sum() == pytest.approx(WEIGHT * math.cos(angle), rel=1e-4)
    assert column(result, "drawbar_pull_n").sum() == pytest.approx(WEIGHT * math.sin(angle), abs=2e-3)
    assert np.abs(column(result, "lateral_force_n")).max() < 1e-6
    # The same balance from the wheel formulas alone: at these sinkages one slip ratio carries the rover.
    sinkage = column(result, "sinkage_m")

    def surplus(slip: float) -> float:
        forces = closed_form_forces(yutu2.wheel, longji_soil, sinkage, slip)
        return float(forces.drawbar_pull_n.sum()) - WEIGHT * math.sin(angle)

    assert column(result, "slip_ratio") == pytest.approx(np.full(6, brentq(surplus, -0.5, 0.5)), abs=1e-4)


def test_recorded_forces_are_those_of_the_recorded_states(yutu2, longji_soil, slope, straight) -> None:  # type: ignore[no-untyped-def]
    result = predict(yutu2, slope(-0.05, 0.03), straight(4.0, 0.1), sweep=(), ruts=False)
    forces = closed_form_forces(
        yutu2.wheel, longji_soil, *(column(result, name) for name in ("sinkage_m", "slip_ratio", "side_slip_deg"))
    )
    assert column(result, "drawbar_pull_n") == pytest.approx(forces.drawbar_pull_n, abs=1e-9)
    assert column(result, "lateral_force_n") == pytest.approx(forces.lateral_force_n, abs=1e-9)
    assert column(result, "resistance_torque_nm") == pytest.approx(forces.resistance_torque_nm, abs=1e-9)
    # The touch-down damping is in the recorded normal force: 400 N s/m at fractions of a mm/s.
    assert column(result, "normal_force_n") == pytest.approx(forces.normal_force_n, abs=0.3)


def test_a_side_slope_pushes_downhill_and_the_lateral_force_holds_against_it(yutu2, slope, straight) -> None:  # type: ignore[no-untyped-def]
    result = predict(yutu2, slope(0.0, 0.03), straight(5.0), sweep=(), ruts=False)
    assert result.endpoints_m[0, 1] < -0.05
    assert (column(result, "side_slip_deg") < 0).all()
    assert column(result, "lateral_force_n").sum() == pytest.approx(-WEIGHT * 0.03, rel=0.02)


@pytest.mark.parametrize("gradient", [(0.0, 0.1), (0.05, 0.1), (-0.1, -0.05)])
def test_steady_drive_across_a_slope_balances_all_moments(yutu2: Rover, slope, straight, gradient) -> None:  # type: ignore[no-untyped-def]
    """About the centre of mass, so that the weight has no moment. F_L acts at the middle of the triangle of stress, a
    third of the sum of its angles, M_R about the axle. The chassis tilts by 0.3 deg as wheels sink unequally, which
    moves levers about x and y by millimetres, and those about the normal hardly."""
    result = predict(yutu2, slope(*gradient), straight(4.0), sweep=(), ruts=False)
    z, normal, pull, side, torque = (
        column(result, name)
        for name in ("sinkage_m", "normal_force_n", "drawbar_pull_n", "lateral_force_n", "resistance_torque_nm")
    )
    arms = yutu2.wheel_positions_m
    body, wheels = yutu2.body_kg * np.array(yutu2.body_center_m), yutu2.wheel_kg * arms.sum(axis=0)
    arms = arms - (body + wheels) / yutu2.mass_kg
    middle = 1.5 * np.arccos(1.0 - z / 0.15) / 3.0  # theta_1, theta_1 / 2, and 0 behind the wheel
    ahead, below = (yutu2.wheel.shearing_radius_m * of(middle) for of in (np.sin, np.cos))
    forces, own = np.column_stack([pull, -side, normal]), np.column_stack([-below * side, -torque, -ahead * side])
    by_forces, by_moments = np.cross(arms, forces).sum(axis=0), own.sum(axis=0)
    assert abs(by_moments[2]) > 0.25
    assert by_forces == pytest.approx(-by_moments, rel=0.04)
    assert by_forces[2] == pytest.approx(-by_moments[2], rel=0.01)


def test_the_end_converges_with_first_order_in_the_time_step(yutu2) -> None:  # type: ignore[no-untyped-def]
    terrain, plan = synthetic_longji(rms_m=0.0), read_plan()
    steps = np.array([0.2, 0.1, 0.05, 0.025])
    ends = [predict(yutu2, terrain, plan, sweep=(), time_step_s=dt).endpoints_m[0] for dt in (*steps, 0.003125)]
    errors = np.array([np.hypot(*(end - ends[-1])) for end in ends[:-1]])
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 0.8 < slope < 1.3, (slope, errors)
    assert errors[1] < 1.5e-3, "the default step of 0.1 s must hold the end of the embedded plan to 1.5 mm"


def hill(soil: Soil):  # type: ignore[no-untyped-def]
    """Level, then ever steeper downhill: 65 deg after 5 m."""
    x = np.arange(-2.0, 12.01, 0.1)
    down = np.cumsum(np.tan(np.radians(np.clip(20.0 * (x - 1.0), 0.0, 75.0)))) * 0.1
    return build_terrain("hill", -2.0, -4.0, 0.1, np.repeat(-down[None, :], 81, axis=0), soil)


def cliff(soil: Soil):  # type: ignore[no-untyped-def]
    x = np.arange(-2.0, 12.01, 0.1)
    return build_terrain("cliff", -2.0, -4.0, 0.1, np.repeat(np.where(x > 2.0, -5.0, 0.0)[None, :], 81, axis=0), soil)


def holed(soil: Soil):  # type: ignore[no-untyped-def]
    height = np.zeros((81, 141))
    height[30:50, 40:45] = np.nan
    return build_terrain("holed", -2.0, -4.0, 0.1, height, soil)


@pytest.mark.parametrize(
    ("ground", "expected"),
    [(hill, "overturned"), (cliff, "cliff"), (holed, "hole in the terrain")],
)
@pytest.mark.parametrize("x_m", [0.0, 0.0025, 0.005])
def test_bad_ground_ends_the_drive_with_its_reason(yutu2, longji_soil, straight, ground, expected, x_m) -> None:  # type: ignore[no-untyped-def]
    """The cliff, between nodes, begins with a wall, which can load a wheel with more than any drive."""
    result = predict(yutu2, ground(longji_soil), dataclasses.replace(straight(8.0), x_m=x_m))
    assert result.outcome_text(0).split(":")[0] == expected
    assert 0 < result.recorded[0] < len(result.distance_m)
    assert np.isfinite(result.paths).all() and np.isfinite(result.states).all()
    # Beyond the end the last sample is repeated.
    assert (result.paths[0, result.recorded[0] :] == result.paths[0, result.recorded[0] - 1]).all()


def test_the_edge_of_the_map_ends_the_drive(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    result = predict(yutu2, slope(), straight(15.0), sweep=())
    assert result.outcome_text(0).startswith("left the terrain")
    # The front wheels are 0.5 m ahead of the origin, the map ends at 10 m.
    assert result.endpoints_m[0, 0] == pytest.approx(9.5, abs=0.15)


@pytest.mark.parametrize(
    "soil",
    [
        {"stiffness_kpa_m_n": 1e-6},
        {"stiffness_kpa_m_n": 1e15},
        {"sinkage_exponent": 60.0},
        {"sinkage_exponent_slip": 1e3},
        {"friction_angle_deg": 89.9999},
        {"shear_modulus_mm": 1e-12, "lateral_modulus_mm": 1e-12},
        {"cohesion_pa": 1e12},
        {"cohesion_pa": 0.0, "friction_angle_deg": 0.0, "external_friction_angle_deg": 0.0},
    ],
)
def test_absurd_soil_has_a_stated_outcome(yutu2: Rover, slope, straight, soil: dict[str, float]) -> None:  # type: ignore[no-untyped-def]
    result = predict(yutu2, slope(-0.05).with_soil(**soil), straight(2.0), sweep=())
    assert result.outcome_text(0) in OUTCOMES
    assert np.isfinite(result.paths).all() and np.isfinite(result.states).all()


def test_a_four_wheeler_drives_its_arc(slope, straight) -> None:  # type: ignore[no-untyped-def]
    rover = build_rover("small-four")
    result = predict(rover, slope(), straight(3.0, 0.2, speed_m_s=0.04), sweep=())
    assert result.outcome_text(0) == "finished"
    assert result.states.shape[2] == len(rover.wheels) == 4
    exact = (math.sin(0.6) / 0.2, (1 - math.cos(0.6)) / 0.2)
    assert result.endpoints_m[0] == pytest.approx(exact, abs=0.15)
    weight = rover.mass_kg * rover.gravity_m_s2
    assert column(result, "normal_force_n").sum() == pytest.approx(weight, rel=1e-3)
    assert set(state_table(result)["wheel"]) == {"FL", "FR", "RL", "RR"}


def test_a_slope_that_does_not_hold_the_rover_is_a_fall(yutu2: Rover, longji_soil: Soil, slope, straight) -> None:  # type: ignore[no-untyped-def]
    """35 deg, above the friction angle: with what grip there is it passes 1 m/s."""
    loose = longji_soil.replace(friction_angle_deg=20.0, cohesion_pa=0.0)
    result = predict(yutu2, slope(-math.tan(math.radians(35.0)), soil=loose), straight(2.0), sweep=())
    assert result.outcome_text(0).startswith("fell")
    assert np.isfinite(result.paths).all()


def test_steps_of_1_ms_and_of_half_a_second(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    assert predict(yutu2, slope(), straight(0.1), sweep=(), time_step_s=0.001).outcome_text(0) == "finished"
    with pytest.raises(ParameterError, match=r"time_step_s is 0\.5.*0\.2"):
        predict(yutu2, slope(), straight(0.1), sweep=(), time_step_s=0.5)
    with pytest.raises(ParameterError, match="speed above 0"):
        straight(1.0, speed_m_s=0.0)
    with pytest.raises(ParameterError, match="length is zero"):
        Plan(name="nothing", legs=(), speed_m_s=0.05)
