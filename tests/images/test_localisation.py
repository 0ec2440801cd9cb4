"""Stations by what they share: adjustment beside points of known geometry, ties beside moved pictures."""

import dataclasses
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lunarsci.cli import main
from stations import judged

from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.images.adjustment import (
    OVERLAPPING,
    SMALLEST_PX,
    PairTies,
    TiePoints,
    adjust,
    by_steps,
    triangulated,
)
from lunarsci.images.camera import PARAMETERS, Camera, Pose, StereoRig, covariance_of, rotation_of, vector_of
from lunarsci.images.jobs.locate import _names, _rover, locate
from lunarsci.images.jobs.merge import read_positions as read_shifts
from lunarsci.images.jobs.requests import LocateRequest
from lunarsci.images.localisation import Station, _eight, _peak, transfer
from lunarsci.images.matching import Rectified, StereoMatches
from lunarsci.images.pictures import png_bytes
from lunarsci.images.render import landscape_on, render
from lunarsci.images.rig_files import pose_text, read_pose, rig_text
from lunarsci.io.inputs import InputFile
from lunarsci.twin.telemetry.reading import read_positions

SIGMA = {"left_cx_px": 0.1, "right_cx_px": 0.1, "left_fx_px": 0.25, "rotation_y_rad": 8e-5, "translation_x_m": 1e-4}


TIES = 80


TEMPLATE = SMALLEST_PX * math.sqrt(OVERLAPPING / 4)
"""Error of four templates that share it, as much as `OVERLAPPING` of them would tell. [px]"""


def navcam() -> StereoRig:
    lens = {"width_px": 1024, "height_px": 1024, "fx_px": 1189.0, "fy_px": 1189.0, "cx_px": 514.0, "cy_px": 509.0}
    return StereoRig(
        name="n",
        left=Camera(name="l", k1=-0.06, **lens),
        right=Camera(name="r", k1=-0.05, **lens),
        rotation=rotation_of([0.001, -0.004, 0.0015]),
        translation_m=np.array([-0.27, 0.0006, -0.0009]),
        covariance=covariance_of({name: SIGMA.get(name, 0.0) for name in PARAMETERS}),
    )


RIG, EXACTLY = navcam(), np.zeros((6, 6))


