"""Spectra of RELAB and of the USGS library."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.readers.libraries import without_wavelength_files
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
    assert "has 3 rows of 3 numbers (truncated?)" in message


def test_a_cut_row_is_named(refuse: Refuse) -> None:
    assert "line 4 has 2 fields, the others 3" in refuse(THREE[: THREE.rindex(" ")], "a.tab")


def test_a_count_alone_is_truncated(refuse: Refuse) -> None:
    assert "begins with '401' and has 0 rows" in refuse("401\n", "a.asc")


def test_a_bad_number_is_named(refuse: Refuse) -> None:
    assert "line 3, column 'reflectance': '0.0x532'" in refuse(THREE.replace("0.07532", "0.0x532"), "a.asc")


def test_four_columns_are_refused(refuse: Refuse) -> None:
    assert "2 rows of 4 numbers" in refuse("2\n300 1 2 3\n400 1 2 3\n", "a.asc")


def test_a_table_with_names_in_a_tab_file_is_text(read: Read) -> None:
    (spectrum,) = read("Wavelength(micron)\tReflectance\tStd Dev\n0.3\t0.07\t0.001\n0.4\t0.08\t0.001\n", "a.tab")
    assert spectrum.metadata["format"] == "text"
    np.testing.assert_array_equal(spectrum.uncertainty, [0.001, 0.001])


def test_forcing_the_format_on_another_file_is_refused(refuse: Refuse) -> None:
    assert "begins with the number of its rows" in refuse("wavelength_nm,R\n400,.1\n", format="relab")


SPECTRUM = " splib07a Record=5932: Olivine GDS70.a Fo89          BECKb AREF\n"
BECK = " splib07a Record=21: Wavelengths BECK Beckman interval 4 ch\n  0.2\n  0.5\n  1.0\n  2.0\n"
ASD = " splib07a Record=23: Wavelengths ASD 0.35-2.5 microns 4 ch\n 0.35\n 0.6\n 1.2\n 2.5\n"


@pytest.fixture
def chapter(tmp_path: Path) -> Path:
    """A folder of minerals below that of the wavelengths, as the library comes."""
    (tmp_path / "splib07a_Wavelengths_BECK_Beckman_0.2-3.0_microns.txt").write_text(BECK)
    (tmp_path / "splib07a_Wavelengths_ASD_0.35-2.5_microns_2151_ch.txt").write_text(ASD)
    folder = tmp_path / "ChapterM_Minerals"
    folder.mkdir()
    return folder


def spectrum(folder: Path, text: str = SPECTRUM + " -1.2300000e+034\n 0.30\n 0.25\n 0.40\n") -> str:
    path = folder / "splib07a_Olivine_GDS70.a_Fo89_BECKb_AREF.txt"
    path.write_text(text)
    return str(path)


def refused(path: str) -> str:
    with pytest.raises(DataError) as error:
        read_spectra(path)
    message = str(error.value)
    assert message.startswith(path)
    assert "\n" not in message
    return message


def test_wavelengths_of_the_spectrometer_and_deleted_channels(chapter: Path) -> None:
    with pytest.warns(LunarSciWarning, match="deleted channels"):
        (one,) = read_spectra(spectrum(chapter))
    assert one.id == "splib07a_Olivine_GDS70.a_Fo89_BECKb_AREF"
    np.testing.assert_allclose(one.wavelength_nm, [200, 500, 1000, 2000])
    np.testing.assert_array_equal(one.reflectance, [np.nan, 0.30, 0.25, 0.40])
    assert (one.metadata["format"], one.metadata["title"][:7]) == ("splib", "Olivine")
    assert len(one.metadata["inputs"]) == 2


@pytest.mark.parametrize(("word", "last"), [("ASDFRb", 2500), ("BECKa", 2000)])
def test_the_word_in_the_title_decides(chapter: Path, word: str, last: float) -> None:
    (one,) = read_spectra(spectrum(chapter, SPECTRUM.replace("BECKb", word) + ".1\n.2\n.3\n.4\n"))
    assert one.wavelength_nm[-1] == pytest.approx(last)


def test_no_wavelength_file_names_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    message = refused(spectrum(tmp_path / "below"))
    assert "put splib07a_Wavelengths_*.txt of BECK with 4 values beside it or in the folder above" in message


def test_one_of_another_set_or_length_does_not_do(chapter: Path) -> None:
    assert "with 3 values" in refused(spectrum(chapter, SPECTRUM + ".1\n.2\n.3\n"))
    assert "splib07b_Wavelengths" in refused(spectrum(chapter, SPECTRUM.replace("07a", "07b") + ".1\n.2\n.3\n.4\n"))


def test_two_that_fit_are_not_chosen_between(chapter: Path) -> None:
    (chapter / "splib07a_Wavelengths_BECK_other.txt").write_text(BECK.replace("0.5", "0.6"))
    assert "would both fit" in refused(spectrum(chapter))


def test_the_same_wavelengths_twice_are_no_question(chapter: Path) -> None:
    (chapter / "splib07a_Wavelengths_BECK_copy.txt").write_text(BECK)
    assert len(read_spectra(spectrum(chapter, SPECTRUM + ".1\n.2\n.3\n.4\n"))) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SPECTRUM, "with values below (truncated?)"),
        (SPECTRUM + ".1\nbright\n.3\n.4\n", "line 3, column reflectance: 'bright' is not a number"),
        (SPECTRUM + ".1 .2\n", "is not a number"),
        (BECK, "not a spectrum"),
    ],
)
def test_files_that_are_no_spectra(chapter: Path, text: str, message: str) -> None:
    assert message in refused(spectrum(chapter, text))


def test_standard_input_has_no_folder() -> None:
    with pytest.raises(DataError, match="give the file's name"):
        read_spectra(InputFile("<stdin>", (SPECTRUM + ".1\n.2\n").encode()))


def test_a_stated_format_on_another_file() -> None:
    with pytest.raises(DataError, match="no 'splib07"):
        read_spectra(InputFile("a.txt", b"1 2\n3 4\n"), format="splib")


def test_wavelength_files_are_not_spectra_of_a_folder() -> None:
    names = ["f/splib07a_Bandpass_(FWHM)_BECK.txt", "f/splib07a_Wavelengths_BECK.txt", "f/splib07a_Augite_BECK.txt"]
    assert without_wavelength_files(names) == names[2:]
    assert without_wavelength_files(names[:1]) == names[:1]


def test_lists_of_json_with_errors_that_channels_share(read: Read) -> None:
    lists = '"reflectance": [0.1, null], "reflectance_sigma": [0.01, 0.02], "reflectance_systematic_gain": [0.03, 0.04]'
    (spectrum,) = read(f'{{"wavelength_nm": [400, 500], {lists}}}', "rock.json")
    np.testing.assert_array_equal(spectrum.usable, [True, False])
    np.testing.assert_array_equal(spectrum.uncertainty, [0.01, 0.02])
    assert spectrum.systematic["gain"][0] == 0.03
