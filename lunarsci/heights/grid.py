"""Heights on square cells of metres, as files of any kind say them: their units, and numbers that stand for none."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.heights import HeightUnit
from lunarsci.names import one_of
from lunarsci.ranges import refuse

ERROR_LAYERS = ("height_m_sigma", "height_m_common_sigma", "count", "height_by_disparity_m_px", "resolution_m")
"""What an elevation model made of pictures has beside its heights."""


EVEN = 1e-4
"""How evenly nodes must be spaced, as a share of the spacing; assumed."""


METRES = {
    1.0: ("m", "metre", "meter"),
    1e3: ("km", "kilometre", "kilometer"),
    0.1: ("dm", "decimetre", "decimeter"),
    0.01: ("cm", "centimetre", "centimeter"),
    1e-3: ("mm", "millimetre", "millimeter"),
    0.3048: ("ft", "foot", "feet", "foot international", "international foot", "international feet", "ft intl"),
    1200.0 / 3937.0: ("us ft", "ft us", "ftus", "usft", "us survey foot", "us survey feet", "survey foot", "foot us"),
}
"""Metres in a unit, exactly, and its names in small letters (Thompson & Taylor 2008, NIST Special Publication 811, B.6
for feet)."""
NO_UNIT = ("", "none", "n a", "unk", "unknown", "null", "unspecified")
"""What stands for no unit."""
MARKERS = (
    *(-9999.0, -99999.0, -999999.0, 9999.0, 99999.0, 999999.0),
    *(-32768.0, -32767.0, -32766.0, 32767.0, 65535.0, -2147483648.0, 2147483647.0),
)
"""Numbers that stand for no height: -9999 of ESRI's grids and longer ones, the special pixels of ISIS for 16 bits, and
the ends of integers of 16 and 32 bits; assumed."""
USUALLY = "are without data, as such numbers are usually"
BEYOND = 1e19
"""No height is larger: -3.4e38, 1e20, 1.7e38 and -1e32 stand for none. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightGrid:
    """What a file of heights says.

    Attributes
    ----------
    name : what the ground is.
    x0_m, y0_m, spacing_m : position of node [0, 0] and distance of the nodes. [m]
    height_m : NaN where unknown; row is y, column is x. (ny, nx) [m]
    layers : further numbers, one or one for each node, by name.
    synthetic : True for made-up ground.
    made_for : JSON of the rover that the ground was made for, None where the file names none.
    crs : the coordinate system of x and y as well-known text; empty where none is named.
    crs_of_file : that of the file, which may be another one.
    unit : of the heights, as the file states it; empty where it states none.
    read_as : how the file was read, where there was a choice.
    beside : files beside this one that were read.
    """

    name: str
    x0_m: float
    y0_m: float
    spacing_m: float
    height_m: FloatArray
    layers: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    synthetic: bool = False
    made_for: str | None = None
    crs: str = ""
    crs_of_file: str = ""
    unit: str = "m"
    read_as: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


def layers_on(
    x_m: FloatArray, y_m: FloatArray, layers: Mapping[str, npt.NDArray[Any]]
) -> dict[str, tuple[tuple[str, ...], npt.NDArray[Any]]]:
    """Layers (ny, nx) with their axes, as `Result.layers` has them."""
    return {"y_m": (("y_m",), y_m), "x_m": (("x_m",), x_m)} | {
        key: (("y_m", "x_m"), one) for key, one in layers.items()
    }


