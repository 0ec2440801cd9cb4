"""Cameras of the CAHV family, and the camera of Brown that is nearest to any other one."""

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.images.camera import INTRINSICS, Camera, Pose, rotation_of

STEPS = 12
"""Points along each side of a picture that a model is fitted at."""
FEWEST_POINTS = 50
"""That a fit of 15 numbers rests on; assumed."""
RANGES = (2.0, 5.0, 20.0)
"""Ranges of those points, since the pupil of CAHVORE moves. [m]"""
MOST_TRIES = 100
"""Of a fit; sound models need some ten."""
MOST_PX = 100_000
"""Lines or samples of a picture; assumed."""
COARSE_PX = 1.0
"""A fit that misses by more says so; assumed."""
Z_DOWN = re.compile(r'COORD\w*SYSTEM_NAME\s*=\s*"?(?:ROVER|SITE|LOCAL_LEVEL|LANDER)\w*')
DOWN = "z of the label's frame points down: x, -y, -z of it are told"
NUMBER = r"[-+]?(?:\d++\.?+\d*+|\.\d++)(?:[eEdD][-+]?\d++)?"


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
    from scipy.optimize import least_squares

    v = model.vectors
    axis = v["A"] / np.linalg.norm(v["A"])
    across, down = np.cross(np.cross(axis, v["H"]), axis), np.cross(np.cross(axis, v["V"]), axis)
    focal_x, focal_y = np.linalg.norm(across), np.linalg.norm(down)
    if not (0 < focal_x < np.inf and 0 < focal_y < np.inf):
        raise DataError(f"{name}: A, H and V span no picture ({focal_x:g}, {focal_y:g} px); check the label")
    rotation = orthonormal(np.stack([across / focal_x, np.cross(axis, across / focal_x), axis], axis=1))
    first = np.array([focal_x, focal_y, axis @ v["H"], axis @ v["V"]])
    size = {"width_px": model.width_px, "height_px": model.height_px}
    plain = Camera(name=name, **size, **dict(zip(INTRINSICS[:4], map(float, first), strict=True)))  # type: ignore[arg-type]
    points, pixels = _samples(model, plain, rotation)

    def misses(values: FloatArray) -> FloatArray:
        vector = np.concatenate([first + values[:4], values[4:9] if len(values) > 10 else np.zeros(5)])
        turn, place = values[-6:-3], v["C"] + values[-3:]
        seen = (points - place) @ (rotation @ rotation_of(turn))
        try:
            found = plain.with_vector(vector).project(seen)
        except ValueError:
            return np.full(pixels.size, 1e4)
        return np.asarray(np.nan_to_num((found - pixels).ravel(), nan=1e4))

    scale = np.array([1.0] * 4 + [1e-3] * 11)
    bent = least_squares(misses, np.zeros(15), x_scale=scale, xtol=1e-14, ftol=1e-14, max_nfev=MOST_TRIES)
    pinhole = least_squares(
        misses, np.zeros(10), x_scale=scale[[0, 1, 2, 3, 9, 10, 11, 12, 13, 14]], max_nfev=MOST_TRIES
    )
    left, flat = (np.linalg.norm(fit.fun.reshape(-1, 2), axis=1) for fit in (bent, pinhole))
    remark = f"the fit to its model misses it by {left.max():.2g} px at most"
    return LabelCamera(
        camera=plain.with_vector(np.concatenate([first + bent.x[:4], bent.x[4:9]])),
        pose=Pose(rotation=orthonormal(rotation @ rotation_of(bent.x[9:12])), center_m=v["C"] + bent.x[12:15]),
        residual_rms_px=float(np.sqrt(np.mean(left**2))),
        residual_max_px=float(left.max()),
        pinhole_max_px=float(flat.max()),
        remarks=(remark,) if left.max() > COARSE_PX else (),
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


def read_cahv(name: str, content: str) -> LabelCamera:
    """The camera of a text with a CAHV, CAHVOR or CAHVORE model, its frame with z up. Raises DataError."""
    return _upright(fit_cahv(_cahv_of(name, content), name), content)


def _upright(found: LabelCamera, content: str) -> LabelCamera:
    """A camera in a frame whose z is up.

    Frames of rovers and sites have z down (Maki et al. 2003, 10.1029/2003JE002077, for MER; MSL and Mars 2020 as well).
    Where a label names none of these the picture is held for upright.
    """
    down = bool(Z_DOWN.search(content)) or found.pose.rotation[2, 1] > 0
    if not down:
        return found
    turn = np.diag([1.0, -1.0, -1.0])
    pose = Pose(rotation=turn @ found.pose.rotation, center_m=turn @ found.pose.center_m)
    return replace(found, pose=pose, remarks=(*found.remarks, DOWN))


def _cahv_of(name: str, content: str) -> CahvModel:
    vectors = _components(content)
    if not {"C", "A", "H", "V"} <= vectors.keys():
        raise DataError(f"{name}: no camera model; a label needs C, A, H and V, or the pointing of a PDS4 label")
    for letter, partner in (("O", "R"), ("R", "O")):
        if letter in vectors and partner not in vectors:
            raise DataError(f"{name}: a CAHVOR model needs O and R; {partner} is missing")
    width = _first_number(content, ("LINE_SAMPLES", "xdim", "NS"))
    height = _first_number(content, ("LINES", "ydim", "NL"))
    if width is None or height is None:
        raise DataError(f"{name}: the size of the picture is missing; add LINES = … and LINE_SAMPLES = …")
    kind = _first_number(content, ("MODEL_TYPE_PARAMETER", "MPARM", "T"))
    own = {"linearity": 1.0 if kind is None else float(kind)}
    vectors["O"] = vectors["O"] / np.linalg.norm(vectors["O"]) if "O" in vectors else vectors["A"]
    vectors.setdefault("R", np.zeros(3))
    return CahvModel(
        vectors=vectors, width_px=count_of(name, width, "samples"), height_px=count_of(name, height, "lines"), **own
    )


def _components(content: str) -> dict[str, FloatArray]:
    """Vectors by letter: MODEL_COMPONENT_1 = (…) of PDS3 in the order of MODEL_COMPONENT_ID, or lines C = x y z."""
    unit = r"(?:\s*<[^<>]*>)?"
    triple = rf"\(?\s*({NUMBER}){unit}[\s,]++({NUMBER}){unit}[\s,]++({NUMBER})"
    listed = re.search(r"MODEL_COMPONENT_ID\s*=\s*\(([^)]*)\)", content)
    found: dict[str, FloatArray] = {}
    if listed:
        for index, letter in enumerate(re.findall(r"\w+", listed[1]), start=1):
            if cells := re.search(rf"MODEL_COMPONENT_{index}\s*=\s*{triple}", content):
                found.setdefault(letter, _floats(cells))
        return found
    for cells in re.finditer(rf"^[ \t]*+([CAHVORE])\s*=\s*{triple}", content, re.MULTILINE):
        found.setdefault(cells[1], _floats(cells, 2))
    return found


def _floats(cells: "re.Match[str]", first: int = 1) -> FloatArray:
    return np.array([float(cells[place].replace("D", "e").replace("d", "e")) for place in range(first, first + 3)])


def _first_number(content: str, names: tuple[str, ...]) -> Any:
    for key in names:
        if cells := re.search(rf"^[ \t]*+{key}\s*=\s*({NUMBER})", content, re.MULTILINE):
            return float(cells[1])
    return None


def orthonormal(matrix: FloatArray) -> FloatArray:
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def count_of(name: str, told: str | float | None, what: str) -> int:
    """A number of pixels. Raises DataError for text, parts of one, and what no picture has."""
    count = finite(name, what, str(told))
    if not (1 <= count <= MOST_PX and count.is_integer()):
        raise DataError(f"{name}: its {what} are {told}; a picture has 1 to {MOST_PX}")
    return int(count)


def finite(name: str, tag: str, told: str) -> float:
    try:
        value = float(told)
    except ValueError as error:
        raise DataError(f"{name}: {tag} is '{told}', no number; fetch it again") from error
    if not np.isfinite(value):
        raise DataError(f"{name}: {tag} is {value}; fetch it again")
    return value
