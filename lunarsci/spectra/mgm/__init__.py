"""The Modified Gaussian Model: absorption bands as Gaussians in ln R over a smooth continuum."""

from typing import Literal

__all__ = ["DEFAULT_CONTINUUM", "PERCENT_OF", "MgmContinuum"]

MgmContinuum = Literal[
    "wavelength",
    "wavelength-quadratic",
    "wavelength-cubic",
    "wavenumber",
    "wavenumber-quadratic",
    "wavenumber-cubic",
    "log-quadratic",
    "none",
]
"""Polynomials inside the logarithm, of the logarithm, or none."""
DEFAULT_CONTINUUM: MgmContinuum = "wavelength-quadratic"
"""Second-order continua served best in comparisons on mafic minerals: Clenet et al. (2011), Icarus 213, 404,
10.1016/j.icarus.2011.03.002; Han et al. (2020), arXiv:2003.07856 (not found when looked up again)."""
PERCENT_OF = {
    "fo": "Fo of olivine",
    "fs": "Fs of orthopyroxene",
    "wo": "Wo of clinopyroxene",
    "fs_cpx": "Fs of clinopyroxene",
}
"""Compositions that band centres speak for, in mol %, by their keys."""
