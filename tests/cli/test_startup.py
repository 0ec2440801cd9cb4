"""Starting up is quick: help imports nothing heavy."""

import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from lunarsci.cli import COMMANDS, command_line

HELP_MAY_IMPORT = {
    "lunarsci", "typer", "rich", "click", "shellingham", "annotated_doc", "annotated_types", "pydantic",
    "pydantic_core", "orjson", "typing_extensions", "typing_inspection", "pygments", "markdown_it", "mdurl", "attr",
}  # fmt: skip
"""`attr` comes with the maps' reader; rich imports it where it is there."""
LIST_MODULES = (
    "import sys, json; bare = set(sys.modules); sys.stdout = sys.stderr; "
    "from lunarsci.cli import main; main({arguments}); sys.stdout = sys.__stdout__; "
    "loaded = {{name.split('.')[0] for name in sys.modules.keys() - bare}}; "
    "print(json.dumps(sorted(loaded - set(sys.stdlib_module_names))))"
)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["spectra", "--help"],
        ["spectra", "fit", "--help"],
        ["spectra", "match", "--help"],
        ["twin", "predict", "--help"],
        ["twin", "terrain", "--help"],
        ["images", "dem", "--help"],
        ["regolith", "infer", "--help"],
    ],
)
def test_help_imports_only_what_it_needs(arguments: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LIST_MODULES.format(arguments=arguments)], capture_output=True, check=True
    )
    ours = {name for name in json.loads(done.stdout) if not name.startswith("_")}
    assert ours <= HELP_MAY_IMPORT, ours - HELP_MAY_IMPORT


@pytest.mark.parametrize("group", COMMANDS)
def test_a_group_says_of_its_commands_what_they_say_of_themselves(group: str) -> None:
    """It reads their sources; the commands themselves are imported when one is wanted."""
    listed, whole = (
        {name: (command.help or "").split("\n\n")[0] for name, command in groups.commands[group].commands.items()}
        for groups in (typer.main.get_command(command_line([group])), typer.main.get_command(command_line()))
    )
    assert listed == whole and all(listed.values())


def test_a_command_behind_two_dashes_is_run_and_not_its_stand_in(run) -> None:
    done = run("spectra", "--", "fit", "no-such-file")
    assert done.code == 1 and "no such file" in done.err[0]


def cpu_seconds(*arguments: str, times: int = 3) -> float:
    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    return min(once() for _ in range(times))


SMALLEST_APPLICATION = """
import typer
app = typer.Typer()
@app.command()
def one(x: int = 1): "One."
@app.command()
def two(x: int = 1): "Two."
app(["--help"])
"""


def test_help_costs_less_than_twice_the_help_of_the_smallest_application() -> None:
    ours, smallest = cpu_seconds("-m", "lunarsci.cli", "--help"), cpu_seconds("-c", SMALLEST_APPLICATION)
    assert ours <= 2 * smallest, f"{ours:.3f} s against {smallest:.3f} s"


@pytest.mark.slow
def test_one_fit_costs_less_than_two_and_a_half_times_the_usual_imports(rock: Path) -> None:
    """From a cold process, the quicker of two: the first may have to compile."""
    ours = cpu_seconds("-m", "lunarsci.cli", "spectra", "fit", str(rock), times=2)
    usual = cpu_seconds("-c", "import numpy, scipy.optimize, astropy.table", times=2)
    assert ours < 2.5 * usual, f"{ours:.2f} s against {usual:.2f} s"
