"""One reflectance spectrum, its random noise, and Savitzky-Golay smoothing as a linear operator that carries it."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.noise import scatter_noise_rows

WIDEST_GAP_NM = 100.0
"""Channels farther apart than this may hide the bottom of a band of olivine or pyroxene, whose narrowest is
176 nm wide at half depth (OL M2 of `mgm_bands.csv`); assumed. [nm]"""
NARROW_NM = 60.0
"""Between channels no farther apart than this, a third of the width of OL M2, ln R is taken as straight; assumed.
[nm]"""


def channel_arrays(id: str, wavelength_nm: npt.ArrayLike, *values: npt.ArrayLike) -> list[FloatArray]:
    """Read-only copies of wavelengths (n,) and of values in these channels.

    Raises DataError unless wavelengths are finite, above 0 nm and strictly ascending, and all have their shape.
    """
    arrays = [np.array(one, dtype=float) for one in (wavelength_nm, *values)]
    wavelength = arrays[0]
    if wavelength.ndim != 1 or wavelength.size == 0 or any(one.shape != wavelength.shape for one in arrays):
        shapes = " and ".join(str(one.shape) for one in arrays)
        raise DataError(f"{id}: no channels, or numbers of shapes {shapes}; give one of each per channel")
    if not (np.isfinite(wavelength).all() and wavelength[0] > 0 and (np.diff(wavelength) > 0).all()):
        raise DataError(f"{id}: wavelengths are not finite, above 0 nm and strictly ascending; correct or sort them")
    for one in arrays:
        one.setflags(write=False)
    return arrays


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A reflectance spectrum on ascending wavelengths.

    Attributes
    ----------
    id : name of the spectrum, as a reader or its file gives it.
    wavelength_nm : shape (n,), finite, above 0, strictly ascending. [nm]
    reflectance : shape (n,), fraction of 1 (reflectance factor); NaN where there is no measurement. [-]
    uncertainty : shape (n,) one standard deviation, above 0 where reflectance is finite, or None if unknown. [-]
    mask : shape (n,), True where a channel must not be used; always True where reflectance is not finite or not above
        0. May be left out.
    metadata : whatever the file said about it (instrument, geometry, units found, notes of the reader).
    systematic : name of an error that all channels share to the shift of the reflectance by one standard deviation of
        it, shape (n,) each, signed, 0 where a channel must not be used; empty where none is known. [-]

    Raises
    ------
    DataError when a rule above is broken; the message begins with the id.
    """

    id: str
    wavelength_nm: FloatArray
    reflectance: FloatArray
    uncertainty: FloatArray | None = None
    mask: BoolArray | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    systematic: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given = (self.reflectance, *(() if self.uncertainty is None else (self.uncertainty,)))
        wavelength, reflectance, *sigma = channel_arrays(self.id, self.wavelength_nm, *given)
        unusable = ~np.isfinite(reflectance) | ~(reflectance > 0)
        if self.mask is not None:
            unusable |= np.array(self.mask, bool)
        if sigma and not (sigma[0][~unusable] > 0).all():
            raise DataError(f"{self.id}: an uncertainty is not above 0; leave the column out if errors are unknown")
        unusable.setflags(write=False)
        for name, value in (
            ("wavelength_nm", wavelength),
            ("reflectance", reflectance),
            ("uncertainty", sigma[0] if sigma else None),
            ("mask", unusable),
            ("systematic", self._checked_systematic(unusable)),
        ):
            object.__setattr__(self, name, value)

    def _checked_systematic(self, unusable: BoolArray) -> dict[str, FloatArray]:
        checked = {}
        for name, values in self.systematic.items():
            shift = np.array(values, dtype=float)
            if shift.shape != unusable.shape or not np.isfinite(shift[~unusable]).all():
                what = f"systematic '{name}' is not known in every usable channel"
                raise DataError(f"{self.id}: {what} ({shift.size} values for {unusable.size} channels); complete it")
            shift[unusable] = 0.0
            shift.setflags(write=False)
            checked[name] = shift
        return checked

    @property
    def usable(self) -> BoolArray:
        """True for the channels that may be used; shape (n,)."""
        return ~np.asarray(self.mask, dtype=bool)


