"""The soil of Ding et al. (2024): which of its numbers follow from what they publish, and their figures 4 and S13.

Wheel forces are not published. Two of the numbers stand for them here: K_s at 8 mm gives F_N / b, and the friction
angle at a slip ratio of -0.075 gives F_DP, under the one reading of the shear law that has a solution there.
"""

import math
import textwrap
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lunarsci.arrays import FloatArray
from lunarsci.errors import LunarSciWarning
from lunarsci.figure import BLUE, GREEN, INK, PINK, VERMILION, headline, name_points, page
from lunarsci.regolith import inversion
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.compare import (
    ReferenceSoil,
    Site,
    bearing_distances,
    compare_site,
    lateral_soils,
    reference_soils,
    strength_distances,
)
from lunarsci.regolith.forces import WheelForces, closed_form_forces, contact_angles, shear_sign_code
from lunarsci.regolith.identify import DRAWS, Assumptions, Identification, identify
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates
from lunarsci.regolith.traction import sinkage_under_load
from lunarsci.regolith.wheel import ShearSign, Wheel, read_wheel
from lunarsci.reproduce.numbers import Answer, Number, judged, published_value

MEAN_SINKAGE_M, SLIP = 0.008, -0.075
"""Mean sinkage and slip ratio of the wheels, Ding et al. (2024), 10.1038/s41467-024-46233-8, Results."""
STIFFNESS, TYPICAL, PHI_DEG, COHESION_PA = 1443.0, 820.0, 21.5, 520.0
"""K_s at 8 mm and typical K_s [kPa m^-N], phi and the cohesion it was found at: Ding et al. (2024), Results."""
SHEAR_MODULUS_MM = 17.8
"""Typical K_x of Ding et al. (2024). [mm]"""
CORNER = (42.0, 3154.0)
"""Typical phi [deg] and the cohesion [Pa] found at it: Ding et al. (2024), Fig. 4b."""
BEARING_DOTS = ((STIFFNESS, 1.0), (556.7, 1.0), (STIFFNESS, 0.87))
"""K_s [kPa m^-N] and N of the dots of Fig. 4a, Ding et al. (2024)."""
LATERAL_CORNERS = ((13.0, 8.3), (40.0, 16.5))
"""K_y [mm] and phi_y [deg] as paired by the rectangle of Fig. 4d, Ding et al. (2024)."""
SIDE_SLIPS_DEG = (0.5, 3.0)
"""Where the lateral force is looked at: to 3 deg, the largest side slip that Ding et al. (2024) report; the least is
assumed."""
SHORT_LUG_M = 0.005
"""Height of lugs that is tried for the one that is not published; assumed."""
MANY_DRAWS = 20_000
"""Draws where chance must not show; assumed."""
SOILS, NO_EVIDENCE = 400, 0.5
"""Soils to measure what chance gives, and the share of them from which on a rank says nothing; assumed."""
EXACT = MeasurementErrors(sinkage_m=0, force_relative=0, travel_relative=0, side_slip_relative=0)
"""No errors of measurement."""
WHEEL_LOAD = "F_N / b = 213.5 N/m, which only this number sets"
SLIP_BRANCH = "slip branch of the shear law at |s|"
LONGJI = ("Longji", "lunar soil, nominal")
"""Rows of the tables of soils that are what is compared."""


def published_soil(stiffness: float = STIFFNESS, cohesion: float = COHESION_PA, phi: float = PHI_DEG) -> Soil:
    """The soil of the published numbers: N = 1, K_x = 17.8 mm, lateral pair of one corner."""
    return Soil(
        stiffness_kpa_m_n=stiffness,
        sinkage_exponent=1.0,
        cohesion_pa=cohesion,
        friction_angle_deg=phi,
        shear_modulus_mm=SHEAR_MODULUS_MM,
        external_friction_angle_deg=LATERAL_CORNERS[0][1],
        lateral_modulus_mm=LATERAL_CORNERS[0][0],
    )


@cache
def stand_in_forces(wheel: Wheel) -> WheelForces:
    """On the mean wheel, by the two numbers that stand for them."""
    return closed_form_forces(wheel, published_soil(), MEAN_SINKAGE_M, SLIP, reading="slip-branch")


