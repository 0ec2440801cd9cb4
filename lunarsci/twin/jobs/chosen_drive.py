"""The drive to take, of many to a target: by its risk, on soils that all meet, on a site with finer terrains."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, RequestError
from lunarsci.heights.projections import projection_of
from lunarsci.io.tables import csv_bytes, numbers_of, read_csv_table
from lunarsci.regolith.columns import GROUND, written_in
from lunarsci.result import Doubt, MadeFrom, Progress
from lunarsci.rovers import MadeFor
from lunarsci.twin.assimilation.segments import planned_places
from lunarsci.twin.ground.driven_soil import OF_A_BELIEF, DrivenSoil, GivenSoil
from lunarsci.twin.ground.finer_ground import check_finer, driven_ground, lengths_checked, patch
from lunarsci.twin.ground.hazards import STRAY_M, Traversability, near_way, rover_footprint, swept_nodes
from lunarsci.twin.ground.illumination import SunDirection
from lunarsci.twin.ground.terrain import Terrain, terrain_bytes
from lunarsci.twin.jobs.drive_inputs import SOURCES as OF_DRIVES
from lunarsci.twin.jobs.drive_inputs import DriveInputs, Soils, parsed_fixes
from lunarsci.twin.jobs.requests import GroundRequest, PlanRequest, _numbers
from lunarsci.twin.jobs.terrain import SurveyedSite, TerrainSurvey, light_of, read_site
from lunarsci.twin.judgement.choice import Conditions, DriveChoice, choose, making_up_for_slip
from lunarsci.twin.judgement.safety import percent
from lunarsci.twin.plans.made_for_check import limits_of_rover
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.plans.plan import Limit, Plan, plan_text, read_limits, read_plan
from lunarsci.twin.plans.risk import AcceptedRisk
from lunarsci.twin.routes.candidates import MOST, CandidatePlans, candidate_plans
from lunarsci.twin.routes.long_way import LONG_M
from lunarsci.twin.routes.planner import PATH_STEP_M, PlannedPath, RouteSearch, measured_path, search_margin_m
from lunarsci.twin.simulation.ensemble import PowerState, member_parameters

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

CHECKED_EVERY_M = 0.1
FRESH = 2
"""Fresh soils for each one by which drives are chosen: 128 know a risk of 5 % to sqrt(0.05 x 0.95 / 128), 2 %."""
SOURCES = ["Brown, Cai & DasGupta (2001), Statist. Sci. 16, 101, 10.1214/ss/1009213286"]


def final_heading_deg(request: PlanRequest) -> float | None:
    """The heading at the target, None where any will do. [deg]"""
    return places_of(request)[1][2] if len(places_of(request)[1]) == 3 else None


def places_of(request: PlanRequest) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Start, with a heading, and target, as numbers: a start without one looks at the target. [m, m, deg]"""
    start, target = _places_of(request)
    if len(start) == 2:
        start = (*start, math.degrees(math.atan2(target[1] - start[1], target[0] - start[0])))
    return start, target


def _places_of(request: PlanRequest) -> tuple[tuple[float, ...], tuple[float, ...]]:
    start = last_pose(request.start_files[0]) if request.start_files else _numbers("start", request.start)
    return start, _numbers("target", request.target)


def on_terrain(request: PlanRequest, terrain: Terrain) -> PlanRequest:
    """The same with start and target in m of a terrain. Raises DataError where it has no coordinate system."""
    if not request.lonlat:
        return request

    projection, moved = projection_of(terrain.crs, terrain.name), []
    for longitude, latitude, *heading in _places_of(request):
        moved.append((*projection.metres(longitude, latitude)[0].tolist(), *heading))
    return replace(request, start=moved[0], target=moved[1], lonlat=False)


def planned_power(request: PlanRequest) -> PowerState | None:
    """Battery and light; None where no charge is given. Raises RequestError."""
    sun = light_of(request)[0]
    if request.charge is None:
        return None
    return PowerState(charge=request.charge, sun=None if sun is None else SunDirection(*sun))


