"""Closed-form forces against quadrature of a triangular stress, published numbers, limits and measured wheels."""

import csv
import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import (
    MOST_COHESION,
    closed_form_forces,
    cohesion_share,
    contact_forces,
    slip_ratio,
    stress_moments,
    travel_ratio,
)
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.traction import sinkage_under_load
from lunarsci.regolith.wheel import SHEAR_SIGNS, Wheel

WHEEL = Wheel(radius_m=0.15, width_m=0.15, grouser_height_m=0.008, grouser_shear_coefficient=0.65)
SOIL = Soil(
    stiffness_kpa_m_n=820,
    sinkage_exponent=1.0,
    cohesion_pa=520,
    friction_angle_deg=42,
    shear_modulus_mm=17.8,
    external_friction_angle_deg=12.4,
    lateral_modulus_mm=20,
)


def test_published_worked_state() -> None:
    """s 0.2, N 1, K_s 820, c 520, phi 42, z 12 mm, worked by an independent implementation."""
    found = closed_form_forces(WHEEL, SOIL, 0.012, 0.2)
    assert float(found.normal_force_n) == pytest.approx(35.82, abs=0.01)
    assert float(found.drawbar_pull_n) == pytest.approx(9.44, abs=0.01)
    assert float(found.resistance_torque_nm) == pytest.approx(2.557, abs=0.001)


@pytest.mark.parametrize(("theta_1", "theta_2", "theta_m"), [(0.33, 0.0, 0.165), (0.5, -0.1, 0.22)])
def test_moments_are_integrals_of_a_triangle(theta_1: float, theta_2: float, theta_m: float) -> None:
    def triangle(theta: float) -> float:
        return float(np.interp(theta, [theta_2, theta_m, theta_1], [0.0, 1.0, 0.0]))

    a, b, c = stress_moments(theta_1, theta_2, theta_m)
    for ours, weight in ((a, math.cos), (b, math.sin), (c, lambda _: 1.0)):
        assert ours == pytest.approx(
            quad(lambda t, w=weight: triangle(t) * w(t), theta_2, theta_1, points=[theta_m])[0], rel=1e-9
        )


def test_no_shear_strength_leaves_the_compaction_resistance() -> None:
    """Without cohesion and friction the drawbar pull is the rearward component of the normal stress."""
    slick = SOIL.replace(cohesion_pa=0, friction_angle_deg=0, external_friction_angle_deg=0)
    found = closed_form_forces(WHEEL, slick, 0.01, 0.3, 5.0)
    theta_1 = math.acos(0.14 / 0.15)
    peak = 820e3 * 0.15 * (math.cos(theta_1 / 2) - math.cos(theta_1))

    def stress(theta: float) -> float:
        return peak * float(np.interp(theta, [0, theta_1 / 2, theta_1], [0, 1, 0]))

    backward = quad(lambda t: stress(t) * math.sin(t), 0, theta_1, points=[theta_1 / 2])[0]
    assert float(found.drawbar_pull_n) == pytest.approx(-0.15 * 0.15 * backward, rel=1e-9)
    assert float(found.lateral_force_n) == 0
    assert float(found.resistance_torque_nm) == 0


HARDENING = SOIL.replace(sinkage_exponent=1.1, sinkage_exponent_slip=0.2)
"""At a slip of 0.2 its exponent is 1.14."""


def of_a_triangle(z: float, slip: float, beta_deg: float, peak: float) -> list[float]:
    """F_N, F_DP, F_L, M_R of `WHEEL` on `SOIL` in slip, of triangles with the tips of Eqs 12-17 at theta_m."""
    r, b, h, r_s = 0.15, 0.15, 0.008, 0.1552
    theta_1, theta_1e = math.acos(1 - z / r), math.acos((r - z) / (r + h))
    theta_m, travel = theta_1 / 2, 1 - slip
    j_x = r_s * ((theta_1e - theta_m) - travel * (math.sin(theta_1e) - math.sin(theta_m)))
    j_y = r * travel * math.tan(math.radians(beta_deg)) * (theta_1e - theta_m)
    tau_x = (520 + peak * math.tan(math.radians(42))) * (1 - math.exp(-j_x / 17.8e-3))
    tau_y = (520 + peak * math.tan(math.radians(12.4))) * (1 - math.exp(-j_y / 20e-3))

    def whole(weight: Callable[[float], float]) -> float:
        def of(t: float) -> float:
            return weight(t) * float(np.interp(t, [0, theta_m, theta_1], [0, 1, 0]))

        return float(b * quad(of, 0, theta_1, points=[theta_m])[0])

    return [
        whole(lambda t: r * peak * math.cos(t) + r_s * tau_x * math.sin(t)),
        whole(lambda t: r_s * tau_x * math.cos(t) - r * peak * math.sin(t)),
        whole(lambda _: r_s * tau_y),
        whole(lambda _: r_s**2 * tau_x),
    ]


