"""Angles of one observation, checked when they are put together."""

from dataclasses import dataclass
from math import acos, cos, degrees, isfinite, radians, sin

from lunarsci.errors import ParameterError

__all__ = ["STANDARD", "Geometry", "phase_angle_deg"]

_LIMITS_DEG = {"incidence": 90.0, "emission": 90.0, "phase": 180.0}
_ROUNDING_DEG = 0.5  # labels give the three angles rounded, or at slightly different points


@dataclass(frozen=True, slots=True)
class Geometry:
    """Where the light comes from and where it goes to, seen from the surface.

    Attributes
    ----------
    incidence_deg, emission_deg : from the normal of the surface to the Sun and to the observer, 0 <= angle < 90. [deg]
    phase_deg : between the two directions, 0 <= angle < 180; |i - e| <= g <= i + e to within 0.5 deg. [deg]

    Raises
    ------
    ParameterError when an angle is out of its range, or the three do not make a spherical triangle.
    """

    incidence_deg: float
    emission_deg: float
    phase_deg: float

    def __post_init__(self) -> None:
        for name, limit in _LIMITS_DEG.items():
            angle = getattr(self, f"{name}_deg")
            if not (isfinite(angle) and 0 <= angle < limit):
                where = "; the surface is not lit" if name == "incidence" and angle >= limit else ""
                raise ParameterError(f"{name} angle {angle:g} deg: must lie from 0 to below {limit:g} deg{where}")
        low, high = self.phase_range_deg
        if not low - _ROUNDING_DEG <= self.phase_deg <= high + _ROUNDING_DEG:
            raise ParameterError(
                f"phase angle {self.phase_deg:g} deg cannot occur at incidence {self.incidence_deg:g} and emission "
                f"{self.emission_deg:g} deg ({low:g} to {high:g} deg can); check the three angles"
            )

    @property
    def phase_range_deg(self) -> tuple[float, float]:
        """Smallest and largest phase angle that go with the other two. [deg]"""
        return abs(self.incidence_deg - self.emission_deg), self.incidence_deg + self.emission_deg

    @property
    def cos_incidence(self) -> float:
        """mu0. [-]"""
        return cos(radians(self.incidence_deg))

    @property
    def cos_emission(self) -> float:
        """mu. [-]"""
        return cos(radians(self.emission_deg))


def phase_angle_deg(incidence_deg: float, emission_deg: float, azimuth_difference_deg: float) -> float:
    """Phase angle from cos g = cos i cos e + sin i sin e cos(azimuth difference), 0 to 180. [deg]"""
    i, e, turn = radians(incidence_deg), radians(emission_deg), radians(azimuth_difference_deg)
    return degrees(acos(max(-1.0, min(1.0, cos(i) * cos(e) + sin(i) * sin(e) * cos(turn)))))


STANDARD = Geometry(30.0, 0.0, 30.0)
"""The geometry that lunar reflectances are usually reduced to."""