def wide_gap(wavelength_nm: FloatArray, low_nm: float, high_nm: float) -> tuple[float, float] | None:
    """The widest part of a range without a channel, of ascending ones, that may hide a band; None for none. [nm]"""
    inside = wavelength_nm[(wavelength_nm > low_nm) & (wavelength_nm < high_nm)]
    first, last = np.searchsorted(wavelength_nm, low_nm, side="right") - 1, np.searchsorted(wavelength_nm, high_nm)
    begin = wavelength_nm[first] if first >= 0 else low_nm
    end = wavelength_nm[last] if last < wavelength_nm.size else high_nm
    channels = np.array([begin, *inside, end])
    widest = int(np.argmax(np.diff(channels)))
    gap = float(channels[widest]), float(channels[widest + 1])
    return gap if gap[1] - gap[0] > WIDEST_GAP_NM else None


def reaches_over(wavelength_nm: FloatArray, low_nm: float, high_nm: float) -> bool:
    """Whether channels, ascending, lie on both sides of a range, and nowhere in it too far apart. [nm]"""
    both = wavelength_nm.size and wavelength_nm[0] <= low_nm and wavelength_nm[-1] >= high_nm
    return bool(both) and wide_gap(wavelength_nm, low_nm, high_nm) is None


def channel_noise(spectrum: Spectrum) -> FloatArray:
    """One standard deviation of the reflectance per channel, shape (n,). [-]

    The spectrum's own uncertainty where it has one, else `scatter_noise`. Masked channels are NaN.
    """
    if spectrum.uncertainty is not None:
        return np.where(spectrum.usable, spectrum.uncertainty, np.nan)
    noise = np.full(spectrum.wavelength_nm.shape, np.nan)
    noise[spectrum.usable] = scatter_noise(spectrum.reflectance[spectrum.usable])
    return noise


def scatter_noise(values: FloatArray, window: int = 61) -> FloatArray:
    """Noise from second differences, robustly (median absolute deviation), in a running window of channels.

    Sees only what changes from channel to channel: smoothed data come out too quiet, and structure as narrow as two
    channels counts as noise. Shape (n,), above 0 unless the data are exactly straight. [unit of `values`]

    von Neumann, Kent, Bellinson & Hart (1941), Ann. Math. Stat. 12, 153, 10.1214/aoms/1177731746, in robust form.
    """
    noise: FloatArray = scatter_noise_rows(np.asarray(values, dtype=np.float64)[None], window)[0]
    return noise


