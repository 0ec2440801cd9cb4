"""What Python holds in memory, given to jobs in every natural form."""

import copy
import importlib
import inspect
import io
import json
import os
import pickle
import re
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from astropy.table import QTable

import lunarsci
from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.io.inputs import read_input
from lunarsci.memory import as_named, content_of, named_within, on_disk, toml_text
from lunarsci.options import in_python
from lunarsci.regolith.soil import read_soil
from lunarsci.result import Doubt, Result
from lunarsci.twin.ground.terrain import read_terrain

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
X, Y = np.arange(-2.0, 4.0, 0.2), np.arange(-2.0, 2.0, 0.2)
Z = 0.05 * np.sin(X / 1.5) * np.cos(Y / 2)[:, None]
PLAN = {"name": "first", "drive": {"speed_m_s": 0.05}, "leg": [{"length_m": 0.5}]}
WAVELENGTH = np.arange(500.0, 2500.0, 10.0)
ROCK = 0.3 * (1 - 0.3 * np.exp(-(((WAVELENGTH - 950) / 90) ** 2)) - 0.2 * np.exp(-(((WAVELENGTH - 1950) / 200) ** 2)))
CUBE = ROCK * np.linspace(0.8, 1.2, 12).reshape(3, 4, 1)


def archive() -> io.BytesIO:
    made = io.BytesIO()
    np.savez(made, x_m=X, y_m=Y, height_m=Z)
    return made


GROUNDS: Mapping[str, Callable[[], Any]] = {
    "tuple": lambda: (X, Y, Z),
    "lists": lambda: [X.tolist(), Y.tolist(), Z.tolist()],
    "dict": lambda: {"x": X, "y": Y, "z": Z},
    "DataArray": lambda: xr.DataArray(Z, dims=("y", "x"), coords={"x": X, "y": Y}),
    "Dataset": lambda: xr.Dataset({"height_m": (("y_m", "x_m"), Z)}, coords={"x_m": X, "y_m": Y}),
    "nodes": lambda: pd.DataFrame({"x_m": np.tile(X, Y.size), "y_m": np.repeat(Y, X.size), "height_m": Z.ravel()}),
    "written to its end": archive,
    "bytes": lambda: archive().getvalue(),
}


@pytest.mark.parametrize("form", GROUNDS)
def test_a_terrain_in_memory_is_that_of_its_file(form: str) -> None:
    ground = read_terrain(on_disk("terrain", GROUNDS[form]()), read_soil("longji"))
    assert ground.height_m == pytest.approx(Z) and ground.x_m == pytest.approx(X) and ground.y_m == pytest.approx(Y)


def test_a_path_is_planned_on_an_array_and_driven() -> None:
    """The result is the plan, the terrain, or what its Dataset says; texts name no temporary folder."""
    way = lunarsci.plan(GROUNDS["DataArray"](), target=np.array([2.0, 0.3]))
    drives = [
        lunarsci.predict(plan, terrain=ground, members=1, soil="priors")
        for plan, ground in (
            (way, way),
            (way.files()["plan.toml"](), (X, Y, Z)),
            (way, way.to_xarray()),
        )
    ]
    ends = [drive.to_dict()["endpoint"]["x_m"] for drive in drives]
    assert ends == pytest.approx([2.0] * 3, abs=0.3) and np.ptp(ends) < 1e-6
    texts = [drives[0].to_json(), str(drives[0]), repr(drives[0])]
    for text in (*texts, str(drives[0].to_dict()), str(drives[0].made_from), str(drives[0].asked)):
        assert "/lunarsci-" not in text
    assert "plan.toml" in drives[0].made_from.inputs
    assert "twin-terrain/plan.toml" not in str(drives[0]) and '"plan.toml"' in drives[0].to_json()
    with pytest.raises(ParameterError, match="`plan`: the result has not one plan") as caught:
        lunarsci.predict(SimpleSurvey())
    assert "/lunarsci-" not in str(caught.value)
    with pytest.raises(ParameterError, match="`terrain` is of ndarray, which cannot be read; give a path"):
        lunarsci.plan(Z, target=(1, 0))


class SimpleSurvey:
    """A survey without a path, as the job sees it."""

    schema = "twin-terrain/1"

    def as_input(self, role: str) -> Any:
        survey = importlib.import_module("lunarsci.twin.jobs.terrain").TerrainSurvey
        return survey.as_input(SimpleNamespace(files=lambda: {"terrain.npz": bytes}), role)


