"""Former spellings of commands and options: an alias each, which says what it stands for."""

from collections.abc import Sequence
from dataclasses import dataclass

import typer

from .talk import say


@dataclass(frozen=True, slots=True)
class Alias:
    """An option of a command that is another command, another option, or both, by now.

    Attributes
    ----------
    command : words of the command as it was.
    option : the option as it was.
    to_command : words of the command that it is now.
    to_option : the option that it is now; None where the command says it already, or always does it.
    values : the values it had to those it has now, empty where all stay the same; None for a flag without a value.
    once : whether the option may not be given beside what it is now.
    """

    command: tuple[str, ...]
    option: str
    to_command: tuple[str, ...]
    to_option: str | None
    values: dict[str, str] | None = None
    once: bool = False

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
        value = value if joined else " ".join(rest[place + 1 : place + 2])
        if self.values is None:
            new, used = ([self.to_option] if self.to_option else []), 1
        else:
            if self.values and value not in self.values:
                return None
            new = [self.to_option, self.values.get(value, value)] if self.to_option else []
            used = 1 if joined else 2
        return [*self.to_command, *rest[:place], *new, *rest[place + used :]]

    def __str__(self) -> str:
        now = " ".join([*self.to_command, *([self.to_option] if self.to_option else [])])
        return f"{' '.join(self.command)} {self.option} is an alias of {now}"


MIXING = {"unmix": "both", "hapke": "hapke", "absorbance": "absorbance"}
ANY: dict[str, str] = {}
ALIASES = (
    Alias(("spectra", "fit"), "--abundance", ("spectra", "unmix"), "--method", MIXING),
    Alias(("spectra", "fit"), "--abundance", ("spectra", "fit"), None, {"nbsr": ""}),
    Alias(("regolith", "identify"), "--joint", ("regolith", "infer"), None),
    Alias(("twin", "terrain"), "--target", ("twin", "plan"), "--target", ANY),
    Alias(("twin", "predict"), "--samples", ("twin", "predict"), "--soil", ANY),
    Alias(("twin", "predict"), "--soil-map", ("twin", "predict"), "--soil", ANY),
    Alias(("twin", "forces"), "--motion", ("twin", "loads"), "--motion", ANY),
    Alias(("twin", "forces"), "--samples", ("twin", "forces"), "--soil", ANY),
    Alias(("twin", "update"), "--belief", ("twin", "update"), "--soil", ANY, once=True),
    Alias(("twin", "update"), "--map", ("twin", "update"), "--soil", ANY, once=True),
    Alias(("twin", "predict"), "--belief", ("twin", "predict"), "--soil", ANY, once=True),
    Alias(("twin", "plan"), "--belief", ("twin", "plan"), "--soil", ANY, once=True),
    Alias(("twin", "forces"), "--belief", ("twin", "forces"), "--soil", ANY, once=True),
    Alias(("spectra", "fit"), "--start", ("spectra", "fit"), "--start-file", ANY),
    Alias(("spectra", "match"), "--map", ("spectra", "match"), "--mineral-map", ANY),
    Alias(("spectra", "match"), "--prior", ("spectra", "match"), "--crater-prior", ANY),
    Alias(("regolith", "infer"), "--prior", ("regolith", "infer"), "--prior-file", ANY),
    Alias(("regolith", "infer"), "--sample", ("regolith", "infer"), "--draw-posterior"),
    Alias(("images", "render"), "--samples", ("images", "render"), "--rays", ANY),
    Alias(("images", "render"), "--exact", ("images", "render"), "--exact-rig"),
    Alias(("images", "render"), "--rocks", ("images", "render"), "--rock-density", ANY),
    Alias(("images", "render"), "--roughness", ("images", "render"), "--roughness-factor", ANY),
    Alias(("images", "render"), "--law", ("images", "render"), "--scattering", ANY),
    Alias(("images", "dem"), "--terrain", ("images", "dem"), "--save-terrain", ANY),
    Alias(("images", "calibrate"), "--target", ("images", "calibrate"), "--pattern", ANY),
    Alias(("spectra", "simulate"), "--soil", ("spectra", "simulate"), "--minerals", ANY),
    Alias(("spectra", "simulate"), "--shadow", ("spectra", "simulate"), "--shadow-share", ANY),
    Alias(("reproduce",), "--rocks", ("reproduce",), "--boulders", ANY),
    Alias(("twin", "terrain"), "--craters", ("twin", "terrain"), "--crater-count", ANY),
    Alias(("twin", "plan"), "--craters", ("twin", "plan"), "--crater-count", ANY),
)
"""Those of several steps follow each other in this order."""


def current(arguments: Sequence[str], *, quiet: bool = False) -> list[str]:
    """The arguments with former spellings replaced, each said on stderr."""
    found = list(arguments)
    for alias in ALIASES:
        while (replaced := alias.replaced(found)) is not None:
            if alias.once and sum(word.partition("=")[0] == alias.to_option for word in replaced) > 1:
                raise typer.BadParameter(f"{alias.option} and {alias.to_option} are the same; give one")
            found = replaced
            say(f"note: {alias}", quiet=quiet)
    return found


def option_now(command: str, option: str) -> str:
    """An option of a command, such as `twin update`, without its dashes, as it is called now."""
    names = {
        alias.option: alias.to_option
        for alias in ALIASES
        if " ".join(alias.command) == command and alias.to_command == alias.command and alias.to_option
    }
    return names.get(f"--{option}", f"--{option}").removeprefix("--")
