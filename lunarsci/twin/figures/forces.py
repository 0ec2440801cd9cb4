"""The picture of wheel forces along a drive: one panel for each force, one line for each wheel.

The picture of wheel forces with their uncertainty: against distance, bands, and the assumed soil's share of them.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.loads.load_ensemble import LoadEnsemble
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["force_band_figure", "force_figure"]

FloatArray = npt.NDArray[np.float64]
# Left and right wheel, told apart by the colour-blind (Okabe & Ito 2008); and ink.
LEFT, RIGHT, INK = "#0072B2", "#D55E00", "#26323a"
LABELS = ("Normal force F$_N$ [N]", "Drawbar pull F$_{DP}$ [N]", "Lateral force F$_L$ [N]")
MISSING = ("Missing ahead [N]", "Missing to the left [N]", "Missing moment [N m]")


def force_band_figure(found: LoadEnsemble, title: str) -> "Figure":
    """A column of panels for each axle: the three forces of its wheels, and below what is missing of the totals.

    Pale bands are one standard deviation after the balance; the dark band in it is what the assumed soil brings of it.
    """
    from matplotlib.figure import Figure

    wheels = found.held.rover.wheels
    columns = len(wheels) // 2
    figure = Figure(figsize=(4.3 * columns, 11.0), dpi=130, layout="constrained", facecolor="white")
    parts: Any = figure.subfigures(2, 1, height_ratios=(3.1, 1.0))
    upper, lower = parts
    panels: Any = upper.subplots(3, columns, sharex=True, sharey="row", squeeze=False)
    along = found.held.motion.rolled_m
    for force, row in enumerate(panels):
        for axle, panel in enumerate(row):
            for side, color in enumerate((LEFT, RIGHT)):
                _draw_band(panel, along, found, 2 * axle + side, force, color)
            _band_frame(panel, LABELS[force] if axle == 0 else "", along)
    for panel in panels[0]:
        panel.legend(loc="upper center", ncols=2, fontsize=7.5, frameon=False)
    bottom, top = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(bottom, top + 0.22 * (top - bottom))
    for panel in panels.ravel():
        _zero(panel)
    _draw_missing(lower.subplots(1, 3, sharex=True), along, found)
    figure.suptitle(
        f"{title}\npale: ±1 standard deviation after the balance of totals; dark: what the assumed soil brings of it",
        fontsize=11,
    )
    return figure


def _draw_band(panel: Any, along: FloatArray, found: LoadEnsemble, wheel: int, force: int, color: str) -> None:
    mean, sigma = found.after[:, wheel, force], found.after_sigma[:, wheel, force]
    soil = np.minimum(np.sqrt(np.maximum(found.after_parts[0, :, wheel, force], 0.0)), sigma)
    name = found.held.rover.wheels[wheel]
    panel.fill_between(along, mean - sigma, mean + sigma, color=color, alpha=0.18, linewidth=0, label=f"{name} ±σ")
    panel.fill_between(along, mean - soil, mean + soil, color=color, alpha=0.35, linewidth=0, label=f"{name} by soil")
    panel.plot(along, mean, color=color, linewidth=1.2, linestyle="-" if wheel % 2 == 0 else (0, (4, 2)))


def _draw_missing(panels: Any, along: FloatArray, found: LoadEnsemble) -> None:
    for k, panel in enumerate(panels):
        before, sigma = found.residual_before[:, k], found.total_before[:, k]
        panel.fill_between(along, before - sigma, before + sigma, color=INK, alpha=0.15, linewidth=0)
        panel.plot(along, before, color=INK, linewidth=1.0, linestyle=":", label="before the balance, ±σ")
        panel.plot(along, found.residual_after[:, k], color=INK, linewidth=1.4, label="after")
        _band_frame(panel, MISSING[k], along)
        _zero(panel)
        panel.set_xlabel("Distance rolled [m]")
    panels[0].legend(loc="best", fontsize=7.5, frameon=False)


def _band_frame(panel: Any, text: str, along: FloatArray) -> None:
    panel.set_ylabel(text)
    panel.set_xlim(float(along[0]), float(along[-1]))
    panel.grid(alpha=0.25, linewidth=0.5)


def _zero(panel: Any) -> None:
    if panel.get_ylim()[0] < 0 < panel.get_ylim()[1]:
        panel.axhline(0.0, color=INK, linewidth=0.6)


PANELS = {
    "normal_force_n": "Normal force F$_N$ [N]",
    "drawbar_pull_n": "Drawbar pull F$_{DP}$ [N]",
    "lateral_force_n": "Lateral force F$_L$ [N]",
    "resistance_torque_nm": "Resistance torque M$_R$ [N m]",
    "slip_ratio": "Slip ratio s [-]",
    "side_slip_deg": "Side slip β [deg]",
}
# Colours by axle that colour-blind people tell apart (Okabe & Ito 2008); left full, right dashed.
COLORS = ("#0072B2", "#D55E00", "#009E73")


def force_figure(
    wheels: tuple[str, ...],
    axis: tuple[FloatArray, str],
    states: FloatArray,
    title: str,
    residual_n: FloatArray | None = None,
) -> "Figure":
    """Forces, slip and side slip of each wheel.

    Parameters
    ----------
    wheels : their names, left and right in turn from front to rear.
    axis : values along the drive (n,), and their label.
    states : wheel states, columns `STATE_COLUMNS`; the median over members where there are several.
        (n, wheels, 10) or (members, n, wheels, 10)
    missing_n : for a given motion, the force ahead and to the left that the wheels do not supply. (n, 2) [N]
    """
    from matplotlib.figure import Figure

    along, label = axis
    middle = np.nanmedian(states, axis=0) if states.ndim == 4 else states
    figure = Figure(figsize=(11.0, 8.6), dpi=130, layout="constrained", facecolor="white")
    rows: Any = figure.subplots(3 if residual_n is None else 4, 2, sharex=True, squeeze=False)
    for panel, (name, text) in zip(rows.ravel(), PANELS.items(), strict=False):
        for k, wheel in enumerate(wheels):
            panel.plot(
                along,
                middle[:, k, STATE_COLUMNS.index(name)],
                color=COLORS[k // 2 % len(COLORS)],
                linestyle="-" if k % 2 == 0 else (0, (4, 2)),
                linewidth=1.3,
                label=wheel,
            )
        _frame(panel, text)
    if residual_n is not None:
        for panel, values, text in zip(rows[3], residual_n.T, ("ahead", "to the left"), strict=True):
            panel.plot(along, values, color="#26323a", linewidth=1.3)
            _frame(panel, f"Missing force {text} [N]")
    for panel in rows[-1]:
        panel.set_xlabel(label)
    rows[0, 0].legend(ncols=len(wheels) // 2, fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=12)
    return figure


def _frame(panel: Any, text: str) -> None:
    panel.set_ylabel(text)
    panel.grid(alpha=0.25, linewidth=0.5)
    if panel.get_ylim()[0] < 0 < panel.get_ylim()[1]:
        panel.axhline(0.0, color="#26323a", linewidth=0.6)
