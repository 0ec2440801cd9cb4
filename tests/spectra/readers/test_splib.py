"""USGS splib07 ASCII files: a spectrum finds the wavelengths of its set, or says what is missing."""

from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.readers.libraries import without_wavelength_files

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
        (SPECTRUM, "a header and no values"),
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
    with pytest.raises(DataError, match="not with 'splib07"):
        read_spectra(InputFile("a.txt", b"1 2\n3 4\n"), format="splib")


def test_wavelength_files_are_not_spectra_of_a_folder() -> None:
    names = ["f/splib07a_Bandpass_(FWHM)_BECK.txt", "f/splib07a_Wavelengths_BECK.txt", "f/splib07a_Augite_BECK.txt"]
    assert without_wavelength_files(names) == names[2:]
    assert without_wavelength_files(names[:1]) == names[:1]
