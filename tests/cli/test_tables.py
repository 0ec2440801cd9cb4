"""Tables for people fit the terminal, digits follow the error, and other forms say the same."""

import csv
import io
import json
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from lunarsci.cli.shared.table import UNKNOWN, TextTable, fitted, plus_minus, render, to_markdown, to_tex, to_tsv

CELLS = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "Zs"), max_codepoint=0x2FF), max_size=90)
WIDE = TextTable(
    ["spectrum", "BC1000 [nm]", "spread 1 µm [nm]", "area1000 [nm]", "continuum at 1 µm", "BC2000 [nm]", "status"],
    [["one", "950.1 ± 2.3", "4", "70.0 ± 1.2", "conic", "1950 ± 12", "no 2 µm band where it is looked for"]] * 2,
    notes=["a note"],
)


@st.composite
def tables(draw: st.DrawFn) -> TextTable:
    columns = draw(st.integers(1, 9))
    row = st.lists(CELLS, min_size=columns, max_size=columns)
    notes = draw(st.lists(CELLS, max_size=2))
    return TextTable(draw(row), draw(st.lists(row, min_size=1, max_size=4)), title=draw(CELLS), notes=notes)


@settings(max_examples=60, deadline=None)
@given(tables(), st.integers(40, 160), st.booleans())
@example(TextTable(["0" * 4, "0" * 9, "", "", "", "0", ""], [["", "", "000", "000", "0" * 8, "", ""]]), 40, False)
def test_no_line_is_wider_than_the_terminal(table: TextTable, width: int, keep: bool) -> None:
    from rich.cells import cell_len

    assert max(map(cell_len, render([table], width, keep=keep).split("\n"))) <= width


def test_columns_go_by_their_rank_and_are_named() -> None:
    assert fitted(WIDE, 0) is WIDE
    assert list(fitted(WIDE, 200).headers) == list(WIDE.headers)
    seen = [set(fitted(WIDE, width).headers) for width in (45, 80, 90, 160)]
    assert seen[0] < seen[1] <= seen[2] < seen[3]
    assert {"spectrum", "BC1000 [nm]", "spread 1 µm [nm]"} <= seen[0], "a centre has its spread beside it"
    shown = render([WIDE], 60)
    assert "2 more columns (area1000" in shown and "spread 1 µm" in shown
    assert "a: no 2 µm band where it is looked for" in shown


def test_one_row_becomes_a_list() -> None:
    one = TextTable(WIDE.headers, WIDE.rows[:1])
    made = fitted(one, 60)
    assert list(made.headers) == ["spectrum", "one"]
    assert ["BC2000 [nm]", "1950 ± 12"] in [list(row) for row in made.rows]
    assert made.notes[0].startswith("status: no 2 µm band")


@pytest.mark.parametrize(
    ("value", "sigma", "within", "shown"),
    [
        (1234.5, 123.0, None, "1230 ± 120"),
        (0.98123, 0.00996, None, "0.981 ± 0.010"),
        (950.8525106503012, 0.083, None, "950.853 ± 0.083"),
        (-0.00001, 0.0031, None, "0.0000 ± 0.0031"),
        (5.0, None, None, "5.0"),
        (None, 1.0, None, "-"),
        (float("nan"), 1.0, None, "-"),
        (0.7, 0.0, None, UNKNOWN),
        (0.7, 1.8, (0.0, 1.0), UNKNOWN),
        (-52.6, 178.5, (0.0, 1.0), UNKNOWN),
        (391.2, 4.0, (0.0, 100.0), UNKNOWN),
    ],
)
def test_digits_follow_the_error(
    value: float | None, sigma: float | None, within: tuple[float, float] | None, shown: str
) -> None:
    assert plus_minus(value, sigma, within=within) == shown


def test_other_forms_hold_the_same_cells() -> None:
    table = TextTable(["a_b", "c | d [%]"], [["1 & 2", "±"], ["=cmd", "x"]], title="Title", notes=["50 % of them"])
    rows = list(csv.reader(io.StringIO(to_tsv([table])), delimiter="\t"))
    assert rows == [["# Title"], ["a_b", "c | d [%]"], ["1 & 2", "±"], ["'=cmd", "x"], ["# 50 % of them"]]
    lines = to_markdown([table]).splitlines()
    assert lines[0] == "**Title**"
    assert [line.count("|") - line.count("\\|") for line in lines[2:6]] == [3, 3, 3, 3]
    assert set(lines[3]) <= set("|-: ")
    tex = to_tex([table])
    assert r"a\_b & c | d [\%] \\" in tex and r"1 \& 2 & $\pm$ \\" in tex and r"\begin{tabular}{ll}" in tex


def test_formats_and_columns_of_a_command(run) -> None:
    forces = ("regolith", "forces", "--sinkage", "0.008", "--slip", "0:0.2:3")
    assert run(*forces, "--format", "csv").out == run(*forces, "--csv").out
    assert json.loads(run(*forces, "--format", "json", "--no-time").out)["result"]
    assert run(*forces, "--columns", "slip,PULL", "--format", "tsv").out.splitlines()[0] == "slip [-]\tpull [N]"
    chosen = run(*forces, "--csv", "--columns", "drawbar_pull_n").out.splitlines()
    assert chosen[0] == "drawbar_pull_n" and len(chosen) == 4
    assert run(*forces, "--columns", "slip_ratio,drawbar_pull_n").out.split()[:2] == ["slip_ratio", "drawbar_pull_n"]
    wrong = run(*forces, "--columns", "drawbar_pul_n")
    assert (wrong.code, len(wrong.err)) == (2, 1) and "did you mean 'drawbar_pull_n'" in wrong.err[0]
    for options in (["--format", "markdwn"], ["--json", "--format", "md"], ["--json", "--columns", "slip"]):
        assert run(*forces, *options).code == 2


def test_the_terminal_is_asked_and_a_file_is_not_cut(run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    forces = ("regolith", "forces", "--sinkage", "0.008", "--slip", "0:0.2:3")
    whole = run(*forces).out
    monkeypatch.setenv("COLUMNS", "60")
    narrow = run(*forces).out
    assert max(map(len, narrow.splitlines())) <= 60 < max(map(len, whole.splitlines()))
    assert "more column" in narrow
    run(*forces, "-o", tmp_path / "table.txt")
    assert (tmp_path / "table.txt").read_text("utf-8") == whole


def test_a_field_without_a_value_or_out_of_range_ends_with_3(run, rock: Path) -> None:
    chemistry = ("spectra", "bands", rock, "--field", "spectra.0.chemistry.fs_trend_bc1000")
    done = run(*chemistry[:-1], f"{chemistry[-1]}.value")
    assert done.code == 3 and float(done.out) and len(done.err) == 1
    assert "not to be used: the two centres are not those of an orthopyroxene" in done.err[0]
    assert run(*chemistry[:-1], f"{chemistry[-1]}.in_range").out == "false\n"
    assert run(*chemistry[:-1], f"{chemistry[-1]}.reason").code == 0
