"""What the jobs of this part can be asked: every option with its meaning, its type and its default.

The command line reads it at every start: it imports no module that computes.
"""

from dataclasses import dataclass, fields, replace
from math import inf
from pathlib import Path
from typing import Any, Literal

from lunarsci.errors import RequestError
from lunarsci.heights import HeightUnit
from lunarsci.options import check_intervals, refuse_where
from lunarsci.ranges import CHANCE, POSITIVE, SHARE, refuse

MADE = {
    "seed": "seed",
    "spacing": "spacing_m",
    "rocks": "rock_share",
    "roughness": "rms_m",
    "extent": "extent_m",
    "ground_slope": "slope_deg",
    "craters": "craters",
}
"""Options of synthetic ground, and what its makers call them."""
OF_LONGJI = ("seed", "spacing", "rocks", "roughness")
MAKERS = {"synthetic-longji": OF_LONGJI, "synthetic": tuple(MADE)}
OF_A_CHOICE = ("sweep", "members", "tolerance", "candidates", "fixes", "prefer", "exact_terrain", "charge")
"""Options that ask for something only beside `risk`."""
IN_A_MISSION = ("target", "start", "lonlat", "tolerance", "candidates", "fixes", "prefer")
"""Options that a mission has in its file, or no use for."""
LONGEST_LAG_S = 30.0
"""Beyond which clocks are to be set, as with `start_time`; assumed. [s]"""
UNCERTAIN = ("states", "belief", "draws", "correlation", "balance_error", "iterate")


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverOnGround:
    """What drives where.

    Attributes
    ----------
    rover : Rover: a name (yutu2, small-four) or a TOML file.
    terrain : Terrain: synthetic-longji, or a file (.npz, GeoTIFF, PDS3, PDS4, ISIS, netCDF, ESRI ASCII .asc, CSV of
        nodes).
    height_unit : Unit of the terrain's heights, in place of what its file states.
    gravity : Gravity: moon, mars, earth, or a number in m/s².
    interpolation : Ground between nodes: smooth (continuous gradient) or triangles (as in the paper).
    """

    rover: str | None = None
    terrain: str | None = None
    height_unit: HeightUnit | None = None
    gravity: str | None = None
    interpolation: str = "smooth"

    @property
    def heights_without_unit(self) -> bool:
        """Whether a terrain was given and not what unit its heights are in."""
        return self.terrain is not None and self.height_unit is None

    @property
    def ground(self) -> tuple[str | None, str | None, str, HeightUnit | None, str | None]:
        """The same in the order of `read_drive_inputs`."""
        return self.rover, self.terrain, self.interpolation, self.height_unit, self.gravity


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundRequest:
    """With what rover in mind to look at a terrain, and how to make one.

    Attributes
    ----------
    rover : Rover: a name (yutu2, small-four) or a TOML file.
    height_unit : Unit of the terrain's heights, in place of what its file states.
    gravity : Gravity: moon, mars, earth, or a number in m/s².
    baseline : Side in m of the square whose slope is measured; the rover's by default.
    max_slope : Steepest slope, in deg.
    max_step : Highest step, in m.
    max_roughness : Largest roughness, in m.
    seed : Seed.
    spacing : Grid spacing, in m.
    rocks : Share of ground under rocks; 0.0021 at Chang'E-4.
    roughness : Rms height of waves of 0.4 to 4 m, in m.
    extent : Side of the square in m; not of Longji.
    ground_slope : Slope along x in deg; not of Longji.
    craters : Number of craters; not of Longji.
    keep_out : Ground that no part of the rover may enter (GeoJSON), as `images rocks -o FILE.geojson` writes it;
        repeatable.
    layer : Raster on any grid (GeoTIFF, .asc, .npz, .csv) of factors on the cost of a metre, or with --class of classes
        of ground; repeatable.
    classes : What a class of the layers costs: a factor, or forbidden, such as 3=forbidden; repeatable.
    sun : Direction of the Sun in deg, from x towards y and over the horizon: shadows go to the maps.
    shadow_cost : With `sun`, factor on the cost of a metre in shadow, or forbidden.
    """

    rover: str | None = None
    height_unit: HeightUnit | None = None
    gravity: str | None = None
    baseline: float | None = None
    max_slope: float | None = None
    max_step: float | None = None
    max_roughness: float | None = None
    seed: int | None = None
    spacing: float | None = None
    rocks: float | None = None
    roughness: float | None = None
    extent: float | None = None
    ground_slope: float | None = None
    craters: int | None = None
    keep_out: tuple[str, ...] = ()
    layer: tuple[str, ...] = ()
    classes: tuple[str, ...] = ()
    sun: str | None = None
    shadow_cost: str | None = None

    def made(self, terrain: str) -> dict[str, Any]:
        """What the maker of synthetic ground is told. Raises RequestError for what another terrain has no use for."""
        given = {name: value for name in (*MADE, "height_unit") if (value := getattr(self, name)) is not None}
        for name in given:
            if name not in MAKERS.get(terrain, ("height_unit",)):
                raise RequestError(f"`{name}` does not apply to {terrain}; leave it out")
        return {MADE[name]: value for name, value in given.items() if name in MADE}

    def input_files(self) -> tuple[str, ...]:
        """Files of the user beside the terrain and the keep-outs."""
        return tuple(self.layer)

    def limits_of_ground(self) -> dict[str, float | None]:
        """Limits that were given in place of the rover's, by name."""
        return {"max_slope_deg": self.max_slope, "max_step_m": self.max_step, "max_roughness_m": self.max_roughness}


