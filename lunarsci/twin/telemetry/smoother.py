"""Where the rover was and how it slipped, from its wheels, its heading and localised positions.

The model is that of `filter`. How fast its deviations change decides how far positions tell of the slip between them:
each has an amplitude and a length. What positions and headings are probable for is known from the filter (its
marginal likelihood); with what is believed beforehand it gives weights to candidates. No one of them is chosen: the
motion is averaged over them, so that what is not known of them widens its errors. The smoother, linearised anew about
its own result until it stands still, is Gauss-Newton for the whole drive (Bell 1994, 10.1137/0804035).
"""

import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.telemetry.filter import (
    AHEAD,
    EFFECT_MEAN,
    EFFECTS,
    MEANS,
    SIZE,
    Nodes,
    dead_reckoned,
    filtered,
    linearised,
    smoothed_back,
)
from lunarsci.twin.telemetry.reading import Findings

LENGTHS_M = (0.35, 0.7, 1.4, 2.8)
"""Candidates for the way over which deviations change: from half the length of a rover, which averages the ground below
it, to much more where the ground is smooth. Assumed. [m]"""
AMPLITUDES = (0.0007, 0.0017, 0.004, 0.01, 0.025, 0.06, 0.15)
"""Candidates for the changing parts of ahead and left; times `SHARES`, the last in 1/m. Assumed."""
SHARES = np.array([1.0, 1.0, 0.3])
"""How much less turns change than slip and side slip, by which amplitudes are multiplied; assumed."""
LEAST, UNEXPLAINED, STEP_M = 0.0005, 0.15, 0.5
"""What is believed of the amplitude beforehand: so much, and such a share of what slopes are thought to change over so
long a way. Assumed: linear effects of slopes leave 0.02 to 0.15 of it in drives by the twin and by MuJoCo with stress
integrals, and 0.2 to 0.5, or more sideways, where the soil changes too."""
UNKNOWN = 0.02
"""The same where the slopes are not known; assumed."""
WIDTH = 1.7
"""How widely it is believed, in ln; assumed."""
ORDER = (2, 1, 0)
"""Of the velocities, the best known first: headings tell how the turn changes."""
DRAWN = 12
STRIDES = (1, 5, 7)
"""By which the draws of the three deviations are mixed: without a common divisor with `DRAWN`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipProcess:
    """How the deviations ahead [-], left [-] and turn [1/m] change along the way.

    Attributes
    ----------
    amplitude, length_m : equally probable candidates. (m, 3), (m, 3) [m]
    usual, usual_length_m : their means in ln. (3,)
    spread : standard deviation of ln amplitude. (3,)
    information : what the data tell of amplitude and length beside what was believed, as the Kullback-Leibler
        divergence; 0 where they tell nothing. (3,) [nat]
    """

    amplitude: FloatArray
    length_m: FloatArray
    usual: FloatArray
    usual_length_m: FloatArray
    spread: FloatArray
    information: FloatArray

    @classmethod
    def fixed(cls, amplitude: FloatArray, length_m: FloatArray) -> "SlipProcess":
        """Known amplitudes and lengths. (3,), (3,) [m]"""
        zero = np.zeros(3)
        return cls(
            amplitude=amplitude[None],
            length_m=length_m[None],
            usual=amplitude,
            usual_length_m=length_m,
            spread=zero,
            information=zero,
        )


def believed_change(nodes: Nodes) -> SlipProcess:
    """What is believed before positions and headings say anything."""
    return SlipProcess.fixed(_believed(nodes), np.full(3, LENGTHS_M[1]))


def change_of(nodes: Nodes) -> SlipProcess:
    """How deviations change, from positions and headings: each in turn, the others as they are found to be."""
    believed = _believed(nodes)
    amplitude, length = believed.copy(), np.full(3, LENGTHS_M[1])
    model = linearised(nodes, dead_reckoned(nodes), amplitude[None], length[None])
    reference = smoothed_back(model, *filtered(model)[:2])[0][:, 0]
    ln_a, ln_l = (part.ravel() for part in np.meshgrid(np.log(AMPLITUDES), np.log(LENGTHS_M), indexing="ij"))
    prior = -0.5 * ((ln_a + np.log(SHARES)[:, None] - np.log(believed)[:, None]) / WIDTH) ** 2
    weights = np.empty_like(prior)
    for channel in ORDER:
        tried_a, tried_l = np.repeat(amplitude[None], len(ln_a), axis=0), np.repeat(length[None], len(ln_a), axis=0)
        tried_a[:, channel], tried_l[:, channel] = np.exp(ln_a) * SHARES[channel], np.exp(ln_l)
        likelihood = filtered(linearised(nodes, reference, tried_a, tried_l), kept=False)[2]
        weights[channel] = _normed(prior[channel] + likelihood)
        amplitude[channel] = math.exp(weights[channel] @ ln_a) * SHARES[channel]
        length[channel] = math.exp(weights[channel] @ ln_l)
    spread, believed_weights = np.array([_spread(weight, ln_a) for weight in weights]), [_normed(row) for row in prior]
    drawn = _draws(weights)
    return SlipProcess(
        amplitude=np.exp(ln_a[drawn]) * SHARES,
        length_m=np.exp(ln_l[drawn]),
        usual=amplitude,
        usual_length_m=length,
        spread=spread,
        information=np.array([_divergence(*pair) for pair in zip(weights, believed_weights, strict=True)]),
    )


def _believed(nodes: Nodes) -> FloatArray:
    """Amplitudes believed beforehand: ahead, left, and turn, for which slopes do little. (3,)"""
    if nodes.effect is None:
        return UNKNOWN * SHARES
    effect = nodes.effect[:, :2] @ np.array(EFFECT_MEAN)
    way = np.append(0.0, np.cumsum(nodes.way_m))
    later = np.column_stack([np.interp(way + STEP_M, way, column) for column in effect.T])
    ahead, left = LEAST + UNEXPLAINED * np.sqrt(((later - effect) ** 2).mean(axis=0))
    return np.asarray(np.array([ahead, left, ahead]) * SHARES)


def _normed(ln_weight: FloatArray) -> FloatArray:
    weight = np.exp(ln_weight - ln_weight.max())
    return np.asarray(weight / weight.sum())


def _spread(weight: FloatArray, values: FloatArray) -> float:
    return math.sqrt(weight @ (values - weight @ values) ** 2)


def _divergence(weight: FloatArray, believed: FloatArray) -> float:
    return float(weight @ np.log(np.maximum(weight, 1e-300) / believed))


def _draws(weights: FloatArray) -> IndexArray:
    """Candidates of each deviation, as often as they are probable, mixed with those of the others. (m, 3)"""
    levels = (np.arange(DRAWN) + 0.5) / DRAWN
    columns = []
    for weight, stride in zip(weights, STRIDES, strict=True):
        picked = np.minimum(np.searchsorted(np.cumsum(weight), levels), len(weight) - 1)
        columns.append(picked[(stride * np.arange(DRAWN)) % DRAWN])
    return np.column_stack(columns)


ROUNDS = 2
HELD_BYTES = 1 << 28
"""Of covariances that are held at a time; assumptions are taken in turn where it would be more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """The motion at the nodes.

    Attributes
    ----------
    state, covariance : mean and covariance of the state. (n, 18), (n, 18, 18)
    effect : `Nodes.effects`. (n, 3, 4)
    change : how fast the deviations ahead, left and turn change.
    squared_distance : Mahalanobis distance squared of each position from where all else puts it, else NaN. (n,)
    yaw_squared_distance : the same of each heading. (n,)
    reduced_chi_square : of the positions.
    """

    state: FloatArray
    covariance: FloatArray
    effect: FloatArray
    change: SlipProcess
    squared_distance: FloatArray
    yaw_squared_distance: FloatArray
    reduced_chi_square: float

    @property
    def picks(self) -> FloatArray:
        """Rows that make the deviations out of the state. (n, 3, 18)"""
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
    squared_distance, chi_square, count = _squared_distances(nodes, state, covariance)
    return Smoothed(
        state=state,
        covariance=covariance,
        effect=nodes.effects,
        change=change,
        squared_distance=squared_distance,
        yaw_squared_distance=_yaw_squared_distances(nodes, state, covariance),
        reduced_chi_square=chi_square / max(count, 1),
    )


