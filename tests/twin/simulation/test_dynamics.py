"""The multibody equations against MuJoCo, against conservation laws, and against free fall."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Grid, build_terrain, lay_soil, read_ground
from lunarsci.twin.lanes import BODY, FELL, FINISHED, GROUP, SYSTEM, WHEEL, Work, new_work
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.contact import DRIVEN, MASS_ON_WHEEL, NORMAL_DAMPING, add_rows, meet_ground
from lunarsci.twin.simulation.dynamics import (
    FALLING,
    advance,
    assemble,
    begin_system,
    check_sense,
    eliminate,
    orient,
    place_wheel,
)

ROLLING = 0.05
ABYSS = build_terrain("far below", -50.0, -50.0, 10.0, np.full((11, 11), -100.0), read_soil("longji")).grid()
OWN_SOIL = np.full((GROUP, 8), np.nan)


@pytest.fixture(scope="module", params=["rear", "front", "none"])
def rover(request: pytest.FixtureRequest, lopsided_lengths: dict[str, dict[str, Any]]) -> Rover:
    """Without friction, and with lengths that break every symmetry that could hide a mistake."""
    return dataclasses.replace(
        build_rover("yutu2"),
        bogie=request.param,
        steered=("front", "rear"),
        joint_damping_n_m_s=0.0,
        body_center_m=(0.07, 0.03, 0.31),
        **lopsided_lengths[request.param],
    )


def ready(grid: Grid, rover: Rover) -> Work:
    """Scratch arrays with the terrain's soil under every wheel."""
    work = new_work(len(rover.wheels))
    for wheel in work.wheels:
        lay_soil(grid, OWN_SOIL, wheel)
        WHEEL.view(wheel, "rim")[:] = ROLLING
    return work


def put_state(work: Work, pose: np.ndarray, u: np.ndarray) -> None:
    """The same pose (10) and velocity (9) in every lane."""
    rows = work.body.reshape(-1, GROUP)
    rows[:10], rows[10:19] = pose[:, None], u[:, None]


