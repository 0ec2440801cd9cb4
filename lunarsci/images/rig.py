"""Two cameras that are fixed to each other: triangulation, and the errors that all pixels share."""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.images.camera import INTRINSICS, Camera, Pose, rotation_of
from lunarsci.names import one_of

RELATIVE = (*(f"rotation_{axis}_rad" for axis in "xyz"), *(f"translation_{axis}_m" for axis in "xyz"))
PARAMETERS = (*(f"left_{n}" for n in INTRINSICS), *(f"right_{n}" for n in INTRINSICS), *RELATIVE)
"""What a rig depends on: rows and columns of its covariance."""
MAST_M = 1.5
"""Height of a camera whose rig does not say: assumed. [m]"""
PIXEL_MTF = 2 / math.pi
"""Contrast that a square pixel leaves at half a cycle a pixel. [-]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """What makes numbers of light, the same in both cameras.

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
        if not (8 <= self.bits <= 16 and 0 < self.full_well_e < math.inf and 0 <= self.read_noise_e < math.inf):
            raise ParameterError("a sensor has 8 to 16 bits, electrons above 0 and noise of 0 or more")
        if not 0.01 <= self.mtf_at_nyquist <= PIXEL_MTF:
            raise ParameterError(
                f"mtf_at_nyquist is {self.mtf_at_nyquist}; give 0.01 to {PIXEL_MTF:.3f}, a pixel alone"
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
    """Points (..., 3) in the left camera's frame [m], and by how much the two rays miss each other [m]."""

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
        if not self.baseline_m > 0:
            raise ParameterError(f"{self.name}: both cameras are at one place; a stereo rig needs a baseline")
        size, given = len(PARAMETERS), np.asarray(self.covariance)
        if given.shape != (size, size) or not np.allclose(given, given.T, atol=1e-9 * max(1.0, np.abs(given).max())):
            raise ParameterError(
                f"{self.name}: the covariance has shape {given.shape}; give {size} x {size}, symmetric"
            )
        spread = np.sqrt(np.maximum(np.diag(given), 1e-300))
        if not np.isfinite(given).all() or np.linalg.eigvalsh(given / np.outer(spread, spread)).min() < -1e-6:
            raise ParameterError(f"{self.name}: the covariance is not finite or has a negative variance")

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
        """Standard deviation of each parameter."""
        return dict(zip(PARAMETERS, map(math.sqrt, np.diag(self.covariance)), strict=True))

    def moved(self, changes: npt.ArrayLike) -> "StereoRig":
        """The rig with its parameters changed by so much. (24,)"""
        delta = np.asarray(changes, dtype=float)
        count = len(INTRINSICS)
        return dataclasses.replace(
            self,
            left=self.left.with_vector(self.left.vector() + delta[:count]),
            right=self.right.with_vector(self.right.vector() + delta[count : 2 * count]),
            rotation=rotation_of(delta[2 * count : 2 * count + 3]) @ self.rotation,
            translation_m=self.translation_m + delta[2 * count + 3 :],
        )

    def with_pixels(self, width_px: int) -> "StereoRig":
        """The same view, and errors of the same size in it, in pictures that are `width_px` wide.

        The sensor's numbers stay those of a pixel. Raises ParameterError where a height is then no whole number.
        """
        share = width_px / self.left.width_px
        own = [share if name.endswith("_px") else 1.0 for name in PARAMETERS]
        return dataclasses.replace(
            self,
            name=f"{self.name}, {width_px} px wide",
            left=self.left.scaled(share),
            right=self.right.scaled(share),
            covariance=self.covariance * np.outer(own, own),
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
        spread = np.sqrt(np.diag(self.covariance))
        steps = np.where(spread > 0, 0.1 * spread, 1.0)
        columns = []
        for index, step in enumerate(steps):
            if spread[index] == 0:
                columns.append(np.zeros((*np.shape(left_px)[:-1], 3)))
                continue
            change = np.zeros(len(steps))
            change[index] = step
            more, less = (self.moved(sign * change).triangulate(left_px, right_px).points for sign in (1.0, -1.0))
            columns.append((more - less) / (2 * step))
        return np.stack(columns, axis=-1)

    def by_pixels(self, left_px: npt.ArrayLike, right_px: npt.ArrayLike, step_px: float = 0.01) -> FloatArray:
        """Derivatives (..., 3, 4) of triangulated points by (u, v) of the left and of the right pixel. [m/px]"""
        pixels = np.concatenate([np.asarray(left_px, dtype=float), np.asarray(right_px, dtype=float)], axis=-1)
        columns = []
        for index in range(4):
            change = np.zeros(4)
            change[index] = step_px
            more, less = (pixels + sign * change for sign in (1.0, -1.0))
            points = [self.triangulate(p[..., :2], p[..., 2:]).points for p in (more, less)]
            columns.append((points[0] - points[1]) / (2 * step_px))
        return np.stack(columns, axis=-1)

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
        if name not in PARAMETERS:
            raise ParameterError(f"'{name}' is no parameter of a stereo rig; {one_of(name, PARAMETERS)}")
        if not 0 <= value < math.inf:
            raise ParameterError(f"sigma of {name} is {value}; give a number of 0 or more")
    return np.diag([sigmas.get(name, 0.0) ** 2 for name in PARAMETERS])
