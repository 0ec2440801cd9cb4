"""Which reader a file needs, hostile files, and rules that hold for every format."""

import hashlib
import io
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]
GOOD = "wavelength_nm,reflectance\n400,0.1\n500,0.2\n"


def test_a_path_is_read(tmp_path: Path) -> None:
    path = tmp_path / "yutu.csv"
    path.write_text(GOOD)
    assert read_spectra(str(path))[0].id == "yutu"


def test_a_missing_path_is_one_line() -> None:
    with pytest.raises(DataError, match=r"^nowhere\.csv: no such file"):
        read_spectra("nowhere.csv")


def test_standard_input_has_an_id(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(GOOD.encode())))
    (spectrum,) = read_spectra("-")
    assert (spectrum.id, spectrum.metadata["source"]) == ("stdin", "<stdin>")


def test_a_stated_format_is_taken(read: Read) -> None:
    # A count alone on the first line means RELAB, unless it is said to be text.
    content = "400\n500\n"
    with pytest.raises(DataError, match="one column"):
        read(content, "a.asc", format="text")


def zipped() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("a.csv", GOOD)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (zipped(), "compressed .zip."),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "HDF5"),
        (b"%PDF-1.7\n", "PDF"),
        (b"\x7fELF\x02\x01\x01" + bytes(60), "binary file"),
        (b"<!DOCTYPE html>\n<html><head><title>404 Not Found</title></head></html>", "HTML or XML page"),
        (b"\r\n <?xml version='1.0'?><Product_Observational/>", "neither a table nor an image"),
        (b'{"wavelength_nm": [400, 500]}', "JSON"),
        (b"\n\n  \n", "only blanks"),
        (b"404: Not Found", "no data rows"),
        (b"wavelength_nm,reflectance\n" + b"9" * 5_000_000 + b",1\n", "cannot be split into fields"),
        (b"wavelength_nm,reflectance\n400," + b"x" * 100_000 + b"\n", "is not a number"),
        (b"7," * 50_000 + b"\n", "no unit and the values do not tell"),
        (b"x" * 100_000 + b",y\n400,a\n", "is not a number"),
    ],
)
def test_hostile_files_are_refused_in_one_short_line(refuse: Refuse, data: bytes, reason: str) -> None:
    assert re.search(reason, refuse(data))


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@settings(max_examples=300)
@given(
    st.one_of(
        st.binary(min_size=1, max_size=200), st.text('0123456789.,;-#eEnm\t \nwavelngth"', min_size=1).map(str.encode)
    )
)
def test_noise_is_read_or_refused_but_never_breaks(data: bytes) -> None:
    try:
        read_spectra(InputFile("noise", data))
    except DataError as error:
        assert str(error).startswith("noise: ")
        assert "\n" not in str(error)


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize("length", range(1, len(GOOD)))
def test_a_table_cut_anywhere_is_read_or_refused(length: int) -> None:
    try:
        read_spectra(InputFile("cut", GOOD[:length].encode()))
    except DataError as error:
        assert "\n" not in str(error)


def test_reading_text_imports_no_astropy(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(GOOD)
    program = "import sys; from lunarsci.spectra.readers import read_spectra; read_spectra(sys.argv[1]); "
    program += "sys.exit(any(m.split('.')[0] in ('astropy', 'pandas', 'scipy') for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", program, str(path)], check=False).returncode == 0


def test_descending_rows_are_turned_and_recorded(read: Read) -> None:
    (spectrum,) = read("wavelength_nm,reflectance,std\n600,.3,.03\n500,.2,.02\n400,.1,.01\n")
    np.testing.assert_array_equal(spectrum.wavelength_nm, [400, 500, 600])
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(spectrum.uncertainty, [0.01, 0.02, 0.03])
    assert spectrum.metadata["order"] == "descending"


def test_unsorted_rows_are_sorted_and_said(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match=r"^rock\.csv: .*sorted"):
        (spectrum,) = read("wavelength_nm,reflectance\n600,.3\n400,.1\n500,.2\n")
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, 0.2, 0.3])
    assert spectrum.metadata["order"] == "unsorted"


def test_duplicate_wavelengths_name_both_lines(refuse: Refuse) -> None:
    message = refuse("# c\nwavelength_nm,reflectance\n400,.1\n500.25,.2\n450,.2\n500.25,.3\n")
    assert "line 4 and line 6 have the same wavelength, 500.25 nm" in message


