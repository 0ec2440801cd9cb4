"""Errors at a bound against numerical integration of the same density."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import truncnorm

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES
from lunarsci.spectra.mgm.batch import problem_of
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.fit import fit_data
from lunarsci.spectra.mgm.laplace import _bounded, _hand_over, _one_sided, _rooms
from lunarsci.spectra.mgm.levenberg_marquardt import workspace_for
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


@compiled
def bound_all(
    curvature: Any, gradient: Any, points: Any, problem: Any, space: Any, rooms: Any, found: Any
) -> None:  # fmt: skip
    """Covariances (n, p, p) of curvatures of half the objective and descents along it, of fewer fits than lanes."""
    rows, size = points.shape
    for lane in range(LANES):
        row = min(lane, rows - 1)
        for p in range(size):
            space.point[p, lane], space.slope[p, lane] = points[row, p], gradient[row, p]
            for q in range(p, size):
                space.curvature[p * size + q, lane] = curvature[row, p, q]
    _bounded(problem, space, rooms)
    _hand_over(space, rooms[1], 0, found)


def bounded_covariance(curvature: FloatArray, gradient: FloatArray, point: FloatArray, model: MgmModel) -> FloatArray:
    """Of one fit, among others of another place."""
    others = np.array([point, point - 7.0, point])
    three = [np.array([values] * 3) for values in (curvature, gradient)]
    size, found = point.size, np.empty((3, point.size, point.size))
    bound_all(*three, others, problem_of(model), workspace_for(size, size, 1), _rooms(size), found)
    return found[2]


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


@pytest.mark.parametrize("steepness", [0.0, 1.0, 10.0, 29.9, 30.1, 60.0, 1000.0])
def test_the_variance_at_a_bound_is_that_of_the_one_sided_density(steepness: float) -> None:
    """Mean of t^2 under exp(-g t - h t^2 / 2), t >= 0, by quadrature: to 1e-4 where g / sqrt(h) is above 30."""
    bend = 9.0
    slope = steepness * bend**0.5
    covariance = bounded_covariance(np.diag([1.0, bend]), np.array([0.0, slope]), np.zeros(2), model_of_two())
    reach = 40.0 / np.hypot(slope, bend**0.5)

    def moment(power: int) -> float:
        return float(quad(lambda t: t**power * np.exp(-slope * t - 0.5 * bend * t**2), 0.0, reach, epsabs=0.0)[0])

    assert covariance[1, 1] == pytest.approx(moment(2) / moment(0), rel=1e-4 if steepness > 30 else 1e-7)
    assert covariance[0, 0] == pytest.approx(1.0)


@pytest.mark.parametrize("scatter", [0.5, 3.0])
def test_errors_are_widened_by_chi_square_over_its_degrees_of_freedom(scatter: float) -> None:
    """Centres and widths are fixed, so the fit is a least-squares problem that numpy solves.

    A strength that its prior holds counts as the part of a parameter that the data determine: the trace of
    (J J' + P)^-1 J J', J of the data and P of the prior. Errors are never narrowed, and the prior is never widened.
    """
    grid, noise, model = np.linspace(450.0, 2395.0, 60), 0.02, mgm_model("OPX-CPX", "log-quadratic")
    bands = model.assemblage.bands
    for band in bands:
        for name, value in ((f"{band.key}_center_nm", band.center_nm), (f"{band.key}_fwhm_nm", band.fwhm_nm)):
            model = model.bounded(name, value, value)
    shapes = np.array([np.exp(-4 * np.log(2) * ((grid - band.center_nm) / band.fwhm_nm) ** 2) for band in bands])
    errors = scatter * noise * np.random.default_rng(6).standard_normal(grid.size)
    ln = -1.5 - shapes.sum(axis=0) + errors
    data = MgmData("made", grid, np.exp(ln), np.full(grid.size, noise**-2), np.zeros((0, grid.size)), 0.0)
    [fit] = fit_data([data], model, 1)
    design = np.vstack([np.vander((grid - 1500) / 1100, 3, increasing=True).T, shapes]) / noise
    loads = np.array([band.strength_sigma * band.strength_loading for band in bands])
    together = np.outer(loads, loads) * [[one.mineral == other.mineral for other in bands] for one in bands]
    np.fill_diagonal(together, [band.strength_sigma**2 for band in bands])
    prior = np.pad(np.linalg.inv(together), ((3, 0), (3, 0)))
    inverse = np.linalg.inv(design @ design.T + prior)
    chi2 = float(((ln / noise - design.T @ inverse @ design @ ln / noise) ** 2).sum())
    determined = float(np.trace(inverse @ design @ design.T))
    assert 11 < determined < 3 + len(bands) - 0.05, "priors take a part"
    reduced = chi2 / (grid.size - determined)
    assert fit.reduced_chi2 == pytest.approx(reduced, rel=1e-4)
    free = np.array([0, 1, 2, *range(5, model.prior.size, 3)])
    assert (fit.parameters[free[3:]] < 0).all(), "no strength is on its bound"
    wanted = np.linalg.inv(design @ design.T / max(fit.reduced_chi2, 1.0) + prior)
    assert np.allclose(fit.covariance[np.ix_(free, free)], wanted, rtol=1e-6, atol=1e-6 * wanted.max())


def test_away_from_bounds_it_is_the_inverse_curvature() -> None:
    curvature = np.array([[4.0, 1.5], [1.5, 2.0]])
    covariance = bounded_covariance(curvature, np.zeros(2), np.array([0.3, -1.0]), model_of_two())
    assert np.allclose(covariance, np.linalg.inv(curvature))


def test_a_fixed_parameter_has_no_error_and_the_others_do_not_follow_it() -> None:
    model = replace(model_of_two(), lower=np.array([-np.inf, -0.5]), upper=np.array([np.inf, -0.5]))
    covariance = bounded_covariance(np.array([[4.0, 1.5], [1.5, 2.0]]), np.zeros(2), np.array([0.0, -0.5]), model)
    assert np.allclose(covariance, [[0.25, 0.0], [0.0, 0.0]])


@pytest.mark.parametrize("bend", [0.3, 40.0])
@pytest.mark.parametrize("steep", [-2.0, 0.0, 0.7, 8.0, 29.0, 31.0, 300.0])
def test_the_mean_square_beside_a_bound_is_that_of_quadrature(steep: float, bend: float) -> None:
    """Of exp(-slope t - bend t^2 / 2), t from 0 on, also where its tail is nearly exponential."""
    slope, wide = steep * np.sqrt(bend), 12.0 / (np.sqrt(bend) * max(1.0, steep / 4.0))
    wide += 2.0 * max(-steep, 0.0) / np.sqrt(bend)
    t, weight = np.polynomial.legendre.leggauss(400)
    t = 0.5 * wide * (t + 1.0)
    weight = weight * np.exp(-slope * t - 0.5 * bend * t**2)
    assert _one_sided(slope, bend) == pytest.approx(weight @ t**2 / weight.sum(), rel=2e-4)