@pytest.mark.parametrize("gravity", [9.81, "9.81", "mars"])
def test_gravity_is_a_name_or_a_number(gravity: Any) -> None:
    expected = 3.71 if gravity == "mars" else 9.81
    found = lunarsci.predict(toml_text(PLAN).encode(), gravity=gravity, members=1, soil="priors")
    assert found.to_dict()["gravity_m_s2"] == pytest.approx(expected, abs=0.02)
    found = lunarsci.wheel_forces(sinkage=0.01, slip=0.1, gravity=gravity)
    assert found.asked is not None and found.asked.options["gravity"] == pytest.approx(expected, abs=0.02)
    with pytest.raises(RequestError, match="`gravity` is 'jupiter'"):
        lunarsci.wheel_forces(sinkage=0.01, slip=0.1, gravity="jupiter")


WHEEL = {"name": "rig", "wheel": {"radius_m": 0.15735, "width_m": 0.165}}
STATES = pd.DataFrame({
    "load_N": 80.0, "pull_N": [-6.5, 11, 14.5, 15, 15, 15], "sinkage_m": [0.005, 0.0055, 0.0075, 0.01, 0.0125, 0.0175],
    "slip": [0, 0.1, 0.2, 0.3, 0.4, 0.6],
})  # fmt: skip


def test_rover_prior_and_posterior_stay_in_memory() -> None:
    prior = {"friction_angle_deg": {"of": "ln tan", "median": 35.0, "sd": 0.1}}
    given: list[tuple[Any, Any]] = [(WHEEL, prior), (io.StringIO(toml_text(WHEEL)), toml_text(prior).encode())]
    soils = [lunarsci.infer(STATES, rover=rover, gravity="earth", law="given", prior=one) for rover, one in given]
    assert soils[0] == soils[1]
    assert soils[0]["friction_angle_deg"]["median"] == pytest.approx(35, abs=4)
    draws = pd.read_csv(io.BytesIO(soils[0].soils()), comment="#").iloc[:2]
    for soil, kind in ((soils[0], "belief"), ([soils[0]], "belief"), (draws, "samples"), ((draws,), "samples")):
        found = lunarsci.predict(PLAN, soil=soil, members=2).to_dict()
        assert found["soil"]["of"] == kind and found["members"] == 2
    text = " ".join(str(lunarsci.predict(PLAN, soil=draws)).split())
    assert "soil: of each drive a row of soil.csv" in text
    text = " ".join(str(lunarsci.predict(PLAN, soil=soils[0], members=2)).split())
    assert (
        "for the wheel 'rig; wheels 157.35 x 165 mm', and this is 'yutu2; wheels 150 x 150 mm'; for a gravity of 9.81"
        in text
    )
    same = lunarsci.infer(STATES, rover="yutu2", law="given")
    assert "was inferred for" not in str(lunarsci.predict(PLAN, soil=same, members=2))
    with pytest.raises(DataError, match="no column drawbar_pull_n; there are: load_N"):
        lunarsci.infer(STATES.drop(columns="pull_N"), rover=WHEEL)
    with pytest.raises(RequestError, match=r"`soil` is .* give one text or input, or several in a list"):
        lunarsci.predict(PLAN, soil=5)


@dataclass(frozen=True, eq=False)
class OfRoles(Result):
    """A result that is a file for `terrain`, and a folder for `predicted`."""

    schema = "of-roles/1"

    @property
    def doubt(self) -> Doubt:
        return Doubt.of("/tmp/lunarsci-slla84jr/tmp36n04av1/soil/soil.json is odd; give another by --soil")

    def to_dict(self) -> dict[str, Any]:
        return {}

    def rows(self) -> list[Any]:
        return []

    def as_input(self, role: str) -> Mapping[str, Callable[[], bytes]]:
        one, two = {"a.csv": lambda: b"a"}, {"a.csv": lambda: b"a", "b.csv": lambda: b"b"}
        return {"terrain": one, "predicted": two}.get(role, {})


def test_a_result_is_the_file_that_an_input_is_read_from() -> None:
    assert as_named(on_disk("terrain", OfRoles())) == "a.csv"
    assert OfRoles().untrusted == "soil.json is odd; give another by soil"
    folder = Path(on_disk("predicted", OfRoles()))
    assert folder.name == "of-roles" and sorted(one.name for one in folder.iterdir()) == ["a.csv", "b.csv"]
    assert [Path(one).read_text() for one in on_disk("terrain", [OfRoles()] * 2)] == ["a", "a"]
    with pytest.raises(ParameterError, match="`soil`: a OfRoles holds nothing that it could be read from; give a path"):
        on_disk("soil", OfRoles())
    with pytest.raises(ParameterError, match="OfRoles cannot be read; give a path"):
        lunarsci.identify(OfRoles(), rover="yutu2")


