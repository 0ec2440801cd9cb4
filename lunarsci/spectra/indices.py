"""Spectral indices of the Moon: reflectances at a few wavelengths, combined by a published formula.

A reflectance at a wavelength is interpolated between the channels beside it. Errors of an index are, to first order,
those of the channels carried through interpolation and formula (`sigma`), the shifts that all channels of a spectrum
share (`calibration`), and what a cubic through four channels changes against the line through two (`interpolation`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.collection import alike_channels
from lunarsci.spectra.noise import scatter_noise_rows
from lunarsci.spectra.spectrum import LARGEST_SMOOTH_NM, NARROW_NM, smoothing_operator

Evaluated: TypeAlias = tuple[FloatArray, FloatArray]
Formula: TypeAlias = Callable[[FloatArray], Evaluated]
"""Reflectances at the wavelengths of an index, (n, k), to its values (n,) and their derivatives (n, k)."""

SOILS = (0.03, 0.4)
"""Reflectance factors at 750 nm that soils of the Moon have, at 30, 0 and 30 deg, with room (assumed); what is beyond
is no such soil, or was scaled."""
STATUSES = ("ok", "beyond_range", "no_channels", "undefined")
"""What `status` counts: beyond what the index was calibrated or made for; a wavelength without channels; a formula
that has no value, such as an abundance where the ratio is above its origin."""
OK, BEYOND, NO_CHANNELS, UNDEFINED = range(4)
M3_LIST = "Mustard et al. (2011), J. Geophys. Res. 116, E00G12, 10.1029/2010JE003726"
LUCEY = "Lucey, Blewett & Jolliff (2000), J. Geophys. Res. 105, 20297, 10.1029/1999JE001117"


MEDIAN_OF_NORMAL = 0.6745
"""Median distance from the mean of a normal law, in standard deviations: the quantile of 75 %, by definition."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Index:
    """A published index.

    Attributes
    ----------
    title, unit, source : for people.
    wavelengths_nm : what it needs. (k,)
    formula : see `Formula`.
    low, high : range of values that it was made for; what is beyond has the status `beyond_range`.
    of_soils : whether it holds for reflectance factors of soils of the Moon only, `SOILS` at its first wavelength.
    missed_by : median and largest distance from the chemistry of 11 soils of Apollo and Luna, their spectra measured in
        laboratories; None where that was not tried. [its unit]
    """

    title: str
    source: str
    wavelengths_nm: Sequence[float]
    formula: Formula
    unit: str = "-"
    low: float = -np.inf
    high: float = np.inf
    of_soils: bool = False
    missed_by: tuple[float, float] | None = None

    @property
    def miss_sigma(self) -> float:
        """Standard deviation of a normal law with the median of these distances; 0 where that was not tried."""
        return self.missed_by[0] / MEDIAN_OF_NORMAL if self.missed_by else 0.0


def linear(*weights: float) -> Formula:
    """sum_k w_k R_k"""

    def evaluate(r: FloatArray) -> Evaluated:
        return r @ np.array(weights), np.broadcast_to(weights, r.shape)

    return evaluate


def ratio(above: Sequence[float], below: Sequence[float], less: float = 0.0) -> Formula:
    """sum_k a_k R_k / sum_k b_k R_k - c"""

    def evaluate(r: FloatArray) -> Evaluated:
        quotient = (r @ np.array(above)) / (divisor := r @ np.array(below))
        return quotient - less, (np.array(above) - quotient[:, None] * np.array(below)) / divisor[:, None]

    return evaluate


def integrated_depth(first_nm: float, last_nm: float, at_nm: Sequence[float]) -> Formula:
    """sum_k (1 - R_k / C_k) below the line C through R at the first and the last wavelength, which come first."""
    share = (np.array(at_nm) - first_nm) / (last_nm - first_nm)

    def evaluate(r: FloatArray) -> Evaluated:
        ends, inside = r[:, :2], r[:, 2:]
        line = ends[:, :1] * (1 - share) + ends[:, 1:] * share
        to_line = inside / line**2
        derivatives = [(to_line * (1 - share)).sum(axis=1), (to_line * share).sum(axis=1)]
        return (1 - inside / line).sum(axis=1), np.column_stack([*derivatives, -1 / line])

    return evaluate


