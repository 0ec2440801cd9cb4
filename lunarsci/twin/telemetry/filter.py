"""The motion of a rover as a state that a Kalman filter and a smoother find, for several assumptions at once.

The rover moves as its wheels say, but for a deviation of each of its three velocities, a share of the mean rim speed:
a constant that is not known, what the slopes of the ground and the curvature of the way do times coefficients that are
not known, and a stationary process along the way, Matern 3/2 (Rasmussen & Williams 2006, ch. 4; as a state-space model
Hartikainen & Sarkka 2010, 10.1109/MLSP.2010.5589113). Positions and headings observe it. The smoother is that of Rauch,
Tung & Striebel (1965, 10.2514/3.3166).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray

SIZE = 18
"""State: x, y, heading; deviation and its derivative along the way of ahead, left and turn; their constant parts; the
coefficients of `Nodes.effect`; the error of positions where it is a chain."""
AHEAD = (3, 5, 7)
MEANS = (9, 10, 11)
EFFECTS = (12, 13, 14, 15)
OFF = slice(16, 18)
MEAN_SIGMA = (0.3, 0.1, 0.05)
"""Of the constant deviations, ahead and left as shares, turn in 1/m: wide; assumed."""
EFFECT_MEAN, EFFECT_SIGMA = (0.8, 2.0, 0.0, 0.0), (0.6, 2.0, 0.1, 0.02)
"""Of the coefficients: slip grows about as the slope is steep, side slip about twice so, and curvature changes little;
assumed, as wide as soils drawn from the default priors differ (0.4 to 2.2, 0.8 to 5, -0.1 to 0, and -0.01 to 0 in
drives by the twin)."""
START_M, START_RAD = 10.0, 1.0
"""Of a rover whose place is not known yet, in position and heading; assumed wide."""
LOOSE_M = 1.0
"""Lever by which an error of the way over a gap becomes one of the heading; assumed. [m]"""
POSITION_M_PER_STEP = 2e-4
"""What each step may be off by whatever the wheels do; assumed. [m]"""


class ErrorChain(NamedTuple):
    """Errors of positions: at each node `follows` times the error before, and noise. (n, 2, 2) [-], [m2]"""

    follows: FloatArray
    noise_m2: FloatArray


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
    effect : deviations ahead, left and turn for coefficients of 1; None where nothing is known. (n, 3, 4)
    chain : of the errors of positions; None where they are independent.
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
    effect: FloatArray | None = None
    chain: ErrorChain | None = None

    @property
    def effects(self) -> FloatArray:
        """`effect`, 0 where nothing is known. (n, 3, 4)"""
        return np.zeros((len(self.time_s), 3, len(EFFECTS))) if self.effect is None else self.effect


def dead_reckoned(nodes: Nodes) -> FloatArray:
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
class Model:
    """Matrix (n - 1, m, 18, 18), constant (n - 1, 18) and noise (n - 1, m, 18, 18) of each step, for m assumptions.

    `amplitude` and `rate` of the deviations, which forget within about 1 / rate. (m, 3) [-, -, 1/m], [1/m]
    """

    matrix: FloatArray
    constant: FloatArray
    noise: FloatArray
    amplitude: FloatArray
    rate: FloatArray


def linearised(nodes: Nodes, reference: FloatArray, amplitude: FloatArray, length_m: FloatArray) -> Model:
    """The steps about a reference, for several amplitudes and lengths of the changing deviations (m, 3)."""
    common, constant = _common(nodes, reference)
    rates, way = math.sqrt(3.0) / length_m, nodes.way_m[:, None]
    matrix = np.repeat(common[:, None], len(rates), axis=1)
    noise = np.zeros_like(matrix)
    for channel, k in enumerate(AHEAD):
        rate = rates[None, :, channel]
        decay = np.where(nodes.apart[:, None], 0.0, np.exp(-rate * way))
        block = np.empty((*decay.shape, 2, 2))
        block[..., 0, 0], block[..., 0, 1] = decay * (1 + rate * way), decay * way
        block[..., 1, 0], block[..., 1, 1] = -decay * rate**2 * way, decay * (1 - rate * way)
        still = np.zeros((len(rates), 2, 2))
        still[:, 0, 0], still[:, 1, 1] = 1.0, rates[:, channel] ** 2
        still *= amplitude[:, channel, None, None] ** 2
        matrix[..., k : k + 2, k : k + 2] = block
        noise[..., k : k + 2, k : k + 2] = still - block @ still @ np.swapaxes(block, -1, -2)
    noise[..., 0, 0] = noise[..., 1, 1] = (POSITION_M_PER_STEP**2 + nodes.loose**2)[:, None]
    noise[..., 2, 2] = ((nodes.loose / LOOSE_M) ** 2)[:, None]
    if nodes.chain is not None:
        matrix[..., OFF, OFF] = nodes.chain.follows[1:, None]
        noise[..., OFF, OFF] = nodes.chain.noise_m2[1:, None]
    return Model(matrix, constant, noise, amplitude, rates)


def _common(nodes: Nodes, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows of the pose, with the constant of each step, and what stays as it is; the deviations are left out."""
    way = nodes.way_m
    parts = _moving_parts(nodes)
    before = reference[:-1]
    full = nodes.twist * np.diff(nodes.time_s)[:, None] + np.einsum("nij,nj->ni", parts, before)
    middle = before[:, 2] + 0.5 * full[:, 2]
    cos, sin = np.cos(middle), np.sin(middle)
    by_turn = np.stack([-sin * full[:, 0] - cos * full[:, 1], cos * full[:, 0] - sin * full[:, 1]], axis=-1)
    matrix = np.zeros((len(way), SIZE, SIZE))
    matrix[:, 0] = cos[:, None] * parts[:, 0] - sin[:, None] * parts[:, 1] + 0.5 * by_turn[:, :1] * parts[:, 2]
    matrix[:, 1] = sin[:, None] * parts[:, 0] + cos[:, None] * parts[:, 1] + 0.5 * by_turn[:, 1:] * parts[:, 2]
    matrix[:, 2] = parts[:, 2]
    for k in (0, 1, 2, *MEANS, *EFFECTS):
        matrix[:, k, k] = 1.0
    matrix[:, 0, 2], matrix[:, 1, 2] = by_turn[:, 0], by_turn[:, 1]
    after = np.zeros((len(way), SIZE))
    after[:, 0] = before[:, 0] + cos * full[:, 0] - sin * full[:, 1]
    after[:, 1] = before[:, 1] + sin * full[:, 0] + cos * full[:, 1]
    after[:, 2] = before[:, 2] + full[:, 2]
    constant = np.zeros_like(after)
    constant[:, :3] = after[:, :3] - np.einsum("nij,nj->ni", matrix[:, :3], before)
    return matrix, constant


