"""Exact integrals against adaptive quadrature of the equations written out, limits, and numbers computed elsewhere."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad

from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.integrals import integrated_forces, integrated_forces_in_motion
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import SHEAR_LAWS, ContactModel, ShearLaw, Wheel

WHEEL = Wheel(radius_m=0.15, width_m=0.15, grouser_height_m=0.005, grouser_shear_coefficient=0.65, exit_c3=-0.1)
SOIL = Soil(
    stiffness_kpa_m_n=820,
    sinkage_exponent=1.05,
    sinkage_exponent_slip=0.2,
    cohesion_pa=520,
    friction_angle_deg=38,
    shear_modulus_mm=17.8,
    external_friction_angle_deg=14,
    lateral_modulus_mm=20,
)
STATES = [(0.012, 0.2, 2.0), (0.005, -0.075, 0.5), (0.02, 0.5, -20.0), (0.015, 0.0, 0.0), (0.01, -0.4, 45.0),
          (0.012, 0.2, 0.5)]  # fmt: skip
"""In the last one shear has just begun sideways: with the shearing radius in Eq. 17 the force would be 2.2 % more."""


def written_out(z: float, s: float, beta_deg: float) -> list[float]:
    """Eqs 1-17, separate shear, `signed`, by scipy."""
    r, b, h, r_s = 0.15, 0.15, 0.005, 0.15 + 0.65 * 0.005
    theta_1, theta_1e = math.acos(1 - z / r), math.acos((r - z) / (r + h))
    theta_2, theta_m = -0.1 * theta_1, 0.5 * theta_1
    exponent = 1.05 + 0.2 * s
    travel = 1 - s if s >= 0 else 1 / (1 + s)

    def sigma(t: float) -> float:
        at = t if t >= theta_m else theta_1 - (t - theta_2) / (theta_m - theta_2) * (theta_1 - theta_m)
        return 820e3 * (r * max(math.cos(at) - math.cos(theta_1), 0)) ** exponent

    def tau(t: float) -> float:
        j = r_s * ((theta_1e - t) - travel * (math.sin(theta_1e) - math.sin(t)))
        return (520 + sigma(t) * math.tan(math.radians(38))) * math.copysign(1 - math.exp(-abs(j) / 17.8e-3), j)

    def tau_y(t: float) -> float:
        j = r * travel * math.tan(math.radians(beta_deg)) * (theta_1e - t)  # r, where Eq. 13 has r_s
        return (520 + sigma(t) * math.tan(math.radians(14))) * math.copysign(1 - math.exp(-abs(j) / 20e-3), j)

    def whole(of: Callable[[float], float]) -> float:
        return float(quad(of, theta_2, theta_m, limit=200)[0] + quad(of, theta_m, theta_1, limit=200)[0])

    return [
        b * whole(lambda t: r * sigma(t) * math.cos(t) + r_s * tau(t) * math.sin(t)),
        b * whole(lambda t: r_s * tau(t) * math.cos(t) - r * sigma(t) * math.sin(t)),
        b * whole(lambda t: r_s * tau_y(t)),
        b * whole(lambda t: r_s**2 * tau(t)),
        -b * whole(lambda t: r_s**2 * tau_y(t) * math.sin(t)),
        -b * whole(lambda t: r_s**2 * tau_y(t) * math.cos(t)),
    ]


@pytest.mark.parametrize("state", STATES)
def test_the_integrals_are_those_of_the_equations(state: tuple[float, float, float]) -> None:
    found = integrated_forces(WHEEL, SOIL, *state)
    values = [float(getattr(found, name)) for name in found.__slots__]
    load = values[0]
    assert values == pytest.approx(written_out(*state), rel=2e-3, abs=1e-3 * load)


def test_the_ellipse_equals_separate_shear_in_one_direction_and_never_exceeds_the_strength() -> None:
    for slip in (-0.3, 0.0, 0.3):
        one, two = (
            integrated_forces(WHEEL, SOIL, 0.012, slip, 0.0, ContactModel(shear=law)) for law in ("separate", "ellipse")
        )
        assert float(two.drawbar_pull_n) == pytest.approx(float(one.drawbar_pull_n), rel=1e-12)
    pulls = [
        float(integrated_forces(WHEEL, SOIL, 0.015, 0.6, 0.0, ContactModel(shear=law)).drawbar_pull_n)
        for law in ("separate", "combined")
    ]
    assert pulls[1] == pytest.approx(pulls[0], rel=1e-9), "full sliding one way"
    one, two = (
        integrated_forces(WHEEL, SOIL, 0.012, 0.3, 20.0, ContactModel(shear=law)) for law in ("separate", "ellipse")
    )
    assert 0 < float(two.lateral_force_n) < float(one.lateral_force_n)
    assert 0 < float(two.resistance_torque_nm) < float(one.resistance_torque_nm)


def test_integrals_and_closed_form_give_numbers_computed_by_another_program() -> None:
    """Slip 0.2, N 1, K_s 820, c 520 Pa, phi 42 deg, z 12 mm, lugs of 8 mm: F_N, F_DP, M_R of both."""
    wheel = Wheel(radius_m=0.15, width_m=0.15, grouser_height_m=0.008, grouser_shear_coefficient=0.65)
    soil = SOIL.replace(sinkage_exponent=1.0, sinkage_exponent_slip=0.0, friction_angle_deg=42.0)
    names = ("normal_force_n", "drawbar_pull_n", "resistance_torque_nm")
    exact, closed = integrated_forces(wheel, soil, 0.012, 0.2), closed_form_forces(wheel, soil, 0.012, 0.2)
    assert [float(getattr(exact, name)) for name in names] == pytest.approx([39.50, 11.16, 2.935], rel=1e-3)
    assert [float(getattr(closed, name)) for name in names] == pytest.approx([35.82, 9.44, 2.557], rel=1e-3)


def test_combined_shear_is_the_separate_one_without_side_slip() -> None:
    """At beta = 0 and full sliding one way both laws say the same."""
    pulls = [
        float(integrated_forces(WHEEL, SOIL, 0.015, 0.6, 0.0, ContactModel(shear=law)).drawbar_pull_n)
        for law in ("separate", "combined", "ellipse")
    ]
    assert pulls == pytest.approx([pulls[0]] * 3, rel=1e-9)


def test_skidding_takes_grip_sideways_under_combined_shear() -> None:
    rolling, skidding = (
        float(integrated_forces(WHEEL, SOIL, 0.012, slip, 10.0, ContactModel(shear="combined")).lateral_force_n)
        for slip in (0.0, 0.6)
    )
    assert skidding < rolling


def test_side_slip_of_90_degrees_and_a_locked_wheel_have_forces() -> None:
    """A wheel pushed sideways without turning: no drawbar pull by shear, all strength across."""
    model = ContactModel(shear="combined")
    found = integrated_forces_in_motion(WHEEL, SOIL, [0.012, 0.012], [[0.0, 0.01, 0.0], [0.01, 0.0, 0.0]], model)
    assert found.lateral_force_n[0] > 0
    assert abs(found.lateral_force_n[1]) < 1e-6 * found.normal_force_n[1]
    assert found.drawbar_pull_n[1] < found.drawbar_pull_n[0] < 0
    strength = 0.15 * (0.15 + 0.65 * 0.005) * (520 * 1.1 * math.acos(1 - 0.012 / 0.15))
    assert found.lateral_force_n[0] > strength


@pytest.mark.parametrize("law", ["hegedus", "wong"])
def test_bulldozing_adds_side_force_with_the_sign_of_the_side_slip(law: str) -> None:
    plain = integrated_forces(WHEEL, SOIL, 0.02, 0.1, [-10.0, 0.0, 10.0])
    pushed = integrated_forces(WHEEL, SOIL, 0.02, 0.1, [-10.0, 0.0, 10.0], ContactModel(bulldozing=law))
    more = pushed.lateral_force_n - plain.lateral_force_n
    assert more[1] == 0
    assert more[2] == pytest.approx(-more[0])
    assert more[2] > 0
    assert pushed.drawbar_pull_n == pytest.approx(plain.drawbar_pull_n)
    heavier = integrated_forces(WHEEL, SOIL, 0.02, 0.1, 10.0, ContactModel(bulldozing=law, gravity_m_s2=9.81))
    assert float(heavier.lateral_force_n) > pushed.lateral_force_n[2]


def hegedus(depth: float, cohesion: float, weight: float, phi: float) -> float:
    """Force per length of a blade (Hegedus 1960, as in Ishigami et al. 2007). [N/m]"""
    x_c = math.pi / 4 - phi / 2
    d_1 = 1 / math.tan(x_c) + math.tan(x_c + phi)
    d_2 = 1 / math.tan(x_c) + 1 / math.tan(x_c) ** 2 * math.tan(phi)
    return d_1 * (cohesion * depth + d_2 * weight * depth**2 / 2)


def wong(depth: float, cohesion: float, weight: float, phi: float) -> float:
    """Passive earth pressure on a side wall, per length (Wong 2008, as in Ishigami et al. 2007). [N/m]"""
    cot = 1 / math.tan(math.pi / 4 - phi / 2)
    return 0.5 * weight * depth**2 * cot**2 * (1 + 0.5 * cot * math.tan(phi)) + 2 * depth * cohesion * cot


@pytest.mark.parametrize("cohesion", [0.0, 520.0])
@pytest.mark.parametrize("law", [hegedus, wong])
def test_the_force_on_the_side_is_its_formula(law: Callable[..., float], cohesion: float) -> None:
    """Straight sideways: the soil's force on the segment of the wheel below ground, of 1500 kg/m3 on Earth."""
    soil = SOIL.replace(cohesion_pa=cohesion)
    model = ContactModel(bulldozing=law.__name__, gravity_m_s2=9.81)
    z, r = 0.02, 0.15
    both = [integrated_forces_in_motion(WHEEL, soil, z, [0.0, 0.01, 0.01], m) for m in (model, ContactModel())]
    theta_1 = math.acos(1 - z / r)

    def density(t: float) -> float:
        depth = r * (math.cos(t) - math.cos(theta_1))
        return law(depth, cohesion, 1500 * 9.81, math.radians(38)) * (r - depth * math.cos(t))

    expected = quad(density, -theta_1 / 10, theta_1)[0]
    assert float(both[0].lateral_force_n[0] - both[1].lateral_force_n[0]) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("z", [0.004, 0.012])