def spacing_of(x: FloatArray, y: FloatArray) -> float:
    """The one distance of ascending nodes (nx,) and (ny,). Raises ParameterError where there is none. [m]"""
    axes = [axis.ravel() if axis.ndim == 1 and axis.size > 1 else np.zeros(2) for axis in (x, y)]
    steps = [float(axis[-1] - axis[0]) / (axis.size - 1) for axis in axes]
    uneven = [
        not (step > 0 and np.abs(np.diff(axis) - step).max() <= EVEN * step)
        for axis, step in zip(axes, steps, strict=True)
    ]
    faults = {
        "x_m and y_m must be lists of at least 3 numbers": {x.ndim, y.ndim} != {1} or min(x.size, y.size) < 3,
        f"{'x_m' if uneven[0] else 'y_m'} must ascend in even steps; sort it, or interpolate the heights to even ones":
            any(uneven),
        f"cells must be square: steps are {steps[0]:g} m in x_m and {steps[1]:g} m in y_m; interpolate the heights "
        f"to nodes {max(steps):g} m apart in both": abs(steps[1] - steps[0]) > EVEN * steps[0],
    }  # fmt: skip
    refuse(faults)
    return steps[0]


def metres_in(unit: str) -> float | None:
    """Metres in a unit of length, by one of its usual names; None where it is the name of none.

    >>> metres_in("Kilometers"), metres_in("US_survey_foot") == 1200 / 3937, metres_in("N/A")
    (1000.0, True, None)

    Raises ParameterError for a name that is not known.
    """
    plain = " ".join(re.sub(r"[^a-z]+", " ", unit.lower().replace(".", "")).split())
    if plain in NO_UNIT:
        return None
    for metres, names in METRES.items():
        if plain in names or plain.removesuffix("s") in names:
            return metres
    raise ParameterError(f"'{unit}' is no unit of length that is known; {one_of(unit, get_args(HeightUnit))}")


def without_markers(heights: FloatArray) -> tuple[FloatArray, str]:
    """Heights with NaN for what stands for none, and what was taken for that, '' where nothing was.

    A marker is a usual one, the lowest or highest number of all, and farther from the next one than that is from the
    others: a gap that is wider than all of the ground is high.
    """
    values = np.where(np.isinf(heights) | (np.abs(heights) > BEYOND), np.nan, heights)
    markers = np.unique(heights[~np.isnan(heights) & np.isnan(values)])[:1].tolist()
    # A height has no natural 0, so that only usual marks are looked for.
    while ends := [end for end in far_ends(values.reshape(1, -1), 1.0, from_zero=False) if end.value in MARKERS]:
        markers.append(ends[0].value)
        values = np.where(values == ends[0].value, np.nan, values)
    lost = int(np.isnan(values).sum() - np.isnan(heights).sum())
    names = [f"{value:g}" if math.isfinite(value) else "infinity" for value in markers]
    return values, f"{lost} nodes of {' and '.join(names)} {USUALLY}" if names else ""


class FarEnd(NamedTuple):
    """The lowest or highest number of a row.

    Attributes
    ----------
    value : the number, in the unit of the row.
    repeats : how often it is there.
    others : how many other numbers there are, NaN left out.
    """

    value: float
    repeats: int
    others: int


def far_ends(rows: FloatArray, times: float, *, from_zero: bool) -> Iterator[FarEnd]:
    """Ends of rows (n, c) that are farther from the next number than `times` the range of all others; NaN is none.

    The range is that of the others and of 0 where numbers are measured `from_zero`, as reflectances are.
    """
    for end in (np.fmin, np.fmax):
        edge = end.reduce(rows, axis=1)[:, None]
        at = rows == edge
        others = np.where(at, np.nan, rows)
        count = np.isfinite(others).sum(axis=1)
        low, high = np.fmin.reduce(others, axis=1), np.fmax.reduce(others, axis=1)
        if from_zero:
            low, high = np.fmin(low, 0.0), np.fmax(high, 0.0)
        with np.errstate(invalid="ignore"):
            gap = (low - edge[:, 0]) if end is np.fmin else (edge[:, 0] - high)
            far = (gap > times * (high - low)) & (count > 0)
        for row in np.flatnonzero(far).tolist():
            yield FarEnd(float(edge[row, 0]), int(at[row].sum()), int(count[row]))
