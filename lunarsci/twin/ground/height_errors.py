"""What is not known of the heights of an elevation model, and grounds that agree with it.

The ground is taken as a Gaussian process whose differences over a distance l have the variance c l^(2 H), as those of
fractal ground do (Turcotte 1997, 10.1017/CBO9781139174695, ch. 7); c and H are those of the model's own heights, less
what its random errors add. Random errors hang together over the width of the matching window. Then the ground that is
likely is the model filtered by P / (P + E), with the power spectra P of the ground and E of the errors (Wiener 1949),
and what is left open has the spectrum P E / (P + E): errors at long waves, where the model knows the ground well, and
the ground itself at short ones, where it does not (Rasmussen & Williams 2006, ch. 2, eq. 2.25-2.26, on a torus).

A wheel meets the mean of the ground below it, not every grain: likely grounds and what is left open are means over its
width. As errors grow with distance all this is done for some sizes of them, and blended from node to node. Errors that
nodes share are a height and two tilts of the size that the model states.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError

GRAIN_NODES = 512
"""Side of the square of grain, a power of two; beyond it the same grain begins anew."""
RATIO, MOST_GRAINS = 1.5, 8
"""Between sizes of errors for which grounds are made, and how many there are at most."""
WINDOW_SIGMA = 0.425
"""Standard deviation of the Gaussian whose half width is that of the correlation of means over windows, in windows."""
WHITE_SHARE = 0.05
"""Of the variance of random errors that is each node's own; assumed."""
HURST = (0.3, 0.95)
"""Range of the exponent H; real ground has 0.5 to 0.9 (Turcotte 1997)."""
LONGEST_LAG_M = 1.0
"""Over which differences of heights are looked at; longer ones are craters. Assumed. [m]"""
SAMPLED = 200_000
"""Pairs of nodes that are looked at for each distance."""
FILLED_M = 0.5 * LONGEST_LAG_M
"""Nodes without a height get one as far as this from those that have: over a gap of twice that the relief is known;
assumed. [m]"""
ALIKE_M = 0.1
"""Width over which sizes of errors are averaged, so that the ground does not change its kind from node to node;
assumed. [m]"""
FLAT_M2 = 1e-12
"""Squared differences of heights below this are taken for it: a micrometre. [m2]"""
MARGIN = 64
"""Nodes about the model that its filter sees, mirrored."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightErrors:
    """What is not known of the heights of a terrain.

    Attributes
    ----------
    common : errors that nodes share, by independent modes of one standard deviation each. (ny, nx, modes) [m]
    level : which grain a node has; 2.3 is 0.7 of grain 2 and 0.3 of grain 3. (ny, nx)
    grain : fields without a place, from the smallest error to the largest; then those of filled gaps, from the smallest
        error to the largest. (512, 512, grains) [m]
    filled : nodes in gaps of the model, whose height is that of the ground about them. (ny, nx)

    A drawn ground is the terrain's heights, the modes times standard normal numbers, and grain from an offset.
    """

    common: npt.NDArray[np.float32]
    level: npt.NDArray[np.float32]
    grain: npt.NDArray[np.float32]
    filled: BoolArray = field(default_factory=lambda: np.zeros((1, 1), dtype=bool))

    def draws(self, members: int, seed: int) -> FloatArray:
        """What the ground of each member is drawn by: numbers of the modes, and two offsets. (members, modes + 2)"""
        random = np.random.default_rng([seed, 23])
        modes = random.standard_normal((members, self.common.shape[2]))
        return np.hstack([modes, random.integers(GRAIN_NODES, size=(members, 2)).astype(float)])


EXACT = HeightErrors(
    common=np.zeros((1, 1, 0), np.float32), level=np.zeros((1, 1), np.float32), grain=np.zeros((1, 1, 0), np.float32)
)
"""None: heights are taken as they are."""


class Relief(NamedTuple):
    """Variance c l^(2 H) of the difference of two heights a distance l apart.

    Attributes
    ----------
    at_one_m : c, that of heights a metre apart. [m2]
    hurst : the exponent H. [-]
    """

    at_one_m: float
    hurst: float


def likely_ground(
    height_m: FloatArray,
    spacing_m: float,
    random_m: FloatArray,
    window_m: FloatArray,
    common_m: FloatArray,
    footprint_m: float = 0.0,
    seed: int = 0,
) -> tuple[FloatArray, HeightErrors]:
    """The mean of all grounds that agree with an elevation model, and what each of them adds to it.

    Parameters
    ----------
    height_m : heights, NaN where unknown. (ny, nx) [m]
    spacing_m : of the nodes. [m]
    random_m, common_m : standard deviations of the heights' errors: those of each node, and shared ones. (ny, nx) [m]
    window_m : width over which random errors hang together, 0 for none. (ny, nx) [m]
    footprint_m : width over which the ground is averaged, that of a wheel; 0 for heights of points. [m]
    seed : of the grain.

    Errors that are unknown at a node are those of the next one where they are known. Nodes without a height get one as
    far as 0.5 m from those that have (`_filled`); others stay holes.
    Raises ParameterError where nothing is known of the random errors, all are 0, or hardly any heights are known.
    """
    from scipy.ndimage import gaussian_filter

    finite = np.isfinite(height_m)
    if not (random_m[finite] > 0).any():
        raise ParameterError("the model states no random error above 0 m")
    sigma, window = (_everywhere(values, finite & (random_m > 0)) for values in (random_m, window_m))
    relief = relief_of(height_m, spacing_m, sigma, window)
    filled, gap_sigma = _filled(height_m, spacing_m, sigma, relief)
    sigma = np.exp(gaussian_filter(np.log(sigma), ALIKE_M / spacing_m))
    sizes = _sizes(sigma[finite])
    nearest = np.abs(np.log(sigma[finite])[:, None] - np.log(sizes)).argmin(axis=1)
    widths = [
        float(np.median(window[finite][nearest == k])) if (nearest == k).any() else 0.0 for k in range(len(sizes))
    ]
    level, in_gap = _level(sigma, sizes), np.isfinite(gap_sigma)
    padded = np.pad(_everywhere(filled, np.isfinite(filled)), MARGIN, mode="reflect", reflect_type="odd")
    middle = float(padded.mean())
    waves = mean_over(footprint_m, spacing_m, padded.shape) * np.fft.fft2(padded - middle)
    mean, grain = np.zeros(height_m.shape), []
    white = np.fft.fft2(np.random.default_rng([seed, 29]).standard_normal((GRAIN_NODES, GRAIN_NODES)))
    under_wheel = mean_over(footprint_m, spacing_m, white.shape)
    for k, (size, width) in enumerate(zip(sizes, widths, strict=True)):
        share = np.clip(1.0 - np.abs(level - k), 0.0, None)
        ground, error = _spectra(padded.shape, spacing_m, relief, size, width)
        mean += share * _of_waves(ground / (ground + error) * waves)
        ground, error = _spectra(white.shape, spacing_m, relief, size, width)
        grain.append(np.fft.ifft2(np.sqrt(ground * error / (ground + error)) * under_wheel * white).real)
    if in_gap.any():
        gap = _Gaps.of(
            gap_sigma, np.interp(level, range(len(sizes)), [one.std() for one in grain]), footprint_m / spacing_m
        )
        mean = np.where(gap.touched, _of_waves(waves), mean)
        level = np.where(gap.touched, len(sizes) + gap.level, level)
        grain += [
            np.fft.ifft2(np.sqrt(power) * white).real for power in _gap_power(gap.sizes, spacing_m, relief, under_wheel)
        ]
    common = _common_modes(_everywhere(np.nan_to_num(common_m), finite), finite)
    errors = HeightErrors(
        common=common,
        level=level.astype(np.float32),
        grain=np.stack(grain, axis=-1, dtype=np.float32),
        filled=in_gap,
    )
    return np.where(finite | in_gap, mean + middle, np.nan), errors


class _Gaps(NamedTuple):
    """Which nodes a mean over the footprint mixes with a gap, between which errors they are, and what these are. [m]"""

    touched: BoolArray
    level: FloatArray
    sizes: FloatArray

    @classmethod
    def of(cls, gap_sigma: FloatArray, left_open: FloatArray, nodes: float) -> "_Gaps":
        """Of the errors in gaps, NaN elsewhere, and of what is left open of ground that was seen. [m]"""
        from scipy.ndimage import maximum_filter, uniform_filter

        in_gap, width = np.isfinite(gap_sigma), max(1, round(nodes))
        touched = maximum_filter(in_gap, width)
        mixed = uniform_filter(np.where(in_gap, gap_sigma, left_open), width)
        sizes = _sizes(mixed[touched])
        return cls(touched, _level(mixed, sizes), sizes)


def _gap_power(sizes: FloatArray, spacing: float, relief: Relief, under_wheel: FloatArray) -> Iterator[FloatArray]:
    """Power, at each wave of the grain, of what heights in gaps are off by, for each size of that.

    What the plane through the ground about a gap is off by is smooth, alike over half of `FILLED_M` (measured: over
    0.25 to 0.32 m on four scenes of `tests/benchmarks/scenes.py`); shorter waves are those of the relief, as far as the
    size allows. [m2]
    """
    smooth = np.exp(-2.0 * (math.pi * 0.5 * FILLED_M * _waves(under_wheel.shape, spacing)) ** 2)
    rough = fractal_power(under_wheel.shape, spacing, relief) * (1.0 - smooth) * under_wheel**2
    smooth *= under_wheel**2 / (smooth * under_wheel**2).mean()
    for size in sizes:
        share = min(size**2 / rough.mean(), 1.0)
        yield share * rough + max(size**2 - share * rough.mean(), 0.0) * smooth


def _filled(height: FloatArray, spacing: float, sigma: FloatArray, relief: Relief) -> tuple[FloatArray, FloatArray]:
    """Heights with narrow gaps filled, and the errors of what was filled, NaN elsewhere. [m]

    A height in a gap is that of the plane through those up to twice as far as the nearest one, weighted by the inverse
    squares of their distances (Shepard 1968, 10.1145/800186.810616). Its variance is that of the same heights about the
    plane, plus the relief over the distance of the nearest one and the random error: a gap behind a rock is as
    uncertain as the rock is high.
    """
    finite = np.isfinite(height)
    away = _away(finite) * spacing
    middle = float(height[finite].mean())
    layers = [finite.astype(float), np.where(finite, height - middle, 0.0)]
    filled, error = height.copy(), np.full(height.shape, np.nan)
    nearer, scales = 0.0, spacing * RATIO ** np.arange(math.ceil(math.log(FILLED_M / spacing, RATIO)) + 1)
    for scale in np.minimum(scales, FILLED_M):
        gap = (away > nearer) & (away <= scale)
        nearer = scale
        if gap.any():
            level, square = _plane_about(layers, gap, math.ceil(2.0 * scale / spacing) + 1, spacing, relief)
            filled[gap] = level + middle
            error[gap] = np.sqrt(square + relief.at_one_m * away[gap] ** (2.0 * relief.hurst) + sigma[gap] ** 2)
    return filled, error


def _plane_about(
    layers: Sequence[FloatArray], gap: BoolArray, reach: int, spacing: float, relief: Relief
) -> tuple[FloatArray, FloatArray]:
    """Heights at nodes of planes through what is known up to `reach` nodes away, and mean squares about them. [m], [m2]

    `layers` are 1 where a height is known, else 0, and that height, else 0. The prior of the planes' slopes is that of
    the relief over the reach. The ring of known heights has three times the area of the gap, and counts as three.
    """
    from scipy.signal import oaconvolve

    y, x = spacing * np.mgrid[reach : -reach - 1 : -1, reach : -reach - 1 : -1]
    squared = np.maximum((x * x + y * y) / spacing**2, 1.0)
    kernel = np.where(squared <= reach**2, 1.0 / squared, 0.0)
    one, height = layers

    def mean(layer: FloatArray, by: FloatArray | float = 1.0) -> FloatArray:
        return np.asarray(oaconvolve(layer, kernel * by, mode="same")[gap])

    weight = mean(one)
    sums = [mean(one, x), mean(one, y), mean(one, x * x), mean(one, x * y), mean(one, y * y)]
    by_x, by_y, xx, xy, yy = (each / weight for each in sums)
    right = np.stack([mean(height), mean(height, x), mean(height, y)], axis=-1) / weight[:, None]
    level = np.maximum(mean(height * height) / weight - right[:, 0] ** 2, 0.0)
    ridge = (level + FLAT_M2) / 3.0 / (relief.at_one_m * (reach * spacing) ** (2.0 * relief.hurst - 2.0))
    ones = np.ones_like(weight)
    normal = np.stack([ones, by_x, by_y, by_x, xx + ridge, xy, by_y, xy, yy + ridge], axis=-1).reshape(-1, 3, 3)
    plane = np.linalg.solve(normal, right[..., None])[..., 0]
    # With the ridge's own part taken back these are the squares about the plane.
    square = level + right[:, 0] ** 2 - (plane * right).sum(axis=-1) - ridge * (plane[:, 1:] ** 2).sum(axis=-1)
    return plane[:, 0], np.maximum(square, 0.0)


def _level(sigma: FloatArray, sizes: FloatArray) -> FloatArray:
    """Between which of the sizes errors are, 0 for the first."""
    level = np.interp(np.log(sigma), np.log(sizes), np.arange(len(sizes)))
    return np.asarray(np.minimum(level, len(sizes) - 1 - 1e-4))


def _of_waves(waves: npt.NDArray[np.complex128]) -> FloatArray:
    """What has these waves, without its margin."""
    return np.asarray(np.fft.ifft2(waves).real[MARGIN:-MARGIN, MARGIN:-MARGIN])


def relief_of(height_m: FloatArray, spacing_m: float, sigma_m: FloatArray, window_m: FloatArray) -> Relief:
    """How rough the ground is, from differences of heights less what random errors add to them.

    Of squares their median counts, so that rocks do not stand for the ground, over the half of the nodes with the
    smaller errors. Arguments as in `likely_ground`, errors known everywhere.
    """
    finite = np.isfinite(height_m)
    good = finite & (sigma_m <= np.median(sigma_m[finite]))
    level = np.where(good, height_m - _plane(height_m, good), np.nan)
    size, width = float(np.sqrt(np.mean(sigma_m[good] ** 2))), float(np.median(window_m[good]))
    longest = min(LONGEST_LAG_M / spacing_m, 0.25 * max(height_m.shape))
    lags = np.unique(np.rint(np.geomspace(1, max(longest, 2.0), 12)).astype(int))
    squares = np.maximum([_median_square(level, lag) for lag in lags], FLAT_M2)
    away = lags * spacing_m
    left = squares - 2.0 * size**2 * (1.0 - _alike(away, width))
    # Where errors are most of a difference it tells nothing of the ground.
    informative = left > 0.5 * squares
    if informative.sum() < 3:
        informative = (squares > 0) & (lags >= lags[-1] / 2)
        left = np.maximum(left, 0.1 * squares)
    if not informative.any():
        raise ParameterError("too few known heights side by side to tell how rough the ground is")
    slope = (
        np.polyfit(np.log(away[informative]), np.log(left[informative]), 1)[0]
        if informative.sum() > 1
        else 2.0 * np.mean(HURST)
    )
    hurst = float(np.clip(0.5 * slope, *HURST))
    return Relief(float(np.exp(np.mean(np.log(left[informative]) - 2.0 * hurst * np.log(away[informative])))), hurst)


def _plane(height: FloatArray, good: BoolArray) -> FloatArray:
    y, x = np.indices(height.shape, dtype=float)
    columns = np.column_stack([np.ones(int(good.sum())), x[good], y[good]])
    a, b, c = np.linalg.lstsq(columns, height[good], rcond=None)[0]
    return np.asarray(a + b * x + c * y)


def _median_square(height: FloatArray, lag: int) -> float:
    """Median of the squared differences along x and y, as a variance of a normal law; NaN without pairs. [m2]"""
    apart = [height[:, lag:] - height[:, :-lag], height[lag:] - height[:-lag]]
    differences = np.concatenate([d[np.isfinite(d)] for d in apart])
    differences = differences[:: max(1, differences.size // SAMPLED)]
    return float(np.median(differences**2)) / 0.4549 if differences.size > 10 else math.nan


def _alike(away_m: FloatArray, width_m: float) -> FloatArray:
    """Correlation of the random errors of two nodes. [-]"""
    near = WINDOW_SIGMA * width_m
    smooth = np.exp(-0.5 * (away_m / near) ** 2) if near > 0 else np.zeros_like(away_m)
    return np.asarray((1.0 - WHITE_SHARE) * smooth)


def _sizes(sigma: FloatArray) -> FloatArray:
    """Sizes of errors for which grounds are made, two or more, ascending. [m]"""
    low, high = np.quantile(sigma, (0.01, 0.995))
    high = max(high, 1.01 * low)
    count = min(MOST_GRAINS, 2 + int(math.log(high / low) / math.log(RATIO)))
    return np.geomspace(low, high, count)


def _spectra(
    shape: tuple[int, ...], spacing: float, relief: Relief, size: float, width: float
) -> tuple[FloatArray, FloatArray]:
    """Power of the ground and of the errors at each wave of a torus; their means over the waves are variances. [m2]"""
    k = _waves(shape, spacing)
    ground = fractal_power(shape, spacing, relief)
    near = WINDOW_SIGMA * width
    smooth = np.exp(-2.0 * (math.pi * near * k) ** 2)
    white = 1.0 if near < 0.5 * spacing else WHITE_SHARE
    error = size**2 * (white + (1.0 - white) * smooth / smooth.mean())
    return ground, error


def _waves(shape: tuple[int, ...], spacing: float) -> FloatArray:
    """Waves of a torus. [1/m]"""
    return np.asarray(np.hypot(np.fft.fftfreq(shape[0], spacing)[:, None], np.fft.fftfreq(shape[1], spacing)))


def fractal_power(shape: tuple[int, ...], spacing: float, relief: Relief) -> FloatArray:
    """Power of ground of this relief at each wave of a torus; its mean over the waves is the variance. [m2]"""
    shortest = 1.0 / (spacing * max(shape))
    waves = np.maximum(_waves(shape, spacing), 0.5 * shortest)
    return np.asarray(waves ** (-2.0 * relief.hurst - 2.0) * _power(relief, spacing))


def _power(relief: Relief, spacing: float) -> float:
    """Factor of k^(-2 H - 2) that gives the stated differences: c = 2 A' times an integral, in closed form.

    With A k^-(2H+2) as density over the plane of waves, 2 * int A k^-(2H+2) (1 - J0(2 pi k l)) d2k = c l^2H, and the
    integral is 2 pi (2 pi)^(2H) Gamma(1 - H) / (2^(2H+1) H Gamma(1 + H)). [m2]
    """
    h = relief.hurst
    integral = (2 * math.pi) ** (2 * h + 1) * math.gamma(1 - h) / (2 ** (2 * h + 1) * h * math.gamma(1 + h))
    return float(relief.at_one_m / (2.0 * integral) / spacing**2)


def mean_over(width: float, spacing: float, shape: tuple[int, ...]) -> FloatArray:
    """What a mean over a square of this width leaves of each wave of a torus. [-]"""
    along, across = (np.sinc(width * np.fft.fftfreq(n, spacing)) for n in shape)
    return np.asarray(along[:, None] * across)


def _everywhere(values: FloatArray, finite: BoolArray) -> FloatArray:
    """Values, and where they are not known that of the next node where they are."""
    from scipy.ndimage import distance_transform_edt

    if finite.all():
        return values
    nearest = distance_transform_edt(~finite, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])


def _away(finite: BoolArray) -> FloatArray:
    """Distance of nodes from the next known one, in nodes; 0 for these."""
    from scipy.ndimage import distance_transform_edt

    return np.zeros(finite.shape) if finite.all() else np.asarray(distance_transform_edt(~finite))


def _common_modes(size: FloatArray, finite: BoolArray) -> npt.NDArray[np.float32]:
    """A height and two tilts across the known ground, of the stated size at every node. (ny, nx, 3) [m]"""
    rows, columns = np.indices(size.shape, dtype=float)
    half = 0.5 * max(np.ptp(rows[finite]), np.ptp(columns[finite]), 1.0)
    ones = np.ones(size.shape)
    modes = np.stack([ones, (columns - columns[finite].mean()) / half, (rows - rows[finite].mean()) / half], axis=-1)
    return np.asarray(size[..., None] * modes / np.linalg.norm(modes, axis=-1, keepdims=True), dtype=np.float32)
