"""Error ellipses of points whose covariance is known."""

import numpy as np
import pytest
from scipy.stats import chi2

from lunarsci.twin.judgement.endpoint import error_ellipse, scale_of


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
