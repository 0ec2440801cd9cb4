"""`lunarsci twin loads`: what the wheels carry and pull along a motion that was measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.options import refuse_where
from lunarsci.twin.jobs.requests import LoadsRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus
from .forces import wheel_tables
from .options import AS_WRITTEN, GRAVITY, HEIGHT_UNIT, INTERPOLATION, ROVER, TERRAIN, PlanFile

if TYPE_CHECKING:
    from lunarsci.twin.jobs.loads import MotionLoads, UncertainLoads

PANEL: dict[str, Any] = {"panel": "Uncertain motion and soil"}
OPTIONS = {
    "member": option(min=0),
    "rover": ROVER,
    "terrain": TERRAIN,
    "height_unit": HEIGHT_UNIT,
    "gravity": GRAVITY,
    "interpolation": INTERPOLATION,
    "as_written": AS_WRITTEN,
    "soil": option(show_default="the terrain's, or longji"),
    "states": option(kind=str | None, metavar="FILE", **PANEL),
    "belief": option(kind=str | None, metavar="FILE", **PANEL),
    "draws": option(min=16, max=4096, **PANEL),
    "correlation": option(**PANEL),
    "balance_error": option(**PANEL),
    "iterate": option(min=1, max=50, **PANEL),
    "seed": option(min=0),
}
MotionFile = Annotated[
    str, typer.Option(metavar="FILE", help="The motion that was measured: CSV with time_s, x_m, y_m, yaw_deg.")
]
SavedBelief = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The soil after --iterate as a belief (JSON), for `twin predict --soil`.",
        rich_help_panel=PANEL["panel"],
    ),
]
SYMBOLS = {"normal_force_n": "F_N", "drawbar_pull_n": "F_DP", "lateral_force_n": "F_L"}
"""Of the forces, in tables."""
UNITS = {"ahead": "N", "left": "N", "moment": "N m"}
"""Of the totals."""
EXAMPLES = (
    "lunarsci twin loads --motion states/motion.csv",
    "lunarsci twin loads --motion states/motion.csv --states states/states.csv",
)


@command("loads", EXAMPLES, OPTIONS, folder=True)
def loads(
    output: Output, request: LoadsRequest, motion: MotionFile, plan: PlanFile = None, save: SavedBelief = None
) -> Report:
    """Load, drawbar pull, lateral force and torque of every wheel along a measured motion.

    The commands of the wheels are columns such as steering_FL_deg and speed_FL_m_s, or those of the plan at the same
    times. The result states which part of the needed force the wheels do not supply.

    With --states, --belief or --draws the motion is as uncertain as its columns x_m_sigma, y_m_sigma and yaw_deg_sigma
    say, and the soil as the belief. Forces are then computed on many soils and motions that balance: all wheels
    together carry weight and slope. Their sum is well known; how much each wheel supplies depends on the assumed soil,
    and the tables say by how much. --iterate looks for the soil that fits these forces. Forces computed from a soil
    cannot prove it, so the search uses only the sinkages under the loads, and the slips beside the pull of all wheels
    together. Exit code 3: the rounds do not converge.
    """
    from lunarsci.twin.jobs import loads as job
    from lunarsci.twin.jobs.loads import MotionLoads

    no_soil = save is not None and request.iterate is None
    refuse_where({"`save` takes the soil of `iterate`; give that, or leave it out": no_soil})
    output.check_extra("--save", save, (".json",))
    result = job.loads(motion, plan, request, progress=output.progress("holding the rover to its motion"))
    if isinstance(result, MotionLoads):
        return Report(result, result_tables(result))
    belief = result.belief
    extras = {save: lambda: belief.to_json().encode()} if save and belief else {}
    return Report(result, result_tables(result), files=result.files(), extras=extras)


def result_tables(result: MotionLoads | UncertainLoads) -> list[TextTable]:
    """Loads of one motion, or of all that could have been."""
    from lunarsci.twin.jobs.loads import MotionLoads

    if isinstance(result, MotionLoads):
        return wheel_tables(result.title, result.wheels, _notes_of_motion(result))
    return _tables(result)


def _notes_of_motion(result: MotionLoads) -> list[str]:
    from lunarsci.twin.lanes import outcome_texts

    notes = [*outcome_texts(result.forces.outcome), *result.inputs.remarks]
    if missing := result.missing:
        notes.insert(
            0,
            f"force that the wheels do not supply: {missing['mean_ahead_n']:.2f} N ahead and "
            f"{missing['mean_left_n']:.2f} N to the left on average; as root mean square "
            f"{100 * missing['rms_share_of_weight']:.1f} % of the weight",
        )
    return [*notes, "the terrain is synthetic"] if result.inputs.terrain.synthetic else notes


def _notes(result: UncertainLoads) -> list[str]:
    notes = []
    if result.forces.held.motion.sigmas is None:
        notes.append("the motion has no columns x_m_sigma, y_m_sigma, yaw_deg_sigma; it counts as exact")
    if "belief" not in result.given:
        notes.append("no belief is given: the soils are drawn from the priors")
    if result.states is None:
        notes.append(
            "no states are given: the sinkages in the table follow from the assumed soil, and say nothing about it"
        )
    elif result.turned is None:
        notes.append(
            "errors of single pulls are alike at all poses, as the soil is one; `regolith identify` takes them as "
            "independent, so that its errors are too small; --iterate does not"
        )
    return [*notes, "the terrain is synthetic"] if result.inputs.terrain.synthetic else notes


def _tables(result: UncertainLoads) -> list[TextTable]:
    """Forces of each wheel, where their uncertainty comes from, totals, rounds."""
    record, notes = result.to_dict(), _notes(result)
    if not record["wheels"]:
        return [TextTable([], [], title=result.title, notes=[*notes, "no pose has forces"])]
    tables = [
        _force_table(record["wheels"], result.title),
        _share_table(record["shares"]),
        _total_table(record["totals"], notes),
    ]
    turned = record["iteration"]
    return tables if turned is None else [*tables, _round_table(turned), _soil_table(turned["parameters"])]


def _force_table(wheels: list[dict[str, Any]], title: str) -> TextTable:
    rows = [
        [
            each["wheel"],
            *(
                plus_minus(each[name][f"mean{end}"], each[name][f"sigma{end}"], digits=2)
                for name in SYMBOLS
                for end in ("_before", "")
            ),
        ]
        for each in wheels
    ]
    headers = ["wheel", *(f"{SYMBOLS[name]} {when} [N]" for name in SYMBOLS for when in ("assumed", "balanced"))]
    return TextTable(headers, rows, title=f"{title}; mean along the drive ± standard deviation at a pose")


def _share_table(shares: dict[str, Any]) -> TextTable:
    rows = []
    for name, of_force in shares.items():
        for when, key in (("assumed", "before"), ("balanced", "after")):
            variance = of_force[key]
            parts = (f"{100 * variance[part]:.0f} %" for part in ("soil", "motion", "balance", "together"))
            rows.append([SYMBOLS[name], when, *parts, f"{100 * variance['of_force']:.1f} %"])
    headers = ["force", "", "soil", "motion", "balance", "only jointly", "soil moves the force by"]
    return TextTable(headers, rows, title="Where the variance of the forces comes from")


def _total_table(totals: dict[str, dict[str, float]], notes: list[str]) -> TextTable:
    from lunarsci.twin.jobs.forces import TOGETHER

    rows = [[f"{name} [{UNITS[name]}]", *(f"{row[key]:.2f}" for key in row)] for name, row in totals.items()]
    headers = ["of all wheels", "missing, assumed soil", "balanced", "± assumed soil", "± balanced"]
    title = "What the wheels do not supply, root mean square"
    return TextTable(headers, rows, title=title, notes=[TOGETHER, *notes])


def _round_table(turned: dict[str, Any]) -> TextTable:
    rows = [
        [
            str(number),
            f"{each['soil_moved_sd']:.3g}",
            f"{100 * each['forces_moved_share']:.2g} %",
            f"{each['reduced_chi_square_sinkages']:.2f}",
            f"{each['reduced_chi_square_totals']:.2f}",
        ]
        for number, each in enumerate(turned["rounds"], start=1)
    ]
    headers = ["round", "soil moved [sd]", "pulls moved", "chi² sinkages", "chi² totals"]
    rounds = "1 round" if len(rows) == 1 else f"{len(rows)} rounds"
    notes = [
        "the soil is judged by sinkages under the loads and by the pull of all wheels together; single pulls do not "
        "count, as they were computed from a soil",
    ]
    outcome = f"converged after {rounds}" if turned["converged"] else f"{turned['verdict']}, {rounds}"
    return TextTable(headers, rows, title=f"Forces and soil in turn: {outcome}", notes=notes)


def _soil_table(parameters: dict[str, dict[str, float]]) -> TextTable:
    from lunarsci.pages.words import percent

    rows = [
        [name, *(f"{row[key]:.4g}" for key in ("median", "low", "high")), percent(row["left_of_prior"] ** 2)]
        for name, row in parameters.items()
    ]
    headers = ["parameter", "median", "68 % from", "to", "variance left"]
    return TextTable(headers, rows, title="The soil after the last round")
