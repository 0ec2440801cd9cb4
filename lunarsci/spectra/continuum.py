"""Continua under which absorption bands are measured. Each is linear in the reflectance once its tie points are chosen.

* `conic`: the second-order curve through 700, 1345 and 1580 nm (Ding et al. 2024, 10.1038/s41467-024-46233-8). It is
  extrapolated over the 2 um band, where it can run across or far above the spectrum or fall to zero; whoever uses it
  there must look (`lunarsci.spectra.bands` does).
* `hull`: the upper convex hull (Clark & Roush 1984, 10.1029/JB089iB07p06329).
* `linear`: straight lines between the highest points at the shoulders of each band.

At a channel a continuum is the sum over three terms, each a weight times the smoothed reflectance of a tie point.
"""

from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import aligned, choose, load, spread, store
from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.noise import take_eight, uncounted_rows

ContinuumName = Literal["conic", "hull", "linear"]
CONTINUA: tuple[ContinuumName, ...] = get_args(ContinuumName)
CONIC, HULL, LINEAR = range(len(CONTINUA))
"""Places in `CONTINUA`."""
Indices = npt.NDArray[np.int64]
"""Numbers of channels."""

CONIC_TIES_NM = (700.0, 1345.0, 1580.0)
"""Tie points of the parabola of Ding et al. (2024), 10.1038/s41467-024-46233-8, Methods."""
TERMS = len(CONIC_TIES_NM)
"""Tie points that a continuum rests on at any one channel, at most."""
SHOULDERS_NM = ((600.0, 850.0), (1250.0, 1650.0), (2150.0, 2600.0))
"""Where `linear` looks for its tie points; assumed, wide enough for olivine and pyroxene."""
SMOOTHED, LEVEL, WEIGHT, NODE, TIE_ROWS = 0, 1, 1 + len(CONTINUA), 1 + len(CONTINUA) * (1 + TERMS), 14
"""Rows, n of each, of the table (rows n, 8) that eight spectra of n channels are worked on in, `TIE_ROWS` in all.

* `SMOOTHED`: smoothed reflectance.
* `LEVEL`, a row for each continuum; `WEIGHT`, a row for each of its three terms.
* `NODE`: 1 where the hull touches, else 0.

Row `LEVEL` + k of channel j is at (`LEVEL` + k) n + j.
"""


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
            f"no channel near {_far_from(wavelength_nm):g} nm, where the conic continuum is tied; give `continuum` hull"
            if name == "conic"
            else "fewer than two band shoulders within the spectrum; give `continuum` hull"
        )
    values, levels = np.ascontiguousarray(smoothed, float), np.empty(smoothed.shape)
    table, tie, nodes, workspace = tables_of(ties, TIE_ROWS)
    _levels(CONTINUA.index(name), ties, values, table, tie[CONTINUA.index(name)], nodes, workspace, levels)
    return levels


def tables_of(ties: Ties, rows: int) -> tuple[FloatArray, Indices, Indices, FloatArray]:
    """What eight spectra on n channels are worked on in: a table of (rows n, 8), of which this module uses `TIE_ROWS`,
    the channels of the terms by continuum, (3, 3, 8), and workspaces of one spectrum, (n,) each."""
    count = ties.wavelength_nm.size
    table, tie = aligned(rows * count), np.zeros((len(CONTINUA), TERMS, LANES), np.int64)
    tie[CONIC] = ties.conic[:, None]
    table[WEIGHT * count : (WEIGHT + TERMS) * count] = ties.conic_weight.reshape(-1, 1)
    return table, tie, np.zeros(count, np.int64), np.zeros(count)


def upper_hull(x: FloatArray, y: FloatArray) -> list[int]:
    """Indices of the upper convex hull of points with ascending x."""
    hull = np.empty(x.size, np.int64)
    return [int(i) for i in hull[: hull_chain(np.ascontiguousarray(x), np.ascontiguousarray(y), hull)]]


@uncounted_rows
def hull_chain(x: FloatArray, y: FloatArray, hull: Indices) -> int:
    """Put the upper convex hull of points (n,) with ascending x into `hull` (n,); how many they are.

    Andrew (1979), 10.1016/0020-0190(79)90072-3. A point on a chord is not on the hull.
    """
    hull[0] = 0
    count, xa, ya, xb, yb = 0, 0.0, 0.0, x[0], y[0]
    for i in range(1, x.size):
        xi, yi = x[i], y[i]
        while count > 0 and not (yb - ya) * (xi - xa) > (yi - ya) * (xb - xa):
            count -= 1
            xb, yb = xa, ya
            if count > 0:
                xa, ya = x[hull[count - 1]], y[hull[count - 1]]
        count += 1
        hull[count] = i
        xa, ya, xb, yb = xb, yb, xi, yi
    return count + 1


@uncounted_rows
def _levels(
    which: int,
    ties: Ties,
    smoothed: FloatArray,
    table: Any,
    tie: Indices,
    nodes: Indices,
    workspace: FloatArray,
    out: FloatArray,
) -> None:
    """Levels of a continuum, its place in `CONTINUA`, of smoothed spectra (m, n), into `out` (m, n)."""
    count = ties.wavelength_nm.size
    for begin in range(0, len(smoothed), LANES):
        take_eight(smoothed, begin, table, SMOOTHED * count)
        tie_down(which, ties, table, tie, nodes, workspace)
        for lane in range(min(LANES, len(smoothed) - begin)):
            for j in range(count):
                out[begin + lane, j] = table[(LEVEL + which) * count + j, lane]


