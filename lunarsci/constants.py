"""Physical constants, each with unit, uncertainty and source in one object."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Constant:
    """A number that cannot be separated from its unit, uncertainty and source."""

    value: float
    unit: str
    uncertainty: float
    source: str


LUNAR_GRAVITY = Constant(
    1.622,
    "m s-2",
    0.02,
    "Vaniman, Reedy, Heiken, Olhoeft & Mendell (1991), Lunar Sourcebook ch. 3: mean surface gravity 1.62 m s-2; "
    "GM/R^2 with GM = 4902.8 km3 s-2 and R = 1738.0 km gives 1.623. The uncertainty is the spread over the surface.",
)
