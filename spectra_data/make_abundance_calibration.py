"""Make `abundance_calibration.csv`: `python make_abundance_calibration.py FOLDER > abundance_calibration.csv`.

With `errors` behind FOLDER it makes `share_errors.csv`, the same errors one by one.

FOLDER holds `reflectance.csv` and `manifest.csv` in `relab`, `minerals` and `meteorites`. Spectra of known modes are
unmixed with a library that lacks whatever their suite was made of; the table keeps how the errors compare with what was
expected of them, class by class, each suite counting as the square root of its number of spectra.
"""

import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from lunarsci.spectra_data.make_kinds import suite_of

from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.end_members import FAMILY_OF, embedded_end_members, on_common_channels, without_siblings
from lunarsci.spectra.abundance.one_by_one import raw_shares
from lunarsci.spectra.abundance.posterior import DARK, MOST_WIDE, POWDER
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

COLUMNS = dict(zip(FAMILY_OF, ("vol_ol", "vol_opx", "vol_cpx", "vol_plg"), strict=True))
PURE, GOOD = 0.99, 0.15
"""From which share a sample is no mixture; largest error of a good result."""
MIXTURES = {
    "XP-CMP": (("orthopyroxene", "clinopyroxene"), ("PE-CMP-030", "PP-CMP-021", "PP-CMP-027-E")),
    "AG-TJM": (tuple(FAMILY_OF), ("AG-TJM-008", "AG-TJM-010", "AG-TJM-011")),
    "pomix": (("olivine", "orthopyroxene"), ("SC-EAC-002", "PP-EAC-087", "pomix4012")),
    "OOCMIX": (("olivine", "orthopyroxene", "clinopyroxene"), ("SC-EAC-002", "PP-EAC-087", "PP-EAC-016")),
    "MIX03": (("olivine", "clinopyroxene"), ("SC-EAC-002", "PP-EAC-016")),
    "MIX23": (("orthopyroxene", "clinopyroxene"), ("SC-EAC-036", "PYX040", "PP-EAC-001")),
    "MIX21": (("olivine", "orthopyroxene"), ("SC-EAC-002", "SC-EAC-036", "PO-EAC-062")),
}
"""Suites of mixed powders: minerals named, and end members of which no powder may be in the library."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A spectrum of known modes, and what was found; `score` is the error in units of what was expected.

    `misfit` is in units of the most with which shares are told.
    """

    suite: str
    id: str
    name: str
    minerals: tuple[str, ...]
    error: np.ndarray
    sigma: np.ndarray
    unlike: float
    misfit: float

    @property
    def score(self) -> np.ndarray:
        """(m,)"""
        return np.asarray(np.abs(self.error) / self.sigma)

    @property
    def good(self) -> bool:
        """Whether the worst mineral is near enough."""
        return bool(np.abs(self.error).max() <= GOOD)


def spectra_of(folder: Path) -> tuple[list[Spectrum], pd.DataFrame]:
    """Spectra and their manifest; modes as shares of what is named."""
    rows = pd.read_csv(folder / "manifest.csv").set_index("id")
    rows[list(COLUMNS.values())] = rows[list(COLUMNS.values())].div(rows[list(COLUMNS.values())].sum(axis=1), axis=0)
    return read_spectra(read_input(str(folder / "reflectance.csv"))), rows


def cases(folder: Path) -> Iterator[Case]:
    """All of them, mixtures first."""
    for part in ("relab", "minerals"):
        spectra, rows = spectra_of(folder / part)
        for suite, (minerals, powders) in MIXTURES.items():
            mixed = [s for s in spectra if s.id.startswith(suite) and rows.loc[s.id, [*COLUMNS.values()]].max() < PURE]
            for spectrum in mixed:
                yield case(spectrum, rows, suite, minerals, POWDER, powders)
    spectra, rows = spectra_of(folder / "meteorites")
    for spectrum in spectra:
        if rows.loc[spectrum.id, "type"] in ("Ordinary Chondrite", "Achondrite", "Igneous"):
            yield case(spectrum, rows, suite_of(spectrum.id), tuple(FAMILY_OF), DARK, ())


