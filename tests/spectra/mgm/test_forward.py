"""Eight numbers side by side, the systems they solve and the spectra they carry, against NumPy and the plain model.

The compiled model against lmfit's Gaussian, its Jacobian against differences, its minimum against lmfit's.
"""

from typing import Any

import lmfit
import numpy as np
import pytest
from lmfit.lineshapes import gaussian

from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES
from lunarsci.compiled.lanes import aligned, exponential, load, logarithm, spread, store
from lunarsci.spectra.mgm.fit import fit_batch
from lunarsci.spectra.mgm.forward import (
    back_substitute,
    clip_to_bounds,
    evaluate,
    factorise,
    hold,
    invert,
    matrix_side,
    model_and_jacobian,
    padded_matrix,
    update,
)
from lunarsci.spectra.mgm.levenberg_marquardt import (
    CONVERGED,
    ITERATION_LIMIT,
    NOT_FINITE,
    Channels,
    FitProblem,
    fill_lane,
    workspace_for,
)
from lunarsci.spectra.mgm.model import MGM_CONTINUA, continuum_basis, is_logarithmic
from lunarsci.spectra.mgm.multistart import KernelFits, coarsened, correct

GRID_NM = np.arange(450.0, 2396.0, 5.0)
BANDS = np.array([[0.3, 0.25, -0.5], [0.92, 0.19, -0.35], [1.02, 0.05, -0.20], [1.86, 0.52, -0.25]])


@compiled
def _functions(values: Any, bells: Any, logarithms: Any) -> None:
    for row in range(values.shape[0]):
        x = load(values, row)
        store(bells, row, exponential(x * x * -0.5))
        store(logarithms, row, logarithm(load(values, row)))


def test_exponential_and_logarithm() -> None:
    values, bells, logarithms = aligned(500), aligned(500), aligned(500)
    values[:] = np.geomspace(1e-9, 30.0, values.size).reshape(values.shape)
    values[-1] = 1.0
    _functions(values, bells, logarithms)
    assert np.allclose(bells, np.exp(-(values**2) / 2), rtol=1e-13, atol=0)
    assert np.allclose(logarithms, np.log(values), rtol=1e-14, atol=1e-16)


@compiled
def _solve(matrix: Any, size: int, solution: Any, inverse: Any) -> None:
    side = matrix_side(matrix)
    store(solution, size, factorise(matrix, side))
    back_substitute(matrix, size, side, solution)
    invert(matrix, size, side, inverse)


@pytest.mark.parametrize("size", [1, 4, 7, 30])
def test_systems_are_solved_and_inverted(size: int) -> None:
    rng = np.random.default_rng(size)
    roots, right = rng.normal(size=(LANES, size, size)), rng.normal(size=(LANES, size))
    matrices = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(size)
    space, solution, inverse = padded_matrix(size), aligned(size + 1), aligned(size * size)
    side = matrix_side(space)
    for p in range(size):
        space[p * side + p : p * side + size] = matrices[:, p, p:].T
        space[(p + 1) * side - 4] = right[:, p]
    _solve(space, size, solution, inverse)
    assert (solution[size] > 0).all()
    upper = inverse.T.reshape(LANES, size, size)
    for lane in range(LANES):
        assert np.allclose(solution[:size, lane], np.linalg.solve(matrices[lane], right[lane]), rtol=1e-8)
        assert np.allclose(np.triu(upper[lane]), np.triu(np.linalg.inv(matrices[lane])), rtol=1e-8)


def test_a_matrix_that_is_not_positive_definite_is_reported_in_its_lane() -> None:
    space, solution, inverse = padded_matrix(2), aligned(3), aligned(4)
    space[0], space[matrix_side(space) + 1] = 1.0, 1.0
    space[1] = np.where(np.arange(LANES) == 3, 2.0, 0.5)
    _solve(space, 2, solution, inverse)
    assert ((solution[2] > 0) == (np.arange(LANES) != 3)).all()


@compiled
def _normal_equations(space: Any, degrees: int, logarithmic: bool) -> None:
    channels = (space.wavelength, space.basis, space.data, space.roots)
    evaluate(channels, space.trial, degrees, logarithmic, 1, space.work, space.residuals, space.sums)
    update(space.sums, space.trial, degrees, spread(1.0), space.curvature, space.slope)


