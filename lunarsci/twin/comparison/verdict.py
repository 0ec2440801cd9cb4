"""A prediction held against a drive, and whether it was to be trusted.

Bands of wheel states have to hold as many of them as they should, and what happened has to be one of the things that
were predicted, all quantities together, by means of the wheels over pieces of the drive.

Neighbouring values are alike: all of a drive share one soil, and errors of measurement are shared by neighbours and by
wheels where they come from one smoothed motion. So a piece of the drive counts as one value. What the members share is
in their covariance. Stated errors count as shared by the wheels at each time, but for sinkage, and as independent from
time to time, unless the scatter of the wheels' mean about its smooth course, with its correlation length, says clearly
more. Errors shared over more than a quarter of the drive cannot be told from a soil that is not the one believed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.linalg import block_diag
from scipy.special import bdtr, chdtri

from lunarsci.arrays import FloatArray
from lunarsci.twin.assimilation.residuals import MODEL_ERRORS, OBSERVED
from lunarsci.twin.comparison.forecast import Forecast, MatchedObservations
from lunarsci.twin.comparison.scores import (
    ALL,
    NOMINAL,
    BandCheck,
    EndCheck,
    PathCheck,
    Standing,
    check_bands,
    check_end,
    check_path,
    correlation_length,
    half_band,
    standing,
    worst_of,
)
from lunarsci.twin.simulation.contact import DEEPEST, VALID_SLIP
from lunarsci.twin.simulation.ensemble import MOST_BEYOND

STEPS, MODES = 6, 3
"""Places where the smooth course may step, ends included, and shapes that the members' differences give it."""
LEAST_TIMES = 4
"""In a piece, below which its mean says little of its own."""
BY_WHEEL = ("sinkage_m",)
"""Measured of each wheel by itself; slip and forces follow from the motion of the one body, and share its errors."""
LEAST_FREE = 8
"""Values beyond those that the smooth course takes, below which their scatter is not asked."""
PIECES, FINE_PIECES = 4, 6
"""Of the drive, for the surprise and for a change of the soil: few, as each must be one value among the members."""
MEMBERS_EACH = 4
"""Members for each dimension of the vector, below which fewer pieces are taken."""
MOST_REFERENCES = 400
"""Members whose coverage is worked out, beside which that of the drive is held; more would add nothing."""
ALARM = 0.01
"""Probability below which a drive is none of those that were predicted. All tests together raise a false alarm in 2 to
5 of 100 drives, measured with 64 members; most where the belief is as wide as the priors, and drives differ most."""
ALARM_OF_CHANGE = 0.003
"""The same for a change of the ground: how well the measured means are known is estimated from the drive itself. It is
among the tests whose false alarms were measured together; assumed."""
BORDERLINE = 0.1
"""Probability below which something of a drive lies near the edge of what was predicted: nothing speaks against the
prediction, nor much for it. Right predictions come near in 20 to 30 of 100 drives, measured with the drives of
`tests/twin/comparison/test_verdict.py`."""
FAR, SELDOM = 5.0, 0.05
"""Standard deviations beyond which a mean or an end is too far off also where a single odd member is farther, which
hides more than it says, and how seldom it must be among the members; among the tests measured together, see `ALARM`;
assumed."""
LEAST_MEMBERS = 20
"""Drives that finished, of which one is 5 %: of fewer the extremes are both ends of a region of 90 %."""


@dataclass(frozen=True, slots=True, eq=False)
class PieceMeans:
    """Means of one quantity over the pieces.

    Attributes
    ----------
    observed, members : measured (k,), predicted (M, k).
    variance : of the error of the measured ones, with that of the model. (k,)
    free : values that its estimate rests on; infinite where it follows from the stated errors.
    """

    observed: FloatArray
    members: FloatArray
    variance: FloatArray
    free: float


def _times(matched: MatchedObservations, name: str) -> FloatArray:
    column = OBSERVED.index(name)
    return np.unique(matched.record.time_s[matched.counted[:, column]])


