"""Names for messages: the nearest known one to a name that is none of them, and the first of many."""

import difflib
from collections.abc import Iterable, Sequence

from lunarsci.errors import ParameterError

ALIKE = 0.6
"""Likeness (difflib's ratio) from which a known name may be the one that is meant; difflib's own choice. Assumed."""


def nearest(name: str, known: Iterable[str], cutoff: float = ALIKE) -> str | None:
    """The known name that is most alike, capitals aside; None where none is.

    >>> nearest("yutu-2", ["small-four", "yutu2"])
    'yutu2'
    """
    names = {one.casefold(): one for one in reversed(list(known))}
    found = difflib.get_close_matches(name.casefold(), list(names), n=1, cutoff=cutoff)
    return names[found[0]] if found else None


def meant(name: str, known: Iterable[str]) -> str:
    """`did you mean 'yutu2'? ` for a message; nothing where no name is near.

    >>> meant("yutu-2", ["yutu2"]), meant("x", ["yutu2"])
    ("did you mean 'yutu2'? ", '')
    """
    near = nearest(name, known)
    return f"did you mean '{near}'? " if near else ""


def one_of(name: str, known: Iterable[str]) -> str:
    """The end of a message on a name that is none of the known ones: the nearest, and all.

    >>> one_of("coheson_pa", ["cohesion_pa", "friction_angle_deg"])
    "did you mean 'cohesion_pa'? these are: cohesion_pa, friction_angle_deg"
    """
    names = list(known)
    return f"{meant(name, names)}these are: {', '.join(names)}"


def some_of(names: Sequence[str], most: int, between: str = ", ") -> str:
    """The first of some names, and how many more there are.

    >>> some_of(["a", "b", "c"], 2), some_of(["a", "b"], 2)
    ('a, b and 1 more', 'a, b')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{between.join(names[:most])}{more}"


def known_name(name: str, known: Iterable[str], what: str) -> str:
    """The name, if it is known, capitals aside. Raises ParameterError that names the nearest, and all.

    `what` says what it should be, such as `a soil`.
    """
    names = list(dict.fromkeys(known))
    if name in names:
        return name
    if alike := [one for one in names if one.casefold() == name.casefold()]:
        return alike[0]
    raise ParameterError(f"'{name}' is not {what}; {one_of(name, names)}")
