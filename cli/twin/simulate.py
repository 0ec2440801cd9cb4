"""`lunarsci twin simulate`: a made-up drive and the telemetry it would send."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lunarsci.twin.jobs.requests import SimulateDriveRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable
from .options import BEFORE, GRAVITY, HEIGHT_UNIT, INTERPOLATION, ROVER, RUTS, SEED, TERRAIN, TIME_STEP, PlanFile

if TYPE_CHECKING:
    from lunarsci.twin.jobs.simulate import MadeUpDrive

TELEMETRY = "Telemetry"
OPTIONS = {
    "rover": ROVER,
    "terrain": TERRAIN,
    "height_unit": HEIGHT_UNIT,
    "gravity": GRAVITY,
    "interpolation": INTERPOLATION,
    "soil": option(show_default="the terrain's, or longji"),
    "ruts": RUTS,
    "before": BEFORE,
    "fix_distance": option(panel=TELEMETRY),
    "fix_sigma": option(panel=TELEMETRY),
    "yaw_sigma": option(panel=TELEMETRY),
    "track_sigma": option(panel=TELEMETRY),
    "seed": SEED,
    "time_step": TIME_STEP,
    "sample": option(panel=TELEMETRY),
}
EXAMPLES = (
    "lunarsci twin simulate plan.toml --seed 5 -o drive",
    "lunarsci twin simulate plan.toml --soil lunar-typical --fix-distance 1",
)


@command("simulate", EXAMPLES, OPTIONS, folder=True)
def simulate(output: Output, request: SimulateDriveRequest, plan: PlanFile = None) -> Report:
    """Drive a plan once on one soil and write the telemetry that such a drive would send, sensor errors included.

    In a plan with localisation updates the rover halts after each leg, and steers on from where it then believes to be.
    Telemetry has these positions, and a column for halts.

    -o DIR writes the telemetry to telemetry.csv, the depth of the track to track.csv, and the truth behind both to
    truth.csv. All of it is made up and says so. `lunarsci twin states` reads the first two.
    """
    from lunarsci.twin.jobs.simulate import simulate_drive

    drive = simulate_drive(plan, request, progress=output.progress("driving"))
    return Report(drive, [_table(drive)], files=drive.files())


def _table(made: MadeUpDrive) -> TextTable:
    errors, result = made.drive.errors, made.to_dict()
    rows = [
        ["localised positions", str(result["positions"]), f"{1e3 * errors.position_m:.3g} mm"],
        ["heading", str(result["rows"]), f"{errors.yaw_deg:.3g} deg"],
        ["roll, pitch", str(result["rows"]), f"{errors.tilt_deg:.3g} deg"],
        ["wheel angles", str(result["rows"]), f"{errors.wheel_angle_deg:.3g} deg"],
        ["wheel rates", str(result["rows"]), f"{errors.wheel_rate_deg_s:.3g} deg/s"],
        ["wheel steering", str(result["rows"]), f"{errors.steered_deg:.3g} deg"],
        ["depth of the track", str(result["track_points"]), f"{1e3 * errors.track_m:.3g} mm"],
    ]
    halts = result.get("halts", [])
    if made.drive.prediction.plan.fixes is not None:
        sigma = made.drive.prediction.plan.fixes.position_sigma_m
        rows.insert(1, ["of these at halts", str(len(halts)), f"{1e3 * sigma:.3g} mm"])
    notes = [
        "Synthetic: made up, not a measurement. The track is as deep as the deepest wheel that passed.",
        "Errors of positions and track follow Ding et al. (2024); the others are assumed.",
    ]
    place = result["terrain"]["name"]
    title = f"Telemetry of a made-up drive: {result['plan']}, {result['duration_s']:.4g} s on {place}"
    return TextTable(["measured", "values", "standard error"], rows, title=title, notes=notes)
