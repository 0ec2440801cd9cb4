"""Cameras from what comes with a picture: PDS4 labels of Chang'E cameras, and CAHV, CAHVOR and CAHVORE models.

Both say where a camera looked, in their own words. Here a `Camera` and a `Pose` are made of that, and by how much they
miss it is part of the answer. CAHVOR in photogrammetric terms is of Di & Li (2004), 10.1029/2003JE002199.
"""

import math
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.images.cahv import (
    RANGES,
    CahvModel,
    StatedModel,
    count_of,
    finite,
    is_xml,
    label_of,
    model_in,
    orthonormal,
)
from lunarsci.images.camera import INTRINSICS, Camera, Pose, StereoRig, covariance_of, rotation_of
from lunarsci.io.documents import xml_root
from lunarsci.io.inputs import InputFile
from lunarsci.ranges import refuse

STEPS = 12
"""Points along each side of a picture that a model is fitted at."""
FEWEST_POINTS = 50
"""That a fit of 15 numbers rests on: 100 equations, six or seven for each."""
MOST_TRIES = 100
"""Of a fit; sound models need some ten."""
RIGHT_ANGLE_DEG = 15.0
"""How far the line between two centres may lie from the left camera's rows before its frame is doubted; assumed."""
CLOSE_PX = 0.05
"""What the terms of Brown may miss a model by before it is used itself: rows of a rendered pair are matched to this,
measured as `UNEVEN_PX`."""
DOWN = "z of the label's frame points down: x, -y, -z of it are told"
CORNERS = ("up_left", "down_left", "up_right", "down_right", "center")
"""Places of the picture whose directions a label lists."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelCamera:
    """A camera that a label describes, and how well this one does.

    Attributes
    ----------
    camera, pose : the fit; the pose is in the label's frame.
    residual_rms_px, residual_max_px : what it misses of the label's directions or model. [px]
    pinhole_max_px : the same without distortion. [px]
    remarks : what was assumed, one sentence each.
    height_m : of the camera over the plane that the rover stands on; None where its frame does not tell. [m]
    """

    camera: Camera
    pose: Pose
    residual_rms_px: float
    residual_max_px: float
    pinhole_max_px: float
    remarks: tuple[str, ...]
    height_m: float | None = None


def camera_of(model: CahvModel, name: str) -> LabelCamera:
    """The camera of a model of the CAHV family: Brown-Conrady's where this is near enough, else the model as a lens.

    Where the pupil moves with the angle the lens is right at one range, and the residual is that of all `RANGES`.
    """
    fitted = fit_cahv(model, name)
    if fitted.residual_max_px <= CLOSE_PX:
        return fitted
    camera, pose = _through(model, name)
    points, pixels = _samples(model, name)
    left = np.linalg.norm(camera.project(pose.to_camera(points)) - pixels, axis=1)
    remark = f"{model.title} is used in full, by `lens`: k1 to p2 would miss it by more than {CLOSE_PX:g} px"
    if left.max() > CLOSE_PX:
        remark += (
            f"; its pupil moves, for which it is {left.max():.2g} px off at most at {RANGES[0]:g} to {RANGES[-1]:g} m"
        )
    return replace(
        fitted,
        camera=camera,
        pose=pose,
        residual_rms_px=float(np.sqrt(np.mean(left**2))),
        residual_max_px=float(left.max()),
        remarks=(remark,),
    )


def fit_cahv(model: CahvModel, name: str) -> LabelCamera:
    """The Brown-Conrady camera nearest to a model of the CAHV family, or another lens, over its whole picture at 2, 5
    and 20 m."""
    points, pixels = _samples(model, name)
    lens, begin = _through(model, name)
    plain = replace(lens, lens=None)
    fitted = _fitted(plain, begin, points, pixels, free=slice(0, 9), moves=True)
    pinhole = _fitted(plain, begin, points, pixels, free=slice(0, 4), moves=True)
    return replace(fitted, pinhole_max_px=pinhole.residual_max_px)


def _through(model: CahvModel, name: str) -> tuple[Camera, Pose]:
    """The camera whose lens is a model, and its pose. Raises DataError where A, H and V span no picture."""
    try:
        turn, numbers = model.axes()
        pose = Pose(rotation=turn, center_m=model.vectors["C"])
        plain = dict(zip(INTRINSICS, map(float, numbers), strict=False))
        size = {"width_px": model.width_px, "height_px": model.height_px}
        return Camera(name=name, lens=model.in_its_frame(), **size, **plain), pose  # type: ignore[arg-type]
    except (ValueError, np.linalg.LinAlgError) as error:
        raise DataError(f"{name}: {error}") from error


def _fitted(
    plain: Camera, begin: Pose, points: FloatArray, pixels: FloatArray, *, free: slice, moves: bool
) -> LabelCamera:
    """The camera and pose that see points (n, 3) nearest to pixels (n, 2): free intrinsics, a turn, and a place if it
    moves."""
    from scipy.optimize import least_squares

    count = len(INTRINSICS[free])

    def unpacked(values: FloatArray) -> tuple[Camera, Pose]:
        vector = plain.vector()
        vector[free] += values[:count]
        turned = begin.rotation @ rotation_of(values[count : count + 3])
        center = begin.center_m + values[count + 3 :] if moves else begin.center_m
        return plain.with_vector(vector), Pose(rotation=orthonormal(turned), center_m=center)

    def misses(values: FloatArray) -> FloatArray:
        try:
            camera, pose = unpacked(values)
        except ParameterError:
            return np.full(pixels.size, 1e4)
        return np.asarray(np.nan_to_num((camera.project(pose.to_camera(points)) - pixels).ravel(), nan=1e4))

    scale = np.array(
        [1.0 if name.endswith("_px") else 1e-3 for name in INTRINSICS[free]] + [1e-3] * (6 if moves else 3)
    )
    fit = least_squares(misses, np.zeros(len(scale)), x_scale=scale, xtol=1e-14, ftol=1e-14, max_nfev=MOST_TRIES)
    camera, pose = unpacked(fit.x)
    left = np.linalg.norm(fit.fun.reshape(-1, 2), axis=1)
    largest = float(left.max())
    return LabelCamera(
        camera=camera,
        pose=pose,
        residual_rms_px=float(np.sqrt(np.mean(left**2))),
        residual_max_px=largest,
        pinhole_max_px=largest,
        remarks=(),
    )


def _samples(model: CahvModel, name: str) -> tuple[FloatArray, FloatArray]:
    """Points all over a model's picture, at `RANGES`, and where it sees them. (n, 3) [m], (n, 2) [px]"""
    camera, pose = _through(model, name)
    u, v = np.meshgrid(*(np.linspace(-0.5, count - 0.5, STEPS) for count in camera.size))
    with np.errstate(all="ignore"):
        rays = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2))
        points = np.concatenate([pose.to_world(distance * rays) for distance in RANGES])
        pixels = model.project(points)
    inside = np.isfinite(pixels).all(axis=1)
    if inside.sum() < FEWEST_POINTS:
        raise DataError(f"{name}: its model sees {inside.sum()} points in its own picture; is the label damaged?")
    return points[inside], pixels[inside]


