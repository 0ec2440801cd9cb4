"""What drives where: plan, rover, terrain and soil of a drive, checked against each other; soils of all its members."""

import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import DataError, LunarSciWarning, RequestError, within_option
from lunarsci.heights import HeightUnit
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import Source, read_input
from lunarsci.names import counted
from lunarsci.provenance import sha256
from lunarsci.regolith.belief import FitVerdict, SoilBelief, doubt, other_law
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.regolith.prior import Question, asked_in, prior_hash
from lunarsci.regolith.soil import read_soil, soil_hash, soil_tables, unusual
from lunarsci.regolith.states import StateTable
from lunarsci.result import Doubt
from lunarsci.rovers import DEFAULT_ROVER, RoverDescription, read_rover
from lunarsci.twin.assimilation.segments import planned_places
from lunarsci.twin.ground.driven_soil import (
    DEFAULT_SOIL,
    OF_A_BELIEF,
    PRIORS,
    DrivenSoil,
    GivenSoil,
    caution_of,
    doubt_of,
    lay_soil_on,
    no_use,
    read_soil_samples,
    soil_record,
)
from lunarsci.twin.ground.finer_ground import terrain_questions
from lunarsci.twin.ground.hazards import near_way, read_keep_outs, read_mobility
from lunarsci.twin.ground.soil_map import drawn_grounds
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, TerrainFile, read_terrain_file
from lunarsci.twin.plans.made_for_check import MadeForCheck
from lunarsci.twin.plans.plan import Fixes, Plan, Sweep, parse_fixes, parse_sweep, read_plan
from lunarsci.twin.rover import Rover, build_rover, rover_questions, with_gravity

SYNTHETIC = "synthetic-longji"
SOURCES = [
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
    "Janosi & Hanamoto (1961), Proc. 1st Int. Conf. Mechanics of Soil-Vehicle Systems, Turin, 707",
]
SOIL_TABLE = "soils.toml"


