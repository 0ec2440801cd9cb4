"""The picture of a prediction beside what happened: paths, ends, wheel states in their bands, and ranks."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.figure import COLORS, INK, as_label, headline, legend_below, page
from lunarsci.twin.assimilation.residuals import OBSERVED
from lunarsci.twin.comparison.forecast import MatchedObservations
from lunarsci.twin.comparison.scores import NOMINAL, half_band, ranks, region_ellipse, standardised
from lunarsci.twin.comparison.verdict import DriveComparison
from lunarsci.twin.drives.replay import TrialScore
from lunarsci.twin.figures.panels import ACCENT, GOLD, LABELS, LIMIT, wheel_dots
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS

MOST_PATHS, MOST_POINTS = 200, 1500
DRAWN_REGIONS = (0.5, 0.9, 0.95)
MEASURED = "#111111"
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (7, 2)))


def comparison_figure(
    matched: MatchedObservations, comparison: DriveComparison, title: str, verdict: str = ""
) -> Figure:
    """Paths and ends above, wheel states below them, ranks and standardised differences last.

    Bands span p05 to p95 over members and wheels; a measured state with a ring is outside of the 90 % band of its own
    wheel and moment, in which its error counts. Regions of the ends hold the errors of the last position, too. In the
    title stands `verdict`, or that of what was found.
    """
    names = matched.measured_quantities()
    rows = -(-len(names) // 2)
    figure = page(2.9 + 1.35 * rows + (0.5 if rows else 0.0) + 1.9)
    ratios = (2.9, 1.35 * rows + 0.5, 1.9) if rows else (2.9, 1.9)
    parts: Any = figure.subfigures(len(ratios), 1, height_ratios=ratios)
    paths, end = parts[0].subplots(1, 2)
    _draw_paths(paths, matched)
    _draw_end(end, matched, comparison)
    below = parts[-1].subplots(1, 2)
    _draw_standard(below[0], matched, names)
    _draw_ranks(below[1], matched, names)
    if names:
        panels = parts[1].subplots(rows, 2, sharex=True, squeeze=False).ravel()
        for panel, name in zip(panels, names, strict=False):
            _draw_states(panel, matched, name)
            panel.set_xlabel("time [s]")
            panel.label_outer(remove_inner_ticks=False)
            panel.set_ylabel(LABELS[name][0])
            panel.tick_params(labelleft=True)
        for panel in panels[len(names) :]:
            panel.remove()
        panels[len(names) - 1].tick_params(labelbottom=True)
        panels[len(names) - 1].set_xlabel("time [s]")
        parts[1].legend(handles=_handles(matched), loc="outside lower center", ncols=4, frameon=False)
        legend_below(parts[-1], below[0], 6)
    color = LIMIT if comparison.reasons else INK
    reason = f": {comparison.reasons[0]}" if comparison.reasons else ""
    others = len(comparison.reasons) - 1
    more = f" (and {others} more {'reason' if others == 1 else 'reasons'})" if others > 0 else ""
    text = f"{title}\n{(verdict or comparison.verdict).upper()}{reason}{more}"
    headline(figure, text, synthetic=matched.forecast.synthetic, color=color)
    return figure


def _shown(matched: MatchedObservations) -> IntArray:
    count = len(matched.members)
    return matched.members[np.unique(np.linspace(0, count - 1, min(count, MOST_PATHS)).astype(np.int64))]


def _draw_paths(axes: Axes, matched: MatchedObservations) -> None:
    """The fan, the plan, and the measured positions with a thin line between them."""
    forecast, record = matched.forecast, matched.record
    for number, member in enumerate(_shown(matched)):
        path = forecast.paths[member]
        label = "predicted" if number == 0 else None
        axes.plot(path[:, 0], path[:, 1], color=ACCENT, linewidth=0.6, alpha=0.35, label=label)
    axes.plot(*forecast.planned[:, :2].T, color=LIMIT, linewidth=1.2, linestyle=(0, (5, 2)), label="planned")
    axes.plot(*forecast.planned[0, :2], "o", color="white", markeredgecolor=INK, markersize=6, zorder=6)
    if len(record.fix_m):
        order = np.argsort(record.fix_time_s)
        look: Any = {"color": MEASURED, "linewidth": 0.9, "markersize": 4, "zorder": 5}
        axes.plot(*record.fix_m[order].T, "o-", label="measured", **look)
    _frame_map(axes)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=3, frameon=False)
    axes.set_title("paths of the rover's origin")


def _frame_map(axes: Axes) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _draw_end(axes: Axes, matched: MatchedObservations, comparison: DriveComparison) -> None:
    """The predicted places at the last position, their regions, the plan and what was measured."""
    if comparison.end is None:
        axes.text(0.5, 0.5, "no positions were measured", ha="center", va="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    last = int(matched.record.fix_time_s.argmax())
    members, error = matched.places[:, last], matched.place_error_m2[last]
    axes.plot(*members.T, "o", color=ACCENT, markersize=3, alpha=0.6, linewidth=0, label="predicted")
    for share, style in zip(DRAWN_REGIONS, ((0, (1, 1.5)), "-", "--"), strict=True):
        ring = region_ellipse(members, error, share)
        if ring is not None:
            size = (2.0 * ring.semi_major_m, 2.0 * ring.semi_minor_m)
            look: Any = {"fill": False, "edgecolor": INK, "linewidth": 1.2, "linestyle": style}
            axes.add_patch(Ellipse(tuple(members.mean(axis=0)), *size, angle=ring.azimuth_deg, **look))
            axes.plot([], [], color=INK, linewidth=1.2, linestyle=style, label=f"region of {100 * share:g} %")
    end = comparison.end
    axes.plot(end.planned_x_m, end.planned_y_m, "*", color=GOLD, markeredgecolor=INK, markersize=13, label="planned")
    sd = np.sqrt(np.diag(matched.record.fix_covariance_m2[last]))
    dot: Any = {
        "color": LIMIT if comparison.end.standing and not end.regions.get("99", True) else MEASURED,
        "zorder": 6,
    }
    axes.errorbar(end.x_m, end.y_m, xerr=sd[0], yerr=sd[1], fmt="o", capsize=3, label="measured, 1 σ", **dot)
    _frame_map(axes)
    axes.margins(0.12)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=3, frameon=False)
    where = "end" if end.at_end else f"last, at {end.time_s:.0f} s"
    standing = "" if end.standing is None else f", {end.standing.distance:.1f} sd"
    axes.set_title(f"{where}: {end.error_m:.3f} m from the middle{standing}")


def _draw_states(axes: Axes, matched: MatchedObservations, name: str) -> None:
    """Band over members and wheels, and the measured states by wheel, those outside of their own band in red."""
    label, factor = LABELS.get(name, (name, 1.0))
    forecast, column = matched.forecast, OBSERVED.index(name)
    values = factor * forecast.states[matched.members][..., STATE_COLUMNS.index(name)]
    values[:, forecast.halted] = np.nan
    low, middle, high = _percentiles(values)
    axes.fill_between(forecast.time_s, low, high, color=ACCENT, alpha=0.22, linewidth=0)
    axes.plot(forecast.time_s, middle, color=ACCENT, linewidth=1.4)
    rows = matched.counted[:, column]
    outside = np.abs(standardised(matched, column, rows)) > half_band(len(matched.members))
    time, measured = matched.record.time_s[rows], factor * matched.record.values[rows, column]
    wheel = np.array([forecast.wheels.index(one) for one in matched.record.wheel])[rows]
    every = max(1, len(time) // MOST_POINTS)
    for number in range(len(forecast.wheels)):
        subset = np.flatnonzero(wheel == number)[::every]
        axes.plot(time[subset], measured[subset], markersize=2.6, alpha=0.85, linewidth=0, **wheel_dots(number))
        red = subset[outside[subset]]
        ring: Any = {"markerfacecolor": "none", "markeredgecolor": LIMIT, "markersize": 6, "linewidth": 0}
        axes.plot(time[red], measured[red], "o", **ring)
    check = next(one for one in _together(matched, name))
    axes.set_title(check, loc="right")
    axes.set_ylabel(label)
    axes.set_xlim(float(forecast.time_s[0]), float(forecast.time_s[-1]))
    axes.grid()


def _together(matched: MatchedObservations, name: str) -> list[str]:
    column = OBSERVED.index(name)
    standard = standardised(matched, column, matched.counted[:, column])
    share = float((np.abs(standard) <= half_band(len(matched.members))).mean())
    return [f"{100 * share:.0f} % of {len(standard)} values in their {100 * NOMINAL:.0f} % bands"]


def _percentiles(values: FloatArray) -> FloatArray:
    """p05, p50, p95 over members and wheels at each sample, NaN at halts. (3, samples)"""
    rows = np.full((3, values.shape[1]), np.nan)
    for sample in range(values.shape[1]):
        subset = values[:, sample][np.isfinite(values[:, sample])]
        if subset.size:
            rows[:, sample] = np.percentile(subset, (5, 50, 95))
    return rows


def _handles(matched: MatchedObservations) -> list[Any]:
    ring: Any = {"markerfacecolor": "none", "markeredgecolor": LIMIT, "markersize": 6, "linewidth": 0}
    handles: list[Any] = [
        Patch(facecolor=ACCENT, alpha=0.22, label="predicted, p05 to p95, without errors of measurement"),
        Line2D([], [], marker="o", label="outside its own 90 % band, which has them", **ring),
    ]
    for number, wheel in enumerate(matched.forecast.wheels):
        handles.append(Line2D([], [], markersize=4, linewidth=0, label=as_label(wheel), **wheel_dots(number)))
    return handles


def _draw_standard(axes: Axes, matched: MatchedObservations, names: list[str]) -> None:
    """Standardised differences of the states beside the normal law that they should have, on the whole."""
    edges = np.linspace(-5.0, 5.0, 26)
    for number, name in enumerate(names):
        column = OBSERVED.index(name)
        values = np.clip(standardised(matched, column, matched.counted[:, column]), -4.99, 4.99)
        look: Any = {"histtype": "step", "linewidth": 1.5, "color": COLORS[number % 6], "linestyle": DASHES[number % 6]}
        axes.hist(values, bins=list(edges), density=True, label=_short(name), **look)
    x = np.linspace(-5.0, 5.0, 200)
    axes.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi), color=INK, linewidth=0.7)
    axes.set(xlabel="measured less predicted [standard deviations]", ylabel="share [-]")
    axes.set_title("thin: if all is right")
    axes.set_yticks([])


def _draw_ranks(axes: Axes, matched: MatchedObservations, names: list[str]) -> None:
    """How the measured states rank in what was predicted: even, over many drives, if the prediction is right."""
    for number, name in enumerate(names):
        look: Any = {"histtype": "step", "linewidth": 1.5, "color": COLORS[number % 6], "linestyle": DASHES[number % 6]}
        axes.hist(ranks(matched, name), bins=list(np.linspace(0.0, 1.0, 11)), density=True, label=_short(name), **look)
    axes.axhline(1.0, color=INK, linewidth=0.7)
    axes.set_xlim(0.0, 1.0)
    axes.set(xlabel="rank in the prediction [-]", ylabel="share [-]")
    axes.set_title("one drive shares one soil: uneven is not wrong")
    axes.set_yticks([])


def _short(name: str) -> str:
    return LABELS[name][0].partition(" [")[0]


def trials_figure(trials: Sequence[TrialScore], title: str, *, synthetic: bool = False) -> Figure:
    """Median slip of each trial as measured and predicted, and errors of the ends from the smallest on."""
    figure = page(3.2)
    slips, ends = figure.subplots(1, 2)
    scores = [trial.scores["slip_ratio"] for trial in trials if "slip_ratio" in trial.scores]
    pairs = np.array([(score.measured, score.predicted) for score in scores], dtype=float).reshape(-1, 2)
    slips.plot(pairs[:, 0], pairs[:, 1], "o", color=ACCENT, label="the twin")
    slips.plot(pairs[:, 0], 0.0 * pairs[:, 0], "x", color=GOLD, label="wheels alone")
    slips.axline((0.0, 0.0), slope=1.0, color=INK, linewidth=0.8)
    slips.set(xlabel="measured slip ratio [-]", ylabel="predicted slip ratio [-]")
    for part, mark, color in (("off", "o-", ACCENT), ("off_alone", "x-", GOLD)):
        errors = np.sort(
            [float(getattr(trial.scores["end_m"], part)[0]) for trial in trials if "end_m" in trial.scores]
        )
        ends.plot(np.arange(1, len(errors) + 1), errors, mark, color=color)
    ends.set(xlabel="trial, smallest error first [-]", ylabel="error of the end [m]")
    ends.xaxis.get_major_locator().set_params(integer=True)
    slips.legend(frameon=False)
    headline(figure, title, synthetic=synthetic)
    return figure
