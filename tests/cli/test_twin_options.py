"""What an option of `lunarsci twin` says is what is driven; what cannot be used is refused, and the result names it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.soil import read_soil
from lunarsci.rovers import MadeFor, made_for, read_rover
from lunarsci.twin.ground.soil_map import SoilMap, soil_map_bytes
from lunarsci.twin.plans.plan import read_plan

PLANNED = ("twin", "plan", "synthetic", "--extent", "8", "--spacing", "0.1", "--crater-count", "0", "--roughness", "0")
SOFT = "stiffness_kpa_m_n = 400.0\nsinkage_exponent = 1.0\ncohesion_pa = 100.0\nfriction_angle_deg = 35.0\n" + (
    "shear_modulus_mm = 17.8\nexternal_friction_angle_deg = 12.4\nlateral_modulus_mm = 20.0\n"
)
QUICK = ("--sample", "0.3", "--time-step", "0.2", "--json", "--no-time")


@pytest.fixture
def site(run, tmp_path: Path) -> Path:
    """A folder of `twin terrain` for the default rover, with a plan of 1 m."""
    folder = tmp_path / "site"
    assert run(*PLANNED, "--target", "1,0", "-o", folder, "-q").code == 0
    return folder


@pytest.fixture
def small(run, tmp_path: Path) -> Path:
    """The same for another rover."""
    folder = tmp_path / "small"
    assert run(*PLANNED, "--target", "1,0", "--rover", "small-four", "-o", folder, "-q").code == 0
    return folder


@pytest.fixture
def soft(tmp_path: Path) -> Path:
    path = tmp_path / "soft.toml"
    path.write_text(SOFT)
    return path


def driven(done: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    assert done.code in (0, 3), done.err
    document = json.loads(done.out)
    return document["result"], document["provenance"]


def tables(provenance: dict[str, Any]) -> set[str]:
    return {table["name"] for table in provenance["tables"]}


def test_a_soil_that_is_given_is_driven_whatever_the_terrain_carries(run, site: Path, soft: Path) -> None:
    predict = ("twin", "predict", site / "plan.toml", "--terrain", site / "terrain.npz", *QUICK)
    own, own_provenance = driven(run(*predict))
    done = run(*predict, "--soil", soft)
    other, provenance = driven(done)
    sinkage = [next(x["max"] for x in r["limits"] if x["quantity"] == "sinkage_m") for r in (own, other)]
    assert sinkage[1] > 1.5 * sinkage[0], "400 instead of 1443 kPa/m^N"
    assert own["soil"]["of"] == "terrain" and own["soil"]["name"] == str(site / "terrain.npz")
    assert own["soil"]["parameters"]["stiffness_kpa_m_n"] == 1443.0
    assert "soils.toml" not in tables(own_provenance) and own_provenance["options"]["soil"] is None
    assert other["soil"]["of"] == "option" and other["soil"]["name"] == str(soft)
    assert other["soil"]["parameters"]["stiffness_kpa_m_n"] == 400.0 and len(other["soil"]["replaces_of_terrain"]) == 8
    assert str(soft) in {file["path"] for file in provenance["inputs"]}
    assert any("takes the place of the soil that" in line for line in done.err)


def test_where_nobody_says_the_soil_is_the_common_one_and_named(run, short_plan: Path) -> None:
    found, provenance = driven(run("twin", "predict", short_plan, *QUICK, "--sweep", "cohesion_pa=100:500:2"))
    assert (found["soil"]["of"], found["soil"]["name"]) == ("default", "longji")
    assert provenance["options"]["soil"] == "longji" and provenance["options"]["rover"] == "yutu2"
    assert found["soil"]["drawn"] == ["cohesion_pa"] and "cohesion_pa" not in found["soil"]["parameters"]
    for option in (("--soil", "priors"), ()):
        found, _ = driven(run("twin", "predict", short_plan, "--members", "2", *option, "--json"))
        assert (found["soil"]["of"], found["soil"]["name"]) == ("priors", "priors")
    assert "soils.toml" in tables(provenance)


def test_what_the_terrain_lacks_is_filled_in_and_named(run, site: Path, short_plan: Path, tmp_path: Path) -> None:
    with np.load(site / "terrain.npz") as archive:
        kept = {key: archive[key] for key in ("x_m", "y_m", "height_m")}
    y = np.linspace(30.0, 40.0, kept["y_m"].size)[:, None] + np.zeros(kept["height_m"].shape)
    np.savez(tmp_path / "part.npz", **kept, friction_angle_deg=y)
    part = ("--terrain", tmp_path / "part.npz")
    found, provenance = driven(run("twin", "forces", short_plan, *part, *QUICK))
    assert (found["soil"]["of"], found["soil"]["rest_of"]) == ("terrain", "longji")
    assert "part.npz, what it lacks of longji" in run("twin", "forces", short_plan, *part, *QUICK[:-2]).out
    assert found["soil"]["parameters"]["friction_angle_deg"] == {"low": 30.0, "high": 40.0}
    assert "soils.toml" in tables(provenance)


def test_forces_simulate_and_terrain_name_the_soil_alike(run, site: Path, soft: Path, tmp_path: Path) -> None:
    on = (site / "plan.toml", "--terrain", site / "terrain.npz")
    for command in (("twin", "forces", *on, *QUICK), ("twin", "simulate", *on, "--json")):
        assert driven(run(*command))[0]["soil"]["of"] == "terrain"
        assert driven(run(*command, "--soil", soft))[0]["soil"]["name"] == str(soft)
    again = ("twin", "terrain", site / "terrain.npz", "--json", "-q")
    assert driven(run(*again, "--soil", soft, "-o", tmp_path / "soft"))[0]["soil"]["name"] == str(soft)
    with np.load(tmp_path / "soft" / "terrain.npz") as archive:
        assert float(archive["stiffness_kpa_m_n"]) == pytest.approx(400.0)
    kept, provenance = driven(run(*again, "-o", tmp_path / "kept"))
    assert kept["soil"]["of"] == "terrain" and "soils.toml" not in tables(provenance)


def test_soils_that_leave_no_room_for_another_are_refused(run, short_plan: Path, soft: Path, tmp_path: Path) -> None:
    belief, soil_map, samples = tmp_path / "b.json", tmp_path / "m.json", tmp_path / "s.csv"
    belief.write_text(first_belief().to_json())
    soil_map.write_bytes(soil_map_bytes(SoilMap(reach_m=0.5)))
    names = ("stiffness_kpa_m_n", "sinkage_exponent", "sinkage_exponent_slip", "cohesion_pa", "friction_angle_deg",
             "shear_modulus_mm", "external_friction_angle_deg", "lateral_modulus_mm")  # fmt: skip
    samples.write_text(",".join(names) + "\n" + ",".join(str(getattr(read_soil("longji"), n)) for n in names) + "\n")
    for others in (belief, samples, soil_map):
        done = run("twin", "predict", short_plan, "--soil", soft, "--soil", others)
        assert (done.code, done.out, len(done.err)) == (2, "", 1) and "leave it out" in done.err[0], others
    found, provenance = driven(run("twin", "predict", short_plan, "--soil", samples, *QUICK))
    assert (found["soil"]["of"], found["soil"]["name"]) == ("samples", str(samples))
    assert "soils.toml" not in tables(provenance)
    done = run("twin", "simulate", short_plan, "--soil", belief)
    assert done.code == 2 and "the truth is one soil" in done.err[0]


def test_a_plan_for_another_rover_is_not_driven_by_the_default_one(run, small: Path) -> None:
    plan = read_plan(small / "plan.toml")
    assert plan.made_for is not None and plan.made_for.rover == "small-four"
    limits = {limit.quantity: limit.limit for limit in plan.limits}
    assert (limits["sinkage_m"], limits["tilt_deg"]) == (pytest.approx(0.025), 15.0), "a third of its wheel, its slope"
    assert plan.made_for.limits["max_slope_deg"] == 15.0
    on = (small / "plan.toml", "--terrain", small / "terrain.npz")
    for command in ("predict", "forces", "simulate"):
        done = run("twin", command, *on)
        assert (done.code, done.out, len(done.err)) == (2, "", 1) and "give --rover small-four" in done.err[0]
    found, _ = driven(run("twin", "predict", *on, "--rover", "small-four", *QUICK))
    assert found["made_for"]["plan"]["kinship"] == "same" and found["rover"].startswith("four-wheeler")
    done = run("twin", "predict", *on, "--rover", "yutu2", *QUICK)
    found, provenance = driven(done)
    assert [found["made_for"][what]["kinship"] for what in ("plan", "terrain")] == ["other", "other"]
    assert len([text for text in provenance["warnings"] if "not for Yutu-2" in text]) == 2
    assert sum("not for Yutu-2" in line for line in done.err) == 2


def test_what_differs_in_a_rover_of_the_same_name_is_said(run, small: Path, tmp_path: Path) -> None:
    """Another file with the name of the rover that a plan was made for."""
    text = read_rover("small-four").text
    on = ("twin", "predict", small / "plan.toml", "--terrain", small / "terrain.npz", *QUICK, "--rover")
    for changed, says in (
        (text + "\n# again\n", "limits of the ground are the same"),
        (text.replace("max_step_m = { value = 0.05", "max_step_m = { value = 0.04"), "max_step_m 0.05 then, 0.04 now"),
    ):
        (tmp_path / "mine.toml").write_text(changed)
        done = run(*on, tmp_path / "mine.toml")
        assert changed != text and done.code in (0, 3)
        assert any(f"small-four by another version of its file: {says}" in line for line in done.err), done.err


def test_the_stand_in_counts_as_named_where_it_is(run, site: Path, tmp_path: Path) -> None:
    """States of another ground: refused where no ground is named, and said where the stand-in is."""
    states = tmp_path / "states.csv"
    states.write_text("time_s,x_m,y_m,yaw_deg,ground\n0.0,0.0,0.0,0.0,there; heights 12345678\n")
    start = ("twin", "plan", "--target", "3,0.5", "--start", states)
    done = run(*start, "-q")
    assert done.code == 2 and "no ground is named" in done.err[0]
    done = run("twin", "plan", "synthetic-longji", *start[2:], "--json")
    assert done.code == 0 and any("was made on 'there'" in line for line in done.err)
    done = run("twin", "plan", "--target", "3,0.5", "--json")
    assert driven(done)[1]["options"]["terrain"] == "synthetic-longji"


def test_the_record_of_a_rover_knows_it_again() -> None:
    own = read_rover("yutu2")
    record = made_for(own, {"max_slope_deg": 11.0, "max_roughness_m": None})
    again = MadeFor.from_table(json.loads(record.to_json()))
    assert again == record and again.limits == {"max_slope_deg": 11.0}
    changed, copied = replace(own, text=own.text + "#"), replace(own, origin="mine.toml")
    assert [record.kinship(one) for one in (own, copied, changed)] == ["same", "same", "changed"]
    assert record.kinship(replace(changed, origin="mine.toml")) == record.kinship(read_rover("small-four")) == "other"


@pytest.mark.parametrize(
    "table", ["made_for = 3", '[made_for]\nrover = "a"', '[made_for]\nrover = 1\nname = "a"\nsha256 = ""']
)
def test_a_record_that_is_none_is_one_line(run, short_plan: Path, table: str) -> None:
    text = short_plan.read_text()
    short_plan.write_text(f"{table}\n{text}")
    done = run("twin", "predict", short_plan)
    assert (done.code, done.out, len(done.err)) == (1, "", 1) and "made_for" in done.err[0]


def test_limits_of_a_larger_rover_do_not_judge_a_smaller_one(run, site: Path, short_plan: Path) -> None:
    done = run("twin", "predict", site / "plan.toml", "--rover", "small-four")
    assert done.code == 2 and "sinkage_m 0.05 > 0.025, tilt_deg 20 > 15" in done.err[0]
    done = run("twin", "predict", short_plan, "--rover", "small-four", *QUICK)
    limits = {limit["quantity"]: limit["limit"] for limit in driven(done)[0]["limits"]}
    assert (limits["sinkage_m"], limits["tilt_deg"]) == (pytest.approx(0.025), 15.0)
    assert any("has no [limits]" in line for line in done.err)


def test_a_terrain_that_was_looked_at_for_another_rover_says_so(run, small: Path, short_plan: Path) -> None:
    done = run("twin", "terrain", small / "terrain.npz", "--json")
    assert driven(done)[0]["made_for"]["terrain"]["rover"] == "small-four"
    assert any("not for Yutu-2" in line for line in done.err)
    same = run("twin", "terrain", small / "terrain.npz", "--rover", "small-four", "--json")
    assert same.err == []


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("plan",), "--target says where the path shall end"),
        (("terrain", "--geotiff"), "--geotiff goes into a file"),
        (("terrain", "--soil", "longji"), "--soil goes into a file"),
        (("update", "states.csv", "--forget", "0.2"), "--forget has nothing to forget"),
    ],
)
def test_options_that_would_do_nothing_are_refused(run, arguments: tuple[str, ...], says: str) -> None:
    done = run("twin", *arguments)
    assert (done.code, done.out, len(done.err)) == (2, "", 1) and says in done.err[0]


def test_fixes_need_a_leg_after_them(run, short_plan: Path) -> None:
    done = run("twin", "predict", short_plan, "--fixes", "0.1,0.5")
    assert (done.code, done.out, len(done.err)) == (2, "", 1) and "has only one" in done.err[0]


def test_a_seed_that_draws_nothing_is_said(run, short_plan: Path) -> None:
    grid = ("twin", "predict", short_plan, "--sweep", "cohesion_pa=100:500:2", *QUICK)
    idle, drawn = run(*grid, "--seed", "3"), run(*grid, "--seed", "3", "--members", "2")
    assert any("the seed has nothing to draw" in line for line in idle.err) and drawn.err == []
    assert [driven(done)[1]["seed"] for done in (idle, drawn)] == [None, 3]


def test_gravity_is_an_option_and_stands_in_the_result(run, tmp_path: Path) -> None:
    """A rover on Earth weighs six times as much; its wheels carry that."""
    plan = tmp_path / "plan.toml"
    plan.write_text('name = "a"\n[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.6\n')
    for given, g in (((), 1.622), (("--gravity", "earth"), 9.80665), (("--gravity", "2.5"), 2.5)):
        done = run("twin", "forces", plan, "--soil", "longji", *given, "--json")
        result = json.loads(done.out)["result"]
        assert done.code == 0 and result["gravity_m_s2"] == g, done.err
        mean = sum(wheel["normal_force_n"]["mean"] for wheel in result["wheels"])
        assert mean == pytest.approx(135.0 * g, rel=0.01)
    wrong = run("twin", "predict", plan, "--gravity", "pluto")
    assert wrong.code == 2 and "--gravity" in wrong.err[0] and "moon, mars, earth" in wrong.err[0]


def test_heights_in_km_are_asked_about_and_an_option_answers(run, tmp_path: Path) -> None:
    """A slope of 12 deg whose heights are in km without a word of it: 12 m rise to 12 mm, and the drive seems level."""
    plan, ground = tmp_path / "plan.toml", tmp_path / "slope.asc"
    start = "[start]\nx_m = 10.0\ny_m = 10.0\n"
    plan.write_text(f'name = "a"\n{start}[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.6\n')
    rows = [" ".join(f"{1e-3 * np.tan(np.radians(12.0)) * 0.5 * x:.9f}" for x in range(60))] * 60
    ground.write_text("ncols 60\nnrows 60\nxllcorner 0\nyllcorner 0\ncellsize 0.5\n" + "\n".join(rows) + "\n")
    drive = ("twin", "predict", plan, "--terrain", ground, "--soil", "longji", "--exact-terrain", *QUICK)
    asked = run(*drive)
    result = json.loads(asked.out)["result"]
    assert asked.code == 3 and result["verdict"] == "not-determined"
    [question] = result["questions"]
    assert (question["likely_unit"], question["option"]) == ("km", "--height-unit km, or m if it is m")
    assert asked.err[-1].startswith("not-determined: median slope")
    assert "is it in km? (--height-unit km, or m if it is m)" in asked.err[-1]
    for answer, tilt in ((("--height-unit", "m"), 0.012), (("--as-written",), 0.012), (("--height-unit", "km"), 12.0)):
        told = json.loads(run(*drive, *answer).out)["result"]
        assert told["questions"] == [] and told["verdict"] in ("go", "no-go")
        [found] = [limit["p50"] for limit in told["limits"] if limit["quantity"] == "tilt_deg"]
        assert found == pytest.approx(tilt, abs=1.0)


def test_unknown_clearance_is_null_in_json(run, tmp_path: Path) -> None:
    """A hole between the wheels: they have ground all the way, and the belly does not."""
    plan, ground = tmp_path / "plan.toml", tmp_path / "hole.csv"
    plan.write_text('name = "a"\n[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.4\n')
    nodes = ((0.1 * x, 0.1 * y) for x in range(-20, 31) for y in range(-20, 21) if (x, y) != (2, 0))
    ground.write_text("x_m,y_m,height_m\n" + "".join(f"{x:.1f},{y:.1f},0\n" for x, y in nodes))
    done = run("twin", "predict", plan, "--terrain", ground, "--soil", "longji", *QUICK)
    result = json.loads(done.out)["result"]
    [clearance] = [limit for limit in result["limits"] if limit["quantity"] == "clearance_m"]
    assert done.code == 3 and result["verdict"] == "no-go" and result["outcomes"] == {"finished": 1}
    assert clearance["min"] is None and not clearance["ok"]
    assert any(
        "height of the ground below the body is not known in 1 of 1 drives" in text for text in result["reasons"]
    )
