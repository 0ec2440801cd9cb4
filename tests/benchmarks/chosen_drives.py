"""Are chosen drives as safe as promised? `python tests/benchmarks/chosen_drives.py [--terrains N] [--out FILE.jsonl]`

Errands on SYNTHETIC ground with hidden soils (`errands.py`): a chooser is told the ground and a belief of the soil, and
proposes a plan with the probability that it keeps all limits and ends within 1 m of the target, or says that none does.
The same hidden soils are then driven on by its plan, by the shortest path within the limits of the map (`twin plan`),
and by the cheapest way over a map of slope and roughness (`cost_map.py`): by the twin's physics, which misses by a draw
of what is believed that it misses by, and by that of `quasi_static.py`.

A claim that no plan keeps the limits is tried by plans of its own: the two baselines, forwards and backwards, and ways
over places drawn aside. The best of them is driven anew on fresh soils; where it keeps the limits as often as was
asked, the claim was wrong. That a claim stands this does not prove.

Each errand is one line of the file, and one that is there is not done again. `--report FILES` prints the tables.
"""

import argparse
import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cost_map import cost_map_legs
from errands import TOLERANCE_M, Errand, errand, kept, other_truths, truths
from result_lines import computed, rows_of

from lunarsci.errors import ParameterError
from lunarsci.twin.judgement.choice import Conditions, choose
from lunarsci.twin.plans.plan import Leg, Limit, Plan
from lunarsci.twin.routes.candidates import candidate_plans
from lunarsci.twin.routes.planner import plan_path
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import predict

MEMBERS = 64
TRUTHS, OTHERS = 32, 6
"""Hidden soils of an errand that plans are driven on by the twin's physics, and by other physics."""
HIDDEN = 1_000_003
"""Seed of the hidden soils, beside the errand's number; no chooser draws with it."""
JUDGED = 6
"""Candidates of a chooser whose probabilities are held against the truth, beside the chosen one."""
ASIDE, TRIED, TRIED_AGAIN = 8, 64, 512


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """What a chooser answers: a plan, or None and why; the probability promised; other plans, with theirs.

    The last of each of `others` is whether its probability is a promise, or only what it was sorted out by.
    """

    plan: Plan | None
    promised: float
    reason: str = ""
    others: tuple[tuple[Plan, float, bool], ...] = field(default=())


def shortest(one: Errand) -> Plan | None:
    """The plan of `twin plan`, which knows no soil."""
    try:
        return plan_path(one.surface, one.rover, one.start, one.target, limits=one.limits).plan
    except ParameterError:
        return None


def over_cost_map(one: Errand, *between: tuple[float, float]) -> Plan | None:
    """The plan of teams today, over places `between` where some are given."""
    legs: list[Leg] = []
    here = one.start
    for place in (*between, one.target):
        found = cost_map_legs(one.surface, one.rover, here, place)
        if not found:
            return None
        legs += found
        here = (*place, here[2] + sum(leg.turn_deg for leg in found))
    return _plan(one, tuple(legs))


def backwards(one: Errand, plan: Plan) -> Plan:
    """The same way, with the rover turned about on the spot first."""
    legs = [dataclasses.replace(leg, crab_deg=180.0) if leg.length_m else leg for leg in plan.legs]
    return _plan(one, (Leg(turn_deg=180.0), *legs))


def _plan(one: Errand, legs: tuple[Leg, ...]) -> Plan:
    x, y, heading = one.start
    return Plan(
        name=f"errand {one.number}",
        legs=legs,
        speed_m_s=one.rover.max_speed_m_s,
        x_m=x,
        y_m=y,
        heading_deg=heading,
        limits=one.limits,
    )


def believed(one: Errand, plan: Plan, members: int = MEMBERS, seed: int = 0) -> float:
    """Share of the believed soils on which a plan keeps the limits."""
    found = predict(one.rover, one.surface.terrain, plan, samples=one.belief.draws(members, seed), seed=seed)
    return float(kept(with_discrepancy(found, one.belief.discrepancy, seed), one).mean())


