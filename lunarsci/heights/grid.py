"""Heights on square cells of metres, as files of any kind say them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.heights.rasters import HEIGHT, HeightRaster

ERROR_LAYERS = ("height_m_sigma", "height_m_common_sigma", "count", "height_by_disparity_m_px", "resolution_m")
"""What an elevation model made of pictures has beside its heights."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightGrid:
    """What a file of heights says.

    Attributes
    ----------
    name : what the ground is.
    x0_m, y0_m, spacing_m : position of node [0, 0] and distance of the nodes. [m]
    height_m : NaN where unknown; row is y, column is x. (ny, nx) [m]
    layers : further numbers, one or one for each node, by name.
    synthetic : True for made-up ground.
    made_for : what else the file says, None where it says nothing.
    crs : the coordinate system of x and y as well-known text; empty where none is named.
    crs_of_file : that of the file, which may be another one.
    unit : of the heights, as the file states it; empty where it states none.
    read_as : how the file was read, where there was a choice.
    beside : files beside this one that were read.
    """

    name: str
    x0_m: float
    y0_m: float
    spacing_m: float
    height_m: FloatArray
    layers: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    synthetic: bool = False
    made_for: str | None = None
    crs: str = ""
    crs_of_file: str = ""
    unit: str = "m"
    read_as: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


def grid_of_raster(found: HeightRaster, *, onto: str, values: bool) -> HeightGrid:
    """The grid of a raster, on square cells of metres; `values` that are no heights are not interpolated."""
    raster, done = found.in_metres(onto, nearest=values)
    bands, across = dict(raster.bands), raster.transform
    y0 = across.f + 0.5 * across.e
    if across.e < 0:
        bands = {name: band[::-1] for name, band in bands.items()}
        y0 += across.e * (raster.shape[0] - 1)
    height = bands.pop(HEIGHT)
    for name in bands if raster is not found else ():
        if name not in ERROR_LAYERS:
            bands[name] = np.where(np.isnan(height), np.nanmedian(bands[name]), bands[name])
    return HeightGrid(
        name=Path(raster.path).stem,
        x0_m=across.c + 0.5 * across.a,
        y0_m=y0,
        spacing_m=float(across.a),
        height_m=height,
        layers=bands,
        synthetic=raster.synthetic,
        crs=raster.crs,
        crs_of_file=found.crs,
        unit=raster.unit,
        read_as=tuple(filter(None, (raster.said, done))),
        beside=raster.beside,
    )


def spacing_of(x: FloatArray, y: FloatArray) -> float:
    """The one distance of ascending nodes (nx,) and (ny,). Raises ValueError where there is none. [m]"""
    if x.ndim != 1 or y.ndim != 1 or min(x.size, y.size) < 3:
        raise ValueError("x_m and y_m must be lists of at least 3 numbers")
    steps = []
    for name, axis in (("x_m", x), ("y_m", y)):
        step = float(axis[-1] - axis[0]) / (axis.size - 1)
        if not (step > 0 and np.allclose(np.diff(axis), step, rtol=0, atol=1e-4 * step)):
            raise ValueError(f"{name} must ascend in even steps; sort it, or interpolate the heights to even ones")
        steps.append(step)
    if abs(steps[1] - steps[0]) > 1e-4 * steps[0]:
        told = f"cells must be square: steps are {steps[0]:g} m in x_m and {steps[1]:g} m in y_m"
        raise ValueError(f"{told}; interpolate the heights to nodes {max(steps):g} m apart in both")
    return steps[0]