@dataclass(frozen=True, slots=True, kw_only=True)
class TerrainRequest(GroundRequest):
    """The same, with the soil of the terrain that is written.

    Attributes
    ----------
    soil : With -o, soil of terrain.npz in place of the terrain's: a name or a TOML file.
    """

    soil: str | None = None


Place = str | tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRequest(GroundRequest):
    """Where to plan a path to, with what rover, and on what ground.

    Attributes
    ----------
    target : Where to plan a path to, in m; with the heading there, in deg.
    start : Place of the rover, in m, and its heading, in deg: towards the target if left out. Or where a drive ended:
        the folder of `twin states` or `twin predict`, or a motion.csv.
    speed : Speed in m/s; the rover's highest if left out.
    turning_radius : Smallest radius of an arc, in m; not less than the wheels allow, whose pivots must lie within it.
    hazard_distance : Distance to keep from hazards and holes, in m.
    lonlat : Start and target are longitude to the east and latitude in deg, on a terrain with a coordinate system.
    soil : Soil, in place of the terrain's: a name or a TOML file. With `risk` a file from which each drive has its own,
        as of `twin predict`: a belief of `twin update` or its map (JSON), or CSV.
    risk : Compare drives to the target, and take the best whose probability of breaking a limit or missing the target
        is at most this, such as 0.05.
    prefer : Of the drives that keep the risk, take the one with the least of this.
    sweep : Uncertain soil parameter, such as friction_angle_deg=30:50:3, repeatable; those of the embedded plan where
        no soil is given.
    members : Soils on which all are driven; the best again on twice as many.
    tolerance : Distance in m of the end from the target that counts as there.
    candidates : Drives to compare, at most.
    fixes : Let drives halt for localisation updates, with these standard errors and the standstill in s that each
        takes, such as 0.1,2,600.
    exact_terrain : Drive on the likely ground, not on one that is drawn for each drive.
    charge : Charge of the battery at the start, 0 to 1; the battery is a limit then, and `sun` also lights the panels.
    limits : TOML file with the mission's limits, such as a plan; risk is counted against them, and they go into the
        plan. What it leaves out is as assumed of the rover.
    local : Finer terrain in the same coordinates, looked at in place of the first one where it is known; repeatable.
    mission : Reach several targets by legs: TOML file with tables target, fixes, keep_out and window, and
        time_budget_s.
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
        check_intervals(self, {SHARE: "charge", CHANCE: "risk"})
        if self.purpose == "mission":
            self._check_mission()
            return
        refuse_where({
            "`target` says where the path shall end; give X,Y or X,Y,HEADING": not self.target,
            f"`start` {self.start} is in m, and `lonlat` in deg; give its longitude and latitude":
                self.lonlat and bool(self.start_files),
        })  # fmt: skip
        for name in ("start", "target"):
            if name == "target" or not self.start_files:
                object.__setattr__(self, name, _numbers(name, getattr(self, name)))
        if self.purpose == "path":
            self._check_path()
        else:
            check_intervals(self, {"[2, inf)": "members", "[1, inf)": "candidates", POSITIVE: "tolerance"})

    def _check_mission(self) -> None:
        """Of a mission the file says where."""
        refuse((
            f"`{name}` and `mission` do not go together: the mission's file says where; give one of them"
            for name in self._given(IN_A_MISSION)
        ), kind=RequestError)  # fmt: skip
        check_intervals(self, {"[2, inf)": "members"})

    def _check_path(self) -> None:
        """Without a risk nothing is chosen."""
        refuse_where({
            **{f"`{one}` is for drives that are compared; give `risk`, too": True for one in self._given(OF_A_CHOICE)},
            "several soils are for drives that are compared; give `risk`, too, or one `soil`": len(self.soil) > 1,
        })  # fmt: skip

    def _given(self, names: tuple[str, ...]) -> list[str]:
        """Those of some options that are not as they are without being given."""
        defaults = {field.name: field.default for field in fields(self)}
        return [name for name in names if getattr(self, name) != defaults[name]]

    @property
    def purpose(self) -> Literal["path", "choice", "mission"]:
        """What is planned: a path alone, the choice of a drive by its risk, or a mission of several legs."""
        return "mission" if self.mission is not None else "path" if self.risk is None else "choice"

    @property
    def start_files(self) -> tuple[str, ...]:
        """The table that says where the rover stands; none where numbers do."""
        if not isinstance(self.start, str) or not Path(self.start).exists():
            return ()
        if not (folder := Path(self.start)).is_dir():
            return (self.start,)
        from lunarsci.io.tables import table_in

        table = table_in(folder, "motion") or table_in(folder, "paths")
        if table is None:
            raise RequestError(
                f"`start` {self.start}: no motion.csv or paths.csv in it; give a folder of `twin states`"
            )
        return (str(table),)

    def input_files(self) -> tuple[str, ...]:
        limits = () if self.limits is None else (self.limits,)
        return (*GroundRequest.input_files(self), *self.start_files, *limits)

    def made(self, terrain: str) -> dict[str, Any]:
        """As of a ground; where soils are drawn the seed is theirs, too."""
        alone = self.purpose == "path" or terrain in MAKERS
        return GroundRequest.made(self if alone else replace(self, seed=None), terrain)

    def limits_of_ground(self) -> dict[str, float | None]:
        of_a_path = {"min_turning_radius_m": self.turning_radius, "hazard_distance_m": self.hazard_distance}
        return GroundRequest.limits_of_ground(self) | of_a_path


def _numbers(option: str, place: Place) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in (place.split(",") if isinstance(place, str) else place))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) not in (2, 3):
        raise RequestError(f"`{option}` '{place}' is not X,Y or X,Y,HEADING, numbers with commas between them")
    return numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveRequest(RoverOnGround):
    """How to drive a plan.

    Attributes
    ----------
    soil : Soil, in place of the terrain's: a name or a TOML file; or a file from which each drive has its own: CSV with
        a row each; or the JSON or draws of `regolith infer`, or the JSON, belief or map of `twin update`, from which 64
        are drawn unless `members` is given; or `priors`, or a file of `template prior`: what is believed before any
        drive. Repeatable: a name beside a CSV that lacks parameters.
    sweep : Uncertain soil parameter, such as friction_angle_deg=30:50:3, repeatable; replaces the plan's sweeps.
    members : Number of drives: samples of the ranges instead of the grid of all values, or draws.
    fixes : Position fixes after each leg: standard errors in position and heading, and the standstill in s that each
        takes, such as 0.1,2,600.
    seed : Seed of everything random.
    time_step : Longest time step in s.
    sample : Distance between recorded states in m.
    """

    soil: tuple[str, ...] = ()
    sweep: tuple[str, ...] = ()
    members: int | None = None
    fixes: str | None = None
    seed: int | None = None
    time_step: float = 0.1
    sample: float = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class PoweredRequest(DriveRequest):
    """How to drive, where battery and light may count.

    Attributes
    ----------
    sun : Direction of the Sun in deg, azimuth from x towards y (as headings) and elevation over the horizon; or time
        (UTC) and place, TIME@LON,LAT, where x is east and y north. Adds panels, shadow of the terrain and the battery.
    charge : Charge of the battery at the start, 0 to 1; adds electrical power and the battery.
    """

    sun: str | None = None
    charge: float | None = None

    def __post_init__(self) -> None:
        check_intervals(self, {SHARE: "charge"})


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictRequest(PoweredRequest):
    """How to drive a plan that is to be judged.

    Attributes
    ----------
    ruts : Whether wheels meet the ruts that others, and they themselves, left. If left out, with `soil` of a belief in
        as many drives as its last drive makes probable, else in none.
    before : A plan that was driven on the same ground before; its ruts are met, too.
    exact_terrain : Drive on the likely ground. Without it each drive has a ground of its own, drawn from what an
        elevation model of `images dem` or `images merge` says of its errors, or from the Moon's roughness where nodes
        lie wider apart than a wheel is large.
    keep_out : Ground that no part of the rover may enter (GeoJSON), as `images rocks -o FILE.geojson` writes it;
        repeatable.
    as_written : Take the numbers of soil, rover, terrain and states as they are written. Without it lunarsci asks
        about a number that would be likely in another unit, and the result is not to be trusted.
    risk : Accepted probability of breaking a limit or not ending, such as 0.05, in place of the plan's. Without either
        95 % of the drives must keep each limit, and all must end. No drive may enter ground to keep out of.
    """

    ruts: bool | None = None
    before: str | None = None
    exact_terrain: bool = False
    keep_out: tuple[str, ...] = ()
    as_written: bool = False
    risk: float | None = None

    def __post_init__(self) -> None:
        PoweredRequest.__post_init__(self)
        check_intervals(self, {CHANCE: "risk"})


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulateDriveRequest(RoverOnGround):
    """How to drive, and how well the rover is seen.

    Attributes
    ----------
    soil : The true soil, in place of the terrain's: a name or a TOML file.
    ruts : Whether wheels meet the ruts that others, and they themselves, left. If left out, with `soil` of a belief in
        as many drives as its last drive makes probable, else in none.
    before : A plan that was driven on the same ground before; its ruts are met, too.
    fix_distance : Way between localised positions in m.
    fix_sigma : Their standard error in m, in x and in y; a third of 4 % of the way between them by default.
    yaw_sigma : Standard error of the heading in degrees; assumed.
    track_sigma : Standard error of the track's depth in m.
    seed : Seed of everything random.
    time_step : Longest time step in s.
    sample : Way between rows of telemetry in m.
    """

    soil: str | None = None
    ruts: bool | None = None
    before: str | None = None
    fix_distance: float = 0.5
    fix_sigma: float | None = None
    yaw_sigma: float = 0.1
    track_sigma: float = 0.00033
    seed: int = 0
    time_step: float = 0.05
    sample: float = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class StatesRequest(RoverOnGround):
    """What telemetry is read with.

    Attributes
    ----------
    positions : Positions from localisation, such as those of `images locate` (CSV): time_s, x_m, y_m, and sigma_m or
        xx_m2, xy_m2, yy_m2, with xx_before_m2 and so on where errors are correlated. They replace the telemetry's.
    track : Depth of the track: CSV with x_m, y_m, rut_m and rut_m_sigma, points within half a wheel's width of the
        wheels and as near to each other; or the terrain after the drive. No sinkage without it.
    since : Rows with a time_s before this are left out, such as those of earlier drives.
    until : Rows with a time_s after this are left out.
    start_time : time_s of the start of the plan, by the clock of telemetry and positions, such as seconds since 1970.
        Rows before it are left out. Without it the start is where the commands are those of the plan.
    lag : Time by which positions, headings and attitude are later than the columns of the wheels, because of another
        clock or of wheels that follow commands late; they are shifted back by it. What is left of it is found from the
        drive.
    """

    positions: str | Any | None = None
    track: str | Any | None = None
    since: float | None = None
    until: float | None = None
    start_time: float | None = None
    lag: float = 0.0

    def __post_init__(self) -> None:
        check_intervals(self, {f"[-{LONGEST_LAG_S}, {LONGEST_LAG_S}]": "lag"})

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time. [s]"""
        return -inf if self.since is None else self.since, inf if self.until is None else self.until


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadsRequest(RoverOnGround):
    """What a motion is held with; `states`, `belief` and the options after them make soil and motion uncertain.

    Attributes
    ----------
    member : Which member of the motion's file, where it has several.
    soil : One soil, in place of the terrain's: a name or a TOML file.
    states : Measured wheel states (CSV: time_s, wheel, sinkage_m, slip_ratio, ...) that get the forces.
    belief : What is believed of the soil (JSON of `twin update`); the priors if left out.
    draws : Soils and motions to draw; 64 if left out.
    correlation : Distance in m over which the motion's errors stay alike; from the slips' errors, or 0.5, if left out.
    balance_error : Error of the balance of forces as a share of the weight; 0.005 if left out.
    iterate : Rounds, at most, of forces and soil in turn: needs `states` with sinkages.
    seed : Seed of everything random; 0 if left out.
    as_written : Take the numbers of soil, rover, terrain and states as they are written. Without it lunarsci asks
        about a number that would be likely in another unit, and the result is not to be trusted.
    """

    member: int | None = None
    soil: str | None = None
    states: str | Any | None = None
    belief: str | Any | None = None
    draws: int | None = None
    correlation: float | None = None
    balance_error: float | None = None
    iterate: int | None = None
    seed: int | None = None
    as_written: bool = False

    def __post_init__(self) -> None:
        refuse_where({
            "`seed` draws nothing here; give `draws` or `belief`, or leave it out":
                not self.uncertain and self.seed is not None,
            "`soil` has no use beside soils drawn from `belief` or the priors; leave it out":
                self.uncertain and self.soil is not None,
            "`iterate` learns from measured sinkages and slips; give `states`":
                self.iterate is not None and self.states is None,
        })  # fmt: skip

    @property
    def uncertain(self) -> bool:
        """Whether soils and motions are drawn."""
        return any(getattr(self, name) is not None for name in UNCERTAIN)


