"""What every command answers, and what it answered before: `tests/former_results.json`, made by running this file.

`python tests/benchmarks/former.py` prints every number, text and key that is another than in the table. A change on
purpose is recorded by `python tests/benchmarks/former.py --why "..." [NAME ...]`: it renews those answers, or all, and
keeps the reason beside them. Of each number six digits are held, whatever its size: others depend on the processor and
on the libraries.
"""

import argparse
import ast
import contextlib
import fcntl
import html
import io
import json
import math
import os
import pickle
import re
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
from lunarsci.cli import command_line, main
from lunarsci.cli.shared.emit import Report, emit
from lunarsci.cli.shared.options import PANEL
from lunarsci.cli.shared.table import TextTable, render
from pictured import MISSION, PLAN
from rich.cells import cell_len

import lunarsci
from lunarsci import registry
from lunarsci.pages.job import report
from lunarsci.provenance import to_json
from lunarsci.result import Result

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "tests/former_results.json"
BOUND = 1e-6
"""By which a number may differ from the former one, as a share of it."""
NOTHING = 1e-10
"""A number below stands for zero: sums that cancel leave other last digits on other processors."""
WIDER = {
    r"fit sample\.": 0.05,
    r"identify joint\.result\.joint\.laws\.\d+\.behind": 1e-4,
}
"""Bounds of some places. A chain of draws takes another way where a last digit is another: three times 1.6 %, by which
quantiles of such a chain differed between an AMD and an Intel processor. How far one law of shear is behind another is
the small difference of two large sums."""
LONG = 8
ROCK = "ol=0.1,opx=0.4,cpx=0.2,plg=0.3"
"""Steps that write the files of the later ones; then each command whose `result` is in the table."""
ROCKS: dict[str, str] = {
    "simulate": f"spectra simulate --rock {ROCK} --seed 3 -o scene",
    "calibrate": "spectra calibrate scene",
    "calibrate other": "spectra calibrate scene --photometry akimov --phase sp-high --solar g173 --vnir-steps remove",
    "write spectra": "spectra calibrate scene -o rock.ecsv",
    "bands": "spectra bands rock.ecsv",
    "bands hull": "spectra bands rock.ecsv --continuum hull --smooth 0",
    "indices": "spectra indices rock.ecsv",
    "fit": "spectra fit rock.ecsv",
    "fit auto": "spectra fit rock.ecsv --assemblage auto --starts 2",
    "fit damping": "spectra fit rock.ecsv --continuum wavenumber-cubic --prior damping",
    "fit spread": "spectra fit rock.ecsv --continuum-spread --starts 2 --model-error 0.01",
    "fit profile": "spectra fit rock.ecsv --assemblage OPX-CPX --errors profile --composition wo=42:3 --starts 2",
    "fit sample": "spectra fit rock.ecsv --assemblage OPX-CPX --errors sample --seed 4 --starts 2",
    "fit held": "spectra fit rock.ecsv --fix opx_1_center_nm=915 --bound cpx_2_center_nm=2150:2350 --starts 1 "
    "--tie cpx_1_fwhm_nm=1.0*opx_1_fwhm_nm+10",
    "unmix": "spectra unmix rock.ecsv --kind solid-rock",
    "unmix hapke": "spectra unmix rock.ecsv --kind solid-rock --assemblage OL-OPX-CPX --method hapke --iron",
    "unmix known": "spectra unmix rock.ecsv --kind solid-rock --assemblage OL-OPX-CPX-PLG --together --opaque",
    "match modes": "spectra match --modes ol=0.25:0.05,opx=0.345:0.05,cpx=0.405:0.05 --name fin",
    "match bands": "spectra match bands.json --site=-45,177 --ejecta-law housen",
    "write library": "spectra library import rock.ecsv --mineral other -o library.ecsv",
    "library check": "spectra library check library.ecsv",
}
DRIVES: dict[str, str] = {
    "forces": "regolith forces --load 36.5 --slip -0.05 --side-slip 2",
    "forces exact": "regolith forces --load 36.5 --slip 0.2 --side-slip 5 --exact --shear ellipse --bulldozing hegedus",
    "forces grouser": "regolith forces --load 20 --rover cmu-grouser --slip 0.3 --slip-sinkage lyasko",
    "wheel loads": "twin forces short.toml",
    "identify": "regolith identify states.csv --lateral-modulus 20",
    "identify solved": "regolith identify states.csv --reading signed",
    "identify joint": "regolith infer states.csv --seed 2",
    "compare soils": "regolith compare soil.json",
    "terrain": "twin plan --max-slope 11 --target 8.5,2.5 -o site",
    "choice": "twin plan --target 3,0.5 --risk 0.3 --members 4 --candidates 6 --fixes 0.05,0.5 -o chosen",
    "mission": "twin plan --mission mission.toml --risk 0.3 --members 4",
    "ground": "twin terrain synthetic --extent 4 --spacing 0.02 --seed 2 --rocks 0.03 -o ground",
    "track": "images track ground/terrain.npz --line 0,1,2.5,1.2 --step 0.5",
    "cameras": "images cameras",
    "terrain synthetic": "twin terrain synthetic --crater-count 5 --rocks 0.02 --seed 7",
    "predict sweep": "twin predict short.toml --sweep friction_angle_deg=30:50:3",
    "predict": "twin predict short.toml --soil lunar-typical --sweep stiffness_kpa_m_n=800:1600:2 --ruts -o predicted",
    "simulate drive": "twin simulate short.toml --seed 5 -o drive",
    "states": "twin states drive/telemetry.csv short.toml --track drive/track.csv -o states",
    "loads of paths": "twin loads short.toml --motion predicted/paths.csv --member 1",
    "loads of states": "twin loads --motion states/motion.csv --states states/states.csv --seed 1",
    "update": "twin update states/states.csv --plan short.toml --positions states/positions.csv --seed 1 "
    "--particles 32 --save belief.json --save-map map.json --no-ruts",
    "predict sun": "twin predict short.toml --sun 200,12 --charge 0.5",
    "sweep": "twin sweep short.toml --vary wheel.radius_m=0.13:0.29:2 --vary mass.body_kg=90:120:2 "
    "--sweep friction_angle_deg=30:50:2 --sample 0.2",
    "predict belief": "twin predict short.toml --soil belief.json --members 4",
    "predict map": "twin predict short.toml --soil map.json --members 4",
    "compare drives": "twin compare predicted states/states.csv --positions states/positions.csv",
    "history": "twin history belief.json",
    "reproduce": "reproduce --part soil",
}
HALVES = {"rocks": ROCKS, "drives": DRIVES}
FILES = {"bands.json": "bands", "soil.json": "identify joint"}
"""Files that hold the document of an earlier command."""
CSV_FILES = {"states.csv": "wheel loads"}


