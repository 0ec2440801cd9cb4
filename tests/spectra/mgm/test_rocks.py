"""The page's table of boulders is what the fits give."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]


@pytest.mark.reference
@pytest.mark.slow
def test_the_table_of_boulders_is_current(reference_data: Path, load_benchmark: Callable[[str], Any]) -> None:
    """Every boulder under all eight continua converges; numbers as shown, to two in the last digit."""
    shown = re.findall(
        r"^\| (ce4-\d+-rock) \| (.+) \|$", (ROOT / "docs/validation/rock.md").read_text("utf-8"), re.MULTILINE
    )
    rows = {row[0]: row[1:] for row in load_benchmark("rocks").rock_rows(reference_data)}
    assert len(shown) == len(rows) == 9
    for name, cells in shown:
        for cell, now in zip(cells.split(" | "), rows[name], strict=True):
            numbers = [[float(x) for x in re.findall(r"\d+(?:\.\d+)?", text)] for text in (cell, now)]
            assert numbers[0] or cell == now
            step = 0.02 if "." in cell else 2
            assert numbers[1] == pytest.approx(numbers[0], abs=step), (name, cell, now)
