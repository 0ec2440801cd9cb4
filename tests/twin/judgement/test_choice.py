"""The choice among drives: chances counted apart, races that end like full runs, and ways that are wide enough."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import beta

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.hazards import ExclusionZone
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.judgement.choice import (
    Conditions,
    DriveChoice,
    Weakest,
    choose,
    drive_candidates,
    joined,
    making_up_for_slip,
    ranked,
    verdicts,
)
from lunarsci.twin.judgement.quantities import along
from lunarsci.twin.plans.plan import AT_LEAST, Fixes, Leg, Limit, Plan
from lunarsci.twin.plans.risk import AcceptedRisk, Chance
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import Prediction


def limit(quantity: str, value: float, unit: str = "m") -> Limit:
    return Limit(quantity, unit, value, "the test", False)


END = (limit("slip_ratio", 0.6, "-"), limit("endpoint_miss_m", 0.4))
LAX = (limit("slip_ratio", 1.0, "-"), limit("side_slip_deg", 90.0, "deg"), limit("sinkage_m", 0.15))
"""What no drive breaks, in place of the rover's own limits."""


def plan(*legs: Leg, limits: tuple[Limit, ...] = END, zones: tuple[ExclusionZone, ...] = ()) -> Plan:
    return Plan(name="test", legs=legs, speed_m_s=0.05, limits=limits, exclusion_zones=zones)


@pytest.fixture(scope="module")
def hill() -> Terrain:
    """A plane that falls to the right by 12 deg, 8 m x 10 m."""
    x, y = np.arange(-2.0, 6.01, 0.25), np.arange(-6.0, 4.01, 0.25)
    height = math.tan(math.radians(12.0)) * y[:, None] + 0.0 * x[None, :]
    return build_terrain("hill", -2.0, -6.0, 0.25, height, read_soil("longji"), synthetic=True)


@pytest.fixture(scope="module")
def conditions(yutu2: Rover, hill: Terrain) -> Conditions:
    belief = first_belief()
    return Conditions(rover=yutu2, terrain=hill, samples=belief.draws(48, 3), discrepancy=belief.discrepancy, seed=5)


@pytest.fixture(scope="module")
def driven(conditions: Conditions) -> Prediction:
    """Across the slope, where soils tell."""
    limits = (*END, limit("sinkage_m", 0.03), limit("tilt_deg", 12.5, "deg"), limit("clearance_m", 0.05))
    return drive_candidates(conditions, [plan(Leg(3.0), limits=limits)], range(48))[0]


def test_the_chance_is_a_count_member_by_member(driven: Prediction) -> None:
    """Each drive, sample and wheel is looked at in a loop of its own."""
    failed = 0
    for member in range(driven.members):
        broken = driven.outcome[member] != 0
        for one in driven.plan.limits:
            values = driven.miss_m[member] if one.quantity == "endpoint_miss_m" else along(driven, one.quantity)[member]
            for value in np.ravel(values):
                beyond = value < one.limit if one.quantity in AT_LEAST else abs(value) > one.limit
                broken = broken or bool(beyond)
        failed += broken
    found = verdicts(driven)
    assert 0 < failed < driven.members
    assert found.chance == Chance(failed, driven.members) and int((~found.keeps).sum()) == failed


def test_commands_that_make_up_for_slip_take_the_median_drive_along_the_whole_way(
    yutu2: Rover, conditions: Conditions
) -> None:
    """Uphill and round a bend, with fixes and without: the way that drives leave on the ground beside the plan's."""
    sure = dataclasses.replace(conditions, discrepancy=None)
    up = dataclasses.replace(plan(Leg(1.0), Leg(2.0, 0.1)), heading_deg=60.0)
    for before in (up, dataclasses.replace(up, fixes=Fixes(0.01, 0.1))):
        after = making_up_for_slip([before], sure, 48)[0]
        old, new = drive_candidates(sure, [before, after], range(48))
        assert np.allclose(old.planned[-1], new.planned[-1]) and after.length_m == before.length_m
        driven_m = [np.hypot(*np.diff(one.places_m[one.finished], axis=1).T).sum(axis=0) for one in (old, new)]
        gone_old, gone_new = (float(np.median(way)) / before.length_m for way in driven_m)
        assert gone_old < 0.85 and gone_new == pytest.approx(1.0, abs=0.05)


def test_what_drives_stay_below_or_above_is_in_words() -> None:
    slid = Weakest("side_slip_deg", "deg", 72.94, 10.0, 5, 0.0, 0.0, 1.0)
    assert slid.why == "side_slip_deg: 95 % of the drives stay below 72.9 deg; the limit is 10 deg"
    assert "stay above 0.02 m;" in dataclasses.replace(slid, quantity="clearance_m", unit="m", value=0.02).why


