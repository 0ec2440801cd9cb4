"""How often shares are in domain, and good, where right or wrong minerals are named to `spectra unmix`.

`python tests/benchmarks/named_minerals.py FOLDER` with `reflectance.csv` and `manifest.csv` of RELAB; some minutes.
Good: all shares within 15 %. Right: what is named is there (2 % or more), and nothing else. Wrong: 10 % or more of what
is there is not named.
"""

import csv
import sys
from itertools import combinations
from pathlib import Path

import numpy as np

import lunarsci
from lunarsci.minerals import ABBREVIATIONS, WEIGHED


def main(folder: Path) -> None:
    modes = {}
    for row in csv.DictReader((folder / "manifest.csv").open()):
        parts = np.array([float(row[f"vol_{name}"] or 0.0) for name in ("ol", "opx", "cpx", "plg")])
        modes[row["id"]] = parts / parts.sum()
    answers: dict[str, list[tuple[bool, bool]]] = {"right": [], "wrong": []}
    for places in [some for count in (2, 3) for some in combinations(range(len(WEIGHED)), count)]:
        named = "-".join(ABBREVIATIONS[WEIGHED[k]] for k in places)
        there = np.isin(np.arange(len(WEIGHED)), places)
        unmixed = lunarsci.unmix(folder / "reflectance.csv", kind="powder-mixture", assemblage=named)
        for one in unmixed.shares:
            mean, truth = np.zeros(len(WEIGHED)), modes[one.id]
            mean[[WEIGHED.index(item.mineral) for item in one.fractions]] = [item.fraction for item in one.fractions]
            left_out = truth[~there].sum()
            kind = "right" if left_out < 0.02 and truth[there].min() >= 0.02 else "wrong" if left_out >= 0.1 else ""
            if kind:
                answers[kind].append((one.in_domain, bool(np.abs(mean - truth).max() <= 0.15)))
    for kind, rows in answers.items():
        inside, good = np.array(rows).T
        print(f"{kind}: {len(rows)} answers, {inside.mean():.2f} in domain, {good[inside].mean():.2f} of these good")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
