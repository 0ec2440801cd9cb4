"""Cameras from what comes with a picture: PDS4 labels of Chang'E cameras, and CAHV, CAHVOR and CAHVORE models.

Both say where a camera looked, in their own words. Here a `Camera` (Brown's) and a `Pose` are fitted to that, and by
how much the fit misses is part of the answer.
"""

import math
import re
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.images.camera import INTRINSICS, Camera, Pose, StereoRig, covariance_of, rotation_of
from lunarsci.io.documents import xml_root
from lunarsci.io.inputs import InputFile, text
from lunarsci.ranges import refuse

STEPS = 12
"""Points along each side of a picture that a model is fitted at."""
FEWEST_POINTS = 50
"""That a fit of 15 numbers rests on: 100 equations, six or seven for each."""
RANGES = (2.0, 5.0, 20.0)
"""Ranges of those points, since the pupil of CAHVORE moves. [m]"""
MOST_TRIES = 100
"""Of a fit; sound models need some ten."""
MOST_PX = 100_000
"""Lines or samples of a picture: a hundred times those of cameras on rovers; assumed."""
RIGHT_ANGLE_DEG = 15.0
"""How far the line between two centres may lie from the left camera's rows before its frame is doubted; assumed."""
COARSE_PX = 1.0
"""A fit that misses by more than a pixel says so, as does a calibration; assumed."""
Z_DOWN = re.compile(r'COORD\w*SYSTEM_NAME\s*=\s*"?(?:ROVER|SITE|LOCAL_LEVEL|LANDER)\w*')
"""A label whose frame has its z downwards."""
DOWN = "z of the label's frame points down: x, -y, -z of it are told"
NUMBER = r"[-+]?(?:\d++\.?+\d*+|\.\d++)(?:[eEdD][-+]?\d++)?"
"""A number of a label."""
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
    """

    camera: Camera
    pose: Pose
    residual_rms_px: float
    residual_max_px: float
    pinhole_max_px: float
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CahvModel:
    """A camera of the CAHV family: centre C, axis A, image vectors H and V, optical axis O, radial R, entrance E.

    CAHV is of Yakimovsky & Cunningham (1978), 10.1016/0146-664X(78)90112-0; CAHVOR and CAHVORE of Gennery (2006),
    10.1007/s11263-006-5168-1; CAHVOR in photogrammetric terms of Di & Li (2004), 10.1029/2003JE002199.

    Attributes
    ----------
    vectors : by letter, (3,); C and E in m, H and V in px, the others without unit. O, R and E may be missing.
    linearity : of CAHVORE: 1 perspective, 0 fish-eye.
    width_px, height_px : size of its picture. [px]
    """

    vectors: dict[str, FloatArray]
    width_px: int
    height_px: int
    linearity: float = 1.0

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) of the model's frame [m]."""
        v = self.vectors
        seen = points - v["C"]
        if "E" in v:
            seen = self._bent_entrance(seen)
        elif "O" in v:
            along = seen @ v["O"]
            aside = seen - along[:, None] * v["O"]
            tau = np.sum(aside**2, axis=1) / along**2
            seen = seen + aside * (v["R"][0] + v["R"][1] * tau + v["R"][2] * tau**2)[:, None]
        depth = seen @ v["A"]
        return np.stack([seen @ v["H"] / depth, seen @ v["V"] / depth], axis=1)

    def _bent_entrance(self, seen: FloatArray) -> FloatArray:
        """Direction after a pupil that moves along O with the angle theta (Gennery 2006)."""
        v = self.vectors
        along = seen @ v["O"]
        aside = seen - along[:, None] * v["O"]
        away = np.linalg.norm(aside, axis=1)
        theta = np.arctan2(away, along)
        e0, e1, e2 = v["E"]
        for _ in range(20):
            t2 = theta**2
            moved, change = e0 + e1 * t2 + e2 * t2**2, 2 * e1 * theta + 4 * e2 * theta**3
            sine, cosine = np.sin(theta), np.cos(theta)
            value = cosine * away - sine * along - (theta - sine) * moved
            slope = cosine * along + sine * away + (1 - cosine) * moved + (theta - sine) * change
            theta = theta + value / slope
        lin = self.linearity
        chi = theta if abs(lin) < 1e-9 else (np.tan(lin * theta) if lin > 0 else np.sin(lin * theta)) / lin
        mu = v["R"][0] + v["R"][1] * chi**2 + v["R"][2] * chi**4
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(chi > 0, away / chi, along)
        return np.asarray(depth[:, None] * v["O"] + (1 + mu)[:, None] * aside)


