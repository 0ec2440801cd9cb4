"""What is wrong with two pictures that do not make a pair, as far as looking and trying tells."""

from collections.abc import Callable

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.images.pictures import Picture

ALIKE = 0.999
"""Correlation of two pictures, pixel on pixel, from which they are one: assumed. Two views of ground are below 0.9."""
LEAST_SHARE = 0.4
"""Share that must match before a trial is believed: pictures of two places, turned, may match by their parallax.
Assumed."""
UNEVEN_PX = 0.45
"""Robust scatter of the rows' distances about their plane from which the pictures are of two moments; measured: a
rendered pair has 0.05 px, 0.11 px where the rover moved by 1 cm between its pictures, 0.52 px by 3 cm."""
Share = Callable[[FloatArray, FloatArray], float]
"""Share of the pixels of two pictures, left and right, that match."""


def check_two(left: Picture, right: Picture) -> None:
    """Raise DataError where two pictures are one and the same."""
    if left.size != right.size:
        return
    one, two = (p.values[::4, ::4].ravel() for p in (left, right))
    if np.corrcoef(one, two)[0, 1] > ALIKE:
        names = f"{left.source.name}, {right.source.name}"
        raise DataError(f"{names}: show the same, pixel on pixel; give the pictures of the left and the right camera")


def check_rows(apart_px: FloatArray, names: str) -> None:
    """Raise DataError where distances of rows (n,) [px], less their plane, scatter as in no pair of one moment."""
    scatter = 1.4826 * float(np.median(np.abs(apart_px - np.median(apart_px))))
    if scatter > UNEVEN_PX:
        raise DataError(
            f"{names}: rows are apart unevenly, by {scatter:.1f} px; did the rover move between them, "
            "is one turned, or the rig another one?"
        )


def what_is_wrong(left: Picture, right: Picture, share: Share, fewest: float) -> str:
    """One line on two pictures of which less than the share `fewest` matches, from trying them otherwise."""
    names = f"{left.source.name}, {right.source.name}"
    one, two = left.values, right.values
    square = left.size[0] == left.size[1]
    tries = {
        "left and right are swapped, or both are upside down; give the left one first": (two, one),
        "the right picture is upside down": (one, two[::-1, ::-1]),
        "the left picture is upside down": (one[::-1, ::-1], two),
    }
    if square:
        tries |= {
            "both pictures are turned by 90 deg clockwise": (np.rot90(one), np.rot90(two)),
            "both pictures are turned by 90 deg anticlockwise": (np.rot90(one, -1), np.rot90(two, -1)),
            "the right picture is turned by 90 deg": (one, np.rot90(two)),
            "the left picture is turned by 90 deg": (np.rot90(one), two),
        }
    found = {said: share(*pair) for said, pair in tries.items()}
    likeliest = max(found, key=lambda said: found[said])
    if found[likeliest] > max(LEAST_SHARE, 1.5 * share(one, two)):
        return f"{names}: do not match as they are: {likeliest}"
    return (
        f"{names}: less than {fewest:.0%} of the pixels match; are they of one place, one moment and this rig, "
        "and is neither turned?"
    )
