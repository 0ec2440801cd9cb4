"""The Modified Gaussian Model, compiled: ln R, its derivatives, and what descents and samplers make of them.

`model_and_jacobian` has one spectrum, for what a fit does once. Descents work on eight spectra side by side: the
derivatives of a band are its Gaussian times powers 0 to 2 of the distance u from its centre, so what the normal
equations need of two bands are five sums of the product of their Gaussians, from which the nine of derivatives follow
(`evaluate`, `update`). The sums are taken over a few channels at a time, which stay in the fastest memory; bands, and
pairs of bands, that are lost in the rounding there are left out. The objective is `scale` times chi-square plus (p -
prior)' precision (p - prior), its step Marquardt's within bounds (`solve_step`).

Matrices have the side - `TILE` rows of the system, padded to a multiple of `TILE` by those of the identity, and `TILE`
columns more, of which the first is a right-hand side and the others are 0. The upper triangle is overwritten by the
factor U of A = U' U, its diagonal by 1/U_kk; the factorisation solves U' y = b on its way. What lies below the diagonal
has no meaning.

Arrays of the descents have a column for each of eight lanes; `Workspace` of `levenberg_marquardt` has their shapes and
units. n is the number of channels, m that of continuum coefficients, p that of all parameters, which are continuum
coefficients, then centre [um], FWHM [um], strength [ln R] of each band.

The sampler's trajectories feel the energy of a particle, half the objective, on all channels; the force may come from
neighbouring channels put together (`force_of`).
"""

import math
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import VECTORS, uncounted
from lunarsci.compiled.lanes import (
    aligned,
    choose,
    exponential,
    filled,
    highest,
    is_above,
    load,
    logarithm,
    lowest,
    negligible,
    root,
    spread,
    store,
)

TILE = 4
"""Rows and columns worked on together, so that each number read is used four times."""
LEAST_PIVOT = 1e-30
"""Stands for a pivot that is not above 0, of which no root could be taken."""