def lines_of_tests() -> Iterator[tuple[str, str]]:
    """Further lines, of `RECORDED` in the files of `tests/cli`."""
    for path in sorted((ROOT / "tests/cli").glob("test_*.py")):
        if "\nRECORDED = {" in (text := path.read_text("utf-8")):
            named = (node for node in ast.parse(text).body if isinstance(node, ast.Assign))
            yield from next(
                ast.literal_eval(one.value) for one in named if ast.unparse(one.targets[0]) == "RECORDED"
            ).items()


for _name, _line in lines_of_tests():
    (ROCKS if _line.startswith("spectra ") else DRIVES)[_name] = _line
COMMANDS = ROCKS | DRIVES


NOTEBOOK: dict[str, Callable[[], Result]] = {
    "fit held": lambda: lunarsci.fit(
        "rock.ecsv",
        fix=("opx_1_center_nm=915",),
        bound=("cpx_2_center_nm=2150:2350",),
        tie=("cpx_1_fwhm_nm=1.0*opx_1_fwhm_nm+10",),
        starts=1,
    ),
    "loads of paths": lambda: lunarsci.loads("predicted/paths.csv", plan="short.toml", member=1),
    "compare drives": lambda: lunarsci.compare("predicted", "states/states.csv", positions="states/positions.csv"),
    "update": lambda: lunarsci.update(
        "states/states.csv",
        plan="short.toml",
        positions="states/positions.csv",
        seed=1,
        particles=32,
        ruts=False,
        by_place=True,
    ),
}
"""Jobs in Python that are called in another way than their commands, by the name of the command that must answer the
same; of the others `in_python` makes a call."""


def job_of(line: str) -> str:
    """The function of `import lunarsci` that is the command of a line; '' where there is none."""
    part, command = line.split()[:2]
    return registry.COMMANDS.get(part, {}).get(command, "")


