"""Profile intervals: how far a parameter can go, all others following, before the objective has risen too much.

Intervals of fitted parameters, whatever method they come from, and the ratios that both methods derive.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import LunarSciWarning
from lunarsci.spectra.mgm.model import MgmModel, unit_of
from lunarsci.spectra.mgm.result import REACH_NM, MgmFit, pyroxene_pair
from lunarsci.spectra.spectrum import reaches_over


@dataclass(frozen=True, slots=True)
class Interval:
    """One parameter's 68.27 % and 95 % intervals, in the unit of its name: nm for centres and widths.

    `value` is the parameter at the minimum for a profile, the median for draws. An end that is a bound of the parameter
    is that bound; NaN where the interval could not be closed.
    """

    name: str
    value: float
    low68: float
    high68: float
    low95: float
    high95: float

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals of one fit: `method` is `profile` or `sample`; `remarks` say what limits their use."""

    method: str
    intervals: tuple[Interval, ...]
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Interval:
        """The interval of a parameter; KeyError where it has none."""
        for interval in self.intervals:
            if interval.name == name:
                return interval
        raise KeyError(name)

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {
            "method": self.method,
            "intervals": [interval.to_dict() for interval in self.intervals],
            "remarks": list(self.remarks),
        }


def ratio_rows(model: MgmModel, wavelength_nm: FloatArray) -> dict[str, tuple[int, int]]:
    """Positions of the strengths of orthopyroxene and clinopyroxene by region, `um1` and `um2`.

    Only where the assemblage has both and the channels, ascending, reach over both bands. [nm]
    """
    rows: dict[str, tuple[int, int]] = {}
    for region, (low, high) in REACH_NM.items():
        pair = pyroxene_pair(model.assemblage.bands, region)
        if pair and reaches_over(wavelength_nm, low, high):
            rows[region] = (model.degrees + 3 * pair[0] + 2, model.degrees + 3 * pair[1] + 2)
    return rows


def ratio_names(model: MgmModel, wavelength_nm: FloatArray) -> tuple[str, ...]:
    """`nbsr_um1_opx` and `nbsr_um2_opx`, as far as `ratio_rows` finds them."""
    return tuple(f"nbsr_{region}_opx" for region in ratio_rows(model, wavelength_nm))


def ratios_of(points: FloatArray, model: MgmModel, wavelength_nm: FloatArray) -> dict[str, FloatArray]:
    """s_OPX / (s_OPX + s_CPX) by name, shape (n,), of parameter vectors, shape (n, p); NaN where both are 0. [-]

    Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025.
    """
    found = {}
    for region, (opx, cpx) in ratio_rows(model, wavelength_nm).items():
        total = points[:, opx] + points[:, cpx]
        with np.errstate(invalid="ignore"):
            found[f"nbsr_{region}_opx"] = np.asarray(points[:, opx] / total, dtype=np.float64)
    return found


PROBABILITIES = (0.6827, 0.95)
KINDS = ("center_nm", "strength")
CLOSE = 0.01
"""Of the root of the rise of the objective, at which an end of an interval has been found."""
NARROW = 1e-3
"""Of the standard error: a bracket narrower than this holds a jump of the profile, from one valley to another."""
MOST_STEPS = 30
LOWER_BY = 0.1
"""By how much an objective below the fit's says that the fit is not the minimum; assumed."""
MISFIT = 1.5
"""Reduced chi-square above which intervals are too narrow; assumed."""
TOLERANCE, MAX_ITERATIONS = 1e-4, 300
NO_HOPS = np.zeros((0, 2))


