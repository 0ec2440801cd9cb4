"""How unusual measured ends, paths and wheel states are among the members of an ensemble, whatever its law.

The drive that happens is one more draw of the law that the members are drawn from, if the prediction is right. So its
distance from them is held against the distance of each member, errors of measurement included, from the others. That
counts correlation between neighbours, wheels and quantities for what it is. Beyond the farthest member the probability
falls on as it falls among the farthest of them, and not faster than in the normal law.

How well a sharp prediction met what came: continuous ranked probability score, energy score, and ranks."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist
from scipy.special import fdtrc, fdtri, ndtr, stdtrit

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.assimilation.residuals import MODEL_ERRORS, OBSERVED
from lunarsci.twin.comparison.forecast import MatchedObservations
from lunarsci.twin.judgement.endpoint import ErrorEllipse
from lunarsci.twin.plans.motion import CLOCK_S

WINDOW = 5.0
"""The sum over lags ends where it is this many correlation lengths long (Sokal 1997)."""
REGIONS = (0.5, 0.9, 0.95, 0.99)
"""Shares of a prediction that regions are given for."""
ALL = "all"
NOMINAL = 0.9
"""Share of values that the bands and the region of a check hold."""


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
    if members <= dimensions:
        return float("inf")
    factor = (members - 1) * dimensions / (members - dimensions)
    return float(factor * fdtri(dimensions, members - dimensions, probability))


def _beyond(squared: float, members: int, dimensions: int) -> float:
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
    of_wheel, each = np.zeros(vectors), np.zeros((vectors, count))
    for k in range(vectors):
        off = observed[k] - members[:, k].mean(axis=0)
        of_wheel[k] = _squared(off, spread_of(members[:, k], errors[k]))
        each[k] = squared_distances(members[:, k], errors[k], np.random.default_rng([seed, k]), free)
    most = int(of_wheel.argmax())
    return most, float(of_wheel[most]), _probability(float(of_wheel[most]), each.max(axis=0), size)


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

    return near - float(pdist(members).mean()) / 2.0


def predictive_rank(observed: FloatArray, sigma: FloatArray, members: FloatArray) -> FloatArray:
    """Probability that the prediction gave to less than each observed value, 0 to 1: even if the prediction is right.

    The prediction of a measured value is the mixture of the members (M, n) with normal errors sigma (n,): probability
    integral transform of A. P. Dawid (1984), J. R. Stat. Soc. A 147, 278, 10.2307/2981683. Half a rank keeps it off 0
    and 1.
    """
    total = np.zeros(observed.shape)
    for member in members:
        total += ndtr((observed - member) / sigma)
    return np.asarray((total + 0.5) / (len(members) + 1.0))


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


@dataclass(frozen=True, slots=True)
class EndCheck:
    """The last position beside the predicted ones.

    Attributes
    ----------
    time_s, at_end : when it was measured, and whether that is the end of the plan.
    x_m, y_m : measured. [m]
    predicted_x_m, predicted_y_m, planned_x_m, planned_y_m : mean of the members, and the plan, at that time. [m]
    error_m, planned_error_m : distance of the measured place from either. [m]
    standing : against the members; None where they are too few.
    regions : probability to whether the predicted region, error of the position included, holds the measured place.
    energy_score_m : as of `energy_score`. [m]
    """

    time_s: float
    at_end: bool
    x_m: float
    y_m: float
    predicted_x_m: float
    predicted_y_m: float
    planned_x_m: float
    planned_y_m: float
    error_m: float
    planned_error_m: float
    standing: Standing | None
    regions: dict[str, bool]
    energy_score_m: float


@dataclass(frozen=True, slots=True)
class FixCheck:
    """One position beside the predicted ones.

    Attributes
    ----------
    time_s : of the position, since the start of the plan. [s]
    distance_m : commanded by then. [m]
    error_m : distance from the mean of the predicted places. [m]
    standard : the same in standard deviations; None where members are too few. [-]
    inside_90 : whether it is in their 90 % region; None where members are too few for one.
    """

    time_s: float
    distance_m: float
    error_m: float
    standard: float | None
    inside_90: bool | None


@dataclass(frozen=True, slots=True)
class PathCheck:
    """All positions beside the predicted ones.

    Attributes
    ----------
    fixes : each, in time.
    rms_m, max_m : of the distance from the members' mean. [m]
    worst : the fix with the largest.
    inside_90 : share of the fixes in their 90 % region; None where the members are too few for one. [-]
    """

    fixes: tuple[FixCheck, ...]
    rms_m: float
    max_m: float
    worst: FixCheck
    inside_90: float | None


def check_end(matched: MatchedObservations, seed: int = 0) -> EndCheck | None:
    """The last position that falls into the drive or after it; None without positions."""
    times = matched.record.fix_time_s
    if not len(times):
        return None
    last = int(times.argmax())
    measured, members = matched.record.fix_m[last], matched.places[:, last]
    mean, planned, error = members.mean(axis=0), matched.planned[last], matched.place_error_m2[last]
    off = measured - mean
    enough = len(members) > len(off) + 2
    return EndCheck(
        time_s=float(times[last]),
        at_end=bool(times[last] >= matched.forecast.time_s[-1] - CLOCK_S),
        x_m=float(measured[0]),
        y_m=float(measured[1]),
        predicted_x_m=float(mean[0]),
        predicted_y_m=float(mean[1]),
        planned_x_m=float(planned[0]),
        planned_y_m=float(planned[1]),
        error_m=float(np.hypot(*off)),
        planned_error_m=float(np.hypot(*(measured - planned))),
        standing=standing(measured, members, error, seed),
        regions={f"{100 * share:g}": inside(off, members, error, share) for share in REGIONS} if enough else {},
        energy_score_m=energy_score(measured, members),
    )


def check_path(matched: MatchedObservations) -> PathCheck | None:
    """Every position; None without any."""
    if not len(matched.record.fix_time_s):
        return None
    fixes = tuple(_check_fix(matched, int(number)) for number in np.argsort(matched.record.fix_time_s, kind="stable"))
    errors = np.array([fix.error_m for fix in fixes])
    held = [fix.inside_90 for fix in fixes if fix.inside_90 is not None]
    return PathCheck(
        fixes=fixes,
        rms_m=float(np.sqrt((errors**2).mean())),
        max_m=float(errors.max()),
        worst=fixes[int(errors.argmax())],
        inside_90=float(np.mean(held)) if held else None,
    )


def _check_fix(matched: MatchedObservations, number: int) -> FixCheck:
    members, error = matched.places[:, number], matched.place_error_m2[number]
    off = matched.record.fix_m[number] - members.mean(axis=0)
    standard = None
    if len(members) > len(off) + 2:
        standard = float(np.sqrt(off @ np.linalg.solve(spread_of(members, error), off)))
    return FixCheck(
        time_s=float(matched.record.fix_time_s[number]),
        distance_m=float(matched.fix_distance_m[number]),
        error_m=float(np.hypot(*off)),
        standard=standard,
        inside_90=None if standard is None else bool(standard**2 <= region_edge(0.9, len(members), 2)),
    )


def region_ellipse(members: FloatArray, error: FloatArray, probability: float) -> ErrorEllipse | None:
    """The predicted region of a probability about the mean of places (M, 2), as an ellipse whose semi-axes at one
    standard deviation are those of the region; None for too few members. [m]
    """
    edge = region_edge(probability, len(members), 2)
    if len(members) < 4 or not np.isfinite(edge):
        return None
    values, vectors = np.linalg.eigh(spread_of(members, error))
    minor, major = np.sqrt(np.maximum(values, 0.0) * edge)
    azimuth = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))) % 180.0
    return ErrorEllipse(float(major), float(minor), azimuth, 1.0, float(major), float(minor), float("nan"))


@dataclass(frozen=True, slots=True)
class BandCheck:
    """One quantity of one wheel, or of all.

    Attributes
    ----------
    quantity, wheel : which; the wheel is `all` for all together.
    n, effective : values, and how many independent ones they are worth. [-]
    bias, rms : mean and root mean square of measured less predicted mean, in the quantity's unit.
    bias_standard : bias over the standard deviation that the prediction and the errors of measurement give it. [-]
    rms_standard : root mean square of the differences, each over its own standard deviation; 1 if all is right. [-]
    coverage_90 : share of the values in their predicted 90 % band, errors of measurement included. [-]
    crps : mean continuous ranked probability score, in the quantity's unit.
    """

    quantity: str
    wheel: str
    n: int
    effective: float
    bias: float
    rms: float
    bias_standard: float | None
    rms_standard: float | None
    coverage_90: float | None
    crps: float


def standardised(matched: MatchedObservations, column: int, rows: BoolArray) -> FloatArray:
    """Measured less predicted mean, over the root of the members' variance (1 + 1/M) and that of the error. (n,)"""
    members, sigma = matched.predicted[:, rows, column], matched.sigma[rows, column]
    count = len(members)
    variance = members.var(axis=0, ddof=1) * (1.0 + 1.0 / count) if count > 1 else 0.0
    off = matched.record.values[rows, column] - members.mean(axis=0)
    return np.asarray(off / np.sqrt(variance + sigma**2))


