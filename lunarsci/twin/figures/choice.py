"""Drives that were compared: on the relief, coloured by risk, and what risk, length and energy cost each other."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.figure import INK, PAGE_IN, as_label, headline, legend_below, name_points, page, wrapped
from lunarsci.twin.figures.maps import HAZARD, MOST_NODES, draw_relief
from lunarsci.twin.figures.panels import GOLD, LABELS
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.judgement.choice import DriveCandidate, DriveChoice, Weakest
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.plans.plan import Plan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = "cividis_r"
LEAST_SHOWN, MOST_SHOWN = 0.005, 1.0
"""Ends of the colour scale of risks, which is logarithmic. [-]"""


def candidate_map(surface: Traversability, choice: DriveChoice) -> "Figure":
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
    _mark(axes, choice)
    bar = figure.colorbar(scale, ax=axes, fraction=0.03, pad=0.01, shrink=0.9)
    bar.set_label("chance of failing [-]")
    bar.ax.axhline(choice.risk, color=INK, linewidth=2.0)
    bar.ax.annotate("accepted", (0.0, choice.risk), (-3, -3), xycoords=("axes fraction", "data"),
                    textcoords="offset points", ha="right", color=INK)  # fmt: skip
    axes.set_title(wrapped(_headline(choice), 0.8 * PAGE_IN))
    title = f"{len(choice.candidates)} drives compared on {as_label(terrain.name)}; hatched: hazard"
    headline(figure, title, synthetic=terrain.synthetic)
    legend_below(figure, axes, 5)
    return figure


def _scale() -> Any:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    return ScalarMappable(LogNorm(LEAST_SHOWN, MOST_SHOWN), colormaps[COLORS])


def _headline(choice: DriveChoice) -> str:
    best = choice.best
    share = f"{100 * best.stated.risk:.1f} % (at most {100 * best.stated.high:.1f} %) fail"
    if choice.feasible:
        return f"drive {best.number}: {as_label(best.plan.name)}; {share}, {100 * choice.risk:g} % accepted"
    safest = f"the safest is {best.number}, {as_label(best.plan.name)}: {share}"
    return f"no drive fails with {100 * choice.risk:g} % or less; {safest}"


def _frame(surface: Traversability, choice: DriveChoice) -> tuple[tuple[float, float], tuple[float, float]]:
    """The part of the map that candidates cross, and a metre and a half about it. [m]"""
    places = np.concatenate([poses_along(one.plan, 0.2)[:, :2] for one in choice.candidates])
    terrain, margin = surface.terrain, 1.5
    return (
        (max(terrain.x_m[0], places[:, 0].min() - margin), min(terrain.x_m[-1], places[:, 0].max() + margin)),
        (max(terrain.y_m[0], places[:, 1].min() - margin), min(terrain.y_m[-1], places[:, 1].max() + margin)),
    )


def _draw_way(axes: "Axes", one: DriveCandidate, scale: Any, *, best: bool) -> None:
    x, y, _ = poses_along(one.plan, 0.05).T
    color = scale.to_rgba(min(max(one.stated.risk, LEAST_SHOWN), MOST_SHOWN))
    if best:
        axes.plot(x, y, color="white", linewidth=6.0, zorder=6)
        axes.plot(x, y, color=INK, linewidth=4.6, zorder=6)
    axes.plot(x, y, color=color, linewidth=3.2 if best else 1.1, alpha=1.0 if best else 0.8, zorder=7 if best else 4)


def _mark(axes: "Axes", choice: DriveChoice) -> None:
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


def _mark_weakest(axes: "Axes", best: DriveCandidate) -> None:
    weak = best.weakest
    look: Any = {"color": HAZARD, "markeredgecolor": "white", "markersize": 12, "zorder": 10}
    axes.plot(weak.x_m, weak.y_m, "X", label="least margin", **look)
    said = f"least margin after {weak.distance_m:z.1f} m: {_why(weak)}"
    axes.set_xlabel(f"{axes.get_xlabel()}\n{wrapped(said)}")


def _why(weak: Weakest) -> str:
    """In the words of the other pictures."""
    if weak.quantity not in LABELS:
        return weak.why
    label, factor = LABELS[weak.quantity]
    name, _, unit = label.rstrip("]").partition(" [")
    unit = "" if unit == "-" else f" {unit}"
    return f"95 % of the drives keep {name} {factor * weak.value:.3g}{unit}, limit {factor * weak.limit:g}{unit}"


def _end_of(plan: Plan, legs: int) -> tuple[float, float]:
    """Where so many legs of a plan end. [m, m]"""
    x, y, _ = poses_along(replace(plan, legs=plan.legs[:legs], fixes=None), 1.0)[-1]
    return float(x), float(y)


def front_page(choice: DriveChoice) -> "Figure":
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
        axes.axhline(choice.risk, color=INK, linewidth=1.0, linestyle="--")
        axes.set_yscale("log")
        axes.set_ylim(LEAST_SHOWN * 0.6, 1.3)
        axes.grid()
    panels[0].set_ylabel("chance of failing [-]")
    panels[0].text(0.01, choice.risk * 1.06, "accepted", transform=panels[0].get_yaxis_transform(), color=INK)
    legend_below(figure, panels)
    title = "what less risk costs; bars: 5 % to 95 %, from the number of drives"
    headline(figure, title, synthetic=choice.best.prediction.terrain.synthetic)
    name_points(figure, named)
    return figure


def _draw_risks(axes: "Axes", choice: DriveChoice, name: str) -> None:
    kinds = (
        ("#8d9aa2", "x", "stopped early", [one for one in choice.candidates if one.stopped]),
        ("#0072B2", "o", "on the common soils", [one for one in choice.candidates if not one.stopped]),
    )
    for color, marker, label, group in kinds:
        points = [one for one in group if one.promise is None]
        if points:
            _bars(axes, points, name, color, marker, label)
    promised = [one for one in choice.candidates if one.promise is not None]
    _bars(axes, promised, name, "#D55E00", "D", "on fresh soils")
    front = sorted(choice.front, key=lambda one: float(getattr(one, name)))
    axes.plot(
        [getattr(one, name) for one in front], [one.stated.risk for one in front], "-", color=INK, linewidth=0.8,
        zorder=2, label="not beaten in risk, length and energy",
    )  # fmt: skip


def _bars(axes: "Axes", group: list[DriveCandidate], name: str, color: str, marker: str, label: str) -> None:
    x = [getattr(one, name) for one in group]
    risk = np.array([one.stated.risk for one in group])
    low, high = (np.array([getattr(one.stated, end) for one in group]) for end in ("low", "high"))
    spread = np.maximum(np.array([risk - low, high - risk]), 0.0)
    axes.errorbar(x, risk, spread, fmt=marker, color=color, markersize=4, elinewidth=0.7, capsize=1.5, label=label)
