"""`lunarsci twin simulate` and `lunarsci twin states`: there and back, on made-up drives."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

from lunarsci.io.inputs import read_input
from lunarsci.twin.assimilation.residuals import pace_of, read_record
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.rover import build_rover

PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 2.5\ncurvature_per_m = 0.15\n"


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the telemetry of a made-up drive; not to be written into."""
    folder = tmp_path_factory.mktemp("sent")
    (folder / "plan.toml").write_text(PLAN)
    assert main(["twin", "simulate", str(folder / "plan.toml"), "-q", "-o", str(folder / "drive")]) == 0
    return folder / "drive"


def test_a_made_up_drive_is_marked_and_repeatable(run, plan: Path, sent: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert run("twin", "simulate", plan, "-o", again, "-q").code == 0
    for name in ("telemetry.csv", "track.csv", "truth.csv"):
        content = (sent / name).read_bytes()
        assert content.startswith(b"# synthetic") and content == (again / name).read_bytes()
    other = tmp_path / "other"
    assert run("twin", "simulate", plan, "-o", other, "--seed", "1", "-q").code == 0
    assert (other / "telemetry.csv").read_bytes() != (sent / "telemetry.csv").read_bytes()
    result = json.loads(run("twin", "simulate", plan, "--json").out)
    assert result["schema"] == "lunarsci/twin-simulate/1" and result["result"]["synthetic"] is True


def test_from_telemetry_to_states_and_on(run, plan: Path, sent: Path, tmp_path: Path) -> None:
    found, picture = tmp_path / "found", tmp_path / "states.png"
    done = run(
        *("twin", "states", sent / "telemetry.csv", plan, "--track", sent / "track.csv"),
        *("-o", found, "--plot", picture, "--json"),
    )
    assert done.code == 0, done.err
    document = json.loads(done.out)
    result = document["result"]
    assert document["schema"] == "lunarsci/twin-states/1"
    assert result["findings"] == [] and result["synthetic"] is True
    changes = result["slip_changes"]["ahead"]
    assert set(changes) == {"amplitude", "amplitude_factor", "length_m", "information_nat"}
    assert 0 < changes["amplitude"] < 0.05 and changes["amplitude_factor"] > 1 and 0.3 < changes["length_m"] < 3
    assert set(result["slope_effects"]) == {"slip", "side_slip"}
    assert 18 <= result["states"] <= 6 * (result["positions"] - 1) and result["valid"] == result["states"]
    assert set(result["wheels"]) == {"FL", "FR", "ML", "MR", "RL", "RR"}
    assert abs(result["wheels"]["FL"]["slip_ratio"]["median"]) < 0.1
    # The distance is the rover's, not that of its wheels, and so is that of the page.
    slip = np.mean([one["slip_ratio"]["median"] for one in result["wheels"].values()])
    assert slip > 0.005 and result["wheel_distance_m"] == pytest.approx(2.5, rel=0.01)
    assert result["distance_m"] == pytest.approx((1 - slip) * result["wheel_distance_m"], abs=0.02)
    told = json.loads(run("report", found, "--json").out)["result"]["sections"][0]["answer"]
    rolled = f"its wheels rolled {result['wheel_distance_m']:.3g} m"
    assert f"The rover drove {result['distance_m']:.3g} m in " in told and rolled in told
    assert result["wheels"]["FL"]["sinkage_m"]["median"] == pytest.approx(0.009, abs=0.002)
    assert picture.read_bytes().startswith(b"\x89PNG")
    states = pd.read_csv(found / "states.csv")
    measured = ("sinkage_m", "slip_ratio", "side_slip_deg")
    both = [column for name in measured for column in (name, f"{name}_sigma")]
    assert list(states.columns) == [
        "time_s",
        "distance_m",
        "wheel",
        "x_m",
        "y_m",
        *both,
        "slip_ratio_shared",
        "valid",
        "slip_basis",
        "rim_m_s",
        "rover",
        "ground",
    ]
    assert set(states["rover"]) == {"yutu2; wheels 150 x 150 mm"} == set(pd.read_csv(found / "motion.csv")["rover"])
    assert list(pd.read_csv(found / "positions.csv").columns) == ["time_s", "x_m", "y_m", "xx_m2", "xy_m2", "yy_m2"]
    forces = run("twin", "loads", "--motion", found / "motion.csv", "-o", tmp_path / "forces.csv")
    assert forces.code == 0, forces.err
    # With forces beside them, the states are what the regolith is identified from, without a warning.
    states = states[states["sinkage_m"].notna()].assign(
        normal_force_n=36.0, normal_force_n_sigma=1.0, drawbar_pull_n=-1.0, drawbar_pull_n_sigma=0.1
    )
    states.to_csv(tmp_path / "joined.csv", index=False)
    identified = run("regolith", "identify", tmp_path / "joined.csv", "--json")
    assert identified.code in (0, 3), identified.err
    assert not any("columns not used" in line for line in identified.err)


def test_what_is_found_is_listed_and_doubt_is_exit_3(run, plan: Path, sent: Path, tmp_path: Path) -> None:
    table = pd.read_csv(sent / "telemetry.csv", comment="#")
    gap = table[(table["time_s"] < 15) | (table["time_s"] > 30)]
    gap.to_csv(tmp_path / "gap.csv", index=False)
    done = run("twin", "states", tmp_path / "gap.csv", plan)
    assert done.code == 0 and "gap" in done.out
    assert any(line.startswith("warning: ") and "gap at time_s" in line for line in done.err)
    findings = json.loads(run("twin", "states", tmp_path / "gap.csv", plan, "--json").out)["result"]["findings"]
    [finding] = findings
    assert finding["kind"] == "gap" and finding["doubt"] is False and finding["time_s"] == pytest.approx(14, abs=1.1)
    table.assign(pitch_deg=table["pitch_deg"] + 8.0).to_csv(tmp_path / "tilted.csv", index=False)
    doubted = run("twin", "states", tmp_path / "tilted.csv", plan)
    assert doubted.code == 3 and "attitude against terrain" in doubted.err[-1] and "slip" in doubted.out
    table.assign(yaw_deg=np.nan).to_csv(tmp_path / "headless.csv", index=False)
    refused = run("twin", "states", tmp_path / "headless.csv", plan, "-o", tmp_path / "none")
    assert (refused.code, refused.out, len(refused.err)) == (1, "", 1)
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("off", [0.0, 0.03, 0.07, 0.11])
def test_wheels_that_turn_otherwise_than_planned_are_said(run, sent: Path, tmp_path: Path, off: float) -> None:
    """The plan is as much slower than what was driven as was planted; states of the same wheels keep their slip."""
    plan, rover = tmp_path / "slower.toml", build_rover("yutu2")
    plan.write_text(PLAN.replace("0.05", f"{0.05 / (1.0 + off):.6f}"))
    done = run("twin", "states", sent / "telemetry.csv", plan, "-o", tmp_path / "found", "-q", "--json")
    result = json.loads(done.out)["result"]
    pace, said = result["pace"], [one["what"] for one in result["findings"] if one["kind"] == "wheels against plan"]
    assert pace["ratio"] == pytest.approx(1.0 + off, abs=4.0 * pace["sigma"] + 1e-4) and 0 < pace["sigma"] < 0.003
    assert (pace["off"], done.code, len(said)) == ((True, 0, 1) if off else (False, 0, 0)), done.err
    assert not off or f"{1.0 + off:.3f} ± " in said[0]
    # What `twin update` finds in the states alone is the same.
    states = read_record(read_input(str(tmp_path / "found" / "states.csv")), rover)
    again = pace_of(states, rover, read_plan(str(plan)))
    assert again is not None and again.off == pace["off"] and again.ratio == pytest.approx(pace["ratio"], abs=0.003)
    told = float(again.remedy.partition("write speed_m_s = ")[2].split()[0].rstrip(";"))
    assert told == pytest.approx(0.05, abs=2e-4) and ("r_s / r" in again.remedy) == (off == 0.03)


def test_a_plan_of_the_shells_speed_is_told_from_any_other(run, sent: Path, tmp_path: Path) -> None:
    """Grousers make r_s larger than the wheel; a plan slower by just that is told so, and slip says which radius."""
    plan = tmp_path / "shell.toml"
    wheel = build_rover("yutu2").wheel
    plan.write_text(PLAN.replace("0.05", f"{0.05 * wheel.radius_m / wheel.shearing_radius_m:.6f}"))
    assert wheel.shearing_radius_m > 1.01 * wheel.radius_m
    done = run("twin", "states", sent / "telemetry.csv", plan)
    assert done.code == 0 and "this is r_s / r" in " ".join(done.err) and "write speed_m_s = 0.05" in " ".join(done.err)
    assert f"rolling radius r_s = {1e3 * wheel.shearing_radius_m:.4g} mm" in done.out


def test_telemetry_comes_from_stdin_too(run, sent: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import io
    import sys

    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO((sent / "telemetry.csv").read_bytes())))
    done = run("twin", "states", "-", "--field", "synthetic")
    assert (done.code, done.out) == (0, "true\n"), done.err


