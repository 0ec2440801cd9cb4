"""Tables that come with lunarsci: whole, unchangeable, hashed, and each with its source."""

import csv
import hashlib
import io
import tomllib
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile, open_input
from lunarsci.io.tables import csv_bytes, csv_tables, read_csv_table, table_hashes, table_rows

FOLDER = Path(__file__).parents[2] / "spectra_data"
NAMES = sorted(path.name for path in FOLDER.glob("*.csv"))


@pytest.mark.parametrize("name", NAMES)
def test_rows_and_hash_are_those_of_the_file(name: str) -> None:
    with (FOLDER / name).open(newline="", encoding="utf-8") as file:
        assert [dict(row) for row in table_rows(name)] == list(csv.DictReader(file))
    assert table_hashes(name) == {name: hashlib.sha256((FOLDER / name).read_bytes()).hexdigest()}


def test_every_table_has_a_source() -> None:
    sources = tomllib.loads((FOLDER / "sources.toml").read_text("utf-8")).values()
    arrays = {path.name for path in FOLDER.glob("*.npz")}
    assert {*NAMES, *arrays} == {entry["table"] for entry in sources if "table" in entry}


def test_rows_cannot_be_changed_for_the_next_reader() -> None:
    with pytest.raises(TypeError):
        table_rows("mgm_bands.csv")[0]["center_nm"] = "0"


def test_semicolons_and_decimal_commas_are_those_of_the_same_table() -> None:
    """As spreadsheets of half the world write them; a decimal comma between commas is refused with what to do."""
    plain = b'# remark; with ;\ntime_s,wheel, x_m\n0.5,FL,-1.25e-3\n1,,\n1.5,"a,b",2\n'
    sent = b'# remark; with ;\ntime_s;wheel; x_m\n0,5;FL;-1,25e-3\n1;;\n1.5;"a,b";2\n'
    table = read_csv_table(InputFile("sent.csv", sent))
    assert table.equals(read_csv_table(InputFile("plain.csv", plain)))
    with NamedTemporaryFile(suffix=".csv") as file:
        file.write(sent.replace(b"1.5", b"1,5"))
        file.flush()
        with open_input(file.name) as stream:
            (piece,) = csv_tables(stream, lambda cut, _: cut)
    assert piece.time_s.tolist() == [0.5, 1.0, 1.5] and piece.x_m.tolist()[::2] == [-1.25e-3, 2.0]
    with pytest.raises(DataError, match=r"line 2: 4 fields, the header has 2.* decimal comma needs ';'"):
        read_csv_table(InputFile("sent.csv", b"time_s,x_m\n0,5,1,25\n"))


def test_a_written_table_is_what_pandas_reads_again() -> None:
    """Nine digits of numbers of any size, texts with commas, truths, blanks and whole numbers."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame({
        "count": np.arange(-3, 497),
        "wheel": ["FL", 'a "b", c', "", "Ä"] * 125,
        "there": rng.random(500) > 0.5,
        "value": rng.normal(size=500) * 10.0 ** rng.integers(-30, 30, 500),
        "blank": np.where(rng.random(500) > 0.5, np.nan, 0.1 + 0.2),
    })  # fmt: skip
    written = csv_bytes(table)
    again = pd.read_csv(io.BytesIO(written), keep_default_na=False, na_values={"blank": [""]})
    assert list(again) == list(table)
    for name in ("count", "wheel", "there"):
        assert again[name].tolist() == table[name].tolist(), name
    np.testing.assert_allclose(again["value"], table["value"], rtol=5e-9)
    np.testing.assert_array_equal(again["blank"], np.where(np.isnan(table["blank"]), np.nan, 0.3))
    assert csv_bytes(table.iloc[:0]) == b"count,wheel,there,value,blank\n"


def test_numbers_are_rounded_to_nine_digits_as_text_would_be() -> None:
    """And without zeros at the end."""
    rng = np.random.default_rng(1)
    powers = 10.0 ** np.concatenate([rng.integers(-12, 15, 2000), rng.integers(-300, 300, 500), np.arange(-320, 308)])
    values = powers * np.concatenate([rng.normal(size=2500), np.ones(628)])
    cells = csv_bytes(pd.DataFrame({"value": values})).decode().splitlines()[1:]
    assert [float(one) for one in cells] == [float(f"{value:.9g}") for value in values]
    for one in cells:
        figures, _, _ = one.strip("-").partition("e")
        assert figures == figures.strip() and not ("." in figures and figures.endswith(("0", ".")))
        assert len(figures.replace(".", "").strip("0")) <= 9
    odd = csv_bytes(pd.DataFrame({"value": [0.0, -0.0, np.nan, np.inf, 999999999.5, 5e-324, 1.25e120]}))
    assert odd.split() == b"value 0 -0 1000000000 5e-324 1.25e+120".split()
