"""Verdicts on maps of 1 to 5 m, beside drives on the ground itself: `python tests/benchmarks/coarse_maps.py`.

SYNTHETIC ground of craters, a regional slope and waves of 0.4 to 4 m, none of it by the law that `twin predict` draws
roughness from, is known to a tenth of a metre. A map has its heights every 1 to 5 m. A plan of 5 to 12 m is judged on
the map, and driven on the ground. Printed are how many verdicts are which, how many of them the drive bears out, what
the map alone would have said, taken for smooth, and how many numbers were asked about.
"""

import argparse
import dataclasses
import tempfile
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from lunarsci.twin.ground.synthetic import synthetic_terrain
from lunarsci.twin.ground.terrain import Terrain, terrain_bytes
from lunarsci.twin.jobs.predict import predict
from lunarsci.twin.plans.plan import Leg, Plan

SPACINGS_M = (1.0, 2.0, 5.0)
EXTENT_M, FINE_M = 60.0, 0.1


def map_of(ground: Terrain, spacing_m: float) -> Terrain:
    """Every so many nodes of the ground."""
    step = round(spacing_m / ground.spacing_m)
    return dataclasses.replace(ground, spacing_m=spacing_m, height_m=ground.height_m[::step, ::step], synthetic=False)


def one_plan(number: int, folder: Path, soil: str) -> tuple[float, str, str, str, int]:
    """Spacing of the map, the verdict on it, on it as smooth ground, and on the ground; questions asked."""
    random = np.random.default_rng([7, number])
    ground = synthetic_terrain(
        seed=number, spacing_m=FINE_M, extent_m=EXTENT_M, slope_deg=float(random.uniform(0, 12)),
        craters=int(random.integers(0, 60)), rms_m=float(random.choice([0.002, 0.004, 0.01, 0.02])),
    )  # fmt: skip
    spacing = float(random.choice(SPACINGS_M))
    plan = Plan(
        name=f"plan {number}", legs=(Leg(float(random.uniform(5, 12)), float(random.uniform(-0.15, 0.15))),),
        speed_m_s=0.05, heading_deg=float(random.uniform(-180, 180)), x_m=float(random.uniform(-5, 5)),
        y_m=float(random.uniform(-5, 5)),
    )  # fmt: skip
    (folder / "ground.npz").write_bytes(terrain_bytes(ground))
    (folder / "map.npz").write_bytes(terrain_bytes(map_of(ground, spacing)))
    given = {"soil": (soil,), "rover": "yutu2", "time_step": 0.2, "sample": 0.2}
    said = predict(plan, terrain=str(folder / "map.npz"), **given)
    smooth = predict(plan, terrain=str(folder / "map.npz"), exact_terrain=True, **given)
    driven = predict(plan, terrain=str(folder / "ground.npz"), exact_terrain=True, **given)
    return spacing, said.verdict.verdict, smooth.verdict.verdict, driven.verdict.verdict, len(said.questions)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=100)
    parser.add_argument("--soil", default="longji")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        rows = [one_plan(number, Path(folder), options.soil) for number in range(options.plans)]
    print("spacing [m] | verdict | plans | kept on the ground")
    for spacing in (None, *SPACINGS_M):
        some = [row for row in rows if spacing in (None, row[0])]
        for column, name in ((1, ""), (2, " (map taken for smooth)")):
            for verdict, count in sorted(Counter(row[column] for row in some).items()):
                kept = sum(row[3] == "go" for row in some if row[column] == verdict)
                print(f"{spacing or 'all'} | {verdict}{name} | {count} | {kept}")
    print(f"questions: {sum(row[4] for row in rows)}")


if __name__ == "__main__":
    main()
