"""What is believed of a soil, and of what the twin's physics is off by, as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..shared.table import TextTable, significant

if TYPE_CHECKING:
    from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy

ENDS = (("low", "high"), ("ground_low_68", "ground_high_68"))


def parameter_table(rows: Mapping[str, Mapping[str, float]], title: str, notes: Sequence[str] = ()) -> TextTable:
    """Effective values and the ground's own of each parameter, from `parameter_rows`."""
    cells = [
        [
            name,
            f"{row['median']:.4g}",
            *(f"{significant(row[low])} to {significant(row[high])}" for low, high in ENDS),
            f"{100 * row['left_of_prior']:.0f} %",
        ]
        for name, row in rows.items()
    ]
    headers = ["effective value", "median", "68 %", "ground's own 68 %", "width, of before any drive"]
    return TextTable(headers, cells, title=title, notes=notes)


def discrepancy_table(after: PhysicsDiscrepancy, before: PhysicsDiscrepancy | None = None) -> TextTable:
    """What the twin's physics is off by, for people; beside what was believed before."""
    from lunarsci.regolith.physics_discrepancy import FIRST

    headers = ["share", "68 %", "95 %", "worth [drives]", *(["68 % before"] if before else [])]
    parts = {"way, along": "along", "way, across": "across", **{name: name for name in sorted(after.quantities)}}
    rows = []
    for label, key in parts.items():
        one, old = (_law(law, key) for law in (after, before or after))
        cells = [f"± {100 * one.half_width(p):.2g} %" for p in (0.68, 0.95)]
        rows.append(
            [label, *cells, f"{one.degrees:.1f}", *([f"± {100 * old.half_width(0.68):.2g} %"] if before else [])]
        )
    count = len(after.scored)
    first = " and ".join(dict.fromkeys(f"{_law(FIRST, key).degrees:g}" for key in parts.values()))
    notes = [
        f"learned from {count} drive{'s' * (count != 1)}; predictions add it to what the soil is not known for",
        f"worth: as many drives would tell it as surely; {first} of them stand for the simulations it began with",
    ]
    return TextTable(headers, rows, title="What the twin's physics is off by, beside the soil", notes=notes)


def _law(law: PhysicsDiscrepancy, key: str) -> Any:
    return law.quantities[key] if key in law.quantities else getattr(law, key)
