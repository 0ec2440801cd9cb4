"""Sequential Monte Carlo: a population of points carried from the prior to the data.

Points begin as draws from the prior. The data's share beta of the density is raised from 0 to 1 in steps that leave
half of the points their weight; at each step they are weighted, resampled, and moved until they have forgotten where
they were. How they move is the population's own.

Del Moral, Doucet & Jasra (2006), J. R. Stat. Soc. B 68, 411, 10.1111/j.1467-9868.2006.00553.x (the method); Jasra et
al. (2011), Scand. J. Stat. 38, 1, 10.1111/j.1467-9469.2010.00723.x (steps by the effective number); Douc & Cappé
(2005), 10.1109/ISPA.2005.195385 (systematic resampling).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lunarsci.arrays import FloatArray, IntArray

EFFECTIVE_LEFT = 0.5
"""Share of the points that a step of beta leaves, as an effective number."""
LEAST_LN_POWER, TOLERANCE = -60.0, 1e-9
"""Where the search for a step begins, and how near it ends, in the logarithm of the step."""
WALK, ACCEPTED = 2.38, 0.25
"""Width of a random walk in a normal law, in standard deviations over the root of its dimension, and the share of its
steps that is then accepted: 0.23 to 0.44 (Roberts, Gelman & Gilks 1997, Ann. Appl. Probab. 7, 110,
10.1214/aoap/1034625254)."""


@dataclass(frozen=True, slots=True)
class Moves:
    """When points have moved enough: when no coordinate's correlation with its values before is `decorrelated` or more,
    after `fewest` moves and `most` at the latest.

    With `mirrored`, correlations below 0 count as well, as of trajectories that may end on the other side.
    """

    fewest: int
    most: int
    decorrelated: float
    mirrored: bool = False


@dataclass(frozen=True, slots=True)
class Raise:
    """A step of beta that was made: the data's share after it, moves of every point, the largest correlation left."""

    beta: float
    moves: int
    left: float


class Moving(Protocol):
    """Points and how they move."""

    @property
    def points(self) -> FloatArray:
        """(n, p) as they are now."""

    def move(self, beta: float) -> None:
        """Move every point once, leaving prior times likelihood^beta as it is."""


class Population(Moving, Protocol):
    """Points on their way from the prior to the posterior."""

    @property
    def ln_likelihood(self) -> FloatArray:
        """(n,) of the points as they are now, up to a constant; -inf where one is impossible."""

    def resample(self, beta: float, weight: FloatArray, chosen: IntArray) -> None:
        """Go on, at `beta`, with the `chosen` points (n,), drawn by the weights (n,) of those before."""


def weights(ln_weight: FloatArray) -> FloatArray:
    """exp of it, with sum 1. (n,)"""
    weight = np.exp(ln_weight - ln_weight.max())
    return np.asarray(weight / weight.sum())


def effective_number(weight: FloatArray) -> float:
    """How many points of equal weight would do as well: 1 / sum of squares of weights with sum 1. [-]"""
    return 1.0 / float(weight @ weight)


def largest_power(ln_density: FloatArray, wanted: float, most: float = 1.0) -> float:
    """The largest power of a density, up to `most`, that leaves so many effective points. [-]

    `ln_density` (n,) is -inf where a point is impossible; of the possible ones at most half are wanted.
    """
    from scipy.optimize import brentq

    possible = np.isfinite(ln_density)
    off = np.where(possible, ln_density - ln_density.max(), -np.inf)
    wanted = wanted if wanted < possible.sum() else EFFECTIVE_LEFT * float(possible.sum())

    def excess(ln_power: float) -> float:
        return effective_number(weights(np.exp(ln_power) * off)) - wanted

    highest = float(np.log(most))
    if excess(highest) >= 0:
        return most
    return float(np.exp(brentq(excess, highest + LEAST_LN_POWER, highest, xtol=TOLERANCE)))


def systematic(weight: FloatArray, offset: float) -> IntArray:
    """Indices in proportion to weights with sum 1: those of n even steps of their sum, the first at offset / n. (n,)"""
    steps = (np.arange(len(weight)) + offset) / len(weight)
    return np.minimum(np.searchsorted(np.cumsum(weight), steps), len(weight) - 1)


def correlation(before: FloatArray, after: FloatArray, mirrored: bool = False) -> float:
    """Largest correlation, if `mirrored` of either sign, of a coordinate of points (n, p) with where it was; 1 where
    all points are one. [-]"""
    one, two = before - before.mean(axis=0), after - after.mean(axis=0)
    norm = np.sqrt(np.sum(one**2, axis=0) * np.sum(two**2, axis=0))
    varies = norm > 0
    each = np.where(varies, np.sum(one * two, axis=0) / np.where(varies, norm, 1.0), 1.0)
    return float(np.max(np.abs(each) if mirrored else each))


def mutate(
    population: Moving, beta: float, moves: Moves, progress: Callable[[int], None] = lambda done: None
) -> tuple[int, float]:
    """Move points until they have forgotten where they were; how often, and the correlation left.

    `progress` is called after each move with how many there were.
    """
    before, done, left = population.points.copy(), 0, 1.0
    while done < moves.fewest or (done < moves.most and left >= moves.decorrelated):
        population.move(beta)
        done, left = done + 1, correlation(before, population.points, moves.mirrored)
        progress(done)
    return done, left


def carry(
    population: Population, random: np.random.Generator, each: Moves, last: Moves | None = None
) -> Iterator[Raise]:
    """Carry draws from the prior to the posterior, one step of beta after the other.

    Parameters
    ----------
    population : its points are draws from the prior, at the end from the posterior.
    random : source of random numbers of the resampling.
    each, last : when points have moved enough at a step, and at that to beta = 1 where it is another.
    """
    beta = 0.0
    while beta < 1.0:
        value, rest = population.ln_likelihood, 1.0 - beta
        rise = largest_power(value, EFFECTIVE_LEFT * len(value), rest)
        beta = 1.0 if rise == rest else beta + rise
        weight = weights(rise * value)
        population.resample(beta, weight, systematic(weight, random.random()))
        yield Raise(beta, *mutate(population, beta, (last or each) if beta >= 1.0 else each))
