"""The loop in numbers: `python tests/benchmarks/loop.py [--soils N] [--physics NAME] [--out FILE.jsonl]`.

Hidden soils, drawn from the default priors, on three synthetic terrains: the rover drives out, its wheels are measured
with the errors that Ding et al. (2024) state (sinkage 0.33 mm, slip and side slip 4 %, forces 10 %/3, positions 4 % of
the way), the belief of the soil is rectified, and the return is predicted from it, from the belief before, and from
the soil as it truly is: what is then left is the twin's own physics. Where the twin is told that the truth is its own
physics (`--model-error 0`), predictions hold no discrepancy.

Positions are read in two ways: 4 % as three standard deviations (`third`), and as one (`whole`). With `telemetry` the
wheels are not measured so: the drive is sent as telemetry, with positions of 2 to 5 cm every 0.5 to 1 m and a track,
and its states are found as `twin states` does. The return begins where the rover truly stands.

Each return is also judged as plans with one limit each, of slip, side slip, sinkage and the miss of the target: drawn
as a quantile of what the belief before the drive says of the worst value of a return, so that about half of the true
returns keep them. The table of verdicts says how many do of those with GO and with NO-GO, and how the stated risk is
calibrated, beside the verdicts of the belief before the drive.

The truth is driven by the physics named (`other_physics.py` says what each has in it; `quasi-static` is a simulator
written from the paper alone), the beliefs always by the twin.
The same number is the same hidden soil in all of them, with the same errors of measurement. A soil on which the truth
does not finish both ways is replaced by another draw, and counted.

Each soil is one line of the file, and one that is there is not driven again, so that a run can be cut, go on, and be
done in slices (`--first K --count N`). `--report FILES` prints the tables.
"""

import argparse
import dataclasses
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench_states import found_in
from leaning import as_prediction, record_of
from loop_report import region, report
from mujoco_rover import Driven
from result_lines import computed, rows_of
from true_drives import DRIVEN_BY, Case, chain, terrains

from lunarsci.regolith.belief import first_belief, ground_moments
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.assimilation.residuals import OBSERVED, DriveRecord
from lunarsci.twin.assimilation.update import assimilate
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.judgement.keeping import extremes
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.plan import QUANTITIES, Limit, Plan, read_plan, rover_limits
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.discrepancy import way_matrix, with_discrepancy
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.telemetry.simulated import SensorErrors, simulate_telemetry

ERRORS = MeasurementErrors(sinkage_m=0.00033, force_relative=0.10 / 3, travel_relative=0.04, side_slip_relative=0.04)
POSITION_SHARES = {"third": 0.04 / 3, "whole": 0.04}
"""Standard deviation of the position at the end, as a share of the way."""
TELEMETRY = "telemetry"
MEMBERS, SAMPLE_M = 128, 0.05
LIMITED = ("slip_ratio", "side_slip_deg", "sinkage_m", "endpoint_miss_m")
"""Quantities of the limits that are drawn."""


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


def telemetered(rover: Rover, terrain: Terrain, plan: Plan, out: Driven, seed: int) -> DriveRecord:
    """What is found in the telemetry of a true drive, whose positions are as good and as frequent as drawn."""
    random = np.random.default_rng([seed, 6])
    errors = SensorErrors(fix_sigma_m=random.uniform(0.02, 0.05), fix_distance_m=random.uniform(0.5, 1.0))
    drive = simulate_telemetry(as_prediction(out, rover, terrain, plan), errors, seed)
    return record_of(found_in(drive, terrain), rover, fixes=True)


def drawn_limits(rover: Rover, returns: Prediction, number: int) -> list[tuple[str, float, Plan]]:
    """A plan for each quantity that is limited, its limit a quantile of the worst values of some returns.

    All else may be as it can be.
    """
    random, plans = np.random.default_rng([number, 12]), []
    widest = {"slip_ratio": 1.0, "side_slip_deg": 90.0, "tilt_deg": 90.0, "sinkage_m": rover.wheel.radius_m}
    loose = {limit.quantity: widest.get(limit.quantity, 0.0) for limit in rover_limits(rover)}
    for name in LIMITED:
        worst = extremes(returns, name)
        drawn = float(np.quantile(worst[np.isfinite(worst)], random.uniform()))
        wanted = loose | {name: min(drawn, widest.get(name, np.inf))}
        limits = tuple(Limit(key, QUANTITIES[key], value, "drawn", False) for key, value in wanted.items())
        plans.append((name, wanted[name], dataclasses.replace(returns.plan, limits=limits)))
    return plans


def verdict_of(prediction: Prediction, plan: Plan) -> dict[str, Any]:
    """What the twin says of a plan."""
    found = judge(prediction, plan)
    return {"verdict": found.verdict, "risk": found.chance.risk}


def middle(cloud: np.ndarray) -> np.ndarray:
    """The predicted end: the median of the ends in x and in y, which a few soils that hardly move do not drag along."""
    return np.median(cloud, axis=0)


