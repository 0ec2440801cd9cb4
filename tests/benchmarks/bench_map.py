"""Fits of images, neighbours helping: how fast, beside what else, and how often a pixel alone finds a lower minimum.

`python tests/benchmarks/bench_map.py`, with `--strip LINES` for a strip of 304 samples from file to file as well. All
images are made up (`strips.py`); where LUNARSCI_REFERENCE_DATA is set, also of measured spectra. Nine bands
(OPX-CPX), 85 channels. Rates are of processor time, one core.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from bench_mgm import NOISE, Problem, lmfit_rate, scipy_rate
from strips import EIGHTY_FIVE_NM, MADE_UP, MEASURED, Strip, mixtures, patchwork

from lunarsci.spectra.mgm.batch import FitBatch
from lunarsci.spectra.mgm.fit import fit_arrays, starting_points
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.region import CONTEST_EVERY, ORIGINS, RegionFits, fit_region

HIGHER = 0.01
"""Of chi-square, a tenth of a standard error: by more than this a minimum counts as another."""
SAMPLES = 304
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
    above = found.batch.objective - alone.objective  # type: ignore[union-attr]
    count = len(above)
    worst = np.argsort(-above)[:SHOWN]
    origins = np.bincount(found.origin, minlength=len(ORIGINS)) / count  # type: ignore[union-attr]
    print(
        f"{strip.name:14s} {count / alone_s:7.0f} {count / found_s:7.0f} {100 * (above > HIGHER).mean():8.2f} "
        f"{100 * (above > 1).mean():7.2f} {100 * (above < -HIGHER).mean():8.2f} {100 * (above < -1).mean():7.2f}   "
        + " ".join(f"{100 * share:5.1f}" for share in origins[:3])
        + "   "
        + " ".join(f"{places[k, 1]},{places[k, 0]}:{above[k]:.2g}" for k in worst if above[k] > HIGHER)
    )


def others(strip: Strip, model: MgmModel, count: int) -> None:
    """Rates of lmfit and scipy on some pixels, noise and model error as one."""
    reflectance, _ = listed(strip)
    data = np.log(reflectance[:: len(reflectance) // count][:count])
    data -= data.mean(axis=1)[:, None]
    case = Problem(model, strip.wavelength_nm, data, starting_points(model, data, 1)[0])
    exact, error = np.full(data.shape, 1e-9), NOISE
    own, own_s = timed(partial(fit_arrays, strip.wavelength_nm, np.exp(data), model, sigma=exact, model_error=error))
    for name, (rate, reached) in {
        "lmfit, a pixel at a time": lmfit_rate(case, count, analytic=False),
        "scipy least_squares, our derivatives": scipy_rate(case, count),
        "fit_arrays, all starts and hops": (count / own_s, own.objective),  # type: ignore[union-attr]
    }.items():
        off = np.asarray(reached) - own.objective  # type: ignore[union-attr]
        print(f"{name:40s} {rate:9.1f} fits/s   higher than fit_arrays in {100 * (off > HIGHER).mean():.0f} %")


def write_strip(path: Path, lines: int) -> None:
    """An ENVI file of a made-up strip, band interleaved by line, 32 bits; its name says what it is."""
    with path.open("wb") as file:
        for first in range(0, lines, 512):
            part = mixtures(EIGHTY_FIVE_NM, (min(512, lines - first), SAMPLES), seed=first, length=40.0)
            file.write(np.maximum(part.reflectance, 1e-5).transpose(0, 2, 1).astype("<f4").tobytes())
    numbers = ", ".join(f"{value:.4f}" for value in EIGHTY_FIVE_NM)
    path.with_suffix(".hdr").write_text(
        f"ENVI\ndescription = {{SYNTHETIC mixtures}}\nsamples = {SAMPLES}\nlines = {lines}\n"
        f"bands = {EIGHTY_FIVE_NM.size}\nheader offset = 0\nfile type = ENVI Standard\ndata type = 4\n"
        f"interleave = bil\nbyte order = 0\nwavelength units = Nanometers\nwavelength = {{{numbers}}}\n"
    )


def map_strip(lines: int, options: list[str]) -> None:
    """`spectra map` from file to file."""
    with tempfile.TemporaryDirectory() as folder:
        cube, target = Path(folder) / "SYNTHETIC.img", Path(folder) / "maps.nc"
        write_strip(cube, lines)
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        subprocess.run(
            [sys.executable, "-m", "lunarsci.cli", "spectra", "map", cube, "-o", target, "--products", "fit",
             "--assemblage", "OPX-CPX", "--memory", "1GB", "-q", *options],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        wall_s, used = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
        count = lines * SAMPLES
        print(
            f"spectra map of {SAMPLES} x {lines} x {EIGHTY_FIVE_NM.size}: {wall_s:.0f} s, {cpu_s:.0f} s of processor "
            f"time, {count / cpu_s:.0f} pixels/s and core, {used.ru_maxrss / 2**20:.2f} GB at most, "
            f"{target.stat().st_size / 1e6:.0f} MB written; 10,000 lines: {cpu_s * 10_000 / lines:.0f} s of it"
        )


def main() -> None:
    """Print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=64, help="lines and samples of each image")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--slow", type=int, default=20, help="pixels for lmfit and scipy")
    parser.add_argument("--contest-every", type=int, default=CONTEST_EVERY)
    parser.add_argument("--strip", type=int, default=0, metavar="LINES", help="of a strip from file to file")
    options, more = parser.parse_known_args()
    model, shape = mgm_model("OPX-CPX"), (options.size, options.size)
    warm = mixtures(EIGHTY_FIVE_NM, (8, 8), 0)
    fit_region(warm.wavelength_nm, *listed(warm), model)
    fit_arrays(warm.wavelength_nm, listed(warm)[0], model)
    if options.slow:
        others(mixtures(EIGHTY_FIVE_NM, shape, options.seed), model, options.slow)
    print(f"{'':14s} {'alone/s':>7s} {'map/s':>7s} {'higher %':>8s} {'by >1':>7s} {'lower %':>8s} {'by >1':>7s}   "
          "single, neighbour, contest %; highest: sample,line:by")  # fmt: skip
    for made in MADE_UP.values():
        compare(made(EIGHTY_FIVE_NM, shape, options.seed), model, options.contest_every)
    if folder := os.environ.get("LUNARSCI_REFERENCE_DATA"):
        for file in MEASURED:
            strip = patchwork(EIGHTY_FIVE_NM, shape, options.seed, Path(folder), file)
            compare(strip, model, options.contest_every)
    if options.strip:
        map_strip(options.strip, more)


if __name__ == "__main__":
    main()
