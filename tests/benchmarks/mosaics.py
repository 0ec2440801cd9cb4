"""Mosaics of blind scenes as one map, beside the truth of their meshes and beside the plain way to lay them together.

    python tests/benchmarks/mosaics.py FOLDER --seeds 60 61 62

renders (`scenes.py`, some minutes a scene) a mast that is turned for three pairs at a first stand and two at a second
one, 2.5 m on, and lays them together by `lunarsci images merge`. What telemetry says of each pair is off by draws from
the errors that the command assumes: the rover's heading and level at a stand, the mast's angles, the way; the rig that
took the pictures is a draw from its covariance. Beside it, in the same table, the same pairs gridded with poses as told
and averaged where they overlap. SYNTHETIC.
"""

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import scenes
from scipy.ndimage import map_coordinates, uniform_filter

from lunarsci.arrays import robust_fit
from lunarsci.images.camera import Pose, rotation_of, vector_of
from lunarsci.images.elevation import BLOCK, ElevationModel
from lunarsci.images.gridding import grid_of
from lunarsci.images.jobs.merge import MergedStations, merge
from lunarsci.images.rig_files import pose_text

scenes.SAMPLES = 2
STANDS = ((0.0, 0.0, (0.0, 0.6, -0.6)), (2.5, 0.2, (0.15, -0.4)))
"""x and y of a stand, and the mast's headings there. [m], [rad]"""
HEADING_DEG, LEVEL_DEG, MAST_DEG, DRIFT = 1.0, 0.3, 0.2, 0.03
"""Errors, as `lunarsci images merge` assumes them: the first heading is the map's."""
REACH_M = 10.0
FLOOR = 5e-5
"""Errors of poses that are none: where they are given, what is left of products of rotations. [rad], [m]"""


