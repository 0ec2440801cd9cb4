"""Heights from pairs beside the truth of rendered ground, and beside closed forms."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from lunarsci.cli import main
from scipy.linalg import block_diag

from lunarsci.images.camera import PARAMETERS, Camera, Pose, StereoRig, covariance_of
from lunarsci.images.elevation import ElevationModel, read_elevation
from lunarsci.images.gridding import _common_errors, _lay, grid_of
from lunarsci.images.jobs.dem import StereoTerrain, dem
from lunarsci.images.matching import Rectified, StereoMatches
from lunarsci.images.pictures import png_bytes
from lunarsci.images.render import Landscape, RenderedPair, landscape_on, render
from lunarsci.images.rig_files import pose_text, read_pose, read_rig, rig_text
from lunarsci.twin.ground.synthetic import synthetic_terrain
from lunarsci.twin.ground.terrain import terrain_bytes


def small_rig(**changes: float) -> StereoRig:
    lens = Camera(name="l", width_px=400, height_px=320, fx_px=430.0, fy_px=430.0, cx_px=202.0, cy_px=158.0, k1=-0.05)
    other = Camera(name="r", width_px=400, height_px=320, fx_px=432.0, fy_px=432.0, cx_px=198.0, cy_px=160.0, k1=-0.06)
    sigma = dict.fromkeys(("left_cx_px", "right_cx_px", "left_cy_px"), 0.1) | {"rotation_y_rad": 1e-4}
    return StereoRig(
        name="small",
        left=lens,
        right=other,
        rotation=Pose.looking([0, 0, 0]).rotation.T @ Pose.looking([0, 0, 0], 0.3, 0.1, 0.1).rotation,
        translation_m=np.array([-0.27, 0.001, 0.001]),
        covariance=covariance_of({name: sigma.get(name, 0.0) for name in PARAMETERS}),
    )


@pytest.fixture(scope="module")
def ground() -> Landscape:
    flat = np.zeros((30, 30))
    made = landscape_on(
        (0.2, -2.9, 0.2, flat),
        name="g",
        seed=4,
        spacing_m=0.01,
        roughness=0.5,
        rocks_per_m2=3.0,
        sun_azimuth_deg=110,
        sun_elevation_deg=20,
    )
    boulder = [2.6, 0.3, 0.05, 0.15, 0.12, 0.3, 20.0]
    return dataclasses.replace(made, rocks=np.vstack([made.rocks, boulder]))


@pytest.fixture(scope="module")
def pair(ground: Landscape) -> RenderedPair:
    pose = Pose.looking([0.0, 0.0, 1.5], 2.0, 30.0, 1.0)
    return render(ground, small_rig(), pose, seed=3)


@pytest.fixture(scope="module")
def files(pair: RenderedPair, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("pair")
    contents = {"left.png": png_bytes(pair.left, {"Comment": "SYNTHETIC"}), "right.png": png_bytes(pair.right, {})}
    contents |= {"rig.toml": rig_text(small_rig()).encode(), "pose.toml": pose_text(pair.left_pose).encode()}
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return {name.partition(".")[0]: str(folder / name) for name in contents}


@pytest.fixture(scope="module")
def found(files: dict[str, str]) -> StereoTerrain:
    return dem(files["left"], files["right"], rig=files["rig"], pose=files["pose"])


@pytest.mark.parametrize("near", [(0,), (1,), (2,), (3,), (0, 1), (2, 3), (0, 2), (1, 3), (1, 2, 3), (0, 1, 2)])
def test_no_triangle_lies_across_an_edge(near: tuple[int, ...]) -> None:
    """Four neighbours of 12 and 10 px: 0.17 of the nearer one apart, wherever the edge runs."""
    numbers, place = np.array([[0, 1], [2, 3]]), np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]])
    disparity = np.where(np.isin(np.arange(4), near), 12.0, 10.0)
    for jump, laid in ((0.15, False), (0.18, True)):
        total, weight = np.zeros((3, 3, 1)), np.zeros((3, 3))
        _lay(numbers, place, np.ones((4, 1)), disparity, jump, total, weight)
        assert (weight.all(), weight.any()) == (laid, laid)


def errors(model: ElevationModel, ground: Landscape) -> np.ndarray:
    """Heights less the means of the ground over their cells. (ny, nx) [m]"""
    x, y = np.meshgrid(model.x_m, model.y_m)
    offsets = np.linspace(-0.008, 0.008, 5)
    return model.height_m - np.mean([ground.surface(x + a, y + b) for a in offsets for b in offsets], axis=0)


def test_common_errors_are_those_of_drawn_rigs_up_to_the_edges_of_what_is_seen() -> None:
    """A slope, seen in part, whose heights rigs that are drawn from the covariance get wrong: 300 draws, to 4 %."""
    rig, pose, random = small_rig(), Pose.looking([0.0, 0.0, 1.5], 10.0, 30.0, 2.0), np.random.default_rng(4)
    x, y = np.meshgrid(1.5 + 0.02 * np.arange(150), -0.9 + 0.02 * np.arange(90))
    height = np.where(random.random(x.shape) < 0.3, np.nan, 0.1 * x - 0.2 * y)
    height[(x - 3) ** 2 + y**2 < 0.25] = np.nan
    height[np.abs(y) > 0.4 * x] = np.nan
    known = np.isfinite(height)
    found, _ = _common_errors(rig, pose, height, (1.5, -0.9, 0.02), block_diag(np.zeros((6, 6)), rig.covariance))
    np.testing.assert_array_equal(np.isfinite(found), known)
    seen = pose.to_camera(np.column_stack([x[known], y[known], height[known]]))
    wrong = [pose.to_world(rig.triangulate(*rig.drawn(random).project(seen)).points) for _ in range(300)]
    off = np.array([there[:, 2] - 0.1 * there[:, 0] + 0.2 * there[:, 1] for there in wrong])
    np.testing.assert_allclose(found[known], np.sqrt((off**2).mean(axis=0)), rtol=0.14)


STEEP, WAVE_M = 0.25, 0.15
"""Greatest slope of waves along x and along y, and their length. [-, m]"""


ABOVE = Pose.looking([0.0, 0.0, 1.5], 0.0, 18.5)


FOCAL_PX, BASE_M = 1200.0, 0.27


def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Ground that falls by 0.05 along x, as uneven along x as along y: slopes about it have a mean square of
    `STEEP`^2 / 2. [m]"""
    turns = 2 * np.pi / WAVE_M
    return np.asarray(STEEP / turns * (np.sin(turns * x) + np.sin(turns * y + 1.0)) - 0.05 * (x - 4.5))


