"""Soils of the members from a table."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.regolith.belief import FitVerdict, first_belief, verdict_line
from lunarsci.twin.ground.driven_soil import read_soil_samples
from lunarsci.twin.jobs.drive_inputs import DriveInputs, Soils, read_drive_inputs
from lunarsci.twin.plans.plan import Sweep
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import predict

TABLE = "friction_angle_deg,lateral_modulus_mm\n30,15\n35,25\n45,40\n"


def test_samples_drive_like_the_sweeps_of_the_same_values(tmp_path: Path, yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "soils.csv"
    path.write_text(TABLE)
    samples = read_soil_samples(path)
    assert samples["friction_angle_deg"].tolist() == [30.0, 35.0, 45.0]
    ground, plan = slope(-0.05, 0.05), straight(1.0, 0.1)
    given = predict(yutu2, ground, plan, samples=samples)
    for m, (phi, modulus) in enumerate(((30.0, 15.0), (35.0, 25.0), (45.0, 40.0))):
        sweep = (Sweep("friction_angle_deg", phi, phi, 1), Sweep("lateral_modulus_mm", modulus, modulus, 1))
        assert np.array_equal(predict(yutu2, ground, plan, sweep=sweep).paths[0], given.paths[m])


def test_fewer_members_are_drawn_by_the_seed_without_repetition(tmp_path: Path) -> None:
    path = tmp_path / "soils.csv"
    path.write_text("cohesion_pa\n" + "".join(f"{c}\n" for c in range(100)))
    drawn = [read_soil_samples(path, 30, seed)["cohesion_pa"] for seed in (1, 1, 2)]
    assert np.array_equal(drawn[0], drawn[1]) and not np.array_equal(drawn[0], drawn[2])
    assert len(set(drawn[0])) == 30
    with pytest.raises(DataError, match="at most 100"):
        read_soil_samples(path, 101)


def test_blanks_and_a_byte_order_mark_are_no_part_of_a_name(tmp_path: Path) -> None:
    path = tmp_path / "soils.csv"
    path.write_bytes(b"\xef\xbb\xbffriction_angle_deg , cohesion_pa\r\n35, 500\r\n")
    samples = read_soil_samples(path)
    assert (samples["friction_angle_deg"].tolist(), samples["cohesion_pa"].tolist()) == ([35.0], [500.0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("phi\n30\n", "friction_angle_deg"),
        ("friction_angle_deg\n", "a row for each"),
        ("friction_angle_deg\n95\n", "friction_angle_deg"),
        ("friction_angle_deg\nloose\n", "loose"),
        ("friction_angle_deg\n30\nnan\n", "friction_angle_deg"),
        ("friction_angle_deg\n30\ntrue\n", "row 2, friction_angle_deg: 'true' is no number"),
        ("friction_angle_deg\n30\ninf\n", "row 2"),
        ("friction_angle_deg,cohesion_pa\n30,500,7\n31,500,7\n", "line 2: 3 fields"),
        ("cohesion_pa,cohesion_pa\n1,2\n", "two columns are called 'cohesion_pa'"),
        ("friction_angle_deg\n30\n95\n31\n", "row 2"),
        ("", "is empty"),
    ],
)
def test_a_bad_table_is_one_line_that_names_it(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "soils.csv"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        read_soil_samples(path)
    assert says in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_given_soils_leave_no_room_for_a_sweep(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    for extra in ({"members": 2}, {"sweep": ()}):
        with pytest.raises(ParameterError, match="leave out"):
            predict(yutu2, slope(), straight(1.0), samples={"cohesion_pa": [1.0]}, **extra)
    with pytest.raises(ParameterError, match="one value of each"):
        predict(yutu2, slope(), straight(1.0), samples={"cohesion_pa": [1.0], "friction_angle_deg": [30.0, 31.0]})


def read_with_law(tmp_path: Path, model: str, kind: str) -> DriveInputs:
    """Inputs of a drive on soils that a trusted fit by a law gave."""
    fit = FitVerdict(
        trusted=True, reason="", model=model, model_error=(0.01, 0.01, 0.01), model_error_from="residuals",
        reduced_chi_square=1.0,
    )  # fmt: skip
    path = tmp_path / f"soils{kind}"
    path.write_text(verdict_line(fit) + TABLE if kind == ".csv" else replace(first_belief(), verdict=fit).to_json())
    return read_drive_inputs(None, "yutu2", None, soil=str(path))


@pytest.mark.parametrize("kind", [".csv", ".json"])
def test_soils_of_another_law_than_the_twins_are_named(tmp_path: Path, kind: str) -> None:
    """A fit with open contact angles was driven with those of the rover's file: slip 0.34 where 0.27 was true."""
    for model, lost in (("separate + contact angles", True), ("combined", False)):
        with pytest.warns(LunarSciWarning, match="inferred by the law") as heard:
            found = read_with_law(tmp_path, model, kind)
        (said,) = [str(one.message) for one in heard if "inferred" in str(one.message)]
        assert f"law '{model}'" in said and ("does not keep" in said) == lost and "the law 'given'" in said
        assert said in found.remarks and found.soil_record()["caution"] == said
        assert Soils.of(found, None, 3, 1).doubt.reasons == (said,)


@pytest.mark.parametrize("kind", [".csv", ".json"])
def test_soils_of_the_twins_own_law_need_no_word(tmp_path: Path, kind: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_with_law(tmp_path, "closed", kind)
    assert not any("law" in text for text in found.remarks) and "caution" not in found.soil_record()
    assert not Soils.of(found, None, 3, 1).doubt
