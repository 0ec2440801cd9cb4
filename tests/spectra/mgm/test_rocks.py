"""The README's table of boulders is what the fits give."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.mark.reference
@pytest.mark.slow
def test_the_table_of_boulders_is_current(reference_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every boulder under all eight continua converges; numbers as shown, to two in the last digit."""
    monkeypatch.setattr(sys, "path", [str(ROOT / "tests/benchmarks"), *sys.path])
    from rocks import rock_rows

    shown = re.findall(r"^\| (ce4-\d+-rock) \| (.+) \|$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE)
    rows = {row[0]: row[1:] for row in rock_rows(reference_data)}
    assert len(shown) == len(rows) == 9
    for name, cells in shown:
        for cell, now in zip(cells.split(" | "), rows[name], strict=True):
            numbers = [[float(x) for x in re.findall(r"\d+(?:\.\d+)?", text)] for text in (cell, now)]
            assert numbers[0]
            step = 0.02 if "." in cell else 2
            assert numbers[1] == pytest.approx(numbers[0], abs=step), (name, cell, now)
