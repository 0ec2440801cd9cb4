"""Synthetic observations: what VNIS would have measured of a made-up scene. Never a measurement, and named so.

A scene in pixels has rock, shadow and brightness, made up from a seed. `scene_radiance` is the scene without noise,
`draw` adds one realisation of the instrument; `simulate` is both. Radiance L = REFF · E0 · cos i / (π d²), with E0
averaged over the response of each channel and with incidence, time and distance of each product (Hapke 2012, Theory of
Reflectance and Emittance Spectroscopy, ch. 10).
"""

import math
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.ranges import NOT_NEGATIVE, check_range, check_ranges
from lunarsci.spectra.photometry import Geometry, correction_factor, phase_function
from lunarsci.spectra.solar import in_band_irradiance, solar_spectrum, sun_moon_distance_au
from lunarsci.spectra.vnis.channels import (
    CUBE_SHAPE,
    SPLICED_NM,
    SUB_BAND_STEP_NM,
    SWIR_NM,
    VNIR_NM,
    Detector,
    fixed_pattern,
    footprint_mask,
    fwhm_nm,
    random_noise,
)
from lunarsci.spectra.vnis.simulation.scene import Material, Scene, SceneComposition, SceneRock, surface_reflectance

FloatCube = npt.NDArray[np.float32]
SHAPE = CUBE_SHAPE[1:]
BLOB_SCALE_PX = 24.0
"""Size of the patches of brighter and darker ground; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class ScenePixels:
    """Masks and brightness, each of shape (256, 256).

    Attributes
    ----------
    rock, shadow : where they are.
    brightness : relative to smooth ground in sunlight, texture and shadow together. [-]
    """

    rock: BoolArray
    shadow: BoolArray
    brightness: npt.NDArray[np.float32]


def generator(seed: int, stream: str) -> np.random.Generator:
    """Random numbers of one purpose, so that switching one source of noise off leaves the others as they were.

    Raises ParameterError for a negative seed.
    """
    check_range("the seed", seed, NOT_NEGATIVE)
    return np.random.default_rng([seed, *stream.encode()])


def frame(scene: Scene, seed: int) -> ScenePixels:
    """Place rock, texture and shadow. Raises ParameterError when no sunlit pixel is left in the short-wave field."""
    rock = _disk(scene.rock) if scene.rock is not None else np.zeros(SHAPE, dtype=bool)
    shadow = _shadow(scene, seed)
    if not (footprint_mask() & ~shadow).any():
        raise ParameterError("the shadow covers the whole short-wave field of view; take less of it or another seed")
    brightness = _texture(scene, seed)
    brightness[shadow] *= np.float32(scene.shadow_level)
    for array in (rock, shadow, brightness):
        array.setflags(write=False)
    return ScenePixels(rock, shadow, brightness)


def _disk(rock: SceneRock) -> BoolArray:
    lines, samples = np.ogrid[: SHAPE[0], : SHAPE[1]]
    inside: BoolArray = (lines - rock.center_line) ** 2 + (samples - rock.center_sample) ** 2 <= rock.radius_px**2
    return inside


def _texture(scene: Scene, seed: int) -> npt.NDArray[np.float32]:
    """A log-normal field of mean 1 and the scene's relative standard deviation."""
    if scene.texture == 0:
        return np.ones(SHAPE, dtype=np.float32)
    sigma = math.sqrt(math.log1p(scene.texture**2))
    field = _smooth_field(generator(seed, "texture"), scene.texture_scale_px)
    return np.exp(sigma * field - sigma**2 / 2).astype(np.float32)


def _shadow(scene: Scene, seed: int) -> BoolArray:
    """The pixels that lie deepest in shadow, as many as the scene asks for."""
    count = round(scene.shadow_fraction * SHAPE[0] * SHAPE[1])
    shadow = np.zeros(SHAPE, dtype=bool)
    if count:
        rng = generator(seed, "shadow")
        angle = rng.uniform(0, 2 * math.pi)
        depth = _half_plane(angle) if scene.shadow_shape == "half-plane" else _blobs(scene.rock, angle, rng)
        shadow.flat[np.argpartition(depth, -count, axis=None)[-count:]] = True
    return shadow


def _half_plane(angle: float) -> FloatArray:
    lines, samples = np.ogrid[: SHAPE[0], : SHAPE[1]]
    depth: FloatArray = math.cos(angle) * samples + math.sin(angle) * lines
    return depth


def _blobs(rock: SceneRock | None, angle: float, rng: np.random.Generator) -> FloatArray:
    """A smooth random field; deeper towards the rim of the rock that looks away from the sun."""
    field = _smooth_field(rng, BLOB_SCALE_PX)
    if rock is None:
        return field
    line = rock.center_line + rock.radius_px * math.sin(angle)
    sample = rock.center_sample + rock.radius_px * math.cos(angle)
    lines, samples = np.ogrid[: SHAPE[0], : SHAPE[1]]
    return field - 3 * np.hypot(lines - line, samples - sample) / max(rock.radius_px, BLOB_SCALE_PX)


