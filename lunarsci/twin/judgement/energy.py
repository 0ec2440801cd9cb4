"""What the wheels' motors do along a drive: mechanical work, and the time it takes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.twin.plans.schedule import all_commands, make_schedule
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction

FINEST_S = 0.1
"""Longest step over which commanded rates are summed, as `commands_at` takes them. [s]"""


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
    """How far each wheel turns between two samples, as commanded. (samples - 1, wheels) [rad]

    The rate is the commanded ground speed of the rim over the shearing radius, with which slip ratios are defined. With
    position fixes it is that of the planned legs, from which a corrected leg differs by as much as its length does.
    """
    rover, times = prediction.rover, prediction.time_s
    parts = max(1, int(np.ceil(np.diff(times).max(initial=0.0) / FINEST_S - 1e-9)))
    steps = np.linspace(0.0, times[-1], (len(times) - 1) * parts + 1)
    speed = np.abs(all_commands(rover, make_schedule(prediction.plan, rover), steps).speed_m_s[0])
    turned = speed * np.diff(steps)[:, None] / rover.wheel.shearing_radius_m
    return np.asarray(turned.reshape(len(times) - 1, parts, -1).sum(axis=1))


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
        wheel_work_j=np.einsum("msw,sw->mw", between, wheel_turns_rad(prediction)),
        duration_s=prediction.time_s[last],
    )


def energy_record(prediction: Prediction) -> dict[str, Any] | None:
    """What the motors do in the drives that reach the end, for JSON; None where none does. [J, s]

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
    p95 = float(np.quantile(work_j, 0.95, method="inverted_cdf"))
    return {"p50_j": float(np.median(work_j)), "p95_j": p95}
