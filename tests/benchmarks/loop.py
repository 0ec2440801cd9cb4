"""The loop in numbers: `python tests/benchmarks/loop.py [--soils N] [--physics NAME] [--out FILE.jsonl]`.

Hidden soils, drawn from the default priors, on three synthetic terrains: the rover drives out, its wheels are measured
with the errors that Ding et al. (2024) state (sinkage 0.33 mm, slip and side slip 4 %, forces 10 %/3, positions 4 % of
the way), the belief of the soil is rectified, and the return is predicted from it, from the belief before, and from
the soil as it truly is: what is then left is the twin's own physics.

Positions are read in two ways: 4 % as three standard deviations (`third`), and as one (`whole`). The return begins
where the rover truly stands.

The truth is driven by the physics named (`other_physics.py` says what each has in it), the beliefs always by the twin.
The same number is the same hidden soil in all of them, with the same errors of measurement. A soil on which the truth
does not finish both ways is replaced by another draw, and counted.

Each soil is one line of the file, and one that is there is not driven again, so that a run can be cut, go on, and be
done in slices (`--first K --count N`). `--report FILES` prints the tables.
"""

import argparse
import dataclasses
import json
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from loop_report import report
from mujoco_rover import Driven
from other_physics import PHYSICS, World, true_drive, widths, world_of

from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.ensemble import STATE_COLUMNS, predict
from lunarsci.twin.ground.longji import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Leg, Plan, read_plan
from lunarsci.twin.rectify import rectify
from lunarsci.twin.rover import Rover, build_rover

ERRORS = MeasurementErrors(sinkage_m=0.00033, force_relative=0.10 / 3, travel_relative=0.04, side_slip_relative=0.04)
POSITION_SHARES = {"third": 0.04 / 3, "whole": 0.04}
"""Standard deviation of the position at the end, as a share of the way."""
MEMBERS = 128
REGION = 0.9
"""Share of the predicted ends that a region holds."""
MOST_DRAWS = 20


def way_back(plan: Plan, out: Driven) -> Plan:
    """The same arcs backwards, from where the rover stands."""
    x, y, _, _, _, yaw = out.poses[-1]
    legs = tuple(Leg(leg.length_m, -leg.curvature_per_m, 180.0) for leg in reversed(plan.legs))
    return dataclasses.replace(plan, legs=legs, x_m=float(x), y_m=float(y), heading_deg=float(yaw), sweep=())


def measured(rover: Rover, plan: Plan, out: Driven, share: float, seed: int) -> DriveRecord:
    """What a rover would have measured of a true drive, every third sample, and its position at the end.

    The same seed gives the same errors, in standard deviations.
    """
    rows, random = slice(0, None, 3), np.random.default_rng(seed)
    states = out.states[rows]
    truth = states[..., [STATE_COLUMNS.index(name) for name in OBSERVED]].reshape(-1, len(OBSERVED))
    sigma = np.column_stack([ERRORS.of(name, truth[:, k]) for k, name in enumerate(OBSERVED)])
    place = share * plan.length_m
    return DriveRecord(
        time_s=np.repeat(out.time_s[rows], len(rover.wheels)),
        wheel=rover.wheels * len(states),
        values=truth + sigma * random.normal(size=truth.shape),
        sigmas=sigma,
        fix_time_s=out.time_s[-1:],
        fix_m=out.poses[-1:, :2] + place * random.normal(size=(1, 2)),
        fix_covariance_m2=place**2 * np.eye(2)[None],
    )


def ends(rover: Rover, terrain: Terrain, plan: Plan, belief: SoilBelief) -> np.ndarray:
    """Ends of the drives that finish on soils of the belief."""
    drives = predict(rover, terrain, plan, samples=belief.draws(MEMBERS))
    return drives.endpoints_m[drives.finished]


def middle(cloud: np.ndarray) -> np.ndarray:
    """The predicted end: the median of the ends in x and in y, which a few soils that hardly move do not drag along."""
    return np.median(cloud, axis=0)


