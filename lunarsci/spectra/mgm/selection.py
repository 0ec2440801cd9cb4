"""Which minerals a spectrum speaks for: every assemblage fitted, compared by evidence.

`choose` gives a `Choice` for each spectrum, for `spectra fit --assemblage auto`. How much a spectrum speaks for an
assemblage is Laplace's approximation of the logarithm of the evidence (`EvidencePlace.ln_evidence`).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.minerals import WEIGHED
from lunarsci.names import some_of
from lunarsci.parallel.blocks import arrays_in_blocks, saved_rows
from lunarsci.spectra.collection import SpectrumCollection
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM, MgmContinuum
from lunarsci.spectra.mgm.assemblages import FAMILIES, GROUPS, SURE, BandPrior, chances, standing, verdict
from lunarsci.spectra.mgm.data import MISFIT_FLOOR, MgmData, deepest_absorption, prepare
from lunarsci.spectra.mgm.fit import SpectraFits, check_options, fit_data, model_digest
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import MgmModel, mgm_model, stated_for
from lunarsci.spectra.mgm.result import UNLIKE_RMS, MgmFailure, MgmFit
from lunarsci.spectra.spectrum import Spectrum

NODES = 80
"""Of the quadrature over a mineral's amount."""
FIRST_DAMPING, STEPS = 1e-3, 8
"""Of Levenberg's and Marquardt's descent with correlated errors of channels."""
LN_2PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, slots=True, eq=False)
class EvidencePlace:
    """The objective of a model at a point, where errors of channels are correlated; made by `at`.

    `whiten`, (n, n), makes residuals independent with unit variance.

    Attributes
    ----------
    point : (p,) in the order and units of `MgmModel`.
    objective : sum of squares of the whitened residuals, and the prior's share; infinite where the continuum is not
        above 0. [-]
    curvature, descent : (p, p) half the Hessian (Gauss-Newton), (p,) half the negative slope; NaN there.
    """

    point: FloatArray
    model: MgmModel
    objective: float
    curvature: FloatArray
    descent: FloatArray

    @classmethod
    def at(cls, point: FloatArray, model: MgmModel, data: MgmData, whiten: FloatArray) -> "EvidencePlace":
        """The objective of `model` for `data` at a point."""
        wavelength = data.wavelength_nm
        modelled = model_and_jacobian(point, wavelength / 1e3, model.basis(wavelength), model.logarithmic)
        if modelled is None:
            return cls(point, model, math.inf, np.full_like(model.precision, np.nan), np.full_like(point, np.nan))
        residual, jacobian = whiten @ (np.log(data.reflectance) - modelled[0]), modelled[1] @ whiten.T
        away = point - model.prior
        pull = model.precision @ away
        objective = float(residual @ residual + away @ pull)
        return cls(point, model, objective, jacobian @ jacobian.T + model.precision, jacobian @ residual - pull)

    def lower(self, data: MgmData, whiten: FloatArray) -> "EvidencePlace":
        """A few steps of Levenberg and Marquardt downhill, within the bounds."""
        here, damping, model = self, FIRST_DAMPING, self.model
        for _ in range(STEPS):
            held = ((here.point <= model.lower) & (here.descent < 0)) | (
                (here.point >= model.upper) & (here.descent > 0)
            )
            free = ~held
            matrix = here.curvature[np.ix_(free, free)]
            matrix = matrix + damping * np.diag(np.diag(matrix))
            point = here.point.copy()
            point[free] += np.linalg.solve(matrix, here.descent[free])
            there = EvidencePlace.at(np.clip(point, model.lower, model.upper), model, data, whiten)
            better = there.objective <= here.objective
            damping *= 0.1 if better else 20.0
            here = there if better else here
        return here

    def ln_evidence(self) -> float:
        """ln of the probability of the spectrum given the assemblage, to a constant of the data and the continuum.

        The posterior is taken as normal about the fit: with f the objective there, Q the prior's precision, H half the
        Hessian of the objective (Gauss-Newton) and k the number of band parameters,

            ln Z = -f/2 + ln det(Q)/2 - ln P - ln det(H)/2 + ln T,

        powers of 2 pi cancelling but for the continuum's. Strengths are 0 or below: P is the share of the prior there
        and T that of the normal posterior. A parameter that the data press against a bound has the integral of a
        one-sided normal law instead. Comparable between assemblages under the same continuum, data and model error, and
        dependent on the widths of the priors; of models without fixed parameters. Against sampling it is right to 0.02
        where the data tell the bands, off by 0.1-0.4 where strengths are within their errors of 0, and by up to 1.4
        where errors are a hundredth of the bands or less. NaN where the fit has no finite curvature.

        References
        ----------
        Kass & Raftery (1995), J. Am. Stat. Assoc. 90, 773, 10.1080/01621459.1995.10476572.
        """
        if not math.isfinite(self.objective):
            return math.nan
        model, m = self.model, self.model.degrees
        held = (self.point <= model.lower) | (self.point >= model.upper)
        prior = 0.5 * _ln_det(model.precision[m:, m:]) - ln_all_negative(model.assemblage.bands)
        width = 0.5 * m * LN_2PI + _ln_volume(self.curvature, self.descent, self.point, held, m)
        return -0.5 * self.objective + prior + width


