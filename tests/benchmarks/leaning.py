"""How far a belief leans where it is right, and where it is not: `python tests/benchmarks/leaning.py --out FILE.jsonl`.

Hidden soils of `true_drives.py`, drawn from the default priors, on its three grounds. The rover drives out and sends
telemetry; wheel states are found as `twin states` does, and the belief learns as `twin update` does, which knows
nothing of what drove. Then the drive is predicted again, and the way back, from where the rover stands: how far the
measured slip is off, by whether the belief was right. `CASES` lists what is right and what is wrong:

| name | what drove | what the twin is told |
|---|---|---|
| right, uphill | the twin's own physics, on the grounds and on a slope of 6 degrees | all as it was |
| exact, multipass, all, quasi-static | other physics (`other_physics.py`, `quasi_static.py`) | all as it was |
| two soils, slipping | the twin, on the grounds and on the slope, the track that of another soil | all as it was |
| heavy | the twin, the body 40 % heavier | the rover of the file |
| tilted | the twin, the ground 3 degrees steeper ahead | the ground without |

Each drive is one line of the file, and one that is there is not driven again. `--report FILE` prints the tables.
`--halves` learns each half of the way on its own instead, as `twin update --save-map` learns stretches, of right drives
on one soil: how far right beliefs of stretches lean.
"""

import argparse
import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bench_states import found_in
from mujoco_rover import Driven
from result_lines import computed, rows_of
from true_drives import Case, chain, terrains, way_back

from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import csv_bytes
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.rovers import read_rover
from lunarsci.twin.assimilation.residuals import OBSERVED, POSITION, DriveRecord, pace_of, read_record, states_at
from lunarsci.twin.assimilation.segments import FEWEST_VALUES, record_within, traverse_of
from lunarsci.twin.assimilation.update import WIDENED, SlipLean, SoilUpdate, assimilate
from lunarsci.twin.comparison.forecast import forecast_of, match_observations
from lunarsci.twin.comparison.scores import ALL
from lunarsci.twin.comparison.verdict import compare
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.path import make_schedule, reach_m
from lunarsci.twin.plans.plan import Plan, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import Prediction, predict
from lunarsci.twin.telemetry.simulated import SensorErrors, SyntheticDrive, simulate_telemetry
from lunarsci.twin.telemetry.states import DriveStates, position_table, wheel_table

CASES = {
    "right": 48,
    "uphill": 24,
    "quasi-static": 10,
    "two soils": 10,
    "slipping": 12,
    "all": 6,
    "exact": 6,
    "heavy": 6,
    "tilted": 6,
    "multipass": 4,
}
"""Drives of each kind."""
MEMBERS = 64
SLIP = OBSERVED.index("slip_ratio")
HEAVIER, STEEPER, UPHILL = 1.4, 0.05, 0.11
TWO = ("two soils", "slipping")


def truth(kind: str, number: int, seed: int) -> tuple[Prediction, Prediction, Prediction]:
    """Out and back as they happened, and the drive whose track is seen."""
    rover, plan = build_rover("yutu2"), read_plan()
    if kind in ("right", "uphill", *TWO, "heavy", "tilted"):
        return _by_the_twin(kind, Case(physics="same", number=number, seed=seed), plan)
    case = Case(physics=kind, number=number, seed=seed)
    driven, ground = chain(case, rover, plan), terrains()[case.ground]
    out, back = (
        as_prediction(one, rover, ground, own) for one, own in zip(driven.drives[:2], driven.plans, strict=False)
    )
    return out, back, out


def as_prediction(driven: Driven, rover: Rover, ground: Terrain, plan: Plan) -> Prediction:
    """A true drive at the times of a simulated one."""
    shape = predict(rover, ground, plan, sweep=(), time_step_s=0.05, sample_m=0.05)
    timed = on_schedule(driven, plan, rover) if len(driven.time_s) < len(shape.time_s) / 3 else driven

    def at(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1)
        columns = [np.interp(shape.time_s, timed.time_s, column) for column in flat.T]
        return np.stack(columns, axis=1).reshape(1, len(shape.time_s), *values.shape[1:])

    recorded = np.array([len(shape.time_s)])
    return dataclasses.replace(
        shape, paths=at(timed.poses), states=at(timed.states), recorded=recorded, outcome=np.zeros(1, dtype=np.int64)
    )


