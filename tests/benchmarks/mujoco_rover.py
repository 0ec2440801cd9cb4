"""The rover in MuJoCo: its tree of bodies, steered as commanded, over a terrain, on wheels that push by any law.

MuJoCo has its own kinematics, mass matrix and integrator. Shared with the twin are the commands, the surface of the
terrain between its nodes, and the formulas of `lunarsci.regolith`. The contact frame and where forces act are written
anew from the text of `twin.simulation.contact`.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.regolith.forces import slip_ratio, wheel_forces_kernel
from lunarsci.regolith.integrals import NODES, WEIGHTS, contact_kernel
from lunarsci.twin.ground.terrain import Terrain, nodes_about, smooth_surface
from lunarsci.twin.plans.path import all_commands, make_schedule, start_motion
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import DEEPEST, NORMAL_DAMPING, SHALLOWEST, VALID_SLIP
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS

ACROSS = np.linspace(-0.5, 0.5, 7)
"""Where a wheel looks at the rut below it, as shares of its width."""
FASTEST_M_S = 1.0
STEEPEST_TILT = 0.5
"""Cosine of 60 deg."""


def text(vector: object) -> str:
    """Numbers as MuJoCo reads them."""
    return " ".join(repr(float(v)) for v in np.ravel(vector))


def straight_arm(rover: Rover, pair: str, k: int) -> np.ndarray:
    """Wheel centre on the left (k = 0) or right, not steered."""
    return np.array(getattr(rover, f"{pair}_wheel_m")) * (1.0, 1.0 - 2.0 * k, 1.0)


def steered_arm(rover: Rover, pair: str, k: int, angle: float) -> np.ndarray:
    """Wheel centre on the left (k = 0) or right, `steering_offset_m` outboard of its steering axis."""
    offset = (1.0 - 2.0 * k) * rover.steering_offset_m
    return straight_arm(rover, pair, k) + offset * np.array([-math.sin(angle), math.cos(angle) - 1.0, 0.0])


def hung_pairs(rover: Rover) -> tuple[str, ...]:
    """Pairs of wheels on the bogies."""
    return {"rear": ("middle", "rear"), "front": ("front", "middle"), "none": ()}[rover.bogie]


def mjcf(rover: Rover, steering: np.ndarray) -> str:
    """The rover with its wheels standing as steered."""
    tiny = 'diaginertia="1e-9 1e-9 1e-9"'
    hinge = f'type="hinge" axis="0 1 0" damping="{rover.joint_damping_n_m_s}"'
    hung = hung_pairs(rover)

    def wheel(pair: str, k: int) -> str:
        angle = steering[2 * rover.pairs.index(pair) + k]
        place = steered_arm(rover, pair, k, angle)
        turned = text([math.cos(0.5 * angle), 0.0, 0.0, math.sin(0.5 * angle)])
        return (
            f'<body name="{pair}{k}" pos="{text(place)}" quat="{turned}">'
            f'<inertial pos="0 0 0" mass="{rover.wheel_kg}" {tiny}/></body>'
        )

    def side(k: int) -> str:
        mirror, empty = np.array([1.0, 1.0 - 2.0 * k, 1.0]), f'<inertial pos="0 0 0" mass="1e-9" {tiny}/>'
        on_bogie = "".join(wheel(pair, k) for pair in hung)
        bogie = on_bogie and (
            f'<body pos="{text(mirror * rover.bogie_pivot_m)}"><joint name="bogie{k}" {hinge}/>{empty}{on_bogie}</body>'
        )
        on_rocker = "".join(wheel(pair, k) for pair in rover.pairs if pair not in hung)
        pivot = text(mirror * (0.0, rover.rocker_pivot_y_m, 0.0))
        return f'<body pos="{pivot}"><joint name="rocker{k}" {hinge}/>{empty}{on_rocker}{bogie}</body>'

    return f"""<mujoco><option gravity="0 0 {-rover.gravity_m_s2}" integrator="implicitfast"/>
      <worldbody><body><freejoint/>
      <inertial pos="{text(rover.body_center_m)}" mass="{rover.body_kg}"
        diaginertia="{text(rover.body_inertia_kg_m2)}"/>
      {side(0)}{side(1)}</body></worldbody>
      <equality><joint joint1="rocker1" joint2="rocker0" polycoef="0 -1 0 0 0"
        solref="0.005 1" solimp="0.9999 0.9999 0.001"/></equality></mujoco>"""


def joint_names(rover: Rover) -> tuple[str, ...]:
    """Of the hinges, in the order of `joint_angles`."""
    return ("rocker0", "rocker1", "bogie0", "bogie1") if hung_pairs(rover) else ("rocker0", "rocker1")


def joint_angles(
    rover: Rover, terrain: Terrain, pose: np.ndarray, states: np.ndarray, steering: np.ndarray
) -> np.ndarray:
    """Left and right rocker angle, then bogies, from where the recorded wheel centres are. (samples, 4 or 2) [rad]

    `pose` and `states` are the paths and states of one member of a prediction, `steering` its constant angles. [rad]
    """
    from scipy.spatial.transform import Rotation

    x, y, sinkage = (states[..., STATE_COLUMNS.index(name)] for name in ("x_m", "y_m", "sinkage_m"))
    height, slope_x, slope_y = np.moveaxis(terrain.surface_at(x, y), -1, 0)
    z = height + (rover.wheel.radius_m - sinkage) * np.sqrt(1.0 + slope_x**2 + slope_y**2)
    inverse = Rotation.from_euler("ZYX", pose[:, [5, 4, 3]], degrees=True).inv()
    seen = np.stack([inverse.apply(np.stack([x, y, z], -1)[:, w] - pose[:, :3]) for w in range(len(rover.wheels))], 1)
    hung = hung_pairs(rover)
    lone = next(pair for pair in rover.pairs if pair not in hung)

    def arm_of(pair: str, k: int) -> tuple[np.ndarray, np.ndarray]:
        number = 2 * rover.pairs.index(pair) + k
        return steered_arm(rover, pair, k, steering[number]), seen[:, number]

    angles = [_turned_by(*arm_of(lone, k)) for k in (0, 1)]
    for k in (0, 1):
        if hung:
            (arm_1, seen_1), (arm_2, seen_2) = arm_of(hung[0], k), arm_of(hung[1], k)
            angles.append(_turned_by(arm_1 - arm_2, seen_1 - seen_2) - angles[k])
    return np.array(angles).T


def _turned_by(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Angle about y that turns a segment's x, z part."""
    return np.asarray(np.arctan2(-after[:, 2], after[:, 0]) - math.atan2(-before[2], before[0]))


