"""What pictures of drives share: shaded relief, and bands of quantities against distance."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, ListedColormap, Normalize
from matplotlib.patches import Circle

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.figure import BLUE, DOT_STYLES, INK, LINE_STYLES, as_label
from lunarsci.regolith.figure import PARAMETER_LABELS
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.judgement.quantities import abscissa, along
from lunarsci.twin.judgement.safety import Verdict
from lunarsci.twin.judgement.tables import spread
from lunarsci.twin.plans.plan import AT_LEAST
from lunarsci.twin.simulation.ensemble import Prediction

ACCENT, LIMIT, GOLD = BLUE, "#B2182B", "#f4c430"
"""What was predicted; limits and what breaks them; where the drive shall end."""
MARGIN_M = 3.6
NO_HEIGHT = "#d9b8b0"
MOST_PATHS = 400
LABELS = {
    "slip_ratio": ("slip ratio s [-]", 1.0),
    "side_slip_deg": ("side slip β [°]", 1.0),
    "sinkage_m": ("sinkage z [mm]", 1e3),
    "tilt_deg": ("tilt [°]", 1.0),
    "roll_deg": ("roll [°]", 1.0),
    "pitch_deg": ("pitch, nose down [°]", 1.0),
    "clearance_m": ("ground clearance [m]", 1.0),
    "keep_out_m": ("distance from keep-outs [m]", 1.0),
    "miss_m": ("off the planned place [m]", 1.0),
    "normal_force_n": ("normal force F$_N$ [N]", 1.0),
    "drawbar_pull_n": ("drawbar pull F$_{DP}$ [N]", 1.0),
    "lateral_force_n": ("lateral force F$_L$ [N]", 1.0),
    "resistance_torque_nm": ("resistance torque M$_R$ [N m]", 1.0),
}
"""Axis label, and factor from the quantity's unit to the label's."""
CONTOURS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SIGNED = ("slip_ratio", "side_slip_deg")


def shown_members(prediction: Prediction) -> IntArray:
    """At most 400 members, evenly chosen."""
    count = min(prediction.members, MOST_PATHS)
    return np.unique(np.linspace(0, prediction.members - 1, count).astype(np.int64))


def _scale(prediction: Prediction) -> Any:
    values = next(iter(prediction.parameters.values()))
    return ScalarMappable(Normalize(float(values.min()), float(values.max())), colormaps["viridis"])


def member_colors(prediction: Prediction) -> Any:
    """A colour for each member, by the first swept parameter."""
    if not prediction.parameters:
        return [ACCENT] * prediction.members
    return _scale(prediction).to_rgba(next(iter(prediction.parameters.values())))


def color_bar(figure: Any, axes: Any, prediction: Prediction) -> None:
    """What the colours of the members mean."""
    name = next(iter(prediction.parameters))
    bar = figure.colorbar(
        _scale(prediction), ax=list(axes), orientation="horizontal", fraction=0.05, pad=0.02, aspect=45
    )
    bar.set_label(PARAMETER_LABELS.get(name, as_label(name)))


def map_window(prediction: Prediction, terrain: Terrain, margin_m: float = MARGIN_M) -> tuple[slice, slice]:
    """Rows and columns of the terrain about the paths."""
    return window_about(terrain, np.vstack([prediction.places_m.reshape(-1, 2), prediction.planned[:, :2]]), margin_m)


def window_about(terrain: Terrain, places_m: FloatArray, margin_m: float) -> tuple[slice, slice]:
    """Rows and columns of the terrain about some places (n, 2), NaN where there is none; all where these are few."""
    rows, columns = (
        np.flatnonzero((axis >= np.nanmin(points) - margin_m) & (axis <= np.nanmax(points) + margin_m))
        for axis, points in ((terrain.y_m, places_m[:, 1]), (terrain.x_m, places_m[:, 0]))
    )
    whole = (slice(0, len(terrain.y_m)), slice(0, len(terrain.x_m)))
    if min(len(rows), len(columns)) < 3:
        return whole
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def draw_shade(axes: Axes, height: Any, spacing_m: float, **look: Any) -> None:
    """Shaded relief of heights, masked where there are none, in light from the upper left."""

    # Matplotlib takes the first row for the north one.
    shade = LightSource(315, 35).hillshade(height.filled(float(height.mean()))[::-1], 4.0, spacing_m, spacing_m)[::-1]
    shade = np.ma.masked_array(shade, mask=np.ma.getmaskarray(height))
    axes.imshow(shade, origin="lower", cmap="gray", vmin=-0.35, vmax=1.05, **look)


def draw_ground(axes: Axes, terrain: Terrain, window: tuple[slice, slice], interval_m: float) -> float:
    """Shaded relief with contour lines; gaps of the model that were filled in the colour of ground without heights.

    Returns how far apart the lines are: `interval_m`, or farther where these would be too many. [m]
    """
    x, y = terrain.x_m[window[1]], terrain.y_m[window[0]]
    height, half = np.ma.masked_invalid(terrain.height_m[window]), 0.5 * terrain.spacing_m
    extent = (float(x[0]) - half, float(x[-1]) + half, float(y[0]) - half, float(y[-1]) + half)
    axes.set_facecolor(NO_HEIGHT)
    draw_shade(axes, height, terrain.spacing_m, extent=extent, interpolation="bilinear")
    span = float(height.max() - height.min())
    interval_m = next((step for step in CONTOURS if step >= interval_m and span <= 40.0 * step), CONTOURS[-1])
    levels = np.arange(float(height.min()), float(height.max()) + interval_m, interval_m)
    if len(levels) > 2:
        axes.contour(x, y, height, levels=levels, colors=INK, linewidths=0.5, alpha=0.55)
    if terrain.errors is not None and (filled := terrain.errors.filled).any():
        unseen = np.ma.masked_array(np.ones(filled[window].shape), mask=~filled[window])
        look: Any = {"cmap": ListedColormap([NO_HEIGHT]), "alpha": 0.75, "interpolation": "nearest", "zorder": 2}
        axes.imshow(unseen, origin="lower", extent=extent, **look)
        axes.fill([], [], facecolor=NO_HEIGHT, alpha=0.75, label="not seen, filled")
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return interval_m


def draw_paths(axes: Axes, prediction: Prediction, colors: Any, width: float) -> None:
    """The paths of the shown members as far as they came, and the planned one."""
    places = prediction.places_m
    for m in shown_members(prediction):
        part = places[m, : max(int(prediction.recorded[m]), 1)]
        axes.plot(part[:, 0], part[:, 1], color=colors[m], linewidth=width, alpha=0.85, zorder=3)
    draw_planned(axes, prediction)


def draw_planned(axes: Axes, prediction: Prediction) -> None:
    """The planned path."""
    planned = prediction.planned
    axes.plot(planned[:, 0], planned[:, 1], color="white", linewidth=2.6, zorder=4)
    axes.plot(
        planned[:, 0], planned[:, 1], color=LIMIT, linewidth=1.3, linestyle=(0, (5, 2)), zorder=5, label="planned"
    )


def draw_exclusion_zones(axes: Axes, prediction: Prediction) -> None:
    """The circles that the plan keeps out of."""
    for number, circle in enumerate(prediction.plan.exclusion_zones):
        center, name = (circle.x_m, circle.y_m), "keep out" if number == 0 else None
        look: Any = {"facecolor": LIMIT, "alpha": 0.3, "linewidth": 0, "zorder": 2.5}
        axes.add_patch(Circle(center, circle.radius_m, **look))
        edge: Any = {"fill": False, "edgecolor": LIMIT, "linewidth": 1.3, "hatch": "//", "zorder": 2.6, "label": name}
        axes.add_patch(Circle(center, circle.radius_m, **edge))
        axes.annotate(as_label(circle.name, 24), center, ha="center", va="center", clip_on=True, zorder=2.7)


def wheel_line(number: int) -> Any:
    """Colour and dashes of a wheel's line, by its place in the rover."""
    return LINE_STYLES[number % len(LINE_STYLES)]


