"""Results of jobs as tables, HTML and JSON; requests as options of a command."""

import ast
import base64
import importlib
import inspect
import io
import json
import math
import pickle
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pandas as pd
import pytest
import typer
from astropy import units
from astropy.table import QTable
from lunarsci.cli import command_line, main
from lunarsci.cli.shared.command import command
from lunarsci.cli.shared.emit import Report, answers_of
from lunarsci.cli.shared.options import option
from matplotlib.figure import Figure
from typer.testing import CliRunner

import lunarsci
from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.figure import inline_picture
from lunarsci.io.inputs import read_input
from lunarsci.options import TYPED, request_of
from lunarsci.regolith.jobs.requests import WheelForcesRequest
from lunarsci.result import Doubt, MadeFrom, Result, _column

ROOT = Path(__file__).parents[1]
NO_FIELDS = {"output", "save_terrain", "save_disparity", "save_cloud"}
"""Files that a command writes: no option of a function."""
WITH_DASHES = {
    "lunarsci/figure.py", "lunarsci/images/jobs/locate.py", "lunarsci/pages/documents.py",
    "lunarsci/spectra/origin/composition.py",
}  # fmt: skip
"""Modules of which an error names an option of commands, or of another program, as it is typed."""


@dataclass(frozen=True)
class Asked:
    """What is asked.

    Attributes
    ----------
    load_n : Load on the wheel, in N.
    ties : Bands that share a centre.
    exact : With the integrals, whatever `load_n` is.
    """

    load_n: float = 20.0
    ties: tuple[str, ...] = ()
    exact: bool = False

    def __post_init__(self) -> None:
        if self.load_n < 0:
            raise RequestError(f"`load_n` is {self.load_n}; give 0 or more")


@dataclass(frozen=True)
class Found(Result):
    schema = "found/1"
    load_n: float
    note: str

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(sources=["someone (2024)"], seed=3)

    def to_dict(self) -> dict[str, Any]:
        return {"load_n": self.load_n, "note": self.note}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [self.to_dict() | {"torque_nm": 2.0}, {"load_n": None, "note": "<b>"}]


def test_a_table_has_units() -> None:
    table = Found(1.5, "x").to_table()
    assert table["load_n"].unit == units.N
    assert table["torque_nm"].unit == units.N * units.m
    assert np.isnan(table["load_n"][1])
    assert list(table["note"]) == ["x", "<b>"]
    empty = Found(None, "x").to_table()
    assert empty["load_n"].unit == units.N and np.isnan(empty["load_n"]).all(), "a column without a value, too"
    assert np.isnan(_column("fo_mean", [None, None])).all(), "whatever its name is"


def test_html_says_what_it_shows() -> None:
    shown = Found(1.5, "x")._repr_html_()
    assert "1.5" in shown
    assert "<b>" not in shown


def test_json_has_provenance() -> None:
    made = json.loads(Found(1.5, "x").to_json(time=False))
    assert made["result"] == {"load_n": 1.5, "note": "x"}
    assert made["schema"] == "lunarsci/found/1"
    assert made["provenance"]["seed"] == 3


def test_there_is_no_picture() -> None:
    with pytest.raises(ParameterError, match="page 0"):
        Found(1.5, "x").plot()


def test_options_make_a_request() -> None:
    assert request_of(Asked, None, {"load_n": 3.0}) == Asked(load_n=3.0)
    assert isinstance(request_of(Asked, None, {"load_n": 3}).load_n, float)
    assert request_of(Asked, None, {"ties": "abc"}).ties == ("abc",)
    assert request_of(Asked, Asked(exact=True), {"ties": ("a",)}) == Asked(ties=("a",), exact=True)
    with pytest.raises(RequestError, match=r"'lode' is no option here; did you mean 'load_n'\? these are: exact"):
        request_of(Asked, None, {"lode": 1})
    with pytest.raises(RequestError, match=r"'rays' is no option here"):
        request_of(Asked, None, {"rays": 1})


