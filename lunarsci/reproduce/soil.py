"""Soil parameters of Ding et al. (2024): which of their numbers follow from what they publish.

Wheel forces are not published. Two of the numbers stand for them here: K_s at 8 mm gives F_N / b, and the friction
angle at a slip ratio of -0.075 gives F_DP, under the one reading of the shear law that has a solution there.

The slip at which a rover rolls steadily down a slope: six equal wheels, no terrain, no rover between them.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.compare import Site, compare_site, nearest, reference_soils
from lunarsci.regolith.forces import WheelForces, closed_form_forces, contact_angles
from lunarsci.regolith.identify import Assumptions, Identification, identify
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates
from lunarsci.regolith.traction import sinkage_under_load
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.reproduce.numbers import Answer, Number, judge, published_numbers
from lunarsci.twin.rover import Rover

STEEPEST_DEG = 30.0
"""Slopes and slips within which steady rolling is looked for; assumed, beyond both of Ding et al. (2024)."""
SLIPS = (-0.6, 0.6)
"""As the model holds: see `MAX_VALID_SLIP`."""


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
        return cls(rover.wheel, rover.mass_kg * rover.gravity_m_s2 / len(rover.wheels))

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
        text = f"no slip within {SLIPS[1]} lets {self.weight_n:.1f} N a wheel roll steadily down {slope_deg:g} deg"
        return _root(lambda slip: self.surplus_n(soil, slope_deg, slip), SLIPS, text)

    def slope_deg(self, soil: Soil, slip_ratio: float) -> float:
        """Slope down which a wheel rolls steadily at a slip ratio; negative is uphill. [deg]

        Raises ParameterError where none within 30 deg does.
        """
        text = f"on no slope within {STEEPEST_DEG:g} deg {self.weight_n:.1f} N a wheel roll at a slip of {slip_ratio:g}"
        return _root(lambda slope: self.surplus_n(soil, slope, slip_ratio), (-STEEPEST_DEG, STEEPEST_DEG), text)


def _root(function: Callable[[float], float], span: tuple[float, float], text: str) -> float:
    if function(span[0]) * function(span[1]) > 0:
        raise ParameterError(f"{text}; take another rover or soil")
    return float(brentq(function, *span, xtol=1e-9))


MEAN_SINKAGE_M, SLIP = 0.008, -0.075
"""Mean sinkage and slip ratio of the wheels, Ding et al. (2024), 10.1038/s41467-024-46233-8, Results."""
STIFFNESS, TYPICAL, PHI_DEG, COHESION_PA = 1443.0, 820.0, 21.5, 520.0
"""K_s at 8 mm and typical K_s [kPa m^-N], phi and the cohesion it was found at: Ding et al. (2024), Results."""
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
DRAWS = 20_000
SOILS, NO_EVIDENCE = 400, 0.5
"""Soils to measure what chance gives, and the share of them from which on a rank says nothing; assumed."""
EXACT = MeasurementErrors(sinkage_m=0, force_relative=0, travel_relative=0, side_slip_relative=0)
WHEEL_LOAD = "F_N / b = 213.5 N/m, which only this number sets"
SLIP_BRANCH = "slip branch of the shear law at |s|"


def published_soil(stiffness: float = STIFFNESS, cohesion: float = COHESION_PA, phi: float = PHI_DEG) -> Soil:
    """The soil of the published numbers: N = 1, K_x = 17.8 mm, lateral pair of one corner."""
    return Soil(
        stiffness_kpa_m_n=stiffness,
        sinkage_exponent=1.0,
        cohesion_pa=cohesion,
        friction_angle_deg=phi,
        shear_modulus_mm=17.8,
        external_friction_angle_deg=LATERAL_CORNERS[0][1],
        lateral_modulus_mm=LATERAL_CORNERS[0][0],
    )


@cache
def stand_in_forces(wheel: Wheel) -> WheelForces:
    """On the mean wheel, by the two numbers that stand for them."""
    return closed_form_forces(wheel, published_soil(), MEAN_SINKAGE_M, SLIP, reading="slip-branch")


def identified(
    wheel: Wheel,
    sinkage_m: float,
    assumptions: Assumptions | None = None,
    *,
    errors: MeasurementErrors = EXACT,
    shear: bool = False,
) -> Identification:
    """Of one state with the forces of the mean wheel; `shear` takes the slip branch."""
    forces = stand_in_forces(wheel)
    values = np.array([[sinkage_m, SLIP, np.nan, float(forces.normal_force_n), float(forces.drawbar_pull_n), np.nan]])
    sigmas = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        reading = "slip-branch" if shear else "signed"
        return identify(WheelStates(("mean",), values, sigmas), wheel, assumptions, reading=reading, draws=DRAWS)  # type: ignore[arg-type]


def _value(identification: Identification, name: str) -> float:
    value = identification.site[name].value
    return float("nan") if value is None else value


def _sd(identification: Identification, name: str) -> float:
    sigma = identification.site[name].sigma
    return float("nan") if sigma is None else sigma


def _bearing(wheel: Wheel) -> dict[str, Callable[[], Answer]]:
    stiff = Assumptions(stiffness_kpa_m_n=STIFFNESS)
    both = MeasurementErrors()

    def spread(errors: MeasurementErrors, reason: str) -> Answer:
        return Answer(value=_sd(identified(wheel, 0.005, stiff, errors=errors), "exponent"), reason=reason)

    return {
        "stiffness-8mm": lambda: Answer(
            value=_value(identified(wheel, 0.008), "stiffness_kpa_m_n"),
            set_by_itself=True,
            reading=WHEEL_LOAD,
            reason="a width of 0.15 m would mean 32 N a wheel, 118 kg on six; b and F_N cannot be told apart",
        ),
        "stiffness-15mm": lambda: Answer(
            value=_value(identified(wheel, 0.015), "stiffness_kpa_m_n"), reason="same forces as at 8 mm"
        ),
        "exponent-8mm": lambda: Answer(
            value=_value(identified(wheel, 0.008, Assumptions(stiffness_kpa_m_n=TYPICAL)), "exponent"),
            reason="follows from K_s = 1443 at N = 1 and 8 mm whatever the force, which both share",
        ),
        "exponent-5mm": lambda: Answer(
            value=_value(identified(wheel, 0.005, stiff), "exponent"), reason="same forces as at 8 mm"
        ),
        "sinkage-typical": lambda: _typical_sinkage(wheel),
        "exponent-sd-sinkage": lambda: spread(replace(both, force_relative=0.0), "sinkage errs by 0.33 mm"),
        "exponent-sd-forces": lambda: spread(
            replace(both, sinkage_m=0.0), "forces err by 10 %/3, independently; the text names only the 10 %"
        ),
        "exponent-sd": lambda: spread(both, "0.33 mm and 10 %/3 together"),
        "stiffness-sd-15mm": lambda: Answer(
            value=_sd(identified(wheel, 0.015, errors=both), "stiffness_kpa_m_n"), reason="0.33 mm and 10 %/3 together"
        ),
        "bearing-capacity": lambda: _capacity(wheel),
        "nearest-terrestrial": lambda: _nearest_terrestrial(wheel),
    }


def _typical_sinkage(wheel: Wheel) -> Answer:
    load = float(stand_in_forces(wheel).normal_force_n)
    sinkage_m = sinkage_under_load(wheel, published_soil(TYPICAL), load, SLIP, reading="slip-branch")
    return Answer(value=1e3 * sinkage_m, reason=f"under the same {load:.1f} N; shear at c = 520 Pa, phi = 21.5 deg")


def _capacity(wheel: Wheel) -> Answer:
    forces = stand_in_forces(wheel)
    theta_1 = contact_angles(MEAN_SINKAGE_M, SLIP, wheel.vector())[0]
    mean = float(forces.normal_force_n) / (wheel.width_m * wheel.radius_m * theta_1)
    largest = _value(identified(wheel, MEAN_SINKAGE_M), "stiffness_kpa_m_n") * _depth(wheel)
    return Answer(
        value=mean / 1e3,
        reading="mean pressure F_N / (r b theta_1)",
        reason=f"the largest stress sigma_m is {largest:.1f} kPa",
    )


def _depth(wheel: Wheel) -> float:
    theta_1, _, _, theta_m = contact_angles(MEAN_SINKAGE_M, SLIP, wheel.vector())
    return float(wheel.radius_m * (np.cos(theta_m) - np.cos(theta_1)))


def _nearest_terrestrial(wheel: Wheel) -> Answer:
    """By the nearest of the three dots of Fig. 4a."""
    best: dict[str, float] = {}
    for stiffness, exponent in BEARING_DOTS:
        site = Site(stiffness_kpa_m_n=stiffness, sinkage_exponent=exponent)
        for item in nearest(compare_site(site, wheel.width_m), "bearing"):
            if item.soil.kind == "terrestrial" and item.bearing is not None:
                best[item.soil.name] = min(item.bearing, best.get(item.soil.name, np.inf))
    order = sorted(best, key=lambda name: best[name])
    named = next(name for name in order if "Michigan" in name)
    return Answer(
        value=float(order.index(named) + 1),
        reason=f"rms ln ratio of pressures to the nearest of the three dots {best[named]:.2f}; next is {order[1]} with "
        f"{best[order[1]]:.2f}; of {SOILS} soils drawn from the lunar priors it is the nearest to "
        f"{100 * _share_of_soils(named, 'bearing', wheel):.0f} %",
    )


def _shear(wheel: Wheel) -> dict[str, Callable[[], Answer]]:
    def angle() -> Answer:
        solved = identified(wheel, MEAN_SINKAGE_M, shear=True)
        needed_n = float(stand_in_forces(wheel).drawbar_pull_n)
        physical = closed_form_forces(wheel, published_soil(), MEAN_SINKAGE_M, SLIP)
        pull = float(physical.drawbar_pull_n)
        slope = math.degrees(math.atan2(-pull, float(physical.normal_force_n)))
        return Answer(
            value=_value(solved, "friction_angle_deg"),
            set_by_itself=True,
            reading=f"{SLIP_BRANCH}; F_DP = {needed_n:.2f} N, which only this number sets",
            reason=f"with the physical sign it would take {pull:.1f} N, a mean slope of {slope:.0f} deg, where the "
            "steepest was 8.9 deg",
        )

    return {
        "friction-angle": angle,
        "friction-angle-sd": lambda: _angle_spread(wheel),
        "cohesion": lambda: _cohesion(wheel),
        "nearest-mission": lambda: _nearest_mission(wheel),
    }


def _angle_spread(wheel: Wheel) -> Answer:
    def spread(of: Wheel) -> float:
        solved = identified(of, MEAN_SINKAGE_M, errors=MeasurementErrors(sinkage_m=0.0), shear=True)
        return _sd(solved, "friction_angle_deg")

    short = replace(wheel, grouser_height_m=SHORT_LUG_M)
    stiffness = _value(identified(short, 0.015), "stiffness_kpa_m_n")
    return Answer(
        value=spread(wheel),
        reading=f"{SLIP_BRANCH}; slip ratio errs by 4 %/3 of the way",
        reason=f"the lug height is not published: {1e3 * SHORT_LUG_M:.0f} mm instead of "
        f"{1e3 * wheel.grouser_height_m:.0f} mm give {spread(short):.2f} deg, and {stiffness:.1f} kPa m^-N at 15 mm",
    )


def _cohesion(wheel: Wheel) -> Answer:
    soil = published_soil(cohesion=CORNER[1], phi=CORNER[0])
    pull = float(closed_form_forces(wheel, soil, MEAN_SINKAGE_M, -1e-6, reading="slip-branch").drawbar_pull_n)
    return Answer(
        value=None,
        reason=f"lies on another curve of Fig. 4b, slip ratio -> 0, whose drawbar pull is not published; it takes "
        f"{pull:.2f} N there and {float(stand_in_forces(wheel).drawbar_pull_n):.2f} N at -0.075",
    )


def _nearest_mission(wheel: Wheel) -> Answer:
    """By the farthest corner of the rectangle of Fig. 4b."""
    worst: dict[str, float] = {}
    for cohesion in (COHESION_PA, CORNER[1]):
        for phi in (PHI_DEG, CORNER[0]):
            site = Site(cohesion_pa=cohesion, friction_angle_deg=phi)
            for item in nearest(compare_site(site, wheel.width_m), "strength"):
                if item.soil.kind == "lunar" and "Longji" not in item.soil.name and item.strength is not None:
                    worst[item.soil.name] = max(item.strength, worst.get(item.soil.name, 0.0))
    order = sorted(worst, key=lambda name: worst[name])
    named = next(name for name in order if "Apollo 12, direct shear" in name)
    share = _share_of_soils(named, "strength", wheel)
    return Answer(
        value=float(order.index(named) + 1),
        determined=share < NO_EVIDENCE,
        reason=f"of {SOILS} soils drawn from the lunar priors none is nearer to {100 * share:.0f} %, whatever they "
        f"are: its ranges (0.1-3.1 kPa, 13-56 deg) are the widest of all; next here is {order[1]} at "
        f"{worst[order[1]]:.2f}",
    )


def _share_of_soils(name: str, aspect: str, wheel: Wheel) -> float:
    """Share of soils of the priors to which no reference of a kind is nearer than the named one: what chance gives.

    Missions (`strength`) but the site itself, or terrestrial soils (`bearing`).
    """
    kind = "lunar" if aspect == "strength" else "terrestrial"
    soils = [soil for soil in reference_soils() if soil.kind == kind and "Longji" not in soil.name]
    drawn = first_belief().draws(SOILS, seed=0)
    names = ("cohesion_pa", "friction_angle_deg") if kind == "lunar" else ("stiffness_kpa_m_n", "sinkage_exponent")
    hits = 0
    for values in zip(*(drawn[each] for each in names), strict=True):
        site = Site(**dict(zip(names, map(float, values), strict=True)))
        distances = {
            item.soil.name: getattr(item, aspect) for item in nearest(compare_site(site, wheel.width_m, soils), aspect)
        }
        hits += distances[name] <= min(distances.values())
    return hits / SOILS


def _lateral(wheel: Wheel) -> dict[str, Callable[[], Answer]]:
    def corner(k: int) -> Answer:
        modulus, angle = LATERAL_CORNERS[k]
        soil = replace(published_soil(), external_friction_angle_deg=angle, lateral_modulus_mm=modulus)
        forces = [
            float(closed_form_forces(wheel, soil, MEAN_SINKAGE_M, SLIP, beta).lateral_force_n)
            for beta in SIDE_SLIPS_DEG
        ]
        return Answer(
            value=None,
            reason=f"lateral forces are not published; with K_y = {modulus:g} mm it takes {forces[0]:.2f} N at 0.5 deg "
            f"of side slip or {forces[1]:.2f} N at 3 deg, and no one force gives both ends of the range",
        )

    return {"external-friction-low": lambda: corner(0), "external-friction-high": lambda: corner(1)}


def soil_numbers(wheel: Wheel | None = None) -> list[Number]:
    """Every number of the soil beside ours, in the order of the table.

    Parameters
    ----------
    wheel : Yutu-2's by default; its lug height is not published and moves some of the answers.
    """
    of = wheel or read_wheel("yutu2")
    answers = _bearing(of) | _shear(of) | _lateral(of)
    return [judge(row, answers[row["id"]]()) for row in published_numbers("soil")]
