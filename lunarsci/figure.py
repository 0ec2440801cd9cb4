"""Figures as file contents, the same bytes for the same figure."""

import io
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from lunarsci.errors import LunarSciWarning, ParameterError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_DATELESS = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
DPI = 150


def picture_bytes(figures: "Iterable[Figure]", target: Path) -> bytes:
    """Render figures for a file named `target` (.png, .svg, .pdf).

    A PDF takes every figure as a page; the other formats take the first, and a LunarSciWarning says so when there are
    more. Raises ParameterError for another suffix.
    """
    suffix = target.suffix.lower()
    if suffix not in _DATELESS:
        raise ParameterError(f"{target}: pictures are written as {', '.join(_DATELESS)}")
    if suffix == ".pdf":
        return _pages(figures)
    pages = iter(figures)
    first = next(pages, None)
    if first is None:
        raise ParameterError("there is nothing to draw; leave --plot out")
    content = _one(first, suffix)
    if next(pages, None) is not None:
        warnings.warn(f"{target}: holds the first page only; a .pdf holds all", LunarSciWarning, stacklevel=2)
    return content


def _one(figure: "Figure", suffix: str) -> bytes:
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "lunarsci"}):
        figure.savefig(buffer, format=suffix[1:], dpi=DPI, metadata=_DATELESS[suffix])
    return buffer.getvalue()


def _pages(figures: "Iterable[Figure]") -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages

    buffer = io.BytesIO()
    with PdfPages(buffer, metadata=_DATELESS[".pdf"]) as pages:
        for figure in figures:
            pages.savefig(figure)
    return buffer.getvalue()