@dataclass(frozen=True, slots=True)
class DriveInputs:
    """What drives where: the parsed inputs of a drive and their hashes.

    Attributes
    ----------
    rover, description : the rover, and its file as it was read.
    terrain : with the soil that is driven on where drives have none of their own.
    plan : what is driven.
    inputs, tables : SHA-256 of the files that were read, and of the project's own tables, by name.
    driven : where the soil of the terrain comes from.
    check : what was noted of files that were made for another rover or ground.
    given : which soils were asked for.
    options : what was taken for options that were left out, by name.
    ruts : whether wheels meet the ruts that others, and they themselves, left; None as probably as the belief has it.
    before : a plan that was driven on the same ground before; None without one.
    rough : whether the terrain has roughness that its file does not show.
    questions : numbers that no Moon, soil or rover has as they are written.
    """

    rover: Rover
    description: RoverDescription
    terrain: Terrain
    plan: Plan
    inputs: dict[str, str]
    tables: dict[str, str]
    driven: DrivenSoil
    check: MadeForCheck
    given: GivenSoil = field(default_factory=GivenSoil)
    options: dict[str, Any] = field(default_factory=dict)
    ruts: bool | None = False
    before: Plan | None = None
    rough: bool = False
    questions: tuple[Question, ...] = ()

    @property
    def made_for(self) -> dict[str, Any]:
        """Which rovers plan and terrain were made for."""
        return self.check.made_for

    @property
    def remarks(self) -> tuple[str, ...]:
        """What there is to say of gravity, of how the terrain was read, and of files of another rover or ground."""
        pull = self.rover.gravity_m_s2
        other = [f"under a gravity of {pull:g} m/s²"] if pull != LUNAR_GRAVITY.value else []
        return (*other, *self.check.read_as, *self.check.remarks)

    def soil_record(self, drawn: Iterable[str] = (), named: DrivenSoil | None = None) -> dict[str, Any]:
        """The soil for a result; `drawn` are the parameters that every drive has for itself, `named` their file."""
        record = soil_record(named or self.driven, self.terrain, drawn) | self.given.to_dict()
        cautions = (self.caution_of_belief, other_law(self.given.name, self.given.verdict, self.rover.name))
        remarks = {"doubt": self.doubt_of_belief, "caution": "; ".join(filter(None, cautions))}
        return record | {key: text for key, text in remarks.items() if text}

    def soil_notes(self, members: int, drawn: int) -> list[str]:
        """Which soil `members` drives have, but for that of the stand-in, and what a belief in its place means.

        `drawn` is how many parameters each drive has for itself.
        """
        belief = self.given.belief
        if belief is None:
            standing_in = self.driven.of == "default" and self.options.get("terrain") == SYNTHETIC
            rest = f", what it lacks of {self.driven.rest}" if self.driven.rest else ""
            why = ", assumed: none is given, and the terrain has none (--soil)" if self.driven.of == "default" else ""
            named = not standing_in and drawn < len(SOIL_COLUMNS)
            some = f"soils: {members} of the {self.given.rows} of {self.given.name}; --members N takes more"
            every = f"soil: of each drive a row of {self.given.name}"
            lines = [some if members < self.given.rows else every] if self.given.of == "samples" else []
            return [*lines, f"soil: that of {self.driven.name}{rest}{why}"] if named else lines
        start = "before any drive" if belief.verdict is None else "a fit to wheel states"
        drives = start if not belief.history else counted(len(belief.history), "drive")
        unread = len(belief.history) - self.given.learned
        less = f", {unread} of which taught nothing" if unread else ""
        source = self.given.name
        if self.given.origin == "priors":
            source = "the priors" if source == PRIORS else f"the priors of {source}"
        drawn_from = f"soil: {members} drawn from {source} ({drives}{less}); they replace that of the terrain"
        return [drawn_from, *([f"caution: {self.caution_of_belief}"] if self.caution_of_belief else [])]

    @property
    def doubt_of_belief(self) -> str:
        """Why predictions from the belief, or from the map along the plan, are doubtful; empty where they are not."""
        return doubt_of(self.given.name, self._belief_along())

    @property
    def caution_of_belief(self) -> str:
        """What was warned of when the belief, or the map along the plan, was learned, and other loads; else empty."""
        belief, load = self.given.belief, self.rover.load_n
        texts = [caution_of(self.given.name, self._belief_along())]
        if belief is not None and (share := round(100 * belief.beyond_loads(load))):
            low, high = belief.loads_n
            texts.append(
                f"{self.given.name} was learned under {low:.3g} to {high:.3g} N on a wheel, and {load:.3g} N are on one"
                f" here: its soils are {share} % of the way to the ground's own values, which are less well known"
            )
        return "; ".join(filter(None, texts))

    def _belief_along(self) -> SoilBelief | None:
        if self.given.soil_map is not None:
            return self.given.soil_map.belief_along(planned_places(self.plan, self.rover))
        return self.given.belief

    def asked(self, *, heights: bool, as_written: bool, states: StateTable | None = None) -> "DriveInputs":
        """With what to ask of the rover's numbers, of an own soil, of loads, and of `heights` given without a unit.

        Nothing where all is meant `as_written`.
        """
        if as_written:
            return self
        questions, soil = rover_questions(self.rover), self.given.named
        if heights:
            questions += terrain_questions(self.terrain)
        if soil is not None and soil not in soil_tables():
            questions += unusual(read_soil(soil), soil)
        return replace(self, questions=(*questions, *(() if states is None else states.questions(self.rover.wheel))))

    def about(self) -> dict[str, Any]:
        """Terrain and rover, for a result."""
        return {
            "terrain": {"name": self.terrain.name, "synthetic": self.terrain.synthetic},
            **self.check.how_read,
            "rover": self.rover.name,
            "gravity_m_s2": self.rover.gravity_m_s2,
            "made_for": self.made_for,
            "assumed_of_rover": list(self.description.assumed),
            **asked_in(self.questions),
        }


