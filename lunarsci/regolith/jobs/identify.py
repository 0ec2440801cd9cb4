"""The soil that wheel states reveal, each state by itself: bearing, longitudinal and lateral shear."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import LunarSciWarning, RequestError
from lunarsci.io.inputs import Source, read_input
from lunarsci.options import request_of
from lunarsci.provenance import sha256
from lunarsci.regolith.columns import NamedBy, rover_of_states
from lunarsci.regolith.identify import (
    LABELS,
    UNITS,
    Assumptions,
    Identification,
    Sensitivity,
    StatesAgreement,
    agreement,
    sensitivities,
)
from lunarsci.regolith.identify import identify as identify_soil
from lunarsci.regolith.jobs.requests import IdentifyRequest
from lunarsci.regolith.prior import Question
from lunarsci.regolith.states import MeasurementErrors, WheelStates, read_states
from lunarsci.regolith.wheel import PAPER, Wheel, left_to_defaults, read_wheel
from lunarsci.result import NOT_TO_BE_TRUSTED, Doubt, MadeFrom, Result, job
from lunarsci.rovers import DEFAULT_ROVER, RoverDescription, called, read_rover

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ITS_WHEELS = 6
"""Of the rover whose wheel is taken where none is named."""


def assumptions_of(request: IdentifyRequest) -> Assumptions:
    """As `lunarsci.regolith.identify.identify` takes them. Raises RequestError for a modulus that is no number."""
    given = request.lateral_modulus
    try:
        moduli = tuple(float(part) for part in str(given).split(",")) if given not in (None, "") else ()
    except ValueError:
        text = f"`lateral_modulus` {given}: give one number, or several separated by commas"
        raise RequestError(text) from None
    return Assumptions(
        exponent=request.exponent,
        stiffness_kpa_m_n=request.stiffness,
        cohesion_pa=request.cohesion,
        friction_angle_deg=request.friction_angle,
        shear_modulus_mm=request.shear_modulus,
        lateral_modulus_mm=moduli,
        external_friction_angle_deg=request.external_friction_angle,
    )


def errors_of(request: IdentifyRequest) -> MeasurementErrors:
    """Of states whose table gives none."""
    return MeasurementErrors(
        sinkage_m=request.sinkage_error,
        force_relative=request.force_error,
        travel_relative=request.travel_error,
        side_slip_relative=request.side_slip_error,
    )


def alone_title(held: Mapping[str, float]) -> str:
    """What the numbers of single states are called beside the answer of all states together, with what they assume.

    >>> alone_title({"exponent": 1.0, "cohesion_pa": 520.0, "shear_modulus_mm": 17.8})
    'Each state by itself (assumes N = 1, c = 520 Pa, K_x = 17.8 mm)'
    """
    symbols = {name: label.rpartition(" ")[2] for name, label in LABELS.items()} | {"shear_modulus_mm": "K_x"}
    texts = [f"{symbols[name]} = {value:g} {UNITS[name]}".removesuffix(" -") for name, value in held.items()]
    return f"Each state by itself (assumes {', '.join(texts)})"


@dataclass(frozen=True, slots=True)
class StatesOfWheel:
    """Wheel states and the wheel that they are of.

    Attributes
    ----------
    states : as read.
    rover, wheel : the rover or wheel as it was named, and its wheel.
    origin : files, tables and sources that all comes from.
    assumed : keys of the rover's file that are guesses, and those of the wheel that it leaves to the usual numbers.
    called : its name in its file.
    named_by : `option`, `table` (the column `rover` of the states), or `default` where nothing names it.
    """

    states: WheelStates
    rover: str
    wheel: Wheel
    origin: MadeFrom
    assumed: Sequence[str]
    called: str
    named_by: NamedBy


def read_wheel_states(states: Source, rover: str | None, asked: IdentifyRequest) -> StatesOfWheel:
    """Read the states and the wheel: as asked for, as the table says, or Yutu-2's with a warning. Raises DataError."""
    source = read_input(states)
    named, by = rover_of_states(source, rover, DEFAULT_ROVER)
    description = read_rover(named)
    wheel = read_wheel(description)
    tables = {f"{named} (rover)": sha256(description.text.encode())}
    assumed = [name for name in description.assumed if name.startswith("wheel.")]
    assumed += [f"wheel.{name}" for name in left_to_defaults(description)]
    origin = MadeFrom(inputs={source.name: source.sha256}, tables=tables, sources=[PAPER], options={"rover": named})
    read = StatesOfWheel(
        read_states(source, wheel, errors_of(asked), asked.units), named, wheel, origin, assumed, description.name, by
    )
    if by == "default":
        _warn_of_default(source.name, read, description)
    return read


