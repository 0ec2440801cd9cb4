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

from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.catalogue import OLDEST_MA, Crater
from lunarsci.spectra.origin.ejecta import (
    MEASURED_SIZE_M,
    EjectaLaw,
    Range,
    ejecta_thickness_m,
    local_to_ejecta_ratio,
    survival,
)
from lunarsci.spectra.origin.sphere import Point, distance_km
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["CHANG_E_4", "STAGES", "CraterPrior", "PriorSettings", "crater_priors", "surface_age_ma"]

CHANG_E_4 = (-45.44, 177.56)
"""Site of the fin-shaped rock, Ding et al. (2024), 10.1038/s41467-024-46233-8. [deg]"""
CHANG_E_4_SURFACE_MA = 3600.0
"""Age of the mare at Chang'E-4: 3.6-3.7 Ga by crater counts, others find 3.42-2.28 Ga. [Ma]"""
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
        faults = (
            (1 <= self.thickness_factor <= 100, f"thickness factor is {self.thickness_factor:g}; it must be 1 to 100"),
            (0 <= self.other_weight < 1, f"weight of other sources is {self.other_weight:g}; it must be 0 to below 1"),
            (0 <= self.stirring <= 1000, f"stirring factor is {self.stirring:g}; it must be 0 to 1000"),
            (0 < self.rock_size_m <= 1000, f"rock size is {self.rock_size_m:g} m; it must be above 0 to 1000"),
            (abs(self.life_exponent) <= 5, f"life exponent is {self.life_exponent:g}; it must be -5 to 5"),
            (
                self.surface_age_ma is None or 0 < self.surface_age_ma <= OLDEST_MA,
                f"surface age is {self.surface_age_ma or 0:g} Ma; it must be above 0 to {OLDEST_MA:g}",
            ),
        )
        for right, text in faults:
            if not right:
                raise ParameterError(text)


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
