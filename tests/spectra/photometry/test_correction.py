"""Correction factors worked by hand, and the spread between models against a direct eigendecomposition."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsci.errors import ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.photometry import (
    DISKS,
    PHASE_FUNCTIONS,
    STANDARD,
    Geometry,
    correction_factor,
    model_spread,
    phase_function,
    read_phase_function,
    remarks,
)

GRID = np.arange(450.0, 2396.0, 5.0)
SEEN = Geometry(60, 45, 90)
SELENE = ("sp-low", "sp-mid", "sp-high")
# f(90)/f(30) = exp(-0.3848) of the channel at 1499.8 nm of the middle group (B0 0.742, h 0.0657, c -0.251, G 0.185):
#   tan 45 = 1       : 1 + 0.742 / (1 + 15.2207) = 1.04574; lobes 0.965775 / 1.034225^1.5 = 0.918234
#   tan 15 = 0.267949: 1 + 0.742 / (1 + 4.07837) = 1.14611; lobes 0.965775 / 0.713796^1.5 = 1.601457
#                      and 0.965775 / 1.354654^1.5 = 0.612538, 0.6255 of the first and 0.3745 of the second = 1.231107
ONE_CHANNEL = 1.14611 * 1.231107 / (1.04574 * 0.918234)


@pytest.mark.parametrize("disk", DISKS)
@pytest.mark.parametrize("phase", PHASE_FUNCTIONS)
def test_the_standard_geometry_is_left_as_it_is(disk: str, phase: str) -> None:
    assert correction_factor(STANDARD, GRID, disk, phase_function(phase)) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    ("disk", "level", "published"),
    [
        ("lommel-seeliger", (0.5 + 0.707107) / (0.866025 + 1), 0.951),
        ("akimov", 0.5 / 0.866025 * 0.918650 / 0.707107, 1.102),
        ("mcewen", 0.5 / 0.866025 * 0.903853 / 0.561041, 1.367),
    ],
)
def test_factors_at_60_45_90_and_1500_nm_by_hand(disk: str, level: float, published: float) -> None:
    [flat] = correction_factor(SEEN, np.array([1500.0]), disk, phase_function("flat"))
    assert flat == pytest.approx(level, rel=1e-5)
    one = read_phase_function(InputFile("one.csv", f"phase_deg,f\n30,{ONE_CHANNEL:.6f}\n90,1\n".encode()))
    [exact] = correction_factor(SEEN, np.array([1500.0]), disk, one)
    assert exact == pytest.approx(published, abs=1e-3)
    [smoothed] = correction_factor(SEEN, np.array([1500.0]), disk, phase_function("sp-mid"))
    assert smoothed == pytest.approx(published, rel=0.012), "the channel lies 1.1 % off its neighbours' parabola"


def test_lommel_seeliger_for_reff_has_no_ratio_of_cosines_of_incidence() -> None:
    geometry = Geometry(75, 20, 80)
    expected = (math.cos(math.radians(75)) + math.cos(math.radians(20))) / (math.cos(math.radians(30)) + 1)
    assert correction_factor(geometry, GRID, "lommel-seeliger", phase_function("flat")) == pytest.approx(expected)


def test_a_lambertian_surface_is_left_as_it_is_where_mcewen_is_lambert() -> None:
    # REFF of Lambert's law is the same everywhere; above 104 deg McEwen's D is cos i, and at the standard 0.90385
    factor = correction_factor(Geometry(70, 45, 110), GRID, "mcewen", phase_function("flat"))
    assert factor == pytest.approx(0.903853 / 0.866025, rel=1e-5)


@pytest.mark.parametrize("disk", DISKS)
@settings(max_examples=40)
@given(
    incidence=st.floats(0, 85),
    emission=st.floats(0, 85),
    azimuth=st.floats(0, 180),
    phase=st.sampled_from(PHASE_FUNCTIONS),
)
def test_factors_are_positive_and_finite(
    disk: str, incidence: float, emission: float, azimuth: float, phase: str
) -> None:
    i, e = math.radians(incidence), math.radians(emission)
    cosine = math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(math.radians(azimuth))
    geometry = Geometry(incidence, emission, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))))
    factor = correction_factor(geometry, GRID[::30], disk, phase_function(phase))
    assert np.all(np.isfinite(factor)) and np.all(factor > 0)


def test_where_a_disk_function_vanishes_nothing_is_corrected() -> None:
    with pytest.raises(ParameterError, match=r"akimov vanishes at incidence 89\.995"):
        correction_factor(Geometry(89.995, 89.995, 179.5), GRID, "akimov", phase_function("flat"))


def test_unknown_disk() -> None:
    with pytest.raises(ParameterError, match="choose one of"):
        correction_factor(SEEN, GRID, "lambert", phase_function("flat"))


def test_remarks_join_disk_and_phase() -> None:
    grazing = Geometry(70, 45, 100)
    found = remarks(grazing, GRID, "lommel-seeliger", phase_function("sp-mid"))
    assert len(found) == 2
    assert "Lommel-Seeliger" in found[0]
    assert "sp-mid" in found[1] and "extrapolates" in found[1]
    assert remarks(Geometry(60, 45, 80), np.array([750.0]), "akimov", phase_function("sp-mid")) == []


def directly(geometry: Geometry, wavelength_nm: np.ndarray, disk: str, phase: str) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the nine models about the one used, and its leading modes by eigh."""
    used = correction_factor(geometry, wavelength_nm, disk, phase_function(phase))
    total = np.zeros((wavelength_nm.size, wavelength_nm.size))
    for other_disk in ("lommel-seeliger", "akimov", "mcewen"):
        for other_phase in SELENE:
            other = correction_factor(geometry, wavelength_nm, other_disk, phase_function(other_phase))
            total += np.outer(np.log(other / used), np.log(other / used)) / 9
    values, vectors = np.linalg.eigh(total)
    return total, (vectors * np.sqrt(np.maximum(values, 0)))[:, ::-1][:, :2].T