class Law(NamedTuple):
    """How a wheel is pushed.

    Attributes
    ----------
    exact : the stress integrals; otherwise the closed form of the twin.
    model : `ContactModel.vector()` of the integrals, without a rut.
    rise : A_u of a rut's reloading (Wong 2008); 0 leaves no ruts. [N m^-4]
    """

    exact: bool
    model: tuple[float, ...]
    rise: float


class Ruts(NamedTuple):
    """How deep wheels have pressed the ground, on a grid of its own. [m]"""

    x0: float
    y0: float
    spacing: float
    depth: np.ndarray


def fresh_ruts(terrain: Terrain, spacing_m: float = 0.025) -> Ruts:
    """Undisturbed ground."""
    size = [math.ceil(span / spacing_m) + 2 for span in (np.ptp(terrain.y_m), np.ptp(terrain.x_m))]
    return Ruts(float(terrain.x0_m), float(terrain.y0_m), spacing_m, np.zeros(size))


@compiled
def unit_cross(a, b):
    """Unit vector across two others."""
    c = np.cross(a, b)
    return c / math.sqrt(c @ c)


@compiled
def ground_below(grid, x, y, soil):
    """Height and gradient below a point, and its soil into `soil` (8); NaN off the map."""
    ny, nx = grid.height.shape
    column, row = (x - grid.x0) / grid.spacing, (y - grid.y0) / grid.spacing
    if not (0.0 <= column <= nx - 1 and 0.0 <= row <= ny - 1):
        return math.nan, math.nan, math.nan
    j, i = min(int(column), nx - 2), min(int(row), ny - 2)
    a, b = column - j, row - i
    if grid.soil.shape[0] == 1:
        soil[:] = grid.soil[0, 0]
    else:
        for k in range(8):
            low = (1.0 - a) * grid.soil[i, j, k] + a * grid.soil[i, j + 1, k]
            soil[k] = (1.0 - b) * low + b * ((1.0 - a) * grid.soil[i + 1, j, k] + a * grid.soil[i + 1, j + 1, k])
    nodes = np.empty(16)
    nodes_about(grid, i, j, nodes)
    height, rise_x, rise_y = smooth_surface(nodes, a, b)
    return height, rise_x / grid.spacing, rise_y / grid.spacing


