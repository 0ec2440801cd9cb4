"""The picture of what one soil leaves unexplained along a drive, and where the soil changes."""

from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.rectify import Rectified
from lunarsci.twin.soil_change import way_of, wheel_places
from lunarsci.twin.soil_zones import SoilChange

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["residual_page"]

DOT, MEAN, CHANGE = "#9fb4c0", "#08519c", "#e6550d"
HIGHEST = 8.0
"""Residuals beyond are drawn at the edge."""
WINDOW_M = 0.4


def residual_page(record: DriveRecord, found: Rectified, changes: list[SoilChange]) -> "Figure":
    """Measured less simulated on the best single soil, in errors, against the place of each wheel along the way.

    Lines are medians over 0.4 m; where the soil changes a line stands in the interval that holds it at 95 %.
    """
    from matplotlib.figure import Figure

    places = wheel_places(found.prediction.rover, record, way_of(found.prediction))
    known = [k for k in range(len(OBSERVED)) if np.isfinite(found.residuals[:, k]).any()]
    figure = Figure(figsize=(9.0, 1.2 + 1.6 * max(len(known), 1)), dpi=110, layout="constrained", facecolor="white")
    axes: Any = figure.subplots(max(len(known), 1), 1, sharex=True, squeeze=False)[:, 0]
    for panel, k in zip(axes, known, strict=True):
        values = np.clip(-found.residuals[:, k], -HIGHEST, HIGHEST)
        seen = np.isfinite(values)
        panel.axhline(0.0, color=INK, linewidth=0.6)
        panel.axhspan(-2.0, 2.0, color=INK, alpha=0.06, linewidth=0.0)
        panel.plot(places[seen], values[seen], ".", color=DOT, markersize=3.0)
        panel.plot(*_medians(places[seen], values[seen]), color=MEAN, linewidth=1.4)
        reach = float(np.clip(np.abs(values[seen]).max() * 1.1, 3.0, HIGHEST * 1.05))
        panel.set_ylim(-reach, reach)
        panel.set_ylabel(OBSERVED[k], fontsize=8, color=INK)
        panel.tick_params(labelsize=8)
        for change in changes:
            panel.axvspan(change.low_m, change.high_m, color=CHANGE, alpha=0.25, linewidth=0.0)
            panel.axvline(change.distance_m, color=CHANGE, linewidth=1.2)
    axes[-1].set_xlabel("Way of the wheel [m]")
    told = f"{len(changes)} change{'s' * (len(changes) > 1)} of the soil found" if changes else "no change found"
    figure.suptitle(f"Measured less simulated on one soil, in errors   ·   {told}", fontsize=11, color=INK)
    return figure


def _medians(places: Any, values: Any) -> tuple[Any, Any]:
    number = np.floor(places / WINDOW_M)
    middles = np.unique(number)
    return (middles + 0.5) * WINDOW_M, np.array([np.median(values[number == middle]) for middle in middles])
