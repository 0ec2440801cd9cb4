"""`lunarsci twin compare` over many trials: made files of public layouts, synthetic throughout."""

import csv
import io
import json
import os
import re
import subprocess
from pathlib import Path

import pytest
from made_trials import HUSKY, ROSEY, made_drive, write_captured, write_run

PAGE = Path(__file__).parents[2] / "docs/howto/public-drives.md"
SHORT = {"speed_m_s": 0.08, "seconds": 18.0, "rate_hz": 5.0, **ROSEY}


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two trials of a lab and one run of a field in one folder."""
    folder = tmp_path_factory.mktemp("trials")
    write_captured(folder / "Trial_Data/5.0_Straight_0.0/Trial_1", made_drive(**SHORT, slip=0.12, seed=1), seed=1)
    turning = made_drive(**SHORT, turn_rad_s=-0.05, seed=2)
    write_captured(folder / "Trial_Data/5.0_120.0_Right_0.0/Trial_1", turning, seed=2)
    write_run(folder / "run1", made_drive(speed_m_s=0.4, seconds=25.0, **HUSKY, seed=3), seed=3)
    return folder


def test_two_layouts_are_scored_by_one_command(run, trials: Path, tmp_path: Path) -> None:
    (trials / "Trial_Data/Trial_9").mkdir(exist_ok=True)
    bad = trials / "Trial_Data/Trial_9/Processed_Data.csv"
    bad.write_text("time_s,pos_x\n0,0\n")
    picture = tmp_path / "trials.png"
    done = run("twin", "compare", trials, "--members", "24", "--json", "--plot", picture)
    bad.unlink()
    assert done.code == 1 and "no column pos_y" in "".join(done.err) and picture.stat().st_size > 10_000
    document = json.loads(done.out)
    assert document["schema"] == "lunarsci/twin-trials/1"
    result = document["result"]
    assert result["soil"] == {"of": "priors", "name": "priors"}
    rows = {Path(row["trial"]).parent.name: row for row in result["trials"]}
    assert len(rows) == 3 and all(row["members"] == 24 and row["synthetic"] for row in rows.values())
    assert {row["gravity_m_s2"] for row in rows.values()} == {9.80665}
    straight = rows["5.0_Straight_0.0"]
    assert straight["slip_ratio_measured"] == pytest.approx(0.12, abs=0.02)
    assert straight["end_m_error_wheels_alone"] == pytest.approx(0.12 * 1.4, abs=0.03)
    assert straight["end_m_error"] < straight["end_m_error_wheels_alone"]
    summary = {row["quantity"]: row for row in result["summary"]}
    assert set(summary) == {"slip_ratio", "side_slip_deg", "end_m"}
    assert summary["end_m"]["values"] == 3 and summary["slip_ratio"]["trials"] == 3
    assert summary["slip_ratio"]["rms"] < summary["slip_ratio"]["rms_wheels_alone"]
    assert 0 <= summary["end_m"]["in_90"] <= 1
    used = {file["path"] for file in document["provenance"]["inputs"]}
    assert str(trials / "run1/gps-utm18t.txt") in used and len(used) == 5


def test_a_table_has_a_row_for_each_trial(run, trials: Path) -> None:
    one = trials / "Trial_Data/5.0_Straight_0.0"
    done = run("twin", "compare", one, "--csv", "--soil", "longji", "-q")
    assert done.code == 0, done.err
    (row,) = csv.DictReader(io.StringIO(done.out))
    assert row["members"] == row["finished"] == "1" and row["end_m_in_90"] == ""
    assert float(row["slip_ratio_error_wheels_alone"]) == pytest.approx(0.12, abs=0.02)
    text = run("twin", "compare", one, "--members", "16")
    assert text.code == 0 and "1 trial beside what the twin predicts" in text.out
    assert "wheels: rms" in text.out and "1 of the trials are synthetic" in text.out


def test_telemetry_of_ones_own_is_a_trial(run, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text("[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.5\n")
    assert run("twin", "simulate", plan, "-o", tmp_path / "sent", "-q").code == 0
    done = run("twin", "compare", tmp_path / "sent/telemetry.csv", "--soil", "longji", "--json")
    assert done.code in (0, 3), done.err
    (row,) = json.loads(done.out)["result"]["trials"]
    assert row["rover"].startswith("Yutu-2") and row["gravity_m_s2"] == pytest.approx(1.622, abs=0.01)
    # It was simulated on the same soil and ground, with positions 3 to 6 cm off.
    assert row["slip_ratio_error"] < 0.02 and row["side_slip_deg_error"] < 1.0 and row["end_m_error"] < 0.15
    assert row["way_m"] == pytest.approx(1.5, abs=0.02)


def test_what_does_not_belong_together_is_refused(run, trials: Path, tmp_path: Path) -> None:
    done = run("twin", "compare", trials, "--plan", "plan.toml")
    assert (done.code, done.out) == (2, "") and "--plan belongs to a prediction" in done.err[-1]
    done = run("twin", "compare", trials, "--save", tmp_path / "belief.json")
    assert (done.code, done.out) == (2, "") and "--save keeps" in done.err[-1]
    (tmp_path / "prediction.json").write_text("{}")
    done = run("twin", "compare", tmp_path, "states.csv", "--gravity", "earth")
    assert (done.code, done.out) == (2, "") and "--gravity belongs to trials" in done.err[-1]
    done = run("twin", "compare", tmp_path)
    assert (done.code, done.out) == (2, "") and "give one file of measured states" in done.err[-1]
    done = run("twin", "compare", tmp_path / "nowhere", "-q")
    assert (done.code, done.out) == (1, "") and "no such file" in "".join(done.err)


@pytest.mark.slow
def test_every_command_of_the_page_runs(trials: Path, tmp_path: Path, program: Path) -> None:
    for name in ("Trial_Data", "run1"):
        (tmp_path / name).symlink_to(trials / name)
    script = "".join(re.findall(r"```sh\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL))
    environment = os.environ | {"PATH": os.pathsep.join([str(program), os.environ["PATH"]])}
    line = ["bash", "-euo", "pipefail", "-c", script]
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "trials.csv").read_text().splitlines()) == 3
    assert (tmp_path / "states/states.csv").exists() and json.loads((tmp_path / "run1.json").read_text())
