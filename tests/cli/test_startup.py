"""Starting up is quick: help imports nothing heavy."""

import json
import resource
import statistics
import subprocess
import sys

import pytest

HELP_MAY_IMPORT = {
    "lunarsci", "typer", "rich", "click", "shellingham", "annotated_doc", "annotated_types", "pydantic",
    "pydantic_core", "typing_extensions", "typing_inspection", "pygments", "markdown_it", "mdurl",
}  # fmt: skip
LIST_MODULES = (
    "import sys, json; sys.stdout = sys.stderr; "
    "from lunarsci.cli import main; main({arguments}); sys.stdout = sys.__stdout__; "
    "print(json.dumps(sorted({{name.split('.')[0] for name in sys.modules}} - set(sys.stdlib_module_names))))"
)


@pytest.mark.parametrize(
    "arguments", [["--help"], ["spectra", "--help"], ["spectra", "fit", "--help"], ["twin", "predict", "--help"]]
)
def test_help_imports_only_what_it_needs(arguments: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LIST_MODULES.format(arguments=arguments)], capture_output=True, check=True
    )
    ours = {name for name in json.loads(done.stdout) if not name.startswith("_")}
    assert ours <= HELP_MAY_IMPORT, ours - HELP_MAY_IMPORT


def cpu_seconds(*arguments: str) -> float:
    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    return statistics.median(once() for _ in range(5))


def test_help_takes_a_quarter_second_of_cpu_more_than_nothing() -> None:
    extra = cpu_seconds("-m", "lunarsci.cli", "--help") - cpu_seconds("-c", "pass")
    assert extra <= 0.25, f"{extra:.3f} s"
