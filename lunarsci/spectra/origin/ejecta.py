"""How much ejecta of a crater lies at a distance, how fast it came, and how much local ground it stirred up.

How long rocks last on the surface.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.sphere import MOON_RADIUS_KM
from lunarsci.spectra.spectrum import FloatArray

__all__ = [
    "LAWS",
    "LAW_SOURCES",
    "MEASURED_SIZE_M",
    "SURVIVAL_SOURCE",
    "EjectaLaw",
    "Range",
    "ejecta_thickness_m",
    "launch_speed_m_s",
    "local_to_ejecta_ratio",
    "survival",
    "survival_shape",
    "transient_radius_km",
]

SURVIVAL_SOURCE = "Basilevsky, Head & Hoerz (2013), Planet. Space Sci. 89, 118, 10.1016/j.pss.2013.07.011"
MEASURED_SIZE_M = 2.0
"""Boulders of this size and more were counted by Basilevsky et al. (2013). [m]"""
NEARLY_ALL_GONE = 0.99
LIFE_RATIO = 3.75
"""Time to destroy 99 % of boulders over that to destroy half: 150-300 Ma over 40-80 Ma, Basilevsky et al. (2013)."""


@dataclass(frozen=True, slots=True)
class Range:
    """A quantity of which only the range is known: uniform in its logarithm. Both ends above 0; else ParameterError."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (0 < self.low <= self.high < np.inf):
            raise ParameterError(f"range {self.low:g} to {self.high:g} must rise, from above 0")

    def quantile(self, share: npt.ArrayLike) -> FloatArray:
        """Value below which this share (0 to 1) lies."""
        return np.asarray(self.low * (self.high / self.low) ** np.asarray(share, float))


def survival_shape() -> float:
    """Exponent k of the survival law, from the two published times: ln(ln 100 / ln 2) / ln 3.75 = 1.43."""
    return float(np.log(np.log(1 / (1 - NEARLY_ALL_GONE)) / np.log(2)) / np.log(LIFE_RATIO))


def survival(
    age_ma: npt.ArrayLike,
    median_life_ma: npt.ArrayLike,
    size_m: float = MEASURED_SIZE_M,
    size_exponent: float = 0.0,
) -> FloatArray:
    """Share of rocks that are left after lying on the surface for `age_ma`. [-]

    S = 2^-(age / life)^k with k of `survival_shape`, which passes through half at the median life and 1 % at 3.75
    lives (Basilevsky, Head & Hoerz 2013, boulders of 2 m and more). For other sizes the life is `median_life_ma`
    (size / 2 m)^`size_exponent`; no count constrains that exponent below 2 m. Raises ParameterError for a size of 0 or
    below.
    """
    if not 0 < size_m < np.inf:
        raise ParameterError(f"size of the rock is {size_m:g} m; it must be above 0")
    life = np.asarray(median_life_ma, float) * (size_m / MEASURED_SIZE_M) ** size_exponent
    return np.asarray(np.exp2(-((np.asarray(age_ma, float) / life) ** survival_shape())))


EjectaLaw = Literal["mcgetchin", "pike", "housen", "xie"]
LAWS: tuple[EjectaLaw, ...] = get_args(EjectaLaw)
LAW_SOURCES: dict[EjectaLaw, str] = {
    "mcgetchin": "McGetchin, Settle & Head (1973), Earth Planet. Sci. Lett. 20, 226, 10.1016/0012-821X(73)90162-3",
    "pike": "Pike (1974), Earth Planet. Sci. Lett. 23, 265, 10.1016/0012-821X(74)90114-9",
    "housen": "Housen, Schmidt & Holsapple (1983), J. Geophys. Res. 88, 2485, 10.1029/JB088iB03p02485",
    "xie": "Xie, Liu & Xu (2020), J. Geophys. Res. Planets 125, Ballistic sedimentation of impact crater ejecta",
}