@pytest.mark.parametrize(("disk", "phase"), [("lommel-seeliger", "sp-mid"), ("akimov", "sp-high"), ("mcewen", "flat")])
@pytest.mark.parametrize("geometry", [SEEN, Geometry(64.4, 45.6, 54.5), Geometry(35, 10, 40)])
def test_modes_are_the_leading_eigenvectors(geometry: Geometry, disk: str, phase: str) -> None:
    wavelength = GRID[::20]
    total, expected = directly(geometry, wavelength, disk, phase)
    modes = model_spread(geometry, wavelength, disk, phase_function(phase))
    assert modes.shape == expected.shape
    for mode, other in zip(modes, expected, strict=True):
        assert mode == pytest.approx(other * np.sign(other @ mode), abs=1e-9)
        assert mode[np.argmax(np.abs(mode))] > 0
    assert np.sum(modes**2) > 0.99 * np.trace(total)


def test_the_spread_at_60_45_90_is_a_quarter_in_level_and_two_percent_in_colour() -> None:
    level, colour = model_spread(SEEN, GRID, "lommel-seeliger", phase_function("sp-mid"))
    assert np.all((level > 0.21) & (level < 0.26))
    assert 0.015 < np.abs(colour).max() < 0.03
    assert colour.min() < 0 < colour.max()


def test_at_one_wavelength_the_spread_is_the_rms_distance() -> None:
    wavelength = np.array([1500.0])
    [used] = correction_factor(SEEN, wavelength, "lommel-seeliger", phase_function("sp-mid"))
    squares = [
        math.log(correction_factor(SEEN, wavelength, disk, phase_function(name))[0] / used) ** 2
        for disk in DISKS
        for name in SELENE
    ]
    [[mode]] = model_spread(SEEN, wavelength, "lommel-seeliger", phase_function("sp-mid"))
    assert mode == pytest.approx(math.sqrt(sum(squares) / 9))


def test_models_agree_at_the_standard_geometry() -> None:
    assert model_spread(STANDARD, GRID, "mcewen", phase_function("sp-low")).shape == (0, 390)


def test_spread_does_not_depend_on_the_sampling() -> None:
    fine = model_spread(SEEN, GRID, "akimov", phase_function("sp-mid"))
    coarse = model_spread(SEEN, GRID[::2], "akimov", phase_function("sp-mid"))
    assert fine[:, ::2] == pytest.approx(coarse, abs=2e-3)
