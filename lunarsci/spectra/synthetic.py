"""A made-up rock with known bands, for the demonstration and for tests. Never a measurement, and named so."""

import csv
from importlib.resources import files

import numpy as np

from lunarsci.provenance import sha256
from lunarsci.spectra.mgm.assemblages import assemblage
from lunarsci.spectra.mgm.kernel import FWHM_OVER_SIGMA
from lunarsci.spectra.spectrum import Spectrum

__all__ = ["TABLE", "rock_strengths", "synthetic_rock", "table_hash", "to_csv"]

TABLE = "synthetic_rock.csv"
CHANNELS_NM = np.arange(450.0, 2396.0, 5.0)
"""The 390 channels of VNIS after splicing: 450-2395 nm by 5 nm."""
CONTINUUM = (0.10, 2.2e-5)
"""Reflectance at 0 nm and slope per nm of the straight continuum; assumed, about as bright and red as lunar rock."""


def rock_strengths() -> dict[str, float]:
    """Band name to strength in ln reflectance."""
    return {row["band"]: float(row["strength"]) for row in csv.DictReader(_bytes().decode().splitlines())}


def table_hash() -> dict[str, str]:
    """Name and SHA-256 of the table, for the provenance."""
    return {TABLE: sha256(_bytes())}


def synthetic_rock(noise: float = 0.005, seed: int = 0) -> Spectrum:
    """A made-up rock: the bands of `mgm_bands.csv` at their prior centres and widths, strengths of `rock_strengths`.

    Parameters
    ----------
    noise : standard deviation of ln reflectance per channel. [-]
    seed : of the noise.
    """
    ln = np.log(CONTINUUM[0] + CONTINUUM[1] * CHANNELS_NM)
    strengths = rock_strengths()
    for band in assemblage("OL-OPX-CPX").bands:
        x = (CHANNELS_NM - band.center_nm) * FWHM_OVER_SIGMA / band.fwhm_nm
        ln = ln + strengths[band.name] * np.exp(-0.5 * x**2)
    reflectance = np.exp(ln + noise * np.random.default_rng(seed).standard_normal(ln.size))
    return Spectrum("synthetic_rock", CHANNELS_NM, reflectance, noise * reflectance, metadata={"synthetic": True})


def to_csv(spectrum: Spectrum) -> bytes:
    """A spectrum as CSV with units in the header, readable by `read_spectra`."""
    sigma = spectrum.uncertainty if spectrum.uncertainty is not None else np.full(spectrum.reflectance.shape, np.nan)
    note = "# synthetic: made up by lunarsci, not a measurement\n" if spectrum.metadata.get("synthetic") else ""
    rows = (
        f"{w:g},{r:.6f},{s:.6f}" for w, r, s in zip(spectrum.wavelength_nm, spectrum.reflectance, sigma, strict=True)
    )
    header = f"wavelength_nm,{spectrum.id},{spectrum.id}_sigma"
    return (note + "\n".join([header, *rows]) + "\n").encode()


def _bytes() -> bytes:
    return (files("lunarsci.spectra_data") / TABLE).read_bytes()
