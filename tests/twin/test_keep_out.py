"""Ground to keep out of: files, maps, plans and predictions."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import lunarsci
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.twin.ground.hazards import ExclusionZone, near_way, read_keep_outs
from lunarsci.twin.jobs.plan import plan
from lunarsci.twin.jobs.terrain import terrain
from lunarsci.twin.plans.plan import Leg, Plan, parse_plan, plan_text

PLAN = Plan(name="ahead", legs=(Leg(2.0, 0.0),), speed_m_s=0.05)


def geojson(*features: dict[str, object]) -> InputFile:
    return InputFile("rocks.geojson", json.dumps({"type": "FeatureCollection", "features": list(features)}).encode())


def polygon(ring: list[list[float]], **own: object) -> dict[str, object]:
    return {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [ring]}, "properties": own}


def test_rocks_points_and_polygons_are_read() -> None:
    turns = np.linspace(0, 2 * math.pi, 25)
    ring = [[3 + 0.5 * math.cos(t), 1 + 0.5 * math.sin(t)] for t in turns]
    point = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}, "properties": {"radius_m": 0.3}}
    rock = polygon(ring, id=7, x_m=3.0, y_m=1.0, keepout_m=0.49)
    found = read_keep_outs(geojson(rock, polygon(ring, name="crater"), point))
    assert found[0] == ExclusionZone("rock 7", 3.0, 1.0, 0.49)
    assert found[1].name == "crater" and found[1].radius_m == pytest.approx(0.5)
    assert found[2] == ExclusionZone("keep-out 3", 1.0, 2.0, 0.3)


def test_what_is_not_round_is_covered_by_circles_that_hold_it() -> None:
    """An L of two arms of 4 m x 0.4 m: every point of it lies in a circle, and no circle reaches far beyond."""
    ring = [[0.0, 0.0], [4.0, 0.0], [4.0, 0.4], [0.4, 0.4], [0.4, 4.0], [0.0, 4.0], [0.0, 0.0]]
    zones = read_keep_outs(geojson(polygon(ring)))
    x, y = np.meshgrid(np.linspace(0, 4, 161), np.linspace(0, 4, 161))
    away = np.min([np.hypot(x - z.x_m, y - z.y_m) - z.radius_m for z in zones], axis=0)
    inside = (y <= 0.4) | (x <= 0.4)
    assert (away[inside] <= 1e-9).all()
    assert (away[(y > 1.0) & (x > 1.0)] > 0).all() and 10 < len(zones) < 500


def test_files_that_are_none_are_refused_with_the_feature_named() -> None:
    line = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[0, 0], [1, 1]]}, "properties": {}}
    point = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}, "properties": {}}
    for file, says in (
        (InputFile("a.geojson", b"[]"), "FeatureCollection"),
        (InputFile("a.geojson", b"nonsense"), "a.geojson"),
        (geojson(line), "feature 1.*LineString"),
        (geojson(point), "feature 1"),
        (geojson({"type": "Feature"}), "no geometry"),
        (geojson(polygon([[0, 0], [1, 1]])), "three corners"),
    ):
        with pytest.raises(DataError, match=says):
            read_keep_outs(file)


def test_a_drive_into_a_rock_is_named_with_place_and_margin(tmp_path: Path) -> None:
    """A rock of 10 cm that the left wheels roll over, whose edge is 0.475 m from the middle of the rover."""
    path = tmp_path / "rocks.geojson"
    rocks = [
        polygon([[0, 0]], id=k, x_m=x, y_m=y, keepout_m=0.1) for k, x, y in ((1, 1.5, 0.4), (2, 1.5, -2.0), (3, 30, 0))
    ]
    path.write_bytes(geojson(*rocks).data)
    found = lunarsci.predict(PLAN, soil=("longji",), sweep=("friction_angle_deg=35:39:2",), keep_out=(str(path),))
    half, verdict = 0.525, found.verdict
    assert len(found.prediction.plan.exclusion_zones) == 2 and verdict.verdict == "no-go"
    entered, other = verdict.keep_outs
    assert (entered.name, entered.entered_by) == ("rock 1", 2) and other.margin_m == pytest.approx(
        2 - half - 0.1, abs=0.02
    )
    # The rock's middle is below the rover then.
    assert entered.margin_m == pytest.approx(-0.1, abs=1e-6) and 0.3 < entered.distance_m <= 2.0
    assert any("'rock 1' at x 1.50 m, y 0.40 m is entered by 2 of 2 drives" in reason for reason in verdict.reasons)
    assert found.to_dict()["keep_outs"][0]["name"] == "rock 1"
    assert str(path) in found.made_from.inputs


def test_a_path_goes_around_and_its_plan_keeps_the_circles(tmp_path: Path) -> None:
    path = tmp_path / "rocks.geojson"
    path.write_bytes(geojson(polygon([[0, 0]], id=1, x_m=2.5, y_m=0.0, keepout_m=0.2)).data)
    asked = {"extent": 10.0, "craters": 0, "roughness": 0.0, "rocks": 0.0}
    survey = terrain("synthetic", **asked, keep_out=(str(path),))
    ground = survey.surface.terrain
    row, column = (round((at - low) / ground.spacing_m) for at, low in ((0.0, ground.y0_m), (2.5, ground.x0_m)))
    assert survey.surface.hazard[row, column] and "rock 1" in survey.surface.reason(row, column)
    free, around = (
        plan("synthetic", target=(4.0, 0.0), start=(0.0, 0.0, 0.0), **asked, keep_out=files).path
        for files in ((), (str(path),))
    )
    assert free is not None and around is not None
    assert not free.plan.exclusion_zones and around.plan.length_m > free.plan.length_m + 0.02
    assert around.plan.exclusion_zones == (ExclusionZone("rock 1", 2.5, 0.0, 0.2),)
    assert parse_plan(plan_text(around.plan), "again").exclusion_zones == around.plan.exclusion_zones
    (ground_file := tmp_path / "ground.npz").write_bytes(survey.site.content())
    assert lunarsci.predict(
        around.plan, terrain=str(ground_file), sweep=("friction_angle_deg=36:37:2",)
    ).verdict.keep_outs
    with pytest.raises(ParameterError, match="rock 1"):
        plan("synthetic", target=(2.5, 0.0), start=(0.0, 0.0, 0.0), **asked, keep_out=(str(path),))


def test_circles_far_from_the_way_are_left_out() -> None:
    zones = (ExclusionZone("a", 0.0, 2.0, 0.1), ExclusionZone("b", 0.0, 9.0, 0.1))
    assert near_way(zones, np.zeros((1, 2))) == zones[:1]