@pytest.mark.parametrize(
    ("role", "name"), [("positions", "positions.csv"), ("start", "motion.csv"), ("states", "states.csv")]
)
def test_states_are_what_the_next_step_asks_for(role: str, name: str) -> None:
    measured = importlib.import_module("lunarsci.twin.jobs.states").MeasuredStates
    files = {one: one.encode for one in ("states.csv", "positions.csv", "motion.csv")}
    made = measured.as_input(SimpleNamespace(files=lambda: files), role)
    assert {one: make() for one, make in made.items()} == {name: name.encode()}


def test_any_table_is_read() -> None:
    rows = [{"a": 1, "b": "x"}, {"a": 2, "b": "y"}]
    forms = [
        rows,
        {"a": [1, 2], "b": ["x", "y"]},
        pd.DataFrame(rows),
        QTable(rows),
        pd.DataFrame(rows).to_records(index=False),
    ]
    for form in forms:
        lines = [line for line in read_input(form).data.decode().splitlines() if not line.startswith("#")]
        assert lines == ["a,b", "1,x", "2,y"]
    with pytest.raises(DataError, match=r"columns are \[1, 2\] long"):
        read_input({"a": [1], "b": [1, 2]})


@pytest.mark.parametrize("first", ["# made up by a program, not a measurement", "# made up"])
def test_a_comment_that_pandas_took_for_the_header_is_one(first: str) -> None:
    text = f"{first}\ntime_s,x_m,wheel\n0.10,1.5,FL\n0.2,2,FR\n"
    assert read_input(pd.read_csv(io.StringIO(text))).data.decode() == text


def test_a_dict_is_toml_or_json() -> None:
    table = {"name": 'µ "q"', "on": True, "n": np.float64(0.5), "t": {"a b": [1, [2]]}, "none": None}
    assert tomllib.loads(toml_text(table)) == {"name": 'µ "q"', "on": True, "n": 0.5, "t": {"a b": [1, [2]]}}
    assert content_of({"type": "FeatureCollection", "features": []}) == (
        b'{"type": "FeatureCollection", "features": []}',
        ".json",
    )
    assert content_of({"leg": []}) == (b"leg = []\n", ".toml")
    line = {"type": "LineString", "coordinates": [[0, 1], [2, 3]]}
    assert content_of(line) == (json.dumps(line).encode(), ".json")


def test_a_file_that_was_read_is_read_again() -> None:
    file = io.StringIO("a\n1\n")
    assert read_input(file).data == read_input(file).data == b"a\n1\n"


@pytest.mark.parametrize("form", ["DataArray", "Dataset", "band", "arrays"])
def test_a_cube_in_memory_has_maps_and_spectra_with_their_places(form: str) -> None:
    axes = {"wavelength": WAVELENGTH, "y": [10, 20, 30], "x": [0, 1, 2, 3]}
    array = xr.DataArray(CUBE, dims=("y", "x", "wavelength"), coords=axes, name="reflectance")
    named = {"DataArray": array, "Dataset": array.to_dataset(), "band": array.rename(wavelength="band")}
    cube = (WAVELENGTH, CUBE) if form == "arrays" else named[form]
    maps = lunarsci.map_cube(cube, products="bands")
    assert maps.to_xarray()["bc1000_nm"].to_numpy() == pytest.approx(np.full((3, 4), 950.0), abs=2.0)
    bare = lunarsci.map_cube(
        array.drop_vars("wavelength").rename(wavelength="band"), wavelengths=WAVELENGTH, products="bands"
    )
    assert (bare.to_xarray()["bc1000_nm"].to_numpy() == maps.to_xarray()["bc1000_nm"].to_numpy()).all()
    assert maps == lunarsci.map_cube(cube, products="bands") and "/lunarsci-" not in str(maps)
    assert maps.plot("centre of the 1000") and maps.plot("Centre")
    names = lunarsci.bands(cube).to_pandas()["id"].tolist()
    assert names[:2] == (["line 0 sample 0", "line 0 sample 1"] if form == "arrays" else ["y 10 x 0", "y 10 x 1"])
    assert len(names) == 12


