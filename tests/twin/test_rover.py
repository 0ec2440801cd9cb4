"""Questions about numbers that would be likely in another unit, and verdicts that wait for the answer."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from lunarsci.regolith.prior import SLIPS, Law, question
from lunarsci.regolith.soil import soil_tables
from lunarsci.twin.ground.finer_ground import terrain_questions
from lunarsci.twin.ground.synthetic import synthetic_longji, synthetic_terrain
from lunarsci.twin.jobs.predict import predict
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover, build_rover, rover_questions

PLAN = Plan(name="short", legs=(Leg(1.0),), speed_m_s=0.05)
QUICK = {"time_step": 0.2, "sample": 0.25}


def test_another_unit_must_be_a_hundred_times_likelier() -> None:
    """Of a normal logarithm about ln 1, sd 1, a reading 10 times less is likelier by exp((z^2 - (z - ln 10)^2) / 2)."""
    law, tenth = Law("ln", 1.0, 1.0), {"tenths": 0.1}
    edge = (math.log(1.0 / SLIPS) + 0.5 * math.log(10.0) ** 2) / math.log(10.0)
    below, above = (question("x", math.exp(edge + step), law, tenth) for step in (-1e-6, 1e-6))
    assert below is None and above is not None and above.likely_unit == "tenths" and "is it in tenths?" in str(above)
    assert question("x", 0.0, law, tenth) is None
    # Without another unit only what is rarer than a slip anywhere in six decades, with odds of 0.01, is asked about.
    rare = math.sqrt(-2.0 * math.log(SLIPS / (6.0 * math.log(10.0)) * math.sqrt(2.0 * math.pi)))
    assert question("x", math.exp(rare - 1e-6), law, {}) is None
    asked = question("x", math.exp(rare + 1e-6), law, {})
    assert asked is not None and "is it meant so?" in str(asked)


@pytest.mark.parametrize(("factor", "unit"), [(1.0, None), (1e-3, "km"), (100.0, "cm"), (1000.0, "mm")])
def test_heights_in_another_unit_are_asked_about(factor: float, unit: str | None) -> None:
    """Craters on a slope of 8 deg, in nodes of 0.25 to 1 m."""
    for spacing in (0.25, 1.0):
        ground = synthetic_terrain(spacing_m=spacing, extent_m=80.0, slope_deg=8.0, craters=40)
        asked = terrain_questions(dataclasses.replace(ground, height_m=factor * ground.height_m))
        found = [one.likely_unit for one in asked]
        assert found == ([] if unit is None else [unit]) or (factor > 1 and found[0] in ("cm", "mm"))


def test_sound_ground_and_rovers_are_not_asked_about() -> None:
    """Level ground, too: 0 has no unit, and ground may be as level as it will."""
    for slope in (0.0, 0.2, 0.5, 3.0, 12.0, 25.0):
        for spacing in (0.05, 0.2, 1.0):
            ground = synthetic_terrain(spacing_m=spacing, extent_m=20.0, slope_deg=slope, craters=0, rms_m=0.0)
            assert not terrain_questions(ground)
            assert not terrain_questions(synthetic_terrain(spacing_m=spacing, extent_m=20.0, slope_deg=slope))
    assert not terrain_questions(synthetic_longji())
    assert not any(rover_questions(build_rover(name)) for name in ("yutu2", "small-four"))


def test_rovers_with_another_unit_are_asked_about(yutu2: Rover) -> None:
    assert yutu2.body is not None
    high = dataclasses.replace(yutu2, body=dataclasses.replace(yutu2.body, belly_z_m=5.0))
    assert "belly over the ground" in str(rover_questions(high)[0])
    light = dataclasses.replace(yutu2, body_kg=0.105, wheel_kg=0.005, body_inertia_kg_m2=(0.0175, 0.0284, 0.0284))
    assert "radius x width" in str(rover_questions(light)[0])
    names = ("front_wheel_m", "bogie_pivot_m", "middle_wheel_m", "rear_wheel_m")
    places = {name: (100.0 * getattr(yutu2, name)[0], *getattr(yutu2, name)[1:]) for name in names}
    [far] = rover_questions(dataclasses.replace(yutu2, **places))
    assert far.quantity == "axle to axle [wheel radii]" and far.likely_unit == "cm"


def soil_file(folder: Path, **changes: float) -> str:
    values = {name: value for name, value in soil_tables()["longji"].items() if isinstance(value, float)} | changes
    path = folder / "soil.toml"
    path.write_text("\n".join(f"{name} = {value}" for name, value in values.items()))
    return str(path)


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_a_verdict_waits_for_the_answer(tmp_path: Path) -> None:
    """A shear modulus of 1.78 cm, written as if in mm; the drive itself is as safe as may be."""
    strange = soil_file(tmp_path, shear_modulus_mm=1.78)
    asked = predict(PLAN, soil=(strange,), **QUICK)
    assert asked.verdict.verdict == "not-determined" and asked.untrusted.startswith("not-determined: ")
    [one] = asked.to_dict()["questions"]
    assert one["likely_unit"] == "cm" and one["value"] == 1.78 and one["option"] == "--as-written"
    answered = predict(PLAN, soil=(strange,), as_written=True, **QUICK)
    assert answered.verdict.verdict in ("go", "no-go") and answered.to_dict()["questions"] == []
    assert np.array_equal(answered.prediction.paths, asked.prediction.paths)
    assert predict(PLAN, soil=(soil_file(tmp_path),), **QUICK).verdict.verdict == "go"
