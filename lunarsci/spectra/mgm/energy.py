"""The energy of a particle, half the objective, and its slope, compiled: what the sampler's trajectories feel.

The energy counts on all channels; the force may come from neighbouring channels put together, see `force_of`.
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA, gaussian, residuals
from lunarsci.spectra.mgm.normal import prior_share

__all__ = ["RIDGE", "correct_coarse", "energies_of", "force_of", "lower_factor", "solve_lower"]

RIDGE = 1e-10
"""Added to the diagonal of a matrix, relatively, before it is factorised."""
LN_2, EXPONENT_BITS = math.log(2.0), 52
ROOT_HALF = int(np.array(math.sqrt(0.5)).view(np.int64))
"""The bits of the root of 1/2; numbers from there on count as of the next power of 2."""
LEAST_CONTINUUM = 1e-12


@compiled
def _chi2(channels: Any, logarithmic: bool, point: Any, room: Any) -> float:
    wavelength, columns, data, root_weight = channels
    jacobian, residual, work, powers = room
    chi2: float = residuals(
        point, wavelength, columns, logarithmic, data, root_weight, residual, jacobian, work, powers
    )
    return chi2


@compiled
def energies_of(target: Any, point: Any, room: Any, energy: Any) -> None:
    """Halves of chi-square, of the prior's share, and of the squared distance of the continuum from its start."""
    channels, _, logarithmic, prior, precision, start = target[:6]
    energy[0] = 0.5 * _chi2(channels, logarithmic, point, room[0])
    energy[1] = 0.5 * prior_share(point, prior, precision)
    energy[2] = 0.0
    for m in range(start.shape[1]):
        energy[2] += 0.5 * start[1, m] * (point[m] - start[0, m]) ** 2


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def force_of(target: Any, beta: float, point: Any, room: Any, force: Any) -> bool:
    """Minus the slope of the energy, from the coarse channels; False where the continuum is not above 0.

    Any field of force keeps a trajectory reversible and its volume; that it is the energy's own slope to within a
    fraction of a per cent only decides how many trajectories are accepted, by the energy on all channels.
    """
    (wavelength, columns, data, root_weight), logarithmic, prior, precision, start = target[1:6]
    shapes, rest, level, powers = room[1]
    degrees, channels = columns.shape
    for i in range(channels):
        level[i] = 0.0
    for m in range(degrees):
        coefficient, column = point[m], columns[m]
        for i in range(channels):
            level[i] += column[i] * coefficient
    if not _subtract_continuum(data, level, logarithmic, powers, rest):
        return False
    for row in range(degrees, point.size, 3):
        strength, shape = point[row + 2], shapes[row]
        gaussian(wavelength, point[row], FWHM_OVER_SIGMA / point[row + 1], shape, powers)
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
def _subtract_continuum(data: Any, level: Any, logarithmic: bool, powers: Any, rest: Any) -> bool:
    """Fill `rest` with data - ln C and turn `level` into what a change of C means for ln C.

    ln C = k ln 2 + 2 artanh((f - 1) / (f + 1)) with f in 0.7-1.4; the series to the eleventh power leaves 1e-11.
    """
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
    bits, fraction = level.view(np.int64), powers.view(np.float64)
    for i in range(level.size):
        exponent = (bits[i] - ROOT_HALF) >> EXPONENT_BITS
        rest[i] = exponent * LN_2
        powers[i] = bits[i] - (exponent << EXPONENT_BITS)
    for i in range(level.size):
        t = (fraction[i] - 1.0) / (fraction[i] + 1.0)
        u = t * t
        series = ((((u / 11.0 + 1.0 / 9.0) * u + 1.0 / 7.0) * u + 0.2) * u + 1.0 / 3.0) * u + 1.0
        rest[i] = data[i] - rest[i] - 2.0 * t * series
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
def correct_coarse(target: Any, groups: Any, best: Any, room: Any) -> None:
    """Set the coarse data so that residuals and slope at `best` are those of all channels.

    Means of the residuals alone leave out how noise and slopes go together within a coarse channel.
    """
    channels, coarse, logarithmic, _, precision = target[:5]
    _chi2(channels, logarithmic, best, room[0])
    coarse[2][:] = 0.0
    _chi2(coarse, logarithmic, best, room[1])
    jacobian, wanted, root_weight, model = room[1][0], np.zeros(room[1][1].size), coarse[3], room[1][1]
    for i in range(groups.size):
        wanted[groups[i]] += channels[3][i] * room[0][1][i] / root_weight[groups[i]]
    size = best.size
    matrix, missing = np.empty((size, size)), np.zeros(size)
    for p in range(size):
        missing[p] = (room[0][0][p] * room[0][1]).sum() - (jacobian[p] * wanted).sum()
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
