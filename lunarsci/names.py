"""Names for messages: the nearest known one to a name that is none of them, the first of many, and how many."""

import difflib
import re
from collections.abc import Iterable, Sequence

from lunarsci.errors import ParameterError

PLURALS = {"spectrum": "spectra", "index": "indices"}


def nearest(name: str, names: Iterable[str]) -> str | None:
    """The known name that is most alike, capitals aside: with a unit behind it, as it is, or with it as a whole word.

    None where none is.

    >>> nearest("yutu-2", ["small-four", "yutu2"]), nearest("bc1000", ["bd1000", "bc1000_sigma_nm", "bc1000_nm"])
    ('yutu2', 'bc1000_nm')
    >>> nearest("rock", ["dark-rock-powder", "weathered-soil", "solid-rock"])
    'solid-rock'
    """
    by_fold = {one.casefold(): one for one in reversed(list(names))}
    longer = [one for one in by_fold if one.startswith(f"{name.casefold()}_")]
    close = [min(longer, key=len)] if longer else difflib.get_close_matches(name.casefold(), list(by_fold), n=1)
    close = close or sorted((one for one in by_fold if name.casefold() in re.split("[-_ ]", one)), key=len)
    return by_fold[close[0]] if close else None


def meant(name: str, names: Iterable[str]) -> str:
    """`did you mean 'yutu2'? ` for a message; nothing where no name is near.

    >>> meant("yutu-2", ["yutu2"]), meant("x", ["yutu2"])
    ("did you mean 'yutu2'? ", '')
    """
    near = nearest(name, names)
    return f"did you mean '{near}'? " if near else ""


def one_of(name: str, names: Iterable[str]) -> str:
    """The end of a message on a name that is none of the known ones: the nearest, and all.

    >>> one_of("coheson_pa", ["cohesion_pa", "friction_angle_deg"])
    "did you mean 'cohesion_pa'? these are: cohesion_pa, friction_angle_deg"
    """
    listed = list(names)
    return f"{meant(name, listed)}these are: {', '.join(listed)}"


def some_of(names: Sequence[str], most: int, between: str = ", ") -> str:
    """The first of some names, and how many more there are.

    >>> some_of(["a", "b", "c"], 2), some_of(["a", "b"], 2)
    ('a, b and 1 more', 'a, b')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{between.join(names[:most])}{more}"


def counted(count: int, thing: str) -> str:
    """A number of things.

    >>> counted(1, "drive"), counted(81, "drive")
    ('1 drive', '81 drives')
    """
    many = PLURALS.get(thing, f"{thing}s")
    return f"{count} {thing}" if count == 1 else f"{count} {many}"


def checked_name(name: str, names: Iterable[str], what: str) -> str:
    """The name, if it is known, capitals aside. Raises ParameterError that names the nearest, and all.

    `what` says what it should be, such as `a soil`.
    """
    listed = list(dict.fromkeys(names))
    if name in listed:
        return name
    if alike := [one for one in listed if one.casefold() == name.casefold()]:
        return alike[0]
    raise ParameterError(f"'{name}' is not {what}; {one_of(name, listed)}")
