"""What the wheels meet for each value of an uncertain soil parameter, as box plots.

The page of profiles: attitude, clearance, miss and wheel loads against distance.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.figures.bands import LABELS, draw_band, draw_loads
from lunarsci.twin.figures.relief import ACCENT, INK, PARAMETERS
from lunarsci.twin.judgement.quantities import abscissa, along
from lunarsci.twin.judgement.safety import Verdict
from lunarsci.twin.judgement.tables import available
from lunarsci.twin.simulation.ensemble import Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["box_pages", "grouped", "profile_page"]

LEFT = ("tilt_deg", "roll_deg", "pitch_deg", "miss_m")
RIGHT = ("clearance_m", "keep_out_m")


def profile_page(prediction: Prediction, verdict: Verdict) -> "Figure":
    """Tilt, roll, pitch and miss on the left; clearance, distance to keep-out circles and wheel loads on the right.

    Bands span p05 to p95 over the members, the line is the median, dots are the extremes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 8.2), dpi=130, layout="constrained", facecolor="white")
    columns: Any = figure.subfigures(1, 2)
    left, right = columns
    shown = [name for name in RIGHT if name in available(prediction)]
    panels = list(left.subplots(len(LEFT), 1, sharex=True))
    ratios = [1.0] * len(shown) + [float(len(LEFT) - len(shown))]
    others = list(right.subplots(len(shown) + 1, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0])
    for panel, name in zip([*panels, *others], [*LEFT, *shown], strict=False):
        draw_band(panel, prediction, verdict, name, legend=panel is panels[0])
    draw_loads(others[-1], prediction)
    others[-1].set_title("load of each wheel", fontsize=9)
    for lowest in (panels[-1], others[-1]):
        lowest.set_xlabel(abscissa(prediction)[1])
    members = "1 member" if prediction.members == 1 else f"all {prediction.members} members"
    figure.suptitle(f"Profiles of {members}; upright lines: joints of the plan", fontsize=12)
    return figure


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
