"""Options that the commands of `lunarsci twin` share."""

from typing import Annotated

import typer

from ..shared.options import option

PlanFile = Annotated[
    str | None, typer.Argument(help="Plan of the drive (TOML); the embedded one of Yutu-2 to the rock if left out.")
]
GROUND, SOIL, LIGHT, STEPS = "Rover and ground", "Soil and drives", "Sun and battery", "Steps and draws"
ROVER = option(show_default="yutu2", panel=GROUND)
TERRAIN = option(show_default="synthetic-longji", panel=GROUND)
HEIGHT_UNIT = option(show_default="what the file states, or m", panel=GROUND)
GRAVITY = option(show_default="moon", panel=GROUND)
AS_WRITTEN = option(panel=GROUND)
INTERPOLATION = option(panel=GROUND)
SOILS = option(show_default="the terrain's, or longji", panel=SOIL)
SWEEP = option(metavar="NAME=LOW:HIGH:N", panel=SOIL)
MEMBERS = option(min=1, panel=SOIL)
FIXES = option(metavar="M,DEG[,S]", panel=SOIL)
RUTS = option("--ruts/--no-ruts", panel=GROUND)
BEFORE = option(metavar="PLAN", panel=GROUND)
EXACT_TERRAIN = option(panel=GROUND)
KEEP_OUT = option(metavar="FILE", panel=GROUND)
SUN = option(metavar="AZIMUTH,ELEVATION", panel=LIGHT)
CHARGE = option(show_default="1", panel=LIGHT)
SEED = option(min=0, show_default="0", panel=STEPS)
TIME_STEP = option(panel=STEPS)
SAMPLE = option(panel=STEPS)
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
