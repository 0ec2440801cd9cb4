"""Normal equations of eight fits and Marquardt's step within bounds, compiled.

The objective is `scale` times chi-square plus (p - prior)' precision (p - prior).
"""

from typing import Any

from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.cholesky import TILE, back_substitute, factorise, matrix_side
from lunarsci.spectra.mgm.lanes import choose, highest, load, lowest, spread, store

__all__ = ["clip_to_bounds", "damped", "free_again", "predicted_decrease", "prior_pull", "prior_share", "solve_step"]


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def prior_share(parameters: Any, prior: Any, precision: Any) -> float:
    """(p - prior)' precision (p - prior) of one point."""
    share = 0.0
    for p in range(parameters.size):
        pull, row = 0.0, precision[p]
        for q in range(parameters.size):
            pull += row[q] * (parameters[q] - prior[q])
        share += pull * (parameters[p] - prior[p])
    return share


@compiled
def prior_pull(point: Any, prior: Any, precision: Any, pull: Any) -> Any:
    """Fill `pull` with precision (p - prior); (p - prior)' precision (p - prior)."""
    size, share = prior.size, spread(0.0)
    for p in range(size):
        total = spread(0.0)
        for q in range(size):
            if precision[p, q] != 0.0:
                total += (load(point, q) - prior[q]) * precision[p, q]
        store(pull, p, total)
        share += total * (load(point, p) - prior[p])
    return share


@compiled
def damped(
    curvature: Any, precision: Any, scale: Any, growth: Any, free: Any, size: int, side: int, matrix: Any
) -> None:
    """scale J J' + precision, its diagonal times `growth`; rows and columns that are not free are those of 1."""
    for p in range(size):
        own = load(free, p)
        for q in range(p, size):
            value = load(curvature, p * size + q) * scale + precision[p, q]
            store(matrix, p * side + q, value * own * load(free, q))
        diagonal = load(matrix, p * side + p) * growth
        store(matrix, p * side + p, choose(own, diagonal, spread(1.0)))


@compiled
def _right_side(
    curvature: Any, precision: Any, scale: Any, slope: Any, pull: Any, free: Any, step: Any, held_steps: int,
    side: int, matrix: Any,
) -> None:  # fmt: skip
    """Half the descent of the objective, less what the steps of parameters that stop at a bound do to it."""
    size = free.shape[0]
    for p in range(size):
        total = load(slope, p) * scale - load(pull, p)
        for q in range(size * held_steps):
            held = (spread(1.0) - load(free, q)) * load(step, q)
            low, high = min(p, q), max(p, q)
            total -= (load(curvature, low * size + high) * scale + precision[p, q]) * held
        store(matrix, (p + 1) * side - TILE, choose(load(free, p), total, load(step, p)))


@compiled
def solve_step(
    curvature: Any, precision: Any, scale: Any, growth: Any, slope: Any, pull: Any, free: Any, held_steps: int,
    matrix: Any, step: Any,
) -> Any:  # fmt: skip
    """Marquardt's step of the free parameters, that of the others given; the least pivot."""
    size, side = free.shape[0], matrix_side(matrix)
    damped(curvature, precision, scale, growth, free, size, side, matrix)
    _right_side(curvature, precision, scale, slope, pull, free, step, held_steps, side, matrix)
    least = factorise(matrix, side)
    back_substitute(matrix, size, side, step)
    return least


@compiled
def clip_to_bounds(point: Any, lower: Any, upper: Any, step: Any, free: Any) -> Any:
    """Stop at its bound each step that would cross it, and free its parameter no longer; above 0 where one did."""
    crossed = spread(0.0)
    for p in range(lower.size):
        wanted, here, own = load(step, p), load(point, p), load(free, p)
        allowed = lowest(highest(wanted, lower[p] - here), upper[p] - here)
        beyond = (allowed - wanted) * (allowed - wanted) * own
        store(step, p, choose(own, allowed, wanted))
        store(free, p, choose(beyond, spread(0.0), own))
        crossed = highest(crossed, choose(beyond, spread(1.0), spread(0.0)))
    return crossed


@compiled
def free_again(
    point: Any, lower: Any, upper: Any, scale: Any, slope: Any, pull: Any, renewed: Any, free: Any, step: Any
) -> None:
    """In the lanes where `renewed` is above 0: no step, and every parameter free but those on a bound away from which
    the objective does not fall."""
    for p in range(lower.size):
        here, gradient = load(point, p), load(slope, p) * scale - load(pull, p)
        zero, one = spread(0.0), spread(1.0)
        if lower[p] == upper[p]:
            own = zero
        else:
            off_lower = choose(here - lower[p], one, choose(gradient, one, zero))
            off_upper = choose(upper[p] - here, one, choose(zero - gradient, one, zero))
            own = off_lower * off_upper
        store(free, p, choose(renewed, own, load(free, p)))
        store(step, p, choose(renewed, zero, load(step, p)))


@compiled
def predicted_decrease(curvature: Any, precision: Any, scale: Any, slope: Any, pull: Any, step: Any) -> Any:
    """By how much the quadratic model of the objective falls along a step."""
    size, decrease = step.shape[0], spread(0.0)
    for p in range(size):
        own = load(step, p)
        bend = (load(curvature, p * size + p) * scale + precision[p, p]) * own * 0.5
        for q in range(p + 1, size):
            bend += (load(curvature, p * size + q) * scale + precision[p, q]) * load(step, q)
        decrease += own * (load(slope, p) * scale - load(pull, p) - bend) * 2.0
    return decrease
