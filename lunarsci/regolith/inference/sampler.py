"""Draws from the posterior of a soil without an approximation: a population carried from the prior to the data.

Particles begin as draws from the prior. The weight of the data is raised from 0 to 1 in steps that leave half of the
particles their share; at each step they are weighted, resampled, and moved by random walks as wide as the population.

Del Moral, Doucet & Jasra (2006), J. R. Stat. Soc. B 68, 411, 10.1111/j.1467-9868.2006.00553.x.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from lunarsci.arrays import FloatArray

KEPT = 0.5
"""Share of the particles that a step leaves, as an effective number."""
WANTED_ACCEPTANCE, TUNING = 0.25, 1.0
FORGOTTEN, FEWEST_MOVES, MOST_MOVES, LAST_MOVES = 0.8, 3, 20, 60
"""Correlation of the most persistent parameter with its values before the moves, below which a step has moved enough;
moves at a step and at the last one, which goes on until that correlation is below SETTLED."""
SETTLED = 0.2
SMALLEST = 1e-6
"""Width of a random walk where the population has none, in widths of the prior."""


def carry_population(
    ln_likelihood: Callable[[FloatArray], FloatArray],
    center: FloatArray,
    width: FloatArray,
    particles: int,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, float]:
    """Draws from a posterior with a normal prior.

    Parameters
    ----------
    ln_likelihood : of points (d, p), up to a constant; NaN or -inf where a point is impossible.
    center, width : (p,) of the prior.
    particles : how many.
    rng : source of random numbers.
    progress : called with (done, total).

    Returns
    -------
    (particles, p), and the largest correlation left with where they were before the last moves. [-]
    """

    def likelihood(points: FloatArray) -> FloatArray:
        return np.nan_to_num(ln_likelihood(points), nan=-np.inf)

    points = center + width * rng.standard_normal((particles, len(center)))
    value = likelihood(points)
    beta, scale = 0.0, 2.38 / np.sqrt(len(center))
    while True:
        rise = _rise(value, beta)
        weight = _weights(value, rise)
        beta += rise
        chosen = rng.choice(particles, particles, p=weight)
        points, value = points[chosen], value[chosen]
        factor = np.linalg.cholesky(np.cov(points.T) + np.diag((SMALLEST * width) ** 2))
        before, last = points.copy(), beta >= 1.0
        left = 1.0
        for move in range(LAST_MOVES if last else MOST_MOVES):
            trial = points + scale * rng.standard_normal(points.shape) @ factor.T
            found = likelihood(trial)
            gain = beta * (found - value) - 0.5 * np.sum(
                ((trial - center) / width) ** 2 - ((points - center) / width) ** 2, axis=1
            )
            accepted = np.log(rng.random(particles)) < gain
            points[accepted], value[accepted] = trial[accepted], found[accepted]
            scale *= np.exp(TUNING * (accepted.mean() - WANTED_ACCEPTANCE))
            left = autocorrelation(before, points)
            if move + 1 >= FEWEST_MOVES and left < (SETTLED if last else FORGOTTEN):
                break
        if progress is not None:
            progress(round(100 * min(1.0, 1 + np.log10(max(beta, 1e-9)) / 9)), 100)
        if last:
            return points, left


def _weights(value: FloatArray, rise: float) -> FloatArray:
    ln_weight = np.where(np.isfinite(value), rise * (value - value.max()), -np.inf)
    weight = np.exp(ln_weight)
    return np.asarray(weight / weight.sum())


def _rise(value: FloatArray, beta: float) -> float:
    """The rise of beta that leaves the wanted share of the particles, up to 1."""

    def excess(ln_rise: float) -> float:
        return 1 / float(np.sum(_weights(value, np.exp(ln_rise)) ** 2)) - KEPT * len(value)

    rest = 1.0 - beta
    if excess(np.log(rest)) >= 0:
        return rest
    lowest = np.log(rest) - 60.0
    if excess(lowest) <= 0:  # fewer possible points than wanted
        return rest * 1e-3
    return float(np.exp(brentq(excess, lowest, np.log(rest), xtol=1e-3)))


def autocorrelation(before: FloatArray, after: FloatArray) -> float:
    """Largest correlation of a coordinate of a population (d, p) with where it was before. [-]"""
    one, two = before - before.mean(axis=0), after - after.mean(axis=0)
    norm = np.sqrt(np.sum(one**2, axis=0) * np.sum(two**2, axis=0))
    return float(np.max(np.sum(one * two, axis=0) / np.where(norm > 0, norm, np.inf)))
