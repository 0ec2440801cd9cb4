"""The outside judge of the twin against statics by hand, symmetry, its own limits and its step."""

import dataclasses
import math

import numpy as np
import pytest
from quasi_static import QuasiStatic, _ground, draw_physics, drive, law_of, motion, wheel_commands
from quasi_static_forces import height_of, wheel_forces

from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS

SOIL = dataclasses.asdict(read_soil("longji")) | {"sinkage_exponent_slip": 0.2}
PLAIN = QuasiStatic()


def plan_of(*legs: Leg, **changes: float) -> Plan:
    return Plan(name="test", legs=legs, **({"speed_m_s": 0.05} | changes))


def column(driven, name):  # type: ignore[no-untyped-def]
    return driven.states[..., STATE_COLUMNS.index(name)]


def bumpy(sign: float = 1.0) -> Terrain:
    x, y = np.arange(-2.0, 6.01, 0.1)[None, :], sign * np.arange(-4.0, 4.01, 0.1)[:, None]
    height = 0.06 * np.sin(1.7 * x + 0.9 * y + 0.4) + 0.03 * np.cos(2.9 * y - 1.1 * x)
    return build_terrain("bumpy", -2.0, -4.0, 0.1, height, Soil(**SOIL))


@pytest.mark.parametrize(("along", "across"), [(0.0, 0.0), (math.tan(math.radians(10.0)), 0.0), (-0.1, 0.15)])
def test_forces_balance_on_a_plane_by_hand(yutu2: Rover, slope, along: float, across: float) -> None:  # type: ignore[no-untyped-def]
    driven = drive(yutu2, slope(along, across), plan_of(Leg(0.2)), SOIL, PLAIN)
    assert driven.finished
    normal, pull, side = (column(driven, f"{name}_n") for name in ("normal_force", "drawbar_pull", "lateral_force"))
    weight, steepness = yutu2.mass_kg * yutu2.gravity_m_s2, math.hypot(along, across)
    up = 1.0 / math.sqrt(1.0 + steepness**2)
    np.testing.assert_allclose(normal.sum(axis=1), weight * up, rtol=1e-7)
    np.testing.assert_allclose(np.hypot(pull.sum(axis=1), side.sum(axis=1)), weight * steepness * up, atol=1e-6)
    if across == 0.0:
        np.testing.assert_allclose(pull.sum(axis=1), weight * along * up, atol=1e-6)


@pytest.mark.parametrize("along", [0.0, math.tan(math.radians(10.0))])
def test_moments_balance_by_hand(yutu2: Rover, slope, along: float) -> None:  # type: ignore[no-untyped-def]
    """In the plane of travel, of the whole rover about its origin and of a bogie about its pivot."""
    driven = drive(yutu2, slope(along), plan_of(Leg(0.2)), SOIL, PLAIN)
    normal, pull, torque, x, sinkage = (
        column(driven, name)[-1, ::2]
        for name in ("normal_force_n", "drawbar_pull_n", "resistance_torque_nm", "x_m", "sinkage_m")
    )
    up = 1.0 / math.hypot(1.0, along)
    z = along * x + (yutu2.wheel.radius_m - sinkage) / up
    ahead, lift = up * (pull - along * normal), up * (normal + along * pull)
    lift -= yutu2.wheel_kg * yutu2.gravity_m_s2
    pose = driven.poses[-1]
    swing = yutu2.body_center_m[2] * math.sin(math.radians(pose[4])) * yutu2.body_kg * yutu2.gravity_m_s2
    whole = ((z - pose[2]) * ahead - (x - pose[0]) * lift - torque).sum() + 0.5 * swing
    assert whole == pytest.approx(0.0, abs=1e-6)
    beam = np.array([x[1] - x[2], z[1] - z[2]])
    height = -yutu2.middle_wheel_m[2]
    pivot = np.array([x[1:].mean(), z[1:].mean()]) + height * np.array([-beam[1], beam[0]]) / np.hypot(*beam)
    bogie = ((z - pivot[1]) * ahead - (x - pivot[0]) * lift - torque)[1:].sum()
    assert bogie == pytest.approx(0.0, abs=1e-6)
    assert normal[0] != pytest.approx(normal[1], rel=1e-3)