REQUESTS = sorted(
    {
        (path.relative_to(ROOT).with_suffix("").as_posix().replace("/", "."), name)
        for path in (ROOT / "lunarsci").rglob("*.py")
        for name in re.findall(r"^class (\w+Request)\b", path.read_text("utf-8"), re.M)
    }
)


def test_names_of_the_command_line_are_answered_with_those_of_python() -> None:
    """Each option of a request that is typed otherwise, on every command."""
    fields_of_requests = {
        name
        for module, request in REQUESTS
        for name in get_type_hints(getattr(importlib.import_module(module), request))
    }
    pending, typed = [typer.main.get_command(command_line())], {}
    while pending:
        one = pending.pop()
        pending += getattr(one, "commands", {}).values()
        for item in one.params:
            flag = max(item.opts, key=len)
            own = flag.removeprefix("--").replace("-", "_")
            if flag.startswith("--") and item.name in fields_of_requests and own != item.name:
                typed[own] = item.name
    assert {"prior_file", "draw_posterior", "start_file"} <= set(typed)
    assert {name: TYPED.get(name) for name in typed if name not in NO_FIELDS} == {
        name: typed[name] for name in typed if name not in NO_FIELDS
    }
    with pytest.raises(RequestError, match="'prior_file' is how the command line has `prior`"):
        lunarsci.infer("no.csv", prior_file="x.toml")
    with pytest.raises(RequestError, match="'draw_posterior' is how the command line has `sample`"):
        lunarsci.infer("no.csv", draw_posterior=True)


def test_results_of_arrays_and_of_files_can_be_pickled(tmp_path: Path) -> None:
    nm = np.arange(600.0, 2600.0, 5.0)
    values = 0.3 * (1 - 0.3 * np.exp(-(((nm - 950) / 90) ** 2)) - 0.2 * np.exp(-(((nm - 1950) / 200) ** 2)))
    file = tmp_path / "rock.csv"
    pd.DataFrame({"wavelength_nm": nm, "reflectance": values}).to_csv(file, index=False)
    for source in ((nm, values), str(file)):
        found = lunarsci.bands(source)
        assert pickle.loads(pickle.dumps(found)).to_json(time=False) == found.to_json(time=False)


def test_a_page_says_what_is_no_result() -> None:
    for wrong in (3, 0, None):
        with pytest.raises(DataError, match=f"{wrong} is no result; give"):
            lunarsci.report([wrong])


def spelled_with_dashes(source: str) -> bool:
    """Whether an error or a warning has an option as it is typed, outside the backticks of a command."""
    dashes = re.compile(r"(?<![\w-])--[a-z]")
    for one in ast.walk(ast.parse(source)) if dashes.search(source) else ():
        if isinstance(one, ast.Raise) or (isinstance(one, ast.Call) and ast.unparse(one.func).endswith("warn")):
            texts = [part.value for part in ast.walk(one) if isinstance(part, ast.Constant)]
            if dashes.search(re.sub("`[^`]*`", "", "".join(map(str, texts)))):
                return True
    return False


def test_errors_name_options_as_python_has_them() -> None:
    assert spelled_with_dashes('raise ValueError(f"{path}: add --force")')
    assert not spelled_with_dashes('raise ValueError(f"{path}: add `force`, or `spectra fit --json`")')
    files = [path for path in (ROOT / "lunarsci").rglob("*.py") if path.relative_to(ROOT).parts[1] != "cli"]
    found = {str(path.relative_to(ROOT)) for path in files if spelled_with_dashes(path.read_text("utf-8"))}
    assert found == WITH_DASHES


@pytest.mark.parametrize(("module", "request_name"), REQUESTS)
def test_an_option_refuses_what_is_none_of_its_choices(module: str, request_name: str) -> None:
    kind = getattr(importlib.import_module(module), request_name)
    for name, hint in get_type_hints(kind).items():
        kinds = (hint, *get_args(hint))
        if any(get_origin(one) is Literal for one in kinds):
            with pytest.raises(RequestError, match=f"`{name}` is 'xyz'; .*these are: "):
                request_of(kind, None, {name: "xyz"})
        if float in kinds and str not in kinds:
            with pytest.raises(RequestError, match=f"`{name}` is 'xyz'; give "):
                request_of(kind, None, {name: "xyz"})


