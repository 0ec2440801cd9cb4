"""The parts of the benchmark `loop.py` that its numbers rest on."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop import ERRORS, last_of_each, measured
from loop_report import after_past_returns, interval, region, report, verdicts
from mujoco_rover import Driven
from true_drives import Case, way_back

from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.physics_discrepancy import FIRST
from lunarsci.twin.assimilation.residuals import OBSERVED
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS

PLAN = read_plan()


def made_up(rover: Rover, samples: int = 600) -> Driven:
    """Synthetic: every wheel in one state, at the planned poses."""
    schedule = make_schedule(PLAN, rover)
    times = np.linspace(0.0, schedule.duration_s, samples)
    poses = np.zeros((samples, 6))
    poses[:, [0, 1, 5]] = schedule.pose_at(times)
    poses[:, 5] = np.degrees(poses[:, 5])
    states = np.zeros((samples, len(rover.wheels), len(STATE_COLUMNS)))
    states[..., [STATE_COLUMNS.index(name) for name in OBSERVED]] = 0.01, 0.1, -2.0, 36.0, 1.0, -2.0
    return Driven(time_s=times, poses=poses, states=states, outcome="finished")


def test_the_way_back_leads_back(yutu2: Rover) -> None:
    """The planned return from the planned end ends at the start, facing as at the start."""
    schedule = make_schedule(way_back(PLAN, made_up(yutu2)), yutu2)
    end = schedule.pose_at(np.array([schedule.duration_s]))[0]
    assert end == pytest.approx([PLAN.x_m, PLAN.y_m, np.radians(PLAN.heading_deg)], abs=1e-9)


def test_errors_of_measurement_are_as_stated(yutu2: Rover) -> None:
    """0.33 mm; 4 % of 1 - s and of the side slip; 10 %/3 of forces; of 1200 states. The same seed, the same errors."""
    driven = made_up(yutu2)
    one, three = (measured(yutu2, PLAN, driven, share, 5) for share in (0.04 / 3, 0.04))
    assert one.values.std(axis=0) == pytest.approx([0.00033, 0.036, 0.08, 1.2, 0.1 / 3, 0.2 / 3], rel=0.08)
    assert one.values.mean(axis=0) == pytest.approx([0.01, 0.1, -2.0, 36.0, 1.0, -2.0], rel=0.04)
    assert (one.values == three.values).all()
    assert three.fix_m - driven.poses[-1:, :2] == pytest.approx(3.0 * (one.fix_m - driven.poses[-1:, :2]))
    assert np.sqrt(three.fix_covariance_m2[0]) == pytest.approx(0.04 * PLAN.length_m * np.eye(2))
    assert ERRORS.sinkage_m == 0.00033


def test_hidden_soils_are_drawn_from_the_first_laws_the_same_for_every_physics() -> None:
    def soils(physics: str) -> np.ndarray:
        cases = [Case(physics=physics, number=n, seed=1, positions=()) for n in range(400)]
        return np.array([case.hidden(0) for case in cases])

    first = first_belief()
    assert (soils("same") == soils("exact")).all()
    assert soils("same").mean(axis=0) == pytest.approx(first.mean, abs=0.2 * np.sqrt(np.diag(first.covariance)).max())
    assert np.cov(soils("same").T) == pytest.approx(first.covariance, rel=0.25, abs=0.1)


def test_files_go_on_after_a_cut(tmp_path: Path) -> None:
    """A line that was cut off does not count; of a soil that is there twice, the last does."""
    lines = [{"physics": "same", "seed": 1, "soil": n, "before_m": k} for n, k in ((0, 1.0), (1, 2.0), (0, 3.0))]
    file = tmp_path / "made_up.jsonl"
    file.write_text("\n".join([*map(json.dumps, lines), '{"physics": "sa']), encoding="utf-8")
    assert [(row["soil"], row["before_m"]) for row in last_of_each([file, tmp_path / "none"])] == [(0, 3.0), (1, 2.0)]


def soil_ends(number: int) -> dict[str, Any]:
    """A return of 10 m that was 0.5 m short, on soils that leave 1 cm open."""
    random = np.random.default_rng(number)
    cloud = 0.01 * random.standard_normal((64, 2))
    alone = {"held": False, "held_50": False, "radius_m": 0.014, "radius_90_m": 0.02}
    return {"soil_ends_m": cloud.tolist(), "end_m": [-0.5, 0.0], "place_m": [-0.5, 0.0], "soil_only": alone,
            "place_m2": (1e-4 * np.eye(2)).tolist(), "way_m2": [[1.0, 0.0], [0.0, 0.0]],
            "discrepancy": FIRST.to_dict()}  # fmt: skip


def row(physics: str, number: int, after_m: float, held: bool, refused: str = "") -> dict[str, Any]:
    update = {"after_m": after_m, "held": held, "refused": refused, "radius_m": 0.1, "reduced": 1.0, "surprise": 1.0,
              "persistence": 0.1, "took_s": 2.0, "z": [0.5 if number else 1.5] * 8, "left": [0.5] * 8,
              "held_50": False, "radius_90_m": 0.2, "ground_z": [0.3] * 8, **soil_ends(number)}  # fmt: skip
    return {"physics": physics, "seed": 1, "soil": number, "terrain": "longji", "replaced": ["sank: deep"] * number,
            "drive_s": 2.0, "model_error": 1.0, "before_m": 1.0, "known_m": 0.05,
            "updates": {"third": update}}  # fmt: skip


def test_the_report_says_what_the_rows_do() -> None:
    rows = [row("same", n, 0.1 + 0.1 * n, n < 2) for n in range(3)]
    rows += [row("exact", n, 0.3 + 0.1 * n, n < 1, "why" if n == 2 else "") for n in range(3)]
    lines = [line.split() for line in report(rows).splitlines()]
    assert ["same", "3", "3", "(3", "sank)", "2.00", "1.000", "0.050"] in lines
    assert ["same", "all", "3", "1.000", "0.200", "0.20", "0.050", "0.280", "0.100"] in [line[:9] for line in lines]
    assert ["exact", "3", "0.200", "0.400", "2.00", "+200", "0.67", "->", "0.33"] in lines
    own = [
        "exact",
        "cohesion_pa",
        "0.50",
        "(0.01-0.99)",
        "1.00",
        "(0.16-1.00)",
        "1.00",
        "1.00",
        "0.50",
        "+1.00",
        "0.50",
    ]
    assert own in lines
    assert ["exact", "soil", "alone", "0.00", "(0.00-0.71)", "0.00", "(0.00-0.71)", "0.014", "0.020"] in lines


def test_past_returns_teach_the_region_of_the_next() -> None:
    """Each return is 0.5 of the exposed way short: outside of the first region, inside after ten others that were."""
    rows = [one | one["updates"]["third"] for one in (row("exact", n, 0.1, True) for n in range(11))]
    none, ten = (after_past_returns(rows, past) for past in (0, 10))
    assert not any(one["held"] for one in none) and all(one["held"] for one in ten)
    assert np.median([one["radius_m"] for one in ten]) > 3.0 * np.median([one["radius_m"] for one in none])


def test_a_region_of_draws_of_one_law_holds_its_share() -> None:
    """Student's t with 3 degrees of freedom: by rank, tails do not matter."""
    random = np.random.default_rng(0)
    found = [region(random.standard_t(3.0, (128, 2)), random.standard_t(3.0, 2)) for _ in range(400)]
    assert np.mean([one["held"] for one in found]) == pytest.approx(0.9, abs=0.04)
    assert np.mean([one["held_50"] for one in found]) == pytest.approx(0.5, abs=0.07)