def test_a_wheel_without_shear_in_a_rut_is_carried_by_the_line_of_reloading(z: float) -> None:
    """p = p_u - (k_0 + A_u z_u) (z_u - z) from the bottom of a rut of 12 mm on (Wong 2008, ch. 2), then K z^N.

    The lighter wheel stays on the line, the stress at the middle of the heavier one is above the old one.
    """
    r, b, stiffness, exponent, pressed = 0.15, 0.15, 820e3, 1.05, 0.012
    k_0, a_u = 0.5e6, 8e7
    old = stiffness * pressed**exponent
    bottom = pressed - old / (k_0 + a_u * pressed)
    theta_1 = math.acos(1 - z / r)
    theta_2, theta_m = -theta_1 / 10, theta_1 / 2
    assert (bottom + r * (math.cos(theta_m) - math.cos(theta_1)) > pressed) == (z > 0.01)

    def stress(t: float) -> float:
        at = t if t >= theta_m else theta_1 - (t - theta_2) / (theta_m - theta_2) * (theta_1 - theta_m)
        below = bottom + r * (math.cos(at) - math.cos(theta_1))
        return stiffness * below**exponent if below > pressed else old - (k_0 + a_u * pressed) * (pressed - below)

    slick = SOIL.replace(cohesion_pa=0.0, friction_angle_deg=0.0, sinkage_exponent_slip=0.0)
    model = ContactModel(rut_m=pressed, reload_n_m3=k_0, reload_rise_n_m4=a_u)
    found = integrated_forces(WHEEL, slick, z, 0.0, model=model)
    for value, weight in ((found.normal_force_n, math.cos), (found.drawbar_pull_n, lambda t: -math.sin(t))):
        halves = ((theta_2, theta_m), (theta_m, theta_1))
        parts = [quad(lambda t, w=weight: stress(t) * w(t), *half, limit=200)[0] for half in halves]
        assert float(value) == pytest.approx(b * r * sum(parts), rel=2e-3)


