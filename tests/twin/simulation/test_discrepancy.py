"""Drives moved by what the twin's physics is off by."""

import dataclasses

import numpy as np
import pytest
import quasi_static

from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.physics_discrepancy import FIRST, PhysicsDiscrepancy, VarianceLaw
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.assimilation.residuals import DriveBias, DriveRecord, DriveResiduals
from lunarsci.twin.comparison.forecast import forecast_of, match_observations, miss_of, taught
from lunarsci.twin.ground.hazards import ExclusionZone
from lunarsci.twin.judgement.endpoint import endpoint_spread
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.plan import Fixes, Leg, Limit, Plan, parse_sweep
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import (
    ALIKE_M,
    ALWAYS,
    TURNS,
    exposed,
    exposed_turns,
    turn_matrix,
    turned_places,
    way_matrix,
    with_discrepancy,
)
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

LINE = np.column_stack([np.linspace(0.0, 40.0, 401), np.zeros(401)])


def on_the_level(planned: np.ndarray, lost: float = 0.0) -> np.ndarray:
    return np.column_stack([(1.0 - lost) * planned, np.zeros(len(planned))])


def test_the_discrepancy_grows_with_the_way_and_with_what_is_lost_on_it() -> None:
    """As the way where it is alike all along, as its root far beyond; by the closed form of an exponential."""
    for length in (1.0, 10.0, 40.0):
        own = LINE[: int(10 * length) + 1]
        n = length / ALIKE_M
        closed = (ALWAYS * ALIKE_M) ** 2 * 2.0 * (n - 1.0 + np.exp(-n))
        assert way_matrix(own, on_the_level(own))[0, 0] == pytest.approx(closed, rel=0.01)
    lost = way_matrix(LINE, on_the_level(LINE, 0.2))
    assert lost[0, 0] / way_matrix(LINE, on_the_level(LINE))[0, 0] == pytest.approx(((ALWAYS + 0.2) / ALWAYS) ** 2)
    # Back to the start it has grown all the same, and a place where only the heading turns adds nothing.
    there = np.concatenate([LINE, LINE[-1:], LINE[::-1]])
    assert way_matrix(there, on_the_level(there))[0, 0] > 1.5 * way_matrix(LINE, on_the_level(LINE))[0, 0]
    assert exposed(there, on_the_level(there))[400] == ALWAYS


@pytest.fixture(scope="module")
def many(driven: Prediction) -> Prediction:
    """The 20 drives of 1 m, each 200 times."""
    chosen = np.tile(np.arange(20), 200)
    changes = {name: getattr(driven, name)[chosen] for name in ("paths", "states", "recorded", "outcome")}
    return dataclasses.replace(driven, parameters={}, **changes)


def test_draws_have_the_covariance_of_the_law(many: Prediction) -> None:
    law = dataclasses.replace(FIRST, along=VarianceLaw(40.0, 0.5), across=VarianceLaw(40.0, 0.1))
    moved = with_discrepancy(many, law, seed=1)
    assert moved.discrepancy is not None and np.array_equal(moved.paths, many.paths)
    expected = law.covariance_m2(way_matrix(many.planned[:, :2], many.paths[..., :3]))
    ends = moved.endpoints_m - many.endpoints_m
    assert np.sqrt(np.diag(np.cov(ends.T))) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.1)
    # The rover that comes farther slips less: what the wheels lose is what the path does.
    slip = STATE_COLUMNS.index("slip_ratio")
    less = many.states[:, 5, 0, slip] - moved.states[:, 5, 0, slip]
    farther = np.diff(moved.discrepancy.offsets_m[:, 4:6, 0])[:, 0]
    assert less == pytest.approx(farther / np.diff(many.planned[4:6, 0])[0], abs=1e-12)
    sinkage = STATE_COLUMNS.index("sinkage_m")
    ratio = moved.states[:, 5, 0, sinkage] / many.states[:, 5, 0, sinkage] - 1.0
    assert ratio == pytest.approx(moved.discrepancy.shares["sinkage_m"])
    again = with_discrepancy(many, law, seed=1)
    assert np.array_equal(again.endpoints_m, moved.endpoints_m) and np.array_equal(again.states, moved.states)


def test_the_verdict_holds_it(driven: Prediction) -> None:
    """Limits on the miss and circles are kept by the soils alone, and not with a discrepancy; it says what is whose."""
    law = dataclasses.replace(FIRST, along=VarianceLaw(10.0, 3.0), across=VarianceLaw(10.0, 3.0))
    soils = driven.miss_m.max()
    plan = dataclasses.replace(
        driven.plan,
        limits=(Limit("endpoint_miss_m", "m", 1.2 * soils, "test", False),),
        exclusion_zones=(ExclusionZone("stone", 0.5, 0.95, 0.1),),
    )
    alone, both = judge(driven, plan), judge(with_discrepancy(driven, law), plan)
    assert alone.verdict == "go" and alone.endpoint is not None and alone.endpoint.physics_share is None
    assert both.verdict == "no-go" and both.endpoint is not None
    assert any("endpoint_miss_m" in reason for reason in both.reasons)
    assert both.endpoint.covering_radius_m > 1.5 * alone.endpoint.covering_radius_m
    assert both.endpoint.soil_covariance_m2 == pytest.approx(np.array(alone.endpoint.covariance_m2))
    assert both.endpoint.physics_share is not None and both.endpoint.physics_share > 0.5
    clear = [{j.quantity: j.min for j in one.limits}["keep_out_m"] for one in (alone, both)]
    assert clear[1] < clear[0]


