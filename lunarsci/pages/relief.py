"""A terrain and drives on it, small enough to be turned in a page, and a still picture of the same."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import COLORS, INK, as_label, legend_below, page, picture_bytes, styled
from lunarsci.pages.documents import Document

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_NODES, MOST_DRIVES, MOST_POINTS = 72, 40, 60
"""Nodes along a side of the ground, drives of a prediction and points of a line that a page takes; assumed."""
MARGIN_M = 2.5
"""Ground that is shown around the drives. [m]"""
WAYS = {
    "twin-predict": ("predicted", "paths"),
    "twin-plan": ("planned", "path"),
    "twin-states": ("driven", "motion"),
}
"""By the kind of a result what its way is called, and the table that has it. Planned ways are dashed; of predicted
ones, many drives, only some are drawn."""
HOLE, FULL = -32768, 32000
"""A node without a height, and the highest, in the whole numbers of the page."""


class Ground(Protocol):
    """Heights on a regular grid, as a `HeightGrid` or a terrain of the twin has them; x along columns, y along rows."""

    @property
    def name(self) -> str: ...
    @property
    def x0_m(self) -> float: ...
    @property
    def y0_m(self) -> float: ...
    @property
    def spacing_m(self) -> float: ...
    @property
    def height_m(self) -> FloatArray: ...
    @property
    def synthetic(self) -> bool: ...


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A way on the ground.

    Attributes
    ----------
    name : of its group in the legend.
    xy_m : places along it. (n, 2) [m]
    color : as matplotlib and the page know it.
    dashed : whether it is drawn so.
    """

    name: str
    xy_m: FloatArray
    color: str
    dashed: bool = False


def drives(name: str, places_m: Sequence[FloatArray]) -> list[Line]:
    """Ways of some drives, each (n, 2) or wider, of at most 40 of them and as many points as a page takes."""
    shown = [places_m[k] for k in _spread(len(places_m), MOST_DRIVES)]
    return [Line(name, _thinned(np.asarray(one)[:, :2]), COLORS[0]) for one in shown]


@dataclass(frozen=True, slots=True, eq=False)
class GroundView:
    """Ground and lines as the page takes them.

    Attributes
    ----------
    data : base64 of a JSON text that `relief.js` reads.
    still : the same from above, as PNG.
    note : what was left out, for those who look at it.
    words : what is shown.
    legend : name, colour and whether dashed, of each group of lines.
    """

    data: str
    still: bytes
    note: str
    words: str
    legend: Sequence[tuple[str, str, bool]] = ()


def lines_of(documents: Sequence[Document]) -> list[Line]:
    """Ways of all results: planned paths, predicted drives, and what was driven by the smoothed motion."""
    ways = [(one, *WAYS[one.kind]) for one in documents if one.kind in WAYS]
    return [
        Line(f"{name}: {document.name}", places, COLORS[number % len(COLORS)], name == "planned")
        for number, (document, name, file) in enumerate(ways)
        for places in _places(document.table(file))
    ]


def _places(rows: Sequence[Mapping[str, str]]) -> list[FloatArray]:
    """Ways of a table, one for each member of a prediction, of at most 40 of them."""
    members: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if row.get("x_m") and row.get("y_m"):
            members.setdefault(row.get("member", ""), []).append((float(row["x_m"]), float(row["y_m"])))
    return [_thinned(np.array(list(members.values())[k])) for k in _spread(len(members), MOST_DRIVES)]


def _spread(count: int, most: int) -> list[int]:
    """Numbers from 0 to below `count`, all or `most` of them, evenly spread."""
    return [int(k) for k in np.unique(np.linspace(0, count - 1, min(count, most)).round())] if count else []


def _thinned(places: FloatArray) -> FloatArray:
    """As many places (n, 2) of a way as a page takes, evenly over it, its ends included."""
    return places[_spread(len(places), MOST_POINTS)]


