"""One detector's way from radiance to reflectance factor at the standard geometry, with its random errors.

Also what a calibration can be told: irradiance, photometric model, shadow limit, factors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.ranges import ACUTE_DEG, POSITIVE, check_each, check_range
from lunarsci.spectra.photometry import TABLE as PHASE_TABLE
from lunarsci.spectra.photometry import Geometry, PhaseFunction, SelenePhase, phase_function
from lunarsci.spectra.rows import named_table
from lunarsci.spectra.solar import (
    M3_TABLE,
    SOLAR_SPECTRA,
    SolarSpectrum,
    in_band_irradiance,
    solar_spectrum,
    sun_moon_distance_au,
    table_name,
)
from lunarsci.spectra.spectrum import scatter_noise
from lunarsci.spectra.vnis.channels import (
    SUB_BAND_STEP_NM,
    SWIR_NM,
    TABLES,
    VNIR_NM,
    VNIR_SUB_BANDS_NM,
    Detector,
    fixed_pattern,
    fwhm_nm,
    random_noise,
)
from lunarsci.spectra.vnis.label import Label

IN_FLIGHT_VERSION = 2.0
"""`version_id` of products whose radiance rests on the calibration target seen in flight, by the dates of products
since 2019-07-09 (CNSA 2019, Lunar and Planetary Data Release System)."""

WAVELENGTHS: dict[Detector, FloatArray] = {"vnir": VNIR_NM, "swir": SWIR_NM}


_NOISY = 1 + 0.15 * NormalDist().inv_cdf(1 - SIGNIFICANCE / 2)
"""A sub-band whose channels scatter more than so many times the instrument's figures has its errors enlarged: 1.39,
which `SIGNIFICANCE` of sub-bands exceed by chance, since without excess the estimate was seen to scatter by 0.1 to
0.2."""
_SUB_BANDS_NM: dict[Detector, tuple[float, ...]] = {"vnir": VNIR_SUB_BANDS_NM, "swir": (SUB_BAND_STEP_NM, 1997.5)}
"""Where the filters change their sub-bands: see `SUB_BAND_STEP_NM`; that at 1997.5 nm only splits the scatter,
assumed."""
RANGE = (0.001, 2.0)
"""Reflectance factors that lit lunar ground may have; assumed. [-]"""
_NEIGHBOURS = 5
_FAR: dict[Detector, float] = {"vnir": 0.3, "swir": 0.12}
"""ln R this far from its neighbours is no rock; measured: 88 Chang'E-4 spectra have up to 0.29 in VNIR, at 455 nm, and
0.09 in SWIR, 409 laboratory spectra at 5 nm up to 0.07 and 0.03. [-]"""
_FAR_MEDIANS, _SCATTER = 9.0, 15
"""In noise, this many times the median of so many channels on either side: six standard deviations. Assumed."""


def reflectance_factor(
    radiance: FloatArray, irradiance: FloatArray, incidence_deg: float, distance_au: float
) -> FloatArray:
    """REFF = pi L d^2 / (E0 cos i): radiance over that of a perfectly diffuse surface lit the same way. [-]

    Parameters
    ----------
    radiance : L, any shape that broadcasts with `irradiance`. [W m-2 sr-1 nm-1]
    irradiance : E0 in the channel at 1 AU, above 0. [W m-2 nm-1]
    incidence_deg : i, 0 up to below 90. [deg]
    distance_au : d, Sun to Moon, above 0. [AU]

    Raises ParameterError outside these ranges.

    Hapke (2012), Theory of Reflectance and Emittance Spectroscopy, 10.1017/CBO9781139025683; Ding et al. (2024),
    10.1038/s41467-024-46233-8 (their equation 29).
    """
    sun = {"incidence": incidence_deg, "distance": distance_au, "irradiance": float(np.min(irradiance))}
    check_each("the Sun's", sun, {"incidence": f"{ACUTE_DEG}; in deg", "distance": POSITIVE, "irradiance": POSITIVE})
    factor: FloatArray = np.pi * radiance * distance_au**2 / (irradiance * np.cos(np.radians(incidence_deg)))
    return factor


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFactors:
    """What radiances of version 1 are multiplied with, channel by channel: `vnir` (100,), `swir` (300,). [-]

    `source` is the name of their file.
    """

    source: str
    vnir: FloatArray
    swir: FloatArray


def read_channel_factors(source: InputFile) -> ChannelFactors:
    """Read a CSV file with the columns `detector` (vnir or swir), `wavelength_nm` and `factor`, one row per channel.

    Raises DataError for other columns, missing or repeated channels, and factors that are not above 0.
    """
    table = named_table(source, "detector", "wavelength_nm", "factor")
    detector = np.array([cell.lower() for cell in table.cells("detector")])
    wavelength, factor = table.numbers("wavelength_nm"), table.numbers("factor")
    table.refuse(~np.isin(detector, ("vnir", "swir")), "detector", "the detector is vnir or swir")
    table.refuse(~((factor > 0) & np.isfinite(factor)), "factor", "factors are numbers above 0")
    result = []
    for name, channels in WAVELENGTHS.items():
        order = np.flatnonzero(detector == name)[np.argsort(wavelength[detector == name])]
        if not np.array_equal(wavelength[order], channels):
            lacking = np.setdiff1d(channels, wavelength[order])
            what = f"{lacking[0]:g} nm is missing" if lacking.size else "there are others, or some twice"
            count = f"{name} has {channels.size} channels, {order.size} are given and {what}"
            raise DataError(f"{source.name}: {count}; give each of them once")
        result.append(factor[order])
    return ChannelFactors(source.name, *result)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settings:
    """How to calibrate.

    Attributes
    ----------
    solar : irradiance at 1 AU. other_solar : a second spectrum; the difference of the two is the irradiance's error.
    photometry : disk function `lommel-seeliger`, `akimov` or `mcewen`, or `none` to leave the reflectance factor at the
        angles of measurement.
    phase : phase function, used with a disk function only.
    shadow_limit : pixels with a reflectance factor below it at 465 nm are shadows, 0 to below 1. [-]
    remove_vnir_steps : whether steps between the sub-bands of VNIR are removed, not only their error stated.
    factors : for products from before the in-flight calibration.

    Raises ParameterError outside these.
    """

    solar: SolarSpectrum
    other_solar: SolarSpectrum
    photometry: str
    phase: PhaseFunction
    shadow_limit: float = 0.02
    remove_vnir_steps: bool = False
    factors: ChannelFactors | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_range("the shadow limit", self.shadow_limit, "[0, 1)", "a reflectance")

    @property
    def tables(self) -> tuple[str, ...]:
        """Files of `spectra_data` that a calibration reads, for the provenance."""
        solar = sorted({self.solar.name, self.other_solar.name} & set(SOLAR_SPECTRA))
        phase = [PHASE_TABLE] if self.photometry != "none" and isinstance(self.phase, SelenePhase) else []
        return (*TABLES, *map(table_name, solar), M3_TABLE, *phase)


def default_settings() -> Settings:
    """What `lunarsci spectra calibrate` does without options, and what other commands do with a label.

    The disk function is that of Ding et al. (2024). Of the two solar spectra E490 leaves less structure from channel to
    channel: on the median of 88 Chang'E-4 spectra the second differences are 4 to 20 % smaller in four of six ranges
    and equal in the other two; G173 is sampled at 5 nm from 1705 nm on.
    """
    return Settings(
        solar=solar_spectrum("e490"),
        other_solar=solar_spectrum("g173"),
        photometry="lommel-seeliger",
        phase=phase_function("sp-mid"),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DetectorSpectrum:
    """What one detector measured; arrays have one value per channel, NaN where it is not used.

    Attributes
    ----------
    detector : vnir or swir. wavelength_nm : its channels.
    geometry : incidence, emission, phase of this product. distance_au : Sun to Moon at its time.
    radiance : multiplied by the channel factors, where they apply. [W m-2 sr-1 nm-1]
    irradiance : in the channel, at 1 AU. [W m-2 nm-1]
    observed : reflectance factor at the angles of measurement. [-]
    correction : photometric factor to the standard geometry, 1 without correction. [-]
    relative_sigma : error independent between channels, over the reflectance: noise, fixed pattern and, for the image,
        the standard error of the mean over the pixels. [-]
    excess : scatter between neighbouring channels over what the instrument's figures make of it, in each sub-band;
        `relative_sigma` is enlarged by it where it is above 1.39.
    """

    detector: Detector
    wavelength_nm: FloatArray
    geometry: Geometry
    distance_au: float
    radiance: FloatArray
    irradiance: FloatArray
    observed: FloatArray
    correction: FloatArray
    relative_sigma: FloatArray
    excess: FloatArray

    @property
    def enlarged(self) -> bool:
        """Whether errors were enlarged for scatter beyond the instrument's figures."""
        return bool((self.excess > _NOISY).any())

    @property
    def corrected(self) -> FloatArray:
        """Reflectance factor after the photometric correction. [-]"""
        return self.observed * self.correction