TURNING = Plan(name="turns", legs=(Leg(1.0), Leg(turn_deg=60.0), Leg(1.0)), speed_m_s=0.05)
END = np.array([1.5, np.sqrt(0.75)])
"""Of `TURNING`, whose turn is about (1, 0)."""


@pytest.fixture(scope="module")
def turned(yutu2: Rover, slope) -> Prediction:  # type: ignore[no-untyped-def]
    """The drive with a turn, on two soils, each 1500 times."""
    out = predict(yutu2, slope(), TURNING, sweep=(parse_sweep("friction_angle_deg=35:45:2"),))
    chosen = np.tile(np.arange(2), 1500)
    changes = {name: getattr(out, name)[chosen] for name in ("paths", "states", "recorded", "outcome")}
    return dataclasses.replace(out, parameters={}, **changes)


def test_a_turn_that_is_off_moves_what_follows_sidewards(turned: Prediction) -> None:
    """By the law's share of 60 deg times 1 m of what the turn is exposed to, and nothing before the turn."""
    small = dataclasses.replace(FIRST, along=VarianceLaw(40.0, 1e-6), across=VarianceLaw(40.0, 1e-6))
    moved = with_discrepancy(turned, small, seed=2)
    assert moved.discrepancy is not None
    offsets = moved.discrepancy.offsets_m
    assert np.abs(offsets[:, turned.distance_m < 0.99]).max() < 1e-4
    exposed_share = exposed_turns(turned.planned, turned.paths[..., 5])
    assert ((exposed_share > 0.1) & (exposed_share < 0.3)).all()
    size = np.sqrt(TURNS.variance) * np.median(exposed_share) * np.radians(60.0) * 1.0
    covariance = turn_matrix(TURNING, turned.planned, turned.distance_m, turned.paths)
    assert np.sqrt(np.trace(covariance)) == pytest.approx(size, rel=0.05)
    across = (END - (1.0, 0.0)) @ [[0.0, 1.0], [-1.0, 0.0]]
    assert offsets[:, -1] @ across == pytest.approx(
        np.hypot(*offsets[:, -1].T) * np.sign(offsets[:, -1] @ across), rel=0.05
    )
    assert np.sqrt((offsets[:, -1] ** 2).sum(axis=1).mean()) == pytest.approx(size, rel=0.1)
    few = {name: getattr(moved, name)[:20] for name in ("paths", "states", "recorded", "outcome")}
    drawn = dataclasses.replace(moved.discrepancy, offsets_m=offsets[:20])
    spread = endpoint_spread(dataclasses.replace(moved, discrepancy=drawn, **few))
    assert spread.physics_covariance_m2 == pytest.approx(covariance, rel=1e-3, abs=1e-9)


def test_turns_there_and_back_and_after_fixes_move_nothing(turned: Prediction) -> None:
    distance, places = np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    legs = (Leg(1.0), Leg(turn_deg=90.0), Leg(turn_deg=-90.0), Leg(1.0))
    there = dataclasses.replace(TURNING, legs=legs)
    assert np.abs(turned_places(there, distance, places, np.array(0.01))).max() < 0.03**2
    fixed = dataclasses.replace(TURNING, fixes=Fixes(0.01, 0.1))
    assert not turned_places(fixed, distance, places, np.array(0.1)).any()
    assert not turn_matrix(fixed, turned.planned, turned.distance_m, turned.paths).any()
    # A small share turns what follows about the place of the turn.
    own = turned_places(TURNING, distance, np.array([[0.0, 0.0], [1.0, 0.0], END]), np.array(0.01))
    angle = 0.01 * np.radians(60.0)
    assert own[2] == pytest.approx([-angle * END[1], angle * 0.5], abs=1e-4) and not own[:2].any()


