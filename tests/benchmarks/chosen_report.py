"""Tables of what `chosen_drives.py` found."""

import math
from typing import Any

import numpy as np

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
        lines += [f"  {name:13s} {_mean([row['plans']['chosen'][name] for row in chosen])}" for name in PHYSICS]
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
            lines += [f"  there {name:9s} keeps {_mean(kept)}"] if kept else []
    return "\n".join(lines)


def _mean(values: list[float]) -> str:
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
