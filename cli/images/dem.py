"""`lunarsci images dem`: heights from a pair of pictures."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.images.jobs.requests import DemRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.images.jobs.dem import StereoTerrain

FILES = "Files"
OPTIONS = {
    "rig": option(metavar="RIG"),
    "pose": option(metavar="FILE", show_default="ground near the rover taken as level"),
    "tilt_error": option(),
    "spacing": option(),
    "nearest": option(show_default="from rig and pose"),
    "farthest": option(show_default="where its error is three cells"),
}
Left = Annotated[str, typer.Argument(metavar="LEFT", help="Left picture: PNG, TIFF, JPEG, or a PDS4 label.")]
Right = Annotated[str, typer.Argument(metavar="RIGHT", help="Right picture, of the same moment.")]
Terrain = Annotated[
    Path | None,
    typer.Option(
        "--save-terrain",
        metavar="FILE",
        rich_help_panel=FILES,
        help="The elevation model: .npz or .tif, for `twin terrain`.",
    ),
]
Disparity = Annotated[
    Path | None,
    typer.Option(
        "--save-disparity",
        metavar="FILE",
        rich_help_panel=FILES,
        help="Disparities: .npz with errors, or 16-bit .png (px/256).",
    ),
]
Cloud = Annotated[
    Path | None,
    typer.Option(
        "--save-cloud", metavar="FILE", rich_help_panel=FILES, help="The points as .ply, with grey and errors."
    ),
]
EXAMPLES = (
    "lunarsci images dem lunarsci-demo/left.png lunarsci-demo/right.png \\\n"
    "  --rig lunarsci-demo/rig.toml --pose lunarsci-demo/pose.toml \\\n"
    "  --save-terrain dem.npz",
    "lunarsci images dem lunarsci-demo/left.png lunarsci-demo/right.png \\\n"
    "  --rig lunarsci-demo/rig.toml --spacing 0.05 --save-terrain coarse.npz \\\n"
    "  --save-cloud cloud.ply --save-disparity disparity.png",
)


@command("dem", EXAMPLES, OPTIONS)
def dem(
    left: Left,
    right: Right,
    request: DemRequest,
    output: Output,
    terrain: Terrain = None,
    disparity: Disparity = None,
    cloud: Cloud = None,
) -> Report:
    """Heights on a grid from a stereo pair, each with a random error and one that all share.

    OpenCV (extra `images`) matches the rectified pictures. Least squares refine each disparity and give its error.
    There is no height where shadow, occlusion or a lack of texture leave no match; the picture of --plot says which it
    was. `images track` and `twin terrain` read the model.
    """
    from lunarsci.images.jobs.dem import dem

    output.check_extra("--save-terrain", terrain, (".npz", ".tif", ".tiff"))
    output.check_extra("--save-disparity", disparity, (".npz", ".png"))
    output.check_extra("--save-cloud", cloud, (".ply",))
    made = dem(left, right, request, progress=output.progress("matching"))
    files = {terrain: made.terrain_bytes, disparity: made.disparity_bytes, cloud: lambda _: made.cloud_bytes()}
    extras = {path: partial(content, path.suffix.lower()) for path, content in files.items() if path is not None}
    return Report(made, result_tables(made), extras=extras)


def result_tables(result: StereoTerrain) -> list[TextTable]:
    record = result.to_dict()
    terrain, pixels = record["terrain"], record["pixels"]
    rows = [
        [
            f"{row['range_from_m']:g} to {row['range_to_m']:.3g}",
            str(row["nodes"]),
            f"{1e3 * row['median_height_m_sigma']:.2f}",
            f"{1e3 * row['median_height_m_common_sigma']:.2f}",
            f"{row['median_count']:.1f}",
            f"{1e3 * row['median_resolution_m']:.0f}",
        ]
        for row in record["ranges"]
    ]
    (west, east), (south, north) = terrain["x_m"], terrain["y_m"]
    nodes = "{} x {}".format(*terrain["nodes"])
    title = f"{terrain['name']}: x {west:.2f} to {east:.2f} m, y {south:.2f} to {north:.2f} m, {nodes} nodes"
    without = ", ".join(f"{name.replace('_', ' ')} {share:.1%}" for name, share in pixels.items() if share >= 5e-4)
    notes = [
        f"pixels: {without}",
        f"rows of the pictures were {record['row_offset_px']:.2f} px apart; holes {terrain['hole_share']:.0%}",
        *record["notes"],
    ]
    headers = ["range [m]", "nodes", "random [mm]", "common [mm]", "pixels a node", "resolution [mm]"]
    return [TextTable(headers, rows, title=title, notes=notes)]
