"""A site beside terrestrial soils, simulants and other lunar sites: who behaves alike under a wheel.

Parameters of different laws cannot be compared one by one, (K_s, N) least of all. Distances are therefore those of what
the parameters predict: bearing pressure over the sinkages of a wheel, shear strength over the stresses under it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief
from lunarsci.tables import table_hashes, table_rows

TABLE, LATERAL = "reference_soils.csv", "lateral_soils.csv"
KINDS = ("terrestrial", "simulant", "lunar")
SINKAGES_M = np.linspace(0.005, 0.02, 16)
"""Where predictions are compared; assumed, about what a light rover's wheels sink. [m]"""
STRESSES_PA = np.linspace(2e3, 10e3, 17)
"""Where predictions are compared: sinkages and normal stresses of a light rover's wheel; assumed."""
LARGEST_WIDTH_M = 2.0
"""Of a wheel, to tell metres from centimetres; assumed."""
ASPECTS = ("bearing", "shear", "lateral")
SITE_NAMES = {
    "stiffness_kpa_m_n": ("stiffness_kpa_m_n", "stiffness_kpa_m_n"),
    "sinkage_exponent": ("exponent", "sinkage_exponent"),
    "cohesion_pa": ("cohesion_pa", "cohesion_pa"),
    "friction_angle_deg": ("friction_angle_deg", "friction_angle_deg"),
    "lateral_modulus_mm": ("lateral_modulus_mm", "lateral_modulus_mm"),
    "external_friction_angle_deg": ("external_friction_angle_deg", "external_friction_angle_deg"),
}
"""Name of a parameter of the site to that of single states, and that of the posterior, in a result of `identify`."""


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

    The lateral pair is for the picture: too few soils are known to compare with.

    Raises ParameterError for half a pair, and values out of range.
    """

    stiffness_kpa_m_n: float | None = None
    sinkage_exponent: float | None = None
    cohesion_pa: float | None = None
    friction_angle_deg: float | None = None
    lateral_modulus_mm: float | None = None
    external_friction_angle_deg: float | None = None

    def __post_init__(self) -> None:
        if (self.stiffness_kpa_m_n is None) != (self.sinkage_exponent is None):
            raise ParameterError("stiffness and exponent go together; give both or none")
        if (self.lateral_modulus_mm is None) != (self.external_friction_angle_deg is None):
            raise ParameterError("lateral modulus and external friction angle go together; give both or none")
        if (self.cohesion_pa is None) != (self.friction_angle_deg is None):
            raise ParameterError("cohesion and friction angle go together; give both or none")
        if self.stiffness_kpa_m_n is None and self.cohesion_pa is None:
            raise ParameterError("nothing to compare: give stiffness and exponent, or cohesion and friction angle")
        for name in ("stiffness_kpa_m_n", "sinkage_exponent"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ParameterError(f"{name} is {value:g}; give a number above 0")
        if self.cohesion_pa is not None and not 0 <= self.cohesion_pa < np.inf:
            raise ParameterError(f"cohesion is {self.cohesion_pa:g}; give 0 Pa or more")
        if self.friction_angle_deg is not None and not 0 <= self.friction_angle_deg < 90:
            raise ParameterError(f"friction angle is {self.friction_angle_deg:g}; give 0 to below 90 deg")


@dataclass(frozen=True, slots=True)
class SoilComparison:
    """A reference soil beside the site.

    Attributes
    ----------
    soil : the reference.
    bearing, strength : root mean square of the logarithm of the ratio of predictions, 0 for the same; of strength to
        the nearest within the reference's range. None where either side is not known. [-]
    """

    soil: ReferenceSoil
    bearing: float | None
    strength: float | None

    def to_dict(self, width_m: float) -> dict[str, Any]:
        """Plain values; the stiffness is that for a wheel of this width."""
        soil = self.soil
        return {
            "name": soil.name,
            "kind": soil.kind,
            "bearing_distance": self.bearing,
            "strength_distance": self.strength,
            "stiffness_kpa_m_n": soil.stiffness(width_m),
            "sinkage_exponent": soil.sinkage_exponent,
            "cohesion_low_pa": soil.cohesion_pa[0],
            "cohesion_high_pa": soil.cohesion_pa[1],
            "friction_angle_low_deg": soil.friction_angle_deg[0],
            "friction_angle_high_deg": soil.friction_angle_deg[1],
            "source": soil.source,
        }


def site_of(result: Mapping[str, Any]) -> tuple[Site, dict[str, Any]]:
    """A site from the `result` of `regolith identify` or `infer`, and the curves of single states by aspect.

    The posterior's medians where there is one, else the site values; half a pair is nothing. Raises KeyError or
    TypeError for what is no such result.
    """
    curves = {aspect: result[aspect]["curve"] for aspect in ASPECTS}
    values: dict[str, Any]
    if "joint" in result:
        values = {own: result["joint"]["parameters"][names[1]]["median"] for own, names in SITE_NAMES.items()}
    else:
        pairs = result["bearing"] | result["shear"] | result["lateral"]
        values = {own: pairs[names[0]]["value"] for own, names in SITE_NAMES.items()}
    own = list(SITE_NAMES)
    for pair in (own[:2], own[2:4], own[4:]):
        if any(values[key] is None for key in pair):
            values |= dict.fromkeys(pair)
    return Site(**values), curves


def site_of_belief(belief: SoilBelief) -> Site:
    """The medians of a belief."""
    ends = belief.intervals()
    return Site(**{own: ends[names[1]][0] for own, names in SITE_NAMES.items()})


def nearest(found: Sequence[SoilComparison], aspect: str) -> list[SoilComparison]:
    """Those known in an aspect, `bearing` or `strength`, the most alike first."""
    known = [(getattr(item, aspect), item.soil.name, item) for item in found]
    return [item for _, _, item in sorted((row for row in known if row[0] is not None), key=lambda row: row[:2])]


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


def compare_site(site: Site, width_m: float, soils: Sequence[ReferenceSoil] | None = None) -> list[SoilComparison]:
    """Reference soils and their distances from the site; `nearest` puts them in order.

    Parameters
    ----------
    site : what is known of the ground.
    width_m : of the wheel, on which stiffness depends, above 0 to 2. [m]
    soils : instead of `reference_soils()`.

    Raises ParameterError for a width out of range.
    """
    if not 0 < width_m <= LARGEST_WIDTH_M:
        raise ParameterError(f"width is {width_m:g} m; give a number above 0, up to {LARGEST_WIDTH_M:g}")
    known = soils or reference_soils()
    return [SoilComparison(soil, _bearing(site, soil, width_m), _strength(site, soil)) for soil in known]


def _bearing(site: Site, soil: ReferenceSoil, width_m: float) -> float | None:
    stiffness = soil.stiffness(width_m)
    if site.stiffness_kpa_m_n is None or site.sinkage_exponent is None:
        return None
    if soil.sinkage_exponent is None or stiffness is None or stiffness <= 0:
        return None
    ratio = np.log(stiffness / site.stiffness_kpa_m_n)
    ratio = ratio + (soil.sinkage_exponent - site.sinkage_exponent) * np.log(SINKAGES_M)
    return float(np.sqrt(np.mean(ratio**2)))


def _strength(site: Site, soil: ReferenceSoil) -> float | None:
    if site.cohesion_pa is None or site.friction_angle_deg is None:
        return None
    own = site.cohesion_pa + STRESSES_PA * np.tan(np.radians(site.friction_angle_deg))
    low, high = (
        c + STRESSES_PA * np.tan(np.radians(phi))
        for c, phi in zip(soil.cohesion_pa, soil.friction_angle_deg, strict=True)
    )
    nearest = np.clip(own, low, high)
    return float(np.sqrt(np.mean(np.log(nearest / own) ** 2)))
