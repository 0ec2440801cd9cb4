"""Pairs that are spoilt, or written otherwise: right heights, or one line that says what is wrong."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="needs the extra images")

import cv2

from lunarsci.errors import DataError
from lunarsci.images.camera import Camera, Pose, StereoRig, covariance_of
from lunarsci.images.jobs.dem import StereoTerrain, dem
from lunarsci.images.pictures import png_bytes
from lunarsci.images.render import Landscape, RenderedPair, landscape_on, render
from lunarsci.images.rig_files import pose_text, rig_text

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
    return landscape_on(
        (0.2, -2.9, 0.2, np.zeros((30, 30))), name="g", seed=4, spacing_m=0.01, roughness=0.5, rocks_per_m2=3.0,
        sun_azimuth_deg=110, sun_elevation_deg=20,
    )  # fmt: skip


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


def test_the_same_picture_twice_is_refused(bench: Bench, pair: RenderedPair, plain: StereoTerrain) -> None:
    left, again = str(bench.folder / "left.png"), bench.save("again.jpg", (pair.left >> 2).astype(np.uint8))
    assert "show the same" in bench.refused(left, left)
    assert "show the same" in bench.refused(left, again)


def test_turned_and_swapped_pictures_are_named(bench: Bench, pair: RenderedPair, plain: StereoTerrain) -> None:
    left, right = (str(bench.folder / f"{side}.png") for side in ("left", "right"))
    assert "swapped" in bench.refused(right, left)
    both = [bench.save(f"u{k}.png", p[::-1, ::-1]) for k, p in enumerate((pair.left, pair.right))]
    assert "both are upside down" in bench.refused(*both)
    clockwise = [bench.save(f"q{k}.png", np.rot90(p, -1)) for k, p in enumerate((pair.left, pair.right))]
    assert "both pictures are turned by 90 deg clockwise" in bench.refused(*clockwise)
    turn = cv2.getRotationMatrix2D((160, 160), 3, 1)
    assert "turned" in bench.refused(left, bench.save("t.png", cv2.warpAffine(pair.right, turn, (320, 320))))
    assert "another rig's" in bench.refused(left, bench.save("s.png", pair.right[:300, :300]))


def test_a_rover_that_moved_between_the_pictures_is_noticed(
    bench: Bench, ground: Landscape, plain: StereoTerrain
) -> None:
    """By 3 cm and by 0.9 m along its way, as in 16 s at Yutu-2's 200 m an hour."""
    left = str(bench.folder / "left.png")
    for step, said in ((0.03, "unevenly"), (0.9, "")):
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
