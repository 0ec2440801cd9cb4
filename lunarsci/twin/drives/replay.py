"""The twin driven by the wheels of a drive as they were measured, beside the way that these wheels go without slip."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.twin.ground.terrain import Terrain, soil_overrides
from lunarsci.twin.plans.path import STILL_M_S, Commands
from lunarsci.twin.plans.plan import SLOWEST_M_S, Leg, Plan
from lunarsci.twin.plans.schedule import make_schedule
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.drives import drive_all, drive_finer
from lunarsci.twin.simulation.ensemble import UNDER_WAY, Prediction, for_people
from lunarsci.twin.simulation.members import SLOW, DriveSetup
from lunarsci.twin.telemetry.odometry import fitted_twist, wheel_rows
from lunarsci.twin.telemetry.reading import Telemetry

STEP_S, STEP_M = 0.1, 0.01
"""Longest step, in time and in way of the fastest rim; assumed, as the embedded plan has 0.1 s and 5 mm. [s, m]"""
SAMPLE_S = 0.5
"""Between samples; assumed. [s]"""
SIDEWAYS = 1e-6
"""Weight of what wheels do not move sideways, against what they roll, where no wheel steers: it counts where these
leave a velocity open, hardly where skid steering drags wheels aside; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class WheelTurns:
    """How far the wheels of a drive rolled, as measured.

    Attributes
    ----------
    time_s : from 0 on, ascending. (n,) [s]
    rolled_m : way of each rim r_s theta, negative backwards. (n, wheels) [m]
    steered_rad : steering of each wheel. (n, wheels) [rad]
    """

    time_s: FloatArray
    rolled_m: FloatArray
    steered_rad: FloatArray

    @classmethod
    def of(cls, telemetry: "Telemetry", rover: Rover, begin_s: float) -> "WheelTurns":
        """Those of telemetry from a time on: measured angles, else rates, else commanded speeds."""
        time = telemetry.time_s - begin_s
        columns = [_rolled_m(telemetry, rover, k) for k in range(len(rover.wheels))]
        steered = [_filled(time, np.radians(column)) for column in telemetry.turned_deg.T]
        whole = cls(time, np.column_stack(columns), np.column_stack(steered))
        times = np.append(0.0, time[time > 0.0])
        return cls(times, whole._at(times, whole.rolled_m), whole._at(times, whole.steered_rad))

    def commands(self, times_s: FloatArray) -> Commands:
        """Steering at the end, and mean speed of each rim, of the steps between some times. (1, steps, wheels)"""
        rolled, steered = (self._at(times_s, values) for values in (self.rolled_m, self.steered_rad))
        speed = np.diff(rolled, axis=0) / np.diff(times_s)[:, None]
        return Commands(steered[None, 1:], np.where(np.abs(speed) > STILL_M_S, speed, 0.0)[None])

    def _at(self, times_s: FloatArray, values: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(times_s, self.time_s, column) for column in values.T])


def _filled(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """With what is missing between values; 0 where there are none."""
    known = np.isfinite(values)
    return np.interp(time_s, time_s[known], values[known]) if known.any() else 0.0 * time_s


def _rolled_m(telemetry: "Telemetry", rover: Rover, wheel: int) -> FloatArray:
    """Way of a rim since the first row. (n,) [m]"""
    time, radius = telemetry.time_s, rover.wheel.shearing_radius_m
    angle, rate = np.radians(telemetry.angle_deg[:, wheel]), np.radians(telemetry.rate_deg_s[:, wheel])
    if (known := np.isfinite(angle)).any():
        # Angles that begin anew after each turn stay within one.
        anew = np.ptp(angle[known]) <= 2.0 * math.pi
        angle[known] = np.unwrap(angle[known]) if anew else angle[known]
        return np.asarray(radius * _filled(time, angle))
    speed = radius * rate if np.isfinite(rate).any() else telemetry.speed_m_s[:, wheel]
    speed = _filled(time, speed)
    return np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time)))


@dataclass(frozen=True, slots=True)
class Replay(DriveSetup):
    """A scene whose wheels turn as they were measured."""

    turns: WheelTurns = field(default_factory=lambda: WheelTurns(*np.zeros((3, 0, 0))))

    def commands(self) -> Commands:
        return self.turns.commands(self.times_s)

    @property
    def slow(self) -> BoolArray:
        pace = np.append(_pace(self.commands()), 0.0)
        return np.asarray((pace > 0.0) & (pace < SLOW))

    def finer(self, factor: int, only: IntArray) -> Self:
        times = np.linspace(0.0, self.times_s[-1], (len(self.times_s) - 1) * factor + 1)
        return dataclasses.replace(self, times_s=times, every=self.every * factor, only=only)


def _pace(commands: Commands) -> FloatArray:
    """Mean speed of the rims in each step, as a share of the usual one while they turn. (steps,)"""
    mean = np.abs(commands.speed_m_s[0]).mean(axis=-1)
    turning = mean[mean > STILL_M_S]
    return np.asarray(mean / np.median(turning) if turning.size else mean)


