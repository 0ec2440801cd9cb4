"""Do drives chosen for what they teach make the next prediction better? `python tests/benchmarks/taught_drives.py`

On the SYNTHETIC ground of `errands.py`, with soils drawn from the first laws: the rover drives to the target by the
shortest path, or by the candidate of equal length and risk that is expected to teach most of the way back
(`lunarsci.twin.choice.teaching`); its wheels are measured as in `loop.py`; the belief is rectified, and one and the
same way back is predicted from it. What counts is how far the true end of that is from the predicted one. The truth is
that of `quasi_static.py`; with `--physics same`, where any drive tells nearly all, the twin's own. Candidates are those
of `twin plan --risk`, and the shortest path with a test before it: half a turn on the spot, and back. Wheel rates
cannot be commanded one by one by a plan.

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
from lunarsci.twin.choice.teaching import teaching
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.routes.candidates import candidate_plans
from lunarsci.twin.routes.planner import plan_path
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import Prediction, predict

MEMBERS = 128
ALIKE = 0.1
"""Lengths, and shares of drives that end within the limits, that differ by this at most count as equal."""
TESTS_DEG = (180.0,)
MOST = 16


def drives(one: Errand, plan: Plan, soils: dict[str, np.ndarray], moved: bool) -> Prediction:
    """Over some soils, each moved by a draw of what the twin's physics is off by where that is asked."""
    found = predict(one.rover, one.surface.terrain, plan, samples=soils)
    return with_discrepancy(found, one.belief.discrepancy, 0) if moved else found


def true_drive(one: Errand, plan: Plan, hidden: dict[str, float], same: bool) -> Driven:
    """By the twin's own physics, or by others drawn with the errand's number."""
    if not same:
        return quasi_static.drive(one.rover, one.surface.terrain, plan, hidden, quasi_static.draw_physics(one.number))
    out = predict(one.rover, one.surface.terrain, plan, samples={name: [value] for name, value in hidden.items()})
    return Driven(time_s=out.time_s, poses=out.paths[0], states=out.states[0], outcome=out.outcome_text(0))


def candidates(one: Errand, shortest: Plan) -> list[Plan]:
    """Plans to the same target, of about the same length."""
    found = list(candidate_plans(one.surface, one.rover, one.start, one.target, limits=one.limits, most=MOST))
    for turn in TESTS_DEG:
        found.append(dataclasses.replace(shortest, legs=(Leg(turn_deg=turn), Leg(turn_deg=-turn), *shortest.legs)))
    return [plan for plan in found if abs(plan.length_m / shortest.length_m - 1.0) <= ALIKE]


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
    following, first = (drives(one, plan, soils, not same) for plan in (back, shortest))
    hidden = {name: float(values[0]) for name, values in belief.draws(1, 7_000_000 + number).items()}
    true_back = true_drive(one, back, hidden, same)
    if not true_back.finished:
        return None
    told: list[tuple[float, Plan]] = []
    for plan in candidates(one, shortest):
        predicted = drives(one, plan, soils, not same)
        if abs(finished_within(predicted) - finished_within(first)) <= ALIKE:
            try:
                told.append((teaching(predicted, following).end_sd_m[1], plan))
            except ParameterError:
                continue
    if not told:
        return None
    try:
        before, expected = teaching(first, following).end_sd_m
    except ParameterError:
        return None
    best = min(told, key=lambda pair: pair[0])
    ends = {name: _learned(one, plan, hidden, back, same) for name, plan in
            (("shortest", shortest), ("taught", best[1]))}  # fmt: skip
    if any(found is None for found in ends.values()):
        return None
    truth = true_back.poses[-1, :2]
    prior = middle(following.endpoints_m[following.finished])
    return {
        "errand": number,
        "candidates": len(told),
        "name": best[1].name,
        "expected_m": {"before": before, "shortest": expected, "taught": best[0]},
        "before_m": float(np.hypot(*(prior - truth))),
        **{f"{name}_m": float(np.hypot(*(found[0] - truth))) for name, found in ends.items() if found is not None},
        "sd": {name: found[1] for name, found in ends.items() if found is not None},
        "length_m": {"shortest": shortest.length_m, "taught": best[1].length_m},
    }


def _learned(
    one: Errand, plan: Plan, hidden: dict[str, float], back: Plan, same: bool
) -> tuple[Any, list[float]] | None:
    """Predicted end of the way back after a drive, and what the update left of each standard deviation."""
    driven = true_drive(one, plan, hidden, same)
    if not driven.finished:
        return None
    record, error = measured(one.rover, plan, driven, POSITION_SHARES["third"], one.number), 0.0 if same else 1.0
    try:
        found = assimilate(one.rover, one.surface.terrain, plan, record, first_belief(), model_error=error, ruts=False)
    except ParameterError:
        return None
    predicted = drives(one, back, found.belief.draws(MEMBERS, 1), False)
    return middle(predicted.endpoints_m[predicted.finished]), list(found.belief.sd_ratio.values())


def report(rows: list[dict[str, Any]]) -> str:
    """Medians, and how often the taught drive was the better one."""
    if not rows:
        return "no soil"
    lines = [f"{len(rows)} soils; error of the predicted end of the way back, median and mean [mm]"]
    for name in ("before", "shortest", "taught"):
        values = 1e3 * np.array([row[f"{name}_m"] for row in rows])
        told = 1e3 * np.median([row["expected_m"][name] for row in rows])
        lines.append(f"  {name:9s} {np.median(values):7.1f} {values.mean():7.1f}   expected sd (median) {told:.1f}")
    ratio = np.median([row["taught_m"] for row in rows]) / np.median([row["shortest_m"] for row in rows])
    better = np.mean([row["taught_m"] < row["shortest_m"] for row in rows])
    lines.append(f"  taught over shortest: {ratio:.2f} of the median; better in {better:.0%} of the soils")
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
