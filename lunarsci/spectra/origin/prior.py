"""Which crater's rocks are to be expected at a site, before the rock is looked at.

The amount of each crater's rock at the surface today, as a thickness:

    direct       t S(age)               ejecta that fell there and have survived
    stirred      f m t_y S(age of y)    brought up by the fall of a younger crater's ejecta t_y: m local mass per mass
                                        of ejecta (Oberbeck), f the crater's share of all listed ejecta that lay there
    gardened     f g                    kept at the surface by small local craters

No stage brings up more than there is.
t is drawn about the law's mean with a log-normal spread, ages, the life of rocks and g from their ranges. The prior is
the mean, over the draws, of each crater's share in the sum. Ejecta older than the site's surface lie below it and count
nothing; a crater that contains the site has no ejecta there and is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.constants import LUNAR_GRAVITY, MOON_RADIUS_KM
from lunarsci.errors import ParameterError
from lunarsci.ranges import POSITIVE, check_range, check_ranges
from lunarsci.spectra.origin.catalogue import OLDEST_MA, Crater, Point, distance_km

SURVIVAL_SOURCE = "Basilevsky, Head & Hoerz (2013), Planet. Space Sci. 89, 118, 10.1016/j.pss.2013.07.011"
MEASURED_SIZE_M = 2.0
"""Boulders of this size and more were counted by Basilevsky et al. (2013). [m]"""
NEARLY_ALL_GONE = 0.99
"""Share that is destroyed after the longer of the two times: Basilevsky et al. (2013), 10.1016/j.pss.2013.07.011."""
LIFE_RATIO = 3.75
"""Time to destroy 99 % of boulders over that to destroy half: 150-300 Ma over 40-80 Ma, Basilevsky et al. (2013)."""


@dataclass(frozen=True, slots=True)
class Range:
    """A quantity of which only the range is known: uniform in its logarithm. Both ends above 0; else ParameterError."""

    low: float
    high: float

    def __post_init__(self) -> None:
        check_range("range", self.low, POSITIVE)
        check_range("end of the range", self.high, f"[{self.low}, inf)")

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
    check_range("size of the rock", size_m, POSITIVE)
    life = np.asarray(median_life_ma, float) * (size_m / MEASURED_SIZE_M) ** size_exponent
    return np.asarray(np.exp2(-((np.asarray(age_ma, float) / life) ** survival_shape())))


EjectaLaw = Literal["mcgetchin", "pike", "housen", "xie"]
LAW_SOURCES: dict[EjectaLaw, str] = {
    "mcgetchin": "McGetchin, Settle & Head (1973), Earth Planet. Sci. Lett. 20, 226, 10.1016/0012-821X(73)90162-3",
    "pike": "Pike (1974), Earth Planet. Sci. Lett. 23, 265, 10.1016/0012-821X(74)90114-9",
    "housen": "Housen, Schmidt & Holsapple (1983), J. Geophys. Res. 88, 2485, 10.1029/JB088iB03p02485",
    "xie": "Xie, Liu & Xu (2020), J. Geophys. Res. Planets 125, e2019JE006113, 10.1029/2019JE006113",
}

_LAWS = {"mcgetchin": (0.14, 0.74, -3.0), "pike": (0.033, 1.0, -3.0), "housen": (0.0078, 1.0, -2.61),
         "xie": (0.068, 1.0, -3.0)}  # fmt: skip
"""Factor, and powers of the transient radius in m and of distance over it: McGetchin et al. (1973), Pike (1974), Housen
et al. (1983), Xie et al. (2020); see `LAW_SOURCES`."""
SIMPLE_TO_COMPLEX_KM = 18.7
"""Rim diameter at which lunar craters turn complex, Croft (1985), J. Geophys. Res. 90, C828. [km]"""
SIMPLE_SHRINKAGE = 0.84
"""Transient over rim diameter of a simple crater, Melosh (1989), Impact Cratering, Oxford University Press."""
COLLAPSE_EXPONENT = 0.15
"""Of the rim diameter, as it widens by collapse: Croft (1985), 10.1029/JB090iS02p0C828."""
LAUNCH_ANGLE_DEG = 45.0
"""Launch from the horizontal, as Xie et al. (2020), 10.1029/2019JE006113, take it."""


def transient_radius_km(diameter_km: float) -> float:
    """Radius of the transient crater from the rim diameter. [km]

    0.84 D / 2 for a simple crater, 18.7^0.15 D^0.85 / 2 from 18.7 km on (Croft 1985, 10.1029/JB090iS02p0C828); the
    two differ by 16 % where they meet. Raises ParameterError for a diameter that is not above 0.
    """
    check_range("diameter_km", diameter_km, POSITIVE)
    if diameter_km < SIMPLE_TO_COMPLEX_KM:
        return SIMPLE_SHRINKAGE * diameter_km / 2
    return float(SIMPLE_TO_COMPLEX_KM**COLLAPSE_EXPONENT * diameter_km ** (1 - COLLAPSE_EXPONENT) / 2)


def ejecta_thickness_m(law: EjectaLaw, diameter_km: float, distance_km: float) -> float | None:
    """Mean thickness of ejecta at a distance from the centre; None within the rim, where there is no blanket. [m]

    With R the transient radius [m] and x = r / R:

        mcgetchin  0.14 R^0.74 x^-3      pike  0.033 R x^-3
        housen     0.0078 R x^-2.61      xie   0.068 R x^-3

    One R serves all laws. Xie et al. mean the apparent transient crater, at the level of the ground; which radius each
    of the others means was not checked against the papers.
    Means over all directions: rays and secondaries make it vary by a factor of some 3. Laws of a flat Moon; from a
    quarter of its circumference (2729 km) on, ejecta converge on the antipode and there is more than this. Housen's
    law is for craters of 45-300 km. Sources in `LAW_SOURCES`.
    """
    factor, size_power, distance_power = _LAWS[law]
    if distance_km <= diameter_km / 2:
        return None
    radius = 1e3 * transient_radius_km(diameter_km)
    return float(factor * radius**size_power * (1e3 * distance_km / radius) ** distance_power)


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


def local_to_ejecta_ratio(distance_km: npt.ArrayLike) -> FloatArray:
    """Mass of local ground that falling ejecta stir up over their own mass: 0.0183 r^0.87, r in km from the centre.

    Oberbeck, Hoerz, Morrison, Quaide & Gault (1975), Moon 12, 19, 10.1007/BF00577878; coefficients recalled from later
    literature, not checked against the paper.
    """
    return np.asarray(0.0183 * np.asarray(distance_km, float) ** 0.87)


CHANG_E_4 = (-45.44, 177.56)
"""Site of the fin-shaped rock, Ding et al. (2024), 10.1038/s41467-024-46233-8. [deg]"""
CHANG_E_4_SURFACE_MA = 3600.0
"""Age of the mare at Chang'E-4: 3.6 and 3.7 Ga by crater counts of Ling et al. (2019), 10.1016/j.pss.2019.104741, whose
abstract was read; others find 3.42-2.28 Ga, 10.3390/rs14010049. [Ma]"""
STAGES = ("direct", "stirred", "gardened")
DRAWS = 16384
VALUES_AT_ONCE = 2_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorSettings:
    """What the prior is made of; every term can be switched off.

    Attributes
    ----------
    kind : `ejecta`, or `uniform`: all craters alike but those that contain the site.
    law : of the ejecta's thickness.
    thickness_factor : one standard deviation of a crater's thickness about the law, as a factor; 1 for none.
    exposure : whether rocks are destroyed at the surface.
    rock_life_ma : median life of a boulder of 2 m. [Ma]
    rock_size_m, life_exponent : size of the rock, and the power of size that its life follows. [m, -]
    re_excavation : whether buried ejecta are brought up again.
    stirring : factor on Oberbeck's mass of local ground per mass of ejecta.
    gardening_m : buried rock kept at the surface by small local craters, as a thickness. [m]
    surface_age_ma : age of the site's surface; None for that of Chang'E-4 there, for none elsewhere. [Ma]
    other_weight : prior probability that the rock is from none of the craters, 0 to below 1.
    seed : of the draws.

    Raises ParameterError for values out of range.
    """

    kind: Literal["ejecta", "uniform"] = "ejecta"
    law: EjectaLaw = "pike"
    thickness_factor: float = 3.0
    exposure: bool = True
    rock_life_ma: Range = field(default_factory=lambda: Range(40.0, 80.0))
    rock_size_m: float = MEASURED_SIZE_M
    life_exponent: float = 0.5
    re_excavation: bool = True
    stirring: float = 1.0
    gardening_m: Range = field(default_factory=lambda: Range(0.001, 0.1))
    surface_age_ma: float | None = None
    other_weight: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        intervals = {
            "[1, 100]": "thickness_factor", "[0, 1)": "other_weight", "[0, 1000]": "stirring",
            "(0, 1000]": "rock_size_m", "[-5, 5]": "life_exponent", f"(0, {OLDEST_MA}]": "surface_age_ma",
        }  # fmt: skip
        check_ranges(self, intervals)


@dataclass(frozen=True, slots=True)
class CraterPrior:
    """One crater at one site.

    Attributes
    ----------
    ejecta_m : thickness after the law, before its spread; None where the crater contains the site. [m]
    probability : prior, that of other sources taken off.
    stages : mean share of each of `STAGES` in the probability; empty with a uniform prior.
    survival : mean share of rocks left since the crater formed.
    above_surface : probability that the crater is younger than the site's surface.
    """

    distance_km: float
    ejecta_m: float | None
    probability: float
    stages: dict[str, float]
    survival: float
    above_surface: float


def surface_age_ma(site: Point, settings: PriorSettings) -> float:
    """Age of the site's surface that the prior goes by. [Ma]"""
    if settings.surface_age_ma is not None:
        return settings.surface_age_ma
    return CHANG_E_4_SURFACE_MA if distance_km(site, CHANG_E_4) < 5 else OLDEST_MA


