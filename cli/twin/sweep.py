"""`lunarsci twin sweep`: what a number of the rover is worth on a mission."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.twin.jobs.requests import SweepRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable
from .options import CHARGE, DRIVE, EXACT_TERRAIN, SUN

if TYPE_CHECKING:
    from lunarsci.twin.jobs.sweep import DesignTrade

OPTIONS = DRIVE | {
    "vary": option(metavar="NAME=LOW:HIGH:N"),
    "designs": option(min=1),
    "exact_terrain": EXACT_TERRAIN,
    "sun": SUN,
    "charge": CHARGE,
}
Plans = Annotated[
    list[str] | None,
    typer.Argument(metavar="PLAN", help="Plans of the mission (TOML); the embedded one if left out."),
]
EXAMPLES = (
    "lunarsci twin sweep plan.toml --vary wheel.radius_m=0.13:0.17:2",
    "lunarsci twin sweep plan.toml --vary mass.body_kg=90:120:2 --csv",
)
HEADERS = (
    "", "kept", "slip p95", "sinkage p95 [mm]", "work [J]", "time [s]", "bias [m]", "scatter [m]",
    "pull/weight at 20 %", "climbs [deg]",
)  # fmt: skip


@command("sweep", EXAMPLES, OPTIONS)
def sweep(output: Output, request: SweepRequest, plans: Plans = None) -> Report:
    """Compare designs of a rover that differ in a few numbers, on the same mission and soils.

    The table has for each design the share of drives that keep every limit, p95 of the worst slip and sinkage, work of
    the motors, time, bias and scatter of the ends, and the pull of a wheel at 20 % slip. With --charge or --sun it also
    has the charge left in the battery, which is a limit then. An impossible design is listed with its reason; a number
    that affects no drive is refused. `*` marks designs that no other beats both in energy and in the share of drives
    kept; --plot draws them, and a curve for each number.
    """
    from lunarsci.twin.jobs import sweep as job

    trade = job.sweep(plans, request, progress=output.progress("designs"))
    return Report(trade, result_tables(trade))


def result_tables(trade: DesignTrade) -> list[TextTable]:
    names = [entry.name for entry in trade.variations]
    rows = [[*(f"{row[name]:.4g}" for name in names), *_cells(row)] for row in trade.rows() if not row["impossible"]]
    headers, possible = [*names, *HEADERS], [row for row in trade.rows() if not row["impossible"]]
    if any(row["least_charge"] is not None for row in possible):
        headers.append("battery left [%]")
        rows = [[*cells, f"{100 * row['least_charge']:z.0f}"] for cells, row in zip(rows, possible, strict=True)]
    drives = next((design.outcome.drives for design in trade.designs if design.outcome), 0)
    plans = ", ".join(soils.inputs.plan.name for soils in trade.soils)
    each = "1 drive each" if drives == 1 else f"{drives} drives each"
    title = f"{len(trade.designs)} designs of {trade.inputs.rover.name}: {plans}; {each}"
    notes = [
        "* no other design keeps more drives and needs less work",
        *(f"{name} changed nothing: no drive of this mission depends on it" for name in trade.unused),
        *(trade.inputs.soil_notes(drives, len(trade.soils[0].drawn)) if drives else []),
        *trade.inputs.remarks,
    ]
    if trade.inputs.terrain.synthetic:
        notes.append("the terrain is synthetic; the trade says nothing about a real site")
    out = [[*(f"{row[name]:.4g}" for name in names), row["impossible"]] for row in trade.rows() if row["impossible"]]
    impossible = [TextTable([*names, "why"], out, title="Impossible designs")] if out else []
    return [TextTable(headers, rows, title=title, notes=notes), *impossible]


def _cells(row: Any) -> list[str]:
    def shown(key: str, form: str, factor: float = 1.0) -> str:
        return "-" if row[key] is None else format(factor * row[key], form)

    return [
        "*" if row["on_front"] else "",
        shown("kept_share", ".0f", 100.0) + " %",
        shown("slip_ratio", ".3f"),
        shown("sinkage_m", ".1f", 1e3),
        shown("energy_p50_j", ".4g"),
        shown("duration_s", ".0f"),
        shown("bias_m", ".3f"),
        shown("scatter_m", ".3f"),
        shown("pull_per_weight_at_20", ".3f"),
        shown("slope_at_20_deg", ".1f"),
    ]
