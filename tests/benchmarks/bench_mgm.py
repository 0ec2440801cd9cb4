"""Speed and success of the MGM kernel beside lmfit and scipy: `python tests/benchmarks/bench_mgm.py`.

Nine bands on a straight continuum (olivine, two pyroxenes, two bands of the visible and ultraviolet), truths drawn from
the priors with every band present (strength 0.15, factor 1.5 either way), noise 0.005 in ln R, priors and bounds in
every method, covariance included. Single threads; all rates are those of one core, in its own time.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import lmfit
import numpy as np
from scipy.optimize import least_squares

from lunarsci.compiled import set_threads
from lunarsci.spectra.mgm.batch import problem_of
from lunarsci.spectra.mgm.fit import fit_batch, hops_of, starting_points
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA, model_and_jacobian
from lunarsci.spectra.mgm.levenberg_marquardt import Channels
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.multistart import KernelFits

NOISE = 0.005
NINE = ("uv", "visible_2", "ol_m1_1", "ol_m2", "ol_m1_2", "opx_1", "opx_2", "cpx_1", "cpx_2")
TOLERANCE = 1e-2
"""Expected decrease of the objective, in chi-square, at which a fit has converged: a tenth of a standard error."""
STRENGTH, STRENGTH_FACTOR = 0.15, 1.5
RELATIVE = 1e-3
GRIDS = {390: np.arange(450.0, 2396.0, 5.0), 85: np.linspace(460.0, 2400.0, 85)}


@dataclass(frozen=True)
class Problem:
    """Spectra in ln R, the model, and one start each."""

    model: MgmModel
    wavelength_nm: np.ndarray
    data: np.ndarray
    start: np.ndarray

    @property
    def basis(self) -> np.ndarray:
        return self.model.basis(self.wavelength_nm)


def nine_bands() -> MgmModel:
    """Olivine, two pyroxenes, and two of the three bands that belong to no mineral."""
    whole = mgm_model("OL-OPX-CPX", "wavelength")
    bands = tuple(band for band in whole.assemblage.bands if band.key in NINE)
    keep = np.array([name[1:].isdigit() or name.startswith(NINE) for name in whole.names])
    return replace(
        whole,
        assemblage=replace(whole.assemblage, bands=bands),
        names=tuple(np.array(whole.names)[keep]),
        prior=whole.prior[keep],
        precision=whole.precision[np.ix_(keep, keep)],
        lower=whole.lower[keep],
        upper=whole.upper[keep],
    )


def problem(channels: int, count: int, seed: int = 0) -> Problem:
    """Simulated spectra of known bands."""
    model, grid, rng = nine_bands(), GRIDS[channels], np.random.default_rng(seed)
    m = model.degrees
    root = np.linalg.cholesky(np.linalg.inv(model.precision[m:, m:]))
    data = np.empty((count, grid.size))
    for row in data:
        point = model.prior.copy()
        point[m:] += root @ rng.normal(size=root.shape[0])
        point = np.clip(point, model.lower, model.upper)
        point[m + 2 :: 3] = -STRENGTH * STRENGTH_FACTOR ** rng.normal(size=point[m + 2 :: 3].size)
        point[:m] = rng.uniform(0.12, 0.20), rng.uniform(0.0, 0.05)
        found = model_and_jacobian(point, grid / 1e3, model.basis(grid), model.logarithmic)
        row[:] = found[0] + rng.normal(scale=NOISE, size=grid.size)
    return Problem(model, grid, data, starting_points(model, data, 1)[0])


def objective_rows(case: Problem, number: int) -> tuple[Callable, Callable]:
    """Residuals and Jacobian of data and prior rows, as a user of lmfit or scipy would write them in NumPy."""
    model, x, basis, data = case.model, case.wavelength_nm / 1e3, case.basis, case.data[number]
    m, root = model.degrees, np.linalg.cholesky(model.precision[model.degrees :, model.degrees :]).T

    def residual(point: np.ndarray) -> np.ndarray:
        bands = point[m:].reshape(-1, 3)
        shapes = np.exp(-0.5 * ((x - bands[:, :1]) * FWHM_OVER_SIGMA / bands[:, 1:2]) ** 2)
        ln = np.log(np.maximum(basis @ point[:m], 1e-9)) + bands[:, 2] @ shapes
        return np.concatenate([(ln - data) / NOISE, root @ (point - model.prior)[m:]])

    def jacobian(point: np.ndarray) -> np.ndarray:
        bands, continuum = point[m:].reshape(-1, 3), np.maximum(basis @ point[:m], 1e-9)
        z = (x - bands[:, :1]) * FWHM_OVER_SIGMA / bands[:, 1:2]
        shapes = np.exp(-0.5 * z**2)
        rows = np.empty((x.size + root.shape[0], point.size))
        rows[: x.size, :m] = basis / continuum[:, None] / NOISE
        rows[: x.size, m::3] = (bands[:, 2:] * shapes * z * FWHM_OVER_SIGMA / bands[:, 1:2]).T / NOISE
        rows[: x.size, m + 1 :: 3] = (bands[:, 2:] * shapes * z**2 / bands[:, 1:2]).T / NOISE
        rows[: x.size, m + 2 :: 3] = shapes.T / NOISE
        rows[x.size :] = 0.0
        rows[x.size :, m:] = root
        return rows

    return residual, jacobian


def lmfit_rate(case: Problem, count: int, analytic: bool) -> tuple[float, np.ndarray]:
    """Fits per second by lmfit's default method with bounds, and the objectives reached."""
    reached, begun = [], time.process_time()
    for number in range(count):
        residual, jacobian = objective_rows(case, number)
        parameters = lmfit.Parameters()
        for k, value in enumerate(case.start[number]):
            parameters.add(f"p{k}", value=value, min=case.model.lower[k], max=case.model.upper[k])

        def values(current: lmfit.Parameters) -> np.ndarray:
            return np.array([current[f"p{k}"].value for k in range(case.start.shape[1])])

        options = {"Dfun": lambda current: jacobian(values(current)), "col_deriv": 0} if analytic else {}  # noqa: B023
        fit = lmfit.minimize(lambda current: residual(values(current)), parameters, scale_covar=False, **options)  # noqa: B023
        reached.append(fit.chisqr)
    return count / (time.process_time() - begun), np.array(reached)


