"""What maps of all that M3 measured would cost: `python tests/benchmarks/cost_of_m3.py`.

For docs/validation/speed.md.

A SYNTHETIC strip is written as an ENVI cube, and a block of it mapped as `spectra map` does it: processor seconds of
the worker and of the process that gives out the blocks and writes the map, bytes that are sent and written, all per
pixel; and what a dask scheduler takes per block. From these the cost on 1, 100 and 10,000 cores, and what bounds it.
"""

import io
import pickle
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from strips import EIGHTY_FIVE_NM, mixtures

from lunarsci.parallel.blocks import SavedBlocks
from lunarsci.spectra.cubes.output import fetched, measured
from lunarsci.spectra.cubes.rasters import open_cube
from lunarsci.spectra.cubes.regions import region_of
from lunarsci.spectra.jobs.map_products import products_of
from lunarsci.spectra.jobs.requests import MapRequest

MOON_KM2 = 4.0 * np.pi * 1737.4**2
COVERAGES = 1.5
"""How often global mode saw a place on average, assumed: strips overlap, and towards the poles much."""
GLOBAL = COVERAGES * MOON_KM2 / 0.140**2
"""Pixels of 140 m (Boardman et al. 2011, 10.1029/2010JE003730), 85 channels (Kramer et al. 2011, 10.1029/2010JE003728).
"""
TARGET = 0.25 * MOON_KM2 / 0.070**2
"""Pixels of 70 m, 260 channels, of the quarter of the Moon that was planned at least (Pieters et al. 2009, Curr. Sci.
96, 500); the mission ended early, so this is more than there is."""
TARGET_NM = np.linspace(460.0, 2400.0, 195)
"""The 260 channels of 430-3000 nm, those of 460-2400 nm."""
LINK_BYTES_S = 1.25e9
"""Assumed network of the process that gives out the blocks: 10 Gbit/s. [1/s]"""
LINES, SAMPLES = 8, 304


@dataclass(frozen=True)
class BlockCost:
    """Of one pixel: processor seconds of a worker and of the process that gives out blocks; bytes in, back, written."""

    worker_s: float
    client_s: float
    sent: float
    back: float
    written: float


def write_envi(path: Path, wavelength_nm: np.ndarray, reflectance: np.ndarray) -> None:
    """Band-interleaved by line, 32 bits, as M3 has its reflectances."""
    lines, samples, bands = reflectance.shape
    np.moveaxis(reflectance, 2, 1).astype("<f4").tofile(path)
    numbers = ", ".join(f"{value:.3f}" for value in wavelength_nm)
    path.with_suffix(".hdr").write_text(
        f"ENVI\nsamples = {samples}\nlines = {lines}\nbands = {bands}\nheader offset = 0\nfile type = ENVI Standard\n"
        f"data type = 4\ninterleave = bil\nbyte order = 0\nwavelength units = Nanometers\nwavelength = {{{numbers}}}\n"
    )


def processor_s(call, repeats: int = 2):
    """Processor seconds of the quicker of some calls, all threads together, and what it gave."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        found = call()
        times.append(time.process_time() - before)
    return min(times), found


def cost_of_block(wavelength_nm: np.ndarray, products: str, folder: Path) -> BlockCost:
    """Of mapping `products` of a strip."""
    image = folder / f"strip{len(wavelength_nm)}.img"
    write_envi(image, wavelength_nm, mixtures(wavelength_nm, (LINES, SAMPLES), seed=1).reflectance)
    cube, asked = open_cube(str(image)), MapRequest(products=products)
    region, made, rows, n = region_of(cube), products_of(asked), range(LINES), LINES * SAMPLES
    reading_s, given = processor_s(lambda: fetched(cube, region, rows), 4)
    measured(made, cube.wavelength_nm, given)  # compiled
    worker_s, arrays = processor_s(lambda: measured(made, cube.wavelength_nm, given))
    kept = SavedBlocks(folder / f"kept-{len(wavelength_nm)}-{products}", {}, LINES, LINES)
    sending_s, sent = processor_s(lambda: pickle.dumps(given, protocol=5), 4)
    keeping_s, _ = processor_s(lambda: kept.save(rows, arrays), 4)
    loading_s, found = processor_s(lambda: kept.load(rows), 4)
    writing_s, _ = processor_s(lambda: [io.BytesIO().write(array.tobytes()) for array in found.values()], 4)
    size = sum(array.nbytes for array in arrays.values())
    kept.close(remove=True)
    client_s = reading_s + 2 * sending_s + keeping_s + loading_s + writing_s
    return BlockCost(worker_s / n, client_s / n, len(sent) / n, size / n, size / n)


def scheduler_s() -> float:
    """Processor seconds of a dask scheduler and its client for a block."""
    from distributed import LocalCluster

    from lunarsci.arrays import spans
    from lunarsci.parallel.blocks import computing, run_blocks

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        computing(scheduler=cluster.scheduler_address),
    ):
        list(run_blocks(len, spans(100, 1)))
        return processor_s(lambda: list(run_blocks(len, spans(500, 1))), 1)[0] / 500


def said(name: str, pixels: float, cost: BlockCost, block_s: float, rows: int) -> None:
    """A table of 1, 100 and 10,000 cores."""
    hours = pixels * cost.worker_s / 3600
    print(
        f"\n{name}: {pixels / 1e6:,.0f} million pixels; worker {cost.worker_s * 1e6:.1f} us, giving out and writing "
        f"{cost.client_s * 1e6:.2f} us, {cost.sent:,.0f} bytes sent, {cost.back:,.0f} back, each a pixel"
    )
    print(f"  {hours:,.0f} core hours; {pixels * cost.sent / 1e12:.2f} TB sent, {pixels * cost.written / 1e12:.2f} TB "
          "of maps, and as much again beside them until they are done")  # fmt: skip
    for cores in (1, 100, 10_000):
        ends = {
            "the cores": hours / cores,
            "the process that gives out and writes": pixels * cost.client_s / 3600,
            "the scheduler": pixels / (rows * SAMPLES) * block_s / 3600,
            "the network of that process": pixels * (cost.sent + cost.back) / LINK_BYTES_S / 3600,
        }
        first = max(ends, key=lambda what: ends[what])
        told = ", ".join(f"{what} {value:,.2f} h" for what, value in ends.items())
        print(f"  {cores:6,d} cores: {max(ends.values()):,.1f} h, bound by {first} ({told})")


def main() -> None:
    block_s, rows = scheduler_s(), int(sys.argv[1]) if len(sys.argv) > 1 else 64
    print(f"scheduler: {block_s * 1e3:.2f} ms a block; blocks of {rows} lines of {SAMPLES}")
    with tempfile.TemporaryDirectory() as folder:
        for products in ("bands", "bands,fit"):
            for name, pixels, channels in (("global", GLOBAL, EIGHTY_FIVE_NM), ("target", TARGET, TARGET_NM)):
                cost = cost_of_block(channels, products, Path(folder))
                said(f"{name} mode, {products}", pixels, cost, block_s, rows)


if __name__ == "__main__":
    main()
