"""What goes through a map: blocks of rows as they are read, their layers as they are measured, and a tally of them."""

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import warn
from lunarsci.spectra.cubes.cube import LEFT_OUT, NO_DATA, Cube
from lunarsci.spectra.cubes.output import FLAG_LAYER, NO_CODE, Layer
from lunarsci.spectra.cubes.regions import Region

SAMPLED = 20_000
"""Pixels that medians in the summary are taken from."""
TRIED = 3
"""Pixels that are measured to say what all will take."""
LONG_HOURS = 1 / 60
"""What takes longer is said before it begins."""


class Product(Protocol):
    """Some layers that are measured together; it goes to other processes, so it is small."""

    name: ClassVar[str]

    @property
    def slow(self) -> bool:
        """Whether it works on one spectrum after the other."""

    @property
    def layers(self) -> Sequence[Layer]:
        """What it measures."""

    @property
    def tables(self) -> Sequence[str]:
        """Tables of lunarsci that it reads."""

    @property
    def sources(self) -> Sequence[str]:
        """What to cite."""

    def measure(self, wavelength_nm: FloatArray, reflectance: FloatArray, places: IntArray) -> Mapping[str, Any]:
        """Each layer, (n,), of spectra (n, c) with NaN in channels that cannot be used.

        `places` are the line and the sample of each in the map, (n, 2).
        """


def fetched(cube: Cube, region: Region, rows: range) -> dict[str, Any]:
    """What is read of some rows of a map: reflectance, flags, and further numbers of the pixels."""
    lines, samples = region.part(rows)
    thin = (slice(None, None, region.step),) * 2
    values, flags = cube.read(lines, samples)
    reflectance, flags = values[thin], flags[thin]
    flags[~region.kept(cube, rows)] |= LEFT_OUT
    planes = {
        name: plane.read(lines, samples)[:: region.step, :: region.step] for name, plane in cube.backplanes.items()
    }
    return {"first": rows.start, "reflectance": reflectance, "flags": flags, "planes": planes}


def measured(products: Sequence[Product], wavelength_nm: Any, block: Mapping[str, Any]) -> dict[str, Any]:
    """Every layer of a block, (rows, samples)."""
    flags, shape = block["flags"], block["flags"].shape
    wanted = (flags & (NO_DATA | LEFT_OUT)) == 0
    found: dict[str, Any] = {FLAG_LAYER: flags, **block["planes"]}
    reflectance, places = block["reflectance"][wanted], np.argwhere(wanted) + np.array([block["first"], 0])
    for product in products:
        values = product.measure(wavelength_nm, reflectance, places) if len(reflectance) else {}
        for layer in product.layers:
            whole = np.full(shape, _nothing(layer))
            if layer.name in values:
                whole[wanted] = values[layer.name]
            found[layer.name] = whole
    return found


def warn_of_cost(products: Sequence[Product], cube: Cube, region: Region) -> None:
    """Measure a few pixels of products that take long and say what all would take, as a LunarSciWarning."""
    slow = [product for product in products if product.slow]
    if not slow:
        return
    rows = (region.shape[0] * k // 4 for k in (2, 1, 3, 0))
    blocks = (fetched(cube, region, range(row, row + 1)) for row in rows)
    wanted = (block["reflectance"][(block["flags"] & (NO_DATA | LEFT_OUT)) == 0] for block in blocks)
    some = next((found for found in wanted if len(found) >= TRIED), np.empty((0, 0)))[:TRIED]
    if not len(some):
        return
    places = np.zeros((TRIED, 2), np.int64)
    for product in slow:
        product.measure(cube.wavelength_nm, some[:1], places[:1])
    begun = time.perf_counter()
    for product in slow:
        product.measure(cube.wavelength_nm, some, places)
    each = (time.perf_counter() - begun) / TRIED
    count = region.shape[0] * region.shape[1]
    hours = each * count / 3600
    told = (
        f"{60 * hours:.0f} minutes" if hours < 2 else f"{hours:.0f} hours" if hours < 48 else f"{hours / 24:.0f} days"
    )
    if hours > LONG_HOURS:
        names = " and ".join(product.name for product in slow)
        message = f"{names}: {each:.2g} s a pixel, about {told} for {count:,} pixels on one core; `every` makes it less"
        warn(message)


def _nothing(layer: Layer) -> Any:
    """What a layer has where nothing was measured."""
    return np.nan if not layer.meanings else np.uint8(0) if layer.bits else np.int16(NO_CODE)


class Tally:
    """Counts and samples of what goes through it, for the summary."""

    def __init__(self, layers: Sequence[Layer], shape: tuple[int, int]) -> None:
        self.layers, self.step = layers, max(1, -(-shape[0] * shape[1] // SAMPLED))
        self.parts: dict[str, list[Any]] = {layer.name: [] for layer in layers if not layer.meanings}
        self.codes: dict[str, dict[str, int]] = {
            layer.name: dict.fromkeys(layer.meanings, 0) for layer in layers if layer.meanings
        }
        self.pixels = 0

    def through(self, blocks: Iterator[tuple[range, Mapping[str, Any]]]) -> Iterator[tuple[range, Mapping[str, Any]]]:
        """The same blocks."""
        for rows, arrays in blocks:
            self._add(arrays)
            yield rows, arrays

    def _add(self, arrays: Mapping[str, Any]) -> None:
        kept = (arrays[FLAG_LAYER].ravel() & LEFT_OUT) == 0
        some = np.flatnonzero(kept)[:: self.step]
        self.pixels += int(kept.sum())
        for layer in self.layers:
            values = arrays[layer.name].ravel()
            if not layer.meanings:
                self.parts[layer.name].append(values[some])
                continue
            for k, name in enumerate(layer.meanings):
                hit = (values & (1 << k)) != 0 if layer.bits else values == k
                self.codes[layer.name][name] += int(np.count_nonzero(hit if name == "left_out" else hit & kept))

    def counts(self) -> dict[str, int]:
        """Pixels that were wanted, and how many of them have each flag."""
        return {"pixels": self.pixels, **self.codes[FLAG_LAYER]}

    def values(self) -> dict[str, Any]:
        """Those of the sampled pixels, by layer."""
        return {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in self.parts.items()}