def limits_at(site: SurveyedSite, asked: PlanRequest) -> tuple[Limit, ...]:
    """The limits of the embedded plan, with those of the rover in place, and those of the file that was asked for.

    Raises DataError for a file without limits, RequestError where two places say how far from the target is there.
    """
    assumed = limits_of_rover(read_plan().limits, site.rover)
    if asked.limits is None:
        return assumed
    given = {limit.quantity: limit for limit in read_limits(asked.limits)}
    if asked.tolerance is not None and "endpoint_miss_m" in given:
        raise RequestError(f"`tolerance` and endpoint_miss_m of {asked.limits} both limit the end; give one of them")
    return tuple(({limit.quantity: limit for limit in assumed} | given).values())


def made_for_on(site: SurveyedSite, ground: Terrain | None = None) -> MadeFor:
    """The rover, the limits and the ground of a site, for a plan; another `ground` where that is driven on."""
    return replace(site.made_for, ground=(site.terrain if ground is None else ground).written)


def check_start(asked: PlanRequest, site: SurveyedSite) -> None:
    """Warn where the drive whose end is the start is in doubt, or was on another ground than the path is planned on.

    Raises RequestError where no ground is named and it was on another than the stand-in.
    """
    for path in asked.start_files:
        table = read_csv_table(path)
        site.check.ground(path, written_in(path, table, GROUND))
        if "doubt" in table and (doubts := table["doubt"].dropna().unique()).size:
            site.check.say(f"the start is of a drive in doubt, check the pose: {path}: {'; '.join(doubts)}"[:300])


def last_pose(path: str) -> tuple[float, float, float]:
    """Where a drive ended: the last row of a motion, of several members the middle of their ends. [m, m, deg]

    Raises DataError for what has no x_m, y_m and yaw_deg.
    """
    table = read_csv_table(path)
    for name in ("time_s", "x_m", "y_m", "yaw_deg"):
        if name not in table:
            raise DataError(f"{path}: no column {name}; a start is read of motion.csv of `twin states`, or X,Y,HEADING")
    columns = {name: numbers_of(path, name, table[name]) for name in ("time_s", "x_m", "y_m", "yaw_deg")}
    member = numbers_of(path, "member", table["member"]) if "member" in table else np.zeros(len(table))
    complete = np.isfinite(np.column_stack([*columns.values(), member])).all(axis=1)
    if not complete.any():
        raise DataError(f"{path}: no row with a whole pose; is the file complete?")
    time = np.where(complete, columns["time_s"], -np.inf)
    last = [
        rows[np.argmax(time[rows])]
        for rows in (np.flatnonzero(complete & (member == k)) for k in np.unique(member[complete]))
    ]
    x, y = (float(np.median(columns[name][last])) for name in ("x_m", "y_m"))
    yaw = np.radians(columns["yaw_deg"][last])
    return x, y, float(np.degrees(np.arctan2(np.sin(yaw).mean(), np.cos(yaw).mean())))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalGround:
    """A site with its local terrains, the finest last; there may be none.

    Attributes
    ----------
    site : the first terrain, with the hashes of all.
    surface : its maps.
    finer : the maps of the local ones.
    likely : heights of all of them as they are likely to be, the first one first; empty where they are not driven on.
    """

    site: SurveyedSite
    surface: Traversability
    finer: tuple[Traversability, ...]
    likely: tuple[Terrain, ...] = ()

    @classmethod
    def of(
        cls, asked: PlanRequest, site: SurveyedSite, surface: Traversability, progress: Progress | None
    ) -> "LocalGround":
        """Raises DataError, and RequestError where heights have errors that drives on several terrains cannot have."""
        alone = GroundRequest(rover=asked.rover, keep_out=asked.keep_out)
        driven, inputs = asked.purpose != "path", dict(site.inputs)
        grounds: list[tuple[Traversability, Terrain]] = []
        for path in asked.local:
            local = read_site(path, alone, next(iter(_names(asked)), None), asked.limits_of_ground(), site.terrain.crs)
            check_finer(path, local.terrain, site.terrain)
            if driven and not asked.exact_terrain and (local.file.states_errors or site.file.states_errors):
                raise RequestError(
                    f"heights of {path if local.file.states_errors else site.terrain.name} have errors, and beside "
                    "`local` all are driven on as they are likely to be; give `exact_terrain`, too"
                )
            grounds.append((local.surface(asked.baseline, progress), likely_ground_of(local)))
            inputs |= local.inputs
        grounds.sort(key=lambda one: -one[0].terrain.spacing_m)
        return cls(
            site=replace(site, inputs=inputs),
            surface=surface,
            finer=tuple(one for one, _ in grounds),
            likely=(likely_ground_of(site), *(ground for _, ground in grounds)) if driven and grounds else (),
        )

    def searched(self, points_m: FloatArray) -> Traversability:
        """The maps on which ways between places (n, 2) are looked for; those of the site without finer ones near."""
        if not self.finer:
            return self.surface
        return patch(self.surface, self.finer, points_m, self._margin_m(points_m) + self.surface.terrain.spacing_m)

    def driven(self, points_m: FloatArray) -> Terrain | None:
        """What is driven on about places (n, 2); None without local terrains."""
        if not self.likely:
            return None
        return driven_ground(self.likely[0], self.likely[1:], points_m, self._margin_m(points_m) + STRAY_M)

    def _margin_m(self, points_m: FloatArray) -> float:
        return search_margin_m(rover_footprint(self.site.rover), float(np.hypot(*np.ptp(points_m, axis=0))))

    def on_site(self, path: PlannedPath) -> PlannedPath:
        """A path found on a patch, with the nodes of the site that it sweeps."""
        if not self.finer:
            return path
        poses = poses_along(path.plan, PATH_STEP_M)
        return replace(path, swept=swept_nodes(path.footprint, self.surface.terrain, poses))

    def checked(self, path: PlannedPath) -> list[dict[str, Any]]:
        """On how much of the path which terrain was looked at, the first one first; nothing without local ones."""
        if not self.finer:
            return []
        poses = poses_along(path.plan, CHECKED_EVERY_M)
        lengths = lengths_checked(poses, path.plan.length_m / len(poses), path.footprint, self.finer)
        terrains = (self.site.terrain, *(one.terrain for one in self.finer))
        return [
            {"terrain": terrain.name, "spacing_m": terrain.spacing_m, "length_m": length}
            for terrain, length in zip(terrains, (path.plan.length_m - sum(lengths), *lengths), strict=True)
        ]


