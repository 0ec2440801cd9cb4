"""Centre, depth, area and asymmetry of one absorption band in many spectra on the same channels, with standard errors.

The centre is the minimum of a fourth-order polynomial through the deepest part of the band, of two: a wide one, which
scatters little and is biased where the band is lopsided, and a narrow one, which is neither. They are joined with the
weights of least variance, the bias of the wide one as part of its variance: so the window widens with the noise of the
channels, not with what this noise happened to be, and its bias is in the error. Channels count by a weight that rises
smoothly with the depth of the smoothed band, so that everything from the reflectance to the result has derivatives, the
choice of the window included, and the noise of each channel is carried through to first order, smoothing and continuum
included. Only that the tie points of the continuum are chosen on noisy data is not in the errors. Errors assume noise
independent between channels.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.spectra.continuum import Continuum, Indices


@dataclass(frozen=True, slots=True)
class Band:
    """Where an absorption band lies.

    Attributes
    ----------
    window_nm, centre_nm, reach_nm : its window, where its centre may lie, what a spectrum must reach. [nm]
    others : what else absorbs nearby.
    bias : standard deviation of the bias of a minimum in the wide window, in half widths of that. [-]
    """

    key: str
    window_nm: tuple[float, float]
    centre_nm: tuple[float, float]
    reach_nm: tuple[float, float]
    others: str
    bias: float


BANDS = (
    Band(
        "1000", (700.0, 1580.0), (870.0, 1200.0), (850.0, 1200.0),
        "iron oxides have theirs below 870, feldspar at 1250, water at 1400 nm", 0.02,
    ),
    Band("2000", (1580.0, 2500.0), (1700.0, 2400.0), (1750.0, 2150.0), "hydroxyl has its beyond 2200 nm", 0.04),
)  # fmt: skip
"""The windows meet at the 1580 nm tie of the paper's continuum. Centres are those that mafic silicates have, with a
margin: pyroxenes 900-1060 and 1800-2380 nm (Adams 1974, 10.1029/JB079i032p04829; Cloutis & Gaffey 1991,
10.1029/91JE02512, whose type A has a second minimum near 1150 nm), olivines 1040-1090 nm (King & Ridley 1987,
10.1029/JB092iB11p11457). Water and hydroxyl absorb at 1400 nm (Hunt 1977, 10.1190/1.1440721), feldspar at 1250 nm
(Adams & Goullaud 1978, Proc. Lunar Planet. Sci. Conf. 9, 2901). Biases are those measured on every second of 409
laboratory spectra of minerals, mixtures and meteorites: 68 and 90 % of the minima are off by less than 0.016 and 0.038
at 1 um, 0.037 and 0.069 at 2 um.
"""

ORDER = 4
WIDE, NARROW = (0.6, 0.9), (0.85, 1.0)
"""Channels less deep than the first share of the band do not count, those deeper than the second count fully; assumed.
Polynomials through about the deepest third are usual for asteroids: Moskovitz et al. (2010), Icarus 208, 773,
10.1016/j.icarus.2010.03.002."""
FEWEST_CHANNELS = 8
"""Where fewer are in the wide window, shares half as large are used, and the narrow one not at all: coarse channels."""
SEARCH = np.linspace(-1.0, 1.0, 161)
NEWTON_STEPS = 6
LEAST_DEPTH = 1e-6
_POWERS = np.arange(ORDER + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Removed:
    """m spectra on n channels without their continua.

    Attributes
    ----------
    wavelength_nm : shape (n,). [nm]
    noise : one standard deviation of each reflectance, (m, n). [-]
    smoothing : the operator that smooths, transposed, a sparse array (n, n). [-]
    tied : the continua.
    level : the continua, above 0, (m, n). [-]
    ratio, smoothed : reflectance, as measured and smoothed, over the continuum, (m, n). [-]
    """

    wavelength_nm: FloatArray
    noise: FloatArray
    smoothing: Any
    tied: Continuum
    level: FloatArray
    ratio: FloatArray
    smoothed: FloatArray

    def of(self, rows: Indices) -> "Removed":
        """Some of the spectra."""
        parts = (self.level[rows], self.ratio[rows], self.smoothed[rows])
        return Removed(self.wavelength_nm, self.noise[rows], self.smoothing, self.tied.of(rows), *parts)

    def per_channel(self, of_ratio: FloatArray, of_smoothed: FloatArray) -> FloatArray:
        """Derivatives to both ratios, (m, n) each, into derivatives to the reflectance."""
        onto_level = -(of_ratio * self.ratio + of_smoothed * self.smoothed) / self.level
        onto_smoothed = of_smoothed / self.level + self.tied.carried(onto_level)
        return np.asarray(of_ratio / self.level + (self.smoothing @ onto_smoothed.T).T)

    def sigma(self, slopes: FloatArray) -> FloatArray:
        """Standard errors (m,) of quantities with these derivatives to each reflectance, (m, n)."""
        return np.asarray(np.sqrt(np.sum((slopes * self.noise) ** 2, axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """The channels that a centre is found from.

    Attributes
    ----------
    weight, weight_slope : of each channel, 0 to 1, and its derivative to the share of the depth, (m, n). [-]
    share : depth of the smoothed band over the deepest, (m, n). [-]
    deepest : its channel, (m,).
    deepest_depth : its depth, (m,). [-]
    x : wavelength from -1 to 1 over the window, 0 outside, (m, n). middle_nm, half_nm : its scale, (m,). [-, nm]
    inner : whether the deepest channel lies within the range it is looked for in, and not at its edge, (m,).
    """

    weight: FloatArray
    weight_slope: FloatArray
    share: FloatArray
    deepest: Indices
    deepest_depth: FloatArray
    x: FloatArray
    middle_nm: FloatArray
    half_nm: FloatArray
    inner: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """One band of m spectra; each array is (m,), and meaningless where `found` is False.

    Attributes
    ----------
    found : whether the polynomial has a minimum. inner : see `_Window`.
    center_nm, depth, area_nm, asymmetry : see `lunarsci.spectra.bands.BandResult`; with `_sigma` their standard errors.
    slopes : by name of those four, their derivatives to each reflectance, (m, n).
    """

    found: BoolArray
    inner: BoolArray
    center_nm: FloatArray
    center_sigma_nm: FloatArray
    depth: FloatArray
    depth_sigma: FloatArray
    area_nm: FloatArray
    area_sigma_nm: FloatArray
    asymmetry: FloatArray
    asymmetry_sigma: FloatArray
    slopes: dict[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class _Polynomial:
    """The weighted least-squares polynomials: coefficients (m, 5), inverse normal matrices (m, 5, 5), residuals."""

    window: _Window
    coefficients: FloatArray
    inverse: FloatArray
    residual: FloatArray

    def value(self, x: FloatArray) -> FloatArray:
        return np.asarray(np.sum(_powers(x) * self.coefficients, axis=1))

    def slopes(self, of_coefficients: FloatArray, removed: Removed) -> FloatArray:
        """Derivatives to each reflectance (m, n) of a quantity with these to the coefficients, (m, 5)."""
        w = self.window
        along = _horner((self.inverse @ of_coefficients[..., None])[..., 0], w.x)
        of_share = along * self.residual * w.weight_slope / w.deepest_depth[:, None]
        of_smoothed = -of_share
        of_smoothed[np.arange(w.deepest.size), w.deepest] += np.sum(of_share * w.share, axis=1)
        return removed.per_channel(along * w.weight, of_smoothed)


def centres(removed: Removed, inside: BoolArray, allowed: BoolArray) -> FloatArray:
    """Centres (m,) of the wide window, without errors; NaN where there is none. [nm]"""
    fit = _fitted(removed, _window(removed, inside, allowed, WIDE))
    lowest, _ = _minima(fit)
    return np.where(fit.window.inner, _nm(fit, lowest), np.nan)


def shapes(removed: Removed, inside: BoolArray, allowed: BoolArray, bias: float) -> Shapes:
    """Measure a band.

    Parameters
    ----------
    removed : the spectra without continuum.
    inside, allowed : channels (n,) of the band, and those in which its deepest may lie.
    bias : see `Band`.
    """
    wide, narrow = (_minimum(removed, _window(removed, inside, allowed, shares), bias) for shares in (WIDE, NARROW))
    share = _share_of_wide(wide, narrow, removed)
    part = share[:, None]
    center, depth = (share * a + (1 - share) * b for a, b in ((wide.nm, narrow.nm), (wide.depth, narrow.depth)))
    of_center, of_depth = (
        part * a + (1 - part) * b for a, b in ((wide.of_nm, narrow.of_nm), (wide.of_depth, narrow.of_depth))
    )
    area, asymmetry, of_area, of_asymmetry = _areas(removed, inside, center, 2 * depth[:, None] * of_center)
    unsaid = share**2 * (wide.rival + wide.bias**2) + (1 - share) ** 2 * narrow.rival
    return Shapes(
        wide.found, wide.inner, center, np.sqrt(removed.sigma(of_center) ** 2 + unsaid), depth, removed.sigma(of_depth),
        area, removed.sigma(of_area), asymmetry,
        np.hypot(removed.sigma(of_asymmetry), 2 * depth / np.where(area == 0, np.inf, area) * np.sqrt(unsaid)),
        {"center": of_center, "depth": of_depth, "area": of_area, "asymmetry": of_asymmetry},
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Minimum:
    """Minima in one window: wavelength [nm], depth [-], their derivatives to each reflectance (m, n), variances [nm2].

    `rival` is the variance that is not of first order: that a second minimum may be the lower one, and that the
    curvature is uncertain, three times the square of its relative error; `bias` is that of the window. [nm2, nm]
    """

    found: BoolArray
    inner: BoolArray
    nm: FloatArray
    depth: FloatArray
    of_nm: FloatArray
    of_depth: FloatArray
    rival: FloatArray
    bias: FloatArray


def _minimum(removed: Removed, window: _Window, bias: float) -> _Minimum:
    fit = _fitted(removed, window)
    lowest, second = _minima(fit)
    found = np.isfinite(lowest)
    x = np.where(found, lowest, 0.0)
    curvature = np.where(found, np.sum(_powers(x, 2) * fit.coefficients, axis=1), 1.0)
    of_nm = fit.slopes(_powers(x, 1) * (-window.half_nm / curvature)[:, None], removed)
    of_depth = fit.slopes(-_powers(x), removed)
    flat = removed.sigma(fit.slopes(_powers(x, 2), removed)) / np.maximum(curvature, np.finfo(float).tiny)
    unsaid = _rival_variance(fit, removed, x, second) + 3 * flat**2 * removed.sigma(of_nm) ** 2
    return _Minimum(found, window.inner, _nm(fit, x), 1 - fit.value(x), of_nm, of_depth, unsaid, bias * window.half_nm)


def _share_of_wide(wide: _Minimum, narrow: _Minimum, removed: Removed) -> FloatArray:
    """Weight of the wide window's minimum for the least variance of both together, 0 to 1."""
    variances = (
        removed.sigma(wide.of_nm) ** 2 + wide.rival + wide.bias**2,
        removed.sigma(narrow.of_nm) ** 2 + narrow.rival,
    )
    common = np.sum(wide.of_nm * narrow.of_nm * removed.noise**2, axis=1)
    share = (variances[1] - common) / np.maximum(variances[0] + variances[1] - 2 * common, np.finfo(float).tiny)
    return np.where(narrow.found & narrow.inner, np.clip(share, 0.0, 1.0), 1.0)


