"""Ties of two stations in both pictures, and how they fit."""

from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import COLORS, as_label, headline, legend_below, page
from lunarsci.images.localisation import Localised

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


ARROW = 30.0
"""Residuals are drawn so many times as long."""


def ties_figure(found: Localised, number: int, *, synthetic: bool = False) -> "Figure":
    """Picture of one pair's ties: in the farther and the nearer left picture, residuals, and a plan of stations."""
    pair, adjusted = found.pairs[number], found.adjusted
    far, near = found.stations[pair.far], found.stations[pair.near]
    figure = page(7.2)
    parts: Any = figure.subfigures(2, 1)
    above, below = parts
    (left, right), (residuals, plan) = above.subplots(1, 2), below.subplots(1, 2)
    title = f"{as_label(far.name)} and {as_label(near.name)}: {len(pair.ties.correlation)} ties"
    headline(figure, f"{title}; a tie has the same colour in both pictures", synthetic=synthetic)
    colours = np.arange(len(pair.ties.correlation), dtype=float)
    _picture(left, far.matches.left, pair.ties.far_px, colours, f"{as_label(far.name)}, from afar")
    _picture(right, near.matches.left, pair.ties.near_px, colours, f"{as_label(near.name)}, from near")
    off = adjusted.residual_px[number]
    _residuals(residuals, pair.ties.far_px, off, adjusted.weights[number])
    _plan(plan, found)
    legend_below(below, plan, 2)
    return figure


def _picture(axis: "Axes", light: FloatArray, places: FloatArray, colours: FloatArray, title: str) -> None:
    low, high = np.percentile(light, [0.5, 99.5])
    axis.imshow(np.sqrt(np.clip(light, 0, high)), cmap="gray", vmin=np.sqrt(max(low, 0)), vmax=np.sqrt(high))
    axis.scatter(places[:, 0], places[:, 1], c=colours, s=14, cmap="viridis", edgecolors="white", linewidths=0.5)
    axis.set_title(title)
    axis.set_axis_off()


def _residuals(axis: "Axes", places: FloatArray, off: FloatArray, weights: FloatArray) -> None:
    shown = axis.quiver(
        *places.T, *(ARROW * off).T, weights, angles="xy", scale_units="xy", scale=1, cmap="viridis", clim=(0, 1)
    )
    axis.invert_yaxis()
    axis.set(xlabel="u [px]", ylabel="v [px]")
    axis.set_title(f"residuals, {ARROW:g} times as long; median {np.median(np.linalg.norm(off, axis=1)):.2f} px")
    axis.figure.colorbar(shown, ax=axis, orientation="horizontal", label="weight of the tie [-]", shrink=0.8)


def _plan(axis: "Axes", found: Localised) -> None:
    """Stations by dead reckoning and by ties, with ellipses of 95 %, drawn larger where they would not be seen."""
    from matplotlib.patches import Ellipse

    told = np.array([s.pose.center_m[:2] for s in found.stations])
    now = np.array([p.center_m[:2] for p in found.poses])
    axis.plot(*told.T, "o--", color="0.5", label="dead reckoning")
    axis.plot(*now.T, "^-", color=COLORS[1], label="by ties")
    for k in range(1, len(now)):
        own = found.covariance[6 * k - 3 : 6 * k - 1, 6 * k - 3 : 6 * k - 1]
        sizes, ways = np.linalg.eigh(own)
        turn = np.degrees(np.arctan2(ways[1, 1], ways[0, 1]))
        width, height = 2 * 2.448 * np.sqrt(np.maximum(sizes[::-1], 0)) * 10
        axis.add_patch(Ellipse(tuple(now[k]), width, height, angle=turn, fill=False, color=COLORS[1]))
    axis.set(xlabel="x [m]", ylabel="y [m]", title="left cameras; ellipses of 95 %, ten times as large")
    axis.set_aspect("equal", adjustable="datalim")
