"""How often the intervals of `twin states` hold the truth: `python tests/benchmarks/bench_states.py [--drives N]`.

Hidden soils, drawn from the default priors, on smooth, rough and waved ground: the rover drives two arcs, by the twin
or by MuJoCo with other physics (`other_physics.py`), and sends telemetry of several rates and densities of positions.
The truth is what the wheels do at the moment of a row, not a mean about it. The states are found with another soil than
the hidden one.

A share is the mean over drives of the share of a drive's states; its error counts drives, as the states of one drive
share their errors. `--cache DIR` keeps the drives, so that another code is measured on the same ones.
"""

import argparse
import dataclasses
import io
import pickle
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
from other_physics import PHYSICS, true_drive, widths, world_of

from lunarsci.io.inputs import InputFile
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.synthetic import roughness, synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, STATE_COLUMNS, Prediction, predict
from lunarsci.twin.telemetry.nuisances import RIM_SIGMA
from lunarsci.twin.telemetry.reading import Findings, read_telemetry
from lunarsci.twin.telemetry.simulated import SensorErrors, SyntheticDrive, simulate_telemetry
from lunarsci.twin.telemetry.sinkage import read_track, with_sinkage
from lunarsci.twin.telemetry.states import DriveStates, states_of

PLAN = Plan(name="arcs", legs=(Leg(3.5, 0.15), Leg(3.5, -0.13)), speed_m_s=0.05)
GROUNDS = ("smooth", "rough", "rougher", "1.2 m", "2 m", "3 m", "6 m", "mixed")
STEEPEST = (0.04, 0.14)
"""Range of the steepest slope of a wave."""
SENT = {
    "usual": (1, SensorErrors()),
    "dense": (1, SensorErrors(fix_distance_m=0.2, fix_sigma_m=0.004)),
    "sparse": (2, SensorErrors(fix_distance_m=1.0)),
    "slow": (5, SensorErrors(fix_distance_m=0.5, fix_sigma_m=0.004)),
}
"""Rows of 0.05 m that make one of the telemetry, and its errors."""
NAMES = ("slip_ratio", "side_slip_deg", "sinkage_m")
LEVELS = ((0.6827, 1.0), (0.95, 1.959964))
MOST_DRAWS = 20
STEP_S = 0.05


def waves(x: np.ndarray, y: np.ndarray, length_m: float, random: np.random.Generator) -> np.ndarray:
    """A wave in some direction, as steep as drawn. [m]"""
    direction, phase = random.uniform(-0.9, 0.9), random.uniform(0.0, 2.0 * np.pi)
    k = 2.0 * np.pi / length_m
    height = random.uniform(*STEEPEST) / k
    return np.asarray(height * np.cos(k * (np.cos(direction) * x + np.sin(direction) * y) + phase))


def ground_of(name: str, seed: int) -> Terrain:
    """A ground of one of `GROUNDS`."""
    if name in ("smooth", "rough", "rougher"):
        return synthetic_longji(seed=seed, rms_m={"smooth": 0.0, "rough": 0.004, "rougher": 0.01}[name])
    random = np.random.default_rng([seed, 7])
    x, y = np.arange(-3.0, 11.0, 0.05)[None, :], np.arange(-5.0, 7.0, 0.05)[:, None]
    height = random.uniform(-0.05, 0.05) * x + random.uniform(-0.05, 0.05) * y + roughness(x, y, 0.001, seed)
    if name == "mixed":
        height = height + 0.5 * sum(waves(x, y, length, random) for length in (1.2, 2.0, 3.0, 6.0))
    else:
        height = height + waves(x, y, float(name.split()[0]), random)
    return build_terrain(name, -3.0, -5.0, 0.05, height, read_soil("longji"), synthetic=True)


