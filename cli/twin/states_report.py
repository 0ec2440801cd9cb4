"""From telemetry and a track to states, and from these to a `Report`."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.csv_table import csv_bytes
from lunarsci.inputs import read_input
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.ground.terrain_files import read_terrain
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, read_drive_inputs
from lunarsci.twin.telemetry.filter import EFFECTS
from lunarsci.twin.telemetry.reading import Findings, read_telemetry
from lunarsci.twin.telemetry.sinkage import RutPoints, is_table_of_ruts, read_track, with_sinkage
from lunarsci.twin.telemetry.states import (
    DriveStates,
    finding_rows,
    motion_table,
    position_table,
    states_of,
    wheel_table,
)

from ..shared.report import Report
from ..shared.table import TextTable

__all__ = ["Sent", "states_report"]

SMOOTHER = "Rauch, Tung & Striebel (1965), AIAA J. 3, 1445, 10.2514/3.3166"
MEASURED = {"slip_ratio": 1.0, "side_slip_deg": 1.0, "sinkage_m": 1e3}


@dataclass(frozen=True, slots=True)
class Sent:
    """What came down of a drive, and what is made of it."""

    scene: DriveInputs
    name: str
    planned: bool
    drive: DriveStates

    @classmethod
    def read(
        cls, telemetry: str, plan: str | None, rover: str | None, terrain: str, interpolation: str, track: str | None
    ) -> "Sent":
        """Read the files and find the states."""
        scene = read_drive_inputs(plan, rover, terrain, interpolation, soil_counts=False)
        source = read_input(telemetry)
        scene.inputs[telemetry] = source.sha256
        findings = Findings(source.name)
        sent = read_telemetry(source, scene.rover, findings)
        drive = states_of(sent, scene.rover, scene.terrain, findings, scene.plan if plan is not None else None)
        if track is not None:
            drive = with_sinkage(drive, _read_track(scene, track, interpolation), scene.terrain)
        return cls(scene, source.name, plan is not None, drive)


def _read_track(scene: DriveInputs, path: str, interpolation: str) -> RutPoints | Terrain:
    source = read_input(path)
    scene.inputs[path] = source.sha256
    if is_table_of_ruts(source):
        return read_track(source)
    return replace(read_terrain(path, read_soil("longji")), interpolation=interpolation)


def states_report(sent: Sent) -> Report:
    """The report of `twin states`; its files are states, positions and motion."""
    drive, scene = sent.drive, sent.scene
    findings = finding_rows(drive)

    def figures() -> Any:
        from lunarsci.twin.figures.telemetry import states_page

        return [states_page(drive, scene.terrain, _title(sent))]

    table = wheel_table(drive)
    return Report(
        schema="twin-states/1",
        result=_result(sent, findings),
        tables=[_wheel_table(sent), *_finding_tables(findings)],
        rows=_plain(table),
        figures=figures,
        inputs=scene.inputs,
        data_tables=scene.tables,
        sources=[*SOURCES, SMOOTHER],
        files={
            "states.csv": lambda: csv_bytes(table),
            "positions.csv": lambda: csv_bytes(position_table(drive)),
            "motion.csv": lambda: csv_bytes(motion_table(drive)),
        },
        untrusted=drive.findings.doubt,
        options=scene.options,
    )


def _title(sent: Sent) -> str:
    mark = " (synthetic)" if sent.drive.telemetry.synthetic else ""
    return f"Wheel states from {sent.name}{mark}, on {sent.scene.terrain.name}"


def _result(sent: Sent, findings: list[dict[str, object]]) -> dict[str, Any]:
    drive = sent.drive
    rows = drive.rows
    return {
        "synthetic": drive.telemetry.synthetic,
        "terrain": {"name": sent.scene.terrain.name, "synthetic": sent.scene.terrain.synthetic},
        "rover": sent.scene.rover.name,
        "made_for": sent.scene.made_for,
        "plan": sent.scene.plan.name if sent.planned else None,
        "states": int(rows.slip_ratio.size),
        "valid": int(rows.valid.sum()),
        "sinkages": int(np.isfinite(rows.sinkage_m).sum()),
        "positions": int(np.isfinite(drive.nodes.fix_m).all(axis=1).sum()),
        "positions_left_out": len(drive.left_out),
        "duration_s": float(drive.telemetry.time_s[-1] - drive.telemetry.time_s[0]),
        "distance_m": float(rows.distance_m[-1]),
        "reduced_chi_square": drive.smoothed.reduced_chi_square,
        "slip_changes": _changes(drive),
        "slope_effects": _slope_effects(drive),
        "findings": findings,
        "wheels": {wheel: _of_wheel(drive, k) for k, wheel in enumerate(drive.rover.wheels)},
        "assumed_of_rover": list(sent.scene.description.assumed),
    }


def _changes(drive: DriveStates) -> dict[str, Any]:
    """How fast the deviations change that slopes do not explain; no information where the data tell nothing of it."""
    change = drive.smoothed.change
    columns = (change.usual, np.exp(change.spread), change.usual_length_m, change.information)
    keys = ("amplitude", "amplitude_factor", "length_m", "information_nat")
    rows = zip(*columns, strict=True)
    return {
        name: dict(zip(keys, map(float, row), strict=True))
        for name, row in zip(("ahead", "left", "turn_per_m"), rows, strict=True)
    }


def _slope_effects(drive: DriveStates) -> dict[str, Any]:
    """Slip and side slip, as a tangent, for slopes of 45 degrees along and across, were they proportional."""
    state, covariance = drive.smoothed.state[-1], drive.smoothed.covariance[-1]
    return {
        name: {"value": float(state[k]), "sigma": float(np.sqrt(covariance[k, k]))}
        for name, k in zip(("slip", "side_slip"), EFFECTS[:2], strict=True)
    }


def _of_wheel(drive: DriveStates, k: int) -> dict[str, Any]:
    """Medians over the valid states of a wheel, of the values and of their errors."""
    found: dict[str, Any] = {"valid": int(drive.rows.valid[:, k].sum())}
    for name in MEASURED:
        value, sigma = (getattr(drive.rows, column)[:, k] for column in (name, f"{name}_sigma"))
        known = drive.rows.valid[:, k] & np.isfinite(value)
        spread = np.percentile(value[known], (50, 5, 95)) if known.any() else np.full(3, np.nan)
        found[name] = {
            "median": float(spread[0]),
            "low": float(spread[1]),
            "high": float(spread[2]),
            "sigma": float(np.median(sigma[known])) if known.any() else np.nan,
            "count": int(known.sum()),
        }
    return found


def _wheel_table(sent: Sent) -> TextTable:
    drive = sent.drive
    rows = []
    for k, wheel in enumerate(drive.rover.wheels):
        found = _of_wheel(drive, k)
        rows.append([wheel, str(found["valid"]), *(_cell(found[name], MEASURED[name]) for name in MEASURED)])
    sway, changes = drive.smoothed, _changes(drive)["ahead"]
    notes = [
        f"{int(np.isfinite(drive.nodes.fix_m).all(axis=1).sum())} positions over "
        f"{drive.telemetry.time_s[-1] - drive.telemetry.time_s[0]:.4g} s; they scatter about the motion with a reduced "
        f"chi-square of {sway.reduced_chi_square:.2f}",
        f"beside what slopes do, slip changes by {changes['amplitude']:.2g} (times or by "
        f"{changes['amplitude_factor']:.2g}) within {changes['length_m']:.2g} m",
    ]
    if not np.isfinite(drive.rows.sinkage_m).any():
        notes.append("no sinkage: give the depth of the track with --track")
    else:
        notes.append("sinkage belongs to the deepest wheel that passed a place; of the others the track says nothing")
    if not sent.planned:
        notes.append("clock and commands were not compared with a plan: none was given")
    if drive.telemetry.synthetic:
        notes.append("the telemetry is synthetic")
    if sent.scene.terrain.synthetic:
        notes.append("the terrain is synthetic")
    headers = ["wheel", "states", "slip [-]", "side slip [deg]", "sinkage [mm]"]
    title = f"{_title(sent)}; median (p05 to p95) ± error of one state"
    return TextTable(headers, rows, title=title, notes=notes)


def _cell(found: dict[str, Any], factor: float) -> str:
    if not found["count"]:
        return "-"
    middle, low, high, sigma = (factor * found[name] for name in ("median", "low", "high", "sigma"))
    return f"{middle:.3g} ({low:.3g} to {high:.3g}) ± {sigma:.2g}"


def _finding_tables(findings: list[dict[str, Any]]) -> list[TextTable]:
    if not findings:
        return [TextTable([], [], title="Nothing wrong was found with the telemetry.")]
    rows = [
        [
            entry["kind"],
            "-" if entry["time_s"] is None else f"{entry['time_s']:.4g}",
            str(entry["count"]),
            entry["what"],
            entry["done"],
        ]
        for entry in findings
    ]
    return [TextTable(["found", "first at [s]", "how many", "what", "done"], rows, title="Found in the telemetry")]


def _plain(table: Any) -> list[dict[str, Any]]:
    return list(table.to_dict("records"))