def test_other_physics_turn_as_far_as_the_law_lets_them(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """By shares of at most what 19 in 20 turns are off by, and not all by next to nothing."""
    off = []
    for number, values in enumerate(zip(*first_belief().draws(3, 77).values(), strict=True)):
        soil = dict(zip(PARAMETERS, map(float, values), strict=True))
        plan = Plan(name="turn", legs=(Leg(turn_deg=40.0),), speed_m_s=0.05)
        twin = predict(yutu2, slope(), plan, samples={name: [value] for name, value in soil.items()})
        other = quasi_static.drive(yutu2, slope(), plan, soil, quasi_static.draw_physics(number))
        share = (other.poses[-1, 5] - twin.paths[0, -1, 5]) / 40.0
        off.append(share / float(exposed_turns(twin.planned, twin.paths[0, :, 5])))
    assert np.abs(off).max() < TURNS.half_width(0.95) and np.abs(off).max() > 0.02


def test_a_position_after_a_turn_does_not_speak_against_the_soil(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """An end that is off by 5 deg of the turn counts little, one that is as far off along the way in full."""
    true = predict(yutu2, slope(), TURNING)
    end, across = true.paths[0, -1, :2], np.array([-np.sqrt(0.75), 0.5])
    sizes = []
    for direction in (across, np.array([0.5, np.sqrt(0.75)])):
        record = DriveRecord(
            time_s=np.zeros(0), wheel=(), values=np.zeros((0, 6)), sigmas=np.zeros((0, 6)),
            fix_time_s=true.time_s[-1:].repeat(4), fix_m=np.tile(end + np.radians(5.0) * direction, (4, 1)),
            fix_covariance_m2=np.tile(4e-4 * np.eye(2), (4, 1, 1)),
        )  # fmt: skip
        bias = DriveBias({}, turns=float(np.sqrt(TURNS.variance)))
        drive = DriveResiduals(yutu2, slope(), TURNING, record, first_belief(), bias=bias)
        off = np.tile(-np.radians(5.0) * direction, 4)
        sizes.append(float((drive.marginalised.applied(drive.whitening @ off) ** 2).sum()))
    assert sizes[0] < 0.2 * sizes[1]


def a_fix(out: Prediction, off: tuple[float, float]) -> DriveRecord:
    """One position at the end, known to 1 mm, off the middle of the soils."""
    return DriveRecord(
        time_s=np.zeros(0), wheel=(), values=np.zeros((0, 6)), sigmas=np.zeros((0, 6)), fix_time_s=out.time_s[-1:],
        fix_m=(np.median(out.paths[:, -1, :2], axis=0) + off)[None], fix_covariance_m2=1e-6 * np.eye(2)[None],
    )  # fmt: skip


@pytest.mark.parametrize("law", [None, FIRST])
def test_a_comparison_scores_the_miss_and_learns(driven: Prediction, law: PhysicsDiscrepancy | None) -> None:
    """Measured against the middle of the soils, whether or not the prediction held a discrepancy."""
    predicted = driven if law is None else with_discrepancy(driven, law)
    matched = match_observations(forecast_of(predicted, soils="belief"), a_fix(driven, (-0.2, 0.05)))
    miss = miss_of(matched)
    assert miss is not None and (miss.along_m, miss.across_m) == pytest.approx((-0.2, 0.05), abs=1e-3)
    assert miss.along_share == pytest.approx(-0.2, abs=2e-3) and (miss.physics_m > 0) == (law is not None)
    after = taught(matched, FIRST)
    assert after.along.scale > 1.2 * FIRST.along.scale
    near = taught(match_observations(forecast_of(predicted, soils="belief"), a_fix(driven, (0.0, 0.0))), FIRST)
    assert near.along.scale < FIRST.along.scale and near.across.scale < FIRST.across.scale
    assert near.quantities == FIRST.quantities


def test_sinkage_is_scored_by_its_mean(driven: Prediction) -> None:
    """Every wheel sinks 1.5 times as deep as the middle soil says."""
    middle = driven.states[10, 1:]
    values = np.full((middle.shape[0] * 6, 6), np.nan)
    values[:, 0] = 1.5 * middle[..., STATE_COLUMNS.index("sinkage_m")].ravel()
    record = DriveRecord(
        time_s=np.repeat(driven.time_s[1:], 6), wheel=driven.rover.wheels * len(middle), values=values,
        sigmas=np.full(values.shape, 1e-5), fix_time_s=np.zeros(0), fix_m=np.zeros((0, 2)),
        fix_covariance_m2=np.zeros((0, 2, 2)),
    )  # fmt: skip
    before = dataclasses.replace(FIRST, quantities={**FIRST.quantities, "sinkage_m": VarianceLaw(5.0, 0.1)})
    for predicted in (driven, with_discrepancy(driven, before)):
        after = taught(match_observations(forecast_of(predicted, soils="belief"), record), before)
        share = after.quantities["sinkage_m"]
        assert 0.15 < share.scale < 0.35 and share.degrees > 4.5
        assert (after.along, after.across) == (before.along, before.across)


def test_no_draw_goes_beyond_what_a_quantity_can_have(many: Prediction) -> None:
    """Of a law as wide as three times the way: slip, side slip and sinkage reach their ends, and go no farther."""
    quantities = {name: VarianceLaw(10.0, 30.0) for name in FIRST.quantities}
    wide = dataclasses.replace(
        FIRST, along=VarianceLaw(10.0, 30.0), across=VarianceLaw(10.0, 30.0), quantities=quantities
    )
    states = with_discrepancy(many, wide, seed=3).states
    bounded = ("slip_ratio", "side_slip_deg", "sinkage_m")
    slip, side, sinkage = (np.abs(states[..., STATE_COLUMNS.index(name)]) for name in bounded)
    assert (slip.max(), side.max(), sinkage.max()) == pytest.approx((1.0, 90.0, many.rover.wheel.radius_m))
    assert states[..., STATE_COLUMNS.index("sinkage_m")].min() >= 0.0
