"""A rover that is in static equilibrium wherever it is, with a wheel-soil law of its own: an outside judge of the twin.

It shares no code with the twin but the numbers of rover, plan and terrain. At every step the weight, the wheel forces
and the joints of the suspension balance (six equations of the whole, one of the differential, one of each bogie), and
that decides at once how the rover stands (height, roll, pitch, differential, bogies) and how it moves (forward, to the
left, turning). Its law of wheel and soil is not the closed form of Ding et al. (2024): `QuasiStatic` lists how.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from mujoco_rover import Driven
from quasi_static_forces import Ground, Law, balance, height_of, place, plane_at, wheel_forces

from lunarsci.errors import ParameterError
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover

FloatArray = npt.NDArray[np.float64]

PARAMETERS = ("stiffness_kpa_m_n", "sinkage_exponent", "sinkage_exponent_slip", "cohesion_pa", "friction_angle_deg",
              "shear_modulus_mm", "external_friction_angle_deg", "lateral_modulus_mm")  # fmt: skip
OUTCOMES = ("finished", "no equilibrium", "left the map")
TIGHT = 1e-11
LOOSE = 1e-8
"""Largest sums of forces over the weight, and of moments over the weight times 1 m: aimed at, and accepted."""
PACES = (1.0, 0.9, 0.7, 1.2, 0.4, 1.6, 0.1)
"""Shares of the last speed at which an equilibrium is looked for where the one at hand is lost; assumed."""
NUDGE, LONGEST_STEP, MOST_TRIALS = 1e-7, 0.005, 80
"""Of Newton's iteration: differences for its derivatives, and its longest step, in m, rad, m/s and rad/s."""


@dataclass(frozen=True, kw_only=True)
class QuasiStatic:
    """Choices that Ding et al. (2024) make otherwise, or leave open.

    Attributes
    ----------
    peak_c1, peak_c2 : the largest stress is at (c1 + c2 s) of the entrance angle. Wong & Reece (1967,
        10.1016/0022-4898(67)90105-X) give c1 0.18, c2 0.32 for compact sand and 0.43, 0.32 for loose sand. [-]
    rebound : the soil comes up behind the wheel by this share of the sinkage, so the exit angle is
        -arccos(1 - rebound z / r); Ishigami et al. (2007, 10.1002/rob.20187), their lambda. 0 is flat. [-]
    entry : shear starts where a circle of radius r + entry h enters the ground: 0 at the shell (Wong & Reece 1967), 1
        at the tips of the grousers (Ding et al. 2024, Eq. 15). [-]
    side_share : of the bulldozing resistance on the side face after Hegedus (1960), as in Ishigami et al. (2007) and
        times the sine of the side slip angle; 0 is without. [-]
    density_kg_m3 : of the soil, for bulldozing; 1300-1800 in the first 15 cm (Lunar Sourcebook, 1991).
    footprint_m : the ground below a wheel is the plane through four points at this distance; assumed. [m]
    step_m : travel between equilibria, > 0. [m]
    nodes : Gauss points of the stress integrals before and behind the largest stress.

    Common to all: stresses are integrated over the rim; shear along and across shares one ellipse, with
    (tau_x/tau_xmax)^2 + (tau_y/tau_ymax)^2 = (1 - exp(-e))^2 and e^2 = (j_x/K_x)^2 + (j_y/K_y)^2; the rim turns against
    the arm that carries its motor. Raises ParameterError.
    """

    peak_c1: float = 0.305
    peak_c2: float = 0.32
    rebound: float = 0.1
    entry: float = 0.65
    side_share: float = 1.0
    density_kg_m3: float = 1600.0
    footprint_m: float = 0.04
    step_m: float = 0.02
    nodes: int = 8

    def __post_init__(self) -> None:
        if not 0 < self.peak_c1 < 1 or not (0 <= self.rebound <= 1 and 0 <= self.entry <= 1):
            raise ParameterError("quasi-static physics need 0 < peak_c1 < 1, rebound and entry within 0 to 1")
        if not self.side_share >= 0:
            raise ParameterError("quasi-static physics need side_share of 0 or more")
        if not (self.footprint_m > 0 and self.step_m > 0 and self.density_kg_m3 >= 0 and self.nodes >= 2):
            raise ParameterError("quasi-static physics need footprint_m and step_m above 0, and at least 2 nodes")