def _smooth_field(rng: np.random.Generator, scale_px: float) -> FloatArray:
    """White noise under a Gaussian, brought to mean 0 and standard deviation 1."""
    white = np.fft.rfft2(rng.standard_normal(SHAPE))
    y, x = np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1])[None, :]
    field = np.fft.irfft2(white * np.exp(-2 * (math.pi * scale_px) ** 2 * (x**2 + y**2)), SHAPE)
    standard: FloatArray = (field - field.mean()) / field.std()
    return standard


@dataclass(frozen=True, slots=True)
class Instrument:
    """What the instrument does to the radiance.

    Attributes
    ----------
    noise : factor on all three kinds of noise below; 0 for an exact product. 0-5
    random : factor on the noise per channel and observation, `channels.random_noise`. 0-5
    pattern : factor on the noise per channel that observations share, `channels.fixed_pattern`. 0-5
    pattern_seed : of that pattern; None to draw another one with each seed.
    pixel : relative noise of each pixel of each image, independent; 0.02 is assumed. 0-0.1
    vnir_gain, swir_gain : factor on all channels of a detector; 0.1-10.
    sub_band_step : factor on the short-wave channels below the change of sub-band at 1377.5 nm; 0.1-10.

    Raises ParameterError outside these ranges.
    """

    noise: float = 1.0
    random: float = 1.0
    pattern: float = 1.0
    pattern_seed: int | None = None
    pixel: float = 0.02
    vnir_gain: float = 1.0
    swir_gain: float = 1.0
    sub_band_step: float = 1.0

    def __post_init__(self) -> None:
        names = {
            "[0, 5]": "noise random pattern",
            "[0, 0.1]": "pixel",
            "[0.1, 10]": "vnir_gain swir_gain sub_band_step",
        }
        check_ranges(self, names, "the instrument's")


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a perfect reduction finds.

    Attributes
    ----------
    wavelength_nm : the 390 channels of a spliced spectrum. [nm]
    reflectance : mean reflectance factor, at incidence 30, emission 0 and phase 30 deg, of what is lit within the
        short-wave field of view, texture included; shape (390,). [-]
    soil_reflectance, rock_reflectance : of smooth soil and rock (None where there is no rock). [-]
    composition : of what is lit within the field of view, by area.
    rock_fraction : share of rock in it, by area. [-]
    shadow_fraction : share of the field of view in shadow. [-]
    """

    wavelength_nm: FloatArray
    reflectance: FloatArray
    soil_reflectance: FloatArray
    rock_reflectance: FloatArray | None
    composition: SceneComposition
    rock_fraction: float
    shadow_fraction: float


@dataclass(frozen=True, slots=True, eq=False)
class SceneRadiance:
    """A scene as it shines, without noise.

    Attributes
    ----------
    scene, seed : what it was made from.
    frame : the scene in pixels.
    vnir : radiance of smooth sunlit soil and rock, shape (2, 100). [W m-2 sr-1 nm-1]
    swir : mean radiance over the short-wave field of view, shadows included; shape (300,). [W m-2 sr-1 nm-1]
    vnir_distance_au, swir_distance_au : from the Sun to the Moon in the middle of each scan. [au]
    truth : what a perfect reduction finds.
    """

    scene: Scene
    seed: int
    frame: ScenePixels
    vnir: FloatArray
    swir: FloatArray
    vnir_distance_au: float
    swir_distance_au: float
    truth: Truth


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """One synthetic observation.

    Attributes
    ----------
    source : the scene without noise, with its masks and the truth.
    instrument, seed : what was done to it.
    vnir : radiance of the image cube, shape (100, 256, 256), float32. [W m-2 sr-1 nm-1]
    swir : radiance of the short-wave channels, shape (300,). [W m-2 sr-1 nm-1]
    """

    source: SceneRadiance
    instrument: Instrument
    seed: int
    vnir: FloatCube
    swir: FloatArray

    @property
    def scene(self) -> Scene:
        """What was looked at."""
        return self.source.scene

    @property
    def truth(self) -> Truth:
        """What a perfect reduction finds."""
        return self.source.truth


def simulate(scene: Scene, instrument: Instrument | None = None, seed: int = 0) -> Simulation:
    """A scene as the instrument measures it; equal arguments give equal products.

    Raises ParameterError for a negative seed, or a shadow that leaves nothing lit in the short-wave field of view.
    """
    return draw(scene_radiance(scene, seed), instrument, seed)


def scene_radiance(scene: Scene, seed: int = 0) -> SceneRadiance:
    """A scene without noise; the seed places texture and shadows. Same errors as `simulate`."""
    pixels = frame(scene, seed)
    materials = [scene.soil, scene.rock.material if scene.rock is not None else scene.soil]
    vnir_distance, swir_distance = (sun_moon_distance_au(_middle(t)) for t in (scene.vnir_times(), scene.swir_times()))
    vnir = _material_radiance(scene, materials, VNIR_NM, "vnir", scene.geometry, vnir_distance)
    swir = _material_radiance(scene, materials, SWIR_NM, "swir", scene.swir_geometry(), swir_distance)
    seen = footprint_mask()
    shares = _shares(pixels, seen, int(seen.sum()))
    return SceneRadiance(
        scene, seed, pixels, vnir, shares @ swir, vnir_distance, swir_distance, _truth(scene, materials, pixels)
    )


def draw(source: SceneRadiance, instrument: Instrument | None = None, seed: int = 0) -> Simulation:
    """One realisation of the instrument's noise over a scene; the seed is that of the noise alone."""
    instrument = instrument or Instrument()
    vnir_gain = instrument.vnir_gain * _channel_gain(instrument, seed, VNIR_NM, "vnir")
    swir_gain = instrument.swir_gain * _channel_gain(instrument, seed, SWIR_NM, "swir")
    swir_gain = np.where(SWIR_NM < SUB_BAND_STEP_NM, instrument.sub_band_step * swir_gain, swir_gain)
    cube = _cube(source.frame, source.vnir * vnir_gain, instrument.noise * instrument.pixel, generator(seed, "pixels"))
    swir = source.swir * swir_gain
    for array in (cube, swir):
        array.setflags(write=False)
    return Simulation(source, instrument, seed, cube, swir)


