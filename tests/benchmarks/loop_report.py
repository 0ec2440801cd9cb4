"""Tables of `loop.py`: how well the return is predicted, and whether beliefs hold what is true."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np

from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy, across_of
from lunarsci.regolith.prior import PARAMETERS

WANTED = "wanted: after <= 0.09 m, ratio <= 0.20, regions 0.85-0.95"


def interval(hits: Iterable[bool]) -> str:
    """Share of hits, and the 95 % interval of Clopper and Pearson (1934) about it."""
    from scipy.stats import binomtest

    values = [bool(hit) for hit in hits]
    if not values:
        return "-"
    low, high = binomtest(sum(values), len(values)).proportion_ci(0.95, method="exact")
    return f"{np.mean(values):.2f} ({low:.2f}-{high:.2f})"


def table(head: list[str], rows: list[list[str]]) -> str:
    """Columns side by side."""
    wide = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, wide, strict=True)) for row in [head, *rows]]
    return "\n".join(line.rstrip() for line in lines)


def report(rows: list[dict[str, Any]]) -> str:
    """All tables, one set for each reading of the positions."""
    readings = list(dict.fromkeys(reading for row in rows for reading in row["updates"]))
    parts = [header(rows)]
    for reading in readings:
        own = [row | row["updates"][reading] for row in rows if reading in row["updates"]]
        parts += [f"\n# Positions known to 4 % of the way, read as {reading}\n", returns(own), "\n" + losses(own)]
        parts += ["\n" + regions(own), "\n" + verdicts(own), "\n" + parameters(own), "\n" + health(own)]
    return "\n".join(parts)


def groups(rows: list[dict[str, Any]], terrains: bool = True) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """Rows by physics, over all terrains and on each."""
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for name in dict.fromkeys(row["physics"] for row in rows):
        own = [row for row in rows if row["physics"] == name]
        found[name, "all"] = own
        for terrain in dict.fromkeys(row["terrain"] for row in own) if terrains else ():
            found[name, terrain] = [row for row in own if row["terrain"] == terrain]
    return found


def of(rows: list[dict[str, Any]], name: str) -> np.ndarray:
    """One number of every row."""
    return np.array([row[name] for row in rows], dtype=float)


def header(rows: list[dict[str, Any]]) -> str:
    """How many soils, which were replaced, what a true drive took, and how far the return is off without any update."""
    lines = []
    for (name, _), own in groups(rows, terrains=False).items():
        reasons = [reason for row in own for reason in row["replaced"]]
        counts = ", ".join(f"{reasons.count(reason)} {reason.split(':')[0]}" for reason in dict.fromkeys(reasons))
        lines.append([name, str(len(own)), f"{len(reasons)}{f' ({counts})' if counts else ''}",
                      f"{np.median(of(own, 'drive_s')):.2f}", f"{np.median(of(own, 'before_m')):.3f}",
                      f"{np.median(of(own, 'known_m')):.3f}"])  # fmt: skip
    head = ["physics", "soils", "replaced: the truth did not finish", "true drive [s]", "return, not rectified [m]",
            "return, soil known [m]"]  # fmt: skip
    return table(head, lines)


def returns(rows: list[dict[str, Any]]) -> str:
    """Errors of the predicted return, by physics and terrain."""
    lines = []
    for (name, terrain), own in groups(rows).items():
        before, after = np.median(of(own, "before_m")), np.median(of(own, "after_m"))
        taken = [row for row in own if not row["refused"]]
        taken_after = f"{np.median(of(taken, 'after_m')):.3f}" if taken else "-"
        lines.append([name, terrain, str(len(own)), f"{before:.3f}", f"{after:.3f}", f"{after / before:.2f}",
                      f"{np.median(of(own, 'known_m')):.3f}",
                      f"{np.quantile(of(own, 'after_m'), 0.9):.3f}", f"{np.median(of(own, 'radius_m')):.3f}",
                      interval(row["held"] for row in own), f"{len(own) - len(taken)}", taken_after,
                      interval(row["held"] for row in taken)])  # fmt: skip
    head = ["physics", "terrain", "soils", "before [m]", "after [m]", "ratio", "soil known [m]", "90 % of errors < [m]",
            "spread [m]", "90 % regions hold", "refused", "after, not refused [m]", "their regions hold"]  # fmt: skip
    return f"Median error of the return's end ({WANTED})\n" + table(head, lines)


FEWEST_ENDS = 3
"""Of drives that finished, from which on they have a spread."""
REGIONS = {"held": 0.9, "held_50": 0.5}
"""Share of the predicted ends that a region holds."""


def distance_in(cloud: np.ndarray, point: np.ndarray) -> float:
    """Share of the ends of a cloud that are nearer to its mean than a point, in its standard deviations.

    By rank, so that tails count for what they are.
    """
    off = np.vstack([cloud, point]) - np.median(cloud, axis=0)
    squares = np.einsum("ij,ij->i", off @ np.linalg.inv(np.cov(cloud.T)), off)
    return float((squares[:-1] < squares[-1]).mean())


def region(cloud: np.ndarray, end: np.ndarray) -> dict[str, Any]:
    """Where the true end lies in a cloud of predicted ones, and how large its regions are.

    `radius_m` is the root of the trace of the covariance; `radius_90_m` the radius of the circle that has the area of
    the 90 % region.
    """
    within = distance_in(cloud, end)
    off = cloud - np.median(cloud, axis=0)
    covariance = np.cov(cloud.T)
    squares = np.einsum("ij,ij->i", off @ np.linalg.inv(covariance), off)
    size = float(np.linalg.det(covariance) ** 0.25 * np.sqrt(np.quantile(squares, REGIONS["held"])))
    held = {name: within <= share for name, share in REGIONS.items()}
    return {"within": within, "radius_m": float(np.sqrt(np.trace(covariance))), "radius_90_m": size} | held


def moved(cloud: np.ndarray, law: PhysicsDiscrepancy, way_m2: np.ndarray, seed: int) -> np.ndarray:
    """Ends on soils, each with a draw of a discrepancy."""
    random = np.random.default_rng(seed)
    parts = ((law.along, way_m2), (law.across, across_of(way_m2)))
    offsets = [
        one.sizes(len(cloud), random)[:, None]
        * (random.standard_normal(cloud.shape) @ np.linalg.cholesky(matrix + 1e-12 * np.eye(2)).T)
        for one, matrix in parts
    ]
    return np.asarray(cloud + sum(offsets))


def after_past_returns(rows: list[dict[str, Any]], past: int) -> list[dict[str, Any]]:
    """Regions of each return where its discrepancy also learned from so many other returns by the same physics.

    Those are the next ones in the order of the rows, in a circle, each scored by its measured end. Fewer where there
    are not as many.
    """
    found = []
    for k, row in enumerate(rows):
        if not row["model_error"]:
            found.append(row)
            continue
        law = PhysicsDiscrepancy.of(row["discrepancy"])
        for other in (rows[(k + 1 + n) % len(rows)] for n in range(min(past, len(rows) - 1))):
            ends = np.array(other["soil_ends_m"])
            if len(ends) < FEWEST_ENDS:
                continue
            known = np.cov(ends.T) + np.array(other["place_m2"])
            law = law.after_end(np.array(other["place_m"]) - np.median(ends, axis=0), known, np.array(other["way_m2"]))
        cloud = moved(np.array(row["soil_ends_m"]), law, np.array(row["way_m2"]), 11 + k)
        found.append(region(cloud, np.array(row["end_m"])))
    return found


PAST = (0, 2, 5, 8)
"""Returns that the discrepancy learned from."""


def regions(rows: list[dict[str, Any]]) -> str:
    """Whether regions hold: of the soil alone, with the discrepancy, and with one that past returns taught."""
    lines = []
    for (name, _), own in groups(rows, terrains=False).items():
        kinds = {"soil alone": [row["soil_only"] for row in own], "after the drive out": own}
        kinds |= {f"after {past} past returns": after_past_returns(own, past) for past in PAST if 0 < past < len(own)}
        for kind, found in kinds.items():
            lines.append([name, kind, interval(one["held"] for one in found), interval(one["held_50"] for one in found),
                          f"{np.median(of(found, 'radius_m')):.3f}",
                          f"{np.median(of(found, 'radius_90_m')):.3f}"])  # fmt: skip
    head = ["physics", "discrepancy", "90 % regions hold", "50 % regions hold", "spread [m]", "radius of 90 % [m]"]
    return "Regions of the return (wanted: 0.85-0.95, 0.40-0.60, spread <= 0.15 m)\n" + table(head, lines)


RISKS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Edges of the bins of stated risk."""


