"""What the forces of all wheels add up to: force ahead, force to the left and moment about the vertical."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.loads.held import HeldForces
from lunarsci.twin.simulation.contact_frame import shear_center
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS

__all__ = ["FORCES", "levers_of", "missing_of", "needed_of"]

FloatArray = npt.NDArray[np.float64]
FORCES = ("normal_force_n", "drawbar_pull_n", "lateral_force_n")
"""Forces of a wheel, in the order of all arrays here."""
COLUMNS = [STATE_COLUMNS.index(name) for name in FORCES]


def levers_of(found: HeldForces) -> FloatArray:
    """What one newton of each wheel's forces adds to the totals. (n, 3 totals, wheels, 3 forces) [-, -, m]

    The forces act along the normal, ahead along and sideways against the contact axes at the wheel's centre; the
    lateral one where the shear stress is centred.
    """
    ahead, below = _shear_centers(found)
    e, d, n = (found.axes[:, :, k] for k in range(3))
    along = np.stack([n, e, -d], axis=2)  # (n, wheels, forces, xyz)
    turn = np.cross(found.arms[:, :, None], along)[..., 2]
    turn[..., 2] += -below * e[..., 2] - ahead * n[..., 2]
    yaw = np.radians(found.motion.yaw_deg)[:, None, None]
    forward = np.cos(yaw) * along[..., 0] + np.sin(yaw) * along[..., 1]
    left = np.cos(yaw) * along[..., 1] - np.sin(yaw) * along[..., 0]
    return np.stack([forward, left, turn], axis=1)


def missing_of(found: HeldForces) -> FloatArray:
    """What the wheels do not supply of the totals. (n, 3) [N, N, N m]"""
    return np.column_stack([found.missing_n, found.missing_nm])


def needed_of(found: HeldForces, levers: FloatArray) -> FloatArray:
    """What drawbar pulls and lateral forces have to add up to for the motion: (n, 3) [N, N, N m]

    Weight and slope are in the normal forces; these follow from the levers of the suspension and hardly from the soil.
    """
    forces = found.states[..., COLUMNS][..., 1:]
    return np.asarray(np.einsum("ntwf,nwf->nt", levers[..., 1:], forces) + missing_of(found))


def _shear_centers(found: HeldForces) -> tuple[FloatArray, FloatArray]:
    sinkage, slip = (found.states[..., STATE_COLUMNS.index(name)] for name in ("sinkage_m", "slip_ratio"))
    tyre = found.rover.wheel.vector()
    pairs = [
        shear_center(z, s, tyre) if np.isfinite(z) else (np.nan, np.nan)
        for z, s in zip(sinkage.flat, slip.flat, strict=True)
    ]
    both = np.array(pairs).reshape(*sinkage.shape, 2)
    return both[..., 0], both[..., 1]
