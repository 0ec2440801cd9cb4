"""Solar spectral irradiance at 1 AU: the two standards that come with lunarsci, and channel averages.

`sun_moon_distance_au` has how far the Sun is from the Moon, which its irradiance there depends on.
"""

import warnings
from dataclasses import dataclass
from datetime import datetime
from functools import cache

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.tables import table_rows
from lunarsci.spectra.spectrum import channel_arrays
from lunarsci.sun import sun_from_moon_au

_LIGHT_TIME_S = 499.0
"""From the Sun at 1 au: 499.00478 s, IAU (2009) system of astronomical constants, Luzum et al. (2011),
10.1007/s10569-011-9352-4."""


def sun_moon_distance_au(time: datetime) -> float:
    """Distance that the sunlight on the Moon has travelled. [AU]

    From the Moon's centre at `time` to where the Sun's centre was one light time earlier, as in the range of an
    ephemeris; the geometric distance differs by less than 1e-7 AU. No file is read and no connection is opened.

    Parameters
    ----------
    time : aware of its time zone; from 1950-01-01 up to 2100-01-01 UTC, where the Moon's series was tested.

    Raises
    ------
    ParameterError for a time without time zone or outside that range.

    Notes
    -----
    Worst error against JPL Horizons, daily at 0 h UTC from 2019-01-04 to 2024-10-01: 1.3e-7 AU; against JPL DE421,
    1950 to 2050: 1.4e-7 AU. The light time is taken for 1 AU (1e-9 AU); an unknown leap second adds 1e-8 AU.

    Source: as `sun_from_moon_au`.
    """
    return float(np.linalg.norm(sun_from_moon_au(time, _LIGHT_TIME_S)))


SOLAR_SPECTRA = {
    "g173": "ASTM G173-03, extraterrestrial (Gueymard 2004, Solar Energy 76, 423, doi 10.1016/j.solener.2003.08.039)",
    "e490": "ASTM E490-00a, air mass zero (doi 10.1520/E0490-00AR06)",
}
COVERED_NM = (430.0, 2430.0)
"""What a table must cover for the VNIS channels, 450-2395 nm and their responses; assumed wide enough for both tails.
[nm]"""

M3_TABLE = "solar_m3_over_e490.csv"
"""ln of the irradiance that the M3 team used over that of E490."""

_HALF_WIDTH_FWHM = 3.0
_FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))


@dataclass(frozen=True, slots=True, eq=False)
class SolarSpectrum:
    """Spectral irradiance of the Sun at 1 AU, linear between its samples.

    Attributes
    ----------
    name : `g173`, `e490`, or the stem of the user's file.
    wavelength_nm : shape (n,), n at least 2, finite, above 0, strictly ascending. [nm]
    irradiance : shape (n,), finite, above 0. [W m-2 nm-1]
    source : what to cite, or the user's file.

    Raises
    ------
    DataError when a rule above is broken; the message begins with the name.
    """

    name: str
    wavelength_nm: FloatArray
    irradiance: FloatArray
    source: str

    def __post_init__(self) -> None:
        wavelength, irradiance = channel_arrays(self.name, self.wavelength_nm, self.irradiance)
        if wavelength.size < 2 or not (np.isfinite(irradiance).all() and (irradiance > 0).all()):
            raise DataError(f"{self.name}: fewer than two wavelengths, or an irradiance is missing or not above 0")
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "irradiance", irradiance)


@cache
def solar_spectrum(name: str) -> SolarSpectrum:
    """A standard at its native sampling, 400-2600 nm: `g173` (ASTM G173-03) or `e490` (ASTM E490-00a).

    They differ by 0.6 % from channel to channel and by 0.24 % in the mean. `e490` is made of 1 and 2 nm averages;
    `g173` has 1 nm samples up to 1700 nm and 5 nm ones above 1705 nm. Raises ParameterError for any other name.
    """
    rows = table_rows(table_name(name))
    columns = [(float(row["wavelength_nm"]), float(row["irradiance_w_m-2_nm-1"])) for row in rows]
    wavelength, irradiance = np.array(columns).T
    return SolarSpectrum(name, wavelength, irradiance, SOLAR_SPECTRA[name])