def in_order(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Points of which neighbours in number are neighbours on the ground: strips across, each from right to left."""
    strip = np.argsort(np.argsort(x)) // 16
    return np.column_stack([x, y, z])[np.lexsort((y, strip))]


def shifted(random: np.random.Generator, left: np.ndarray) -> np.ndarray:
    """Places of templates (n, 2) in the left picture that share a shift, and its change over half a picture. [px]"""
    share = np.column_stack([np.ones(len(left)), left / 512.0 - 1.0])
    return left + share @ (0.25 * random.standard_normal((3, 2)))


def alike(random: np.random.Generator, sigma: float, together: int) -> np.ndarray:
    """Errors that so many ties share: templates that overlap see the same light. (TIES, 2)"""
    return np.repeat(sigma * random.standard_normal((TIES // together, 2)), together, axis=0)


def drive(seed: int) -> tuple[list[Pose], list[Pose], np.ndarray, PairTies]:
    """True poses, told ones, the errors of these, and what a rig that differs from its file sees of random ground."""
    random = np.random.default_rng(seed)
    true = [Pose.looking([0, 0, 1.5], 0.0, 25.0), Pose.looking([7, 0.3, 1.4], -2.0, 24.0, 1.0)]
    spread = np.array([0.005, 0.005, 0.0175, 0.15, 0.15, 0.1])
    off = spread * random.standard_normal(6)
    told = Pose(rotation=rotation_of(off[:3]) @ true[1].rotation, center_m=true[1].center_m + off[3:])
    ground = in_order(random.uniform(8.8, 13, TIES), random.uniform(-0.8, 0.9, TIES), random.normal(0, 0.05, TIES))
    rig = navcam().drawn(random)
    sides = []
    for pose, error, together in ((true[1], 0.05, 1), (true[0], TEMPLATE, 4)):
        left, right = rig.project(pose.to_camera(ground))
        disparity = right[:, 0] - left[:, 0] + 0.1 * random.standard_normal(TIES)
        sides.append((left + alike(random, error, together), disparity, np.full(TIES, 0.1)))
    far = shifted(random, sides[1][0]), *sides[1][1:]
    ties = TiePoints(*sides[0], *far, np.zeros((TIES, 2, 2)), np.ones(TIES))
    return true, [true[0], told], np.diag(spread**2), PairTies(1, 0, ties)


def test_poses_are_as_wrong_as_they_say() -> None:
    """Squared errors over their covariance are chi-square of six: the mean of 40 is 4.8 to 7.3 with 98 %."""
    scores, errors = [], []
    for seed in range(40):
        true, told, prior, pair = drive(seed)
        found = adjust(told, by_steps([EXACTLY, prior]), [RIG] * 2, [pair])
        pose = found.poses[1]
        off = np.concatenate([vector_of(pose.rotation @ true[1].rotation.T), pose.center_m - true[1].center_m])
        scores.append(off @ np.linalg.solve(found.covariance, off))
        errors.append(np.linalg.norm(off[3:]))
    assert 4.8 < np.mean(scores) < 7.3
    assert np.sqrt(np.mean(np.square(errors))) < 0.005 * 7


def course(seed: int, pairs: list[tuple[int, int]]) -> tuple[list[Pose], list[Pose], list[np.ndarray], list[PairTies]]:
    """Stations every 2 m, dead reckoning that drifts from one to the next, and what a perturbed rig sees in pairs."""
    random = np.random.default_rng(seed)
    true = [Pose.looking([2.0 * k, 0.1 * k, 1.5], 2.0 * k, 24.0) for k in range(4)]
    spread = np.array([0.005, 0.005, 0.0175, 0.08, 0.08, 0.05])
    told, off = [true[0]], np.zeros(3)
    for pose in true[1:]:
        error = spread * random.standard_normal(6)
        off = off + error[3:]
        told.append(Pose(rotation=rotation_of(error[:3]) @ pose.rotation, center_m=pose.center_m + off))
    rig, found = navcam().drawn(random), []
    for far, near in pairs:
        x = random.uniform(2.0 * near + 1.8, 2.0 * near + 5.0, TIES)
        ground = in_order(x, random.uniform(-0.8, 1.2, TIES), random.normal(0, 0.05, TIES))
        sides = []
        for pose, error, together in ((true[near], 0.05, 1), (true[far], TEMPLATE, 4)):
            left, right = rig.project(pose.to_camera(ground))
            disparity = right[:, 0] - left[:, 0] + 0.1 * random.standard_normal(TIES)
            sides.append((left + alike(random, error, together), disparity, np.full(TIES, 0.1)))
        moved = shifted(random, sides[1][0]), *sides[1][1:]
        found.append(PairTies(near, far, TiePoints(*sides[0], *moved, np.zeros((TIES, 2, 2)), np.ones(TIES))))
    return true, told, [np.diag(spread**2)] * 4, found


@pytest.mark.parametrize("pairs", [[(0, 1), (1, 2), (0, 2), (2, 3), (1, 3), (0, 3)], [(0, 1), (2, 3)], []])
def test_chains_are_as_wrong_as_they_say(pairs: list[tuple[int, int]]) -> None:
    """Three poses: chi-square of 18, the mean of 8 within 3 standard errors; also where one step is reckoned alone."""
    scores, ends = [], []
    for seed in range(8):
        true, told, priors, ties = course(seed, pairs)
        found = adjust(told, by_steps([EXACTLY, *priors[1:]]), [RIG] * 4, ties)
        off = np.concatenate(
            [
                np.concatenate([vector_of(p.rotation @ t.rotation.T), p.center_m - t.center_m])
                for p, t in zip(found.poses[1:], true[1:], strict=True)
            ]
        )
        scores.append(off @ np.linalg.solve(found.covariance, off))
        ends.append(float(np.trace(found.covariance[-3:, -3:])))
    assert abs(np.mean(scores) - 18) < 3 * 6 / math.sqrt(8)
    if len(pairs) == 2:
        # The second step is known by dead reckoning alone, the last one by ties.
        assert np.sqrt(np.mean(ends)) == pytest.approx(math.sqrt(0.08**2 * 2 + 0.05**2), rel=0.1)


def seen_from(poses: list[Pose], near: int, far: int, seed: int) -> PairTies:
    """Ties without error, of ground before two stations, by the rig of the file."""
    random, rig = np.random.default_rng(seed), navcam()
    x = poses[near].center_m[0] + random.uniform(1.8, 5.0, TIES)
    ground = in_order(x, random.uniform(-0.8, 1.2, TIES), random.normal(0, 0.05, TIES))
    sides = []
    for pose in (poses[near], poses[far]):
        left, right = rig.project(pose.to_camera(ground))
        sides += [left, right[:, 0] - left[:, 0], np.full(TIES, 0.1)]
    return PairTies(near, far, TiePoints(*sides, np.zeros((TIES, 2, 2)), np.ones(TIES)))


STEPPED = [Pose.looking([2.0 * k, 0.1 * k, 1.5], 2.0 * k, 24.0) for k in range(3)]


def test_a_station_without_ties_keeps_its_step_from_the_one_before() -> None:
    """Ties move the first station by 0.3, -0.2 and 0.1 m; dead reckoning puts the second as far from it as before.

    The error of its place is that of the first and that of the step together.
    """
    off = np.array([0.3, -0.2, 0.1])
    told = [STEPPED[0], *(Pose(rotation=pose.rotation, center_m=pose.center_m + off) for pose in STEPPED[1:])]
    step = np.array([0.4, 0.5, 0.6])
    loose = np.diag(np.concatenate([[0.01] * 3, step]) ** 2)
    found = adjust(told, by_steps([EXACTLY, loose, loose]), [RIG] * 3, [seen_from(STEPPED, 1, 0, 1)])
    np.testing.assert_allclose(found.poses[1].center_m, STEPPED[1].center_m, atol=3e-4)
    apart = told[2].center_m - told[1].center_m
    np.testing.assert_allclose(found.poses[2].center_m - found.poses[1].center_m, apart, atol=1e-9)
    np.testing.assert_allclose(found.poses[2].rotation, told[2].rotation, atol=1e-9)
    one, two = (found.covariance[k : k + 3, k : k + 3] for k in (3, 9))
    np.testing.assert_allclose(two, one + np.diag(step**2), rtol=1e-6, atol=1e-9)
    assert np.trace(one) < 0.01 * np.trace(np.diag(step**2)), "ties, not dead reckoning, say where the first is"


def test_a_station_between_two_that_are_tied_shares_the_gap_by_the_errors_of_its_steps() -> None:
    """The last of three stations, tied to the first, closes a gap of 0.15 m along x, 0.1 m along y and z.

    Steps of 1, 2 and 1 dm before and 2, 1 and 1 dm after take 1/5, 4/5 and half of it, by their variances.
    """
    gap = np.array([0.15, -0.1, 0.1])
    told = [*STEPPED[:2], Pose(rotation=STEPPED[2].rotation, center_m=STEPPED[2].center_m + gap)]
    before, after = np.array([0.1, 0.2, 0.1]), np.array([0.2, 0.1, 0.1])
    errors = [np.diag(np.concatenate([[0.01] * 3, step]) ** 2) for step in (before, before, after)]
    found = adjust(told, by_steps([EXACTLY, *errors[1:]]), [RIG] * 3, [seen_from(STEPPED, 2, 0, 2)])
    np.testing.assert_allclose(found.poses[2].center_m, STEPPED[2].center_m, atol=3e-3)
    closed = found.poses[2].center_m - told[2].center_m
    np.testing.assert_allclose(
        found.poses[1].center_m - told[1].center_m, closed * np.array([0.2, 0.8, 0.5]), atol=1e-8
    )
    np.testing.assert_allclose(found.poses[1].rotation, told[1].rotation, atol=1e-9)
    between, end = (found.covariance[k : k + 3, k : k + 3] for k in (3, 9))
    left = np.diag(before**2 * after**2 / (before**2 + after**2))
    share = np.diag([0.2, 0.8, 0.5])
    np.testing.assert_allclose(between, left + share @ end @ share, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("times", [1.5, 3.0])
def test_errors_of_templates_are_inflated_to_what_they_are(times: float) -> None:
    """4000 ties whose places scatter so many times as much as stated; nearer stations see as well as they say.

    A median of 4000 has a relative error of 1 / (2 ln 2 sqrt(4000)) = 1.1 % in the square; three of it are 3.4 %.
    """
    count, rig, random = 4000, navcam(), np.random.default_rng(8)
    poses = [Pose.looking([0, 0, 1.5], 0.0, 25.0), Pose.looking([7, 0.3, 1.4], -2.0, 24.0, 1.0)]
    ground = np.column_stack(
        [random.uniform(8.8, 13, count), random.uniform(-0.8, 0.9, count), random.normal(0, 0.05, count)]
    )
    template = np.array([[0.09, 0.04], [0.04, 0.06]])
    stated = template / OVERLAPPING + SMALLEST_PX**2 * np.eye(2)
    sides = []
    for pose, covariance in ((poses[1], SMALLEST_PX**2 * np.eye(2)), (poses[0], times**2 * stated)):
        left, right = rig.project(pose.to_camera(ground))
        off = random.multivariate_normal(np.zeros(2), covariance, count)
        sides += [left + off, right[:, 0] - left[:, 0] + 0.1 * random.standard_normal(count), np.full(count, 0.1)]
    ties = TiePoints(*sides, np.tile(template, (count, 1, 1)), np.ones(count))
    told = np.diag(np.array([0.005, 0.005, 0.0175, 0.15, 0.15, 0.1]) ** 2)
    found = adjust(poses, by_steps([EXACTLY, told]), [rig] * 2, [PairTies(1, 0, ties)])
    assert found.inflation[0] ** 2 == pytest.approx(times**2, rel=0.034)


def test_stations_may_have_rigs_of_their_own() -> None:
    """Exact points by a rig and by one of three quarters of its focal length: the second place is found, and errors of
    both rigs are in the covariance, apart."""
    other = dataclasses.replace(RIG, name="o", left=RIG.left.scaled(0.75), right=RIG.right.scaled(0.75))
    random, poses = np.random.default_rng(3), STEPPED[:2]
    ground = in_order(random.uniform(3.8, 7, TIES), random.uniform(-0.8, 1.2, TIES), random.normal(0, 0.05, TIES))
    sides = []
    for rig, pose in ((other, poses[1]), (RIG, poses[0])):
        left, right = rig.project(pose.to_camera(ground))
        sides += [left, right[:, 0] - left[:, 0], np.full(TIES, 0.1)]
    ties = TiePoints(*sides, np.zeros((TIES, 2, 2)), np.ones(TIES))
    told = Pose(rotation=rotation_of([0.01, -0.01, 0.02]) @ poses[1].rotation, center_m=poses[1].center_m + 0.05)
    loose = np.diag(np.array([0.01, 0.01, 0.02, 0.1, 0.1, 0.1]) ** 2)
    found = adjust([poses[0], told], by_steps([EXACTLY, loose]), [RIG, other], [PairTies(1, 0, ties)])
    np.testing.assert_allclose(found.poses[1].center_m, poses[1].center_m, atol=3e-3)
    assert found.joint.shape == (12 + 48, 12 + 48) and found.rig_of == (0, 1)
    assert np.diag(found.of_pair(1, 1))[6] == found.joint[36, 36] > 0


def test_a_loop_that_closes_knows_its_end_better() -> None:
    open_pairs = [(0, 1), (1, 2), (2, 3)]
    ends = []
    for pairs in (open_pairs, [*open_pairs, (0, 3)]):
        _, told, priors, ties = course(5, pairs)
        ends.append(np.trace(adjust(told, by_steps([EXACTLY, *priors[1:]]), [RIG] * 4, ties).covariance[-3:, -3:]))
    assert ends[1] < 0.8 * ends[0]


def test_the_rovers_origin_is_below_its_mast() -> None:
    """A rover at a known place and attitude, its cameras turned about a mast that leans with it."""
    rig, mast = navcam(), np.array([0.4, 0.1, 1.2])
    body = Pose(rotation=rotation_of([0, 0, 0.3]) @ rotation_of([0, 0.1, 0]) @ rotation_of([0.05, 0, 0]),
                center_m=np.array([3.0, 1.0, 0.25]))  # fmt: skip
    for heading in (0.0, 90.0):
        camera = Pose.looking([0, 0, 0], heading, 20.0, 3.0)
        middle = body.to_world(mast)
        left = middle + 0.5 * camera.rotation @ rig.rotation.T @ rig.translation_m
        told = Pose(rotation=camera.rotation, center_m=left)
        rover = _rover(rig, told, np.degrees([0.3, 0.1, 0.05]), mast)
        np.testing.assert_allclose(told.to_world(rover.center_m), body.center_m, atol=1e-9)
        np.testing.assert_allclose(told.rotation @ rover.rotation, body.rotation, atol=1e-9)


@pytest.fixture(scope="module")
def stations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two SYNTHETIC stations 2 m apart with small cameras; dead reckoning is off by 5 cm and 0.4 degrees."""
    folder = tmp_path_factory.mktemp("stations")
    lens = {"width_px": 400, "height_px": 300, "fx_px": 464.0, "fy_px": 464.0, "cx_px": 200.0, "cy_px": 150.0}
    rig = StereoRig(
        name="SYNTHETIC small",
        left=Camera(name="l", **lens),
        right=Camera(name="r", **lens),
        rotation=np.eye(3),
        translation_m=np.array([-0.27, 0, 0]),
        covariance=covariance_of({"left_cx_px": 0.1, "right_cx_px": 0.1, "translation_x_m": 1e-4}),
    )
    (folder / "rig.toml").write_text(rig_text(rig))
    level = (-1.0, -4.0, 0.25, np.zeros((33, 57)))
    ground = landscape_on(level, name="g", seed=8, spacing_m=0.02, rocks_per_m2=1.0)
    for k, (pose, told) in enumerate(zip(TRUE, (TRUE[0], RECKONED), strict=True)):
        place = folder / f"stop{k}"
        place.mkdir()
        pair = render(ground, rig, pose, seed=3)
        for side in ("left", "right"):
            (place / f"{side}.png").write_bytes(png_bytes(getattr(pair, side), {"Comment": "SYNTHETIC"}))
        (place / "pose.toml").write_text(pose_text(told) + f"time_s = {60.0 * k}\n{LEANING}")
    return folder


TRUE = Pose.looking([0, 0, 1.5], 0.0, 28.0), Pose.looking([2.0, 0.1, 1.5], 2.0, 27.0)


RECKONED = Pose(
    rotation=Pose.looking([0, 0, 0], 2.4, 27.0).rotation, center_m=np.add(TRUE[1].center_m, [0.04, -0.03, 0.01])
)


LEANING = "rover_yaw_deg = 1.0\nrover_pitch_deg = 2.0\nrover_roll_deg = -1.0\n"


def test_from_pictures_to_positions(stations: Path, answered: Callable[..., str]) -> None:
    folders = [stations / f"stop{k}" for k in range(2)]
    result = locate(folders, rig=str(stations / "rig.toml"), mast="0.4,0,1.2")
    for folder, pose in zip(folders, TRUE, strict=True):
        np.savez(folder / "truth.npz", left_rotation=pose.rotation, left_center_m=pose.center_m)
    found = judged(result.localised, folders)
    # A chi-square of six is below 22.5 with 99.9 %; 0.5 % of 7 m is the aim of cameras with 2.6 times the pixels.
    assert result.untrusted == "" and found["tied"] and found["nees"] < 22.5 and found["expected"] == 6
    assert found["percent"] < 1.0 < 100 * np.linalg.norm(RECKONED.center_m - TRUE[1].center_m) / 2
    files = {name: InputFile(name, made()) for name, made in result.files().items()}
    camera, row = read_pose(files["stop1.toml"]), result.rows()[1]
    # The rover is below its mast, and leans with it.
    assert row["z_m"] == pytest.approx(camera.center_m[2] - 1.2, abs=0.02)
    assert row["tied"] and row["time_s"] == 60.0 and row["yaw_deg"] == pytest.approx(1.0, abs=0.6)
    np.testing.assert_allclose(read_positions(files["positions.csv"]).place_m[1], [row["x_m"], row["y_m"]], rtol=1e-6)
    assert len(read_shifts(files["shifts.csv"], 2)) == 2
    assert len(result.plot().axes) == 5
    assert answered(result).startswith(
        "Pictures tie 2 of 2 stations together. The rover at the last, stop1, was at x 1."
    )


def test_what_cannot_be_tied_is_said(
    stations: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], answered: Callable[..., str]
) -> None:
    rig, first = str(stations / "rig.toml"), str(stations / "stop0")
    far = tmp_path / "far"
    shutil.copytree(stations / "stop1", far)
    (far / "pose.toml").write_text(pose_text(Pose.looking([40.0, 0.0, 1.5], 0.0, 27.0)))
    assert main(["images", "locate", first, str(far), "--rig", rig]) == 3
    told = capsys.readouterr()
    assert "far is where dead reckoning puts it: they share no ground" in told.out + told.err
    alone = locate([first, far], rig=rig)
    apart = answered(alone)
    assert "Pictures tie 1 of 2 stations together" in apart
    assert "Far is where dead reckoning puts it: they share no ground" in apart
    with pytest.raises(ParameterError, match=r"no ties to draw: far .* they share no ground"):
        alone.plot()
    shutil.copy(stations / "stop0" / "left.png", far / "left.png")
    assert main(["images", "locate", first, str(far), "--rig", rig]) == 1
    assert "the same picture as" in capsys.readouterr().err
    shutil.copy(stations / "stop1" / "left.png", far / "left.png")
    assert main(["images", "locate", first, str(far), "--rig", rig, "--mast", "0,0,1"]) == 1
    assert "add rover_yaw_deg" in capsys.readouterr().err


