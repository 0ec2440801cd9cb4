"""Pictures of a soil map over a terrain: median soil at every node, and how much of the first laws' spread is left.

The picture of what one soil leaves unexplained along a drive, and where the soil changes.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.assimilation.change_point import traverse_of, wheel_places
from lunarsci.twin.assimilation.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.assimilation.segments import SoilChange
from lunarsci.twin.assimilation.update import SoilUpdate
from lunarsci.twin.ground.soil_layers import SoilLayers
from lunarsci.twin.ground.soil_map import SoilMap
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, from_si

if TYPE_CHECKING:
    from matplotlib.figure import Figure


DOT, MEAN, CHANGE = "#9fb4c0", "#08519c", "#e6550d"
HIGHEST = 8.0
"""Residuals beyond are drawn at the edge."""
WINDOW_M = 0.4


def residual_page(record: DriveRecord, found: SoilUpdate, changes: list[SoilChange]) -> "Figure":
    """Measured less simulated on the best single soil, in errors, against the place of each wheel along the way.

    Lines are medians over 0.4 m; where the soil changes a line stands in the interval that holds it at 95 %.
    """
    from matplotlib.figure import Figure

    places = wheel_places(found.prediction.rover, record, traverse_of(found.prediction))
    known = [k for k in range(len(OBSERVED)) if np.isfinite(found.residuals[:, k]).any()]
    figure = Figure(figsize=(9.0, 1.2 + 1.6 * max(len(known), 1)), dpi=110, layout="constrained", facecolor="white")
    axes: Any = figure.subplots(max(len(known), 1), 1, sharex=True, squeeze=False)[:, 0]
    for panel, k in zip(axes, known, strict=True):
        values = np.clip(-found.residuals[:, k], -HIGHEST, HIGHEST)
        seen = np.isfinite(values)
        panel.axhline(0.0, color=INK, linewidth=0.6)
        panel.axhspan(-2.0, 2.0, color=INK, alpha=0.06, linewidth=0.0)
        panel.plot(places[seen], values[seen], ".", color=DOT, markersize=3.0)
        panel.plot(*_medians(places[seen], values[seen]), color=MEAN, linewidth=1.4)
        reach = float(np.clip(np.abs(values[seen]).max() * 1.1, 3.0, HIGHEST * 1.05))
        panel.set_ylim(-reach, reach)
        panel.set_ylabel(OBSERVED[k], fontsize=8, color=INK)
        panel.tick_params(labelsize=8)
        for change in changes:
            panel.axvspan(change.low_m, change.high_m, color=CHANGE, alpha=0.25, linewidth=0.0)
            panel.axvline(change.distance_m, color=CHANGE, linewidth=1.2)
    axes[-1].set_xlabel("Way of the wheel [m]")
    told = f"{len(changes)} change{'s' * (len(changes) > 1)} of the soil found" if changes else "no change found"
    figure.suptitle(f"Measured less simulated on one soil, in errors   ·   {told}", fontsize=11, color=INK)
    return figure


def _medians(places: Any, values: Any) -> tuple[Any, Any]:
    number = np.floor(places / WINDOW_M)
    middles = np.unique(number)
    return (middles + 0.5) * WINDOW_M, np.array([np.median(values[number == middle]) for middle in middles])


INK, PATH = "#26323a", "#e6550d"
LABELS = {
    "stiffness_kpa_m_n": "Stiffness [kPa/m$^N$]",
    "sinkage_exponent": "Sinkage exponent [-]",
    "sinkage_exponent_slip": "Sinkage exponent per slip [-]",
    "cohesion_pa": "Cohesion [Pa]",
    "friction_angle_deg": "Friction angle [deg]",
    "shear_modulus_mm": "Shear modulus [mm]",
    "external_friction_angle_deg": "External friction angle [deg]",
    "lateral_modulus_mm": "Lateral modulus [mm]",
}


def soil_pages(layers: SoilLayers, soil_map: SoilMap) -> "Iterator[Figure]":
    """Two pages of eight maps: medians, and what is left of the first laws' standard deviation; tracks are drawn."""
    terrain, shape = layers.terrain, layers.terrain.height_m.shape
    soil = {name: from_si(name, terrain.soil[..., SOIL_COLUMNS[name]]) for name in PARAMETERS}
    medians = {name: np.broadcast_to(values, shape) for name, values in soil.items()}
    length = f"{soil_map.correlation_m:g} m"
    yield _page(layers, soil_map, medians, "Median soil at every node", None)
    title = f"Left of the first laws' standard deviation: 1 = nothing known; soils alike over {length}, assumed"
    yield _page(layers, soil_map, dict(layers.sd_ratio), title, (0.0, 1.0))


def _page(
    layers: SoilLayers,
    soil_map: SoilMap,
    values: dict[str, FloatArray],
    title: str,
    limits: tuple[float, float] | None,
) -> "Figure":
    from matplotlib.figure import Figure

    terrain = layers.terrain
    tall = float(np.clip(np.ptp(terrain.y_m) / np.ptp(terrain.x_m), 0.3, 2.0))
    figure = Figure(figsize=(15.0, 2.0 * (3.0 * tall + 0.6) + 0.8), dpi=110, layout="constrained", facecolor="white")
    axes: Any = figure.subplots(2, 4, sharex=True, sharey=True)
    half = 0.5 * terrain.spacing_m
    x, y = terrain.x_m, terrain.y_m
    drawn: Any = {"extent": (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half), "origin": "lower"}
    hole = np.isnan(terrain.height_m)
    for panel, name in zip(axes.flat, PARAMETERS, strict=True):
        shown = np.ma.masked_array(values[name], mask=hole)
        low, high = limits or _limits(shown)
        image = panel.imshow(shown, cmap="viridis" if limits is None else "magma_r", vmin=low, vmax=high, **drawn)
        figure.colorbar(image, ax=panel, fraction=0.046, pad=0.01).ax.tick_params(labelsize=7)
        panel.set_title(LABELS[name], fontsize=10, color=INK)
        panel.set_aspect("equal")
        panel.tick_params(labelsize=8)
        _draw_tracks(panel, soil_map)
    for panel in axes[1]:
        panel.set_xlabel("x [m]")
    for panel in axes[:, 0]:
        panel.set_ylabel("y [m]")
    synthetic = " (synthetic)" if terrain.synthetic and "synthetic" not in terrain.name else ""
    figure.suptitle(f"{title}   ·   {terrain.name}{synthetic}", fontsize=12, color=INK)
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
