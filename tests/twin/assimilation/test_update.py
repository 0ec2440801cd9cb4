"""What a drive says of the soil, against the soil that it was simulated on.

What the best soil of a drive leaves unexplained: when that is a reason to refuse, and what it teaches.

Contact angles and effective radius of the wheels as unknowns: in drives, beliefs, updates and predictions.
"""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.belief import (
    SoilBelief,
    contact_rows,
    first_belief,
    parameter_rows,
    past_beliefs,
    read_belief,
    with_drive,
)
from lunarsci.regolith.physics_discrepancy import FIRST
from lunarsci.regolith.prior import PARAMETERS, ROLLING
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.assimilation import update
from lunarsci.twin.assimilation.residuals import OBSERVED, DriveRecord, DriveResiduals, states_at
from lunarsci.twin.assimilation.update import SlipLean, SoilUpdate, _refusal, _taught, assimilate, unexplained_share
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain, terrain_bytes
from lunarsci.twin.jobs.predict import predict as predict_job
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

PLAN = Plan(name="test", legs=(Leg(1.5, 0.15), Leg(1.5, -0.15)), speed_m_s=0.05)
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


def record_of(out: Prediction, seed: int = 0) -> DriveRecord:
    """Every third sample with the errors that Ding et al. (2024) state."""
    states = out.states[0, ::3]
    truth = states[..., [STATE_COLUMNS.index(name) for name in OBSERVED]].reshape(-1, 6)
    errors = MeasurementErrors(travel_relative=0.04, side_slip_relative=0.04)
    sigma = np.column_stack([errors.of(name, truth[:, k]) for k, name in enumerate(OBSERVED)])
    random = np.random.default_rng(seed)
    return DriveRecord(
        time_s=np.repeat(out.time_s[::3], 6),
        wheel=out.rover.wheels * len(states),
        values=truth + sigma * random.normal(size=truth.shape),
        sigmas=sigma,
        fix_time_s=out.time_s[-1:],
        fix_m=out.endpoints_m + 0.04 * random.normal(size=(1, 2)),
        fix_covariance_m2=0.04**2 * np.eye(2)[None],
    )


@pytest.fixture(scope="module")
def ground() -> Terrain:
    return synthetic_longji(rms_m=0.01)


@pytest.fixture(scope="module")
def record(yutu2: Rover, ground: Terrain) -> DriveRecord:
    return record_of(predict(yutu2, ground, PLAN, samples={name: [value] for name, value in SOIL.items()}))


@pytest.fixture(scope="module")
def found(yutu2: Rover, ground: Terrain, record: DriveRecord) -> SoilUpdate:
    return assimilate(yutu2, ground, PLAN, record, first_belief(), particles=64, model_error=0.0)


def test_ruts_are_taken_where_they_explain_the_drive_better(yutu2: Rover, ground: Terrain, found: SoilUpdate) -> None:
    """On a soft soil rear wheels that sink in the ruts of the front ones are explained by no soil without ruts."""
    soft = {name: [value] for name, value in (SOIL | {"stiffness_kpa_m_n": 600.0}).items()}
    drive = predict(yutu2, ground, PLAN, samples=soft, ruts=True)
    both = [
        assimilate(yutu2, ground, PLAN, record_of(drive), first_belief(), particles=32, model_error=0.0, ruts=ruts)
        for ruts in (None, False)
    ]
    assert both[0].prediction.ruts and not both[1].prediction.ruts and not found.prediction.ruts
    assert both[0].ruts_probability > 0.99 > 0.5 > found.ruts_probability >= both[1].ruts_probability == 0.0
    assert not both[0].refused and max(both[0].inflation.values(), default=1.0) < 1.2
    assert both[1].refused or max(both[1].inflation.values()) > 2.0


