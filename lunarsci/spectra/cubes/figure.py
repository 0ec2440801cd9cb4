"""A quick look at maps: a panel a layer, its scale of colours, kilometres along its edges, and where north is."""

import json
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.figure import AMBER, BLUE, PAGE_IN, SKY, TALLEST_IN, VERMILION, as_label, headline, page
from lunarsci.spectra.cubes.cube import FLAGS, SYNTHETIC, PixelFrame
from lunarsci.spectra.cubes.output import FLAG_LAYER, SUFFIXES, is_geographic
from lunarsci.spectra.cubes.rasters import frame_of, netcdf, netcdf_frame, opened

SHARE, DOMAIN, BOTH = "share_", "shares{}_in_domain", "_both"
"""Names of layers: shares of minerals, which come first, whether they are in domain, and the end of those with
mixtures."""
FIRST = ("bd1000", "bc1000_nm", "bd2000", "bc2000_nm", "nbsr_um2_opx", "fit_rms_ln", "ibd1000")
PER_PAGE = 9
MOST_PIXELS = 700
"""On a side of a panel; more are thinned."""
LEAST_IN = 2.4
"""Height of a panel with its title and scale at least; assumed. [in]"""
STRIPES = 300
"""On a side of what is hatched; fewer pixels are divided; assumed."""
LONG = 3.0
"""A map that is more times as long as wide, or as wide as long, is drawn so many times; the kilometres say so."""
NO_VALUE = "#c8c8c8"
FLAG_COLORS = ("#f5f5f5", "#000000", NO_VALUE, AMBER, VERMILION, SKY)
PLACES = ("longitude", "latitude")
_ERRORS = ("_sigma", "_systematic", "_gaussian", "_method", "_low", "_high", "_interpolation")


