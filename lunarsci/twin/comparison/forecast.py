"""A prediction as it was before the drive: kept in a folder, read back, and matched to what was measured."""

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray, at_times, samples_about
from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.io.tables import as_csv, table_in
from lunarsci.provenance import sha256
from lunarsci.regolith.physics_discrepancy import SHARED, PhysicsDiscrepancy
from lunarsci.twin.assimilation.residuals import (
    FIX_ERROR_M,
    MODEL_ERRORS,
    OBSERVED,
    DriveRecord,
    check_clock,
    check_wheels,
    states_at,
)
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.plan import Plan, parse_plan, plan_text
from lunarsci.twin.simulation.discrepancy import turn_matrix, way_matrix
from lunarsci.twin.simulation.ensemble import OFFSET_COLUMNS, PATH_COLUMNS, STATE_COLUMNS, DrawnDiscrepancy, Prediction

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = "lunarsci/twin-prediction/1"
FILE = "prediction.json"
TABLES = ("states", "paths")
"""Of the folder, with the states and paths of every drive."""
AGAIN = "predict the drive again with `lunarsci twin predict -o`"
_ALIKE = ("plan", "time_s", "distance_m", "planned", "states", "halted", "recorded", "outcome", "discrepancy")
NEAR = 0.5
"""Of a quantity's mean size, that its mean counts by at least: a mean force near 0 says nothing of shares; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forecast:
    """A prediction without the ground it was made on.

    Attributes
    ----------
    origin : the folder it was read from, or empty.
    rover, rover_sha256 : name of the rover, and of the text that describes it.
    wheels, wheel_radius_m : their names, and their radius. [m]
    terrain, synthetic : name of the terrain, and whether it is synthetic.
    soils : `belief`, `samples`, `sweep` or `one`: what its soils are. Only those of a belief or of samples are draws of
        a law, whose shares are probabilities.
    soil : the soil as the result of the prediction named it; empty in folders of older versions.
    plan, time_s, distance_m, planned, paths, states, halted, recorded, outcome : as of `Prediction`, but x and y of the
        paths are its `places_m`, which hold what the twin's physics is off by.
    discrepancy : that part of them, and of the states; None where there is none.
    gravity_m_s2 : that was driven under; the Moon's in folders of older versions. [m/s2]
    """

    origin: str
    rover: str
    rover_sha256: str
    wheels: tuple[str, ...]
    wheel_radius_m: float
    terrain: str
    synthetic: bool
    soils: str
    plan: Plan
    time_s: FloatArray
    distance_m: FloatArray
    planned: FloatArray
    paths: FloatArray
    states: FloatArray
    halted: BoolArray
    recorded: IntArray
    outcome: IntArray
    soil: Mapping[str, Any] = field(default_factory=dict)
    discrepancy: DrawnDiscrepancy | None = None
    gravity_m_s2: float = LUNAR_GRAVITY.value

    @property
    def members(self) -> int:
        """Number of drives."""
        return len(self.outcome)

    @property
    def finished(self) -> BoolArray:
        """Drives that reached the end of the plan. (members,)"""
        return np.asarray(self.outcome == 0)


def forecast_of(
    prediction: Prediction, *, soils: str = "samples", rover_sha256: str = "", soil: Mapping[str, Any] | None = None
) -> Forecast:
    """A prediction that was just made, as a forecast."""
    rover, terrain, paths = prediction.rover, prediction.terrain, prediction.paths.copy()
    paths[..., :2] = prediction.places_m
    return Forecast(
        origin="",
        rover=rover.name,
        rover_sha256=rover_sha256,
        wheels=rover.wheels,
        wheel_radius_m=rover.wheel.radius_m,
        gravity_m_s2=rover.gravity_m_s2,
        terrain=terrain.name,
        synthetic=terrain.synthetic,
        soils=soils,
        soil=soil or {},
        paths=paths,
        **{name: getattr(prediction, name) for name in _ALIKE},
    )


def forecast_document(forecast: Forecast, tables: Mapping[str, Callable[[], bytes]]) -> dict[str, Any]:
    """What goes into `prediction.json` beside the files of states and paths, whose hashes it holds."""
    return {
        "schema": SCHEMA,
        "rover": {
            "name": forecast.rover,
            "sha256": forecast.rover_sha256,
            "wheels": list(forecast.wheels),
            "wheel_radius_m": forecast.wheel_radius_m,
            "gravity_m_s2": forecast.gravity_m_s2,
        },
        "terrain": {"name": forecast.terrain, "synthetic": forecast.synthetic},
        "soils": forecast.soils,
        "soil": dict(forecast.soil),
        "plan": plan_text(forecast.plan),
        "time_s": forecast.time_s.tolist(),
        "distance_m": forecast.distance_m.tolist(),
        "planned": forecast.planned.tolist(),
        "halted": forecast.halted.tolist(),
        "recorded": forecast.recorded.tolist(),
        "outcome": [OUTCOMES[code] for code in forecast.outcome],
        "discrepancy": None if forecast.discrepancy is None else _discrepancy_document(forecast.discrepancy),
        "tables": {name: sha256(make()) for name, make in tables.items()},
    }


def _discrepancy_document(drawn: DrawnDiscrepancy) -> dict[str, Any]:
    """Without the offsets, which are in the table of paths, and without what the law rests on."""
    law = drawn.law.to_dict() | {"scored": []}
    return {"law": law, "shares": {name: share.tolist() for name, share in drawn.shares.items()}}


def _drawn(document: Any, offsets_m: FloatArray) -> DrawnDiscrepancy:
    members = offsets_m.shape[:1]
    shares = {name: _checked(document["shares"][name], members) for name in document["shares"]}
    return DrawnDiscrepancy(PhysicsDiscrepancy.of(document["law"]), offsets_m, shares)


def read_forecast(folder: str | Path) -> tuple[Forecast, dict[str, str]]:
    """Read the folder that a prediction was written to: the forecast, and the SHA-256 of each file that was read.

    Raises DataError for a folder without `prediction.json`, one of another version, and tables that are missing or not
    as they were written.
    """
    import pandas as pd

    place = Path(folder)
    if not (place / FILE).is_file():
        lacking = "no folder" if place.is_file() else f"no {FILE} in it"
        give = "give the folder of `lunarsci twin predict -o`, or in Python the result of `predict`, which pickle keeps"
        raise DataError(f"{folder}: {lacking}; {give}")
    source = read_input(str(place / FILE))
    document = _document(source)
    files = {name: _table_file(place, name, document) for name in TABLES}
    try:
        tables = (pd.read_csv(io.BytesIO(as_csv(file).data)) for file in files.values())
        result = _forecast(str(folder), document, *tables)
    except (KeyError, TypeError, IndexError, ValueError, ParameterError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{source.name}: not as it was written ({error}); {AGAIN}") from error
    return result, {file.name: file.sha256 for file in (source, *files.values())}


def _document(source: InputFile) -> Any:
    try:
        document = json_document(text(source))
    except json.JSONDecodeError as error:
        raise DataError(f"{source.name}, line {error.lineno}: {error.msg}; is the file complete? {AGAIN}") from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise DataError(f"{source.name}: its schema is {schema}, not {SCHEMA}; {AGAIN}")
    return document


def _table_file(place: Path, kind: str, document: Any) -> InputFile:
    file = read_input(str(table_in(place, kind) or place / f"{kind}.csv"))
    hashes = document.get("tables")
    if not isinstance(hashes, dict) or hashes.get(Path(file.name).name) != file.sha256:
        raise DataError(f"{file.name}: not as it was written with {FILE} (cut off, changed, or of another); {AGAIN}")
    return file


def _forecast(origin: str, document: Any, states: "pd.DataFrame", paths: "pd.DataFrame") -> Forecast:
    rover, times = document["rover"], np.array(document["time_s"], dtype=float)
    wheels = tuple(map(str, rover["wheels"]))
    recorded = np.array(document["recorded"], dtype=np.int64)
    shape = (len(recorded), len(times))
    plan = parse_plan(document["plan"], origin)
    reached = np.arange(len(times)) < recorded[:, None]
    result = document.get("discrepancy")
    return Forecast(
        origin=origin,
        rover=str(rover["name"]),
        rover_sha256=str(rover["sha256"]),
        wheels=wheels,
        wheel_radius_m=float(rover["wheel_radius_m"]),
        gravity_m_s2=float(rover.get("gravity_m_s2", LUNAR_GRAVITY.value)),
        terrain=str(document["terrain"]["name"]),
        synthetic=bool(document["terrain"]["synthetic"]),
        soils=str(document["soils"]),
        soil=dict(document.get("soil") or {}),
        plan=plan,
        time_s=times,
        distance_m=_checked(document["distance_m"], shape[1:]),
        planned=_checked(document["planned"], (shape[1], 3)),
        paths=_spread_out(paths[list(PATH_COLUMNS)].to_numpy(float), reached, (6,)),
        states=_spread_out(states[list(STATE_COLUMNS)].to_numpy(float), reached, (len(wheels), len(STATE_COLUMNS))),
        halted=np.array(document["halted"], dtype=bool),
        recorded=recorded,
        outcome=np.array([OUTCOMES.index(name) for name in document["outcome"]], dtype=np.int64),
        discrepancy=None
        if result is None
        else _drawn(result, _spread_out(paths[list(OFFSET_COLUMNS)].to_numpy(float), reached, (2,))),
    )


def _checked(values: Any, shape: tuple[int, ...]) -> FloatArray:
    result = np.array(values, dtype=float)
    if result.shape != shape:
        raise ParameterError(f"shape {result.shape} where {shape} is wanted")
    return result


def _spread_out(rows: FloatArray, reached: BoolArray, each: tuple[int, ...]) -> FloatArray:
    """Rows in the order of drives and samples, into an array that is NaN beyond what was driven."""
    whole = np.full((*reached.shape, *each), np.nan)
    whole[reached] = rows.reshape(-1, *each)
    return whole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedObservations:
    """A forecast and a record, brought to the same times.

    Attributes
    ----------
    forecast, record : both. Only drives that finished count.
    members : their numbers. (M,)
    predicted : values of the members at the record's times and wheels, columns `OBSERVED`. (M, n, 6)
    sigma : errors of the measured values with those of the model. (n, 6)
    counted : values that compare: measured, after the first second, before the plan ends, not at a halt. (n, 6)
    independent : values that are no second reading of the positions. (n, 6)
    distance_m : commanded distance of each state. (n,) [m]
    places : predicted places at the times of the positions. (M, f, 2) [m]
    place_error_m2 : covariance of the positions with the error of the time step. (f, 2, 2) [m2]
    fix_distance_m, planned : commanded distance and planned place at the positions. (f,), (f, 2) [m]
    """

    forecast: Forecast
    record: DriveRecord
    members: IntArray
    predicted: FloatArray
    sigma: FloatArray
    counted: BoolArray
    independent: BoolArray
    distance_m: FloatArray
    places: FloatArray
    place_error_m2: FloatArray
    fix_distance_m: FloatArray
    planned: FloatArray

    def measured_quantities(self) -> list[str]:
        """Those with a value that compares."""
        return [name for k, name in enumerate(OBSERVED) if self.counted[:, k].any()]


def match_observations(
    forecast: Forecast, record: DriveRecord, independent: BoolArray | None = None
) -> MatchedObservations:
    """Bring them together; values between samples are interpolated in time.

    `independent` (n, 6) is False where a value was derived from the positions that the record also holds. Raises
    ParameterError for wheels that the predicted rover has not, and where nothing compares.
    """
    check_wheels(record, forecast.wheels, f"{forecast.rover}, for which the drive was predicted")
    check_clock(record, float(forecast.time_s[-1]), float(forecast.time_s[1]))
    members = np.flatnonzero(forecast.finished)
    if not members.size:
        raise ParameterError("no predicted drive came to its end, so there is nothing to compare with")
    low, _ = samples_about(forecast.time_s, record.time_s)
    moving = ~(forecast.halted[low] | forecast.halted[low + 1])
    timely = moving & (record.time_s > forecast.time_s[1]) & (record.time_s <= forecast.time_s[-1])
    counted = np.isfinite(record.values) & timely[:, None]
    floor = np.array([MODEL_ERRORS[name] for name in OBSERVED])
    if not counted.any() and not len(record.fix_time_s):
        raise ParameterError("no measured value falls into the time of the predicted drive; compare the clocks")
    courses = np.concatenate([forecast.paths[members][..., :2], forecast.planned[None, :, :2]])
    places = at_times(record.fix_time_s, forecast.time_s, courses, axis=-2)
    return MatchedObservations(
        forecast=forecast,
        record=record,
        members=members,
        predicted=states_at(record, forecast.time_s, forecast.states[members], forecast.wheels),
        sigma=np.where(counted, np.hypot(record.sigmas, floor), np.nan),
        counted=counted,
        independent=np.ones(counted.shape, dtype=bool) if independent is None else independent,
        distance_m=np.interp(record.time_s, forecast.time_s, forecast.distance_m),
        places=places[:-1],
        place_error_m2=record.fix_covariance_m2 + FIX_ERROR_M**2 * np.eye(2),
        fix_distance_m=np.interp(record.fix_time_s, forecast.time_s, forecast.distance_m),
        planned=places[-1],
    )


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


@dataclass(frozen=True, slots=True, eq=False)
class _MissParts:
    """What the miss of the last position is made of.

    Attributes
    ----------
    miss : of the measured place from the mean of the predicted ones. (2,) [m]
    soil, place, turns : covariances by the soils, by the error of the position, and by spot turns. (2, 2) [m2]
    way : covariance for a share along the way of variance 1, see `way_matrix`. (2, 2) [m2]
    last : number of the position in the record.
    """

    miss: FloatArray
    soil: FloatArray
    place: FloatArray
    turns: FloatArray
    way: FloatArray
    last: int


def _miss_parts(matched: MatchedObservations) -> _MissParts | None:
    """None without positions, or with fewer than four drives."""
    times, forecast = matched.record.fix_time_s, matched.forecast
    if not len(times) or len(matched.members) < 4:
        return None
    last = int(times.argmax())
    places, paths = matched.places[:, last], forecast.paths[matched.members].copy()
    if forecast.discrepancy is not None:
        offsets = forecast.discrepancy.offsets_m[matched.members]
        paths[..., :2] -= offsets
        places = places - at_times(times[last : last + 1], forecast.time_s, offsets, axis=-2)[:, 0]
    so_far = slice(0, int(np.searchsorted(forecast.time_s, min(float(times[last]), float(forecast.time_s[-1])))) + 1)
    planned, driven = forecast.planned[so_far], paths[:, so_far]
    return _MissParts(
        miss=matched.record.fix_m[last] - np.median(places, axis=0),
        soil=np.cov(places.T),
        place=matched.place_error_m2[last],
        turns=turn_matrix(forecast.plan, planned, forecast.distance_m[so_far], driven),
        way=way_matrix(planned[:, :2], driven[..., :3]),
        last=last,
    )


def miss_of(matched: MatchedObservations) -> Miss | None:
    """How the last position was missed; None without positions, or with fewer than four drives."""
    result = _miss_parts(matched)
    if result is None:
        return None
    miss, last = result.miss, result.last
    chord = matched.planned[last] - matched.forecast.planned[0, :2]
    ahead = chord / max(float(np.hypot(*chord)), 1e-12)
    along, across = float(miss @ ahead), float(ahead[0] * miss[1] - ahead[1] * miss[0])
    way, law = float(matched.fix_distance_m[last]), matched.forecast.discrepancy
    return Miss(
        way_m=way,
        along_m=along,
        across_m=across,
        along_share=along / max(way, 1e-12),
        across_share=across / max(way, 1e-12),
        soil_m=float(np.sqrt(np.trace(result.soil))),
        position_m=float(np.sqrt(np.trace(result.place))),
        physics_m=0.0 if law is None else float(np.sqrt(np.trace(law.law.covariance_m2(result.way) + result.turns))),
    )


def taught(matched: MatchedObservations, before: PhysicsDiscrepancy) -> PhysicsDiscrepancy:
    """The discrepancy after the drive: the way's shares by the last position, those of wheel states by their means."""
    after, result = before, _miss_parts(matched)
    if result is not None:
        after = after.after_end(result.miss, result.soil + result.place + result.turns, result.way)
    for name in SHARED:
        column = OBSERVED.index(name)
        rows = matched.counted[:, column]
        if rows.any() and len(matched.members) > 3:
            after = _by_mean(matched, name, rows, after)
    return after


def _by_mean(
    matched: MatchedObservations, name: str, rows: BoolArray, before: PhysicsDiscrepancy
) -> PhysicsDiscrepancy:
    column, drawn = OBSERVED.index(name), matched.forecast.discrepancy
    members = matched.predicted[:, rows, column]
    if drawn is not None:
        members = members / np.maximum(1.0 + drawn.shares[name][matched.members], 1e-3)[:, None]
    means = members.mean(axis=1)
    size = float(np.abs(members).mean())
    if size <= 0.0 or abs(float(means.mean())) < NEAR * size:
        return before
    miss = float((matched.record.values[rows, column] - members.mean(axis=0)).mean())
    error = float((matched.sigma[rows, column] ** 2).mean()) / int(rows.sum()) + MODEL_ERRORS[name] ** 2
    return before.after_quantity(name, miss, float(means.var(ddof=1)) + error, abs(float(means.mean())))
