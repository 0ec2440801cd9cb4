"""From the options that say which soils to drive on to a prediction."""

import dataclasses
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import typer

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.inputs import read_input
from lunarsci.regolith.belief import read_belief
from lunarsci.regolith.fit_verdict import FitVerdict, doubt, read_verdict
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.assimilation.change_point import planned_places
from lunarsci.twin.ground.driven_soil import DrivenSoil, Origin
from lunarsci.twin.ground.soil_layers import drawn_grounds
from lunarsci.twin.ground.soil_map import SoilMap, read_soil_map
from lunarsci.twin.ground.terrain import SOIL_COLUMNS
from lunarsci.twin.plans.plan import Sweep, parse_sweep
from lunarsci.twin.simulation.ensemble import Prediction, predict
from lunarsci.twin.simulation.path_discrepancy import with_discrepancy
from lunarsci.twin.simulation.soil_samples import read_soil_samples

from ..shared.report import Report
from .predict_report import DriveInputs, SoilOfBelief

__all__ = ["Soils", "drive", "with_physics", "with_verdict"]

SOIL_TABLE = "soils.toml"
OF_A_BELIEF = 64
"""Drives on soils of a belief, where their number is not given."""


@dataclass(frozen=True, slots=True)
class Soils:
    """The soils of a prediction: a sweep, or samples from a file, of which some may be drawn; and the seed.

    `discrepancy` is what a belief knows of the twin's physics, None where the soils are of no belief.
    """

    sweep: tuple[Sweep, ...] | None
    members: int | None
    samples: Mapping[str, npt.NDArray[np.float64]] | None
    seed: int
    inputs: Mapping[str, str]
    soil_map: SoilMap | None = None
    thinned: bool = False
    verdict: FitVerdict | None = None
    discrepancy: PhysicsDiscrepancy | None = None

    @classmethod
    def of(
        cls,
        sweep: list[str] | None,
        members: int | None,
        samples: str | None,
        seed: int,
        believed: SoilOfBelief | None = None,
        soil_map: str | None = None,
    ) -> "Soils":
        """Parse the options; a belief that is the soil, or a soil map, leaves no room for others."""
        ways = {"--soil-map": soil_map, "--sweep": sweep, "--samples": samples}
        given = [name for name, value in ways.items() if value is not None]
        if believed is not None and given:
            raise typer.BadParameter(f"{given[0]} and a belief as --soil are two ways to name the soils; give one")
        if soil_map is not None and len(given) > 1:
            raise typer.BadParameter(f"--soil-map names the soils already; leave out {given[1]}")
        if believed is not None:
            drawn = believed.belief.draws(members or OF_A_BELIEF, seed)
            known = believed.belief
            return cls(None, None, drawn, seed, {}, verdict=known.verdict, discrepancy=known.discrepancy)
        if soil_map is not None:
            source = read_input(soil_map)
            return cls(None, members, None, seed, {soil_map: source.sha256}, read_soil_map(source))
        if samples is None:
            return cls(None if sweep is None else _parsed(sweep), members, None, seed, {})
        if sweep is not None:
            raise typer.BadParameter("--sweep and --samples are two ways to name the soils; give one")
        source = read_input(samples)
        inputs, thinned, verdict = {samples: source.sha256}, members is not None, read_verdict(source)
        if not samples.lower().endswith(".json"):
            drawn = read_soil_samples(source, members, seed)
            return cls(None, None, drawn, seed, inputs, thinned=thinned, verdict=verdict)
        belief = read_belief(source)
        drawn, law = belief.draws(members or OF_A_BELIEF, seed), belief.discrepancy
        return cls(None, None, drawn, seed, inputs, thinned=thinned, verdict=verdict, discrepancy=law)

    def drawn(self, scene: DriveInputs) -> tuple[str, ...]:
        """Soil parameters that each drive has for itself, whatever lies on the terrain."""
        if self.soil_map is not None:
            return tuple(SOIL_COLUMNS)
        if self.samples is not None:
            return tuple(self.samples)
        return tuple(sweep.name for sweep in (scene.plan.sweep if self.sweep is None else self.sweep))

    def check(self, scene: DriveInputs, *, seed_given: bool = False) -> None:
        """Refuse a soil that no drive meets, keep it out of the provenance, and say where a seed draws nothing."""
        if scene.soil is None and set(self.drawn(scene)) >= set(SOIL_COLUMNS):
            if scene.driven.of == "option":
                raise typer.BadParameter(
                    f"--soil {scene.driven.name} has no use beside {self._named(scene)}, which has every parameter of "
                    "the soil; leave it out"
                )
            scene.tables.pop(SOIL_TABLE, None)
            scene.options.pop("soil", None)
        if seed_given and self.drawn_by(scene) is None:
            text = "--seed has nothing to draw here: the soils are given or a grid, and the plan has no fixes"
            warnings.warn(text, LunarSciWarning, stacklevel=2)

    def drawn_by(self, scene: DriveInputs) -> int | None:
        """The seed, or None where it draws nothing."""
        believed = scene.soil is not None or self.soil_map is not None or self.kind(scene) == "belief"
        drawn = believed or self.members is not None or self.thinned or scene.plan.fixes is not None
        return self.seed if drawn else None

    def _named(self, scene: DriveInputs) -> str:
        return next(iter(self.inputs), scene.plan.origin if self.sweep is None else "--sweep")

    def record(self, scene: DriveInputs) -> dict[str, Any]:
        """The soil that is driven on, for the result."""
        named = None
        if scene.soil is None and (self.soil_map is not None or self.samples is not None):
            of: Origin = "map" if self.soil_map is not None else "samples"
            named = DrivenSoil(self._named(scene), of, scene.driven.carried, scene.driven.rest)
        return scene.soil_record(self.drawn(scene), named)

    def kind(self, scene: DriveInputs) -> str:
        """What the soils are: draws of a `belief`, other `samples`, a `sweep` of ranges, or `one`."""
        if self.soil_map is not None:
            return "belief"
        if self.samples is not None:
            path = next(iter(self.inputs), ".json" if scene.soil else "")
            return "belief" if path.lower().endswith(".json") else "samples"
        return "sweep" if (scene.plan.sweep if self.sweep is None else self.sweep) else "one"


