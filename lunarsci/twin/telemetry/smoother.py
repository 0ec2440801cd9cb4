"""Where the rover was and how it slipped, from its wheels, its heading and localised positions.

The model is that of `filter`, with unknown constants and hypotheses about them. How fast deviations change decides how
far positions tell of the slip between them: each has an amplitude and a length (`SlipProcess`). What positions and
headings are probable for is known from the filter (its marginal likelihood); with what is believed beforehand it gives
weights to candidates. No one of them is chosen: the motion is averaged over them, so that what is not known of them
widens its errors. Errors of positions and headings follow Student's law, by weights that are found with the motion
(Lange, Little & Taylor 1989, 10.1080/01621459.1989.10478852). The smoother, linearised anew about its own result, is
Gauss-Newton for the whole drive (Bell 1994, 10.1137/0804035).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.telemetry.filter import (
    AHEAD,
    EFFECTS,
    MEANS,
    SCALE,
    SIZE,
    FilterRun,
    Model,
    Nodes,
    ProcessCandidates,
    ReferenceMotion,
    at_nodes,
    filtered,
    linearised,
    smoothed_back,
)
from lunarsci.twin.telemetry.hypotheses import (
    DECISIVE,
    EFFECT_MEAN,
    FREEDOM,
    LN_ODDS,
    MEAN_SIGMA,
    Posterior,
    Priors,
    averaged,
    probable_sets,
)

LENGTHS_M = (0.35, 0.7, 1.4, 2.8)
"""Candidates for the way over which deviations change: from half the length of a rover, which averages the ground below
it, to much more where the ground is smooth. Twice as many, or twice as many of `AMPLITUDES`, move slips by 0.06 of
their errors at most, as measured by `tests/benchmarks/telemetry_constants.py`. [m]"""
AMPLITUDES = (0.0007, 0.0017, 0.004, 0.01, 0.025, 0.06, 0.15, 0.4)
"""Candidates for the changing parts of ahead and left, as measured; times `SHARES`, the last in 1/m."""
SHARES = np.array([1.0, 1.0, 0.3])
"""How much less turns change than slip and side slip, by which amplitudes are multiplied. Half or twice as much moves
slips by 0.14 of their errors at most, as measured."""
LEAST, UNEXPLAINED, STEP_M = 0.0005, 0.15, 0.5
"""What is believed of the amplitude beforehand: so much, and such a share of what slopes are thought to change over so
long a way. As measured: linear effects of slopes leave 0.02 to 0.15 of it in drives by the twin and by MuJoCo with
stress integrals, and 0.2 to 0.5, or more sideways, where the soil changes too."""
WIDTH = 1.7
"""How widely it is believed, in ln. Half or twice as much moves slips by 0.3 of their errors at most, as measured."""
WALKS, WALK_ODDS = (0.0, 0.02, 0.045, 0.08), (0.16, 0.28, 0.28, 0.28)
"""Candidates for how the error that positions share grows, and how probable each is beforehand: visual odometry walks
by some centimetres a root metre; assumed. [m / sqrt(m)]"""
COARSE = np.array([MEAN_SIGMA[1], MEAN_SIGMA[1], MEAN_SIGMA[2]])
"""How slip changes while nothing is known of it: as widely as it is unknown."""
ORDER = (2, 1, 0)
"""Of the velocities, the best known first: headings tell how the turn changes."""
DRAWN = 12
STRIDES = (1, 5, 7, 11)
"""By which the draws of the three deviations and the walk are mixed: without a common divisor with `DRAWN`."""
FAR = 2.0 * (DECISIVE - LN_ODDS["failure"])
"""Mahalanobis distance squared from which on a position or a heading is decisively more probably wrong altogether, with
odds as `LN_ODDS`, and is looked at alone."""
MEDIAN_OF_TWO = 2.0 * math.log(2.0)
"""Median of chi-square with two degrees of freedom."""
ROUNDS = 4
"""Of weights, constants and the motion about which the model is linear, until they agree."""
HELD_BYTES = 1 << 28
"""Of covariances that are held at a time; assumptions are taken in turn where it would be more."""


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
    def middle(self) -> ProcessCandidates:
        """The usual ones alone."""
        walk = np.array([self.usual_walk])
        return ProcessCandidates(amplitude=self.usual[None], length_m=self.usual_length_m[None], walk=walk)

    @property
    def all(self) -> ProcessCandidates:
        """All candidates."""
        return ProcessCandidates(amplitude=self.amplitude, length_m=self.length_m, walk=self.walk)


def prior_process(nodes: Nodes) -> SlipProcess:
    """What is believed before positions and headings say anything."""
    return SlipProcess.fixed(_prior_amplitude(nodes), np.full(3, LENGTHS_M[1]))


def change_of(nodes: Nodes, priors: Priors | None = None, reference: ReferenceMotion | None = None) -> SlipProcess:
    """How deviations change, from positions and headings: each in turn, the others as they are found to be.

    Parameters
    ----------
    priors : of the constants; None takes the plain ones.
    reference : a motion that is about right; None takes dead reckoning.
    """
    priors = priors or Priors.plain(nodes)
    believed = _prior_amplitude(nodes)
    amplitude, length, walk = COARSE.copy(), np.full(3, LENGTHS_M[1]), 0.0
    reference = reference or ReferenceMotion.first(nodes)
    sets = [np.zeros(len(priors.hypotheses), dtype=bool)]
    if priors.hypotheses:
        usual = ProcessCandidates(amplitude=amplitude[None], length_m=length[None], walk=np.zeros(1))
        sets = probable_sets(priors, filtered(Model.about(nodes, reference, usual), every_node=False).squares[0])

    def likelihood(tried_a: FloatArray, tried_l: FloatArray, tried_w: FloatArray) -> FloatArray:
        assumed = ProcessCandidates(amplitude=tried_a, length_m=tried_l, walk=tried_w)
        run = filtered(Model.about(nodes, reference, assumed), every_node=False)
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
    spread = np.sqrt([weight @ (ln_a - weight @ ln_a) ** 2 for weight in weights])
    beside = np.maximum(weights, 1e-300) / [_normed(row) for row in prior]
    drawn = [_draws(weight, stride) for weight, stride in zip((*weights, walked), STRIDES, strict=True)]
    picked = np.column_stack(drawn[:3])
    return SlipProcess(
        amplitude=np.exp(ln_a[picked]) * SHARES,
        length_m=np.exp(ln_l[picked]),
        walk=np.array(WALKS)[drawn[3]],
        usual=amplitude,
        usual_length_m=length,
        usual_walk=walk,
        spread=spread,
        information=(weights * np.log(beside)).sum(axis=1),
    )


def _prior_amplitude(nodes: Nodes) -> FloatArray:
    """Amplitudes believed beforehand: ahead, left, and turn, for which slopes do little. (3,)"""
    effect = nodes.effects[:, :2] @ np.array(EFFECT_MEAN)
    way = np.append(0.0, np.cumsum(nodes.way_m))
    later = np.column_stack([np.interp(way + STEP_M, way, column) for column in effect.T])
    ahead, left = LEAST + UNEXPLAINED * np.sqrt(((later - effect) ** 2).mean(axis=0))
    return np.asarray(np.array([ahead, left, ahead]) * SHARES)


def _normed(ln_weight: FloatArray) -> FloatArray:
    weight = np.exp(ln_weight - ln_weight.max())
    return np.asarray(weight / weight.sum())


def _draws(weight: FloatArray, stride: int) -> IndexArray:
    """Candidates as often as they are probable, in an order of their own. (m,)"""
    levels = (np.arange(DRAWN) + 0.5) / DRAWN
    picked = np.minimum(np.searchsorted(np.cumsum(weight), levels), len(weight) - 1)
    return np.asarray(picked[(stride * np.arange(DRAWN)) % DRAWN])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """The motion at the nodes.

    Attributes
    ----------
    state, covariance : mean and covariance of the state and, behind it, of the constants. (n, 11 + k), ...
    effect, direction, turn_gain : those of `Nodes`, the last two at the nodes. (n, 3, 5), (n,), (n,)
    change : how fast the deviations ahead, left and turn change.
    fix_weight, yaw_weight : how much each position and heading counts, 1 for one that is as good as it says. (n,)
    reduced_chi_square : of the positions.
    posterior : of the constants.
    """

    state: FloatArray
    covariance: FloatArray
    effect: FloatArray
    direction: FloatArray
    turn_gain: FloatArray
    change: SlipProcess
    fix_weight: FloatArray
    yaw_weight: FloatArray
    reduced_chi_square: float
    posterior: Posterior

    @property
    def reference(self) -> ReferenceMotion:
        """What the same model may be linearised about."""
        state, constants = self.state[:, :SIZE], self.posterior.mean
        return ReferenceMotion(state=state, constants=constants, fix_weight=self.fix_weight, yaw_weight=self.yaw_weight)

    @property
    def picks(self) -> FloatArray:
        """Rows that make the deviations out of the state, and ln of the rims' scale. (n, 4, 11 + k)"""
        picks = np.zeros((len(self.state), 4, self.state.shape[1]))
        for row, (k, mean) in enumerate(zip(AHEAD, MEANS, strict=True)):
            picks[:, row, k] = picks[:, row, mean] = 1.0
        picks[:, 0, MEANS[0]] = self.direction
        picks[:, 2, AHEAD[2]] = self.turn_gain
        picks[:, :3, EFFECTS] = self.effect
        picks[:, 3, SIZE + SCALE] = 1.0
        return picks

    @property
    def deviation(self) -> FloatArray:
        """Deviation of ahead, left and turn, as shares of the rims' mean speed. (n, 3) [-, -, 1/m]"""
        return np.asarray(np.einsum("nij,nj->ni", self.picks, self.state)[:, :3])

    @property
    def deviation_covariance(self) -> FloatArray:
        """Covariance of `deviation` and of ln of the rims' scale. (n, 4, 4)"""
        picks = self.picks
        return np.asarray(picks @ self.covariance @ np.swapaxes(picks, 1, 2))


