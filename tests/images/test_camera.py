"""Cameras and rigs beside OpenCV's lens and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.images.camera import (
    INTRINSICS,
    PARAMETERS,
    Camera,
    Pose,
    StereoRig,
    covariance_of,
    rotation_of,
    vector_of,
)
from lunarsci.images.jobs.cameras import CameraSheet
from lunarsci.images.jobs.requests import CamerasRequest

LENS = {"fx_px": 1189.0, "fy_px": 1187.0, "cx_px": 510.0, "cy_px": 513.0}


BENT = {"k1": -0.2, "k2": 0.05, "k3": 0.01, "p1": 1e-3, "p2": -2e-3}


def camera(**changes: float) -> Camera:
    return Camera(name="a", width_px=1024, height_px=1000, **(LENS | BENT | changes))


def points(count: int = 40) -> np.ndarray:
    random = np.random.default_rng(1)
    directions = np.column_stack([random.uniform(-0.4, 0.4, (count, 2)), np.ones(count)])
    return np.asarray(directions * random.uniform(1, 9, (count, 1)))


def rig(**changes: object) -> StereoRig:
    return StereoRig(
        **{
            "name": "r",
            "left": camera(),
            "right": camera(cx_px=505.0, k1=-0.21),
            "rotation": rotation_of([0.002, -0.01, 0.004]),
            "translation_m": np.array([-0.27, 0.002, 0.001]),
            "covariance": covariance_of({name: 0.1 if name.endswith("px") else 1e-4 for name in PARAMETERS}),
        }
        | changes
    )


def test_a_lens_is_that_of_opencv() -> None:
    cv2 = pytest.importorskip("cv2", reason="needs the extra images")
    lens = camera()
    theirs = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), lens.matrix, lens.distortion)[0][:, 0]
    np.testing.assert_allclose(lens.project(points()), theirs, atol=1e-9)


def test_a_pixel_comes_back_from_its_ray_and_derivatives_are_those_of_differences() -> None:
    pytest.importorskip("cv2", reason="needs the extra images")
    lens, there = camera(), points()
    np.testing.assert_allclose(lens.rays(lens.project(there)), there / there[:, 2:], atol=1e-13)
    seen = lens.project_with_derivatives(there)
    moved = [(lens.project(there + 1e-6 * e) - lens.project(there - 1e-6 * e)) / 2e-6 for e in np.eye(3)]
    turned = [
        (lens.project(there @ rotation_of(1e-6 * e).T) - lens.project(there @ rotation_of(-1e-6 * e).T)) / 2e-6
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(seen.pixels, lens.project(there), atol=1e-9)
    np.testing.assert_allclose(seen.by_pose, np.stack([*turned, *moved], -1), atol=1e-5)
    for index, e in enumerate(np.eye(len(INTRINSICS)) * 1e-6):
        more, less = lens.with_vector(lens.vector() + e), lens.with_vector(lens.vector() - e)
        np.testing.assert_allclose(
            seen.by_intrinsics[..., index], (more.project(there) - less.project(there)) / 2e-6, atol=1e-6
        )


def test_fewer_pixels_show_the_same_view() -> None:
    """A pixel's edges, not its middle, stay on the view's; where both pictures' edges are is the same direction."""
    whole, half = camera(), camera().scaled(0.5)
    assert half.size == (512, 500)
    there = points()
    np.testing.assert_allclose(half.project(there) + 0.5, 0.5 * (whole.project(there) + 0.5), atol=1e-12)
    corners = np.array([[-0.5, -0.5], [1023.5, 999.5]])
    np.testing.assert_allclose(half.rays(0.5 * (corners + 0.5) - 0.5), whole.rays(corners), atol=1e-13)
    assert half.field_of_view_deg() == pytest.approx(whole.field_of_view_deg(), abs=1e-9)


