"""Shares of spectra as mixtures of end members: alone, or together as mixtures of the same powders.

Mixing laws are weighted by their evidence; what comes out is one of the two estimates of `shares`.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.abundance.end_members import OPAQUE, CommonChannels, embedded_end_members, on_common_channels
from lunarsci.spectra.abundance.learned import MINERALS, SHARES, shared_out
from lunarsci.spectra.abundance.mixing import HapkeSurface, MixingLaw, Weathering, iron_absorption, mixing_laws
from lunarsci.spectra.abundance.powders import Powders, loosened, population
from lunarsci.spectra.abundance.shares import Mixed
from lunarsci.spectra.abundance.unmix import MixtureSeries, SharesPosterior, unmix
from lunarsci.spectra.library.end_member import EndMember
from lunarsci.spectra.spectrum import Spectrum

DRAWS, SEED = 4000, 0
MODEL_ERROR = 0.03
"""Standard deviation of ln R on channels of 20 nm that stands for end members unlike the mixture's own; measured:
with it 68 % intervals of laboratory mixtures hold the truth in 67-75 %, all samples of their series left out of the
library."""
LEAST_MINERALS, MOST_SPECTRA = 2, 500
SUM_TOLERANCE = 0.02
"""How far known shares may miss a sum of 1; assumed."""


def estimate_series(
    spectra: Sequence[Spectrum],
    minerals: Sequence[str],
    *,
    method: str = "unmix",
    end_members: Sequence[EndMember] | None = None,
    surface: HapkeSurface | None = None,
    model_error: float = MODEL_ERROR,
    iron: bool = False,
    present: Sequence[Sequence[str] | None] | None = None,
    known: Sequence[Mapping[str, float] | None] | None = None,
) -> Mixed:
    """Probabilities of the shares by volume of the named minerals, which sum to 1.

    Each mineral is a population of end members (`population`), so that its powder may differ from every one of them;
    all minerals share a level that stands for grain size, and ln R may be shifted, tilted and bent by something
    neutral. The spectra are taken as mixtures of the same powders, which many spectra determine much better than one,
    and mixtures of known modes better still. Fractions are conditional on the minerals named: one that is not named
    cannot be found; one that is named may come out as absent.

    Parameters
    ----------
    spectra : reflectance factors reaching over 750-2300 nm, up to 500.
    minerals : two or more of `FAMILY_OF`, or others that `end_members` holds. `opaque` has a flat embedded end member.
    method : `hapke` mixes single-scattering albedos, `absorbance` mixes -ln R, `unmix` weights both by their evidence.
    end_members : instead of the embedded ones; at least one per mineral, over the channels compared.
    surface : geometry, phase function and filling of `hapke`; 30, 0 deg, isotropic, none by default.
    model_error : standard deviation of ln R at 20 nm, above 0 and below 1. [-]
    iron : whether grains may be darkened by submicroscopic iron (`weathering`); with `hapke` only.
    present : of each spectrum, the minerals that it may hold; None for all.
    known : of each spectrum, the fractions of all minerals, summing to 1; None where they are sought. [-]

    Raises
    ------
    ParameterError for minerals, a method, fractions or an error out of range; DataError for a spectrum that reaches
    too short.

    References
    ----------
    Hapke (1981), J. Geophys. Res. 86, 3039, 10.1029/JB086iB04p03039; Mustard & Pieters (1989), J. Geophys. Res. 94,
    13619, 10.1029/JB094iB10p13619.
    """
    _check(spectra, minerals, model_error)
    laws = mixing_laws(method, surface, iron=iron)
    names = [spectrum.id for spectrum in spectra]
    held = _held(names, minerals, present or [None] * len(names))
    fractions = _known(names, minerals, known or [None] * len(names))
    data = on_common_channels(spectra)
    library = embedded_end_members(data.wavelength_nm) if end_members is None else end_members
    found = [
        unmix(_suite(data, _powders(law, minerals, library, data), held, fractions, model_error, iron)) for law in laws
    ]
    return _mixed(found, [MINERALS.index(name) for name in minerals if name != OPAQUE], model_error, len(spectra) > 1)


def _mixed(found: Sequence[SharesPosterior], places: Sequence[int], model_error: float, series: bool) -> Mixed:
    """Draws of all laws, as many of each as its evidence says; minerals that are not named have a share of 0."""
    evidence = np.array([item.ln_evidence for item in found])
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    counts = np.maximum(1, np.round(DRAWS * weight).astype(int))
    drawn = zip(found, counts, strict=True)
    draws = np.concatenate([item.draws(int(count), SEED + k) for k, (item, count) in enumerate(drawn)])
    shares = draws[..., : len(places)] / draws[..., : len(places)].sum(axis=-1, keepdims=True)
    square = sum(share * np.mean(item.ln_residual**2, axis=1) for share, item in zip(weight, found, strict=True))
    strain = sum(share * item.strain for share, item in zip(weight, found, strict=True))
    probabilities = np.zeros((draws.shape[1], len(MINERALS), SHARES.size))
    probabilities[:, :, 0] = 1.0
    for k, place in enumerate(places):
        probabilities[:, place] = shared_out(shares[:, :, k]).mean(axis=0)
    strange = square / model_error**2 + strain / found[0].ln_residual.shape[1]
    return Mixed(probabilities, np.asarray(strange), np.sqrt(square), series)


def _check(spectra: Sequence[Spectrum], minerals: Sequence[str], model_error: float) -> None:
    if len(set(minerals)) < max(LEAST_MINERALS, len(minerals)):
        raise ParameterError("unmixing needs two or more minerals, each once")
    if not 0 < model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a number above 0 and below 1, such as 0.03")
    if not 0 < len(spectra) <= MOST_SPECTRA:
        raise ParameterError(f"{len(spectra)} spectra; a suite has 1 to {MOST_SPECTRA}: split it, or unmix one by one")


def _held(names: Sequence[str], minerals: Sequence[str], present: Sequence[Sequence[str] | None]) -> FloatArray:
    held = np.ones((len(names), len(minerals)))
    for row, name, own in zip(held, names, present, strict=True):
        if own is not None:
            row[:] = [mineral in own for mineral in minerals]
            if not row.any():
                raise ParameterError(f"{name}: none of the minerals stated is one of {', '.join(minerals)}")
    return held


def _known(names: Sequence[str], minerals: Sequence[str], known: Sequence[Mapping[str, float] | None]) -> FloatArray:
    fractions = np.full((len(names), len(minerals)), np.nan)
    for row, name, given in zip(fractions, names, known, strict=True):
        if given is None:
            continue
        beyond = [mineral for mineral, share in given.items() if share > 0 and mineral not in minerals]
        if beyond:
            raise ParameterError(f"{name} holds {beyond[0]}, which is not one of {', '.join(minerals)}; add it to them")
        row[:] = [given.get(mineral, 0.0) for mineral in minerals]
        if not (row.min() >= 0 and abs(row.sum() - 1) <= SUM_TOLERANCE):
            raise DataError(f"{name}: known fractions of {', '.join(minerals)} sum to {row.sum():g}; give shares of 1")
        row /= row.sum()
    return fractions


def _powders(law: MixingLaw, minerals: Sequence[str], library: Sequence[EndMember], data: CommonChannels) -> Powders:
    found = [population(mineral, library, data.wavelength_nm, law) for mineral in minerals]
    if len(data.ln_reflectance) > 1:
        found = [loosened(item, data.wavelength_nm) for item in found]
    return Powders(law, found)


def _suite(
    data: CommonChannels, powders: Powders, held: FloatArray, fractions: FloatArray, model_error: float, iron: bool
) -> MixtureSeries:
    weathering = Weathering(iron_absorption(data.wavelength_nm)) if iron else None
    sigma = np.hypot(data.noise, model_error)
    return MixtureSeries(powders, data.wavelength_nm, data.ln_reflectance, sigma, held, fractions, weathering)