def smooth(
    nodes: Nodes,
    change: SlipProcess | None = None,
    priors: Priors | None = None,
    start: ReferenceMotion | None = None,
) -> Smoothed:
    """The motion that explains positions and headings best, with its uncertainty.

    Parameters
    ----------
    nodes : with two positions or more.
    change : how fast deviations change; None finds it from the nodes.
    priors : of the constants; None takes the plain ones, and errors that are normal.
    start : what the model is first linearised about; None takes dead reckoning.

    Raises DataError for fewer than two positions, or where the numbers do not hold.
    """
    if nodes.fixed.sum() < 2:
        raise DataError("fewer than two usable positions; slip needs two or more")
    robust, priors = priors is not None, priors or Priors.plain(nodes)
    try:
        reference = start or ReferenceMotion.first(nodes)
        if robust and (reference.fix_weight == 1.0).all():
            reference = _downweighted(nodes, reference, priors)
        for number in range(ROUNDS):
            tried = change or SlipProcess.coarse()
            reference = _round(nodes, reference, tried, priors, robust=robust)
            if change is None and number == ROUNDS - 3:
                change = change_of(nodes, priors, reference)
        change = change or SlipProcess.coarse()
        state, covariance, posterior = _averaged(nodes, reference, change, priors)
    except np.linalg.LinAlgError as error:
        raise DataError(
            "the motion cannot be found; check the errors of positions and headings, and their units"
        ) from error
    off, spread = _residuals(
        nodes, reference, state, lambda rows: np.asarray(rows @ covariance @ np.swapaxes(rows, 1, 2))
    )
    return Smoothed(
        state=state,
        covariance=covariance,
        effect=nodes.effects,
        direction=at_nodes(nodes.direction),
        turn_gain=at_nodes(nodes.turn_gain),
        change=change,
        fix_weight=reference.fix_weight,
        yaw_weight=reference.yaw_weight,
        reduced_chi_square=_reduced_chi_square(nodes, reference.fix_weight, off, spread),
        posterior=posterior,
    )


