"""How well a sharp prediction met what came: continuous ranked probability score, energy score, and ranks."""

import numpy as np
import numpy.typing as npt

__all__ = ["crps", "energy_score", "predictive_rank"]

FloatArray = npt.NDArray[np.float64]


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
