"""The picture of a belief's history: each parameter's median and 68 % interval after each drive."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.belief_history import past_beliefs, rolled_back, shared_drives
from lunarsci.regolith.prior import PARAMETERS

__all__ = ["belief_history_figure"]

INK, OWN, OTHER, REFUSED = "#26323a", "#0072B2", "#D55E00", "#c0392b"
LABELS = {
    "stiffness_kpa_m_n": "Stiffness K$_s$ [kPa m$^{-N}$]",
    "sinkage_exponent": "Sinkage exponent N [-]",
    "sinkage_exponent_slip": "Dynamic exponent n$_1$ [-]",
    "cohesion_pa": "Cohesion c [Pa]",
    "friction_angle_deg": "Friction angle φ [deg]",
    "shear_modulus_mm": "Shear modulus K$_x$ [mm]",
    "external_friction_angle_deg": "External friction angle φ$_y$ [deg]",
    "lateral_modulus_mm": "Lateral modulus K$_y$ [mm]",
}


def belief_history_figure(
    belief: SoilBelief, title: str, other: SoilBelief | None = None, names: tuple[str, str] = ("", "")
) -> Figure:
    """One panel for each parameter; a second belief beside the first where there is one.

    Bars are 68 %; the band is the interval of the priors. Drives from which nothing was learned are crossed. What two
    beliefs share is drawn once, as the first's. States that a file did not keep are left out.
    """
    figure = Figure(figsize=(13.0, 6.6), dpi=130, layout="constrained", facecolor="white")
    panels: Any = figure.subplots(2, 4, sharex=True)
    most = max(len(belief.history), len(other.history) if other else 0)
    first = 0 if other is None else shared_drives(belief, other) + 1
    for panel, name in zip(panels.ravel(), PARAMETERS, strict=True):
        _, low, high = rolled_back(belief, 0).intervals()[name]
        panel.axhspan(low, high, color=INK, alpha=0.08, linewidth=0, label="the priors")
        _draw(panel, belief, name, OWN, -0.0 if other is None else -0.08, names[0] or "median and 68 %", 0)
        if other is not None:
            _draw(panel, other, name, OTHER, 0.08, names[1], min(first, len(other.history)))
        panel.set_ylabel(LABELS[name])
        panel.grid(alpha=0.25, linewidth=0.5)
        panel.set_xticks(_ticks(most))
        panel.set_xlim(-0.4, most + 0.4)
    for panel in panels[1]:
        panel.set_xlabel("after drive")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    figure.suptitle(title, fontsize=12)
    return figure


def _ticks(most: int) -> Sequence[int]:
    return range(0, most + 1, max(1, -(-most // 8)))


def _draw(panel: Any, belief: SoilBelief, name: str, color: str, shift: float, label: str, first: int) -> None:
    kept = [(k, state.intervals()[name]) for k, state in enumerate(past_beliefs(belief)) if state and k >= first]
    drives = [k + shift for k, _ in kept]
    middle = [value for _, (value, _, _) in kept]
    spread = [[v - low for _, (v, low, _) in kept], [high - v for _, (v, _, high) in kept]]
    look: Any = {"color": color, "markersize": 5, "linewidth": 1.2, "capsize": 3, "elinewidth": 1.4}
    panel.errorbar(drives, middle, spread, fmt="o-", label=label, **look)
    lost = [k for k, _ in kept if k and belief.history[k - 1].get("refused")]
    if lost:
        values = [value for k, (value, _, _) in kept if k in lost]
        cross = "nothing was learned"
        panel.plot([k + shift for k in lost], values, "x", color=REFUSED, markersize=9, zorder=5, label=cross)
