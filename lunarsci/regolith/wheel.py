"""The wheel as the terramechanics formulas see it, and what a model of its contact takes into account."""

import math
from dataclasses import dataclass, fields
from typing import Literal, get_args

from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import named
from lunarsci.names import checked_name
from lunarsci.ranges import NOT_NEGATIVE, POSITIVE, SHARE, check_each, refuse
from lunarsci.rovers import RoverDescription, read_rover

PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"
"""Source of the model, as results cite it."""
ShearSign = Literal["signed", "printed", "slip-branch"]
"""Sign convention of the longitudinal shear stress, see `lunarsci.regolith.forces`."""
ShearLaw = Literal["separate", "combined", "ellipse"]
"""How longitudinal and lateral shear stress are mobilised, see `ContactModel.shear`."""
Bulldozing = Literal["none", "hegedus", "wong"]
"""Force of the soil against the side face, see `ContactModel.bulldozing`."""
SlipSinkageLaw = Literal["lyasko", "linear"]
"""How slip deepens the sinkage, see `lunarsci.regolith.inversion.slip_sinkage`."""
SHEAR_SIGNS: tuple[str, ...] = get_args(ShearSign)
SLIP_SINKAGE_LAWS: tuple[str, ...] = get_args(SlipSinkageLaw)
SHEAR_LAWS: tuple[ShearLaw, ...] = get_args(ShearLaw)
BULLDOZING: tuple[str, ...] = get_args(Bulldozing)
"""The names of each; compiled formulas know them by their places."""
MAX_VALID_SLIP = 0.6
"""Slip ratio up to which the model holds: Ding et al. (2024), 10.1038/s41467-024-46233-8, Methods. [-]"""
DENSITY_KG_M3 = 1500.0
"""Of the upper 15 cm of the ground, Lunar Sourcebook (1991), ch. 9. [kg m^-3]"""


