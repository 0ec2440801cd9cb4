"""Pictures as they would be printed: nothing too small, cut off or hidden, and what they were when they were looked at.

A picture is compared, in grey and 240 pixels wide, with a small reference in `tests/pictures`: a legend that moves over
the data or a label that is lost changes more than other versions of the libraries do. After a change on purpose look
at the picture, then `python tests/test_pictures.py --write NAME ...` renews those references, or all.
"""

import ast
import io
import itertools
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

sys.path.append(str(Path(__file__).with_name("benchmarks")))  # where pytest looks, too

from pictured import CROWDED, MEASURED, PICTURES

import lunarsci
from lunarsci.figure import PAGE_IN, TALLEST_IN, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = Path(__file__).with_name("pictures")
WIDTH_PX, SMALLEST_PT, ALLOWED = 240, 7.0, 0.02
"""Width of a reference, the smallest text in print, and the rms by which grey may differ, of 1. [px, pt, -]"""
APART = {"line": 0.2, "area": 0.1}
"""Lightness by which lines of one dash and one marker, and areas of one hatch, differ at least, of 1. [-]"""
TOUCHING_PX = 1.5
"""Boxes of text may overlap so far: they are wider than the letters. [px, of 100 an inch]"""


def grey(content: bytes) -> Any:
    """The picture in grey, of 0 to 1, small."""
    from PIL import Image

    picture = Image.open(io.BytesIO(content)).convert("L")
    return picture.resize((WIDTH_PX, round(WIDTH_PX * picture.height / picture.width)), Image.Resampling.BOX)


def rendered(figure: "Figure") -> bytes:
    """As a file of 100 px an inch; a page that has no room for what is on it is an error."""
    buffer = io.BytesIO()
    with styled(), warnings.catch_warnings():
        warnings.filterwarnings("error", message="constrained_layout not applied")
        figure.savefig(buffer, format="png", dpi=100)
    return buffer.getvalue()


def difference(content: bytes, name: str) -> float:
    """Root mean square of what differs from the reference, 1 for another shape."""
    from PIL import Image

    now, former = grey(content), Image.open(FOLDER / f"{name}.png").convert("L")
    if now.size != former.size:
        return 1.0
    return float(np.sqrt(np.mean((np.asarray(now, float) - np.asarray(former, float)) ** 2)) / 255)


MAKERS: set[tuple[str, str]] = set()
"""File and function that a figure was made in."""


def drawing(make: Callable[[], "Figure"]) -> "Figure":
    """A picture; where its figure was made is noted."""
    from matplotlib.figure import Figure

    plain = Figure.__init__

    def noted(self: "Figure", *arguments: Any, **options: Any) -> None:
        frame: FrameType | None = sys._getframe(1)
        if frame.f_code.co_name == "page":
            frame = frame.f_back
        MAKERS.add((frame.f_code.co_filename, frame.f_code.co_name))
        plain(self, *arguments, **options)

    with styled(), pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patch.setattr(Figure, "__init__", noted)
        return make()


DRAWN: set[str] = set()
"""Pictures whose places are noted."""


@lru_cache(maxsize=1)
def drawn(name: str) -> tuple["Figure", bytes]:
    figure = drawing({**PICTURES, **CROWDED}[name])
    DRAWN.add(name)
    return figure, rendered(figure)


def shown_texts(figure: "Figure") -> Iterator[tuple[Any, Any]]:
    """All text that is seen, with its box in pixels."""
    from matplotlib.axis import Axis
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Annotation, Text
    from matplotlib.transforms import Bbox

    renderer = FigureCanvasAgg(figure).get_renderer()
    ticks: set[Any] = set()
    texts: list[Any] = []
    for axis in figure.findobj(Axis):
        ticks |= set(axis.findobj(Text)) - {axis.label, axis.offsetText}
        if axis.get_visible() and axis.axes.get_visible() and axis.axes.axison:
            texts += [label for tick in axis._update_ticks() for label in (tick.label1, tick.label2)]
        else:
            ticks |= {axis.label, axis.offsetText}
    texts += [one for one in figure.findobj(Text) if one not in ticks]
    for one in texts:
        if not (one.get_visible() and one.get_text().strip()):
            continue
        if isinstance(one, Annotation) and not one._check_xy(renderer):
            continue
        box = Text.get_window_extent(one, renderer)  # of an annotation without its line
        if one.get_clip_on() and one.axes is not None and (one.get_clip_path() or one.get_clip_box()):
            box = Bbox.intersection(box, one.axes.bbox)
        if box is not None and box.width > 0 and box.height > 0:
            yield one, box


def faults(figure: "Figure", *, printed: bool = True) -> list[str]:
    """What a journal would send back. The figure has been drawn."""
    with styled():
        texts = list(shown_texts(figure))
        found = [*_text_faults(figure, texts, printed=printed), *_axes_faults(figure, {one for one, _ in texts})]
        return found + list(_legend_faults(figure))