@compiled
def rut_below(ruts, x, y, left, width, across):
    """Mean depth of the rut over a wheel's width. [m]"""
    ny, nx = ruts.depth.shape
    total = 0.0
    for share in across:
        column = (x + share * width * left[0] - ruts.x0) / ruts.spacing
        row = (y + share * width * left[1] - ruts.y0) / ruts.spacing
        if not (0.0 <= column < nx - 1 and 0.0 <= row < ny - 1):
            continue
        j, i = int(column), int(row)
        a, b = column - j, row - i
        low = (1.0 - a) * ruts.depth[i, j] + a * ruts.depth[i, j + 1]
        total += (1.0 - b) * low + b * ((1.0 - a) * ruts.depth[i + 1, j] + a * ruts.depth[i + 1, j + 1])
    return total / len(across)


@compiled
def press(ruts, marks, width):
    """Press marks (n, 5) of x, y, leftward unit vector and depth into the ground, across a wheel's width."""
    ny, nx = ruts.depth.shape
    for x, y, left_x, left_y, depth in marks:
        for k in range(-6, 7):
            j = round((x + k / 12.0 * width * left_x - ruts.x0) / ruts.spacing)
            i = round((y + k / 12.0 * width * left_y - ruts.y0) / ruts.spacing)
            if 0 <= i < ny and 0 <= j < nx:
                ruts.depth[i, j] = max(ruts.depth[i, j], depth)


@compiled
def push_of(law, sinkage, rut, v_x, v_y, rim, tyre, soil, nodes, weights):
    """F_N, F_DP, F_L, M_R, and the moments about the normal and the heading. [N, N m]"""
    own = (soil[0], soil[1], soil[2], soil[3], soil[4], soil[5], soil[6], soil[7])
    if law.exact:
        # Reloading is never softer than first loading was.
        first = soil[0] * rut ** (soil[1] - 1.0) if rut > 0.0 else 0.0
        model = (
            law.model[0], law.model[1], law.model[2], law.model[3], law.model[4], law.model[5], rut, first, law.rise
        )  # fmt: skip
        return contact_kernel(sinkage, (v_x, v_y, rim), tyre, own, model, (nodes, weights))
    f_n, f_dp, f_l, m_r = wheel_forces_kernel(sinkage, v_x / rim, v_y / rim, tyre, own, 0)
    # The centroid of the stress triangle between theta_2 = c3 theta_1 and theta_1 with its peak at theta_m.
    theta_1 = math.acos(1.0 - sinkage / tyre[0])
    middle = (1.0 + tyre[6] + tyre[4] + tyre[5] * slip_ratio(v_x / rim)) * theta_1 / 3.0
    return f_n, f_dp, f_l, m_r, -tyre[3] * f_l * math.sin(middle), -tyre[3] * f_l * math.cos(middle)


