"""Physical constants, each with unit, uncertainty and source in one object; and what results cite."""

from dataclasses import dataclass

from lunarsci.errors import ParameterError
from lunarsci.ranges import POSITIVE, check_range


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

MARTIAN_GRAVITY = Constant(
    3.71, "m s-2", 0.03,
    "Williams, Mars Fact Sheet, NASA Goddard Space Flight Center: mean surface gravity 3.71 m s-2; equator and pole "
    "differ by 0.05.",
)  # fmt: skip
STANDARD_GRAVITY = Constant(
    9.80665, "m s-2", 0.03, "3rd Conference generale des poids et mesures (1901), by definition; 9.78 to 9.83 on Earth."
)
GRAVITIES = {"moon": LUNAR_GRAVITY, "mars": MARTIAN_GRAVITY, "earth": STANDARD_GRAVITY}
"""By the name of the body."""


def gravity_of(gravity: str | float) -> float:
    """Of `moon`, `mars`, `earth`, or a number. [m/s2] Raises ParameterError for anything else."""
    tabulated = GRAVITIES.get(str(gravity).strip().lower())
    try:
        value = float(gravity) if tabulated is None else tabulated.value
        check_range("gravity", value, POSITIVE)
    except ValueError as error:
        raise ParameterError(f"gravity is '{gravity}'; give {', '.join(GRAVITIES)}, or m/s2 above 0") from error
    return value


MOON_RADIUS_KM = 1737.4
"""Mean radius, Archinal et al. (2018), Celest. Mech. Dyn. Astron. 130, 22, 10.1007/s10569-017-9805-5. [km]"""

PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"
MGM = "Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955, 10.1029/JB095iB05p06955"
NBSR = "Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025"
SMOOTHING = "Savitzky & Golay (1964), Anal. Chem. 36, 1627, 10.1021/ac60214a047"
HAPKE = "Hapke (1981), J. Geophys. Res. 86, 3039, 10.1029/JB086iB04p03039"
ABSORBANCE = "Clark & Roush (1984), J. Geophys. Res. 89, 6329, 10.1029/JB089iB07p06329"
WEATHERING = "Hapke (2001), J. Geophys. Res. 106, 10039, 10.1029/2000JE001338"
