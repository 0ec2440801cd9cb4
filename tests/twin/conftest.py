"""Grounds and drives that several tests share."""

from typing import Any

import numpy as np
import pytest

from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.plan import Leg, Plan, parse_sweep
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict


@pytest.fixture(scope="session")
def yutu2() -> Rover:
    return build_rover("yutu2")


@pytest.fixture(scope="session")
def longji_soil() -> Soil:
    return read_soil("longji")


@pytest.fixture(scope="session")
def slope():  # type: ignore[no-untyped-def]
    """A plane rising by `along` in x and `across` in y, 12 m x 8 m about the start."""

    def make(along: float = 0.0, across: float = 0.0, soil: Soil | None = None) -> Terrain:
        x, y = np.arange(-2.0, 10.01, 0.25), np.arange(-4.0, 4.01, 0.25)
        height = along * x[None, :] + across * y[:, None]
        return build_terrain("plane", -2.0, -4.0, 0.25, height, soil or read_soil("longji"), synthetic=True)

    return make


@pytest.fixture(scope="session")
def straight():  # type: ignore[no-untyped-def]
    def make(length_m: float = 2.0, curvature_per_m: float = 0.0, **changes: float) -> Plan:
        legs = (Leg(length_m, curvature_per_m),)
        return Plan(name="test", legs=legs, **({"speed_m_s": 0.05} | changes))

    return make


@pytest.fixture(scope="session")
def driven(yutu2: Rover, slope, straight) -> Prediction:  # type: ignore[no-untyped-def]
    """20 soils on 1 m of level ground, 11 samples; tests replace what they need to know exactly."""
    sweep = (parse_sweep("friction_angle_deg=30:49:20"),)
    return predict(yutu2, slope(), straight(1.0), sweep=sweep)


@pytest.fixture(scope="session")
def lopsided_lengths() -> dict[str, dict[str, Any]]:
    """By where the bogie is, lengths that break every symmetry that could hide a mistake."""
    return {
        "rear": {
            "front_wheel_m": (0.52, 0.04, -0.11),
            "bogie_pivot_m": (-0.27, 0.02, -0.03),
            "middle_wheel_m": (0.24, 0.01, -0.09),
            "rear_wheel_m": (-0.29, 0.03, -0.07),
        },
        "front": {
            "front_wheel_m": (0.27, 0.03, -0.07),
            "bogie_pivot_m": (0.26, 0.02, -0.03),
            "middle_wheel_m": (-0.22, 0.01, -0.09),
            "rear_wheel_m": (-0.51, 0.04, -0.11),
        },
        "none": {
            "front_wheel_m": (0.52, 0.04, -0.11),
            "bogie_pivot_m": None,
            "middle_wheel_m": None,
            "rear_wheel_m": (-0.41, 0.03, -0.12),
        },
    }
