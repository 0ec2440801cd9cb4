"""How often compositions from band centres are right within their errors, on minerals and meteorites of known ones.

`LUNARSCI_REFERENCE_DATA=… python tests/benchmarks/compositions.py`, five minutes. The assemblage is chosen; of each key
those are counted that a result quotes: in range, and not the prior's. `TREND_SIGMA` is the last column but two. Below,
mixtures of two pyroxenes of which one alone was called sure, and the largest share of the other: `HIDDEN`. Last the
default fit: `FO_HIDDEN`, each sample series left out, and how often Fo is right where it is told.
"""

import os
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

import lunarsci
from lunarsci.result import from_prior
from lunarsci.spectra.mgm import TREND_SIGMA
from lunarsci.spectra.mgm.batch import FO_HIDDEN

TRUTH = {
    "fo": ("fo", "vol_ol"),
    "fs": ("opx_fs", "vol_opx"),
    "wo": ("cpx_wo", "vol_cpx"),
    "fs_cpx": ("cpx_fs", "vol_cpx"),
}
SETS = ("meteorites", "relab")
ALL_SETS = (*SETS, "minerals")
PYROXENES = {"orthopyroxene": "vol_opx", "clinopyroxene": "vol_cpx"}
LEAST_SHARE = 0.05
"""Of both pyroxenes in a mixture."""
Records = Mapping[str, Mapping[str, Any]]


def fitted(data: Path, name: str) -> tuple[pd.DataFrame, Records]:
    """The manifest of a set, and its fits with the assemblage chosen, by id."""
    known = pd.read_csv(data / f"spectra/{name}/manifest.csv").set_index("id")
    spectra = lunarsci.fit(data / f"spectra/{name}/reflectance.csv", assemblage="auto").to_dict()["spectra"]
    return known, {record["id"]: record for record in spectra}


def misses(known: pd.DataFrame, records: Records) -> dict[str, list[tuple[float, float]]]:
    """(error, sigma) of what is quoted, by key; what the manifest leaves open or states as 0 is not counted."""
    found = defaultdict(list)
    for name, record in records.items():
        for key, item in record["compositions"].items():
            truth, share = (known.loc[name, column] for column in TRUTH[key])
            told = item["in_range"] and not from_prior(item["sigma"], item["prior_sigma"])
            if told and truth > 0 and share > 0:
                found[key].append((item["mean"] - 100 * truth, item["sigma"]))
    return found


def hidden(*sets: tuple[pd.DataFrame, Records]) -> None:
    """Print how many mixtures of two pyroxenes were fitted by one, and the most that was hidden of the other."""
    shares = pd.concat(known[list(PYROXENES.values())].fillna(0.0) for known, _ in sets)
    records = {name: record for _, own in sets for name, record in own.items()}
    mixed = [name for name in records if (shares.loc[name] >= LEAST_SHARE).all() and records[name]["choice"]]
    print(f"{len(mixed)} mixtures with {LEAST_SHARE:.0%} or more of both pyroxenes")
    for mineral, column in PYROXENES.items():
        other = next(one for one in PYROXENES if one != mineral)
        alone = [
            name
            for name in mixed
            if other in records[name]["choice"]["sure"] and mineral not in records[name]["choice"]["sure"]
        ]
        most = max(alone, key=lambda name: float(shares.loc[name, column]), default="")
        told = f", at most {shares.loc[most, column]:.0%} ({most})" if most else ""
        print(f"{other} alone is sure in {len(alone)}, and hides {mineral}{told}")


def olivines(data: Path) -> pd.DataFrame:
    """Of the default fit: error of Fo, the fit's own sigma, pyroxene's share of strengths at 1 um, series, by id."""
    rows = []
    for name in ALL_SETS:
        known = pd.read_csv(data / f"spectra/{name}/manifest.csv").set_index("id")
        for record in lunarsci.fit(data / f"spectra/{name}/reflectance.csv").to_dict()["spectra"]:
            own, item = known.loc[record["id"]], record["compositions"]["fo"]
            if own["vol_ol"] > LEAST_SHARE and own["fo"] > 0 and item["mean"] is not None:
                at_1um = [band for band in record["bands"] if band["region"] == "um1" and band["mineral"] != "any"]
                depth = pd.DataFrame(at_1um).groupby("mineral")["strength"].sum()
                share = 1 - depth["olivine"] / depth.sum()
                sigma = np.sqrt(item["sigma"] ** 2 - (FO_HIDDEN * share) ** 2)
                series = "mixtures" if record["id"][0].islower() else "-".join(record["id"].split("-")[:2])
                rows.append((item["mean"] - 100 * own["fo"], sigma, share, series))
    return pd.DataFrame(rows, columns=["error", "sigma", "share", "series"])


def hidden_olivine(found: pd.DataFrame) -> None:
    """Print `FO_HIDDEN` by the likeliest Student law, each series left out, and how often told Fo are right."""

    def cost(hidden: float, part: pd.DataFrame) -> float:
        scale = np.sqrt(part["sigma"] ** 2 + TREND_SIGMA["fo"] ** 2 + (hidden * part["share"]) ** 2)
        return -float(student.logpdf(part["error"], 4, scale=scale).sum())

    parts = [found[found["series"] != series] for series in found["series"].unique()]
    each = [minimize_scalar(cost, bounds=(0, 200), args=(part,), method="bounded").x for part in parts]
    total = np.hypot(found["sigma"], FO_HIDDEN * found["share"])
    told = ~np.array([from_prior(one, 30.0) for one in total])
    right = np.abs(found["error"]) <= 2 * np.hypot(total, TREND_SIGMA["fo"])
    print(f"hidden by pyroxene: {min(each):.0f} to {max(each):.0f} mol %, {len(found)} spectra, {len(parts)} series")
    print(f"Fo is told of {told.mean():.0%}, of these within two errors {right[told].mean():.0%}")


def row(name: str, key: str, values: list[tuple[float, float]]) -> str:
    """Root mean square, mean, what sigma leaves of the first; shares within two errors without and with the trend's."""
    error, sigma = np.array(values).T
    left = np.sqrt(max(0.0, float(np.mean(error**2 - sigma**2))))
    inside = [np.mean(np.abs(error) <= 2 * np.hypot(sigma, more)) for more in (0.0, TREND_SIGMA[key])]
    rms = np.sqrt(np.mean(error**2))
    return (
        f"{key:<7} {name:<11} {error.size:>4} {rms:>6.1f} {error.mean():>+6.1f} {np.median(sigma):>6.1f} {left:>6.1f} "
        f"{inside[0]:>7.0%} {inside[1]:>7.0%}"
    )


def main() -> None:
    """Print the table."""
    data = Path(os.environ["LUNARSCI_REFERENCE_DATA"])
    fits = {name: fitted(data, name) for name in SETS}
    found = {name: misses(*fits[name]) for name in SETS}
    print("key     spectra        n    rms   bias  sigma  trend  within 2, and with the trend's")
    for key in TRUTH:
        for name in SETS:
            print(row(name, key, found[name][key]))
        print(row("both", key, [one for name in SETS for one in found[name][key]]))
    hidden(fits["relab"], fitted(data, "minerals"))
    hidden_olivine(olivines(data))


if __name__ == "__main__":
    main()
