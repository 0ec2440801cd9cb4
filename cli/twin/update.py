"""`lunarsci twin update`: what a drive says of the soil, for the next prediction."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.twin.jobs.requests import UpdateRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import SPREAD, Output, option
from ..shared.table import TextTable
from .history import discrepancy_table, parameter_table
from .options import AS_WRITTEN, GRAVITY, HEIGHT_UNIT, INTERPOLATION, ROVER, TERRAIN

if TYPE_CHECKING:
    from lunarsci.twin.assimilation.segments import Segment
    from lunarsci.twin.assimilation.update import SoilUpdate
    from lunarsci.twin.jobs.update import LearnedSoil


FILE: dict[str, Any] = {"kind": str | None, "metavar": "FILE"}
DRIVE, BELIEF = "Drive", "Belief"
OPTIONS = {
    "plan": option(kind=str | None, panel=DRIVE),
    "positions": option(**FILE, panel=DRIVE),
    "soil": option(**FILE, panel=BELIEF),
    "forget": option(min=0, max=1, panel=BELIEF),
    "correlation": option(min=0.1, panel=BELIEF),
    "rover": ROVER,
    "terrain": TERRAIN,
    "height_unit": HEIGHT_UNIT,
    "gravity": GRAVITY,
    "interpolation": INTERPOLATION,
    "as_written": AS_WRITTEN,
    "particles": option(min=32, panel=BELIEF),
    "ruts": option("--ruts/--no-ruts", panel=DRIVE),
    "seed": option(min=0),
}
States = Annotated[
    str,
    typer.Argument(
        help="Measured wheel states (CSV), as `twin states -o DIR` writes them: time_s, wheel, sinkage_m, slip_ratio, "
        "..., NAME_sigma, rim_m_s."
    ),
]
SavedBelief = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", rich_help_panel=BELIEF, help="The new belief (JSON): for --soil, and `twin predict --soil`."
    ),
]
SavedMap = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        rich_help_panel=BELIEF,
        help="The soil map after it (JSON): each stretch of the way with its own soil.",
    ),
]
SavedTerrain = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        rich_help_panel=BELIEF,
        help="The terrain with the median soil at every node, and what is known (.npz).",
    ),
]
EFFECTIVE = (
    "medians and 68 % are effective values: with them the twin drives as the rover did; the ground's own values, which "
    "another law or instrument would find, are less certain, cohesion most of all, since friction can replace it"
)
EXAMPLES = (
    "lunarsci twin update states/states.csv --plan plan.toml --particles 32 \\\n"
    "  --positions states/positions.csv --save belief.json",
    "lunarsci twin update states/states.csv --plan plan.toml --particles 32 \\\n"
    "  --positions states/positions.csv --seed 2 --save second.json",
)


@command("update", EXAMPLES, OPTIONS, blocks=SPREAD)
def update(
    states: States,
    request: UpdateRequest,
    output: Output,
    save: SavedBelief = None,
    save_map: SavedMap = None,
    save_terrain: SavedTerrain = None,
) -> Report:
    """Update what is believed of the soil by a drive that happened: the twin drives it on many soils.

    The soils that agree with the measured states and positions are kept. If no soil does, nothing is learned, the
    reason is named, and the exit code is 3. The result says where along the way the soil changes. With a map each
    stretch between changes is learned on its own; far from all drives the map returns to the first priors.

    Values are effective ones, with which the twin drives as the rover did; the ground's own have wider intervals. A
    belief is doubtful after a drive that needs errors more than five times as large, that slipped otherwise than the
    soil does, or whose wheels turned otherwise than planned. The exit code is then 3, here and wherever the belief is
    used, until all is forgotten (--forget 1).

    Residuals that no soil explains teach the error of the twin's physics, which predictions from the belief then carry.
    """
    from lunarsci.twin.jobs import update as job

    output.check_extra("--save", save, (".json",))
    output.check_extra("--save-map", save_map, (".json",))
    output.check_extra("--save-terrain", save_terrain, (".npz",))
    asked = dataclasses.replace(request, by_place=save_map is not None or save_terrain is not None)
    learned = job.update(states, asked, progress=output.progress("driving on many soils"))
    made = {
        save: lambda: learned.belief.to_json().encode(),
        save_map: learned.map_bytes,
        save_terrain: learned.terrain_bytes,
    }
    return Report(learned, result_tables(learned), extras={path: make for path, make in made.items() if path})


def result_tables(learned: LearnedSoil) -> list[TextTable]:
    from lunarsci.regolith.belief import parameter_rows
    from lunarsci.regolith.columns import short_name

    given = learned.inputs
    title = (
        f"Soil after {learned.states.name}: {given.plan.name}; {short_name(given.rover.name)} on {given.terrain.name}"
    )
    tables = [
        parameter_table(parameter_rows(learned.belief), title, _notes(learned)),
        discrepancy_table(learned.belief.discrepancy),
    ]
    return tables if len(learned.segments or []) < 2 else [*tables, _segment_table(learned.segments or [])]


def _notes(learned: LearnedSoil) -> list[str]:
    from lunarsci.twin.assimilation.update import SURPRISING

    update = learned.update
    notes = [
        f"learned from {update.learned_from}; {int(update.outliers.sum())} outliers, reduced chi-square "
        f"{update.reduced:.2f}",
        f"surprise: the soil lies {update.prior_shift:.2f} standard deviations from what was believed before; about 1 "
        f"or less is expected, above {SURPRISING:.2g} check whether it is the same ground",
        *learned.doubts.reasons,
        *learned.before.cautions(update),
        *_slip_notes(learned),
    ]
    notes.append(_rut_note(update))
    for name, factor in update.inflation.items():
        notes.append(
            f"errors of {name} are taken {factor:.1f} times as large, as no soil explains the measurements better"
        )
    for name, size in update.wheel_errors.items():
        notes.append(f"single wheels are off in {name} by {size:.2g} throughout; the errors include this")
    notes.extend(change.text for change in learned.changes)
    if learned.changes and learned.segments is None:
        notes.append("--save-map learns the soil of each stretch on its own")
    if not update.settled:
        notes.append("the intervals may be too narrow, as too few soils were left to vary; give more --particles")
    return [*notes, *_mass_notes(learned), EFFECTIVE]


def _rut_note(update: SoilUpdate) -> str:
    """How surely wheels ran in the ruts of others, and what that means for predictions."""
    return (
        f"the probability that wheels met the ruts of those before them is {update.ruts_probability:.2g}; in "
        "predictions from this belief wheels meet ruts in as many of the drives"
    )


def _mass_notes(learned: LearnedSoil) -> list[str]:
    """What the soil owes to the mass in the rover file, which no motion tells."""
    if learned.forces_measured:
        return []
    rover = learned.inputs.rover
    return [
        f"stiffness and cohesion rest on the mass in the rover file, {rover.mass_kg:.4g} kg: if the rover is 10 % "
        "heavier, both are 10 % larger, and no other value changes; slip, sinkage and positions do not show the mass"
    ]


def _slip_notes(learned: LearnedSoil) -> list[str]:
    """Slip and rates of the wheels, as measured beside the drive that was simulated."""
    notes, pace = [], learned.pace
    if learned.slip is not None:
        notes.append(learned.slip.text)
    if pace is None:
        notes.append("the plan's speed was not checked: the states do not say how fast the wheels turned (rim_m_s)")
    elif not pace.off:
        notes.append(pace.text)
    return notes


def _segment_table(segments: list[Segment]) -> TextTable:
    """Stretches of the way side by side."""
    from lunarsci.pages.words import percent

    columns = []
    for segment in segments:
        left, intervals = segment.belief.sd_ratio, segment.belief.intervals().items()
        columns.append({name: f"{row[0]:.4g} ({percent(left[name] ** 2)})" for name, row in intervals})
    notes = [
        f"{segment.from_m:.1f} to {segment.to_m:.1f} m: stays at what was believed: {segment.why_not}"
        for segment in segments
        if not segment.learned
    ]
    notes += [segment.slip_text for segment in segments]
    headers = ["parameter", *(f"{segment.from_m:.1f} to {segment.to_m:.1f} m" for segment in segments)]
    rows = [[name, *(column[name] for column in columns)] for name in columns[0]]
    title = "Soil of each stretch of the way: median, and in brackets the variance left of that before any drive"
    return TextTable(headers, rows, title=title, notes=notes)
