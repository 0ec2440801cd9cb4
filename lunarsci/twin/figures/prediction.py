"""Pictures of a prediction: the fan of its paths, profiles, and boxes of wheel states."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.figure import INK, as_label, headline, legend_below, page
from lunarsci.regolith.figure import PARAMETER_LABELS
from lunarsci.twin.figures.panels import (
    ACCENT,
    GOLD,
    LABELS,
    LIMIT,
    color_bar,
    draw_band,
    draw_exclusion_zones,
    draw_ground,
    draw_loads,
    draw_paths,
    map_window,
    member_colors,
    shown_members,
    window_about,
)
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.judgement.endpoint import Endpoint, ErrorEllipse, scale_of
from lunarsci.twin.judgement.quantities import abscissa, along
from lunarsci.twin.judgement.safety import Verdict, arrivals, headword
from lunarsci.twin.judgement.tables import available
from lunarsci.twin.simulation.ensemble import Prediction

WHEELS = ("slip_ratio", "side_slip_deg", "sinkage_m")
LEFT = ("tilt_deg", "roll_deg", "pitch_deg", "miss_m")
RIGHT = ("clearance_m", "keep_out_m")
SHOWN = ("slip_ratio", "side_slip_deg", "sinkage_m")
MOST_BOXES, BINS = 15, 8
ROWS = 3


def path_fan(prediction: Prediction, verdict: Verdict) -> Figure:
    """Terrain with planned and predicted paths, the ends about the destination, and wheel states against distance.

    The paths are coloured by the first swept parameter; at most 400 of them are drawn, evenly chosen. Bands span p05
    to p95 over members and wheels, the line is the median, dots are the extremes.
    """
    terrain = prediction.terrain
    figure = page(8.6)
    parts: Any = figure.subfigures(3, 1, height_ratios=(1.5, 1.15, 1.0))
    maps = parts[0].subplots(), parts[1].subplots()
    colors = member_colors(prediction)
    _draw_map(maps[0], prediction, terrain, colors)
    legend_below(parts[0], maps[0], 5)
    _draw_ends(maps[1], prediction, verdict, terrain, colors)
    if prediction.parameters:
        color_bar(parts[0], maps[:1], prediction)
    panels = parts[2].subplots(1, 3)
    for panel, name in zip(panels, WHEELS, strict=True):
        draw_band(panel, prediction, verdict, name)
        panel.set_xlabel(abscissa(prediction)[1])
    legend_below(parts[2], panels)
    headline(parts[2], "all wheels of all members; upright lines: joints of the plan")
    members = "1 member" if prediction.members == 1 else f"{prediction.members} members"
    length = f"{prediction.plan.length_m:.2f} m"
    headline(
        figure,
        f"{headword(verdict)} for the drive of {length}, {members}, on {as_label(terrain.name)}",
        synthetic=terrain.synthetic,
        color=INK if verdict.verdict == "go" else LIMIT,
    )
    return figure


def _draw_map(axes: Axes, prediction: Prediction, terrain: Terrain, colors: Any) -> None:
    every_m = draw_ground(axes, terrain, map_window(prediction, terrain), 0.1)
    draw_exclusion_zones(axes, prediction)
    draw_paths(axes, prediction, colors, 0.7)
    start, end = prediction.planned[0], prediction.destination_m
    axes.plot(start[0], start[1], "o", color="white", markeredgecolor=INK, markersize=7, zorder=6, label="start")
    axes.plot(end[0], end[1], "*", color=GOLD, markeredgecolor=INK, markersize=13, zorder=6, label="destination")
    stopped = ~prediction.finished
    if stopped.any():
        ends = prediction.endpoints_m[stopped]
        axes.plot(ends[:, 0], ends[:, 1], "x", color=LIMIT, markersize=7, zorder=6, label="stopped early")
    axes.set_title(f"paths of the rover's origin; contours every {every_m:g} m")


def _draw_ends(axes: Axes, prediction: Prediction, verdict: Verdict, terrain: Terrain, colors: Any) -> None:
    """The last stretch, with error ellipses and the smallest circle about the destination that holds every end."""
    target = prediction.destination_m
    end = verdict.endpoint
    reach = 0.5
    if end is not None:
        reach = max(end.covering_radius_m, end.bias_m + 3.0 * end.ellipse.semi_major_m if end.ellipse else 0.0)
    half = max(1.1 * reach, 0.1)
    corners = np.asarray(target) + half * np.array([[-1.9, -1.0], [1.9, 1.0]])
    every_m = draw_ground(axes, terrain, window_about(terrain, corners, 0.0), 0.02)
    draw_exclusion_zones(axes, prediction)
    draw_paths(axes, prediction, colors, 0.9)
    shown = [m for m in shown_members(prediction) if prediction.finished[m]]
    ends = prediction.endpoints_m
    dots: dict[str, Any] = {"s": 14, "edgecolors": "white", "linewidths": 0.4, "zorder": 7}
    axes.scatter(ends[shown, 0], ends[shown, 1], c=[colors[m] for m in shown], **dots)
    axes.plot(*target, "*", color=GOLD, markeredgecolor=INK, markersize=15, zorder=8)
    if end is not None:
        _draw_spread(axes, end)
    edges = [(axis[0], axis[-1]) for axis in (terrain.x_m, terrain.y_m)]
    low, high = (np.clip(corner, *np.transpose(edges)) for corner in corners)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    who = "all" if verdict.arrived == verdict.members else arrivals(verdict.arrived, verdict.members)
    text = f"{who} within {end.covering_radius_m:.3f} m of the destination" if end else "none reached the destination"
    axes.set_title(f"ends: {text}; contours every {every_m:g} m")


def _draw_spread(axes: Axes, end: Endpoint) -> None:
    """Covering circle about the destination, mean of the ends, ellipses of 1 to 3 sigma and 95 %."""
    center, mean = (end.planned_x_m, end.planned_y_m), (end.x_m, end.y_m)
    radius = end.covering_radius_m
    axes.add_patch(Circle(center, radius, fill=False, edgecolor=INK, linewidth=1.4, linestyle=":", zorder=5))
    plus = axes.plot(*mean, "P", color="white", markeredgecolor=INK, markersize=9, zorder=8, linestyle="")
    named: dict[str, Any] = {"holds every end": _sample(axes, 1.4, ":"), "mean of the ends": plus[0]}
    if end.ellipse is not None:
        for sigma in (1.0, 2.0, 3.0):
            _draw_ring(axes, mean, end.ellipse, sigma, 0.8, "--")
        _draw_ring(axes, mean, end.ellipse, scale_of(0.95), 1.6, "-")
        named["error ellipses of 1, 2, 3 σ"] = _sample(axes, 0.8, "--")
        named["error ellipse of 95 %"] = _sample(axes, 1.6, "-")
    axes.legend(list(named.values()), list(named), loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)


def _draw_ring(
    axes: Axes, mean: tuple[float, float], ellipse: ErrorEllipse, sigma: float, width: float, style: str
) -> None:
    size = (2.0 * sigma * ellipse.semi_major_m, 2.0 * sigma * ellipse.semi_minor_m)
    look: dict[str, Any] = {"fill": False, "edgecolor": INK, "linewidth": width, "linestyle": style, "zorder": 5}
    axes.add_patch(Ellipse(mean, *size, angle=ellipse.azimuth_deg, **look))


def _sample(axes: Axes, width: float, style: str) -> Any:
    """A line for the legend, drawn nowhere."""
    return axes.plot([], [], color=INK, linewidth=width, linestyle=style)[0]


def profile_page(prediction: Prediction, verdict: Verdict) -> Figure:
    """Tilt, roll, pitch and miss on the left; clearance, distance to keep-out circles and wheel loads on the right.

    Bands span p05 to p95 over the members, the line is the median, dots are the extremes.
    """
    figure = page(7.2)
    columns: Any = figure.subfigures(1, 2)
    left, right = columns
    shown = [name for name in RIGHT if name in available(prediction)]
    panels = list(left.subplots(len(LEFT), 1, sharex=True))
    ratios = [1.0] * len(shown) + [float(len(LEFT) - len(shown))]
    others = list(right.subplots(len(shown) + 1, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0])
    for panel, name in zip([*panels, *others], [*LEFT, *shown], strict=False):
        draw_band(panel, prediction, verdict, name)
    draw_loads(others[-1], prediction)
    others[-1].set_title("load of each wheel: median, p05 to p95")
    legend_below(left, panels)
    legend_below(right, others[-1], 3)
    for lowest in (panels[-1], others[-1]):
        lowest.set_xlabel(abscissa(prediction)[1])
    members = "1 member" if prediction.members == 1 else f"all {prediction.members} members"
    title = f"profiles of {members}; upright lines: joints of the plan"
    headline(figure, title, synthetic=prediction.terrain.synthetic)
    return figure


def grouped(values: FloatArray) -> list[tuple[float, BoolArray]]:
    """Members by the value of a parameter: each value where there are at most 15, else eighths of equal count.

    Returns for each group its value, or the median of its values, and which members are in it.
    """
    distinct = np.unique(values)
    if len(distinct) <= MOST_BOXES:
        return [(float(value), values == value) for value in distinct]
    rank = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    number = rank * BINS // len(values)
    return [(float(np.median(values[number == k])), number == k) for k in range(BINS)]


def box_pages(prediction: Prediction) -> Iterator[Figure]:
    """Slip ratio, side slip and sinkage against each swept parameter, three parameters to a page; none, no page.

    A box holds all wheel states of its members: quartiles and median, whiskers from p05 to p95, circle at the mean.
    """
    names = [name for name, values in prediction.parameters.items() if np.ptp(values) > 0]
    for first in range(0, len(names), ROWS):
        subset = names[first : first + ROWS]
        figure = page(0.6 + 2.7 * len(subset))
        panels = figure.subplots(len(subset), len(SHOWN), squeeze=False)
        for row, name in zip(panels, subset, strict=True):
            for panel, quantity in zip(row, SHOWN, strict=True):
                _draw_boxes(panel, prediction, name, quantity)
        title = "all wheel states of the members, by soil: quartiles, median, whiskers p05 to p95, ○ mean"
        headline(figure, title, synthetic=prediction.terrain.synthetic)
        yield figure


def _draw_boxes(axes: Axes, prediction: Prediction, parameter: str, quantity: str) -> None:
    label, factor = LABELS[quantity]
    values = factor * along(prediction, quantity)
    groups = grouped(prediction.parameters[parameter])
    places, stats = [], []
    for place, members in groups:
        subset = values[members][prediction.reached[members]].ravel()
        if subset.size:
            places.append(place)
            stats.append(_box(subset))
    if places:
        gap = float(np.diff(places).min()) if len(places) > 1 else 1.0
        axes.bxp(
            stats, positions=places, widths=0.6 * gap, showfliers=False, showmeans=True, manage_ticks=False, **_look()
        )
    if len(places) > 5:
        axes.locator_params(axis="x", nbins=6)
    else:
        axes.set_xticks(places, [f"{place:.4g}" for place in places])
    if min(values.min(), 0.0) < 0.0:
        axes.axhline(0.0, color=INK, linewidth=0.6)
    binned = len(np.unique(prediction.parameters[parameter])) > MOST_BOXES
    axes.set_xlabel(
        PARAMETER_LABELS.get(parameter, as_label(parameter)) + ("\nmedian of each eighth" if binned else "")
    )
    axes.set_ylabel(label)
    axes.grid(axis="y")


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
