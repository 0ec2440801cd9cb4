"""Small positive definite systems, compiled: inner loops run along whole rows, so that they become vector instructions.

Matrices are square with a side that is a multiple of `LANES`, the unused rows and columns those of the identity. Only
the upper triangle is read; it is overwritten by the factor U of A = U' U, on the diagonal by 1/U_kk. What lies below is
overwritten by numbers without meaning.
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import VECTORS, compiled

__all__ = ["LANES", "factorise", "invert", "padded", "solve"]

LANES = 8
"""Doubles in the widest vector registers; loops that begin and end on multiples of it have no remainders."""


def padded(size: int) -> int:
    """The next multiple of `LANES`."""
    return -(-size // LANES) * LANES


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def factorise(matrix: Any) -> bool:
    """Overwrite the upper triangle by the factor U, its diagonal by 1/U_kk; False where there is no such factor."""
    size = matrix.shape[0]
    for k in range(size):
        row = matrix[k]
        if not row[k] > 0.0:
            return False
        inverse = 1.0 / math.sqrt(row[k])
        for block in range(k // LANES * LANES, size, LANES):
            for i in range(LANES):
                row[block + i] *= inverse
        for j in range(k + 1, size):
            factor, other = row[j], matrix[j]
            if factor != 0.0:
                for block in range(j // LANES * LANES, size, LANES):
                    for i in range(LANES):
                        other[block + i] -= factor * row[block + i]
        row[k] = inverse
    return True


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def solve(factor: Any, right: Any) -> None:
    """Overwrite `right`, padded like the matrix, by the solution of U' U x = right."""
    size = right.size
    for k in range(size):
        row = factor[k]
        known = right[k] * row[k]
        right[k] = known
        for i in range(k + 1, size):
            right[i] -= known * row[i]
    for k in range(size - 1, -1, -1):
        row, total = factor[k], 0.0
        for i in range(k + 1, size):
            total += row[i] * right[i]
        right[k] = (right[k] - total) * row[k]


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def invert(matrix: Any, inverse: Any) -> bool:
    """Fill `inverse`, (size, size) of a matrix padded to more; False where it is not positive definite.

    U' V = 1 by forward substitution on whole rows, then A^-1 = V' V with V lower triangular.
    """
    size, side = inverse.shape[0], matrix.shape[0]
    if not factorise(matrix):
        return False
    rows = np.zeros((side, side))
    for k in range(size):
        own, source = rows[k], matrix[k]
        last = padded_end(k)
        own[k] = 1.0
        for i in range(last):
            own[i] *= source[k]
        for j in range(k + 1, size):
            factor, other = source[j], rows[j]
            for i in range(last):
                other[i] -= factor * own[i]
    for p in range(size):
        for q in range(size):
            inverse[p, q] = 0.0
    for k in range(size):
        source = rows[k]
        for p in range(k + 1):
            factor, target = source[p], inverse[p]
            for q in range(k + 1):
                target[q] += factor * source[q]
    return True


@compiled
def padded_end(k: int) -> int:
    """The first multiple of `LANES` beyond column k."""
    return (k // LANES + 1) * LANES
