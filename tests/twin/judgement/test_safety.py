"""What percentiles, margins, validity and the worst member of a verdict mean."""

import dataclasses

import numpy as np
import pytest
from lunarsci.cli.twin.predict import _limit_row

from lunarsci.pages.drive_answers import predicted
from lunarsci.twin.ground.hazards import ExclusionZone
from lunarsci.twin.judgement.quantities import encounters
from lunarsci.twin.judgement.safety import judge, validity
from lunarsci.twin.judgement.tables import check_loads, load_notes
from lunarsci.twin.lanes import HOLE, LEFT
from lunarsci.twin.plans.plan import Limit
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction

SINKAGE, SLIP, LOAD, VALID = map(STATE_COLUMNS.index, ("sinkage_m", "slip_ratio", "normal_force_n", "valid"))


def limited(prediction: Prediction, *limits: Limit) -> Prediction:
    return dataclasses.replace(prediction, plan=dataclasses.replace(prediction.plan, limits=limits))


def lifted(driven: Prediction, first: float) -> Prediction:
    """Level on level ground, member k with `first` + k cm between its underside and the ground."""
    paths = np.zeros_like(driven.paths)
    paths[..., 2] = (first + 0.01 * np.arange(20) - driven.rover.body.belly_z_m)[:, None]
    return dataclasses.replace(driven, paths=paths)


def test_small_clearances_are_the_bad_ones(driven: Prediction) -> None:
    """Of 20 drives 19 are 95 %: they keep 0.11 m and more; the smallest is 0.10 m."""
    limit, *_ = judge(limited(lifted(driven, 0.1), Limit("clearance_m", "m", 0.105, "test", False))).limits
    assert (limit.sense, limit.ok, limit.exceeding, limit.worst_member) == ("at least", True, 1, 0)
    assert (limit.min, limit.p05, limit.p50, limit.p95, limit.max) == pytest.approx((0.10, 0.11, 0.195, 0.28, 0.29))
    assert limit.margin == pytest.approx(0.005) and limit.judged == limit.kept == limit.p05
    verdict = judge(limited(lifted(driven, 0.1), Limit("clearance_m", "m", 0.115, "test", False)))
    assert verdict.verdict == "no-go" and verdict.reasons[0].endswith("break the limit 0.115; 95 % stay above 0.11")
    assert not any("break" in note for note in verdict.notes)


def test_the_sign_of_the_largest_slip_is_said_where_it_is_that_of_a_braking_wheel(driven: Prediction) -> None:
    states = driven.states.copy()
    for slip, said in ((0.4, 0), (-0.4, 1)):
        states[..., SLIP] = 0.1
        states[2, 3, 0, SLIP] = slip
        notes = judge(dataclasses.replace(driven, states=states)).notes
        assert sum(note.startswith("limits count the size of slip_ratio; the largest, -0.4,") for note in notes) == said


def test_a_start_that_is_none_is_said(driven: Prediction) -> None:
    outcome, recorded = driven.outcome.copy(), driven.recorded.copy()
    outcome[:2], recorded[0] = LEFT, 1
    went_on = judge(dataclasses.replace(driven, outcome=outcome, recorded=recorded)).reasons[0]
    recorded[1] = 1
    began = judge(dataclasses.replace(driven, outcome=outcome, recorded=recorded)).reasons[0]
    assert not went_on.endswith("start elsewhere") and began.endswith("where it starts; start elsewhere")


def test_drives_that_never_began_come_near_to_no_circle(driven: Prediction) -> None:
    circle = ExclusionZone(name="rock", x_m=5.0, y_m=0.0, radius_m=0.2)
    plan = dataclasses.replace(driven.plan, exclusion_zones=(circle,))
    assert [one.name for one in encounters(dataclasses.replace(driven, plan=plan))] == ["rock"]
    none = dataclasses.replace(driven, plan=plan, recorded=np.zeros_like(driven.recorded))
    assert encounters(none) == []


def test_limits_and_ends_are_said_to_be_of_the_drives_that_arrived(driven: Prediction) -> None:
    outcome = driven.outcome.copy()
    outcome[0] = LEFT
    limit = Limit("clearance_m", "m", 0.125, "test", False)
    verdict = judge(limited(dataclasses.replace(lifted(driven, 0.1), outcome=outcome), limit))
    assert verdict.arrived == 19 and verdict.reasons[0].startswith("1 of 20 drives ends early: left the terrain")
    assert verdict.reasons[1].startswith("clearance_m: 2 of the 19 that arrived break the limit")
    answer = predicted(dataclasses.asdict(verdict) | {"plan": "a", "rover": "b"}).text
    assert "in 95 % of the 19 drives that arrived" in answer and "1 of 20 drives ends early" in answer


