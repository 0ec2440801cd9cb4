"""What a file says never reaches a terminal or a spreadsheet as a command."""

import csv
import io
import json
from pathlib import Path

import pandas as pd
import pytest
from lunarsci.cli import main

from lunarsci.io.documents import json_document, toml_document
from lunarsci.io.tables import csv_bytes
from lunarsci.printable import LONGEST, cell, printable, shortened

RED, TITLE, CSI, TURNED = "\x1b[31mred", "\x1b]0;owned\x07", "\x9b2J", "\u202eexe.txt"


@pytest.mark.parametrize("text", [RED, TITLE, CSI, TURNED, "a\rb", "a\nb", "\x00", "\x7f"])
def test_control_characters_are_spelt_out(text: str) -> None:
    shown = printable(text)
    assert shown.isprintable()
    assert shown != text


def test_text_of_all_languages_stays() -> None:
    assert printable("µm ± 0.1 °, 玉兔二号, Größe\tσ") == "µm ± 0.1 °, 玉兔二号, Größe\tσ"


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "+1+cmd", "-2+3*cmd", "@SUM(A1)", "\t=1+1"])
def test_formulas_are_made_text(text: str) -> None:
    assert cell(text) == f"'{text}"


@pytest.mark.parametrize("text", ["-", "-0.5", "+3", "-1e-5", "-0.5 0.25", "OL-OPX", "a=b", ""])
def test_numbers_and_words_stay(text: str) -> None:
    assert cell(text) == text


def test_tables_of_pandas_too() -> None:
    made = csv_bytes(pd.DataFrame({"name": ["=1+1", RED], "depth_m": [-0.5, 1.0]})).decode()
    assert [row["name"] for row in csv.DictReader(io.StringIO(made))] == ["'=1+1", "\\x1b[31mred"]
    assert "-0.5" in made


def test_a_long_message_keeps_its_ends() -> None:
    text = f"file: {'x' * 5000}; give a number"
    assert len(shortened(text)) == LONGEST
    assert shortened(text).startswith("file: xxx")
    assert shortened(text).endswith("; give a number")


@pytest.mark.parametrize("kind", ["--csv", "--json", "table"])
def test_a_spectrum_with_a_name_of_commands(kind: str, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rows = "".join(f"{nm},{0.2 + 1e-5 * nm - 0.03 * (900 < nm < 1050):.5f}\n" for nm in range(500, 2500, 10))
    file = tmp_path / "named.csv"
    file.write_text(f"wavelength_nm,=cmd{RED}{TITLE}\n{rows}")
    code = main(["spectra", "bands", str(file), *([] if kind == "table" else [kind])])
    out, err = capfd.readouterr()
    assert code == 0, err
    assert "\x1b" not in out + err
    assert "\x07" not in out + err
    assert "cmd" in out
    if kind == "--json":
        assert json.loads(out)["result"]["spectra"][0]["id"].startswith("=cmd\x1b")
    if kind == "--csv":
        assert next(csv.DictReader(io.StringIO(out)))["id"].startswith("'=cmd\\x1b")


DEEP, DIGITS = 100_000, 5000


@pytest.mark.parametrize(
    "content", ["[" * DEEP, '{"a":' * DEEP, f'{{"a": {"9" * DIGITS}}}', '{"a": 1e999}', f"[{2**63}]", "[1"]
)
def test_json_fails_in_one_way(content: str) -> None:
    with pytest.raises(json.JSONDecodeError):
        json_document(content)


@pytest.mark.parametrize("content", ["a=" + "[" * 5000 + "]" * 5000, "a=" + "9" * DIGITS, "a=" + "9" * 30, "a=[", "a"])
def test_toml_fails_in_one_way(content: str) -> None:
    import tomllib

    with pytest.raises(tomllib.TOMLDecodeError):
        toml_document(content)


def test_documents_are_what_their_parsers_say() -> None:
    assert json_document('{"a": [1, -2.5e3, "x", null, true]}') == {"a": [1, -2500.0, "x", None, True]}
    assert toml_document("a = 9223372036854775807\n[b]\nc = 1.5") == {"a": 2**63 - 1, "b": {"c": 1.5}}


def test_what_to_do_is_not_cut_in_its_middle() -> None:
    """Whole parts between semicolons stay at the end, as many as fit into half of the line."""
    do = "; steered_W_deg is 0 for wheels that stay straight; `lunarsci template telemetry` has all"
    assert shortened(f"log.csv: columns are missing: {'name, ' * 120}of each wheel{do}").endswith(f" …{do}")
