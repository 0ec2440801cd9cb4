"""Small positive definite systems, compiled: inner loops run along whole rows, so that they become vector instructions.

Matrices are square with a side that is a multiple of `LANES`, the unused rows and columns those of the identity. Only
the upper triangle is read; it is overwritten by the factor U of A = U' U, what lies below by numbers without meaning.
"""

import math
from typing import Any

from lunarsci.compiled import VECTORS, compiled

__all__ = ["LANES", "factorise", "invert", "padded", "solve"]

LANES = 8
"""Doubles in the widest vector registers; loops that begin and end on multiples of it have no remainders."""


def padded(size: int) -> int:
    """The next multiple of `LANES`."""
    return -(-size // LANES) * LANES


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def factorise(matrix: Any) -> bool:
    """Overwrite the upper triangle by the factor U; False where the matrix is not positive definite."""
    size = matrix.shape[0]
    for k in range(size):
        pivot = matrix[k, k]
        if not pivot > 0.0:
            return False
        inverse = 1.0 / math.sqrt(pivot)
        row = matrix[k]
        for block in range(k // LANES * LANES, size, LANES):
            for i in range(LANES):
                row[block + i] *= inverse
        for j in range(k + 1, size):
            factor, other = row[j], matrix[j]
            for block in range(j // LANES * LANES, size, LANES):
                for i in range(LANES):
                    other[block + i] -= factor * row[block + i]
    return True


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def solve(factor: Any, right: Any) -> None:
    """Overwrite `right` by the solution of U' U x = right."""
    size = right.size
    for k in range(size):
        row = factor[k]
        right[k] /= row[k]
        known = right[k]
        for i in range(k + 1, size):
            right[i] -= known * row[i]
    for k in range(size - 1, -1, -1):
        row, total = factor[k], 0.0
        for i in range(k + 1, size):
            total += row[i] * right[i]
        right[k] = (right[k] - total) / row[k]


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def invert(matrix: Any, inverse: Any) -> bool:
    """Fill `inverse`, (size, size) of a matrix padded to more, row by row; False where it is not positive definite.

    U' V = 1 by forward substitution on whole rows, then A^-1 = V' V with V lower triangular.
    """
    size, side = inverse.shape[0], matrix.shape[0]
    if not factorise(matrix):
        return False
    rows = matrix.copy()
    for k in range(side):
        for i in range(side):
            rows[k, i] = 0.0
        rows[k, k] = 1.0
    for k in range(size):
        scale = 1.0 / matrix[k, k]
        for i in range(k + 1):
            rows[k, i] *= scale
        for j in range(k + 1, size):
            factor = matrix[k, j]
            for i in range(k + 1):
                rows[j, i] -= factor * rows[k, i]
    for p in range(size):
        for q in range(size):
            inverse[p, q] = 0.0
    for k in range(size):
        for p in range(k + 1):
            factor = rows[k, p]
            for q in range(k + 1):
                inverse[p, q] += factor * rows[k, q]
    return True
