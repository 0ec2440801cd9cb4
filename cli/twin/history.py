"""`lunarsci twin history`: what a belief of the soil rests on, and the way back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.names import counted
from lunarsci.options import refuse_where
from lunarsci.twin.jobs.requests import HistoryRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, significant

if TYPE_CHECKING:
    from lunarsci.regolith.belief import BeliefDistance, SoilBelief
    from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
    from lunarsci.twin.jobs.history import BeliefHistory


OPTIONS = {
    "against": option(kind=str | None, metavar="FILE"),
    "rollback": option(min=0, metavar="N"),
}
SavedBelief = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Takes the belief of --rollback (JSON), for `twin update`.")
]
ENDS = (("low", "high"), ("ground_low_68", "ground_high_68"))
"""Keys of the ends of 68 %: of the effective value, and of the ground's own."""
SHORT = {
    "stiffness_kpa_m_n": "K_s",
    "sinkage_exponent": "N",
    "sinkage_exponent_slip": "n_1",
    "cohesion_pa": "c",
    "friction_angle_deg": "φ",
    "shear_modulus_mm": "K_x",
    "external_friction_angle_deg": "φ_y",
    "lateral_modulus_mm": "K_y",
}
"""Symbols of the parameters in tables."""
EXAMPLES = (
    "lunarsci twin history belief.json",
    "lunarsci twin history second.json --against belief.json",
)


@command("history", EXAMPLES, OPTIONS)
def history(
    belief: Annotated[str, typer.Argument(metavar="BELIEF.json", help="A belief of `twin update --save`.")],
    request: HistoryRequest,
    output: Output,
    save: SavedBelief = None,
) -> Report:
    """Which drives a belief of the soil rests on, how each moved it, and where it differs from another.

    Each drive has its states file, the number of its values, how well a soil explained them, and how far it moved each
    parameter, in standard deviations of the belief before. --rollback undoes the drives after the Nth: mean and
    covariance come back exactly, the drawn soils do not, so the belief is a normal distribution from there on.
    """
    from lunarsci.twin.jobs.history import history

    apart = (request.rollback is None) != (save is None)
    refuse_where({"`rollback` N and `save` FILE belong together; give both, or neither": apart})
    output.check_extra("--save", save, (".json",))
    result = history(belief, request)
    back = result.rolled_back
    extras = {} if save is None or back is None else {save: lambda: back.to_json().encode()}
    return Report(result, _tables(result, save), extras=extras)


def _tables(result: BeliefHistory, save: Path | None) -> list[TextTable]:
    from lunarsci.regolith.belief import parameter_rows

    now = parameter_table(parameter_rows(result.belief), "What is believed now")
    drives = result.drives
    tables = [_drive_table(result.source.name, drives), _moved_table(drives), now, _physics_table(result.belief)]
    if result.distance is not None and result.other_source is not None:
        tables.append(_distance_table((result.source.name, result.other_source.name), result.distance))
    if result.rollback is not None and result.rolled_back is not None:
        title = f"What was believed after {counted(result.rollback, 'drive')}, written to {save}"
        tables.append(parameter_table(parameter_rows(result.rolled_back), title))
    return [table for table in tables if table.rows or table.notes]


def _drive_table(name: str, drives: list[dict[str, Any]]) -> TextTable:
    from lunarsci.regolith.columns import ground_name

    headers = [
        "drive",
        "states",
        "plan",
        "values",
        "outliers",
        "reduced chi-square",
        "surprise [sd]",
        "forgotten before",
    ]
    rows = [
        [
            str(drive["drive"]),
            *(str(drive[key] or "-") for key in ("states", "plan")),
            *("-" if drive[key] is None else str(drive[key]) for key in ("values", "outliers")),
            *("-" if drive[key] is None else f"{drive[key]:.2f}" for key in ("reduced_chi_square", "surprise")),
            "-" if not drive["forgotten"] else f"{100 * drive['forgotten']:.0f} %",
        ]
        for drive in drives
    ]
    if not drives:
        return TextTable([], [], title=f"{name} rests on no drive", notes=["it holds the priors"])
    learned = sum(drive["refused"] is None for drive in drives)
    notes = [f"drive {d['drive']} taught nothing: {d['refused']}" for d in drives if d["refused"]]
    notes += [f"drive {d['drive']} is doubtful: {d['doubt']}" for d in drives if d["doubt"]]
    notes += [f"drive {d['drive']} was learned with a warning: {d['caution']}" for d in drives if d["caution"]]
    rovers = list(dict.fromkeys(drive["rover"] for drive in drives if drive["rover"]))
    notes += [f"driven by {'; '.join(rovers)}"] if rovers else []
    grounds = list(dict.fromkeys(ground_name(drive["ground"]) for drive in drives if drive["ground"]))
    notes += [f"driven on {'; '.join(grounds)}"] if grounds else []
    pulls = list(dict.fromkeys(drive["gravity_m_s2"] for drive in drives if drive["gravity_m_s2"]))
    notes += [f"driven under a gravity of {', '.join(f'{pull:g}' for pull in pulls)} m/s²"] if pulls else []
    notes.append("surprise: how far the soil lies from what was believed before; about 1 or less is expected")
    return TextTable(headers, rows, title=f"{name} rests on {counted(learned, 'drive')}", notes=notes)


