"""Where along a drive the soil changes: one soil for the whole way is held against two, one after the other.

About the best single soil the states are linear in the transforms of the soil parameters. For every place of the way
two soils, before and after it, are fitted to the residuals by least squares with the first laws' widths as a penalty;
the statistic is how much more they explain than one (the likelihood ratio of a change at an unknown place: Andrews
1993, Econometrica 61, 821, 10.2307/2951764; Csorgo & Horvath 1997, Limit Theorems in Change-Point Analysis, Wiley).
Its largest value over all places is held against those of simulated drives over one soil, whose noise is as large and
as correlated along the way as what two soils leave. Residuals are averaged over short pieces of the way, along which it
is known where each wheel stood.

A drive in which a change is found is cut in two, the soil of each part is found, and each part is searched in turn
(binary segmentation: Vostrikova 1981, Soviet Math. Dokl. 24, 55), as long as there are changes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray
from lunarsci.ranges import check_range
from lunarsci.regolith.belief import SoilBelief, effective_rows
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.assimilation.residuals import HUBER, MODEL_ERRORS, OBSERVED, SAMPLE_M, DriveRecord, states_at
from lunarsci.twin.assimilation.update import SlipLean, SoilUpdate, assimilate
from lunarsci.twin.ground.soil_map import SoilMap
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import ALIKE_M
from lunarsci.twin.simulation.ensemble import LONGEST_SAMPLE_M, LONGEST_STEP_S, Prediction, predict

BIN_M, MOST_BINS = 2.0 * SAMPLE_M, 200
"""Length of way over which residuals are averaged: two samples of a drive, between which states are interpolated;
longer where the drive has more pieces, whose covariance takes their number squared."""
FEWEST_BINS = 4
"""On either side of a change; assumed."""
SIMULATIONS = 999
"""Drives over one soil that a change is held against: p-values of 0.001 or more."""
MARGIN = 1.0
"""Standard errors by which noise counts as more correlated than it was found: the p-value is that of an unkind case
within the uncertainty, as in Berger & Boos (1994), J. Am. Stat. Assoc. 89, 1012."""
NUDGE = 0.1
"""Widths of the first laws by which soils are moved to either side for derivatives; assumed."""
WITHIN_95 = 7.35
"""Fall of the statistic from its top within which the place lies, at 95 %: Hansen (2000), Econometrica 68, 575,
10.1111/1468-0262.00124."""
FALSE_ALARMS = SIGNIFICANCE
"""Wanted share of drives over one soil in which a change is found; 0.05 at most where the twin is off by its errors."""
MODEL_SHARE = 2.0
"""Of `MODEL_ERRORS`, which are those of single values, by which the twin may be off over metres of way; assumed, and
enough for what is left of the time step's errors."""
FINER = 0.25
"""Of the time step."""
MOST_SEGMENTS = 16
"""Stretches with a soil of their own beyond which no further change is looked for; assumed."""
FEWEST_VALUES = 2 * len(PARAMETERS)
"""Of a stretch whose soil is learned, and whose median slip is judged: as many are left to judge it by as it takes.
With fewer it stays as believed."""


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

    def part(self, inside: BoolArray) -> "TrackBins":
        """Some of the pieces."""
        middle, mean, weight, slope = (part[inside] for part in (self.middle_m, self.mean, self.weight, self.slope))
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
    measured = np.isfinite(values)
    columns = np.flatnonzero(measured.any(axis=0))
    if not columns.size:
        return None
    length = max(BIN_M, float(np.ptp(places)) / MOST_BINS)
    first = np.floor(places.min() / length)
    number = (np.floor(places / length) - first).astype(np.int64)
    weight = np.zeros((int(number.max()) + 1, len(columns)))
    total, slope = np.zeros(weight.shape), np.zeros((*weight.shape, slopes.shape[-1]))
    seen = measured[:, columns]
    np.add.at(weight, number, seen)
    np.add.at(total, number, np.where(seen, values[:, columns], 0.0))
    np.add.at(slope, number, np.where(seen[..., None], slopes[:, columns], 0.0))
    full = (weight > 0).all(axis=1)
    if not full.any():
        return None
    middle = (first + np.arange(len(weight)) + 0.5) * length
    mean, slope = total[full] / weight[full], slope[full] / weight[full][..., None]
    return TrackBins(middle[full], tuple(OBSERVED[k] for k in columns), mean, weight[full], slope, model[columns])


