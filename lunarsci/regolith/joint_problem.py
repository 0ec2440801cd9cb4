"""What the joint inference compares: states, their forces and errors, and the model at any soil."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lunarsci.compiled import each_in_threads
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.joint_model import forces_at, forces_of_many, whitened
from lunarsci.regolith.prior import PARAMETERS, Law, values_of
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import Wheel

__all__ = ["STEP", "Problem", "part_of", "problem_of"]

FloatArray = npt.NDArray[np.float64]
STEP = 1e-3
"""Of numerical derivatives, in standard deviations of the prior or the input."""
CHUNK = 32
"""Points evaluated at once, so that they stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """States, their forces and errors, and how the model is evaluated."""

    inputs: FloatArray
    input_sigma: FloatArray
    forces: FloatArray
    force_sigma: FloatArray
    wheel: Wheel
    model: ContactModel | None
    prior: Mapping[str, Law]
    model_error: float

    @property
    def center(self) -> FloatArray:
        return np.array([self.prior[name].center for name in PARAMETERS])

    @property
    def width(self) -> FloatArray:
        return np.array([self.prior[name].width for name in PARAMETERS])

    def at(self, point: FloatArray) -> FloatArray:
        """Forces of all states, (n, 3), at transformed parameters."""
        return forces_at(values_of(self.prior, point), self.inputs, self.wheel, self.model)

    def white(self, points: FloatArray) -> FloatArray:
        """Residuals over their errors, (d, n, 3), 0 for forces not measured.

        At transformed parameters (d, 8). Errors of the inputs reach the forces through the model's derivatives at each
        point. NaN where a point is beyond any soil.
        """
        values = values_of(self.prior, points)
        count, step = len(self.inputs), STEP * np.maximum(self.input_sigma, 1e-9)
        moved = [self.inputs]
        for k in range(3):
            for sign in (1, -1):
                moved.append(self.inputs.copy())
                moved[-1][:, k] += sign * step[:, k]
        forces = forces_of_many(values, np.concatenate(moved), self.wheel, self.model)
        parts = forces.reshape(len(points), 3, 7, count).transpose(0, 2, 1, 3)
        share = (self.input_sigma / (2 * step)).T[:, None]
        slopes = (parts[:, 1::2] - parts[:, 2::2]) * share
        variance = self.force_sigma**2 + (self.model_error * np.abs(self.forces[:, :1])) ** 2
        missing = ~np.isfinite(self.forces)
        residual = self.forces.T - parts[:, 0]
        white = whitened(residual, slopes, np.where(missing, 0.0, variance).T.copy(), missing.T.astype(float))
        return np.asarray(white.transpose(0, 2, 1))

    def objective(self, point: FloatArray) -> float:
        """-2 ln of the posterior at a point, up to a constant."""
        away = (point - self.center) / self.width
        return float(np.sum(self.white(point[None]) ** 2) + np.sum(away**2))

    def ln_likelihood(self, points: FloatArray) -> FloatArray:
        """Of transformed parameters (d, 8), up to a constant, in as many threads as there are cores.

        Without the determinant of the errors: the true inputs are unknowns of their own here, and with it K_s and N of
        simulated soils are off by more than their standard deviation.
        """
        found = np.empty(len(points))
        chunks = [slice(k, k + CHUNK) for k in range(0, len(points), CHUNK)]

        def fill(number: int) -> None:
            found[chunks[number]] = -0.5 * np.sum(self.white(points[chunks[number]]) ** 2, axis=(1, 2))

        each_in_threads(fill, len(chunks))
        return found


def problem_of(
    states: WheelStates,
    usable: npt.NDArray[np.bool_],
    wheel: Wheel,
    prior: Mapping[str, Law],
    model: ContactModel | None,
    model_error: float,
) -> Problem:
    values, sigmas = states.values[usable], states.sigmas[usable]
    inputs, spread = values[:, :3].copy(), sigmas[:, :3].copy()
    no_side = ~np.isfinite(inputs[:, 2])
    inputs[no_side, 2], spread[no_side, 2] = 0.0, 0.0
    forces = values[:, 3:].copy()
    forces[no_side, 2] = np.nan
    return Problem(inputs, spread, forces, np.nan_to_num(sigmas[:, 3:]), wheel, model, prior, model_error)


def part_of(problem: Problem, kept: npt.NDArray[np.bool_]) -> Problem:
    parts = {name: getattr(problem, name)[kept] for name in ("inputs", "input_sigma", "forces", "force_sigma")}
    return replace(problem, **parts)
