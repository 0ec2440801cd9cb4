"""How unusual a value is among the members of an ensemble, whatever its law and however its parts hang together.

The drive that happens is one more draw of the law that the members are drawn from, if the prediction is right. So its
distance from them is held against the distance of each member, errors of measurement included, from the others. That
counts correlation between neighbours, wheels and quantities for what it is. Beyond the farthest member the probability
falls on as it falls among the farthest of them, and not faster than in the normal law.

How well a sharp prediction met what came: continuous ranked probability score, energy score, and ranks.
"""

from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Standing:
    """A drive held against the members.

    Attributes
    ----------
    squared : squared Mahalanobis distance of the drive from the members' mean. [-]
    dimensions : of the vector.
    p : probability of a drive at least as far off, were the prediction right.
    ln_density : ln of the normal predictive density at the drive, in the units of the vector.
    farther : members that are farther off than the drive, of `members`.
    """

    squared: float
    dimensions: int
    p: float
    ln_density: float
    farther: int
    members: int

    @property
    def distance(self) -> float:
        """Mahalanobis distance. [-]"""
        return float(np.sqrt(self.squared))


def spread_of(members: FloatArray, error: FloatArray) -> FloatArray:
    """Covariance of a measured draw about the members' mean: C (1 + 1/M) + R. (d, d)

    `members` are (M, d), `error` is the covariance R of the measurement (d, d).
    """
    count = len(members)
    off = members - members.mean(axis=0)
    return np.asarray(off.T @ off / (count - 1) * (1.0 + 1.0 / count) + error)


def region_edge(probability: float, members: int, dimensions: int) -> float:
    """Squared distance within which a draw falls with this probability: (M-1) d / (M-d) F(d, M-d).

    Prediction region of Hotelling (1931), Ann. Math. Stat. 2, 360, 10.1214/aoms/1177732979; with an error of
    measurement that is known, it is somewhat too wide. Infinite with no more members than dimensions. [-]
    """
    from scipy.special import fdtri

    if members <= dimensions:
        return float("inf")
    factor = (members - 1) * dimensions / (members - dimensions)
    return float(factor * fdtri(dimensions, members - dimensions, probability))


def _beyond(squared: float, members: int, dimensions: int) -> float:
    from scipy.special import fdtrc

    factor = (members - 1) * dimensions / (members - dimensions)
    return float(fdtrc(dimensions, members - dimensions, squared / factor))


def inside(off: FloatArray, members: FloatArray, error: FloatArray, probability: float) -> bool:
    """Whether a measured point, `off` from the members' mean, lies in the region of a probability."""
    return bool(_squared(off, spread_of(members, error)) <= region_edge(probability, len(members), len(off)))


def _squared(off: FloatArray, spread: FloatArray) -> float:
    return float(off @ np.linalg.solve(spread, off))


def squared_distances(
    members: FloatArray, error: FloatArray, random: np.random.Generator, free: float = np.inf
) -> FloatArray:
    """Squared distance of each member, with an error of measurement added, from the others. (M,)

    Where the size of the error is only known from `free` values, the errors added differ from it as much. Mean
    and scatter without a member follow from those of all by a change of rank one.
    """
    count, size = members.shape
    # Rounding of an error of measurement that is 0 must not fail.
    noise = random.multivariate_normal(np.zeros(size), error, count, method="eigh", check_valid="ignore")
    if np.isfinite(free):
        noise *= np.sqrt(free / random.chisquare(free, count))[:, None]
    measured = members + noise
    mean = members.mean(axis=0)
    off = members - mean
    scatter = off.T @ off
    others_mean = mean - off / (count - 1)
    others = scatter - count / (count - 1) * np.einsum("mi,mj->mij", off, off)
    spread = others / (count - 2) * (1.0 + 1.0 / (count - 1)) + error
    away = measured - others_mean
    return np.asarray(np.einsum("mi,mi->m", away, np.linalg.solve(spread, away[..., None])[..., 0]))


def standing(
    observed: FloatArray, members: FloatArray, error: FloatArray, seed: int = 0, free: float = np.inf
) -> Standing | None:
    """Hold a measured vector (d,) against members (M, d), with the covariance of its error (d, d).

    The probability is (1 + number of members farther off) / (M + 1), exact for draws of one law: G. A. Barnard (1963),
    J. R. Stat. Soc. B 25, 294; J. Besag & P. Clifford (1989), Biometrika 76, 633, 10.1093/biomet/76.4.633. Beyond all
    members it falls from there as a power of the distance, as steep as among the farthest sqrt(M) of them (B. Hill
    (1975), Ann. Stat. 3, 1163, 10.1214/aos/1176343247), but not steeper than the F law of normal draws. None with fewer
    than d + 3 members.
    """
    count, size = members.shape
    if count < size + 3:
        return None
    scale = np.sqrt(np.diag(spread_of(members, error)))
    scale = np.where(scale > 0, scale, 1.0)
    scaled, error = members / scale, error / np.outer(scale, scale)
    spread = spread_of(scaled, error)
    off = observed / scale - scaled.mean(axis=0)
    squared = _squared(off, spread)
    each = squared_distances(scaled, error, np.random.default_rng(seed), free)
    ln_det = float(np.linalg.slogdet(spread)[1]) + 2.0 * float(np.log(scale).sum())
    return Standing(
        squared=squared,
        dimensions=size,
        p=_probability(squared, each, size),
        ln_density=-0.5 * (squared + ln_det + size * float(np.log(2.0 * np.pi))),
        farther=int((each >= squared).sum()),
        members=count,
    )


