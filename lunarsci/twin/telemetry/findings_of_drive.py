"""What the smoothed motion says of its telemetry: which hypotheses hold, and which positions fit no motion."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.twin.telemetry.filter import linearised
from lunarsci.twin.telemetry.motion_nodes import DRIFT, LAG, LEVER, SCALE, SLIDES, Nodes
from lunarsci.twin.telemetry.nuisances import Hypothesis, Posterior, Priors
from lunarsci.twin.telemetry.reading import Findings, Positions, Telemetry
from lunarsci.twin.telemetry.smoother import MEDIAN_OF_TWO, Smoothed

HELD = 0.5
"""Probability from which on a hypothesis is said: it is more probable than not."""
SURE = 3.0
"""Standard errors by which a rover must go too far for it to be sure; assumed."""
HARDLY = 0.25
"""Weight below which, beside the best one, a position or a heading is said to be left out; assumed. By Student's law it
is then 4.5 standard errors off."""
MOST_JUMPS = 8
"""Ways on which positions may shift; where more are odd, positions are bad altogether; assumed."""
MOST_LEFT_OUT = 0.2
"""Share of the positions left out beyond which the result is in doubt; assumed."""
WORST_SCATTER = 4.0
"""Median square of what positions are off by over that of their errors beyond which it is said; assumed."""
LEAST_SCATTER, FINEST_M = 0.05, 5e-4
"""The same, and a standard error [m], below which errors of positions are not believed; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """By how much positions and headings are later than the columns of the wheels.

    Attributes
    ----------
    lag_s, sigma_s : positive where the rover moves later than its wheels say. [s]
    probable : that there is more than clocks usually differ by.
    """

    lag_s: float
    sigma_s: float
    probable: float

    @classmethod
    def of(cls, posterior: Posterior, priors: Priors, put_back_s: float) -> "Lag":
        """From the constants of a drive in which so much was put back."""
        number = [one.name for one in priors.hypotheses].index("lag")
        sigma = math.sqrt(posterior.covariance[LAG, LAG])
        probable = 1.0 if put_back_s else float(posterior.probable[number])
        return cls(lag_s=put_back_s + float(posterior.mean[LAG]), sigma_s=sigma, probable=probable)

    @property
    def found(self) -> bool:
        """Whether a lag is more probable than none."""
        return self.probable > HELD

    def to_dict(self) -> dict[str, float | bool]:
        """For a result."""
        return {"lag_s": self.lag_s, "sigma_s": self.sigma_s, "found": self.found}


def say_constants(smoothed: Smoothed, nodes: Nodes, priors: Priors, lag: Lag, findings: Findings) -> None:
    """Say each hypothesis that is more probable than not, with what was found; the motion holds it."""
    mean, sigma = smoothed.posterior.mean, np.sqrt(np.diag(smoothed.posterior.covariance))

    def value(k: int, unit: str, factor: float = 1.0) -> str:
        return f"{factor * mean[k]:.3g} +- {factor * sigma[k]:.2g} {unit}"

    ahead, left = LEVER.start, LEVER.start + 1
    text = {
        "lever arm": (
            f"positions are those of a point {value(ahead, 'm')} ahead and {value(left, 'm')} to the left of the "
            "rover's origin",
            "the motion is that of the origin; give positions of the origin",
        ),
        "heading drift": (
            f"headings drift by {value(DRIFT, 'deg', math.degrees(1.0))} until the end",
            "the motion is without the drift",
        ),
        "lag": (
            f"the rover moves {abs(lag.lag_s):.3g} +- {lag.sigma_s:.2g} s "
            f"{'later' if lag.lag_s > 0 else 'earlier'} than its wheels say",
            f"positions and headings are put back, as --lag {lag.lag_s:.2f} does",
        ),
        "constant side slip": (
            f"the rover glides by {value(1, 'deg', math.degrees(1.0))} all the way, positive to the left",
            "kept; a heading that is off throughout looks the same",
        ),
        "encoder scale": (
            f"the rims turn {math.exp(mean[SCALE]):.3f} +- {sigma[SCALE]:.3f} times as far as their encoders say",
            "slip is of the rims",
        ),
    }
    for one, probable in zip(priors.hypotheses, smoothed.posterior.probable, strict=True):
        probable = lag.probable if one.name == "lag" else probable
        if probable <= HELD or not one.said:
            continue
        if one.slide < 0:
            what, done = text[one.name]
            findings.add(one.name, what, f"{done} (probability {probable:.3g})")
            continue
        times = nodes.time_s[list(nodes.slides[one.slide])]
        ways = [SLIDES + 2 * one.slide + step for step in (0, 1)]
        halted = one.slide < len(nodes.halts)
        what = (
            f"the rover moves {value(ways[0], 'm')} ahead and {value(ways[1], 'm')} to the left between {times[0]:.6g} "
            f"and {times[1]:.6g} s "
            + ("while its wheels stand: it slid" if halted else "beside what its wheels roll: it slipped suddenly")
            + ", or positions are of another frame from then on"
        )
        done = "the motion holds it, and slips are found on either side"
        findings.add(one.name, what, done, time_s=float(times[0]), doubt=not halted and _too_far(smoothed, nodes, one))


