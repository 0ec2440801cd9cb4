"""What goes through a map: blocks of rows as they are read, their layers as they are measured, and a tally of them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.cubes.cube import LEFT_OUT, NO_DATA, Cube
from lunarsci.spectra.cubes.output import FLAG_LAYER, NO_CODE, Layer
from lunarsci.spectra.cubes.regions import Region

SAMPLED = 20_000
"""Pixels that medians in the summary are taken from."""


class Product(Protocol):
    """Some layers that are measured together; it goes to other processes, so it is small."""

    @property
    def layers(self) -> Sequence[Layer]:
        """What it measures."""

    @property
    def tables(self) -> Sequence[str]:
        """Tables of lunarsci that it reads."""

    @property
    def sources(self) -> Sequence[str]:
        """What to cite."""

    def measure(self, wavelength_nm: FloatArray, reflectance: FloatArray) -> Mapping[str, Any]:
        """Each layer, (n,), of spectra (n, c) with NaN in channels that cannot be used."""


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
    return {"reflectance": reflectance, "flags": flags, "planes": planes}


def measured(products: Sequence[Product], wavelength_nm: Any, block: Mapping[str, Any]) -> dict[str, Any]:
    """Every layer of a block, (rows, samples)."""
    flags, shape = block["flags"], block["flags"].shape
    wanted = (flags & (NO_DATA | LEFT_OUT)) == 0
    found: dict[str, Any] = {FLAG_LAYER: flags, **block["planes"]}
    reflectance = block["reflectance"][wanted]
    for product in products:
        values = product.measure(wavelength_nm, reflectance) if len(reflectance) else {}
        for layer in product.layers:
            whole = np.full(shape, NO_CODE, np.int16) if layer.meanings else np.full(shape, np.nan)
            if layer.name in values:
                whole[wanted] = values[layer.name]
            found[layer.name] = whole
    return found


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
