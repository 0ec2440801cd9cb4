"""What telemetry may be off by throughout a drive: priors of the unknown constants, and the hypotheses among them.

A healthy drive has constants near 0, as the plain priors say. Each hypothesis widens some of them: the localised point
is elsewhere on the rover, headings drift, clocks differ, the rover slides at a halt, encoders count wrongly. As the
state is linear in the constants (see `filter`), the marginal likelihood of any set of hypotheses is a quadratic form
(MacKay 2003, ch. 28). None is chosen: constants are averaged over the sets, each as probable as it is.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.telemetry.filter import FilterRun
from lunarsci.twin.telemetry.motion_nodes import DRIFT, LAG, LEVER, OFFSET, SCALE, SLIDES, Nodes

MEAN_SIGMA = (0.3, 0.1, 0.05)
"""Of the constant deviations, ahead and left as shares, turn in 1/m, where nothing is known: wide; assumed."""
LEVEL, LEVEL_SIGMA = -0.03, (0.15, 0.02)
"""Deviation ahead on level ground: soils drawn from the default priors slip by 0.03 in the median, and 16 to 84 % by
-0.04 to 0.11. Its standard deviation is twice as wide, lest it draw the radius along, and that to the left; assumed."""
EFFECT_MEAN, EFFECT_SIGMA = (0.8, 2.0, 0.0, 0.0, 0.0), (0.6, 2.0, 0.1, 0.02, 0.02)
"""Of the coefficients: slip grows about as the slope is steep, side slip about twice so, and a rover that steers turns
about as its wheels say; assumed, as wide as soils drawn from the default priors differ (0.4 to 2.2, 0.8 to 5, -0.1 to
0, and -0.01 to 0 in drives by the twin)."""
SKID_SIGMA = (0.4, 0.2, 0.1)
"""Of the last three for a rover that steers by its sides' speeds: its tracks are up to twice as far apart as its
wheels, and turn about places that lie off its axles (Mandow et al. 2007, 10.1109/IROS.2007.4399139). [-, m, m]"""
RIM_SIGMA = 0.03
"""Of ln of a wheel's rolling radius on soil, between shell and grousers, over that of its file; assumed."""
POINT_M, CLOCK_S, STANDS_M = 0.01, 0.1, 2e-4
"""How well the localised point [m] and the clock [s] are usually known, and a rover stands at a halt [m]; assumed."""
ELSEWHERE_M, DRIFTS_RAD, LATE_S, SLIDES_M = 0.3, math.radians(5.0), 3.0, 0.3
"""Standard deviation of the localised point, the drift, the lag and the slide where there is one; assumed."""
RARE, OFTEN = math.log(0.1), math.log(3.0)
"""ln of the odds of each hypothesis beforehand, and of that encoders are wrong where they differ from the commands, as
a motor that is controlled turns as told; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """Constants that may be far from 0.

    Attributes
    ----------
    name : a word for it.
    members : which constants.
    mean, sigma : their prior if it holds.
    ln_odds : beforehand.
    slide : which of `Nodes.slides` it concerns, -1 for none.
    said : whether it is worth a word where it holds.
    """

    name: str
    members: tuple[int, ...]
    sigma: float
    mean: float = 0.0
    ln_odds: float = RARE
    slide: int = -1
    said: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Priors:
    """What is believed of the constants beforehand.

    Attributes
    ----------
    mean, sigma : of a healthy drive. (k,), (k,)
    hypotheses : what else may be.
    """

    mean: FloatArray
    sigma: FloatArray
    hypotheses: tuple[Hypothesis, ...] = ()

    @classmethod
    def plain(cls, nodes: Nodes) -> "Priors":
        """Only slip, side slip and turn, and what slopes do to them, are unknown."""
        mean, sigma = np.zeros(nodes.constants), np.zeros(nodes.constants)
        mean[3:SCALE] = EFFECT_MEAN
        sigma[:SCALE] = (*MEAN_SIGMA, *EFFECT_SIGMA)
        return cls(mean=mean, sigma=sigma)

    @classmethod
    def of_drive(cls, nodes: Nodes, *, skids: bool, told_share: float = 1.0) -> "Priors":
        """All of them.

        Parameters
        ----------
        skids : whether no wheel of the rover is steered.
        told_share : rim speed measured over commanded, 1 where there is no command. What differs may be the encoders'.
        """
        plain = cls.plain(nodes)
        mean, sigma = plain.mean, plain.sigma
        if skids:
            sigma[5:SCALE] = SKID_SIGMA
        mean[0], sigma[:2] = LEVEL, LEVEL_SIGMA
        heading = float(np.nanmedian(nodes.yaw_sigma_rad))
        sigma[SCALE], sigma[LEVER], sigma[[OFFSET, DRIFT]], sigma[LAG] = RIM_SIGMA, POINT_M, heading, CLOCK_S
        sigma[SLIDES:] = STANDS_M
        hypotheses = [
            Hypothesis(name="much slip", members=(0,), sigma=MEAN_SIGMA[0], said=False),
            Hypothesis(name="constant side slip", members=(1,), sigma=MEAN_SIGMA[1]),
            Hypothesis(name="lever arm", members=(9, 10), sigma=ELSEWHERE_M),
            Hypothesis(name="heading drift", members=(DRIFT,), sigma=DRIFTS_RAD),
            Hypothesis(name="lag", members=(LAG,), sigma=LATE_S),
            Hypothesis(
                name="encoder scale",
                members=(SCALE,),
                sigma=RIM_SIGMA,
                mean=-math.log(told_share),
                ln_odds=OFTEN,
                said=abs(math.log(told_share)) > RIM_SIGMA,
            ),
        ]
        for number in range(len(nodes.slides)):
            members = (SLIDES + 2 * number, SLIDES + 2 * number + 1)
            name = "slide at a halt" if number < len(nodes.halts) else "position shift"
            hypotheses.append(Hypothesis(name=name, members=members, sigma=SLIDES_M, slide=number))
        return cls(mean=mean, sigma=sigma, hypotheses=tuple(hypotheses))

    def under(self, held: BoolArray) -> tuple[FloatArray, FloatArray, float]:
        """Mean, sigma, and ln of the odds beforehand, where some hypotheses hold."""
        mean, sigma, ln_odds = self.mean.copy(), self.sigma.copy(), 0.0
        for one in itertools.compress(self.hypotheses, held):
            members = list(one.members)
            mean[members], sigma[members] = one.mean, one.sigma
            ln_odds += one.ln_odds
        return mean, sigma, ln_odds


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Constants after the measurements, averaged over the sets of hypotheses that were weighed.

    mean (k,), covariance (k, k), `ln_likelihood` marginal, up to a constant, and how probable each hypothesis is.
    """

    mean: FloatArray
    covariance: FloatArray
    ln_likelihood: float
    probable: FloatArray


