"""What a drive takes: work of the wheels' motors, electrical power, sunlight on the panels, state of the battery."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.twin.ground.illumination import SunDirection, sunlit
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.judgement.quantities import least_of_95, most_of_95
from lunarsci.twin.plans.path import all_commands, make_schedule
from lunarsci.twin.rover import SOLAR_CONSTANT_W_M2, Motors, PowerSupply, Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, PowerState, Prediction

SECONDS_PER_HOUR = 3600.0
FINEST_S = 0.1
"""Longest step over which commanded rates are summed, as `commands_at` takes them. [s]"""
BLOCK = 64
"""Members whose commands are held in memory together."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EnergyUse:
    """Mechanical work that the motors of the wheels give to the ground.

    Attributes
    ----------
    wheels : their names, in the order of `wheel_work_j`.
    wheel_work_j : positive work of each wheel's motor up to where its drive ended; what a wheel that the slope pushes
        ahead would give back is not counted. (members, wheels) [J]
    duration_s : how long each drive took. (members,) [s]
    """

    wheels: tuple[str, ...]
    wheel_work_j: FloatArray
    duration_s: FloatArray

    @property
    def total_j(self) -> FloatArray:
        """Work of all wheels. (members,) [J]"""
        return np.asarray(self.wheel_work_j.sum(axis=1))


def wheel_turns_rad(prediction: Prediction) -> FloatArray:
    """How far each wheel turns between two samples, as commanded. (members, or 1 for all; samples - 1, wheels) [rad]

    The rate is the commanded ground speed of the rim over the shearing radius, with which slip ratios are defined.
    After a position fix each member has commands of its own.
    """
    rover, times, steered = prediction.rover, prediction.time_s, prediction.steered
    parts = max(1, int(np.ceil(np.diff(times).max(initial=0.0) / FINEST_S - 1e-9)))
    steps = np.linspace(0.0, times[-1], (len(times) - 1) * parts + 1)
    schedule = make_schedule(prediction.plan, rover)

    def turned(legs: FloatArray | None) -> FloatArray:
        """On legs as members steer them (members, runs, 3), or as planned. (members or 1, samples - 1, wheels) [rad]"""
        speed = np.abs(all_commands(rover, schedule, steps, legs).speed_m_s)
        angle = speed * np.diff(steps)[:, None] / rover.wheel.shearing_radius_m
        return np.asarray(angle.reshape(len(speed), len(times) - 1, parts, -1).sum(axis=2))

    if steered is None:
        return turned(None)
    return np.concatenate([turned(steered[k : k + BLOCK]) for k in range(0, len(steered), BLOCK)])


def energy_use(prediction: Prediction) -> EnergyUse:
    """Work of the motors, the sum over a drive of driving torque times angle turned, trapezium rule between samples.

    The torque is the resistance M_R of the ground about the axle, `resistance_torque_nm`: in a steady drive what the
    motor gives at the wheel, after its gears. Where it is negative, a wheel held back on its way down, the motor does
    no work. At halts no wheel turns. Losses of motors and gears, steering and electronics are not in it. The
    closed form of the wheel's forces has torques 6-23 % below those of the exact stress integrals.
    """
    torque = np.maximum(prediction.states[..., STATE_COLUMNS.index("resistance_torque_nm")], 0.0)
    reached = prediction.reached[:, 1:, None]
    between = np.where(reached, 0.5 * (torque[:, 1:] + torque[:, :-1]), 0.0)
    last = np.maximum(prediction.recorded - 1, 0)
    return EnergyUse(
        wheels=prediction.rover.wheels,
        wheel_work_j=(between * wheel_turns_rad(prediction)).sum(axis=1),
        duration_s=prediction.time_s[last],
    )


def energy_record(prediction: Prediction) -> dict[str, Any] | None:
    """Work of the motors in the drives that reach the end, for JSON; None where none does. [J, s]

    `p95_j` is the smallest value that at least 95 % of the drives do not exceed.
    """
    finished = prediction.finished
    if not finished.any():
        return None
    use = energy_use(prediction)
    work = use.wheel_work_j[finished]
    per_wheel = {wheel: _middle_and_most(work[:, k]) for k, wheel in enumerate(use.wheels)}
    return {
        **_middle_and_most(work.sum(axis=1)),
        "wheels": per_wheel,
        "duration_s": float(use.duration_s[finished][0]),
        "drives": int(finished.sum()),
    }