def _from_origin(r: FloatArray, x0: float, y0: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """x - x0 and y0 - y of x = R_1, y = R_2 / R_1, and their derivatives. (n,), (n,), (2,), (n, 2)"""
    y = r[:, 1] / r[:, 0]
    return r[:, 0] - x0, y0 - y, np.array([1.0, 0.0]), np.column_stack([y, -np.ones_like(y)]) / r[:, :1]


def angle(x0: float, y0: float, of_angle: Callable[[FloatArray], tuple[FloatArray, FloatArray]]) -> Formula:
    """f(theta), theta = atan((y0 - R_2 / R_1) / (R_1 - x0)) from 0 to pi; `of_angle` gives f and df/dtheta."""

    def evaluate(r: FloatArray) -> Evaluated:
        a, b, da, db = _from_origin(r, x0, y0)
        value, slope = of_angle(np.where(b > 0, np.arctan2(b, a), np.nan))
        square = a**2 + b**2
        return value, (slope / square)[:, None] * (a[:, None] * db - b[:, None] * da)

    return evaluate


def rising_angle(x0: float, y0: float, factor: float, power: float) -> Formula:
    """factor theta^power, theta = atan((R_2 / R_1 - y0) / (R_1 - x0)) from 0 to pi"""

    def evaluate(r: FloatArray) -> Evaluated:
        a, b, da, db = _from_origin(r, x0, y0)
        theta = np.where(b < 0, np.arctan2(-b, a), np.nan)
        slope = factor * power * theta ** (power - 1) / (a**2 + b**2)
        return factor * theta**power, slope[:, None] * (b[:, None] * da - a[:, None] * db)

    return evaluate


def distance(x0: float, y0: float) -> Formula:
    """sqrt((R_1 - x0)^2 + (R_2 / R_1 - y0)^2)"""

    def evaluate(r: FloatArray) -> Evaluated:
        a, b, da, db = _from_origin(r, x0, y0)
        length = np.hypot(a, b)
        return length, (a[:, None] * da + b[:, None] * db) / length[:, None]

    return evaluate


def _line(factor: float, constant: float) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    return lambda theta: (factor * theta + constant, np.full_like(theta, factor))


UM1, UM2 = (699.0, 1579.0), (1578.0, 2538.0)
"""Ends of the lines of IBD1000 and IBD2000: Mustard et al. (2011), 10.1029/2010JE003726."""
STEPS_UM1 = tuple(789.0 + 20 * step for step in range(27))
"""Where IBD1000 is summed up, every 20 nm: Mustard et al. (2011)."""
STEPS_UM2 = tuple(1658.0 + 40 * step for step in range(22))
"""Where IBD2000 is summed up, every 40 nm: Mustard et al. (2011)."""
INDICES: Mapping[str, Index] = {
    "r540": Index(title="R540", source=M3_LIST, wavelengths_nm=(540.0,), formula=linear(1.0)),
    "r1580": Index(title="R1580", source=M3_LIST, wavelengths_nm=(1579.0,), formula=linear(1.0)),
    "ibd1000": Index(
        title="IBD1000",
        source=f"{M3_LIST}; line through 699 and 1579 nm",
        wavelengths_nm=(*UM1, *STEPS_UM1),
        formula=integrated_depth(*UM1, STEPS_UM1),
    ),
    "ibd2000": Index(
        title="IBD2000",
        source=f"{M3_LIST}; line through 1578 and 2538 nm",
        wavelengths_nm=(*UM2, *STEPS_UM2),
        formula=integrated_depth(*UM2, STEPS_UM2),
    ),
    "slope1000_per_um": Index(
        title="1 µm slope",
        source=f"{M3_LIST}; 699 to 1579 nm",
        wavelengths_nm=UM1,
        formula=linear(-1 / 0.88, 1 / 0.88),
        unit="1/µm",
    ),
    "slope2000_per_um": Index(
        title="2 µm slope",
        source=f"{M3_LIST}; 1578 to 2538 nm",
        wavelengths_nm=UM2,
        formula=linear(-1 / 0.96, 1 / 0.96),
        unit="1/µm",
    ),
    "olivine_index": Index(
        title="olivine index",
        source="Pelkey et al. (2007), J. Geophys. Res. 112, E08S14, 10.1029/2006JE002831 (OLINDEX)",
        wavelengths_nm=(1695.0, 1080.0, 1210.0, 1330.0, 1470.0),
        formula=ratio((1, 0, 0, 0, 0), (0, 0.1, 0.1, 0.4, 0.4), 1.0),
    ),
    "spinel_pieters": Index(
        title="spinel, R1400/R1750",
        source="Pieters et al. (2014), Am. Mineral. 99, 1893, 10.2138/am-2014-4776",
        wavelengths_nm=(1400.0, 1750.0),
        formula=ratio((1, 0), (0, 1)),
    ),
    "spinel_moriarty": Index(
        title="spinel, 2600 nm",
        source="Moriarty et al. (2023), J. Geophys. Res. Planets 128, e2022JE007482, 10.1029/2022JE007482",
        wavelengths_nm=(750.0, 1250.0, 2600.0),
        formula=ratio((-2.7, 3.7, 0), (0, 0, 1)),
    ),
    "omat": Index(
        title="OMAT",
        source="Lucey, Blewett, Taylor & Hawke (2000), J. Geophys. Res. 105, 20377, 10.1029/1999JE001110",
        wavelengths_nm=(750.0, 950.0),
        formula=distance(0.08, 1.19),
        of_soils=True,
    ),
    "feo_lucey_wt": Index(
        title="FeO, Clementine",
        source=LUCEY,
        wavelengths_nm=(750.0, 950.0),
        formula=angle(0.08, 1.19, _line(17.427, -7.565)),
        unit="wt %",
        of_soils=True,
        low=0.0,
        high=25.0,
        missed_by=(3.1, 23.2),
    ),
    "feo_zhang_wt": Index(
        title="FeO, M3",
        source="Zhang & Bowles (2013), Lunar Planet. Sci. 44, 1212",
        wavelengths_nm=(750.0, 950.0),
        formula=angle(0.01, 1.26, _line(17.83, -6.82)),
        unit="wt %",
        of_soils=True,
        low=0.0,
        high=25.0,
        missed_by=(0.5, 14.5),
    ),
    "tio2_lucey_wt": Index(
        title="TiO2, Clementine",
        source=LUCEY,
        wavelengths_nm=(750.0, 415.0),
        formula=rising_angle(0.0, 0.42, 3.708, 5.979),
        unit="wt %",
        of_soils=True,
        low=0.0,
        high=15.0,
    ),
}
"""By the name of its key; abundances are those of soils of the Moon, and their ranges those that these have."""


@dataclass(frozen=True, slots=True, eq=False)
class IndexColumn:
    """One index of n spectra.

    Attributes
    ----------
    value : NaN where it is not determined. (n,) [unit of the index]
    sigma : one standard deviation from the noise of the channels. (n,)
    interpolation : difference to what cubic interpolation between the channels gives, absolute. (n,)
    calibration : one standard deviation from shifts that channels share; 0 where none is known. (n,)
    status : number in `STATUSES`. (n,)
    """

    value: FloatArray
    sigma: FloatArray
    interpolation: FloatArray
    calibration: FloatArray
    status: IntArray

    @classmethod
    def empty(cls, size: int) -> "IndexColumn":
        value, sigma, between, calibration = (np.full(size, np.nan) for _ in range(4))
        return cls(value, sigma, between, calibration, np.full(size, NO_CHANNELS, np.int8))

    def take(self, other: "IndexColumn", rows: Sequence[int] | IntArray) -> None:
        """Put another column's spectra into these rows."""
        for name in ("value", "sigma", "interpolation", "calibration", "status"):
            getattr(self, name)[rows] = getattr(other, name)


def index_arrays(
    wavelength_nm: FloatArray,
    reflectance: FloatArray,
    sigma: FloatArray | None = None,
    *,
    names: Sequence[str] = tuple(INDICES),
    smooth_nm: float = 0.0,
    shifts: Mapping[str, FloatArray] | None = None,
) -> dict[str, IndexColumn]:
    """Indices of many spectra on the same channels.

    Parameters
    ----------
    wavelength_nm : (c,) ascending. [nm]
    reflectance : (n, c); what is not finite or not above 0 is left out, row by row. [-]
    sigma : one standard deviation, (c,) or (n, c); by default from the scatter of the channels. [-]
    names : which of `INDICES`.
    smooth_nm : window of a Savitzky-Golay filter of order 2 before all, 0 for none. [nm]
    shifts : of the reflectance by one standard deviation of an error that channels share, (n, c) each. [-]

    Raises ParameterError for an unknown name or an impossible window.
    """
    if unknown := [name for name in names if name not in INDICES]:
        raise ParameterError(f"there is no index {unknown[0]}; there are: {', '.join(INDICES)}")
    if not 0 <= smooth_nm <= LARGEST_SMOOTH_NM:
        raise ParameterError(f"smoothing over {smooth_nm:g} nm: give 0 to {LARGEST_SMOOTH_NM:g} nm")
    values = np.asarray(reflectance, float)
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(values) & (values > 0)
    columns = {name: IndexColumn.empty(len(values)) for name in names}
    for channels, rows in alike_channels(usable):
        if channels.sum() < 2:
            continue
        measured = values[np.ix_(rows, channels)]
        noise = (
            scatter_noise_rows(measured)
            if sigma is None
            else np.broadcast_to(sigma, values.shape)[np.ix_(rows, channels)]
        )
        shared = [np.asarray(shift)[np.ix_(rows, channels)] for shift in (shifts or {}).values()]
        group = _Group(wavelength_nm[channels], measured, noise, shared, smooth_nm)
        for name in names:
            group.into(columns[name], rows, INDICES[name])
    return columns


@dataclass(slots=True, eq=False)
class _Group:
    """n spectra on the same c usable channels.

    Attributes
    ----------
    wavelength_nm, reflectance, sigma : (c,), (n, c), and one standard deviation, (n, c). [nm, -, -]
    shifts : changes of the reflectance by one standard deviation of each error that channels share, (n, c). [-]
    smooth_nm : window of the smoothing, 0 for none; `smoothing` is its operator, (c, c).
    """

    wavelength_nm: FloatArray
    reflectance: FloatArray
    sigma: FloatArray
    shifts: Sequence[FloatArray]
    smooth_nm: float
    smoothing: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.smoothing = smoothing_operator(self.wavelength_nm, self.smooth_nm, 2)

    def into(self, column: IndexColumn, rows: IntArray, index: Index) -> None:
        """Write an index of these spectra into the rows of its column."""
        wanted = np.array(index.wavelengths_nm)
        if not reached(self.wavelength_nm, wanted).all():
            return
        straight = interpolation(self.wavelength_nm, wanted, 1) @ self.smoothing
        curved = interpolation(self.wavelength_nm, wanted, 3) @ self.smoothing
        used = np.flatnonzero(np.abs(straight).sum(axis=0) > 0)
        reflectance = self.reflectance[:, used] @ straight[:, used].T
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            value, derivatives = index.formula(reflectance)
            other, _ = index.formula(self.reflectance @ curved.T)
        carried = derivatives @ straight[:, used]
        column.value[rows] = np.where(np.isfinite(value), value, np.nan)
        finite = np.isfinite(value)
        shared = np.array([(carried * shift[:, used]).sum(axis=1) for shift in self.shifts]).reshape(-1, len(value))
        column.sigma[rows] = np.where(finite, np.sqrt(((carried * self.sigma[:, used]) ** 2).sum(axis=1)), np.nan)
        column.interpolation[rows] = np.where(finite, np.abs(other - value), np.nan)
        column.calibration[rows] = np.where(finite, np.sqrt((shared**2).sum(axis=0)), np.nan)
        beyond = (value < index.low) | (value > index.high)
        if index.of_soils:
            beyond |= (reflectance[:, 0] < SOILS[0]) | (reflectance[:, 0] > SOILS[1])
        column.status[rows] = np.where(finite, np.where(beyond, BEYOND, OK), UNDEFINED)


def reached(wavelength_nm: FloatArray, wanted_nm: FloatArray) -> BoolArray:
    """Whether there are channels on both sides, near enough, or one within half of a step beyond the end. (k,)"""
    right = np.clip(np.searchsorted(wavelength_nm, wanted_nm), 1, wavelength_nm.size - 1)
    step = wavelength_nm[right] - wavelength_nm[right - 1]
    beyond = np.maximum(wavelength_nm[0] - wanted_nm, wanted_nm - wavelength_nm[-1])
    at_one = np.abs(wavelength_nm[:, None] - wanted_nm).min(axis=0) < 1e-9
    near: BoolArray = at_one | ((step <= NARROW_NM) & (beyond <= step / 2))
    return near


def interpolation(wavelength_nm: FloatArray, wanted_nm: FloatArray, order: int) -> FloatArray:
    """Matrix that takes channels to wanted wavelengths, (k, c): Lagrange's polynomial through the nearest ones.

    Of order 1 a wavelength beyond the end takes the last channel; of order 3 it is extrapolated.
    """
    count = min(order + 1, wavelength_nm.size)
    right = np.searchsorted(wavelength_nm, wanted_nm)
    first = np.clip(right - count // 2, 0, wavelength_nm.size - count)
    at = np.clip(wanted_nm, wavelength_nm[0], wavelength_nm[-1]) if order == 1 else wanted_nm
    matrix = np.zeros((wanted_nm.size, wavelength_nm.size))
    for row, start in enumerate(first):
        nodes = wavelength_nm[start : start + count]
        for place, node in enumerate(nodes):
            others = np.delete(nodes, place)
            matrix[row, start + place] = np.prod((at[row] - others) / (node - others))
    return matrix
