"""Targets of calibration: which points of a flat board are seen where in a picture."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.images.pictures import Picture, open_cv
from lunarsci.names import one_of

Kind = Literal["chessboard", "circles", "asymmetric-circles", "charuco"]
GOES_ON = 0.75
"""Contrast of squares beyond a board, over that within, from which it is larger than stated; the outer edge of the
outer squares has half of it. Assumed."""
NEAR = 0.4
"""Half width of the window about a corner, as a share of the distance to the next; assumed."""
FEWEST_POINTS = 6
"""Points of a board that a picture must show; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardTarget:
    """A flat board of points.

    Attributes
    ----------
    kind : what it shows.
    columns, rows : of inner corners (chessboard), circles, or squares (charuco).
    square_m : side of a square, or distance of circles; of asymmetric ones half the distance within a row. [m]
    marker_m : side of the markers of a charuco board. [m]
    circle_m : diameter of circles; 0 leaves the centres of their pictures as they are. [m]
    dictionary : of the markers, as OpenCV calls it.

    Raises ParameterError for what no board can be.
    """

    kind: Kind = "chessboard"
    columns: int = 9
    rows: int = 6
    square_m: float = 0.025
    marker_m: float = 0.0
    circle_m: float = 0.0
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise ParameterError(f"'{self.kind}' is no kind of target; {one_of(self.kind, get_args(Kind))}")
        if min(self.columns, self.rows) < 3 or max(self.columns, self.rows) > 100:
            raise ParameterError(f"a board of {self.columns} x {self.rows}; give 3 to 100 each way")
        if not 0 < self.square_m < 100:
            raise ParameterError(f"squares of {self.square_m:g} m; give a number above 0")
        if self.kind == "charuco" and not 0 < self.marker_m < self.square_m:
            raise ParameterError("markers of a charuco board are smaller than its squares; give their side in m")
        if not 0 <= self.circle_m < 2 * self.square_m:
            raise ParameterError(f"circles of {self.circle_m:g} m do not fit between centres {self.square_m:g} m apart")

    @property
    def points_m(self) -> FloatArray:
        """All points of the board, row by row. (n, 3) [m]"""
        if self.kind == "charuco":
            return np.asarray(self.charuco().getChessboardCorners(), dtype=float).reshape(-1, 3)
        row, column = np.mgrid[: self.rows, : self.columns].astype(float)
        across = 2 * column + row % 2 if self.kind == "asymmetric-circles" else column
        return self.square_m * np.stack([across, row, np.zeros_like(row)], axis=-1).reshape(-1, 3)

    def charuco(self) -> Any:
        """OpenCV's board. Raises ParameterError for a dictionary that it does not know."""
        markers = open_cv().aruco
        if not hasattr(markers, self.dictionary):
            raise ParameterError(f"'{self.dictionary}' is no dictionary of markers; one is DICT_4X4_50")
        words = markers.getPredefinedDictionary(getattr(markers, self.dictionary))
        return markers.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, words)

    def __str__(self) -> str:
        return f"{self.kind} of {self.columns} x {self.rows}"


class Sighting(NamedTuple):
    """Points of a target in a picture: their places in `BoardTarget.points_m` (n,), and where they are (n, 2) [px]."""

    numbers: npt.NDArray[np.int64]
    pixels: FloatArray


def find_target(picture: Picture, target: BoardTarget, *, patient: bool = True) -> Sighting | None:
    """Where a picture shows the points of a target; None where it does not. `patient` looks for seconds."""
    eight = eight_bits(picture)
    if target.kind == "charuco":
        return _charuco(eight, target)
    size = target.columns, target.rows
    pixels = _chessboard(eight, size, patient) if target.kind == "chessboard" else _circles(eight, target)
    if pixels is None:
        return None
    return Sighting(np.arange(len(pixels)), pixels)


def eight_bits(picture: Picture) -> npt.NDArray[np.uint8]:
    """A picture from black to its brightest in 8 bits. (h, w)"""
    low, high = np.percentile(picture.values, [0.5, 99.5])
    return np.asarray(np.clip(255 * (picture.values - low) / max(high - low, 1e-9), 0, 255), dtype=np.uint8)


def _chessboard(eight: npt.NDArray[np.uint8], size: tuple[int, int], patient: bool) -> FloatArray | None:
    """Corners by the sectors about them (Duda & Frese 2018, Br. Mach. Vis. Conf.), then by the gradients there.

    Gradients (Foerstner & Guelch 1987, ISPRS Intercomm. Conf. Fast Process. Photogramm. Data) are three times as
    precise on tilted boards, and without bias.
    """
    cv2 = open_cv()
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    flags |= cv2.CALIB_CB_EXHAUSTIVE if patient else 0
    found, corners = cv2.findChessboardCornersSB(eight, size, flags=flags)
    if not found:
        return None
    start = np.asarray(corners, dtype=np.float32).reshape(size[1], size[0], 2)
    apart = min(float(np.linalg.norm(np.diff(start, axis=axis), axis=-1).min()) for axis in (0, 1))
    half = (max(2, int(NEAR * apart)),) * 2
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    return np.asarray(cv2.cornerSubPix(eight, start.reshape(-1, 1, 2), half, (-1, -1), stop), float).reshape(-1, 2)


