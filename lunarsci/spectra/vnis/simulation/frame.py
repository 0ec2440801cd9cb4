"""A scene in pixels: where the rock lies, where it is dark, how bright each pixel is. All of it made up from a seed."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.spectra.spectrum import BoolArray, FloatArray
from lunarsci.spectra.vnis.channels import CUBE_SHAPE, footprint_mask
from lunarsci.spectra.vnis.simulation.scene import Rock, Scene

__all__ = ["Frame", "frame", "generator"]

SHAPE = CUBE_SHAPE[1:]
BLOB_SCALE_PX = 24.0


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
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
    if seed < 0:
        raise ParameterError(f"the seed is {seed}; give a whole number from 0")
    return np.random.default_rng([seed, *stream.encode()])


def frame(scene: Scene, seed: int) -> Frame:
    """Place rock, texture and shadow. Raises ParameterError when no sunlit pixel is left in the short-wave field."""
    rock = _disk(scene.rock) if scene.rock is not None else np.zeros(SHAPE, dtype=bool)
    shadow = _shadow(scene, seed)
    if not (footprint_mask() & ~shadow).any():
        raise ParameterError("the shadow covers the whole short-wave field of view; take less of it or another seed")
    brightness = _texture(scene, seed)
    brightness[shadow] *= np.float32(scene.shadow_level)
    for array in (rock, shadow, brightness):
        array.setflags(write=False)
    return Frame(rock, shadow, brightness)


def _disk(rock: Rock) -> BoolArray:
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


def _blobs(rock: Rock | None, angle: float, rng: np.random.Generator) -> FloatArray:
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