def by_risk(one: Errand, risk: float) -> Proposal:
    """The choice of `twin plan --risk`: candidates driven over the believed soils, the best again on fresh ones."""
    end = Limit("endpoint_miss_m", "m", TOLERANCE_M, "tolerance of the errand", False)
    try:
        plans = candidate_plans(one.surface, one.rover, one.start, one.target, limits=(*one.limits, end)).plans
    except ParameterError as error:
        return Proposal(plan=None, promised=0.0, reason=str(error))
    conditions = Conditions(
        rover=one.rover,
        terrain=one.surface.terrain,
        samples=one.belief.draws(3 * MEMBERS, 0),
        discrepancy=one.belief.discrepancy,
    )
    found = choose(plans, conditions, risk=risk, members=MEMBERS)
    best = found.best
    return Proposal(
        plan=best.plan if found.feasible else None,
        promised=1.0 - best.stated.risk,
        reason="" if found.feasible else best.weakest.why,
        others=tuple(
            (a.plan, 1.0 - a.stated.risk, a.promise is not None) for a in found.candidates if a is not found.best
        ),
    )


def judged(number: int, chooser: Callable[[Errand, float], Proposal], risk: float) -> dict[str, Any]:
    """One errand: what is proposed, and what then happens."""
    one, begin = errand(number), time.perf_counter()
    proposal = chooser(one, risk)
    took = time.perf_counter() - begin
    plans = {"chosen": proposal.plan, "shortest": shortest(one), "cost map": over_cost_map(one)}
    seed = HIDDEN + number
    picked = np.random.default_rng([seed, 3]).permutation(len(proposal.others))
    others = sorted((proposal.others[int(k)] for k in picked), key=lambda other: not other[2])[:JUDGED]
    row = {
        "errand": number,
        "risk": risk,
        "took_s": took,
        "promised": proposal.promised,
        "reason": proposal.reason,
        "plans": {name: _driven(one, plan, seed) for name, plan in plans.items() if plan is not None},
        "candidates": [[told, float(truths(one, plan, TRUTHS, seed).mean()), firm] for plan, told, firm in others],
    }
    if proposal.plan is None:
        row["refuted_by"] = refutation(one, [plan for plan in plans.values() if plan is not None])
    return row


def _driven(one: Errand, plan: Plan, seed: int) -> dict[str, Any]:
    return {
        "length_m": plan.length_m,
        "legs": len(plan.legs),
        "twin": float(truths(one, plan, TRUTHS, seed).mean()),
        "twin unmoved": float(truths(one, plan, TRUTHS, seed, moved=False).mean()),
        "other": float(other_truths(one, plan, OTHERS, seed).mean()),
    }


def refutation(one: Errand, plans: list[Plan]) -> float:
    """How often the best of plans of our own keeps the limits, on fresh soils."""
    random = np.random.default_rng([HIDDEN, one.number, 5])
    start, target = np.array(one.start[:2]), np.array(one.target)
    across = np.array([[0.0, -1.0], [1.0, 0.0]]) @ (target - start)
    tried = [*plans, *(backwards(one, plan) for plan in plans)]
    for _ in range(ASIDE):
        place = start + random.uniform(0.25, 0.75) * (target - start) + random.uniform(-0.4, 0.4) * across
        found = over_cost_map(one, (float(place[0]), float(place[1])))
        tried += [] if found is None else [found]
    if not tried:
        return 0.0
    best = max(tried, key=lambda plan: believed(one, plan, TRIED, HIDDEN + one.number))
    return believed(one, best, TRIED_AGAIN, HIDDEN - one.number)


BINS = 10
ALIKE = 0.1
"""Lengths that differ by this share at most count as equal."""
PHYSICS = ("twin", "twin unmoved", "other")
BASELINES = ("shortest", "cost map")


