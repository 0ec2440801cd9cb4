"""Names beside the points of a figure, kept off each other."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import Bbox

__all__ = ["place_names"]

SIZE = 7.0
PLACES = (
    *((5.0, y, "left") for y in (3.0, -9.0, 12.0, -18.0)),
    *((-5.0, y, "right") for y in (3.0, -9.0, 12.0, -18.0)),
)
"""Offsets that are tried in this order, and the side of the name that is at the point. [points]"""


def place_names(axes: "Axes", points: Mapping[str, tuple[float, float]]) -> None:
    """Name points in data coordinates, each at the first place where it covers no other name, no legend and no edge.

    The figure must have been laid out. A name that finds no such place is left at its first one.
    """
    legend = axes.get_legend()
    taken = [axes.transData.transform([point]).repeat(2, axis=0) for point in points.values()]
    boxes = [_around(corners) for corners in taken]
    if legend is not None:
        boxes.append(legend.get_window_extent())
    for name, point in points.items():
        boxes.append(_place(axes, name, point, boxes))


def _around(corners: object) -> "Bbox":
    """A box of a marker's size about a point in pixels."""
    from matplotlib.transforms import Bbox

    return Bbox(corners).padded(3.0)  # type: ignore[arg-type]


def _place(axes: "Axes", name: str, point: tuple[float, float], boxes: list["Bbox"]) -> "Bbox":
    tried = []
    for x, y, side in PLACES:
        text = axes.annotate(
            name, point, xytext=(x, y), textcoords="offset points", ha=side, fontsize=SIZE, color="0.35", zorder=5
        )
        box = text.get_window_extent()
        inside = axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1
        if inside and not any(box.overlaps(other) for other in boxes):
            break
        tried.append((text, box))
    else:
        text, box = tried.pop(0)
    for other, _ in tried:
        other.remove()
    return box
