"""Identify soil parameters from wheel states, with Monte Carlo uncertainties, in the three aspects of the regolith."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith import inversion
from lunarsci.regolith.forces import shear_sign_code, warn_of_shear_sign
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import ShearSign, Wheel

DRAWS = 1024
"""Sample size of Ding et al. (2024)."""
CURVES = {
    "exponent": np.round(np.arange(0.70, 1.301, 0.02), 2),
    "cohesion_pa": np.arange(0.0, 5001.0, 200.0),
    "lateral_modulus_mm": np.arange(5.0, 61.0, 2.5),
}
MOST_STATES = 100_000
POOLED_DRAWS, LEAST_POOLED = 200_000, 8
"""About how many draws of all states together make the estimates of the site, and how many of each state at least."""
PERCENTILES = (2.5, 97.5)
MIN_SOLVED = 0.5
"""With a solution in fewer draws than this the rest is a selected sample, and no value is given; assumed."""
UNITS = {
    "sigma_m_pa": "Pa",
    "tau_xm_pa": "Pa",
    "tau_ym_pa": "Pa",
    "stiffness_kpa_m_n": "kPa/m^N",
    "exponent": "-",
    "friction_angle_deg": "deg",
    "cohesion_pa": "Pa",
    "external_friction_angle_deg": "deg",
    "lateral_modulus_mm": "mm",
}
"""Unit of every estimated quantity."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A solved quantity: value at the measured states, standard deviation and 95 % interval over the Monte Carlo draws.

    `solved` is the share of draws that have a solution; None everywhere with `assumed` False means no solution, and
    `reason` says why. `assumed` values have no error.
    """

    value: float | None
    sigma: float | None = None
    low: float | None = None
    high: float | None = None
    solved: float = 0.0
    assumed: bool = False
    reason: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {name: getattr(self, name) for name in self.__slots__}


def estimate(values: FloatArray, name: str, states: int = 1) -> Estimate:
    """Of values at so many measured states, first, and their draws."""
    nominal, drawn = values[:states], values[states:]
    good = drawn[np.isfinite(drawn)]
    share = good.size / drawn.size
    if not np.isfinite(nominal).any() or share < MIN_SOLVED:
        return Estimate(None, solved=share, reason=_reason(name))
    low, high = np.percentile(good, PERCENTILES)
    value = float(np.nanmedian(nominal))
    reason = "" if share == 1 else f"{_percent(1 - share)} of the draws have no solution and are left out"
    return Estimate(value, float(np.std(good, ddof=1)), float(low), float(high), share, reason=reason)


def _percent(share: float) -> str:
    return "under 1 %" if share < 0.01 else f"{100 * share:.0f} %"


def _reason(name: str) -> str:
    if name in ("tau_ym_pa", "lateral_modulus_mm", "external_friction_angle_deg"):
        return "needs slip_ratio, side_slip_deg and lateral_force_n, and a force that side slip can mobilise"
    if name in ("friction_angle_deg", "cohesion_pa"):
        return "needs slip_ratio, and no value in range gives this drawbar pull at this slip with the rest as assumed"
    return "no value in range gives these forces at this sinkage with the rest as assumed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumptions:
    """What is assumed; of each pair, the parameter that is not given is solved for.

    With both of a pair given, each is solved at the other's value. With none of the first two pairs given, N = 1 and
    c = 520 Pa are assumed, the typical lunar values of Ding et al. (2024), 10.1038/s41467-024-46233-8, and K_y is taken
    at 13 and 40 mm, their lower and upper bound.

    Attributes
    ----------
    exponent [-], stiffness_kpa_m_n [kPa m^-N] : bearing pair N, K_s.
    cohesion_pa [Pa], friction_angle_deg [deg] : shear pair c, phi.
    shear_modulus_mm : K_x, 17.8 mm is typical. [mm]
    lateral_modulus_mm [mm], one or more values, external_friction_angle_deg [deg] : lateral pair K_y, phi_y.
    """

    exponent: float | None = None
    stiffness_kpa_m_n: float | None = None
    cohesion_pa: float | None = None
    friction_angle_deg: float | None = None
    shear_modulus_mm: float = 17.8
    lateral_modulus_mm: tuple[float, ...] = ()
    external_friction_angle_deg: float | None = None

    def __post_init__(self) -> None:
        if self.exponent is None and self.stiffness_kpa_m_n is None:
            object.__setattr__(self, "exponent", 1.0)
        if self.cohesion_pa is None and self.friction_angle_deg is None:
            object.__setattr__(self, "cohesion_pa", 520.0)
        if not self.lateral_modulus_mm and self.external_friction_angle_deg is None:
            object.__setattr__(self, "lateral_modulus_mm", (13.0, 40.0))
        positive = [self.exponent, self.stiffness_kpa_m_n, self.shear_modulus_mm, *self.lateral_modulus_mm]
        if not all(value is None or 0 < value < np.inf for value in positive):
            raise ParameterError("exponent, stiffness, shear modulus and lateral modulus must be above 0")
        for angle in (self.friction_angle_deg, self.external_friction_angle_deg):
            if angle is not None and not 0 <= angle < 90:
                raise ParameterError(f"friction angle {angle:g}: give 0 to below 90 deg")
        if self.cohesion_pa is not None and not 0 <= self.cohesion_pa < np.inf:
            raise ParameterError(f"cohesion {self.cohesion_pa:g}: give 0 Pa or more")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """The soil that a set of wheel states reveals.

    Attributes
    ----------
    observations : per state, its id and the estimates of `sigma_m_pa`, `tau_xm_pa`, `tau_ym_pa` and of every solved
        parameter.
    site : the same parameters over all states: median of the values, and the spread of single states and their errors
        together. It tells what one state may give, not how well many of them determine a common soil.
    curves : per aspect, points of the curve the states allow, each with value, low and high.
    corners : the external friction angle at each assumed K_y.
    unsolved : parameters that were asked for and have no solution in any state.
    """

    observations: tuple[dict[str, Any], ...]
    site: dict[str, Estimate]
    curves: dict[str, list[dict[str, Any]]]
    corners: tuple[dict[str, Any], ...]
    unsolved: tuple[str, ...]
    draws: int
    reading: str
    assumptions: Assumptions = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The keys of `lunarsci regolith identify --json`."""
        names = {
            "bearing": ("stiffness_kpa_m_n", "exponent"),
            "shear": ("friction_angle_deg", "cohesion_pa"),
            "lateral": ("external_friction_angle_deg", "lateral_modulus_mm"),
        }
        result: dict[str, Any] = {
            aspect: {name: self.site[name].to_dict() for name in pair} | {"curve": self.curves[aspect]}
            for aspect, pair in names.items()
        }
        result["lateral"]["corners"] = _plain(self.corners)
        return result | {"observations": _plain(self.observations), "draws": self.draws, "reading": self.reading}