def test_a_clearance_over_unknown_ground_is_unknown(driven: Prediction, monkeypatch: pytest.MonkeyPatch) -> None:
    """Below the body of one drive of 20 no height is given: 95 % of the drives keep the limit all the same."""
    unknown = np.zeros(driven.paths.shape[:2])
    unknown[3, 5] = 0.2
    for module in ("keeping", "safety"):
        monkeypatch.setattr(f"lunarsci.twin.judgement.{module}.clearance", lambda _: (unknown + 0.3, unknown))
    verdict = judge(limited(driven, Limit("clearance_m", "m", 0.05, "test", False)))
    limit = verdict.limits[0]
    assert (limit.ok, limit.judged, verdict.verdict) == (False, -np.inf, "no-go")
    assert [reason for reason in verdict.reasons if "clearance" in reason] == []
    assert [cell for cell in _limit_row(limit) if cell in ("-", "-inf", "unknown")] == ["-", "-", "unknown"]


def test_large_misses_are_the_bad_ones(driven: Prediction) -> None:
    paths = driven.paths.copy()
    paths[:, -1, :2] = driven.planned[-1, :2] + np.column_stack([0.01 * np.arange(1, 21), np.zeros(20)])
    missed = dataclasses.replace(driven, paths=paths)
    limit, *_ = judge(limited(missed, Limit("endpoint_miss_m", "m", 0.195, "test", False))).limits
    assert (limit.sense, limit.ok, limit.exceeding, limit.worst_member) == ("at most", True, 1, 19)
    assert (limit.min, limit.p05, limit.p50, limit.p95, limit.max) == pytest.approx((0.01, 0.02, 0.105, 0.19, 0.20))
    assert limit.margin == pytest.approx(0.005)


def test_a_chassis_in_the_ground_is_said(driven: Prediction) -> None:
    verdict = judge(limited(lifted(driven, -0.01), Limit("clearance_m", "m", 0.05, "test", False)))
    assert any("touch the ground" in note for note in verdict.notes) and verdict.verdict == "no-go"


def test_the_worst_member_uses_most_of_a_limit(driven: Prediction) -> None:
    """0.10 m of at least 0.08 m is 80 %; the tilt is 0 of 20 deg. A drive that stops is worse than any."""
    limits = (Limit("tilt_deg", "deg", 20.0, "test", False), Limit("clearance_m", "m", 0.08, "test", False))
    posed = limited(lifted(driven, 0.1), *limits)
    worst = judge(posed).worst
    assert worst.member == 0 and worst.parameters == {"friction_angle_deg": 30.0}
    assert "clearance_m of 0.1 m" in worst.why and "nearest" in worst.why
    outcome = posed.outcome.copy()
    outcome[11] = LEFT
    stopped = judge(dataclasses.replace(posed, outcome=outcome)).worst
    assert (stopped.member, stopped.parameters) == (11, {"friction_angle_deg": 41.0}) and "left" in stopped.why


@pytest.mark.parametrize(("least_m", "tightest", "member"), [(0.08, "sinkage_m", 7), (0.09, "clearance_m", 0)])
def test_the_tightest_limit_may_be_at_least_or_at_most(
    driven: Prediction, least_m: float, tightest: str, member: int
) -> None:
    """Member 7 sinks 17 mm of at most 20 mm, 85 %. Member 0 has 0.10 m of at least 0.08 m, 80 %, or 0.09 m, 90 %."""
    states = np.zeros_like(driven.states)
    states[..., SINKAGE], states[..., VALID] = 0.008, 1.0
    states[7, 5, 2, SINKAGE] = 0.017
    sunk = dataclasses.replace(lifted(driven, 0.1), states=states)
    limits = (Limit("sinkage_m", "m", 0.02, "test", False), Limit("clearance_m", "m", least_m, "test", False))
    verdict = judge(limited(sunk, *limits))
    assert [one.used for one in verdict.limits[:2]] == pytest.approx([0.85, least_m / 0.1])
    assert verdict.worst.member == member and tightest in verdict.worst.why
    assert verdict.worst.why.partition(" comes nearest to its limit, ")[1]


def test_a_clearance_of_nothing_uses_more_than_any_limit(driven: Prediction) -> None:
    low = limited(lifted(driven, -0.01), Limit("clearance_m", "m", 0.05, "test", False))
    assert judge(low).limits[0].used == np.inf
    assert judge(limited(lifted(driven, 0.0), Limit("clearance_m", "m", 0.0, "test", False))).limits[0].used == 0.0