def test_wild_ties_move_little() -> None:
    _, told, prior, pair = drive(3)
    plain = adjust(told, by_steps([EXACTLY, prior]), [RIG] * 2, [pair])
    wild = pair.ties.far_px.copy()
    wild[::20] += 6.0
    bent = adjust(told, by_steps([EXACTLY, prior]), [RIG] * 2, [pair._replace(ties=pair.ties._replace(far_px=wild))])
    assert np.linalg.norm(bent.poses[1].center_m - plain.poses[1].center_m) < 0.02
    assert bent.weights[0][::20].max() < 0.5 < np.median(bent.weights[0])


def test_points_by_disparity() -> None:
    rig = navcam()
    points = np.random.default_rng(1).uniform([-1, -1, 2], [1, 1, 15], (40, 3))
    left, right = rig.project(points)
    np.testing.assert_allclose(triangulated(rig, left, right[:, 0] - left[:, 0]), points, rtol=1e-6, atol=1e-6)


def test_light_that_is_compared_has_the_same_mean_and_contrast_all_over() -> None:
    """Noise of 1 and of 20 about a brightness that rises, beside glare that is not used: the noise itself is left,
    about the middle of 8 bits and so wide that one pixel in a hundred or fewer is cut off at either end."""
    noise = np.random.default_rng(1).normal(size=(200, 400))
    contrast = np.where(np.arange(400) < 200, 1.0, 20.0)
    used = np.ones(noise.shape, dtype=bool)
    used[80:120, :] = False
    light = 300.0 + 0.5 * np.arange(400) + contrast * noise
    light[~used] = 1e5
    found = _eight(light.astype(np.float32), used).astype(float)
    assert (found[~used] == 128).all()
    slopes = []
    for half in (np.s_[:60, 30:160], np.s_[140:, 240:370], np.s_[125:140, 30:160], np.s_[60:75, 240:370]):
        kept = np.abs(noise[half]) < 2.0
        assert np.corrcoef(found[half][kept], noise[half][kept])[0, 1] > 0.99
        slope, middle = np.polyfit(noise[half][kept], found[half][kept], 1)
        assert middle == pytest.approx(127.5, abs=2.0)
        slopes.append(slope)
        ends = [(found[half] == end).mean() for end in (0, 255)]
        assert max(ends) < 0.01
    assert slopes == pytest.approx([np.mean(slopes)] * 4, rel=0.03) and np.mean(slopes) > 40.0


