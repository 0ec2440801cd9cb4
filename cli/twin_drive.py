"""From the options that say which soils to drive on to a prediction."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import typer

from lunarsci.inputs import read_input
from lunarsci.regolith.belief import read_belief
from lunarsci.twin.ensemble import Prediction, predict
from lunarsci.twin.plans.plan import Sweep, parse_sweep
from lunarsci.twin.soil_samples import read_soil_samples

from .twin_report import Scene

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
    def of(cls, sweep: list[str] | None, members: int | None, samples: str | None, seed: int) -> "Soils":
        """Parse the options."""
        if samples is None:
            swept = None if sweep is None else tuple(parse_sweep(text) for text in sweep)
            return cls(swept, members, None, seed, {})
        if sweep is not None:
            raise typer.BadParameter("--sweep and --samples are two ways to name the soils; give one")
        source = read_input(samples)
        if samples.lower().endswith(".json"):
            drawn = read_belief(source).draws(members or OF_A_BELIEF, seed)
        else:
            drawn = read_soil_samples(source, members, seed)
        return cls(None, None, drawn, seed, {samples: source.sha256})


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