def ln_all_negative(bands: Iterable[BandPrior]) -> float:
    """ln of the prior probability that all strengths are below 0, were they normal with mean 0 and not bounded.

    Strengths of one mineral share its amount a: P = integral of N(a) product over bands of Phi(-l a / sqrt(1 - l^2)),
    l the loading of the band; a half for a band alone. By Gauss-Hermite quadrature.
    """
    from scipy.special import log_ndtr

    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    loadings: dict[str, list[float]] = {}
    for band in bands:
        loadings.setdefault(band.mineral, []).append(band.strength_loading)
    total = 0.0
    for shared in loadings.values():
        load = np.array(shared)
        steep = -load / np.sqrt(1.0 - load**2)
        inside = np.exp(log_ndtr(np.outer(nodes, steep)).sum(axis=1))
        total += math.log(float(weights @ inside) / math.sqrt(2.0 * math.pi))
    return total


def _ln_det(matrix: FloatArray) -> float:
    """NaN where the determinant is not above 0."""
    sign, value = np.linalg.slogdet(matrix)
    return float(value) if sign > 0 else math.nan


def _ln_volume(curvature: FloatArray, gradient: FloatArray, point: FloatArray, held: BoolArray, m: int) -> float:
    """ln of the integral of the posterior over its value at `point`, less k/2 ln 2 pi and m/2 ln 2 pi.

    `curvature` (p, p) and `gradient` (p,), the descent, are those of an `EvidencePlace` at `point` (p,); `held` (p,)
    says which parameters are on a bound; the first m are the continuum's.
    """
    from scipy.special import erfcx, log_ndtr

    free = ~held
    block = curvature[np.ix_(free, free)]
    if math.isnan(volume := -0.5 * _ln_det(block)):
        return math.nan
    inverse = np.linalg.inv(block)
    cross = curvature[np.ix_(held, free)]
    bend = np.diag(curvature[np.ix_(held, held)] - cross @ inverse @ cross.T)
    slope = np.abs(gradient[held]) / np.sqrt(bend)
    volume += float(np.sum(np.log(0.5 * erfcx(slope / math.sqrt(2.0))) - 0.5 * np.log(bend)))
    strengths = np.arange(m + 2, point.size, 3)
    strengths = strengths[free[strengths]]
    sigma = np.sqrt(np.diag(inverse))[np.cumsum(free)[strengths] - 1]
    return volume + float(log_ndtr(-point[strengths] / sigma).sum())