@pytest.mark.parametrize("cell", ["0.0", "-500", "nan", "", "inf"])
def test_rows_without_a_wavelength_are_left_out_and_said(read: Read, cell: str) -> None:
    with pytest.warns(LunarSciWarning, match=r"^rock\.csv: left out rows .*: 1 of 3, first line 2"):
        (spectrum,) = read(f"wavelength_nm,reflectance,std\n{cell},0,0\n400,.1,.01\n500,.2,.02\n")
    np.testing.assert_array_equal(spectrum.wavelength_nm, [400, 500])
    np.testing.assert_array_equal(spectrum.uncertainty, [0.01, 0.02])
    assert spectrum.metadata["rows_left_out"] == 1


def test_more_than_half_the_rows_without_a_wavelength_are_an_error(refuse: Refuse) -> None:
    message = refuse("wavelength_nm,reflectance\n400,.1\n0,.1\n0,.2\n")
    assert "2 of 3, first line 3" in message


def test_values_not_above_zero_are_masked_and_counted(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="not above 0, masked: 3 in 2 of 3 spectra, first 'b'"):
        spectra = read("wavelength_nm,a,b,c\n400,.1,0,-.1\n500,.2,.2,-.2\n600,.2,.2,.3\n")
    assert [int(s.usable.sum()) for s in spectra] == [3, 2, 1]
    assert [s.metadata["channels_not_positive"] for s in spectra] == [0, 1, 2]


@pytest.mark.parametrize("cells", [("nan", ""), ("nan", "-")])
def test_one_spectrum_without_values_is_an_error(refuse: Refuse, cells: tuple[str, str]) -> None:
    assert "no reflectance above 0" in refuse(f"wavelength_nm,reflectance\n400,{cells[0]}\n500,{cells[1]}\n")


@pytest.mark.filterwarnings("ignore:.*not above 0, masked:lunarsci.errors.LunarSciWarning")
def test_one_spectrum_without_positive_values_is_an_error(refuse: Refuse) -> None:
    assert "no reflectance above 0" in refuse("wavelength_nm,reflectance\n400,0\n500,-.1\n")


def test_one_of_many_without_values_is_returned_masked_and_said(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="1 of 2 spectra have no usable channel: 'b'"):
        a, b = read("wavelength_nm,a,b\n400,.1,\n500,.2,\n")
    assert a.usable.all()
    assert b.id == "b"
    assert not b.usable.any()


def test_channels_without_their_uncertainty_are_masked_and_said(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="uncertainty is missing or not above 0, masked: 2"):
        (spectrum,) = read("wavelength_nm,reflectance,std\n400,.1,.01\n500,.2,0\n600,.2,\n700,,\n")
    np.testing.assert_array_equal(spectrum.usable, [True, False, False, False])
    assert spectrum.metadata["channels_without_uncertainty"] == 2


def test_uncertainties_that_are_all_zero_are_unknown(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="unknown"):
        (spectrum,) = read("wavelength_nm,reflectance,std\n400,.1,0\n500,.2,0\n")
    assert spectrum.uncertainty is None
    assert spectrum.usable.all()


def test_what_was_found_is_recorded(read: Read) -> None:
    content = "# instrument: VNIS\nwavelength_um,reflectance (%)\n0.4,10\n0.5,\n0.6,30\n"
    (spectrum,) = read(content, "in/rock.csv")
    expected = {
        "source": "in/rock.csv",
        "sha256": hashlib.sha256(content.encode()).hexdigest(),
        "format": "text",
        "wavelength_unit": "um",
        "wavelength_unit_from": "file",
        "reflectance_unit": "percent",
        "reflectance_unit_from": "file",
        "order": "ascending",
        "rows_left_out": 0,
        "channels_missing": 1,
        "channels_deleted": 0,
        "channels_not_positive": 0,
        "comments": ["instrument: VNIS"],
        "column": "reflectance (%)",
    }
    assert {key: spectrum.metadata[key] for key in expected} == expected


def test_ids_that_would_be_equal_are_refused(refuse: Refuse) -> None:
    assert "two columns are named 'a'" in refuse("wavelength_nm,a,a (%)\n400,.1,10\n500,.1,10\n")