@lru_cache(maxsize=16)
def irradiance_at(detector: Detector, solar: SolarSpectrum) -> FloatArray:
    """Irradiance in the channels of one detector at 1 AU; read-only, kept for the next observation. [W m-2 nm-1]"""
    wavelength = WAVELENGTHS[detector]
    irradiance = in_band_irradiance(solar, wavelength, fwhm_nm(wavelength, detector))
    irradiance.setflags(write=False)
    return irradiance


def measure(
    detector: Detector,
    label: Label,
    radiance: FloatArray,
    mean_error: FloatArray,
    irradiance: FloatArray,
    correction: FloatArray,
) -> DetectorSpectrum:
    """Reflectance factor and its random error from radiance, NaN where a channel is not used.

    `mean_error` is the relative standard error of the mean over pixels, 0 for a single pixel; `correction` the
    photometric factor to the standard geometry.
    """
    wavelength = WAVELENGTHS[detector]
    middle = label.start + (label.stop - label.start) / 2
    distance = sun_moon_distance_au(middle)
    observed = reflectance_factor(radiance, irradiance, label.geometry.incidence_deg, distance)
    figures = np.hypot(random_noise(wavelength, detector), fixed_pattern(wavelength, detector))
    excess = _excess(detector, wavelength, observed, figures)
    sigma = np.hypot(figures * np.where(excess > _NOISY, excess, 1.0), mean_error)
    return DetectorSpectrum(
        detector,
        wavelength,
        label.geometry,
        distance,
        radiance,
        irradiance,
        observed,
        correction,
        np.where(np.isfinite(observed), sigma, np.nan),
        excess,
    )


