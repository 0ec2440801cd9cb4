"""Normal equations of eight fits and Marquardt's step within bounds, compiled.

The objective is `scale` times chi-square plus (p - prior)' precision (p - prior).

Small positive definite systems, eight at a time, compiled.

Matrices have the side - `TILE` rows of the system, padded to a multiple of `TILE` by those of the identity, and `TILE`
columns more, of which the first is a right-hand side and the others are 0. The upper triangle is overwritten by the
factor U of A = U' U, its diagonal by 1/U_kk; the factorisation solves U' y = b on its way. What lies below the diagonal
has no meaning.
"""

from typing import Any

from lunarsci.arrays import FloatArray
from lunarsci.compiled import VECTORS, compiled
from lunarsci.compiled.lanes import aligned, choose, highest, load, lowest, root, spread, store

TILE = 4
"""Rows and columns worked on together, so that each number read is used four times."""
LEAST_PIVOT = 1e-300


def padded_matrix(size: int) -> FloatArray:
    """Workspace for the matrix of a system of so many unknowns, (rows columns, 8)."""
    rows = -(-size // TILE) * TILE
    side = rows + TILE
    matrix = aligned(rows * side)
    for k in range(size, rows):
        matrix[k * side + k] = 1.0
    return matrix


@compiled
def matrix_side(matrix: Any) -> int:
    """Columns of a matrix: rows (rows + `TILE`) = its size."""
    rows = TILE
    while rows * (rows + TILE) < matrix.shape[0]:
        rows += TILE
    return rows + TILE


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _tile(matrix: Any, side: int, k: int, j: int) -> None:
    """A_kj - sum_i U_ik U_ij, i < k, of `TILE` rows from k and columns from j, each sum in a register of its own."""
    at = k * side + j
    s00, s01, s02, s03 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    at = (k + 1) * side + j
    s10, s11, s12, s13 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    at = (k + 2) * side + j
    s20, s21, s22, s23 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    at = (k + 3) * side + j
    s30, s31, s32, s33 = load(matrix, at), load(matrix, at + 1), load(matrix, at + 2), load(matrix, at + 3)
    for i in range(k):
        left, above = i * side + k, i * side + j
        a, b, c, d = load(matrix, above), load(matrix, above + 1), load(matrix, above + 2), load(matrix, above + 3)
        own = load(matrix, left)
        s00 -= own * a
        s01 -= own * b
        s02 -= own * c
        s03 -= own * d
        own = load(matrix, left + 1)
        s10 -= own * a
        s11 -= own * b
        s12 -= own * c
        s13 -= own * d
        own = load(matrix, left + 2)
        s20 -= own * a
        s21 -= own * b
        s22 -= own * c
        s23 -= own * d
        own = load(matrix, left + 3)
        s30 -= own * a
        s31 -= own * b
        s32 -= own * c
        s33 -= own * d
    at = k * side + j
    store(matrix, at, s00)
    store(matrix, at + 1, s01)
    store(matrix, at + 2, s02)
    store(matrix, at + 3, s03)
    at = (k + 1) * side + j
    store(matrix, at, s10)
    store(matrix, at + 1, s11)
    store(matrix, at + 2, s12)
    store(matrix, at + 3, s13)
    at = (k + 2) * side + j
    store(matrix, at, s20)
    store(matrix, at + 1, s21)
    store(matrix, at + 2, s22)
    store(matrix, at + 3, s23)
    at = (k + 3) * side + j
    store(matrix, at, s30)
    store(matrix, at + 1, s31)
    store(matrix, at + 2, s32)
    store(matrix, at + 3, s33)


@compiled
def factorise(matrix: Any, side: int) -> Any:
    """Factor in place; the least pivot, which is not above 0 where there is no factor."""
    least = spread(1.0)
    for block in range(0, side - TILE, TILE):
        for j in range(block, side, TILE):
            _tile(matrix, side, block, j)
        for k in range(block, block + TILE):
            pivot = load(matrix, k * side + k)
            least = lowest(pivot, least)
            inverse = spread(1.0) / root(highest(pivot, spread(LEAST_PIVOT)))
            store(matrix, k * side + k, inverse)
            for j in range(k + 1, side):
                store(matrix, k * side + j, load(matrix, k * side + j) * inverse)
            for row in range(k + 1, block + TILE):
                own = load(matrix, k * side + row)
                for j in range(row, side):
                    store(matrix, row * side + j, load(matrix, row * side + j) - own * load(matrix, k * side + j))
    return least


@compiled
def back_substitute(matrix: Any, size: int, side: int, solution: Any) -> None:
    """Solve U x = y, where y is the right-hand side of the factorised matrix."""
    for k in range(size):
        store(solution, k, load(matrix, (k + 1) * side - TILE))
    for k in range(size - 1, -1, -1):
        known = load(solution, k) * load(matrix, k * side + k)
        store(solution, k, known)
        for i in range(k):
            store(solution, i, load(solution, i) - load(matrix, i * side + k) * known)


@compiled
def invert(matrix: Any, size: int, side: int, inverse: Any) -> None:
    """Fill the upper triangle of `inverse` (size size, 8) from a factor: V = U^-1 row by row, then V V'."""
    for p in range(size - 1, -1, -1):
        own = load(matrix, p * side + p)
        store(inverse, p * size + p, own)
        for q in range(p + 1, size):
            total = spread(0.0)
            for k in range(p + 1, q + 1):
                total += load(matrix, p * side + k) * load(inverse, k * size + q)
            store(inverse, p * size + q, total * own * -1.0)
    for p in range(size):
        for q in range(p, size):
            total = spread(0.0)
            for k in range(q, size):
                total += load(inverse, p * size + k) * load(inverse, q * size + k)
            store(inverse, p * size + q, total)


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
