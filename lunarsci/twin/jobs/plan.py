"""A path to a target, around what a rover may not drive on."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from lunarsci.errors import RequestError
from lunarsci.result import request_of
from lunarsci.twin.jobs.terrain import Progress, SurveyedSite, TerrainRequest, TerrainSurvey, read_site

if TYPE_CHECKING:
    from lunarsci.twin.ground.hazards import Traversability
    from lunarsci.twin.routes.planner import PlannedPath


Place = str | tuple[float, ...]
PLACE = ("X", "Y", "HEADING")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRequest(TerrainRequest):
    """Where to plan a path to, with what rover, and on what ground.

    Attributes
    ----------
    target : x, y, and the heading there where it matters; numbers, or a text of them with commas. [m, m, deg]
    start : x, y, heading of the rover. [m, m, deg]
    speed : of the drive; the rover's highest where it is None. [m/s]
    turning_radius, hazard_distance : limits in place of the rover's: smallest radius of an arc, and distance to keep
        from hazards and holes. [m]
    """

    target: Place = ""
    start: Place = "0,0,0"
    speed: float | None = None
    turning_radius: float | None = None
    hazard_distance: float | None = None

    def __post_init__(self) -> None:
        if not self.target:
            raise RequestError("`target` says where the path shall end; give X,Y or X,Y,HEADING")
        for name, counts in (("start", (3,)), ("target", (2, 3))):
            object.__setattr__(self, name, _numbers(name, getattr(self, name), counts))

    def limits(self) -> dict[str, float | None]:
        of_a_path = {"min_turning_radius_m": self.turning_radius, "hazard_distance_m": self.hazard_distance}
        return TerrainRequest.limits(self) | of_a_path


def plan(
    terrain: str = "synthetic-longji",
    request: PlanRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> TerrainSurvey:
    """Look at a terrain as `terrain` does, and find a path to a target: arcs that keep the rover's limits.

    Raises DataError and RequestError, and ParameterError where there is no such path.
    """
    asked = request_of(PlanRequest, request, options)
    site = read_site(terrain, asked, asked.limits())
    surface = site.surface(asked.baseline, progress)
    return TerrainSurvey(site=site, surface=surface, path=_path(asked, site, surface, progress))


def _path(
    asked: PlanRequest, site: SurveyedSite, surface: "Traversability", progress: Progress | None
) -> "PlannedPath":
    from lunarsci.twin.assimilation.change_point import planned_places
    from lunarsci.twin.ground.keep_out import near_way
    from lunarsci.twin.plans.plan import read_plan
    from lunarsci.twin.plans.rover_check import limits_of_rover
    from lunarsci.twin.routes.planner import plan_path

    (x0, y0, heading), (x, y, *final) = (_numbers(name, getattr(asked, name), (2, 3)) for name in ("start", "target"))
    found = plan_path(
        surface,
        site.rover,
        (x0, y0, heading),
        (x, y),
        final_heading_deg=final[0] if final else None,
        speed_m_s=asked.speed,
        limits=limits_of_rover(read_plan().limits, site.description, site.rover),
        name=f"path to x {x:g} m, y {y:g} m on {site.terrain.name}",
        progress=progress,
    )
    near = near_way(site.keep_outs, planned_places(found.plan, site.rover))
    return replace(found, plan=replace(found.plan, made_for=site.made_for, exclusion_zones=near, crs=site.terrain.crs))


def _numbers(option: str, place: Place, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in (place.split(",") if isinstance(place, str) else place))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) not in counts:
        wanted = " or ".join(",".join(PLACE[:count]) for count in counts)
        raise RequestError(f"`{option}` '{place}' is not {wanted}, numbers with commas between them")
    return numbers
