"""How often the choice of minerals is right, each suite left out of what TEMPER and PENALTY are learned from.

`LUNARSCI_REFERENCE_DATA=… python tests/benchmarks/choices.py`, some minutes.
"""

import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import log_softmax

from lunarsci.io.inputs import read_input
from lunarsci.spectra.mgm.assemblages import FAMILIES
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


if __name__ == "__main__":
    main()
