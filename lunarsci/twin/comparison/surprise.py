"""Is what happened one of the things that were predicted: all quantities together, along the drive."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.comparison.means import most_pieces, piece_edges, piece_means
from lunarsci.twin.comparison.meeting import Meeting
from lunarsci.twin.comparison.tail import Standing, standing, worst_of
from lunarsci.twin.drive_record import OBSERVED

__all__ = ["Bias", "Change", "Surprise", "find_change", "mean_bias", "surprise"]

FloatArray = npt.NDArray[np.float64]
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
class Change:
    """Where the ground seems to change: the commanded distance [m], and the probability of such by chance."""

    distance_m: float
    p: float


def _names(meeting: Meeting) -> list[str]:
    """Quantities that are measured, and are no second reading of the positions."""
    columns = {name: OBSERVED.index(name) for name in meeting.measured_quantities()}
    return [name for name, k in columns.items() if meeting.independent[meeting.known[:, k], k].all()]


def surprise(meeting: Meeting, seed: int = 0) -> Surprise | None:
    """Means of each quantity over all wheels and a piece of the drive, and the last position of each piece.

    As many pieces, at most four, as leave four members to a dimension. None where nothing fits even one piece.
    """
    names = _names(meeting)
    for pieces in range(most_pieces(meeting, names, PIECES) if names else PIECES, 0, -1):
        found = _vector(meeting, names, pieces)
        if found is None or (found[0].size * MEMBERS_EACH > len(meeting.members) and pieces > 1):
            continue
        result = standing(*found[:3], seed, found[3])
        own = (*names, *(["position"] if len(meeting.record.fix_time_s) else []))
        return None if result is None else Surprise(result, pieces, own)
    return None


def _vector(meeting: Meeting, names: list[str], pieces: int) -> tuple[FloatArray, FloatArray, FloatArray, float] | None:
    """Measured (d,), members (M, d), covariance of the errors (d, d), and values that this rests on."""
    end = meeting.forecast.time_s[-1]
    edges = np.append(np.append(-np.inf, np.linspace(0.0, end, pieces + 1)[1:-1]), np.inf)
    if names:
        edges = piece_edges(meeting, names, pieces)
    observed, members, blocks, free = [], [], [], np.inf
    for name in names:
        means = piece_means(meeting, name, edges)
        if means is None:
            return None
        observed.append(means.observed)
        members.append(means.members)
        blocks.append(np.diag(means.variance))
        free = min(free, means.free)
    for fix in _last_fixes(meeting.record.fix_time_s, edges):
        observed.append(meeting.record.fix_m[fix])
        members.append(meeting.places[:, fix])
        blocks.append(meeting.place_error_m2[fix])
    if not blocks:
        return None
    from scipy.linalg import block_diag

    return np.concatenate(observed), np.concatenate(members, axis=1), np.asarray(block_diag(*blocks)), free


def _last_fixes(times: FloatArray, edges: FloatArray) -> list[int]:
    """The last position of each piece that has one."""
    piece = np.searchsorted(edges, times) - 1
    return [int(np.flatnonzero(piece == k)[times[piece == k].argmax()]) for k in np.unique(piece)]


def mean_bias(meeting: Meeting, seed: int = 0) -> Bias | None:
    """The mean of each quantity over the whole drive and all wheels, against the members; None with too few."""
    names, whole = meeting.measured_quantities(), np.array([-np.inf, np.inf])
    means = {name: one for name in names if (one := piece_means(meeting, name, whole)) is not None}
    if not means:
        return None
    own = {name: standing(m.observed, m.members, np.diag(m.variance), seed, m.free) for name, m in means.items()}
    found = {name: one for name, one in own.items() if one is not None}
    if not found:
        return None
    worst = min(found, key=lambda name: found[name].p)
    return Bias(found, worst, min(1.0, len(found) * found[worst].p))


def find_change(meeting: Meeting, seed: int = 0) -> Change | None:
    """Where the means after and before differ from what was predicted most, of five places in the drive.

    A soil that is not the one believed shows on the whole way; one that changes shows in the difference. None where
    there are too few members, times or measured quantities.
    """
    names = _names(meeting)
    pieces = most_pieces(meeting, names, FINE_PIECES) if names else 0
    if pieces < 2:
        return None
    edges = piece_edges(meeting, names, pieces)
    found = [piece_means(meeting, name, edges) for name in names]
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
    place = float(np.interp(edges[most[0] + 1], meeting.forecast.time_s, meeting.forecast.distance_m))
    return Change(place, most[2])
