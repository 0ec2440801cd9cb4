"""Whether the errors of `spectra bands` hold: `python tests/benchmarks/bench_bands.py FOLDER`, with `--rover` on those
of a rover.

FOLDER has `relab`, `meteorites` and `minerals`, each a `reflectance.csv`. Noise of 0.3 and 1 % is added to every
spectrum; the truth is what the same spectrum gives without it, and errors are those that the command finds without
being told the noise. Beside it another definition of the centre, the minimum of the spectrum smoothed over 75 nm.

With `--rover` FOLDER has `ce4/reflectance_factor.csv`: 88 targets, each smoothed over 41 channels, and 100 draws of it
with the noise that its own channels have. `Band.least` was chosen on every second of them, measured on the others.

With `--cut` spectra of FOLDER that go on to 2450 nm are cut before: the truth is the centre of the whole one.

With `--rate COUNT` no FOLDER is needed: how many made-up spectra of 390 channels `lunarsci spectra bands` measures in a
second, file to file beyond its start, and hylite and Spectral Python (SPy), where they are installed, in memory.
"""

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from scipy.signal import savgol_filter

from lunarsci.spectra.bands import BandFailure, SpectrumBands, band_arrays, measure_batch
from lunarsci.spectra.continuum import continuum
from lunarsci.spectra.spectrum import Spectrum, smoothing_operator

KINDS = ("relab", "meteorites", "minerals")
NOISES = (0.003, 0.01)
SMALL_NM = 4.0
"""Errors of centres that were a quarter too small."""
QUANTITIES = {
    "centre": ("center_nm", "center_sigma_nm"),
    "depth": ("depth", "depth_sigma"),
    "area": ("area_nm", "area_sigma_nm"),
    "asymmetry": ("asymmetry", "asymmetry_sigma"),
}
Held = dict[tuple[str, float, str], np.ndarray]


