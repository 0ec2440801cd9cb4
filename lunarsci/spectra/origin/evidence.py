"""What the composition of rocks says of the craters that they may come from: ln Bayes factors against any composition.

Compared are shares of the minerals that both have, and band centres. The rock differs from the crater's mean by its own
error, the scatter within the crater, and what two methods disagree by (the systematic). The yardstick, ln Bayes
factor 0, is a rock of which nothing is known: shares uniform over all that add up to 1, centres uniform over the range
of lunar minerals. A crater whose composition is not known is no better and no worse than that.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.provenance import sha256
from lunarsci.spectra.origin.composition import MINERALS, SMALLEST_SIGMA, Composition, closed

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
        return ", ".join(compared) if compared else "nothing that both have, any composition"


@dataclass(frozen=True, slots=True, eq=False)
class CompositionRows:
    """Compositions of n rocks, NaN where something is not known.

    Attributes
    ----------
    modes, mode_sigmas : fractions of `MINERALS`. (n, 4)
    centers_nm, center_sigmas_nm : of `BAND_RANGE_NM`. (n, 2)
    correlation : of the modes, (n, 4, 4); independent where None.
    """

    modes: FloatArray
    mode_sigmas: FloatArray
    centers_nm: FloatArray
    center_sigmas_nm: FloatArray
    correlation: FloatArray | None = None

    @classmethod
    def of(cls, rocks: Sequence[Composition]) -> "CompositionRows":
        size = len(rocks)
        modes, bands = np.full((2, size, len(MINERALS)), np.nan), np.full((2, size, len(BAND_RANGE_NM)), np.nan)
        correlation = np.broadcast_to(np.eye(len(MINERALS)), (size, len(MINERALS), len(MINERALS))).copy()
        for row, rock in enumerate(rocks):
            places = [MINERALS.index(name) for name in rock.modes]
            for place, value in zip(places, rock.modes.values(), strict=True):
                modes[:, row, place] = value
            if rock.correlation is not None:
                correlation[row][np.ix_(places, places)] = rock.correlation
            for place, name in enumerate(BAND_RANGE_NM):
                bands[:, row, place] = rock.bands.get(name, (np.nan, np.nan))
        return cls(modes[0], modes[1], bands[0], bands[1], correlation)

    def part(self, rows: slice) -> "CompositionRows":
        """Some of them."""
        return CompositionRows(*(None if one is None else one[rows] for one in self._arrays))  # type: ignore[arg-type]

    def digest(self) -> str:
        """SHA-256 of all of them."""
        return sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in self._arrays if one is not None))

    @property
    def _arrays(self) -> tuple[FloatArray | None, ...]:
        return self.modes, self.mode_sigmas, self.centers_nm, self.center_sigmas_nm, self.correlation

    def shares(self, rows: IntArray, minerals: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Mean (r, k) and covariance (r, k, k) of the shares of some minerals, by number."""
        own = np.array(minerals)
        sigmas = np.maximum(self.mode_sigmas[np.ix_(rows, own)], SMALLEST_SIGMA)
        covariance = sigmas[:, :, None] * sigmas[:, None, :]
        if self.correlation is None:
            covariance = covariance * np.eye(len(minerals))
        else:
            covariance = self.correlation[np.ix_(rows, own, own)] * covariance
        return closed(self.modes[np.ix_(rows, own)], covariance)


@dataclass(frozen=True, slots=True, eq=False)
class EvidenceRows:
    """ln Bayes factors of n rocks and c craters, NaN where nothing could be compared. (n, c)"""

    ln_modes: FloatArray
    ln_bands: FloatArray
    rocks: CompositionRows
    craters: Sequence[Composition]

    @property
    def ln_total(self) -> FloatArray:
        """Their sum, 0 where nothing could be compared; as if both were independent. (n, c)"""
        return np.nan_to_num(self.ln_modes, nan=0.0) + np.nan_to_num(self.ln_bands, nan=0.0)

    def at(self, rock: int, crater: int) -> CompositionEvidence:
        """Of one rock and one crater."""
        modes, bands = self.ln_modes[rock, crater], self.ln_bands[rock, crater]
        known = self.craters[crater]
        minerals = [m for k, m in enumerate(MINERALS) if m in known.modes and np.isfinite(self.rocks.modes[rock, k])]
        centers = [b for k, b in enumerate(BAND_RANGE_NM) if b in known.bands and _known(self.rocks, k)[rock]]
        return CompositionEvidence(
            None if np.isnan(modes) else float(modes),
            None if np.isnan(bands) else float(bands),
            () if np.isnan(modes) else tuple(minerals),
            () if np.isnan(bands) else tuple(centers),
        )


def _known(rocks: CompositionRows, band: int) -> BoolArray:
    known: BoolArray = np.isfinite(rocks.centers_nm[:, band]) & np.isfinite(rocks.center_sigmas_nm[:, band])
    return known


def composition_evidence(
    rock: Composition, crater: Composition, *, systematic: float, band_systematic_nm: float
) -> CompositionEvidence:
    """The same as `evidence_rows` of one rock and one crater."""
    rows = CompositionRows.of([rock])
    return evidence_rows(rows, [crater], systematic=systematic, band_systematic_nm=band_systematic_nm).at(0, 0)