def on_schedule(driven: Driven, plan: Plan, rover: Rover) -> Driven:
    """With the times at which the schedule is as far: that rover steers at once, and neither starts nor stops slowly.

    Without, its record says that a rover is at the target while by the schedule it steers after a turn.
    """
    schedule, speed = make_schedule(plan, rover), plan.speed_m_s
    own, told = [0.0], [0.0]
    for run in schedule.runs:
        length = run.length_m or abs(np.radians(run.legs[0].turn_deg)) * reach_m(rover)
        shares = np.linspace(0.0, 1.0, 201)
        times = np.linspace(run.begin_s + run.steer_s, run.end_s, 2001)
        told += np.interp(shares, run.share_at(times), times).tolist()
        own += (own[-1] + shares * (length / speed + sum(leg.stop_s for leg in run.legs))).tolist()
    return dataclasses.replace(driven, time_s=np.interp(driven.time_s, own, told))


def _by_the_twin(kind: str, case: Case, plan: Plan) -> tuple[Prediction, Prediction, Prediction]:
    ground, rover = told_ground(kind, case.number), build_rover("yutu2")
    if kind == "tilted":
        ground = steeper(ground, STEEPER)
    if kind == "heavy":
        described = read_rover("yutu2")
        mass = described.tables["mass"] | {"body_kg": HEAVIER * described.tables["mass"]["body_kg"]}
        rover = build_rover(dataclasses.replace(described, tables=described.tables | {"mass": mass}))

    def driven(own: Plan, draw: int) -> Prediction:
        values = values_of(first_belief().laws, case.hidden(draw))
        soil = {name: [float(value)] for name, value in zip(PARAMETERS, values, strict=True)}
        return predict(rover, ground, own, samples=soil, time_step_s=0.05, sample_m=0.05)

    finished: list[tuple[Prediction, Prediction]] = []
    for draw in range(40):
        out = driven(plan, draw)
        if not out.finished[0]:
            continue
        stood = Driven(time_s=out.time_s, poses=out.paths[0], states=out.states[0], outcome="finished")
        back = driven(way_back(plan, stood), draw)
        if back.finished[0]:
            finished.append((out, back))
        if len(finished) == (2 if kind in TWO else 1):
            return *finished[0], finished[-1][0]
    raise SystemExit(f"{kind} {case.number}: no soil carries the rover")


def told_ground(kind: str, number: int) -> Terrain:
    """What the twin is told of the ground."""
    ground = list(terrains().values())[number % len(terrains())]
    return steeper(ground, UPHILL) if kind in ("uphill", "slipping") else ground


def steeper(ground: Terrain, slope: float) -> Terrain:
    """The ground, rising so much more in x."""
    return dataclasses.replace(ground, height_m=ground.height_m + slope * ground.x_m[None, :])


def sent(drive: Prediction, seen: Prediction, told: Terrain, seed: int) -> DriveStates:
    """The states that are found in the telemetry of a drive, with the track of another one."""
    own = simulate_telemetry(drive, SensorErrors(), seed)
    if seen is not drive:
        own = dataclasses.replace(own, track=_track_of(own, drive, seen, seed))
    yutu2 = dataclasses.replace(own, prediction=dataclasses.replace(drive, rover=build_rover("yutu2")))
    return found_in(yutu2, told)


def _track_of(own: SyntheticDrive, drive: Prediction, seen: Prediction, seed: int) -> Any:
    """The track of the drive, as deep as the other drive's is in the middle."""
    other = simulate_telemetry(seen, SensorErrors(), seed).track
    factor = float(other["rut_m"].median() / own.track["rut_m"].median())
    return own.track.assign(rut_m=factor * own.track["rut_m"])


def record_of(states: DriveStates, rover: Rover, *, fixes: bool) -> DriveRecord:
    """As `twin update` reads it, with positions or without."""
    of_wheels = InputFile("states.csv", csv_bytes(wheel_table(states)))
    places = InputFile("positions.csv", csv_bytes(position_table(states)))
    return read_record(of_wheels, rover, positions=places if fixes else None)