def draw_physics(seed: int, **fixed: Any) -> QuasiStatic:
    """Physics within the ranges of their sources, uniform; `fixed` fields are taken as given."""
    random = np.random.default_rng(seed)
    drawn = {
        "peak_c1": random.uniform(0.18, 0.43),
        "rebound": random.uniform(0.0, 0.3),
        "entry": random.uniform(0.0, 1.0),
        "side_share": random.uniform(0.0, 1.0),
        "density_kg_m3": random.uniform(1300.0, 1800.0),
        "footprint_m": random.uniform(0.02, 0.06),
    }
    return QuasiStatic(**(drawn | fixed))


def equilibrium(scene: Any, command: Any, now: FloatArray, q: FloatArray) -> tuple[FloatArray, float]:
    """Newton's iteration for q, in place; states of the wheels, and the largest sum left over, NaN off the map.

    The derivatives are taken anew where the last ones did not bring it ten times nearer.
    """
    size, wheels = 9 if scene[0].bogies else 7, np.empty((len(command[0]), 10))

    def left_over(q: FloatArray) -> FloatArray:
        rest = np.empty(9)
        balance(scene, command, now, q, rest, wheels)
        return rest[:size]

    rest, step, fresh = left_over(q), np.zeros(9), False
    error = float(np.abs(rest).max())
    by_q: FloatArray = np.empty((0, size))
    for _ in range(MOST_TRIALS):
        if error < TIGHT or math.isnan(error):
            break
        if fresh or not len(by_q):
            nudged = [left_over(q + NUDGE * unit) for unit in np.eye(9)[:size]]
            by_q, fresh = np.asarray(np.linalg.pinv((np.array(nudged) - rest).T / NUDGE), dtype=np.float64), True
        step[:size] = -by_q @ rest
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP))
        found = left_over(q + step)
        while fresh and not np.abs(found).max() < error and np.abs(step).max() > NUDGE * LONGEST_STEP:
            step *= 0.5
            found = left_over(q + step)
        worst = float(np.abs(found).max())
        if worst < error:
            q += step
        elif fresh:
            break
        fresh = not worst < 0.1 * error
        if worst < error:
            rest, error = found, worst
    rest = left_over(q)
    return wheels, float(np.abs(rest).max())


def touch_down(scene: Any, steer: FloatArray, now: FloatArray, depth: float) -> FloatArray:
    """q at rest in which all wheels are about `depth` deep, as a start of Newton's iteration. (9,)"""
    rover, law, ground = scene
    count, q, points = len(steer), np.zeros(9), np.empty((4, 3))
    q[3] = height_of(ground, now[0], now[1])

    def gaps(q: FloatArray) -> FloatArray:
        found = []
        for i in range(count):
            place(rover, q, i, steer[i], points)
            x = now[0] + math.cos(now[2]) * points[0, 0] - math.sin(now[2]) * points[0, 1]
            y = now[1] + math.sin(now[2]) * points[0, 0] + math.cos(now[2]) * points[0, 1]
            height, east, north = plane_at(ground, x, y, law.footprint)
            found.append(q[3] + points[0, 2] - height - (law.radius - depth) * math.sqrt(1.0 + east**2 + north**2))
        return np.array(found)

    for _ in range(8):
        gap = gaps(q)
        if not np.isfinite(gap).all():
            break
        nudges = 1e-6 * np.eye(9)[3 : 3 + count]
        jacobian = np.stack([(gaps(q + nudge) - gap) / 1e-6 for nudge in nudges], axis=1)
        q[3 : 3 + count] -= np.linalg.solve(jacobian, gap)
    return q


