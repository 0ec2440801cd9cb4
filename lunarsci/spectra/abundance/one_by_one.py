"""Shares of minerals of spectra taken one by one: by kind of target, with what is dark weighed by its evidence.

A spectrum whose kind is open between powders of minerals and of rocks is taken as either, as likely as it is. Draws of
both (`posterior`) give a mean and a standard deviation of each share; measured errors of suites of known modes
(`targets`) make intervals of them, and say whether the spectrum is in domain. No share is named where the spectrum says
little beyond what was drawn (`TELLING`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.abundance.band_depth import too_shallow
from lunarsci.spectra.abundance.end_members import embedded_end_members, on_common_channels
from lunarsci.spectra.abundance.kinds import KindVerdict, find_kinds
from lunarsci.spectra.abundance.mixing import HapkeSurface, mixing_laws
from lunarsci.spectra.abundance.posterior import (
    CHONDRITE,
    DARK,
    MOST_MISFIT,
    MOST_WIDE,
    POWDER,
    SOLID,
    TARGETS,
    Comparison,
    DrawnShares,
    KindCalibration,
    calibrations,
)
from lunarsci.spectra.abundance.powders import grain_sizes, unsized
from lunarsci.spectra.abundance.random_mixtures import IRON, PHASES, Darkening, random_mixtures
from lunarsci.spectra.abundance.result import (
    ROCKS_UNCALIBRATED,
    Abundance,
    DarkPart,
    MineralFraction,
    open_share,
    refused,
)
from lunarsci.spectra.library.end_member import EndMember
from lunarsci.spectra.spectrum import Spectrum

COUNT = 20_000
KEPT = 6
"""Random mixtures of a kind, and of how many kinds, channels and choices of minerals they are kept."""
TELLING = 0.6
"""A share is named where its standard deviation is below this part of that before the spectrum was seen; assumed."""
LEAST_SIGMA = 0.03
"""No share is taken as known better; assumed."""
LIKELY = 0.5
"""Probability from which a rock counts as an ordinary chondrite; assumed."""
LIKE_CHONDRITE = "; it looks like an ordinary chondrite, whose ratios need not be its own: ratios are not determined"
UNTESTED = "what was stated to be dark was compared with no measured mixture"
CENTRAL = np.array([0.16, 0.84])
MAFIC = ("olivine", "orthopyroxene", "clinopyroxene")


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Draws of one spectrum: shares (k, m), weights, which are chondrites, phase, iron and dark share of each.

    `prior` has the shares of all random mixtures of each kind; `misfit` is that of `DrawnShares` over the most that is
    allowed; `missed` says that nothing absorbs, or what of the spectrum no mixture has; empty where shares may be told.
    """

    shares: FloatArray
    weight: FloatArray
    chondrite: BoolArray
    phase: IntArray
    iron: IntArray
    dark_share: FloatArray
    prior: tuple[FloatArray, ...]
    unlike: float
    rms_ln: float
    misfit: float
    missed: str

    @property
    def prior_sigma(self) -> FloatArray:
        """Standard deviation of each share before the spectrum was seen, (m,)."""
        return np.asarray(np.max([shares.std(axis=0) for shares in self.prior], axis=0))

    def moments(self, chosen: BoolArray) -> tuple[FloatArray, FloatArray]:
        weight = self.weight * chosen
        weight = weight / weight.sum()
        mean = weight @ self.shares
        return mean, np.maximum(np.sqrt(weight @ (self.shares - mean) ** 2), LEAST_SIGMA)


