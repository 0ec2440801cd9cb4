"""Continua under which absorption bands are measured. Each is linear in the reflectance once its tie points are chosen.

* `conic`: the second-order curve through 700, 1345 and 1580 nm (Ding et al. 2024, 10.1038/s41467-024-46233-8). It is
  extrapolated over the 2 um band, where it can run across or far above the spectrum or fall to zero; whoever uses it
  there must look (`lunarsci.spectra.bands` does).
* `hull`: the upper convex hull (Clark & Roush 1984, 10.1029/JB089iB07p06329).
* `linear`: straight lines between the highest points at the shoulders of each band.

At a channel a continuum is the sum over three terms, each a weight times the smoothed reflectance of a tie point.
"""

from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.compiled import compiled
from lunarsci.errors import DataError, ParameterError

ContinuumName = Literal["conic", "hull", "linear"]
CONTINUA: tuple[ContinuumName, ...] = get_args(ContinuumName)
CONIC, HULL, LINEAR = range(len(CONTINUA))
Indices = npt.NDArray[np.int64]

CONIC_TIES_NM = (700.0, 1345.0, 1580.0)
TERMS = len(CONIC_TIES_NM)
SHOULDERS_NM = ((600.0, 850.0), (1250.0, 1650.0), (2150.0, 2600.0))
"""Where `linear` looks for its tie points; assumed, wide enough for olivine and pyroxene."""


class Ties(NamedTuple):
    """What the continua of all spectra on the same n channels share.

    Attributes
    ----------
    wavelength_nm : shape (n,). [nm]
    conic, conic_weight : the conic's ties, (3,), and their weights at each channel, (3, n).
    shoulders : first channel of each shoulder and the one behind its last, (3, 2).
    available : which of `CONTINUA` the channels allow, (3,).
    """

    wavelength_nm: FloatArray
    conic: Indices
    conic_weight: FloatArray
    shoulders: Indices
    available: BoolArray


def ties_of(wavelength_nm: FloatArray) -> Ties:
    """The ties on ascending channels, (n,). [nm]"""
    conic = np.array([int(np.argmin(np.abs(wavelength_nm - target))) for target in CONIC_TIES_NM])
    shoulders = np.array(
        [np.searchsorted(wavelength_nm, [low, np.nextafter(high, np.inf)]) for low, high in SHOULDERS_NM]
    )
    available = np.array([not _far_from(wavelength_nm), True, (shoulders[:, 1] > shoulders[:, 0]).sum() >= 2])
    nodes = wavelength_nm[conic]
    weight = np.zeros((TERMS, wavelength_nm.size))
    if available[CONIC]:
        for k, node in enumerate(nodes):
            others = np.delete(nodes, k)
            weight[k] = np.prod((wavelength_nm[:, None] - others) / (node - others), axis=1)
    return Ties(wavelength_nm, conic, weight, shoulders.astype(np.int64), available)


def _far_from(wavelength_nm: FloatArray) -> float | None:
    """The conic's tie that no channel is near to, if there is one. [nm]"""
    for target in CONIC_TIES_NM:
        index = int(np.argmin(np.abs(wavelength_nm - target)))
        reach = 2 * float(np.max(np.diff(wavelength_nm[max(index - 1, 0) : index + 2]), initial=0.0))
        if abs(wavelength_nm[index] - target) > reach:
            return target
    return None


def continuum(name: ContinuumName, wavelength_nm: FloatArray, smoothed: FloatArray) -> FloatArray:
    """Continua, shape (m, n), of smoothed spectra (m, n) on ascending channels (n,), no gaps. [-, -, nm]

    Raises
    ------
    DataError when the spectra do not reach the tie points; ParameterError for an unknown name.
    """
    if name not in CONTINUA:
        raise ParameterError(f"continuum '{name}' is unknown; choose one of: {', '.join(CONTINUA)}")
    ties = ties_of(np.ascontiguousarray(wavelength_nm, float))
    if not ties.available[CONTINUA.index(name)]:
        raise DataError(
            f"no channel near {_far_from(wavelength_nm):g} nm, where the conic continuum is tied; use --continuum hull"
            if name == "conic"
            else "fewer than two band shoulders within the spectrum; use --continuum hull"
        )
    tie, weight = np.zeros((TERMS, wavelength_nm.size), np.int64), np.zeros((TERMS, wavelength_nm.size))
    spare, levels = np.zeros(wavelength_nm.size, np.int64), np.empty(smoothed.shape)
    for row, values in enumerate(np.ascontiguousarray(smoothed, float)):
        tie_down(CONTINUA.index(name), ties, values, tie, weight, spare)
        level_under(values, tie, weight, levels[row])
    return levels


