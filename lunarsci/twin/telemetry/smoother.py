"""Where the rover was and how it slipped, from its wheels, its heading and localised positions.

The rover moves as its wheels say, but for a deviation of each of its three velocities, a share of the mean rim speed:
a constant that is not known, plus a stationary process along the way, Matern 3/2 (Rasmussen & Williams 2006, ch. 4; as
a state-space model Hartikainen & Sarkka 2010, 10.1109/MLSP.2010.5589113). Positions and headings observe it. A Kalman
filter with the smoother of Rauch, Tung & Striebel (1965, 10.2514/3.3166), linearised anew about its own result until it
stands still, is Gauss-Newton for the whole drive (Bell 1994, 10.1137/0804035).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError

__all__ = ["AHEAD", "MEANS", "SIZE", "Nodes", "Smoothed", "smooth"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
SIZE = 12
"""State: x, y, heading; deviation and its derivative along the way of ahead, left and turn; their constant parts."""
AHEAD = (3, 5, 7)
MEANS = (9, 10, 11)
LENGTHS_M = (0.7, 1.4, 2.8)
"""Candidates for the way over which deviations change: about the length of a rover, which averages the ground below it,
and more where the ground is smooth. [m]"""
MEAN_SIGMA = (0.3, 0.1, 0.05)
"""Of the constant deviations, ahead and left as shares, turn in 1/m: wide; assumed."""
AMPLITUDES = (0.003, 0.008, 0.02, 0.05, 0.12, 0.3)
"""Candidates for the changing parts of ahead and left; times `SHARES`, the last in 1/m."""
SHARES = np.array([1.0, 1.0, 0.3])
USUAL, USUAL_WIDTH = 0.02, 1.0
"""What is believed of the amplitude beforehand, and how widely in ln: slip changes by some percent; assumed."""
SWEEPS = 2
START_M, START_RAD = 10.0, 1.0
LOOSE_M = 1.0
"""Lever by which an error of the way over a gap becomes one of the heading; assumed. [m]"""
POSITION_M_PER_STEP = 2e-4
"""What each step may be off by whatever the wheels do; assumed. [m]"""
ROUNDS = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nodes:
    """The moments at which the motion is found.

    Attributes
    ----------
    time_s : (n,) [s]
    twist : mean velocity between nodes if nothing slips: ahead, left [m/s], turn [rad/s]. (n - 1, 3)
    way_m : mean way of the rims between nodes. (n - 1,) [m]
    loose : additional standard error of the way between nodes, as over a gap. (n - 1,) [m]
    apart : steps over which deviations keep nothing, as at a halt. (n - 1,)
    fix_m, fix_covariance_m2 : positions, NaN where there is none. (n, 2), (n, 2, 2)
    yaw_rad, yaw_sigma_rad : headings, NaN where there is none. (n,)
    """

    time_s: FloatArray
    twist: FloatArray
    way_m: FloatArray
    loose: FloatArray
    apart: BoolArray
    fix_m: FloatArray
    fix_covariance_m2: FloatArray
    yaw_rad: FloatArray
    yaw_sigma_rad: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """The motion at the nodes.

    Attributes
    ----------
    state, covariance : mean and covariance of the state. (n, 12), (n, 12, 12)
    amplitude : of the changing deviations ahead, left [-] and turn [1/m]. (3,)
    length_m : over which each of them changes. (3,) [m]
    misfit : Mahalanobis distance squared of each position from where all else puts it, NaN where there is none. (n,)
    yaw_misfit : the same of each heading. (n,)
    reduced_chi_square : of the positions.
    """

    state: FloatArray
    covariance: FloatArray
    amplitude: FloatArray
    length_m: FloatArray
    misfit: FloatArray
    yaw_misfit: FloatArray
    reduced_chi_square: float

    @property
    def deviation(self) -> FloatArray:
        """Deviation of ahead, left and turn, as shares of the rims' mean speed. (n, 3) [-, -, 1/m]"""
        return self.state[:, AHEAD] + self.state[:, MEANS]


