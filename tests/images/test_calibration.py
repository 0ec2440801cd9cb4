"""Calibration against SYNTHETIC boards seen through OpenCV's lens, and against itself on pictures of a real board."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import boards
import cv2
import numpy as np
import pytest
from lunarsci.cli import main
from lunarsci.cli.images.calibrate import EXAMPLES

from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.images.calibration import (
    BoardTarget,
    CameraCalibration,
    Sighting,
    alike_turned,
    calibrate,
    find_target,
    of_moments,
)
from lunarsci.images.camera import INTRINSICS, Camera, rotation_of, vector_of
from lunarsci.images.jobs.calibrate_cameras import SIDES, CalibratedCameras, _seen_share, calibrate_cameras
from lunarsci.images.jobs.requests import CalibrateCamerasRequest
from lunarsci.images.pictures import Picture
from lunarsci.images.rig_files import read_rig
from lunarsci.io.inputs import InputFile

SQUARE = 0.025
LEFT = boards.lens(520, 243, 196, (-0.12, 0.05, 5e-4, -8e-4, 0.01))
RIGHT = boards.lens(518, 236, 203, (-0.11, 0.04, -5e-4, 4e-4, 0.0))
TURN, WAY = cv2.Rodrigues(np.array([0.004, -0.012, 0.006]))[0], np.array([-0.12, 0.001, -0.002])
ORDER = [0, 1, 4, 2, 3]


def truth() -> np.ndarray:
    own = [
        [of.matrix[0, 0], of.matrix[1, 1], of.matrix[0, 2], of.matrix[1, 2], *of.terms[ORDER]] for of in (LEFT, RIGHT)
    ]
    return np.concatenate([*own, np.zeros(3), WAY])


def away(found: CameraCalibration) -> np.ndarray:
    own = [camera.vector() for camera in found.cameras]
    return np.concatenate([*own, vector_of(found.rotation @ TURN.T), found.translation_m]) - truth()


def simulated(count: int, random: np.random.Generator, noise: float = 0.05) -> list[Any]:
    """Corners straight from OpenCV's projection, with white noise. [px]"""
    points, views = BoardTarget().points_m, []
    for turn, place in boards.poses(count, (0.1, 0.0625), 0.45, random):
        there = points @ turn.T + place
        pixels = [
            cv2.projectPoints(p, np.zeros(3), np.zeros(3), of.matrix, of.terms)[0].reshape(-1, 2)
            for p, of in ((there, LEFT), (there @ TURN.T + WAY, RIGHT))
        ]
        noisy = [p + noise * random.standard_normal(p.shape) for p in pixels]
        inside = [((p > 0) & (p < of.size)).all(axis=1) for p, of in zip(noisy, (LEFT, RIGHT), strict=True)]
        both = zip(noisy, inside, strict=True)
        views.append(tuple(Sighting(np.flatnonzero(k), p[k]) if k.sum() > 10 else None for p, k in both))
    return views


def test_a_picture_is_seen_in_as_many_of_64_cells_as_hold_a_point() -> None:
    """Of 800 by 400 pixels: cells of 100 by 50; places half a pixel beyond the border belong to the outermost."""

    def share(*places: tuple[float, float]) -> float:
        rows = np.array([[0.0, u, v, 0.1, 0.2] for u, v in places])
        found: Any = SimpleNamespace(cameras=[None, SimpleNamespace(size=(800, 400))], residuals=[None, rows])
        return 64.0 * _seen_share(found, 1)

    assert share((-0.4, -0.4), (99.0, 49.0), (799.4, 399.4), (701.0, 351.0)) == pytest.approx(2.0)
    assert share((99.0, 10.0), (101.0, 10.0), (101.0, 60.0), (101.0, 40.0), (650.0, 390.0)) == pytest.approx(4.0)
    assert share(*((50.0 + 100 * i, 25.0 + 50 * j) for i in range(8) for j in range(8))) == pytest.approx(64.0)


