"""Maps on disk: NetCDF after the CF conventions, or GeoTIFF, written block by block."""

import errno
import json
import os
import shutil
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import warn
from lunarsci.spectra.cubes.cube import FLAGS, LEFT_OUT, NO_DATA, Cube, PixelFrame
from lunarsci.spectra.cubes.rasters import optional
from lunarsci.spectra.cubes.regions import MOON_LONGLAT, Region

SUFFIXES = {".nc": "netcdf", ".tif": "geotiff", ".tiff": "geotiff"}
CONVENTIONS = "CF-1.11"
NO_CODE = -1
FLAG_LAYER = "pixel_flags"
Block = tuple[range, Mapping[str, npt.NDArray[Any]]]


@dataclass(frozen=True, slots=True)
class Layer:
    """One number of every pixel of a map: a value with a unit, or a code with the meaning of each.

    `meanings` : of the codes 0, 1, 2, …; with `bits`, of the bits 1, 2, 4, ….
    """

    name: str
    long_name: str
    units: str = "1"
    meanings: tuple[str, ...] = ()
    bits: bool = False
    standard_name: str = ""

    @property
    def dtype(self) -> str:
        """Of the file, where values are written in full precision."""
        return ("u1" if self.bits else "i2") if self.meanings else "f8"


def backplane_layers(cube: Cube) -> list[Layer]:
    """What further numbers of its pixels a map takes over from a cube."""
    placed = ("longitude", "latitude")
    return [
        Layer(name, plane.long_name, plane.units, standard_name=name if name in placed else "")
        for name, plane in cube.backplanes.items()
    ]


