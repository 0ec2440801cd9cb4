"""Where the rover was and how it slipped, from its wheels, its heading and localised positions.

The model is that of `filter`, its constants and hypotheses are those of `nuisances`. How fast deviations change decides
how far positions tell of the slip between them: each has an amplitude and a length. What positions and headings are
probable for is known from the filter (its marginal likelihood); with what is believed beforehand it gives weights to
candidates. No one of them is chosen: the motion is averaged over them, so that what is not known of them widens its
errors. Errors of positions and headings follow Student's law, by weights that are found with the motion (Lange, Little
& Taylor 1989, 10.1080/01621459.1989.10478852). The smoother, linearised anew about its own result, is Gauss-Newton for
the whole drive (Bell 1994, 10.1137/0804035).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.twin.telemetry.filter import (
    FilterRun,
    Model,
    ReferenceMotion,
    TriedProcesses,
    filtered,
    linearised,
    smoothed_back,
)
from lunarsci.twin.telemetry.motion_nodes import AHEAD, EFFECTS, MEANS, SCALE, SIZE, Nodes, at_nodes
from lunarsci.twin.telemetry.nuisances import Posterior, Priors, averaged, likely_sets
from lunarsci.twin.telemetry.slip_process import SlipProcess, change_of

FAR = 20.0
"""Mahalanobis distance squared from which on a measurement is looked at alone; assumed: once in 22 000 by chance."""
MEDIAN_OF_TWO = 2.0 * math.log(2.0)
"""Median of chi-square with two degrees of freedom."""
FREEDOM = 4.0
"""Of Student's law of the errors of positions and headings (Gelman et al. 2013, ch. 17: few degrees, as 4)."""
ROUNDS = 4
"""Of weights, constants and the motion about which the model is linear, until they agree."""
HELD_BYTES = 1 << 28
"""Of covariances that are held at a time; assumptions are taken in turn where it would be more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """The motion at the nodes.

    Attributes
    ----------
    state, covariance : mean and covariance of the state and, behind it, of the constants. (n, 11 + k), ...
    effect, heads, bend : `Nodes.effects`, and `Nodes.heads` and `Nodes.bend` at the nodes. (n, 3, 5), (n,), (n,)
    change : how fast the deviations ahead, left and turn change.
    squared_distance : Mahalanobis distance squared of each position from where all else puts it, else NaN. (n,)
    yaw_squared_distance : the same of each heading. (n,)
    fix_weight, yaw_weight : how much each position and heading counts, 1 for one that is as good as it says. (n,)
    reduced_chi_square : of the positions.
    posterior : of the constants.
    """

    state: FloatArray
    covariance: FloatArray
    effect: FloatArray
    heads: FloatArray
    bend: FloatArray
    change: SlipProcess
    squared_distance: FloatArray
    yaw_squared_distance: FloatArray
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
        picks[:, 0, MEANS[0]] = self.heads
        picks[:, 2, AHEAD[2]] = self.bend
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
        raise DataError("fewer than two positions of use; slip needs two or more")
    robust, priors = priors is not None, priors or Priors.plain(nodes)
    try:
        reference = start or ReferenceMotion.first(nodes)
        if robust and (reference.fix_weight == 1.0).all():
            reference = _without_far_ones(nodes, reference, priors)
        for number in range(ROUNDS):
            tried = change or SlipProcess.coarse()
            reference = _round(nodes, reference, tried, priors, robust=robust)
            if change is None and number == ROUNDS - 3:
                change = change_of(nodes, priors, reference)
        change = change or SlipProcess.coarse()
        state, covariance, posterior = _averaged(nodes, reference, change, priors)
    except np.linalg.LinAlgError as error:
        raise DataError("the motion cannot be found: errors of positions or headings are absurd") from error
    off, spread = _residuals(nodes, reference, state, covariance)
    squared, chi_square, count = _squared_distances(nodes, off, spread, reference.fix_weight)
    return Smoothed(
        state=state,
        covariance=covariance,
        effect=nodes.effects,
        heads=at_nodes(nodes.heads),
        bend=at_nodes(nodes.bend),
        change=change,
        squared_distance=squared,
        yaw_squared_distance=_yaw_squared_distances(nodes, off, spread, reference.yaw_weight),
        fix_weight=reference.fix_weight,
        yaw_weight=reference.yaw_weight,
        reduced_chi_square=chi_square / max(count, 1),
        posterior=posterior,
    )


def _residuals(
    nodes: Nodes, reference: ReferenceMotion, state: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What positions and headings are off (n, 3), and how well it is known where they should be (n, 3, 3).

    `state` and `covariance` are those of state and constants together.
    """
    linear = linearised(nodes, reference)
    seen = np.concatenate([linear.seen, linear.by], axis=2)
    return linear.value - np.einsum("nij,nj->ni", seen, state), seen @ covariance @ np.swapaxes(seen, 1, 2)


