"""Quantities of a drive against distance: median and spread over the members."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.twin.figures.relief import ACCENT, INK, LIMIT
from lunarsci.twin.judgement.quantities import abscissa, along
from lunarsci.twin.judgement.safety import Verdict
from lunarsci.twin.judgement.tables import spread
from lunarsci.twin.plans.plan import AT_LEAST
from lunarsci.twin.simulation.ensemble import Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["LABELS", "WHEEL_COLORS", "draw_band", "draw_loads"]

FloatArray = npt.NDArray[np.float64]

LABELS = {
    "slip_ratio": ("Slip ratio s [-]", 1.0),
    "side_slip_deg": ("Side slip β [deg]", 1.0),
    "sinkage_m": ("Sinkage z [mm]", 1e3),
    "tilt_deg": ("Tilt [deg]", 1.0),
    "roll_deg": ("Roll [deg]", 1.0),
    "pitch_deg": ("Pitch, nose down [deg]", 1.0),
    "clearance_m": ("Ground clearance [m]", 1.0),
    "keep_out_m": ("To the keep-out circles [m]", 1.0),
    "miss_m": ("Off the planned place [m]", 1.0),
    "normal_force_n": ("Normal force F$_N$ [N]", 1.0),
}
"""Axis label, and factor from the quantity's unit to the label's."""
SIGNED = ("slip_ratio", "side_slip_deg")
WHEEL_COLORS = ("#0072b2", "#56b4e9", "#009e73", "#e69f00", "#d55e00", "#cc79a7")
"""Of Okabe & Ito, told apart by the colour-blind."""


def draw_band(axes: "Axes", prediction: Prediction, verdict: Verdict, quantity: str, *, legend: bool = False) -> None:
    """p05 to p95, median and extremes over members and wheels, and the limit where it is in sight."""
    label, factor = LABELS[quantity]
    where, _ = abscissa(prediction)
    low, middle, high, least, most = factor * spread(along(prediction, quantity), prediction.reached)
    axes.fill_between(where, low, high, color=ACCENT, alpha=0.25, linewidth=0, label="p05 to p95")
    for edge, name in ((least, "min and max"), (most, None)):
        axes.plot(where, edge, color=ACCENT, linewidth=0.7, linestyle=":", label=name)
    axes.plot(where, middle, color=ACCENT, linewidth=1.6, label="median")
    _draw_joints(axes, prediction)
    axes.set_ylabel(label)
    for judgement in verdict.limits:
        if judgement.quantity == (quantity if quantity != "miss_m" else "endpoint_miss_m"):
            _draw_limit(axes, quantity, factor * judgement.limit, _unit(label))
    if legend:
        _legend_above(axes, 3)


def draw_loads(axes: "Axes", prediction: Prediction) -> None:
    """Normal force of each wheel: median and p05 to p95 over the members."""
    where, _ = abscissa(prediction)
    forces = along(prediction, "normal_force_n")
    for number, wheel in enumerate(prediction.rover.wheels):
        low, middle, high, *_ = spread(forces[..., number], prediction.reached)
        color = WHEEL_COLORS[number % len(WHEEL_COLORS)]
        axes.fill_between(where, low, high, color=color, alpha=0.2, linewidth=0)
        axes.plot(where, middle, color=color, linewidth=1.5, linestyle="-" if number % 2 == 0 else "--", label=wheel)
    _draw_joints(axes, prediction)
    axes.set_ylabel(LABELS["normal_force_n"][0])
    _legend_above(axes, len(prediction.rover.wheels))


def _draw_joints(axes: "Axes", prediction: Prediction) -> None:
    """Upright lines where the pieces of the plan join, range and grid."""
    where, _ = abscissa(prediction)
    if where is prediction.distance_m:
        for place in np.cumsum([leg.length_m for leg in prediction.plan.legs])[:-1]:
            axes.axvline(place, color=INK, linewidth=0.6, alpha=0.35)
    axes.set_xlim(float(where[0]), float(where[-1]))
    axes.grid(alpha=0.25, linewidth=0.5)


def _legend_above(axes: "Axes", columns: int) -> None:
    """A legend on one line, with room for it above the curves."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top + 0.16 * (top - bottom))
    axes.legend(loc="upper center", ncols=columns, fontsize=8, frameon=False)


def _unit(label: str) -> str:
    unit = label[label.index("[") + 1 : -1]
    return "" if unit == "-" else f" {unit}"


def _draw_limit(axes: "Axes", quantity: str, limit: float, unit: str) -> None:
    """Dashed lines where the limit is in sight, and its value in any case."""
    bottom, top = axes.get_ylim()
    signed = bottom < 0 and quantity in SIGNED
    for line in (-limit, limit) if signed else (limit,):
        if bottom - 0.3 * (top - bottom) < line < top + 0.3 * (top - bottom):
            axes.axhline(line, color=LIMIT, linewidth=1.0, linestyle="--")
    if signed:
        axes.axhline(0.0, color=INK, linewidth=0.6)
    sense = "at least " if quantity in AT_LEAST else "±" if signed else ""
    where = " at the end" if quantity == "miss_m" else ""
    axes.set_title(f"limit{where} {sense}{limit:g}{unit}", fontsize=8, color=LIMIT, loc="right")