@pytest.mark.parametrize("name", ["wavelength-quadratic", "log-quadratic", "none"])
def test_normal_equations_are_those_of_the_jacobian(name: str) -> None:
    basis = continuum_basis(name, GRID_NM)
    logarithmic, degrees, rng = name != "wavelength-quadratic", basis.shape[1], np.random.default_rng(5)
    points = [
        np.concatenate([[0.4, 0.1, 0.02][:degrees], (BANDS * rng.uniform(0.9, 1.1)).ravel()]) for _ in range(LANES)
    ]
    data, root = rng.normal(-1, 0.1, (LANES, GRID_NM.size)), rng.uniform(50, 100, (LANES, GRID_NM.size))
    spectra = Channels(GRID_NM[None] / 1e3, np.ascontiguousarray(basis.T)[None], data, root)
    space = workspace_for(points[0].size, degrees, GRID_NM.size)
    for lane in range(LANES):
        fill_lane(spectra, lane, space, lane)
        space.trial[:, lane] = points[lane]
    _normal_equations(space, degrees, logarithmic)
    for lane in range(LANES):
        found = model_and_jacobian(points[lane], GRID_NM / 1e3, basis, logarithmic)
        jacobian, residual = found[1] * root[lane], (data[lane] - found[0]) * root[lane]
        curvature = jacobian @ jacobian.T
        scale = np.sqrt(np.outer(np.diag(curvature), np.diag(curvature)))
        ours = space.curvature[:, lane].reshape(curvature.shape)
        assert np.allclose(np.triu(ours / scale), np.triu(curvature / scale), atol=1e-11)
        assert np.allclose(space.slope[:, lane], jacobian @ residual, rtol=1e-9)
        assert space.sums[(degrees + 1) ** 2 - 1, lane] == pytest.approx(residual @ residual, rel=1e-12)


def test_corrected_coarse_spectra_have_the_slope_of_the_fine_ones() -> None:
    """Where the slope counts, in units of the standard errors: to a hundredth of what it was apart."""
    rng, basis = np.random.default_rng(8), continuum_basis("wavelength", GRID_NM)
    point = np.concatenate([[0.4, 0.1], BANDS[1:].ravel()])
    point[6] = 0.2
    truth = model_and_jacobian(point, GRID_NM / 1e3, basis, False)
    data = truth[0] + rng.normal(scale=0.005, size=(3, GRID_NM.size))
    root = rng.uniform(100, 200, data.shape) * (rng.uniform(size=data.shape) > 0.1)
    fine = Channels(GRID_NM[None] / 1e3, np.ascontiguousarray(basis.T)[None], data, root)
    size = point.size
    sigma = np.concatenate([[np.inf] * 2, np.tile([0.02, 0.03, 0.2], 3)])
    problem = FitProblem(2, False, point, np.diag(sigma**-2.0), np.full(size, -np.inf), np.full(size, np.inf))
    points = np.tile(point * 1.001, (3, 1))
    before, after = coarsened(fine, 8), coarsened(fine, 8)
    spaces = workspace_for(size, 2, GRID_NM.size), workspace_for(size, 2, after.data.shape[1])
    correct(fine, after, 8, problem, points, spaces)

    def slope(spectra: Channels, row: int) -> tuple[np.ndarray, np.ndarray]:
        own = min(row, len(spectra.wavelength) - 1)
        found = model_and_jacobian(points[row], spectra.wavelength[own], spectra.basis[own].T, False)
        jacobian = found[1] * spectra.root_weight[row]
        return jacobian @ ((spectra.data[row] - found[0]) * spectra.root_weight[row]), jacobian @ jacobian.T

    for row in range(3):
        wanted, curvature = slope(fine, row)
        covariance = np.linalg.inv(curvature + problem.precision)
        was, now = (slope(spectra, row)[0] - wanted for spectra in (before, after))
        assert now @ covariance @ now < 1e-2 * (was @ covariance @ was)


@compiled
def _clip(point: Any, lower: Any, upper: Any, step: Any, free: Any, held: Any, crossed: Any) -> None:
    store(crossed, 0, clip_to_bounds(point, lower, upper, step, free, held))


