"""Elementary functions in lanes against NumPy's."""

import platform
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
import pytest

from lunarsci.compiled import LANE_OPTIONS, compiled, lanes
from lunarsci.compiled.formulas import formula
from lunarsci.compiled.instructions import offer_all
from lunarsci.compiled.lanes import (
    aligned,
    arcsin,
    choose,
    cosine,
    exp_minus_one,
    exponential,
    filled,
    is_above,
    load,
    logarithm,
    negligible,
    root,
    sine,
    store,
)


@cache
def looped(function: Any) -> Any:
    @numba.njit(**LANE_OPTIONS)
    def loop(x: Any, out: Any) -> None:
        for i in range(len(x)):
            out[i] = function(x[i])

    offer_all()
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


@compiled
def _of_eight(values: Any, bells: Any, logarithms: Any, others: Any) -> int:
    """Exponentials, logarithms and what else rows of an array need; how many rows have a number above 1."""
    above = 0
    for row in range(values.shape[0]):
        x = load(values, row)
        store(bells, row, exponential(x * -1.0))
        store(logarithms, row, logarithm(x))
        store(others, row, choose(x - 1.0, root(x) / 3.0, filled(values, 0.1)))
        above += is_above(x, 1.0)
    return above


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_eight_singles_are_as_exact_as_singles_can_be(kind: type[np.floating[Any]]) -> None:
    values, bells, logarithms, others = (aligned(1000, kind=kind) for _ in range(4))
    values[:] = np.geomspace(1e-6, 80.0, values.size).reshape(values.shape)
    above = _of_eight(values, bells, logarithms, others)
    assert above == np.count_nonzero((values > 1).any(axis=1)) not in (0, 1000)
    truth, digit = values.astype(np.float64), float(np.finfo(kind).eps)
    assert bells.dtype == kind
    assert np.allclose(bells, np.exp(-truth), rtol=4 * digit, atol=0)
    assert np.allclose(logarithms, np.log(truth), rtol=2 * digit, atol=digit)
    assert np.allclose(others, np.where(truth > 1, np.sqrt(truth) / 3, 0.1), rtol=2 * digit, atol=0)


@compiled
def _negligible(values: Any) -> float:
    return negligible(values)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_what_is_negligible_is_lost_beside_1(kind: type[np.floating[Any]]) -> None:
    share = np.exp(-_negligible(aligned(1, kind=kind)))
    assert np.finfo(kind).eps / 2 < share < 2 * np.finfo(kind).eps


@formula
def _second(table: Any) -> Any:
    return table[1] * 2.0


@compiled
def _twice_the_second(table: Any) -> float:
    return _second(table)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_plain_number_of_a_table_is_read(kind: type[np.floating[Any]]) -> None:
    assert _twice_the_second(np.array([1.0, 0.75], kind)) == 1.5
