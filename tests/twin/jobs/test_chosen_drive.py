"""The judge of chosen drives: its baseline keeps clear of what it must, its truths know limits, wrong claims fall."""

import dataclasses

import numpy as np
import pytest
from chosen_drives import Proposal, judged, over_cost_map, report, shortest
from cost_map import cost_map_legs
from errands import Errand, errand, kept, other_truths

from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.simulation.ensemble import predict


@pytest.fixture(scope="module")
def easy() -> Errand:
    """An errand on ground without hazards near the way."""
    return errand(0)


def test_the_cheapest_way_over_clear_ground_is_a_line(easy: Errand) -> None:
    plan = over_cost_map(easy)
    assert plan is not None
    assert plan.length_m == pytest.approx(np.hypot(*np.subtract(easy.target, easy.start[:2])), rel=0.01)


def test_it_goes_around_a_wall_and_ends_at_the_target(easy: Errand) -> None:
    surface = easy.surface
    begin, end = np.array(easy.start[:2]), np.array(easy.target)
    middle, along = 0.5 * (begin + end), (end - begin) / np.hypot(*(end - begin))
    x, y = np.meshgrid(surface.terrain.x_m - middle[0], surface.terrain.y_m - middle[1])
    ahead, aside = x * along[0] + y * along[1], y * along[0] - x * along[1]
    wall = (np.abs(ahead) < 0.1) & (np.abs(aside) < 1.0)
    walled = dataclasses.replace(surface, demand=np.where(wall, np.float32(2.0), surface.demand))
    legs = cost_map_legs(walled, easy.rover, easy.start, easy.target)
    assert legs is not None
    x0, y0, heading = easy.start
    plan = Plan(name="around", legs=legs, speed_m_s=0.05, x_m=x0, y_m=y0, heading_deg=heading)
    schedule = make_schedule(plan, easy.rover)
    places = schedule.pose_at(np.linspace(0.0, schedule.duration_s, 200))[:, :2]
    distance = np.hypot(*(places[:, None] - np.column_stack([x[wall], y[wall]]) - middle).transpose(2, 0, 1)).min()
    assert distance > surface.mobility.hazard_distance_m
    assert np.hypot(*(places[-1] - end)) < 0.2


def test_no_way_through_a_closed_ring(easy: Errand) -> None:
    surface = easy.surface
    x, y = np.meshgrid(surface.terrain.x_m - easy.target[0], surface.terrain.y_m - easy.target[1])
    ring = np.abs(np.hypot(x, y) - 1.0) < 0.15
    closed = dataclasses.replace(surface, demand=np.where(ring, np.float32(2.0), surface.demand))
    assert cost_map_legs(closed, easy.rover, easy.start, easy.target) is None


def test_kept_is_the_limits_and_the_end(easy: Errand) -> None:
    plan = shortest(easy)
    assert plan is not None
    drive = predict(easy.rover, easy.surface.terrain, plan, samples=easy.belief.draws(8, 1))
    assert kept(drive, easy).all()
    slip = float(np.abs(drive.states[..., 3]).max())
    tight = tuple(
        dataclasses.replace(limit, limit=0.99 * slip) if limit.quantity == "slip_ratio" else limit
        for limit in easy.limits
    )
    assert 1 <= (~kept(drive, dataclasses.replace(easy, limits=tight))).sum() < 8
    elsewhere = dataclasses.replace(easy, target=(easy.target[0] + 2.0, easy.target[1]))
    assert not kept(drive, elsewhere).any()


def test_other_physics_agree_where_the_ground_is_easy(easy: Errand) -> None:
    plan = shortest(easy)
    assert plan is not None
    assert other_truths(easy, plan, 2, 7).all()


def test_a_wrong_claim_that_none_is_safe_is_refuted(easy: Errand) -> None:
    row = judged(easy.number, lambda one, risk: Proposal(plan=None, promised=0.0, reason="a lie"), 0.05)
    assert row["refuted_by"] >= 0.95
    assert "refuted 1" in report([row])


def test_the_table_tells_what_is_off() -> None:
    rows = [
        {"errand": k, "risk": 0.05, "took_s": 1.0, "promised": 0.0, "reason": "", "plans": {},
         "candidates": [[0.55, 0.35, True], [0.95, 0.95, False]], "refuted_by": 0.0} for k in range(20)
    ]  # fmt: skip
    lines = report(rows).splitlines()
    assert any(line.startswith("  0.5 to 0.6") and line.endswith("-0.200") for line in lines)
    assert any(line.startswith("  0.9 to 1.0") and line.endswith("+0.000") for line in lines)
