"""Make `nbsr_calibrations.csv` from a reference library: `python make_nbsr_calibration.py FOLDER`.

FOLDER holds `relab`, `minerals` and `meteorites`, each with `reflectance.csv` and `manifest.csv`. All spectra with
pyroxene are fitted as `spectra fit` does. What is kept is the scale of the ratio's error, and how often intervals hold
of sample series that were left out.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.stats import t as student

from lunarsci.arrays import FloatArray
from lunarsci.io.inputs import read_input
from lunarsci.spectra.abundance.nbsr import FREEDOM
from lunarsci.spectra.abundance.shares import GOOD, LIKELY
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers import read_spectra

ASSEMBLAGES = ("OL-OPX-CPX", "OPX-CPX")
LEAST = 0.1
"""Share of pyroxene from which a spectrum is taken."""


def known(folder: Path, assemblage: str) -> pd.DataFrame:
    """Ratio, orthopyroxene's share of pyroxene, and sample series of each spectrum, by id."""
    parts = []
    for name in ("relab", "minerals", "meteorites"):
        manifest = pd.read_csv(folder / name / "manifest.csv").set_index("id")
        pyroxene = manifest["vol_opx"] + manifest["vol_cpx"]
        share = (manifest["vol_opx"] / pyroxene)[pyroxene > LEAST]
        spectra = [one for one in read_spectra(read_input(str(folder / name / "reflectance.csv"))) if one.id in share]
        fits = [fit for fit in fit_spectra(spectra, mgm_model(assemblage)) if isinstance(fit, MgmFit)]
        ratio = {fit.id: fit.nbsr["um2"].opx for fit in fits if fit.nbsr["um2"]}
        sigma = {fit.id: fit.nbsr["um2"].sigma for fit in fits if fit.nbsr["um2"]}
        parts.append(pd.DataFrame({"ratio": ratio, "sigma": sigma, "share": share}).dropna())
    found = pd.concat(parts)
    series = found.index.str.split("-").str[:2].str.join("-")
    return found.assign(series=series.str.replace(r"^(pomix|MIX|OOC|PYX).*", "laboratory mixtures", regex=True))


def scale_law(taken: pd.DataFrame) -> FloatArray:
    """c0 and c1 of the likeliest errors; each series weighs as the root of its number of spectra."""
    weight = 1 / np.sqrt(taken.groupby("series")["share"].transform("size"))
    error = (taken["share"] - taken["ratio"]).to_numpy()

    def cost(law: FloatArray) -> float:
        return -float(np.sum(weight * student.logpdf(error, FREEDOM, scale=scale(law, taken))))

    return np.asarray(minimize(cost, [-3.0, 2.0], method="Nelder-Mead").x)


def scale(law: FloatArray, taken: pd.DataFrame) -> FloatArray:
    """Of the errors, those of the ratios among them."""
    ratio, sigma = taken["ratio"].to_numpy(), taken["sigma"].to_numpy()
    return np.hypot(np.exp(law[0] + law[1] * 4 * ratio * (1 - ratio)), sigma)


def left_out(found: pd.DataFrame) -> dict[str, float]:
    """How often intervals hold, and how good shares in domain are, each series by a law that others made."""
    error, scales = (found["share"] - found["ratio"]).abs().to_numpy(), np.empty(len(found))
    for series in found["series"].unique():
        own = (found["series"] == series).to_numpy()
        scales[own] = scale(scale_law(found[~own]), found[own])
    inside = 2 * student.cdf(GOOD / scales, FREEDOM) - 1 >= LIKELY
    held = {f"held_{level}": float(np.mean(error < scales * student.ppf(0.5 + level / 200, FREEDOM)))
            for level in (68, 95)}  # fmt: skip
    return held | {"in_domain": float(inside.mean()), "good_of_these": float((error < GOOD)[inside].mean())}


def main() -> None:
    """Write the table beside this file."""
    rows = []
    for assemblage in ASSEMBLAGES:
        found = known(Path(sys.argv[1]), assemblage)
        law = dict(zip(("ln_scale", "ln_scale_of_pairs"), scale_law(found), strict=True))
        counts = {"spectra": len(found), "series": found["series"].nunique()}
        rows.append({"assemblage": assemblage} | law | counts | left_out(found) | {"source": "nbsr-calibration"})
    text = pd.DataFrame(rows).to_csv(index=False, float_format="%.4g")
    (Path(__file__).parent / "nbsr_calibrations.csv").write_text(text)


if __name__ == "__main__":
    main()