def _residuals(
    nodes: Nodes, reference: ReferenceMotion, mean: FloatArray, covariance_of: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """What positions and headings are off (n, 3), and how well it is known where they should be (n, 3, 3).

    `mean` is that of state and constants together, `covariance_of` the covariance of what rows make of them.
    """
    linear = linearised(nodes, reference)
    seen = np.concatenate([linear.seen, linear.by], axis=2)
    return linear.value - np.einsum("nij,nj->ni", seen, mean), covariance_of(seen)


def probable(nodes: Nodes, change: SlipProcess, priors: Priors, reference: ReferenceMotion) -> tuple[FloatArray, float]:
    """Constants (k,), and ln of how probable positions and headings are, up to a constant."""
    run = filtered(Model.about(nodes, reference, change.middle), every_node=False)
    (posterior,) = averaged(priors, run, probable_sets(priors, run.squares[0]))
    return posterior.mean, posterior.ln_likelihood


def _round(
    nodes: Nodes, reference: ReferenceMotion, change: SlipProcess, priors: Priors, *, robust: bool = False
) -> ReferenceMotion:
    """The motion about a reference, as the next one, with weights by Student's law where it is `robust`."""
    joint, constants = _about(nodes, reference, change, priors)
    fix_weight, yaw_weight = reference.fix_weight, reference.yaw_weight
    if robust:
        fix_weight, yaw_weight = _weights(nodes, *_residuals(nodes, reference, joint.mean, joint.seen))
    return ReferenceMotion(
        state=joint.mean[:, :SIZE], constants=constants, fix_weight=fix_weight, yaw_weight=yaw_weight
    )


def _about(
    nodes: Nodes, reference: ReferenceMotion, change: SlipProcess, priors: Priors
) -> tuple["_Joint", FloatArray]:
    """State and constants, and the constants alone (k,), for the usual change."""
    model = Model.about(nodes, reference, change.middle)
    run = smoothed_back(model, filtered(model))
    (posterior,) = averaged(priors, run, probable_sets(priors, run.squares[0]))
    return _Joint.of(run, 0, posterior), posterior.mean


def _downweighted(nodes: Nodes, reference: ReferenceMotion, priors: Priors) -> ReferenceMotion:
    """Weights to begin with: positions that are farthest from where all others put them hardly count, then the next.

    Student's law has several modes. Where a wrong position counts as much as any at first, its neighbours may end as
    the odd ones.
    """
    fix_weight, yaw_weight = reference.fix_weight.copy(), reference.yaw_weight.copy()
    for _ in range(len(nodes.time_s)):
        reference = replace(reference, fix_weight=fix_weight, yaw_weight=yaw_weight)
        joint, constants = _about(nodes, reference, SlipProcess.coarse(), priors)
        off, spread = _residuals(nodes, reference, joint.mean, joint.seen)
        fixes, headings = _distances(nodes, reference, off, spread)
        far, odd = _farthest(fixes, fix_weight), _farthest(headings, yaw_weight)
        reference = replace(reference, state=joint.mean[:, :SIZE], constants=constants)
        if not (far.any() or odd.any()):
            return reference
        fix_weight = np.where(far, (FREEDOM + 2.0) / (FREEDOM + fixes), fix_weight)
        yaw_weight = np.where(odd, (FREEDOM + 1.0) / (FREEDOM + headings), yaw_weight)
    return reference


def _farthest(squared: FloatArray, weight: FloatArray) -> BoolArray:
    """Of each run of far measurements the farthest, as it may have drawn its neighbours along. (n,)

    `squared` is NaN where there is none; those that count less already are no more than their neighbours.
    """
    given = np.flatnonzero(np.isfinite(squared))
    values = np.where(weight[given] < 1.0, 0.0, squared[given])
    far, result = values >= FAR, np.zeros(len(squared), dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(np.int8), [0]])))
    for begin, end in edges.reshape(-1, 2):
        result[given[begin + int(np.argmax(values[begin:end]))]] = True
    return result


