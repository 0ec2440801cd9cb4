"""Finding the reader, and refusing what no reader can use."""

import bz2
import gzip
import io
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsci.errors import DataError
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
        (gzip.compress(GOOD.encode(), mtime=0), "compressed .gzip.; unpack"),
        (bz2.compress(GOOD.encode()), "compressed .bzip2."),
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
        (b"7," * 500_000 + b"\n", "no unit and the values do not tell"),
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