def _plain(value: Any) -> Any:
    """Estimates as dictionaries, however deep they sit."""
    if isinstance(value, Estimate):
        return value.to_dict()
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def identify(
    states: WheelStates,
    wheel: Wheel,
    assumptions: Assumptions | None = None,
    *,
    reading: ShearSign = "signed",
    draws: int = DRAWS,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Identification:
    """Soil parameters from wheel states.

    Each state is solved for its stresses (Eqs 21, 22, 24) and these for the parameters; the errors of the inputs are
    drawn `draws` times from independent normal laws and carried through the same equations.

    Parameters
    ----------
    states, wheel : what was measured, and with which wheel.
    assumptions : what is taken as known.
    reading : of the shear law, see `lunarsci.regolith.forces`; all but `signed` warn.
    draws : Monte Carlo sample size, 2 or more. [-]
    seed : of the random numbers.
    progress : called with (done, total).

    Raises
    ------
    ParameterError for an unknown reading or too few draws.

    References
    ----------
    Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8.
    """
    if draws < 2:
        raise ParameterError(f"{draws} draws; give 2 or more")
    if len(states) > MOST_STATES:
        raise ParameterError(f"{len(states)} wheel states are more than {MOST_STATES}; give every tenth, for example")
    code = shear_sign_code(reading)
    warn_of_shear_sign(reading)
    known = assumptions or Assumptions()
    solver = _Solver(wheel, known, code, np.random.default_rng(seed), draws)
    kept = min(draws, max(LEAST_POOLED, POOLED_DRAWS // len(states)))
    observations, measured, drawn = [], [], []
    for number, (name, values, sigmas) in enumerate(zip(states.id, states.values, states.sigmas, strict=True), 1):
        stresses = solver.stresses(values, sigmas)
        observations.append(_Solved(stresses, known).record(name))
        measured.append(stresses[:1].copy())
        drawn.append(stresses[1 : 1 + kept].copy())
        if progress:
            progress(number, len(states))
    solved = _Solved(np.concatenate([*measured, *drawn]), known, len(states))
    site = _site(solved, known)
    return Identification(
        observations=tuple(observations),
        site=site,
        curves=_curves(solved),
        corners=tuple(_corners(solved)),
        unsolved=_unsolved(states, site),
        draws=draws,
        reading=reading,
        assumptions=known,
    )


class _Solver:
    """Solve one state after another, nominal values first and the draws behind them."""

    def __init__(self, wheel: Wheel, known: Assumptions, code: int, rng: np.random.Generator, draws: int) -> None:
        self.wheel, self.known, self.code, self.rng, self.draws = wheel.vector(), known, code, rng, draws

    def stresses(self, values: FloatArray, sigmas: FloatArray) -> FloatArray:
        drawn = values + sigmas * self.rng.standard_normal((self.draws, values.size))
        sample = np.vstack([values, drawn])
        modulus = self.known.shear_modulus_mm * 1e-3
        return np.asarray(inversion.invert_states(sample, self.wheel, modulus, self.code))


class _Solved:
    """Stresses of states as measured, and of their draws behind them, and the parameters that follow."""

    def __init__(self, stresses: FloatArray, known: Assumptions, states: int = 1) -> None:
        self.sigma_m, self.tau_x, self.tau_y, self.depth, self.mobilised, self.displacement = stresses.T
        self.known, self.states = known, states
        with np.errstate(all="ignore"):
            self.parameters = self._parameters()

    def _parameters(self) -> dict[str, FloatArray]:
        known, found = self.known, {}
        if known.exponent is not None:
            found["stiffness_kpa_m_n"] = inversion.stiffness(self.sigma_m, self.depth, known.exponent)
        if known.stiffness_kpa_m_n is not None:
            found["exponent"] = inversion.sinkage_exponent(self.sigma_m, self.depth, known.stiffness_kpa_m_n)
        if known.cohesion_pa is not None:
            found["friction_angle_deg"] = self.friction_angle(known.cohesion_pa)
        if known.friction_angle_deg is not None:
            found["cohesion_pa"] = inversion.cohesion(
                self.sigma_m, self.tau_x, self.mobilised, known.friction_angle_deg
            )
        adhesion = known.cohesion_pa if known.cohesion_pa is not None else found["cohesion_pa"]
        self.corners = {m: self.external_friction_angle(m, adhesion) for m in known.lateral_modulus_mm}
        if known.external_friction_angle_deg is not None:
            found["lateral_modulus_mm"] = inversion.lateral_modulus(
                self.sigma_m, self.tau_y, self.displacement, known.external_friction_angle_deg, adhesion
            )
        return found

    def friction_angle(self, cohesion_pa: Any) -> FloatArray:
        return np.asarray(inversion.friction_angle(self.sigma_m, self.tau_x, self.mobilised, cohesion_pa))

    def external_friction_angle(self, modulus_mm: Any, cohesion_pa: Any) -> FloatArray:
        angle = inversion.external_friction_angle(self.sigma_m, self.tau_y, self.displacement, modulus_mm, cohesion_pa)
        return np.asarray(angle)

    def record(self, name: str) -> dict[str, Any]:
        stresses = {"sigma_m_pa": self.sigma_m, "tau_xm_pa": self.tau_x, "tau_ym_pa": self.tau_y}
        estimates = {key: estimate(sample, key) for key, sample in (stresses | self.parameters).items()}
        return {"id": name, "corners": _corners(self)} | estimates


def _site(solved: _Solved, known: Assumptions) -> dict[str, Estimate]:
    """Every parameter over all states: estimated where it was solved for, as assumed where it was given."""
    site = {name: estimate(values, name, solved.states) for name, values in solved.parameters.items()}
    if known.lateral_modulus_mm:
        name = "external_friction_angle_deg"
        site[name] = _over_corners([corner[name] for corner in _corners(solved)])
    return _assumed(known) | site


def _over_corners(found: Sequence[Estimate]) -> Estimate:
    """One estimate as it is; of several, which rest on different assumptions, only the range they span."""
    low, high = [e.low for e in found if e.low is not None], [e.high for e in found if e.high is not None]
    if len(found) == 1 or not (low and high):
        return found[0]
    solved = min(estimate.solved for estimate in found)
    return Estimate(None, None, min(low), max(high), solved, reason="depends on the assumed K_y; the range spans them")


def _unsolved(states: WheelStates, site: dict[str, Estimate]) -> tuple[str, ...]:
    """Parameters without a solution although what they need was measured."""
    needs = {"friction_angle_deg": 1, "cohesion_pa": 1, "external_friction_angle_deg": 5, "lateral_modulus_mm": 5}
    return tuple(
        name
        for name, found in site.items()
        if found.low is None and not found.assumed and np.isfinite(states.values[:, needs.get(name, 0)]).any()
    )


def _corners(solved: _Solved) -> list[dict[str, Any]]:
    """External friction angle at each assumed lateral modulus, over the given states."""
    name = "external_friction_angle_deg"
    return [
        {"lateral_modulus_mm": modulus, name: estimate(values, name, solved.states)}
        for modulus, values in solved.corners.items()
    ]


def _assumed(known: Assumptions) -> dict[str, Estimate]:
    """What was given, as estimates without an error."""
    moduli = known.lateral_modulus_mm
    several = "assumed at several values, see the corners" if len(moduli) > 1 else ""
    given = {
        "stiffness_kpa_m_n": known.stiffness_kpa_m_n,
        "exponent": known.exponent,
        "friction_angle_deg": known.friction_angle_deg,
        "cohesion_pa": known.cohesion_pa,
        "external_friction_angle_deg": known.external_friction_angle_deg,
        "lateral_modulus_mm": moduli[0] if len(moduli) == 1 else None,
    }
    return {
        name: Estimate(value, solved=1.0, assumed=True, reason=several if name == "lateral_modulus_mm" else "")
        for name, value in given.items()
    }


def _curves(solved: _Solved) -> dict[str, list[dict[str, Any]]]:
    known = solved.known.cohesion_pa
    adhesion = known if known is not None else solved.parameters["cohesion_pa"]
    laws: dict[str, tuple[str, str, Callable[[Any], FloatArray]]] = {
        "bearing": (
            "exponent",
            "stiffness_kpa_m_n",
            lambda n: np.asarray(inversion.stiffness(solved.sigma_m, solved.depth, n)),
        ),
        "shear": ("cohesion_pa", "friction_angle_deg", solved.friction_angle),
        "lateral": (
            "lateral_modulus_mm",
            "external_friction_angle_deg",
            lambda k: solved.external_friction_angle(k, adhesion),
        ),
    }
    with np.errstate(all="ignore"):
        return {
            curve: [_point(x_name, x, y_name, estimate(law(x), y_name, solved.states)) for x in CURVES[x_name]]
            for curve, (x_name, y_name, law) in laws.items()
        }


def _point(x_name: str, x: float, y_name: str, found: Estimate) -> dict[str, Any]:
    return {x_name: float(x), y_name: found.value, "low": found.low, "high": found.high}
