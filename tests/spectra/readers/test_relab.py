"""RELAB files: a count, then rows."""

from collections.abc import Callable

import numpy as np
import pytest

from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]

THREE = "      3\n   300.00   0.07254  0.00377\n   305.00   0.07532  0.00342\n   310.00   0.07650  0.00313\n"


@pytest.mark.parametrize("name", ["c1lr01.asc", "C1LR01.TAB", "c1lr01.txt"])
def test_count_and_three_columns(read: Read, name: str) -> None:
    (spectrum,) = read(THREE, name, wavelength_unit="nm")
    assert (spectrum.id, spectrum.metadata["format"]) == (name[:6], "relab")
    np.testing.assert_array_equal(spectrum.wavelength_nm, [300, 305, 310])
    np.testing.assert_array_equal(spectrum.reflectance, [0.07254, 0.07532, 0.0765])
    np.testing.assert_array_equal(spectrum.uncertainty, [0.00377, 0.00342, 0.00313])


def test_two_columns_have_no_uncertainty(read: Read) -> None:
    (spectrum,) = read("2\r\n0.3 0.07\r\n0.4 0.08\r\n\x1a", "a.asc", wavelength_unit="um")
    assert spectrum.uncertainty is None
    np.testing.assert_allclose(spectrum.wavelength_nm, [300, 400])


def test_zero_deviations_mean_unknown_without_a_word(read: Read) -> None:
    (spectrum,) = read("2\n300 0.07 0.0\n400 0.08 0.0\n", "a.asc", wavelength_unit="nm")
    assert spectrum.uncertainty is None
    assert spectrum.usable.all()


@pytest.mark.parametrize("count", ["4", "2", "0", "9" * 30])
def test_a_count_that_lies_is_refused(refuse: Refuse, count: str) -> None:
    message = refuse(THREE.replace("3", count, 1), "a.tab")
    assert "3 rows follow (truncated download?)" in message


def test_a_cut_row_is_named(refuse: Refuse) -> None:
    assert "line 4 has 2 fields, the others 3" in refuse(THREE[: THREE.rindex(" ")], "a.tab")


def test_a_count_alone_is_truncated(refuse: Refuse) -> None:
    assert "announces 401 channels and 0 rows" in refuse("401\n", "a.asc")


def test_a_bad_number_is_named(refuse: Refuse) -> None:
    assert "line 3, column 'reflectance': '0.0x532'" in refuse(THREE.replace("0.07532", "0.0x532"), "a.asc")


def test_four_columns_are_refused(refuse: Refuse) -> None:
    assert "4 columns" in refuse("2\n300 1 2 3\n400 1 2 3\n", "a.asc")


def test_a_table_with_names_in_a_tab_file_is_text(read: Read) -> None:
    (spectrum,) = read("Wavelength(micron)\tReflectance\tStd Dev\n0.3\t0.07\t0.001\n0.4\t0.08\t0.001\n", "a.tab")
    assert spectrum.metadata["format"] == "text"
    np.testing.assert_array_equal(spectrum.uncertainty, [0.001, 0.001])


def test_forcing_the_format_on_another_file_is_refused(refuse: Refuse) -> None:
    assert "not the number of channels" in refuse("wavelength_nm,R\n400,.1\n", format="relab")
