"""The Modified Gaussian Model itself, compiled: ln R and its derivatives with respect to every parameter.

The energy of a particle, half the objective, and its slope: what the sampler's trajectories feel. The energy counts on
all channels; the force may come from neighbouring channels put together, see `force_of`.
"""

import math
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.compiled import VECTORS, compiled
from lunarsci.compiled.lanes import exponential, logarithm
from lunarsci.spectra.mgm.normal_equations import prior_share


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def gaussian(wavelength: Any, centre: float, inverse_sigma: float, values: Any) -> None:
    """Fill `values` (n,) with exp(-(lambda - centre)^2 inverse_sigma^2 / 2)."""
    for i in range(wavelength.size):
        x = (wavelength[i] - centre) * inverse_sigma
        values[i] = exponential(-0.5 * x * x)


FWHM_OVER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))


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
    size = wavelength_um.size
    residual, work = np.empty(size), np.empty(size)
    jacobian = np.empty((parameters.size, size))
    chi2 = residuals(
        parameters, wavelength_um, np.ascontiguousarray(basis.T), logarithmic, np.zeros(size), np.ones(size), residual,
        jacobian, work,
    )  # fmt: skip
    return (-residual, jacobian) if math.isfinite(chi2) else None


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def residuals(
    parameters: Any, wavelength: Any, columns: Any, logarithmic: bool, data: Any, root_weight: Any, residual: Any,
    jacobian: Any, work: Any,
) -> float:  # fmt: skip
    """Fill `residual` (n,) with data - ln R and `jacobian` (p, n) with the derivatives of ln R, both times the root of
    the weight; return chi-square, infinite where the continuum is not above 0. `columns` is the basis, (m, n).
    """
    channels = wavelength.size
    if not _continuum(parameters, columns, logarithmic, data, root_weight, residual, jacobian, work):
        return math.inf
    for row in range(columns.shape[0], parameters.size, 3):
        centre, fwhm, strength = parameters[row], parameters[row + 1], parameters[row + 2]
        inverse = FWHM_OVER_SIGMA / fwhm
        gaussian(wavelength, centre, inverse, work)
        by_centre, by_fwhm, by_strength = jacobian[row], jacobian[row + 1], jacobian[row + 2]
        slope, bend = strength * inverse, strength / fwhm
        for i in range(channels):
            x = (wavelength[i] - centre) * inverse
            residual[i] -= strength * work[i]
            shape = work[i] * root_weight[i]
            by_strength[i] = shape
            by_centre[i] = shape * x * slope
            by_fwhm[i] = shape * x * x * bend
    chi2 = 0.0
    for i in range(channels):
        residual[i] *= root_weight[i]
        chi2 += residual[i] * residual[i]
    return chi2


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _continuum(
    parameters: Any, columns: Any, logarithmic: bool, data: Any, root_weight: Any, residual: Any, jacobian: Any,
    work: Any,
) -> bool:  # fmt: skip
    """The continuum's share of `residual` and `jacobian`; False where it is not above 0."""
    degrees, channels = columns.shape
    for i in range(channels):
        work[i] = 0.0
    for m in range(degrees):
        coefficient, column = parameters[m], columns[m]
        for i in range(channels):
            work[i] += column[i] * coefficient
    if logarithmic:
        for i in range(channels):
            residual[i] = data[i] - work[i]
            work[i] = root_weight[i]
    else:
        lowest = work[0]
        for i in range(channels):
            lowest = min(lowest, work[i])
        if not lowest > 0.0:
            return False
        for i in range(channels):
            residual[i] = data[i] - logarithm(work[i])
        for i in range(channels):
            work[i] = root_weight[i] / work[i]
    for m in range(degrees):
        row, column = jacobian[m], columns[m]
        for i in range(channels):
            row[i] = column[i] * work[i]
    return True


RIDGE = 1e-10
"""Added to the diagonal of a matrix, relatively, before it is factorised."""
LEAST_CONTINUUM = 1e-12


@compiled
def _chi2(channels: Any, logarithmic: bool, point: Any, space: Any) -> float:
    wavelength, columns, data, root_weight = channels
    jacobian, residual, work = space
    chi2: float = residuals(point, wavelength, columns, logarithmic, data, root_weight, residual, jacobian, work)
    return chi2


