"""A quick look at maps: a panel a layer, its scale of colours, kilometres along its edges, and where north is."""

import textwrap
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.figure import PAGE_IN, TALLEST_IN, as_label, headline, page
from lunarsci.spectra.cubes.cube import FLAGS
from lunarsci.spectra.cubes.output import FLAG_LAYER, SUFFIXES, Layer, MapFile, is_geographic
from lunarsci.spectra.cubes.rasters import netcdf, opened

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FIRST = (
    "bd1000", "bc1000_nm", "bd2000", "bc2000_nm", "nbsr_um2_opx", "fit_rms_ln", "olivine", "orthopyroxene", "ibd1000",
)  # fmt: skip
PER_PAGE = 9
MOST_PIXELS = 700
"""On a side of a panel; more are thinned."""
LONG = 3.0
"""A map that is more times as long as wide, or as wide as long, is drawn so many times; the kilometres say so."""
NO_VALUE = "#c8c8c8"
FLAG_COLORS = ("#f5f5f5", "#000000", NO_VALUE, "#E69F00", "#D55E00", "#56B4E9")
_ERRORS = ("_sigma", "_systematic", "_method", "_low", "_high", "_interpolation")


@dataclass(frozen=True, slots=True)
class _Ground:
    """Kilometres to the east and north that one sample and one line of a map go, in its middle; what north is."""

    sample: tuple[float, float]
    line: tuple[float, float]
    north: str

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of a pixel. [km]"""
        return float(np.hypot(*self.sample)), float(np.hypot(*self.line))


def map_pages(path: Path, made: MapFile, empty: Collection[str] = ()) -> "Iterator[Figure]":
    """Pages of a map file: what is looked at first, then every other layer of values that is no error, nor `empty`."""
    values = [layer for layer in made.layers if not layer.meanings and not layer.standard_name]
    shown = [one for one in values if not any(part in one.name for part in _ERRORS) and one.name not in empty]
    ranked = sorted(shown, key=lambda layer: FIRST.index(layer.name) if layer.name in FIRST else len(FIRST))
    for start in range(0, max(len(ranked), 1), PER_PAGE - 1):
        yield _page(path, made, ranked[start : start + PER_PAGE - 1])


def _page(path: Path, made: MapFile, layers: Sequence[Layer]) -> "Figure":
    lines, samples = made.region.shape
    ground = _ground(made)
    width, height = ground.size if ground else (1.0, 1.0)
    long = lines * height / (samples * width)
    drawn = float(np.clip(long, 1 / LONG, LONG))
    columns = min(len(layers) + 1, 4 if drawn > 1.5 else 3)
    rows = -(-(len(layers) + 1) // columns)
    wide = min(PAGE_IN / columns, PAGE_IN / 2.4)
    tall = (0.72 * wide * drawn + 1.1) * rows + 0.6
    # A page that were taller than paper is made narrower, so that its panels stay as long.
    figure = page(tall, max(PAGE_IN * min(1.0, TALLEST_IN / tall), 5.2) if columns > 2 else wide * columns + 0.4)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    extent = (0.0, samples * width, lines * height, 0.0)
    numbers = {layer.name: number for number, layer in enumerate(made.layers, 1)}
    for panel, layer in zip(panels, (None, *layers), strict=False):
        name = layer.name if layer else FLAG_LAYER
        _draw(figure, panel, _thinned(path, name, numbers[name], made), layer, extent)
        panel.set_aspect(drawn / long)
        panel.set_xlabel("along the lines [km]" if ground else "sample [px]")
    for number, panel in enumerate(panels[: len(layers) + 1]):
        if number % columns:
            panel.tick_params(labelleft=False)
        else:
            panel.set_ylabel("across the lines [km]" if ground else "line [px]")
    for panel in panels[len(layers) + 1 :]:
        panel.set_axis_off()
    if ground:
        _point_north(panels[0], ground, drawn / long)
    headline(figure, _title(made, drawn / long, ground), synthetic=made.cube.synthetic)
    return figure


def _title(made: MapFile, squeezed: float, ground: _Ground | None) -> str:
    parts = [f"samples {made.region.samples[0]}-{made.region.samples[1] - 1}"]
    parts.append(f"lines {made.region.lines[0]}-{made.region.lines[1] - 1}")
    parts += [f"every {made.region.step}-th"] if made.region.step > 1 else []
    parts += [] if ground else ["no place on the Moon known"]
    parts += ["not to scale: see the numbers along the edges"] if abs(squeezed - 1) > 1e-6 else []
    parts += ["grey: not determined"]
    return f"{as_label(Path(made.cube.name).name, 80)}\n{', '.join(parts)}"


def _thinned(path: Path, name: str, number: int, made: MapFile) -> FloatArray:
    """A layer with as many pixels as a panel can show."""
    lines, samples = made.region.shape
    steps = tuple(slice(None, None, max(1, -(-size // MOST_PIXELS))) for size in (lines, samples))
    if SUFFIXES[path.suffix.lower()] == "netcdf":
        return np.asarray(netcdf(str(path))[name][steps].values, float)
    with opened(str(path), "GTiff") as dataset:
        return np.asarray(dataset.read(number)[steps], float)


def _draw(figure: "Figure", panel: Any, image: FloatArray, layer: Layer | None, extent: tuple[float, ...]) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    if layer is None:
        codes = _worst_flag(image)
        panel.imshow(codes, ListedColormap(FLAG_COLORS), vmin=-0.5, vmax=5.5, extent=extent, interpolation="nearest")
        seen = [int(code) for code in np.unique(codes)]
        names = ("measured", *(name.replace("_", " ") for name in FLAGS))
        handles = [Patch(facecolor=FLAG_COLORS[code], edgecolor="0.5", label=names[code]) for code in seen]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4), frameon=False)
        panel.set_title("pixels")
        return
    known = image[np.isfinite(image)]
    low, high = np.quantile(known, (0.02, 0.98)) if known.size else (0.0, 1.0)
    colors = colormaps["viridis"].with_extremes(bad=NO_VALUE)
    drawn = panel.imshow(image, colors, vmin=low, vmax=high, extent=extent, interpolation="nearest")
    bar = figure.colorbar(drawn, ax=panel, orientation="horizontal", fraction=0.05, pad=0.02, extend="both")
    bar.ax.locator_params(nbins=4)
    bar.set_label("[-]" if layer.units == "1" else f"[{layer.units}]")
    panel.set_title("\n".join([layer.name, *textwrap.wrap(as_label(layer.long_name, 60), 22)]), pad=9)


def _worst_flag(image: FloatArray) -> FloatArray:
    """0 for a pixel without flags, else the place of its first flag, from 1."""
    flags, codes = image.astype(int), np.zeros(image.shape)
    for k in reversed(range(len(FLAGS))):
        codes[(flags & (1 << k)) != 0] = k + 1
    return codes


def _ground(made: MapFile) -> _Ground | None:
    """How far pixels go; None where nothing says it."""
    frame = made.frame
    line, sample = (np.array([size / 2 - 0.5, size / 2 + 0.5]) for size in made.region.shape)
    if frame is not None and frame.crs_wkt and not is_geographic(frame):
        a, b, _, d, e, _ = (value / 1e3 for value in frame.transform)
        return _Ground((a, d), (b, e), "grid north")
    if frame is not None and frame.crs_wkt:
        a, b, _, d, e, _ = (np.radians(value) * MOON_RADIUS_KM for value in frame.transform)
        level = float(np.cos(np.radians(frame.middles(line, sample)[1].mean())))
        return _Ground((a * level, d), (b * level, e), "north")
    planes = made.cube.backplanes
    if "longitude" not in planes or min(made.region.shape) < 2:
        return None
    middle = [
        first + (size // 2 - 1) * made.region.step
        for first, size in zip((made.region.lines[0], made.region.samples[0]), made.region.shape, strict=True)
    ]
    at = [slice(first, first + 2) for first in middle]
    longitude, latitude = (np.radians(planes[name].read(*at)) for name in ("longitude", "latitude"))
    east = (np.unwrap(longitude, axis=1) - longitude[0, 0]) * np.cos(latitude[0, 0]) * MOON_RADIUS_KM
    north = (latitude - latitude[0, 0]) * MOON_RADIUS_KM
    step = made.region.step
    return _Ground(
        (step * float(east[0, 1]), step * float(north[0, 1])),
        (step * float(east[1, 0]), step * float(north[1, 0])),
        "north",
    )


def _point_north(panel: Any, ground: _Ground, aspect: float) -> None:
    """An arrow to the north in the panel's upper corner."""
    matrix = np.array([ground.sample, ground.line]).T
    if abs(np.linalg.det(matrix)) < 1e-12:
        return
    samples, lines = np.linalg.solve(matrix, [0.0, 1.0])
    width, height = ground.size
    right, up = samples * width, -lines * height * aspect
    right, up = np.array([right, up]) / np.hypot(right, up)
    panel.annotate(
        "", xy=(0.86 + 0.09 * right, 0.88 + 0.09 * up), xytext=(0.86 - 0.09 * right, 0.88 - 0.09 * up),
        xycoords="axes fraction", arrowprops={"arrowstyle": "-|>", "color": "#0072B2", "lw": 1.5},
    )  # fmt: skip
    panel.text(0.86, 0.72, ground.north, transform=panel.transAxes, ha="center", color="#0072B2")
