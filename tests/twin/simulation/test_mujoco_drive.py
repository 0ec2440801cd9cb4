"""MuJoCo drives the same rover over the same ground: its own kinematics, mass matrix and integrator.

Shared are the wheel-soil formulas of `regolith.forces` and the commands. Written anew: the tree of bodies (in
`benchmarks/mujoco_rover.py`), the ground as an analytic surface, the contact frame and where the forces of a wheel act,
from the text of `twin.contact`.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from mujoco_rover import joint_angles, joint_names, mjcf

from lunarsci.compiled import compiled
from lunarsci.regolith.forces import wheel_forces_kernel
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.path import reach_m, wheel_commands
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.contact import MASS_ON_WHEEL, NORMAL_DAMPING
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

mujoco = pytest.importorskip("mujoco")

STEP_S = 0.002
SPEED_M_S = 0.05


class Ground(NamedTuple):
    """A plane with a Gaussian bump: z = along x + across y + height exp(-r^2 / 2 sigma^2)."""

    along: float = 0.0
    across: float = 0.0
    height: float = 0.0
    x: float = 0.0
    y: float = 0.0
    sigma: float = 1.0

    def at(self, x: Any, y: Any) -> Any:
        """Height."""
        bump = self.height * np.exp(-((x - self.x) ** 2 + (y - self.y) ** 2) / (2.0 * self.sigma**2))
        return self.along * x + self.across * y + bump

    def terrain(self, soil: Soil) -> Terrain:
        """As a grid of 5 cm."""
        x, y = np.arange(-3.0, 12.001, 0.05), np.arange(-6.0, 6.001, 0.05)
        return build_terrain("ground", -3.0, -6.0, 0.05, self.at(x[None, :], y[:, None]), soil, synthetic=True)


class Track(NamedTuple):
    """x, y, z, roll, pitch, yaw [m, deg] (samples, 6); left and right rocker, bogies [deg]; F_N [N] (samples, n)."""

    pose: np.ndarray
    joints: np.ndarray
    normal: np.ndarray


@compiled  # type: ignore[untyped-decorator]
def unit_cross(a, b):  # type: ignore[no-untyped-def]
    c = np.cross(a, b)
    return c / math.sqrt(c @ c)


@compiled  # type: ignore[untyped-decorator]
def push_wheels(bodies, place, turn, motion, about, rim, ground, tyre, soil, damping, applied, normal):  # type: ignore[no-untyped-def]
    """The wrench of the soil on every wheel into `applied` (bodies, 6), world axes at the wheel centre."""
    r, r_s, c1, c2, c3 = tyre[0], tyre[3], tyre[4], tyre[5], tyre[6]
    for w in range(len(bodies)):
        body = bodies[w]
        center, axle = place[body], turn[body][1::3] * math.copysign(1.0, rim[w])
        v = motion[body, 3:] + np.cross(motion[body, :3], center - about)
        dx, dy = center[0] - ground.x, center[1] - ground.y
        bump = ground.height * math.exp(-(dx * dx + dy * dy) / (2.0 * ground.sigma**2))
        height = ground.along * center[0] + ground.across * center[1] + bump
        up = np.array([bump * dx / ground.sigma**2 - ground.along, bump * dy / ground.sigma**2 - ground.across, 1.0])
        up /= math.sqrt(up @ up)
        ahead = unit_cross(axle, up)
        left = np.cross(up, ahead)
        z = r - (center[2] - height) * up[2]
        normal[w] = 0.0
        applied[body] = 0.0
        if z <= 0.0:
            continue
        speed = abs(rim[w])
        travel = (v @ ahead) / speed
        f_n, f_dp, f_l, m_r = wheel_forces_kernel(z, travel, (v @ left) / speed, tyre, soil, 0)
        normal[w] = f_n
        slip = 1.0 - travel if travel <= 1.0 else 1.0 / travel - 1.0
        # The centroid of the stress triangle between theta_2 = c3 theta_1 and theta_1 with its peak at theta_m.
        theta_1 = math.acos(1.0 - z / r)
        middle = (theta_1 + c3 * theta_1 + (c1 + c2 * slip) * theta_1) / 3.0
        lever = r_s * (math.sin(middle) * ahead - math.cos(middle) * up)
        sideways = -f_l * left
        applied[body, :3] = max(f_n - damping * (v @ up), 0.0) * up + f_dp * ahead + sideways
        applied[body, 3:] = np.cross(lever, sideways) - m_r * left


def soil_of(terrain: Terrain) -> tuple[float, ...]:
    return tuple(map(float, terrain.soil[0, 0]))


def angles_of(quaternion: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw. [deg]"""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_euler("ZYX", degrees=True)[::-1]


