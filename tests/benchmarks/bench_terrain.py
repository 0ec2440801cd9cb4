"""Time and memory of maps and paths: `python tests/benchmarks/bench_terrain.py`.

Maps of 4000 x 4000 nodes every 5 cm (200 m x 200 m), a path on the stand-in for Longji, paths of growing length on the
large ground, and how often a path is found among random rocks where a search on the grid says that there is a passage.
"""

import resource
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.ndimage import label

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import read_soil
from lunarsci.rovers import read_rover
from lunarsci.twin.ground.footprint import rover_footprint
from lunarsci.twin.ground.hazards import Traversability, assess, ground_maps, map_scales, read_mobility
from lunarsci.twin.ground.synthetic import scatter_rocks, synthetic_longji, synthetic_terrain
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.routes.planner import plan_path
from lunarsci.twin.routes.search_ground import search_ground
from lunarsci.twin.rover import build_rover

ROVER = build_rover("yutu2")
MOBILITY = read_mobility(read_rover("yutu2"), ROVER)
NODES, SPACING = 4000, 0.05
TRIALS = 40


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = call()
    return time.perf_counter() - start, result


def memory_gb() -> float:
    """Largest resident set so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def look(terrain: Terrain) -> Traversability:
    return assess(terrain, ground_maps(terrain, *map_scales(ROVER)), MOBILITY)


def large_ground() -> Terrain:
    axis = SPACING * (np.arange(NODES) - NODES // 2)
    height = 0.3 * np.sin(axis[None, :] / 3.0) * np.cos(axis[:, None] / 4.0)
    height = scatter_rocks(axis, axis, height, 0.01, seed=1)
    return build_terrain("large", axis[0], axis[0], SPACING, height, read_soil("longji"), synthetic=True)


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
    """Print times, memory and shares."""
    longji = look(synthetic_longji())
    plan_path(longji, ROVER, (0.0, 0.0, 0.0), (9.0, 2.0))
    seconds, path = timed(lambda: plan_path(longji, ROVER, (0.0, 0.0, 0.0), (9.369, 1.957)))
    print(f"stand-in for Longji: path of {path.plan.length_m:.2f} m in {seconds:.2f} s")
    print("share of rocks  found  passages  longest search [s]")
    for share in (0.0021, 0.02, 0.05):
        found, passages, longest = found_among_rocks(share)
        print(f"{share:14.4f}  {found:5d}  {passages:8d}  {longest:18.2f}")
    terrain = large_ground()
    before = memory_gb()
    seconds, surface = timed(lambda: look(terrain))
    print(
        f"{NODES} x {NODES} nodes: maps in {seconds:.1f} s; memory {before:.2f} GB before, {memory_gb():.2f} GB at most"
    )
    for distance in (10.0, 30.0, 60.0):
        target = (0.8 * distance, 0.6 * distance)
        try:
            seconds, path = timed(lambda target=target: plan_path(surface, ROVER, (0.0, 0.0, 0.0), target))
            print(
                f"  {distance:3.0f} m: {seconds:.1f} s, {len(path.plan.legs)} arcs, memory {memory_gb():.2f} GB at most"
            )
        except ParameterError as error:
            print(f"  {distance:3.0f} m: {error}")


if __name__ == "__main__":
    main()
