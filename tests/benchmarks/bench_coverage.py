"""How often the intervals of `laplace`, `profile` and `sample` hold the truth; run it with Python.

Truth is drawn from the model's own prior: centres and widths from its covariance, strengths half-normal, all within the
bounds, over a straight continuum; the noise of ln R is normal and known. Every band parameter of every spectrum counts.
Errors of the shares are from a bootstrap over spectra, whose parameters are not independent of each other.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from lunarsci.compiled import each_in_threads
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.fit import DEFAULT_STARTS, fit_data
from lunarsci.spectra.mgm.intervals import Intervals, posterior_intervals, profile_intervals, sample_batch
from lunarsci.spectra.mgm.model import KINDS, MgmModel, mgm_model, unit_of
from lunarsci.spectra.mgm.result import MgmFit

CHANNELS_NM = np.arange(450.0, 2396.0, 5.0)
FWHM_OVER_SIGMA = 2.354820045
METHODS = ("laplace", "profile", "sample")
BINS = (0.0, 1.0, 2.0, 3.0, 5.0, np.inf)


def draw_truth(model: MgmModel, rng: np.random.Generator) -> np.ndarray:
    """Band parameters, (3 k,), from the prior within the bounds; in um, um, ln R."""
    m = model.degrees
    covariance = np.linalg.inv(model.precision[m:, m:])
    while True:
        truth = rng.multivariate_normal(model.prior[m:], covariance)
        truth[2::3] = -np.abs(truth[2::3])
        if np.all((truth >= model.lower[m:]) & (truth <= model.upper[m:])):
            return truth


def simulate(model: MgmModel, truth: np.ndarray, noise: float, rng: np.random.Generator) -> MgmData:
    """A spectrum of these bands with normal noise of ln R, as a fit takes it."""
    ln = np.log(0.15 + 5e-5 * CHANNELS_NM)
    for centre, fwhm, strength in truth.reshape(-1, 3):
        ln = ln + strength * np.exp(-0.5 * ((CHANNELS_NM / 1e3 - centre) * FWHM_OVER_SIGMA / fwhm) ** 2)
    ln = ln + rng.normal(scale=noise, size=ln.size)
    weight = np.full(ln.size, noise**-2)
    return MgmData("made", CHANNELS_NM, np.exp(ln), weight, np.zeros((0, ln.size)), 0.0)


def laplace_ends(fit: MgmFit) -> np.ndarray:
    """(3 k, 4): low68, high68, low95, high95 in the kernel's units."""
    m = fit.model.degrees
    point, sigma = fit.parameters[m:], np.sqrt(np.diag(fit.covariance))[m:]
    return point[:, None] + sigma[:, None] * np.array([-1.0, 1.0, -1.959964, 1.959964])


def ends_of(intervals: Intervals, model: MgmModel) -> np.ndarray:
    """As `laplace_ends`."""
    rows = [(intervals[name], unit_of(name)) for name in model.names[model.degrees :]]
    return np.array([[i.low68 / u, i.high68 / u, i.low95 / u, i.high95 / u] for i, u in rows])


def profile_batch(fits: Sequence[MgmFit]) -> list[Intervals]:
    """Profile intervals of all band parameters, in threads."""
    found: dict[int, Intervals] = {}

    def one(index: int) -> None:
        fit = fits[index]
        found[index] = profile_intervals(fit, fit.model.names[fit.model.degrees :])

    each_in_threads(one, len(fits))
    return [found[index] for index in range(len(fits))]


def timed(task: Callable[[], np.ndarray], seconds: dict[str, float], key: str) -> np.ndarray:
    """The result of a task; its time goes into `seconds`."""
    start = time.perf_counter()
    result = task()
    seconds[key] = time.perf_counter() - start
    return result


def measure(
    model: MgmModel, noise: float, count: int, seed: int, methods: Sequence[str] = METHODS, **sampling: int
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], dict[str, float]]:
    """Truth (n, 3 k), strength over its Laplace error (n, k), ends by method (n, 3 k, 4) and seconds per spectrum.

    `sampling` are options of `sample_batch`.
    """
    rng = np.random.default_rng(seed)
    truth = np.array([draw_truth(model, rng) for _ in range(count)])
    fits = fit_data([simulate(model, row, noise, rng) for row in truth], model, DEFAULT_STARTS)
    tasks: dict[str, Callable[[], np.ndarray]] = {
        "laplace": lambda: np.array([laplace_ends(fit) for fit in fits]),
        "profile": lambda: np.array([ends_of(intervals, model) for intervals in profile_batch(fits)]),
        "sample": lambda: np.array([ends_of(posterior_intervals(p), model) for p in sample_batch(fits, **sampling)]),
    }
    seconds: dict[str, float] = {}
    ends = {method: timed(tasks[method], seconds, method) for method in methods}
    ratio = np.array([[-band.strength / band.strength_sigma for band in fit.bands] for fit in fits])
    return truth, ratio, ends, {method: value / count for method, value in seconds.items()}


def inside(truth: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(2, n, 3 k): whether the 68 % and the 95 % intervals hold the truth."""
    return np.array([(ends[:, :, j] <= truth) & (truth <= ends[:, :, j + 1]) for j in (0, 2)])


def share(hits: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """Mean over all, and its standard error by a bootstrap over spectra (axis 0)."""
    per_spectrum = hits.mean(axis=1)
    rng = np.random.default_rng(seed)
    picks = rng.integers(0, len(per_spectrum), (1000, len(per_spectrum)))
    return float(per_spectrum.mean()), float(per_spectrum[picks].mean(axis=1).std())


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--spectra", type=int, default=240)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.002, 0.005, 0.01])
    parser.add_argument("--assemblage", default="OL-OPX-CPX")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    model = mgm_model(options.assemblage)
    for noise in options.noise:
        truth, ratio, ends, seconds = measure(model, noise, options.spectra, options.seed, options.methods)
        print(f"\nnoise {noise:g}, {options.spectra} spectra of {options.assemblage}: share that holds the truth")
        for method, limits in ends.items():
            hits = inside(truth, limits)
            print(f"  {method} ({seconds[method]:.2f} s per spectrum)")
            for name, rows in [*((kind, hits[:, :, k::3]) for k, kind in enumerate(KINDS)), ("all", hits)]:
                text = [f"{100 * level:g} %: {share:.3f} +- {error:.3f}" for level, (share, error) in levels(rows)]
                print(f"    {name:10s} {'   '.join(text)}")
            for low, high in pairwise(BINS):
                chosen = np.repeat((ratio >= low) & (ratio < high), 3, axis=1)
                if chosen.any():
                    print(
                        f"    strength {low:g}-{high:g} sigma: n {chosen.sum() // 3:4d}"
                        f"   68 %: {hits[0][chosen].mean():.3f}   95 %: {hits[1][chosen].mean():.3f}"
                    )


def levels(hits: np.ndarray) -> list[tuple[float, tuple[float, float]]]:
    """Both levels with share and error."""
    return [(level, share(rows)) for level, rows in zip((0.6827, 0.95), hits, strict=True)]


if __name__ == "__main__":
    main()
