"""Contact angles and effective radius of the wheels as unknowns: in drives, beliefs, updates and predictions."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.belief import first_belief, read_belief
from lunarsci.regolith.belief_history import contact_rows, parameter_rows, past_beliefs, with_drive
from lunarsci.regolith.prior import PARAMETERS, ROLLING
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.assimilation.drive_record import OBSERVED, DriveRecord, states_at
from lunarsci.twin.assimilation.update import SlipLean, SoilUpdate, assimilate
from lunarsci.twin.ground.terrain import Terrain, build_terrain, terrain_bytes
from lunarsci.twin.jobs.predict import predict as predict_job
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

SOIL = {
    "stiffness_kpa_m_n": 1100.0,
    "sinkage_exponent": 1.0,
    "sinkage_exponent_slip": 0.1,
    "cohesion_pa": 400.0,
    "friction_angle_deg": 32.0,
    "shear_modulus_mm": 22.0,
    "external_friction_angle_deg": 14.0,
    "lateral_modulus_mm": 25.0,
}
OTHER = {"max_stress_c1": 0.32, "max_stress_c2": 0.2, "exit_c3": -0.15}
PLAN = Plan(name="bends", legs=(Leg(2.0, 0.15), Leg(2.0, -0.15)), speed_m_s=0.05)
SLIP = STATE_COLUMNS.index("slip_ratio")


def sloping(degrees: float) -> Terrain:
    x, y = np.arange(-3.0, 9.1, 0.25), np.arange(-5.0, 5.1, 0.25)
    height = np.tan(np.radians(degrees)) * np.tile(x, (len(y), 1))
    return build_terrain("slope", -3.0, -5.0, 0.25, height, Soil(**SOIL))


def drive(rover: Rover, ground: Terrain, plan: Plan = PLAN, **more: float) -> Prediction:
    return predict(rover, ground, plan, samples={name: [value] for name, value in (SOIL | more).items()})


def with_wheel(rover: Rover, **changes: float) -> Rover:
    return dataclasses.replace(rover, wheel=dataclasses.replace(rover.wheel, **changes))


def median_slip(drives: Prediction) -> FloatArray:
    slips = drives.states[drives.finished][:, ~drives.halted][..., SLIP]
    return np.asarray(np.median(slips.reshape(len(slips), -1), axis=1))


def seen(
    out: Prediction, names: tuple[str, ...] = OBSERVED, wander_m: float = 0.0, travel: float = 0.04
) -> DriveRecord:
    """Every third sample with the errors that Ding et al. (2024) state, and positions that wander."""
    states, random = out.states[0, 3::3], np.random.default_rng(0)
    truth = states[..., [STATE_COLUMNS.index(name) for name in OBSERVED]].reshape(-1, 6)
    errors = MeasurementErrors(travel_relative=travel, side_slip_relative=0.04)
    sigma = np.column_stack([errors.of(name, truth[:, k]) for k, name in enumerate(OBSERVED)])
    values = truth + sigma * random.normal(size=truth.shape)
    values[:, [name not in names for name in OBSERVED]] = np.nan
    times, places = out.time_s[3::6], out.paths[0, 3::6, :2]
    wander = wander_m * np.column_stack([np.sin(times / 15.0), np.cos(times / 11.0)])
    return DriveRecord(
        time_s=np.repeat(out.time_s[3::3], 6),
        wheel=out.rover.wheels * len(states),
        values=values,
        sigmas=sigma,
        fix_time_s=times,
        fix_m=places + wander + 0.03 * random.normal(size=places.shape),
        fix_covariance_m2=np.tile(0.03**2 * np.eye(2), (len(times), 1, 1)),
    )


def test_angles_of_a_member_are_those_of_a_rover_whose_file_has_them(yutu2: Rover) -> None:
    ground = sloping(5.0)
    own, stated = drive(yutu2, ground, **OTHER), drive(with_wheel(yutu2, **OTHER), ground)
    assert np.array_equal(own.paths, stated.paths) and np.array_equal(own.states, stated.states)
    assert not np.array_equal(own.paths, drive(yutu2, ground).paths)


def test_a_larger_effective_radius_is_a_faster_rim(yutu2: Rover) -> None:
    """At the same rates a wheel whose r_s is 3 % larger drives as a stated one of that r_s commanded 3 % faster.

    r_s = r + lambda_s h. Its slip is told against the stated radius: s' = 1 - (1 - s) 1.03 where wheels drive, which
    are faster for the same rates than they are taken for.
    """
    wheel, ratio = yutu2.wheel, 1.01
    share = (ratio * wheel.shearing_radius_m - wheel.radius_m) / wheel.grouser_height_m
    larger = with_wheel(yutu2, grouser_shear_coefficient=share)
    plan = Plan(name="straight", legs=(Leg(2.0, 0.0),), speed_m_s=0.05)
    faster = dataclasses.replace(plan, legs=(Leg(2.0 * ratio, 0.0),), speed_m_s=0.05 * ratio)
    ground = sloping(4.0)
    one = drive(yutu2, ground, plan, shearing_radius_ratio=ratio)
    other = predict(larger, ground, faster, samples={k: [v] for k, v in SOIL.items()}, sample_m=0.1 * ratio)
    # Both speed up in the same time, from other speeds.
    assert np.allclose(one.paths, other.paths, rtol=0, atol=2e-4)
    assert np.abs(one.paths - drive(yutu2, ground, plan).paths).max() > 0.01
    slips = other.states[0][5:-5][..., SLIP]
    assert (slips > 0).all()
    assert np.allclose(one.states[0][5:-5][..., SLIP], 1.0 - (1.0 - slips) * ratio, rtol=0, atol=1e-4)


def test_the_largest_stress_stays_within_the_contact(yutu2: Rover) -> None:
    """Angles that rise beyond the entrance at full slip, or below the exit in skid, give forces all the same."""
    steep = drive(yutu2, sloping(0.0), max_stress_c1=0.9, max_stress_c2=0.6, exit_c3=-0.1)
    assert np.isfinite(steep.states[steep.finished]).all()


def test_a_belief_opens_its_wheel_about_the_angles_of_its_file(yutu2: Rover) -> None:
    opened = first_belief().opened(yutu2.wheel)
    assert opened.names == (*PARAMETERS, *ROLLING) and opened.opened(yutu2.wheel) is opened
    ends = opened.intervals()
    assert [ends[name][0] for name in ROLLING] == pytest.approx([0.5, 0.0, 0.0, 1.0])
    assert ends["max_stress_c1"][2] == pytest.approx(0.62) and set(opened.sd_ratio.values()) == {1.0}
    assert np.array_equal(opened.soil.mean, first_belief().mean)
    assert np.array_equal(opened.inflated(1.0).covariance, opened.covariance)
    assert list(contact_rows(opened)) == list(ROLLING) and contact_rows(first_belief()) == {}
    assert list(parameter_rows(opened)) == list(PARAMETERS)
    with pytest.raises(ParameterError, match="none or all of max_stress_c1"):
        laws = {name: opened.laws[name] for name in opened.names[:-1]}
        dataclasses.replace(opened, laws=laws, mean=opened.mean[:-1], covariance=opened.covariance[:-1, :-1])


def test_files_with_and_without_wheels_are_read(yutu2: Rover) -> None:
    old = first_belief()
    opened = dataclasses.replace(old.opened(yutu2.wheel), population=old.opened(yutu2.wheel).mean[None].repeat(3, 0))
    for belief in (old, opened):
        back = read_belief(InputFile("belief.json", belief.to_json().encode()))
        assert back.names == belief.names and np.array_equal(back.covariance, belief.covariance)
    assert set(back.draws(2)) == {*PARAMETERS, *ROLLING}
    one = with_drive(old, old, {"states": "a.csv"})
    two = with_drive(dataclasses.replace(one.opened(yutu2.wheel), history=one.history), one, {"states": "b.csv"})
    names = [None if state is None else state.names for state in past_beliefs(two)]
    assert names == [PARAMETERS, PARAMETERS, (*PARAMETERS, *ROLLING)]


@pytest.mark.slow
def test_a_healthy_drive_that_skids_on_level_ground_teaches_its_wheel(yutu2: Rover) -> None:
    """Wheels with other angles and a larger radius than their file has roll with negative slip where nothing pushes."""
    true = SOIL | OTHER | {"shearing_radius_ratio": 1.05, "stiffness_kpa_m_n": 2000.0}
    ground = sloping(0.0)
    out = drive(yutu2, ground, **true)
    assert median_slip(out)[0] < -0.015
    record = seen(out, travel=0.004)
    found = assimilate(yutu2, ground, PLAN, record, first_belief(), particles=64, model_error=0.0)
    lean, belief = SlipLean.of(record, found), found.belief
    assert not found.refused and not found.doubt and lean is not None and not lean.off
    spread = np.sqrt(np.diag(belief.covariance))
    truth = np.array([law.transformed(np.array(true[name])) for name, law in belief.laws.items()])
    assert (np.abs(belief.mean - truth) < 3.0 * spread).all()
    known = assimilate(yutu2, ground, PLAN, record, first_belief(), particles=64, model_error=0.0, wheel=False)
    back = dataclasses.replace(PLAN, legs=(Leg(4.0, 0.1),), heading_deg=90.0, y_m=-2.0)
    ahead = drive(yutu2, sloping(4.0), back, **true).endpoints_m[0]
    off = []
    for one in (known, found):
        ends = predict(yutu2, sloping(4.0), back, samples=one.belief.draws(64)).endpoints_m
        off.append(float(np.hypot(*(np.median(ends, axis=0) - ahead))))
    assert off[1] < 0.5 * off[0] or known.refused, off


def predicted(found: SoilUpdate, record: DriveRecord, slips: FloatArray, folder: Path) -> FloatArray:
    """Median slips of `twin predict`, of its drives at the measured states, as a new user comes to them."""
    terrain, belief = folder / "ground.npz", folder / "belief.json"
    terrain.write_bytes(terrain_bytes(found.prediction.terrain))
    entry = {"states": "states.csv", "ruts": found.prediction.ruts}
    belief.write_text(with_drive(found.belief, first_belief(), entry).to_json())
    assert json.loads(belief.read_text())["order"] == [*PARAMETERS, *ROLLING]
    drives = predict_job(PLAN, terrain=str(terrain), soil=(str(belief),), seed=3).prediction
    assert set(drives.parameters) == {*PARAMETERS, *ROLLING}
    states = states_at(record, drives.time_s, drives.states[drives.finished], drives.rover.wheels)
    known = np.isfinite(slips)
    return np.asarray(np.median(states[:, known, OBSERVED.index("slip_ratio")], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.0, 6.0])
def test_slip_on_the_soil_found_is_what_a_prediction_of_the_same_plan_gives(
    yutu2: Rover, tmp_path: Path, degrees: float
) -> None:
    """Positions that no soil explains widen their errors, and with them the soils: far from the best one of these."""
    out = drive(yutu2, sloping(degrees), friction_angle_deg=30.0)
    whole, record = seen(out, wander_m=0.1), seen(out, ("sinkage_m",), wander_m=0.1)
    found = assimilate(yutu2, sloping(degrees), PLAN, record, first_belief(), particles=64)
    lean = SlipLean.of(whole, found)
    assert lean is not None
    slips = predicted(found, whole, whole.values[:, OBSERVED.index("slip_ratio")], tmp_path)
    # The median of 64 draws is known to 1.25 of their standard deviation over the root of 64, and there are two.
    error = np.hypot(1.0, 1.0) * 1.25 * slips.std(ddof=1) / np.sqrt(slips.size)
    assert abs(lean.simulated - np.median(slips)) < 3.0 * error
    assert lean.spread == pytest.approx(slips.std(ddof=1), rel=0.5)


def test_slip_is_of_the_soils_believed_and_not_of_the_best_one(yutu2: Rover) -> None:
    """Where these are others, as a population can be, predictions are theirs."""
    out, soft = drive(yutu2, sloping(0.0)), drive(yutu2, sloping(0.0), friction_angle_deg=26.0)
    belief = first_belief()
    mean = np.array([law.transformed(np.array(SOIL[name])) for name, law in belief.laws.items()])
    believed = dataclasses.replace(belief, mean=mean, covariance=1e-6 * belief.covariance)
    found = SoilUpdate(
        belief=believed,
        prediction=soft,
        residuals=np.zeros((0, 6)),
        outliers=np.zeros((0, 6), dtype=bool),
        inflation={},
        wheel_errors={},
        chi_square=0.0,
        values=0,
        prior_shift=0.0,
        autocorrelation=0.0,
        refused="",
    )
    lean = SlipLean.of(seen(soft), found)
    assert lean is not None and median_slip(soft)[0] > median_slip(out)[0] + 0.05
    assert lean.simulated == pytest.approx(median_slip(out)[0], abs=0.005)
    assert "predictions slip less than the rover does" in dataclasses.replace(lean, sigma=0.01).doubt


def test_parameters_that_no_prior_has_are_doubted(yutu2: Rover) -> None:
    belief = first_belief().opened(yutu2.wheel)
    far = belief.mean + np.where(np.array(belief.names) == "max_stress_c1", 3.5 * 0.12, 0.0)
    found = SoilUpdate(
        belief=dataclasses.replace(belief, mean=far, covariance=0.01 * belief.covariance),
        prediction=drive(yutu2, sloping(0.0)),
        residuals=np.zeros((0, 6)),
        outliers=np.zeros((0, 6), dtype=bool),
        inflation={},
        wheel_errors={},
        chi_square=0.0,
        values=0,
        prior_shift=0.0,
        autocorrelation=0.0,
        refused="",
    )
    assert found.doubt.startswith("max_stress_c1 is 0.92, 3.5 standard deviations of its prior from 0.5")
    near = dataclasses.replace(found, belief=dataclasses.replace(belief, mean=far))
    assert near.doubt == "" and dataclasses.replace(found, refused="no soil").doubt == ""
