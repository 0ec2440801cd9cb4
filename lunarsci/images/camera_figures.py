"""Pictures of cameras: what a calibration leaves, and how well a rig tells distances."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import INK, LINE_STYLES, as_label, headline, legend_below, page
from lunarsci.images.calibration import CameraCalibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MARK = "#D55E00"
LONG = 0.08
"""Length of the arrow of a residual of three standard deviations, as a share of the picture's width."""


def calibration_page(found: "CameraCalibration", name: str) -> "Figure":
    """Residuals of each camera over its picture, on how uncertain directions are, and residuals by moment."""
    count = len(found.cameras)
    figure = page(6.0 if count > 1 else 3.6)
    headline(figure, f"{as_label(name, 60)}: residuals {found.residual_px:.3f} px")
    axes: Any = figure.subplots(2, 2) if count > 1 else figure.subplots(1, 2)[None]
    for k in range(count):
        _residuals(figure, axes[0, k], found, k)
        _by_moment(axes[1, k] if count > 1 else axes[0, 1], found, k)
    legend_below(figure, axes.flat)
    return figure


def _residuals(figure: "Figure", axis: "Axes", found: "CameraCalibration", index: int) -> None:
    camera, rows = found.cameras[index], found.residuals[index]
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, 25), np.linspace(0, camera.height_px - 1, 21))
    uncertain = found.uncertainty_px(index, np.stack([u.ravel(), v.ravel()], axis=-1)).reshape(u.shape)
    top = float(np.nanpercentile(uncertain, 98))
    shown = axis.pcolormesh(u, v, uncertain, cmap="Blues", vmin=0, vmax=top, shading="gouraud")
    figure.colorbar(shown, ax=axis, orientation="horizontal", label="uncertainty of a direction [px]", shrink=0.8)
    scale = 3 * found.residual_px / (LONG * camera.width_px)
    arrows = axis.quiver(
        *rows[:, 1:].T, angles="xy", scale_units="xy", scale=scale, width=0.002, color=MARK, headwidth=3
    )
    axis.quiverkey(arrows, 0.85, 1.03, 3 * found.residual_px, f"{3 * found.residual_px:.2f} px", labelpos="E")
    axis.set(xlim=(0, camera.width_px), ylim=(camera.height_px, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    axis.set_title(f"{camera.name}: {len(rows)} points", loc="left")


def _by_moment(axis: "Axes", found: "CameraCalibration", index: int) -> None:
    rows = found.residuals[index]
    moments = np.unique(rows[:, 0]).astype(int)
    rms = [float(np.sqrt(np.mean(rows[rows[:, 0] == k, 3:] ** 2))) for k in moments]
    axis.bar(moments + 1, rms, color=INK)
    axis.axhline(found.residual_px, color=MARK, lw=1, label="all pictures")
    axis.set(xlabel="picture, in the order given [-]", ylabel="rms of residuals [px]")
    axis.set_title(found.cameras[index].name, loc="left")


def range_page(
    names: Sequence[str], ranges_m: FloatArray, random_m: Sequence[FloatArray], common_m: Sequence[FloatArray]
) -> "Figure":
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
