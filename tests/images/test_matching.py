"""Refinement beside pictures in closed form; pairs that are spoilt, or written otherwise: right heights, or one line
that says what is wrong."""

import dataclasses
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.images.camera import Camera, Pose, StereoRig, covariance_of
from lunarsci.images.jobs.dem import StereoTerrain, dem
from lunarsci.images.matching import HALF_PX, MATCHED, SHADOW, _field, _islands, _relief, match, rectify, refine
from lunarsci.images.pictures import png_bytes, read_picture
from lunarsci.images.render import Landscape, RenderedPair, landscape_on, render
from lunarsci.images.rig_files import pose_text, rig_text


def light(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A texture in closed form."""
    random = np.random.default_rng(5)
    waves = random.uniform(-1.2, 1.2, (60, 2))
    turns = random.uniform(0, 2 * np.pi, 60)
    return 300 + sum(12 * np.sin(a * u + b * v + t) for (a, b), t in zip(waves, turns, strict=True))


@pytest.mark.parametrize(("half_px", "interpolation_px"), [(4, 0.02), (HALF_PX, 0.03)])
def test_refined_disparities_are_right_and_as_uncertain_as_they_say(half_px: int, interpolation_px: float) -> None:
    """Right(u - d, v) = left(u, v) with d linear; white noise of 2 in pictures of 300.

    Without noise the curve between pixels is what is off, which a smaller window averages less. With noise
    errors are 12 to 15 % larger than the normal matrix says; 1200 of them tell that to 2 %.
    """
    v, u = np.mgrid[:80, :160].astype(float)
    truth = 20 + 0.05 * u - 0.1 * v
    # Where a pixel of the right picture lies in the left one: u_r = u - d(u, v).
    back = (u + 20 - 0.1 * v) / (1 - 0.05)
    random = np.random.default_rng(1)
    plain = light(u, v), 0.8 * light(back, v) + 30
    start = truth + random.uniform(-0.5, 0.5, truth.shape)
    slopes = np.zeros_like(truth), np.full_like(truth, -0.05)
    exact = refine(*plain, start, slopes, half_px=half_px)
    known = np.isfinite(exact.disparity)
    assert known[10:-10, 50:-10].mean() > 0.99
    assert np.abs(exact.disparity - truth)[known].max() < interpolation_px
    assert np.nanmedian(exact.slope_u) == pytest.approx(0.05, abs=1e-3)
    errors = []
    for _ in range(12):
        noisy = [p + 2.0 * random.standard_normal(p.shape) for p in plain]
        found = refine(*noisy, start, slopes, half_px=half_px, step_px=9)
        errors.append(((found.disparity - truth) / found.sigma)[np.isfinite(found.disparity)])
    z = np.concatenate(errors)
    assert len(z) > 1200
    assert 0.95 < np.sqrt(np.mean(z**2)) < 1.2


def test_where_texture_is_weak_the_field_forgets_what_it_began_with() -> None:
    """Texture of 2 and white noise of 2, begun 1 px off: small windows keep most of that."""
    v, u = np.mgrid[:160, :240].astype(float)
    truth = 30 - 0.1 * v
    random = np.random.default_rng(3)
    noise = 2.0 * random.standard_normal((2, *u.shape))
    left, right = (10 + 0.035 * light(w, v) + n for w, n in zip((u, u + truth), noise, strict=True))
    within = np.s_[24:-24, 64:-24]
    begun = truth - 1.0
    small = refine(left, right, begun, (np.zeros_like(u), np.full_like(u, -0.1))).disparity
    assert np.nanmean((small - truth)[within]) < -0.4
    smooth = _field(*(p.astype(np.float32) for p in (left, right)), begun)
    off = (smooth.disparity - truth)[within]
    assert abs(np.nanmean(off)) < 0.06
    assert np.nanstd(off) < 0.3


def test_rows_that_are_apart_are_measured() -> None:
    """In two steps, as the derivative between rows is that of a smooth picture."""
    v, u = np.mgrid[:60, :120].astype(float)
    start, level = np.full(u.shape, 10.0), (np.zeros_like(u), np.zeros_like(u))
    total = 0.0
    for _ in range(2):
        right = light(u + 10, v - 0.4 + total)
        found = refine(light(u, v), right, start, level, step_px=5, rows=True)
        total += float(np.nanmedian(found.row_offset))
    assert total == pytest.approx(0.4, abs=0.03)


def test_rectified_rows_are_in_line() -> None:
    turn = Pose.looking([0, 0, 0]).rotation.T @ Pose.looking([0, 0, 0], 0.3, 0.1, 0.1).rotation
    rig = dataclasses.replace(square_rig(), rotation=turn, translation_m=np.array([-0.27, 0.001, 0.001]))
    frame = rectify(rig)
    points = np.random.default_rng(2).uniform([-0.6, -0.5, 2], [0.6, 0.5, 6], (50, 3))
    sides = zip((rig.left, rig.right), rig.project(points), (np.eye(3), rig.rotation), strict=True)
    rows = [frame.turn @ (camera.rays(pixels) @ turn).T for camera, pixels, turn in sides]
    np.testing.assert_allclose(rows[0][1] / rows[0][2], rows[1][1] / rows[1][2], atol=1e-12)
    apart = frame.focal_px * (rows[0][0] / rows[0][2] - rows[1][0] / rows[1][2])
    depth = (frame.turn @ points.T)[2]
    np.testing.assert_allclose(apart, frame.focal_px * rig.baseline_m / depth, rtol=1e-9)


def test_shadow_has_no_height_and_says_why(plain: StereoTerrain, pair: RenderedPair) -> None:
    places = np.rint(np.nan_to_num(plain.matches.rectified.maps[0], nan=0)).astype(int)
    v, u = np.clip(places[..., 1], 0, 319), np.clip(places[..., 0], 0, 319)
    dark = (pair.truth.lit[v, u] == 0) & (pair.truth.kind[v, u] > 0)
    from scipy.ndimage import binary_erosion

    deep = binary_erosion(dark, iterations=5)
    assert deep.sum() > 40
    assert (plain.matches.reason[deep] == SHADOW).mean() > 0.9
    assert (plain.matches.reason[deep] == MATCHED).mean() < 0.02


def test_patches_that_hang_in_nothing_are_islands() -> None:
    disparity = 60 - 0.1 * np.mgrid[:200, :300][0].astype(float)
    plane = disparity.copy()
    disparity[50:150, 50:250] = np.nan
    alone, beside, below, wide, stone = (
        np.s_[95:105, 70:85], np.s_[60:70, 55:65], np.s_[60:70, 200:215], np.s_[90:115, 150:175], np.s_[10:16, 20:26],
    )  # fmt: skip
    disparity[alone], disparity[below] = 40.0, 0.4 * plane[below]
    disparity[beside], disparity[wide] = plane[beside], 30.0
    disparity[stone] += 4.0
    islands = _islands(disparity)
    assert islands[alone].all() and islands[below].all()
    assert islands.sum() == 150 + 150


def test_relief_is_what_a_plane_leaves_of_the_window_that_is_refined() -> None:
    """Against planes by least squares; a spike counts as far as the 7 x 7 pixels about it, with what its plane leaves.

    Nothing of a window's 49 disparities but the middle is off: of the spike its mean takes 1/49, so that 48/49^2 of its
    square are left; off the middle the slopes take more.
    """
    v, u = np.mgrid[:30, :40].astype(float)
    plane = 50 - 0.3 * v + 0.02 * u
    assert _relief(plane) == pytest.approx(0.0, abs=1e-5)
    spiked = plane + 2.0 * ((v == 12) & (u == 20))
    found = _relief(spiked)
    assert found[12, 20] == pytest.approx(2.0 * np.sqrt(48) / 49, rel=1e-6)
    assert np.argwhere(found > 1e-3).min(axis=0).tolist() == [9, 17]
    assert np.argwhere(found > 1e-3).max(axis=0).tolist() == [15, 23]
    rough = plane + np.random.default_rng(1).normal(size=plane.shape)
    found = _relief(rough)
    for row, column in ((3, 3), (11, 27), (26, 36)):
        window = np.s_[row - 3 : row + 4, column - 3 : column + 4]
        columns = np.column_stack([np.ones(49), v[window].ravel(), u[window].ravel()])
        left = rough[window].ravel() - columns @ np.linalg.lstsq(columns, rough[window].ravel(), rcond=None)[0]
        assert found[row, column] == pytest.approx(np.sqrt((left**2).mean()), rel=1e-6)


def test_cameras_one_ahead_of_the_other_are_no_rig_that_can_be_rectified() -> None:
    lens = Camera(name="m", width_px=80, height_px=60, fx_px=90.0, fy_px=90.0, cx_px=39.5, cy_px=29.5)
    ahead = {"rotation": np.eye(3), "translation_m": np.array([-0.05, 0.0, -1.0]), "covariance": np.zeros((24, 24))}
    with pytest.raises(DataError, match="not to the right of the left one"):
        rectify(StereoRig(name="m", left=lens, right=lens, **ahead))


@pytest.mark.reference
def test_a_real_pair_is_matched_no_worse_than_by_opencv() -> None:
    """Motorcycle of Middlebury (Scharstein et al. 2014, 10.1007/978-3-319-11752-2_3), whose disparities are known."""
    import cv2

    folder = Path(os.environ["LUNARSCI_REFERENCE_DATA"]) / "images"
    archive = np.load(folder / "motorcycle_disp.npz")
    truth = np.asarray(archive[archive.files[0]], dtype=float)
    pictures = [read_picture(folder / f"motorcycle_{side}.png") for side in ("left", "right")]
    width, height = pictures[0].size
    focal, baseline = 994.978, 0.193001
    pinhole = {"fx_px": focal, "fy_px": focal, "cx_px": 0.5 * (width - 1), "cy_px": 0.5 * (height - 1)}
    lens = Camera(name="m", width_px=width, height_px=height, **pinhole)
    apart = {"rotation": np.eye(3), "translation_m": np.array([-baseline, 0, 0]), "covariance": np.zeros((24, 24))}
    found = match(*pictures, StereoRig(name="m", left=lens, right=lens, **apart), nearest_m=focal * baseline / 72)
    known = np.isfinite(truth) & (truth > 0)

    def bad(disparity: np.ndarray) -> float:
        both = known & np.isfinite(disparity)
        return float((np.abs(disparity - truth)[both] > 1).mean())

    grey = [np.clip(p.values, 0, 255).astype(np.uint8) for p in pictures]
    shares = []
    for mode in (cv2.STEREO_SGBM_MODE_HH, cv2.STEREO_SGBM_MODE_SGBM_3WAY):
        theirs = cv2.StereoSGBM_create(0, 80, 3, 72, 288, 1, 31, 15, 100, 2, mode).compute(*grey) / 16.0
        shares.append(bad(np.where(theirs > 0, theirs, np.nan)))
    assert bad(found.disparity) <= min(shares)
    both = known & np.isfinite(found.disparity)
    assert 0.58 < (np.abs(found.disparity - truth) < found.sigma_px)[both].mean() < 0.75


POSE = Pose.looking([0.0, 0.0, 1.5], 2.0, 30.0, 1.0)


def square_rig() -> StereoRig:
    lens = Camera(name="l", width_px=320, height_px=320, fx_px=400.0, fy_px=400.0, cx_px=162.0, cy_px=158.0, k1=-0.05)
    sigmas = dict.fromkeys(("left_cx_px", "right_cx_px", "left_cy_px"), 0.1)
    return StereoRig(
        name="SYNTHETIC square", left=lens, right=dataclasses.replace(lens, name="r", cx_px=158.0), rotation=np.eye(3),
        translation_m=np.array([-0.27, 0.0, 0.0]), covariance=covariance_of(sigmas),
    )  # fmt: skip


@pytest.fixture(scope="module")
def ground() -> Landscape:
    made = landscape_on(
        (0.2, -2.9, 0.2, np.zeros((30, 30))), name="g", seed=4, spacing_m=0.01, roughness=0.5, rocks_per_m2=3.0,
        sun_azimuth_deg=110, sun_elevation_deg=20,
    )  # fmt: skip
    boulder = [2.6, 0.3, 0.05, 0.15, 0.12, 0.3, 20.0]
    return dataclasses.replace(made, rocks=np.vstack([made.rocks, boulder]))


@pytest.fixture(scope="module")
def pair(ground: Landscape) -> RenderedPair:
    return render(ground, square_rig(), POSE, seed=3)


class Bench:
    """A folder with the rig, its pose and pictures by name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "rig.toml").write_text(rig_text(square_rig()))
        (folder / "pose.toml").write_text(pose_text(POSE))

    def save(self, name: str, values: np.ndarray) -> str:
        path = str(self.folder / name)
        if values.dtype == np.uint16 and values.ndim == 2:
            Path(path).write_bytes(png_bytes(values, {}))
        else:
            assert cv2.imwrite(path, values)
        return path

    def heights(self, left: str, right: str) -> StereoTerrain:
        rig, pose = str(self.folder / "rig.toml"), str(self.folder / "pose.toml")
        return dem(left, right, rig=rig, pose=pose, farthest=4.5)

    def refused(self, left: str, right: str) -> str:
        with pytest.raises(DataError) as caught:
            self.heights(left, right)
        assert "\n" not in str(caught.value)
        return str(caught.value)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(tmp_path_factory.mktemp("pairs"))