def depth_at_the_peak(z: float) -> float:
    """How far the wheel has gone into the ground at the middle of its contact. [m]"""
    theta_1 = math.acos(1 - z / 0.15)
    return 0.15 * (math.cos(theta_1 / 2) - math.cos(theta_1))


@pytest.mark.parametrize("beta", [0.3, 5.0, 40.0])
def test_forces_are_integrals_of_triangular_stresses(beta: float) -> None:
    """The lateral displacement has r, the lever of the stress r_s; at 0.3 deg no displacement saturates."""
    found = closed_form_forces(WHEEL, HARDENING, 0.012, 0.2, beta)
    values = [float(getattr(found, name)) for name in found.__slots__]
    assert values == pytest.approx(of_a_triangle(0.012, 0.2, beta, 820e3 * depth_at_the_peak(0.012) ** 1.14), rel=1e-8)


PRESSED, LEFT = 0.012, 0.007


@pytest.mark.parametrize(("z", "reloads"), [(0.003, True), (0.005, True), (0.009, False), (0.012, False)])
def test_a_wheel_in_a_rut_follows_the_line_of_reloading_up_to_the_old_stress(z: float, reloads: bool) -> None:
    """A rut pressed to z_u = 12 mm has risen by 5 mm: its bottom carries nothing, 12 mm carry K z_u^N, and in between
    stress is in proportion (Wong 2008, ch. 2). Deeper ground is undisturbed."""
    depth = depth_at_the_peak(z)
    assert (LEFT + depth < PRESSED) == reloads
    peak = 820e3 * (PRESSED**1.14 * depth / (PRESSED - LEFT) if reloads else (LEFT + depth) ** 1.14)
    lateral = 0.8 * math.tan(math.radians(5.0))
    soil = HARDENING.vector()
    found, _, _ = contact_forces(z, 0.2, 0.8, lateral, 0.8, (PRESSED, LEFT), WHEEL.vector(), soil, 0)
    assert [float(value) for value in found] == pytest.approx(of_a_triangle(z, 0.2, 5.0, peak), rel=1e-8)


def test_slopes_are_differences_of_the_forces_where_slip_does_not_change_the_stress() -> None:
    """F_N, F_DP and M_R by the travel ratio, F_L by the lateral one, with c2 = n1 = 0."""
    z, travel, lateral, step = 0.011, 0.9, 0.05, 1e-5
    wheel = dataclasses.replace(WHEEL, max_stress_c2=0.0).vector()
    soil = SOIL.replace(sinkage_exponent_slip=0.0).vector()

    def forces(travel: float, lateral: float) -> np.ndarray:
        return np.array(contact_forces(z, 0.1, travel, lateral, travel, (0.0, 0.0), wheel, soil, 0)[0], dtype=float)

    _, slopes, _ = contact_forces(z, 0.1, travel, lateral, travel, (0.0, 0.0), wheel, soil, 0)
    by_travel = (forces(travel + step, lateral) - forces(travel - step, lateral)) / (2 * step)
    by_lateral = (forces(travel, lateral + step) - forces(travel, lateral - step)) / (2 * step)
    expected = [by_travel[0], by_travel[1], by_lateral[2], by_travel[3]]
    assert np.all(np.abs(expected) > 1e-3)
    assert [float(value) for value in slopes] == pytest.approx(expected, rel=1e-6)


