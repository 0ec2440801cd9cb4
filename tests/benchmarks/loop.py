"""The loop in numbers: `python tests/benchmarks/loop.py [SOILS]`.

Hidden soils, drawn from the default priors, on three synthetic terrains: the rover drives out, its wheels are measured
with the errors that Ding et al. (2024) state (sinkage 0.33 mm, slip and side slip 4 %, forces 10 %/3, positions 4 %/3
of the way), the belief of the soil is rectified, and the return is predicted from it and from the belief before.
Printed: how far the predicted ends of the return are from the true one, and how often 90 % regions hold it.
"""

import dataclasses
import sys
import time
import warnings

import numpy as np

from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.ground.longji import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Leg, Plan, read_plan
from lunarsci.twin.rectify import rectify
from lunarsci.twin.rover import Rover, build_rover

ERRORS = MeasurementErrors(sinkage_m=0.00033, force_relative=0.10 / 3, travel_relative=0.04, side_slip_relative=0.04)
POSITION_SHARE = 0.04 / 3
MEMBERS = 64
CHI_SQUARE_90 = 4.605
"""Of two degrees of freedom."""


def way_back(out: Prediction) -> Plan:
    """The same arcs backwards, from where the rover stands."""
    x, y, _, _, _, yaw = out.paths[0, -1]
    legs = tuple(Leg(leg.length_m, -leg.curvature_per_m, 180.0) for leg in reversed(out.plan.legs))
    return dataclasses.replace(out.plan, legs=legs, x_m=float(x), y_m=float(y), heading_deg=float(yaw), sweep=())


def measured(out: Prediction, random: np.random.Generator) -> DriveRecord:
    """What a rover would have measured of a true drive, every third sample, and its position at the end."""
    rows = slice(0, None, 3)
    states = out.states[0, rows]
    truth = states[..., [STATE_COLUMNS.index(name) for name in OBSERVED]].reshape(-1, len(OBSERVED))
    sigma = np.column_stack([ERRORS.of(name, truth[:, k]) for k, name in enumerate(OBSERVED)])
    place = POSITION_SHARE * out.plan.length_m
    return DriveRecord(
        time_s=np.repeat(out.time_s[rows], len(out.rover.wheels)),
        wheel=out.rover.wheels * len(states),
        values=truth + sigma * random.normal(size=truth.shape),
        sigmas=sigma,
        fix_time_s=out.time_s[-1:],
        fix_m=out.endpoints_m + place * random.normal(size=(1, 2)),
        fix_covariance_m2=place**2 * np.eye(2)[None],
    )


def ends(rover: Rover, terrain: Terrain, plan: Plan, belief: SoilBelief) -> np.ndarray:
    """Ends of the drives that finish on soils of the belief."""
    drives = predict(rover, terrain, plan, samples=belief.draws(MEMBERS))
    return drives.endpoints_m[drives.finished]


def holds(cloud: np.ndarray, point: np.ndarray) -> bool:
    """Whether the 90 % ellipse of a cloud holds a point."""
    off = point - cloud.mean(axis=0)
    return bool(off @ np.linalg.solve(np.cov(cloud.T), off) < CHI_SQUARE_90)


def hidden_soil(random: np.random.Generator) -> np.ndarray:
    """Transforms of a soil drawn from the priors."""
    first = first_belief()
    return first.mean + np.sqrt(np.diag(first.covariance)) * random.normal(size=len(PARAMETERS))


def terrains() -> dict[str, Terrain]:
    """Three grounds under the embedded plan: the stand-in for Longji, rougher, and flatter with other bumps."""
    whole = synthetic_longji()
    rough = synthetic_longji(seed=7, rms_m=0.01)
    flat = dataclasses.replace(synthetic_longji(seed=3), height_m=0.4 * synthetic_longji(seed=3).height_m)
    return {"longji": whole, "rough": rough, "gentle": flat}


def main(soils: int = 45) -> None:
    """Print errors and coverage."""
    warnings.simplefilter("ignore")
    rover, plan, random = build_rover("yutu2"), read_plan(), np.random.default_rng(41)
    grounds, first = terrains(), first_belief()
    rows, standard = [], []
    while len(rows) < soils:
        name = list(grounds)[len(rows) % len(grounds)]
        terrain, theta = grounds[name], hidden_soil(random)
        soil = {key: np.array([value]) for key, value in zip(PARAMETERS, values_of(first.laws, theta), strict=True)}
        out = predict(rover, terrain, plan, samples=soil)
        if not out.finished[0]:
            continue
        back = way_back(out)
        true = predict(rover, terrain, back, samples=soil)
        if not true.finished[0]:
            continue
        start = time.perf_counter()
        found = rectify(rover, terrain, plan, measured(out, random), first)
        took = time.perf_counter() - start
        end = true.endpoints_m[0]
        mean = {key: np.array([v]) for key, v in zip(PARAMETERS, values_of(first.laws, first.mean), strict=True)}
        before = predict(rover, terrain, back, samples=mean).endpoints_m[0]
        after = ends(rover, terrain, back, found.belief)
        rows.append(
            [np.hypot(*(before - end)), np.hypot(*(after.mean(axis=0) - end)), holds(after, end), found.reduced]
        )
        standard.append((found.belief.mean - theta) / np.sqrt(np.diag(found.belief.covariance)))
        print(f"{name:8s} before {rows[-1][0]:.3f} m, after {rows[-1][1]:.3f} m, held {bool(rows[-1][2])}, reduced "
              f"chi-square {found.reduced:.2f}, {took:.1f} s {found.refused}")  # fmt: skip
    table = np.array(rows, dtype=float)
    print(f"median error of the return: {np.median(table[:, 1]):.3f} m after, {np.median(table[:, 0]):.3f} m before")
    print(f"90 % regions hold {table[:, 2].mean():.2f} of the ends")
    z = np.array(standard)
    for k, key in enumerate(PARAMETERS):
        print(
            f"{key}: 68 % intervals hold {(np.abs(z[:, k]) < 1).mean():.2f}, 95 % {(np.abs(z[:, k]) < 1.96).mean():.2f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
