"""Records kept as columns beside the dicts that they stand for, written by Python's own json and csv."""

import csv
import io
import json
import math
import re
from typing import Any

import numpy as np
import pytest

from lunarsci.io import records as module
from lunarsci.io.records import Codes, Listed, Records, RecordsInBlocks, Same, Where, in_blocks
from lunarsci.printable import cell
from lunarsci.provenance import json_chunks, to_json


def numbers(rng: np.random.Generator, size: int) -> Any:
    """Numbers of all sizes, some of them none."""
    values = rng.normal(size=size) * 10.0 ** rng.integers(-20, 20, size)
    return np.where(rng.random(size) < 0.1, rng.choice([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e16], size), values)


def made(size: int) -> Records:
    rng = np.random.default_rng(size)
    return Records(
        {
            "id": [f'spectrum {index}, "ü" <45 µm>' for index in range(size)],
            "rms_ln": numbers(rng, size),
            "iterations": rng.integers(-5, 100, size),
            "converged": rng.random(size) < 0.5,
            "status": Codes(rng.integers(0, 3, size), ["ok", None, "first, second\nthird"]),
            "assemblage": Same("OL-OPX"),
            "method": "map",
            "seed": None,
            "notes": [["a"] * (index % 3) for index in range(size)],
            "coefficients": rng.normal(size=(size, 3)),
            "nothing": {},
            "nbsr": Where(
                rng.random(size) < 0.5,
                {"um1": Where(rng.random(size) < 0.5, {"opx": numbers(rng, size)}), "sigma": Same([1, 2])},
            ),
            "bands": Listed([{"name": Same(f"B{j}"), "c": numbers(rng, size)} for j in range(3)], np.arange(size) % 4),
            "both": Listed([numbers(rng, size), {"q": numbers(rng, size)}]),
        }
    )


def finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BLOCK_VALUES", 500)


def without_numbers(text: str) -> str:
    """Other libraries write the same number otherwise: 1e-05 is 0.00001."""
    return re.sub(r"(?<![\w\"])-?\d[\d.e+-]*", "0", text)


@pytest.mark.parametrize("size", [1, 2, 100])
@pytest.mark.usefixtures("blocks")
def test_json_is_that_of_python(size: int) -> None:
    records = made(size)
    document = {"result": {"spectra": records.tolist(), "x": 1.5}, "schema": "s", "provenance": {"z": [1, 2]}}
    wanted = json.dumps(document, sort_keys=True, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    text = to_json(document | {"result": {"spectra": records, "x": 1.5}})
    assert json.loads(text) == json.loads(wanted)
    assert without_numbers(text) == without_numbers(wanted)
    assert finite(records[size - 1]) == records[-1] == json.loads(wanted)["result"]["spectra"][-1]


@pytest.mark.usefixtures("blocks")
def test_csv_is_that_of_python() -> None:
    records = made(100)
    text = b"".join(records.csv_chunks()).decode()
    rows = list(csv.reader(io.StringIO(text)))
    place = {name: number for number, name in enumerate(records.names)}
    assert len(rows) == 100
    for row, record in zip(rows, records, strict=True):
        ratio = record["nbsr"] or {}
        opx = (ratio.get("um1") or {}).get("opx")
        assert row[place["id"]] == cell(record["id"])
        assert row[place["status"]] == cell(record["status"] or "")
        assert number(row[place["rms_ln"]]) == record["rms_ln"]
        assert number(row[place["nbsr_um1_opx"]]) == opx
        assert row[place["converged"]] == str(record["converged"]).lower()
        assert row[place["coefficients"]] == " ".join(map(str, record["coefficients"]))
    plain = b"".join(Records({"id": ["one", "two 2"], "x": np.array([1.5, np.nan])}).csv_chunks())
    assert plain == b"one,1.5\ntwo 2,\n", "quotes only where they are needed"


def number(cell_text: str) -> float | None:
    return float(cell_text) if cell_text else None


@pytest.mark.usefixtures("blocks")
def test_numbers_are_read_as_they_were() -> None:
    rng = np.random.default_rng(1)
    powers = np.array([10.0**power for power in range(-300, 308)] + [2.0**power for power in range(-1074, 1024)])
    values = np.concatenate(
        [
            np.array([0.0, -0.0, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 1e-4, 9.9e-5, 1e16, 0.1]),
            *(np.nextafter(powers, end) for end in (0, np.inf)),
            -powers,
            rng.integers(0, 2**63, 20_000, dtype=np.uint64).view(float),
            np.round(rng.random(5000) * 10.0 ** rng.integers(-5, 18, 5000), 3),
        ]
    )
    values = values[np.isfinite(values)]
    texts = b"".join(Records({"x": values}).csv_chunks()).decode().split("\n")[:-1]
    assert list(map(float, texts)) == values.tolist()
    assert json.loads(to_json({"x": Records({"x": values})}))["x"] == [{"x": value} for value in values.tolist()]
    assert json.loads(to_json({"seed": 10**30})) == {"seed": str(10**30)}


def test_blocks_are_written_as_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BLOCK_VALUES", 10)
    pieces = list(json_chunks({"spectra": Records({"a": np.arange(100), "b": np.arange(100) / 8})}))
    assert len(pieces) > 20
    assert json.loads(b"".join(pieces))["spectra"][99] == {"a": 99, "b": 12.375}


def test_a_slice_is_records_too() -> None:
    records = made(9)
    assert list(records[2:7:2]) == [records[2], records[4], records[6]]
    assert to_json({"r": Records({"a": np.zeros(0)})}) == '{\n  "r": []\n}\n'
    with pytest.raises(IndexError):
        records[9]


def test_columns_are_of_one_length() -> None:
    with pytest.raises(ValueError, match=r"\[2, 3\]"):
        Records({"a": np.zeros(3), "b": {"c": np.zeros(2)}})
    with pytest.raises(ValueError, match="no lengths"):
        Records({"a": "same"})


@pytest.mark.parametrize("each", [1, 3])
def test_records_made_block_by_block_are_the_same(each: int) -> None:
    """By size 10 of a block, of things with one record or three; JSON, CSV, and as a list."""

    def make(things: range) -> Records:
        row = np.repeat(np.arange(things.start, things.stop), each)
        return Records({"thing": row, "root": np.sqrt(row), "name": [f"n{k}" for k in row], "none": None})

    whole, parts = make(range(37)), in_blocks(37, make, size=37 * each, rows=10)
    assert isinstance(parts, RecordsInBlocks)
    assert isinstance(in_blocks(10, make, rows=10), Records)
    assert len(parts) == len(whole)
    assert parts.tolist() == whole.tolist()
    assert parts[11:15] == whole[11:15].tolist()
    assert parts[::-7] == whole.tolist()[::-7]
    assert (parts[-1], parts[10]) == (whole[-1], whole[10])
    with pytest.raises(IndexError):
        parts[37 * each]
    assert b"".join(parts.csv_chunks()) == b"".join(whole.csv_chunks())
    assert parts.names == whole.names
    assert to_json({"rows": parts}) == to_json({"rows": whole})
