"""Forces along a measured motion, both uncertain: from files to a `Report`."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

from lunarsci.csv_table import csv_bytes
from lunarsci.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief
from lunarsci.regolith.prior import PARAMETERS, prior_hash
from lunarsci.twin.ground.driven_soil import DrivenSoil, soil_record
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs
from lunarsci.twin.judgement.load_check import force_table
from lunarsci.twin.loads.alternating import AlternatingEstimate, alternate
from lunarsci.twin.loads.load_ensemble import BALANCE_ERROR, DRAWS, draw_loads
from lunarsci.twin.loads.pose_states import PoseStates, read_pose_states
from lunarsci.twin.plans.motion import CORRELATION_M, Motion, correlation_of, read_motion

from ..shared.report import Report
from .motion_tables import doubt_of, motion_result, motion_tables

__all__ = ["Told", "motion_report"]

METHODS = [
    "Kalman (1960), J. Basic Eng. 82, 35, 10.1115/1.3662552",
    "Rahimi & Recht (2007), NIPS 20, 1177",
]


@dataclass(frozen=True, slots=True)
class Told:
    """The options of this mode, as given."""

    motion: str
    member: int | None
    states: str | None
    belief: str | None
    draws: int | None
    correlation_m: float | None
    balance_error: float | None
    iterate: int | None
    save: Path | None
    seed: int

    def check(self) -> None:
        """Options that would do nothing."""
        if self.iterate is not None and self.states is None:
            raise typer.BadParameter("--iterate learns from measured sinkages and slips; give --states")
        if self.save is not None and self.iterate is None:
            raise typer.BadParameter("--save takes the soil of --iterate; give that, or leave it out")


@dataclass(frozen=True, slots=True)
class MotionInputs:
    """What was read."""

    motion: Motion
    states: PoseStates | None
    belief: SoilBelief
    correlation_m: float
    basis: str


def motion_report(scene: DriveInputs, told: Told, progress: Callable[[int, int], None], *, planned: bool) -> Report:
    """The report of `twin forces --motion` with drawn soils and motions."""
    known = _read(scene, told, planned=planned)
    options: dict[str, Any] = {
        "correlation_m": known.correlation_m,
        "balance_error": BALANCE_ERROR if told.balance_error is None else told.balance_error,
        "seed": told.seed,
        "progress": progress,
    }
    draws, turned = told.draws or DRAWS, None
    if told.iterate is not None and known.states is not None:
        sites = (scene.rover, scene.terrain, known.motion, known.states, known.belief)
        turned = alternate(*sites, rounds=told.iterate, draws=draws, **options)
        found = turned.forces
    else:
        middle = {name: value for name, (value, _, _) in known.belief.intervals().items()}
        soils = known.belief.draws(draws, told.seed)
        found = draw_loads(scene.rover, scene.terrain, known.motion, soils, middle, **options)
    table = force_table(found, known.states)
    poses = f"{int(found.known.sum())} of {len(found.known)} poses"
    title = f"Wheel forces along {told.motion}, {poses}, on {scene.terrain.name}"

    def figures() -> Any:
        from lunarsci.twin.figures.wheel_states import force_band_figure

        return [force_band_figure(found, title)]

    return Report(
        schema="twin-forces/1",
        result=motion_result(scene, found, turned, draws, options, known.basis, known.motion.sigmas is not None)
        | {"soil": soil_record(_soil_of(told), scene.terrain, PARAMETERS)},
        tables=motion_tables(scene, found, turned, title, _notes(known, told, scene)),
        rows=list(table.to_dict("records")),  # type: ignore[arg-type]
        figures=figures,
        inputs=scene.inputs,
        data_tables=scene.tables | ({} if told.belief else prior_hash()),
        sources=[*SOURCES, *METHODS],
        seed=told.seed,
        files={"forces.csv": lambda: csv_bytes(table)},
        extras=_saved(scene, told, turned),
        untrusted=doubt_of(found, turned),
        options=scene.options,
    )


def _read(scene: DriveInputs, told: Told, *, planned: bool) -> MotionInputs:
    files = {path: read_input(path) for path in (told.motion, told.states, told.belief) if path is not None}
    scene.inputs.update({path: file.sha256 for path, file in files.items()})
    motion = read_motion(files[told.motion], scene.rover, scene.plan if planned else None, told.member)
    if told.correlation_m is not None and motion.sigmas is None:
        raise typer.BadParameter("--correlation is of the motion's errors, and it has none; add x_m_sigma and others")
    states = None if told.states is None else read_pose_states(files[told.states], scene.rover)
    belief = first_belief() if told.belief is None else read_belief(files[told.belief])
    length, basis = told.correlation_m, "given"
    if length is None and states is not None:
        shown = states.valid & np.isin(states.time_s, motion.time_s[~motion.no_speed])
        length, basis = correlation_of(motion, states.values[shown, 1], states.sigmas[shown, 1]), "slip errors"
    if length is None:
        length, basis = CORRELATION_M, "assumed"
    return MotionInputs(motion, states, belief, length, basis)


def _notes(known: MotionInputs, told: Told, scene: DriveInputs) -> list[str]:
    notes = []
    if known.motion.sigmas is None:
        notes.append("the motion has no columns x_m_sigma, y_m_sigma, yaw_deg_sigma; it counts as exact")
    if told.belief is None:
        notes.append("no belief is given: the soils are drawn from the priors")
    if known.states is None:
        notes.append("no states are given: sinkages in the table are those of the assumed soil, and tell nothing of it")
    elif told.iterate is None:
        notes.append(
            "errors of single pulls are one soil's, alike at all poses; `regolith identify` takes them as independent "
            "and is too sure of what it finds, --iterate is not"
        )
    if scene.terrain.synthetic:
        notes.append("the terrain is synthetic")
    return notes


def _soil_of(told: Told) -> DrivenSoil:
    return DrivenSoil("priors", "priors") if told.belief is None else DrivenSoil(told.belief, "belief")


def _saved(scene: DriveInputs, told: Told, turned: AlternatingEstimate | None) -> dict[Path, Callable[[], bytes]]:
    if turned is None or told.save is None or told.states is None:
        return {}
    belief, path = turned.posterior.belief, told.states
    entry = {
        "states": Path(path).name,
        "sha256": scene.inputs[path],
        "of": "forces and soil in turn",
        "rounds": len(turned.rounds),
        "verdict": turned.verdict,
    }
    belief = dataclasses.replace(belief, history=(*belief.history, entry))
    return {told.save: lambda: belief.to_json().encode()}
