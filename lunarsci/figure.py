"""One style for every picture, and figures as file contents, the same bytes for the same figure."""

import io
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.printable import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_DATELESS = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
DPI = 200
PAGE_IN = 7.2
"""Width of a page of pictures, two columns of a journal (Nature: 183 mm), so that a point is a point in print."""
TALLEST_IN = 9.4
"""Height of a printed page, less its margins and a caption. [in]"""
INK = "#26323a"
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
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


def as_label(text: str, longest: int = 40) -> str:
    """A name from a file as a label: short, and without what matplotlib would take for a formula.

    >>> as_label("rock $4"), as_label("0123456789", 5)
    ('rock \\\\$4', '0123…')
    """
    short = text if len(text) <= longest else f"{text[: longest - 1]}…"
    return printable(short).replace("$", r"\$")


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
    columns : names side by side at most.
    """
    panels = [axes] if hasattr(axes, "get_legend_handles_labels") else list(axes)
    named: dict[str, Any] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        named |= {label: handle for handle, label in zip(handles, labels, strict=True) if label not in named}
    if named:
        across = min(columns, len(named))
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=across, frameon=False)


def synthetic_title(text: str, synthetic: bool) -> str:
    """A title that says where data are made up.

    >>> synthetic_title("rock 1", True)
    'SYNTHETIC: rock 1'
    """
    return f"SYNTHETIC: {text}" if synthetic and "SYNTHETIC" not in text else text


@contextmanager
def styled() -> "Iterator[None]":
    """Figures that are made and written in this block have the style of the house."""
    import matplotlib

    with matplotlib.rc_context(STYLE):
        yield


def picture_bytes(figures: "Iterable[Figure]", target: Path) -> bytes:
    """Render figures for a file named `target` (.png, .svg, .pdf), in the style of the house as they are drawn.

    A PDF takes every figure as a page; the other formats take the first, and a LunarSciWarning says so when there are
    more. Raises ParameterError for another suffix.
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
    if next(pages, None) is not None:
        warnings.warn(f"{target}: holds the first page only; a .pdf holds all", LunarSciWarning, stacklevel=3)
    return content


def _one(figure: "Figure", suffix: str) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix[1:], dpi=DPI, metadata=_DATELESS[suffix])
    return buffer.getvalue()


def _pages(figures: "Iterable[Figure]") -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages

    buffer = io.BytesIO()
    with PdfPages(buffer, metadata=_DATELESS[".pdf"]) as pages:
        for figure in figures:
            pages.savefig(figure)
    return buffer.getvalue()
