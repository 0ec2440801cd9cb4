"""The posterior of a soil after a drive, in coordinates that linearise it: density, mode and draws.

Stiffness and exponent of sinkage make up for each other in the pressure at the sinkage that was measured, cohesion and
friction in the strength under the pressure of the wheels. In coordinates of these, and not in the transforms of the
prior, soils that explain a drive lie along straight lines, and a normal law is near enough to a posterior to draw from.
The most probable soil is found by damped Gauss-Newton from many starts at once; how much wider than measured the errors
must be for the twin's physics to explain a drive follows from what it leaves.

Draws are proposed by an emulator of the drives and judged by drives. Drives simulated about the mode train an emulator,
chains on the emulator say where to simulate next, and after some rounds the chain's points are proposed to particles
that accept them by the true density, so that what the emulator misses is put right. The emulator is a quadratic
stand-in for residuals: they bend gently with linearised coordinates, so that second-order polynomials of each one
follow them over a posterior; the cost, a sum of their squares, then has the bent valleys of the true one.

Rasmussen (2003), Bayesian Statistics 7, 651 (posterior of an emulator as proposal); Christen & Fox (2005), J. Comput.
Graph. Stat. 14, 795, 10.1198/106186005X76983 (approximation judged by the exact density); Robert & Casella (2004),
Monte Carlo Statistical Methods, 2nd ed., ch. 7 (independence Metropolis).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, IndexArray
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.tempering import ACCEPTED, WALK, Moves, largest_power, mutate, weights
from lunarsci.twin.assimilation.residuals import HUBER, OBSERVED, POSITION, DriveResiduals, cost_of, robust_cost

BATCH = 8
"""Values of one wheel that are averaged; assumed longer than what sensors remember, shorter than a drive."""
MEDIAN_VARIANCE = np.pi / 2
"""Of the median of n normal values, times n over theirs."""
PRESSURE_PA = 5000.0
"""Mean pressure below a wheel about which coordinates are straight, near the 4 kPa of Ding et al. (2024),
10.1038/s41467-024-46233-8; no posterior depends on it."""
STIFFNESS, EXPONENT, COHESION, FRICTION = (
    PARAMETERS.index(name) for name in ("stiffness_kpa_m_n", "sinkage_exponent", "cohesion_pa", "friction_angle_deg")
)
"""Their places among the parameters."""
SHALLOW_M = 1e-4
"""Least typical sinkage: the coordinates need its logarithm."""
STARTS, DESCENTS, STEPS = 64, 4, 16
"""Soils looked at first, how many of them are followed down, and for how many steps at most."""
DAMPINGS = (1e-3, 1e-1, 1.0, 10.0, 100.0)
"""Of the steps that are tried from each point (Levenberg and Marquardt's, in parts of the curvature's diagonal)."""
WIDTH = 0.03
"""Of finite differences, in widths of the prior: above the noise of interpolated states, below curvature."""
LONGEST = 1.0
"""Step, in widths of the prior."""
CONVERGED, BEHIND = 0.1, 60.0
"""Fall of the cost that counts as none; how far behind the best a descent is given up after a few steps."""
PATIENCE = 3
"""Steps that every descent is given, however far behind it is."""
SPARE, MOST_SHARED = 1.5, 0.9
"""Effective number of drives for each coefficient of the fit, at least, but for this share of all drives. A worse fit
is accepted less often, and changes no law of the draws."""
RIDGE = 1e-8
"""Share added to the diagonal of the emulator's normal equations, so that they can be solved."""
FIRST, EACH, ROUNDS = 192, 128, 4
"""Drives of the first round and of each later one, and rounds at most."""
GOOD = 0.3
"""Standard deviation of the emulator's ln density, at new draws, below which it is trained enough."""
FREEDOM = 6.0
"""Degrees of freedom of the Student law of the first round: tails heavier than a posterior's."""
CHAIN, TUNED = 600, 200
"""Steps of a chain on the emulator, of which so many tune it."""
DIFFERENT = 0.25
"""Effective number of drives that chains begin at, as a share of the chains or the drives."""
PROPOSALS = Moves(3, 12, 0.1)
"""Proposals to the population."""
TOGETHER = 512
"""Chains that walk side by side, so that few particles cost no more steps than many."""