@dataclass(frozen=True, slots=True, eq=False)
class ChangePoint:
    """The most likely change of the soil.

    Attributes
    ----------
    after_m : where it is, along the way. [m]
    p_value : share of simulated drives over one soil whose largest statistic is as large. [-]
    tried_m : places tried. (k,) [m]
    statistic : how much more two soils explain than one, with the change at each of them. (k,) [-]
    """

    after_m: float
    p_value: float
    tried_m: FloatArray
    statistic: FloatArray


def find_change_point(bins: TrackBins, random: np.random.Generator, simulations: int = SIMULATIONS) -> ChangePoint:
    """The most likely change and its p-value, no smaller than 1 / (simulations + 1).

    Parameters
    ----------
    bins : residuals along the way, in `2 * FEWEST_BINS` pieces or more, and how they follow the soil.
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

    What that costs is in the simulated drives, whose noise does. With m pieces of way and q quantities:

    Attributes
    ----------
    places : pieces after which a change is tried.
    inverse : of the root of the covariance of each quantity's means. (q, m, m)
    whole : whitened derivatives by the soil of the whole way. (q * m, 8)
    before : the same of the way up to each place alone. (places, q * m, 8)
    one, two : inverses of the normal equations of one soil, and of two, with the first laws as a penalty. (8, 8),
        (places, 16, 16)
    """

    def __init__(self, bins: TrackBins, sigma: FloatArray) -> None:
        size, quantities = bins.mean.shape
        self.bins = bins
        self.places = slice(FEWEST_BINS - 1, size - FEWEST_BINS)
        self.inverse = np.linalg.inv(np.stack([_root(bins, k, sigma[k], 0.0) for k in range(quantities)]))
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
        """Residuals of two soils with the change at a place, whose number it is. (m, q)"""
        slope, mean = self.bins.slope, self.bins.mean
        first = np.arange(len(mean)) <= place + self.places.start
        columns = np.concatenate([slope * first[:, None, None], slope * ~first[:, None, None]], axis=-1)
        white = np.concatenate([self.before[place], self.whole - self.before[place]], axis=-1)
        return np.asarray(mean - columns @ (self.two[place] @ (white.T @ self.whitened(mean))))


def _root(bins: TrackBins, quantity: int, sigma: float, autocorrelation: float) -> FloatArray:
    """Root of the covariance of a quantity's means: noise of the values, and errors of the twin itself. (m, m) [-]

    `sigma` and `autocorrelation`, from piece to piece, are of the noise of single values.
    """
    lag = np.abs(bins.middle_m[:, None] - bins.middle_m)
    number = np.rint(lag / max(float(np.min(np.diff(bins.middle_m))), 1e-6))
    scale = sigma / np.sqrt(bins.weight[:, quantity])
    noise = np.outer(scale, scale) * np.where(number > 0, autocorrelation**number, 1.0)
    return np.linalg.cholesky(noise + bins.model[quantity] ** 2 * np.exp(-lag / ALIKE_M))