def distance_in(cloud: np.ndarray, point: np.ndarray) -> float:
    """Share of the ends of a cloud that are nearer to its mean than a point, in its standard deviations."""
    off = np.vstack([cloud, point]) - cloud.mean(axis=0)
    squares = np.einsum("ij,ij->i", off @ np.linalg.inv(np.cov(cloud.T)), off)
    return float((squares[:-1] < squares[-1]).mean())


@cache
def terrains() -> dict[str, Terrain]:
    """Three grounds under the embedded plan: the stand-in for Longji, rougher, and flatter with other bumps."""
    bumps = synthetic_longji(seed=3)
    flat = dataclasses.replace(bumps, height_m=0.4 * bumps.height_m)
    return {"longji": synthetic_longji(), "rough": synthetic_longji(seed=7, rms_m=0.01), "gentle": flat}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One hidden soil by one physics: drawn by `seed` and `number`, the same for every physics."""

    physics: str
    number: int
    seed: int
    positions: tuple[str, ...]
    model_error: float = 1.0

    def hidden(self, draw: int) -> np.ndarray:
        """Transforms of a soil drawn from the first laws."""
        random = np.random.default_rng([self.seed, self.number, draw])
        return first_belief().mean + widths() * random.normal(size=len(PARAMETERS))


def both_ways(case: Case, rover: Rover, terrain: Terrain, plan: Plan) -> tuple[World, list[Driven], list[str], float]:
    """A hidden soil, the true drives out and back on it, why soils before it were replaced, and seconds for a drive."""
    replaced: list[str] = []
    for draw in range(MOST_DRAWS):
        world = world_of(rover, terrain, PHYSICS[case.physics], case.hidden(draw), seed=case.seed + case.number)
        begin = time.perf_counter()
        out = true_drive(world, plan)
        if out.finished:
            back = true_drive(world, way_back(plan, out))
            if back.finished:
                return world, [out, back], replaced, 0.5 * (time.perf_counter() - begin)
            out = back
        replaced.append(out.outcome)
    raise SystemExit(f"soil {case.number}: {MOST_DRAWS} draws, and the truth drives on none of them: {replaced}")


def experiment(case: Case) -> dict[str, Any]:
    """One hidden soil: drive out, measure, rectify, predict the return."""
    warnings.simplefilter("ignore")
    rover, plan, first = build_rover("yutu2"), read_plan(), first_belief()
    name = list(terrains())[case.number % len(terrains())]
    terrain = terrains()[name]
    world, (out, true), replaced, drive_s = both_ways(case, rover, terrain, plan)
    back, end, theta = way_back(plan, out), true.poses[-1, :2], world.soil_along(out)
    guesses = zip(PARAMETERS, values_of(first.laws, np.stack([first.mean, theta])).T, strict=True)
    before, known = predict(rover, terrain, back, samples=dict(guesses)).endpoints_m
    result: dict[str, Any] = {
        "physics": case.physics,
        "soil": case.number,
        "seed": case.seed,
        "terrain": name,
        "replaced": replaced,
        "model_error": case.model_error,
        "drive_s": drive_s,
        "theta": theta.tolist(),
        "before_m": float(np.hypot(*(before - end))),
        "known_m": float(np.hypot(*(known - end))),
        "updates": {},
    }
    for reading in case.positions:
        record = measured(rover, plan, out, POSITION_SHARES[reading], case.seed + 1000 * case.number)
        result["updates"][reading] = learned(rover, terrain, plan, record, back, end, theta, case.model_error)
    return result


def learned(
    rover: Rover,
    terrain: Terrain,
    plan: Plan,
    record: DriveRecord,
    back: Plan,
    end: np.ndarray,
    theta: np.ndarray,
    model_error: float,
) -> dict[str, Any]:
    """What one update makes of a record, beside the true end of the return and the true soil."""
    first, begin = first_belief(), time.perf_counter()
    found = rectify(rover, terrain, plan, record, first, model_error=model_error)
    took, belief = time.perf_counter() - begin, found.belief
    cloud = ends(rover, terrain, back, belief)
    sd = np.sqrt(np.diag(belief.covariance))
    ranks = None if belief.population is None else (belief.population < theta).mean(axis=0).tolist()
    return {
        "after_m": float(np.hypot(*(middle(cloud) - end))),
        "within": distance_in(cloud, end),
        "held": distance_in(cloud, end) <= REGION,
        "radius_m": float(np.sqrt(np.trace(np.cov(cloud.T)))),
        "members": len(cloud),
        "refused": found.refused,
        "reduced": found.reduced,
        "inflation": dict(found.inflation),
        "wheel_errors": dict(found.wheel_errors),
        "surprise": found.surprise,
        "persistence": found.persistence,
        "z": ((belief.mean - theta) / sd).tolist(),
        "rank": ranks,
        "left": list(belief.left_of_prior.values()),
        "took_s": took,
    }


def said(row: dict[str, Any]) -> str:
    """One line about a soil."""
    parts = [
        f"{row['physics']} {row['soil']:3d} {row['terrain']:7s} before {row['before_m']:.3f} m, "
        f"soil known {row['known_m']:.3f} m",
        *(
            f"{reading}: {u['after_m']:.3f} m, held {u['held']}, reduced chi-square {u['reduced']:.2f}, "
            f"{u['took_s']:.1f} s{', refused' if u['refused'] else ''}"
            for reading, u in row["updates"].items()
        ),
        f"true drive {row['drive_s']:.1f} s, {len(row['replaced'])} soils replaced",
    ]
    return "; ".join(parts)


def rows_of(files: list[Path]) -> list[dict[str, Any]]:
    """Lines of result files, the last of each soil; a line that was cut off is left out."""
    rows: dict[Any, dict[str, Any]] = {}
    for line in (line for file in files if file.exists() for line in file.read_text("utf-8").splitlines()):
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        rows[row["physics"], row["seed"], row["soil"]] = row
    return list(rows.values())


def run(cases: list[Case], out: Path | None, jobs: int) -> list[dict[str, Any]]:
    """Do the cases that are not in the file yet, and add them to it; all of the file's rows are given back."""
    rows = rows_of([out] if out else [])
    done = {(row["physics"], row["seed"], row["soil"]) for row in rows}
    todo = [case for case in cases if (case.physics, case.seed, case.number) not in done]
    with ProcessPoolExecutor(jobs, initializer=numba.set_num_threads, initargs=(1,)) as pool:
        for row in pool.map(experiment, todo) if jobs > 1 else map(experiment, todo):
            print(said(row), flush=True)
            rows.append(row)
            if out:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
    return rows


