"""A planned mission for people: its targets, and its legs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.twin.jobs.planned_mission import PlannedMission
    from lunarsci.twin.mission.legs import MissionLeg


def mission_tables(planned: PlannedMission) -> list[TextTable]:
    """What becomes of the targets, and the timetable of the legs."""
    return [_targets(planned), _legs(planned)]


def _targets(planned: PlannedMission) -> TextTable:
    driven, mission, chance = planned.driven, planned.driven.mission, planned.chance
    rows = [
        [
            one.target.name,
            one.fate,
            clock(one.arrival_s) if one.fate == "reached" else "-",
            f"{100 * one.kept.mean():.0f}" if one.fate == "reached" else "-",
        ]
        for one in driven.targets
    ]
    whole = driven.reached == len(driven.targets)
    chance_text = (
        f"kept with {100 * (1 - chance.risk):.0f} % ({100 * (1 - chance.high):.0f} to {100 * (1 - chance.low):.0f} %)"
    )
    verdict = chance_text if whole else f"{driven.reached} of {len(driven.targets)} targets reached"
    budget = "" if mission.time_budget_s == float("inf") else f" of {clock(mission.time_budget_s)}"
    notes = [
        *(f"{one.target.name}: {one.why}" for one in driven.targets if one.why),
        f"takes {clock(driven.end_s)}{budget}, of which {clock(driven.waited_s)} waiting for communication",
        *planned.soils.inputs.soil_notes(driven.kept.size, 0),
        *planned.notes(),
    ]
    headers = ["target", "fate", "arrival [h:min]", "kept [%]"]
    return TextTable(headers, rows, title=f"{mission.name}: {verdict}", notes=notes)


def _legs(planned: PlannedMission) -> TextTable:

    from lunarsci.twin.judgement.keeping import least_of_95

    rows = [_row(leg) for leg in planned.driven.legs]
    headers = ["leg", "to", "begin", "waited", "drive [min]", "m", "sd [m]", "kept [%]"]
    notes = ["begin and waited: h:min; sd: of the end, along its larger axis, before the rover is localised"]
    if charges := [leg.charge for leg in planned.driven.legs if leg.charge is not None]:
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
        f"{100 * leg.kept.mean():.0f}",
    ]


def clock(time_s: float) -> str:
    """Hours and minutes.

    >>> clock(3720.0)
    '1:02'
    """
    hours, minutes = divmod(round(time_s / 60), 60)
    return f"{hours}:{minutes:02d}"
