"""The regolith from Python: tables in, results with units out, the same as the commands give."""

import io
import itertools
import json
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from astropy import units
from scipy import stats

from lunarsci import compare_soils, identify, infer, wheel_forces
from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.regolith.figure import PARAMETER_LABELS
from lunarsci.regolith.identify import Estimate, agreement
from lunarsci.regolith.integrals import integrated_forces
from lunarsci.regolith.jobs.identify import IdentifiedSoil
from lunarsci.regolith.jobs.infer import InferredSoil
from lunarsci.regolith.jobs.requests import WheelForcesRequest
from lunarsci.regolith.jobs.wheel_forces import contact_model
from lunarsci.regolith.prior import CONTACT, PARAMETERS
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import Wheel


@pytest.fixture(scope="module")
def states() -> pd.DataFrame:
    """Synthetic: what the closed form of lunar-typical soil gives at eight states."""
    rows = [wheel_forces(sinkage=0.008 + 0.001 * k, slip=0.05 * k, side_slip=1.0 + k).rows()[0] for k in range(8)]
    return pd.DataFrame(rows)


@pytest.fixture(scope="module")
def identified(states: pd.DataFrame) -> IdentifiedSoil:
    return identify(states, rover="yutu2", lateral_modulus=20, draws=64, sensitivity=True)


@pytest.fixture(scope="module")
def inferred(states: pd.DataFrame) -> InferredSoil:
    return infer(states, rover="yutu2", draws=16)


def test_forces_have_units_and_a_request_can_be_changed() -> None:
    asked = WheelForcesRequest(load=36.5, slip=0.2)
    found = wheel_forces(asked)
    table = found.to_table()
    assert table["normal_force_n"].unit == units.N and table["resistance_torque_nm"].unit == units.N * units.m
    assert found.forces.normal_force_n == pytest.approx(36.5)
    assert found.untrusted == "" and "drawbar pull" in found._repr_html_()
    softer = wheel_forces(asked, stiffness=500.0)
    assert softer.sinkage_m > found.sinkage_m and softer.soil.stiffness_kpa_m_n == 500.0


@pytest.mark.parametrize("choice", [{}, {"slip_sinkage": "lyasko"}, {"shear": "ellipse", "side_slip": 5.0}])
def test_a_curve_over_slip_is_what_each_slip_alone_gives(choice: dict[str, object]) -> None:
    curve = wheel_forces(load=30.0, slip="0:0.6:7", **choice)
    assert [row["slip_ratio"] for row in curve.rows()] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6], abs=1e-15)
    for row in curve.rows():
        alone = wheel_forces(load=30.0, slip=row["slip_ratio"], **choice).rows()[0]
        assert alone == {key: row[key] for key in alone}
    assert len(curve.to_table()) == 7 and "states" in curve.to_dict() and curve.figures()


def test_figures_of_traction_are_those_of_their_definitions() -> None:
    """Each looked up again by a call of its own: no pull, 20 % slip, and the slope on which nothing is left to pull."""
    curve = wheel_forces(load=30.0, slip="-0.1:0.6:71")
    found = curve.traction
    assert found is not None and found.slope_at_20_deg is not None and found.self_propelled_slip is not None
    at_20 = wheel_forces(load=30.0, slip=0.2)
    pull, torque = float(at_20.forces.drawbar_pull_n), float(at_20.forces.resistance_torque_nm)
    assert found.pull_at_20_n == pytest.approx(pull) and found.pull_per_weight_at_20 == pytest.approx(pull / 30.0)
    work = pull * 1.0 / (torque * 1.0 / (at_20.wheel.shearing_radius_m * (1.0 - 0.2)))  # over a metre of way
    assert found.efficiency_at_20 == pytest.approx(work) and 0 < work < 0.8
    assert abs(float(wheel_forces(load=30.0, slip=found.self_propelled_slip).forces.drawbar_pull_n)) < 0.01
    angle = np.radians(found.slope_at_20_deg)
    uphill = wheel_forces(load=30.0 * np.cos(angle), slip=0.2)
    assert float(uphill.forces.drawbar_pull_n) == pytest.approx(30.0 * np.sin(angle), abs=1e-4)
    efficiencies = [row["tractive_efficiency"] for row in curve.rows()]
    assert efficiencies[0] is None and found.best_efficiency == max(filter(None, efficiencies))


