"""Shares of spectra as mixtures of end members: alone, or together as mixtures of the same powders.

Mixing laws are weighted by their evidence; what comes out is one of the two estimates of `shares`. The model of s
spectra of one sample series (`MixtureSeries`):

ln R_j = ln R(sum_i F_ji x_i) + g_j0 + g_j1 u + g_j2 (u^2 - mean),  F_ji ~ f_ji c_i,  f_ji = a_ji^2 / sum_i a_ji^2,

with x_i the powder of mineral i (`mixing.Powders`), shared by all spectra, c_i its cross-section per volume, u the
wavelength in um from 1.45. The prior of a direction a is uniform, so that f follows a Dirichlet law with 1/2: a mineral
may be absent. g is a neutral darkening or brightening (opaques, photometry, packing), tilted and bent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import CommonChannels, embedded_end_members, on_common_channels
from lunarsci.spectra.abundance.learned import SHARES, shared_out
from lunarsci.spectra.abundance.mixing import (
    MixingLaw,
    Powders,
    Weathering,
    iron_absorption,
    loosened,
    mixing_laws,
    population,
)
from lunarsci.spectra.abundance.shares import Mixed
from lunarsci.spectra.readers.library import SUM_TOLERANCE, EndMember
from lunarsci.spectra.spectrum import Spectrum

NEUTRAL = np.array([0.1, 0.05, 0.02])
"""Standard deviations of g; assumed."""
ORIGIN_UM = 1.45
"""Wavelength from which u of the module's equation is counted."""
GAUGE = 0.05
"""How tightly the length of a, which has no meaning, is held at 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Objective, half of how fast it falls, and half its curvature (Gauss-Newton), at one point of `MixtureSeries`.

    The p shared parameters are those of the powders; each of s spectra has q of its own.

    Attributes
    ----------
    value : chi-square and the prior's share. [-]
    shared_slope, local_slope : (p,), (s, q) by shared and own parameters.
    shared, across, local : (p, p), (s, p, q), (s, q, q) curvature among shared, between shared and own, among own ones.
    """

    value: float
    shared_slope: FloatArray
    local_slope: FloatArray
    shared: FloatArray
    across: FloatArray
    local: FloatArray