def gaussian_centres(removed: Removed, inside: BoolArray, allowed: BoolArray) -> FloatArray:
    """Centres (m,) of Gaussians through the deeper half of the smoothed bands; NaN where there is none. [nm]

    A parabola through ln depth, weighted with the depth squared: Guo (2011), 10.1109/MSP.2011.941846.
    """
    window = _window(removed, inside, allowed, (0.5, 0.5 + 1e-9))
    deep = np.where(window.weight > 0, np.maximum(1 - removed.smoothed, LEAST_DEPTH), 1.0)
    weight = np.where(window.weight > 0, deep**2, 0.0)
    basis = window.x[..., None] ** np.arange(3)
    weighted = np.swapaxes(basis * weight[..., None], 1, 2)
    fit = (np.linalg.pinv(weighted @ basis, hermitian=True) @ (weighted @ np.log(deep)[..., None]))[..., 0]
    peaked = fit[:, 2] < 0
    x = -fit[:, 1] / (2 * np.where(peaked, fit[:, 2], 1.0))
    return np.where(peaked & (np.abs(x) < 1), window.middle_nm + window.half_nm * x, np.nan)


def _window(removed: Removed, inside: BoolArray, allowed: BoolArray, shares: tuple[float, float]) -> _Window:
    """Weights of the channels that are connected with the deepest one and deep enough."""
    depth = 1 - removed.smoothed
    at = np.flatnonzero(allowed)
    deepest = at[np.argmax(depth[:, at], axis=1)]
    most = np.maximum(np.take_along_axis(depth, deepest[:, None], axis=1), LEAST_DEPTH)
    share = depth / most
    few = (_connected((share > shares[0]) & inside, deepest).sum(axis=1) < FEWEST_CHANNELS)[:, None]
    low, high = (np.where(few & (shares == WIDE), limit / 2, limit) for limit in shares)
    keep = _connected((share > low) & inside, deepest)
    t = np.clip((share - low) / (high - low), 0.0, 1.0) * keep
    first, last = np.argmax(keep, axis=1), keep.shape[1] - 1 - np.argmax(keep[:, ::-1], axis=1)
    ends = removed.wavelength_nm[first], removed.wavelength_nm[last]
    middle, half = (ends[0] + ends[1]) / 2, np.maximum((ends[1] - ends[0]) / 2, 1.0)
    return _Window(
        t**2 * (3 - 2 * t), 6 * t * (1 - t) / (high - low), share, deepest, most[:, 0],
        np.where(keep, (removed.wavelength_nm - middle[:, None]) / half[:, None], 0.0), middle, half,
        (deepest > at[0]) & (deepest < at[-1]) & (keep.sum(axis=1) >= FEWEST_CHANNELS),
    )  # fmt: skip


