"""Manual pages for `man`, from the help of the commands: `python -m lunarsci.cli.manual FOLDER`."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lunarsci import __version__

from . import EXIT_CODES, command_line

SECTION = 1


def pages() -> dict[str, str]:
    """Name of each file, such as `lunarsci-spectra-fit.1`, to its text in the language of `man`."""
    import typer

    program: Any = typer.main.get_command(command_line())
    return {f"{'-'.join(words)}.{SECTION}": _page(words, command) for words, command in _walked(("lunarsci",), program)}


def _walked(words: tuple[str, ...], command: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    yield words, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from _walked((*words, name), inner)


def _page(words: tuple[str, ...], command: Any) -> str:
    paragraphs = [" ".join(part.split()) for part in (command.help or "").split("\n\n") if part.strip()]
    title = "-".join(words)
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    options = [one for one in command.params if one.param_type_name == "option"]
    usage = " ".join(_metavar(one) for one in arguments) or ("COMMAND" if hasattr(command, "commands") else "")
    lines = [
        f'.TH "{title.upper()}" "{SECTION}" "" "lunarsci {__version__}" "lunarsci"',
        ".SH NAME",
        rf"{_escaped(title)} \- {_escaped(paragraphs[0] if paragraphs else title)}",
        ".SH SYNOPSIS",
        rf".B {_escaped(' '.join(words))}",
        _escaped(f"[OPTIONS] {usage}".strip()),
        ".SH DESCRIPTION",
        *(line for part in paragraphs for line in (".PP", _escaped(part))),
    ]
    inner = getattr(command, "commands", {})
    lines += [".SH COMMANDS"] if inner else []
    lines += [line for name, one in inner.items() for line in _entry(name, one.help)]
    lines += [".SH ARGUMENTS"] if arguments else []
    lines += [line for one in arguments for line in _entry(_metavar(one), one.help)]
    for panel in dict.fromkeys(_panel(one) for one in options):
        lines.append(f".SH {_escaped(panel.upper())}")
        for one in options:
            lines += (
                _entry(", ".join([*one.opts, *one.secondary_opts]), _with_default(one)) if _panel(one) == panel else []
            )
    lines += _examples(command.epilog or "")
    return "\n".join([*lines, ".SH EXIT STATUS", _escaped(EXIT_CODES.removeprefix("Exit codes: ")), ""])


def _panel(option: Any) -> str:
    return getattr(option, "rich_help_panel", None) or "Options"


def _metavar(argument: Any) -> str:
    return str(argument.metavar or argument.name.upper())


def _with_default(option: Any) -> str:
    shown = option.show_default if isinstance(option.show_default, str) else option.default
    default = f" [default: {shown}]" if shown not in (None, False, True, "", ()) and not callable(shown) else ""
    return f"{option.help or ''}{default}"


def _entry(name: str, text: str | None) -> list[str]:
    return [".TP", rf".B {_escaped(name)}", _escaped(" ".join((text or "").split("\n\n")[0].split()))]


def _examples(epilog: str) -> list[str]:
    examples = epilog.removeprefix("Examples:").strip("\n") if epilog.startswith("Examples:") else ""
    return [".SH EXAMPLES", ".nf", *map(_escaped, examples.split("\n")), ".fi"] if examples else []


def _escaped(text: str) -> str:
    """Text in which nothing is a command of troff."""
    safe = text.replace("\\", r"\e").replace("-", r"\-")
    return re.sub(r"^([.'])", r"\&\1", safe)


def write(folder: str) -> None:
    """Write all pages into a folder, which is made."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (target / name).write_text(text, "utf-8")


if __name__ == "__main__":
    write(sys.argv[1])
