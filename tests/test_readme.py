"""Every command of README, of the pages of `docs` and of the notebooks runs and prints what is shown there.

`python tests/test_readme.py --write [PAGE ...]` runs them and writes what they print now into the pages.
"""

import contextlib
import doctest
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import zip_longest
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
PAGES = sorted({ROOT / "README.md", *(ROOT / "docs").rglob("*.md")} - {*(ROOT / "docs/_build").rglob("*.md")})
ELSEWHERE = {
    "docs/howto/cubes.md": "tests/spectra/cubes/test_map.py",
    "docs/howto/pictures.md": "tests/test_pictures_page.py",
    "docs/howto/cluster.md": "tests/parallel/test_dask_cluster.py",
    "docs/howto/public-drives.md": "tests/cli/test_twin_trials.py",
}
"""Pages whose commands another test runs, on smaller data."""
NOT_RUN = ("make ", "pip install", "crontab ")
"""Beginnings of lines of blocks that would install something, or change the machine."""
DEMO_PICTURES = ("ground.png", "calibration.png", "bands.png", "fit.png", "drive.png", "soil.png")
BLOCK = re.compile(r"^```(sh|console|python|pycon)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
GOES_ON = re.compile(r"go on from \[[^\]]*\]\(([\w./-]+\.md)\)")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?![\w.])")
INTERPRETER = """
import contextlib, io, json, sys
namespace, printed = {"__name__": "__main__"}, []
for mode, source in json.loads(sys.stdin.read()):
    with contextlib.redirect_stdout(io.StringIO()) as told:
        exec(compile(source, "<page>", mode), namespace)
    printed.append(told.getvalue())
print(json.dumps(printed))
"""


@dataclass(frozen=True, slots=True)
class Run:
    """A command or statement of a page, what is shown of it, and what it prints."""

    command: str
    shown: str | None
    printed: str = ""


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """Language and text of each block that a reader would run."""
    for language, text in BLOCK.findall(page.read_text("utf-8")):
        if not text.startswith(NOT_RUN):
            yield language, text


def before(page: Path) -> Path | None:
    """The page whose files this one goes on with."""
    found = GOES_ON.search(page.read_text("utf-8"))
    return (page.parent / found[1]).resolve() if found else None