LARGEST_M = 2.5
"""Radius or width; the largest tyres built are 2.0 m in radius (59/80R63, of mining trucks). Assumed. [m]"""
RANGES = {
    **dict.fromkeys(("radius_m", "width_m"), f"(0, {LARGEST_M}]; is it in mm or cm?"),
    "grouser_height_m": NOT_NEGATIVE,
    "grouser_shear_coefficient": SHARE,
}
"""Of the numbers of a `Wheel`."""
CONTACT_RANGES = {
    **dict.fromkeys(("density_kg_m3", "gravity_m_s2"), POSITIVE),
    "rebound": SHARE,
    **dict.fromkeys(("rut_m", "reload_n_m3", "reload_rise_n_m4"), NOT_NEGATIVE),
}
"""Of the numbers of a `ContactModel`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    """A rigid wheel with grousers, and the coefficients of its contact angles.

    Attributes
    ----------
    radius_m, width_m : shell radius r and width b, both > 0. [m]
    grouser_height_m : grouser height h >= 0. [m]
    grouser_shear_coefficient : part of the grousers that counts to the radius of slip, 0 to 1: lambda_s in
        r_s = r + lambda_s h (Eq. 4). [-]
    max_stress_c1, max_stress_c2 : theta_m = (c1 + c2 s) theta_1, Eq. 11. [-]
    exit_c3 : theta_2 = c3 theta_1, Eq. 10. [-]

    Raises ParameterError for values outside these ranges. Defaults and equations: Ding et al. (2024),
    10.1038/s41467-024-46233-8.
    """

    radius_m: float
    width_m: float
    grouser_height_m: float = 0.0
    grouser_shear_coefficient: float = 0.5
    max_stress_c1: float = 0.5
    max_stress_c2: float = 0.0
    exit_c3: float = 0.0

    def __post_init__(self) -> None:
        check_each("wheel", self, RANGES)
        faults = {
            f"wheel grouser_height_m is {self.grouser_height_m:g}, not less than radius_m; in mm?":
                not self.grouser_height_m < self.radius_m,
            "wheel contact angles need exit_c3 < max_stress_c1 < 1": not self.exit_c3 < self.max_stress_c1 < 1,
        }  # fmt: skip
        refuse(faults)

    @property
    def shearing_radius_m(self) -> float:
        """Equivalent shearing radius r_s = r + lambda_s h of a wheel with grousers (Eq. 4). [m]"""
        return self.radius_m + self.grouser_shear_coefficient * self.grouser_height_m

    def vector(self) -> tuple[float, float, float, float, float, float, float]:
        """(r, b, h, r_s, c1, c2, c3), the order the compiled formulas take. [m, m, m, m, -, -, -]"""
        return (
            self.radius_m,
            self.width_m,
            self.grouser_height_m,
            self.shearing_radius_m,
            self.max_stress_c1,
            self.max_stress_c2,
            self.exit_c3,
        )


def read_wheel(rover: str | RoverDescription) -> Wheel:
    """The wheel of a rover: a name such as `yutu2`, a TOML file, or a description already read."""
    description = read_rover(rover) if isinstance(rover, str) else rover
    table = description.table("wheel")
    with named(f"{description.origin}: [wheel]"):
        return Wheel(**{name: float(value) for name, value in table.items()})


def left_to_defaults(description: RoverDescription) -> tuple[str, ...]:
    """Names of the numbers of a wheel that its file does not give and for which the usual ones are taken."""
    return tuple(item.name for item in fields(Wheel) if item.name not in description.table("wheel"))


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactModel:
    """Choices of the exact stress integrals, beyond the closed form, each with its source.

    Attributes
    ----------
    reading : of the sign of the longitudinal shear stress, see `lunarsci.regolith.forces`; with `separate` shear only.
    shear : `separate` mobilises longitudinal and lateral stress each by its own displacement (Ding et al. 2024, Eqs 12,
        16). The others mobilise one strength by the length of both displacements, each over its modulus, so that a
        wheel that skids loses grip sideways: `combined` along the sliding velocity (Pavlov & Johnson 2019), which
        jumps where a wheel without side slip passes from slip to skid; `ellipse` along the displacement itself, which
        does not, and without side slip equals `separate` (an assumption made here, tried on measured wheels).
    bulldozing : force of the soil against the side face: `hegedus` (Hegedus 1960, as in Ishigami et al. 2007), `wong`
        (passive earth pressure, Wong 2008), or `none` as in the source.
    density_kg_m3, gravity_m_s2 : of the soil, and where; both above 0. Only bulldozing needs them. [kg m^-3, m s^-2]
    skid_exponent_slip : n2 of N = n0 - n2 s in skid (Pavlov & Johnson 2019); None takes n1, as Eq. 7 does. [-]
    rebound : share of the sinkage behind the wheel that springs back, 0 to 1: theta_2 = -arccos(1 - rebound z / r)
        (Ishigami et al. 2007); None takes the wheel's c3. [-]
    rut_m : how deep a wheel before has pressed the soil, 0 for none; it has risen and is loaded again linearly, and
        sinkage counts from the risen ground. [m]
    reload_n_m3, reload_rise_n_m4 : k_0 and A_u of that line, p = p_u - (k_0 + A_u z_u) (z_u - z) (Wong 2008); a rut
        needs one of them. [N m^-3, N m^-4]

    Raises
    ------
    ParameterError for a choice that is unknown or a number out of range.

    References
    ----------
    Ding et al. (2024), 10.1038/s41467-024-46233-8; Pavlov & Johnson (2019), Proc. ISTVS 15th European-African Conf.,
    and their code 3d-terramechanics; Ishigami, Miwa, Nagatani & Yoshida (2007), J. Field Robot. 24, 233,
    10.1002/rob.20187; Wong (2008), Theory of Ground Vehicles, 4th ed., ch. 2.
    """

    reading: ShearSign = "signed"
    shear: ShearLaw = "separate"
    bulldozing: Bulldozing = "none"
    density_kg_m3: float = DENSITY_KG_M3
    gravity_m_s2: float = LUNAR_GRAVITY.value
    skid_exponent_slip: float | None = None
    rebound: float | None = None
    rut_m: float = 0.0
    reload_n_m3: float = 0.0
    reload_rise_n_m4: float = 0.0

    def __post_init__(self) -> None:
        checked_name(self.reading, SHEAR_SIGNS, "a reading of the shear stress")
        checked_name(self.shear, SHEAR_LAWS, "a shear law")
        checked_name(self.bulldozing, BULLDOZING, "a bulldozing law")
        check_each("", self, CONTACT_RANGES)
        faults = {
            f"reading '{self.reading}' belongs to separate shear; take reading 'signed'":
                self.shear != "separate" and self.reading != "signed",
            "a rut needs the slope of reloading, reload_n_m3 or reload_rise_n_m4":
                self.rut_m > 0 and self.reload_n_m3 + self.reload_rise_n_m4 == 0,
        }  # fmt: skip
        refuse(faults)

    def vector(self) -> tuple[float, float, float, float, float, float, float, float, float]:
        """What the compiled integrals take; NaN for an n2 and -1 for a rebound that are not given.

        In order: numbers of reading, shear law and bulldozing law, rho g, n2, rebound, rut, k_0, A_u. [-, -, -, N m^-3,
        -, -, m, N m^-3, N m^-4]
        """
        return (
            float(SHEAR_SIGNS.index(self.reading)),
            float(SHEAR_LAWS.index(self.shear)),
            float(BULLDOZING.index(self.bulldozing)),
            self.density_kg_m3 * self.gravity_m_s2,
            math.nan if self.skid_exponent_slip is None else self.skid_exponent_slip,
            -1.0 if self.rebound is None else self.rebound,
            self.rut_m,
            self.reload_n_m3,
            self.reload_rise_n_m4,
        )
