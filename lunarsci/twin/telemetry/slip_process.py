"""How fast slip changes along the way, and how errors of positions grow: weighed by how probable the data make it."""

import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.twin.telemetry.filter import Model, ReferenceMotion, TriedProcesses, filtered
from lunarsci.twin.telemetry.motion_nodes import Nodes
from lunarsci.twin.telemetry.nuisances import EFFECT_MEAN, Priors, averaged, likely_sets

LENGTHS_M = (0.35, 0.7, 1.4, 2.8)
"""Candidates for the way over which deviations change: from half the length of a rover, which averages the ground below
it, to much more where the ground is smooth. Assumed. [m]"""
AMPLITUDES = (0.0007, 0.0017, 0.004, 0.01, 0.025, 0.06, 0.15, 0.4)
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
WALKS, WALK_ODDS = (0.0, 0.02, 0.045, 0.08), (0.16, 0.28, 0.28, 0.28)
"""Candidates for how the error that positions share grows, and how probable each is beforehand: visual odometry walks
by some centimetres a root metre; assumed. [m / sqrt(m)]"""
COARSE = np.array([0.1, 0.1, 0.05])
"""How slip changes while nothing is known of it: widely; assumed."""
ORDER = (2, 1, 0)
"""Of the velocities, the best known first: headings tell how the turn changes."""
DRAWN = 12
STRIDES = (1, 5, 7, 11)
"""By which the draws of the three deviations and the walk are mixed: without a common divisor with `DRAWN`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipProcess:
    """How the deviations ahead [-], left [-] and turn [1/m] change along the way, and how the error of positions grows.

    Attributes
    ----------
    amplitude, length_m : equally probable candidates. (m, 3), (m, 3) [m]
    walk : growth of the error that positions share. (m,) [m / sqrt(m)]
    usual, usual_length_m, usual_walk : their means, in ln but for the walk. (3,), (3,)
    spread : standard deviation of ln amplitude. (3,)
    information : what the data tell of amplitude and length beside what was believed, as the Kullback-Leibler
        divergence; 0 where they tell nothing. (3,) [nat]
    """

    amplitude: FloatArray
    length_m: FloatArray
    walk: FloatArray
    usual: FloatArray
    usual_length_m: FloatArray
    usual_walk: float
    spread: FloatArray
    information: FloatArray

    @classmethod
    def fixed(cls, amplitude: FloatArray, length_m: FloatArray) -> "SlipProcess":
        """Known amplitudes and lengths, and no walk. (3,), (3,) [m]"""
        zero = np.zeros(3)
        return cls(
            amplitude=amplitude[None],
            length_m=length_m[None],
            walk=np.zeros(1),
            usual=amplitude,
            usual_length_m=length_m,
            usual_walk=0.0,
            spread=zero,
            information=zero,
        )

    @classmethod
    def coarse(cls) -> "SlipProcess":
        """What is taken while nothing is known."""
        return cls.fixed(COARSE, np.full(3, LENGTHS_M[1]))

    @property
    def middle(self) -> TriedProcesses:
        """The usual ones alone."""
        walk = np.array([self.usual_walk])
        return TriedProcesses(amplitude=self.usual[None], length_m=self.usual_length_m[None], walk=walk)

    @property
    def all(self) -> TriedProcesses:
        """All candidates."""
        return TriedProcesses(amplitude=self.amplitude, length_m=self.length_m, walk=self.walk)


def believed_change(nodes: Nodes) -> SlipProcess:
    """What is believed before positions and headings say anything."""
    return SlipProcess.fixed(_believed(nodes), np.full(3, LENGTHS_M[1]))


def change_of(nodes: Nodes, priors: Priors | None = None, reference: ReferenceMotion | None = None) -> SlipProcess:
    """How deviations change, from positions and headings: each in turn, the others as they are found to be.

    Parameters
    ----------
    priors : of the constants; None takes the plain ones.
    reference : a motion that is about right; None takes dead reckoning.
    """
    priors = priors or Priors.plain(nodes)
    believed = _believed(nodes)
    amplitude, length, walk = COARSE.copy(), np.full(3, LENGTHS_M[1]), 0.0
    reference = reference or ReferenceMotion.first(nodes)
    sets = [np.zeros(len(priors.hypotheses), dtype=bool)]
    if priors.hypotheses:
        usual = TriedProcesses(amplitude=amplitude[None], length_m=length[None], walk=np.zeros(1))
        sets = likely_sets(priors, filtered(Model.about(nodes, reference, usual), kept=False).squares[0])

    def likelihood(tried_a: FloatArray, tried_l: FloatArray, tried_w: FloatArray) -> FloatArray:
        assumed = TriedProcesses(amplitude=tried_a, length_m=tried_l, walk=tried_w)
        run = filtered(Model.about(nodes, reference, assumed), kept=False)
        return np.array([one.ln_likelihood for one in averaged(priors, run, sets)])

    ln_a, ln_l = (part.ravel() for part in np.meshgrid(np.log(AMPLITUDES), np.log(LENGTHS_M), indexing="ij"))
    prior = -0.5 * ((ln_a + np.log(SHARES)[:, None] - np.log(believed)[:, None]) / WIDTH) ** 2
    weights, walked = np.empty_like(prior), np.eye(len(WALKS))[0]
    for channel in ORDER:
        if channel == ORDER[1] and nodes.chain is None and priors.hypotheses:
            # Slip that changes and positions that walk look alike: they are weighed together.
            step, level = (part.ravel() for part in np.meshgrid(np.arange(len(WALKS)), AMPLITUDES, indexing="ij"))
            tried_a = np.column_stack([level, level, np.full(len(level), amplitude[2])])
            tried_l = np.tile([LENGTHS_M[1], LENGTHS_M[1], length[2]], (len(level), 1))
            ln_weight = likelihood(tried_a, tried_l, np.array(WALKS)[step]) + np.log(WALK_ODDS)[step]
            ln_weight -= 0.5 * (np.log(level[:, None] / believed[:2]) ** 2).sum(axis=1) / WIDTH**2
            walked = np.bincount(step, _normed(ln_weight))
            walk = float(walked @ WALKS)
        tried_a, tried_l = np.repeat(amplitude[None], len(ln_a), axis=0), np.repeat(length[None], len(ln_a), axis=0)
        tried_a[:, channel], tried_l[:, channel] = np.exp(ln_a) * SHARES[channel], np.exp(ln_l)
        weights[channel] = _normed(prior[channel] + likelihood(tried_a, tried_l, np.full(len(ln_a), walk)))
        amplitude[channel] = math.exp(weights[channel] @ ln_a) * SHARES[channel]
        length[channel] = math.exp(weights[channel] @ ln_l)
    spread, believed_weights = np.array([_spread(weight, ln_a) for weight in weights]), [_normed(row) for row in prior]
    drawn = [_drawn(weight, stride) for weight, stride in zip((*weights, walked), STRIDES, strict=True)]
    picked = np.column_stack(drawn[:3])
    return SlipProcess(
        amplitude=np.exp(ln_a[picked]) * SHARES,
        length_m=np.exp(ln_l[picked]),
        walk=np.array(WALKS)[drawn[3]],
        usual=amplitude,
        usual_length_m=length,
        usual_walk=walk,
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


def _drawn(weight: FloatArray, stride: int) -> IndexArray:
    """Candidates as often as they are probable, in an order of their own. (m,)"""
    levels = (np.arange(DRAWN) + 0.5) / DRAWN
    picked = np.minimum(np.searchsorted(np.cumsum(weight), levels), len(weight) - 1)
    return np.asarray(picked[(stride * np.arange(DRAWN)) % DRAWN])
