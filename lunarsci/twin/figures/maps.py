"""Maps of terrain and ways on it, what one soil leaves unexplained along a way, and maps of the soils found."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from lunarsci.arrays import FloatArray
from lunarsci.figure import BLUE, INK, PAGE_IN, VERMILION, as_label, headline, legend_below, page
from lunarsci.regolith.figure import PARAMETER_LABELS
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.assimilation.residuals import OBSERVED, DriveRecord
from lunarsci.twin.assimilation.segments import SoilChange, traverse_of, wheel_places
from lunarsci.twin.assimilation.update import SoilUpdate
from lunarsci.twin.figures.panels import CONTOURS, GOLD, LABELS, draw_shade
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.ground.soil_map import SoilLayers, SoilMap
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, from_si
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.routes.planner import PlannedPath

PATH, HAZARD, UNKNOWN = VERMILION, "#B2182B", "#ffffff"
MOST_NODES = 900
"""Nodes drawn along each side at most; beyond that every second, third ... one."""
DOT, MEAN, CHANGE = "#9fb4c0", BLUE, PATH
HIGHEST, WINDOW_M = 8.0, 0.4
"""Residuals beyond are drawn at the edge; medians are those of such lengths of the way."""
ROUNDING_M = 1e-4
"""Roughness below this is not drawn: of a plane it is that of rounding."""


def terrain_maps(surface: Traversability, path: PlannedPath | None = None) -> Figure:
    """Four maps with one scale: relief with contours, slope, steps with roughness as contours, and traversability.

    The path of the rover's origin is drawn on each, the ground that its footprint sweeps on the first and the last.
    """
    terrain = surface.terrain
    wide = np.ptp(terrain.x_m) / np.ptp(terrain.y_m)
    figure = page(float(np.clip(5.4 / wide + 2.6, 4.8, 9.4)))
    axes: Any = figure.subplots(2, 2, sharex=True, sharey=True)
    step = max(1, -(-max(terrain.height_m.shape) // MOST_NODES))
    every = (slice(None, None, step), slice(None, None, step))
    draw_relief(axes[0, 0], terrain, every)
    if surface.sunlit is not None:
        _draw_shadow(axes[0, 0], terrain, surface.sunlit[every])
    _draw_slope(axes[0, 1], surface, every)
    _draw_steps(axes[1, 0], surface, every)
    _draw_traversability(axes[1, 1], surface, every)
    for number, panel in enumerate(axes.flat):
        extent = _extent(terrain)
        panel.set(aspect="equal", xlim=extent[:2], ylim=extent[2:])
        panel.label_outer()
        panel.set_xlabel("x [m]" if number > 1 else "")
        panel.set_ylabel("" if number % 2 else "y [m]")
        if path is not None:
            _draw_path(panel, path, terrain, outline=number in (0, 3))
    legend_below(figure, axes.flat)
    headline(figure, _title(surface, path), synthetic=surface.terrain.synthetic)
    return figure


def _title(surface: Traversability, path: PlannedPath | None) -> str:
    ground = as_label(surface.terrain.name)
    if path is None:
        return ground
    return (
        f"{ground}: path of {path.plan.length_m:.2f} m, nearest hazard {path.min_hazard_distance_m:.2f} m, "
        f"slope up to {path.max_slope_deg:.1f}°"
    )


def _extent(terrain: Terrain) -> tuple[float, float, float, float]:
    half, x, y = 0.5 * terrain.spacing_m, terrain.x_m, terrain.y_m
    return float(x[0]) - half, float(x[-1]) + half, float(y[0]) - half, float(y[-1]) + half


def _draw_shadow(axes: Axes, terrain: Terrain, lit: npt.NDArray[np.bool_]) -> None:
    """Ground in shadow, dark over the relief."""
    dark = np.ma.masked_array(np.ones(lit.shape), mask=lit)
    axes.imshow(
        dark, extent=_extent(terrain), origin="lower", cmap=ListedColormap([INK]), alpha=0.6, interpolation="nearest"
    )
    axes.set_title(f"{axes.get_title()}; dark: in shadow")


def draw_relief(axes: Axes, terrain: Terrain, every: tuple[slice, slice], *, height_bar: bool = True) -> None:
    """Shaded relief with contours."""
    height = np.ma.masked_invalid(terrain.height_m[every])
    axes.set_facecolor(UNKNOWN)
    drawn: Any = {"extent": _extent(terrain), "origin": "lower"}
    draw_shade(axes, height, terrain.spacing_m * (every[0].step or 1), extent=drawn["extent"])
    if height_bar:
        _bar(axes, axes.imshow(height, cmap="cividis", alpha=0.3, **drawn), "height [m]", extend="neither")
    span = float(height.max() - height.min())
    interval = next((value for value in CONTOURS if span / value <= 24), CONTOURS[-1])
    levels = np.arange(np.floor(float(height.min()) / interval), float(height.max()) / interval + 1) * interval
    if len(levels) > 2:
        style: Any = {"colors": INK, "linewidths": 0.5, "alpha": 0.6, "linestyles": "solid"}
        lines = axes.contour(terrain.x_m[every[1]], terrain.y_m[every[0]], height, levels=levels, **style)
        axes.clabel(lines, np.asarray(lines.levels)[::4], fmt="%g", fontsize=7)
    axes.set_title(f"relief, contours every {interval:g} m")


def _draw_map(
    axes: Axes, surface: Traversability, values: npt.NDArray[np.float32], every: tuple[slice, slice], color_map: str,
    top: float,
) -> Any:  # fmt: skip
    axes.set_facecolor(UNKNOWN)
    shown = np.ma.masked_invalid(values[every])
    extent = _extent(surface.terrain)
    return axes.imshow(
        shown, extent=extent, origin="lower", cmap=color_map, vmin=0.0, vmax=top, interpolation="nearest"
    )


def _top(values: npt.NDArray[np.float32], limit: float | None) -> float:
    """Upper end of a colour scale: the 99.5th percentile, or the limit where that is within twice of it."""
    finite = values[~np.isnan(values)]
    top = float(np.percentile(finite, 99.5)) if finite.size else 1.0
    if limit is not None and 0.5 * limit < top:
        return limit
    return max(top, 1e-6)


def _bar(axes: Axes, image: Any, label: str, extend: str = "max") -> Any:
    figure: Any = axes.figure
    bar = figure.colorbar(image, ax=axes, orientation="horizontal", fraction=0.05, pad=0.02, aspect=30, extend=extend)
    bar.set_label(label)
    return bar


def _draw_slope(axes: Axes, surface: Traversability, every: tuple[slice, slice]) -> None:
    maps, limit = surface.maps, surface.mobility.max_slope_deg
    image = _draw_map(axes, surface, maps.slope_deg, every, "viridis", _top(maps.slope_deg, limit))
    _bar(axes, image, "slope [°]")
    side = f"{maps.baseline_m:g} m × {maps.baseline_m:g} m"
    axes.set_title(f"slope over {side}; limit {limit:g}°")


def _draw_steps(axes: Axes, surface: Traversability, every: tuple[slice, slice]) -> None:
    """Steps in colour, roughness as a few contours."""
    maps, limit, terrain = surface.maps, surface.mobility.max_step_m, surface.terrain
    image = _draw_map(axes, surface, maps.step_m, every, "viridis", _top(maps.step_m, limit))
    _bar(axes, image, f"step within {maps.wheel_window_m:g} m [m]")
    finite = maps.roughness_m[~np.isnan(maps.roughness_m)]
    levels = np.unique(np.percentile(finite, (90, 97))) if finite.size else np.empty(0)
    if levels.size and float(levels[0]) > ROUNDING_M:
        rough = np.ma.masked_invalid(maps.roughness_m[every])
        x, y = terrain.x_m[every[1]], terrain.y_m[every[0]]
        lines = axes.contour(x, y, rough, levels=levels, colors="white", linewidths=(0.5, 1.0))
        axes.clabel(lines, fontsize=7, fmt=lambda value: f"{1e3 * value:.2g} mm")
    steps = f"steps, limit {limit:g} m" if maps.shows_steps else "steps not determined: too coarse a grid"
    axes.set_title(f"{steps}; white lines: rms roughness")


def _draw_traversability(axes: Axes, surface: Traversability, every: tuple[slice, slice]) -> None:
    color_map = colormaps["cividis"].with_extremes(over=HAZARD, bad=UNKNOWN)
    axes.set_facecolor(UNKNOWN)
    image = axes.imshow(
        np.ma.masked_invalid(np.minimum(surface.demand[every], 2.0)),
        extent=_extent(surface.terrain), origin="lower", cmap=color_map, vmin=0.0, vmax=1.0, interpolation="nearest",
    )  # fmt: skip
    _bar(axes, image, "largest share of a limit [-]")
    _hatch(axes, surface.terrain, surface.hazard[every], every)
    share = float((~surface.hazard & ~surface.unknown).mean())
    axes.set_title(f"{share:.1%} may be driven on; hatched: hazard")


def _hatch(axes: Axes, terrain: Terrain, hazard: npt.NDArray[np.bool_], every: tuple[slice, slice]) -> None:
    """Hatched in red, so that hazards are seen in grey, too; what is unknown stays white."""
    x, y = terrain.x_m[every[1]], terrain.y_m[every[0]]
    if hazard.any():
        drawn = axes.contourf(
            x, y, hazard.astype(float), levels=[0.5, 1.5], colors=[HAZARD], alpha=0.3, hatches=["////"]
        )
        drawn.set(edgecolor="white", linewidth=0.0)
        axes.fill([], [], facecolor=HAZARD, alpha=0.3, hatch="////", label="hazard")


def _draw_path(axes: Axes, path: PlannedPath, terrain: Terrain, *, outline: bool) -> None:
    poses = planned_pose(path.plan, np.linspace(0.0, path.plan.length_m, 400))
    axes.plot(poses[:, 0], poses[:, 1], color="white", linewidth=2.8, zorder=4)
    axes.plot(poses[:, 0], poses[:, 1], color=PATH, linewidth=1.5, zorder=5, label="path")
    axes.plot(poses[0, 0], poses[0, 1], "o", color="white", markeredgecolor=INK, markersize=6, zorder=6, label="start")
    axes.plot(*path.target_m, "*", color=GOLD, markeredgecolor=INK, markersize=13, zorder=6, label="target")
    if not outline:
        return
    swept = path.swept.astype(float)
    axes.contour(terrain.x_m, terrain.y_m, swept, levels=[0.5], colors=PATH, linewidths=0.9, linestyles="--", zorder=4)
    for pose in (poses[0], poses[-1]):
        corners = path.footprint.corners_m(pose)
        axes.add_patch(Polygon(corners, fill=False, edgecolor="white", linewidth=1.3, zorder=5))


def residual_page(record: DriveRecord, learned: SoilUpdate, changes: list[SoilChange]) -> Figure:
    """Measured less simulated on the best single soil, in errors, against the place of each wheel along the way.

    Lines are medians over 0.4 m; where the soil changes a line stands in the interval that holds it at 95 %.
    """
    places = wheel_places(learned.prediction.rover, record, traverse_of(learned.prediction))
    measured = [k for k in range(len(OBSERVED)) if np.isfinite(learned.residuals[:, k]).any()]
    figure = page(0.9 + 1.25 * max(len(measured), 1))
    axes: Any = figure.subplots(max(len(measured), 1), 1, sharex=True, squeeze=False)[:, 0]
    if not measured:
        axes[0].text(0.5, 0.5, "positions alone: no states to draw", transform=axes[0].transAxes, ha="center")
        axes[0].set_axis_off()
    for panel, k in zip(axes, measured, strict=False):
        values = np.clip(-learned.residuals[:, k], -HIGHEST, HIGHEST)
        seen = np.isfinite(values)
        panel.axhline(0.0, color=INK, linewidth=0.6)
        panel.axhspan(-2.0, 2.0, color=INK, alpha=0.06, linewidth=0.0)
        panel.plot(places[seen], values[seen], ".", color=DOT, markersize=3.0)
        panel.plot(*_medians(places[seen], values[seen]), color=MEAN, linewidth=1.4)
        reach = float(np.clip(np.abs(values[seen]).max() * 1.1, 3.0, HIGHEST * 1.05))
        panel.set_ylim(-reach, reach)
        panel.set_ylabel(f"{LABELS[OBSERVED[k]][0].partition(' [')[0]}\n[errors]")
        for change in changes:
            panel.axvspan(change.low_m, change.high_m, color=CHANGE, alpha=0.25, linewidth=0.0)
            panel.axvline(change.distance_m, color=CHANGE, linewidth=1.2)
    axes[-1].set_xlabel("way of the wheel [m]")
    count = (
        f"{len(changes)} change{'s' * (len(changes) > 1)} of the soil found"
        if changes
        else "no change of the soil found"
    )
    title = f"measured less simulated on one soil, in standard errors: {count}"
    headline(figure, title, synthetic=learned.prediction.terrain.synthetic)
    return figure


def _medians(places: Any, values: Any) -> tuple[Any, Any]:
    number = np.floor(places / WINDOW_M)
    middles = np.unique(number)
    return (middles + 0.5) * WINDOW_M, np.array([np.median(values[number == middle]) for middle in middles])


def soil_pages(layers: SoilLayers, soil_map: SoilMap) -> Iterator[Figure]:
    """Two pages of eight maps: medians, and what is left of the first laws' standard deviation; tracks are drawn."""
    terrain, shape = layers.terrain, layers.terrain.height_m.shape
    soil = {name: from_si(name, terrain.soil[..., SOIL_COLUMNS[name]]) for name in PARAMETERS}
    medians = {name: np.broadcast_to(values, shape) for name, values in soil.items()}
    length = f"{soil_map.correlation_m:g} m"
    yield _soil_page(layers, soil_map, medians, "median soil at every node", None)
    title = f"standard deviation left of the first one: 1 = nothing learned; soils alike over {length}, assumed"
    yield _soil_page(layers, soil_map, dict(layers.sd_ratio), title, (0.0, 1.0))


