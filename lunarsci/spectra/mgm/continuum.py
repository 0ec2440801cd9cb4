"""Continua of the Modified Gaussian Model: polynomials inside the logarithm, of the logarithm, or none."""

from typing import Literal, get_args

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["MGM_CONTINUA", "MgmContinuum", "continuum_basis", "is_logarithmic"]

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
MGM_CONTINUA: tuple[MgmContinuum, ...] = get_args(MgmContinuum)

RANGE_NM = (400.0, 2600.0)
"""The polynomials are written on this interval, mapped to -1 to 1, so that coefficients compare between spectra."""
_DEGREES = {"quadratic": 2, "cubic": 3, "none": -1}


def is_logarithmic(name: MgmContinuum) -> bool:
    """Whether the polynomial is ln C itself (`log-quadratic`, and `none`, which is ln C = 0) and not C."""
    return name in ("log-quadratic", "none")


def continuum_basis(name: MgmContinuum, wavelength_nm: FloatArray) -> FloatArray:
    """Basis B, shape (n, m), of a continuum C = B c that stands inside ln C, or of ln C = B c (`is_logarithmic`).

    Columns are 1, u (u^2, u^3), with u the wavelength, or the wavenumber, mapped linearly so that 400 and 2600 nm
    become -1 and 1 (or 1 and -1). `none` has no columns. `wavelength_nm` has shape (n,) [nm]. Raises ParameterError
    for an unknown name.
    """
    if name not in MGM_CONTINUA:
        raise ParameterError(f"continuum '{name}' is unknown; choose one of: {', '.join(MGM_CONTINUA)}")
    low, high = RANGE_NM
    values, ends = wavelength_nm, (low, high)
    if name.startswith("wavenumber"):
        values, ends = 1e7 / wavelength_nm, (1e7 / high, 1e7 / low)
    u = 2 * (values - ends[0]) / (ends[1] - ends[0]) - 1
    degree = _DEGREES.get(name.rpartition("-")[2], 1)
    return np.ascontiguousarray(np.vander(u, degree + 1, increasing=True))