def estimate_each(
    spectra: Sequence[Spectrum],
    minerals: Sequence[str],
    *,
    kinds: Sequence[KindVerdict] | None = None,
    method: str = "hapke",
    end_members: Sequence[EndMember] | None = None,
    surface: HapkeSurface | None = None,
    opaque: bool = False,
    iron: bool = False,
) -> list[Abundance]:
    """Fractions by volume of the named minerals, which sum to 1 beside whatever is dark, one spectrum at a time.

    Fractions are conditional on the minerals named: one that is not named cannot be found.

    Parameters
    ----------
    spectra : reflectance factors reaching over 750-2300 nm.
    minerals : two or more of which there are end members.
    kinds : of the targets; found where they are not given. Weathered soils are taken as powders of dark rocks, for
        which nothing vouches.
    method : `hapke`, `absorbance`, or `unmix`, both with draws in equal numbers.
    end_members : instead of the embedded ones.
    surface : geometry, phase function and filling of `hapke`; 30, 0 deg, isotropic, none by default.
    opaque, iron : whether there surely is an opaque phase, or nanophase iron; otherwise these, others and none compete.

    Raises
    ------
    ParameterError for minerals without end members and an unknown method; DataError for a spectrum that reaches too
    short.
    """
    if len(set(minerals)) < max(2, len(minerals)):
        raise ParameterError("unmixing needs two or more minerals, each once")
    dark = Darkening((1,) if opaque else (1, 2, 3), (1,) if iron else (1, 2), opaque, iron)
    model = _Model(tuple(minerals), _kept(end_members), method, surface, dark)
    verdicts = find_kinds(spectra) if kinds is None else kinds
    return [
        _abundance(spectrum.id, model, _drawn(spectrum, model, _kinds_of(kind)), kind)
        for spectrum, kind in zip(spectra, verdicts, strict=True)
    ]


def raw_shares(
    spectrum: Spectrum, minerals: Sequence[str], kind: str, end_members: Sequence[EndMember] | None = None
) -> tuple[str, FloatArray, FloatArray, float, float]:
    """What calibration starts from: class, mean and standard deviation (m,) of shares, `unlike`, and `misfit`."""
    model = _Model(tuple(minerals), _kept(end_members), "hapke", None, Darkening())
    found = _drawn(spectrum, model, {kind: 1.0})
    name, chosen = _class(found, kind)
    return (name, *found.moments(chosen), found.unlike, found.misfit)


def _kinds_of(kind: KindVerdict) -> dict[str, float]:
    """Probability of each kind that a spectrum is taken as."""
    if kind.kind in TARGETS:
        return {kind.kind: 1.0}
    if kind.is_weathered:
        return {DARK: 1.0}
    powder, dark = kind.probabilities[POWDER], kind.probabilities[DARK] + kind.probabilities[SOLID]
    total = powder + dark
    return {POWDER: powder / total, DARK: dark / total} if total > 0 else {DARK: 1.0}


def _class(found: _Found, kind: str) -> tuple[str, BoolArray]:
    """An ordinary chondrite where that is likely, else the kind; and the draws that speak for it."""
    if kind != SOLID and _like_chondrite(found):
        return CHONDRITE, found.chondrite
    return kind, np.ones_like(found.chondrite)


def _like_chondrite(found: _Found) -> bool:
    return float(found.weight @ found.chondrite) >= LIKELY


@dataclass(frozen=True, slots=True)
class _Model:
    """What is mixed, and how."""

    minerals: tuple[str, ...]
    library: tuple[EndMember, ...] | None
    method: str
    surface: HapkeSurface | None
    dark: Darkening


def _kept(end_members: Sequence[EndMember] | None) -> tuple[EndMember, ...] | None:
    return None if end_members is None else tuple(end_members)


def _drawn(spectrum: Spectrum, model: _Model, kinds: Mapping[str, float]) -> _Found:
    data = on_common_channels([spectrum])
    parts = []
    for kind, share in kinds.items():
        comparison = _comparison(kind, model, data.wavelength_nm.tobytes())
        found = comparison.draws(data.ln_reflectance[0], data.noise[0])
        parts.append(_of_kind(comparison, found, kind, share))
    joined = {
        name: np.concatenate([getattr(one, name) for one in parts])
        for name in ("shares", "weight", "chondrite", "phase", "iron", "dark_share")
    }
    return _Found(
        **joined,
        prior=tuple(shares for one in parts for shares in one.prior),
        unlike=max(one.unlike for one in parts),
        rms_ln=min(one.rms_ln for one in parts),
        misfit=min(one.misfit for one in parts),
        missed=too_shallow(spectrum) or (parts[0].missed if all(one.missed for one in parts) else ""),
    )


def _of_kind(comparison: Comparison, found: DrawnShares, kind: str, share: float) -> _Found:
    mixtures, index = comparison.mixtures, found.index
    names = [item.name for item in TARGETS[kind].rock_types]
    chondrite = (
        mixtures.rock_type[index] == names.index(CHONDRITE) if CHONDRITE in names else np.zeros(index.size, bool)
    )
    return _Found(
        found.draws,
        share * found.weight,
        chondrite,
        mixtures.phase[index],
        mixtures.iron[index],
        mixtures.dark_share[index],
        (mixtures.shares,),
        found.unlike,
        found.rms_ln,
        found.misfit / TARGETS[kind].most_misfit,
        _missed(found) if found.misfit > TARGETS[kind].most_misfit else "",
    )


