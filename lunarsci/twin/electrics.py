"""Motors, battery and solar panels of a rover, as its file describes them."""

import math
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.names import one_of
from lunarsci.rovers import RoverDescription

SOLAR_CONSTANT_W_M2 = 1360.8
"""Power of sunlight through a square metre at 1 au: Kopp & Lean (2011), 10.1029/2010GL045777. [W/m2]"""


def _check(what: str, given: object, positive: tuple[str, ...], shares: tuple[str, ...] = ()) -> None:
    for name in positive:
        if not 0 < getattr(given, name) < math.inf:
            raise ParameterError(f"{what} {name} is {getattr(given, name)}; give a number above 0")
    for name in shares:
        if not 0 < getattr(given, name) <= 1:
            raise ParameterError(f"{what} {name} is {getattr(given, name)}; give a share above 0, at most 1")


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
        _check("motors", self, ("stall_torque_nm", "continuous_torque_nm", "no_load_rate_rad_s"), ("efficiency",))
        if self.continuous_torque_nm > self.stall_torque_nm:
            raise ParameterError("motors continuous_torque_nm is above stall_torque_nm; give at most that")
        if not 0 <= self.idle_w < math.inf:
            raise ParameterError(f"motors idle_w is {self.idle_w}; give 0 or more")

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
        _check("power", self, ("battery_wh",), ("cell_efficiency",))
        for name in ("electronics_w", "panel_area_m2", "standby_w"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise ParameterError(f"power {name} is {value}; give 0 or more")
        if not 0 <= self.least_charge < 1:
            raise ParameterError(f"power least_charge is {self.least_charge}; give a share from 0 to less than 1")

    @property
    def standing_w(self) -> float:
        """Draw of everything while the rover stands. [W]"""
        return self.electronics_w if self.standby_w is None else self.standby_w


Part = TypeVar("Part", Motors, PowerSupply)


def read_part(description: RoverDescription, table: str, kind: type[Part]) -> Part | None:
    """[motors] or [power] of a rover file, None where it has none. Raises DataError."""
    found: dict[str, Any] | None = description.tables.get(table)
    if found is None:
        return None
    known = [field.name for field in fields(kind)]
    if unknown := set(found) - set(known):
        raise DataError(f"{description.origin}: [{table}] has no '{min(unknown)}'; {one_of(min(unknown), known)}")
    try:
        return kind(**{name: float(value) for name, value in found.items()})
    except (TypeError, ValueError) as error:
        raise DataError(f"{description.origin}: [{table}]: {error}") from error
