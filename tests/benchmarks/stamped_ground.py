"""SYNTHETIC ground with a track or rocks of known size, and what stereo makes of it; knows nothing of what measures."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, uniform_filter

from lunarsci.images.elevation import ElevationModel

FINE = 0.005
NAVCAM, PANCAM = 1180.0, 3378.0
"""Focal lengths in px: of a NavCam, and of a PanCam binned by two."""


def fractal(rng: np.random.Generator, shape: tuple[int, int], slope_deg: float, exponent: float = 0.75) -> Any:
    """Self-affine ground whose slopes over 0.1 m have this rms. (ny, nx) [m]"""
    size = max(shape) + 8
    k = np.hypot(np.fft.rfftfreq(size, FINE)[None], np.fft.fftfreq(size, FINE)[:, None])
    k[0, 0] = 1.0
    amplitude = np.where(k < 50.0, k ** -(exponent + 1.0), 0.0)
    amplitude[0, 0] = 0.0
    z = np.fft.irfft2(amplitude * np.exp(2j * np.pi * rng.random(k.shape)), s=(size, size))
    lag = round(0.1 / FINE)
    return (z * np.tan(np.radians(slope_deg)) * 0.1 / (z[:, lag:] - z[:, :-lag]).std())[: shape[0], : shape[1]]


@dataclass
class Ground:
    """Fine heights before and after, and the truth at each fine node."""

    x: Any
    y: Any
    before: Any
    after: Any

    def seen(
        self,
        rng: np.random.Generator,
        focal_px: float,
        camera: tuple[float, float, float],
        *,
        sigma_px: float = 0.2,
        bias_px: float = 0.05,
        holes: float = 0.05,
        spacing: float = 0.01,
        window_px: int = 9,
    ) -> ElevationModel:
        """Heights that matching gives: averaged over its window, with noise and a slowly varying bias, and holes."""
        z = self.after
        away = [self.x - camera[0], self.y - camera[1], camera[2] - z]
        distance = np.sqrt(sum(part**2 for part in away))
        sine, pixel = away[2] / distance, distance / focal_px
        sizes = [max(1, round(window_px * float(side.mean()) / FINE)) for side in (pixel, pixel / sine)]
        by_disparity = distance**2 / (focal_px * 0.27) * sine
        noise = uniform_filter(rng.standard_normal(z.shape), sizes)
        bias = gaussian_filter(rng.standard_normal(z.shape), 0.15 / FINE)
        error = by_disparity * (sigma_px * noise / noise.std() + bias_px * bias / bias.std())
        step = round(spacing / FINE)
        height = (uniform_filter(z, sizes) + error)[::step, ::step].copy()
        where = gaussian_filter(rng.standard_normal(height.shape), 3)
        height[where > np.quantile(where, 1 - holes)] = np.nan
        return ElevationModel(
            name="stamped",
            x0_m=0.0,
            y0_m=0.0,
            spacing_m=spacing,
            height_m=height,
            height_m_sigma=(by_disparity * sigma_px)[::step, ::step],
            height_by_disparity_m_px=by_disparity[::step, ::step],
            resolution_m=np.array(FINE * np.sqrt(sizes[0] * sizes[1])),
            synthetic=True,
        )


def _nodes(size: tuple[float, float]) -> tuple[Any, Any]:
    return np.meshgrid(*(np.arange(round(side / FINE)) * FINE for side in size))


def with_track(
    rng: np.random.Generator, depth: float, *, slope_deg: float = 1.0, width: float = 0.15, swing: float = 0.0
) -> Ground:
    """A rigid wheel rolled along y = 1.2 m: a floor level across, walls of 35 degrees, berms beside."""
    x, y = _nodes((1.7, 2.4))
    tilt = 0.03 * x + 0.05 * y
    rough = fractal(rng, x.shape, slope_deg)
    left = y - 1.2 - swing * np.sin(0.9 * x)
    inside = np.abs(left) <= 0.5 * width
    mean = np.nanmean(np.where(inside, rough, np.nan), axis=0)
    aside = np.abs(left) - 0.5 * width
    after = rough - np.maximum(0.0, depth - aside * np.tan(np.radians(35.0)))
    after += 0.2 * depth * np.exp(-0.5 * ((aside - 0.03) / 0.02) ** 2)
    after = np.where(inside, gaussian_filter(mean, 0.03 / FINE)[None] - depth, after)
    return Ground(x, y, rough + tilt, after + tilt)


def with_rocks(
    rng: np.random.Generator, diameters: list[float], *, slope_deg: float = 1.0, size: tuple[float, float] = (4.0, 3.0)
) -> tuple[Ground, Any]:
    """Rocks as blocks with rounded tops, half as high as wide or less, on fractal ground; and their places (n, 3)."""
    x, y = _nodes(size)
    ground = fractal(rng, x.shape, slope_deg) + 0.03 * x
    rocks: list[tuple[float, float, float]] = []
    after = ground.copy()
    for diameter in diameters:
        for _ in range(1000):
            place = rng.uniform(0.25, [size[0] - 0.25, size[1] - 0.25])
            if all(np.hypot(*(place - rock[:2])) > 2 * (diameter + rock[2]) for rock in np.array(rocks).reshape(-1, 3)):
                break
        rocks.append((*place, diameter))
        turn, long, high = rng.uniform(0, np.pi), rng.uniform(1.0, 1.5), rng.uniform(0.4, 0.7)
        u = np.cos(turn) * (x - place[0]) + np.sin(turn) * (y - place[1])
        v = -np.sin(turn) * (x - place[0]) + np.cos(turn) * (y - place[1])
        inside = (u / np.sqrt(long)) ** 2 + (v * np.sqrt(long)) ** 2
        after += high * diameter * np.clip(1.0 - (inside / (0.5 * diameter) ** 2) ** 2, 0.0, None) ** 0.5
    return Ground(x, y, ground, after), np.array(rocks)