def fit_cahv(model: CahvModel, name: str) -> LabelCamera:
    """The Brown-Conrady camera nearest to a model of the CAHV family, or another lens, over its whole picture at 2, 5
    and 20 m."""
    v = model.vectors
    axis = v["A"] / np.linalg.norm(v["A"])
    across, down = np.cross(np.cross(axis, v["H"]), axis), np.cross(np.cross(axis, v["V"]), axis)
    focal_x, focal_y = np.linalg.norm(across), np.linalg.norm(down)
    if not (0 < focal_x < np.inf and 0 < focal_y < np.inf):
        raise DataError(f"{name}: A, H and V span no picture ({focal_x:g}, {focal_y:g} px); check the label")
    rotation = orthonormal(np.stack([across / focal_x, np.cross(axis, across / focal_x), axis], axis=1))
    numbers = dict(zip(INTRINSICS, map(float, (focal_x, focal_y, axis @ v["H"], axis @ v["V"])), strict=False))
    plain = Camera(name=name, width_px=model.width_px, height_px=model.height_px, **numbers)
    points, pixels = _samples(model, plain, rotation)
    begin = Pose(rotation=rotation, center_m=v["C"])
    fitted = _fitted(plain, begin, points, pixels, free=slice(0, 9), moves=True)
    pinhole = _fitted(plain, begin, points, pixels, free=slice(0, 4), moves=True)
    remark = f"the fit to its model misses it by {fitted.residual_max_px:.2g} px at most"
    return replace(
        fitted,
        pinhole_max_px=pinhole.residual_max_px,
        remarks=(remark,) if fitted.residual_max_px > COARSE_PX else (),
    )


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


