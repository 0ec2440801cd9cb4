"""The rover as the multibody model sees it: a chassis on a rocker-bogie suspension, its motors, battery and panels."""

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.constants import LUNAR_GRAVITY, gravity_of
from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.io.documents import record_of
from lunarsci.names import one_of
from lunarsci.ranges import FINITE, NOT_NEGATIVE, POSITIVE, check_ranges, refuse
from lunarsci.regolith.columns import written_for
from lunarsci.regolith.prior import LOAD_PRESSURE_PA, Law, Question, question
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.rovers import RoverDescription, read_rover

SOLAR_CONSTANT_W_M2 = 1360.8
"""Power of sunlight through a square metre at 1 au: Kopp & Lean (2011), 10.1029/2010GL045777. [W/m2]"""
PAIRS = ("front", "middle", "rear")
"""Pairs of wheels, from front to rear; a rover without bogies has no middle one."""
BOGIES = ("rear", "front", "none")
"""Where the bogies are, see `Rover.bogie`."""
HUNG = {"rear": ("middle", "rear"), "front": ("front", "middle"), "none": ()}
"""Pairs of wheels on the bogies, by where these are; the others are on the rockers."""
FALLBACK_SLOPE_DEG = 15.0
"""Steepest slope of a rover whose file has none: assumed, cautious for a rocker-bogie. [deg]"""
DENSEST_KG_M3 = 22_600.0
"""Osmium, 22.59 g/cm3: CRC Handbook of Chemistry and Physics, 97th ed., Haynes (2016). [kg/m3]"""
BELLY_RADII = Law("ln", 2.1, 0.6, "1.5 to 2.4 of Lunokhod, MER, Curiosity and Yutu-2, 0.5 of RoSEy; width assumed")
"""Height of the belly above level ground, in radii of the wheels; assumed."""
AXLE_RADII = Law("ln", 4.0, 0.4, "2.5 to 6 of rovers that drove on the Moon and Mars; width assumed")
"""From one axle to the next, in radii of the wheels; assumed."""
LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2}
"""In metres, by definition."""
MASS_UNITS = {"g": 1e-3, "t": 1e3}
"""In kilograms, by definition."""
PLACES = "body_center_m front_wheel_m middle_wheel_m rear_wheel_m bogie_pivot_m"
VECTORS = ("body_inertia_kg_m2", *PLACES.split())
RANGES = {
    POSITIVE: "body_kg wheel_kg body_inertia_kg_m2 rocker_pivot_y_m max_speed_m_s gravity_m_s2",
    NOT_NEGATIVE: "joint_damping_n_m_s steering_offset_m",
    FINITE: PLACES,
    "(0, 90]": "max_slope_deg",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Motors:
    """The motor of each wheel with its gears, seen at the wheel; all are alike.

    Attributes
    ----------
    stall_torque_nm : torque at which it stands still. [N m]
    continuous_torque_nm : most torque that it gives for long, at most the stall torque. [N m]
    no_load_rate_rad_s : how fast it turns without load; torque falls in a straight line to 0 there. [rad/s]
    efficiency : mechanical power at the wheel over electrical power, of motor and gears, taken as constant. [-]
    idle_w : electrical power of a motor that turns without load. [W]

    Raises ParameterError outside these ranges.
    """

    stall_torque_nm: float
    continuous_torque_nm: float
    no_load_rate_rad_s: float
    efficiency: float
    idle_w: float = 0.0

    def __post_init__(self) -> None:
        most = f"(0, {self.stall_torque_nm}]"
        positive = "stall_torque_nm no_load_rate_rad_s"
        names = {POSITIVE: positive, most: "continuous_torque_nm", "(0, 1]": "efficiency", NOT_NEGATIVE: "idle_w"}
        check_ranges(self, names, "motors")

    def torque_nm(self, rate_rad_s: npt.ArrayLike) -> FloatArray:
        """Most torque that the motor gives for long at rates of the wheel, 0 from the no-load rate on. [N m]"""
        line = self.stall_torque_nm * (1.0 - np.abs(rate_rad_s) / self.no_load_rate_rad_s)
        return np.asarray(np.clip(line, 0.0, self.continuous_torque_nm))


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerSupply:
    """Battery, panels, and what draws power beside the motors.

    Attributes
    ----------
    battery_wh : energy of the full battery. [W h]
    electronics_w : draw of everything but the wheels' motors while the rover drives, heaters included. [W]
    panel_area_m2 : area of solar cells, 0 for none. They lie flat on top of the chassis and tilt with it. [m2]
    cell_efficiency : electrical power over sunlight, with dust and wiring. [-]
    least_charge : share of the full battery that must always be left, 0 to less than 1. [-]
    standby_w : draw of everything while the rover stands between drives; as while it drives where it is None. [W]

    Raises ParameterError outside these ranges.
    """

    battery_wh: float
    electronics_w: float
    panel_area_m2: float = 0.0
    cell_efficiency: float = 0.3
    least_charge: float = 0.0
    standby_w: float | None = None

    def __post_init__(self) -> None:
        names = {POSITIVE: "battery_wh", NOT_NEGATIVE: "electronics_w panel_area_m2 standby_w"}
        check_ranges(self, names | {"(0, 1]": "cell_efficiency", "[0, 1)": "least_charge"}, "power")

    @property
    def standing_w(self) -> float:
        """Draw of everything while the rover stands. [W]"""
        return self.electronics_w if self.standby_w is None else self.standby_w


Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Body:
    """Underside of the chassis: a rectangle in the rover's frame, level with it.

    Attributes
    ----------
    length_m, width_m : along x and y, > 0. [m]
    belly_z_m : its height above the rover's origin. [m]
    center_x_m : its centre along x. [m]

    Raises ParameterError for lengths that are not positive and numbers that are not finite.
    """

    length_m: float
    width_m: float
    belly_z_m: float
    center_x_m: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, {POSITIVE: "length_m width_m", FINITE: "belly_z_m center_x_m"}, "rover body")