def test_positions_from_elsewhere_take_the_place_of_those_in_the_telemetry(
    run, plan: Path, sent: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same positions in a file of their own give the same states; at times between rows nearly so."""
    table = pd.read_csv(sent / "telemetry.csv", comment="#")
    fixed = table[["time_s", "x_m", "y_m", "xx_m2", "xy_m2", "yy_m2"]].dropna()
    bare = table.drop(columns=["x_m", "y_m", "xx_m2", "xy_m2", "yy_m2"])
    fixed.to_csv(tmp_path / "fixed.csv", index=False)
    bare.to_csv(tmp_path / "bare.csv", index=False)
    log = tmp_path / "log.csv"
    log.write_text("t,w_fl,w_fr,w_rl,w_rr,vo_x,odom_x,vo_y,yaw\n0,1,1,1,1,0,0,0,0\n")
    monkeypatch.chdir(tmp_path)
    said = run("twin", "states", "log.csv", "--rover", "small-four").err[-1]
    assert "missing: x_m (vo_x?), steered_W_deg or" in said
    assert "columns are missing: x_m, y_m;" in run("twin", "states", tmp_path / "bare.csv", plan).err[-1]
    wheels = []
    for lines in (
        (sent / "telemetry.csv", plan),
        (tmp_path / "bare.csv", plan, "--positions", tmp_path / "fixed.csv"),
        (tmp_path / "bare.csv", plan, "--positions", tmp_path / "between.csv"),
    ):
        done = run("twin", "states", *lines, "--json")
        assert done.code == 0, done.err
        wheels.append(json.loads(done.out)["result"]["wheels"])
        at = {name: np.interp(fixed["time_s"] + 0.4, fixed["time_s"], fixed[name]) for name in ("x_m", "y_m")}
        moved = fixed.assign(time_s=np.minimum(fixed["time_s"] + 0.4, fixed["time_s"].max()), **at)
        moved.to_csv(tmp_path / "between.csv", index=False)
    assert wheels[1] == wheels[0]
    for name, wheel in wheels[2].items():
        near = wheels[0][name]["slip_ratio"]
        assert wheel["slip_ratio"]["median"] == pytest.approx(near["median"], abs=2 * near["sigma"])
    late = fixed.assign(time_s=fixed["time_s"] + np.where(fixed.index > fixed.index[3], 1e4, 0.0))
    late.to_csv(tmp_path / "late.csv", index=False)
    done = run("twin", "states", tmp_path / "bare.csv", plan, "--positions", tmp_path / "late.csv")
    assert done.code == 3 and any("not within the times of the telemetry" in line for line in done.err)


def test_the_ground_after_the_drive_is_a_track(run, plan: Path, sent: Path, tmp_path: Path) -> None:
    """A ground that lies 9 mm lower throughout: every wheel that a depth belongs to sank 9 mm."""
    assert run("twin", "terrain", "synthetic-longji", "-o", tmp_path / "ground", "-q").code == 0
    import numpy as np

    with np.load(tmp_path / "ground" / "terrain.npz") as archive:
        content = dict(archive)
    content["height_m"] = content["height_m"] - 0.009
    np.savez(tmp_path / "after.npz", **content)
    done = run("twin", "states", sent / "telemetry.csv", plan, "--track", tmp_path / "after.npz", "--json")
    assert done.code == 0, done.err
    wheels = json.loads(done.out)["result"]["wheels"]
    deep = [wheel["sinkage_m"]["median"] for wheel in wheels.values() if wheel["sinkage_m"]["count"]]
    assert deep and deep == pytest.approx([0.009] * len(deep), abs=1e-5)


def test_without_a_track_or_a_plan_it_is_said(run, sent: Path) -> None:
    done = run("twin", "states", sent / "telemetry.csv")
    assert done.code == 0 and "give the depth of the track with --track" in done.out
    assert "not compared with a plan" in done.out


def test_a_plan_with_fixes_is_driven_with_its_halts(run, plan: Path, tmp_path: Path) -> None:
    plan.write_text(PLAN + "[[leg]]\nlength_m = 1.5\n[fixes]\nposition_sigma_m = 0.05\nheading_sigma_deg = 0.5\n")
    folder = tmp_path / "drive"
    done = run("twin", "simulate", plan, "-o", folder, "--json", "-q")
    assert done.code == 0, done.err
    [halt] = json.loads(done.out)["result"]["halts"]
    assert halt["distance_m"] == pytest.approx(2.5, abs=1e-3) and 0 < halt["off_m"] < 0.3
    rows = pd.read_csv(folder / "telemetry.csv", comment="#")
    [row] = rows.index[(rows["time_s"] - halt["time_s"]).abs() < 1e-6]
    assert bool(rows.loc[row, "halted"]) and rows.loc[row, "xx_m2"] == pytest.approx(0.05**2)
    states = run("twin", "states", folder / "telemetry.csv", plan, "--track", folder / "track.csv", "--json", "-q")
    assert states.code == 0, states.err
    kinds = {entry["kind"] for entry in json.loads(states.out)["result"]["findings"]}
    assert kinds <= {"sparse positions"}
    assert "of these at halts" in run("twin", "simulate", plan).out
