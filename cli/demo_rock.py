"""The demonstration's first step: a synthetic rock from the spectrometer's products to its minerals."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from lunarsci.figure import picture_bytes
from lunarsci.spectra.bands import SpectrumBands, measure_bands
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.vnis.calibrate import calibrate
from lunarsci.spectra.vnis.calibration import Calibration
from lunarsci.spectra.vnis.channels import SPLICED_NM
from lunarsci.spectra.vnis.observation import read_observation
from lunarsci.spectra.vnis.simulation.instrument import Truth, simulate
from lunarsci.spectra.vnis.simulation.products import product_files
from lunarsci.spectra.vnis.simulation.scene import FULL_STRENGTH, Scene, SceneRock

__all__ = ["Studied", "finding", "rock", "rock_findings", "rock_pictures"]


@dataclass(frozen=True, slots=True)
class Studied:
    """The synthetic rock as the spectrometer's products, the calibrated spectrum, and what two methods find in it."""

    products: dict[str, bytes]
    truth: Truth
    calibration: Calibration
    bands: SpectrumBands
    fit: MgmFit


def rock(seed: int) -> Studied:
    """Simulate what the spectrometer sees of a rock, write and calibrate the products, measure and fit the spectrum."""
    simulation = simulate(Scene(rock=SceneRock(), shadow_fraction=0.05), seed=seed)
    products = product_files(simulation)
    with TemporaryDirectory() as folder:
        for name, content in products.items():
            (Path(folder) / name).write_bytes(content)
        label = next(name for name in products if name.endswith(".2BL"))
        calibration = calibrate(read_observation(str(Path(folder) / label)))
    spectrum = calibration.to_spectrum()
    [fit] = fit_spectra([spectrum], mgm_model())
    if not isinstance(fit, MgmFit):
        raise RuntimeError(fit.status)
    return Studied(products, simulation.truth, calibration, measure_bands(spectrum), fit)


def rock_findings(the_rock: Studied) -> list[dict[str, Any]]:
    """What was found in the rock, beside what went into it."""
    at, item = int((SPLICED_NM == 750.0).argmax()), the_rock.calibration
    error = float(np.hypot(item.sigma[at], item.systematic_total[at]))
    name, truth = "rock: reflectance factor at 750 nm", float(the_rock.truth.reflectance[at])
    found = [finding(name, float(item.reflectance[at]), error, truth, "-", "calibration.png")]
    for key in ("1000", "2000"):
        band = the_rock.bands.bands[key]
        if band.center_nm is not None:
            found.append(
                finding(
                    f"rock: centre of the {key} nm band", band.center_nm, band.center_sigma_nm, None, "nm", "bands.png"
                )
            )
    for region, number in (("um1", "1"), ("um2", "2")):
        ratio = the_rock.fit.nbsr[region]
        if ratio is not None:
            opx, cpx = _strengths(the_rock.truth, number)
            name = f"rock: OPX / (OPX + CPX) band strength at {number} µm"
            found.append(finding(name, ratio.opx, ratio.sigma, opx / (opx + cpx), "-", "fit.png"))
    return found


def _strengths(truth: Truth, number: str) -> tuple[float, float]:
    """True strengths of the pyroxene bands at 1 or 2 um, but for a common factor."""
    shares = truth.composition
    opx = shares.orthopyroxene * FULL_STRENGTH["orthopyroxene"][f"OPX {number}"]
    return opx, shares.clinopyroxene * FULL_STRENGTH["clinopyroxene"][f"CPX {number}"]


def finding(what: str, value: float, sigma: float | None, truth: float | None, unit: str, file: str) -> dict[str, Any]:
    """One row of the demonstration's result; `truth` is None where there is none."""
    return {"quantity": what, "value": value, "sigma": sigma, "truth": truth, "unit": unit, "picture": file}


def rock_pictures(the_rock: Studied) -> dict[str, Callable[[], bytes]]:
    """File name to what draws it."""

    def calibration() -> bytes:
        from lunarsci.spectra.vnis.figure import calibration_pages

        return picture_bytes(calibration_pages([the_rock.calibration]), Path("calibration.png"))

    def bands() -> bytes:
        from lunarsci.spectra.mgm.figure import band_pages

        return picture_bytes(band_pages([the_rock.bands]), Path("bands.png"))

    def fit() -> bytes:
        from lunarsci.spectra.mgm.figure import fit_pages

        return picture_bytes(fit_pages([the_rock.fit]), Path("fit.png"))

    return {"calibration.png": calibration, "bands.png": bands, "fit.png": fit}
