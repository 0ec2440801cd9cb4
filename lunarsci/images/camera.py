"""One camera: from a direction to a pixel and back, with derivatives; and two that are fixed to each other.

Pixels are (u, v): u to the right, v down, (0, 0) the centre of the first one. The frame of a camera has x to the right,
y down and z along its axis; the world x and y level and z up, as a terrain has. A rig triangulates, and has errors that
all pixels share.
"""

import dataclasses
import math
import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.images.pictures import cv2
from lunarsci.names import one_of
from lunarsci.ranges import refuse

INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "p1", "p2")
"""What a camera's picture depends on, in the order of `Camera.vector`."""
NEWTON_STEPS = 30
"""At most, from a pixel to its direction."""
CONVERGED = 1e-12
"""Step of a direction's x and y over z that ends Newton's method. [-]"""
STEP = 1e-6
"""Of differences: the third root of what doubles resolve, at which these are best."""
RELATIVE = (*(f"rotation_{axis}_rad" for axis in "xyz"), *(f"translation_{axis}_m" for axis in "xyz"))
"""How the right camera stands to the left one: a small rotation after that of the rig, and the translation."""
PARAMETERS = (*(f"left_{n}" for n in INTRINSICS), *(f"right_{n}" for n in INTRINSICS), *RELATIVE)
"""What a rig depends on: rows and columns of its covariance."""
MAST_M = 1.5
"""Height of a camera whose rig does not say: about that of the mast cameras of MER, 1.54 m (Maki et al. 2003,
10.1029/2003JE002077). [m]"""
COARSE_PX = 1.0
"""A fit, a direction or a disparity that is off by more than a pixel is called so; assumed."""
UNSTATED = (0.01, 0.4)
"""Errors of a rig whose file states none: of lengths, focal and the baseline, as shares, and what its rotation shifts
[px]; measured: by as much do halves of six public sets of chessboards differ."""
AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Turns a direction of a camera into one whose x is ahead, y left and z up. (3, 3)"""
PIXEL_MTF = 2 / math.pi
"""Contrast that a square pixel leaves at half a cycle a pixel. [-]"""


class Projection(NamedTuple):
    """Pixels of n points, with their derivatives.

    Attributes
    ----------
    pixels : u and v. (n, 2) [px]
    by_pose : by the rotation vector [rad] and the translation [m] that are applied to the points. (n, 2, 6)
    by_intrinsics : in the order of `INTRINSICS`. (n, 2, 9)
    """

    pixels: FloatArray
    by_pose: FloatArray
    by_intrinsics: FloatArray


class Lens(Protocol):
    """A distortion that no terms of Brown describe, such as CAHVORE's."""

    def bent(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x' and y' of `Camera` from x and y; NaN for what the lens does not see. [-]"""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A camera with the distortion of Brown (1971), Photogramm. Eng. 37, 855, as OpenCV names its terms, or a lens.

    With x, y the direction over its z and r^2 = x^2 + y^2,

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2),    u = fx x' + cx
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y,    v = fy y' + cy

    Attributes
    ----------
    name : what it is called.
    width_px, height_px : size of its picture. [px]
    fx_px, fy_px : focal length in pixels, > 0. [px]
    cx_px, cy_px : principal point. [px]
    k1, k2, k3, p1, p2 : radial and tangential distortion. [-]
    lens : makes x' and y' in their place; None where they do.

    Raises ParameterError for what no camera can be.
    """

    name: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    lens: Lens | None = None

    def __post_init__(self) -> None:
        positive = min(self.fx_px, self.fy_px) > 0 and min(self.size) >= 2
        if not (positive and np.isfinite(self.vector()).all()):
            names = ("width_px", "height_px", *INTRINSICS)
            numbers = ", ".join(f"{name} {getattr(self, name)}" for name in names)
            raise ParameterError(
                f"{self.name}: 2 px or more, a focal length above 0 and finite numbers are needed, not {numbers}"
            )

    def vector(self) -> FloatArray:
        """The intrinsics in the order of `INTRINSICS`. (9,)"""
        return np.array([getattr(self, name) for name in INTRINSICS], dtype=float)

    def with_vector(self, vector: npt.ArrayLike) -> "Camera":
        """The same camera with other intrinsics. (9,)"""
        values = dict(zip(INTRINSICS, map(float, np.asarray(vector, dtype=float)), strict=True))
        return dataclasses.replace(self, **values)  # type: ignore[arg-type]

    def scaled(self, share: float) -> "Camera":
        """The same view in `share` times the pixels each way, whose edges, not middles, are those of the picture.

        Raises ParameterError where width or height is then no whole number.
        """
        sides = [share * side for side in self.size]
        if not all(math.isfinite(side) and math.isclose(side, round(side), abs_tol=1e-6) for side in sides):
            raise ParameterError(
                f"{self.name}: {share:g} times {self.width_px} x {self.height_px} px are no whole pixels; "
                "give a width that makes both whole"
            )
        return dataclasses.replace(
            self,
            width_px=round(sides[0]),
            height_px=round(sides[1]),
            fx_px=share * self.fx_px,
            fy_px=share * self.fy_px,
            cx_px=share * (self.cx_px + 0.5) - 0.5,
            cy_px=share * (self.cy_px + 0.5) - 0.5,
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height. [px]"""
        return self.width_px, self.height_px

    @property
    def matrix(self) -> FloatArray:
        """The pinhole's matrix K. (3, 3) [px]"""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> FloatArray:
        """(k1, k2, p1, p2, k3), the order that OpenCV takes."""
        return np.array([self.k1, self.k2, self.p1, self.p2, self.k3])

    def field_of_view_deg(self) -> tuple[float, float]:
        """Full angles across the middle row and the middle column, from edge to edge of the outer pixels. [deg]"""
        middle_u, middle_v = 0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1)
        ends = [[-0.5, middle_v], [self.width_px - 0.5, middle_v], [middle_u, -0.5], [middle_u, self.height_px - 0.5]]
        rays = self.rays(ends)
        unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return tuple(math.degrees(math.acos(float(unit[i] @ unit[i + 1]))) for i in (0, 2))  # type: ignore[return-value]

    def fold(self) -> float:
        """Largest r at which the distortion is one to one; inf where it always is, and of a lens. [-]"""
        if self.lens is not None:
            return math.inf
        roots = np.roots([7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        real = roots[np.abs(roots.imag) < 1e-12].real
        return float(np.sqrt(real[real > 0].min())) if (real > 0).any() else math.inf

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (..., 2) of points or directions (..., 3) in the camera's frame; NaN behind it or past the fold."""
        given = np.asarray(points, dtype=float)
        ahead = given[..., 2] > 0
        x, y = np.moveaxis(given[..., :2] / np.where(ahead, given[..., 2], 1.0)[..., None], -1, 0)
        xd, yd = self._distorted(x, y)
        pixels = np.stack([self.fx_px * xd + self.cx_px, self.fy_px * yd + self.cy_px], axis=-1)
        return np.where((ahead & (np.hypot(x, y) < self.fold()))[..., None], pixels, np.nan)

    def project_with_derivatives(
        self, points: FloatArray, turn: npt.ArrayLike = (0.0,) * 3, way_m: npt.ArrayLike = (0.0,) * 3
    ) -> Projection:
        """`project`, by OpenCV, of points (n, 3) [m] after a rotation and a translation.

        turn : rotation vector. (3,) [rad]
        way_m : translation, after the rotation. (3,) [m]
        """
        rotated = np.asarray(turn, dtype=float), np.asarray(way_m, dtype=float)
        if self.lens is not None:
            return self._through_lens(points, *rotated)
        pixels, slopes = cv2.projectPoints(points, *rotated, self.matrix, self.distortion)
        slopes = np.asarray(slopes).reshape(-1, 2, 15)
        return Projection(np.asarray(pixels)[:, 0], slopes[..., :6], slopes[..., [6, 7, 8, 9, 10, 11, 14, 12, 13]])

    def _through_lens(self, points: FloatArray, turn: FloatArray, way_m: FloatArray) -> Projection:
        """`project_with_derivatives` by the chain rule; derivatives of the rotation are differences."""
        there = points @ rotation_of(turn).T + way_m
        x, y = (there[:, :2] / there[:, 2:]).T
        by_xy = self._by_xy(x, y) * np.array([[self.fx_px], [self.fy_px]])
        by_point = np.concatenate([by_xy, -(by_xy @ np.stack([x, y], -1)[..., None])], -1) / there[:, 2, None, None]
        ends = [points @ (rotation_of(turn + step) - rotation_of(turn - step)).T for step in STEP * np.eye(3)]
        by_turn = by_point @ np.stack(ends, -1) / (2 * STEP)
        xd, yd = self._distorted(x, y)
        by_lens = np.zeros((len(points), 2, len(INTRINSICS)))
        by_lens[:, 0, 0], by_lens[:, 1, 1], by_lens[:, 0, 2], by_lens[:, 1, 3] = xd, yd, 1.0, 1.0
        pixels = np.stack([self.fx_px * xd + self.cx_px, self.fy_px * yd + self.cy_px], axis=-1)
        return Projection(pixels, np.concatenate([by_turn, by_point], -1), by_lens)

    def rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Directions (..., 3) with z = 1 of pixels (..., 2), by Newton's method; NaN where the distortion has none."""
        given = np.asarray(pixels, dtype=float)
        goal_x = (given[..., 0] - self.cx_px) / self.fx_px
        goal_y = (given[..., 1] - self.cy_px) / self.fy_px
        x, y = goal_x.copy(), goal_y.copy()
        if self.lens is not None or self.distortion.any():
            with np.errstate(all="ignore"):
                x, y = self._undistorted(goal_x, goal_y)
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def sees(self, pixels: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Whether pixels (..., 2) lie in the picture. (...)"""
        given = np.asarray(pixels, dtype=float)
        return np.asarray(((given >= -0.5) & (given <= np.array(self.size) - 0.5)).all(axis=-1))

    def _distorted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x' and y' of `Camera` from x and y, directions over their z. [-]"""
        if self.lens is not None:
            return self.lens.bent(x, y)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        across = 2 * x * y
        return (
            x * radial + self.p1 * across + self.p2 * (r2 + 2 * x * x),
            y * radial + self.p1 * (r2 + 2 * y * y) + self.p2 * across,
        )

    def _by_xy(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Derivatives of what `_distorted` gives by x and y, as differences. (..., 2, 2)"""
        ends = [(self._distorted(x + h, y + k), self._distorted(x - h, y - k)) for h, k in STEP * np.eye(2)]
        return np.stack([(np.stack(more, -1) - np.stack(less, -1)) / (2 * STEP) for more, less in ends], -1)

    def _undistorted(self, goal_x: FloatArray, goal_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x and y that `_distorted` leads to these, within the fold; NaN where none does. [-]"""
        fold = self.fold()
        goal = np.hypot(goal_x, goal_y)
        shrink = np.minimum(1.0, 0.9 * fold / np.maximum(goal, 1e-300))
        x, y = goal_x * shrink, goal_y * shrink
        for _ in range(NEWTON_STEPS):
            off_x, off_y = (goal - now for goal, now in zip((goal_x, goal_y), self._distorted(x, y), strict=True))
            (a, b), (c, d) = np.moveaxis(self._by_xy(x, y), (-2, -1), (0, 1))
            step = np.stack([d * off_x - b * off_y, a * off_y - c * off_x]) / (a * d - b * c)
            x, y = x + step[0], y + step[1]
            if not (np.abs(step) > CONVERGED).any():
                break
        xd, yd = self._distorted(x, y)
        good = (np.hypot(xd - goal_x, yd - goal_y) < 1e3 * CONVERGED) & (np.hypot(x, y) < fold)
        return np.where(good, x, np.nan), np.where(good, y, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """Where a camera is and where it looks.

    Attributes
    ----------
    rotation : turns a direction of the camera's frame into the world's. (3, 3)
    center_m : its centre of projection. (3,) [m]
    """

    rotation: FloatArray
    center_m: FloatArray

    def __post_init__(self) -> None:
        rotation, center = np.asarray(self.rotation, dtype=float), np.asarray(self.center_m, dtype=float)
        turns = rotation.shape == (3, 3) and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        if not (turns and np.linalg.det(rotation) > 0 and center.shape == (3,) and np.isfinite(center).all()):
            raise ParameterError(
                "a pose needs a rotation of 3 x 3 numbers that turns without stretching or mirroring, and a centre of "
                "3 finite numbers"
            )

    @classmethod
    def looking(
        cls, center_m: npt.ArrayLike, heading_deg: float = 0.0, down_deg: float = 0.0, roll_deg: float = 0.0
    ) -> "Pose":
        """A camera at `center_m` that looks along a heading (from x towards y), so far below the horizon.

        `roll_deg` turns it clockwise about its axis, as seen from behind. [deg]
        """
        turn = Rotation.from_euler("ZYX", (heading_deg, down_deg, roll_deg), degrees=True)
        return cls(rotation=turn.as_matrix() @ AHEAD, center_m=np.asarray(center_m, dtype=float))

    def angles_deg(self) -> tuple[float, float, float]:
        """Heading, angle below the horizon and roll of `looking`. [deg]"""
        with warnings.catch_warnings(action="ignore"):  # straight down heading and roll are one angle
            heading, down, roll = Rotation.from_matrix(self.rotation @ AHEAD.T).as_euler("ZYX", degrees=True)
        return float(heading), float(down), float(roll)

    def to_dict(self) -> dict[str, Any]:
        """position_m, heading_deg, down_deg and roll_deg, as results and files have them."""
        angles = dict(zip(("heading_deg", "down_deg", "roll_deg"), self.angles_deg(), strict=True))
        return {"position_m": [float(v) for v in self.center_m], **angles}

    def to_world(self, points: npt.ArrayLike) -> FloatArray:
        """Points (..., 3) of the camera's frame in the world. [m]"""
        return np.asarray(np.asarray(points, dtype=float) @ self.rotation.T + self.center_m)

    def to_camera(self, points: npt.ArrayLike) -> FloatArray:
        """Points (..., 3) of the world in the camera's frame. [m]"""
        return np.asarray((np.asarray(points, dtype=float) - self.center_m) @ self.rotation)


def rotation_of(vector: npt.ArrayLike) -> FloatArray:
    """The rotation about a vector by its length, Rodrigues' formula. (3,) [rad] to (3, 3)"""
    return np.asarray(Rotation.from_rotvec(np.asarray(vector, dtype=float)).as_matrix())


def vector_of(rotation: npt.ArrayLike) -> FloatArray:
    """The inverse of `rotation_of`. (3, 3) to (3,) [rad]"""
    return np.asarray(Rotation.from_matrix(np.asarray(rotation, dtype=float)).as_rotvec())


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """What makes numbers of light, the same in both cameras; by default as of Yutu-2's PanCam (`rigs.toml`), with
    assumed noise of reading.

    Attributes
    ----------
    bits : of its numbers, 8 to 16.
    full_well_e : electrons of the largest number. [e-]
    read_noise_e : standard deviation of reading. [e-]
    mtf_at_nyquist : contrast that lens and pixels leave at half a cycle a pixel, 0.01 to 0.63 (a pixel alone). [-]
    """

    bits: int = 10
    full_well_e: float = 25000.0
    read_noise_e: float = 15.0
    mtf_at_nyquist: float = 0.33

    def __post_init__(self) -> None:
        electrons = 0 < self.full_well_e < math.inf and 0 <= self.read_noise_e < math.inf
        if not (8 <= self.bits <= 16 and electrons and 0.01 <= self.mtf_at_nyquist <= PIXEL_MTF):
            raise ParameterError(
                "a sensor has 8 to 16 bits, electrons above 0, noise of 0 or more, and mtf_at_nyquist of 0.01 to "
                f"{PIXEL_MTF:.3f}, that of a pixel alone; not {self}"
            )

    @property
    def top(self) -> int:
        """The largest number."""
        return int(2**self.bits - 1)

    @property
    def lens_sigma_px(self) -> float:
        """Width of the lens's Gaussian blur, from the contrast that is not lost in the pixel: [px]

        MTF = sinc(1/2) exp(-pi^2 s^2 / 2) at half a cycle a pixel.
        """
        return math.sqrt(2 * math.log(PIXEL_MTF / self.mtf_at_nyquist)) / math.pi


class Triangulated(NamedTuple):
    """Points from two pixels each; NaN where the rays do not meet ahead.

    Attributes
    ----------
    points : in the left camera's frame. (..., 3) [m]
    miss_m : by how much the two rays miss each other. (...) [m]
    """

    points: FloatArray
    miss_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoRig:
    """A stereo rig: X_right = rotation X_left + translation_m.

    Attributes
    ----------
    name : what it is called.
    left, right : its cameras.
    rotation : turns a direction of the left camera's frame into the right one's. (3, 3)
    translation_m : the left camera's centre in the right one's frame; its length is the baseline. (3,) [m]
    covariance : of `PARAMETERS`, with the rotation as a small one that is applied after `rotation`. (24, 24)
    sensor : what makes numbers of its light.
    mast_height_m : of the left camera over the ground, None where it is not known. [m]
    nearest_m : where sharp pictures begin. [m]
    assumed : names of what is a guess.
    source : where the numbers are from.
    read_as : how its files were read, where there was a choice.
    """

    name: str
    left: Camera
    right: Camera
    rotation: FloatArray
    translation_m: FloatArray
    covariance: FloatArray
    sensor: Sensor = Sensor()
    mast_height_m: float | None = None
    nearest_m: float = 0.0
    assumed: tuple[str, ...] = ()
    source: str = ""
    read_as: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        Pose(rotation=self.rotation, center_m=self.translation_m)
        size, given = len(PARAMETERS), np.asarray(self.covariance, dtype=float)
        good = given.shape == (size, size) and np.isfinite(given).all()
        if good:
            scale = np.sqrt(np.maximum(np.diag(given), 1e-300))
            good = np.allclose(given, given.T, atol=1e-9 * max(1.0, np.abs(given).max()))
            good = good and np.linalg.eigvalsh(given / np.outer(scale, scale)).min() >= -1e-6
        reasons = {
            "both cameras are at one place; a stereo rig needs a baseline": not self.baseline_m > 0,
            f"a covariance of shape {given.shape}; give {size} x {size} finite numbers, symmetric, without a negative "
            "variance": not good,
        }
        refuse(reasons, self.name)

    @property
    def height_m(self) -> float:
        """Of the left camera over the ground, assumed where it is not known. [m]"""
        return self.mast_height_m or MAST_M

    @property
    def baseline_m(self) -> float:
        """Distance of the two centres. [m]"""
        return float(np.linalg.norm(self.translation_m))

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviation of each of `PARAMETERS`, in the unit that its name ends in."""
        return dict(zip(PARAMETERS, map(math.sqrt, np.diag(self.covariance)), strict=True))

    @property
    def in_rows(self) -> FloatArray:
        """From the left camera's frame to one with rows in line: x along the baseline, z between both axes. (3, 3)"""
        along, ahead = -self.rotation.T @ self.translation_m / self.baseline_m, self.rotation[2] + [0.0, 0.0, 1.0]
        ahead = ahead - (ahead @ along) * along
        ahead /= np.linalg.norm(ahead)
        return np.stack([along, np.cross(ahead, along), ahead])

    def summary(self) -> dict[str, Any]:
        """Name, baseline, and what is assumed, for a result."""
        return {"name": self.name, "baseline_m": self.baseline_m, "assumed": list(self.assumed)}

    def moved(self, changes: npt.ArrayLike) -> "StereoRig":
        """The rig with its parameters changed by so much. (24,)"""
        left, right, turn, way = np.split(np.asarray(changes, dtype=float), (9, 18, 21))
        return dataclasses.replace(
            self,
            left=self.left.with_vector(self.left.vector() + left),
            right=self.right.with_vector(self.right.vector() + right),
            rotation=rotation_of(turn) @ self.rotation,
            translation_m=self.translation_m + way,
        )

    def with_pixels(self, width_px: int) -> "StereoRig":
        """The same view, and errors of the same size in it, in pictures that are `width_px` wide.

        The sensor's numbers stay those of a pixel. Raises ParameterError where a height is then no whole number.
        """
        share = width_px / self.left.width_px
        scale = [share if name.endswith("_px") else 1.0 for name in PARAMETERS]
        return dataclasses.replace(
            self,
            name=f"{self.name}, {width_px} px wide",
            left=self.left.scaled(share),
            right=self.right.scaled(share),
            covariance=self.covariance * np.outer(scale, scale),
        )

    def drawn(self, random: np.random.Generator) -> "StereoRig":
        """A rig that this one may really be: a draw from its covariance."""
        return self.moved(random.multivariate_normal(np.zeros(len(PARAMETERS)), self.covariance, method="eigh"))

    def right_pose(self, left: Pose) -> Pose:
        """Where the right camera is when the left one is at a pose."""
        center = left.to_world(-self.rotation.T @ self.translation_m)
        return Pose(rotation=left.rotation @ self.rotation.T, center_m=center)

    def project(self, points: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Pixels (..., 2) of points (..., 3) of the left camera's frame in both pictures."""
        given = np.asarray(points, dtype=float)
        return self.left.project(given), self.right.project(given @ self.rotation.T + self.translation_m)

    def triangulate(self, left_px: npt.ArrayLike, right_px: npt.ArrayLike) -> Triangulated:
        """Points where the rays of two pixels (..., 2) are nearest to each other: the middle between them.

        The point is in the left camera's frame; NaN where a pixel has no ray, rays are parallel, or they meet behind.
        """
        first = self.left.rays(left_px)
        second = self.right.rays(right_px) @ self.rotation
        offset = -self.rotation.T @ self.translation_m
        a, b, c = (np.einsum("...i,...i", p, q) for p, q in ((first, first), (first, second), (second, second)))
        d, e = first @ offset, second @ offset
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (c * d - b * e) / (a * c - b * b)
            other = (b * d - a * e) / (a * c - b * b)
        on_first, on_second = first * along[..., None], second * other[..., None] + offset
        points = 0.5 * (on_first + on_second)
        good = (along > 0) & (other > 0) & np.isfinite(points).all(axis=-1)
        miss = np.linalg.norm(on_first - on_second, axis=-1)
        return Triangulated(np.where(good[..., None], points, np.nan), np.where(good, miss, np.nan))

    def by_parameters(self, left_px: npt.ArrayLike, right_px: npt.ArrayLike) -> FloatArray:
        """Derivatives (..., 3, 24) of triangulated points by the rig's parameters, by central differences.

        The steps are a tenth of the standard deviations. With the covariance C of the rig, J_i C J_k^T is the
        covariance of two points: the error that does not average.
        """
        sigmas = np.sqrt(np.diag(self.covariance))
        by = np.zeros((*np.shape(left_px)[:-1], 3, len(sigmas)))
        for index in np.flatnonzero(sigmas):
            change = np.zeros(len(sigmas))
            change[index] = 0.1 * sigmas[index]
            more, less = (self.moved(sign * change).triangulate(left_px, right_px).points for sign in (1.0, -1.0))
            by[..., index] = (more - less) / (2 * change[index])
        return by

    def range_error_m(self, range_m: npt.ArrayLike, disparity_sigma_px: float) -> FloatArray:
        """Random error of the range from that of a disparity: z^2 s / (f b). [m]"""
        return np.asarray(range_m, dtype=float) ** 2 * disparity_sigma_px / (self.left.fx_px * self.baseline_m)


def is_swapped(translation_m: FloatArray) -> bool:
    """Whether the right camera of a rig is left of the left one: by the left one's centre in the right one's frame."""
    return bool(translation_m[0] > abs(translation_m[1]))


def covariance_of(sigmas: dict[str, float]) -> FloatArray:
    """A covariance without correlations, from standard deviations by the names of `PARAMETERS`; 0 where none is given.

    Raises ParameterError for a name that is none, and for a negative or infinite sigma.
    """
    for name, value in sigmas.items():
        if name not in PARAMETERS or not 0 <= value < math.inf:
            raise ParameterError(
                f"'{name}' is no parameter of a stereo rig; {one_of(name, PARAMETERS)}" if name not in PARAMETERS else
                f"sigma of {name} is {value}; give a number of 0 or more"
            )  # fmt: skip
    return np.diag([sigmas.get(name, 0.0) ** 2 for name in PARAMETERS])


def unstated_covariance(left: Camera, right: Camera, translation_m: FloatArray) -> FloatArray:
    """Errors that a rig has whose file states none, as `UNSTATED`. (24, 24)"""
    share, shift_px = UNSTATED
    sides = (("left", left), ("right", right))
    focal = {f"{side}_{name}": share * getattr(one, name) for side, one in sides for name in INTRINSICS[:2]}
    turns = dict.fromkeys(RELATIVE[:3], shift_px / left.fx_px)
    return covariance_of(focal | turns | dict.fromkeys(RELATIVE[3:], share * float(np.linalg.norm(translation_m))))