@dataclass(frozen=True, slots=True)
class _Ground:
    """How far one sample and one line of a map go in its middle, to the east and to the north [km]; what north is."""

    sample: tuple[float, float]
    line: tuple[float, float]
    north: str

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of a pixel. [km]"""
        return float(np.hypot(*self.sample)), float(np.hypot(*self.line))


def map_pages(path: Path, record: Mapping[str, Any]) -> Iterator[Figure]:
    """Pages of a map file: what is looked at first, then every other layer of values that is no error and not empty.

    `record` : the `result` of the JSON of `lunarsci spectra map`, which made it.
    """
    values = [row for row in record["layers"] if row["kind"] == "value" and row["name"] not in PLACES]
    shown = [one for one in values if not any(part in one["name"] for part in _ERRORS) and one["determined"] != 0]
    shares = [one for one in shown if one["name"].startswith(SHARE)]
    both = [(one, one | {"long_name": "width of its 95 % interval", "ends": True}) for one in shares]
    rest = [one for one in shown if one not in shares]
    rest.sort(key=lambda layer: FIRST.index(layer["name"]) if layer["name"] in FIRST else len(FIRST))
    ranked = [*(one for pair in both for one in pair), *rest]
    for start in range(0, max(len(ranked), 1), PER_PAGE - 1):
        yield _page(path, record, ranked[start : start + PER_PAGE - 1])


def is_map_of(path: Path, record: Mapping[str, Any], provenance: Mapping[str, Any]) -> bool:
    """Whether a file is the map that a JSON document of `spectra map` tells of, by what both say it was made from.

    Raises DataError for a file that cannot be read.
    """
    if SUFFIXES[path.suffix.lower()] == "netcdf":
        data = netcdf(str(path))
        stated, shape = data.attrs.get("provenance"), data[FLAG_LAYER].shape if FLAG_LAYER in data.variables else ()
        names = {str(name) for name in data.variables}
    else:
        with opened(str(path), "GTiff") as dataset:
            stated, shape, names = dataset.tags().get("provenance"), dataset.shape, set(dataset.descriptions)
    made = json.loads(stated or "{}")
    same = all(made.get(key) == provenance.get(key) for key in ("version", "inputs", "tables"))
    asked = provenance.get("options") or {}
    return (
        same
        and all(asked.get(key, value) == value for key, value in made.get("options", {}).items())
        and tuple(shape) == (record["map"]["lines"], record["map"]["samples"])
        and {row["name"] for row in record["layers"]} <= names
    )


def _page(path: Path, record: Mapping[str, Any], layers: Sequence[Mapping[str, Any]]) -> Figure:
    """One page: the flags, then a panel for each of some layers."""
    lines, samples = shape = record["map"]["lines"], record["map"]["samples"]
    numbers = {layer["name"]: number for number, layer in enumerate(record["layers"], 1)}
    ground = _ground(path, shape, numbers)
    width, height = ground.size if ground else (1.0, 1.0)
    long = lines * height / (samples * width)
    drawn = float(np.clip(long, 1 / LONG, LONG))
    columns = min(len(layers) + 1, 4 if drawn > 1.5 else 3)
    rows = -(-(len(layers) + 1) // columns)
    wide = min(PAGE_IN / columns, PAGE_IN / 2.4)
    tall = max(0.72 * wide * drawn + 1.1, LEAST_IN) * rows + 0.6
    # A page that were taller than paper is made narrower, so that its panels stay as long.
    figure = page(tall, max(PAGE_IN * min(1.0, TALLEST_IN / tall), 5.2) if columns > 2 else wide * columns + 0.4)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    extent = (0.0, samples * width, lines * height, 0.0)
    thinned = tuple(slice(None, None, max(1, -(-size // MOST_PIXELS))) for size in shape)
    for panel, layer in zip(panels, (None, *layers), strict=False):
        name = layer["name"] if layer else ""
        image = _image(path, numbers, layer, thinned)
        _draw(figure, panel, image, layer, extent, drawn)
        if (domain := _domain_of(name)) in numbers:
            _hatch(panel, np.isfinite(image) & (pixels_of(path, domain, numbers[domain], thinned) == 0), extent)
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
    synthetic = any(SYNTHETIC in text for text in record["cube"]["remarks"])
    hatched = dict.fromkeys(_domain_of(layer["name"]) for layer in layers)
    headline(figure, _title(record, drawn / long, ground, hatched), synthetic=synthetic)
    return figure


def _domain_of(name: str) -> str:
    """The layer that says whether a share is in domain, by the name of the share; '' of other layers."""
    return DOMAIN.format(BOTH if name.endswith(BOTH) else "") if name.startswith(SHARE) else ""


def _image(
    path: Path, numbers: Mapping[str, int], layer: Mapping[str, Any] | None, part: tuple[slice, ...]
) -> FloatArray:
    """Pixels of a panel: of a layer, of the width of its interval, or the flags where it is None."""
    name = layer["name"] if layer else FLAG_LAYER
    names = (f"{name}_low95", f"{name}_high95") if layer and layer.get("ends") else (name,)
    first, *second = (pixels_of(path, one, numbers[one], part) for one in names)
    return second[0] - first if second else first


def _title(record: Mapping[str, Any], squeezed: float, ground: _Ground | None, hatched: Collection[str]) -> str:
    """Which part of the cube it is, and how to read the page.

    `squeezed` is how much longer panels are than the map, `hatched` the layers of domains that panels hang on.
    """
    region, parts = record["map"], []
    for name in ("sample", "line"):
        first, step = region[f"first_{name}"], region["every"]
        parts.append(f"{name}s {first}-{first + step * (region[f'{name}s'] - 1)}")
    parts += [f"every {region['every']}-th"] if region["every"] > 1 else []
    parts += [] if ground else ["no place on the Moon known"]
    parts += ["not to scale: see the numbers along the edges"] if abs(squeezed - 1) > 1e-6 else []
    parts += ["grey: not determined"]
    outside = [row["codes"].partition("out_of_domain=")[2] for row in record["layers"] if row["name"] in hatched]
    total = record["pixels"]["pixels"]
    parts += [f"hatched: out of domain, {text.split()[0]} of {total} pixels" for text in outside if text]
    return f"{as_label(Path(record['cube']['file']).name, 80)}\n{', '.join(parts)}"


def pixels_of(path: Path, name: str, number: int, part: tuple[slice, ...]) -> FloatArray:
    """Some lines and samples of a layer, which is the `number`-th from 1."""
    if SUFFIXES[path.suffix.lower()] == "netcdf":
        return np.asarray(netcdf(str(path))[name][part].values, float)
    with opened(str(path), "GTiff") as dataset:
        return np.asarray(dataset.read(number)[part], float)


def _draw(
    figure: Figure, panel: Any, image: FloatArray, layer: Mapping[str, Any] | None, extent: tuple[float, ...],
    drawn: float,
) -> None:  # fmt: skip
    """A layer, or the flags where it is None, with its scale; `extent` in km or pixels, as imshow takes it.

    Shares, and the widths of their intervals, have one scale. `drawn` is how long the panel is for its width.
    """
    if layer is None:
        codes = _worst_flag(image)
        panel.imshow(codes, ListedColormap(FLAG_COLORS), vmin=-0.5, vmax=5.5, extent=extent, interpolation="nearest")
        seen = [int(code) for code in np.unique(codes)]
        names = ("measured", *(name.replace("_", " ") for name in FLAGS))
        handles = [Patch(facecolor=FLAG_COLORS[code], edgecolor="0.5", label=names[code]) for code in seen]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4), frameon=False)
        panel.set_title("pixels")
        return
    finite = image[np.isfinite(image)]
    share = layer["name"].startswith(SHARE)
    low, high = np.quantile(finite, (0.02, 0.98)) if finite.size and not share else (0.0, 1.0)
    colors = colormaps["viridis"].with_extremes(bad=NO_VALUE)
    picture = panel.imshow(image, colors, vmin=low, vmax=high, extent=extent, interpolation="nearest")
    thick = 0.05 / min(1.0, drawn)
    bar = figure.colorbar(
        picture, ax=panel, orientation="horizontal", fraction=thick, pad=0.02, extend="neither" if share else "both"
    )
    bar.ax.locator_params(nbins=4 if drawn > 0.5 else 3)
    bar.set_label("[-]" if layer["units"] == "1" else f"[{layer['units']}]")
    panel.set_title("\n".join([layer["name"], *textwrap.wrap(as_label(layer["long_name"], 60), 22)]), pad=9)


def _hatch(panel: Any, where: BoolArray, extent: tuple[float, ...]) -> None:
    """White stripes over some pixels."""
    fine = max(1, STRIPES // max(where.shape))
    there = np.kron(where, np.ones((fine, fine), dtype=bool))
    stripe = np.add.outer(*map(np.arange, there.shape)) % 12 < 4
    panel.imshow(np.dstack([np.ones((*there.shape, 3)), there & stripe]), extent=extent, interpolation="nearest")


def _worst_flag(image: FloatArray) -> FloatArray:
    """0 for a pixel without flags, else the place of its first flag, from 1."""
    flags, codes = image.astype(int), np.zeros(image.shape)
    for k in reversed(range(len(FLAGS))):
        codes[(flags & (1 << k)) != 0] = k + 1
    return codes


def _ground(path: Path, shape: tuple[int, int], numbers: Mapping[str, int]) -> _Ground | None:
    """How far pixels go; None where nothing says it."""
    frame = _frame(path)
    line, sample = (np.array([size / 2 - 0.5, size / 2 + 0.5]) for size in shape)
    if frame is not None and frame.crs_wkt and not is_geographic(frame):
        a, b, _, d, e, _ = (value / 1e3 for value in frame.transform)
        return _Ground((a, d), (b, e), "grid north")
    if frame is not None and frame.crs_wkt:
        a, b, _, d, e, _ = (np.radians(value) * MOON_RADIUS_KM for value in frame.transform)
        level = float(np.cos(np.radians(frame.middles(line, sample)[1].mean())))
        return _Ground((a * level, d), (b * level, e), "north")
    if not numbers.keys() >= set(PLACES) or min(shape) < 2:
        return None
    middle = tuple(slice(size // 2 - 1, size // 2 + 1) for size in shape)
    longitude, latitude = (np.radians(pixels_of(path, name, numbers[name], middle)) for name in PLACES)
    east = (np.unwrap(longitude, axis=1) - longitude[0, 0]) * np.cos(latitude[0, 0]) * MOON_RADIUS_KM
    north = (latitude - latitude[0, 0]) * MOON_RADIUS_KM
    return _Ground((float(east[0, 1]), float(north[0, 1])), (float(east[1, 0]), float(north[1, 0])), "north")


def _frame(path: Path) -> PixelFrame | None:
    """Where the pixels of a map file lie."""
    if SUFFIXES[path.suffix.lower()] == "netcdf":
        flags = netcdf(str(path))[FLAG_LAYER]
        return netcdf_frame(netcdf(str(path)), flags, *map(str, flags.dims))
    with opened(str(path), "GTiff") as dataset:
        return frame_of(dataset)


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
        xycoords="axes fraction", arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.5},
    )  # fmt: skip
    panel.text(0.86, 0.72, ground.north, transform=panel.transAxes, ha="center", color=BLUE)
