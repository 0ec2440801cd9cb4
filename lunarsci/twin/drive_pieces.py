"""A drive as a line: where along the way each wheel stood, and residuals averaged over short pieces of the way."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import make_schedule
from lunarsci.twin.rover import Rover

__all__ = ["Pieces", "Way", "averaged", "planned_places", "way_of", "wheel_places"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
PIECE_M, MOST_PIECES = 0.2, 200
"""Length of way over which residuals are averaged, longer where the drive has more pieces; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """A drive as a line.

    Attributes
    ----------
    time_s, distance_m, place_m : of the rover's origin; distance never falls. (n,), (n,) [m], (n, 2) [m]
    reach_m : from the origin to its foremost or hindmost wheel. [m]
    """

    time_s: FloatArray
    distance_m: FloatArray
    place_m: FloatArray
    reach_m: float

    @property
    def _moving(self) -> BoolArray:
        return np.concatenate([[True], np.diff(self.distance_m) > 0])

    def distance_at(self, time_s: npt.ArrayLike) -> FloatArray:
        """Of the origin. [m]"""
        return np.asarray(np.interp(np.asarray(time_s, dtype=float), self.time_s, self.distance_m))

    def time_at(self, distance_m: float) -> float:
        """When the origin passed a distance. [s]"""
        return float(np.interp(distance_m, self.distance_m[self._moving], self.time_s[self._moving]))

    def place_at(self, distance_m: npt.ArrayLike) -> FloatArray:
        """Of the origin, and of the wheels before its start and beyond its end: straight on. (..., 2) [m]"""
        stations, places = self._line
        wanted = np.asarray(distance_m, dtype=float)
        return np.stack([np.interp(wanted, stations, places[:, k]) for k in (0, 1)], axis=-1)

    @property
    def _line(self) -> tuple[FloatArray, FloatArray]:
        """Distances and places, with the ground of the wheels at both ends."""
        stations, places = self.distance_m[self._moving], self.place_m[self._moving]
        if len(stations) < 2:
            return stations, places
        ends = []
        for end, inner in ((0, 1), (-1, -2)):
            ahead = (places[end] - places[inner]) / max(float(np.linalg.norm(places[end] - places[inner])), 1e-9)
            ends.append(places[end] + self.reach_m * ahead)
        stations = np.concatenate([[stations[0] - self.reach_m], stations, [stations[-1] + self.reach_m]])
        return stations, np.concatenate([ends[:1], places, ends[1:]])

    def between(self, low_m: float, high_m: float) -> FloatArray:
        """Places of a stretch, its ends included; without limits from the hindmost wheel to the foremost. (k, 2) [m]"""
        stations, _ = self._line
        low, high = (float(np.clip(value, stations[0], stations[-1])) for value in (low_m, high_m))
        inside = stations[(stations > low) & (stations < high)]
        return self.place_at(np.unique(np.concatenate([[low], inside, [high]])))


def way_of(drive: Prediction) -> Way:
    """The way of the first member of a prediction."""
    wheels = drive.rover.wheel_positions_m
    return Way(drive.time_s, drive.distance_m, drive.paths[0, :, :2], float(np.abs(wheels[:, 0]).max()))


def planned_places(plan: Plan, rover: Rover) -> FloatArray:
    """Places of the rover's origin along a plan, a decimetre or less apart. (k, 2) [m]"""
    schedule = make_schedule(plan, rover)
    count = max(2, math.ceil(schedule.duration_s * plan.speed_m_s / 0.1) + 1)
    return schedule.pose_at(np.linspace(0.0, schedule.duration_s, count))[:, :2]


def wheel_places(rover: Rover, record: DriveRecord, way: Way) -> FloatArray:
    """Distance along the way at which each wheel of a record stood. (n,) [m]

    That of the origin, and how far ahead of it the wheel is on the rover: as on a drive straight ahead.
    """
    ahead = rover.wheel_positions_m[[rover.wheels.index(name) for name in record.wheel], 0]
    return way.distance_at(record.time_s) + ahead


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Means of whitened residuals, measured less simulated, over pieces of the way in which all quantities are known.

    Attributes
    ----------
    middle_m : of the pieces, along the way. (m,) [m]
    names : quantities. (q,)
    mean, weight : of each piece and quantity, and of how many values. (m, q)
    slope : means of the derivatives of the simulated values by the soil, in widths of the first laws. (m, q, 8)
    model : error of the twin itself in units of the residuals, alike over metres. (q,)
    """

    middle_m: FloatArray
    names: tuple[str, ...]
    mean: FloatArray
    weight: FloatArray
    slope: FloatArray
    model: FloatArray

    def part(self, kept: BoolArray) -> "Pieces":
        """Some of the pieces."""
        middle, mean, weight, slope = (part[kept] for part in (self.middle_m, self.mean, self.weight, self.slope))
        return Pieces(middle, self.names, mean, weight, slope, self.model)


def averaged(places: FloatArray, values: FloatArray, slopes: FloatArray, model: FloatArray) -> Pieces | None:
    """Means over pieces of way; None where no piece has all the quantities that were measured at all.

    Parameters
    ----------
    places : along the way. (n,) [m]
    values : NaN where not measured. (n, 6)
    slopes : of the values by the soil. (n, 6, 8)
    model : of each quantity. (6,)
    """
    known = np.isfinite(values)
    columns = np.flatnonzero(known.any(axis=0))
    if not columns.size:
        return None
    length = max(PIECE_M, float(np.ptp(places)) / MOST_PIECES)
    first = np.floor(places.min() / length)
    number = (np.floor(places / length) - first).astype(np.int64)
    weight = np.zeros((int(number.max()) + 1, len(columns)))
    total, slope = np.zeros(weight.shape), np.zeros((*weight.shape, slopes.shape[-1]))
    seen = known[:, columns]
    np.add.at(weight, number, seen)
    np.add.at(total, number, np.where(seen, values[:, columns], 0.0))
    np.add.at(slope, number, np.where(seen[..., None], slopes[:, columns], 0.0))
    full = (weight > 0).all(axis=1)
    if not full.any():
        return None
    middle = (first + np.arange(len(weight)) + 0.5) * length
    mean, slope = total[full] / weight[full], slope[full] / weight[full][..., None]
    return Pieces(middle[full], tuple(OBSERVED[k] for k in columns), mean, weight[full], slope, model[columns])