def truth_of(physics: str, ground: str, seed: int) -> Prediction:
    """A drive on a hidden soil, as of `predict`; soils on which it does not arrive are replaced."""
    rover, terrain = build_rover("yutu2"), ground_of(ground, seed)
    for draw in range(MOST_DRAWS):
        random = np.random.default_rng([seed, draw])
        theta = first_belief().mean + widths() * random.normal(size=len(PARAMETERS))
        world = world_of(rover, terrain, PHYSICS[physics], theta, seed=seed)
        if PHYSICS[physics].mujoco:
            shape = predict(rover, terrain, PLAN, sweep=(), time_step_s=STEP_S, sample_m=0.05)
            driven = true_drive(world, PLAN, sample_s=1.0)
            if not driven.finished or len(driven.time_s) != len(shape.time_s):
                continue
            out = dataclasses.replace(
                shape, time_s=driven.time_s, paths=driven.poses[None], states=driven.states[None], terrain=terrain
            )
        else:
            out = predict(rover, world.terrain, PLAN, sweep=(), time_step_s=STEP_S, sample_m=0.05)
            out = _without_lag(dataclasses.replace(out, terrain=terrain))
        if out.finished[0] and np.median(out.states[0, :, :, STATE_COLUMNS.index("slip_ratio")]) < 0.5:
            return out
    raise SystemExit(f"{physics}, {ground}, {seed}: no soil of {MOST_DRAWS} carries the rover")


def _without_lag(out: Prediction) -> Prediction:
    """Velocities of the twin are those of a step ago, headings are of now: add what the rover turned since."""
    states = out.states.copy()
    yaw = out.paths[..., PATH_COLUMNS.index("yaw_deg")]
    turned = np.gradient(yaw, out.time_s, axis=1) * out.time_step_s
    states[..., STATE_COLUMNS.index("side_slip_deg")] += turned[..., None]
    return dataclasses.replace(out, states=states)


def coarser(out: Prediction, every: int) -> Prediction:
    """Every so manieth sample."""
    rows = slice(None, None, every)
    return dataclasses.replace(
        out,
        time_s=out.time_s[rows],
        distance_m=out.distance_m[rows],
        planned=out.planned[rows],
        paths=out.paths[:, rows],
        states=out.states[:, rows],
        halted=out.halted[rows],
        recorded=np.array([len(out.time_s[rows])]),
    )


def of_other_radius(drive: SyntheticDrive, seed: int) -> SyntheticDrive:
    """The same drive where the rover file has a radius that is off as much as radii are thought to be."""
    table = drive.telemetry.copy()
    factor = np.exp(RIM_SIGMA * np.random.default_rng([seed, 8]).normal())
    for wheel in drive.prediction.rover.wheels:
        for column in (f"angle_{wheel}_deg", f"rate_{wheel}_deg_s", f"speed_{wheel}_m_s"):
            table[column] *= factor
    return dataclasses.replace(drive, telemetry=table)


def found_in(drive: SyntheticDrive, terrain: Terrain) -> DriveStates:
    """States of a made-up drive, as `twin states --track` finds them."""

    def file(table: Any, name: str) -> InputFile:
        buffer = io.StringIO()
        table.to_csv(buffer, index=False)
        return InputFile(name, buffer.getvalue().encode())

    findings = Findings("made-up.csv")
    telemetry = read_telemetry(file(drive.telemetry, "made-up.csv"), drive.prediction.rover, findings)
    states = states_of(telemetry, drive.prediction.rover, terrain, findings, drive.prediction.plan)
    return with_sinkage(states, read_track(file(drive.track, "track.csv")), terrain)


def scores(states: DriveStates, out: Prediction) -> dict[str, Any]:
    """Of each quantity: error in standard errors, and error."""
    times, result = states.nodes.time_s[states.rows.node], {}
    for name in NAMES:
        true = np.column_stack(
            [
                np.interp(times, out.time_s, out.states[0, :, w, STATE_COLUMNS.index(name)])
                for w in range(out.states.shape[2])
            ]
        )
        value, sigma = getattr(states.rows, name), getattr(states.rows, f"{name}_sigma")
        known = states.rows.valid & np.isfinite(value)
        result[name] = ((value - true)[known], sigma[known])
    return result


