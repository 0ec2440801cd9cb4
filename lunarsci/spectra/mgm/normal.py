"""Normal equations of a fit and Marquardt's step within bounds, compiled.

The objective is `scale` times chi-square plus (p - prior)' precision (p - prior). Matrices are padded as `cholesky`
wants them.
"""

from typing import Any

from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.cholesky import factorise, solve

__all__ = ["damped", "damped_step", "gradient_of", "mark_free", "predicted_decrease", "prior_share", "products"]

BLOCK = 4


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def products(jacobian: Any, curvature: Any) -> None:
    """Upper triangle of J J', in blocks of 4 x 4: each number read from memory is used four times."""
    channels = jacobian.shape[1]
    for p in range(0, jacobian.shape[0], BLOCK):
        p0, p1, p2, p3 = jacobian[p], jacobian[p + 1], jacobian[p + 2], jacobian[p + 3]
        for q in range(p, jacobian.shape[0], BLOCK):
            q0, q1, q2, q3 = jacobian[q], jacobian[q + 1], jacobian[q + 2], jacobian[q + 3]
            s00, s01, s02, s03, s10, s11, s12, s13 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            s20, s21, s22, s23, s30, s31, s32, s33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(channels):
                a, b, c, d = q0[i], q1[i], q2[i], q3[i]
                s00 += p0[i] * a
                s01 += p0[i] * b
                s02 += p0[i] * c
                s03 += p0[i] * d
                s10 += p1[i] * a
                s11 += p1[i] * b
                s12 += p1[i] * c
                s13 += p1[i] * d
                s20 += p2[i] * a
                s21 += p2[i] * b
                s22 += p2[i] * c
                s23 += p2[i] * d
                s30 += p3[i] * a
                s31 += p3[i] * b
                s32 += p3[i] * c
                s33 += p3[i] * d
            c0, c1, c2, c3 = curvature[p], curvature[p + 1], curvature[p + 2], curvature[p + 3]
            c0[q], c0[q + 1], c0[q + 2], c0[q + 3] = s00, s01, s02, s03
            c1[q], c1[q + 1], c1[q + 2], c1[q + 3] = s10, s11, s12, s13
            c2[q], c2[q + 1], c2[q + 2], c2[q + 3] = s20, s21, s22, s23
            c3[q], c3[q + 1], c3[q + 2], c3[q + 3] = s30, s31, s32, s33


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def gradient_of(
    jacobian: Any, residual: Any, scale: float, parameters: Any, prior: Any, precision: Any, gradient: Any
) -> None:
    """scale J r - precision (p - prior), half the descent of the objective."""
    size = parameters.size
    for p in range(size):
        slope, row = 0.0, jacobian[p]
        for i in range(residual.size):
            slope += row[i] * residual[i]
        pull, own = 0.0, precision[p]
        for q in range(size):
            pull += own[q] * (parameters[q] - prior[q])
        gradient[p] = scale * slope - pull


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def prior_share(parameters: Any, prior: Any, precision: Any) -> float:
    """(p - prior)' precision (p - prior)."""
    share = 0.0
    for p in range(parameters.size):
        pull, row = 0.0, precision[p]
        for q in range(parameters.size):
            pull += row[q] * (parameters[q] - prior[q])
        share += pull * (parameters[p] - prior[p])
    return share


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def damped(curvature: Any, scale: float, precision: Any, free: Any, damping: float, matrix: Any) -> None:
    """Upper triangle of the damped curvature; rows and columns that are not free are those of the identity."""
    size, side = free.size, matrix.shape[0]
    for p in range(size):
        row, own, held = matrix[p], curvature[p], precision[p]
        for q in range(p, size):
            row[q] = own[q] * scale + held[q]
        row[p] *= 1.0 + damping
        for q in range(size, side):
            row[q] = 0.0
    for p in range(size, side):
        for q in range(p, side):
            matrix[p, q] = 0.0
        matrix[p, p] = 1.0
    for p in range(size):
        if not free[p]:
            for q in range(p):
                matrix[q, p] = 0.0
            for q in range(p, size):
                matrix[p, q] = 0.0
            matrix[p, p] = 1.0


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def damped_step(
    curvature: Any, scale: float, precision: Any, gradient: Any, point: Any, lower: Any, upper: Any, free: Any,
    damping: float, matrix: Any, trial: Any, step: Any,
) -> bool:  # fmt: skip
    """Marquardt's step within the bounds: what would cross one stops there, and the others are solved again.

    `free` is True for the parameters that may move and comes back without those that were stopped. False where the
    damped curvature is not positive definite.
    """
    size = gradient.size
    for p in range(size):
        step[p] = 0.0
    for _ in range(size):
        damped(curvature, scale, precision, free, damping, matrix)
        for p in range(trial.size):
            trial[p] = 0.0
        for p in range(size):
            trial[p] = gradient[p] if free[p] else step[p]
        for q in range(size):
            if not free[q] and step[q] != 0.0:
                for p in range(size):
                    if free[p]:
                        coupling = curvature[min(p, q), max(p, q)] * scale + precision[p, q]
                        trial[p] -= coupling * step[q]
        if not factorise(matrix):
            return False
        solve(matrix, trial)
        crossed = False
        for p in range(size):
            allowed = min(max(trial[p], lower[p] - point[p]), upper[p] - point[p])
            if free[p] and allowed != trial[p]:
                free[p], crossed = False, True
            step[p] = allowed
        if not crossed:
            return True
    return True


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def predicted_decrease(curvature: Any, scale: float, precision: Any, gradient: Any, step: Any) -> float:
    """By how much the quadratic model of the objective falls along a step."""
    decrease, size = 0.0, step.size
    for p in range(size):
        bend, row, pull, own = 0.0, curvature[p], 0.0, precision[p]
        for q in range(p + 1, size):
            bend += row[q] * step[q]
        for q in range(size):
            pull += own[q] * step[q]
        decrease += step[p] * (2.0 * gradient[p] - scale * (2.0 * bend + row[p] * step[p]) - pull)
    return decrease


@compiled
def mark_free(parameters: Any, gradient: Any, lower: Any, upper: Any, free: Any) -> None:
    """A parameter on its bound is free only when the objective falls away from the bound."""
    for p in range(parameters.size):
        held_low = parameters[p] <= lower[p] and gradient[p] < 0.0
        held_high = parameters[p] >= upper[p] and gradient[p] > 0.0
        free[p] = not (held_low or held_high or lower[p] == upper[p])
