"""`lunarsci twin forces`: what the wheels carry and pull along a predicted drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lunarsci.twin.jobs.requests import DriveRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import SPREAD, Output
from ..shared.table import TextTable, bare
from .options import DRIVE, PlanFile

if TYPE_CHECKING:
    from lunarsci.twin.jobs.forces import DriveForces
    from lunarsci.twin.judgement.tables import Spread, WheelLoads


COLUMNS = {
    "normal_force_n": ("F_N [N]", 1.0),
    "drawbar_pull_n": ("F_DP [N]", 1.0),
    "lateral_force_n": ("F_L [N]", 1.0),
    "resistance_torque_nm": ("M_R [N m]", 1.0),
    "sinkage_m": ("sinkage [mm]", 1e3),
    "slip_ratio": ("slip [-]", 1.0),
    "side_slip_deg": ("side slip [deg]", 1.0),
}
"""Head of each column of the table, and by what its numbers are multiplied there."""
EXAMPLES = (
    "lunarsci twin forces plan.toml",
    "lunarsci twin forces plan.toml --soil lunar-typical --csv",
)


@command("forces", EXAMPLES, DRIVE, blocks=SPREAD)
def forces(output: Output, request: DriveRequest, plan: PlanFile = None) -> Report:
    """Load, drawbar pull, lateral force and torque of every wheel along a predicted drive.

    The drive has the soil of the terrain unless --sweep, --members or --soil name others. `lunarsci twin loads` gives
    the same along a measured motion.
    """
    from lunarsci.twin.jobs import forces as job

    result = job.forces(plan, request, progress=output.progress("driving"))
    return Report(result, wheel_tables(result.title, result.loads, _notes(result)))


def _notes(result: DriveForces) -> list[str]:
    inputs, prediction = result.soils.inputs, result.prediction
    notes = [*inputs.soil_notes(prediction.members, len(prediction.parameters)), *result.failed, *inputs.remarks]
    return [*notes, "the terrain is synthetic"] if inputs.terrain.synthetic else notes


def wheel_tables(title: str, loads: Sequence[WheelLoads], notes: Sequence[str]) -> list[TextTable]:
    """Median and range of forces, sinkage and slips of each wheel."""
    names = list(COLUMNS)
    heading = f"{title}; medians along the drive"
    return [_table(heading, loads, names[:4], ()), _table("", loads, names[4:], notes)]


def _table(title: str, loads: Sequence[WheelLoads], names: Sequence[str], notes: Sequence[str]) -> TextTable:
    headers = [head for name in names for head in spread_headers(COLUMNS[name][0])]
    rows = [
        [load.wheel, *(cell for name in names for cell in _spread(load.quantities[name], COLUMNS[name][1]))]
        for load in loads
    ]
    return TextTable(["wheel", *headers], rows, title=title, notes=list(notes))


def spread_headers(header: str) -> list[str]:
    """Headers of a median and of its range.

    >>> spread_headers("slip [-]")
    ['slip [-]', 'slip from p05 to p95']
    """
    return [header, f"{bare(header)} from p05 to p95"]


def _spread(spread: Spread, factor: float) -> list[str]:
    low, middle, high = (factor * value for value in (spread.p05, spread.p50, spread.p95))
    return [f"{middle:.3g}", f"{low:.3g} to {high:.3g}"]
