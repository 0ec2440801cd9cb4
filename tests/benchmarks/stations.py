"""Poses of stations from the blind scenes of `scenes.py`, beside the truth of its files.

    python tests/benchmarks/scenes.py FOLDER --seeds 2 3 4 --stations 2
    python tests/benchmarks/stations.py FOLDER/navcam-2 FOLDER/navcam-3 ...

Of each scene: error of the last station as a share of its distance from the first, and NEES, the squared error of all
poses over their covariance (expected: 6 a station), and of the last place alone (3). Then, over all scenes, the mean of
NEES over what is expected and the share of scenes in their 95 % regions. SYNTHETIC.
"""

import sys
from pathlib import Path

import numpy as np

from lunarsci.images.camera import vector_of
from lunarsci.images.jobs.locate import locate
from lunarsci.images.localisation import Localised


def judged(found: Localised, folders: list[Path]) -> dict[str, float]:
    """How far poses are from those of `truth.npz` beside their pictures."""
    truth = [np.load(folder / "truth.npz") for folder in folders]
    off = np.concatenate(
        [
            np.concatenate([vector_of(p.rotation @ t["left_rotation"].T), p.center_m - t["left_center_m"]])
            for p, t in zip(found.poses[1:], truth[1:], strict=True)
        ]
    )
    way = np.linalg.norm(truth[-1]["left_center_m"] - truth[0]["left_center_m"])
    return {
        "tied": all(found.tied),
        "percent": 100 * np.linalg.norm(off[-3:]) / way,
        "nees_place": off[-3:] @ np.linalg.solve(found.covariance[-3:, -3:], off[-3:]),
        "nees": off @ np.linalg.solve(found.covariance, off),
        "expected": len(off),
    }


def measure(scene: Path) -> dict[str, float]:
    """The same of all stations of a scene."""
    folders = sorted(scene.glob("station*"))
    return judged(locate(folders, rig=str(scene / "rig.toml")).localised, folders)


def main(scenes: list[str]) -> None:
    from scipy.stats import chi2

    rows = []
    for name in scenes:
        rows.append(measure(Path(name)))
        print(name, {key: round(float(value), 3) for key, value in rows[-1].items()}, flush=True)
    ratio = np.array([row["nees"] / row["expected"] for row in rows])
    inside = [row["nees"] < chi2.ppf(0.95, row["expected"]) for row in rows]
    print(f"{len(rows)} scenes: percent {np.median([r['percent'] for r in rows]):.3f} in the median, "
          f"{max(r['percent'] for r in rows):.3f} at most; NEES over expected {ratio.mean():.2f}; "
          f"{np.mean(inside):.0%} within 95 %")  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