def median_slips(record: DriveRecord, drives: Prediction) -> np.ndarray:
    """Of every drive, at the measured states. (members,)"""
    known = np.isfinite(record.values[:, SLIP])
    states = states_at(record, drives.time_s, drives.states[drives.finished], drives.rover.wheels)
    return np.asarray(np.median(states[:, known, SLIP], axis=1))


@cache
def first() -> SoilBelief:
    """Before any drive."""
    return first_belief()


def experiment(task: tuple[str, int, int]) -> dict[str, Any]:
    """One drive: what was learned of it, and how the same drive and the way back are predicted."""
    kind, number, seed = task
    out, back, seen = truth(kind, number, seed)
    rover, told = build_rover("yutu2"), told_ground(kind, number)
    row: dict[str, Any] = {"kind": kind, "number": number, "seed": seed}
    try:
        states = sent(out, seen, told, 10 * seed + number)
        record, along = (record_of(states, rover, fixes=fixes) for fixes in (True, False))
        found = assimilate(rover, told, out.plan, record, first())
    except Exception as error:
        return row | {"refused": f"{type(error).__name__}: {error}"[:200]}
    pace = pace_of(along, rover, out.plan)
    row |= {
        "refused": found.refused,
        "doubt": "; ".join(text for text in (along.doubt, pace.doubt if pace else "", found.doubt) if text),
        "inflation": dict(found.inflation),
        "measured": float(np.nanmedian(along.values[:, SLIP])),
        "sigma": float(np.nanmedian(along.sigmas[:, SLIP])),
        "simulated": float(median_slips(along, found.prediction)[0]),
    }
    if found.refused:
        return row
    back_states = sent(back, back, told, 10 * seed + number + 5)
    returned = [record_of(back_states, rover, fixes=fixes) for fixes in (True, False)]
    row["again"] = predicted(rover, told, out.plan, found, (record, along))
    row["back"] = predicted(rover, told, back.plan, found, (returned[0], returned[1]))
    return row


def halves(task: tuple[str, int, int]) -> dict[str, Any]:
    """What each half of a drive says of its soil, and how far it leans."""
    kind, number, seed = task
    out, _, seen = truth(kind, number, seed)
    rover, told = build_rover("yutu2"), told_ground(kind, number)
    row: dict[str, Any] = {"kind": kind, "number": number, "seed": seed, "halves": []}
    along = record_of(sent(out, seen, told, 10 * seed + number), rover, fixes=False)
    way = traverse_of(predict(rover, told, out.plan, sweep=()))
    middle = float(way.distance_m.mean())
    for low, high in ((-np.inf, middle), (middle, np.inf)):
        own = record_within(along, way, low, high)
        slips = int(np.isfinite(own.values[:, SLIP]).sum())
        lean = None
        if np.isfinite(own.values).sum() >= FEWEST_VALUES:
            lean = SlipLean.of(own, assimilate(rover, told, out.plan, own, first()), least=FEWEST_VALUES)
        row["halves"].append({"slips": slips, "lean": lean.to_dict() if lean else None})
    return row


def report_halves(rows: list[dict[str, Any]]) -> str:
    """How many were judged, how far they lean, and how many are called leaning."""
    every = [half for row in rows for half in row["halves"]]
    leans = [half["lean"] for half in every if half["lean"]]
    far = [abs(one["simulated"] - one["measured"]) for one in leans]
    errors = [by / np.hypot(one["spread"], one["sigma"]) for by, one in zip(far, leans, strict=True)]
    return (
        f"{len(every)} halves of {len(rows)} right drives, {len(leans)} judged: "
        f"largest lean {max(far, default=0.0):.3f}, {max(errors, default=0.0):.1f} errors; "
        f"called leaning: {sum(one['off'] for one in leans)}"
    )