def test_plain_types_of_options_are_kept() -> None:
    assert request_of(Asked, None, {"load_n": np.float32(2.0)}) == Asked(load_n=2.0)
    for wrong in ({"load_n": "a"}, {"load_n": True}, {"exact": 1}, {"ties": 5}):
        with pytest.raises(RequestError, match="; give "):
            request_of(Asked, None, wrong)
    with pytest.raises(RequestError, match="; give "):
        request_of(Asked, Asked(exact=1), {})


def test_a_command_takes_the_fields_of_a_request() -> None:
    app = typer.Typer()
    seen = []

    @command("try", options={"load_n": option(), "ties": option(), "exact": option()})
    def run(request: Asked) -> Report:
        seen.append(request)
        return Report(Found(request.load_n, "x"), [])

    run.add_to(app)  # type: ignore[attr-defined]

    runner = CliRunner()
    help_text = " ".join(runner.invoke(app, ["--help"]).output.replace("│", " ").split())
    assert "Load on the wheel, in N." in help_text and "whatever --load-n is." in help_text
    assert runner.invoke(app, ["--load-n", "7", "--ties", "a", "--ties", "b", "--exact", "--json"]).exit_code == 0
    assert runner.invoke(app, ["--json"]).exit_code == 0
    assert seen == [Asked(7.0, ("a", "b"), True), Asked()]
    wrong = runner.invoke(app, ["--load-n", "-1"])
    assert wrong.exit_code == 2
    assert "--load-n is -1.0; give 0 or more" in " ".join(wrong.output.replace("│", " ").split())


@pytest.mark.parametrize("kind", ["file", "frame", "table"])
def test_open_files_and_tables_are_inputs(kind: str) -> None:
    frame = pd.DataFrame({"sinkage_m": [0.01, 0.02], "wheel": ["FL", "FR"]})
    table = QTable({"sinkage_m": [1.0, 2.0] * units.cm, "wheel": ["FL", "FR"]})
    given = {"file": io.StringIO(frame.to_csv(index=False)), "frame": frame, "table": table}[kind]
    content = read_input(given).data.decode()
    rows = [line.split(",") for line in content.splitlines() if not line.startswith("#")]
    assert rows[0] == ["sinkage_m", "wheel"]
    assert [float(row[0]) for row in rows[1:]] == [0.01, 0.02]


def test_what_cannot_be_read_is_refused() -> None:
    with pytest.raises(ParameterError, match="int cannot be read; give a path"):
        read_input(3)


def test_a_result_records_what_it_was_asked_with() -> None:
    found = lunarsci.wheel_forces(sinkage=0.01, slip=0.2)
    made = json.loads(found.to_json(time=False))["provenance"]
    assert made["command"] == "lunarsci.wheel_forces"
    assert made["options"]["sinkage"] == 0.01 and made["options"]["slip"] == 0.2
    assert made["options"]["rover"] == "yutu2" and made["options"]["reading"] == "signed"
    again = lunarsci.wheel_forces(WheelForcesRequest(sinkage=0.01), slip=0.2)
    assert again.asked == found.asked == pickle.loads(pickle.dumps(found)).asked


def test_a_warning_points_once_at_the_line_of_the_user_and_is_kept() -> None:
    state = pd.DataFrame({"sinkage_m": [0.008], "slip_ratio": 0.05, "normal_force_n": 32.03, "drawbar_pull_n": -1.3})
    for _ in range(2):
        with pytest.warns(LunarSciWarning, match="for reproducing published numbers only") as caught:
            found = lunarsci.identify(state, rover="yutu2", reading="slip-branch")
        assert [warning.filename for warning in caught] == [__file__]
        assert json.loads(found.to_json())["provenance"]["warnings"] == [str(caught[0].message)]
    with pytest.raises(LunarSciWarning), warnings.catch_warnings():
        warnings.simplefilter("error")
        lunarsci.identify(state, rover="yutu2", reading="slip-branch")


