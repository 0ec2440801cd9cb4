"""What was matched in a pair, and the heights and errors that follow."""

from typing import TYPE_CHECKING

import numpy as np

from lunarsci.figure import COLORS, as_label, headline, page
from lunarsci.images.camera import Pose
from lunarsci.images.elevation import ElevationModel
from lunarsci.images.matching import MATCHED, REASONS, StereoMatches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage


REASON_COLOURS = ("#ffffff", "#bcc4c8", "#f6e27a", "#000000", "#e08f3c", "#7a1f8f", "#3f74c9", "#003d2e")
"""Of `REASONS` in their order; in grey each is by a tenth lighter or darker than the next."""


def dem_figure(model: ElevationModel, matches: StereoMatches, pose: Pose) -> "Figure":
    """Picture with disparities, reasons where there is none, heights, and random and common errors."""
    figure = page(5.9)
    axes = figure.subplots(2, 3)
    title = f"{as_label(model.name)}: {matches.shares()['matched']:.0%} of the pixels matched"
    headline(figure, title, synthetic=model.synthetic)
    _picture(axes[0, 0], matches)
    _disparity(figure, axes[0, 1], matches)
    _reasons(axes[0, 2], matches)
    for axis, key, name in (
        (axes[1, 0], "height_m", "height [m]"),
        (axes[1, 1], "height_m_sigma", "random error [mm]"),
        (axes[1, 2], "height_m_common_sigma", "common error [mm]"),
    ):
        _map(figure, axis, model, key, name, pose)
    return figure


def _picture(axis: "Axes", matches: StereoMatches) -> None:
    low, high = np.percentile(matches.left, [0.5, 99.5])
    axis.imshow(matches.left, cmap="gray", vmin=low, vmax=high)
    axis.set_title("left picture, rectified")
    axis.set_axis_off()


def _disparity(figure: "Figure", axis: "Axes", matches: StereoMatches) -> None:
    shown = axis.imshow(matches.disparity, cmap="viridis", interpolation="nearest")
    axis.set_title("disparity")
    axis.set_axis_off()
    _bar(figure, shown, axis, "disparity [px]")


def _reasons(axis: "Axes", matches: StereoMatches) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    axis.imshow(matches.reason, cmap=ListedColormap(REASON_COLOURS), vmin=-0.5, vmax=len(REASONS) - 0.5)
    axis.set_title("why there is no disparity")
    shares = list(matches.shares().values())
    handles = [
        Patch(facecolor=colour, edgecolor="0.5", label=f"{name} {share:.1%}")
        for colour, name, share in zip(REASON_COLOURS, REASONS, shares, strict=True)
        if share >= 0.0005 or name == REASONS[MATCHED]
    ]
    axis.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.03), frameon=False, ncols=2)
    axis.set_axis_off()


def _map(figure: "Figure", axis: "Axes", model: ElevationModel, key: str, name: str, pose: Pose) -> None:
    scale = 1e3 if "mm" in name else 1.0
    values = scale * model.layer(key)
    low, high = np.nanpercentile(values, [2, 98])
    colours = "cividis" if key == "height_m" else "viridis"
    shown = axis.imshow(values, origin="lower", extent=model.extent_m, cmap=colours, vmin=low, vmax=high)
    axis.plot(*pose.center_m[:2], marker="^", color=COLORS[1], markeredgecolor="white", clip_on=False)
    axis.set(title=name.partition(" [")[0], xlabel="x [m]", ylabel="y [m]")
    _bar(figure, shown, axis, name)


def _bar(figure: "Figure", shown: "AxesImage", axis: "Axes", label: str) -> None:
    figure.colorbar(shown, ax=axis, orientation="horizontal", label=label, shrink=0.85, aspect=25)
