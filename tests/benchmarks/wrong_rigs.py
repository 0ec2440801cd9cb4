"""Does `lunarsci.images.reliability` doubt rigs that are wrong, and those alone?

Of scenes of `scenes.py` the true rig is known:

    python tests/benchmarks/scenes.py FOLDER --seeds 30 31 32 --rig navcam
    python tests/benchmarks/wrong_rigs.py FOLDER/navcam-3*

prints the share of rigs that are doubted at `SIGNIFICANCE`: 15 draws a scene that the true rig may be one of, then
the stated rig with each error of `WRONG`, and how often the right cause is named first.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from lunarsci.arrays import SIGNIFICANCE
from lunarsci.images.camera import StereoRig, rotation_of
from lunarsci.images.pictures import read_picture
from lunarsci.images.reliability import reliability, ties_of
from lunarsci.images.rig_files import read_pose, read_rig

DRAWS, MAST_M, TILT_DEG = 15, 1.5, 0.3


def focal(rig: StereoRig, share: float) -> StereoRig:
    sides = [replace(one, fx_px=share * one.fx_px, fy_px=share * one.fy_px) for one in (rig.left, rig.right)]
    return replace(rig, left=sides[0], right=sides[1])


WRONG: dict[str, tuple[Callable[[StereoRig], StereoRig], str]] = {
    "baseline x 2": (lambda r: replace(r, translation_m=2 * r.translation_m), "baseline"),
    "baseline x 0.5": (lambda r: replace(r, translation_m=0.5 * r.translation_m), "baseline"),
    "focal x 1.2": (lambda r: focal(r, 1.2), "focal"),
    "focal x 0.8": (lambda r: focal(r, 0.8), "focal"),
    "turned by 0.5 deg": (lambda r: replace(r, rotation=rotation_of([0, 0, 0.0087]) @ r.rotation), "turned"),
    "2 px too low": (lambda r: replace(r, right=replace(r.right, cy_px=r.right.cy_px - 2)), "too low"),
    "mast + 1 m": (lambda r: replace(r, mast_height_m=MAST_M + 1), "m over the ground, not"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    random = np.random.default_rng(0)
    doubted, named = {name: [] for name in ("none", *WRONG)}, {name: [] for name in WRONG}
    for scene in parser.parse_args().scenes:
        rig = replace(read_rig(str(scene / "rig.toml")), mast_height_m=MAST_M)
        station = scene / "station0"
        pose = read_pose(str(station / "pose.toml"))
        ties = ties_of(*(read_picture(station / f"{side}.png") for side in ("left", "right")))
        true = rig.moved(np.load(station / "truth.npz")["rig"])
        drawn = [true.moved(np.sqrt(np.diag(rig.covariance)) * random.standard_normal(24)) for _ in range(DRAWS)]
        for name, one in [("none", one) for one in drawn] + [
            (name, change(rig)) for name, (change, _) in WRONG.items()
        ]:
            result = reliability(one, ties, pose, TILT_DEG)
            assert result is not None
            doubted[name].append(result.probability < SIGNIFICANCE)
            if name in WRONG and doubted[name][-1]:
                named[name].append(WRONG[name][1] in result.causes[0])
    for name, shares in doubted.items():
        right = f", its cause named first {sum(named[name])}" if name in WRONG else ""
        print(f"{name}: {sum(shares)} of {len(shares)} doubted{right}")


if __name__ == "__main__":
    main()