class RoverVector(NamedTuple):
    """What the compiled formulas read of a rover, in SI units; more of each number is in `Rover`.

    Wheels are in the order of `Rover.wheels`: front to rear, left before right.

    Attributes
    ----------
    body_kg : mass of the chassis. [kg]
    wheel_kg : mass of one wheel with its share of the arm. [kg]
    inertia : principal moments of the chassis. (3,) [kg m2]
    center : its centre of mass. (3,) [m]
    pivot_y : half the distance between the rocker pivots. [m]
    bogie : bogie pivot from the rocker pivot, of the left side; zeros without bogies. (3,) [m]
    arms : wheel centres from the pivot that they hang on, in the rover's frame. (wheels, 3) [m]
    hung : 1 where a wheel hangs on a bogie, 0 on a rocker. (wheels,)
    bogies : whether there are any.
    steering_offset : how far outboard of its steering axis a wheel stands. [m]
    joint_damping : torque of a joint over its rate. [N m s]
    gravity : [m/s2]
    """

    body_kg: float
    inertia: FloatArray
    center: FloatArray
    wheel_kg: float
    pivot_y: float
    bogie: FloatArray
    arms: FloatArray
    hung: FloatArray
    bogies: bool
    steering_offset: float
    joint_damping: float
    gravity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Rover:
    """A rocker-bogie rover; x forward, y left, z up, origin midway between the rocker pivots.

    Attributes
    ----------
    name : as in the rover file.
    wheel : the wheel of the wheel-soil formulas; all are alike.
    body_kg, wheel_kg : mass of the chassis, and of one wheel with its share of the arm as a point mass. [kg]
    body_inertia_kg_m2 : principal moments of the chassis about its own centre of mass, along x, y, z. [kg m2]
    body_center_m : centre of mass of the chassis. [m]
    rocker_pivot_y_m : half the distance between the rocker pivots. [m]
    bogie : `rear` carries middle and rear wheels on a bogie, `front` front and middle ones; `none` is a four-wheeler
        whose front and rear wheels are on the rockers.
    front_wheel_m, middle_wheel_m, rear_wheel_m : wheel centres, from the bogie pivot where they hang on a bogie, else
        from the rocker pivot; middle_wheel_m is left out without bogies. [m]
    bogie_pivot_m : bogie pivot from the rocker pivot, left out without bogies. [m]
    joint_damping_n_m_s : viscous friction of each pivot. [N m s]
    steered : which of `front`, `middle`, `rear` are steered.
    steering_offset_m : distance of a wheel from its steering axis, which is inboard of it. [m]
    max_speed_m_s : highest commanded speed. [m/s]
    gravity_m_s2 : acceleration of gravity. [m/s2]
    body : underside of the chassis, None where unknown.
    max_slope_deg : the steepest slope that it may stand on, above 0, at most 90. [deg]
    max_slope_source : where that is from; empty where it is assumed.
    motors, power : of the wheels, and battery and panels; None where unknown. No force of a drive depends on them.

    The left rocker turns by +rho about the chassis' y axis, the right one by -rho: a differential does that whether it
    is a bar outside or gears inside the body. Each bogie turns about its rocker. Raises ParameterError for masses,
    moments or lengths that are not positive, for wheels that do not follow each other from front to rear, and for what
    no rover can be.
    """

    name: str
    wheel: Wheel
    body_kg: float
    wheel_kg: float
    body_inertia_kg_m2: Vector3
    body_center_m: Vector3
    rocker_pivot_y_m: float
    front_wheel_m: Vector3
    rear_wheel_m: Vector3
    joint_damping_n_m_s: float
    steered: tuple[str, ...]
    max_speed_m_s: float
    bogie: str = "rear"
    middle_wheel_m: Vector3 | None = None
    bogie_pivot_m: Vector3 | None = None
    steering_offset_m: float = 0.0
    gravity_m_s2: float = LUNAR_GRAVITY.value
    body: Body | None = None
    motors: Motors | None = None
    power: PowerSupply | None = None
    max_slope_deg: float = FALLBACK_SLOPE_DEG
    max_slope_source: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, RANGES, "rover")
        refuse(self._ill_made())
        refuse(_impossible(self))

    def _ill_made(self) -> Iterator[str]:
        if self.bogie not in BOGIES:
            yield f"rover bogie is '{self.bogie}'; {one_of(self.bogie, BOGIES)}"
        for name in ("middle_wheel_m", "bogie_pivot_m"):
            if (getattr(self, name) is None) != (self.bogie == "none"):
                wanted = "leave it out" if self.bogie == "none" else "give it"
                yield f"rover with bogie '{self.bogie}': {wanted}: {name}"
        if unknown := set(self.steered) - set(self.pairs):
            yield f"rover steered_wheels has '{min(unknown)}'; {one_of(min(unknown), self.pairs)}"
        if not (np.diff(self.wheel_positions_m[::2, 0]) < 0).all():
            yield "the rover's wheels must follow each other from front to rear; check their x"

    @property
    def pairs(self) -> tuple[str, ...]:
        """Pairs of wheels, from front to rear."""
        return PAIRS if self.bogie != "none" else ("front", "rear")

    @property
    def wheels(self) -> tuple[str, ...]:
        """Names of the wheels in the order of all results: FL, FR, (ML, MR,) RL, RR."""
        return tuple(pair[0].upper() + side for pair in self.pairs for side in "LR")

    @property
    def written(self) -> str:
        """The rover as its tables name it."""
        return written_for(self.name, self.wheel)

    @property
    def mass_kg(self) -> float:
        """Mass of the whole rover. [kg]"""
        return self.body_kg + len(self.wheels) * self.wheel_kg

    @property
    def load_n(self) -> float:
        """What a wheel carries on level ground, in the mean. [N]"""
        return self.mass_kg * self.gravity_m_s2 / len(self.wheels)

    @property
    def wheel_positions_m(self) -> FloatArray:
        """Wheel centres with all joints at zero, in the order of `wheels`. (n, 3) [m]"""
        side = np.array([0.0, self.rocker_pivot_y_m, 0.0])
        rows = [arm + side + hung * self._pivot() for arm, hung in zip(self._arms(), self._hung(), strict=True)]
        return np.array([row * (1.0, sign, 1.0) for row in rows for sign in (1.0, -1.0)])

    @property
    def turning_x_m(self) -> float:
        """Where along x the turning centre lies: beside the wheels that do not steer, or the origin if all do. [m]"""
        fixed = ~self.steered_mask
        return float(self.wheel_positions_m[fixed, 0].mean()) if fixed.any() else 0.0

    @property
    def tightest_curvature_per_m(self) -> float:
        """Largest curvature whose turning centre lies outside the wheels, with a tenth to spare. [1/m]"""
        return 0.9 / (self.rocker_pivot_y_m + self.steering_offset_m)

    def _arms(self) -> FloatArray:
        return np.array([getattr(self, f"{pair}_wheel_m") for pair in self.pairs], dtype=float)

    def _hung(self) -> FloatArray:
        return np.array([float(pair in HUNG[self.bogie]) for pair in self.pairs])

    def _pivot(self) -> FloatArray:
        return np.array(self.bogie_pivot_m or (0.0, 0.0, 0.0), dtype=float)

    @property
    def steered_mask(self) -> BoolArray:
        """Which wheels are steered, in the order of `wheels`."""
        return np.repeat([pair in self.steered for pair in self.pairs], 2)

    def vector(self) -> RoverVector:
        """The numbers that the compiled formulas take, in SI units."""
        arms = np.repeat(self._arms(), 2, axis=0)
        arms[1::2, 1] *= -1
        return RoverVector(
            float(self.body_kg),
            np.array(self.body_inertia_kg_m2, dtype=float),
            np.array(self.body_center_m, dtype=float),
            float(self.wheel_kg),
            float(self.rocker_pivot_y_m),
            self._pivot(),
            arms,
            np.repeat(self._hung(), 2),
            self.bogie != "none",
            float(self.steering_offset_m),
            float(self.joint_damping_n_m_s),
            float(self.gravity_m_s2),
        )


