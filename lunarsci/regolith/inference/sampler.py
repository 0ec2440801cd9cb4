"""Draws from the posterior of a soil without an approximation: a population carried from the prior to the data.

`tempering` says how; here, points move by random walks as wide as the population.

Roberts, Gelman & Gilks (1997), Ann. Appl. Probab. 7, 110, 10.1214/aoap/1034625254 (width and acceptance of such walks).
"""

from collections.abc import Callable

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.tempering import Moves, carry

WANTED_ACCEPTANCE, TUNING = 0.25, 1.0
AT_A_STEP, AT_THE_LAST = Moves(3, 20, 0.8), Moves(3, 60, 0.2)
SMALLEST = 1e-6
"""Width of a random walk where the population has none, in widths of the prior."""


class _Walkers:
    """A population of `tempering` under a normal prior of independent coordinates."""

    def __init__(
        self,
        ln_likelihood: Callable[[FloatArray], FloatArray],
        center: FloatArray,
        width: FloatArray,
        particles: int,
        random: np.random.Generator,
    ) -> None:
        self._of, self._center, self._width, self._random = ln_likelihood, center, width, random
        self.points = center + width * random.standard_normal((particles, len(center)))
        self.ln_likelihood = self._possible(self.points)
        self._factor: FloatArray = np.diag(width)
        self._scale = 2.38 / np.sqrt(len(center))

    def resample(self, beta: float, weight: FloatArray, chosen: IntArray) -> None:
        covariance = np.cov(self.points.T, aweights=weight, ddof=0)
        covariance += np.diag((SMALLEST * self._width) ** 2)
        self._factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        self.points, self.ln_likelihood = self.points[chosen], self.ln_likelihood[chosen]

    def move(self, beta: float) -> None:
        trial = self.points + self._scale * self._random.standard_normal(self.points.shape) @ self._factor.T
        found = self._possible(trial)
        gain = beta * (found - self.ln_likelihood) + self._ln_prior(trial) - self._ln_prior(self.points)
        accepted = np.log(self._random.random(len(trial))) < gain
        self.points = np.where(accepted[:, None], trial, self.points)
        self.ln_likelihood = np.where(accepted, found, self.ln_likelihood)
        self._scale *= np.exp(TUNING * (accepted.mean() - WANTED_ACCEPTANCE))

    def _possible(self, points: FloatArray) -> FloatArray:
        return np.nan_to_num(self._of(points), nan=-np.inf)

    def _ln_prior(self, points: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * np.sum(((points - self._center) / self._width) ** 2, axis=1))


def carry_population(
    ln_likelihood: Callable[[FloatArray], FloatArray],
    center: FloatArray,
    width: FloatArray,
    particles: int,
    random: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, float]:
    """Draws from a posterior with a normal prior.

    Parameters
    ----------
    ln_likelihood : of points (d, p), up to a constant; NaN or -inf where a point is impossible.
    center, width : (p,) of the prior.
    particles : how many.
    random : source of random numbers.
    progress : called with (done, total).

    Returns
    -------
    (particles, p), and the largest correlation left with where they were before the last moves. [-]
    """
    population, left = _Walkers(ln_likelihood, center, width, particles, random), 1.0
    for step in carry(population, random, AT_A_STEP, AT_THE_LAST):
        left = step.left
        if progress is not None:
            progress(round(100 * min(1.0, 1 + np.log10(max(step.beta, 1e-9)) / 9)), 100)
    return population.points, left