def test_a_rut_carries_more_and_meets_the_virgin_soil_at_its_depth() -> None:
    virgin = integrated_forces(WHEEL, SOIL, 0.006, 0.0)
    rut = ContactModel(rut_m=0.012, reload_rise_n_m4=5e8)
    again = integrated_forces(WHEEL, SOIL, 0.006, 0.0, model=rut)
    assert float(again.normal_force_n) > 1.5 * float(virgin.normal_force_n)
    with pytest.raises(ParameterError, match="slope of reloading"):
        ContactModel(rut_m=0.01)


def test_the_exit_angle_follows_the_rebound() -> None:
    """More contact behind the wheel carries more."""
    models = [ContactModel(rebound=share) for share in (0.0, 0.3, 0.9)]
    loads = [float(integrated_forces(WHEEL, SOIL, 0.012, 0.1, model=model).normal_force_n) for model in models]
    assert loads == sorted(loads)


def test_skid_may_have_its_own_exponent() -> None:
    models = [ContactModel(skid_exponent_slip=n) for n in (None, 0.5)]
    plain, own = (integrated_forces(WHEEL, SOIL, 0.012, -0.3, model=model) for model in models)
    same = integrated_forces(WHEEL, SOIL, 0.012, -0.3, model=ContactModel(skid_exponent_slip=-0.2))
    assert float(same.normal_force_n) == pytest.approx(float(plain.normal_force_n))
    assert float(own.normal_force_n) < float(plain.normal_force_n)


