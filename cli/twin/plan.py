"""`lunarsci twin plan`: a path to a target."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from lunarsci.twin.jobs.requests import PlanRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import SPREAD, Output, option
from ..shared.table import TextTable
from .terrain import LIMITS, GeoTiff, NamedTerrain, check_files, ground_table
from .terrain import OPTIONS as OF_TERRAIN

if TYPE_CHECKING:
    from lunarsci.twin.jobs.chosen_drive import ChosenDrive
    from lunarsci.twin.jobs.plan import PlannedMission
    from lunarsci.twin.jobs.terrain import TerrainSurvey
    from lunarsci.twin.judgement.choice import DriveCandidate
    from lunarsci.twin.mission.mission import MissionLeg
    from lunarsci.twin.plans.plan import Leg
    from lunarsci.twin.routes.planner import PlannedPath


PATH, CHOICE = "Path", "Drives compared by their risk"
OPTIONS = {
    "target": option(panel=PATH, metavar="X,Y[,HEADING]", kind=str, show_default=False),
    "start": option(panel=PATH, metavar="X,Y[,HEADING]|DRIVE", kind=str),
    "lonlat": option(panel=PATH),
    "local": option(panel=PATH, metavar="FILE"),
    "speed": option(panel=PATH),
    "turning_radius": option(panel=LIMITS),
    "limits": option(panel=LIMITS, metavar="FILE", show_default="assumed of the rover"),
    "hazard_distance": option(panel=LIMITS),
    "risk": option(panel=CHOICE),
    "prefer": option(panel=CHOICE),
    "soil": option(show_default="the terrain's, or longji"),
    "sweep": option(panel=CHOICE, metavar="NAME=LOW:HIGH:N"),
    "members": option(panel=CHOICE, show_default="64"),
    "tolerance": option(panel=CHOICE, show_default="1"),
    "candidates": option(panel=CHOICE, show_default="50"),
    "fixes": option(panel=CHOICE, metavar="M,DEG[,S]"),
    "mission": option(panel=PATH, metavar="FILE", show_default=False),
    "exact_terrain": option(panel=CHOICE),
    "charge": option(panel=CHOICE, show_default="the battery does not count"),
    **{name: text for name, text in OF_TERRAIN.items() if name != "soil"},
}
SHORT = {
    "slip_ratio": "slip", "side_slip_deg": "sideslip", "sinkage_m": "sinkage", "tilt_deg": "tilt",
    "clearance_m": "clearance", "keep_out_m": "keep-out", "endpoint_miss_m": "end", "unfinished": "stuck",
    "motor_torque_nm": "torque", "motor_load": "motors", "battery_charge": "battery",
}  # fmt: skip
"""Words for limits where a table has little room."""
SHOWN = 12
"""Candidates in the table for people; those whose plans are written are all in it."""
EXAMPLES = (
    "lunarsci twin plan --target 8.5,2.5 -o site",
    "lunarsci twin plan --target 2,0.3 --risk 0.3 --members 4 --candidates 3",
)


@command("plan", EXAMPLES, OPTIONS, folder=True, blocks=SPREAD)
def plan(output: Output, request: PlanRequest, terrain: NamedTerrain = None, geotiff: GeoTiff = False) -> Report:
    """A path to a target that keeps the limits of a rover, on the maps of `twin terrain`.

    -o DIR writes the path to plan.toml, path.csv and path.geojson, the terrain to terrain.npz, the maps to maps.npz:
    `lunarsci twin predict DIR/plan.toml --terrain DIR/terrain.npz` drives it. Plan and terrain keep the rover and the
    limits that they were made for.

    With --risk many drives are compared: round other sides of obstacles, backwards, crabwise, after a spot turn, with
    --fixes also with halts for localisation updates. All are driven on the same soils, and the best again on fresh
    ones, from which the promised risk is counted. Exit code 3: no drive keeps the risk. -o DIR writes the drive to take
    to plan.toml, with the accepted risk, which `twin predict` then uses; candidates.csv has all drives, plan-NN.toml
    those that no other beats in risk, length and energy.

    With --mission several targets are reached by legs, each planned from where the rover was localised. The result has
    the probability to keep all limits, when each leg begins, what waits for communication, and the last target that
    fits. Exit code 3: a target is not reached, or the probability is too small. -o DIR writes leg-NNN.toml, the
    timetable legs.csv and the map mission.geojson.
    """
    from lunarsci.twin.jobs import plan as job

    check_files(output, soil=bool(request.soil) and request.purpose == "path", geotiff=geotiff)
    survey = job.plan(terrain, request, progress=output.progress("planning"))
    return Report(survey, result_tables(survey), files=survey.files(geotiff=geotiff))


def result_tables(survey: TerrainSurvey) -> list[TextTable]:
    """A mission's targets and legs, or the drives to choose from and the way, or the way and the ground."""
    from lunarsci.twin.jobs.chosen_drive import ChosenDrive
    from lunarsci.twin.jobs.plan import PlannedMission

    if isinstance(survey, PlannedMission):
        return mission_tables(survey)
    way = [] if survey.path is None else [_path_table(survey, survey.path)]
    return [_choice_table(survey), *way] if isinstance(survey, ChosenDrive) else [*way, ground_table(survey)]


