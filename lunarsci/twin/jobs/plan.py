"""A path to a target around what a rover may not drive on; of many drives the one to take by its risk; a mission."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.errors import ParameterError, RequestError
from lunarsci.io.documents import geojson_feature
from lunarsci.io.inputs import Ground, read_input
from lunarsci.io.tables import csv_bytes
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Progress, job
from lunarsci.twin.assimilation.segments import planned_places
from lunarsci.twin.ground.driven_soil import OF_A_BELIEF, GivenSoil
from lunarsci.twin.ground.hazards import ExclusionZone, Traversability, near_way, rover_footprint
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.jobs.chosen_drive import (
    SOURCES,
    LocalGround,
    check_soils,
    check_start,
    chosen_drive,
    drive_conditions,
    final_heading_deg,
    limits_at,
    made_for_on,
    on_terrain,
    places_of,
    planned_power,
)
from lunarsci.twin.jobs.drive_inputs import SOURCES as OF_DRIVES
from lunarsci.twin.jobs.drive_inputs import Soils
from lunarsci.twin.jobs.requests import PlanRequest
from lunarsci.twin.jobs.terrain import SurveyedSite, TerrainSurvey, read_site
from lunarsci.twin.judgement.choice import Conditions
from lunarsci.twin.judgement.keeping import keeps_limits
from lunarsci.twin.judgement.quantities import least_of_95
from lunarsci.twin.mission.mission import (
    DrivenMission,
    Mission,
    MissionLeg,
    MissionTarget,
    Pose,
    drive_mission,
    read_mission,
)
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.plans.plan import Leg, Plan, plan_text, read_plan
from lunarsci.twin.plans.risk import USUAL, AcceptedRisk, Chance
from lunarsci.twin.routes.candidates import candidate_plans
from lunarsci.twin.routes.long_way import way_to
from lunarsci.twin.routes.planner import PlannedPath, nearest_room
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

WIDER = 2.0
"""Circles to keep out of grow by so many standard errors of a localised position; assumed."""
LOOKED_AT_M = 0.5
"""Between places of a leg about which ground is looked for. [m]"""
ALTERNATIVES = 8
"""Candidates among which one is looked for where no way leads on ahead."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedMission(TerrainSurvey):
    """A mission as it is expected.

    Attributes
    ----------
    soils : what is driven on.
    driven : legs, and what becomes of the targets.
    risk : chance that the mission is not kept that is accepted.
    file : of the mission, and its hash.
    """

    schema: ClassVar[str] = "twin-mission/1"
    soils: Soils
    driven: DrivenMission
    risk: AcceptedRisk
    file: tuple[str, str]

    @property
    def made_from(self) -> MadeFrom:
        made, inputs = TerrainSurvey._made_from(self), self.soils.inputs
        return replace(
            made,
            inputs={**made.inputs, **inputs.inputs, self.file[0]: self.file[1]},
            sources=[*dict.fromkeys([*made.sources, *OF_DRIVES, *SOURCES])],
            seed=self.soils.seed,
            options={**made.options, **inputs.options, "risk": self.risk.share},
        )

    @property
    def chance(self) -> Chance:
        """Of not keeping the whole mission."""
        return chance_of(self.driven.safe)

    @property
    def doubt(self) -> Doubt:
        missed = next((one for one in self.driven.targets if one.fate != "reached"), None)
        parts = [] if missed is None else [f"target '{missed.target.name}' is not reached, {missed.fate}: {missed.why}"]
        if missed is None and not self.risk.accepts(self.chance):
            chance, accepted = self.chance.risk, self.risk.share
            parts = [f"the mission is not kept with a chance of {chance:.2g}, {accepted:g} is accepted"]
        return Doubt.of(*parts, self.soils.doubt)

    def to_dict(self) -> dict[str, Any]:
        driven, mission = self.driven, self.driven.mission
        reached = [one.target.name for one in driven.targets if one.fate == "reached"]
        return {
            **TerrainSurvey.to_dict(self),
            "gravity_m_s2": self.site.rover.gravity_m_s2,
            "soil": self.soils.record(),
            "mission": {
                "name": mission.name,
                "risk": self.risk.share,
                "members": int(driven.safe.size),
                "kept": self.chance.to_dict(),
                "last_target": reached[-1] if reached else None,
                "reached": len(reached),
                "end_s": driven.end_s,
                "waited_s": driven.waited_s,
                "time_budget_s": mission.time_budget_s if np.isfinite(mission.time_budget_s) else None,
                "targets": [
                    {
                        "name": one.target.name, "x_m": one.target.x_m, "y_m": one.target.y_m, "fate": one.fate,
                        "why": one.why, "arrival_s": one.arrival_s, "kept": chance_of(one.safe).to_dict(),
                    }
                    for one in driven.targets
                ],
                "legs": self._legs(),
            },
        }  # fmt: skip

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return self._legs()

    def _legs(self) -> list[dict[str, Any]]:
        safe = np.ones_like(self.driven.safe)
        rows = []
        for leg in self.driven.legs:
            safe = safe & leg.safe
            rows.append(_leg_row(leg) | {"kept_so_far": float(safe.mean())})
        return rows

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.choice import mission_map, timetable

        yield mission_map(self.surface, self.driven)
        yield timetable(self.driven, synthetic=self.surface.terrain.synthetic)

    def files(self, *, geotiff: bool = False) -> dict[str, Callable[[], bytes]]:
        """Terrain and maps, the table of legs, a plan for each, and all of it as GeoJSON."""
        contents = TerrainSurvey.files(self, geotiff=geotiff)
        contents["legs.csv"] = lambda: csv_bytes(self._table())
        contents["mission.geojson"] = lambda: (json.dumps(geojson(self.driven), indent=1) + "\n").encode()
        for leg in self.driven.legs:
            contents[f"leg-{leg.number:03d}.toml"] = lambda leg=leg: plan_text(leg.plan).encode()  # type: ignore[misc]
        return contents

    def _table(self) -> "pd.DataFrame":
        import pandas as pd

        return pd.DataFrame(self.rows())

    def notes(self) -> list[str]:
        """What there is to say about ground and soils."""
        fixes = self.driven.mission.fixes
        return [
            *TerrainSurvey.notes(self),
            f"each leg begins where one drive, drawn by the seed, was localised with {fixes.position_sigma_m:g} m and "
            f"{fixes.heading_sigma_deg:g} deg; shares are of {self.driven.safe.size} drives, each with one soil",
        ]


