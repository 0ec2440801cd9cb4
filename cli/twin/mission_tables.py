"""A planned mission for people: its targets, and its legs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lunarsci.twin.jobs.plan import PlannedMission
from lunarsci.twin.judgement.quantities import least_of_95
from lunarsci.twin.mission.mission import MissionLeg

from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.twin.jobs.plan import PlannedMission
    from lunarsci.twin.mission.mission import MissionLeg


def mission_tables(found: PlannedMission) -> list[TextTable]:
    """What becomes of the targets, and the timetable of the legs."""
    return [_targets(found), _legs(found)]


def _targets(found: PlannedMission) -> TextTable:
    driven, mission, chance = found.driven, found.driven.mission, found.chance
    rows = [
        [
            one.target.name,
            one.fate,
            clock(one.arrival_s) if one.fate == "reached" else "-",
            f"{100 * one.safe.mean():.0f}" if one.fate == "reached" else "-",
        ]
        for one in driven.targets
    ]
    whole = driven.reached == len(driven.targets)
    kept = (
        f"kept with {100 * (1 - chance.risk):.0f} % ({100 * (1 - chance.high):.0f} to {100 * (1 - chance.low):.0f} %)"
    )
    verdict = kept if whole else f"{driven.reached} of {len(driven.targets)} targets reached"
    budget = "" if mission.time_budget_s == float("inf") else f" of {clock(mission.time_budget_s)}"
    notes = [
        *(f"{one.target.name}: {one.why}" for one in driven.targets if one.why),
        f"takes {clock(driven.end_s)}{budget}, of which {clock(driven.waited_s)} waiting for communication",
        *found.soils.inputs.soil_notes(driven.safe.size, 0),
        *found.notes(),
    ]
    headers = ["target", "fate", "arrival [h:min]", "kept [%]"]
    return TextTable(headers, rows, title=f"{mission.name}: {verdict}", notes=notes)


def _legs(found: PlannedMission) -> TextTable:

    rows = [_row(leg) for leg in found.driven.legs]
    headers = ["leg", "to", "begin", "waited", "drive [min]", "m", "sd [m]", "kept [%]"]
    notes = ["begin and waited: h:min; sd: of the end, along its larger axis, before the rover is localised"]
    if charges := [leg.charge for leg in found.driven.legs if leg.charge is not None]:
        headers.append("left [%]")
        rows = [[*row, f"{100 * least_of_95(charge):z.0f}"] for row, charge in zip(rows, charges, strict=True)]
        notes.append("left: of the battery at the end of the leg, in 95 % of the drives; below 0 what is missing")
    return TextTable(headers, rows, title="legs", notes=notes)


def _row(leg: MissionLeg) -> list[str]:
    return [
        str(leg.number),
        leg.target,
        clock(leg.begin_s),
        clock(leg.waited_s) if leg.waited_s else "-",
        f"{leg.drive_s / 60:.1f}",
        f"{leg.plan.length_m:.1f}",
        f"{leg.spread_m:.2f}",
        f"{100 * leg.safe.mean():.0f}",
    ]


def clock(time_s: float) -> str:
    """Hours and minutes.

    >>> clock(3720.0)
    '1:02'
    """
    hours, minutes = divmod(round(time_s / 60), 60)
    return f"{hours}:{minutes:02d}"
