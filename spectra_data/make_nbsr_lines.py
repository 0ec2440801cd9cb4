"""Make `nbsr_calibrations.csv` and `nbsr_likeness.csv` from a reference library: `python make_nbsr_lines.py FOLDER`.

FOLDER holds `relab/reflectance.csv` and `relab/manifest.csv`. The 20 orthopyroxene-clinopyroxene powders of one suite
are fitted as `spectra fit` does; a line through their ratios, and the bands they have along it, are what is kept.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.nbsr import NAMES, band_features, likeness_terms
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers import read_spectra

ASSEMBLAGES = ("OL-OPX-CPX", "OPX-CPX")
POWDERS = r"(XP|PE|PP)-CMP-"
DOMAIN = {"fs_low": 8, "fs_high": 18, "wo_low": 40, "wo_high": 50}


def lines(folder: Path) -> tuple[list[dict[str, object]], list[dict[str, object]]]:
    """Rows of both tables."""
    manifest = pd.read_csv(folder / "relab/manifest.csv").set_index("id")
    manifest = manifest[manifest.index.str.match(POWDERS)]
    spectra = {s.id: s for s in read_spectra(read_input(str(folder / "relab/reflectance.csv")))}
    powders = [spectra[name] for name in manifest.index]
    truth = 100 * manifest["vol_opx"].to_numpy() / (manifest["vol_opx"] + manifest["vol_cpx"]).to_numpy()
    calibrations, likeness = [], []
    for assemblage in ASSEMBLAGES:
        fits = [fit for fit in fit_spectra(powders, mgm_model(assemblage)) if isinstance(fit, MgmFit)]
        ratio = np.array([fit.nbsr["um2"].opx for fit in fits])  # type: ignore[union-attr]
        features = pd.DataFrame([band_features(fit) for fit in fits])
        depth = features["um1_depth"].to_numpy()
        slope, offset = np.polyfit(ratio, truth, 1)
        sd = np.sqrt(np.sum((truth - slope * ratio - offset) ** 2) / (truth.size - 2))
        key = {"name": "opx-cpx", "assemblage": assemblage}
        line = {"region": "um2", "slope_percent": slope, "offset_percent": offset, "sd_percent": sd}
        ends = {"depth_low": depth.min(), "depth_high": depth.max()}
        calibrations.append(key | line | DOMAIN | ends)
        terms = likeness_terms(ratio, depth)
        for name in NAMES:
            values = features[name].to_numpy()
            law = np.linalg.lstsq(terms, values, rcond=None)[0]
            scatter = np.sqrt(np.sum((values - terms @ law) ** 2) / (values.size - law.size))
            likeness.append(key | {"feature": name} | {f"c{k}": c for k, c in enumerate(law)} | {"sd": scatter})
    return calibrations, likeness


def main() -> None:
    """Write both tables beside this file."""
    found = lines(Path(sys.argv[1]))
    for name, rows in zip(("nbsr_calibrations.csv", "nbsr_likeness.csv"), found, strict=True):
        text = pd.DataFrame(rows).to_csv(index=False, float_format="%.5g")
        (Path(__file__).parent / name).write_text(text)


if __name__ == "__main__":
    main()