def experiment(case: Case, kept: Path | None = None) -> dict[str, Any]:
    """One hidden soil: drive out, measure, rectify, predict the return."""
    rover, plan, first = build_rover("yutu2"), read_plan(), first_belief()
    terrain = terrains(case.training)[case.ground]
    driven = chain(case, rover, plan, kept)
    (out, true), back, theta = driven.drives[:2], driven.plans[1], driven.thetas[0]
    end = true.poses[-1, :2]
    guesses = zip(PARAMETERS, values_of(first.laws, np.stack([first.mean, theta])).T, strict=True)
    before, known = predict(rover, terrain, back, samples=dict(guesses)).endpoints_m
    untaught = predict(rover, terrain, back, samples=first.draws(MEMBERS), sample_m=SAMPLE_M)
    returned_truly = as_prediction(true, rover, terrain, back)
    limits = drawn_limits(rover, untaught, 1000 * case.seed + case.number)
    result: dict[str, Any] = {
        "physics": case.physics,
        "soil": case.number,
        "seed": case.seed,
        "terrain": case.ground,
        "replaced": list(driven.replaced),
        "model_error": case.model_error,
        "drive_s": driven.drive_s,
        "before_m": float(np.hypot(*(before - end))),
        "known_m": float(np.hypot(*(known - end))),
        "limits": [
            {"quantity": name, "limit": value, "kept": bool(extremes(returned_truly, name)[0] <= value)}
            | {"untaught": verdict_of(untaught, own)}
            for name, value, own in limits
        ],
        "updates": {},
    }
    for reading in case.positions:
        seed = case.seed + 1000 * case.number
        share = POSITION_SHARES.get(reading, POSITION_SHARES["third"])
        if reading == TELEMETRY:
            record = telemetered(rover, terrain, plan, out, seed)
        else:
            record = measured(rover, plan, out, share, seed)
        returned = measured(rover, back, true, share, seed + 1)
        found = learned(rover, terrain, plan, record, back, end, theta, case.model_error, [own for *_, own in limits])
        place, covariance = returned.fix_m[0], returned.fix_covariance_m2[0]
        result["updates"][reading] = found | {"place_m": place.tolist(), "place_m2": covariance.tolist()}
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
    limited: list[Plan],
) -> dict[str, Any]:
    """What one update makes of a record, beside the true end of the return and the true soil."""
    first, begin = first_belief(), time.perf_counter()
    found = assimilate(rover, terrain, plan, record, first, model_error=model_error)
    took, belief = time.perf_counter() - begin, found.belief
    ruts = found.prediction.ruts
    before = plan if ruts else None
    predicted = predict(
        rover, terrain, back, samples=belief.draws(MEMBERS), ruts=ruts, before=before, sample_m=SAMPLE_M
    )
    if model_error:
        predicted = with_discrepancy(predicted, belief.discrepancy)
    done = predicted.finished
    driven = predicted.paths[done]
    soil = belief.soil
    sd = np.sqrt(np.diag(soil.covariance))
    own, own_sd = ground_moments(soil)
    return region(predicted.endpoints_m[done], end) | {
        "verdicts": [verdict_of(predicted, own) for own in limited],
        "soil_only": region(driven[:, -1, :2], end),
        "after_m": float(np.hypot(*(middle(driven[:, -1, :2]) - end))),
        "soil_ends_m": np.round(driven[:, -1, :2], 5).tolist(),
        "end_m": end.tolist(),
        "way_m2": way_matrix(predicted.planned[:, :2], driven[..., :3]).tolist(),
        "discrepancy": belief.discrepancy.to_dict(),
        "refused": found.refused,
        "reduced": found.reduced,
        "surprise": found.prior_shift,
        "persistence": found.autocorrelation,
        "z": ((soil.mean - theta) / sd).tolist(),
        "ground_z": ((own - theta) / own_sd).tolist(),
        "left": list(soil.sd_ratio.values()),
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


def last_of_each(files: list[Path]) -> list[dict[str, Any]]:
    """Lines of result files, the last of each soil."""
    return list({(row["physics"], row["seed"], row["soil"]): row for row in rows_of(*files)}.values())


def arguments() -> argparse.Namespace:
    """As given."""
    parser = argparse.ArgumentParser(description="The loop in numbers: how well a rectified soil predicts the return.")
    parser.add_argument("--soils", "--count", type=int, default=45, help="hidden soils of each physics")
    parser.add_argument("--first", type=int, default=0, help="number of the first soil")
    parser.add_argument("--physics", nargs="+", choices=DRIVEN_BY, default=["same"], help="what the truth is driven by")
    known = (*POSITION_SHARES, TELEMETRY)
    parser.add_argument("--positions", nargs="*", default=list(POSITION_SHARES), help=f"{known}, or none: no update")
    parser.add_argument("--seed", type=int, default=41)
    parser.add_argument(
        "--model-error", type=float, help="as `assimilate` takes it; by default 0 for `same` and `closed`, 1 for others"
    )
    parser.add_argument("--kept", type=Path, help="folder of true drives, read where they lie there, and added to")
    parser.add_argument(
        "--training", action="store_true", help="the grounds on which priors were set; take another seed with them"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, help="file of results, one line a soil, added to")
    parser.add_argument("--report", type=Path, nargs="+", help="print the tables of these files, and drive nothing")
    given = parser.parse_args()
    if strange := set(given.positions) - set(known):
        parser.error(f"--positions {min(strange)}: give some of {known}, or none of them")
    return given


def model_error(given: float | None, physics: str) -> float:
    """What the twin is told of its own errors: none where the truth is its own."""
    if given is not None:
        return given
    return 0.0 if physics in ("same", "closed") else 1.0


def main() -> None:
    """Drive, and report."""
    given = arguments()
    if given.report:
        print(report(last_of_each(given.report)))
        return
    cases = {
        (name, given.seed, number): Case(
            physics=name,
            number=number,
            seed=given.seed,
            positions=tuple(given.positions),
            model_error=model_error(given.model_error, name),
            training=given.training,
        )
        for number in range(given.first, given.first + given.soils)
        for name in given.physics
    }
    driven = partial(experiment, kept=given.kept)
    print(report(computed(driven, cases, ("physics", "seed", "soil"), given.out, given.jobs, said)))


if __name__ == "__main__":
    main()
