"""Differential and bogies on rigid ground with one wheel lifted: angles worked out here from lines through wheels."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain, soil_override
from lunarsci.twin.lanes import FINISHED, GROUP, WHEEL, new_work
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.settle import settle

LIFT_M = 0.004
RIGID = {"stiffness_kpa_m_n": 1443.0 * 3e6}


class Stance(NamedTuple):
    """Angles about x and y [rad], positive to the right and nose down; wheel loads [N]."""

    roll: float
    pitch: float
    differential: float
    bogies: tuple[float, float]
    loads: np.ndarray


def steps(rover: Rover, lifts: dict[str, float]) -> Terrain:
    """Level ground with a square of 0.2 m raised under each wheel named."""
    x, y = np.arange(-2.0, 2.001, 0.05), np.arange(-2.0, 2.001, 0.05)
    height = np.zeros((len(y), len(x)))
    for name, lift in lifts.items():
        center = rover.wheel_positions_m[rover.wheels.index(name)]
        near = (np.abs(x - center[0]) < 0.101)[None, :] & (np.abs(y - center[1]) < 0.101)[:, None]
        height[near] = lift
    return build_terrain("steps", -2.0, -2.0, 0.05, height, read_soil("longji"), synthetic=True)


def settled(rover: Rover, terrain: Terrain) -> Stance:
    work = new_work(len(rover.wheels))
    WHEEL.view(work.wheels, "rim")[:] = 0.05
    override = np.tile(soil_override(RIGID), (GROUP, 1))
    settle(rover.vector(), rover.wheel.vector(), terrain.grid(), override, np.zeros((GROUP, 3)), work)
    assert (work.code == FINISHED).all()
    pose = work.body.reshape(-1, GROUP)[:10, 0]
    _, pitch, roll = Rotation.from_quat(pose[[4, 5, 6, 3]]).as_euler("ZYX")
    loads = WHEEL.view(work.wheels, "normal")[:, 0].copy()
    return Stance(roll, pitch, pose[7], (pose[8], pose[9]), loads)


def line(x_1: float, z_1: float, x_2: float, z_2: float) -> tuple[float, float]:
    """Height at x = 0, and angle about y (nose down) of the line through two points."""
    rise = (z_1 - z_2) / (x_1 - x_2)
    return z_1 - rise * x_1, -rise


def by_hand(rover: Rover, lifts: dict[str, float]) -> Stance:
    """To first order in the lifts: the wheels' heights give each bogie, the bogie its pivot, that the rocker."""
    pivots, rockers, bogies = [], [], []
    for side in "LR":
        height = {pair: lifts.get(pair[0].upper() + side, 0.0) for pair in rover.pairs}
        reach = {pair: getattr(rover, f"{pair}_wheel_m")[0] for pair in rover.pairs}
        bogie, pairs = None, list(rover.pairs)
        if rover.bogie != "none":
            on = ("middle", "rear") if rover.bogie == "rear" else ("front", "middle")
            lone = next(pair for pair in pairs if pair not in on)
            pivot, bogie = line(reach[on[0]], height[on[0]], reach[on[1]], height[on[1]])
            z, angle = line(reach[lone], height[lone], rover.bogie_pivot_m[0], pivot)
        else:
            z, angle = line(reach["front"], height["front"], reach["rear"], height["rear"])
        pivots.append(z)
        rockers.append(angle)
        bogies.append(0.0 if bogie is None else bogie - angle)
    pitch = 0.5 * (rockers[0] + rockers[1])
    roll = (pivots[0] - pivots[1]) / (2.0 * rover.rocker_pivot_y_m)
    return Stance(roll, pitch, rockers[0] - pitch, (bogies[0], bogies[1]), np.zeros(0))


def rover_with(bogie: str) -> Rover:
    lengths = {
        "rear": {},
        "front": {
            "front_wheel_m": (0.24, 0.0, -0.08),
            "bogie_pivot_m": (0.26, 0.0, -0.02),
            "middle_wheel_m": (-0.22, 0.0, -0.08),
            "rear_wheel_m": (-0.51, 0.0, -0.10),
        },
        "none": {
            "front_wheel_m": (0.52, 0.0, -0.11),
            "rear_wheel_m": (-0.41, 0.0, -0.11),
            "bogie_pivot_m": None,
            "middle_wheel_m": None,
        },
    }
    return dataclasses.replace(build_rover("yutu2"), bogie=bogie, **lengths[bogie])


CASES = [
    *[("rear", {name: LIFT_M}) for name in ("FL", "ML", "RL", "FR")],
    *[("front", {name: LIFT_M}) for name in ("FL", "ML", "RL", "RR")],
    *[("none", {name: LIFT_M}) for name in ("FL", "FR", "RL")],
    ("rear", {"FL": LIFT_M, "FR": -LIFT_M}),
    ("rear", {"ML": LIFT_M, "RL": -LIFT_M}),
    ("front", {"FL": LIFT_M, "RR": 0.5 * LIFT_M}),
]


@pytest.mark.parametrize(("bogie", "lifts"), CASES, ids=lambda value: str(value).replace(" ", ""))
def test_a_lifted_wheel_turns_the_joints_as_geometry_says(bogie: str, lifts: dict[str, float]) -> None:
    rover = rover_with(bogie)
    stance, expected, scale = settled(rover, steps(rover, lifts)), by_hand(rover, lifts), LIFT_M / 0.5
    for name in ("roll", "pitch", "differential", "bogies"):
        assert getattr(stance, name) == pytest.approx(getattr(expected, name), rel=0.01, abs=0.005 * scale), name


@pytest.mark.parametrize("bogie", ["rear", "front", "none"])
def test_the_pitch_of_the_chassis_is_the_mean_of_its_rockers(bogie: str) -> None:
    """Front left up, front right down: both rockers turn, the chassis does not."""
    rover = rover_with(bogie)
    level = settled(rover, steps(rover, {"FL": LIFT_M, "FR": -LIFT_M}))
    # What is left is of second order in the angles.
    assert abs(level.pitch) < level.differential**2 and abs(level.differential) > 0.3 * LIFT_M
    both = settled(rover, steps(rover, {"FL": LIFT_M, "FR": LIFT_M}))
    assert max(abs(both.differential), abs(both.roll)) < both.pitch**2 and abs(both.pitch) > 0.3 * LIFT_M


@pytest.mark.parametrize("bogie", ["rear", "front", "none"])
def test_a_lifted_wheel_keeps_its_load(bogie: str) -> None:
    """What a rocker-bogie is for: the loads follow from levers, not from heights; a stiff frame would lift a wheel."""
    rover = rover_with(bogie)
    level = settled(rover, steps(rover, {})).loads
    for name in rover.wheels[::2]:
        lifted = settled(rover, steps(rover, {name: 5.0 * LIFT_M})).loads
        tilt = 5.0 * LIFT_M / 0.5
        # The centre of mass, 0.4 m above the wheels, shifts by less than that times the tilt.
        assert np.abs(lifted / level - 1.0).max() < 2.0 * tilt * 0.4 / 0.45
    assert math.fsum(level) == pytest.approx(rover.mass_kg * rover.gravity_m_s2, rel=1e-6)