@pytest.fixture(scope="module")
def depths() -> np.ndarray:
    """How far 110 by 300 pixels see the waves from 1.5 m above them: the first crossing of each ray. [m]"""
    v, u = np.mgrid[:110, :300].astype(float)
    way = np.stack([(u - 149.5) / FOCAL_PX, (v - 54.5) / FOCAL_PX, np.ones(u.shape)], axis=-1) @ ABOVE.rotation.T

    def below(depth: np.ndarray) -> np.ndarray:
        return np.asarray(1.5 + depth * way[..., 2] < waves(depth * way[..., 0], depth * way[..., 1]))

    trials = np.linspace(1.4, 1.6, 300)[:, None, None] / -way[..., 2]
    first = below(trials).argmax(axis=0)
    low, high = (np.take_along_axis(trials, (first - k)[None], axis=0)[0] for k in (1, 0))
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = np.where(below(middle), low, middle), np.where(below(middle), middle, high)
    return low


def model_of(depths: np.ndarray, shift_px: float, sigma_px: float) -> ElevationModel:
    """Heights from disparities that are all off by a shift, by a rig without error."""
    disparity, blank = FOCAL_PX * BASE_M / depths + shift_px, np.zeros(depths.shape)
    frame = Rectified(np.eye(3), FOCAL_PX, (149.5, 54.5), BASE_M, np.zeros((2, *depths.shape, 2), np.float32))
    matches = StereoMatches(
        rectified=frame, left=blank, right=blank, disparity=disparity, sigma_px=blank + sigma_px,
        window_px=blank + 7.0, reason=blank.astype(np.uint8),
        row_offset_px=0.0,
    )  # fmt: skip
    rig = dataclasses.replace(small_rig(), covariance=np.zeros((len(PARAMETERS), len(PARAMETERS))))
    return grid_of(matches, rig, ABOVE, name="waves", spacing_m=0.01, farthest_m=20.0)