@pytest.fixture(scope="module")
def plain(bench: Bench, pair: RenderedPair) -> StereoTerrain:
    return bench.heights(bench.save("left.png", pair.left), bench.save("right.png", pair.right))


def coloured(values: np.ndarray, alpha: bool = False) -> np.ndarray:
    layers = [
        0.8 * values,
        values,
        0.95 * values,
        *([np.full_like(values, np.iinfo(values.dtype).max)] if alpha else []),
    ]
    return np.dstack([layer.astype(values.dtype) for layer in layers])


@pytest.mark.parametrize("kind", ["jpg", "16 bits", "colour", "alpha", "8 and 10 bits"])
def test_pictures_written_otherwise_give_the_same_heights(
    kind: str, bench: Bench, pair: RenderedPair, plain: StereoTerrain
) -> None:
    eight = [(p >> 2).astype(np.uint8) for p in (pair.left, pair.right)]
    pictures = {
        "jpg": eight,
        "16 bits": [(p << 6).astype(np.uint16) for p in (pair.left, pair.right)],
        "colour": [coloured(p) for p in eight],
        "alpha": [coloured(p, alpha=True) for p in eight],
        "8 and 10 bits": [eight[0], pair.right],
    }[kind]
    ending = "jpg" if kind == "jpg" else "png"
    found = bench.heights(*(bench.save(f"{kind[:2]}{k}.{ending}", p) for k, p in enumerate(pictures))).model
    x, y = np.meshgrid(found.x_m, found.y_m)
    apart = found.height_m - plain.model.at("height_m", x, y)
    stated = np.hypot(found.layer("height_m_sigma"), found.layer("height_m_common_sigma"))
    known = np.isfinite(apart)
    assert known.sum() > 0.8 * np.isfinite(plain.model.height_m).sum()
    assert (np.abs(apart) < 3 * stated)[known].mean() > 0.95


