"""Identify soil parameters from wheel states, with Monte Carlo uncertainties, in the three aspects of the regolith.

Each state is solved by itself: whether all of them give one soil, and which measured quantity the errors come from.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import gammaincc

from lunarsci.arrays import FloatArray
from lunarsci.compiled import each_in_threads
from lunarsci.ranges import ACUTE_DEG, NOT_NEGATIVE, POSITIVE, check_each, refuse
from lunarsci.regolith import inversion
from lunarsci.regolith.forces import shear_sign_code, warn_of_shear_sign
from lunarsci.regolith.prior import SIGNIFICANCE
from lunarsci.regolith.prior import UNITS as SOIL_UNITS
from lunarsci.regolith.states import COLUMNS, WheelStates
from lunarsci.regolith.wheel import ShearSign, Wheel

DRAWS = 1024
"""Sample size of Ding et al. (2024)."""
CURVES = {
    "exponent": np.round(np.arange(0.70, 1.301, 0.02), 2),
    "cohesion_pa": np.arange(0.0, 5001.0, 200.0),
    "lateral_modulus_mm": np.arange(5.0, 61.0, 2.5),
}
"""Values of one parameter of a pair at which the other is solved for, to draw the curves."""
COUNTS = {
    "draws": "[2, inf)",
    "wheel states": "[1, 100000]; take every tenth, for example",
}
"""Ranges of how many draws and states there can be."""
SENSITIVITY_STATES = 50
"""States of a longer file, evenly over it, that shares of variance are computed of; assumed."""
POOLED_DRAWS, LEAST_POOLED = 200_000, 8
"""About how many draws of all states together make the estimates of the site, and how many of each state at least."""
PERCENTILES = (2.5, 97.5)
"""Ends of an interval of 95 %."""
MIN_SOLVED = 0.5
"""Share of the draws with a solution below which no value is given: the others may hold its median; assumed."""
UNITS = {**dict.fromkeys(("sigma_m_pa", "tau_xm_pa", "tau_ym_pa"), "Pa"), "exponent": "-", **SOIL_UNITS}
"""Unit of every estimated quantity."""
RANGES = {
    **dict.fromkeys(("exponent", "stiffness_kpa_m_n", "shear_modulus_mm", "lateral_modulus_mm"), POSITIVE),
    **dict.fromkeys(("friction_angle_deg", "external_friction_angle_deg"), ACUTE_DEG),
    "cohesion_pa": NOT_NEGATIVE,
}
"""Of what may be given."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A solved quantity, in the unit that `UNITS` has for it. None everywhere with `assumed` False means no solution.

    value : at the measured states, their median where there are several.
    sigma, low, high : standard deviation and ends of the 95 % interval over the Monte Carlo draws.
    solved : share of the draws that have a solution. [-]
    assumed : whether it was given; it has no error then.
    reason : why there is no value, or what the value does not include; '' for none.
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
    sigma, value = float(np.std(good, ddof=1)), float(np.nanmedian(nominal))
    low, high = np.percentile(good, PERCENTILES, overwrite_input=True)
    reason = "" if share == 1 else f"{_percent(1 - share)} of the draws have no solution and are left out"
    return Estimate(value, sigma, float(low), float(high), share, reason=reason)


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
    exponent, stiffness_kpa_m_n : bearing pair N, K_s. [-, kPa m^-N]
    cohesion_pa, friction_angle_deg : shear pair c, phi. [Pa, deg]
    shear_modulus_mm : K_x, 17.8 mm is typical. [mm]
    lateral_modulus_mm, external_friction_angle_deg : lateral pair K_y, one or more values, and phi_y. [mm, deg]
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
        check_each("assumed", self, RANGES)


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
    draws : Monte Carlo sample size of each state.
    reading : of the shear law.
    assumptions : what was taken as given.
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
    check_each("number of", {"draws": draws, "wheel states": len(states)}, COUNTS)
    code = shear_sign_code(reading)
    warn_of_shear_sign(reading)
    given, random = assumptions or Assumptions(), np.random.default_rng(seed)
    pooled = min(draws, max(LEAST_POOLED, POOLED_DRAWS // len(states)))
    observations, measured, drawn = [], [], []
    for number, (name, values, sigmas) in enumerate(zip(states.id, states.values, states.sigmas, strict=True), 1):
        sample = np.empty((1 + draws, values.size))
        random.standard_normal(out=sample[1:])
        sample[1:] *= sigmas
        sample[0] = 0.0
        sample += values
        stresses = inversion.invert_states(sample, wheel.vector(), given.shear_modulus_mm * 1e-3, code)
        observations.append(_Solved(stresses, given).record(name))
        measured.append(stresses[:1].copy())
        drawn.append(stresses[1 : 1 + pooled].copy())
        if progress:
            progress(number, len(states))
    solved = _Solved(np.concatenate([*measured, *drawn]), given, len(states))
    site = _site(solved, given)
    return Identification(
        observations=tuple(observations),
        site=site,
        curves=_curves(solved),
        corners=tuple(_corners(solved)),
        unsolved=_unsolved(states, site),
        draws=draws,
        reading=reading,
        assumptions=given,
    )


class _Solved:
    """Stresses of states as measured, and of their draws behind them, and the parameters that follow.

    stresses : rows as of `invert_states`, those of the measured states first. (n, 6)
    given : what is assumed.
    states : how many of the rows are measured states.

    `parameters` has every solved parameter by name, `corners` the external friction angle by assumed K_y [mm]; (n,)
    each, NaN where there is no solution.
    """

    def __init__(self, stresses: FloatArray, given: Assumptions, states: int = 1) -> None:
        columns = np.ascontiguousarray(stresses.T)
        self.sigma_m, self.tau_x, self.tau_y, self.depth, self.mobilised, self.displacement = columns
        self.given, self.states = given, states
        with np.errstate(all="ignore"):
            self.parameters = self._parameters()

    def _parameters(self) -> dict[str, FloatArray]:
        """Parameters that are solved for, by name; sets `adhesion`, c of each row [Pa], and `corners` on the way."""
        given, solved = self.given, {}
        if given.exponent is not None:
            solved["stiffness_kpa_m_n"] = inversion.stiffness(self.sigma_m, self.depth, given.exponent)
        if given.stiffness_kpa_m_n is not None:
            solved["exponent"] = inversion.sinkage_exponent(self.sigma_m, self.depth, given.stiffness_kpa_m_n)
        if given.cohesion_pa is not None:
            solved["friction_angle_deg"] = self.friction_angle(given.cohesion_pa)
        if (angle := given.friction_angle_deg) is not None:
            solved["cohesion_pa"] = inversion.cohesion(self.sigma_m, self.tau_x, self.mobilised, angle)
        self.adhesion = given.cohesion_pa if given.cohesion_pa is not None else solved["cohesion_pa"]
        self.corners = {modulus: self.external_friction_angle(modulus) for modulus in given.lateral_modulus_mm}
        if (angle := given.external_friction_angle_deg) is not None:
            forces = (self.sigma_m, self.tau_y, self.displacement)
            solved["lateral_modulus_mm"] = inversion.lateral_modulus(*forces, angle, self.adhesion)
        return solved

    def friction_angle(self, cohesion_pa: Any) -> FloatArray:
        """phi of each row at a cohesion. (n,) [deg]"""
        return np.asarray(inversion.friction_angle(self.sigma_m, self.tau_x, self.mobilised, cohesion_pa))

    def external_friction_angle(self, modulus_mm: Any) -> FloatArray:
        """phi_y of each row at a K_y. (n,) [deg]"""
        forces = (self.sigma_m, self.tau_y, self.displacement)
        return np.asarray(inversion.external_friction_angle(*forces, modulus_mm, self.adhesion))

    def record(self, name: str) -> dict[str, Any]:
        """Estimates of one state and its draws, as `Identification.observations` has them."""
        stresses = {"sigma_m_pa": self.sigma_m, "tau_xm_pa": self.tau_x, "tau_ym_pa": self.tau_y}
        estimates = {key: estimate(sample, key) for key, sample in (stresses | self.parameters).items()}
        return {"id": name, "corners": _corners(self)} | estimates


def _site(solved: _Solved, given: Assumptions) -> dict[str, Estimate]:
    """Every parameter over all states: estimated where it was solved for, as assumed where it was given."""
    moduli = given.lateral_modulus_mm
    assumed = {name: getattr(given, name) for name in LABELS} | {"lateral_modulus_mm": None}
    site = {name: Estimate(value, solved=1.0, assumed=True) for name, value in assumed.items()}
    site["lateral_modulus_mm"] = Estimate(
        moduli[0] if len(moduli) == 1 else None,
        solved=1.0,
        assumed=True,
        reason="assumed at several values, see the corners" if len(moduli) > 1 else "",
    )
    site |= {name: estimate(values, name, solved.states) for name, values in solved.parameters.items()}
    if moduli:
        name = "external_friction_angle_deg"
        site[name] = _over_corners([corner[name] for corner in _corners(solved)])
    return site


def _over_corners(corners: Sequence[Estimate]) -> Estimate:
    """One estimate as it is; of several, which rest on different assumptions, only the range they span."""
    low, high = [e.low for e in corners if e.low is not None], [e.high for e in corners if e.high is not None]
    if len(corners) == 1 or not (low and high):
        return corners[0]
    solved = min(estimate.solved for estimate in corners)
    return Estimate(
        None, None, min(low), max(high), solved, reason="depends on the assumed K_y; the range covers these"
    )


def _unsolved(states: WheelStates, site: dict[str, Estimate]) -> tuple[str, ...]:
    """Parameters without a solution although what they need was measured."""
    needs = {"friction_angle_deg": 1, "cohesion_pa": 1, "external_friction_angle_deg": 5, "lateral_modulus_mm": 5}
    return tuple(
        name
        for name, estimate in site.items()
        if estimate.low is None and not estimate.assumed and np.isfinite(states.values[:, needs.get(name, 0)]).any()
    )


def _corners(solved: _Solved) -> list[dict[str, Any]]:
    """External friction angle at each assumed lateral modulus, over the given states."""
    name = "external_friction_angle_deg"
    return [
        {"lateral_modulus_mm": modulus, name: estimate(values, name, solved.states)}
        for modulus, values in solved.corners.items()
    ]


def _curves(solved: _Solved) -> dict[str, list[dict[str, Any]]]:
    """Points of the curve of each aspect, as `Identification.curves` has them."""

    def stiffness(exponent: Any) -> FloatArray:
        return np.asarray(inversion.stiffness(solved.sigma_m, solved.depth, exponent))

    laws: dict[str, tuple[str, str, Callable[[Any], FloatArray]]] = {
        "bearing": ("exponent", "stiffness_kpa_m_n", stiffness),
        "shear": ("cohesion_pa", "friction_angle_deg", solved.friction_angle),
        "lateral": ("lateral_modulus_mm", "external_friction_angle_deg", solved.external_friction_angle),
    }

    curves = {curve: [{x_name: float(x)} for x in CURVES[x_name]] for curve, (x_name, _, _) in laws.items()}
    points: list[tuple[str, dict[str, Any]]] = [(curve, point) for curve in curves for point in curves[curve]]

    def solve(number: int) -> None:
        curve, point = points[number]
        x_name, y_name, law = laws[curve]
        with np.errstate(all="ignore"):
            y = estimate(law(point[x_name]), y_name, solved.states)
        point.update({y_name: y.value, "low": y.low, "high": y.high})

    each_in_threads(solve, len(points))
    return curves


LABELS = {
    "stiffness_kpa_m_n": "stiffness K_s",
    "exponent": "sinkage exponent N",
    "friction_angle_deg": "internal friction angle φ",
    "cohesion_pa": "cohesion c",
    "external_friction_angle_deg": "external friction angle φ_y",
    "lateral_modulus_mm": "lateral shear modulus K_y",
}
"""Parameters of the site in words."""
TREND = 0.05
"""Chance of a rank correlation with slip that is called a trend: the usual level (Fisher 1925, Statistical Methods for
Research Workers), of Kendall's tau (1938, Biometrika 30, 81, 10.1093/biomet/30.1-2.81)."""


@dataclass(frozen=True, slots=True)
class StatesAgreement:
    """Whether single states tell one value of a parameter.

    Attributes
    ----------
    parameter : its key.
    states : how many of them give a value.
    reduced_chi_square : of these values about their weighted mean, each with its own error.
    probability : of a larger one by chance.
    first, last : values at the least and the largest slip.
    trend : `falls` or `rises` with slip; '' for neither, for equal slips, and for values within their least error.
    """

    parameter: str
    states: int
    reduced_chi_square: float
    probability: float
    first: float
    last: float
    trend: str

    @property
    def agree(self) -> bool:
        """Whether one soil may have given them. Measured curves over slip have a chi-square of 6 to 200 a state."""
        return self.probability > SIGNIFICANCE

    @property
    def text(self) -> str:
        """In words, for those that do not agree."""
        how = f" {self.trend} with slip from" if self.trend else " from"
        first, last = (float(f"{value:.3g}") for value in (self.first, self.last))
        symbol = LABELS[self.parameter].rpartition(" ")[2]
        return f"{symbol}{how} {first:g} to {last:g}, chi-square {self.reduced_chi_square:.0f} a state"


def agreement(parameter: str, estimates: Sequence[Estimate], slip: FloatArray) -> StatesAgreement | None:
    """Of single states, with their slip, (n,); None where fewer than two have a value and an error."""
    from scipy.stats import kendalltau

    pairs = [(e.value, e.sigma) if e.value is not None and e.sigma else (np.nan, np.nan) for e in estimates]
    value, sigma = np.array(pairs, float).reshape(-1, 2).T
    solved = np.isfinite(value)
    value, weight, slip = value[solved], 1 / sigma[solved] ** 2, slip[solved]
    degrees = len(value) - 1
    if degrees < 1:
        return None
    chi_square = float(np.sum(weight * (value - np.average(value, weights=weight)) ** 2))
    chance = float(gammaincc(degrees / 2, chi_square / 2))
    varied = np.isfinite(slip).all() and np.ptp(slip) > 0 and np.ptp(value) > sigma[solved].min()
    rank = kendalltau(slip, value) if varied else None
    trend = "" if rank is None or rank.pvalue > TREND else "rises" if rank.statistic > 0 else "falls"
    order = np.argsort(slip, kind="stable")
    ends = float(value[order[0]]), float(value[order[-1]])
    return StatesAgreement(parameter, degrees + 1, chi_square / degrees, chance, *ends, trend)


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Share of the variance of a parameter that goes back to one measured quantity.

    Attributes
    ----------
    parameter, quantity : which of which.
    alone : variance with only this quantity in error, over that with all. [-]
    saved : share of the variance that is gone with this quantity exact; both agree where errors do not interact. [-]

    None where there is no solution.
    """

    parameter: str
    quantity: str
    alone: float | None
    saved: float | None


def sensitivities(
    states: WheelStates,
    wheel: Wheel,
    assumptions: Assumptions | None = None,
    *,
    reading: ShearSign = "signed",
    draws: int = 1024,
    seed: int = 0,
) -> list[Sensitivity]:
    """Shares of variance of every parameter that is solved for, averaged over the states.

    Parameters as in `identify`. Raises ParameterError where all errors are 0.

    References
    ----------
    Ding et al. (2024), 10.1038/s41467-024-46233-8, compare the errors of sinkage and forces in this way.
    """
    exact = not np.nan_to_num(states.sigmas).any()
    refuse({"all errors are 0; there is nothing to divide among the measured quantities": exact})
    at = np.unique(np.linspace(0, len(states) - 1, SENSITIVITY_STATES).astype(int))
    few = WheelStates(tuple(states.id[k] for k in at), states.values[at], states.sigmas[at])

    def variances(sigmas: FloatArray) -> dict[str, float]:
        result = identify(replace(few, sigmas=sigmas), wheel, assumptions, reading=reading, draws=draws, seed=seed)
        return {name: value for name in LABELS if (value := _variance(result, name)) is not None}

    def share(part: float | None, total: float) -> float | None:
        return None if part is None or total == 0 else part / total

    totals = variances(few.sigmas)
    shares = []
    for k, quantity in enumerate(COLUMNS):
        if not np.nan_to_num(few.sigmas[:, k]).any() or not np.isfinite(few.values[:, k]).any():
            continue
        only = np.where(np.arange(len(COLUMNS)) == k, few.sigmas, 0.0)
        alone, without = variances(only), variances(few.sigmas - only)
        for name, total in totals.items():
            rest = share(without.get(name), total)
            shares.append(
                Sensitivity(name, quantity, share(alone.get(name), total), None if rest is None else 1 - rest)
            )
    return sorted(shares, key=lambda share: [*LABELS].index(share.parameter))


def _variance(result: Identification, name: str) -> float | None:
    """Of a parameter, the mean over the states that have a solution; of several assumed K_y the first."""
    parts = [row[name] for row in result.observations if name in row]
    if name == "external_friction_angle_deg":
        parts = [row["corners"][0][name] for row in result.observations if row["corners"]]
    sigmas = [part.sigma for part in parts if part.sigma is not None]
    return float(np.mean(np.square(sigmas))) if sigmas else None