def _names(asked: PlanRequest) -> Sequence[str]:
    """The soil of a path on the maps, which alone may be laid over a local terrain's own."""
    return asked.soil if asked.purpose == "path" else ()


def likely_ground_of(site: SurveyedSite, *, exact: bool = True) -> Terrain:
    """Heights as they are likely to be below a wheel, with what is not known of them unless they are `exact`."""
    as_read = replace(site.terrain, height_m=site.file.terrain.height_m, errors=None)
    likely = site.file.likely(as_read, site.rover.wheel.width_m)
    return replace(likely, errors=None) if exact else likely


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChosenDrive(TerrainSurvey):
    """Drives to a target, ranked by their chance of failing.

    Attributes
    ----------
    soils : what is driven on.
    choice : the candidates, best first.
    tolerance_m : distance of the end from the target that counts as there. [m]
    ground : what is driven on, where that is not the site's terrain alone.
    few : why there are fewer candidates than were asked for; '' where there are not.
    members : soils by which drives are chosen; the promises are of `fresh_members` others.
    """

    schema: ClassVar[str] = "twin-plan/1"
    soils: Soils
    choice: DriveChoice
    tolerance_m: float
    members: int
    fresh_members: int
    ground: Terrain | None = None
    few: str = ""

    @property
    def made_from(self) -> MadeFrom:
        made, inputs = TerrainSurvey._made_from(self), self.soils.inputs
        return replace(
            made,
            inputs={**made.inputs, **inputs.inputs},
            sources=[*dict.fromkeys([*made.sources, *OF_DRIVES, *SOURCES])],
            seed=self.soils.seed,
            options={**made.options, **inputs.options},
        )

    @property
    def doubt(self) -> Doubt:
        return Doubt.of("" if self.choice.feasible else self.why_none, self.soils.doubt)

    @property
    def why_none(self) -> str:
        """All limits that the safest drive breaks, where no drive keeps the risk."""
        best, choice = self.choice.best, self.choice
        broken = ", ".join(one.short for one in best.broken)
        return (
            f"no drive keeps a risk of {100 * choice.risk.share:g} %, so there is no plan.toml; drive {best.number}, "
            f"the safest of {len(choice.candidates)}, fails on {percent(best.stated.risk)} of the soils "
            f"({percent(best.stated.low)} to {percent(best.stated.high)}): {broken}"
        )

    @property
    def scouting(self) -> str:
        """A drive that would teach the soil, where the belief has learned from others or from none."""
        belief = self.soils.inputs.given.belief
        return (
            "another short drive near the start" if belief and belief.history else "a short drive near the start first"
        )

    @property
    def what_next(self) -> str:
        """What may help where no drive keeps the risk, by what is broken."""
        soil = {"slip_ratio", "side_slip_deg", "sinkage_m", "unfinished", "motor_torque_nm", "motor_load"}
        best = self.choice.best
        broken = {one.quantity for one in best.broken}
        help_for = {
            "another target, or ground that is less steep or less soft": soil | {"tilt_deg", "clearance_m"},
            f"{self.scouting}, from which `twin update` learns the soil": soil | {"endpoint_miss_m"},
            "--fixes, a nearer target or a wider --tolerance": {"endpoint_miss_m", "keep_out_m"},
            "more charge or Sun": {"battery_charge"},
            "--limits FILE, as its limits are assumed": {one.quantity for one in best.plan.limits if one.assumed},
        }
        advice = "; ".join(what for what, quantities in help_for.items() if quantities & broken)
        if any(one.plan.fixes for one in self.choice.candidates):
            advice = advice.replace("--fixes, ", "")
        names = ", ".join(f"plan-{one.number:02d}.toml" for one in self.choice.front)
        return (
            f"what may help: {advice or 'another target'}, or a higher --risk; `twin predict` says more of the drives "
            f"that no other beats, which -o DIR writes as {names}"
        )

    def to_dict(self) -> dict[str, Any]:
        choice = self.choice
        return {
            **TerrainSurvey.to_dict(self),
            "gravity_m_s2": self.site.rover.gravity_m_s2,
            "soil": self.soils.record(),
            "choice": {
                "risk": choice.risk.share,
                "prefer": choice.prefer,
                "tolerance_m": self.tolerance_m,
                "feasible": choice.feasible,
                "best": choice.best.number if choice.feasible else None,
                "why_none": None if choice.feasible else self.why_none,
                "members": self.members,
                "fresh_members": self.fresh_members,
                "drives": sum(one.chance.drives for one in choice.candidates),
                "front": [one.number for one in choice.front],
                "broken": [] if choice.feasible else [one.short for one in choice.best.broken],
                "stands_in_the_way": [{"quantity": name, "candidates": count} for name, count in choice.obstacles],
                "candidates": [one.to_dict() for one in choice.candidates],
            },
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [_row(one.to_dict()) for one in self.choice.candidates]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.choice import candidate_map, front_page

        yield candidate_map(self.surface, self.choice)
        yield front_page(self.choice)
        yield from TerrainSurvey.figures(self)

    def files(self, *, geotiff: bool = False) -> dict[str, Callable[[], bytes]]:
        """Those of a path, where one is feasible; the table of candidates, and the plans that none beats."""
        contents = TerrainSurvey.files(self, geotiff=geotiff)
        if (ground := self.ground) is not None:
            contents["driven-terrain.npz"] = lambda: terrain_bytes(ground, made_for=self.site.made_for)
        contents["candidates.csv"] = lambda: csv_bytes(self._table())
        for one in self.choice.front:
            contents[f"plan-{one.number:02d}.toml"] = lambda one=one: plan_text(one.plan).encode()  # type: ignore[misc]
        return contents

    def _table(self) -> "pd.DataFrame":
        import pandas as pd

        return pd.DataFrame(self.rows())

    def notes(self) -> list[str]:
        """What there is to say about ground and soils."""
        kind = self.soils.kind
        ranges = "shares of the ranges, not probabilities, " if kind == "sweep" else ""
        assumed = [one.quantity for one in self.choice.best.plan.limits if one.assumed]
        fresh = f"{self.fresh_members} fresh ones" if self.choice.fresh else "the same ones: there are no others"
        return [
            *([self.few] if self.few else []),
            *TerrainSurvey.notes(self),
            *([f"assumed limits of the drives: {', '.join(assumed)}"] if assumed else []),
            f"risks are {ranges}counted on {self.members} soils, those of the best drives on {fresh}; the bounds "
            "include the number of drives alone, and no error of soil, ground or physics beyond what is drawn",
        ]


def _row(record: Mapping[str, Any]) -> dict[str, Any]:
    """One line of the table of candidates."""
    chance_of = record["promised"] or record["screened"]
    plain = {name: record[name] for name in ("number", "name", "length_m", "duration_s", "energy_j")}
    chance = {name: chance_of[name] for name in ("drives", "failed", "risk", "risk_low", "risk_high")}
    worst = {
        f"worst_{name}": record["worst"][name] for name in ("quantity", "value", "limit", "x_m", "y_m", "distance_m")
    }
    marks = {"promised": record["promised"] is not None, **{n: record[n] for n in ("stopped_early", "pareto")}}
    return {**plain, "localisation_updates": record["localisation_updates"], **chance, **marks, **worst}


def chosen_drive(terrain: str | None, asked: PlanRequest, risk: AcceptedRisk, progress: Progress | None) -> ChosenDrive:
    """CandidatePlans to the target, driven over the soils that are believed, and the one to take.

    Raises DataError, RequestError, and ParameterError where no path leads there.
    """
    given = GivenSoil.read(asked.soil)
    site = read_site(terrain, asked, given.named, asked.limits_of_ground())
    check_asked(asked, risk)
    site.check.belief(given.name, given.belief)
    site.check.law(given.name, given.verdict)
    check_start(asked, site)
    local = LocalGround.of(asked, site, site.surface(asked.baseline, progress), progress)
    asked, site = on_terrain(asked, site.terrain), local.site
    ends = np.array([place[:2] for place in places_of(asked)])
    surface, ground = local.searched(ends), local.driven(ends)
    check_soils(asked, given)
    (x0, y0, heading), (x, y, *_) = places_of(asked)
    search = RouteSearch.of(surface, site.rover, (x0, y0, heading), (x, y), final_heading_deg(asked))
    candidates = candidates_of(asked, site, search, given, risk, progress, ground)
    plans: Sequence[Plan] = candidates.plans
    soils, conditions, members = drive_conditions(asked, site, given, plans, ground)
    plans = making_up_for_slip(plans, conditions, members, progress)
    choice = choose(plans, conditions, risk=risk, prefer=asked.prefer, members=members, progress=progress)
    path = None
    if choice.feasible:
        path = local.on_site(measured_path(search, choice.best.plan))
    tolerance = next(limit.limit for limit in plans[0].limits if limit.quantity == "endpoint_miss_m")
    fresh = conditions.members - members
    return ChosenDrive(
        site=site, surface=local.surface, path=path, soils=soils, choice=choice, tolerance_m=tolerance,
        members=members, fresh_members=fresh, ground=ground,
        few="" if len(plans) >= (asked.candidates or MOST) else candidates.why_no_more,
        checked=() if path is None else local.checked(path),
    )  # fmt: skip


def check_asked(asked: PlanRequest, risk: AcceptedRisk) -> None:
    """Raises RequestError where so few drives can never promise the risk, and for a target that is too far away."""
    (x0, y0, _), (x, y, *_) = places_of(asked)
    if (far := math.hypot(x - x0, y - y0)) > LONG_M:
        raise RequestError(
            f"`target` is {far:.0f} m away, and `risk` compares drives of up to {LONG_M:g} m; give a nearer one"
        )
    if (asked.members or OF_A_BELIEF) < risk.least_drives:
        raise RequestError(
            f"`risk` {risk.share:g} takes {risk.least_drives} `members` or more; give them, or accept more risk"
        )


def check_soils(asked: PlanRequest, given: GivenSoil) -> None:
    """Raises RequestError where there is one soil alone."""
    if given.file is None and not asked.sweep and asked.soil:
        what = "risk" if asked.mission is None else "mission"
        raise RequestError(
            f"`{what}` counts drives over soils, and `soil` {given.named} is one; give a file of soils as `soil`, or "
            "`sweep` NAME=LOW:HIGH:N"
        )


def candidates_of(
    asked: PlanRequest,
    site: SurveyedSite,
    search: RouteSearch,
    given: GivenSoil,
    risk: AcceptedRisk,
    progress: Progress | None = None,
    ground: Terrain | None = None,
) -> CandidatePlans:
    """Plans to compare, with the limits asked for, the tolerance, and the circles that each comes near to.

    `ground` is what they are driven on instead of the site's terrain.
    """
    (x0, y0, heading), (x, y, *_) = places_of(asked)
    limits = limits_at(site, asked)
    if asked.tolerance is not None:
        end = Limit("endpoint_miss_m", "m", asked.tolerance, "tolerance of the end from the target", False)
        limits = tuple(end if one.quantity == end.quantity else one for one in limits)
    searched = candidate_plans(
        search.surface,
        site.rover,
        (x0, y0, heading),
        (x, y),
        final_heading_deg=final_heading_deg(asked),
        speed_m_s=asked.speed,
        limits=limits,
        fixes=None if asked.fixes is None else parsed_fixes(asked.fixes),
        most=asked.candidates or MOST,
        progress=progress,
    )
    swept = read_plan().sweep if given.file is None and not asked.sweep else ()
    near = [
        near_way(site.keep_outs, planned_places(plan, site.rover)) if site.keep_outs else () for plan in searched.plans
    ]
    made = tuple(
        replace(
            plan,
            made_for=made_for_on(site, ground),
            exclusion_zones=zones,
            sweep=swept,
            crs=site.terrain.crs,
            accepted_risk=risk,
        )
        for plan, zones in zip(searched.plans, near, strict=True)
    )
    return searched._replace(plans=made)


def drive_conditions(
    asked: PlanRequest, site: SurveyedSite, given: GivenSoil, plans: Sequence[Plan], ground: Terrain | None = None
) -> tuple[Soils, Conditions, int]:
    """What is driven on, as the result says it and as it is drawn, and how many of the soils plans are chosen by.

    `ground` is what is driven on instead of the site's terrain.
    """
    members, seed = asked.members or OF_A_BELIEF, asked.seed or 0
    total = (1 + FRESH) * members
    ground = likely_ground_of(site, exact=asked.exact_terrain) if ground is None else ground
    inputs = _inputs(site, given, plans[0], ground)
    rows_of_file = given.of == "samples"
    soils = Soils.of(inputs, asked.sweep or None, None if rows_of_file else total, seed)
    of = soils.of_members()
    samples = of.get("samples")
    if samples is None and "grounds" in of:
        samples = of["grounds"].parameters
    if samples is None:
        samples = member_parameters(plans[0].sweep if of["sweep"] is None else of["sweep"], total, seed)
    if rows_of_file:
        samples = _shuffled(samples, total, seed)
    total = len(next(iter(samples.values())))
    errors = of["terrain"].errors
    conditions = Conditions(
        rover=of["rover"],
        terrain=of["terrain"],
        samples=samples,
        grounds=of.get("grounds"),
        draws=None if errors is None else errors.draws(total, seed),
        discrepancy=soils.discrepancy,
        ruts=of["ruts"],
        seed=seed,
        power=planned_power(asked),
    )
    return soils, conditions, members if total > members else total


def _shuffled(samples: Mapping[str, Any], most: int, seed: int) -> dict[str, Any]:
    """Rows of a file in an order of their own, so that those that come first are like the others."""
    count = len(next(iter(samples.values())))
    order = np.random.default_rng([seed, 29]).permutation(count)[:most]
    return {name: values[order] for name, values in samples.items()}


def _inputs(site: SurveyedSite, given: GivenSoil, plan: Plan, ground: Terrain) -> DriveInputs:
    """The site as something to drive on."""
    belief = given.belief
    hashes = {} if given.file is None else {given.name: given.file.sha256}
    return DriveInputs(
        rover=site.rover,
        description=site.description,
        terrain=ground,
        plan=plan,
        inputs={**site.inputs, **hashes},
        tables=dict(site.tables),
        driven=site.driven if belief is None else DrivenSoil(given.name, given.origin),
        given=given,
        check=site.check,
        ruts=None,
    )