def notebook_names() -> list[str]:
    """The first line of every job, and `NOTEBOOK`."""
    firsts: dict[str, str] = {}
    for name, line in COMMANDS.items():
        firsts.setdefault(job_of(line), name)
    return list(dict.fromkeys([*(name for job, name in firsts.items() if job), *NOTEBOOK]))


def in_python(line: str) -> Result:
    """The job of a line, called with its arguments in their order and what else the line gives by name."""
    part, name, *words = line.split()
    typed: Any = typer.main.get_command(command_line((part, name))).commands[part].commands[name]  # type: ignore[attr-defined]
    context = typed.make_context(name, words)
    arguments, options = [], {}
    for one in typed.params:
        value = context.params.get(one.name)
        if context.get_parameter_source(one.name).name != "COMMANDLINE" or getattr(one, "rich_help_panel", "") == PANEL:
            continue
        if one.param_type_name == "argument":
            arguments.append(value[0] if isinstance(value, list | tuple) and len(value) == 1 else value)
        else:
            options[one.name] = tuple(value) if isinstance(value, list) else value
    made: Result = getattr(lunarsci, job_of(line))(*arguments, **options)
    return made


def said(arguments: list[str]) -> tuple[int, str]:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = main(arguments)
    return code, out.getvalue()


def short(value: Any) -> Any:
    """Long lists of numbers as their length, ends and moments, other long lists as their length and ends."""
    if isinstance(value, dict):
        return {key: short(item) for key, item in value.items()}
    if not isinstance(value, list):
        return value
    if len(value) <= LONG:
        return [short(item) for item in value]
    kept = {
        "length": len(value),
        "first": short(value[0]),
        "middle": short(value[len(value) // 2]),
        "last": short(value[-1]),
    }
    if all(isinstance(item, float) for item in value):
        kept |= {"sum": math.fsum(value), "squares": math.fsum(item * item for item in value)}
    return kept


def with_contents(result: dict[str, Any]) -> dict[str, Any]:
    """A result whose files in JSON are what they hold: their size hangs on last digits, which are the processor's."""
    if not isinstance(result.get("files"), list):
        return result
    files = [
        {"name": file["name"], "content": json.loads(next(Path().rglob(file["name"])).read_text("utf-8"))}
        if str(file.get("name", "")).endswith(".json")
        else file
        for file in result["files"]
    ]
    return result | {"files": files}


TABLES: dict[str, list[TextTable]] = {}
"""Tables for people of every command, kept as it runs."""
COLUMNS: dict[str, list[str]] = {}
"""Columns of its CSV."""


@contextlib.contextmanager
def kept_tables(name: str) -> Iterator[None]:
    """What a command hands over to be shown is kept on its way."""

    def keep(report: Report, *more: Any) -> int:
        TABLES[name] = list(report.shown)
        COLUMNS[name] = sorted({column for row in report.result.rows() for column in row})
        return emit(report, *more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lunarsci.cli.shared.command.emit", keep)
        yield


def answers(folder: Path, commands: dict[str, str]) -> dict[str, dict[str, Any]]:
    """The `result` of each of these commands, run in a folder."""
    found: dict[str, dict[str, Any]] = {}
    before = Path.cwd()
    os.chdir(folder)
    try:
        Path("short.toml").write_text(PLAN)
        Path("mission.toml").write_text(MISSION)
        for name, line in commands.items():
            wanted = [] if name.startswith("write") else ["--json"]
            with kept_tables(name):
                code, text = said([*line.split(), *wanted, "--no-time", "-q"])
            if not wanted:
                continue
            if code not in (0, 3):
                found[name] = {"exit": code}
                continue
            Path("answers").mkdir(exist_ok=True)
            Path("answers", f"{name}.json").write_text(text, "utf-8")
            document = json.loads(text)
            found[name] = {
                "exit": code,
                "schema": document["schema"],
                "result": short(with_contents(document["result"])),
            }
            for path, of in FILES.items():
                if of == name:
                    Path(path).write_text(text, "utf-8")
            for path, of in CSV_FILES.items():
                if of == name:
                    Path(path).write_text(said([*line.split(), "--csv", "-q"])[1], "utf-8")
    finally:
        os.chdir(before)
    return found


@cache
def run_once(shared: Path, half: str) -> Path:
    """The folder in which one of `HALVES` has run: once for all workers of a run, by the first that asks.

    `answers` has the documents as they were printed, `now.pickle` the short answers, tables for people and columns.
    """
    folder = shared / f"former-{half}"
    with (shared / f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "now.pickle").exists():
            folder.mkdir()
            made = answers(folder, HALVES[half])
            (folder / "now.pickle").write_bytes(pickle.dumps((made, TABLES, COLUMNS)))
    return folder


def documents(shared: Path) -> dict[str, dict[str, Any]]:
    """What every command printed with --json, by its name."""
    files = [file for half in HALVES for file in (run_once(shared, half) / "answers").iterdir()]
    return {file.stem: json.loads(file.read_text("utf-8")) for file in sorted(files)}


def bound_at(place: str) -> float:
    return next((bound for pattern, bound in WIDER.items() if re.match(pattern, place)), BOUND)


def differences(former: Any, now: Any, place: str) -> list[str]:
    """Keys that came or are gone, and values that are not the same; the place of an answer is its name."""
    if isinstance(former, dict) and isinstance(now, dict):
        other = [f"{place}.{key}: gone" for key in sorted(former.keys() - now.keys())]
        other += [f"{place}.{key}: new" for key in sorted(now.keys() - former.keys())]
        both = sorted(former.keys() & now.keys())
        return other + [text for key in both for text in differences(former[key], now[key], f"{place}.{key}")]
    if isinstance(former, list) and isinstance(now, list):
        if len(now) != len(former):
            return [f"{place}: another length"]
        pairs = enumerate(zip(former, now, strict=True))
        return [text for index, (one, other) in pairs for text in differences(one, other, f"{place}.{index}")]
    if isinstance(former, float) and isinstance(now, float):
        alike = math.isclose(former, now, rel_tol=bound_at(place), abs_tol=NOTHING)
    else:
        alike = former == now and type(former) is type(now)
    return [] if alike else [f"{place}: {former!r} was, {now!r} is"]


def former_answers() -> dict[str, dict[str, Any]]:
    """The table."""
    found: dict[str, dict[str, Any]] = json.loads(TABLE.read_text("utf-8"))["answers"]
    return found


FROZEN = ROOT / "tests/frozen.json"
"""What scripts rely on since version 1.0: `tests/test_stability.py`."""


def unfolded(tree: dict[str, Any]) -> dict[str, Any]:
    """A tree in which names with the same below them stand together, with `|` between, with each name by itself."""
    return {name: unfolded(below) for names, below in tree.items() for name in names.split("|")}


def frozen(part: str) -> dict[str, Any]:
    return unfolded(json.loads(FROZEN.read_text("utf-8"))[part])


def files_of(folder: Path, name: str) -> list[str]:
    """Files in the folder of `-o` of a command, those that are numbered left out; none where it writes none."""
    made = re.search(r" -o ([\w-]+)$", COMMANDS[name])
    files = (folder / made[1]).iterdir() if made and (folder / made[1]).is_dir() else ()
    return sorted(file.name for file in files if not re.search(r"\d", file.name))


SAID_OTHERWISE = ("what calibration errors add to the ratios is not determined at 1 µm",)
"""What the status of a fit says of its bands already: what calibration errors do to them is not determined."""
VERDICT = re.compile(
    "likel|not determined|hardly|decides nothing|weak evidence|strong evidence|cannot be|out of domain|do not use|"
    "not to be|no-go|strained|says? nothing|not calibrated|nothing was|depends on|undetermined|fit for use"
)
"""Words by which commands say what they do not vouch for."""


class Answers:
    """What is tested of each command of a half, by a class for each: a worker of pytest runs one of them."""

    half: str

    @pytest.fixture(scope="class")
    @classmethod
    def folder(cls, shared: Path) -> Path:
        return run_once(shared, cls.half)

    @pytest.fixture(scope="class")
    @classmethod
    def now(cls, folder: Path) -> dict[str, dict[str, Any]]:
        made, tables, columns = pickle.loads((folder / "now.pickle").read_bytes())
        COLUMNS.update(columns)
        TABLES.update(tables)
        return dict(made)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        names = [name for name in HALVES[self.half] if not name.startswith("write")]
        if metafunc.function.__name__.startswith("test_a_notebook"):
            names = [name for name in names if name in notebook_names()]
        if "name" in metafunc.fixturenames:
            metafunc.parametrize("name", names)

    def test_an_answer_is_the_former_one(self, name: str, now: dict[str, dict[str, Any]]) -> None:
        assert differences(former_answers()[name], now[name], name) == []

    def test_columns_of_its_csv_are_still_there(self, name: str, now: dict[str, dict[str, Any]]) -> None:
        """Those of the first release: `tests/test_stability.py`."""
        assert {*frozen("columns").get(name, ())} <= {*COLUMNS[name]}

    def test_files_of_its_folder_are_still_there(self, name: str, now: dict[str, Any], folder: Path) -> None:
        """Those of the first release, by name: `tests/test_stability.py`."""
        assert {*frozen("folders").get(name, ())} <= {*files_of(folder, name)}

    def test_a_page_says_what_the_command_says(self, name: str, now: dict[str, Any], folder: Path) -> None:
        """Every verdict of the tables for people, and of stderr, stands on the page; so does no better one."""
        made = report(folder / "answers" / f"{name}.json")
        [section] = made.rows()
        page = " ".join(re.sub("<[^>]+>", " ", html.unescape(made.html().decode())).split()).lower()
        texts = [text for t in TABLES[name] for text in (*t.notes, t.title, *(c for row in t.rows for c in row))]
        clauses = {part.strip(" .").lower() for text in texts for part in re.split(r"[;(),]|: |- ", text)}
        missing = [part for part in clauses - {*SAID_OTHERWISE} if VERDICT.search(part) and part not in page]
        assert missing == []
        assert (section["tone"] in ("doubt", "no-go")) == (now[name]["exit"] == 3)
        assert made.page.documents[0].provenance["untrusted"].lower() in page
        assert ("go" in section["answer"].lower().split()) <= (now[name]["exit"] == 0)

    def test_tables_fit_the_terminal(self, now: dict[str, Any]) -> None:
        """No line is wider than 80, 100 and 160 columns, and wider terminals show no fewer of them."""
        for name in HALVES[self.half]:
            shown = {width: render(TABLES[name], width) for width in (80, 100, 160)}
            for width, text in shown.items():
                assert [line for line in text.split("\n") if cell_len(line) > width] == [], name
            left_out = [text.count("more column") for text in shown.values()]
            assert left_out == sorted(left_out, reverse=True), name

    def test_a_notebook_gets_what_the_command_prints(
        self, name: str, now: dict[str, Any], folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """To the byte; and as a table, a picture and HTML."""
        monkeypatch.chdir(folder)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = NOTEBOOK[name]() if name in NOTEBOOK else in_python(COMMANDS[name])
        printed = json.loads(Path("answers", f"{name}.json").read_text("utf-8"))
        made = json.loads(found.to_json(time=False))
        for part in ("schema", "result"):
            assert to_json(made[part]) == to_json(printed[part])
        for part in ("inputs", "tables", "sources", "seed"):
            assert made["provenance"][part] == printed["provenance"][part]
        assert len(found.to_table()) == len(found.answers()) > 0
        assert "<table" in (html := found._repr_html_()) and "data:image/png" in html and len(html) < 400_000
        assert found.plot().axes


def record(names: list[str], why: str, made: dict[str, Any]) -> None:
    """Renew these answers in the table, and keep the reason there."""
    former = former_answers()
    changed = {name: made[name] for name in names or made if differences(former.get(name), made[name], name)}
    kept = {name: answer for name, answer in former.items() if name in made}
    reasons = json.loads(TABLE.read_text("utf-8")).get("why", {}) | dict.fromkeys(changed, why)
    table = {"answers": kept | changed, "why": reasons}
    TABLE.write_text(json.dumps(table, indent=0, sort_keys=True) + "\n", "utf-8")


def run() -> None:
    """Compare, or record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--why", help="what changed these numbers; the answers are then renewed")
    parser.add_argument("names", nargs="*", help="answers that are renewed; by default all that differ")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        made = answers(Path(folder), COMMANDS)
    if options.why:
        return record(options.names, options.why, made)
    former = former_answers()
    print("\n".join(text for name in made for text in differences(former.get(name), made[name], name)) or "as before")


if __name__ == "__main__":
    for library in ("OPENBLAS", "OMP", "MKL"):  # as in the tests: sums in threads round otherwise
        os.environ[f"{library}_NUM_THREADS"] = "1"
    run()
