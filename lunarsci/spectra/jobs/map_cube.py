"""What is measured on one spectrum, on every pixel of an image cube, as a file of maps."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.errors import RequestError
from lunarsci.io.atomic import written_whole
from lunarsci.io.inputs import Source, expand_inputs
from lunarsci.io.tables import table_hashes
from lunarsci.memory import as_named, new_path
from lunarsci.names import some_of
from lunarsci.options import refuse_where, request_of
from lunarsci.parallel.blocks import blocks_in_order, rows_in_memory
from lunarsci.provenance import Provenance
from lunarsci.result import NOT_TO_BE_TRUSTED, Doubt, MadeFrom, Progress, Result, job
from lunarsci.spectra.cubes.cube import FLAGS, Cube, Stated
from lunarsci.spectra.cubes.output import (
    PIXEL_FLAGS,
    SUFFIXES,
    Layer,
    MapFile,
    Product,
    Tally,
    backplane_layers,
    fetched,
    measured,
    warn_of_cost,
)
from lunarsci.spectra.cubes.rasters import open_cube
from lunarsci.spectra.cubes.regions import region_of
from lunarsci.spectra.jobs.map_products import minerals_of, products_of
from lunarsci.spectra.jobs.requests import MOST_ROWS, ROWS, MapRequest

if TYPE_CHECKING:
    import numpy.typing as npt
    from matplotlib.figure import Figure
    from xarray import Dataset


MOST_REASONS = 4
"""Reasons without a value that are named."""
BYTES_A_CHANNEL = 80
"""Memory of a pixel while it is worked on, for each channel and layer: reflectance and its copies; measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CubeMap(Result):
    """A map that was written, and what is in it.

    Attributes
    ----------
    path : of the file.
    request, products : what was asked.
    counts : pixels that were wanted, and those with each flag.
    codes : by layer of codes, pixels with each of its codes.
    made : what the file was made of.
    determined : by layer of values, pixels that have one.
    sampled : the same, the values of some pixels evenly spread over the map, NaN where not determined.
    """

    schema = "spectra-map/1"
    path: Path
    made: MapFile
    request: MapRequest
    products: Sequence[Product]
    counts: Mapping[str, int]
    codes: Mapping[str, Mapping[str, int]]
    determined: Mapping[str, int]
    sampled: Mapping[str, Any] = field(repr=False)

    @property
    def made_from(self) -> MadeFrom:
        return made_from(self.made.cube, self.products)

    @property
    def doubt(self) -> Doubt:
        if self.counts["pixels"] <= self.counts["no_data"]:
            return Doubt.of("no pixel of the region has a channel that can be used", verdict=NOT_TO_BE_TRUSTED)
        values = [(one, [layer.name for layer in one.layers if not layer.meanings]) for one in self.products]
        without = (one for one, names in values if not any(self.determined[name] for name in names))
        return Doubt.of(*map(self._why_without, without), verdict=NOT_TO_BE_TRUSTED)

    def _why_without(self, product: Product) -> str:
        """That no pixel has a value of a product, how many there are of each reason, and what leads on."""
        counts = {name: {code: n for code, n in self.codes[name].items() if n} for name in product.reasons}
        reasons = [f"{name} {code} in {n} of {self.counts['pixels']} pixels" for name, codes in counts.items()
                   for code, n in codes.items()]  # fmt: skip
        why = product.lacking(self.made.cube.wavelength_nm) or some_of(reasons, MOST_REASONS)
        return "; ".join(filter(None, (f"no pixel has a value of {product.name}", why, product.instead)))

    def to_dict(self) -> dict[str, Any]:
        return {
            "cube": cube_record(self.made.cube),
            "map": {
                "file": str(self.path),
                "lines": self.made.region.shape[0],
                "samples": self.made.region.shape[1],
                "first_line": self.made.region.lines[0],
                "first_sample": self.made.region.samples[0],
                "every": self.made.region.step,
            },
            "pixels": dict(self.counts),
            "unmix": unmix_record(self.request),
            "layers": self.rows(),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One a layer: of values the share of pixels that has one, and quantiles of a sample."""
        return [self._row(layer) for layer in self.made.layers]

    def _row(self, layer: Layer) -> dict[str, Any]:
        kind = "value" if not layer.meanings else "bits" if layer.bits else "code"
        row: dict[str, Any] = {"name": layer.name, "long_name": layer.long_name, "units": layer.units, "kind": kind}
        seen = self.sampled.get(layer.name)
        finite = np.empty(0) if seen is None else seen[np.isfinite(seen)]
        low, median, high = np.quantile(finite, (0.05, 0.5, 0.95)) if finite.size else (None, None, None)
        share = finite.size / seen.size if seen is not None and seen.size else None
        codes = " ".join(f"{name}={count}" for name, count in self.codes.get(layer.name, {}).items() if count)
        return row | {"determined": share, "p05": low, "median": median, "p95": high, "codes": codes}

    def layers(self) -> dict[str, Any]:
        """Of the written file, lines and samples as of the cube; all of it is read."""
        from lunarsci.spectra.cubes.figure import pixels_of

        region, whole = self.made.region, (slice(None), slice(None))
        firsts = zip(("line", "sample"), (region.lines[0], region.samples[0]), region.shape, strict=True)
        axes: dict[str, Any] = {
            name: ((name,), first + region.step * np.arange(count)) for name, first, count in firsts
        }
        if (frame := self.made.frame) and not frame.rotated:
            lines, samples = (np.arange(count, dtype=float) for count in region.shape)
            axes["y"] = ("line",), frame.middles(lines, 0 * lines)[1]
            axes["x"] = ("sample",), frame.middles(0 * samples, samples)[0]
        names = [layer.name for layer in self.made.layers]
        return axes | {n: (("line", "sample"), pixels_of(self.path, n, k, whole)) for k, n in enumerate(names, 1)}

    def to_xarray(self) -> "Dataset":
        """All layers as a Dataset; with the places of lines and samples, `y` and `x`, where the cube has such."""
        made = super().to_xarray()
        return made.set_coords([name for name in ("y", "x") if name in made])

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.spectra.cubes.figure import map_pages

        return map_pages(self.path, self.to_dict())


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelSpectrum(Result):
    """The spectrum of one pixel, as a table that every other job reads."""

    schema = "spectra-pixel/1"
    cube: Cube
    line: int
    sample: int
    reflectance: Any = field(repr=False)
    flags: Sequence[str] = ()
    places: Mapping[str, float] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """Such as `M3G20090203T175131_V01_RFL x10 y250`."""
        return f"{Path(self.cube.name).stem} x{self.sample} y{self.line}"

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(inputs=self.cube.inputs)

    def to_dict(self) -> dict[str, Any]:
        return {
            "id": self.id,
            "cube": cube_record(self.cube),
            "line": self.line,
            "sample": self.sample,
            "flags": list(self.flags),
            **self.places,
            "wavelength_nm": self.cube.wavelength_nm.tolist(),
            "reflectance": self.reflectance.tolist(),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One a channel; no reflectance where the channel cannot be used."""
        pairs = zip(self.cube.wavelength_nm.tolist(), self.reflectance.tolist(), strict=True)
        return [{"wavelength_nm": wavelength, self.id: value} for wavelength, value in pairs]


@job
def map_cube(
    cube: "Source | tuple[npt.ArrayLike, npt.ArrayLike]", path: str | Path | None = None,
    request: MapRequest | None = None, *, force: bool = False, time: bool = True, progress: Progress | None = None,
    **options: Any,
) -> CubeMap:  # fmt: skip
    """Measure every wanted pixel of a cube and write the maps.

    Parameters
    ----------
    cube : ENVI data file or header, M3 reflectance, GeoTIFF, NetCDF or VNIS product; an array of xarray with a
        coordinate of wavelengths; or (wavelength_nm (n,), reflectance (lines, samples, n)).
    path : of the maps, `.nc` (NetCDF, CF conventions) or `.tif` (GeoTIFF); None for a file that is there until the
        process ends, whose maps `to_xarray()` has.
    request, options : what is asked, and options of `MapRequest` that replace its own.
    force : whether a file that exists is replaced.
    time : whether the file says when it was made; without it equal runs give equal bytes.
    progress : called with (done, total) lines.

    Raises
    ------
    RequestError for options that exclude each other; DataError for a cube that cannot be used; OutputError.

    Examples
    --------
    >>> maps = lunarsci.map_cube("lunarsci-demo/*VD_SCI*.2B", products="indices", every=16).to_xarray()
    """
    asked, target = request_of(MapRequest, request, options), new_path("map.nc") if path is None else Path(path)
    if target.suffix.lower() not in SUFFIXES:
        named = f" '{target.name}'" if target.name else ""
        raise RequestError(f"`path`{named}: a map is a file; give a name that ends in {', '.join(SUFFIXES)}")
    names = expand_inputs([str(cube)])
    refuse_where({f"`cube` {cube} is {len(names)} files; give one": len(names) > 1})
    image = open_cube(names[0], stated_of(asked))
    region = region_of(image, asked.roi, asked.mask, asked.every)
    products = products_of(asked)
    layers = [PIXEL_FLAGS, *backplane_layers(image), *(layer for product in products for layer in product.layers)]
    made = made_from(image, products)
    chosen = asdict(asked)
    record = Provenance(
        command="lunarsci spectra map", options=chosen, inputs=made.inputs, tables=made.tables, sources=made.sources
    ).to_dict(time=time)
    file = MapFile(
        cube=image, region=region, layers=layers, title=f"maps of {Path(image.name).name}", provenance=record,
        single=asked.single_precision,
    )  # fmt: skip
    cost = BYTES_A_CHANNEL * (image.wavelength_nm.size + len(layers)) * region.shape[1]
    warn_of_cost(products, image, region)
    rows = max(ROWS, rows_in_memory(cost, most=MOST_ROWS) // ROWS * ROWS)
    blocks = blocks_in_order(
        partial(measured, products, image.wavelength_nm),
        region.shape[0],
        rows,
        stage="map",
        about={f"option {key}": str(value) for key, value in chosen.items()}
        | {f"input {name}": digest for name, digest in made.inputs.items()},
        fetch=partial(fetched, image, region),
        progress=progress,
    )
    tally = Tally(layers, region.shape)
    with written_whole(target, force=force) as name:
        file.write(Path(name), target.suffix, tally.through(blocks))
    return CubeMap(
        path=target, made=file, request=asked, products=products,
        counts=tally.counts(), codes=tally.codes, determined=tally.determined, sampled=tally.values(),
    )  # fmt: skip


def pixel(cube: str, place: str, request: MapRequest | None = None, **options: Any) -> PixelSpectrum:
    """One pixel of a cube as a spectrum, what `map_cube` measures there; `place` is `X,Y`, sample and line from 0.

    Raises RequestError for a place that is none, or beside the cube.
    """
    asked = request_of(MapRequest, request, options)
    image = open_cube(str(cube), stated_of(asked))
    lines, samples = image.shape
    numbers = re.fullmatch(r"\s*(\d{1,9})\s*,\s*(\d{1,9})\s*", place)
    sample, line = (int(numbers[1]), int(numbers[2])) if numbers else (-1, -1)
    if not (0 <= sample < samples and 0 <= line < lines):
        raise RequestError(
            f"`spectrum` {place}: give sample and line; the cube has samples 0 to {samples - 1} and lines 0 to "
            f"{lines - 1}"
        )
    at = slice(line, line + 1), slice(sample, sample + 1)
    reflectance, flags = image.read(*at)
    places = {
        f"{name}_deg": float(plane.read(*at)[0, 0])
        for name, plane in image.backplanes.items()
        if name in ("longitude", "latitude")
    }
    names = [name for k, name in enumerate(FLAGS) if flags[0, 0] & np.uint8(1 << k)]
    return PixelSpectrum(
        cube=image, line=line, sample=sample, reflectance=reflectance[0, 0], flags=names, places=places
    )


def made_from(cube: Cube, products: Sequence[Product]) -> MadeFrom:
    """Inputs, tables and sources of a map."""
    tables = table_hashes(*dict.fromkeys(table for product in products for table in product.tables))
    return MadeFrom(inputs=cube.inputs, tables=tables, sources=[text for one in products for text in one.sources])


def unmix_record(request: MapRequest) -> dict[str, Any] | None:
    """How shares of a map were found, for `--json`; None where there are none."""
    if "unmix" not in request.wanted:
        return None
    return {"method": "learned", "both": request.both, "minerals": minerals_of(request)}


def cube_record(cube: Cube) -> dict[str, Any]:
    """What is known of a cube, for `--json`."""
    return {
        "file": as_named(cube.name),
        "format": cube.format,
        "lines": cube.shape[0],
        "samples": cube.shape[1],
        "channels": int(cube.wavelength_nm.size),
        "bad_channels": int(cube.bad.sum()),
        "first_nm": float(cube.wavelength_nm[0]),
        "last_nm": float(cube.wavelength_nm[-1]),
        "georeference": "frame" if cube.frame else "pixels" if "longitude" in cube.backplanes else None,
        "remarks": list(cube.remarks),
    }


def stated_of(request: MapRequest) -> Stated:
    """What is said of the cube."""
    return Stated(
        wavelength_unit=request.wavelength_unit,
        scale=request.scale,
        ignored=request.ignore,
        saturated=request.saturated,
        wavelengths=request.wavelengths,
        locations=request.locations,
    )
