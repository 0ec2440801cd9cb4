"""Reflectance of a particulate surface from single-scattering albedo, and back.

Hapke (1981), J. Geophys. Res. 86, 3039, 10.1029/JB086iB04p03039; filling: Hapke (2008), Icarus 195, 918,
10.1016/j.icarus.2008.01.003.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["HapkeSurface"]

TABLE = 4001
"""Values of gamma = (1 - w)^(1/2) at which the inverse is tabulated: 1e-7 of w between them."""


@dataclass(frozen=True)
class HapkeSurface:
    """A geometry, a phase function and a filling factor.

    Attributes
    ----------
    incidence_deg, emission_deg : below 90; the phase angle only enters through `phase` and `opposition`. [deg]
    phase : single-particle phase function at the phase angle, 1 for isotropic scattering. [-]
    opposition : backscatter function at the phase angle, 0 beyond some 15 deg. [-]
    filling : share of the volume that is solid, 0 (no correction) to below 0.75. [-]

    The reflectance factor is  R = K w / (4 (m0 + m)) ((1 + B) P + H(m0 / K) H(m / K) - 1),  m0 and m the cosines of
    incidence and emission, H(x) = (1 + 2 x) / (1 + 2 x (1 - w)^(1/2)),  K = -ln(1 - q) / q,  q = 1.209 filling^(2/3).

    Raises
    ------
    ParameterError for angles or a filling out of range, and a phase function not above 0.
    """

    incidence_deg: float = 30.0
    emission_deg: float = 0.0
    phase: float = 1.0
    opposition: float = 0.0
    filling: float = 0.0

    def __post_init__(self) -> None:
        if not (0 <= self.incidence_deg < 90 and 0 <= self.emission_deg < 90):
            raise ParameterError(f"incidence {self.incidence_deg:g}, emission {self.emission_deg:g} deg: give 0 to 90")
        if not (self.phase > 0 and self.opposition >= 0):
            raise ParameterError("the phase function must be above 0, the opposition effect 0 or above")
        if not 0 <= self.filling < 0.75:
            raise ParameterError(f"filling {self.filling:g}: give 0 to below 0.75")

    @property
    def porosity_factor(self) -> float:
        """K, 1 without filling. [-]"""
        q = 1.209 * self.filling ** (2 / 3)
        return -math.log1p(-q) / q if q > 0 else 1.0

    def reflectance(self, albedo: FloatArray) -> FloatArray:
        """Reflectance factor of single-scattering albedos, 0 to 1, any shape. [-]"""
        k = self.porosity_factor
        mu0, mu = (math.cos(math.radians(angle)) for angle in (self.incidence_deg, self.emission_deg))
        gamma = np.sqrt(1.0 - np.asarray(albedo, dtype=np.float64))
        both = _h(mu0 / k, gamma) * _h(mu / k, gamma)
        return np.asarray(k * albedo / (4.0 * (mu0 + mu)) * ((1.0 + self.opposition) * self.phase + both - 1.0))

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ascending albedos, ln R of them and d ln R / dw."""
        gamma = np.linspace(1.0, 0.0, TABLE)[1:]
        albedo = 1.0 - gamma**2
        ln_reflectance = np.log(self.reflectance(albedo))
        return albedo, ln_reflectance, np.gradient(ln_reflectance, albedo)

    def albedo(self, reflectance: FloatArray) -> FloatArray:
        """Single-scattering albedo of reflectance factors above 0; those above that of w = 1 give 1. [-]"""
        albedo, ln_reflectance, _ = self._table
        return np.interp(np.log(reflectance), ln_reflectance, albedo)

    def ln_reflectance(self, albedo: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln R and its derivative by the albedo, by interpolation."""
        table, ln_reflectance, slope = self._table
        return np.interp(albedo, table, ln_reflectance), np.interp(albedo, table, slope)


def _h(x: float, gamma: FloatArray) -> FloatArray:
    return np.asarray((1.0 + 2.0 * x) / (1.0 + 2.0 * x * gamma))
