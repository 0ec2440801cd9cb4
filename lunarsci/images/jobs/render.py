"""SYNTHETIC pairs of pictures, with the truth beside them."""

import io
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.figure import file_label, headline, page
from lunarsci.images import render as renderer
from lunarsci.images.camera import Pose, StereoRig
from lunarsci.images.elevation import read_elevation
from lunarsci.images.jobs.requests import RenderRequest
from lunarsci.images.pictures import png_bytes
from lunarsci.images.render import ROCK_COLUMNS, Landscape, RenderedPair, landscape_on, read_track, with_track
from lunarsci.images.rig_files import pose_text, read_rig, rig_text
from lunarsci.io.inputs import Ground, read_input
from lunarsci.options import request_of
from lunarsci.result import Figures, Progress, Result, job

SOURCES = [
    "Brown (1971), Photogramm. Eng. 37, 855: lens distortion",
    "Hapke (2012), 10.1017/CBO9781139025683: how regolith scatters light",
    "Tevs, Ihrke & Seidel (2008), 10.1145/1342250.1342279: rays through height fields",
]
FLAT_M, COARSE_M = 24.0, 0.25
"""Side, assumed, and spacing of the level ground about 0, 0 that is there where no terrain is given: it gets waves of
up to four spacings. [m]"""
TRUTH_STEP_M = 2.0**-16
"""To which places of the truth are rounded, 15 micrometres: its file is a third as large then. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SyntheticPair(Result):
    """Two SYNTHETIC pictures of a landscape, and the truth of the left one.

    Attributes
    ----------
    landscape : that they show.
    rig : as it was given, not the draw that took them.
    pair : the pictures, and how they were really taken.
    inputs : SHA-256 of each file by its name.
    seed : of all random numbers.
    """

    schema: ClassVar[str] = "images-render/1"
    sources = SOURCES
    landscape: Landscape
    rig: StereoRig
    pair: RenderedPair
    inputs: Mapping[str, str]
    seed: int

    def to_dict(self) -> dict[str, Any]:
        truth, rig = self.pair.truth, self.rig
        ground = truth.kind > 0
        return {
            "synthetic": True,
            "rig": rig.summary(),
            "pose": self.pair.left_pose.to_dict(),
            "pixels": {
                "sky": float((~ground).mean()),
                "rock": float((truth.kind == 2).mean()),
                "shadow": float((ground & (truth.lit == 0)).mean()),
                "seen_by_both": float(truth.seen.mean()),
            },
            "rocks": len(self.landscape.rocks),
            "brightest": {
                "left": int(self.pair.left.max()),
                "right": int(self.pair.right.max()),
                "top": rig.sensor.top,
            },
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a rock, as `ROCK_COLUMNS` says."""
        return [dict(zip(ROCK_COLUMNS, map(float, row), strict=True)) for row in self.landscape.rocks]

    def figures(self) -> Figures:
        figure = page(3.9)
        headline(figure, f"{file_label(self.landscape.name)}, {self.rig.name}", synthetic=True)
        for axis, name in zip(figure.subplots(1, 2), ("left", "right"), strict=True):
            axis.imshow(getattr(self.pair, name), cmap="gray", vmin=0)
            axis.set_title(f"{name} picture")
            axis.set_axis_off()
        yield figure

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        name = next((one for one in self.files() if one.partition(".")[0] == role and role != "truth"), "")
        return self.files() if role == "stations" else {name: self.files()[name]} if name else {}

    def files(self) -> dict[str, Callable[[], bytes]]:
        """Pictures, the rig and pose that a solver is given, and the truth: name to what makes the content."""
        words = {"Comment": "SYNTHETIC, rendered by lunarsci", "Source": self.landscape.name}
        note = "# SYNTHETIC pictures were taken with a rig near this one; its own numbers are in truth.npz\n"
        return {
            "left.png": lambda: png_bytes(self.pair.left, words),
            "right.png": lambda: png_bytes(self.pair.right, words),
            "rig.toml": lambda: (note + rig_text(self.rig)).encode(),
            "pose.toml": lambda: pose_text(self.pair.left_pose).encode(),
            "truth.npz": self._truth_bytes,
        }

    def _truth_bytes(self) -> bytes:
        ground, poses = self.landscape, {"left": self.pair.left_pose, "right": self.pair.right_pose}
        truth = self.pair.truth
        arrays: dict[str, Any] = truth._asdict() | {"points_m": _rounded(truth.points_m)}
        arrays |= {f"{side}_rotation": pose.rotation for side, pose in poses.items()}
        arrays |= {f"{side}_center_m": pose.center_m for side, pose in poses.items()}
        arrays |= {
            "grid": np.array([ground.x0_m, ground.y0_m, ground.spacing_m]),
            "ground_m": _rounded(ground.height_m),
        }
        arrays |= {"rocks": ground.rocks, "rig": np.array(rig_text(self.pair.rig)), "synthetic": np.array(True)}
        content = io.BytesIO()
        # As `savez_compressed`, which compresses eight times as long for a twentieth of the bytes.
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, values in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(values))
        return content.getvalue()


