"""Picture of the plane of the two band centres with the pyroxenes, and measured spectra in it."""

from collections.abc import Iterator, Sequence
from typing import Any

from matplotlib.figure import Figure

from lunarsci.spectra.bands import SpectrumBands
from lunarsci.spectra.chemistry.bands import error_nm
from lunarsci.spectra.chemistry.plane import OLIVINE_NM, Anchor, anchors

__all__ = ["plane_pages"]

X_NM, Y_NM = (890.0, 1100.0), (1740.0, 2400.0)
BELOW_NM = 1765.0
"""Height at which spectra without a 2 um band are drawn."""
MOST_NAMES = 25
FIELDS = (
    (
        "orthopyroxene, Wo ≤ 5",
        ((905, 1810), (915, 1810), (953, 2055), (948, 2075), (938, 2055), (905, 1850)),
        (918, 1805),
    ),
    (
        "pigeonite, Wo 5-25",
        ((940, 1960), (948, 1898), (958, 1905), (1010, 2130), (1022, 2235), (1000, 2205), (962, 2115), (938, 1990)),
        (962, 1910),
    ),
    (
        "augite, Wo > 25",
        ((982, 2040), (1000, 2030), (1062, 2230), (1058, 2315), (1034, 2315), (1010, 2270)),
        (1040, 2140),
    ),
)
"""Name, corners and place of the name of each field. Drawn around RELAB pyroxenes of known composition, upper hull; 30
of 31, 24 of 27 and 24 of 24 lie inside. After Adams (1974) and Cloutis & Gaffey (1991), whose tables were not at hand.
"""
COLORS = ("#0072B2", "#E69F00", "#D55E00")
OLIVINE_COLOR = "#009E73"


def plane_pages(measured: Sequence[SpectrumBands]) -> Iterator[Figure]:
    """One page: 2 um centre over 1 um centre, fields and trend of the pyroxenes, olivine below, spectra with errors."""
    figure = Figure(figsize=(8.5, 7), layout="constrained")
    axes = figure.subplots()
    _draw_fields(axes)
    _draw_trend(axes)
    shown = [item for item in measured if item.bands["1000"].center_nm is not None]
    for item in shown:
        _draw_spectrum(axes, item, named=len(shown) <= MOST_NAMES)
    axes.set_xlim(*X_NM)
    axes.set_ylim(*Y_NM)
    axes.set_xlabel("centre of the 1 µm band [nm]")
    axes.set_ylabel("centre of the 2 µm band [nm]")
    axes.set_title(f"{len(shown)} of {len(measured)} spectra; bars: noise, continuum and calibration", fontsize=10)
    yield figure


def _draw_fields(axes: Any) -> None:
    from matplotlib.patches import Polygon

    for (name, corners, place), color in zip(FIELDS, COLORS, strict=True):
        axes.add_patch(Polygon(corners, closed=True, facecolor=color, alpha=0.12, edgecolor="none"))
        axes.annotate(name, place, fontsize=8, color=color)
    low, high = OLIVINE_NM
    axes.axvspan(low, high, ymax=0.075, facecolor=OLIVINE_COLOR, alpha=0.2)
    axes.text((low + high) / 2, BELOW_NM + 30, "olivine\n(no 2 µm band)", ha="center", fontsize=8, color=OLIVINE_COLOR)
    axes.axhline(Y_NM[0] + 0.075 * (Y_NM[1] - Y_NM[0]), color="0.8", linewidth=0.8)
    axes.text(X_NM[0] + 2, BELOW_NM, "no 2 µm band", va="center", fontsize=8, color="0.5")


def _draw_trend(axes: Any) -> None:
    poor = [anchor for anchor in anchors() if anchor.wo == 0]
    rich = [anchor for anchor in anchors() if anchor.wo > 0]
    for items in (poor, rich):
        axes.plot(*_centres(items), "o-", color="0.55", markersize=4, linewidth=1, zorder=1)
        for anchor in items:
            text = f"Fs {anchor.fs:g}" if anchor.wo == 0 else f"Wo {anchor.wo:g}"
            axes.annotate(
                text, (anchor.bc1000_nm, anchor.bc2000_nm), xytext=(-6, 2), textcoords="offset points",
                ha="right", fontsize=7, color="0.45",
            )  # fmt: skip


def _centres(items: Sequence[Anchor]) -> tuple[list[float], list[float]]:
    return [item.bc1000_nm for item in items], [item.bc2000_nm for item in items]


def _draw_spectrum(axes: Any, item: SpectrumBands, *, named: bool) -> None:
    one, two = item.bands["1000"], item.bands["2000"]
    has_second = two.center_nm is not None
    x, y = one.center_nm, two.center_nm if has_second else BELOW_NM
    axes.errorbar(
        x, y, xerr=error_nm(one), yerr=error_nm(two) if has_second else None, fmt="o" if has_second else "v",
        color="black", markersize=4, linewidth=0.8, zorder=3,
    )  # fmt: skip
    if named:
        axes.annotate(item.id, (x, y), xytext=(5, 4), textcoords="offset points", fontsize=7, clip_on=True)
