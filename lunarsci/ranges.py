"""Intervals that numbers of an input must lie in, and one refusal for all of them."""

import math
from collections.abc import Iterable, Mapping
from functools import cache

from lunarsci.errors import LunarSciError, ParameterError

POSITIVE, NOT_NEGATIVE, FINITE = "(0, inf)", "[0, inf)", "(-inf, inf)"
SHARE, CHANCE, ACUTE_DEG = "[0, 1]", "(0, 1)", "[0, 90)"


@cache
def _ends(interval: str) -> tuple[float, bool, float, bool]:
    """Both ends of an interval such as `(0, 90]`, and whether each belongs to it."""
    low, high = map(float, interval[1:-1].split(","))
    return low, interval.startswith("["), high, interval.endswith("]")


def is_within(value: float, interval: str) -> bool:
    """Whether a number lies in an interval.

    >>> [is_within(0.0, interval) for interval in (POSITIVE, NOT_NEGATIVE, "(-1, 0]")]
    [False, True, True]
    """
    low, has_low, high, has_high = _ends(interval)
    return low < value < high or (has_low and value == low) or (has_high and value == high)


def in_words(interval: str) -> str:
    """What to give instead.

    >>> [in_words(interval) for interval in (POSITIVE, NOT_NEGATIVE, FINITE, "[2, 9]", "(0, 90]", "[0, 1)")]
    ['a number above 0', '0 or more', 'a finite number', '2 to 9', 'a number above 0, at most 90', '0 or more, below 1']
    """
    low, has_low, high, has_high = _ends(interval)
    if math.isinf(low) and math.isinf(high):
        return "a finite number"
    if has_low and has_high:
        return f"{low:g} to {high:g}"
    begin = f"{low:g} or more" if has_low else f"a number above {low:g}"
    return begin if math.isinf(high) else f"{begin}, {'at most' if has_high else 'below'} {high:g}"


def check_range(name: str, value: float, interval: str, hint: str = "") -> None:
    """Raises ParameterError, with its name and what it may have been meant to be, for a number outside an interval."""
    if not is_within(value, interval):
        raise ParameterError(f"{name} is {value:g}; give {in_words(interval)}{hint and f'; {hint}'}")


def check_each(what: str, given: object, intervals: Mapping[str, str]) -> None:
    """The same for values of a mapping or attributes of an object, `what`, each in its interval.

    What is None is left out; a tuple is so many numbers. An interval may go on with `; ` and a hint.
    """
    for name, interval in intervals.items():
        bounds, _, hint = interval.partition("; ")
        value = given[name] if isinstance(given, Mapping) else getattr(given, name)
        for number in value if isinstance(value, tuple) else () if value is None else (value,):
            check_range(f"{what} {name}".strip(), number, bounds, hint)


def check_ranges(given: object, names: Mapping[str, str], what: str = "") -> None:
    """The same by interval, with the names that lie in it, blanks between."""
    check_each(what, given, {name: interval for interval, several in names.items() for name in several.split()})


def refuse(
    reasons: Iterable[str] | Mapping[str, bool], where: str = "", kind: type[LunarSciError] = ParameterError
) -> None:
    """Raises an error with the first of some reasons, if there is any; of a mapping, the first that holds."""
    for reason in reasons:
        if not isinstance(reasons, Mapping) or reasons[reason]:
            raise kind(f"{where}: {reason}" if where else reason)