class _Follower:
    """The rover under way: where it is, how it stands and moves, its wheels, how long ago that was solved."""

    def __init__(self, scene: Any, now: FloatArray, steps: Any, depth: float) -> None:
        steer, rims, meant = steps[:3]
        self.scene, self.now = scene, now
        self.q = touch_down(scene, steer[0], now, depth)
        self.since, self.rate, self.depth = math.inf, np.zeros(9), depth
        self.outcome = self.begin(steer[0], np.nan_to_num(rims[0]), meant[0])

    def begin(self, steer: FloatArray, rims: FloatArray, meant: FloatArray) -> str:
        """Find the equilibrium at the begin of a leg; the outcome."""
        self.since, self.rate, self.q[:3] = math.inf, np.zeros(9), meant
        outcome, self.since = self.settle(steer, rims, 0.0), 0.0
        return outcome

    def settle(self, steer: FloatArray, rims: FloatArray, onward: float) -> str:
        """Find the equilibrium a time `onward` from now; the outcome."""
        before, since = self.q.copy(), self.since + onward
        command = (steer, rims, before, since, onward)
        if since < math.inf:
            self.q += since * self.rate
        self.wheels, error = equilibrium(self.scene, command, self.now, self.q)
        for share in PACES:
            if not error >= LOOSE:
                break
            # The equilibrium is lost, as where more slip means less pull: look for one at another pace.
            self.q = touch_down(self.scene, steer, self.now, self.depth)
            self.q[:3] = share * before[:3]
            self.wheels, error = equilibrium(self.scene, command, self.now, self.q)
        self.rate[3:] = (self.q - before)[3:] / since if 0.0 < since < math.inf else self.rate[3:]
        return OUTCOMES[0 if error < LOOSE else 1 if error >= LOOSE else 2]

    def step(self, steer: FloatArray, rims: FloatArray, dt: float) -> None:
        """Go on for a time with the velocity in its middle."""
        self.outcome = self.settle(steer, rims, 0.5 * dt)
        yaw, (ahead, left, turn) = self.now[2] + 0.5 * dt * self.q[2], dt * self.q[:3]
        self.now += (math.cos(yaw) * ahead - math.sin(yaw) * left, math.sin(yaw) * ahead + math.cos(yaw) * left, turn)
        self.since = 0.5 * dt

    def pose(self) -> FloatArray:
        """As PATH_COLUMNS, angles in rad. (6,)"""
        return np.array([*self.now[:2], *self.q[3:6], self.now[2]])


def follow(
    scene: Any, steps: Any, now: FloatArray, depth: float, law_at: Callable[[FloatArray], Law] | None = None
) -> tuple[FloatArray, FloatArray, str]:
    """Poses (n, 6) [m, rad] and wheel states (n, wheels, 10) at the samples reached, and the outcome.

    `law_at` gives the law at x, y and heading [m, m, rad], where it changes on the way.
    """
    under_way = _Follower(scene, now, steps, depth)
    if under_way.outcome != OUTCOMES[0]:
        return np.empty((0, 6)), np.empty((0, *under_way.wheels.shape)), under_way.outcome
    poses, states = [under_way.pose()], [under_way.wheels.copy()]
    for steer, rims, meant, dt, fresh, sampled in zip(*steps, strict=True):
        halted = bool(np.isnan(rims[0]))
        if not halted:
            if law_at is not None:
                under_way.scene = (scene[0], law_at(under_way.now), scene[2])
            if fresh:
                under_way.outcome = under_way.begin(steer, rims, meant)
            under_way.step(steer, rims, dt)
            if sampled and under_way.outcome == OUTCOMES[0]:
                under_way.outcome, under_way.since = under_way.settle(steer, rims, 0.0), 0.0
        if under_way.outcome != OUTCOMES[0]:
            break
        if sampled:
            poses.append(under_way.pose())
            states.append(under_way.wheels.copy())
            states[-1][:, 3:5] *= not halted
    return np.array(poses), np.array(states), under_way.outcome


