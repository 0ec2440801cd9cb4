"""Pictures of what is believed of a soil: each parameter before any drive and now, and after each drive."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import INK, headline, legend_below, page
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.belief_history import past_beliefs, rolled_back, shared_drives
from lunarsci.regolith.figure import PARAMETER_LABELS
from lunarsci.regolith.prior import NINETY_FIVE, PARAMETERS, Law

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OWN, OTHER, REFUSED = "#0072B2", "#D55E00", "#26323a"


def belief_history_figure(
    belief: SoilBelief,
    title: str,
    other: SoilBelief | None = None,
    names: tuple[str, str] = ("", ""),
    *,
    synthetic: bool = False,
) -> "Figure":
    """One panel for each parameter; a second belief beside the first where there is one.

    Bars are 68 %; the band is the interval of the priors. Drives from which nothing was learned are crossed. What two
    beliefs share is drawn once, as the first's. States that a file did not keep are left out.
    """
    figure = page(8.2)
    panels: Any = figure.subplots(4, 2, sharex=True)
    most = max(len(belief.history), len(other.history) if other else 0)
    first = 0 if other is None else shared_drives(belief, other) + 1
    for panel, name in zip(panels.ravel(), PARAMETERS, strict=True):
        _, low, high = rolled_back(belief, 0).intervals()[name]
        panel.axhspan(low, high, color=INK, alpha=0.08, linewidth=0, label="the priors")
        _draw(panel, belief, name, (OWN, "o-"), -0.0 if other is None else -0.08, names[0] or "median and 68 %", 0)
        if other is not None:
            _draw(panel, other, name, (OTHER, "s--"), 0.08, names[1], min(first, len(other.history)))
        panel.set_ylabel(PARAMETER_LABELS[name].replace(" [", "\n["))
        panel.grid()
        panel.set_xticks(_ticks(most))
        panel.set_xlim(-0.4, most + 0.4)
    for panel in panels[-1]:
        panel.set_xlabel("after drive [-]")
    legend_below(figure, panels.ravel())
    headline(figure, title, synthetic=synthetic)
    return figure


def _ticks(most: int) -> Sequence[int]:
    return range(0, most + 1, max(1, -(-most // 8)))


def _draw(
    panel: Any, belief: SoilBelief, name: str, style: tuple[str, str], shift: float, label: str, first: int
) -> None:
    kept = [(k, state.intervals()[name]) for k, state in enumerate(past_beliefs(belief)) if state and k >= first]
    drives = [k + shift for k, _ in kept]
    middle = [value for _, (value, _, _) in kept]
    spread = [[v - low for _, (v, low, _) in kept], [high - v for _, (v, _, high) in kept]]
    look: Any = {"color": style[0], "markersize": 4, "linewidth": 1.2, "capsize": 3, "elinewidth": 1.4}
    panel.errorbar(drives, middle, spread, fmt=style[1], label=label, **look)
    lost = [k for k, _ in kept if k and belief.history[k - 1].get("refused")]
    if lost:
        values = [value for k, (value, _, _) in kept if k in lost]
        cross = "nothing was learned"
        panel.plot([k + shift for k in lost], values, "x", color=REFUSED, markersize=8, zorder=5, label=cross)


SOILS = 512
"""Drawn of a belief for its density; where it holds a population, that in turn."""


def belief_figure(belief: SoilBelief, title: str, *, synthetic: bool = False) -> "Figure":
    """What a belief says of the soil: each parameter before any drive and now, as the posterior of `infer`.

    Intervals are those of `SoilBelief.intervals`, the density that of its soils.
    """
    center, width = (np.array([getattr(law, what) for law in belief.laws.values()]) for what in ("center", "width"))
    spread = np.sqrt(np.diag(belief.covariance))
    lines = [belief.mean + k * spread for k in (0.0, -1.0, 1.0, -NINETY_FIVE, NINETY_FIVE)]
    lines += [center + k * width for k in (-NINETY_FIVE, NINETY_FIVE)]
    keys = ("median", "low68", "high68", "low95", "high95", "prior_low95", "prior_high95")
    columns = belief.samples(np.stack(lines)).values()
    rows = [
        {"parameter": name, **dict(zip(keys, column, strict=True)), "shrinkage": 1.0 - left, "determined": False}
        for (name, left), column in zip(belief.sd_ratio.items(), columns, strict=True)
    ]
    soils = belief.draws(SOILS)
    title = f"{title}, doubtful" if belief.doubt else title
    draws = np.stack(list(soils.values()), axis=1)
    return posterior_figure(rows, belief.laws, draws, title, synthetic=synthetic)


def posterior_figure(
    rows: Sequence[Mapping[str, Any]],
    prior: Mapping[str, Law],
    draws: FloatArray,
    title: str,
    *,
    synthetic: bool = False,
) -> "Figure":
    """Prior and posterior density of each parameter; bars are the 68 and 95 % intervals of the posterior.

    Parameters
    ----------
    rows, prior, draws : of a `SoilPosterior`.
    synthetic : whether the states are made up.

    Draws that are all one value have no density: their median and interval alone are drawn.
    """
    from matplotlib.ticker import LogLocator
    from scipy.stats import gaussian_kde

    figure = page(1.9 * -(-len(rows) // 2))
    panels: Any = figure.subplots(-(-len(rows) // 2), 2)
    for k, (panel, row) in enumerate(zip(panels.ravel(), rows, strict=True)):
        name, law = row["parameter"], prior[row["parameter"]]
        ends = law.transformed(np.array([[row[f"{of}low95"], row[f"{of}high95"]] for of in ("prior_", "")]))
        at = np.linspace(ends.min() - 0.25 * np.ptp(ends), ends.max() + 0.25 * np.ptp(ends), 400)
        before = np.exp(-0.5 * ((at - law.center) / law.width) ** 2) / (law.width * np.sqrt(2 * np.pi))
        own = law.transformed(draws[:, k])
        after = gaussian_kde(own)(at) if np.ptp(own) > 0 else np.full(at.size, np.nan)
        values = law.back(at)
        panel.fill_between(values, before, color=INK, alpha=0.15, linewidth=0, label="prior")
        panel.plot(values, after, color=OWN, label="posterior")
        foot = -0.07 * float(np.nanmax([after, before]))
        panel.plot([row["low95"], row["high95"]], [foot] * 2, color=OWN, linewidth=2, label="95 %")
        panel.plot([row["low68"], row["high68"]], [foot] * 2, color=OWN, linewidth=4, label="68 %")
        panel.plot(row["median"], foot, "o", color=OTHER, markersize=4, label="median")
        panel.set_xlabel(PARAMETER_LABELS[name])
        panel.set_yticks([])
        panel.spines["left"].set_visible(False)
        if law.of == "ln":
            panel.set_xscale("log")
            wide = values.max() > 8.0 * values.min()
            panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if wide else (1, 1.5, 2, 3, 5, 7)))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.xaxis.set_minor_formatter("")
        known = "determined" if row["determined"] else f"{100 * (1 - row['shrinkage']):.0f} % of the prior's width"
        panel.set_title(known, loc="left")
    legend_below(figure, panels.ravel()[:1], 5)
    headline(figure, title, synthetic=synthetic)
    return figure
