"""Libraries as files: what is written is read back, and files that are none are refused."""

import io
from typing import Any

import numpy as np
import pytest
from astropy.table import Table

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.readers.library import EndMember, read_library, to_ecsv

OLIVINE = EndMember(
    "Kiglapait, <45 um", "olivine", np.array([500.0, 600.0, 700.0]), np.array([0.2, 0.3, 0.4]), fo=0.57, max_um=45.0,
    source="RELAB",
)  # fmt: skip
PYROXENE = EndMember(
    "opx-1", "orthopyroxene", np.array([550.0, 600.0]), np.array([0.31, -0.01]), fs=0.2, en=0.78, wo=0.02, min_um=0.0
)
UNKNOWN = EndMember("dust", None, np.array([500.0, 550.0, 700.0]), np.array([0.1, 0.11, 1.3]))


def written(*members: EndMember, name: str = "lib.ecsv") -> InputFile:
    return InputFile(name, to_ecsv(members))


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_every_field_comes_back_and_each_spectrum_on_its_own_channels() -> None:
    before = [OLIVINE, PYROXENE, UNKNOWN]
    after = read_library(written(*before))
    assert [(m.id, m.sample()) for m in after] == [(m.id, m.sample()) for m in before]
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(other.wavelength_nm, one.wavelength_nm)
        np.testing.assert_array_equal(other.reflectance, one.reflectance)


def test_astropy_reads_it_with_units_and_blanks(tmp_path: Any) -> None:
    path = tmp_path / "lib.ecsv"
    path.write_bytes(to_ecsv([OLIVINE, UNKNOWN], {"command": "x"}))
    table = Table.read(path)
    assert str(table["wavelength_nm"].unit) == "nm"
    assert table.meta["end_members"]["dust"]["mineral"] is None
    assert table.meta["provenance"] == {"command": "x"}
    assert table["Kiglapait, <45 um"].mask.tolist() == [False, True, False, False]


def test_a_library_is_a_file_of_spectra_like_any_other() -> None:
    other = EndMember("b", None, np.array([500.0, 600.0]), np.array([0.1, 0.2]))
    assert [s.id for s in read_spectra(written(OLIVINE, other))] == [OLIVINE.id, "b"]


@pytest.mark.parametrize("count", [1, 250])
def test_any_number_of_end_members_keeps_its_description(count: int) -> None:
    members = [
        EndMember(f"r{k}", "plagioclase", np.array([500.0, 600.0]), np.array([0.5, 0.6]), an=k / 250)
        for k in range(count)
    ]
    assert [m.an for m in read_library(written(*members))] == [m.an for m in members]


def test_a_plain_table_is_a_library_without_descriptions() -> None:
    (one,) = read_library(InputFile("ol.csv", b"wavelength_nm,reflectance\n500,0.1\n600,\n700,0.3\n"))
    assert (one.id, one.mineral, one.fo) == ("ol", None, None)
    np.testing.assert_array_equal(one.wavelength_nm, [500, 700])


def test_spectra_without_a_channel_are_left_out_and_said() -> None:
    with pytest.warns(LunarSciWarning, match="1 of 2 spectra have no usable channel: 'b'"):
        members = read_library(InputFile("two.csv", b"wavelength_nm,a,b\n500,0.1,\n600,0.2,\n"))
    assert [member.id for member in members] == ["a"]


@pytest.mark.parametrize("id", ["a_sigma", "fwhm", "band", "sigma", "wavelength", "a_systematic_b", " "])
def test_an_id_that_would_be_read_as_something_else_is_refused(id: str) -> None:
    with pytest.raises(DataError):
        to_ecsv([EndMember(id, None, np.array([500.0]), np.array([0.1]))])


def test_two_of_one_id_and_none_at_all_are_refused() -> None:
    with pytest.raises(DataError, match="two end members have this id"):
        to_ecsv([OLIVINE, OLIVINE])
    with pytest.raises(DataError, match="at least one"):
        to_ecsv([])


def spoiled(old: str, new: str) -> InputFile:
    text = to_ecsv([OLIVINE, UNKNOWN]).decode()
    assert old in text
    return InputFile("lib.ecsv", text.replace(old, new, 1).encode())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mineral: olivine", "mineral: chalk", "'chalk' is not known"),
        ("fo: 0.57", "fo: 57", "fo = 57 is no mole fraction"),
        ("fo: 0.57", "fo: .nan", "fo = nan is no mole fraction"),
        ("fo: 0.57", "fo: [1, 2]", "fo is '[1, 2]', no number"),
        ("fo: 0.57", "fo: rich", "fo is 'rich', no number"),
        ("max_um: 45.0", "max_um: -1", "max_um = -1 is no grain size"),
        ("max_um: 45.0", "max_um: .inf", "max_um = inf is no grain size"),
        ("min_um: null", "min_um: 90", "from 90 down to 45 um"),
    ],
)
def test_a_wrong_description_is_one_line_with_file_and_id(old: str, new: str, message: str) -> None:
    with pytest.raises(DataError) as error:
        read_library(spoiled(old, new))
    text = str(error.value)
    assert text.startswith(f"lib.ecsv: {OLIVINE.id}: ")
    assert message in text
    assert "\n" not in text


def test_descriptions_that_are_no_mapping_are_refused() -> None:
    table = Table({"wavelength_nm": [500.0, 600.0], "a": [0.1, 0.2]})
    for meta in ({"end_members": ["a"]}, {"end_members": {"a": "olivine"}}):
        table.meta.clear()
        table.meta.update(meta)
        buffer = io.StringIO()
        table.write(buffer, format="ascii.ecsv")
        with pytest.raises(DataError, match=r"^lib.ecsv: .*is no mapping"):
            read_library(InputFile("lib.ecsv", buffer.getvalue().encode()))


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_a_library_cut_anywhere_is_read_or_refused() -> None:
    whole = to_ecsv([OLIVINE, UNKNOWN])
    for length in range(1, len(whole), 7):
        try:
            read_library(InputFile("cut.ecsv", whole[:length]))
        except DataError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("wavelength", "reflectance"),
    [([], []), ([500.0], [0.1, 0.2]), ([500.0, 500.0], [0.1, 0.1]), ([0.0], [0.1]), ([500.0], [np.nan])],
)
def test_impossible_channels_are_refused(wavelength: list[float], reflectance: list[float]) -> None:
    with pytest.raises(DataError, match=r"^x: "):
        EndMember("x", None, np.array(wavelength), np.array(reflectance))
