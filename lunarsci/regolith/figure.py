"""Pictures of wheel forces over slip, and of the three characteristic curves of the regolith.

Picture of a site among reference soils in four panels, as Fig. 4 of Ding et al. (2024).
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.figure import as_label, headline, legend_below, name_points, page, wrapped
from lunarsci.regolith.compare import KINDS, Site, SoilComparison, lateral_soils, nearest
from lunarsci.regolith.forces import WheelForces
from lunarsci.regolith.identify import Identification
from lunarsci.regolith.integrals import ContactForces, forces_by
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.traction import DESIGN_SLIP, Traction
from lunarsci.regolith.wheel import ContactModel, ShearSign, Wheel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = dict(zip(KINDS, ("black", "#0072B2", "#009E73"), strict=True))
MARKERS = dict(zip(KINDS, ("o", "^", "s"), strict=True))
SITE, CURVE = "#D55E00", "#E69F00"
NAMED = 4
"""How many of the nearest soils are named in each panel."""
PARAMETER_LABELS = {
    "stiffness_kpa_m_n": "stiffness K$_s$ [kPa m$^{-N}$]",
    "sinkage_exponent": "sinkage exponent N [-]",
    "sinkage_exponent_slip": "exponent with slip n$_1$ [-]",
    "cohesion_pa": "cohesion c [Pa]",
    "friction_angle_deg": "internal friction angle φ [°]",
    "shear_modulus_mm": "shear modulus K$_x$ [mm]",
    "external_friction_angle_deg": "external friction angle φ$_y$ [°]",
    "lateral_modulus_mm": "lateral shear modulus K$_y$ [mm]",
    "skid_exponent_slip": "fall of the exponent with skid n$_2$ [-]",
    "max_stress_c1": "angle of largest stress c$_1$ [-]",
    "max_stress_c2": "rise of that angle with slip c$_2$ [-]",
    "exit_c3": "exit angle c$_3$ [-]",
    "shearing_radius_ratio": "effective over stated radius [-]",
}
"""A parameter of the soil along an axis, the same in every picture."""
LEAST_PA = 10.0
"""Cohesions below are drawn here, at the edge of a logarithmic axis."""

Curves = Mapping[str, Sequence[Mapping[str, Any]]]
Named = list[tuple[str, float, float]]
"""Names of points to be written, and where these are."""


def comparison_figure(
    site: Site, found: Sequence[SoilComparison], width_m: float, curves: Curves | None = None
) -> "Figure":
    """Bearing; shear beside terrestrial soils and simulants; shear beside lunar missions; lateral shear.

    Parameters
    ----------
    site, found, width_m : as given to and returned by `compare_site`.
    curves : by aspect (`bearing`, `shear`, `lateral`) the points of `Identification.curves`, drawn with their bands.
    """
    figure = page(7.4)
    (bearing, shear), (missions, lateral) = figure.subplots(2, 2)
    own = curves or {}
    named = {bearing: _bearing(bearing, site, found, width_m, own.get("bearing", ()))}
    named[shear] = _shear(shear, site, [item for item in found if item.soil.kind != "lunar"], own.get("shear", ()))
    named[missions] = _shear(
        missions, site, [item for item in found if item.soil.kind == "lunar"], own.get("shear", ())
    )
    named[lateral] = _lateral(lateral, site, own.get("lateral", ()))
    bearing.set_title(f"a  bearing, wheel {1e3 * width_m:.0f} mm wide", loc="left")
    shear.set_title("b  shear, terrestrial soils and simulants", loc="left")
    missions.set_title("c  shear, lunar missions; lines: ranges", loc="left")
    lateral.set_title("d  lateral shear", loc="left")
    for kind in KINDS:
        bearing.plot([], [], MARKERS[kind], color=COLORS[kind], label=kind)
    bearing.plot([], [], "*", color=SITE, markersize=12, label="the site")
    if own:
        bearing.plot([], [], color=CURVE, label="what its wheel states allow, 95 %")
    legend_below(figure, bearing, 5)
    name_points(figure, named, fontsize=7)
    return figure


def _bearing(axes: Any, site: Site, found: Sequence[SoilComparison], width_m: float, curve: Sequence[Any]) -> Named:
    """Soils beside the site; the nearest ones, to be named."""
    named, names = [], {item.soil.name for item in nearest(found, "bearing")[:NAMED]}
    for item in found:
        soil, stiffness = item.soil, item.soil.stiffness(width_m)
        if soil.sinkage_exponent is not None and stiffness is not None and stiffness > 0:
            axes.plot(soil.sinkage_exponent, stiffness, MARKERS[soil.kind], color=COLORS[soil.kind], markersize=5)
            named.append((soil.name, soil.sinkage_exponent, stiffness))
    _law_curve(axes, curve, "exponent", "stiffness_kpa_m_n")
    if site.stiffness_kpa_m_n is not None:
        axes.plot(site.sinkage_exponent, site.stiffness_kpa_m_n, "*", color=SITE, markersize=15)
    axes.set(xlabel=PARAMETER_LABELS["sinkage_exponent"], ylabel=PARAMETER_LABELS["stiffness_kpa_m_n"], yscale="log")
    axes.margins(x=0.16)
    return [(_named(name), x, y) for name, x, y in named if name in names]


def _shear(axes: Any, site: Site, found: Sequence[SoilComparison], curve: Sequence[Any]) -> Named:
    """The same of shear."""
    named, names = [], {item.soil.name for item in nearest(found, "strength")[:NAMED]}
    for item in found:
        soil, color = item.soil, COLORS[item.soil.kind]
        cohesion = [max(value, LEAST_PA) for value in soil.cohesion_pa]
        angle = soil.friction_angle_deg
        middle = ((cohesion[0] * cohesion[1]) ** 0.5, sum(angle) / 2)
        axes.plot(cohesion, [middle[1]] * 2, color=color, linewidth=0.8)
        axes.plot([middle[0]] * 2, angle, color=color, linewidth=0.8)
        axes.plot(*middle, MARKERS[soil.kind], color=color, markersize=4)
        named.append((soil.name, *middle))
    _law_curve(
        axes, [point for point in curve if point["cohesion_pa"] >= LEAST_PA], "cohesion_pa", "friction_angle_deg"
    )
    if site.cohesion_pa is not None:
        axes.plot(max(site.cohesion_pa, LEAST_PA), site.friction_angle_deg, "*", color=SITE, markersize=15)
    axes.set(
        xlabel="cohesion c [Pa], 10 and below at the edge", ylabel=PARAMETER_LABELS["friction_angle_deg"], xscale="log"
    )
    axes.margins(x=0.16)
    return [(_named(name), x, y) for name, x, y in named if name in names]


def _lateral(axes: Any, site: Site, curve: Sequence[Any]) -> Named:
    named = []
    for row in lateral_soils():
        point = float(row["lateral_modulus_mm"]), float(row["external_friction_angle_deg"])
        axes.plot(*point, MARKERS[row["kind"]], color=COLORS[row["kind"]], markersize=5)
        named.append((_named(row["name"]), *point))
    _law_curve(axes, curve, "lateral_modulus_mm", "external_friction_angle_deg")
    if site.lateral_modulus_mm is not None:
        axes.plot(site.lateral_modulus_mm, site.external_friction_angle_deg, "*", color=SITE, markersize=15)
    axes.set(xlabel=PARAMETER_LABELS["lateral_modulus_mm"], ylabel=PARAMETER_LABELS["external_friction_angle_deg"])
    axes.margins(x=0.16)
    return named


def _named(soil: str) -> str:
    """The name of a soil in short lines."""
    return "\n".join(textwrap.wrap(as_label(soil, 52).replace(" %", "\u00a0%"), 28)).replace("K_y", "K$_y$")


def _law_curve(axes: Any, points: Sequence[Mapping[str, Any]], x: str, y: str) -> None:
    solved = [point for point in points if point[y] is not None and point["low"] is not None]
    if solved:
        at = [point[x] for point in solved]
        low, high = ([point[end] for point in solved] for end in ("low", "high"))
        axes.fill_between(at, low, high, color=CURVE, alpha=0.3, linewidth=0)
        axes.plot(at, [point[y] for point in solved], color=CURVE)


BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"
TYPICAL_BEARING = (1.0, 820.0)
TYPICAL_SHEAR = (520.0, 42.0)
"""Typical lunar N, K_s and c, phi, as drawn by Ding et al. (2024), Fig. 4, 10.1038/s41467-024-46233-8."""


def forces_over_slip(
    wheel: Wheel,
    soil: Soil,
    sinkage_m: float,
    slip_ratio: float | Sequence[float],
    side_slip_deg: float,
    reading: ShearSign,
    model: ContactModel | None = None,
) -> "Figure":
    """Normal force, drawbar pull and lateral force against slip at one sinkage, with the asked states marked."""

    def forces(slip: Any) -> WheelForces | ContactForces:
        return forces_by(model, wheel, soil, sinkage_m, slip, side_slip_deg, reading)

    slip = np.linspace(-0.6, 0.6, 241)
    curves, here = forces(slip), forces(slip_ratio)
    figure = page(3.8, 5.2)
    axes = figure.subplots()
    for name, label, color, dashes in (
        ("normal_force_n", "normal force F$_N$", "black", "-"),
        ("drawbar_pull_n", "drawbar pull F$_{DP}$", BLUE, "--"),
        ("lateral_force_n", f"lateral force F$_L$ at {side_slip_deg:g}° side slip", ORANGE, "-."),
    ):
        axes.plot(slip, getattr(curves, name), color=color, linestyle=dashes, label=label)
        axes.plot(slip_ratio, getattr(here, name), "o", color=color)
    axes.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    axes.axvline(0, color="0.8", linewidth=0.8, zorder=0)
    axes.set(xlabel="slip ratio s [-]  (negative: skid)", ylabel="force on the wheel [N]")
    form = f"exact integrals, {model.shear} shear" if model else "closed form"
    axes.set_title(wrapped(f"sinkage {1e3 * sinkage_m:.1f} mm, {form}, reading '{reading}'", 4.4))
    legend_below(figure, axes, 3)
    return figure


def traction_over_slip(rows: Sequence[Mapping[str, Any]], found: Traction, load_n: float) -> "Figure":
    """Pull per weight and tractive efficiency over slip, above; torque and sinkage below; 20 % slip marked."""
    figure = page(5.4, 5.2)
    pull, effort = figure.subplots(2, 1, sharex=True)
    slip = [row["slip_ratio"] for row in rows]
    for axes, name, factor, color, dashes, label in (
        (pull, "pull_per_weight", 1.0, BLUE, "-", "pull per weight"),
        (pull, "tractive_efficiency", 1.0, ORANGE, "--", "tractive efficiency"),
        (effort, "resistance_torque_nm", 1.0, "black", "-", "resistance torque M$_R$ [N m]"),
        (effort.twinx(), "sinkage_m", 1e3, GREEN, "-.", "sinkage z [mm]"),
    ):
        values = [np.nan if row[name] is None else factor * row[name] for row in rows]
        axes.plot(slip, values, color=color, linestyle=dashes, label=label.partition(" [")[0])
        if axes is not pull:
            axes.spines["right"].set_visible(axes is not effort)
            axes.set_ylabel(label, color=color)
            axes.tick_params(axis="y", colors=color)
    pull.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    pull.axvline(DESIGN_SLIP, color="0.8", linewidth=0.8, zorder=0)
    pull.plot(DESIGN_SLIP, found.pull_per_weight_at_20, "o", color=BLUE)
    pull.set_ylabel("pull per weight, efficiency [-]")
    legend_below(figure, figure.axes, 4)
    slope = "none" if found.slope_at_20_deg is None else f"{found.slope_at_20_deg:.1f}°"
    pull.set_title(wrapped(f"load {load_n:g} N; at 20 % slip: pull {found.pull_at_20_n:.2f} N, slope {slope}", 4.4))
    effort.set_xlabel("slip ratio [-]  (negative: skid)")
    return figure


def characteristic_curves(found: Identification, *, synthetic: bool = False) -> "Figure":
    """The pairs (N, K_s), (c, phi), (K_y, phi_y) that the states allow, with 95 % bands, one panel per aspect."""
    figure = page(3.6)
    bearing, shear, lateral = figure.subplots(1, 3)
    _curve(bearing, found.curves["bearing"], "exponent", "stiffness_kpa_m_n")
    _axes_of(bearing, "bearing", "sinkage_exponent", "stiffness_kpa_m_n")
    bearing.set_yscale("log")
    _curve(shear, found.curves["shear"], "cohesion_pa", "friction_angle_deg")
    _axes_of(shear, "longitudinal shear", "cohesion_pa", "friction_angle_deg")
    _curve(lateral, found.curves["lateral"], "lateral_modulus_mm", "external_friction_angle_deg")
    _axes_of(lateral, "lateral shear", "lateral_modulus_mm", "external_friction_angle_deg")
    for axes, typical in ((bearing, TYPICAL_BEARING), (shear, TYPICAL_SHEAR)):
        if axes.lines:
            axes.plot(*typical, "s", color=GREEN, label="typical lunar")
    _mark(bearing, found, "exponent", "stiffness_kpa_m_n")
    _mark(shear, found, "cohesion_pa", "friction_angle_deg")
    for corner in found.corners:
        angle = corner["external_friction_angle_deg"]
        if angle.value is not None:
            lateral.errorbar(corner["lateral_modulus_mm"], angle.value, angle.sigma, fmt="o", color=ORANGE)
    legend_below(figure, (bearing, shear, lateral))
    states = "1 wheel state" if len(found.observations) == 1 else f"{len(found.observations)} wheel states"
    title = f"{states}, reading '{found.reading}': each point of a curve explains the forces"
    headline(figure, title, synthetic=synthetic)
    return figure


def _axes_of(axes: Any, title: str, x: str, y: str) -> None:
    axes.set(title=title, xlabel=PARAMETER_LABELS[x], ylabel=PARAMETER_LABELS[y])


def _curve(axes: Any, points: list[dict[str, Any]], x: str, y: str) -> None:
    solved = [point for point in points if point[y] is not None]
    if not solved:
        axes.text(0.5, 0.5, "not determined by these states", ha="center", transform=axes.transAxes, color="0.4")
        return
    at = [point[x] for point in solved]
    axes.fill_between(
        at, [p["low"] for p in solved], [p["high"] for p in solved], color=BLUE, alpha=0.2, label="95 % of the draws"
    )
    axes.plot(at, [point[y] for point in solved], color=BLUE, label="at the measured states")


def _mark(axes: Any, found: Identification, x: str, y: str) -> None:
    """Each solved value at the assumed value of its partner, with its standard deviation."""
    for solved, partner in ((y, x), (x, y)):
        estimate, given = found.site[solved], getattr(found.assumptions, partner)
        if estimate.assumed or estimate.value is None or given is None:
            continue
        at = (
            (given, estimate.value, estimate.sigma, None)
            if solved == y
            else (estimate.value, given, None, estimate.sigma)
        )
        axes.errorbar(
            *at, fmt=SOLVED[partner], color=ORANGE, capsize=3, label=f"solved at {_short(partner)} = {given:g}"
        )


SOLVED = {"exponent": "o", "stiffness_kpa_m_n": "v", "cohesion_pa": "D", "friction_angle_deg": "^"}
"""Marker of what was solved, by what was given."""


def _short(name: str) -> str:
    return {"exponent": "N", "stiffness_kpa_m_n": "K$_s$", "cohesion_pa": "c", "friction_angle_deg": "φ"}[name]
