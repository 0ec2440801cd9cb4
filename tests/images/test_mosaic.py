"""Pairs as one map: a turned mast beside the ground that was rendered, and modes beside what follows by hand."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lunarsci.cli import main
from scipy.linalg import block_diag

from lunarsci.errors import RequestError
from lunarsci.images.adjustment import apart, root_of
from lunarsci.images.camera import Camera, Pose, StereoRig, covariance_of, rotation_of, vector_of
from lunarsci.images.elevation import ElevationModel, Stack, blocks_of, map_of, read_elevation, reconciled
from lunarsci.images.gridding import height_modes, upwards
from lunarsci.images.jobs.merge import MergedStations, merge
from lunarsci.images.localisation import reckoned
from lunarsci.images.mosaic import _seam, _shares
from lunarsci.images.pictures import png_bytes
from lunarsci.images.render import Landscape, landscape_on, render
from lunarsci.images.rig_files import pose_text, rig_text
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import read_terrain_file

LENS = {"width_px": 400, "height_px": 300, "fx_px": 464.0, "fy_px": 464.0, "cx_px": 200.0, "cy_px": 150.0}
RIG = StereoRig(
    name="SYNTHETIC small",
    left=Camera(name="l", **LENS),
    right=Camera(name="r", **LENS),
    rotation=np.eye(3),
    translation_m=np.array([-0.27, 0, 0]),
    covariance=covariance_of({"left_cx_px": 0.1, "right_cx_px": 0.1, "translation_x_m": 1e-4}),
)
MAST = {"left": 22.0, "middle": 0.0, "right": -22.0, "away": 150.0}
"""Headings of the mast; the last one shares no ground with the others. [deg]"""
OFF_DEG = {"left": (0.3, -0.4, 0.5), "middle": (0.0, 0.0, 0.0), "right": (-0.4, 0.2, 0.3), "away": (0.2, 0.3, -0.4)}
"""What telemetry says wrongly, about x, y, z: two errors of the mast's angles, and none of level or place. [deg]"""
LEVEL = ("--mast-error", "0.3", "--tilt-error", "0.02")


@pytest.fixture(scope="module")
def ground() -> Landscape:
    return landscape_on((-5.0, -5.0, 0.2, np.zeros((51, 51))), name="g", seed=8, spacing_m=0.02, rocks_per_m2=0.0)


