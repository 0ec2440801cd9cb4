"""How much a spectrum speaks for an assemblage: Laplace's approximation of the logarithm of the evidence."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.assemblages import BandPrior
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.result import MgmFit

NODES = 80
FIRST_DAMPING, STEPS = 1e-3, 8
LN_2PI = math.log(2.0 * math.pi)


def ln_evidence(fit: MgmFit) -> float:
    """ln of the probability of the spectrum given the assemblage, to a constant of the data and the continuum.

    The posterior is taken as normal about the fit: with f the objective there, Q the prior's precision, H half the
    Hessian of the objective (Gauss-Newton) and k the number of band parameters,

        ln Z = -f/2 + ln det(Q)/2 - ln P - ln det(H)/2 + ln T,

    powers of 2 pi cancelling but for the continuum's. Strengths are 0 or below: P is the share of the prior there and
    T that of the normal posterior. A parameter that the data press against a bound has the integral of a one-sided
    normal law instead. Comparable between assemblages under the same continuum, data and model error, and dependent on
    the widths of the priors. Against sampling it is right to 0.02 where the data tell the bands, off by 0.1-0.4 where
    strengths are within their errors of 0, and by up to 1.4 where errors are a hundredth of the bands or less.

    Raises
    ------
    ParameterError for a model with fixed parameters, whose prior is not normalised here. NaN where the fit has no
    finite curvature.

    References
    ----------
    Kass & Raftery (1995), J. Am. Stat. Assoc. 90, 773, 10.1080/01621459.1995.10476572.
    """
    if fit.model.fixed.any():
        raise ParameterError(f"{fit.id}: the evidence of a model with fixed parameters is not defined; free them")
    return EvidencePlace.at(fit.parameters, fit.model, fit.data, np.diag(np.sqrt(fit.data.weight))).ln_evidence()


@dataclass(frozen=True, slots=True, eq=False)
class EvidencePlace:
    """The objective of a model at a point, where errors of channels hang together.

    `whiten`, (n, n), makes residuals independent with unit variance; `curvature` is half the Hessian (Gauss-Newton),
    `descent` half the negative slope. The objective is infinite where the continuum is not above 0.
    """

    point: FloatArray
    model: MgmModel
    objective: float
    curvature: FloatArray
    descent: FloatArray

    @classmethod
    def at(cls, point: FloatArray, model: MgmModel, data: MgmData, whiten: FloatArray) -> "EvidencePlace":
        wavelength = data.wavelength_nm
        found = model_and_jacobian(point, wavelength / 1e3, model.basis(wavelength), model.logarithmic)
        if found is None:
            return cls(point, model, math.inf, np.full_like(model.precision, np.nan), np.full_like(point, np.nan))
        residual, jacobian = whiten @ (np.log(data.reflectance) - found[0]), found[1] @ whiten.T
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
        """See `ln_evidence`."""
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
    sign, value = np.linalg.slogdet(matrix)
    return float(value) if sign > 0 else math.nan


def _ln_volume(curvature: FloatArray, gradient: FloatArray, point: FloatArray, held: BoolArray, m: int) -> float:
    """ln of the integral of the posterior over its value at `point`, less k/2 ln 2 pi and m/2 ln 2 pi."""
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