def probable(nodes: Nodes, change: SlipProcess, priors: Priors, reference: ReferenceMotion) -> tuple[FloatArray, float]:
    """Constants (k,), and ln of how probable positions and headings are, up to a constant."""
    run = filtered(Model.about(nodes, reference, change.middle), kept=False)
    (found,) = averaged(priors, run, likely_sets(priors, run.squares[0]))
    return found.mean, found.ln_likelihood


def _round(
    nodes: Nodes, reference: ReferenceMotion, change: SlipProcess, priors: Priors, *, robust: bool = False
) -> ReferenceMotion:
    """The motion about a reference, as the next one, with weights by Student's law where it is `robust`."""
    state, covariance, constants = _about(nodes, reference, change, priors)
    fix_weight, yaw_weight = reference.fix_weight, reference.yaw_weight
    if robust:
        fix_weight, yaw_weight = _weights(nodes, *_residuals(nodes, reference, state, covariance))
    return ReferenceMotion(state=state[:, :SIZE], constants=constants, fix_weight=fix_weight, yaw_weight=yaw_weight)


def _about(
    nodes: Nodes, reference: ReferenceMotion, change: SlipProcess, priors: Priors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """State and constants (n, 11 + k), their covariance, and the constants alone, for the usual change."""
    model = Model.about(nodes, reference, change.middle)
    run = smoothed_back(model, filtered(model))
    (found,) = averaged(priors, run, likely_sets(priors, run.squares[0]))
    return *_joined(run, 0, found), found.mean


def _without_far_ones(nodes: Nodes, reference: ReferenceMotion, priors: Priors) -> ReferenceMotion:
    """Weights to begin with: the position that is farthest from where all others put it hardly counts, then the next.

    Student's law has several modes. Where a wrong position counts as much as any at first, its neighbours may end as
    the odd ones.
    """
    fix_weight, yaw_weight = reference.fix_weight.copy(), reference.yaw_weight.copy()
    for _ in range(len(nodes.time_s)):
        reference = replace(reference, fix_weight=fix_weight, yaw_weight=yaw_weight)
        state, covariance, constants = _about(nodes, reference, SlipProcess.coarse(), priors)
        off, spread = _residuals(nodes, reference, state, covariance)
        fixes = np.nan_to_num(_squared_distances(nodes, off, spread, fix_weight)[0])
        headings = np.nan_to_num(_yaw_squared_distances(nodes, off, spread, yaw_weight))
        fixes[fix_weight < 1.0], headings[yaw_weight < 1.0] = 0.0, 0.0
        reference = replace(reference, state=state[:, :SIZE], constants=constants)
        if max(fixes.max(), headings.max()) < FAR:
            return reference
        far = fixes >= max(FAR, fixes.max())
        fix_weight = np.where(far, (FREEDOM + 2.0) / (FREEDOM + fixes), fix_weight)
        far = headings >= max(FAR, 0.5 * headings.max())
        yaw_weight = np.where(far, (FREEDOM + 1.0) / (FREEDOM + headings), yaw_weight)
    return reference


def _joined(run: FilterRun, number: int, found: Posterior) -> tuple[FloatArray, FloatArray]:
    """State and constants together, and their covariance, for one of the assumptions."""
    columns, size = run.columns[:, number], len(found.mean)
    onto = np.concatenate([columns[..., 1:], np.broadcast_to(np.eye(size), (len(columns), size, size))], axis=1)
    state, covariance = onto @ found.mean, onto @ found.covariance @ np.swapaxes(onto, 1, 2)
    state[:, :SIZE] += columns[..., 0]
    covariance[:, :SIZE, :SIZE] += run.covariance[:, number]
    return state, covariance


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
    known = np.isfinite(squared_yaw)
    yaw[known] = np.minimum(1.0, (FREEDOM + 1.0) / (FREEDOM + squared_yaw[known]))
    return fix, yaw


def _averaged(
    nodes: Nodes, reference: ReferenceMotion, change: SlipProcess, priors: Priors
) -> tuple[FloatArray, FloatArray, Posterior]:
    """State and constants with their covariance, averaged over assumptions, linearised about a reference."""
    whole, every = SIZE + nodes.constants, change.all
    count, many = len(reference.state), len(every.walk)
    each = max(1, HELD_BYTES // (8 * SIZE * (SIZE + whole) * count))
    sets = likely_sets(priors, filtered(Model.about(nodes, reference, change.middle), kept=False).squares[0])
    means, covariance, found = np.zeros((many, count, whole)), np.zeros((count, whole, whole)), list[Posterior]()
    for first in range(0, many, each):
        some = slice(first, first + each)
        assumed = TriedProcesses(amplitude=every.amplitude[some], length_m=every.length_m[some], walk=every.walk[some])
        model = Model.about(nodes, reference, assumed)
        run = smoothed_back(model, filtered(model))
        for k, posterior in enumerate(averaged(priors, run, sets)):
            means[first + k], own = _joined(run, k, posterior)
            covariance += own
            found.append(posterior)
    mean = means.mean(axis=0)
    apart = means - mean
    covariance = (covariance + np.einsum("mni,mnj->nij", apart, apart)) / many
    middle = np.mean([one.ln_likelihood for one in found])
    held = np.mean([one.probable for one in found], axis=0)
    weights = np.concatenate([reference.fix_weight, reference.yaw_weight])
    # Student's law is a normal one of an unknown scale, which has a prior of its own.
    ln_likelihood = float(middle + 0.5 * FREEDOM * (np.log(weights) - weights + 1.0).sum())
    return mean, covariance, Posterior(mean[-1, SIZE:], covariance[-1, SIZE:, SIZE:], ln_likelihood, held)


def _yaw_squared_distances(nodes: Nodes, off: FloatArray, spread: FloatArray, weight: FloatArray) -> FloatArray:
    """The same of headings. (n,)"""
    errors = nodes.yaw_sigma_rad**2
    counted = errors / weight
    left = np.maximum(counted - spread[:, 2, 2], 1e-3 * counted)
    # Without the heading itself it is off by more, from a motion that is less well known.
    return np.asarray((off[:, 2] * counted / left) ** 2 / (errors + counted**2 / left - counted))


def _squared_distances(
    nodes: Nodes, off: FloatArray, spread: FloatArray, weight: FloatArray
) -> tuple[FloatArray, float, int]:
    """Mahalanobis distance squared of each position from what all others say of it; chi-square, and its freedom."""
    squared_distance = np.full(len(nodes.time_s), np.nan)
    chi_square, count = 0.0, 0.0
    for k in np.flatnonzero(nodes.fixed):
        errors, apart = nodes.fix_covariance_m2[k], off[k, :2]
        counted = errors / weight[k]
        left = counted - spread[k, :2, :2]
        value, axes = np.linalg.eigh(left)
        inverse = axes @ np.diag(1.0 / np.maximum(value, 1e-6 * np.trace(errors))) @ axes.T
        alone, known = counted @ inverse @ apart, counted @ inverse @ counted - counted
        squared_distance[k] = float(alone @ np.linalg.solve(errors + known, alone))
        chi_square += float(apart @ np.linalg.solve(counted, apart))
        count += float(np.trace(np.linalg.solve(counted, left)))
    return squared_distance, chi_square, max(round(count), 1)
