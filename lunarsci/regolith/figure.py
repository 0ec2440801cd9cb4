"""Pictures of wheel forces over slip, and of the three characteristic curves of the regolith.

Picture of a site among reference soils in four panels, as Fig. 4 of Ding et al. (2024). Pictures of what is believed of
a soil: each parameter before any drive and now, and after each drive.
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from lunarsci.arrays import FloatArray
from lunarsci.figure import (
    AMBER,
    BLUE,
    GREEN,
    INK,
    VERMILION,
    as_label,
    headline,
    legend_below,
    name_points,
    page,
    wrapped,
)
from lunarsci.regolith.belief import SoilBelief, past_beliefs, rolled_back, shared_drives
from lunarsci.regolith.compare import ASPECTS, KINDS, SITE_NAMES, Site, SoilComparison, lateral_soils, nearest
from lunarsci.regolith.forces import WheelForces
from lunarsci.regolith.identify import Identification
from lunarsci.regolith.integrals import ContactForces, forces_by
from lunarsci.regolith.prior import NINETY_FIVE, PARAMETERS, Law
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.traction import DESIGN_SLIP, Traction
from lunarsci.regolith.wheel import ContactModel, ShearSign, Wheel

COLORS = dict(zip(KINDS, ("black", BLUE, GREEN), strict=True))
MARKERS = dict(zip(KINDS, ("o", "^", "s"), strict=True))
SITE, CURVE = VERMILION, AMBER
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
    site: Site, soils: Sequence[SoilComparison], width_m: float, curves: Curves | None = None
) -> Figure:
    """Bearing; shear beside terrestrial soils and simulants; shear beside lunar missions; lateral shear.

    Parameters
    ----------
    site, soils, width_m : as given to and returned by `compare_site`.
    curves : by aspect (`bearing`, `shear`, `lateral`) the points of `Identification.curves`, drawn with their bands.
    """
    figure = page(7.4)
    (bearing, shear), (missions, lateral) = figure.subplots(2, 2)
    bearings, shears, laterals = ((curves or {}).get(aspect, ()) for aspect in ASPECTS)
    lunar = [item for item in soils if item.soil.kind == "lunar"]
    named = {bearing: _bearing(bearing, site, soils, width_m, bearings)}
    named[shear] = _shear(shear, site, [item for item in soils if item not in lunar], shears)
    named[missions] = _shear(missions, site, lunar, shears)
    named[lateral] = _lateral(lateral, site, laterals)
    bearing.set_title(f"a  bearing, wheel {1e3 * width_m:.0f} mm wide", loc="left")
    shear.set_title("b  shear, terrestrial soils and simulants", loc="left")
    missions.set_title("c  shear, lunar missions; lines: ranges", loc="left")
    lateral.set_title("d  lateral shear", loc="left")
    for kind in KINDS:
        bearing.plot([], [], MARKERS[kind], color=COLORS[kind], label=kind)
    bearing.plot([], [], "*", color=SITE, markersize=12, label="the site")
    if curves:
        bearing.plot([], [], color=CURVE, label="what its wheel states allow, 95 %")
    legend_below(figure, bearing, 5)
    name_points(figure, named, fontsize=7)
    return figure


def _bearing(axes: Any, site: Site, soils: Sequence[SoilComparison], width_m: float, curve: Sequence[Any]) -> Named:
    """Soils beside the site; the nearest ones, to be named."""
    named, names = [], {item.soil.name for item in nearest(soils, "bearing")[:NAMED]}
    for item in soils:
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


def _shear(axes: Any, site: Site, soils: Sequence[SoilComparison], curve: Sequence[Any]) -> Named:
    """The same of shear."""
    named, names = [], {item.soil.name for item in nearest(soils, "strength")[:NAMED]}
    for item in soils:
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


CHARACTERISTIC = (
    ("bearing", "bearing", "exponent", "stiffness_kpa_m_n"),
    ("shear", "longitudinal shear", "cohesion_pa", "friction_angle_deg"),
    ("lateral", "lateral shear", "lateral_modulus_mm", "external_friction_angle_deg"),
)
"""Aspect, its title, and its pair of parameters as single states name them."""
SOLVED = {
    "exponent": ("N", "o"),
    "stiffness_kpa_m_n": ("K$_s$", "v"),
    "cohesion_pa": ("c", "D"),
    "friction_angle_deg": ("φ", "^"),
}
"""Symbol of what was given, and marker of what was solved with it."""


def forces_over_slip(
    wheel: Wheel,
    soil: Soil,
    sinkage_m: float,
    slip_ratio: float | Sequence[float],
    side_slip_deg: float,
    reading: ShearSign,
    model: ContactModel | None = None,
) -> Figure:
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
        ("lateral_force_n", f"lateral force F$_L$ at {side_slip_deg:g}° side slip", VERMILION, "-."),
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


def traction_over_slip(rows: Sequence[Mapping[str, Any]], figures: Traction, load_n: float) -> Figure:
    """Pull per weight and tractive efficiency over slip, above; torque and sinkage below; 20 % slip marked."""
    figure = page(5.4, 5.2)
    pull, effort = figure.subplots(2, 1, sharex=True)
    slip = [row["slip_ratio"] for row in rows]
    for axes, name, factor, color, dashes, label in (
        (pull, "pull_per_weight", 1.0, BLUE, "-", "pull per weight"),
        (pull, "tractive_efficiency", 1.0, VERMILION, "--", "tractive efficiency"),
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
    pull.plot(DESIGN_SLIP, figures.pull_per_weight_at_20, "o", color=BLUE)
    pull.set_ylabel("pull per weight, efficiency [-]")
    legend_below(figure, figure.axes, 4)
    slope = "none" if figures.slope_at_20_deg is None else f"{figures.slope_at_20_deg:.1f}°"
    pull.set_title(wrapped(f"load {load_n:g} N; at 20 % slip: pull {figures.pull_at_20_n:.2f} N, slope {slope}", 4.4))
    effort.set_xlabel("slip ratio [-]  (negative: skid)")
    return figure


def characteristic_curves(result: Identification, *, synthetic: bool = False) -> Figure:
    """The pairs (N, K_s), (c, phi), (K_y, phi_y) that the states allow, with 95 % bands, one panel per aspect."""
    figure = page(3.6)
    bearing, shear, lateral = figure.subplots(1, 3)
    for axes, (aspect, title, x, y) in zip((bearing, shear, lateral), CHARACTERISTIC, strict=True):
        _curve(axes, result.curves[aspect], x, y)
        axes.set(title=title, xlabel=PARAMETER_LABELS[SITE_NAMES[x]], ylabel=PARAMETER_LABELS[y])
    bearing.set_yscale("log")
    for axes, typical in ((bearing, (1.0, 820.0)), (shear, (520.0, 42.0))):  # Fig. 4 of Ding et al. (2024)
        if axes.lines:
            axes.plot(*typical, "s", color=GREEN, label="typical lunar")
    _mark(bearing, result, "exponent", "stiffness_kpa_m_n")
    _mark(shear, result, "cohesion_pa", "friction_angle_deg")
    for corner in result.corners:
        angle = corner["external_friction_angle_deg"]
        if angle.value is not None:
            lateral.errorbar(corner["lateral_modulus_mm"], angle.value, angle.sigma, fmt="o", color=VERMILION)
    legend_below(figure, (bearing, shear, lateral))
    states = "1 wheel state" if len(result.observations) == 1 else f"{len(result.observations)} wheel states"
    title = f"{states}, reading '{result.reading}': each point of a curve explains the forces"
    headline(figure, title, synthetic=synthetic)
    return figure


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


def _mark(axes: Any, result: Identification, x: str, y: str) -> None:
    """Each solved value at the assumed value of its partner, with its standard deviation."""
    for solved, partner in ((y, x), (x, y)):
        estimate, given = result.site[solved], getattr(result.assumptions, partner)
        if estimate.assumed or estimate.value is None or given is None:
            continue
        at, spread = (given, estimate.value), (estimate.sigma, None)
        symbol, marker = SOLVED[partner]
        ends = (*at, *spread) if solved == y else (*at[::-1], *spread[::-1])
        axes.errorbar(*ends, fmt=marker, color=VERMILION, capsize=3, label=f"solved at {symbol} = {given:g}")


FIRST, SECOND, REFUSED = BLUE, VERMILION, INK


def belief_history_figure(
    belief: SoilBelief,
    title: str,
    other: SoilBelief | None = None,
    names: tuple[str, str] = ("", ""),
    *,
    synthetic: bool = False,
) -> Figure:
    """One panel for each parameter; a second belief beside the first where there is one.

    Bars are 68 %; the band is the interval of the priors. Drives from which nothing was learned are crossed. What two
    beliefs share is drawn once, as the first's. States that a file did not keep are left out.
    """
    figure = page(8.2)
    panels: Any = figure.subplots(4, 2, sharex=True)
    most = max(len(belief.history), len(other.history) if other else 0)
    first = 0 if other is None else shared_drives(belief, other) + 1
    for panel, name in zip(panels.ravel(), PARAMETERS, strict=True):
        _, low, high = rolled_back(belief, 0).intervals()[name]
        panel.axhspan(low, high, color=INK, alpha=0.08, linewidth=0, label="the priors")
        _draw(panel, belief, name, (FIRST, "o-"), -0.0 if other is None else -0.08, names[0] or "median and 68 %", 0)
        if other is not None:
            _draw(panel, other, name, (SECOND, "s--"), 0.08, names[1], min(first, len(other.history)))
        panel.set_ylabel(PARAMETER_LABELS[name].replace(" [", "\n["))
        panel.grid()
        panel.set_xticks(range(0, most + 1, max(1, -(-most // 8))))
        panel.set_xlim(-0.4, most + 0.4)
    for panel in panels[-1]:
        panel.set_xlabel("after drive [-]")
    legend_below(figure, panels.ravel())
    headline(figure, title, synthetic=synthetic)
    return figure


def _draw(
    panel: Any, belief: SoilBelief, name: str, style: tuple[str, str], shift: float, label: str, first: int
) -> None:
    states = {k: state.intervals()[name] for k, state in enumerate(past_beliefs(belief)) if state and k >= first}
    drives, ends = np.array([*states], float), np.array([*states.values()]).reshape(-1, 3).T
    look: Any = {"color": style[0], "markersize": 4, "linewidth": 1.2, "capsize": 3, "elinewidth": 1.4}
    spread = [ends[0] - ends[1], ends[2] - ends[0]]
    panel.errorbar(drives + shift, ends[0], spread, fmt=style[1], label=label, **look)
    lost = np.array([bool(k and belief.history[k - 1].get("refused")) for k in states], bool)
    if lost.any():
        look = {"color": REFUSED, "markersize": 8, "zorder": 5, "label": "nothing was learned"}
        panel.plot(drives[lost] + shift, ends[0][lost], "x", **look)


SOILS = 512
"""Drawn of a belief for its density; where it holds a population, that in turn."""


def belief_figure(belief: SoilBelief, title: str, *, synthetic: bool = False) -> Figure:
    """What a belief says of the soil: each parameter before any drive and now, as the posterior of `infer`.

    Intervals are those of `SoilBelief.intervals`, the density that of its soils.
    """
    center, width = (np.array([getattr(law, what) for law in belief.laws.values()]) for what in ("center", "width"))
    lines = [belief.mean + k * belief.sd for k in (0.0, -1.0, 1.0, -NINETY_FIVE, NINETY_FIVE)]
    lines += [center + k * width for k in (-NINETY_FIVE, NINETY_FIVE)]
    keys = ("median", "low68", "high68", "low95", "high95", "prior_low95", "prior_high95")
    columns = belief.samples(np.stack(lines)).values()
    rows = [
        {"parameter": name, **dict(zip(keys, column, strict=True)), "shrinkage": 1.0 - left, "determined": False}
        for (name, left), column in zip(belief.sd_ratio.items(), columns, strict=True)
    ]
    soils = belief.draws(SOILS)
    title = f"{title}, doubtful" if belief.doubt else title
    draws = np.stack(list(soils.values()), axis=1)
    return posterior_figure(rows, belief.laws, draws, title, synthetic=synthetic)


def posterior_figure(
    rows: Sequence[Mapping[str, Any]],
    prior: Mapping[str, Law],
    draws: FloatArray,
    title: str,
    *,
    synthetic: bool = False,
) -> Figure:
    """Prior and posterior density of each parameter; bars are the 68 and 95 % intervals of the posterior.

    Parameters
    ----------
    rows, prior, draws : of a `SoilPosterior`.
    synthetic : whether the states are made up.

    Draws that are all one value have no density: their median and interval alone are drawn.
    """
    from scipy.stats import gaussian_kde

    figure = page(1.9 * -(-len(rows) // 2))
    panels: Any = figure.subplots(-(-len(rows) // 2), 2)
    for k, (panel, row) in enumerate(zip(panels.ravel(), rows, strict=True)):
        name, law = row["parameter"], prior[row["parameter"]]
        ends = law.transformed(np.array([[row[f"{of}low95"], row[f"{of}high95"]] for of in ("prior_", "")]))
        at = np.linspace(ends.min() - 0.25 * np.ptp(ends), ends.max() + 0.25 * np.ptp(ends), 400)
        before = np.exp(-0.5 * ((at - law.center) / law.width) ** 2) / (law.width * np.sqrt(2 * np.pi))
        drawn = law.transformed(draws[:, k])
        after = gaussian_kde(drawn)(at) if np.ptp(drawn) > 0 else np.full(at.size, np.nan)
        values = law.back(at)
        panel.fill_between(values, before, color=INK, alpha=0.15, linewidth=0, label="prior")
        panel.plot(values, after, color=FIRST, label="posterior")
        foot = -0.07 * float(np.nanmax([after, before]))
        panel.plot([row["low95"], row["high95"]], [foot] * 2, color=FIRST, linewidth=2, label="95 %")
        panel.plot([row["low68"], row["high68"]], [foot] * 2, color=FIRST, linewidth=4, label="68 %")
        panel.plot(row["median"], foot, "o", color=SECOND, markersize=4, label="median")
        panel.set_xlabel(PARAMETER_LABELS[name])
        panel.set_yticks([])
        panel.spines["left"].set_visible(False)
        if law.of == "ln":
            panel.set_xscale("log")
            wide = values.max() > 8.0 * values.min()
            panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if wide else (1, 1.5, 2, 3, 5, 7)))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.xaxis.set_minor_formatter("")
        left = f"{100 * (1 - row['shrinkage']):.0f} % of the prior's width"
        panel.set_title("determined" if row["determined"] else left, loc="left")
    legend_below(figure, panels.ravel()[:1], 5)
    headline(figure, title, synthetic=synthetic)
    return figure
