"""The `lunarsci` command."""

import ast
import contextlib
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer

from lunarsci.errors import BatchError, NoFilesError, TakenError
from lunarsci.io.atomic import STOPPING, written
from lunarsci.names import nearest
from lunarsci.registry import COMMANDS, SINGLE

from .shared.talk import CLOSED, FAILED, NO_FILES, USAGE, failure_line, interrupt, interrupted, say

GROUPS = {
    "spectra": "What the rock is made of: absorption bands and minerals from reflectance spectra.",
    "regolith": "What the ground is: wheel-soil forces, the soil that wheel states reveal, and soils alike.",
    "images": "What pictures show: terrain, where the rover stands, how deep its tracks are, and rocks.",
    "twin": "Whether the next drive is safe: a rover simulated on deformable ground.",
}
"""Groups of commands, and what the help says of each."""
HELP = (
    "From a lunar rover's spectra and wheel telemetry to what the rock is, what the ground is, and whether the next "
    "drive is safe."
)
HELP_NAMES = {"help_option_names": ["-h", "--help"]}
COMPLETING = "_LUNARSCI_COMPLETE"
"""Set by the shell where it asks what may come next; the words so far are then in these two, by shell."""
TYPED = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")
NO_CHOICE, CHOICE = re.compile(r"'([^']*)' is not one of (.+)\."), re.compile(r"'([^']+)'")
"""Typer's message for a value that is no choice of an option, and each choice in it."""
MOMENT_S = 2.0
"""What a command is given to end by itself after Ctrl-C; assumed."""
EXIT_CODES = (
    "Exit codes: 0 done; 1 failed, or some inputs of a batch; 2 wrong usage, or --force is wanted; 3 finished, but not "
    "to be trusted or not safe; 4 no file to read in the folders given; 130 interrupted by Ctrl-C, 143 by SIGTERM."
)


def command_line(wanted: Collection[str] | None = None) -> typer.Typer:
    """The program; parts that are not wanted are left out or there by name alone, which spares importing them.

    `wanted` has groups, single commands, and the commands wanted of a group; None wants all.
    """
    program = typer.Typer(no_args_is_help=True, help=HELP, epilog=EXIT_CODES, context_settings=HELP_NAMES)
    program.callback()(lunarsci)
    for name, text in GROUPS.items():
        group = typer.Typer(no_args_is_help=True, help=text)
        group.callback()(lambda: None)
        if wanted is None or name in wanted:
            chosen = COMMANDS[name] if wanted is None else [one for one in COMMANDS[name] if one in wanted]
            for command in COMMANDS[name]:
                if command in chosen:
                    _add(import_module(f".{name}.{command}", __name__), group)
                else:
                    group.command(command, help="" if chosen else _summary(name, command))(lambda: None)
        program.add_typer(group, name=name)
    for name, text in SINGLE.items():
        if wanted is None or name in wanted:
            _add(import_module(f".{name}", __name__), program)
        else:
            program.command(name, help=text)(lambda: None)
    return program


def _add(module: ModuleType, app: typer.Typer) -> None:
    """Add the commands that a module declares, below a group of their own where it has the help of one as `GROUP`."""
    group = app
    if text := getattr(module, "GROUP", ""):
        group = typer.Typer(no_args_is_help=True, help=text)
        app.add_typer(group, name=module.__name__.rpartition(".")[2])
    for function in vars(module).values():
        if getattr(function, "__module__", "") == module.__name__ and hasattr(function, "add_to"):
            function.add_to(group)