def _rounded(places_m: FloatArray) -> Any:
    """Places to `TRUTH_STEP_M`, in single precision. [m]"""
    return ((places_m / TRUTH_STEP_M).round() * TRUTH_STEP_M).astype("float32")


@job
def render(
    terrain: "Ground | None" = None,
    request: RenderRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> SyntheticPair:
    """Two SYNTHETIC pictures of a terrain (.npz), or of level ground, with roughness, rocks, shadows and noise.

    The seed makes the same ground for every place of the camera. Raises DataError for a terrain that cannot be read,
    ParameterError where a camera cannot be.

    Examples
    --------
    >>> pair = lunarsci.render(rig="lunarsci-demo/rig.toml", samples=1, x=0.5)
    """
    request = request_of(RenderRequest, request, options)
    path = None if terrain is None else str(terrain)
    rig = read_rig(request.rig)
    count = round(FLAT_M / COARSE_M) + 1
    level = (-0.5 * FLAT_M, -0.5 * FLAT_M, COARSE_M, np.zeros((count, count)))
    if path is None and max(abs(request.x), abs(request.y)) > 0.5 * FLAT_M:
        raise ParameterError(
            f"the camera at {request.x:g}, {request.y:g} m is beside the level ground, {FLAT_M:g} m wide about 0, 0; "
            "give a nearer place or a terrain"
        )
    ground = landscape_on(
        level if path is None else _heights(path),
        name=path or "level ground",
        seed=request.seed,
        rocks_per_m2=request.rocks,
        roughness=request.roughness,
        sun_azimuth_deg=request.sun_azimuth,
        sun_elevation_deg=request.sun_elevation,
        spacing_m=request.spacing,
    )
    inputs = {name: read_input(name).sha256 for name in (path, request.track) if name is not None}
    if request.track is not None:
        ground = with_track(ground, *read_track(request.track), request.track_width)
    low = float(np.nan_to_num(ground.ground(request.x, request.y)))
    height = request.height or rig.height_m
    pose = Pose.looking([request.x, request.y, low + height], request.heading, request.down, request.roll)
    pair = renderer.render(
        ground,
        rig,
        pose,
        seed=request.seed,
        perturbed=not request.exact,
        law=request.law,
        samples=request.samples,
        progress=progress,
    )
    return SyntheticPair(landscape=ground, rig=rig, pair=pair, inputs=inputs, seed=request.seed)


def _heights(terrain: str) -> tuple[float, float, float, FloatArray]:
    """x0, y0, spacing and heights (ny, nx) of a terrain file. [m]"""
    model = read_elevation(terrain)
    return model.x0_m, model.y0_m, model.spacing_m, model.height_m