def crater_priors(craters: Sequence[Crater], site: Point, settings: PriorSettings) -> list[CraterPrior]:
    """Prior of every crater at a site; probabilities and the weight of other sources add up to 1.

    Raises ParameterError where no crater can have delivered a rock.
    """
    distances = np.array([distance_km(site, crater.center) for crater in craters])
    law = [ejecta_thickness_m(settings.law, c.diameter_km, d) for c, d in zip(craters, distances, strict=True)]
    outside = np.array([thickness is not None for thickness in law])
    if not outside.any():
        raise ParameterError("every crater of the catalogue contains the site; add the craters around it")
    thickness = np.array([thickness or 0.0 for thickness in law])
    shares, left, above = _drawn(craters, thickness, distances, settings, surface_age_ma(site, settings))
    if settings.kind == "uniform":
        stages: list[dict[str, float]] = [{} for _ in craters]
        total = outside / outside.sum()
    else:
        total = shares.sum(axis=0)
        stages = [dict(zip(STAGES, map(float, _part(column)), strict=True)) for column in shares.T]
    probabilities = (1 - settings.other_weight) * total
    return [
        CraterPrior(float(distances[k]), law[k], float(probabilities[k]), stages[k], float(left[k]), float(above[k]))
        for k in range(len(craters))
    ]


