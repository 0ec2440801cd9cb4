"""A made-up piece of lunar ground and how the sun and the rover stand to it. Never a measurement.

Every number in this module that describes a material is assumed: full strengths of bands, albedos, slopes, textures.
They are chosen so that spectra look about as bright, red and subdued as those of the Chang'E-4 site.
"""

import math
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.ranges import SHARE, check_range, check_ranges, refuse
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA
from lunarsci.spectra.photometry import Geometry, phase_angle_deg
from lunarsci.spectra.vnis.channels import FOOTPRINT, IMAGE_NM, SWIR_NM, VNIR_NM
from lunarsci.spectra.vnis.label import SUN_DEG
from lunarsci.sun import sun_in_moon_frame, sun_incidence_deg, upward

SITE = (177.585, -45.44)
"""Longitude and latitude of the rover: by the labels of Chang'E-4 (CNSA 2020, Lunar and Planetary Data Release System).
[deg]"""
SWIR_STEP = timedelta(seconds=1.068)
"""See `VNIR_STEP`."""
SWIR_BREAK = timedelta(seconds=21.944)
"""Extra pause after channel 95, where the filter changes its sub-band: see `VNIR_STEP`."""
VNIR_DELAY = timedelta(seconds=49.5)
"""See `VNIR_STEP`."""
VNIR_STEP = timedelta(seconds=0.806)
"""Clock of a measurement, about that of observation 136 of Chang'E-4 (CNSA 2020, Lunar and Planetary Data Release
System): the short-wave scan first, then the images."""
SWIR_MORE_INCIDENCE_DEG = 0.0334
"""The sun rises between the scans: 64.445 deg in the short-wave label of observation 136 (CNSA 2020), 64.412 deg in the
other."""


class SceneBand(NamedTuple):
    """A band: the mineral it belongs to, '' for all materials; strength where that is all there is [ln R]; [nm, nm]."""

    mineral: str
    strength: float
    center_nm: float
    fwhm_nm: float


BANDS = {
    "uv": SceneBand("", -0.30, 330.0, 250.0),
    "visible 1": SceneBand("", -0.05, 480.0, 150.0),
    "visible 2": SceneBand("", -0.03, 640.0, 180.0),
    "OL M1-1": SceneBand("olivine", -0.25, 860.0, 215.0),
    "OL M2": SceneBand("olivine", -0.45, 1043.0, 171.0),
    "OL M1-2": SceneBand("olivine", -0.35, 1215.0, 429.0),
    "OPX 1": SceneBand("orthopyroxene", -0.60, 915.0, 190.0),
    "OPX 2": SceneBand("orthopyroxene", -0.45, 1860.0, 520.0),
    "CPX 1": SceneBand("clinopyroxene", -0.50, 1015.0, 215.0),
    "CPX 2": SceneBand("clinopyroxene", -0.40, 2300.0, 560.0),
    "PLG": SceneBand("plagioclase", -0.06, 1250.0, 350.0),
}
"""Centres are about those of olivine Fo 85, orthopyroxene Fs 20 and augite in laboratory spectra, widths and strengths
assumed. Not from the table of priors, so that a simulation does not know what a fit expects."""


@dataclass(frozen=True, slots=True)
class SceneComposition:
    """Fractions of the minerals, each within 0-1, sum 1 (within 1e-6). Raises ParameterError for anything else. [-]"""

    olivine: float = 0.0
    orthopyroxene: float = 0.0
    clinopyroxene: float = 0.0
    plagioclase: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self.fractions, {SHARE: " ".join(self.fractions)}, "the fraction of")
        total = sum(self.fractions.values())
        check_range("the sum of all fractions", total, "[0.999999, 1.000001]", "make them add up to 1")

    @property
    def fractions(self) -> dict[str, float]:
        """Mineral to fraction."""
        return {item.name: float(getattr(self, item.name)) for item in fields(self)}


