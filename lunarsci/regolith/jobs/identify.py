"""The soil that wheel states reveal, each state by itself: bearing, longitudinal and lateral shear."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.errors import RequestError
from lunarsci.inputs import Source, read_input
from lunarsci.regolith.wheel import PAPER, ShearSign
from lunarsci.result import MadeFrom, Result, job, request_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lunarsci.regolith.identify import Assumptions, Identification
    from lunarsci.regolith.sensitivity import Sensitivity
    from lunarsci.regolith.states import MeasurementErrors, WheelStates
    from lunarsci.regolith.wheel import Wheel


LABELS = {
    "stiffness_kpa_m_n": "stiffness K_s",
    "exponent": "sinkage exponent N",
    "friction_angle_deg": "internal friction angle φ",
    "cohesion_pa": "cohesion c",
    "external_friction_angle_deg": "external friction angle φ_y",
    "lateral_modulus_mm": "lateral shear modulus K_y",
}
"""Parameters of the site in words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyRequest:
    """What is assumed, and how errors are drawn.

    Of each pair what is given is assumed and the other is solved for; with both given, each is solved at the other's
    value; with none, the lunar values of `Assumptions` are taken.

    Attributes
    ----------
    rover : rover or wheel, a name or a TOML file.
    exponent [-], stiffness [kPa m^-N] : bearing pair N, K_s.
    cohesion [Pa], friction_angle [deg] : shear pair c, phi.
    shear_modulus : K_x. [mm]
    lateral_modulus [mm], external_friction_angle [deg] : lateral pair K_y, phi_y; K_y is a number, or several as text
        with commas between them.
    reading : sign convention of the longitudinal shear stress.
    draws, seed : Monte Carlo draws of each state, 2 or more, and the seed of the random numbers.
    sinkage_error [m], force_error, travel_error, side_slip_error : standard deviations where the table gives none, all
        but the first as shares, see `MeasurementErrors`.
    sensitivity : whether to say how much of each variance comes from each measured quantity.
    """

    rover: str = "yutu2"
    exponent: float | None = None
    stiffness: float | None = None
    cohesion: float | None = None
    friction_angle: float | None = None
    shear_modulus: float = 17.8
    lateral_modulus: str | float | None = None
    external_friction_angle: float | None = None
    reading: ShearSign = "signed"
    draws: int = 1024
    seed: int = 0
    sinkage_error: float = 0.00033
    force_error: float = 0.1 / 3
    travel_error: float = 0.04 / 3
    side_slip_error: float = 0.04 / 3
    sensitivity: bool = False

    @property
    def assumptions(self) -> "Assumptions":
        """As `lunarsci.regolith.identify.identify` takes them. Raises RequestError for a modulus that is no number."""
        from lunarsci.regolith.identify import Assumptions

        given = self.lateral_modulus
        try:
            moduli = tuple(float(part) for part in str(given).split(",")) if given not in (None, "") else ()
        except ValueError:
            text = f"`lateral_modulus` {given}: give one number, or several separated by commas"
            raise RequestError(text) from None
        return Assumptions(
            exponent=self.exponent,
            stiffness_kpa_m_n=self.stiffness,
            cohesion_pa=self.cohesion,
            friction_angle_deg=self.friction_angle,
            shear_modulus_mm=self.shear_modulus,
            lateral_modulus_mm=moduli,
            external_friction_angle_deg=self.external_friction_angle,
        )

    @property
    def errors(self) -> "MeasurementErrors":
        """Of states whose table gives none."""
        from lunarsci.regolith.states import MeasurementErrors

        return MeasurementErrors(
            sinkage_m=self.sinkage_error,
            force_relative=self.force_error,
            travel_relative=self.travel_error,
            side_slip_relative=self.side_slip_error,
        )


@dataclass(frozen=True, slots=True)
class StatesOfWheel:
    """Wheel states, the wheel, where both come from, and keys of the rover's file that are guesses."""

    states: "WheelStates"
    wheel: "Wheel"
    origin: MadeFrom
    assumed: Sequence[str]


def read_wheel_states(states: Source, rover: str, errors: "MeasurementErrors") -> StatesOfWheel:
    """Read the wheel states and the wheel. Raises DataError."""
    from lunarsci.provenance import sha256
    from lunarsci.regolith.states import read_states
    from lunarsci.regolith.wheel import read_wheel
    from lunarsci.rovers import read_rover

    description, source = read_rover(rover), read_input(states)
    wheel = read_wheel(description)
    tables = {f"{rover} (rover)": sha256(description.text.encode())}
    assumed = [name for name in description.assumed if name.startswith("wheel.")]
    origin = MadeFrom(inputs={source.name: source.sha256}, tables=tables, sources=[PAPER])
    return StatesOfWheel(read_states(source, wheel, errors), wheel, origin, assumed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifiedSoil(Result):
    """The soil that wheel states reveal.

    Attributes
    ----------
    found : estimates of each state and of the site, curves, corners.
    shares : where the errors come from, None where that was not asked for.
    assumed : keys of the rover's file that are guesses.
    """

    schema: ClassVar[str] = "regolith-identify/1"
    found: "Identification"
    shares: "Sequence[Sensitivity] | None"
    assumed: Sequence[str]
    origin: MadeFrom

    @property
    def made_from(self) -> MadeFrom:
        return self.origin

    @property
    def untrusted(self) -> str:
        reasons = [f"no {LABELS[name]}: {self.found.site[name].reason}" for name in self.found.unsolved]
        return f"not to be trusted: {'; '.join(reasons)}" if reasons else ""

    def to_dict(self) -> dict[str, Any]:
        shares = {} if self.shares is None else {"sensitivity": [asdict(share) for share in self.shares]}
        return self.found.to_dict() | {"assumed_of_rover": list(self.assumed)} | shares

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [_flat(row) for row in self.found.observations]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.regolith.figure import characteristic_curves

        yield characteristic_curves(self.found)


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
    """
    from dataclasses import replace

    from lunarsci.regolith.identify import identify as identify_soil
    from lunarsci.regolith.sensitivity import sensitivities

    asked = request_of(IdentifyRequest, request, options)
    known = asked.assumptions
    given = read_wheel_states(states, asked.rover, asked.errors)
    same: dict[str, Any] = {"reading": asked.reading, "seed": asked.seed}
    found = identify_soil(given.states, given.wheel, known, draws=asked.draws, progress=progress, **same)
    shares = sensitivities(given.states, given.wheel, known, **same) if asked.sensitivity else None
    return IdentifiedSoil(
        found=found, shares=shares, assumed=given.assumed, origin=replace(given.origin, seed=asked.seed)
    )
