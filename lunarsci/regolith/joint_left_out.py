"""Groups of neighbouring states predicted from all others, without fitting anew."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.regolith.joint_error import neighbours
from lunarsci.regolith.joint_mode import Mode
from lunarsci.regolith.joint_problem import STEP

__all__ = ["LeftOut", "left_out", "stretch_of"]

FloatArray = npt.NDArray[np.float64]
MOST_STRETCH = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Residuals of a group of g states that was left out, whitened, state by state F_N, F_DP, F_L.

    Attributes
    ----------
    states : which of all states. (n,)
    away : residuals. (3 g,)
    spread : their covariance, from the errors (1 on the diagonal) and the parameters. (3 g, 3 g)
    """

    states: npt.NDArray[np.bool_]
    away: FloatArray
    spread: FloatArray


def left_out(mode: Mode, groups: npt.NDArray[np.intp]) -> list[LeftOut]:
    """Each group predicted from the others, in a linear step from the mode.

    With rows w of whitened residuals of a group, J their derivatives, H the curvature of all others and a states alike,
    the residuals of a fit without it are (1 + J H^-1 J' / a) w, and their covariance is 1 + J H^-1 J'.
    """
    problem, width = mode.problem, mode.problem.width
    rows = problem.white(mode.point[None])[0]
    moved = problem.white(mode.point + np.diag(STEP * width))
    slopes = (moved - rows).transpose(1, 2, 0) / (STEP * width)
    kept = slopes[mode.kept].reshape(-1, len(width))
    curvature = np.diag(width**-2) + kept.T @ kept / mode.alike
    found = []
    for number in range(groups.max() + 1):
        own = np.asarray(groups == number, dtype=np.bool_)
        inside = slopes[own & mode.kept].reshape(-1, len(width))
        rest = np.linalg.inv(curvature - inside.T @ inside / mode.alike)
        j, w = slopes[own].reshape(-1, len(width)), rows[own].ravel()
        unknown = j @ rest @ j.T
        found.append(LeftOut(own, w + unknown @ w / mode.alike, np.eye(len(w)) + unknown))
    return found


def stretch_of(mode: Mode) -> tuple[float, float, float]:
    """How many times wider than stated errors of F_N, F_DP and F_L are where neighbours were left out, 1 to 3. [-]"""
    groups = neighbours(mode.problem.inputs, mode.problem.wheel.radius_m)
    squares, count = np.zeros(3), np.zeros(3)
    for left in left_out(mode, groups):
        good = np.isfinite(mode.problem.forces[left.states]) & mode.kept[left.states, None]
        ratio = (left.away**2 / np.diag(left.spread)).reshape(-1, 3)
        squares += np.where(good, ratio, 0.0).sum(axis=0)
        count += good.sum(axis=0)
    wide = np.clip(np.sqrt(squares / np.maximum(count, 1)), 1.0, MOST_STRETCH)
    return (float(wide[0]), float(wide[1]), float(wide[2]))
