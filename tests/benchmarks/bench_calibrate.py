"""Time and memory of one VNIS calibration against the plain route; run it with Python.

The baseline is what public scripts do, in NumPy: the whole cube to double precision, the reflectance of every pixel of
every image, the footprint's mask, the mean; the short-wave table; the scaling at 900 nm. Both start from the files and
end with 390 reflectances. The baseline is given irradiance, distance and angles for nothing; it reads no labels, checks
and hashes nothing, and knows neither shadows nor errors.
"""

import argparse
import statistics
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lunarsci.spectra.solar import sun_moon_distance_au
from lunarsci.spectra.vnis.calibrate import calibrate
from lunarsci.spectra.vnis.detector import default_settings, irradiance_at
from lunarsci.spectra.vnis.observation import find_parts, read_observation
from lunarsci.spectra.vnis.simulation.instrument import simulate
from lunarsci.spectra.vnis.simulation.products import product_files
from lunarsci.spectra.vnis.simulation.scene import Scene, SceneRock


def ours(label: str) -> Callable[[], np.ndarray]:
    """From files to a spectrum with errors, as each observation of a batch."""
    settings = default_settings()
    return lambda: calibrate(read_observation(label), settings).reflectance


def baseline_of(scene: Scene, label: str) -> Callable[[], np.ndarray]:
    """The plain route with everything but the radiances prepared."""
    parts, solar = find_parts(label), default_settings().solar
    irradiance = irradiance_at("vnir", solar), irradiance_at("swir", solar)
    distance = sun_moon_distance_au(scene.time)
    cosines = [np.cos(np.radians(g.incidence_deg)) for g in (scene.geometry, scene.swir_geometry())]
    lines, samples = np.ogrid[:256, :256]
    mask = (lines - 127) ** 2 + (samples - 97) ** 2 <= 53.8**2

    def run() -> np.ndarray:
        cube = np.fromfile(parts.cube, "<f4").astype(np.float64).reshape(100, 256, 256)
        reflectance = np.pi * cube * distance**2 / (irradiance[0][:, None, None] * cosines[0])
        vnir = reflectance[:, mask].mean(axis=1)
        radiance = np.array([float(row.split()[4]) for row in Path(parts.table).read_text().splitlines()])
        swir = np.pi * radiance * distance**2 / (irradiance[1] * cosines[1])
        return np.concatenate([vnir[:90] * swir[0] / vnir[90], swir])

    return run


def seconds(run: Callable[[], object], repeats: int) -> list[float]:
    """Wall time of each repetition."""
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        found.append(time.perf_counter() - start)
    return found


def peak_mb(run: Callable[[], object]) -> float:
    """Largest memory that is allocated at once, in this run alone."""
    tracemalloc.start()
    run()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15)
    repeats = parser.parse_args().repeats
    scene = Scene(rock=SceneRock(), disk=None)
    with tempfile.TemporaryDirectory() as folder:
        for name, content in product_files(simulate(scene, seed=1)).items():
            (Path(folder) / name).write_bytes(content)
        label = str(next(Path(folder).glob("*SD_SCI*L")))
        routes = {"lunarsci": ours(label), "baseline": baseline_of(scene, label)}
        for run in routes.values():
            run()
        # In turn, so that a slow moment of the machine meets both.
        times: dict[str, list[float]] = {name: [] for name in routes}
        for _ in range(repeats):
            for name, run in routes.items():
                times[name] += seconds(run, 1)
        for name, run in routes.items():
            middle, fastest = statistics.median(times[name]), min(times[name])
            print(f"{name}: {1e3 * middle:.0f} ms (fastest {1e3 * fastest:.0f}), peak {peak_mb(run):.0f} MB")
        ratio = statistics.median(a / b for a, b in zip(times["lunarsci"], times["baseline"], strict=True))
        print(f"lunarsci / baseline: {ratio:.2f} of the time")


if __name__ == "__main__":
    main()
