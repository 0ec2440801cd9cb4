"""What the end of a drive owes to each uncertain soil parameter, and to the time step."""

from dataclasses import dataclass, replace

import numpy as np

from lunarsci.twin.plans.plan import Fixes
from lunarsci.twin.simulation.ensemble import Prediction, predict

__all__ = ["EndpointSensitivity", "endpoint_sensitivity", "step_error_m"]

SHORTEST_STEP_S = 0.01
"""Below, the error is a tenth of a millimetre, and half the step would take long."""


@dataclass(frozen=True, slots=True)
class EndpointSensitivity:
    """How the end moves with one soil parameter.

    Attributes
    ----------
    parameter : its name, with its unit.
    x_m, y_m : shift of the end from the lowest to the highest value of the ensemble, of a linear fit over all swept
        parameters. [m]
    share : of the variance of the ends that the parameter's part of that fit explains. [-]
    """

    parameter: str
    x_m: float
    y_m: float
    share: float


def endpoint_sensitivity(prediction: Prediction) -> list[EndpointSensitivity]:
    """By linear least squares over the members that finished; empty with fewer than two more than swept parameters."""
    done = prediction.finished
    names = [name for name, values in prediction.parameters.items() if np.ptp(values[done]) > 0] if done.any() else []
    if not names or done.sum() < len(names) + 2:
        return []
    columns = np.column_stack([prediction.parameters[name][done] for name in names])
    scaled = (columns - columns.mean(axis=0)) / np.ptp(columns, axis=0)
    ends = prediction.endpoints_m[done] - prediction.endpoints_m[done].mean(axis=0)
    shifts, *_ = np.linalg.lstsq(scaled, ends, rcond=None)
    total = float((ends**2).sum())
    return [
        EndpointSensitivity(
            name,
            float(shift[0]),
            float(shift[1]),
            float(((column[:, None] * shift) ** 2).sum() / total) if total > 0 else 0.0,
        )
        for name, shift, column in zip(names, shifts, scaled.T, strict=True)
    ]


def step_error_m(prediction: Prediction) -> float | None:
    """Error of the end by the time step: twice the shift that half the step makes, of the member that misses most. [m]

    The integration is of first order, so what is left at half the step is the shift once more. None where that member
    did not finish, and for steps below 0.01 s, whose error is a tenth of a millimetre. Position fixes count as exact.
    """
    member = int(np.argmax(np.where(prediction.finished, prediction.miss_m, -1.0)))
    if not prediction.finished[member] or prediction.time_step_s < SHORTEST_STEP_S:
        return None
    fixes = prediction.plan.fixes and Fixes(0.0, 0.0)
    plan = replace(prediction.plan, fixes=fixes)
    steps = (prediction.time_step_s, prediction.time_step_s / 2) if fixes else (prediction.time_step_s / 2,)
    ground = prediction.grounds and prediction.grounds.only(member)
    own = {name: values[member : member + 1] for name, values in prediction.parameters.items()}
    runs = [
        predict(
            prediction.rover,
            prediction.terrain,
            plan,
            samples=(own or None) if ground is None else None,
            grounds=ground,
            sweep=None if prediction.parameters else (),
            time_step_s=step * (1 + 1e-9),
            sample_m=float(prediction.time_s[1]) * plan.speed_m_s * (1 + 1e-9),
            ruts=prediction.ruts,
            before=prediction.before,
        )
        for step in steps
    ]
    if not all(run.finished[0] for run in runs):
        return None
    whole = runs[0].endpoints_m[0] if fixes else prediction.paths[member, -1, :2]
    return float(2 * np.hypot(*(runs[-1].endpoints_m[0] - whole)))