def with_gravity(rover: Rover, gravity: str | None) -> Rover:
    """The rover on `moon`, `mars` or `earth`, or where gravity is a number in m/s2; as it is for None.

    Raises ParameterError for anything else.
    """
    if gravity is None:
        return rover
    return replace(rover, gravity_m_s2=gravity_of(gravity))


def build_rover(rover: str | RoverDescription, *, varied: bool = False) -> Rover:
    """The rover of a name such as `yutu2`, a TOML file, or a description already read. Raises DataError.

    Motors must reach its top speed, but for a `varied` description, whose plans may be slower.
    """
    description = read_rover(rover) if isinstance(rover, str) else rover
    mass, suspension = description.table("mass"), description.table("suspension")
    steering, drive = description.table("steering"), description.table("drive")
    suspended: tuple[str, ...] = ("front_wheel_m", "rear_wheel_m", "rocker_pivot_y_m", "joint_damping_n_m_s")
    bogie = str(suspension.get("bogie", "rear"))
    suspended += () if bogie == "none" else ("middle_wheel_m", "bogie_pivot_m")
    of_others = ((mass, ("body_kg", "wheel_kg", "body_inertia_kg_m2", "body_center_m")), (drive, ("max_speed_m_s",)))
    parts: dict[str, type[Any]] = {"body": Body, "motors": Motors, "power": PowerSupply}
    try:
        numbers = {n: _numbers(table[n], n) for table, names in (*of_others, (suspension, suspended)) for n in names}
        built = Rover(
            name=description.name,
            wheel=read_wheel(description),
            bogie=bogie,
            steered=tuple(str(pair) for pair in steering["steered_wheels"]),
            steering_offset_m=float(steering.get("offset_m", 0.0)),
            **_slope(description),
            **numbers,
            **{name: record_of(kind, description.tables[name], f"[{name}]")
               for name, kind in parts.items() if name in description.tables},
        )  # fmt: skip
        if not varied:
            check_speed(built)
            warn_of_unusual(built, description.origin)
        return built
    except KeyError as error:
        raise DataError(f"{description.origin}: no {error}; add it as in the yutu2 file") from error
    except DataError:
        raise
    except (TypeError, ValueError) as error:
        raise DataError(f"{description.origin}: {error}") from error


