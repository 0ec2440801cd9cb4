"""The embedded library: it rebuilds what it was made from, and its script makes it again.

Tables of modes that are known.
"""

import csv
import io
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.io.tables import table_rows
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import OPAQUE, TABLE, embedded_end_members, read_modes
from lunarsci.spectra.readers.dispatch import read_spectra

SCRIPT = Path(__file__).parents[3] / "spectra_data/make_end_members.py"
GRID = np.arange(450.0, 2451.0, 5.0)


def test_every_mineral_has_end_members_with_their_chemistry_in_range() -> None:
    library = embedded_end_members(GRID)
    assert {item.mineral for item in library} == {*WEIGHED, OPAQUE}
    assert len({item.id for item in library}) == len(library) > 100
    for item in library:
        assert np.all((item.reflectance > 0) & (item.reflectance < 1.1)), item.id
        if item.fs is not None:
            assert item.en is not None
            assert item.wo is not None
            assert item.fs + item.en + item.wo == pytest.approx(1, abs=0.01), item.id


@pytest.mark.reference
def test_rebuilt_spectra_are_the_measured_ones(reference_data: Path) -> None:
    """Root mean square of the difference of ln R against what the table says."""
    source = read_input(str(reference_data / "spectra/relab/reflectance.csv"))
    measured = {s.id: s for s in read_spectra(source)}
    rows = {row["id"]: row for row in table_rows(TABLE)}
    checked = 0
    for item in embedded_end_members(GRID):
        if item.id in measured:
            spectrum = measured[item.id]
            difference = np.log(np.interp(spectrum.wavelength_nm, GRID, item.reflectance) / spectrum.reflectance)
            assert 100 * np.sqrt(np.mean(difference**2)) == pytest.approx(
                float(rows[item.id]["rms_ln_percent"]), abs=0.02
            ), item.id
            checked += 1
    assert checked > 100


@pytest.mark.slow
@pytest.mark.reference
def test_the_script_makes_the_table_again(
    reference_data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(reference_data / "spectra")])
    with pytest.warns(UserWarning, match="left out 'fwhm_nm'"):
        runpy.run_path(str(SCRIPT), run_name="__main__")
    made = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    kept = table_rows(TABLE)
    assert [row["id"] for row in made] == [row["id"] for row in kept]
    for new, old in zip(made, kept, strict=True):
        assert float(new["rms_ln_percent"]) == pytest.approx(float(old["rms_ln_percent"]), abs=0.02), new["id"]
        assert {key: new[key] for key in ("mineral", "fo", "fs", "wo")} == {
            key: old[key] for key in ("mineral", "fo", "fs", "wo")
        }


def test_channels_beyond_the_library_are_refused() -> None:
    with pytest.raises(ParameterError, match="450 to 2450"):
        embedded_end_members(np.array([400.0, 500.0]))


def table(text: str) -> InputFile:
    return InputFile("modes.csv", text.encode())


def test_numbers_are_known_empty_cells_are_sought_and_zeros_beside_them_absent() -> None:
    found = read_modes(table("id,OLIVINE,vol_opx,remark\na,0.25,0.75,sieved\nb,,,\nc,0,,wet\n"))
    assert found.shares == {"a": {"olivine": 0.25, "orthopyroxene": 0.75}}
    assert found.absent == {"b": [], "c": ["olivine"]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,remark\na,b\n", "needs columns named after minerals"),
        ("name,olivine\na,1\n", "no column 'id'"),
        ("id,olivine,ol\na,1,0\n", "one of each"),
        ("id,olivine\na,1\na,1\n", "line 3, column 'id': 'a'; each row has an id of its own"),
        ("id,olivine\n,1\n", "line 2, column 'id': ''"),
        ("id,olivine,cpx\na,1.5,0\n", "line 2, column olivine: '1.5' is no share"),
        ("id,olivine,cpx\na,much,0\n", "is no share"),
        ("id,olivine,cpx\na,nan,0\n", "is no share"),
        ("id,olivine,cpx\na,0.5,\n", "some shares are stated"),
        ("id,olivine,cpx\na,0.5\n", "the header has 3 names and the rows 2 fields"),
    ],
)
def test_faults_are_said_with_their_line(text: str, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        read_modes(table(text))