def clustered(pairs: list[tuple[int, bool]]) -> str:
    """A share, and twice its standard error, by soils, each of which may have several."""
    if not pairs:
        return "-"
    soils, hits = (np.array(part) for part in zip(*pairs, strict=True))
    share, each = float(hits.mean()), np.unique(soils)
    sums = np.array([(hits[soils == soil] - share).sum() for soil in each])
    error = np.sqrt((sums**2).sum() * len(each) / max(len(each) - 1, 1)) / len(hits)
    return f"{share:.2f}±{2.0 * error:.2f} of {len(hits)}"


def verdicts(rows: list[dict[str, Any]]) -> str:
    """Of plans with one limit each: how many keep it, by verdict, and the Brier score of the stated risk."""
    lines, bins = [], []
    rows = [row for row in rows if "limits" in row]
    for (name, _), own in groups(rows, terrains=False).items():
        kinds = {
            "before the drive": [(r["soil"], one["kept"], one["untaught"]) for r in own for one in r["limits"]],
            "after it": [
                (r["soil"], one["kept"], said)
                for r in own
                for one, said in zip(r["limits"], r["verdicts"], strict=True)
            ],
        }
        for kind, found in kinds.items():
            by = {
                word: clustered([(soil, kept) for soil, kept, said in found if said["verdict"] == word])
                for word in ("go", "no-go")
            }
            failed, risk = (np.array(part, dtype=float) for part in zip(*((not k, s["risk"]) for _, k, s in found),
                                                                        strict=True))  # fmt: skip
            plain = failed.mean()
            lines.append([name, kind, f"{1.0 - plain:.2f}", *by.values(), f"{np.mean((risk - failed) ** 2):.3f}",
                          f"{plain * (1.0 - plain):.3f}"])  # fmt: skip
            for low, high in pairwise(RISKS):
                some = (risk > low) & (risk <= high)
                if some.any():
                    bins.append([name, kind, f"{low:g}-{high:g}", str(int(some.sum())), f"{risk[some].mean():.3f}",
                                 f"{failed[some].mean():.3f}"])  # fmt: skip
    head = ["physics", "belief", "keep", "GO keep (wanted >= 0.93)", "NO-GO would keep (<= 0.25)", "Brier",
            "Brier of the mean"]  # fmt: skip
    risks = ["physics", "belief", "stated risk", "plans", "its mean", "failed"]
    return "Plans with a drawn limit\n" + table(head, lines) + "\n\nStated risks\n" + table(risks, bins)