def _slope(description: RoverDescription) -> dict[str, Any]:
    """The steepest slope of a rover's [limits], and where it is from unless it is assumed."""
    given, key = description.tables.get("limits", {}), "limits.max_slope_deg"
    if "max_slope_deg" not in given:
        return {}
    source = description.sources.get(key, f"[limits] of {description.origin}")
    return {
        "max_slope_deg": float(given["max_slope_deg"]),
        "max_slope_source": "" if key in description.assumed else source,
    }


def _numbers(value: Any, name: str) -> Any:
    """A number, or the three of a vector."""
    if name not in VECTORS:
        return float(value)
    if not isinstance(value, list) or len(value) != 3:
        raise ParameterError(f"{name} is {value}; give a list of three numbers")
    return tuple(map(float, value))


def rover_questions(rover: Rover) -> list[Question]:
    """Whether its belly is as high, its axles as far apart and its wheels as loaded as those of rovers are."""
    wheel, asked = rover.wheel, []
    apart = np.linalg.norm(np.diff(rover.wheel_positions_m[::2], axis=0), axis=1).max() / wheel.radius_m
    asked.append(question("axle to axle [wheel radii]", float(apart), AXLE_RADII, LENGTH_UNITS))
    pressure = rover.load_n / (wheel.radius_m * wheel.width_m)
    asked.append(question("weight over the wheels' radius x width [Pa]", pressure, LOAD_PRESSURE_PA, MASS_UNITS))
    if rover.body is not None:
        level = rover.body.belly_z_m - float(rover.wheel_positions_m[:, 2].min()) + wheel.radius_m
        if level > 0:
            asked.append(question("belly over the ground [wheel radii]", level / wheel.radius_m, BELLY_RADII, {}))
    return [one for one in asked if one is not None]


