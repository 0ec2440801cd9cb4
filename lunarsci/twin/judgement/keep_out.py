"""How near the rover comes to the circles that it must keep out of."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.footprint import rover_outline
from lunarsci.twin.plans.plan import KeepOut

__all__ = ["keep_out_distance"]

FloatArray = npt.NDArray[np.float64]


def keep_out_distance(prediction: Prediction, circles: tuple[KeepOut, ...] | None = None) -> FloatArray:
    """Horizontal distance of the rover's outline from the nearest circle; negative inside. (members, samples) [m]

    The outline is the rectangle of `rover_outline`, turned with the rover; tilt is neglected, which errs on the safe
    side. `circles` are the plan's by default; infinite where there are none. From where the centre of a circle lies
    below the rover, the distance is minus its radius.
    """
    outline, paths = rover_outline(prediction.rover), prediction.paths
    poses = np.concatenate([prediction.places_m, np.radians(paths[..., 5:])], axis=-1)
    nearest = np.full(poses.shape[:-1], np.inf)
    for circle in prediction.plan.keep_out if circles is None else circles:
        nearest = np.minimum(nearest, outline.distance_m(poses, circle.x_m, circle.y_m) - circle.radius_m)
    return nearest
