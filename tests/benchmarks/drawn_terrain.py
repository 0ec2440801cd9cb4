"""Do drives over drawn terrains hold the true one? `python tests/benchmarks/drawn_terrain.py [--cases N] [--members N]`

With `--sun DEG` stones lie on the ground, and the model has no height in their shadows and where they hide the ground.

A true ground is made up here (fractal, with craters), and an elevation model of it as stereo cameras at one place would
make it: random errors that grow with the square of the range and hang together over a window, and an error of the rig,
a bias of the disparity, which all heights share. The true drive is on the true ground, the prediction knows the model
and the sizes of its errors. Both drives take the mean of the ground over a wheel's width. The soil is known, so that
all spread is terrain. SYNTHETIC; nothing of `lunarsci.images` makes the model, and nothing of
`lunarsci.twin.ground.height_errors` the ground.
"""

import argparse
import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import correlate1d, map_coordinates, uniform_filter

from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Terrain, TerrainFile, build_terrain
from lunarsci.twin.judgement.quantities import along
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict

SPACING_M = 0.02
SIDE_M = (8.4, 6.4)
CAMERA_M = (-2.5, 0.0, 1.5)
FOCAL_PX, BASELINE_M = 1189.0, 0.27
RANDOM_PX, WINDOW_PX, BIAS_PX = 0.25, 9, 0.15


class Case(NamedTuple):
    """A true terrain, and the file that an elevation model of it would be."""

    truth: Terrain
    model: TerrainFile