def _connected(chosen: BoolArray, at: Indices) -> BoolArray:
    """The run of chosen channels (m, n) around one channel a row, (m,)."""
    channel = np.arange(chosen.shape[1])
    before = np.max(np.where(~chosen & (channel < at[:, None]), channel, -1), axis=1)
    behind = np.min(np.where(~chosen & (channel > at[:, None]), channel, channel.size), axis=1)
    return np.asarray((channel > before[:, None]) & (channel < behind[:, None]))


def _fitted(removed: Removed, window: _Window) -> _Polynomial:
    columns = np.flatnonzero((window.weight > 0).any(axis=0))
    x, weight, ratio = (values[:, columns] for values in (window.x, window.weight, removed.ratio))
    basis = x[..., None] ** _POWERS
    weighted = np.swapaxes(basis * weight[..., None], 1, 2)
    inverse = np.linalg.pinv(weighted @ basis, hermitian=True)
    coefficients = (inverse @ (weighted @ ratio[..., None]))[..., 0]
    residual = np.where(window.weight > 0, removed.ratio - _horner(coefficients, window.x), 0.0)
    return _Polynomial(window, coefficients, np.asarray(inverse, float), residual)


def _horner(coefficients: FloatArray, x: FloatArray) -> FloatArray:
    """Polynomials (m, 5) at x (m, k)."""
    value = np.broadcast_to(coefficients[:, -1:], x.shape)
    for k in reversed(range(ORDER)):
        value = value * x + coefficients[:, k : k + 1]
    return np.asarray(value)


