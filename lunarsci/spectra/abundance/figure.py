"""Picture of mineral shares: one row for each spectrum, one panel for each mineral, with 68 and 95 % intervals."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lunarsci.spectra.abundance.result import Abundance
from lunarsci.spectra.mgm.figure import COLORS

__all__ = ["share_pages"]

PER_PAGE = 40
OTHER = "0.3"


def share_pages(found: Sequence[Abundance]) -> Iterator[Figure]:
    """Shares in per cent; spectra outside the domain of the method have open circles."""
    minerals = list(dict.fromkeys(item.mineral for one in found for item in one.fractions))
    for start in range(0, len(found), PER_PAGE):
        part = found[start : start + PER_PAGE]
        height = 1.6 + 0.24 * len(part)
        figure = Figure(figsize=(2.2 + 2.4 * len(minerals), height), layout="constrained")
        panels = figure.subplots(1, len(minerals), sharey=True, squeeze=False)[0]
        for panel, mineral in zip(panels, minerals, strict=True):
            for row, one in enumerate(part):
                _draw(panel, row, one, mineral)
            panel.set_title(mineral, fontsize=10)
            panel.set_xlim(-2, 102)
            panel.set_xlabel("share [%]")
            panel.grid(axis="x", color="0.9")
        panels[0].set_yticks(np.arange(len(part)), [one.id for one in part], fontsize=8)
        panels[0].set_ylim(len(part) - 0.5, -0.5)
        figure.suptitle(f"mineral shares, {found[0].method}; open: outside the domain of the method", fontsize=9)
        yield figure


def _draw(panel: Any, row: int, one: Abundance, mineral: str) -> None:
    color = COLORS.get(mineral, OTHER)
    for item in one.fractions:
        if item.mineral == mineral:
            for low, high, width in ((item.low95, item.high95, 1.0), (item.low, item.high, 3.5)):
                panel.plot([100 * low, 100 * high], [row, row], color=color, linewidth=width, solid_capstyle="butt")
            face = color if one.in_domain else "white"
            panel.plot(100 * item.fraction, row, "o", color=color, markerfacecolor=face, markersize=5)
