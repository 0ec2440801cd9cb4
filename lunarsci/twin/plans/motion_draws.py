"""Motions that a measured one may have been: its errors, smooth along the drive, put on it."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.plans.motion import Motion

__all__ = ["CORRELATION_M", "correlation_of", "drawn_motions"]

FloatArray = npt.NDArray[np.float64]
CORRELATION_M = 0.5
"""Distance over which errors of a smoothed motion stay alike, where nothing tells it; assumed. [m]"""
WAVES = 48
"""Of which an error is made up; its covariance is exact for any number, with more it also is nearly normal."""


def correlation_of(motion: Motion, slip_ratio: FloatArray, slip_sigma: FloatArray) -> float | None:
    """Distance over which the motion's errors stay alike, as the errors of slips that were derived from it tell. [m]

    Errors of x and y of sigma, alike over a length l, are errors of sigma / l in the speed over ground as a share of
    the rims', and so of the slip ratio's travel v / (r_s omega) = 1 - s. None where motion or slips have no errors.

    Parameters
    ----------
    slip_ratio, slip_sigma : of any wheel states along the motion. (n,) [-]
    """
    known = np.isfinite(slip_ratio) & np.isfinite(slip_sigma) & (slip_sigma > 0)
    if motion.sigmas is None or not known.any():
        return None
    sigma = float(np.median(np.sqrt((motion.sigmas[:, :2] ** 2).mean(axis=1))))
    return sigma / float(np.median(slip_sigma[known])) if sigma > 0 else None


def drawn_motions(motion: Motion, count: int, correlation_m: float, rng: np.random.Generator) -> Iterator[Motion]:
    """Motions with errors of the given sigmas; without sigmas the motion itself, `count` times.

    Errors of x, y and yaw are independent normal processes over the distance that the rims rolled, with correlation
    exp(-d^2 / 2 l^2). They have to be smooth: errors of 5 mm that were independent from second to second would be
    errors of 7 mm/s of a rover that drives at 50 mm/s.

    Parameters
    ----------
    motion : as measured.
    count : how many, 1 or more.
    correlation_m : the length l, above 0. [m]
    rng : source of random numbers.

    Raises ParameterError. Waves of random length have that correlation on average (Rahimi & Recht 2007, Random features
    for large-scale kernel machines, NIPS 20, 1177).
    """
    if count < 1:
        raise ParameterError(f"{count} draws of the motion; give 1 or more")
    if not 0 < correlation_m < np.inf:
        raise ParameterError(f"the errors' correlation length is {correlation_m:g} m; give a number above 0")
    return _motions(motion, count, motion.rolled_m / correlation_m, rng)


def _motions(motion: Motion, count: int, place: FloatArray, rng: np.random.Generator) -> Iterator[Motion]:
    for _ in range(count):
        if motion.sigmas is None:
            yield motion
            continue
        wave, size = rng.standard_normal((3, WAVES, 1)), rng.standard_normal((2, 3, WAVES, 1)) / np.sqrt(WAVES)
        error = (size[0] * np.cos(wave * place) + size[1] * np.sin(wave * place)).sum(axis=1)
        x, y, yaw = error * motion.sigmas.T
        yield dataclasses.replace(motion, x_m=motion.x_m + x, y_m=motion.y_m + y, yaw_deg=motion.yaw_deg + yaw)
