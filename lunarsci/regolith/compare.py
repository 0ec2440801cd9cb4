"""A site beside terrestrial soils, simulants and other lunar sites: who behaves alike under a wheel.

Parameters of different laws cannot be compared one by one, (K_s, N) least of all. Distances are therefore those of what
the parameters predict: bearing pressure over the sinkages of a wheel, shear strength over the stresses under it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.io.tables import table_hashes, table_rows
from lunarsci.ranges import check_each, refuse
from lunarsci.regolith.belief import SoilBelief, belief_of_posterior
from lunarsci.regolith.prior import DETERMINED, PARAMETERS
from lunarsci.regolith.soil import RANGES
from lunarsci.regolith.wheel import RANGES as WHEEL_RANGES

TABLE, LATERAL = "reference_soils.csv", "lateral_soils.csv"
"""Files beside this one: soils with their sources, and pairs of lateral shear parameters."""
KINDS = ("terrestrial", "simulant", "lunar")
"""Of reference soils."""
SINKAGES_M, STRESSES_PA = np.linspace(0.005, 0.02, 16), np.linspace(2e3, 10e3, 17)
"""Where predictions are compared: sinkages and normal stresses of a light rover's wheel; assumed. [m, Pa]"""
ASPECTS = ("bearing", "shear", "lateral")
"""Keys of the results of `identify` and `infer` that have curves of single states."""
DRAWS, SEED, SIXTY_EIGHT = 1000, 0, (0.15865, 0.84135)
"""Soils that the range of a distance comes from, the seed of their random numbers, and its ends."""
SYMBOLS = {"stiffness_kpa_m_n": "K_s", "sinkage_exponent": "N", "cohesion_pa": "c", "friction_angle_deg": "φ"}
PAIRED = ("stiffness and exponent", "cohesion and friction angle", "lateral modulus and external friction angle")
WORDS = {"bearing": "bearing", "strength": "shear strength"}
PAIRS = {"bearing": tuple(SYMBOLS)[:2], "strength": tuple(SYMBOLS)[2:]}
"""Parameters of each aspect that is compared."""
SITE_NAMES = {
    name.removeprefix("sinkage_"): name
    for name in PARAMETERS
    if name not in ("sinkage_exponent_slip", "shear_modulus_mm")
}
"""What single states call a parameter of the site, and its own name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSoil:
    """A soil of the literature; None where its source says nothing.

    Attributes
    ----------
    name, kind : kind is one of `KINDS`.
    sinkage_exponent : n of Bekker's law p = (k_c / b + k_phi) z^n. [-]
    k_c, k_phi : its moduli. [kN m^-(n+1), kN m^-(n+2)]
    cohesion_pa, friction_angle_deg : lowest and highest. [Pa, deg]
    source : where they come from.
    """

    name: str
    kind: str
    sinkage_exponent: float | None
    k_c: float | None
    k_phi: float | None
    cohesion_pa: tuple[float, float]
    friction_angle_deg: tuple[float, float]
    source: str

    def stiffness(self, width_m: float) -> float | None:
        """K_s = k_c / b + k_phi for a plate or wheel of this width. [kPa m^-n]"""
        return None if self.k_c is None or self.k_phi is None else self.k_c / width_m + self.k_phi


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """What is known of the ground to compare: bearing pair, shear pair, or both; None for what is not.

    The lateral pair is for the picture: too few soils are known to compare with. Parameters are those of `Soil`, with
    their units; stiffness and exponent are those of a wheel without slip.

    Raises ParameterError for half a pair, and values out of range.
    """

    stiffness_kpa_m_n: float | None = None
    sinkage_exponent: float | None = None
    cohesion_pa: float | None = None
    friction_angle_deg: float | None = None
    lateral_modulus_mm: float | None = None
    external_friction_angle_deg: float | None = None

    def __post_init__(self) -> None:
        given = [getattr(self, name) is not None for name in self.__slots__]
        halves = zip(PAIRED, given[::2], given[1::2], strict=True)
        refuse(f"{words} go together; give both or none" for words, one, other in halves if one != other)
        refuse({"nothing to compare: give stiffness and exponent, or cohesion and friction angle": not any(given[:4])})
        check_each("", self, {name: RANGES[name] for name in SYMBOLS})


@dataclass(frozen=True, slots=True)
class SoilComparison:
    """A reference soil beside the site.

    Attributes
    ----------
    soil : the reference.
    bearing, strength : root mean square of the logarithm of the ratio of predictions, 0 for the same; of strength to
        the nearest within the reference's range. None where either side is not known. [-]
    bearing_range, strength_range : 68 % of these over what the result leaves open of the site; None where it is one
        soil, or where either side is not known. [-]
    """

    soil: ReferenceSoil
    bearing: float | None
    strength: float | None
    bearing_range: tuple[float, float] | None = None
    strength_range: tuple[float, float] | None = None

    def to_dict(self, width_m: float) -> dict[str, Any]:
        """Plain values; the stiffness is that for a wheel of this width."""
        soil, row = self.soil, dict[str, Any](name=self.soil.name, kind=self.soil.kind)
        for aspect in PAIRS:
            low, high = getattr(self, f"{aspect}_range") or (None, None)
            row[f"{aspect}_distance"] = getattr(self, aspect)
            row |= {f"{aspect}_distance_low": low, f"{aspect}_distance_high": high}
        row |= {"stiffness_kpa_m_n": soil.stiffness(width_m), "sinkage_exponent": soil.sinkage_exponent}
        for name, unit in (("cohesion", "pa"), ("friction_angle", "deg")):
            row[f"{name}_low_{unit}"], row[f"{name}_high_{unit}"] = getattr(soil, f"{name}_{unit}")
        return row | {"source": soil.source}


@dataclass(frozen=True, slots=True)
class OpenSite:
    """What a result leaves open of a site.

    Attributes
    ----------
    belief : of the soil, that of all states together or of drives.
    left : share of the prior's width that is left of each parameter. [-]
    """

    belief: SoilBelief
    left: Mapping[str, float]

    def undetermined(self) -> dict[str, dict[str, float]]:
        """By aspect, parameters that are hardly better known than before, with what is left of the prior's width."""
        return {
            aspect: {name: self.left[name] for name in names if not self.left[name] < DETERMINED}
            for aspect, names in PAIRS.items()
        }