@pytest.mark.parametrize(
    "options",
    [
        {"reading": "mine"}, {"shear": "both"}, {"bulldozing": "much"}, {"density_kg_m3": 0.0}, {"gravity_m_s2": -1.0},
        {"rebound": 1.5}, {"rut_m": -0.1}, {"shear": "combined", "reading": "printed"},
    ],
)  # fmt: skip
def test_choices_out_of_range_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        ContactModel(**options)


@pytest.mark.parametrize("law", SHEAR_LAWS)
@pytest.mark.parametrize(("state", "near"), [
    ((-1.0, 0.0), (-1 + 1e-7, 0.0)), ((-1.0, 20.0), (-1 + 1e-7, 20.0)), ((1.0, 30.0), (1 - 1e-7, 30.0)),
    ((0.2, 90.0), (0.2, 90 - 1e-6)), ((-0.5, -90.0), (-0.5, -90 + 1e-6)), ((-1.0, 90.0), (-1 + 1e-9, 89.9999)),
])  # fmt: skip
def test_a_locked_wheel_and_side_slip_of_90_degrees_are_limits(
    law: ShearLaw, state: tuple[float, float], near: tuple[float, float]
) -> None:
    model = ContactModel(shear=law, skid_exponent_slip=0.3, bulldozing="hegedus")
    both = [integrated_forces(WHEEL, SOIL, 0.012, *at, model) for at in (state, near)]
    for name in both[0].__slots__:
        one, two = (float(getattr(found, name)) for found in both)
        assert one == pytest.approx(two, abs=1e-3 * float(both[0].normal_force_n)), name


@pytest.mark.parametrize("state", [(0.0, 0.1, 0.0), (0.2, 0.1, 0.0), (0.01, -1.1, 0.0), (0.01, 0.0, 91.0)])
def test_states_no_wheel_can_have_are_refused(state: tuple[float, float, float]) -> None:
    with pytest.raises(ParameterError):
        integrated_forces(WHEEL, SOIL, *state)
    with pytest.raises(ParameterError):
        integrated_forces_in_motion(WHEEL, SOIL, 0.01, [np.nan, 0.0, 1.0])