@dataclass(frozen=True, eq=False)
class MixtureSeries:
    """s spectra on n channels and what is known of them: the objective, and its parameters.

    `shared` parameters, (p,), are those of `powders`; `local` ones, (s, q), of each spectrum: m roots of the fractions,
    a of the module's equation, 3 of g there, and the amount of iron if there is `weathering`.

    Attributes
    ----------
    powders : m minerals.
    wavelength_nm : (n,) [nm]
    ln_reflectance, sigma_ln : (s, n) measured, and standard deviation, errors of the model included. [-]
    present : (s, m) which minerals a spectrum may hold.
    stated : (s, m) fractions where they are known, NaN where they are sought.
    weathering : submicroscopic iron, or None.
    """

    powders: Powders
    wavelength_nm: FloatArray
    ln_reflectance: FloatArray
    sigma_ln: FloatArray
    present: FloatArray
    stated: FloatArray
    weathering: Weathering | None = None

    @property
    def minerals(self) -> int:
        """Their number, m."""
        return len(self.powders.minerals)

    @cached_property
    def sought(self) -> FloatArray:
        """(s, m) 1 where a root is free, else 0."""
        return np.asarray(self.present * np.isnan(self.stated), dtype=np.float64)

    @cached_property
    def scale(self) -> FloatArray:
        """Prior standard deviations of a spectrum's own parameters, (q,)."""
        return np.concatenate([np.ones(self.minerals), NEUTRAL, np.ones(int(self.weathering is not None))])

    @cached_property
    def neutral(self) -> FloatArray:
        """(3, n) what g of the module's equation is multiplied by: 1, u and u^2 - mean."""
        u = self.wavelength_nm / 1e3 - ORIGIN_UM
        return np.array([np.ones_like(u), u, u**2 - np.mean(u**2)])

    def start(self, favoured: int | None = None) -> FloatArray:
        """Own parameters, (s, q): equal shares, or one mineral in front; fractions that are known."""
        roots = np.array(self.present, dtype=np.float64)
        if favoured is not None:
            roots[:, favoured] *= 4.0
        roots = np.where(np.isnan(self.stated), roots, np.sqrt(self.stated))
        roots /= np.linalg.norm(roots, axis=1, keepdims=True)
        return np.concatenate([roots, np.zeros((len(roots), len(self.scale) - self.minerals))], axis=1)

    def ln_model(self, shared: FloatArray, local: FloatArray) -> FloatArray:
        """ln R, (s, n)."""
        x, _ = self.powders.at(shared)
        mixed = self._effective(shared, local) @ x
        if self.weathering is not None:
            mixed = self.weathering.darken(mixed, local[:, -1])[0]
        ln_model = self.powders.law.ln_reflectance(mixed)[0]
        return np.asarray(ln_model + local[:, self.minerals : self.minerals + len(NEUTRAL)] @ self.neutral)

    def value(self, shared: FloatArray, local: FloatArray) -> float:
        """The objective."""
        residual = (self.ln_reflectance - self.ln_model(shared, local)) / self.sigma_ln
        return float(np.sum(residual**2)) + self._prior(shared, local)

    def _prior(self, shared: FloatArray, local: FloatArray) -> float:
        """The prior's share of the objective, with the gauge."""
        length = np.sum(local[:, : self.minerals] ** 2, axis=1)
        gauge = float(np.sum(((length - 1) / GAUGE) ** 2))
        return float(np.sum(shared**2) + np.sum((local / self.scale) ** 2)) + gauge

    def _effective(self, shared: FloatArray, local: FloatArray) -> FloatArray:
        """F of the module's equation, shares of the cross-section, (s, m)."""
        weighted = local[:, : self.minerals] ** 2 * self.powders.section(shared)
        return np.asarray(weighted / weighted.sum(axis=1, keepdims=True))

    def equations(self, shared: FloatArray, local: FloatArray) -> Equations:
        """Gauss-Newton, with the curvature that a root at 0 has from the slope by its square."""
        ln_model, by_shared, by_local, bend = self._derivatives(shared, local)
        residual = (self.ln_reflectance - ln_model) / self.sigma_ln
        by_shared /= self.sigma_ln[:, :, None]
        by_local /= self.sigma_ln[:, :, None]
        count, size = len(local), by_shared.shape[-1]
        flat = by_shared.reshape(-1, size)
        local_block = np.matmul(by_local.transpose(0, 2, 1), by_local)
        local_slope = np.matmul(by_local.transpose(0, 2, 1), residual[:, :, None])[:, :, 0] - local / self.scale**2
        roots = local[:, : self.minerals] * self.sought
        by_length = 2 * roots / GAUGE
        gauge = (np.sum(local[:, : self.minerals] ** 2, axis=1) - 1) / GAUGE
        local_slope[:, : self.minerals] -= by_length * gauge[:, None]
        local_slope[:, : self.minerals] *= self.sought
        local_block[:, : self.minerals, : self.minerals] += by_length[:, :, None] * by_length[:, None, :]
        extra = np.zeros((count, len(self.scale)))
        slope = np.matmul(bend, (residual / self.sigma_ln)[:, :, None])[:, :, 0]
        extra[:, : self.minerals] = np.maximum(-slope, 0.0) * self.sought
        local_block += (extra + self.scale**-2)[:, :, None] * np.eye(len(self.scale))
        return Equations(
            float(np.sum(residual**2)) + self._prior(shared, local),
            flat.T @ residual.ravel() - shared,
            local_slope,
            flat.T @ flat + np.eye(size),
            np.matmul(by_shared.transpose(0, 2, 1), by_local),
            local_block,
        )

    def _derivatives(
        self, shared: FloatArray, local: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """ln R (s, n); derivatives by shared (s, n, p), own parameters (s, n, q); second ones by roots (s, m, n)."""
        x, slope = self.powders.at(shared)
        effective = self._effective(shared, local)
        mixed = effective @ x
        apart = x[None] - mixed[:, None, :]
        local_columns = np.zeros((*mixed.shape, len(self.scale)))
        chain = np.ones_like(mixed)
        if self.weathering is not None:
            mixed, chain, by_iron = self.weathering.darken(mixed, local[:, -1])
            local_columns[:, :, -1] = by_iron
        ln_model, by_mixed = self.powders.law.ln_reflectance(mixed)
        local_columns[:, :, -1] *= by_mixed
        by_mixed = by_mixed * chain
        by_share = by_mixed[:, None, :] * apart
        lead = self.powders.section(shared)
        lead = lead / (local[:, : self.minerals] ** 2 @ lead)[:, None]
        bend = 2 * by_share * (lead * self.sought)[:, :, None]
        local_columns[:, :, : self.minerals] = (bend * local[:, : self.minerals, None]).transpose(0, 2, 1)
        stop = self.minerals + len(NEUTRAL)
        local_columns[:, :, self.minerals : stop] = self.neutral.T
        shared_columns = (by_share * effective[:, :, None]).transpose(0, 2, 1) @ self.powders.sections
        for number, (place, item) in enumerate(zip(self.powders.places, self.powders.minerals, strict=True)):
            weight = by_mixed * effective[:, number, None]
            shared_columns[:, :, place] += weight[:, :, None] * (slope[number] * item.shapes).T
        shared_columns[:, :, -1] += by_mixed * (effective @ slope)
        ln_model = ln_model + local[:, self.minerals : stop] @ self.neutral
        return ln_model, shared_columns, local_columns, bend


STEPS, DAMPING, HIGHEST_DAMPING = 500, 1e-3, 1e8
NEAR, CONVERGED = 0.1, 1e-5
"""Gains of a step at which starts are compared, and at which the best is done."""

LIFTED = 0.06
"""Least root at which curvature is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class SharesPosterior:
    """Normal approximation around the lowest minimum.

    Attributes
    ----------
    roots, covariance : (s, m) and (s, m, m): fractions are squares of roots over their sum.
    objective : chi-square and the prior's share together.
    ln_evidence : to a constant of the data.
    ln_residual : (s, n) data - model. [-]
    strain : (s,) the prior's share of the objective, that of the powders in equal parts: how unlike the end members the
        minerals must be taken. [-]
    """

    roots: FloatArray
    covariance: FloatArray
    objective: float
    ln_evidence: float
    ln_residual: FloatArray
    strain: FloatArray

    @property
    def shares(self) -> FloatArray:
        """Fractions at the minimum, (s, m)."""
        return shares(self.roots)

    def draws(self, count: int, seed: int) -> FloatArray:
        """Fractions drawn from the posterior, (count, s, m)."""
        rng = np.random.default_rng(seed)
        sizes, directions = np.linalg.eigh(self.covariance)
        root = directions * np.sqrt(np.maximum(sizes, 0.0))[:, None, :]
        normal = rng.standard_normal((count, *self.roots.shape))
        return shares(self.roots + np.einsum("sij,csj->csi", root, normal))


def shares(roots: FloatArray) -> FloatArray:
    """Fractions from roots along the last axis."""
    squares = roots**2
    return np.asarray(squares / squares.sum(axis=-1, keepdims=True))


def unmix(suite: MixtureSeries) -> SharesPosterior:
    """Fit all spectra of a sample series with powders common to all.

    One spectrum alone is started from equal shares and from each mineral in front, and the lowest minimum counts; a
    series from equal shares (on seven laboratory series of 3 to 20 mixtures no other start ended lower).

    References
    ----------
    Lapotre, Ehlmann & Minson (2017), J. Geophys. Res. Planets 122, 983, 10.1002/2016JE005248 (Bayesian unmixing).
    """
    favoured = [None, *(range(suite.minerals) if len(suite.ln_reflectance) == 1 else ())]
    shared = np.zeros(suite.powders.size)
    ends = [_descend(suite, shared, suite.start(mineral), NEAR) for mineral in favoured]
    shared, local, _ = min(ends, key=lambda end: end[2].value)
    return _posterior(suite, *_descend(suite, shared, local, CONVERGED))


def _descend(
    suite: MixtureSeries, shared: FloatArray, local: FloatArray, least_gain: float
) -> tuple[FloatArray, FloatArray, Equations]:
    """Levenberg-Marquardt; parameters and the equations there."""
    damping, equations = DAMPING, suite.equations(shared, local)
    for _ in range(STEPS):
        shared_step, local_step = _solve(equations, damping)
        value = suite.value(shared + shared_step, local + local_step)
        if not value < equations.value:
            damping *= 10.0
            if damping > HIGHEST_DAMPING:
                break
            continue
        gained = equations.value - value
        shared, local, damping = shared + shared_step, local + local_step, damping / 5.0
        equations = suite.equations(shared, local)
        if gained < least_gain:
            break
    return shared, local, equations


def _solve(equations: Equations, damping: float) -> tuple[FloatArray, FloatArray]:
    """The damped step, the spectra's own parameters eliminated first."""
    local = equations.local * (1.0 + damping * np.eye(equations.local.shape[-1]))
    inverse = np.linalg.inv(local)
    folded = np.matmul(equations.across, inverse)
    across = equations.across.transpose(0, 2, 1)
    shared = equations.shared * (1.0 + damping * np.eye(len(equations.shared)))
    left = shared - np.matmul(folded, across).sum(axis=0)
    right = equations.shared_slope - np.einsum("spq,sq->p", folded, equations.local_slope)
    step = np.linalg.solve(left, right)
    return step, np.einsum("sqr,sr->sq", inverse, equations.local_slope - across @ step)


def _posterior(suite: MixtureSeries, shared: FloatArray, local: FloatArray, lowest: Equations) -> SharesPosterior:
    """At a root of 0 the model does not change to first order; its curvature is that at `LIFTED`."""
    count = suite.minerals
    raised = local.copy()
    raised[:, :count] = np.where(suite.sought * (np.abs(local[:, :count]) < LIFTED) > 0, LIFTED, local[:, :count])
    equations = suite.equations(shared, raised)
    inverse = np.linalg.inv(equations.local)
    folded = np.matmul(equations.across, inverse)
    left = equations.shared - np.matmul(folded, equations.across.transpose(0, 2, 1)).sum(axis=0)
    back = folded.transpose(0, 2, 1)
    covariance = inverse + back @ np.linalg.inv(left) @ folded
    sought = suite.sought
    volume = float(np.linalg.slogdet(left)[1] + np.linalg.slogdet(equations.local)[1].sum())
    volume += 2 * len(local) * float(np.log(suite.scale).sum())
    strain = np.sum(shared**2) / len(local) + np.sum((local / suite.scale)[:, count:] ** 2, axis=1)
    return SharesPosterior(
        local[:, :count] * suite.present,
        covariance[:, :count, :count] * sought[:, :, None] * sought[:, None, :],
        lowest.value,
        -0.5 * (lowest.value + volume),
        suite.ln_reflectance - suite.ln_model(shared, local),
        strain,
    )


DRAWS, SEED = 4000, 0
MODEL_ERROR = 0.03
"""Standard deviation of ln R on channels of 20 nm that stands for end members unlike the mixture's own; measured:
with it 68 % intervals of laboratory mixtures hold the truth in 67-75 %, all samples of their series left out of the
library."""
LEAST_MINERALS, MOST_SPECTRA = 2, 500
"""Of a series of mixtures."""


def estimate_series(
    spectra: Sequence[Spectrum],
    minerals: Sequence[str],
    *,
    method: str = "unmix",
    end_members: Sequence[EndMember] | None = None,
    model_error: float = MODEL_ERROR,
    iron: bool = False,
    present: Sequence[Sequence[str] | None] | None = None,
    given: Sequence[Mapping[str, float] | None] | None = None,
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
    minerals : two or more of `WEIGHED`, and others that `end_members` holds, whose shares are left out. `opaque` has a
        flat embedded end member.
    method : `hapke` mixes single-scattering albedos, `absorbance` mixes -ln R, `unmix` weights both by their evidence.
    end_members : instead of the embedded ones; at least one per mineral, over the channels compared.
    model_error : standard deviation of ln R at 20 nm, above 0 and below 1. [-]
    iron : whether grains may be darkened by submicroscopic iron (`weathering`); with `hapke` only.
    present : of each spectrum, the minerals that it may hold; None for all.
    given : of each spectrum, the fractions of all minerals, summing to 1; None where they are sought. [-]

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
    laws = mixing_laws(method, iron=iron)
    names = [spectrum.id for spectrum in spectra]
    held = _held(names, minerals, present or [None] * len(names))
    fractions = _stated_fractions(names, minerals, given or [None] * len(names))
    data = on_common_channels(spectra)
    library = embedded_end_members(data.wavelength_nm) if end_members is None else end_members
    posteriors = [
        unmix(_suite(data, _powders(law, minerals, library, data), held, fractions, model_error, iron)) for law in laws
    ]
    places = {column: WEIGHED.index(name) for column, name in enumerate(minerals) if name in WEIGHED}
    return _mixed(posteriors, places, model_error, len(spectra) > 1)


def _mixed(posteriors: Sequence[SharesPosterior], places: Mapping[int, int], model_error: float, series: bool) -> Mixed:
    """Draws of all laws, as many of each as its evidence says; minerals that are not named have a share of 0.

    `places` are those in `WEIGHED` of columns of the draws; shares of other columns are left out, and the rest is all.
    """
    evidence = np.array([item.ln_evidence for item in posteriors])
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    counts = np.maximum(1, np.round(DRAWS * weight).astype(int))
    drawn = zip(posteriors, counts, strict=True)
    draws = np.concatenate([item.draws(int(count), SEED + k) for k, (item, count) in enumerate(drawn)])
    weighed = draws[..., [*places]]
    shares = weighed / weighed.sum(axis=-1, keepdims=True)
    square = sum(share * np.mean(item.ln_residual**2, axis=1) for share, item in zip(weight, posteriors, strict=True))
    strain = sum(share * item.strain for share, item in zip(weight, posteriors, strict=True))
    probabilities = np.zeros((draws.shape[1], len(WEIGHED), SHARES.size))
    probabilities[:, :, 0] = 1.0
    for k, place in enumerate(places.values()):
        probabilities[:, place] = shared_out(shares[:, :, k]).mean(axis=0)
    strange = square / model_error**2 + strain / posteriors[0].ln_residual.shape[1]
    return Mixed(probabilities, np.asarray(strange), np.sqrt(square), series)


def _check(spectra: Sequence[Spectrum], minerals: Sequence[str], model_error: float) -> None:
    if len(set(minerals)) < max(LEAST_MINERALS, len(minerals)):
        raise ParameterError("unmixing needs two or more minerals, each once")
    if not 0 < model_error < 1:
        raise ParameterError(f"model error is {model_error:g}; give a number above 0 and below 1, such as 0.03")
    if not 0 < len(spectra) <= MOST_SPECTRA:
        raise ParameterError(f"{len(spectra)} spectra together; give 1 to {MOST_SPECTRA}, or unmix one by one")


def _held(names: Sequence[str], minerals: Sequence[str], present: Sequence[Sequence[str] | None]) -> FloatArray:
    held = np.ones((len(names), len(minerals)))
    for row, name, some in zip(held, names, present, strict=True):
        if some is not None:
            row[:] = [mineral in some for mineral in minerals]
            if not row.any():
                raise ParameterError(f"{name}: none of the minerals stated is one of {', '.join(minerals)}")
    return held


def _stated_fractions(
    names: Sequence[str], minerals: Sequence[str], stated: Sequence[Mapping[str, float] | None]
) -> FloatArray:
    fractions = np.full((len(names), len(minerals)), np.nan)
    for row, name, given in zip(fractions, names, stated, strict=True):
        if given is None:
            continue
        row[:] = [given.get(mineral, 0.0) for mineral in minerals]
        if not (row.min() >= 0 and abs(row.sum() - 1) <= SUM_TOLERANCE):
            raise DataError(
                f"{name}: known fractions of {', '.join(minerals)} sum to {row.sum():g}; name all, with shares of 1"
            )
        row /= row.sum()
    return fractions


def _powders(law: MixingLaw, minerals: Sequence[str], library: Sequence[EndMember], data: CommonChannels) -> Powders:
    populations = [population(mineral, library, data.wavelength_nm, law) for mineral in minerals]
    if len(data.ln_reflectance) > 1:
        populations = [loosened(item, data.wavelength_nm) for item in populations]
    return Powders(law, populations)


def _suite(
    data: CommonChannels, powders: Powders, held: FloatArray, fractions: FloatArray, model_error: float, iron: bool
) -> MixtureSeries:
    weathering = Weathering(iron_absorption(data.wavelength_nm)) if iron else None
    sigma = np.hypot(data.noise, model_error)
    return MixtureSeries(powders, data.wavelength_nm, data.ln_reflectance, sigma, held, fractions, weathering)
