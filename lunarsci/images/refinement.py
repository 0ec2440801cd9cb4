"""Disparities between pixels, with their errors: least squares on small windows of two rectified pictures.

About a pixel the left picture is the right one, moved by a disparity that changes linearly over the window, times a
gain, plus an offset (Gruen 1985, S. Afr. J. Photogramm. 14, 175: adaptive least squares correlation). The normal
matrix and what is left of the light give the disparity's error.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.compiled import compiled, each_in_threads

HALF_PX = 3
"""Windows are 7 x 7 pixels: the compromise between noise and relief that was nearest to the truth of two rendered pairs
(`tests/benchmarks/scenes.py`: NavCam 2, PanCam 1) of 5, 7 and 9."""
STEPS = 5
SMALL_STEP_PX = 0.01
FARTHEST_PX = 0.9
"""A window that moves farther from where it began has found something else; assumed."""
STEEPEST = 0.6
"""Largest change of disparity from pixel to pixel; assumed. [px/px]"""
ROWS = 16


class Refined(NamedTuple):
    """By pixel (h, w): disparity and its error [px], its slopes along u and v [px/px], what is left of the light over
    what was there [-], and how far the rows are apart [px]; NaN where nothing fitted."""

    disparity: FloatArray
    sigma: FloatArray
    slope_u: FloatArray
    slope_v: FloatArray
    misfit: FloatArray
    row_offset: FloatArray


def refine(
    left: npt.NDArray[np.float32],
    right: npt.NDArray[np.float32],
    first: FloatArray,
    slopes: tuple[FloatArray, FloatArray],
    *,
    half_px: int = HALF_PX,
    step_px: int = 1,
    rows: bool = False,
) -> Refined:
    """Refine disparities (h, w) [px] from where they are finite, on every `step_px`-th pixel.

    `left`, `right` are rectified pictures (h, w); `slopes` how disparity changes along u and v. With `rows` the
    distance of the rows is solved for as well.
    """
    shape = left.shape
    found = Refined(*(np.full(shape, np.nan) for _ in Refined._fields))
    grids = [np.ascontiguousarray(a, dtype=np.float32) for a in (left, right)]
    starts = [np.ascontiguousarray(a, dtype=float) for a in (first, *slopes)]
    blocks = [(low, min(low + ROWS * step_px, shape[0])) for low in range(0, shape[0], ROWS * step_px)]
    each_in_threads(lambda n: _refine_rows(*grids, *starts, *blocks[n], half_px, step_px, rows, *found), len(blocks))
    return found


@compiled(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc", "arcp"})
def _refine_rows(  # type: ignore[no-untyped-def]
    left,
    right,
    first,
    first_u,
    first_v,
    low,
    high,
    half,
    step,
    rows,
    disparity,
    sigma,
    slope_u,
    slope_v,
    misfit,
    offset,
):
    count = 6 if rows else 5
    normal, side = np.empty((6, 6)), np.empty(6)
    row, values = np.empty(6), np.empty(6)
    height, width = left.shape
    for v in range(low, high, step):
        if v < half + 1 or v >= height - half - 1:
            continue
        for u in range(half, width - half, step):
            start = first[v, u]
            if not np.isfinite(start):
                continue
            values[0], values[1], values[2], values[3], values[4], values[5] = (
                start,
                first_u[v, u],
                first_v[v, u],
                1,
                0,
                0,
            )
            good, change = True, 1.0
            total = 0.0
            for _ in range(STEPS):
                total = _normal_equations(left, right, u, v, half, values, normal, side, row, count)
                if total < 0.0 or not _solved(normal, side, count):
                    good = False
                    break
                change = abs(side[0])
                for k in range(count):
                    values[k] += side[k]
                if abs(values[0] - start) > FARTHEST_PX or abs(values[1]) > STEEPEST or abs(values[2]) > STEEPEST:
                    good = False
                    break
                if change < SMALL_STEP_PX:
                    break
            if good and change < 10 * SMALL_STEP_PX:
                pixels = (2 * half + 1) ** 2
                disparity[v, u], slope_u[v, u], slope_v[v, u] = values[0], values[1], values[2]
                sigma[v, u] = np.sqrt(total / (pixels - count) * _first_of_inverse(normal, count))
                misfit[v, u] = np.sqrt(total / max(_spread(left, u, v, half), 1e-12))
                offset[v, u] = values[5] if rows else 0.0


@compiled(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc", "arcp"})
def _normal_equations(left, right, u, v, half, values, normal, side, row, count):  # type: ignore[no-untyped-def]
    """Sum of squares left; negative where the window leaves the right picture."""
    normal[:], side[:], total = 0.0, 0.0, 0.0
    width = right.shape[1]
    gain, level = values[3], values[4]
    for dv in range(-half, half + 1):
        line = right[v + dv]
        for du in range(-half, half + 1):
            x = u + du - values[0] - values[1] * du - values[2] * dv
            i = int(np.floor(x))
            if i < 1 or i > width - 3:
                return -1.0
            t = x - i
            a, b, c, d = line[i - 1], line[i], line[i + 1], line[i + 2]
            # Catmull & Rom (1974): value and slope between four pixels.
            p, q, r = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
            light = b + t * (p + t * (q + t * r))
            slope = p + t * (2.0 * q + 3.0 * t * r)
            missing = left[v + dv, u + du] - gain * light - level
            row[0] = -gain * slope
            row[1], row[2], row[3], row[4] = row[0] * du, row[0] * dv, light, 1.0
            if count == 6:
                row[5] = (
                    gain
                    * 0.5
                    * (right[v + dv + 1, i if t < 0.5 else i + 1] - right[v + dv - 1, i if t < 0.5 else i + 1])
                )
                missing -= row[5] * values[5]
            total += missing * missing
            for k in range(count):
                side[k] += row[k] * missing
                for m in range(k + 1):
                    normal[k, m] += row[k] * row[m]
    return total


@compiled(nogil=True, error_model="numpy")
def _solved(normal, side, count):  # type: ignore[no-untyped-def]
    """Cholesky in place: `normal` becomes its factor, `side` the solution; False where it has none."""
    for k in range(count):
        for m in range(k + 1):
            total = normal[k, m]
            for n in range(m):
                total -= normal[k, n] * normal[m, n]
            if k > m:
                normal[k, m] = total / normal[m, m]
            else:
                if not total > 1e-9 * normal[k, k] + 1e-30:
                    return False
                normal[k, k] = np.sqrt(total)
    for k in range(count):
        for n in range(k):
            side[k] -= normal[k, n] * side[n]
        side[k] /= normal[k, k]
    for k in range(count - 1, -1, -1):
        for n in range(k + 1, count):
            side[k] -= normal[n, k] * side[n]
        side[k] /= normal[k, k]
    return True


@compiled(nogil=True, error_model="numpy")
def _first_of_inverse(factor, count):  # type: ignore[no-untyped-def]
    """The first diagonal element of the inverse of what `factor` is the Cholesky factor of."""
    total = 0.0
    column = np.zeros(6)
    for k in range(count):
        value = 1.0 if k == 0 else 0.0
        for n in range(k):
            value -= factor[k, n] * column[n]
        column[k] = value / factor[k, k]
        total += column[k] ** 2
    return total


@compiled(nogil=True, error_model="numpy")
def _spread(picture, u, v, half):  # type: ignore[no-untyped-def]
    """Sum of squares about the mean of a window."""
    total, square = 0.0, 0.0
    for dv in range(-half, half + 1):
        for du in range(-half, half + 1):
            value = picture[v + dv, u + du]
            total += value
            square += value * value
    return square - total * total / (2 * half + 1) ** 2
