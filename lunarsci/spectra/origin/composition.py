"""What a rock or a crater's ejecta are made of: shares of minerals, band centres, and their errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["BANDS", "MINERALS", "Composition", "Value", "closed"]

MINERALS = ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase")
BANDS = {"bc1000_nm": (700.0, 1300.0), "bc2000_nm": (1500.0, 2600.0)}
"""Band centres, and the range outside which a value is no such centre. [nm]"""
LARGEST_SUM = 1.1
"""Modes that add up to more are in the wrong unit or wrong: published ones of 102 % exist."""
SMALLEST_SIGMA = 1e-4
"""Standard deviation of a mode is taken as at least this, that a covariance can be inverted."""

Value = tuple[float, float]
"""A value and its standard deviation."""


@dataclass(frozen=True, slots=True)
class Composition:
    """Modes and band centres, each as (value, standard deviation).

    Attributes
    ----------
    modes : fraction of some of `MINERALS`, 0 to 1; by volume or weight, only their shares count.
    bands : some of `bc1000_nm` and `bc2000_nm`. [nm]
    correlation : of the modes in their order, (n, n); independent where None.

    Raises ParameterError for unknown names, values or errors out of range, modes whose sum is above 1.1 or 0.
    """

    modes: Mapping[str, Value] = field(default_factory=dict)
    bands: Mapping[str, Value] = field(default_factory=dict)
    correlation: FloatArray | None = None

    def __post_init__(self) -> None:
        for name, (value, sigma) in self.modes.items():
            _check_mode(name, value, sigma)
        for name, (value, sigma) in self.bands.items():
            _check_band(name, value, sigma)
        total = sum(value for value, _ in self.modes.values())
        if self.modes and not 0 < total <= LARGEST_SUM:
            raise ParameterError(
                f"modes add up to {total:g}; they are fractions and must add up to 1 or less, and more than 0"
            )
        if len(self.modes) == 1:
            raise ParameterError(
                f"{next(iter(self.modes))} alone is no share of anything; give two minerals or more, or none"
            )
        if self.correlation is not None:
            _check_correlation(self.correlation, len(self.modes))

    @property
    def known(self) -> bool:
        """Whether there is anything to compare."""
        return bool(self.modes or self.bands)

    def shares(self, minerals: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Mean (n,) and covariance (n, n) of the shares of these minerals, which add up to 1."""
        values = np.array([self.modes[name][0] for name in minerals])
        sigmas = np.array([max(self.modes[name][1], SMALLEST_SIGMA) for name in minerals])
        order = [list(self.modes).index(name) for name in minerals]
        correlation = np.eye(len(order)) if self.correlation is None else self.correlation[np.ix_(order, order)]
        return closed(values, correlation * np.outer(sigmas, sigmas))


def closed(values: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values divided by their sum, and their covariance to first order: J C J', J = (1 - p 1') / sum.

    Raises ParameterError where the sum is 0.
    """
    total = float(values.sum())
    if total <= 0:
        raise ParameterError("the minerals to be compared are all absent; there is nothing to compare")
    share = values / total
    jacobian = (np.eye(values.size) - np.outer(share, np.ones(values.size))) / total
    return share, jacobian @ covariance @ jacobian.T


def _check_mode(name: str, value: float, sigma: float) -> None:
    if name not in MINERALS:
        raise ParameterError(f"'{name}' is no mineral here; there are {', '.join(MINERALS)}")
    if not 0 <= value <= 1:
        raise ParameterError(f"{name} is {value:g}; a mode is a fraction from 0 to 1")
    if not 0 <= sigma <= 1:
        raise ParameterError(f"error of {name} is {sigma:g}; it is a fraction from 0 to 1")


def _check_band(name: str, value: float, sigma: float) -> None:
    if name not in BANDS:
        raise ParameterError(f"'{name}' is no band here; there are {', '.join(BANDS)}")
    low, high = BANDS[name]
    if not low <= value <= high:
        raise ParameterError(f"{name} is {value:g}; it must be {low:g} to {high:g} nm")
    if not 0 < sigma <= 1000:
        raise ParameterError(f"error of {name} is {sigma:g}; it must be above 0, in nm")


def _check_correlation(correlation: FloatArray, size: int) -> None:
    right = correlation.shape == (size, size) and bool(np.isfinite(correlation).all())
    if not right or not np.allclose(correlation, correlation.T) or np.linalg.eigvalsh(correlation)[0] < -1e-9:
        raise ParameterError(
            f"correlation of the modes: must be symmetric, {size} x {size}, without negative eigenvalues"
        )
    if not np.allclose(np.diag(correlation), 1):
        raise ParameterError("the correlation of the modes must have 1 on its diagonal")
