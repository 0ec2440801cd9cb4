"""What `lunarsci.plan` is asked: where to, with what rover, on what ground, at what risk."""

from dataclasses import replace

import numpy as np

from lunarsci.errors import DataError, RequestError
from lunarsci.heights.projections import projection_of
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.regolith.columns import GROUND, written_in
from lunarsci.rovers import MadeFor
from lunarsci.twin.ground.illumination import SunDirection
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.jobs.requests import PlanRequest, _numbers
from lunarsci.twin.jobs.terrain import SurveyedSite, light_of
from lunarsci.twin.plans.made_for_check import limits_of_rover
from lunarsci.twin.plans.plan import Limit, read_limits, read_plan
from lunarsci.twin.simulation.ensemble import PowerState


def final_heading_deg(request: PlanRequest) -> float | None:
    """The heading at the target, None where any will do. [deg]"""
    return places_of(request)[1][2] if len(places_of(request)[1]) == 3 else None


def places_of(request: PlanRequest) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Start and target as numbers. [m, m, deg]"""
    start = last_pose(request.start_files[0]) if request.start_files else _numbers("start", request.start, (3,))
    return start, _numbers("target", request.target, (2, 3))


def on_terrain(request: PlanRequest, terrain: Terrain) -> PlanRequest:
    """The same with start and target in m of a terrain. Raises DataError where it has no coordinate system."""
    if not request.lonlat:
        return request

    projection, moved = projection_of(terrain.crs, terrain.name), []
    for longitude, latitude, *heading in places_of(request):
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
