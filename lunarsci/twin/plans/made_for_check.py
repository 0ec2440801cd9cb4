"""Whether plans, terrains, beliefs and states were made for the rover that drives, and on the ground it drives on.

What is safe where a plan does not say.
"""

import math
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.heights.projections import carried, name_of
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import read_csv_table
from lunarsci.regolith.belief import FitVerdict, SoilBelief, other_law
from lunarsci.regolith.columns import GROUND, ground_kinship, short_name, written_in
from lunarsci.rovers import DEFAULT_ROVER, MadeFor, RoverDescription
from lunarsci.twin.ground.driven_soil import DrivenSoil
from lunarsci.twin.ground.hazards import read_mobility
from lunarsci.twin.ground.synthetic import STAND_IN
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain
from lunarsci.twin.plans.plan import Limit, Plan, rover_limits
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd

OF_THE_ROVER = ("sinkage_m", "tilt_deg")
"""Limits that follow from the rover's size and file."""
EMBEDDED = "the embedded plan"


def _of_rover(rover: Rover) -> dict[str, Limit]:
    return {limit.quantity: limit for limit in rover_limits(rover) if limit.quantity in OF_THE_ROVER}


def limits_of_rover(limits: Iterable[Limit], rover: Rover) -> tuple[Limit, ...]:
    """Limits with those of the rover in place: sinkage a third of the wheel radius, tilt its steepest slope."""
    of_rover = _of_rover(rover)
    return tuple(of_rover.get(limit.quantity, limit) for limit in limits)


def laxer(limits: Iterable[Limit], rover: Rover) -> list[str]:
    """Where limits allow more than those of the rover do: `sinkage_m 0.05 > 0.025`."""
    pairs = [(limit, of_rover) for limit in limits if (of_rover := _of_rover(rover).get(limit.quantity))]
    return [
        f"{limit.quantity} {limit.limit:g} > {of_rover.limit:g}"
        for limit, of_rover in pairs
        if limit.limit > of_rover.limit * (1 + 1e-9)
    ]


def _carried(plan: Plan, crs: str, onto: str) -> Plan:
    """A plan on another map. Raises ParameterError."""
    x, y, heading = carried(crs, onto, plan.x_m, plan.y_m, plan.heading_deg)
    zones = tuple(
        replace(zone, x_m=place[0], y_m=place[1])
        for zone in plan.exclusion_zones
        for place in (carried(crs, onto, zone.x_m, zone.y_m, 0.0),)
    )
    return replace(plan, x_m=x, y_m=y, heading_deg=heading, exclusion_zones=zones, crs=onto)


