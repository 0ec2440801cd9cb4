"""One style for every picture, and figures as file contents, the same bytes for the same figure."""

import base64
import io
import re
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.printable import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_DATELESS = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
DPI = 200
INLINE_DPI = (100, 75, 50, 25)
LARGEST_INLINE = 150_000
"""Points per inch of pictures in notebooks, the first with which one has at most so many bytes: 200 kB as text."""
PAGE_IN = 7.2
"""Width of a page of pictures, two columns of a journal (Nature: 183 mm), so that a point is a point in print."""
TALLEST_IN = 9.4
"""Height of a printed page, less its margins and a caption. [in]"""
INK = "#26323a"
BLUE, VERMILION, GREEN, PINK, SKY, AMBER = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
COLORS = (BLUE, VERMILION, GREEN, PINK, SKY, AMBER)
"""Told apart by the colour-blind: Okabe & Ito (2008), Color Universal Design."""
LINE_STYLES = tuple(
    {"color": color, "linestyle": dashes}
    for color, dashes in zip(COLORS, ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (7, 2))), strict=True)
)
"""Lines of things alike, such as wheels, told apart in grey by their dashes."""
DOT_STYLES = tuple(
    {"color": color, "marker": marker} for color, marker in zip(COLORS, ("o", "s", "^", "D", "v", "P"), strict=True)
)
"""The same for dots, by their shapes."""
STYLE: Any = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlepad": 4.0,
    "axes.titlecolor": INK,
    "axes.labelsize": 8.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "text.color": INK,
    "legend.fontsize": 7.0,
    "legend.handlelength": 2.4,
    "legend.labelspacing": 0.35,
    "legend.columnspacing": 1.4,
    "legend.framealpha": 0.85,
    "legend.borderpad": 0.3,
    "legend.edgecolor": "none",
    "figure.titlesize": 9.0,
    "figure.labelsize": 8.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "image.cmap": "viridis",
    "lines.linewidth": 1.2,
    "errorbar.capsize": 2.0,
    "svg.hashsalt": "lunarsci",
}
"""What every picture looks like unless it says otherwise: sober, of one size of text, of few lines."""

FIRST_PAGE = "the picture has several pages, and this is the first"
"""What is said of a picture of several pages that takes one, before those that are left out."""
MOST_NAMED = 3
"""Pages left out that are named; more would have to be drawn for it. Assumed."""


def as_label(text: str, longest: int = 40) -> str:
    """A name from a file as a label: short, and without what matplotlib would take for a formula.

    >>> as_label("rock $4"), as_label("0123456789", 5)
    ('rock \\\\$4', '0123…')
    """
    short = text if len(text) <= longest else f"{text[: longest - 1]}…"
    return printable(short).replace("$", r"\$")


def named_picture(figures: Iterable["Figure"], name: str) -> "Figure | None":
    """The first with a text that begins with a name, as that of a spectrum above its panel, or with its label.

    Without such one the first with a text that has the name in it, as that of a mineral; None where there is none.
    """
    from matplotlib.text import Text

    wanted, within = (name, as_label(name), as_label(name, 28).rstrip("…")), None
    for figure in figures:
        texts = [one.get_text() for one in figure.findobj(Text)]
        if any(text.startswith(wanted) for text in texts):
            return figure
        if within is None and any(name.casefold() in text.casefold() for text in texts):
            within = figure
    return within


def file_label(name: str, longest: int = 40) -> str:
    """A file as a label: without the folders above it.

    >>> file_label("/data/2021/states.csv")
    'states.csv'
    """
    return as_label(Path(name).name, longest)


def page(height_in: float, width_in: float = PAGE_IN) -> "Figure":
    """An empty page of a picture, laid out so that no two of its panels, labels and legends overlap.

    Parameters
    ----------
    height_in : its height, of which 9.4 in are used at most. [in]
    width_in : its width. [in]
    """
    from matplotlib.figure import Figure

    made = Figure(figsize=(width_in, min(height_in, TALLEST_IN)), layout="constrained")
    layout: Any = made.get_layout_engine()
    layout.set(w_pad=0.05, h_pad=0.05)
    return made


def legend_below(figure: Any, axes: Any, columns: int = 4) -> None:
    """One legend for panels alike, each name once, below them where it hides nothing.

    Parameters
    ----------
    figure : a figure, or a part of one.
    axes : its panels, one or many.
    columns : names side by side at most; fewer where they are long.
    """
    panels = [axes] if hasattr(axes, "get_legend_handles_labels") else list(axes)
    named: dict[str, Any] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        named |= {label: handle for handle, label in zip(handles, labels, strict=True) if label not in named}
    if named:
        room = 72 * figure.bbox.width / figure.dpi / (LETTER_PT * STYLE["legend.fontsize"])
        across = max(1, min(columns, len(named), int(room / (max(map(len, named)) + BESIDE))))
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=across, frameon=False)


