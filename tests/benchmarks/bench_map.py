"""Fits of images, neighbours helping: how fast, and how often a pixel alone finds a lower minimum.

`python tests/benchmarks/bench_map.py`. All images are made up (`strips.py`); where LUNARSCI_REFERENCE_DATA is set, also
of measured spectra. Nine bands (OPX-CPX), 85 channels. Rates are of processor time, one core.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")

import argparse
import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np
from strips import EIGHTY_FIVE_NM, MADE_UP, MEASURED, Strip, mixtures, patchwork

from lunarsci.spectra.mgm.batch import FitBatch
from lunarsci.spectra.mgm.fit import fit_arrays
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.region import CONTEST_EVERY, ORIGINS, RegionFits, fit_region

HIGHER = 0.01
"""Of chi-square, a tenth of a standard error: by more than this a minimum counts as another."""
SHOWN = 5


def spent_s() -> float:
    """Processor time of this process, all threads."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def timed(task: Callable[[], FitBatch | RegionFits]) -> tuple[FitBatch | RegionFits, float]:
    begun = spent_s()
    found = task()
    return found, spent_s() - begun


def listed(strip: Strip) -> tuple[np.ndarray, np.ndarray]:
    """Reflectances, (n, c), and places, (n, 2), of all pixels."""
    shape = strip.reflectance.shape[:2]
    return np.maximum(strip.reflectance, 1e-5).reshape(-1, strip.wavelength_nm.size), np.argwhere(np.ones(shape))


def compare(strip: Strip, model: MgmModel, contest_every: int) -> None:
    """One line about an image, and its worst pixels."""
    reflectance, places = listed(strip)
    alone, alone_s = timed(lambda: fit_arrays(strip.wavelength_nm, reflectance, model))
    found, found_s = timed(
        lambda: fit_region(strip.wavelength_nm, reflectance, places, model, contest_every=contest_every)
    )
    above = found.batch.objective - alone.objective
    count = len(above)
    worst = np.argsort(-above)[:SHOWN]
    origins = np.bincount(found.origin, minlength=len(ORIGINS)) / count
    print(
        f"{strip.name:14s} {count / alone_s:7.0f} {count / found_s:7.0f} {100 * (above > HIGHER).mean():8.2f} "
        f"{100 * (above > 1).mean():7.2f} {100 * (above < -HIGHER).mean():8.2f} {100 * (above < -1).mean():7.2f}   "
        + " ".join(f"{100 * share:5.1f}" for share in origins[:3])
        + "   "
        + " ".join(f"{places[k, 1]},{places[k, 0]}:{above[k]:.2g}" for k in worst if above[k] > HIGHER)
    )


def main() -> None:
    """Print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=64, help="lines and samples of each image")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--contest-every", type=int, default=CONTEST_EVERY)
    options = parser.parse_args()
    model, shape = mgm_model("OPX-CPX"), (options.size, options.size)
    warm = mixtures(EIGHTY_FIVE_NM, (8, 8), 0)
    fit_region(warm.wavelength_nm, *listed(warm), model)
    fit_arrays(warm.wavelength_nm, listed(warm)[0], model)
    print(f"{'':14s} {'alone/s':>7s} {'map/s':>7s} {'higher %':>8s} {'by >1':>7s} {'lower %':>8s} {'by >1':>7s}   "
          "single, neighbour, contest %; highest: sample,line:by")  # fmt: skip
    for made in MADE_UP.values():
        compare(made(EIGHTY_FIVE_NM, shape, options.seed), model, options.contest_every)
    if folder := os.environ.get("LUNARSCI_REFERENCE_DATA"):
        for file in MEASURED:
            strip = patchwork(EIGHTY_FIVE_NM, shape, options.seed, Path(folder), file)
            compare(strip, model, options.contest_every)


if __name__ == "__main__":
    main()
