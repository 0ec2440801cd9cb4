"""Are heights, tracks and rocks of `lunarsci images` as wrong as they say, in scenes that nobody tuned on?

Scenes are those of `scenes.py` (Mitsuba; the rig that took the pictures is a draw from the covariance that the solver
is told). Each station is read by `lunarsci images dem` with its true pose, and set beside the meshes:

    python tests/benchmarks/scenes.py FOLDER --seeds 30 31 32 --rig navcam
    python tests/benchmarks/blind_scenes.py FOLDER/navcam-3*

prints, by range and over all scenes: rms error over rms stated error, the share of nodes within one stated error, and
both for what is left when the height error of the rig's own offset, which is known here, is taken off (`alone`);
heights in shadow; depths of tracks about 3 m away against the meshes; rocks.
"""

import argparse
import json
import math
import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.images.camera import Pose
from lunarsci.images.elevation import ElevationModel
from lunarsci.images.gridding import grid_of
from lunarsci.images.jobs.dem import StereoTerrain, dem
from lunarsci.images.matching import MATCHED
from lunarsci.images.rig_files import pose_text
from lunarsci.images.rocks import find_rocks
from lunarsci.images.tracks import change_along, track_depths

RANGES_M = (0.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0)
FEWEST = 300
"""Nodes without which a range says nothing."""
WHEEL_M = 0.15
TRACK_M = 2.75, 3.75
"""Ranges between which tracks are measured: about 3 m, where both pictures show them."""
ROCKS_M, ROCK_M = 5.0, 0.05
BEFORE_OFF = 0.02, 0.1
"""Errors of the pose of the pictures before the drive. [m], [deg]"""


@dataclass(frozen=True)
class Seen:
    """A station, what was made of it, and what is true."""

    name: str
    found: StereoTerrain
    truth: Any

    @property
    def camera_m(self) -> np.ndarray:
        return np.asarray(self.truth["left_center_m"])

    def surface(self, x: np.ndarray, y: np.ndarray, cell_m: float, key: str = "dem_m") -> np.ndarray:
        """Mean height of cells about places, NaN outside."""
        from scipy.ndimage import convolve1d, map_coordinates

        ahead, left, height = self.truth["dem_x_m"], self.truth["dem_y_m"], self.truth[key]
        step = float(ahead[1] - ahead[0])
        half = 0.5 * cell_m / step
        around = np.arange(-math.ceil(half), math.ceil(half) + 1)
        weight = np.clip(half + 0.5 - np.abs(around), 0.0, 1.0)
        for axis in (0, 1):
            height = convolve1d(height, weight / weight.sum(), axis=axis, mode="nearest")
        return map_coordinates(height, [(y - left[0]) / step, (x - ahead[0]) / step], order=1, cval=np.nan)

    def beside(self, model: ElevationModel) -> dict[str, np.ndarray]:
        """Ranges, errors, those of the rig's offset, and stated errors, random and common, of a model's nodes."""
        x, y = np.meshgrid(model.x_m, model.y_m)
        truth = self.surface(x, y, model.spacing_m)
        known = np.isfinite(model.height_m) & np.isfinite(truth)
        places = np.column_stack([x[known], y[known], truth[known]])
        random, common = (model.layer(k)[known] for k in ("height_m_sigma", "height_m_common_sigma"))
        return {
            "range": np.linalg.norm(places - self.camera_m, axis=1),
            "error": model.height_m[known] - truth[known],
            "offset": self._offset(places),
            "random": random,
            "common": common,
        }

    def _offset(self, places: np.ndarray) -> np.ndarray:
        """What the heights of places are off by since the rig is not the one that was told. (n,) [m]"""
        told, pose = self.found.rig, Pose(rotation=self.truth["left_rotation"], center_m=self.camera_m)
        pixels = told.moved(self.truth["rig"]).project(pose.to_camera(places))
        moved = pose.to_world(told.triangulate(*pixels).points)
        step = 0.03
        slope = [
            (self.surface(*(moved[:, :2] + way).T, 0.1) - self.surface(*(moved[:, :2] - way).T, 0.1)) / (2 * step)
            for way in np.eye(2) * step
        ]
        shift = moved - places
        return np.asarray(shift[:, 2] - slope[0] * shift[:, 0] - slope[1] * shift[:, 1])


