"""Continua of the Modified Gaussian Model: polynomials inside the logarithm."""

from typing import Literal, get_args

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["MGM_CONTINUA", "MgmContinuum", "continuum_basis"]

MgmContinuum = Literal["wavelength", "wavelength-quadratic", "wavenumber", "wavenumber-quadratic"]
MGM_CONTINUA: tuple[MgmContinuum, ...] = get_args(MgmContinuum)

RANGE_NM = (400.0, 2600.0)
"""The polynomials are written on this interval, mapped to -1 to 1, so that coefficients compare between spectra."""


def continuum_basis(name: MgmContinuum, wavelength_nm: FloatArray) -> FloatArray:
    """Basis B, shape (n, m), of a continuum C = B c that stands inside ln C.

    Columns are 1, u (and u^2), with u the wavelength, or the wavenumber, mapped linearly so that 400 and 2600 nm
    become -1 and 1 (or 1 and -1). `wavelength_nm` has shape (n,) [nm]. Raises ParameterError for an unknown name.
    """
    if name not in MGM_CONTINUA:
        raise ParameterError(f"continuum '{name}' is unknown; choose one of: {', '.join(MGM_CONTINUA)}")
    low, high = RANGE_NM
    values, ends = wavelength_nm, (low, high)
    if name.startswith("wavenumber"):
        values, ends = 1e7 / wavelength_nm, (1e7 / high, 1e7 / low)
    u = 2 * (values - ends[0]) / (ends[1] - ends[0]) - 1
    degree = 2 if name.endswith("quadratic") else 1
    return np.ascontiguousarray(np.vander(u, degree + 1, increasing=True))
