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
TREND_SIGMA = {"fo": 10.0, "fs": 9.0, "wo": 15.0, "fs_cpx": 9.0}
"""What the trends of centres with composition miss beside a fit's own error, root mean square over minerals of RELAB
and meteorites of known composition, with the assemblage chosen: `tests/benchmarks/compositions.py`. [mol %]"""


def with_trend(shown: str, trend_sigma: float, digits: int = 0) -> str:
    """A composition with its fit's own error, and that of the trend beside it.

    >>> with_trend("43.0 ± 4.3", 9.0)
    '43.0 ± 4.3 (fit) ± 9 (trend)'
    """
    return f"{shown} (fit) ± {trend_sigma:.{digits}f} (trend)"
