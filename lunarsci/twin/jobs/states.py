"""From the telemetry of a drive to slip, side slip and sinkage of every wheel."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.figure import file_label
from lunarsci.io.inputs import Source, open_input, read_input
from lunarsci.io.tables import csv_bytes
from lunarsci.options import request_of
from lunarsci.regolith.soil import read_soil
from lunarsci.result import Doubt, MadeFrom, Result, job
from lunarsci.twin.drives.layouts import read_public_drive
from lunarsci.twin.ground.terrain import Terrain, read_terrain
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, read_drive_inputs
from lunarsci.twin.jobs.requests import StatesRequest
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.telemetry.checks import with_positions
from lunarsci.twin.telemetry.filter import EFFECTS
from lunarsci.twin.telemetry.reading import Findings, read_positions, read_telemetry
from lunarsci.twin.telemetry.sinkage import RutPoints, is_table_of_ruts, read_track, with_sinkage
from lunarsci.twin.telemetry.states import DriveStates, motion_table, position_table, states_of, wheel_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SMOOTHER = "Rauch, Tung & Striebel (1965), AIAA J. 3, 1445, 10.2514/3.3166"
DEEPEST = "sinkage belongs to the deepest wheel that passed a place; of the others the track says nothing"
MEASURED = ("slip_ratio", "side_slip_deg", "sinkage_m")

TABLES_OF = {
    "positions": "positions.csv",
    "states": "states.csv",
    **dict.fromkeys(("motion", "start"), "motion.csv"),
}
"""Which table another job's input is, by its name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredStates(Result):
    """Wheel states of a drive.

    Attributes
    ----------
    inputs : what drove where.
    name : of the telemetry.
    planned : whether clock and commands were compared with a plan.
    drive : the states, the motion, and what was found wrong with the telemetry.
    put_back_s : lag that was asked to be put back. [s]
    """

    schema = "twin-states/1"
    inputs: DriveInputs
    name: str
    planned: bool
    drive: DriveStates
    put_back_s: float = 0.0

    @property
    def made_from(self) -> MadeFrom:
        inputs = self.inputs
        return MadeFrom(
            inputs=inputs.inputs, tables=inputs.tables, sources=[*SOURCES, SMOOTHER], options=inputs.options
        )

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(self.drive.findings.doubt)

    @property
    def title(self) -> str:
        """What the states are of, for tables and pictures."""
        mark = " (synthetic)" if self.drive.telemetry.synthetic else ""
        return f"Wheel states from {self.name}{mark}, on {self.inputs.terrain.name}"

    def to_dict(self) -> dict[str, Any]:
        drive, rows = self.drive, self.drive.rows
        return self.inputs.about() | {
            "synthetic": drive.telemetry.synthetic,
            "plan": self.inputs.plan.name if self.planned else None,
            "states": int(rows.slip_ratio.size),
            "measured": int(rows.measured.sum()),
            "valid": int(rows.valid.sum()),
            "sinkages": int(np.isfinite(rows.sinkage_m).sum()),
            "positions": int(np.isfinite(drive.nodes.fix_m).all(axis=1).sum()),
            "positions_left_out": len(drive.left_out),
            "duration_s": float(drive.telemetry.time_s[-1] - drive.telemetry.time_s[0]),
            "distance_m": drive.driven_m,
            "wheel_distance_m": float(drive.nodes.way_m.sum()),
            "reduced_chi_square": drive.smoothed.reduced_chi_square,
            "slip_changes": _changes(drive),
            "slope_effects": _slope_effects(drive),
            "pace": None if drive.pace is None else drive.pace.to_dict(),
            "lag": drive.lag.to_dict() | {"put_back_s": self.put_back_s},
            "rolling_radius_m": drive.rover.wheel.shearing_radius_m,
            "findings": [asdict(entry) for entry in drive.findings.entries],
            "wheels": {wheel: _of_wheel(drive, k) for k, wheel in enumerate(drive.rover.wheels)},
        }

    @cached_property
    def tables(self) -> dict[str, Any]:
        """States, positions and motion, which `update` and `loads` take: name of the file to table."""
        makers = {"states.csv": wheel_table, "positions.csv": position_table, "motion.csv": motion_table}
        return {name: make(self.drive) for name, make in makers.items()}

    def rows(self) -> list[dict[str, Any]]:
        """One a time and wheel."""
        return list(self.tables["states.csv"].to_dict("records"))

    def files(self) -> dict[str, Callable[[], bytes]]:
        """The tables as CSV: name to what makes the content."""
        return {name: lambda table=table: csv_bytes(table) for name, table in self.tables.items()}  # type: ignore[misc]

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        name = TABLES_OF.get(role)
        return {name: self.files()[name]} if name else {}

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.wheel_states import states_page

        yield states_page(self.drive, self.inputs.terrain, self.title.replace(self.name, file_label(self.name)))


