"""`lunarsci images render`: SYNTHETIC pairs of pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.images.jobs.requests import RenderRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.images.jobs.render import SyntheticPair

CAMERA, GROUND, LIGHT = "Camera", "Ground", "Light"
OPTIONS = {
    "rig": option(panel=CAMERA),
    "x": option(panel=CAMERA),
    "y": option(panel=CAMERA),
    "heading": option(panel=CAMERA),
    "down": option(panel=CAMERA),
    "roll": option(panel=CAMERA),
    "height": option(panel=CAMERA, show_default="the rig's mast"),
    "samples": option("--rays", panel=CAMERA),
    "exact": option("--exact-rig", panel=CAMERA),
    "spacing": option(panel=GROUND),
    "rocks": option("--rock-density", panel=GROUND),
    "roughness": option("--roughness-factor", panel=GROUND),
    "track": option(panel=GROUND),
    "track_width": option(panel=GROUND),
    "seed": option(panel=GROUND),
    "sun_azimuth": option(panel=LIGHT),
    "sun_elevation": option(panel=LIGHT),
    "law": option("--scattering", panel=LIGHT),
}
Terrain = Annotated[
    str | None, typer.Argument(metavar="[TERRAIN]", help="Ground; where it is left out, level, 24 m wide about 0, 0.")
]
EXAMPLES = (
    "lunarsci images render --rig lunarsci-demo/rig.toml --rays 1 -o pair",
    "lunarsci images render --rig lunarsci-demo/rig.toml --rays 1 \\\n  --x 0.5 -o station-2",
)


@command("render", EXAMPLES, OPTIONS, folder=True)
def render(output: Output, request: RenderRequest, terrain: Terrain = None) -> Report:
    """SYNTHETIC pictures of a terrain by a stereo rig: hard shadows, blur, noise, vignetting.

    With -o DIR they go to left.png and right.png, with rig.toml and pose.toml, which `images dem` reads, and truth.npz:
    where each pixel looks, whether the Sun reaches it and the other camera sees it. With one --seed the ground is the
    same from every place.
    """
    from lunarsci.images.jobs.render import render

    result = render(terrain, request, progress=output.progress("rendering"))
    return Report(result, result_tables(result), files=result.files())


def result_tables(result: SyntheticPair) -> list[TextTable]:
    """What the pixels show."""
    record = result.to_dict()
    pixels = {name.replace("_", " "): share for name, share in record["pixels"].items()}
    position = ", ".join(f"{v:.3f}" for v in record["pose"]["position_m"])
    notes = [
        f"left camera at {position} m, {record['pose']['down_deg']:.1f} deg below the horizon; {record['rocks']} rocks",
        "SYNTHETIC: ground, rocks and light are made up",
    ]
    rows = [[name, f"{share:.1%}"] for name, share in pixels.items()]
    return [TextTable(["pixels", "share"], rows, title=f"SYNTHETIC pair of {record['rig']['name']}", notes=notes)]