def state_of(work: Work, lane: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Pose and velocity of a lane."""
    rows = work.body.reshape(-1, GROUP)
    return rows[:10, lane].copy(), rows[10:19, lane].copy()


def system_of(work: Work, lane: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (9, 9) and right side (9) of a lane, summed over both sides of the rover."""
    matrix, right = np.zeros((9, 9)), np.zeros(9)
    for side in range(2):
        own = [*range(7), 7 + side]
        matrix[np.ix_(own, own)] += SYSTEM.view(work.sides, "matrix")[side, :, lane].reshape(8, 8)
        right[own] += SYSTEM.view(work.sides, "right")[side, :, lane]
    return matrix, right


def random_state(seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    quaternion = random.normal(size=4)
    pose = np.concatenate([random.normal(size=3), quaternion / np.linalg.norm(quaternion), 0.4 * random.normal(size=3)])
    return pose, random.normal(size=9)


def equations(rover: Rover, pose: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix and force: with no ground in reach, a step of 1 s has M as its matrix and the force on its right."""
    work = ready(ABYSS, rover)
    put_state(work, pose, u)
    assemble(rover.vector(), rover.wheel.vector(), ABYSS, OWN_SOIL, 1.0, DRIVEN, work)
    return system_of(work)


def rotation(pose: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(pose[[4, 5, 6, 3]]).as_matrix()


def about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def on_bogie(rover: Rover) -> list[tuple[float, float, float]]:
    pairs = {"rear": ["middle", "rear"], "front": ["front", "middle"], "none": []}[rover.bogie]
    return [getattr(rover, f"{pair}_wheel_m") for pair in pairs]


def on_rocker(rover: Rover) -> list[tuple[float, float, float]]:
    pairs = {"rear": ["front"], "front": ["rear"], "none": ["front", "rear"]}[rover.bogie]
    return [getattr(rover, f"{pair}_wheel_m") for pair in pairs]


def mass_points(rover: Rover, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masses and world positions of chassis centre and wheels, from the rover's description alone."""
    points = [np.array(rover.body_center_m)]
    for k in (0, 1):
        mirror = np.array([1.0, -1.0 if k else 1.0, 1.0])
        rocker = about_y(-pose[7] if k else pose[7])
        pivot = mirror * (0.0, rover.rocker_pivot_y_m, 0.0)
        for arm in on_rocker(rover):
            points.append(pivot + rocker @ (mirror * arm))
        for arm in on_bogie(rover):
            bogie = pivot + rocker @ (mirror * rover.bogie_pivot_m)
            points.append(bogie + rocker @ about_y(pose[8 + k]) @ (mirror * arm))
    masses = np.array([rover.body_kg] + [rover.wheel_kg] * len(rover.wheels))
    return masses, pose[:3] + np.array(points) @ rotation(pose).T


def moved(pose: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
    """The pose after dt at constant velocity."""
    from scipy.spatial.transform import Rotation

    turned = (Rotation.from_rotvec(dt * u[3:6]) * Rotation.from_quat(pose[[4, 5, 6, 3]])).as_quat()
    return np.concatenate([pose[:3] + dt * u[:3], turned[[3, 0, 1, 2]], pose[7:] + dt * u[6:]])


def invariants(rover: Rover, pose: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Linear momentum, angular momentum about the world's origin, kinetic energy; velocities by differences."""
    h = 1e-5
    masses, points = mass_points(rover, pose)
    velocity = (mass_points(rover, moved(pose, u, h))[1] - mass_points(rover, moved(pose, u, -h))[1]) / (2 * h)
    r = rotation(pose)
    spin = r @ (np.array(rover.body_inertia_kg_m2) * (r.T @ u[3:6]))
    linear = masses @ velocity
    angular = (masses[:, None] * np.cross(points, velocity)).sum(axis=0) + spin
    energy = 0.5 * float(masses @ (velocity**2).sum(axis=1) + u[3:6] @ spin)
    return np.concatenate([linear, angular, [energy]])


def test_free_flight_conserves_momentum_angular_momentum_and_energy(rover: Rover) -> None:
    weightless = dataclasses.replace(rover, gravity_m_s2=1e-300)
    pose, u = random_state(3)
    if rover.bogie == "none":
        u[7:] = 0.0
    before = invariants(weightless, pose, u)
    dt = 2e-3

    def rate(p: np.ndarray, v: np.ndarray) -> np.ndarray:
        mass, force = equations(weightless, p, v)
        return np.linalg.solve(mass, force)

    for _ in range(200):
        # The implicit midpoint rule by two corrections, turning with the exact exponential map.
        k1 = rate(pose, u)
        middle = u + 0.5 * dt * k1
        k2 = rate(moved(pose, middle, 0.5 * dt), middle)
        middle = u + 0.5 * dt * k2
        pose, u = moved(pose, middle, dt), u + dt * rate(moved(pose, middle, 0.5 * dt), middle)
    after = invariants(weightless, pose, u)
    assert np.abs(after - before).max() < 3e-4 * np.abs(before).max()
    assert np.abs(u).max() > 0.1


def test_the_energy_that_is_watched_is_that_of_the_masses(rover: Rover) -> None:
    """Of their motion, and of their height; no wheel has pressed any ground."""
    pose, u = random_state(5)
    if rover.bogie == "none":
        u[7:] = 0.0
    work = ready(ABYSS, rover)
    put_state(work, pose, u)
    assemble(rover.vector(), rover.wheel.vector(), ABYSS, OWN_SOIL, 1.0, DRIVEN, work)
    check_sense(work, rover.vector(), rover.wheel.vector(), 1.0, True)
    masses, points = mass_points(rover, pose)
    whole = invariants(rover, pose, u)[-1] + rover.gravity_m_s2 * masses @ points[:, 2]
    assert BODY.view(work.body, "energy") == pytest.approx(whole, rel=1e-6)


def test_accelerations_follow_from_conservation_laws_at_every_state(rover: Rover) -> None:
    """d/dt of momentum is the weight, of energy the power of the weight: no integrator involved."""
    for seed in range(8):
        pose, u = random_state(seed)
        mass, force = equations(rover, pose, u)
        acceleration = np.linalg.solve(mass, force)
        h = 1e-4
        ahead = invariants(rover, moved(pose, u + 0.5 * h * acceleration, h), u + h * acceleration)
        behind = invariants(rover, moved(pose, u - 0.5 * h * acceleration, -h), u - h * acceleration)
        change = (ahead - behind) / (2 * h)
        masses, points = mass_points(rover, pose)
        weight = np.outer(masses, [0.0, 0.0, -rover.gravity_m_s2])
        expected = np.concatenate([weight.sum(axis=0), np.cross(points, weight).sum(axis=0)])
        assert np.allclose(change[:6], expected, atol=2e-4 * rover.mass_kg)
        assert change[6] == pytest.approx(
            float(invariants(rover, pose, u)[:3] @ [0, 0, -rover.gravity_m_s2]), abs=2e-4 * rover.mass_kg
        )


def test_mass_matrix_and_forces_agree_with_mujoco(rover: Rover) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(rover))
    data = mujoco.MjData(model)
    for seed in range(5):
        pose, u = random_state(seed)
        bogies = rover.bogie != "none"
        joints = [pose[7], pose[8], -pose[7], pose[9]] if bogies else [pose[7], -pose[7]]
        data.qpos[:] = np.concatenate([pose[:7], joints])
        into = np.zeros((len(data.qvel), 9))
        into[:3, :3] = np.eye(3)
        into[3:6, 3:6] = rotation(pose).T
        left, right = (6, 8) if bogies else (6, 7)
        into[left, 6], into[right, 6] = 1.0, -1.0
        if bogies:
            into[7, 7], into[9, 8] = 1.0, 1.0
        data.qvel[:] = into @ u
        mujoco.mj_forward(model, data)
        full = np.column_stack([mujoco_mass_times(mujoco, model, data, column) for column in np.eye(len(data.qvel))])
        mass, force = equations(rover, pose, u)
        if not bogies:  # their rows stand idle
            assert np.allclose(mass[7:], np.eye(9)[7:])
            mass[7, 7] = mass[8, 8] = 0.0
        assert np.allclose(into.T @ full @ into, mass, atol=1e-6)
        assert np.allclose(-into.T @ data.qfrc_bias, force, atol=1e-6)


def mujoco_mass_times(mujoco, model, data, column: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    result = np.zeros(len(column))
    mujoco.mj_mulM(model, data, result, column)
    return result


def mjcf(rover: Rover) -> str:
    def text(vector: object) -> str:
        return " ".join(repr(float(v)) for v in np.ravel(vector))

    def point(position: object) -> str:
        tiny = f'<inertial pos="0 0 0" mass="{rover.wheel_kg}" diaginertia="1e-9 1e-9 1e-9"/>'
        return f'<body pos="{text(position)}">{tiny}</body>'

    def side(sign: float) -> str:
        mirror = np.array([1.0, sign, 1.0])
        hinge = '<joint type="hinge" axis="0 1 0"/><inertial pos="0 0 0" mass="1e-9" diaginertia="1e-9 1e-9 1e-9"/>'
        wheels = "".join(point(mirror * arm) for arm in on_bogie(rover))
        bogie = f'<body pos="{text(mirror * rover.bogie_pivot_m)}">{hinge}{wheels}</body>' if wheels else ""
        pivot = text([0.0, sign * rover.rocker_pivot_y_m, 0.0])
        return f'<body pos="{pivot}">{hinge}{"".join(point(mirror * arm) for arm in on_rocker(rover))}{bogie}</body>'

    return f"""<mujoco><option gravity="0 0 {-rover.gravity_m_s2}"/><worldbody><body><freejoint/>
      <inertial pos="{text(rover.body_center_m)}" mass="{rover.body_kg}"
        diaginertia="{text(rover.body_inertia_kg_m2)}"/>
      {side(1.0)}{side(-1.0)}</body></worldbody></mujoco>"""


def test_free_fall_is_exact(rover: Rover) -> None:
    vector, tyre, work = rover.vector(), rover.wheel.vector(), ready(ABYSS, rover)
    pose, u = np.zeros(10), np.zeros(9)
    pose[3], u[:3] = 1.0, (0.1, -0.2, 0.3)
    put_state(work, pose, u)
    dt = 0.01
    for k in range(1, 61):
        assemble(vector, tyre, ABYSS, OWN_SOIL, dt, DRIVEN, work)
        advance(work, dt, rover.gravity_m_s2 * dt, FALLING)
        t = k * dt
        assert (work.code == (FELL if rover.gravity_m_s2 * t - 0.3 >= 1.0 else FINISHED)).all()
        expected = np.array([0.1, -0.2, 0.3]) * t - np.array([0, 0, 0.5 * rover.gravity_m_s2 * t * t])
        for lane in range(GROUP):
            pose, _ = state_of(work, lane)
            assert np.abs(pose[:3] - expected).max() < 1e-12
            assert np.abs(pose[4:]).max() < 1e-12


@compiled
def changes(work: Any) -> None:
    eliminate(work, 0)


def test_the_changes_solve_the_system(rover: Rover) -> None:
    """On the ground, with all its stiffness and damping, against numpy."""
    ground = build_terrain("ground", -50.0, -50.0, 10.0, np.zeros((11, 11)), read_soil("longji")).grid()
    work = ready(ground, rover)
    for seed in range(5):
        pose, u = random_state(seed)
        pose[2:7] = 0.24, 1.0, 0.02, -0.03, 0.04
        pose[3:7] /= np.linalg.norm(pose[3:7])
        pose[7:] *= 0.05
        put_state(work, pose, 0.02 * u)
        assemble(rover.vector(), rover.wheel.vector(), ground, OWN_SOIL, 0.1, DRIVEN, work)
        matrix, right = system_of(work)
        changes(work)
        assert BODY.view(work.body, "change")[:, 3] == pytest.approx(
            np.linalg.solve(matrix, right), rel=1e-9, abs=1e-12
        )


@np.errstate(divide="ignore", invalid="ignore")
def test_what_is_compiled_is_what_the_formulas_say(rover: Rover) -> None:
    """A step on a slope by compiled code, and by the same formulas as plain Python on arrays."""
    slope = build_terrain(
        "slope", -50.0, -50.0, 10.0, np.add.outer(np.zeros(11), np.linspace(0, 15, 11)), read_soil("longji")
    ).grid()
    vector, tyre, work, dt = rover.vector(), rover.wheel.vector(), ready(slope, rover), 0.1
    rows = work.body.reshape(-1, GROUP)
    rows[:19] = np.random.default_rng(1).normal(0.0, 0.02, (19, GROUP))
    rows[2], rows[3] = 7.5 + np.linspace(0.2, 0.26, GROUP), 1.0
    plain = Work(*(part.copy() for part in work))
    assemble(vector, tyre, slope, OWN_SOIL, dt, DRIVEN, work)
    calm = (rover.body_kg / len(vector.arms) + rover.wheel_kg) / MASS_ON_WHEEL * NORMAL_DAMPING
    for lane in range(0, GROUP, LANES):
        orient(plain.body, lane)
        begin_system(plain, vector, dt, lane)
    for w in range(len(vector.arms)):
        side = 1.0 - 2.0 * (w % 2)
        for lane in range(0, GROUP, LANES):
            place_wheel(plain, vector, w, side, lane)
        read_ground(slope, OWN_SOIL, plain.wheels[w], plain.code)
        for lane in range(0, GROUP, LANES):
            meet_ground(plain, w, tyre, vector, side, dt, DRIVEN, calm, lane)
            add_rows(plain, w, 1, vector, side, dt, lane)
    assert (WHEEL.view(work.wheels, "normal") > 1.0).any() and (WHEEL.view(work.wheels, "normal") == 0.0).any()
    for part in ("body", "wheels", "sides"):
        found, expected = getattr(work, part), getattr(plain, part)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-11 * np.abs(expected).max())
