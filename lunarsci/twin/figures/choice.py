"""Pictures of drives, designs and missions that were compared or planned."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from lunarsci.arrays import FloatArray
from lunarsci.figure import (
    BLUE,
    INK,
    PAGE_IN,
    VERMILION,
    as_label,
    file_label,
    headline,
    legend_below,
    name_points,
    page,
    wrapped,
)
from lunarsci.twin.figures.maps import HAZARD, MOST_NODES, PATH, draw_relief
from lunarsci.twin.figures.panels import ACCENT, GOLD, LABELS, LIMIT
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.judgement.choice import DriveCandidate, DriveChoice, Weakest
from lunarsci.twin.judgement.designs import Design
from lunarsci.twin.mission.mission import DrivenMission, MissionLeg, TargetFate
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.plans.plan import Plan
from lunarsci.units import UNITS, unit_of

COLORS = "cividis_r"
LEAST_SHOWN, MOST_SHOWN = 0.005, 1.0
"""Ends of the colour scale of risks, which is logarithmic. [-]"""
MEASURES = (
    ("kept_share", 100.0, "drives that\nkeep limits [%]"),
    ("slip_ratio", 1.0, "slip s, worst [-]"),
    ("sinkage_m", 1e3, "sinkage z,\nworst [mm]"),
    ("energy_p50_j", 1.0, "work at the\nwheels [J]"),
    ("pull_per_weight_at_20", 1.0, "pull per weight\nat 20 % slip [-]"),
)
"""Keys of a design's row, factor, and label."""
MOST_NAMED = 8
"""Designs of the front whose values are written beside their dots."""
WAITED, LOCALISED, STAYED = "#d9d9d9", "#9fb4c0", GOLD
MARGIN_M = 2.0
MOST_ARRIVALS = 24
"""Names of arrivals that fit side by side; one that is too near to the one before is left out."""