def mean_state(wheel: Wheel, sinkage_m: float, errors: MeasurementErrors) -> WheelStates:
    """One state with the forces of the mean wheel."""
    forces = stand_in_forces(wheel)
    values = np.array([[sinkage_m, SLIP, np.nan, float(forces.normal_force_n), float(forces.drawbar_pull_n), np.nan]])
    sigmas = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
    return WheelStates(("mean",), values, sigmas)


def identified(
    wheel: Wheel,
    sinkage_m: float,
    assumptions: Assumptions | None = None,
    *,
    errors: MeasurementErrors = EXACT,
    reading: ShearSign = "signed",
) -> Identification:
    """The soil of the mean state."""
    states = mean_state(wheel, sinkage_m, errors)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        return identify(states, wheel, assumptions, reading=reading, draws=MANY_DRAWS)


def _bearing(wheel: Wheel) -> dict[str, Answer]:
    stiff, both = Assumptions(stiffness_kpa_m_n=STIFFNESS), MeasurementErrors()
    typical = Assumptions(stiffness_kpa_m_n=TYPICAL)
    load = float(stand_in_forces(wheel).normal_force_n)

    def at(sinkage_m: float, name: str, given: Assumptions | None = None, **more: Any) -> Answer:
        return Answer(value=identified(wheel, sinkage_m, given).site[name].value, **more)

    def sd(sinkage_m: float, name: str, given: Assumptions | None, errors: MeasurementErrors, reason: str) -> Answer:
        return Answer(value=identified(wheel, sinkage_m, given, errors=errors).site[name].sigma, reason=reason)

    return {
        "stiffness-8mm": at(
            0.008,
            "stiffness_kpa_m_n",
            set_by_itself=True,
            reading=WHEEL_LOAD,
            reason="a width of 0.15 m would mean 32 N a wheel, 118 kg on six; b and F_N cannot be told apart",
        ),
        "stiffness-15mm": at(0.015, "stiffness_kpa_m_n", reason="same forces as at 8 mm"),
        "exponent-8mm": at(
            0.008,
            "exponent",
            typical,
            reason="follows from K_s = 1443 at N = 1 and 8 mm whatever the force, which both share",
        ),
        "exponent-5mm": at(0.005, "exponent", stiff, reason="same forces as at 8 mm"),
        "sinkage-typical": Answer(
            value=1e3 * sinkage_under_load(wheel, published_soil(TYPICAL), load, SLIP, reading="slip-branch"),
            reason=f"under the same {load:.1f} N; shear at c = 520 Pa, phi = 21.5 deg",
        ),
        "exponent-sd-sinkage": sd(
            0.005, "exponent", stiff, replace(both, force_relative=0.0), "sinkage errs by 0.33 mm"
        ),
        "exponent-sd-forces": sd(
            0.005,
            "exponent",
            stiff,
            replace(both, sinkage_m=0.0),
            "forces err by 10 %/3, independently; the text names only the 10 %",
        ),
        "exponent-sd": sd(0.005, "exponent", stiff, both, "0.33 mm and 10 %/3 together"),
        "stiffness-sd-15mm": sd(0.015, "stiffness_kpa_m_n", None, both, "0.33 mm and 10 %/3 together"),
        "bearing-capacity": _capacity(wheel, load),
        "nearest-terrestrial": _nearest_terrestrial(wheel),
    }


def _capacity(wheel: Wheel, load_n: float) -> Answer:
    theta_1, _, _, theta_m = contact_angles(MEAN_SINKAGE_M, SLIP, wheel.vector())
    stiffness = identified(wheel, MEAN_SINKAGE_M).site["stiffness_kpa_m_n"].value or math.nan
    largest = stiffness * float(wheel.radius_m * (np.cos(theta_m) - np.cos(theta_1)))
    return Answer(
        value=load_n / (wheel.width_m * wheel.radius_m * theta_1) / 1e3,
        reading="mean pressure F_N / (r b theta_1)",
        reason=f"the largest stress sigma_m is {largest:.1f} kPa",
    )


