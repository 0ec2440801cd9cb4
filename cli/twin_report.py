"""From files to a scene, and from a predicted drive to a `Report`."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from lunarsci.inputs import read_input
from lunarsci.provenance import sha256
from lunarsci.regolith.soil import read_soil, soil_hash
from lunarsci.rovers.description import RoverDescription, read_rover
from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.longji import synthetic_longji
from lunarsci.twin.plan import Plan, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.safety import Verdict, judge
from lunarsci.twin.sensitivity import EndpointSensitivity, endpoint_sensitivity, step_error_m
from lunarsci.twin.tables import endpoint_table, path_table, state_table
from lunarsci.twin.terrain import Terrain
from lunarsci.twin.terrain_files import read_terrain

from .report import Report
from .table import TextTable

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Scene", "csv_bytes", "predict_report", "read_scene", "verdict_tables"]

SYNTHETIC = "synthetic-longji"
SOURCES = [
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
    "Janosi & Hanamoto (1961), Proc. 1st Int. Conf. Mechanics of Soil-Vehicle Systems, Turin, 707",
]


@dataclass(frozen=True, slots=True)
class Scene:
    """What drives where: the parsed inputs of a prediction and their hashes."""

    rover: Rover
    description: RoverDescription
    terrain: Terrain
    plan: Plan
    inputs: dict[str, str]
    tables: dict[str, str]


def read_scene(plan: str | None, rover: str, terrain: str, soil: str) -> Scene:
    """Read plan, rover, terrain and soil."""
    description = read_rover(rover)
    ground = read_soil(soil)
    inputs, tables = soil_hash(soil)
    for path in (plan, None if terrain == SYNTHETIC else terrain):
        if path is not None:
            inputs[path] = read_input(path).sha256
    return Scene(
        build_rover(description),
        description,
        synthetic_longji(ground) if terrain == SYNTHETIC else read_terrain(terrain, ground),
        read_plan(plan),
        inputs,
        tables | {f"{rover} (rover)": sha256(description.text.encode())},
    )


def predict_report(scene: Scene, prediction: Prediction) -> Report:
    """The report of `twin predict`."""
    verdict = judge(prediction, scene.plan)
    shares, step_error = endpoint_sensitivity(prediction), step_error_m(prediction)

    def figures() -> Any:
        from lunarsci.twin.figure import path_fan

        return [path_fan(prediction, verdict)]

    return Report(
        schema="twin-predict/1",
        result=_result(scene, prediction, verdict)
        | {"sensitivity": [asdict(share) for share in shares], "step_error_m": step_error},
        tables=[*verdict_tables(scene, prediction, verdict), *_sensitivity_tables(shares, step_error)],
        rows=[asdict(limit) for limit in verdict.limits],
        figures=figures,
        inputs=scene.inputs,
        data_tables=scene.tables,
        sources=SOURCES,
        seed=prediction.seed,
        files={
            "states.csv": lambda: csv_bytes(state_table(prediction)),
            "paths.csv": lambda: csv_bytes(path_table(prediction)),
            "endpoints.csv": lambda: csv_bytes(endpoint_table(prediction)),
        },
        untrusted="" if verdict.verdict == "go" else f"no-go: {'; '.join(verdict.reasons)}",
    )


def _result(scene: Scene, prediction: Prediction, verdict: Verdict) -> dict[str, Any]:
    return asdict(verdict) | {
        "members": prediction.members,
        "path_length_m": scene.plan.length_m,
        "time_step_s": prediction.time_step_s,
        "plan": scene.plan.name,
        "terrain": {"name": scene.terrain.name, "synthetic": scene.terrain.synthetic},
        "sweep": {name: {"low": values.min(), "high": values.max()} for name, values in prediction.parameters.items()},
        "assumed_of_rover": list(scene.description.assumed),
    }


def verdict_tables(scene: Scene, prediction: Prediction, verdict: Verdict) -> list[TextTable]:
    """The verdict for people: head line, limits, notes."""
    rows = [
        [
            limit.quantity,
            *(f"{value:.4g}" for value in (limit.p50, limit.p95, limit.max, limit.limit, limit.margin)),
            limit.unit,
            "ok" if limit.ok else "exceeded",
            "assumed" if limit.assumed else "",
        ]
        for limit in verdict.limits
    ]
    headers = [
        "quantity (largest of each drive)",
        "p50",
        "p95",
        "max",
        "limit",
        "margin",
        "unit",
        "verdict",
        "limit is",
    ]
    title = f"{verdict.verdict.upper()}: {scene.plan.name}; {prediction.members} drives on {scene.terrain.name}"
    return [TextTable(headers, rows, title=title, notes=[*_endpoint_notes(verdict), *verdict.reasons, *verdict.notes])]


def _sensitivity_tables(shares: list[EndpointSensitivity], step_error: float | None) -> list[TextTable]:
    rows = [[share.parameter, f"{share.x_m:.3f}", f"{share.y_m:.3f}", f"{100 * share.share:.0f} %"] for share in shares]
    notes = [] if step_error is None else [f"the time step puts ends off by about {1e3 * step_error:.1f} mm"]
    if not rows:
        return [TextTable([], [], title=notes[0])] if notes else []
    headers = ["over the range of", "x [m]", "y [m]", "of the variance"]
    return [TextTable(headers, rows, title="What moves the end", notes=notes)]


def _endpoint_notes(verdict: Verdict) -> list[str]:
    end = verdict.endpoint
    if end is None:
        return []
    return [
        f"ends: mean {end.bias_m:.3f} m from the destination, all within {end.covering_radius_m:.3f} m of it, "
        f"within {end.scatter_radius_m:.3f} m of each other's middle"
    ]


def csv_bytes(table: "pd.DataFrame") -> bytes:
    """A table as CSV, nine significant digits."""
    text: str = table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return text.encode()