def test_a_result_prints_as_its_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["regolith", "forces", "--sinkage", "0.01", "--slip", "0.2"]) == 0
    found = lunarsci.wheel_forces(sinkage=0.01, slip=0.2)
    assert f"{found.to_text()}\n" == capsys.readouterr().out
    assert found.to_text() in str(found)
    html = found._repr_html_()
    assert "<th>" in html and "drawbar pull" in html
    assert len(repr(found)) < 200


def test_a_sentence_has_no_number_that_is_none() -> None:
    medians = {"slip_ratio": {"median": 0.1}, "sinkage_m": {"median": math.nan}}
    content = {"wheels": {"FL": medians}, "distance_m": 1.0, "duration_s": 20.0}
    result: Any = SimpleNamespace(schema="twin-states/1", untrusted="", failures=())
    (sentence,), _ = answers_of(result, content, [], {})
    assert "Sinkage was not measured" in sentence and "nan" not in sentence


PNG = re.compile('<img src="data:image/png;base64,([^"]+)"')


def test_a_notebook_shows_answer_table_and_picture() -> None:
    """A picture of the width of a page at 100 points per inch, from base64; the rows that are left out are counted."""
    found = lunarsci.wheel_forces(load=36.5, slip="0:0.5:90")
    html = found._repr_html_()
    assert html.index("<p>") < html.index("<table>") < html.index("<img") < html.index("<details>")
    first, _, folded = html.partition("<details>")
    assert first.count("<tr>") == 1 + 12 and "78 more rows: to_pandas() has all" in first
    assert folded.count("<tr>") > 90 and "more of 90 rows" in folded and "more rows" not in folded
    width = int.from_bytes(base64.b64decode(PNG.findall(html)[0])[16:20], "big")
    assert width == pytest.approx(100 * found.plot().get_figwidth(), abs=1) and len(html) < 250_000


def test_a_result_of_ten_thousand_spectra_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """And its picture is one page: of spectra that nobody sees no objects are made."""
    made: list[int] = []
    kind = importlib.import_module("lunarsci.spectra.bands").BandsOfSpectra
    one = kind.__getitem__
    monkeypatch.setattr(kind, "__getitem__", lambda self, place: made.append(place) or one(self, place))
    wavelength = np.arange(500.0, 2400.0, 20.0)
    center = np.linspace(900, 960, 10_000)[:, None]
    found = lunarsci.bands((wavelength, 0.2 * np.exp(-0.3 * np.exp(-0.5 * ((wavelength - center) / 60) ** 2))))
    html = found._repr_html_()
    assert len(html) < 250_000 and len(PNG.findall(html)) == 1 and "9,900 more rows" in html
    assert len([place for place in made if not isinstance(place, slice)]) < 100
    assert found.to_pandas()["bc1000_nm"].to_numpy() == pytest.approx(center[:, 0], abs=2.0)


def test_what_cannot_be_drawn_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Any) -> Any:
        raise ValueError("no <ink>")
        yield

    found = lunarsci.wheel_forces(sinkage=0.01)
    monkeypatch.setattr(type(found), "figures", broken)
    assert "no picture: no &lt;ink&gt;" in (html := found._repr_html_()) and "<th>" in html


def test_a_large_picture_is_made_smaller() -> None:
    """Noise, which no PNG makes small: in fewer colours, then in fewer points; what is small stays as it is."""
    noise = np.random.default_rng(0).random((900, 900, 3))

    def picture(values: Any) -> Figure:
        figure = Figure(figsize=(7.2, 7.2))
        figure.add_axes((0, 0, 1, 1)).imshow(values)
        return figure

    assert inline_picture([]) == ""
    plain, noisy = (inline_picture([picture(one)]) for one in (0 * noise, noise))
    assert plain.startswith("data:image/png;base64,") and 100_000 < len(noisy) < 200_100
    sizes = [int.from_bytes(base64.b64decode(one.partition(",")[2])[16:20], "big") for one in (plain, noisy)]
    assert sizes[0] == 720 > sizes[1]


