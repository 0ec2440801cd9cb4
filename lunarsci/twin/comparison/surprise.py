"""Is what happened one of the things that were predicted: all quantities together, along the drive.

Means of the wheels over pieces of a drive, measured and predicted, and how well the measured ones are known.

Neighbouring values are alike: all of a drive share one soil, and errors of measurement are shared by neighbours and by
wheels where they come from one smoothed motion. So a piece of the drive counts as one value. What the members share is
in their covariance. Stated errors count as shared by the wheels at each time, but for sinkage, and as independent from
time to time, unless the scatter of the wheels' mean about its smooth course, with its correlation length, says clearly
more. Errors shared over more than a quarter of the drive cannot be told from a soil that is not the one believed.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.twin.assimilation.drive_record import OBSERVED
from lunarsci.twin.assimilation.residuals import MODEL_ERRORS
from lunarsci.twin.comparison.matched import MatchedObservations
from lunarsci.twin.comparison.scores import Standing, correlation_length, standing, worst_of

STEPS, MODES = 6, 3
"""Places where the smooth course may step, ends included, and shapes that the members' differences give it."""
LEAST_TIMES = 4
"""In a piece, below which its mean says little of its own."""
BY_WHEEL = ("sinkage_m",)
"""Measured of each wheel by itself; slip and forces follow from the motion of the one body, and share its errors."""
CLEARLY = 2.0
"""Times the variance of independent errors: from 16 values, an estimate is that large by chance in 1 of 100.
Assumed."""
LEAST_FREE = 8
"""Values beyond those that the smooth course takes, below which their scatter is not asked."""


@dataclass(frozen=True, slots=True, eq=False)
class PieceMeans:
    """Means of one quantity over the pieces.

    Attributes
    ----------
    observed, members : measured (k,), predicted (M, k).
    variance : of the error of the measured ones, with that of the model. (k,)
    free : values that its estimate rests on; infinite where it follows from the stated errors.
    """

    observed: FloatArray
    members: FloatArray
    variance: FloatArray
    free: float


def _times(matched: MatchedObservations, name: str) -> FloatArray:
    column = OBSERVED.index(name)
    return np.unique(matched.record.time_s[matched.known[:, column]])