def relief(grid: Ground, lines: Sequence[Line]) -> GroundView:
    """The ground around the lines, all of it where there are none, in at most 72 by 72 nodes."""
    rows, columns = _window(grid, lines)
    step = max(1, -(-max(len(rows), len(columns)) // MOST_NODES))
    rows, columns = rows[::step], columns[::step]
    height = grid.height_m[np.ix_(rows, columns)]
    x, y = grid.x0_m + columns * grid.spacing_m, grid.y0_m + rows * grid.spacing_m
    shown = [(line, np.c_[line.xy_m, _heights_at(line.xy_m, x, y, height)]) for line in lines]
    note = f"Shown with a node every {step * grid.spacing_m:.3g} m" + (
        f"; the terrain's own are {grid.spacing_m:.3g} m apart." if step > 1 else ", as the terrain has them."
    )
    drives = sum(line.name.startswith("predicted") for line in lines)
    if drives:
        note += f" Of each prediction at most {MOST_DRIVES} drives are drawn."
    ground = f"{grid.name}{' (synthetic)' if grid.synthetic and 'synthetic' not in grid.name else ''}"
    names = list(dict.fromkeys(line.name for line in lines))
    heights = height[np.isfinite(height)]
    words = (
        f"{ground}, {x[-1] - x[0]:.1f} m by {y[-1] - y[0]:.1f} m, heights {heights.min():.2f} to {heights.max():.2f} m"
        f"{', with lines: ' + ', '.join(names) if names else ''}."
    )
    legend = list(dict.fromkeys((line.name, line.color, line.dashed) for line in lines))
    return GroundView(_packed(x, y, height, shown), _still(x, y, height, lines), note, words, legend)


def _window(grid: Ground, lines: Sequence[Line]) -> tuple[Any, Any]:
    """Numbers of the rows and of the columns about the lines, at least 3 each; all where there would be fewer."""
    sizes = grid.height_m.shape
    every = np.arange(sizes[0]), np.arange(sizes[1])
    if not lines:
        return every
    points = np.vstack([line.xy_m for line in lines])
    origin = (grid.x0_m, grid.y0_m)
    inside = [
        number[(at >= low - MARGIN_M) & (at <= high + MARGIN_M)]
        for number, at, low, high in (
            (
                every[1 - axis],
                origin[axis] + every[1 - axis] * grid.spacing_m,
                points[:, axis].min(),
                points[:, axis].max(),
            )
            for axis in (1, 0)
        )
    ]
    return (inside[0], inside[1]) if min(map(len, inside)) >= 3 else every


def _heights_at(xy: FloatArray, x: FloatArray, y: FloatArray, height: FloatArray) -> FloatArray:
    """Height of the node nearest to each place (n, 2); the mean where that has none. (n,) [m]

    x (columns,), y (rows,), height (rows, columns) are of the nodes. [m]
    """
    row = np.abs(y[:, None] - xy[:, 1]).argmin(axis=0)
    column = np.abs(x[:, None] - xy[:, 0]).argmin(axis=0)
    nearest: FloatArray = np.nan_to_num(height[row, column], nan=float(np.nanmean(height)))
    return nearest


def _packed(x: FloatArray, y: FloatArray, height: FloatArray, lines: Sequence[tuple[Line, FloatArray]]) -> str:
    """`GroundView.data`: nodes as of `_heights_at`, and lines with their places x, y, z (n, 3). [m]"""
    low, high = float(np.nanmin(height)), float(np.nanmax(height))
    scale = max(high - low, 1e-6) / FULL
    numbers = np.where(np.isfinite(height), np.nan_to_num((height - low) / scale), HOLE).round().astype("<i2")
    scene = {
        "rows": len(y), "columns": len(x), "x": [x[0], x[-1]], "y": [y[0], y[-1]], "low": low,
        "scale": scale, "hole": HOLE,
        "heights": base64.b64encode(numbers.tobytes()).decode(),
        "lines": [
            {"name": line.name, "color": line.color, "dashed": line.dashed, "points": points.round(3).tolist()}
            for line, points in lines
        ],
    }  # fmt: skip
    return base64.b64encode(json.dumps(scene).encode()).decode()


def _still(x: FloatArray, y: FloatArray, height: FloatArray, lines: Sequence[Line]) -> bytes:
    """`GroundView.still`; nodes as of `_heights_at`."""
    with styled():
        return picture_bytes([still_figure(x, y, height, lines)], Path("still.png"))


def still_figure(x: FloatArray, y: FloatArray, height: FloatArray, lines: Sequence[Line]) -> "Figure":
    """The ground from above, shaded, x along its columns and y along its rows, with lines on it."""
    from matplotlib.colors import LightSource

    wide = float(np.clip(np.ptp(y) / max(np.ptp(x), 1e-9), 0.4, 1.4))
    figure = page(5.2 * wide + (0.8 if lines else 0.1), 5.2)
    axes = figure.subplots()
    step = float(x[1] - x[0])
    filled = np.nan_to_num(height, nan=float(np.nanmean(height)))
    shade = LightSource(315, 35).hillshade(filled[::-1], 3.0, step, step)[::-1]
    extent = (x[0] - step / 2, x[-1] + step / 2, y[0] - step / 2, y[-1] + step / 2)
    axes.imshow(shade, cmap="gray", vmin=-0.4, vmax=1.1, extent=extent, origin="lower", interpolation="bilinear")
    named: set[str] = set()
    for line in lines:
        label = None if line.name in named else line.name
        named.add(line.name)
        look: Any = {"color": line.color, "linestyle": "--" if line.dashed else "-", "linewidth": 1.0}
        axes.plot(*line.xy_m.T, color="white", linewidth=2.2, alpha=0.5)
        axes.plot(*line.xy_m.T, label=label and as_label(label), **look)
        axes.plot(*line.xy_m[0], "o", color="white", markeredgecolor=INK, markersize=5)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=extent[:2], ylim=extent[2:])
    legend_below(figure, axes, 2)
    return figure
