"""`lunarsci regolith forces`: forces of the soil on one wheel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lunarsci.regolith.jobs.requests import WheelForcesRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import option
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.regolith.jobs.wheel_forces import ForcesOnWheel
    from lunarsci.regolith.traction import Traction

SOIL, EXACT = "Soil", "Exact integrals"
WHEEL = "State of the wheel"
OPTIONS = {
    "sinkage": option(panel=WHEEL),
    "load": option(panel=WHEEL),
    "slip": option(kind=str, metavar="S,…|A:B:N", panel=WHEEL),
    "side_slip": option(panel=WHEEL),
    "rover": option(),
    "soil": option(panel=SOIL),
    "stiffness": option(panel=SOIL),
    "exponent": option(panel=SOIL),
    "cohesion": option(panel=SOIL),
    "friction_angle": option(panel=SOIL),
    "shear_modulus": option(panel=SOIL),
    "external_friction_angle": option(panel=SOIL),
    "lateral_modulus": option(panel=SOIL),
    "reading": option(),
    "exact": option(panel=EXACT),
    "shear": option(panel=EXACT),
    "bulldozing": option(panel=EXACT),
    "density": option(panel=EXACT),
    "gravity": option(kind=str, metavar="G", panel=EXACT),
    "rebound": option(panel=EXACT),
    "rut": option(panel=EXACT),
    "reload": option(panel=EXACT),
    "slip_sinkage": option(panel=WHEEL),
    "reece_cohesive": option(panel=SOIL),
    "reece_frictional": option(panel=SOIL),
}
EXAMPLES = (
    "lunarsci regolith forces --sinkage 0.008 --slip 0.1",
    "lunarsci regolith forces --load 36.5 --slip 0:0.6:13 --plot pull.png",
)


@command("forces", EXAMPLES, OPTIONS)
def forces(request: WheelForcesRequest) -> Report:
    """Forces of the soil on one wheel, from its sinkage or its load.

    The model was compared with wheels at slips up to ±0.6, and says so beyond. At a slip of -1 (locked wheel) and a
    side slip of 90 deg the forces are limits of the equations. A sinkage of the wheel's radius or more is refused. Exit
    code 3: cohesion alone would pull more than the wheel presses, as at next to no sinkage. An option of the
    integrals, such as --shear, stands for --exact, too.

    With --slip FIRST:LAST:N a curve; under --load also pull at 20 % slip and per weight, tractive efficiency, and the
    slope that such wheels climb.
    """
    from lunarsci.regolith.jobs.wheel_forces import wheel_forces

    result = wheel_forces(request)
    return Report(result, result_tables(result))


def result_tables(result: ForcesOnWheel) -> list[TextTable]:
    """One state in full, or a curve over slip and what it is worth."""
    rows = result.rows()
    if len(rows) == 1:
        return [_table(rows[0])]
    return [_curve(rows), *([] if result.traction is None else [_figures(result.traction)])]


def _table(row: Mapping[str, Any]) -> TextTable:
    cells = [
        ["sinkage", f"{1e3 * row['sinkage_m']:.2f}", "mm"],
        ["slip ratio", f"{row['slip_ratio']:.4f}", "-"],
        ["side slip", f"{row['side_slip_deg']:.2f}", "deg"],
        ["normal force", f"{row['normal_force_n']:.2f}", "N"],
        ["drawbar pull", f"{row['drawbar_pull_n']:.2f}", "N"],
        ["lateral force", f"{row['lateral_force_n']:.2f}", "N"],
        ["resistance torque", f"{row['resistance_torque_nm']:.3f}", "N m"],
    ]
    for name in ("steering_moment_nm", "overturning_moment_nm"):
        if name in row:
            cells.append([name.removesuffix("_nm").replace("_", " "), f"{row[name]:.3f}", "N m"])
    return TextTable(["quantity", "value", "unit"], cells)


CURVE = (
    ("slip_ratio", "slip [-]", 1.0, 3),
    ("sinkage_m", "sinkage [mm]", 1e3, 2),
    ("normal_force_n", "normal [N]", 1.0, 2),
    ("drawbar_pull_n", "pull [N]", 1.0, 2),
    ("lateral_force_n", "lateral [N]", 1.0, 2),
    ("resistance_torque_nm", "torque [N m]", 1.0, 3),
    ("tractive_efficiency", "efficiency [-]", 1.0, 3),
)
"""Of a curve over slip: key, head, factor and digits."""


def _curve(rows: Sequence[Mapping[str, Any]]) -> TextTable:
    shown = [column for column in CURVE if column[0] in rows[0]]
    cells = [
        ["-" if row[key] is None else f"{factor * row[key]:.{digits}f}" for key, _, factor, digits in shown]
        for row in rows
    ]
    return TextTable([head for _, head, _, _ in shown], cells)


def _figures(traction: Traction) -> TextTable:
    rows: list[tuple[str, float | None, str]] = [
        ("pull at 20 % slip", traction.pull_at_20_n, "N"),
        ("pull per weight at 20 % slip", traction.pull_per_weight_at_20, "-"),
        ("tractive efficiency at 20 % slip", traction.efficiency_at_20, "-"),
        ("slope climbed at 20 % slip", traction.slope_at_20_deg, "deg"),
        ("slip without pull", traction.self_propelled_slip, "-"),
        ("best tractive efficiency", traction.best_efficiency, "-"),
        ("at a slip of", traction.best_efficiency_slip, "-"),
    ]
    cells = [[name, "none" if value is None else f"{value:.3g}", unit] for name, value, unit in rows]
    notes = ["the slope is that of wheels alone, each under its share of the load; a rover's weight shifts downhill"]
    return TextTable(["figure", "value", "unit"], cells, notes=notes)
