"""Heights on grids: their files, units, marks of no data and projections."""

from typing import Literal

HeightUnit = Literal["m", "km", "dm", "cm", "mm", "ft", "us-ft"]
"""Names of options."""
TERRAINS = ("terrain", "terrains", "local", "track", "before")
"""Inputs of jobs that are heights on a grid, by their names."""