def test_states_outside_of_the_model_are_counted_by_kind(driven: Prediction) -> None:
    """1320 states: 20 members, 11 samples, 6 wheels."""
    states = np.zeros_like(driven.states)
    states[..., SINKAGE], states[..., VALID] = 0.008, 1.0
    states[0, :, 0, SLIP], states[0, :, 0, VALID] = -0.7, 0.0
    states[1, :, :2, SINKAGE], states[1, :, :2, VALID] = 0.0, 0.0
    states[2, 0, 0, SINKAGE], states[2, 0, 0, VALID] = 0.14, 0.0
    states[3, :, 1, SINKAGE] = 0.004
    states[4, :, 1, SINKAGE] = 0.016
    outcome = driven.outcome.copy()
    outcome[5:7], outcome[7] = LEFT, HOLE
    found = validity(dataclasses.replace(driven, states=states, outcome=outcome))
    assert found.wheel_states == 1320
    assert found.slip_share == pytest.approx(11 / 1320) and found.unloaded_share == pytest.approx(22 / 1320)
    assert found.too_deep_share == pytest.approx(1 / 1320) and found.invalid_share == pytest.approx(34 / 1320)
    assert found.uncalibrated_share == pytest.approx((11 + 11 + 1) / 1320)
    assert (found.members_off_map, found.members_in_hole) == (2, 1)
    notes = " ".join(judge(dataclasses.replace(driven, states=states)).notes)
    for words in (
        "0.8 % of the wheel states slip",
        "1.7 % of the wheel states are in the air",
        "5 mm or more than 15 mm",
    ):
        assert words in notes
    assert "less than 0.1 % of the wheel states sink deeper" in notes


def test_wheels_that_hang_or_carry_too_much_are_counted(driven: Prediction) -> None:
    """One state of 0 N in one drive, two beyond twice the weight in another; what was not driven does not count."""
    weight = driven.rover.mass_kg * driven.rover.gravity_m_s2
    states = driven.states.copy()
    states[..., LOAD] = weight / 6
    assert load_notes(check_loads(dataclasses.replace(driven, states=states))) == []
    states[3, 2, 0, LOAD] = 0.0
    states[5, 1:3, 4, LOAD] = 2.1 * weight
    states[7, -1, 0, LOAD] = -1.0
    recorded = driven.recorded.copy()
    recorded[7] = states.shape[1] - 1
    found = check_loads(dataclasses.replace(driven, states=states, recorded=recorded))
    count = states[..., LOAD].size - states.shape[2]
    assert (found.hanging_members, found.overloaded_members) == (1, 1)
    assert (found.hanging_share, found.overloaded_share) == pytest.approx((1 / count, 2 / count))
    assert (found.least_n, found.most_n) == pytest.approx((0.0, 2.1 * weight))
    assert "carries nothing" in load_notes(found)[0] and "more than twice" in load_notes(found)[1]
    nothing = check_loads(dataclasses.replace(driven, recorded=np.zeros_like(recorded)))
    assert (nothing.least_n, nothing.most_n, nothing.hanging_members) == (None, None, 0)


@pytest.mark.parametrize("given", [(), (Limit("tilt_deg", "deg", 20.0, "test", False),)])
def test_limits_that_a_plan_leaves_out_are_the_rovers_own(driven: Prediction, given: tuple[Limit, ...]) -> None:
    """Half the slip that the law holds for, a third of the wheels' 0.15 m, the 20 deg of the file, 10 deg and 5 cm."""
    states = driven.states.copy()
    states[:, 5, 2, SLIP] = 0.55
    verdict = judge(limited(dataclasses.replace(driven, states=states), *given))
    own = {"slip_ratio": 0.3, "side_slip_deg": 10.0, "sinkage_m": 0.05, "tilt_deg": 20.0, "clearance_m": 0.05}
    judged = {limit.quantity: limit for limit in verdict.limits}
    assert {name: judged[name].limit for name in own} == pytest.approx(own)
    left_out = set(own) - {limit.quantity for limit in given}
    for name in left_out:
        assert judged[name].source.startswith("the rover's own, as the plan has none: ")
        assert judged[name].assumed == (name != "tilt_deg"), "of which Yutu-2's file names the source"
    [note] = [note for note in verdict.notes if "the rover's own" in note]
    assert set(note.partition(": ")[2].replace(",", "").split()[::2]) == left_out
    assert verdict.verdict == "no-go" and verdict.failed == 20
    assert any(reason.endswith("95 % stay below 0.55") for reason in verdict.reasons)


def test_a_verdict_does_not_rest_on_states_beyond_the_wheel_model(driven: Prediction) -> None:
    """Of 20 x 11 x 6 states 66 slip by 0.7, which are 5 %; with one that sinks by 0.14 m of 0.15 m they are more.

    A wheel in the air has no force, which is known.
    """
    lax = {"slip_ratio": 1.0, "side_slip_deg": 90.0, "sinkage_m": 0.15, "tilt_deg": 90.0, "clearance_m": 0.001}
    limits = [Limit(name, "", value, "test", False) for name, value in lax.items()]
    states = driven.states.copy()
    states[..., SINKAGE], states[..., SLIP] = 0.01, 0.1
    states[:10, ..., SINKAGE] = 0.0
    states[19, :, :, SLIP] = 0.7
    at_most = judge(limited(dataclasses.replace(driven, states=states), *limits))
    assert at_most.validity.beyond_share == pytest.approx(0.05) and at_most.verdict == "go"
    states[18, 0, 0, SINKAGE] = 0.14
    beyond = judge(limited(dataclasses.replace(driven, states=states), *limits))
    assert beyond.verdict == "no-go" and beyond.reasons == (
        "the wheel model does not hold for 5.1 % of the wheel states; at most 5.0 % are allowed",
    )