def wheel_errors(drive: DriveResiduals, residuals: FloatArray) -> dict[str, float]:
    """Standard deviation of an error that each wheel has of its own, by quantity, in the errors of its values.

    From whitened residuals of the best soil, such errors not removed (n, 6): the wheels' medians scatter more about
    their mean than noise would let them, as where rear wheels follow in ruts and the twin's do not (DerSimonian & Laird
    1986, 10.1016/0197-2456(86)90046-2).
    """
    from scipy.special import chdtri

    result = {}
    for k, name in enumerate(OBSERVED):
        parts = _by_wheel(drive, residuals[:, k], k)
        if len(parts) < 2:
            continue
        medians = np.array([np.median(part) for part in parts])
        noise = np.array([MEDIAN_VARIANCE / part.size for part in parts])
        weight = 1.0 / noise
        excess = (weight * (medians - np.average(medians, weights=weight)) ** 2).sum() - (len(parts) - 1)
        if excess + len(parts) - 1 > chdtri(len(parts) - 1, SIGNIFICANCE):
            result[name] = float(np.sqrt(excess / (weight.sum() - (weight**2).sum() / weight.sum())))
    return result


def inflation_of(drive: DriveResiduals, residuals: FloatArray, places: FloatArray) -> dict[str, float]:
    """Factor of the errors of each quantity, and of positions, above 1, from whitened residuals of the best soil.

    Those are of states (n, 6), and of positions (2 f,), x and y in turn.

    Independent residuals as large as their errors have means over batches of m values whose variance is 1/m. What the
    physics misses is alike along a stretch, and these means scatter more: their variance times m is the variance that
    errors need to have for as many values to count as independent (batch means; Flegal & Jones 2010,
    10.1214/09-AOS735). What a wheel has of its own throughout is left to `wheel_errors`. Residuals count as at most
    `HUBER`, so that outliers remain outliers, but those of positions, which are few.
    """
    from scipy.special import chdtri

    series = {POSITION: [part for part in (places[::2], places[1::2]) if part.size]}
    for k, name in enumerate(OBSERVED):
        parts = [part - np.median(part) for part in _by_wheel(drive, residuals[:, k], k)]
        series[name] = [np.clip(part, -HUBER, HUBER) for part in parts]
    result = {}
    for name, parts in series.items():
        # Sums over batches, over the root of their size: unit variance where values are independent.
        batches = [batch for part in parts for batch in np.array_split(part, max(1, round(len(part) / BATCH)))]
        means = np.array([batch.sum() / np.sqrt(batch.size) for batch in batches])
        if means.size < 2:
            continue
        variance = float((means**2).mean())
        if variance > chdtri(means.size, SIGNIFICANCE) / means.size:
            result[name] = float(np.sqrt(variance))
    return result


def _by_wheel(drive: DriveResiduals, values: FloatArray, k: int) -> list[FloatArray]:
    """Those of some values (n,) of quantity k that count, for each wheel that has any."""
    counted, wheels = drive.counted[:, k], np.array(drive.record.wheel)
    parts = [values[counted & (wheels == name)] for name in dict.fromkeys(drive.record.wheel)]
    return [part for part in parts if part.size]