def _too_far(smoothed: Smoothed, nodes: Nodes, one: Hypothesis) -> bool:
    """Whether the rover goes farther on the way of a shift than its wheels roll, which no slip makes of it."""
    first, last = nodes.slides[one.slide]
    moved = float(np.hypot(*(smoothed.state[last, :2] - smoothed.state[first, :2])))
    ways = list(one.members)
    sigma = math.sqrt(np.diag(smoothed.posterior.covariance)[ways].sum())
    return moved - float(nodes.way_m[first:last].sum()) > SURE * sigma


def _left_out(smoothed: Smoothed, nodes: Nodes) -> BoolArray:
    return np.asarray(nodes.fixed & (smoothed.fix_weight < HARDLY * smoothed.fix_weight[nodes.fixed].max()))


def shifted(smoothed: Smoothed, nodes: Nodes) -> Nodes:
    """Nodes whose positions may shift just before or behind those that hardly count."""
    fixes, out = np.flatnonzero(nodes.fixed), _left_out(smoothed, nodes)[nodes.fixed]
    # A shift beside the first or the last position is that position's own.
    inner = list(zip(pairwise(fixes), out[1:] | out[:-1], strict=True))[1:-1]
    ways = [pair for pair, odd in inner if odd]
    moved = (nodes.way_m[first:last].any() for first, last in ways)
    jumps = tuple((int(a), int(b)) for (a, b), rolls in zip(ways, moved, strict=True) if rolls)
    return replace(nodes, jumps=jumps[:MOST_JUMPS])


def left_out_of(smoothed: Smoothed, nodes: Nodes) -> FloatArray:
    """Positions that hardly count: time, x, y. (o, 3) [s, m, m]"""
    rows = _left_out(smoothed, nodes)
    return np.column_stack([nodes.time_s[rows], nodes.fix_m[rows]])


def say_left_out(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say positions and headings that hardly count."""
    known = np.isfinite(nodes.yaw_rad)
    odd = known & (smoothed.yaw_weight < HARDLY)
    if odd.any():
        many, first = odd.sum() > MOST_LEFT_OUT * known.sum(), float(nodes.time_s[int(np.argmax(odd))])
        what = f"{odd.sum()} of {known.sum()} headings fit no motion of the wheels"
        findings.add("odd heading", what, "they hardly count", count=int(odd.sum()), time_s=first, doubt=bool(many))
    left, fixes = np.flatnonzero(_left_out(smoothed, nodes)), np.flatnonzero(nodes.fixed)
    if not left.size:
        return
    what, done = f"{len(left)} of {len(fixes)} positions fit no motion of the wheels", "they hardly count"
    ends = [name for name, node in (("first", fixes[0]), ("last", fixes[-1])) if node in left]
    if ends:
        what += f", the {' and the '.join(ends)} one too"
        done += ": none beyond it tells whether it is wrong, or the rover went there and the motion is wrong"
    doubt = "last" in ends or len(left) > MOST_LEFT_OUT * len(fixes)
    findings.add("position jump", what, done, count=len(left), time_s=float(nodes.time_s[left[0]]), doubt=doubt)


def say_scatter(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say errors of positions that nobody can believe, and a scatter that they do not explain.

    What all positions are off by does not make them scatter: of errors that they share a small scatter is none.
    """
    fixed = nodes.fixed
    sigma = float(np.median(np.sqrt(np.trace(nodes.fix_covariance_m2[fixed], axis1=1, axis2=2) / 2.0)))
    scatter = float(np.nanmedian(smoothed.squared_distance)) / MEDIAN_OF_TWO
    if sigma < FINEST_M:
        what = f"positions claim errors of {1e3 * sigma:.2g} mm, which no localisation of a rover reaches"
        findings.add("errors too small", what, "kept; are they in another unit?", doubt=True)
    elif scatter < LEAST_SCATTER and nodes.chain is None and fixed.sum() > 5:
        what = f"positions scatter {scatter:.2g} times as much as their errors of {sigma:.3g} m say"
        findings.add("errors too large", what, "kept; are they in another unit?")
    if scatter > WORST_SCATTER:
        what = f"positions scatter about the motion with {math.sqrt(scatter):.1f} times the errors that they say"
        findings.add("positions scatter", what, "their errors are taken to be so much larger")


def counted_positions(
    sent: Telemetry, rows: IndexArray, nodes: Nodes, smoothed: Smoothed, left_out: FloatArray
) -> Positions:
    """Those that count, without what the localised point's place on the rover and what is left of a lag add."""
    used = nodes.fixed & ~np.isin(nodes.time_s, left_out[:, 0])
    members = np.r_[LEVER, LAG]
    added = linearised(nodes, smoothed.reference).by[:, :2, members] @ smoothed.posterior.mean[members]
    shared = None
    if sent.fix_shared_m2 is not None:
        # The one before may have been left out; what the two share is then not known.
        after_used = np.append(False, used[nodes.fixed][:-1])[used[nodes.fixed]]
        shared = sent.fix_shared_m2[rows][used] * after_used[:, None, None]
    place, covariance = sent.fix_m[rows] - added, sent.fix_covariance_m2[rows]
    return Positions(nodes.time_s[used], place[used], covariance[used], shared)
