"""Errors at a bound against numerical integration of the same density."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import truncnorm

from lunarsci.arrays import FloatArray
from lunarsci.spectra.mgm.batch import problem_of
from lunarsci.spectra.mgm.laplace import bounded_covariances
from lunarsci.spectra.mgm.model import MgmModel, mgm_model


def model_of_two() -> MgmModel:
    """A model whose bounds are those of two numbers: the first free, the second at most 0."""
    return replace(
        mgm_model(),
        names=("a", "b"),
        prior=np.zeros(2),
        precision=np.eye(2),
        lower=np.array([-np.inf, -np.inf]),
        upper=np.array([np.inf, 0.0]),
    )


def bounded_covariance(curvature: FloatArray, gradient: FloatArray, point: FloatArray, model: MgmModel) -> FloatArray:
    """Of one fit, among others of another place."""
    others = np.array([point, point - 7.0, point])
    three = [np.array([values] * 3) for values in (curvature, gradient)]
    return bounded_covariances(*three, others, problem_of(model))[2]


@pytest.mark.parametrize("slope", [0.0, 0.5, 3.0, 30.0])
def test_mean_square_distance_from_the_mode_at_a_bound(slope: float) -> None:
    """Density exp(-(x' H x) / 2 + slope b) on b <= 0, summed at midpoints; the mode is at 0 where slope >= 0."""
    curvature = np.array([[4.0, 1.5], [1.5, 2.0]])
    covariance = bounded_covariance(curvature, np.array([0.0, slope]), np.zeros(2), model_of_two())
    a, b = np.meshgrid(np.linspace(-8, 8, 2001), np.arange(-7.999, 0, 0.002), indexing="ij")
    density = np.exp(-0.5 * (curvature[0, 0] * a**2 + 2 * curvature[0, 1] * a * b + curvature[1, 1] * b**2) + slope * b)
    density /= density.sum()
    found = np.array([[(density * x * y).sum() for y in (a, b)] for x in (a, b)])
    assert np.allclose(covariance, found, rtol=2e-3, atol=1e-5)


def test_one_bound_alone_is_a_truncated_normal_law() -> None:
    curvature, slope = np.diag([1.0, 9.0]), 2.4
    covariance = bounded_covariance(curvature, np.array([0.0, slope]), np.zeros(2), model_of_two())
    mean, sigma = slope / 9, 1 / 3
    law = truncnorm(-np.inf, (0 - mean) / sigma, loc=mean, scale=sigma)
    assert covariance[1, 1] == pytest.approx(law.moment(2))
    assert covariance[0, 0] == pytest.approx(1.0)


def test_away_from_bounds_it_is_the_inverse_curvature() -> None:
    curvature = np.array([[4.0, 1.5], [1.5, 2.0]])
    covariance = bounded_covariance(curvature, np.zeros(2), np.array([0.3, -1.0]), model_of_two())
    assert np.allclose(covariance, np.linalg.inv(curvature))


def test_a_fixed_parameter_has_no_error_and_the_others_do_not_follow_it() -> None:
    model = replace(model_of_two(), lower=np.array([-np.inf, -0.5]), upper=np.array([np.inf, -0.5]))
    covariance = bounded_covariance(np.array([[4.0, 1.5], [1.5, 2.0]]), np.zeros(2), np.array([0.0, -0.5]), model)
    assert np.allclose(covariance, [[0.25, 0.0], [0.0, 0.0]])