@pytest.mark.filterwarnings("ignore:the soil. friction_angle_deg is 5")
def test_a_wheel_that_cannot_pull_climbs_nothing_and_has_no_efficiency() -> None:
    found = wheel_forces(load=30.0, slip="0:0.3:4", cohesion=0.0, friction_angle=5.0).traction
    assert found is not None and found.pull_at_20_n < 0
    assert (found.slope_at_20_deg, found.efficiency_at_20, found.self_propelled_slip) == (None, None, None)
    assert found.best_efficiency is None


@pytest.mark.parametrize("slip", ["0.3:0.1:5", "0:0.5:1", "0:0.5:2.5", "0:0.5", "a:b:3", "fast", "0:0.5:1000000"])
def test_a_curve_that_is_none_is_refused(slip: str) -> None:
    with pytest.raises(RequestError, match="FIRST:LAST:N"):
        wheel_forces(load=30.0, slip=slip)


def test_shares_of_grip_need_the_integrals_and_have_them_without_being_asked() -> None:
    assert contact_model(WheelForcesRequest(load=36.5)) is None
    for choice in ({"exact": True}, {"shear": "ellipse"}, {"bulldozing": "wong"}, {"rebound": 0.0}):
        assert contact_model(WheelForcesRequest(load=36.5, **choice)) is not None


def test_a_soil_is_found_again_in_its_forces(identified: IdentifiedSoil) -> None:
    """K_s of lunar-typical soil at its exponent of 1."""
    from lunarsci.regolith.soil import read_soil

    site = identified.identification.site
    assert site["stiffness_kpa_m_n"].value == pytest.approx(read_soil("lunar-typical").stiffness_kpa_m_n, rel=0.25)
    assert len(identified.rows()) == 8 and "sigma_m_pa" in identified.rows()[0]
    table = identified.to_table()
    told = table[table["parameter"] == "stiffness_kpa_m_n"][0]
    assert told["value"] == site["stiffness_kpa_m_n"].value and told["unit"] == "kPa/m^N" and not told["assumed"]
    assert {"alone", "saved"} <= set(identified.to_dict()["sensitivity"][0])
    assert json.loads(identified.to_json(time=False))["schema"] == "lunarsci/regolith-identify/1"


def test_all_states_together_keep_what_each_says(inferred: InferredSoil) -> None:
    made = inferred.to_dict()
    assert {"bearing", "shear", "lateral", "observations", "joint"} <= set(made)
    assert len(made["joint"]["laws"]) == 7 and made["joint"]["predicted"] is None
    rows = inferred.soils(".csv").decode().splitlines()
    assert rows[0].startswith("# verdict of the fit: ") and len(rows) == 2 + len(inferred.posterior.draws)
    values = np.array([float(cell) for cell in rows[2].split(",")])
    assert np.array_equal(values, inferred.posterior.draws[0][:8])
    assert json.loads(inferred.soils(".json"))["schema"] == "lunarsci/soil-belief/1"


def rig_states(seed: int, loads: tuple[float, ...]) -> pd.DataFrame:
    """Synthetic: the integrals for a smooth wheel on dry sand whose largest stress lies far ahead, with noise."""
    wheel = Wheel(radius_m=0.12, width_m=0.1, grouser_height_m=0, max_stress_c1=0.18, max_stress_c2=0.32, exit_c3=0)
    soil = Soil(**RIG, external_friction_angle_deg=20.0, lateral_modulus_mm=20.0)
    rng = np.random.default_rng(seed)
    slip, depth = np.array([0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5]), np.linspace(1e-3, 0.04, 400)
    rows = []
    for load, s in itertools.product(loads, slip):
        found = integrated_forces(wheel, soil, depth, np.full_like(depth, s), np.zeros_like(depth))
        z = np.interp(load, found.normal_force_n, depth)
        rows.append((z, s, load, np.interp(z, depth, found.drawbar_pull_n)))
    values = np.array(rows) + rng.normal(0, [3e-4, 0, 0.5, 0.5], (len(rows), 4))
    table = pd.DataFrame(values, columns=["sinkage_m", "slip_ratio", "normal_force_n", "drawbar_pull_n"])
    return table.assign(sinkage_m_sigma=3e-4, normal_force_n_sigma=0.5, drawbar_pull_n_sigma=0.5)


RIG = {
    "stiffness_kpa_m_n": 900.0,
    "sinkage_exponent": 1.05,
    "cohesion_pa": 250.0,
    "friction_angle_deg": 33.0,
    "shear_modulus_mm": 15.0,
}