def cells(notebook: Path) -> Iterator[tuple[str, str]]:
    """Source of each cell of code, without magic lines, and what it printed; a result at its end has a picture."""
    for cell in json.loads(notebook.read_text("utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            source = "".join(line for line in cell["source"] if not line.startswith("%"))
            source = re.sub(r"^(\w+)\Z", r"assert '<img src=\"data:image/png' in \1._repr_html_()", source, flags=re.M)
            yield source, "".join(line for out in cell["outputs"] for line in out.get("text", []))


def commands_shown(text: str) -> list[tuple[str, str]]:
    """Each command after a `$` and the lines that follow it."""
    parts = re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]
    return [(command, shown) for command, _, shown in (part.partition("\n") for part in parts)]


class Reader:
    """Follows pages as a reader does who has activated the environment, each in a folder with the files of the demo."""

    def __init__(self, folder: Path, programs: Path, demo: Path | None = None) -> None:
        self.folder, self.demo_folder = folder, demo or folder / "demo"
        self.environment = os.environ | {
            "PATH": os.pathsep.join([str(programs), str(Path(sys.executable).parent), os.environ["PATH"]]),
            "PYTHONUTF8": "1",
            "MPLBACKEND": "Agg",
            "COLUMNS": "100",
        }
        self.after = cache(self._after)

    def shell(self, command: str, folder: Path) -> str:
        """What a line prints; it must succeed."""
        line = ["sh", "-c", f"set -e\n{command}"]
        done = subprocess.run(line, cwd=folder, env=self.environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}{done.stderr}"
        assert "Traceback" not in done.stderr
        return done.stdout

    def terminal(self, command: str, folder: Path) -> str:
        """What a line prints on a terminal; it must succeed."""
        ours, theirs = os.openpty()
        plain, printed = {"TERM": "dumb", "NO_COLOR": "1"}, b""
        with tempfile.TemporaryFile("w+") as told:
            line = ["sh", "-c", f"set -e\n{command}"]
            process = subprocess.Popen(line, cwd=folder, env=self.environment | plain, stdout=theirs, stderr=told)
            os.close(theirs)
            with contextlib.suppress(OSError):  # the other end is closed: the command has ended
                while part := os.read(ours, 10_000):
                    printed += part
            os.close(ours)
            code = process.wait()
            told.seek(0)
            errors = told.read()
        text = printed.decode().replace("\r\n", "\n")
        assert code == 0 and "Traceback" not in errors, f"{command}\n{text[-2000:]}{errors}"
        return text

    def demo(self) -> str:
        """What the demo prints, which is run where that was not done before."""
        printed = self.demo_folder / "printed.txt"
        if not printed.exists():
            self.demo_folder.mkdir()
            printed.write_text(self.shell("lunarsci demo", self.demo_folder), "utf-8")
        return printed.read_text("utf-8")

    def _after(self, page: Path) -> tuple[Path, list[Run]]:
        """The folder as the page leaves it, and what was run there."""
        self.demo()
        folder = self.folder / name_of(page).replace("/", "-")
        if one := before(page):
            shutil.copytree(self.after(one)[0], folder, symlinks=True)
        else:
            folder.mkdir()
            (folder / "lunarsci-demo").symlink_to(self.demo_folder / "lunarsci-demo")
        return folder, list(self._runs(page, folder))

    def _runs(self, page: Path, folder: Path) -> Iterator[Run]:
        if page.suffix == ".ipynb":
            runs = [Run(source, shown) for source, shown in cells(page)]
            yield from self._interpreted(runs, ["exec"] * len(runs), folder)
            return
        python = [(language, text) for language, text in blocks(page) if language.startswith("py")]
        for language, text in blocks(page):
            if language == "sh":
                self.shell(text, folder)
            elif language == "console":
                for command, shown in commands_shown(text):
                    printed = self.demo() if command == "lunarsci demo" else self.terminal(command, folder)
                    yield Run(command, shown, printed)
            elif (language, text) == python[-1]:
                yield from self._python(python, folder)

    def _python(self, texts: list[tuple[str, str]], folder: Path) -> Iterator[Run]:
        """All programs of a page, one after the other in one namespace."""
        parser, runs = doctest.DocTestParser(), []
        for language, text in texts:
            examples = parser.get_examples(text) if language == "pycon" else []
            runs += [Run(one.source, one.want) for one in examples] or [Run(text, None)]
        yield from self._interpreted(runs, ["exec" if run.shown is None else "single" for run in runs], folder)

    def _interpreted(self, runs: list[Run], modes: list[str], folder: Path) -> Iterator[Run]:
        told = json.dumps([(mode, run.command) for mode, run in zip(modes, runs, strict=True)])
        line = [sys.executable, "-c", INTERPRETER]
        done = subprocess.run(line, cwd=folder, env=self.environment, input=told, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        for run, printed in zip(runs, json.loads(done.stdout), strict=True):
            yield Run(run.command, run.shown, printed)


def same(shown: str, printed: str) -> None:
    """The same words and layout; numbers within three units of the last digit shown, or 1 %."""
    words = [re.sub("─+", "─", NUMBER.sub("#", text)).split() for text in (shown, printed)]
    assert words[0] == words[1]
    for one, other in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        last_digit = 10.0 ** -len(one.partition(".")[2])
        assert float(other) == pytest.approx(float(one), rel=0.01, abs=3 * last_digit), (one, other)


RUN_HERE = [page for page in PAGES if name_of(page) not in ELSEWHERE and list(blocks(page))] + NOTEBOOKS


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory, program: Path, demo: Path) -> Reader:
    return Reader(tmp_path_factory.mktemp("pages"), program, demo)


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN_HERE, ids=name_of)
def test_commands_of_a_page_run_and_print_what_it_shows(page: Path, reader: Reader) -> None:
    for run in reader.after(page)[1]:
        if run.shown is not None:
            same(run.shown, run.printed)


def test_there_are_pages_with_commands() -> None:
    assert len(RUN_HERE) > 30
    assert sum(language == "console" for page in RUN_HERE for language, _ in blocks(page)) > 10


