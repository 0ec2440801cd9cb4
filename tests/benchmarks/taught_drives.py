"""Do drives chosen for what they teach make the next prediction better? `python tests/benchmarks/taught_drives.py`

On the SYNTHETIC ground of `errands.py`, with soils drawn from the first laws: the rover drives to the target by the
shortest path, and by the candidate of equal length and risk that is expected to teach most of the way back
(`lunarsci.twin.choice.teaching`), whether or not it surely teaches more; `--prefer teaching` takes it only if so. Its
wheels are measured as in `loop.py`; the belief is rectified, and one and the same way back is predicted from it. What
counts is how far the true end of that is from the predicted one. The truth is that of `quasi_static.py`; with
`--physics same`, where any drive tells nearly all, the twin's own. Candidates are those of `twin plan --risk --teach`:
also the shortest path with a turn on the spot and back before it, and with a wheel that slips on purpose.

Each soil is one line of the file, and one that is there is not done again.
"""

import argparse
import dataclasses
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import quasi_static
from errands import Errand, errand
from loop import POSITION_SHARES, measured, middle
from mujoco_rover import Driven

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import first_belief
from lunarsci.twin.assimilation.update import assimilate
from lunarsci.twin.choice.next_end import NextEnd
from lunarsci.twin.choice.teaching import teaching
from lunarsci.twin.plans.path import reach_m
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import make_schedule
from lunarsci.twin.routes.candidates import candidate_plans, with_tests
from lunarsci.twin.routes.planner import RouteSearch, plan_path
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import Prediction, predict

MEMBERS = 128
ALIKE = 0.1
"""Lengths, and shares of drives that end within the limits, that differ by this at most count as equal."""
MOST = 16


def drives(one: Errand, plan: Plan, soils: dict[str, np.ndarray], moved: bool, seed: int = 0) -> Prediction:
    """Over some soils, each moved by a draw of what the twin's physics is off by where that is asked."""
    found = predict(one.rover, one.surface.terrain, plan, samples=soils)
    return with_discrepancy(found, one.belief.discrepancy, seed) if moved else found


def true_drive(one: Errand, plan: Plan, hidden: dict[str, float], same: bool) -> Driven:
    """By the twin's own physics, or by others drawn with the errand's number."""
    if same:
        out = predict(one.rover, one.surface.terrain, plan, samples={name: [value] for name, value in hidden.items()})
        return Driven(time_s=out.time_s, poses=out.paths[0], states=out.states[0], outcome=out.outcome_text(0))
    physics = quasi_static.draw_physics(one.number)
    return on_schedule(quasi_static.drive(one.rover, one.surface.terrain, plan, hidden, physics), plan, one.rover)


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


def candidates(one: Errand, shortest: Plan) -> list[Plan]:
    """Plans to the same target, of about the same length; the shortest one first."""
    found = candidate_plans(one.surface, one.rover, one.start, one.target, limits=one.limits, most=MOST)
    search = RouteSearch.of(one.surface, one.rover, one.start, one.target, None)
    plans = with_tests((shortest, *found), search, MOST + 4)
    return [plan for plan in plans if abs(plan.length_m / shortest.length_m - 1.0) <= ALIKE]


def finished_within(prediction: Prediction) -> float:
    """Share of the drives that end, less than a metre and a half off."""
    return float((prediction.finished & (prediction.miss_m < 1.5)).mean())


def experiment(number: int, same: bool) -> dict[str, Any] | None:
    """One soil; None where the truth does not finish."""
    one, belief = errand(number), first_belief()
    soils = belief.draws(MEMBERS, 0)
    try:
        shortest = plan_path(one.surface, one.rover, one.start, one.target, limits=one.limits).plan
        end = np.array(one.target)
        heading = np.degrees(np.arctan2(*(np.array(one.start[:2]) - end)[::-1]))
        back = plan_path(one.surface, one.rover, (*one.target, float(heading)), one.start[:2], limits=one.limits).plan
    except ParameterError:
        return None
    following = drives(one, back, soils, not same, seed=1)
    hidden = {name: float(values[0]) for name, values in belief.draws(1, 7_000_000 + number).items()}
    true_back = true_drive(one, back, hidden, same)
    if not true_back.finished:
        return None
    told = compared(one, candidates(one, shortest), soils, following, same)
    if told is None:
        return None
    least, best = told[0], min(told, key=lambda pair: pair[0].after_m)
    ends = {name: _learned(one, plan, hidden, back, same) for name, plan in
            (("shortest", shortest), ("taught", best[1]))}  # fmt: skip
    if any(found is None for found in ends.values()):
        return None
    truth = true_back.poses[-1, :2]
    prior = middle(following.paths[following.finished, -1, :2])
    known = drives(one, back, {name: np.array([value]) for name, value in hidden.items()}, False).endpoints_m[0]
    return {
        "errand": number,
        "candidates": len(told),
        "name": best[1].name,
        "sure": best[0].surely_below(least[0], len(told)),
        "expected_m": {"before": least[0].before_m, "shortest": least[0].after_m, "taught": best[0].after_m},
        "expected_floor_m": least[0].floor_m,
        "before_m": float(np.hypot(*(prior - truth))),
        "soil_known_m": float(np.hypot(*(known - truth))),
        **{f"{name}_m": float(np.hypot(*(found[0] - truth))) for name, found in ends.items() if found is not None},
        "left": {name: found[1:] for name, found in ends.items() if found is not None},
        "length_m": {"shortest": shortest.length_m, "taught": best[1].length_m},
    }


