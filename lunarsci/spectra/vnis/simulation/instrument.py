"""Synthetic observations: what VNIS would have measured of a made-up scene. Never a measurement, and named so.

Two steps: `scene_radiance` is the scene without noise, `draw` adds one realisation of the instrument; `simulate` is
both. Radiance L = REFF · E0 · cos i / (π d²), with E0 averaged over the response of each channel and with incidence,
time and distance of each product (Hapke 2012, Theory of Reflectance and Emittance Spectroscopy, ch. 10).
"""

import math
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.spectra.photometry import Geometry, correction_factor, phase_function
from lunarsci.spectra.solar import in_band_irradiance, solar_spectrum
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.sun import sun_moon_distance_au
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
from lunarsci.spectra.vnis.simulation.frame import Frame, frame, generator
from lunarsci.spectra.vnis.simulation.scene import Composition, Material, Scene, surface_reflectance

__all__ = ["Instrument", "SceneRadiance", "Simulation", "Truth", "draw", "scene_radiance", "simulate"]

FloatCube = npt.NDArray[np.float32]


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
        limits = {"pixel": (0.0, 0.1), "vnir_gain": (0.1, 10.0), "swir_gain": (0.1, 10.0), "sub_band_step": (0.1, 10.0)}
        for name in ("noise", "random", "pattern", *limits):
            low, high = limits.get(name, (0.0, 5.0))
            value = getattr(self, name)
            if not low <= value <= high:
                raise ParameterError(f"the instrument's {name} is {value:g}; give one from {low:g} to {high:g}")


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
    composition: Composition
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
    frame: Frame
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


def _truth(scene: Scene, materials: list[Material], pixels: Frame) -> Truth:
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
        composition=Composition(**mixed),
        rock_fraction=rock_share,
        shadow_fraction=float((seen & pixels.shadow).sum()) / int(seen.sum()),
    )


def _shares(pixels: Frame, where: npt.NDArray[np.bool_], count: int) -> FloatArray:
    """Brightness of soil and of rock within a mask, over the number of its pixels; shape (2,)."""
    soil = pixels.brightness[where & ~pixels.rock].sum(dtype=np.float64)
    rock = pixels.brightness[where & pixels.rock].sum(dtype=np.float64)
    return np.array([soil, rock]) / count


def _channel_gain(instrument: Instrument, seed: int, wavelength_nm: FloatArray, detector: Detector) -> FloatArray:
    """Random factor of each channel: the noise of this observation times the pattern of the instrument."""
    pattern_seed = seed if instrument.pattern_seed is None else instrument.pattern_seed
    random = instrument.noise * instrument.random * random_noise(wavelength_nm, detector)
    pattern = instrument.noise * instrument.pattern * fixed_pattern(wavelength_nm, detector)
    own = generator(seed, f"random {detector}").standard_normal(wavelength_nm.size)
    shared = generator(pattern_seed, f"pattern {detector}").standard_normal(wavelength_nm.size)
    gain: FloatArray = (1 + random * own) * (1 + pattern * shared)
    return gain


def _cube(pixels: Frame, radiance: FloatArray, noise: float, rng: np.random.Generator) -> FloatCube:
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
