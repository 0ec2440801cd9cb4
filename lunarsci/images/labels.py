"""Cameras from what comes with a picture: PDS4 labels of Chang'E cameras, and CAHV, CAHVOR and CAHVORE models.

Both say where a camera looked, in their own words. Here a `Camera` and a `Pose` are fitted to that, and by how much the
fit misses is part of the answer.
"""

from xml.etree.ElementTree import Element

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.images.cahv import MOST_TRIES, LabelCamera, count_of, finite, orthonormal, read_cahv
from lunarsci.images.camera import INTRINSICS, Camera, Pose, rotation_of
from lunarsci.images.rig import StereoRig, covariance_of
from lunarsci.io.documents import xml_root
from lunarsci.io.inputs import InputFile, text

CORNERS = ("up_left", "down_left", "up_right", "down_right", "center")
RIGHT_ANGLE_DEG = 15.0
"""How far the line between two centres may lie from the left camera's rows before its frame is doubted; assumed."""


def read_label(file: InputFile) -> LabelCamera:
    """The camera of a PDS4 label, a PDS3 label with a CAHV model, or a text of `C = …, A = …` (VICAR).

    Raises DataError for what has none, and names what is missing.
    """
    content = text(file)
    if content.lstrip().startswith("<"):
        return _from_pds4(file.name, content)
    return read_cahv(file.name, content)


def rig_of_labels(left: InputFile, right: InputFile) -> StereoRig:
    """A rig from the labels of a left and a right picture of one moment.

    Its covariance holds what the fits miss; what calibration did is not in a label. Raises DataError where the two do
    not make a pair: swapped, or one camera twice.
    """
    first, second = read_label(left), read_label(right)
    rotation = second.pose.rotation.T @ first.pose.rotation
    translation = second.pose.to_camera(first.pose.center_m)
    if not np.linalg.norm(translation) > 0:
        raise DataError(f"{left.name}, {right.name}: both labels name one place; give the left and the right picture's")
    along = -translation / np.linalg.norm(translation)
    if along[0] < -np.cos(np.radians(RIGHT_ANGLE_DEG)):
        raise DataError(f"{left.name}, {right.name}: left and right are swapped; give the left one first")
    remarks = [*first.remarks, *(remark for remark in second.remarks if remark not in first.remarks)]
    if along[0] < np.cos(np.radians(RIGHT_ANGLE_DEG)):
        remarks.append("centres are stated in another frame than directions: the baseline is laid along the rows")
        translation = -np.linalg.norm(translation) * np.array([1.0, 0.0, 0.0])
    sigmas = {f"{side}_{name}": fit.residual_rms_px for side, fit in (("left", first), ("right", second))
              for name in INTRINSICS[:4]}  # fmt: skip
    turned = max(first.residual_rms_px / first.camera.fx_px, second.residual_rms_px / second.camera.fx_px)
    return StereoRig(
        name=f"{left.stem}, {right.stem}",
        left=first.camera,
        right=second.camera,
        rotation=rotation,
        translation_m=translation,
        covariance=covariance_of(sigmas | dict.fromkeys((f"rotation_{axis}_rad" for axis in "xyz"), turned)),
        assumed=("covariance: what the fits to the labels miss, not what the calibration did", *remarks),
        source=f"labels {left.name} and {right.name}",
    )


# --- PDS4 labels of the Ground Research and Application System (CLPDS) ---


def _from_pds4(name: str, content: str) -> LabelCamera:
    root = xml_root(name, content.encode())
    width, height = _size(name, root)
    pitch, length = (_number(name, root, tag) for tag in ("pixel_size", "focal_length"))
    if not (pitch > 0 and length > 0):
        raise DataError(f"{name}: pixel_size {pitch:g}, focal_length {length:g}; both are above 0")
    focal = length / (pitch := pitch * 1e-3)
    across, down = (_principal(name, root, axis) / pitch for axis in "xy")
    found = {corner: _vector(name, root, f"{corner}_point_observe_vector") for corner in CORNERS}
    told = {corner: vector / np.linalg.norm(vector) for corner, vector in found.items() if vector is not None}
    center = np.array([_number(name, root, f"camera_center_position_{axis}", 0.0) for axis in "xyz"])
    fits = [
        _fit_corners(name, (width, height), focal, (across, sign * down), told, center) for sign in (1.0, -1.0)
    ] if len(told) >= 3 else []  # fmt: skip
    if not fits:
        raise DataError(f"{name}: its label states {len(told)} directions of corners; three or more are needed")
    best = min(fits, key=lambda fit: fit.residual_rms_px)
    if best.residual_max_px > 0.1 * width:
        raise DataError(
            f"{name}: focal length and stated corners differ by {best.residual_max_px:.0f} px; is the label damaged?"
        )
    return best


