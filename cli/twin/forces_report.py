"""From wheel forces along a drive to a `Report`."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from lunarsci.inputs import read_input
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs
from lunarsci.twin.judgement.load_check import Spread, WheelLoads, wheel_loads
from lunarsci.twin.judgement.tables import held_table, state_table
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads, prescribed_loads
from lunarsci.twin.outcomes import FINISHED, OUTCOMES
from lunarsci.twin.plans.motion import read_motion
from lunarsci.twin.simulation.ensemble import Prediction

from ..shared.report import Report
from ..shared.table import TextTable

__all__ = ["held_report", "predicted_report"]

SCHEMA = "twin-forces/1"
LARGEST_MISSING = 0.05
"""Share of the weight: what is missing beyond it says that the soil or the motion is not as given."""
COLUMNS = {
    "normal_force_n": ("F_N [N]", 1.0),
    "drawbar_pull_n": ("F_DP [N]", 1.0),
    "lateral_force_n": ("F_L [N]", 1.0),
    "resistance_torque_nm": ("M_R [N m]", 1.0),
    "sinkage_m": ("sinkage [mm]", 1e3),
    "slip_ratio": ("slip [-]", 1.0),
    "side_slip_deg": ("side slip [deg]", 1.0),
}


def predicted_report(scene: DriveInputs, prediction: Prediction, soil: dict[str, Any], seed: int | None) -> Report:
    """Forces along a predicted drive, on a `soil` as the result names it; those of all members count alike."""
    states = np.where(prediction.reached[..., None, None], prediction.states, np.nan)
    loads = wheel_loads(prediction.rover.wheels, states)
    notes = scene.soil_notes(prediction.members, len(prediction.parameters))
    failed = sorted({prediction.outcome_text(int(m)) for m in np.flatnonzero(~prediction.finished)})
    drives = "1 drive" if prediction.members == 1 else f"{prediction.members} drives"
    title = f"Wheel forces of {drives}: {scene.plan.name}, on {scene.terrain.name}"

    def figures() -> Any:
        from lunarsci.twin.figures.wheel_states import force_figure
        from lunarsci.twin.judgement.quantities import abscissa

        return [force_figure(prediction.rover.wheels, abscissa(prediction), states, title)]

    return Report(
        schema=SCHEMA,
        result=_common(scene, loads)
        | {
            "of": "prediction",
            "members": prediction.members,
            "missing": None,
            "soil": soil,
        },
        tables=_tables(title, loads, [*notes, *_notes(scene, failed)]),
        rows=_rows(state_table(prediction)),
        figures=figures,
        inputs=scene.inputs,
        data_tables=scene.tables,
        sources=SOURCES,
        seed=seed,
        untrusted=f"not driven to the end: {'; '.join(failed)}" if failed else "",
        options=scene.options,
    )


def held_report(scene: DriveInputs, path: str, member: int | None, *, planned: bool) -> Report:
    """Forces along a motion that is given."""
    source = read_input(path)
    scene.inputs[path] = source.sha256
    motion = read_motion(source, scene.rover, scene.plan if planned else None, member)
    found = prescribed_loads(scene.rover, scene.terrain, motion)
    loads = wheel_loads(scene.rover.wheels, found.states)
    title = f"Wheel forces along {path}, {len(motion.time_s)} poses on {scene.terrain.name}"
    failed = sorted({OUTCOMES[int(code)] for code in found.outcome if code != FINISHED})
    missing = {} if not loads else _missing(found)
    notes = _notes(scene, failed)
    if missing:
        notes.insert(0, _missing_note(missing))

    def figures() -> Any:
        from lunarsci.twin.figures.wheel_states import force_figure

        axis = (motion.time_s, "Time [s]")
        return [force_figure(scene.rover.wheels, axis, found.states, title, found.residual_n)]

    return Report(
        schema=SCHEMA,
        result=_common(scene, loads)
        | {"of": "motion", "members": 1, "missing": missing or None, "soil": scene.soil_record()},
        tables=_tables(title, loads, notes),
        rows=_rows(held_table(found)),
        figures=figures,
        inputs=scene.inputs,
        data_tables=scene.tables,
        sources=SOURCES,
        untrusted=_doubt(missing, failed),
        options=scene.options,
    )


def _common(scene: DriveInputs, loads: Sequence[WheelLoads]) -> dict[str, Any]:
    return {
        "terrain": {"name": scene.terrain.name, "synthetic": scene.terrain.synthetic},
        "rover": scene.rover.name,
        "made_for": scene.made_for,
        "weight_n": scene.rover.mass_kg * scene.rover.gravity_m_s2,
        "assumed_of_rover": list(scene.description.assumed),
        "wheels": [
            {"wheel": load.wheel, "valid_share": load.valid_share}
            | {name: asdict(spread) for name, spread in load.quantities.items()}
            for load in loads
        ],
    }


def _missing(found: PrescribedLoads) -> dict[str, float]:
    known = found.outcome == FINISHED
    ahead, left = found.residual_n[known].mean(axis=0)
    return {
        "rms_share_of_weight": found.residual_share,
        "mean_ahead_n": float(ahead),
        "mean_left_n": float(left),
        "rms_moment_nm": float(np.sqrt((found.residual_nm[known] ** 2).mean())),
    }


def _missing_note(missing: dict[str, float]) -> str:
    return (
        f"the motion needs {missing['mean_ahead_n']:.2f} N ahead and {missing['mean_left_n']:.2f} N to the left that "
        f"the wheels do not supply in the mean, {100 * missing['rms_share_of_weight']:.1f} % of the weight in rms"
    )


def _doubt(missing: dict[str, float], failed: Sequence[str]) -> str:
    if failed:
        return f"poses without equilibrium: {'; '.join(failed)}"
    if missing and missing["rms_share_of_weight"] > LARGEST_MISSING:
        share = 100 * missing["rms_share_of_weight"]
        return (
            f"the wheels' forces leave {share:.0f} % of the weight unexplained: the soil, the terrain or the motion is "
            "not as given"
        )
    return ""


def _notes(scene: DriveInputs, failed: Sequence[str]) -> list[str]:
    notes = [*failed, *scene.remarks]
    if scene.terrain.synthetic:
        notes.append("the terrain is synthetic")
    return notes


def _tables(title: str, loads: Sequence[WheelLoads], notes: Sequence[str]) -> list[TextTable]:
    names = list(COLUMNS)
    heading = f"{title}; median (p05 to p95) along the drive"
    return [_table(heading, loads, names[:4], ()), _table("", loads, names[4:], notes)]


def _table(title: str, loads: Sequence[WheelLoads], names: Sequence[str], notes: Sequence[str]) -> TextTable:
    rows = [[load.wheel, *(_spread(load.quantities[name], COLUMNS[name][1]) for name in names)] for load in loads]
    return TextTable(["wheel", *(COLUMNS[name][0] for name in names)], rows, title=title, notes=list(notes))


def _spread(spread: Spread, factor: float) -> str:
    low, middle, high = (factor * value for value in (spread.p05, spread.p50, spread.p95))
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def _rows(table: Any) -> list[dict[str, Any]]:
    return list(table.to_dict("records"))
