"""Picture of a site among reference soils: bearing pair and shear pair, as in Fig. 4 of Ding et al. (2024)."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from lunarsci.regolith.compare import KINDS, Comparison, Site, nearest

__all__ = ["comparison_figure"]

COLORS = dict(zip(KINDS, ("black", "#0072B2", "#009E73"), strict=True))
MARKERS = dict(zip(KINDS, ("o", "^", "s"), strict=True))
SITE = "#D55E00"
NAMED = 4
"""How many of the nearest soils are named in each panel."""


def comparison_figure(site: Site, found: Sequence[Comparison], width_m: float) -> Figure:
    """Two panels: sinkage exponent against stiffness for this wheel width, cohesion against friction angle."""
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    bearing, shear = figure.subplots(1, 2)
    named = {aspect: {item.soil.name for item in nearest(found, aspect)[:NAMED]} for aspect in ("bearing", "strength")}
    for item in found:
        soil = item.soil
        color, marker = COLORS[soil.kind], MARKERS[soil.kind]
        stiffness = soil.stiffness(width_m)
        if soil.sinkage_exponent is not None and stiffness is not None and stiffness > 0:
            bearing.plot(soil.sinkage_exponent, stiffness, marker, color=color, markersize=5)
            _name(bearing, soil.sinkage_exponent, stiffness, soil.name if soil.name in named["bearing"] else "")
        cohesion = [max(value, 10.0) for value in soil.cohesion_pa]
        angle = soil.friction_angle_deg
        middle = ((cohesion[0] * cohesion[1]) ** 0.5, sum(angle) / 2)
        shear.plot(cohesion, [middle[1]] * 2, color=color, linewidth=0.8)
        shear.plot([middle[0]] * 2, angle, color=color, linewidth=0.8)
        shear.plot(*middle, marker, color=color, markersize=4)
        _name(shear, *middle, soil.name if soil.name in named["strength"] else "")
    if site.stiffness_kpa_m_n is not None:
        bearing.plot(site.sinkage_exponent, site.stiffness_kpa_m_n, "*", color=SITE, markersize=15)
    if site.cohesion_pa is not None:
        shear.plot(max(site.cohesion_pa, 10.0), site.friction_angle_deg, "*", color=SITE, markersize=15)
    bearing.set(xlabel="sinkage exponent N [-]", ylabel="stiffness K$_s$ [kPa m$^{-N}$]", yscale="log")
    bearing.set_title(f"bearing, wheel {1e3 * width_m:.0f} mm wide", fontsize=10)
    shear.set(xlabel="cohesion c [Pa], 10 and below at the edge", ylabel="internal friction angle φ [°]", xscale="log")
    shear.set_title("shear strength; lines span what the source gives", fontsize=10)
    for kind in KINDS:
        shear.plot([], [], MARKERS[kind], color=COLORS[kind], label=kind)
    shear.plot([], [], "*", color=SITE, markersize=12, label="the site")
    shear.legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def _name(axes: Any, x: float, y: float, label: str) -> None:
    if label:
        axes.annotate(label, (x, y), xytext=(5, 4), textcoords="offset points", fontsize=7)
