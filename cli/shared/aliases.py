"""Former spellings of commands and options: an alias each, which says what it stands for."""

from collections.abc import Sequence
from dataclasses import dataclass

from .talk import say

__all__ = ["ALIASES", "Alias", "current"]


@dataclass(frozen=True, slots=True)
class Alias:
    """An option of a command that is another command, another option, or both, by now.

    Attributes
    ----------
    command : words of the command as it was.
    option : the option as it was.
    to_command : words of the command that it is now.
    to_option : the option that it is now; None where the command says it already.
    values : the value it had to the value it has now; others are kept. Empty for a flag without a value.
    """

    command: tuple[str, ...]
    option: str
    to_command: tuple[str, ...]
    to_option: str | None
    values: dict[str, str] | None = None

    def replaced(self, arguments: Sequence[str]) -> list[str] | None:
        """The arguments with this alias spelled out; None where it is not in them."""
        depth = len(self.command)
        if tuple(arguments[:depth]) != self.command:
            return None
        rest = list(arguments[depth:])
        place = next((k for k, word in enumerate(rest) if word.partition("=")[0] == self.option), None)
        if place is None or "--" in rest[:place]:
            return None
        _, joined, value = rest[place].partition("=")
        if self.values is None:
            new, used = ([self.to_option] if self.to_option else []), 1
        else:
            value, used = (value, 1) if joined else (" ".join(rest[place + 1 : place + 2]), 2)
            new = [self.to_option or self.option, self.values.get(value, value)]
        return [*self.to_command, *rest[:place], *new, *rest[place + used :]]

    def __str__(self) -> str:
        now = " ".join([*self.to_command, *([self.to_option] if self.to_option else [])])
        return f"{' '.join(self.command)} {self.option} is an alias of {now}"


FIT, IDENTIFY, PREDICT = ("spectra", "fit"), ("regolith", "identify"), ("twin", "predict")
ALIASES: tuple[Alias, ...] = ()


def current(arguments: Sequence[str], *, quiet: bool = False) -> list[str]:
    """The arguments with former spellings replaced, each said on stderr."""
    found = list(arguments)
    for alias in ALIASES:
        while (replaced := alias.replaced(found)) is not None:
            found = replaced
            say(f"note: {alias}", quiet=quiet)
    return found