@dataclass(frozen=True, slots=True)
class Material:
    """A composition and how it looks.

    Attributes
    ----------
    composition : fractions of the minerals.
    albedo : of the continuum at 750 nm, reflectance factor at incidence 30, emission 0, phase 30 deg; above 0, up to 1.
    red_slope : relative rise of the straight continuum per micrometre, -0.5 to 3. [1/um]
    contrast : factor on the mineral bands, 0-3; below 1 as space weathering or fine grains make them.

    Raises ParameterError outside these ranges.
    """

    composition: SceneComposition
    albedo: float = 0.10
    red_slope: float = 0.6
    contrast: float = 1.0

    def __post_init__(self) -> None:
        check_ranges(self, {"(0, 1]": "albedo", "[-0.5, 3]": "red_slope", "[0, 3]": "contrast"}, "the material's")


SOIL, ROCK = (
    Material(SceneComposition(0.05, 0.20, 0.20, 0.55), albedo=0.10, red_slope=0.6, contrast=0.6),
    Material(SceneComposition(0.10, 0.35, 0.25, 0.30), albedo=0.09, red_slope=0.55),
)
"""A soil and a rock as there might be at the Chang'E-4 site; assumed."""


@dataclass(frozen=True, slots=True)
class SceneRock:
    """A disk of another material in the image; as large as the short-wave field of view if nothing else is said.

    `center_line` and `center_sample` count from 0, in the image or up to its own width outside it; radius above 0. [px]
    Raises ParameterError otherwise.
    """

    material: Material = ROCK
    center_line: float = FOOTPRINT[0]
    center_sample: float = FOOTPRINT[1]
    radius_px: float = math.ceil(FOOTPRINT[2])

    def __post_init__(self) -> None:
        check_ranges(self, {"[-256, 512]": "center_line center_sample", "[0.5, 1024]": "radius_px"}, "the rock's")


@dataclass(frozen=True, slots=True)
class Scene:
    """Ground, shadows, sun and rover.

    Attributes
    ----------
    soil : what covers the ground. rock : what lies on it, or None.
    texture : relative standard deviation of the brightness of pixels, the same in all channels; 0-0.5.
    texture_scale_px : how far one bright or dark spot reaches (standard deviation of a Gaussian); 0.5-64. [px]
    shadow_fraction : share of the image in shadow, 0 up to below 1.
    shadow_shape : `half-plane`, or `blobs`, which lie behind the rock where there is one.
    shadow_level : brightness in shadow relative to sunlight, 0 up to below 1.
    geometry : of the images; the short-wave scan differs by its incidence.
    swir_incidence_deg : of the short-wave scan; None for 0.0334 deg more than the images, as in real labels. [deg]
    disk, phase : photometry that the ground obeys, as in `photometry.correction_factor`; disk None for ground whose
        reflectance factor is the same at all angles.
    solar : name of the solar spectrum that lights it.
    time : middle of the short-wave scan, with its time zone.
    sequence : number of the observation, 1-9999.
    latitude_deg, longitude_deg : of the rover; None for where the Sun stands at its incidence, at the Chang'E-4 site
        or as far from it as need be. [deg]

    Raises ParameterError when a value is out of its range.
    """

    soil: Material = SOIL
    rock: SceneRock | None = None
    texture: float = 0.05
    texture_scale_px: float = 4.0
    shadow_fraction: float = 0.0
    shadow_shape: str = "blobs"
    shadow_level: float = 0.003
    geometry: Geometry = field(default_factory=lambda: Geometry(64.412, 45.557, 54.505))
    swir_incidence_deg: float | None = None
    disk: str | None = "akimov"
    phase: str = "sp-high"
    solar: str = "e490"
    time: datetime = datetime(2020, 7, 16, 8, 20, tzinfo=UTC)
    sequence: int = 1
    latitude_deg: float | None = None
    longitude_deg: float | None = None

    def __post_init__(self) -> None:
        check_ranges(self, {
            "[0, 0.5]": "texture", "[0.5, 64]": "texture_scale_px", "[0, 1)": "shadow_fraction shadow_level",
            "[1, 9999]": "sequence", "[-90, 90]": "latitude_deg", "[-180, 360]": "longitude_deg",
        }, "the scene's")  # fmt: skip
        reasons = {
            "a place has a latitude and a longitude; give both or neither":
                (self.latitude_deg is None) != (self.longitude_deg is None),
            f"the shadow shape '{self.shadow_shape}' is unknown; choose half-plane or blobs":
                self.shadow_shape not in ("half-plane", "blobs"),
            f"the time {self.time.isoformat()} has no time zone; give it in UTC, ending in Z": self.time.tzinfo is None,
        }  # fmt: skip
        refuse(reasons)
        self.swir_geometry()

    @property
    def place(self) -> tuple[float, float]:
        """Longitude and latitude of the rover. [deg]"""
        if self.latitude_deg is not None and self.longitude_deg is not None:
            return self.longitude_deg, self.latitude_deg
        times = self.vnir_times()
        middle, incidence = times[0] + (times[-1] - times[0]) / 2, self.geometry.incidence_deg
        if abs(sun_incidence_deg(middle, *SITE) - incidence) < 0.5 * SUN_DEG:
            return SITE
        sun, site = sun_in_moon_frame(middle), upward(*SITE)
        aside = site - (site @ sun) * sun
        there = math.cos(math.radians(incidence)) * sun + math.sin(math.radians(incidence)) * aside / np.linalg.norm(
            aside
        )
        return math.degrees(math.atan2(there[1], there[0])) % 360, math.degrees(math.asin(there[2]))

    def swir_geometry(self) -> Geometry:
        """Angles of the short-wave scan: own incidence, same emission, phase at the same difference of azimuths."""
        seen = self.geometry
        incidence = self.swir_incidence_deg
        if incidence is None:
            incidence = seen.incidence_deg + SWIR_MORE_INCIDENCE_DEG
        turn = azimuth_difference_deg(seen)
        before, now = (phase_angle_deg(i, seen.emission_deg, turn) for i in (seen.incidence_deg, incidence))
        return Geometry(incidence, seen.emission_deg, max(seen.phase_deg + now - before, 0.0))

    def swir_times(self) -> tuple[datetime, ...]:
        """UTC of the 300 short-wave channels."""
        last = SWIR_STEP * (SWIR_NM.size - 1) + SWIR_BREAK
        start = self.time.astimezone(UTC) - last / 2
        return tuple(start + k * SWIR_STEP + (SWIR_BREAK if k > 95 else timedelta()) for k in range(SWIR_NM.size))

    def vnir_times(self) -> tuple[datetime, ...]:
        """UTC of the 100 images."""
        start = self.swir_times()[-1] + VNIR_DELAY
        return tuple(start + k * VNIR_STEP for k in range(VNIR_NM.size))