def test_the_bounds_are_those_of_the_beta_law_and_cover_as_often_as_they_say() -> None:
    chance = Chance(3, 64)
    assert (chance.low, chance.high) == pytest.approx(beta(3.5, 61.5).ppf((0.05, 0.95)))
    assert chance.risk == pytest.approx(beta(3.5, 61.5).mean())
    random = np.random.default_rng(1)
    truths = random.uniform(0.02, 0.5, 4000)
    counts = random.binomial(64, truths)
    below = np.mean([Chance(int(k), 64).high >= p for k, p in zip(counts, truths, strict=True)])
    assert 0.93 < below < 0.97
    assert Chance(0, 64).low == 0.0 and Chance(64, 64).high == 1.0


def test_the_fewest_drives_that_can_promise_a_risk() -> None:
    for risk in (0.3, 0.05, 0.01):
        least = AcceptedRisk(risk).least_drives
        assert Chance(0, least).risk <= risk < Chance(0, least - 1).risk if least > 1 else True
    with pytest.raises(ParameterError, match="above 0, below 1"):
        AcceptedRisk(1.0)


def test_the_weakest_place_is_where_the_ground_is_steepest(yutu2: Rover, conditions: Conditions) -> None:
    """Level but for a ramp of 15 deg between x = 3 and 4 m: the tilt is largest there."""
    x, y = np.arange(-2.0, 8.01, 0.1), np.arange(-3.0, 3.01, 0.1)
    height = np.interp(x, (3.0, 4.0), (0.0, math.tan(math.radians(15.0))))[None, :] + 0.0 * y[:, None]
    ramp = build_terrain("ramp", -2.0, -3.0, 0.1, height, read_soil("longji"), synthetic=True)
    there = dataclasses.replace(conditions, terrain=ramp, discrepancy=None)
    only = (limit("tilt_deg", 8.0, "deg"),)
    weak = verdicts(drive_candidates(there, [plan(Leg(6.0), limits=only)], range(16))[0]).weakest
    assert weak.quantity == "tilt_deg" and weak.failed == 16 and "tilt_deg" in weak.why
    assert 2.4 < weak.x_m < 4.6
    # The place on the way that is drawn, not that of drives which slip and slide off it.
    assert (weak.x_m, weak.y_m) == pytest.approx((weak.distance_m, 0.0), abs=1e-9)


def test_members_driven_in_parts_are_those_driven_at_once(conditions: Conditions) -> None:
    """Without errors that are drawn for each part the paths are the same to the last bit."""
    exact = dataclasses.replace(conditions, discrepancy=None)
    plans = [plan(Leg(1.0)), plan(Leg(1.0, 0.1))]
    whole = drive_candidates(exact, plans, range(32))
    parts = [drive_candidates(exact, plans, part) for part in (range(16), range(16, 32))]
    for number, one in enumerate(whole):
        both = joined([part[number] for part in parts])
        assert (both.paths == one.paths).all() and (both.outcome == one.outcome).all()
        assert all((both.parameters[name] == values).all() for name, values in one.parameters.items())


def test_a_wider_way_wins_where_the_tight_one_is_risky(conditions: Conditions) -> None:
    """A straight drive drifts down the slope into a circle below it; a longer one bends away first."""
    x, y = np.arange(-2.0, 7.01, 0.25), np.arange(-5.0, 5.01, 0.25)
    height = math.tan(math.radians(5.0)) * y[:, None] + 0.0 * x[None, :]
    gentle = build_terrain("gentle", -2.0, -5.0, 0.25, height, read_soil("longji"), synthetic=True)
    there = dataclasses.replace(conditions, terrain=gentle)
    zone = (ExclusionZone("rock", 2.0, -1.3, 0.5),)
    tight = plan(Leg(4.0), limits=LAX, zones=zone)
    wide = plan(Leg(1.2, 0.6), Leg(2.4, -0.6), Leg(1.2, 0.6), limits=LAX, zones=zone)
    found = choose([tight, wide], there, risk=AcceptedRisk(0.3), members=24)
    assert [one.number for one in found.candidates] == [2, 1] and found.feasible
    assert found.candidates[1].stated.risk > 0.3 and found.candidates[1].weakest.quantity == "keep_out_m"
    assert found.candidates[1].length_m < found.best.length_m