def read_drive_inputs(
    plan: "Source | Plan | None",
    rover: str | None,
    named: str | None,
    interpolation: str = "smooth",
    height_unit: HeightUnit | None = None,
    gravity: str | None = None,
    *,
    soil: str | Sequence[str] | None = None,
    fixes: str | None = None,
    soil_counts: bool = True,
    judged: bool = False,
    ruts: bool | None = None,
    before: "Source | Plan | None" = None,
    terrain_errors: bool = False,
    keep_out: Sequence[str] = (),
    priors: bool = False,
    below: Terrain | None = None,
) -> DriveInputs:
    """Read plan, rover, terrain and soil, which may be a belief, a soil map or samples; `fixes` replaces the plan's.

    A rover that is None is Yutu-2; `named` is the terrain, if None the ground `below` that a drive itself tells, or
    the synthetic stand-in for Yutu-2's site.
    A soil that is given lies everywhere, whatever the terrain's file carries; without one this is driven on, and where
    it has none, `longji`. Where soils are of no account (`soil_counts`) none is said
    to be used. The limits of a plan that is `judged` must be those of the rover, or no laxer. `before` is a plan that
    was driven on the same ground before, whose ruts are met. `ruts` that are None are met with such a plan, and of a
    belief in as many drives as its last drive makes probable. Heights of a file that states their errors are as they
    are likely to be; with `terrain_errors` what is not known of them comes with them. `keep_out` are files of ground to
    keep out of. With `priors` soils are drawn from the priors where neither an option, the terrain nor the plan says
    anything of them.

    Raises DataError for what cannot be read, RequestError for what does not belong together.
    """
    description, terrain = read_rover(rover or DEFAULT_ROVER), named or (SYNTHETIC if below is None else below.name)
    built, given = on_gravity(build_rover(description), gravity), GivenSoil.read(soil)
    ruts = _meets_ruts(ruts, before is not None, given)
    file, surface, driven = _read_ground(terrain, given, height_unit, below)
    surface = file.likely(surface, built.wheel.width_m)
    surface = surface if terrain_errors else replace(surface, errors=None)
    inputs: dict[str, str] = {}
    read, earlier = (_read_plan(one, inputs) for one in (plan, before))
    read = read or read_plan()
    if priors and driven.of == "default" and given.file is None and not read.sweep:
        soil, given, driven = PRIORS, GivenSoil.read(PRIORS), DrivenSoil(PRIORS, "priors")
    of_soil, tables = soil_hashes(given, driven if soil_counts else None)
    inputs = of_soil | inputs
    if terrain != SYNTHETIC and below is None:
        inputs |= {terrain: read_input(terrain).sha256} | file.hashes_beside
    check = MadeForCheck(description, built, rover is not None, surface, (named or below) is not None, file.read_as)
    drive, earlier = check.placed(read, file.crs_of_file), earlier and check.placed(earlier, "")
    drive = _with_keep_outs(drive, built, read_mobility(description, built).max_step_m, keep_out, inputs, surface.crs)
    if fixes is not None and len(drive.legs) < 2:
        raise RequestError(f"`fixes` steer the next leg, and {drive.origin} has only one; leave them out")
    drive = check.plan(drive, None if plan is None else drive.origin, judged=judged)
    check.note("terrain", file.made_for, terrain)
    check.belief(given.name, given.belief)
    check.law(given.name, given.verdict)
    check.stand_in()
    if soil_counts:
        check.soil(driven, terrain)
    return DriveInputs(
        built,
        description,
        replace(surface, interpolation=interpolation),
        drive if fixes is None else replace(drive, fixes=parsed_fixes(fixes)),
        inputs,
        tables | {f"{description.origin} (rover)": sha256(description.text.encode())},
        driven,
        check,
        given,
        {"rover": description.origin, "terrain": terrain} | _soil_option(soil, driven if soil_counts else None),
        ruts,
        earlier,
    )


def _meets_ruts(ruts: bool | None, before: bool, given: GivenSoil) -> bool | None:
    if before and ruts is False:
        raise RequestError("`before` leaves nothing but ruts, and `ruts` are left out; give one of them")
    return ruts if ruts is not None else before or (None if given.belief is not None else False)


def _read_plan(plan: "Source | Plan | None", inputs: dict[str, str]) -> Plan | None:
    """The plan of a file, whose hash goes to the `inputs`, or the one in memory."""
    if plan is None or isinstance(plan, Plan):
        return plan
    if isinstance(plan, str) and plan != "-" and not Path(plan).exists():
        _check_missing(Path(plan))
    file = read_input(plan)
    inputs[file.name] = file.sha256
    return read_plan(file)


def _check_missing(plan: Path) -> None:
    """Raises DataError where a plan is missing as `twin plan` found none, by the record in its folder."""
    try:
        record = json_document((plan.parent / "result.json").read_text("utf-8"))
        why = record["result"]["choice"]["why_none"]
    except (OSError, ValueError, KeyError, TypeError):
        return
    if plan.name == "plan.toml" and isinstance(why, str):
        number = re.search(r"drive (\d+), the safest", why)
        safest = f"plan-{int(number[1]):02d}.toml" if number else ""
        named = f"; {safest} is the safest" if safest and (plan.parent / safest).is_file() else ""
        raise DataError(
            f"{plan}: `twin plan` found no drive that keeps its risk, and wrote none (result.json says why){named}; "
            "plan with more `risk`, `fixes`, or another `target`"
        )


def _with_keep_outs(
    plan: Plan, rover: Rover, climbs_m: float, files: Sequence[str], inputs: dict[str, str], crs: str
) -> Plan:
    """The plan with the circles of keep-out files that its way comes near to; their hashes go to the `inputs`."""
    for name in files:
        file = read_input(name)
        inputs[file.name] = file.sha256
        zones = tuple(zone for zone in read_keep_outs(file, crs, climbs_m) if zone not in plan.exclusion_zones)
        near = near_way(zones, planned_places(plan, rover))
        plan = replace(plan, exclusion_zones=plan.exclusion_zones + near)
    return plan


