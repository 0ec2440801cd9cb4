"""Pictures of a rover: its cameras, and what can be measured in pairs of pictures."""

from typing import Literal, TypeAlias

Law: TypeAlias = Literal["lommel-seeliger", "hapke"]
"""How the ground of a rendered picture scatters light."""
LengthUnit: TypeAlias = Literal["m", "cm", "mm"]
"""Units of translations in files of rigs."""