@compiled
def push_wheels(bodies, place, turn, motion, about, rims, grid, ruts, tyre, law, rule, applied, seen, marks):
    """The wrench of the soil on every wheel into `applied` (bodies, 6), world axes at the wheel centre.

    Its state goes into `seen` (wheels, 10), columns `STATE_COLUMNS`, and what it presses into `marks` (wheels, 5).
    """
    nodes, weights, across = rule
    r, soil = tyre[0], np.empty(8)
    for w in range(len(bodies)):
        body, rim = bodies[w], abs(rims[w])
        center, axle = place[body], turn[body][1::3] * math.copysign(1.0, rims[w])
        v = motion[body, 3:] + np.cross(motion[body, :3], center - about)
        height, slope_x, slope_y = ground_below(grid, center[0], center[1], soil)
        up = np.array([-slope_x, -slope_y, 1.0])
        up /= math.sqrt(up @ up)
        ahead = unit_cross(axle, up)
        left = np.cross(up, ahead)
        total = r - (center[2] - height) * up[2]
        rut = rut_below(ruts, center[0], center[1], left, tyre[1], across) if law.rise > 0.0 else 0.0
        risen, rut = 0.0, rut if rut > SHALLOWEST else 0.0
        if rut > 0.0:
            risen = rut - soil[0] * rut ** soil[1] / (soil[0] * rut ** (soil[1] - 1.0) + law.rise * rut)
        sinkage = total - risen * up[2]
        v_x, v_y, v_z = v @ ahead, v @ left, v @ up
        slip = slip_ratio(v_x / rim)
        applied[body], seen[w] = 0.0, 0.0
        if sinkage > SHALLOWEST:
            z = min(sinkage, DEEPEST * r)
            f_n, f_dp, f_l, m_r, m_up, m_ahead = push_of(law, z, rut, v_x, v_y, rim, tyre, soil, nodes, weights)
            applied[body, :3] = max(f_n - NORMAL_DAMPING * v_z, 0.0) * up + f_dp * ahead - f_l * left
            applied[body, 3:] = m_up * up + m_ahead * ahead - m_r * left
            seen[w, 5], seen[w, 6], seen[w, 7], seen[w, 8] = f_n, f_dp, f_l, m_r
            seen[w, 9] = 1.0 if total <= DEEPEST * r and abs(slip) <= VALID_SLIP else 0.0
        seen[w, 0], seen[w, 1], seen[w, 2], seen[w, 3] = center[0], center[1], max(total, 0.0), slip
        seen[w, 4] = math.degrees(math.atan2(v_y, abs(v_x)))
        marks[w, 0], marks[w, 1], marks[w, 2], marks[w, 3] = center[0], center[1], left[0], left[1]
        marks[w, 4] = max(total, 0.0)


@compiled
def steer(angles, bodies, straight, offset, place, turn):
    """Stand every wheel as commanded; that it rolls while it is being steered is left out, as in the twin."""
    for w in range(len(bodies)):
        angle, body = angles[w], bodies[w]
        place[body, 0] = straight[w, 0] - offset[w] * math.sin(angle)
        place[body, 1] = straight[w, 1] + offset[w] * (math.cos(angle) - 1.0)
        turn[body, 0], turn[body, 3] = math.cos(0.5 * angle), math.sin(0.5 * angle)


@dataclass(frozen=True, kw_only=True, eq=False)
class Driven:
    """A drive: times (n,), poses as `PATH_COLUMNS` (n, 6), states as `STATE_COLUMNS` (n, wheels, 10), how it ended."""

    time_s: np.ndarray
    poses: np.ndarray
    states: np.ndarray
    outcome: str

    @property
    def finished(self) -> bool:
        """Whether it came to the end of the plan."""
        return self.outcome == "finished"


