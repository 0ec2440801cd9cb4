"""From a scene to a made-up drive, and from this to a `Report`."""

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.csv_table import csv_bytes
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs
from lunarsci.twin.judgement.tables import state_table
from lunarsci.twin.simulation.ensemble import predict
from lunarsci.twin.telemetry.simulated import SensorErrors, SyntheticDrive, simulate_telemetry

from ..shared.report import Report
from ..shared.table import TextTable

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["simulate_report", "simulated"]

REMARK = b"# synthetic: made up by `lunarsci twin simulate`, not a measurement\n"


def simulated(
    scene: DriveInputs,
    errors: SensorErrors,
    seed: int,
    time_step_s: float,
    sample_m: float,
    progress: Callable[[int, int], None],
) -> SyntheticDrive:
    """Drive the scene's plan on its own soil, and blur what is seen of it."""
    prediction = predict(
        scene.rover,
        scene.terrain,
        scene.plan,
        sweep=(),
        time_step_s=time_step_s,
        sample_m=sample_m,
        ruts=scene.ruts,
        before=scene.before,
        progress=progress,
    )
    return simulate_telemetry(prediction, errors, seed)


def simulate_report(scene: DriveInputs, drive: SyntheticDrive) -> Report:
    """The report of `twin simulate`; its files are the telemetry, the track and the truth."""
    prediction = drive.prediction
    errors = {name: value for name, value in asdict(drive.errors).items() if name != "fix_sigma_m"}
    result = {
        "synthetic": True,
        "plan": scene.plan.name,
        "terrain": {"name": scene.terrain.name, "synthetic": scene.terrain.synthetic},
        "rover": scene.rover.name,
        "made_for": scene.made_for,
        "soil": scene.soil_record(),
        "rows": len(drive.telemetry),
        "positions": int(np.isfinite(drive.telemetry["x_m"]).sum()),
        "track_points": len(drive.track),
        "duration_s": float(drive.telemetry["time_s"].iloc[-1]),
        "outcome": prediction.outcome_text(0),
        "errors": errors | {"position_m": drive.errors.position_m},
        "assumed_of_rover": list(scene.description.assumed),
    }
    return Report(
        schema="twin-simulate/1",
        result=result,
        tables=[_table(scene, drive, result)],
        rows=_plain(drive.telemetry),
        inputs=scene.inputs,
        data_tables=scene.tables,
        sources=SOURCES,
        seed=drive.seed,
        files={
            "telemetry.csv": lambda: _marked(drive.telemetry),
            "track.csv": lambda: _marked(drive.track),
            "truth.csv": lambda: _marked(state_table(prediction)),
        },
        untrusted="" if prediction.finished[0] else f"the drive did not reach its end: {prediction.outcome_text(0)}",
        options=scene.options,
    )


def _marked(table: "pd.DataFrame") -> bytes:
    return REMARK + csv_bytes(table)


def _table(scene: DriveInputs, drive: SyntheticDrive, result: dict[str, Any]) -> TextTable:
    errors = drive.errors
    rows = [
        ["localised positions", str(result["positions"]), f"{1e3 * errors.position_m:.3g} mm"],
        ["heading", str(result["rows"]), f"{errors.yaw_deg:.3g} deg"],
        ["roll, pitch", str(result["rows"]), f"{errors.tilt_deg:.3g} deg"],
        ["wheel angles", str(result["rows"]), f"{errors.wheel_angle_deg:.3g} deg"],
        ["wheel rates", str(result["rows"]), f"{errors.wheel_rate_deg_s:.3g} deg/s"],
        ["wheel steering", str(result["rows"]), f"{errors.steered_deg:.3g} deg"],
        ["depth of the track", str(result["track_points"]), f"{1e3 * errors.track_m:.3g} mm"],
    ]
    notes = [
        "Synthetic: made up, not a measurement. The track is as deep as the deepest wheel that passed.",
        "Errors of positions and track follow Ding et al. (2024); the others are assumed.",
    ]
    title = f"Telemetry of a made-up drive: {scene.plan.name}, {result['duration_s']:.4g} s on {scene.terrain.name}"
    return TextTable(["measured", "values", "standard error"], rows, title=title, notes=notes)


def _plain(table: Any) -> list[dict[str, Any]]:
    return list(table.to_dict("records"))
