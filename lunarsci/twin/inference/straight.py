"""Coordinates of a soil in which the soils that explain a drive lie along straight lines rather than curves.

Stiffness and exponent of sinkage make up for each other in the pressure at the sinkage that was measured, cohesion and
friction in the strength under the pressure of the wheels. In these coordinates, and not in the transforms of the prior,
a normal law is near enough to a posterior to draw from.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.regolith.prior import PARAMETERS

__all__ = ["PRESSURE_PA", "Straight"]

FloatArray = npt.NDArray[np.float64]
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
