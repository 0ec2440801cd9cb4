"""Stand-in."""

from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.twin.plans.schedule import commands_at, make_schedule
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction


@dataclass(frozen=True, slots=True, eq=False)
class EnergyUse:
    total_j: FloatArray


def energy_use(prediction: Prediction) -> EnergyUse:
    schedule = make_schedule(prediction.plan, prediction.rover)
    rate = np.abs(commands_at(prediction.rover, schedule, prediction.time_s).speed_m_s) / prediction.rover.wheel.radius_m
    torque = np.abs(prediction.states[..., STATE_COLUMNS.index("resistance_torque_nm")])
    return EnergyUse(np.trapezoid((torque * rate).sum(axis=2), prediction.time_s, axis=1))
