"""What heights, depths of tracks and positions hang on: numbers of `lunarsci.images` that no theory gives.

    python tests/benchmarks/scenes.py FOLDER --seeds 4 --stations 2
    python tests/benchmarks/scenes.py FOLDER --seeds 110 111 --material pressed
    python tests/benchmarks/image_numbers.py FOLDER/navcam-4 FOLDER/navcam-pressed-11* [--only gridding]

Each number is set as it is, and smaller and larger, beside the truth of the scenes (SYNTHETIC, by Mitsuba). Of heights
it prints how many nodes have one, their rms error without the rig's own in mm, that over the stated one, and the share
beyond four stated errors; of tracks the rms of the depths' errors in mm, and that over the stated one; of positions
ties, error in percent of the way, and NEES over what is expected; of maps of two stations the rms error in mm, and that
over the stated one.
"""

import argparse
import dataclasses
import importlib
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from blind_scenes import Seen, heights, seen, tracks
from stations import judged

from lunarsci.images.elevation import StationPosition, merge
from lunarsci.images.gridding import grid_of
from lunarsci.images.jobs.locate import DeadReckoning, read_stations
from lunarsci.images.jobs.requests import LocateRequest
from lunarsci.images.localisation import localise
from lunarsci.images.rig_files import read_rig

NUMBERS: dict[str, tuple[Any, ...]] = {
    "matching.STARTS_PX": (0.25, 0.5, 1.0),
    "matching.START_SIGMAS": (2.0, 3.0, 4.5),
    "matching.WIDE_HALF_PX": (3, 4, 5),
    "matching.WIDE_SMOOTH_PX": (3, 5, 7),
    "matching.DARK": (0.025, 0.05, 0.1),
    "matching.COARSE_PX": (0.5, 1.0, 2.0),
    "gridding.STEEPEST": (1.0, 1.5, 2.25),
    "gridding.GRAZING_DEG": (1.5, 3.0, 6.0),
    "gridding.COVERED": (0.25, 0.5, 0.75),
    "gridding.SMOOTH_M": (0.03, 0.06, 0.12),
    "gridding.LEVEL": (0.001, 0.01, 0.1),
    "tracks.FLOOR_SHARE": (0.4, 0.6, 0.8),
    "tracks.COVERED": ((0.25, 0.15), (0.5, 0.3), (0.75, 0.45)),
    "tracks.RESOLUTION_OFF": (0.15, 0.3, 0.6),
    "tracks.CELL_SHARE": (0.15, 0.3, 0.6),
    "tracks.PRIOR_SHAMS": (2.0, 4.0, 8.0),
    "elevation.BLOCK": (6, 12, 24),
    "elevation.BETWEEN_NODES": (0.05, 0.1, 0.2),
    "adjustment.SMALLEST_PX": (0.05, 0.1, 0.2),
    "localisation.FEWEST": (4, 8, 16),
    "localisation.HIDDEN": (0.01, 0.02, 0.04),
    "localisation.TEMPLATE_PX": ((31, 13), (41, 17), (61, 25)),
    "localisation.WIDE_PX": ((61, 19), (81, 25), (121, 37)),
    "localisation.LEAST_CORRELATION": (0.5, 0.6, 0.7),
    "localisation.LOOSE_CORRELATION": (0.35, 0.45, 0.55),
    "localisation.INLIER_PX": (2.0, 4.0, 8.0),
    "localisation.REACHES_PX": (((6, 3), (3, 2)), ((12, 6), (6, 4)), ((24, 12), (12, 8))),
}


def of_heights(stations: list[Seen]) -> str:
    rows = [row for station in stations for row in heights(station)]
    count = np.array([row["nodes"] for row in rows])
    error, stated = (math.sqrt(np.average([r[key] for r in rows], weights=count)) for key in ("alone_m2", "random_m2"))
    beyond = np.average([row["beyond_4"] for row in rows], weights=count)
    return f"{count.sum()} nodes, {1e3 * error:.3f} mm, {error / stated:.3f} of the stated one, {beyond:.2%} beyond 4"


def of_tracks(stations: list[Seen]) -> str:
    rows = [row for station in stations for row in tracks(station) if "off_m" in row]
    off, sigma = (np.concatenate([row[key] for row in rows]) for key in ("off_m", "sigma_m"))
    rms = float(np.sqrt(np.mean(off**2)))
    return f"{len(off)} depths, {1e3 * rms:.3f} mm, {float(np.sqrt(np.mean((off / sigma) ** 2))):.3f} of the stated one"


def of_positions(scenes: list[tuple[list[Path], list[Any]]]) -> str:
    parts = []
    for folders, read in scenes:
        found = localise(read)
        row = judged(found, folders)
        ties = sum(report.ties for report in found.reports)
        parts.append(f"{ties} ties, {row['percent']:.3f} %, NEES {row['nees'] / row['expected']:.2f}")
    return "; ".join(parts)


def of_maps(models: list[Seen]) -> str:
    """Of both stations, the second of which is known to 2 cm and is off by as much."""
    places = [StationPosition(), StationPosition(x_m=0.02, y_m=-0.02, covariance_m2=np.diag([4e-4] * 3))]
    found = models[0].beside(merge([one.found.model for one in models], places).model)
    error, stated = found["error"], np.hypot(found["random"], found["common"])
    rms = float(np.sqrt(np.nanmean(error**2)))
    return (
        f"{len(error)} nodes, {1e3 * rms:.3f} mm, {rms / float(np.sqrt(np.nanmean(stated**2))):.3f} of the stated one"
    )


def read_scenes(folders: list[Path]) -> Iterator[tuple[list[Path], list[Any]]]:
    """Scenes of two stations and more, with their pairs matched."""
    asked = LocateRequest()
    errors = DeadReckoning(asked.drift, asked.heading_error, asked.tilt_error)
    for folder in folders:
        stations = sorted(folder.glob("station*"))
        if len(stations) > 1:
            rig = read_rig(str(folder / "rig.toml"))
            yield stations, read_stations(stations, errors, lambda _, rig=rig: rig, progress=lambda _: None).stations


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    names = [name for name in NUMBERS if name.startswith(asked.only)]
    pairs = [folder / "station0" for folder in asked.scenes]
    with tempfile.TemporaryDirectory() as made:
        first = [seen(pair, Path(made)) for pair in pairs]
        located = list(read_scenes(asked.scenes)) if any(name[0] in "al" for name in names) else []
        both = [seen(asked.scenes[0] / f"station{k}", Path(made)) for k in (0, 1)] if "elevation.BLOCK" in names else []
        for name in names:
            module, _, number = name.partition(".")
            code = importlib.import_module(f"lunarsci.images.{module}")
            before = getattr(code, number)
            for value in NUMBERS[name]:
                setattr(code, number, value)
                if module == "matching":
                    said = of_heights([seen(pair, Path(made)) for pair in pairs])
                elif module == "gridding":
                    said = of_heights([dataclasses.replace(one, found=regridded(one)) for one in first])
                elif module == "elevation":
                    said = of_maps(both)
                else:
                    said = of_tracks(first) if module == "tracks" else of_positions(located)
                print(f"{name} {value}{' (as it is)' if value == before else ''}: {said}", flush=True)
            setattr(code, number, before)


def regridded(station: Seen) -> Any:
    found = station.found
    model = grid_of(found.matches, found.rig, found.pose, name="", spacing_m=0.02, farthest_m=found.farthest_m)
    return dataclasses.replace(found, model=model)


if __name__ == "__main__":
    main()