def test_an_error_along_the_ray_is_one_of_height_on_uneven_ground(depths: np.ndarray) -> None:
    """A point that is wrong along its ray is also beside itself, which slopes from node to node turn into height.

    Truth is what heights do where all disparities are off by 0.01 px, at 4 to 5 m: on even ground they would
    move by a sixth less. Differences from node to node lose 3 % of the slopes of these waves. A stated error is that
    of one pixel times w / (sqrt(n) + w - 1) of n pixels, w = 4.
    """
    exact, told = model_of(depths, 0.0, 1e-9), model_of(depths, 0.0, 0.05)
    x, y = np.meshgrid(exact.x_m, exact.y_m)
    up, down = (model_of(depths, shift, 1e-9).at("height_m", x, y) for shift in (0.01, -0.01))
    of_noise = told.layer("height_m_sigma") ** 2 - exact.layer("height_m_sigma") ** 2
    stated = np.sqrt(of_noise) / 0.05 * (np.sqrt(np.maximum(told.layer("count"), 1)) + 3) / 4
    true = (up - down) / 0.02
    known = np.isfinite(true) & np.isfinite(stated) & (np.abs(np.hypot(x, y) - 4.5) < 0.5)
    assert known.sum() > 3000
    assert np.sqrt(np.mean(stated[known] ** 2)) == pytest.approx(np.sqrt(np.mean(true[known] ** 2)), rel=0.04)


def test_heights_are_as_wrong_as_they_say(
    found: StereoTerrain, files: dict[str, str], pair: RenderedPair, ground: Landscape, tmp_path: Path
) -> None:
    """By the rig of the file, which differs from the true one within its covariance, and by the true one."""
    off = errors(found.model, ground)
    known = np.isfinite(off)
    assert known.sum() > 8000
    total = np.hypot(found.model.layer("height_m_sigma"), found.model.layer("height_m_common_sigma"))[known]
    assert np.sqrt(np.mean(off[known] ** 2)) < 1.2 * np.sqrt(np.mean(total**2))
    assert abs(np.median(off[known] / found.model.layer("height_m_common_sigma")[known])) < 3
    assert found.model.synthetic
    (tmp_path / "true.toml").write_text(rig_text(pair.rig))
    alone = dem(files["left"], files["right"], rig=str(tmp_path / "true.toml"), pose=files["pose"]).model
    off, random = errors(alone, ground), alone.layer("height_m_sigma")
    known = np.isfinite(off)
    assert np.sqrt(np.mean(off[known] ** 2)) < 1.2 * np.sqrt(np.mean(random[known] ** 2))
    assert 0.63 < (np.abs(off) < random)[known].mean() < 0.97


def test_heights_are_told(found: StereoTerrain, answered: Callable[..., str]) -> None:
    said = answered(found)
    assert re.search(r"Heights of [0-9.]+ by [0-9.]+ m of ground, [0-9]+ % of it unseen\. From [0-9.]+ to", said), said
    assert "mm from node to node and by" in said


def test_ground_without_texture_has_no_pits(tmp_path: Path) -> None:
    """Plain facets of 5 cm match where they do not belong: by 2 to 3 m too deep where islands of matches are kept."""
    from lunarsci.images.jobs.render import render as rendered

    heights = synthetic_terrain(seed=3, spacing_m=0.1, extent_m=24.0)
    (tmp_path / "ground.npz").write_bytes(terrain_bytes(heights))
    (tmp_path / "rig.toml").write_text(rig_text(read_rig("yutu2-navcam").with_pixels(600)))
    options = {"x": -2.4, "spacing": 0.05, "rocks": 0.4, "exact": True, "samples": 1}
    for name, make in rendered(str(tmp_path / "ground.npz"), rig=str(tmp_path / "rig.toml"), **options).files().items():
        (tmp_path / name).write_bytes(make())
    pair = (tmp_path / f"{side}.png" for side in ("left", "right"))
    seen = dem(*pair, rig=str(tmp_path / "rig.toml"), pose=str(tmp_path / "pose.toml"))
    with np.load(tmp_path / "truth.npz") as truth:
        (x0, y0, step), ground = truth["grid"], truth["ground_m"]
    known = np.isfinite(seen.model.height_m)
    x, y = (v[known] for v in np.meshgrid(seen.model.x_m, seen.model.y_m))
    off = (
        seen.model.height_m[known] - ground[np.rint((y - y0) / step).astype(int), np.rint((x - x0) / step).astype(int)]
    )
    total = np.hypot(seen.model.layer("height_m_sigma"), seen.model.layer("height_m_common_sigma"))[known]
    assert known.sum() > 40000
    assert (off > -0.2 - 3 * total).all()
    assert 0 < seen.matches.shares()["island"] < 0.02


