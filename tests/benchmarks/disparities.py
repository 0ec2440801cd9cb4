"""Are disparities of `lunarsci images` as wrong as they say, beside OpenCV's? Against dense truth of `scenes.py`.

    python tests/benchmarks/scenes.py FOLDER --seeds 110 111 --material pressed
    python tests/benchmarks/disparities.py FOLDER/navcam-pressed-11*/station0

prints for each station: density (share of the pixels that both cameras see), share more than 1 px off, shares within
1 and 1.96 stated errors and beyond 4; the same of semi-global matching with one setting for all (blocks of 5 px, P1 and
P2 of 8 and 32 times their area, uniqueness 10, left and right agree to 1 px, speckles below 100 px); both on the pixels
that both have; and the mean error on the floors of tracks between 2.5 and 4 m, less that of the ground beside them.
"""

import argparse
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lunarsci.images.camera import Pose, StereoRig
from lunarsci.images.jobs.dem import nearest_ground_m
from lunarsci.images.matching import Rectified, _warped, match
from lunarsci.images.pictures import Picture, read_picture
from lunarsci.images.rig_files import read_rig

NEAR_M, FLOOR_M, BESIDE_M = (2.5, 4.0), 0.045, (0.15, 0.3)


def true_disparities(truth: Any, told: StereoRig, pose: Pose, frame: Rectified) -> tuple[np.ndarray, np.ndarray]:
    """In the told rig's rectified frame, as the true cameras see the points, and these points. (h, w), (h, w, 3)"""
    left, right = told.moved(truth["rig"]).project(pose.to_camera(truth["points_m"]))
    ways = told.left.rays(left) @ frame.turn.T, told.right.rays(right) @ told.rotation @ frame.turn.T
    seen = frame.focal_px * (ways[0][..., 0] / ways[0][..., 2] - ways[1][..., 0] / ways[1][..., 2])
    seen = np.where(truth["seen"] & (truth["kind"] > 0), seen, np.nan)
    maps = np.nan_to_num(frame.maps[0], nan=-9.0)
    places = cv2.remap(truth["points_m"], *np.moveaxis(maps, -1, 0), cv2.INTER_NEAREST, borderValue=(math.nan,) * 3)
    return cv2.remap(seen, *np.moveaxis(maps, -1, 0), cv2.INTER_LINEAR, borderValue=math.nan), places


def semi_global(frame: Rectified, pictures: list[Picture], nearest_m: float) -> np.ndarray:
    """OpenCV's, with its settings. (h, w) [px]"""
    warped = [_warped(p.values, m) for p, m in zip(pictures, frame.maps, strict=True)]
    top = np.percentile(warped[0], 99.5)
    eight = [np.clip(255 * np.sqrt(np.maximum(p, 0) / top), 0, 255).astype(np.uint8) for p in warped]
    count = 16 * math.ceil((frame.focal_px * frame.baseline_m / nearest_m + 2) / 16)
    matcher = cv2.StereoSGBM_create(0, count, 5, 8 * 25, 32 * 25, 1, 31, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM)
    padded = [cv2.copyMakeBorder(p, 0, 0, count, 0, cv2.BORDER_REPLICATE) for p in eight]
    disparity = matcher.compute(*padded)[:, count:] / 16
    return np.where(disparity > 0, disparity, np.nan)


def judged(station: Path) -> str:
    truth = np.load(station / "truth.npz")
    told = read_rig(str(station.parent / "rig.toml"))
    pose = Pose(rotation=truth["left_rotation"], center_m=truth["left_center_m"])
    pictures = [read_picture(station / f"{side}.png") for side in ("left", "right")]
    nearest = nearest_ground_m(told, pose, told.height_m)
    matches = match(*pictures, told, nearest_m=nearest)
    true, places = true_disparities(truth, told, pose, matches.rectified)
    known = np.isfinite(true)
    off = matches.disparity - true
    theirs = semi_global(matches.rectified, pictures, nearest) - true
    good, others = np.isfinite(off), np.isfinite(theirs)
    z = np.abs(off[good]) / matches.sigma_px[good]
    both = good & others
    away = np.linalg.norm(places - pose.center_m, axis=-1)
    near = good & (away > NEAR_M[0]) & (away < NEAR_M[1])
    floors = []
    for track in truth["tracks"]:
        aside = np.abs(places[..., 1] - np.interp(places[..., 0], track[:, 0], track[:, 1]))
        floor, beside = near & (aside < FLOOR_M), near & (aside > BESIDE_M[0]) & (aside < BESIDE_M[1])
        floors.append(off[floor].mean() - off[beside].mean() if floor.sum() > 50 and beside.sum() > 50 else math.nan)
    shares = (np.mean(np.abs(e) > 1) for e in (off[good], theirs[others], off[both], theirs[both]))
    bad = [f"{share:.2%}" for share in shares]
    counts = [f"{part.sum() / known.sum():.3f}" for part in (good, others, both)]
    return (
        f"{station.parent.name}/{station.name}: {counts[0]}, {bad[0]} bad, {np.mean(z < 1):.3f} "
        f"{np.mean(z < 1.96):.3f}, {np.mean(z > 4):.2%} beyond 4 | OpenCV {counts[1]}, {bad[1]} | both {counts[2]}: "
        f"{bad[2]}, {bad[3]} | floors " + " ".join(f"{value:+.3f}" for value in floors)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stations", type=Path, nargs="+")
    for station in parser.parse_args().stations:
        print(judged(station), flush=True)


if __name__ == "__main__":
    main()
