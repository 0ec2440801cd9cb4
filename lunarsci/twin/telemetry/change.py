"""How fast slip changes: found from the data, for it decides how far positions tell of the slip between them.

The changing deviations of `filter` have an amplitude and a length each. What positions and headings are probable for is
known from the filter (its marginal likelihood); with what is believed beforehand it gives weights to candidates. No one
of them is chosen: the motion is averaged over them, so that what is not known of them widens its errors.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.telemetry.filter import EFFECT_MEAN, Nodes, dead_reckoned, filtered, linearised, smoothed_back

__all__ = ["SlipProcess", "believed_change", "change_of"]

FloatArray = npt.NDArray[np.float64]
LENGTHS_M = (0.35, 0.7, 1.4, 2.8)
"""Candidates for the way over which deviations change: from half the length of a rover, which averages the ground below
it, to much more where the ground is smooth. [m]"""
AMPLITUDES = (0.0007, 0.0017, 0.004, 0.01, 0.025, 0.06, 0.15)
"""Candidates for the changing parts of ahead and left; times `SHARES`, the last in 1/m."""
SHARES = np.array([1.0, 1.0, 0.3])
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
    reference = smoothed_back(model, *filtered(nodes, model)[:2])[0][:, 0]
    ln_a, ln_l = (part.ravel() for part in np.meshgrid(np.log(AMPLITUDES), np.log(LENGTHS_M), indexing="ij"))
    prior = -0.5 * ((ln_a + np.log(SHARES)[:, None] - np.log(believed)[:, None]) / WIDTH) ** 2
    weights = np.empty_like(prior)
    for channel in ORDER:
        tried_a, tried_l = np.repeat(amplitude[None], len(ln_a), axis=0), np.repeat(length[None], len(ln_a), axis=0)
        tried_a[:, channel], tried_l[:, channel] = np.exp(ln_a) * SHARES[channel], np.exp(ln_l)
        likelihood = filtered(nodes, linearised(nodes, reference, tried_a, tried_l))[2]
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


def _draws(weights: FloatArray) -> npt.NDArray[np.intp]:
    """Candidates of each deviation, as often as they are probable, mixed with those of the others. (m, 3)"""
    levels = (np.arange(DRAWN) + 0.5) / DRAWN
    columns = []
    for weight, stride in zip(weights, STRIDES, strict=True):
        picked = np.minimum(np.searchsorted(np.cumsum(weight), levels), len(weight) - 1)
        columns.append(picked[(stride * np.arange(DRAWN)) % DRAWN])
    return np.column_stack(columns)
