"""Damping mode beside the restated path of the RELAB program, and beside `--prior map` from the same start file.

`python tests/benchmarks/reference_mode.py [spectra]`: how many of so many measured spectra (10) from each of three
start files end after as many iterations as the restated path, how far these are apart, and which others there are; then
orthopyroxene of measured orthopyroxene-clinopyroxene mixtures from the ratio of band strengths at 2 um, in both modes,
and what a start whose pyroxene bands are 20 nm off changes. Measured data: `LUNARSCI_REFERENCE_DATA`.
"""

import csv
import os
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from lunarsci.io.inputs import read_input
from lunarsci.spectra.mgm.damping import fit_damping
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.fit_file import FitBand, FitFile, model_of
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.spectra.mgm.restated import Path as Restatement

DATA = Path(os.environ["LUNARSCI_REFERENCE_DATA"]) / "spectra/relab"
PYROXENES = FitFile(
    "", "mixture.asc", (-100.0, 25.0, 10.0), (450.0, 2450.0, 1.0), 2e-3, 1e-6, "T", (0.7, -5e-6, 0.0, 0.0),
    (1.0, 1e-4, 0.0, 0.0),
    (
        FitBand(330.0, 250.0, -0.5, 50.0, 100.0, 1.0),
        FitBand(480.0, 150.0, -0.1, 40.0, 60.0, 1.0),
        FitBand(640.0, 175.0, -0.1, 40.0, 60.0, 1.0),
        FitBand(905.0, 200.0, -0.3, 20.0, 60.0, 1.0, mineral="OPX"),
        FitBand(1020.0, 200.0, -0.2, 20.0, 60.0, 1.0, mineral="CPX"),
        FitBand(1180.0, 250.0, -0.1, 40.0, 60.0, 1.0),
        FitBand(1835.0, 550.0, -0.3, 60.0, 100.0, 1.0, mineral="OPX"),
        FitBand(2300.0, 600.0, -0.2, 60.0, 100.0, 1.0, mineral="CPX"),
    ),
)  # fmt: skip
PUBLISHED = replace(
    PYROXENES, continuum="Q", coefficients=(0.85, -1e-6, 1e-11, 1e-16), coefficients_95=(10.0, 1e-4, 1e-7, 1e-7),
    bands=(
        FitBand(333.0, 400.0, -20.0, 1e4, 1e4, 100.0),
        FitBand(1000.0, 250.0, -1.0, 200.0, 400.0, 10.0),
        FitBand(2000.0, 300.0, -1.0, 300.0, 400.0, 10.0),
    ),
)  # fmt: skip
OLIVINE = replace(
    PYROXENES, continuum="P", coefficients=(0.5, 5e-5, 1e-9, 0.0), coefficients_95=(1.0, 1e-3, 1e-6, 0.0),
    bands=tuple(
        FitBand(*values, 100.0, 100.0, 1.0)
        for values in ((340.0, 250.0, -0.5), (640.0, 175.0, -0.1), (860.0, 210.0, -0.2), (1050.0, 175.0, -0.2),
                       (1240.0, 430.0, -0.3))
    ),
)  # fmt: skip
STARTS = {"eight bands, straight line": PYROXENES, "published, cubic": PUBLISHED, "olivine, quadratic": OLIVINE}


def damped(spectra: list[Spectrum], file: FitFile) -> list[MgmFit]:
    limits = {"rms_limit": file.rms_limit, "improvement_limit": file.improvement_limit}
    return [fit for fit in fit_damping(spectra, model_of(file), file=file, **limits) if isinstance(fit, MgmFit)]


def restated(spectrum: Spectrum, file: FitFile) -> tuple[int, np.ndarray]:
    values, errors = (np.array(rows) for rows in zip(*((b.values, b.uncertainties) for b in file.bands), strict=True))
    use = spectrum.usable
    path = Restatement(
        spectrum.wavelength_nm[use], spectrum.reflectance[use], file.continuum, file.coefficients,
        file.coefficients_95, values, errors,
    )  # fmt: skip
    end = path.follow(file.rms_limit, file.improvement_limit)
    return end.iterations, end.bands


def paths(spectra: list[Spectrum]) -> None:
    print("start                        spectra  iterations equal  most of them  centres apart by at most [nm]")
    for name, file in STARTS.items():
        begun = time.perf_counter()
        fits = damped(spectra, file)
        seconds = (time.perf_counter() - begun) / len(spectra)
        ends = [restated(spectrum, file) for spectrum in spectra]
        equal = [fit.iterations == count for fit, (count, _) in zip(fits, ends, strict=True)]
        apart = [
            max(abs(own.center_nm - row[0]) for own, row in zip(fit.bands, bands, strict=True))
            for fit, (_, bands), same in zip(fits, ends, equal, strict=True)
            if same
        ]
        most = max(count for count, _ in ends)
        print(f"{name:28} {len(spectra):7} {sum(equal):17} {most:13} {max(apart):31.0e}   {seconds:.2f} s each")
        others = [fit.id for fit, same in zip(fits, equal, strict=True) if not same]
        print(f"  another path: {', '.join(others)}" if others else "", end="\n" if others else "")


def off(file: FitFile, shift_nm: float) -> FitFile:
    moved = (replace(band, center_nm=band.center_nm + shift_nm) if band.mineral else band for band in file.bands)
    return replace(file, bands=tuple(moved))


def mixtures(spectra: dict[str, Spectrum]) -> None:
    with (DATA / "manifest.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["id"] in spectra]
    pyroxenes = [row for row in rows if float(row["vol_opx"]) + float(row["vol_cpx"]) > 0.97]
    mixed = [row for row in pyroxenes if min(float(row["vol_opx"]), float(row["vol_cpx"])) > 0.03]
    truth = np.array([100 * float(row["vol_opx"]) for row in mixed])
    chosen = [spectra[row["id"]] for row in mixed]
    print(f"\n{len(chosen)} mixtures; OPX from NBSR at 2 um [vol %]")
    print("mode      start   error below 0.5    rms   sd about a line   68 % hold   sigma, median   seconds each")
    for mode in ("map", "damping"):
        for shift in (0.0, -20.0, 20.0):
            file, begun = off(PYROXENES, shift), time.process_time()
            found = fit_spectra(chosen, model_of(file)) if mode == "map" else damped(chosen, file)
            seconds = (time.process_time() - begun) / len(chosen)
            ratios = [fit.nbsr["um2"] if isinstance(fit, MgmFit) else None for fit in found]
            value, sigma = np.array([(100 * r.opx, 100 * r.sigma) if r else (np.nan, np.nan) for r in ratios]).T
            told = np.isfinite(value)
            error = value[told] - truth[told]
            line = np.polyval(np.polyfit(value[told], truth[told], 1), value[told])
            print(
                f"{mode:8} {shift:+4.0f} nm {np.sum(sigma < 50):9} of {told.sum():2} {np.sqrt(np.mean(error**2)):6.1f} "
                f"{np.std(truth[told] - line):12.1f} {100 * np.mean(np.abs(error) < sigma[told]):14.0f} "
                f"{np.median(sigma[told]):12.1f} {seconds:15.2f}"
            )


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    everything = {s.id: s for s in read_spectra(read_input(str(DATA / "reflectance.csv")))}
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    paths(list(everything.values())[:: max(1, len(everything) // count)][:count])
    mixtures(everything)
