"""Pictures of tracks, rocks and merged maps."""

from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import DOT_STYLES, INK, as_label, headline, legend_below, page
from lunarsci.images.elevation import ElevationModel
from lunarsci.images.lines import places_on, unrolled
from lunarsci.images.merge import MergedMap
from lunarsci.images.rocks import RockSurvey
from lunarsci.images.tracks import TrackDepths, TrackProfile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARK, BAND = "#D55E00", "#9fb4c0"


def _page(title: str, height_in: float, synthetic: bool) -> "Figure":
    figure = page(height_in)
    headline(figure, title, synthetic=synthetic)
    return figure


def _map(axes: "Axes", model: ElevationModel, values: FloatArray, label: str, **look: Any) -> None:
    picture = axes.imshow(values, extent=model.extent_m, origin="lower", interpolation="nearest", **look)
    axes.figure.colorbar(picture, ax=axes, label=label, shrink=0.85)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_facecolor("#c9c9c9")


def _levelled(model: ElevationModel) -> FloatArray:
    """Heights less their plane. (ny, nx) [m]"""
    x, y = np.meshgrid(model.x_m, model.y_m)
    known = np.isfinite(model.height_m)
    design = np.column_stack([np.ones(int(known.sum())), x[known], y[known]])
    plane = np.linalg.lstsq(design, model.height_m[known], rcond=None)[0]
    return np.asarray(model.height_m - (plane[0] + plane[1] * x + plane[2] * y))


def track_page(model: ElevationModel, line: FloatArray, width_m: float, depths: TrackDepths) -> "Figure":
    """Where the track is, its depth along it with errors, and the mean profile across."""
    figure = _page(f"track on {as_label(model.name)}", 7.6, model.synthetic)
    axes: Any = figure.subplots(3, 1, height_ratios=(1.3, 1, 1))
    reach = 4 * width_m
    level = 1e3 * _levelled(model)
    seen = level[np.isfinite(level)]
    low, high = np.percentile(seen, (1, 99))
    _map(axes[0], model, level, "height less its plane [mm]", cmap="cividis", vmin=low, vmax=high)
    way = np.linspace(depths.distance_m[0], depths.distance_m[-1], 60)
    for side in (-0.5, 0.5):
        edge = places_on(line, way, np.interp(way, depths.distance_m, depths.offset_m) + side * width_m)
        axes[0].plot(*edge.T, color=MARK, lw=1.0)
    low_m, high_m = line.min(axis=0) - reach, line.max(axis=0) + reach
    left, right, bottom, top = model.extent_m
    axes[0].set(xlim=(max(low_m[0], left), min(high_m[0], right)), ylim=(max(low_m[1], bottom), min(high_m[1], top)))
    _along(axes[1], depths)
    _across(axes[2], model, line, width_m, depths)
    return figure


def _along(axes: "Axes", depths: TrackDepths) -> None:
    total = np.hypot(depths.rut_m_random, depths.rut_m_systematic)
    for sigma, colour, label in ((total, "#d5dee3", "with systematic error"), (depths.rut_m_random, BAND, "random")):
        low, high = 1e3 * (depths.rut_m - sigma), 1e3 * (depths.rut_m + sigma)
        axes.fill_between(depths.distance_m, low, high, color=colour, label=f"one sigma, {label}", lw=0)
    axes.plot(depths.distance_m, 1e3 * depths.rut_m, color=INK, marker=".", lw=1, label="depth of the floor")
    for place in depths.distance_m[~depths.determined]:
        axes.axvline(place, color=MARK, lw=0.6, alpha=0.6)
    if not depths.determined.all():
        axes.plot([], [], color=MARK, lw=0.6, label="not determined")
    axes.axhline(0, color=INK, lw=0.5)
    axes.set(xlabel="distance along the line [m]", ylabel="depth [mm]")
    axes.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)