LETTER_PT, BESIDE = 0.56, 7
"""Width of a letter of a size of 1 pt, and letters that the line and the gap beside a name in a legend take."""


def wrapped(text: str, width_in: float = PAGE_IN, size_pt: float = STYLE["figure.titlesize"]) -> str:
    """Text in lines that fit a width; lines that are broken already stay apart.

    >>> wrapped("a path of some metres", 1.0)
    'a path of some\\nmetres'
    """
    letters = int(72 * width_in / (LETTER_PT * size_pt))
    return "\n".join(piece for line in text.split("\n") for piece in textwrap.wrap(line, letters) or [""])


def headline(figure: Any, text: str, *, synthetic: bool = False, **look: Any) -> None:
    """What a page shows, above all panels, in lines that fit it; it says once where data are made up."""
    width = figure.bbox.width / figure.dpi
    figure.suptitle(wrapped(synthetic_title(text, synthetic), 0.98 * width), **look)


def synthetic_title(text: str, synthetic: bool) -> str:
    """A title that says once where data are made up.

    >>> synthetic_title("rock 1", True), synthetic_title("SYNTHETIC rock", True)
    ('SYNTHETIC: rock 1', 'SYNTHETIC rock')
    >>> synthetic_title("path on synthetic ground (synthetic)", True)
    'SYNTHETIC: path on ground'
    """
    if not synthetic:
        return text
    bare = re.sub(r"\s*\(synthetic\)|\bsynthetic\s+", "", text)
    return bare if "SYNTHETIC" in bare else f"SYNTHETIC: {bare}"


AWAY_PT, NEAR_PT, LARGE_PT = (4.0, 10.0, 18.0, 28.0, 40.0), 8.0, 4.5
"""Gaps between a point and its name that are tried, beyond which a thin line joins them, and half the size of markers
that no name may hide. [points]"""
DIRECTIONS_DEG = (30, -30, 150, -150, 90, -90, 0, 180, 60, -60, 120, -120)