DETAIL_FLOOR, DETAIL_SHARE, DETAIL_NM, WHITE_SHARE = 0.008, 0.04, 60.0, 0.1
"""What Gaussians and priors do not know of natural minerals: its standard deviation in ln R, a floor and a share of the
deepest absorption; the length over which it is correlated, by Matern's law of order 3/2; the share that is not. Size
and length hardly matter for which assemblage is found (`choose`); assumed. [-, -, nm, -]"""
COARSE_NM = DETAIL_NM / 3
"""Channels are put together to about this, which follows from that length."""
START_ERROR = 0.03
"""Share of the depth as an independent error, with which the minima are looked for; assumed."""
TEMPER, PENALTY = 0.57, 2.04
"""Weight of ln evidence, and what every mineral must add, in the logarithm of the probability; see `choose`.
`python tests/benchmarks/choices.py` learns them: 0.57 and 2.02 from the priors and fits as they are now."""
CREDIBLE, MOST_TOGETHER = SURE, 4
"""Probability that the assemblages named together hold, and how many of them still are strong evidence: 62 % of 156
spectra are, and 92 % of these families right (`choose`)."""
LEAST_DEPTH = 0.03
"""Depth of the deepest absorption that is reckoned with at least; assumed."""
DEFAULT_CHOICE_STARTS = 3
TOGETHER = 16
"""Spectra of a block: some seconds of work."""
LONGEST_REASON = 300
"""Characters of the sentence on a spectrum without a choice."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One assemblage fitted to a spectrum.

    Attributes
    ----------
    bic : of the fit with independent errors, where the comparison starts; lower is better. [-]
    ln_evidence : with correlated errors, to a constant shared by all candidates of the spectrum. [-]
    score : ln of the probability, to a constant shared by all. [-]
    probability : that this assemblage is the right one, of all that were compared. [-]
    """

    assemblage: str
    bic: float
    ln_evidence: float
    score: float
    probability: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The assemblage a spectrum speaks for.

    Attributes
    ----------
    candidates : all that could be compared, best score first.
    family : the most probable assemblages that together hold 93 % of the probability.
    margin : by how much the score of the best exceeds that of the next. [-]
    margin_ln_evidence, margin_bic : ln evidence of the best less that of the next; BIC of the next less that of the
        best. Negative where simplicity, not evidence, decides. [-]
    strong : whether the family has four members or fewer, and a mineral that is in all of them.
    beyond : minerals whose centres, in the fit that was chosen, are those of no composition.
    cause : what else than a pyroxene the 2 um band may be of (`other_cause`), '' for nothing. beside : what lies in it.
    present : probability of more than 5 % of each mineral as `unmix` gives it; empty where it is untested. [-]
    """

    id: str
    candidates: tuple[Candidate, ...]
    family: tuple[str, ...]
    margin: float
    margin_ln_evidence: float
    margin_bic: float
    strong: bool
    beyond: tuple[str, ...] = ()
    cause: str = ""
    beside: str = ""
    present: Mapping[str, float] = field(default_factory=dict)

    @property
    def status(self) -> str:
        """The verdict, which minerals are sure and which are open: what the result says of the spectrum."""
        verdict_text = verdict(self.probabilities, self.present, self.beyond, self.cause)
        return f"{verdict_text}; in the 2 µm band {self.beside}" if self.beside else verdict_text

    @property
    def assemblage(self) -> str:
        """Name of the best."""
        return self.candidates[0].assemblage

    @property
    def probabilities(self) -> dict[str, float]:
        """Of each assemblage. [-]"""
        return {candidate.assemblage: candidate.probability for candidate in self.candidates}

    @property
    def minerals(self) -> dict[str, float]:
        """Probability of each mineral: of the assemblages that it is in. [-]"""
        return {name: chance for name, chance in chances(self.probabilities).items() if name not in GROUPS}

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        columns = ("assemblage", "ln_evidence", "bic", "score", "probability")
        rows = [{name: getattr(candidate, name) for name in columns} for candidate in self.candidates]
        names = ("id", "assemblage", "margin", "margin_ln_evidence", "margin_bic", "strong", "status")
        groups = {name: chance for name, chance in chances(self.probabilities).items() if name in GROUPS}
        present = {name: self.present.get(name) for name in WEIGHED}
        chances_of = {"mineral_probability": self.minerals, "group_probability": groups, "present": present}
        more = chances_of | standing(self.probabilities, self.present, self.beyond, self.cause)
        return {name: getattr(self, name) for name in names} | {"candidates": rows, "family": list(self.family)} | more


def choose(
    spectra: Sequence[Spectrum],
    *,
    families: Sequence[str] = FAMILIES,
    continuum: MgmContinuum = DEFAULT_CONTINUUM,
    compositions: Mapping[str, tuple[float, float]] | None = None,
    model_error: float | None = None,
    starts: int = DEFAULT_CHOICE_STARTS,
    progress: Callable[[int, int], None] | None = None,
) -> list[Choice | MgmFailure]:
    """Fit every assemblage to every spectrum and compare them; one result or one stated reason each, in order.

    What Gaussians and priors do not know of natural minerals is correlated over tens of nanometres: the evidence is
    that of residuals with a standard deviation of 0.008 and 4 % of the deepest absorption, correlated over 60 nm,
    beside the noise. Strengths have priors as wide as the deepest absorption, so that spectra of weak and of strong
    bands are judged alike. An assemblage with n minerals has the probability exp(0.57 ln evidence - 2.04 n), over the
    sum of all: the first number says how far the evidence may be believed, the second that minerals are not assumed
    without need. Both were learned from which assemblage is right, in 156 laboratory spectra with one or two minerals
    of 5 vol % or more (`tests/benchmarks/choices.py`); the kernel's size and length hardly matter.

    Assemblages that cannot be told apart are named together, as a family. The evidence is strong where these are few
    and have a mineral in common: that mineral is there, the others are open. Leaving each sample series out of what was
    learned, 62 % of the 156 spectra are strong and 92 % of these families right (two assemblages on average); of 153
    further spectra, by the numbers learned from the 156, 70 and 91 %. The share of the probability that a family holds
    was chosen with these figures in view: at 0.9 they are 71 and 90, 81 and 89 %. The assemblage named first is right
    for 74 and 84 %. What is missed is a second mineral below another that absorbs more: olivine up to 40 vol % in
    orthopyroxene, diopside in olivine. Rocks of three or four minerals are beyond what was learned: of 83 meteorites
    27 % look strong, and 41 % of these families are right.

    Parameters
    ----------
    spectra : on any channels between 400 and 2600 nm; at least 40 usable ones, reaching over 800-1300 nm.
    families : names of assemblages, two or more, each once.
    continuum : the same for all, since evidence compares under one continuum only.
    compositions : see `mgm_model`; each counts in the assemblages that have it. [mol %]
    model_error : of ln R, above 0 and below 1, instead of the standard deviation above. [-]
    starts : number of starting points of each fit, 1 or more.
    progress : called with (done, total) spectra.

    Raises
    ------
    ParameterError for families that are unknown, fewer than two or repeated, and a model error or starts out of range.

    References
    ----------
    Kass & Raftery (1995), J. Am. Stat. Assoc. 90, 773, 10.1080/01621459.1995.10476572; Kennedy & O'Hagan (2001), J. R.
    Stat. Soc. B 63, 425, 10.1111/1467-9868.00294 (model discrepancy).
    """
    models = [mgm_model(name, continuum, stated_for(name, compositions)) for name in families]
    names = [model.assemblage.name for model in models]
    if len(names) < 2 or len(set(names)) < len(names):
        raise ParameterError("a choice needs two or more assemblages, each once")
    check_options(model_error, starts)
    collection = SpectrumCollection.of(spectra)
    arrays = arrays_in_blocks(
        partial(_compared, models=models, model_error=model_error, starts=starts),
        len(collection),
        saved_rows(len(collection), TOGETHER),
        stage=f"choice {continuum}",
        about=lambda: {
            "spectra": collection.digest(),
            "models": " ".join(model_digest(model) for model in models),
            "model error": str(model_error),
            "starts": str(starts),
        },
        fetch=lambda block: [collection[row] for row in block],
        progress=progress,
    )
    results: list[Choice | MgmFailure] = []
    for name, numbers, why in zip(collection.ids, arrays["numbers"], arrays["why"].tolist(), strict=True):
        if why:
            results.append(MgmFailure(name, "-", continuum, f"no result: {why}"))
        else:
            results.append(_choice(name, names, numbers))
    return results


def _compared(
    spectra: Sequence[Spectrum], *, models: Sequence[MgmModel], model_error: float | None, starts: int
) -> dict[str, Any]:
    """BIC, ln evidence and score of each assemblage (n, models, 3), or why there are none (n,)."""
    numbers, why = np.full((len(spectra), len(models), 3), np.nan), [""] * len(spectra)
    for row, spectrum in enumerate(spectra):
        try:
            numbers[row] = _scores(spectrum, models, model_error, starts)
        except DataError as error:
            why[row] = str(error)
    return {"numbers": numbers, "why": np.array(why, dtype=f"<U{LONGEST_REASON}")}


def _scores(spectrum: Spectrum, models: Sequence[MgmModel], model_error: float | None, starts: int) -> FloatArray:
    """BIC, ln evidence and score of each assemblage, (models, 3). Raises DataError with fewer than two scores."""
    fine = prepare(spectrum, MISFIT_FLOOR)
    depth = max(LEAST_DEPTH, float(deepest_absorption(fine.wavelength_nm, fine.reflectance[None])[0]))
    data = _coarse(fine, math.hypot(MISFIT_FLOOR, START_ERROR * depth))
    error = math.hypot(DETAIL_FLOOR, DETAIL_SHARE * depth) if model_error is None else model_error
    whiten = _whitening(data, error)
    scores = np.array([_score(data, _deepened(model, depth), whiten, starts) for model in models])
    if np.isfinite(scores[:, 2]).sum() < 2:
        raise DataError("fewer than two assemblages can be fitted; look at the spectrum for channels that are wrong")
    return scores


def _choice(name: str, families: Sequence[str], numbers: FloatArray) -> Choice:
    """The choice of a spectrum from its numbers, (families, 3), as `_scores` has them."""
    compared = [Candidate(one, *row) for one, row in zip(families, numbers.tolist(), strict=True)]
    ranked = sorted((c for c in compared if math.isfinite(c.score)), key=lambda c: -c.score)
    odds = np.exp([c.score - ranked[0].score for c in ranked])
    ranked = [replace(c, probability=float(p)) for c, p in zip(ranked, odds / odds.sum(), strict=True)]
    best, second = ranked[:2]
    family = family_of(ranked)
    shared = set.intersection(*(set(name.split("-")) for name in family))
    strong = bool(shared) and len(family) <= MOST_TOGETHER
    return Choice(
        name,
        tuple(ranked),
        family,
        best.score - second.score,
        best.ln_evidence - second.ln_evidence,
        second.bic - best.bic,
        strong,
    )


def family_of(ranked: Sequence[Candidate]) -> tuple[str, ...]:
    """The first of the candidates, most probable first, that together hold `CREDIBLE` of the probability."""
    held = np.cumsum([candidate.probability for candidate in ranked])
    return tuple(candidate.assemblage for candidate in ranked[: int(np.sum(held < CREDIBLE)) + 1])


def _coarse(fine: MgmData, error: float) -> MgmData:
    """Means of ln R over neighbouring channels, about `COARSE_NM` together, with their noise and `error`."""
    together = max(1, round(COARSE_NM / float(np.median(np.diff(fine.wavelength_nm)))))
    size = fine.wavelength_nm.size // together * together
    wavelength, ln_reflectance, variance = (
        values[:size].reshape(-1, together).mean(axis=1)
        for values in (fine.wavelength_nm, np.log(fine.reflectance), 1.0 / fine.weight)
    )
    weight = 1.0 / (variance / together + error**2)
    return replace(
        fine, wavelength_nm=wavelength, reflectance=np.exp(ln_reflectance), weight=weight, model_error=error,
        shifts=np.empty((0, wavelength.size)),
    )  # fmt: skip


def _whitening(data: MgmData, error: float) -> FloatArray:
    """(n, n) matrix that makes residuals of ln R independent with unit variance: noise, and `error`, which is
    correlated over `DETAIL_NM`."""
    apart = math.sqrt(3.0) * np.abs(np.subtract.outer(data.wavelength_nm, data.wavelength_nm)) / DETAIL_NM
    noise = np.maximum(1.0 / data.weight - data.model_error**2, 0.0)
    covariance = error**2 * (1.0 + apart) * np.exp(-apart) + np.diag(noise + (WHITE_SHARE * error) ** 2)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)


def _score(data: MgmData, model: MgmModel, whiten: FloatArray, starts: int) -> tuple[float, float, float]:
    """BIC, ln evidence and score of an assemblage."""
    [fit] = fit_data([data], model, starts)
    value = EvidencePlace.at(fit.parameters, model, data, whiten).lower(data, whiten).ln_evidence()
    return fit.bic, value, TEMPER * value - PENALTY * len(model.assemblage.minerals)


def _deepened(model: MgmModel, depth: float) -> MgmModel:
    """The model with strengths whose prior standard deviations are multiplied by `depth`."""
    scale: FloatArray = np.ones(model.prior.size)
    scale[model.degrees + 2 :: 3] = depth
    return replace(model, precision=model.precision / np.outer(scale, scale))


NAMED = 5
"""Spectra without a decided assemblage that are named."""

ODD = {"strained": "bands are strained, see `status`, of", "ambiguous": "another minimum fits almost as well for"}
"""Words of a status beside `converged`, and what they are against a fit."""


def doubts_about(fits: Sequence[MgmFit | MgmFailure], choices: Mapping[int, Choice] | None = None) -> list[str]:
    """Why some fits should not be trusted, one sentence for each reason."""
    if isinstance(fits, SpectraFits):
        unsettled, rms = ~(fits.gathered(lambda batch: batch.converged) > 0), fits.gathered(lambda batch: batch.rms_ln)
        names = np.array(fits.names, dtype=object)
        lists = [names[unsettled & fits.there].tolist(), names[rms > UNLIKE_RMS].tolist()]
        statuses = list(zip(fits.names, fits.statuses, strict=True))
    else:
        good = [item for item in fits if isinstance(item, MgmFit)]
        lists = [[one.id for one in good if not one.converged], [one.id for one in good if one.rms_ln > UNLIKE_RMS]]
        statuses = [(item.id, item.status) for item in good]
    texts = ("no convergence for {}", "the model does not describe {}")
    doubts = [text.format(", ".join(names_of)) for text, names_of in zip(texts, lists, strict=True) if names_of]
    for word, text in ODD.items():
        odd = [name for name, status in statuses if f"; {word}: " in status]
        doubts += [f"{text} {some_of(odd, NAMED)}"] if odd else []
    weak = [choice.id for choice in (choices or {}).values() if not choice.strong]
    return doubts + ([f"the assemblage is not decided for {some_of(weak, NAMED)}"] if weak else [])
