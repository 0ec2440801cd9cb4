"""The wheel as the terramechanics formulas see it."""

from dataclasses import dataclass

from lunarsci.errors import DataError, ParameterError
from lunarsci.rovers import RoverDescription, read_rover


def shearing_radius(radius_m: float, grouser_height_m: float, grouser_shear_coefficient: float) -> float:
    """Equivalent shearing radius of a wheel with grousers, r_s = r + lambda_s h.

    Parameters
    ----------
    radius_m : radius r of the wheel shell. [m]
    grouser_height_m : grouser height h. [m]
    grouser_shear_coefficient : lambda_s, 0 to 1; 0.5 is typical, 0.65 is used for Yutu-2. [-]

    Returns
    -------
    r_s. [m]

    References
    ----------
    Eq. 4 of Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8.
    """
    return radius_m + grouser_shear_coefficient * grouser_height_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    """A rigid wheel with grousers, and the coefficients of its contact angles.

    Attributes
    ----------
    radius_m, width_m : shell radius r and width b, both > 0. [m]
    grouser_height_m : grouser height h >= 0. [m]
    grouser_shear_coefficient : lambda_s of Eq. 4, 0 to 1. [-]
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
        for name in ("radius_m", "width_m"):
            if not getattr(self, name) > 0:
                raise ParameterError(f"wheel {name} is {getattr(self, name)}; give a length above 0 m")
        if not self.grouser_height_m >= 0:
            raise ParameterError(f"wheel grouser_height_m is {self.grouser_height_m}; give 0 m or more")
        if not 0 <= self.grouser_shear_coefficient <= 1:
            raise ParameterError("wheel grouser_shear_coefficient must lie within 0 to 1")
        if not self.exit_c3 < self.max_stress_c1 < 1:
            raise ParameterError("wheel contact angles need exit_c3 < max_stress_c1 < 1")

    @property
    def shearing_radius_m(self) -> float:
        """r_s of Eq. 4. [m]"""
        return shearing_radius(self.radius_m, self.grouser_height_m, self.grouser_shear_coefficient)

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
    try:
        return Wheel(**{name: float(value) for name, value in table.items()})
    except (TypeError, ValueError) as error:
        raise DataError(f"{description.origin}: [wheel] {error}") from error
