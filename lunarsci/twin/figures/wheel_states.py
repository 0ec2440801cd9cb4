"""Pictures of wheel states along a drive: slip, side slip and sinkage found in telemetry, and wheel forces."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from lunarsci.arrays import FloatArray
from lunarsci.figure import BLUE, INK, VERMILION, as_label, headline, legend_below, page
from lunarsci.twin.figures.panels import ACCENT, GOLD, LABELS, LIMIT, draw_ground, wheel_dots, wheel_line, window_about
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.simulation.prescribed_motion import LoadEnsemble
from lunarsci.twin.telemetry.states import DriveStates

STATE_PANELS = ("slip_ratio", "side_slip_deg", "sinkage_m")
MARGIN_M = 1.6
LEFT, RIGHT = BLUE, VERMILION
"""Colours of left and right wheels that the colour-blind distinguish (Okabe & Ito 2008)."""
FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")
MISSING = ("missing ahead [N]", "missing to the left [N]", "missing moment [N m]")
FORCE_PANELS = (*FORCES, "resistance_torque_nm", "slip_ratio", "side_slip_deg")


def states_page(drive: DriveStates, terrain: Terrain, title: str) -> Figure:
    """Map with wheel tracks, positions and smoothed way above; slip, side slip and sinkage against distance below."""
    figure = page(8.8)
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.0, 1.55])
    axes = parts[0].subplots()
    _draw_map(axes, drive, terrain)
    legend_below(parts[0], axes)
    panels = parts[1].subplots(3, 1, sharex=True)
    for panel, name in zip(panels, STATE_PANELS, strict=True):
        _draw_states(panel, drive, name)
    legend_below(parts[1], panels[0], 7)
    panels[0].set_title("one state between two positions; bars: 68 %; white: not measured")
    panels[-1].set_xlabel("way as the wheels say [m]")
    headline(figure, title, synthetic=drive.telemetry.synthetic or terrain.synthetic)
    return figure


def _draw_map(axes: Axes, drive: DriveStates, terrain: Terrain) -> None:
    places = drive.held.states[..., :2]
    points = np.vstack([places.reshape(-1, 2), drive.nodes.fix_m])
    every_m = draw_ground(axes, terrain, window_about(terrain, points, MARGIN_M), 0.1)
    for k in range(places.shape[1]):
        axes.plot(*places[:, k].T, **(wheel_line(k) | {"linewidth": 0.9, "alpha": 0.9, "zorder": 3}))
    motion, fixes = drive.motion, drive.positions
    axes.plot(motion.x_m, motion.y_m, color="white", linewidth=3.0, zorder=4)
    axes.plot(motion.x_m, motion.y_m, color=ACCENT, linewidth=1.6, zorder=5, label="smoothed way of the rover's origin")
    for begin, end in drive.gaps:
        inside = (motion.time_s >= begin) & (motion.time_s <= end)
        axes.plot(motion.x_m[inside], motion.y_m[inside], color=GOLD, linewidth=4.0, zorder=5.5, label="gap")
    axes.plot(*fixes.place_m.T, ".", color=INK, markersize=5, zorder=6, label="localised positions")
    for (x, y), covariance in zip(fixes.place_m, fixes.covariance_m2, strict=True):
        values, axis = np.linalg.eigh(covariance)
        angle = float(np.degrees(np.arctan2(axis[1, 1], axis[0, 1])))
        size = 6.0 * np.sqrt(values)
        axes.add_patch(
            Ellipse((x, y), size[1], size[0], angle=angle, fill=False, edgecolor=INK, linewidth=0.7, zorder=6)
        )
    if len(drive.left_out):
        axes.plot(*drive.left_out[:, 1:].T, "x", color=LIMIT, markersize=8, zorder=7, label="left out: fits no motion")
    axes.set_title(f"wheel tracks, positions with ellipses of 3 σ; contours every {every_m:g} m")


def _draw_states(panel: Axes, drive: DriveStates, name: str) -> None:
    text, factor = LABELS[name]
    rows = drive.rows
    values, sigmas = factor * getattr(rows, name), factor * getattr(rows, f"{name}_sigma")
    reach = float(np.median(np.diff(rows.distance_m))) if len(rows.distance_m) > 1 else 0.1
    for k, wheel in enumerate(drive.rover.wheels):
        # Side by side, so that the bars of six wheels do not hide each other.
        where = rows.distance_m + 0.1 * reach * (k - 0.5 * (len(drive.rover.wheels) - 1))
        good = rows.measured[:, k] & np.isfinite(values[:, k])
        bad = ~rows.measured[:, k] & np.isfinite(values[:, k])
        look: Any = wheel_dots(k)
        color = look["color"]
        shown = np.where(good, values[:, k], np.nan)
        panel.plot(*_broken(where, shown, drive), color=color, linewidth=0.8, alpha=0.6)
        panel.errorbar(
            where, shown, np.where(good, sigmas[:, k], 0.0),
            linestyle="", markersize=3.0, elinewidth=0.8, capsize=1.2, label=as_label(wheel), **look,
        )  # fmt: skip
        panel.plot(where[bad], values[bad, k], linestyle="", markersize=3.0, markerfacecolor="white", **look)
    way = _distance_at(drive, drive.gaps)
    for number, (begin, end) in enumerate(way):
        panel.axvspan(begin, end, color=GOLD, alpha=0.35, linewidth=0, label="gap" if number == 0 else None)
    _frame(panel, text)
    _zero(panel)
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


def force_band_figure(loads: LoadEnsemble, title: str, *, synthetic: bool = False) -> Figure:
    """A column of panels for each axle: the three forces of its wheels, and below what is missing of the totals.

    Pale bands are one standard deviation after the balance; the dark band in it is what the assumed soil brings of it.
    """
    wheels = loads.held.rover.wheels
    columns = len(wheels) // 2
    figure = page(8.6)
    parts: Any = figure.subfigures(2, 1, height_ratios=(3.1, 1.0))
    upper, lower = parts
    panels: Any = upper.subplots(3, columns, sharex=True, sharey="row", squeeze=False)
    along = loads.held.motion.rolled_m
    for force, row in enumerate(panels):
        for axle, panel in enumerate(row):
            for side, color in enumerate((LEFT, RIGHT)):
                _draw_band(panel, along, loads, 2 * axle + side, force, color)
            _frame(panel, LABELS[FORCES[force]][0] if axle == 0 else "", along)
    for axle, panel in enumerate(panels[0]):
        panel.set_title(" and ".join(as_label(wheel) for wheel in wheels[2 * axle : 2 * axle + 2]))
    for panel in panels[-1]:
        panel.set_xlabel("distance rolled [m]")
    legend_below(upper, panels[0, 0])
    for panel in panels.ravel():
        _zero(panel)
    missing = lower.subplots(1, 3, sharex=True)
    _draw_missing(missing, along, loads)
    legend_below(lower, missing[0])
    caption = "pale: ±1 standard deviation after the balance of totals; dark: what the assumed soil brings of it"
    headline(figure, f"{title}\n{caption}", synthetic=synthetic)
    return figure


def _draw_band(panel: Any, along: FloatArray, loads: LoadEnsemble, wheel: int, force: int, color: str) -> None:
    mean, sigma = loads.after[:, wheel, force], loads.after_sigma[:, wheel, force]
    soil = np.minimum(np.sqrt(np.maximum(loads.after_parts[0, :, wheel, force], 0.0)), sigma)
    panel.fill_between(along, mean - sigma, mean + sigma, color=color, alpha=0.18, linewidth=0)
    panel.fill_between(along, mean - soil, mean + soil, color=color, alpha=0.35, linewidth=0)
    left = wheel % 2 == 0
    name = "left wheel" if left else "right wheel"
    panel.plot(along, mean, color=color, linewidth=1.2, linestyle="-" if left else (0, (4, 2)), label=name)


def _draw_missing(panels: Any, along: FloatArray, loads: LoadEnsemble) -> None:
    for k, panel in enumerate(panels):
        before, sigma = loads.residual_before[:, k], loads.total_before[:, k]
        panel.fill_between(along, before - sigma, before + sigma, color=INK, alpha=0.15, linewidth=0)
        panel.plot(along, before, color=INK, linewidth=1.0, linestyle=":", label="before the balance, ±σ")
        panel.plot(along, loads.residual_after[:, k], color=INK, linewidth=1.4, label="after")
        _frame(panel, MISSING[k], along)
        _zero(panel)
        panel.set_xlabel("distance rolled [m]")


def _frame(panel: Any, text: str, along: FloatArray | None = None) -> None:
    panel.set_ylabel(text)
    if along is not None:
        panel.set_xlim(float(along[0]), float(along[-1]))
    panel.grid()


def _zero(panel: Any) -> None:
    if panel.get_ylim()[0] < 0 < panel.get_ylim()[1]:
        panel.axhline(0.0, color=INK, linewidth=0.6)


def force_figure(
    wheels: tuple[str, ...],
    axis: tuple[FloatArray, str],
    states: FloatArray,
    title: str,
    residual_n: FloatArray | None = None,
    *,
    synthetic: bool = False,
) -> Figure:
    """Forces, slip and side slip of each wheel.

    Parameters
    ----------
    wheels : their names, left and right in turn from front to rear.
    axis : values along the drive (n,), and their label.
    states : wheel states, columns `STATE_COLUMNS`; the median over members where there are several.
        (n, wheels, 10) or (members, n, wheels, 10)
    residual_n : for a given motion, the force ahead and to the left that the wheels do not supply. (n, 2) [N]
    synthetic : whether the ground or the motion is made up.
    """
    along, label = axis
    middle = np.nanmedian(states, axis=0) if states.ndim == 4 else states
    figure = page(6.6 if residual_n is None else 8.2)
    rows: Any = figure.subplots(3 if residual_n is None else 4, 2, sharex=True, squeeze=False)
    for panel, name in zip(rows.ravel(), FORCE_PANELS, strict=False):
        for k, wheel in enumerate(wheels):
            panel.plot(along, middle[:, k, STATE_COLUMNS.index(name)], label=as_label(wheel), **wheel_line(k))
        _frame(panel, LABELS[name][0])
        _zero(panel)
    if residual_n is not None:
        for panel, values, text in zip(rows[3], residual_n.T, ("ahead", "to the left"), strict=True):
            panel.plot(along, values, color=INK)
            _frame(panel, f"missing force\n{text} [N]")
            _zero(panel)
    for panel in rows[-1]:
        panel.set_xlabel(label)
    legend_below(figure, rows[0, 0], 6)
    headline(figure, title, synthetic=synthetic)
    return figure
