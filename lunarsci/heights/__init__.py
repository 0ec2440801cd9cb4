"""Heights on grids: their files, units, marks of no data and projections."""

from typing import Literal

HeightUnit = Literal["m", "km", "dm", "cm", "mm", "ft", "us-ft"]
"""Names of options."""