def test_a_rig_of_fewer_pixels_has_the_errors_of_the_same_view() -> None:
    """A drawn rig with fewer pixels is the rig of fewer pixels, drawn: its covariance is J C J^T, by differences."""
    random = np.random.default_rng(3)
    mixed = random.standard_normal((24, 24)) * np.sqrt(np.diag(rig().covariance))[:, None]
    whole = rig(covariance=mixed @ mixed.T)
    small = whole.with_pixels(256)
    assert small.left.size == small.right.size == (256, 250)
    step = 1e-3 * np.sqrt(np.diag(whole.covariance))

    def vector(one: StereoRig) -> np.ndarray:
        turned = vector_of(one.rotation @ whole.rotation.T)
        return np.concatenate([one.left.vector(), one.right.vector(), turned, one.translation_m])

    columns = [
        (vector(whole.moved(e).with_pixels(256)) - vector(whole.moved(-e).with_pixels(256))) / (2 * e.sum())
        for e in np.diag(step)
    ]
    jacobian = np.column_stack(columns)
    np.testing.assert_allclose(small.covariance, jacobian @ whole.covariance @ jacobian.T, rtol=1e-6, atol=1e-15)
    pixels = [side + 0.5 for side in whole.project(points())]
    for side, other in zip(small.project(points()), pixels, strict=True):
        np.testing.assert_allclose(side + 0.5, 0.25 * other, atol=1e-12)
    for width in (100, 0, -256):  # 1000 rows are 97.65625 of 100 columns' pixels
        with pytest.raises(ParameterError):
            whole.with_pixels(width)
    with pytest.raises(ParameterError, match="whole"):
        whole.with_pixels(512.5)


def test_what_no_lens_shows_is_not_a_number() -> None:
    lens = camera(k1=-0.4, k2=0.0, k3=0.0, p1=0.0, p2=0.0)
    assert lens.fold() == pytest.approx(math.sqrt(1 / 1.2))
    assert np.isnan(lens.project([[0.0, 0.0, -1.0], [1.0, 0.0, 1.0]])).all()
    assert np.isnan(lens.rays([[511.0 + 0.7 * 1189, 513.0]])[..., :2]).all()
    assert lens.sees([[0.0, 0.0], [1023.4, 999.4], [1023.6, 0.0], [-0.6, 0.0]]).tolist() == [True, True, False, False]


def test_pixels_beyond_the_border_are_not_seen() -> None:
    """Of 1024 by 1000 pixels whose middles count from 0, to half a pixel beyond the outermost one."""
    lens, low, right, bottom = camera(), -0.5, 1023.5, 999.5
    corners = np.array([[low, low], [right, low], [low, bottom], [right, bottom]])
    middle = np.array([512.0, 500.0])
    assert lens.sees(corners + 1e-6 * (middle - corners)).all()
    for off in ([1e-3, 0.0], [0.0, 1e-3]):
        assert not lens.sees(corners + np.sign(corners - middle) * off).any()


def test_a_camera_looks_where_it_is_told() -> None:
    pose = Pose.looking([1.0, 2.0, 1.5], heading_deg=30, down_deg=20, roll_deg=5)
    ahead = pose.rotation[:, 2]
    assert ahead == pytest.approx(
        [math.cos(0.349066) * math.cos(math.pi / 6), math.cos(0.349066) * 0.5, -math.sin(0.349066)], abs=1e-6
    )
    assert pose.angles_deg() == pytest.approx((30, 20, 5))
    assert Pose.looking([0, 0, 1]).rotation[:, 0] == pytest.approx(
        [0, -1, 0]
    )  # the right hand of one who looks along x
    assert pose.rotation[2, 0] < 0  # rolled clockwise, its right side is lower
    np.testing.assert_allclose(pose.to_camera(pose.to_world(points())), points(), atol=1e-12)
    with pytest.raises(ParameterError, match="without stretching"):
        Pose(rotation=2 * np.eye(3), center_m=np.zeros(3))