def _moved_table(drives: list[dict[str, Any]]) -> TextTable:
    rows = [[str(d["drive"]), *(f"{d['moved_sd'][name]:+.2f}" for name in SHORT)] for d in drives if d["moved_sd"]]
    lost = [str(d["drive"]) for d in drives if d["moved_sd"] is None]
    older = "an older version wrote the file, without the states of"
    notes = (
        [f"{older} drive {', '.join(lost)}; there is no way back to {'it' if len(lost) == 1 else 'them'}"]
        if lost
        else []
    )
    title = "How far each drive moved the parameters, in standard deviations of what was believed before"
    return TextTable(["drive", *SHORT.values()] if rows else [], rows, title=title, notes=notes)


def _physics_table(belief: SoilBelief) -> TextTable:
    """What the twin's physics is off by, and the drives that taught it."""
    table = discrepancy_table(belief.discrepancy)
    lines = [f"taught by {one.get('states')} ({one.get('how')})" for one in belief.discrepancy.scored]
    return TextTable(table.headers, table.rows, title=table.title, notes=[*table.notes, *lines])


def _distance_table(names: tuple[str, str], distance: BeliefDistance) -> TextTable:
    rows = [
        [
            name,
            *(f"{middle:.4g} ({low:.4g} to {high:.4g})" for middle, low, high in (row.one, row.other)),
            f"{row.difference_sd:+.2f}",
            f"{row.bhattacharyya:.3f}",
        ]
        for name, row in distance.parameters.items()
    ]
    one, other = distance.kullback_leibler
    same = "drive" if distance.shared_drives == 1 else f"{distance.shared_drives} drives"
    shared = f"both rest on the same first {same}, and are not independent"
    notes = [
        f"as a whole {distance.difference_sd:.2f} combined standard deviations apart; Bhattacharyya distance "
        f"{distance.bhattacharyya:.2f}; Kullback-Leibler {one:.2f} nat lost where the first stands for the second, "
        f"{other:.2f} the other way round",
        shared if distance.shared_drives else "they share no drive",
    ]
    title = f"{names[0]} beside {names[1]}: median (68 %)"
    return TextTable(
        ["parameter", "first", "second", "difference [sd]", "Bhattacharyya"], rows, title=title, notes=notes
    )


def parameter_table(rows: Mapping[str, Mapping[str, float]], title: str, notes: Sequence[str] = ()) -> TextTable:
    """Effective values and the ground's own of each parameter, from `parameter_rows`."""
    from lunarsci.pages.words import percent

    cells = [
        [
            name,
            f"{row['median']:.4g}",
            *(f"{significant(row[low])} to {significant(row[high])}" for low, high in ENDS),
            percent(row["left_of_prior"] ** 2),
        ]
        for name, row in rows.items()
    ]
    headers = ["effective value", "median", "68 %", "ground's own 68 %", "variance left"]
    return TextTable(headers, cells, title=title, notes=notes)


def discrepancy_table(after: PhysicsDiscrepancy, before: PhysicsDiscrepancy | None = None) -> TextTable:
    """What the twin's physics is off by, for people; beside what was believed before."""
    from lunarsci.regolith.physics_discrepancy import FIRST

    headers = ["share", "68 %", "95 %", "worth [drives]", *(["68 % before"] if before else [])]
    parts = {"way, along": "along", "way, across": "across", **{name: name for name in sorted(after.quantities)}}
    rows = []
    for label, key in parts.items():
        one, old = (_law(law, key) for law in (after, before or after))
        cells = [_share(one.half_width(p)) for p in (0.68, 0.95)]
        rows.append([label, *cells, f"{one.degrees:.1f}", *([_share(old.half_width(0.68))] if before else [])])
    count = len(after.scored)
    first = " and ".join(dict.fromkeys(f"{_law(FIRST, key).degrees:g}" for key in parts.values()))
    notes = [
        f"learned from {count} drive{'s' * (count != 1)}; predictions carry it beside the uncertainty of the soil",
        f"worth: so many drives would determine the error as well; the priors, from simulations, are worth {first}",
    ]
    return TextTable(headers, rows, title="Error of the twin's physics, beside that of the soil", notes=notes)


def _share(half_width: float) -> str:
    """An interval about what the twin says; beyond all of it nothing is left that it says."""
    return f"± {100 * half_width:.2g} %" if half_width < 1.0 else "± 100 % or more"


def _law(law: PhysicsDiscrepancy, key: str) -> Any:
    return law.quantities[key] if key in law.quantities else getattr(law, key)
