"""The rover as the multibody model sees it: a chassis on a rocker-bogie suspension with a differential."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.constants import GRAVITIES, LUNAR_GRAVITY
from lunarsci.errors import DataError, ParameterError
from lunarsci.names import one_of
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.regolith.written_names import written_for
from lunarsci.rovers import RoverDescription, read_rover
from lunarsci.twin.electrics import Motors, PowerSupply, read_part
from lunarsci.twin.rover_limits import check_limits, check_speed, warn_of_unusual

PAIRS = ("front", "middle", "rear")
BOGIES = ("rear", "front", "none")
HUNG = {"rear": ("middle", "rear"), "front": ("front", "middle"), "none": ()}
"""Pairs of wheels on the bogies, by where these are; the others are on the rockers."""
FALLBACK_SLOPE_DEG = 15.0
"""Steepest slope of a rover whose file has none: assumed, cautious for a rocker-bogie. [deg]"""
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
        for name in ("length_m", "width_m"):
            if not 0 < getattr(self, name) < math.inf:
                raise ParameterError(f"rover body {name} is {getattr(self, name)}; give a number above 0")
        for name in ("belly_z_m", "center_x_m"):
            if not math.isfinite(getattr(self, name)):
                raise ParameterError(f"rover body {name} is {getattr(self, name)}; give a finite number")


class RoverVector(NamedTuple):
    """What the compiled formulas read of a rover, SI units; the meaning of each entry is in `Rover`."""

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
    motors, power : of the wheels, and battery and panels; None where unknown. No force of a drive depends on them.

    The left rocker turns by +rho about the chassis' y axis, the right one by -rho: a differential does that whether it
    is a bar outside or gears inside the body. Each bogie turns about its rocker. Raises ParameterError for masses,
    moments or lengths that are not positive, for wheels that do not follow each other from front to rear, and for what
    no rover can be, see `rover_limits`.
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

    def __post_init__(self) -> None:
        for name in ("body_kg", "wheel_kg", "rocker_pivot_y_m", "max_speed_m_s", "gravity_m_s2"):
            if not 0 < getattr(self, name) < math.inf:
                raise ParameterError(f"rover {name} is {getattr(self, name)}; give a number above 0")
        for name in ("joint_damping_n_m_s", "steering_offset_m"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ParameterError(f"rover {name} is {getattr(self, name)}; give 0 or more")
        if not 0 < self.max_slope_deg <= 90.0:
            raise ParameterError(f"rover max_slope_deg is {self.max_slope_deg}; give a number above 0, at most 90 deg")
        self._check_bogie()
        for name in ("body_center_m", "front_wheel_m", "rear_wheel_m", "middle_wheel_m", "bogie_pivot_m"):
            value = getattr(self, name)
            if value is not None and not all(map(math.isfinite, value)):
                raise ParameterError(f"rover {name} is {value}; give three finite numbers")
        if not all(0 < moment < math.inf for moment in self.body_inertia_kg_m2):
            raise ParameterError(f"rover body_inertia_kg_m2 is {self.body_inertia_kg_m2}; give three numbers above 0")
        if unknown := set(self.steered) - set(self.pairs):
            raise ParameterError(f"rover steered_wheels has '{min(unknown)}'; {one_of(min(unknown), self.pairs)}")
        x = self.wheel_positions_m[::2, 0]
        if not (np.diff(x) < 0).all():
            raise ParameterError("the rover's wheels must follow each other from front to rear; check their x")
        check_limits(self)

    def _check_bogie(self) -> None:
        if self.bogie not in BOGIES:
            raise ParameterError(f"rover bogie is '{self.bogie}'; {one_of(self.bogie, BOGIES)}")
        for name in ("middle_wheel_m", "bogie_pivot_m"):
            if (getattr(self, name) is None) != (self.bogie == "none"):
                wanted = "leave it out" if self.bogie == "none" else "give it"
                raise ParameterError(f"rover with bogie '{self.bogie}': {wanted}: {name}")

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
    known = GRAVITIES.get(gravity.strip().lower())
    try:
        return replace(rover, gravity_m_s2=float(gravity) if known is None else known.value)
    except ValueError as error:
        raise ParameterError(f"gravity is '{gravity}'; give {', '.join(GRAVITIES)}, or m/s2 above 0") from error


def build_rover(rover: str | RoverDescription, *, varied: bool = False) -> Rover:
    """The rover of a name such as `yutu2`, a TOML file, or a description already read. Raises DataError.

    Motors must reach its top speed, but for a `varied` description, whose plans may be slower.
    """
    description = read_rover(rover) if isinstance(rover, str) else rover
    mass, suspension = description.table("mass"), description.table("suspension")
    steering, drive = description.table("steering"), description.table("drive")
    try:
        built = Rover(
            name=description.name,
            wheel=read_wheel(description),
            **_numbers(mass, "body_kg", "wheel_kg"),
            **_vectors(mass, "body_inertia_kg_m2", "body_center_m"),
            **_numbers(suspension, "rocker_pivot_y_m", "joint_damping_n_m_s"),
            **_suspension(suspension),
            steered=tuple(str(pair) for pair in steering["steered_wheels"]),
            steering_offset_m=float(steering.get("offset_m", 0.0)),
            **_numbers(drive, "max_speed_m_s"),
            body=_body(description.tables.get("body")),
            motors=read_part(description, "motors", Motors),
            power=read_part(description, "power", PowerSupply),
            max_slope_deg=float(description.tables.get("limits", {}).get("max_slope_deg", FALLBACK_SLOPE_DEG)),
        )
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


def _suspension(table: dict[str, Any]) -> dict[str, Any]:
    bogie = str(table.get("bogie", "rear"))
    own = ("front_wheel_m", "rear_wheel_m") + (() if bogie == "none" else ("middle_wheel_m", "bogie_pivot_m"))
    return {"bogie": bogie} | _vectors(table, *own)


def _body(table: dict[str, Any] | None) -> Body | None:
    if table is None:
        return None
    return Body(**_numbers(table, "length_m", "width_m", "belly_z_m"), center_x_m=float(table.get("center_x_m", 0.0)))


def _numbers(table: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: float(table[name]) for name in names}


def _vectors(table: dict[str, Any], *names: str) -> dict[str, Any]:
    for name in names:
        if not isinstance(table[name], list) or len(table[name]) != 3:
            raise ValueError(f"{name} must be a list of three numbers")
    return {name: _floats(table[name]) for name in names}


def _floats(values: Sequence[float]) -> Vector3:
    x, y, z = values
    return float(x), float(y), float(z)