def _noise(bins: TrackBins, rest: FloatArray, fitted: float) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of one value, no smaller than stated, and autocorrelation from bin to bin. (q,), (q,)

    `fitted` numbers were taken from each series. In n values a mean taken away hides (1 + 3 r) / n of their
    autocorrelation r (Kendall 1954, Biometrika 41, 403), and so, about, does every other number; this and `MARGIN` are
    added. Noise that is alike over all of a series cannot be told from a longer one's.
    """
    size = len(rest)
    white = rest * np.sqrt(bins.weight)
    square = np.maximum((white**2).sum(axis=0), np.finfo(float).tiny)
    lag = (white[1:] * white[:-1]).sum(axis=0) / square
    lag = lag + fitted * (1.0 + 3.0 * np.maximum(lag, 0.0)) / size
    lag = lag + MARGIN * np.sqrt((1.0 - np.minimum(lag**2, 1.0)) / size)
    sigma = np.sqrt(square / max(size - fitted, 0.25 * size))
    return np.maximum(sigma, 1.0), np.clip(lag, 0.0, 1.0 - 1.0 / size)


@dataclass(frozen=True, slots=True, kw_only=True)
class SoilChange:
    """A place of the way from which on the soil is another.

    Attributes
    ----------
    distance_m : along the way of the rover's origin. [m]
    low_m, high_m : interval that holds it at 95 %, if the noise is normal. [m]
    time_s : when the origin passed it. [s]
    x_m, y_m : where that was. [m]
    p_value : share of simulated drives over one soil that look as much like two; 0.001 is the smallest there is. [-]
    steps : of each measured quantity, measured less simulated on the best single soil, after less before, in errors of
        one value. [-]
    """

    distance_m: float
    low_m: float
    high_m: float
    time_s: float
    x_m: float
    y_m: float
    p_value: float
    steps: dict[str, float]

    @property
    def text(self) -> str:
        """In words, such as `the soil changes at 4.9 m of the way (4.7 to 5.0 m): from there on ...`."""
        strong = sorted(self.steps, key=lambda name: -abs(self.steps[name]))
        usual = sum(map(abs, self.steps.values())) / max(len(self.steps), 1)
        named = [name for name in strong if abs(self.steps[name]) >= usual]
        words = ", ".join(f"{name} is {'larger' if self.steps[name] > 0 else 'smaller'}" for name in named)
        place = f"{self.distance_m:.1f} m of the way ({self.low_m:.1f} to {self.high_m:.1f} m)"
        return f"the soil changes at {place}" + (f": from there on {words} than before" if words else "")


def find_change(
    record: DriveRecord,
    update: SoilUpdate,
    *,
    false_alarms: float = FALSE_ALARMS,
    seed: int = 0,
) -> SoilChange | None:
    """The clearest change of the soil along a drive, None where one soil will do.

    Parameters
    ----------
    record : what was measured.
    update : what `assimilate` made of it: its residuals, and the drive on the soil that left them.
    false_alarms : wanted share of drives over one soil in which a change is found, 0.001 to 0.5.
    seed : of the simulated drives.

    A change within 0.8 m of either end is not looked for. Errors of the terrain, too, can look like another soil.
    Raises ParameterError.
    """
    check_range("false_alarms", false_alarms, "[0.001, 0.5]")
    way = traverse_of(update.prediction)
    floor = np.array([MODEL_ERRORS[name] for name in OBSERVED])
    sigma = np.where(np.isfinite(update.residuals), np.hypot(record.sigmas, floor), np.nan)
    measured = np.isfinite(sigma).any(axis=0)
    typical = np.nanmedian(np.where(measured, sigma, 1.0), axis=0)
    model = np.where(measured, MODEL_SHARE * floor / typical, 0.0)
    places = wheel_places(update.prediction.rover, record, way)
    slopes, finer = _drives(record, update)
    widened = np.array([update.inflation.get(name, 1.0) for name in OBSERVED])
    residuals = widened * update.residuals + finer / sigma
    unexplained = -np.clip(residuals, -HUBER, HUBER)
    bins = binned(places, unexplained, slopes / sigma[..., None], model)
    if bins is None or len(bins.middle_m) < 2 * FEWEST_BINS:
        return None
    step = find_change_point(bins, np.random.default_rng(seed))
    return _change(step, way, places, -residuals) if step.p_value <= false_alarms else None


def _drives(record: DriveRecord, update: SoilUpdate) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the simulated values by the soil, in widths of the first laws; and what a finer time step adds.

    In bends a step of 0.2 s puts the side slip off by 0.1 deg, which would look like another soil. (n, 6, 8), (n, 6)
    """
    laws, drive, plan = update.belief.laws, update.prediction, update.prediction.plan
    best = np.array([law.transformed(drive.parameters[name])[0] for name, law in laws.items()])
    nudges = NUDGE * np.diag([law.width for law in laws.values()])[: len(PARAMETERS)]
    samples = update.belief.samples(np.concatenate([best + nudges, best - nudges]))
    # A hair more than the steps that were made: asked for exactly these, rounding might make one more.
    sample_m = min(float(drive.time_s[1]) * plan.speed_m_s * (1 + 1e-9), LONGEST_SAMPLE_M)
    step = min(drive.time_step_s * (1 + 1e-9), LONGEST_STEP_S)
    count, scene, met = len(PARAMETERS), (drive.rover, drive.terrain, plan), bool(drive.ruts.all())
    moved = predict(*scene, samples=samples, time_step_s=step, sample_m=sample_m, ruts=met)
    states = _states(moved, record)
    slopes = (states[:count] - states[count:]) / (2.0 * NUDGE)
    arrived = moved.finished[:count] & moved.finished[count:]
    fine = predict(*scene, samples=drive.parameters, time_step_s=step * FINER, sample_m=sample_m, ruts=met)
    finer = (_states(fine, record) - _states(drive, record))[0] * fine.finished[0]
    return np.moveaxis(np.where(arrived[:, None, None], slopes, 0.0), 0, -1), finer