@pytest.mark.parametrize(("seed", "loads"), [(1, (40, 80, 120)), (2, (40, 80, 120)), (2, (40,)), (8, (40,))])
def test_a_wheel_of_other_contact_angles_gives_no_wrong_soil_that_counts_as_determined(
    seed: int, loads: tuple[float, ...], tmp_path: Path
) -> None:
    """The closed form, with the angles of the wheel's file, finds K_x = 10.3 +- 0.4 mm in place of 15."""
    rover = tmp_path / "wheel.toml"
    rover.write_text("name = 'rig'\n[wheel]\nradius_m = 0.12\nwidth_m = 0.1\ngrouser_height_m = 0\n")
    states = rig_states(seed, loads)
    found = infer(states, rover=str(rover), gravity=9.81)
    assert found.untrusted == "" and found.posterior.verdict.model.endswith("contact angles")
    for row in found.rows():
        if row["parameter"] in RIG:
            assert row["low95"] <= RIG[row["parameter"]] <= row["high95"], row
    assert ("shear_modulus_mm" in found.posterior.determined) == (len(loads) > 1)
    closed = infer(states, rover=str(rover), gravity=9.81, law="given")
    assert any("contact angles of the wheel as known" in said for said in closed.posterior.verdict.assumed)


def test_a_law_that_is_named_is_taken(states: pd.DataFrame) -> None:
    named: list[tuple[dict[str, Any], str]] = [
        ({"law": "given"}, "closed"),
        ({"exact": True}, "separate"),
        ({"shear": "ellipse"}, "ellipse"),
    ]
    for options, model in named:
        found = infer(states, rover="yutu2", draws=16, **options)
        assert found.posterior.verdict.model == model and not found.scores


def test_a_site_is_compared_as_an_object_or_as_numbers(identified: IdentifiedSoil) -> None:
    by_result = compare_soils(identified)
    assert len(by_result.rows()) == len(by_result.soils) > 30
    assert by_result.plot() is not None
    numbers = compare_soils(stiffness=by_result.site.stiffness_kpa_m_n, exponent=1.0)
    assert [soil.bearing for soil in numbers.soils] == [soil.bearing for soil in by_result.soils]


@pytest.mark.parametrize(
    ("job", "options"),
    [
        (wheel_forces, {}),
        (wheel_forces, {"load": 30.0, "sinkage": 0.01}),
        (wheel_forces, {"sinkage": 0.01, "slip_sinkage": "linear"}),
        (wheel_forces, {"load": 30.0, "lode": 1}),
        (compare_soils, {}),
    ],
)
def test_what_makes_no_sense_is_refused(job, options) -> None:
    with pytest.raises(RequestError):
        job(**options)


def test_options_of_the_inference_that_exclude_each_other(states: pd.DataFrame) -> None:
    for options in ({"sample": True, "profile": True}, {"law": "auto", "contact": True}, {"reading": "printed"}):
        with pytest.raises(RequestError):
            infer(states, **options)
    with pytest.raises(RequestError, match="`lateral_modulus` a,b"):
        identify(states, lateral_modulus="a,b")
    with pytest.raises(ParameterError, match="go together"):
        compare_soils(cohesion=500.0)


DING_2011 = """sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n
0.005,0.0,80,-6.5
0.0055,0.1,80,11
0.0075,0.2,80,14.5
0.01,0.3,80,15
0.0125,0.4,80,15
0.0175,0.6,80,15
"""
"""Smooth wheel of Ding et al. (2011), J. Terramechanics 48, 27, Fig. 9, 10.1016/j.jterra.2010.05.001, in HIT-LSS1."""


