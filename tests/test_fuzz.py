"""A few spoilt files for every reader; many, by `make fuzz`."""

import ast
import json
import random
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from cProfile import Profile
from dataclasses import replace
from datetime import date
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lunarsci

PROMISES = Path(__file__).parents[1] / "docs/promises.md"
LIBRARY = Path(lunarsci.__file__).parent
INPUTS, SECONDS, EXAMPLES = 12, 1.0, 25
KIND = re.compile(rb'"schema": "[^"]*"')
PICTURE = (
    b"<a><offset>0</offset><data_type>UnsignedByte</data_type><axis_array><axis_name>Line</axis_name><elements>24"
    b"</elements></axis_array><axis_array><axis_name>Sample</axis_name><elements>32</elements></axis_array></a>"
    b"\n--- next file ---\n" + bytes(range(256)) * 3
)
CRASHERS = {
    "modes": [b"# SYNTHETIC: comments alone\n"],
    "fitted rocks": [
        b'{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"id": "rock", "nbsr": {"um2": {"opx": 0.46, '
        b'"cpx": 0.54, "sigma": 0.03, "calibration": -1e308}}}]}}'
    ],
    "wavelengths": [b"s%n((((((((((" + b"a" * 5000],
    "spectra .csv": [b"9" * 80_000 + b"a,0.1\n"],
    "start of a fit": [b"9" * 80_000 + b"a\n"],
    "stations": [b"x_m,y_m,z_m,sigma_m\n0,0,0,0.01\n1,0," + b"9" * 140_000 + b",0.01\n"],
    "craters": [b"name,latitude_deg,longitude_deg,diameter_km\n" + b"a" * 140_000 + b",1,2,3\n"],
    "TOML": [b"a = " + b"9" * 5000],
    "keep-outs": [
        b'{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"name": "rock"}, '
        b'"geometry": {"type": "Polygon", "coordinates": [[[0, 0], [1e308, 0], [2, 1], [0, 0]]]}}]}'
    ],
    "track": [b"x_m,y m,rut_m " + b"9" * 80_000],
    "mask .npy": [
        b"\x93NUMPY\x01\x00\x16\x00{'descr': '<f8', 'shape'",
        b"\x93NUMPY\x01\x00\x3e\x00{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }  \n",
    ],
    "cube NetCDF 3": [b"CDF\x01" + b"\x00" * 40],
    "picture PDS4": [
        PICTURE.replace(b"32", b"0x10"),
        PICTURE.replace(b"<offset>0", b"<offset>9"),
        PICTURE.replace(b"24", b"9" * 12),
    ],
    "camera CAHVOR": [
        b"NS = 4\nNL = 4\nH = 1, " + b"9" * 2_000 + b" a\nC = 1 0 0\nA = 0 0 1\nV = 0 0 2\n",
        b"\n" * 100_000,
        b"NS = 4\nNL = 4\nC = 1 0 0\nA = 0 0 1\nH = 9 0 2\nV = 0 0 2\n",
        b"NS = 4\nNL = 4\nC = 1 0 0\nA = 0 0 1\nH = 9 0 2\nV = 0 1e999 2\n",
    ],
    "rig": [
        b'name = "x"\nassumed = 1.0\n',
        b'name = "x"\nbaseline_m = 0.3\nwidth_px = inf\nheight_px = 4\nfocal_px = 1.0\n',
    ],
    "mission": [b"leg_m = " + b"9" * 5000],
    "results": [
        b'{"schema": "lunarsci/spectra-fit/1", "provenance": {}, '
        b'"result": {"spectra": [{"id": "rock", "bands": [{}]}]}}'
    ],
}
"""What once broke the promise. SYNTHETIC."""