def test_steps_end_at_bounds_and_free_no_longer_what_would_cross_them() -> None:
    """Parameter 0 lies between -1 and 2, parameter 1 has no bounds, parameter 2 is held already."""
    lower, upper = np.array([-1.0, -np.inf, -1.0]), np.array([2.0, np.inf, 2.0])
    point, step, free = np.full((3, LANES), 0.5), aligned(3), aligned(3)
    step[:], free[:2] = [1.0, 1.5, 1.6, -1.5, -1.6, -9.0, 9.0, 0.0], 1.0
    wanted, crossed, held = step.copy(), aligned(1), aligned(3)
    held[:] = 0.0
    _clip(point, lower, upper, step, free, held, crossed)
    assert step[0].tolist() == [1.0, 1.5, 1.5, -1.5, -1.5, -1.5, 1.5, 0.0]
    assert free[0].tolist() == [1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert (step[1:] == wanted[1:]).all() and (free[1] == 1.0).all() and (free[2] == 0.0).all()
    assert (crossed[0] > 0).tolist() == (free[0] == 0.0).tolist()
    assert (held == np.array([free[0] == 0.0, [0.0] * LANES, [0.0] * LANES])).all()


@compiled
def _hold(matrix: Any, held: Any, later: Any, units: Any, solution: Any, free: Any, step: Any) -> None:
    factorise(matrix, matrix_side(matrix))
    hold(matrix, held, units, solution, free, step)
    for p in range(free.shape[0]):
        store(held, p, load(held, p) + load(later, p))
    hold(matrix, held, units, solution, free, step)


def test_a_system_is_solved_again_with_some_unknowns_given() -> None:
    """Of ten unknowns each lane has others given, the first lane none, some of them later; by numpy without these."""
    size, rng = 10, np.random.default_rng(2)
    roots, right, given = (rng.normal(size=(LANES, size, size)), *rng.normal(size=(2, LANES, size)))
    matrices = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(size)
    space, free, held, step = padded_matrix(size), aligned(size), aligned(size), aligned(size)
    side = matrix_side(space)
    for p in range(size):
        space[p * side + p : p * side + size] = matrices[:, p, p:].T
        space[(p + 1) * side - 4] = right[:, p]
    free[:] = rng.random((size, LANES)) < 0.6
    free[:, 0], step[:] = 1.0, given.T
    later = (1.0 - free) * (rng.random((size, LANES)) < 0.5)
    held[:] = 1.0 - free - later
    _hold(space, held, later, aligned(size * size), aligned(size), free, step)
    for lane in range(LANES):
        moves, stays = free[:, lane] == 1.0, free[:, lane] == 0.0
        matrix, wanted = matrices[lane], given[lane].copy()
        wanted[moves] = np.linalg.solve(
            matrix[np.ix_(moves, moves)], right[lane, moves] - matrix[np.ix_(moves, stays)] @ given[lane, stays]
        )
        assert np.allclose(step[:, lane], wanted, rtol=1e-8)


GRID = GRID_NM / 1e3
BANDS_KERNEL = np.array([[0.92, 0.19, -0.35], [1.02, 0.22, -0.20], [1.86, 0.52, -0.25], [2.30, 0.55, -0.15]])
POINT = np.concatenate([[0.4, 0.1], BANDS_KERNEL.ravel()])


def evaluated(point: np.ndarray, basis: np.ndarray, logarithmic: bool = False) -> tuple[np.ndarray, np.ndarray]:
    found = model_and_jacobian(point, GRID, basis, logarithmic)
    assert found is not None
    return found


def written_out(point: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """The same model from lmfit's area-normalised Gaussian."""
    total = np.log(basis @ point[: basis.shape[1]])
    for centre, fwhm, strength in point[basis.shape[1] :].reshape(-1, 3):
        sigma = fwhm / 2.3548200450309493  # 2 sqrt(2 ln 2), any table of the normal law
        total = total + gaussian(GRID, strength * sigma * np.sqrt(2 * np.pi), centre, sigma)
    return total


def test_model_is_gaussians_in_wavelength_over_a_continuum_in_the_logarithm() -> None:
    basis = continuum_basis("wavelength", GRID_NM)
    assert np.allclose(evaluated(POINT, basis)[0], written_out(POINT, basis), atol=1e-12)


@pytest.mark.parametrize("name", MGM_CONTINUA)
def test_jacobian_agrees_with_central_differences(name: str) -> None:
    basis = continuum_basis(name, GRID_NM)
    logarithmic = is_logarithmic(name)
    point = np.concatenate([[0.4, 0.1, 0.05, 0.02][: basis.shape[1]], BANDS_KERNEL.ravel()])
    _, jacobian = evaluated(point, basis, logarithmic)
    for k in range(point.size):
        step = np.zeros(point.size)
        step[k] = 1e-6
        forward, backward = evaluated(point + step, basis, logarithmic), evaluated(point - step, basis, logarithmic)
        assert np.allclose(jacobian[k], (forward[0] - backward[0]) / 2e-6, atol=1e-7), k


@pytest.mark.parametrize("name", ["log-quadratic", "none"])
def test_logarithmic_continua_are_polynomials_of_ln_c(name: str) -> None:
    basis = continuum_basis(name, GRID_NM)
    coefficients = np.array([-1.5, 0.2, -0.1])[: basis.shape[1]]
    u = (GRID_NM - 1500) / 1100
    by_hand = coefficients @ np.vander(u, coefficients.size, increasing=True).T if coefficients.size else 0.0
    flat = np.array([[1.0, 0.2, 0.0]])
    model, _ = evaluated(np.concatenate([coefficients, flat.ravel()]), basis, True)
    assert np.allclose(model, by_hand, atol=1e-12)


def test_a_continuum_that_falls_to_zero_is_refused() -> None:
    basis = continuum_basis("wavelength", GRID_NM)
    below = POINT.copy()
    below[1] = -2.0
    assert model_and_jacobian(below, GRID, basis, False) is None


PRIOR = np.concatenate([[0, 0], np.array([[0.91, 0.2, 0], [1.03, 0.2, 0], [1.9, 0.5, 0], [2.3, 0.6, 0]]).ravel()])
SIGMA = np.concatenate([[np.inf, np.inf], np.tile([0.02, 0.04, 0.5], 4)])
UPPER = np.concatenate([[np.inf, np.inf], np.tile([np.inf, np.inf, 0.0], 4)])
LIMITS = (PRIOR, np.diag(SIGMA**-2.0), np.full(PRIOR.size, -np.inf), UPPER)
"""The prior, and its bounds."""


def fitted_by_kernel(
    data: np.ndarray, weight: np.ndarray, grid: np.ndarray, basis: np.ndarray, prior: tuple[np.ndarray, ...],
    starts: np.ndarray, hops: np.ndarray, tolerance: float, most: int,
) -> KernelFits:  # fmt: skip
    """Channels without weight are masked, whatever their datum; `prior` is mean, precision, lower and upper bounds."""
    columns = np.ascontiguousarray(basis.T)[None]
    spectra = Channels(grid[None], columns, np.where(weight > 0, data, 0.0), np.sqrt(weight))
    return fit_batch(spectra, FitProblem(basis.shape[1], False, *prior), starts, hops, tolerance, most)


def test_the_minimum_is_that_of_lmfit() -> None:
    """lmfit with numerical derivatives on the same residuals (data and prior rows), strengths bounded at 0."""
    rng = np.random.default_rng(11)
    basis, noise = continuum_basis("wavelength", GRID_NM), 0.005
    data = written_out(POINT, basis) + rng.normal(scale=noise, size=GRID.size)
    start = PRIOR.copy()
    start[0], start[4::3] = 0.4, -0.1
    weight = np.full((1, GRID.size), noise**-2)
    found = fitted_by_kernel(data[None], weight, GRID, basis, LIMITS, start[None, None], np.empty((0, 2)), 1e-8, 200)

    parameters = lmfit.Parameters()
    for k, value in enumerate(start):
        parameters.add(f"p{k}", value=value, max=UPPER[k])

    def residual(current: lmfit.Parameters) -> np.ndarray:
        point = np.array([current[f"p{k}"].value for k in range(start.size)])
        return np.concatenate([(data - written_out(point, basis)) / noise, ((point - PRIOR) / SIGMA)[2:]])

    best = lmfit.minimize(residual, parameters, method="least_squares", scale_covar=False, xtol=1e-12, ftol=1e-12)
    assert found.objective[0] == pytest.approx(best.chisqr, rel=1e-6)
    theirs = np.array([best.params[f"p{k}"].value for k in range(start.size)])
    errors = np.sqrt(np.diag(found.covariance[0]))
    assert np.all(np.abs(found.parameters[0] - theirs) < 1e-3 * errors)
    stderr = np.array([best.params[f"p{k}"].stderr for k in range(start.size)])
    assert np.allclose(errors, stderr, rtol=0.02)


HOPS = np.array([[row, -4.0] for row in (4, 7, 10, 13)])
BASIS = continuum_basis("wavelength", GRID_NM)


def simulated(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Spectra whose bands differ, with weights that differ from channel to channel."""
    rng = np.random.default_rng(seed)
    data, sigma = np.empty((count, GRID.size)), rng.uniform(0.003, 0.02, (count, GRID.size))
    for row in range(count):
        point = POINT * rng.uniform(0.97, 1.03, POINT.size)
        data[row] = written_out(point, BASIS) + rng.normal(size=GRID.size) * sigma[row]
    return data, sigma**-2.0


def kernel(data: np.ndarray, weight: np.ndarray, keep: object = slice(None), **changes: np.ndarray) -> KernelFits:
    lower, upper = changes.get("lower", np.full(PRIOR.size, -np.inf)), changes.get("upper", UPPER)
    first = PRIOR.copy()
    first[0], first[4::3] = 0.4, -0.1
    second = first + np.concatenate([[0, 0], np.tile([0.02, 0.02, -0.1], 4)])
    starts = np.repeat(np.array([first, second])[:, None], len(data), axis=1)
    limits = (changes.get("prior", PRIOR), LIMITS[1], lower, upper)
    return fitted_by_kernel(data[:, keep], weight[:, keep], GRID[keep], BASIS[keep], limits, starts, HOPS, 1e-8, 300)


def test_nor_does_one_whose_steps_cross_bounds() -> None:
    data, weight = simulated(21, 14)
    reach = np.where(np.isfinite(SIGMA), 0.7 * SIGMA, np.inf)
    bounds = {"lower": PRIOR - reach, "upper": np.minimum(PRIOR + reach, UPPER)}
    bounds["lower"][4::3] = -0.3
    together = kernel(data, weight, **bounds)
    assert np.mean((together.parameters == bounds["lower"]) | (together.parameters == bounds["upper"])) > 0.1
    for row in range(21):
        alone = kernel(data[row : row + 1], weight[row : row + 1], **bounds)
        assert np.array_equal(alone.parameters[0], together.parameters[row])
        assert alone.iterations[0] == together.iterations[row]


def test_masked_channels_are_as_if_removed() -> None:
    data, weight = simulated(3, 6)
    mask = np.random.default_rng(7).uniform(size=GRID.size) < 0.2
    mask[:9] = mask[-3:] = True
    masked_data, masked_weight = data.copy(), weight.copy()
    masked_data[:, mask], masked_weight[:, mask] = np.nan, 0.0
    masked, removed = kernel(masked_data, masked_weight), kernel(data, weight, keep=~mask)
    errors = np.sqrt(np.diagonal(removed.covariance, axis1=1, axis2=2))
    assert np.all(np.abs(masked.parameters - removed.parameters) < 1e-3 * errors)
    assert np.allclose(masked.objective, removed.objective, rtol=1e-9)


def test_bounds_hold_exactly_and_the_others_follow() -> None:
    """A centre may not go where the data want it; the minimum under that bound is that of a fit with it fixed there."""
    data, weight = simulated(4, 9)
    free = kernel(data, weight)
    lower = np.full(PRIOR.size, -np.inf)
    lower[2] = free.parameters[:, 2].max() + 0.003
    bounded = kernel(data, weight, lower=lower)
    assert (bounded.status == CONVERGED).all()
    assert (bounded.parameters[:, 2] == lower[2]).all()
    assert (bounded.parameters[:, 4::3] <= 0).all()
    upper = UPPER.copy()
    upper[2] = lower[2]
    fixed = kernel(data, weight, lower=lower, upper=upper)
    assert (fixed.parameters[:, 2] == lower[2]).all()
    assert np.allclose(bounded.objective, fixed.objective, rtol=1e-9)
    assert (bounded.objective > free.objective).all()


def test_spectra_without_a_fit_are_reported_and_leave_the_others_alone() -> None:
    """A start with a continuum below zero, in the company of one that has none."""
    data, weight = simulated(2, 12)
    start = PRIOR.copy()
    start[0], start[4::3] = 0.4, -0.1
    starts = np.array([[start, start]])
    starts[0, 0, 0] = -1.0
    found = fitted_by_kernel(data, weight, GRID, BASIS, LIMITS, starts, HOPS, 1e-8, 300)
    assert found.status.tolist() == [NOT_FINITE, CONVERGED]
    assert found.objective[0] == np.inf
    alone = kernel(data[1:], weight[1:])
    assert found.objective[1] == pytest.approx(alone.objective[0], rel=1e-9)


def test_the_iteration_limit_is_reported() -> None:
    data, weight = simulated(1, 3)
    start = PRIOR.copy()
    start[0], start[4::3] = 0.4, -0.1
    found = fitted_by_kernel(data, weight, GRID, BASIS, LIMITS, start[None, None], np.empty((0, 2)), 1e-12, 1)
    assert found.status[0] == ITERATION_LIMIT
    assert found.iterations[0] == 1