def _circles(eight: npt.NDArray[np.uint8], target: BoardTarget) -> FloatArray | None:
    cv2 = open_cv()
    wanted = cv2.SimpleBlobDetector_Params()
    wanted.minArea, wanted.maxArea, wanted.minThreshold, wanted.thresholdStep = 12.0, 0.05 * eight.size, 20.0, 5.0
    blobs = cv2.SimpleBlobDetector_create(wanted)
    grid = cv2.CALIB_CB_SYMMETRIC_GRID if target.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
    found, centers = cv2.findCirclesGrid(eight, (target.columns, target.rows), flags=grid, blobDetector=blobs)
    return np.asarray(centers, dtype=float).reshape(-1, 2) if found else None


def _charuco(eight: npt.NDArray[np.uint8], target: BoardTarget) -> Sighting | None:
    cv2 = open_cv()
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(target.charuco()).detectBoard(eight)
    if numbers is None or len(numbers) < FEWEST_POINTS:
        return None
    return Sighting(np.asarray(numbers, dtype=np.int64).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2))


def alike_turned(left: Sighting, right: Sighting) -> Sighting:
    """The right picture's sighting numbered as the left one's: a board that looks alike upside down may be turned."""
    ways = [s.pixels[-1] - s.pixels[0] for s in (left, right)]
    return right if float(ways[0] @ ways[1]) >= 0 else Sighting(right.numbers, right.pixels[::-1])


def check_board(pictures: Sequence[Picture], seen: Sequence[Sighting | None], target: BoardTarget) -> None:
    """Raise DataError where the board of some pictures is not as large as stated, as far as that can be told."""
    if target.kind != "chessboard":
        return
    size = target.columns, target.rows
    known = [(eight_bits(p), s.pixels) for p, s in zip(pictures, seen, strict=True) if s is not None]
    beyond = Counter(side for eight, pixels in known for side in _goes_on(eight, pixels, size))
    often = [side for side, count in beyond.items() if count > 0.5 * len(known)]
    if often:
        raise DataError(f"the chessboard goes on {' and '.join(often)} beyond {size[0]} x {size[1]}; {INNER}")
    if len(known) > 0.5 * len(pictures):
        return
    without = [p for p, s in zip(pictures, seen, strict=True) if s is None]
    for picture in without[:2]:
        if other := _other_size(picture, size):
            raise DataError(
                f"{picture.source.name}: shows a chessboard of {other[0]} x {other[1]}, "
                f"not {size[0]} x {size[1]}; {INNER}"
            )


INNER = "a chessboard's size is that of its inner corners, squares less one each way"


def _goes_on(eight: npt.NDArray[np.uint8], pixels: FloatArray, size: tuple[int, int]) -> list[str]:
    """Sides at which squares alternate beyond the corners that were found."""
    cv2 = open_cv()
    columns, rows = size
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    plane = cv2.findHomography(np.stack([column.ravel(), row.ravel()], axis=-1), pixels.astype(np.float32))[0]

    def contrast(columns_at: FloatArray, rows_at: FloatArray) -> FloatArray:
        at = np.stack([columns_at + 0.0, rows_at + 0.0], axis=-1)[:, None] + 0.25 * np.array(
            [[1, 1], [-1, 1], [-1, -1], [1, -1]]
        )
        there = cv2.perspectiveTransform(at.reshape(1, -1, 2).astype(np.float32), plane).reshape(-1, 2)
        light = cv2.remap(eight.astype(np.float32), there[:, 0], there[:, 1], cv2.INTER_LINEAR, borderValue=np.nan)
        signs = np.where((columns_at + rows_at) % 2 == 0, 1.0, -1.0)
        return np.asarray(signs * (light.reshape(-1, 4) @ np.array([1.0, -1.0, 1.0, -1.0])))

    within = float(np.median(contrast(column.ravel().astype(float), row.ravel().astype(float))))
    across, down = np.arange(columns, dtype=float), np.arange(rows, dtype=float)
    sides = {
        "left of it": (np.full(rows, -1.0), down),
        "right of it": (np.full(rows, float(columns)), down),
        "above it": (across, np.full(columns, -1.0)),
        "below it": (across, np.full(columns, float(rows))),
    }
    means = {side: float(np.median(contrast(*places))) for side, places in sides.items()}
    return [side for side, mean in means.items() if math.isfinite(mean) and mean / within > GOES_ON]


def _other_size(picture: Picture, size: tuple[int, int]) -> tuple[int, int] | None:
    """The largest chessboard near a size that a picture shows."""
    eight = eight_bits(picture)
    tries = [(size[0] + a, size[1] + b) for a, b in product((2, 1, 0, -1, -2), repeat=2)]
    for other in sorted((t for t in tries if min(t) >= 3 and t != size), key=lambda t: -t[0] * t[1]):
        if _chessboard(eight, other, False) is not None:
            return other
    return None