def seen(station: Path, folder: Path, off: tuple[float, float] = (0.0, 0.0)) -> Seen:
    """Read a station as a user would who knows where it is, `off` by so much [m] and so much in its angles [deg]."""
    from scipy.spatial.transform import Rotation

    truth, random = np.load(station / "truth.npz"), np.random.default_rng(len(str(station)))
    turn = Rotation.from_rotvec(random.normal(0, math.radians(off[1]), 3)).as_matrix()
    place = truth["left_center_m"] + random.normal(0, off[0], 3)
    pose = folder / "pose.toml"
    pose.write_text(pose_text(Pose(rotation=truth["left_rotation"] @ turn, center_m=place)))
    pictures, rig = (station / "left.png", station / "right.png"), str(station.parent / "rig.toml")
    found = dem(*pictures, rig=rig, pose=str(pose), tilt_error=off[1])
    return Seen(f"{station.parent.name}/{station.name}", found, truth)


def heights(station: Seen) -> list[dict[str, Any]]:
    """Sums of a station's nodes by range."""
    found = station.beside(station.found.model)
    stated = np.hypot(found["random"], found["common"])
    alone = found["error"] - found["offset"]
    rows = []
    for low, high in pairwise(RANGES_M):
        inside = (found["range"] >= low) & (found["range"] < high) & np.isfinite(alone) & np.isfinite(stated)
        if inside.sum() < FEWEST:
            continue
        rows.append(
            {
                "from_m": low,
                "to_m": high,
                "nodes": int(inside.sum()),
                "error_m2": float(np.mean(found["error"][inside] ** 2)),
                "stated_m2": float(np.mean(stated[inside] ** 2)),
                "held": float(np.mean(np.abs(found["error"]) < stated, where=inside)),
                "alone_m2": float(np.mean(alone[inside] ** 2)),
                "random_m2": float(np.mean(found["random"][inside] ** 2)),
                "alone_held": float(np.mean(np.abs(alone) < found["random"], where=inside)),
                "median_m": float(np.median(alone[inside])),
                "beyond_4": float(np.mean(np.abs(alone) > 4 * found["random"], where=inside)),
            }
        )
    return rows


def shadows(station: Seen) -> dict[str, float]:
    """Pixels that no Sun reaches, some way into the shadow: share with a height, and with one that is 3 sigma off."""
    from scipy.ndimage import binary_erosion

    matches, truth = station.found.matches, station.truth
    places = np.rint(np.nan_to_num(matches.rectified.maps[0], nan=-9.0)).astype(int)
    height, width = truth["lit"].shape
    inside = (places[..., 0] >= 0) & (places[..., 0] < width) & (places[..., 1] >= 0) & (places[..., 1] < height)
    u, v = np.clip(places[..., 0], 0, width - 1), np.clip(places[..., 1], 0, height - 1)
    dark = inside & (truth["lit"][v, u] < 0.01) & (truth["kind"][v, u] > 0)
    deep = binary_erosion(dark, iterations=5)
    error = matches.disparity - _disparities(station, truth["points_m"][v, u])
    given = deep & (matches.reason == MATCHED)
    wrong = given & (np.abs(error - np.nanmedian(error)) > 3 * matches.sigma_px)
    count = max(int(deep.sum()), 1)
    return {"pixels": int(deep.sum()), "given": float(given.sum() / count), "wrong": float(wrong.sum() / count)}


def _disparities(station: Seen, points: np.ndarray) -> np.ndarray:
    """Disparity of world points in the told rig's rectified frame, as the true cameras see them. [px]"""
    told, frame = station.found.rig, station.found.matches.rectified
    pose = Pose(rotation=station.truth["left_rotation"], center_m=station.camera_m)
    left, right = told.moved(station.truth["rig"]).project(pose.to_camera(points))
    ways = told.left.rays(left) @ frame.turn.T, told.right.rays(right) @ told.rotation @ frame.turn.T
    return np.asarray(frame.focal_px * (ways[0][..., 0] / ways[0][..., 2] - ways[1][..., 0] / ways[1][..., 2]))


def _fine(station: Seen) -> ElevationModel:
    found = station.found
    return grid_of(found.matches, found.rig, found.pose, name=station.name, spacing_m=0.01, farthest_m=5.0)