@pytest.fixture(scope="module")
def fuzz(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("fuzz")


class Prepared(NamedTuple):
    """The readers, their folders, in which they have read their seeds, and the functions that were called by that."""

    readers: dict[str, Any]
    folders: dict[str, Path]
    called: set[tuple[str, str]]


def one_of_each(reader: Any) -> Any:
    """With one result of each kind for a seed: tests of former answers make a page of each of them."""
    kinds = {(KIND.findall(seed) or [seed])[0]: seed for seed in reversed(reader.seeds)}
    return replace(reader, seeds=list(kinds.values()))


@pytest.fixture(scope="module")
def prepared(fuzz: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    readers, place = fuzz.readers(), tmp_path_factory.mktemp("readers")
    with Profile(builtins=False, subcalls=False) as calls:
        folders = {name: fuzz.prepare(one_of_each(reader), place / fuzz.slug(name)) for name, reader in readers.items()}
    codes = [one.code for one in calls.getstats() if not isinstance(one.code, str)]
    return Prepared(readers, folders, {(code.co_filename, code.co_name) for code in codes})


@pytest.mark.parametrize("inputs", [INPUTS, pytest.param(100, marks=pytest.mark.study)])
def test_every_reader_gives_a_result_or_a_line(inputs: int, fuzz: ModuleType, prepared: Prepared) -> None:
    broken = {}
    for name, reader in prepared.readers.items():
        folder = prepared.folders[name]
        for seed in reader.seeds[:1]:
            assert fuzz.tried(reader, folder, seed) == ("read", ""), name
        found = fuzz.tries(reader, inputs, 7, folder, seconds=max(SECONDS, inputs / 60))
        assert found.refusals or found.inputs < inputs, name
        broken |= {f"{name}: {what}": data[:200] for what, data in found.broken.items()}
    assert broken == {}


def test_every_file_of_a_command_comes_to_a_reader_that_is_tried(fuzz: ModuleType) -> None:
    """A parameter that is new, takes a text and is not declared fails here; so does a reader that no command has."""
    table = sys.modules["fuzz_readers"]
    parameters = {name: table.readers_of(name, metavar) for name, metavar in table.path_parameters()}
    assert len(parameters) > 300
    undeclared = [name for name, found in parameters.items() if found is None]
    assert undeclared == [], (
        "say in KINDS of lunarsci/registry.py which files they are, or in READ_BY, READ_BY_COMMAND or NO_FILE of "
        "tests/benchmarks/fuzz_readers.py"
    )
    reached = {reader for found in parameters.values() for reader in found or ()}
    assert reached == set(fuzz.readers())
    assert f"for the {len(reached)} readers that are tried" in PROMISES.read_text("utf-8")
    last = {name.rpartition(" ")[2] for name in parameters}
    assert {*table.READ_BY, *table.READ_BY_COMMAND, *table.NO_FILE} <= last | parameters.keys()


def test_every_function_that_is_given_a_file_is_tried(prepared: Prepared) -> None:
    """Those of the library with an `InputFile` among their arguments, but for jobs, which hand it on to them."""
    given = {
        (str(path), function.name)
        for path in LIBRARY.rglob("*.py")
        if "jobs" not in path.parts and "InputFile" in (text := path.read_text("utf-8"))
        for function in ast.walk(ast.parse(text))
        if isinstance(function, ast.FunctionDef)
        and any(one.annotation and "InputFile" in ast.unparse(one.annotation) for one in function.args.args)
    }
    assert len(given) > 80
    assert "\n".join(map(str, sorted(given - prepared.called))) == ""


# --- files of the right form, whatever they say ---

NUMBERS = st.one_of(
    st.floats(), st.integers(-3, 400), st.sampled_from([0, -0.0, 10**30, 10**400, -(2**63), 5e-324, 1e308])
)
SCALARS = NUMBERS | st.booleans() | st.text(max_size=8) | st.dates() | st.datetimes()
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=2),
    max_leaves=4,
)
CELLS = st.one_of(
    NUMBERS.map(str),
    st.sampled_from(["", "nan", "-", "inf", "true", "x", '"a,b"', "1,5", "1e999", "0x10", "1_0", "٣", "FL", "9" * 400]),
)
TYPES = st.sampled_from(
    ["float64", "float16", "int64", "uint8", "bool", "string", "complex128", "object", "datetime64"]
)
FORMS = {
    "toml": ["plan", "rover", "wheel", "mission", "soil", "prior", "pose", "rig", "camera", "any settings"],
    "csv": ["states", "record", "positions", "stations", "motion", "track", "craters", "modes", "samples", "sunlight",
            "soil samples", "channel factors", "phase function", "telemetry .csv", "terrain .csv", "spectra .csv"],
    "ecsv": ["spectra .ecsv", "library", "telemetry .ecsv"],
}  # fmt: skip
"""Readers of text, by the grammar of what they are given."""


