"""The picture of a prediction: the fan of paths on the terrain, the ends, and what the wheels meet on the way."""

from typing import TYPE_CHECKING, Any

from lunarsci.twin.figures.bands import draw_band
from lunarsci.twin.figures.relief import (
    GOLD,
    INK,
    LIMIT,
    color_bar,
    draw_ground,
    draw_keep_out,
    draw_paths,
    map_window,
    member_colors,
    shown_members,
)
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.judgement.endpoint import Endpoint, ErrorEllipse, scale_of
from lunarsci.twin.judgement.quantities import abscissa
from lunarsci.twin.judgement.safety import Verdict
from lunarsci.twin.simulation.ensemble import Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["path_fan"]

WHEELS = ("slip_ratio", "side_slip_deg", "sinkage_m")


def path_fan(prediction: Prediction, verdict: Verdict, terrain: Terrain | None = None) -> "Figure":
    """Terrain with planned and predicted paths, the ends about the destination, and wheel states against distance.

    The paths are coloured by the first swept parameter; at most 400 of them are drawn, evenly chosen. Bands span p05
    to p95 over members and wheels, the line is the median, dots are the extremes.
    """
    from matplotlib.figure import Figure

    terrain = terrain or prediction.terrain
    figure = Figure(figsize=(13.0, 8.2), dpi=130, layout="constrained", facecolor="white")
    columns: Any = figure.subfigures(1, 2, width_ratios=(1.75, 1.0))
    left = columns[0].subplots(2, 1, height_ratios=(1.45, 1.0))
    colors = member_colors(prediction)
    _draw_map(left[0], prediction, terrain, colors)
    _draw_ends(left[1], prediction, verdict, terrain, colors)
    if prediction.parameters:
        color_bar(columns[0], left, prediction)
    panels = columns[1].subplots(3, 1, sharex=True)
    columns[1].suptitle("All wheels of all members; upright lines: joints of the plan", fontsize=10)
    for panel, name in zip(panels, WHEELS, strict=True):
        draw_band(panel, prediction, verdict, name, legend=name == WHEELS[0])
    panels[-1].set_xlabel(abscissa(prediction)[1])
    ground = f"{terrain.name} (synthetic terrain)" if terrain.synthetic else terrain.name
    members = "1 member" if prediction.members == 1 else f"{prediction.members} members"
    length = f"{prediction.plan.length_m:.2f} m"
    figure.suptitle(
        f"Predicted drive of {length}: {verdict.verdict.upper()}   ·   {members}   ·   {ground}",
        fontsize=12,
        color=LIMIT if verdict.verdict == "no-go" else INK,
    )
    return figure


def _draw_map(axes: "Axes", prediction: Prediction, terrain: Terrain, colors: Any) -> None:
    draw_ground(axes, terrain, map_window(prediction, terrain), 0.1)
    draw_keep_out(axes, prediction)
    draw_paths(axes, prediction, colors, 0.7)
    start, end = prediction.planned[0], prediction.planned[-1]
    axes.plot(start[0], start[1], "o", color="white", markeredgecolor=INK, markersize=7, zorder=6, label="start")
    axes.plot(end[0], end[1], "*", color=GOLD, markeredgecolor=INK, markersize=13, zorder=6, label="destination")
    stopped = ~prediction.finished
    if stopped.any():
        ends = prediction.endpoints_m[stopped]
        axes.plot(ends[:, 0], ends[:, 1], "x", color=LIMIT, markersize=7, zorder=6, label="stopped early")
    axes.legend(loc="upper left", ncols=5, fontsize=8, framealpha=0.9)
    axes.set_title("Paths of the rover's origin; contours every 0.1 m", fontsize=10)


def _draw_ends(axes: "Axes", prediction: Prediction, verdict: Verdict, terrain: Terrain, colors: Any) -> None:
    """The last stretch, with error ellipses and the smallest circle about the destination that holds every end."""
    target = prediction.planned[-1, :2]
    end = verdict.endpoint
    draw_ground(axes, terrain, map_window(prediction, terrain), 0.02)
    draw_keep_out(axes, prediction)
    draw_paths(axes, prediction, colors, 0.9)
    shown = [m for m in shown_members(prediction) if prediction.finished[m]]
    ends = prediction.endpoints_m
    dots: dict[str, Any] = {"s": 14, "edgecolors": "white", "linewidths": 0.4, "zorder": 7}
    axes.scatter(ends[shown, 0], ends[shown, 1], c=[colors[m] for m in shown], **dots)
    axes.plot(*target, "*", color=GOLD, markeredgecolor=INK, markersize=15, zorder=8)
    reach = 0.5
    if end is not None:
        reach = max(end.covering_radius_m, end.bias_m + 3.0 * end.ellipse.semi_major_m if end.ellipse else 0.0)
        _draw_spread(axes, end)
    half = max(1.1 * reach, 0.1)
    axes.set_xlim(target[0] - 1.9 * half, target[0] + 1.9 * half)
    axes.set_ylim(target[1] - half, target[1] + half)
    text = f"all within {end.covering_radius_m:.3f} m of the destination" if end else "none reached the destination"
    axes.set_title(f"Ends: {text}; contours every 0.02 m", fontsize=10)


def _draw_spread(axes: "Axes", end: Endpoint) -> None:
    """Covering circle about the destination, mean of the ends, ellipses of 1 to 3 sigma and 95 %."""
    from matplotlib.patches import Circle

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
    axes.legend(list(named.values()), list(named), loc="upper right", fontsize=8, framealpha=0.9)


def _draw_ring(
    axes: "Axes", mean: tuple[float, float], ellipse: ErrorEllipse, sigma: float, width: float, style: str
) -> None:
    from matplotlib.patches import Ellipse

    size = (2.0 * sigma * ellipse.semi_major_m, 2.0 * sigma * ellipse.semi_minor_m)
    look: dict[str, Any] = {"fill": False, "edgecolor": INK, "linewidth": width, "linestyle": style, "zorder": 5}
    axes.add_patch(Ellipse(mean, *size, angle=ellipse.azimuth_deg, **look))


def _sample(axes: "Axes", width: float, style: str) -> Any:
    """A line for the legend, drawn nowhere."""
    return axes.plot([], [], color=INK, linewidth=width, linestyle=style)[0]