def _warn_of_default(file: str, given: StatesOfWheel, rover: RoverDescription) -> None:
    """Say that nobody named a rover, and which wheel is taken; names and loads like its own do not tell its size."""
    mass = rover.table("mass")
    usual = (mass["body_kg"] / ITS_WHEELS + mass["wheel_kg"]) * LUNAR_GRAVITY.value
    load = float(np.median(given.states.values[:, 3]))
    size = f"radius {1e3 * given.wheel.radius_m:g} mm, width {1e3 * given.wheel.width_m:g} mm"
    warnings.warn(
        f"{file}: no rover is named, so the wheel of {DEFAULT_ROVER} is taken ({size}; {usual:.0f} N on each, here "
        f"{load:.3g} N): another wheel gives another soil; name yours with `rover`, or {DEFAULT_ROVER}",
        LunarSciWarning,
        stacklevel=3,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifiedSoil(Result):
    """The soil that wheel states reveal.

    Attributes
    ----------
    identification : estimates of each state and of the site, curves, corners.
    rover, wheel : whose wheel was taken, as it was asked for, and the wheel.
    slip : of the states, NaN where it is unknown. (n,) [-]
    shares : where the errors come from, None where that was not asked for.
    assumed : keys of the rover's file that are guesses, and those of the wheel that it leaves to the usual numbers.
    called : its name in its file.
    named_by : `option`, `table` (the column `rover` of the states), or `default` where nothing names it.
    read_as, questions : how columns of the table were read, and what to ask of them.
    origin : files, tables and sources that it was made from.
    """

    schema: ClassVar[str] = "regolith-identify/1"
    identification: Identification
    rover: str
    wheel: Wheel
    slip: FloatArray
    shares: Sequence[Sensitivity] | None
    assumed: Sequence[str]
    called: str
    named_by: NamedBy
    origin: MadeFrom
    read_as: tuple[str, ...] = ()
    questions: tuple[Question, ...] = ()

    @property
    def made_from(self) -> MadeFrom:
        return self.origin

    @property
    def wheel_of(self) -> str:
        """Whose wheel: the name in its file, and the file where one was given."""
        return called(self.rover, self.called)

    @property
    def agreements(self) -> Sequence[StatesAgreement]:
        """Of each parameter that was solved for in several states."""
        names = [name for name in LABELS if name in self.identification.observations[0]]
        listed = ((name, [row[name] for row in self.identification.observations]) for name in names)
        return [made for name, estimates in listed if (made := agreement(name, estimates, self.slip))]

    @property
    def doubt(self) -> Doubt:
        reasons: list[object] = [*self.questions]
        reasons += [
            f"no {LABELS[name]}: {self.identification.site[name].reason}" for name in self.identification.unsolved
        ]
        against = [item.text for item in self.agreements if not item.agree]
        if against:
            reasons.append(
                f"the states contradict each other ({'; '.join(against)}): check the wheel, {self.rover}, or "
                "use `lunarsci regolith infer`, whose N rises with slip"
            )
        return Doubt.of(*reasons, verdict=NOT_TO_BE_TRUSTED)

    def to_dict(self) -> dict[str, Any]:
        shares = {} if self.shares is None else {"sensitivity": [asdict(share) for share in self.shares]}
        about = {
            "assumed_of_rover": list(self.assumed),
            "read_as": list(self.read_as),
            "questions": [asdict(one) for one in self.questions],
            "wheel": {
                "of": self.rover,
                "name": self.called,
                "named_by": self.named_by,
                "radius_m": self.wheel.radius_m,
                "width_m": self.wheel.width_m,
            },
            "agreement": [asdict(item) | {"agree": item.agree} for item in self.agreements],
        }
        return self.identification.to_dict() | about | shares

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Each state; the site is in `answers`."""
        return [_flat(row) for row in self.identification.observations]

    def answers(self) -> Sequence[Mapping[str, Any]]:
        """The values of the site, one row a parameter, the external friction angle at each assumed K_y."""
        name = "external_friction_angle_deg"
        several = self.identification.corners if len(self.identification.corners) > 1 else ()
        corners = [(name, corner[name], corner["lateral_modulus_mm"]) for corner in several]
        return [
            {"parameter": key, "unit": UNITS[key]}
            | {part: getattr(estimate, part) for part in ("value", "sigma", "low", "high", "assumed")}
            | {"at_lateral_modulus_mm": modulus, "remark": estimate.reason}
            for key, estimate, modulus in [*((key, self.identification.site[key], None) for key in LABELS), *corners]
        ]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.regolith.figure import characteristic_curves

        yield characteristic_curves(self.identification)


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """A state's estimates as columns: value, sigma, low and high of each."""
    flat: dict[str, Any] = {}
    for name, value in row.items():
        if name == "corners":
            for corner in value:
                label = f"external_friction_angle_deg_at_{corner['lateral_modulus_mm']:g}_mm"
                flat |= _columns(label, corner["external_friction_angle_deg"])
        else:
            flat |= {name: value} if isinstance(value, str) else _columns(name, value)
    return flat


def _columns(name: str, estimate: Any) -> dict[str, float | None]:
    return {name: estimate.value} | {
        f"{name}_{suffix}": getattr(estimate, suffix) for suffix in ("sigma", "low", "high")
    }


@job
def identify(
    states: Source,
    request: IdentifyRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> IdentifiedSoil:
    """Soil parameters in three aspects from wheel states, with errors; `options` replace those of the request.

    Parameters
    ----------
    states : table of wheel states, see `lunarsci.regolith.states.read_states`.
    progress : called with (done, total).

    Raises RequestError, ParameterError for values out of range, DataError for tables that cannot be used.

    Examples
    --------
    >>> site = lunarsci.identify("lunarsci-demo/wheel_states.csv", rover="yutu2", lateral_modulus="20")
    >>> values = site.to_table()["parameter", "value", "sigma", "unit"]
    """
    asked = request_of(IdentifyRequest, request, options)
    given = assumptions_of(asked)
    return identified(read_wheel_states(states, asked.rover, asked), asked, given, progress)


def identified(
    given: StatesOfWheel,
    asked: IdentifyRequest,
    assumptions: Assumptions,
    progress: Callable[[int, int], None] | None,
) -> IdentifiedSoil:
    """The same of states that are read."""
    same: dict[str, Any] = {"reading": asked.reading, "seed": asked.seed}
    result = identify_soil(given.states, given.wheel, assumptions, draws=asked.draws, progress=progress, **same)
    shares = sensitivities(given.states, given.wheel, assumptions, **same) if asked.sensitivity else None
    return IdentifiedSoil(
        identification=result,
        rover=given.rover,
        wheel=given.wheel,
        slip=given.states.values[:, 1],
        shares=shares,
        assumed=given.assumed,
        called=given.called,
        named_by=given.named_by,
        origin=replace(given.origin, seed=asked.seed),
        read_as=given.states.read_as,
        questions=given.states.questions,
    )