def profile_intervals(fit: MgmFit, names: Sequence[str] | None = None) -> Intervals:
    """68.27 % and 95 % intervals of parameters from the profile of the objective.

    The ends are where min objective(parameter fixed) - min objective = z^2, z = 1 and 1.96, or the parameter's bound
    where that is nearer. The weights of the data are taken as they are: chi-square is known. The intervals are those of
    `lmfit.conf_interval` on `lmfit_interop.to_minimizer(fit)`, and come quicker.

    Parameters
    ----------
    fit : a result of `fit_spectra`.
    names : parameters of the model, or `nbsr_um1_opx`, `nbsr_um2_opx`; all centres, strengths and ratios by default.

    Raises
    ------
    ParameterError for an unknown name.

    References
    ----------
    Venzon & Moolgavkar (1988), Appl. Stat. 37, 87, 10.2307/2347496.
    """
    ratios = ratio_names(fit.model, fit.wavelength_nm)
    if names is None:
        names = (*(name for name in fit.model.names if name.endswith(KINDS)), *ratios)
    remarks: list[str] = []
    if fit.reduced_chi2 > MISFIT:
        remarks.append(f"reduced chi-square is {fit.reduced_chi2:.1f}: errors are larger than stated to the fit")
    intervals = []
    for name in names:
        if name not in ratios:
            fit.model.index(name)
        profile = _ratio_profile(fit, name) if name in ratios else _parameter_profile(fit, name)
        intervals.append(_interval(profile, remarks))
    for remark in remarks:
        warnings.warn(f"{fit.id}: {remark}", LunarSciWarning, stacklevel=2)
    return Intervals("profile", tuple(intervals), tuple(remarks))


@dataclass(slots=True)
class _Profile:
    """What is known of one profile: `restricted` fixes the parameter, `known` holds (value, root of rise, point)."""

    name: str
    fit: MgmFit
    best: float
    sigma: float
    low: float
    high: float
    restricted: Callable[[float], MgmModel]
    moved: Callable[[FloatArray, float], FloatArray]
    known: list[tuple[float, float, FloatArray]] = field(default_factory=list)
    lowest: float = 0.0

    def rise(self, value: float) -> float:
        """Root of the rise of the objective where the parameter is `value`; starts from the nearest known points."""
        nearest = sorted(self.known, key=lambda entry: abs(entry[0] - value))[:2]
        starts = [self.moved(point, value) for _, _, point in nearest]
        point, objective = _minimum(self.fit, self.restricted(value), starts)
        change = objective - self.fit.objective
        self.lowest = min(self.lowest, change)
        root = float(np.sqrt(max(change, 0.0))) if np.isfinite(change) else np.inf
        self.known.append((value, root, point))
        return root


def _parameter_profile(fit: MgmFit, name: str) -> _Profile:
    k, unit = fit.model.index(name), unit_of(name)
    variance = fit.covariance[k, k]
    follow = fit.covariance[k] / variance if variance > 0 else np.zeros(fit.parameters.size)

    def restricted(value: float) -> MgmModel:
        return fit.model.bounded(name, value * unit, value * unit)

    def moved(point: FloatArray, value: float) -> FloatArray:
        return np.asarray(point + (value - point[k]) * follow)

    best = float(fit.parameters[k])
    profile = _Profile(
        name,
        fit,
        best,
        float(np.sqrt(variance)),
        float(fit.model.lower[k]),
        float(fit.model.upper[k]),
        restricted,
        moved,
    )
    profile.known.append((best, 0.0, fit.parameters))
    return profile


def _ratio_profile(fit: MgmFit, name: str) -> _Profile:
    """Of s_OPX / (s_OPX + s_CPX), which a tie between the two strengths fixes."""
    region = name.split("_")[1]
    opx, cpx = ratio_rows(fit.model, fit.wavelength_nm)[region]
    names = fit.model.names

    def restricted(value: float) -> MgmModel:
        if value <= 0.5:
            return fit.model.tied(names[opx], value / (1 - value), names[cpx], 0.0)
        return fit.model.tied(names[cpx], (1 - value) / value, names[opx], 0.0)

    def moved(point: FloatArray, value: float) -> FloatArray:
        start = point.copy()
        start[opx], start[cpx] = np.array([value, 1 - value]) * (point[opx] + point[cpx])
        return start

    best = float(ratios_of(fit.parameters[None], fit.model, fit.wavelength_nm)[name][0])
    total = fit.parameters[opx] + fit.parameters[cpx]
    slope = np.array([fit.parameters[cpx], -fit.parameters[opx]]) / total**2 if total < 0 else np.zeros(2)
    block = fit.covariance[np.ix_([opx, cpx], [opx, cpx])]
    profile = _Profile(name, fit, best, float(np.sqrt(slope @ block @ slope)), 0.0, 1.0, restricted, moved)
    profile.known.append((best, 0.0, fit.parameters))
    return profile


