"""Depths of tracks against tracks stamped into made-up ground, seen by simulated stereo with correlated errors."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from stamped_ground import NAVCAM, PANCAM, Ground, with_track

from lunarsci.arrays import BIWEIGHT, robust_fit
from lunarsci.errors import ParameterError
from lunarsci.images.elevation import MOVED
from lunarsci.images.jobs.track import TrackSinkage
from lunarsci.images.tracks import (
    TrackDepths,
    TrackProfile,
    Unrolled,
    cells_of,
    change_along,
    places_on,
    read_line,
    track_depths,
)

LINE = np.array([[0.3, 1.2], [1.4, 1.2]])


CAMERA = (-1.8, 1.2, 1.5)


def truth(ground: Ground, along: np.ndarray, window: float) -> np.ndarray:
    floor = np.abs(ground.y - 1.2) <= 0.075
    depth = ground.before - ground.after
    return np.array([depth[floor & (np.abs(ground.x - 0.3 - s) <= 0.5 * window)].mean() for s in along])


@pytest.mark.parametrize(("focal", "limit_m"), [(NAVCAM, 0.002), (PANCAM, 0.0012)])
def test_errors_hold_over_seeds(focal: float, limit_m: float) -> None:
    """One window of each seed: between 9 and 16 of 16 within one sigma is what 68 % gives in 98 of 100 cases."""
    off, sigma = [], []
    for seed in range(900, 916):
        rng = np.random.default_rng(seed)
        ground = with_track(rng, 0.002 + 0.001 * (seed % 10))
        found = track_depths(ground.seen(rng, focal, CAMERA), LINE, 0.15, step_m=0.3, disparity_bias_px=0.05)
        middle = len(found.distance_m) // 2
        off.append((found.rut_m - truth(ground, found.distance_m, 0.5))[middle])
        sigma.append(np.hypot(found.rut_m_random, found.rut_m_systematic)[middle])
    z = np.array(off) / np.array(sigma)
    assert 8 <= (np.abs(z) < 1).sum() <= 16
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert np.median(sigma) < limit_m
    assert abs(np.mean(off)) < 3 * np.std(off) / 4 + 0.0003, "more than the statistics allow"


def test_from_before_and_after_no_ground_is_interpolated() -> None:
    """The model before lies elsewhere, by 2 cm and some mrad; ground of 4 deg rms would cost 3 mm otherwise."""
    wrong = np.array([0.02, -0.012, 0.004, 0.02, 0.006, -0.004])
    off, sigma, alone, moves = [], [], [], []
    for seed in range(940, 948):
        rng = np.random.default_rng(seed)
        ground = with_track(rng, 0.008, slope_deg=4.0)
        after = ground.seen(rng, NAVCAM, CAMERA)
        before = dataclasses.replace(ground, after=ground.before).seen(rng, NAVCAM, (-1.5, 1.0, 1.5))
        y, x = np.mgrid[: before.height_m.shape[0], : before.height_m.shape[1]] * 0.01
        at = x - 0.85, y - 1.2
        turned = wrong[0] + at[0] - wrong[2] * at[1], wrong[1] + at[1] + wrong[2] * at[0]
        height = before.at("height_m", turned[0] + 0.85, turned[1] + 1.2)
        height = height + wrong[3] + wrong[4] * at[0] + wrong[5] * at[1]
        change = change_along(after, dataclasses.replace(before, height_m=height), LINE, 0.15, 0.05)
        found = track_depths(change.model, LINE, 0.15, step_m=0.3, disparity_bias_px=0.05)
        off.append(np.nanmean(found.rut_m - truth(ground, found.distance_m, 0.5)))
        shared = np.nanmean(found.rut_m_systematic)
        sigma.append(np.hypot(found.mean_random_m, shared))
        alone.append(np.nanmean(track_depths(after, LINE, 0.15, step_m=0.3).rut_m_random))
        moves.append((change.moved[:3] - wrong[:3]) / np.sqrt(np.diag(change.covariance)[:3]))
    assert abs(np.mean(off)) < 0.001
    assert np.sqrt(np.mean(np.square(off))) < 0.0012
    assert np.sqrt(np.mean((np.array(off) / sigma) ** 2)) < 1.5
    assert np.median(sigma) < 0.5 * np.median(alone)
    assert np.median(np.abs(moves)) < 2.0, dict(zip(MOVED, np.mean(moves, axis=0), strict=False))


def test_without_noise_on_smooth_ground_the_depth_is_that_of_the_stamp() -> None:
    rng = np.random.default_rng(1)
    ground = with_track(rng, 0.008, slope_deg=1e-3)
    model = ground.seen(rng, PANCAM, CAMERA, sigma_px=1e-6, bias_px=0.0, holes=0.01)
    found = track_depths(model, LINE, 0.15)
    assert found.rut_m == pytest.approx(0.008, abs=1.5e-4)
    off_line = track_depths(model, LINE + np.array([0.0, 0.03]), 0.15)
    assert off_line.offset_m == pytest.approx(found.offset_m - 0.03, abs=3e-3)
    assert off_line.rut_m == pytest.approx(found.rut_m, abs=1.5e-4)


def test_no_track_gives_no_depth() -> None:
    z = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        found = track_depths(with_track(rng, 0.0).seen(rng, PANCAM, CAMERA), LINE, 0.15, step_m=0.3)
        z += list(found.rut_m / np.hypot(found.rut_m_random, found.rut_m_systematic))
    assert np.abs(np.median(z)) < 1.0
    assert np.sqrt(np.mean(np.square(z))) < 2.0


def test_a_matching_window_as_wide_as_the_track_determines_nothing() -> None:
    rng = np.random.default_rng(2)
    model = with_track(rng, 0.008).seen(rng, NAVCAM / 8, CAMERA)
    found = track_depths(model, LINE, 0.15)
    assert not found.determined.any()
    assert "too wide" in found.reason[0]


def test_holes_in_floor_or_ground_are_said() -> None:
    rng = np.random.default_rng(3)
    model = with_track(rng, 0.008).seen(rng, PANCAM, CAMERA, holes=0.01)
    model.height_m[112:128, 30:100] = np.nan
    model.height_m[:112, 100:] = np.nan
    found = track_depths(model, LINE, 0.15, search_m=0.0)
    assert "floor not covered" in found.reason
    assert "ground to the right not covered" in found.reason
    assert found.determined.sum() < len(found.reason)


def test_profile_of_a_box_under_a_window() -> None:
    """Share left by averaging, against averaging itself."""
    profile = TrackProfile.of_wheel(0.15, 0.1)
    across = np.arange(-0.4, 0.4, 1e-4)
    box = (np.abs(across) <= 0.075).astype(float)
    blurred = np.convolve(box, np.full(1000, 1e-3), mode="same")
    assert profile.gain(0.1) == pytest.approx(blurred[np.abs(across) <= profile.floor_m].mean(), abs=2e-3)


def test_lines_and_places() -> None:
    line = read_line("0,0,1,0,1,2")
    assert places_on(line, np.array([0.5, 2.0]), np.array([0.1, 0.1])) == pytest.approx(
        np.array([[0.5, 0.1], [0.9, 1.0]])
    )
    for bad in ("1,2,3", "1,2", "1,2,1,2", "a,b,c,d", "1,2,nan,4"):
        with pytest.raises(ParameterError, match="line"):
            read_line(bad)


def test_geojson(tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    path.write_text('{"type":"Feature","geometry":{"type":"LineString","coordinates":[[1,2],[3,4,5]]}}')
    assert read_line(str(path)).tolist() == [[1, 2], [3, 4]]
    for flat in ("[1,2,3,4]", "[[1],[2],[3],[4]]"):
        path.write_text(f'{{"type":"LineString","coordinates":{flat}}}')
        with pytest.raises(ParameterError, match="LineString"):
            read_line(str(path))
    path.write_text('{"type":"Point","coordinates":[1,2]}')
    with pytest.raises(ParameterError, match="LineString"):
        read_line(str(path))


def test_what_places_share_does_not_average_and_sinkage_is_what_was_before_the_rebound() -> None:
    """Two places of three: systematic errors of hypot(3, 4) and hypot(0, 1) mm; the ground rose by a fifth."""
    depths = TrackDepths(
        distance_m=np.array([0.0, 0.1, 0.2]),
        x_m=np.array([0.3, 0.4, 0.5]),
        y_m=np.full(3, 1.2),
        rut_m=np.array([0.008, np.nan, 0.012]),
        rut_m_random=np.array([0.012, 0.5, 0.0]),
        systematic_m={"slope": np.array([0.003, 0.7, 0.0]), "bias": np.array([0.004, 0.7, 0.001]), "pose": None},
        reason=("", "floor not covered", ""),
        offset_m=np.zeros(3),
        mean_m=0.010,
        mean_random_m=0.006,
        ground_scatter_m=None,
    )
    model: Any = SimpleNamespace(summary=dict, height_m_sigma=np.ones(1), synthetic=True)
    found = TrackSinkage(
        model=model, line=LINE, width_m=0.15, depths=depths, rebound=0.2, inputs={}, tables={}, assumed=()
    )
    told = found.to_dict()
    # Means of squares: (25 + 1) / 2 = 13 mm2; 36 + 13 = 49 mm2.
    rut = {"mean": 0.010, "random": 0.006, "systematic": 1e-3 * np.sqrt(13.0), "sigma": 0.007}
    assert told["rut_m"] == pytest.approx(rut)
    assert told["sinkage_m"] == pytest.approx({"mean": 0.0125, "sigma": 0.00875, "rebound": 0.2})
    assert (told["places"], told["determined"]) == (3, 2)
    first, none, last = told["track"]
    assert first["rut_m_sigma"] == pytest.approx(0.013) and last["rut_m_sigma"] == pytest.approx(0.001)
    assert first["sinkage_m"] == pytest.approx(0.010) and first["sinkage_m_sigma"] == pytest.approx(0.01625)
    assert np.isnan(none["rut_m_sigma"]) and none["status"] == "floor not covered"


def test_cells_are_means_with_errors_that_neighbours_share() -> None:
    """Cells of 0.1 m along and across, the first node left out. A cell of three, with errors of 1, 2 and 3 mm: means,
    and a mean variance of 14/3 mm2, of which 2/3 is left as two nodes count as one. A node alone keeps its own."""
    nodes = Unrolled(
        along=np.array([0.01, 0.02, 0.05, 0.08, 0.12, 0.05]),
        across=np.array([0.01, -0.05, -0.01, -0.03, -0.05, 0.05]),
        height=np.array([9.0, 0.1, 0.2, 0.6, 0.7, 0.8]),
        sigma=np.array([9.0, 0.001, 0.002, 0.003, 0.004, 0.005]),
    )
    found = cells_of(nodes, np.arange(6) > 0, 0.1, 2.0)
    order = np.argsort(found.height)
    assert found.place[order] == pytest.approx(np.array([[0.05, -0.03], [0.12, -0.05], [0.05, 0.05]]))
    assert found.height[order] == pytest.approx([0.3, 0.7, 0.8])
    assert found.sigma[order] == pytest.approx([1e-3 * np.sqrt(14 / 3 * 2 / 3), 0.004, 0.005])
    assert found.nodes[order].tolist() == [3, 1, 1]


def test_weights_of_a_robust_fit_follow_the_scatter() -> None:
    """A plane whose heights scatter by 3 mm; each twentieth lies 10 cm off. Tukey's weights."""
    random = np.random.default_rng(0)
    design = np.column_stack([np.ones(400), random.uniform(-1, 1, (400, 2))])
    height = design @ [0.5, 0.1, -0.2] + random.normal(0.0, 0.003, 400)
    height[::20] += 0.1
    found, weight = robust_fit(design, height)
    assert found == pytest.approx([0.5, 0.1, -0.2], abs=0.001)
    off = height - design @ found
    spread = 1.4826 * np.median(np.abs(off - np.median(off)))
    assert weight == pytest.approx(np.clip(1 - (off / (BIWEIGHT * spread)) ** 2, 0, None) ** 2, abs=0.02)
    assert (weight[::20] == 0).all() and weight.mean() > 0.8