@compiled
def energies_of(target: Any, point: Any, space: Any, energy: Any) -> None:
    """Halves of chi-square, of the prior's share, and of the squared distance of the continuum from its start."""
    channels, _, logarithmic, prior, precision, start = target[:6]
    energy[0] = 0.5 * _chi2(channels, logarithmic, point, space[0])
    energy[1] = 0.5 * prior_share(point, prior, precision)
    energy[2] = 0.0
    for m in range(start.shape[1]):
        energy[2] += 0.5 * start[1, m] * (point[m] - start[0, m]) ** 2


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def force_of(target: Any, beta: float, point: Any, space: Any, force: Any) -> bool:
    """Minus the slope of the energy, from the coarse channels; False where the continuum is not above 0.

    Any field of force keeps a trajectory reversible and its volume; that it is the energy's own slope to within a
    fraction of a per cent only decides how many trajectories are accepted, by the energy on all channels.
    """
    (wavelength, columns, data, root_weight), logarithmic, prior, precision, start = target[1:6]
    shapes, rest, level = space[1]
    degrees, channels = columns.shape
    for i in range(channels):
        level[i] = 0.0
    for m in range(degrees):
        coefficient, column = point[m], columns[m]
        for i in range(channels):
            level[i] += column[i] * coefficient
    if not _subtract_continuum(data, level, logarithmic, rest):
        return False
    for row in range(degrees, point.size, 3):
        strength, shape = point[row + 2], shapes[row]
        gaussian(wavelength, point[row], FWHM_OVER_SIGMA / point[row + 1], shape)
        for i in range(channels):
            rest[i] -= strength * shape[i]
    for i in range(channels):
        rest[i] *= root_weight[i] * root_weight[i] * beta
    _project(point, wavelength, columns, rest, level, shapes, force)
    for p in range(point.size):
        pull, own = 0.0, precision[p]
        for q in range(point.size):
            pull += own[q] * (point[q] - prior[q])
        force[p] -= pull
    for m in range(degrees):
        force[m] -= (1.0 - beta) * start[1, m] * (point[m] - start[0, m])
    return True


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _subtract_continuum(data: Any, level: Any, logarithmic: bool, rest: Any) -> bool:
    """Fill `rest` with data - ln C and turn `level` into what a change of C means for ln C."""
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


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _project(point: Any, wavelength: Any, columns: Any, rest: Any, level: Any, shapes: Any, force: Any) -> None:
    """Sums of `rest` times the derivatives of ln R."""
    degrees, channels = columns.shape
    for m in range(degrees):
        column, total = columns[m], 0.0
        for i in range(channels):
            total += rest[i] * column[i] * level[i]
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


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def correct_coarse(target: Any, groups: Any, best: Any, space: Any) -> None:
    """Set the coarse data so that residuals and slope at `best` are those of all channels.

    Means of the residuals alone leave out how noise and slopes go together within a coarse channel.
    """
    channels, coarse, logarithmic, _, precision = target[:5]
    _chi2(channels, logarithmic, best, space[0])
    coarse[2][:] = 0.0
    _chi2(coarse, logarithmic, best, space[1])
    jacobian, wanted, root_weight, model = space[1][0], np.zeros(space[1][1].size), coarse[3], space[1][1]
    for i in range(groups.size):
        wanted[groups[i]] += channels[3][i] * space[0][1][i] / root_weight[groups[i]]
    size = best.size
    matrix, missing = np.empty((size, size)), np.zeros(size)
    for p in range(size):
        missing[p] = (space[0][0][p] * space[0][1]).sum() - (jacobian[p] * wanted).sum()
        for q in range(p + 1):
            matrix[p, q] = (jacobian[p] * jacobian[q]).sum() + precision[p, q]
        matrix[p, p] *= 1.0 + RIDGE
    if lower_factor(matrix):
        solve_lower(matrix, missing)
        for p in range(size):
            wanted += missing[p] * jacobian[p]
    for j in range(root_weight.size):
        coarse[2][j] = (wanted[j] - model[j]) / root_weight[j]


@compiled
def lower_factor(matrix: Any) -> bool:
    """Overwrite the lower triangle by its Cholesky factor; False where there is none."""
    for k in range(matrix.shape[0]):
        for j in range(k + 1):
            total = matrix[k, j]
            for i in range(j):
                total -= matrix[k, i] * matrix[j, i]
            if j < k:
                matrix[k, j] = total / matrix[j, j]
            elif total > 0.0:
                matrix[k, k] = math.sqrt(total)
            else:
                return False
    return True


@compiled
def solve_lower(factor: Any, right: Any) -> None:
    for k in range(right.size):
        for i in range(k):
            right[k] -= factor[k, i] * right[i]
        right[k] /= factor[k, k]
    for k in range(right.size - 1, -1, -1):
        for i in range(k + 1, right.size):
            right[k] -= factor[i, k] * right[i]
        right[k] /= factor[k, k]