def drive(
    rover: Rover,
    terrain: Terrain,
    plan: Plan,
    soil: Mapping[str, float],
    physics: QuasiStatic,
    *,
    sample_m: float = 0.1,
    soil_at: Callable[[FloatArray], Mapping[str, float]] | None = None,
) -> Driven:
    """Drive a plan on one soil. Slip and side slip are 0 at a halt, as no speed is there to compare with.

    `soil` names parameters as `Soil` does, in its units; `sample_m` is the longest travel between samples. `soil_at`
    gives the soil below all wheels with the rover at x, y and heading [m, m, rad]; `soil` is then that of the start.
    """
    times, steps = _steps(rover, plan, physics.step_m, sample_m)
    scene = (rover.vector(), law_of(rover, soil, physics), _ground(terrain))
    weight = rover.mass_kg * rover.gravity_m_s2 / len(rover.wheels)
    start = np.array([plan.x_m, plan.y_m, math.radians(plan.heading_deg)])
    law_at = None if soil_at is None else (lambda now: law_of(rover, soil_at(now), physics))
    poses, states, outcome = follow(scene, steps, start, _first_depth(scene[1], weight), law_at)
    poses[:, 3:] = np.degrees(poses[:, 3:])
    return Driven(time_s=times[: len(poses)], poses=poses, states=states, outcome=outcome)


def law_of(rover: Rover, soil: Mapping[str, float], physics: QuasiStatic) -> Law:
    """What the kernels read of a wheel and a soil."""
    wheel, scale = rover.wheel, (1e3, 1.0, 1.0, 1.0, None, 1e-3, None, 1e-3)
    values = [float(soil[name]) for name in PARAMETERS]
    si = [math.tan(math.radians(v)) if k is None else v * k for v, k in zip(values, scale, strict=True)]
    nodes, weights = np.polynomial.legendre.leggauss(physics.nodes)
    return Law(
        wheel.radius_m, wheel.shearing_radius_m, wheel.width_m, np.array(si), physics.peak_c1, physics.peak_c2,
        physics.rebound, wheel.radius_m + physics.entry * wheel.grouser_height_m, physics.side_share,
        physics.density_kg_m3 * rover.gravity_m_s2, physics.footprint_m, 0.5 * (nodes + 1.0), 0.5 * weights,
    )  # fmt: skip


def _first_depth(law: Law, load_n: float) -> float:
    low, high = 0.0, 0.5 * law.radius
    for _ in range(40):
        middle = 0.5 * (low + high)
        deeper = wheel_forces(law, middle, 0.05, 0.0, 0.05, 0.0)[0] < load_n
        low, high = (middle, high) if deeper else (low, middle)
    return middle


def _ground(terrain: Terrain) -> Ground:
    height = np.ascontiguousarray(terrain.height_m, dtype=float)
    return Ground(float(terrain.x0_m), float(terrain.y0_m), float(terrain.spacing_m), height,
                  terrain.interpolation == "triangles")  # fmt: skip


def motion(leg: Leg, rover: Rover, speed: float) -> FloatArray:
    """Velocity ahead, to the left and turning that the wheels are to give. (3,) [m/s, m/s, rad/s]"""
    if leg.stop_s:
        return np.zeros(3)
    if leg.turn_deg:
        rate = math.copysign(speed / np.hypot(*_spokes(rover).T).max(), leg.turn_deg)
        return np.array([0.0, -rate * rover.turning_x_m, rate])
    crab, rate = math.radians(leg.crab_deg), speed * leg.curvature_per_m
    straight = abs(math.sin(crab)) < 1e-12
    return np.array([speed * math.cos(crab), -rate * rover.turning_x_m if straight else speed * math.sin(crab), rate])


def _spokes(rover: Rover) -> FloatArray:
    return np.asarray(rover.wheel_positions_m[:, :2] - (rover.turning_x_m, 0.0))