def _material_radiance(
    scene: Scene,
    materials: list[Material],
    wavelength_nm: FloatArray,
    detector: Detector,
    geometry: Geometry,
    distance_au: float,
) -> FloatArray:
    """Radiance of each material, smooth and sunlit; shape (materials, channels). [W m-2 sr-1 nm-1]"""
    reflectance = np.array([surface_reflectance(wavelength_nm, material) for material in materials])
    if scene.disk is not None:
        phase = phase_function(scene.phase)
        reflectance = reflectance / correction_factor(geometry, wavelength_nm, scene.disk, phase)
    irradiance = in_band_irradiance(solar_spectrum(scene.solar), wavelength_nm, fwhm_nm(wavelength_nm, detector))
    cosine = math.cos(math.radians(geometry.incidence_deg))
    radiance: FloatArray = reflectance * irradiance * (cosine / (math.pi * distance_au**2))
    return radiance


def _truth(scene: Scene, materials: list[Material], pixels: ScenePixels) -> Truth:
    """What is lit within the short-wave field of view; `materials` are soil and rock."""
    seen = footprint_mask()
    lit = seen & ~pixels.shadow
    count = int(lit.sum())
    spectra = np.array([surface_reflectance(SPLICED_NM, material) for material in materials])
    rock_share = float((lit & pixels.rock).sum()) / count
    soil, rock = (material.composition.fractions for material in materials)
    mixed = {mineral: (1 - rock_share) * soil[mineral] + rock_share * rock[mineral] for mineral in soil}
    return Truth(
        wavelength_nm=SPLICED_NM,
        reflectance=_shares(pixels, lit, count) @ spectra,
        soil_reflectance=spectra[0],
        rock_reflectance=spectra[1] if scene.rock is not None else None,
        composition=SceneComposition(**mixed),
        rock_fraction=rock_share,
        shadow_fraction=float((seen & pixels.shadow).sum()) / int(seen.sum()),
    )


def _shares(pixels: ScenePixels, where: BoolArray, count: int) -> FloatArray:
    """Brightness of soil and of rock within a mask, over the number of its pixels; shape (2,)."""
    soil = pixels.brightness[where & ~pixels.rock].sum(dtype=np.float64)
    rock = pixels.brightness[where & pixels.rock].sum(dtype=np.float64)
    return np.array([soil, rock]) / count


def _channel_gain(instrument: Instrument, seed: int, wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Random factor of each channel: the noise of this observation times the pattern of the instrument."""
    pattern_seed = seed if instrument.pattern_seed is None else instrument.pattern_seed
    random = instrument.noise * instrument.random * random_noise(wavelength_nm, detector)
    pattern = instrument.noise * instrument.pattern * fixed_pattern(wavelength_nm, detector)
    drawn = generator(seed, f"random {detector}").standard_normal(wavelength_nm.size)
    shared = generator(pattern_seed, f"pattern {detector}").standard_normal(wavelength_nm.size)
    gain: FloatArray = (1 + random * drawn) * (1 + pattern * shared)
    return gain


def _cube(pixels: ScenePixels, radiance: FloatArray, noise: float, rng: np.random.Generator) -> FloatCube:
    """Images from brightness and the radiance of soil and rock; band by band, which stays in the processor's cache."""
    soil = np.where(pixels.rock, np.float32(0), pixels.brightness)
    rock = pixels.brightness - soil
    with_rock = bool(pixels.rock.any())
    cube = np.empty(CUBE_SHAPE, dtype=np.float32)
    work = np.empty(CUBE_SHAPE[1:], dtype=np.float32)
    for band, (of_soil, of_rock) in zip(cube, radiance.T.astype(np.float32), strict=True):
        np.multiply(soil, of_soil, out=band)
        if with_rock:
            np.multiply(rock, of_rock, out=work)
            band += work
        if noise:
            rng.standard_normal(out=work, dtype=np.float32)
            work *= np.float32(noise)
            work += np.float32(1)
            band *= work
    return cube


def _middle(times: tuple[datetime, ...]) -> datetime:
    return times[0] + (times[-1] - times[0]) / 2
