"""Wrong turns of people who write shell scripts: what was meant is done, or the message says the way that works."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import read_belief
from lunarsci.twin.ground.driven_soil import OF_A_BELIEF

GRID = "ncols 41\nnrows 41\nxllcorner -1\nyllcorner -1\ncellsize 0.1\n" + "\n".join(["0 " * 41] * 41) + "\n"
PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.6\n"


@pytest.fixture
def at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, driven_states: bytes) -> Path:
    """A folder to work in, with states of a drive, a plan and a terrain."""
    (tmp_path / "states.csv").write_bytes(driven_states)
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "site.asc").write_text(GRID)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_infer_writes_is_a_soil_to_drive_on(run, at: Path) -> None:
    """The same as its belief, but about the medians; its doubt goes with it."""
    infer = ("regolith", "infer", "states.csv", "--law", "given", "-q")
    assert run(*infer, "-o", "soil.json", "--posterior", "belief.json").code == 0
    assert "lunarsci twin predict --soil" in run("info", "soil.json").out
    of = ("info", "soil.json", "--field", "result.joint.parameters")
    parameters = json.loads(run(*of).out)
    quoted = {name: run(*of[:-1], f"{of[-1]}.{name}.median").code for name in parameters}
    assert quoted == {name: 0 if one["determined"] else 3 for name, one in parameters.items()}
    assert {0, 3} == set(quoted.values())
    made, saved = (read_belief(read_input(name)) for name in ("soil.json", "belief.json"))
    assert np.allclose(made.covariance, saved.covariance, rtol=1e-9, atol=1e-15)
    assert (np.abs(made.mean - saved.mean) < 0.2 * saved.sd).all() and made.verdict == saved.verdict
    drive = ("twin", "predict", "plan.toml", "--soil", "soil.json", "--members", "3", "-q", "--json")
    result = json.loads(run(*drive).out)["result"]
    assert result["members"] == 3 and result["soil"]["of"] == "belief" and result["doubt"] is None
    document = json.loads(Path("soil.json").read_text())
    document["provenance"]["untrusted"] = "the load's unit is open"
    Path("soil.json").write_text(json.dumps(document))
    done = run(*drive)
    assert done.code == 3 and "the load's unit is open" in json.loads(done.out)["result"]["doubt"]


def test_what_identify_writes_is_none_and_says_what_is(run, at: Path) -> None:
    assert run("regolith", "identify", "states.csv", "-q", "-o", "soil.json").code in (0, 3)
    done = run("twin", "predict", "plan.toml", "--soil", "soil.json", "-q")
    assert done.code == 1 and "lunarsci regolith infer STATES.csv -o soil.json" in done.err[-1]


def test_of_the_draws_of_a_fit_as_many_are_driven_on_as_of_a_belief(run, at: Path) -> None:
    assert run("regolith", "infer", "states.csv", "--law", "given", "-q", "--posterior", "soils.csv").code == 0
    done = run("twin", "predict", "plan.toml", "--soil", "soils.csv", "--json", "-q")
    result = json.loads(done.out)["result"]
    assert result["members"] == OF_A_BELIEF and result["soil"]["of"] == "samples"
    assert json.loads(done.out)["provenance"]["seed"] == 0
    assert "64 of the 4000 of soils.csv; --members" in run("twin", "predict", "plan.toml", "--soil", "soils.csv").out
    rows = pd.read_csv("soils.csv", comment="#").head(70)
    rows.to_csv("mine.csv", index=False)  # without a fit's verdict each row is a soil that somebody chose
    assert (
        json.loads(run("twin", "predict", "plan.toml", "--soil", "mine.csv", "--json").out)["result"]["members"] == 70
    )


@pytest.mark.parametrize("name", ["-", "/dev/stdout"])
def test_stdout_by_its_names_is_stdout(run, at: Path, name: str) -> None:
    line = ("regolith", "forces", "--load", "20", "--slip", "0.2", "--csv", "-q")
    assert run(*line, "-o", name).out == run(*line).out != ""
    assert run("twin", "predict", "plan.toml", "-q", "-o", name).out.startswith(("GO", "NO-GO", "NOT"))
    done = run("regolith", "forces", "--load", "20", "--slip", "0:0.5:5", "--plot", name)
    assert done.code == 2 and "--plot" in done.err[0] and "name of a file" in done.err[0]
    assert run("demo", "-o", name).code == 2
    assert not (at / "-").exists()


@pytest.mark.parametrize("line", ["twin predict --help", "regolith forces --load 20 --slip 0:0.5:400 --csv -q"])
def test_a_closed_pipe_ends_as_in_other_programs(program: Path, line: str) -> None:
    """`yes | head -1` ends `yes` with 141 in a shell's pipefail: 128 and the number of SIGPIPE."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as closed:
        done = subprocess.run([program / "lunarsci", *line.split()], stdout=closed, stderr=subprocess.PIPE)
    assert done.returncode == 141 and done.stderr == b""


def test_gravity_is_named_alike_in_all_commands(run, at: Path) -> None:
    line = (
        "regolith",
        "forces",
        "--load",
        "20",
        "--slip",
        "0.2",
        "--side-slip",
        "5",
        "--exact",
        "--bulldozing",
        "wong",
    )
    named, number, moon = (
        run(*line, "--gravity", one, "--field", "lateral_force_n").out for one in ("earth", "9.80665", "moon")
    )
    assert named == number != moon
    done = run("regolith", "infer", "states.csv", "--gravity", "venus")
    assert done.code == 2 and "--gravity is 'venus'; give moon, mars, earth, or m/s2" in done.err[0]