def _ranked(
    sites: Sequence[Site], aspect: str, kind: str, wheel: Wheel, end: Callable[[list[float]], float]
) -> dict[str, float]:
    """Soils of a kind but the site itself, the nearest first, with the `end` of their distances from several sites."""
    distances: dict[str, list[float]] = {}
    for item in (item for site in sites for item in compare_site(site, wheel.width_m)):
        distance = getattr(item, aspect)
        if item.soil.kind == kind and "Longji" not in item.soil.name and distance is not None:
            distances.setdefault(item.soil.name, []).append(distance)
    ends = {name: end(values) for name, values in distances.items()}
    return dict(sorted(ends.items(), key=lambda pair: (pair[1], pair[0])))


def _nearest_terrestrial(wheel: Wheel) -> Answer:
    """By the nearest of the three dots of Fig. 4a."""
    sites = [Site(stiffness_kpa_m_n=stiffness, sinkage_exponent=exponent) for stiffness, exponent in BEARING_DOTS]
    best = _ranked(sites, "bearing", "terrestrial", wheel, min)
    order, named = [*best], next(name for name in best if "Michigan" in name)
    return Answer(
        value=float(order.index(named) + 1),
        reason=f"rms ln ratio of pressures to the nearest of the three dots {best[named]:.2f}; next is {order[1]} with "
        f"{best[order[1]]:.2f}; of {SOILS} soils drawn from the lunar priors it is the nearest to "
        f"{100 * _share_of_soils(named, 'bearing', wheel):.0f} %",
    )


def _nearest_mission(wheel: Wheel) -> Answer:
    """By the farthest corner of the rectangle of Fig. 4b."""
    pairs = [(c, phi) for c in (COHESION_PA, CORNER[1]) for phi in (PHI_DEG, CORNER[0])]
    sites = [Site(cohesion_pa=cohesion, friction_angle_deg=phi) for cohesion, phi in pairs]
    worst = _ranked(sites, "strength", "lunar", wheel, max)
    order, named = [*worst], next(name for name in worst if "Apollo 12, direct shear" in name)
    share = _share_of_soils(named, "strength", wheel)
    return Answer(
        value=float(order.index(named) + 1),
        determined=share < NO_EVIDENCE,
        reason=f"of {SOILS} soils drawn from the lunar priors none is nearer to {100 * share:.0f} %, whatever they "
        f"are: its ranges (0.1-3.1 kPa, 13-56 deg) are the widest of all; next here is {order[1]} at "
        f"{worst[order[1]]:.2f}",
    )


def _share_of_soils(name: str, aspect: str, wheel: Wheel) -> float:
    """Share of soils of the priors that no reference of its kind is nearer to than the named one: what chance gives."""
    kind = "lunar" if aspect == "strength" else "terrestrial"
    drawn = first_belief().draws(SOILS, seed=0)
    distances = {
        soil.name: strength_distances(drawn, soil)
        if aspect == "strength"
        else bearing_distances(drawn, soil, wheel.width_m)
        for soil in reference_soils()
        if soil.kind == kind and "Longji" not in soil.name
    }
    return float(np.mean(distances[name] <= np.nanmin([*distances.values()], axis=0)))


