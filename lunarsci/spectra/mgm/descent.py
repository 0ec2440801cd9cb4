"""Bounded Levenberg-Marquardt from one start, compiled."""

import math
from typing import Any

from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.forward import residuals
from lunarsci.spectra.mgm.normal import (
    damped_step,
    gradient_of,
    mark_free,
    predicted_decrease,
    prior_share,
    products,
)

__all__ = ["CONVERGED", "ITERATION_LIMIT", "NOT_FINITE", "descend"]

CONVERGED, ITERATION_LIMIT, NOT_FINITE = 0, 1, 2
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e12
GENTLE_DAMPING = 1e-2
"""Below this a step that promises nothing means that there is nothing to gain."""


@compiled
def descend(
    channels: Any, used: float, logarithmic: bool, prior: Any, precision: Any, lower: Any, upper: Any, tempered: bool,
    first_damping: float, tolerance: float, max_iterations: int, best: Any, room: Any, solver: Any, outcome: Any,
) -> None:  # fmt: skip
    """Move `best` to the minimum that its neighbourhood leads to; `outcome` becomes chi-square, objective, iterations,
    status.

    While `tempered` and chi-square is larger than the number of channels `used`, the data's share of the objective is
    divided by their ratio, as if the errors were that much larger: the prior then keeps the first steps in the region
    it knows, and half the steps are enough. The last steps, to convergence, are on the objective itself.

    `channels` are wavelength, basis (m, n), data and root of the weight; `room` and `solver` arrays to work in.
    """
    wavelength, columns, data, root_weight = channels
    jacobian, residual, work, powers = room
    curvature, matrix, gradient, step, trial, right, free = solver
    size = best.size
    for p in range(size):
        best[p] = min(max(best[p], lower[p]), upper[p])
    outcome[0], outcome[1], outcome[2], outcome[3] = math.nan, math.inf, 0.0, NOT_FINITE
    chi2 = residuals(best, wavelength, columns, logarithmic, data, root_weight, residual, jacobian, work, powers)
    if not math.isfinite(chi2):
        return
    share = prior_share(best, prior, precision)
    damping, growth, status, iteration, scale, fresh = first_damping, 4.0, ITERATION_LIMIT, 0, 1.0, True
    while iteration < max_iterations and damping < MOST_DAMPING:
        iteration += 1
        if fresh:
            scale = used / chi2 if tempered and chi2 > used else 1.0
            products(jacobian, curvature)
            gradient_of(jacobian, residual, scale, best, prior, precision, gradient)
            fresh = False
        mark_free(best, gradient, lower, upper, free)
        solved = damped_step(
            curvature, scale, precision, gradient, best, lower, upper, free, damping, matrix, right, step
        )
        if not solved:
            damping, growth = max(damping, 1e-4) * growth, growth * 2.0
            continue
        predicted = predicted_decrease(curvature, scale, precision, gradient, step)
        settled = predicted <= tolerance * scale
        if settled and damping > GENTLE_DAMPING:
            damping, growth = damping * 0.1, 4.0
            continue
        if settled and scale == 1.0:
            status = CONVERGED
            break
        if settled:
            tempered, fresh = False, True
            residuals(best, wavelength, columns, logarithmic, data, root_weight, residual, jacobian, work, powers)
            continue
        for p in range(size):
            trial[p] = best[p] + step[p]
        trial_chi2 = residuals(
            trial, wavelength, columns, logarithmic, data, root_weight, residual, jacobian, work, powers
        )
        trial_share = prior_share(trial, prior, precision)
        gain = scale * (chi2 - trial_chi2) + share - trial_share
        if not gain > 0.0:
            if predicted <= 10.0 * tolerance * scale and scale == 1.0:
                status = CONVERGED
                break
            damping, growth = max(damping, 1e-4) * growth, growth * 2.0
            continue
        for p in range(size):
            best[p] = trial[p]
        chi2, share, fresh = trial_chi2, trial_share, True
        damping = max(damping * max(0.1, 1.0 - (2.0 * gain / predicted - 1.0) ** 3), LEAST_DAMPING)
        growth = 4.0
    outcome[0], outcome[1], outcome[2], outcome[3] = chi2, chi2 + share, iteration, status