def test_signed_reading_is_smooth_and_rises_through_zero_slip() -> None:
    slip = np.linspace(-0.3, 0.3, 601)
    pull = closed_form_forces(WHEEL, SOIL, 0.009, slip).drawbar_pull_n
    assert np.all(np.diff(pull) > 0)
    assert np.max(np.diff(pull)) < 0.15


def test_printed_reading_jumps_at_zero_slip_and_is_not_monotone() -> None:
    """The jump of 6-24 N between s = 0- and s = 0+ that the printed law has at a load of about 36.5 N."""
    sinkage = sinkage_under_load(WHEEL, SOIL, 36.5, 0.0)
    below, above = closed_form_forces(WHEEL, SOIL, sinkage, [-1e-9, 0.0], reading="printed").drawbar_pull_n
    assert 6 < above - below < 24
    skid = closed_form_forces(WHEEL, SOIL, sinkage, np.linspace(-0.3, -0.01, 50), reading="printed").drawbar_pull_n
    assert np.any(np.diff(skid) < 0)


@pytest.mark.parametrize("slip", [0.05, 0.3])
def test_the_slip_branch_has_the_shear_of_as_much_slip_in_skid(slip: float) -> None:
    """|s| in the place of s in Eqs 12-17; theta_m and the exponent do not follow s where c2 = n1 = 0."""
    wheel, soil = dataclasses.replace(WHEEL, max_stress_c2=0.0), SOIL.replace(sinkage_exponent_slip=0.0)
    skid = closed_form_forces(wheel, soil, 0.011, -slip, reading="slip-branch")
    forward = closed_form_forces(wheel, soil, 0.011, slip, reading="signed")
    for name in ("normal_force_n", "drawbar_pull_n", "resistance_torque_nm"):
        assert float(getattr(skid, name)) == pytest.approx(float(getattr(forward, name)), rel=1e-9)


def test_readings_agree_in_slip() -> None:
    values = [
        float(closed_form_forces(WHEEL, SOIL, 0.009, 0.2, reading=reading).drawbar_pull_n) for reading in SHEAR_SIGNS
    ]
    assert values == pytest.approx([values[0]] * 3)


def test_lateral_force_is_odd_in_side_slip_and_saturates_at_the_strength() -> None:
    left, right = closed_form_forces(WHEEL, SOIL, 0.009, 0.0, [-89.9, 89.9]).lateral_force_n
    assert left == pytest.approx(-right)
    theta_1 = math.acos((0.15 - 0.009) / 0.15)
    peak = 820e3 * 0.15 * (math.cos(theta_1 / 2) - math.cos(theta_1))
    strength = 520 + peak * math.tan(math.radians(12.4))
    assert right == pytest.approx(WHEEL.shearing_radius_m * 0.15 * strength * theta_1 / 2, rel=1e-3)


@pytest.mark.parametrize(("state", "near"), [
    ((-1.0, 0.0), (-1 + 1e-7, 0.0)), ((-1.0, 20.0), (-1 + 1e-7, 20.0)), ((1.0, 30.0), (1 - 1e-7, 30.0)),
    ((0.2, 90.0), (0.2, 90 - 1e-6)), ((-0.5, -90.0), (-0.5, -90 + 1e-6)), ((-1.0, 90.0), (-1 + 1e-7, 89.999)),
])  # fmt: skip
def test_a_locked_wheel_and_side_slip_of_90_degrees_are_limits(
    state: tuple[float, float], near: tuple[float, float]
) -> None:
    both = [closed_form_forces(WHEEL, SOIL, 0.009, *at) for at in (state, near)]
    for name in both[0].__slots__:
        one, two = (float(getattr(found, name)) for found in both)
        assert one == pytest.approx(two, abs=1e-3 * float(both[0].normal_force_n)), name


def test_cohesion_of_a_contact_without_load_is_told() -> None:
    """By hand: b r_s c theta_1 / 2 over F_N. At 0.2 micrometres the closed form pulls 173 times its load."""
    z = np.array([2e-7, 0.009])
    load = closed_form_forces(WHEEL, SOIL, z, 0.2).normal_force_n
    theta_1 = np.arccos((0.15 - z) / 0.15)
    expected = 0.15 * WHEEL.shearing_radius_m * 520 * theta_1 / 2 / load
    assert cohesion_share(WHEEL, SOIL, z, load) == pytest.approx(expected)
    assert expected[0] > 10 * MOST_COHESION > 20 * expected[1]


