"""Maps on disk: NetCDF after the CF conventions, or GeoTIFF, written block by block."""

import errno
import json
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.cubes.cube import FLAGS, Cube, PixelFrame
from lunarsci.spectra.cubes.rasters import HINT
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
        try:
            import h5netcdf
        except ImportError as error:
            raise ParameterError(HINT) from error
        with h5netcdf.File(path, "w") as file:
            file.attrs.update(self.attributes())
            dims = ("y", "x") if self.frame is not None and not self.frame.rotated else ("line", "sample")
            file.dimensions = dict(zip(dims, self.region.shape, strict=True))
            links = _coordinates(file, self, dims)
            for layer in self.layers:
                _netcdf_layer(file, layer, self.dtype(layer), dims, links)
            for rows, arrays in blocks:
                for layer in self.layers:
                    values = file.variables[layer.name]
                    values[rows.start : rows.stop] = _stored(arrays[layer.name], self.dtype(layer))

    def _geotiff(self, path: Path, blocks: Iterable[Block]) -> None:
        try:
            import rasterio
            from rasterio.windows import Window
        except ImportError as error:
            raise ParameterError(HINT) from error
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
                file.update_tags(number, long_name=layer.long_name, **_told(layer))
            for rows, arrays in blocks:
                window = Window(0, rows.start, samples, len(rows))
                for number, layer in enumerate(self.layers, 1):
                    file.write(_as_float(arrays[layer.name], layer).astype(kind), number, window=window)


def _georeference(frame: PixelFrame | None) -> dict[str, Any]:
    if frame is None:
        return {}
    from rasterio.crs import CRS
    from rasterio.transform import Affine

    crs = {"crs": CRS.from_wkt(frame.crs_wkt)} if frame.crs_wkt else {}
    return {"transform": Affine(*frame.transform), **crs}


def _told(layer: Layer) -> dict[str, Any]:
    """Codes and their meanings, as CF names them."""
    if not layer.meanings:
        return {}
    values = [1 << k for k in range(len(layer.meanings))] if layer.bits else list(range(len(layer.meanings)))
    return {"flag_masks" if layer.bits else "flag_values": values, "flag_meanings": " ".join(layer.meanings)}


def _as_float(values: npt.NDArray[Any], layer: Layer) -> FloatArray:
    found = values.astype(float)
    if layer.meanings and not layer.bits:
        found[values == NO_CODE] = np.nan
    return found


def _stored(values: npt.NDArray[Any], dtype: str) -> npt.NDArray[Any]:
    return np.ascontiguousarray(values, dtype=dtype)


def _netcdf_layer(file: Any, layer: Layer, dtype: str, dims: tuple[str, str], links: Mapping[str, str]) -> None:
    fill: Any = np.nan if dtype.startswith("f") else None if layer.bits else NO_CODE
    variable = file.create_variable(layer.name, dims, dtype=dtype, fillvalue=fill)
    variable.attrs["long_name"] = layer.long_name
    if not layer.meanings:
        variable.attrs["units"] = layer.units
    if layer.standard_name:
        variable.attrs["standard_name"] = layer.standard_name
        return
    for key, value in _told(layer).items():
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
        known = {"x": ("longitude", "degrees_east"), "y": ("latitude", "degrees_north")}
        return {"standard_name": known[name][0], "units": known[name][1]}
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
