"""Formulas as compiled code for eight numbers and for one, beside the same formula on arrays, and rows by name."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError

from lunarsci.compiled import compiled
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import (
    Fields,
    aligned,
    choose,
    exponent_of,
    highest,
    load,
    lowest,
    mantissa_of,
    nearest,
    root,
    signed,
    store,
    two_to,
)

X = np.array([-2.5, -0.0, 0.0, 0.3, 1.0, 1.5, 7.0, 1e300])
Y = np.array([3.0, 1.5, -1.0, 0.3, math.nan, 1.5, -8.0, 1e-300])
FORMULAS: dict[str, tuple[Callable[[Any, Any], Any], Any]] = {
    "arithmetic": (lambda x, y: (x + 2.0) * y - x / (1.0 - y), (X + 2.0) * Y - X / (1.0 - Y)),
    "comparison": (lambda x, y: choose((x < y) | ~(x >= 0.0), x, y), np.where((X < Y) | ~(X >= 0.0), X, Y)),
    "both": (lambda x, y: choose((x > 0.0) & (y > 0.0), 1.0, -abs(y)), np.where((X > 0) & (Y > 0), 1.0, -np.abs(Y))),
    "above zero": (lambda x, y: choose(x, y, 5.0), np.where(X > 0.0, Y, 5.0)),
    "lowest": (lowest, np.where(X < Y, X, Y)),
    "highest": (lambda x, y: highest(y, x), np.where(Y > X, Y, X)),
    "signs": (lambda x, y: signed(y, x), np.copysign(Y, X)),
    "roots": (lambda x, y: root(abs(x)), np.sqrt(np.abs(X))),
    "powers": (lambda x, y: two_to(nearest(lowest(9.0, x))), 2.0 ** np.rint(np.minimum(X, 9.0))),
    "parts": (lambda x, y: mantissa_of(abs(x) + 1.0) * two_to(exponent_of(lowest(9.0, abs(x)) + 1.0)), None),
}


@pytest.mark.parametrize("name", FORMULAS)
@np.errstate(all="ignore")
def test_a_formula_is_the_same_for_eight_numbers_for_one_and_for_arrays(name: str) -> None:
    written, expected = FORMULAS[name]
    own = formula(lambda x, y: written(x, y))

    @compiled
    def eight(x: Any, y: Any, out: Any) -> None:
        store(out, 0, own(load(x, 0), load(y, 0)))

    @compiled
    def one(x: float, y: float) -> float:
        return own(x, y)

    plain, lanes = own(X, Y), aligned(1)
    eight(X[None], Y[None], lanes)
    if expected is not None:
        np.testing.assert_allclose(plain, expected, rtol=1e-15)
    np.testing.assert_allclose(lanes[0], plain, rtol=3e-16)
    np.testing.assert_allclose([one(x, y) for x, y in zip(X, Y, strict=True)], plain, rtol=3e-16)
    assert (np.signbit(lanes[0]) == np.signbit(plain)).all()


def test_whole_numbers_are_numbers() -> None:
    """As in a soil whose exponent was written without a point."""

    @formula
    def mixed(x: Any, k: Any) -> Any:
        return (k + x) * (k - 1.0) / (2.0 * k) - (1.0 - k) + choose(x > k, k, x)

    @compiled
    def use(x: float, k: int) -> float:
        return mixed(x, k)

    assert use(0.3, 4) == pytest.approx(mixed(0.3, 4.0), rel=1e-15)


def test_a_whole_number_is_compared_turned_about_and_given_back_as_a_number() -> None:
    @formula
    def parts(k: Any) -> Any:
        return k, -k, abs(k), choose(k < 0.0, 1.0, 2.0), choose((k == -3) & (k != 3), 5.0, 6.0)

    @compiled
    def use(k: int) -> Any:
        return parts(k)

    assert use(-3) == (-3.0, 3.0, 3.0, 1.0, 5.0)
    assert use(4) == (4.0, -4.0, 4.0, 2.0, 6.0)


def test_parts_of_a_number_make_it_again() -> None:
    values = np.geomspace(1e-300, 1e300, 1001)
    assert (mantissa_of(values) * two_to(exponent_of(values)) == values).all()
    assert (mantissa_of(values) >= 1.0).all() and (mantissa_of(values) < 2.0).all()


def test_a_formula_that_branches_on_a_number_is_refused() -> None:
    @formula
    def branches(x: Any) -> Any:
        return x if x > 0.0 else -x

    @compiled
    def use(x: float) -> float:
        return branches(x)

    with pytest.raises((TypingError, TypeError), match="choose"):
        use(1.0)


def test_an_array_is_read_by_index_and_not_taken_apart() -> None:
    @formula
    def by_index(soil: Any) -> Any:
        return soil[0] - 2.0 * soil[1]

    @formula
    def apart(soil: Any) -> Any:
        first, second = soil
        return first - 2.0 * second

    @compiled
    def read(soil: Any) -> float:
        return by_index(soil)

    @compiled
    def unpack(soil: Any) -> float:
        return apart(soil)

    assert read(np.array([7.0, 3.0])) == 1.0
    assert unpack((7.0, 3.0)) == 1.0
    with pytest.raises((TypingError, TypeError), match="give it a tuple"):
        unpack(np.array([7.0, 3.0]))


PARTS = Fields(2 * LANES, place=3, mass=1)


@formula
def grow(table: Any, which: Any, lane: Any) -> None:
    part = PARTS.of(table, which, lane)
    part.mass = part.mass + part.place[2]
    part.place = (part.mass, 7.0, part.place[0])


@compiled
def grow_second(table: Any) -> None:
    grow(table, 1, LANES)


def test_rows_are_read_and_written_by_name() -> None:
    """The second of two tables, its second eight columns; nothing else is touched."""
    table = np.arange(2.0 * PARTS.rows * PARTS.width).reshape(2, -1)
    expected = table.copy().reshape(2, PARTS.rows, PARTS.width)
    own = expected[1, :, LANES:]
    own[3] += own[2]
    own[0], own[1], own[2] = own[3], 7.0, own[0].copy()
    plain = table.copy()
    grow(plain, 1, LANES)
    grow_second(table)
    for found in (plain, table):
        assert (found.reshape(expected.shape) == expected).all()
    assert (PARTS.view(table, "mass") == expected[:, 3]).all()
    assert (PARTS.view(table, "place")[1] == expected[1, :3]).all()


def test_a_wrong_number_of_rows_is_refused() -> None:
    part = PARTS.of(np.zeros(PARTS.rows * PARTS.width), 0)
    with pytest.raises(ValueError, match="zip"):
        part.place = (1.0, 2.0)
    with pytest.raises(KeyError, match="speed"):
        _ = part.speed