def test_slip_is_small_on_level_ground(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    driven = drive(yutu2, slope(), plan_of(Leg(0.3)), SOIL, PLAIN)
    slip = column(driven, "slip_ratio")
    assert slip.min() > 0.0 and slip.max() < 0.03
    assert abs(column(driven, "side_slip_deg")).max() < 1e-6
    assert driven.poses[-1, 0] == pytest.approx(0.3 * (1.0 - slip.mean()), rel=1e-3)


@pytest.mark.parametrize("legs", [(Leg(0.5, 0.3), Leg(0.3, -0.4)), (Leg(0.4, 0.2, 180.0), Leg(0.3, crab_deg=30.0)),
                                  (Leg(0.2), Leg(turn_deg=20.0), Leg(stop_s=10.0), Leg(0.2))])  # fmt: skip
def test_a_mirrored_drive_is_the_mirror_of_the_drive(yutu2: Rover, legs: tuple[Leg, ...]) -> None:
    there = drive(yutu2, bumpy(), plan_of(*legs), SOIL, PLAIN)
    flipped = [
        dataclasses.replace(leg, curvature_per_m=-leg.curvature_per_m, crab_deg=-leg.crab_deg, turn_deg=-leg.turn_deg)
        for leg in legs
    ]
    mirror = drive(yutu2, bumpy(-1.0), plan_of(*flipped), SOIL, PLAIN)
    assert there.finished and mirror.finished
    np.testing.assert_allclose(mirror.poses * (1, -1, 1, -1, 1, -1), there.poses, atol=1e-8)
    np.testing.assert_allclose(mirror.poses[:, :3] * (1, -1, 1), there.poses[:, :3], atol=1e-9)


def test_the_step_converges(yutu2: Rover) -> None:
    ends = [
        drive(yutu2, bumpy(), plan_of(Leg(0.8, 0.3), blend_m=0.0), SOIL, QuasiStatic(step_m=step)).poses[-1, :2]
        for step in (0.02, 0.01, 0.0025)
    ]
    off = [float(np.hypot(*(end - ends[2]))) for end in ends]
    assert off[0] < 5e-4 and off[1] < 0.6 * off[0]


@pytest.mark.parametrize("peak", [0.05, 0.3, 0.6])
def test_a_smooth_wheel_that_hardly_sinks_meets_bekker(yutu2: Rover, peak: float) -> None:
    """Without shear and with N = 1 the load is the integral of K_s z over the chord where the peak is at the bottom.

    Elsewhere the stress behind the peak is the mirrored one, so 2/3 goes over to (2/3 - c + c^3/3)/(1 - c).
    """
    soil = SOIL | {"cohesion_pa": 0.0, "friction_angle_deg": 0.0, "sinkage_exponent_slip": 0.0}
    smooth = dataclasses.replace(yutu2, wheel=dataclasses.replace(yutu2.wheel, grouser_height_m=0.0))
    law, z = law_of(smooth, soil, QuasiStatic(peak_c1=peak, peak_c2=0.0, rebound=0.0, nodes=20)), 1e-6
    fn, fx, fy, torque, over, about = wheel_forces(law, z, 0.05, 0.0, 0.05, 0.0)
    share = (2.0 / 3.0 - peak + peak**3 / 3.0) / (1.0 - peak)
    assert fn == pytest.approx(share * 1e3 * soil["stiffness_kpa_m_n"] * 0.15 * z * math.sqrt(2.0 * 0.15 * z), rel=1e-4)
    assert (fy, torque, over, about) == (0.0, 0.0, 0.0, 0.0)
    assert -math.acos(1.0 - z / 0.15) * fn < fx < 0.0


def test_shear_shares_one_ellipse_and_keeps_its_limits(yutu2: Rover) -> None:
    soil = SOIL | {"friction_angle_deg": 0.0, "external_friction_angle_deg": 0.0, "cohesion_pa": 1000.0}
    soil |= {"shear_modulus_mm": 1e-3, "lateral_modulus_mm": 1e-3, "stiffness_kpa_m_n": 1e-6}
    law = law_of(yutu2, soil, QuasiStatic(side_share=0.0, rebound=0.0))
    z, arc = 0.01, yutu2.wheel.shearing_radius_m * yutu2.wheel.width_m * math.acos(1.0 - 0.01 / 0.15)
    ahead = wheel_forces(law, z, 0.0, 0.0, 0.05, 0.0)
    aside = wheel_forces(law, z, 0.0, -0.05, 1e-9, 0.0)
    both = wheel_forces(law, z, 0.0, -0.05, 0.05, 0.0)
    assert ahead[3] == pytest.approx(1000.0 * arc * yutu2.wheel.shearing_radius_m, rel=1e-3)
    assert aside[2] == pytest.approx(1000.0 * arc, rel=1e-3)
    assert math.hypot(both[3] / ahead[3], both[2] / aside[2]) == pytest.approx(1.0, abs=1e-3)
    assert both[3] == pytest.approx(both[2] * yutu2.wheel.shearing_radius_m, rel=1e-3)


def test_the_side_face_adds_resistance_to_side_slip_alone(yutu2: Rover) -> None:
    with_face, without = (law_of(yutu2, SOIL, QuasiStatic(side_share=share)) for share in (1.0, 0.0))
    assert wheel_forces(with_face, 0.01, 0.05, 0.0, 0.05, 0.0) == wheel_forces(without, 0.01, 0.05, 0.0, 0.05, 0.0)
    left = [wheel_forces(law, 0.01, 0.05, 0.005, 0.05, 0.0)[2] for law in (with_face, without)]
    assert left[0] < left[1] < 0.0


def test_heights_are_those_of_the_terrain() -> None:
    terrain, random = synthetic_longji(spacing_m=0.2), np.random.default_rng(0)
    x, y = random.uniform(-2.0, 13.0, 50), random.uniform(-6.0, 8.0, 50)
    for way in ("smooth", "triangles"):
        laid = dataclasses.replace(terrain, interpolation=way)
        own = [height_of(_ground(laid), a, b) for a, b in zip(x, y, strict=True)]
        np.testing.assert_allclose(own, laid.height_at(x, y), atol=1e-12)


def test_commands_roll_without_side_slip(yutu2: Rover) -> None:
    """Each wheel's rim runs along its spoke's normal; with no soil to slip on the rover would follow the arc."""
    for leg in (Leg(1.0, 0.3), Leg(1.0, -0.2, 180.0), Leg(1.0, 0.1, 40.0), Leg(turn_deg=-90.0)):
        moved = motion(leg, yutu2, 0.05)
        steer, rims = (value[0] for value in wheel_commands(yutu2, moved[None]))
        x, y = yutu2.wheel_positions_m[:, :2].T
        wanted = np.stack([moved[0] - moved[2] * y, moved[1] + moved[2] * x])
        free = yutu2.steered_mask
        given = rims * np.stack([np.cos(steer), np.sin(steer)])
        np.testing.assert_allclose(given[:, free], wanted[:, free], atol=1e-12)
        np.testing.assert_allclose(given[0, ~free], wanted[0, ~free], atol=1e-12)
        assert abs(steer).max() <= 0.5 * math.pi + 1e-9


def test_other_ends(slope) -> None:  # type: ignore[no-untyped-def]
    """A four-wheeler drives by the same statics; the edge of the map ends a drive; physics are drawn within sources."""
    four = build_rover("small-four")
    driven = drive(four, slope(), plan_of(Leg(0.2, 0.5), Leg(stop_s=5.0), speed_m_s=0.04), SOIL, draw_physics(3))
    assert driven.finished
    assert column(driven, "normal_force_n")[-1].sum() == pytest.approx(four.mass_kg * four.gravity_m_s2, rel=1e-6)
    assert np.ptp(driven.poses[driven.time_s > 5.0 + 1e-9], axis=0).max() == 0.0
    assert drive(four, slope(), plan_of(Leg(0.2), x_m=9.8), SOIL, PLAIN).outcome == "left the map"
    drawn = [draw_physics(seed) for seed in range(30)]
    assert all(0.18 <= one.peak_c1 <= 0.43 for one in drawn) and len({one.rebound for one in drawn}) == 30
