"""`lunarsci images calibrate`: cameras from pictures of a board."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.images.jobs.requests import CalibrateCamerasRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus
from .cameras import SHOWN, number

if TYPE_CHECKING:
    from lunarsci.images.jobs.calibrate_cameras import CalibratedCameras

BOARD = "Board"
OPTIONS = {
    "target": option("--pattern", panel=BOARD),
    "board": option(metavar="CxR", panel=BOARD),
    "square": option(panel=BOARD),
    "marker": option(panel=BOARD),
    "circle": option(panel=BOARD),
    "dictionary": option(panel=BOARD),
    "square_error": option(panel=BOARD),
    "distortion": option(kind=int),
    "name": option(),
}
Pictures = Annotated[
    list[str],
    typer.Argument(
        metavar="PICTURES...", help="Pictures of the board, or a pattern in quotes; of a rig those of the left one."
    ),
]
Right = Annotated[
    str | None,
    typer.Option(
        "--right",
        metavar="PATTERN",
        help="Pictures of the right camera: a pattern in quotes, such as 'right*.png'. Numbers in the names pair them.",
    ),
]
EXAMPLES = (
    "lunarsci images calibrate left*.png --board 9x6 --square 0.03",
    "lunarsci images calibrate left*.png --right 'right*.png' --board 9x6 \\\n  --square 0.03 -o rig.toml",
)


@command("calibrate", EXAMPLES, OPTIONS)
def calibrate(output: Output, pictures: Pictures, request: CalibrateCamerasRequest, right: Right = None) -> Report:
    """Camera or stereo rig from pictures of a chessboard, a grid of circles or a charuco board, with errors.

    Give 12 pictures or more, with the board tilted by 30 deg each way and everywhere in the picture. -o FILE.toml
    writes the rig with its covariance for `images dem`. --plot shows residuals, and how uncertain directions are. Exit
    code 3: the pictures leave focal length or baseline open.
    """
    from lunarsci.images.calibration import pictures_matching
    from lunarsci.images.jobs.calibrate_cameras import calibrate_cameras

    cameras = calibrate_cameras(
        pictures_matching(pictures),
        pictures_matching([right] if right else [], "right"),
        request,
        progress=output.progress("looking for the board"),
    )

    return Report(cameras, result_tables(cameras), formats={".toml": lambda _: cameras.toml()})


def result_tables(result: CalibratedCameras) -> list[TextTable]:
    record = result.to_dict()
    cameras = list(record["cameras"].values())
    rows = [[name, *(number(name, camera) for camera in cameras)] for name in SHOWN]
    rows.append(["residual [px]", *(f"{camera['residual_rms_px']:.3f}" for camera in cameras)])
    rows.append(["seen", *(f"{camera['seen_share']:.0%}" for camera in cameras)])
    rows.append(["edge uncertain by [px]", *(f"{camera['corner_uncertainty_px']:.2f}" for camera in cameras)])
    notes = [f"not determined: {line}" for line in record["not_determined"]] + record["notes"]
    if "baseline_m" in record:
        notes.insert(
            0, f"baseline {plus_minus(1e3 * record['baseline_m'], 1e3 * record['baseline_m_sigma'], digits=2)} mm"
        )
    title = (
        f"{result.request.name}: residuals {record['residual_px']:.3f} px, {record['left_out_points']} points left out"
    )
    whole = TextTable(["", *record["cameras"]], rows, title=title, notes=notes)
    pictures = [
        [row["file"], str(row["points"]), str(row["used"])]
        + ["-" if row[key] is None else f"{row[key]:.3f}" for key in ("rms_px", "largest_px")]
        for row in record["pictures"]
    ]
    return [whole, TextTable(["picture", "points", "used", "rms [px]", "largest [px]"], pictures, title="Pictures")]
