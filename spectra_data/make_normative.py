"""Make `soil_normative.csv` from reference spectra: `python make_normative.py FOLDER > soil_normative.csv`.

FOLDER holds `lunar_soils/reflectance.csv` and `lunar_soils/chemistry.csv`. The table keeps coefficients, no soil.
"""

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.arrays import FloatArray
from lunarsci.io.inputs import read_input
from lunarsci.spectra.abundance.normative import (
    FEATURES,
    SoilRegression,
    soil_features,
)
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

MISSION_OF_ROW = ("a14", "a14", "a16", "a16", "a16", "a11", "a12", "a15", "a17", "a17", "luna16")
"""In the order of the table: identified by their oxides, Lunar Sample Compendium."""
SODA_A14_WT = 0.65
"""Na2O of Apollo 14, assumed. [wt %]"""
RIDGE = 0.3
"""In units of a mission's mean weight; assumed."""
MOLAR_MASS = {"sio2": 60.084, "tio2": 79.866, "al2o3": 101.961, "feo": 71.844, "mgo": 40.304, "cao": 56.077,
              "na2o": 61.979}  # fmt: skip
"""Of the oxides, from the atomic weights of the IUPAC: Meija et al. (2016), Pure Appl. Chem. 88, 265,
10.1515/pac-2015-0305. [g/mol]"""
SODA_WT = 0.45
"""Na2O of a soil where it is not stated; assumed. [wt %]"""


def plagioclase_norm_wt(al2o3_wt: FloatArray | float, na2o_wt: FloatArray | float = SODA_WT) -> FloatArray:
    """Plagioclase of the norm, all alumina in it and none in pyroxene. [wt % of the soil]

    An = Al2O3 - Na2O and Ab = 2 Na2O in mol, weighed: 2.73 Al2O3 + 3.97 Na2O.
    """
    soda = np.asarray(na2o_wt) / MOLAR_MASS["na2o"]
    anorthite = np.asarray(al2o3_wt) / MOLAR_MASS["al2o3"] - soda
    an = MOLAR_MASS["cao"] + MOLAR_MASS["al2o3"] + 2 * MOLAR_MASS["sio2"]
    ab = (MOLAR_MASS["na2o"] + MOLAR_MASS["al2o3"] + 6 * MOLAR_MASS["sio2"]) / 2
    return np.asarray(anorthite * an + 2 * soda * ab)


def learn_regression(features: FloatArray, values: FloatArray, missions: Sequence[str], names: Sequence[str]
                     ) -> SoilRegression:  # fmt: skip
    """Ridge regression of values (n,) on features (n, f); a mission of m soils counts as sqrt(m) of them.

    Its error is that of soils whose mission is left out.
    """
    own = np.array(missions)
    square = []
    for mission in np.unique(own):
        out = own == mission
        found, far = _ridge(features[~out], values[~out], own[~out], names).at(features[out])
        square.extend((values[out] - found) ** 2 / (1.0 + far))
    law = _ridge(features, values, own, names)
    freedom = np.unique(own).size - len(names) - 1.0
    parts = (law.features, law.mean, law.scale, law.coefficients, law.spread)
    return SoilRegression(*parts, float(np.sqrt(np.mean(square))), freedom, float(law.at(features)[1].max()))


def _ridge(features: FloatArray, values: FloatArray, missions: FloatArray, names: Sequence[str]) -> SoilRegression:
    mean, scale = features.mean(axis=0), features.std(axis=0)
    _, place, count = np.unique(missions, return_inverse=True, return_counts=True)
    weight = count[place] ** -0.5
    weight /= weight.mean()
    design = np.column_stack([np.ones(len(values)), (features - mean) / scale])
    penalty = RIDGE * np.diag([0.0, *np.ones(features.shape[1])])
    spread = np.linalg.inv((design.T * weight) @ design + penalty)
    coefficients = spread @ (design.T * weight) @ values
    return SoilRegression(tuple(names), mean, scale, coefficients, spread, 0.0, 0.0, 0.0)


def soils(folder: Path) -> tuple[list[Spectrum], pd.DataFrame]:
    """Spectra, and what is known of each: `mission`, the oxides, `plagioclase_wt` of the norm."""
    spectra = list(read_spectra(read_input(str(folder / "lunar_soils/reflectance.csv"))))
    known = pd.read_csv(folder / "lunar_soils/chemistry.csv").set_index("id").loc[[item.id for item in spectra]]
    known["mission"] = list(MISSION_OF_ROW)
    known["na2o_wt"] = np.where(known["mission"] == "a14", SODA_A14_WT, SODA_WT)
    known["plagioclase_wt"] = plagioclase_norm_wt(known["al2o3_wt"].to_numpy(), known["na2o_wt"].to_numpy())
    return spectra, known


def table_of(spectra: list[Spectrum]) -> dict[str, FloatArray]:
    """Features of each quantity, (n, f)."""
    found = [soil_features(item) for item in spectra]
    return {name: np.array([[item[key] for key in keys] for item in found]) for name, keys in FEATURES.items()}


def main(folder: Path) -> None:
    """Write the table."""
    spectra, known = soils(folder)
    features = table_of(spectra)
    out = csv.writer(sys.stdout, lineterminator="\n")
    head = ["quantity", "feature", "mean", "scale", "coefficient", "spread_0", "spread_1", "spread_2"]
    out.writerow([*head, "sigma", "freedom", "farthest"])
    for name, keys in FEATURES.items():
        law = learn_regression(features[name], known[name].to_numpy(), list(known["mission"]), keys)
        whole = [f"{law.sigma:.4f}", f"{law.freedom:g}", f"{1.001 * law.farthest:.5f}"]  # more than rounding takes
        for row, key in enumerate(("constant", *keys)):
            scale = (law.mean[row - 1], law.scale[row - 1]) if row else (0.0, 1.0)
            numbers = [*scale, law.coefficients[row], *law.spread[row]]
            out.writerow([name, key, *(f"{value:.6f}" for value in numbers), *(whole if not row else ["", "", ""])])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
