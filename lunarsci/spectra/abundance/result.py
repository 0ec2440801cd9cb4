"""Mineral modes with intervals: one result type for every method, and their picture.

The picture has one row for each spectrum and one panel for each mineral.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import as_label, headline, page
from lunarsci.minerals import WITH_BANDS
from lunarsci.spectra.mgm.figure import COLORS, OTHER

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VALUE_AND_ENDS = ("fraction", "low", "high", "low95", "high95")
"""Fields of a `MineralFraction` that a row of a picture shows, and its keys of JSON: the share, then the ends of its 68
and 95 % intervals."""


@dataclass(frozen=True, slots=True)
class MineralFraction:
    """Share of one mineral: the mean of its posterior, and intervals of 68 and 95 % about it.

    By volume; of `nbsr` in pyroxene, with central intervals. `fraction` is the mean: means of all minerals sum to 1. It
    is NaN where the share is not determined: there is an interval, and no centre. `median` is that of the same
    posterior, NaN where the method has none; `present` the probability of more than 5 %, NaN likewise. [-]
    """

    mineral: str
    fraction: float
    low: float
    high: float
    low95: float
    high95: float
    present: float = math.nan
    median: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Abundance:
    """Modes of a spectrum.

    Attributes
    ----------
    id, method : of the spectrum, and how it was found.
    fractions : by mineral; they sum to 1 over the minerals that the method can see.
    in_domain : whether the spectrum is of the kind for which the method was tested.
    status : a sentence; why not, where it is not.
    rms_ln : misfit of ln R, root mean square, None for a method that fits none. [-]
    learned : weight of the networks' estimate beside that of mixed end members; None of other methods. [-]
    ratios : of a solid rock, shares of one mineral in several.
    prior : of the shares; of `unmix`, the powders that networks learned from where none is named, None of others.
    returned : with the prior of returned lunar rocks, the probability that this is one like them. [-]
    """

    id: str
    method: str
    fractions: tuple[MineralFraction, ...]
    in_domain: bool
    status: str
    rms_ln: float | None
    learned: float | None = None
    ratios: tuple[MineralFraction, ...] = ()
    prior: str | None = None
    returned: float | None = None

    @property
    def determined(self) -> bool:
        """Whether any share has a value, and not an interval alone."""
        return any(math.isfinite(item.fraction) for item in self.fractions)

    @property
    def not_weighed(self) -> list[str]:
        """Minerals that may be there and were not looked for: shares are of the others alone."""
        return [mineral for mineral in WITH_BANDS if mineral not in {item.mineral for item in self.fractions}]

    def to_dict(self) -> dict[str, Any]:
        """The key `abundance` of `lunarsci spectra fit --json` and `lunarsci spectra unmix --json`."""
        shares = {item.mineral: _values(item) for item in self.fractions}
        return {
            "method": self.method,
            "in_domain": self.in_domain,
            "not_weighed": self.not_weighed,
            "status": self.status,
            "rms_ln": self.rms_ln,
            "learned": self.learned,
            "prior": self.prior,
            "returned": self.returned,
            "ratios": {item.mineral: _values(item) for item in self.ratios},
            "published": BOULDERS if self.ratios else None,
        } | shares


def _values(item: MineralFraction) -> dict[str, float]:
    """The numbers of a share as JSON has them."""
    median = item.fraction if math.isnan(item.median) else item.median
    return {name: getattr(item, name) for name in (*VALUE_AND_ENDS, "present")} | {"median": median}


def open_share(name: str) -> MineralFraction:
    """A share, or a ratio, that may be anything."""
    return MineralFraction(name, math.nan, 0.0, 1.0, 0.0, 1.0)


def refused(id: str, method: str, minerals: Sequence[str], reason: str) -> Abundance:
    """Shares that may be anything, since a method does not apply to a spectrum."""
    fractions = tuple(open_share(mineral) for mineral in minerals)
    return Abundance(id, method, fractions, False, f"not determined: {reason}", None)


PER_PAGE = 40
"""Rows of a page."""
BOULDERS = "Chang'E-4 boulders by Ding et al. (2024), 10.1038/s41467-024-46233-8: OPX 46 % of pyroxene, olivine 20-30 %"
"""What is published of solid rocks seen by a rover, to be set beside their ratios."""


def share_pages(abundances: Sequence[Abundance]) -> "Iterator[Figure]":
    """Shares in per cent; spectra outside the domain of the method have open circles, what is not determined none."""
    panels = []
    for mineral in dict.fromkeys(item.mineral for one in abundances for item in one.fractions):
        color, bars = COLORS.get(mineral, OTHER), []
        for one in abundances:
            shares = [item for item in one.fractions if item.mineral == mineral]
            face = color if one.in_domain else "white"
            values = [getattr(shares[0], name) for name in VALUE_AND_ENDS] if shares else []
            bars.append((100 * np.array(values), color, face) if shares else None)
        panels.append(BarPanel({"title": mineral, "xlabel": "share [%]", "xlim": (-3, 103)}, bars))
    text = "bars: 68 and 95 %; open: outside the domain; no dot: not determined"
    return bar_pages([one.id for one in abundances], panels, f"mineral shares by {abundances[0].method}; {text}")


Bar: TypeAlias = tuple[FloatArray, str, str] | None
"""Value, low, high, low95 and high95 of a row, (5,), in the unit of its panel; colours of bar and dot. None: no bar."""


class BarPanel(NamedTuple):
    """A panel's properties (`Axes.set`), and the bar of each row."""

    looks: dict[str, Any]
    bars: Sequence[Bar]


def bar_pages(names: Sequence[str], panels: Sequence[BarPanel], text: str) -> "Iterator[Figure]":
    """A row for each name: a dot, and bars of 68 and 95 %; `PER_PAGE` rows a page."""
    for start in range(0, len(names), PER_PAGE):
        labels = names[start : start + PER_PAGE]
        figure = page(1.4 + 0.2 * len(labels))
        drawn = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axes, (looks, bars) in zip(drawn, panels, strict=True):
            for row, bar in enumerate(bars[start : start + PER_PAGE]):
                _draw(axes, row, bar)
            axes.set(**looks)
            axes.grid(axis="x", color="0.9")
        drawn[0].set_yticks(np.arange(len(labels)), [as_label(name, 28) for name in labels])
        drawn[0].set_ylim(len(labels) - 0.5, -0.5)
        headline(figure, text)
        yield figure


def _draw(axes: Any, row: int, bar: Bar) -> None:
    """The bar of a row, its dot on both intervals."""
    if bar is None:
        return
    (value, low, high, low95, high95), color, face = bar
    for ends, width in (((low95, high95), 1.0), ((low, high), 3.5)):
        axes.plot(ends, [row, row], color=color, linewidth=width, solid_capstyle="butt")
    axes.plot(value, row, "o", color=color, markerfacecolor=face, markersize=5)
