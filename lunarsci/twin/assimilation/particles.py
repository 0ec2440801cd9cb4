"""Draws from a posterior whose mode is known: proposed by an emulator of the drives, judged by drives.

Drives simulated about the mode train an emulator, chains on the emulator say where to simulate next, and after some
rounds the chain's points are proposed to particles that accept them by the true density, so that what the emulator
misses is put right. The emulator is a quadratic stand-in for residuals: they bend gently with linearised coordinates,
so that second-order polynomials of each one follow them over a posterior; the cost, a sum of their squares, then has
the bent valleys of the true one.

Rasmussen (2003), Bayesian Statistics 7, 651 (posterior of an emulator as proposal); Christen & Fox (2005), J. Comput.
Graph. Stat. 14, 795, 10.1198/106186005X76983 (approximation judged by the exact density); Robert & Casella (2004),
Monte Carlo Statistical Methods, 2nd ed., ch. 7 (independence Metropolis).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.tempering import ACCEPTED, WALK, Moves, forget, largest_power, weights
from lunarsci.twin.assimilation.posterior import DrivePosterior, PosteriorMode
from lunarsci.twin.assimilation.residuals import HUBER

SPARE, MOST_SHARED = 1.5, 0.9
"""Effective number of drives for each coefficient of the fit, at least, but for this share of all drives; assumed."""
RIDGE = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Emulator:
    """Cost of a drive as q^T A q, with q the monomials 1, v_i, v_i v_j of scaled coordinates v.

    Attributes
    ----------
    center, inverse : v = inverse (point - center). (p,), (p, p)
    form : A, symmetric and positive semi-definite. (m, m)
    """

    center: FloatArray
    inverse: FloatArray
    form: FloatArray

    def cost(self, points: FloatArray) -> FloatArray:
        """-2 ln likelihood up to a constant. (points,)"""
        q = monomials((points - self.center) @ self.inverse.T)
        return np.asarray(np.einsum("ij,ij->i", q @ self.form, q))


def monomials(scaled: FloatArray) -> FloatArray:
    """Of order 0, 1 and 2. (points, 1 + p + p (p + 1) / 2)"""
    row, column = _pairs(scaled.shape[1])
    return np.hstack([np.ones((len(scaled), 1)), scaled, scaled[:, row] * scaled[:, column]])


@cache
def _pairs(count: int) -> tuple[IntArray, IntArray]:
    """Both of each pair of so many, also of one with itself."""
    return np.triu_indices(count)


def fit_emulator(
    points: FloatArray, rows: FloatArray, cost: FloatArray, center: FloatArray, root: FloatArray
) -> Emulator:
    """Fit residuals by weighted least squares.

    Parameters
    ----------
    points : where drives were simulated. (d, p)
    rows : their residuals, each weighted so that squares add up to the cost. (d, r)
    cost : -2 ln of posterior; drives count less the higher theirs is. (d,)
    center, root : of a normal law about as wide as the posterior. (p,), lower Cholesky factor (p, p)
    """
    inverse: FloatArray = np.asarray(np.linalg.inv(root), dtype=np.float64)
    q = monomials((points - center) @ inverse.T)
    power = largest_power(-0.5 * cost, min(SPARE * q.shape[1], MOST_SHARED * len(cost)))
    weight = np.sqrt(weights(-0.5 * power * cost))[:, None]
    own = weight * q
    matrix = own.T @ own
    matrix[np.diag_indices(len(matrix))] *= 1.0 + RIDGE
    coefficients = np.linalg.solve(matrix, own.T @ (weight * rows))
    return Emulator(center, inverse, coefficients @ coefficients.T)


FIRST, EACH, ROUNDS = 192, 128, 4
"""Drives of the first round and of each later one, and rounds at most."""
GOOD = 0.3
"""Standard deviation of the emulator's ln density, at new draws, below which it is trained enough; assumed."""
FREEDOM = 6.0
"""Degrees of freedom of the Student law of the first round; assumed: tails heavier than a posterior's."""
CHAIN, TUNED = 600, 200
"""Steps of a chain on the emulator, of which so many tune it."""
DIFFERENT = 0.25
"""Effective number of drives that chains begin at, as a share of the chains or the drives; assumed."""
PROPOSALS = Moves(3, 12, 0.1)
"""Proposals to the population."""
TOGETHER = 512
"""Chains that walk side by side, so that few particles cost no more steps than many; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class _Drives:
    """Simulated drives: points (d, p), residuals weighted as at the mode (d, r), ln density (d,)."""

    points: FloatArray
    rows: FloatArray
    ln_density: FloatArray

    def joined(self, more: "_Drives") -> "_Drives":
        return _Drives(
            np.vstack([self.points, more.points]),
            np.vstack([self.rows, more.rows]),
            np.concatenate([self.ln_density, more.ln_density]),
        )


def draw_particles(
    posterior: "DrivePosterior",
    mode: "PosteriorMode",
    particles: int,
    random: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, float]:
    """Draws from a posterior.

    Parameters
    ----------
    posterior : residuals and prior over linearised coordinates.
    mode : its most probable point.
    particles : how many draws.
    random : source of random numbers.
    progress : called with (done, total).

    Returns
    -------
    (particles, 8) coordinates, and the largest correlation of one of them with where the last moves began. [-]
    """
    told, total = progress or (lambda done, of: None), ROUNDS + PROPOSALS.most
    weight = _huber_weight(posterior, mode)
    root: FloatArray = np.asarray(np.linalg.cholesky(mode.covariance), dtype=np.float64)
    noise = random.standard_normal((FIRST, len(root))) @ root.T
    spread = np.sqrt(random.chisquare(FREEDOM, FIRST) / FREEDOM)[:, None]
    drives = _simulated(posterior, weight, np.vstack([mode.point, mode.point + noise / spread]))
    for number in range(ROUNDS):
        told(number, total)
        emulated = _Emulated(posterior, drives, mode, root)
        chain = emulated.chain(drives, EACH, random)
        fresh = _simulated(posterior, weight, chain)
        misses = fresh.ln_density - emulated.ln_density(fresh.points)
        drives = drives.joined(fresh)
        if len(misses) > EACH // 2 and np.std(misses) < GOOD:
            break
    emulated = _Emulated(posterior, drives, mode, root)
    population = _Proposed(posterior, emulated, drives, particles, random)
    return _moved(population, lambda done: told(ROUNDS + done, total))


def _huber_weight(posterior: "DrivePosterior", mode: "PosteriorMode") -> FloatArray:
    """Root of Huber's weight of each residual at the mode. (r,)"""
    here = np.abs(posterior.residuals(mode.point[None])[0][0])
    return np.asarray(np.sqrt(HUBER / np.maximum(here, HUBER)))


