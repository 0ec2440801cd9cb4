"""Drives made of others by what their ensemble tells: aimed off against a slide, halted before the tightest place."""

import dataclasses
import math

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.choice.chances import Weakest
from lunarsci.twin.choice.choice import choose
from lunarsci.twin.choice.conditions import Conditions
from lunarsci.twin.choice.improvement import Improvement, mean_drift
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.plans.limits import Limit
from lunarsci.twin.plans.path import planned_pose
from lunarsci.twin.plans.plan import Fixes, Leg, Plan, parse_plan
from lunarsci.twin.plans.plan_files import plan_text
from lunarsci.twin.routes.aiming import bent_plan, halting_at
from lunarsci.twin.rover import Rover

GIVEN = {"slip_ratio": 0.6, "side_slip_deg": 90.0, "sinkage_m": 0.15, "endpoint_miss_m": 0.4}
END = tuple(Limit(name, "", value, "test", False) for name, value in GIVEN.items())
STRAIGHT = Plan(name="straight", legs=(Leg(5.0),), speed_m_s=0.05, limits=END)
FREE = Improvement(fits=lambda plan: True, most_curvature_per_m=1.0 / 1.5, fixes=Fixes(0.05, 0.5, halt_s=60.0))


@pytest.fixture(scope="module")
def hill(yutu2: Rover) -> Conditions:
    """A plane that falls to the right by 5 deg: whoever drives across it slides down."""
    x, y = np.arange(-2.0, 8.01, 0.25), np.arange(-5.0, 5.01, 0.25)
    height = math.tan(math.radians(5.0)) * y[:, None] + 0.0 * x[None, :]
    ground = build_terrain("hill", -2.0, -5.0, 0.25, height, read_soil("longji"), synthetic=True)
    first = first_belief()
    known = dataclasses.replace(first, covariance=0.04 * first.covariance)
    return Conditions(rover=yutu2, terrain=ground, samples=known.draws(48, 3), discrepancy=known.discrepancy, seed=5)


def test_a_plan_is_bent_to_lead_through_places() -> None:
    """Places on a circle of 6 m radius are met, by an arc of that curvature; less is bent than may be."""
    shares = np.arange(1, 9) / 8
    angle = 5.0 * shares / 6.0
    places = 6.0 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    bent = bent_plan(STRAIGHT, shares, places, 1.0)
    assert bent is not None and np.array([leg.curvature_per_m for leg in bent.legs]) == pytest.approx(1 / 6, rel=0.1)
    assert np.hypot(*(planned_pose(bent, shares * bent.length_m)[:, :2] - places).T).max() < 0.02
    tight = bent_plan(STRAIGHT, shares, places, 0.1)
    assert tight is not None and max(abs(leg.curvature_per_m) for leg in tight.legs) <= 0.1


def test_a_drive_aims_off_against_its_slide(hill: Conditions) -> None:
    """What it made of a miss of half a metre: the mean end within a few cm of the target, and nearly none fails."""
    found = choose([STRAIGHT], hill, risk=0.05, members=16, improve=FREE)
    straight = next(one for one in found.candidates if one.number == 1)
    best = found.best
    off = [np.hypot(*(one.prediction.endpoints_m.mean(axis=0) - (5.0, 0.0))) for one in (straight, best)]
    assert off[0] > 0.4 and straight.chance.risk > 0.5
    assert best.plan.target_m == (5.0, 0.0) and off[1] < 0.1 and found.feasible
    # Uphill, to the left, and further than the first try would have told: the slide goes on.
    assert planned_pose(best.plan, best.plan.length_m)[1] > 0.3
    drift = mean_drift(best.prediction, STRAIGHT, np.arange(1, 9) / 8)
    assert drift is not None and np.hypot(*drift.T).max() < 0.15
    assert best.prediction.miss_m.mean() == pytest.approx(
        np.hypot(*(best.prediction.endpoints_m - (5.0, 0.0)).T).mean()
    )
    assert best.plan.name == "straight, aimed off" and not found.best.prediction.destination_m[1]


def test_an_aimed_plan_is_read_back_with_its_target() -> None:
    plan = dataclasses.replace(STRAIGHT, legs=(Leg(5.0, 0.05),), target_m=(5.0, 0.0))
    text = plan_text(plan)
    assert parse_plan(text, "").target_m == (5.0, 0.0) and plan_text(parse_plan(text, "")) == text
    for old, new in (("[target]\nx_m = 5.0\n", "[target]\n"), ("x_m = 5.0", "x_m = nan"), ("x_m = 5.0", "z_m = 5.0")):
        with pytest.raises(DataError, match=r"target|x_m"):
            parse_plan(text.replace(old, new), "")


def weakest(quantity: str, distance_m: float) -> Weakest:
    return Weakest(quantity, "m", 0.1, 0.2, 3, 0.0, 0.0, distance_m)


@pytest.mark.parametrize(
    ("quantity", "distance_m", "lengths"),
    [("keep_out_m", 3.0, [2.0, 3.0]), ("endpoint_miss_m", 5.0, [4.0, 1.0]), ("slip_ratio", 3.0, None)],
)
def test_a_halt_lies_before_the_tightest_place(hill: Conditions, quantity: str, distance_m: float, lengths) -> None:  # type: ignore[no-untyped-def]
    driven = hill.drive(STRAIGHT, range(4))
    halted = [plan for plan in FREE.plans(driven, weakest(quantity, distance_m), STRAIGHT) if plan.fixes is not None]
    assert [[leg.length_m for leg in plan.legs] for plan in halted] == ([] if lengths is None else [lengths])
    bare = dataclasses.replace(FREE, fixes=None)
    assert all(plan.fixes is None for plan in bare.plans(driven, weakest(quantity, distance_m), STRAIGHT))


def test_no_halt_is_set_beside_a_joint() -> None:
    plan = dataclasses.replace(STRAIGHT, legs=(Leg(2.0), Leg(3.0)))
    assert halting_at(plan, 2.2, 0.5) == plan.legs and len(halting_at(plan, 3.0, 0.5)) == 3
    assert sum(leg.length_m for leg in halting_at(plan, 3.0, 0.5)) == pytest.approx(5.0)


def test_what_does_not_fit_the_maps_is_not_tried(hill: Conditions) -> None:
    found = choose([STRAIGHT], hill, risk=0.05, members=16, improve=dataclasses.replace(FREE, fits=lambda plan: False))
    assert len(found.candidates) == 1
