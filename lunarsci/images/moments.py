"""Pictures of two cameras, of the same moments."""

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from lunarsci.errors import LunarSciWarning, NoFilesError, RequestError
from lunarsci.io.inputs import InputFile, expand_inputs
from lunarsci.names import some_of

Shown: TypeAlias = str | Path | InputFile
"""A picture, by its name or read; it is handed on as it is."""
NAMED = 4
"""Pictures that a warning names."""


def matching(patterns: Sequence[str], what: str = "pictures") -> list[str]:
    """Files that patterns match, in the order of their names, and all files of folders. Raises RequestError."""
    try:
        return expand_inputs(patterns, all_files=True)
    except NoFilesError as error:
        raise RequestError(f"`{what}` {error}; put a pattern in quotes") from error


def files_of(pictures: str | Sequence[Shown], what: str = "pictures") -> list[Shown]:
    """The same of one pattern; files as they are."""
    return [*matching([pictures], what)] if isinstance(pictures, str) else list(pictures)


def of_moments(left: Sequence[Shown], right: Sequence[Shown]) -> tuple[list[Shown], list[Shown]]:
    """Pictures of both cameras with their partners.

    Where the last number in a name tells pictures of each side apart, and both sides have such a number in common, they
    belong together by it, and pictures without a partner are left out with a warning; else by their order. Raises
    RequestError where that leaves some over.
    """
    sides = [{_number(one): one for one in side} for side in (left, right)]
    common = [number for number in sides[0] if number and number in sides[1]]
    if common and [len(side) for side in sides] == [len(left), len(right)]:
        over = [_name(one) for side in sides for number, one in side.items() if number not in common]
        if over:
            told = f"no partner of the other camera, left out: {some_of(over, NAMED)}"
            warnings.warn(told, LunarSciWarning, stacklevel=3)
        return [sides[0][number] for number in common], [sides[1][number] for number in common]
    if len(left) != len(right):
        raise RequestError(f"{len(left)} pictures and {len(right)} of `right`; give one of each moment, in order")
    return list(left), list(right)


def _name(picture: Shown) -> str:
    return picture.name if isinstance(picture, InputFile) else str(picture)


def _number(picture: Shown) -> str:
    """The last number in a name, without what counts cameras (cam0, cam1); '' where there is none.

    >>> _number("left07.png"), _number("cam1_0007.png"), _number("12_L.png")
    ('7', '7', '12')
    """
    stem = re.sub(r"(?i)cam(?:era)?[_-]?[01](?![0-9])", "", Path(_name(picture)).stem)
    return next((digits.lstrip("0") or "0" for digits in reversed(re.findall(r"\d+", stem))), "")