def test_peak_of_a_parabola() -> None:
    v, u = np.mgrid[:9, :9].astype(float)
    found = _peak(0.9 - 0.02 * (u - 4.3) ** 2 - 0.01 * (v - 3.8) ** 2, 100)
    assert found[:2] == pytest.approx((4.3, 3.8), abs=1e-9)
    assert found[3] / found[5] == pytest.approx(0.5)
    assert _peak(np.full((9, 9), 0.9), 100) is None


def test_what_is_no_station(tmp_path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "pose.toml").write_text("position_m = [0, 0, 1.5]\nheading_deg = 0\ndown_deg = 25\n")
    with pytest.raises(DataError, match=r"no left.png; a station is a folder"):
        locate([tmp_path / "a", tmp_path / "b"])
    with pytest.raises(RequestError, match="is given twice"):
        locate([tmp_path / "a", tmp_path / "a"])
    with pytest.raises(RequestError, match="two or more"):
        locate([tmp_path / "a"])
    with pytest.raises(RequestError, match="`drift`"):
        LocateRequest(drift=0.0)
    for mast in ("1,2", "a,b,c", "1,2,nan"):
        with pytest.raises(RequestError, match="ahead, left and up"):
            LocateRequest(mast=mast)


def test_names_of_stations_differ() -> None:
    assert _names([Path("day1/A"), Path("day1/B")]) == ["A", "B"]
    assert _names([Path("day1/A"), Path("day2/A")]) == ["day1-A", "day2-A"]


