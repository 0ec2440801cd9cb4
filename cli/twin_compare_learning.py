"""What a comparison teaches a belief of the twin's physics, and how it is shown."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from lunarsci.errors import DataError
from lunarsci.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, read_belief
from lunarsci.twin.comparison.learning import Miss, taught

from .twin_compare_report import Met

__all__ = ["Lesson", "learn", "miss_rows"]


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