def table_name(name: str) -> str:
    """File in `spectra_data` that a standard is read from. Raises ParameterError for an unknown name."""
    if name not in SOLAR_SPECTRA:
        raise ParameterError(f"solar spectrum '{name}' is unknown; choose one of {', '.join(SOLAR_SPECTRA)}")
    return f"solar_{name}.csv"


def in_band_irradiance(solar: SolarSpectrum, center_nm: npt.ArrayLike, fwhm_nm: npt.ArrayLike) -> FloatArray:
    """Irradiance as a channel sees it: the mean of E over the channel's response g. [W m-2 nm-1]

        E_band = int E g dl / int g dl,  g = exp(-4 ln 2 (l - center)^2 / fwhm^2),  |l - center| <= 3 fwhm

    The Gaussian shape is assumed: only the width is published for VNIS. The integral over the piecewise linear E is in
    closed form. The table's own resolution is not taken out.

    Parameters
    ----------
    solar : must reach 3 fwhm beyond every centre.
    center_nm, fwhm_nm : any shapes that broadcast; finite and above 0. [nm]

    Returns
    -------
    The broadcast shape. A LunarSciWarning says where the table's step exceeds the FWHM: lines are lost there.

    Raises
    ------
    ParameterError for a centre or width that is not finite and above 0, or a response the table does not cover.
    """
    centers, widths = np.broadcast_arrays(np.asarray(center_nm, dtype=float), np.asarray(fwhm_nm, dtype=float))
    if not all(np.isfinite(values).all() and (values > 0).all() for values in (centers, widths)):
        raise ParameterError("center_nm and fwhm_nm must be finite and above 0 nm; correct the channel table")
    _check_coverage(solar, centers, widths)
    result = np.empty(centers.shape)
    coarsest = (1.0, 0.0, 0.0)
    for at in np.ndindex(centers.shape):
        center, fwhm = float(centers[at]), float(widths[at])
        result[at], step = _gaussian_mean(solar, center, fwhm)
        coarsest = max(coarsest, (step / fwhm, center, step))
    if coarsest[0] > 1:
        message = (
            f"{solar.name}: its step of {coarsest[2]:.3g} nm at {coarsest[1]:g} nm exceeds the channel's FWHM of "
            f"{coarsest[2] / coarsest[0]:.3g} nm: solar lines are lost; use a spectrum with finer steps"
        )
        warnings.warn(message, LunarSciWarning, stacklevel=2)
    return result


def _check_coverage(solar: SolarSpectrum, centers: FloatArray, widths: FloatArray) -> None:
    first, last = solar.wavelength_nm[0], solar.wavelength_nm[-1]
    reach = _HALF_WIDTH_FWHM * widths
    outside = (centers - reach < first) | (centers + reach > last)
    if outside.any():
        center, half = centers[outside][0], reach[outside][0]
        raise ParameterError(
            f"{solar.name}: covers {first:g}-{last:g} nm, the channel at {center:g} nm needs {center - half:g}-"
            f"{center + half:g} nm; use a spectrum that covers it or leave the channel out"
        )


def _gaussian_mean(solar: SolarSpectrum, center: float, fwhm: float) -> tuple[float, float]:
    """Mean over one response, and the widest step of the table within it."""
    from scipy.special import ndtr

    low, high = center - _HALF_WIDTH_FWHM * fwhm, center + _HALF_WIDTH_FWHM * fwhm
    first = int(np.searchsorted(solar.wavelength_nm, low, side="right")) - 1
    last = int(np.searchsorted(solar.wavelength_nm, high, side="left")) + 1
    knots, levels = solar.wavelength_nm[first:last], solar.irradiance[first:last]
    sigma = fwhm / _FWHM_PER_SIGMA
    edges = (np.clip(knots, low, high) - center) / sigma
    # On each segment E = E(center) + slope (l - center): one part takes the Gaussian's area, one its first moment.
    slope = np.diff(levels) / np.diff(knots)
    at_center = levels[:-1] + slope * (center - knots[:-1])
    area = np.diff(ndtr(edges))
    moment = -sigma * np.diff(np.exp(-0.5 * edges**2)) / np.sqrt(2.0 * np.pi)
    return float((at_center @ area + slope @ moment) / area.sum()), float(np.diff(knots).max())