def by_mujoco(result: Prediction, ground: Ground, step_s: float = STEP_S) -> Track:
    """The single leg of a prediction, from its first pose at the commanded velocity."""
    from scipy.spatial.transform import Rotation

    rover, own = result.rover, joints_of(result)[0]
    velocity, steering, rim = motion_of(rover, result.plan.legs[0])
    model = mujoco.MjModel.from_xml_string(mjcf(rover, steering))
    steps = math.ceil(result.time_s[1] / step_s - 1e-9)
    model.opt.timestep = result.time_s[1] / steps
    data = mujoco.MjData(model)
    start = result.paths[0, 0]
    attitude = Rotation.from_euler("ZYX", start[[5, 4, 3]], degrees=True)
    data.qpos[:3], data.qpos[3:7] = start[:3], attitude.as_quat()[[3, 0, 1, 2]]
    address = [model.joint(name).qposadr[0] for name in joint_names(rover)]
    data.qpos[address] = np.radians(own)
    data.qvel[:3], data.qvel[3:6] = attitude.apply([*velocity[:2], 0.0]), (0.0, 0.0, velocity[2])
    bodies = np.array([model.body(f"{pair}{k}").id for pair in rover.pairs for k in (0, 1)])
    tyre, soil = rover.wheel.vector(), soil_of(result.terrain)
    seen = (data.xpos, data.xmat, data.cvel, data.subtree_com[1])
    normal, rows = np.zeros(len(bodies)), []
    damping = NORMAL_DAMPING * result.rover.mass_kg / len(result.rover.wheels) / MASS_ON_WHEEL
    for k in range((len(result.time_s) - 1) * steps + 1):
        mujoco.mj_step1(model, data)
        push_wheels(bodies, *seen, rim, ground, tyre, soil, damping, data.xfrc_applied, normal)
        if k % steps == 0:
            pose = np.concatenate([data.qpos[:3], angles_of(data.qpos[3:7])])
            rows.append((pose, np.degrees(data.qpos[address]), normal.copy()))
        mujoco.mj_step2(model, data)
    track = Track(*(np.array(part) for part in zip(*rows, strict=True)))
    track.pose[:, 5] = np.degrees(np.unwrap(np.radians(track.pose[:, 5])))
    return track


def column(result: Prediction, name: str) -> np.ndarray:
    return result.states[0, :, :, STATE_COLUMNS.index(name)]


def joints_of(result: Prediction) -> np.ndarray:
    """Left and right rocker angle, then bogies, from where the recorded wheel centres are. (samples, 4 or 2) [deg]"""
    steering = motion_of(result.rover, result.plan.legs[0])[1]
    return np.degrees(joint_angles(result.rover, result.terrain, result.paths[0], result.states[0], steering))