@job
def states(
    telemetry: Source, plan: "Source | Plan | None" = None, request: StatesRequest | None = None, **options: Any
) -> MeasuredStates:
    """Slip, side slip and sinkage of every wheel, with their errors; a `plan` is for its clock and commands.

    A folder or table of a public data set (`lunarsci.twin.drives.layouts`) has its own rover, gravity and, where no
    terrain is given, a plane by its heights and attitude. Raises DataError for telemetry that cannot be used.

    Examples
    --------
    >>> states = lunarsci.states("drive/telemetry.csv", "plan.toml", track="drive/track.csv")
    >>> slips = states.to_table()["slip_ratio", "slip_ratio_sigma"]
    """
    settings = request_of(StatesRequest, request, options)
    public, below = read_public_drive(telemetry), None
    if public is not None:
        settings = replace(settings, rover=settings.rover or public.rover, gravity=settings.gravity or public.gravity)
        below = None if settings.terrain else public.plane()
    inputs = read_drive_inputs(plan, *settings.ground, soil_counts=False, below=below)
    inputs.check.read_as = (*(public.read_as if public else ()), *inputs.check.read_as)
    with open_input(telemetry if public is None else public.telemetry) as source:
        findings = Findings(source.name)
        placed = settings.positions is None
        sent = read_telemetry(
            source, inputs.rover, findings, placed=placed, span_s=settings.span_s, start_s=settings.start_time
        )
    inputs.inputs.update({source.name: source.sha256} if public is None else public.inputs)
    if settings.positions is not None:
        fixes = read_input(settings.positions)
        inputs.inputs[fixes.name] = fixes.sha256
        located = read_positions(fixes)
        located = located._replace(time_s=located.time_s - sent.start_s)
        sent = with_positions(sent, located, fixes.name, findings)
    drive = states_of(
        sent, inputs.rover, inputs.terrain, findings, inputs.plan if plan is not None else None, settings.lag
    )
    if settings.track is not None:
        drive = with_sinkage(drive, _read_track(inputs, settings.track), inputs.terrain)
    return MeasuredStates(
        inputs=inputs, name=source.name, planned=plan is not None, drive=drive, put_back_s=settings.lag
    )


def _read_track(inputs: DriveInputs, track: Any) -> RutPoints | Terrain:
    source = read_input(track)
    inputs.inputs[source.name] = source.sha256
    if is_table_of_ruts(source):
        return read_track(source)
    track_ground = read_terrain(source.name, read_soil("longji"), onto=inputs.terrain.crs)
    return replace(track_ground, interpolation=inputs.terrain.interpolation)


def _changes(drive: DriveStates) -> dict[str, Any]:
    """How fast the deviations change that slopes do not explain; no information where the data tell nothing of it."""
    change = drive.smoothed.change
    columns = (change.usual, np.exp(change.spread), change.usual_length_m, change.information)
    keys = ("amplitude", "amplitude_factor", "length_m", "information_nat")
    rows = zip(*columns, strict=True)
    return {
        name: dict(zip(keys, map(float, row), strict=True))
        for name, row in zip(("ahead", "left", "turn_per_m"), rows, strict=True)
    }


def _slope_effects(drive: DriveStates) -> dict[str, Any]:
    """Slip and side slip, as a tangent, for slopes of 45 degrees along and across, were they proportional."""
    state, covariance = drive.smoothed.state[-1], drive.smoothed.covariance[-1]
    return {
        name: {"value": float(state[k]), "sigma": float(np.sqrt(covariance[k, k]))}
        for name, k in zip(("slip", "side_slip"), EFFECTS[:2], strict=True)
    }


def _of_wheel(drive: DriveStates, k: int) -> dict[str, Any]:
    """Medians over the measured states of a wheel, of the values and of their errors."""
    record: dict[str, Any] = {name: int(getattr(drive.rows, name)[:, k].sum()) for name in ("measured", "valid")}
    for name in MEASURED:
        value, sigma = (getattr(drive.rows, column)[:, k] for column in (name, f"{name}_sigma"))
        finite = drive.rows.measured[:, k] & np.isfinite(value)
        spread = np.percentile(value[finite], (50, 5, 95)) if finite.any() else np.full(3, np.nan)
        record[name] = {
            "median": float(spread[0]),
            "low": float(spread[1]),
            "high": float(spread[2]),
            "sigma": float(np.median(sigma[finite])) if finite.any() else np.nan,
            "count": int(finite.sum()),
        }
    return record