def test_scripts_read_what_is_written(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "dem.npz"
    arguments = ["images", "dem", files["left"], files["right"], "--rig", files["rig"], "--pose", files["pose"]]
    arguments += ["--save-cloud", str(tmp_path / "cloud.ply"), "--save-disparity", str(tmp_path / "disparity.png")]
    assert (
        main([*arguments, "--save-terrain", str(target), "--plot", str(tmp_path / "dem.png"), "--json", "--no-time"])
        == 0
    )
    head, body = (tmp_path / "cloud.ply").read_bytes().split(b"end_header\n", 1)
    wanted = ["double x", "double y", "double z", "uchar red", "uchar green", "uchar blue", "float disparity_px"]
    assert re.findall(rb"property (.*)", head) == [w.encode() for w in [*wanted, "float sigma_px"]]
    kinds = ["<f8"] * 3 + ["u1"] * 3 + ["<f4"] * 2
    points = np.frombuffer(body, dtype=[(f"f{k}", kind) for k, kind in enumerate(kinds)])
    assert f"element vertex {len(points)}\n".encode() in head
    seen = read_elevation(target)
    apart = points["f2"] - seen.at("height_m", points["f0"], points["f1"])
    assert abs(np.nanmedian(apart)) < 0.001
    assert np.isfinite(apart).mean() > 0.9
    picture = cv2.imread(str(tmp_path / "disparity.png"), cv2.IMREAD_UNCHANGED) / 256
    assert picture.max() >= points["f6"].max() - 0.003
    assert (picture > 0).sum() >= len(points) > 20000
    result = json.loads(capsys.readouterr().out)["result"]
    assert sum(result["pixels"].values()) == pytest.approx(1)
    assert result["ranges"][0]["median_height_m_sigma"] < result["ranges"][-1]["median_height_m_sigma"]
    assert read_elevation(target).height_m_common_sigma is not None
    assert (tmp_path / "dem.png").stat().st_size > 20000


def test_without_a_pose_the_ground_is_level(files: dict[str, str]) -> None:
    free = dem(files["left"], files["right"], rig=files["rig"], farthest=4.0)
    assert free.levelled
    assert free.pose.angles_deg()[1] == pytest.approx(30, abs=2)
    assert abs(np.nanmedian(free.model.height_m)) < 0.03
    # Nobody knows by how much it leans: 3 deg along a line.
    away = np.hypot(*np.meshgrid(free.model.x_m, free.model.y_m))
    leaning = free.model.height_m_common_sigma / (np.tan(np.radians(2.965)) * away)
    assert np.nanmin(leaning) > 0.97 and np.nanmedian(leaning) < 1.2


def test_the_tilt_of_a_pose_is_as_uncertain_as_is_stated(files: dict[str, str]) -> None:
    """0.5 degrees raise level ground by tan 0.5 degrees a metre from the camera, to a part in ten on these waves."""
    given = {name: files[name] for name in ("rig", "pose")}
    rig_alone, leant = (
        dem(files["left"], files["right"], **given, farthest=4.0, tilt_error=tilt).model for tilt in (0.0, 0.5)
    )
    assert rig_alone.height_m_common_sigma is not None and leant.height_m_common_sigma is not None
    x, y = np.meshgrid(leant.x_m, leant.y_m)
    pose = read_pose(given["pose"])
    added = np.sqrt(leant.height_m_common_sigma**2 - rig_alone.height_m_common_sigma**2)
    expected = np.tan(np.radians(0.5)) * np.hypot(x - pose.center_m[0], y - pose.center_m[1])
    assert np.nanmedian(added / expected) == pytest.approx(1.0, abs=0.1)
