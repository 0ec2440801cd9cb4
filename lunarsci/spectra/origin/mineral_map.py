"""Composition of craters' ejecta from mineral maps: a GeoTIFF of one mineral, or what `spectra map` wrote of several.

Each map is read at points spread evenly, by area, over the ring of ejecta around the rim; their mean and standard
deviation are those of the mineral there. Works for maps in degrees (-180 to 180 or 0 to 360, also across the seam) and
for projected ones.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import DataError, ParameterError
from lunarsci.minerals import WITH_BANDS
from lunarsci.ranges import check_range
from lunarsci.spectra.cubes.rasters import HDF, netcdf, opened, start_of
from lunarsci.spectra.origin.catalogue import Crater, destination
from lunarsci.spectra.origin.composition import LARGEST_SUM, Composition

if TYPE_CHECKING:
    from rasterio.io import DatasetReader


ANNULUS = (1.0, 2.0)
"""Ring of ejecta, in rim radii from the centre, within the continuous blanket, which reaches to some 2.3: Moore, Hodges
& Scott (1974), Proc. Lunar Sci. Conf. 5, 71."""
RINGS, SPOKES = 64, 256
FEWEST_VALID = 50
"""Points with a value below which a ring is taken as empty; assumed."""
LARGEST_SIDE = 4096
"""A window with more pixels a side than this is read at a lower resolution."""
LONGITUDE_LATITUDE = f"+proj=longlat +R={1e3 * MOON_RADIUS_KM:.0f} +no_defs"
LAYER = "share_{}"
"""Name of the layer of a mineral in what `spectra map` writes."""


@dataclass(frozen=True, slots=True)
class MapReport:
    """What the maps gave for one crater: the share of the ring with values by mineral, and a sentence."""

    crater: str
    covered: Mapping[str, float]
    status: str


def with_maps(
    craters: Sequence[Crater], maps: Mapping[str, str], annulus: tuple[float, float] = ANNULUS
) -> tuple[list[Crater], list[MapReport]]:
    """The craters with modes from maps (mineral to GeoTIFF), where those cover them, and what was found for each.

    A crater keeps the catalogue's modes where fewer than two maps have values in its ring. Maps may be in fractions or
    percent. Raises ParameterError for unknown minerals, fewer than two maps, a ring that is none, or missing rasterio;
    DataError for files that cannot be read, 8-bit copies without a scale, several bands, and values that are no modes.
    """
    _check_request(maps, annulus)
    values: dict[str, list[FloatArray]] = {}
    for mineral, file in maps.items():
        with _rings_of(file, mineral) as ring:
            values[mineral] = [ring(crater, annulus) for crater in craters]
    units = {mineral: _unit(rings, maps[mineral]) for mineral, rings in values.items()}
    if len(set(units.values()) - {0.0}) > 1:
        raise DataError(f"{', '.join(maps.values())}: some are in percent, others in fractions; bring them to one unit")
    read = [
        _with_values(crater, {name: values[name][k] / (units[name] or 1.0) for name in values}, maps)
        for k, crater in enumerate(craters)
    ]
    return [crater for crater, _ in read], [report for _, report in read]


def _check_request(maps: Mapping[str, str], annulus: tuple[float, float]) -> None:
    if len(maps) < 2 or not maps.keys() <= set(WITH_BANDS):
        raise ParameterError(f"maps of {', '.join(maps)} give no shares; give two or more of {', '.join(WITH_BANDS)}")
    low, high = annulus
    check_range("start of the ring", low, "[0, 20]", "in rim radii")
    check_range("end of the ring", high, f"({low}, 20]", "in rim radii")


def minerals_of(file: str) -> list[str]:
    """Minerals whose shares are layers of a file that `spectra map` wrote. Raises DataError for another file."""
    names = layers_of(file)
    return [mineral for mineral in WITH_BANDS if LAYER.format(mineral) in names]


def layers_of(file: str) -> list[str]:
    """Names of the layers of a NetCDF file or a GeoTIFF, '' for none. Raises DataError for another file."""
    if start_of(file).startswith(HDF):
        return [str(name) for name in netcdf(file).data_vars]
    with opened(file, "GTiff") as dataset:
        return [name or "" for name in dataset.descriptions]


@contextmanager
def _rings_of(file: str, mineral: str) -> Iterator[Callable[[Crater, tuple[float, float]], FloatArray]]:
    """What reads a mineral's values in the ring of a crater."""
    if not start_of(file).startswith(HDF):
        with opened(file, "GTiff") as dataset:
            names = [name or "" for name in dataset.descriptions]
            layer = LAYER.format(mineral)
            band = names.index(layer) + 1 if layer in names else 1
            check_map(dataset, file, one_of_many=layer in names)
            yield partial(ring_values, dataset, file=file, band=band)
        return
    data, name = netcdf(file), LAYER.format(mineral)
    if name not in data.variables:
        raise DataError(f"{file}: has no layer {name}; make it with `lunarsci spectra map --products unmix`")
    if "longitude" in data.variables and "crs" not in data.variables:
        yield _Swath(data, name, file).ring_values
        return
    with opened(f'netcdf:"{file}":{name}', "netCDF") as dataset:
        check_map(dataset, file)
        yield partial(ring_values, dataset, file=file)


