"""The probability that a rock comes from each of the candidate craters, and what it is made of.

How much better a rock's composition goes with a crater's than with any composition at all.

Compared are shares of the minerals that both have, and band centres. The rock differs from the crater's mean by its own
error, the scatter within the crater, and what two methods disagree by (the systematic). The yardstick, ln Bayes
factor 0, is a rock of which nothing is known: shares uniform over all that add up to 1, centres uniform over the range
of lunar minerals. A crater whose composition is not known is no better and no worse than that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.catalogue import Crater, Point, azimuth_deg
from lunarsci.spectra.origin.composition import MINERALS, Composition, Rock
from lunarsci.spectra.origin.prior import CraterPrior, PriorSettings, crater_priors, launch_speed_m_s

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


OTHER = "other source"
LEADS, DECIDES = 0.5, 3.0
"""Posterior from which a crater is called the likeliest, and ln Bayes factor from which composition decides (about
20 : 1, 'strong' in Kass & Raftery 1995, 10.1080/01621459.1995.10476572)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """`systematic` of a mineral's share between two methods [-], of a band centre [nm], and the prior's settings."""

    systematic: float = 0.10
    band_systematic_nm: float = 10.0
    use_modes: bool = True
    use_bands: bool = True
    prior: PriorSettings

    def __post_init__(self) -> None:
        if not 0 <= self.systematic <= 1:
            raise ParameterError(f"systematic is {self.systematic:g}; it is a fraction from 0 to 1")
        if not 0 <= self.band_systematic_nm <= 500:
            raise ParameterError(f"systematic of the bands is {self.band_systematic_nm:g} nm; it must be 0 to 500")


@dataclass(frozen=True, slots=True)
class CraterMatch:
    """One rock and one crater; `posterior` is prior times exp of the ln Bayes factor, over the sum of all."""

    crater: Crater
    prior: CraterPrior
    evidence: CompositionEvidence
    posterior: float
    azimuth_deg: float | None
    launch_speed_m_s: float | None

    @property
    def ln_bayes_factor(self) -> float:
        """Composition alone, against a rock of any composition."""
        return self.evidence.ln_total

    @property
    def contains_site(self) -> bool:
        """Whether the site lies within the rim, so that it has no ejecta there."""
        return self.prior.ejecta_m is None

    def to_dict(self) -> dict[str, Any]:
        """The keys of a crater in `lunarsci spectra match --json`."""
        low, high = self.crater.age_ma
        return {
            "name": self.crater.name,
            "latitude_deg": self.crater.latitude_deg,
            "longitude_deg": self.crater.longitude_deg,
            "diameter_km": self.crater.diameter_km,
            "age_low_ma": low,
            "age_high_ma": high,
            "distance_km": self.prior.distance_km,
            "azimuth_deg": self.azimuth_deg,
            "contains_site": self.contains_site,
            "ejecta_m": self.prior.ejecta_m,
            "launch_speed_m_s": self.launch_speed_m_s,
            "log_bayes_factor": self.ln_bayes_factor,
            "log_bayes_factor_modes": self.evidence.ln_modes,
            "log_bayes_factor_bands": self.evidence.ln_bands,
            "compared": self.evidence.basis,
            "prior": self.prior.probability,
            "posterior": self.posterior,
            "terms": {
                "survival": self.prior.survival,
                "above_surface": self.prior.above_surface,
                "stages": dict(self.prior.stages),
            },
            "sources": dict(self.crater.sources),
        }


@dataclass(frozen=True, slots=True)
class RockMatch:
    """One rock: all craters in the catalogue's order, the probability of other sources, and a sentence."""

    rock: Rock
    craters: tuple[CraterMatch, ...]
    other_prior: float
    other_posterior: float
    status: str

    def to_dict(self) -> dict[str, Any]:
        """The keys of a rock in `lunarsci spectra match --json`."""
        composition = self.rock.composition
        best = max(self.craters, key=lambda item: item.posterior)
        return {
            "id": self.rock.id,
            "modes": {name: {"fraction": v, "sigma": s} for name, (v, s) in composition.modes.items()},
            "bands": {name: {"center_nm": v, "sigma_nm": s} for name, (v, s) in composition.bands.items()},
            "craters": [item.to_dict() for item in self.craters],
            "other": {"log_bayes_factor": 0.0, "prior": self.other_prior, "posterior": self.other_posterior},
            "best": best.crater.name if best.posterior > self.other_posterior else OTHER,
            "remarks": list(self.rock.remarks),
            "status": self.status,
        }


def match_rocks(
    rocks: Sequence[Rock], craters: Sequence[Crater], site: Point, settings: MatchSettings
) -> list[RockMatch]:
    """Match rocks found at one site (latitude, longitude in deg) with candidate craters.

    Raises ParameterError where no crater can have delivered a rock to the site.
    """
    priors = crater_priors(craters, site, settings.prior)
    return [_match(rock, craters, priors, site, settings) for rock in rocks]


def _match(
    rock: Rock, craters: Sequence[Crater], priors: Sequence[CraterPrior], site: Point, settings: MatchSettings
) -> RockMatch:
    seen = Composition(
        rock.composition.modes if settings.use_modes else {},
        rock.composition.bands if settings.use_bands else {},
        rock.composition.correlation if settings.use_modes else None,
    )
    evidence = [
        composition_evidence(
            seen,
            crater.composition,
            systematic=settings.systematic,
            band_systematic_nm=settings.band_systematic_nm,
        )
        for crater in craters
    ]
    other = settings.prior.other_weight
    probabilities = _posterior([*(p.probability for p in priors), other], [*(e.ln_total for e in evidence), 0.0])
    matches = tuple(
        CraterMatch(
            crater,
            prior,
            item,
            probability,
            azimuth_deg(site, crater.center),
            launch_speed_m_s(crater.diameter_km, prior.distance_km),
        )
        for crater, prior, item, probability in zip(craters, priors, evidence, probabilities, strict=False)
    )
    return RockMatch(rock, matches, other, probabilities[-1], _status(matches, probabilities[-1], other))


def _posterior(priors: Sequence[float], ln_factors: Sequence[float]) -> list[float]:
    """Priors times exp of the ln Bayes factors, over their sum; exact however small they are."""
    with np.errstate(divide="ignore"):
        ln = np.log(np.array(priors)) + np.array(ln_factors)
    weights = np.exp(ln - ln.max())
    return [float(value) for value in weights / weights.sum()]


def _status(matches: Sequence[CraterMatch], other: float, other_prior: float) -> str:
    """One sentence: what leads, and whether it is composition or the prior that says so."""
    compared = [item for item in matches if item.evidence.minerals or item.evidence.bands]
    if not compared:
        return "composition decides nothing: no crater has a composition to compare with; the posterior is the prior"
    if other >= LEADS and other > 2 * other_prior:
        return "goes with none of the craters whose composition is known: another source is likelier than all of them"
    first = max(matches, key=lambda item: item.posterior)
    lead = "likeliest" if first.posterior >= LEADS else "none is likely; the first is"
    factors = [item.ln_bayes_factor for item in matches if not item.contains_site]
    spread = max(factors) - min(factors)
    decisive = "composition speaks strongly" if spread >= DECIDES else "composition hardly decides, the prior does"
    return f"{lead} {first.crater.name} ({first.posterior:.2f}); {decisive} (ln Bayes factors differ by {spread:.1f})"
