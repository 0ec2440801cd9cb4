"""Channels of VNIS, and whether they are where they should be."""

import csv
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.solar import solar_spectrum
from lunarsci.spectra.vnis.channels import (
    CUBE_SHAPE,
    JOIN_NM,
    SPLICED_NM,
    SWIR_NM,
    VNIR_NM,
    Detector,
    displaced_channels,
    equal_frames,
    fixed_pattern,
    footprint_mask,
    fwhm_nm,
    random_noise,
    repeated_rows,
    scale_step,
)
from lunarsci.spectra.vnis.detector import irradiance_at, outlying


def published(folder: Path, name: str) -> dict[str, np.ndarray]:
    with (folder / "vnis" / name).open() as file:
        rows = list(csv.DictReader(file))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


def test_channels_are_those_of_the_instrument() -> None:
    assert (VNIR_NM[0], VNIR_NM[-1], VNIR_NM.size) == (450, 945, 100)
    assert (SWIR_NM[0], SWIR_NM[-1], SWIR_NM.size) == (900, 2395, 300)
    assert (SPLICED_NM[0], SPLICED_NM[-1], SPLICED_NM.size) == (450, 2395, 390)
    assert CUBE_SHAPE == (100, 256, 256)
    for grid in (VNIR_NM, SWIR_NM, SPLICED_NM):
        assert (np.diff(grid) == 5).all()


def test_widths_worked_by_hand() -> None:
    """-3.259 0.45^2 + 22.187 0.45 - 6.909 = -0.65995 + 9.98415 - 6.909 = 2.4152 nm, and so on."""
    assert fwhm_nm(np.array([450.0]), "vnir")[0] == pytest.approx(2.4152, abs=1e-4)
    # 13.688 0.9^2 - 10.334 0.9 + 3.872 = 11.08728 - 9.3006 + 3.872
    assert fwhm_nm(np.array([900.0]), "vnir")[0] == pytest.approx(5.65868, abs=1e-5)
    # The response jumps from about 8.4 to 3.9 nm where the sub-band changes.
    before, after = fwhm_nm(np.array([1375.0, 1380.0]), "swir")
    assert before > 2 * after - 1


@pytest.mark.reference
@pytest.mark.parametrize(("low", "high"), [(450, 630), (635, 945)])
def test_widths_of_vnir_are_the_published_ones(reference_data: Path, low: float, high: float) -> None:
    table = published(reference_data, "vnis_cmos_wl_fwhm_solar.csv")
    inside = (table["wavelength_nm"] >= low) & (table["wavelength_nm"] <= high)
    assert inside.sum() == (high - low) / 5 + 1
    assert fwhm_nm(table["wavelength_nm"][inside], "vnir") == pytest.approx(table["fwhm_nm"][inside], abs=1e-3)


@pytest.mark.reference
@pytest.mark.parametrize(("low", "high", "rms_nm", "worst_nm"), [(900, 1375, 0.05, 0.13), (1380, 2395, 0.135, 0.35)])
def test_widths_of_swir_are_near_the_published_ones(
    reference_data: Path, low: float, high: float, rms_nm: float, worst_nm: float
) -> None:
    """Third-order polynomials go through them, the quadratics beside them."""
    table = published(reference_data, "vnis_swir_wl_fwhm_solar.csv")
    inside = (table["wavelength_nm"] >= low) & (table["wavelength_nm"] <= high)
    assert inside.sum() == (high - low) / 5 + 1
    apart = fwhm_nm(table["wavelength_nm"][inside], "swir") - table["fwhm_nm"][inside]
    assert np.sqrt(np.mean(apart**2)) < rms_nm
    assert np.abs(apart).max() < worst_nm
    assert abs(apart.mean()) < 0.01


@pytest.mark.parametrize("function", [fwhm_nm, random_noise, fixed_pattern])
@pytest.mark.parametrize(
    ("wavelength", "detector", "message"),
    [
        (445.0, "vnir", "VNIR detector has channels from 450 to 945 nm only"),
        (950.0, "vnir", "VNIR detector has channels from 450 to 945 nm only"),
        (895.0, "swir", "SWIR detector has channels from 900 to 2395 nm only"),
        (2400.0, "swir", "SWIR detector has channels from 900 to 2395 nm only"),
        (np.nan, "swir", "SWIR detector"),
    ],
)
def test_wavelengths_of_no_channel_are_refused(function, wavelength: float, detector: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        function(np.array([700.0 if detector == "vnir" else 1500.0, wavelength]), detector)


@pytest.mark.parametrize("function", [fwhm_nm, random_noise, fixed_pattern])
def test_every_channel_has_a_figure_above_0_in_the_shape_given(function) -> None:
    for grid, detector in ((VNIR_NM, "vnir"), (SWIR_NM, "swir")):
        values = function(grid, detector)
        assert values.shape == grid.shape
        assert (values > 0).all()
        assert values[::-1] == pytest.approx(function(grid[::-1], detector))


def test_noise_is_that_of_the_spectra_it_was_measured_on() -> None:
    """Some of the figures measured on Chang'E-4 spectra, in per cent, one of each range."""
    at = np.array([450.0, 560.0, 650.0, 800.0])
    assert 100 * random_noise(at, "vnir") == pytest.approx([2.32, 1.61, 1.24, 1.02])
    at = np.array([1000.0, 1200.0, 1500.0, 1900.0, 2100.0, 2300.0])
    assert 100 * random_noise(at, "swir") == pytest.approx([0.80, 0.61, 0.46, 0.63, 0.97, 0.81])
    assert 100 * fixed_pattern(at, "swir") == pytest.approx([0.31, 0.44, 0.59, 0.76, 0.79, 0.83])


def test_the_footprint_is_a_disk_of_9085_pixels() -> None:
    mask = footprint_mask()
    assert mask.shape == (256, 256)
    assert mask.dtype == bool
    assert mask.sum() == 9085 == sum((x - 97) ** 2 + (y - 127) ** 2 <= 53.8**2 for y in range(256) for x in range(256))
    lines, samples = np.nonzero(mask)
    assert (lines.mean(), samples.mean()) == pytest.approx((127, 97))


def test_a_changed_mask_does_not_change_the_next_one() -> None:
    footprint_mask()[:] = False
    assert footprint_mask().sum() == 9085


@pytest.mark.reference
def test_the_footprint_is_the_published_one(reference_data: Path) -> None:
    rows = published(reference_data, "vnis_swir_footprint_rows.csv")
    drawn = np.zeros((256, 256), dtype=bool)
    columns = (rows["line_index0"], rows["sample_first0"], rows["sample_last0"])
    for line, first, last in zip(*(column.astype(int) for column in columns), strict=True):
        drawn[line, first : last + 1] = True
    assert np.array_equal(footprint_mask(), drawn)


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
