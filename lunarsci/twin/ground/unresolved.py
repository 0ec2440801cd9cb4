"""Roughness that lies between the nodes of a coarse grid, drawn from the roughness of the Moon by scale.

A map from orbit shows no ground between its nodes, and a rover meets it. Differences of lunar heights over a distance l
have the variance c l^(2 H), and medians of slope and exponent are known for maria and highlands down to 17 m. That the
law goes on to the size of a wheel is assumed. How rough the ground is beside the law the map's own heights tell, as far
as a map that may be smoothed can. What a smooth surface through nodes of that spacing does not show of such ground is
laid on nodes as close as a wheel is large; how rough it is changes from place to place by what is not known of it.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import NORMAL_MAD, FloatArray
from lunarsci.regolith.prior import Law, Question, question
from lunarsci.regolith.wheel import Wheel
from lunarsci.twin.ground.height_errors import GRAIN_NODES, HeightErrors, Relief, fractal_power, mean_over
from lunarsci.twin.ground.terrain import Terrain

BASELINE_M = 17.0
"""Shortest distance over which slopes were measured from orbit: Rosenburg et al. (2011), 10.1029/2010JE003716. [m]"""
MARIA, HIGHLANDS = (2.0, 0.76), (7.5, 0.95)
"""Median slope of the ground over 17 m [deg], and median Hurst exponent [-]: Rosenburg et al. (2011), as above."""
WITHIN_KIND = 0.45
"""Standard deviation of ln of the size of differences within maria or highlands; assumed."""
OF_A_MAP, DEGREES = 0.5, 4.0
"""How well a map tells it: standard deviation of a Student law with so many degrees of freedom. Maps are smoothed, and
one that is level throughout tells little; assumed."""
LAGS = (2, 4)
"""Nodes over which a map's second differences are looked at: over one node matching and resampling smooth; assumed."""
ALIKE_M = 10.0
"""Distance over which the ground stays about as rough; assumed. [m]"""
MARGIN_M, MARGIN_SHARE = 10.0, 0.2
"""About a plan, and of its length, on which finer nodes are laid: drives stray less. Assumed."""
MOST_NODES = 4_000_000
"""Of the finer grid; beyond them nodes lie wider apart."""
OBSTACLE_SIGMAS = 3.0
"""Of what lies between nodes, that make an obstacle; assumed."""
SLOPE_SD = 1.0
"""Standard deviation of the logarithm of median slopes of maps about that of the law: assumed, flat maria to crater
walls."""
HEIGHT_UNITS = {"km": 1e3, "cm": 1e-2, "mm": 1e-3}
"""In metres, by definition; feet and decimetres make slopes that the Moon has, too."""


def relief_of_kind(slope_deg: float, hurst: float) -> Relief:
    """The law of differences of heights for a median slope over 17 m and an exponent."""
    # Slopes along x and y are normal, so that the ground's slope has Rayleigh's law, of median sqrt(2 ln 2).
    rms_m = BASELINE_M * math.tan(math.radians(slope_deg)) / math.sqrt(2.0 * math.log(2.0))
    return Relief(rms_m**2 * BASELINE_M ** (-2.0 * hurst), hurst)


def lunar_relief() -> tuple[Relief, float]:
    """The law half-way between maria and highlands, in logarithms, and how far each is from it. [ln of a height]"""
    one, other = relief_of_kind(*MARIA), relief_of_kind(*HIGHLANDS)
    apart = 0.25 * math.log(other.at_one_m / one.at_one_m)
    return Relief(math.sqrt(one.at_one_m * other.at_one_m), 0.5 * (one.hurst + other.hurst)), apart


def terrain_questions(terrain: Terrain) -> list[Question]:
    """Whether its median slope is one of the Moon at its spacing, or would be in another unit of heights."""
    height = terrain.height_m
    slope = np.hypot(np.diff(height, axis=0)[:, :-1], np.diff(height, axis=1)[:-1]) / terrain.spacing_m
    known = slope[np.isfinite(slope)]
    if not known.size:
        return []
    relief, _ = lunar_relief()
    usual = math.sqrt(relief.at_one_m * 2.0 * math.log(2.0)) * terrain.spacing_m ** (relief.hurst - 1.0)
    law, median = Law("ln", usual, SLOPE_SD), float(np.median(known))
    asked = question("median slope of the terrain [m/m]", median, law, HEIGHT_UNITS, "--height-unit m")
    # Ground may be as level as it will: only another unit makes it doubtful.
    return [asked] if asked is not None and asked.likely_unit else []


@dataclass(frozen=True, slots=True)
class Unresolved:
    """What a grid does not show.

    Attributes
    ----------
    spacing_m : of its nodes. [m]
    rms_m : what lies between them, in the median over the ground that may be there. [m]
    deciding_m : spacing at which no obstacle of the rover lies between nodes. [m]
    """

    spacing_m: float
    rms_m: float
    deciding_m: float


def with_unresolved(
    terrain: Terrain, places_m: FloatArray, wheel: Wheel, step_m: float, seed: int = 0
) -> tuple[Terrain, Unresolved | None]:
    """A terrain about planned places (n, 2) on nodes no wider than a wheel's radius, with what it does not show.

    As it is, and None, where its own nodes are as close. `step_m` is what a wheel climbs.
    """
    factor = 2 ** max(0, math.ceil(math.log2(terrain.spacing_m / wheel.radius_m) - 1e-9))
    rows, columns = _about(terrain, places_m)
    while factor > 1 and (rows.stop - rows.start) * (columns.stop - columns.start) * factor**2 > MOST_NODES:
        factor //= 2
    if factor == 1:
        return terrain, None
    finer = _finer(terrain, rows, columns, factor)
    rougher = roughness_of_map(terrain)
    grain = unresolved_grain(factor, finer.spacing_m, seed, rougher, wheel.width_m)
    errors = HeightErrors(
        common=np.zeros((*finer.height_m.shape, 0), np.float32),
        level=np.zeros(finer.height_m.shape, np.float32),
        grain=np.stack([grain, grain], axis=-1),
    )
    relief, _ = lunar_relief()
    rms_at_one_m = math.sqrt(relief.at_one_m) * math.exp(rougher[0])
    deciding = (step_m / (OBSTACLE_SIGMAS * rms_at_one_m)) ** (1.0 / relief.hurst)
    told = Unresolved(terrain.spacing_m, NORMAL_MAD * float(np.median(np.abs(grain))), deciding)
    return dataclasses.replace(finer, errors=errors), told