class _Model:
    """The rover in MuJoCo, at its start."""

    def __init__(self, rover: Rover, start: Any, steering: np.ndarray, schedule: Any, step_s: float) -> None:
        import mujoco
        from scipy.spatial.transform import Rotation

        self.model = mujoco.MjModel.from_xml_string(mjcf(rover, steering))
        self.model.opt.timestep = step_s
        self.data = mujoco.MjData(self.model)
        pose, joints = start
        attitude = Rotation.from_euler("ZYX", pose[[5, 4, 3]], degrees=True)
        self.data.qpos[:3], self.data.qpos[3:7] = pose[:3], attitude.as_quat()[[3, 0, 1, 2]]
        self.data.qpos[[self.model.joint(name).qposadr[0] for name in joint_names(rover)]] = joints
        ahead, left, turn = start_motion(schedule, rover)
        self.data.qvel[:3], self.data.qvel[3:6] = attitude.apply([ahead, left, 0.0]), (0.0, 0.0, turn)
        arms = [(pair, k) for pair in rover.pairs for k in (0, 1)]
        self.bodies = np.array([self.model.body(f"{pair}{k}").id for pair, k in arms])
        straight = np.array([straight_arm(rover, pair, k) for pair, k in arms])
        offset = np.array([(1.0 - 2.0 * k) * rover.steering_offset_m for _, k in arms])
        offset = np.where(rover.steered_mask, offset, 0.0)
        self.standing = (self.bodies, straight, offset, self.model.body_pos, self.model.body_quat)
        self.seen = (self.bodies, self.data.xpos, self.data.xmat, self.data.cvel, self.data.subtree_com[1])

    def pose(self) -> np.ndarray:
        """As `PATH_COLUMNS`."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_quat(self.data.qpos[[4, 5, 6, 3]]).as_euler("ZYX", degrees=True)[::-1]
        return np.concatenate([self.data.qpos[:3], turned])

    def trouble(self, states: np.ndarray, radius_m: float) -> str:
        """Why the drive cannot go on, or nothing."""
        if not (np.isfinite(self.data.qpos).all() and np.isfinite(states).all()):
            return "left the terrain or diverged"
        if np.abs(self.data.qvel[:3]).max() > FASTEST_M_S:
            return "fell"
        if self.data.xmat[1][8] < STEEPEST_TILT:
            return "overturned"
        return "sank" if states[:, 2].max() > DEEPEST * radius_m else ""


def drive(
    rover: Rover, terrain: Terrain, plan: Any, law: Law, start: Any, ruts: Ruts, *, step_s: float, sample_s: float = 2.0
) -> Driven:
    """Drive a plan from a start: its pose as `PATH_COLUMNS`, and its joint angles [rad].

    `ruts` are read and pressed on where the law leaves any. Wheels press behind themselves, 3 s late, so that none
    meets its own rut before it comes back.
    """
    import mujoco

    schedule = make_schedule(plan, rover)
    samples = max(1, math.ceil(schedule.duration_s / sample_s))
    every = math.ceil(schedule.duration_s / samples / step_s)
    times = np.linspace(0.0, schedule.duration_s, samples * every + 1)
    commands = all_commands(rover, schedule, times)
    angles, rims = (np.ascontiguousarray(part[0]) for part in (commands.steering_rad, commands.speed_m_s))
    rig, grid, tyre = _Model(rover, start, angles[0], schedule, times[1]), terrain.grid(), rover.wheel.vector()
    seen, marks = np.zeros((len(rover.wheels), 10)), np.zeros((len(rover.wheels), 5))
    rule, rows = (NODES, WEIGHTS, ACROSS), []
    mark_every, late, waiting = max(1, round(0.2 / times[1])), round(3.0 / times[1]), []
    model, data, outcome = rig.model, rig.data, "finished"
    for n in range(len(times)):
        now = min(n, len(rims) - 1)
        steer(angles[now], *rig.standing)
        mujoco.mj_step1(model, data)
        push_wheels(*rig.seen, rims[now], grid, ruts, tyre, law, rule, data.xfrc_applied, seen, marks)
        if law.rise > 0.0 and n % mark_every == 0:
            waiting.append((n, marks.copy()))
            while n - waiting[0][0] > late:
                press(ruts, waiting.pop(0)[1], tyre[1])
        if n % every == 0:
            if trouble := rig.trouble(seen, tyre[0]):
                outcome = trouble
                break
            rows.append((times[n], rig.pose(), seen.copy()))
        mujoco.mj_step2(model, data)
    for _, mark in waiting:
        press(ruts, mark, tyre[1])
    time, poses, states = (np.array(part) for part in zip(*rows, strict=True))
    poses[:, 5] = np.degrees(np.unwrap(np.radians(poses[:, 5])))
    return Driven(time_s=time, poses=poses, states=states, outcome=outcome)