def _text_faults(figure: "Figure", texts: list[tuple[Any, Any]], *, printed: bool) -> Iterator[str]:
    """Too small, beyond the page, over other text, or over the edge of its panel."""
    from matplotlib.axes import Axes

    scale = PAGE_IN / max(figure.get_size_inches()[0], PAGE_IN) if printed else 1.0
    frame = figure.bbox
    for one, box in texts:
        name = f"'{one.get_text()}'"
        if one.get_fontsize() * scale < SMALLEST_PT - 1e-6:
            yield f"{name} is of {one.get_fontsize() * scale:.1f} pt"
        if min(box.x0, box.y0, frame.x1 - box.x1, frame.y1 - box.y1) < -TOUCHING_PX:
            yield f"{name} is beyond the page"
        axes = one.axes
        if isinstance(axes, Axes) and one in axes.texts and axes.axison and axes.bbox.overlaps(box):
            edges = (axes.bbox.x0, axes.bbox.x1, box.x0, box.x1), (axes.bbox.y0, axes.bbox.y1, box.y0, box.y1)
            if any(low < a - TOUCHING_PX or high > b + TOUCHING_PX for a, b, low, high in edges):
                yield f"{name} lies over the edge of its panel"
    # Labels along contours are turned, so that their boxes say little.
    level = [(one, box) for one, box in texts if one.get_rotation() % 90 == 0]
    for (one, box), (other, its) in itertools.combinations(level, 2):
        wide = min(box.x1, its.x1) - max(box.x0, its.x0)
        tall = min(box.y1, its.y1) - max(box.y0, its.y0)
        if wide > TOUCHING_PX and tall > TOUCHING_PX:
            yield f"'{one.get_text()}' lies over '{other.get_text()}'"


