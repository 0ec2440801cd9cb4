"""The posterior of a soil after a drive, in straight coordinates: residuals for its mode, density for its draws.

Coordinates of a soil in which the soils that explain a drive lie along straight lines rather than curves.

Stiffness and exponent of sinkage make up for each other in the pressure at the sinkage that was measured, cohesion and
friction in the strength under the pressure of the wheels. In these coordinates, and not in the transforms of the prior,
a normal law is near enough to a posterior to draw from.

How much wider than measured the errors must be for the twin's physics to explain a drive.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.inference.drive_record import OBSERVED
from lunarsci.twin.inference.misfit import HUBER, POSITION, Misfit, cost_of, robust_cost

__all__ = ["PRESSURE_PA", "DrivePosterior", "Straight", "inflation_of", "posterior_of", "wheel_errors"]

FloatArray = npt.NDArray[np.float64]
BATCH = 8
"""Values of one wheel that are averaged; assumed longer than what sensors remember, shorter than a drive."""
CHANCE = 0.01
"""That a variance as large as found comes from the errors alone; below it, errors are widened."""
MEDIAN_VARIANCE = np.pi / 2
"""Of the median of n normal values, times n over theirs."""


def wheel_errors(misfit: Misfit, residuals: FloatArray) -> dict[str, float]:
    """Standard deviation of an error that each wheel has of its own, by quantity, in the errors of its values.

    From whitened residuals of the best soil, such errors not removed (n, 6): the wheels' medians scatter more about
    their mean than noise would let them, as where rear wheels follow in ruts and the twin's do not (DerSimonian & Laird
    1986, 10.1016/0197-2456(86)90046-2).
    """
    from scipy.stats import chi2

    result = {}
    for k, name in enumerate(OBSERVED):
        parts = _by_wheel(misfit, residuals[:, k], k)
        if len(parts) < 2:
            continue
        medians = np.array([np.median(part) for part in parts])
        noise = np.array([MEDIAN_VARIANCE / part.size for part in parts])
        weight = 1.0 / noise
        excess = (weight * (medians - np.average(medians, weights=weight)) ** 2).sum() - (len(parts) - 1)
        if excess + len(parts) - 1 > chi2.isf(CHANCE, len(parts) - 1):
            result[name] = float(np.sqrt(excess / (weight.sum() - (weight**2).sum() / weight.sum())))
    return result


def inflation_of(misfit: Misfit, residuals: FloatArray, places: FloatArray) -> dict[str, float]:
    """Factor of the errors of each quantity, and of positions, above 1, from whitened residuals of the best soil.

    Those are of states (n, 6), and of positions (2 f,), x and y in turn.

    Independent residuals as large as their errors have means over batches of m values whose variance is 1/m. What the
    physics misses is alike along a stretch, and these means scatter more: their variance times m is the variance that
    errors need to have for as many values to count as independent (batch means; Flegal & Jones 2010,
    10.1214/09-AOS735). What a wheel has of its own throughout is left to `wheel_errors`. Residuals count as at most
    `HUBER`, so that outliers remain outliers, but those of positions, which are few.
    """
    from scipy.stats import chi2

    series = {POSITION: [part for part in (places[::2], places[1::2]) if part.size]}
    for k, name in enumerate(OBSERVED):
        parts = [part - np.median(part) for part in _by_wheel(misfit, residuals[:, k], k)]
        series[name] = [np.clip(part, -HUBER, HUBER) for part in parts]
    result = {}
    for name, parts in series.items():
        means = _batch_means(parts)
        if means.size < 2:
            continue
        variance = float((means**2).mean())
        if variance > chi2.isf(CHANCE, means.size) / means.size:
            result[name] = float(np.sqrt(variance))
    return result


def _by_wheel(misfit: Misfit, values: FloatArray, k: int) -> list[FloatArray]:
    known, wheels = misfit.known[:, k], np.array(misfit.record.wheel)
    parts = [values[known & (wheels == name)] for name in dict.fromkeys(misfit.record.wheel)]
    return [part for part in parts if part.size]


def _batch_means(parts: list[FloatArray]) -> FloatArray:
    """Sums over batches, over the root of their size: unit variance where values are independent."""
    batches = [batch for part in parts for batch in np.array_split(part, max(1, round(len(part) / BATCH)))]
    return np.array([batch.sum() / np.sqrt(batch.size) for batch in batches])


PRESSURE_PA = 5000.0
"""Mean pressure below a wheel; assumed, near the 4 kPa of Ding et al. (2024), 10.1038/s41467-024-46233-8."""
STIFFNESS, EXPONENT, COHESION, FRICTION = (
    PARAMETERS.index(name) for name in ("stiffness_kpa_m_n", "sinkage_exponent", "cohesion_pa", "friction_angle_deg")
)


@dataclass(frozen=True, slots=True)
class Straight:
    """From transforms (ln K, ln N, n1, ln c, ln tan phi, ln K_x, ln tan phi_y, ln K_y) and back.

    ln K becomes ln K + N ln z, ln N becomes N, and ln tan phi becomes ln (c + sigma tan phi).

    Attributes
    ----------
    sinkage_m : typical sinkage z of the drive, > 0. [m]
    """

    sinkage_m: float

    def straightened(self, transforms: FloatArray) -> FloatArray:
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


SHALLOW_M = 1e-4
"""Least typical sinkage: the coordinates need its logarithm."""


@dataclass(frozen=True, slots=True, eq=False)
class DrivePosterior:
    """Misfit and prior over straight coordinates.

    Attributes
    ----------
    misfit : of drives; its belief is the prior.
    straight : the coordinates.
    root : lower Cholesky factor of the belief's covariance. (8, 8)
    """

    misfit: Misfit
    straight: Straight
    root: FloatArray

    def residuals(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals of the drive (points, r) and of the prior (points, 8), infinite where there is no soil."""
        transforms = self.straight.transforms(points)
        rows = self.misfit.residuals(transforms)
        return rows, self.of_prior(np.where(np.isfinite(rows[:, :1]), transforms, np.inf))

    def of_prior(self, transforms: FloatArray) -> FloatArray:
        """Whitened distance from the belief's mean. (points, 8)"""
        off = transforms - self.misfit.belief.mean
        white = np.full(off.shape, np.inf)
        known = np.isfinite(off).all(axis=1)
        white[known] = np.linalg.solve(self.root, off[known].T).T
        return white

    def cost(self, points: FloatArray) -> FloatArray:
        """-2 ln of likelihood times prior of the transforms, up to a constant. (points,)"""
        return cost_of(*self.residuals(points))

    def with_density(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals of the drive (points, r), and ln of the density of the coordinates up to a constant, -inf
        where there is no soil. (points,)"""
        rows = self.residuals(points)[0]
        known = np.isfinite(rows[:, 0])
        density = np.full(len(points), -np.inf)
        density[known] = self.ln_prior(points[known]) - 0.5 * robust_cost(rows[known]).sum(axis=1)
        return rows, density

    def ln_prior(self, points: FloatArray) -> FloatArray:
        """ln of the prior density of the coordinates up to a constant; -inf where there is no soil. (points,)"""
        transforms = self.straight.transforms(points)
        known = self.misfit.near(transforms)
        density = np.full(len(points), -np.inf)
        inside = transforms[known]
        density[known] = self.straight.ln_volume(inside) - 0.5 * (self.of_prior(inside) ** 2).sum(axis=1)
        return density

    def draw_prior(self, count: int, random: np.random.Generator) -> FloatArray:
        """The belief's mean, and draws from it, as coordinates. (count, 8)"""
        noise = random.standard_normal((count - 1, len(self.root)))
        mean = self.misfit.belief.mean
        return self.straight.straightened(np.vstack([mean, mean + noise @ self.root.T]))


def posterior_of(misfit: Misfit) -> DrivePosterior:
    """The posterior in the coordinates of its typical sinkage, 1 cm where none was measured."""
    sinkage = misfit.record.values[misfit.known[:, 0], 0]
    typical = float(np.median(sinkage)) if sinkage.size else 0.01
    root = np.asarray(np.linalg.cholesky(misfit.belief.covariance), dtype=np.float64)
    return DrivePosterior(misfit, Straight(max(typical, SHALLOW_M)), root)