def probable(nodes: Nodes, change: SlipProcess) -> tuple[FloatArray, float]:
    """State at the end (18,), and ln of how probable positions and headings are, up to a constant."""
    amplitude, length_m = change.usual[None], change.usual_length_m[None]
    reference, _ = _round(nodes, dead_reckoned(nodes), amplitude, length_m)
    means, _, ln_likelihood = filtered(linearised(nodes, reference, amplitude, length_m), kept=False)
    return means[-1, 0], float(ln_likelihood[0])


def _round(
    nodes: Nodes, reference: FloatArray, amplitude: FloatArray, length_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States and their covariances, averaged over amplitudes and lengths (m, 3), linearised about a reference."""
    each = max(1, HELD_BYTES // (8 * SIZE**2 * len(reference)))
    parts, covariance = [], np.zeros((len(reference), SIZE, SIZE))
    for first in range(0, len(amplitude), each):
        some = slice(first, first + each)
        model = linearised(nodes, reference, amplitude[some], length_m[some])
        means, covariances = smoothed_back(model, *filtered(model)[:2])
        parts.append(means)
        covariance += covariances.sum(axis=1)
    means = np.concatenate(parts, axis=1)
    mean = means.mean(axis=1)
    apart = means - mean[:, None]
    return mean, (covariance + np.einsum("nmi,nmj->nij", apart, apart)) / len(amplitude)


def _yaw_squared_distances(nodes: Nodes, state: FloatArray, covariance: FloatArray) -> FloatArray:
    """The same of headings. (n,)"""
    errors = nodes.yaw_sigma_rad**2
    left = np.maximum(errors - covariance[:, 2, 2], 1e-3 * errors)
    return np.asarray((nodes.yaw_rad - state[:, 2]) ** 2 / left)


def _squared_distances(nodes: Nodes, state: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float, int]:
    """Mahalanobis distance squared of each position from what all others say of it; chi-square, and its freedom."""
    fixed = np.isfinite(nodes.fix_m).all(axis=1)
    squared_distance = np.full(len(nodes.time_s), np.nan)
    chi_square, count = 0.0, 0.0
    for k in np.flatnonzero(fixed):
        off, errors = nodes.fix_m[k] - state[k, :2], nodes.fix_covariance_m2[k]
        left = errors - covariance[k, :2, :2]
        value, axes = np.linalg.eigh(left)
        squared_distance[k] = ((axes.T @ off) ** 2 / np.maximum(value, 1e-6 * np.trace(errors))).sum()
        chi_square += float(off @ np.linalg.solve(errors, off))
        count += float(np.trace(np.linalg.solve(errors, left)))
    return squared_distance, chi_square, max(round(count), 1)


WORST_CHI_SQUARE = 4.0
"""Reduced chi-square beyond which the result is in doubt; assumed."""
LEAST_CHI_SQUARE, FINEST_M = 0.05, 5e-4
"""Reduced chi-square and standard error [m] below which errors of positions are not believed; assumed."""
SPARSE = 0.02
"""Information about how slip changes below which positions are said to tell nothing of it; assumed. [nat]"""
GLIDE_DEG = 3.0
"""Side slip all along from which on it is said: the largest that Ding et al. (2024) report. [deg]"""


def check_scatter(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say errors of positions that nobody can believe, and a scatter that they do not explain.

    What all positions are off by does not make them scatter: of errors that they share a small scatter is none.
    """
    fixed = np.isfinite(nodes.fix_m).all(axis=1)
    sigma = float(np.median(np.sqrt(np.trace(nodes.fix_covariance_m2[fixed], axis1=1, axis2=2) / 2.0)))
    if sigma < FINEST_M:
        what = f"positions claim errors of {1e3 * sigma:.2g} mm, which no localisation of a rover reaches"
        findings.add("errors too small", what, "kept; are they in another unit?", doubt=True)
    scattered = smoothed.reduced_chi_square >= LEAST_CHI_SQUARE or nodes.chain is not None
    if not scattered and fixed.sum() > 5 and sigma >= FINEST_M:
        what = f"positions scatter {smoothed.reduced_chi_square:.2g} times as much as their errors of {sigma:.3g} m say"
        findings.add("errors too large", what, "kept; are they in another unit?")
    if smoothed.reduced_chi_square > WORST_CHI_SQUARE:
        what = f"positions scatter with a reduced chi-square of {smoothed.reduced_chi_square:.1f} about the motion"
        findings.add("positions scatter", what, "kept; their errors are too small, or they jump", doubt=True)


def check_glide(smoothed: Smoothed, findings: Findings) -> None:
    """Say a side slip that stays the same all along."""
    left, sigma = float(smoothed.state[-1, MEANS[1]]), float(np.sqrt(smoothed.covariance[-1, MEANS[1], MEANS[1]]))
    middle = math.degrees(math.atan(float(np.median(smoothed.deviation[:, 1]))))
    if abs(middle) > GLIDE_DEG and abs(left) > sigma:
        what = f"the rover glides by {middle:.2g} deg all the way, positive to the left"
        findings.add("constant side slip", what, "kept; a heading that is off throughout looks the same")


def check_change(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say positions that are too few or too coarse to tell how slip changes."""
    if smoothed.change.information[0] < SPARSE:
        count = int(np.isfinite(nodes.fix_m).all(axis=1).sum())
        what = (
            f"{count} positions over {float(nodes.way_m.sum()):.3g} m by the wheels do not tell how fast slip changes"
        )
        findings.add("sparse positions", what, "errors of slip rest on what is assumed of it", count=count)