def _shear(wheel: Wheel) -> dict[str, Answer]:
    needed_n = float(stand_in_forces(wheel).drawbar_pull_n)
    physical = closed_form_forces(wheel, published_soil(), MEAN_SINKAGE_M, SLIP)
    pull = float(physical.drawbar_pull_n)
    slope = math.degrees(math.atan2(-pull, float(physical.normal_force_n)))
    other = published_soil(cohesion=CORNER[1], phi=CORNER[0])
    rolling = closed_form_forces(wheel, other, MEAN_SINKAGE_M, -1e-6, reading="slip-branch")

    def angle(of: Wheel, errors: MeasurementErrors) -> Any:
        return identified(of, MEAN_SINKAGE_M, errors=errors, reading="slip-branch").site["friction_angle_deg"]

    slipping, short = MeasurementErrors(sinkage_m=0.0), replace(wheel, grouser_height_m=SHORT_LUG_M)
    stiffness = identified(short, 0.015).site["stiffness_kpa_m_n"].value or math.nan
    return {
        "friction-angle": Answer(
            value=angle(wheel, EXACT).value,
            set_by_itself=True,
            reading=f"{SLIP_BRANCH}; F_DP = {needed_n:.2f} N, which only this number sets",
            reason=f"with the physical sign it would take {pull:.1f} N, a mean slope of {slope:.0f} deg, where the "
            "steepest was 8.9 deg",
        ),
        "friction-angle-sd": Answer(
            value=angle(wheel, slipping).sigma,
            reading=f"{SLIP_BRANCH}; slip ratio errs by 4 %/3 of the way",
            reason=f"the lug height is not published: {1e3 * SHORT_LUG_M:.0f} mm instead of "
            f"{1e3 * wheel.grouser_height_m:.0f} mm give {angle(short, slipping).sigma or math.nan:.2f} deg, and "
            f"{stiffness:.1f} kPa m^-N at 15 mm",
        ),
        "cohesion": Answer(
            value=None,
            reason="lies on another curve of Fig. 4b, slip ratio -> 0, whose drawbar pull is not published; it takes "
            f"{float(rolling.drawbar_pull_n):.2f} N there and {needed_n:.2f} N at -0.075",
        ),
        "nearest-mission": _nearest_mission(wheel),
    }


def _lateral(wheel: Wheel, corner: tuple[float, float]) -> Answer:
    modulus, angle = corner
    soil = replace(published_soil(), external_friction_angle_deg=angle, lateral_modulus_mm=modulus)
    least, most = closed_form_forces(wheel, soil, MEAN_SINKAGE_M, SLIP, SIDE_SLIPS_DEG).lateral_force_n
    return Answer(
        value=None,
        reason=f"lateral forces are not published; with K_y = {modulus:g} mm it takes {least:.2f} N at 0.5 deg "
        f"of side slip or {most:.2f} N at 3 deg, and no one force gives both ends of the range",
    )


