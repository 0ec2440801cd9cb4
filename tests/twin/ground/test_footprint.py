"""Circles that the rover must not enter."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.twin.ground.footprint import rover_outline
from lunarsci.twin.judgement.quantities import exclusion_distance
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.plan import ExclusionZone, Limit, read_plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import Prediction


def at(prediction: Prediction, x: float, y: float, yaw_deg: float) -> Prediction:
    paths = prediction.paths.copy()
    paths[..., :2], paths[..., 5] = (x, y), yaw_deg
    return dataclasses.replace(prediction, paths=paths)


def sides(rover: Rover) -> tuple[float, float, float]:
    outline = rover_outline(rover)
    return outline.rear_m, outline.front_m, outline.half_width_m


def with_circles(prediction: Prediction, *circles: ExclusionZone, limits: tuple[Limit, ...] = ()) -> Prediction:
    return dataclasses.replace(
        prediction, plan=dataclasses.replace(prediction.plan, exclusion_zones=circles, limits=limits)
    )


def test_the_outline_is_that_of_wheels_and_body(yutu2: Rover) -> None:
    """Wheels at x = +-0.5 m, y = +-0.45 m, radius 0.15 m with grousers of 8 mm, width 0.15 m; they enclose the body."""
    assert sides(yutu2) == pytest.approx((-0.658, 0.658, 0.525))
    long = dataclasses.replace(yutu2, body=dataclasses.replace(yutu2.body, length_m=2.0, width_m=1.2))
    assert sides(long) == pytest.approx((-1.0, 1.0, 0.6))


@pytest.mark.parametrize("yaw", [0.0, 37.0, -120.0])
@pytest.mark.parametrize(
    ("ahead", "left", "radius", "distance"),
    [
        (0.2, 0.525 + 0.4, 0.4, 0.0),
        (0.0, -0.525 - 0.5, 0.4, 0.1),
        (-0.658 - 0.7, 0.1, 0.4, 0.3),
        (0.658 + 0.3, 0.525 + 0.4, 0.2, 0.3),
        (0.658 + 0.3, -0.525 - 0.4, 0.5, 0.0),
        (0.1, 0.1, 0.3, -0.3),
        (0.2, 0.525 + 0.1, 0.4, -0.3),
    ],
)
def test_distances_of_known_figures(
    driven: Prediction, yaw: float, ahead: float, left: float, radius: float, distance: float
) -> None:
    turn = np.radians(yaw)
    x, y = 3.0 + np.cos(turn) * ahead - np.sin(turn) * left, 1.0 + np.sin(turn) * ahead + np.cos(turn) * left
    posed = at(driven, 3.0, 1.0, yaw)
    assert exclusion_distance(posed, (ExclusionZone("rock", x, y, radius),)) == pytest.approx(distance, abs=1e-12)


def test_the_distance_is_that_to_the_nearest_point_of_the_outline(driven: Prediction) -> None:
    random = np.random.default_rng(4)
    edge = np.linspace(0.0, 1.0, 4001)[:, None]
    for x, y, yaw in random.uniform((0, 0, -180), (2, 2, 180), (20, 3)):
        corners = rover_outline(driven.rover).corners_m(np.array([x, y, np.radians(yaw)]))
        border = np.concatenate(
            [a + edge * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        )
        place = np.array([x, y]) + 2.0 * np.array([np.cos(5 * yaw), np.sin(5 * yaw)])
        truth = np.hypot(*(border - place).T).min() - 0.25
        circle = ExclusionZone("rock", float(place[0]), float(place[1]), 0.25)
        assert exclusion_distance(at(driven, x, y, yaw), (circle,))[0, 0] == pytest.approx(truth, abs=1e-6)


def test_the_nearest_circle_counts_and_none_is_infinitely_far(driven: Prediction) -> None:
    near, far = ExclusionZone("near", 0.0, 3.0, 0.4), ExclusionZone("far", 0.0, 9.0, 0.4)
    both = exclusion_distance(at(driven, 0.0, 0.0, 0.0), (far, near))
    assert both == pytest.approx(3.0 - 0.4 - 0.525) and np.isinf(exclusion_distance(driven)).all()


def test_a_single_drive_that_enters_is_a_no_go(driven: Prediction) -> None:
    paths = driven.paths.copy()
    paths[..., :2], paths[..., 5] = 0.0, 0.0
    paths[7, 5, 1] = 0.3
    posed = dataclasses.replace(driven, paths=paths)
    touched = judge(with_circles(posed, ExclusionZone("rock", 0.0, 1.2, 0.5)))
    limit = next(one for one in touched.limits if one.quantity == "keep_out_m")
    assert (limit.quantity, limit.sense, limit.limit, limit.exceeding, limit.worst_member) == (
        *("keep_out_m", "at least", 0.0, 1, 7),
    )
    assert limit.min == limit.judged == pytest.approx(1.2 - 0.5 - 0.525 - 0.3) and limit.p05 == pytest.approx(0.175)
    assert touched.verdict == "no-go" and "keep_out_m" in touched.reasons[0] and touched.worst.member == 7
    clear = judge(with_circles(posed, ExclusionZone("rock", 0.0, 1.4, 0.5)))
    assert clear.verdict == "go" and clear.keep_outs[0].margin_m == pytest.approx(0.075)
    wide = Limit("keep_out_m", "m", 0.1, "test", True)
    assert judge(with_circles(posed, ExclusionZone("rock", 0.0, 1.4, 0.5), limits=(wide,))).verdict == "no-go"


DRIVE = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 1.0\ncurvature_per_m = 0.0\n"
CIRCLE = "[[keep_out]]\nname = 'rock'\nx_m = 1\ny_m = 2.5\nradius_m = 0.5\n"


def test_a_plan_names_its_circles(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(DRIVE + CIRCLE + "[limits]\nkeep_out_m = 0\nclearance_m = 0.1\n")
    plan = read_plan(path)
    assert plan.exclusion_zones == (ExclusionZone("rock", 1.0, 2.5, 0.5),)
    assert [(limit.limit, limit.sense) for limit in plan.limits] == [(0.0, "at least"), (0.1, "at least")]
    for text, says in (
        (DRIVE + CIRCLE.replace("0.5", "0"), "radius_m is 0; give a number above 0"),
        (DRIVE + CIRCLE.replace("x_m = 1\n", ""), "no x_m"),
        (DRIVE + CIRCLE.replace("[[", "[").replace("]]", "]"), "double brackets"),
        (DRIVE + CIRCLE.replace("2.5", "nan"), "finite"),
        (DRIVE + "[limits]\nkeep_out_m = 0.1\n", r"\[\[keep_out\]\]"),
        (DRIVE + CIRCLE + "[limits]\nkeep_out_m = -0.1\n", "keep_out_m"),
    ):
        path.write_text(text)
        with pytest.raises(DataError, match=says):
            read_plan(path)
    with pytest.raises(ParameterError):
        ExclusionZone("rock", 0.0, 0.0, -1.0)