SIMPLE_TO_COMPLEX_KM = 18.7
"""Rim diameter at which lunar craters turn complex, Croft (1985), J. Geophys. Res. 90, C828. [km]"""
SIMPLE_SHRINKAGE = 0.84
"""Transient over rim diameter of a simple crater, Melosh (1989), Impact Cratering, Oxford University Press."""
COLLAPSE_EXPONENT = 0.15
LAUNCH_ANGLE_DEG = 45.0
"""Launch from the horizontal; assumed, as in Xie et al. (2020)."""


def transient_radius_km(diameter_km: float) -> float:
    """Radius of the transient crater from the rim diameter. [km]

    0.84 D / 2 for a simple crater, 18.7^0.15 D^0.85 / 2 from 18.7 km on (Croft 1985, 10.1029/JB090iS02p0C828); the
    two differ by 16 % where they meet. Raises ParameterError for a diameter that is not above 0.
    """
    if not (np.isfinite(diameter_km) and diameter_km > 0):
        raise ParameterError(f"diameter is {diameter_km:g} km; it must be above 0")
    if diameter_km < SIMPLE_TO_COMPLEX_KM:
        return SIMPLE_SHRINKAGE * diameter_km / 2
    return float(SIMPLE_TO_COMPLEX_KM**COLLAPSE_EXPONENT * diameter_km ** (1 - COLLAPSE_EXPONENT) / 2)


def ejecta_thickness_m(law: EjectaLaw, diameter_km: float, distance_km: float) -> float | None:
    """Mean thickness of ejecta at a distance from the centre; None within the rim, where there is no blanket. [m]

    With R the transient radius [m] and x = r / R:

        mcgetchin  0.14 R^0.74 x^-3      pike  0.033 R x^-3
        housen     0.0078 R x^-2.61      xie   0.068 R x^-3

    Means over all directions: rays and secondaries make it vary by a factor of some 3. Laws of a flat Moon; from a
    quarter of its circumference (2729 km) on, ejecta converge on the antipode and there is more than this. Housen's
    law is for craters of 45-300 km. Sources in `LAW_SOURCES`. Raises ParameterError for an unknown law.
    """
    if law not in LAWS:
        raise ParameterError(f"ejecta law '{law}' is unknown; there are {', '.join(LAWS)}")
    if distance_km <= diameter_km / 2:
        return None
    radius = 1e3 * transient_radius_km(diameter_km)
    steps = 1e3 * distance_km / radius
    if law == "mcgetchin":
        return float(0.14 * radius**0.74 * steps**-3)
    if law == "housen":
        return float(0.0078 * radius * steps**-2.61)
    return float((0.033 if law == "pike" else 0.068) * radius * steps**-3)


def launch_speed_m_s(diameter_km: float, distance_km: float) -> float | None:
    """Speed with which ejecta left the transient rim, at 45 deg, to land at a distance from the centre. [m/s]

    v^2 = R g tan(p) / (tan(p) cos^2 a + sin a cos a), p the half angle of the flight seen from the Moon's centre:
    the exact ballistic range on a sphere. It is also the speed of impact, which decides whether rocks survive it. None
    within the rim.
    """
    flight_km = distance_km - transient_radius_km(diameter_km)
    if distance_km <= diameter_km / 2 or flight_km <= 0:
        return None
    angle = np.radians(LAUNCH_ANGLE_DEG)
    tangent = np.tan(min(flight_km / (2 * MOON_RADIUS_KM), np.pi / 2))
    shape = np.cos(angle) ** 2 + np.sin(angle) * np.cos(angle) / tangent
    return float(np.sqrt(1e3 * MOON_RADIUS_KM * LUNAR_GRAVITY.value / shape))


def local_to_ejecta_ratio(distance_km: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Mass of local ground that falling ejecta stir up over their own mass: 0.0183 r^0.87, r in km from the centre.

    Oberbeck, Hoerz, Morrison, Quaide & Gault (1975), Moon 12, 19, 10.1007/BF00577878; coefficients recalled from later
    literature, not checked against the paper.
    """
    return np.asarray(0.0183 * np.asarray(distance_km, float) ** 0.87)