def _across(axes: "Axes", model: ElevationModel, line: FloatArray, width_m: float, depths: TrackDepths) -> None:
    profile = TrackProfile.of_wheel(width_m, float(np.nan_to_num(np.nanmedian(model.layer("resolution_m")))))
    inner, outer = profile.ground_m
    nodes = unrolled(model, line, outer + width_m)
    nodes = nodes.only(
        (nodes.along >= depths.distance_m[0] - width_m) & (nodes.along <= depths.distance_m[-1] + width_m)
    )
    left = nodes.across - np.interp(nodes.along, depths.distance_m, depths.offset_m)
    ground = (np.abs(left) >= inner) & (np.abs(left) <= outer)
    design = np.column_stack([np.ones_like(left), nodes.along, left])
    if ground.sum() > 10:
        rest = 1e3 * (nodes.height - design @ np.linalg.lstsq(design[ground], nodes.height[ground], rcond=None)[0])
        edges = np.arange(-outer - 0.5 * width_m, outer + 0.5 * width_m, max(model.spacing_m, width_m / 30))
        group = np.digitize(left, edges)
        middles = [(np.median(left[group == k]), np.median(rest[group == k])) for k in np.unique(group) if k]
        axes.plot(*np.array(middles).T, color=INK, lw=1.2, label="median of the line")
    axes.axvspan(
        -profile.floor_m, profile.floor_m, facecolor=MARK, edgecolor=MARK, alpha=0.25, lw=0, hatch="//", label="floor"
    )
    for side in (-1, 1):
        label = "ground" if side < 0 else None
        axes.axvspan(side * inner, side * outer, color=BAND, alpha=0.4, lw=0, label=label)
    axes.axhline(0, color=INK, lw=0.5)
    axes.set(xlabel="distance to the left of the middle [m]", ylabel="height over the ground [mm]")
    axes.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)


def rocks_page(model: ElevationModel, survey: RockSurvey) -> "Figure":
    """Rocks on the heights over the ground, and the share found by diameter."""
    figure = _page(f"rocks on {as_label(model.name)}", 4.3, model.synthetic)
    axes: Any = figure.subplots(1, 2, width_ratios=(2, 1))
    above = 1e3 * survey.above_m
    high = max(float(np.nanpercentile(above, 99.5)), 1e-3)
    _map(axes[0], model, above, "height over the ground [mm]", cmap="cividis", vmin=-high, vmax=high)
    turn = np.linspace(0, 2 * np.pi, 40)
    for rock in survey.rocks:
        around = rock.keepout_m * np.cos(turn) + rock.x_m, rock.keepout_m * np.sin(turn) + rock.y_m
        axes[0].plot(*around, color=MARK, lw=1.0)
    axes[0].set_title(f"{len(survey.rocks)} rocks and what to keep away from")
    halves = sorted({float(np.nan_to_num(entry.sigma_from_m)) for entry in survey.completeness})
    for k, start in enumerate(halves):
        rows = [entry for entry in survey.completeness if np.nan_to_num(entry.sigma_from_m) == start]
        size, share = [e.diameter_m for e in rows], [e.share for e in rows]
        bars = np.maximum([[e.share - e.share_low for e in rows], [e.share_high - e.share for e in rows]], 0.0)
        label = f"error of nodes {1e3 * start:.2f} to {1e3 * rows[0].sigma_to_m:.2f} mm"
        axes[1].errorbar(size, share, bars, label=label, **DOT_STYLES[k % len(DOT_STYLES)])
    axes[1].set(xscale="log", ylim=(-0.03, 1.03), xlabel="diameter [m]", ylabel="share found [-]")
    legend_below(figure, axes[1], 3)
    return figure


def merge_page(merged: MergedMap) -> "Figure":
    """The merged heights, their errors, how many models there are, and where these disagree."""
    model = merged.model
    figure = _page(f"map of {as_label(model.name, 60)}", 6.4, model.synthetic)
    axes: Any = figure.subplots(2, 2)
    _map(axes[0, 0], model, _levelled(model), "height less its plane [m]", cmap="cividis")
    errors = 1e3 * np.hypot(model.layer("height_m_sigma"), model.layer("height_m_common_sigma"))
    high = float(np.nanpercentile(errors, 98))
    _map(axes[0, 1], model, errors, "error, random and common [mm]", cmap="viridis", vmin=0, vmax=high)
    count = np.where(model.layer("count") > 0, model.layer("count"), np.nan)
    _map(axes[1, 0], model, count, "models [-]", cmap="Blues", vmin=0)
    _map(axes[1, 1], model, merged.z_score, "disagreement [standard errors]", cmap="RdBu_r", vmin=-4, vmax=4)
    return figure
