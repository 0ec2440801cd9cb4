"""Identification: a published number, round trips through the forces, shares of variance by measured quantity."""

import math

import numpy as np
import pytest

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.identify import Assumptions, Estimate, _over_corners, identify, sensitivities
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.states import MeasurementErrors, WheelStates, read_states
from lunarsci.regolith.wheel import Wheel, read_wheel

YUTU = read_wheel("yutu2")
EXACT = MeasurementErrors(sinkage_m=0, force_relative=0, travel_relative=0, side_slip_relative=0)


def state(sinkage_mm: float, errors: MeasurementErrors, slip: float = -0.075) -> WheelStates:
    """The mean wheel state of Ding et al. (2024) with F_N 32.03 N and F_DP -1.30 N."""
    header = "sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n"
    return read(f"{header}\n{sinkage_mm / 1e3},{slip},32.03,-1.30\n", errors=errors)


def read(text: str, wheel: Wheel = YUTU, errors: MeasurementErrors | None = None) -> WheelStates:
    return read_states(InputFile("states.csv", text.encode()), wheel, errors)


def test_published_friction_angle_needs_the_slip_branch() -> None:
    """21.5 deg at c 520 Pa and s -0.075; the physical reading has no solution there and says so."""
    with pytest.warns(LunarSciWarning, match="reproducing published numbers only"):
        found = identify(state(8, EXACT), YUTU, reading="slip-branch")
    assert found.site["friction_angle_deg"].value == pytest.approx(21.5, abs=0.3)
    physical = identify(state(8, EXACT), YUTU)
    assert physical.site["friction_angle_deg"].value is None
    assert physical.unsolved == ("friction_angle_deg",)


TRUTH = Soil(
    stiffness_kpa_m_n=1100,
    sinkage_exponent=0.95,
    cohesion_pa=700,
    friction_angle_deg=35,
    shear_modulus_mm=17.8,
    external_friction_angle_deg=14,
    lateral_modulus_mm=25,
)


def simulated(errors: MeasurementErrors, slip: float = 0.12, side_slip: float = 3.0) -> WheelStates:
    forces = closed_form_forces(YUTU, TRUTH, 0.009, slip, side_slip)
    row = [
        0.009,
        slip,
        side_slip,
        *(float(f) for f in (forces.normal_force_n, forces.drawbar_pull_n, forces.lateral_force_n)),
    ]
    names = "sinkage_m,slip_ratio,side_slip_deg,normal_force_n,drawbar_pull_n,lateral_force_n"
    return read(f"{names}\n{','.join(map(repr, row))}\n", errors=errors)


@pytest.mark.parametrize("slip", [-0.2, 0.0, 0.12, 0.5])
@pytest.mark.parametrize("side_slip", [-3.0, 3.0])
def test_forces_of_a_soil_give_the_soil_back(slip: float, side_slip: float) -> None:
    states = simulated(EXACT, slip, side_slip)
    given = Assumptions(
        exponent=0.95,
        stiffness_kpa_m_n=1100,
        cohesion_pa=700,
        friction_angle_deg=35,
        lateral_modulus_mm=(25.0,),
        external_friction_angle_deg=14,
    )
    site = identify(states, YUTU, given, draws=4).site
    assert site["stiffness_kpa_m_n"].value == pytest.approx(1100, rel=1e-9)
    assert site["exponent"].value == pytest.approx(0.95, rel=1e-9)
    assert site["friction_angle_deg"].value == pytest.approx(35, rel=1e-6)
    assert site["cohesion_pa"].value == pytest.approx(700, rel=1e-6)
    assert site["external_friction_angle_deg"].value == pytest.approx(14, rel=1e-6)
    assert site["lateral_modulus_mm"].value == pytest.approx(25, rel=1e-6)


def test_curves_pass_through_the_truth() -> None:
    curves = identify(simulated(EXACT), YUTU, Assumptions(cohesion_pa=700), draws=4).curves
    bearing = {point["exponent"]: point["stiffness_kpa_m_n"] for point in curves["bearing"]}
    assert math.exp((math.log(bearing[0.94]) + math.log(bearing[0.96])) / 2) == pytest.approx(1100, rel=1e-6)
    shear = {point["cohesion_pa"]: point["friction_angle_deg"] for point in curves["shear"]}
    assert shear[600.0] > 35 > shear[800.0]
    lateral = {point["lateral_modulus_mm"]: point["external_friction_angle_deg"] for point in curves["lateral"]}
    assert lateral[25.0] == pytest.approx(14, rel=1e-6)


@pytest.mark.slow
def test_intervals_cover_the_truth() -> None:
    """300 measurements of one state with the stated errors: the 95 % interval holds the truth in 92-98 % of them."""
    clean = simulated(MeasurementErrors())
    rng = np.random.default_rng(8)
    noisy = clean.values + clean.sigmas * rng.standard_normal((300, 6))
    states = WheelStates(tuple(map(str, range(300))), noisy, np.repeat(clean.sigmas, 300, axis=0))
    found = identify(states, YUTU, Assumptions(exponent=0.95, cohesion_pa=700, lateral_modulus_mm=(25.0,)), draws=512)
    for name, truth in (("stiffness_kpa_m_n", 1100), ("friction_angle_deg", 35)):
        inside = [row[name].low < truth < row[name].high for row in found.observations]
        assert 0.92 <= np.mean(inside) <= 0.98, name