def check_bands(matched: MatchedObservations) -> list[BandCheck]:
    """Each quantity that was measured, of all wheels together and of each that has values."""
    wheel = np.array(matched.record.wheel)
    checks = []
    for name in matched.measured_quantities():
        counted = matched.counted[:, OBSERVED.index(name)]
        checks.append(_check(matched, name, ALL, counted))
        wheels = (w for w in matched.forecast.wheels if counted[wheel == w].any())
        checks += [_check(matched, name, w, counted & (wheel == w)) for w in wheels]
    return checks


def _check(matched: MatchedObservations, name: str, wheel: str, rows: BoolArray) -> BandCheck:
    column = OBSERVED.index(name)
    members, measured = matched.predicted[:, rows, column], matched.record.values[rows, column]
    off, several = measured - members.mean(axis=0), len(members) > 2
    bias = float(off.mean())
    of_wheel = members.mean(axis=1).var(ddof=1) * (1.0 + 1.0 / len(members)) if several else 0.0
    error = float((matched.sigma[rows, column] ** 2).mean()) / len(off) + MODEL_ERRORS[name] ** 2
    standard = standardised(matched, column, rows)
    return BandCheck(
        quantity=name,
        wheel=wheel,
        n=int(rows.sum()),
        effective=effective_values(matched, column, rows) if several else float(len(off)),
        bias=bias,
        rms=float(np.sqrt((off**2).mean())),
        bias_standard=bias / float(np.sqrt(of_wheel + error)) if several else None,
        rms_standard=float(np.sqrt((standard**2).mean())) if several else None,
        coverage_90=float((np.abs(standard) <= half_band(len(members))).mean()) if several else None,
        crps=float(crps(measured, members).mean()),
    )


def half_band(members: int) -> float:
    """Half the 90 % band of a normal law whose mean and deviation are known from so many members. [sd]"""
    return float(stdtrit(members - 1, 0.5 + NOMINAL / 2))


def effective_values(matched: MatchedObservations, column: int, rows: BoolArray) -> float:
    """Independent values among standardised differences: those of each wheel over their correlation length, summed.

    Wheels count as independent of each other, as far as the length along each tells nothing else. [-]
    """
    total, wheel = 0.0, np.array(matched.record.wheel)
    for one in sorted(set(wheel[rows])):
        of_wheel = rows & (wheel == one)
        order = np.argsort(matched.record.time_s[of_wheel], kind="stable")
        series = standardised(matched, column, of_wheel)[order]
        total += len(series) / correlation_length(series)
    return total


def ranks(matched: MatchedObservations, name: str) -> FloatArray:
    """Predictive rank of each value of a quantity, 0 to 1. (n,)"""
    column = OBSERVED.index(name)
    rows = matched.counted[:, column]
    return predictive_rank(
        matched.record.values[rows, column], matched.sigma[rows, column], matched.predicted[:, rows, column]
    )
