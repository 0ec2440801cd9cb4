"""Figures 4 and S13 of Ding et al. (2024): regions of the soil parameters, and Monte Carlo histograms.

Names beside the points of a figure, kept off each other.

Monte Carlo draws behind the published standard deviations, as the histograms of Ding et al. (2024), Fig. S13.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
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

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox


SHEAR_MODULUS_M = 0.0178


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Draws of a quantity, with the ids of its published mean and standard deviation, and a label with its unit."""

    label: str
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
        _histogram("sinkage exponent N at 5 mm [-]", "exponent-5mm", "exponent-sd", exponent),
        _histogram("stiffness K$_s$ at 15 mm [kPa m$^{-N}$]", "stiffness-15mm", "stiffness-sd-15mm", stiffness),
        _histogram("internal friction angle φ at c = 520 Pa [°]", "friction-angle", "friction-angle-sd", angle),
    )


def _histogram(label: str, mean_id: str, sd_id: str, values: FloatArray) -> Histogram:
    return Histogram(label, mean_id, sd_id, values[np.isfinite(values)])


SIZE = 7.0
PLACES = (
    *((5.0, y, "left") for y in (3.0, -9.0, 12.0, -18.0)),
    *((-5.0, y, "right") for y in (3.0, -9.0, 12.0, -18.0)),
)
"""Offsets that are tried in this order, and the side of the name that is at the point. [points]"""


def place_names(axes: "Axes", points: Mapping[str, tuple[float, float]]) -> None:
    """Name points in data coordinates, each at the first place where it covers no other name, no legend and no edge.

    The figure must have been laid out. A name that finds no such place is left at its first one.
    """
    legend = axes.get_legend()
    taken = [axes.transData.transform([point]).repeat(2, axis=0) for point in points.values()]
    boxes = [_around(corners) for corners in taken]
    if legend is not None:
        boxes.append(legend.get_window_extent())
    for name, point in points.items():
        boxes.append(_place(axes, name, point, boxes))


def _around(corners: object) -> "Bbox":
    """A box of a marker's size about a point in pixels."""
    from matplotlib.transforms import Bbox

    return Bbox(corners).padded(3.0)  # type: ignore[arg-type]


def _place(axes: "Axes", name: str, point: tuple[float, float], boxes: list["Bbox"]) -> "Bbox":
    tried = []
    for x, y, side in PLACES:
        text = axes.annotate(
            name, point, xytext=(x, y), textcoords="offset points", ha=side, fontsize=SIZE, color="0.35", zorder=5
        )
        box = text.get_window_extent()
        inside = axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1
        if inside and not any(box.overlaps(other) for other in boxes):
            break
        tried.append((text, box))
    else:
        text, box = tried.pop(0)
    for other, _ in tried:
        other.remove()
    return box


Named = dict[str, tuple[float, float]]

REGION, DOT, TYPICAL_COLOR, GREY = "#f6c592", "#D55E00", "#009E73", "0.35"
CURVES = ("#0072B2", "#56B4E9", "#CC79A7", "#000000")
SINKAGES_MM = (5.0, 8.0, 12.0, 15.0)
OWN = ("Longji", "lunar soil, nominal")
"""Rows of the tables of soils that are what is compared."""


