"""`lunarsci twin states`: from telemetry to slip, side slip and sinkage of every wheel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.twin.jobs.requests import StatesRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import option
from ..shared.table import TextTable, plus_minus
from .forces import spread_headers
from .options import GRAVITY, HEIGHT_UNIT, INTERPOLATION, ROVER, TERRAIN

if TYPE_CHECKING:
    from lunarsci.twin.jobs.states import MeasuredStates

OPTIONS = {
    "rover": ROVER,
    "terrain": TERRAIN,
    "height_unit": HEIGHT_UNIT,
    "gravity": GRAVITY,
    "interpolation": INTERPOLATION,
    "positions": option(kind=str | None, metavar="FILE"),
    "track": option(kind=str | None, metavar="FILE"),
    "since": option(metavar="S"),
    "until": option(metavar="S"),
    "start_time": option(metavar="S"),
    "lag": option(metavar="S"),
}
Telemetry = Annotated[
    str,
    typer.Argument(
        help="Telemetry: .csv, .ecsv or .parquet, - for CSV from stdin. time_s, x_m, y_m, sigma_m, yaw_deg, and of "
        "each wheel such as FL: angle_FL_deg, rate_FL_deg_s or speed_FL_m_s, and steered_FL_deg or steering_FL_deg. "
        "`lunarsci template telemetry` has all columns. Or a trial of a public data set, a folder or its table."
    ),
]
DrivenPlan = Annotated[
    str | None, typer.Argument(help="Plan that was driven (TOML), to compare clock, commands and speed with.")
]
FACTORS = {"slip_ratio": 1.0, "side_slip_deg": 1.0, "sinkage_m": 1e3}
"""By what numbers of a column are multiplied in the table: sinkage is in mm."""
EXAMPLES = (
    "lunarsci twin states drive/telemetry.csv plan.toml \\\n  --track drive/track.csv -o states",
    "lunarsci twin states drive/telemetry.csv --csv",
)


@command("states", EXAMPLES, OPTIONS, folder=True)
def states(telemetry: Telemetry, request: StatesRequest, plan: DrivenPlan = None) -> Report:
    """Slip, side slip and sinkage of every wheel, with their errors, from the telemetry of a drive.

    Slip and side slip follow from positions, headings and wheels, and from the slopes of the terrain: one state between
    two positions at most. How fast they change besides is found from the data and stated. Sinkage follows from the
    track, for the deepest wheel that passed; that of the others stays blank.

    Errors of the telemetry itself are unknowns, too: the localised point, a drift of headings, a lag of the clock,
    scales of the encoders, the rolling radius of the wheels, positions whose errors walk, slides at halts. They widen
    the errors of the states, and those more probable than not are listed. Units and axes are read as they are most
    probably meant; the result says how. Exit code 3: the result should not be trusted.

    Files of any length are read in pieces. Of a rover that stands for long only rows beside drives and with a new
    position are kept. --since and --until take a part.

    Slip is that of the rolling radius r_s = r + lambda_s h, with grousers of height h. Its errors include 3 % of that
    radius, which all states share (column slip_ratio_shared). A warning names wheels that turned more than 2 % off the
    plan's speed: a soil learned with this plan would be another.

    -o DIR writes the states to states.csv, the positions to positions.csv, and the smoothed motion to motion.csv, for
    `lunarsci twin update` and `lunarsci twin loads`.
    """
    from lunarsci.twin.jobs.states import states

    result = states(telemetry, plan, request)
    return Report(result, result_tables(result), files=result.files())


def result_tables(result: MeasuredStates) -> list[TextTable]:
    record = result.to_dict()
    return [_wheel_table(result, record), *_finding_tables(record["findings"])]


def _wheel_table(result: MeasuredStates, record: dict[str, Any]) -> TextTable:
    from lunarsci.twin.jobs.states import DEEPEST

    rows = [
        [
            wheel,
            str(row["measured"]),
            *(cell for name, factor in FACTORS.items() for cell in _cells(row[name], factor)),
        ]
        for wheel, row in record["wheels"].items()
    ]
    changes = record["slip_changes"]["ahead"]
    notes = [
        f"the rover drove {record['distance_m']:.3g} m in {record['duration_s']:.4g} s; its wheels rolled "
        f"{record['wheel_distance_m']:.3g} m, so that the overall slip is "
        f"{1.0 - record['distance_m'] / max(record['wheel_distance_m'], 1e-9):.3f}",
        f"{record['positions']} positions scatter about the motion with a reduced chi-square of "
        f"{record['reduced_chi_square']:.2f}",
        f"beside what slopes do, slip varies by {changes['amplitude'] / changes['amplitude_factor']:.2g} to "
        f"{changes['amplitude'] * changes['amplitude_factor']:.2g} within {changes['length_m']:.2g} m of the way",
        DEEPEST if record["sinkages"] else _no_sinkage(result),
    ]
    if put_back := record["lag"]["put_back_s"]:
        notes.append(f"positions, headings and attitude were put back by {put_back:g} s to their wheels (--lag)")
    notes.append(_rolling_note(result, record))
    if not result.planned:
        notes.append("clock, commands and speed were not compared with a plan: none was given")
    elif result.drive.pace is not None and not result.drive.pace.off:
        notes.append(result.drive.pace.text)
    if record["synthetic"]:
        notes.append("the telemetry is synthetic")
    if record["terrain"]["synthetic"]:
        notes.append("the terrain is synthetic")
    headers = [head for name in ("slip [-]", "side slip [deg]", "sinkage [mm]") for head in spread_headers(name)]
    title = f"{result.title}; medians ± error of one state"
    return TextTable(["wheel", "states", *headers], rows, title=title, notes=notes)


def _no_sinkage(result: MeasuredStates) -> str:
    if result.inputs.options.get("track"):
        return "no sinkage: no point of the track shows the depth of a wheel"
    return "no sinkage: give the depth of the track with --track"


def _rolling_note(result: MeasuredStates, record: dict[str, Any]) -> str:
    """Which radius slip is of, and what it would be of the shell's."""
    wheel = result.drive.rover.wheel
    rolling, shell = 1e3 * wheel.shearing_radius_m, 1e3 * wheel.radius_m
    note = f"slip counts from the rolling radius r_s = {rolling:.4g} mm: the wheel's {shell:.4g} mm"
    if wheel.shearing_radius_m == wheel.radius_m:
        return note
    slips = [values["slip_ratio"]["median"] for values in record["wheels"].values() if values["slip_ratio"]["count"]]
    part = f"{note} and {wheel.grouser_shear_coefficient:g} times the grousers' {1e3 * wheel.grouser_height_m:.4g} mm"
    if not slips:
        return part
    of_shell = 1.0 - (1.0 - sum(slips) / len(slips)) * rolling / shell
    return f"{part}; counted from the wheel's radius alone, the mean slip is {of_shell:.3f}"


def _cells(values: dict[str, Any], factor: float) -> list[str]:
    if not values["count"]:
        return ["-", "-"]
    middle, low, high, sigma = (factor * values[name] for name in ("median", "low", "high", "sigma"))
    return [plus_minus(middle, sigma), f"{low:.3g} to {high:.3g}"]


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