def test_a_table_goes_to_pandas_and_what_is_no_grid_is_refused() -> None:
    found = lunarsci.wheel_forces(load=36.5, slip="0:0.5:6")
    for slips in ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], np.linspace(0, 0.5, 6), "0,0.1,0.2,0.3,0.4,0.5"):
        assert lunarsci.wheel_forces(load=36.5, slip=slips).rows()[:3] == found.rows()[:3]
    with pytest.raises(RequestError, match="several that grow"):
        lunarsci.wheel_forces(load=36.5, slip=[0.2, 0.1])
    frame = found.to_pandas()
    assert frame["slip_ratio"].tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert frame["drawbar_pull_n"].tolist() == [row["drawbar_pull_n"] for row in found.rows()]
    with pytest.raises(ParameterError, match="is no grid; to_pandas"):
        found.to_xarray()


@pytest.mark.parametrize("name", [job for jobs in lunarsci.JOBS.values() for job in jobs])
def test_the_help_of_a_function_names_every_option(name: str) -> None:
    function = getattr(lunarsci, name)
    kind = next(one for one in get_args(function.__annotations__["request"]) if is_dataclass(one))
    meaning, _, defaults = (inspect.getdoc(function) or "").partition("Other Parameters")[2].partition("By default ")
    for item in fields(kind):
        assert re.search(rf"\b{item.name}\b", meaning), f"{kind.__name__} does not say what {item.name} means"
        assert f"{item.name}=" in defaults
    assert not re.search(r"repeat(ed|able)\b|the command\b", meaning, re.IGNORECASE), "as only the command line has it"


def test_columns_of_shares_have_a_unit_and_a_meaning() -> None:
    row = {
        "olivine": 0.3,
        "olivine_low": None,
        "nbsr_orthopyroxene": 0.4,
        "olivine_present": 0.9,
        "olivine_in_mafic_high95": 0.5,
        "fo_mean": 70.0,
        "rms_ln": 0.1,
        "probability_of_plagioclase": 0.034,
    }

    @dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
    class Shares(Result):
        def to_dict(self) -> dict[str, Any]:
            return {}

        def rows(self) -> Sequence[Mapping[str, Any]]:
            return [row, row | {"olivine_low": 0.2}]

    table = Shares().to_table()
    told = {name: (table[name].unit, table[name].info.description) for name in table.colnames}
    for name in ("olivine", "olivine_low", "nbsr_orthopyroxene", "olivine_in_mafic_high95"):
        assert told[name][0] == units.dimensionless_unscaled and "fraction of 1" in told[name][1]
    assert told["fo_mean"] == (units.percent, "composition of the mineral in mol %")
    assert told["olivine_present"] == (units.dimensionless_unscaled, "probability of more than 5 % of the mineral")
    assert "the fit needs it; whether it is there, `unmix`" in told["probability_of_plagioclase"][1]
    assert told["rms_ln"][1] is None
    assert table["olivine"][0] == 0.3


def test_reasons_of_a_doubt_are_joined_in_one_place() -> None:
    """Empty ones are left out, another doubt is one reason; no job words the sentence by itself."""
    inner = Doubt.of("a wheel stands", "", "no end", verdict="no-go")
    assert str(inner) == "no-go: a wheel stands; no end" and inner.reasons == ("a wheel stands", "no end")
    assert str(Doubt.of(inner, "an odd soil")) == f"{inner}; an odd soil"
    nothing = Doubt.of("", Doubt(), verdict="not to be trusted")
    assert not nothing and str(nothing) == ""
    jobs = [path.read_text("utf-8") for path in (ROOT / "lunarsci").rglob("jobs/*.py")]
    assert len(jobs) > 30 and not any("def untrusted" in text for text in jobs)
