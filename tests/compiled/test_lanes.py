"""Elementary functions in lanes against NumPy's."""

import platform
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
import pytest

from lunarsci.compiled import LANE_OPTIONS, lanes
from lunarsci.compiled.lanes import arcsin, cosine, exp_minus_one, exponential, logarithm, sine


@cache
def looped(function: Any) -> Any:
    @numba.njit(**LANE_OPTIONS)
    def loop(x: Any, out: Any) -> None:
        for i in range(len(x)):
            out[i] = function(x[i])

    return loop


def over(function: Any, x: np.ndarray) -> tuple[np.ndarray, str]:
    """Values over an array, and the assembly of the loop."""
    out, loop = np.empty_like(x), looped(function)
    loop(x, out)
    return out, loop.inspect_asm(loop.signatures[0])


@pytest.mark.parametrize(
    ("function", "truth", "low", "high"),
    [
        (sine, np.sin, -1.7, 1.7),
        (arcsin, np.arcsin, 1e-9, 0.7071067811865475),
        (exp_minus_one, np.expm1, -690.0, 690.0),
        (exp_minus_one, np.expm1, -1e-6, 1e-6),
        (logarithm, np.log, 1e-300, 1e-3),
        (logarithm, np.log, 0.5, 2.0),
        (logarithm, np.log, 1.0, 1e300),
    ],
)
def test_values_are_exact_to_a_few_units_in_the_last_place(
    function: Any, truth: Callable[[np.ndarray], np.ndarray], low: float, high: float
) -> None:
    x = np.linspace(low, high, 100_001)
    assert over(function, x)[0] == pytest.approx(truth(x), rel=1e-15, abs=1e-300)


def test_values_near_a_zero_are_exact_to_the_scale_of_the_function() -> None:
    x = np.linspace(-1.7, 1.7, 100_001)
    assert over(cosine, x)[0] == pytest.approx(np.cos(x), abs=3e-16)


def test_exponentials_beyond_all_numbers_stay_numbers() -> None:
    assert over(exp_minus_one, np.array([-1e9, 0.0]))[0].tolist() == [-1.0, 0.0]
    assert np.isfinite(over(exponential, np.array([1e9, -1e9]))[0]).all()


@pytest.mark.skipif(platform.machine() != "x86_64", reason="other processors have other names for their lanes")
@pytest.mark.parametrize("name", ["sine", "cosine", "arcsin", "exp_minus_one", "exponential", "logarithm"])
def test_loops_run_in_lanes(name: str) -> None:
    _, assembly = over(getattr(lanes, name), np.linspace(0.1, 0.7, 100))
    assert re.search(r"v(?:mul|fn?madd\d+)pd\b", assembly)
