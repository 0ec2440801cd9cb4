"""Quantities of a drive against distance: of the chassis and of the wheels.

How near the rover comes to the circles that it must keep out of.
"""

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.ground.footprint import rover_outline
from lunarsci.twin.judgement.clearance import clearance
from lunarsci.twin.plans.plan import KeepOut
from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, STATE_COLUMNS, Prediction

__all__ = ["abscissa", "along", "keep_out_distance", "tilt_deg"]

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


def tilt_deg(roll_deg: npt.ArrayLike, pitch_deg: npt.ArrayLike) -> FloatArray:
    """Angle between the chassis' z axis and the vertical, cos(tilt) = cos(roll) cos(pitch). [deg]"""
    return np.asarray(np.degrees(np.arccos(np.cos(np.radians(roll_deg)) * np.cos(np.radians(pitch_deg)))))


def along(prediction: Prediction, quantity: str) -> FloatArray:
    """A quantity at every sample, (members, samples), or (members, samples, wheels) for a column of the wheel states.

    `tilt_deg`, `miss_m` (distance of the rover's origin from where the plan has it by then), `clearance_m`,
    `keep_out_m`, and the columns of `PATH_COLUMNS` and `STATE_COLUMNS`, of which x_m and y_m are the rover's. Rows
    beyond `Prediction.reached` repeat the last one. Raises ParameterError for another name.
    """
    if quantity == "tilt_deg":
        return tilt_deg(along(prediction, "roll_deg"), along(prediction, "pitch_deg"))
    if quantity == "miss_m":
        return np.asarray(np.hypot(*np.moveaxis(prediction.places_m - prediction.planned[:, :2], -1, 0)))
    if quantity == "clearance_m":
        return clearance(prediction)[0]
    if quantity == "keep_out_m":
        return keep_out_distance(prediction)
    if quantity in PATH_COLUMNS:
        return prediction.paths[..., PATH_COLUMNS.index(quantity)]
    if quantity in STATE_COLUMNS:
        return prediction.states[..., STATE_COLUMNS.index(quantity)]
    raise ParameterError(f"'{quantity}' is no quantity of a drive")


def abscissa(prediction: Prediction) -> tuple[FloatArray, str]:
    """What to draw against, with its label: the commanded distance, or the time where the rover also turns or waits."""
    if (np.diff(prediction.distance_m) > 0).all():
        return prediction.distance_m, "Commanded distance [m]"
    return prediction.time_s, "Time [s]"
