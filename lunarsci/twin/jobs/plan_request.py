"""What `lunarsci.plan` is asked: where to, with what rover, on what ground, at what risk."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lunarsci.errors import DataError, RequestError
from lunarsci.heights.projections import projection_of
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.regolith.written_names import GROUND, written_in
from lunarsci.rovers import MadeFor
from lunarsci.twin.ground.illumination import SunDirection
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.jobs.terrain import MAKERS, GroundRequest, SurveyedSite
from lunarsci.twin.plans.made_for_check import limits_of_rover
from lunarsci.twin.plans.plan import Limit, read_limits, read_plan
from lunarsci.twin.simulation.ensemble import PowerState

Place = str | tuple[float, ...]
PLACE = ("X", "Y", "HEADING")
OF_A_CHOICE = ("sweep", "members", "tolerance", "candidates", "fixes", "prefer", "exact_terrain", "charge")
"""Options that ask for something only beside `risk`."""
IN_A_MISSION = ("target", "start", "lonlat", "tolerance", "candidates", "fixes", "prefer")
"""Options that a mission has in its file, or no use for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRequest(GroundRequest):
    """Where to plan a path to, with what rover, and on what ground.

    Attributes
    ----------
    target : x, y, and the heading there where it matters; numbers, or a text of them with commas. [m, m, deg]
    start : x, y, heading of the rover; or where a drive ended: the folder of `states` or `predict`, or a table of
        x_m, y_m, yaw_deg such as motion.csv, whose last row is taken. [m, m, deg]
    speed : of the drive; the rover's highest where it is None. [m/s]
    turning_radius, hazard_distance : limits in place of the rover's: smallest radius of an arc, and distance to keep
        from hazards and holes. [m]
    lonlat : start and target are longitude to the east and latitude, of a terrain with a coordinate system. [deg]
    soil : in place of the terrain's: a name or a TOML file; with `risk` also a file from which every drive has a soil
        of its own, as `predict` takes it.
    risk : chance that a limit is broken or the end missed that is accepted; then many drives are compared. None for the
        cheapest path on the maps. [-]
    prefer : of drives that keep the risk that with the least energy, length, time or risk.
    sweep : with `risk`: NAME=LOW:HIGH:N, uncertain parameters; those of the embedded plan where no soil is given.
    members : with `risk`: soils on which all candidates are driven; 64 where it is None.
    tolerance : with `risk`: distance of the end from the target that counts as there; the limit of the embedded plan
        where it is None. [m]
    candidates : with `risk`: drives that are compared, at most; 50 where it is None.
    fixes : with `risk`: M,DEG, standard errors of localisation updates, where drives may halt for some.
    exact_terrain : with `risk`: leave out that each drive has a ground of its own where the terrain's file says how far
        its heights may be off.
    charge : with `risk` or a mission: of the battery at the start, 0 to 1; then the battery is a limit, and `sun` also
        lights the panels. [-]
    limits : TOML file with [limits] that drives are judged by, such as a plan; what it leaves out, and all of it where
        it is None, is as of the rover and the embedded plan.
    local : files of finer terrains, in the first one's coordinates, that stand in its place where they are known: for
        ways and, with `risk` or a mission, for the drives.
    mission : TOML file of several targets with keep-outs, time and windows of communication, instead of a target;
        reached by legs with localisation between, over the soils; `risk` is then that of the whole, 0.05 if None.
    """

    target: Place = ""
    start: Place = "0,0,0"
    speed: float | None = None
    turning_radius: float | None = None
    hazard_distance: float | None = None
    lonlat: bool = False
    soil: tuple[str, ...] = ()
    risk: float | None = None
    prefer: Literal["energy", "length", "time", "risk"] = "energy"
    sweep: tuple[str, ...] = ()
    members: int | None = None
    tolerance: float | None = None
    candidates: int | None = None
    fixes: str | None = None
    exact_terrain: bool = False
    charge: float | None = None
    limits: str | None = None
    local: tuple[str, ...] = ()
    mission: str | None = None

    def __post_init__(self) -> None:
        if self.charge is not None and not 0 <= self.charge <= 1:
            raise RequestError(f"`charge` is {self.charge:g}; give a share from 0 to 1")
        if self.mission is not None:
            self._check_mission()
            return
        if not self.target:
            raise RequestError("`target` says where the path shall end; give X,Y or X,Y,HEADING")
        if self.start_files and self.lonlat:
            raise RequestError(f"`start` {self.start} is in m, and `lonlat` in deg; give its longitude and latitude")
        for name, counts in (("start", (3,)), ("target", (2, 3))):
            if name == "target" or not self.start_files:
                object.__setattr__(self, name, _numbers(name, getattr(self, name), counts))
        if self.risk is None:
            self._check_path()
        else:
            self._check_choice(self.risk)

    def _check_mission(self) -> None:
        """Of a mission the file says where."""
        defaults = {field.name: field.default for field in fields(self)}
        for name in IN_A_MISSION:
            if getattr(self, name) != defaults[name]:
                raise RequestError(f"`{name}` and `mission` do not go together: the mission's file says where; "
                                   "give one of them")  # fmt: skip
        if self.risk is not None and not 0 < self.risk < 1:
            raise RequestError(f"`risk` is {self.risk:g}; give a chance above 0 and below 1, such as 0.05")
        if self.members is not None and self.members < 2:
            raise RequestError(f"`members` is {self.members}; give 2 or more")

    def _check_path(self) -> None:
        """Without a risk nothing is chosen."""
        defaults = {field.name: field.default for field in fields(self)}
        for name in OF_A_CHOICE:
            if getattr(self, name) != defaults[name]:
                raise RequestError(f"`{name}` is for drives that are compared; give `risk`, too")
        if len(self.soil) > 1:
            raise RequestError("several soils are for drives that are compared; give `risk`, too, or one `soil`")

    def _check_choice(self, risk: float) -> None:
        if not 0 < risk < 1:
            raise RequestError(f"`risk` is {risk:g}; give a chance above 0 and below 1, such as 0.05")
        for name, least in (("members", 2), ("candidates", 1)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise RequestError(f"`{name}` is {value}; give {least} or more")
        if self.tolerance is not None and not 0 < self.tolerance < float("inf"):
            raise RequestError(f"`tolerance` is {self.tolerance:g}; give a distance above 0 m")

    @property
    def final_heading_deg(self) -> float | None:
        """The heading at the target, None where any will do. [deg]"""
        return self.places[1][2] if len(self.places[1]) == 3 else None

    @property
    def start_files(self) -> tuple[str, ...]:
        """The table that says where the rover stands; none where numbers do."""
        if not isinstance(self.start, str) or not Path(self.start).exists():
            return ()
        if not (folder := Path(self.start)).is_dir():
            return (self.start,)
        found = next((name for name in ("motion.csv", "paths.csv") if (folder / name).is_file()), None)
        if found is None:
            raise RequestError(
                f"`start` {self.start}: no motion.csv or paths.csv in it; give a folder of `twin states`"
            )
        return (str(folder / found),)

    def input_files(self) -> tuple[str, ...]:
        limits = () if self.limits is None else (self.limits,)
        return (*GroundRequest.input_files(self), *self.start_files, *limits)

    @property
    def places(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Start and target as numbers. [m, m, deg]"""
        start = last_pose(self.start_files[0]) if self.start_files else _numbers("start", self.start, (3,))
        return start, _numbers("target", self.target, (2, 3))

    def on(self, terrain: Terrain) -> "PlanRequest":
        """The same with start and target in m of a terrain. Raises DataError where it has no coordinate system."""
        if not self.lonlat:
            return self

        projection, moved = projection_of(terrain.crs, terrain.name), []
        for longitude, latitude, *heading in self.places:
            moved.append((*projection.metres(longitude, latitude)[0].tolist(), *heading))
        return replace(self, start=moved[0], target=moved[1], lonlat=False)

    def power(self) -> PowerState | None:
        """Battery and light; None where no charge is given. Raises RequestError."""

        sun = self.light()[0]
        if self.charge is None:
            return None
        return PowerState(charge=self.charge, sun=None if sun is None else SunDirection(*sun))

    def made(self, terrain: str) -> dict[str, Any]:
        """As of a ground; where soils are drawn the seed is theirs, too."""
        alone = (self.risk is None and self.mission is None) or terrain in MAKERS
        return GroundRequest.made(self if alone else replace(self, seed=None), terrain)

    def limits_of_ground(self) -> dict[str, float | None]:
        of_a_path = {"min_turning_radius_m": self.turning_radius, "hazard_distance_m": self.hazard_distance}
        return GroundRequest.limits_of_ground(self) | of_a_path


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
    known = np.isfinite(np.column_stack([*columns.values(), member])).all(axis=1)
    if not known.any():
        raise DataError(f"{path}: no row with a whole pose; is the file complete?")
    time = np.where(known, columns["time_s"], -np.inf)
    last = [
        own[np.argmax(time[own])] for own in (np.flatnonzero(known & (member == k)) for k in np.unique(member[known]))
    ]
    x, y = (float(np.median(columns[name][last])) for name in ("x_m", "y_m"))
    yaw = np.radians(columns["yaw_deg"][last])
    return x, y, float(np.degrees(np.arctan2(np.sin(yaw).mean(), np.cos(yaw).mean())))


def _numbers(option: str, place: Place, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in (place.split(",") if isinstance(place, str) else place))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) not in counts:
        wanted = " or ".join(",".join(PLACE[:count]) for count in counts)
        raise RequestError(f"`{option}` '{place}' is not {wanted}, numbers with commas between them")
    return numbers
