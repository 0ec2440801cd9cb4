"""Pictures of a rover: its cameras, and what can be measured in pairs of pictures."""

from typing import Literal, TypeAlias

LengthUnit: TypeAlias = Literal["m", "cm", "mm"]
"""Units of translations in files of rigs."""
