"""Speed of wheel forces and of identification: `python tests/benchmarks/bench_regolith.py`.

Forces of one wheel in closed form, compiled, beside the same formulas in plain Python and in NumPy over all states; the
exact integrals; a million Monte Carlo identifications; a joint posterior of 200 states.
"""

import math
import time
from collections.abc import Callable

import numpy as np

from lunarsci.regolith.forces import _each_state, closed_form_forces, contact_angles, stress_moments
from lunarsci.regolith.identify import identify
from lunarsci.regolith.inference.posterior import infer_soil
from lunarsci.regolith.integrals import integrated_forces
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates
from lunarsci.regolith.wheel import read_wheel

WHEEL, SOIL = read_wheel("yutu2"), read_soil("lunar-typical")
STATES = 200_000


def seconds(call: Callable[[], object], repeats: int = 5) -> float:
    """The fastest of some runs, the first left out."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def in_numpy(z: np.ndarray, s: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """The closed form over arrays, `signed`."""
    r, b, h, r_s, c1, c2, c3 = WHEEL.vector()
    k_s, n0, n1, c, tan_phi, k_x, tan_y, k_y = SOIL.vector()
    travel = np.where(s >= 0, 1 - s, 1 / (1 + s))
    t1, t1e = np.arccos((r - z) / r), np.arccos((r - z) / (r + h))
    t2, tm = c3 * t1, (c1 + c2 * s) * t1
    front, rear = t1 - tm, tm - t2
    a = (np.cos(tm) - np.cos(t2)) / rear + (np.cos(tm) - np.cos(t1)) / front
    m = (np.sin(tm) - np.sin(t2)) / rear + (np.sin(tm) - np.sin(t1)) / front
    sigma = k_s * (r * (np.cos(tm) - np.cos(t1))) ** (n0 + n1 * s)
    j = r_s * ((t1e - tm) - travel * (np.sin(t1e) - np.sin(tm)))
    j_y = r * travel * np.tan(beta) * (t1e - tm)
    tau_x = (c + sigma * tan_phi) * np.sign(j) * -np.expm1(-np.abs(j) / k_x)
    tau_y = (c + sigma * tan_y) * np.sign(j_y) * -np.expm1(-np.abs(j_y) / k_y)
    half = (t1 - t2) / 2
    return np.stack(
        [b * (r * sigma * a + r_s * tau_x * m), b * (r_s * tau_x * a - r * sigma * m), r_s * b * tau_y * half]
    )


def in_python(z: float, s: float) -> float:
    """F_N of one state, `signed`, interpreted."""
    plain_angles, plain_moments = contact_angles.py_func, stress_moments.py_func
    t1, t1e, t2, tm = plain_angles(z, s, WHEEL.vector())
    a, m, _ = plain_moments(t1, t2, tm)
    r, b, _, r_s, *_ = WHEEL.vector()
    k_s, n0, n1, c, tan_phi, k_x, _, _ = SOIL.vector()
    sigma = k_s * (r * (math.cos(tm) - math.cos(t1))) ** (n0 + n1 * s)
    travel = 1 - s if s >= 0 else 1 / (1 + s)
    j = r_s * ((t1e - tm) - travel * (math.sin(t1e) - math.sin(tm)))
    tau = (c + sigma * tan_phi) * math.copysign(-math.expm1(-abs(j) / k_x), j)
    return b * (r * sigma * a + r_s * tau * m)


def states(count: int) -> WheelStates:
    """Synthetic states of `lunar-typical` with the errors of the paper."""
    rng = np.random.default_rng(0)
    z, s, beta = rng.uniform(0.006, 0.018, count), rng.uniform(-0.2, 0.4, count), rng.uniform(1, 8, count)
    found = closed_form_forces(WHEEL, SOIL, z, s, beta)
    values = np.column_stack([z, s, beta, found.normal_force_n, found.drawbar_pull_n, found.lateral_force_n])
    errors = MeasurementErrors()
    sigmas = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
    noisy = values + sigmas * rng.standard_normal(values.shape)
    return WheelStates(tuple(map(str, range(count))), noisy, sigmas)


def main() -> None:
    """Print times and ratios."""
    rng = np.random.default_rng(0)
    z, s, beta = rng.uniform(0.005, 0.02, STATES), rng.uniform(-0.5, 0.5, STATES), rng.uniform(-0.2, 0.2, STATES)
    compiled = seconds(lambda: closed_form_forces(WHEEL, SOIL, z, s, np.degrees(beta))) / STATES
    travel = np.where(s >= 0, 1 - s, 1 / (1 + s))
    loop = seconds(lambda: _each_state(z, travel, travel * np.tan(beta), WHEEL.vector(), SOIL.vector(), 0)) / STATES
    arrays = seconds(lambda: in_numpy(z, s, beta)) / STATES
    python = seconds(lambda: [in_python(a, b) for a, b in zip(z[:2000], s[:2000], strict=True)]) / 2000
    exact = seconds(lambda: integrated_forces(WHEEL, SOIL, z[:20000], s[:20000], np.degrees(beta[:20000]))) / 20000
    print(f"closed form, compiled: {1e9 * loop:.0f} ns a wheel, with checks {1e9 * compiled:.0f} ns; NumPy "
          f"{arrays / loop:.1f} times, Python (F_N only) {python / loop:.0f} times; exact integrals {exact / loop:.0f} "
          "times")  # fmt: skip
    one, many = states(1), states(200)
    print(f"a million draws of one state: {seconds(lambda: identify(one, WHEEL, draws=1_000_000), 2):.2f} s")
    print(f"joint posterior of 200 states: {seconds(lambda: infer_soil(many, WHEEL), 2):.2f} s, sampled "
          f"{seconds(lambda: infer_soil(many, WHEEL, sample=True), 1):.2f} s")  # fmt: skip


if __name__ == "__main__":
    main()