def _minimum(fit: MgmFit, model: MgmModel, starts: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """Point and objective of the lowest minimum under `model`, the objective with the fit's own prior."""
    from lunarsci.spectra.mgm.fit import fit_batch

    solved = fit_batch(
        np.log(fit.reflectance)[None], fit.data.weight[None], fit.wavelength_nm / 1e3, model.basis(fit.wavelength_nm),
        model.logarithmic, model.prior, model.precision, model.lower, model.upper,
        np.clip(np.array(starts), model.lower, model.upper)[:, None], NO_HOPS, TOLERANCE, MAX_ITERATIONS,
    )  # fmt: skip
    point = solved.parameters[0]
    pull = point - fit.model.prior
    return point, float(solved.chi2[0] + pull @ fit.model.precision @ pull)


def _interval(profile: _Profile, remarks: list[str]) -> Interval:
    unit = unit_of(profile.name)
    if not (np.isfinite(profile.best) and np.isfinite(profile.sigma)):
        remarks.append(f"{profile.name} has no profile: it is undetermined at the minimum")
        ends = [[np.nan] * 2] * 2
    elif profile.low == profile.high:
        ends = [[profile.best] * 2] * 2
    else:
        ends = [list(_ends(profile, sign)) for sign in (-1, 1)]
        if np.isnan(ends).any():
            remarks.append(f"the interval of {profile.name} could not be closed")
        if profile.lowest < -LOWER_BY:
            remarks.append(
                f"the profile of {profile.name} found an objective {-profile.lowest:.1f} lower: fit with more starts"
            )
    (low68, low95), (high68, high95) = ends
    return Interval(profile.name, *(unit * end for end in (profile.best, low68, high68, low95, high95)))


def _ends(profile: _Profile, sign: int) -> Iterator[float]:
    """Ends to one side, the nearer first."""
    bound = profile.high if sign > 0 else profile.low
    inside = profile.best
    for probability in PROBABILITIES:
        wanted = NormalDist().inv_cdf(0.5 + probability / 2)
        inside = _end(profile, sign, bound, wanted, inside)
        yield inside
        if np.isnan(inside):
            inside = profile.best


def _end(profile: _Profile, sign: int, bound: float, wanted: float, start: float) -> float:
    """Where the root of the rise is `wanted`: outward in steps, then by the secant between the last two."""
    inner, inner_root = start, min(profile.known, key=lambda entry: abs(entry[0] - start))[1]
    step = max(profile.sigma, 1e-9) * max(wanted - inner_root, 0.1)
    outer, outer_root, narrow = np.nan, np.nan, NARROW * max(profile.sigma, 1e-9)
    for _ in range(MOST_STEPS):
        if np.isnan(outer):
            trial = inner + sign * step
            trial = min(trial, bound) if sign > 0 else max(trial, bound)
        else:
            share = (wanted - inner_root) / (outer_root - inner_root) if np.isfinite(outer_root) else 0.5
            trial = inner + (outer - inner) * min(max(share, 0.1), 0.9)
        root = profile.rise(trial)
        if abs(root - wanted) < CLOSE or (trial == bound and root <= wanted) or abs(outer - inner) < narrow:
            return trial
        if root > wanted:
            outer, outer_root = trial, root
        else:
            rise = (root - inner_root) / abs(trial - inner) if trial != inner else 0.0
            step = min(max((wanted - root) / rise if rise > 0 else 2 * step, 0.3 * step), 3 * step)
            inner, inner_root = trial, root
    return np.nan