def chance_of(safe: Any) -> Chance:
    """Of failing, counted over members."""
    return Chance(int((~safe).sum()), int(safe.size))


def _leg_row(leg: MissionLeg) -> dict[str, Any]:
    (xx, xy), (_, yy) = leg.covariance_m2
    charge = {}
    if leg.charge is not None:
        charge = {"charge_p50": float(np.median(leg.charge)), "charge_p05": least_of_95(leg.charge)}
    return {
        "leg": leg.number,
        "target": leg.target,
        "begin_s": leg.begin_s,
        "waited_s": leg.waited_s,
        "drive_s": leg.drive_s,
        "length_m": leg.plan.length_m,
        "x_m": leg.plan.x_m,
        "y_m": leg.plan.y_m,
        "heading_deg": leg.plan.heading_deg,
        "end_x_m": leg.fixed[0],
        "end_y_m": leg.fixed[1],
        "end_xx_m2": float(xx),
        "end_xy_m2": float(xy),
        "end_yy_m2": float(yy),
        "kept": float(leg.safe.mean()),
        **charge,
    }


def geojson(driven: DrivenMission) -> dict[str, Any]:
    """Legs as lines, targets as points, circles to keep out of as points with `keepout_m`; x, y in m of the terrain."""
    features = [
        geojson_feature("LineString", poses_along(leg.plan, 0.25)[:, :2].tolist(), {"kind": "leg", **_leg_row(leg)})
        for leg in driven.legs
    ]
    for one in driven.targets:
        about = {"kind": "target", "name": one.target.name, "fate": one.fate, "why": one.why}
        features.append(geojson_feature("Point", [one.target.x_m, one.target.y_m], about))
    for zone in driven.mission.keep_outs:
        circle = {"kind": "keep-out", "name": zone.name, "keepout_m": zone.radius_m}
        features.append(geojson_feature("Point", [zone.x_m, zone.y_m], circle))
    return {"type": "FeatureCollection", "name": driven.mission.name, "features": features}


