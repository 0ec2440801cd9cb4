"""Libraries of end members: files, tables of what samples are, and what must be mended."""

import io
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from astropy.table import Table

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.readers.library import (
    MIXTURE,
    EndMember,
    check_library,
    read_library,
    read_metadata,
    to_ecsv,
    with_description,
)

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
    with pytest.raises(DataError, match="no end member is left"):
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
        ("min_um: null", "min_um: 90", "no grain size from 90 um on"),
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


def told(text: str) -> dict[str, dict[str, object]]:
    return read_metadata(InputFile("samples.csv", text.encode()))


def test_plain_columns() -> None:
    found = told("id,mineral,fo,max_um,source,remark\nA,ol,0.9,45,RELAB,nice\nB,Ilmenite,,,,\nC,,0.5,,,\n")
    assert found["A"]["mineral"] == "olivine"
    assert (found["A"]["fo"], found["A"]["max_um"], found["A"]["source"]) == (0.9, 45, "RELAB")
    assert (found["B"]["mineral"], found["B"]["max_um"]) == ("opaque", None)
    assert (found["C"]["mineral"], found["C"]["fo"]) == (None, 0.5)


def test_modes_and_zeros_as_in_tables_of_mixtures() -> None:
    header = "id;vol_ol;vol_opx;vol_cpx;vol_plg;fo;opx_fs;opx_en;opx_wo;cpx_fs;an;min_um;max_um\n"
    rows = ["ol;1;0;0;0;0.9;0;0;0;0;0;0;45", "opx;0;0.97;0.03;0;0;0.2;0.78;0.02;0.1;0;0;0", "mix;0.5;0.5;0;0;0.9;0.2;0.8;0;0;0;0;45"]  # fmt: skip # noqa: E501
    found = told(header + "\n".join(rows))
    assert (found["ol"]["mineral"], found["ol"]["fo"], "fs" in found["ol"]) == ("olivine", 0.9, False)
    opx = found["opx"]
    assert (opx["mineral"], opx["fs"], opx["en"], opx["wo"]) == ("orthopyroxene", 0.2, 0.78, 0.02)
    assert ("fo" in opx, opx["max_um"]) == (False, None)
    assert found["mix"]["mineral"] == MIXTURE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,mineral\nA,olivine\n", "no column 'id' ('name', 'mineral')"),
        ("id,mineral\n", "0 rows below the header"),
        ("id,mineral\n,olivine\n", "line 2, column 'id': ''; each row has an id"),
        ("id,fo\nA,.9\nA,.8\n", "line 3, column 'id': 'A'; each row has an id"),
        ("id,mineral\nA,chalk\n", "line 2: mineral 'chalk' is not known"),
        ("id,fo\nA,rich\n", "line 2, column fo: 'rich' is not a number"),
        ("id,fo\nA,inf\n", "line 2, column fo: 'inf' is not a number"),
        ("id,fo\nA,.9,1\n", "the header has 2 names and the rows 3 fields"),
        ("id,vol_ol\nA,much\n", "line 2, column vol_ol: 'much' is not a number"),
        ('id,fo\n"A,.9\n', "cannot be split into fields"),
        ("\x00\x01\x02", "binary"),
    ],
)
def test_wrong_tables_are_one_line(text: str, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)) as error:
        told(text)
    assert str(error.value).startswith("samples.csv: ")
    assert "\n" not in str(error.value)


def test_a_comment_does_not_move_the_line_numbers() -> None:
    with pytest.raises(DataError, match="line 4, column fo"):
        told("# mine\nid,fo\nA,.9\nB,x\n")


def member(**sample: object) -> EndMember:
    return EndMember("A", wavelength_nm=np.array([500.0]), reflectance=np.array([0.1]), **({"mineral": None} | sample))  # type: ignore[arg-type]


