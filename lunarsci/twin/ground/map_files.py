"""Maps of a terrain as files: a NumPy archive, and a GeoTIFF with a band for each map."""

import io

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.twin.ground.hazards import Traversability

__all__ = ["maps_bytes", "maps_geotiff"]


def _layers(surface: Traversability) -> dict[str, npt.NDArray[np.float32]]:
    maps = surface.maps
    return {
        "slope_deg": maps.slope_deg,
        "roughness_m": maps.roughness_m,
        "step_m": maps.step_m,
        "demand": surface.demand,
    }


def maps_bytes(surface: Traversability) -> bytes:
    """NumPy archive: x_m (nx,), y_m (ny,), and slope_deg, roughness_m, step_m, demand (ny, nx), NaN where unknown."""
    archive = io.BytesIO()
    np.savez_compressed(archive, x_m=surface.terrain.x_m, y_m=surface.terrain.y_m, **_layers(surface))  # type: ignore[arg-type]
    return archive.getvalue()


def maps_geotiff(surface: Traversability) -> bytes:
    """GeoTIFF with the bands slope_deg, roughness_m, step_m and demand, in the coordinates of the terrain.

    It names no projection, because a terrain has none. Raises ParameterError without rasterio.
    """
    try:
        from rasterio.io import MemoryFile
        from rasterio.transform import from_origin
    except ImportError as error:
        raise ParameterError("GeoTIFF needs rasterio; pip install 'lunarsci[cubes]'") from error
    terrain, layers = surface.terrain, _layers(surface)
    half, (ny, nx) = 0.5 * terrain.spacing_m, terrain.height_m.shape
    west, north = terrain.x0_m - half, float(terrain.y_m[-1]) + half
    shape = {"driver": "GTiff", "count": len(layers), "dtype": "float32", "height": ny, "width": nx}
    place = {"transform": from_origin(west, north, terrain.spacing_m, terrain.spacing_m), "nodata": np.nan}
    with MemoryFile() as memory:
        with memory.open(**shape, **place, compress="deflate") as raster:
            for band, (name, values) in enumerate(layers.items(), start=1):
                raster.write(values[::-1], band)
                raster.set_band_description(band, name)
        content: bytes = memory.read()
    return content