def test_errors_of_a_rig_are_those_that_it_has() -> None:
    """Eight calibrations: the error over its covariance is a chi-square of 24."""
    random = np.random.default_rng(3)
    sizes = [LEFT.size, RIGHT.size]
    squares = []
    for _ in range(8):
        found = calibrate(simulated(12, random), BoardTarget(), sizes)
        delta = away(found)
        squares.append(float(delta @ np.linalg.solve(found.covariance, delta)))
        assert found.residual_px == pytest.approx(0.05, rel=0.12)
        assert found.between_pictures == pytest.approx(1.0, abs=0.45)
    assert np.mean(squares) == pytest.approx(24, abs=7.4)  # three standard errors of 2.45


@pytest.mark.parametrize(("bent", "between"), [(0.0, (0.4, 1.6)), (0.5, (2.0, 8.0))])
def test_leaving_pictures_out_is_what_refitting_without_them_does(bent: float, between: tuple[float, float]) -> None:
    """The linear jackknife beside one that fits anew; pictures that are bent, each in its way, raise it."""
    random, sizes = np.random.default_rng(4), [LEFT.size]
    views = [view[:1] for view in simulated(10, random)]
    bend = lambda pixels: 1.0 + bent * ((pixels[:, :1] - 240.0) / 240.0) ** 2  # noqa: E731
    bad = [(Sighting(s.numbers, s.pixels + 0.4 * random.standard_normal(2) * bend(s.pixels)),)
           for view in views if (s := view[0]) is not None]  # fmt: skip
    found = calibrate(bad, BoardTarget(), sizes, distortion=2)
    fits = [
        calibrate(bad[:k] + bad[k + 1 :], BoardTarget(), sizes, distortion=2).cameras[0].vector()
        for k in range(len(bad))
    ]
    spread = np.sqrt(((np.array(fits) - np.mean(fits, axis=0)) ** 2).sum(axis=0) * (len(bad) - 1) / len(bad))
    stated = np.sqrt(np.diag(found.covariance))
    shown = stated > 0
    # A shift of the whole board is taken up by its pose: the errors must not grow.
    assert between[0] < found.between_pictures < between[1]
    assert np.median(spread[shown] / stated[shown]) == pytest.approx(1.0, abs=0.6)


def files_of(folder: Path, count: int, seed: int = 1) -> tuple[list[str], list[str]]:
    random, names = np.random.default_rng(seed), ([], [])
    ways = boards.rays(LEFT), boards.rays(RIGHT)

    def light(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return boards.chessboard(x, y, 9, 6, SQUARE)

    for k, (turn, place) in enumerate(boards.poses(count, (0.1, 0.0625), 0.55, random, spread=0.12)):
        for side, way, (t, p) in zip(
            ("left", "right"), ways, ((turn, place), (TURN @ turn, TURN @ place + WAY)), strict=True
        ):
            name = str(folder / f"{side}{k:02d}.png")
            cv2.imwrite(name, boards.picture(way, t, p, light, random))
            names[side == "right"].append(name)
    return names


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], list[str]]:
    return files_of(tmp_path_factory.mktemp("boards"), 6)


@pytest.fixture(scope="module")
def found(shown: tuple[list[str], list[str]]) -> CalibratedCameras:
    return calibrate_cameras(*shown, distortion=4, name="SYNTHETIC", square_error=0.0)


def test_rendered_boards_give_the_rig(found: CalibratedCameras) -> None:
    """k3 is 0.01 at most, and held at 0: no more than a hundredth of a pixel at the picture's edge."""
    fit = found.calibration
    assert fit.residual_px < 0.08
    delta, sigma = away(fit), np.sqrt(np.diag(fit.covariance))
    free = sigma > 0
    assert (np.abs(delta[free]) < 4 * sigma[free]).mean() > 0.95
    assert fit.baseline_m == pytest.approx(np.linalg.norm(WAY), rel=2e-3)
    assert np.abs(delta[[0, 1, 9, 10]]).max() < 2.0


def test_the_calibration_is_told(found: CalibratedCameras, answered: Callable[..., str]) -> None:
    said = answered(found)
    assert re.search(r"from \d+ pictures?: points of the board are met within 0\.\d+ px, baseline \d+", said), said
    assert ("Not determined: " in said) == bool(found.not_determined())


