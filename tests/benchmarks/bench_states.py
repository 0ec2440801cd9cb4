"""Made-up drives on hidden soils with their telemetry, and how far the states found in it are off.

Soils are drawn from the default priors; the ground is smooth, rough or waved. The rover drives two arcs, by the twin or
by MuJoCo with other physics (`other_physics.py`). The truth is what the wheels do at the moment of a row, not a mean
about it. The states are found with another soil than the hidden one.
"""

import dataclasses
import io
from typing import Any

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
from lunarsci.twin.telemetry.hypotheses import RIM_SIGMA
from lunarsci.twin.telemetry.reading import Findings, read_telemetry
from lunarsci.twin.telemetry.simulated import SensorErrors, SyntheticDrive
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