def upper_hull(x: FloatArray, y: FloatArray) -> list[int]:
    """Indices of the upper convex hull of points with ascending x."""
    found = np.empty(x.size, np.int64)
    return [int(i) for i in found[: hull_chain(np.ascontiguousarray(x), np.ascontiguousarray(y), found)]]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def hull_chain(x: FloatArray, y: FloatArray, found: Indices) -> int:
    """Put the upper convex hull of points (n,) with ascending x into `found` (n,); how many they are.

    Andrew (1979), 10.1016/0020-0190(79)90072-3. A point on a chord is not on the hull.
    """
    count = 0
    for i in range(x.size):
        while count > 1:
            a, b = found[count - 2], found[count - 1]
            if (y[b] - y[a]) * (x[i] - x[a]) > (y[i] - y[a]) * (x[b] - x[a]):
                break
            count -= 1
        found[count] = i
        count += 1
    return count


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _shoulders(ties: Ties, smoothed: FloatArray, found: Indices) -> int:
    count = 0
    for k in range(ties.shoulders.shape[0]):
        low, high = ties.shoulders[k, 0], ties.shoulders[k, 1]
        if high > low:
            highest = low
            for j in range(low, high):
                if smoothed[j] > smoothed[highest]:
                    highest = j
            found[count] = highest
            count += 1
    return count


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def tie_down(which: int, ties: Ties, smoothed: FloatArray, tie: Indices, weight: FloatArray, spare: Indices) -> None:
    """Choose the ties of a continuum, its place in `CONTINUA`, on a smoothed spectrum (n,).

    `tie` and `weight`, (3, n), take the channel of each term and its weight; `spare` is (n,).
    """
    if which == CONIC:
        for k in range(TERMS):
            for j in range(smoothed.size):
                tie[k, j], weight[k, j] = ties.conic[k], ties.conic_weight[k, j]
    elif which == HULL:
        _straight_lines(ties.wavelength_nm, spare[: hull_chain(ties.wavelength_nm, smoothed, spare)], tie, weight)
    else:
        _straight_lines(ties.wavelength_nm, spare[: _shoulders(ties, smoothed, spare)], tie, weight)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _straight_lines(wavelength_nm: FloatArray, nodes: Indices, tie: Indices, weight: FloatArray) -> None:
    """Between nodes, two at least, extended beyond the first and the last."""
    for k in range(nodes.size - 1):
        left, right = nodes[k], nodes[k + 1]
        begin = 0 if k == 0 else left
        end = wavelength_nm.size if k == nodes.size - 2 else right
        per_nm = 1.0 / (wavelength_nm[right] - wavelength_nm[left])
        for j in range(begin, end):
            share = (wavelength_nm[j] - wavelength_nm[left]) * per_nm
            tie[0, j], tie[1, j], tie[2, j] = left, right, left
            weight[0, j], weight[1, j], weight[2, j] = 1.0 - share, share, 0.0


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def level_under(smoothed: FloatArray, tie: Indices, weight: FloatArray, level: FloatArray) -> None:
    """The continuum, into `level` (n,), of a smoothed spectrum (n,). [-]"""
    for j in range(smoothed.size):
        level[j] = (
            smoothed[tie[0, j]] * weight[0, j] + smoothed[tie[1, j]] * weight[1, j] + smoothed[tie[2, j]] * weight[2, j]
        )
