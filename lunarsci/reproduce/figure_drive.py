"""Figures 3 and S6 of Ding et al. (2024) on the stand-in for their ground: fans of paths, and slip by soil."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import INK, headline, legend_below, page
from lunarsci.reproduce.drive import (
    K_Y_MM,
    PHI_DEG,
    SOIL,
    STAND_IN,
    TYPICAL_K_Y_MM,
    TYPICAL_PHI_DEG,
    Drives,
    medians,
)
from lunarsci.reproduce.numbers import published_value
from lunarsci.reproduce.soil import Rolling
from lunarsci.twin.figures.panels import GOLD, LIMIT, draw_ground, draw_planned, map_window
from lunarsci.twin.simulation.ensemble import Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PHI, K_Y = "friction_angle_deg", "lateral_modulus_mm"
SYMBOLS = {PHI: ("φ", "°"), K_Y: ("K$_y$", " mm")}
NAMES = {"slip_ratio": "slip ratio [-]  (negative: skid)", "side_slip_deg": "side slip angle |β| [°]"}
PUBLISHED = {
    PHI: dict(zip(PHI_DEG, ("slip-25deg", "slip-55deg"), strict=True)),
    K_Y: dict(zip(K_Y_MM, ("side-slip-15mm", "side-slip-45mm"), strict=True)),
}
COLUMNS = {"slip_ratio": 3, "side_slip_deg": 4}
SHOWN_SLOPES = (0.0, 12.0)
LIGHTEST = 0.88
"""End of the colours of values, which would be too light on paper beyond."""


def drive_pages(drives: Drives) -> "Iterator[Figure]":
    """Two pages: fans of paths with their ends (Fig. 3), and slip and side slip by soil (Fig. S6)."""
    yield _fans(drives.stand_in)
    yield _slips(drives)


def _fans(found: Prediction) -> "Figure":
    figure = page(6.8)
    parts: Any = figure.subfigures(2, 1)
    fans = ((PHI, K_Y, TYPICAL_K_Y_MM, "ab"), (K_Y, PHI, TYPICAL_PHI_DEG, "cd"))
    for part, (parameter, other, held, letters) in zip(parts, fans, strict=True):
        whole, ends = part.subplots(1, 2, width_ratios=(1.62, 1.0))
        members = np.flatnonzero(found.parameters[other] == held)
        symbol, unit = SYMBOLS[other]
        _draw_fan(whole, found, parameter, members, 0.1)
        whole.set_title(f"{letters[0]}  {SYMBOLS[parameter][0]} varied, {symbol} = {held:g}{unit}", loc="left")
        _draw_fan(ends, found, parameter, members, 0.02)
        _draw_ends(ends, found, parameter, members)
        ends.set_title(f"{letters[1]}  its ends", loc="left")
        varied, per = SYMBOLS[parameter]
        bar = part.colorbar(
            _scale(found.parameters[parameter]), ax=whole, orientation="horizontal", aspect=40, pad=0.03
        )
        bar.set_label(f"{varied} [{per.strip()}]")
        legend_below(part, (whole, ends), 3)
    title = (
        "predicted paths after Fig. 3 of Ding et al. (2024), on synthetic ground with craters and slopes as published; "
        "contours every 0.1 m, enlarged 0.02 m"
    )
    headline(figure, title, synthetic=True)
    return figure


def _scale(values: FloatArray) -> Any:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    colors = ListedColormap(colormaps["viridis"](np.linspace(0.0, LIGHTEST, 256)))
    return ScalarMappable(Normalize(float(values.min()), float(values.max())), colors)


def _colors(values: FloatArray) -> Any:
    from matplotlib import colormaps

    return colormaps["viridis"](LIGHTEST * _scale(values).norm(values))


def _draw_fan(axes: "Axes", found: Prediction, parameter: str, members: Any, contour_m: float) -> None:
    draw_ground(axes, found.terrain, map_window(found, found.terrain, 2.2), contour_m)
    draw_planned(axes, found)
    values = found.parameters[parameter][members]
    for member, color in zip(members, _colors(values), strict=True):
        part = found.paths[member, : max(int(found.recorded[member]), 1)]
        axes.plot(part[:, 0], part[:, 1], color=color, linewidth=1.2, zorder=6)
    start, end = found.planned[0], found.planned[-1]
    axes.plot(start[0], start[1], "o", color="white", markeredgecolor=INK, markersize=5, zorder=8)
    axes.plot(end[0], end[1], "*", color=GOLD, markeredgecolor=INK, markersize=11, zorder=8)


def _draw_ends(axes: "Axes", found: Prediction, parameter: str, members: Any) -> None:
    """Enlarged about the destination, with the published circle and that which holds every end of all soils."""
    from matplotlib.patches import Circle

    target = found.planned[-1, :2]
    values = found.parameters[parameter][members]
    ends = found.endpoints_m[members]
    look: dict[str, Any] = {"edgecolors": INK, "linewidths": 0.6, "s": 20, "zorder": 9}
    axes.scatter(ends[:, 0], ends[:, 1], c=_colors(values), **look)
    circles = (
        (published_value("ends-within"), LIMIT, ":", "published: no end beyond"),
        (float(found.miss_m[found.finished].max()), INK, "--", "ours, all soils: no end beyond"),
    )
    for radius, color, style, name in circles:
        text = f"{name} {radius:.3f} m"
        circle = Circle(tuple(target), radius, fill=False, edgecolor=color, linestyle=style, linewidth=1.4, zorder=7)
        axes.add_patch(circle)
        axes.plot([], [], color=color, linestyle=style, linewidth=1.4, label=text)
    half = 1.45 * max(radius for radius, *_ in circles)
    axes.set_xlim(target[0] - half, target[0] + half)
    axes.set_ylim(target[1] - half, target[1] + half)


def _slips(drives: Drives) -> "Figure":
    figure = page(4.0)
    slip, side, rolling = figure.subplots(1, 3)
    _boxes(slip, drives.stand_in, PHI, "slip_ratio", "a  on the stand-in")
    _boxes(side, drives.stand_in, K_Y, "side_slip_deg", "b  on the stand-in")
    _rolling(rolling, drives)
    headline(figure, "slip by soil after Fig. S6 of Ding et al. (2024)", synthetic=True)
    return figure


def _boxes(axes: "Axes", found: Prediction, parameter: str, quantity: str, title: str) -> None:
    """All wheel states for each value of a parameter, and the published medians at both ends."""
    values = found.states[..., COLUMNS[quantity]]
    values = np.abs(values) if quantity == "side_slip_deg" else values
    own = found.parameters[parameter]
    places = np.unique(own)
    states = [values[own == place][found.reached[own == place]].ravel() for place in places]
    width = 0.6 * float(np.diff(places).min())
    axes.boxplot(
        states, positions=places, widths=width, whis=(5, 95), showfliers=False, patch_artist=True,
        boxprops={"facecolor": "#bcd7e0"}, medianprops={"color": INK, "linewidth": 1.8}, manage_ticks=False,
    )  # fmt: skip
    axes.plot(*zip(*medians(found, quantity, parameter).items(), strict=True), color=INK, linewidth=1.0)
    ends = PUBLISHED[parameter]
    published = [published_value(name) for name in ends.values()]
    axes.plot(list(ends), published, "D--", color=LIMIT, markersize=5, zorder=5, label="published medians")
    axes.plot([], [], color=INK, linewidth=1.8, label="ours: quartiles, 5 to 95 %")
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    symbol, unit = SYMBOLS[parameter]
    axes.set_xlabel(f"{symbol} [{unit.strip()}]")
    axes.set_ylabel(NAMES[quantity])
    axes.set_xticks(places)
    axes.set_title(title, loc="left")
    _legend(axes)


def _rolling(axes: "Axes", drives: Drives) -> None:
    """Steady rolling against the slope, and the medians on each ground: why the trend of the slip differs."""
    from lunarsci.regolith.soil import read_soil

    rolling, soil = Rolling.of(drives.rover), read_soil(SOIL)
    slopes = np.linspace(*SHOWN_SLOPES, 25)
    phis = np.array([PHI_DEG[0], TYPICAL_PHI_DEG, PHI_DEG[1]])
    for phi, color, dashes in zip(phis, _colors(phis), ("-", (0, (7, 2)), "-."), strict=True):
        own = soil.replace(friction_angle_deg=float(phi))
        slips = [rolling.slip_ratio(own, float(slope)) for slope in slopes]
        axes.plot(slopes, slips, color=color, linestyle=dashes, label=f"steady rolling, φ = {phi:g}°")
    for phi, color, dashes in zip(PHI_DEG, (_colors(phis)[0], _colors(phis)[-1]), ("--", ":"), strict=True):
        value = published_value(PUBLISHED[PHI][phi])
        axes.axhline(value, color=color, linestyle=dashes, linewidth=1.2, label=f"published median, φ = {phi:g}°")
    for name, found in drives.on.items():
        if name != STAND_IN and "down" in name:
            slope = float(name.partition("°")[0])
            for phi, color in zip(PHI_DEG, (_colors(phis)[0], _colors(phis)[-1]), strict=True):
                axes.plot(slope, medians(found, "slip_ratio", PHI)[phi], "o", color=color, markeredgecolor=INK)
    axes.plot([], [], "o", color="white", markeredgecolor=INK, label="the rover on planes")
    steepest = published_value("slope-most")
    axes.axvline(steepest, color="0.5", linewidth=0.8, label=f"steepest, published: {steepest}°")
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes.set_xlabel("slope, downhill [°]")
    axes.set_ylabel(NAMES["slip_ratio"])
    axes.set_title("c  slip against slope, no terrain", loc="left")
    _legend(axes)


def _legend(axes: "Axes") -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False)