def _moving_parts(nodes: Nodes) -> FloatArray:
    """Way ahead and left, and turn, in a step, that the deviation at its middle adds. (n - 1, 3, 18)"""
    way, effects = nodes.way_m, nodes.effects
    parts = np.zeros((len(way), 3, SIZE))
    for row, (k, mean) in enumerate(zip(AHEAD, MEANS, strict=True)):
        parts[:, row, k], parts[:, row, k + 1], parts[:, row, mean] = way, 0.5 * way**2, way
    parts[:, :, EFFECTS] = way[:, None, None] * 0.5 * (effects[1:] + effects[:-1])
    return parts


def _start(nodes: Nodes, model: Model) -> tuple[FloatArray, FloatArray]:
    mean = np.zeros((len(model.rate), SIZE))
    mean[:, :3] = dead_reckoned(nodes)[0, :3]
    mean[:, EFFECTS] = EFFECT_MEAN
    covariance = np.zeros((len(model.rate), SIZE, SIZE))
    covariance[:, 0, 0] = covariance[:, 1, 1] = START_M**2
    covariance[:, 2, 2] = START_RAD**2
    for channel, row in enumerate(AHEAD):
        covariance[:, row, row] = model.amplitude[:, channel] ** 2
        covariance[:, row + 1, row + 1] = (model.amplitude[:, channel] * model.rate[:, channel]) ** 2
    for row, sigma in zip((*MEANS, *EFFECTS), (*MEAN_SIGMA, *EFFECT_SIGMA), strict=True):
        covariance[:, row, row] = sigma**2
    if nodes.chain is not None:
        covariance[:, OFF, OFF] = nodes.chain.noise_m2[0]
    return mean, covariance


def filtered(nodes: Nodes, model: Model) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Filter for each of several assumptions: means (n, m, 18), covariances, and ln likelihood (m,)."""
    mean, covariance = _start(nodes, model)
    means, covariances = [], []
    ln_likelihood = np.zeros(len(mean))
    for k in range(len(nodes.time_s)):
        if k:
            step = model.matrix[k - 1]
            mean = np.einsum("mij,mj->mi", step, mean) + model.constant[k - 1]
            covariance = step @ covariance @ np.swapaxes(step, 1, 2) + model.noise[k - 1]
        seen, values, errors = _observed(nodes, k)
        if len(seen):
            off = values - mean @ seen.T
            through = seen @ covariance
            within = through @ seen.T + errors
            gain = np.linalg.solve(within, through)
            ln_likelihood += -0.5 * np.einsum("mi,mi->m", off, np.linalg.solve(within, off[..., None])[..., 0])
            ln_likelihood += -0.5 * np.linalg.slogdet(within)[1]
            mean = mean + np.einsum("mij,mi->mj", gain, off)
            covariance = covariance - np.swapaxes(through, 1, 2) @ gain
            covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        means.append(mean)
        covariances.append(covariance)
    return np.array(means), np.array(covariances), ln_likelihood


def _observed(nodes: Nodes, k: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What is measured at a node: by the state (m, 18), values, and their covariance beside it."""
    fixed, turned = bool(np.isfinite(nodes.fix_m[k]).all()), bool(np.isfinite(nodes.yaw_rad[k]))
    seen = np.eye(SIZE)[[0, 1] * fixed + [2] * turned]
    errors = np.zeros((len(seen), len(seen)))
    if fixed and nodes.chain is None:
        errors[:2, :2] = nodes.fix_covariance_m2[k]
    elif fixed:
        seen[:2, OFF] = np.eye(2)
    if turned:
        errors[-1, -1] = nodes.yaw_sigma_rad[k] ** 2
    return seen, np.array([*nodes.fix_m[k][: 2 * fixed], *[nodes.yaw_rad[k]] * turned]), errors


def smoothed_back(model: Model, means: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means and covariances that know what came later too, from those of `filtered`."""
    means, covariances = means.copy(), covariances.copy()
    for k in range(len(means) - 2, -1, -1):
        step = model.matrix[k]
        ahead = step @ covariances[k] @ np.swapaxes(step, 1, 2) + model.noise[k]
        gain = np.swapaxes(np.linalg.solve(ahead + 1e-18 * np.eye(SIZE), step @ covariances[k]), 1, 2)
        off = means[k + 1] - np.einsum("mij,mj->mi", step, means[k]) - model.constant[k]
        means[k] = means[k] + np.einsum("mij,mj->mi", gain, off)
        covariances[k] = covariances[k] + gain @ (covariances[k + 1] - ahead) @ np.swapaxes(gain, 1, 2)
        covariances[k] = 0.5 * (covariances[k] + np.swapaxes(covariances[k], 1, 2))
    return means, covariances