def test_of_drives_that_are_alike_the_safest_is_the_best(conditions: Conditions) -> None:
    """85.4 and 86.2 J are within 1 %, 87 J is not; beyond the accepted risk energy counts for nothing."""
    base = choose([plan(Leg(1.0))], conditions, risk=AcceptedRisk(0.3), members=24).best
    told = [(86.2, 1), (85.4, 3), (87.0, 0), (80.0, 30)]
    found = [
        dataclasses.replace(base, number=k, energy_j=energy, promise=Chance(failed, 64))
        for k, (energy, failed) in enumerate(told, 1)
    ]
    assert [one.number for one in ranked(found, AcceptedRisk(0.1), "energy")] == [1, 2, 3, 4]
    assert [one.number for one in ranked(found, AcceptedRisk(0.1), "risk")] == [3, 1, 2, 4]


def ways() -> list[Plan]:
    """Twelve drives to about (4, 0), some of which slip or miss more than others."""
    bends = np.linspace(-0.45, 0.45, 12)
    limits = (limit("slip_ratio", 0.35, "-"), limit("endpoint_miss_m", 0.55), limit("side_slip_deg", 16.0, "deg"))
    return [plan(Leg(1.0, float(bend)), Leg(2.0, -float(bend)), Leg(1.0, float(bend)), limits=limits) for bend in bends]


@pytest.mark.parametrize("risk", [0.05, 0.3, 0.6])
def test_the_race_has_the_winner_of_the_full_run(conditions: Conditions, risk: float) -> None:
    plans = ways()
    raced = choose(plans, conditions, risk=AcceptedRisk(risk), members=32)
    full = choose(plans, conditions, risk=AcceptedRisk(risk), members=32, racing=False)
    assert raced.best.number == full.best.number and raced.feasible == full.feasible
    assert sum(one.prediction.members for one in raced.candidates) < sum(
        one.prediction.members for one in full.candidates
    )


def test_none_on_the_front_is_beaten_and_all_others_are(conditions: Conditions) -> None:
    found: DriveChoice = choose(ways(), conditions, risk=AcceptedRisk(0.3), members=32, racing=False)

    def aims(number: int) -> tuple[float, float, float]:
        one = next(one for one in found.candidates if one.number == number)
        return one.stated.risk, round(one.length_m, 3), one.energy_j

    numbers = [one.number for one in found.candidates]
    for number in numbers:
        beaten = any(
            all(a <= b for a, b in zip(aims(other), aims(number), strict=True)) and aims(other) != aims(number)
            for other in numbers
        )
        assert beaten != (number in [one.number for one in found.front])


def test_where_none_keeps_the_risk_it_says_what_stands_in_the_way(conditions: Conditions) -> None:
    steep = [dataclasses.replace(one, limits=(*LAX, limit("tilt_deg", 10.0, "deg"))) for one in ways()]
    found = choose(steep, conditions, risk=AcceptedRisk(0.05), members=16)
    assert not found.feasible and found.best.stated.risk > 0.9
    assert found.obstacles == (("tilt_deg", 12),)
    both = [dataclasses.replace(one, limits=(*one.limits, limit("sinkage_m", 1e-4, "m"))) for one in steep]
    broken = choose(both[:2], conditions, risk=AcceptedRisk(0.05), members=16).best.broken
    limits = {one.quantity: one for one in broken if one.quantity != "unfinished"}
    assert {name: one.limit for name, one in limits.items()} == {"tilt_deg": 10.0, "sinkage_m": 1e-4}
    for name, one in limits.items():
        assert one.value > one.limit and one.short.startswith(f"{name} {one.value:.3g}")
        assert one.short.endswith(f"({one.failed} drives)")


def test_the_promise_is_counted_on_soils_that_had_no_part_in_the_choice(conditions: Conditions) -> None:
    found = choose(ways(), conditions, risk=AcceptedRisk(0.5), members=16)
    assert found.fresh and found.best.promise is not None and found.best.promise.drives == 32
    again = drive_candidates(conditions, [found.best.plan], range(16, 48))[0]
    assert verdicts(again).chance == found.best.promise


def test_too_few_soils_for_the_risk_are_refused(conditions: Conditions) -> None:
    with pytest.raises(ParameterError, match=r"a risk of 0\.001 needs 499 or more"):
        choose(ways(), conditions, risk=AcceptedRisk(0.001))
    with pytest.raises(ParameterError, match="no limits"):
        choose([plan(Leg(1.0), limits=())], conditions, risk=AcceptedRisk(0.5), members=16)
    with pytest.raises(ParameterError, match="no plans to choose from"):
        choose([], conditions, risk=AcceptedRisk(0.5))
