"""Positions whose errors hang together: `python tests/benchmarks/shared_positions.py [--drives N]`.

Made-up drives of 5 m with positions at five stations, whose errors grow along the way as those of stations that are
tied one to the next, by 6 mm ahead and 4 mm aside from each to the next. `twin states` reads them with the covariance
of each with the one before, and without it: squared errors of the smoothed places over their covariance, where 2 is
expected.
"""

import argparse
import json
import warnings

import numpy as np
import pandas as pd

from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import csv_bytes
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import predict
from lunarsci.twin.telemetry.checks import with_positions
from lunarsci.twin.telemetry.reading import Findings, Positions, joint_m2, read_telemetry
from lunarsci.twin.telemetry.simulated import SensorErrors, simulate_telemetry
from lunarsci.twin.telemetry.states import states_of

PLAN = Plan(name="way", legs=(Leg(3.0, 0.15), Leg(2.0, -0.13)), speed_m_s=0.05)
STEP_M2 = np.diag([0.006, 0.004]) ** 2
STATIONS = 5


def scores(seed: int) -> dict[bool, np.ndarray]:
    """Squared errors over the covariance at all stations but the first, with and without what positions share."""
    rover, random = build_rover("yutu2"), np.random.default_rng(seed)
    terrain = synthetic_longji(rms_m=(0.0, 0.002, 0.005)[seed % 3])
    soil = terrain.with_soil(friction_angle_deg=float(random.uniform(25, 50)))
    out = predict(rover, soil, PLAN, sweep=(), time_step_s=0.05, sample_m=0.05)
    table = simulate_telemetry(out, SensorErrors(), seed).telemetry
    rows = np.linspace(0, len(table) - 1, STATIONS).astype(int)
    own, shared = (np.array([STEP_M2 * (k + more) for k in range(STATIONS)]) for more in (1, 0))
    errors = np.linalg.cholesky(joint_m2(own, shared)) @ random.normal(size=2 * STATIONS)
    place, found = out.paths[0, rows, :2] + errors.reshape(-1, 2), {}
    for together in (True, False):
        findings = Findings("made-up.csv")
        sent = read_telemetry(InputFile("made-up.csv", csv_bytes(table)), rover, findings, placed=False)
        positions = Positions(table["time_s"].to_numpy()[rows], place, own, shared if together else None)
        sent = with_positions(sent, positions, "positions.csv", findings)
        smoothed = states_of(sent, rover, terrain, findings, PLAN)
        at = [int(np.abs(smoothed.nodes.time_s - time).argmin()) for time in positions.time_s[1:]]
        off = np.column_stack([smoothed.motion.x_m, smoothed.motion.y_m])[at] - out.paths[0, rows[1:], :2]
        found[together] = np.einsum("ni,nij,nj->n", off, np.linalg.inv(smoothed.smoothed.covariance[at, :2, :2]), off)
    return found


def main() -> None:
    """Run, and print the means at each station."""
    parser = argparse.ArgumentParser(description="Positions whose errors hang together.")
    parser.add_argument("--drives", type=int, default=60)
    warnings.simplefilter("ignore")
    rows = [scores(seed) for seed in range(parser.parse_args().drives)]
    table = {name: np.mean([row[key] for row in rows], axis=0) for name, key in (("shared", True), ("alone", False))}
    print(json.dumps(pd.DataFrame(table).round(2).to_dict("list")))


if __name__ == "__main__":
    main()
