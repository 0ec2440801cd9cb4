"""Zones of one soil along a drive: where it changes, and what each part of the drive says of its own soil.

A drive in which a change is found is cut in two, the soil of each part is found, and each part is searched in turn
(binary segmentation: Vostrikova 1981, Soviet Math. Dokl. 24, 55), as long as there are changes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief, effective_rows
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.assimilation.change_point import (
    FEWEST_BINS,
    ChangePoint,
    Traverse,
    binned,
    find_change_point,
    traverse_of,
    wheel_places,
)
from lunarsci.twin.assimilation.drive_record import OBSERVED, DriveRecord, states_at
from lunarsci.twin.assimilation.residuals import MODEL_ERRORS
from lunarsci.twin.assimilation.update import SlipLean, SoilUpdate, assimilate
from lunarsci.twin.ground.soil_map import SoilMap
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import LONGEST_SAMPLE_M, LONGEST_STEP_S, Prediction, predict

NUDGE = 0.1
"""Widths of the first laws by which soils are moved for derivatives; assumed."""
LARGEST = 4.0
"""Residuals count as no larger, so that a stone or a slip of a sensor makes no change; assumed."""
WITHIN_95 = 7.35
"""Fall of the statistic from its top within which the place lies, at 95 %: Hansen (2000), Econometrica 68, 575,
10.1111/1468-0262.00124."""
FALSE_ALARMS = 0.01
"""Wanted share of drives over one soil in which a change is found; 0.05 at most where the twin is off by its errors;
assumed."""
MODEL_SHARE = 2.0
"""Of `MODEL_ERRORS`, which are those of single values, by which the twin may be off over metres of way; assumed, and
enough for what is left of the time step's errors."""
FINER = 0.25
"""Of the time step."""
MOST_SEGMENTS = 16
FEWEST_VALUES = 2 * len(PARAMETERS)
"""Of a stretch, assumed; with fewer it stays as it was believed to be."""
LEAST_SLIPS = 2 * len(PARAMETERS)
"""Of a stretch whose median slip is judged, as many as `FEWEST_VALUES` of which its soil is learned; assumed."""
TOLD = 1.0
"""Steps of a measured quantity that are named, in its errors; assumed."""


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
        named = [name for name in strong if abs(self.steps[name]) >= TOLD]
        words = ", ".join(f"{name} is {'larger' if self.steps[name] > 0 else 'smaller'}" for name in named)
        place = f"{self.distance_m:.1f} m of the way ({self.low_m:.1f} to {self.high_m:.1f} m)"
        return f"the soil changes at {place}" + (f": from there on {words} than before" if words else "")


def find_change(
    record: DriveRecord,
    found: SoilUpdate,
    *,
    false_alarms: float = FALSE_ALARMS,
    seed: int = 0,
) -> SoilChange | None:
    """The clearest change of the soil along a drive, None where one soil will do.

    Parameters
    ----------
    record : what was measured.
    found : what `assimilate` made of it: its residuals, and the drive on the soil that left them.
    false_alarms : wanted share of drives over one soil in which a change is found, 0.001 to 0.5.
    seed : of the simulated drives.

    A change within 0.8 m of either end is not looked for. Errors of the terrain, too, can look like another soil.
    Raises ParameterError.
    """
    if not 0.001 <= false_alarms <= 0.5:
        raise ParameterError(f"the share of false alarms is {false_alarms:g}; give 0.001 to 0.5")
    way = traverse_of(found.prediction)
    floor = np.array([MODEL_ERRORS[name] for name in OBSERVED])
    sigma = np.where(np.isfinite(found.residuals), np.hypot(record.sigmas, floor), np.nan)
    known = np.isfinite(sigma).any(axis=0)
    typical = np.nanmedian(np.where(known, sigma, 1.0), axis=0)
    model = np.where(known, MODEL_SHARE * floor / typical, 0.0)
    places = wheel_places(found.prediction.rover, record, way)
    slopes, finer = _drives(record, found)
    widened = np.array([found.inflation.get(name, 1.0) for name in OBSERVED])
    residuals = widened * found.residuals + finer / sigma
    unexplained = -np.clip(residuals, -LARGEST, LARGEST)
    bins = binned(places, unexplained, slopes / sigma[..., None], model)
    if bins is None or len(bins.middle_m) < 2 * FEWEST_BINS:
        return None
    step = find_change_point(bins, np.random.default_rng(seed))
    return _change(step, way, places, -residuals) if step.p_value <= false_alarms else None


