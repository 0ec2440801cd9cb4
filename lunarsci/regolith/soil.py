"""Mechanical parameters of a soil in the three aspects: bearing, longitudinal shear, lateral shear."""

import dataclasses
import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from lunarsci.errors import named, warn
from lunarsci.io.documents import toml_of
from lunarsci.io.inputs import named_input
from lunarsci.io.tables import table_hashes
from lunarsci.names import checked_name, one_of
from lunarsci.provenance import sha256
from lunarsci.ranges import ACUTE_DEG, FINITE, NOT_NEGATIVE, POSITIVE, check_each, refuse
from lunarsci.regolith.prior import Question, default_prior, question

RANGES = {
    **dict.fromkeys(("stiffness_kpa_m_n", "sinkage_exponent", "shear_modulus_mm", "lateral_modulus_mm"), POSITIVE),
    **dict.fromkeys(("friction_angle_deg", "external_friction_angle_deg"), ACUTE_DEG),
    "cohesion_pa": NOT_NEGATIVE,
    "sinkage_exponent_slip": FINITE,
}
"""Of the numbers of a `Soil`."""
OTHER_UNITS: dict[str, dict[str, float]] = {
    "stiffness_kpa_m_n": {"Pa/m^N": 1e-3, "MPa/m^N": 1e3, "psi/in^N": 271.4, "tenths of kPa/m^N": 0.1,
                          "tens of kPa/m^N": 10.0},
    "cohesion_pa": {"kPa": 1e3, "psi": 6894.76, "tenths of Pa": 0.1, "tens of Pa": 10.0},
    "friction_angle_deg": {"rad": 57.29578},
    "shear_modulus_mm": {"cm": 10.0, "m": 1e3, "in": 25.4},
    "external_friction_angle_deg": {"rad": 57.29578},
    "lateral_modulus_mm": {"cm": 10.0, "m": 1e3, "in": 25.4},
}  # fmt: skip
"""Other units of soil parameters with their size in the unit of the name: by definition (1 in = 25.4 mm, 1 lbf/in2 =
6894.76 Pa). Stiffness in psi is that of N = 1, about which units are asked. Tenths and
tens are of a digit too many, or one that is missing."""


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Soil:
    """One soil as the wheel-soil formulas see it.

    Attributes
    ----------
    stiffness_kpa_m_n : equivalent stiffness K_s = k_c/b + k_phi, > 0. [kPa m^-N]
    sinkage_exponent : static sinkage exponent n0 of N = n0 + n1 s, > 0. [-]
    sinkage_exponent_slip : dynamic sinkage exponent n1, Eq. 7. [-]
    cohesion_pa : cohesion c >= 0. [Pa]
    friction_angle_deg : internal friction angle phi, 0 to below 90. [deg]
    shear_modulus_mm : longitudinal shear deformation modulus K_x > 0. [mm]
    external_friction_angle_deg : external friction angle phi_y, 0 to below 90. [deg]
    lateral_modulus_mm : lateral shear deformation modulus K_y > 0. [mm]

    Raises ParameterError outside these ranges. Source of the parameter set: Ding et al. (2024),
    10.1038/s41467-024-46233-8, Eqs 6, 7, 12, 16.
    """

    stiffness_kpa_m_n: float
    sinkage_exponent: float
    cohesion_pa: float
    friction_angle_deg: float
    shear_modulus_mm: float
    external_friction_angle_deg: float
    lateral_modulus_mm: float
    sinkage_exponent_slip: float = 0.0

    def __post_init__(self) -> None:
        check_each("soil", self, RANGES)

    def vector(self) -> tuple[float, float, float, float, float, float, float, float]:
        """(K_s, n0, n1, c, tan phi, K_x, tan phi_y, K_y), the order the compiled formulas take, in Pa and m."""
        return (
            self.stiffness_kpa_m_n * 1e3,
            self.sinkage_exponent,
            self.sinkage_exponent_slip,
            self.cohesion_pa,
            math.tan(math.radians(self.friction_angle_deg)),
            self.shear_modulus_mm * 1e-3,
            math.tan(math.radians(self.external_friction_angle_deg)),
            self.lateral_modulus_mm * 1e-3,
        )

    def replace(self, **changes: float) -> "Soil":
        """The same soil with some parameters changed. Raises ParameterError for a name that is none."""
        named_so = {checked_name(name, RANGES, "a soil parameter"): value for name, value in changes.items()}
        return dataclasses.replace(self, **named_so)


def soil_tables() -> dict[str, dict[str, Any]]:
    """The soils that come with lunarsci, name to table (parameters and `source`)."""
    return tomllib.loads((files(__package__) / "soils.toml").read_text("utf-8"))


def soil_hash(soil: str) -> tuple[dict[str, str], dict[str, str]]:
    """Where a soil comes from, for the provenance: (user's file, own table) to SHA-256, one of them empty."""
    if soil in soil_tables():
        return {}, table_hashes("soils.toml", package=__package__)
    return {soil: sha256(Path(soil).read_bytes())}, {}


def read_soil(soil: str) -> Soil:
    """Read a soil by name (`lunar-typical`) or from a TOML file with the keys of `Soil`. Raises DataError.

    Warns with LunarSciWarning of values of a file that no lunar soil is known to have.
    """
    tables = soil_tables()
    if soil in tables:
        return _soil(tables[soil], soil)
    read = _soil(toml_of(soil, named_input(soil, f"a soil of lunarsci ({', '.join(tables)})", tables)), soil)
    warn_of_unusual(read, soil)
    return read


def warn_of_unusual(soil: Soil, called: str) -> None:
    """Warn of values that would be likely in another unit, or that no lunar soil has."""
    for asked in unusual(soil, called):
        warn(asked.doubt)


def unusual(soil: Soil, called: str = "soil") -> list[Question]:
    """What to ask of a soil, by the laws of `priors.toml`."""
    asked = (
        question(f"{called}: {name}", getattr(soil, name), law, OTHER_UNITS.get(name, {}))
        for name, law in default_prior().items()
    )
    return [one for one in asked if one is not None]


def _soil(table: dict[str, Any], origin: str) -> Soil:
    values = {name: value for name, value in table.items() if name not in ("source", "assumed")}
    with named(origin):
        refuse(f"'{name}' is not a key of a soil; {one_of(name, RANGES)}" for name in values if name not in RANGES)
        refuse(
            f"{name} is a law, as of a prior, and a soil has numbers; see `lunarsci template soil`"
            for name, value in values.items()
            if isinstance(value, dict)
        )
        return Soil(**{name: float(value) for name, value in values.items()})
