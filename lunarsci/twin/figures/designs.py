"""Pictures of a trade: risk beside energy, and what each number of the design does."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.figure import INK, as_label, headline, legend_below, name_points, page
from lunarsci.result import UNITS, unit_of
from lunarsci.twin.figures.panels import ACCENT, GOLD, LIMIT
from lunarsci.twin.judgement.designs import Design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


def front_page(designs: Sequence[Design], front: Sequence[int], *, synthetic: bool = False) -> "Figure":
    """Share of drives that break a limit against the energy of the others, and the designs that none beats in both."""
    figure = page(5.0, 6.0)
    axes = figure.subplots()
    rows = [design.row() for design in designs]
    known = [n for n, row in enumerate(rows) if row["energy_p50_j"] is not None]
    name = next(iter(designs[0].values))
    if known:
        risk = {n: 100.0 * (1.0 - rows[n]["kept_share"]) for n in known}
        energy = {n: rows[n]["energy_p50_j"] for n in known}
        dots = axes.scatter(
            [energy[n] for n in known],
            [risk[n] for n in known],
            c=[designs[n].values[name] for n in known],
            s=36,
            cmap="viridis",
            edgecolors="white",
            linewidths=0.5,
            zorder=3,
        )
        axes.plot([energy[n] for n in front], [risk[n] for n in front], "-", color=GOLD, linewidth=2.0, zorder=2)
        axes.scatter(
            [energy[n] for n in front], [risk[n] for n in front], s=110, facecolors="none", edgecolors=LIMIT,
            linewidths=1.6, zorder=4, label="no other design is better in both",
        )  # fmt: skip
        figure.colorbar(dots, ax=axes, label=_label(name))
        legend_below(figure, axes, 1)
    highest = max(10.0, *(100.0 * (1.0 - rows[n]["kept_share"]) for n in known), 0.0)
    axes.set_ylim(-0.04 * highest, 1.08 * highest)
    axes.set_xlabel("work of the motors at the wheels, median [J]")
    axes.set_ylabel("drives that break a limit or do not end [%]")
    axes.grid()
    left = len(designs) - len(known)
    more = f"; {left} impossible or without an end are not shown" if left else ""
    headline(figure, f"{len(designs)} designs on the same soils{more}", synthetic=synthetic)
    if known:
        named = [(_values(designs[n]), energy[n], risk[n]) for n in list(front)[:MOST_NAMED]]
        name_points(figure, {axes: named}, clear_pt=5.0, color=INK)
    return figure


def _values(design: Design) -> str:
    """What makes a design of the front, beside its dot."""
    return ", ".join(f"{value:.3g}" for value in design.values.values())


def curve_page(designs: Sequence[Design], names: Sequence[str], *, synthetic: bool = False) -> "Figure":
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


def _draw_curve(axes: "Axes", values: Any, measured: Any) -> None:
    known = np.isfinite(measured)
    axes.plot(values[known], measured[known], "o", color=ACCENT, markersize=4, alpha=0.55, markeredgewidth=0)
    places = np.unique(values[known])
    if 1 < len(places) <= max(12, known.sum() // 2):
        middle = [np.median(measured[known & (values == place)]) for place in places]
        axes.plot(places, middle, "-", color=INK, linewidth=1.4)
    for place in np.unique(values[~known]):
        axes.axvline(place, color=LIMIT, linewidth=0.8, linestyle=":", alpha=0.6)
    axes.grid()