def compared(
    one: Errand, plans: list[Plan], soils: dict[str, np.ndarray], following: Prediction, same: bool
) -> list[tuple[NextEnd, Plan]] | None:
    """What plans teach, of those as safe as the first one, which comes first; None where that one tells nothing."""
    told: list[tuple[NextEnd, Plan]] = []
    kept = finished_within(drives(one, plans[0], soils, not same))
    for plan in plans:
        predicted = drives(one, plan, soils, not same)
        if abs(finished_within(predicted) - kept) > ALIKE:
            continue
        try:
            taught = teaching(predicted, following).next_end
        except ParameterError:
            taught = None
        if taught is not None:
            told.append((taught, plan))
    return told if told and told[0][1] is plans[0] else None


def _learned(
    one: Errand, plan: Plan, hidden: dict[str, float], back: Plan, same: bool
) -> tuple[Any, float, float, float, str] | None:
    """Predicted end of the way back after a drive; standard deviations by soil, and by all; squared distance of the
    update's end; why it refused."""
    driven = true_drive(one, plan, hidden, same)
    if not driven.finished:
        return None
    record, error = measured(one.rover, plan, driven, POSITION_SHARES["third"], one.number), 0.0 if same else 1.0
    try:
        found = assimilate(one.rover, one.surface.terrain, plan, record, first_belief(), model_error=error, ruts=False)
    except ParameterError:
        return None
    predicted = drives(one, back, found.belief.draws(MEMBERS, 1), False)
    done = predicted.finished
    ends = predicted.endpoints_m[done]
    moved = ends if same else with_discrepancy(predicted, found.belief.discrepancy).endpoints_m[done]
    spread = [float(np.sqrt(np.trace(np.cov(cloud.T)))) for cloud in (ends, moved)]
    return middle(ends), *spread, found.reduced, found.refused


def report(rows: list[dict[str, Any]]) -> str:
    """Medians, and how often the taught drive was the better one."""
    if not rows:
        return "no soil"
    lines = [f"{len(rows)} soils; error of the predicted end of the way back, median and mean [mm]"]
    for name in ("before", "shortest", "taught"):
        values = 1e3 * np.array([row[f"{name}_m"] for row in rows])
        told = 1e3 * np.median([row["expected_m"][name] for row in rows])
        lines.append(f"  {name:12s} {np.median(values):7.1f} {values.mean():7.1f}   expected (median) {told:.1f}")
    known, floor = (1e3 * np.median([row[name] for row in rows]) for name in ("soil_known_m", "expected_floor_m"))
    lines.append(f"  true soil    {known:7.1f}           expected (median) {floor:.1f}")
    other = [row for row in rows if row["taught_m"] != row["shortest_m"]]
    better = np.mean([row["taught_m"] < row["shortest_m"] for row in other]) if other else float("nan")
    ratio = np.median([row["taught_m"] for row in rows]) / np.median([row["shortest_m"] for row in rows])
    preferred = [row["taught_m"] if row["sure"] else row["shortest_m"] for row in rows]
    lines += [
        f"  taught over shortest: {ratio:.2f} of the median; better in {better:.0%} of {len(other)} soils",
        f"  surely better by the twin in {sum(row['sure'] for row in rows)}; what --prefer teaching would drive: "
        f"{1e3 * np.median(preferred):.1f} mm",
        f"  refused: {sum(bool(row['left'][name][-1]) for row in rows for name in ('shortest', 'taught'))} updates",
    ]
    return "\n".join(lines)


def main() -> None:
    """Drive, learn and report."""
    parser = argparse.ArgumentParser(
        description="Do drives chosen for what they teach make the next prediction better?"
    )
    parser.add_argument("--soils", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--physics", choices=("quasi-static", "same"), default="quasi-static")
    parser.add_argument("--out", type=Path, help="file of results, one line a soil, added to")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    old = given.out.read_text().splitlines() if given.out and given.out.exists() else []
    rows = [json.loads(line) for line in old]
    done = {row["errand"] for row in rows}
    for number in range(given.first, given.first + given.soils):
        if number in done or (row := experiment(number, given.physics == "same")) is None:
            continue
        rows.append(row)
        print(json.dumps(row), flush=True)
        if given.out:
            with given.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
    print(report(rows))


if __name__ == "__main__":
    main()