def soil_numbers(wheel: Wheel | None = None) -> list[Number]:
    """Every number of the soil beside ours, in the order of the table.

    Parameters
    ----------
    wheel : Yutu-2's by default; its lug height is not published and moves some of the answers.
    """
    of = wheel or read_wheel("yutu2")
    names = ("external-friction-low", "external-friction-high")
    lateral = {name: _lateral(of, corner) for name, corner in zip(names, LATERAL_CORNERS, strict=True)}
    return judged("soil", _bearing(of) | _shear(of) | lateral)


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Draws of a quantity beside its published mean and standard deviation.

    Attributes
    ----------
    label, per : of the quantity and of its density, with their units.
    mean_id, sd_id : of the published numbers, in `published.csv`.
    draws : of the quantity, in that unit. (n,)
    """

    label: str
    per: str
    mean_id: str
    sd_id: str
    draws: FloatArray


def histograms(wheel: Wheel, draws: int = DRAWS, seed: int = 0) -> tuple[Histogram, ...]:
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
        state = mean_state(wheel, sinkage_m, errors)
        sample = state.values + state.sigmas * rng.standard_normal((draws, len(COLUMNS)))
        modulus_m = SHEAR_MODULUS_MM * 1e-3
        return np.asarray(inversion.invert_states(sample, wheel.vector(), modulus_m, shear_sign_code(reading))).T

    shallow = stresses(0.005, MeasurementErrors(), "signed")
    deep = stresses(0.015, MeasurementErrors(), "signed")
    sheared = stresses(MEAN_SINKAGE_M, MeasurementErrors(sinkage_m=0.0), "slip-branch")
    with np.errstate(all="ignore"):
        exponent = inversion.sinkage_exponent(shallow[0], shallow[3], STIFFNESS)
        stiffness = inversion.stiffness(deep[0], deep[3], 1.0)
        angle = inversion.friction_angle(sheared[0], sheared[1], sheared[4], COHESION_PA)

    def made(label: str, per: str, mean_id: str, sd_id: str, values: FloatArray) -> Histogram:
        return Histogram(label, per, mean_id, sd_id, values[np.isfinite(values)])

    return (
        made("sinkage exponent N at 5 mm [-]", "-", "exponent-5mm", "exponent-sd", exponent),
        made("stiffness K$_s$ at 15 mm [kPa m$^{-N}$]", "m$^N$/kPa", "stiffness-15mm", "stiffness-sd-15mm", stiffness),
        made("friction angle φ at 520 Pa [°]", "1/°", "friction-angle", "friction-angle-sd", angle),
    )


Named = list[tuple[str, float, float]]
"""Names of points to be written, and where these are."""
REGION, DOT, TYPICAL_COLOR, GREY = "#f6c592", VERMILION, GREEN, "0.35"
CURVES: Any = ({"color": BLUE}, {"color": VERMILION, "linestyle": "--"}, {"color": PINK, "linestyle": ":"},
               {"color": "#000000", "linestyle": (0, (7, 2))})  # fmt: skip
TYPICAL_LOOK: Any = {"color": TYPICAL_COLOR, "linestyle": "-.", "linewidth": 1.1, "zorder": 2}
PROGRAMMES = {"Surveyor": BLUE, "Luna": VERMILION, "Apollo": INK}
MARKERS = "os^Dv<>Php*"
SINKAGES_MM = (5.0, 8.0, 12.0, 15.0)
COHESION, FRICTION = "cohesion c [Pa]", "internal friction angle φ [°]"


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
    axes.set(xlabel=x, ylabel=y)
    axes.grid()


def _terrestrial(axes: Axes, points: Mapping[str, tuple[float, float]]) -> Named:
    """Terrestrial soils, to be named; water by weight is in the names of most."""
    axes.plot(*zip(*points.values(), strict=True), "k.", markersize=7, label="terrestrial soils")
    return [
        ("\n".join(textwrap.wrap(name.replace(" % water", "\u00a0%"), 22)), *point) for name, point in points.items()
    ]


def _others(kind: str) -> list[ReferenceSoil]:
    return [soil for soil in reference_soils() if soil.kind == kind and not any(one in soil.name for one in LONGJI)]


def _bearing_panel(axes: Axes, wheel: Wheel) -> Named:
    """Pairs (N, K_s) that carry the load at each sinkage; returns the soils to be named."""
    stiffness, exponent = zip(*BEARING_DOTS, strict=True)
    _region(axes, exponent, stiffness, list(zip(exponent, stiffness, strict=True)))
    for sinkage_mm, look in zip(SINKAGES_MM, CURVES, strict=True):
        points = identified(wheel, 1e-3 * sinkage_mm).curves["bearing"]
        pairs = [(one["exponent"], one["stiffness_kpa_m_n"]) for one in points if one["stiffness_kpa_m_n"] is not None]
        axes.plot(*np.reshape(pairs, (-1, 2)).T, label=f"z = {sinkage_mm:g} mm", **look)
    axes.axvline(1.0, **TYPICAL_LOOK)
    axes.axhline(TYPICAL, label=f"typical of the Moon: N = 1, K$_s$ = {TYPICAL:g}", **TYPICAL_LOOK)
    soils = {
        soil.name: (soil.sinkage_exponent, value)
        for soil in _others("terrestrial")
        if soil.sinkage_exponent is not None and (value := soil.stiffness(wheel.width_m)) is not None
    }
    axes.set(yscale="log", xlim=(0.35, 1.5), ylim=(150, 1e4))
    title = f"a  bearing, F$_N$ = {float(stand_in_forces(wheel).normal_force_n):.1f} N a wheel"
    _finish(axes, title, "sinkage exponent N [-]", "stiffness K$_s$ [kPa m$^{-N}$]")
    return _terrestrial(axes, soils)


def _same_forces(
    wheel: Wheel, soil: Soil, slip: float, side_slip_deg: float, reading: ShearSign
) -> tuple[WheelForces, FloatArray]:
    """Forces on a soil at the mean sinkage, and what `invert_states` makes of them. (6,)"""
    forces = closed_form_forces(wheel, soil, MEAN_SINKAGE_M, slip, side_slip_deg, reading=reading)
    numbers = (forces.normal_force_n, forces.drawbar_pull_n, forces.lateral_force_n)
    state = np.array([[MEAN_SINKAGE_M, slip, side_slip_deg, *map(float, numbers)]])
    return forces, inversion.invert_states(state, wheel.vector(), SHEAR_MODULUS_MM * 1e-3, shear_sign_code(reading))[0]


def _shear_panel(axes: Axes, wheel: Wheel) -> Named:
    """Pairs (c, phi) of both curves with a published point, each with the drawbar pull that puts it there."""
    corners = ((COHESION_PA, PHI_DEG, SLIP), (CORNER[1], CORNER[0], -1e-6))
    _region(axes, [COHESION_PA, CORNER[1]], [PHI_DEG, CORNER[0]], [(c, phi) for c, phi, _ in corners])
    x = np.linspace(0.0, 11_000.0, 441)
    for (cohesion, phi, slip), look in zip(corners, CURVES, strict=False):
        soil = published_soil(cohesion=cohesion, phi=phi)
        forces, solved = _same_forces(wheel, soil, slip, 0.0, "slip-branch")
        with np.errstate(all="ignore"):
            y = inversion.friction_angle(solved[0], solved[1], solved[4], x)
        name = f"s = {slip:g}" if slip < -1e-3 else "s → 0, skid"
        axes.plot(x, y, label=f"{name}, F$_{{DP}}$ = {float(forces.drawbar_pull_n):.2f} N (sets the dot)", **look)
    axes.axvline(COHESION_PA, **TYPICAL_LOOK)
    label = f"typical of the Moon: c = {COHESION_PA:g} Pa, φ = {CORNER[0]:g}°"
    axes.axhline(CORNER[0], label=label, **TYPICAL_LOOK)
    soils = {soil.name: (soil.cohesion_pa[0], soil.friction_angle_deg[0]) for soil in _others("terrestrial")}
    axes.set(xlim=(0, x[-1]), ylim=(0, 60))
    _finish(axes, "b  longitudinal shear, slip branch of the law at |s|", COHESION, FRICTION)
    return _terrestrial(axes, {name: point for name, point in soils.items() if point[0] < x[-1]})


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
    _finish(axes, "c  shear beside other missions; bars: what is given", COHESION, FRICTION)


def _lateral_panel(axes: Axes, wheel: Wheel) -> None:
    """Pairs (K_y, phi_y) at both ends of the side slip, each with the lateral force that puts it through its dot."""
    moduli, angles = zip(*LATERAL_CORNERS, strict=True)
    _region(axes, moduli, angles, LATERAL_CORNERS)
    x = np.linspace(5.0, 60.0, 221)
    for (modulus, angle), beta, look in zip(LATERAL_CORNERS, reversed(SIDE_SLIPS_DEG), CURVES, strict=False):
        soil = replace(published_soil(), external_friction_angle_deg=angle, lateral_modulus_mm=modulus)
        forces, solved = _same_forces(wheel, soil, SLIP, beta, "signed")
        with np.errstate(all="ignore"):
            y = inversion.external_friction_angle(solved[0], solved[2], solved[5], x, COHESION_PA)
        axes.plot(x, y, label=f"β = {beta:g}°, F$_L$ = {float(forces.lateral_force_n):.2f} N (sets the dot)", **look)
    axes.axvline(moduli[0], **TYPICAL_LOOK)
    axes.axvline(moduli[1], label=f"K$_y$ = {moduli[0]:g} and {moduli[1]:g} mm, assumed", **TYPICAL_LOOK)
    rows = [row for row in lateral_soils() if not any(one in row["name"] for one in LONGJI)]
    for marker, row in zip("^v<>", rows, strict=False):
        point = float(row["lateral_modulus_mm"]), float(row["external_friction_angle_deg"])
        axes.plot(*point, marker, color="black", linestyle="", markersize=6, label=row["name"])
    axes.set(xlim=(5, 60), ylim=(0, 45))
    title = "d  lateral shear; no one force puts curves through both dots"
    _finish(axes, title, "lateral shear modulus K$_y$ [mm]", "external friction angle φ$_y$ [°]")


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