def scipy_rate(case: Problem, count: int) -> tuple[float, np.ndarray]:
    """Fits per second by scipy's trust-region method with our derivatives and bounds, and the objectives reached."""
    reached, begun = [], time.process_time()
    for number in range(count):
        residual, jacobian = objective_rows(case, number)
        start = np.clip(case.start[number], case.model.lower + 1e-9, case.model.upper - 1e-9)
        fit = least_squares(residual, start, jac=jacobian, bounds=(case.model.lower, case.model.upper), x_scale="jac")
        np.linalg.pinv(fit.jac.T @ fit.jac)
        reached.append(2 * fit.cost)
    return count / (time.process_time() - begun), np.array(reached)


def kernel_rate(case: Problem, starts: int, hops: np.ndarray) -> tuple[float, np.ndarray]:
    """Fits per second by the kernel in one thread, and the objectives reached."""
    set_threads(1)
    columns, root = np.ascontiguousarray(case.basis.T)[None], np.full(case.data.shape, 1 / NOISE)
    spectra, problem = Channels(case.wavelength_nm[None] / 1e3, columns, case.data, root), problem_of(case.model)
    points = starting_points(case.model, case.data, starts)

    def fit(rows: slice) -> KernelFits:
        return fit_batch(spectra.part(rows), problem, points[:, rows], hops, TOLERANCE, 1000)

    fit(slice(0, 2))
    begun = time.process_time()
    found = fit(slice(None))
    return len(case.data) / (time.process_time() - begun), found.objective


def dgemm_rate(size: int = 1024) -> float:
    """Floating-point operations per second of this machine's matrix product, one thread."""
    a = np.random.default_rng(0).normal(size=(size, size))
    best = min(_timed(lambda: a @ a) for _ in range(5))
    return 2 * size**3 / best


def _timed(task: Callable[[], object]) -> float:
    begun = time.process_time()
    task()
    return time.process_time() - begun


def main() -> None:
    """Print one table per number of channels."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--spectra", type=int, default=2000, help="for the kernel")
    parser.add_argument("--slow", type=int, default=30, help="spectra for lmfit and scipy")
    options = parser.parse_args()
    peak = dgemm_rate()
    print(f"dgemm, one thread: {peak / 1e9:.1f} GFLOP/s")
    for channels in GRIDS:
        report(channels, options.spectra, options.slow, peak)


def near_1_um(model: MgmModel) -> np.ndarray:
    """Hops of the mineral bands that overlap at 1 um, each deeper by the same as in `hops_of`."""
    bands = [k for k, band in enumerate(model.assemblage.bands) if band.region == "um1"]
    return np.array([hop for hop in hops_of(model) if (hop[0] - model.degrees - 2) / 3 in bands])


def report(channels: int, count: int, slow: int, peak: float) -> None:
    """Rates and success of every method; success is measured against the lowest objective that any method found."""
    case = problem(channels, count)
    hops = hops_of(case.model)
    few = hops[[int(h) for h in range(len(hops)) if hops[h, 0] % 3 == (case.model.degrees + 2) % 3]]
    rows = {
        "lmfit, numerical derivatives": lmfit_rate(case, slow, analytic=False),
        "lmfit, our derivatives": lmfit_rate(case, slow, analytic=True),
        "scipy least_squares, our derivatives": scipy_rate(case, slow),
        "kernel, 1 start": kernel_rate(case, 1, np.empty((0, 2))),
        "kernel, 1 start, bands at 1 um deeper": kernel_rate(case, 1, near_1_um(case.model)),
        "kernel, 1 start, every band deeper": kernel_rate(case, 1, few),
        "kernel, 4 starts, all hops": kernel_rate(case, 4, hops),
        "kernel, 24 starts, all hops": kernel_rate(case, 24, hops),
    }
    best = np.full(count, np.inf)
    for _, reached in rows.values():
        best[: reached.size] = np.minimum(best[: reached.size], reached)
    base = rows["lmfit, numerical derivatives"][0]
    p, n = case.start.shape[1], channels
    print(f"\n{channels} channels, {p} parameters, {count} spectra ({slow} for lmfit and scipy)")
    print(f"{'':40s} {'fits/s':>9s} {'ratio':>8s} {'at the best':>12s}")
    for name, (rate, reached) in rows.items():
        share = np.mean(reached - best[: reached.size] < RELATIVE * best[: reached.size])
        print(f"{name:40s} {rate:9.1f} {rate / base:8.1f} {100 * share:11.1f}%")
    operations = n * p * (p + 1) + 40 * n * (p // 3)
    floor = operations / peak * 1e6
    print(f"one evaluation and its normal equations: {operations / 1e6:.2f} MFLOP, at dgemm's rate {floor:.1f} us")
    for name in ("kernel, 1 start", "kernel, 1 start, every band deeper"):
        print(f"{name}: the time of {1e6 / rows[name][0] / floor:.0f} of these at dgemm's rate")


if __name__ == "__main__":
    main()
