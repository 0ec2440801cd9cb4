"""What is known of cameras: intrinsics, views, and how well a rig tells distances."""

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.images import LengthUnit
from lunarsci.images.camera import INTRINSICS, Camera, StereoRig, vector_of
from lunarsci.images.jobs.requests import CamerasRequest
from lunarsci.images.labels import LabelCamera, read_label, rig_of_labels
from lunarsci.images.rig_files import (
    SingleCamera,
    WrittenCamera,
    is_rig,
    read_camera,
    read_rig,
    rig_names,
    rig_or_camera,
    rig_text,
)
from lunarsci.io.documents import toml_document
from lunarsci.io.inputs import InputFile, Source, read_input, text
from lunarsci.options import request_of
from lunarsci.result import Figures, Result, job

SOURCES = [
    "Brown (1971), Photogramm. Eng. 37, 855: lens distortion",
    "Gennery (2006), Int. J. Comput. Vis. 68, 239, 10.1007/s11263-006-5168-1: CAHVOR and CAHVORE",
]
RANGES_M = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0)
"""Distances at which errors of a rig are listed. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSheet(Result):
    """Rigs, or single cameras with what their labels' fits miss.

    Attributes
    ----------
    rigs : stereo rigs, in the order given.
    alone : single cameras by file or name.
    request : what was asked.
    inputs : SHA-256 of each file by its name.
    """

    schema: ClassVar[str] = "images-cameras/1"
    sources = SOURCES
    rigs: tuple[StereoRig, ...]
    alone: Mapping[str, LabelCamera | SingleCamera]
    request: CamerasRequest
    inputs: Mapping[str, str]

    def to_dict(self) -> dict[str, Any]:
        return {
            "rigs": [self._rig(rig) for rig in self.rigs],
            "cameras": [_alone(name, one) for name, one in self.alone.items()],
            "read_as": [f"{rig.name}: {note}" for rig in self.rigs for note in rig.read_as],
        }

    def _rig(self, rig: StereoRig) -> dict[str, Any]:
        sigmas = rig.sigmas if rig.covariance.any() else {}
        numbers = {side: _numbers(getattr(rig, side), sigmas, f"{side}_") for side in ("left", "right")}
        relative = {
            "rotation_rad": [float(v) for v in vector_of(rig.rotation)],
            "rotation_rad_sigma": [sigmas.get(f"rotation_{axis}_rad") for axis in "xyz"],
            "translation_m": [float(v) for v in rig.translation_m],
            "translation_m_sigma": [sigmas.get(f"translation_{axis}_m") for axis in "xyz"],
        }
        way = rig.translation_m / rig.baseline_m
        return {
            **rig.summary(),
            "source": rig.source,
            "baseline_m_sigma": float(way @ rig.covariance[-3:, -3:] @ way) ** 0.5 or None,
            "read_as": list(rig.read_as),
            "relative": relative,
            "ranges": self.ranges(rig),
            **numbers,
        }

    def ranges(self, rig: StereoRig, ranges_m: Sequence[float] = RANGES_M) -> list[dict[str, float]]:
        """Of a point in the middle of the view: disparity, size of a pixel, and errors of its range, by range."""
        focal, rows = rig.left.fx_px, []
        way = rig.left.rays([0.5 * (rig.left.width_px - 1), 0.5 * (rig.left.height_px - 1)])
        way = way / np.linalg.norm(way)
        for away in ranges_m:
            left, right = rig.project(away * way)
            common = float("nan")
            if np.isfinite([left, right]).all() and rig.covariance.any():
                by = way @ rig.by_parameters(left, right)
                common = math.sqrt(max(float(by @ rig.covariance @ by), 0.0))
            depth = away * float(way[2])
            rows.append({
                "range_m": away,
                "disparity_px": focal * rig.baseline_m / depth,
                "pixel_m": depth / focal,
                "range_random_m_sigma": float(rig.range_error_m(depth, self.request.disparity_error)) / float(way[2]),
                "range_common_m_sigma": common,
                "seen_by_both": bool(rig.right.sees(right)) and away >= rig.nearest_m,
            })  # fmt: skip
        return rows

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a rig and range."""
        return [{"name": rig.name} | row for rig in self.rigs for row in self.ranges(rig)]

    def figures(self) -> Figures:
        from lunarsci.images.figures import range_page

        if not self.rigs:
            raise ParameterError("ranges need two cameras; give a rig, or the labels of the left and right picture")
        away = np.geomspace(RANGES_M[0], RANGES_M[-1], 40)
        rows = [self.ranges(rig, [float(a) for a in away]) for rig in self.rigs]
        errors = [
            [np.array([row[f"range_{kind}_m_sigma"] for row in one_rig]) for one_rig in rows]
            for kind in ("random", "common")
        ]
        yield range_page([rig.name for rig in self.rigs], away, *errors)

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"rig.toml": self.toml} if role in ("rig", "sources") else {}

    def toml(self) -> bytes:
        """The file of the one rig, which `images dem` reads. Raises ParameterError for none or several."""
        if len(self.rigs) != 1:
            raise ParameterError(f"a file holds one rig, not {len(self.rigs)}; name one, or two labels, left and right")
        return rig_text(self.rigs[0]).encode()