def open_site(result: Mapping[str, Any]) -> OpenSite:
    """What the `result` of `regolith infer` leaves open, as a normal law about its medians. Raises as `site_of`."""
    joint = result["joint"]
    left = {name: 1 - float(joint["parameters"][name]["shrinkage"]) for name in PARAMETERS}
    return OpenSite(belief_of_posterior(joint), left)


def site_of(result: Mapping[str, Any]) -> tuple[Site, dict[str, Any]]:
    """A site from the `result` of `regolith identify` or `infer`, and the curves of single states by aspect.

    The posterior's medians where there is one, else the site values; half a pair is nothing. Raises KeyError or
    TypeError for what is no such result.
    """
    curves = {aspect: result[aspect]["curve"] for aspect in ASPECTS}
    values: dict[str, Any]
    if "joint" in result:
        values = {name: result["joint"]["parameters"][name]["median"] for name in SITE_NAMES.values()}
    else:
        pairs = result["bearing"] | result["shear"] | result["lateral"]
        values = {name: pairs[of_state]["value"] for of_state, name in SITE_NAMES.items()}
    names = [*values]
    for pair in (names[:2], names[2:4], names[4:]):
        if any(values[key] is None for key in pair):
            values |= dict.fromkeys(pair)
    return Site(**values), curves


def site_of_belief(belief: SoilBelief) -> Site:
    """The medians of a belief."""
    ends = belief.intervals()
    return Site(**{name: ends[name][0] for name in SITE_NAMES.values()})


def nearest(soils: Sequence[SoilComparison], aspect: str) -> list[SoilComparison]:
    """Those compared in an aspect, `bearing` or `strength`, the most alike first."""
    compared = [item for item in soils if getattr(item, aspect) is not None]
    return sorted(compared, key=lambda item: (getattr(item, aspect), item.soil.name))


def remarks(left_open: OpenSite, soils: Sequence[SoilComparison]) -> list[str]:
    """What is not determined, how many soils may be the most alike then, and that slip is left out."""
    notes = []
    for aspect, names in left_open.undetermined().items():
        ends = [span for item in nearest(soils, aspect) if (span := getattr(item, f"{aspect}_range"))]
        if not names or not ends:
            continue
        alike = sum(low <= ends[0][1] for low, _ in ends)
        little = ", so the order says little" if 2 * alike > len(ends) else ""
        left = " and ".join(
            f"{SYMBOLS[name]} ({100 * share:.0f} % of the prior's width left)" for name, share in names.items()
        )
        notes.append(
            f"{WORDS[aspect]}: not determined: {left}; by the 68 % of the distances {alike} of {len(ends)} soils may "
            f"be the most alike{little}"
        )
    rise = left_open.belief.intervals()["sinkage_exponent_slip"][0]
    return [*notes, f"bearing: N is that of a wheel without slip; its rise with slip, n1 = {rise:.2g}, is left out"]