def _axes_faults(figure: "Figure", shown: set[Any]) -> Iterator[str]:
    """Axes with numbers and without a label that names their unit."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            ticks = axis._update_ticks()
            numbers = [t.get_text() for tick in ticks for t in (tick.label1, tick.label2) if t in shown]
            numbers = [text for text in numbers if re.fullmatch(r"[-−0-9.]+|\$.*10.*\$", text)]
            label = axis.get_label_text()
            if numbers and (axis.label not in shown or not ("[" in label and "]" in label)):
                yield f"an axis with {numbers[0]} … {numbers[-1]} is called '{label}'"


def _legend_faults(figure: "Figure") -> Iterator[str]:
    """Entries that are one in grey, and legends over the data."""
    from matplotlib.legend import Legend
    from matplotlib.transforms import Bbox

    for legend in figure.findobj(Legend):
        entries = list(_entries(legend))
        for (name, kind, one, light), (its, other_kind, other, other_light) in itertools.combinations(entries, 2):
            if (kind, one) == (other_kind, other) and abs(light - other_light) < APART[kind]:
                yield f"'{name}' and '{its}' are alike in grey"
        axes = legend.axes
        box = None if axes is None else Bbox.intersection(legend.get_window_extent().padded(-1), axes.bbox)
        if axes is None or box is None or min(box.size) <= 0:
            continue
        for line in axes.lines:
            path = line.get_transform().transform_path(line.get_path()).cleaned(remove_nans=True)
            if len(path.vertices) and line.get_visible() and path.intersects_bbox(box, filled=False):
                yield f"the legend lies over '{line.get_label()}'"
        for bar in axes.patches:
            if bar.get_window_extent().overlaps(box):
                yield f"the legend lies over '{bar.get_label()}'"


def _entries(legend: Any) -> Iterator[tuple[str, str, Any, float]]:
    """Name, whether it is a line or an area, what tells it apart in grey but its lightness, and that."""
    from matplotlib.colors import to_rgba
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def lightness(color: Any) -> float:
        r, g, b, a = to_rgba(color)
        return float(a * np.dot((r, g, b), (0.299, 0.587, 0.114)) + 1 - a)

    for column in legend._legend_handle_box.get_children():
        for row in column.get_children():
            area, label = row.get_children()
            kind, look, light = "area", [], 1.0
            for one in area.get_children():
                if isinstance(one, Line2D):
                    kind, line, marker = "line", one.get_linestyle() != "None", one.get_marker() not in ("None", "")
                    look.append((one._unscaled_dash_pattern, round(one.get_linewidth())) if line else None)
                    look.append((one.get_marker(), round(one.get_markersize() / 2)) if marker else None)
                    light = lightness(one.get_color() if line else one.get_markerfacecolor())
                elif isinstance(one, Patch):
                    filled = one.get_fill() and one.get_facecolor()[3] > 0
                    look.append((one.get_hatch(), None if filled else str(one._unscaled_dash_pattern)))
                    light = lightness(one.get_facecolor() if filled else one.get_edgecolor())
            yield label.get_text(), kind, tuple(look), light


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PICTURES, *CROWDED])
def test_a_picture_is_as_it_was_looked_at_and_can_be_printed(name: str) -> None:
    """What is made up is called so: somewhere, in capitals, and by no text twice."""
    figure, content = drawn(name)
    if name in PICTURES:
        assert difference(content, name) < ALLOWED
        texts = [one.get_text() for one, _ in shown_texts(figure)]
        assert name in MEASURED or any("SYNTHETIC" in text for text in texts)
        assert [text for text in texts if len(re.findall("synthetic", text, re.IGNORECASE)) > 1] == []
    width, height = figure.get_size_inches()
    printed = name != "film"
    if printed:
        assert width <= PAGE_IN + 1e-6 and height <= TALLEST_IN + 1e-6
    assert faults(figure, printed=printed) == []


@cache
def makers() -> set[tuple[str, str]]:
    """File and innermost function of every place of the library that makes a figure."""
    found = set()
    for path in Path(lunarsci.__file__).parent.rglob("*.py"):
        text = path.read_text("utf-8")
        if path == Path(lunarsci.__file__).with_name("figure.py") or not re.search(r"\b(page|Figure)\(", text):
            continue
        for function in ast.walk(ast.parse(text)):
            if isinstance(function, ast.FunctionDef):
                for call in ast.walk(function):
                    if isinstance(call, ast.Call) and getattr(call.func, "id", "") in ("page", "Figure"):
                        found.add((str(path), function.name))
    return found


@pytest.mark.slow
def test_no_kind_of_picture_is_forgotten() -> None:
    assert {path.stem for path in FOLDER.iterdir()} == set(PICTURES)
    for name in PICTURES.keys() - DRAWN:
        drawn(name)
    forgotten = makers() - {(str(Path(file).resolve()), name) for file, name in MAKERS}
    assert not forgotten, f"give an example in tests/benchmarks/pictured.py: {sorted(forgotten)}"


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda axes: axes.text(0.5, 0.5, "small", fontsize=5), "'small' is of 5.0 pt"),
        (lambda axes: axes.figure.text(0.98, 0.5, "far out"), "'far out' is beyond the page"),
        (lambda axes: [axes.text(0.5, 0.5 + d, f"n{d}") for d in (0, 0.01)], "'n0' lies over 'n0.01'"),
        (lambda axes: axes.text(0.99, 0.5, "at the edge"), "'at the edge' lies over the edge of its panel"),
        (lambda axes: axes.set_xlabel("length"), "an axis with 0.0 … 1.0 is called 'length'"),
        (lambda axes: axes.plot([0, 1], [0, 1], color="#D55E00", label="b"), "'a' and 'b' are alike in grey"),
        (lambda axes: axes.legend(loc="upper right"), "the legend lies over 'a'"),
    ],
)
def test_each_fault_is_seen(spoil: Callable[[Any], Any], told: str) -> None:
    from lunarsci.figure import legend_below, page

    def figure(spoilt: bool) -> "Figure":
        made = page(3.0)
        axes = made.subplots()
        axes.plot([0, 1], [0.94, 0.94], color="#0072B2", label="a")
        axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(0, 1), ylim=(0, 1))
        if spoilt:
            spoil(axes)
        legend_below(made, axes)
        rendered(made)
        return made

    assert faults(drawing(lambda: figure(False))) == []
    assert told in faults(drawing(lambda: figure(True)))


@pytest.mark.slow
def test_a_kind_without_an_example_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing counts as drawn, every place that makes a figure is missed."""
    assert {Path(file).name for file, _ in makers()} >= {"soil.py", "charts.py", "animation.py", "render.py"}
    for name, value in {"DRAWN": set(PICTURES), "MAKERS": set()}.items():
        monkeypatch.setattr(sys.modules[__name__], name, value)
    with pytest.raises(AssertionError):
        test_no_kind_of_picture_is_forgotten()


@pytest.mark.slow
def test_a_legend_over_the_data_and_a_lost_label_are_seen() -> None:
    moved = drawing(PICTURES["forces"])
    axes, legend = moved.axes[0], moved.legends[0]
    legend.remove()
    axes.legend(loc="center")
    assert difference(rendered(moved), "forces") > ALLOWED
    assert any("the legend lies over" in text for text in faults(moved))
    lost = drawing(PICTURES["forces"])
    lost.axes[0].set_ylabel("")
    assert difference(rendered(lost), "forces") > ALLOWED
    assert any("is called ''" in text for text in faults(lost))


if __name__ == "__main__":
    if "--write" not in sys.argv:
        sys.exit(__doc__)
    FOLDER.mkdir(exist_ok=True)
    for chosen in sys.argv[sys.argv.index("--write") + 1 :] or list(PICTURES):
        grey(drawn(chosen)[1]).save(FOLDER / f"{chosen}.png", optimize=True)
