"""A drive as a film: the fan of paths grows over the terrain while the rover of one member drives."""

import io
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.animation import FFMpegWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from lunarsci.arrays import FloatArray
from lunarsci.errors import OutputError, ParameterError
from lunarsci.figure import INK, as_label, synthetic_title
from lunarsci.ranges import check_range
from lunarsci.twin.figures.panels import (
    ACCENT,
    GOLD,
    LABELS,
    LIMIT,
    draw_exclusion_zones,
    draw_ground,
    draw_planned,
    map_window,
    member_colors,
    shown_members,
)
from lunarsci.twin.ground.hazards import RoverFootprint, rover_outline
from lunarsci.twin.judgement.quantities import abscissa, along
from lunarsci.twin.judgement.safety import Verdict, headword
from lunarsci.twin.judgement.tables import spread
from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, Prediction

FORMATS = (".gif", ".mp4")
MOST_FRAMES, PER_SECOND = 120, 12
WIDTH_IN, HEIGHT_IN, DPI = 9.6, 5.4, 90
MARGIN_M = 1.8
"""Ground that is shown beyond the paths. [m]"""
GREYS, COLORS, VIVID = 80, 160, 30
"""Of the 256 colours of a GIF; some stay free, one of them for pixels that do not change."""
INSETS = ("tilt_deg", "slip_ratio")
"""Quantities that are plotted beside the map."""


def check_format(target: Path) -> None:
    """Raise ParameterError for a film that cannot be written here: another suffix, or .mp4 without ffmpeg."""
    suffix = target.suffix.lower()
    if suffix not in FORMATS:
        raise ParameterError(f"{target}: films are written as {', '.join(FORMATS)}")
    if suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise ParameterError(f"{target}: .mp4 needs the program ffmpeg; install it, or give a name that ends in .gif")


def animate(
    prediction: Prediction,
    verdict: Verdict,
    target: Path,
    *,
    frames: int = MOST_FRAMES,
    progress: Callable[[int, int], None] | None = None,
) -> bytes:
    """A film for a file named `target` (.gif, or .mp4 with ffmpeg), as its content.

    The paths of at most 400 members grow over shaded relief; outline and wheels are those of the member that misses the
    destination by the median of those that finished. Insets show its tilt and largest |slip| with p05 to p95 over the
    members.

    Parameters
    ----------
    frames : at most so many, 2 to 120, from the first sample to the last, at 12 a second; never more than samples.
    progress : called with frames done and frames in all, after each of them.

    Raises
    ------
    ParameterError for another suffix or number of frames, or for .mp4 without ffmpeg; OutputError where the encoder
    fails.
    """
    check_format(target)
    check_range("frames", frames, f"[2, {MOST_FRAMES}]")
    count = len(prediction.time_s)
    samples = [int(k) for k in np.unique(np.linspace(0, count - 1, min(frames, count)).astype(np.int64))]
    stage = _Stage(prediction, verdict)

    def reported(done: int) -> None:
        if progress is not None:
            progress(done, len(samples))

    try:
        return (_gif if target.suffix.lower() == ".gif" else _mp4)(stage, samples, reported)
    except (OSError, RuntimeError) as error:
        raise OutputError(f"{target}: the film could not be encoded: {error}") from error


def _gif(stage: "_Stage", samples: list[int], reported: Callable[[int], None]) -> bytes:
    """All frames in the colours of the last one, so that only what moves is stored again."""

    def drawn(sample: int) -> Image.Image:
        stage.show(sample)
        return Image.fromarray(_pixels(stage.figure)).convert("RGB")

    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette(np.asarray(drawn(samples[-1]))))
    images = []
    for done, sample in enumerate(samples, start=1):
        images.append(drawn(sample).quantize(palette=palette, dither=Image.Dither.NONE))
        reported(done)
    buffer = io.BytesIO()
    pause = round(1000 / PER_SECOND)
    images[0].save(buffer, "GIF", save_all=True, append_images=images[1:], duration=pause, loop=0, optimize=True)
    return buffer.getvalue()


def _mp4(stage: "_Stage", samples: list[int], reported: Callable[[int], None]) -> bytes:
    writer = FFMpegWriter(PER_SECOND, codec="libx264", extra_args=["-pix_fmt", "yuv420p", "-loglevel", "error"])
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        with writer.saving(stage.figure, str(film), DPI):
            for done, sample in enumerate(samples, start=1):
                stage.show(sample)
                writer.grab_frame()
                reported(done)
        return film.read_bytes()