def test_turned_and_swapped_pictures_are_named(bench: Bench, pair: RenderedPair, plain: StereoTerrain) -> None:
    left, right = (str(bench.folder / f"{side}.png") for side in ("left", "right"))
    assert "show the same" in bench.refused(left, bench.save("again.jpg", (pair.left >> 2).astype(np.uint8)))
    assert "left and right are swapped" in bench.refused(right, left)
    both = [bench.save(f"u{k}.png", p[::-1, ::-1]) for k, p in enumerate((pair.left, pair.right))]
    assert "both are upside down" in bench.refused(*both)
    clockwise = [bench.save(f"q{k}.png", np.rot90(p, -1)) for k, p in enumerate((pair.left, pair.right))]
    assert "both pictures are turned by 90 deg clockwise" in bench.refused(*clockwise)
    turn = cv2.getRotationMatrix2D((160, 160), 3, 1)
    assert "turned by -3 deg" in bench.refused(left, bench.save("t.png", cv2.warpAffine(pair.right, turn, (320, 320))))
    assert "another rig's" in bench.refused(left, bench.save("s.png", pair.right[:300, :300]))
    assert "the left picture is turned" in bench.refused(bench.save("a.png", np.rot90(pair.left)), right)
    assert "the right picture is upside down" in bench.refused(left, bench.save("b.png", pair.right[::-1, ::-1]))
    assert "4.8 px too low" in bench.refused(left, bench.save("e.png", np.roll(pair.right, 5, axis=0)))


