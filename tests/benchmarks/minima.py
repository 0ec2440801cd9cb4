"""Whether fits end in the lowest minimum, beside a search from 200 starts: `python tests/benchmarks/minima.py`.

SYNTHETIC spectra of twelve bands and, where LUNARSCI_REFERENCE_DATA names a folder, spectra of laboratories and of a
rover. Rates are of processor time, one core.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.arrays import FloatArray
from lunarsci.spectra.mgm.fit import fit_arrays
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import MgmModel, mgm_model

EXHAUSTIVE = 200
"""Starts of the search by which others are judged."""
HIGHER = 0.01
"""Of chi-square, a tenth of a standard error: by more than this a minimum counts as another."""
STRENGTH, FACTOR, PRESENT = 0.15, 1.5, 0.8
"""Of a band that is there: ln R, how it varies, and in how many spectra it is."""
MEASURED = ("relab", "meteorites", "minerals", "lunar_soils")
RANGE_NM = (400.0, 2600.0)


def synthetic(model: MgmModel, grid_nm: FloatArray, count: int, noise: float, seed: int) -> FloatArray:
    """Reflectances, (count, n), of bands drawn from the priors on straight continua."""
    rng, m = np.random.default_rng(seed), model.degrees
    root, basis = np.linalg.cholesky(np.linalg.inv(model.precision[m:, m:])), model.basis(grid_nm)
    rows = np.empty((count, grid_nm.size))
    for row in rows:
        point = np.zeros_like(model.prior)
        point[m:] = model.prior[m:] + root @ rng.normal(size=root.shape[0])
        point = np.clip(point, model.lower, model.upper)
        bands = point[m + 2 :: 3].size
        point[m + 2 :: 3] = -STRENGTH * FACTOR ** rng.normal(size=bands) * (rng.random(bands) < PRESENT)
        point[:2] = rng.uniform(0.12, 0.20), rng.uniform(0.0, 0.05)
        found = model_and_jacobian(point, grid_nm / 1e3, basis, model.logarithmic)
        assert found is not None, "this continuum is above 0"
        row[:] = np.exp(found[0] + rng.normal(scale=noise, size=grid_nm.size))
    return rows


def read(path: Path) -> tuple[FloatArray, FloatArray]:
    """Channels, (n,) [nm], and reflectances, (rows, n), of a table with a column for each spectrum."""
    table = pd.read_csv(path)
    wavelength_nm, rows = table.iloc[:, 0].to_numpy(float), table.iloc[:, 1:].to_numpy(float).T
    inside = (wavelength_nm >= RANGE_NM[0]) & (wavelength_nm <= RANGE_NM[1])
    return wavelength_nm[inside], rows[:, inside]


def collections(model: MgmModel, scale: float) -> dict[str, tuple[FloatArray, FloatArray]]:
    """All that is fitted, by name."""
    fine, coarse = np.arange(450.0, 2396.0, 5.0), np.linspace(460.0, 2400.0, 85)
    made = {
        "synthetic, noise 0.005": (fine, synthetic(model, fine, round(900 * scale), 0.005, 1)),
        "synthetic, noise 0.002": (fine, synthetic(model, fine, round(400 * scale), 0.002, 2)),
        "synthetic, 85 channels": (coarse, synthetic(model, coarse, round(300 * scale), 0.005, 3)),
    }
    if folder := os.environ.get("LUNARSCI_REFERENCE_DATA"):
        spectra = Path(folder) / "spectra"
        made |= {name: read(spectra / name / "reflectance.csv") for name in MEASURED}
        made["rover"] = read(spectra / "ce4" / "reflectance_factor.csv")
    return made


def main() -> None:
    """Print a table, and the misses of the default."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="of the number of synthetic spectra")
    options = parser.parse_args()
    model = mgm_model("OL-OPX-CPX", "wavelength")
    print(f"{'':24s} spectra   0 starts/s missed   default/s missed  worst")
    misses, total = [], 0
    for name, (grid_nm, rows) in collections(model, options.scale).items():
        reached, rates = [], []
        fit_arrays(grid_nm, rows[:8], model)
        for starts in (0, 4, EXHAUSTIVE):
            begun = time.process_time()
            reached.append(fit_arrays(grid_nm, rows, model, starts=starts).objective)
            rates.append(len(rows) / (time.process_time() - begun))
        above = [one - np.minimum.reduce(reached) for one in reached]
        quick, missed = (np.flatnonzero(one > HIGHER) for one in above[:2])
        print(
            f"{name:24s} {len(rows):7d}   {rates[0]:10.0f} {quick.size:6d}   {rates[1]:9.0f} {missed.size:6d} "
            f"{above[1].max():6.2f}"
        )
        total += len(rows)
        misses += [f"{name} {row}: {above[1][row]:.2f}" for row in missed]
    print(
        f"of {total} spectra the default misses {len(misses)}, {100 * len(misses) / total:.2f} %: {'; '.join(misses)}"
    )


if __name__ == "__main__":
    main()
