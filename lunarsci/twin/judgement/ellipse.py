"""Error ellipse of the ends of a drive."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["ErrorEllipse", "error_ellipse", "scale_of"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ErrorEllipse:
    """The ellipse of a covariance, about the mean.

    Attributes
    ----------
    semi_major_m, semi_minor_m : semi-axes at one standard deviation, roots of the covariance's eigenvalues. [m]
    azimuth_deg : direction of the major axis from x towards y, as a plan's heading, 0 <= azimuth < 180; 0 for a circle.
    factor_95 : sqrt(chi2.ppf(0.95, 2)) = 2.4477, by which the semi-axes grow to the ellipse that holds 95 % of a plane
        normal distribution. [-]
    semi_major_95_m, semi_minor_95_m : semi-axes of that ellipse. [m]
    share_inside_95 : share of the ends that lie in it, which tells how far from normal they are. [-]
    """

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float
    factor_95: float
    semi_major_95_m: float
    semi_minor_95_m: float
    share_inside_95: float


def scale_of(probability: float) -> float:
    """Standard deviations from the mean to the edge of the ellipse that holds `probability` of a plane normal law.

    The square of that distance has the chi-squared law with two degrees of freedom, whose quantile is
    -2 ln(1 - probability). [-]
    """
    return math.sqrt(-2.0 * math.log1p(-probability))


def error_ellipse(points_m: FloatArray) -> ErrorEllipse | None:
    """Ellipse of points (n, 2) about their mean, covariance with n - 1; None for fewer than two points. [m]"""
    if len(points_m) < 2:
        return None
    offsets = points_m - points_m.mean(axis=0)
    values, vectors = np.linalg.eigh(offsets.T @ offsets / (len(points_m) - 1))
    minor, major = np.sqrt(np.maximum(values, 0.0))
    across, along = offsets @ vectors[:, 0], offsets @ vectors[:, 1]
    factor = scale_of(0.95)
    # Rounding must not put points on a line outside of it.
    inside = np.abs(along) <= factor * major * (1 + 1e-9)
    if minor > 1e-9 * major:
        inside = (along / major) ** 2 + (across / minor) ** 2 <= factor**2
    azimuth = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1])) % 180.0
    return ErrorEllipse(
        semi_major_m=float(major),
        semi_minor_m=float(minor),
        azimuth_deg=azimuth if major - minor > 1e-12 * major else 0.0,
        factor_95=factor,
        semi_major_95_m=factor * float(major),
        semi_minor_95_m=factor * float(minor),
        share_inside_95=float(inside.mean()),
    )