def _excess(detector: Detector, wavelength: FloatArray, observed: FloatArray, figures: FloatArray) -> FloatArray:
    """By sub-band, the scatter between neighbouring channels over the instrument's figures; 1 for a few channels."""
    excess = np.ones_like(observed)
    edges = np.searchsorted(wavelength, _SUB_BANDS_NM[detector])
    for part in np.split(np.arange(wavelength.size), edges):
        good = part[np.isfinite(observed[part])]
        if good.size >= 10:
            ratio = np.log(observed[good]) / figures[good]
            excess[part] = np.median(scatter_noise(ratio - np.median(ratio)))
    return excess


def outlying(detector: Detector, reflectance: FloatArray) -> BoolArray:
    """True for channels outside 0.001-2 or far from their neighbours; shape (n,).

    What they should be is the median of five straight lines: through the next channels on both sides, those after
    them, and so on to the fifth.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        absurd = np.isfinite(reflectance) & ~((reflectance >= RANGE[0]) & (reflectance <= RANGE[1]))
        ln = np.log(np.where(absurd | ~(reflectance > 0), np.nan, reflectance))
    finite = np.flatnonzero(np.isfinite(ln))
    if finite.size < 2 * _NEIGHBOURS:
        return absurd
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(ln[finite], _NEIGHBOURS, mode="reflect", reflect_type="odd"), 2 * _NEIGHBOURS + 1
    )
    middles = (around[:, :_NEIGHBOURS] + around[:, :_NEIGHBOURS:-1]) / 2
    far = np.zeros_like(absurd)
    off = np.abs(ln[finite] - np.median(middles, axis=1))
    beside = min(_SCATTER, finite.size - 1)
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(off, beside, mode="reflect"), 2 * beside + 1)
    far[finite] = off > np.maximum(_FAR[detector], _FAR_MEDIANS * np.median(nearby, axis=1))
    return np.asarray(absurd | far, dtype=np.bool_)