def _soil_page(
    layers: SoilLayers,
    soil_map: SoilMap,
    values: dict[str, FloatArray],
    title: str,
    limits: tuple[float, float] | None,
) -> Figure:
    terrain = layers.terrain
    tall = float(np.clip(np.ptp(terrain.y_m) / np.ptp(terrain.x_m), 0.3, 2.0))
    columns = 2 if tall < 0.75 else 4
    rows = len(PARAMETERS) // columns
    figure = page(rows * (tall * PAGE_IN / columns * 0.85 + 0.75) + 0.7)
    axes: Any = figure.subplots(rows, columns, sharex=True, sharey=True)
    drawn: Any = {"extent": _extent(terrain), "origin": "lower"}
    hole = np.isnan(terrain.height_m)
    for panel, name in zip(axes.flat, PARAMETERS, strict=True):
        shown = np.ma.masked_array(values[name], mask=hole)
        low, high = limits or _limits(shown)
        image = panel.imshow(shown, cmap="viridis" if limits is None else "cividis_r", vmin=low, vmax=high, **drawn)
        label = PARAMETER_LABELS[name]
        unit = label[label.index("[") :] if limits is None else "[-]"
        figure.colorbar(image, ax=panel, orientation="horizontal", fraction=0.05, pad=0.02, aspect=25, label=unit)
        panel.set_title(label.partition(" [")[0])
        panel.set_aspect("equal")
        _draw_tracks(panel, soil_map)
    for panel in axes[-1]:
        panel.set_xlabel("x [m]")
    for panel in axes[:, 0]:
        panel.set_ylabel("y [m]")
    headline(figure, f"{title}\n{as_label(terrain.name, 60)}", synthetic=terrain.synthetic)
    return figure


def _limits(values: FloatArray) -> tuple[float, float]:
    """Of a colour scale; no narrower than 2 %, so that rounding makes no pattern."""
    low, high = float(values.min()), float(values.max())
    least = 0.02 * max(abs(low), abs(high), 1e-9)
    return (low, high) if high - low > least else (0.5 * (low + high - least), 0.5 * (low + high + least))


def _draw_tracks(panel: Any, soil_map: SoilMap) -> None:
    for zone in soil_map.zones:
        panel.plot(*zone.place_m.T, ".", color=PATH, markersize=1.0)
        panel.plot(*zone.place_m[0], "o", color=PATH, markersize=3.0)