def name_points(
    figure: Any, named: Mapping[Any, Sequence[tuple[str, float, float]]], *, clear_pt: float = 0.0, **look: Any
) -> None:
    """Write names beside points of panels, each where it covers no other name and, if there is room, no other point.

    Parameters
    ----------
    figure : the whole page, with all else drawn.
    named : by panel, names and their points, in the order of their importance: a name that finds no place is left out.
    clear_pt : half the size of the points' own markers, where these are large. [points]
    look : of the text.
    """
    import numpy as np
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()
    look = {"bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}, **look}
    for axes, items in named.items():
        places = [np.asarray(axes.transData.transform((x, y))) for _, x, y in items]
        dots = np.array([*((*place, 2.0) for place in places), *_marked(axes)]).reshape(-1, 3)
        taken = [one.get_window_extent() for one in axes.texts]
        taken += [Bbox.from_extents(x - h, y - h, x + h, y + h) for x, y, h in dots if h > LARGE_PT * figure.dpi / 72]
        if axes.get_legend() is not None:
            taken.append(axes.get_legend().get_window_extent())
        for (text, *point), place in zip(items, places, strict=True):
            if axes.bbox.contains(*place):
                _name(axes, text, (point, place, clear_pt), dots, taken, look)


def _marked(axes: Any) -> Iterator[Any]:
    """Places of all markers of a panel, and half their sizes. [px]"""
    for line in axes.lines:
        if line.get_marker() not in ("None", "", " ", None) and line.get_transform() == axes.transData:
            half = 0.5 * line.get_markersize() * axes.figure.dpi / 72
            yield from ((*place, half) for place in axes.transData.transform(line.get_xydata()))


def _name(axes: Any, text: str, where: Any, dots: Any, taken: list[Any], look: Mapping[str, Any]) -> None:
    import numpy as np
    from matplotlib.transforms import Bbox

    point, place, clear = where
    trial = axes.annotate(text, point, xytext=(0, 0), textcoords="offset points", **look)
    size, scale = np.array(trial.get_window_extent().size), axes.figure.dpi / 72
    trial.remove()
    best: tuple[float, Any, float, Any] | None = None
    for away in AWAY_PT:
        for angle in np.radians(DIRECTIONS_DEG):
            way = np.array([np.cos(angle), np.sin(angle)])
            corner = place + scale * (away + clear) * way + 0.5 * size * (np.clip(1.6 * way, -1, 1) - 1)
            box = Bbox.from_bounds(*corner, *size)
            room = axes.bbox.padded(-2.0 * scale)
            inside = room.x0 < box.x0 and box.x1 < room.x1 and room.y0 < box.y0 and box.y1 < room.y1
            if not inside or any(box.padded(2.0 * scale).overlaps(other) for other in taken):
                continue
            half = dots[:, 2:]
            hidden = np.all((dots[:, :2] > corner - half) & (dots[:, :2] < corner + size + half), axis=1).sum()
            cost = away + 12.0 * float(hidden)
            if best is None or cost < best[0]:
                best = cost, (corner - place) / scale, away, box
    if best is None:
        return
    _, offset, away, box = best
    line = {"arrowstyle": "-", "color": "0.5", "linewidth": 0.5, "shrinkA": 0, "shrinkB": 2}
    drawn = axes.annotate(
        text, point, xytext=offset, textcoords="offset points", ha="left", va="bottom", multialignment="center",
        zorder=6, arrowprops=line if away > NEAR_PT else None, **look,
    )  # fmt: skip
    drawn.set_in_layout(False)
    taken.append(box)


@contextmanager
def styled() -> Iterator[None]:
    """Figures that are made and written in this block have the style of the house."""
    import matplotlib

    with matplotlib.rc_context(STYLE):
        yield


def picture_bytes(figures: "Iterable[Figure]", target: Path) -> bytes:
    """Render figures for a file named `target` (.png, .svg, .pdf), in the style of the house as they are drawn.

    A PDF takes every figure as a page; the other formats take the first, and a LunarSciWarning names the next ones when
    there are more. Raises ParameterError for another suffix.
    """
    suffix = target.suffix.lower()
    if suffix not in _DATELESS:
        raise ParameterError(f"{target}: pictures are written as {', '.join(_DATELESS)}")
    with styled():
        return _rendered(figures, target, suffix)


def _rendered(figures: "Iterable[Figure]", target: Path, suffix: str) -> bytes:
    if suffix == ".pdf":
        return _pages(figures)
    pages = iter(figures)
    first = next(pages, None)
    if first is None:
        raise ParameterError("there is nothing to draw; leave --plot out")
    content = _one(first, suffix)
    title = _headline_of(first, 1)[len("page 1") :]
    named = [_headline_of(one, number) for number, one in enumerate(islice(pages, MOST_NAMED), 2)]
    if left_out := [text.removesuffix(title) if title else text for text in named]:
        more = " and more" if next(pages, None) is not None else ""
        every = f"--plot {target.with_suffix('.pdf').name} draws all"
        text = f"{target}: {FIRST_PAGE}; left out: {'; '.join(left_out)}{more}; {every}"
        warnings.warn(text, LunarSciWarning, stacklevel=3)
    return content


def inline_picture(figures: "Iterable[Figure]") -> str:
    """The first figure as the source of an image in HTML, at most `LARGEST_INLINE` long; '' where there is none.

    In 256 colours where all of them would take more, and then in fewer points.
    """
    with styled():
        first = next(iter(figures), None)
        small = next((one for one in _smaller(first) if len(one) <= LARGEST_INLINE), b"") if first is not None else b""
    return f"data:image/png;base64,{base64.b64encode(small).decode()}" if small else ""


def _smaller(figure: "Figure") -> Iterator[bytes]:
    from PIL import Image

    for dpi in INLINE_DPI:
        content = _one(figure, ".png", dpi=dpi)
        yield content
        palette = io.BytesIO()
        Image.open(io.BytesIO(content)).convert("RGB").quantize(256).save(palette, "png", optimize=True)
        yield palette.getvalue()


def shown(figure: "Figure") -> "Figure":
    """A figure with the picture that a notebook shows where matplotlib itself has not been asked to."""
    figure.__dict__["_repr_png_"] = partial(_one, figure, ".png", dpi=INLINE_DPI[0])
    return figure


def _headline_of(figure: "Figure", number: int) -> str:
    """What is above all panels of a page, or above the first, else its number."""
    titles = (figure.get_suptitle(), *(one.get_title() for one in figure.axes[:1]))
    title = next((" ".join(text.replace(r"\$", "$").split()) for text in titles if text.strip()), "")
    return f"page {number}{f' ({title})' if title else ''}"


def _one(figure: "Figure", suffix: str, dpi: float = DPI) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix[1:], dpi=dpi, metadata=_DATELESS[suffix])
    return buffer.getvalue()


def _pages(figures: "Iterable[Figure]") -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages

    buffer = io.BytesIO()
    with PdfPages(buffer, metadata=_DATELESS[".pdf"]) as pages:
        for figure in figures:
            pages.savefig(figure)
    return buffer.getvalue()