def ln_evidence(squares: FloatArray, mean: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """ln of the marginal likelihood (m,), means (m, k) and covariances (m, k, k) of normal constants.

    `squares` are those of a `FilterRun`, (m, 1 + k, 1 + k).
    """
    at_mean = squares[:, 1:, 0] + squares[:, 1:, 1:] @ mean
    chi_square = squares[:, 0, 0] + (squares[:, 0, 1:] + at_mean) @ mean
    precision = np.eye(len(mean)) + sigma[:, None] * squares[:, 1:, 1:] * sigma
    off = np.linalg.solve(precision, -(sigma * at_mean)[..., None])[..., 0]
    chi_square = chi_square + np.einsum("mi,mi->m", off, sigma * at_mean)
    covariance = sigma[:, None] * np.linalg.inv(precision) * sigma
    return -0.5 * chi_square - 0.5 * np.linalg.slogdet(precision)[1], mean + sigma * off, covariance


def likely_sets(priors: Priors, squares: FloatArray) -> list[BoolArray]:
    """Sets of hypotheses to average over: the most probable one that is reached hypothesis by hypothesis, and all that
    differ from it by one. `squares` are those of one assumption. (1 + k, 1 + k)"""
    held = np.zeros(len(priors.hypotheses), dtype=bool)

    def probable(tried: BoolArray) -> float:
        mean, sigma, ln_odds = priors.under(tried)
        return ln_odds + float(ln_evidence(squares[None], mean, sigma)[0][0])

    best = probable(held)
    while True:
        near = [np.where(np.arange(len(held)) == k, ~held, held) for k in range(len(held))]
        found = [probable(one) for one in near]
        if not found or max(found) <= best:
            return [held, *near]
        best, held = max(found), near[int(np.argmax(found))]


def averaged(priors: Priors, run: FilterRun, sets: list[BoolArray]) -> list[Posterior]:
    """The constants for each assumption of a run."""
    parts = []
    for held in sets:
        mean, sigma, ln_odds = priors.under(held)
        ln_likelihood, means, covariances = ln_evidence(run.squares, mean, sigma)
        parts.append((ln_odds + ln_likelihood + run.ln_likelihood, means, covariances))
    ln_all, means, covariances = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
    highest = ln_all.max(axis=1, keepdims=True)
    whole = highest[:, 0] + np.log(np.exp(ln_all - highest).sum(axis=1))
    weights = np.exp(ln_all - whole[:, None])
    result = []
    for k, weight in enumerate(weights):
        mean = weight @ means[k]
        apart = means[k] - mean
        covariance = np.einsum("s,sij->ij", weight, covariances[k] + apart[:, :, None] * apart[:, None, :])
        result.append(Posterior(mean, covariance, float(whole[k]), weight @ np.array(sets)))
    return result
