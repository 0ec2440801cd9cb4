"""Where along a drive the soil changes: one soil for the whole way is held against two, one after the other.

About the best single soil the states are linear in the transforms of the soil parameters. For every place of the way
two soils, before and after it, are fitted to the residuals by least squares with the first laws' widths as a penalty;
the statistic is how much more they explain than one (the likelihood ratio of a change at an unknown place: Andrews
1993, Econometrica 61, 821, 10.2307/2951764; Csorgo & Horvath 1997, Limit Theorems in Change-Point Analysis, Wiley).
Its largest value over all places is held against those of simulated drives over one soil, whose noise is as large and
as correlated along the way as what two soils leave.

A drive as a line: where along the way each wheel stood, and residuals averaged over short pieces of the way.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.assimilation.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import Prediction

BIN_M, MOST_BINS = 0.2, 200
"""Length of way over which residuals are averaged, longer where the drive has more pieces; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class Traverse:
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


def traverse_of(drive: Prediction) -> Traverse:
    """The way of the first member of a prediction."""
    wheels = drive.rover.wheel_positions_m
    return Traverse(drive.time_s, drive.distance_m, drive.paths[0, :, :2], float(np.abs(wheels[:, 0]).max()))


def planned_places(plan: Plan, rover: Rover) -> FloatArray:
    """Places of the rover's origin along a plan, a decimetre or less apart. (k, 2) [m]"""
    schedule = make_schedule(plan, rover)
    count = max(2, math.ceil(schedule.duration_s * plan.speed_m_s / 0.1) + 1)
    return schedule.pose_at(np.linspace(0.0, schedule.duration_s, count))[:, :2]


def wheel_places(rover: Rover, record: DriveRecord, way: Traverse) -> FloatArray:
    """Distance along the way at which each wheel of a record stood. (n,) [m]

    That of the origin, and how far ahead of it the wheel is on the rover: as on a drive straight ahead.
    """
    ahead = rover.wheel_positions_m[[rover.wheels.index(name) for name in record.wheel], 0]
    return way.distance_at(record.time_s) + ahead


@dataclass(frozen=True, slots=True, eq=False)
class TrackBins:
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

    def part(self, kept: BoolArray) -> "TrackBins":
        """Some of the pieces."""
        middle, mean, weight, slope = (part[kept] for part in (self.middle_m, self.mean, self.weight, self.slope))
        return TrackBins(middle, self.names, mean, weight, slope, self.model)


def binned(places: FloatArray, values: FloatArray, slopes: FloatArray, model: FloatArray) -> TrackBins | None:
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
    length = max(BIN_M, float(np.ptp(places)) / MOST_BINS)
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
    return TrackBins(middle[full], tuple(OBSERVED[k] for k in columns), mean, weight[full], slope, model[columns])


FEWEST_BINS = 4
"""On either side of a change; assumed."""
SIMULATIONS = 999
MODEL_M = 3.0
"""Way over which errors of the twin itself are alike, such as an arc's; assumed. [m]"""
MOST_CORRELATED = 0.95
"""Correlation of neighbouring bins that is reckoned with at most: what is left of a mean must not vanish; assumed."""
MARGIN = 1.0
"""Standard errors by which noise counts as more correlated than it was found: the p-value is that of an unkind case
within the uncertainty, as in Berger & Boos (1994), J. Am. Stat. Assoc. 89, 1012."""


@dataclass(frozen=True, slots=True, eq=False)
class ChangePoint:
    """The most likely change: where, p-value, places tried and how much more two soils explain there. (k,), (k,)"""

    after_m: float
    p_value: float
    tried_m: FloatArray
    statistic: FloatArray


def find_change_point(bins: TrackBins, random: np.random.Generator, simulations: int = SIMULATIONS) -> ChangePoint:
    """The most likely change and its p-value, no smaller than 1 / (simulations + 1).

    Parameters
    ----------
    pieces : residuals of the way, `2 * FEWEST_PIECES` or more, and how they follow the soil.
    random : source of random numbers.
    simulations : of drives over one soil.
    """
    size, quantities = bins.mean.shape
    sigma = np.ones(quantities)
    for _ in range(2):
        fits = _Fits(bins, sigma)
        statistic = fits.gain(fits.whitened(bins.mean)[None])[0]
        best = int(np.argmax(statistic))
        sigma, autocorrelation = _noise(bins, fits.rest(best), fits.numbers(best) / quantities)
    fits = _Fits(bins, sigma)
    statistic = fits.gain(fits.whitened(bins.mean)[None])[0]
    roots = np.stack([_root(bins, k, sigma[k], autocorrelation[k]) for k in range(quantities)])
    noise = np.einsum("qab,qbc,dqc->dqa", fits.inverse, roots, random.standard_normal((simulations, quantities, size)))
    null = fits.gain(noise.reshape(simulations, -1)).max(axis=1)
    p_value = (1 + int((null >= statistic.max()).sum())) / (simulations + 1)
    tried = (0.5 * (bins.middle_m[1:] + bins.middle_m[:-1]))[fits.places]
    return ChangePoint(float(tried[int(np.argmax(statistic))]), p_value, tried, statistic)


