"""`lunarsci images render`: SYNTHETIC pairs of pictures."""

from typing import Annotated

import typer

from lunarsci.images.jobs.render import RenderRequest, SyntheticPair

from ..shared.command import command
from ..shared.options import Output, option
from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import TextTable

CAMERA, GROUND, LIGHT = "Camera", "Ground", "Light"
OPTIONS = {
    "rig": option("The cameras: yutu2-pancam, yutu2-navcam, yutu2-hazcam, or a TOML file.", panel=CAMERA),
    "x": option("Where the left camera is, along x, in m.", panel=CAMERA),
    "y": option("Where the left camera is, along y, in m.", panel=CAMERA),
    "heading": option("Where it looks, from x towards y, in deg.", panel=CAMERA),
    "down": option("How far below the horizon, in deg.", panel=CAMERA),
    "roll": option("Turned clockwise about its axis, in deg.", panel=CAMERA),
    "height": option("Over the ground, in m.", panel=CAMERA, show_default="the rig's mast"),
    "samples": option("Rays along each side of a pixel.", "--rays", panel=CAMERA),
    "exact": option("Take the rig as it is, not a draw from its covariance.", "--exact-rig", panel=CAMERA),
    "spacing": option("Side of the ground's triangles, in m.", panel=GROUND),
    "rocks": option("Rocks of 4 cm and more on a square metre.", "--rock-density", panel=GROUND),
    "roughness": option(
        "Factor on the roughness assumed of regolith; 0 leaves the terrain as it is.",
        "--roughness-factor",
        panel=GROUND,
    ),
    "track": option(
        "What wheels left: CSV of x_m, y_m, and rut_m or sinkage_m; the ground is lower there.", panel=GROUND
    ),
    "track_width": option("Width of the wheels, in m.", panel=GROUND),
    "seed": option("Seed of ground, noise and the rig's draw.", panel=GROUND),
    "sun_azimuth": option("Where the Sun is, from x towards y, in deg.", panel=LIGHT),
    "sun_elevation": option("Over the horizon, in deg.", panel=LIGHT),
    "law": option("How the ground scatters light.", "--scattering", panel=LIGHT),
}
Terrain = Annotated[str | None, typer.Argument(metavar="[TERRAIN]", help="Ground; level where it is left out.")]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "render", folder=True, request=RenderRequest, options=OPTIONS)(render)


def render(output: Output, request: RenderRequest, terrain: Terrain = None) -> Report:
    """SYNTHETIC pictures of a terrain by a stereo rig: hard shadows, blur, noise, vignetting.

    With -o DIR they go to left.png and right.png, with rig.toml and pose.toml, which `images dem` reads, and truth.npz:
    where each pixel looks, whether the Sun reaches it and the other camera sees it.
    """
    from lunarsci.images.jobs.render import render

    with progress("rendering", quiet=output.quiet) as update:
        found = render(terrain, request, progress=update)
    return Report.of(found, result_tables(found), files=found.files())


def result_tables(found: SyntheticPair) -> list[TextTable]:
    """What the pixels show."""
    result = found.to_dict()
    pixels = {name.replace("_", " "): share for name, share in result["pixels"].items()}
    position = ", ".join(f"{v:.3f}" for v in result["pose"]["position_m"])
    notes = [
        f"left camera at {position} m, {result['pose']['down_deg']:.1f} deg below the horizon; {result['rocks']} rocks",
        "SYNTHETIC: ground, rocks and light are made up",
    ]
    rows = [[name, f"{share:.1%}"] for name, share in pixels.items()]
    return [TextTable(["pixels", "share"], rows, title=f"SYNTHETIC pair of {result['rig']['name']}", notes=notes)]