def test_intervals_are_those_of_clopper_and_pearson() -> None:
    """9 of 10: 0.5550 to 0.9975, as tabulated."""
    assert interval([True] * 9 + [False]) == "0.90 (0.55-1.00)"


def test_verdicts_are_counted_by_what_was_kept() -> None:
    """Two soils with two plans each: one GO that keeps, three NO-GO of which one would have."""
    said = {"go": {"verdict": "go", "risk": 0.04}, "no": {"verdict": "no-go", "risk": 0.9}}
    kept = ([True, False], [True, False])
    rows = [
        {
            "physics": "exact",
            "terrain": "longji",
            "soil": soil,
            "limits": [{"kept": one, "untaught": said["no"]} for one in own],
            "verdicts": [said["go" if soil == 0 and one else "no"] for one in own],
        }
        for soil, own in enumerate(kept)
    ]
    lines = [line.split() for line in verdicts(rows).splitlines()]
    brier = (0.04**2 + 0.9**2 + 2 * 0.1**2) / 4
    after = ["exact", "after", "it", "0.50", "1.00±0.00", "of", "1", "0.33±0.44", "of", "3", f"{brier:.3f}", "0.250"]
    assert after in lines
    assert ["exact", "after", "it", "0.8-0.95", "3", "0.900", "0.667"] in lines
    assert verdicts([{"physics": "exact"}])
