"""Pictures of tracks, rocks, merged maps, elevation models, calibrated cameras and ties of stations."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Patch

from lunarsci.arrays import FloatArray
from lunarsci.figure import COLORS, DOT_STYLES, INK, LINE_STYLES, VERMILION, as_label, headline, legend_below, page
from lunarsci.images.calibration import CameraCalibration
from lunarsci.images.camera import Pose
from lunarsci.images.elevation import ElevationModel, MergedMap
from lunarsci.images.localisation import Localised
from lunarsci.images.matching import MATCHED, REASONS, StereoMatches
from lunarsci.images.rocks import RockSurvey
from lunarsci.images.tracks import TrackDepths, TrackProfile, places_on, unrolled

MARK, BAND = VERMILION, "#9fb4c0"
REASON_COLOURS = ("#ffffff", "#bcc4c8", "#f6e27a", "#000000", "#e08f3c", "#7a1f8f", "#3f74c9", "#003d2e")
"""Of `REASONS` in their order; in grey each is by a tenth lighter or darker than the next."""
LONG = 0.08
"""Length of the arrow of a residual of three standard deviations, as a share of the picture's width."""
ARROW = 30.0
"""Residuals are drawn so many times as long."""


def _map(axes: Axes, model: ElevationModel, values: FloatArray, label: str, **look: Any) -> None:
    """Draw values (ny, nx) at the nodes of a model, with a bar of colours."""
    picture = axes.imshow(values, extent=model.extent_m, origin="lower", interpolation="nearest", **look)
    axes.figure.colorbar(picture, ax=axes, label=label, shrink=0.85)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_facecolor("#c9c9c9")


def track_page(model: ElevationModel, line: FloatArray, width_m: float, depths: TrackDepths) -> Figure:
    """Where the track is, its depth along it with errors, and the mean profile across."""
    figure = page(7.6)
    headline(figure, f"track on {as_label(model.name)}", synthetic=model.synthetic)
    axes: Any = figure.subplots(3, 1, height_ratios=(1.3, 1, 1))
    reach = 4 * width_m
    level = 1e3 * model.less_plane()
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


def _along(axes: Axes, depths: TrackDepths) -> None:
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


def _across(axes: Axes, model: ElevationModel, line: FloatArray, width_m: float, depths: TrackDepths) -> None:
    """Draw the mean profile across the track over the plane of the ground beside it."""
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


def rocks_page(model: ElevationModel, survey: RockSurvey) -> Figure:
    """Rocks on the heights over the ground, and the share found by diameter."""
    figure = page(4.3)
    headline(figure, f"rocks on {as_label(model.name)}", synthetic=model.synthetic)
    axes: Any = figure.subplots(1, 2, width_ratios=(2, 1))
    above = 1e3 * model.less_plane()
    high = max(float(np.nanpercentile(np.abs(above), 99)), 1e-3)
    _map(axes[0], model, above, "height over the plane [mm]", cmap="cividis", vmin=-high, vmax=high)
    turn = np.linspace(0, 2 * np.pi, 40)
    for rock in survey.rocks:
        around = rock.keepout_m * np.cos(turn) + rock.x_m, rock.keepout_m * np.sin(turn) + rock.y_m
        axes[0].plot(*around, color=MARK, lw=1.0)
    axes[0].set_title(f"{len(survey.rocks)} rocks and what to keep away from")
    for k, start in enumerate(sorted({entry.range_from_m for entry in survey.completeness})):
        rows = [entry for entry in survey.completeness if entry.range_from_m == start]
        size, share = [e.diameter_m for e in rows], [e.share for e in rows]
        bars = np.maximum([[e.share - e.share_low for e in rows], [e.share_high - e.share for e in rows]], 0.0)
        label = f"at {start:g} to {rows[0].range_to_m:g} m"
        axes[1].errorbar(size, share, bars, label=label, **DOT_STYLES[k % len(DOT_STYLES)])
    axes[1].set(xscale="log", ylim=(-0.03, 1.03), xlabel="diameter [m]", ylabel="share found [-]")
    sizes = sorted({entry.diameter_m for entry in survey.completeness})
    axes[1].set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes[1].set_xticks([], minor=True)
    legend_below(figure, axes[1], 2)
    return figure


def merge_page(merged: MergedMap) -> Figure:
    """The merged heights, their errors, how many models there are, and where these disagree."""
    model = merged.model
    figure = page(6.4)
    headline(figure, f"map of {as_label(model.name, 60)}", synthetic=model.synthetic)
    axes: Any = figure.subplots(2, 2)
    _map(axes[0, 0], model, model.less_plane(), "height less its plane [m]", cmap="cividis")
    errors = 1e3 * np.hypot(model.layer("height_m_sigma"), model.layer("height_m_common_sigma"))
    high = float(np.nanpercentile(errors, 98))
    _map(axes[0, 1], model, errors, "error, random and common [mm]", cmap="viridis", vmin=0, vmax=high)
    count = np.where(model.layer("count") > 0, model.layer("count"), np.nan)
    _map(axes[1, 0], model, count, "models [-]", cmap="Blues", vmin=0)
    _map(axes[1, 1], model, merged.z_score, "disagreement [standard errors]", cmap="RdBu_r", vmin=-4, vmax=4)
    return figure


