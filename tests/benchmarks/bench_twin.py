"""Speed and time-step error of the rover: `python tests/benchmarks/bench_twin.py`.

The embedded plan (9.807 m at 0.05 m/s) for 1024 soils on the synthetic terrain: time by time step and number of
threads, and how far the ends are from those at a step of 1 ms; one drive; and MuJoCo driving the same rover with the
same wheel forces in the same process, its own step of 2 ms.
"""

import importlib.util
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lunarsci.compiled import compiled, set_threads, threads
from lunarsci.regolith.forces import wheel_forces_kernel
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict

ROVER, TERRAIN, PLAN = build_rover("yutu2"), synthetic_longji(), read_plan()
MEMBERS, CHECKED = 1024, 64
DURATION_S = PLAN.length_m / PLAN.speed_m_s


def seconds(call: Callable[[], object], repeats: int = 3) -> float:
    """The fastest of some runs."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def drive(members: int, dt: float) -> Prediction:
    """Latin hypercube of the plan's soils."""
    return predict(ROVER, TERRAIN, PLAN, members=members, seed=1, time_step_s=dt)


@compiled
def forces_of(wheels: np.ndarray, tyre: tuple, soil: tuple) -> float:
    total = 0.0
    for z, travel, lateral in wheels:
        f_n, f_dp, f_l, m_r = wheel_forces_kernel(z, travel, lateral, tyre, soil, 0)
        total += f_n + f_dp + f_l + m_r
    return total


def mujoco_step_s() -> float | None:
    """One step of MuJoCo with this rover's tree and six calls of the wheel forces, None where it is not installed."""
    if importlib.util.find_spec("mujoco") is None:
        return None
    import mujoco

    spec = importlib.util.spec_from_file_location(
        "test_dynamics", Path(__file__).parents[1] / "twin/simulation/test_dynamics.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    model = mujoco.MjModel.from_xml_string(module.mjcf(ROVER))
    data = mujoco.MjData(model)
    wheels, tyre = np.tile([0.008, 0.95, 0.03], (6, 1)), ROVER.wheel.vector()
    soil, steps = read_soil("longji").vector(), 5000

    def run() -> None:
        for _ in range(steps):
            forces_of(wheels, tyre, soil)
            mujoco.mj_step(model, data)

    run()
    return seconds(run) / steps


def main() -> None:
    """Print times and ratios."""
    ends = drive(CHECKED, 0.001).endpoints_m
    drive(16, 0.1)
    count = threads()
    for dt in (0.05, 0.1, 0.2):
        error = np.hypot(*(drive(CHECKED, dt).endpoints_m - ends).T)
        many = seconds(lambda dt=dt: drive(MEMBERS, dt))
        print(
            f"step {dt:g} s: {MEMBERS} drives in {many:.2f} s on {count} threads, ends off by "
            f"{1e3 * np.median(error):.2f} mm (median), {1e3 * error.max():.2f} mm at most, against 1 ms"
        )
    own = seconds(lambda: drive(MEMBERS, 0.1)) * count / MEMBERS
    print(f"one drive alone: {1e3 * seconds(lambda: predict(ROVER, TERRAIN, PLAN, sweep=(), time_step_s=0.2)):.0f} ms")
    set_threads(1)
    one = drive(40, 0.1).endpoints_m
    set_threads(0)
    same = np.array_equal(one, drive(40, 0.1).endpoints_m)
    print(f"ends of 40 members by 1 and {count} threads equal to the bit: {same}")
    step = mujoco_step_s()
    if step is not None:
        theirs = step * DURATION_S / 0.002
        print(
            f"MuJoCo: {1e6 * step:.1f} us a step of 2 ms, {theirs:.2f} s a drive on one core, "
            f"{theirs / own:.0f} times ours"
        )


if __name__ == "__main__":
    main()