def replayed(
    rover: Rover,
    terrain: Terrain,
    turns: WheelTurns,
    start: tuple[float, float, float],
    soils: Mapping[str, FloatArray],
    *,
    name: str = "",
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Prediction:
    """Drives whose wheels turn as they were measured, one for each soil.

    Parameters
    ----------
    start : x, y and heading of the rover's origin at time 0. [m, m, deg]
    soils : parameter to one value for each member; empty for the terrain's own soil.

    The `planned` poses of the result are those of `wheels_alone`. Raises ParameterError for a soil that is none.
    """
    whole = turns.commands(turns.time_s)
    fastest = float(np.abs(whole.speed_m_s).max(initial=SLOWEST_M_S))
    samples = max(1, math.ceil(turns.time_s[-1] / SAMPLE_S))
    every = max(1, math.ceil(turns.time_s[-1] / samples / min(STEP_S, STEP_M / fastest)))
    times = np.linspace(0.0, turns.time_s[-1], samples * every + 1)
    count = len(next(iter(soils.values()))) if soils else 1
    plan = _stand_in(name, start, turns.commands(times))
    draws = None if terrain.errors is None else terrain.errors.draws(count, seed)
    scene = Replay(rover, terrain, make_schedule(plan, rover), times, every, seed, draws=draws, turns=turns)
    overrides = soil_overrides(dict(soils), count)
    driven = drive_all(scene, overrides, samples + 1, progress)
    finer = drive_finer(scene, overrides, driven)
    paths, states, results, _ = driven
    halted = np.append(_pace(turns.commands(times[::every])), 0.0) < 1.0 - UNDER_WAY
    for_people(scene, paths, states, results[:, 1], halted)
    alone = wheels_alone(rover, turns, start, times)[::every]
    return Prediction(
        rover=rover,
        terrain=terrain,
        plan=plan,
        seed=seed,
        time_step_s=scene.time_step_s,
        parameters=dict(soils),
        time_s=times[::every],
        distance_m=np.append(0.0, np.cumsum(np.hypot(*np.diff(alone[:, :2], axis=0).T))),
        planned=alone,
        paths=paths,
        states=states,
        halted=halted,
        recorded=results[:, 1],
        outcome=results[:, 0],
        finer=finer,
        draws=draws,
    )


def _stand_in(name: str, start: tuple[float, float, float], commands: Commands) -> Plan:
    """A plan for what asks for one: the start, and whether the rover is under way there."""
    first = float(commands.speed_m_s[0, 0].mean())
    leg = Leg(length_m=1.0) if first >= SLOWEST_M_S else Leg(stop_s=1.0)
    x, y, heading = start
    speed = max(first, SLOWEST_M_S)
    return Plan(name=name or "drive", legs=(leg,), speed_m_s=speed, x_m=x, y_m=y, heading_deg=heading)


def rigid_twist(rover: Rover, commands: Commands) -> FloatArray:
    """Velocity ahead, to the left [m/s] and turn [rad/s] that fit all rims best: the plain baseline. (steps, 3)

    Least squares of what each wheel rolls in its own plane, and does not move sideways; of a rover that steers no wheel
    the latter only decides the rest.
    """
    rims = commands.speed_m_s[0]
    weight = np.ones_like(rims), np.full_like(rims, 1.0 if rover.steered else SIDEWAYS)
    return fitted_twist(*wheel_rows(rover, commands.steering_rad[0]), rims, 0.0 * rims, weight)


def slips_alone(rover: Rover, turns: WheelTurns, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Slip ratio [-] and side slip [deg] of each wheel at a time, of a rover that moves as its wheels fit best."""
    commands = turns.commands(np.array([time_s - 0.5 * SAMPLE_S, time_s + 0.5 * SAMPLE_S]))
    along, across = (part[0] @ rigid_twist(rover, commands)[0] for part in wheel_rows(rover, commands.steering_rad[0]))
    with np.errstate(divide="ignore", invalid="ignore"):
        travel = along / commands.speed_m_s[0, 0]
        slip = np.where(travel <= 1.0, 1.0 - travel, 1.0 / travel - 1.0)
    return np.nan_to_num(slip), np.degrees(np.arctan2(across, np.abs(along)))


def wheels_alone(rover: Rover, turns: WheelTurns, start: tuple[float, float, float], times_s: FloatArray) -> FloatArray:
    """Poses of a rover whose wheels do not slip: x, y, heading at some times. (n, 3) [m, m, rad]"""
    twist = rigid_twist(rover, turns.commands(times_s))
    step = np.diff(times_s)
    heading = math.radians(start[2]) + np.append(0.0, np.cumsum(twist[:, 2] * step))
    middle = 0.5 * (heading[1:] + heading[:-1])
    ahead, left = twist[:, 0] * step, twist[:, 1] * step
    x = start[0] + np.append(0.0, np.cumsum(np.cos(middle) * ahead - np.sin(middle) * left))
    y = start[1] + np.append(0.0, np.cumsum(np.sin(middle) * ahead + np.cos(middle) * left))
    return np.stack([x, y, heading], axis=-1)
