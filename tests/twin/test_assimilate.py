"""What a drive says of the soil, against the soil that it was simulated on."""

import dataclasses

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.assimilation.residuals import OBSERVED, DriveRecord
from lunarsci.twin.assimilation.update import SlipLean, SoilUpdate, assimilate
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
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
    assert not both[0].refused and max(both[0].inflation.values(), default=1.0) < 1.2
    assert both[1].refused or max(both[1].inflation.values()) > 2.0


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