def _powers(x: FloatArray, derivative: int = 0) -> FloatArray:
    """Derivative of 1, x, …, x^4 at x (m,); shape (m, 5)."""
    factor = np.prod([np.maximum(_POWERS - k, 0) for k in range(derivative)], axis=0) * np.ones(ORDER + 1)
    return np.asarray(factor * x[:, None] ** np.maximum(_POWERS - derivative, 0))


def _minima(fit: _Polynomial) -> tuple[FloatArray, FloatArray]:
    """The lowest and the second lowest minimum within the window, -1 to 1; NaN where there is none."""
    values = _horner(fit.coefficients, np.broadcast_to(SEARCH, (fit.coefficients.shape[0], SEARCH.size)))
    inner = (values[:, 1:-1] < values[:, :-2]) & (values[:, 1:-1] <= values[:, 2:])
    candidates = np.where(inner, values[:, 1:-1], np.inf)
    order = np.argsort(candidates, axis=1, kind="stable")[:, :2]
    found = np.isfinite(np.take_along_axis(candidates, order, axis=1))
    x = np.where(found, SEARCH[1:-1][order], np.nan)
    return _polished(fit, x[:, 0]), _polished(fit, x[:, 1])


def _polished(fit: _Polynomial, start: FloatArray) -> FloatArray:
    """Newton's steps to the zero of the derivative, no farther than the next point of the search."""
    x, step = start, SEARCH[1] - SEARCH[0]
    for _ in range(NEWTON_STEPS):
        curvature = np.sum(_powers(x, 2) * fit.coefficients, axis=1)
        slope = np.sum(_powers(x, 1) * fit.coefficients, axis=1)
        x = np.clip(x - slope / np.where(curvature > 0, curvature, np.inf), start - step, start + step)
    return x


