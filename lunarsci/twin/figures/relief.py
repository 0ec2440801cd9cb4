"""The map below a prediction: shaded relief, paths, and colours of the members."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.simulation.ensemble import Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "ACCENT",
    "GOLD",
    "INK",
    "LIMIT",
    "PARAMETERS",
    "color_bar",
    "draw_ground",
    "draw_keep_out",
    "draw_paths",
    "draw_planned",
    "map_window",
    "member_colors",
    "shown_members",
]

INK, ACCENT, LIMIT, GOLD = "#26323a", "#1f6f8b", "#c0392b", "#f4c430"
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


def shown_members(prediction: Prediction) -> npt.NDArray[np.int64]:
    """At most 400 members, evenly chosen."""
    count = min(prediction.members, MOST_PATHS)
    return np.unique(np.linspace(0, prediction.members - 1, count).astype(np.int64))


def _scale(prediction: Prediction) -> Any:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

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
    bar = figure.colorbar(_scale(prediction), ax=list(axes), fraction=0.025, pad=0.01, aspect=45)
    bar.set_label(PARAMETERS.get(name, name))


def map_window(prediction: Prediction, terrain: Terrain, margin_m: float = MARGIN_M) -> tuple[slice, slice]:
    """Rows and columns of the terrain about the paths."""
    rows, columns = (
        np.flatnonzero((axis >= points.min() - margin_m) & (axis <= points.max() + margin_m))
        for axis, points in (
            (terrain.y_m, np.append(prediction.places_m[..., 1], prediction.planned[:, 1])),
            (terrain.x_m, np.append(prediction.places_m[..., 0], prediction.planned[:, 0])),
        )
    )
    whole = (slice(0, len(terrain.y_m)), slice(0, len(terrain.x_m)))
    if min(len(rows), len(columns)) < 3:
        return whole
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def draw_ground(axes: "Axes", terrain: Terrain, window: tuple[slice, slice], interval_m: float) -> None:
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
    axes.set(xlim=extent[:2], ylim=extent[2:])
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def draw_paths(axes: "Axes", prediction: Prediction, colors: Any, width: float) -> None:
    """The paths of the shown members as far as they came, and the planned one."""
    places = prediction.places_m
    for m in shown_members(prediction):
        part = places[m, : max(int(prediction.recorded[m]), 1)]
        axes.plot(part[:, 0], part[:, 1], color=colors[m], linewidth=width, alpha=0.85, zorder=3)
    draw_planned(axes, prediction)


def draw_planned(axes: "Axes", prediction: Prediction) -> None:
    """The planned path."""
    planned = prediction.planned
    axes.plot(planned[:, 0], planned[:, 1], color="white", linewidth=2.6, zorder=4)
    axes.plot(
        planned[:, 0], planned[:, 1], color=LIMIT, linewidth=1.3, linestyle=(0, (5, 2)), zorder=5, label="planned"
    )


def draw_keep_out(axes: "Axes", prediction: Prediction) -> None:
    """The circles that the plan keeps out of."""
    from matplotlib.patches import Circle

    for number, circle in enumerate(prediction.plan.keep_out):
        center, name = (circle.x_m, circle.y_m), "keep out" if number == 0 else None
        look: Any = {"facecolor": LIMIT, "alpha": 0.3, "linewidth": 0, "zorder": 2.5}
        axes.add_patch(Circle(center, circle.radius_m, **look))
        edge: Any = {"fill": False, "edgecolor": LIMIT, "linewidth": 1.3, "hatch": "//", "zorder": 2.6, "label": name}
        axes.add_patch(Circle(center, circle.radius_m, **edge))
        axes.annotate(circle.name, center, fontsize=7, ha="center", va="center", clip_on=True, zorder=2.7)
