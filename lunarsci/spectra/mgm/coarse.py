"""Neighbouring channels put together, compiled: bands are tens of channels wide, so a coarse spectrum leads near the
minimum at a fraction of the cost."""

import math
from typing import Any

from lunarsci.compiled import compiled

__all__ = ["COARSE_CHANNELS", "coarse_size", "coarsen", "correct"]

COARSE_CHANNELS = 96


def coarse_size(channels: int) -> int:
    """How many channels are put together so that about `COARSE_CHANNELS` remain."""
    return max(1, channels // COARSE_CHANNELS)


@compiled
def coarsen(fine: Any, together: int, coarse: Any) -> int:
    """Weighted means of `together` channels each into `coarse`, whose last channels stay unused; how many are used.

    Both are wavelength, basis (m, n), data, root of the weight. Channels without weight do not count.
    """
    wavelength, columns, data, root_weight = fine
    to_wavelength, to_columns, to_data, to_root = coarse
    used = 0
    for target in range(to_wavelength.size):
        first, last = target * together, min((target + 1) * together, wavelength.size)
        total, place, value = 0.0, 0.0, 0.0
        for i in range(first, last):
            weight = root_weight[i] * root_weight[i]
            total += weight
            place += weight * wavelength[i]
            value += weight * data[i]
        used += total > 0.0
        for m in range(columns.shape[0]):
            level = 0.0
            for i in range(first, last):
                level += root_weight[i] * root_weight[i] * columns[m, i]
            to_columns[m, target] = level / total if total > 0.0 else columns[m, min(first, wavelength.size - 1)]
        to_wavelength[target] = place / total if total > 0.0 else wavelength[min(first, wavelength.size - 1)]
        to_data[target] = value / total if total > 0.0 else 0.0
        to_root[target] = math.sqrt(total)
    return used


@compiled
def correct(fine: Any, together: int, coarse: Any, fine_residual: Any, coarse_residual: Any) -> None:
    """Shift the coarse data so that, at the point where both residuals were taken, the coarse residuals are the means
    of the fine ones: what the model's bends within a coarse channel do is then in the data.

    Residuals are data - model times the root of the weight. The correction of full approximation storage: Brandt
    (1977), Math. Comp. 31, 333, 10.1090/S0025-5718-1977-0431719-X.
    """
    root_weight, to_data, to_root = fine[3], coarse[2], coarse[3]
    for target in range(to_data.size):
        if not to_root[target] > 0.0:
            continue
        total = 0.0
        for i in range(target * together, min((target + 1) * together, root_weight.size)):
            total += root_weight[i] * fine_residual[i]
        to_data[target] += (total / to_root[target] - coarse_residual[target]) / to_root[target]