@dataclass(frozen=True, slots=True)
class SoilCoordinates:
    """From transforms (ln K, ln N, n1, ln c, ln tan phi, ln K_x, ln tan phi_y, ln K_y) and back.

    ln K becomes ln K + N ln z, ln N becomes N, and ln tan phi becomes ln (c + sigma tan phi).

    Attributes
    ----------
    sinkage_m : typical sinkage z of the drive, > 0. [m]
    """

    sinkage_m: float

    def from_transforms(self, transforms: FloatArray) -> FloatArray:
        """(..., 8) from transforms of the same shape."""
        points = np.array(transforms, dtype=np.float64)
        strength = np.exp(transforms[..., COHESION]) + PRESSURE_PA * np.exp(transforms[..., FRICTION])
        points[..., EXPONENT] = np.exp(transforms[..., EXPONENT])
        points[..., STIFFNESS] += np.log(self.sinkage_m) * points[..., EXPONENT]
        points[..., FRICTION] = np.log(strength)
        return points

    def transforms(self, points: FloatArray) -> FloatArray:
        """The inverse; NaN where no soil has such coordinates. (..., 8)"""
        back = np.array(points, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            frictional = np.exp(points[..., FRICTION]) - np.exp(points[..., COHESION])
            back[..., FRICTION] = np.log(frictional / PRESSURE_PA)
            back[..., EXPONENT] = np.log(points[..., EXPONENT])
            back[..., STIFFNESS] -= np.log(self.sinkage_m) * points[..., EXPONENT]
        back[~np.isfinite(back).all(axis=-1)] = np.nan
        return back

    def ln_volume(self, transforms: FloatArray) -> FloatArray:
        """ln of the volume of transforms for each volume of coordinates. (...)"""
        frictional = PRESSURE_PA * np.exp(transforms[..., FRICTION])
        strength = np.exp(transforms[..., COHESION]) + frictional
        return np.asarray(np.log(strength / frictional) - transforms[..., EXPONENT])


@dataclass(frozen=True, slots=True, eq=False)
class DrivePosterior:
    """Residuals and prior over linearised coordinates.

    Attributes
    ----------
    drive : residuals of drives; its belief is the prior.
    coordinates : in which a posterior is nearly normal.
    root : lower Cholesky factor of the belief's covariance. (8, 8)
    """

    drive: DriveResiduals
    coordinates: SoilCoordinates
    root: FloatArray

    def residuals(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals of the drive (points, r) and of the prior (points, 8), infinite where there is no soil."""
        transforms = self.coordinates.transforms(points)
        rows = self.drive.residuals(transforms)
        return rows, self.of_prior(np.where(np.isfinite(rows[:, :1]), transforms, np.inf))

    def of_prior(self, transforms: FloatArray) -> FloatArray:
        """Whitened distance from the belief's mean. (points, 8)"""
        off = transforms - self.drive.belief.mean
        white = np.full(off.shape, np.inf)
        counted = np.isfinite(off).all(axis=1)
        white[counted] = np.linalg.solve(self.root, off[counted].T).T
        return white

    def cost(self, points: FloatArray) -> FloatArray:
        """-2 ln of likelihood times prior of the transforms, up to a constant. (points,)"""
        return cost_of(*self.residuals(points))

    def with_density(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals of the drive (points, r), and ln of the density of the coordinates up to a constant, -inf
        where there is no soil. (points,)"""
        rows = self.residuals(points)[0]
        counted = np.isfinite(rows[:, 0])
        density = np.full(len(points), -np.inf)
        density[counted] = self.ln_prior(points[counted]) - 0.5 * robust_cost(rows[counted]).sum(axis=1)
        return rows, density

    def ln_prior(self, points: FloatArray) -> FloatArray:
        """ln of the prior density of the coordinates up to a constant; -inf where there is no soil. (points,)"""
        transforms = self.coordinates.transforms(points)
        counted = self.drive.near(transforms)
        density = np.full(len(points), -np.inf)
        inside = transforms[counted]
        density[counted] = self.coordinates.ln_volume(inside) - 0.5 * (self.of_prior(inside) ** 2).sum(axis=1)
        return density

    def ln_evidence(self, mode: "PosteriorMode") -> float:
        """ln of the probability of what was measured, up to a constant of drive and belief: Laplace's method at a mode.

        MacKay (2003), Information Theory, Inference, and Learning Algorithms, ch. 27 and 28.
        """
        volume = float(self.coordinates.ln_volume(self.coordinates.transforms(mode.point)))
        spread = 0.5 * float(np.linalg.slogdet(mode.covariance)[1])
        return volume + spread - 0.5 * mode.cost - self.drive.ln_errors

    def draw_prior(self, count: int, random: np.random.Generator) -> FloatArray:
        """The belief's mean, and draws from it, as coordinates. (count, 8)"""
        noise = random.standard_normal((count - 1, len(self.root)))
        mean = self.drive.belief.mean
        return self.coordinates.from_transforms(np.vstack([mean, mean + noise @ self.root.T]))


def posterior_of(drive: DriveResiduals) -> DrivePosterior:
    """The posterior in the coordinates of its typical sinkage, 1 cm where none was measured."""
    sinkage = drive.record.values[drive.counted[:, 0], 0]
    typical = float(np.median(sinkage)) if sinkage.size else 0.01
    root = np.asarray(np.linalg.cholesky(drive.belief.covariance), dtype=np.float64)
    return DrivePosterior(drive, SoilCoordinates(max(typical, SHALLOW_M)), root)


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorMode:
    """The most probable soil.

    Attributes
    ----------
    point : its coordinates, those of `DrivePosterior.coordinates`. (8,)
    cost : -2 ln of likelihood times prior there, up to a constant.
    covariance : inverse of the curvature of half the cost there. (8, 8)
    """

    point: FloatArray
    cost: float
    covariance: FloatArray


def find_mode(
    posterior: "DrivePosterior", random: np.random.Generator, starts: FloatArray | None = None
) -> PosteriorMode | None:
    """The lowest cost that any descent reached; None where no soil of the belief carries the rover to the end.

    Descents begin at `starts` (k, 8), or at draws from the belief.
    """
    starts = posterior.draw_prior(STARTS, random) if starts is None else starts
    looked = _Looked.at(posterior, starts)
    best = looked.best_first()[:DESCENTS]
    here = looked.part(best[np.isfinite(looked.costs[best])])
    if not here.costs.size:
        return None
    width = _width(posterior, here.points[0])
    for step in range(STEPS):
        curvature, slope = _local(posterior, here, width)
        trials = _best_trials(posterior, here.points, curvature, slope, width)
        falls = here.costs - trials.costs
        here = here.replaced(trials, falls > 0.0)
        first = here.best_first()[0]
        if falls[first] < CONVERGED and step >= PATIENCE:
            break
        if step >= PATIENCE:
            here = here.part(here.costs < here.costs[first] + BEHIND)
    lowest = here.part(here.best_first()[:1])
    curvature, _ = _local(posterior, lowest, width)
    return PosteriorMode(lowest.points[0], float(lowest.costs[0]), np.asarray(np.linalg.inv(curvature[0])))


@dataclass(frozen=True, slots=True, eq=False)
class _Looked:
    """Points that were driven on.

    Attributes
    ----------
    points : coordinates of soils. (k, 8)
    rows : whitened residuals of the drive, then of the prior. (k, r + 8)
    costs : as `DrivePosterior.cost` has them; infinite where no rover arrives. (k,)
    """

    points: FloatArray
    rows: FloatArray
    costs: FloatArray

    @classmethod
    def at(cls, posterior: "DrivePosterior", points: FloatArray) -> "_Looked":
        drive, prior = posterior.residuals(points)
        return cls(points, np.concatenate([drive, prior], axis=1), cost_of(drive, prior))

    def part(self, which: npt.NDArray[Any]) -> "_Looked":
        return _Looked(self.points[which], self.rows[which], self.costs[which])

    def best_first(self) -> IndexArray:
        return np.argsort(self.costs)

    def replaced(self, other: "_Looked", where: BoolArray) -> "_Looked":
        points, rows = (
            np.where(where[:, None], a, b) for a, b in ((other.points, self.points), (other.rows, self.rows))
        )
        return _Looked(points, rows, np.where(where, other.costs, self.costs))


def _width(posterior: "DrivePosterior", point: FloatArray) -> FloatArray:
    """Of the prior along each coordinate, others held. (8,)"""
    transforms = posterior.coordinates.transforms(point)
    spread = np.sqrt(np.diag(posterior.drive.belief.covariance))
    moved = posterior.coordinates.from_transforms(transforms + np.diag(spread))
    return np.asarray(np.abs(np.diag(moved - point)))


def _local(posterior: "DrivePosterior", at: _Looked, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Curvature (k, 8, 8) and slope (k, 8) of half the cost at points (k, 8), from central differences.

    Where one neighbour carries no rover the difference is one-sided; where neither does it is 0, and the
    curvature that of the prior.
    """
    count, size = at.points.shape
    steps = np.vstack([np.diag(WIDTH * width), -np.diag(WIDTH * width)])
    drive, prior = posterior.residuals((at.points[:, None] + steps[None]).reshape(-1, size))
    rows = np.concatenate([drive, prior], axis=1).reshape(count, len(steps), -1)
    curvature, slope = np.zeros((count, size, size)), np.zeros((count, size))
    for k in range(count):
        here, up, down = at.rows[k], rows[k, :size], rows[k, size:]
        columns = _differences(here, up, down) / (WIDTH * width)[:, None]
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(here), HUBER))
        weight[-size:] = 1.0
        curvature[k] = (columns * weight) @ columns.T
        slope[k] = (columns * weight) @ here
        idle = np.diag(curvature[k]) == 0.0
        curvature[k][idle, idle] = width[idle] ** -2
    return curvature, slope


def _differences(here: FloatArray, up: FloatArray, down: FloatArray) -> FloatArray:
    """Of residuals (8, r) for one step along each coordinate."""
    above, below = np.isfinite(up).all(axis=1), np.isfinite(down).all(axis=1)
    result = np.zeros(up.shape)
    both = above & below
    result[both] = 0.5 * (up[both] - down[both])
    result[above & ~below] = up[above & ~below] - here
    result[below & ~above] = here - down[below & ~above]
    return result


def _best_trials(
    posterior: "DrivePosterior", points: FloatArray, curvature: FloatArray, slope: FloatArray, width: FloatArray
) -> _Looked:
    """The best of several damped steps from each point."""
    trials = np.empty((len(points), len(DAMPINGS), points.shape[1]))
    for k, (matrix, side) in enumerate(zip(curvature, slope, strict=True)):
        scale = np.diag(np.maximum(np.diag(matrix), width**-2))
        for m, damping in enumerate(DAMPINGS):
            step = -np.linalg.solve(matrix + damping * scale, side)
            trials[k, m] = points[k] + np.clip(step, -LONGEST * width, LONGEST * width)
    looked = _Looked.at(posterior, trials.reshape(-1, points.shape[1]))
    best = np.argmin(looked.costs.reshape(len(points), -1), axis=1)
    return looked.part(len(DAMPINGS) * np.arange(len(points)) + best)


@dataclass(frozen=True, slots=True, eq=False)
class Emulator:
    """Cost of a drive as q^T A q, with q the monomials 1, v_i, v_i v_j of scaled coordinates v.

    Attributes
    ----------
    center, inverse : v = inverse (point - center). (p,), (p, p)
    form : A, symmetric and positive semi-definite. (m, m)
    """

    center: FloatArray
    inverse: FloatArray
    form: FloatArray

    def cost(self, points: FloatArray) -> FloatArray:
        """-2 ln likelihood up to a constant. (points,)"""
        q = monomials((points - self.center) @ self.inverse.T)
        return np.asarray(np.einsum("ij,ij->i", q @ self.form, q))


@cache
def _pairs(count: int) -> tuple[IndexArray, IndexArray]:
    """Numbers i <= j of all pairs of so many coordinates."""
    return np.triu_indices(count)


def monomials(scaled: FloatArray) -> FloatArray:
    """Of order 0, 1 and 2. (points, 1 + p + p (p + 1) / 2)"""
    row, column = _pairs(scaled.shape[1])
    return np.hstack([np.ones((len(scaled), 1)), scaled, scaled[:, row] * scaled[:, column]])


def fit_emulator(
    points: FloatArray, rows: FloatArray, cost: FloatArray, center: FloatArray, root: FloatArray
) -> Emulator:
    """Fit residuals by weighted least squares.

    Parameters
    ----------
    points : where drives were simulated. (d, p)
    rows : their residuals, each weighted so that squares add up to the cost. (d, r)
    cost : -2 ln of posterior; drives count less the higher theirs is. (d,)
    center, root : of a normal law about as wide as the posterior. (p,), lower Cholesky factor (p, p)
    """
    inverse: FloatArray = np.asarray(np.linalg.inv(root), dtype=np.float64)
    q = monomials((points - center) @ inverse.T)
    power = largest_power(-0.5 * cost, min(SPARE * q.shape[1], MOST_SHARED * len(cost)))
    weight = np.sqrt(weights(-0.5 * power * cost))[:, None]
    weighted = weight * q
    matrix = weighted.T @ weighted
    matrix[np.diag_indices(len(matrix))] *= 1.0 + RIDGE
    coefficients = np.linalg.solve(matrix, weighted.T @ (weight * rows))
    return Emulator(center, inverse, coefficients @ coefficients.T)


@dataclass(frozen=True, slots=True, eq=False)
class _Drives:
    """Simulated drives that arrived.

    Attributes
    ----------
    points : coordinates of their soils. (d, p)
    rows : whitened residuals, those that are outliers at the mode weighed down as there. (d, r)
    ln_density : of the coordinates, up to a constant, as `DrivePosterior.with_density` has it. (d,)
    """

    points: FloatArray
    rows: FloatArray
    ln_density: FloatArray

    def joined(self, more: "_Drives") -> "_Drives":
        return _Drives(
            np.vstack([self.points, more.points]),
            np.vstack([self.rows, more.rows]),
            np.concatenate([self.ln_density, more.ln_density]),
        )


def draw_particles(
    posterior: "DrivePosterior",
    mode: "PosteriorMode",
    particles: int,
    random: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, float]:
    """Draws from a posterior.

    Parameters
    ----------
    posterior : residuals and prior over linearised coordinates.
    mode : its most probable point.
    particles : how many draws.
    random : source of random numbers.
    progress : called with (done, total).

    Returns
    -------
    (particles, 8) coordinates, and the largest correlation of one of them with where the last moves began. [-]
    """
    report, total = progress or (lambda done, of: None), ROUNDS + PROPOSALS.most
    here = np.abs(posterior.residuals(mode.point[None])[0][0])
    weight = np.asarray(np.sqrt(HUBER / np.maximum(here, HUBER)))
    root: FloatArray = np.asarray(np.linalg.cholesky(mode.covariance), dtype=np.float64)
    noise = random.standard_normal((FIRST, len(root))) @ root.T
    spread = np.sqrt(random.chisquare(FREEDOM, FIRST) / FREEDOM)[:, None]
    drives = _simulated(posterior, weight, np.vstack([mode.point, mode.point + noise / spread]))
    for number in range(ROUNDS):
        report(number, total)
        emulated = _Emulated(posterior, drives, mode, root)
        chain = emulated.chain(drives, EACH, random)
        fresh = _simulated(posterior, weight, chain)
        misses = fresh.ln_density - emulated.ln_density(fresh.points)
        drives = drives.joined(fresh)
        if len(misses) > EACH // 2 and np.std(misses) < GOOD:
            break
    emulated = _Emulated(posterior, drives, mode, root)
    population = _Proposed(posterior, emulated, drives, particles, random)
    _, left = mutate(population, 1.0, PROPOSALS, lambda done: report(ROUNDS + done, total))
    report(total, total)
    arrived = np.flatnonzero(np.isfinite(population.excess))
    return population.points[arrived[np.arange(particles) % len(arrived)]], left


def _simulated(posterior: "DrivePosterior", weight: FloatArray, points: FloatArray) -> _Drives:
    """Drives at points (k, p), those that arrive; `weight` is of each residual. (r,)"""
    rows, ln_density = posterior.with_density(points)
    arrived = np.isfinite(ln_density)
    return _Drives(points[arrived], weight * rows[arrived], ln_density[arrived])


class _Emulated:
    """The posterior with drives by an emulator, prior and coordinates as they are.

    `root` (p, p), the lower Cholesky factor of the mode's covariance, scales the emulator's coordinates.
    """

    def __init__(self, posterior: "DrivePosterior", drives: _Drives, mode: "PosteriorMode", root: FloatArray) -> None:
        self.posterior = posterior
        self.emulator = fit_emulator(drives.points, drives.rows, -2.0 * drives.ln_density, mode.point, root)

    def ln_density(self, points: FloatArray) -> FloatArray:
        """Up to the same constant as the true one; -inf where there is no soil. (points,)"""
        return self.posterior.ln_prior(points) - 0.5 * self.emulator.cost(points)

    def chain(self, drives: _Drives, count: int, random: np.random.Generator) -> FloatArray:
        """Ends of as many random walks, begun at drives by their density. (count, p)"""
        # By a flattened density, so that many of them differ.
        ln_density = self.ln_density(drives.points)
        power = largest_power(ln_density, DIFFERENT * min(count, len(ln_density)))
        points = drives.points[random.choice(len(ln_density), count, p=weights(power * ln_density))]
        values, scale = self.ln_density(points), WALK / np.sqrt(points.shape[1])
        root = np.linalg.inv(self.emulator.inverse)
        for step in range(CHAIN):
            if step % (TUNED // 4) == 0 and 0 < step <= TUNED:
                root = np.linalg.cholesky(np.cov(points.T) + 1e-9 * root @ root.T)
            trial = points + scale * random.standard_normal(points.shape) @ root.T
            best = self.ln_density(trial)
            accepted = np.log(random.random(count)) < best - values
            points, values = np.where(accepted[:, None], trial, points), np.where(accepted, best, values)
            if step < TUNED:
                scale *= np.exp(0.3 * (accepted.mean() - ACCEPTED))
        return points


class _Proposed:
    """Independence Metropolis: draws of the emulator are accepted by how much denser the truth has them.

    What `mutate` moves: `points` are the particles (particles, p), `excess` the ln of the true density over that of the
    emulator there (particles,); -inf where no rover arrives.
    """

    def __init__(
        self,
        posterior: "DrivePosterior",
        emulated: _Emulated,
        drives: _Drives,
        particles: int,
        random: np.random.Generator,
    ) -> None:
        self._posterior, self._emulated, self._drives, self._random = posterior, emulated, drives, random
        self._ready: list[FloatArray] = []
        self.points, self.excess = self._drawn(particles)

    def _drawn(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Points of the emulator's chains, and by how much the truth has them denser."""
        if not self._ready:
            times = min(max(TOGETHER // count, 1), PROPOSALS.most + 1)
            ends = self._emulated.chain(self._drives, times * count, self._random)
            self._ready = list(self._random.permutation(ends).reshape(times, count, -1))
        points = self._ready.pop()
        return points, self._posterior.with_density(points)[1] - self._emulated.ln_density(points)

    def move(self, beta: float) -> None:
        trial, best = self._drawn(len(self.points))
        accepted = ~(np.log(self._random.random(len(trial))) >= best - self.excess)
        self.points = np.where(accepted[:, None], trial, self.points)
        self.excess = np.where(accepted, best, self.excess)
