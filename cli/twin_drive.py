"""From the options that say which soils to drive on to a prediction."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import typer

from lunarsci.errors import ParameterError
from lunarsci.inputs import read_input
from lunarsci.regolith.belief import read_belief
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.drive_pieces import planned_places
from lunarsci.twin.ensemble import Prediction, predict
from lunarsci.twin.ground.soil_layers import drawn_grounds
from lunarsci.twin.ground.soil_map import SoilMap
from lunarsci.twin.ground.soil_map_files import read_soil_map
from lunarsci.twin.path_discrepancy import with_discrepancy
from lunarsci.twin.plans.plan import Sweep, parse_sweep
from lunarsci.twin.soil_samples import read_soil_samples

from .twin_report import Scene, SoilOfBelief

__all__ = ["Soils", "drive", "with_physics"]

OF_A_BELIEF = 64
"""Drives on soils of a belief, where their number is not given."""


@dataclass(frozen=True, slots=True)
class Soils:
    """The soils of a prediction: a sweep, or samples from a file; and the seed.

    `discrepancy` is what a belief knows of the twin's physics, None where the soils are of no belief.
    """

    sweep: tuple[Sweep, ...] | None
    members: int | None
    samples: Mapping[str, npt.NDArray[np.float64]] | None
    seed: int
    inputs: Mapping[str, str]
    soil_map: SoilMap | None = None
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
            return cls(None, None, drawn, seed, {}, discrepancy=believed.belief.discrepancy)
        if soil_map is not None:
            source = read_input(soil_map)
            return cls(None, members, None, seed, {soil_map: source.sha256}, read_soil_map(source))
        if samples is None:
            return cls(None if sweep is None else _parsed(sweep), members, None, seed, {})
        if sweep is not None:
            raise typer.BadParameter("--sweep and --samples are two ways to name the soils; give one")
        source = read_input(samples)
        inputs = {samples: source.sha256}
        if not samples.lower().endswith(".json"):
            return cls(None, None, read_soil_samples(source, members, seed), seed, inputs)
        belief = read_belief(source)
        drawn = belief.draws(members or OF_A_BELIEF, seed)
        return cls(None, None, drawn, seed, inputs, discrepancy=belief.discrepancy)

    def kind(self, scene: Scene) -> str:
        """What the soils are: draws of a `belief`, other `samples`, a `sweep` of ranges, or `one`."""
        if self.soil_map is not None:
            return "belief"
        if self.samples is not None:
            path = next(iter(self.inputs), ".json" if scene.soil else "")
            return "belief" if path.lower().endswith(".json") else "samples"
        return "sweep" if (scene.plan.sweep if self.sweep is None else self.sweep) else "one"


def _parsed(sweep: list[str]) -> tuple[Sweep, ...]:
    try:
        return tuple(parse_sweep(text) for text in sweep)
    except ParameterError as error:
        raise typer.BadParameter(f"--{error}" if str(error).startswith("sweep") else f"--sweep: {error}") from error


def drive(
    scene: Scene, soils: Soils, time_step_s: float, sample_m: float, progress: Callable[[int, int], None]
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
        progress=progress,
    )


def with_physics(scene: Scene, soils: Soils, prediction: Prediction) -> Prediction:
    """With what the twin's physics is off by, where the soils are of a belief or a map of beliefs."""
    law = soils.discrepancy
    if soils.soil_map is not None:
        law = soils.soil_map.belief_along(planned_places(scene.plan, scene.rover)).discrepancy
    return prediction if law is None else with_discrepancy(prediction, law, soils.seed)
