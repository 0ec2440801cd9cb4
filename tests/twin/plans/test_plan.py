"""Plans, sweeps and the geometry of the path."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciError, ParameterError
from lunarsci.rovers import RoverDescription, read_rover
from lunarsci.twin.plans.path import curvature_at, make_schedule
from lunarsci.twin.plans.plan import Leg, check_plan, parse_sweep, read_plan, rover_limits
from lunarsci.twin.rover import Rover, build_rover


def test_the_embedded_plan_is_the_published_one() -> None:
    """Ding et al. (2024), Fig. 1d; 9.807 m in all, phi 25-55 deg, K_y 15-45 mm."""
    plan = read_plan()
    assert [(leg.length_m, leg.curvature_per_m) for leg in plan.legs] == [
        (3.673, 0.154),
        (4.282, -0.132),
        (1.852, -0.138),
    ]
    assert plan.length_m == pytest.approx(9.807)
    assert [str(sweep) for sweep in plan.sweep] == ["25:55:9", "15:45:9"]
    assert all(limit.assumed or limit.source for limit in plan.limits)


ARC = "[[leg]]\nlength_m = 1.0\ncurvature_per_m = 0.0\n"
DRIVE = "[drive]\nspeed_m_s = 0.05\n"


def test_a_plan_without_limits_gets_the_embedded_ones_and_sweeps_nothing(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(DRIVE + ARC)
    plan = read_plan(path)
    assert plan.limits == read_plan().limits and plan.sweep == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (DRIVE, "length is zero"),
        (DRIVE + "[[leg]]\nlength_m = 0\ncurvature_per_m = 0\n", "length_m"),
        (DRIVE + "[[leg]]\nlength_m = nan\ncurvature_per_m = 0\n", "length_m"),
        (DRIVE + "[[leg]]\nlength_m = 1\ncurvature_per_m = inf\n", "curvature_per_m"),
        (DRIVE + "[[leg]]\ncurvature_per_m = 0\n", "exactly one of length_m"),
        (DRIVE + "[[leg]]\nlength_m = 1\nturn_deg = 30\n", "exactly one of length_m"),
        (DRIVE + "[[leg]]\nturn_deg = 30\ncrab_deg = 10\n", "crab_deg"),
        (DRIVE + "[[leg]]\nturn_deg = 361\n", "turn_deg"),
        (DRIVE + "[[leg]]\nstop_s = 0.2\n", "1 to 3600"),
        (DRIVE + "[[leg]]\nlength_m = -1\n", "length_m"),
        (DRIVE + ARC + "[fixes]\nposition_sigma_m = 0.1\n", "heading_sigma_deg"),
        (DRIVE + ARC + "[fixes]\nposition_sigma_m = -0.1\nheading_sigma_deg = 0\n", "position_sigma_m"),
        (DRIVE + "[[leg]]\nlength_m = 1e9\ncurvature_per_m = 0\n", "0 to 10000"),
        (DRIVE + "[leg]\nlength_m = 1\ncurvature_per_m = 0\n", "double brackets"),
        ("[drive]\nspeed_m_s = -0.05\n" + ARC, "speed_m_s"),
        ("[drive]\nspeed_m_s = nan\n" + ARC, "speed_m_s"),
        ("[drive]\nspeed_m_s = true\n" + ARC, "give a number"),
        ("[drive]\n" + ARC, "no speed_m_s"),
        ("[drive]\nspeed = 0.05\n" + ARC, "speed_m_s, blend_m"),
        ("drive = 3\n" + ARC, "table"),
        (DRIVE + ARC + "[limits]\nslip = 0.3\n", "slip_ratio, side_slip_deg"),
        (DRIVE + ARC + "[limits]\nslip_ratio = nan\n", "slip_ratio"),
        (DRIVE + ARC + "[sweep]\nfriction_angle_deg = '25:55'\n", "NAME=LOW:HIGH:N"),
        (DRIVE + ARC + "[sweep]\nphi = '25:55:3'\n", "friction_angle_deg"),
        (DRIVE + ARC + "[sweep]\nfriction_angle_deg = '25:95:3'\n", "friction_angle_deg"),
        (DRIVE + ARC + "[start]\nx_m = nan\n", "finite"),
        (DRIVE + ARC + "[extra]\n", "'extra'"),
        ("not toml", "TOML"),
    ],
)
def test_a_bad_plan_is_one_line_that_says_what_to_do(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        read_plan(path)
    assert says in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_no_file_is_no_plan(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(DataError):
            read_plan(path)


def test_a_rover_can_refuse_a_plan(yutu2: Rover) -> None:
    plan = read_plan()
    check_plan(plan, yutu2)
    with pytest.raises(ParameterError, match=r"at most 0\.055"):
        check_plan(dataclasses.replace(plan, speed_m_s=0.06), yutu2)
    with pytest.raises(ParameterError, match="turning centre"):
        check_plan(dataclasses.replace(plan, legs=(Leg(1.0, 3.0),)), yutu2)


def test_a_bad_leg_is_told_by_its_number(tmp_path: Path, yutu2: Rover) -> None:
    path = tmp_path / "plan.toml"
    good = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1\n[[leg]]\n"
    for leg, says in (("length_m = nan", "length_m is nan"), ("turn = 30", "'turn' is not a key")):
        path.write_text(good + leg)
        with pytest.raises(DataError, match="leg 2: ") as caught:
            read_plan(path)
        assert says in str(caught.value)
    path.write_text(good + "length_m = 1\ncurvature_per_m = 50")
    with pytest.raises(ParameterError, match=r"plan\.toml: leg 2: curvature_per_m is 50"):
        check_plan(read_plan(path), yutu2)


@pytest.mark.parametrize("text", ["", "a", "friction_angle_deg=1:2", "friction_angle_deg=2:1:3", "cohesion_pa=1:2:1"])
def test_a_bad_sweep_is_refused(text: str) -> None:
    with pytest.raises(ParameterError):
        parse_sweep(text)


def test_a_sweep_reads_back() -> None:
    sweep = parse_sweep("lateral_modulus_mm=15:45:9")
    assert (sweep.name, sweep.low, sweep.high, sweep.count) == ("lateral_modulus_mm", 15.0, 45.0, 9)
    assert str(parse_sweep("cohesion_pa=520:520:1")) == "520:520:1"


def test_the_path_is_the_integral_of_its_heading(yutu2: Rover) -> None:
    """Quadrature of cos and sin of the heading, against the exact chords."""
    plan = dataclasses.replace(read_plan(), x_m=1.0, y_m=2.0, heading_deg=30.0)
    s = np.linspace(0.0, plan.length_m, 200001)
    middle = 0.5 * (s[1:] + s[:-1])
    edges = np.cumsum([leg.length_m for leg in plan.legs])
    curvature = np.array([leg.curvature_per_m for leg in plan.legs])[np.searchsorted(edges[:-1], middle)]
    heading = math.radians(30.0) + np.cumsum(curvature) * s[1] - 0.5 * curvature * s[1]
    pose = make_schedule(plan, yutu2).pose_at(s / plan.speed_m_s)
    assert pose[-1, 0] == pytest.approx(1.0 + np.sum(np.cos(heading)) * s[1], abs=1e-4)
    assert pose[-1, 1] == pytest.approx(2.0 + np.sum(np.sin(heading)) * s[1], abs=1e-4)
    assert pose[-1, 2] == pytest.approx(math.radians(30.0) + sum(a.length_m * a.curvature_per_m for a in plan.legs))
    assert pose[0] == pytest.approx([1.0, 2.0, math.radians(30.0)])


def test_the_blended_curvature_turns_as_far_as_the_arcs() -> None:
    plan = read_plan()
    s = np.linspace(0.0, plan.length_m, 100001)
    blended = curvature_at(plan.legs, s, 0.2)
    turned = sum(leg.length_m * leg.curvature_per_m for leg in plan.legs)
    assert np.sum(0.5 * (blended[1:] + blended[:-1])) * s[1] == pytest.approx(turned, abs=1e-6)
    assert np.abs(np.diff(blended)).max() < 1.01 * 0.286 / 0.2 * s[1]
    assert curvature_at(plan.legs, [3.673], 0.2)[0] == pytest.approx(0.5 * (0.154 - 0.132))


def test_the_rover_file_is_checked() -> None:
    good = read_rover("yutu2")

    def changed(table: str, **entries: object) -> RoverDescription:
        tables = good.tables | {table: good.tables[table] | entries}
        return dataclasses.replace(good, tables=tables)

    assert build_rover(good).mass_kg == 135.0
    for table, entry in (
        ("mass", {"body_kg": -1.0}),
        ("mass", {"body_kg": "heavy"}),
        ("mass", {"body_inertia_kg_m2": [1.0, 2.0]}),
        ("suspension", {"rear_wheel_m": [0.5, 0.0, -0.1]}),
        ("suspension", {"front_wheel_m": [math.nan, 0.0, 0.0]}),
        ("steering", {"steered_wheels": ["fore"]}),
    ):
        with pytest.raises(DataError, match="yutu2"):
            build_rover(changed(table, **entry))
    without = dataclasses.replace(good, tables={k: v for k, v in good.tables.items() if k != "mass"})
    with pytest.raises(DataError, match="mass"):
        build_rover(without)


@pytest.mark.parametrize(("line", "source", "assumed"), [
    ('{ value = 25.0, source = "tilt table, 2024" }', "(tilt table, 2024)", False),
    ('{ value = 25.0, source = "a guess", assumed = true }', "(assumed)", True),
    ("25.0", "([limits] of ", False),
    (None, "(assumed)", True),
])  # fmt: skip
def test_a_tilt_limit_is_assumed_where_the_rover_file_says_so(
    tmp_path: Path, line: str | None, source: str, assumed: bool
) -> None:
    own = tmp_path / "rover.toml"
    own.write_text(
        re.sub("max_slope_deg = .*", "" if line is None else f"max_slope_deg = {line}", read_rover("yutu2").text)
    )
    limit = next(one for one in rover_limits(build_rover(str(own))) if one.quantity == "tilt_deg")
    assert limit.assumed == assumed and source in limit.source


@pytest.mark.parametrize(("limit", "says"), [
    ("slip_ratio = 30.0", "write a share, 0.3 for 30 %"), ("tilt_deg = 95.0", "another unit than degrees"),
    ("side_slip_deg = 100.0", "another unit than degrees"), ("battery_charge = 20.0", "write a share"),
    ("sinkage_m = 50.0", "radius of 0.15 m; is it in mm"), ("clearance_m = 50.0", "0.3 m on level ground; is it in mm"),
])  # fmt: skip
def test_a_limit_that_its_quantity_cannot_have_names_the_likely_unit(tmp_path: Path, limit: str, says: str) -> None:
    """The belly of Yutu-2 is 0.05 m above its origin, whose wheels of 0.15 m stand 0.10 m below."""
    path = tmp_path / "plan.toml"
    path.write_text(f"[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.0\n[limits]\n{limit}\n")
    with pytest.raises(LunarSciError, match=re.escape(says)):
        check_plan(read_plan(path), build_rover("yutu2"))