def test_triangulation_undoes_projection() -> None:
    pair = rig()
    left, right = pair.project(points())
    found = pair.triangulate(left, right)
    np.testing.assert_allclose(found.points, points(), atol=1e-9)
    assert found.miss_m.max() < 1e-9
    lifted = pair.triangulate(left, right + np.array([0.0, 1.0])).miss_m
    np.testing.assert_allclose(lifted, points()[:, 2] / 1187, rtol=0.2)  # one pixel off in the rows
    assert np.isnan(pair.triangulate([[500.0, 500.0]], [[900.0, 500.0]]).points).all()  # behind the cameras


def test_the_right_camera_is_where_its_picture_says() -> None:
    pair, pose = rig(), Pose.looking([3.0, 1.0, 1.5], 40, 15)
    there = pose.to_world(points())
    np.testing.assert_allclose(
        pair.right.project(pair.right_pose(pose).to_camera(there)), pair.project(points())[1], atol=1e-9
    )
    assert np.linalg.norm(pair.right_pose(pose).center_m - pose.center_m) == pytest.approx(pair.baseline_m)


def test_common_errors_are_those_of_drawn_rigs() -> None:
    """Covariance by derivatives beside what draws of the rig make of the same pixels."""
    pair, there = rig(), np.array([[0.3, 0.1, 3.0], [-0.5, 0.2, 6.0]])
    left, right = pair.project(there)
    by = pair.by_parameters(left, right)
    stated = np.sqrt(np.einsum("nip,pq,niq->ni", by, pair.covariance, by))
    random = np.random.default_rng(2)
    drawn = np.array([pair.drawn(random).triangulate(left, right).points for _ in range(1500)])
    np.testing.assert_allclose(drawn.std(axis=0), stated, rtol=0.08)
    noise = random.standard_normal((2, 1500, 2, 2))
    depth = pair.triangulate(left + noise[0], right + noise[1]).points[..., 2]
    assert depth.std(axis=0) == pytest.approx(pair.range_error_m(there[:, 2], math.sqrt(2)), rel=0.1)


def test_ranges_of_a_parallel_rig_by_hand() -> None:
    """1000 px of focal length, 0.3 m apart, the middle of the picture 100 px beside the axis: z = r / sqrt(1.01).

    Disparity f b / z, pixel z / f, random error z^2 s / (f b) along the slanted way; a baseline that is 1 mm off is 1
    part in 300 of every range. 500.5 px to the left of its middle the right picture ends, and nearer than the given
    distance nothing is sharp.
    """
    plain = Camera(name="a", width_px=1001, height_px=1001, fx_px=1000.0, fy_px=1000.0, cx_px=400.0, cy_px=500.0)
    pair = StereoRig(
        name="parallel",
        left=plain,
        right=plain,
        rotation=np.eye(3),
        translation_m=np.array([-0.3, 0.0, 0.0]),
        covariance=covariance_of({"translation_x_m": 1e-3}),
        nearest_m=0.7,
    )
    sheet = CameraSheet(rigs=(pair,), alone={}, request=CamerasRequest(disparity_error=0.5), inputs={})
    slant = math.sqrt(1.01)
    away = np.array([0.55, 0.65, 0.69, 0.7, 2.0])
    rows = sheet.ranges(pair, away.tolist())
    depth = away / slant
    expected = {
        "range_m": away,
        "disparity_px": 300.0 / depth,
        "pixel_m": depth / 1000.0,
        "range_random_m_sigma": depth**2 * 0.5 / 300.0 * slant,
        "seen_by_both": [False, False, False, True, True],
    }
    for name, values in expected.items():
        assert [row[name] for row in rows] == pytest.approx(values)
    assert [row["range_common_m_sigma"] for row in rows] == pytest.approx(away / 300.0, rel=1e-4)
    sharp = CameraSheet(rigs=(replace(pair, nearest_m=0.0),), alone={}, request=sheet.request, inputs={})
    assert [row["seen_by_both"] for row in sharp.ranges(sharp.rigs[0], [0.59, 0.61])] == [False, True]
    assert sheet.to_dict()["rigs"][0]["baseline_m_sigma"] == pytest.approx(1e-3)