@pytest.fixture(scope="module")
def measured_wheel(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("wheel") / "hit.toml"
    file.write_text("name = 'HIT'\n[wheel]\nradius_m = 0.15735\nwidth_m = 0.165\ngrouser_height_m = 0.0\n")
    return str(file)


def test_states_that_contradict_each_other_are_not_averaged_in_silence(measured_wheel: str) -> None:
    found = identify(io.StringIO(DING_2011), rover=measured_wheel, draws=256)
    told = {item.parameter: item for item in found.agreements}
    assert told["stiffness_kpa_m_n"].trend == told["friction_angle_deg"].trend == "falls"
    assert told["friction_angle_deg"].reduced_chi_square > 50
    assert re.search(r"contradict each other \(K_s falls with slip .* use `lunarsci regolith infer`", found.untrusted)


def test_states_of_one_soil_agree(identified: IdentifiedSoil) -> None:
    assert identified.agreements and all(item.agree for item in identified.agreements)
    assert "contradict" not in identified.untrusted


def test_scatter_within_the_errors_is_no_contradiction() -> None:
    """Of normal values with their errors the chi-square is that of the law; a hundredfold smaller error contradicts."""
    rng = np.random.default_rng(4)
    values = rng.normal(40, 3, 200)
    ours = agreement("friction_angle_deg", [Estimate(v, 3.0) for v in values], np.arange(200.0))
    assert ours is not None and ours.agree and ours.trend == ""
    assert ours.reduced_chi_square == pytest.approx(np.var(values, ddof=1) / 9)
    assert ours.probability == pytest.approx(stats.chi2.sf(199 * ours.reduced_chi_square, 199))
    close = agreement("friction_angle_deg", [Estimate(v, 0.03) for v in values], np.arange(200.0))
    assert close is not None and not close.agree


@pytest.mark.parametrize(("step", "trend"), [(0.3, "rises"), (-0.3, "falls"), (1e-12, "")])
def test_a_trend_within_the_errors_is_seen_and_one_of_the_last_digits_is_none(step: float, trend: str) -> None:
    values = 30 + step * np.arange(20.0)
    ours = agreement("friction_angle_deg", [Estimate(v, 3.0) for v in values], np.arange(20.0))
    assert ours is not None and ours.agree and ours.trend == trend


WHEELS = ("FL", "FR", "ML", "MR", "RL", "RR")


@pytest.mark.parametrize(("wheels", "load_n"), [((), 36.0), (WHEELS, 36.0), (WHEELS, 80.0)])
def test_states_of_an_unnamed_rover_are_said_to_have_the_wheel_of_yutu2(wheels: tuple[str, ...], load_n: float) -> None:
    """Names and loads like Yutu-2's, 135 kg at 1.622 m/s² on six wheels, 36.5 N each, may be those of another."""
    table = pd.DataFrame({"sinkage_m": [0.008] * 6, "normal_force_n": load_n, "drawbar_pull_n": -1.3})
    if wheels:
        table["wheel"] = [wheels[k % len(wheels)] for k in range(6)]
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        found = identify(table, draws=2)
    said = [str(one.message) for one in heard if "no rover is named" in str(one.message)]
    assert len(said) == 1 and f"36 N on each, here {load_n:g} N" in said[0] and "with `rover`" in said[0]
    assert found.to_dict()["wheel"]["named_by"] == "default"
    assert found.rover == "yutu2" and json.loads(found.to_json())["provenance"]["options"]["rover"] == "yutu2"
    assert "with the wheel of yutu2 (the default)" in found.to_text()
    named = identify(table, rover="yutu2", draws=2).to_dict()
    assert named.pop("wheel") == found.to_dict()["wheel"] | {"named_by": "option"}
    assert named.items() <= found.to_dict().items()


def states_of(rover: str) -> pd.DataFrame:
    columns = ["sinkage_m", "slip_ratio", "normal_force_n", "drawbar_pull_n", "rover"]
    return pd.DataFrame(wheel_forces(rover=rover, load=60.0, slip="0.1:0.5:4").rows())[columns]


def test_states_that_name_their_rover_are_read_for_it_or_refused(tmp_path: Path) -> None:
    forces = states_of("hit-smooth")
    assert set(forces["rover"]) == {"hit-smooth; wheels 157.35 x 165 mm"}
    found = identify(forces, draws=2)
    assert found.rover == "hit-smooth" and found.wheel.width_m == 0.165
    assert "with the wheel of hit-smooth (named in the table)" in found.to_text()
    with pytest.raises(
        DataError, match=r"for 'hit-smooth; wheels 157\.35 x 165 mm', and is read for wheels 150 x 150 mm"
    ):
        identify(forces, rover="yutu2", draws=2)
    own = tmp_path / "own.toml"
    own.write_text('name = "Own, of ours"\n[wheel]\nradius_m = 0.11\nwidth_m = 0.1\n')
    ours = states_of(str(own))
    with pytest.raises(DataError, match="'Own of ours; wheels 110 x 100 mm', which lunarsci does not have; give the"):
        identify(ours, draws=2)
    assert identify(ours, rover=str(own), draws=2).wheel.radius_m == 0.11
    with pytest.raises(DataError, match="rows of several rovers"):
        identify(pd.concat([forces, ours]), draws=2)


def test_states_without_forces_name_the_ways_on() -> None:
    table = pd.DataFrame({"time_s": [0.0], "wheel": ["FL"], "sinkage_m": [0.008], "slip_ratio": [0.1]})
    with pytest.raises(DataError, match=r"without forces; `lunarsci twin update` .* `lunarsci twin loads --motion"):
        infer(table)


def test_every_parameter_of_a_contact_has_its_words_in_the_picture() -> None:
    assert set(PARAMETERS) | set(CONTACT) <= PARAMETER_LABELS.keys()


def test_a_comparison_takes_the_wheel_of_the_result(measured_wheel: str, tmp_path: Path) -> None:
    found = identify(io.StringIO(DING_2011), rover=measured_wheel, draws=64)
    file = tmp_path / "id.json"
    file.write_text(found.to_json())
    for given in (found, str(file)):
        assert (compare_soils(given).width_m, compare_soils(given).rover) == (0.165, measured_wheel)
    assert compare_soils(found, rover="yutu2").width_m == 0.15
    assert compare_soils(stiffness=1443.0, exponent=1.0).rover == "yutu2"


def test_all_states_are_the_answer_and_single_ones_stand_below_with_what_they_assume(
    inferred: InferredSoil, identified: IdentifiedSoil
) -> None:
    text, title = inferred.to_text(), "Each state by itself (assumes N = 1, c = 520 Pa, K_x = 17.8 mm)"
    assert text.startswith("The soil of all 8 states with the wheel of yutu2") and title in text
    assert text.index("variance left") < text.index(title) < text.index("errors are those of one state")
    assert "regolith infer" not in text
    assert identified.to_text().startswith("Each state\n") and "`lunarsci regolith infer`" in identified.to_text()


def test_single_states_that_differ_speak_against_their_assumptions_alone(measured_wheel: str) -> None:
    found = infer(io.StringIO(DING_2011), rover=measured_wheel, draws=64)
    said = next(line for line in found.to_text().splitlines() if line.startswith("solved so, the states differ"))
    assert "K_s falls with slip" in said and said.endswith("tests what single states assume, not the soil above")
    assert f"with the wheel of HIT ({measured_wheel})" in found.to_text()
    assert "wheel.max_stress_c1" in found.to_dict()["assumed_of_rover"]


def test_distances_have_the_range_that_the_posterior_leaves(inferred: InferredSoil) -> None:
    """By draws of the posterior itself, and p = K_s z^N over 5-20 mm in ln p, whose mean square has a closed form."""
    found = compare_soils(inferred)
    stiffness, exponent = inferred.posterior.draws[:, :2].T
    depths = np.log(np.linspace(0.005, 0.02, 16))
    for item in [one for one in found.soils if one.bearing is not None][:5]:
        level = np.log(item.soil.stiffness(found.width_m) / stiffness)
        slope = item.soil.sinkage_exponent - exponent
        square = level**2 + 2 * level * slope * depths.mean() + slope**2 * np.mean(depths**2)
        expected = np.quantile(np.sqrt(square), (0.15865, 0.84135))
        assert item.bearing_range == pytest.approx(expected, rel=0.15, abs=0.02)
    assert all(one.strength_range[0] <= one.strength_range[1] for one in found.soils if one.strength is not None)


def test_a_comparison_says_what_is_not_determined(inferred: InferredSoil, identified: IdentifiedSoil) -> None:
    found = compare_soils(inferred).to_dict()
    rows = {row["parameter"]: row for row in inferred.rows()}
    for aspect, names in (
        ("bearing", ("stiffness_kpa_m_n", "sinkage_exponent")),
        ("strength", ("cohesion_pa", "friction_angle_deg")),
    ):
        left = {name: 1 - rows[name]["shrinkage"] for name in names if not rows[name]["determined"]}
        told = {one["parameter"]: one["left_of_prior"] for one in found["undetermined"][aspect]}
        assert left and told == pytest.approx(left)
        assert any(
            text.startswith(("bearing", "shear strength")) and "not determined" in text for text in found["remarks"]
        )
    assert "n1 = " in found["remarks"][-1] and found["remarks"][-1] in compare_soils(inferred).to_text()
    assert compare_soils(identified).to_dict()["remarks"] == []


def test_the_posterior_is_the_table_and_the_first_picture(inferred: InferredSoil) -> None:
    table = inferred.to_table()
    assert list(table["parameter"]) == list(inferred.posterior.names)
    for row in table:
        law = inferred.posterior.prior[row["parameter"]]
        assert row["prior_median"] == pytest.approx(law.median)
        inside = stats.norm.cdf(law.transformed(row["prior_high95"]), law.center, law.width)
        assert inside == pytest.approx(0.975, abs=1e-6)
        assert row["low95"] < row["low68"] < row["median"] < row["high68"] < row["high95"]
    panels = inferred.plot().axes
    assert len(panels) == len(table) and "friction angle" in panels[4].get_xlabel()
