"""What a drive teaches of the discrepancy: how far it missed the prediction, beside what the soil leaves open."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.interpolation import at_times
from lunarsci.regolith.physics_discrepancy import SHARED, PhysicsDiscrepancy
from lunarsci.twin.comparison.meeting import Meeting
from lunarsci.twin.inference.drive_record import OBSERVED
from lunarsci.twin.inference.misfit import MODEL_ERRORS
from lunarsci.twin.simulation.path_discrepancy import way_matrix

__all__ = ["Miss", "miss_of", "taught"]

FloatArray = npt.NDArray[np.float64]
NEAR = 0.5
"""Of a quantity's mean size, that its mean counts by at least: a mean force near 0 says nothing of shares; assumed."""


@dataclass(frozen=True, slots=True)
class Miss:
    """The last position beside the middle of the soils, as a share of the way.

    Attributes
    ----------
    way_m : commanded, to there. [m]
    along_m, across_m : how much farther, and how much to the left of the predicted middle the rover came. [m]
    along_share, across_share : of the way. [-]
    soil_m, position_m, physics_m : standard deviations, root of the trace: of the soils, of the measured place, and of
        the physics as it was believed. [m]
    """

    way_m: float
    along_m: float
    across_m: float
    along_share: float
    across_share: float
    soil_m: float
    position_m: float
    physics_m: float


def _parts(meeting: Meeting) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, int] | None:
    """Miss (2,), covariances of soils and of the place (2, 2), matrix of the way (2, 2), and number of the position."""
    times, forecast = meeting.record.fix_time_s, meeting.forecast
    if not len(times) or len(meeting.members) < 4:
        return None
    last = int(times.argmax())
    places, paths = meeting.places[:, last], forecast.paths[meeting.members][..., :3].copy()
    if forecast.discrepancy is not None:
        offsets = forecast.discrepancy.offsets_m[meeting.members]
        paths[..., :2] -= offsets
        places = places - at_times(times[last : last + 1], forecast.time_s, offsets, axis=-2)[:, 0]
    so_far = slice(0, int(np.searchsorted(forecast.time_s, min(float(times[last]), float(forecast.time_s[-1])))) + 1)
    way_m2 = way_matrix(forecast.planned[so_far, :2], paths[:, so_far])
    middle = np.median(places, axis=0)
    return meeting.record.fix_m[last] - middle, np.cov(places.T), meeting.place_error_m2[last], way_m2, last


def miss_of(meeting: Meeting) -> Miss | None:
    """How the last position was missed; None without positions, or with fewer than four drives."""
    found = _parts(meeting)
    if found is None:
        return None
    miss, soil, place, way_m2, last = found
    chord = meeting.planned[last] - meeting.forecast.planned[0, :2]
    ahead = chord / max(float(np.hypot(*chord)), 1e-12)
    along, across = float(miss @ ahead), float(ahead[0] * miss[1] - ahead[1] * miss[0])
    way, law = float(meeting.fix_distance_m[last]), meeting.forecast.discrepancy
    return Miss(
        way_m=way,
        along_m=along,
        across_m=across,
        along_share=along / max(way, 1e-12),
        across_share=across / max(way, 1e-12),
        soil_m=float(np.sqrt(np.trace(soil))),
        position_m=float(np.sqrt(np.trace(place))),
        physics_m=0.0 if law is None else float(np.sqrt(np.trace(law.law.covariance_m2(way_m2)))),
    )


def taught(meeting: Meeting, before: PhysicsDiscrepancy) -> PhysicsDiscrepancy:
    """The discrepancy after the drive: the way's shares by the last position, those of wheel states by their means."""
    after, found = before, _parts(meeting)
    if found is not None:
        miss, soil, place, way_m2, _ = found
        after = after.with_miss(miss, soil + place, way_m2)
    for name in SHARED:
        column = OBSERVED.index(name)
        rows = meeting.known[:, column]
        if rows.any() and len(meeting.members) > 3:
            after = _by_mean(meeting, name, rows, after)
    return after


def _by_mean(
    meeting: Meeting, name: str, rows: npt.NDArray[np.bool_], before: PhysicsDiscrepancy
) -> PhysicsDiscrepancy:
    column, drawn = OBSERVED.index(name), meeting.forecast.discrepancy
    members = meeting.predicted[:, rows, column]
    if drawn is not None:
        members = members / np.maximum(1.0 + drawn.shares[name][meeting.members], 1e-3)[:, None]
    means = members.mean(axis=1)
    size = float(np.abs(members).mean())
    if size <= 0.0 or abs(float(means.mean())) < NEAR * size:
        return before
    miss = float((meeting.record.values[rows, column] - members.mean(axis=0)).mean())
    error = float((meeting.sigma[rows, column] ** 2).mean()) / int(rows.sum()) + MODEL_ERRORS[name] ** 2
    return before.with_quantity(name, miss, float(means.var(ddof=1)) + error, abs(float(means.mean())))