def motion_of(rover: Rover, leg: Leg) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity ahead and left, rate of turn; steering angles; rim speeds."""
    if leg.turn_deg:
        ahead, left, turn = 0.0, 0.0, math.copysign(1.0 / reach_m(rover), leg.turn_deg)
    else:
        ahead, left = math.cos(math.radians(leg.crab_deg)), math.sin(math.radians(leg.crab_deg))
        turn = leg.curvature_per_m
    commands = wheel_commands(rover, ahead, left, turn, SPEED_M_S)
    return SPEED_M_S * np.array([ahead, left, turn]), commands.steering_rad, commands.speed_m_s


def drive(rover: Rover, ground: Ground, leg: Leg, soil: Soil, step_s: float, y_m: float = 0.0) -> Prediction:
    plan = Plan(name="test", legs=(leg,), speed_m_s=SPEED_M_S, y_m=y_m)
    result = predict(rover, ground.terrain(soil), plan, sweep=(), time_step_s=step_s, sample_m=0.1, ruts=False)
    assert result.outcome_text(0) == "finished"
    return result


class Gap(NamedTuple):
    """Largest differences along the drive: path [m], roll or pitch, yaw, joints [deg], wheel loads [-]."""

    path: float
    tilt: float
    yaw: float
    joints: float
    load: float
    mean_load: float


def gap(result: Prediction, track: Track) -> Gap:
    off = np.abs(result.paths[0] - track.pose)
    loads, later = column(result, "normal_force_n"), result.time_s > 2.0
    mean = loads[later].mean(axis=0) / track.normal[later].mean(axis=0) - 1.0
    return Gap(
        float(np.linalg.norm(off[:, :3], axis=1).max()),
        float(off[:, 3:5].max()),
        float(off[:, 5].max()),
        float(np.abs(joints_of(result) - track.joints).max()),
        float(np.abs(loads / track.normal - 1.0).max()),
        float(np.abs(mean).max()),
    )


def lopsided(bogie: str, lengths: dict[str, dict[str, Any]]) -> Rover:
    """A rover whose lengths break every symmetry that could hide a mistake."""
    return dataclasses.replace(
        build_rover("yutu2"),
        bogie=bogie,
        body_center_m=(0.05, 0.03, 0.31),
        steering_offset_m=0.05,
        **lengths[bogie],
    )


TILTED = Ground(-math.tan(math.radians(8.0)), math.tan(math.radians(3.0)))
BUMP = Ground(height=0.08, x=4.0, y=0.8, sigma=0.6)


@pytest.mark.parametrize(
    ("ground", "leg"),
    [(TILTED, Leg(10.0, 0.1)), (BUMP, Leg(10.0))],
    ids=["10 m arc, 8 deg along and 3 deg across", "10 m over a bump of 8 cm under the left wheels"],
)
def test_ten_metres_end_where_mujoco_drives(yutu2: Rover, longji_soil: Soil, ground: Ground, leg: Leg) -> None:
    """At the default step, and five times closer at a fifth of it: what is left is our own step, not the model."""
    one = drive(yutu2, ground, leg, longji_soil, 0.1)
    two = drive(yutu2, ground, leg, longji_soil, 0.02)
    track = by_mujoco(one, ground)
    coarse, fine = gap(one, track), gap(two, track)
    assert coarse.path < 4e-3 and fine.path < 0.8e-3, (coarse, fine)
    assert fine.path < 0.3 * coarse.path
    assert coarse.load < 2.5e-3 and coarse.mean_load < 3e-4 and fine.load < 1e-3, (coarse, fine)
    assert coarse.tilt < 2e-3 and coarse.joints < 5e-3 and coarse.yaw < 0.01, coarse
    # There was something to see: chassis and joints moved.
    assert np.ptp(track.pose[:, 3:5]) > 2.0 and np.ptp(track.normal) > 5.0
    assert ground is TILTED or np.ptp(track.joints[:, 2]) > 3.0


def test_mujoco_itself_has_converged(yutu2: Rover, longji_soil: Soil) -> None:
    """Half its step moves it fifty times less than what is compared; the differential does not give."""
    result = drive(yutu2, BUMP, Leg(2.0, 0.1), longji_soil, 0.1)
    one, two = (by_mujoco(result, BUMP, step) for step in (STEP_S, 0.5 * STEP_S))
    assert np.abs(one.pose[:, :3] - two.pose[:, :3]).max() < 1e-5
    assert np.abs(one.normal - two.normal).max() < 1e-3
    assert np.abs(one.joints[:, 0] + one.joints[:, 1]).max() < 1e-5


@pytest.mark.parametrize("bogie", ["rear", "front", "none"])
def test_lopsided_rovers_follow_mujoco_over_the_bump(
    longji_soil: Soil, bogie: str, lopsided_lengths: dict[str, dict[str, Any]]
) -> None:
    """Bogie in front, at the rear, none; wheels beside their steering axes; centre of mass off the middle."""
    bump = Ground(0.05, -0.03, 0.08, 1.5, 0.6, 0.5)
    result = drive(lopsided(bogie, lopsided_lengths), bump, Leg(3.0, 0.2), longji_soil, 0.005)
    track = by_mujoco(result, bump)
    off = gap(result, track)
    assert off.path < 0.4e-3 and off.load < 1e-3 and off.mean_load < 1e-4, off
    assert off.tilt < 2e-3 and off.joints < 2e-3, off
    assert np.ptp(track.joints[:, 0]) > 1.0


@pytest.mark.parametrize(
    "leg", [Leg(turn_deg=90.0), Leg(turn_deg=-120.0), Leg(1.5, 0.0, 30.0), Leg(1.5, 0.1, 180.0)],
    ids=["turn left", "turn right", "crab", "backwards"],
)  # fmt: skip
def test_turns_on_the_spot_crab_and_reverse_follow_mujoco(yutu2: Rover, longji_soil: Soil, leg: Leg) -> None:
    ground = Ground(0.05, 0.05, 0.05, 0.6, 0.3, 0.5)
    result = drive(yutu2, ground, leg, longji_soil, 0.02)
    track = by_mujoco(result, ground)
    off = gap(result, track)
    assert off.path < 0.5e-3 and off.yaw < 0.01, off
    assert off.load < 1e-3 and off.tilt < 2e-3 and off.joints < 2e-3, off
    if leg.turn_deg:
        assert abs(track.pose[-1, 5]) == pytest.approx(abs(leg.turn_deg), rel=0.1)