def tracks(station: Seen, earlier: Seen | None = None) -> list[dict[str, Any]]:
    """Depths along both tracks about 3 m away: a line drawn a little beside, windows of 0.5 m and the mean.

    Below the ground of an `earlier` station, where there is one.
    """
    model = _fine(station)
    before = None if earlier is None else _fine(earlier)
    random = np.random.default_rng(len(station.name))
    rows = []
    for side, track in zip(("left", "right"), station.truth["tracks"], strict=True):
        away = np.hypot(np.hypot(*(track[:, :2] - station.camera_m[:2]).T), station.camera_m[2])
        near = np.flatnonzero((away >= TRACK_M[0]) & (away <= TRACK_M[1]))
        if len(near) < 50:
            continue
        line = track[near[[0, len(near) // 2, -1]], :2]
        line = line + random.uniform(-0.02, 0.02, (3, 2))
        used = model if before is None else change_along(model, before, line, WHEEL_M, 0.05).model
        found = track_depths(used, line, WHEEL_M, window_m=0.5, step_m=0.1)
        if not found.determined.any():
            rows.append({"side": side, "reason": found.reason[0]})
            continue
        truth = _true_depths(station, track, found.x_m)
        good = found.determined
        sigma = np.hypot(found.rut_m_random, found.rut_m_systematic)[good]
        shared = float(np.nanmean(found.rut_m_systematic))
        rows.append(
            {
                "side": side,
                "windows": int(good.sum()),
                "off_m": (found.rut_m - truth)[good].tolist(),
                "sigma_m": sigma.tolist(),
                "mean_off_m": float(found.mean_m - truth[good].mean()),
                "mean_sigma_m": math.hypot(found.mean_random_m, shared),
                "mean_random_m": found.mean_random_m,
                "depth_m": float(truth[good].mean()),
                "causes_m": {k: None if v is None else float(np.nanmean(v)) for k, v in found.systematic_m.items()},
                "offset_off_m": float(np.mean(_aside(track, found.x_m, found.y_m))),
            }
        )
    return rows


def _aside(track: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(y - np.interp(x, track[:, 0], track[:, 1]))


def _true_depths(station: Seen, track: np.ndarray, places: np.ndarray, window_m: float = 0.5) -> np.ndarray:
    """Mean of the ground before the wheel less the ground after it, over the wheel's width and the window. (n,) [m]"""
    along, across = np.meshgrid(np.arange(-0.5, 0.5, 0.004) * window_m, np.arange(-0.5, 0.5, 0.02) * WHEEL_M)
    found = []
    for place in places:
        k = int(np.argmin(np.abs(track[:, 0] - place)))
        turn = track[k, 3]
        x = track[k, 0] + along * np.cos(turn) - across * np.sin(turn)
        y = track[k, 1] + along * np.sin(turn) + across * np.cos(turn)
        found.append(np.mean(station.surface(x, y, 0.0, "ground_m") - station.surface(x, y, 0.0)))
    return np.array(found)


def rocks(station: Seen) -> dict[str, int]:
    """Rocks of 5 cm and more within 5 m that pixels show, how many were found, and finds that are none."""
    truth = station.truth
    sun = truth["sun"]
    angles = math.degrees(math.atan2(sun[1], sun[0])), math.degrees(math.asin(sun[2]))
    survey = find_rocks(station.found.matches, station.found.pose, sun_deg=angles)
    found = np.array([(r.x_m, r.y_m) for r in survey.rocks]).reshape(-1, 2)
    points = truth["points_m"][(truth["kind"] == 2) & truth["seen"]]
    near = np.array([r for r in truth["rocks"] if np.linalg.norm(r[:3] - station.camera_m) < ROCKS_M + 0.3])
    away = np.linalg.norm(near[:, :3] - station.camera_m, axis=1)
    shown = np.array([(np.hypot(*(points[:, :2] - r[:2]).T) < 0.5 * r[3]).sum() >= 12 for r in near])
    asked = shown & (near[:, 3] >= ROCK_M) & (away < ROCKS_M)
    apart = np.hypot(*(found[:, None] - near[:, :2]).transpose(2, 0, 1))
    hit = apart < np.maximum(0.6 * near[:, 3], 0.03)
    level = math.sqrt(ROCKS_M**2 - self_height(station) ** 2)
    inside = np.hypot(*(found - station.camera_m[:2]).T) < level
    return {
        "rocks": int(asked.sum()),
        "found": int((asked & hit.any(axis=0)).sum()),
        "finds": int(inside.sum()),
        "false": int((inside & ~hit.any(axis=1)).sum()),
    }


def self_height(station: Seen) -> float:
    """Of the camera over the ground. [m]"""
    return float(station.camera_m[2] - np.nanmedian(station.truth["ground_m"]))


def judged(station: Path, folder: Path) -> dict[str, Any]:
    """All numbers of a station."""
    began, spent = time.time(), _spent()
    found = seen(station, folder)
    cost = {"wall_s": time.time() - began, "cpu_s": _spent() - spent}
    before = station.with_name(station.name.replace("station", "before"))
    earlier = seen(before, folder, BEFORE_OFF) if (before / "truth.npz").exists() else None
    return {
        "station": found.name,
        **cost,
        "pixels": found.found.matches.shares(),
        "heights": heights(found),
        "shadows": shadows(found),
        "tracks": tracks(found),
        "sinkage": [] if earlier is None else tracks(found, earlier),
        "rocks": rocks(found),
    }


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def height_lines(results: list[dict[str, Any]]) -> Iterator[str]:
    """By range over all stations, each of which counts alike."""
    yield "range m | stations nodes | rms/stated  68 % | alone: rms/random  68 %  median mm  > 4 sigma | rms mm"
    for low, high in pairwise(RANGES_M):
        rows = [row for result in results for row in result["heights"] if row["from_m"] == low]
        if not rows:
            continue
        mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        yield (
            f"{low:4.1f}-{high:4.1f} | {len(rows):3d} {sum(r['nodes'] for r in rows):8d} | "
            f"{math.sqrt(mean['error_m2'] / mean['stated_m2']):.2f}  {mean['held']:.3f} | "
            f"{math.sqrt(mean['alone_m2'] / mean['random_m2']):.2f}  {mean['alone_held']:.3f}  "
            f"{1e3 * mean['median_m']:+.2f}  {mean['beyond_4']:.4f} | {1e3 * math.sqrt(mean['error_m2']):.1f}"
        )


def track_lines(results: list[dict[str, Any]], key: str) -> Iterator[str]:
    rows = [row | {"station": r["station"]} for r in results for row in r[key]]
    for row in rows:
        if "reason" in row:
            yield f"{row['station']} {row['side']}: not determined: {row['reason']}"
            continue
        causes = " ".join(f"{k} {1e3 * (v or 0):.2f}" for k, v in row["causes_m"].items())
        yield (
            f"{row['station']} {row['side']}: {1e3 * row['depth_m']:.1f} mm, off {1e3 * row['mean_off_m']:+.2f}, "
            f"stated {1e3 * row['mean_sigma_m']:.2f} (random {1e3 * row['mean_random_m']:.2f}; {causes}); a window "
            f"{1e3 * np.std(row['off_m']):.2f}, stated {1e3 * np.mean(row['sigma_m']):.2f}"
        )
    good = [row for row in rows if "reason" not in row]
    if good:
        off, sigma = (np.concatenate([row[key] for row in good]) * 1e3 for key in ("off_m", "sigma_m"))
        mean, said = (np.array([row[key] for row in good]) * 1e3 for key in ("mean_off_m", "mean_sigma_m"))
        for name, e, s in (("windows of 0.5 m", off, sigma), ("means over the line", mean, said)):
            yield (
                f"tracks, {len(e)} {name}: bias {e.mean():+.2f} mm, rms {np.sqrt(np.mean(e**2)):.2f} mm, "
                f"stated {np.median(s):.2f} mm, rms of z {np.sqrt(np.mean((e / s) ** 2)):.2f}, "
                f"held {np.mean(np.abs(e) < s):.2f}"
            )


def lines(results: list[dict[str, Any]]) -> Iterator[str]:
    yield from height_lines(results)
    dark = {key: np.array([r["shadows"][key] for r in results]) for key in ("pixels", "given", "wrong")}
    total = max(dark["pixels"].sum(), 1)
    given, wrong = ((dark[key] * dark["pixels"]).sum() / total for key in ("given", "wrong"))
    yield f"shadow: {total} pixels, {given:.2%} with a height, {wrong:.2%} with one 3 sigma off"
    yield from track_lines(results, "tracks")
    yield "from before and after:"
    yield from track_lines(results, "sinkage")
    sums = {key: sum(r["rocks"][key] for r in results) for key in ("rocks", "found", "finds", "false")}
    yield f"rocks of 5 cm within 5 m: {sums['found']} of {sums['rocks']}; {sums['false']} false of {sums['finds']}"
    yield f"CPU s a pair: {np.median([r['cpu_s'] for r in results]):.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+", help="folders of scenes; all their stations are read")
    parser.add_argument("--stations", type=int, default=9, help="of each scene")
    parser.add_argument("-o", "--output", type=Path, help="JSON file of all numbers")
    asked = parser.parse_args()
    import tempfile

    results = []
    with tempfile.TemporaryDirectory() as folder:
        for scene in asked.scenes:
            for station in sorted(scene.glob("station*"))[: asked.stations]:
                results.append(judged(station, Path(folder)))
                print(f"-- {results[-1]['station']}", *lines(results[-1:]), sep="\n")
                sys.stdout.flush()
    print("== all", *lines(results), sep="\n")
    if asked.output:
        asked.output.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