def _middle_and_most(work_j: FloatArray) -> dict[str, float]:
    return {"p50_j": float(np.median(work_j)), "p95_j": most_of_95(work_j)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PowerUse:
    """Electrical power of a drive, between its samples, and what is left in the battery.

    Attributes
    ----------
    time_s : of the samples. (samples,) [s]
    wheels_w : drawn by the motor of each wheel, mean between samples. (members, samples - 1, wheels) [W]
    others_w : drawn by all else, mean between samples. (members, samples - 1) [W]
    panels_w : from the panels, mean between samples; 0 without a Sun. (members, samples - 1) [W]
    lit : whether the rover's origin is in sunlight at a sample; None without a Sun. (members, samples)
    balance_wh : left in the battery at each sample, at most its capacity; below 0 what is drawn beyond it. (members,
        samples) [W h]
    """

    time_s: FloatArray
    wheels_w: FloatArray
    others_w: FloatArray
    panels_w: FloatArray
    lit: BoolArray | None
    balance_wh: FloatArray

    @property
    def battery_wh(self) -> FloatArray:
        """Left in the battery at each sample, between 0 and the capacity. (members, samples) [W h]"""
        return np.maximum(self.balance_wh, 0.0)

    @property
    def drawn_wh(self) -> FloatArray:
        """Electrical energy that each drive takes. (members,) [W h]"""
        watts = self.wheels_w.sum(axis=2) + self.others_w
        return np.asarray(watts @ np.diff(self.time_s) / SECONDS_PER_HOUR)

    @property
    def gained_wh(self) -> FloatArray:
        """What the panels gave. (members,) [W h]"""
        return np.asarray(self.panels_w @ np.diff(self.time_s) / SECONDS_PER_HOUR)


def power_use(prediction: Prediction) -> PowerUse:
    """Electrical power at every wheel, from the panels, and the state of the battery along each drive.

    With charge and Sun of the prediction's `power`, a full battery and no Sun where it has none. A motor draws its
    mechanical power over its efficiency, and its idle power while its wheel turns. Panels lie flat on
    the chassis: area times efficiency times solar constant times cosine of the Sun's angle from their normal, nothing
    where the terrain's shadow lies on the rover's origin. The battery takes what is over until it is full; its own
    losses are left out, as are those of charging. A drive that ended early keeps its last state.

    Raises ParameterError for a rover without [motors] or [power].
    """
    motors, power = _parts(prediction.rover)
    state = PowerState() if prediction.power is None else prediction.power
    time, turned = prediction.time_s, wheel_turns_rad(prediction)
    between = np.diff(time)
    torque = np.maximum(prediction.states[..., STATE_COLUMNS.index("resistance_torque_nm")], 0.0)
    mean = 0.5 * (torque[:, 1:] + torque[:, :-1])
    reached = prediction.reached[:, 1:]
    wheels = (mean * turned / motors.efficiency + motors.idle_w * (turned > 0) * between[:, None]) / between[:, None]
    lit, watts = _panels(prediction, power, state.sun)
    gain = np.where(reached, 0.5 * (watts[:, 1:] + watts[:, :-1]), 0.0)
    wheels = np.where(reached[..., None], wheels, 0.0)
    others = np.where(reached, power.electronics_w, 0.0)
    change = (gain - wheels.sum(axis=2) - others) * between / SECONDS_PER_HOUR
    left = np.empty((prediction.members, len(time)))
    left[:, 0] = np.asarray(state.charge) * power.battery_wh
    for k in range(len(between)):
        left[:, k + 1] = np.minimum(left[:, k] + change[:, k], power.battery_wh)
    return PowerUse(time_s=time, wheels_w=wheels, others_w=others, panels_w=gain, lit=lit, balance_wh=left)


def charge_left(prediction: Prediction) -> FloatArray:
    """Charge of the battery at the end of each drive, below 0 by what is drawn beyond an empty one. (members,) [-]

    Raises ParameterError for a rover without [motors] or [power].
    """
    return np.asarray(power_use(prediction).balance_wh[:, -1] / _parts(prediction.rover)[1].battery_wh)


def stood(prediction: Prediction, charge: FloatArray, seconds: float, sample: int) -> FloatArray:
    """Charge of the battery after each rover has stood for a time where it is at a sample. (members,) [-]

    Raises ParameterError for a rover without [motors] or [power].
    """
    power = _parts(prediction.rover)[1]
    sun = None if prediction.power is None else prediction.power.sun
    watts = _panels(prediction, power, sun)[1][:, sample] - power.standing_w
    return np.minimum(charge + watts * seconds / SECONDS_PER_HOUR / power.battery_wh, 1.0)


def _parts(rover: Rover) -> tuple[Motors, PowerSupply]:
    """Motors and power supply. Raises ParameterError for a rover without them."""
    if rover.motors is None or rover.power is None:
        raise ParameterError(
            f"{rover.name} has no [motors] and [power]; add both tables to the rover file as in yutu2's"
        )
    return rover.motors, rover.power


def _panels(
    prediction: Prediction, power: PowerSupply, sun: SunDirection | None
) -> tuple[BoolArray | None, FloatArray]:
    """Samples in sunlight, None without a Sun, and power of the panels at each. (members, samples) both [W]"""
    if sun is None:
        return None, np.zeros((prediction.members, len(prediction.time_s)))
    roll, pitch, yaw = np.moveaxis(np.radians(prediction.paths[..., 3:]), -1, 0)
    # The chassis' z axis: turned by roll about x, then pitch about y, then yaw about z.
    aside, along = -np.sin(roll), np.cos(roll) * np.sin(pitch)
    normal = (
        np.cos(yaw) * along - np.sin(yaw) * aside,
        np.sin(yaw) * along + np.cos(yaw) * aside,
        np.cos(roll) * np.cos(pitch),
    )
    facing = np.maximum(0.0, np.tensordot(sun.vector, np.array(normal), axes=1))
    terrain = prediction.terrain
    bright, nodes = _bright(terrain, sun), []
    for axis, place, first in ((1, 0, terrain.x0_m), (0, 1, terrain.y0_m)):
        number = np.rint((prediction.places_m[..., place] - first) / terrain.spacing_m).astype(np.int64)
        nodes.append(np.clip(number, 0, bright.shape[axis] - 1))
    lit = bright[nodes[1], nodes[0]]
    return lit, np.asarray(SOLAR_CONSTANT_W_M2 * power.panel_area_m2 * power.cell_efficiency * facing * lit)


@lru_cache(maxsize=4)
def _bright(terrain: Terrain, sun: SunDirection) -> BoolArray:
    """Lit nodes, worked out once for all drives on a terrain. (ny, nx)"""
    return sunlit(terrain, sun.azimuth_deg, sun.elevation_deg)


def power_record(prediction: Prediction, use: PowerUse) -> dict[str, Any]:
    """Electrical power and battery of all drives, for JSON. [W, W h]

    Of energies p50 and p95, of the battery p50 and p05 of its lowest state; `empty_drives` ran out of it.
    """
    drawn, least = use.drawn_wh, use.battery_wh.min(axis=1)
    lit = None if use.lit is None else float(use.lit[prediction.reached].mean()) if prediction.reached.any() else None
    most = use.wheels_w.max(axis=(0, 1))
    return {
        "drawn": {"p50_wh": float(np.median(drawn)), "p95_wh": most_of_95(drawn)},
        "panels": {"p50_wh": float(np.median(use.gained_wh)), "lit_share": lit},
        "battery": {"p50_least_wh": float(np.median(least)), "p05_least_wh": least_of_95(least)},
        "empty_drives": int((least <= 0).sum()),
        "wheels_most_w": dict(zip(prediction.rover.wheels, map(float, most), strict=True)),
    }


def expected_energy_j(prediction: Prediction) -> float:
    """Mean work of all wheels over the drives that ended, NaN where none did. [J]"""
    total = energy_use(prediction).total_j[prediction.finished]
    return float(total.mean()) if total.size else np.nan