class _Joint(NamedTuple):
    """State and constants together, for one of the assumptions.

    Attributes
    ----------
    mean : of both. (n, 11 + k)
    alone : covariance of the state if the constants were known. (n, 11, 11)
    by : what the constants add to the state. (n, 11, k)
    constants : covariance of the constants. (k, k)
    """

    mean: FloatArray
    alone: FloatArray
    by: FloatArray
    constants: FloatArray

    @classmethod
    def of(cls, run: FilterRun, number: int, posterior: Posterior) -> "_Joint":
        """Of a run under assumption `number`."""
        columns = run.columns[:, number]
        by, constants = np.ascontiguousarray(columns[..., 1:]), np.tile(posterior.mean, (len(columns), 1))
        mean = np.concatenate([columns[..., 0] + by @ posterior.mean, constants], axis=1)
        return cls(mean, run.covariance[:, number], by, posterior.covariance)

    def seen(self, rows: FloatArray) -> FloatArray:
        """Covariance of what rows (n, r, 11 + k) make of state and constants. (n, r, r)"""
        state = rows[..., :SIZE]
        onto = state @ self.by + rows[..., SIZE:]
        return np.asarray(
            state @ self.alone @ np.swapaxes(state, 1, 2) + onto @ self.constants @ np.swapaxes(onto, 1, 2)
        )

    def add_to(self, covariance: FloatArray) -> None:
        """Add the whole covariance to another. (n, 11 + k, 11 + k)"""
        shared = (self.by.reshape(-1, len(self.constants)) @ self.constants).reshape(self.by.shape)
        covariance[:, :SIZE, :SIZE] += self.alone + shared @ np.swapaxes(self.by, 1, 2)
        covariance[:, :SIZE, SIZE:] += shared
        covariance[:, SIZE:, :SIZE] += np.swapaxes(shared, 1, 2)
        covariance[:, SIZE:, SIZE:] += self.constants