def test_info_of_a_folder_is_what_its_files_are(run, at: Path) -> None:
    done = run("info", at, "--json", "-q")
    assert done.code == 0
    result = json.loads(done.out)["result"]
    assert result["kind"] == "folder"
    assert result["contents"] == {"plan": "1: plan.toml", "states": "1: states.csv", "terrain": "1: site.asc"}
    (at / "one").mkdir()
    (at / "one/p.toml").write_text(PLAN)
    assert "lunarsci twin predict" in run("info", "one").out
    (at / "empty").mkdir()
    assert run("info", "empty").code == 4


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        (
            "twin predict site.asc",
            "kind of file (heights on a grid): `lunarsci twin predict --terrain site.asc`",
        ),
        ("twin predict --terrain plan.toml", "(plan of a drive): `lunarsci twin predict plan.toml`"),
        ("regolith infer plan.toml", "(plan of a drive): `lunarsci twin predict plan.toml`"),
        ("twin predict --terrain -", "heights are not read from stdin; give a file"),
    ],
)
def test_a_file_in_the_wrong_place_is_told_its_place(run, at: Path, line: str, hint: str) -> None:
    done = run(*line.split())
    assert done.code == 1 and hint in done.err[-1]


def test_a_broken_file_in_its_place_is_told_nothing_of_places(run, at: Path) -> None:
    Path("site.asc").write_text(GRID[:-100])
    Path("plan.toml").write_text(PLAN.replace("0.05", "fast"))
    for line in ("twin predict --terrain site.asc", "twin predict plan.toml"):
        done = run(*line.split())
        assert done.code == 1 and "another kind" not in done.err[-1]


def test_missing_columns_are_listed_as_the_file_names_them(run, at: Path) -> None:
    Path("rig.csv").write_text("run,load_N,slip [%],pull_N\n1,24.5,10,8.1\n2,24.5,20,8.6\n")
    done = run("regolith", "infer", "rig.csv")
    assert done.code == 1 and "no column sinkage_m; there are: run, load_N, slip [%], pull_N" in done.err[-1]


def test_columns_of_craters_have_one_name(run, at: Path) -> None:
    """Of one rock and of several, in the table for people and in CSV."""
    for name in ("a", "b"):
        shares = ("--modes", "ol=0.25:0.05,opx=0.35:0.05,cpx=0.4:0.05")
        table = run("spectra", "match", *shares, "--name", name, "--columns", "name,posterior", "-q").out.splitlines()
        rows = run("spectra", "match", *shares, "--columns", "name,posterior", "--csv", "-q").out.splitlines()
        assert [cell in table[1] for cell in ("name", "posterior")] == [True, True]
        assert {row.split(",")[0] for row in rows[1:]} <= {line.rpartition("  ")[0].strip() for line in table}


def test_a_start_is_offered_as_it_is_typed(run, at: Path) -> None:
    """Then a path is planned from there."""
    plan = ("twin", "plan", "site.asc", "--target", "1.5,1.5", "-q")
    done = run(*plan, "--start=-0.9,-0.9,30")
    offered = done.err[-1].partition("nearest with room being ")[2].partition(";")[0]
    assert done.code == 1 and offered.count(",") == 1
    assert run(*plan, f"--start={offered}").code == 0


def test_where_no_path_is_its_limits_are_named_with_their_options(run, at: Path) -> None:
    rows = np.zeros((41, 121))
    rows[:, 60:62] = 1.0
    head = GRID[: GRID.index("0 0")].replace("ncols 41", "ncols 121")
    Path("wall.asc").write_text(head + "\n".join(" ".join(map(str, row)) for row in rows))
    done = run("twin", "plan", "wall.asc", "--start", "1,1,0", "--target", "9,1", "-q")
    assert done.code == 1
    assert "--max-slope, --max-step, --hazard-distance and --turning-radius, alone or together" in done.err[-1]


def test_a_batch_says_which_option_lists_its_failures(run, at: Path, rock: Path) -> None:
    Path("broken.csv").write_text("no spectrum\n")
    done = run("spectra", "bands", rock, "broken.csv", "-q")
    assert done.code == 1 and done.err[-1].endswith("1 input without: broken.csv (--failed FILE lists them)")
    done = run("spectra", "bands", rock, "broken.csv", "-q", "--failed", "bad.txt")
    assert done.err[-1].endswith("(bad.txt lists them)")


def test_a_column_without_a_unit_is_asked_about_as_such(run, at: Path) -> None:
    """Not by setting a usual number beside a usual number."""
    Path("rig.csv").write_text("load,slip,pull,sinkage_mm\n" + "".join(
        f"24.5,{slip},{pull},{sinkage}\n" for slip, pull, sinkage in ((0.1, 8.1, 6), (0.2, 8.6, 9.5), (0.3, 9.0, 12))
    ))  # fmt: skip
    done = run("regolith", "infer", "rig.csv", "--law", "given", "-q")
    asked = next(line for line in done.err if "normal_force_n=" in line)
    assert done.code == 3 and "the column names no unit, and median normal_force_n is 24.5; is it in N?" in asked
