"""The options of a request: their meanings, from its docstring, and what they can be, by their types."""

import dataclasses
import inspect
import os
import re
from collections.abc import Mapping
from textwrap import fill
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from lunarsci.errors import RequestError
from lunarsci.memory import as_named, on_disk
from lunarsci.names import one_of
from lunarsci.ranges import in_words, is_within, refuse

Request = TypeVar("Request")
_ATTRIBUTES = re.compile(r"^Attributes\n-+\n(.*?)(?=\n\n|\Z)", re.DOTALL | re.MULTILINE)
PLAIN = {str: (str, os.PathLike), int: (int,), float: (int, float), bool: (bool,), NoneType: (NoneType,)}
"""Plain types of options, and what counts as one of them."""
WORDS = {str: "text", int: "a whole number", float: "a number", bool: "True or False"}

TYPED = {
    "boulders": "rocks",
    "class": "classes",
    "crater_count": "craters",
    "crater_prior": "prior",
    "draw_posterior": "sample",
    "exact_rig": "exact",
    "minerals": "soil",
    "pattern": "target",
    "prior_file": "prior",
    "rays": "samples",
    "rock_density": "rocks",
    "roughness_factor": "roughness",
    "scattering": "law",
    "shadow_share": "shadow",
    "start_file": "start",
}
"""Options that the command line has under another name: as typed there, and the name in Python."""
OF_RESULTS = {
    "animate": "film()",
    "csv": "to_pandas()",
    "field": "to_dict()",
    "json": "to_dict()",
    "plot": "plot()",
    "save": "files()",
    "save_map": "map_bytes()",
    "verbose": "to_text()",
}
"""What the command line is asked for by an option, and Python has as a method of the result."""
STATED = ("modes", "bands")
"""Options that are values and errors by name, and in Python a dict as well."""
_VALUE = r"(?=[^ ,;:)]*[\d=A-Z])[^ ,;:)]+(?:,[a-z_]+=[^ ,;:)]+)*|auto|priors"
_FLAG = re.compile(rf"(?<![\w-])--([a-z][a-z0-9-]*)(?:[ =]({_VALUE}))?")
_REPEATED = re.compile(r"May be\s+repeated|Repeatable|repeatable")
_IN_A_LIST = {"repeatable": "several in a list", "Repeatable": "Several in a list", "May": "Several are a list"}
_WRITTEN = re.compile(r"(?<![\w-])-o [A-Z][A-Z.a-z]*")


def in_python(text: str) -> str:
    """A text with options as Python has them, not as they are typed, but in commands between backticks.

    >>> in_python("give `rover` (--units sinkage_m=mm,slip_ratio=%); `twin plan --risk` up to --max-slope 89: --csv")
    'give `rover` (units="sinkage_m=mm,slip_ratio=%"); `twin plan --risk` up to max_slope=89: to_pandas()'
    """

    def worded(flag: re.Match[str]) -> str:
        name, value = flag[1].replace("-", "_"), flag[2]
        if name in OF_RESULTS:
            return OF_RESULTS[name] + (f" {value}" if value else "")
        quoted = value if value is None or re.fullmatch(r"[-+.\de]+", value) else f'"{value}"'
        return TYPED.get(name, name) + (f"={quoted}" if value else "")

    parts = as_named(text).split("`")
    commands = [k % 2 == 1 and not part.startswith("-") for k, part in enumerate(parts)]
    pairs = zip(parts, commands, strict=True)
    return "`".join(part if typed else _WRITTEN.sub("files()", _FLAG.sub(worded, part)) for part, typed in pairs)


def meanings(kind: type) -> dict[str, str]:
    """What each option of a request means, by its name: from its docstring, before those of the requests it extends."""
    entries: dict[str, str] = {}
    for request in reversed(kind.__mro__):
        section = _ATTRIBUTES.search(inspect.getdoc(request) or "") if dataclasses.is_dataclass(request) else None
        for entry in re.split(r"\n(?=\S)", section[1]) if section else ():
            name, _, text = entry.partition(" : ")
            entries[name] = " ".join(text.split())
    return entries


def choices_of(hint: Any) -> list[Any]:
    """The values that a type hint names, in its order.

    >>> choices_of(Literal["hull", "conic"] | None)
    ['hull', 'conic']
    """
    return [one for kind in (hint, *get_args(hint)) if get_origin(kind) is Literal for one in get_args(kind)]


def check_option(name: str, value: Any, hint: Any) -> None:
    """RequestError for a value that is none of an option's choices, or of another type than its plain ones."""
    kinds = get_args(hint) if isinstance(hint, UnionType) or NoneType in get_args(hint) else (hint,)
    if get_origin(hint) is tuple and not (isinstance(value, tuple | list) and all(isinstance(v, str) for v in value)):
        raise RequestError(f"`{name}` is {value!r:.60}; give one text or input, or several in a list")
    choices, others = choices_of(hint), [kind for kind in kinds if get_origin(kind) is not Literal]
    if any(kind not in PLAIN for kind in others) or any(
        isinstance(value, PLAIN[kind]) and (kind is bool or not isinstance(value, bool)) for kind in others
    ):
        return
    if not choices:
        raise RequestError(f"`{name}` is {value!r:.60}; give {' or '.join(WORDS[k] for k in others if k in WORDS)}")
    if not any(value is one or (type(value) is type(one) and value == one) for one in choices):
        raise RequestError(f"`{name}` is {value!r:.60}; {one_of(str(value), [str(one) for one in choices])}")