def _weights(nodes: Nodes, off: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How much positions and headings count, by what they are off (n, 3), known to a covariance (n, 3, 3).

    A chain of errors makes a position off by what it adds to the error before.
    """
    fix, yaw, fixed = np.ones(len(off)), np.ones(len(off)), nodes.fixed
    total = off[fixed, :2, None] * off[fixed, None, :2] + spread[fixed, :2, :2]
    squared = np.trace(np.linalg.solve(nodes.fix_covariance_m2[fixed], total), axis1=1, axis2=2)
    # Errors are as large as positions scatter by, and no smaller than they say.
    scale = max(1.0, float(np.median(squared)) / MEDIAN_OF_TWO)
    fix[fixed] = np.minimum(1.0, (FREEDOM + 2.0) / (FREEDOM + squared / scale)) / scale
    squared_yaw = (off[:, 2] ** 2 + spread[:, 2, 2]) / nodes.yaw_sigma_rad**2
    given = np.isfinite(squared_yaw)
    yaw[given] = np.minimum(1.0, (FREEDOM + 1.0) / (FREEDOM + squared_yaw[given]))
    return fix, yaw


def _averaged(
    nodes: Nodes, reference: ReferenceMotion, change: SlipProcess, priors: Priors
) -> tuple[FloatArray, FloatArray, Posterior]:
    """State and constants with their covariance, averaged over assumptions, linearised about a reference."""
    whole, every = SIZE + nodes.constants, change.all
    count, many = len(reference.state), len(every.walk)
    each = max(1, HELD_BYTES // (8 * SIZE * (SIZE + whole) * count))
    sets = probable_sets(priors, filtered(Model.about(nodes, reference, change.middle), every_node=False).squares[0])
    means, covariance, posteriors = np.zeros((many, count, whole)), np.zeros((count, whole, whole)), list[Posterior]()
    for first in range(0, many, each):
        some = slice(first, first + each)
        assumed = ProcessCandidates(
            amplitude=every.amplitude[some], length_m=every.length_m[some], walk=every.walk[some]
        )
        model = Model.about(nodes, reference, assumed)
        run = smoothed_back(model, filtered(model))
        for k, posterior in enumerate(averaged(priors, run, sets)):
            joint = _Joint.of(run, k, posterior)
            means[first + k] = joint.mean
            joint.add_to(covariance)
            posteriors.append(posterior)
    mean = means.mean(axis=0)
    apart = means - mean
    covariance = (covariance + np.einsum("mni,mnj->nij", apart, apart)) / many
    middle = np.mean([one.ln_likelihood for one in posteriors])
    held = np.mean([one.probable for one in posteriors], axis=0)
    weights = np.concatenate([reference.fix_weight, reference.yaw_weight])
    # Student's law is a normal one of an unknown scale, which has a prior of its own.
    ln_likelihood = float(middle + 0.5 * FREEDOM * (np.log(weights) - weights + 1.0).sum())
    return mean, covariance, Posterior(mean[-1, SIZE:], covariance[-1, SIZE:, SIZE:], ln_likelihood, held)


def _squared_distances(errors: FloatArray, weight: FloatArray, off: FloatArray, spread: FloatArray) -> FloatArray:
    """Mahalanobis distance squared of measurements from what all others say of them. (n,)

    Parameters
    ----------
    errors : covariances as stated, which `weight` divides. (n, d, d), (n,)
    off, spread : residuals, and how well it is known where measurements should be. (n, d), (n, d, d)
    """
    counted = errors / weight[:, None, None]
    value, axes = np.linalg.eigh(counted - spread)
    # Without the measurement itself it is off by more, from a motion that is less well known: by counted (counted -
    # spread)^-1 spread.
    gain = (
        counted
        @ (axes / np.maximum(value, 1e-6 * np.trace(errors, axis1=1, axis2=2)[:, None])[:, None])
        @ np.swapaxes(axes, 1, 2)
    )
    alone = gain @ off[..., None]
    return np.asarray((alone * np.linalg.solve(errors + gain @ spread, alone)).sum(axis=(1, 2)))


def _distances(
    nodes: Nodes, reference: ReferenceMotion, off: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Those of positions and of headings, NaN where there is none. (n,), (n,)"""
    fixes, headings = np.full((2, len(off)), np.nan)
    fixed, given = nodes.fixed, np.isfinite(nodes.yaw_rad)
    fixes[fixed] = _squared_distances(
        nodes.fix_covariance_m2[fixed], reference.fix_weight[fixed], off[fixed, :2], spread[fixed, :2, :2]
    )
    headings[given] = _squared_distances(
        nodes.yaw_sigma_rad[given, None, None] ** 2, reference.yaw_weight[given], off[given, 2:], spread[given, 2:, 2:]
    )
    return fixes, headings


def _reduced_chi_square(nodes: Nodes, weight: FloatArray, off: FloatArray, spread: FloatArray) -> float:
    """Of the positions."""
    fixed = nodes.fixed
    counted = nodes.fix_covariance_m2[fixed] / weight[fixed, None, None]
    chi_square = (off[fixed, :2] * np.linalg.solve(counted, off[fixed, :2, None])[..., 0]).sum()
    freedom = 2.0 * fixed.sum() - np.trace(np.linalg.solve(counted, spread[fixed, :2, :2]), axis1=1, axis2=2).sum()
    return float(chi_square / max(round(float(freedom)), 1))
