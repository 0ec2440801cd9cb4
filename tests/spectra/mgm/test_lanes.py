"""Eight numbers side by side, the systems they solve and the spectra they carry, against NumPy and the plain model."""

from typing import Any

import numpy as np
import pytest

from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES
from lunarsci.compiled.lanes import aligned, exponential, load, logarithm, spread, store
from lunarsci.spectra.mgm.forward import (
    back_substitute,
    clip_to_bounds,
    evaluate,
    factorise,
    invert,
    matrix_side,
    model_and_jacobian,
    padded_matrix,
    update,
)
from lunarsci.spectra.mgm.levenberg_marquardt import (
    Channels,
    FitProblem,
    channels_of,
    coarsened,
    correct,
    fill_lane,
    workspace_for,
)
from lunarsci.spectra.mgm.model import continuum_basis

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
    evaluate(channels_of(space), space.trial, degrees, logarithmic, 1, space.work, space.residuals, space.sums)
    update(space.sums, space.trial, degrees, spread(1.0), space.curvature, space.slope)


@pytest.mark.parametrize("name", ["wavelength-quadratic", "log-quadratic", "none"])
def test_normal_equations_are_those_of_the_jacobian(name: str) -> None:
    basis = continuum_basis(name, GRID_NM)  # type: ignore[arg-type]
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
        assert found is not None
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
    assert truth is not None
    data = truth[0] + rng.normal(scale=0.005, size=(3, GRID_NM.size))
    root = rng.uniform(100, 200, data.shape) * (rng.uniform(size=data.shape) > 0.1)
    fine = Channels(GRID_NM[None] / 1e3, np.ascontiguousarray(basis.T)[None], data, root)
    size = point.size
    sigma = np.concatenate([[np.inf] * 2, np.tile([0.02, 0.03, 0.2], 3)])
    problem = FitProblem(2, False, point, np.diag(sigma**-2.0), np.full(size, -np.inf), np.full(size, np.inf))
    points = np.tile(point * 1.001, (3, 1))
    before, after = coarsened(fine, 8), coarsened(fine, 8)
    correct(
        fine,
        after,
        8,
        problem,
        points,
        workspace_for(size, 2, GRID_NM.size),
        workspace_for(size, 2, after.data.shape[1]),
    )

    def slope(spectra: Channels, row: int) -> tuple[np.ndarray, np.ndarray]:
        own = min(row, len(spectra.wavelength) - 1)
        found = model_and_jacobian(points[row], spectra.wavelength[own], spectra.columns[own].T, False)
        assert found is not None
        jacobian = found[1] * spectra.root_weight[row]
        return jacobian @ ((spectra.data[row] - found[0]) * spectra.root_weight[row]), jacobian @ jacobian.T

    for row in range(3):
        wanted, curvature = slope(fine, row)
        covariance = np.linalg.inv(curvature + problem.precision)
        was, now = (slope(spectra, row)[0] - wanted for spectra in (before, after))
        assert now @ covariance @ now < 1e-2 * (was @ covariance @ was)


@compiled
def _clip(point: Any, lower: Any, upper: Any, step: Any, free: Any, crossed: Any) -> None:
    store(crossed, 0, clip_to_bounds(point, lower, upper, step, free))


def test_steps_end_at_bounds_and_free_no_longer_what_would_cross_them() -> None:
    """Parameter 0 lies between -1 and 2, parameter 1 has no bounds, parameter 2 is held already."""
    lower, upper = np.array([-1.0, -np.inf, -1.0]), np.array([2.0, np.inf, 2.0])
    point, step, free = np.full((3, LANES), 0.5), aligned(3), aligned(3)
    step[:], free[:2] = [1.0, 1.5, 1.6, -1.5, -1.6, -9.0, 9.0, 0.0], 1.0
    wanted, crossed = step.copy(), aligned(1)
    _clip(point, lower, upper, step, free, crossed)
    assert step[0].tolist() == [1.0, 1.5, 1.5, -1.5, -1.5, -1.5, 1.5, 0.0]
    assert free[0].tolist() == [1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert (step[1:] == wanted[1:]).all() and (free[1] == 1.0).all() and (free[2] == 0.0).all()
    assert (crossed[0] > 0).tolist() == (free[0] == 0.0).tolist()
