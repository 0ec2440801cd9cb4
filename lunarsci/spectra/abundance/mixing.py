"""Laws by which minerals of a powder mix: linear in single-scattering albedo, or in absorbance.

Every law has a quantity x that mixes linearly by volume, and its own t, which grows by a constant where all absorption
grows by a factor: a coarser powder of one mineral is, nearly, the same t moved up by `size_exponent` times the
logarithm of the grain size. Series of sieved powders (RELAB PE-CMP, PP-CMP; USGS PYX02, GDS70; 7-180 um) give 0.8-1.2
in `Albedo` and 0.4-0.6 in `Absorbance`.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lunarsci.spectra.abundance.hapke import HapkeSurface
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["Absorbance", "Albedo", "MixingLaw"]

LEAST, MOST = 1e-5, 1.0 - 1e-5
BRIGHTEST = 0.999
"""Reflectance from which on a powder counts as this bright: absorbance must stay above 0."""


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