class _Swath:
    """A map whose pixels have each a longitude and a latitude, as those of an orbiter's strip have."""

    def __init__(self, data: Any, name: str, file: str) -> None:
        from scipy.spatial import cKDTree

        places = _on_sphere(*(np.asarray(data[key].values, float) for key in ("latitude", "longitude")))
        located = np.isfinite(places).all(axis=-1)
        if data[name].shape != located.shape or located.sum() < 2:
            raise DataError(f"{file}: fewer than two pixels have a longitude and a latitude; make it anew")
        self.values = np.asarray(data[name].values, float)[located]
        self.tree = cKDTree(places[located])
        spacings = (np.linalg.norm(np.diff(places, axis=axis), axis=-1) for axis in (0, 1) if places.shape[axis] > 1)
        self.reach = float(max(map(np.nanmedian, spacings)))

    def ring_values(self, crater: Crater, annulus: tuple[float, float]) -> FloatArray:
        """Those of the pixels that lie nearest, NaN where none is as near as pixels are to each other."""
        distance, nearest = self.tree.query(_on_sphere(*_ring(crater, annulus)), distance_upper_bound=self.reach)
        return np.where(np.isfinite(distance), np.append(self.values, np.nan)[nearest], np.nan)


def _on_sphere(latitude: FloatArray, longitude: FloatArray) -> FloatArray:
    """Unit vectors, (..., 3)."""
    up, along = np.radians(latitude), np.radians(longitude)
    return np.stack([np.cos(up) * np.cos(along), np.cos(up) * np.sin(along), np.sin(up)], axis=-1)


def check_map(dataset: "DatasetReader", file: str, *, one_of_many: bool = False) -> None:
    """Raise DataError for a raster that is no map of one quantity in physical units, or without a place on the Moon."""
    kind, plain = dataset.dtypes[0], dataset.scales[0] == 1 and dataset.offsets[0] == 0
    placed = dataset.crs is not None or (not dataset.transform.is_identity and _looks_like_degrees(dataset))
    faults = {
        f"has {dataset.count} bands; give a file with the one band of the mineral": dataset.count != 1
        and not one_of_many,
        "holds 8-bit numbers without a scale: a picture stretched for display, whose numbers are no modes; get the "
        "file with physical values, or set the band's scale and offset": kind in ("uint8", "int8") and plain,
        "holds complex numbers; a mode is a real one": kind.startswith("complex"),
        "puts all pixels on one line; correct its geotransform": dataset.transform.is_degenerate,
        "has no coordinate system, and no bounds in degrees; give one that says where on the Moon it lies": not placed,
    }
    for fault, there in faults.items():
        if there:
            raise DataError(f"{file}: {fault}")


def _looks_like_degrees(dataset: "DatasetReader") -> bool:
    left, bottom, right, top = dataset.bounds
    return bool(left >= -181 and right <= 361 and bottom >= -91 and top <= 91)


def ring_values(
    dataset: "DatasetReader", crater: Crater, annulus: tuple[float, float], file: str = "map", band: int = 1
) -> FloatArray:
    """Values (RINGS x SPOKES,) of a map in the ring around a crater; NaN for holes and beyond the map's edge."""
    latitude, longitude = _ring(crater, annulus)
    x, y = _map_coordinates(dataset, latitude, longitude, file)
    inverse = ~dataset.transform
    columns, rows = (inverse.a * x + inverse.b * y + inverse.c, inverse.d * x + inverse.e * y + inverse.f)
    return _pixels(dataset, columns, rows, band)


