"""Means of the wheels over pieces of a drive, measured and predicted, and how well the measured ones are known.

Neighbouring values are alike: all of a drive share one soil, and errors of measurement are shared by neighbours and by
wheels where they come from one smoothed motion. So a piece of the drive counts as one value. What the members share is
in their covariance. Stated errors count as shared by the wheels at each time, but for sinkage, and as independent from
time to time, unless the scatter of the wheels' mean about its smooth course, with its correlation length, says clearly
more. Errors shared over more than a quarter of the drive cannot be told from a soil that is not the one believed.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lunarsci.twin.comparison.autocorrelation import correlation_length
from lunarsci.twin.comparison.meeting import Meeting
from lunarsci.twin.drive_record import OBSERVED
from lunarsci.twin.inference.misfit import MODEL_ERRORS

__all__ = ["PieceMeans", "most_pieces", "piece_edges", "piece_means"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
STEPS, MODES = 6, 3
"""Places where the smooth course may step, ends included, and shapes that the members' differences give it."""
LEAST_TIMES = 4
"""In a piece, below which its mean says little of its own."""
BY_WHEEL = ("sinkage_m",)
"""Measured of each wheel by itself; slip and forces follow from the motion of the one body, and share its errors."""
CLEARLY = 2.0
"""Times the variance of independent errors: from 16 values, an estimate is that large by chance in 1 of 100."""
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


def _times(meeting: Meeting, name: str) -> FloatArray:
    column = OBSERVED.index(name)
    return np.unique(meeting.record.time_s[meeting.known[:, column]])


def most_pieces(meeting: Meeting, names: list[str], wanted: int) -> int:
    """Pieces that leave each quantity four times in each, at most `wanted`; 0 where not even one does."""
    fewest = min((len(_times(meeting, name)) for name in names), default=0)
    return min(wanted, fewest // LEAST_TIMES)


def piece_edges(meeting: Meeting, names: list[str], pieces: int) -> FloatArray:
    """Times between pieces with as many measured times in each, of the quantity that has fewest. (pieces + 1,) [s]"""
    times = min((_times(meeting, name) for name in names), key=len)
    inner = [0.5 * (part[-1] + after[0]) for part, after in pairwise(np.array_split(times, pieces))]
    return np.array([-np.inf, *inner, np.inf])


def piece_means(meeting: Meeting, name: str, edges: FloatArray) -> PieceMeans | None:
    """Means of a quantity over all wheels and the times between edges; None where a piece has no value."""
    column = OBSERVED.index(name)
    rows = meeting.known[:, column]
    piece = np.searchsorted(edges, meeting.record.time_s[rows]) - 1
    count = len(edges) - 1
    size = np.bincount(piece, minlength=count)
    if (size == 0).any():
        return None
    average = (np.arange(count)[:, None] == piece) / size[:, None]
    measured, members = meeting.record.values[rows, column], meeting.predicted[:, rows, column]
    floor = MODEL_ERRORS[name] ** 2
    stated = np.maximum(meeting.sigma[rows, column] ** 2 - floor, 0.0)
    times = meeting.record.time_s[rows]
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
