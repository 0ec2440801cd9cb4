"""Continua under which absorption bands are measured. Each is linear in the reflectance once its tie points are chosen.

* `conic`: the second-order curve through 700, 1345 and 1580 nm (Ding et al. 2024, 10.1038/s41467-024-46233-8). It is
  extrapolated over the 2 um band, where it can run across or far above the spectrum or fall to zero; whoever uses it
  there must look (`lunarsci.spectra.bands` does).
* `hull`: the upper convex hull (Clark & Roush 1984, 10.1029/JB089iB07p06329).
* `linear`: straight lines between the highest points at the shoulders of each band.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, ParameterError

ContinuumName = Literal["conic", "hull", "linear"]
CONTINUA: tuple[ContinuumName, ...] = get_args(ContinuumName)
Indices = npt.NDArray[np.int_]

CONIC_TIES_NM = (700.0, 1345.0, 1580.0)
SHOULDERS_NM = ((600.0, 850.0), (1250.0, 1650.0), (2150.0, 2600.0))
"""Where `linear` looks for its tie points; assumed, wide enough for olivine and pyroxene."""


@dataclass(frozen=True, slots=True, eq=False)
class Continuum:
    """Continua of m spectra on the same n channels, as weighted sums of the smoothed reflectance at tie points.

    Attributes
    ----------
    name : which of the continua it is.
    terms : each a channel, shape (m, n), and its weight, (m, n); the continuum is the sum over them. [-]
    """

    name: ContinuumName
    terms: Sequence[tuple[Indices, FloatArray]]

    def of(self, rows: Indices) -> "Continuum":
        """Those of some of the spectra."""
        return Continuum(self.name, [(tie[rows], weight[rows]) for tie, weight in self.terms])

    def values(self, smoothed: FloatArray) -> FloatArray:
        """The continua, shape (m, n), of smoothed spectra (m, n). [-]"""
        level = np.zeros(smoothed.shape)
        for tie, weight in self.terms:
            level += np.take_along_axis(smoothed, tie, axis=1) * weight
        return level

    def carried(self, slopes: FloatArray) -> FloatArray:
        """Derivatives to the continuum into derivatives to the smoothed reflectance, both (m, n)."""
        rows = (np.arange(slopes.shape[0]) * slopes.shape[1])[:, None]
        onto = np.zeros(slopes.size)
        for tie, weight in self.terms:
            onto += np.bincount((tie + rows).ravel(), (slopes * weight).ravel(), slopes.size)
        return onto.reshape(slopes.shape)


def continuum(name: ContinuumName, wavelength_nm: FloatArray, smoothed: FloatArray) -> Continuum:
    """Choose the tie points of continua on smoothed spectra.

    Parameters
    ----------
    name : `conic`, `hull` or `linear`.
    wavelength_nm, smoothed : shape (n,), ascending, and (m, n), no gaps. [nm, -]

    Raises
    ------
    DataError when the spectra do not reach the tie points; ParameterError for an unknown name.
    """
    if name == "conic":
        return Continuum(name, _parabola(wavelength_nm, smoothed.shape))
    if name == "hull":
        return Continuum(name, _straight_lines(wavelength_nm, hull_ties(wavelength_nm, smoothed)))
    if name == "linear":
        return Continuum(name, _straight_lines(wavelength_nm, _shoulders(wavelength_nm, smoothed)))
    raise ParameterError(f"continuum '{name}' is unknown; choose one of: {', '.join(CONTINUA)}")


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


def hull_ties(x: FloatArray, y: FloatArray) -> BoolArray:
    """Which of the points (m, n) over ascending x (n,) are on the upper convex hull of their row.

    From the first point to the one in steepest ascent, and so on to the last: Jarvis (1973),
    10.1016/0020-0190(73)90020-3, of all rows at once.
    """
    tie: BoolArray = np.zeros(y.shape, bool)
    tie[:, 0] = True
    rows, at = np.arange(y.shape[0]), np.zeros(y.shape[0], int)
    while rows.size and x.size > 1:
        first = int(at.min()) + 1
        run = x[first:] - x[at][:, None]
        rise = y[rows, first:] - y[rows, at][:, None]
        steepness = np.where(run > 0, rise / np.where(run > 0, run, 1.0), -np.inf)
        at = x.size - 1 - np.argmax(steepness[:, ::-1], axis=1)
        tie[rows, at] = True
        rows, at = rows[at < x.size - 1], at[at < x.size - 1]
    return tie


def _shoulders(wavelength_nm: FloatArray, smoothed: FloatArray) -> BoolArray:
    tie: BoolArray = np.zeros(smoothed.shape, bool)
    for low, high in SHOULDERS_NM:
        inside = np.flatnonzero((wavelength_nm >= low) & (wavelength_nm <= high))
        if inside.size:
            tie[np.arange(tie.shape[0]), inside[np.argmax(smoothed[:, inside], axis=1)]] = True
    if tie.shape[0] and tie[0].sum() < 2:
        raise DataError("fewer than two band shoulders within the spectrum; use --continuum hull")
    return tie


def _straight_lines(wavelength_nm: FloatArray, tie: BoolArray) -> list[tuple[Indices, FloatArray]]:
    """Between ties (m, n), two a row at least, extended beyond the first and the last."""
    rows, channels = np.nonzero(tie)
    rank = np.cumsum(tie, axis=1) - 1
    table = np.zeros((tie.shape[0], int(rank.max(initial=0)) + 1), int)
    table[rows, rank[rows, channels]] = channels
    segment = np.clip(rank, 0, rank[:, -1:] - 1)
    left, right = (np.take_along_axis(table, segment + step, axis=1) for step in (0, 1))
    share = (wavelength_nm - wavelength_nm[left]) / (wavelength_nm[right] - wavelength_nm[left])
    return [(left, 1.0 - share), (right, share)]


def _parabola(wavelength_nm: FloatArray, shape: Any) -> list[tuple[Indices, FloatArray]]:
    """Lagrange's second-order interpolation through the conic's ties."""
    ties = _nearest(wavelength_nm, CONIC_TIES_NM)
    nodes = wavelength_nm[ties]
    terms: list[tuple[Any, Any]] = []
    for k, tie in enumerate(ties):
        others: Any = np.delete(nodes, k)
        weight = np.prod((wavelength_nm[:, None] - others) / (nodes[k] - others), axis=1)
        terms.append((np.full(shape, tie), np.broadcast_to(weight, shape)))
    return terms


def _nearest(wavelength_nm: FloatArray, targets_nm: tuple[float, ...]) -> list[int]:
    found = [int(np.argmin(np.abs(wavelength_nm - target))) for target in targets_nm]
    for index, target in zip(found, targets_nm, strict=True):
        reach = 2 * float(np.max(np.diff(wavelength_nm[max(index - 1, 0) : index + 2])))
        if abs(wavelength_nm[index] - target) > reach:
            raise DataError(f"no channel near {target:g} nm, where the conic continuum is tied; use --continuum hull")
    return found
