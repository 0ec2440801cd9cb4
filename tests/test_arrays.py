"""Interpolation in time."""

import numpy as np

from lunarsci.arrays import at_times, samples_about

TIMES = np.array([0.0, 1.0, 2.0])


def test_values_beside_ones_that_are_not_known_are_not() -> None:
    values = np.array([1.0, 3.0, np.nan])
    assert at_times(np.array([0.0, 0.5, 1.0]), TIMES, values).tolist() == [1.0, 2.0, 3.0]
    assert np.isnan(at_times(np.array([1.5, 2.0]), TIMES, values)).all()


def test_beyond_the_ends() -> None:
    wanted, values = np.array([-0.1, 2.1]), np.array([1.0, 3.0, 4.0])
    assert at_times(wanted, TIMES, values).tolist() == [1.0, 4.0]
    assert np.isnan(at_times(wanted, TIMES, values, beyond=False)).all()


def test_the_same_along_any_axis() -> None:
    """numpy.interp of each row."""
    random = np.random.default_rng(0)
    times, wanted = np.sort(random.random(20)), random.random(7)
    values = random.random((3, 20, 2))
    truth = np.stack([[np.interp(wanted, times, row[:, k]) for k in (0, 1)] for row in values]).transpose(0, 2, 1)
    for axis in (1, -2):
        assert np.allclose(at_times(wanted, times, values, axis=axis), truth, rtol=1e-12, atol=0)
    moved = at_times(wanted, times, np.moveaxis(values, 1, 0))
    assert np.allclose(np.moveaxis(moved, 0, 1), truth, rtol=1e-12, atol=0)


def test_the_last_time_belongs_to_the_last_step() -> None:
    low, share = samples_about(TIMES, np.array([0.0, 1.25, 2.0]))
    assert low.tolist() == [0, 1, 1] and share.tolist() == [0.0, 0.25, 1.0]
