"""Channels that are shifted, repeated or of another scale: found in real spectra that were spoilt, and in none else."""

import csv
from pathlib import Path

import numpy as np
import pytest

from lunarsci.spectra.solar import solar_spectrum
from lunarsci.spectra.vnis.channels import (
    JOIN_NM,
    SPLICED_NM,
    Detector,
    displaced_channels,
    equal_frames,
    repeated_rows,
    scale_step,
)
from lunarsci.spectra.vnis.detector import irradiance_at, outlying

PARTS: tuple[tuple[Detector, slice], ...] = (("vnir", slice(0, 90)), ("swir", slice(90, None)))


def table(path: Path) -> np.ndarray:
    with path.open() as file:
        return np.array([[float(cell) for cell in row] for row in list(csv.reader(file))[1:]])


@pytest.fixture(scope="module")
def real(reference_data: Path) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Reflectance factor (88, channels), radiance but for a factor, irradiance of the standard; by detector."""
    spectra = table(reference_data / "spectra/ce4/reflectance_factor.csv")
    found = {}
    for (detector, part), name in zip(PARTS, ("cmos", "swir"), strict=True):
        reflectance = spectra[part, 1:].T
        stated = table(reference_data / f"vnis/vnis_{name}_wl_fwhm_solar.csv")[: reflectance.shape[1], 2]
        expected = irradiance_at(detector, solar_spectrum("e490"))[: reflectance.shape[1]]
        found[detector] = (reflectance, reflectance * stated, expected)
    return found


def wavelengths(detector: Detector) -> np.ndarray:
    return SPLICED_NM[SPLICED_NM < JOIN_NM] if detector == "vnir" else SPLICED_NM[SPLICED_NM >= JOIN_NM]


@pytest.mark.reference
@pytest.mark.parametrize("detector", ["vnir", "swir"])
def test_no_real_spectrum_is_doubted(real: dict[str, tuple[np.ndarray, ...]], detector: Detector) -> None:
    reflectance, radiance, irradiance = real[detector]
    assert len(reflectance) == 88
    assert [displaced_channels(row, irradiance) for row in radiance] == [0] * 88
    assert [scale_step(detector, wavelengths(detector), row) for row in reflectance] == [(0.0, 0.0)] * 88
    assert not any(outlying(detector, row).any() for row in reflectance)


@pytest.mark.reference
@pytest.mark.parametrize(("detector", "least"), [("vnir", 85), ("swir", 77)])
@pytest.mark.parametrize("by", [-1, 1])
def test_shifted_channels_show_in_the_lines_of_the_sun(
    real: dict[str, tuple[np.ndarray, ...]], detector: Detector, least: int, by: int
) -> None:
    _, radiance, irradiance = real[detector]
    found = np.array([displaced_channels(np.roll(row, by), irradiance) for row in radiance])
    assert (found == by).sum() >= least
    assert set(found.tolist()) <= {0, by, 2 * by}


@pytest.mark.reference
@pytest.mark.parametrize(
    ("detector", "factor", "least", "most"),
    [("swir", 1.15, 1.0, 1.0), ("swir", 1.1, 0.99, 1.0), ("vnir", 1.15, 0.25, 0.4), ("vnir", 1.3, 0.8, 1.0)],
)
def test_blocks_of_another_scale(
    real: dict[str, tuple[np.ndarray, ...]], detector: Detector, factor: float, least: float, most: float
) -> None:
    """15 channels anywhere; in the imager a block of 15 % is within what real spectra do."""
    reflectance = real[detector][0]
    random, found = np.random.default_rng(0), []
    for row in reflectance:
        for _ in range(3):
            spoilt, at = row.copy(), random.integers(10, row.size - 26)
            spoilt[at : at + 15] *= factor
            found.append(scale_step(detector, wavelengths(detector), spoilt)[0] != 0)
    assert least <= np.mean(found) <= most


def test_noise_alone_has_no_lines() -> None:
    irradiance = irradiance_at("vnir", solar_spectrum("e490"))
    random = np.random.default_rng(1)
    found = [
        displaced_channels(irradiance * np.exp(0.08 * random.standard_normal(100)), irradiance) for _ in range(200)
    ]
    assert np.count_nonzero(found) <= 2


def test_equal_frames_are_found_and_frames_of_one_value_are_not() -> None:
    cube = np.random.default_rng(0).random((6, 256, 256)).astype(np.float32)
    assert equal_frames(cube) is None
    cube[1] = cube[4] = 0.5
    cube[2] = np.nan
    assert equal_frames(cube) is None
    cube[5] = cube[3]
    assert equal_frames(cube) == (3, 5)
    cube[5, 7, 9] += 1  # not among the pixels that are looked at first
    assert equal_frames(cube) is None


def test_repeated_rows() -> None:
    values = np.random.default_rng(0).random(300) + 0.1
    assert repeated_rows(values) is None
    values[120:123] = values[40:43]
    assert repeated_rows(values) == (40, 120)
    values[120:140] = values[200:240] = 0.5  # a plateau: saturation, which is told by another rule
    assert repeated_rows(values) is None