@uncounted_rows
def tie_down(which: int, ties: Ties, table: Any, tie: Indices, nodes: Indices, workspace: FloatArray) -> None:
    """A continuum, its place in `CONTINUA`, of eight smoothed spectra: its LEVEL, and what that is made of.

    That is NODE, 1 where the hull touches and 0 elsewhere, and the channels of the other continua's terms, in `tie`;
    and each term's WEIGHT, of the hull those of the nodes before and behind a channel.
    """
    wavelength_nm, count = ties.wavelength_nm, ties.wavelength_nm.size
    if which == HULL:
        for lane in range(LANES):
            for j in range(count):
                workspace[j] = table[SMOOTHED * count + j, lane]
                table[NODE * count + j, lane] = 0.0
            for k in range(hull_chain(wavelength_nm, workspace, nodes)):
                table[NODE * count + nodes[k], lane] = 1.0
        _hull_lines(wavelength_nm, table)
    elif which == LINEAR:
        _straight_lines(ties, table, tie)
    else:
        conic = ties.conic
        for j in range(count):
            level = load(table, WEIGHT * count + j) * load(table, SMOOTHED * count + conic[0])
            level += load(table, (WEIGHT + 1) * count + j) * load(table, SMOOTHED * count + conic[1])
            level += load(table, (WEIGHT + 2) * count + j) * load(table, SMOOTHED * count + conic[2])
            store(table, LEVEL * count + j, level)


@uncounted_rows
def _hull_lines(wavelength_nm: FloatArray, table: Any) -> None:
    """Straight lines between nodes, of which the first and the last channel are."""
    count = wavelength_nm.size
    level, before, behind = (LEVEL + HULL) * count, (WEIGHT + TERMS * HULL) * count, (WEIGHT + TERMS * HULL + 1) * count
    left, left_nm = spread(0.0), spread(0.0)
    for j in range(count):
        node, here = load(table, NODE * count + j), load(table, SMOOTHED * count + j)
        left, left_nm = choose(node, here, left), choose(node, spread(wavelength_nm[j]), left_nm)
        store(table, level + j, left)
        store(table, before + j, left_nm)
    right, right_nm = load(table, SMOOTHED * count + count - 1), spread(wavelength_nm[count - 1])
    for j in range(count - 1, -1, -1):
        node, left, left_nm = load(table, NODE * count + j), load(table, level + j), load(table, before + j)
        share = (wavelength_nm[j] - left_nm) / choose(right_nm - left_nm, right_nm - left_nm, spread(1.0))
        store(table, before + j, 1.0 - share)
        store(table, behind + j, share)
        store(table, level + j, left * (1.0 - share) + right * share)
        right, right_nm = choose(node, left, right), choose(node, left_nm, right_nm)


@formula
def _highest_of(value: Any, j: Any, at_nm: Any, highest: Any, place: Any, place_nm: Any) -> Any:
    """The highest value so far, its channel and its wavelength, with channel j taken in."""
    above = value > highest
    return choose(above, value, highest), choose(above, j, place), choose(above, at_nm, place_nm)


@uncounted_rows
def _straight_lines(ties: Ties, table: Any, tie: Indices) -> None:
    """Between the highest points of the shoulders, two or three, extended beyond the first and the last."""
    wavelength_nm, shoulders, count, number = ties.wavelength_nm, ties.shoulders, ties.wavelength_nm.size, 0
    base = (WEIGHT + TERMS * LINEAR) * count
    for k in range(TERMS):
        low, high = shoulders[k, 0], shoulders[k, 1]
        if high > low:
            highest, place, place_nm = (
                load(table, SMOOTHED * count + low),
                spread(float(low)),
                spread(wavelength_nm[low]),
            )
            for j in range(low + 1, high):
                highest, place, place_nm = _highest_of(
                    load(table, SMOOTHED * count + j), float(j), wavelength_nm[j], highest, place, place_nm
                )
            store(table, base + 3 * number, highest)
            store(table, base + 3 * number + 1, place)
            store(table, base + 3 * number + 2, place_nm)
            for lane in range(LANES):
                tie[number, lane] = int(table[base + 3 * number + 1, lane])
            number += 1
    _between(wavelength_nm, table, base, number)


@uncounted_rows
def _between(wavelength_nm: FloatArray, table: Any, base: int, number: int) -> None:
    """Weights and level of lines through two or three nodes: their values, channels and wavelengths, from `base` on."""
    count = wavelength_nm.size
    first, first_nm, second, place = (
        load(table, base),
        load(table, base + 2),
        load(table, base + 3),
        load(table, base + 4),
    )
    second_nm, third, third_nm = load(table, base + 5), load(table, base + 6), load(table, base + 8)
    if number < TERMS:
        place, third, third_nm = spread(float(count)), second, second_nm + 1.0
    per_nm, per_next = 1.0 / (second_nm - first_nm), 1.0 / (third_nm - second_nm)
    for j in range(count):
        share, behind = (wavelength_nm[j] - first_nm) * per_nm, (wavelength_nm[j] - second_nm) * per_next
        inside = choose(place - float(j), spread(1.0), spread(0.0))
        one = choose(inside, 1.0 - share, spread(0.0))
        two = choose(inside, share, 1.0 - behind)
        three = choose(inside, spread(0.0), behind)
        store(table, base + j, one)
        store(table, base + count + j, two)
        store(table, base + 2 * count + j, three)
        store(table, (LEVEL + LINEAR) * count + j, first * one + second * two + third * three)
