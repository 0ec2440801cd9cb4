"""A file of another kind than its option takes: what it is, and where it goes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lunarsci.errors import LunarSciError

VAGUE = ("table", "config", "result")
"""Kinds of `lunarsci info` that may be anything else, too."""


def hint_at_kind(context: Any, message: str) -> str:
    """What to add to the message about a file that was refused; nothing where the option takes files of its kind.

    `context` is that of the command, whose options have the file.
    """
    place = next((place for place in _places(context) if message.startswith(f"{place[1]}: ")), None)
    if place is None or not Path(place[1]).is_file():
        return ""
    from lunarsci.guide.info import kind_of
    from lunarsci.io.inputs import read_input
    from lunarsci.registry import KINDS

    (flag, file), here = place, context.command_path.removeprefix("lunarsci ")
    takers = {name: _of_flag(kind.commands, flag, here) for name, kind in KINDS.items()}
    try:
        kind = kind_of(read_input(file))
    except LunarSciError:
        return ""
    if kind in VAGUE or takers[kind] or not any(takers.values()):
        return ""
    commands = KINDS[kind].commands
    to = next((one for one in commands if one.partition(" --")[0] == here), commands[0])
    return f"; it looks like another kind of file ({KINDS[kind].title}): `lunarsci {to} {file}`"


def _places(context: Any) -> Iterator[tuple[str, str]]:
    """Each value of the command, with its flag, '' of an argument."""
    for one in context.command.params:
        value = context.params.get(one.name)
        flag = max(one.opts, key=len) if one.param_type_name == "option" else ""
        for text in value if isinstance(value, list | tuple) else (value,):
            if isinstance(text, str | Path):
                yield flag, str(text)


def _of_flag(commands: tuple[str, ...], flag: str, here: str) -> bool:
    """Whether one of these is the command's argument, or of any command an option of that name."""
    return here in commands if not flag else any(one.endswith(f" {flag}") for one in commands)