def planned_mission(
    terrain: str | None, asked: PlanRequest, risk: AcceptedRisk, progress: Progress | None
) -> PlannedMission:
    """A mission, driven leg by leg over the soils that are believed.

    Raises DataError, RequestError, and ParameterError where targets lie outside the map.
    """
    source = read_input(asked.mission or "")
    mission, given = read_mission(source), GivenSoil.read(asked.soil)
    check_soils(asked, given)
    site = read_site(terrain, asked, given.named, asked.limits_of_ground())
    site.check.belief(given.name, given.belief)
    site.check.law(given.name, given.verdict)
    far = WIDER * mission.fixes.position_sigma_m
    wider = tuple(ExclusionZone(zone.name, zone.x_m, zone.y_m, zone.radius_m + far) for zone in mission.keep_outs)
    site = replace(site, keep_outs=site.keep_outs + wider)
    local = LocalGround.of(asked, site, site.surface(asked.baseline, progress), progress)
    site, surface = local.site, local.surface
    check_targets(mission, surface)
    swept = read_plan().sweep if given.file is None and not asked.sweep else ()
    soils, conditions, _ = drive_conditions(asked, site, given, (replace(_nominal(mission, site, asked), sweep=swept),))
    members = range(min(asked.members or OF_A_BELIEF, conditions.members))
    driven = drive_mission(
        mission,
        site.rover,
        _Ways(local, asked, mission.speed_m_s),
        lambda plan: _conditions_of(plan, local, soils, conditions).drive(plan, members),
        keeps_limits,
        seed=asked.seed or 0,
        goal_of=lambda target: beyond(target, surface, site.rover),
        power=planned_power(asked),
        progress=progress,
    )
    return PlannedMission(
        site=site, surface=surface, soils=soils, driven=driven, risk=risk, file=(source.name, source.sha256)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Ways:
    """Plans from a pose to a place, within the limits of the rover; a `Way` of a mission.

    Attributes
    ----------
    local : the site with its local terrains.
    asked : the request.
    mission_speed_m_s : speed of the mission's plans; None takes that of the request. [m/s]
    """

    local: LocalGround
    asked: PlanRequest
    mission_speed_m_s: float | None

    def __call__(self, pose: Pose, place: tuple[float, float]) -> Plan:
        """The cheapest path ahead; where there is none, one that turns about or goes backwards first."""
        local, site = self.local, self.local.site
        speed_m_s = self.mission_speed_m_s or self.asked.speed
        asked: dict[str, Any] = {"speed_m_s": speed_m_s, "limits": limits_at(site, self.asked)}
        try:
            plan = way_to(local.surface, site.rover, pose, place, local.finer, **asked).plan
        except ParameterError as error:
            try:
                ground = local.searched(np.array([pose[:2], place]))
                plan = candidate_plans(ground, site.rover, pose, place, most=ALTERNATIVES, **asked).plans[0]
            except (ParameterError, IndexError):
                raise error from None
        near = near_way(site.keep_outs, planned_places(plan, site.rover)) if site.keep_outs else ()
        made_for = made_for_on(site, _driven(plan, local))
        return replace(plan, made_for=made_for, exclusion_zones=near, crs=site.terrain.crs)


def _driven(plan: Plan, local: LocalGround) -> Terrain | None:
    """The finest ground about a leg; None where there are no local terrains."""
    return local.driven(poses_along(plan, LOOKED_AT_M)[:, :2])


def _conditions_of(plan: Plan, local: LocalGround, soils: Soils, conditions: Conditions) -> Conditions:
    """The same soils on the finest ground about a leg, where there are local terrains."""
    ground = _driven(plan, local)
    if ground is None:
        return conditions
    if conditions.grounds is None:
        return replace(conditions, terrain=ground)
    there = replace(soils, inputs=replace(soils.inputs, terrain=ground))
    return replace(conditions, terrain=ground, grounds=there.of_members()["grounds"])


def _nominal(mission: Mission, site: SurveyedSite, asked: PlanRequest) -> Plan:
    """Straight lines from target to target: along these a map of beliefs is read."""
    places = np.array([(mission.start.x_m, mission.start.y_m), *((one.x_m, one.y_m) for one in mission.targets)])
    heading, legs = mission.start.heading_deg, list[Leg]()
    for way in np.diff(places, axis=0):
        toward = float(np.degrees(np.arctan2(way[1], way[0])))
        turn = (toward - heading + 180.0) % 360.0 - 180.0
        legs += [*([Leg(turn_deg=turn)] if turn else []), *([Leg(float(np.hypot(*way)))] if way.any() else [])]
        heading = toward
    speed = mission.speed_m_s or site.rover.max_speed_m_s
    x, y = places[0]
    return Plan(name=mission.name, legs=tuple(legs), speed_m_s=speed, x_m=float(x), y_m=float(y),
                heading_deg=mission.start.heading_deg, limits=limits_at(site, asked))  # fmt: skip


def check_targets(mission: Mission, surface: Traversability) -> None:
    """Raises RequestError for start and targets outside the map, or in ground to keep out of."""
    terrain = surface.terrain
    places = [("start", mission.start.x_m, mission.start.y_m)]
    places += [(f"target '{one.name}'", one.x_m, one.y_m) for one in mission.targets]
    for name, x, y in places:
        if not (terrain.x_m[0] <= x <= terrain.x_m[-1] and terrain.y_m[0] <= y <= terrain.y_m[-1]):
            raise RequestError(
                f"`mission`: the {name} at x {x:g} m, y {y:g} m lies outside the map, x {terrain.x_m[0]:g} to "
                f"{terrain.x_m[-1]:g} m and y {terrain.y_m[0]:g} to {terrain.y_m[-1]:g} m"
            )
        zone = next((one for one in surface.keep_outs if np.hypot(x - one.x_m, y - one.y_m) <= one.radius_m), None)
        if zone is not None:
            raise RequestError(f"`mission`: the {name} lies in '{zone.name}', which is to be kept out of")


def beyond(target: MissionTarget, surface: Traversability, rover: Rover) -> tuple[float, float] | None:
    """The place with room for the rover that is nearest to a target on unknown ground; None where it is known."""
    row, column = surface.terrain.nodes(np.array([target.x_m, target.y_m]))
    if not surface.unknown[row, column]:
        return None
    return nearest_room(surface, (target.x_m, target.y_m), rover_footprint(rover).reach_m)


@job
def plan(
    terrain: "Ground | None" = None,
    request: PlanRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> TerrainSurvey:
    """Look at a terrain, `synthetic-longji` if None, and find a path to a target: arcs that keep the rover's limits.

    `terrain` is a file, or in memory an array of xarray or x (nx,), y (ny,) and heights (ny, nx) of nodes in metres.
    With `risk` many drives to it are compared on soils, and the result is a `ChosenDrive`; with `mission` several
    targets are reached leg by leg, and the result is a `PlannedMission`.

    Raises DataError and RequestError, and ParameterError where there is no such path.

    Examples
    --------
    >>> way = lunarsci.plan(target=(2.0, 0.3))
    >>> drive = lunarsci.predict(way, terrain=way)
    """
    asked = request_of(PlanRequest, request, options)
    risk = USUAL if asked.risk is None else AcceptedRisk(asked.risk)
    path = None if terrain is None else str(terrain)
    if asked.purpose == "mission":
        return planned_mission(path, asked, risk, progress)
    if asked.purpose == "choice":
        return chosen_drive(path, asked, risk, progress)

    if asked.soil and (several := GivenSoil.read(asked.soil)).file is not None:
        raise RequestError(
            f"`soil` {several.name} has many soils, and a path alone is looked for on one; give `risk`, which drives "
            "it on all of them, or leave `soil` out"
        )
    site = read_site(path, asked, next(iter(asked.soil), None), asked.limits_of_ground())

    check_start(asked, site)
    local = LocalGround.of(asked, site, site.surface(asked.baseline, progress), progress)
    way = _path(on_terrain(asked, site.terrain), local.site, local.surface, local.finer, progress)
    return TerrainSurvey(site=local.site, surface=local.surface, path=way, checked=local.checked(way))


def _path(
    asked: PlanRequest, site: SurveyedSite, surface: Traversability, finer: tuple[Traversability, ...],
    progress: Progress | None,
) -> PlannedPath:  # fmt: skip
    (x0, y0, heading), (x, y, *_) = places_of(asked)
    path = way_to(
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
    near = near_way(site.keep_outs, planned_places(path.plan, site.rover))
    plan = replace(path.plan, made_for=made_for_on(site), exclusion_zones=near, crs=site.terrain.crs)
    return replace(path, plan=plan)
