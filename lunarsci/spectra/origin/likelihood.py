"""How much better a rock's composition goes with a crater's than with any composition at all.

Compared are shares of the minerals that both have, and band centres. The rock differs from the crater's mean by its own
error, the scatter within the crater, and what two methods disagree by (the systematic). The yardstick, ln Bayes
factor 0, is a rock of which nothing is known: shares uniform over all that add up to 1, centres uniform over the range
of lunar minerals. A crater whose composition is not known is no better and no worse than that.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from lunarsci.spectra.origin.composition import MINERALS, Composition
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["BAND_RANGE_NM", "CompositionEvidence", "composition_evidence", "ln_shares_broad", "ln_shares_crater"]

BAND_RANGE_NM = {"bc1000_nm": (880.0, 1070.0), "bc2000_nm": (1780.0, 2350.0)}
"""Centres a lunar rock may have, from Mg-orthopyroxene to augite and olivine mixtures; assumed. [nm]"""
DRAWS = 8192
LEAST_INSIDE = 0.5 / DRAWS
"""Share of draws inside where none is: the ln Bayes factor is then an upper bound near its true value."""


@dataclass(frozen=True, slots=True)
class CompositionEvidence:
    """ln Bayes factors of a crater's composition against any composition.

    Attributes
    ----------
    ln_modes, ln_bands : of the shares and of the centres; None where they cannot be compared.
    minerals, bands : what was compared.
    """

    ln_modes: float | None
    ln_bands: float | None
    minerals: tuple[str, ...]
    bands: tuple[str, ...]

    @property
    def ln_total(self) -> float:
        """Their sum, 0 where nothing could be compared; as if both were independent."""
        return (self.ln_modes or 0.0) + (self.ln_bands or 0.0)

    @property
    def basis(self) -> str:
        """What was compared, in words."""
        compared = [*(["modes " + "+".join(self.minerals)] if self.minerals else []), *self.bands]
        return ", ".join(compared) if compared else "nothing: unknown, any composition"


def composition_evidence(
    rock: Composition, crater: Composition, *, systematic: float, band_systematic_nm: float
) -> CompositionEvidence:
    """ln Bayes factors of a rock's composition, crater against any composition.

    `systematic` is the standard deviation of the difference between two methods in the share of one mineral [-];
    `band_systematic_nm` that of a band centre [nm]. With fewer than two minerals in common modes are not compared.
    """
    minerals = tuple(name for name in MINERALS if name in rock.modes and name in crater.modes)
    minerals = minerals if len(minerals) > 1 and _present(rock, minerals) and _present(crater, minerals) else ()
    bands = tuple(name for name in BAND_RANGE_NM if name in rock.bands and name in crater.bands)
    ln_modes = None
    if minerals:
        seen, error = rock.shares(minerals)
        error = error + systematic**2 * np.eye(len(minerals))
        mean, scatter = crater.shares(minerals)
        ln_modes = ln_shares_crater(seen, error, mean, scatter) - ln_shares_broad(seen, error)
    ln_bands = sum((_ln_band(name, rock, crater, band_systematic_nm) for name in bands), 0.0) if bands else None
    return CompositionEvidence(ln_modes, ln_bands, minerals, bands)


def _present(composition: Composition, minerals: tuple[str, ...]) -> bool:
    return sum(composition.modes[name][0] for name in minerals) > 0


def ln_shares_broad(seen: FloatArray, error: FloatArray) -> float:
    """ln density of measured shares (n,) if the true ones are uniform over all that add up to 1.

    The integral of N(seen; x, error) over the simplex over its volume: the share of draws from N(seen, error) inside.
    """
    y, cov = _reduced(seen, error)
    return float(np.log(_inside(y, cov, seen.size)) - np.log(_volume(seen.size)))


def ln_shares_crater(seen: FloatArray, error: FloatArray, mean: FloatArray, scatter: FloatArray) -> float:
    """ln density of measured shares (n,) if the true ones are N(mean, scatter) cut to shares of 0 or more.

    N(seen; mean, error + scatter) times the probability of valid shares after, over that before the rock was seen.
    """
    y, noise = _reduced(seen, error)
    m, prior = _reduced(mean, scatter)
    total = noise + prior
    gain = np.linalg.solve(total, prior).T
    after_mean, after = m + gain @ (y - m), prior - gain @ prior
    residual = y - m
    ln_normal = -0.5 * (
        residual @ np.linalg.solve(total, residual) + np.linalg.slogdet(total)[1] + y.size * np.log(2 * np.pi)
    )
    inside = np.log(_inside(after_mean, after, seen.size)) - np.log(_inside(m, prior, seen.size))
    return float(ln_normal + inside)


@cache
def _basis(size: int) -> FloatArray:
    """Orthonormal directions (size - 1, size) of differences between shares: Helmert's rows."""
    rows = [[1.0] * k + [-float(k)] + [0.0] * (size - k - 1) for k in range(1, size)]
    return np.array([np.array(row) / np.linalg.norm(row) for row in rows])


@cache
def _normal_draws(size: int) -> FloatArray:
    """Standard normal points (DRAWS, size - 1) that fill space evenly, the same in every run."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    points = qmc.Sobol(size - 1, scramble=False).random(2 * DRAWS)[DRAWS:]
    return np.asarray(ndtri(points), float)


def _reduced(shares: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    basis = _basis(shares.size)
    return basis @ (shares - 1 / shares.size), basis @ covariance @ basis.T


def _inside(mean: FloatArray, covariance: FloatArray, size: int) -> float:
    """Probability that shares with this mean and covariance (in differences) are all 0 or more."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    shares = (mean + _normal_draws(size) @ root.T) @ _basis(size) + 1 / size
    return max(float(np.mean((shares >= 0).all(axis=1))), LEAST_INSIDE)


def _volume(size: int) -> float:
    """Volume of the shares that add up to 1, in the coordinates of `_basis`: sqrt(n) / (n - 1)!"""
    from math import factorial, sqrt

    return sqrt(size) / factorial(size - 1)


def _ln_band(name: str, rock: Composition, crater: Composition, systematic_nm: float) -> float:
    """ln Bayes factor of one centre: a normal law about the crater's against a uniform one over the range."""
    from scipy.stats import norm

    (seen, error), (mean, scatter) = rock.bands[name], crater.bands[name]
    low, high = BAND_RANGE_NM[name]
    noise = float(np.hypot(error, systematic_nm))
    broad = (norm.cdf(high, seen, noise) - norm.cdf(low, seen, noise)) / (high - low)
    return float(norm.logpdf(seen, mean, np.hypot(noise, scatter)) - np.log(max(broad, np.finfo(float).tiny)))