def most_pieces(matched: MatchedObservations, names: list[str], wanted: int) -> int:
    """Pieces that leave each quantity four times in each, at most `wanted`; 0 where not even one does."""
    fewest = min((len(_times(matched, name)) for name in names), default=0)
    return min(wanted, fewest // LEAST_TIMES)


def piece_edges(matched: MatchedObservations, names: list[str], pieces: int) -> FloatArray:
    """Times between pieces with as many measured times in each, of the quantity that has fewest. (pieces + 1,) [s]"""
    times = min((_times(matched, name) for name in names), key=len)
    inner = [0.5 * (part[-1] + after[0]) for part, after in pairwise(np.array_split(times, pieces))]
    return np.array([-np.inf, *inner, np.inf])


def piece_means(matched: MatchedObservations, name: str, edges: FloatArray) -> PieceMeans | None:
    """Means of a quantity over all wheels and the times between edges; None where a piece has no value."""
    column = OBSERVED.index(name)
    rows = matched.counted[:, column]
    piece = np.searchsorted(edges, matched.record.time_s[rows]) - 1
    count = len(edges) - 1
    size = np.bincount(piece, minlength=count)
    if (size == 0).any():
        return None
    average = (np.arange(count)[:, None] == piece) / size[:, None]
    measured, members = matched.record.values[rows, column], matched.predicted[:, rows, column]
    floor = MODEL_ERRORS[name] ** 2
    stated = np.maximum(matched.sigma[rows, column] ** 2 - floor, 0.0)
    times = matched.record.time_s[rows]
    of_one, free = _scatter(times, measured - members.mean(axis=0), members - members.mean(axis=0))
    moments = np.array([len(np.unique(times[piece == k])) for k in range(count)])
    enough = free >= LEAST_FREE
    independent = (average**2) @ stated if name in BY_WHEEL and enough else average @ stated / moments
    shared = of_one / moments if enough else np.zeros(count)
    single = np.where(shared > chdtri(max(free, 1), ALARM) / max(free, 1) * independent, shared, independent)
    rests_on = float(free) if (single > independent).any() else np.inf
    return PieceMeans(average @ measured, members @ average.T, single + floor, rests_on)


def _scatter(times: FloatArray, off: FloatArray, anomalies: FloatArray) -> tuple[float, int]:
    """Variance of the wheels' mean at one time about its smooth course, times the correlation length of what is left.

    The course may follow the shapes by which the members differ most, and step once where that serves best, so that a
    soil that changes is not taken for noise. Also returned: how many values are left to tell.
    """
    moments, place = np.unique(times, return_inverse=True)
    average = (np.arange(len(moments))[:, None] == place) / np.bincount(place)[:, None]
    series, shapes = average @ off, anomalies @ average.T
    _, _, modes = np.linalg.svd(shapes, full_matrices=False)
    free = len(moments) - 2 - len(modes[:MODES])
    if free < LEAST_FREE:
        return 0.0, free
    rests = []
    for step in np.linspace(0, len(moments), STEPS + 1).astype(np.int64)[1:-1]:
        counted = np.column_stack([np.ones(len(moments)), np.arange(len(moments)) >= step, modes[:MODES].T])
        rests.append(series - counted @ np.linalg.lstsq(counted, series, rcond=None)[0])
    rest = min(rests, key=lambda one: float(one @ one))
    return float(rest @ rest) / free * correlation_length(rest, len(moments) - free), free


@dataclass(frozen=True, slots=True)
class Surprise:
    """The whole drive against the members.

    Attributes
    ----------
    standing : the vector of means and places.
    pieces : of the drive, each of which counts as one value of each quantity.
    quantities : in the vector, `position` among them.
    """

    standing: Standing
    pieces: int
    quantities: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Bias:
    """Means over the drive, each quantity against the members.

    Attributes
    ----------
    quantities : how each stands among the members, by name.
    worst : name of the least probable.
    p : probability of one as bad: its own times the number of quantities, at most 1 (Bonferroni). [-]
    """

    quantities: dict[str, Standing]
    worst: str
    p: float


@dataclass(frozen=True, slots=True)
class GroundChange:
    """Where the ground seems to change.

    Attributes
    ----------
    distance_m : commanded distance. [m]
    p : probability of such a change by chance. [-]
    """

    distance_m: float
    p: float


def _names(matched: MatchedObservations) -> list[str]:
    """Quantities that are measured, and are no second reading of the positions."""
    columns = {name: OBSERVED.index(name) for name in matched.measured_quantities()}
    return [name for name, k in columns.items() if matched.independent[matched.counted[:, k], k].all()]


def surprise(matched: MatchedObservations, seed: int = 0) -> Surprise | None:
    """Means of each quantity over all wheels and a piece of the drive, and the last position of each piece.

    As many pieces, at most four, as leave four members to a dimension. None where nothing fits even one piece.
    """
    names = _names(matched)
    for pieces in range(most_pieces(matched, names, PIECES) if names else PIECES, 0, -1):
        vector = _vector(matched, names, pieces)
        if vector is None or (vector[0].size * MEMBERS_EACH > len(matched.members) and pieces > 1):
            continue
        held = standing(*vector[:3], seed, vector[3])
        quantities = (*names, *(["position"] if len(matched.record.fix_time_s) else []))
        return None if held is None else Surprise(held, pieces, quantities)
    return None


def _vector(
    matched: MatchedObservations, names: list[str], pieces: int
) -> tuple[FloatArray, FloatArray, FloatArray, float] | None:
    """Measured (d,), members (M, d), covariance of the errors (d, d), and values that this rests on."""
    end = matched.forecast.time_s[-1]
    edges = np.append(np.append(-np.inf, np.linspace(0.0, end, pieces + 1)[1:-1]), np.inf)
    if names:
        edges = piece_edges(matched, names, pieces)
    observed, members, blocks, free = [], [], [], np.inf
    for name in names:
        means = piece_means(matched, name, edges)
        if means is None:
            return None
        observed.append(means.observed)
        members.append(means.members)
        blocks.append(np.diag(means.variance))
        free = min(free, means.free)
    for fix in _last_fixes(matched.record.fix_time_s, edges):
        observed.append(matched.record.fix_m[fix])
        members.append(matched.places[:, fix])
        blocks.append(matched.place_error_m2[fix])
    if not blocks:
        return None

    return np.concatenate(observed), np.concatenate(members, axis=1), np.asarray(block_diag(*blocks)), free


def _last_fixes(times: FloatArray, edges: FloatArray) -> list[int]:
    """The last position of each piece that has one."""
    piece = np.searchsorted(edges, times) - 1
    return [int(np.flatnonzero(piece == k)[times[piece == k].argmax()]) for k in np.unique(piece)]


def mean_bias(matched: MatchedObservations, seed: int = 0) -> Bias | None:
    """The mean of each quantity over the whole drive and all wheels, against the members; None with too few."""
    names, whole = matched.measured_quantities(), np.array([-np.inf, np.inf])
    means = {name: one for name in names if (one := piece_means(matched, name, whole)) is not None}
    if not means:
        return None
    single = {name: standing(m.observed, m.members, np.diag(m.variance), seed, m.free) for name, m in means.items()}
    result = {name: one for name, one in single.items() if one is not None}
    if not result:
        return None
    worst = min(result, key=lambda name: result[name].p)
    return Bias(result, worst, min(1.0, len(result) * result[worst].p))


def find_change(matched: MatchedObservations, seed: int = 0) -> GroundChange | None:
    """Where the means after and before differ from what was predicted most, of five places in the drive.

    A soil that is not the one believed shows on the whole way; one that changes shows in the difference. None where
    there are too few members, times or measured quantities.
    """
    names = _names(matched)
    pieces = most_pieces(matched, names, FINE_PIECES) if names else 0
    if pieces < 2:
        return None
    edges = piece_edges(matched, names, pieces)
    result = [piece_means(matched, name, edges) for name in names]
    parts = np.array([[0.0] * pieces] * (pieces - 1))
    for split in range(1, pieces):
        parts[split - 1, :split], parts[split - 1, split:] = -1.0 / split, 1.0 / (pieces - split)
    means = [one for one in result if one is not None]
    observed = np.stack([parts @ one.observed for one in means], axis=-1)
    members = np.stack([one.members @ parts.T for one in means], axis=-1)
    errors = np.stack([parts**2 @ one.variance for one in means], axis=-1)
    free = min(one.free for one in means)
    most = worst_of(observed, members, np.einsum("kd,de->kde", errors, np.eye(len(means))), seed, free)
    if most is None:
        return None
    place = float(np.interp(edges[most[0] + 1], matched.forecast.time_s, matched.forecast.distance_m))
    return GroundChange(place, most[2])


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of values in their 90 % bands, against those that members have.

    Attributes
    ----------
    p : quantity to the probability of no larger a share, were the prediction right.
    worst, worst_p : the quantity with the smallest, and the probability that any has one as small.
    """

    p: dict[str, float]
    worst: str
    worst_p: float


def check_coverage(matched: MatchedObservations, bands: Sequence[BandCheck], seed: int = 0) -> Coverage | None:
    """Hold the shares of all wheels against those of the members.

    Each member, with errors of measurement, is put beside the bands of the others: (1 + those with no larger share) /
    (M + 1) is the probability, whatever values share. Where no member has so small a share, it falls from there as the
    binomial law does, with the effective number of values. None with fewer than three members or without values.
    """
    checks = [band for band in bands if band.wheel == ALL and band.coverage_90 is not None]
    if not checks or len(matched.members) < 4:
        return None
    members = np.stack([_shares(matched, check.quantity, [seed, k]) for k, check in enumerate(checks)])
    single = np.array([check.coverage_90 for check in checks], dtype=float)
    count = members.shape[1]
    fewer = (members <= single[:, None] + 1e-12).sum(axis=1)
    falls = [_fall(check, *pair) for check, *pair in zip(checks, single, members.min(axis=1), strict=True)]
    each = (1 + fewer) / (count + 1) * np.where(fewer > 0, 1.0, falls)
    ranked = (members[:, None, :] <= members[:, :, None] + 1e-12).sum(axis=2) / (count + 1)
    worst = int(each.argmin())
    as_bad = int((ranked.min(axis=0) <= (1 + fewer[worst]) / (count + 1) - 1e-12).sum()) if fewer[worst] else 0
    together = (1 + as_bad) / (count + 1) * (1.0 if fewer[worst] else falls[worst])
    names = [check.quantity for check in checks]
    return Coverage(dict(zip(names, map(float, each), strict=True)), names[worst], float(together))


def _fall(check: BandCheck, share: float, least: float) -> float:
    """Binomial probability of the share over that of the least share of a member, at most 1. [-]"""
    values = max(int(check.effective), 1)
    single, other = (bdtr(np.floor(one * values), values, NOMINAL) for one in (share, least))
    return min(float(single / max(other, 1e-300)), 1.0)


def _shares(matched: MatchedObservations, name: str, seed: Sequence[int]) -> FloatArray:
    """Share of each member's values in the bands of the others."""
    column = OBSERVED.index(name)
    rows = matched.counted[:, column]
    members, sigma = matched.predicted[:, rows, column], matched.sigma[rows, column]
    count, random, mean = len(members), np.random.default_rng(seed), members.mean(axis=0)
    scatter = ((members - mean) ** 2).sum(axis=0)
    shares = []
    for m in np.unique(np.linspace(0, count - 1, min(count, MOST_REFERENCES)).astype(np.int64)):
        off = members[m] - mean
        variance = (scatter - count / (count - 1) * off**2) / (count - 2) * (1.0 + 1.0 / (count - 1)) + sigma**2
        away = members[m] + sigma * random.standard_normal(sigma.shape) - (mean - off / (count - 1))
        shares.append((np.abs(away) <= half_band(count - 1) * np.sqrt(variance)).mean())
    return np.array(shares)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveComparison:
    """What was predicted beside what happened.

    Attributes
    ----------
    verdict, reasons : `trusted`, `not contradicted`, or `not to be trusted` and why, one sentence each.
    near : where nothing contradicts the prediction, what of the drive lies near the edge of it, one sentence each.
    notes : what a reader should know all the same.
    compared, not_compared : quantities; of the latter, why.
    members, finished : predicted drives, and those that came to their end, which alone count.
    end, path, surprise, change : None where not measured or not to be told.
    bands : each quantity of all wheels and of each.
    bias : of the means over the drive, against the members.
    coverage : of the shares in the bands, against the members.
    invalid_share : measured states where the wheel model does not hold. [-]
    """

    verdict: Literal["trusted", "not contradicted", "not to be trusted"]
    reasons: tuple[str, ...]
    near: tuple[str, ...]
    notes: tuple[str, ...]
    compared: tuple[str, ...]
    not_compared: dict[str, str]
    members: int
    finished: int
    end: EndCheck | None
    path: PathCheck | None
    surprise: Surprise | None
    change: GroundChange | None
    bands: tuple[BandCheck, ...]
    bias: Bias | None
    coverage: Coverage | None
    invalid_share: float


def compare(matched: MatchedObservations, seed: int = 0) -> DriveComparison:
    """Hold a forecast against the record that it was brought together with.

    `seed` is of the errors of measurement that are given to the members.
    """
    forecast = matched.forecast
    end, path = check_end(matched, seed), check_path(matched)
    bands = check_bands(matched)
    whole, change = surprise(matched, seed), find_change(matched, seed)
    names = matched.measured_quantities()
    bias, coverage = mean_bias(matched, seed), check_coverage(matched, bands, seed)
    invalid = _invalid_share(matched)
    reasons = [
        *_ensemble_reasons(forecast, len(matched.members)),
        *_end_reasons(end),
        *_state_reasons(bands, bias, coverage),
        *_whole_reasons(whole, change),
    ]
    if invalid > MOST_BEYOND:
        reasons.append(f"{100 * invalid:.0f} % of the measured states lie outside of what the wheel model holds for")
    near = [] if reasons else _near(bands, bias, coverage, end, whole)
    return DriveComparison(
        verdict="not to be trusted" if reasons else "not contradicted" if near else "trusted",
        reasons=tuple(reasons),
        near=tuple(near),
        notes=tuple(_notes(matched, end, whole)),
        compared=(*(["position"] if end else []), *names),
        not_compared=_not_compared(matched, end),
        members=forecast.members,
        finished=len(matched.members),
        end=end,
        path=path,
        surprise=whole,
        change=change,
        bands=tuple(bands),
        bias=bias,
        coverage=coverage,
        invalid_share=invalid,
    )


def _invalid_share(matched: MatchedObservations) -> float:
    """Measured states with |s| beyond 0.6, or a sinkage below 0 or beyond 0.9 radii."""
    values, rows = matched.record.values, matched.counted.any(axis=1)
    if not rows.any():
        return 0.0
    sinkage, slip = (values[rows, OBSERVED.index(name)] for name in ("sinkage_m", "slip_ratio"))
    # A sinkage near 0 may be measured below it.
    lowest = -3.0 * np.nan_to_num(matched.sigma[rows, OBSERVED.index("sinkage_m")])
    strange = (np.abs(slip) > VALID_SLIP) | (sinkage > DEEPEST * matched.forecast.wheel_radius_m) | (sinkage < lowest)
    return float(strange.mean())


def _ensemble_reasons(forecast: Forecast, finished: int) -> list[str]:
    reasons = []
    if finished < LEAST_MEMBERS:
        reasons.append(
            f"the prediction rests on {finished} drives that finish; give {LEAST_MEMBERS} or more for regions and bands"
        )
    if 2 * finished < forecast.members:  # the middle one of the predicted drives ends early
        reasons.append(f"only {finished} of {forecast.members} predicted drives come to the end that was driven to")
    return reasons


def _end_reasons(end: EndCheck | None) -> list[str]:
    if end is None or end.standing is None or not _improbable(end.standing, end.standing.p):
        return []
    what = "the end" if end.at_end else f"the last position, at {end.time_s:.0f} s,"
    return [
        f"{what} lies outside of the predicted region of {100 * (1 - ALARM):g} %: {end.error_m:.3f} m from the middle, "
        f"{end.standing.distance:.1f} standard deviations"
    ]


def _improbable(standing: Standing, p: float) -> bool:
    return p < ALARM or (standing.distance > FAR and standing.p < SELDOM)


def _state_reasons(bands: Sequence[BandCheck], bias: Bias | None, coverage: Coverage | None) -> list[str]:
    """Where the worst quantity is none of chance: that one, and others that are as improbable by themselves."""
    reasons = []
    for check in (band for band in bands if band.wheel == ALL):
        name = check.quantity
        single = None if bias is None else bias.quantities.get(name)
        if single is not None and bias is not None and _improbable(single, len(bias.quantities) * single.p):
            away = f"{single.distance:.1f} standard deviations"
            reasons.append(f"{name} is off by {check.bias:+.3g} in the mean, {away}")
        if coverage is not None and coverage.worst_p < ALARM and (name == coverage.worst or coverage.p[name] < ALARM):
            share = 100 * (check.coverage_90 or 0.0)
            reasons.append(f"{name}: only {share:.0f} % of the values are in their 90 % bands")
    return reasons


def _near(
    bands: Sequence[BandCheck],
    bias: Bias | None,
    coverage: Coverage | None,
    end: EndCheck | None,
    whole: Surprise | None,
) -> list[str]:
    """What of the drive is improbable, though not so much that it contradicts the prediction."""
    near = []
    for check in (band for band in bands if band.wheel == ALL):
        name = check.quantity
        single = None if bias is None else bias.quantities.get(name)
        least = min(1.0 if single is None else single.p, 1.0 if coverage is None else coverage.p.get(name, 1.0))
        if least < BORDERLINE and check.bias_standard is not None:
            near.append(
                f"{name} is off by {check.bias:+.3g} in the mean ({check.bias_standard:+.2f} sd), and "
                f"{100 * (check.coverage_90 or 0.0):.0f} % of its values lie in their 90 % bands; probability by "
                f"chance {_small(least)}"
            )
    if end is not None and end.standing is not None and end.standing.p < BORDERLINE:
        near.append(
            f"the end lies {end.error_m:.3f} m from the middle of the predicted ({end.standing.distance:.2f} sd); "
            f"probability by chance {_small(end.standing.p)}"
        )
    if not near and whole is not None and whole.standing.p < BORDERLINE:
        near.append(
            f"the drive as a whole lies {whole.standing.distance:.2f} sd from the predicted; probability by chance "
            f"{_small(whole.standing.p)}"
        )
    return near


def _whole_reasons(whole: Surprise | None, change: GroundChange | None) -> list[str]:
    reasons = []
    if whole is not None and whole.standing.p < ALARM:
        reasons.append(
            f"the drive as a whole lies {whole.standing.distance:.1f} standard deviations from those that were "
            f"predicted, in {whole.standing.dimensions} dimensions; probability by chance {_small(whole.standing.p)}"
        )
    if change is not None and change.p < ALARM_OF_CHANGE:
        reasons.append(
            f"the ground seems to change about {change.distance_m:.1f} m from the start; probability by chance "
            f"{_small(change.p)}"
        )
    return reasons


def _small(p: float) -> str:
    return f"{p:.2g}" if p >= 1e-6 else "below 1e-6"


def _notes(matched: MatchedObservations, end: EndCheck | None, whole: Surprise | None) -> list[str]:
    forecast, notes = matched.forecast, []
    if forecast.synthetic:
        notes.append("the terrain is synthetic")
    if forecast.soils in ("sweep", "one"):
        notes.append(
            "the prediction swept ranges of the soil and did not draw from a belief: its regions and shares are "
            "shares of these ranges, not probabilities; predict with --soil BELIEF.json"
        )
    lost = forecast.members - len(matched.members)
    if lost:
        notes.append(f"{lost} of {forecast.members} predicted drives did not finish and were left out")
    if end is not None and not end.at_end:
        notes.append(f"the last position is of {end.time_s:.0f} s, before the end of the plan; ends are compared there")
    late = int((matched.record.time_s > forecast.time_s[-1]).sum())
    if late:
        notes.append(f"{late} of {len(matched.record.time_s)} states are later than the end of the plan and left out")
    if whole is None:
        notes.append("too few drives or values for a surprise of the whole drive")
    if not matched.independent[matched.counted].all():
        notes.append("slip that was derived from the positions does not count a second time in the surprise")
    return notes


def _not_compared(matched: MatchedObservations, end: EndCheck | None) -> dict[str, str]:
    result = {} if end else {"position": "not measured"}
    for k, name in enumerate(OBSERVED):
        if not matched.counted[:, k].any():
            measured = np.isfinite(matched.record.values[:, k]).any()
            result[name] = (
                "measured only at halts, in the first second or after the end" if measured else "not measured"
            )
    return result
