"""The rover under way: commanded arcs, balances of force, convergence in the time step, and every way to end.

Bad starts, absurd numbers and long plans end with a stated outcome or a refusal, in bounded time.

Rest is rest: halts change nothing, small changes stay small, and what a step does not hold is said.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.prior import PARAMETERS, default_prior, values_of
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.judgement.tables import state_table
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Fixes, Leg, Plan, parse_sweep, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.simulation.members import drive
from lunarsci.twin.simulation.settle import balance

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


def cliff(soil: Soil, edge_m: float = 2.0) -> Terrain:
    x = np.arange(-2.0, 12.01, 0.1)
    return build_terrain(
        "cliff", -2.0, -4.0, 0.1, np.repeat(np.where(x > edge_m, -5.0, 0.0)[None, :], 81, axis=0), soil
    )


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


def test_a_rover_that_is_to_drive_fast_does_not_fall(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    fast = dataclasses.replace(yutu2, max_speed_m_s=2.0, motors=None)
    result = predict(fast, slope(), straight(2.0, speed_m_s=1.2), sweep=(), time_step_s=0.02)
    assert result.outcome_text(0) == "finished"


def test_steps_of_1_ms_and_of_half_a_second(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    assert predict(yutu2, slope(), straight(0.1), sweep=(), time_step_s=0.001).outcome_text(0) == "finished"
    with pytest.raises(ParameterError, match=r"time_step_s is 0\.5.*0\.2"):
        predict(yutu2, slope(), straight(0.1), sweep=(), time_step_s=0.5)
    with pytest.raises(ParameterError, match=r"speed_m_s is 0; give 0\.001 or more"):
        straight(1.0, speed_m_s=0.0)
    with pytest.raises(ParameterError, match="length is zero"):
        Plan(name="nothing", legs=(), speed_m_s=0.05)


GradientTerrain = Callable[..., Terrain]
TAN_20 = math.tan(math.radians(20.0))


def plan_of(*legs: Leg, **changes: object) -> Plan:
    return Plan(name="test", legs=legs, **({"speed_m_s": 0.05} | changes))  # type: ignore[arg-type]


def outcome(result: Prediction) -> str:
    assert result.outcome_text(0) in OUTCOMES
    assert np.isfinite(result.paths).all() and np.isfinite(result.states).all()
    return result.outcome_text(0).split(":")[0]


def missing(terrain: Terrain, rows: slice, columns: slice) -> Terrain:
    terrain.height_m[rows, columns] = np.nan
    return terrain


def test_a_start_where_no_rover_can_stand_is_no_drive(yutu2: Rover, longji_soil: Soil, slope: GradientTerrain) -> None:
    starts = {
        "hole in the terrain": (missing(slope(), slice(14, 19), slice(6, 11)), 0.0),
        "left the terrain": (slope(), 50.0),
        "cliff": (cliff(longji_soil, 0.5), 0.0),
    }
    for expected, (terrain, x) in starts.items():
        result = predict(yutu2, terrain, plan_of(Leg(1.0), x_m=x), sweep=())
        assert outcome(result) == expected
        assert result.recorded[0] == 0 and (result.paths[0, :, 0] == x).all() and not result.states.any()


def test_missing_heights_in_a_corner_matter_only_there(yutu2: Rover, slope: GradientTerrain) -> None:
    holed = missing(slope(), slice(0, 3), slice(0, 3))
    here, whole = (predict(yutu2, ground, plan_of(Leg(1.0)), sweep=()) for ground in (holed, slope()))
    assert outcome(here) == "finished" and np.array_equal(here.paths, whole.paths)
    into = predict(yutu2, holed, plan_of(Leg(4.0), heading_deg=-120.0), sweep=())
    assert outcome(into) == "hole in the terrain" and 0 < into.recorded[0] < len(into.time_s)


def test_a_map_of_three_by_three_nodes_is_driven_like_a_large_one(
    yutu2: Rover, longji_soil: Soil, slope: GradientTerrain
) -> None:
    x = np.array([-10.0, 0.0, 10.0])
    small = build_terrain("small", -10.0, -10.0, 10.0, -0.1 * x[None, :] + 0.05 * x[:, None], longji_soil)
    one, two = (predict(yutu2, ground, plan_of(Leg(3.0, 0.1)), sweep=()) for ground in (small, slope(-0.1, 0.05)))
    assert outcome(one) == "finished"
    assert one.paths == pytest.approx(two.paths, abs=1e-9)
    tiny = build_terrain("tiny", -0.1, -0.1, 0.1, np.zeros((3, 3)), longji_soil)
    assert outcome(predict(yutu2, tiny, plan_of(Leg(3.0)), sweep=())) == "left the terrain"


def test_a_speed_that_no_step_resolves_is_refused(yutu2: Rover, slope: GradientTerrain) -> None:
    for speed in (1e-6, 9e-4):
        with pytest.raises(ParameterError, match=r"give 0\.001 or more"):
            plan_of(Leg(0.1), speed_m_s=speed)
    # The slowest that is not: 5 cm uphill in 50 s, with the slip of a fast drive.
    result = predict(yutu2, slope(0.1), plan_of(Leg(0.05), speed_m_s=0.001), sweep=(), sample_m=0.01, ruts=False)
    fast = predict(yutu2, slope(0.1), plan_of(Leg(1.0)), sweep=(), ruts=False)
    assert outcome(result) == "finished"
    slips = [run.states[0, -1, :, STATE_COLUMNS.index("slip_ratio")] for run in (result, fast)]
    assert slips[0] == pytest.approx(slips[1], abs=1e-3)


@pytest.mark.parametrize("speed", [0.001, 0.003, 0.01, 0.05])
def test_a_halt_holds_at_any_speed_and_step(yutu2: Rover, slope: GradientTerrain, speed: float) -> None:
    """A minute of standing after a metre-long leg scaled to the speed: every step ends where the shortest does."""
    plan = plan_of(Leg(6.0 * speed), Leg(stop_s=60.0), speed_m_s=speed)
    steps = (0.2, 0.1, 0.02)
    results = [predict(yutu2, slope(0.1, 0.05), plan, sweep=(), time_step_s=dt, sample_m=0.1) for dt in (*steps, 0.005)]
    assert all(outcome(result) == "finished" for result in results)
    for result in results[:-1]:
        assert result.endpoints_m[0] == pytest.approx(results[-1].endpoints_m[0], abs=0.01)
        assert result.paths[0, -1, 5] == pytest.approx(results[-1].paths[0, -1, 5], abs=0.1)


@pytest.mark.parametrize("gradient", [TAN_20, -TAN_20])
def test_a_halt_on_20_deg_stands(yutu2: Rover, slope: GradientTerrain, gradient: float) -> None:
    """With phi = 42 deg the wheels hold; what creeps is the 3 mm a minute of the rims and as much again of shear."""
    result = predict(yutu2, slope(gradient), plan_of(Leg(0.5), Leg(stop_s=60.0)), sweep=())
    assert outcome(result) == "finished"
    stop = make_schedule(result.plan, yutu2).runs[1]
    still = (result.time_s > stop.begin_s + 3.0) & (result.time_s < stop.end_s)
    assert np.ptp(result.paths[0, still, 0]) < 0.01


ABSURD = [
    {"stiffness_kpa_m_n": 1e6},
    {"shear_modulus_mm": 0.05, "lateral_modulus_mm": 0.05},
    {"stiffness_kpa_m_n": 1e6, "shear_modulus_mm": 0.05, "lateral_modulus_mm": 0.05},
    {"stiffness_kpa_m_n": 1e15, "shear_modulus_mm": 1e-12},
    {"stiffness_kpa_m_n": 1.0},
]


@pytest.mark.parametrize("soil", ABSURD)
@pytest.mark.parametrize("gradient", [0.0, TAN_20])
def test_halts_on_absurd_soil_have_a_stated_outcome(
    yutu2: Rover, slope: GradientTerrain, soil: dict[str, float], gradient: float
) -> None:
    legs = (Leg(0.3), Leg(stop_s=20.0), Leg(turn_deg=30.0), Leg(0.3, 0.0, 180.0))
    result = predict(yutu2, slope(gradient, 0.05).with_soil(**soil), plan_of(*legs), sweep=())
    # Nothing falls where the steepest ground has 20 deg: if the step does not hold, that is what it says.
    assert outcome(result) in {"finished", "diverged", "did not settle"}


def test_a_long_plan_of_short_legs(yutu2: Rover, slope: GradientTerrain) -> None:
    arcs = plan_of(*(Leg(0.005, 0.3 * (-1) ** k) for k in range(1000)))
    result = predict(yutu2, slope(), arcs, sweep=(), time_step_s=0.2)
    assert outcome(result) == "finished" and result.endpoints_m[0, 0] == pytest.approx(4.88, abs=0.05)
    halts = plan_of(*(Leg(stop_s=1.0) for _ in range(1000)))
    still = predict(yutu2, slope(), halts, sweep=(), time_step_s=0.2)
    assert outcome(still) == "finished" and abs(still.endpoints_m[0, 0]) < 0.06


@pytest.mark.parametrize(("length_m", "legs", "sigma_m"), [(0.005, 100, 0.01), (0.1, 40, 0.05)])
def test_fixes_worse_than_a_leg_is_long_do_not_whirl_the_rover(
    yutu2: Rover, slope: GradientTerrain, length_m: float, legs: int, sigma_m: float
) -> None:
    plan = plan_of(*(Leg(length_m) for _ in range(legs)), fixes=Fixes(sigma_m, 0.1))
    result = predict(yutu2, slope(), plan, sweep=(), sample_m=0.05)
    assert outcome(result) == "finished"
    # No faster than twice the plan's speed, on a circle no tighter than the rover can drive.
    rate = np.diff(result.paths[0, :, 5]) / np.diff(result.time_s)
    assert np.abs(rate).max() < math.degrees(2.0 * 0.05 * yutu2.tightest_curvature_per_m)
    assert result.miss_m[0] < 5.0 * sigma_m


def test_every_kind_of_plan_drives_on_one_machine_code(yutu2: Rover, slope: GradientTerrain) -> None:
    """A drive compiled anew for another layout of its commands would take 10 s instead of 10 ms."""
    mixed = (Leg(0.1), Leg(stop_s=1.0), Leg(turn_deg=5.0), Leg(0.1))
    plans = [plan_of(*legs, **extra) for legs in (mixed, mixed[1:]) for extra in ({}, {"fixes": Fixes(0.01, 0.1)})]
    predict(yutu2, slope(), plan_of(Leg(0.1)), sweep=())
    before = len(drive.entries), len(balance.entries)
    for plan in (*plans, plan_of(Leg(stop_s=1.0))):
        assert outcome(predict(yutu2, slope(), plan, sweep=())) == "finished"
    assert (len(drive.entries), len(balance.entries)) == before


def test_sweeps_of_one_value(yutu2: Rover, slope: GradientTerrain) -> None:
    one = predict(yutu2, slope(), plan_of(Leg(0.5)), sweep=(parse_sweep("cohesion_pa=520:520:1"),))
    bare = predict(yutu2, slope(), plan_of(Leg(0.5)), sweep=())
    assert one.members == 1 and np.array_equal(one.paths, bare.paths)
    same = predict(yutu2, slope(), plan_of(Leg(0.5)), sweep=(parse_sweep("cohesion_pa=520:520:1"),), members=20)
    assert (same.paths == bare.paths).all()
    with pytest.raises(ParameterError, match="LOW < HIGH"):
        parse_sweep("cohesion_pa=520:520:3")


def test_joints_without_friction_drive_and_settle(yutu2: Rover, slope: GradientTerrain) -> None:
    """On a plane the joints do not move, so their friction has nothing to say; on waves it shifts the end by little."""
    loose = dataclasses.replace(yutu2, joint_damping_n_m_s=0.0)
    plan = plan_of(Leg(2.0, 0.1))
    one, two = (predict(rover, slope(-0.05, 0.05), plan, sweep=()) for rover in (loose, yutu2))
    assert outcome(one) == "finished" and one.paths == pytest.approx(two.paths, abs=2e-3)
    rough = synthetic_longji(rms_m=0.01, spacing_m=0.1)
    one, two = (predict(rover, rough, plan, sweep=()) for rover in (loose, yutu2))
    assert outcome(one) == "finished" and one.endpoints_m == pytest.approx(two.endpoints_m, abs=0.02)


@pytest.mark.parametrize(("rms_m", "spacing_m"), [(0.01, 0.05), (0.05, 0.05), (0.05, 0.02)])
def test_triangles_on_rough_ground(yutu2: Rover, rms_m: float, spacing_m: float) -> None:
    smooth = synthetic_longji(rms_m=rms_m, spacing_m=spacing_m)
    faceted = dataclasses.replace(smooth, interpolation="triangles")
    one, two = (predict(yutu2, ground, plan_of(Leg(3.0, 0.1)), sweep=()) for ground in (faceted, smooth))
    assert outcome(one) == "finished"
    assert np.hypot(*(one.endpoints_m - two.endpoints_m)[0]) < 0.05


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