def dem_figure(model: ElevationModel, matches: StereoMatches, pose: Pose) -> Figure:
    """Picture with disparities, reasons where there is none, heights, and random and common errors."""
    figure = page(5.9)
    axes = figure.subplots(2, 3)
    title = f"{as_label(model.name)}: {matches.shares()['matched']:.0%} of the pixels matched"
    headline(figure, title, synthetic=model.synthetic)
    low, high = np.percentile(matches.left, [0.5, 99.5])
    axes[0, 0].imshow(matches.left, cmap="gray", vmin=low, vmax=high)
    axes[0, 0].set_title("left picture, rectified")
    disparity = axes[0, 1].imshow(matches.disparity, cmap="viridis", interpolation="nearest")
    axes[0, 1].set_title("disparity")
    for axis in axes[0]:
        axis.set_axis_off()
    bar: Any = {"orientation": "horizontal", "shrink": 0.85, "aspect": 25}
    figure.colorbar(disparity, ax=axes[0, 1], label="disparity [px]", **bar)
    _reasons(axes[0, 2], matches)
    for axis, key, title, unit, colours in (
        (axes[1, 0], "height_m", "height", "m", "cividis"),
        (axes[1, 1], "height_m_sigma", "random error", "mm", "viridis"),
        (axes[1, 2], "height_m_common_sigma", "common error", "mm", "viridis"),
    ):
        values = model.layer(key) * (1e3 if unit == "mm" else 1.0)
        low, high = np.nanpercentile(values, [2, 98])
        heights = axis.imshow(values, origin="lower", extent=model.extent_m, cmap=colours, vmin=low, vmax=high)
        axis.plot(*pose.center_m[:2], marker="^", color=COLORS[1], markeredgecolor="white", clip_on=False)
        axis.set(title=title, xlabel="x [m]", ylabel="y [m]")
        figure.colorbar(heights, ax=axis, label=f"{title} [{unit}]", **bar)
    return figure


def _reasons(axis: Axes, matches: StereoMatches) -> None:
    axis.imshow(matches.reason, cmap=ListedColormap(REASON_COLOURS), vmin=-0.5, vmax=len(REASONS) - 0.5)
    axis.set_title("why there is no disparity")
    shares = list(matches.shares().values())
    handles = [
        Patch(facecolor=colour, edgecolor="0.5", label=f"{name} {share:.1%}")
        for colour, name, share in zip(REASON_COLOURS, REASONS, shares, strict=True)
        if share >= 0.0005 or name == REASONS[MATCHED]
    ]
    axis.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.03), frameon=False, ncols=2)


def calibration_page(result: CameraCalibration, name: str) -> Figure:
    """Residuals of each camera over its picture, on how uncertain directions are, and residuals by moment."""
    count = len(result.cameras)
    figure = page(6.0 if count > 1 else 3.6)
    headline(figure, f"{as_label(name, 60)}: residuals {result.residual_px:.3f} px")
    axes: Any = figure.subplots(2, 2) if count > 1 else figure.subplots(1, 2)[None]
    for k in range(count):
        _calibration_residuals(figure, axes[0, k], result, k)
        _by_moment(axes[1, k] if count > 1 else axes[0, 1], result, k)
    legend_below(figure, axes.flat)
    return figure