def _choice_table(survey: ChosenDrive) -> TextTable:
    """The best candidates, one line each, best first."""
    from lunarsci.names import counted

    choice = survey.choice
    shown = [one for place, one in enumerate(choice.candidates) if place < SHOWN or one.pareto]
    best, rows = choice.best, [_candidate_row(one) for one in shown]
    stopped = sum(one.stopped for one in choice.candidates)
    verdict = f"take drive {best.number}, {best.plan.name}" if choice.feasible else "NO-GO: no drive keeps the risk"
    verdict = f"doubtful: {verdict}" if survey.soils.doubt else verdict
    accepted = f"{100 * choice.risk.share:g} %"
    longer = best.plan.commanded_m / max(best.length_m, 1e-9) - 1.0
    held = f"plan.toml states the accepted risk, {accepted}, and `twin predict` judges by it"
    notes = [
        *survey.soils.doubt.reasons,
        *([] if choice.feasible else [survey.what_next]),
        f"drive {best.number} fails on {_percent(best.stated.risk)} % of the soils, at most on "
        f"{_percent(best.stated.high)} %; it takes {best.duration_s / 60:.1f} min",
        f"its weakest place is x {best.weakest.x_m:z.2f} m, y {best.weakest.y_m:z.2f} m: {best.weakest.why}",
        *(
            [f"its commands are {100 * longer:.0f} % longer than its way, to make up for slip"]
            if longer >= 0.005
            else []
        ),
        *([held] if choice.feasible else []),
        "risk %: share of the soils on which a drive fails; to %: the risk is below this with 95 % confidence; ~: the "
        "drive was not tried on fresh soils",
        "m and J: length of the way, and work of the wheels; limit: the one that most drives break, or else come "
        "nearest to, and at m: where on the way",
        "m left and m right: how far a way leads beside the straight line",
        "*: no other drive has less risk, length and energy at once",
        *([f"{counted(stopped, 'drive')} of {len(choice.candidates)} stopped early, as hopeless"] if stopped else []),
        *([f"--csv lists {counted(more, 'drive')} more"] if (more := len(choice.candidates) - len(rows)) else []),
        f"a drive fails that ends farther than {survey.tolerance_m:g} m from the target",
        *survey.soils.inputs.soil_notes(survey.members, 0),
        *survey.notes(),
    ]
    headers = ["no", "drive", "risk %", "to %", "m", "J", "limit", "at m"]
    return TextTable(headers, rows, title=f"{verdict}; accepted: {accepted}", notes=notes)


def _candidate_row(one: DriveCandidate) -> list[str]:
    weak, energy = one.weakest, "-" if one.energy_j != one.energy_j else f"{one.energy_j:.0f}"
    unsure = "" if one.promise is not None else "~"
    return [
        f"{one.number}{'*' if one.pareto else ''}",
        one.plan.name,
        f"{unsure}{_percent(one.stated.risk)}",
        _percent(one.stated.high),
        f"{one.length_m:.1f}",
        energy,
        SHORT[weak.quantity],
        f"{weak.distance_m:z.1f}",
    ]


