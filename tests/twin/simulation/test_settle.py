"""The rover at rest: wheel loads against the levers, worked out here from the rover's dimensions.

Differential and bogies on rigid ground with one wheel lifted: angles worked out here from lines through wheels.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain, soil_override
from lunarsci.twin.lanes import CLIFF, FINISHED, GROUP, HOLE, LEFT, SANK, UNSETTLED, WHEEL, new_work
from lunarsci.twin.rover import Rover, build_rover, with_gravity
from lunarsci.twin.simulation.settle import settle


def loads(rover: Rover, terrain: Terrain, heading: float = 0.0, at: tuple[float, float] = (0.0, 0.0), **soil: float):  # type: ignore[no-untyped-def]
    """Outcome, F_N of FL, FR, ML, MR, RL, RR, and the pose."""
    count = len(rover.wheels)
    work = new_work(count)
    start, override = np.tile([*at, heading], (GROUP, 1)), np.tile(soil_override(soil), (GROUP, 1))
    WHEEL.view(work.wheels, "rim")[:] = 0.05
    settle(rover.vector(), rover.wheel.vector(), terrain.grid(), override, start, work)
    assert (work.code == work.code[0]).all()
    return (
        int(work.code[0]),
        WHEEL.view(work.wheels, "normal")[:, 0].copy(),
        work.body.reshape(-1, GROUP)[:10, 0].copy(),
    )


def levers(rover: Rover) -> np.ndarray:
    """Loads on level, rigid ground; the bar in the comments marks a load less the wheel's own weight."""
    g, weight = rover.gravity_m_s2, rover.wheel_kg * rover.gravity_m_s2
    body = rover.body_kg * g
    x_c, y_c, _ = rover.body_center_m
    front, pivot = rover.front_wheel_m[0], rover.bogie_pivot_m[0]
    middle, rear = rover.middle_wheel_m[0], rover.rear_wheel_m[0]
    result = np.zeros(6)
    for k, sign in enumerate((1.0, -1.0)):
        side = 0.5 * body * (1.0 + sign * y_c / rover.rocker_pivot_y_m)  # roll balance: F̄ + B̄ on this side
        moment = 0.5 * body * x_c  # the differential gives both rockers the same moment: F̄ x_f + B̄ x_b
        bogie = (side * front - moment) / (front - pivot)
        result[k] = side - bogie + weight
        result[2 + k] = -bogie * rear / (middle - rear) + weight  # balance about the bogie pivot
        result[4 + k] = bogie * middle / (middle - rear) + weight
    return result


VARIANTS = [
    {},
    {"bogie_pivot_m": (-0.31, 0.0, -0.02), "middle_wheel_m": (0.22, 0.0, -0.08)},
    {"body_center_m": (0.06, 0.05, 0.3)},
]


@pytest.mark.parametrize("changes", VARIANTS)
def test_loads_follow_the_levers(yutu2: Rover, slope, changes) -> None:  # type: ignore[no-untyped-def]
    rover = dataclasses.replace(yutu2, **changes)
    # Rigid ground, so that different sinkages do not tilt the levers.
    code, normal, _ = loads(rover, slope(), stiffness_kpa_m_n=1443.0 * 3e6)
    assert code == FINISHED
    assert normal == pytest.approx(levers(rover), rel=1e-6)
    assert normal.sum() == pytest.approx(rover.mass_kg * rover.gravity_m_s2, rel=1e-9)