def savitzky_golay_operator(wavelength_nm: FloatArray, points: int = 41, order: int = 3) -> FloatArray:
    """Matrix S, shape (n, n), whose product with a spectrum is the smoothed spectrum.

    Each row is the least-squares polynomial through the `points` nearest channels, evaluated at its channel. On equal
    steps this is the Savitzky-Golay filter (ends included); on unequal steps it is the same idea done correctly.

    Parameters
    ----------
    wavelength_nm : shape (n,), ascending. [nm]
    points : odd, above `order`; 0 or 1 means no smoothing. Longer than the spectrum: the longest that fits. [-]
    order : of the polynomial. The 41 points are those of Ding et al. (2024), who give no order; 3 is assumed. [-]

    Raises
    ------
    ParameterError for an even or too short window.

    References
    ----------
    Savitzky & Golay (1964), Anal. Chem. 36, 1627, 10.1021/ac60214a047.
    """
    size = wavelength_nm.size
    if points in (0, 1):
        return np.eye(size)
    if points < 0 or points % 2 == 0 or points <= order:
        raise ParameterError(f"smoothing over {points} points; give an odd number above {order}, or 0 for none")
    points = min(points, size if size % 2 else size - 1)
    if points <= order:
        return np.eye(size)
    first = np.clip(np.arange(size) - points // 2, 0, size - points)
    return _operator(wavelength_nm.tobytes(), tuple(first), tuple(first + points), order)


LARGEST_SMOOTH_NM = 300.0
"""Half of the width of the 1 um band of pyroxene between its shoulders, 700 and 1300 nm (Adams 1974); a wider window
flattens the band."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothing:
    """Savitzky-Golay window and order of its polynomial; it serves the continuum and the search for the minimum.

    `window_nm` is its width, 0 for none; `channels` the same in channels of the median step, instead.

    Raises ParameterError where it is impossible, or wider than half of a band.
    """

    window_nm: float = 205.0
    order: int = 3
    channels: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.window_nm <= LARGEST_SMOOTH_NM:
            raise ParameterError(_too_wide(f"{self.window_nm:g} nm"))
        odd = self.channels is None or self.channels in (0, 1) or self.channels % 2 == 1
        if not odd or (self.channels is not None and 1 < self.channels <= self.order) or (self.channels or 0) < 0:
            raise ParameterError(
                f"smoothing over {self.channels} channels; give an odd number above {self.order}, or 0 for none"
            )

    def width_nm(self, wavelength_nm: FloatArray) -> float:
        """Its width on these channels. Raises DataError where that is more than half of a band."""
        if self.channels is None or self.channels in (0, 1):
            return self.window_nm if self.channels is None else 0.0
        width = self.channels * float(np.median(np.diff(wavelength_nm)))
        if width > LARGEST_SMOOTH_NM:
            raise DataError(_too_wide(f"{self.channels} channels, here {width:.0f} nm,"))
        return width


def _too_wide(what: str) -> str:
    return (
        f"smoothing over {what} is wider than half of a band; give a window of 0 to {LARGEST_SMOOTH_NM:g} nm "
        "(`smooth_nm`, 205 where left out)"
    )


def smoothing_operator(wavelength_nm: FloatArray, window_nm: float = 205.0, order: int = 3) -> FloatArray:
    """The same, with a window that is so wide in wavelength, (n, n): what it smooths does not depend on the channels.

    A channel is as wide as the middles to its neighbours are apart; 205 nm are 41 channels of 5 nm. At the ends the
    window stays as wide and is no longer centred. With `order` + 1 channels or fewer in it a channel stays as it is.

    Parameters
    ----------
    wavelength_nm : shape (n,), ascending. [nm]
    window_nm : 0 for no smoothing. [nm]
    order : of the polynomial. [-]
    """
    if window_nm == 0 or wavelength_nm.size < 2:
        return np.eye(wavelength_nm.size)
    middles = (wavelength_nm[1:] + wavelength_nm[:-1]) / 2
    ends = 2 * wavelength_nm[[0, -1]] - middles[[0, -1]]
    start = np.clip(wavelength_nm - window_nm / 2, ends[0], max(ends[0], ends[1] - window_nm))
    slack = 1e-6 * window_nm
    first = np.searchsorted(wavelength_nm, start - slack)
    last = np.searchsorted(wavelength_nm, start + window_nm + slack, side="right")
    return _operator(wavelength_nm.tobytes(), tuple(first), tuple(last), order)


@functools.lru_cache(maxsize=8)
def _operator(wavelength: bytes, first: tuple[int, ...], last: tuple[int, ...], order: int) -> FloatArray:
    """The matrix for one set of channels and windows; a batch of spectra on the same channels shares it."""
    wavelength_nm = np.frombuffer(wavelength)
    operator = np.eye(wavelength_nm.size)
    for row, window in enumerate(map(slice, first, last)):
        if window.stop - window.start > order + 1:
            operator[row] = 0.0
            operator[row, window] = _weights(wavelength_nm[window], wavelength_nm[row], order)
    operator.setflags(write=False)
    return operator


def _weights(nodes: FloatArray, at: float, order: int) -> FloatArray:
    scale = np.ptp(nodes) / 2
    basis = np.vander((nodes - at) / scale, order + 1, increasing=True)
    weights: FloatArray = np.linalg.pinv(basis)[0]
    return weights
