"""Error ellipses of points whose covariance is known.

What moves the end of a drive: soil parameters one by one, and the time step.
"""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.judgement.endpoint import endpoint_sensitivity, error_ellipse, scale_of, step_error_m
from lunarsci.twin.plans.plan import Fixes, parse_sweep, read_plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import predict


@pytest.mark.parametrize("azimuth", [0.0, 30.0, 90.0, 179.0])
def test_a_cross_of_known_arms(azimuth: float) -> None:
    """Four points at +-a along one direction and +-b across: the covariance has 2 a2 / 3 and 2 b2 / 3 on its axes."""
    turn = np.radians(azimuth)
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    points = np.array([5.0, -2.0]) + np.array([0.6 * along, -0.6 * along, 0.2 * across, -0.2 * across])
    ellipse = error_ellipse(points)
    assert (ellipse.semi_major_m, ellipse.semi_minor_m) == pytest.approx((0.6 * np.sqrt(2 / 3), 0.2 * np.sqrt(2 / 3)))
    assert np.cos(2 * np.radians(ellipse.azimuth_deg) - 2 * turn) == pytest.approx(1.0), "a direction, not a sense"
    assert 0.0 <= ellipse.azimuth_deg < 180.0
    assert ellipse.factor_95 == pytest.approx(np.sqrt(chi2.ppf(0.95, 2)), rel=1e-12)
    assert ellipse.semi_major_95_m == pytest.approx(ellipse.semi_major_m * np.sqrt(chi2.ppf(0.95, 2)))


@pytest.mark.parametrize("probability", [0.1, 0.6827, 0.95, 0.999])
def test_the_scale_is_the_root_of_the_chi_squared_quantile(probability: float) -> None:
    assert scale_of(probability) == pytest.approx(np.sqrt(chi2.ppf(probability, 2)), rel=1e-12)


def test_the_95_ellipse_holds_95_of_100_normal_points() -> None:
    covariance = np.array([[0.04, 0.018], [0.018, 0.01]])
    points = np.random.default_rng(3).multivariate_normal([1.0, 2.0], covariance, 40_000)
    ellipse = error_ellipse(points)
    assert ellipse.share_inside_95 == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 40_000))
    values = np.linalg.eigvalsh(covariance)
    assert (ellipse.semi_minor_m, ellipse.semi_major_m) == pytest.approx(tuple(np.sqrt(values)), rel=0.02)


def test_ends_on_a_line_and_too_few_ends() -> None:
    line = np.column_stack([np.linspace(0.0, 4.0, 9), np.linspace(0.0, 3.0, 9)])
    ellipse = error_ellipse(line)
    assert ellipse.azimuth_deg == pytest.approx(np.degrees(np.arctan2(3.0, 4.0)))
    assert ellipse.semi_minor_m == pytest.approx(0.0, abs=1e-7) and ellipse.share_inside_95 == 1.0
    assert error_ellipse(line[:1]) is None
    same = error_ellipse(np.ones((3, 2)))
    assert (same.semi_major_m, same.azimuth_deg, same.share_inside_95) == (0.0, 0.0, 1.0)


SWEEP = (parse_sweep("friction_angle_deg=25:55:5"), parse_sweep("lateral_modulus_mm=15:45:5"))


@pytest.mark.slow
def test_one_parameter_at_a_time_moves_the_end_as_the_fit_says(yutu2: Rover) -> None:
    """Against two drives at the ends of each range, the other parameter at its middle."""
    terrain, plan = synthetic_longji(rms_m=0.0), read_plan()
    found = {share.parameter: share for share in endpoint_sensitivity(predict(yutu2, terrain, plan, sweep=SWEEP))}
    for name, own, other in (
        ("friction_angle_deg", "friction_angle_deg=25:55:2", "lateral_modulus_mm=30:30:1"),
        ("lateral_modulus_mm", "lateral_modulus_mm=15:45:2", "friction_angle_deg=40:40:1"),
    ):
        pair = predict(yutu2, terrain, plan, sweep=(parse_sweep(own), parse_sweep(other)))
        order = np.argsort(pair.parameters[name])
        shift = pair.endpoints_m[order[1]] - pair.endpoints_m[order[0]]
        assert np.hypot(*(shift - (found[name].x_m, found[name].y_m))) < 0.25 * np.hypot(*shift)
    assert 0.9 < sum(share.share for share in found.values()) < 1.05


@pytest.mark.slow
def test_few_members_and_no_sweep_have_no_sensitivity(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    assert endpoint_sensitivity(predict(yutu2, slope(), straight(0.5), sweep=())) == []


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.2, 0.1])
def test_the_stated_step_error_is_the_one_against_a_fine_step(yutu2: Rover, dt: float) -> None:
    terrain, plan = synthetic_longji(rms_m=0.0), read_plan()
    coarse, fine = (predict(yutu2, terrain, plan, sweep=(), time_step_s=step) for step in (dt, 0.002))
    error = float(np.hypot(*(coarse.endpoints_m[0] - fine.endpoints_m[0])))
    assert step_error_m(coarse) == pytest.approx(error, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("fixes", [None, Fixes(0.005, 0.1)])
def test_the_step_error_is_that_of_the_member_that_misses_most(yutu2: Rover, fixes: Fixes | None) -> None:
    """Of two soils the second; where it is fixed on the way, that fix counts as exact at every step."""
    terrain, plan = synthetic_longji(rms_m=0.0), dataclasses.replace(read_plan(), fixes=fixes)
    exact = dataclasses.replace(plan, fixes=fixes and Fixes(0.0, 0.0))
    soils = {"friction_angle_deg": np.array([40.0, 25.0])}
    driven = predict(yutu2, terrain, plan, samples=soils, time_step_s=0.1)
    coarse, fine = (predict(yutu2, terrain, exact, samples=soils, time_step_s=step) for step in (0.1, 0.005))
    error = np.hypot(*(coarse.endpoints_m - fine.endpoints_m).T)
    assert driven.miss_m.argmax() == 1
    assert step_error_m(driven) == pytest.approx(error[1], rel=0.2)


@pytest.mark.slow
def test_steps_too_fine_to_matter_are_not_halved(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    assert step_error_m(predict(yutu2, slope(), straight(0.2), sweep=(), time_step_s=0.005)) is None


@pytest.mark.slow
def test_a_drive_that_did_not_finish_has_no_step_error(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    lost = predict(yutu2, slope(), straight(15.0), sweep=())
    assert step_error_m(lost) is None
    assert endpoint_sensitivity(dataclasses.replace(lost, parameters={"cohesion_pa": np.array([1.0])})) == []
