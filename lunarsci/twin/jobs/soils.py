"""The soils of the members of an ensemble: a sweep of ranges, or draws of a belief, a soil map or a table."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lunarsci.arrays import FloatArray
from lunarsci.errors import LunarSciWarning, ParameterError, RequestError
from lunarsci.regolith.belief import FitVerdict, doubt, other_law
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.assimilation.segments import planned_places
from lunarsci.twin.ground.driven_soil import DrivenSoil, read_soil_samples
from lunarsci.twin.ground.soil_layers import drawn_grounds
from lunarsci.twin.ground.terrain import SOIL_COLUMNS
from lunarsci.twin.jobs.drive_inputs import DriveInputs, named_option
from lunarsci.twin.jobs.given_soil import DEFAULT_SOIL, no_use
from lunarsci.twin.plans.plan import Sweep, parse_sweep

SOIL_TABLE = "soils.toml"
OF_A_BELIEF = 64
"""Drives on soils of a belief, or on draws of the ground, where their number is not given."""


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
            drawn, known = given.belief.draws(members or OF_A_BELIEF, seed), given.belief
            soils = replace(soils, samples=drawn, verdict=known.verdict, discrepancy=known.discrepancy)
        elif given.soil_map is not None:
            law = given.soil_map.belief_along(planned_places(inputs.plan, inputs.rover)).discrepancy
            soils = replace(soils, discrepancy=law)
        elif given.file is not None:
            rows = read_soil_samples(given.file, members, seed)
            soils = replace(soils, samples=rows, verdict=given.verdict)
        return soils._without_unused_soil()

    def _without_unused_soil(self) -> "Soils":
        inputs = self.inputs
        if inputs.driven.of == "belief" or not set(self.drawn) >= set(SOIL_COLUMNS):
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
    def doubt(self) -> str:
        """Why soils should not be driven on, by their fit, its law or the drives of their belief; empty if they may."""
        fit = "" if self.verdict is None else doubt(self.verdict)
        known = self.inputs
        law = other_law(known.given.name, known.given.verdict, known.rover.name)
        return "; ".join(part for part in (fit, law, known.doubt_of_belief) if part)

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

    def of_members(self) -> dict[str, Any]:
        """What `drive_ensemble` takes: rover, terrain and plan, ruts, and the soils of all members."""
        known = self.inputs
        found: dict[str, Any] = {"rover": known.rover, "terrain": known.terrain, "plan": known.plan, "seed": self.seed}
        found |= {"ruts": known.ruts, "before": known.before}
        if known.given.soil_map is not None:
            along, members = planned_places(known.plan, known.rover), self.members or OF_A_BELIEF
            grounds = drawn_grounds(known.given.soil_map, known.terrain, along, members, self.seed)
            return found | {"grounds": grounds}
        if self.samples is not None:
            return found | {"samples": self.samples}
        if self.kind == "one" and self.members is None and known.rough and known.terrain.errors is not None:
            found |= {"draws": known.terrain.errors.draws(OF_A_BELIEF, self.seed)}
        return found | {"sweep": self.sweep, "members": self.members}


def _parsed_sweep(sweep: Sequence[str]) -> tuple[Sweep, ...]:
    try:
        return tuple(parse_sweep(text) for text in sweep)
    except ParameterError as error:
        raise RequestError(named_option("sweep", error)) from error
