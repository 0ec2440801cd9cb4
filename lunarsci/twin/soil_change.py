"""Where along a drive the soil changes: one soil for the whole way is held against two, one after the other.

About the best single soil the states are linear in the transforms of the soil parameters. For every place of the way
two soils, before and after it, are fitted to the residuals by least squares with the first laws' widths as a penalty;
the statistic is how much more they explain than one (the likelihood ratio of a change at an unknown place: Andrews
1993, Econometrica 61, 821, 10.2307/2951764; Csorgo & Horvath 1997, Limit Theorems in Change-Point Analysis, Wiley).
Its largest value over all places is held against those of simulated drives over one soil, whose noise is as large and
as correlated along the way as what two soils leave.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.drive_pieces import Pieces

__all__ = ["FEWEST_PIECES", "Step", "largest_step"]

FloatArray = npt.NDArray[np.float64]
FEWEST_PIECES = 4
"""On either side of a change; assumed."""
SIMULATIONS = 999
MODEL_M = 3.0
"""Way over which errors of the twin itself are alike, such as an arc's; assumed. [m]"""
MOST_CORRELATED = 0.95
MARGIN = 1.0
"""Standard errors by which noise counts as more persistent than it was found: the p-value is that of an unkind case
within the uncertainty, as in Berger & Boos (1994), J. Am. Stat. Assoc. 89, 1012."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The most likely change: where, p-value, places tried and how much more two soils explain there. (k,), (k,)"""

    after_m: float
    p_value: float
    tried_m: FloatArray
    statistic: FloatArray


def largest_step(pieces: Pieces, random: np.random.Generator, simulations: int = SIMULATIONS) -> Step:
    """The most likely change and its p-value, no smaller than 1 / (simulations + 1).

    Parameters
    ----------
    pieces : residuals of the way, `2 * FEWEST_PIECES` or more, and how they follow the soil.
    random : source of random numbers.
    simulations : of drives over one soil.
    """
    size, quantities = pieces.mean.shape
    sigma = np.ones(quantities)
    for _ in range(2):
        fits = _Fits(pieces, sigma)
        statistic = fits.gain(fits.whitened(pieces.mean)[None])[0]
        best = int(np.argmax(statistic))
        sigma, persistence = _noise(pieces, fits.rest(best), fits.numbers(best) / quantities)
    fits = _Fits(pieces, sigma)
    statistic = fits.gain(fits.whitened(pieces.mean)[None])[0]
    roots = np.stack([_root(pieces, k, sigma[k], persistence[k]) for k in range(quantities)])
    noise = np.einsum("qab,qbc,dqc->dqa", fits.inverse, roots, random.standard_normal((simulations, quantities, size)))
    null = fits.gain(noise.reshape(simulations, -1)).max(axis=1)
    p_value = (1 + int((null >= statistic.max()).sum())) / (simulations + 1)
    tried = (0.5 * (pieces.middle_m[1:] + pieces.middle_m[:-1]))[fits.places]
    return Step(float(tried[int(np.argmax(statistic))]), p_value, tried, statistic)


class _Fits:
    """One soil, and two soils with a change at each place, fitted as if noise did not persist.

    What that costs is in the simulated drives, whose noise does.
    """

    def __init__(self, pieces: Pieces, sigma: FloatArray) -> None:
        size, quantities = pieces.mean.shape
        self.pieces = pieces
        self.places = slice(FEWEST_PIECES - 1, size - FEWEST_PIECES)
        self.inverse = np.linalg.inv(np.stack([_root(pieces, k, sigma[k], 0.0) for k in range(quantities)]))
        # Columns of the soil before each place, whitened: (places, quantities * pieces, 8).
        grown = np.cumsum(np.einsum("qab,bqp->bqap", self.inverse, pieces.slope), axis=0)
        self.whole = grown[-1].reshape(quantities * size, -1)
        self.before = grown[:-1][self.places].reshape(-1, *self.whole.shape)
        both = np.concatenate([self.before, self.whole - self.before], axis=-1)
        self.one = np.linalg.inv(self.whole.T @ self.whole + np.eye(self.whole.shape[1]))
        self.two = np.linalg.inv(np.swapaxes(both, 1, 2) @ both + np.eye(both.shape[-1]))

    def whitened(self, mean: FloatArray) -> FloatArray:
        """Means (m, q) as unit noise. (q * m,)"""
        return np.asarray(np.einsum("qab,bq->qa", self.inverse, mean).ravel())

    def gain(self, white: FloatArray) -> FloatArray:
        """How much more two soils explain than one, at each place, of several drives (d, q * m). (d, places)"""
        whole = white @ self.whole
        first = np.einsum("dn,knp->dkp", white, self.before, optimize=True)
        both = np.concatenate([first, whole[:, None] - first], axis=-1)
        explained = np.einsum("dkp,kpr,dkr->dk", both, self.two, both, optimize=True)
        return np.asarray(explained - np.einsum("dp,pr,dr->d", whole, self.one, whole)[:, None])

    def numbers(self, place: int) -> float:
        """How many numbers two soils take from the data: the trace of what maps means to fitted ones. [-]"""
        white = np.concatenate([self.before[place], self.whole - self.before[place]], axis=-1)
        return float(np.trace(self.two[place] @ (white.T @ white)))

    def rest(self, place: int) -> FloatArray:
        """What two soils with the change at a place leave. (m, q)"""
        slope, mean = self.pieces.slope, self.pieces.mean
        first = np.arange(len(mean)) <= place + self.places.start
        columns = np.concatenate([slope * first[:, None, None], slope * ~first[:, None, None]], axis=-1)
        white = np.concatenate([self.before[place], self.whole - self.before[place]], axis=-1)
        return np.asarray(mean - columns @ (self.two[place] @ (white.T @ self.whitened(mean))))


def _root(pieces: Pieces, quantity: int, sigma: float, persistence: float) -> FloatArray:
    """Root of the covariance of a quantity's means: noise of the values, and errors of the twin itself."""
    lag = np.abs(pieces.middle_m[:, None] - pieces.middle_m)
    number = np.rint(lag / max(float(np.min(np.diff(pieces.middle_m))), 1e-6))
    scale = sigma / np.sqrt(pieces.weight[:, quantity])
    noise = np.outer(scale, scale) * np.where(number > 0, persistence**number, 1.0)
    return np.linalg.cholesky(noise + pieces.model[quantity] ** 2 * np.exp(-lag / MODEL_M))


def _noise(pieces: Pieces, rest: FloatArray, fitted: float) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of one value, no smaller than stated, and persistence from piece to piece. (q,), (q,)

    `fitted` numbers were taken from each series. In n values a mean taken away hides (1 + 3 r) / n of the persistence r
    (Kendall 1954, Biometrika 41, 403), and so, about, does every other number; this and `MARGIN` are added.
    """
    size = len(rest)
    white = rest * np.sqrt(pieces.weight)
    square = np.maximum((white**2).sum(axis=0), np.finfo(float).tiny)
    lag = (white[1:] * white[:-1]).sum(axis=0) / square
    lag = lag + fitted * (1.0 + 3.0 * np.maximum(lag, 0.0)) / size
    lag = lag + MARGIN * np.sqrt((1.0 - np.minimum(lag**2, 1.0)) / size)
    sigma = np.sqrt(square / max(size - fitted, 0.25 * size))
    return np.maximum(sigma, 1.0), np.clip(lag, 0.0, MOST_CORRELATED)