def _missed(found: DrawnShares) -> str:
    """What of the spectrum no mixture has, and what next."""
    side = "darker" if found.worst_ln < 0 else "brighter"
    return (
        f"contradicted by the spectrum: the mixtures most like it miss it by {found.misfit:.1f} times what powders "
        f"differ by (at most {MOST_MISFIT:g}), most near {found.worst_nm:.0f} nm, where it is "
        f"{100 * abs(math.expm1(found.worst_ln)):.0f} % {side}; see which minerals its bands need with `spectra fit "
        "--assemblage auto`, or give end members like it (`--library`)"
    )


@lru_cache(KEPT)
def _comparison(kind: str, model: _Model, channels: bytes) -> Comparison:
    target, wavelength, names = TARGETS[kind], np.frombuffer(channels), model.minerals
    library = embedded_end_members(wavelength) if model.library is None else model.library
    laws = mixing_laws(model.method, model.surface, iron=model.dark.iron_stated)
    drawn = random_mixtures(names, library, wavelength, laws, target.rock_types, COUNT, darkening=model.dark)
    return Comparison(drawn, wavelength, target.discrepancy, target.components, target.foretold)


def _abundance(id: str, model: _Model, found: _Found, kind: KindVerdict) -> Abundance:
    name, chosen = _class(found, kind.kind)
    mean, sigma = found.moments(chosen)
    known = _for_grains(_calibration(_kinds_of(kind), name), model)
    ratios = _ratios(found, model.minerals, known) if kind.kind == SOLID else ()
    if found.missed:
        open_ones = refused(id, model.method, model.minerals, found.missed)
        return replace(open_ones, rms_ln=found.rms_ln, dark=_dark(found), ratios=ratios)
    told = _told(sigma, found, model.minerals, kind.kind) if name != CHONDRITE else np.full(mean.size, True)
    stated = model.dark.phase_stated or model.dark.iron_stated
    doubt = UNTESTED if stated and not kind.stranger else _doubt(kind, sigma, found.unlike, known)
    if doubt and (names := unsized(model.minerals, model.library or ())):
        doubt += f"; the library states no grain size (min_um, max_um) of {', '.join(names)}"
    if kind.kind == SOLID and _like_chondrite(found):
        doubt += LIKE_CHONDRITE
    shares = zip(model.minerals, mean, sigma, told, strict=True)
    return Abundance(
        id,
        model.method,
        tuple(_fraction(mineral, value, error, bool(sure), known) for mineral, value, error, sure in shares),
        _correlation(found, chosen),
        not doubt,
        _status(known, told, model.minerals, doubt),
        found.rms_ln,
        dark=_dark(found),
        ratios=ratios,
        suites=known.suites,
        certified=known.certified,
    )


def _told(sigma: FloatArray, found: _Found, minerals: Sequence[str], kind: str) -> BoolArray:
    """Which shares are named: those of which the spectrum says enough, and of a solid rock no plagioclase."""
    open_one = np.array([kind == SOLID and mineral not in MAFIC for mineral in minerals])
    return np.asarray((sigma <= TELLING * found.prior_sigma) & ~open_one)


def _calibration(kinds: Mapping[str, float], name: str) -> KindCalibration:
    """That of the class; of two kinds the one that vouches for less."""
    known = calibrations()
    if name == CHONDRITE:
        return known[CHONDRITE]
    return max((known[DARK if kind == SOLID else kind] for kind in kinds), key=lambda item: item.factor95)


def _for_grains(known: KindCalibration, model: _Model) -> KindCalibration:
    """Not narrower than drawn where grain sizes are those of single end members, which no suite was measured with."""
    if not any(item.sigma for item in grain_sizes(model.minerals, model.library or ()).values()):
        return known
    return replace(known, factor68=max(known.factor68, 1.0), factor95=max(known.factor95, NormalDist().inv_cdf(0.975)))