def table(folder: Path, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths (n,) and spectra (m, n) of a kind. [nm, -]"""
    frame = pd.read_csv(folder / kind / "reflectance.csv").dropna(axis=1)
    return frame.iloc[:, 0].to_numpy(float), frame.iloc[:, 1:].to_numpy(float).T


def measured(wavelength: np.ndarray, spectra: np.ndarray, name: str) -> Sequence[SpectrumBands | BandFailure]:
    """Bands of spectra whose noise is not stated."""
    return measure_batch([Spectrum("x", wavelength, values) for values in spectra], continuum_name=name)


def coverage(
    folder: Path, *, every: int = 1, draws: int = 2, name: str = "conic", quantity: str = "centre", seed: int = 1
) -> Held:
    """Errors over their standard errors, by kind, noise and band, where both have the band."""
    rng = np.random.default_rng(seed)
    value, sigma = QUANTITIES[quantity]
    held: dict[tuple[str, float, str], list[float]] = {}
    for kind in KINDS:
        wavelength, spectra = table(folder, kind)
        spectra = spectra[::every]
        truths = measured(wavelength, spectra, name)
        for noise in NOISES * draws:
            noisy = measured(wavelength, spectra * (1 + noise * rng.normal(size=spectra.shape)), name)
            for truth, found in zip(truths, noisy, strict=True):
                if isinstance(truth, BandFailure) or isinstance(found, BandFailure):
                    continue
                for key, band in truth.bands.items():
                    if band.center_nm is not None and found.bands[key].center_nm is not None:
                        error = getattr(found.bands[key], value) - getattr(band, value)
                        held.setdefault((kind, noise, key), []).append(abs(error) / getattr(found.bands[key], sigma))
    return {key: np.array(values) for key, values in held.items()}


def other_centres(wavelength: np.ndarray, spectra: np.ndarray) -> dict[str, np.ndarray]:
    """Minima of the spectra over their hulls, smoothed over 75 nm, by band. [nm]"""
    smoothed = spectra @ smoothing_operator(wavelength).T
    ratio = (spectra @ smoothing_operator(wavelength, 75.0, 2).T) / continuum("hull", wavelength, smoothed)
    found = {}
    for key, (low, high) in {"1000": (870.0, 1200.0), "2000": (1700.0, 2400.0)}.items():
        near = np.flatnonzero((wavelength >= low) & (wavelength <= high))
        found[key] = wavelength[near[np.argmin(ratio[:, near], axis=1)]]
    return found


def compare(folder: Path) -> None:
    """Print how far the other definition's centres are, and whether the stated spread holds them."""
    for kind in KINDS:
        wavelength, spectra = table(folder, kind)
        found = measured(wavelength, spectra, "hull")
        for key, centres in other_centres(wavelength, spectra).items():
            bands = [item.bands[key] for item in found if isinstance(item, SpectrumBands)]
            off = np.abs([(band.center_nm or np.nan) for band in bands] - centres)
            spread = np.array([band.center_method_nm or 0.0 for band in bands])
            seen = np.isfinite(off)
            print(
                f"{kind:11} {key}: minimum of the smoothed curve off by {np.median(off[seen]):.1f} nm (median), "
                f"{np.percentile(off[seen], 90):.1f} (9 of 10); within the spread "
                f"{np.mean(off[seen] < spread[seen]):.2f}"
            )


def rover(folder: Path, draws: int = 100) -> None:
    """Print how many of the centres lie within their errors, of all and of the smallest tenth of the errors."""
    frame = pd.read_csv(folder / "ce4/reflectance_factor.csv")
    wavelength, columns = frame.iloc[:, 0].to_numpy(float), list(frame.columns[1:])
    rng = np.random.default_rng(3)
    for targets, told in ((columns[::2], "chosen on"), (columns[1::2], "held out")):
        held: dict[str, list[tuple[float, float]]] = {"1000": [], "2000": []}
        for name in targets:
            values = frame[name].to_numpy(float)
            there = np.isfinite(values) & (values > 0)
            smooth = savgol_filter(values[there], 41, 3)
            jumps = pd.Series(np.abs(np.diff(values[there], 2)) / np.sqrt(6))
            noise = 1.4826 * jumps.rolling(61, center=True, min_periods=30).median().to_numpy()
            noise = np.concatenate([noise[:1], noise, noise[-1:]])
            drawn = smooth + noise * rng.normal(size=(draws, noise.size))
            [truth] = measured(wavelength[there], smooth[None], "hull")
            for found in measured(wavelength[there], drawn, "hull"):
                for key, band in truth.bands.items() if isinstance(found, SpectrumBands) else ():
                    own = found.bands[key]
                    if band.center_nm is not None and own.center_nm is not None:
                        held[key].append((abs(own.center_nm - band.center_nm), own.center_sigma_nm or 0.0))
        for key, pairs in held.items():
            off, sigma = np.array(pairs).T
            least = sigma <= np.percentile(sigma, 10)
            parts = [f"{np.mean(off < k * sigma):.2f} ({np.mean((off < k * sigma)[least]):.2f})" for k in (1, 1.96)]
            small = sigma < SMALL_NM
            if small.any():
                inside = [f"{np.mean(off[small] < k * sigma[small]):.2f}" for k in (1, 1.96)]
                print(f"{told}, {key} nm, {small.sum()} errors below {SMALL_NM:g} nm: hold {' and '.join(inside)}")
            print(
                f"{len(targets)} targets, {told}, {key} nm: 68 % hold {parts[0]}, 95 % hold {parts[1]} of {off.size} "
                "(of the smallest tenth of the errors)"
            )


def cut(folder: Path, last_nm: float) -> pd.DataFrame:
    """Centres at 2 um of spectra cut behind a channel and of the whole ones, and errors: noise, method. [nm]"""
    found: list[pd.DataFrame] = []
    for kind in KINDS:
        wavelength, spectra = table(folder, kind)
        keep = wavelength <= last_nm
        whole = band_arrays(wavelength, spectra).bands["2000"]
        own = band_arrays(wavelength[keep], spectra[:, keep]).bands["2000"]
        columns = {"centre": own.center_nm, "sigma": own.center_sigma_nm, "method": own.center_method_nm}
        columns["other"] = np.fmax(own.center_systematic_nm, own.center_gaussian_nm)
        found.append(pd.DataFrame({"whole": whole.center_nm, **columns}))
    return pd.concat(found).dropna(subset=["whole", "centre"]).fillna(0.0)


def shares_held(pairs: pd.DataFrame, method: str = "method") -> tuple[float, float]:
    """Shares of the centres of `cut` within one and two of the joined errors."""
    errors = (pairs.centre - pairs.whole).abs() / np.hypot(pairs.sigma, pairs[method])
    return float((errors < 1).mean()), float((errors < 2).mean())


def print_cut(folder: Path) -> None:
    """Print how many centres of cut spectra lie within their errors, with and without what the cut adds."""
    for last_nm in (2400.0, 2350.0, 2300.0):
        pairs = cut(folder, last_nm)
        for low, high in ((1700.0, 2000.0), (2000.0, 2150.0), (2150.0, 2400.0)):
            own = pairs[pairs.whole.between(low, high)]
            with_cut, without = shares_held(own), shares_held(own, "other")
            print(
                f"cut at {last_nm:g} nm, centre {low:g} to {high:g} nm, {len(own)} spectra: within one and two errors "
                f"{with_cut[0]:.2f} and {with_cut[1]:.2f}; without the cut's {without[0]:.2f} and {without[1]:.2f}"
            )


def spent(task: Callable[[], object]) -> np.ndarray:
    """Seconds of the clock and of processors that a task takes, its processes included; the least of three. (2,)"""
    takes = []
    for _ in range(3):
        begun = [resource.getrusage(which) for which in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        clock = time.perf_counter()
        task()
        took = time.perf_counter() - clock
        ended = [resource.getrusage(which) for which in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        cpu = sum(b.ru_utime + b.ru_stime - a.ru_utime - a.ru_stime for a, b in zip(begun, ended, strict=True))
        takes.append((took, cpu))
    return np.min(takes, axis=0)


def others(wavelength: np.ndarray, spectra: np.ndarray) -> dict[str, Callable[[], object]]:
    """What other libraries do nearest to it, those that are installed: minima below the hull in both windows."""
    tasks: dict[str, Callable[[], object]] = {}
    try:
        from hylite.analyse.mwl import minimum_wavelength
        from hylite.hylibrary import HyLibrary

        library = HyLibrary(spectra, wav=wavelength)
        windows = ((700.0, 1580.0), (1580.0, 2400.0))
        for method in ("poly", "gaussian"):
            tasks[f"hylite, {method}"] = lambda method=method: [
                minimum_wavelength(library, *window, method=method, vb=False) for window in windows
            ]
    except ImportError:
        print("hylite is not installed")
    try:
        from spectral.algorithms.continuum import remove_continuum

        tasks["SPy, hull alone"] = lambda: remove_continuum(spectra, wavelength)
    except ImportError:
        print("SPy is not installed")
    return tasks


def rate(count: int) -> None:
    """Print spectra a second: of the clock, and of processors."""
    rng, wavelength = np.random.default_rng(1), np.linspace(480.0, 2400.0, 390)
    depth, centre = rng.uniform(0.02, 0.3, (2, count, 1)), rng.uniform(900.0, 1080.0, (count, 1))
    absorbed = depth[0] * np.exp(-(((wavelength - centre) / 110) ** 2))
    absorbed += depth[1] * np.exp(-(((wavelength - 2 * centre) / 220) ** 2))
    spectra = (0.05 + 5e-5 * wavelength) * np.exp(-absorbed) * (1 + 0.003 * rng.normal(size=absorbed.shape))
    with TemporaryDirectory() as folder:
        for errors in (False, True):
            took = {}
            for size in (8, count):
                frame = pd.DataFrame(spectra[:size].T, columns=[f"s{k}" for k in range(size)])
                if errors:
                    frame = frame.join(0.003 * frame.add_suffix("_sigma"))
                file = Path(folder) / f"{size}.csv"
                frame.set_index(pd.Index(wavelength, name="wavelength_nm")).to_csv(file, float_format="%.6f")
                line = [sys.executable, "-m", "lunarsci", "spectra", "bands", str(file), "-q", "--force"]
                took[size] = spent(
                    lambda line=line, file=file: subprocess.run([*line, "-o", f"{file}.out.csv"], check=True)
                )
            clock, cpu = (count - 8) / (took[count] - took[8])
            print(f"lunarsci{', with errors' if errors else '':15} {clock:8.0f} a second, {cpu:8.0f} of one processor")
    for name, task in others(wavelength, spectra[:200]).items():
        clock, cpu = 200 / spent(task)
        print(f"{name:23} {clock:8.0f} a second, {cpu:8.0f} of one processor")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path())
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--rover", action="store_true")
    parser.add_argument("--cut", action="store_true")
    parser.add_argument("--rate", type=int, default=0)
    options = parser.parse_args()
    if options.rate:
        rate(options.rate)
        return
    if options.rover or options.cut:
        (rover if options.rover else print_cut)(options.folder)
        return
    for name in ("conic", "hull"):
        for quantity in QUANTITIES:
            held = coverage(options.folder, every=options.every, draws=options.draws, name=name, quantity=quantity)
            for noise in NOISES:
                parts = {key: values for key, values in held.items() if key[1] == noise}
                together = np.concatenate(list(parts.values()))
                each = ", ".join(f"{kind} {band} {np.mean(z < 1):.2f}" for (kind, _, band), z in parts.items())
                print(
                    f"{name} {quantity:9} noise {noise:.1%}: 68 % hold {np.mean(together < 1):.2f}, 95 % hold "
                    f"{np.mean(together < 1.96):.2f} of {together.size}; {each}"
                )
    compare(options.folder)


if __name__ == "__main__":
    main()