def _ring(crater: Crater, annulus: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Latitudes and longitudes of points spread evenly, by area, over the ring about a crater. [deg]"""
    radius = crater.diameter_km / 2
    inner, outer = (1 - np.cos(ring * radius / MOON_RADIUS_KM) for ring in annulus)
    middle = (np.arange(RINGS) + 0.5) / RINGS
    distance = MOON_RADIUS_KM * np.arccos(1 - (inner + (outer - inner) * middle))
    azimuth = (np.arange(SPOKES) + 0.5) * 360 / SPOKES
    return destination(crater.center, np.tile(azimuth, RINGS), np.repeat(distance, SPOKES))


def _map_coordinates(
    dataset: "DatasetReader", latitude: FloatArray, longitude: FloatArray, file: str
) -> tuple[FloatArray, FloatArray]:
    if dataset.crs is None or dataset.crs.is_geographic:
        left, right = dataset.bounds.left, dataset.bounds.right
        start = left if right - left > 359 else (left + right) / 2 - 180
        return (longitude - start) % 360 + start, latitude
    from rasterio.errors import RasterioError
    from rasterio.warp import transform

    try:
        x, y = transform(LONGITUDE_LATITUDE, dataset.crs, longitude.tolist(), latitude.tolist())
    except (RasterioError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{file}: its coordinate system is not one of the Moon's ({reason}); reproject it") from error
    return np.asarray(x, float), np.asarray(y, float)


def _pixels(dataset: "DatasetReader", columns: FloatArray, rows: FloatArray, band: int) -> FloatArray:
    """Values at fractional pixel positions; NaN outside and where there is no data. Reads only what is needed."""
    values = np.full(columns.shape, np.nan)
    inside = np.isfinite(columns) & np.isfinite(rows)
    inside &= (columns >= 0) & (columns < dataset.width) & (rows >= 0) & (rows < dataset.height)
    if not inside.any():
        return values
    across = np.ptp(columns[inside]) > dataset.width / 2
    sides = [columns < dataset.width / 2, columns >= dataset.width / 2] if across else [np.ones_like(inside)]
    for side in sides:
        chosen = inside & side
        if chosen.any():
            values[chosen] = _window_values(dataset, columns[chosen].astype(int), rows[chosen].astype(int), band)
    return values


def _window_values(
    dataset: "DatasetReader", columns: npt.NDArray[np.int_], rows: npt.NDArray[np.int_], band: int
) -> FloatArray:
    from rasterio.windows import Window

    left, top = int(columns.min()), int(rows.min())
    width, height = int(columns.max()) - left + 1, int(rows.max()) - top + 1
    shape = (min(height, LARGEST_SIDE), min(width, LARGEST_SIDE))
    block = dataset.read(band, window=Window(left, top, width, height), out_shape=shape, masked=True)
    values = np.ma.filled(block.astype(float), np.nan) * dataset.scales[band - 1] + dataset.offsets[band - 1]
    picked = values[(rows - top) * shape[0] // height, (columns - left) * shape[1] // width]
    # Special values that a file does not declare are far below 0; a mode is not.
    return np.asarray(np.where(np.isfinite(picked) & (picked >= 0), picked, np.nan))


def _unit(rings: Sequence[FloatArray], file: str) -> float:
    """100 for a map in percent, 1 for fractions, 0 where it has no values at all. Raises DataError for others."""
    values = np.concatenate(rings) if rings else np.empty(0)
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0
    largest = float(values.max())
    unit = 100.0 if largest > LARGEST_SUM else 1.0
    if largest > LARGEST_SUM * unit:
        raise DataError(f"{file}: has a value of {largest:g}; a mode is 0 to 1, or 0 to 100 percent")
    return unit


def _with_values(crater: Crater, rings: Mapping[str, FloatArray], maps: Mapping[str, str]) -> tuple[Crater, MapReport]:
    covered = {name: float(np.isfinite(values).mean()) for name, values in rings.items()}
    usable = [name for name, values in rings.items() if np.isfinite(values).sum() >= FEWEST_VALID]
    if len(usable) < 2:
        status = "the maps have no values in its ring; its catalogue entry stands"
        return crater, MapReport(crater.name, covered, status)
    modes = {name: (min(float(np.nanmean(rings[name])), 1.0), float(np.nanstd(rings[name], ddof=1))) for name in usable}
    try:
        composition = Composition(modes, crater.composition.bands)
    except ParameterError as error:
        raise DataError(f"{', '.join(maps.values())}: {crater.name}: {error}") from error
    sources = {**crater.sources, "composition": "maps: " + ", ".join(maps[name] for name in usable)}
    least = min(covered[name] for name in usable)
    status = f"modes of {', '.join(usable)} from the maps, {100 * least:.0f} % of its ring covered"
    return replace(crater, composition=composition, sources=sources), MapReport(crater.name, covered, status)