def most_pieces(matched: MatchedObservations, names: list[str], wanted: int) -> int:
    """Pieces that leave each quantity four times in each, at most `wanted`; 0 where not even one does."""
    fewest = min((len(_times(matched, name)) for name in names), default=0)
    return min(wanted, fewest // LEAST_TIMES)


def piece_edges(matched: MatchedObservations, names: list[str], pieces: int) -> FloatArray:
    """Times between pieces with as many measured times in each, of the quantity that has fewest. (pieces + 1,) [s]"""
    times = min((_times(matched, name) for name in names), key=len)
    inner = [0.5 * (part[-1] + after[0]) for part, after in pairwise(np.array_split(times, pieces))]
    return np.array([-np.inf, *inner, np.inf])


def piece_means(matched: MatchedObservations, name: str, edges: FloatArray) -> PieceMeans | None:
    """Means of a quantity over all wheels and the times between edges; None where a piece has no value."""
    column = OBSERVED.index(name)
    rows = matched.known[:, column]
    piece = np.searchsorted(edges, matched.record.time_s[rows]) - 1
    count = len(edges) - 1
    size = np.bincount(piece, minlength=count)
    if (size == 0).any():
        return None
    average = (np.arange(count)[:, None] == piece) / size[:, None]
    measured, members = matched.record.values[rows, column], matched.predicted[:, rows, column]
    floor = MODEL_ERRORS[name] ** 2
    stated = np.maximum(matched.sigma[rows, column] ** 2 - floor, 0.0)
    times = matched.record.time_s[rows]
    of_one, free = _scatter(times, measured - members.mean(axis=0), members - members.mean(axis=0))
    moments = np.array([len(np.unique(times[piece == k])) for k in range(count)])
    enough = free >= LEAST_FREE
    independent = (average**2) @ stated if name in BY_WHEEL and enough else average @ stated / moments
    shared = of_one / moments if enough else np.zeros(count)
    own = np.where(shared > CLEARLY * independent, shared, independent)
    known_from = float(free) if (own > independent).any() else np.inf
    return PieceMeans(average @ measured, members @ average.T, own + floor, known_from)


def _scatter(times: FloatArray, off: FloatArray, anomalies: FloatArray) -> tuple[float, int]:
    """Variance of the wheels' mean at one time about its smooth course, times the correlation length of what is left.

    The course may follow the shapes by which the members differ most, and step once where that serves best, so that a
    soil that changes is not taken for noise. Also returned: how many values are left to tell.
    """
    moments, place = np.unique(times, return_inverse=True)
    average = (np.arange(len(moments))[:, None] == place) / np.bincount(place)[:, None]
    series, shapes = average @ off, anomalies @ average.T
    _, _, modes = np.linalg.svd(shapes, full_matrices=False)
    free = len(moments) - 2 - len(modes[:MODES])
    if free < LEAST_FREE:
        return 0.0, free
    rests = []
    for step in np.linspace(0, len(moments), STEPS + 1).astype(np.int64)[1:-1]:
        known = np.column_stack([np.ones(len(moments)), np.arange(len(moments)) >= step, modes[:MODES].T])
        rests.append(series - known @ np.linalg.lstsq(known, series, rcond=None)[0])
    rest = min(rests, key=lambda one: float(one @ one))
    return float(rest @ rest) / free * correlation_length(rest, len(moments) - free), free


PIECES, FINE_PIECES = 4, 6
"""Of the drive, for the surprise and for a change of the soil: few, as each must be one value among the members."""
MEMBERS_EACH = 4
"""Members for each dimension of the vector, below which fewer pieces are taken."""


@dataclass(frozen=True, slots=True)
class Surprise:
    """The whole drive against the members.

    Attributes
    ----------
    standing : the vector of means and places.
    pieces : of the drive, each of which counts as one value of each quantity.
    quantities : in the vector, `position` among them.
    """

    standing: Standing
    pieces: int
    quantities: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Bias:
    """Means over the drive: each quantity against the members; the worst, and the probability of one as bad.

    That is the smallest by itself times the number of quantities, at most 1 (Bonferroni).
    """

    quantities: dict[str, Standing]
    worst: str
    p: float


@dataclass(frozen=True, slots=True)
class GroundChange:
    """Where the ground seems to change: the commanded distance [m], and the probability of such by chance."""

    distance_m: float
    p: float


def _names(matched: MatchedObservations) -> list[str]:
    """Quantities that are measured, and are no second reading of the positions."""
    columns = {name: OBSERVED.index(name) for name in matched.measured_quantities()}
    return [name for name, k in columns.items() if matched.independent[matched.known[:, k], k].all()]


def surprise(matched: MatchedObservations, seed: int = 0) -> Surprise | None:
    """Means of each quantity over all wheels and a piece of the drive, and the last position of each piece.

    As many pieces, at most four, as leave four members to a dimension. None where nothing fits even one piece.
    """
    names = _names(matched)
    for pieces in range(most_pieces(matched, names, PIECES) if names else PIECES, 0, -1):
        found = _vector(matched, names, pieces)
        if found is None or (found[0].size * MEMBERS_EACH > len(matched.members) and pieces > 1):
            continue
        result = standing(*found[:3], seed, found[3])
        own = (*names, *(["position"] if len(matched.record.fix_time_s) else []))
        return None if result is None else Surprise(result, pieces, own)
    return None


def _vector(
    matched: MatchedObservations, names: list[str], pieces: int
) -> tuple[FloatArray, FloatArray, FloatArray, float] | None:
    """Measured (d,), members (M, d), covariance of the errors (d, d), and values that this rests on."""
    end = matched.forecast.time_s[-1]
    edges = np.append(np.append(-np.inf, np.linspace(0.0, end, pieces + 1)[1:-1]), np.inf)
    if names:
        edges = piece_edges(matched, names, pieces)
    observed, members, blocks, free = [], [], [], np.inf
    for name in names:
        means = piece_means(matched, name, edges)
        if means is None:
            return None
        observed.append(means.observed)
        members.append(means.members)
        blocks.append(np.diag(means.variance))
        free = min(free, means.free)
    for fix in _last_fixes(matched.record.fix_time_s, edges):
        observed.append(matched.record.fix_m[fix])
        members.append(matched.places[:, fix])
        blocks.append(matched.place_error_m2[fix])
    if not blocks:
        return None
    from scipy.linalg import block_diag

    return np.concatenate(observed), np.concatenate(members, axis=1), np.asarray(block_diag(*blocks)), free


def _last_fixes(times: FloatArray, edges: FloatArray) -> list[int]:
    """The last position of each piece that has one."""
    piece = np.searchsorted(edges, times) - 1
    return [int(np.flatnonzero(piece == k)[times[piece == k].argmax()]) for k in np.unique(piece)]


def mean_bias(matched: MatchedObservations, seed: int = 0) -> Bias | None:
    """The mean of each quantity over the whole drive and all wheels, against the members; None with too few."""
    names, whole = matched.measured_quantities(), np.array([-np.inf, np.inf])
    means = {name: one for name in names if (one := piece_means(matched, name, whole)) is not None}
    if not means:
        return None
    own = {name: standing(m.observed, m.members, np.diag(m.variance), seed, m.free) for name, m in means.items()}
    found = {name: one for name, one in own.items() if one is not None}
    if not found:
        return None
    worst = min(found, key=lambda name: found[name].p)
    return Bias(found, worst, min(1.0, len(found) * found[worst].p))


def find_change(matched: MatchedObservations, seed: int = 0) -> GroundChange | None:
    """Where the means after and before differ from what was predicted most, of five places in the drive.

    A soil that is not the one believed shows on the whole way; one that changes shows in the difference. None where
    there are too few members, times or measured quantities.
    """
    names = _names(matched)
    pieces = most_pieces(matched, names, FINE_PIECES) if names else 0
    if pieces < 2:
        return None
    edges = piece_edges(matched, names, pieces)
    found = [piece_means(matched, name, edges) for name in names]
    parts = np.array([[0.0] * pieces] * (pieces - 1))
    for split in range(1, pieces):
        parts[split - 1, :split], parts[split - 1, split:] = -1.0 / split, 1.0 / (pieces - split)
    means = [one for one in found if one is not None]
    observed = np.stack([parts @ one.observed for one in means], axis=-1)
    members = np.stack([one.members @ parts.T for one in means], axis=-1)
    errors = np.stack([parts**2 @ one.variance for one in means], axis=-1)
    free = min(one.free for one in means)
    most = worst_of(observed, members, np.einsum("kd,de->kde", errors, np.eye(len(means))), seed, free)
    if most is None:
        return None
    place = float(np.interp(edges[most[0] + 1], matched.forecast.time_s, matched.forecast.distance_m))
    return GroundChange(place, most[2])
