"""Paths among rocks: `python tests/benchmarks/bench_terrain.py`.

A path on the stand-in for Longji, and how often a path is found among random rocks where a search on the grid says that
there is a passage. Time and memory of maps of 16 million nodes are those of `load.py terrain`.
"""

import time

import numpy as np
from scipy.ndimage import label

from lunarsci.errors import ParameterError
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.hazards import Traversability, assess, ground_maps, map_scales, read_mobility, rover_footprint
from lunarsci.twin.ground.synthetic import synthetic_longji, synthetic_terrain
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.routes.arc_search import search_ground
from lunarsci.twin.routes.planner import plan_path
from lunarsci.twin.rover import build_rover

ROVER = build_rover("yutu2")
MOBILITY = read_mobility(read_rover("yutu2"), ROVER)
TRIALS = 40


def look(terrain: Terrain) -> Traversability:
    return assess(terrain, ground_maps(terrain, *map_scales(ROVER)), MOBILITY)


def joined(surface: Traversability, target: tuple[float, float]) -> bool:
    """Whether discs of half the rover's width and its clearance can get from the start to the target."""
    clear = rover_footprint(ROVER).half_width_m + MOBILITY.hazard_distance_m
    ground = search_ground(surface, np.array([(0.0, 0.0), target]), 10.0)
    parts, _ = label(ground.window.values[..., 0] >= clear)
    window = ground.window
    numbers = [
        parts[round((y - window.y0) / window.spacing), round((x - window.x0) / window.spacing)]
        for x, y in ((0.0, 0.0), target)
    ]
    return bool(numbers[0] == numbers[1] != 0)


def found_among_rocks(share: float) -> tuple[int, int, float]:
    """Paths found and passages on the grid, over random grounds, and the longest search. [s]"""
    found, passages, longest = 0, 0, 0.0
    for seed in range(TRIALS):
        surface = look(synthetic_terrain(seed=seed, rock_share=share, extent_m=24.0))
        if not joined(surface, (9.0, 2.0)):
            continue
        passages += 1
        start = time.perf_counter()
        try:
            plan_path(surface, ROVER, (0.0, 0.0, 0.0), (9.0, 2.0))
            found += 1
        except ParameterError:
            pass
        longest = max(longest, time.perf_counter() - start)
    return found, passages, longest


def main() -> None:
    """Print times and shares."""
    longji = look(synthetic_longji())
    plan_path(longji, ROVER, (0.0, 0.0, 0.0), (9.0, 2.0))
    start = time.perf_counter()
    path = plan_path(longji, ROVER, (0.0, 0.0, 0.0), (9.369, 1.957))
    print(f"stand-in for Longji: path of {path.plan.length_m:.2f} m in {time.perf_counter() - start:.2f} s")
    print("share of rocks  found  passages  longest search [s]")
    for share in (0.0021, 0.02, 0.05):
        found, passages, longest = found_among_rocks(share)
        print(f"{share:14.4f}  {found:5d}  {passages:8d}  {longest:18.2f}")


if __name__ == "__main__":
    main()
