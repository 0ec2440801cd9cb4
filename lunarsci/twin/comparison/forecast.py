"""A prediction as it was before the drive: kept in a folder, and read back."""

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.provenance import sha256
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.plan import Plan, parse_plan
from lunarsci.twin.plans.plan_files import plan_text
from lunarsci.twin.simulation.ensemble import OFFSET_COLUMNS, PATH_COLUMNS, STATE_COLUMNS, DrawnDiscrepancy, Prediction

if TYPE_CHECKING:
    import pandas as pd


SCHEMA = "lunarsci/twin-prediction/1"
FILE = "prediction.json"
TABLES = ("states.csv", "paths.csv")
"""Of the folder, with the states and paths of every drive."""
AGAIN = "predict the drive again with `lunarsci twin predict -o`"


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


_ALIKE = ("plan", "time_s", "distance_m", "planned", "states", "halted", "recorded", "outcome", "discrepancy")


def forecast_document(forecast: Forecast, tables: Mapping[str, Callable[[], bytes]]) -> dict[str, Any]:
    """What goes into `prediction.json` beside the tables of states and paths, whose hashes it holds."""
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
        "tables": {name: sha256(tables[name]()) for name in TABLES},
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
    place = Path(folder)
    if not (place / FILE).is_file():
        raise DataError(f"{folder}: no {FILE} in it; name a folder of `lunarsci twin predict -o`")
    source = read_input(str(place / FILE))
    document = _document(source)
    files = {name: _table_file(place, name, document) for name in TABLES}
    try:
        found = _forecast(str(folder), document, *(_frame(files[name]) for name in TABLES))
    except (KeyError, TypeError, IndexError, ValueError, ParameterError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{source.name}: not as it was written ({error}); {AGAIN}") from error
    return found, {file.name: file.sha256 for file in (source, *files.values())}


def _document(source: InputFile) -> Any:
    try:
        document = json_document(text(source))
    except json.JSONDecodeError as error:
        raise DataError(f"{source.name}, line {error.lineno}: {error.msg}; is the file complete? {AGAIN}") from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise DataError(f"{source.name}: its schema is {schema}, not {SCHEMA}; {AGAIN}")
    return document


def _table_file(place: Path, name: str, document: Any) -> InputFile:
    file = read_input(str(place / name))
    tables = document.get("tables")
    if not isinstance(tables, dict) or tables.get(name) != file.sha256:
        raise DataError(f"{file.name}: not as it was written with {FILE} (cut off, changed, or of another); {AGAIN}")
    return file


def _frame(file: InputFile) -> "pd.DataFrame":

    import pandas as pd

    return pd.read_csv(io.BytesIO(file.data))


def _forecast(origin: str, document: Any, states: "pd.DataFrame", paths: "pd.DataFrame") -> Forecast:
    rover, times = document["rover"], np.array(document["time_s"], dtype=float)
    wheels = tuple(map(str, rover["wheels"]))
    recorded = np.array(document["recorded"], dtype=np.int64)
    shape = (len(recorded), len(times))
    plan = parse_plan(document["plan"], origin)
    reached = np.arange(len(times)) < recorded[:, None]
    found = document.get("discrepancy")
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
        if found is None
        else _drawn(found, _spread_out(paths[list(OFFSET_COLUMNS)].to_numpy(float), reached, (2,))),
    )


def _checked(values: Any, shape: tuple[int, ...]) -> FloatArray:
    found = np.array(values, dtype=float)
    if found.shape != shape:
        raise ParameterError(f"shape {found.shape} where {shape} is wanted")
    return found


def _spread_out(rows: FloatArray, reached: BoolArray, each: tuple[int, ...]) -> FloatArray:
    """Rows in the order of drives and samples, into an array that is NaN beyond what was driven."""
    whole = np.full((*reached.shape, *each), np.nan)
    whole[reached] = rows.reshape(-1, *each)
    return whole