def _drives(record: DriveRecord, found: SoilUpdate) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the simulated values by the soil, in widths of the first laws; and what a finer time step adds.

    In bends a step of 0.2 s puts the side slip off by 0.1 deg, which would look like another soil. (n, 6, 8), (n, 6)
    """
    laws, drive, plan = found.belief.laws, found.prediction, found.prediction.plan
    best = np.array([law.transformed(drive.parameters[name])[0] for name, law in laws.items()])
    nudges = NUDGE * np.diag([law.width for law in laws.values()])[: len(PARAMETERS)]
    samples = found.belief.samples(np.concatenate([best + nudges, best - nudges]))
    sample_m = min(float(drive.time_s[1]) * plan.speed_m_s * (1 + 1e-9), LONGEST_SAMPLE_M)
    step = min(drive.time_step_s * (1 + 1e-9), LONGEST_STEP_S)
    count, scene = len(PARAMETERS), (drive.rover, drive.terrain, plan)
    moved = predict(*scene, samples=samples, time_step_s=step, sample_m=sample_m, ruts=drive.ruts)
    states = _states(moved, record)
    slopes = (states[:count] - states[count:]) / (2.0 * NUDGE)
    arrived = moved.finished[:count] & moved.finished[count:]
    fine = predict(*scene, samples=drive.parameters, time_step_s=step * FINER, sample_m=sample_m, ruts=drive.ruts)
    finer = (_states(fine, record) - _states(drive, record))[0] * fine.finished[0]
    return np.moveaxis(np.where(arrived[:, None, None], slopes, 0.0), 0, -1), finer


def _states(drives: Prediction, record: DriveRecord) -> FloatArray:
    return states_at(record, drives.time_s, drives.states, drives.rover.wheels)


def _change(step: ChangePoint, way: Traverse, places: FloatArray, values: FloatArray) -> SoilChange:
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
    found : what the stretch says; None where it has too little data.
    slips : how many states of it have a slip.
    slip : median slip as measured and on its soil; None where nothing was learned, or by fewer than `LEAST_SLIPS`.
    """

    from_m: float
    to_m: float
    place_m: FloatArray
    before: SoilBelief
    found: SoilUpdate | None
    slips: int = 0
    slip: SlipLean | None = None

    @property
    def learned(self) -> bool:
        """Whether the stretch moved the belief."""
        return self.found is not None and not self.found.refused

    @property
    def belief(self) -> SoilBelief:
        """After the drive."""
        return self.before if self.found is None else self.found.belief

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
            "surprise": self.found.prior_shift if self.found else None,
            "slips": self.slips,
            "slip_ratio": self.slip.to_dict() if self.slip else None,
            "parameters": effective_rows(self.belief),
        }

    @property
    def why_not(self) -> str:
        """Why nothing was learned, empty where something was."""
        return "too few values" if self.found is None else self.found.refused


def drive_segments(
    rover: Rover,
    terrain: Terrain,
    plan: Plan,
    record: DriveRecord,
    found: SoilUpdate,
    soil_map: SoilMap,
    *,
    forget: float = 0.0,
    particles: int,
    seed: int = 0,
    false_alarms: float = FALSE_ALARMS,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[Segment], list[SoilChange]]:
    """The stretches of a drive that have a soil of their own, what each says of it, and the changes between them.

    Parameters
    ----------
    rover, terrain, plan : what was driven where.
    record, found, false_alarms : as in `find_change`.
    soil_map : what was believed of the soil by place.
    forget : share of the way back to the first laws, as in `SoilBelief.forgotten`. [-]
    particles, seed, progress : as in `assimilate`.

    Of a stretch beside others count the states of times at which the whole rover stood in it, and no position: where
    it led depends on the soils before it, and what positions say of speed is in the slip. The twin drives the whole
    plan on each stretch's soil, so that it comes to the stretch some centimetres beside where the rover did.
    """
    way = traverse_of(found.prediction)

    def believed(place_m: FloatArray) -> SoilBelief:
        return soil_map.belief_along(place_m).inflated(forget)

    def learned(own: DriveRecord, low: float, high: float) -> _Part:
        before = believed(way.between(low, high))
        if np.isfinite(own.values).sum() < FEWEST_VALUES:
            return _Part(low, high, own, before, None)
        drive = assimilate(
            *(rover, terrain, plan, own, before),
            particles=particles,
            seed=seed,
            ruts=found.prediction.ruts,
            wheel=False,
            progress=progress,
        )
        return _Part(low, high, own, before, drive)

    open_parts = [_Part(-np.inf, np.inf, record, believed(way.place_m), found)]
    segments: list[Segment] = []
    changes: list[SoilChange] = []
    while open_parts:
        part = open_parts.pop(0)
        change = None
        if part.found is not None and len(changes) + 1 < MOST_SEGMENTS:
            change = find_change(part.record, part.found, false_alarms=false_alarms, seed=seed)
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
    """A stretch that may still change: from where to where, its states, what was believed, and what it says."""

    low_m: float
    high_m: float
    record: DriveRecord
    before: SoilBelief
    found: SoilUpdate | None

    def segment(self, way: Traverse) -> Segment:
        low, high = max(self.low_m, float(way.distance_m[0])), min(self.high_m, float(way.distance_m[-1]))
        stretch = f"{low:.1f} to {high:.1f} m: "
        return Segment(
            from_m=low,
            to_m=high,
            place_m=way.between(self.low_m, self.high_m),
            before=self.before,
            found=self.found,
            slips=int(np.isfinite(self.record.values[:, OBSERVED.index("slip_ratio")]).sum()),
            slip=None if self.found is None else SlipLean.of(self.record, self.found, stretch, LEAST_SLIPS),
        )


def record_within(record: DriveRecord, way: Traverse, low_m: float, high_m: float) -> DriveRecord:
    """States of the times at which the whole rover stood within a stretch of its way, without positions."""
    distance = way.distance_at(record.time_s)
    kept = (distance - way.reach_m >= low_m) & (distance + way.reach_m <= high_m)
    return replace(
        record,
        time_s=record.time_s[kept],
        wheel=tuple(np.array(record.wheel, dtype=object)[kept]),
        values=record.values[kept],
        sigmas=record.sigmas[kept],
        fix_time_s=np.zeros(0),
        fix_m=np.zeros((0, 2)),
        fix_covariance_m2=np.zeros((0, 2, 2)),
    )
