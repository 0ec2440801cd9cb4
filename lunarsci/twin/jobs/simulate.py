"""A made-up drive, and the telemetry that it would send."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.errors import RequestError
from lunarsci.io.inputs import Source
from lunarsci.io.tables import csv_bytes
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Result
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, read_drive_inputs
from lunarsci.twin.jobs.requests import SimulateDriveRequest
from lunarsci.twin.judgement.tables import state_table
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.simulation.ensemble import predict
from lunarsci.twin.telemetry.simulated import SensorErrors, SyntheticDrive, simulate_telemetry

if TYPE_CHECKING:
    import pandas as pd


XY = ("x_m", "y_m")
REMARK = b"# synthetic: made up by `lunarsci twin simulate`, not a measurement\n"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MadeUpDrive(Result):
    """A simulated drive on a known soil: what drove where, and the telemetry with the truth behind it."""

    schema: ClassVar[str] = "twin-simulate/1"
    inputs: DriveInputs
    drive: SyntheticDrive

    @property
    def made_from(self) -> MadeFrom:
        inputs = self.inputs
        options, seed = inputs.options, self.drive.seed
        return MadeFrom(inputs=inputs.inputs, tables=inputs.tables, sources=SOURCES, seed=seed, options=options)

    @property
    def doubt(self) -> Doubt:
        driven = self.drive.prediction
        return Doubt.of("" if driven.finished[0] else f"the drive did not reach its end: {driven.outcome_text(0)}")

    def to_dict(self) -> dict[str, Any]:
        telemetry, errors = self.drive.telemetry, asdict(self.drive.errors)
        errors.pop("fix_sigma_m")
        return {
            **self.inputs.about(),
            "synthetic": True,
            "plan": self.inputs.plan.name,
            "soil": self.inputs.soil_record(),
            "rows": len(telemetry),
            "positions": int(telemetry["x_m"].notna().sum()),
            "track_points": len(self.drive.track),
            "duration_s": float(telemetry["time_s"].iloc[-1]),
            "outcome": self.drive.prediction.outcome_text(0),
            **self._halts(),
            "errors": errors | {"position_m": self.drive.errors.position_m},
        }

    def _halts(self) -> dict[str, Any]:
        """Where the rover halted for a position fix, and how far off this was; nothing for a plan without fixes."""
        driven, sent = self.drive.prediction, self.drive.telemetry
        if driven.plan.fixes is None:
            return {}
        return {
            "halts": [
                {
                    "time_s": float(driven.time_s[row]),
                    "distance_m": float(driven.distance_m[row]),
                    "x_m": float(driven.paths[0, row, 0]),
                    "y_m": float(driven.paths[0, row, 1]),
                    "off_m": math.hypot(*(sent[name].iloc[row] - driven.paths[0, row, k] for k, name in enumerate(XY))),
                }
                for row in self.drive.halts.tolist()
            ]
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [{str(name): cell for name, cell in row.items()} for row in self.drive.telemetry.to_dict("records")]

    def files(self) -> dict[str, Callable[[], bytes]]:
        """Telemetry, track and truth, each marked as made up: name to what makes the content."""
        return {
            "telemetry.csv": lambda: _marked(self.drive.telemetry),
            "track.csv": lambda: _marked(self.drive.track),
            "truth.csv": lambda: _marked(state_table(self.drive.prediction)),
        }


def simulate_drive(
    plan: "Source | Plan | None" = None,
    request: SimulateDriveRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> MadeUpDrive:
    """Drive a plan once on one soil, and blur what is seen of it by the errors of the sensors.

    Raises DataError for what cannot be read, RequestError for options that are impossible.
    """
    asked = request_of(SimulateDriveRequest, request, options)
    errors = SensorErrors(
        fix_distance_m=asked.fix_distance,
        fix_sigma_m=asked.fix_sigma,
        yaw_deg=asked.yaw_sigma,
        track_m=asked.track_sigma,
    )
    inputs = read_drive_inputs(plan, *asked.ground, soil=asked.soil, ruts=asked.ruts, before=asked.before)
    if not inputs.given.one_soil:
        raise RequestError(f"`soil` {asked.soil} is a belief, and the truth is one soil; give a name or a TOML file")
    # Where the plan has fixes their errors are other ones than those of the predictions with the same seed.
    drawn = int(np.random.SeedSequence([asked.seed, 41]).generate_state(1)[0])
    prediction = predict(
        inputs.rover,
        inputs.terrain,
        inputs.plan,
        sweep=(),
        time_step_s=asked.time_step,
        sample_m=asked.sample,
        ruts=bool(inputs.ruts),
        before=inputs.before,
        seed=drawn,
        progress=progress,
    )
    return MadeUpDrive(inputs=inputs, drive=simulate_telemetry(prediction, errors, asked.seed))


def _marked(table: "pd.DataFrame") -> bytes:
    return REMARK + csv_bytes(table)