def _simulated(posterior: "DrivePosterior", weight: FloatArray, points: FloatArray) -> _Drives:
    """Those that arrive."""
    rows, ln_density = posterior.with_density(points)
    arrived = np.isfinite(ln_density)
    return _Drives(points[arrived], weight * rows[arrived], ln_density[arrived])


class _Emulated:
    """The posterior with drives by an emulator, prior and coordinates as they are."""

    def __init__(self, posterior: "DrivePosterior", drives: _Drives, mode: "PosteriorMode", root: FloatArray) -> None:
        self.posterior = posterior
        self.emulator = fit_emulator(drives.points, drives.rows, -2.0 * drives.ln_density, mode.point, root)

    def ln_density(self, points: FloatArray) -> FloatArray:
        """Up to the same constant as the true one; -inf where there is no soil. (points,)"""
        return self.posterior.ln_prior(points) - 0.5 * self.emulator.cost(points)

    def chain(self, drives: _Drives, count: int, random: np.random.Generator) -> FloatArray:
        """Ends of as many random walks, begun at drives by their density. (count, p)"""
        points = drives.points[_by_density(self.ln_density(drives.points), count, random)]
        values, scale = self.ln_density(points), WALK / np.sqrt(points.shape[1])
        root = np.linalg.inv(self.emulator.inverse)
        for step in range(CHAIN):
            if step % (TUNED // 4) == 0 and 0 < step <= TUNED:
                root = np.linalg.cholesky(np.cov(points.T) + 1e-9 * root @ root.T)
            trial = points + scale * random.standard_normal(points.shape) @ root.T
            found = self.ln_density(trial)
            accepted = np.log(random.random(count)) < found - values
            points, values = np.where(accepted[:, None], trial, points), np.where(accepted, found, values)
            if step < TUNED:
                scale *= np.exp(0.3 * (accepted.mean() - ACCEPTED))
        return points


def _by_density(ln_density: FloatArray, count: int, random: np.random.Generator) -> IntArray:
    """Indices drawn by a flattened density, so that many of them differ. (count,)"""
    power = largest_power(ln_density, DIFFERENT * min(count, len(ln_density)))
    return random.choice(len(ln_density), count, p=weights(power * ln_density))


class _Proposed:
    """Independence Metropolis: draws of the emulator are accepted by how much denser the truth has them."""

    def __init__(
        self,
        posterior: "DrivePosterior",
        emulated: _Emulated,
        drives: _Drives,
        particles: int,
        random: np.random.Generator,
    ) -> None:
        self._posterior, self._emulated, self._drives, self._random = posterior, emulated, drives, random
        self._ready: list[FloatArray] = []
        self.points, self.excess = self._drawn(particles)

    def _drawn(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Points of the emulator's chains, and by how much the truth has them denser."""
        if not self._ready:
            times = min(max(TOGETHER // count, 1), PROPOSALS.most + 1)
            ends = self._emulated.chain(self._drives, times * count, self._random)
            self._ready = list(self._random.permutation(ends).reshape(times, count, -1))
        points = self._ready.pop()
        return points, self._posterior.with_density(points)[1] - self._emulated.ln_density(points)

    def move(self, beta: float) -> None:
        trial, found = self._drawn(len(self.points))
        accepted = ~(np.log(self._random.random(len(trial))) >= found - self.excess)
        self.points = np.where(accepted[:, None], trial, self.points)
        self.excess = np.where(accepted, found, self.excess)


def _moved(population: _Proposed, told: Callable[[int], None]) -> tuple[FloatArray, float]:
    _, left = forget(population, 1.0, PROPOSALS, told)
    told(PROPOSALS.most)
    arrived = np.flatnonzero(np.isfinite(population.excess))
    return population.points[arrived[np.arange(len(population.points)) % len(arrived)]], left
