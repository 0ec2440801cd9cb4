"""Bad starts, absurd numbers and long plans end with a stated outcome or a refusal, in bounded time."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Fixes, Leg, Plan, parse_sweep
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.simulation.members import drive
from lunarsci.twin.simulation.settle import balance

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


def cliff(soil: Soil) -> Terrain:
    x = np.arange(-2.0, 12.01, 0.1)
    return build_terrain("cliff", -2.0, -4.0, 0.1, np.repeat(np.where(x > 0.5, -5.0, 0.0)[None, :], 81, axis=0), soil)


def test_a_start_where_no_rover_can_stand_is_no_drive(yutu2: Rover, longji_soil: Soil, slope: GradientTerrain) -> None:
    starts = {
        "hole in the terrain": (missing(slope(), slice(14, 19), slice(6, 11)), 0.0),
        "left the terrain": (slope(), 50.0),
        "cliff": (cliff(longji_soil), 0.0),
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
        with pytest.raises(ParameterError, match=r"give at least 0\.001 m/s"):
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
    before = len(drive.signatures), len(balance.signatures)
    for plan in (*plans, plan_of(Leg(stop_s=1.0))):
        assert outcome(predict(yutu2, slope(), plan, sweep=())) == "finished"
    assert (len(drive.signatures), len(balance.signatures)) == before


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