def surface_reflectance(wavelength_nm: FloatArray, material: Material) -> FloatArray:
    """Reflectance factor at incidence 30, emission 0, phase 30 deg, shape (n,). [-]

    ln R = ln C + contrast · Σ fraction · strength · Gaussian + Σ strength · Gaussian, C a straight line through
    the albedo at 750 nm; centres, widths and full strengths assumed, proportional to the fraction (a real
    mixture is not). Form after Sunshine, Pieters & Pratt (1990), J. Geophys. Res. 95, 6955,
    10.1029/JB095iB05p06955.

    Raises ParameterError where the continuum is not above 0.
    """
    wavelength = np.asarray(wavelength_nm, dtype=float)
    continuum = material.albedo * (1 + material.red_slope * (wavelength - IMAGE_NM) / 1000)
    if not (continuum > 0).all():
        raise ParameterError(f"a continuum of slope {material.red_slope:g} per micrometre falls to 0 at these channels")
    ln = np.log(continuum)
    for band in BANDS.values():
        share = material.contrast * material.composition.fractions[band.mineral] if band.mineral else 1.0
        off = (wavelength - band.center_nm) * FWHM_OVER_SIGMA / band.fwhm_nm
        ln = ln + share * band.strength * np.exp(-0.5 * off**2)
    reflectance: FloatArray = np.exp(ln)
    return reflectance


def azimuth_difference_deg(geometry: Geometry) -> float:
    """Azimuth between the sun and the instrument, 0-180; 0 where one stands in the zenith. [deg]"""
    i, e, g = np.radians([geometry.incidence_deg, geometry.emission_deg, geometry.phase_deg])
    across = np.sin(i) * np.sin(e)
    if across < 1e-12:
        return 0.0
    return float(np.degrees(np.arccos(np.clip((np.cos(g) - np.cos(i) * np.cos(e)) / across, -1, 1))))