def test_a_bogie_at_the_front_mirrors_one_at_the_rear(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """The same rover seen from behind, its centre of mass moved the other way."""
    flip = np.array([-1.0, 1.0, 1.0])

    def mirrored(arm: tuple[float, float, float] | None) -> tuple[float, ...]:
        return tuple(map(float, flip * arm))

    rear = dataclasses.replace(yutu2, body_center_m=(0.06, 0.05, 0.3), middle_wheel_m=(0.21, 0.0, -0.08))
    front = dataclasses.replace(
        rear,
        bogie="front",
        body_center_m=mirrored(rear.body_center_m),
        front_wheel_m=mirrored(rear.rear_wheel_m),
        middle_wheel_m=mirrored(rear.middle_wheel_m),
        rear_wheel_m=mirrored(rear.front_wheel_m),
        bogie_pivot_m=mirrored(rear.bogie_pivot_m),
    )
    one, two = (loads(rover, slope(), stiffness_kpa_m_n=1443.0 * 3e6)[1] for rover in (rear, front))
    assert one[[4, 5, 2, 3, 0, 1]] == pytest.approx(two, rel=1e-6)


def test_a_four_wheeler_rests_on_its_levers(slope) -> None:  # type: ignore[no-untyped-def]
    rover = dataclasses.replace(build_rover("small-four"), body_center_m=(0.03, 0.02, 0.06))
    code, normal, _ = loads(rover, slope(), stiffness_kpa_m_n=1443.0 * 3e6)
    assert code == FINISHED
    g, body = rover.gravity_m_s2, rover.body_kg * rover.gravity_m_s2
    for k, sign in enumerate((1.0, -1.0)):
        side = 0.5 * body * (1.0 + sign * 0.02 / rover.rocker_pivot_y_m)
        moment = 0.5 * body * 0.03  # the differential gives both rockers the same
        front = (moment - side * rover.rear_wheel_m[0]) / (rover.front_wheel_m[0] - rover.rear_wheel_m[0])
        assert normal[k] == pytest.approx(front + rover.wheel_kg * g, rel=1e-6)
        assert normal[2 + k] == pytest.approx(side - front + rover.wheel_kg * g, rel=1e-6)


def test_loads_of_yutu2_are_equal_and_36_n(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    code, normal, pose = loads(yutu2, slope())
    assert code == FINISHED
    assert normal == pytest.approx(np.full(6, 135.0 * 1.622 / 6.0), rel=1e-3)
    # Ding et al. (2024): 8 mm mean sinkage goes with 1443 kPa/m^N; the origin is 0.1 m above the wheel centres.
    assert 0.15 + 0.10 - pose[2] == pytest.approx(0.0085, abs=0.0008)


@pytest.mark.parametrize("heading", [0.0, 1.0, 2.5, -3.0])
@pytest.mark.parametrize("gradient", [(0.1, 0.0), (0.0, 0.15), (-0.2, 0.1)])
def test_on_a_plane_the_chassis_lies_along_the_plane_and_carries_its_normal_weight(
    yutu2: Rover,
    slope,  # type: ignore[no-untyped-def]
    heading: float,
    gradient: tuple[float, float],
) -> None:
    code, normal, pose = loads(yutu2, slope(*gradient), heading)
    assert code == FINISHED
    upright = 1.0 / math.sqrt(1.0 + gradient[0] ** 2 + gradient[1] ** 2)
    # What points down the slope is held along the surface, not by the normal forces.
    assert normal.sum() == pytest.approx(yutu2.mass_kg * yutu2.gravity_m_s2 * upright, rel=1e-8)
    w, x, y, z = pose[3:7]
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    assert np.degrees(np.arccos(axis @ (np.array([-gradient[0], -gradient[1], 1.0]) * upright))) < 0.3


def test_what_cannot_settle_says_so(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    assert loads(yutu2, slope(), stiffness_kpa_m_n=1e-3)[0] in (UNSETTLED, SANK)
    assert loads(yutu2, slope(1.7))[0] == UNSETTLED
    assert loads(yutu2, slope(3.0))[0] == CLIFF
    assert loads(yutu2, slope(0.0, 3.0))[0] == CLIFF
    assert loads(yutu2, slope(), at=(50.0, 0.0))[0] == LEFT
    holed = slope()
    holed.height_m[14:19, 6:11] = np.nan
    assert loads(yutu2, holed)[0] == HOLE


@pytest.mark.parametrize(("gravity", "g"), [("earth", 9.80665), ("mars", 3.71), ("Moon", 1.622), ("3.3", 3.3)])
def test_wheels_carry_the_weight_under_any_gravity(yutu2: Rover, slope, gravity: str, g: float) -> None:  # type: ignore[no-untyped-def]
    """At rest on level ground, as the levers share it."""
    rover = with_gravity(yutu2, gravity)
    code, normal, _ = loads(rover, slope(), stiffness_kpa_m_n=1443.0 * 3e6)
    assert code == FINISHED and normal == pytest.approx(levers(rover), rel=1e-6)
    assert normal.sum() == pytest.approx(135.0 * g, rel=1e-9)


@pytest.mark.parametrize("gravity", ["0", "-1", "nan", "inf", "pluto"])
def test_gravity_that_cannot_be_is_refused(yutu2: Rover, gravity: str) -> None:
    with pytest.raises(ParameterError, match="gravity"):
        with_gravity(yutu2, gravity)


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
