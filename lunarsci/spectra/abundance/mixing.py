"""How powders mix: in the albedo of single scattering (Hapke), or in -ln R (absorbance).

Reflectance of a particulate surface from single-scattering albedo, and back.

Hapke (1981), J. Geophys. Res. 86, 3039, 10.1029/JB086iB04p03039; filling: Hapke (2008), Icarus 195, 918,
10.1016/j.icarus.2008.01.003.

Submicroscopic iron on the grains of a mixture, which darkens and reddens it.

Iron particles far smaller than the wavelength add 36 pi phi z / L to the absorption coefficient of a grain, with
z = n^3 n_Fe k_Fe / ((n_Fe^2 - k_Fe^2 + 2 n^2)^2 + (2 n_Fe k_Fe)^2), n the index of the grain and L the wavelength:
Hapke (2001), J. Geophys. Res. 106, 10039, 10.1029/2000JE001338. Here it is added to (1 - w) / w, which is nearly the
absorption coefficient times the grain size.

Laws by which minerals of a powder mix: linear in single-scattering albedo, or in absorbance.

Every law has a quantity x that mixes linearly by volume, and its own t, which grows by a constant where all absorption
grows by a factor: a coarser powder of one mineral is, nearly, the same t moved up by `size_exponent` times the
logarithm of the grain size. Series of sieved powders (RELAB PE-CMP, PP-CMP; USGS PYX02, GDS70; 7-180 um) give 0.8-1.2
in `Albedo` and 0.4-0.6 in `Absorbance`.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.io.tables import table_rows

IRON_TABLE = "iron_optical_constants.csv"
GRAIN_INDEX = 1.7
"""Refractive index of the silicate around the iron; assumed, pyroxene and olivine have 1.65-1.75."""
UNIT_NM = 1000.0
TYPICAL_LN, SPREAD_LN = -1.0, 1.5
"""Mean and standard deviation of the logarithm of the absorption added at 1000 nm, in units of (1 - w) / w; assumed."""


def iron_absorption(wavelength_nm: FloatArray) -> FloatArray:
    """Absorption of submicroscopic iron, 1 at 1000 nm, from 450 to 2500 nm. [-]"""
    rows = [tuple(map(float, row.values())) for row in table_rows(IRON_TABLE)]
    table_nm, index, extinction = (np.array(column) for column in list(zip(*rows, strict=True))[:3])

    def at(wanted: FloatArray) -> FloatArray:
        n_fe, k_fe = np.interp(wanted, table_nm, index), np.interp(wanted, table_nm, extinction)
        below = (n_fe**2 - k_fe**2 + 2 * GRAIN_INDEX**2) ** 2 + (2 * n_fe * k_fe) ** 2
        return np.asarray(n_fe * k_fe / below / wanted)

    return at(wavelength_nm) / at(np.array([UNIT_NM]))


@dataclass(frozen=True, slots=True, eq=False)
class Weathering:
    """Absorption by iron on given channels; its amount is exp(-1 + 1.5 z), with z standard normal."""

    absorption: FloatArray

    def darken(self, albedo: FloatArray, amount: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Albedo with iron, its derivative by the one without, and by z; (s, n) each, from (s, n) and (s,)."""
        added = np.exp(TYPICAL_LN + SPREAD_LN * amount)[:, None] * self.absorption
        darkened = 1.0 / (1.0 / albedo + added)
        return darkened, (darkened / albedo) ** 2, -(darkened**2) * added * SPREAD_LN


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


LEAST, MOST = 1e-5, 1.0 - 1e-5
BRIGHTEST = 0.999
"""Reflectance from which on a powder counts as this bright: absorbance must stay above 0. Assumed."""


class MixingLaw(Protocol):
    """What `unmix` needs of a law; arrays of any shape."""

    @property
    def name(self) -> str:
        """As it stands in results."""

    @property
    def size_exponent(self) -> float:
        """By how much t grows with the logarithm of the grain size."""

    @property
    def section(self) -> float:
        """By how much the logarithm of cross-section per volume falls with t of grains that are coarser."""

    def element(self, reflectance: FloatArray) -> FloatArray:
        """t of a powder of one mineral."""

    def mixing(self, element: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x of t, and dx / dt."""

    def ln_reflectance(self, mixed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln R of x, and d ln R / dx."""


@dataclass(frozen=True, eq=False)
class Albedo:
    """x is the single-scattering albedo w, which adds by cross-section: by volume where grains are of one size;
    t = ln((1 - w) / w).

    Mustard & Pieters (1989), J. Geophys. Res. 94, 13619, 10.1029/JB094iB10p13619.
    """

    surface: HapkeSurface
    name: str = "hapke"
    size_exponent: float = 1.0
    section: float = 1.0

    def element(self, reflectance: FloatArray) -> FloatArray:
        """See `MixingLaw`."""
        albedo = np.clip(self.surface.albedo(reflectance), LEAST, MOST)
        return np.asarray(np.log((1.0 - albedo) / albedo))

    def mixing(self, element: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `MixingLaw`."""
        albedo = 1.0 / (1.0 + np.exp(element))
        return albedo, -albedo * (1.0 - albedo)

    def ln_reflectance(self, mixed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `MixingLaw`."""
        return self.surface.ln_reflectance(np.clip(mixed, LEAST, MOST))


@dataclass(frozen=True, eq=False)
class Absorbance:
    """x is the apparent absorbance -ln R; t = ln x. No theory of scattering, but near the truth for bright powders.

    Clark & Roush (1984), J. Geophys. Res. 89, 6329, 10.1029/JB089iB07p06329 (apparent absorbance).
    """

    name: str = "absorbance"
    size_exponent: float = 0.5
    section: float = 0.0

    def element(self, reflectance: FloatArray) -> FloatArray:
        """See `MixingLaw`."""
        return np.asarray(np.log(-np.log(np.clip(reflectance, LEAST, BRIGHTEST))))

    def mixing(self, element: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `MixingLaw`."""
        absorbance = np.exp(element)
        return absorbance, absorbance

    def ln_reflectance(self, mixed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `MixingLaw`."""
        return -mixed, np.full_like(mixed, -1.0)


METHODS = ("unmix", "hapke", "absorbance")


def mixing_laws(method: str, surface: HapkeSurface | None = None, *, iron: bool = False) -> tuple[MixingLaw, ...]:
    """The laws that a method compares. Raises ParameterError for an unknown method, and iron without `hapke`."""
    laws: dict[str, tuple[MixingLaw, ...]] = {
        "hapke": (Albedo(surface or HapkeSurface()),),
        "absorbance": (Absorbance(),),
    }
    laws["unmix"] = laws["hapke"] if iron else laws["hapke"] + laws["absorbance"]
    if method not in laws:
        raise ParameterError(f"method '{method}'; give one of {', '.join(METHODS)}")
    if iron and method == "absorbance":
        raise ParameterError("submicroscopic iron needs the method hapke or unmix")
    return laws[method]
