"""A new command, and a new format of spectra, are known everywhere by their own files and a word in the registry.

`python tests/test_registry.py --write` renews `lunarsci/__init__.pyi`.
"""

import importlib
import importlib.util
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent

import lunarsci.cli.images
import pytest
from lunarsci.cli import main

import lunarsci.images.jobs
import lunarsci.spectra.readers
from lunarsci import cli, registry
from lunarsci.guide.info import info
from lunarsci.pages.job import report
from lunarsci.spectra.readers.dispatch import read_spectra

STUB = Path(lunarsci.__file__).with_suffix(".pyi")
REQUEST = '''
    """What `images relief` can be asked."""

    from dataclasses import dataclass


    @dataclass(frozen=True, slots=True, kw_only=True)
    class ReliefRequest:
        """Of which heights the relief is.

        Attributes
        ----------
        above : Heights to count from, in m.
        """

        above: float = 0.0
    '''
JOB = '''
    """The range of heights of a terrain, as a job."""

    from collections.abc import Iterator, Mapping, Sequence
    from dataclasses import dataclass
    from typing import Any

    from matplotlib.figure import Figure

    from lunarsci.images.jobs.relief_request import ReliefRequest
    from lunarsci.io.inputs import Source, read_input
    from lunarsci.io.tables import read_csv_table
    from lunarsci.options import request_of
    from lunarsci.result import Result, job


    @dataclass(frozen=True, slots=True, kw_only=True, eq=False)
    class TerrainRelief(Result):
        """A range of heights. [m]"""

        schema = "images-relief/1"
        page_title = "Relief"
        sources = ("Nobody (2000), J. Nothing 1, 2",)
        inputs: Mapping[str, str]
        relief_m: float

        def to_dict(self) -> dict[str, Any]:
            return {"relief_m": self.relief_m}

        def rows(self) -> Sequence[Mapping[str, Any]]:
            return [self.to_dict()]

        def figures(self) -> Iterator[Figure]:
            figure = Figure()
            figure.subplots().bar(["relief"], [self.relief_m])
            yield figure

        @staticmethod
        def page_answer(result: Mapping[str, Any]) -> str:
            return f"Heights range over {result['relief_m']:g} m."


    @job
    def relief(ground: Source, request: ReliefRequest | None = None, **options: Any) -> TerrainRelief:
        """The range of heights of a terrain above some height."""
        asked = request_of(ReliefRequest, request, options)
        source = read_input(ground)
        heights = read_csv_table(source)["height_m"]
        relief_m = float(heights.max()) - max(asked.above, float(heights.min()))
        return TerrainRelief(inputs={source.name: source.sha256}, relief_m=relief_m)
    '''
COMMAND = '''
    """`lunarsci images relief`: the range of heights of a terrain."""

    from typing import TYPE_CHECKING, Annotated

    import typer

    from lunarsci.images.jobs.relief_request import ReliefRequest

    from ..shared.command import command
    from ..shared.emit import Report
    from ..shared.options import option
    from ..shared.table import TextTable

    if TYPE_CHECKING:
        from lunarsci.images.jobs.relief import TerrainRelief

    OPTIONS = {"above": option(metavar="M")}
    EXAMPLES = ("lunarsci images relief ground.csv", "lunarsci images relief ground.csv --above 0.1")


    Ground = Annotated[str, typer.Argument(metavar="TERRAIN", help="Heights.")]


    @command("relief", EXAMPLES, OPTIONS)
    def relief(ground: Ground, request: ReliefRequest) -> Report:
        """The range of heights of a terrain.

        Of those above a height with --above.
        """
        from lunarsci.images.jobs.relief import relief

        result = relief(ground, request)
        return Report(result, result_tables(result))


    def result_tables(result: "TerrainRelief") -> list[TextTable]:
        return [TextTable(["relief [m]"], [[f"{result.relief_m:g}"]])]
    '''


def stub() -> str:
    """`__init__.pyi`: every function from where it is."""
    places = {
        name: f"lunarsci.{part}.jobs.{name}" for part in registry.COMMANDS for name in registry.functions_of(part)
    }
    lines = [
        f"from {module} import {name} as {name}"
        for name, module in sorted({**places, **lunarsci._ELSEWHERE}.items(), key=lambda one: one[1])
    ]
    lines.insert(0, "from lunarsci import errors as errors")
    return "\n".join([*lines, "", "JOBS: dict[str, tuple[str, ...]]", "__version__: str", ""])


def test_type_checkers_know_every_function() -> None:
    assert STUB.read_text("utf-8") == stub(), "python tests/test_registry.py --write"


def test_every_command_and_every_job_is_where_the_registry_says() -> None:
    for part, commands in registry.COMMANDS.items():
        for name, function in commands.items():
            module = importlib.import_module(f"lunarsci.{part}.jobs.{function or name}")
            assert not function or callable(getattr(module, function))
            assert importlib.util.find_spec(f"lunarsci.cli.{part}.{name}") is not None