def true_heights(random: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Fractal ground of 2 to 5 cm rms over a metre, exponent 0.6 to 0.9, and some craters. [m]"""
    size, hurst, rms = 1024, random.uniform(0.6, 0.9), random.uniform(0.015, 0.035)
    k = np.hypot(np.fft.fftfreq(size, SPACING_M)[:, None], np.fft.fftfreq(size, SPACING_M))
    power = np.where((k > 1 / 8) & (k < 1 / (3 * SPACING_M)), np.maximum(k, 1e-9) ** (-hurst - 1), 0.0)
    ground = np.fft.ifft2(power * np.fft.fft2(random.standard_normal((size, size)))).real
    lag = round(1 / SPACING_M)
    ground *= rms / np.sqrt(np.mean((ground[:, lag:] - ground[:, :-lag]) ** 2))
    y, x = np.mgrid[: shape[0], : shape[1]] * SPACING_M
    heights = ground[: shape[0], : shape[1]]
    for _ in range(6):
        radius = random.uniform(0.15, 0.5)
        away = np.hypot(x - random.uniform(0, x.max()), y - random.uniform(0, y.max())) / radius
        heights = heights + 0.1 * radius * np.where(away < 1, away**2 - 1, 0.2 * np.exp(-3 * (away - 1) ** 2) - 0.2)
    return heights


def stones(random: np.random.Generator, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Half ellipsoids of 4 to 24 cm, one on two square metres, as high as a third of their width. [m]"""
    heights = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    for _ in range(round(0.5 * SIDE_M[0] * SIDE_M[1])):
        radius = 0.02 * random.pareto(2.0) + 0.02
        away = np.hypot(x - random.choice(x), y - random.choice(y.ravel())) / min(radius, 0.12)
        heights = np.maximum(heights, 0.66 * min(radius, 0.12) * np.sqrt(np.maximum(1.0 - away**2, 0.0)))
    return heights


def hidden(heights: np.ndarray, x: np.ndarray, y: np.ndarray, azimuth: float, elevation: float) -> np.ndarray:
    """Nodes in shadow, and those that the camera does not see for what stands before them."""
    sun = np.cos(azimuth) + 0.0 * x * y, np.sin(azimuth) + 0.0 * x * y, math.tan(elevation) + 0.0 * x * y
    away = np.hypot(CAMERA_M[0] - x, CAMERA_M[1] - y)
    eye = (CAMERA_M[0] - x) / away, (CAMERA_M[1] - y) / away, (CAMERA_M[2] - heights) / away
    row, column = np.indices(heights.shape, dtype=float)
    dark = np.zeros(heights.shape, dtype=bool)
    for along_x, along_y, rise in (sun, eye):
        for step in range(1, 60):
            met = map_coordinates(heights, [row + step * along_y, column + step * along_x], order=1, mode="nearest")
            dark |= met > heights + step * SPACING_M * rise + 0.002
    return dark


def case(seed: int, sun_deg: float | None = None) -> Case:
    """A ground and its model; with the Sun so high there are stones, and holes for what is dark or hidden."""
    random = np.random.default_rng([seed, 7])
    shape = tuple(round(side / SPACING_M) + 1 for side in SIDE_M[::-1])
    origin = -1.2, -0.5 * SIDE_M[1]
    truth = true_heights(random, shape)
    x, y = origin[0] + SPACING_M * np.arange(shape[1]), origin[1] + SPACING_M * np.arange(shape[0])[:, None]
    if sun_deg is not None:
        truth = truth + stones(random, x, y)
    level = np.hypot(x - CAMERA_M[0], y - CAMERA_M[1])
    reach = np.hypot(level, CAMERA_M[2])
    by_px = CAMERA_M[2] * reach / (FOCAL_PX * BASELINE_M)
    # A cell's mean is over the pixels in it; errors of neighbouring pixels share the window of the matching.
    window = WINDOW_PX * reach / FOCAL_PX
    noise = uniform_filter(random.standard_normal(shape), max(1, round(float(np.median(window)) / SPACING_M)))
    noise /= noise.std()
    sigma = RANDOM_PX * by_px
    heights = truth + sigma * noise + BIAS_PX * by_px * random.standard_normal()
    if sun_deg is not None:
        heights[hidden(truth, x, y, random.uniform(0, 2 * math.pi), math.radians(sun_deg))] = np.nan
    soil = read_soil("longji")
    errors = {"height_m_sigma": sigma, "height_m_common_sigma": BIAS_PX * by_px, "resolution_m": window}
    grounds = [build_terrain(name, *origin, SPACING_M, h, soil) for name, h in (("truth", truth), ("model", heights))]
    return Case(grounds[0], TerrainFile(grounds[1], errors=errors))


def plan_of(seed: int) -> Plan:
    """Two arcs of 5 m together."""
    turn = np.random.default_rng([seed, 8]).uniform(-0.2, 0.2, 2)
    return Plan(name="two arcs", legs=tuple(Leg(2.5, float(k)) for k in turn), speed_m_s=0.05)


def felt(heights: np.ndarray, width_m: float) -> np.ndarray:
    """Means over a wheel's width about each node; the outermost nodes count by the part of them that it covers. [m]"""
    half = 0.5 * width_m / SPACING_M
    nodes = np.arange(-math.ceil(half), math.ceil(half) + 1)
    shares = np.clip(half + 0.5 - np.abs(nodes), 0.0, 1.0)
    shares /= shares.sum()
    return correlate1d(correlate1d(heights, shares, axis=0, mode="nearest"), shares, axis=1, mode="nearest")


def quantities(drive: Prediction) -> dict[str, np.ndarray]:
    """The end [m], and of each drive largest and median tilt [deg], slip [-] and sinkage [m]."""
    found = {"end_x_m": drive.endpoints_m[:, 0], "end_y_m": drive.endpoints_m[:, 1]}
    for name in ("tilt_deg", "slip_ratio", "sinkage_m"):
        values = np.abs(along(drive, name)).reshape(drive.members, -1)
        found |= {f"largest {name}": values.max(axis=1), f"median {name}": np.median(values, axis=1)}
    return found


def ranks(seed: int, members: int, sun_deg: float | None = None) -> dict[str, Any]:
    """Where the true drive lies among the predicted ones, by quantity, 0 to 1; and the model taken as exact."""
    one, rover, plan = case(seed, sun_deg), build_rover("yutu2"), plan_of(seed)
    truth = dataclasses.replace(one.truth, height_m=felt(one.truth.height_m, rover.wheel.width_m))
    soils = {"friction_angle_deg": np.full(members, 37.2)}
    drawn = one.model.likely(one.model.terrain, rover.wheel.width_m)
    drives = {
        "truth": predict(rover, truth.with_soil(friction_angle_deg=37.2), plan, sweep=()),
        "drawn": predict(rover, drawn, plan, samples=soils, seed=seed),
        "as read": predict(rover, one.model.terrain.with_soil(friction_angle_deg=37.2), plan, sweep=()),
    }
    true, clouds, read = (quantities(drives[name]) for name in ("truth", "drawn", "as read"))
    done = drives["drawn"].finished
    found: dict[str, Any] = {"finished": float(done.mean()), "read": drives["as read"].outcome_text(0)}
    if not done.any():
        return found
    for name, values in clouds.items():
        cloud = values[done]
        found[name] = {
            "rank": float((cloud < true[name][0]).mean()),
            "sd": float(cloud.std()),
            "off": float(np.median(cloud) - true[name][0]),
            "read_off": float(read[name][0] - true[name][0]),
        }
    return found


def share_within(found: list[dict[str, Any]], name: str, level: float) -> float:
    """Of the cases whose truth lies in the middle interval of that level."""
    return float(np.mean([abs(one[name]["rank"] - 0.5) <= 0.5 * level for one in found]))


def main() -> None:
    """Drive, and print."""
    parser = argparse.ArgumentParser(description="Do drives over drawn terrains hold the true drive?")
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--members", type=int, default=64)
    parser.add_argument("--sun", type=float, help="its height: stones, with shadows [deg]")
    given = parser.parse_args()
    every = [ranks(seed, given.members, given.sun) for seed in range(given.first, given.first + given.cases)]
    found = [one for one in every if len(one) > 2]
    print(f"as read: {sum(one['read'] != 'finished' for one in every)} do not finish; drawn: {len(every) - len(found)}")
    names = [name for name in found[0] if isinstance(found[0][name], dict)]
    print(f"{len(found)} cases of {given.members} members; finished {np.mean([one['finished'] for one in found]):.3f}")
    print(f"{'quantity':24s} in 68 %  in 95 %    rms off   rms sd   rms off as read")
    for name in names:
        rms = [math.sqrt(np.mean([one[name][key] ** 2 for one in found])) for key in ("off", "sd", "read_off")]
        held = [share_within(found, name, level) for level in (0.68, 0.95)]
        print(f"{name:24s} {held[0]:7.2f} {held[1]:7.2f} {rms[0]:10.5f} {rms[1]:8.5f} {rms[2]:10.5f}")


if __name__ == "__main__":
    main()