def candidate_map(surface: Traversability, choice: DriveChoice) -> Figure:
    """All candidates on the shaded relief in the colour of their risk, the best one bold, its weakest place marked."""
    terrain = surface.terrain
    (left, right), (low, high) = _frame(surface, choice)
    figure = page(float(np.clip(0.8 * PAGE_IN * (high - low) / (right - left) + 1.4, 3.4, 9.4)))
    axes: Any = figure.subplots()
    step = max(1, -(-max(terrain.height_m.shape) // MOST_NODES))
    every = (slice(None, None, step), slice(None, None, step))
    draw_relief(axes, terrain, every, height_bar=False)
    if surface.hazard.any():
        axes.contourf(
            terrain.x_m[every[1]], terrain.y_m[every[0]], surface.hazard[every].astype(float), levels=[0.5, 1.5],
            colors=[HAZARD], alpha=0.35, hatches=["////"],
        )  # fmt: skip
    axes.set(xlim=(left, right), ylim=(low, high), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    scale = _scale()
    for one in reversed(choice.candidates):
        _draw_way(axes, one, scale, best=one is choice.best)
    _mark_choice(axes, choice)
    bar = figure.colorbar(scale, ax=axes, fraction=0.03, pad=0.01, shrink=0.9)
    bar.set_label("chance of failing [-]")
    bar.ax.axhline(choice.risk.share, color=INK, linewidth=2.0)
    bar.ax.annotate("accepted", (0.0, choice.risk.share), (-3, -3), xycoords=("axes fraction", "data"),
                    textcoords="offset points", ha="right", color=INK)  # fmt: skip
    axes.set_title(wrapped(_choice_headline(choice), 0.8 * PAGE_IN))
    compared = "1 drive" if len(choice.candidates) == 1 else f"{len(choice.candidates)} drives compared"
    title = f"{compared} on {as_label(terrain.name)}; hatched: hazard"
    headline(figure, title, synthetic=terrain.synthetic)
    legend_below(figure, axes, 5)
    return figure


def _scale() -> Any:
    return ScalarMappable(LogNorm(LEAST_SHOWN, MOST_SHOWN), colormaps[COLORS])


def _choice_headline(choice: DriveChoice) -> str:
    best = choice.best
    share = f"{100 * best.stated.risk:.1f} % (at most {100 * best.stated.high:.1f} %) fail"
    if choice.feasible:
        return f"drive {best.number}: {as_label(best.plan.name)}; {share}, {100 * choice.risk.share:g} % accepted"
    safest = f"the safest is {best.number}, {as_label(best.plan.name)}: {share}"
    return f"no drive fails with {100 * choice.risk.share:g} % or less; {safest}"


def _frame(surface: Traversability, choice: DriveChoice) -> tuple[tuple[float, float], tuple[float, float]]:
    """The part of the map that candidates cross, and a metre and a half about it. [m]"""
    places = np.concatenate([poses_along(one.plan, 0.2)[:, :2] for one in choice.candidates])
    terrain, margin = surface.terrain, 1.5
    return (
        (max(terrain.x_m[0], places[:, 0].min() - margin), min(terrain.x_m[-1], places[:, 0].max() + margin)),
        (max(terrain.y_m[0], places[:, 1].min() - margin), min(terrain.y_m[-1], places[:, 1].max() + margin)),
    )


def _draw_way(axes: Axes, one: DriveCandidate, scale: Any, *, best: bool) -> None:
    x, y, _ = poses_along(one.plan, 0.05).T
    color = scale.to_rgba(min(max(one.stated.risk, LEAST_SHOWN), MOST_SHOWN))
    if best:
        axes.plot(x, y, color="white", linewidth=6.0, zorder=6)
        axes.plot(x, y, color=INK, linewidth=4.6, zorder=6)
    axes.plot(x, y, color=color, linewidth=3.2 if best else 1.1, alpha=1.0 if best else 0.8, zorder=7 if best else 4)


def _mark_choice(axes: Axes, choice: DriveChoice) -> None:
    """Start, target, halts, drives on the soils, and the weakest place of the best one."""
    best = choice.best
    ends = best.prediction.endpoints_m
    axes.plot(ends[:, 0], ends[:, 1], ".", color=INK, markersize=2.5, alpha=0.7, zorder=8, label="ends on the soils")
    plan, (x, y) = best.plan, best.prediction.destination_m
    axes.plot(plan.x_m, plan.y_m, "o", color="white", markeredgecolor=INK, markersize=8, zorder=9, label="start")
    axes.plot(x, y, "*", color=GOLD, markeredgecolor=INK, markersize=16, zorder=9, label="target")
    if plan.fixes is not None:
        halts = np.array([_end_of(plan, number) for number in range(1, len(plan.legs))])
        axes.plot(
            *halts.T, "s", color="white", markeredgecolor=INK, markersize=6, zorder=9, label="localisation update"
        )
    _mark_weakest(axes, best)


def _mark_weakest(axes: Axes, best: DriveCandidate) -> None:
    weak = best.weakest
    look: Any = {"color": HAZARD, "markeredgecolor": "white", "markersize": 12, "zorder": 10}
    axes.plot(weak.x_m, weak.y_m, "X", label="least margin", **look)
    text = f"least margin after {weak.distance_m:z.1f} m: {_why(weak)}"
    axes.set_xlabel(f"{axes.get_xlabel()}\n{wrapped(text)}")


def _why(weak: Weakest) -> str:
    """In the words of the other pictures."""
    if weak.quantity not in LABELS:
        return weak.why
    label, factor = LABELS[weak.quantity]
    name, _, unit = label.rstrip("]").partition(" [")
    unit = "" if unit == "-" else f" {unit}"
    return weak.in_words(name, unit, factor)


def _end_of(plan: Plan, legs: int) -> tuple[float, float]:
    """Where so many legs of a plan end. [m, m]"""
    x, y, _ = poses_along(replace(plan, legs=plan.legs[:legs], fixes=None), 1.0)[-1]
    return float(x), float(y)


def front_page(choice: DriveChoice) -> Figure:
    """Risk with its bounds against energy, and against length; the front that no drive beats is joined."""
    figure = page(3.9)
    panels: Any = figure.subplots(1, 2, sharey=True)
    named = {}
    for axes, name, label in (
        (panels[0], "energy_j", "work of the wheels [J]"),
        (panels[1], "length_m", "length of the drive [m]"),
    ):
        _draw_risks(axes, choice, name)
        named[axes] = [(str(one.number), getattr(one, name), one.stated.risk) for one in choice.front]
        axes.set_xlabel(label)
        axes.axhline(choice.risk.share, color=INK, linewidth=1.0, linestyle="--")
        axes.set_yscale("log")
        axes.set_ylim(LEAST_SHOWN * 0.6, 1.3)
        axes.grid()
    panels[0].set_ylabel("chance of failing [-]")
    panels[0].text(0.01, choice.risk.share * 1.06, "accepted", transform=panels[0].get_yaxis_transform(), color=INK)
    legend_below(figure, panels)
    title = "what less risk costs; bars: 5 % to 95 %, from the number of drives"
    headline(figure, title, synthetic=choice.best.prediction.terrain.synthetic)
    name_points(figure, named)
    return figure


def _draw_risks(axes: Axes, choice: DriveChoice, name: str) -> None:
    kinds = (
        ("#8d9aa2", "x", "stopped early", [one for one in choice.candidates if one.stopped]),
        (BLUE, "o", "on the common soils", [one for one in choice.candidates if not one.stopped]),
    )
    for color, marker, label, group in kinds:
        points = [one for one in group if one.promise is None]
        if points:
            _bars(axes, points, name, color, marker, label)
    promised = [one for one in choice.candidates if one.promise is not None]
    _bars(axes, promised, name, VERMILION, "D", "on fresh soils")
    front = sorted(choice.front, key=lambda one: float(getattr(one, name)))
    axes.plot(
        [getattr(one, name) for one in front], [one.stated.risk for one in front], "-", color=INK, linewidth=0.8,
        zorder=2, label="not beaten in risk, length and energy",
    )  # fmt: skip


def _bars(axes: Axes, group: list[DriveCandidate], name: str, color: str, marker: str, label: str) -> None:
    x = [getattr(one, name) for one in group]
    risk = np.array([one.stated.risk for one in group])
    low, high = (np.array([getattr(one.stated, end) for one in group]) for end in ("low", "high"))
    spread = np.maximum(np.array([risk - low, high - risk]), 0.0)
    axes.errorbar(x, risk, spread, fmt=marker, color=color, markersize=4, elinewidth=0.7, capsize=1.5, label=label)


def design_front_page(designs: Sequence[Design], front: Sequence[int], *, synthetic: bool = False) -> Figure:
    """Share of drives that break a limit against the energy of the others, and the designs that none beats in both."""
    figure = page(5.0, 6.0)
    axes = figure.subplots()
    rows = [design.row() for design in designs]
    finished = [n for n, row in enumerate(rows) if row["energy_p50_j"] is not None]
    name = next(iter(designs[0].values))
    if finished:
        risk = {n: 100.0 * (1.0 - rows[n]["kept_share"]) for n in finished}
        energy = {n: rows[n]["energy_p50_j"] for n in finished}
        dots = axes.scatter(
            [energy[n] for n in finished], [risk[n] for n in finished], s=36, cmap="viridis", edgecolors="white",
            c=[designs[n].values[name] for n in finished], linewidths=0.5, zorder=3,
        )  # fmt: skip
        axes.plot([energy[n] for n in front], [risk[n] for n in front], "-", color=GOLD, linewidth=2.0, zorder=2)
        axes.scatter(
            [energy[n] for n in front], [risk[n] for n in front], s=110, facecolors="none", edgecolors=LIMIT,
            linewidths=1.6, zorder=4, label="no other design is better in both",
        )  # fmt: skip
        figure.colorbar(dots, ax=axes, label=_label(name))
        legend_below(figure, axes, 1)
    highest = max(10.0, *(100.0 * (1.0 - rows[n]["kept_share"]) for n in finished), 0.0)
    axes.set_ylim(-0.04 * highest, 1.08 * highest)
    axes.set_xlabel("work of the motors at the wheels, median [J]")
    axes.set_ylabel("drives that break a limit or do not end [%]")
    axes.grid()
    left = len(designs) - len(finished)
    more = f"; {left} impossible or without an end are not shown" if left else ""
    headline(figure, f"{len(designs)} designs on the same soils{more}", synthetic=synthetic)
    if finished:
        named = [(_values(designs[n]), energy[n], risk[n]) for n in list(front)[:MOST_NAMED]]
        name_points(figure, {axes: named}, clear_pt=5.0, color=INK)
    return figure


def _values(design: Design) -> str:
    """What makes a design of the front, beside its dot."""
    return ", ".join(f"{value:.3g}" for value in design.values.values())


def curve_page(designs: Sequence[Design], names: Sequence[str], *, synthetic: bool = False) -> Figure:
    """Each measure against each varied number: a dot for each design, the line through the medians of equal values."""
    figure = page(1.5 * len(MEASURES) + 0.6)
    panels = figure.subplots(len(MEASURES), len(names), squeeze=False, sharex="col", sharey="row")
    rows = [design.row() for design in designs]
    for column, name in enumerate(names):
        values = np.array([design.values[name] for design in designs])
        for axes, (key, factor, label) in zip(panels[:, column], MEASURES, strict=True):
            measured = np.array([np.nan if row[key] is None else factor * row[key] for row in rows])
            _draw_curve(axes, values, measured)
            if column == 0:
                axes.set_ylabel(label)
        panels[-1, column].set_xlabel(_label(name))
    headline(figure, "what each number does; lines: medians over the others", synthetic=synthetic)
    return figure


def _label(name: str) -> str:
    """A varied key of the rover, such as `wheel.radius_m`, as a label with its unit."""
    unit = unit_of(name)
    ends = [end for end in UNITS if name.endswith(f"_{end}")] if unit else []
    bare = name.removesuffix(f"_{max(ends, key=len)}") if ends else name
    return f"{as_label(bare.replace('.', ' ').replace('_', ' '))} [{unit.replace(' / ', '/') or '-'}]"


def _draw_curve(axes: Axes, values: Any, measured: Any) -> None:
    finished = np.isfinite(measured)
    axes.plot(values[finished], measured[finished], "o", color=ACCENT, markersize=4, alpha=0.55, markeredgewidth=0)
    places = np.unique(values[finished])
    if 1 < len(places) <= max(12, finished.sum() // 2):
        middle = [np.median(measured[finished & (values == place)]) for place in places]
        axes.plot(places, middle, "-", color=INK, linewidth=1.4)
    for place in np.unique(values[~finished]):
        axes.axvline(place, color=LIMIT, linewidth=0.8, linestyle=":", alpha=0.6)
    axes.grid()


def mission_map(surface: Traversability, driven: DrivenMission) -> Figure:
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
    return f"{reached}; all limits kept by {100 * driven.safe.mean():.0f} % of {driven.safe.size} drives"


def _draw_leg(axes: Axes, leg: MissionLeg) -> None:
    x, y, _ = poses_along(leg.plan, 0.05).T
    color = (PATH, ACCENT)[leg.number % 2]
    axes.plot(x, y, color="white", linewidth=4.4, zorder=5)
    axes.plot(x, y, color=color, linewidth=2.6, zorder=6)
    safe = leg.safe
    label = "ends, before localisation" if leg.number == 1 else None
    axes.plot(*leg.ends_m[safe].T, ".", color=color, markersize=3, alpha=0.6, zorder=7, label=label)
    if not safe.all():
        axes.plot(*leg.ends_m[~safe].T, "x", color=HAZARD, markersize=5, alpha=0.8, zorder=7)


def _mark(axes: Axes, driven: DrivenMission) -> None:
    """Start, localised places, targets, and circles."""
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


def timetable(driven: DrivenMission, *, synthetic: bool = False) -> Figure:
    """What the rover does when, in hours, below the windows of communication; and the share of drives that go on."""
    figure = page(3.9)
    panels: Any = figure.subplots(2, 1, sharex=True, height_ratios=(1, 2))
    _draw_times(panels[0], driven)
    legend_below(figure, panels[0], 6)
    safe, times, shares = np.ones_like(driven.safe), [0.0], [1.0]
    for leg in driven.legs:
        safe = safe & leg.safe
        times.append((leg.begin_s + leg.drive_s) / 3600)
        shares.append(float(safe.mean()))
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


def _draw_times(axes: Axes, driven: DrivenMission) -> None:
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
