"""Tables of modes that are known."""

import re

import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.abundance.known_modes import read_modes


def table(text: str) -> InputFile:
    return InputFile("modes.csv", text.encode())


def test_numbers_are_known_empty_cells_are_sought_and_zeros_beside_them_absent() -> None:
    found = read_modes(table("id,OLIVINE,vol_opx,remark\na,0.25,0.75,sieved\nb,,,\nc,0,,wet\n"))
    assert found.known == {"a": {"olivine": 0.25, "orthopyroxene": 0.75}}
    assert found.absent == {"b": [], "c": ["olivine"]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,remark\na,b\n", "has no column named after a mineral"),
        ("name,olivine\na,1\n", "no column 'id'"),
        ("id,olivine,ol\na,1,0\n", "olivine has two columns"),
        ("id,olivine\na,1\na,1\n", "each row has an id of its own"),
        ("id,olivine\n,1\n", "line 2, column 'id'"),
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
