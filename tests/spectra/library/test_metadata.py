"""Tables of what samples are."""

import re

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.library import MIXTURE, EndMember, read_metadata, with_description


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
