"""From the options that say which soils to drive on to a prediction."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import typer

from lunarsci.errors import ParameterError
from lunarsci.inputs import read_input
from lunarsci.regolith.belief import read_belief
from lunarsci.twin.ensemble import Prediction, predict
from lunarsci.twin.plans.plan import Sweep, parse_sweep
from lunarsci.twin.soil_samples import read_soil_samples

from .twin_report import Scene, SoilOfBelief

__all__ = ["Soils", "drive"]

OF_A_BELIEF = 64
"""Drives on soils of a belief, where their number is not given."""


@dataclass(frozen=True, slots=True)
class Soils:
    """The soils of a prediction: a sweep, or samples from a file; and the seed."""

    sweep: tuple[Sweep, ...] | None
    members: int | None
    samples: Mapping[str, npt.NDArray[np.float64]] | None
    seed: int
    inputs: Mapping[str, str]

    @classmethod
    def of(
        cls,
        sweep: list[str] | None,
        members: int | None,
        samples: str | None,
        seed: int,
        believed: SoilOfBelief | None = None,
    ) -> "Soils":
        """Parse the options; a belief that is the soil leaves no room for others."""
        if believed is not None:
            for name, given in (("--sweep", sweep), ("--samples", samples)):
                if given is not None:
                    raise typer.BadParameter(f"{name} and a belief as --soil are two ways to name the soils; give one")
            return cls(None, None, believed.belief.draws(members or OF_A_BELIEF, seed), seed, {})
        if samples is None:
            return cls(None if sweep is None else _parsed(sweep), members, None, seed, {})
        if sweep is not None:
            raise typer.BadParameter("--sweep and --samples are two ways to name the soils; give one")
        source = read_input(samples)
        if samples.lower().endswith(".json"):
            drawn = read_belief(source).draws(members or OF_A_BELIEF, seed)
        else:
            drawn = read_soil_samples(source, members, seed)
        return cls(None, None, drawn, seed, {samples: source.sha256})

    def kind(self, scene: Scene) -> str:
        """What the soils are: draws of a `belief`, other `samples`, a `sweep` of ranges, or `one`."""
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
    return predict(
        scene.rover,
        scene.terrain,
        scene.plan,
        sweep=soils.sweep,
        members=soils.members,
        samples=soils.samples,
        seed=soils.seed,
        time_step_s=time_step_s,
        sample_m=sample_m,
        progress=progress,
    )