def _summary(group: str, command: str) -> str:
    """The first paragraph of a command's help, from its source, which is not run."""
    place = find_spec(f".{group}.{command}", __name__)
    tree = ast.parse(Path(str(place and place.origin)).read_text("utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "GROUP":
            return str(ast.literal_eval(node.value))
        if isinstance(node, ast.FunctionDef) and node.returns and "Report" in ast.unparse(node.returns):
            return " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
    return ""


@cache
def _program(*wanted: str) -> Callable[..., Any]:
    """The command line, made once in a process."""
    return typer.main.get_command(command_line(wanted))


def _parts(arguments: Sequence[str]) -> list[str]:
    """Which parts of the program are needed: a group and its command, or those of what a shell wants to complete."""
    words = list(arguments)
    if COMPLETING in os.environ:
        words = [word for name in TYPED for word in os.environ.get(name, "").split()]
    named = [word for word in words if not word.startswith("-")]
    first = next((k for k, word in enumerate(named) if word in (*GROUPS, *SINGLE)), len(named))
    part = named[first : first + 1]
    return part + [word for word in named[first + 1 : first + 2] if word in COMMANDS.get(part[0], ())]


def _show_version(value: bool) -> None:
    if value:
        from lunarsci import __version__

        typer.echo(__version__)
        raise typer.Exit


def lunarsci(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Options of the command as a whole."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; a failure is one line on stderr."""
    as_program = arguments is None
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    _prepare_process()
    if as_program:
        _leave_on_signal()
    try:
        code: Any = _program(*_parts(arguments))(arguments, standalone_mode=False, prog_name="lunarsci")
        code = int(code or 0)
    except (KeyboardInterrupt, typer.Abort):
        code = interrupted()
    except (BrokenPipeError, SystemExit) as error:  # typer ends a closed pipe by the latter
        code = CLOSED if isinstance(error.__context__ or error, BrokenPipeError) else FAILED
    except Exception as error:
        code = _report(error, verbose="-v" in arguments or "--verbose" in arguments)
    _settle_stdout()
    if as_program and code == interrupted():
        # Python would wait for threads that still compute.
        sys.stderr.flush()
        os._exit(code)
    return int(code)


def _report(error: Exception, *, verbose: bool) -> int:
    usage = getattr(error, "format_message", None)
    if usage is not None:
        return _report_usage(error, usage())
    say(f"error: {failure_line(error)}")
    if verbose:
        import traceback

        traceback.print_exception(error)
    if isinstance(error, NoFilesError) or (isinstance(error, BatchError) and error.no_files):
        return NO_FILES
    return USAGE if isinstance(error, TakenError) else FAILED


def _report_usage(error: Any, message: str) -> int:
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        error.show()
    else:
        path = context.command_path if context else "lunarsci"
        text = _with_nearest(" ".join(message.split()).replace(": Value error, ", ": ")) + _elsewhere(error, message)
        say(f"error: {text} (see '{path} --help')")
    return int(error.exit_code)


def _with_nearest(message: str) -> str:
    """A message on a value that is none of a few choices, with the nearest of them."""
    choice = NO_CHOICE.search(message)
    near = choice and nearest(choice[1], CHOICE.findall(choice[2]))
    return f"{message} Did you mean '{near}'?" if near else message


def _elsewhere(error: Any, message: str) -> str:
    """The other command of the group whose option of the same name has the choice that this one's has not."""
    choice, param, group = NO_CHOICE.search(message), getattr(error, "param", None), getattr(error.ctx, "parent", None)
    if choice is None or param is None or group is None or group.info_name not in COMMANDS:
        return ""
    whole: Any = _program(group.info_name, *COMMANDS[group.info_name])
    for name, command in whole.commands[group.info_name].commands.items():
        for other in getattr(command, "params", ()):
            if other.name == param.name:
                with contextlib.suppress(type(error)):
                    other.process_value(error.ctx, choice[1])
                    return f" '{choice[1]}' is one of `{group.command_path} {name} {max(other.opts, key=len)}`."
    return ""


def _prepare_process() -> None:
    """A polite kill unwinds like Ctrl-C, so that temporary files go; a terminal without a character shows '?'.

    Into a file or another program goes UTF-8, as into the file of `-o`, whatever the language of the system.
    """
    for number in STOPPING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup and a shell's background jobs want it
            signal.signal(number, interrupt)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure:
            to_program = stream is sys.stdout and not stream.isatty()
            reconfigure(errors="replace", encoding="utf-8" if to_program else None)


def _leave_on_signal() -> None:
    """Ctrl-C where Python does not hear it, as while machine code is made: a moment later the process ends anyway."""
    heard, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)

    def watch() -> None:
        while (number := os.read(heard, 1)[0]) not in STOPPING or signal.getsignal(number) is signal.SIG_IGN:
            pass
        time.sleep(MOMENT_S)
        blocks = sys.modules.get("lunarsci.parallel.blocks")
        saved = blocks.what_is_saved() if blocks else []
        say("; ".join(["interrupted", *(saved or [written()])]))
        os._exit(interrupted(number))

    threading.Thread(target=watch, daemon=True).start()


def _settle_stdout() -> None:
    """Where stdout cannot take what is left in its buffer (`| head`, a full disk), keep Python quiet about it."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
