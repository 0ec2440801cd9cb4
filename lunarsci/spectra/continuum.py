"""Continua under which absorption bands are measured. Each is linear in the reflectance once its tie points are chosen.

* `conic`: the second-order curve through 700, 1345 and 1580 nm (Ding et al. 2024, 10.1038/s41467-024-46233-8). It is
  extrapolated over the 2 um band, where it can run across or far above the spectrum or fall to zero; whoever uses it
  there must look (`lunarsci.spectra.bands` does).
* `hull`: the upper convex hull (Clark & Roush 1984, 10.1029/JB089iB07p06329).
* `linear`: straight lines between the highest points at the shoulders of each band.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError

ContinuumName = Literal["conic", "hull", "linear"]
CONTINUA: tuple[ContinuumName, ...] = get_args(ContinuumName)

CONIC_TIES_NM = (700.0, 1345.0, 1580.0)
SHOULDERS_NM = ((600.0, 850.0), (1250.0, 1650.0), (2150.0, 2600.0))
"""Where `linear` looks for its tie points; assumed, wide enough for olivine and pyroxene."""


@dataclass(frozen=True, slots=True, eq=False)
class Continuum:
    """A continuum as a linear operator on the smoothed reflectance.

    Attributes
    ----------
    name : which of the continua it is.
    operator : shape (n, n); the continuum is `operator @ smoothed`. [-]
    ties_nm : wavelengths it is tied to. [nm]
    """

    name: ContinuumName
    operator: FloatArray
    ties_nm: tuple[float, ...]

    def values(self, smoothed: FloatArray) -> FloatArray:
        """The continuum, shape (n,). [-]"""
        return self.operator @ smoothed


def continuum(name: ContinuumName, wavelength_nm: FloatArray, smoothed: FloatArray) -> Continuum:
    """Choose the tie points of a continuum on a smoothed spectrum.

    Parameters
    ----------
    name : `conic`, `hull` or `linear`.
    wavelength_nm, smoothed : shape (n,), ascending, no gaps. [nm, -]

    Raises
    ------
    DataError when the spectrum does not reach the tie points; ParameterError for an unknown name.
    """
    if name == "conic":
        ties = _nearest(wavelength_nm, CONIC_TIES_NM)
        return Continuum(name, _conic_operator(wavelength_nm, ties), tuple(wavelength_nm[ties]))
    if name == "hull":
        ties = upper_hull(wavelength_nm, smoothed)
    elif name == "linear":
        ties = _shoulders(wavelength_nm, smoothed)
    else:
        raise ParameterError(f"continuum '{name}' is unknown; choose one of: {', '.join(CONTINUA)}")
    return Continuum(name, _piecewise_operator(wavelength_nm, ties), tuple(wavelength_nm[ties]))


def upper_hull(x: FloatArray, y: FloatArray) -> list[int]:
    """Indices of the upper convex hull of points with ascending x (Andrew 1979, 10.1016/0020-0190(79)90072-3)."""
    hull: list[int] = []
    for i in range(x.size):
        while len(hull) > 1 and _not_below(hull[-2], hull[-1], i, x, y):
            hull.pop()
        hull.append(i)
    return hull


def _not_below(a: int, b: int, c: int, x: FloatArray, y: FloatArray) -> bool:
    """True when b does not rise above the chord from a to c."""
    return bool((y[b] - y[a]) * (x[c] - x[a]) <= (y[c] - y[a]) * (x[b] - x[a]))


def _nearest(wavelength_nm: FloatArray, targets_nm: tuple[float, ...]) -> list[int]:
    found = [int(np.argmin(np.abs(wavelength_nm - target))) for target in targets_nm]
    for index, target in zip(found, targets_nm, strict=True):
        reach = 2 * float(np.max(np.diff(wavelength_nm[max(index - 1, 0) : index + 2])))
        if abs(wavelength_nm[index] - target) > reach:
            raise DataError(f"no channel near {target:g} nm, where the conic continuum is tied; use --continuum hull")
    return found


def _shoulders(wavelength_nm: FloatArray, smoothed: FloatArray) -> list[int]:
    ties = []
    for low, high in SHOULDERS_NM:
        inside = np.flatnonzero((wavelength_nm >= low) & (wavelength_nm <= high))
        if inside.size:
            ties.append(int(inside[np.argmax(smoothed[inside])]))
    if len(ties) < 2:
        raise DataError("fewer than two band shoulders within the spectrum; use --continuum hull")
    return ties


def _conic_operator(wavelength_nm: FloatArray, ties: list[int]) -> FloatArray:
    """Lagrange's second-order interpolation through the ties."""
    operator = np.zeros((wavelength_nm.size, wavelength_nm.size))
    nodes = wavelength_nm[ties]
    for k, tie in enumerate(ties):
        others = np.delete(nodes, k)
        operator[:, tie] = np.prod((wavelength_nm[:, None] - others) / (nodes[k] - others), axis=1)
    return operator


def _piecewise_operator(wavelength_nm: FloatArray, ties: list[int]) -> FloatArray:
    """Straight lines between the ties, extended beyond the first and the last."""
    operator = np.zeros((wavelength_nm.size, wavelength_nm.size))
    nodes = wavelength_nm[ties]
    segment = np.clip(np.searchsorted(nodes, wavelength_nm, side="right") - 1, 0, len(ties) - 2)
    fraction = (wavelength_nm - nodes[segment]) / (nodes[segment + 1] - nodes[segment])
    rows = np.arange(wavelength_nm.size)
    index = np.asarray(ties)
    np.add.at(operator, (rows, index[segment]), 1.0 - fraction)
    np.add.at(operator, (rows, index[segment + 1]), fraction)
    return operator
