"""What the wheels carry and pull along a predicted drive."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.errors import RequestError
from lunarsci.io.inputs import Source
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Result
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, Soils, read_drive_inputs
from lunarsci.twin.jobs.predict import predict_drives
from lunarsci.twin.jobs.requests import DriveRequest
from lunarsci.twin.judgement.quantities import abscissa
from lunarsci.twin.judgement.tables import WheelLoads, state_table, wheel_loads
from lunarsci.twin.lanes import outcome_texts
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.simulation.ensemble import Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure


TOGETHER = (
    "together the wheels supply what the balance of forces asks for; how much of it each wheel supplies still "
    "depends on the assumed soil"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveForces(Result):
    """Forces of the wheels along predicted drives; those of all members count alike.

    Attributes
    ----------
    soils : what drove where, on which soils.
    prediction : paths, wheel states and forces of all drives.
    loads : summary of each wheel.
    """

    schema = "twin-forces/1"
    soils: Soils
    prediction: Prediction
    loads: Sequence[WheelLoads]

    @property
    def failed(self) -> list[str]:
        """How drives ended that did not come to the end, each once."""
        return outcome_texts(self.prediction.outcome)

    @property
    def made_from(self) -> MadeFrom:
        inputs, seed = self.soils.inputs, self.soils.drawn_by
        return MadeFrom(inputs=inputs.inputs, tables=inputs.tables, sources=SOURCES, seed=seed, options=inputs.options)

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(Doubt(tuple(self.failed), "not driven to the end"), self.soils.doubt)

    @property
    def title(self) -> str:
        """What the forces are of, for tables and pictures."""
        inputs, members = self.soils.inputs, self.prediction.members
        drives = "1 drive" if members == 1 else f"{members} drives"
        return f"Wheel forces of {drives}: {inputs.plan.name}, on {inputs.terrain.name}"

    def to_dict(self) -> dict[str, Any]:
        record = {"of": "prediction", "members": self.prediction.members, "missing": None, "soil": self.soils.record()}
        return load_record(self.soils.inputs, self.loads) | record

    def rows(self) -> list[dict[str, Any]]:
        """One a drive, time and wheel."""
        return list(state_table(self.prediction).to_dict("records"))  # type: ignore[arg-type]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.wheel_states import force_figure

        prediction = self.prediction
        drawn = (prediction.rover.wheels, abscissa(prediction), _reached(prediction), self.title)
        yield force_figure(*drawn, synthetic=prediction.terrain.synthetic)


def forces(
    plan: "Source | Plan | None" = None,
    request: DriveRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> DriveForces:
    """Forces of every wheel along a predicted drive, the embedded one if `plan` is None.

    Without a sweep, a number of members or a file of soils one drive is made.

    Raises DataError for what cannot be read, RequestError for options that are impossible.
    """
    asked = request_of(DriveRequest, request, options)
    inputs = read_drive_inputs(plan, *asked.ground, soil=asked.soil, fixes=asked.fixes)
    alone = not asked.sweep and asked.members is None and inputs.given.one_soil
    soils = Soils.of(inputs, () if alone else asked.sweep or None, inputs.given.members(asked.members), asked.seed or 0)
    if asked.seed is not None and soils.drawn_by is None:
        raise RequestError("`seed` has nothing to draw; give `members`, `soil` or `fixes`, or leave it out")
    prediction = predict_drives(soils, asked.time_step, asked.sample, progress)
    loads = wheel_loads(prediction.rover.wheels, _reached(prediction))
    return DriveForces(soils=soils, prediction=prediction, loads=loads)


def _reached(prediction: Prediction) -> Any:
    """States as far as was driven, NaN beyond."""
    return np.where(prediction.reached[..., None, None], prediction.states, np.nan)


def load_record(inputs: DriveInputs, loads: Sequence[WheelLoads]) -> dict[str, Any]:
    """Rover, terrain and wheels, for a result."""
    return inputs.about() | {
        "weight_n": inputs.rover.mass_kg * inputs.rover.gravity_m_s2,
        "wheels": [
            {"wheel": load.wheel, "valid_share": load.valid_share}
            | {name: asdict(spread) for name, spread in load.quantities.items()}
            for load in loads
        ],
    }