def evidence_rows(
    rocks: CompositionRows, craters: Sequence[Composition], *, systematic: float, band_systematic_nm: float
) -> EvidenceRows:
    """ln Bayes factors of the compositions of rocks, each crater against any composition.

    `systematic` is the standard deviation of the difference between two methods in the share of one mineral [-];
    `band_systematic_nm` that of a band centre [nm]. With fewer than two minerals in common modes are not compared.
    """
    shape = (len(rocks.modes), len(craters))
    ln_modes, ln_bands = np.full(shape, np.nan), np.full(shape, np.nan)
    for minerals, own, rows in _comparable(rocks, craters):
        seen, error = rocks.shares(rows, minerals)
        error = error + systematic**2 * np.eye(len(minerals))
        broad = ln_shares_broad(seen, error)
        for number in own:
            mean, scatter = craters[number].shares([MINERALS[place] for place in minerals])
            ln_modes[rows, number] = ln_shares_crater(seen, error, mean, scatter) - broad
    for number, crater in enumerate(craters):
        for place, name in enumerate(BAND_RANGE_NM):
            if name in crater.bands:
                rows = np.flatnonzero(_known(rocks, place))
                seen, error = rocks.centers_nm[rows, place], rocks.center_sigmas_nm[rows, place]
                found = _ln_band(name, seen, error, *crater.bands[name], band_systematic_nm)
                ln_bands[rows, number] = np.nan_to_num(ln_bands[rows, number], nan=0.0) + found
    return EvidenceRows(ln_modes, ln_bands, rocks, craters)


def _comparable(
    rocks: CompositionRows, craters: Sequence[Composition]
) -> Iterator[tuple[tuple[int, ...], list[int], IntArray]]:
    """Minerals by number, the craters that have them in common with some rocks, and the numbers of these rocks."""
    known = np.isfinite(rocks.modes)
    for kind in np.unique(known, axis=0):
        rows = np.flatnonzero((known == kind).all(axis=1))
        groups: dict[tuple[int, ...], list[int]] = {}
        for number, crater in enumerate(craters):
            minerals = tuple(k for k, name in enumerate(MINERALS) if kind[k] and name in crater.modes)
            if len(minerals) > 1 and sum(crater.modes[MINERALS[k]][0] for k in minerals) > 0:
                groups.setdefault(minerals, []).append(number)
        for minerals, own in groups.items():
            present = rows[rocks.modes[np.ix_(rows, np.array(minerals))].sum(axis=1) > 0]
            if present.size:
                yield minerals, own, present


def ln_shares_broad(seen: FloatArray, error: FloatArray) -> FloatArray:
    """ln density of measured shares (..., n) with errors (..., n, n) if the true ones are uniform over all of sum 1.

    The integral of N(seen; x, error) over the simplex over its volume: the share of draws from N(seen, error) inside.
    """
    y, cov = _reduced(seen, error)
    inside: FloatArray = np.log(_inside(y, cov)) - np.log(_volume(seen.shape[-1]))
    return inside


def ln_shares_crater(seen: FloatArray, error: FloatArray, mean: FloatArray, scatter: FloatArray) -> FloatArray:
    """ln density of measured shares (..., n) if the true ones are N(mean, scatter) cut to shares of 0 or more.

    N(seen; mean, error + scatter) times the probability of valid shares after, over that before the rock was seen.
    """
    y, noise = _reduced(seen, error)
    m, prior = _reduced(mean, scatter)
    total = noise + prior
    gain = np.swapaxes(np.linalg.solve(total, np.broadcast_to(prior, total.shape)), -1, -2)
    residual = y - m
    after_mean, after = m + (gain @ residual[..., None])[..., 0], prior - gain @ prior
    squares = (residual * np.linalg.solve(total, residual[..., None])[..., 0]).sum(axis=-1)
    ln_normal = -0.5 * (squares + np.linalg.slogdet(total)[1] + y.shape[-1] * np.log(2 * np.pi))
    density: FloatArray = ln_normal + (np.log(_inside(after_mean, after)) - np.log(_inside(m, prior)))
    return density


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
    basis = _basis(shares.shape[-1])
    return (shares - 1 / shares.shape[-1]) @ basis.T, basis @ covariance @ basis.T


def _inside(mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Probability that shares with these means and covariances (in differences) are all 0 or more. (..., n - 1)

    By the symmetric root of the covariance, which is one; its eigenvectors are not where variances are equal, and then
    those of one processor's LAPACK are not another's.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :] @ np.swapaxes(vectors, -1, -2)
    size = mean.shape[-1] + 1
    basis, draws = _basis(size), _normal_draws(size).T
    found = np.empty(mean.shape[:-1])
    for place in np.ndindex(found.shape):
        shares = basis.T @ (mean[place][:, None] + root[place] @ draws) + 1 / size
        found[place] = np.count_nonzero(shares.min(axis=0) >= 0) / DRAWS
    return np.maximum(found, LEAST_INSIDE)


def _volume(size: int) -> float:
    """Volume of the shares that add up to 1, in the coordinates of `_basis`: sqrt(n) / (n - 1)!"""
    from math import factorial, sqrt

    return sqrt(size) / factorial(size - 1)


def _ln_band(
    name: str, seen: FloatArray, error: FloatArray, mean: float, scatter: float, systematic_nm: float
) -> FloatArray:
    """ln Bayes factors of centres (n,): a normal law about the crater's against a uniform one over the range."""
    from scipy.stats import norm

    low, high = BAND_RANGE_NM[name]
    noise = np.hypot(error, systematic_nm)
    broad = (norm.cdf(high, seen, noise) - norm.cdf(low, seen, noise)) / (high - low)
    factor: FloatArray = norm.logpdf(seen, mean, np.hypot(noise, scatter)) - np.log(
        np.maximum(broad, np.finfo(float).tiny)
    )
    return factor