def _percent(chance: float) -> str:
    return f"{100 * chance:.1f}" if chance < 0.02 else f"{100 * chance:.0f}"


def _path_table(survey: TerrainSurvey, path: PlannedPath) -> TextTable:
    limits = survey.site.mobility
    rows = [
        [str(number), f"{arc.length_m:.3f}", f"{arc.curvature_per_m:.4f}", _radius(arc.curvature_per_m)]
        for number, arc in enumerate(path.plan.legs, start=1)
    ]
    headers = ["arc", "length [m]", "curvature [1/m]", "radius [m]"]
    if any(leg.turn_deg or leg.crab_deg or leg.wheel_test for leg in path.plan.legs):
        headers.append("driven")
        rows = [[*row, _driven(leg)] for row, leg in zip(rows, path.plan.legs, strict=True)]
    end = path.end
    notes = [
        f"starts at x {path.plan.x_m:z.3f} m, y {path.plan.y_m:z.3f} m, heading {path.plan.heading_deg:z.1f} deg",
        f"{path.plan.length_m:.3f} m long, ends at x {end[0]:.3f} m, y {end[1]:.3f} m, "
        f"heading {math.degrees(end[2]):.1f} deg, {1e3 * path.miss_m:.1f} mm from the target",
        *_place_notes(path, survey.light()),
        f"under the footprint: slope {path.max_slope_deg:.2f} of {limits.max_slope_deg:g} deg, step "
        f"{_metres(path.max_step_m)} of {limits.max_step_m:g} m; nearest hazard {path.min_hazard_distance_m:.2f} m, "
        f"{limits.hazard_distance_m:g} m to be kept",
        *(
            f"{one['length_m']:.1f} m looked at on {one['terrain']}, every {one['spacing_m']:g} m"
            for one in survey.checked
        ),
    ]
    return TextTable(headers, rows, title=path.plan.name, notes=notes)


def _driven(leg: Leg) -> str:
    if leg.turn_deg:
        return f"turn {leg.turn_deg:+.1f}°"
    if leg.wheel_test is not None:
        return f"wheel {leg.wheel_test.wheel} at {leg.wheel_test.rate_ratio:g}"
    return {0.0: "ahead", 180.0: "backwards"}.get(leg.crab_deg, f"crab {leg.crab_deg:+.1f}°")


def _place_notes(path: PlannedPath, light: Mapping[str, Any]) -> list[str]:
    """Longitude and latitude of the end, and the share of the path in shadow, where these are known."""
    from lunarsci.heights.projections import lonlat_of

    end = lonlat_of(path.plan.crs, path.end[:2].tolist())
    notes = [f"ends at longitude {end['longitude_deg']:.6f} deg, latitude {end['latitude_deg']:.6f} deg"] if end else []
    return notes + ([f"in shadow: {light['sun']['path_shadow_share']:.1%} of the path"] if light else [])


def _metres(length_m: float) -> str:
    return "unknown" if math.isnan(length_m) else f"{length_m:.3f}"


def _radius(curvature_per_m: float) -> str:
    return f"{1.0 / abs(curvature_per_m):.2f}" if abs(curvature_per_m) > 1e-4 else "-"


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
            f"{100 * one.safe.mean():.0f}" if one.fate == "reached" else "-",
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
        f"the mission takes {clock(driven.end_s)}{budget}; for {clock(driven.waited_s)} of it the rover waits for "
        "communication",
        *planned.soils.inputs.soil_notes(driven.safe.size, 0),
        *planned.notes(),
    ]
    headers = ["target", "fate", "arrival [h:min]", "kept [%]"]
    return TextTable(headers, rows, title=f"{mission.name}: {verdict}", notes=notes)


def _legs(planned: PlannedMission) -> TextTable:
    from lunarsci.twin.judgement.quantities import least_of_95

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
        f"{100 * leg.safe.mean():.0f}",
    ]


def clock(time_s: float) -> str:
    """Hours and minutes.

    >>> clock(3720.0)
    '1:02'
    """
    hours, minutes = divmod(round(time_s / 60), 60)
    return f"{hours}:{minutes:02d}"