def _fraction(mineral: str, mean: float, sigma: float, told: bool, known: KindCalibration) -> MineralFraction:
    ends = [
        float(np.clip(mean + sign * factor * sigma, 0.0, 1.0))
        for factor in (known.factor68, known.factor95)
        for sign in (-1, 1)
    ]
    return MineralFraction(mineral, float(mean) if told else float("nan"), *ends)


def _doubt(kind: KindVerdict, sigma: FloatArray, unlike: float, known: KindCalibration) -> str:
    """Why the spectrum is out of domain; empty where it is in."""
    if kind.stranger:
        return "; ".join(kind.reasons)
    if kind.kind == SOLID:
        return ROCKS_UNCALIBRATED
    if kind.is_weathered:
        return "no weathered soil of known modes was measured with it"
    if known.name == CHONDRITE:
        return "it looks like an ordinary chondrite, and so do powders of pyroxene and plagioclase without any olivine"
    if unlike > known.most_unlike:
        return f"unlike mixtures of these minerals ({unlike:.1f} times as far from them as they are from each other)"
    if (wide := known.factor68 * sigma.max()) > MOST_WIDE:
        return f"a share is uncertain by {100 * wide:.0f} %, more than {100 * MOST_WIDE:.0f} %"
    return ""


def _status(known: KindCalibration, told: BoolArray, minerals: Sequence[str], doubt: str) -> str:
    open_ones = [mineral for mineral, sure in zip(minerals, told, strict=True) if not sure]
    parts = [f"out of domain: {doubt}" if doubt else f"like {known.name} of known modes"]
    if known.name == CHONDRITE:
        parts.append("an ordinary chondrite: means of its class, own shares not determined")
    elif open_ones:
        parts.append(f"not determined: {', '.join(open_ones)}")
    tests = f"intervals were tested on {len(known.suites)} sample series"
    parts.append(f"{tests}, enough for {100 * known.certified:.0f} % at most")
    return "; ".join(parts)


def _correlation(found: _Found, chosen: BoolArray) -> FloatArray:
    """Of the fractions; 0 beside one that does not vary."""
    covariance = np.cov(found.shares.T, aweights=found.weight * chosen + 1e-15)
    spread = np.sqrt(np.diag(covariance))
    scale = np.outer(spread, spread)
    correlation = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0)
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(correlation)


def _dark(found: _Found) -> DarkPart:
    """Probabilities of what is dark, and the share of a dark powder in the cross-section."""
    phases, iron = (
        {name: float(found.weight[places == number].sum()) for number, name in enumerate(names)}
        for places, names in ((found.phase, PHASES), (found.iron, IRON))
    )
    order = np.argsort(found.dark_share)
    ends = np.minimum(np.searchsorted(np.cumsum(found.weight[order]), CENTRAL), order.size - 1)
    low, high = (float(value) for value in found.dark_share[order][ends])
    return DarkPart(phases, iron, float(found.weight @ found.dark_share), low, high)


RATIOS = {"olivine_in_mafic": (("olivine",), MAFIC), "orthopyroxene_in_pyroxene": (("orthopyroxene",), MAFIC[1:])}


def _ratios(found: _Found, minerals: Sequence[str], known: KindCalibration) -> tuple[MineralFraction, ...]:
    """Shares of one mineral in several, by volume; anything where the spectrum says little of them (`TELLING`).

    What looks like an ordinary chondrite would get the means of that class, its plagioclase included, whatever it is:
    made-up norites without olivine had 50-57 % of it.
    """
    ratios = []
    open_ones = bool(found.missed) or _like_chondrite(found)
    for name, (above, below) in RATIOS.items():
        if set(below) <= set(minerals):
            places = [[minerals.index(mineral) for mineral in some] for some in (above, below)]
            value, *before = (_ratio(shares, *places) for shares in (found.shares, *found.prior))
            mean = float(found.weight @ value)
            sigma = max(float(np.sqrt(found.weight @ (value - mean) ** 2)), LEAST_SIGMA)
            told = not open_ones and sigma <= TELLING * max(one.std() for one in before)
            ratios.append(_fraction(name, mean, sigma, True, known) if told else open_share(name))
    return tuple(ratios)


def _ratio(shares: FloatArray, above: Sequence[int], below: Sequence[int]) -> FloatArray:
    return np.asarray(shares[:, above].sum(axis=1) / np.maximum(shares[:, below].sum(axis=1), 1e-6))