def _probability(squared: float, each: FloatArray, dimensions: int) -> float:
    count = len(each)
    farther = int((each >= squared).sum())
    return (1 + farther) / (count + 1) * (1.0 if farther else _fall(squared, np.sort(each), dimensions))


def _fall(squared: float, ordered: FloatArray, dimensions: int) -> float:
    """Probability of this distance over that of the farthest member, which is nearer. [-]"""
    count, most = len(ordered), float(ordered[-1])
    if most <= 0.0:
        return 0.0
    normal = _beyond(squared, count, dimensions) / max(_beyond(most, count, dimensions), 1e-300)
    few = max(2, round(count**0.5))
    steps = np.log(ordered[-few:] / max(float(ordered[-few - 1]), 1e-12 * most)).mean() if count > few else np.inf
    power = (most / squared) ** (1.0 / float(steps)) if steps > 0 else 0.0
    return min(max(normal, power), 1.0)


def worst_of(
    observed: FloatArray, members: FloatArray, errors: FloatArray, seed: int = 0, free: float = np.inf
) -> tuple[int, float, float] | None:
    """The vector of several that is farthest off: its number, squared distance, and probability of one as far off.

    `observed` is (k, d), `members` (M, k, d), `errors` (k, d, d); errors of the k vectors count as independent where
    members are given theirs. None with fewer than d + 3 members.
    """
    count, vectors, size = members.shape
    if count < size + 3:
        return None
    own, each = np.zeros(vectors), np.zeros((vectors, count))
    for k in range(vectors):
        off = observed[k] - members[:, k].mean(axis=0)
        own[k] = _squared(off, spread_of(members[:, k], errors[k]))
        each[k] = squared_distances(members[:, k], errors[k], np.random.default_rng([seed, k]), free)
    most = int(own.argmax())
    return most, float(own[most]), _probability(float(own[most]), each.max(axis=0), size)


def crps(observed: FloatArray, members: FloatArray) -> FloatArray:
    """Continuous ranked probability score of ensembles (M, n) for observed values (n,), in their unit; 0 is best.

    E|X - y| - E|X - X'|/2, the second without pairs of a member with itself, so that small ensembles are not punished:
    T. Gneiting & A. Raftery (2007), J. Am. Stat. Assoc. 102, 359, 10.1198/016214506000001437; C. Ferro (2014), Q. J. R.
    Meteorol. Soc. 140, 1917, 10.1002/qj.2270. For a single member it is the absolute error.
    """
    count = len(members)
    near = np.abs(members - observed).mean(axis=0)
    if count < 2:
        return np.asarray(near)
    weights = 2.0 * np.arange(1, count + 1) - count - 1.0
    pairs = (weights[:, None] * np.sort(members, axis=0)).sum(axis=0)
    return np.asarray(near - pairs / (count * (count - 1.0)))


def energy_score(observed: FloatArray, members: FloatArray) -> float:
    """The same for a place (2,) and the members' places (M, 2), with distances in the place of differences. [m]"""
    count = len(members)
    near = float(np.hypot(*(members - observed).T).mean())
    if count < 2:
        return near
    from scipy.spatial.distance import pdist

    return near - float(pdist(members).mean()) / 2.0


def predictive_rank(observed: FloatArray, sigma: FloatArray, members: FloatArray) -> FloatArray:
    """Probability that the prediction gave to less than each observed value, 0 to 1: even if the prediction is right.

    The prediction of a measured value is the mixture of the members (M, n) with normal errors sigma (n,): probability
    integral transform of A. P. Dawid (1984), J. R. Stat. Soc. A 147, 278, 10.2307/2981683. Half a rank keeps it off 0
    and 1.
    """
    from scipy.special import ndtr

    total = np.zeros(observed.shape)
    for member in members:
        total += ndtr((observed - member) / sigma)
    return np.asarray((total + 0.5) / (len(members) + 1.0))


WINDOW = 5.0
"""The sum over lags ends where it is this many correlation lengths long (Sokal 1997)."""


def correlation_length(series: FloatArray, taken: int = 0) -> float:
    """Number of neighbouring values that count as one: 1 + 2 (sum of the autocorrelation), 1 to n. [-]

    The sum ends where the lag passes five times what was summed so far: A. Sokal (1997), Monte Carlo methods in
    statistical mechanics, 10.1007/978-1-4899-0319-8_6. The series is (n,), evenly sampled, about zero: its mean is not
    taken off, so that a constant counts as one value. Where a fit of `taken` numbers was taken off, it took about
    taken/n from the autocorrelation at each lag, as the mean alone takes 1/n (M. Kendall (1954), Biometrika 41, 403,
    10.1093/biomet/41.3-4.403); this is given back, up to the lag whose correlation is within chance, 1/sqrt(n).
    """
    count = len(series)
    power = float(series @ series)
    if count < 2 or power == 0:
        return 1.0
    length = 1.0
    for lag in range(1, count):
        correlation = float(series[lag:] @ series[:-lag]) / power + taken / count
        if taken and correlation < count**-0.5:
            break
        length += 2.0 * correlation
        if lag >= WINDOW * length:
            break
    return float(np.clip(length, 1.0, count))