def _states(drives: Prediction, record: DriveRecord) -> FloatArray:
    """Simulated states at the times of a record. (members, n, 6)"""
    return states_at(record, drives.time_s, drives.states, drives.rover.wheels)


def _change(step: ChangePoint, way: Traverse, places: FloatArray, values: FloatArray) -> SoilChange:
    """A change point on its way, for people; residuals (n, 6), measured less simulated, stood at `places` (n,) [m]."""
    near = step.tried_m[step.statistic >= step.statistic.max() - WITHIN_95]
    half = 0.5 * float(np.diff(step.tried_m).min()) if len(step.tried_m) > 1 else 0.1
    measured = [k for k in range(values.shape[1]) if np.isfinite(values[:, k]).any()]
    inside = (places >= step.tried_m[0] - 1.0) & (places <= step.tried_m[-1] + 1.0)
    before, after = (
        np.nanmedian(values[inside & side][:, measured], axis=0)
        for side in (places < step.after_m, places >= step.after_m)
    )
    x, y = way.place_at(step.after_m)
    return SoilChange(
        distance_m=step.after_m,
        low_m=float(near.min()) - half,
        high_m=float(near.max()) + half,
        time_s=way.time_at(step.after_m),
        x_m=float(x),
        y_m=float(y),
        p_value=step.p_value,
        steps={OBSERVED[k]: float(value) for k, value in zip(measured, after - before, strict=True)},
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segment:
    """A stretch of a drive over one soil.

    Attributes
    ----------
    from_m, to_m : along the way of the rover's origin. [m]
    place_m : places of the origin. (k, 2) [m]
    before : what was believed of the soil there.
    update : what the stretch says; None where it has too little data.
    slips : how many states of it have a slip.
    slip : median slip as measured and on its soil; None where nothing was learned, or by fewer than `FEWEST_VALUES`.
    """

    from_m: float
    to_m: float
    place_m: FloatArray
    before: SoilBelief
    update: SoilUpdate | None
    slips: int = 0
    slip: SlipLean | None = None

    @property
    def learned(self) -> bool:
        """Whether the stretch moved the belief."""
        return self.update is not None and not self.update.refused

    @property
    def belief(self) -> SoilBelief:
        """After the drive."""
        return self.before if self.update is None else self.update.belief

    @property
    def slip_text(self) -> str:
        """Its median slip as measured beside the simulated one, or that it is not judged."""
        if self.slip is not None:
            return self.slip.text
        states = f"{self.slips} state{'' if self.slips == 1 else 's'}"
        return f"{self.from_m:.1f} to {self.to_m:.1f} m: median slip not judged: {states}"

    def to_dict(self) -> dict[str, Any]:
        """For a result."""
        return {
            "from_m": self.from_m,
            "to_m": self.to_m,
            "learned": self.learned,
            "why_not": self.why_not or None,
            "surprise": self.update.prior_shift if self.update else None,
            "slips": self.slips,
            "slip_ratio": self.slip.to_dict() if self.slip else None,
            "parameters": effective_rows(self.belief),
        }

    @property
    def why_not(self) -> str:
        """Why nothing was learned, empty where something was."""
        return "too few values" if self.update is None else self.update.refused


def drive_segments(
    rover: Rover,
    terrain: Terrain,
    plan: Plan,
    record: DriveRecord,
    update: SoilUpdate,
    soil_map: SoilMap,
    *,
    forgotten: float = 0.0,
    particles: int,
    seed: int = 0,
    false_alarms: float = FALSE_ALARMS,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[Segment], list[SoilChange]]:
    """The stretches of a drive that have a soil of their own, what each says of it, and the changes between them.

    Parameters
    ----------
    rover, terrain, plan : what was driven where.
    record, update, false_alarms : as in `find_change`.
    soil_map : what was believed of the soil by place.
    forgotten : share of the way back to the first laws, as in `SoilBelief.forgotten`. [-]
    particles, seed, progress : as in `assimilate`.

    Of a stretch beside others count the states of times at which the whole rover stood in it, and no position: where
    it led depends on the soils before it, and what positions say of speed is in the slip. The twin drives the whole
    plan on each stretch's soil, so that it comes to the stretch some centimetres beside where the rover did.
    """
    way = traverse_of(update.prediction)

    def believed(place_m: FloatArray) -> SoilBelief:
        return soil_map.belief_along(place_m).forgotten(forgotten)

    def learned(states: DriveRecord, low: float, high: float) -> _Part:
        before = believed(way.between(low, high))
        if np.isfinite(states.values).sum() < FEWEST_VALUES:
            return _Part(low, high, states, before, None)
        drive = assimilate(
            *(rover, terrain, plan, states, before),
            particles=particles,
            seed=seed,
            ruts=bool(update.prediction.ruts.all()),
            wheel=False,
            progress=progress,
        )
        return _Part(low, high, states, before, drive)

    open_parts = [_Part(-np.inf, np.inf, record, believed(way.place_m), update)]
    segments: list[Segment] = []
    changes: list[SoilChange] = []
    while open_parts:
        part = open_parts.pop(0)
        change = None
        if part.update is not None and len(changes) + 1 < MOST_SEGMENTS:
            change = find_change(part.record, part.update, false_alarms=false_alarms, seed=seed)
        if change is None:
            segments.append(part.segment(way))
            continue
        changes.append(change)
        before = record_within(part.record, way, -np.inf, change.low_m)
        after = record_within(part.record, way, change.high_m, np.inf)
        open_parts.append(learned(before, part.low_m, change.distance_m))
        open_parts.append(learned(after, change.distance_m, part.high_m))
    return sorted(segments, key=lambda segment: segment.from_m), sorted(changes, key=lambda change: change.distance_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A stretch of a drive in which a change is still to be looked for.

    Attributes
    ----------
    low_m, high_m : along the way of the rover's origin; infinite at the ends of the way. [m]
    record : states of times at which the whole rover stood in it.
    before : what was believed of the soil there.
    update : what the stretch says of it; None where it has too little data.
    """

    low_m: float
    high_m: float
    record: DriveRecord
    before: SoilBelief
    update: SoilUpdate | None

    def segment(self, way: Traverse) -> Segment:
        low, high = max(self.low_m, float(way.distance_m[0])), min(self.high_m, float(way.distance_m[-1]))
        stretch = f"{low:.1f} to {high:.1f} m: "
        return Segment(
            from_m=low,
            to_m=high,
            place_m=way.between(self.low_m, self.high_m),
            before=self.before,
            update=self.update,
            slips=int(np.isfinite(self.record.values[:, OBSERVED.index("slip_ratio")]).sum()),
            slip=None if self.update is None else SlipLean.of(self.record, self.update, stretch, FEWEST_VALUES),
        )


def record_within(record: DriveRecord, way: Traverse, low_m: float, high_m: float) -> DriveRecord:
    """States of the times at which the whole rover stood within a stretch of its way, without positions."""
    distance = way.distance_at(record.time_s)
    inside = (distance - way.reach_m >= low_m) & (distance + way.reach_m <= high_m)
    return replace(
        record,
        time_s=record.time_s[inside],
        wheel=tuple(np.array(record.wheel, dtype=object)[inside]),
        values=record.values[inside],
        sigmas=record.sigmas[inside],
        fix_time_s=np.zeros(0),
        fix_m=np.zeros((0, 2)),
        fix_covariance_m2=np.zeros((0, 2, 2)),
    )
