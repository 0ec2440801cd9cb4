"""Designs of a rover beside the laws of wheels on soil, and beside the same drives one by one."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lunarsci
from lunarsci.errors import ParameterError, RequestError
from lunarsci.rovers import read_rover
from lunarsci.twin.jobs.sweep import DesignTrade, sweep
from lunarsci.twin.judgement.designs import (
    Design,
    MissionOutcome,
    check_design,
    design_values,
    pareto_front,
    parse_variation,
    unchanged,
    varied_description,
)
from lunarsci.twin.rover import build_rover

PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 2.0\n"


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mission")
    (folder / "plan.toml").write_text(PLAN)
    (folder / "back.toml").write_text(PLAN.replace("length_m = 2.0", "length_m = 1.0\ncrab_deg = 180.0"))
    for name, slope in (("level.csv", 0.0), ("climb.csv", 0.15)):
        rows = [f"{x},{y},{slope * x}" for y in range(-3, 4, 2) for x in range(-3, 6, 2)]
        (folder / name).write_text("\n".join(["x_m,y_m,height_m", *rows]) + "\n")
    return folder


def column(found: DesignTrade, name: str) -> np.ndarray:
    return np.array([row[name] for row in found.rows()])


def on_level(mission: Path, *vary: str, **options: Any) -> DesignTrade:
    given = {"terrain": str(mission / "level.csv"), "soil": "longji", "vary": vary, "sample": 0.2}
    return sweep(mission / "plan.toml", **given | options)


def test_sinkage_follows_bekker_s_law_of_rigid_wheels(mission: Path) -> None:
    """z = (3 W / ((3 - N) b k sqrt(D)))^(2 / (2 N + 1)), Bekker (1969): D^(-1/3), b^(-2/3), W^(2/3) at N = 1.

    Without lugs, whose height the stiffness depends on here.
    """
    bald = "wheel.grouser_height_m=0:0:1"
    wide = on_level(mission, "wheel.radius_m=0.1:0.2:3", bald)
    sinkage = column(wide, "sinkage_m")
    assert (np.diff(sinkage) < 0).all()
    assert sinkage[2] / sinkage[0] == pytest.approx(2.0 ** (-1 / 3), rel=0.05)
    sinkage = column(on_level(mission, "wheel.width_m=0.1:0.2:2", bald), "sinkage_m")
    assert sinkage[1] / sinkage[0] == pytest.approx(2.0 ** (-2 / 3), rel=0.05)
    heavy = on_level(mission, "mass.body_kg=60:150:2", bald)
    sinkage, energy = column(heavy, "sinkage_m"), column(heavy, "energy_p50_j")
    assert sinkage[1] / sinkage[0] == pytest.approx((180.0 / 90.0) ** (2 / 3), rel=0.05)
    # Compaction resistance grows faster than the weight: with W^(4/3) at N = 1.
    assert energy[1] / energy[0] == pytest.approx(2.0 ** (4 / 3), rel=0.15)


def test_a_climb_takes_the_energy_of_its_height_for_every_mass_and_speed_alone_only_time(mission: Path) -> None:
    found = on_level(
        mission, "mass.body_kg=70:140:2", "plan.speed_m_s=0.025:0.05:2", terrain=str(mission / "climb.csv")
    )
    lifted = np.array([100.0, 100.0, 170.0, 170.0]) * 1.622 * 2.0 * 0.95 * math.sin(math.atan(0.15))
    energy = column(found, "energy_p50_j")
    assert (energy > lifted).all() and (energy < 4.0 * lifted).all()
    assert energy[2] > 1.5 * energy[0]
    assert column(found, "duration_s") == pytest.approx([80.0, 40.0, 80.0, 40.0])
    grid = found.to_xarray()
    assert grid["duration_s"].dims == ("mass.body_kg", "plan.speed_m_s") and grid["energy_p50_j"].attrs["units"] == "J"
    assert grid["duration_s"].values.tolist() == pytest.approx(np.array([[80.0, 40.0], [80.0, 40.0]]))
    assert float(grid["energy_p50_j"].sel({"mass.body_kg": 140.0, "plan.speed_m_s": 0.025})) == energy[2]
    assert energy[0] == pytest.approx(energy[1], rel=0.03) and energy[2] == pytest.approx(energy[3], rel=0.03)


@pytest.mark.parametrize(("gravity", "g"), [(None, 1.622), ("mars", 3.71)])
def test_a_design_like_the_rover_is_the_prediction_of_the_rover(mission: Path, gravity: str | None, g: float) -> None:
    """One mission of two plans is the sum of both; pull per weight is that of `regolith forces`."""
    given = {"terrain": str(mission / "level.csv"), "soil": "longji", "sample": 0.2, "gravity": gravity}
    soils = {"sweep": ("friction_angle_deg=30:45:4",)}
    plans = [mission / "plan.toml", mission / "back.toml"]
    [row] = sweep(plans, vary=("wheel.radius_m=0.15:0.15:1",), **given, **soils).rows()
    alone = [lunarsci.predict(plan, **given, **soils, exact_terrain=True) for plan in plans]
    records = [one.to_dict()["energy"] for one in alone]
    assert row["energy_p50_j"] == pytest.approx(sum(one["p50_j"] for one in records), rel=1e-6)
    assert row["duration_s"] == pytest.approx(sum(one["duration_s"] for one in records))
    assert row["slip_ratio"] == max(
        limit.p95 for one in alone for limit in one.verdict.limits if limit.quantity == "slip_ratio"
    )
    assert row["kept_share"] == 1.0
    curve = lunarsci.wheel_forces(load=135.0 * g / 6, slip="0:0.6:7", soil="longji", friction_angle=37.5)
    pull = curve.to_dict()["traction"]["pull_per_weight_at_20"]
    assert row["pull_per_weight_at_20"] == pytest.approx(pull, rel=1e-9)


def test_designs_that_cannot_be_are_listed_and_the_others_go_on(mission: Path) -> None:
    found = on_level(mission, "wheel.radius_m=0.15:0.35:2", "plan.speed_m_s=0.05:0.06:2")
    reasons = column(found, "impossible")
    assert reasons[0] == "" and found.designs[0].outcome is not None
    assert "drives at most 0.055" in reasons[1]
    assert all("do not fit 0.5 m" in reason for reason in reasons[2:])
    assert found.rows()[3]["energy_p50_j"] is None and not found.rows()[3]["on_front"] and not found.untrusted
    nothing = on_level(mission, "wheel.radius_m=0.3:0.35:2")
    assert nothing.untrusted == "no design is possible" and nothing.front == ()


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("wheel.grouser_count", "not by their number"),
        ("wheel.lugs", "grouser_height_m"),
        ("limits.max_slope_deg", "twin plan"),
        ("drive.max_speed_m_s", "vary plan.speed_m_s"),
        ("steering.steered_wheels", "no number"),
        ("wheel.radius", "these are: plan.speed_m_s, wheel.radius_m"),
        ("mass.body_center_m", "mass.body_center_m.x"),
    ],
)
def test_numbers_that_change_no_drive_are_refused_with_the_reason(mission: Path, name: str, why: str) -> None:
    with pytest.raises(RequestError, match="`vary`") as refused:
        on_level(mission, f"{name}=1:2:2")
    assert why in str(refused.value)


def test_a_chassis_counts_only_where_a_plan_judges_it(mission: Path) -> None:
    clear = on_level(mission, "body.belly_z_m=-0.02:0.05:2")
    assert column(clear, "kept_share").tolist() == [1.0, 1.0]
    (mission / "free.toml").write_text(PLAN + "[limits]\nslip_ratio = 0.3\n")
    with pytest.raises(RequestError, match="no plan limits clearance_m"):
        sweep(mission / "free.toml", terrain=str(mission / "level.csv"), vary=("body.belly_z_m=0:0.05:2",))


def test_what_changes_nothing_is_said(mission: Path) -> None:
    """The size of the battery does nothing to what is drawn from it."""
    found = on_level(mission, "power.battery_wh=50:100:2", "wheel.radius_m=0.14:0.16:2")
    assert found.unused == ("power.battery_wh",)
    assert on_level(mission, "motors.efficiency=0.3:0.6:2").unused == ()


def test_less_efficient_motors_draw_more_by_what_they_lose(mission: Path) -> None:
    """Work over efficiency, 60 W of electronics and 1 W for each of six motors over 40 s."""
    found = on_level(mission, "motors.efficiency=0.25:0.5:2")
    work, drawn = column(found, "energy_p50_j"), 3600.0 * column(found, "electrical_p50_wh")
    assert drawn == pytest.approx(work / [0.25, 0.5] + (60.0 + 6.0) * 40.0, rel=1e-6)


def test_ranges_are_read_or_refused() -> None:
    entry = parse_variation("wheel.radius_m=0.10:0.20:5")
    assert (entry.name, entry.low, entry.high, entry.count) == ("wheel.radius_m", 0.1, 0.2, 5)
    for text in ("wheel.radius_m", "wheel.radius_m=0.1:0.2", "a=1:2:3:4", "a=x:2:3"):
        with pytest.raises(ParameterError, match="not NAME=LOW:HIGH:N"):
            parse_variation(text)
    for text in ("a=2:1:3", "a=1:2:1", "a=nan:2:3"):
        with pytest.raises(ParameterError, match="LOW < HIGH"):
            parse_variation(text)
    with pytest.raises(ParameterError, match=r"designs is \d+; give 1 to 2000"):
        design_values([parse_variation("a=0:1:50"), parse_variation("b=0:1:50")], None, 0)


def test_samples_fill_every_stratum_of_each_range() -> None:
    ranges = [parse_variation("a=0:1:2"), parse_variation("b=10:20:2")]
    rows = design_values(ranges, 16, 4)
    for name, low, width in (("a", 0.0, 1.0), ("b", 10.0, 10.0)):
        strata = sorted(int(16 * (row[name] - low) / width) for row in rows)
        assert strata == list(range(16))
    assert rows == design_values(ranges, 16, 4) != design_values(ranges, 16, 5)


def test_a_vector_is_varied_by_its_axis_and_wheels_must_fit(mission: Path) -> None:
    description = read_rover("yutu2")
    moved = varied_description(description, {"mass.body_center_m.z": 0.5, "wheel.width_m": 0.2})
    rover = build_rover(moved)
    assert rover.body_center_m == (0.0, 0.0, 0.5) and rover.wheel.width_m == 0.2
    assert build_rover(description).body_center_m[2] == 0.3
    check_design(rover, description.assumed)
    with pytest.raises(ParameterError, match=r"reach 0\.025 m into the chassis"):
        check_design(rover)
    low = dataclasses.replace(rover, body=dataclasses.replace(rover.body, belly_z_m=-0.3))
    with pytest.raises(ParameterError, match="lies on the ground"):
        check_design(low, description.assumed)


def outcome(kept: float, energy: float | None) -> Design:
    numbers = dict.fromkeys(("slip_ratio", "sinkage_m", "motor_torque_nm", "duration_s"), 0.0)
    rest: dict[str, Any] = dict.fromkeys(("energy_p95_j", "electrical_p50_wh", "bias_m", "scatter_m", "traction"))
    found = MissionOutcome(drives=4, kept_share=kept, energy_p50_j=energy, reasons=(), **numbers, **rest)
    return Design(values={"a": 0.0}, outcome=found)


def dominated(number: int, points: Sequence[tuple[float, float]]) -> bool:
    kept, energy = points[number]
    return any(k >= kept and e <= energy and (k, e) != (kept, energy) for k, e in points)


def test_the_front_is_what_no_other_design_beats_in_both() -> None:
    rng = np.random.default_rng(1)
    points = [(float(k) / 8, float(e)) for k, e in zip(rng.integers(0, 9, 60), rng.permutation(60), strict=True)]
    front = pareto_front([outcome(*point) for point in points])
    assert sorted(front) == [n for n in range(60) if not dominated(n, points)]
    assert [points[n][1] for n in front] == sorted(points[n][1] for n in front)
    beyond = [outcome(0.5, None), Design(values={"a": 0.0}, impossible="no"), outcome(0.2, 3.0)]
    assert pareto_front(beyond) == [2] and unchanged([]) == []


def test_a_hopeless_design_keeps_nothing_and_says_why(mission: Path) -> None:
    """The slope of 0.15 with a soil that holds at most 5 deg: every drive slips beyond the limit."""
    slick = ("friction_angle_deg=3:5:2",)
    found = on_level(mission, "mass.body_kg=90:120:2", terrain=str(mission / "climb.csv"), sweep=slick)
    assert column(found, "kept_share").tolist() == [0.0, 0.0]
    assert all("slip_ratio" in reason or " early: " in reason for reason in column(found, "reasons"))