def _nm(fit: _Polynomial, x: FloatArray) -> FloatArray:
    return np.asarray(fit.window.middle_nm + fit.window.half_nm * x)


def _rival_variance(fit: _Polynomial, removed: Removed, x: FloatArray, second: FloatArray) -> FloatArray:
    """What it adds to the variance of the centre that the second minimum may truly be the lower one. [nm2]

    The probability of that, from the difference of their depths and its error, times the square of their distance.
    """
    from scipy.special import ndtr

    rows = np.flatnonzero(np.isfinite(second))
    variance = np.zeros(x.size)
    if rows.size:
        there = np.where(np.isfinite(second), second, x)
        rise = fit.value(there) - fit.value(x)
        sigma = np.maximum(removed.sigma(fit.slopes(_powers(there) - _powers(x), removed)), np.finfo(float).tiny)
        variance[rows] = (ndtr(-rise / sigma) * (_nm(fit, there) - _nm(fit, x)) ** 2)[rows]
    return variance


def _areas(removed: Removed, inside: BoolArray, center_nm: FloatArray, moved: FloatArray) -> tuple[Any, ...]:
    """Area and asymmetry, and the derivatives of both to each reflectance.

    `moved` is what a shift of the centre takes from the right and gives to the left, per reflectance, (m, n).
    """
    steps = np.where(inside, np.gradient(removed.wavelength_nm), 0.0)
    offset = (removed.wavelength_nm - center_nm[:, None]) / np.gradient(removed.wavelength_nm)
    side = np.clip(2 * offset, -1.0, 1.0)
    deep = 1 - removed.ratio
    area, excess = deep @ steps, np.sum(deep * steps * side, axis=1)
    nothing = np.zeros_like(deep)
    of_area = removed.per_channel(np.broadcast_to(-steps, deep.shape), nothing)
    of_excess = removed.per_channel(-steps * side, nothing) - moved
    whole = np.where(np.abs(area) > 0, area, np.inf)[:, None]
    return area, excess / whole[:, 0], of_area, (of_excess - (excess[:, None] / whole) * of_area) / whole
