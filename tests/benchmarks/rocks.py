"""The boulders of Chang'E-4 under every continuum, for docs/validation/rock.md: `python tests/benchmarks/rocks.py`.

Needs the reference data, found through LUNARSCI_REFERENCE_DATA.
"""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lunarsci.io.inputs import read_input
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM
from lunarsci.spectra.mgm.fit import SPREAD_CONTINUA, fit_continua
from lunarsci.spectra.mgm.model import MGM_CONTINUA, mgm_model
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.readers.dispatch import read_spectra

__all__ = ["rock_rows", "rocks_table"]

MAFIC = ("OL M1-2", "OPX 1", "CPX 1")


def olivine_share(fit: MgmFit) -> float:
    """Strength of the olivine band near 1220 nm over that and the two pyroxene bands at 1 um; NaN where all are 0."""
    strength = {band.name: abs(band.strength) for band in fit.bands}
    total = sum(strength[name] for name in MAFIC)
    return strength[MAFIC[0]] / total if total > 0 else float("nan")


def span(values: Sequence[float]) -> str:
    """Lowest to highest, in per cent."""
    known = np.array(values)[np.isfinite(values)]
    return f"{100 * known.min():.0f}-{100 * known.max():.0f}" if known.size else "-"


def rock_rows(data: Path) -> list[list[str]]:
    """Per boulder: id, rms [%], OPX share of the 2 um strengths, its span, the olivine share, its span."""
    spectra = [s for s in read_spectra(read_input(str(data / "spectra/ce4/reflectance_factor.csv"))) if "rock" in s.id]
    found = fit_continua(spectra, lambda name: mgm_model(continuum=name), continua=MGM_CONTINUA)
    rows = []
    for spectrum, fits in zip(spectra, found, strict=True):
        if any(isinstance(fit, MgmFailure) or not fit.converged for fit in fits.values()):
            rows.append([spectrum.id, *["not fitted"] * 5])
            continue
        good = {name: fit for name, fit in fits.items() if isinstance(fit, MgmFit) and name in SPREAD_CONTINUA}
        own = good[DEFAULT_CONTINUUM]
        ratio = own.nbsr["um2"]
        ratios = [fit.nbsr["um2"].opx for fit in good.values() if fit.nbsr["um2"]]
        rows.append(
            [
                spectrum.id,
                f"{100 * own.rms_ln:.2f}",
                f"{100 * ratio.opx:.0f} ± {100 * ratio.sigma:.0f}" if ratio else "not determined",
                span(ratios),
                f"{100 * olivine_share(own):.0f}",
                span([olivine_share(fit) for fit in good.values()]),
            ]
        )
    return rows


def rocks_table(data: Path) -> str:
    """The rows as Markdown."""
    head = ["boulder", "rms ln R [%]", "OPX in pyroxene [%]", "over continua", "olivine share [%]", "over continua"]
    lines = [head, ["---"] * len(head), *rock_rows(data)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    print(rocks_table(Path(os.environ["LUNARSCI_REFERENCE_DATA"])))