def test_a_disparity_without_an_error_says_nothing() -> None:
    """As one that is not known: the poses are the same."""
    _, told, prior, pair = drive(4)
    found = []
    for key in ("far_disparity", "far_sigma"):
        values = getattr(pair.ties, key).copy()
        values[:20] = np.nan
        ties = pair.ties._replace(**{key: values})
        found.append(adjust(told, by_steps([EXACTLY, prior]), [RIG] * 2, [pair._replace(ties=ties)]).poses[1])
    np.testing.assert_allclose(found[1].center_m, found[0].center_m, atol=1e-12)


def test_views_of_the_same_size_have_no_gaps() -> None:
    """A camera turned about its axis by 17 degrees: the other view is full, each place within a pixel and a half."""
    shape, focal = (120, 160), 200.0
    frame = Rectified(np.eye(3), focal, (79.5, 59.5), 0.2, np.zeros((2, *shape, 2), np.float32))
    blank, random = np.zeros(shape), np.random.default_rng(2)
    matches = StereoMatches(
        rectified=frame, left=100 + random.normal(0, 5, shape), right=blank, disparity=blank + 8.0,
        sigma_px=blank + 0.1, window_px=blank + 7.0, reason=blank.astype(np.uint8), row_offset_px=0.0,
    )  # fmt: skip
    station = Station(name="a", matches=matches, rig=RIG, pose=STEPPED[0], covariance=EXACTLY)
    turned = Pose(rotation=STEPPED[0].rotation @ rotation_of([0.0, 0.0, 0.3]), center_m=STEPPED[0].center_m)
    seen = transfer(station, STEPPED[0], station, turned)
    assert seen.seen[30:-30, 30:-30].all() and np.abs(seen.apart[30:-30, 30:-30]).max() < 1.5
    # The light of a full view is that of the other one, not that of sums cut to whole numbers.
    np.testing.assert_allclose(seen.light[30:-30, 30:-30].mean(), np.sqrt(matches.left).mean(), rtol=0.01)