PIXEL_FLAGS = Layer(FLAG_LAYER, "what to know about the pixel", meanings=FLAGS, bits=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFile:
    """What a map is made of, beside its numbers.

    Attributes
    ----------
    layers : of the map; every block has an array of (rows, samples) for each.
    title, provenance : one line, and a document.
    single : whether values are written with 24 bits instead of 53.
    """

    cube: Cube
    region: Region
    layers: Sequence[Layer]
    title: str
    provenance: Mapping[str, Any]
    single: bool = False

    @property
    def frame(self) -> PixelFrame | None:
        """Where the pixels of the map lie."""
        if self.cube.frame is None:
            return None
        return self.cube.frame.part(self.region.lines[0], self.region.samples[0], self.region.step)

    @property
    def picked(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """Lines and samples of the cube."""
        return tuple(  # type: ignore[return-value]
            np.arange(first, last, self.region.step, dtype=np.int32)
            for first, last in (self.region.lines, self.region.samples)
        )

    def dtype(self, layer: Layer) -> str:
        """Type of a layer in the file."""
        return "f4" if self.single and not layer.meanings else layer.dtype

    def attributes(self) -> dict[str, str]:
        """Of the file: what it is, and what it was made from."""
        return {
            "Conventions": CONVENTIONS,
            "title": self.title,
            "source": f"lunarsci {self.provenance.get('version', '')}: {self.cube.name} ({self.cube.format})",
            "history": " ".join(str(self.provenance.get(key, "")) for key in ("time_utc", "command")).strip(),
            "references": "; ".join(self.provenance.get("sources", ())),
            "provenance": json.dumps(self.provenance, sort_keys=True, ensure_ascii=False),
        }

    def write(self, path: Path, suffix: str, blocks: Iterable[Block]) -> None:
        """Write the file in the format of a suffix, in the order of the blocks, which is that of their rows.

        Raises OSError where there is no room for it, before it is begun: HDF5 breaks down on a disk that becomes full.
        """
        waiting = iter(blocks)
        blocks = chain(list(islice(waiting, 1)), waiting)  # blocks that are kept are all made before the first comes
        if shutil.disk_usage(path.parent).free < self._bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        {"netcdf": self._netcdf, "geotiff": self._geotiff}[SUFFIXES[suffix.lower()]](path, blocks)

    @property
    def _bytes(self) -> int:
        """What its numbers take on a disk, which are not packed."""
        lines, samples = self.region.shape
        return lines * samples * sum(np.dtype(self.dtype(layer)).itemsize for layer in self.layers)

    def _netcdf(self, path: Path, blocks: Iterable[Block]) -> None:
        """Write the map as NetCDF, block by block."""
        h5netcdf, _ = map(optional, ("h5netcdf", "h5py"))
        with h5netcdf.File(path, "w") as file:
            file.attrs.update(self.attributes())
            dims = ("y", "x") if self.frame is not None and not self.frame.rotated else ("line", "sample")
            file.dimensions = dict(zip(dims, self.region.shape, strict=True))
            links = _coordinates(file, self, dims)
            for layer in self.layers:
                _netcdf_layer(file, layer, self.dtype(layer), dims, links)
        with optional("h5py").File(path, "r+") as file:
            written = [(file[layer.name], layer.name, self.dtype(layer)) for layer in self.layers]
            for rows, arrays in blocks:
                for values, name, dtype in written:
                    values[rows.start : rows.stop] = np.ascontiguousarray(arrays[name], dtype)

    def _geotiff(self, path: Path, blocks: Iterable[Block]) -> None:
        """Write the map as GeoTIFF, block by block, a band for each layer."""
        rasterio = optional("rasterio")
        from rasterio.windows import Window

        lines, samples = self.region.shape
        kind = "float32" if self.single else "float64"
        with closing(
            rasterio.open(
                path, "w", driver="GTiff", width=samples, height=lines, count=len(self.layers), dtype=kind,
                nodata=np.nan, interleave="band", BIGTIFF="IF_SAFER", **_georeference(self.frame),
            )
        ) as file:  # fmt: skip
            file.update_tags(**self.attributes())
            for number, layer in enumerate(self.layers, 1):
                file.set_band_description(number, layer.name)
                file.set_band_unit(number, layer.units if layer.units != "1" else "")
                file.update_tags(number, long_name=layer.long_name, **_flag_attributes(layer))
            for rows, arrays in blocks:
                window = Window(0, rows.start, samples, len(rows))
                for number, layer in enumerate(self.layers, 1):
                    file.write(_as_float(arrays[layer.name], layer).astype(kind), number, window=window)


def _georeference(frame: PixelFrame | None) -> dict[str, Any]:
    """rasterio's arguments for where pixels lie."""
    if frame is None:
        return {}
    from rasterio.crs import CRS
    from rasterio.transform import Affine

    crs = {"crs": CRS.from_wkt(frame.crs_wkt)} if frame.crs_wkt else {}
    return {"transform": Affine(*frame.transform), **crs}


def _flag_attributes(layer: Layer) -> dict[str, Any]:
    """Codes and their meanings, as CF names them."""
    if not layer.meanings:
        return {}
    values = [1 << k for k in range(len(layer.meanings))] if layer.bits else list(range(len(layer.meanings)))
    return {"flag_masks" if layer.bits else "flag_values": values, "flag_meanings": " ".join(layer.meanings)}


def _as_float(values: npt.NDArray[Any], layer: Layer) -> FloatArray:
    """Values of a layer as floats, NaN where there is no code."""
    result = values.astype(float)
    if layer.meanings and not layer.bits:
        result[values == NO_CODE] = np.nan
    return result


def _netcdf_layer(file: Any, layer: Layer, dtype: str, dims: tuple[str, str], links: Mapping[str, str]) -> None:
    """An empty variable for a layer, with its attributes; `links` say where its pixels lie."""
    fill: Any = np.nan if dtype.startswith("f") else None if layer.bits else NO_CODE
    variable = file.create_variable(layer.name, dims, dtype=dtype, fillvalue=fill)
    variable.attrs["long_name"] = layer.long_name
    if not layer.meanings:
        variable.attrs["units"] = layer.units
    if layer.standard_name:
        variable.attrs["standard_name"] = layer.standard_name
        return
    for key, value in _flag_attributes(layer).items():
        variable.attrs[key] = np.array(value, dtype=dtype) if isinstance(value, list) else value
    for key, value in links.items():
        variable.attrs[key] = value


def _coordinates(file: Any, made: MapFile, dims: tuple[str, str]) -> dict[str, str]:
    """Write where pixels lie; what layers must name to be placed there."""
    for name, along, picked in zip(("line", "sample"), dims, made.picked, strict=True):
        index = file.create_variable(f"cube_{name}", (along,), data=picked)
        index.attrs["long_name"] = f"{name} of the cube, from 0"
        index.attrs["units"] = "1"
    links: dict[str, str] = {}
    frame, (lines, samples) = made.frame, made.region.shape
    if frame is not None:
        links["grid_mapping"] = "crs"
        _grid_mapping(file, frame)
        if not frame.rotated:
            a, _, c, _, e, f = frame.transform
            geographic = is_geographic(frame)
            for name, values in (("x", c + a * (np.arange(samples) + 0.5)), ("y", f + e * (np.arange(lines) + 0.5))):
                axis = file.create_variable(name, (name,), data=values)
                axis.attrs["axis"] = name.upper()
                axis.attrs.update(_axis_names(name, geographic))
    places = _places_of(made)
    for name, values in places.items():
        plane = file.create_variable(name, dims, data=values)
        plane.attrs["standard_name"], plane.attrs["long_name"] = name, name
        plane.attrs["units"] = "degrees_east" if name == "longitude" else "degrees_north"
    located = [layer.name for layer in made.layers if layer.standard_name]
    if places or located:
        links["coordinates"] = " ".join([*places, *located])
    return links


def _axis_names(name: str, geographic: bool) -> dict[str, str]:
    if geographic:
        names = {"x": ("longitude", "degrees_east"), "y": ("latitude", "degrees_north")}
        return {"standard_name": names[name][0], "units": names[name][1]}
    return {"standard_name": f"projection_{name}_coordinate", "units": "m"}


def is_geographic(frame: PixelFrame) -> bool:
    """Whether x and y are longitude and latitude."""
    from rasterio.crs import CRS

    return bool(frame.crs_wkt) and bool(CRS.from_wkt(frame.crs_wkt).is_geographic)


def _grid_mapping(file: Any, frame: PixelFrame) -> None:
    """The coordinate system as well-known text, with the six numbers that GDAL looks for."""
    mapping = file.create_variable("crs", (), dtype="i4")
    a, b, c, d, e, f = frame.transform
    mapping.attrs["GeoTransform"] = " ".join(repr(float(value)) for value in (c, a, b, f, d, e))
    if frame.crs_wkt:
        mapping.attrs["crs_wkt"] = mapping.attrs["spatial_ref"] = frame.crs_wkt
        if is_geographic(frame):
            mapping.attrs["grid_mapping_name"] = "latitude_longitude"


def _places_of(made: MapFile) -> dict[str, FloatArray]:
    """Longitude and latitude of each pixel of a rotated frame, where no x and y can say it. (rows, samples)"""
    if made.frame is None or not made.frame.rotated or not made.frame.crs_wkt:
        return {}
    from rasterio.crs import CRS
    from rasterio.warp import transform

    rows, columns = (np.arange(size, dtype=float) for size in made.region.shape)
    x, y = made.frame.middles(rows[:, None], columns[None, :])
    system = CRS.from_wkt(made.frame.crs_wkt)
    target = CRS.from_wkt(system.to_wkt()) if system.is_geographic else _globe_of(system)
    longitude, latitude = transform(system, target, x.ravel().tolist(), y.ravel().tolist())
    shape = made.region.shape
    return {"longitude": np.reshape(longitude, shape), "latitude": np.reshape(latitude, shape)}


def _globe_of(system: Any) -> Any:
    """Longitude and latitude on the body that a projected system lies on."""
    from rasterio.crs import CRS

    text = system.to_proj4().split()
    ball = [part for part in text if part.startswith(("+R=", "+a=", "+b=", "+ellps=", "+datum="))]
    return CRS.from_proj4(" ".join(["+proj=longlat", *ball, "+no_defs"]) if ball else MOON_LONGLAT)


SAMPLED = 20_000
"""Pixels that medians in the summary are taken from."""
TRIED = 3
"""Pixels that are measured to say what all will take."""
LONG_HOURS = 1 / 60
"""What takes longer is said before it begins."""


class Product(ABC):
    """Some layers that are measured together; it goes to other processes, so it is small."""

    name: ClassVar[str]

    reasons: ClassVar[Sequence[str]] = ()
    """Layers of codes, or ends of their names, that say why a pixel has no value."""
    instead: ClassVar[str] = ""
    """What leads on where no pixel has a value."""

    @property
    def slow(self) -> bool:
        """Whether it works on one spectrum after the other."""
        return False

    @property
    def layers(self) -> Sequence[Layer]:
        """What it measures."""
        return ()

    @property
    def tables(self) -> Sequence[str]:
        """Tables of lunarsci that it reads."""
        return ()

    @property
    def sources(self) -> Sequence[str]:
        """What to cite."""
        return ()

    def lacking(self, wavelength_nm: FloatArray) -> str:
        """Why no spectrum of these channels (c,) [nm] has a value; '' where one may."""
        return ""

    @abstractmethod
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
    flags[~region.wanted(cube, rows)] |= LEFT_OUT
    planes = {
        name: plane.read(lines, samples)[:: region.step, :: region.step] for name, plane in cube.backplanes.items()
    }
    return {"first": rows.start, "reflectance": reflectance, "flags": flags, "planes": planes}


def measured(products: Sequence[Product], wavelength_nm: Any, block: Mapping[str, Any]) -> dict[str, Any]:
    """Every layer of a block, (rows, samples)."""
    flags, shape = block["flags"], block["flags"].shape
    wanted = (flags & (NO_DATA | LEFT_OUT)) == 0
    result: dict[str, Any] = {FLAG_LAYER: flags, **block["planes"]}
    reflectance, places = block["reflectance"][wanted], np.argwhere(wanted) + np.array([block["first"], 0])
    for product in products:
        values = product.measure(wavelength_nm, reflectance, places) if len(reflectance) else {}
        for layer in product.layers:
            whole = np.full(shape, _nothing(layer))
            if layer.name in values:
                whole[wanted] = values[layer.name]
            result[layer.name] = whole
    return result


def warn_of_cost(products: Sequence[Product], cube: Cube, region: Region) -> None:
    """Measure a few pixels of products that take long and say what all would take, as a LunarSciWarning."""
    slow = [product for product in products if product.slow]
    if not slow:
        return
    rows = (region.shape[0] * k // 4 for k in (2, 1, 3, 0))
    blocks = (fetched(cube, region, range(row, row + 1)) for row in rows)
    wanted = (block["reflectance"][(block["flags"] & (NO_DATA | LEFT_OUT)) == 0] for block in blocks)
    some = next((result for result in wanted if len(result) >= TRIED), np.empty((0, 0)))[:TRIED]
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
    duration = (
        f"{60 * hours:.0f} minutes" if hours < 2 else f"{hours:.0f} hours" if hours < 48 else f"{hours / 24:.0f} days"
    )
    if hours > LONG_HOURS:
        names = " and ".join(product.name for product in slow)
        message = (
            f"{names}: {each:.2g} s a pixel, about {duration} for {count:,} pixels on one core; `every` makes it less"
        )
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
        self.pixels, self.determined = 0, dict.fromkeys(self.parts, 0)

    def through(self, blocks: Iterator[tuple[range, Mapping[str, Any]]]) -> Iterator[tuple[range, Mapping[str, Any]]]:
        """The same blocks."""
        for rows, arrays in blocks:
            self._add(arrays)
            yield rows, arrays

    def _add(self, arrays: Mapping[str, Any]) -> None:
        """Count a block, and keep some of its values."""
        retained = (arrays[FLAG_LAYER].ravel() & LEFT_OUT) == 0
        some = np.flatnonzero(retained)[:: self.step]
        self.pixels += int(retained.sum())
        for layer in self.layers:
            values = arrays[layer.name].ravel()
            if not layer.meanings:
                self.determined[layer.name] += int(np.isfinite(values[retained]).sum())
                self.parts[layer.name].append(values[some])
                continue
            for k, name in enumerate(layer.meanings):
                hit = (values & (1 << k)) != 0 if layer.bits else values == k
                self.codes[layer.name][name] += int(np.count_nonzero(hit if name == "left_out" else hit & retained))

    def counts(self) -> dict[str, int]:
        """Pixels that were wanted, and how many of them have each flag."""
        return {"pixels": self.pixels, **self.codes[FLAG_LAYER]}

    def values(self) -> dict[str, Any]:
        """Those of the sampled pixels, by layer."""
        return {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in self.parts.items()}
