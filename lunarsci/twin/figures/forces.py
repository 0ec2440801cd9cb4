"""The picture of wheel forces along a drive: one panel for each force, one line for each wheel."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ensemble import STATE_COLUMNS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["force_figure"]

FloatArray = npt.NDArray[np.float64]
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
    missing_n: FloatArray | None = None,
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
    rows: Any = figure.subplots(3 if missing_n is None else 4, 2, sharex=True, squeeze=False)
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
    if missing_n is not None:
        for panel, values, text in zip(rows[3], missing_n.T, ("ahead", "to the left"), strict=True):
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