def test_pictures_that_show_nothing_are_refused(bench: Bench, pair: RenderedPair, plain: StereoTerrain) -> None:
    right = str(bench.folder / "right.png")
    assert "overexposed" in bench.refused(bench.save("c.png", np.full_like(pair.left, 1023)), right)
    assert "shows nothing" in bench.refused(bench.save("d.png", np.full_like(pair.left, 9)), right)
    (bench.folder / "f.png").write_bytes(b"no picture")
    assert "no picture" in bench.refused(str(bench.folder / "f.png"), right)


def test_a_rover_that_moved_between_the_pictures_is_noticed(
    bench: Bench, ground: Landscape, plain: StereoTerrain
) -> None:
    """By 3 cm and by 0.9 m along its way, as in 16 s at Yutu-2's 200 m an hour."""
    left = str(bench.folder / "left.png")
    for step, said in ((0.03, "the rover moved between the pictures"), (0.9, "")):
        moved = render(ground, square_rig(), Pose.looking([step, 0.0, 1.5], 2.0, 30.0, 1.0), seed=3).right
        assert said in bench.refused(left, bench.save("moved.png", moved))


def test_shadows_that_moved_make_no_heights(bench: Bench, ground: Landscape, plain: StereoTerrain) -> None:
    """The Sun 8 deg further, which is 16 hours of a lunar day: what is matched is right, or has no height."""
    later = dataclasses.replace(ground, sun_azimuth_deg=ground.sun_azimuth_deg + 8)
    right = bench.save("later.png", render(later, square_rig(), POSE, seed=3).right)
    found = bench.heights(str(bench.folder / "left.png"), right).model
    x, y = np.meshgrid(found.x_m, found.y_m)
    apart = np.abs(found.height_m - plain.model.at("height_m", x, y))
    stated = np.hypot(found.layer("height_m_sigma"), found.layer("height_m_common_sigma"))
    known = np.isfinite(apart)
    assert known.mean() > 0.1
    assert (apart < 3 * stated)[known].mean() > 0.93