def _calibration_residuals(figure: Figure, axis: Axes, result: CameraCalibration, index: int) -> None:
    camera, rows = result.cameras[index], result.residuals[index]
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, 25), np.linspace(0, camera.height_px - 1, 21))
    uncertain = result.uncertainty_px(index, np.stack([u.ravel(), v.ravel()], axis=-1)).reshape(u.shape)
    top = float(np.nanpercentile(uncertain, 98))
    shown = axis.pcolormesh(u, v, uncertain, cmap="Blues", vmin=0, vmax=top, shading="gouraud")
    figure.colorbar(shown, ax=axis, orientation="horizontal", label="uncertainty of a direction [px]", shrink=0.8)
    scale = 3 * result.residual_px / (LONG * camera.width_px)
    arrows = axis.quiver(
        *rows[:, 1:].T, angles="xy", scale_units="xy", scale=scale, width=0.002, color=MARK, headwidth=3
    )
    axis.quiverkey(arrows, 0.85, 1.03, 3 * result.residual_px, f"{3 * result.residual_px:.2f} px", labelpos="E")
    axis.set(xlim=(0, camera.width_px), ylim=(camera.height_px, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    axis.set_title(f"{camera.name}: {len(rows)} points", loc="left")


def _by_moment(axis: Axes, result: CameraCalibration, index: int) -> None:
    rows = result.residuals[index]
    moments = np.unique(rows[:, 0]).astype(int)
    rms = [float(np.sqrt(np.mean(rows[rows[:, 0] == k, 3:] ** 2))) for k in moments]
    axis.bar(moments + 1, rms, color=INK)
    axis.axhline(result.residual_px, color=MARK, lw=1, label="all pictures")
    axis.set(xlabel="picture, in the order given [-]", ylabel="rms of residuals [px]")
    axis.set_title(result.cameras[index].name, loc="left")


def range_page(
    names: Sequence[str], ranges_m: FloatArray, random_m: Sequence[FloatArray], common_m: Sequence[FloatArray]
) -> Figure:
    """Random and common error of the range of a single point, by its range."""
    figure = page(4.0 + 0.15 * 2 * len(names), 5.6)
    axis: Any = figure.subplots()
    for k, name in enumerate(names):
        look: Any = LINE_STYLES[k % len(LINE_STYLES)]
        axis.plot(ranges_m, 1e3 * random_m[k], label=f"{as_label(name)}: random", **look)
        if (common_m[k] > 0).any():
            axis.plot(ranges_m, 1e3 * common_m[k], marker=".", label=f"{as_label(name)}: common", **look)
    axis.set(xscale="log", yscale="log", xlabel="range [m]", ylabel="error of the range, one standard deviation [mm]")
    axis.set_xticks([1, 2, 3, 5, 10, 20], ["1", "2", "3", "5", "10", "20"])
    axis.set_xticks([], minor=True)
    axis.grid()
    legend_below(figure, axis, 2)
    return figure


def ties_figure(result: Localised, number: int, *, synthetic: bool = False) -> Figure:
    """Picture of one pair's ties: in the farther and the nearer left picture, residuals, and a plan of stations."""
    pair, adjusted = result.pairs[number], result.adjusted
    far, near = result.stations[pair.far], result.stations[pair.near]
    figure = page(7.2)
    parts: Any = figure.subfigures(2, 1)
    above, below = parts
    (left, right), (residuals, plan) = above.subplots(1, 2), below.subplots(1, 2)
    title = f"{as_label(far.name)} and {as_label(near.name)}: {len(pair.ties.correlation)} ties"
    headline(figure, f"{title}; a tie has the same colour in both pictures", synthetic=synthetic)
    colours = np.arange(len(pair.ties.correlation), dtype=float)
    _ties_picture(left, far.matches.left, pair.ties.far_px, colours, f"{as_label(far.name)}, from afar")
    _ties_picture(right, near.matches.left, pair.ties.near_px, colours, f"{as_label(near.name)}, from near")
    off = adjusted.residual_px[number]
    _ties_residuals(residuals, pair.ties.far_px, off, adjusted.weights[number])
    _plan(plan, result)
    legend_below(below, plan, 2)
    return figure


def _ties_picture(axis: Axes, light: FloatArray, places: FloatArray, colours: FloatArray, title: str) -> None:
    """Draw a picture (h, w) with ties at (u, v) (n, 2) [px], coloured by numbers (n,)."""
    low, high = np.percentile(light, [0.5, 99.5])
    axis.imshow(np.sqrt(np.clip(light, 0, high)), cmap="gray", vmin=np.sqrt(max(low, 0)), vmax=np.sqrt(high))
    axis.scatter(places[:, 0], places[:, 1], c=colours, s=14, cmap="viridis", edgecolors="white", linewidths=0.5)
    axis.set_title(title)
    axis.set_axis_off()


def _ties_residuals(axis: Axes, places: FloatArray, off: FloatArray, weights: FloatArray) -> None:
    """Draw residuals (n, 2) [px] as arrows at their places (u, v) (n, 2) [px], coloured by weight (n,)."""
    shown = axis.quiver(
        *places.T, *(ARROW * off).T, weights, angles="xy", scale_units="xy", scale=1, cmap="viridis", clim=(0, 1)
    )
    axis.invert_yaxis()
    axis.set(xlabel="u [px]", ylabel="v [px]")
    axis.set_title(f"residuals, {ARROW:g} times as long; median {np.median(np.linalg.norm(off, axis=1)):.2f} px")
    axis.figure.colorbar(shown, ax=axis, orientation="horizontal", label="weight of the tie [-]", shrink=0.8)


def _plan(axis: Axes, result: Localised) -> None:
    """Stations by dead reckoning and by ties, with ellipses of 95 %, drawn larger where they would not be seen."""
    reckoned = np.array([s.pose.center_m[:2] for s in result.stations])
    now = np.array([p.center_m[:2] for p in result.poses])
    axis.plot(*reckoned.T, "o--", color="0.5", label="dead reckoning")
    axis.plot(*now.T, "^-", color=COLORS[1], label="by ties")
    for k in range(1, len(now)):
        covariance = result.covariance[6 * k - 3 : 6 * k - 1, 6 * k - 3 : 6 * k - 1]
        sizes, ways = np.linalg.eigh(covariance)
        turn = np.degrees(np.arctan2(ways[1, 1], ways[0, 1]))
        width, height = 2 * 2.448 * np.sqrt(np.maximum(sizes[::-1], 0)) * 10
        axis.add_patch(Ellipse(tuple(now[k]), width, height, angle=turn, fill=False, color=COLORS[1]))
    axis.set(xlabel="x [m]", ylabel="y [m]", title="left cameras; ellipses of 95 %, ten times as large")
    axis.set_aspect("equal", adjustable="datalim")