def predicted(
    rover: Rover, ground: Terrain, plan: Plan, found: SoilUpdate, records: tuple[DriveRecord, DriveRecord]
) -> dict[str, Any]:
    """A drive predicted from a belief beside what was measured of it, as `twin compare` tells it."""
    record, along = records
    drives = predict(rover, ground, plan, samples=found.belief.draws(MEMBERS), ruts=found.prediction.ruts)
    plain = median_slips(along, drives)
    forecast = forecast_of(with_discrepancy(drives, found.belief.discrepancy), soils="belief")
    whole = dataclasses.replace(record, values=along.values, sigmas=along.sigmas)
    try:
        matched = match_observations(forecast, whole, np.isfinite(record.values))
        held = compare(matched)
    except Exception as error:
        return {"error": str(error)[:200]}
    check = next((one for one in held.bands if one.quantity == "slip_ratio" and one.wheel == ALL), None)
    return {
        "spread": float(plain.std(ddof=1)),
        "verdict": held.verdict,
        "bias_sd": None if check is None else check.bias_standard,
        "end_sd": None if held.end is None or held.end.standing is None else held.end.standing.distance,
    }


def main() -> None:
    """Drive, and report."""
    parser = argparse.ArgumentParser(description="How far does a belief lean where it is right, and where it is not?")
    parser.add_argument("--kinds", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--share", type=float, default=1.0, help="of the drives of each kind")
    parser.add_argument("--seed", type=int, default=53)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="file of results, one line a drive, added to")
    parser.add_argument("--report", type=Path, help="print the tables of this file, and drive nothing")
    parser.add_argument("--halves", action="store_true", help="of right drives, each learned on its own")
    given = parser.parse_args()
    told, drive = (report_halves, halves) if given.halves else (report, experiment)
    if given.report:
        print(told(rows_of(given.report)))
        return
    tasks = {
        (kind, number, given.seed): number / CASES[kind]
        for kind in (RIGHT if given.halves else given.kinds)
        for number in range(round(given.share * CASES[kind]))
    }
    tasks = {task: task for task in sorted(tasks, key=lambda task: tasks[task])}
    print(told(computed(drive, tasks, ("kind", "number", "seed"), given.out, given.jobs)))


RIGHT = ("right", "uphill")
MISLED = 2.0
"""Standard deviations by which the way back misses what was predicted of its slip or end, from which on it is wrong."""


def lean_of(row: dict[str, Any]) -> SlipLean:
    """As `twin update` judges it."""
    spread = row["again"].get("spread", 0.0)
    return SlipLean(measured=row["measured"], simulated=row["simulated"], spread=spread, sigma=row["sigma"])


def misled(row: dict[str, Any]) -> bool:
    """Whether the way back was predicted wrong."""
    back = row["back"]
    return max(abs(back.get("bias_sd") or 0.0), back.get("end_sd") or 0.0) > MISLED


def report(rows: list[dict[str, Any]]) -> str:
    """By kind: drives, refused, doubted without the lean; of the others the leans, and who was misled."""
    lines = ["kind          drives refused doubted | others  largest lean  errors  leaning | misled, of these leaning"]
    kinds = [kind for kind in CASES if any(row["kind"] == kind for row in rows)]
    for name, own in {
        **{kind: (kind,) for kind in kinds},
        "all right": RIGHT,
        "all wrong": set(CASES) - {*RIGHT},
    }.items():
        every = [row for row in rows if row["kind"] in own]
        known = [row for row in every if "again" in row]
        others = [row for row in known if not row["doubt"]]
        leans = [lean_of(row) for row in others]
        largest = max((abs(one.simulated - one.measured) for one in leans), default=0.0)
        errors = max((abs(one.simulated - one.measured) / one.error for one in leans), default=0.0)
        wrong = [lean.off for row, lean in zip(others, leans, strict=True) if misled(row)]
        lines.append(
            f"{name:13s} {len(every):6d} {len(every) - len(known):7d} {len(known) - len(others):7d} | {len(others):6d} "
            f"{largest:13.3f} {errors:7.1f} {sum(one.off for one in leans):8d} | {len(wrong):6d} {sum(wrong):6d}"
        )
        wide = [row["inflation"].get(POSITION, 1.0) > WIDENED for row in others]
        lines[-1] += f"; errors of position widened {WIDENED:g} times: {sum(wide)}"
    return "\n".join(lines)


if __name__ == "__main__":
    main()