def smooth(nodes: Nodes, scales: tuple[FloatArray, FloatArray] | None = None) -> Smoothed:
    """The motion that explains positions and headings best, with its uncertainty.

    Parameters
    ----------
    nodes : with two positions or more.
    scales : amplitude of the changing deviations (3,), and the way over which each changes (3,) [m]; None takes means
        of `AMPLITUDES` and `LENGTHS_M`, weighed by how well each foretells the positions.

    Raises DataError for fewer than two positions, or where the numbers do not hold.
    """
    if np.isfinite(nodes.fix_m).all(axis=1).sum() < 2:
        raise DataError("fewer than two positions of use; slip needs two or more")
    try:
        chosen, length_m = scales or _likely(nodes)
        reference = _dead_reckoned(nodes)
        for _ in range(ROUNDS):
            state, covariance = _round(nodes, reference, chosen, length_m)
            reference = state
    except np.linalg.LinAlgError as error:
        raise DataError("the motion cannot be found: errors of positions or headings are absurd") from error
    misfit, chi_square, count = _misfits(nodes, state, covariance)
    return Smoothed(
        state=state,
        covariance=covariance,
        amplitude=chosen,
        length_m=length_m,
        misfit=misfit,
        yaw_misfit=_yaw_misfits(nodes, state, covariance),
        reduced_chi_square=chi_square / max(count, 1),
    )