@pytest.mark.parametrize("slip", [-0.9, -0.3, 0.0, 0.2, 0.9])
def test_travel_ratio_and_slip_ratio_are_inverse(slip: float) -> None:
    assert slip_ratio(travel_ratio(slip)) == pytest.approx(slip, abs=1e-12)


def test_shearing_radius() -> None:
    """Eq. 4 by hand: 150 + 0.65 x 8 mm."""
    wheel = Wheel(radius_m=0.15, width_m=0.15, grouser_height_m=0.008, grouser_shear_coefficient=0.65)
    assert wheel.shearing_radius_m == pytest.approx(0.1552)


@pytest.mark.parametrize(
    ("state", "name"),
    [
        ((0.0, 0.0, 0.0), "sinkage_m"),
        ((0.15, 0.0, 0.0), "sinkage_m"),
        ((math.nan, 0.0, 0.0), "sinkage_m"),
        ((0.01, -1.01, 0.0), "slip_ratio"),
        ((0.01, 1.01, 0.0), "slip_ratio"),
        ((0.01, math.nan, 0.0), "slip_ratio"),
        ((0.01, 0.0, 90.1), "side_slip_deg"),
        ((0.01, 1.0, 90.0), "leaves it open"),
    ],
)
def test_impossible_states_are_refused(state: tuple[float, float, float], name: str) -> None:
    with pytest.raises(ParameterError, match=name):
        closed_form_forces(WHEEL, SOIL, *state)


@pytest.mark.parametrize(
    "change",
    [
        {"radius_m": 0},
        {"width_m": -1},
        {"grouser_height_m": -1},
        {"grouser_shear_coefficient": 2},
        {"exit_c3": 0.6},
        {"grouser_height_m": 0.15},
        {"radius_m": math.nan},
    ],
)
def test_impossible_wheels_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        Wheel(**({"radius_m": 0.15, "width_m": 0.15} | change))


@pytest.mark.reference
def test_signed_reading_agrees_with_measured_skid_and_slip(reference_data: Path) -> None:
    """CMU wheel with grousers without side slip: drawbar pull at measured sinkage, soil fitted on every other run.

    The test is of the sign of the shear law alone: the soil is fitted to the drawbar pull, its normal force is free.
    """
    from scipy.optimize import least_squares

    with (reference_data / "wheel/cmu_pavlov_single_wheel_grouser.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if float(row["beta"]) == 0 and abs(float(row["slip"])) <= 0.75]
    table = np.array([[float(row[k]) for k in ("slip", "avg_Z", "avg_Fy")] for row in rows])
    slip, sinkage, pull = table[:, 0], -table[:, 1] / 1e3, -table[:, 2]
    wheel = Wheel(radius_m=0.058, width_m=0.05, grouser_height_m=0.005, grouser_shear_coefficient=0.65)
    fitted = np.arange(slip.size) % 2 == 0

    def residual(point: np.ndarray, reading: str) -> np.ndarray:
        soil = SOIL.replace(
            stiffness_kpa_m_n=np.exp(point[0]),
            sinkage_exponent=0.5,
            shear_modulus_mm=np.exp(point[1]),
            friction_angle_deg=point[2],
            sinkage_exponent_slip=point[3],
        )
        return closed_form_forces(wheel, soil, sinkage, slip, reading=reading).drawbar_pull_n - pull

    def held_out_rmse(reading: str) -> float:
        bounds = ([0, 0, 5, -0.6], [14, 5, 60, 0.9])
        best = least_squares(lambda p: residual(p, reading)[fitted], [6, 2.7, 30, 0], bounds=bounds)
        return float(np.sqrt(np.mean(residual(best.x, reading)[~fitted] ** 2)))

    signed = held_out_rmse("signed")
    assert signed < 1.1
    assert held_out_rmse("printed") > 2 * signed
    assert held_out_rmse("slip-branch") > 2 * signed