def _upright(fitted: LabelCamera, stated: StatedModel) -> LabelCamera:
    """A camera in a frame whose z is up; where nothing tells which way that is the picture is held for upright.

    The origin of a rover's frame is where it stands (Maki et al. 2003, 10.1029/2003JE002077).
    """
    turn, remarks = stated.turn, (*fitted.remarks, *stated.remarks)
    if turn is None and fitted.pose.rotation[2, 1] > 0:
        turn, remarks = np.diag([1.0, -1.0, -1.0]), (*remarks, DOWN)
    if turn is None:
        return replace(fitted, remarks=remarks)
    pose = Pose(rotation=turn @ fitted.pose.rotation, center_m=turn @ fitted.pose.center_m)
    height = float(pose.center_m[2]) if stated.frame.upper().startswith("ROVER") and pose.center_m[2] > 0 else None
    return replace(fitted, pose=pose, remarks=remarks, height_m=height)


def read_label(file: InputFile) -> LabelCamera:
    """The camera of a picture with a label of PDS3, VICAR or PDS4, of such a label, or of a text of `C = …, A = …`.

    The label is in the file, or beside it. Raises DataError for what has none, and names what is missing.
    """
    label = label_of(file) or file
    if stated := model_in(label):
        return _upright(camera_of(stated.model, file.name), stated)
    if is_xml(label):
        return _from_pds4(label.name, label.data)
    raise DataError(f"{file.name}: no camera model; a label needs C, A, H and V, or the pointing of a PDS4 label")


def rig_of_labels(left: InputFile, right: InputFile) -> StereoRig:
    """A rig from the labels of a left and a right picture of one moment.

    Its covariance holds what the fits miss; what calibration did is not in a label. Raises DataError where the two do
    not make a pair: swapped, or one camera twice.
    """
    first, second = read_label(left), read_label(right)
    rotation = second.pose.rotation.T @ first.pose.rotation
    translation = second.pose.to_camera(first.pose.center_m)
    apart, near = float(np.linalg.norm(translation)), math.cos(math.radians(RIGHT_ANGLE_DEG))
    reasons = {
        "both labels name one place; give the left and the right picture's": apart == 0,
        "left and right are swapped; give the left one first": float(translation[0]) > near * apart,
    }
    refuse(reasons, f"{left.name}, {right.name}", DataError)
    remarks = [*first.remarks, *(remark for remark in second.remarks if remark not in first.remarks)]
    if -translation[0] < near * apart:
        remarks.append("centres are stated in another frame than directions: the baseline is laid along the rows")
        translation = -apart * np.array([1.0, 0.0, 0.0])
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
        mast_height_m=first.height_m,
        source=f"labels {left.name} and {right.name}",
    )


