"""SYNTHETIC pictures of targets, by OpenCV's lens and nothing of `lunarsci.images`: the judge of calibration.

Each pixel is the mean of rays that OpenCV undistorts and a plane cuts; then blur, noise and 8 bits.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np

SIDE = 3


class Lens(NamedTuple):
    """Size (width, height), K and (k1, k2, p1, p2, k3) of OpenCV."""

    size: tuple[int, int]
    matrix: np.ndarray
    terms: np.ndarray


def lens(fx: float, cx: float, cy: float, terms: tuple[float, ...], size: tuple[int, int] = (480, 400)) -> Lens:
    return Lens(size, np.array([[fx, 0, cx], [0, 1.002 * fx, cy], [0, 0, 1]]), np.array(terms))


def rays(of: Lens) -> np.ndarray:
    """Directions of all rays of a picture. (h SIDE, w SIDE, 3)"""
    width, height = of.size
    u, v = (np.arange(n * SIDE) / SIDE - 0.5 + 0.5 / SIDE for n in (width, height))
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 60, 1e-10)
    flat = cv2.undistortPointsIter(grid, of.matrix, of.terms, None, None, stop) if hasattr(
        cv2, "undistortPointsIter") else cv2.undistortPoints(grid, of.matrix, of.terms, criteria=stop)  # fmt: skip
    return np.dstack([flat.reshape(height * SIDE, width * SIDE, 2), np.ones((height * SIDE, width * SIDE))])


def chessboard(x: np.ndarray, y: np.ndarray, columns: int, rows: int, square: float) -> np.ndarray:
    """Light of a board whose inner corners begin at (0, 0), with a white margin of a square. [0, 1]"""
    i, j = np.floor(x / square).astype(int), np.floor(y / square).astype(int)
    inside = (i >= -1) & (i < columns) & (j >= -1) & (j < rows)
    margin = (i >= -2) & (i <= columns) & (j >= -2) & (j <= rows)
    return np.where(inside, np.where((i + j) % 2 == 0, 0.1, 0.9), np.where(margin, 0.9, 0.4))


def circles(x: np.ndarray, y: np.ndarray, centers: np.ndarray, diameter: float) -> np.ndarray:
    """Light of dark circles on white."""
    light = np.full(x.shape, 0.9)
    low, high = centers.min(axis=0) - 2 * diameter, centers.max(axis=0) + 2 * diameter
    light[(x < low[0]) | (x > high[0]) | (y < low[1]) | (y > high[1])] = 0.4
    for cx, cy in centers:
        light[(x - cx) ** 2 + (y - cy) ** 2 < 0.25 * diameter**2] = 0.1
    return light


def picture(ways: np.ndarray, turn: np.ndarray, place: np.ndarray, light: Any, random: np.random.Generator, *,
            blur_px: float = 0.7, noise: float = 2.0) -> np.ndarray:  # fmt: skip
    """A board with rotation `turn` (3, 3) at `place` (3,) in the camera's frame, seen along rays. (h, w) uint8"""
    normal = turn[:, 2]
    depth = (normal @ place) / (ways @ normal)
    points = (ways * depth[..., None] - place) @ turn
    seen = np.where(depth > 0, light(points[..., 0], points[..., 1]), 0.4)
    height, width = (n // SIDE for n in seen.shape)
    grey = cv2.GaussianBlur(seen, (0, 0), blur_px * SIDE).reshape(height, SIDE, width, SIDE).mean(axis=(1, 3))
    return np.clip(np.rint(20 + 200 * grey + noise * random.standard_normal(grey.shape)), 0, 255).astype(np.uint8)


def poses(count: int, middle: tuple[float, float], distance: float, random: np.random.Generator, *,
          tilt: float = 0.6, spread: float = 0.22) -> list[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """Boards about the axis of the left camera, tilted up to `tilt` [rad] each way."""
    found = []
    for _ in range(count):
        turn = cv2.Rodrigues(np.array([*random.uniform(-tilt, tilt, 2), random.uniform(-0.3, 0.3)]))[0]
        depth = distance * random.uniform(0.85, 1.3)
        way = np.array([*random.uniform(-spread, spread, 2), 1.0])
        found.append((turn, depth * way - turn @ np.array([*middle, 0.0])))
    return found
