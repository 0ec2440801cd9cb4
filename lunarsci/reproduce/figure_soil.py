"""Figures 4 and S13 of Ding et al. (2024): regions of the soil parameters, and Monte Carlo histograms.

Monte Carlo draws behind the published standard deviations, as the histograms of Ding et al. (2024), Fig. S13.
"""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lunarsci.arrays import FloatArray
from lunarsci.figure import BLUE, GREEN, INK, PINK, VERMILION, headline, name_points, page
from lunarsci.regolith import inversion
from lunarsci.regolith.compare import ReferenceSoil, lateral_soils, reference_soils
from lunarsci.regolith.forces import closed_form_forces, shear_sign_code
from lunarsci.regolith.identify import DRAWS
from lunarsci.regolith.states import COLUMNS, MeasurementErrors
from lunarsci.regolith.wheel import Wheel
from lunarsci.reproduce.numbers import published_value
from lunarsci.reproduce.soil import (
    BEARING_DOTS,
    COHESION_PA,
    CORNER,
    LATERAL_CORNERS,
    MEAN_SINKAGE_M,
    PHI_DEG,
    SIDE_SLIPS_DEG,
    SLIP,
    STIFFNESS,
    TYPICAL,
    identified,
    published_soil,
    stand_in_forces,
)

SHEAR_MODULUS_M = 0.0178


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Draws of a quantity, with the ids of its published mean and standard deviation, a label with its unit, and that
    of its density."""

    label: str
    per: str
    mean_id: str
    sd_id: str
    draws: FloatArray


def histograms(wheel: Wheel, draws: int = DRAWS, seed: int = 0) -> tuple[Histogram, Histogram, Histogram]:
    """N at 5 mm and K_s = 1443, K_s at 15 mm and N = 1, phi at c = 520 Pa and a slip ratio of -0.075.

    Parameters
    ----------
    wheel : its lug height is not published and moves the last two a little.
    draws : Monte Carlo sample size, 2 or more; the paper's 1024 by default. [-]
    seed : of the random numbers, >= 0.

    Draws without a solution are left out. Errors are those of `MeasurementErrors`, for phi without the sinkage's.
    """
    rng = np.random.default_rng(seed)

    def stresses(sinkage_m: float, errors: MeasurementErrors, reading: str) -> FloatArray:
        forces = stand_in_forces(wheel)
        nominal = (sinkage_m, SLIP, np.nan, float(forces.normal_force_n), float(forces.drawbar_pull_n), np.nan)
        values = np.array([nominal])
        sigmas = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
        sample = values + sigmas * rng.standard_normal((draws, len(COLUMNS)))
        return np.asarray(inversion.invert_states(sample, wheel.vector(), SHEAR_MODULUS_M, shear_sign_code(reading)))

    shallow = stresses(0.005, MeasurementErrors(), "signed")
    deep = stresses(0.015, MeasurementErrors(), "signed")
    sheared = stresses(MEAN_SINKAGE_M, MeasurementErrors(sinkage_m=0.0), "slip-branch")
    with np.errstate(all="ignore"):
        exponent = inversion.sinkage_exponent(shallow[:, 0], shallow[:, 3], STIFFNESS)
        stiffness = inversion.stiffness(deep[:, 0], deep[:, 3], 1.0)
        angle = inversion.friction_angle(sheared[:, 0], sheared[:, 1], sheared[:, 4], COHESION_PA)
    return (
        _histogram("sinkage exponent N at 5 mm [-]", "-", "exponent-5mm", "exponent-sd", exponent),
        _histogram(
            "stiffness K$_s$ at 15 mm [kPa m$^{-N}$]", "m$^N$/kPa", "stiffness-15mm", "stiffness-sd-15mm", stiffness
        ),
        _histogram("friction angle φ at 520 Pa [°]", "1/°", "friction-angle", "friction-angle-sd", angle),
    )


def _histogram(label: str, per: str, mean_id: str, sd_id: str, values: FloatArray) -> Histogram:
    return Histogram(label, per, mean_id, sd_id, values[np.isfinite(values)])


Named = list[tuple[str, float, float]]

REGION, DOT, TYPICAL_COLOR, GREY = "#f6c592", VERMILION, GREEN, "0.35"
CURVES: Any = ({"color": BLUE}, {"color": VERMILION, "linestyle": "--"}, {"color": PINK, "linestyle": ":"},
               {"color": "#000000", "linestyle": (0, (7, 2))})  # fmt: skip
PROGRAMMES = {"Surveyor": BLUE, "Luna": VERMILION, "Apollo": INK}
MARKERS = "os^Dv<>Php*"
SINKAGES_MM = (5.0, 8.0, 12.0, 15.0)
LONGJI = ("Longji", "lunar soil, nominal")
"""Rows of the tables of soils that are what is compared."""


def soil_pages(wheel: Wheel) -> Iterator[Figure]:
    """Three pages: panels a, b and d of Fig. 4; panel c, whose missions are many; and the histograms of Fig. S13."""
    title = "Soil parameters at Longji after Fig. 4 of Ding et al. (2024)"
    figure = page(8.4)
    parts: Any = figure.subfigures(2, 1, height_ratios=(5.4, 2.8))
    (bearing, shear), lateral = parts[0].subplots(1, 2), parts[1].subplots()
    named = {bearing: _bearing_panel(bearing, wheel), shear: _shear_panel(shear, wheel)}
    _lateral_panel(lateral, wheel)
    for axes in (bearing, shear):
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False)
    parts[1].legend(loc="outside right center", frameon=False)
    headline(figure, title)
    name_points(figure, named, fontsize=7)
    yield figure
    figure = page(4.6)
    _missions(figure.subplots())
    figure.legend(loc="outside right center", frameon=False)
    headline(figure, title)
    yield figure
    yield _histograms(wheel)


def _region(axes: Axes, x: Sequence[float], y: Sequence[float], dots: Sequence[tuple[float, float]]) -> None:
    """The published rectangle and its dots."""
    corner, size = (min(x), min(y)), (max(x) - min(x), max(y) - min(y))
    axes.add_patch(Rectangle(corner, *size, facecolor=REGION, alpha=0.55, zorder=1, label="published region"))
    axes.plot(*np.transpose(dots), "o", color=DOT, markersize=6, zorder=6, label="published dots")


def _finish(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid()


def _typical(axes: Axes, x: float, y: float, label: str) -> None:
    look: dict[str, Any] = {"color": TYPICAL_COLOR, "linestyle": "-.", "linewidth": 1.1, "zorder": 2}
    axes.axvline(x, **look)
    axes.axhline(y, label=label, **look)


def _bearing_panel(axes: Axes, wheel: Wheel) -> Named:
    """Pairs (N, K_s) that carry the load at each sinkage; returns the soils to be named."""
    named: Named = []
    stiffness = [dot[0] for dot in BEARING_DOTS]
    exponent = [dot[1] for dot in BEARING_DOTS]
    _region(axes, exponent, stiffness, list(zip(exponent, stiffness, strict=True)))
    for sinkage_mm, look in zip(SINKAGES_MM, CURVES, strict=True):
        points = identified(wheel, 1e-3 * sinkage_mm).curves["bearing"]
        axes.plot(*_xy(points, "exponent", "stiffness_kpa_m_n"), label=f"z = {sinkage_mm:g} mm", **look)
    _typical(axes, 1.0, TYPICAL, f"typical of the Moon: N = 1, K$_s$ = {TYPICAL:g}")
    for soil in _others("terrestrial"):
        value = soil.stiffness(wheel.width_m)
        if soil.sinkage_exponent is not None and value is not None:
            axes.plot(soil.sinkage_exponent, value, "k.", markersize=7)
            named.append((_short(soil.name), soil.sinkage_exponent, value))
    axes.plot([], [], "k.", markersize=7, label="terrestrial soils")
    axes.set(yscale="log", xlim=(0.35, 1.5), ylim=(150, 1e4))
    force = float(stand_in_forces(wheel).normal_force_n)
    _finish(
        axes, f"a  bearing, F$_N$ = {force:.1f} N a wheel", "sinkage exponent N [-]", "stiffness K$_s$ [kPa m$^{-N}$]"
    )
    return named


def _xy(points: Sequence[Mapping[str, Any]], x: str, y: str) -> tuple[list[float], list[float]]:
    solved = [point for point in points if point[y] is not None]
    return [point[x] for point in solved], [point[y] for point in solved]


def _others(kind: str) -> list[ReferenceSoil]:
    return [soil for soil in reference_soils() if soil.kind == kind and not _is_longji(soil.name)]


def _is_longji(soil: str) -> bool:
    return any(name in soil for name in LONGJI)


def _short(name: str) -> str:
    """Water by weight is in the names of most."""
    return "\n".join(textwrap.wrap(name.replace(" % water", "\u00a0%"), 22))


def _shear_panel(axes: Axes, wheel: Wheel) -> Named:
    """Pairs (c, phi) of both curves with a published point, each with the drawbar pull that puts it there."""
    named: Named = []
    corners = ((COHESION_PA, PHI_DEG, SLIP), (CORNER[1], CORNER[0], -1e-6))
    _region(axes, [COHESION_PA, CORNER[1]], [PHI_DEG, CORNER[0]], [(c, phi) for c, phi, _ in corners])
    for (cohesion, phi, slip), look in zip(corners, CURVES, strict=False):
        pull, x, y = _shear_curve(wheel, cohesion, phi, slip)
        name = f"s = {slip:g}" if slip < -1e-3 else "s → 0, skid"
        axes.plot(x, y, label=f"{name}, F$_{{DP}}$ = {pull:.2f} N (sets the dot)", **look)
    _typical(axes, COHESION_PA, CORNER[0], f"typical of the Moon: c = {COHESION_PA:g} Pa, φ = {CORNER[0]:g}°")
    for soil in _others("terrestrial"):
        if soil.cohesion_pa[0] < 11_000:
            axes.plot(soil.cohesion_pa[0], soil.friction_angle_deg[0], "k.", markersize=7)
            named.append((_short(soil.name), soil.cohesion_pa[0], soil.friction_angle_deg[0]))
    axes.plot([], [], "k.", markersize=7, label="terrestrial soils")
    axes.set(xlim=(0, 11_000), ylim=(0, 60))
    title = "b  longitudinal shear, slip branch of the law at |s|"
    _finish(axes, title, "cohesion c [Pa]", "internal friction angle φ [°]")
    return named


def _shear_curve(wheel: Wheel, cohesion: float, phi: float, slip: float) -> tuple[float, Any, Any]:
    """Drawbar pull [N] of a soil at the mean sinkage, and the pairs (c [Pa], phi [deg]) that have the same one."""
    forces = closed_form_forces(
        wheel, published_soil(cohesion=cohesion, phi=phi), MEAN_SINKAGE_M, slip, reading="slip-branch"
    )
    pull = float(forces.drawbar_pull_n)
    state = np.array([[MEAN_SINKAGE_M, slip, np.nan, float(forces.normal_force_n), pull, np.nan]])
    solved = inversion.invert_states(state, wheel.vector(), SHEAR_MODULUS_M, shear_sign_code("slip-branch"))[0]
    x = np.linspace(0.0, 11_000.0, 441)
    with np.errstate(all="ignore"):
        return pull, x, inversion.friction_angle(solved[0], solved[1], solved[4], x)


def _missions(axes: Axes) -> None:
    """Ranges of other missions, each with a marker of its own: colours are programmes."""
    _region(axes, [COHESION_PA, CORNER[1]], [PHI_DEG, CORNER[0]], [(COHESION_PA, PHI_DEG), (CORNER[1], CORNER[0])])
    for number, soil in enumerate(_others("lunar")):
        x, y = np.mean(soil.cohesion_pa), np.mean(soil.friction_angle_deg)
        error = (np.ptp(soil.cohesion_pa) / 2, np.ptp(soil.friction_angle_deg) / 2)
        color = next((shade for name, shade in PROGRAMMES.items() if soil.name.startswith(name)), GREY)
        axes.errorbar(
            x, y, xerr=error[0], yerr=error[1], fmt=MARKERS[number % len(MARKERS)], color=color, markersize=5,
            markerfacecolor="white" if number // len(MARKERS) % 2 else color, capsize=1.5, linewidth=0.8,
            label=soil.name,
        )  # fmt: skip
    axes.set(xlim=(-100, 6200), ylim=(10, 65), yticks=range(10, 61, 10))
    title = "c  shear beside other missions; bars: what is given"
    _finish(axes, title, "cohesion c [Pa]", "internal friction angle φ [°]")


def _lateral_panel(axes: Axes, wheel: Wheel) -> None:
    """Pairs (K_y, phi_y) at both ends of the side slip, each with the lateral force that puts it through its dot."""
    moduli, angles = zip(*LATERAL_CORNERS, strict=True)
    _region(axes, moduli, angles, LATERAL_CORNERS)
    for (modulus, angle), beta, look in zip(LATERAL_CORNERS, reversed(SIDE_SLIPS_DEG), CURVES, strict=False):
        force, x, y = _lateral_curve(wheel, modulus, angle, beta)
        axes.plot(x, y, label=f"β = {beta:g}°, F$_L$ = {force:.2f} N (sets the dot)", **look)
    assumed: dict[str, Any] = {"color": TYPICAL_COLOR, "linestyle": "-.", "linewidth": 1.1, "zorder": 2}
    axes.axvline(moduli[0], **assumed)
    axes.axvline(moduli[1], label=f"K$_y$ = {moduli[0]:g} and {moduli[1]:g} mm, assumed", **assumed)
    for marker, row in zip("^v<>", (row for row in lateral_soils() if not _is_longji(row["name"])), strict=False):
        point = float(row["lateral_modulus_mm"]), float(row["external_friction_angle_deg"])
        axes.plot(*point, marker, color="black", linestyle="", markersize=6, label=row["name"])
    axes.set(xlim=(5, 60), ylim=(0, 45))
    title = "d  lateral shear; no one force puts curves through both dots"
    _finish(axes, title, "lateral shear modulus K$_y$ [mm]", "external friction angle φ$_y$ [°]")


def _lateral_curve(wheel: Wheel, modulus_mm: float, angle_deg: float, beta_deg: float) -> tuple[float, Any, Any]:
    """Lateral force [N] of a soil at a side slip, and the pairs (K_y [mm], phi_y [deg]) that have the same one."""
    soil = replace(published_soil(), external_friction_angle_deg=angle_deg, lateral_modulus_mm=modulus_mm)
    forces = closed_form_forces(wheel, soil, MEAN_SINKAGE_M, SLIP, beta_deg)
    force = float(forces.lateral_force_n)
    normal, pull = float(forces.normal_force_n), float(forces.drawbar_pull_n)
    state = np.array([[MEAN_SINKAGE_M, SLIP, beta_deg, normal, pull, force]])
    solved = inversion.invert_states(state, wheel.vector(), SHEAR_MODULUS_M, shear_sign_code("signed"))[0]
    x = np.linspace(5.0, 60.0, 221)
    with np.errstate(all="ignore"):
        return force, x, inversion.external_friction_angle(solved[0], solved[2], solved[5], x, COHESION_PA)


def _histograms(wheel: Wheel) -> Figure:
    figure = page(3.1)
    panels = figure.subplots(1, 3)
    for axes, item, letter in zip(panels, histograms(wheel), "abc", strict=True):
        mean, sd = published_value(item.mean_id), published_value(item.sd_id)
        label = f"ours: {item.draws.mean():.4g} ± {item.draws.std(ddof=1):.2g}, {item.draws.size} draws"
        _, edges, _ = axes.hist(item.draws, bins=32, density=True, color="#bcd7e0", edgecolor="white", label=label)
        x = np.linspace(min(edges[0], mean - 4 * sd), max(edges[-1], mean + 4 * sd), 400)
        law = np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
        axes.plot(x, law, color=DOT, linestyle="--", label=f"published: {mean:g} ± {sd:g}, normal")
        axes.axvline(mean, color=DOT, linewidth=0.8)
        _finish(axes, letter, item.label, f"density [{item.per}]")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.24), frameon=False)
    headline(figure, "Monte Carlo errors after Fig. S13 of Ding et al. (2024)")
    return figure