def _fit_corners(
    name: str,
    size: tuple[int, int],
    focal: float,
    principal: tuple[float, float],
    told: dict[str, FloatArray],
    center: FloatArray,
) -> LabelCamera:
    """Rotation and k1 from stated directions of the corners and the middle of a picture."""
    from scipy.optimize import least_squares

    right, low = size[0] - 1.0, size[1] - 1.0
    places = {"up_left": (0, 0), "down_left": (0, low), "up_right": (right, 0), "down_right": (right, low)}
    pixels = np.array([places.get(corner, (0.5 * right, 0.5 * low)) for corner in told])
    directions = np.array(list(told.values()))
    middle = 0.5 * right + principal[0], 0.5 * low + principal[1]
    plain = Camera(
        name=name, width_px=size[0], height_px=size[1], fx_px=focal, fy_px=focal, cx_px=middle[0], cy_px=middle[1]
    )
    first = _turned_onto(plain.rays(pixels), directions)

    def misses(values: FloatArray) -> FloatArray:
        vector = plain.vector()
        vector[4] = values[3] if len(values) > 3 else 0.0
        seen = directions @ (rotation_of(values[:3]) @ first)
        return np.asarray(np.nan_to_num((plain.with_vector(vector).project(seen) - pixels).ravel(), nan=1e4))

    pinhole, bent = (least_squares(misses, np.zeros(count), x_scale=1e-3, max_nfev=MOST_TRIES) for count in (3, 4))
    chosen = bent if len(told) >= 4 else pinhole
    vector = plain.vector()
    vector[4] = chosen.x[3] if len(chosen.x) > 3 else 0.0
    left = np.linalg.norm(chosen.fun.reshape(-1, 2), axis=1)
    k1 = "k1 from the stated corners, other distortion unknown" if len(told) >= 4 else "distortion unknown"
    return LabelCamera(
        camera=plain.with_vector(vector),
        pose=Pose(rotation=orthonormal(rotation_of(chosen.x[:3]) @ first), center_m=center),
        residual_rms_px=float(np.sqrt(np.mean(left**2))),
        residual_max_px=float(left.max()),
        pinhole_max_px=float(np.linalg.norm(pinhole.fun.reshape(-1, 2), axis=1).max()),
        remarks=(k1, "the sign of the principal point's y is the one that fits the corners better"),
    )


def _turned_onto(rays: FloatArray, directions: FloatArray) -> FloatArray:
    """The rotation that turns rays of the camera best into directions (Kabsch 1976, 10.1107/S0567739476001873)."""
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    left, _, right = np.linalg.svd(directions.T @ unit)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _size(name: str, root: "Element") -> tuple[int, int]:
    axes = {
        str(axis.findtext("axis_name")).strip().lower(): axis.findtext("elements") for axis in root.iter("axis_array")
    }
    if not {"line", "sample"} <= axes.keys():
        raise DataError(f"{name}: its label says no lines and samples; is it the label of a picture?")
    return count_of(name, axes["sample"], "samples"), count_of(name, axes["line"], "lines")


def _number(name: str, root: "Element", tag: str, default: float | None = None) -> float:
    found = next((node.text for node in root.iter(tag) if node.text), None)
    if found is None and default is None:
        raise DataError(f"{name}: its label has no {tag}; labels of Chang'E's PCAM of level 2B have one")
    return finite(name, tag, str(default) if found is None else found)


def _principal(name: str, root: "Element", axis: str) -> float:
    """x0, y0 in mm; the Moon's labels write principle_point_coordinate, and x, y."""
    for place in ("principal_point_coordinate", "principle_point_coordinate"):
        for node in root.iter(place):
            for tag in (f"{axis}0", axis):
                if (found := node.findtext(tag)) is not None:
                    return finite(name, tag, found)
    raise DataError(f"{name}: its label has no principal point")


def _vector(name: str, root: "Element", tag: str) -> FloatArray | None:
    node = next(root.iter(tag), None)
    cells = [] if node is None else [node.findtext(axis) for axis in "xyz"]
    values = np.array([finite(name, tag, cell) for cell in cells if cell])
    return values if values.size == 3 and np.linalg.norm(values) > 0 else None