def case(task: tuple[str, str, int, tuple[str, ...], str]) -> list[dict[str, Any]]:
    """All telemetry of one drive."""
    physics, ground, seed, settings, cache = task
    warnings.simplefilter("ignore")
    kept = Path(cache) / f"{physics}_{ground.replace(' ', '')}_{seed}.pickle" if cache else None
    if kept is not None and kept.exists():
        out = pickle.loads(kept.read_bytes())
    else:
        out = truth_of(physics, ground, seed)
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_bytes(pickle.dumps(out))
    rows = []
    for number, setting in enumerate(settings):
        every, errors = SENT[setting]
        drive = simulate_telemetry(coarser(out, every), errors, 10 * seed + number)
        states = found_in(drive, out.terrain)
        rows.append(
            {
                "physics": physics,
                "ground": ground,
                "sent": setting,
                "seed": seed,
                "scores": scores(states, out),
                "amplitude": states.smoothed.change.usual,
                "length_m": states.smoothed.change.usual_length_m,
            }
        )
    return rows


def shares(rows: list[dict[str, Any]], name: str) -> str:
    """Coverage of both levels with its error over drives, rms error and median sigma."""
    per_drive: dict[Any, list[list[float]]] = {}
    errors, sigmas = [], []
    for row in rows:
        error, sigma = row["scores"][name]
        if len(error) >= 5:
            key = (row["physics"], row["ground"], row["seed"])
            per_drive.setdefault(key, []).append([float((np.abs(error) < z * sigma).mean()) for _, z in LEVELS])
            errors.append((error**2).mean())
            sigmas.append(np.median(sigma))
    if not per_drive:
        return f"{'-':>37s}"
    each = np.array([np.mean(values, axis=0) for values in per_drive.values()])
    unsure = each.std(axis=0, ddof=1) / np.sqrt(len(each)) if len(each) > 1 else np.full(2, np.nan)
    factor = 1e3 if name != "side_slip_deg" else 1.0
    texts = [f"{100 * mean:3.0f}±{100 * error:2.0f}" for mean, error in zip(each.mean(axis=0), unsure, strict=True)]
    return f"{texts[0]} {texts[1]} ({factor * np.sqrt(np.mean(errors)):5.2f}, {factor * np.mean(sigmas):5.2f})"


def report(rows: list[dict[str, Any]]) -> None:
    """By physics and ground, by physics and telemetry, and all."""
    print("share of the truth in 68 % and 95 % intervals (rms error, mean sigma); slip and sinkage in 1e-3, 1e-3 m")
    print(f"{'':26s}{'slip':>30s} {'side slip [deg]':>30s} {'sinkage':>30s}  {'amplitude ahead, left, lengths [m]'}")

    def line(label: str, chosen: list[dict[str, Any]]) -> None:
        if chosen:
            a, length = (np.median([row[key] for row in chosen], axis=0) for key in ("amplitude", "length_m"))
            drives = len({(row["physics"], row["ground"], row["seed"]) for row in chosen})
            print(
                f"{label:22s}{drives:4d} ",
                *(f"{shares(chosen, name):>30s}" for name in NAMES),
                f"  {a[0]:.4f} {a[1]:.4f}  {length[0]:.2f} {length[1]:.2f}",
            )

    for physics in dict.fromkeys(row["physics"] for row in rows):
        own = [row for row in rows if row["physics"] == physics]
        for key, names in (("ground", GROUNDS), ("sent", tuple(SENT))):
            for name in names:
                line(f"{physics} {name}", [row for row in own if row[key] == name])
        line(f"{physics} all", own)
    line("all", rows)


def main() -> None:
    """Drive, find the states, print the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=8, help="on each ground")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--physics", nargs="+", default=["same"], choices=PHYSICS)
    parser.add_argument("--grounds", nargs="+", default=list(GROUNDS), choices=GROUNDS)
    parser.add_argument("--sent", nargs="+", default=list(SENT), choices=SENT)
    parser.add_argument("--cache", default="", help="folder that keeps the drives")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    tasks = [
        (physics, ground, seed, tuple(given.sent), given.cache)
        for physics in given.physics
        for ground in given.grounds
        for seed in range(given.first, given.first + given.drives)
    ]
    rows: list[dict[str, Any]] = []
    if given.jobs > 1:
        with ProcessPoolExecutor(given.jobs, initializer=numba.set_num_threads, initargs=(1,)) as pool:
            for part in pool.map(case, tasks):
                rows += part
    else:
        numba.set_num_threads(1)
        for task in tasks:
            rows += case(task)
    report(rows)


if __name__ == "__main__":
    main()