def with_verdict(report: Report, verdict: FitVerdict | None) -> Report:
    """The report of a drive on soils that carry the verdict of a fit: repeated, and not trusted where that is not."""
    if verdict is None:
        return report
    reason = doubt(verdict)
    if reason:
        warnings.warn(reason, LunarSciWarning, stacklevel=2)
    return dataclasses.replace(
        report,
        result={**report.result, "soil_verdict": verdict.to_dict()},
        untrusted="; ".join(part for part in (report.untrusted, reason) if part),
    )


def _parsed(sweep: list[str]) -> tuple[Sweep, ...]:
    try:
        return tuple(parse_sweep(text) for text in sweep)
    except ParameterError as error:
        raise typer.BadParameter(f"--{error}" if str(error).startswith("sweep") else f"--sweep: {error}") from error


def drive(
    scene: DriveInputs, soils: Soils, time_step_s: float, sample_m: float, progress: Callable[[int, int], None]
) -> Prediction:
    """Drive the scene's plan on these soils."""
    scene.inputs.update(soils.inputs)
    grounds = None
    if soils.soil_map is not None:
        along, members = planned_places(scene.plan, scene.rover), soils.members or OF_A_BELIEF
        grounds = drawn_grounds(soils.soil_map, scene.terrain, along, members, soils.seed)
    return predict(
        scene.rover,
        scene.terrain,
        scene.plan,
        sweep=soils.sweep,
        members=soils.members if grounds is None else None,
        samples=soils.samples,
        grounds=grounds,
        seed=soils.seed,
        time_step_s=time_step_s,
        sample_m=sample_m,
        ruts=scene.ruts,
        before=scene.before,
        progress=progress,
    )


def with_physics(scene: DriveInputs, soils: Soils, prediction: Prediction) -> Prediction:
    """With what the twin's physics is off by, where the soils are of a belief or a map of beliefs."""
    law = soils.discrepancy
    if soils.soil_map is not None:
        law = soils.soil_map.belief_along(planned_places(scene.plan, scene.rover)).discrepancy
    return prediction if law is None else with_discrepancy(prediction, law, soils.seed)