def rendered(folder: Path, seed: int, material: str = "regolith") -> Path:
    """Render a mosaic, as far as it is not there, and give its folder."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    target, told = folder / f"mosaic-{material}-{seed}", scenes.nominal("navcam")
    random = np.random.default_rng((seed, 41))
    delta, ground = random.standard_normal(24) * told.sigmas, None
    azimuth, height = random.uniform(0, 2 * np.pi), math.radians(random.uniform(20, 45))
    way = np.zeros(3)
    for number, (x, y, pans) in enumerate(STANDS):
        sizes = np.radians([LEVEL_DEG, LEVEL_DEG, HEADING_DEG if number else 0.0])
        turned, step = random.normal(0, sizes), DRIFT * math.hypot(x, y) * random.normal(0, 1, 3)
        way = way + step
        for pan in pans:
            mast, more = random.normal(0, math.radians(MAST_DEG), 3), random.uniform(-0.03, 0.03, 3)
            place = target / f"{'AB'[number]}{1 + pans.index(pan)}"
            if (place / "pose.toml").exists():
                continue
            ground = ground or scenes.Ground(seed, scenes.MATERIALS[material])
            angles = [pan + more[0], math.radians(told.down_deg) + more[1], more[2]]
            look = scenes.look(*angles)
            middle = np.array([x, y, float(ground.bare(np.array([x]), np.array([y]))[0]) + told.height_m])
            center = middle - look @ [0.5 * 0.27, 0.0, 0.0] + look @ [0.0, 0.0, 0.05]
            corners = REACH_M * np.array([[math.cos(pan + a), math.sin(pan + a)] for a in (-0.45, 0.0, 0.45)])
            low, high = np.minimum(corners.min(axis=0), 0.0), np.maximum(corners.max(axis=0), 0.0)
            box = low[0], high[0], low[1], high[1]
            sun = scenes.sun_at(azimuth + 0.05 * number, height)
            scenes.take(place, ground, told, delta, seed, (center, angles, sun, box), random.spawn(1)[0])
            off = rotation_of(turned + mast)
            lean = np.cross(np.array([*turned[:2], 0.0]), [0.0, 0.0, told.height_m]) + np.cross(mast, center - middle)
            pose = Pose(rotation=off @ look, center_m=center + way + lean)
            (place / "pose.toml").write_text(pose_text(pose) + f'station = "{"AB"[number]}"\n')
    (target / "rig.toml").write_text(scenes.rig_toml(told))
    return target


def truth_of(folders: list[Path], model: ElevationModel) -> np.ndarray:
    """Mean true height of each cell, NaN where no pair has it. (ny, nx) [m]"""
    x, y = np.meshgrid(model.x_m, model.y_m)
    height = np.full(x.shape, np.nan)
    for folder in folders:
        true = np.load(folder / "truth.npz")
        width = round(model.spacing_m / float(true["dem_x_m"][1] - true["dem_x_m"][0]))
        mean = uniform_filter(true["dem_m"], width + 1 - width % 2)
        rows, columns = (y - true["dem_y_m"][0]) / 0.01, (x - true["dem_x_m"][0]) / 0.01
        height = np.where(np.isfinite(height), height, map_coordinates(mean, [rows, columns], order=1, cval=np.nan))
    return height


def seam_mm(models: list[ElevationModel]) -> float:
    """Rms of what blocks of `BLOCK` nodes of two models differ by in the mean, over all that overlap."""
    heights, off = laid(models), []
    for i in range(len(models)):
        for j in range(i):
            apart = heights[i] - heights[j]
            ny, nx = (n // BLOCK * BLOCK for n in apart.shape)
            blocks = apart[:ny, :nx].reshape(ny // BLOCK, BLOCK, nx // BLOCK, BLOCK).swapaxes(1, 2)
            blocks = blocks.reshape(-1, BLOCK**2)
            off += list(np.nanmedian(blocks[np.isfinite(blocks).mean(axis=1) > 0.5], axis=1))
    return 1e3 * float(np.sqrt(np.mean(np.square(off))))


def laid(models: list[ElevationModel], key: str = "height_m") -> np.ndarray:
    """A layer of models on one grid. (k, ny, nx)"""
    step = models[0].spacing_m
    first = np.array([[round(m.y0_m / step), round(m.x0_m / step)] for m in models])
    size = (first + [m.height_m.shape for m in models]).max(axis=0) - first.min(axis=0)
    whole = np.full((len(models), *size), np.nan)
    for k, (model, start) in enumerate(zip(models, first - first.min(axis=0), strict=True)):
        rows, columns = (slice(a, a + n) for a, n in zip(start, model.height_m.shape, strict=True))
        whole[k, rows, columns] = model.layer(key)
    return whole


def plainly(found: MergedStations) -> tuple[list[ElevationModel], ElevationModel]:
    """Pairs gridded where telemetry puts them, and their plain mean."""
    models = [
        grid_of(s.matches, s.rig, s.pose, name=s.name, spacing_m=found.models[0].spacing_m, farthest_m=far)
        for s, far in zip(found.mosaic.localised.stations, found.mosaic.farthest_m, strict=True)
    ]
    heights, common = laid(models), laid(models, "height_m_common_sigma")
    count = np.isfinite(heights).sum(axis=0)
    step, least = models[0].spacing_m, np.where(count > 0, count, np.nan)
    mean = ElevationModel(
        name="plain",
        x0_m=min(m.x0_m for m in models),
        y0_m=min(m.y0_m for m in models),
        spacing_m=step,
        height_m=np.nansum(heights, axis=0) / least,
        height_m_sigma=np.sqrt(np.nansum(laid(models, "height_m_sigma") ** 2, axis=0)) / least,
        height_m_common_sigma=np.nansum(common, axis=0) / least,
        count=count.astype(float),
    )
    return models, mean


def heights(model: ElevationModel, folders: list[Path]) -> dict[str, float]:
    """Rms errors and stated ones where pairs overlap and elsewhere, and both of what is left of a plane."""
    off, rows = model.height_m - truth_of(folders, model), {}
    random, common = model.layer("height_m_sigma"), model.layer("height_m_common_sigma")
    known = np.isfinite(off)
    y, x = np.nonzero(known)
    design = np.column_stack([np.ones(len(x)), x, y])
    level = off.copy()
    level[known] -= design @ robust_fit(design, off[known])[0]
    for name, part in (("overlap", model.count >= 2), ("alone", model.count == 1)):
        here, stated = known & part, np.hypot(random, common)
        rms = [float(np.sqrt(np.mean(np.square(v[here])))) for v in (off, stated, level, random)]
        rows |= {f"{name}_mm": 1e3 * rms[0], f"{name}_ratio": rms[0] / rms[1]}
        rows |= {f"{name}_level_mm": 1e3 * rms[2], f"{name}_level_ratio": rms[2] / rms[3]}
        rows |= {f"{name}_within": float((np.abs(off) < stated)[here].mean())}
    return rows


def measure(scene: Path, folders: list[Path] | None = None) -> dict[str, Any]:
    """A scene by one adjustment, and plainly."""
    folders = folders or sorted(p.parent for p in scene.glob("*/pose.toml"))
    return judged(merge([str(f) for f in folders], rig=str(scene / "rig.toml")), folders)


def judged(found: MergedStations, folders: list[Path]) -> dict[str, Any]:
    """What was found beside the truth."""
    fitted = found.mosaic.localised.adjusted
    true = [np.load(folder / "truth.npz") for folder in folders]
    off = np.concatenate([
        np.concatenate([vector_of(p.rotation @ t["left_rotation"].T), p.center_m - t["left_center_m"]])
        for p, t in zip(fitted.poses, true, strict=True)
    ])  # fmt: skip
    end, told = 6 * len(folders), [s.pose for s in found.mosaic.localised.stations]
    joint = fitted.joint[:end, :end]
    floor = np.diag(np.tile([FLOOR] * 6, len(folders)) ** 2)
    turn = [vector_of(p.rotation @ t["left_rotation"].T) for p, t in zip(told, true, strict=True)]
    models, mean = plainly(found)
    relative = off.reshape(-1, 6)[1:] - off.reshape(-1, 6)[:1]
    return {
        "tied": sum(found.mosaic.localised.tied),
        "pairs": len(folders),
        "nees": float(off @ np.linalg.solve(joint + floor, off)),
        "expected": float(np.trace(joint @ np.linalg.inv(joint + floor))),
        "turn_deg": float(np.degrees(np.sqrt(np.mean(np.square(relative[:, :3]))))),
        "told_turn_deg": float(np.degrees(np.sqrt(np.mean(np.square(np.array(turn[1:]) - turn[0]))))),
        "chi_square": max((s.chi_square for s in found.mosaic.steps), default=0.0),
        "chance": min((s.chance for s in found.mosaic.steps), default=1.0),
        "seam_mm": seam_mm(list(found.models)),
        "seam_plain_mm": seam_mm(models),
        "map": heights(found.merged.model, folders),
        "plain": heights(mean, folders),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[60])
    parser.add_argument("--material", choices=tuple(scenes.MATERIALS), default="regolith")
    parser.add_argument("--render", action="store_true", help="render alone")
    asked = parser.parse_args()
    for seed in asked.seeds:
        scene = rendered(asked.folder, seed, asked.material)
        print(json.dumps({"scene": scene.name} | ({} if asked.render else measure(scene))), flush=True)


if __name__ == "__main__":
    main()
