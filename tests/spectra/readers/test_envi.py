"""ENVI spectral libraries: bytes written by hand to the layout that the header states."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.readers.envi import without_headers

HEADER = """ENVI
description = {
  A library = made by hand}
; a comment = not a field
samples = 3
lines   = 2
bands   = 1
header offset = 0
file type = ENVI Spectral Library
data type = 4
interleave = bsq
byte order = 0
wavelength units = Micrometers
spectra names = {
 Olivine Fo 90,
 Augite <45 um}
wavelength = {
 0.5, 1.0,
 2.0}
"""
VALUES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


def library(folder: Path, header: str = HEADER, code: str = "<6f", values: tuple[float, ...] = VALUES) -> Path:
    (folder / "lib.hdr").write_text(header)
    (folder / "lib.sli").write_bytes(struct.pack(code, *values))
    return folder / "lib.sli"


def refused(path: Path) -> str:
    with pytest.raises(DataError) as error:
        read_spectra(str(path))
    message = str(error.value)
    assert message.startswith(str(path.parent))
    assert "\n" not in message
    return message


@pytest.mark.parametrize("given_name", ["lib.sli", "lib.hdr"])
def test_either_file_gives_the_spectra(tmp_path: Path, given_name: str) -> None:
    library(tmp_path)
    olivine, augite = read_spectra(str(tmp_path / given_name))
    assert [olivine.id, augite.id] == ["Olivine Fo 90", "Augite <45 um"]
    np.testing.assert_array_equal(augite.wavelength_nm, [500, 1000, 2000])
    np.testing.assert_allclose(olivine.reflectance, [0.1, 0.2, 0.3], rtol=1e-7)
    np.testing.assert_allclose(augite.reflectance, [0.4, 0.5, 0.6], rtol=1e-7)
    assert {Path(name).name for name in olivine.metadata["inputs"]} == {"lib.sli", "lib.hdr"}


@pytest.mark.parametrize(
    ("header", "data"), [("lib.sli.hdr", "lib.sli"), ("lib.HDR", "lib.SLI"), ("lib.hdr", "lib"), ("lib.hdr", "lib.slb")]
)
def test_the_other_file_is_found(tmp_path: Path, header: str, data: str) -> None:
    (tmp_path / header).write_text(HEADER)
    (tmp_path / data).write_bytes(struct.pack("<6f", *VALUES))
    assert len(read_spectra(str(tmp_path / header))) == 2


@pytest.mark.parametrize(
    ("kind", "order", "code"), [("4", "0", "<6f"), ("4", "1", ">6f"), ("5", "0", "<6d"), ("5", "1", ">6d")]
)
def test_types_and_byte_orders(tmp_path: Path, kind: str, order: str, code: str) -> None:
    header = HEADER.replace("data type = 4", f"data type = {kind}").replace("byte order = 0", f"byte order = {order}")
    first, _ = read_spectra(str(library(tmp_path, header, code)))
    np.testing.assert_allclose(first.reflectance, [0.1, 0.2, 0.3], rtol=1e-7)


def test_scale_factor_offset_ignored_deleted_and_bad_channels(tmp_path: Path) -> None:
    header = HEADER.replace("header offset = 0", "header offset = 8") + (
        "reflectance scale factor = 10000\ndata ignore value = -99\nbbl = {1, 1, 0}\n"
    )
    path = library(tmp_path, header, "<8x6f", (1000.0, -99.0, 3000.0, -1.23e34, 5000.0, 6000.0))
    with pytest.warns(LunarSciWarning, match="deleted channels"):
        first, second = read_spectra(str(path))
    np.testing.assert_allclose(first.reflectance, [0.1, np.nan, np.nan])
    np.testing.assert_allclose(second.reflectance, [np.nan, 0.5, np.nan])


def test_nanometres_and_no_word_about_units(tmp_path: Path) -> None:
    nm = HEADER.replace("Micrometers", "Nanometers").replace("0.5, 1.0,\n 2.0", "500, 1000, 2000")
    np.testing.assert_array_equal(read_spectra(str(library(tmp_path, nm)))[0].wavelength_nm, [500, 1000, 2000])
    unknown = HEADER.replace("Micrometers", "Unknown")
    with pytest.warns(LunarSciWarning, match="µm"):
        np.testing.assert_array_equal(read_spectra(str(library(tmp_path, unknown)))[0].wavelength_nm, [500, 1000, 2000])


def test_wavelengths_among_the_records_are_left_out(tmp_path: Path) -> None:
    path = library(tmp_path, HEADER.replace("Olivine Fo 90", "Wavelengths AVIRIS 1995"))
    with pytest.warns(LunarSciWarning, match="left out 1 records"):
        (spectrum,) = read_spectra(str(path))
    assert spectrum.id == "Augite <45 um"


def test_spectra_without_names_are_told_apart(tmp_path: Path) -> None:
    header = HEADER.replace("spectra names = {\n Olivine Fo 90,\n Augite <45 um}\n", "")
    assert [s.id for s in read_spectra(str(library(tmp_path, header)))] == ["lib:column-1", "lib:column-2"]


def test_one_spectrum_may_have_commas_in_its_name(tmp_path: Path) -> None:
    header = HEADER.replace("lines   = 2", "lines = 1")
    (spectrum,) = read_spectra(str(library(tmp_path, header, "<3f", VALUES[:3])))
    assert spectrum.id == "Olivine Fo 90, Augite <45 um"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ENVI Spectral Library", "ENVI Standard", "'ENVI Standard', not of an 'ENVI Spectral Library'"),
        ("file type = ENVI Spectral Library", "", "of no file type"),
        ("samples = 3", "", "'samples' is missing"),
        ("samples = 3", "samples = three", "'samples' is 'three', no whole number"),
        ("samples = 3", "samples = 0", "no possible library"),
        ("samples = 3", "samples = 999999999999", "no possible library"),
        ("samples = 3", "samples = 4", "3 'wavelength' for samples = 4"),
        ("lines   = 2", "lines = 3", "2 'spectra names' for lines = 3 (a comma in a name?)"),
        ("bands   = 1", "bands = 2", "bands = 2 are no possible library"),
        ("data type = 4", "data type = 6", "'data type' is '6' and"),
        ("byte order = 0", "byte order = 7", "'byte order' '7'; real"),
        ("header offset = 0", "header offset = -4", "'header offset' is '-4', no whole number"),
        ("Micrometers", "GHz", "'wavelength units' is 'GHz'"),
        ("0.5, 1.0", "0.5, x", "'x' in 'wavelength' is no number"),
        (" 2.0}", " 2.0", "the braces of 'wavelength' are never closed"),
        ("Augite <45 um", "Olivine Fo 90", "two columns are named 'Olivine Fo 90'"),
        ("interleave = bsq", "reflectance scale factor = 0", "it must be above 0"),
        ("interleave = bsq", "reflectance scale factor = nan", "it must be above 0"),
    ],
)
def test_a_header_that_is_wrong_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in HEADER
    assert message in refused(library(tmp_path, HEADER.replace(old, new, 1)))


@pytest.mark.parametrize("code", ["<5f", "<7f", "<6d"])
def test_another_size_than_announced_is_refused(tmp_path: Path, code: str) -> None:
    count = int(code[1])
    assert "announces 24 (2 spectra of 3 channels)" in refused(library(tmp_path, code=code, values=VALUES[:1] * count))


def test_a_missing_partner_is_named(tmp_path: Path) -> None:
    path = library(tmp_path)
    (tmp_path / "lib.hdr").unlink()
    assert "its header (.hdr) is missing; put lib.sli.hdr or lib.hdr beside it" in refused(path)
    (tmp_path / "lib.hdr").write_text(HEADER)
    path.unlink()
    assert "its data file (.sli) is missing" in refused(tmp_path / "lib.hdr")


def test_standard_input_is_one_file_too_few() -> None:
    with pytest.raises(DataError, match="one of two files"):
        read_spectra(InputFile("<stdin>", HEADER.encode()))


def test_a_header_beside_its_data_is_not_read_twice() -> None:
    names = ["a/x.sli", "a/x.hdr", "a/y.sli", "a/y.sli.hdr", "b/x.hdr", "c.csv"]
    assert without_headers(names) == ["a/x.sli", "a/y.sli", "b/x.hdr", "c.csv"]


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@settings(max_examples=150, deadline=None)
@given(st.integers(0, len(HEADER)), st.text("{}=,0123456789.aZ\n ;-", max_size=12), st.integers(0, 12))
def test_a_spoiled_header_is_read_or_refused(place: int, inserted: str, removed: int) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        path = library(Path(name), HEADER[:place] + inserted + HEADER[place + removed :])
        try:
            read_spectra(str(path))
        except DataError as error:
            assert "\n" not in str(error)
            assert len(str(error)) < 400
