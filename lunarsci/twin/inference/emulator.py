"""A quadratic stand-in for the residuals of simulated drives, near enough to draw soils from.

Residuals bend gently with straight coordinates, so that second-order polynomials of each one follow them over a
posterior; the cost, a sum of their squares, then has the bent valleys of the true one.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Emulator", "fit_emulator"]

FloatArray = npt.NDArray[np.float64]
SPARE = 1.5
"""Effective number of drives for each coefficient of the fit, at least; assumed."""
RIDGE = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Emulator:
    """Cost of a drive as q^T A q, with q the monomials 1, v_i, v_i v_j of scaled coordinates v.

    Attributes
    ----------
    center, inverse : v = inverse (point - center). (p,), (p, p)
    form : A, symmetric and positive semi-definite. (m, m)
    """

    center: FloatArray
    inverse: FloatArray
    form: FloatArray

    def cost(self, points: FloatArray) -> FloatArray:
        """-2 ln likelihood up to a constant. (points,)"""
        q = monomials((points - self.center) @ self.inverse.T)
        return np.asarray(np.einsum("ij,ij->i", q @ self.form, q))


def monomials(scaled: FloatArray) -> FloatArray:
    """Of order 0, 1 and 2. (points, 1 + p + p (p + 1) / 2)"""
    row, column = np.triu_indices(scaled.shape[1])
    return np.hstack([np.ones((len(scaled), 1)), scaled, scaled[:, row] * scaled[:, column]])


def fit_emulator(
    points: FloatArray, rows: FloatArray, cost: FloatArray, center: FloatArray, root: FloatArray
) -> Emulator:
    """Fit residuals by weighted least squares.

    Parameters
    ----------
    points : where drives were simulated. (d, p)
    rows : their residuals, each weighted so that squares add up to the cost. (d, r)
    cost : -2 ln of posterior; drives count less the higher theirs is. (d,)
    center, root : of a normal law about as wide as the posterior. (p,), lower Cholesky factor (p, p)
    """
    inverse: FloatArray = np.asarray(np.linalg.inv(root), dtype=np.float64)
    q = monomials((points - center) @ inverse.T)
    weight = np.sqrt(_weights(cost, SPARE * q.shape[1]))[:, None]
    own = weight * q
    matrix = own.T @ own
    matrix[np.diag_indices(len(matrix))] *= 1.0 + RIDGE
    coefficients = np.linalg.solve(matrix, own.T @ (weight * rows))
    return Emulator(center, inverse, coefficients @ coefficients.T)


def _weights(cost: FloatArray, wanted: float) -> FloatArray:
    """exp(-cost / 2T), T as low as leaves the wanted effective number of drives, but 1 at least."""
    temperature = 1.0
    while True:
        weight = np.exp(-0.5 * (cost - cost.min()) / temperature)
        if weight.sum() ** 2 / (weight**2).sum() >= min(wanted, 0.9 * len(cost)) or temperature > 1e6:
            return np.asarray(weight)
        temperature *= 1.3
