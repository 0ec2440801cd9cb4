"""TOML and JSON from files that nobody vouches for: what no parser's own error covers becomes one."""

import json
import math
import tomllib
from collections.abc import Callable
from typing import Any

LARGEST = 2**63
"""Whole numbers are smaller: those of 64 bits, as in TOML 1.0."""
TOO_DEEP = "nested too deeply"


def toml_document(content: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises tomllib.TOMLDecodeError, also for tables nested too deeply and whole numbers beyond 64 bits.
    """
    try:
        document = tomllib.loads(content)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise tomllib.TOMLDecodeError(TOO_DEEP) from error
    except ValueError as error:
        raise tomllib.TOMLDecodeError("a number of thousands of digits") from error
    open_ones: list[Any] = [document]
    while open_ones:
        value = open_ones.pop()
        if isinstance(value, int) and abs(value) >= LARGEST:
            raise tomllib.TOMLDecodeError("a whole number beyond 64 bits")
        open_ones += value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return document


def json_document(content: str, parse_constant: Callable[[str], Any] | None = None) -> Any:
    """The value of a JSON text; `parse_constant` is called for NaN and infinities.

    Raises json.JSONDecodeError, also for values nested too deeply and numbers beyond 64 bits.
    """

    def whole(digits: str) -> int:
        if len(digits) > 20 or abs(int(digits)) >= LARGEST:
            raise json.JSONDecodeError("a whole number beyond 64 bits", content, content.find(digits))
        return int(digits)

    def real(digits: str) -> float:
        if math.isinf(value := float(digits)):
            raise json.JSONDecodeError("a number beyond 64 bits", content, content.find(digits))
        return value

    try:
        return json.loads(content, parse_int=whole, parse_float=real, parse_constant=parse_constant)
    except RecursionError as error:
        raise json.JSONDecodeError(TOO_DEEP, content, 0) from error