def _palette(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Greys for the ground, and what represents the colourful pixels best, as red, green, blue of each."""
    flat = pixels.reshape(-1, 3)
    vivid = flat[np.ptp(flat, axis=1) > VIVID]
    greys = np.repeat(np.linspace(0, 255, GREYS).astype(np.uint8), 3).tobytes()
    if not len(vivid):
        return greys
    chosen = Image.fromarray(vivid[None]).quantize(COLORS).getpalette() or []
    return greys + bytes(chosen[: 3 * COLORS])


def _pixels(figure: Figure) -> npt.NDArray[np.uint8]:
    """The figure as red, green, blue and opacity. (height, width, 4)"""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba(), dtype=np.uint8)


def median_member(prediction: Prediction) -> int:
    """The member that misses the destination by the median; of those that finished, if any did."""
    members = np.flatnonzero(prediction.finished)
    members = members if members.size else np.arange(prediction.members)
    order = members[np.argsort(prediction.miss_m[members], kind="stable")]
    return int(order[(len(order) - 1) // 2])


class _Stage:
    """The picture whose moving parts are set for each sample."""

    def __init__(self, prediction: Prediction, verdict: Verdict) -> None:
        self.prediction = prediction
        self.member = median_member(prediction)
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, facecolor="white")
        static = _background(figure, prediction, verdict, self.member)
        self.figure: Figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, facecolor="white")
        self.figure.figimage(static, zorder=-1)
        self.axes = [_clear_axes(self.figure, axes) for axes in figure.axes]
        self.insets = [_of_member(prediction, name)[self.member] for name in INSETS]
        self.moving = self._parts()

    def _parts(self) -> dict[str, Any]:
        ground, *insets = self.axes
        colors = np.array(member_colors(self.prediction), dtype=object)
        self.members = shown_members(self.prediction)
        fan = LineCollection([], colors=[colors[m] for m in self.members], linewidths=0.8, alpha=0.85)
        body = PolyCollection([], facecolors=[(1, 1, 1, 0.55)], edgecolors=INK, linewidths=1.2)
        wheels = PolyCollection([], facecolors=INK, edgecolors=INK)
        for part in (fan, body, wheels):
            ground.add_collection(part, autolim=False)
        clock = ground.text(0.02, 0.03, "", transform=ground.transAxes, fontsize=9, color=INK)
        clock.set_bbox({"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 2.0})
        marks = [axes.plot([], [], "o", color=LIMIT, markersize=5, clip_on=False)[0] for axes in insets]
        return {"fan": fan, "body": body, "wheels": wheels, "clock": clock, "marks": marks}

    def show(self, sample: int) -> None:
        """Move everything to where it is at a sample."""
        prediction, parts = self.prediction, self.moving
        paths = prediction.paths
        parts["fan"].set_segments([paths[m, : sample + 1, :2] for m in self.members])
        x, y, yaw = (float(paths[self.member, sample, PATH_COLUMNS.index(name)]) for name in ("x_m", "y_m", "yaw_deg"))
        pose = np.array([x, y, np.radians(yaw)])
        parts["body"].set_verts([rover_outline(prediction.rover).corners_m(pose)])
        parts["wheels"].set_verts(self._wheels(sample, yaw))
        where = abscissa(prediction)[0]
        for mark, values in zip(parts["marks"], self.insets, strict=True):
            mark.set_data([where[sample]], [values[sample]])
        time, last = prediction.time_s[sample], prediction.time_s[-1]
        parts["clock"].set_text(f"{time:.0f} s of {last:.0f} s, {prediction.distance_m[sample]:.1f} m")

    def _wheels(self, sample: int, yaw_deg: float) -> list[FloatArray]:
        if not self.prediction.recorded[self.member]:
            return []
        wheel = self.prediction.rover.wheel
        rim = RoverFootprint(rear_m=-wheel.radius_m, front_m=wheel.radius_m, half_width_m=0.5 * wheel.width_m)
        places = self.prediction.states[self.member, sample, :, :2]
        return [rim.corners_m(np.array([x, y, np.radians(yaw_deg)])) for x, y in places]


def _of_member(prediction: Prediction, quantity: str) -> FloatArray:
    """The quantity for each member and sample; of the wheels' the largest magnitude."""
    values = along(prediction, quantity)
    return values if values.ndim == 2 else np.asarray(np.abs(values).max(axis=2))


def _background(figure: Figure, prediction: Prediction, verdict: Verdict, member: int) -> npt.NDArray[np.uint8]:
    """Draw all that stands still; the picture as pixels."""
    ground = figure.add_axes((0.07, 0.1, 0.61, 0.82))
    terrain = prediction.terrain
    draw_ground(ground, terrain, map_window(prediction, terrain, MARGIN_M), 0.1)
    draw_exclusion_zones(ground, prediction)
    draw_planned(ground, prediction)
    ground.plot(*prediction.destination_m, "*", color=GOLD, markeredgecolor=INK, markersize=12, zorder=6)
    drives = "1 drive" if prediction.members == 1 else f"{prediction.members} drives"
    title = f"{headword(verdict)}: {drives} on {as_label(terrain.name)}"
    ground.set_title(synthetic_title(title, terrain.synthetic), fontsize=10)
    for row, name in enumerate(INSETS):
        _draw_inset(figure.add_axes((0.765, 0.57 - 0.47 * row, 0.215, 0.33)), prediction, name, member)
    return _pixels(figure)


def _draw_inset(axes: Axes, prediction: Prediction, name: str, member: int) -> None:
    where, label = abscissa(prediction)
    values = _of_member(prediction, name)
    low, _, high, *_ = spread(values, prediction.reached)
    axes.fill_between(where, low, high, color=ACCENT, alpha=0.25, linewidth=0)
    axes.plot(where, np.where(prediction.reached[member], values[member], np.nan), color=ACCENT, linewidth=1.3)
    axes.set_xlim(float(where[0]), float(where[-1]))
    axes.set_xlabel(label, fontsize=8)
    axes.set_ylabel("largest |s| of the wheels [-]" if name == "slip_ratio" else LABELS[name][0], fontsize=8)
    axes.set_title("line: rover shown; band: p05 to p95", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, linewidth=0.5)


def _clear_axes(figure: Figure, drawn: Axes) -> Axes:
    """Invisible axes over those of the background, with the same place and limits."""
    axes: Axes = figure.add_axes(drawn.get_position().bounds)
    axes.set_xlim(drawn.get_xlim())
    axes.set_ylim(drawn.get_ylim())
    axes.axis("off")
    return axes