def test_scripts_read_the_rig(
    shown: tuple[list[str], list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target, pattern = tmp_path / "rig.toml", str(Path(shown[1][0]).parent / "right*.png")
    arguments = ["images", "calibrate", *shown[0], "--right", pattern, "--distortion", "4", "--no-time"]
    assert main([*arguments, "-o", str(target), "--plot", str(tmp_path / "a.png")]) == 0
    rig = read_rig(str(target))
    assert rig.baseline_m == pytest.approx(0.12, abs=1e-3)
    assert rig.sigmas["translation_x_m"] > 1e-3 * 0.12 * 0.99  # the board's size is not known better
    assert (tmp_path / "a.png").stat().st_size > 20000
    capsys.readouterr()
    assert main(["images", "cameras", str(target), "--json", "--no-time"]) == 0
    told = json.loads(capsys.readouterr().out)["result"]["rigs"][0]
    assert told["left"]["fx_px"] == rig.left.fx_px
    alone = ["images", "calibrate", *shown[0], "--distortion", "2", "-q"]
    assert main([*alone, "-o", str(tmp_path / "one.toml")]) == 0
    assert main(["images", "cameras", str(tmp_path / "one.toml")]) == 0
    assert "camera" in capsys.readouterr().out
    with pytest.raises(DataError, match="is one camera"):
        read_rig(str(tmp_path / "one.toml"))


def test_swapped_sides_are_told_and_the_advice_gives_the_rig(
    shown: tuple[list[str], list[str]], found: CalibratedCameras
) -> None:
    left, right = (str(Path(side[0]).parent / f"{name}*.png") for name, side in zip(SIDES, shown, strict=True))
    swapped = calibrate_cameras(right, left, distortion=4, square_error=0.0)
    assert "left and right are swapped" in swapped.untrusted
    assert "give its pictures first" in swapped.untrusted
    assert not found.untrusted
    assert swapped.calibration.baseline_m == pytest.approx(found.calibration.baseline_m, rel=1e-6)
    with pytest.raises(RequestError, match="put a pattern in quotes"):
        calibrate_cameras(str(Path(shown[0][0]).parent / "middle*.png"))


def test_pictures_belong_together_by_the_numbers_in_their_names() -> None:
    left, right = [f"cam0/cam0_{k:03d}.png" for k in (1, 2, 3)], [f"cam1/cam1_{k:03d}.png" for k in (1, 3, 4)]
    with pytest.warns(LunarSciWarning, match="left out: cam0/cam0_002.png, cam1/cam1_004.png"):
        assert of_moments(left, right) == ([left[0], left[2]], right[:2])
    assert of_moments(["2.png", "10.png"], ["10r.png", "2r.png"]) == (["2.png", "10.png"], ["2r.png", "10r.png"])
    assert of_moments(["a.png"], ["b.png"]) == (["a.png"], ["b.png"])


def refused(*pictures: object, **options: object) -> str:
    with pytest.raises((DataError, RequestError, ParameterError)) as caught:
        calibrate_cameras(*pictures, **options)
    return str(caught.value)


def test_examples_of_the_help_run(
    shown: tuple[list[str], list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a shell reads them: what is not in quotes is a pattern of files."""
    for picture in (*shown[0], *shown[1]):
        (tmp_path / Path(picture).name).symlink_to(picture)
    monkeypatch.chdir(tmp_path)
    for line in EXAMPLES:
        words = line.replace("\\\n", "").split()[1:]
        plain = [[word.strip("'")] if "*" not in word or "'" in word else sorted(map(str, Path().glob(word)))
                 for word in words]  # fmt: skip
        assert main([*chain(*plain)]) == 0
    assert read_rig(str(tmp_path / "rig.toml")).baseline_m == pytest.approx(0.12 * 0.03 / SQUARE, rel=0.02)


def test_pictures_that_calibrate_nothing_are_refused(shown: tuple[list[str], list[str]], tmp_path: Path) -> None:
    left, right, small = *shown, str(tmp_path / "small.png")
    cv2.imwrite(small, cv2.imread(left[0])[::2, ::2])
    assert "better 12" in refused(left[:2])
    assert "9 x 6" in refused([small], board="9x7")
    assert "shows a chessboard of 9 x 6, not 8 x 6" in refused([small], board="8x6")
    named_otherwise = [tmp_path / f"{chr(ord('a') + k)}.png" for k in range(len(right) - 1)]
    assert "one of each moment" in refused(left, named_otherwise)
    assert "given twice" in refused([*left[:3], left[0]])
    assert "one camera has one size" in refused([left[0], small])
    for options in ({"board": "9"}, {"square": 0.0}, {"distortion": 3}, {"target": "charuco"}):
        with pytest.raises(RequestError):
            CalibrateCamerasRequest(**options)


def test_a_board_that_is_not_tilted_is_refused() -> None:
    random, points, views = np.random.default_rng(5), BoardTarget().points_m, []
    for k in range(8):
        there = points + np.array([0.02 * k - 0.15, -0.06, 0.5 + 0.02 * k])
        pixels = cv2.projectPoints(there, np.zeros(3), np.zeros(3), LEFT.matrix, LEFT.terms)[0].reshape(-1, 2)
        views.append((Sighting(np.arange(54), pixels + 0.03 * random.standard_normal(pixels.shape)),))
    with pytest.raises(DataError, match="from one side"):
        calibrate(views, BoardTarget(), [LEFT.size])


@pytest.mark.parametrize("kind", ["circles", "asymmetric-circles"])
def test_middles_of_circles_are_corrected(kind: str) -> None:
    """Ellipses of large circles, straight from their rims: uncorrected, the focal length is 0.8 px off."""
    random = np.random.default_rng(6)
    target = BoardTarget(kind=kind, columns=7, rows=5, square_m=0.03, circle_m=0.024)
    turns = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim, views = 0.012 * np.column_stack([np.cos(turns), np.sin(turns), 0 * turns]), []
    for turn, place in boards.poses(10, (0.1, 0.06), 0.3, random):
        rims = (target.points_m[:, None] + rim) @ turn.T + place
        seen = cv2.projectPoints(rims.reshape(-1, 3), np.zeros(3), np.zeros(3), LEFT.matrix, LEFT.terms)[0]
        outlines = seen.reshape(len(target.points_m), -1, 1, 2).astype(np.float32)
        moments = [cv2.moments(outline - outline.mean(axis=0)) for outline in outlines]
        middles = [
            np.array([m["m10"] / m["m00"], m["m01"] / m["m00"]]) + o.mean(axis=(0, 1))
            for m, o in zip(moments, outlines, strict=True)
        ]
        views.append((Sighting(np.arange(35), np.array(middles)),))
    plain = calibrate(views, BoardTarget(kind=kind, columns=7, rows=5, square_m=0.03), [LEFT.size])
    corrected = calibrate(views, target, [LEFT.size])
    assert plain.residual_px < 0.01  # which residuals do not tell
    assert corrected.cameras[0].fx_px == pytest.approx(520, abs=0.05)
    assert plain.cameras[0].fx_px == pytest.approx(519.2, abs=0.2)


def test_boards_of_every_kind_are_found() -> None:
    random, way = np.random.default_rng(7), boards.rays(LEFT)
    turn, place = rotation_of([0.3, -0.2, 0.1]), np.array([-0.1, -0.07, 0.5])
    numbers = dict(zip(INTRINSICS, map(float, truth()[:9]), strict=True))
    camera = Camera(name="a", width_px=480, height_px=400, **numbers)
    for kind in ("circles", "asymmetric-circles", "charuco"):
        size = {"columns": 4, "rows": 7} if kind == "asymmetric-circles" else {"columns": 7, "rows": 5}
        target = BoardTarget(kind=kind, square_m=0.03, marker_m=0.022, circle_m=0.015, **size)
        if kind == "charuco":
            drawn = target.charuco().generateImage((1400, 1000)) / 255.0

            def light(x: np.ndarray, y: np.ndarray, drawn: np.ndarray = drawn) -> np.ndarray:
                inside = (x >= 0) & (x < 0.21) & (y >= 0) & (y < 0.15)
                i, j = np.clip((y / 0.15 * 1000).astype(int), 0, 999), np.clip((x / 0.21 * 1400).astype(int), 0, 1399)
                return np.where(inside, 0.1 + 0.8 * drawn[i, j], 0.9)
        else:
            centers = target.points_m[:, :2]

            def light(x: np.ndarray, y: np.ndarray, centers: np.ndarray = centers) -> np.ndarray:
                return boards.circles(x, y, centers, 0.015)

        values = boards.picture(way, turn, place, light, random).astype(float)
        seen = find_target(Picture(source=InputFile("a", b""), values=values, bits=8), target)
        assert seen is not None, kind
        expected = camera.project(target.points_m[seen.numbers] @ turn.T + place)
        apart = [np.abs(seen.pixels[::way_] - expected).max() for way_ in (1, -1)]
        assert len(seen.numbers) > 0.9 * len(target.points_m)
        assert min(apart) < 0.4, kind


def test_boards_before_a_busy_wall_are_found_at_once() -> None:
    """What finds corners by their sectors alone loses half of these among the wall's."""
    random, way, target = np.random.default_rng(1), boards.rays(LEFT), BoardTarget()

    def light(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        wall = 0.5 + 0.4 * np.sign(np.sin(60 * x) * np.sin(55 * y + 3 * x))
        near = (x > -0.06) & (x < 0.26) & (y > -0.06) & (y < 0.19)
        return np.where(near, boards.chessboard(x, y, 9, 6, SQUARE), wall)

    for turn, place in boards.poses(5, (0.1, 0.0625), 0.6, random, spread=0.1):
        values = boards.picture(way, turn, place, light, random).astype(float)
        seen = find_target(Picture(source=InputFile("a", b""), values=values, bits=8), target, patient=False)
        there = target.points_m @ turn.T + place
        expected = cv2.projectPoints(there, np.zeros(3), np.zeros(3), LEFT.matrix, LEFT.terms)[0].reshape(-1, 2)
        assert seen is not None
        assert min(np.abs(seen.pixels[::one] - expected).max() for one in (1, -1)) < 0.3


def test_a_square_board_that_one_side_numbers_otherwise_is_one_board() -> None:
    """Of 5 x 5 points four numberings look alike; that of the left picture is the one of which both are nearest."""
    target, random = BoardTarget(columns=5, rows=5), np.random.default_rng(2)
    pixels = target.points_m[:, :2] * 4000 @ rotation_of([0, 0, 0.2])[:2, :2] + random.normal(0, 0.1, (25, 2))
    left = Sighting(np.arange(25), pixels)
    for turns in range(4):
        other = np.rot90((pixels - [40.0, 1.0]).reshape(5, 5, 2), turns).reshape(-1, 2)
        assert alike_turned(left, Sighting(np.arange(25), other), target).pixels == pytest.approx(pixels - [40.0, 1.0])


def test_terms_that_fold_the_picture_leave_its_edge_without_an_error(found: CalibratedCameras) -> None:
    """k3 = -0.4 of pictures whose middle alone was seen: the farthest direction is at fx y of about 0.62."""
    camera = replace(found.calibration.cameras[0], k1=0.1, k2=-0.1, k3=-0.4)
    folded = replace(found.calibration, cameras=(camera, *found.calibration.cameras[1:]))
    away = folded.uncertainty_px(0, np.array([[243.0, 196.0], [camera.cx_px + 1.1 * camera.fx_px, 196.0]]))
    assert np.isfinite(away).tolist() == [True, False]
    corner = replace(folded, cameras=(replace(camera, width_px=1300), *folded.cameras[1:]))
    sheet = replace(found, calibration=corner)
    assert any("edge without directions" in note for note in sheet.notes())
    assert sheet.to_dict()["cameras"]["left"]["corner_uncertainty_px"] > 0
