"""Make `soil_normative.csv` from reference spectra: `python make_normative.py FOLDER > soil_normative.csv`.

FOLDER holds `lunar_soils/reflectance.csv` and `lunar_soils/chemistry.csv`. The table keeps coefficients, no soil.
"""

import csv
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.arrays import FloatArray
from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.normative import (
    FEATURES,
    SODA_WT,
    learn_regression,
    plagioclase_norm_wt,
    soil_features,
)
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

MISSION_OF_ROW = ("a14", "a14", "a16", "a16", "a16", "a11", "a12", "a15", "a17", "a17", "luna16")
"""In the order of the table: identified by their oxides, Lunar Sample Compendium."""
SODA_A14_WT = 0.65
"""Na2O of Apollo 14, assumed. [wt %]"""


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
        whole = [f"{law.sigma:.4f}", f"{law.freedom:g}", f"{law.farthest:.5f}"]
        for row, key in enumerate(("constant", *keys)):
            scale = (law.mean[row - 1], law.scale[row - 1]) if row else (0.0, 1.0)
            numbers = [*scale, law.coefficients[row], *law.spread[row]]
            out.writerow([name, key, *(f"{value:.6f}" for value in numbers), *(whole if not row else ["", "", ""])])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
