"""What a comparison teaches a belief of the twin's physics, and how it is shown."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lunarsci.errors import DataError
from lunarsci.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, read_belief
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.comparison.learning import Miss, taught

from .table import TextTable
from .twin_compare_report import Met

__all__ = ["Lesson", "discrepancy_table", "learn", "miss_rows"]


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """A belief before and after a comparison, and the file that takes the latter."""

    before: SoilBelief
    after: SoilBelief
    save: Path

    @property
    def extras(self) -> dict[Path, Callable[[], bytes]]:
        """The file that was asked for."""
        return {self.save: lambda: self.after.to_json().encode()}


def learn(met: Met, belief: str, save: Path) -> Lesson:
    """Teach the belief of a file. Raises DataError for one that knows the drive, and predictions of no belief."""
    source = read_input(belief)
    before, digest = read_belief(source), met.inputs[met.states]
    if met.meeting.forecast.soils != "belief":
        raise DataError(f"{met.meeting.forecast.origin}: predicted on ranges of soils, and teaches nothing of a belief")
    if before.discrepancy.has_scored(digest):
        raise DataError(f"{belief} has learned from {met.states} already; compare first, then update by the drive")
    met.inputs[belief] = source.sha256
    law = taught(met.meeting, before.discrepancy).with_score(
        states=Path(met.states).name, sha256=digest, plan=met.meeting.forecast.plan.name, how="comparison"
    )
    return Lesson(before, replace(before, discrepancy=law), save)


def miss_rows(miss: Miss | None) -> list[list[str]]:
    """The last position beside the middle of the soils, for people."""
    if miss is None:
        return []
    return [
        ["miss", "along, across (left)", f"{miss.along_m:+.3f} m, {miss.across_m:+.3f} m"],
        [
            "miss",
            "as shares of the way",
            f"{100 * miss.along_share:+.2f} %, {100 * miss.across_share:+.2f} % of {miss.way_m:.1f} m",
        ],
        [
            "miss",
            "1 sd of soils, place, physics",
            f"{miss.soil_m:.3f} m, {miss.position_m:.3f} m, {miss.physics_m:.3f} m",
        ],
    ]


def discrepancy_table(after: PhysicsDiscrepancy, before: PhysicsDiscrepancy | None = None) -> TextTable:
    """What the twin's physics is off by, for people; beside what was believed before."""
    headers = ["share", "68 %", "95 %", "rests on [drives]", *(["68 % before"] if before else [])]
    parts = {"way, along": "along", "way, across": "across", **{name: name for name in sorted(after.quantities)}}
    rows = []
    for label, key in parts.items():
        one, old = (_law(law, key) for law in (after, before or after))
        cells = [f"± {100 * one.half_width(p):.2g} %" for p in (0.68, 0.95)]
        rows.append(
            [label, *cells, f"{one.degrees:.1f}", *([f"± {100 * old.half_width(0.68):.2g} %"] if before else [])]
        )
    note = f"learned from {len(after.scored)} drive(s); regions of predictions hold it beside the soil's spread"
    return TextTable(headers, rows, title="What the twin's physics is off by, beside the soil", notes=[note])


def _law(law: PhysicsDiscrepancy, key: str) -> Any:
    return law.quantities[key] if key in law.quantities else getattr(law, key)
