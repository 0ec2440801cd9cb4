"""The picture of a drive's telemetry: its way over the ground, and the states of its wheels along it."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.figures.bands import LABELS, WHEEL_COLORS
from lunarsci.twin.figures.relief import ACCENT, GOLD, INK, LIMIT, draw_ground
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.telemetry.states import DriveStates

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["states_page"]

FloatArray = npt.NDArray[np.float64]
PANELS = ("slip_ratio", "side_slip_deg", "sinkage_m")
MARGIN_M = 1.6
WORDS = 60
"""Letters of a finding that are drawn."""


def states_page(drive: DriveStates, terrain: Terrain, title: str) -> "Figure":
    """Map with wheel tracks, positions and smoothed way above; slip, side slip and sinkage against distance below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 13.0), dpi=130, layout="constrained", facecolor="white")
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.0, 1.55])
    _draw_map(parts[0].subplots(), drive, terrain)
    panels = parts[1].subplots(3, 1, sharex=True)
    for panel, name in zip(panels, PANELS, strict=True):
        _draw_states(panel, drive, name)
    handles, labels = panels[0].get_legend_handles_labels()
    parts[1].legend(handles, labels, loc="outside lower center", ncols=8, fontsize=8, frameon=False)
    panels[0].set_title("One state between two positions; bars: 68 %; hollow: not valid", fontsize=10)
    panels[-1].set_xlabel("Way as the wheels say [m]")
    figure.suptitle(title, fontsize=12)
    return figure


def _draw_map(axes: "Axes", drive: DriveStates, terrain: Terrain) -> None:
    from matplotlib.patches import Ellipse

    places = drive.held.states[..., :2]
    points = np.vstack([places.reshape(-1, 2), drive.nodes.fix_m])
    draw_ground(axes, terrain, _window(points, terrain), 0.1)
    for k in range(places.shape[1]):
        axes.plot(*places[:, k].T, color=WHEEL_COLORS[k], linewidth=0.9, alpha=0.9, zorder=3)
    motion, telemetry = drive.motion, drive.telemetry
    axes.plot(motion.x_m, motion.y_m, color="white", linewidth=3.0, zorder=4)
    axes.plot(motion.x_m, motion.y_m, color=ACCENT, linewidth=1.6, zorder=5, label="smoothed way of the rover's origin")
    for begin, end in drive.gaps:
        inside = (motion.time_s >= begin) & (motion.time_s <= end)
        axes.plot(motion.x_m[inside], motion.y_m[inside], color=GOLD, linewidth=4.0, zorder=5.5, label="gap")
    rows = telemetry.fixed & ~np.isin(telemetry.time_s, drive.left_out[:, 0])
    fixes = telemetry.fix_m[rows]
    axes.plot(*fixes.T, ".", color=INK, markersize=5, zorder=6, label="localised positions")
    for (x, y), covariance in zip(fixes, telemetry.fix_covariance_m2[rows], strict=True):
        values, axis = np.linalg.eigh(covariance)
        angle = float(np.degrees(np.arctan2(axis[1, 1], axis[0, 1])))
        size = 6.0 * np.sqrt(values)
        axes.add_patch(
            Ellipse((x, y), size[1], size[0], angle=angle, fill=False, edgecolor=INK, linewidth=0.7, zorder=6)
        )
    if len(drive.left_out):
        axes.plot(*drive.left_out[:, 1:].T, "x", color=LIMIT, markersize=8, zorder=7, label="left out: fits no motion")
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(list(unique.values()), list(unique), loc="upper left", ncols=2, fontsize=8, framealpha=0.9)
    axes.set_title("Wheel tracks, positions with ellipses of 3 σ; contours every 0.1 m", fontsize=10)


def _window(points: FloatArray, terrain: Terrain) -> tuple[slice, slice]:
    """Rows and columns of the terrain about points."""
    known = points[np.isfinite(points).all(axis=1)]
    found = []
    for axis, values in ((terrain.y_m, known[:, 1]), (terrain.x_m, known[:, 0])):
        near = np.flatnonzero((axis >= values.min() - MARGIN_M) & (axis <= values.max() + MARGIN_M))
        found.append(slice(int(near[0]), int(near[-1]) + 1) if len(near) > 2 else slice(0, len(axis)))
    return found[0], found[1]


def _draw_states(panel: "Axes", drive: DriveStates, name: str) -> None:
    text, factor = LABELS[name]
    rows = drive.rows
    values, sigmas = factor * getattr(rows, name), factor * getattr(rows, f"{name}_sigma")
    reach = float(np.median(np.diff(rows.distance_m))) if len(rows.distance_m) > 1 else 0.1
    for k, wheel in enumerate(drive.rover.wheels):
        # Side by side, so that the bars of six wheels do not hide each other.
        where = rows.distance_m + 0.1 * reach * (k - 0.5 * (len(drive.rover.wheels) - 1))
        good = rows.valid[:, k] & np.isfinite(values[:, k])
        bad = ~rows.valid[:, k] & np.isfinite(values[:, k])
        color = WHEEL_COLORS[k]
        shown = np.where(good, values[:, k], np.nan)
        panel.plot(*_broken(where, shown, drive), color=color, linewidth=0.8, alpha=0.6)
        panel.errorbar(
            where, shown, np.where(good, sigmas[:, k], 0.0),
            fmt="o", color=color, markersize=3.5, elinewidth=1.0, capsize=1.5, label=wheel,
        )  # fmt: skip
        panel.plot(where[bad], values[bad, k], "o", color=color, markersize=4, markerfacecolor="white")
    way = _distance_at(drive, drive.gaps)
    for number, (begin, end) in enumerate(way):
        panel.axvspan(begin, end, color=GOLD, alpha=0.35, linewidth=0, label="gap" if number == 0 else None)
    panel.set_ylabel(text)
    panel.grid(alpha=0.25, linewidth=0.5)
    if panel.get_ylim()[0] < 0 < panel.get_ylim()[1]:
        panel.axhline(0.0, color=INK, linewidth=0.6)
    if not np.isfinite(values).any():
        panel.text(0.5, 0.5, "no depth of the track was given", transform=panel.transAxes, ha="center", color=INK)


def _broken(where: FloatArray, values: FloatArray, drive: DriveStates) -> tuple[FloatArray, FloatArray]:
    """A line that ends at gaps."""
    times = drive.nodes.time_s[drive.rows.node]
    after = np.unique(np.searchsorted(times, drive.gaps[:, 0]))
    return np.insert(where, after, np.nan), np.insert(values, after, np.nan)


def _distance_at(drive: DriveStates, times: FloatArray) -> FloatArray:
    """Way as the wheels say at some times. (..., ) [m]"""
    speed = np.hypot(drive.nodes.twist[:, 0], drive.nodes.twist[:, 1])
    way = np.append(0.0, np.cumsum(speed * np.diff(drive.nodes.time_s)))
    return np.asarray(np.interp(times, drive.nodes.time_s, way))