def unresolved_grain(
    factor: int, spacing_m: float, seed: int, rougher: tuple[float, float], footprint_m: float = 0.0
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Fractal ground less the cubic spline through every so many nodes of it, on a torus. (512, 512) [m]

    It is as much `rougher` than the law, in the logarithm, as that mean and standard deviation say, alike over 10 m.
    What a wheel meets of it is the mean over a square of its width, `footprint_m`.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates

    random = np.random.default_rng([seed, 31])
    relief, _ = lunar_relief()
    shape = (GRAIN_NODES, GRAIN_NODES)
    waves = np.fft.fft2(random.standard_normal(shape)) * np.sqrt(fractal_power(shape, spacing_m, relief))
    ground = np.fft.ifft2(waves).real
    kind = gaussian_filter(random.standard_normal(shape), min(ALIKE_M / spacing_m, GRAIN_NODES / 8), mode="wrap")
    nodes = np.mgrid[:GRAIN_NODES, :GRAIN_NODES] / factor
    shown = map_coordinates(ground[::factor, ::factor], nodes, order=3, mode="grid-wrap")
    size = np.exp(rougher[0] + rougher[1] * (kind - kind.mean()) / kind.std())
    met = np.fft.ifft2(np.fft.fft2(size * (ground - shown)) * mean_over(footprint_m, spacing_m, shape)).real
    return np.asarray(met, dtype=np.float32)


def roughness_of_map(terrain: Terrain) -> tuple[float, float]:
    """How much rougher than the law the ground is, by the map's second differences: mean and sd of the logarithm.

    Those of fractal ground over a distance l have the variance c l^(2 H) (4 - 2^(2 H)). Their median counts, so that
    craters and rocks do not stand for the ground. Beforehand it is as rough as the law says, give or take the two kinds
    and what differs within them.
    """
    relief, apart = lunar_relief()
    away = np.linspace(-5.0, 5.0, 1001)
    density = -0.5 * away**2 / (apart**2 + WITHIN_KIND**2)
    found = [size for lag in LAGS if (size := _second_differences(terrain, lag, relief)) > 0]
    if found:
        off = (away - float(np.mean(np.log(found)))) / OF_A_MAP
        density -= 0.5 * (DEGREES + 1.0) * np.log1p(off**2 / DEGREES)
    weight = np.exp(density - density.max())
    mean = float(weight @ away / weight.sum())
    return mean, math.sqrt(float(weight @ (away - mean) ** 2 / weight.sum()))


def _second_differences(terrain: Terrain, lag: int, relief: Relief) -> float:
    """Their size in that of the law; 0 where there are too few, or where the map is level."""
    height, found = terrain.height_m, []
    for one in (height, height.T):
        if len(one) > 2 * lag:
            bent = one[2 * lag :] - 2.0 * one[lag:-lag] + one[: -2 * lag]
            found.append(bent[np.isfinite(bent)])
    together = np.concatenate(found) if found else np.empty(0)
    if together.size < 10:
        return 0.0
    law = relief.at_one_m * (lag * terrain.spacing_m) ** (2.0 * relief.hurst) * (4.0 - 2.0 ** (2.0 * relief.hurst))
    return NORMAL_MAD * float(np.median(np.abs(together))) / math.sqrt(law)


def _about(terrain: Terrain, places_m: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of the nodes about a plan, at least four of each where there are so many."""
    length = float(np.hypot(*np.diff(places_m, axis=0).T).sum())
    reach = MARGIN_M + MARGIN_SHARE * length + 2.0 * terrain.spacing_m
    parts = []
    for axis, places in ((terrain.y_m, places_m[:, 1]), (terrain.x_m, places_m[:, 0])):
        first, last = np.searchsorted(axis, (places.min() - reach, places.max() + reach))
        parts.append(slice(max(0, min(int(first), len(axis) - 4)), min(len(axis), max(int(last), 4))))
    return parts[0], parts[1]


def _finer(terrain: Terrain, rows: slice, columns: slice, factor: int) -> Terrain:
    """The same surface on nodes a `factor` closer, between some rows and columns."""
    from scipy.interpolate import RegularGridInterpolator

    x, y = terrain.x_m[columns], terrain.y_m[rows]
    spacing = terrain.spacing_m / factor
    finer_x, finer_y = (axis[0] + spacing * np.arange(factor * (len(axis) - 1) + 1) for axis in (x, y))
    soil = terrain.soil
    if soil.shape[0] > 1:
        places = np.stack(np.meshgrid(finer_y, finer_x, indexing="ij"), axis=-1)
        laid = RegularGridInterpolator((y, x), soil[rows, columns], bounds_error=False, fill_value=None)
        soil = laid(places)
    return dataclasses.replace(
        terrain,
        x0_m=float(x[0]),
        y0_m=float(y[0]),
        spacing_m=spacing,
        height_m=terrain.height_at(finer_x[None, :], finer_y[:, None]),
        soil=soil,
        ground=terrain.written,
    )