def as_meant(name: str, value: Any, hint: Any) -> Any:
    """A whole number as a real one, one text as the only one of several, several texts as one with commas, a number as
    text, and what is in memory as the path of a file that holds it, where that is meant.
    """
    if type(value).__module__ == "numpy" and getattr(value, "shape", None) == ():
        value = value.item()
    if name == "wavelengths" and getattr(value, "ndim", 0) == 1:
        value = {"wavelength": value}
    if getattr(value, "ndim", 0) == 1 and hasattr(value, "tolist"):
        value = tuple(value.tolist())
    if name in STATED and isinstance(value, Mapping):
        value = ",".join(f"{key}={_joined(':', one)}" for key, one in value.items())
    if "str" in str(hint):
        value = on_disk(name, value)
    texts = {str, tuple[float, ...]} <= {*get_args(hint)} or {str, float} <= {*get_args(hint)}
    if texts and isinstance(value, tuple | list) and all(isinstance(one, int | float) for one in value):
        return _joined(",", value)
    if get_origin(hint) is tuple:
        return (value,) if isinstance(value, str) else value
    plain = {str, int, float} & {hint, *get_args(hint)}
    if isinstance(value, list | tuple) and plain == {str} and all(isinstance(one, str) for one in value):
        return ",".join(value)
    if isinstance(value, str) and plain == {float}:
        return _number(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return repr(value) if plain == {str} else float(value) if float in plain else value


def _joined(sign: str, values: Any) -> str:
    """One number or several as text."""
    return sign.join(map(str, values)) if isinstance(values, list | tuple) else str(values)


def _number(text: str) -> Any:
    """The number that a text is; the text where it is none."""
    try:
        return float(text)
    except ValueError:
        return text


def options_text(kind: type) -> str:
    """The options of a request with their meaning, from its docstring and those that it extends, and their defaults."""
    requests = [one for one in reversed(kind.__mro__) if dataclasses.is_dataclass(one)]
    sections = [section[1] for one in requests if (section := _ATTRIBUTES.search(inspect.getdoc(one) or ""))]
    defaults = [f"{item.name}={item.default!r}" for item in dataclasses.fields(kind)]
    named = {name: choices_of(hint) for name, hint in get_type_hints(kind).items()}
    choices = [f"{name}: {', '.join(map(repr, values))}" for name, values in named.items() if values]
    closing = [f"By default {', '.join(defaults)}.", *([f"Choices of {'; '.join(choices)}."] if choices else [])]
    lines = (fill(line, 112, break_on_hyphens=False, break_long_words=False) for line in closing)
    text = "\n".join(["Other Parameters", "----------------", *sections, "", *lines])
    return in_python(_REPEATED.sub(lambda one: _IN_A_LIST[one[0].split()[0]], text))


def request_of(kind: type[Request], request: Request | None, options: Mapping[str, Any]) -> Request:
    """A request, or the one with all defaults, with some options replaced.

    Raises RequestError for a name that is none of its options, and for a value that an option cannot have.
    """
    if request is not None and not isinstance(request, kind):
        kinds = f"of {type(request).__name__}, and not a {kind.__name__}"
        raise RequestError(f"`request` is {kinds}; give options by name, and several inputs in a list")
    names = [item.name for item in dataclasses.fields(kind)]  # type: ignore[arg-type]
    if wrong := next((name for name in options if name not in names), None):
        other = TYPED.get(wrong)
        if other in names:
            raise RequestError(f"'{wrong}' is how the command line has `{other}`; give that name in Python")
        raise RequestError(f"'{wrong}' is no option here; {one_of(wrong, sorted(names))}")
    hints = get_type_hints(kind)
    meant = {name: as_meant(name, value, hints[name]) for name, value in options.items()}
    given = meant if request is None else {name: getattr(request, name) for name in names} | meant
    for name, value in given.items():
        check_option(name, value, hints[name])
    return kind(**meant) if request is None else dataclasses.replace(request, **meant)  # type: ignore[type-var]


def check_intervals(request: object, intervals: Mapping[str, str]) -> None:
    """Raises RequestError for a number outside its interval; by interval the names of options with blanks between."""
    for interval, names in intervals.items():
        for name in names.split():
            value = getattr(request, name)
            if value is not None and not is_within(value, interval):
                raise RequestError(f"`{name}` is {value:g}; give {in_words(interval)}")


def refuse_where(reasons: Mapping[str, bool]) -> None:
    """Raises RequestError with the first sentence that holds of the options."""
    refuse((reason for reason, holds in reasons.items() if holds), kind=RequestError)
