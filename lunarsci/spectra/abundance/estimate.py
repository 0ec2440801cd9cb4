"""Modes of spectra taken together, as mixtures of the same powders: mixing laws weighted by their evidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.abundance.end_members import OPAQUE, CommonChannels, embedded_end_members, on_common_channels
from lunarsci.spectra.abundance.mixing import HapkeSurface, MixingLaw, Weathering, iron_absorption, mixing_laws
from lunarsci.spectra.abundance.posterior import MOST_WIDE
from lunarsci.spectra.abundance.powders import Powders, loosened, population, unsized
from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.abundance.unmix import MixtureSeries, SharesPosterior, unmix
from lunarsci.spectra.library.end_member import EndMember
from lunarsci.spectra.spectrum import Spectrum

DRAWS, SEED = 4000, 0
LEVELS = (0.6827, 0.95)
LEAST_SIGMA = 0.01
"""No share that is sought is taken as known better; assumed."""
ABSENT = 0.005
"""Below this an interval is taken to begin at 0; assumed."""
MOST_STRANGE = 0.15
"""Misfit and strain together, per channel, up to which spectra count as mixtures of the end members; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What `unmix` found for the spectra of a suite, under each law.

    `untested` says why no measurement vouches for it; empty where one does. `unsized` has minerals whose grain size
    nobody stated.
    """

    method: str
    minerals: tuple[str, ...]
    posteriors: tuple[SharesPosterior, ...]
    model_error: float
    untested: str = ""
    unsized: tuple[str, ...] = ()


def abundances(names: Sequence[str], outcome: Outcome) -> list[Abundance]:
    """Posterior means and shortest intervals of all spectra, laws weighted by their evidence."""
    evidence = np.array([item.ln_evidence for item in outcome.posteriors])
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    counts = np.maximum(1, np.round(DRAWS * weight).astype(int))
    drawn = zip(outcome.posteriors, counts, strict=True)
    draws = np.concatenate([item.draws(int(count), SEED + k) for k, (item, count) in enumerate(drawn)])
    misfit = sum(share * item.ln_residual**2 for share, item in zip(weight, outcome.posteriors, strict=True))
    strain = sum(share * item.strain for share, item in zip(weight, outcome.posteriors, strict=True))
    square = np.mean(misfit, axis=1)
    strange = square / outcome.model_error**2 + strain / outcome.posteriors[0].ln_residual.shape[1]
    return [
        _abundance(name, outcome, draws[:, index], float(np.sqrt(square[index])), float(strange[index]))
        for index, name in enumerate(names)
    ]


def _abundance(name: str, outcome: Outcome, draws: FloatArray, rms: float, strange: float) -> Abundance:
    mean = draws.mean(axis=0)
    edges = [
        _widened(*shortest_interval(draws, level), mean, sigmas * LEAST_SIGMA * (np.ptp(draws, axis=0) > 0))
        for sigmas, level in enumerate(LEVELS, start=1)
    ]
    fractions = tuple(
        MineralFraction(
            mineral,
            float(mean[k]),
            *(float(value) for low, high in edges for value in (min(low[k], mean[k]), max(high[k], mean[k]))),
        )
        for k, mineral in enumerate(outcome.minerals)
    )
    doubt = _doubt(outcome, strange, max((item.high - item.low) / 2 for item in fractions))
    status = f"out of domain: {doubt}" if doubt else "like laboratory mixtures of these minerals"
    return Abundance(name, outcome.method, fractions, _correlation(draws), not doubt, status, rms)


def _doubt(outcome: Outcome, strange: float, wide: float) -> str:
    """Why a spectrum is out of domain; empty where it is in."""
    if outcome.untested:
        return outcome.untested
    if strange > MOST_STRANGE:
        return (
            f"less like these minerals than laboratory mixtures are (strangeness {strange:.2f}, up to "
            f"{MOST_STRANGE:g} is usual); coarse grains, weathering, opaques, glass or other minerals"
        )
    if outcome.unsized and wide > MOST_WIDE:
        return (
            f"a share by volume is uncertain by {100 * wide:.0f} %, more than {100 * MOST_WIDE:.0f} %, since the "
            f"library states no grain size (min_um, max_um) of {', '.join(outcome.unsized)}"
        )
    return ""


def _widened(low: FloatArray, high: FloatArray, mean: FloatArray, least: FloatArray) -> tuple[FloatArray, FloatArray]:
    """An interval no narrower than `least` on either side of the mean, within 0 and 1."""
    return np.maximum(np.minimum(low, mean - least), 0.0), np.minimum(np.maximum(high, mean + least), 1.0)


def _correlation(draws: FloatArray) -> FloatArray:
    """Of the fractions; 0 beside one that does not vary."""
    covariance = np.cov(draws.T)
    spread = np.sqrt(np.diag(covariance))
    scale = np.outer(spread, spread)
    found = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0)
    np.fill_diagonal(found, 1.0)
    return np.asarray(found)


def shortest_interval(draws: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """Ends of the shortest interval that holds a share `level` of draws, (k,) each, from (n, k)."""
    ordered = np.sort(draws, axis=0)
    held = int(np.ceil(level * len(ordered)))
    width = ordered[held - 1 :] - ordered[: len(ordered) - held + 1]
    begin = np.argmin(width, axis=0)
    low = np.take_along_axis(ordered, begin[None], axis=0)[0]
    high = np.take_along_axis(ordered, begin[None] + held - 1, axis=0)[0]
    return np.where(low < ABSENT, 0.0, low), np.where(high > 1 - ABSENT, 1.0, high)


MODEL_ERROR = 0.03
"""Standard deviation of ln R on channels of 20 nm that stands for end members unlike the mixture's own; measured:
with it 68 % intervals of laboratory mixtures hold the truth in 67-75 %, all samples of their series left out of the
library."""
UNTESTED = "shares beside opaques or submicroscopic iron were compared with no measured mixture"
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
) -> list[Abundance]:
    """Fractions by volume of the named minerals, which sum to 1, with credible intervals.

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
    found = []
    for law in laws:
        suite = _suite(data, _powders(law, minerals, library, data), held, fractions, model_error, iron)
        found.append(unmix(suite))
    untested = UNTESTED if iron or OPAQUE in minerals else ""
    sizes = tuple(unsized(minerals, library))
    return abundances(names, Outcome(method, tuple(minerals), tuple(found), model_error, untested, sizes))


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
