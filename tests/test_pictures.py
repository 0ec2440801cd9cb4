"""Pictures as they would be printed: nothing too small, cut off or hidden, and what they were when they were looked at.

A picture is compared, in grey and 240 pixels wide, with a small reference in `tests/pictures`: a legend that moves over
the data or a label that is lost changes more than other versions of the libraries do. After a change on purpose look
at the picture, then `python tests/test_pictures.py --write NAME ...` renews those references, or all.
"""

import io
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from lunarsci.figure import PAGE_IN, TALLEST_IN, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = Path(__file__).with_name("pictures")
WIDTH_PX, SMALLEST_PT, ALLOWED = 240, 7.0, 0.02
"""Width of a reference, the smallest text in print, and the rms by which grey may differ, of 1. [px, pt, -]"""


@cache
def spectra() -> Any:
    """A red slope with bands at 930 and 1950 nm, and noise of 0.5 %."""
    from lunarsci.spectra.spectrum import Spectrum

    x = np.arange(500.0, 2400.0, 5.0)
    noise = 1 + 0.005 * np.random.default_rng(1).standard_normal(x.size)
    bands = 0.3 * np.exp(-0.5 * ((x - 930) / 90) ** 2) + 0.15 * np.exp(-0.5 * ((x - 1950) / 200) ** 2)
    return Spectrum(id="SYNTHETIC rock", wavelength_nm=x, reflectance=(0.05 + 4e-5 * x) * np.exp(-bands) * noise)


def forces(**options: Any) -> "Figure":
    import lunarsci

    return lunarsci.wheel_forces(load=36.5, side_slip=2, **options).plot()


def match() -> "Figure":
    import lunarsci

    return lunarsci.match(modes="ol=0.25:0.05,opx=0.345:0.05,cpx=0.405:0.05", name="a rock").plot()


def cameras() -> "Figure":
    import lunarsci

    return lunarsci.cameras().plot()


def measured(job: str, page: int = 0) -> "Figure":
    import lunarsci

    return getattr(lunarsci, job)(spectra()).plot(page)


PICTURES: dict[str, Callable[[], "Figure"]] = {
    "bands": lambda: measured("bands"),
    "indices": lambda: measured("indices"),
    "fit": lambda: measured("fit"),
    "match": match,
    "forces": lambda: forces(slip=0.1),
    "cameras": cameras,
}


def grey(figure: "Figure") -> Any:
    """The figure in grey, of 0 to 1, small."""
    from PIL import Image

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    picture = Image.open(buffer).convert("L")
    return picture.resize((WIDTH_PX, round(WIDTH_PX * picture.height / picture.width)), Image.Resampling.BOX)


def difference(figure: "Figure", name: str) -> float:
    """Root mean square of what differs from the reference, 1 for another shape."""
    from PIL import Image

    now, former = grey(figure), Image.open(FOLDER / f"{name}.png").convert("L")
    if now.size != former.size:
        return 1.0
    return float(np.sqrt(np.mean((np.asarray(now, float) - np.asarray(former, float)) ** 2)) / 255)


@cache
def drawn(name: str) -> "Figure":
    with styled():
        return PICTURES[name]()


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_as_it_was_looked_at(name: str) -> None:
    with styled():
        assert difference(drawn(name), name) < ALLOWED


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_fits_a_page_and_its_text_can_be_read(name: str) -> None:
    from matplotlib.text import Text

    with styled():
        figure = drawn(name)
        figure.draw_without_rendering()
    width, height = figure.get_size_inches()
    assert width <= PAGE_IN + 1e-6 and height <= TALLEST_IN + 1e-6
    texts = [one for one in figure.findobj(Text) if one.get_visible() and one.get_text().strip()]
    assert min(one.get_fontsize() for one in texts) >= SMALLEST_PT


@pytest.mark.slow
def test_a_legend_over_the_data_and_a_lost_label_are_seen() -> None:
    with styled():
        moved = forces(slip=0.1)
        axes, legend = moved.axes[0], moved.legends[0]
        legend.remove()
        axes.legend(loc="center")
        assert difference(moved, "forces") > ALLOWED
        lost = forces(slip=0.1)
        lost.axes[0].set_ylabel("")
        assert difference(lost, "forces") > ALLOWED


if __name__ == "__main__":
    if "--write" not in sys.argv:
        sys.exit(__doc__)
    FOLDER.mkdir(exist_ok=True)
    for chosen in sys.argv[sys.argv.index("--write") + 1 :] or list(PICTURES):
        with styled():
            grey(drawn(chosen)).save(FOLDER / f"{chosen}.png", optimize=True)