def test_the_table_fills_and_replaces_but_never_empties() -> None:
    before = member(mineral="olivine", fo=0.9, source="mine")
    after = with_description(before, {"mineral": "olivine", "fo": 0.8, "max_um": 45.0, "source": ""})
    assert (after.fo, after.max_um, after.source) == (0.8, 45.0, "mine")


def test_another_mineral_brings_its_own_chemistry() -> None:
    after = with_description(member(mineral="olivine", fo=0.9), {"mineral": "plagioclase", "an": 0.95})
    assert (after.mineral, after.fo, after.an) == ("plagioclase", None, 0.95)


def test_per_cent_are_refused() -> None:
    with pytest.raises(DataError, match="fo = 90 is no mole fraction"):
        with_description(member(), {"mineral": "olivine", "fo": 90.0})


GRID = np.arange(450.0, 2451.0, 5.0)
GOOD = EndMember(
    "good", "orthopyroxene", GRID, np.full(GRID.size, 0.4), fs=0.20, en=0.77, wo=0.03, min_um=0.0, max_um=45.0
)


def texts(member: EndMember, *, must_mend: bool) -> list[str]:
    return [finding.text for finding in check_library([member])[0] if finding.must_mend == must_mend]


def changed(place: int, value: float) -> EndMember:
    values = GOOD.reflectance.copy()
    values[place] = value
    return replace(GOOD, reflectance=values)


def test_nothing_is_said_of_a_good_one() -> None:
    assert check_library([GOOD]) == [()]


@pytest.mark.parametrize(
    ("member", "word"),
    [
        (changed(10, 0.0), "1 channels not between 0 and 1.2, first 0 at 500 nm"),
        (changed(0, -0.1), "first -0.1 at 450 nm"),
        (changed(400, 1.2), "first 1.2 at 2450 nm"),
        (replace(GOOD, mineral=None), "no mineral"),
        (replace(GOOD, fs=0.5), "fs + en + wo = 1.300, not 1"),
        (replace(GOOD, en=None, fs=0.9, wo=0.2), "add up to 1.100, more than 1"),
        (replace(GOOD, fo=0.9), "fo = 0.9 in a mineral without it (orthopyroxene)"),
        (replace(GOOD, mineral="opaque"), "fs = 0.2 in a mineral without it (opaque)"),
        (replace(GOOD, wavelength_nm=GRID[:19], reflectance=np.full(19, 0.4)), "19 channels; 20 are needed"),
    ],
)
def test_what_must_be_mended(member: EndMember, word: str) -> None:
    assert any(word in text for text in texts(member, must_mend=True))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"max_um": None}, "grain size unknown"),
        ({"fs": None, "en": None, "wo": None}, "no fs, no en, no wo: composition unknown"),
        ({"wavelength_nm": GRID + 310}, "covers 760-2760 nm"),
        ({"wavelength_nm": np.where(GRID > 1000, GRID + 100, GRID)}, "gap of 105 nm after 1000 nm"),
    ],
)
def test_what_one_should_know(change: dict[str, Any], word: str) -> None:
    member = replace(GOOD, **change)
    assert texts(member, must_mend=True) == []
    assert [word in text for text in texts(member, must_mend=False)] == [True]


def test_coarse_sampling_is_no_gap() -> None:
    coarse = np.arange(400.0, 2500.0, 70.0)
    assert texts(replace(GOOD, wavelength_nm=coarse, reflectance=np.full(coarse.size, 0.3)), must_mend=False) == []


def test_analyses_may_lack_two_per_cent() -> None:
    assert texts(replace(GOOD, en=0.751), must_mend=True) == []
    assert texts(replace(GOOD, en=0.749), must_mend=True) != []


def test_every_one_of_two_equal_ids_is_named() -> None:
    *twins, other = check_library([GOOD, replace(GOOD, reflectance=GOOD.reflectance / 2), replace(GOOD, id="other")])
    assert [[finding.must_mend for finding in findings] for findings in twins] == [[True], [True]]
    assert "2 end members have this id" in twins[1][0].text
    assert other == ()