def case(
    spectrum: Spectrum, rows: pd.DataFrame, suite: str, minerals: tuple[str, ...], kind: str, powders: Sequence[str]
) -> Case:
    """What is found in one spectrum."""
    wavelength = on_common_channels([spectrum]).wavelength_nm
    library = without_siblings(embedded_end_members(wavelength), powders) if powders else None
    truth = rows.loc[spectrum.id, [COLUMNS[mineral] for mineral in minerals]].to_numpy(float)
    name, mean, sigma, unlike, misfit = raw_shares(spectrum, minerals, kind, library)
    return Case(suite, spectrum.id, name, minerals, mean - truth, sigma, unlike, misfit)


def factor(found: Sequence[Case], level: float) -> float:
    """Quantile of the scores, each suite with the weight of the square root of its number of spectra."""
    suites = [one.suite for one in found]
    scores = np.concatenate([one.score for one in found])
    weight = np.concatenate([np.full(one.score.size, suites.count(one.suite) ** -0.5) for one in found])
    order = np.argsort(scores)
    place = np.searchsorted(np.cumsum(weight[order]) / weight.sum(), level)
    return float(scores[order][min(place, scores.size - 1)])


def verdict(found: Sequence[Case]) -> tuple[float, float]:
    """Precision and recall of `MOST_WIDE` and `most_unlike`, each suite judged by the others."""
    taken = np.array([accepted(one, [other for other in found if other.suite != one.suite]) for one in found])
    good = np.array([one.good for one in found])
    return float(good[taken].mean()) if taken.any() else 0.0, float(taken[good].mean()) if good.any() else 0.0


def accepted(one: Case, others: Sequence[Case]) -> bool:
    """Whether a spectrum is in domain, by the errors of the others."""
    near = one.unlike <= max(other.unlike for other in others)
    return bool(one.misfit <= 1 and near and factor(others, 0.68) * one.sigma.max() <= MOST_WIDE)


def held(found: Sequence[Case], level: float) -> float:
    """Share of the errors within intervals of this level, each suite by the others."""
    inside = [one.score <= factor([other for other in found if other.suite != one.suite], level) for one in found]
    return float(np.concatenate(inside).mean())


def row(name: str, found: Sequence[Case]) -> dict[str, object]:
    """Of the table."""
    precision, recall = verdict(found)
    numbers = {
        "factor68": factor(found, 0.68),
        "factor95": factor(found, 0.95),
        "most_unlike": max(one.unlike for one in found),
        "held68": held(found, 0.68),
        "held95": held(found, 0.95),
        "precision": precision,
        "recall": recall,
    }
    suites = sorted({one.suite for one in found})
    return {"name": name, "suites": " ".join(suites), "count": len(found)} | {
        key: round(value, 3) for key, value in numbers.items()
    }


def error_row(one: Case, found: Sequence[Case]) -> dict[str, object]:
    """Of the table of errors; its suite takes no part in its verdict and its standard deviations."""
    others = [other for other in found if other.name == one.name and other.suite != one.suite]
    sigma = factor(others, 0.68) * one.sigma
    values = {
        "error": dict(zip(one.minerals, one.error, strict=True)),
        "sigma": dict(zip(one.minerals, sigma, strict=True)),
    }
    return {"class": one.name, "suite": one.suite, "id": one.id, "in_domain": str(accepted(one, others)).lower()} | {
        f"{what}_{mineral}": f"{own[mineral]:.3f}" if mineral in own else ""
        for what, own in values.items()
        for mineral in FAMILY_OF
    }


def main() -> None:
    """Write the table to stdout."""
    found = list(cases(Path(sys.argv[1])))
    names = dict.fromkeys(one.name for one in found)
    rows = [row(name, [one for one in found if one.name == name]) for name in names]
    if sys.argv[2:] == ["errors"]:
        rows = [error_row(one, found) for one in found]
    writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)


if __name__ == "__main__":
    main()
