"""A planned mission: legs on the relief with where their drives end, and its timetable."""

from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import INK, PAGE_IN, as_label, file_label, headline, legend_below, name_points, page, wrapped
from lunarsci.twin.figures.maps import HAZARD, MOST_NODES, PATH, draw_relief
from lunarsci.twin.figures.panels import ACCENT, GOLD
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.mission.legs import DrivenMission, MissionLeg, TargetFate
from lunarsci.twin.plans.path import poses_along

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WAITED, LOCALISED, STAYED = "#d9d9d9", "#9fb4c0", GOLD
MARGIN_M = 2.0
MOST_ARRIVALS = 24
"""Names of arrivals that fit side by side; one that is too near to the one before is left out."""


def mission_map(surface: Traversability, driven: DrivenMission) -> "Figure":
    """Legs in turns of two colours, the drives' ends before each localisation, targets and ground to keep out of."""
    terrain = surface.terrain
    places = _places(driven)
    (left, low), (right, high) = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
    figure = page(float(np.clip(0.85 * PAGE_IN * (high - low) / (right - left) + 1.2, 3.2, 9.4)))
    axes: Any = figure.subplots()
    step = max(1, -(-max(terrain.height_m.shape) // MOST_NODES))
    every = (slice(None, None, step), slice(None, None, step))
    draw_relief(axes, terrain, every, height_bar=False)
    for layer, color, hatch in ((surface.hazard, HAZARD, "////"), (surface.unknown, "#808080", "....")):
        if layer.any():
            x, y = terrain.x_m[every[1]], terrain.y_m[every[0]]
            axes.contourf(
                x, y, layer[every].astype(float), levels=[0.5, 1.5], colors=[color], alpha=0.35, hatches=[hatch]
            )
    for leg in driven.legs:
        _draw_leg(axes, leg)
    _mark(axes, driven)
    axes.set(xlim=(max(left, terrain.x_m[0]), min(right, terrain.x_m[-1])),
             ylim=(max(low, terrain.y_m[0]), min(high, terrain.y_m[-1])),
             aspect="equal", xlabel="x [m]", ylabel="y [m]")  # fmt: skip
    axes.set_title(wrapped(_headline(driven)))
    title = f"{file_label(driven.mission.name)}, on {as_label(terrain.name)}"
    headline(figure, title, synthetic=terrain.synthetic)
    legend_below(figure, axes, 5)
    named = [(_named(one), one.target.x_m, one.target.y_m) for one in driven.targets]
    name_points(figure, {axes: named}, clear_pt=6.0, color=INK)
    return figure


def _named(one: TargetFate) -> str:
    name = as_label(one.target.name, 24)
    return name if one.fate == "reached" else f"{name}: {one.fate}"


def _places(driven: DrivenMission) -> FloatArray:
    """All that shall be on the map. (n, 2) [m]"""
    start = driven.mission.start
    legs = [poses_along(leg.plan, 0.5)[:, :2] for leg in driven.legs]
    targets = [(one.x_m, one.y_m) for one in driven.mission.targets]
    return np.vstack([(start.x_m, start.y_m), *legs, *targets])


def _headline(driven: DrivenMission) -> str:
    reached = f"{driven.reached} of {len(driven.targets)} targets reached in {len(driven.legs)} legs"
    return f"{reached}; all limits kept by {100 * driven.kept.mean():.0f} % of {driven.kept.size} drives"


def _draw_leg(axes: "Axes", leg: MissionLeg) -> None:
    x, y, _ = poses_along(leg.plan, 0.05).T
    color = (PATH, ACCENT)[leg.number % 2]
    axes.plot(x, y, color="white", linewidth=4.4, zorder=5)
    axes.plot(x, y, color=color, linewidth=2.6, zorder=6)
    kept = leg.kept
    label = "ends, before localisation" if leg.number == 1 else None
    axes.plot(*leg.ends_m[kept].T, ".", color=color, markersize=3, alpha=0.6, zorder=7, label=label)
    if not kept.all():
        axes.plot(*leg.ends_m[~kept].T, "x", color=HAZARD, markersize=5, alpha=0.8, zorder=7)


def _mark(axes: "Axes", driven: DrivenMission) -> None:
    """Start, localised places, targets, and circles."""
    from matplotlib.patches import Circle

    start = driven.mission.start
    axes.plot(start.x_m, start.y_m, "o", color="white", markeredgecolor=INK, markersize=9, zorder=9, label="start")
    fixed = np.array([leg.fixed[:2] for leg in driven.legs]).reshape(-1, 2)
    axes.plot(*fixed.T, "s", color="white", markeredgecolor=INK, markersize=6, zorder=8, label="localised there")
    for one in driven.targets:
        color = GOLD if one.fate == "reached" else "white"
        place = (one.target.x_m, one.target.y_m)
        axes.plot(*place, "*", color=color, markeredgecolor=INK, markersize=16, zorder=9)
    for zone in driven.mission.keep_outs:
        axes.add_patch(
            Circle((zone.x_m, zone.y_m), zone.radius_m, fill=False, hatch="////", edgecolor=HAZARD, zorder=5)
        )


def timetable(driven: DrivenMission, *, synthetic: bool = False) -> "Figure":
    """What the rover does when, in hours, below the windows of communication; and the share of drives that go on."""
    figure = page(3.9)
    panels: Any = figure.subplots(2, 1, sharex=True, height_ratios=(1, 2))
    _draw_times(panels[0], driven)
    legend_below(figure, panels[0], 6)
    kept, times, shares = np.ones_like(driven.kept), [0.0], [1.0]
    for leg in driven.legs:
        kept = kept & leg.kept
        times.append((leg.begin_s + leg.drive_s) / 3600)
        shares.append(float(kept.mean()))
    panels[1].step(times, shares, where="post", color=PATH, linewidth=2.0)
    panels[1].set(xlabel="time [h]", ylabel="drives that kept\nall limits [-]", ylim=(0.0, 1.05))
    panels[1].grid()
    room, last = max(driven.end_s, 1.0) / 3600 / MOST_ARRIVALS, -np.inf
    for one in sorted((one for one in driven.targets if one.fate == "reached"), key=lambda one: one.arrival_s):
        at = one.arrival_s / 3600
        panels[1].axvline(at, color=INK, linewidth=0.8, linestyle="--")
        if at - last >= room:
            # Beside its line, on the side where the page goes on.
            side: Any = {"ha": "right"} if at > 0.9 * driven.end_s / 3600 else {"ha": "left"}
            panels[1].annotate(as_label(one.target.name, 24), (at, 0.05), (-3 if "right" in side.values() else 3, 0),
                               textcoords="offset points", rotation=90, color=INK, **side)  # fmt: skip
            last = at
    headline(figure, f"{file_label(driven.mission.name)}: {driven.end_s / 3600:.2f} h", synthetic=synthetic)
    return figure


def _draw_times(axes: "Axes", driven: DrivenMission) -> None:
    mission, end = driven.mission, max(driven.end_s, 1.0)
    waits = [(leg.begin_s - leg.waited_s, leg.waited_s) for leg in driven.legs]
    drives = [(leg.begin_s, leg.drive_s) for leg in driven.legs]
    halts = [(leg.begin_s + leg.drive_s, mission.localisation_s) for leg in driven.legs]
    stays = [(one.arrival_s, one.target.stay_s) for one in driven.targets if one.fate == "reached"]
    open_ = [(one.begin_s, min(one.end_s, end) - one.begin_s) for one in mission.windows if one.begin_s < end]
    for label, color, level, bars in (("waits", WAITED, 0.0, waits), ("drives", ACCENT, 0.0, drives),
                                      ("is localised", LOCALISED, 0.0, halts), ("stays", STAYED, 0.0, stays),
                                      ("communication", INK, 0.75, open_)):  # fmt: skip
        if begun := [(begin / 3600, length / 3600) for begin, length in bars if length > 0]:
            lefts, lengths = zip(*begun, strict=True)
            axes.barh(level, lengths, 0.3 if level else 0.8, left=lefts, color=color, edgecolor="white",
                      linewidth=0.3, label=label)  # fmt: skip
    if np.isfinite(mission.time_budget_s) and mission.time_budget_s < 1.5 * end:
        axes.axvline(mission.time_budget_s / 3600, color=HAZARD, linewidth=1.5, label="time given")
    axes.set(yticks=[], ylim=(-0.6, 1.1))
