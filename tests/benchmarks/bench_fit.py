"""Fits from file to file beside the kernel alone: `python tests/benchmarks/bench_fit.py`.

SYNTHETIC spectra of 390 channels (those of `bench_mgm.py`) are fitted from a CSV, to a CSV and to JSON, and by
the kernel alone with the same model, weights, starts and hops, all in this process and after a first run has loaded
what there is to load. CPU seconds of all threads count, so that other work on the machine does not.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from bench_mgm import problem
from lunarsci.cli import main as main_of_lunarsci

from lunarsci.spectra.mgm.data import prepare_rows
from lunarsci.spectra.mgm.fit import MAX_ITERATIONS, TOLERANCE, fit_batch, hops_of, starting_points
from lunarsci.spectra.mgm.model import mgm_model

WARM = 200
"""Spectra of a first run: so many that all compiled code is loaded."""


def cpu_seconds() -> float:
    """Of this process and all its threads."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def seconds(task: Callable[[], object]) -> tuple[float, float]:
    """CPU and wall seconds."""
    cpu, wall = cpu_seconds(), time.perf_counter()
    task()
    return cpu_seconds() - cpu, time.perf_counter() - wall


def run(*arguments: str) -> None:
    """One command of the command line, in this process."""
    if (code := main_of_lunarsci(["spectra", "fit", *arguments, "-q"])) not in (0, 3):
        raise SystemExit(code)


def kernel(data: np.ndarray, wavelength_nm: np.ndarray, starts: int) -> Callable[[], object]:
    """The kernel alone on ln R and weights that are there already, as the command asks for it."""
    model, rows = mgm_model(), prepare_rows(wavelength_nm, np.exp(data))
    shifted = np.log(rows.reflectance)
    shifted -= shifted.mean(axis=1)[:, None]
    points = starting_points(model, shifted, starts)
    return lambda: fit_batch(
        shifted, rows.weight, wavelength_nm / 1e3, model.basis(wavelength_nm), model.logarithmic, model.prior,
        model.precision, model.lower, model.upper, points, hops_of(model), TOLERANCE, MAX_ITERATIONS,
    )  # fmt: skip


def rates(count: int, starts: int) -> dict[str, tuple[float, float]]:
    """CPU and wall seconds of each way."""
    case = problem(390, count, seed=5)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part, kept in (("some", WARM), ("all", count)):
            table = pd.DataFrame(np.exp(case.data[:kept]).T, columns=[f"s{k}" for k in range(kept)])
            table.insert(0, "wavelength_nm", case.wavelength_nm)
            table.to_csv(folder / f"{part}.csv", index=False)
        common = ("--starts", str(starts), "-o")
        for suffix in ("csv", "json"):
            run(str(folder / "some.csv"), *common, str(folder / f"first.{suffix}"))
        return {
            "kernel alone": seconds(kernel(case.data, case.wavelength_nm, starts)),
            "CSV to CSV": seconds(lambda: run(str(folder / "all.csv"), *common, str(folder / "out.csv"))),
            "CSV to JSON": seconds(lambda: run(str(folder / "all.csv"), *common, str(folder / "out.json"))),
        }


def main() -> None:
    """Print the rates, and what share of the kernel's a user gets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--spectra", type=int, default=2000)
    parser.add_argument("--starts", type=int, default=4)
    options = parser.parse_args()
    found = rates(options.spectra, options.starts)
    base = found["kernel alone"]
    print(f"{options.spectra} SYNTHETIC spectra of 390 channels, OL-OPX-CPX, {options.starts} starts and all hops")
    print(f"{'':14s} {'CPU [s]':>8s} {'a CPU s':>8s} {'of kernel':>10s} {'wall [s]':>9s} {'of kernel':>10s}")
    for name, (cpu, wall) in found.items():
        share = (f"{100 * base[0] / cpu:.0f} %", f"{100 * base[1] / wall:.0f} %")
        print(f"{name:14s} {cpu:8.2f} {options.spectra / cpu:8.0f} {share[0]:>10s} {wall:9.2f} {share[1]:>10s}")


if __name__ == "__main__":
    main()
