"""Options that the commands of `lunarsci twin` share."""

from typing import Annotated

import typer

from ..shared.options import option

__all__ = [
    "BEFORE",
    "FIXES",
    "INTERPOLATION",
    "MEMBERS",
    "ROVER",
    "RUTS",
    "SAMPLE",
    "SEED",
    "SOILS",
    "SWEEP",
    "TERRAIN",
    "TIME_STEP",
    "Fixes",
    "Interpolation",
    "Members",
    "PlanFile",
    "RoverName",
    "Sample",
    "Samples",
    "Seed",
    "SoilName",
    "Sweeps",
    "TerrainName",
    "TimeStep",
]

PlanFile = Annotated[
    str | None, typer.Argument(help="Plan of the drive (TOML); the embedded one of Yutu-2 to the rock if left out.")
]
RoverName = Annotated[
    str | None,
    typer.Option(help="Rover: a name (yutu2, small-four) or a TOML file.", show_default="yutu2"),
]
TerrainName = Annotated[
    str, typer.Option(help="Terrain: synthetic-longji, or a file (.npz, GeoTIFF, ESRI ASCII .asc, CSV of nodes).")
]
Interpolation = Annotated[
    str, typer.Option(help="Ground between nodes: smooth (continuous gradient) or triangles (as in the paper).")
]
SoilName = Annotated[
    str | None,
    typer.Option(
        help="Soil, in place of the terrain's: a name or a TOML file; or a belief of `twin update` (.json), and each "
        "drive has a soil drawn from it, 64 unless --members is given.",
        show_default="the terrain's, or longji",
    ),
]
Sweeps = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=LOW:HIGH:N", help="Uncertain soil parameter, repeatable; replaces the plan's sweeps."),
]
Samples = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Soils to drive on instead of a sweep: CSV, a row each, or a belief of `twin update` (.json).",
    ),
]
Members = Annotated[
    int | None,
    typer.Option(min=1, help="Number of drives: samples of the ranges instead of the grid of all values, or draws."),
]
Fixes = Annotated[
    str | None,
    typer.Option(metavar="M,DEG", help="Position fixes after each leg, standard errors in position and heading."),
]
Ruts = Annotated[
    bool | None,
    typer.Option(
        "--ruts/--no-ruts",
        help="Whether wheels meet the ruts that others, and they themselves, left. With --soil of a belief as its last "
        "drive did, else no, if left out.",
    ),
]
Before = Annotated[
    str | None,
    typer.Option(metavar="PLAN", help="A plan that was driven on the same ground before; its ruts are met, too."),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
TimeStep = Annotated[float, typer.Option(help="Longest time step in s.")]
Sample = Annotated[float, typer.Option(help="Distance between recorded states in m.")]

ROVER = option("Rover: a name (yutu2, small-four) or a TOML file.", show_default="yutu2")
TERRAIN = option("Terrain: synthetic-longji, or a file (.npz, GeoTIFF, ESRI ASCII .asc, CSV of nodes).")
INTERPOLATION = option("Ground between nodes: smooth (continuous gradient) or triangles (as in the paper).")
SOILS = option(
    "Soil, in place of the terrain's: a name or a TOML file; or a file from which each drive has its own: CSV with a "
    "row each, a belief of `twin update` or its map (JSON), from which 64 are drawn unless --members is given. "
    "Repeatable: a name beside a CSV that lacks parameters.",
    show_default="the terrain's, or longji",
)
SWEEP = option("Uncertain soil parameter, repeatable; replaces the plan's sweeps.", metavar="NAME=LOW:HIGH:N")
MEMBERS = option("Number of drives: samples of the ranges instead of the grid of all values, or draws.", min=1)
FIXES = option("Position fixes after each leg, standard errors in position and heading.", metavar="M,DEG")
RUTS = option(
    "Whether wheels meet the ruts that others, and they themselves, left. With --soil of a belief as its last drive "
    "did, else no, if left out.",
    "--ruts/--no-ruts",
)
BEFORE = option("A plan that was driven on the same ground before; its ruts are met, too.", metavar="PLAN")
SEED = option("Seed of everything random.", min=0, show_default="0")
TIME_STEP = option("Longest time step in s.")
SAMPLE = option("Distance between recorded states in m.")
