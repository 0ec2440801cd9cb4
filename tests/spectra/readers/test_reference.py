"""Real measurements, where LUNARSCI_REFERENCE_DATA names the folder that holds them."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.spectra.readers.dispatch import read_spectra

FOLDER = os.environ.get("LUNARSCI_REFERENCE_DATA", "")

pytestmark = [
    pytest.mark.reference,
    pytest.mark.skipif(not FOLDER, reason="LUNARSCI_REFERENCE_DATA does not name the folder of measured data"),
]


def path(name: str) -> str:
    return str(Path(FOLDER) / "spectra" / name)


@pytest.mark.parametrize(
    ("name", "count", "channels", "first", "last"),
    [
        ("relab/reflectance.csv", 172, 401, "PE-CMP-030", "DL-CMP-091-A"),
        ("ce4/reflectance_factor.csv", 88, 390, "ce4-001-regolith", "ce4-195-regolith"),
        ("lunar/m3_aristarchus_sample.csv", 6, 83, "median_50x50", "r45_c45"),
    ],
)
def test_tables_of_many_spectra(name: str, count: int, channels: int, first: str, last: str) -> None:
    spectra = read_spectra(path(name))
    assert (len(spectra), spectra[0].id, spectra[-1].id) == (count, first, last)
    assert all(s.wavelength_nm.size == channels and s.usable.all() for s in spectra)


@pytest.mark.parametrize(
    "name", ["relab/reflectance.csv", "ce4/reflectance_factor.csv", "usgs/splib07_aviris95_wide.csv"]
)
def test_values_are_those_that_numpy_reads(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        spectra = read_spectra(path(name))
    raw = np.genfromtxt(path(name), delimiter=",", skip_header=1)
    header = Path(path(name)).read_text("utf-8").splitlines()[0].split(",")
    for spectrum in spectra:
        np.testing.assert_array_equal(spectrum.wavelength_nm, raw[:, 0])
        np.testing.assert_array_equal(spectrum.reflectance, raw[:, header.index(spectrum.id)])


def test_usgs_leaves_the_widths_out() -> None:
    with pytest.warns(LunarSciWarning, match="left out 'fwhm_nm'"):
        spectra = read_spectra(path("usgs/splib07_aviris95_wide.csv"))
    assert len(spectra) == 44
    # 'um' at the end of an id is a grain size, not a unit of wavelength.
    assert spectra[0].id == "Anorthite_GDS28_Syn_74um"


def test_apollo_average_has_two_spectra_with_their_deviations() -> None:
    reflectance, scaled = read_spectra(path("lunar/apollo16_62231_relab_avg.csv"))
    assert (reflectance.id, scaled.id) == ("reflectance", "scaled")
    assert reflectance.uncertainty is not None
    assert scaled.uncertainty is not None
    assert (reflectance.uncertainty[0], scaled.uncertainty[0]) == (0.0037666, 0.0080461)


def test_apollo_row_without_a_wavelength_is_left_out() -> None:
    with (
        pytest.warns(LunarSciWarning, match="1 of 206, first line 2"),
        # One deviation is written 0.00000.
        pytest.warns(LunarSciWarning, match="masked: 1$"),
    ):
        (spectrum,) = read_spectra(path("lunar/apollo16_62231_42_bmr1ls101_sub8.csv"))
    assert spectrum.wavelength_nm[[0, -1]].tolist() == [1429.6, 2599.2]
    assert spectrum.uncertainty is not None


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("lunar/m3_solar_spec.csv", "no reflectance column beside 'solar_irradiance"),
        ("relab/manifest.csv", "'id'.*not a number"),
    ],
)
def test_tables_that_are_not_reflectance_are_refused(name: str, reason: str) -> None:
    with pytest.raises(DataError, match=reason):
        read_spectra(path(name))