def test_without_slip_only_the_bearing_is_found() -> None:
    found = identify(read("sinkage_m,normal_force_n,drawbar_pull_n\n0.008,32.03,-1.30\n"), YUTU)
    assert found.site["stiffness_kpa_m_n"].value == pytest.approx(1443, abs=3)
    assert found.site["friction_angle_deg"].value is None
    assert found.unsolved == ()


@pytest.mark.parametrize(
    "options",
    [
        {"exponent": -1},
        {"cohesion_pa": -1},
        {"friction_angle_deg": 90},
        {"lateral_modulus_mm": (0.0,)},
        {"shear_modulus_mm": 0},
    ],
)
def test_impossible_assumptions_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        Assumptions(**options)


def test_forces_that_need_the_ground_to_pull_have_no_solution() -> None:
    found = identify(read("sinkage_m,normal_force_n,drawbar_pull_n\n0.009,5,30\n"), YUTU)
    assert found.site["stiffness_kpa_m_n"].value is None
    assert "stiffness_kpa_m_n" in found.unsolved


def test_a_friction_angle_no_soil_has_is_no_solution() -> None:
    found = identify(read("sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n\n0.0091,0.05,36,90\n"), YUTU)
    assert found.site["friction_angle_deg"].value is None


def test_several_assumed_moduli_give_a_range_and_corners_but_no_value() -> None:
    found = identify(simulated(MeasurementErrors()), YUTU, Assumptions(cohesion_pa=700))
    angle = found.site["external_friction_angle_deg"]
    low, high = (corner["external_friction_angle_deg"] for corner in found.corners)
    assert (angle.value, angle.low, angle.high) == (None, low.low, high.high)
    assert low.value < 14 < high.value
    assert found.unsolved == ()


def test_a_range_over_corners_is_solved_as_seldom_as_the_worst_of_them() -> None:
    found = _over_corners([Estimate(30.0, 1.0, 28.0, 32.0, 0.9), Estimate(40.0, 1.0, 38.0, 42.0, 0.6)])
    assert (found.value, found.sigma, found.low, found.high, found.solved) == (None, None, 28.0, 42.0, 0.6)


def test_too_many_states_are_refused() -> None:
    clean = simulated(EXACT)
    many = WheelStates(("s",) * 100_001, np.repeat(clean.values, 100_001, 0), np.repeat(clean.sigmas, 100_001, 0))
    with pytest.raises(ParameterError, match="give 1 to 100000; take every tenth"):
        identify(many, YUTU)


WHEEL = read_wheel("yutu2")
STATE = b"sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n\n0.005,-0.075,32.03,-1.30\n"


def states(errors: MeasurementErrors | None = None) -> WheelStates:
    return read_states(InputFile("s.csv", STATE), WHEEL, errors)


def test_the_exponent_owes_its_error_to_the_sinkage_as_published() -> None:
    """Ding et al. (2024): sd 0.017 by sinkage, 0.006 by forces, 0.017 by both."""
    found = {
        (share.parameter, share.quantity): share
        for share in sensitivities(states(), WHEEL, Assumptions(stiffness_kpa_m_n=1443), draws=20_000)
    }
    sinkage = found["exponent", "sinkage_m"]
    assert sinkage.alone is not None
    assert sinkage.saved is not None
    assert sinkage.alone == pytest.approx(0.88, abs=0.03)
    assert sinkage.saved == pytest.approx(sinkage.alone, abs=0.04)
    total = sum(share.alone or 0 for (name, _), share in found.items() if name == "exponent")
    assert total == pytest.approx(1, abs=0.05)


def test_exact_measurements_have_nothing_to_divide() -> None:
    exact = states(MeasurementErrors(sinkage_m=0, force_relative=0, travel_relative=0, side_slip_relative=0))
    with pytest.raises(ParameterError, match="nothing to divide"):
        sensitivities(exact, WHEEL)


def test_quantities_not_measured_have_no_row() -> None:
    assert {share.quantity for share in sensitivities(states(), WHEEL)}.isdisjoint({"side_slip_deg", "lateral_force_n"})


def test_long_files_are_thinned() -> None:
    """Of 400 states 50 are taken, evenly."""
    one, thicker = states(), 1.0 + 0.001 * np.arange(400)[:, None]
    many, few = (
        WheelStates(tuple(map(str, rows)), one.values * thicker[rows], np.repeat(one.sigmas, len(rows), 0))
        for rows in (np.arange(400), np.linspace(0, 399, 50).astype(int))
    )
    long, short = (sensitivities(given, WHEEL, draws=64) for given in (many, few))
    assert long == short
