"""What a drive teaches: against closed forms, nested importance sampling, and updates by simulated drives."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.physics_discrepancy import FIRST
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.choice.next_end import next_end
from lunarsci.twin.choice.teaching import OBSERVED, PARTS, observed, teaching, way_back
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.plans.schedule import make_schedule
from lunarsci.twin.plans.wheel_test import WheelTest
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import DrawnDiscrepancy
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction

ERRORS = MeasurementErrors(sinkage_m=0.002, travel_relative=0.0, side_slip_relative=0.0)
PLAN = Plan(name="line", legs=(Leg(5.0),), speed_m_s=0.05)
NAMES = ("stiffness_kpa_m_n", "cohesion_pa")


def made_up(rover: Rover, soil: np.ndarray, slopes: np.ndarray, noise: np.ndarray, ends: np.ndarray) -> Prediction:
    """SYNTHETIC: sinkage in each part is linear in the soil's transforms, with noise; the rest tells nothing."""
    schedule, members = make_schedule(PLAN, rover), len(soil)
    times = np.linspace(0.0, schedule.duration_s, 21)
    halted = np.zeros(len(times), dtype=bool)
    states = np.zeros((members, len(times), len(rover.wheels), len(STATE_COLUMNS)))
    parts = np.array_split(np.arange(len(times)), PARTS)
    for part, slope, off in zip(parts, slopes, noise.T, strict=True):
        states[..., STATE_COLUMNS.index("sinkage_m")][:, part] = (0.05 + soil @ slope + off)[:, None, None]
    random = np.random.default_rng(5)
    for name in ("slip_ratio", "side_slip_deg"):
        states[..., STATE_COLUMNS.index(name)] = random.standard_normal((members, len(times), 1))
    paths = np.zeros((members, len(times), 6))
    paths[:, -1, :2] = ends
    return Prediction(
        rover=rover, terrain=None, plan=PLAN, seed=0, time_step_s=0.1,  # type: ignore[arg-type]
        parameters={name: np.exp(soil[:, k]) for k, name in enumerate(NAMES)}, time_s=times,
        distance_m=schedule.distance_at(times), planned=schedule.pose_at(times), paths=paths, states=states,
        halted=halted, recorded=np.full(members, len(times)), outcome=np.zeros(members, dtype=np.int64),
    )  # fmt: skip


def ensemble(members: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transforms of the soil of standard deviation 1, unexplained sinkage of 3 mm, ends that tell nothing."""
    random = np.random.default_rng(seed)
    return (
        random.standard_normal((members, 2)),
        0.003 * random.standard_normal((members, PARTS)),
        10.0 * random.standard_normal((members, 2)),
    )


SLOPES = np.array([[0.004, 0.0], [0.004, 0.002]])


def exact_posterior() -> np.ndarray:
    """Of both transforms: observations with 2 mm of error and 3 mm that the soil does not explain."""
    return np.linalg.inv(np.eye(2) + SLOPES.T @ SLOPES / (0.002**2 + 0.003**2))


@pytest.mark.parametrize("members", [64, 4000])
def test_linear_drives_teach_what_the_closed_form_says(yutu2: Rover, members: int) -> None:
    """On average over ensembles also with 64 members: neither optimistic nor pessimistic by more than 5 %."""
    found = []
    for seed in range(40 if members == 64 else 1):
        soil, noise, ends = ensemble(members, seed)
        found.append(teaching(made_up(yutu2, soil, SLOPES, noise, ends), errors=ERRORS).sd_ratio)
    assert np.mean(found, axis=0) == pytest.approx(np.sqrt(np.diag(exact_posterior())), rel=0.05)


def test_information_is_that_of_the_determinants(yutu2: Rover) -> None:
    soil, noise, ends = ensemble(4000)
    gain = teaching(made_up(yutu2, soil, SLOPES, noise, ends), errors=ERRORS).gain_nats
    assert gain == pytest.approx(-0.5 * math.log(np.linalg.det(exact_posterior())), rel=0.06)


def test_nested_importance_sampling_agrees(yutu2: Rover) -> None:
    """Every member in turn is the truth, is observed with errors, and weighs the others: no linearity is taken."""
    soil, noise, ends = ensemble(3000, 3)
    drives = made_up(yutu2, soil, SLOPES, noise, ends)
    seen, sigma = observed(drives, ERRORS)
    own = [k for k in range(seen.shape[1] - 2) if OBSERVED[k % len(OBSERVED)] == "sinkage_m"]
    # Observations without the drawn noise are what a soil says; noise and errors are their likelihood.
    said, spread = 0.05 + soil @ SLOPES.T, np.hypot(0.003, sigma[own])
    random, left = np.random.default_rng(4), []
    for truth in range(300):
        told = seen[truth, own] + sigma[own] * random.standard_normal(len(own))
        weight = np.exp(-0.5 * (((said - told) / spread) ** 2).sum(axis=1))
        mean = weight @ soil / weight.sum()
        left.append(weight @ (soil - mean) ** 2 / weight.sum())
    expected = np.sqrt(np.mean(left, axis=0))
    assert teaching(drives, errors=ERRORS).sd_ratio == pytest.approx(expected, rel=0.05)


def linear_ends(seed: int, members: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Telemetry, next ends, and these without 0.1 m of what physics are off by. (members, 2) each"""
    random = np.random.default_rng(seed)
    soil, noise = random.standard_normal((members, 2)), random.standard_normal((members, PARTS))
    unmoved = soil @ np.array([[0.3, 0.0], [0.0, 0.2]])
    telemetry = soil @ SLOPES.T + math.hypot(0.002, 0.003) * noise
    return telemetry, unmoved + 0.1 * random.standard_normal((members, 2)), unmoved


def median_length(covariance: np.ndarray) -> float:
    """Of normal vectors."""
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(2), covariance, 100_000)
    return float(np.median(np.hypot(*drawn.T)))