def arguments() -> argparse.Namespace:
    """As given."""
    parser = argparse.ArgumentParser(description="The loop in numbers: how well a rectified soil predicts the return.")
    parser.add_argument("--soils", "--count", type=int, default=45, help="hidden soils of each physics")
    parser.add_argument("--first", type=int, default=0, help="number of the first soil")
    parser.add_argument("--physics", nargs="+", choices=PHYSICS, default=["same"], help="what the truth is driven by")
    parser.add_argument(
        "--positions", nargs="*", default=list(POSITION_SHARES), help="third, whole, or none: no update"
    )
    parser.add_argument("--seed", type=int, default=41)
    parser.add_argument(
        "--model-error", type=float, help="as `rectify` takes it; by default 0 for `same` and `closed`, 1 for others"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, help="file of results, one line a soil, added to")
    parser.add_argument("--report", type=Path, nargs="+", help="print the tables of these files, and drive nothing")
    given = parser.parse_args()
    if strange := set(given.positions) - set(POSITION_SHARES):
        parser.error(f"--positions {min(strange)}: give third, whole, both or none of them")
    return given


def model_error(given: float | None, physics: str) -> float:
    """What the twin is told of its own errors: none where the truth is its own."""
    if given is not None:
        return given
    return 1.0 if PHYSICS[physics].exact else 0.0


def main() -> None:
    """Drive, and report."""
    given = arguments()
    if given.report:
        print(report(rows_of(given.report)))
        return
    cases = [
        Case(
            physics=name,
            number=number,
            seed=given.seed,
            positions=tuple(given.positions),
            model_error=model_error(given.model_error, name),
        )
        for number in range(given.first, given.first + given.soils)
        for name in given.physics
    ]
    print(report(run(cases, given.out, given.jobs)))


if __name__ == "__main__":
    main()
