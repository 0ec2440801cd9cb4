"""Picture of a site among reference soils in four panels, as Fig. 4 of Ding et al. (2024)."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from lunarsci.regolith.compare import KINDS, Comparison, Site, lateral_soils, nearest

__all__ = ["comparison_figure"]

COLORS = dict(zip(KINDS, ("black", "#0072B2", "#009E73"), strict=True))
MARKERS = dict(zip(KINDS, ("o", "^", "s"), strict=True))
SITE, CURVE = "#D55E00", "#E69F00"
NAMED = 4
"""How many of the nearest soils are named in each panel."""
LEAST_PA = 10.0
"""Cohesions below are drawn here, at the edge of a logarithmic axis."""

Curves = Mapping[str, Sequence[Mapping[str, Any]]]


def comparison_figure(site: Site, found: Sequence[Comparison], width_m: float, curves: Curves | None = None) -> Figure:
    """Bearing; shear beside terrestrial soils and simulants; shear beside lunar missions; lateral shear.

    Parameters
    ----------
    site, found, width_m : as given to and returned by `compare_site`.
    curves : by aspect (`bearing`, `shear`, `lateral`) the points of `Identification.curves`, drawn with their bands.
    """
    figure = Figure(figsize=(13, 10), layout="constrained")
    (bearing, shear), (missions, lateral) = figure.subplots(2, 2)
    own = curves or {}
    _bearing(bearing, site, found, width_m, own.get("bearing", ()))
    _shear(shear, site, [item for item in found if item.soil.kind != "lunar"], own.get("shear", ()))
    _shear(missions, site, [item for item in found if item.soil.kind == "lunar"], own.get("shear", ()))
    _lateral(lateral, site, own.get("lateral", ()))
    bearing.set_title(f"a  bearing, wheel {1e3 * width_m:.0f} mm wide", fontsize=10, loc="left")
    shear.set_title("b  shear strength beside terrestrial soils and simulants", fontsize=10, loc="left")
    missions.set_title(
        "c  shear strength beside lunar missions; lines span what the source gives", fontsize=10, loc="left"
    )
    lateral.set_title("d  lateral shear", fontsize=10, loc="left")
    for kind in KINDS:
        bearing.plot([], [], MARKERS[kind], color=COLORS[kind], label=kind)
    bearing.plot([], [], "*", color=SITE, markersize=12, label="the site")
    if own:
        bearing.plot([], [], color=CURVE, label="what its wheel states allow, 95 %")
    bearing.legend(frameon=False, fontsize=8, loc="best")
    return figure


def _bearing(axes: Any, site: Site, found: Sequence[Comparison], width_m: float, curve: Sequence[Any]) -> None:
    names = {item.soil.name for item in nearest(found, "bearing")[:NAMED]}
    for item in found:
        soil, stiffness = item.soil, item.soil.stiffness(width_m)
        if soil.sinkage_exponent is not None and stiffness is not None and stiffness > 0:
            axes.plot(soil.sinkage_exponent, stiffness, MARKERS[soil.kind], color=COLORS[soil.kind], markersize=5)
            _name(axes, soil.sinkage_exponent, stiffness, soil.name if soil.name in names else "")
    _law_curve(axes, curve, "exponent", "stiffness_kpa_m_n")
    if site.stiffness_kpa_m_n is not None:
        axes.plot(site.sinkage_exponent, site.stiffness_kpa_m_n, "*", color=SITE, markersize=15)
    axes.set(xlabel="sinkage exponent N [-]", ylabel="stiffness K$_s$ [kPa m$^{-N}$]", yscale="log")


def _shear(axes: Any, site: Site, found: Sequence[Comparison], curve: Sequence[Any]) -> None:
    names = {item.soil.name for item in nearest(found, "strength")[:NAMED]}
    for item in found:
        soil, color = item.soil, COLORS[item.soil.kind]
        cohesion = [max(value, LEAST_PA) for value in soil.cohesion_pa]
        angle = soil.friction_angle_deg
        middle = ((cohesion[0] * cohesion[1]) ** 0.5, sum(angle) / 2)
        axes.plot(cohesion, [middle[1]] * 2, color=color, linewidth=0.8)
        axes.plot([middle[0]] * 2, angle, color=color, linewidth=0.8)
        axes.plot(*middle, MARKERS[soil.kind], color=color, markersize=4)
        _name(axes, *middle, soil.name if soil.name in names else "")
    _law_curve(axes, [point for point in curve if point["cohesion_pa"] >= LEAST_PA], "cohesion_pa", "friction_angle_deg")
    if site.cohesion_pa is not None:
        axes.plot(max(site.cohesion_pa, LEAST_PA), site.friction_angle_deg, "*", color=SITE, markersize=15)
    axes.set(xlabel="cohesion c [Pa], 10 and below at the edge", ylabel="internal friction angle φ [°]", xscale="log")


def _lateral(axes: Any, site: Site, curve: Sequence[Any]) -> None:
    for row in lateral_soils():
        point = float(row["lateral_modulus_mm"]), float(row["external_friction_angle_deg"])
        axes.plot(*point, MARKERS[row["kind"]], color=COLORS[row["kind"]], markersize=5)
        _name(axes, *point, row["name"])
    _law_curve(axes, curve, "lateral_modulus_mm", "external_friction_angle_deg")
    if site.lateral_modulus_mm is not None:
        axes.plot(site.lateral_modulus_mm, site.external_friction_angle_deg, "*", color=SITE, markersize=15)
    axes.set(xlabel="lateral shear modulus K$_y$ [mm]", ylabel="external friction angle φ$_y$ [°]")


def _law_curve(axes: Any, points: Sequence[Mapping[str, Any]], x: str, y: str) -> None:
    solved = [point for point in points if point[y] is not None and point["low"] is not None]
    if solved:
        at = [point[x] for point in solved]
        low, high = ([point[end] for point in solved] for end in ("low", "high"))
        axes.fill_between(at, low, high, color=CURVE, alpha=0.3, linewidth=0)
        axes.plot(at, [point[y] for point in solved], color=CURVE)


def _name(axes: Any, x: float, y: float, label: str) -> None:
    if label:
        lower = len(axes.texts) % 2
        axes.annotate(label, (x, y), xytext=(5, -10 if lower else 5), textcoords="offset points", fontsize=7)
