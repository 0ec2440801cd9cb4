"""How often the choice of minerals is right, each suite left out of what TEMPER and PENALTY are learned from.

`LUNARSCI_REFERENCE_DATA=… python tests/benchmarks/choices.py [NETWORKS]`, some minutes. With networks of the folds, of
`make_share_networks.py`, also how often minerals are there that are sure, and probably absent, by either probability.
"""

import os
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from lunarsci.spectra_data.make_share_calibration import all_spectra
from lunarsci.spectra_data.make_share_networks import FOLDS, fold_of, measured
from scipy.optimize import minimize
from scipy.special import log_softmax

from lunarsci.io.inputs import read_input
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.kinds import find_kinds
from lunarsci.spectra.abundance.learned import foretell_each, unpacked
from lunarsci.spectra.abundance.shares import LIKELY, answer, calibration, how_dark, solid_rock
from lunarsci.spectra.mgm.assemblages import FAMILIES, SURE
from lunarsci.spectra.mgm.selection import CREDIBLE, MOST_TOGETHER, choose
from lunarsci.spectra.readers.dispatch import read_spectra

COUNTED = 0.05
TOGETHER = {"PE-CMP": "XP-CMP", "PP-CMP": "XP-CMP"}
"""Suites whose powders are those of another."""
MINERALS = np.array([name.count("-") + 1.0 for name in FAMILIES])
MEMBERS = np.array([[key in name.split("-") for key in ("OL", "OPX", "CPX", "PLG")] for name in FAMILIES])


def evidence(data: Path, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ln evidence (n, 15), position of the right assemblage (n,), suite (n,) of spectra of one or two minerals."""
    rows = pd.read_csv(data / f"spectra/{name}/manifest.csv").set_index("id")
    spectra = {s.id: s for s in read_spectra(read_input(str(data / f"spectra/{name}/reflectance.csv")))}
    there = rows[["vol_ol", "vol_opx", "vol_cpx", "vol_plg"]] >= COUNTED
    rows = rows[there.sum(axis=1) <= 2]
    truth = ["-".join(np.array(["OL", "OPX", "CPX", "PLG"])[one]) for one in there.loc[rows.index].to_numpy()]
    suites = rows.index.to_series().str.extract(r"^([A-Za-z]+-[A-Z]+|[A-Za-z]+\d?)", expand=False).replace(TOGETHER)
    values = []
    for choice in choose([spectra[id] for id in rows.index]):
        by_name = {one.assemblage: one.ln_evidence for one in choice.candidates}
        values.append([by_name.get(family, -np.inf) for family in FAMILIES])
    return np.array(values), np.array([FAMILIES.index(one) for one in truth]), suites.to_numpy()


def learned(values: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """TEMPER and PENALTY under which the right assemblages are most probable."""

    def surprise(numbers: np.ndarray) -> float:
        scores = log_softmax(np.exp(numbers[0]) * values - numbers[1] * MINERALS, axis=1)
        return float(-scores[np.arange(truth.size), truth].mean() + 0.02 * numbers[0] ** 2)

    numbers = minimize(surprise, [-0.5, 1.5], method="Nelder-Mead").x
    return np.array([np.exp(numbers[0]), numbers[1]])


def row(name: str, values: np.ndarray, truth: np.ndarray, numbers: np.ndarray) -> str:
    """Shares of right first assemblages, of strong ones, and of right families among these; `numbers` (n, 2)."""
    share = np.exp(log_softmax(numbers[:, :1] * values - numbers[:, 1:] * MINERALS, axis=1))
    order = np.argsort(-share, axis=1)
    held = np.take_along_axis(share, order, axis=1).cumsum(axis=1)
    families = [one[: int((total < CREDIBLE).sum()) + 1] for one, total in zip(order, held, strict=True)]
    strong = np.array([MEMBERS[one].all(axis=0).any() and len(one) <= MOST_TOGETHER for one in families])
    right = np.array([one in family for one, family in zip(truth, families, strict=True)])
    first, sure = np.mean(order[:, 0] == truth), right[strong].mean()
    return f"{name:10} {truth.size} spectra: first {first:.2f}, strong {strong.mean():.2f}, of these right {sure:.3f}"


def standings(data: Path, networks: Path) -> None:
    """Of 409 spectra, minerals that are sure and probably absent by the fit and by `present`, and are there."""
    powders, spectra = measured(data / "spectra"), all_spectra(data / "spectra")
    fold, there = fold_of(powders.suites), powders.shares > COUNTED
    choices = choose(spectra)
    need = np.array([[one.minerals[name] for name in WEIGHED] for one in choices])
    present, inside = np.empty(need.shape), np.empty(len(spectra), dtype=bool)
    for k in range(FOLDS):
        with np.load(networks / f"fold-{k}.npz") as found:
            learned_of_fold = unpacked(found)
        rows = np.flatnonzero(fold == k)
        some = [spectra[row] for row in rows]
        every, kinds = np.ones((len(rows), 4)), find_kinds(some)
        result = answer(foretell_each(some, every, learned_of_fold), every, how_dark(kinds), solid_rock(kinds))
        present[rows], inside[rows] = result.present(calibration()), result.near() >= LIKELY
    for name, chance in (("fit", need), ("present", present)):
        for what, rows in (("all", inside | True), ("out of domain", ~inside)):
            sure, absent = chance[rows] >= SURE, chance[rows] <= 1 - SURE
            print(f"{name:8} {what:14} sure {sure.sum()}, of these there {there[rows][sure].mean():.3f}; "
                  f"absent {absent.sum()}, of these there {there[rows][absent].mean():.3f}")  # fmt: skip


def main() -> None:
    """Print both rows."""
    data = Path(os.environ["LUNARSCI_REFERENCE_DATA"])
    values, truth, suites = evidence(data, "relab")
    numbers = np.empty((truth.size, 2))
    for suite in np.unique(suites):
        numbers[suites == suite] = learned(values[suites != suite], truth[suites != suite])
    print(row("relab", values, truth, numbers))
    own = learned(values, truth)
    print(f"learned from all of relab: {own[0]:.2f}, {own[1]:.2f}")
    others, right, _ = evidence(data, "minerals")
    print(row("minerals", others, right, np.tile(own, (right.size, 1))))
    for networks in sys.argv[1:]:
        standings(data, Path(networks))


if __name__ == "__main__":
    main()