# --- PDS4 labels of the Ground Research and Application System (CLPDS) ---


def _from_pds4(name: str, data: bytes) -> LabelCamera:
    root = xml_root(name, data)
    width, height = _size(name, root)
    pitch, length = (_number(name, root, tag) for tag in ("pixel_size", "focal_length"))
    vectors = {corner: _vector(name, root, f"{corner}_point_observe_vector") for corner in CORNERS}
    stated = {corner: vector / np.linalg.norm(vector) for corner, vector in vectors.items() if vector is not None}
    center = np.array([_number(name, root, f"camera_center_position_{axis}", 0.0) for axis in "xyz"])
    reasons = {
        f"pixel_size {pitch:g}, focal_length {length:g}; both are above 0": not min(pitch, length) > 0,
        f"its label states {len(stated)} directions of corners; three or more are needed": len(stated) < 3,
    }
    refuse(reasons, name, DataError)
    focal = length / (pitch := pitch * 1e-3)
    across, down = (_principal(name, root, axis) / pitch for axis in "xy")
    fits = [_fit_corners(name, (width, height), focal, (across, sign * down), stated) for sign in (1.0, -1.0)]
    best = min(fits, key=lambda fit: fit.residual_rms_px)
    if best.residual_max_px > 0.1 * width:
        raise DataError(
            f"{name}: focal length and stated corners differ by {best.residual_max_px:.0f} px; is the label damaged?"
        )
    return replace(best, pose=Pose(rotation=best.pose.rotation, center_m=center))


def _fit_corners(
    name: str, size: tuple[int, int], focal: float, principal: tuple[float, float], stated: dict[str, FloatArray]
) -> LabelCamera:
    """Rotation and k1 from stated directions of the corners and the middle of a picture."""
    right, low = size[0] - 1.0, size[1] - 1.0
    places = {"up_left": (0, 0), "down_left": (0, low), "up_right": (right, 0), "down_right": (right, low)}
    pixels = np.array([places.get(corner, (0.5 * right, 0.5 * low)) for corner in stated])
    directions = np.array(list(stated.values()))
    plain = Camera(
        name=name, width_px=size[0], height_px=size[1], fx_px=focal, fy_px=focal,
        cx_px=0.5 * right + principal[0], cy_px=0.5 * low + principal[1],
    )  # fmt: skip
    rays = plain.rays(pixels)
    turn, _ = Rotation.align_vectors(directions, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    begin = Pose(rotation=turn.as_matrix(), center_m=np.zeros(3))
    pinhole = _fitted(plain, begin, directions, pixels, free=slice(0, 0), moves=False)
    bends = len(stated) >= 4
    fitted = _fitted(plain, begin, directions, pixels, free=slice(4, 5), moves=False) if bends else pinhole
    k1 = "k1 from the stated corners, other distortion unknown" if bends else "distortion unknown"
    remarks = (k1, "the sign of the principal point's y is the one that fits the corners better")
    return replace(fitted, pinhole_max_px=pinhole.residual_max_px, remarks=remarks)


def _size(name: str, root: Element) -> tuple[int, int]:
    axes = {
        str(axis.findtext("axis_name")).strip().lower(): axis.findtext("elements") for axis in root.iter("axis_array")
    }
    if not {"line", "sample"} <= axes.keys():
        raise DataError(f"{name}: its label says no lines and samples; is it the label of a picture?")
    return count_of(name, axes["sample"], "samples"), count_of(name, axes["line"], "lines")


def _number(name: str, root: Element, tag: str, default: float | None = None) -> float:
    cell = next((node.text for node in root.iter(tag) if node.text), default)
    if cell is None:
        raise DataError(f"{name}: its label has no {tag}; labels of Chang'E's PCAM of level 2B have one")
    return finite(name, tag, str(cell))


def _principal(name: str, root: Element, axis: str) -> float:
    """x0, y0 in mm; the Moon's labels write principle_point_coordinate, and x, y."""
    for place in ("principal_point_coordinate", "principle_point_coordinate"):
        for node in root.iter(place):
            for tag in (f"{axis}0", axis):
                if (cell := node.findtext(tag)) is not None:
                    return finite(name, tag, cell)
    raise DataError(f"{name}: its label has no principal point")


def _vector(name: str, root: Element, tag: str) -> FloatArray | None:
    """x, y, z of an element of a label; None where it is not there or not whole. (3,)"""
    node = next(root.iter(tag), None)
    cells = [] if node is None else [node.findtext(axis) for axis in "xyz"]
    values = np.array([finite(name, tag, cell) for cell in cells if cell])
    return values if values.size == 3 and np.linalg.norm(values) > 0 else None
