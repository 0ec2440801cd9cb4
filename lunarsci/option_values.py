"""Whether the value of an option is of its type: one of its choices, a text, a number."""

from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from os import PathLike
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from lunarsci.errors import RequestError
from lunarsci.names import one_of

_MEANT: dict[Any, tuple[tuple[type, ...], str]] = {
    str: ((str, PathLike), "text"),
    float: ((Real,), "a number"),
    int: ((Integral,), "a whole number"),
    tuple: ((Iterable,), "a list"),
    NoneType: ((NoneType,), "None"),
}
"""What is taken where a type is named, and how messages call it; other types are not checked."""


def check(name: str, value: Any, hint: Any) -> None:
    """Refuse a value that is none of the choices of an option, or not of its kind."""
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    choices = [one for part in parts if get_origin(part) is Literal for one in get_args(part)]
    kinds = [get_origin(part) or part for part in parts if get_origin(part) is not Literal]
    if any(type(value) in (type(one), float) and value == one for one in choices):
        return
    if bool in kinds and _is_flag(value):
        return
    if any(kind not in _MEANT and kind is not bool for kind in kinds):
        return
    taken = [_MEANT[kind][0] for kind in kinds if kind in _MEANT and (kind is not tuple or _is_list(value))]
    if not _is_flag(value) and any(isinstance(value, kind) for kind in taken):
        return
    if choices:
        told = one_of(str(value), map(str, choices)) + (", None" if NoneType in kinds else "")
    else:
        told = "give " + " or ".join("True or False" if kind is bool else _MEANT[kind][1] for kind in kinds)
    raise RequestError(f"`{name}` cannot be {value!r:.60}; {told}")


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")


def _is_list(value: Any) -> bool:
    return not isinstance(value, str | bytes | Mapping)
