"""Make `kinds.csv` from reference spectra: `python make_kinds.py FOLDER > kinds.csv`.

FOLDER holds the folders relab, minerals, meteorites, lunar_soils, lunar and ce4. The table keeps means and covariances
of the features of `lunarsci.spectra.abundance.kinds`, no spectrum.
"""

import csv
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from lunarsci.spectra_data.make_normative import MISSION_OF_ROW

from lunarsci.arrays import FloatArray
from lunarsci.io.inputs import read_input
from lunarsci.spectra.abundance.kinds import WINDOWS_NM, Kind, KindModel, spectral_features
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

COMPONENTS: dict[str, Kind] = {
    "powder": "powder-mixture",
    "dark-powder": "dark-rock-powder",
    "soil": "weathered-soil",
    "rover-rock": "solid-rock",
    "cut-rock": "solid-rock",
}
SOLID = r"Chip|Slab|Natural"
TERRESTRIAL = "MS-CMP"
"""Olivines among the meteorites."""
LAB_TO_LAB = {"level": 0.2} | dict.fromkeys([name for name in WINDOWS_NM if name != "level"], 0.04) | {"visible": 0.02}
"""Standard deviation of each feature between instruments, packings and geometries; assumed."""
SHRINKAGE = 0.15
"""Weight of the mean variances of all components, without correlation, in each covariance; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A spectrum of known kind; suite: laboratory series, or mission; rock: its name, all spectra of which are kin."""

    spectrum: Spectrum
    component: str
    suite: str
    rock: str


@cache
def examples(folder: Path) -> tuple[Example, ...]:
    """All spectra of known kind."""
    return (*_powders(folder), *_soils(folder), *_rover(folder))


def suite_of(id: str) -> str:
    """The series of an id: PE-CMP of PE-CMP-030-A, pomix1 of pomix1002, MIX of MIX031."""
    short = re.match(r"(pomix\d|OOCMIX|MIX|PYX)", id)
    return short.group(1) if short else "-".join(id.split("-")[:2])


def _powders(folder: Path) -> list[Example]:
    found = []
    for name in ("relab", "minerals", "meteorites"):
        rows = pd.read_csv(folder / name / "manifest.csv").drop_duplicates("id").set_index("id")
        for spectrum in read_spectra(read_input(str(folder / name / "reflectance.csv"))):
            row = rows.loc[spectrum.id]
            rock = re.split(r"[ ,]", str(row["name"]))[0].lower()
            dark = name == "meteorites" and not spectrum.id.startswith(TERRESTRIAL)
            component = "dark-powder" if dark else "powder"
            if re.search(SOLID, str(row.get("texture", ""))):
                component = "cut-rock"
            found.append(Example(spectrum, component, suite_of(spectrum.id), rock if dark else spectrum.id))
    return found


def _soils(folder: Path) -> list[Example]:
    soils = read_spectra(read_input(str(folder / "lunar_soils/reflectance.csv")))
    found = [Example(item, "soil", mission, item.id) for item, mission in zip(soils, MISSION_OF_ROW, strict=True)]
    apollo16 = read_spectra(read_input(str(folder / "lunar/apollo16_62231_relab_avg.csv")))[0]
    orbit = read_spectra(read_input(str(folder / "lunar/m3_aristarchus_sample.csv")))
    return [*found, Example(apollo16, "soil", "a16", "62231"), *(Example(item, "soil", "m3", "m3") for item in orbit)]


def _rover(folder: Path) -> list[Example]:
    spectra = read_spectra(read_input(str(folder / "ce4/reflectance_factor.csv")))
    return [Example(item, "rover-rock" if "rock" in item.id else "soil", "ce4", item.id) for item in spectra]


def features(found: tuple[Example, ...]) -> FloatArray:
    """(n, 9)"""
    return np.array([spectral_features(item.spectrum)[0] for item in found])


def learn_kinds(
    features: FloatArray, components: Sequence[str], suites: Sequence[str], kinds: Mapping[str, Kind]
) -> KindModel:
    """Laws from features (n, 9) of spectra of known components; a suite of m spectra counts as sqrt(m) of them."""
    named, from_suite = np.array(components), np.array(suites)
    found = [_moments(features[named == name], from_suite[named == name]) for name in kinds]
    mean, raw = np.array([item[0] for item in found]), np.array([item[1] for item in found])
    pooled = np.diag(np.diagonal(raw.mean(axis=0)))
    measured = np.diag(np.square([LAB_TO_LAB[name] for name in WINDOWS_NM]))
    return KindModel(tuple(kinds), tuple(kinds.values()), mean, (1 - SHRINKAGE) * raw + SHRINKAGE * pooled + measured)


def _moments(features: FloatArray, suites: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted mean (9,) and covariance (9, 9); features that are NaN do not count."""
    _, place, count = np.unique(suites, return_inverse=True, return_counts=True)
    there = np.isfinite(features)
    weight = count[place][:, None] ** -0.5 * there
    mean = np.sum(weight * np.where(there, features, 0.0), axis=0) / weight.sum(axis=0)
    apart = np.where(there, features - mean, 0.0)
    return mean, (weight * apart).T @ apart / (weight.T @ there.astype(float))


def main(folder: Path) -> None:
    """Write the table."""
    found = examples(folder)
    parts, suites = [item.component for item in found], [item.suite for item in found]
    model = learn_kinds(features(found), parts, suites, COMPONENTS)
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(["component", "kind", "spectra", "suites", "feature", "mean", *WINDOWS_NM])
    for name, kind, mean, covariance in zip(model.components, model.kinds, model.mean, model.covariance, strict=True):
        own = [item.suite for item in found if item.component == name]
        for feature, value, row in zip(WINDOWS_NM, mean, covariance, strict=True):
            cells = [name, kind, len(own), len(set(own)), feature, f"{value:.4f}", *(f"{cell:.6f}" for cell in row)]
            out.writerow(cells)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