@pytest.mark.parametrize(("page", "test"), ELSEWHERE.items())
def test_other_pages_are_run_elsewhere(page: str, test: str) -> None:
    assert page in (ROOT / test).read_text("utf-8")
    assert list(blocks(ROOT / page))


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 120


def executed(notebook: Path, folder: Path) -> str:
    """The text of a notebook with what its cells show now, pictures too."""
    import nbformat
    from nbclient import NotebookClient

    document = nbformat.read(notebook, as_version=4)
    NotebookClient(document, resources={"metadata": {"path": str(folder)}}).execute()
    for cell in document.cells:
        cell.metadata.clear()
    document.metadata = {"kernelspec": document.metadata["kernelspec"], "language_info": {"name": "python"}}
    return str(nbformat.writes(document, indent=1)) + "\n"


def renewed(page: Path, runs: list[Run]) -> str:
    """The text of a page with what its commands print now."""
    text = page.read_text("utf-8")
    for run in runs:
        if run.shown is None or run.shown == run.printed:
            continue
        head = f"$ {run.command}\n" if f"$ {run.command}\n" in text else run.command
        if head == run.command:
            lines = run.command.splitlines()
            head = "".join(f"{mark} {line}".rstrip() + "\n" for mark, line in 
                           zip_longest([">>>"], lines, fillvalue="..."))  # fmt: skip
        assert head + run.shown in text, f"{page}: {head}"
        text = text.replace(head + run.shown, head + run.printed, 1)
    return text


WIDEST_PX, COLOURS = 1000, 96


def keep_pictures(page: Path, folder: Path) -> None:
    """Pictures that a page shows and its commands draw, smaller, in `docs/images`."""
    from PIL import Image

    for name in re.findall(r"images/([\w-]+\.png)\)", page.read_text("utf-8")):
        drawn = [path for path in (folder / name, folder / "lunarsci-demo" / name) if path.is_file()]
        if drawn:
            with Image.open(drawn[0]) as picture:
                small = picture.convert("RGB")
                small.thumbnail((WIDEST_PX, WIDEST_PX), Image.Resampling.LANCZOS)
                small.quantize(COLOURS).save(ROOT / "docs/images" / name, optimize=True)


def write(names: list[str]) -> None:
    """Renew what the pages show, text and pictures; all, or those that are named."""
    pages, failed = [ROOT / name for name in names] or RUN_HERE, []
    with tempfile.TemporaryDirectory() as folder:
        reader = Reader(Path(folder), Path(sys.executable).parent)
        for page in pages:
            try:
                at, runs = reader.after(page)
            except AssertionError as failure:
                failed.append(name_of(page))
                sys.stdout.write(f"FAILED {name_of(page)}: {failure}\n")
                continue
            page.write_text(executed(page, at) if page.suffix == ".ipynb" else renewed(page, runs), "utf-8")
            if page.suffix == ".md":
                keep_pictures(page, at)
            sys.stdout.write(f"{name_of(page)}\n")
            sys.stdout.flush()
    if failed:
        sys.exit(f"not renewed: {', '.join(failed)}")


def test_pictures_are_drawn_by_the_commands_of_some_page() -> None:
    drawn = "".join(text for page in PAGES for _, text in blocks(page)) + " ".join(DEMO_PICTURES)
    for page in PAGES:
        for name in re.findall(r"images/([\w-]+\.png)\)", page.read_text("utf-8")):
            assert name in drawn and (ROOT / "docs/images" / name).is_file(), (page, name)


def test_a_page_is_renewed_where_a_command_prints_something_else(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```console\n$ lunarsci x\nold 1\n```\n\n```pycon\n>>> f(1,\n...   2)\n3\n```\n")
    runs = [Run("lunarsci x", "old 1\n", "new 2\n"), Run("f(1,\n  2)\n", "3\n", "4\n")]
    assert renewed(page, runs) == "```console\n$ lunarsci x\nnew 2\n```\n\n```pycon\n>>> f(1,\n...   2)\n4\n```\n"


if __name__ == "__main__":
    if sys.argv[1:2] != ["--write"]:
        sys.exit(__doc__)
    write(sys.argv[2:])