def wheel_commands(rover: Rover, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Steering angles within ±90° and rim speeds r_s omega for velocities (n, 3): each across its spoke. (n, w)"""
    x, y = rover.wheel_positions_m[:, 0], rover.wheel_positions_m[:, 1]
    side, steers = np.sign(y), rover.steered_mask
    axis = y - side * rover.steering_offset_m * steers
    ahead, left = moved[:, :1] - moved[:, 2:] * axis, moved[:, 1:2] + moved[:, 2:] * x
    angle = np.where(steers, np.arctan2(left, ahead), 0.0)
    # Rounding must not decide between +90 and -90 degrees: wheels turn to the left, and roll on.
    back = steers & ((angle > 0.5 * np.pi + 1e-9) | (angle < -0.5 * np.pi - 1e-9))
    angle = np.where(back, angle - np.copysign(np.pi, angle), angle)
    rim = np.cos(angle) * ahead + np.sin(angle) * left - moved[:, 2:] * side * rover.steering_offset_m * steers
    return angle, rim


def wheel_turns(rover: Rover, plan: Plan, step_m: float = 0.005) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What the wheels do: times (n + 1,), and in each step steering (n, w) [rad], rims (n, w) [m/s], NaN at a halt."""
    _, (steer, rims, _, dt, _, _) = _steps(rover, plan, step_m, step_m)
    return np.concatenate([[0.0], np.cumsum(dt)]), steer, rims


def _steps(rover: Rover, plan: Plan, step_m: float, sample_m: float) -> tuple[FloatArray, Any]:
    """Sample times, and for each step: steering, rims (NaN at a halt), velocities meant, length, fresh, sampled."""
    speed, bounds, moves = plan.speed_m_s, [0.0], []
    for leg in plan.legs:
        moved = motion(leg, rover, speed)
        took = leg.stop_s or (math.radians(leg.turn_deg) / moved[2] if leg.turn_deg else leg.length_m / speed)
        bounds.append(bounds[-1] + took)
        moves.append(moved)
    times = np.linspace(0.0, bounds[-1], max(1, math.ceil(bounds[-1] * speed / sample_m - 1e-9)) + 1)
    edges = np.unique(np.concatenate([times, [b for b in bounds if np.abs(times - b).min() > 1e-9]]))
    counts = [max(1, math.ceil((b - a) * speed / step_m - 1e-9)) for a, b in pairwise(edges)]
    parts = [np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(pairwise(edges), counts, strict=True)]
    nodes = np.concatenate([[0.0], *parts])
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    leg_of = np.minimum(np.searchsorted(bounds, middle) - 1, len(moves) - 1)
    moved = np.array(moves)[leg_of]
    moved[:, 2] += _blends(plan, bounds, moves, middle)
    steer, rims = wheel_commands(rover, moved)
    rims *= np.array([_rate_ratios(leg, rover) for leg in plan.legs])[leg_of]
    rims[np.array([bool(leg.stop_s) for leg in plan.legs])[leg_of]] = np.nan
    fresh = np.concatenate([[True], np.diff(leg_of) != 0])
    sampled = np.abs(nodes[1:, None] - times[None, :]).min(axis=1) < 1e-9
    return times, (steer, rims, moved, np.diff(nodes), fresh, sampled)


def _rate_ratios(leg: Leg, rover: Rover) -> FloatArray:
    """Of the wheels; a wheel test begins and ends at once."""
    test = leg.wheel_test
    return np.array([test.rate_ratio if test and test.wheel == wheel else 1.0 for wheel in rover.wheels])


def _blends(plan: Plan, bounds: list[float], moves: list[FloatArray], at: FloatArray) -> FloatArray:
    """What a linear change of the turning rate over blend_m adds to it, between arcs of one direction."""
    added = np.zeros_like(at)
    for k in range(1, len(moves)):
        a, b = plan.legs[k - 1], plan.legs[k]
        if not (a.length_m and b.length_m) or a.crab_deg != b.crab_deg:
            continue
        half = 0.5 * min(plan.blend_m, a.length_m, b.length_m) / plan.speed_m_s
        if half > 0:
            share = np.clip((at - bounds[k]) / half, -1.0, 1.0)
            added += 0.5 * (moves[k][2] - moves[k - 1][2]) * (share - np.sign(share))
    return added


PAPER = QuasiStatic(peak_c1=0.5, peak_c2=0.0, rebound=0.0, entry=1.0, side_share=0.0, footprint_m=0.005)
"""The physics nearest to the paper's."""