def soil_pages(wheel: Wheel) -> "Iterator[Figure]":
    """Two pages: the four panels of Fig. 4, and the histograms of Fig. S13."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 10.5), layout="constrained")
    (bearing, shear), (missions, lateral) = figure.subplots(2, 2)
    named = {bearing: _bearing(bearing, wheel), shear: _shear(shear, wheel)}
    _missions(missions)
    _lateral(lateral, wheel)
    figure.suptitle("Soil parameters at Longji after Fig. 4 of Ding et al. (2024)", fontsize=12)
    figure.draw_without_rendering()
    for axes, points in named.items():
        place_names(axes, points)
    yield figure
    yield _histograms(wheel)


def _region(axes: "Axes", x: Sequence[float], y: Sequence[float], dots: Sequence[tuple[float, float]]) -> None:
    """The published rectangle and its dots."""
    from matplotlib.patches import Rectangle

    corner, size = (min(x), min(y)), (max(x) - min(x), max(y) - min(y))
    axes.add_patch(Rectangle(corner, *size, facecolor=REGION, alpha=0.55, zorder=1, label="published region"))
    axes.plot(*np.transpose(dots), "o", color=DOT, markersize=8, zorder=6, label="published dots")


def _finish(axes: "Axes", title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.2, linewidth=0.5)
    axes.legend(frameon=True, framealpha=0.85, fontsize=8, loc="best")


def _typical(axes: "Axes", x: float, y: float, label: str) -> None:
    look: dict[str, Any] = {"color": TYPICAL_COLOR, "linestyle": "-.", "linewidth": 1.1, "zorder": 2}
    axes.axvline(x, **look)
    axes.axhline(y, label=label, **look)


def _bearing(axes: "Axes", wheel: Wheel) -> Named:
    """Pairs (N, K_s) that carry the load at each sinkage; returns the soils to be named."""
    named: Named = {}
    stiffness = [dot[0] for dot in BEARING_DOTS]
    exponent = [dot[1] for dot in BEARING_DOTS]
    _region(axes, exponent, stiffness, list(zip(exponent, stiffness, strict=True)))
    for sinkage_mm, color in zip(SINKAGES_MM, CURVES, strict=True):
        points = identified(wheel, 1e-3 * sinkage_mm).curves["bearing"]
        axes.plot(*_xy(points, "exponent", "stiffness_kpa_m_n"), color=color, label=f"z = {sinkage_mm:g} mm")
    _typical(axes, 1.0, TYPICAL, f"typical of the Moon: N = 1, K$_s$ = {TYPICAL:g}")
    for soil in _others("terrestrial"):
        value = soil.stiffness(wheel.width_m)
        if soil.sinkage_exponent is not None and value is not None:
            axes.plot(soil.sinkage_exponent, value, "k.", markersize=7)
            named[soil.name] = (soil.sinkage_exponent, value)
    axes.plot([], [], "k.", markersize=7, label="terrestrial soils")
    axes.set(yscale="log", xlim=(0.35, 1.5), ylim=(150, 1e4))
    force = float(stand_in_forces(wheel).normal_force_n)
    _finish(
        axes, f"a  bearing, F$_N$ = {force:.1f} N a wheel", "sinkage exponent N [-]", "stiffness K$_s$ [kPa m$^{-N}$]"
    )
    return named


def _xy(points: Sequence[Mapping[str, Any]], x: str, y: str) -> tuple[list[float], list[float]]:
    known = [point for point in points if point[y] is not None]
    return [point[x] for point in known], [point[y] for point in known]


def _others(kind: str) -> list[ReferenceSoil]:
    return [soil for soil in reference_soils() if soil.kind == kind and not any(name in soil.name for name in OWN)]


def _shear(axes: "Axes", wheel: Wheel) -> Named:
    """Pairs (c, phi) of both curves with a published point, each with the drawbar pull that puts it there."""
    named: Named = {}
    corners = ((COHESION_PA, PHI_DEG, SLIP), (CORNER[1], CORNER[0], -1e-6))
    _region(axes, [COHESION_PA, CORNER[1]], [PHI_DEG, CORNER[0]], [(c, phi) for c, phi, _ in corners])
    for (cohesion, phi, slip), color in zip(corners, CURVES, strict=False):
        pull, x, y = _shear_curve(wheel, cohesion, phi, slip)
        name = f"s = {slip:g}" if slip < -1e-3 else "s → 0, skid"
        axes.plot(x, y, color=color, label=f"{name}, F$_{{DP}}$ = {pull:.2f} N (sets the dot)")
    _typical(axes, COHESION_PA, CORNER[0], f"typical of the Moon: c = {COHESION_PA:g} Pa, φ = {CORNER[0]:g}°")
    for soil in _others("terrestrial"):
        if soil.cohesion_pa[0] < 11_000:
            axes.plot(soil.cohesion_pa[0], soil.friction_angle_deg[0], "k.", markersize=7)
            named[soil.name] = (soil.cohesion_pa[0], soil.friction_angle_deg[0])
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


def _missions(axes: "Axes") -> None:
    """Ranges of other missions, each named at its side."""
    from matplotlib import colormaps

    _region(axes, [COHESION_PA, CORNER[1]], [PHI_DEG, CORNER[0]], [(COHESION_PA, PHI_DEG), (CORNER[1], CORNER[0])])
    soils = _others("lunar")
    colors = colormaps["tab20"](np.linspace(0, 1, len(soils)))
    for number, (soil, color) in enumerate(zip(soils, colors, strict=True)):
        x, y = np.mean(soil.cohesion_pa), np.mean(soil.friction_angle_deg)
        error = (np.ptp(soil.cohesion_pa) / 2, np.ptp(soil.friction_angle_deg) / 2)
        marker = "osD^vP"[number % 6]
        axes.errorbar(
            x, y, xerr=error[0], yerr=error[1], fmt=marker, color=color, markersize=5, capsize=2.5, linewidth=1.1,
            label=soil.name,
        )  # fmt: skip
    axes.set(xlim=(-100, 6200), ylim=(10, 105), yticks=range(10, 61, 10))
    title = "c  longitudinal shear beside other missions; bars span what the source gives"
    _finish(axes, title, "cohesion c [Pa]", "internal friction angle φ [°]")
    axes.legend(frameon=False, fontsize=7, loc="upper center", ncols=2)


def _lateral(axes: "Axes", wheel: Wheel) -> None:
    """Pairs (K_y, phi_y) at both ends of the side slip, each with the lateral force that puts it through its dot."""
    moduli, angles = zip(*LATERAL_CORNERS, strict=True)
    _region(axes, moduli, angles, LATERAL_CORNERS)
    for (modulus, angle), beta, color in zip(LATERAL_CORNERS, reversed(SIDE_SLIPS_DEG), CURVES, strict=False):
        force, x, y = _lateral_curve(wheel, modulus, angle, beta)
        axes.plot(x, y, color=color, label=f"β = {beta:g}°, F$_L$ = {force:.2f} N (sets the dot)")
    look: dict[str, Any] = {"color": TYPICAL_COLOR, "linestyle": "-.", "linewidth": 1.1, "zorder": 2}
    axes.axvline(moduli[0], **look)
    axes.axvline(moduli[1], label=f"K$_y$ = {moduli[0]:g} and {moduli[1]:g} mm, assumed", **look)
    for row in lateral_soils():
        if not any(name in row["name"] for name in OWN):
            point = float(row["lateral_modulus_mm"]), float(row["external_friction_angle_deg"])
            axes.plot(*point, "k^", markersize=6, label=row["name"])
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


def _histograms(wheel: Wheel) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 4.8), layout="constrained")
    panels = figure.subplots(1, 3)
    for axes, item, letter in zip(panels, histograms(wheel), "abc", strict=True):
        mean, sd = published_value(item.mean_id), published_value(item.sd_id)
        own = f"ours: {item.draws.mean():.4g} ± {item.draws.std(ddof=1):.2g}, {item.draws.size} draws"
        _, edges, _ = axes.hist(item.draws, bins=32, density=True, color="#bcd7e0", edgecolor="white", label=own)
        x = np.linspace(min(edges[0], mean - 4 * sd), max(edges[-1], mean + 4 * sd), 400)
        law = np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
        axes.plot(x, law, color=DOT, linestyle="--", label=f"published: {mean:g} ± {sd:g}, as a normal law")
        axes.axvline(mean, color=DOT, linewidth=0.8)
        axes.set_ylim(0, 1.3 * axes.get_ylim()[1])
        _finish(axes, letter, item.label, "probability density")
    figure.suptitle("Monte Carlo errors after Fig. S13 of Ding et al. (2024)", fontsize=12)
    return figure