def wheel_dots(number: int) -> Any:
    """Colour and shape of a wheel's dots, by its place in the rover."""
    return DOT_STYLES[number % len(DOT_STYLES)]


def draw_band(axes: Axes, prediction: Prediction, verdict: Verdict, quantity: str) -> None:
    """p05 to p95, median and extremes over members and wheels, and the limit where it is in sight."""
    label, factor = LABELS[quantity]
    where, _ = abscissa(prediction)
    low, middle, high, least, most = factor * spread(along(prediction, quantity), prediction.reached)
    axes.fill_between(where, low, high, color=ACCENT, alpha=0.25, linewidth=0, label="p05 to p95")
    for edge, name in ((least, "min and max"), (most, None)):
        axes.plot(where, edge, color=ACCENT, linewidth=0.9, linestyle=":", label=name)
    axes.plot(where, middle, color=ACCENT, linewidth=1.4, label="median")
    _draw_joints(axes, prediction)
    axes.set_ylabel(label)
    for judgement in verdict.limits:
        if judgement.quantity == (quantity if quantity != "miss_m" else "endpoint_miss_m"):
            _draw_limit(axes, quantity, factor * judgement.limit, _unit(label))


def draw_loads(axes: Axes, prediction: Prediction) -> None:
    """Normal force of each wheel: median and p05 to p95 over the members."""
    where, _ = abscissa(prediction)
    forces = along(prediction, "normal_force_n")
    for number, wheel in enumerate(prediction.rover.wheels):
        low, middle, high, *_ = spread(forces[..., number], prediction.reached)
        look = wheel_line(number)
        axes.fill_between(where, low, high, color=look["color"], alpha=0.15, linewidth=0)
        axes.plot(where, middle, label=as_label(wheel), **look)
    _draw_joints(axes, prediction)
    axes.set_ylabel(LABELS["normal_force_n"][0])


def _draw_joints(axes: Axes, prediction: Prediction) -> None:
    """Upright lines where the pieces of the plan join, range and grid."""
    where, _ = abscissa(prediction)
    if where is prediction.distance_m:
        for place in np.cumsum([leg.length_m for leg in prediction.plan.legs])[:-1]:
            axes.axvline(place, color=INK, linewidth=0.6, alpha=0.35)
    axes.set_xlim(float(where[0]), float(where[-1]))
    axes.grid()


def _unit(label: str) -> str:
    unit = label[label.index("[") + 1 : -1]
    return "" if unit == "-" else f" {unit}"


def _draw_limit(axes: Axes, quantity: str, limit: float, unit: str) -> None:
    """Dashed lines where the limit is in sight, and its value in any case."""
    bottom, top = axes.get_ylim()
    signed = bottom < 0 and quantity in SIGNED
    for line in (-limit, limit) if signed else (limit,):
        if bottom - 0.3 * (top - bottom) < line < top + 0.3 * (top - bottom):
            axes.axhline(line, color=LIMIT, linewidth=1.0, linestyle="--")
    if signed:
        axes.axhline(0.0, color=INK, linewidth=0.6)
    sense = "at least " if quantity in AT_LEAST else "±" if signed else ""
    where = " at the end" if quantity == "miss_m" else ""
    axes.set_title(f"limit{where} {sense}{limit:.4g}{unit}", color=LIMIT, loc="right")