def test_spectra_in_rows_keep_the_names_of_the_index() -> None:
    frame = pd.DataFrame([ROCK, 1.1 * ROCK], index=["a", "b"], columns=WAVELENGTH)
    assert lunarsci.bands(frame).to_pandas()["id"].tolist() == ["a", "b"]


SERIES = pd.Series(ROCK, name="rock1")
INDEXED = pd.Series(ROCK, index=WAVELENGTH)


@pytest.mark.parametrize(("given", "names"), [
    ((WAVELENGTH, pd.DataFrame({"a": ROCK, "b": 1.1 * ROCK})), ["a", "b"]),
    ((WAVELENGTH, pd.DataFrame([ROCK, 1.1 * ROCK], index=["c", "d"])), ["c", "d"]),
    ((WAVELENGTH, SERIES), ["rock1"]),
    (([(WAVELENGTH, SERIES), (WAVELENGTH, SERIES.rename("q")), (WAVELENGTH, SERIES)],), ["rock1", "q", "spectrum 3"]),
    ((WAVELENGTH, SERIES.rename("reflectance")), ["spectrum 1"]),
    ((INDEXED,), ["spectrum 1"]),
    ((INDEXED.set_axis(WAVELENGTH.astype(int)).rename("s")[::-1],), ["s"]),
    ((INDEXED.to_frame("t"),), ["t"]),
])  # fmt: skip
def test_spectra_of_pandas_have_their_names_and_wavelengths_in_nm(given: Any, names: list[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lunarsci.bands(*given)
    assert found.to_pandas()["id"].tolist() == names and found[0]["bc1000_nm"] == pytest.approx(950, abs=3)
    assert len(found.made_from.inputs) >= (1 if len(given) == 1 and not isinstance(given[0], list) else len(names))


def test_many_columns_by_wavelength_warn_of_nothing() -> None:
    frame = pd.DataFrame(index=pd.Index(WAVELENGTH, name="wavelength_nm"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pd.errors.PerformanceWarning)
        for k in range(120):
            frame[f"s{k}"] = ROCK
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(lunarsci.bands(frame)) == 120


def test_the_spectra_of_a_cube_are_two_arrays_and_no_other_form_is_named() -> None:
    assert lunarsci.map_cube(WAVELENGTH, CUBE, products="bands") == lunarsci.map_cube(
        (WAVELENGTH, CUBE), products="bands"
    )
    with pytest.raises(ParameterError, match=r"or \(wavelength_nm, reflectance of three dimensions\)"):
        lunarsci.map_cube(CUBE)


def test_options_of_a_match_are_numbers_as_python_has_them() -> None:
    found, text = (
        lunarsci.match(modes=one) for one in ({"ol": (0.25, 0.05), "opx": (0.5, 0.1)}, "ol=0.25:0.05,opx=0.5:0.1")
    )
    assert found == text
    sites = [lunarsci.match(modes="ol=0.25:0.05,opx=0.5:0.1", site=one) for one in ((-45.4, 177.5), "-45.4,177.5")]
    assert sites[0] == sites[1]
    with pytest.raises(lunarsci.errors.LunarSciError, match=r"`request` is of str, .* several inputs in a list"):
        lunarsci.match(found, "rock")
    bands = lunarsci.bands((WAVELENGTH, ROCK))
    assert [*lunarsci.match(json.loads(bands.to_json())).rows()] == [*lunarsci.match(bands).rows()]
    with pytest.raises(ParameterError, match=r"Matches is no grid; to_pandas\(\) has its table$"):
        found.to_xarray()


def test_swapped_arrays_are_read_as_they_are_meant() -> None:
    with pytest.warns(LunarSciWarning, match=r"read as \(reflectance, wavelength\)"):
        found = lunarsci.bands((np.round(ROCK, 3), WAVELENGTH))
    assert found[0]["bc1000_nm"] == pytest.approx(950, abs=3)
    frame = pd.DataFrame({"a": np.round(ROCK, 3), "b": np.round(1.1 * ROCK, 3)})
    with pytest.raises(DataError, match="'a' is in no order: is it the wavelength"), pytest.warns(LunarSciWarning):
        lunarsci.bands(frame)


def test_results_have_rows_by_name_and_compare_by_what_they_say() -> None:
    lab = pd.DataFrame({"a": ROCK, "b": 1.1 * ROCK}, index=WAVELENGTH)
    found = lunarsci.bands(lab)
    assert found["b"] == found[1] == found[-1]
    with pytest.raises(KeyError, match="no row is called 'c'; there are a, b"):
        found["c"]
    with pytest.raises(IndexError, match="row 7: there are 2"):
        found[7]
    assert found == pickle.loads(pickle.dumps(found)) == copy.deepcopy(found) == lunarsci.bands(lab)
    assert found != lunarsci.bands(1.01 * lab) and len({found, copy.deepcopy(found)}) == 1
    with pytest.raises(DataError, match=r"predicted\.toml: no folder; give .* the result of `predict`"):
        lunarsci.compare({"bc1000_nm": 3}, STATES)


def test_a_pickled_result_has_its_text_in_another_process() -> None:
    drives = lunarsci.predict(PLAN, terrain=(X, Y, Z), members=1, soil="priors")
    code = "import pickle, sys; print(pickle.load(sys.stdin.buffer).to_text())"
    done = subprocess.run([sys.executable, "-c", code], input=pickle.dumps(drives), capture_output=True, check=True)
    assert "\ntilt_deg " in done.stdout.decode() and "/lunarsci-" not in done.stdout.decode()
    earlier = "drives of /tmp/lunarsci-slla84jr/tmp36n04av1/twin-predict on /a b/lunarsci-demo/rock.ecsv"
    alike = {f"/tmp/lunarsci-slla84jr/tmp36n04av{k}/terrain/terrain.npz": k for k in range(3)}
    assert named_within(alike) == {"terrain.npz": 0, "terrain/terrain.npz": 1, "terrain.npz 2": 2}
    assert as_named(earlier) == "drives of twin-predict on /a b/lunarsci-demo/rock.ecsv"


def test_a_figure_shows_itself_and_many_rows_are_cut() -> None:
    found = lunarsci.bands((WAVELENGTH, CUBE))
    figure = found.plot()
    assert figure._repr_png_().startswith(b"\x89PNG") and pickle.loads(pickle.dumps(figure)) is not None  # type: ignore[attr-defined]
    found = lunarsci.wheel_forces(load=36.5, slip="0:0.5:90")
    assert "71 more rows" in str(found) and "to_text()" in str(found) and len(str(found).splitlines()) <= 24
    assert len(found.to_text().splitlines()) > 90


def test_texts_name_what_python_has() -> None:
    meant = {
        "with --assemblage auto, --csv or --json": 'with assemblage="auto", to_pandas() or to_dict()',
        "on one soil: --soil priors --members 64": 'on one soil: soil="priors" members=64',
        "with -o DIR, and `twin plan -o DIR --risk 1`": "with files(), and `twin plan -o DIR --risk 1`",
        "bands of --start-file; a -- b": "bands of start; a -- b",
    }
    assert {text: in_python(text) for text in meant} == meant
    shown = [
        str(lunarsci.fit((WAVELENGTH, ROCK), starts=1)),
        *(str(getattr(lunarsci, one).__doc__) for one in ("fit", "plan")),
    ]
    assert [re.findall("(?<!-)--[a-z]", text) for text in shown] == [[], [], []]


@pytest.mark.parametrize(("job", "name", "kind"), [
    ("plan", "terrain", "Ground"), ("compare", "predicted", "AsFiles"), ("update", "states", "AsFiles"),
    ("fit", "spectra", "Series"),
])  # fmt: skip
def test_type_checkers_take_what_is_taken(job: str, name: str, kind: str) -> None:
    hint = str(inspect.signature(getattr(lunarsci, job)).parameters[name].annotation)
    aliases = importlib.import_module("lunarsci.spectra.readers.batch")
    assert kind in hint.replace("SpectraSource", f"{aliases.SpectraSource} {aliases.OneSource} {aliases.Source}")


def test_the_doctor_tries_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    doctor = importlib.import_module("lunarsci.guide.doctor")
    assert not doctor._extra("cubes").trouble and doctor._extra("cubes").observed == "works"

    def without_h5py(name: str) -> Any:
        if name == "h5py":
            raise ImportError("No module named 'h5py'")

    monkeypatch.setattr(doctor, "import_module", without_h5py)
    assert "pip install 'lunarsci[cubes]'" in doctor._extra("cubes").trouble
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert any(one.startswith("h5py") for one in extras["cubes"])


def test_without_anything_in_memory_nothing_lies_on_the_disk(tmp_path: Path) -> None:
    """Neither the import of the jobs nor a text of theirs makes a folder for it."""
    code = "import lunarsci, os; lunarsci.bands, lunarsci.predict; print(os.listdir(os.environ['TMPDIR']))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"TMPDIR": str(tmp_path)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout == "[]\n"