def _part(column: FloatArray) -> FloatArray:
    return np.asarray(column / column.sum() if column.sum() > 0 else np.zeros_like(column))


def _drawn(
    craters: Sequence[Crater], thickness: FloatArray, distances: FloatArray, settings: PriorSettings, surface: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean shares (3, n) by stage, mean survival (n,) and probability to lie above the surface (n,)."""
    rng = np.random.default_rng(settings.seed)
    ages = [Range(*crater.age_ma) for crater in craters]
    chunk = max(64, min(DRAWS, VALUES_AT_ONCE // len(craters)))
    sums, left, above, done, used = np.zeros((len(STAGES), len(craters))), 0.0, 0.0, 0, 0
    while done < DRAWS:
        size = (min(chunk, DRAWS - done), len(craters))
        uniform = rng.random(size)
        age = np.stack([item.quantile(uniform[:, k]) for k, item in enumerate(ages)], axis=1)
        amount = thickness * settings.thickness_factor ** rng.standard_normal(size) * (age < surface)
        life = settings.rock_life_ma.quantile(rng.random((size[0], 1)))
        garden = settings.gardening_m.quantile(rng.random((size[0], 1)))
        lasting = survival(age, life, settings.rock_size_m, settings.life_exponent)
        lasting = lasting if settings.exposure else np.ones_like(lasting)
        stages = _amounts(age, amount, lasting, distances, garden, settings)
        total = stages.sum(axis=(0, 2))
        possible = total > 0  # a draw that leaves no rock at all cannot be the one in which one was found
        sums += (stages[:, possible] / total[possible, None]).sum(axis=1)
        used += int(possible.sum())
        left, above, done = left + lasting.sum(axis=0), above + (age < surface).sum(axis=0), done + size[0]
    if not used:
        raise ParameterError(
            "no crater can have left a rock at the surface: its ejecta are older than the surface, or all rocks are "
            "gone; check ages, surface age, exposure and re-excavation"
        )
    return sums / used, np.asarray(left / DRAWS), np.asarray(above / DRAWS)


def _amounts(
    age: FloatArray,
    amount: FloatArray,
    lasting: FloatArray,
    distances: FloatArray,
    garden: FloatArray,
    settings: PriorSettings,
) -> FloatArray:
    """Rock at the surface by stage, draw and crater, (3, draws, n). [m]"""
    stages = np.zeros((len(STAGES), *age.shape))
    stages[0] = amount * lasting
    if not settings.re_excavation:
        return stages
    order = np.argsort(-age, axis=1)
    sorted_amount = np.take_along_axis(amount, order, axis=1)
    below = np.cumsum(sorted_amount, axis=1) - sorted_amount
    reached = np.take_along_axis(settings.stirring * local_to_ejecta_ratio(distances) * amount, order, axis=1)
    share = np.minimum(reached, below) / np.where(below > 0, below, np.inf)
    lifted = share * np.take_along_axis(lasting, order, axis=1)
    by_younger = np.flip(np.cumsum(np.flip(lifted, axis=1), axis=1), axis=1) - lifted
    stages[1] = amount * np.take_along_axis(by_younger, np.argsort(order, axis=1), axis=1)
    all_ejecta = amount.sum(axis=1, keepdims=True)
    stages[2] = np.minimum(garden, all_ejecta) * amount / np.where(all_ejecta > 0, all_ejecta, np.inf)
    return stages