def warn_of_unusual(rover: Rover, called: str) -> None:
    """Warn of numbers that would be likely in another unit, or that no rover has."""
    for asked in rover_questions(rover):
        warnings.warn(f"{called}: {asked.doubt}", LunarSciWarning, stacklevel=3)


def _impossible(rover: Rover) -> Iterator[str]:
    """Why a rover cannot be built, with the unit that is likely.

    Wheels overlap; the centre of mass is not between them, or higher than the rover is long or wide; moments of a body
    obey I1 + I2 >= I3, and its mass is not further from its centre than the rover is large; nothing is denser than
    osmium, neither a wheel nor the box about the rover.
    """
    wheel, places, kg = rover.wheel, rover.wheel_positions_m, rover.body_kg
    outer, gap = wheel.radius_m + wheel.grouser_height_m, np.linalg.norm(np.diff(places[::2], axis=0), axis=1).min()
    if 2.0 * outer > gap:
        yield (f"wheels of {2 * outer:.3g} m across do not fit {gap:.3g} m from one axle to the next; they meet "
               "(is wheel.radius_m a diameter, or in mm?)")  # fmt: skip
    if wheel.width_m > 2.0 * (rover.rocker_pivot_y_m + rover.steering_offset_m):
        yield f"wheels {wheel.width_m:.3g} m wide meet in the middle of the rover; is wheel.width_m in mm?"
    center = (kg * np.array(rover.body_center_m) + rover.wheel_kg * places.sum(axis=0))[:2] / rover.mass_kg
    span, given = np.ptp(places, axis=0), f"body_center_m is {list(rover.body_center_m)}"
    length, width = float(span[0]) + 2.0 * outer, float(span[1]) + wheel.width_m
    height = float(rover.body_center_m[2] - places[:, 2].min() + outer)
    if (center < places.min(axis=0)[:2]).any() or (center > places.max(axis=0)[:2]).any():
        yield f"{given}: the rover falls over, its centre of mass is not between its wheels; in mm?"
    if not 0 < height <= max(length, width):
        yield (f"{given}: {height:.3g} m above the ground, for a rover {max(length, width):.3g} m long or wide; "
               "is it in mm?")  # fmt: skip
    moments, given = sorted(rover.body_inertia_kg_m2), f"body_inertia_kg_m2 is {list(rover.body_inertia_kg_m2)}"
    if moments[0] + moments[1] < moments[2] * (1 - 1e-6):
        yield f"{given}; of no body is one moment more than the sum of the others"
    if moments[2] > kg * (length**2 + width**2):
        yield f"{given}: more than {kg:g} kg have {math.hypot(length, width):.3g} m away; is it in g cm2?"
    volumes = {"wheel_kg": math.pi * outer**2 * wheel.width_m, "body_kg": length * width * 2.0 * height}
    for name, volume in volumes.items():
        if (mass := getattr(rover, name)) > DENSEST_KG_M3 * volume:
            yield f"{name} is {mass:g} in {volume:.3g} m3, denser than osmium; is it in g?"


def check_speed(rover: Rover) -> None:
    """Raises ParameterError for a top speed beyond that of wheels that turn without load."""
    if rover.motors is None:
        return
    reached = rover.motors.no_load_rate_rad_s * (rover.wheel.radius_m + rover.wheel.grouser_height_m)
    if rover.max_speed_m_s > reached:
        raise ParameterError(
            f"max_speed_m_s is {rover.max_speed_m_s:g}, but motors without load reach {reached:.3g} m/s; is it in mm/s?"
        )


def check_turning(rover: Rover, radius_m: float | None) -> None:
    """Raises RequestError for arcs that a rover cannot drive: their centre would lie between its wheels."""
    least = 1.0 / rover.tightest_curvature_per_m
    if radius_m is not None and not radius_m >= least * (1 - 1e-9):
        raise RequestError(
            f"`turning_radius` is {radius_m:g} m, and the smallest arc of {rover.name} has {least:.3g} m: within it "
            f"the turning centre lies between the wheels; give {math.ceil(100 * least) / 100:g} m or more"
        )
