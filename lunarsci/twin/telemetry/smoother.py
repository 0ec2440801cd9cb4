"""Where the rover was and how it slipped, from its wheels, its heading and localised positions.

The model is that of `filter`, how fast deviations change that of `change`. The smoother, linearised anew about its own
result until it stands still, is Gauss-Newton for the whole drive (Bell 1994, 10.1137/0804035).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.twin.telemetry.change import SlipProcess, change_of
from lunarsci.twin.telemetry.filter import (
    AHEAD,
    EFFECTS,
    MEANS,
    SIZE,
    Nodes,
    dead_reckoned,
    filtered,
    linearised,
    smoothed_back,
)

__all__ = ["MEANS", "Nodes", "SlipProcess", "Smoothed", "probable", "smooth"]

FloatArray = npt.NDArray[np.float64]
ROUNDS = 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """The motion at the nodes.

    Attributes
    ----------
    state, covariance : mean and covariance of the state. (n, 16), (n, 16, 16)
    effect : `Nodes.effects`. (n, 3, 4)
    change : how fast the deviations ahead, left and turn change.
    misfit : Mahalanobis distance squared of each position from where all else puts it, NaN where there is none. (n,)
    yaw_misfit : the same of each heading. (n,)
    reduced_chi_square : of the positions.
    """

    state: FloatArray
    covariance: FloatArray
    effect: FloatArray
    change: SlipProcess
    misfit: FloatArray
    yaw_misfit: FloatArray
    reduced_chi_square: float

    @property
    def picks(self) -> FloatArray:
        """Rows that make the deviations out of the state. (n, 3, 16)"""
        picks = np.zeros((len(self.state), 3, SIZE))
        for row, (k, mean) in enumerate(zip(AHEAD, MEANS, strict=True)):
            picks[:, row, k] = picks[:, row, mean] = 1.0
        picks[:, :, EFFECTS] = self.effect
        return picks

    @property
    def deviation(self) -> FloatArray:
        """Deviation of ahead, left and turn, as shares of the rims' mean speed. (n, 3) [-, -, 1/m]"""
        return np.asarray(np.einsum("nij,nj->ni", self.picks, self.state))

    @property
    def deviation_covariance(self) -> FloatArray:
        """Covariance of `deviation`. (n, 3, 3)"""
        picks = self.picks
        return np.asarray(picks @ self.covariance @ np.swapaxes(picks, 1, 2))


def smooth(nodes: Nodes, change: SlipProcess | None = None) -> Smoothed:
    """The motion that explains positions and headings best, with its uncertainty.

    Parameters
    ----------
    nodes : with two positions or more.
    change : how fast deviations change; None finds it from the nodes.

    Raises DataError for fewer than two positions, or where the numbers do not hold.
    """
    if np.isfinite(nodes.fix_m).all(axis=1).sum() < 2:
        raise DataError("fewer than two positions of use; slip needs two or more")
    try:
        change = change or change_of(nodes)
        reference = dead_reckoned(nodes)
        for _ in range(ROUNDS):
            reference, _ = _round(nodes, reference, change.usual[None], change.usual_length_m[None])
        state, covariance = _round(nodes, reference, change.amplitude, change.length_m)
    except np.linalg.LinAlgError as error:
        raise DataError("the motion cannot be found: errors of positions or headings are absurd") from error
    misfit, chi_square, count = _misfits(nodes, state, covariance)
    return Smoothed(
        state=state,
        covariance=covariance,
        effect=nodes.effects,
        change=change,
        misfit=misfit,
        yaw_misfit=_yaw_misfits(nodes, state, covariance),
        reduced_chi_square=chi_square / max(count, 1),
    )


def probable(nodes: Nodes, change: SlipProcess) -> tuple[FloatArray, float]:
    """State at the end (16,), and ln of how probable positions and headings are, up to a constant."""
    amplitude, length_m = change.usual[None], change.usual_length_m[None]
    reference, _ = _round(nodes, dead_reckoned(nodes), amplitude, length_m)
    means, _, ln_likelihood = filtered(nodes, linearised(nodes, reference, amplitude, length_m))
    return means[-1, 0], float(ln_likelihood[0])


def _round(
    nodes: Nodes, reference: FloatArray, amplitude: FloatArray, length_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States and their covariances, averaged over amplitudes and lengths (m, 3), linearised about a reference."""
    model = linearised(nodes, reference, amplitude, length_m)
    means, covariances = smoothed_back(model, *filtered(nodes, model)[:2])
    mean = means.mean(axis=1)
    apart = means - mean[:, None]
    return mean, covariances.mean(axis=1) + np.einsum("nmi,nmj->nij", apart, apart) / len(amplitude)


def _yaw_misfits(nodes: Nodes, state: FloatArray, covariance: FloatArray) -> FloatArray:
    """The same of headings. (n,)"""
    errors = nodes.yaw_sigma_rad**2
    left = np.maximum(errors - covariance[:, 2, 2], 1e-3 * errors)
    return np.asarray((nodes.yaw_rad - state[:, 2]) ** 2 / left)


def _misfits(nodes: Nodes, state: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float, int]:
    """Mahalanobis distance squared of each position from what all others say of it; chi-square, and its freedom."""
    fixed = np.isfinite(nodes.fix_m).all(axis=1)
    misfit = np.full(len(nodes.time_s), np.nan)
    chi_square, count = 0.0, 0.0
    for k in np.flatnonzero(fixed):
        off, errors = nodes.fix_m[k] - state[k, :2], nodes.fix_covariance_m2[k]
        left = errors - covariance[k, :2, :2]
        value, axes = np.linalg.eigh(left)
        misfit[k] = ((axes.T @ off) ** 2 / np.maximum(value, 1e-6 * np.trace(errors))).sum()
        chi_square += float(off @ np.linalg.solve(errors, off))
        count += float(np.trace(np.linalg.solve(errors, left)))
    return misfit, chi_square, max(round(count), 1)
