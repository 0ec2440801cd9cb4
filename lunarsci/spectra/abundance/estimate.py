"""Modes of a spectrum by unmixing: both mixing laws, weighted by their evidence."""

import math
from collections.abc import Sequence

import numpy as np

from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.hapke import HapkeSurface
from lunarsci.spectra.abundance.mixing import Absorbance, Albedo, MixingLaw
from lunarsci.spectra.abundance.population import population
from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.abundance.unmix import Posterior, softmax, unmix
from lunarsci.spectra.library import EndMember
from lunarsci.spectra.spectrum import FloatArray, Spectrum

__all__ = ["METHODS", "estimate_abundance", "mixing_laws"]

METHODS = ("unmix", "hapke", "absorbance")
STEP_NM, LOWEST_NM, HIGHEST_NM = 20.0, 450.0, 2450.0
"""Channels that are compared: features of minerals are ten times as wide."""
NEEDED_NM = (750.0, 2300.0)
MODEL_ERROR = 0.025
"""Standard deviation of ln R on channels of 20 nm that stands for end members unlike the mixture's own; with it 68 %
intervals of laboratory mixtures hold the truth in 60-76 %, all samples of their series left out of the library."""
MOST_STRANGE = 0.2
"""Misfit and strain together, per channel, up to which a spectrum counts as a mixture of the end members: 45 of 53
laboratory mixtures stay below (the others are coarser than 45 um), none of 88 spectra of lunar soil and rock does."""
DRAWS, SEED = 4000, 0
LEAST_MINERALS = 2


def mixing_laws(method: str, surface: HapkeSurface | None = None) -> tuple[MixingLaw, ...]:
    """The laws that a method compares. Raises ParameterError for an unknown method."""
    laws: dict[str, tuple[MixingLaw, ...]] = {
        "hapke": (Albedo(surface or HapkeSurface()),),
        "absorbance": (Absorbance(),),
    }
    laws["unmix"] = laws["hapke"] + laws["absorbance"]
    if method not in laws:
        raise ParameterError(f"method '{method}'; give one of {', '.join(METHODS)}")
    return laws[method]


def estimate_abundance(
    spectrum: Spectrum,
    minerals: Sequence[str],
    *,
    method: str = "unmix",
    end_members: Sequence[EndMember] | None = None,
    surface: HapkeSurface | None = None,
    model_error: float = MODEL_ERROR,
) -> Abundance:
    """Fractions by volume of the named minerals, which sum to 1, with credible intervals.

    Each mineral is a population of end members (`population`), so that its powder may differ from every one of them;
    all minerals share a level that stands for grain size, and ln R may be shifted, tilted and bent by something
    neutral. Fractions are conditional on the minerals named: one that is not named cannot be found.

    Parameters
    ----------
    spectrum : reflectance factor reaching over 750-2300 nm.
    minerals : two or more of `FAMILY_OF`.
    method : `hapke` mixes single-scattering albedos, `absorbance` mixes -ln R, `unmix` weights both by their evidence.
    end_members : instead of the embedded ones; at least one per mineral, over the channels compared.
    surface : geometry, phase function and filling of `hapke`; 30, 0 deg, isotropic, none by default.
    model_error : standard deviation of ln R at 20 nm, above 0 and below 1. [-]

    Raises
    ------
    ParameterError for minerals, a method or an error out of range; DataError for a spectrum that reaches too short.

    References
    ----------
    Hapke (1981), J. Geophys. Res. 86, 3039, 10.1029/JB086iB04p03039; Mustard & Pieters (1989), J. Geophys. Res. 94,
    13619, 10.1029/JB094iB10p13619.
    """
    if len(set(minerals)) < max(LEAST_MINERALS, len(minerals)):
        raise ParameterError("unmixing needs two or more minerals, each once")
    if not 0 < model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a number above 0 and below 1, such as 0.025")
    wavelength, reflectance, noise = _compared(spectrum)
    library = embedded_end_members(wavelength) if end_members is None else end_members
    found = []
    for law in mixing_laws(method, surface):
        populations = [population(mineral, library, wavelength, law) for mineral in minerals]
        found.append(unmix(wavelength, reflectance, np.hypot(noise, model_error), populations, law))
    return _abundance(spectrum.id, method, minerals, found)


def _compared(spectrum: Spectrum) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means over channels of `STEP_NM`, of wavelength and ln R: wavelength, reflectance, standard error of ln R."""
    usable = spectrum.usable
    wavelength, reflectance = spectrum.wavelength_nm[usable], spectrum.reflectance[usable]
    if not wavelength.size or wavelength[0] > NEEDED_NM[0] or wavelength[-1] < NEEDED_NM[1]:
        raise DataError(f"{spectrum.id}: unmixing needs {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm")
    noise = np.zeros_like(wavelength)
    if spectrum.uncertainty is not None:
        noise = spectrum.uncertainty[usable] / reflectance
    inside = np.flatnonzero((wavelength >= LOWEST_NM) & (wavelength < HIGHEST_NM))
    index = np.unique(np.floor((wavelength[inside] - LOWEST_NM) / STEP_NM), return_inverse=True)[1]
    count = np.bincount(index)
    mean_nm, mean = (np.bincount(index, row[inside]) / count for row in (wavelength, np.log(reflectance)))
    return mean_nm, np.exp(mean), np.sqrt(np.bincount(index, noise[inside] ** 2)) / count


def _abundance(name: str, method: str, minerals: Sequence[str], found: Sequence[Posterior]) -> Abundance:
    evidence = np.array([item.ln_evidence for item in found])
    share = softmax(evidence)
    rng = np.random.default_rng(SEED)
    counts = np.maximum(1, np.round(DRAWS * share).astype(int))
    draws = np.concatenate(
        [
            softmax(rng.multivariate_normal(item.logits, item.covariance, count))
            for item, count in zip(found, counts, strict=True)
        ]
    )
    best = share @ np.array([softmax(item.logits) for item in found])
    low, high, low95, high95 = np.quantile(draws, [0.15865, 0.84135, 0.025, 0.975], axis=0)
    fractions = tuple(
        MineralFraction(mineral, *map(float, row))
        for mineral, *row in zip(
            minerals, best, np.minimum(low, best), np.maximum(high, best), low95, high95, strict=True
        )
    )
    rms = math.sqrt(float(share @ [np.mean(item.ln_residual**2) for item in found]))
    strange = float(share @ [np.mean((item.ln_residual / MODEL_ERROR) ** 2) for item in found])
    strange += float(share @ [item.strain / item.ln_residual.size for item in found])
    inside = strange <= MOST_STRANGE
    reason = (
        f"out of domain: less like these minerals than laboratory mixtures are (strangeness {strange:.2f}, up to "
        f"{MOST_STRANGE:g} is usual); coarse grains, weathering, opaques, glass or other minerals"
    )
    status = "like laboratory mixtures of these minerals" if inside else reason
    return Abundance(name, method, fractions, np.corrcoef(draws.T), inside, status, rms)
