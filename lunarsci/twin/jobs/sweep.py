"""Designs of a rover that differ in a few numbers, compared by their drives on one mission and the same soils."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.constants import PAPER
from lunarsci.errors import RequestError, within_option
from lunarsci.io.inputs import Source
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Progress, Result, job
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, Soils, read_drive_inputs
from lunarsci.twin.jobs.predict import power_of
from lunarsci.twin.jobs.requests import SweepRequest
from lunarsci.twin.judgement.designs import (
    Design,
    Variation,
    check_names,
    design_values,
    pareto_front,
    parse_variation,
    try_design,
    unchanged,
)
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import Prediction, predict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignTrade(Result):
    """Designs on one mission.

    Attributes
    ----------
    soils : what drove where, by plan.
    variations : what was varied.
    designs : in the order of the grid or the samples.
    front : numbers of the designs that no other beats in both the share of drives kept and the energy.
    unused : varied numbers that changed nothing.
    """

    schema: ClassVar[str] = "twin-sweep/1"
    soils: tuple[Soils, ...]
    variations: tuple[Variation, ...]
    designs: tuple[Design, ...]
    front: tuple[int, ...]
    unused: tuple[str, ...]

    @property
    def inputs(self) -> DriveInputs:
        """What drives where, on the first plan."""
        return self.soils[0].inputs

    @property
    def made_from(self) -> MadeFrom:
        inputs = {name: digest for soils in self.soils for name, digest in soils.inputs.inputs.items()}
        first, seed = self.inputs, self.soils[0].seed
        sources = list(dict.fromkeys([*SOURCES, PAPER]))
        return MadeFrom(inputs=inputs, tables=first.tables, sources=sources, seed=seed, options=first.options)

    @property
    def doubt(self) -> Doubt:
        none = "" if any(design.outcome for design in self.designs) else "no design is possible"
        return Doubt.of(none, self.soils[0].doubt)

    def to_dict(self) -> dict[str, Any]:
        return {
            **self.inputs.about(),
            "plans": [soils.inputs.plan.name for soils in self.soils],
            "vary": [asdict(entry) for entry in self.variations],
            "designs": self.rows(),
            "front": list(self.front),
            "unchanged_by": list(self.unused),
            "soil": self.soils[0].record(),
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [
            {"design": number, **design.row(), "on_front": number in self.front}
            for number, design in enumerate(self.designs)
        ]

    def layers(self) -> dict[str, Any]:
        """Over the numbers that were varied where the designs are a grid of these, else over the designs."""
        rows = self.rows()
        grid = {one.name: np.unique([row[one.name] for row in rows]) for one in self.variations}
        shape = tuple(map(len, grid.values()))
        if math.prod(shape) == len(rows):
            places = tuple(np.searchsorted(axis, [row[name] for row in rows]) for name, axis in grid.items())
        else:
            grid, shape, places = {"design": np.arange(len(rows))}, (len(rows),), (np.arange(len(rows)),)
        made: dict[str, Any] = {name: ((name,), axis) for name, axis in grid.items()}
        for key in (key for key in rows[0] if key not in (*grid, "reasons", "impossible")):
            values = np.full(shape, np.nan)
            values[places] = [np.nan if row[key] is None else row[key] for row in rows]
            made[key] = (tuple(grid), values)
        return made

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.choice import curve_page, design_front_page

        synthetic = any(soils.inputs.terrain.synthetic for soils in self.soils)
        yield design_front_page(self.designs, self.front, synthetic=synthetic)
        yield curve_page(self.designs, [entry.name for entry in self.variations], synthetic=synthetic)


@job
def sweep(
    plans: "Sequence[Source | Plan] | Source | Plan | None" = None,
    request: SweepRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> DesignTrade:
    """Drive designs of a rover, which differ in a few numbers, on the plans of a mission, each on the same soils.

    `plans` is one plan or several, the embedded one if None. Limits are those of the plans, the same for all designs. A
    design that is impossible is listed with its reason, the others go on.

    Raises DataError for what cannot be read, RequestError for options that are impossible, and for numbers that no
    drive depends on.

    Examples
    --------
    >>> designs = lunarsci.sweep("plan.toml", vary=("wheel.radius_m=0.13:0.17:2",), members=4).to_table()
    """
    asked = request_of(SweepRequest, request, options)
    soils = _mission(plans, asked)
    inputs = [one.inputs for one in soils]
    with within_option("vary"):
        variations = tuple(parse_variation(text) for text in asked.vary)
        check_names(variations, inputs[0].description, [one.plan for one in inputs])
        values = design_values(variations, asked.designs, asked.seed or 0)
    drive = _driver(soils, asked)
    designs = []
    for number, one in enumerate(values):
        if progress is not None:
            progress(number, len(values))
        designs.append(try_design(inputs, one, drive))
    return DesignTrade(
        soils=soils,
        variations=variations,
        designs=tuple(designs),
        front=tuple(pareto_front(designs)),
        unused=tuple(unchanged(designs)),
    )


def _driver(soils: Sequence[Soils], asked: SweepRequest) -> Callable[[int, dict[str, Any]], Prediction]:
    members, power = [one.of_members() for one in soils], power_of(asked)

    def drive(number: int, changes: dict[str, Any]) -> Prediction:
        driven = predict(**members[number] | changes, time_step_s=asked.time_step, sample_m=asked.sample)
        law = soils[number].discrepancy
        driven = driven if law is None else with_discrepancy(driven, law, soils[number].seed)
        return replace(driven, power=power)

    return drive


def _mission(plans: Any, asked: SweepRequest) -> tuple[Soils, ...]:
    """The soils of each plan, as many and the same on all of them. Raises RequestError where plans have others."""
    several = list(plans) if isinstance(plans, list | tuple) else [plans]
    soils = []
    for plan in several or [None]:
        inputs = read_drive_inputs(
            plan,
            *asked.ground,
            soil=asked.soil,
            fixes=asked.fixes,
            judged=True,
            terrain_errors=not asked.exact_terrain,
            priors=asked.members is not None and not asked.sweep,
        )
        members = inputs.given.members(asked.members)
        soils.append(Soils.of(inputs, asked.sweep or None, members, asked.seed or 0))
    if len({one.drawn for one in soils}) > 1 or (
        not asked.sweep and len({one.inputs.plan.sweep for one in soils}) > 1 and soils[0].kind in ("sweep", "one")
    ):
        raise RequestError("the plans sweep different soils; give `sweep` or `soil` for all of them")
    soils[0].warn_of_seed(None if asked.designs is not None else asked.seed)
    return tuple(soils)