def _samples(model: CahvModel, plain: Camera, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points that the model sees in its picture, and where."""
    reach = [np.linspace(-0.6 * count, 0.6 * count, 2 * STEPS) for count in (model.width_px, model.height_px)]
    u, v = np.meshgrid(reach[0], reach[1])
    rays = np.stack([u / plain.fx_px, v / plain.fy_px, np.ones_like(u)], axis=-1).reshape(-1, 3)
    points = np.concatenate([model.vectors["C"] + distance * rays @ rotation.T for distance in RANGES])
    pixels = model.project(points)
    inside = np.isfinite(pixels).all(axis=1) & plain.sees(np.nan_to_num(pixels, nan=-1e9))
    if inside.sum() < FEWEST_POINTS:
        raise DataError(f"{plain.name}: its model sees {inside.sum()} points in its own picture; is the label damaged?")
    return points[inside], pixels[inside]


def _upright(fitted: LabelCamera, content: str) -> LabelCamera:
    """A camera in a frame whose z is up.

    Frames of rovers and sites have z down (Maki et al. 2003, 10.1029/2003JE002077, for MER; MSL and Mars 2020 as well).
    Where a label names none of these the picture is held for upright.
    """
    if not (Z_DOWN.search(content) or fitted.pose.rotation[2, 1] > 0):
        return fitted
    turn = np.diag([1.0, -1.0, -1.0])
    pose = Pose(rotation=turn @ fitted.pose.rotation, center_m=turn @ fitted.pose.center_m)
    return replace(fitted, pose=pose, remarks=(*fitted.remarks, DOWN))


def _cahv_of(name: str, content: str) -> CahvModel:
    vectors = _components(content)
    width = _first_number(content, ("LINE_SAMPLES", "xdim", "NS"))
    height = _first_number(content, ("LINES", "ydim", "NL"))
    halves = {"O", "R"} & vectors.keys()
    reasons = {
        "no camera model; a label needs C, A, H and V, or the pointing of a PDS4 label":
            not {"C", "A", "H", "V"} <= vectors.keys(),
        f"a CAHVOR model needs O and R, not {''.join(halves)} alone": len(halves) == 1,
        "the size of the picture is missing; add LINES = … and LINE_SAMPLES = …": width is None or height is None,
    }  # fmt: skip
    refuse(reasons, name, DataError)
    kind = _first_number(content, ("MODEL_TYPE_PARAMETER", "MPARM", "T"))
    vectors["O"] = vectors["O"] / np.linalg.norm(vectors["O"]) if "O" in vectors else vectors["A"]
    vectors.setdefault("R", np.zeros(3))
    return CahvModel(
        vectors=vectors,
        width_px=count_of(name, width, "samples"),
        height_px=count_of(name, height, "lines"),
        linearity=1.0 if kind is None else kind,
    )


def _components(content: str) -> dict[str, FloatArray]:
    """Vectors by letter: MODEL_COMPONENT_1 = (…) of PDS3 in the order of MODEL_COMPONENT_ID, or lines C = x y z."""
    unit = r"(?:\s*<[^<>]*>)?"
    triple = rf"\(?\s*({NUMBER}){unit}[\s,]++({NUMBER}){unit}[\s,]++({NUMBER})"
    listed = re.search(r"MODEL_COMPONENT_ID\s*=\s*\(([^)]*)\)", content)
    letters = re.findall(r"\w+", listed[1]) if listed else "CAHVORE"
    vectors: dict[str, FloatArray] = {}
    for index, letter in enumerate(letters, start=1):
        start = rf"MODEL_COMPONENT_{index}" if listed else rf"^[ \t]*+{letter}"
        if letter not in vectors and (cells := re.search(rf"{start}\s*=\s*{triple}", content, re.MULTILINE)):
            vectors[letter] = np.array([float(cell.upper().replace("D", "E")) for cell in cells.groups()])
    return vectors


def _first_number(content: str, names: tuple[str, ...]) -> float | None:
    cells = (re.search(rf"^[ \t]*+{key}\s*=\s*({NUMBER})", content, re.MULTILINE) for key in names)
    return next((float(match[1]) for match in cells if match), None)


def orthonormal(matrix: FloatArray) -> FloatArray:
    """The orthogonal matrix nearest to one. (3, 3)"""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def count_of(name: str, cell: str | float | None, what: str) -> int:
    """A number of pixels. Raises DataError for text, parts of one, and what no picture has."""
    count = finite(name, what, str(cell))
    if not (1 <= count <= MOST_PX and count.is_integer()):
        raise DataError(f"{name}: its {what} are {cell}; a picture has 1 to {MOST_PX}")
    return int(count)


def finite(name: str, tag: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise DataError(f"{name}: {tag} is '{cell}', no number; fetch it again")
    return value


def read_label(file: InputFile) -> LabelCamera:
    """The camera of a PDS4 label, a PDS3 label with a CAHV model, or a text of `C = …, A = …` (VICAR).

    Raises DataError for what has none, and names what is missing.
    """
    content = text(file)
    if content.lstrip().startswith("<"):
        return _from_pds4(file.name, content)
    return _upright(fit_cahv(_cahv_of(file.name, content), file.name), content)


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
        source=f"labels {left.name} and {right.name}",
    )


# --- PDS4 labels of the Ground Research and Application System (CLPDS) ---


def _from_pds4(name: str, content: str) -> LabelCamera:
    root = xml_root(name, content.encode())
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
