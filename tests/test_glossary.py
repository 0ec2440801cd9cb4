"""The glossary names what is there, with the units that the names end in."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from lunarsci.units import unit_of

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs/glossary.md").read_text("utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split(" | ")]
    for line in TEXT.splitlines()
    if line.startswith("| ") and not line.startswith("| symbol")
]
WORDS = {
    word
    for path in (
        *(path for top in ("lunarsci", "cli") for path in (ROOT / top).rglob("*.py")),
        ROOT / "tests/former_results.json",
    )
    for word in re.findall(r"\w+", path.read_text("utf-8"))
}
"""Of the sources, and of what commands answer."""
WRITTEN = {"1 / m": "1/m", "": "-"}


def test_every_row_is_whole() -> None:
    assert len(ROWS) > 50
    assert [row for row in ROWS if len(row) != 5 or not all(row)] == []
    assert [row for row in ROWS if row[4] != "assumed" and not re.search(r"\((1[89]|20)\d\d\)", row[4])] == []


def test_a_name_is_used_and_has_its_unit() -> None:
    for unit, name in ((row[1], name) for row in ROWS for name in re.findall(r"`(\w+)`", row[2])):
        assert name in WORDS
        assert unit in ("mol %", "kPa/m^N") or WRITTEN.get(unit_of(name), unit_of(name)) == unit, name


def test_no_name_is_explained_twice() -> None:
    names = [name for row in ROWS for name in re.findall(r"`(\w+)`|^([a-z ]+)$", row[2])]
    assert len(names) == len(set(names))


def test_symbols_of_one_table_are_not_used_twice() -> None:
    for part in TEXT.split("\n## ")[1:]:
        symbols = [s for line in part.splitlines() if line.startswith("| ") and "symbol" not in line
                   for s in line.split("|")[1].strip().split(", ") if s != "-"]  # fmt: skip
        assert len(symbols) == len(set(symbols)), part[:20]


def test_every_key_of_a_result_is_described(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the page of JSON keys, made of this glossary, of what classes say, and of `key_meanings.toml`."""
    monkeypatch.syspath_prepend(str(ROOT / "docs/_extension"))
    import pages_of_commands

    tables = re.split(r"^## `lunarsci (.+)`$", pages_of_commands.keys_text(), flags=re.MULTILINE)
    shown = dict(zip(tables[1::2], tables[2::2], strict=True))
    rows = [(name, row) for name, text in shown.items() for row in text.splitlines() if row.startswith("| `")]
    assert len(shown) > 20 and len(rows) > 2500
    assert [(name, row) for name, row in rows if not row.strip("| ").split(" | ")[2:]] == []
    needed = {pages_of_commands.written_end(row.split("`")[1], name) for name, row in rows}
    written = tomllib.loads((ROOT / "docs/_extension/key_meanings.toml").read_text("utf-8"))
    assert {(name, end) for name, table in written.items() for end in table} - needed == set()
    for name in ("pages_of_commands", "pages_of_code"):
        sys.modules.pop(name, None)


MEANT = {
    "twin predict": {
        "verdict": "`go`, `no-go`, or `not-determined`",
        "failed": "drives that broke a limit",
        "members": "drives of the prediction",
        "limits[].limit": "largest or smallest safe value",
        "sensitivity[].share": "of the variance of the ends",
        "sweep.cohesion_pa.low": "smallest value of the drives' soils",
        "unresolved": "`deciding_m`",
    },
    "spectra match": {"rocks[].best": "name of the crater", "rocks[].craters[].prior": "before the rock's composition"},
    "spectra fit": {
        "spectra[].choice.sure": "0.93 or more",
        "spectra[].choice.open": "between 0.07 and 0.93",
        "spectra[].choice.not_needed": "0.07 or less",
        "spectra[].prior": "`damping`",
    },
    "spectra unmix": {"spectra[].kind.stated": "`--kind`", "spectra[].abundance.ratios.*.fraction": "mean of"},
    "regolith infer": {"joint.verdict.model": "name of the wheel-soil law", "joint.laws[].law": "name of the"},
    "regolith identify": {"wheel.of": "rover or wheel", "bearing.exponent.solved": "share of the Monte Carlo draws"},
    "twin compare": {"verdict": "`not contradicted`"},
}  # fmt: skip
"""What some keys are, by command: names that several classes have for something else each."""


@pytest.mark.parametrize("command", MEANT)
def test_a_key_is_described_as_the_key_of_its_own_command(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs/_extension"))
    import pages_of_commands

    text = pages_of_commands.keys_text(command)
    assert re.findall("^## .*", text, re.MULTILINE) == [f"## `lunarsci {command}`"]
    rows = {row.split("`")[1]: row for row in text.splitlines() if row.startswith("| `")}
    for key, words in MEANT[command].items():
        shown = [row for name, row in rows.items() if re.fullmatch(re.escape(key).replace(r"\*", r"\w+"), name)]
        assert shown and all(words in row for row in shown), (key, shown)
    assert [row for row in rows.values() if re.search(r"\bNone\b|\bNaN\b|\([nm], ", row)] == []


def test_words_that_a_key_is_described_by_are_those_that_are_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each `status` of one word is named in its description, and what is named as `ok` is written so somewhere."""
    monkeypatch.syspath_prepend(str(ROOT / "docs/_extension"))
    import pages_of_commands

    written: dict[tuple[str, str], set[str]] = {}
    for command, result in pages_of_commands.recorded():
        for key, value in pages_of_commands.keys_and_values(result):
            if key.rpartition(".")[2] in ("status", "kind"):
                written.setdefault((command, key), set()).add(str(value))
    glossary = pages_of_commands.meanings()
    for (command, key), values in written.items():
        _, meaning = pages_of_commands.meaning_of(key, glossary, command, set())
        single = {value for value in values if value and " " not in value and value.islower()}
        assert single <= set(re.findall("`([a-z_-]+)`", meaning)), (command, key, values)
        assert "`ok`" not in meaning or not all(" " in value for value in values), (command, key, values)


def test_the_program_of_make_keys_prints_those_of_a_command() -> None:
    program = ROOT / "docs/_extension/pages_of_commands.py"
    done = subprocess.run([sys.executable, program, "twin", "predict"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("## `lunarsci twin predict`\n") and "| `verdict` |" in done.stdout


def test_the_name_alone_does_not_say_whose_key_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chance has `failed` and `drives`; ScoredTrials has `failed`, and nothing that stands beside it here."""
    monkeypatch.syspath_prepend(str(ROOT / "docs/_extension"))
    import pages_of_code

    assert "broke a limit" in pages_of_code.attribute_beside("failed", {"failed", "drives", "risk"}, "twin")[1]
    assert pages_of_code.attribute_beside("failed", {"failed", "wavelength_nm"}, "twin") == ("", "")