class _Fits:
    """One soil, and two soils with a change at each place, fitted as if noise did not persist.

    What that costs is in the simulated drives, whose noise does.
    """

    def __init__(self, bins: TrackBins, sigma: FloatArray) -> None:
        size, quantities = bins.mean.shape
        self.bins = bins
        self.places = slice(FEWEST_BINS - 1, size - FEWEST_BINS)
        self.inverse = np.linalg.inv(np.stack([_root(bins, k, sigma[k], 0.0) for k in range(quantities)]))
        # Columns of the soil before each place, whitened: (places, quantities * pieces, 8).
        grown = np.cumsum(np.einsum("qab,bqp->bqap", self.inverse, bins.slope), axis=0)
        self.whole = grown[-1].reshape(quantities * size, -1)
        self.before = grown[:-1][self.places].reshape(-1, *self.whole.shape)
        both = np.concatenate([self.before, self.whole - self.before], axis=-1)
        self.one = np.linalg.inv(self.whole.T @ self.whole + np.eye(self.whole.shape[1]))
        self.two = np.linalg.inv(np.swapaxes(both, 1, 2) @ both + np.eye(both.shape[-1]))

    def whitened(self, mean: FloatArray) -> FloatArray:
        """Means (m, q) as unit noise. (q * m,)"""
        return np.asarray(np.einsum("qab,bq->qa", self.inverse, mean).ravel())

    def gain(self, white: FloatArray) -> FloatArray:
        """How much more two soils explain than one, at each place, of several drives (d, q * m). (d, places)"""
        whole = white @ self.whole
        first = np.einsum("dn,knp->dkp", white, self.before, optimize=True)
        both = np.concatenate([first, whole[:, None] - first], axis=-1)
        explained = np.einsum("dkp,kpr,dkr->dk", both, self.two, both, optimize=True)
        return np.asarray(explained - np.einsum("dp,pr,dr->d", whole, self.one, whole)[:, None])

    def numbers(self, place: int) -> float:
        """How many numbers two soils take from the data: the trace of what maps means to fitted ones. [-]"""
        white = np.concatenate([self.before[place], self.whole - self.before[place]], axis=-1)
        return float(np.trace(self.two[place] @ (white.T @ white)))

    def rest(self, place: int) -> FloatArray:
        """What two soils with the change at a place leave. (m, q)"""
        slope, mean = self.bins.slope, self.bins.mean
        first = np.arange(len(mean)) <= place + self.places.start
        columns = np.concatenate([slope * first[:, None, None], slope * ~first[:, None, None]], axis=-1)
        white = np.concatenate([self.before[place], self.whole - self.before[place]], axis=-1)
        return np.asarray(mean - columns @ (self.two[place] @ (white.T @ self.whitened(mean))))


def _root(bins: TrackBins, quantity: int, sigma: float, autocorrelation: float) -> FloatArray:
    """Root of the covariance of a quantity's means: noise of the values, and errors of the twin itself."""
    lag = np.abs(bins.middle_m[:, None] - bins.middle_m)
    number = np.rint(lag / max(float(np.min(np.diff(bins.middle_m))), 1e-6))
    scale = sigma / np.sqrt(bins.weight[:, quantity])
    noise = np.outer(scale, scale) * np.where(number > 0, autocorrelation**number, 1.0)
    return np.linalg.cholesky(noise + bins.model[quantity] ** 2 * np.exp(-lag / MODEL_M))


def _noise(bins: TrackBins, rest: FloatArray, fitted: float) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of one value, no smaller than stated, and autocorrelation from bin to bin. (q,), (q,)

    `fitted` numbers were taken from each series. In n values a mean taken away hides (1 + 3 r) / n of their
    autocorrelation r (Kendall 1954, Biometrika 41, 403), and so, about, does every other number; this and `MARGIN` are
    added.
    """
    size = len(rest)
    white = rest * np.sqrt(bins.weight)
    square = np.maximum((white**2).sum(axis=0), np.finfo(float).tiny)
    lag = (white[1:] * white[:-1]).sum(axis=0) / square
    lag = lag + fitted * (1.0 + 3.0 * np.maximum(lag, 0.0)) / size
    lag = lag + MARGIN * np.sqrt((1.0 - np.minimum(lag**2, 1.0)) / size)
    sigma = np.sqrt(square / max(size - fitted, 0.25 * size))
    return np.maximum(sigma, 1.0), np.clip(lag, 0.0, MOST_CORRELATED)
