"""The drive of Ding et al. (2024): which of its numbers follow from what they publish.

The elevation model of Longji, the dimensions of the rover and most soil parameters of their simulation are in a
supplement that is not openly available. What a stand-in for them gives is shown as an example, with its range over
four pieces of ground, and is not judged. What does not depend on the ground is.

The slip at which a rover rolls steadily down a slope: six equal wheels, no terrain, no rover between them.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from scipy.optimize import brentq

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.figure import INK, headline, legend_below, page
from lunarsci.ranges import refuse
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.regolith.traction import STEEPEST_DEG, sinkage_under_load
from lunarsci.regolith.wheel import MAX_VALID_SLIP, Wheel
from lunarsci.reproduce.numbers import Answer, Number, judged, published_value
from lunarsci.twin.figures.panels import GOLD, LIMIT, draw_ground, draw_planned, map_window
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.judgement.quantities import along
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.plans.plan import Plan, Sweep, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict

SOIL, STAND_IN = "longji", "stand-in"
"""Soil of the drive, and the name of the synthetic terrain that it is predicted on, in the place of that of `DEM`."""
PHI, K_Y = "friction_angle_deg", "lateral_modulus_mm"
PHI_DEG, K_Y_MM = (25.0, 55.0), (15.0, 45.0)
"""The published range of the sweep: Ding et al. (2024), 10.1038/s41467-024-46233-8, Fig. S6."""
VALUES = 7
"""Values of each parameter over the published range; assumed."""
TYPICAL_PHI_DEG, TYPICAL_K_Y_MM = 40.0, 20.0
"""The values of the sweep nearest to those of the uncorrected prediction, phi = 42 deg and K_y = 20 mm, of Ding et al.
(2024)."""
CORNERS = {"stiffness_kpa_m_n": (556.7, 1443.0), "cohesion_pa": (520.0, 3154.0)}
"""The published ranges of what else the shear of a wheel depends on: Ding et al. (2024), Fig. 4."""
VIEW_M = 0.69
"""Height of the spectrometer, which looks down at 45 deg (Ding et al. 2024), and so sees so far ahead."""
FRONT_M = 0.75
"""Half of the assumed 1.5 m of the rover, its origin to its front."""
DEM = "the elevation model of Longji is not public"


@dataclass(frozen=True, slots=True)
class Rolling:
    """A rover whose wheels share its weight equally and hold it back or push it alike, reading `signed`.

    Attributes
    ----------
    wheel : of the rover.
    weight_n : of the rover on each wheel, > 0. [N]
    """

    wheel: Wheel
    weight_n: float

    @classmethod
    def of(cls, rover: Rover) -> "Rolling":
        """The mean wheel of a rover."""
        return cls(rover.wheel, rover.load_n)

    def surplus_n(self, soil: Soil, slope_deg: float, slip_ratio: float) -> float:
        """Force along a slope, downhill positive, that speeds a wheel up at a slip ratio; 0 in steady rolling. [N]"""
        slope = math.radians(slope_deg)
        sinkage = sinkage_under_load(self.wheel, soil, self.weight_n * math.cos(slope), slip_ratio)
        pull = closed_form_forces(self.wheel, soil, sinkage, slip_ratio).drawbar_pull_n
        return float(pull) + self.weight_n * math.sin(slope)

    def slip_ratio(self, soil: Soil, slope_deg: float) -> float:
        """Slip ratio of steady rolling down a slope, negative for skid. [-]

        Raises ParameterError where no slip within 0.6 balances the weight.
        """
        wheel = f"{self.weight_n:.1f} N a wheel"
        text = f"no slip within {MAX_VALID_SLIP} lets {wheel} roll steadily down {slope_deg:g} deg"
        return _root(lambda slip: self.surplus_n(soil, slope_deg, slip), MAX_VALID_SLIP, text)

    def slope_deg(self, soil: Soil, slip_ratio: float) -> float:
        """Slope down which a wheel rolls steadily at a slip ratio; negative is uphill. [deg]

        Raises ParameterError where none within 45 deg does.
        """
        text = f"on no slope within {STEEPEST_DEG:g} deg {self.weight_n:.1f} N a wheel roll at a slip of {slip_ratio:g}"
        return _root(lambda slope: self.surplus_n(soil, slope, slip_ratio), STEEPEST_DEG, text)


def _root(function: Callable[[float], float], reach: float, text: str) -> float:
    refuse({f"{text}; take another rover or soil": function(-reach) * function(reach) > 0})
    return float(brentq(function, -reach, reach, xtol=1e-9))


@dataclass(frozen=True, slots=True)
class Drives:
    """The planned drive over a grid of soils, phi 25-55 deg by K_y 15-45 mm, on several pieces of ground.

    Attributes
    ----------
    rover, plan : what drove which plan.
    on : `STAND_IN`, and planes by name, with the prediction on each.
    """

    rover: Rover
    plan: Plan
    on: Mapping[str, Prediction]

    @property
    def stand_in(self) -> Prediction:
        """The prediction on the stand-in for Longji."""
        return self.on[STAND_IN]


def _plane(down_deg: float, across_deg: float, soil: Soil) -> Terrain:
    """A plane that falls along x and rises to the left."""
    x, y = np.arange(-4.0, 16.01, 0.5)[None, :], np.arange(-10.0, 10.01, 0.5)[:, None]
    height = math.tan(math.radians(across_deg)) * y - math.tan(math.radians(down_deg)) * x
    return build_terrain("plane", -4.0, -10.0, 0.5, height, soil, synthetic=True)


def _grounds() -> dict[str, Terrain]:
    soil = read_soil(SOIL)
    slopes = {f"{published_value(name):g}° down": published_value(name) for name in ("slope-end", "slope-most")}
    planes = {name: _plane(slope, 0.0, soil) for name, slope in slopes.items()}
    return {STAND_IN: synthetic_longji(soil), **planes, "2° across": _plane(0.0, 2.0, soil)}


def predicted_drives(rover: Rover | None = None, progress: Callable[[int, int], None] | None = None) -> Drives:
    """Drive the embedded plan over the grid of soils, on each piece of ground.

    Parameters
    ----------
    rover : Yutu-2 by default.
    progress : called with pieces of ground done and in all.
    """
    driver, plan, grounds = rover or build_rover("yutu2"), read_plan(), _grounds()
    sweep = Sweep(PHI, *PHI_DEG, VALUES), Sweep(K_Y, *K_Y_MM, VALUES)
    on = {}
    for number, (name, terrain) in enumerate(grounds.items(), 1):
        on[name] = predict(driver, terrain, plan, sweep=sweep, ruts=False)
        if progress:
            progress(number, len(grounds))
    if not on[STAND_IN].finished.any():
        raise DataError(f"{driver.name} does not finish the published plan: {on[STAND_IN].outcome_text(0)}")
    return Drives(driver, plan, on)


def medians(prediction: Prediction, quantity: str, parameter: str) -> dict[float, float]:
    """Median of |side slip| or of the slip ratio over samples, wheels and all else, for each value of a parameter."""
    values, varied = along(prediction, quantity), prediction.parameters[parameter]
    values = np.abs(values) if quantity == "side_slip_deg" else values
    return {
        float(value): float(np.median(values[varied == value][prediction.reached[varied == value]]))
        for value in np.unique(varied)
    }


def _example(drives: Drives, of: Callable[[Prediction], float], reason: str) -> Answer:
    """The value on the stand-in, with the range over all grounds; not judged."""
    values = {name: of(prediction) for name, prediction in drives.on.items() if prediction.finished.any()}
    on_planes = ", ".join(f"{name} {value:.3g}" for name, value in values.items() if name != STAND_IN)
    return Answer(
        value=values[STAND_IN],
        determined=False,
        low=min(values.values()),
        high=max(values.values()),
        reading="synthetic stand-in for the ground of Longji",
        reason=f"{reason}; on planes: {on_planes}",
    )


def _path(plan: Plan) -> dict[str, Answer]:
    x, y, heading = planned_pose(plan, plan.length_m)
    end, reach = np.array([x - plan.x_m, y - plan.y_m]), FRONT_M + VIEW_M
    slope = Answer(value=None, reason=f"{DEM}; the stand-in is built to have this slope")
    return {
        "path-length": Answer(
            value=math.fsum(leg.length_m for leg in plan.legs),
            reason=f"{' + '.join(f'{leg.length_m:g}' for leg in plan.legs)} m",
        ),
        "rock-distance": Answer(
            value=math.hypot(*(end + reach * np.array([math.cos(heading), math.sin(heading)]))),
            reading="at the end of the arcs the spectrometer sees the rock",
            reason=f"the arcs end {math.hypot(*end):.2f} m from their start; {VIEW_M} m ahead of the front, which is "
            f"{FRONT_M} m ahead of the origin (assumed); a straight approach of unpublished length is not counted",
        ),
        "slope-most": slope,
        "slope-end": slope,
    }


def _slip(drives: Drives) -> dict[str, Answer]:
    weak, strong = PHI_DEG
    slope = Rolling.of(drives.rover).slope_deg(_soil(weak), published_value("slip-25deg"))
    skid = {phi: _skid_share(drives.stand_in, phi) for phi in PHI_DEG}
    return {
        "slip-25deg": _example(
            drives,
            lambda prediction: medians(prediction, "slip_ratio", PHI)[weak],
            f"the slope along the path sets it, and {DEM}; -0.035 takes steady rolling down {slope:.1f} deg; on the "
            f"stand-in {100 * skid[weak]:.0f} % of the wheel states skid at {weak:g} deg, {100 * skid[strong]:.0f} % "
            f"at {strong:g} deg",
        ),
        "slip-55deg": _strong_soil(drives),
        "slip-least": _example(
            drives,
            lambda prediction: float(along(prediction, "slip_ratio")[prediction.reached].min()),
            f"the steepest ground sets it, and {DEM}",
        ),
    }


def _soil(phi_deg: float, **values: float) -> Soil:
    return replace(read_soil(SOIL), friction_angle_deg=phi_deg, **values)


def _skid_share(prediction: Prediction, phi_deg: float) -> float:
    members = prediction.parameters[PHI] == phi_deg
    return float((along(prediction, "slip_ratio")[members][prediction.reached[members]] < 0).mean())


def _strong_soil(drives: Drives) -> Answer:
    """Slip at 55 deg on the slope that gives the published slip at 25 deg, over the corners of K_s and c."""
    rolling, published = Rolling.of(drives.rover), published_value("slip-25deg")

    def there(**values: float) -> tuple[float, float]:
        slope = rolling.slope_deg(_soil(PHI_DEG[0], **values), published)
        return slope, rolling.slip_ratio(_soil(PHI_DEG[1], **values), slope)

    corners = [there(**dict(zip(CORNERS, pair, strict=True)))[1] for pair in product(*CORNERS.values())]
    slope, slip = there()
    ends = medians(drives.stand_in, "slip_ratio", PHI)
    return Answer(
        value=slip,
        low=min(corners),
        high=max(corners),
        reading="steady rolling of six equal wheels, shear along its displacement (signed)",
        reason=f"down the {slope:.1f} deg that give {published:g} at 25 deg; range over the published K_s and c. "
        f"Stronger soil needs less slip against the rolling resistance, so slip falls as phi grows (stand-in "
        f"{ends[PHI_DEG[0]]:+.3f} to {ends[PHI_DEG[1]]:+.3f}); it rises only beyond {_turn(rolling):.1f} deg downhill, "
        f"where the steepest was {published_value('slope-most')} deg",
    )


def _turn(rolling: Rolling) -> float:
    """Downhill slope on which the slip is the same at both ends of phi. [deg]"""
    weak, strong = map(_soil, PHI_DEG)

    def rise(slope_deg: float) -> float:
        return rolling.slip_ratio(strong, slope_deg) - rolling.slip_ratio(weak, slope_deg)

    return float(brentq(rise, 0.0, 20.0, xtol=1e-3))


def _side_slip(drives: Drives) -> dict[str, Answer]:
    by_modulus = medians(drives.stand_in, "side_slip_deg", K_Y)
    ratio = by_modulus[K_Y_MM[1]] / by_modulus[K_Y_MM[0]]
    published = published_value("side-slip-45mm") / published_value("side-slip-15mm")
    reason = (
        f"the slope across the path sets it, and {DEM}; it grows with K_y as published, {ratio:.2f} times from "
        f"15 to 45 mm where {published:.2f} times are published"
    )

    def at(modulus: float) -> Answer:
        return _example(drives, lambda one: medians(one, "side_slip_deg", K_Y)[modulus], reason)

    return {f"side-slip-{modulus:g}mm": at(modulus) for modulus in K_Y_MM}


def _ends(drives: Drives) -> dict[str, Answer]:
    parameters = drives.stand_in.parameters
    typical = (parameters[PHI] == TYPICAL_PHI_DEG) & (parameters[K_Y] == TYPICAL_K_Y_MM)
    unknown = "the path of the return, its ground and the soil identified for it are not published"
    return {
        "ends-within": _example(
            drives, lambda one: float(one.miss_m[one.finished].max()), f"{DEM}, nor are the rover's dimensions"
        ),
        "arrival": _example(
            drives,
            lambda one: float(one.miss_m[typical][0]),
            f"measured on the Moon; the example is the prediction for phi = {TYPICAL_PHI_DEG:g} deg, "
            f"K_y = {TYPICAL_K_Y_MM:g} mm",
        ),
        "return-identified": Answer(value=None, reason=unknown),
        "return-typical": Answer(value=None, reason=unknown),
    }


def drive_numbers(drives: Drives) -> list[Number]:
    """Every number of the drive beside ours, in the order of the table."""
    return judged("drive", _path(drives.plan) | _slip(drives) | _side_slip(drives) | _ends(drives))


SYMBOLS = {PHI: ("φ", "°"), K_Y: ("K$_y$", " mm")}
NAMES = {"slip_ratio": "slip ratio [-]  (negative: skid)", "side_slip_deg": "side slip angle |β| [°]"}
PUBLISHED = {
    PHI: dict(zip(PHI_DEG, ("slip-25deg", "slip-55deg"), strict=True)),
    K_Y: dict(zip(K_Y_MM, ("side-slip-15mm", "side-slip-45mm"), strict=True)),
}
COLUMNS = {"slip_ratio": 3, "side_slip_deg": 4}


def drive_pages(drives: Drives) -> Iterator[Figure]:
    """Two pages: fans of paths with their ends (Fig. 3), and slip and side slip by soil (Fig. S6)."""
    yield _fans(drives.stand_in)
    yield _slips(drives)


def _fans(prediction: Prediction) -> Figure:
    figure = page(6.8)
    parts: Any = figure.subfigures(2, 1)
    fans = ((PHI, K_Y, TYPICAL_K_Y_MM, "ab"), (K_Y, PHI, TYPICAL_PHI_DEG, "cd"))
    for part, (parameter, other, held, letters) in zip(parts, fans, strict=True):
        whole, ends = part.subplots(1, 2, width_ratios=(1.62, 1.0))
        members = np.flatnonzero(prediction.parameters[other] == held)
        symbol, unit = SYMBOLS[other]
        _draw_fan(whole, prediction, parameter, members, 0.1)
        whole.set_title(f"{letters[0]}  {SYMBOLS[parameter][0]} varied, {symbol} = {held:g}{unit}", loc="left")
        _draw_fan(ends, prediction, parameter, members, 0.02)
        _draw_ends(ends, prediction, parameter, members)
        ends.set_title(f"{letters[1]}  its ends", loc="left")
        varied, per = SYMBOLS[parameter]
        bar = part.colorbar(
            _scale(prediction.parameters[parameter]), ax=whole, orientation="horizontal", aspect=40, pad=0.03
        )
        bar.set_label(f"{varied} [{per.strip()}]")
        legend_below(part, (whole, ends), 3)
    title = (
        "predicted paths after Fig. 3 of Ding et al. (2024), on synthetic ground with craters and slopes as published; "
        "contours every 0.1 m, enlarged 0.02 m"
    )
    headline(figure, title, synthetic=True)
    return figure


def _scale(values: FloatArray) -> Any:
    # Beyond 0.88 colours would be too light on paper.
    colors = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.88, 256)))
    return ScalarMappable(Normalize(float(values.min()), float(values.max())), colors)


def _colors(values: FloatArray) -> Any:
    return _scale(values).to_rgba(values)


def _draw_fan(axes: Axes, prediction: Prediction, parameter: str, members: Any, contour_m: float) -> None:
    draw_ground(axes, prediction.terrain, map_window(prediction, prediction.terrain, 2.2), contour_m)
    draw_planned(axes, prediction)
    values = prediction.parameters[parameter][members]
    for member, color in zip(members, _colors(values), strict=True):
        part = prediction.paths[member, : max(int(prediction.recorded[member]), 1)]
        axes.plot(part[:, 0], part[:, 1], color=color, linewidth=1.2, zorder=6)
    start, end = prediction.planned[0], prediction.planned[-1]
    axes.plot(start[0], start[1], "o", color="white", markeredgecolor=INK, markersize=5, zorder=8)
    axes.plot(end[0], end[1], "*", color=GOLD, markeredgecolor=INK, markersize=11, zorder=8)


def _draw_ends(axes: Axes, prediction: Prediction, parameter: str, members: Any) -> None:
    """Enlarged about the destination, with the published circle and that which holds every end of all soils."""
    target = prediction.planned[-1, :2]
    values = prediction.parameters[parameter][members]
    ends = prediction.endpoints_m[members]
    look: dict[str, Any] = {"edgecolors": INK, "linewidths": 0.6, "s": 20, "zorder": 9}
    axes.scatter(ends[:, 0], ends[:, 1], c=_colors(values), **look)
    circles = (
        (published_value("ends-within"), LIMIT, ":", "published: no end beyond"),
        (float(prediction.miss_m[prediction.finished].max()), INK, "--", "ours, all soils: no end beyond"),
    )
    for radius, color, style, name in circles:
        text = f"{name} {radius:.3f} m"
        circle = Circle(tuple(target), radius, fill=False, edgecolor=color, linestyle=style, linewidth=1.4, zorder=7)
        axes.add_patch(circle)
        axes.plot([], [], color=color, linestyle=style, linewidth=1.4, label=text)
    half = 1.45 * max(radius for radius, *_ in circles)
    axes.set_xlim(target[0] - half, target[0] + half)
    axes.set_ylim(target[1] - half, target[1] + half)


def _slips(drives: Drives) -> Figure:
    figure = page(4.0)
    slip, side, rolling = figure.subplots(1, 3)
    _boxes(slip, drives.stand_in, PHI, "slip_ratio", "a  on the stand-in")
    _boxes(side, drives.stand_in, K_Y, "side_slip_deg", "b  on the stand-in")
    _rolling(rolling, drives)
    headline(figure, "slip by soil after Fig. S6 of Ding et al. (2024)", synthetic=True)
    return figure


def _boxes(axes: Axes, prediction: Prediction, parameter: str, quantity: str, title: str) -> None:
    """All wheel states for each value of a parameter, and the published medians at both ends."""
    values = prediction.states[..., COLUMNS[quantity]]
    values = np.abs(values) if quantity == "side_slip_deg" else values
    varied = prediction.parameters[parameter]
    places = np.unique(varied)
    states = [values[varied == place][prediction.reached[varied == place]].ravel() for place in places]
    width = 0.6 * float(np.diff(places).min())
    axes.boxplot(
        states, positions=places, widths=width, whis=(5, 95), showfliers=False, patch_artist=True,
        boxprops={"facecolor": "#bcd7e0"}, medianprops={"color": INK, "linewidth": 1.8}, manage_ticks=False,
    )  # fmt: skip
    axes.plot(*zip(*medians(prediction, quantity, parameter).items(), strict=True), color=INK, linewidth=1.0)
    ends = PUBLISHED[parameter]
    published = [published_value(name) for name in ends.values()]
    axes.plot(list(ends), published, "D--", color=LIMIT, markersize=5, zorder=5, label="published medians")
    axes.plot([], [], color=INK, linewidth=1.8, label="ours: quartiles, 5 to 95 %")
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    symbol, unit = SYMBOLS[parameter]
    axes.set_xlabel(f"{symbol} [{unit.strip()}]")
    axes.set_ylabel(NAMES[quantity])
    axes.set_xticks(places)
    axes.set_title(title, loc="left")
    _legend(axes)


def _rolling(axes: Axes, drives: Drives) -> None:
    """Steady rolling against the slope, and the medians on each ground: why the trend of the slip differs."""
    rolling, soil = Rolling.of(drives.rover), read_soil(SOIL)
    slopes = np.linspace(0.0, 12.0, 25)
    phis = np.array([PHI_DEG[0], TYPICAL_PHI_DEG, PHI_DEG[1]])
    for phi, color, dashes in zip(phis, _colors(phis), ("-", (0, (7, 2)), "-."), strict=True):
        weaker = soil.replace(friction_angle_deg=float(phi))
        slips = [rolling.slip_ratio(weaker, float(slope)) for slope in slopes]
        axes.plot(slopes, slips, color=color, linestyle=dashes, label=f"steady rolling, φ = {phi:g}°")
    for phi, color, dashes in zip(PHI_DEG, (_colors(phis)[0], _colors(phis)[-1]), ("--", ":"), strict=True):
        value = published_value(PUBLISHED[PHI][phi])
        axes.axhline(value, color=color, linestyle=dashes, linewidth=1.2, label=f"published median, φ = {phi:g}°")
    for name, prediction in drives.on.items():
        if name != STAND_IN and "down" in name:
            slope = float(name.partition("°")[0])
            for phi, color in zip(PHI_DEG, (_colors(phis)[0], _colors(phis)[-1]), strict=True):
                axes.plot(slope, medians(prediction, "slip_ratio", PHI)[phi], "o", color=color, markeredgecolor=INK)
    axes.plot([], [], "o", color="white", markeredgecolor=INK, label="the rover on planes")
    steepest = published_value("slope-most")
    axes.axvline(steepest, color="0.5", linewidth=0.8, label=f"steepest, published: {steepest}°")
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes.set_xlabel("slope, downhill [°]")
    axes.set_ylabel(NAMES["slip_ratio"])
    axes.set_title("c  slip against slope, no terrain", loc="left")
    _legend(axes)


def _legend(axes: Axes) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False)
