"""Shares of a spectrum by comparison with random mixtures: those most like it, corrected to it by regression.

Spectra are compared by their leading principal components, in which the discrepancy of the model (`Discrepancy`) and
the noise of the spectrum are added to the random mixtures: approximate Bayesian computation with a local linear
correction, Beaumont, Zhang & Balding (2002), Genetics 162, 2025.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.abundance.random_mixtures import RandomMixtures

NEIGHBOURS, RIDGE = 600, 3.0
"""Random mixtures compared closely, and the ridge of the regression in units of one of them; assumed."""
WIDTH_NM, ORIGIN_UM = 120.0, 1.45
CONTROLS, NEAREST, SEED = 400, 10, 1
"""Random mixtures that show how near the nearest ones usually are."""


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Standard deviations of what ln R of a real powder has beside the model's.

    Attributes
    ----------
    level, slope, bend : of what is constant, linear (per um) and quadratic (per um^2) in wavelength. [-]
    detail : of what varies over `WIDTH_NM`. [-]
    channel : of what differs between channels of 20 nm. [-]
    components : principal components that are compared.
    """

    level: float = 0.1
    slope: float = 0.05
    bend: float = 0.03
    detail: float = 0.01
    channel: float = 0.005
    components: int = 20

    def covariance(self, wavelength_nm: FloatArray) -> FloatArray:
        """(c, c) of ln R."""
        u = wavelength_nm / 1e3 - ORIGIN_UM
        terms = np.array([self.level * np.ones_like(u), self.slope * u, self.bend * (u**2 - np.mean(u**2))])
        apart = (wavelength_nm[:, None] - wavelength_nm) / WIDTH_NM
        detail = self.detail**2 * np.exp(-0.5 * apart**2)
        return np.asarray(terms.T @ terms + detail + self.channel**2 * np.eye(u.size))


@dataclass(frozen=True, slots=True, eq=False)
class SharesPosterior:
    """Weighted draws of what a spectrum may show.

    Attributes
    ----------
    mean, sigma : (m,) shares, and standard deviations of draws. [-]
    draws : (k, m) shares, `weight` (k,) of them, which sums to 1.
    index : (k,) places of the draws in the random mixtures.
    unlike : share of random mixtures that lie nearer to their like than this spectrum does. [-]
    rms_ln : root mean square of ln R less that of the draws' weighted mean. [-]
    """

    mean: FloatArray
    sigma: FloatArray
    draws: FloatArray
    weight: FloatArray
    index: FloatArray
    unlike: float
    rms_ln: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Random mixtures ready to be compared with spectra on their channels."""

    mixtures: RandomMixtures
    wavelength_nm: FloatArray
    discrepancy: Discrepancy

    @cached_property
    def _axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean spectrum, principal axes (c, p), and the clean mixtures along them (n, p)."""
        clean = self.mixtures.ln_reflectance
        mean = clean.mean(axis=0)
        total = np.cov(clean.T) + self.discrepancy.covariance(self.wavelength_nm)
        sizes, axes = np.linalg.eigh(total)
        axes = axes[:, ::-1][:, : self.discrepancy.components]
        axes = axes / np.sqrt(sizes[::-1][: axes.shape[1]])
        return mean, axes, (clean - mean) @ axes

    @cached_property
    def _normal(self) -> FloatArray:
        """Standard normal deviates for the noise, (n, p)."""
        rng = np.random.default_rng(SEED)
        return rng.standard_normal((len(self.mixtures.shares), self._axes[1].shape[1]))

    def _noisy(self, noise: FloatArray) -> FloatArray:
        """(n, p) with the model's discrepancy and the noise (c,) of a spectrum."""
        _, axes, clean = self._axes
        covariance = axes.T @ (self.discrepancy.covariance(self.wavelength_nm) + np.diag(noise**2)) @ axes
        return np.asarray(clean + self._normal @ np.linalg.cholesky(covariance).T)

    @cached_property
    def _usual(self) -> FloatArray:
        """Mean distances of random mixtures from those nearest to them, ascending."""
        noisy = self._noisy(np.zeros_like(self.wavelength_nm))
        chosen = np.random.default_rng(SEED).choice(len(noisy), min(CONTROLS, len(noisy)), replace=False)
        rest = np.delete(noisy, chosen, axis=0)
        return np.sort([_nearest(rest, noisy[one]) for one in chosen])

    def posterior(self, ln_reflectance: FloatArray, noise: FloatArray) -> SharesPosterior:
        """What one spectrum shows, (c,), with the standard errors of its ln R."""
        mean, axes, _ = self._axes
        noisy = self._noisy(noise)
        seen = (ln_reflectance - mean) @ axes
        square = np.sum((noisy - seen) ** 2, axis=1)
        count = min(NEIGHBOURS, len(square) - 1)
        index = np.argpartition(square, count)[:count]
        weight = 1.0 - square[index] / square[index].max() * (1 - 1e-9)
        weight /= weight.sum()
        draws = _corrected(self.mixtures.shares[index], noisy[index] - seen, weight)
        centre = np.maximum(weight @ draws, 0.0)
        centre /= centre.sum()
        draws = np.maximum(draws, 0.0)
        draws /= draws.sum(axis=1, keepdims=True)
        sigma = np.sqrt(weight @ (draws - centre) ** 2)
        nearest = _nearest(noisy, seen)
        unlike = float(np.searchsorted(self._usual, nearest) / len(self._usual))
        left = ln_reflectance - weight @ self.mixtures.ln_reflectance[index]
        return SharesPosterior(centre, sigma, draws, weight, index, unlike, float(np.sqrt(np.mean(left**2))))


def _nearest(points: FloatArray, seen: FloatArray) -> float:
    square = np.sum((points - seen) ** 2, axis=1)
    return float(np.sqrt(np.partition(square, NEAREST)[:NEAREST]).mean())


def _corrected(shares: FloatArray, apart: FloatArray, weight: FloatArray) -> FloatArray:
    """Shares moved to where the spectrum is, by a weighted ridge regression on the distance from it."""
    scale = apart.std(axis=0) + 1e-12
    design = np.column_stack([np.ones(len(apart)), apart / scale])
    weighted = design * (weight / weight.max())[:, None]
    normal = weighted.T @ design
    normal[np.arange(1, len(normal)), np.arange(1, len(normal))] += RIDGE
    slopes = np.linalg.solve(normal, weighted.T @ shares)
    return np.asarray(shares - design[:, 1:] @ slopes[1:])
