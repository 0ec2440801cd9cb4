"""What the wheels meet for each value of an uncertain soil parameter, as box plots."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.figures.bands import LABELS
from lunarsci.twin.figures.relief import ACCENT, INK, PARAMETERS
from lunarsci.twin.judgement.quantities import along

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["box_pages", "grouped"]

FloatArray = npt.NDArray[np.float64]

SHOWN = ("slip_ratio", "side_slip_deg", "sinkage_m")
MOST_BOXES, BINS = 15, 8
ROWS = 3


def grouped(values: FloatArray) -> list[tuple[float, npt.NDArray[np.bool_]]]:
    """Members by the value of a parameter: each value where there are at most 15, else eighths of equal count.

    Returns for each group its value, or the median of its values, and which members are in it.
    """
    distinct = np.unique(values)
    if len(distinct) <= MOST_BOXES:
        return [(float(value), values == value) for value in distinct]
    rank = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    number = rank * BINS // len(values)
    return [(float(np.median(values[number == k])), number == k) for k in range(BINS)]


def box_pages(prediction: Prediction) -> "Iterator[Figure]":
    """Slip ratio, side slip and sinkage against each swept parameter, three parameters to a page; none, no page.

    A box holds all wheel states of its members: quartiles and median, whiskers from p05 to p95, circle at the mean.
    """
    from matplotlib.figure import Figure

    names = [name for name, values in prediction.parameters.items() if np.ptp(values) > 0]
    for first in range(0, len(names), ROWS):
        own = names[first : first + ROWS]
        figure = Figure(figsize=(13.0, 0.9 + 3.6 * len(own)), dpi=130, layout="constrained", facecolor="white")
        panels = figure.subplots(len(own), len(SHOWN), squeeze=False)
        for row, name in zip(panels, own, strict=True):
            for panel, quantity in zip(row, SHOWN, strict=True):
                _draw_boxes(panel, prediction, name, quantity)
        figure.suptitle(
            "All wheel states of the members by soil: quartiles and median, whiskers p05 to p95, ○ mean", fontsize=12
        )
        yield figure


def _draw_boxes(axes: "Axes", prediction: Prediction, parameter: str, quantity: str) -> None:
    label, factor = LABELS[quantity]
    values = factor * along(prediction, quantity)
    groups = grouped(prediction.parameters[parameter])
    places, stats = [], []
    for place, members in groups:
        own = values[members][prediction.reached[members]].ravel()
        if own.size:
            places.append(place)
            stats.append(_box(own))
    if places:
        gap = float(np.diff(places).min()) if len(places) > 1 else 1.0
        axes.bxp(stats, positions=places, widths=0.6 * gap, showfliers=False, showmeans=True, **_look())
    axes.set_xticks(places, [f"{place:.4g}" for place in places], rotation=45 if len(places) > 9 else 0)
    if min(values.min(), 0.0) < 0.0:
        axes.axhline(0.0, color=INK, linewidth=0.6)
    binned = len(np.unique(prediction.parameters[parameter])) > MOST_BOXES
    axes.set_xlabel(PARAMETERS.get(parameter, parameter) + (", median of each eighth" if binned else ""))
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.25, linewidth=0.5)


def _box(values: FloatArray) -> dict[str, Any]:
    low, first, middle, third, high = np.percentile(values, (5, 25, 50, 75, 95))
    return {"whislo": low, "q1": first, "med": middle, "q3": third, "whishi": high, "mean": values.mean()}


def _look() -> dict[str, Any]:
    return {
        "patch_artist": True,
        "boxprops": {"facecolor": "#bcd7e0", "edgecolor": ACCENT, "linewidth": 1.0},
        "medianprops": {"color": INK, "linewidth": 1.6},
        "whiskerprops": {"color": ACCENT, "linewidth": 1.0},
        "capprops": {"color": ACCENT, "linewidth": 1.0},
        "meanprops": {"marker": "o", "markerfacecolor": "white", "markeredgecolor": INK, "markersize": 4},
    }