@dataclass(slots=True)
class MadeForCheck:
    """The rover that drives and its ground, and what there is to say of files that were made for others.

    Attributes
    ----------
    description, rover, asked : the rover, its file, and whether it was asked for.
    terrain, terrain_asked : the ground, and whether it was asked for.
    read_as : how the ground was read, where there was a choice.
    made_for : which rovers plan and terrain were made for, for the result.
    remarks : one sentence for each warning.
    """

    description: RoverDescription
    rover: Rover
    asked: bool
    terrain: Terrain
    terrain_asked: bool
    read_as: tuple[str, ...] = ()
    made_for: dict[str, Any] = field(default_factory=lambda: {"plan": None, "terrain": None})
    remarks: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Warn, and keep the sentence."""
        self.remarks.append(text)
        warnings.warn(text, LunarSciWarning, stacklevel=3)

    @property
    def how_read(self) -> dict[str, list[str]]:
        """For a result: `read_as`, where there was a choice in how the ground was read."""
        return {"read_as": list(self.read_as)} if self.read_as else {}

    def plan(self, plan: Plan, path: str | None, *, judged: bool) -> Plan:
        """The plan with limits of this rover. Raises RequestError for a plan that another rover should drive.

        A plan without limits of its own, and the embedded one, is judged by the rover's own.
        """
        if path is None or not plan.has_limits:
            return self._judged_by_rover(plan, path) if judged else plan
        made = plan.made_for
        if made is not None and made.kinship(self.description) == "other":
            self._refuse(plan, made, path, judged=judged)
        self.note("plan", made, path)
        self.ground(path or "the plan", made.ground if made is not None else "", refused=False)
        return plan

    def placed(self, plan: Plan, crs_of_file: str) -> Plan:
        """The plan with the x and y of the terrain, where it has those of another coordinate system.

        A plan that names none has those of the terrain; or of the terrain's file, where this is another one and only
        there its start is on the ground. Raises RequestError where the two systems have nothing to do with each other.
        """
        here, crs = self.terrain.crs, plan.crs or crs_of_file
        if not here or crs in ("", here) or not (plan.crs or not self._is_on(plan)):
            return plan
        try:
            moved = _carried(plan, crs, here)
        except ParameterError as error:
            if not plan.crs:
                return plan
            raise RequestError(
                f"{plan.origin} has another coordinate system than {self.terrain.name}: {error}; plan on this terrain"
            ) from error
        if not plan.crs and not self._is_on(moved):
            return plan
        if round(math.dist((plan.x_m, plan.y_m), (moved.x_m, moved.y_m)), 2) > 0:
            self.say(
                f"{plan.origin}: x and y are of '{name_of(crs)}', and are taken to those of the terrain: it starts at "
                f"x {moved.x_m:.2f}, y {moved.y_m:.2f} m, heading {moved.heading_deg:.2f} deg"
            )
        return moved

    def _is_on(self, plan: Plan) -> bool:
        """Whether a plan starts on the grid of the terrain."""
        return bool(self.terrain.has(*self.terrain.nodes(np.array([plan.x_m, plan.y_m]))))

    def ground(self, path: str, written: str, *, refused: bool = True) -> None:
        """Say it where a file was made on another ground; '' where it does not say.

        Raises RequestError where nobody named the ground, so that it is the stand-in, if that is to be `refused`.
        """
        kinship = "same" if not written else ground_kinship(written, self.terrain.written)
        if kinship == "same":
            return
        name, here = written.rpartition("; ")[0], self.terrain.name
        other = f"'{name}'" if kinship == "other" else f"'{name}' with other heights"
        if refused and not self.terrain_asked:
            raise RequestError(f"{path} was made on {other}, and no ground is named; give its file as `terrain`")
        if kinship == "other":
            self.say(f"{path} was made on {other}, and this is on '{here}'; give its own file as `terrain`")
        else:
            self.say(f"{path} was made on {other} than here; give the same file as `terrain`, or make it anew")

    def tables(self, files: Iterable[InputFile]) -> None:
        """Whether motions and states are of the ground, see `ground`."""
        for file in files:
            self.ground(file.name, written_in(file.name, read_csv_table(file), GROUND))

    def states(self, file: str, table: "pd.DataFrame", *, named: bool = False) -> None:
        """Whether wheel states are of the rover and the ground that are taken where nobody names them.

        `named` says that another file names the rover. Warns where nothing names rover or ground. Raises RequestError
        as `ground`, DataError where states of whole wheels of the rover are missing: another's may bear the same names.
        """
        if not (self.asked or named or written_in(file, table)) and "wheel" in table:
            self._default_rover(file, set(table["wheel"].dropna().str.strip()))
        self.ground(file, written := written_in(file, table, GROUND))
        if not written and not self.terrain_asked and short_name(self.rover.name) == DEFAULT_ROVER:
            self.say(f"{file}: no ground is named, so the {STAND_IN} is taken; give the file of yours as `terrain`")

    def _default_rover(self, file: str, wheels: set[str]) -> None:
        taken = f"no rover is named, so {short_name(self.rover.name)} is taken"
        if missing := [name for name in self.rover.wheels if name not in wheels]:
            raise DataError(
                f"{file}: {taken}, and there are no states of its {', '.join(missing)}; name yours with `rover`"
            )
        self.say(f"{file}: {taken}: another one's wheels learn another soil; give `rover`")

    def _refuse(self, plan: Plan, made: MadeFor, path: str, *, judged: bool) -> None:
        """RequestError where nobody asked for this rover, or where the limits allow more than its own."""
        this_file = self.description.origin
        if not self.asked:
            raise RequestError(
                f"{path} was made for {made.name}; give `rover` {made.rover}, or `rover` {this_file} to drive it with "
                "that all the same"
            )
        beyond = laxer(plan.limits, self.rover) if judged else []
        if beyond:
            raise RequestError(
                f"{path} was made for {made.name}, and its limits are laxer than those of {self.rover.name} "
                f"({', '.join(beyond)}); plan with `rover` {this_file}, or write its [limits] for this rover "
                "and take [made_for] out"
            )

    def soil(self, driven: DrivenSoil, path: str) -> None:
        """Say it where a soil takes the place of the one that the terrain's file carries."""
        if not driven.replaced:
            return
        what = "" if len(driven.replaced) == len(SOIL_COLUMNS) else f" ({', '.join(driven.replaced)})"
        self.say(f"soil {driven.name} takes the place of the soil that {path} carries{what}; leave it out to keep that")

    def belief(self, name: str, belief: SoilBelief | None) -> None:
        """Say it where a belief was learned with another rover, as its values are those of that one's wheels.

        And where it was learned on a ground of another name; other heights of the same may have the same soil. Raises
        RequestError where nobody asked for this rover, and on the stand-in if it was learned on measured ground.
        """
        last = belief.history[-1] if belief is not None and belief.history else {}
        learned, this_rover = str(last.get("rover", "")), self.rover.written
        ground = str(last.get("ground", "")).rpartition("; ")[0]
        if learned and self.terrain.name == STAND_IN and not last.get("synthetic"):
            where = f"measured ground{f', {ground!r}' if ground else ''}"
            raise RequestError(f"{name} was learned on {where}, and this is the {STAND_IN}; give `terrain`")
        if ground and ground_kinship(str(last["ground"]), self.terrain.written) == "other":
            self.say(f"{name} was learned on '{ground}', and this is on '{self.terrain.name}': is the soil the same?")
        if not learned or learned == this_rover:
            return
        if not self.asked:
            raise RequestError(
                f"{name} was learned with '{learned}'; give that one's file as `rover`, or `rover` "
                f"{self.description.origin} to drive its soil with '{this_rover}' all the same"
            )
        self.say(f"{name} was learned with '{learned}', not with '{this_rover}', whose wheels may meet another soil")

    def law(self, name: str, verdict: FitVerdict | None) -> None:
        """Say it where soils were found by another law than the twin's, or of another wheel or gravity."""
        if remark := other_law(name, verdict, self.rover.name):
            self.say(remark)
        if verdict is None or not verdict.wheel or verdict.gravity_m_s2 is None:
            return
        pull, here = (f"{one:.3g} m/s²" for one in (verdict.gravity_m_s2, self.rover.gravity_m_s2))
        differ = {
            f"the wheel '{verdict.wheel}', and this is '{self.rover.written}'": verdict.wheel != self.rover.written,
            f"a gravity of {pull}, and here it is {here}": pull != here,
        }
        if any(differ.values()):
            what = "; for ".join(text for text, true in differ.items() if true)
            self.say(f"{name} was inferred for {what}: is the soil the same to both?")

    def stand_in(self) -> None:
        """Say it where a rover of one's own is on the synthetic stand-in for Yutu-2's site, as where none is named."""
        if self.terrain.name == STAND_IN and short_name(self.rover.name) != DEFAULT_ROVER:
            self.say(f"this is on the {STAND_IN}, as no terrain is named; give `terrain` for the ground of your rover")

    def _judged_by_rover(self, plan: Plan, path: str | None) -> Plan:
        limits = limits_of_rover(plan.limits, self.rover)
        pairs = zip(limits, plan.limits, strict=True)
        changed = [
            f"{one.quantity} {one.limit:.3g}" for one, given in pairs if not math.isclose(one.limit, given.limit)
        ]
        if changed:
            what = f"{EMBEDDED}, made for Yutu-2," if path is None else f"{path} has no [limits] and"
            self.say(f"{what} is judged by limits that follow from {self.description.origin}: {', '.join(changed)}")
        return replace(plan, limits=limits)

    def _changed(self, made: MadeFor) -> str:
        """Which limits of the ground a file was made by that the rover now does not have."""
        mobility = read_mobility(self.description, self.rover)
        now = {name: math.nan if (value := getattr(mobility, name, None)) is None else value for name in made.limits}
        other = [
            f"{name} {value:g} then, {f'{now[name]:g}' if math.isfinite(now[name]) else 'none'} now"
            for name, value in made.limits.items()
            if not math.isclose(now[name], value, rel_tol=1e-9)
        ]
        if not other:
            return "limits of the ground are the same; make it anew if wheels or others changed"
        return f"{', '.join(other)}; make it anew with this one"

    def note(self, what: str, made: MadeFor | None, path: str) -> None:
        """Keep what rover a file was made for, and say so where it is not this one."""
        if made is None:
            return
        kinship = made.kinship(self.description)
        self.made_for[what] = {"rover": made.rover, "name": made.name, "kinship": kinship, "limits": dict(made.limits)}
        if kinship == "changed" or (kinship == "other" and made.name == self.description.name):
            which = "when its file was another" if kinship == "changed" else "by another version of its file"
            self.say(f"{path} was made for {made.rover} {which}: {self._changed(made)}")
        elif kinship == "other":
            limits = ", ".join(f"{name} {value:g}" for name, value in made.limits.items())
            self.say(
                f"{path} was made for {made.name}, not for {self.rover.name}: its limits are {limits or 'not known'}"
            )
