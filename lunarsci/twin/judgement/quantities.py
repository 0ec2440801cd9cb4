"""Quantities of a drive against distance: of the chassis and of the wheels."""

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.ensemble import PATH_COLUMNS, STATE_COLUMNS, Prediction
from lunarsci.twin.judgement.clearance import clearance
from lunarsci.twin.judgement.keep_out import keep_out_distance

__all__ = ["abscissa", "along", "tilt_deg"]

FloatArray = npt.NDArray[np.float64]


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
