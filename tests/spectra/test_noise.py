"""Noise and depth of many spectra at once against plain numpy, one spectrum at a time."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lunarsci.spectra.noise import deepest_below_hull, scatter_noise_rows


def plainly(values: np.ndarray, window: int) -> np.ndarray:
    """The running median of absolute second differences, every window sorted anew."""
    second = np.abs(np.diff(values, 2))
    half = (min(window, second.size) - 1) // 2
    middle = [min(max(i - 1, half), second.size - 1 - half) for i in range(values.size)]
    running = np.array([np.median(second[at - half : at + half + 1]) for at in middle])
    return np.maximum(running * 1.4826 / np.sqrt(6.0), np.finfo(float).eps * np.abs(values).max())


@pytest.mark.parametrize("channels", [5, 6, 40, 62, 63, 64, 85, 390])
@pytest.mark.parametrize("window", [7, 61])
def test_noise_is_the_running_median(channels: int, window: int) -> None:
    """Also with ties, and of a straight line, whose noise is that of its digits."""
    values = np.random.default_rng(channels).uniform(0.1, 0.2, (6, channels))
    values[1], values[2], values[3] = values[1].round(2), 0.1, np.linspace(1, 2, channels)
    assert np.array_equal(scatter_noise_rows(values, window), [plainly(row, window) for row in values])


def test_depth_is_below_the_hull_of_all_points() -> None:
    rng = np.random.default_rng(1)
    x, y = np.sort(rng.uniform(400, 2600, 40)), rng.normal(size=(5, 40))
    for row, found in zip(y, deepest_below_hull(x, y), strict=True):
        faces = ConvexHull(np.column_stack([x, row])).equations
        upper = faces[faces[:, 1] > 0]
        hull = np.min(-(upper[:, :1] * x + upper[:, 2:]) / upper[:, 1:2], axis=0)
        assert found == pytest.approx(np.max(hull - row), rel=1e-12)


def test_little_or_nothing_has_no_depth() -> None:
    assert deepest_below_hull(np.empty(0), np.empty((2, 0))).tolist() == [0, 0]
    assert deepest_below_hull(np.arange(3.0), np.array([[0.0, 1.0, 0.0]])).tolist() == [0]
