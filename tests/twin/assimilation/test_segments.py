"""Changes of the soil along a drive: by hand, by how often they are found where there is none, and on simulated drives
over ground whose soil changes on the way."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.assimilation.residuals import MODEL_ERRORS, OBSERVED, DriveRecord, states_at
from lunarsci.twin.assimilation.segments import (
    FEWEST_BINS,
    FEWEST_VALUES,
    TrackBins,
    Traverse,
    binned,
    drive_segments,
    find_change,
    find_change_point,
    record_within,
    traverse_of,
    wheel_places,
)
from lunarsci.twin.assimilation.update import SlipLean, SoilUpdate, assimilate
from lunarsci.twin.figures.maps import residual_page
from lunarsci.twin.ground.soil_map import SoilMap
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.jobs.update import LearnedSoil
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

SOIL = {
    "stiffness_kpa_m_n": 1100.0,
    "sinkage_exponent": 1.0,
    "sinkage_exponent_slip": 0.1,
    "cohesion_pa": 400.0,
    "friction_angle_deg": 34.0,
    "shear_modulus_mm": 22.0,
    "external_friction_angle_deg": 14.0,
    "lateral_modulus_mm": 25.0,
}
PLAN = Plan(name="test", legs=(Leg(3.0, 0.05), Leg(3.0, -0.05)), speed_m_s=0.05, x_m=-0.5)
CHANGE_X = 2.5


def pieces_of(mean: np.ndarray, slope: np.ndarray | None = None) -> TrackBins:
    size, quantities = mean.shape
    slope = np.ones((size, quantities, 1)) if slope is None else slope
    names = OBSERVED[:quantities]
    return TrackBins(np.arange(size) * 0.2, names, mean, np.ones(mean.shape), slope, np.zeros(quantities))


def test_the_statistic_is_that_of_two_means() -> None:
    """One parameter whose derivative is 1: two means, each shrunk by a prior of width 1, against one."""
    mean = np.array([0.3, -0.2, 0.1, -0.3, 0.2, 0.6, 0.1, 0.5, 0.2, 0.7, -0.1, 0.4])[:, None]
    step = find_change_point(pieces_of(mean), np.random.default_rng(0), 19)
    n = len(mean)
    wanted = [
        mean[:k].sum() ** 2 / (k + 1) + mean[k:].sum() ** 2 / (n - k + 1) - mean.sum() ** 2 / (n + 1)
        for k in range(FEWEST_BINS, n - FEWEST_BINS + 1)
    ]
    assert step.statistic == pytest.approx(wanted)
    assert step.tried_m == pytest.approx([0.2 * k - 0.1 for k in range(FEWEST_BINS, n - FEWEST_BINS + 1)])


def noise(count: int, size: int, persistence: float, random: np.random.Generator) -> np.ndarray:
    """Drives of unit noise in two quantities. (count, size, 2)"""
    shocks = random.standard_normal((count, size, 2))
    series = shocks.copy()
    for k in range(1, size):
        series[:, k] = persistence * series[:, k - 1] + np.sqrt(1 - persistence**2) * shocks[:, k]
    return series


@pytest.mark.parametrize("persistence", [0.0, 0.4])
def test_false_alarms_are_rare_and_a_change_is_found(persistence: float) -> None:
    """Wanted 1 %, stated 5 % at most; of 120 drives 6 may be false. A step of 3 errors is found within 0.4 m."""
    random = np.random.default_rng(2)
    slope = random.normal(size=(40, 2, 8))
    slope[..., 0] = 1.0
    drives = noise(120, 40, persistence, random)
    found = [find_change_point(pieces_of(drive, slope), random, 99).p_value <= 0.01 for drive in drives]
    assert sum(found) <= 6
    drives[:40, 25:] += 3.0
    steps = [find_change_point(pieces_of(drive, slope), random, 99) for drive in drives[:40]]
    assert np.mean([step.p_value <= 0.01 for step in steps]) > 0.9
    assert np.mean([abs(step.after_m - 4.9) <= 0.4 for step in steps]) > 0.9


def test_pieces_are_means_of_what_lies_in_them() -> None:
    values = np.full((5, 6), np.nan)
    values[:, 0], values[1:, 2] = [1.0, 3.0, 5.0, 7.0, 100.0], [2.0, 4.0, 6.0, 8.0]
    slopes = np.ones((5, 6, 8)) * np.arange(5.0)[:, None, None]
    bins = binned(np.array([-0.1, -0.05, 0.1, 0.15, 0.9]), values, slopes, np.arange(6.0))
    assert bins is not None and bins.names == ("sinkage_m", "side_slip_deg")
    assert bins.middle_m == pytest.approx([-0.1, 0.1, 0.9])
    assert bins.mean[:, 0] == pytest.approx([2.0, 6.0, 100.0]) and bins.weight[0].tolist() == [2.0, 1.0]
    assert bins.slope[:, 0, 3] == pytest.approx([0.5, 2.5, 4.0]) and bins.model.tolist() == [0.0, 2.0]
    assert binned(np.zeros(5), np.full((5, 6), np.nan), slopes, np.zeros(6)) is None


def record_of(out: Prediction, seed: int) -> DriveRecord:
    """Sinkage, slip and side slip of every second sample with the errors that Ding et al. (2024) state."""
    states = out.states[0, ::2]
    truth = states[..., [STATE_COLUMNS.index(name) for name in OBSERVED]].reshape(-1, 6)
    errors = MeasurementErrors(travel_relative=0.04, side_slip_relative=0.04)
    sigma = np.column_stack([errors.of(name, truth[:, k]) for k, name in enumerate(OBSERVED)])
    values = truth + sigma * np.random.default_rng(seed).normal(size=truth.shape)
    values[:, 3:] = np.nan
    return DriveRecord(
        time_s=np.repeat(out.time_s[::2], 6),
        wheel=out.rover.wheels * len(states),
        values=values,
        sigmas=sigma,
        fix_time_s=out.time_s[-1:],
        fix_m=out.endpoints_m,
        fix_covariance_m2=0.04**2 * np.eye(2)[None],
    )


def parted(ground: Terrain, share: float) -> Terrain:
    """The soil, its stiffness times `share` beyond CHANGE_X."""
    layers = {name: np.full(ground.height_m.shape, value) for name, value in SOIL.items()}
    layers["stiffness_kpa_m_n"][:, ground.x_m > CHANGE_X] *= share
    return ground.with_soil(**layers)


def on_one_soil(rover: Rover, ground: Terrain, record: DriveRecord, share: float) -> SoilUpdate:
    """What a rectification would hand on whose best soil is the geometric mean of both."""
    soil = SOIL | {"stiffness_kpa_m_n": SOIL["stiffness_kpa_m_n"] * share**0.5}
    drive = predict(rover, ground, PLAN, samples={name: [v] for name, v in soil.items()}, time_step_s=0.2)
    sigma = np.hypot(record.sigmas, [MODEL_ERRORS[name] for name in OBSERVED])
    residuals = (states_at(record, drive.time_s, drive.states, rover.wheels)[0] - record.values) / sigma
    residuals[record.time_s <= 1.0] = np.nan
    return SoilUpdate(
        belief=first_belief(),
        prediction=drive,
        residuals=residuals,
        outliers=np.abs(residuals) > 4,
        inflation={},
        wheel_errors={},
        chi_square=0.0,
        values=1,
        prior_shift=0.0,
        autocorrelation=0.0,
        refused="",
    )


@pytest.fixture(scope="module")
def ground(slope) -> Terrain:  # type: ignore[no-untyped-def]
    return slope(0.05, 0.03)  # type: ignore[no-any-return]


@pytest.mark.slow
def test_one_soil_has_no_change(yutu2: Rover, ground: Terrain) -> None:
    """12 drives with a time step of 0.05 s, errors of their own; stated are 5 % at most, more than 2 by 2 in 100."""
    out = predict(yutu2, parted(ground, 1.0), PLAN, sweep=(), time_step_s=0.05)
    found = []
    for seed in range(12):
        record = record_of(out, seed)
        found.append(find_change(record, on_one_soil(yutu2, ground, record, 1.0), seed=seed))
    assert sum(change is not None for change in found) <= 2


@pytest.mark.parametrize("share", [0.5, 1.6])
def test_another_stiffness_is_found_at_its_place(yutu2: Rover, ground: Terrain, share: float) -> None:
    out = predict(yutu2, parted(ground, share), PLAN, sweep=(), time_step_s=0.1)
    true_m = float(np.interp(CHANGE_X, out.paths[0, :, 0], out.distance_m))
    record = record_of(out, 0)
    found = on_one_soil(yutu2, ground, record, share)
    change = find_change(record, found)
    assert change is not None and change.p_value <= 0.01
    assert abs(change.distance_m - true_m) <= 0.4 and change.low_m <= true_m + 0.2 <= change.high_m + 0.4
    assert change.x_m == pytest.approx(CHANGE_X, abs=0.5)
    assert change.time_s == pytest.approx(true_m / PLAN.speed_m_s, abs=9.0)
    assert np.sign(change.steps["sinkage_m"]) == (1 if share < 1 else -1)
    word = "larger" if share < 1 else "smaller"
    assert change.text.endswith("than before")
    assert f"the soil changes at {change.distance_m:.1f} m of the way" in change.text
    assert f"sinkage_m is {word}" in change.text
    assert len(residual_page(record, found, [change]).axes) == 3
    with pytest.raises(ParameterError, match=r"give 0\.001 to 0\.5"):
        find_change(record, found, false_alarms=0.0)


def test_states_astride_a_change_belong_to_no_stretch(yutu2: Rover, ground: Terrain) -> None:
    out = predict(yutu2, parted(ground, 0.5), PLAN, sweep=(), time_step_s=0.2)
    record, way = record_of(out, 0), traverse_of(out)
    part = record_within(record, way, 2.0, 4.0)
    places = wheel_places(yutu2, part, way)
    assert places.min() >= 2.0 and places.max() <= 4.0 and np.ptp(places) > 1.7
    assert part.fix_m.shape == (0, 2) and len(part.wheel) == len(part.time_s) == len(part.values)
    assert record_within(record, way, -np.inf, np.inf).values.shape == record.values.shape


def test_a_way_goes_on_to_the_wheels_at_its_ends() -> None:
    places = np.column_stack([np.zeros(4), np.array([0.0, 1.0, 1.0, 2.0])])
    way = Traverse(np.arange(4.0), np.array([0.0, 1.0, 1.0, 2.0]), places, 0.5)
    assert way.between(-np.inf, np.inf) == pytest.approx(
        np.column_stack([np.zeros(5), np.array([-0.5, 0.0, 1.0, 2.0, 2.5])])
    )
    assert way.between(0.5, 1.5) == pytest.approx(np.column_stack([np.zeros(3), np.array([0.5, 1.0, 1.5])]))
    assert way.time_at(1.5) == pytest.approx(2.25) or way.time_at(1.5) == pytest.approx(2.0)
    assert way.distance_at(0.5) == pytest.approx(0.5)


@pytest.mark.slow
def test_each_stretch_is_learned_on_its_own(yutu2: Rover, ground: Terrain) -> None:
    """Stiffness halved at x = 2.5 m: two zones, whose beliefs hold the true soils."""
    out = predict(yutu2, parted(ground, 0.5), PLAN, sweep=(), time_step_s=0.1)
    record = record_of(out, 1)
    found = on_one_soil(yutu2, ground, record, 0.5)
    asked: list[np.ndarray] = []

    def believed(places: np.ndarray) -> SoilBelief:
        asked.append(places)
        return first_belief()

    prior = SimpleNamespace(belief_along=believed)

    segments, changes = drive_segments(yutu2, ground, PLAN, record, found, prior, particles=48, seed=0)
    assert len(segments) == 2 and len(changes) == 1
    assert all(segment.learned and segment.why_not == "" for segment in segments)
    assert segments[0].to_m == segments[1].from_m == changes[0].distance_m
    assert segments[0].place_m[:, 0].max() <= CHANGE_X + 0.5 and segments[1].place_m[:, 0].min() >= CHANGE_X - 0.5
    for segment, share in zip(segments, (1.0, 0.5), strict=True):
        soil = SOIL | {"stiffness_kpa_m_n": SOIL["stiffness_kpa_m_n"] * share}
        truth = np.array([segment.belief.laws[name].transformed(np.array(soil[name])) for name in PARAMETERS])
        spread = np.sqrt(np.diag(segment.belief.covariance))
        assert (np.abs(segment.belief.mean - truth) < 3.0 * spread).all()
    # Each is judged on its own slip: right on its soil, and said to be off where slip was 0.1 more than on it.
    for segment in segments:
        lean, stretch = segment.slip, f"{segment.from_m:.1f} to {segment.to_m:.1f} m: "
        assert lean is not None and not lean.off and segment.slips >= FEWEST_VALUES
        assert segment.slip_text.startswith(f"{stretch}median slip ratio: {lean.measured:.3f} measured")
        off = dataclasses.replace(segment, slip=dataclasses.replace(lean, measured=lean.simulated + 0.1))
        parts: Any = {"found": found, "record": record, "pace": None, "slip": off.slip}
        doubts: Any = LearnedSoil.doubts
        reasons = doubts.fget(SimpleNamespace(**parts, segments=[segments[0], off])).reasons
        assert any(one.startswith(f"{stretch}median slip is") for one in reasons)
        assert "median slip" not in str(doubts.fget(SimpleNamespace(**parts, segments=segments)))
    # The sinkage of each zone's drive, its first or last metre, is the one measured there.
    for segment, row in zip(segments, (5, -5), strict=True):
        assert segment.update is not None
        driven = segment.update.prediction.states[0, row, :, 2].mean()
        assert driven == pytest.approx(out.states[0, row, :, 2].mean(), rel=0.05)


def test_a_stretch_with_too_little_data_stays_as_it_was(yutu2: Rover, ground: Terrain) -> None:
    """States end 0.8 m behind the change: less than 16 values are of times at which the whole rover stood behind it."""
    out = predict(yutu2, parted(ground, 0.4), PLAN, sweep=(), time_step_s=0.1)
    record = record_of(out, 0)
    kept = record.time_s < (4.2 / PLAN.speed_m_s)
    record = dataclasses.replace(
        record,
        time_s=record.time_s[kept],
        wheel=tuple(np.array(record.wheel)[kept]),
        values=record.values[kept],
        sigmas=record.sigmas[kept],
    )
    found = on_one_soil(yutu2, ground, record, 0.4)
    segments, changes = drive_segments(yutu2, ground, PLAN, record, found, SoilMap(), particles=32)
    assert changes and not segments[-1].learned and segments[-1].why_not == "too few values"
    assert segments[-1].belief.mean == pytest.approx(first_belief().mean)
    few = f"median slip not judged: {segments[-1].slips} states"
    assert segments[-1].slip is None and few in segments[-1].slip_text and segments[-1].slips < FEWEST_VALUES
    slips = int(np.isfinite(record.values[:, OBSERVED.index("slip_ratio")]).sum())
    assert SlipLean.of(record, found, least=slips) is not None and SlipLean.of(record, found, least=slips + 1) is None
    assert segments[-1].to_dict()["slip_ratio"] is None


def test_errors_that_were_widened_hide_no_change(yutu2: Rover, ground: Terrain) -> None:
    """The same residuals in other units: what is found does not depend on how much `assimilate` widened the errors."""
    out = predict(yutu2, parted(ground, 0.5), PLAN, sweep=(), time_step_s=0.2)
    record = record_of(out, 0)
    plain = on_one_soil(yutu2, ground, record, 0.5)
    factor = np.array([3.0 if name == "sinkage_m" else 1.0 for name in OBSERVED])
    widened = dataclasses.replace(plain, residuals=plain.residuals / factor, inflation={"sinkage_m": 3.0})
    one, two = find_change(record, plain), find_change(record, widened)
    assert one is not None and two is not None
    assert (one.distance_m, one.p_value) == (two.distance_m, two.p_value)
    assert one.steps == pytest.approx(two.steps)
    # A soil that explains a drive only with errors far larger is learned, and doubted.
    assert plain.doubt == widened.doubt == ""
    assert "sinkage_m only with 6.0 times" in dataclasses.replace(plain, inflation={"sinkage_m": 6.0}).doubt


def test_an_update_hands_on_what_a_change_is_looked_for_in(yutu2: Rover, ground: Terrain) -> None:
    """The best soil of a rectification stands in its prediction, by name, one member."""
    plan = dataclasses.replace(PLAN, legs=(Leg(1.0),))
    out = predict(yutu2, parted(ground, 1.0), plan, sweep=(), time_step_s=0.2)
    found = assimilate(yutu2, ground, plan, record_of(out, 0), first_belief(), particles=32)
    assert (
        set(found.prediction.parameters) == set(found.belief.draws(1)) | set(PARAMETERS)
        and found.prediction.members == 1
    )
    assert found.residuals.shape == record_of(out, 0).values.shape
    assert find_change(record_of(out, 0), found) is None
