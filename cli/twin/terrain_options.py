"""Options of `lunarsci twin terrain`, by panel of its help."""

from typing import Annotated

import typer

__all__ = [
    "Baseline",
    "Craters",
    "Extent",
    "GroundSlope",
    "HazardDistance",
    "MaxRoughness",
    "MaxSlope",
    "MaxStep",
    "Rocks",
    "Roughness",
    "Seed",
    "SoilName",
    "Spacing",
    "Speed",
    "Start",
    "Target",
    "TurningRadius",
]

SoilName = Annotated[
    str | None,
    typer.Option(
        help="With -o, soil of terrain.npz in place of the terrain's: a name or a TOML file.",
        show_default="the terrain's, or longji",
    ),
]
Baseline = Annotated[
    float | None, typer.Option(help="Side in m of the square whose slope is measured; the rover's by default.")
]
PATH, LIMITS, GROUND = "Path", "Limits, instead of those of the rover file", "Synthetic ground"

Start = Annotated[
    str | None,
    typer.Option(
        help="Pose of the rover, in m and deg.", rich_help_panel=PATH, metavar="X,Y,HEADING", show_default="0,0,0"
    ),
]
Target = Annotated[
    str | None,
    typer.Option(
        help="Where to plan a path to, in m; with the heading there, in deg.",
        rich_help_panel=PATH,
        metavar="X,Y[,HEADING]",
    ),
]
Speed = Annotated[
    float | None, typer.Option(help="Speed in m/s; the rover's highest if left out.", rich_help_panel=PATH)
]
MaxSlope = Annotated[float | None, typer.Option(help="Steepest slope, in deg.", rich_help_panel=LIMITS)]
MaxStep = Annotated[float | None, typer.Option(help="Highest step, in m.", rich_help_panel=LIMITS)]
MaxRoughness = Annotated[float | None, typer.Option(help="Largest roughness, in m.", rich_help_panel=LIMITS)]
TurningRadius = Annotated[float | None, typer.Option(help="Smallest radius of an arc, in m.", rich_help_panel=LIMITS)]
HazardDistance = Annotated[
    float | None, typer.Option(help="Distance to keep from hazards and holes, in m.", rich_help_panel=LIMITS)
]
Seed = Annotated[int | None, typer.Option(help="Seed.", rich_help_panel=GROUND)]
Spacing = Annotated[float | None, typer.Option(help="Grid spacing, in m.", rich_help_panel=GROUND)]
Rocks = Annotated[
    float | None, typer.Option(help="Share of ground under rocks; 0.0021 at Chang'E-4.", rich_help_panel=GROUND)
]
Roughness = Annotated[
    float | None, typer.Option(help="Rms height of waves of 0.4 to 4 m, in m.", rich_help_panel=GROUND)
]
Extent = Annotated[float | None, typer.Option(help="Side of the square in m; not of Longji.", rich_help_panel=GROUND)]
GroundSlope = Annotated[float | None, typer.Option(help="Slope along x in deg; not of Longji.", rich_help_panel=GROUND)]
Craters = Annotated[int | None, typer.Option(help="Number of craters; not of Longji.", rich_help_panel=GROUND)]