def report(rows: list[dict[str, Any]]) -> str:
    """All tables."""
    if not rows:
        return "no errand"
    asked = 1.0 - rows[0]["risk"]
    chosen = [row for row in rows if "chosen" in row["plans"]]
    none = [row for row in rows if "chosen" not in row["plans"]]
    lines = [f"{len(rows)} errands: {len(chosen)} plans promised at {asked:.0%}, {len(none)} times none; a choice took "
             f"{np.median([row['took_s'] for row in rows]):.1f} s (median)"]  # fmt: skip
    if chosen:
        lines += ["", "plans promised: mean promise, and share of hidden truths kept (standard error over errands)"]
        lines.append(f"  promised {np.mean([row['promised'] for row in chosen]):.3f}")
        lines += [f"  {name:13s} {_mean_of([row['plans']['chosen'][name] for row in chosen])}" for name in PHYSICS]
        lines += ["", *_comparison(chosen)]
    promised = [[row["promised"], row["plans"]["chosen"]["twin"]] for row in chosen]
    for what, firm in (("promised", True), ("told of drives sorted out early", False)):
        told = [pair[:2] for row in rows for pair in row["candidates"] if pair[2] is firm]
        lines += ["", *_calibration(f"probabilities {what}", told + promised * firm)]
    if none:
        wrong = [row for row in none if row["refuted_by"] >= asked]
        lines += ["", f"claims that none keeps the limits: {len(none)}, refuted {len(wrong)}, "
                      f"stand {1 - len(wrong) / len(none):.3f}"]  # fmt: skip
        for name in BASELINES:
            kept = [row["plans"][name]["twin"] for row in none if name in row["plans"]]
            lines += [f"  there {name:9s} keeps {_mean_of(kept)}"] if kept else []
    return "\n".join(lines)


def _mean_of(values: list[float]) -> str:
    error = np.std(values, ddof=1) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return f"{np.mean(values):.3f} +- {error:.3f} ({len(values)} errands)"


def _comparison(chosen: list[dict[str, Any]]) -> list[str]:
    lines = ["failures of the chosen drive and of others, on the same errands and soils"]
    for name in BASELINES:
        both = [row["plans"] for row in chosen if name in row["plans"]]
        alike = [p for p in both if abs(p["chosen"]["length_m"] / p[name]["length_m"] - 1.0) <= ALIKE]
        for what, pairs in (("all lengths", both), (f"equal within {ALIKE:.0%}", alike)):
            if not pairs:
                continue
            longer = np.median([p["chosen"]["length_m"] / p[name]["length_m"] for p in pairs])
            parts = [f"{kind} {_failed(pairs, 'chosen', kind):.3f} : {_failed(pairs, name, kind):.3f}"
                     for kind in PHYSICS]  # fmt: skip
            lines.append(f"  {name:9s} {what:16s} {len(pairs):3d} errands, {longer:.2f} as long; {'; '.join(parts)}")
    return lines


def _failed(pairs: list[dict[str, Any]], name: str, physics: str) -> float:
    return 1.0 - float(np.mean([p[name][physics] for p in pairs]))


def _calibration(what: str, pairs: list[list[float]]) -> list[str]:
    """By the probability that was told, how often the limits are kept."""
    if not pairs:
        return [f"{what}: none"]
    told, true = np.array(pairs).T
    place = np.minimum((told * BINS).astype(int), BINS - 1)
    lines = [f"{what}, and shares kept by the twin's physics", "  bin          plans   told    kept    off"]
    for k in range(BINS):
        own = place == k
        if own.any():
            a, b = told[own].mean(), true[own].mean()
            lines.append(f"  {k / BINS:.1f} to {(k + 1) / BINS:.1f} {own.sum():8d}  {a:.3f}   {b:.3f}  {b - a:+.3f}")
    return lines


def main() -> None:
    """Choose, drive and report."""
    parser = argparse.ArgumentParser(description="Are chosen drives as safe as promised?")
    parser.add_argument("--terrains", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first errand")
    parser.add_argument("--risk", type=float, default=0.05)
    parser.add_argument("--out", type=Path, help="file of results, one line an errand, added to")
    parser.add_argument("--report", type=Path, nargs="+", help="print the tables of these files, and drive nothing")
    given = parser.parse_args()
    if given.report:
        print(report(rows_of(*given.report)))
        return
    tasks = {(number,): number for number in range(given.first, given.first + given.terrains)}
    chosen = partial(judged, chooser=by_risk, risk=given.risk)
    print(report(computed(chosen, tasks, ("errand",), given.out, said=_said)))


def _said(row: dict[str, Any]) -> str:
    drives = ", ".join(
        f"{name} {plan['length_m']:.1f} m {plan['twin']:.2f}/{plan['other']:.2f}" for name, plan in row["plans"].items()
    )
    refuted = f", claim of none against {row['refuted_by']:.3f}" if "refuted_by" in row else ""
    return f"{row['errand']:4d} promised {row['promised']:.3f} in {row['took_s']:.1f} s: {drives}{refuted}"


if __name__ == "__main__":
    main()