def test_next_ends_are_missed_by_what_the_closed_form_leaves() -> None:
    found = []
    for seed in range(6):
        told, ends, unmoved = linear_ends(seed)
        found.append(next_end(told, ends, unmoved, np.ones(len(ends), dtype=bool)))
    owed, rest = np.diag([0.3, 0.2]), 0.01 * np.eye(2)
    assert np.mean([one.before_m for one in found]) == pytest.approx(median_length(owed @ owed + rest), rel=0.06)
    assert np.mean([one.floor_m for one in found]) == pytest.approx(median_length(rest), rel=0.06)
    after = median_length(owed.T @ exact_posterior() @ owed + rest)
    assert np.mean([one.after_m for one in found]) == pytest.approx(after, rel=0.06)


def test_next_ends_need_not_be_linear_nor_normal() -> None:
    """An end that grows as the exponential of what telemetry shows to 1 %, and members that did not finish."""
    random = np.random.default_rng(3)
    soil, done = random.standard_normal(128), np.arange(128) % 8 > 0
    ends = np.column_stack([np.exp(1.5 * soil), np.zeros(128)])
    found = next_end(np.column_stack([soil + 0.01 * random.standard_normal(128), np.zeros(128)]), ends, ends, done)
    assert found.floor_m == 0.0 and found.after_m < 0.15 * found.before_m
    assert np.isnan(found.errors_m[~done]).all() and np.isfinite(found.errors_m[done]).all()


def test_a_better_teacher_is_one_beyond_chance() -> None:
    """Of 20 pairs with telemetry as good as each other at most one seems better; half the noise is seen in most."""
    random, chance, better = np.random.default_rng(8), 0, 0
    for _ in range(20):
        soil, all_done = random.standard_normal((96, 2)), np.ones(96, dtype=bool)
        first, same, finer = (
            next_end(soil + noise * random.standard_normal(soil.shape), soil, soil, all_done)
            for noise in (0.4, 0.4, 0.1)
        )
        chance += same.surely_below(first, 10)
        better += finer.surely_below(first, 10)
    assert chance <= 1 and better >= 18


def test_the_next_end_is_that_of_the_drive_that_follows(yutu2: Rover) -> None:
    """Sinkage that tells the end exactly; physics move the next end by 0.1 m, which no drive teaches."""
    soil, noise, ends = ensemble(200)
    drives = made_up(yutu2, soil, 10.0 * np.eye(2), 0.0 * noise, ends)
    following = made_up(yutu2, soil, SLOPES, noise, soil)
    off = 0.1 * np.random.default_rng(2).standard_normal((200, 21, 2))
    moved = replace(following, discrepancy=DrawnDiscrepancy(law=FIRST, offsets_m=off, shares={}))
    found = teaching(drives, moved, ERRORS)
    assert found.next_end is not None and found.to_dict()["next_end_error_m"]["after"] == found.next_end.after_m
    assert found.next_end.floor_m == pytest.approx(0.1 * math.sqrt(2.0 * math.log(2.0)), rel=0.15)
    assert found.next_end.floor_m < found.next_end.after_m < 0.5 * found.next_end.before_m
    assert teaching(drives, errors=ERRORS).next_end is None


def test_what_tells_nothing_teaches_nothing(yutu2: Rover) -> None:
    ratios = []
    for seed in range(40):
        soil, noise, ends = ensemble(64, seed)
        ratios.append(teaching(made_up(yutu2, soil, 0.0 * SLOPES, noise, ends), errors=ERRORS).variance_reduction)
    assert np.mean(ratios) < 0.1


def test_too_few_drives_and_one_soil_are_refused(yutu2: Rover) -> None:
    soil, noise, ends = ensemble(16)
    with pytest.raises(ParameterError, match="give more members"):
        teaching(made_up(yutu2, soil, SLOPES, noise, ends), errors=ERRORS)
    with pytest.raises(ParameterError, match="one soil"):
        teaching(made_up(yutu2, 0.0 * soil, SLOPES, noise, ends), errors=ERRORS)


def test_the_way_back_ends_at_the_start(yutu2: Rover) -> None:
    """Arcs of either hand, crabwise, and a spot turn; a real drive without slip is not needed for geometry."""
    legs = (
        Leg(2.0, 0.2, wheel_test=WheelTest("FL", 0.7)),
        Leg(turn_deg=40.0),
        Leg(1.5, -0.3, 30.0),
        Leg(1.0, 0.0, 180.0),
    )
    plan = Plan(name="out", legs=legs, speed_m_s=0.05, x_m=1.0, y_m=-2.0, heading_deg=25.0)
    back = way_back(plan)
    assert all(leg.wheel_test is None for leg in back.legs)
    schedule = make_schedule(back, yutu2)
    x, y, heading = schedule.pose_at(np.array([schedule.duration_s]))[0]
    assert (x, y) == pytest.approx((1.0, -2.0), abs=0.01)
    assert math.remainder(heading - math.radians(25.0), 2 * math.pi) == pytest.approx(0.0, abs=0.01)