def _soil_option(soil: str | Sequence[str] | None, driven: DrivenSoil | None) -> dict[str, Any]:
    """What was taken for the soil, by name: what was given, or the common one; nothing for the terrain's."""
    names = [soil] if isinstance(soil, str) else list(soil or ())
    if driven is not None and driven.of == "default" and not names:
        return {"soil": driven.name}
    return {"soil": names[0] if len(names) == 1 else names} if names else {}


def _read_ground(
    terrain: str, given: GivenSoil, unit: HeightUnit | None, below: Terrain | None
) -> tuple[TerrainFile, Terrain, DrivenSoil]:
    """The terrain's file, the terrain with the soil that is driven on, and where this comes from."""
    name = given.named or DEFAULT_SOIL
    soil = read_soil(name)
    made = below or (synthetic_longji(soil) if terrain == SYNTHETIC else None)
    if made is not None and unit is not None:
        raise RequestError(f"`height_unit` does not apply to {terrain}; leave it out")
    file = read_terrain_file(terrain, soil, unit) if made is None else TerrainFile(made)
    surface, driven = lay_soil_on(file, terrain, soil, name, asked=given.named is not None)
    return file, surface, driven if given.belief is None else DrivenSoil(given.name, given.origin)


def soil_hashes(given: GivenSoil, driven: DrivenSoil | None) -> tuple[dict[str, str], dict[str, str]]:
    """Hashes of the user's files and of own tables; of the latter only that of the soil that is `driven` on."""
    inputs, tables = ({}, {}) if given.named is None else soil_hash(given.named)
    if given.name == PRIORS:
        tables = tables | prior_hash()
    elif given.file is not None:
        inputs = inputs | {given.name: given.file.sha256}
    if driven is not None and (driven.rest or driven.name) in soil_tables():
        tables = tables | soil_hash(driven.rest or driven.name)[1]
    return inputs, tables


def parsed_fixes(text: str) -> Fixes:
    """What an option says of position fixes. Raises RequestError."""
    with within_option("fixes"):
        return parse_fixes(text)


def on_gravity(rover: Rover, gravity: str | None) -> Rover:
    """A rover where gravity is what an option says. Raises RequestError."""
    with within_option("gravity"):
        return with_gravity(rover, gravity)


