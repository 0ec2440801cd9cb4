"""The picture of a prediction: the fan of paths on the terrain, the ends, and what the wheels meet on the way."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ensemble import STATE_COLUMNS, Prediction
from lunarsci.twin.safety import Verdict
from lunarsci.twin.terrain import Terrain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["path_fan"]

FloatArray = npt.NDArray[np.float64]

INK, ACCENT, LIMIT, GOLD = "#26323a", "#1f6f8b", "#c0392b", "#f4c430"
LABELS = {
    "slip_ratio": ("Slip ratio s [-]", 1.0),
    "side_slip_deg": ("Side slip β [deg]", 1.0),
    "sinkage_m": ("Sinkage z [mm]", 1e3),
}
PARAMETERS = {
    "stiffness_kpa_m_n": "Stiffness K$_s$ [kPa m$^{-N}$]",
    "sinkage_exponent": "Sinkage exponent N [-]",
    "sinkage_exponent_slip": "Dynamic sinkage exponent n$_1$ [-]",
    "cohesion_pa": "Cohesion c [Pa]",
    "friction_angle_deg": "Internal friction angle φ [deg]",
    "shear_modulus_mm": "Shear modulus K$_x$ [mm]",
    "external_friction_angle_deg": "External friction angle φ$_y$ [deg]",
    "lateral_modulus_mm": "Lateral modulus K$_y$ [mm]",
}
MARGIN_M = 3.6
MOST_PATHS = 400


def path_fan(prediction: Prediction, verdict: Verdict, terrain: Terrain | None = None) -> "Figure":
    """Terrain with planned and predicted paths, the ends about the destination, and wheel states against distance.

    The paths are coloured by the first swept parameter; at most 400 of them are drawn, evenly chosen. Bands span p5 to
    p95 over members and wheels, the line is the median.
    """
    from matplotlib.figure import Figure

    terrain = terrain or prediction.terrain
    figure = Figure(figsize=(13.0, 8.2), dpi=130, layout="constrained", facecolor="white")
    columns: Any = figure.subfigures(1, 2, width_ratios=(1.75, 1.0))
    left = columns[0].subplots(2, 1, height_ratios=(1.45, 1.0))
    colors = _member_colors(prediction)
    _draw_map(left[0], prediction, terrain, colors)
    _draw_ends(left[1], prediction, verdict, terrain, colors)
    if prediction.parameters:
        _color_bar(columns[0], left, prediction)
    panels = columns[1].subplots(3, 1, sharex=True)
    columns[1].suptitle("All wheels of all members; upright lines: joints of the arcs", fontsize=10)
    for panel, name in zip(panels, LABELS, strict=True):
        _draw_band(panel, prediction, verdict, name)
    panels[-1].set_xlabel("Commanded distance [m]")
    ground = f"{terrain.name} (synthetic terrain)" if terrain.synthetic else terrain.name
    members = "1 member" if prediction.members == 1 else f"{prediction.members} members"
    length = f"{prediction.plan.length_m:.2f} m"
    figure.suptitle(
        f"Predicted drive of {length}: {verdict.verdict.upper()}   ·   {members}   ·   {ground}",
        fontsize=12,
        color=LIMIT if verdict.verdict == "no-go" else INK,
    )
    return figure


def _shown(prediction: Prediction) -> npt.NDArray[np.int64]:
    count = min(prediction.members, MOST_PATHS)
    return np.unique(np.linspace(0, prediction.members - 1, count).astype(np.int64))


def _scale(prediction: Prediction) -> Any:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    values = next(iter(prediction.parameters.values()))
    return ScalarMappable(Normalize(float(values.min()), float(values.max())), colormaps["viridis"])


def _member_colors(prediction: Prediction) -> Any:
    if not prediction.parameters:
        return [ACCENT] * prediction.members
    return _scale(prediction).to_rgba(next(iter(prediction.parameters.values())))


def _color_bar(figure: Any, axes: Any, prediction: Prediction) -> None:
    name = next(iter(prediction.parameters))
    bar = figure.colorbar(_scale(prediction), ax=list(axes), fraction=0.025, pad=0.01, aspect=45)
    bar.set_label(PARAMETERS.get(name, name))


def _window(prediction: Prediction, terrain: Terrain) -> tuple[slice, slice]:
    """Rows and columns of the terrain about the paths."""
    rows, columns = (
        np.flatnonzero((axis >= points.min() - MARGIN_M) & (axis <= points.max() + MARGIN_M))
        for axis, points in (
            (terrain.y_m, np.append(prediction.paths[..., 1], prediction.planned[:, 1])),
            (terrain.x_m, np.append(prediction.paths[..., 0], prediction.planned[:, 0])),
        )
    )
    whole = (slice(0, len(terrain.y_m)), slice(0, len(terrain.x_m)))
    if min(len(rows), len(columns)) < 3:
        return whole
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _draw_ground(axes: "Axes", terrain: Terrain, window: tuple[slice, slice], interval_m: float) -> None:
    """Shaded relief, light from the upper left, with contour lines."""
    from matplotlib.colors import LightSource

    x, y = terrain.x_m[window[1]], terrain.y_m[window[0]]
    height = np.ma.masked_invalid(terrain.height_m[window])
    half = 0.5 * terrain.spacing_m
    light, step = LightSource(315, 35), terrain.spacing_m
    # Matplotlib takes the first row for the north one.
    shade = light.hillshade(height.filled(float(height.mean()))[::-1], 4.0, step, step)[::-1]
    extent = (float(x[0]) - half, float(x[-1]) + half, float(y[0]) - half, float(y[-1]) + half)
    shade = np.ma.masked_array(shade, mask=np.ma.getmaskarray(height))
    axes.set_facecolor("#d9b8b0")
    axes.imshow(shade, extent=extent, origin="lower", cmap="gray", vmin=-0.35, vmax=1.05, interpolation="bilinear")
    span = float(height.max() - height.min())
    levels = np.arange(float(height.min()), float(height.max()) + interval_m, max(interval_m, span / 40.0))
    if len(levels) > 2:
        axes.contour(x, y, height, levels=levels, colors=INK, linewidths=0.5, alpha=0.55)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _draw_paths(axes: "Axes", prediction: Prediction, colors: Any, width: float) -> None:
    for m in _shown(prediction):
        part = prediction.paths[m, : max(int(prediction.recorded[m]), 1)]
        axes.plot(part[:, 0], part[:, 1], color=colors[m], linewidth=width, alpha=0.85, zorder=3)
    planned = prediction.planned
    axes.plot(planned[:, 0], planned[:, 1], color="white", linewidth=2.6, zorder=4)
    axes.plot(
        planned[:, 0], planned[:, 1], color=LIMIT, linewidth=1.3, linestyle=(0, (5, 2)), zorder=5, label="planned"
    )


def _draw_map(axes: "Axes", prediction: Prediction, terrain: Terrain, colors: Any) -> None:
    _draw_ground(axes, terrain, _window(prediction, terrain), 0.1)
    _draw_paths(axes, prediction, colors, 0.7)
    start, end = prediction.planned[0], prediction.planned[-1]
    axes.plot(start[0], start[1], "o", color="white", markeredgecolor=INK, markersize=7, zorder=6, label="start")
    axes.plot(end[0], end[1], "*", color=GOLD, markeredgecolor=INK, markersize=13, zorder=6, label="destination")
    stopped = ~prediction.finished
    if stopped.any():
        ends = prediction.endpoints_m[stopped]
        axes.plot(ends[:, 0], ends[:, 1], "x", color=LIMIT, markersize=7, zorder=6, label="stopped early")
    axes.legend(loc="upper left", ncols=4, fontsize=8, framealpha=0.9)
    axes.set_title("Paths of the rover's origin; contours every 0.1 m", fontsize=10)


def _draw_ends(axes: "Axes", prediction: Prediction, verdict: Verdict, terrain: Terrain, colors: Any) -> None:
    """The last stretch, with the smallest circle about the destination that holds every end."""
    from matplotlib.patches import Circle

    target = prediction.planned[-1, :2]
    radius = verdict.endpoint.covering_radius_m if verdict.endpoint else 0.5
    _draw_ground(axes, terrain, _window(prediction, terrain), 0.02)
    _draw_paths(axes, prediction, colors, 0.9)
    shown = [m for m in _shown(prediction) if prediction.finished[m]]
    ends = prediction.endpoints_m
    dots: dict[str, Any] = {"s": 18, "edgecolors": "white", "linewidths": 0.5, "zorder": 6}
    axes.scatter(ends[shown, 0], ends[shown, 1], c=[colors[m] for m in shown], **dots)
    axes.plot(*target, "*", color=GOLD, markeredgecolor=INK, markersize=15, zorder=7)
    if verdict.endpoint:
        center = (float(target[0]), float(target[1]))
        axes.add_patch(Circle(center, radius, fill=False, color=INK, linewidth=1.4, linestyle=":", zorder=6))
        mean = (verdict.endpoint.x_m, verdict.endpoint.y_m)
        axes.plot(*mean, "P", color="white", markeredgecolor=INK, markersize=9, zorder=7)
    half = max(1.35 * radius, 0.1)
    axes.set_xlim(target[0] - 1.9 * half, target[0] + 1.9 * half)
    axes.set_ylim(target[1] - half, target[1] + half)
    text = f"every end within {radius:.3f} m (dotted), + is their mean" if verdict.endpoint else "none reached the end"
    axes.set_title(f"At the destination: {text}", fontsize=10)


def _draw_band(axes: "Axes", prediction: Prediction, verdict: Verdict, name: str) -> None:
    """p5, p50 and p95 over members and wheels at each distance, and the limit where it is in sight."""
    label, factor = LABELS[name]
    values = factor * prediction.states[..., STATE_COLUMNS.index(name)]
    values = np.where(prediction.reached[..., None], values, np.nan)
    used = prediction.reached.any(axis=0)
    if used.any():
        low, middle, high = np.nanpercentile(values[:, used], (5, 50, 95), axis=(0, 2))
        distance = prediction.distance_m[used]
        axes.fill_between(distance, low, high, color=ACCENT, alpha=0.22, linewidth=0, label="p5 to p95")
        axes.plot(distance, middle, color=ACCENT, linewidth=1.6, label="median")
    for judgement in verdict.limits:
        if judgement.quantity == name:
            _draw_limit(axes, factor * judgement.limit)
    for place in np.cumsum([leg.length_m for leg in prediction.plan.legs])[:-1]:
        axes.axvline(place, color=INK, linewidth=0.6, alpha=0.35)
    axes.set_xlim(0.0, float(prediction.distance_m[-1]))
    axes.set_ylabel(label)
    axes.grid(alpha=0.25, linewidth=0.5)
    if name == next(iter(LABELS)) and used.any():
        axes.legend(loc="upper right", fontsize=8, frameon=False)


def _draw_limit(axes: "Axes", limit: float) -> None:
    """Dashed lines where the limit is in sight, and its value in any case."""
    bottom, top = axes.get_ylim()
    signed = bottom < 0
    for line in (-limit, limit) if signed else (limit,):
        if bottom - 0.3 * (top - bottom) < line < top + 0.3 * (top - bottom):
            axes.axhline(line, color=LIMIT, linewidth=1.0, linestyle="--")
    if signed:
        axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.set_title(f"limit {'±' if signed else ''}{limit:g}", fontsize=8, color=LIMIT, loc="right")
