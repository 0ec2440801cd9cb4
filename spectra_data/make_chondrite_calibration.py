"""Make `chondrite_calibration.csv`: `python make_chondrite_calibration.py FOLDER > chondrite_calibration.csv`.

FOLDER holds `meteorites/reflectance.csv` and `meteorites/manifest.csv`. The table keeps the law, and how it did on
sample series left out together with all other spectra of their rocks, beside the regressions of Dunn et al. (2010) and
the constant, the mean of the rocks learned from; no spectrum.
"""

import csv
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.arrays import FloatArray
from lunarsci.io.inputs import read_input
from lunarsci.spectra.bands import measure_batch
from lunarsci.spectra.chemistry.bands import BANDS, COMPOSITION, bands_of_chondrites, learn_law
from lunarsci.spectra.chemistry.plane import regressions
from lunarsci.spectra.readers import read_spectra

UNITS = ("nm", "1", "mol %", "mol %", "1")
DUNN = dict(zip(COMPOSITION, ("fa_dunn", "fs_dunn", "ol_dunn"), strict=True))


def chondrites(folder: Path) -> pd.DataFrame:
    """Ordinary chondrites by id: bands, their errors (`_error`), composition, `rock`, `group`, `suite`, and Dunn's.

    A chondrite without orthopyroxene in its stated modes is left out: there is none (DP-JNG-016).
    """
    about = pd.read_csv(folder / "meteorites/manifest.csv").set_index("id")
    about = about[(about["type"] == "Ordinary Chondrite") & (about["vol_opx"] > 0)]
    spectra = read_spectra(read_input(str(folder / "meteorites/reflectance.csv")))
    found = measure_batch([one for one in spectra if one.id in about.index], continuum_name="hull").arrays.bands
    bands, errors = bands_of_chondrites(found)
    names = [one.id for one in spectra if one.id in about.index]
    rows = pd.DataFrame(np.hstack([bands, errors]), index=names, columns=[*BANDS, *(f"{key}_error" for key in BANDS)])
    about = about.loc[names]
    rows["fa"], rows["fs"] = 100 * about["fa"], 100 * about["opx_fs"]
    rows["ol_share"] = about["vol_ol"] / (about["vol_ol"] + about["vol_opx"] + about["vol_cpx"])
    rows["rock"] = [re.split(r" (?:M-|\(|powder)", name)[0] for name in about["name"]]
    rows["group"] = about["subtype"].str.extract(r"^(H|LL|L)")[0]
    rows["suite"] = [re.match(r"\w+-\w+", name)[0] for name in names]
    rows["bc1000"], rows["bar"] = found["1000"].center_nm, np.exp(rows["ln_area_ratio"])
    published = {key: regressions()[key] for key in DUNN.values()}
    return rows.assign(**{key: line.value(rows[line.predictor]) for key, line in published.items()})


def left_out(rows: pd.DataFrame) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Composition, its standard error and the constant, (n, 3) each, with suite and all of its rocks left out."""
    value, error, constant = (np.full((len(rows), len(COMPOSITION)), np.nan) for _ in range(3))
    for suite in rows["suite"].unique():
        out = (rows["suite"] == suite).to_numpy()
        rest = rows[~rows["rock"].isin(rows.loc[out, "rock"])]
        law = learn_law(rest[[*BANDS, *COMPOSITION]].to_numpy(), list(rest["rock"]), list(rest["group"]))
        errors = rows.loc[out, [f"{key}_error" for key in BANDS]].to_numpy()
        value[out], error[out] = law.composition(rows.loc[out, list(BANDS)].to_numpy(), errors)
        constant[out] = rest.groupby("rock")[list(COMPOSITION)].mean().mean().to_numpy()
    return value, error, constant


def main(folder: Path) -> None:
    """Write the table."""
    rows = chondrites(folder)
    law = learn_law(rows[[*BANDS, *COMPOSITION]].to_numpy(), list(rows["rock"]), list(rows["group"]))
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(["quantity", "unit", "mean", *BANDS, *COMPOSITION, *judged(rows).columns])
    for place, name in enumerate((*BANDS, *COMPOSITION)):
        numbers = [law.mean[place], *law.covariance[place]]
        beside = [f"{value:.4f}" for value in judged(rows).loc[name]] if name in COMPOSITION else [""] * 4
        out.writerow([name, UNITS[place], *(f"{number:.6g}" for number in numbers), *beside])


def judged(rows: pd.DataFrame) -> pd.DataFrame:
    """By quantity the rms of the law and of the constant on series left out, Dunn's, and within 2 errors of the law."""
    value, error, constant = left_out(rows)
    truth, published = (rows[list(names)].to_numpy() for names in (COMPOSITION, DUNN.values()))
    found = {
        "rms_left_out": _rms(value - truth),
        "rms_constant": _rms(constant - truth),
        "rms_dunn": _rms(published - truth),
        "within_2_sigma": np.mean(np.abs(value - truth) < 2 * error, axis=0),
    }
    return pd.DataFrame(found, index=COMPOSITION)


def _rms(errors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