def losses(rows: list[dict[str, Any]]) -> str:
    """What other physics cost: against `same` on the same soils, where the soil was not replaced in one of them."""
    same = {(row["seed"], row["soil"]): row for row in rows if row["physics"] == "same"}
    lines = []
    for (name, _), own in groups(rows, terrains=False).items():
        pairs = [
            (row, same[key])
            for row in own
            if (key := (row["seed"], row["soil"])) in same and len(row["replaced"]) == len(same[key]["replaced"])
        ]
        if name == "same" or not pairs:
            continue
        mine, theirs = (np.array([pair[k]["after_m"] for pair in pairs]) for k in (0, 1))
        held = [np.mean([pair[k]["held"] for pair in pairs]) for k in (0, 1)]
        lines.append([name, str(len(pairs)), f"{np.median(theirs):.3f}", f"{np.median(mine):.3f}",
                      f"{np.median(mine) / np.median(theirs):.2f}", f"{1e3 * np.median(mine - theirs):+.0f}",
                      f"{held[1]:.2f} -> {held[0]:.2f}"])  # fmt: skip
    head = ["physics", "soils", "same [m]", "this [m]", "ratio", "median difference [mm]", "regions hold"]
    return "Loss against a truth of the twin's own physics, on the same soils\n" + table(head, lines) if lines else ""


def parameters(rows: list[dict[str, Any]]) -> str:
    """How often intervals hold the true parameters, and how much narrower they are than before the drive."""
    lines = []
    for (name, _), own in groups(rows, terrains=False).items():
        taken = [row for row in own if not row["refused"]]
        for k, key in enumerate(PARAMETERS) if taken else ():
            z, left = np.array([row["z"][k] for row in taken]), np.array([row["left"][k] for row in taken])
            own = np.abs([row["ground_z"][k] for row in taken])
            lines.append([name, key, interval(np.abs(z) < 1.0), interval(np.abs(z) < 1.96),
                          f"{(own < 1.0).mean():.2f}", f"{(own < 1.96).mean():.2f}",
                          f"{left.mean():.2f}", f"{np.mean(z):+.2f}", f"{np.std(z):.2f}"])  # fmt: skip
        if taken:
            z, own = np.array([row["z"] for row in taken]), np.abs([row["ground_z"] for row in taken])
            lines.append([name, "all", f"{(np.abs(z) < 1.0).mean():.2f}", f"{(np.abs(z) < 1.96).mean():.2f}",
                          f"{(own < 1.0).mean():.2f}", f"{(own < 1.96).mean():.2f}",
                          "", f"{z.mean():+.2f}", f"{z.std():.2f}"])  # fmt: skip
    head = ["physics", "parameter", "68 % intervals hold", "95 % intervals hold", "ground's own 68 %", "95 %",
            "width left", "mean z", "sd of z"]  # fmt: skip
    return "Parameters, of updates that were not refused (width left: after as a share of before)\n" + table(
        head, lines
    )


def health(rows: list[dict[str, Any]]) -> str:
    """Refusals, and what the updates say of themselves."""
    lines = []
    for (name, _), own in groups(rows, terrains=False).items():
        refused = [row for row in own if row["refused"]]
        lines.append([name, interval(bool(row["refused"]) for row in own), f"{np.median(of(own, 'reduced')):.2f}",
                      f"{np.median(of(own, 'surprise')):.2f}", f"{np.median(of(own, 'persistence')):.2f}",
                      f"{np.median(of(own, 'took_s')):.1f}",
                      f"{np.median(of(refused, 'reduced')):.2f}" if refused else "-"])  # fmt: skip
    head = ["physics", "refused", "reduced chi-square", "surprise", "persistence", "update [s]", "chi-square, refused"]
    return "Updates (medians)\n" + table(head, lines)
