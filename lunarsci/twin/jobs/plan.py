"""A path to a target around what a rover may not drive on; of many drives the one to take by its risk; a mission."""

from dataclasses import replace
from typing import Any

from lunarsci.errors import RequestError
from lunarsci.options import request_of
from lunarsci.result import job
from lunarsci.twin.assimilation.segments import planned_places
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.ground.keep_out import near_way
from lunarsci.twin.jobs.chosen_drive import chosen_drive
from lunarsci.twin.jobs.given_soil import GivenSoil
from lunarsci.twin.jobs.local_ground import LocalGround
from lunarsci.twin.jobs.plan_request import (
    check_start,
    final_heading_deg,
    limits_at,
    made_for_on,
    on_terrain,
    places_of,
)
from lunarsci.twin.jobs.planned_mission import planned_mission
from lunarsci.twin.jobs.requests import PlanRequest
from lunarsci.twin.jobs.terrain import Progress, SurveyedSite, TerrainSurvey, read_site
from lunarsci.twin.routes.long_way import way_to
from lunarsci.twin.routes.planner import PlannedPath


@job
def plan(
    terrain: str | None = None,
    request: PlanRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> TerrainSurvey:
    """Look at a terrain, `synthetic-longji` if None, and find a path to a target: arcs that keep the rover's limits.

    With `risk` many drives to it are compared on soils, and the result is a `ChosenDrive`; with `mission` several
    targets are reached leg by leg, and the result is a `PlannedMission`.

    Raises DataError and RequestError, and ParameterError where there is no such path.
    """
    asked = request_of(PlanRequest, request, options)
    if asked.mission is not None:
        return planned_mission(terrain, asked, progress)
    if asked.risk is not None:
        return chosen_drive(terrain, asked, progress)

    if asked.soil and (several := GivenSoil.read(asked.soil)).file is not None:
        raise RequestError(
            f"`soil` {several.name} has many soils, and a path alone is looked for on one; give `risk`, which drives "
            "it on all of them, or leave `soil` out"
        )
    site = read_site(terrain, asked, next(iter(asked.soil), None), asked.limits_of_ground())

    check_start(asked, site)
    local = LocalGround.of(asked, site, site.surface(asked.baseline, progress), progress)
    path = _path(on_terrain(asked, site.terrain), local.site, local.surface, local.finer, progress)
    return TerrainSurvey(site=local.site, surface=local.surface, path=path, checked=local.checked(path))


def _path(
    asked: PlanRequest, site: SurveyedSite, surface: Traversability, finer: tuple[Traversability, ...],
    progress: Progress | None,
) -> PlannedPath:  # fmt: skip

    (x0, y0, heading), (x, y, *_) = places_of(asked)
    found = way_to(
        surface,
        site.rover,
        (x0, y0, heading),
        (x, y),
        final_heading_deg=final_heading_deg(asked),
        speed_m_s=asked.speed,
        limits=limits_at(site, asked),
        name=f"path to x {x:g} m, y {y:g} m on {site.terrain.name}",
        progress=progress,
        finer=finer,
    )
    near = near_way(site.keep_outs, planned_places(found.plan, site.rover))
    plan = replace(found.plan, made_for=made_for_on(site), exclusion_zones=near, crs=site.terrain.crs)
    return replace(found, plan=plan)
