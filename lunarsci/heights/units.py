"""Units of heights: their names in files and options, and the metres in them."""

import re
from typing import Literal, get_args

from lunarsci.errors import ParameterError
from lunarsci.names import one_of

HeightUnit = Literal["m", "km", "dm", "cm", "mm", "ft", "us-ft"]
"""Names of options."""
METRES = {
    1.0: ("m", "metre", "meter"),
    1e3: ("km", "kilometre", "kilometer"),
    0.1: ("dm", "decimetre", "decimeter"),
    0.01: ("cm", "centimetre", "centimeter"),
    1e-3: ("mm", "millimetre", "millimeter"),
    0.3048: ("ft", "foot", "feet", "foot international", "international foot", "international feet", "ft intl"),
    1200.0 / 3937.0: ("us ft", "ft us", "ftus", "usft", "us survey foot", "us survey feet", "survey foot", "foot us"),
}
"""Metres in a unit, exactly, and its names in small letters (Thompson & Taylor 2008, NIST Special Publication 811, B.6
for feet)."""
NO_UNIT = ("", "none", "n a", "unk", "unknown", "null", "unspecified")
"""What stands for no unit."""


def metres_in(unit: str) -> float | None:
    """Metres in a unit of length, by one of its usual names; None where it is the name of none.

    >>> metres_in("Kilometers"), metres_in("US_survey_foot") == 1200 / 3937, metres_in("N/A")
    (1000.0, True, None)

    Raises ParameterError for a name that is not known.
    """
    plain = " ".join(re.sub(r"[^a-z]+", " ", unit.lower().replace(".", "")).split())
    if plain in NO_UNIT:
        return None
    for metres, names in METRES.items():
        if plain in names or plain.removesuffix("s") in names:
            return metres
    raise ParameterError(f"'{unit}' is no unit of length that is known; {one_of(unit, get_args(HeightUnit))}")
