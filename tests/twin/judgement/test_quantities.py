"""Ground clearance against geometry.

Circles that the rover must not enter.
"""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsci.errors import DataError, ParameterError
from lunarsci.rovers import read_rover
from lunarsci.twin.judgement.quantities import clearance, clearance_of_poses, with_middles
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.plans.plan import Limit
from lunarsci.twin.rover import Body, Rover, build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict

BODY = Body(length_m=1.2, width_m=0.8, belly_z_m=0.05, center_x_m=0.1)
CORNERS = np.array([[0.1 + 0.6 * a, 0.4 * b, 0.05] for a in (-1, 1) for b in (-1, 1)])


def limited(prediction: Prediction) -> Prediction:
    limits = (Limit("clearance_m", "m", 0.05, "test", False),)
    return dataclasses.replace(prediction, plan=dataclasses.replace(prediction.plan, limits=limits))


def test_any_pose_over_a_plane_is_decided_by_a_corner(driven: Prediction, slope) -> None:  # type: ignore[no-untyped-def]
    over = dataclasses.replace(driven, terrain=slope(0.2, -0.1))
    random = np.random.default_rng(5)
    poses = random.uniform((0, -1, 0.5, -20, -20, -180), (6, 1, 1.5, 20, 20, 180), (40, 6))
    found, unknown = clearance_of_poses(over, BODY, poses)
    roll, pitch, yaw = poses[:, 3:].T
    turned = [Rotation.from_euler("ZYX", p, degrees=True).apply(CORNERS) for p in zip(yaw, pitch, roll, strict=True)]
    places = np.array(turned) + poses[:, None, :3]
    truth = (places[..., 2] - 0.2 * places[..., 0] + 0.1 * places[..., 1]).min(axis=1)
    assert found == pytest.approx(truth, abs=1e-9) and (unknown == 0).all()


def test_a_bump_takes_its_height_from_the_clearance(driven: Prediction, slope) -> None:  # type: ignore[no-untyped-def]
    fine = dataclasses.replace(slope(), spacing_m=0.05, height_m=np.zeros((161, 241)))
    x, y = fine.x_m, fine.y_m
    bump = 0.1 * np.exp(-((x[None, :] - 3.0) ** 2 + (y[:, None] - 0.2) ** 2) / 0.3**2)
    over = dataclasses.replace(driven, terrain=dataclasses.replace(fine, height_m=bump))
    poses = np.zeros((2, 6))
    poses[:, 0], poses[:, 2] = (3.0, 0.0), 0.3
    found, _ = clearance_of_poses(over, BODY, poses)
    assert found[0] == pytest.approx(0.35 - 0.1, abs=0.1 * (0.025**2 * 2) / 0.3**2 + 1e-4)
    assert found[1] == pytest.approx(0.35, abs=1e-6)


def test_a_rover_that_drives_up_a_slope_keeps_its_clearance(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    """Wheels 0.25 m below the origin, the underside 0.05 m above it: 0.30 m less the sinkage, square to the ground."""
    for rise in (0.0, 0.12):
        prediction = predict(yutu2, slope(rise), straight(1.0), sweep=())
        found, _ = clearance(prediction)
        sinkage = prediction.states[0, 5, :, 2]
        square = found[0, 5] * np.cos(np.arctan(rise))
        # The underside ends 0.1 m beyond the wheels, and these sink unevenly.
        assert 0.30 - 1.3 * sinkage.max() < square < 0.30 - 0.7 * sinkage.min()


def test_unknown_ground_is_said(driven: Prediction, slope) -> None:  # type: ignore[no-untyped-def]
    height = slope().height_m.copy()
    height[:, 20:] = np.nan
    over = dataclasses.replace(driven, terrain=dataclasses.replace(slope(), height_m=height))
    poses = np.zeros((3, 6))
    poses[:, 0], poses[:, 2] = (0.0, 2.65, 500.0), 0.3
    found, unknown = clearance_of_poses(over, BODY, poses)
    # Heights are known up to x = 2.75 m; the underside of the second pose is centred there.
    assert found[:2] == pytest.approx([0.35, 0.35]) and np.isnan(found[2])
    assert unknown[0] == 0.0 and unknown[1] == pytest.approx(0.5, abs=0.15) and unknown[2] == 1.0
    paths = np.tile(poses[1], (20, 11, 1))
    verdict = judge(limited(dataclasses.replace(over, paths=paths)))
    assert verdict.verdict == "no-go" and verdict.failed == 20
    assert any("ground below the body is not known in 20 of 20 drives" in reason for reason in verdict.reasons)


@pytest.mark.parametrize("interpolation", ["smooth", "triangles"])
def test_the_highest_stone_below_the_belly_counts(driven: Prediction, slope, interpolation: str) -> None:  # type: ignore[no-untyped-def]
    """A stone narrower than any grid on the belly, at any node; the belly is level, so that its height alone counts."""
    random = np.random.default_rng(8)
    flat = dataclasses.replace(
        slope(), x0_m=-1.0, y0_m=-1.0, spacing_m=0.02, height_m=np.zeros((101, 151)), interpolation=interpolation
    )
    for row, column in random.integers((30, 20), (70, 75), (20, 2)):
        height = flat.height_m.copy()
        height[row, column] = 0.28
        over = dataclasses.replace(driven, terrain=dataclasses.replace(flat, height_m=height))
        pose = np.array([[0.0, 0.0, 0.3, 0.0, 0.0, 0.0]])

        assert abs(flat.x_m[column] - 0.1) <= 0.6 and abs(flat.y_m[row]) <= 0.4
        assert clearance_of_poses(over, BODY, pose)[0] == pytest.approx(0.35 - 0.28, abs=1e-12)


def test_a_smooth_ground_is_higher_between_two_high_nodes() -> None:
    """Cubic convolution of 0, 1, 1, 0 is 9/8 half-way; two planes a cell are 1 there."""
    height = np.zeros((4, 6))
    height[:, 2:4] = 1.0
    assert with_middles(height, "smooth")[3, 5] == pytest.approx(9 / 8)
    assert with_middles(height, "triangles")[3, 5] == 1.0
    plane = np.add.outer(0.2 * np.arange(5.0), 0.3 * np.arange(4.0))
    for kind in ("smooth", "triangles"):
        assert with_middles(plane, kind) == pytest.approx(
            np.add.outer(0.1 * np.arange(9.0), 0.15 * np.arange(7.0)), abs=1e-12
        )


def test_a_rover_without_a_body_is_not_judged_by_it(driven: Prediction) -> None:
    bare = dataclasses.replace(driven, rover=dataclasses.replace(driven.rover, body=None))
    with pytest.raises(ParameterError, match=r"\[body\]"):
        clearance(bare)
    verdict = judge(limited(bare))
    assert "clearance_m" not in [limit.quantity for limit in verdict.limits]
    assert any("clearance_m was not judged" in note for note in verdict.notes)


def test_the_body_of_a_rover_file_is_read_and_checked() -> None:
    good = read_rover("yutu2")
    assert build_rover(good).body == Body(1.2, 0.75, 0.05)
    assert "body.belly_z_m" in good.assumed and "body.length_m" in good.assumed
    without = dataclasses.replace(good, tables={k: v for k, v in good.tables.items() if k != "body"})
    assert build_rover(without).body is None
    for wrong in ({"length_m": 0.0}, {"belly_z_m": float("nan")}, {"width_m": "wide"}):
        with pytest.raises(DataError):
            build_rover(dataclasses.replace(good, tables=good.tables | {"body": good.tables["body"] | wrong}))