@pytest.fixture(scope="module")
def pairs(ground: Landscape, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mast")
    (folder / "rig.toml").write_text(rig_text(RIG))
    for name, heading in MAST.items():
        pose = Pose.looking([0, 0, 1.5], heading, 30.0)
        pair, place = render(ground, RIG, pose, seed=3), folder / name
        place.mkdir()
        for side in ("left", "right"):
            (place / f"{side}.png").write_bytes(png_bytes(getattr(pair, side), {"Comment": "SYNTHETIC"}))
        told = Pose(rotation=rotation_of(np.radians(OFF_DEG[name])) @ pose.rotation, center_m=pose.center_m)
        (place / "pose.toml").write_text(pose_text(told) + 'station = "A"\n')
    return folder


@pytest.fixture(scope="module")
def found(pairs: Path) -> MergedStations:
    folders = [str(pairs / name) for name in ("middle", "left", "right", "away")]
    return merge(folders, rig=str(pairs / "rig.toml"), mast_error=0.3, tilt_error=0.02, spacing=0.03)


def off_of(model: ElevationModel, ground: Landscape) -> np.ndarray:
    """Heights less the ground's. (ny, nx) [m]"""
    x, y = np.meshgrid(model.x_m, model.y_m)
    return model.height_m - ground.surface(x, y)


def test_a_turned_mast_gives_one_map_whose_errors_hold(found: MergedStations, ground: Landscape) -> None:
    """Poses told 0.5 degrees off tilt heights by centimetres 5 m away; tied they are off by millimetres.

    What all pairs are off by is the mean of their masts' errors, and the rig's: one draw, which is below three standard
    deviations with 99.7 %.
    """
    assert found.mosaic is not None and found.untrusted == ""
    assert found.mosaic.localised.tied == (True, True, True, False)
    true = [Pose.looking([0, 0, 1.5], heading, 30.0).rotation for heading in (0.0, 22.0, -22.0)]
    off = [vector_of(pose.rotation @ r.T) for pose, r in zip(found.mosaic.localised.poses[:3], true, strict=True)]
    assert np.degrees(np.linalg.norm(np.subtract(off[1:], off[0]), axis=1)).max() < 0.1, "of 0.7 and 0.5 as told"
    model = found.merged.model
    off, ahead = off_of(model, ground), np.meshgrid(model.x_m, model.y_m)[0] > 1.0
    random, common = model.layer("height_m_sigma"), model.layer("height_m_common_sigma")
    for here in (ahead & (model.layer("count") > 1), ahead & (model.layer("count") == 1)):
        here &= np.isfinite(off)
        assert here.sum() > 1000
        assert np.sqrt(np.mean(off[here] ** 2)) < 1.5 * np.sqrt(np.mean((random**2 + common**2)[here]))
        assert abs(np.median(off[here] / common[here])) < 3
    assert max(step.chi_square for step in found.mosaic.steps) < 21.1, "a chi-square of three, 1 in 10000"


def test_a_pair_that_cannot_be_tied_stays_where_telemetry_puts_it(
    found: MergedStations, answered: Callable[..., str]
) -> None:
    assert "not tied to middle, and where telemetry puts them: away" in found.notes()
    assert found.mosaic is not None
    alone, tied = (found.mosaic.localised.adjusted.joint[k : k + 3, k : k + 3] for k in (18, 6))
    # The mast's 0.3 degrees and the level's 0.02 of a pair alone, less of one that is tied to the first one's.
    np.testing.assert_allclose(np.degrees(np.sqrt(np.diag(alone))), [np.hypot(0.3, 0.02)] * 2 + [0.3], rtol=0.01)
    assert np.trace(tied) < 0.9 * np.trace(alone)
    told = found.mosaic.localised.stations[3].pose
    np.testing.assert_allclose(found.mosaic.localised.poses[3].rotation, told.rotation, atol=1e-9)
    assert "Heights of 4 stations are one grid now" in answered(found)


def test_telemetry_that_pictures_overrule_is_a_doubt(found: MergedStations) -> None:
    """Pictures of one place, whose telemetry says 1.5 m: both ways and the standard errors stand in the doubt."""
    assert found.located is not None
    localised = found.located.localised
    there = np.add(localised.poses[0].center_m, [1.5, 0, 0])
    moved = Pose(rotation=localised.stations[1].pose.rotation, center_m=there)
    stations = (localised.stations[0], replace(localised.stations[1], pose=moved), *localised.stations[2:])
    said = replace(found, located=replace(found.located, localised=replace(localised, stations=stations)))
    told = r"left is 1.50 m from middle by telemetry and 0.0\d m by the pictures, \d+ standard errors"
    assert re.search(told, said.untrusted)
    assert "away is" not in said.untrusted, "what pictures do not tie they cannot overrule"


def test_the_command_writes_map_and_cloud(pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [str(pairs / name) for name in ("middle", "left")]
    whole, cloud = tmp_path / "map.npz", tmp_path / "cloud.ply"
    given = ["--rig", str(pairs / "rig.toml"), "--spacing", "0.03", *LEVEL, "--save-cloud", str(cloud)]
    assert main(["images", "merge", *folders, *given, "-o", str(whole)]) == 0
    capsys.readouterr()
    model, read = read_elevation(whole), read_terrain_file(whole, read_soil("longji"))
    assert model.synthetic and read.states_errors
    likely = read.likely(read.terrain)
    assert np.nanmedian(np.abs(likely.height_m - model.height_m)) < 0.01
    head, points = cloud.read_bytes().split(b"end_header\n", 1)
    count = int(head.split(b"element vertex ")[1].split()[0])
    z = np.frombuffer(points, dtype=np.uint8).reshape(count, -1)[:, 16:24].copy().view("<f8")[:, 0]
    assert count > 100_000 and np.percentile(z, 1) == pytest.approx(np.nanpercentile(model.height_m, 1), abs=0.05)
    assert main(["images", "merge", *folders, *given[:-2], "--json", "--no-time"]) == 0
    result = json.loads(capsys.readouterr().out)["result"]
    assert np.shape(result["covariance"]) == (12, 12) and len(result["poses"]) == len(result["steps"]) + 1 == 2


def test_what_is_neither_models_nor_folders(pairs: Path, tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(b"")
    with pytest.raises(RequestError, match="one or the other"):
        merge([str(pairs / "left"), str(tmp_path / "a.npz")])
    with pytest.raises(RequestError, match="two or more"):
        merge([str(pairs / "left")])
    with pytest.raises(RequestError, match=r"pose\.toml of their folders"):
        merge([str(pairs / "left"), str(pairs / "right")], positions="p.csv")


def stacked(prior: np.ndarray, height: np.ndarray, by: np.ndarray, sigma: float) -> Stack:
    """Two models on 60 by 60 nodes, 0.02 m apart."""
    shape = 2, 3600
    return Stack(
        height=height.reshape(shape), variance=np.full(shape, sigma**2), by=by, prior=prior, alike=1.0,
        block=blocks_of(60, 60),
    )  # fmt: skip


@pytest.mark.parametrize(("shared", "left"), [(1.0, 1.0), (0.0, 0.5), (0.6, 0.8)])
def test_what_pairs_share_does_not_average(shared: float, left: float) -> None:
    """Two offsets of variance 1 cm2 with a correlation r: their mean has the variance (1 + r) / 2."""
    prior = 1e-4 * np.array([[1.0, shared], [shared, 1.0]])
    model = ElevationModel(name="a", x0_m=0, y0_m=0, spacing_m=0.02, height_m=np.zeros((60, 60)))
    stack = stacked(prior, np.random.default_rng(2).normal(0, 1e-4, (2, 3600)), np.ones((2, 3600, 1)), 1e-4)
    corrections, covariance, weight = reconciled(stack)
    axis = 0.02 * np.arange(60)
    merged = map_of([model, model], stack, weight, corrections, covariance, (axis, axis, 0.02)).model
    assert np.median(merged.layer("height_m_common_sigma")) ** 2 == pytest.approx(1e-4 * left, rel=0.01)


def test_steps_are_a_chi_square_of_three_and_show_what_is_wrong() -> None:
    """Planes of known spread between two models: the mean of 300 chi-squares is 3 within 4 standard errors; a step five
    times as large as the spread allows has a chance below 1 in 1000."""
    random, axis = np.random.default_rng(5), 0.02 * np.arange(60)
    x, y = (grid.ravel() - 0.59 for grid in np.meshgrid(axis, axis))
    by = np.stack([np.stack([np.ones(3600), x, y], axis=-1)] * 2)
    root = np.diag([0.003, 0.004, 0.004])
    prior = block_diag(root**2, root**2)

    def step(offsets: np.ndarray) -> float:
        heights = np.einsum("knc,kc->kn", by, offsets) + random.normal(0, 0.002, (2, 3600))
        made = _seam(stacked(prior, heights, by, 0.002), (0, 1), (axis, axis, 0.02))
        assert made is not None
        return made.chi_square if abs(offsets).max() < 0.021 else made.chance

    squares = [step(random.standard_normal((2, 3)) @ root) for _ in range(300)]
    assert np.mean(squares) == pytest.approx(3.0, abs=4 * np.sqrt(6 / 300))
    assert step(np.array([[0.0, 0.0, 0.0], [5 * 0.003 * np.sqrt(2), 0.0, 0.0]])) < 1e-3


def test_modes_are_what_poses_make_of_heights() -> None:
    """A plane seen from (0, 0, 1.5): heights rise by what the camera rises, and by -y and x of a turn about x and y."""
    height = np.zeros((40, 60))
    model = ElevationModel(name="flat", x0_m=2.0, y0_m=-0.4, spacing_m=0.02, height_m=height)
    x, y = np.meshgrid(model.x_m, model.y_m)
    for column, change in ((5, np.ones(x.shape)), (0, y), (1, -x)):
        root = np.zeros((30, 1))
        root[column] = 0.01
        modes = height_modes(model, RIG, Pose.looking([0, 0, 1.5], 0.0, 30.0), root, 1, upwards(height, 0.02))
        made = modes.by[..., 0] * (modes.of[0, column] * 0.01)
        np.testing.assert_allclose(made, 0.01 * change, atol=2e-5)


def test_pairs_of_a_stand_share_the_rovers_errors(found: MergedStations) -> None:
    """Between two pairs of one stand there are their masts' errors alone."""
    assert found.mosaic is not None
    prior = reckoned(found.mosaic.localised.stations)
    mast = np.radians(0.3) * np.array([1, 1, 1, 0.27, 0.27, 0.27])
    np.testing.assert_allclose(apart(prior, 0, 3), np.diag(2 * mast**2), atol=1e-12)
    np.testing.assert_allclose(root_of(prior) @ root_of(prior).T, prior, atol=1e-12)


ALONE, SHARED = [[0.0, 0.0], [0.0, 9.0]], [[9.0, 9.0], [9.0, 9.0]]


@pytest.mark.parametrize(("prior", "share"), [(ALONE, 0.1), (SHARED, 0.25), ([[0.0, 0.0], [0.0, 0.0]], 0.25)])
def test_a_pair_counts_by_its_pose_and_not_by_what_it_shares(prior: list[list[float]], share: float) -> None:
    """Variances of 1, and of 1 + 9 by a pose or 4: the mean of least variance has weights of 1 to 1/10 or 1/4."""
    stack = stacked(np.array(prior), np.zeros((2, 3600)), np.ones((2, 3600, 1)), 1.0)
    stack.variance[1] = 1.0 if share == 0.1 else 4.0
    stack.height[1, 7] = np.nan
    shares = _shares(stack)
    np.testing.assert_allclose(np.delete(shares[1] / shares[0], 7), share, rtol=1e-9)
    assert shares[1, 7] == 0.0 < shares[0, 7]
