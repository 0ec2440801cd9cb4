"""Options that the commands of `lunarsci twin` share."""

from typing import Annotated

import typer

from ..shared.options import option

PlanFile = Annotated[
    str | None, typer.Argument(help="Plan of the drive (TOML); the embedded one of Yutu-2 to the rock if left out.")
]
GROUND, SOIL, LIGHT, STEPS = "Rover and ground", "Soil and drives", "Sun and battery", "Steps and draws"
ROVER = option("Rover: a name (yutu2, small-four) or a TOML file.", show_default="yutu2", panel=GROUND)
TERRAIN = option(
    "Terrain: synthetic-longji, or a file (.npz, GeoTIFF, PDS3, PDS4, ISIS, netCDF, ESRI ASCII .asc, CSV of nodes).",
    show_default="synthetic-longji",
    panel=GROUND,
)
HEIGHT_UNIT = option(
    "Unit of the terrain's heights, in place of what its file states.",
    show_default="what the file states, or m",
    panel=GROUND,
)
GRAVITY = option("Gravity: moon, mars, earth, or a number in m/s².", show_default="moon", panel=GROUND)
AS_WRITTEN = option(
    "Numbers of soil, rover, terrain and states are meant as they are written. Without it one that would be likely "
    "in another unit is asked about, and the result is not to be trusted.",
    panel=GROUND,
)
INTERPOLATION = option(
    "Ground between nodes: smooth (continuous gradient) or triangles (as in the paper).", panel=GROUND
)
SOILS = option(
    "Soil, in place of the terrain's: a name or a TOML file; or a file from which each drive has its own: CSV with a "
    "row each, a belief of `twin update` or its map (JSON), from which 64 are drawn unless --members is given; or "
    "`priors`, or a file of `template prior`: what is believed before any drive. "
    "Repeatable: a name beside a CSV that lacks parameters.",
    show_default="the terrain's, or longji",
    panel=SOIL,
)
SWEEP = option(
    "Uncertain soil parameter, repeatable; replaces the plan's sweeps.", metavar="NAME=LOW:HIGH:N", panel=SOIL
)
MEMBERS = option(
    "Number of drives: samples of the ranges instead of the grid of all values, or draws.", min=1, panel=SOIL
)
FIXES = option(
    "Position fixes after each leg: standard errors in position and heading, and the standstill in s that each takes.",
    metavar="M,DEG[,S]",
    panel=SOIL,
)
RUTS = option(
    "Whether wheels meet the ruts that others, and they themselves, left. With --soil of a belief as its last drive "
    "did, else no, if left out.",
    "--ruts/--no-ruts",
    panel=GROUND,
)
BEFORE = option(
    "A plan that was driven on the same ground before; its ruts are met, too.", metavar="PLAN", panel=GROUND
)
EXACT_TERRAIN = option(
    "Drive on the likely ground. Without it each drive has a ground of its own, drawn from what an elevation "
    "model of `images dem` or `images merge` says of its errors, or from the Moon's roughness where nodes lie wider "
    "apart than a wheel is large.",
    panel=GROUND,
)
KEEP_OUT = option(
    "Ground that no part of the rover may enter (GeoJSON), as `images rocks -o FILE.geojson` writes it; repeatable.",
    metavar="FILE",
    panel=GROUND,
)
SUN = option(
    "Direction of the Sun in deg, azimuth from x towards y (as headings) and elevation over the horizon; or time (UTC) "
    "and place, TIME@LON,LAT, where x is east and y north. Adds panels, shadow of the terrain and the battery.",
    metavar="AZIMUTH,ELEVATION",
    panel=LIGHT,
)
CHARGE = option(
    "Charge of the battery at the start, 0 to 1; adds electrical power and the battery.", show_default="1", panel=LIGHT
)
SEED = option("Seed of everything random.", min=0, show_default="0", panel=STEPS)
TIME_STEP = option("Longest time step in s.", panel=STEPS)
SAMPLE = option("Distance between recorded states in m.", panel=STEPS)
DRIVE = {
    "rover": ROVER,
    "terrain": TERRAIN,
    "height_unit": HEIGHT_UNIT,
    "gravity": GRAVITY,
    "interpolation": INTERPOLATION,
    "soil": SOILS,
    "sweep": SWEEP,
    "members": MEMBERS,
    "fixes": FIXES,
    "seed": SEED,
    "time_step": TIME_STEP,
    "sample": SAMPLE,
}
"""Those of a `DriveRequest`."""