def test_soils_are_of_both_cases_as_probable_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws of 0 without ruts, of 1 with them; what is all but impossible has none."""
    same = SimpleNamespace(transforms=lambda points: points)
    made = {
        ruts: SimpleNamespace(coordinates=same, number=float(ruts), drive=SimpleNamespace(ruts=ruts))
        for ruts in (False, True)
    }
    monkeypatch.setattr(update, "draw_particles", lambda fit, mode, count, *_: (np.full((count, 8), fit.number), 0.1))
    for share, expected in ((0.25, 16), (0.001, 0)):
        fits: Any = [SimpleNamespace(posterior=made[False], mode=None, probability=1 - share),
                     SimpleNamespace(posterior=made[True], mode=None, probability=share)]  # fmt: skip
        points, met, left = update._drawn(fits, 64, np.random.default_rng(0), None)
        assert points.shape == (64, 8) and points[:, 0].sum() == expected and left == 0.1
        assert np.array_equal(met, points[:, 0] == 1.0)


def test_the_evidence_counts_the_errors_that_were_allowed(yutu2: Rover, ground: Terrain, record: DriveRecord) -> None:
    """Half of ln of the determinant of the covariance of all errors, put together from its parts."""
    drive = DriveResiduals(yutu2, ground, PLAN, record, first_belief(), inflation={"sinkage_m": 2.0})
    bias = drive.marginalised.vectors * drive.marginalised.sizes
    single = np.diag(drive.sigma.ravel())
    scale = block_diag(single, np.linalg.inv(drive.whitening))
    covariance = scale @ (np.eye(len(scale)) + bias @ bias.T) @ scale.T
    assert drive.ln_errors == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1], rel=1e-9)


@pytest.mark.slow
def test_the_belief_holds_the_true_soil_and_predicts_the_next_drive(
    yutu2: Rover, ground: Terrain, found: SoilUpdate
) -> None:
    assert not found.refused and found.outliers.sum() == 0
    assert 0.4 < found.reduced < 1.2
    spread = np.sqrt(np.diag(found.belief.covariance))
    wheel = {"max_stress_c1": 0.5, "max_stress_c2": 0.0, "exit_c3": 0.0, "shearing_radius_ratio": 1.0}
    truth = np.array([law.transformed(np.array((SOIL | wheel)[name])) for name, law in found.belief.laws.items()])
    assert (np.abs(found.belief.mean - truth) < 3.0 * spread).all()
    assert min(found.belief.sd_ratio.values()) < 0.5
    ahead = dataclasses.replace(PLAN, legs=(Leg(4.0, -0.1),), x_m=3.0, y_m=0.5)
    true = predict(yutu2, ground, ahead, samples={name: [value] for name, value in SOIL.items()}).endpoints_m[0]
    ends = {
        key: predict(yutu2, ground, ahead, samples=belief.draws(32)).endpoints_m
        for key, belief in (("after", found.belief), ("before", first_belief()))
    }
    off = {key: float(np.hypot(*(np.median(cloud, axis=0) - true))) for key, cloud in ends.items()}
    spread_of = {key: float(np.sqrt(np.var(cloud, axis=0).sum())) for key, cloud in ends.items()}
    assert off["after"] < 0.1 and off["after"] < 0.5 * off["before"]
    assert spread_of["after"] < 0.3 * spread_of["before"]


def surprise(moved: np.ndarray) -> float:
    """Root mean square in independent standard deviations of the first belief, by its principal axes."""
    values, axes = np.linalg.eigh(first_belief().covariance)
    return float(np.sqrt(((moved @ axes) ** 2 / values).mean()))


def test_the_surprise_is_how_far_the_mean_of_the_soil_moved(found: SoilUpdate) -> None:
    assert found.prior_shift == pytest.approx(surprise(found.belief.soil.mean - first_belief().mean))


@pytest.mark.slow
def test_contradictory_telemetry_does_not_move_the_belief(yutu2: Rover, ground: Terrain, record: DriveRecord) -> None:
    """A drive said to have sunk 60 mm deep while its loads stay those of the Moon."""
    values = record.values.copy()
    values[::3, 0] += 0.06
    wrong = assimilate(yutu2, ground, PLAN, dataclasses.replace(record, values=values), first_belief(), particles=32)
    assert "single wheels are off in sinkage_m" in wrong.refused
    assert np.array_equal(wrong.belief.mean, first_belief().mean)
    first, best = first_belief(), wrong.prediction.parameters
    moved = np.array([law.transformed(best[name])[0] for name, law in first.laws.items()]) - first.mean
    assert wrong.prior_shift == pytest.approx(surprise(moved))


def test_slip_that_the_soil_found_does_not_have_is_doubted(record: DriveRecord, found: SoilUpdate) -> None:
    """The slip of the own drive is within its errors; one that was 0.1 less, as of another law, is not."""
    lean = SlipLean.of(record, found)
    assert lean is not None and not lean.off and lean.doubt == "" and 0 < lean.spread < 0.02
    values = record.values.copy()
    values[:, OBSERVED.index("slip_ratio")] -= 0.1
    other = SlipLean.of(dataclasses.replace(record, values=values), found)
    assert other is not None and other.off and "predictions slip more than the rover does" in other.doubt
    assert not dataclasses.replace(other, sigma=0.06).off and not dataclasses.replace(other, measured=lean.measured).off
    assert SlipLean.of(record, dataclasses.replace(found, refused="no soil explains it")) is None


def test_errors_of_positions_are_warned_of_from_twice_on(found: SoilUpdate) -> None:
    for factor, caution, doubt in ((1.9, False, False), (2.4, True, False), (4.7, True, False), (5.1, False, True)):
        wide = dataclasses.replace(found, inflation={"position": factor})
        assert (bool(wide.caution), bool(wide.doubt)) == (caution, doubt), factor


def test_a_record_must_fit_the_rover(yutu2: Rover, ground: Terrain, record: DriveRecord) -> None:
    alien = dataclasses.replace(record, wheel=("XX", *record.wheel[1:]))
    with pytest.raises(ParameterError, match="'XX' is no wheel"):
        assimilate(yutu2, ground, PLAN, alien, first_belief())
    empty = dataclasses.replace(record, values=np.full_like(record.values, np.nan))
    with pytest.raises(ParameterError, match="fewer than a soil"):
        assimilate(yutu2, ground, PLAN, empty, first_belief())
    with pytest.raises(ParameterError, match="0 or more"):
        dataclasses.replace(record, time_s=record.time_s - 1.0)
    with pytest.raises(ParameterError, match="positive definite"):
        dataclasses.replace(record, fix_covariance_m2=-record.fix_covariance_m2)


SIGMA = np.array([0.00033, 0.01, 0.1, 1.0, 0.05, 0.1])


@pytest.fixture(scope="module")
def best(driven: Prediction) -> Prediction:
    """One of the 20 drives, on level ground with a push from the side so that no quantity is 0."""
    parts = {name: getattr(driven, name)[:1] for name in ("paths", "states", "recorded", "outcome")}
    states = parts.pop("states").copy()
    states[..., STATE_COLUMNS.index("side_slip_deg")] = 3.0
    states[..., STATE_COLUMNS.index("drawbar_pull_n")] = 2.0
    parameters = {name: values[:1] for name, values in driven.parameters.items()}
    return dataclasses.replace(driven, states=states, parameters=parameters, **parts)


def expected_of(best: Prediction) -> np.ndarray:
    return best.states[0, ::2][..., [STATE_COLUMNS.index(name) for name in OBSERVED]].reshape(-1, 6)


def level_drive(
    best: Prediction, factor: dict[str, float], inflation: dict[str, float], off_m: float = 0.0
) -> DriveResiduals:
    """The drive with quantities multiplied, its errors widened, and its end `off_m` to the left."""
    values = expected_of(best) * np.array([factor.get(name, 1.0) for name in OBSERVED])
    record = DriveRecord(
        time_s=np.repeat(best.time_s[::2], 6),
        wheel=best.rover.wheels * len(best.time_s[::2]),
        values=values,
        sigmas=np.tile(SIGMA, (len(values), 1)),
        fix_time_s=best.time_s[-1:],
        fix_m=best.paths[0, -1:, :2] + (0.0, off_m),
        fix_covariance_m2=1e-6 * np.eye(2)[None],
    )
    return DriveResiduals(best.rover, best.terrain, best.plan, record, first_belief(), inflation=inflation)


@pytest.mark.parametrize(
    ("factor", "inflation", "off_m", "says"),
    [
        # A law that is off by a third of a force or of the sinkage is no fault of the drive, however good the sensors.
        ({"drawbar_pull_n": 1.4}, {"drawbar_pull_n": 14.0}, 0.0, ""),
        ({"sinkage_m": 1.5}, {"sinkage_m": 20.0}, 0.0, ""),
        ({}, {"position": 30.0}, 0.05, ""),
        # A wrong sign, a wrong unit, and an end that is elsewhere are.
        ({"drawbar_pull_n": -1.0}, {"drawbar_pull_n": 60.0}, 0.0, "misses drawbar_pull_n by 60.0 times"),
        ({"sinkage_m": 10.0}, {"sinkage_m": 200.0}, 0.0, "misses sinkage_m"),
        ({"side_slip_deg": 0.01745}, {"side_slip_deg": 30.0}, 0.0, "misses side_slip_deg"),
        ({}, {"position": 90.0}, 0.3, "misses position by 90.0 times its errors; look at its sign and unit"),
    ],
)
def test_refused_is_what_no_physics_explains(
    best: Prediction, factor: dict[str, float], inflation: dict[str, float], off_m: float, says: str
) -> None:
    found = _refusal(level_drive(best, factor, inflation, off_m), 0, {}, expected_of(best), best)
    assert says in found if says else found == ""


def test_outliers_and_single_wheels_are_refused_as_before(best: Prediction) -> None:
    plain, expected = level_drive(best, {}, {}), expected_of(best)
    assert "values are explained by no soil" in _refusal(plain, int(0.1 * plain.counted.sum()), {}, expected, best)
    assert "are wheels exchanged" in _refusal(plain, 0, {"sinkage_m": 0.02}, expected, best)
    # A level drive has hardly any side slip; that wheels are off by more than it is nothing against them.
    assert _refusal(plain, 0, {"side_slip_deg": 0.7}, expected, best) == ""
    assert "off in side_slip_deg" in _refusal(plain, 0, {"side_slip_deg": 20.0}, expected, best)


def test_what_states_leave_unexplained_widens_the_discrepancy(best: Prediction) -> None:
    expected = expected_of(best)
    none, some = level_drive(best, {}, {}), level_drive(best, {}, {"sinkage_m": 10.0})
    assert unexplained_share(none, expected, best) == 0.0
    sinkage = np.abs(expected[some.counted[:, 0], 0]).mean()
    own = np.hypot(0.00033, 5e-5) * np.sqrt(99.0) / sinkage
    assert unexplained_share(some, expected, best) == pytest.approx(own, rel=0.01)
    clear, off = (_taught(FIRST, one, expected, best) for one in (none, some))
    assert clear.along.degrees > FIRST.along.degrees and clear.along.scale < 1.2 * FIRST.along.scale
    assert off.along.scale > 2.0 * clear.along.scale and off.across.scale > 2.0 * clear.across.scale


def test_an_end_that_the_best_soil_misses_widens_it(best: Prediction) -> None:
    expected = expected_of(best)
    near, far = (_taught(FIRST, level_drive(best, {}, {}, off_m), expected, best) for off_m in (0.0, 0.05))
    assert far.across.scale > 1.5 * near.across.scale
    assert far.along.scale == pytest.approx(near.along.scale, rel=0.2)


OTHER = {"max_stress_c1": 0.32, "max_stress_c2": 0.2, "exit_c3": -0.15}
ROLLING_PLAN = Plan(name="bends", legs=(Leg(2.0, 0.15), Leg(2.0, -0.15)), speed_m_s=0.05)
SLIP = STATE_COLUMNS.index("slip_ratio")


def sloping(degrees: float) -> Terrain:
    x, y = np.arange(-3.0, 9.1, 0.25), np.arange(-5.0, 5.1, 0.25)
    height = np.tan(np.radians(degrees)) * np.tile(x, (len(y), 1))
    return build_terrain("slope", -3.0, -5.0, 0.25, height, Soil(**SOIL))


def drive(rover: Rover, ground: Terrain, plan: Plan = ROLLING_PLAN, **more: float) -> Prediction:
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
    assert np.array_equal(opened.forgotten(1.0).covariance, opened.covariance)
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
    found = assimilate(yutu2, ground, ROLLING_PLAN, record, first_belief(), particles=64, model_error=0.0)
    lean, belief = SlipLean.of(record, found), found.belief
    assert not found.refused and not found.doubt and lean is not None and not lean.off
    spread = np.sqrt(np.diag(belief.covariance))
    truth = np.array([law.transformed(np.array(true[name])) for name, law in belief.laws.items()])
    assert (np.abs(belief.mean - truth) < 3.0 * spread).all()
    known = assimilate(yutu2, ground, ROLLING_PLAN, record, first_belief(), particles=64, model_error=0.0, wheel=False)
    back = dataclasses.replace(ROLLING_PLAN, legs=(Leg(4.0, 0.1),), heading_deg=90.0, y_m=-2.0)
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
    entry = {"states": "states.csv", "ruts": bool(found.prediction.ruts.all())}
    belief.write_text(with_drive(found.belief, first_belief(), entry).to_json())
    assert json.loads(belief.read_text())["order"] == [*PARAMETERS, *ROLLING]
    drives = predict_job(ROLLING_PLAN, terrain=str(terrain), soil=(str(belief),), seed=3).prediction
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
    found = assimilate(yutu2, sloping(degrees), ROLLING_PLAN, record, first_belief(), particles=64)
    lean = SlipLean.of(whole, found)
    assert lean is not None
    slips = predicted(found, whole, whole.values[:, OBSERVED.index("slip_ratio")], tmp_path)
    # The median of 64 draws is known to 1.25 of their standard deviation over the root of 64, and there are two.
    error = np.hypot(1.0, 1.0) * 1.25 * slips.std(ddof=1) / np.sqrt(slips.size)
    assert abs(lean.simulated - np.median(slips)) < 3.0 * error
    assert lean.spread == pytest.approx(slips.std(ddof=1), rel=0.5)


def update_without_values(belief: SoilBelief, prediction: Prediction) -> SoilUpdate:
    """What an update says of the soil alone."""
    return SoilUpdate(
        belief=belief,
        prediction=prediction,
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


def test_slip_is_of_the_soils_believed_and_not_of_the_best_one(yutu2: Rover) -> None:
    """Where these are others, as a population can be, predictions are theirs."""
    out, soft = drive(yutu2, sloping(0.0)), drive(yutu2, sloping(0.0), friction_angle_deg=26.0)
    belief = first_belief()
    mean = np.array([law.transformed(np.array(SOIL[name])) for name, law in belief.laws.items()])
    believed = dataclasses.replace(belief, mean=mean, covariance=1e-6 * belief.covariance)
    found = update_without_values(believed, soft)
    lean = SlipLean.of(seen(soft), found)
    assert lean is not None and median_slip(soft)[0] > median_slip(out)[0] + 0.05
    assert lean.simulated == pytest.approx(median_slip(out)[0], abs=0.005)
    assert "predictions slip less than the rover does" in dataclasses.replace(lean, sigma=0.01).doubt


def test_parameters_that_no_prior_has_are_doubted(yutu2: Rover) -> None:
    belief = first_belief().opened(yutu2.wheel)
    far = belief.mean + np.where(np.array(belief.names) == "max_stress_c1", 3.5 * 0.12, 0.0)
    found = update_without_values(
        dataclasses.replace(belief, mean=far, covariance=0.01 * belief.covariance), drive(yutu2, sloping(0.0))
    )
    assert found.doubt.startswith("max_stress_c1 is 0.92, 3.5 standard deviations of its prior from 0.5")
    near = dataclasses.replace(found, belief=dataclasses.replace(belief, mean=far))
    assert near.doubt == "" and dataclasses.replace(found, refused="no soil").doubt == ""