def padded_matrix(size: int, kind: type[np.floating[Any]] = np.float64) -> Any:
    """Workspace for the matrix of a system of so many unknowns, (rows columns, 8)."""
    rows = -(-size // TILE) * TILE
    side = rows + TILE
    matrix = aligned(rows * side, kind=kind)
    for k in range(size, rows):
        matrix[k * side + k] = 1.0
    return matrix


@uncounted
def matrix_side(matrix: Any) -> int:
    """Columns of a matrix: rows (rows + `TILE`) = its size."""
    rows = TILE
    while rows * (rows + TILE) < matrix.shape[0]:
        rows += TILE
    return rows + TILE


@uncounted(forceinline=True)  # type: ignore[untyped-decorator]
def _tile(matrix: Any, side: int, k: int, j: int) -> None:
    """A_kj - sum_i U_ik U_ij, i < k, of `TILE` rows from k and columns from j, each sum in a register of its own."""
    at = k * side + j
    s00, s01, s02, s03 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    at = (k + 1) * side + j
    s10, s11, s12, s13 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    at = (k + 2) * side + j
    s20, s21, s22, s23 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    at = (k + 3) * side + j
    s30, s31, s32, s33 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    for i in range(k):
        left, above = i * side + k, i * side + j
        a, b, c, d = load(matrix, above), load(matrix, above + 1), load(matrix, above + 2), load(matrix, above + 3)
        lead = load(matrix, left)
        s00 -= lead * a
        s01 -= lead * b
        s02 -= lead * c
        s03 -= lead * d
        lead = load(matrix, left + 1)
        s10 -= lead * a
        s11 -= lead * b
        s12 -= lead * c
        s13 -= lead * d
        lead = load(matrix, left + 2)
        s20 -= lead * a
        s21 -= lead * b
        s22 -= lead * c
        s23 -= lead * d
        lead = load(matrix, left + 3)
        s30 -= lead * a
        s31 -= lead * b
        s32 -= lead * c
        s33 -= lead * d
    at = k * side + j
    store(matrix, at, s00)
    store(matrix, at + 1, s01)
    store(matrix, at + 2, s02)
    store(matrix, at + 3, s03)
    at = (k + 1) * side + j
    store(matrix, at, s10)
    store(matrix, at + 1, s11)
    store(matrix, at + 2, s12)
    store(matrix, at + 3, s13)
    at = (k + 2) * side + j
    store(matrix, at, s20)
    store(matrix, at + 1, s21)
    store(matrix, at + 2, s22)
    store(matrix, at + 3, s23)
    at = (k + 3) * side + j
    store(matrix, at, s30)
    store(matrix, at + 1, s31)
    store(matrix, at + 2, s32)
    store(matrix, at + 3, s33)


@uncounted
def factorise(matrix: Any, side: int) -> Any:
    """Factor in place; the least pivot, which is not above 0 where there is no factor."""
    least = filled(matrix, 1.0)
    for block in range(0, side - TILE, TILE):
        for j in range(block, side, TILE):
            _tile(matrix, side, block, j)
        for k in range(block, block + TILE):
            pivot = load(matrix, k * side + k)
            least = lowest(pivot, least)
            inverse = spread(1.0) / root(highest(pivot, spread(LEAST_PIVOT)))
            store(matrix, k * side + k, inverse)
            for j in range(k + 1, side):
                store(matrix, k * side + j, load(matrix, k * side + j) * inverse)
            for row in range(k + 1, block + TILE):
                lead = load(matrix, k * side + row)
                for j in range(row, side):
                    store(matrix, row * side + j, load(matrix, row * side + j) - lead * load(matrix, k * side + j))
    return least


@uncounted
def back_substitute(matrix: Any, size: int, side: int, solution: Any) -> None:
    """Solve U x = y, where y is the right-hand side of the factorised matrix."""
    for k in range(size):
        store(solution, k, load(matrix, (k + 1) * side - TILE))
    for k in range(size - 1, -1, -1):
        value = load(solution, k) * load(matrix, k * side + k)
        store(solution, k, value)
        for i in range(k):
            store(solution, i, load(solution, i) - load(matrix, i * side + k) * value)


@uncounted
def invert(matrix: Any, size: int, side: int, inverse: Any) -> None:
    """Fill the upper triangle of `inverse` (size size, 8) from a factor: V = U^-1 row by row, then V V'."""
    for p in range(size - 1, -1, -1):
        diagonal = load(matrix, p * side + p)
        store(inverse, p * size + p, diagonal)
        for q in range(p + 1, size):
            total = filled(matrix, 0.0)
            for k in range(p + 1, q + 1):
                total += load(matrix, p * side + k) * load(inverse, k * size + q)
            store(inverse, p * size + q, total * diagonal * -1.0)
    for p in range(size):
        for q in range(p, size):
            total = filled(matrix, 0.0)
            for k in range(q, size):
                total += load(inverse, p * size + k) * load(inverse, q * size + k)
            store(inverse, p * size + q, total)


@uncounted(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def prior_share(parameters: Any, prior: Any, precision: Any) -> float:
    """(p - prior)' precision (p - prior) of one point."""
    share = 0.0
    for p in range(parameters.size):
        pull, row = 0.0, precision[p]
        for q in range(parameters.size):
            pull += row[q] * (parameters[q] - prior[q])
        share += pull * (parameters[p] - prior[p])
    return share


@uncounted
def prior_pull(point: Any, prior: Any, precision: Any, pull: Any) -> Any:
    """Fill `pull` with precision (p - prior); (p - prior)' precision (p - prior)."""
    size, share = prior.size, filled(point, 0.0)
    for p in range(size):
        total = filled(point, 0.0)
        for q in range(size):
            if precision[p, q] != 0.0:
                total += (load(point, q) - prior[q]) * precision[p, q]
        store(pull, p, total)
        share += total * (load(point, p) - prior[p])
    return share


@uncounted
def damped(
    curvature: Any, precision: Any, scale: Any, growth: Any, free: Any, size: int, side: int, matrix: Any
) -> None:
    """Fill `matrix` with scale J J' + precision, its diagonal times `growth`; rows and columns that are not free are
    those of the identity."""
    for p in range(size):
        is_free = load(free, p)
        for q in range(p, size):
            value = load(curvature, p * size + q) * scale + precision[p, q]
            store(matrix, p * side + q, value * is_free * load(free, q))
        diagonal = load(matrix, p * side + p) * growth
        store(matrix, p * side + p, choose(is_free, diagonal, spread(1.0)))


@uncounted
def solve_step(
    curvature: Any, precision: Any, scale: Any, growth: Any, slope: Any, pull: Any, free: Any, matrix: Any, step: Any
) -> Any:  # fmt: skip
    """Marquardt's step of the free parameters, that of the others given; the least pivot."""
    size, side = free.shape[0], matrix_side(matrix)
    damped(curvature, precision, scale, growth, free, size, side, matrix)
    for p in range(size):
        descent = load(slope, p) * scale - load(pull, p)
        store(matrix, (p + 1) * side - TILE, choose(load(free, p), descent, load(step, p)))
    least = factorise(matrix, side)
    back_substitute(matrix, size, side, step)
    return least


@uncounted
def _forward_substitute(matrix: Any, size: int, side: int, first: int, solution: Any) -> None:
    """Solve U' y = e, where e is 0 before its place `first`; both are `solution`."""
    for i in range(first, size):
        value = load(solution, i) * load(matrix, i * side + i)
        store(solution, i, value)
        for k in range(i + 1, size):
            store(solution, k, load(solution, k) - load(matrix, i * side + k) * value)


@uncounted
def _product(size: int, first: Any, at: int, stride: int, second: Any) -> Any:
    """Scalar product of a vector and every `stride`-th row of an array from `at`."""
    total = filled(second, 0.0)
    for k in range(size):
        total += load(first, at + k * stride) * load(second, k)
    return total


@uncounted
def hold(matrix: Any, held: Any, units: Any, solution: Any, free: Any, step: Any) -> None:
    """Solve a factorised system again, with the steps of parameters that just crossed a bound given.

    With A = U'U and y = U^-T b, the solution under x_p = s_p is U^-1 (y - w), w the least change that gives s_p. Lanes
    in which nothing crossed keep their solution. This takes size^2 products a parameter, factorising size^3 / 6.

    held : (p, 8) 1 for a parameter that has just crossed, -1 for one that is held already, else 0.
    units : (p p, 8) the directions U^-T e_p of those held, of unit length and at right angles.
    solution : (p, 8) to work in.
    """
    size, side = free.shape[0], matrix_side(matrix)
    for p in range(size):
        new = highest(load(held, p), filled(held, 0.0))
        if not is_above(new, 0.0):
            continue
        for k in range(size):
            store(solution, k, new if k == p else filled(held, 0.0))
        _forward_substitute(matrix, size, side, p, solution)
        gap = _product(size, matrix, side - TILE, side, solution) - load(step, p)
        for q in range(size):
            if is_above(load(held, q) * -1.0, 0.0):
                along = _product(size, units, q * size, 1, solution)
                for k in range(size):
                    store(solution, k, load(solution, k) - along * load(units, q * size + k))
        inverse = spread(1.0) / root(highest(_product(size, solution, 0, 1, solution), spread(LEAST_PIVOT)))
        again = is_above(load(held, p) * -1.0, 0.0)
        for k in range(size):
            unit, at = load(solution, k) * inverse, (k + 1) * side - TILE
            store(matrix, at, load(matrix, at) - gap * inverse * unit)
            store(units, p * size + k, unit + load(units, p * size + k) if again else unit)
        store(held, p, choose(new, filled(held, -1.0), load(held, p)))
    back_substitute(matrix, size, side, solution)
    for p in range(size):
        store(step, p, choose(load(free, p), load(solution, p), load(step, p)))


@uncounted
def clip_to_bounds(point: Any, lower: Any, upper: Any, step: Any, free: Any, held: Any) -> Any:
    """Stop at its bound each step that would cross it, and free its parameter no longer, which `held` marks by 1; above
    0 where one did."""
    crossed = filled(point, 0.0)
    for p in range(lower.size):
        wanted, here, is_free = load(step, p), load(point, p), load(free, p)
        allowed = lowest(highest(wanted, lower[p] - here), upper[p] - here)
        beyond = (allowed - wanted) * (allowed - wanted) * is_free
        store(step, p, choose(is_free, allowed, wanted))
        store(free, p, choose(beyond, spread(0.0), is_free))
        store(held, p, choose(beyond, filled(point, 1.0), load(held, p)))
        crossed = highest(crossed, choose(beyond, filled(point, 1.0), filled(point, 0.0)))
    return crossed


@uncounted
def free_again(
    point: Any, lower: Any, upper: Any, scale: Any, slope: Any, pull: Any, renewed: Any, free: Any, step: Any, held: Any
) -> None:
    """In the lanes where `renewed` is above 0: no step, and every parameter free but those on a bound away from which
    the objective does not fall."""
    for p in range(lower.size):
        here, gradient = load(point, p), load(slope, p) * scale - load(pull, p)
        zero, one = filled(point, 0.0), filled(point, 1.0)
        if lower[p] == upper[p]:
            is_free = zero
        else:
            off_lower = choose(here - lower[p], one, choose(gradient, one, zero))
            off_upper = choose(upper[p] - here, one, choose(zero - gradient, one, zero))
            is_free = off_lower * off_upper
        store(free, p, choose(renewed, is_free, load(free, p)))
        store(step, p, choose(renewed, zero, load(step, p)))
        store(held, p, zero)


@uncounted
def predicted_decrease(curvature: Any, precision: Any, scale: Any, slope: Any, pull: Any, step: Any) -> Any:
    """By how much the quadratic model of the objective falls along a step."""
    size, decrease = step.shape[0], filled(step, 0.0)
    for p in range(size):
        move = load(step, p)
        bend = (load(curvature, p * size + p) * scale + precision[p, p]) * move * 0.5
        for q in range(p + 1, size):
            bend += (load(curvature, p * size + q) * scale + precision[p, q]) * load(step, q)
        decrease += move * (load(slope, p) * scale - load(pull, p) - bend) * 2.0
    return decrease


LEAST_CONTINUUM = 1e-12
"""A continuum that is not above this somewhere has no logarithm, and the model no value."""


@uncounted(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def gaussian(wavelength: Any, centre: float, inverse_sigma: float, values: Any) -> None:
    """Fill `values` (n,) with exp(-(lambda - centre)^2 inverse_sigma^2 / 2)."""
    for i in range(wavelength.size):
        x = (wavelength[i] - centre) * inverse_sigma
        values[i] = exponential(-0.5 * x * x)


FWHM_OVER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Full width at half maximum of a Gaussian over its standard deviation."""


def model_and_jacobian(
    parameters: FloatArray, wavelength_um: FloatArray, basis: FloatArray, logarithmic: bool
) -> tuple[FloatArray, FloatArray] | None:
    """ln R, shape (n,), and its derivatives, shape (p, n); None where the continuum is not above 0.

    ln R = ln C + sum_k s_k exp(-(lambda - mu_k)^2 / (2 sigma_k^2)), sigma_k = FWHM_k / 2.3548. C = basis @ c, or
    ln C = basis @ c where `logarithmic`. Gaussians are symmetric in wavelength.

    Parameters
    ----------
    parameters : (p,) continuum coefficients c, then centre [um], FWHM [um], strength [ln reflectance] of each band.
    wavelength_um, basis : (n,) and (n, m), as `continuum_basis` gives it.

    References
    ----------
    Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955.
    """
    m, (centre, fwhm, strength) = basis.shape[1], parameters[basis.shape[1] :].reshape(-1, 3).T[:, :, None]
    level, jacobian = basis @ parameters[:m], np.empty((parameters.size, wavelength_um.size))
    if not logarithmic and not level.min() > LEAST_CONTINUUM:
        return None
    inverse = FWHM_OVER_SIGMA / fwhm
    x = (wavelength_um - centre) * inverse
    shape = np.exp(x * x * -0.5)
    absorbed, along = shape * strength, shape * x
    jacobian[:m] = basis.T if logarithmic else basis.T / level
    jacobian[m::3] = along * (strength * inverse)
    jacobian[m + 1 :: 3] = along * x * (strength / fwhm)
    jacobian[m + 2 :: 3] = shape
    ln_model = (level if logarithmic else np.log(level)) + absorbed.sum(axis=0)
    return (ln_model, jacobian) if math.isfinite(ln_model.sum()) else None


@uncounted(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _subtract_continuum(
    parameters: Any, basis: Any, logarithmic: bool, data: Any, level: Any, rest: Any
) -> bool:  # fmt: skip
    """Fill `rest` with data - ln C and `level` with what a change of C means for ln C; False where C is not above 0."""
    for i in range(level.size):
        level[i] = 0.0
    for m in range(basis.shape[0]):
        coefficient, basis_row = parameters[m], basis[m]
        for i in range(level.size):
            level[i] += basis_row[i] * coefficient
    if logarithmic:
        for i in range(level.size):
            rest[i] = data[i] - level[i]
            level[i] = 1.0
        return True
    lowest = level[0]
    for i in range(level.size):
        lowest = min(lowest, level[i])
    if not lowest > LEAST_CONTINUUM:
        return False
    for i in range(level.size):
        rest[i] = data[i] - logarithm(level[i])
        level[i] = 1.0 / level[i]
    return True


@uncounted(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _subtract(point: Any, wavelength: Any, basis: Any, logarithmic: bool, data: Any, space: Any) -> bool:
    """Gaussians, data - ln R and level of one spectrum into `space`; False where the continuum is not above 0.

    `wavelength` (n,) [um], `basis` (m, n) and `data` (n,), ln R, are of the spectrum; `space` is Gaussians (bands or
    more, n), data - ln R (n,), and what a change of C means for ln C (n,).
    """
    shapes, rest, level = space
    if not _subtract_continuum(point, basis, logarithmic, data, level, rest):
        return False
    for row in range(basis.shape[0], point.size, 3):
        strength, shape = point[row + 2], shapes[row]
        gaussian(wavelength, point[row], FWHM_OVER_SIGMA / point[row + 1], shape)
        for i in range(wavelength.size):
            rest[i] -= strength * shape[i]
    return True


@uncounted(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def energies_of(target: Any, point: Any, space: Any, energy: Any) -> None:
    """Halves of chi-square, of the prior's share, and of the squared distance of the continuum from its start, (3,).

    `target` is as `run_population` of `intervals` has it; of `space` the first room is for all channels, the second
    for the coarse ones, each as `_subtract` takes it.
    """
    channels, _, logarithmic, prior, precision, start = target[:6]
    wavelength, basis, data, root_weight = channels
    rest, chi2 = space[0][1], 0.0
    if _subtract(point, wavelength, basis, logarithmic, data, space[0]):
        for i in range(wavelength.size):
            chi2 += (rest[i] * root_weight[i]) ** 2
    else:
        chi2 = math.inf
    energy[0] = 0.5 * chi2
    energy[1] = 0.5 * prior_share(point, prior, precision)
    energy[2] = 0.0
    for m in range(start.shape[1]):
        energy[2] += 0.5 * start[1, m] * (point[m] - start[0, m]) ** 2


@uncounted(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def force_of(target: Any, beta: float, point: Any, space: Any, force: Any) -> bool:
    """Minus the slope of the energy, (p,), from the coarse channels; False where the continuum is not above 0.

    `target` and `space` are as in `energies_of`; `beta`, 0 to 1, is the share of the data that has been brought in.
    Any field of force keeps a trajectory reversible and its volume; that it is the energy's own slope to within a
    fraction of a per cent only decides how many trajectories are accepted, by the energy on all channels.
    """
    (wavelength, basis, data, root_weight), logarithmic, prior, precision, start = target[1:6]
    shapes, rest, level = space[1]
    degrees, channels = basis.shape
    if not _subtract(point, wavelength, basis, logarithmic, data, space[1]):
        return False
    for i in range(channels):
        rest[i] *= root_weight[i] * root_weight[i] * beta
    _project(point, wavelength, basis, rest, level, shapes, force)
    for p in range(point.size):
        pull, weights = 0.0, precision[p]
        for q in range(point.size):
            pull += weights[q] * (point[q] - prior[q])
        force[p] -= pull
    for m in range(degrees):
        force[m] -= (1.0 - beta) * start[1, m] * (point[m] - start[0, m])
    return True


@uncounted(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _project(point: Any, wavelength: Any, basis: Any, rest: Any, level: Any, shapes: Any, force: Any) -> None:
    """Sums over channels of `rest`, (n,), times the derivatives of ln R, into `force`, (p,)."""
    degrees, channels = basis.shape
    for m in range(degrees):
        basis_row, total = basis[m], 0.0
        for i in range(channels):
            total += rest[i] * basis_row[i] * level[i]
        force[m] = total
    for row in range(degrees, point.size, 3):
        centre, inverse, strength, shape = point[row], FWHM_OVER_SIGMA / point[row + 1], point[row + 2], shapes[row]
        by_centre, by_fwhm, by_strength = 0.0, 0.0, 0.0
        for i in range(channels):
            x = (wavelength[i] - centre) * inverse
            share = rest[i] * shape[i]
            by_strength += share
            by_centre += share * x
            by_fwhm += share * x * x
        force[row] = by_centre * strength * inverse
        force[row + 1] = by_fwhm * strength / point[row + 1]
        force[row + 2] = by_strength


BLOCK = 8
"""Channels worked on together; their number is a multiple of it."""
MOMENTS = 5
"""Sums of a pair of bands a and b: of the product of their Gaussians times 1, u_a, u_a^2, u_a^2 u_b and u_a^2 u_b^2."""
LEAST = 1e-9
"""A continuum below this, in a trial that will be refused, is replaced by it."""


def rows_of_work(degrees: int, bands: int) -> int:
    """Of the workspace of `evaluate`."""
    return (degrees + 1 + 3 * bands) * BLOCK + bands


def rows_of_sums(degrees: int, bands: int) -> int:
    """Of the sums of `evaluate`: (m + 1)^2 of the plain rows among themselves, 3 of each with each band, 5 of each pair
    of bands, and the lowest value of the continuum."""
    plain = degrees + 1
    return plain * plain + 3 * plain * bands + MOMENTS * bands * bands + 1


@uncounted
def continuum_rows(channels: Any, first: int, point: Any, degrees: int, logarithmic: bool, work: Any) -> Any:
    """Derivatives by the continuum's coefficients and ln R - ln C of one block; the lowest value of C."""
    _, basis, data, roots = channels
    count, least = data.shape[0], filled(data, 1.0)
    for i in range(BLOCK):
        level = filled(data, 0.0)
        for m in range(degrees):
            level += load(basis, m * count + first + i) * load(point, m)
        slope = load(roots, first + i)
        if logarithmic:
            store(work, degrees * BLOCK + i, load(data, first + i) - level)
        else:
            least = lowest(least, level)
            level = choose(level - LEAST, level, spread(LEAST))
            slope = slope / level
            store(work, degrees * BLOCK + i, load(data, first + i) - logarithm(level))
        for m in range(degrees):
            store(work, m * BLOCK + i, load(basis, m * count + first + i) * slope)
    return least


@uncounted
def gaussian_rows(channels: Any, first: int, point: Any, degrees: int, work: Any) -> None:
    """Weighted Gaussians times the powers 0, 1, 2 of u, the residual without the bands, and whether each is there at
    all (above 0 where it is), of one block."""
    wavelength, _, _, roots = channels
    at = degrees * BLOCK
    row, far, nothing = at + BLOCK, at + BLOCK + (point.shape[0] - degrees) * BLOCK, negligible(work)
    for band in range(degrees, point.shape[0], 3):
        centre, inverse = load(point, band), FWHM_OVER_SIGMA / load(point, band + 1)
        strength = load(point, band + 2)
        beyond = (load(wavelength, first) - centre) * inverse
        before = (centre - load(wavelength, first + BLOCK - 1)) * inverse
        apart = highest(highest(beyond, before), spread(0.0))
        inside = nothing - apart * apart * 0.5
        store(work, far, inside)
        if is_above(inside, 0.0):
            for i in range(BLOCK):
                u = load(wavelength, first + i) - centre
                x = u * inverse
                shape = choose(inside, exponential(x * x * -0.5), spread(0.0))
                store(work, at + i, load(work, at + i) - strength * shape)
                shape = shape * load(roots, first + i)
                store(work, row + i, shape)
                shape = shape * u
                store(work, row + BLOCK + i, shape)
                store(work, row + 2 * BLOCK + i, shape * u)
        else:
            for i in range(3 * BLOCK):
                store(work, row + i, spread(0.0))
        row += 3 * BLOCK
        far += 1
    for i in range(BLOCK):
        store(work, at + i, load(work, at + i) * load(roots, first + i))


@uncounted
def _add_plain(work: Any, degrees: int, bands: int, sums: Any) -> None:
    """Sums of the continuum's rows and the residual among themselves and with every band."""
    plain, target = degrees + 1, 0
    far = (plain + 3 * bands) * BLOCK
    for c in range(plain):
        for d in range(plain):
            total = load(sums, target)
            for i in range(BLOCK):
                total += load(work, c * BLOCK + i) * load(work, d * BLOCK + i)
            store(sums, target, total)
            target += 1
    for band in range(bands):
        if not is_above(load(work, far + band), 0.0):
            continue
        row = (plain + 3 * band) * BLOCK
        for c in range(plain):
            target = plain * plain + 3 * (c * bands + band)
            s0, s1, s2 = load(sums, target), load(sums, target + 1), load(sums, target + 2)
            for i in range(BLOCK):
                row_value = load(work, c * BLOCK + i)
                s0 += row_value * load(work, row + i)
                s1 += row_value * load(work, row + BLOCK + i)
                s2 += row_value * load(work, row + 2 * BLOCK + i)
            store(sums, target, s0)
            store(sums, target + 1, s1)
            store(sums, target + 2, s2)


@uncounted
def _add_bands(work: Any, degrees: int, bands: int, sums: Any) -> None:
    """`MOMENTS` of every two bands."""
    begin, start = (degrees + 1) * BLOCK, (degrees + 1) * (degrees + 1 + 3 * bands)
    far, nothing = begin + 3 * bands * BLOCK, negligible(work)
    for a in range(bands):
        p, inside_a = begin + 3 * a * BLOCK, load(work, far + a) - nothing
        for b in range(a, bands):
            inside = inside_a + load(work, far + b)
            if not is_above(inside, 0.0):
                continue
            q, target = begin + 3 * b * BLOCK, start + MOMENTS * (a * bands + b)
            s0, s1, s2 = filled(work, 0.0), filled(work, 0.0), filled(work, 0.0)
            s3, s4 = filled(work, 0.0), filled(work, 0.0)
            for i in range(BLOCK):
                p0, p1, p2 = load(work, p + i), load(work, p + BLOCK + i), load(work, p + 2 * BLOCK + i)
                q0, q1, q2 = load(work, q + i), load(work, q + BLOCK + i), load(work, q + 2 * BLOCK + i)
                s0 += p0 * q0
                s1 += p1 * q0
                s2 += p2 * q0
                s3 += p2 * q1
                s4 += p2 * q2
            _add(sums, target, inside, s0)
            _add(sums, target + 1, inside, s1)
            _add(sums, target + 2, inside, s2)
            _add(sums, target + 3, inside, s3)
            _add(sums, target + 4, inside, s4)


@uncounted(forceinline=True)  # type: ignore[untyped-decorator]
def _add(sums: Any, row: int, inside: Any, value: Any) -> None:
    """Add to a row in the lanes where `inside` is above 0."""
    store(sums, row, load(sums, row) + choose(inside, value, spread(0.0)))


@uncounted
def evaluate(
    channels: Any, point: Any, degrees: int, logarithmic: bool, curved: int, work: Any, residuals: Any, sums: Any
) -> None:
    """Fill `sums`, in the order of `rows_of_sums`, at the points (p, 8); those of pairs of bands where `curved` is 1.

    `channels` are wavelength, basis, ln R and the root of the weight, each (n, 8), the basis (m n, 8).
    `residuals` (n, 8) become data - model, times the root of the weight.
    """
    bands, least = (point.shape[0] - degrees) // 3, filled(point, 1.0)
    last = sums.shape[0] - 1
    for row in range(last):
        store(sums, row, spread(0.0))
    for first in range(0, channels[0].shape[0], BLOCK):
        least = lowest(least, continuum_rows(channels, first, point, degrees, logarithmic, work))
        gaussian_rows(channels, first, point, degrees, work)
        _add_plain(work, degrees, bands, sums)
        if curved > 0:
            _add_bands(work, degrees, bands, sums)
        for i in range(BLOCK):
            store(residuals, first + i, load(work, degrees * BLOCK + i))
    store(sums, last, least)


@uncounted(forceinline=True)  # type: ignore[untyped-decorator]
def _keep(target: Any, row: int, taken: Any, value: Any) -> None:
    """Write a row in the lanes where `taken` is above 0."""
    store(target, row, choose(taken, value, load(target, row)))


@uncounted(forceinline=True)  # type: ignore[untyped-decorator]
def _shape(point: Any, band: int) -> Any:
    """Centre, by_centre and by_width of a band, whose derivatives are g, by strength; u g by_centre; u^2 g by_width,
    with g its Gaussian and u the wavelength less the centre."""
    centre, inverse = load(point, band), FWHM_OVER_SIGMA / load(point, band + 1)
    by_centre = load(point, band + 2) * inverse * inverse
    return centre, by_centre, by_centre / load(point, band + 1)


@uncounted(forceinline=True)  # type: ignore[untyped-decorator]
def _keep_band(target: Any, row: int, stride: int, taken: Any, shape: Any, s0: Any, s1: Any, s2: Any) -> None:
    """Sums of something with g, u g, u^2 g become those with a band's derivatives by centre, width and strength."""
    _, by_centre, by_width = shape
    _keep(target, row, taken, s1 * by_centre)
    _keep(target, row + stride, taken, s2 * by_width)
    _keep(target, row + 2 * stride, taken, s0)


@uncounted(forceinline=True)  # type: ignore[untyped-decorator]
def _between_bands(sums: Any, row: int, first: Any, second: Any, target: Any, at: int, side: int, taken: Any) -> None:
    """The nine products of the derivatives of two bands, a and b; u_b = u_a + d gives the four that are not summed."""
    s0, s1, s2 = load(sums, row), load(sums, row + 1), load(sums, row + 2)
    s3, s4 = load(sums, row + 3), load(sums, row + 4)
    centre, by_centre, by_width = first
    d = centre - second[0]
    b, ab = s1 + d * s0, s2 + d * s1
    _keep_band(target, at, 1, taken, second, s1 * by_centre, ab * by_centre, (s3 + d * ab) * by_centre)
    _keep_band(target, at + side, 1, taken, second, s2 * by_width, s3 * by_width, s4 * by_width)
    _keep_band(target, at + 2 * side, 1, taken, second, s0, b, ab + d * b)


@uncounted
def update(sums: Any, point: Any, degrees: int, taken: Any, curvature: Any, slope: Any) -> None:
    """In the lanes where `taken` is above 0: the upper triangle of J J' into `curvature` (p p, 8), J r into `slope`."""
    size, plain = point.shape[0], degrees + 1
    bands = (size - degrees) // 3
    with_bands = plain * plain
    between = with_bands + 3 * plain * bands
    for c in range(degrees):
        for d in range(degrees):
            _keep(curvature, c * size + d, taken, load(sums, c * plain + d))
        _keep(slope, c, taken, load(sums, c * plain + degrees))
    for a in range(bands):
        p = degrees + 3 * a
        first = _shape(point, p)
        for c in range(plain):
            row = with_bands + 3 * (c * bands + a)
            s0, s1, s2 = load(sums, row), load(sums, row + 1), load(sums, row + 2)
            if c < degrees:
                _keep_band(curvature, c * size + p, 1, taken, first, s0, s1, s2)
            else:
                _keep_band(slope, p, 1, taken, first, s0, s1, s2)
        for b in range(a, bands):
            q = degrees + 3 * b
            _between_bands(
                sums, between + MOMENTS * (a * bands + b), first, _shape(point, q), curvature, p * size + q, size, taken
            )