@dataclass(frozen=True, slots=True, kw_only=True)
class UpdateRequest(RoverOnGround):
    """What was driven and measured beside the wheel states, and what was believed before.

    Attributes
    ----------
    plan : Plan that was driven (TOML); the embedded one if left out.
    positions : Positions from localisation (CSV): time_s, x_m, y_m, and errors as in `twin states`.
    soil : What was believed before: a belief or a soil map (JSON), which keeps the soil by place, or a file of priors;
        the priors if left out.
    forget : Share of the way back to the first priors, for ground further on.
    by_place : whether the soil is kept by place, as it is where `soil` is a map.
    correlation : Distance in m over which soils are alike; the map's, or 5, if left out.
    particles : Number of soils that represent the belief.
    ruts : Whether wheels met the ruts of others; by the probability that the drive gives it, if left out.
    seed : Seed of everything random.
    as_written : Take the numbers of soil, rover, terrain and states as they are written. Without it lunarsci asks
        about a number that would be likely in another unit, and the result is not to be trusted.
    """

    plan: str | Any | None = None
    positions: str | Any | None = None
    soil: str | Any | None = None
    forget: float = 0.0
    by_place: bool = False
    correlation: float | None = None
    particles: int = 128
    ruts: bool | None = None
    seed: int = 0
    as_written: bool = False

    def __post_init__(self) -> None:
        refuse_where({
            "`forget` has nothing to forget, as the priors are believed; give `soil`":
                bool(self.forget) and self.soil is None,
        })  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareRequest:
    """What to hold a prediction against, beside the wheel states.

    Attributes
    ----------
    positions : Measured positions (CSV): time_s, x_m, y_m, and sigma_m or xx_m2, xy_m2, yy_m2.
    plan : Plan that was driven (TOML): refused if another was predicted.
    belief : Belief (JSON) whose discrepancy of the twin's physics learns from the miss, for --save.
    rover : Rover: a name (yutu2, husky, rosey) or a TOML file.
    seed : Seed of everything random.
    as_written : Take the numbers of soil, rover, terrain and states as they are written. Without it lunarsci asks
        about a number that would be likely in another unit, and the result is not to be trusted.
    """

    positions: str | Any | None = None
    plan: str | Any | None = None
    belief: str | Any | None = None
    rover: str | None = None
    seed: int = 0
    as_written: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialsRequest(CompareRequest):
    """How trials are predicted. What belongs to a prediction made before (positions, plan, belief) is refused.

    Attributes
    ----------
    terrain : Terrain of the trials: a file, as of `twin states`.
    height_unit : Unit of the terrain's heights, in place of what its file states.
    gravity : Gravity: moon, mars, earth, or a number in m/s².
    interpolation : Ground between nodes: smooth (continuous gradient) or triangles (as in the paper).
    soil : Soil that trials are predicted on: a name or a TOML file; or a belief (JSON) or samples (CSV), from which
        every drive has its own. Repeatable.
    members : Number of drives for each trial.
    """

    terrain: str | None = None
    height_unit: HeightUnit | None = None
    gravity: str | None = None
    interpolation: str = "smooth"
    soil: tuple[str, ...] = ()
    members: int | None = None

    def __post_init__(self) -> None:
        check_intervals(self, {"[1, inf)": "members"})


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepRequest(PoweredRequest):
    """Which designs to drive.

    Attributes
    ----------
    vary : Number of the rover file, TABLE.KEY (with .x, .y or .z of a vector), or plan.speed_m_s, such as
        wheel.radius_m=0.13:0.17:3; repeatable: the grid of all values.
    designs : Number of designs: Latin-hypercube samples of the ranges instead of the grid.
    exact_terrain : Drive on the likely ground. Without it each drive has a ground of its own, drawn from what an
        elevation model of `images dem` or `images merge` says of its errors, or from the Moon's roughness where nodes
        lie wider apart than a wheel is large.
    """

    vary: tuple[str, ...] = ()
    designs: int | None = None
    exact_terrain: bool = False

    def __post_init__(self) -> None:
        PoweredRequest.__post_init__(self)
        refuse_where({
            "nothing to vary; give `vary` NAME=LOW:HIGH:N, for example wheel.radius_m=0.10:0.20:5": not self.vary
        })  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryRequest:
    """What to look for in a belief's history.

    Attributes
    ----------
    against : Another belief (JSON) to set beside it, parameter by parameter.
    rollback : Go back to what was believed after N drives; 0: the priors.
    """

    against: str | Any | None = None
    rollback: int | None = None
