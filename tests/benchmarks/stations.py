"""Poses of stations from the blind scenes of `scenes.py`, beside the truth of its files.

    python tests/benchmarks/scenes.py FOLDER --seeds 2 3 4 --stations 2
    python tests/benchmarks/stations.py FOLDER/navcam-2 FOLDER/navcam-3 ...

NEES is the squared error over the covariance: of place (expected 3), of place and direction (expected 6). SYNTHETIC.
"""

import sys
from pathlib import Path

import numpy as np

from lunarsci.images.camera import vector_of
from lunarsci.images.jobs.locate import locate


def measure(scene: Path) -> dict[str, float]:
    """Error as a share of the way, and NEES, of the second station."""
    found = locate([scene / "station0", scene / "station1"], rig=str(scene / "rig.toml")).found
    first, second = (np.load(scene / f"station{k}" / "truth.npz") for k in (0, 1))
    pose = found.poses[1]
    off = np.concatenate(
        [vector_of(pose.rotation @ second["left_rotation"].T), pose.center_m - second["left_center_m"]]
    )
    way = np.linalg.norm(second["left_center_m"] - first["left_center_m"])
    whole = off @ np.linalg.solve(found.covariance, off)
    place = off[3:] @ np.linalg.solve(found.covariance[3:, 3:], off[3:])
    error = 100 * np.linalg.norm(off[3:]) / way
    return {"tied": found.tied[1], "percent": error, "nees_place": place, "nees": whole}


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(name, {key: round(float(value), 3) for key, value in measure(Path(name)).items()}, flush=True)