@dataclass(frozen=True, slots=True)
class Soils:
    """The soils of the members of an ensemble: a sweep, or those of a file, of which some may be drawn; and the seed.

    Attributes
    ----------
    inputs : what drives where, without the hash of a soil that no drive meets.
    sweep : None for that of the plan.
    members : how many drives were asked for, None for all of the sweep or the file.
    samples : parameter to one value for each drive; None for a sweep or a soil map.
    verdict : of the fit that the soils come from, None where they come from none.
    discrepancy : what a belief knows of the twin's physics, None where the soils are of no belief.
    """

    inputs: DriveInputs
    sweep: tuple[Sweep, ...] | None
    members: int | None
    seed: int
    samples: Mapping[str, FloatArray] | None = None
    verdict: FitVerdict | None = None
    discrepancy: PhysicsDiscrepancy | None = None

    @classmethod
    def of(cls, inputs: DriveInputs, sweep: Sequence[str] | None, members: int | None, seed: int) -> "Soils":
        """The soils of some inputs; a sweep that is None is the plan's.

        Raises RequestError for a sweep beside a file of soils, and for a soil that no drive meets.
        """
        given = inputs.given
        if sweep is not None and given.file is not None:
            what = {"belief": "a belief", "map": "a soil map", "samples": "samples"}[given.of]
            raise RequestError(f"`sweep` and {what} as `soil` are two ways to name the soils; give one")
        ranges = None if sweep is None else _parsed_sweep(sweep)
        soils = cls(inputs, ranges, members, seed)
        if given.belief is not None:
            belief = given.belief.under(inputs.rover.load_n, seed)
            drawn = belief.draws(members or OF_A_BELIEF, seed)
            soils = replace(soils, samples=drawn, verdict=belief.verdict, discrepancy=belief.discrepancy)
        elif given.soil_map is not None:
            law = given.soil_map.belief_along(planned_places(inputs.plan, inputs.rover)).discrepancy
            soils = replace(soils, discrepancy=law)
        elif given.file is not None:
            rows = read_soil_samples(given.file, members, seed)
            soils = replace(soils, samples=rows, verdict=given.verdict)
        return soils._without_unused_soil()

    def _without_unused_soil(self) -> "Soils":
        inputs = self.inputs
        if inputs.driven.of in ("belief", "priors") or not set(self.drawn) >= set(SOIL_COLUMNS):
            return self
        if inputs.driven.of == "option":
            raise RequestError(no_use(inputs.driven.name, self._origin))
        tables = {name: digest for name, digest in inputs.tables.items() if name != SOIL_TABLE}
        options = {name: value for name, value in inputs.options.items() if value != DEFAULT_SOIL}
        return replace(self, inputs=replace(inputs, tables=tables, options=options))

    @property
    def drawn(self) -> tuple[str, ...]:
        """Soil parameters that each drive has for itself, whatever lies on the terrain."""
        if self.inputs.given.soil_map is not None:
            return tuple(SOIL_COLUMNS)
        if self.samples is not None:
            return tuple(self.samples)
        return tuple(sweep.name for sweep in (self.inputs.plan.sweep if self.sweep is None else self.sweep))

    @property
    def drawn_by(self) -> int | None:
        """The seed, or None where it draws nothing."""
        inputs = self.inputs
        drawn = self.kind == "belief" or self.members is not None or inputs.plan.fixes is not None
        return self.seed if drawn or inputs.terrain.errors is not None else None

    def warn_of_seed(self, seed: int | None) -> None:
        """Say it where a seed that was given draws nothing."""
        if seed is not None and self.drawn_by is None:
            text = "the seed has nothing to draw here: the soils are given or a grid, and the plan has no fixes"
            warnings.warn(text, LunarSciWarning, stacklevel=3)

    @property
    def doubt(self) -> Doubt:
        """Why soils should not be driven on, by their fit, its law or the drives of their belief."""
        fit = "" if self.verdict is None else doubt(self.verdict)
        inputs = self.inputs
        law = other_law(inputs.given.name, inputs.given.verdict, inputs.rover.name)
        return Doubt.of(fit, law, inputs.doubt_of_belief)

    def warn_of_fit(self) -> None:
        """Say the doubt of a fit."""
        if self.verdict is not None and (text := doubt(self.verdict)):
            warnings.warn(text, LunarSciWarning, stacklevel=3)

    @property
    def _origin(self) -> str:
        return self.inputs.given.name or (self.inputs.plan.origin if self.sweep is None else "`sweep`")

    def record(self) -> dict[str, Any]:
        """The soil that is driven on, for the result."""
        driven, given = self.inputs.driven, self.inputs.given
        named = None
        if given.of == "map" or given.of == "samples":
            named = DrivenSoil(given.name, given.of, driven.carried, driven.rest)
        return self.inputs.soil_record(self.drawn, named)

    @property
    def kind(self) -> str:
        """What the soils are: draws of a `belief`, other `samples`, a `sweep` of ranges, or `one`."""
        of = self.inputs.given.of
        if of != "none":
            return "samples" if of == "samples" else "belief"
        return "sweep" if (self.inputs.plan.sweep if self.sweep is None else self.sweep) else "one"

    @property
    def _ruts(self) -> bool | BoolArray:
        """Whether wheels meet ruts: in all drives, or in each."""
        belief, asked = self.inputs.given.belief, self.inputs.ruts
        if asked is None and belief is not None and self.samples is not None:
            return belief.draws_with_ruts(len(next(iter(self.samples.values()))), self.seed)
        return bool(asked)

    def of_members(self) -> dict[str, Any]:
        """What `drive_ensemble` takes: rover, terrain and plan, ruts, and the soils of all members."""
        inputs = self.inputs
        result: dict[str, Any] = {
            "rover": inputs.rover,
            "terrain": inputs.terrain,
            "plan": inputs.plan,
            "seed": self.seed,
        }
        result |= {"ruts": self._ruts, "before": inputs.before}
        if inputs.given.soil_map is not None:
            along, members = planned_places(inputs.plan, inputs.rover), self.members or OF_A_BELIEF
            grounds = drawn_grounds(inputs.given.soil_map, inputs.terrain, along, members, self.seed)
            return result | {"grounds": grounds}
        if self.samples is not None:
            return result | {"samples": self.samples}
        if self.kind == "one" and self.members is None and inputs.rough and inputs.terrain.errors is not None:
            result |= {"draws": inputs.terrain.errors.draws(OF_A_BELIEF, self.seed)}
        return result | {"sweep": self.sweep, "members": self.members}


def _parsed_sweep(sweep: Sequence[str]) -> tuple[Sweep, ...]:
    with within_option("sweep"):
        return tuple(parse_sweep(text) for text in sweep)