def _round(
    nodes: Nodes, reference: FloatArray, amplitude: FloatArray, length_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States and their covariances from a filter and a smoother linearised about a reference."""
    model = _linearised(nodes, reference, length_m)
    means, covariances, _ = _filtered(nodes, model, amplitude[None])
    return _smoothed(
        model,
        means[:, 0],
        covariances[:, 0],
        [_noise(nodes, model, amplitude[None], k)[0] for k in range(len(model.matrix))],
    )


def _likely(nodes: Nodes) -> tuple[FloatArray, FloatArray]:
    """Amplitudes and lengths by their posterior means in ln, for one velocity after the other."""
    amplitude, length = USUAL * SHARES, np.full(3, LENGTHS_M[1])
    reference = _dead_reckoned(nodes)
    for _ in range(2):
        reference, _ = _round(nodes, reference, amplitude, length)
    believed = -0.5 * ((np.log(AMPLITUDES) - math.log(USUAL)) / USUAL_WIDTH) ** 2
    for channel in (0, 1, 2) * SWEEPS:
        tried = np.repeat(amplitude[None], len(AMPLITUDES), axis=0)
        tried[:, channel] = np.array(AMPLITUDES) * SHARES[channel]
        ln_weight = np.empty((len(LENGTHS_M), len(AMPLITUDES)))
        for row, value in enumerate(LENGTHS_M):
            length[channel] = value
            ln_weight[row] = believed + _filtered(nodes, _linearised(nodes, reference, length), tried)[2]
        weight = np.exp(ln_weight - ln_weight.max())
        weight /= weight.sum()
        amplitude[channel] = np.exp(weight.sum(axis=0) @ np.log(tried[:, channel]))
        length[channel] = np.exp(weight.sum(axis=1) @ np.log(LENGTHS_M))
    return amplitude, length


def _dead_reckoned(nodes: Nodes) -> FloatArray:
    """States along measured headings, or where there are none turned as the wheels say, through the first position."""
    count = len(nodes.time_s)
    steps = np.diff(nodes.time_s)
    turned = np.append(0.0, np.cumsum(nodes.twist[:, 2] * steps))
    known = np.isfinite(nodes.yaw_rad)
    off = np.interp(np.arange(count), np.flatnonzero(known), (nodes.yaw_rad - turned)[known]) if known.any() else 0.0
    yaw = turned + off
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    ahead, left = nodes.twist[:, 0] * steps, nodes.twist[:, 1] * steps
    state = np.zeros((count, SIZE))
    state[1:, 0] = np.cumsum(np.cos(middle) * ahead - np.sin(middle) * left)
    state[1:, 1] = np.cumsum(np.sin(middle) * ahead + np.cos(middle) * left)
    state[:, 2] = yaw
    first = int(np.argmax(np.isfinite(nodes.fix_m).all(axis=1)))
    state[:, :2] += nodes.fix_m[first] - state[first, :2]
    return state


@dataclass(frozen=True, slots=True)
class _Model:
    """Matrix (n - 1, 12, 12) and constant (n - 1, 12) of each step, and how fast deviations forget. (3,) [1/m]"""

    matrix: FloatArray
    constant: FloatArray
    rate: FloatArray


def _linearised(nodes: Nodes, reference: FloatArray, length_m: FloatArray) -> _Model:
    """The steps about a reference."""
    steps, way = np.diff(nodes.time_s), nodes.way_m
    matrix = np.zeros((len(steps), SIZE, SIZE))
    rates = math.sqrt(3.0) / length_m
    for k, rate in zip(AHEAD, rates, strict=True):
        decay = np.where(nodes.apart, 0.0, np.exp(-rate * way))
        matrix[:, k, k], matrix[:, k, k + 1] = decay * (1 + rate * way), decay * way
        matrix[:, k + 1, k], matrix[:, k + 1, k + 1] = -decay * rate**2 * way, decay * (1 - rate * way)
    for k in MEANS:
        matrix[:, k, k] = 1.0
    # Way ahead and left, and turn, in a step: what the wheels say and the deviation at its middle.
    moved = nodes.twist * steps[:, None]
    parts = np.zeros((len(steps), 3, SIZE))
    for row, (k, mean) in enumerate(zip(AHEAD, MEANS, strict=True)):
        parts[:, row, k], parts[:, row, k + 1], parts[:, row, mean] = way, 0.5 * way**2, way
    before = reference[:-1]
    full = moved + np.einsum("nij,nj->ni", parts, before)
    middle = before[:, 2] + 0.5 * full[:, 2]
    cos, sin = np.cos(middle), np.sin(middle)
    by_turn = np.stack([-sin * full[:, 0] - cos * full[:, 1], cos * full[:, 0] - sin * full[:, 1]], axis=-1)
    matrix[:, 0] = cos[:, None] * parts[:, 0] - sin[:, None] * parts[:, 1] + 0.5 * by_turn[:, :1] * parts[:, 2]
    matrix[:, 1] = sin[:, None] * parts[:, 0] + cos[:, None] * parts[:, 1] + 0.5 * by_turn[:, 1:] * parts[:, 2]
    matrix[:, 2] = parts[:, 2]
    matrix[:, 0, 0] = matrix[:, 1, 1] = matrix[:, 2, 2] = 1.0
    matrix[:, 0, 2], matrix[:, 1, 2] = by_turn[:, 0], by_turn[:, 1]
    after = np.zeros((len(steps), SIZE))
    after[:, 0] = before[:, 0] + cos * full[:, 0] - sin * full[:, 1]
    after[:, 1] = before[:, 1] + sin * full[:, 0] + cos * full[:, 1]
    after[:, 2] = before[:, 2] + full[:, 2]
    after[:, 3:] = np.einsum("nij,nj->ni", matrix, before)[:, 3:]
    return _Model(matrix, after - np.einsum("nij,nj->ni", matrix, before), rates)


def _noise(nodes: Nodes, model: _Model, amplitude: FloatArray, k: int) -> FloatArray:
    """Covariance that a step adds, for each of several amplitudes (m, 3). (m, 12, 12)"""
    result = np.zeros((len(amplitude), SIZE, SIZE))
    for channel, row in enumerate(AHEAD):
        still = np.diag([1.0, model.rate[channel] ** 2])
        block = model.matrix[k, row : row + 2, row : row + 2]
        result[:, row : row + 2, row : row + 2] = (
            amplitude[:, channel, None, None] ** 2 * (still - block @ still @ block.T)[None]
        )
    result[:, 0, 0] = result[:, 1, 1] = POSITION_M_PER_STEP**2 + nodes.loose[k] ** 2
    result[:, 2, 2] = (nodes.loose[k] / LOOSE_M) ** 2
    return result


def _start(nodes: Nodes, amplitude: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    reference = _dead_reckoned(nodes)[0]
    mean = np.zeros((len(amplitude), SIZE))
    mean[:, :3] = reference[:3]
    covariance = np.zeros((len(amplitude), SIZE, SIZE))
    covariance[:, 0, 0] = covariance[:, 1, 1] = START_M**2
    covariance[:, 2, 2] = START_RAD**2
    for channel, row in enumerate(AHEAD):
        covariance[:, row, row] = amplitude[:, channel] ** 2
        covariance[:, row + 1, row + 1] = (amplitude[:, channel] * rate[channel]) ** 2
    for row, sigma in zip(MEANS, MEAN_SIGMA, strict=True):
        covariance[:, row, row] = sigma**2
    return mean, covariance


def _filtered(nodes: Nodes, model: _Model, amplitude: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Filter for each of several amplitudes (m, 3): means (n, m, 12), covariances, and ln likelihood (m,)."""
    mean, covariance = _start(nodes, amplitude, model.rate)
    means, covariances = [], []
    ln_likelihood = np.zeros(len(amplitude))
    for k in range(len(nodes.time_s)):
        if k:
            step = model.matrix[k - 1]
            mean = mean @ step.T + model.constant[k - 1]
            covariance = step @ covariance @ step.T + _noise(nodes, model, amplitude, k - 1)
        seen, values, errors = _observed(nodes, k)
        if seen:
            off = values - mean[:, seen]
            within = covariance[:, seen][:, :, seen] + errors
            gain = np.linalg.solve(within, covariance[:, seen])
            ln_likelihood += -0.5 * np.einsum("mi,mi->m", off, np.linalg.solve(within, off[..., None])[..., 0])
            ln_likelihood += -0.5 * np.linalg.slogdet(within)[1]
            mean = mean + np.einsum("mij,mi->mj", gain, off)
            covariance = covariance - np.swapaxes(covariance[:, seen], 1, 2) @ gain
            covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        means.append(mean)
        covariances.append(covariance)
    return np.array(means), np.array(covariances), ln_likelihood


def _observed(nodes: Nodes, k: int) -> tuple[list[int], FloatArray, FloatArray]:
    """What is measured at a node: which parts of the state, their values and their covariance."""
    fixed, turned = bool(np.isfinite(nodes.fix_m[k]).all()), bool(np.isfinite(nodes.yaw_rad[k]))
    seen = [0, 1] * fixed + [2] * turned
    errors = np.zeros((len(seen), len(seen)))
    if fixed:
        errors[:2, :2] = nodes.fix_covariance_m2[k]
    if turned:
        errors[-1, -1] = nodes.yaw_sigma_rad[k] ** 2
    return seen, np.array([*nodes.fix_m[k][: 2 * fixed], *[nodes.yaw_rad[k]] * turned]), errors


def _smoothed(
    model: _Model, means: FloatArray, covariances: FloatArray, noises: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Means and covariances that know what came later too."""
    means, covariances = means.copy(), covariances.copy()
    for k in range(len(means) - 2, -1, -1):
        step = model.matrix[k]
        ahead = step @ covariances[k] @ step.T + noises[k]
        gain = np.linalg.solve(ahead + 1e-18 * np.eye(SIZE), step @ covariances[k]).T
        means[k] = means[k] + gain @ (means[k + 1] - step @ means[k] - model.constant[k])
        covariances[k] = covariances[k] + gain @ (covariances[k + 1] - ahead) @ gain.T
        covariances[k] = 0.5 * (covariances[k] + covariances[k].T)
    return means, covariances


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