def _numbers(camera: Camera, sigmas: Mapping[str, float], before: str = "") -> dict[str, Any]:
    """Size, intrinsics with errors, and field of view of a camera."""
    cells: dict[str, Any] = {"width_px": camera.width_px, "height_px": camera.height_px}
    for name in INTRINSICS:
        cells |= {name: getattr(camera, name), f"{name}_sigma": sigmas.get(f"{before}{name}")}
    across, down = camera.field_of_view_deg()
    return cells | {"view_across_deg": across, "view_down_deg": down}


def _alone(name: str, one: LabelCamera | SingleCamera) -> dict[str, Any]:
    if isinstance(one, SingleCamera):
        sigmas = dict(zip(INTRINSICS, map(float, one.covariance.diagonal() ** 0.5), strict=True))
        return {"name": name, **_numbers(one.camera, sigmas), "remarks": [f"source: {one.source}"]}
    return {
        "name": name,
        **_numbers(one.camera, {}),
        **one.pose.to_dict(),
        "residual_rms_px": one.residual_rms_px,
        "residual_largest_px": one.residual_max_px,
        "pinhole_residual_largest_px": one.pinhole_max_px,
        "remarks": list(one.remarks),
    }


@job
def cameras(sources: Sequence[Source] = (), request: CamerasRequest | None = None, **options: Any) -> CameraSheet:
    """What is known of rigs: by name, from TOML files, or from labels; of all that come with lunarsci without any.

    A label, or a file of ROS or OpenCV with one camera, alone is one camera; two are the left and the right one of a
    rig. Raises RequestError and DataError.

    Examples
    --------
    >>> rigs = lunarsci.cameras(["lunarsci-demo/rig.toml"], disparity_error=0.2)
    """
    request = request_of(CamerasRequest, request, options)
    size: Any = request.picture_size and tuple(map(int, request.picture_size.split("x")))
    given = [sources] if isinstance(sources, str) else list(sources)
    files: list[Any] = [None if one in rig_names() else read_input(one) for one in given]
    rigs: list[StereoRig] = []
    alone: dict[str, LabelCamera | SingleCamera] = {}
    pair: list[InputFile] = []
    for one, file in zip(given or rig_names(), files or [None] * len(rig_names()), strict=True):
        if file is None:
            rigs.append(read_rig(one))  # type: ignore[arg-type]
        elif is_rig(file):
            rigs.append(rig_or_camera([file], request.translation_unit, size))  # type: ignore[arg-type]
        elif not _is_toml(file):
            pair.append(file)
        elif single := read_camera(file):
            alone[file.name] = single
        else:
            rigs.append(read_rig(file))
    of_pair, of_labels = _of_pair(pair, request.translation_unit, size)
    rigs, alone = rigs + of_pair, alone | of_labels
    inputs = {file.name: file.sha256 for file in files if file is not None}
    return CameraSheet(rigs=tuple(rigs), alone=alone, request=request, inputs=inputs)


def _of_pair(
    files: list[InputFile], unit: LengthUnit | None, size: tuple[int, int] | None
) -> tuple[list[StereoRig], dict[str, LabelCamera | SingleCamera]]:
    """The rig of two labels or files of ROS or OpenCV, and cameras of one, or of labels. Raises DataError."""
    if len(files) > 2:
        raise RequestError(f"{len(files)} labels; give one, or those of the left and the right picture")
    written = rig_or_camera(files, unit, size)
    if isinstance(written, WrittenCamera):
        name = files[0].name
        return [], {name: SingleCamera(written.camera, np.full((9, 9), np.nan), f"{name}; {'; '.join(written.notes)}")}
    if written is not None:
        return [written], {}
    labels: dict[str, LabelCamera | SingleCamera] = {file.name: read_label(file) for file in files}
    return [rig_of_labels(*files)] if len(files) == 2 else [], labels


def _is_toml(file: InputFile) -> bool:
    try:
        toml_document(text(file))
    except tomllib.TOMLDecodeError:
        return file.name.lower().endswith(".toml")
    except DataError:
        return False
    return True
