"""Figures 5b and 5c of Ding et al. (2024): the plane of the band centres, and fits of the boulders."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.reproduce.numbers import published_value
from lunarsci.reproduce.spectra import SMOOTHED_POINTS, Rocks, high_calcium, low_calcium
from lunarsci.spectra.chemistry.figure import plane_pages
from lunarsci.spectra.mgm.figure import fit_pages

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["spectra_pages"]

PYROXENES = (
    ("low-calcium pyroxene", "lcp", low_calcium, "#0072B2"),
    ("high-calcium pyroxene", "hcp", high_calcium, "#D55E00"),
)
PUBLISHED = "#c0392b"


def spectra_pages(rocks: Rocks | None) -> "Iterator[Figure]":
    """The plane of the centres (Fig. 5b) and, with boulders, the fit of the one that fits best when smoothed (5c)."""
    yield _plane(rocks)
    if rocks is not None:
        best = min(rocks.smoothed, key=lambda fit: fit.rms_ln)
        measured = [fit for fit in rocks.fits if fit.id == best.id]
        smoothed = replace(best, id=f"{best.id} smoothed over {SMOOTHED_POINTS} points")
        for figure in fit_pages([smoothed, *measured]):
            figure.suptitle("Olivine and two pyroxenes after Fig. 5c of Ding et al. (2024)", fontsize=12)
            yield figure


def _plane(rocks: Rocks | None) -> "Figure":
    """Fields and trend, the minerals behind them, what is published as about, and boulders where there are any."""
    figure = next(iter(plane_pages(rocks.bands if rocks else ())))
    axes = figure.axes[0]
    for name, key, centres, color in PYROXENES:
        found = centres()
        axes.plot(*found.T, ".", color=color, alpha=0.45, markersize=6, zorder=0.5, label=f"laboratory: {name}")
        about = published_value(f"{key}-1um"), published_value(f"{key}-2um")
        axes.plot(*about, "*", color=color, markeredgecolor=PUBLISHED, markersize=15, label=f"published: about, {name}")
    if rocks:
        axes.plot([], [], "o", color="black", markersize=4, label="boulders that were given")
    axes.set_xlim(885.0, np.nextafter(1110.0, 0))
    axes.legend(loc="upper left", fontsize=8, framealpha=0.9)
    told = f"boulders' spectra given: {len(rocks.bands)}" if rocks else "no boulders: give their spectra with --rocks"
    axes.set_title(f"Band centres after Fig. 5b of Ding et al. (2024); {told}", fontsize=10)
    return figure