@cache
def reference_soils() -> tuple[ReferenceSoil, ...]:
    """The table that comes with lunarsci."""
    return tuple(_soil(row) for row in table_rows(TABLE, __package__))


def lateral_soils() -> tuple[Mapping[str, str], ...]:
    """Rows of the table of lateral shear parameters."""
    return table_rows(LATERAL, __package__)


def reference_hash() -> dict[str, str]:
    """Names and SHA-256 of the tables, for the provenance."""
    return table_hashes(TABLE, LATERAL, package=__package__)


def sources_of(soils: Iterable[ReferenceSoil]) -> list[str]:
    """Where the numbers of these soils come from, each source once."""
    return list(dict.fromkeys(soil.source for soil in soils))


def _soil(row: Mapping[str, str]) -> ReferenceSoil:
    def number(name: str) -> float | None:
        return float(row[name]) if row[name] else None

    return ReferenceSoil(
        name=row["name"],
        kind=row["kind"],
        sinkage_exponent=number("sinkage_exponent"),
        k_c=number("k_c_kn_m_n_plus_1"),
        k_phi=number("k_phi_kn_m_n_plus_2"),
        cohesion_pa=(float(row["cohesion_low_pa"]), float(row["cohesion_high_pa"])),
        friction_angle_deg=(float(row["friction_angle_low_deg"]), float(row["friction_angle_high_deg"])),
        source=row["source"],
    )


def compare_site(
    site: Site, width_m: float, soils: Sequence[ReferenceSoil] | None = None, left_open: OpenSite | None = None
) -> list[SoilComparison]:
    """Reference soils and their distances from the site; `nearest` puts them in order.

    Parameters
    ----------
    site : what is known of the ground.
    width_m : of the wheel, on which stiffness depends. [m]
    soils : instead of `reference_soils()`.
    left_open : what is left open of the site, for the range of each distance.

    Raises ParameterError for a width out of range.
    """
    check_each("wheel", {"width_m": width_m}, {"width_m": WHEEL_RANGES["width_m"]})
    one = {name: np.array([np.nan if (value := getattr(site, name)) is None else value]) for name in SYMBOLS}
    drawn = {} if left_open is None else left_open.belief.draws(DRAWS, SEED)
    compared = []
    for soil in soils or reference_soils():
        bearing, strength = _single(bearing_distances(one, soil, width_m)), _single(strength_distances(one, soil))
        bearings = _range(bearing_distances(drawn, soil, width_m)) if drawn and bearing is not None else None
        strengths = _range(strength_distances(drawn, soil)) if drawn and strength is not None else None
        compared.append(SoilComparison(soil, bearing, strength, bearings, strengths))
    return compared


def _single(distances: FloatArray) -> float | None:
    """The distance of one site (1,); None where it is not known."""
    return float(distances[0]) if np.isfinite(distances[0]) else None


def _range(distances: FloatArray) -> tuple[float, float]:
    """Ends of 68 % of the distances (d,) of drawn sites."""
    low, high = np.quantile(distances, SIXTY_EIGHT)
    return float(low), float(high)


def bearing_distances(sites: Mapping[str, FloatArray], soil: ReferenceSoil, width_m: float) -> FloatArray:
    """Of a soil from sites in bearing under a wheel so wide [m]; NaN where one is not known. (n,) [-]

    `sites` has values (n,) by parameter.
    """
    stiffness = soil.stiffness(width_m)
    if soil.sinkage_exponent is None or stiffness is None or stiffness <= 0:
        return np.full(len(sites["stiffness_kpa_m_n"]), np.nan)
    ratio = np.log(stiffness / sites["stiffness_kpa_m_n"])[:, None]
    ratio = ratio + (soil.sinkage_exponent - sites["sinkage_exponent"])[:, None] * np.log(SINKAGES_M)
    return np.asarray(np.sqrt(np.mean(ratio**2, axis=1)))


def strength_distances(sites: Mapping[str, FloatArray], soil: ReferenceSoil) -> FloatArray:
    """The same in shear strength. (n,) [-]"""
    strength = sites["cohesion_pa"][:, None] + STRESSES_PA * np.tan(np.radians(sites["friction_angle_deg"]))[:, None]
    low, high = (
        c + STRESSES_PA * np.tan(np.radians(phi))
        for c, phi in zip(soil.cohesion_pa, soil.friction_angle_deg, strict=True)
    )
    closest = np.clip(strength, low, high)
    return np.asarray(np.sqrt(np.mean(np.log(closest / strength) ** 2, axis=1)))