def toml(value: Any) -> str:
    """A value as TOML writes it, tables within a line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(str(key))} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "")
    return value.isoformat() if isinstance(value, date) else str(value).lower()


def tables_in(value: Any) -> Iterator[dict[str, Any]]:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if isinstance(value, dict) and value:
        yield value
    for one in inner:
        yield from tables_in(one)


@st.composite
def settings_like(draw: st.DrawFn, seed: bytes) -> bytes:
    """The document with other values, without some keys, or with more, in any of its tables."""
    document = tomllib.loads(seed.decode())
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(list(tables_in(document)) or [document]))
        key = draw(st.sampled_from([*place, "new"]))
        what = draw(st.sampled_from(("number", "number", "value", "gone", "list")))
        if what == "gone":
            place.pop(key, None)
        else:
            place[key] = (
                [place.get(key)] if what == "list" and key in place else draw(NUMBERS if what[0] == "n" else VALUES)
            )
    return "".join(f"{toml(key)} = {toml(value)}\n" for key, value in document.items()).encode()


@st.composite
def table_like(draw: st.DrawFn, seed: bytes) -> bytes:
    """The table with other cells, its columns in another order, some twice or missing, each row as long as the header.

    Of ECSV also with other types of its columns.
    """
    lines = seed.decode().splitlines()
    told = [line for line in lines if line.startswith("#")]
    if told and "ECSV" in told[0]:
        told = [re.sub(r"datatype: \w+", f"datatype: {draw(TYPES)}", line) if draw(st.integers(0, 3)) == 0 else line
                for line in told]  # fmt: skip
    gap = " " if told and "delimiter" not in seed.decode() and "," not in lines[len(told)] else ","
    rows = [line.split(gap) for line in lines if not line.startswith("#")]
    places = range(len(rows[0]))
    order = draw(st.just(places) | st.permutations(places) | st.lists(st.sampled_from(places), min_size=1, max_size=12))
    table = [[row[k] for k in order if k < len(row)] for row in rows]
    for _ in range(draw(st.integers(0, 4))):
        row = draw(st.sampled_from(table))
        if row:
            row[draw(st.integers(0, len(row) - 1))] = draw(CELLS).replace(" ", "")
    return "\n".join([*told, *(gap.join(row) for row in table), ""]).encode()


@pytest.mark.parametrize("form", FORMS)
def test_whatever_a_file_of_the_right_form_says(form: str, fuzz: ModuleType, prepared: Prepared) -> None:
    """What a mutation of bytes seldom gives: a document that parses, and says something else."""
    like = settings_like if form == "toml" else table_like
    ends: Counter[str] = Counter()

    def check(name: str, data: bytes) -> None:
        end, said = fuzz.tried(prepared.readers[name], prepared.folders[name], data)
        ends[end] += 1
        assert end != "broken", said

    for name in FORMS[form]:
        files = st.sampled_from(prepared.readers[name].seeds).flatmap(like)
        tried = settings(max_examples=EXAMPLES, deadline=None, derandomize=True, database=None)
        tried(given(st.just(name), files)(check))()
    assert min(ends["read"], ends["refused"]) > 0.05 * ends.total()


def test_what_once_broke_it(fuzz: ModuleType, tmp_path: Path) -> None:
    readers = fuzz.readers()
    for name, files in CRASHERS.items():
        folder = fuzz.prepare(replace(readers[name], seeds=[]), tmp_path / fuzz.slug(name))
        for data in files:
            assert fuzz.tried(readers[name], folder, data)[0] == "refused", (name, data[:80])


def test_what_breaks_the_promise_is_seen(fuzz: ModuleType, tmp_path: Path) -> None:
    """Readers that fail on purpose, each in a way of its own."""

    def foreign(path: Path) -> None:
        raise KeyError(path.name)

    def endless(path: Path) -> None:
        while path:
            pass

    fuzz.SLOWEST_S = 0.2
    for read, said in ((foreign, "KeyError"), (endless, "slower")):
        found = fuzz.tries(fuzz.Reader(read, ["spoilt.txt"], [b"1 2 3"]), 1, 1, tmp_path)
        assert [what for what in found.broken if said in what], said


def test_a_process_that_dies_is_a_promise_broken(fuzz: ModuleType, tmp_path: Path) -> None:
    fuzz.run("no such reader", 1, 1.0, 1, tmp_path)
    [what] = fuzz.summed("no such reader", tmp_path).broken
    assert what.startswith("the process ended with 1")


def test_an_input_of_several_files_may_lack_one(fuzz: ModuleType, tmp_path: Path) -> None:
    reader = fuzz.Reader(lambda path: None, ["a.hdr", "a.img"], [])
    fuzz.write(reader, tmp_path, b"head" + fuzz.BETWEEN + b"data")
    assert [(tmp_path / name).read_bytes() for name in reader.names] == [b"head", b"data"]
    fuzz.write(reader, tmp_path, b"head alone")
    assert [file.name for file in tmp_path.iterdir()] == ["a.hdr"]


def test_mutations_change_files(fuzz: ModuleType) -> None:
    draw = random.Random(1)
    sound = b"wavelength_nm,reflectance\n500,0.1\n510,0.2\n"
    made = {fuzz.mutated(sound, draw) for _ in range(500)}
    assert len(made) > 350
    assert any(len(data) > 2000 for data in made)
