"""Types of arrays, rows in blocks, interpolation in time, and scatter that outliers do not move."""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
IntArray: TypeAlias = npt.NDArray[np.int64]
IndexArray: TypeAlias = npt.NDArray[np.intp]
NORMAL_MAD = 1.4826
"""Standard deviation of a normal law over its median absolute deviation."""
BIWEIGHT = 4.685
"""Tukey's biweight, 95 % efficient for normal errors (Holland & Welsch 1977, 10.1080/03610927708827533)."""
SIGNIFICANCE = 0.01
"""Share of normal errors that is taken for outliers; assumed."""


def spans(total: int, rows: int) -> list[range]:
    """Rows 0 to `total` - 1 in blocks of `rows`, the last one shorter.

    >>> spans(5, 2)
    [range(0, 2), range(2, 4), range(4, 5)]
    """
    return [range(first, min(first + rows, total)) for first in range(0, total, rows)]


def robust_scatter(values: FloatArray, about: float | None = None) -> float:
    """Robust standard deviation: 1.4826 times the median absolute deviation.

    Parameters
    ----------
    values : of any shape, one or more, none of them NaN.
    about : what the distances are counted from; their median if None.
    """
    return NORMAL_MAD * float(np.median(np.abs(values - (np.median(values) if about is None else about))))


def huber_weights(squares: FloatArray, freedom: int) -> FloatArray:
    """Weights from 0 to 1 by sums of squares of so many normal errors of 1: below 1 where `SIGNIFICANCE` are larger.

    Huber (1964), 10.1214/aoms/1177703732: what is large counts by its size, not by its square.
    """
    from scipy.special import chdtri

    return np.sqrt(np.minimum(1.0, float(chdtri(freedom, SIGNIFICANCE)) / np.maximum(squares, 1e-300)))


def robust_fit(design: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients (k,) of a design (n, k) and weights (n,) from 0 to 1, by iterated weights of Tukey's biweight."""
    weight = np.ones(len(values))
    for _ in range(6):
        root = np.sqrt(weight)
        coefficients = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        residual = values - design @ coefficients
        scale = max(robust_scatter(residual), 1e-12)
        weight = np.clip(1.0 - (residual / (BIWEIGHT * scale)) ** 2, 0.0, None) ** 2
    return np.asarray(coefficients), np.asarray(weight)


def samples_about(times_s: FloatArray, wanted_s: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sample before each wanted time, and the share of the way to the next one; beyond the ends it is the end.

    Parameters
    ----------
    times_s : (n,) ascending, two or more. [s]
    wanted_s : (t,) [s]

    Returns
    -------
    Numbers of samples from 0 to n - 2, and shares from 0 to 1. (t,), (t,)
    """
    index = np.interp(wanted_s, times_s, np.arange(len(times_s)))
    low = np.minimum(index.astype(np.int64), len(times_s) - 2)
    return low, index - low


def at_times(
    wanted_s: FloatArray, times_s: FloatArray, values: FloatArray, *, axis: int = 0, beyond: bool = True
) -> FloatArray:
    """Values at wanted times, v_k + f (v_k+1 - v_k) with the share f of the way between two samples.

    Parameters
    ----------
    wanted_s : (t,) [s]
    times_s : (n,) ascending, two or more. [s]
    values : n along `axis`; at a sample's own time it is that sample, though its neighbours be NaN.
    beyond : whether before the first and after the last sample values are those of the ends; NaN if not.

    Returns
    -------
    Of the shape of `values`, t along `axis`.
    """
    low, share = samples_about(times_s, wanted_s)
    if not beyond:
        share = np.where((wanted_s < times_s[0]) | (wanted_s > times_s[-1]), np.nan, share)
    share = share.reshape(-1, *([1] * (values.ndim - 1 - axis % values.ndim)))
    before, after = np.take(values, low, axis=axis), np.take(values, low + 1, axis=axis)
    between = (1.0 - share) * before + share * after
    return np.where(share == 0, before, np.where(share == 1, after, between))