@pytest.fixture
def newcomer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """`lunarsci images relief`: three files of its own, a word in `COMMANDS`, and one in `KINDS`. A terrain to try."""
    for package, files in (
        (lunarsci.cli.images, {"relief.py": COMMAND}),
        (lunarsci.images.jobs, {"relief.py": JOB, "relief_request.py": REQUEST}),
    ):
        folder = tmp_path / package.__name__
        folder.mkdir()
        for name, text in files.items():
            (folder / name).write_text(dedent(text), "utf-8")
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    terrain = registry.KINDS["terrain"]
    monkeypatch.setitem(registry.COMMANDS["images"], "relief", "relief")
    monkeypatch.setitem(
        registry.KINDS, "terrain", registry.KindOfFile(terrain.title, (*terrain.commands, "images relief"))
    )
    cli._program.cache_clear()
    monkeypatch.chdir(tmp_path)
    ground = tmp_path / "ground.csv"
    ground.write_text("x_m,y_m,height_m\n" + "".join(f"{x},{y},{x / 4}\n" for x in range(4) for y in range(3)))
    yield ground
    cli._program.cache_clear()
    for name in [name for name in sys.modules if name.endswith((".relief", ".relief_request")) and ".images." in name]:
        del sys.modules[name]


def test_a_new_command_is_known_everywhere(newcomer: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from former import in_python
    from fuzz_readers import path_parameters, readers_of

    def printed(*arguments: str) -> str:
        assert main([*arguments]) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    assert "The range of heights of a terrain." in printed("images", "--help")
    text = printed("images", "relief", "--help")
    assert "Heights to count from, in m." in text and "--above" in text and "lunarsci images relief ground.csv" in text
    document = json.loads(printed("images", "relief", "ground.csv", "--above", "0.1", "--json"))
    assert document["result"] == {"relief_m": pytest.approx(0.65)} and document["schema"] == "lunarsci/images-relief/1"
    assert printed("images", "relief", "ground.csv", "--csv") == "relief_m\n0.75\n"
    assert main(["images", "relief", "ground.csv", "-o", "relief.json", "--plot", "relief.png"]) == 0
    assert "Heights range over 0.75 m." in capsys.readouterr().err
    assert Path("relief.png").read_bytes().startswith(b"\x89PNG")
    (section,) = report("relief.json").rows()
    assert (section["title"], section["answer"]) == ("Relief", "Heights range over 0.75 m.")
    assert "@misc{nobody2000," in printed("cite", "relief.json")
    assert "lunarsci images relief" in info(newcomer).commands
    notebook = in_python("images relief ground.csv --above 0.1 --json")
    assert notebook.to_dict() == document["result"] and notebook.plot().axes
    shown = printed("images", "relief", "ground.csv", "--above", "0.1")
    assert f"{notebook.to_text()}\n" == shown and str(notebook).startswith("Heights range over 0.65 m.")
    assert "above : Heights" in (lunarsci.relief.__doc__ or "")
    declared = {name: readers_of(name, metavar) for name, metavar in path_parameters() if "images relief " in name}
    assert None not in declared.values() and "terrain .csv" in (declared["images relief ground"] or ())


PLAIN = """
    import io

    import numpy as np

    from lunarsci.io.inputs import InputFile
    from lunarsci.spectra.readers.table import Column, SpectrumTable


    def is_plain(source: InputFile, start: str) -> bool:
        return start.startswith("PLAIN")


    def read_plain(source: InputFile) -> SpectrumTable:
        wavelength, reflectance = np.loadtxt(io.BytesIO(source.data), skiprows=1, unpack=True)
        places = tuple(f"line {number}" for number in range(2, 2 + len(wavelength)))
        spectra = ((Column("rock", reflectance, 2), None),)
        return SpectrumTable(source, "plain", Column("wavelength", wavelength, 1, "nm"), spectra, places)
    """


def test_a_new_format_is_known_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of its own, and a row in `FORMATS`."""
    (tmp_path / "plain.py").write_text(dedent(PLAIN), "utf-8")
    monkeypatch.setattr(lunarsci.spectra.readers, "__path__", [*lunarsci.spectra.readers.__path__, str(tmp_path)])
    plain = registry.FormatOfSpectra("PLAIN", "plain:read_plain", "plain:is_plain", spectra_alone=True)
    monkeypatch.setattr("lunarsci.spectra.readers.dispatch.FORMATS", formats := {"plain": plain} | registry.FORMATS)
    monkeypatch.setattr("lunarsci.guide.info.FORMATS", formats)
    file = tmp_path / "rock.dat"
    file.write_text(
        "PLAIN, below depth_m\n" + "".join(f"{nm} {0.2 + nm * 1e-5:.5f}\n" for nm in range(400, 2500, 10)), "utf-8"
    )
    (spectrum,) = read_spectra(str(file))
    assert spectrum.id == "rock" and spectrum.metadata["format"] == "plain" and spectrum.wavelength_nm[0] == 400
    assert info(file).kind == "spectra" and "lunarsci spectra fit" in info(file).commands
    assert main(["spectra", "indices", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["result"]["spectra"][0]["id"] == "rock"
    sys.modules.pop("lunarsci.spectra.readers.plain")


def test_the_help_and_the_page_name_every_format(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["spectra", "bands", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    page = (Path(__file__).parents[1] / "docs/howto/own-spectra.md").read_text("utf-8")
    for one in registry.FORMATS.values():
        assert one.title in text and one.title.split()[-1 if one.title.startswith("tables") else 0] in page, one.title


if __name__ == "__main__" and "--write" in sys.argv:
    STUB.write_text(stub(), "utf-8")
