"""`lunarsci twin compare`: the folder of a prediction beside a measured drive."""

import csv
import dataclasses
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

import lunarsci
from lunarsci.errors import RequestError
from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief

PLAN = '[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.2\ncurvature_per_m = 0.1\n[sweep]\ncohesion_pa = "300:600:4"\n'


@dataclasses.dataclass(frozen=True)
class Drive:
    """The plan, the folder of its prediction, and what was measured of a drive."""

    plan: Path
    folder: Path
    states: Path
    positions: Path

    def arguments(self) -> tuple[object, ...]:
        return ("twin", "compare", self.folder, self.states, "--positions", self.positions)


@pytest.fixture
def drive(predicted: Path, tmp_path: Path) -> Drive:
    """Files of `predicted` of one's own."""
    shutil.copytree(predicted, tmp_path, dirs_exist_ok=True)
    return Drive(tmp_path / "plan.toml", tmp_path / "drive", tmp_path / "measured.csv", tmp_path / "positions.csv")


@pytest.fixture(scope="module")
def predicted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A prediction on 32 draws of a belief; measured is another draw, with errors (synthetic)."""
    tmp_path = tmp_path_factory.mktemp("predicted")
    plan, belief, other = tmp_path / "plan.toml", tmp_path / "belief.json", tmp_path / "other"
    plan.write_text(PLAN)
    first = first_belief()
    belief.write_text(SoilBelief(first.laws, first.mean, 0.05 * first.covariance).to_json())
    predict = ["twin", "predict", str(plan), "--soil", str(belief), "-q"]
    assert main([*predict, "--members", "32", "-o", str(tmp_path / "drive")]) == 0
    assert main([*predict, "--members", "1", "--seed", "8", "-o", str(other)]) == 0
    states, path = pd.read_csv(other / "states.csv"), pd.read_csv(other / "paths.csv")
    random = np.random.default_rng(1)
    states["sinkage_m"] += 0.00033 * random.normal(size=len(states))
    states["slip_ratio"] += 0.013 * random.normal(size=len(states))
    columns = ["time_s", "wheel", "sinkage_m", "slip_ratio", "side_slip_deg", "valid"]
    states[columns].to_csv(tmp_path / "measured.csv", index=False)
    fixes = path[["time_s", "x_m", "y_m"]].iloc[4::4].copy()
    fixes[["x_m", "y_m"]] += 0.01 * random.normal(size=(len(fixes), 2))
    fixes.assign(sigma_m=0.01).to_csv(tmp_path / "positions.csv", index=False)
    return tmp_path


def test_tables_in_parquet_are_compared_as_those_in_csv(run, drive: Drive, tmp_path: Path) -> None:
    folder = tmp_path / "parquet"
    predict = ("twin", "predict", drive.plan, "--soil", tmp_path / "belief.json", "-q", "--members", "32")
    assert run(*predict, "-o", folder, "--tables", "parquet").code == 0
    assert {path.name for path in folder.iterdir()} == {
        path.name.replace(".csv", ".parquet") for path in drive.folder.iterdir()
    }
    for name in ("states", "paths", "endpoints", "profiles"):
        exact, rounded = pd.read_parquet(folder / f"{name}.parquet"), pd.read_csv(drive.folder / f"{name}.csv")
        numbers = exact.select_dtypes("number").columns
        assert np.allclose(exact[numbers], rounded[numbers], rtol=1e-8, atol=0, equal_nan=True)
        exact, rounded = exact.drop(columns=numbers), rounded.drop(columns=numbers).fillna("")
        assert (exact.astype(str) == rounded.astype(str)).all(axis=None) and len(exact.columns)
    compare = [("twin", "compare", place, *drive.arguments()[3:], "--json") for place in (drive.folder, folder)]
    one, other = (json.loads(run(*words).out)["result"] for words in compare)
    assert one["verdict"] == other["verdict"] == "trusted"
    assert one["end"]["p"] == pytest.approx(other["end"]["p"], rel=1e-6)
    starts = ("twin", "plan", "--target", "3,0.5", "--json", "--start")
    lengths = [json.loads(run(*starts, place).out)["result"]["path"]["length_m"] for place in (drive.folder, folder)]
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-6) and lengths[0] > 1
    kinds = [
        json.loads(run("info", folder / f"{name}.parquet", "--json").out)["result"] for name in ("states", "paths")
    ]
    assert "telemetry" not in json.dumps(kinds)
    shutil.copy(drive.folder / "paths.csv", folder)
    assert "paths.csv and paths.parquet are both in it" in run(*compare[1]).err[-1]
    (folder / "paths.csv").unlink()
    (folder / "states.parquet").write_bytes(b"PAR1")
    assert "states.parquet: not as it was written" in run(*compare[1]).err[-1]
    assert run(*predict, "--tables", "xlsx").code == run(*predict, "--tables", "parquet").code == 2
    with pytest.raises(RequestError, match="give csv or parquet"):
        lunarsci.predict(str(drive.plan)).files(tables="xlsx")


def test_a_drive_as_predicted_is_trusted(run, drive: Drive, tmp_path: Path) -> None:
    picture = tmp_path / "compare.png"
    done = run(*drive.arguments(), "--plan", drive.plan, "--json", "--plot", picture)
    assert done.code == 0, done.err
    assert picture.stat().st_size > 50_000
    document = json.loads(done.out)
    assert document["schema"] == "lunarsci/twin-compare/1"
    result = document["result"]
    assert result["verdict"] == "trusted" and result["reasons"] == [] and result["soils"] == "belief"
    assert result["members"] == result["finished"] == 32
    assert result["end"]["at_end"] and result["end"]["regions"]["99"] and 0 < result["end"]["p"] <= 1
    assert result["not_compared"]["normal_force_n"] == "not measured"
    assert result["surprise"]["quantities"] == ["sinkage_m", "slip_ratio", "side_slip_deg", "position"]
    used = {file["path"] for file in document["provenance"]["inputs"]}
    assert used >= {str(drive.folder / "prediction.json"), str(drive.states), str(drive.positions), str(drive.plan)}
    assert run(*drive.arguments(), "--json", "--no-time").out == run(*drive.arguments(), "--json", "--no-time").out
    rows = list(csv.DictReader(io.StringIO(run(*drive.arguments(), "--csv").out)))
    assert len(rows) == 3 * 7 and {"quantity", "wheel", "bias", "coverage_90", "crps", "bias_p"} <= rows[0].keys()
    text = run(*drive.arguments()).out
    assert text.startswith("TRUSTED") and "not compared: normal_force_n (not measured)" in text
    # Without positions all else still compares.
    assert run("twin", "compare", drive.folder, drive.states, "--field", "end").out == "null\n"


def test_a_miss_teaches_the_belief_of_the_twins_physics(run, drive: Drive, tmp_path: Path) -> None:
    """An end 0.1 m beside the predicted one, 1 cm known: later regions are wider, and the drive counts once."""
    belief, after = tmp_path / "belief.json", tmp_path / "after.json"
    fixes = pd.read_csv(drive.positions)
    fixes["y_m"] += 0.1
    fixes.to_csv(drive.positions, index=False)
    done = run(*drive.arguments(), "--belief", belief, "--save", after, "--json")
    assert done.code == 3, done.err
    result = json.loads(done.out)["result"]
    assert result["miss"]["across_m"] == pytest.approx(0.1, abs=0.05) and result["miss"]["way_m"] == 1.2
    before, learned = (read_belief(read_input(str(path))) for path in (belief, after))
    assert learned.discrepancy.across.scale > 1.5 * before.discrepancy.across.scale
    assert np.array_equal(learned.mean, before.mean) and learned.history == before.history
    predict = ("twin", "predict", drive.plan, "--members", "32", "--field", "endpoint.physics_covariance_m2", "--soil")
    narrow, wide = (np.array(json.loads(run(*predict, path).out)) for path in (belief, after))
    assert wide[1, 1] > 1.5 * narrow[1, 1] > 0
    again = run(*drive.arguments(), "--belief", after, "--save", tmp_path / "twice.json")
    assert again.code == 1 and "compare first, then update by the drive" in again.err[-1]
    assert run(*drive.arguments(), "--save", after).code == 2


def test_another_ground_is_not_to_be_trusted(run, drive: Drive) -> None:
    table = pd.read_csv(drive.states)
    table["slip_ratio"] += 0.15
    table.to_csv(drive.states, index=False)
    done = run(*drive.arguments(), "--json")
    assert done.code == 3 and "the prediction is not to be trusted: slip_ratio is off by +0.1" in done.err[-1]
    assert json.loads(done.out)["result"]["verdict"] == "not to be trusted"


def test_what_is_near_the_edge_is_not_called_trusted(run, drive: Drive, tmp_path: Path) -> None:
    """A slip that is off by some 1.8 standard deviations contradicts nothing, and confirms nothing."""
    own = {row["quantity"]: row for row in json.loads(run(*drive.arguments(), "--json").out)["result"]["quantities"]}
    table, band = pd.read_csv(drive.states), own["slip_ratio"]
    # Towards where it is off already, so that it is 1.8 standard deviations off.
    one = band["bias"] / band["bias_standard"]
    table["slip_ratio"] += np.sign(band["bias"]) * (1.8 - abs(band["bias_standard"])) * one
    table.to_csv(drive.states, index=False)
    done = run("twin", "compare", drive.folder, drive.states)
    assert done.code == 0 and done.out.startswith("NOT CONTRADICTED: "), done.err
    assert "near the edge: slip_ratio is off by" in done.out and "hardly confirmed" in done.err[0]
    found = run("twin", "compare", drive.folder, drive.states, "-o", tmp_path / "c.json")
    assert found.code == 0 and json.loads((tmp_path / "c.json").read_text())["result"]["verdict"] == "not contradicted"
    told = json.loads(run("report", tmp_path / "c.json", "--json").out)["result"]["sections"][0]["answer"]
    assert told.startswith("The prediction is not contradicted: slip_ratio is off by")
    assert run("twin", "compare", drive.folder, drive.states, "-o", tmp_path / "plain", "-q").code == 0
    text = run("report", tmp_path / "plain")
    assert text.code == 1 and "--json -o plain.json" in text.err[0]


def test_a_sweep_gives_no_probabilities_and_few_drives_no_trust(run, drive: Drive, tmp_path: Path) -> None:
    swept = tmp_path / "swept"
    assert run("twin", "predict", drive.plan, "-o", swept, "-q").code == 0
    done = run("twin", "compare", swept, drive.states, "--positions", drive.positions)
    assert done.code == 3 and "rests on 4 drives" in done.err[-1] and "not probabilities" in done.out


def broken(drive: Drive, how: str) -> None:
    file, states = drive.folder / "prediction.json", drive.folder / "states.csv"
    document = json.loads(file.read_text())
    changes: dict[str, Callable[[], object]] = {
        "no document": file.unlink,
        "cut document": lambda: file.write_text(file.read_text()[:500]),
        "other version": lambda: file.write_text(json.dumps(document | {"schema": "lunarsci/twin-prediction/0"})),
        "no table": states.unlink,
        "other table": lambda: shutil.copy(drive.folder / "paths.csv", states),
        "no time": lambda: file.write_text(json.dumps({k: v for k, v in document.items() if k != "time_s"})),
        "broken plan": lambda: file.write_text(json.dumps(document | {"plan": "[drive"})),
    }
    changes[how]()


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ("no document", "no prediction.json"),
        ("cut document", "is the file complete"),
        ("other version", "its schema is"),
        ("no table", "no such file"),
        ("other table", "not as it was written"),
        ("no time", "'time_s'"),
        ("broken plan", "not valid TOML"),
    ],
)
def test_a_broken_folder_is_one_line(run, drive: Drive, how: str, says: str) -> None:
    broken(drive, how)
    done = run(*drive.arguments())
    assert (done.code, done.out, len(done.err)) == (1, "", 1), done.err
    assert says in done.err[0] and str(drive.folder) in done.err[0]


def test_another_plan_rover_or_clock_is_refused(run, drive: Drive, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(PLAN.replace("1.2", "1.3"))
    done = run(*drive.arguments(), "--plan", other)
    assert done.code == 1 and "not the plan" in done.err[0]
    # Limits and sweeps are no part of the drive.
    other.write_text(PLAN.replace("300:600:4", "100:900:9") + "[limits]\nslip_ratio = 0.5\n")
    assert run(*drive.arguments(), "--plan", other).code == 0
    done = run(*drive.arguments(), "--rover", "small-four")
    assert done.code == 1 and "give that file as --rover" in done.err[0]
    four = tmp_path / "four"
    assert run("twin", "predict", drive.plan, "--rover", "small-four", "-o", four).code in (0, 3)
    table = pd.read_csv(four / "states.csv")
    table[table["member"] == 0].drop(columns="member").to_csv(four / "one.csv", index=False)
    done = run("twin", "compare", four, four / "one.csv", "--field", "provenance.options.rover")
    assert done.out == "small-four\n" and done.code in (0, 3), done.err
    table = pd.read_csv(drive.states)
    table["time_s"] += 1e6
    table.to_csv(drive.states, index=False)
    done = run("twin", "compare", drive.folder, drive.states)
    assert done.code == 1 and "time_s in seconds from its start" in done.err[0] and str(drive.states) in done.err[0]
