"""Survival of boulders against the two published times."""

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.prior import Range, survival


@pytest.mark.parametrize(("half", "nearly_all"), [(40, 150), (80, 300)])
def test_half_and_99_percent_are_gone_when_they_were_counted(half: float, nearly_all: float) -> None:
    """Basilevsky, Head & Hoerz (2013), abstract: median 40-80 Ma, 99 % gone after 150-300 Ma."""
    assert survival(half, half) == pytest.approx(0.5)
    assert survival(nearly_all, half) == pytest.approx(0.01, rel=1e-9)


def test_larger_rocks_last_longer_only_if_asked() -> None:
    assert survival(60, 60, size_m=8) == pytest.approx(0.5)
    assert survival(120, 60, size_m=8, size_exponent=0.5) == pytest.approx(0.5)
    assert survival(0, 60) == 1
    assert survival(4000, 60) == pytest.approx(0)


def test_a_range_is_uniform_in_its_logarithm() -> None:
    assert Range(1, 100).quantile([0, 0.5, 1]) == pytest.approx([1, 10, 100])
    assert np.ptp(Range(7, 7).quantile(np.linspace(0, 1, 5))) == 0


@pytest.mark.parametrize("ends", [(0, 1), (-1, 1), (2, 1), (1, float("inf")), (float("nan"), 1)])
def test_impossible_ranges_are_refused(ends: tuple) -> None:
    with pytest.raises(ParameterError, match="must rise"):
        Range(*ends)


def test_a_rock_has_a_size() -> None:
    with pytest.raises(ParameterError, match="above 0"):
        survival(10, 60, size_m=0)
