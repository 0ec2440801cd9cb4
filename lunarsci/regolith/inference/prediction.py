"""Forces that a soil, learned from one wheel, predicts for any wheel, with its uncertainty and the model's error.

Which wheel-soil law measured states want: laws compared by how well each predicts states that it has not seen. States
are parted into groups of neighbours in slip, side slip and sinkage; each group is predicted from all others, by taking
its rows out of the normal approximation of the posterior (a linear step, so that no law is fitted anew). The score is
the logarithm of the density of the forces left out, summed over groups: higher is better.

Vehtari, Gelman & Gabry (2017), Stat. Comput. 27, 1413, 10.1007/s11222-016-9696-4 (predictive scores and their
differences); Roberts et al. (2017), Ecography 40, 913, 10.1111/ecog.02881 (why to leave out groups).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.ranges import POSITIVE, check_each
from lunarsci.regolith.inference.mode import predictive_densities
from lunarsci.regolith.inference.posterior import SoilPosterior, fit_soil, law_name, usable_states
from lunarsci.regolith.inference.problem import FORCES, MOST_STATES, forces_of_many, misfit_at, neighbours
from lunarsci.regolith.prior import NINETY_FIVE, PARAMETERS, Law, contact_prior, default_prior, values_of
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates, impossible, read_state_table
from lunarsci.regolith.traction import DEEPEST
from lunarsci.regolith.wheel import DENSITY_KG_M3, SHEAR_LAWS, ContactModel, Wheel

DRAWS = 200
"""Of a predictive distribution; assumed."""
STEPS, SHALLOWEST = 24, 1e-4
"""Halvings to the sinkage under a load; the least one as a share of the radius."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictedForces:
    """F_N, F_DP, F_L of n states.

    Attributes
    ----------
    value : (n, 3) of the most probable soil. [N]
    draws : (d, n, 3) of the predictive distribution of measured forces. [N]
    sinkage_m : (d, n) at which they hold. [m]
    """

    value: FloatArray
    draws: FloatArray
    sinkage_m: FloatArray

    def interval(self, share: float = 0.9) -> tuple[FloatArray, FloatArray]:
        """Limits that hold measured forces with that probability, (n, 3) each. [N]"""
        low, high = np.nanquantile(self.draws, (0.5 - share / 2, 0.5 + share / 2), axis=0)
        return np.asarray(low), np.asarray(high)

    def holds(self, measured: FloatArray, share: float = 0.9) -> BoolArray:
        """Whether measured forces (n, 3) lie in the interval of that share."""
        low, high = self.interval(share)
        return np.asarray((low <= measured) & (measured <= high))


def predict_forces(
    posterior: SoilPosterior,
    wheel: Wheel,
    slip_ratio: npt.ArrayLike,
    side_slip_deg: npt.ArrayLike,
    load_n: npt.ArrayLike,
    sinkage_m: npt.ArrayLike | None = None,
    *,
    errors: MeasurementErrors | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> PredictedForces:
    """What a wheel meets on the soil of a posterior.

    Parameters
    ----------
    wheel : any, by its own radius, width and grousers; contact angles are the posterior's where it inferred them.
    slip_ratio, side_slip_deg : (n,) s from -1 to 1, beta from -90 to 90. [-, deg]
    load_n : (n,) above 0; the model's error is a share of it. [N]
    sinkage_m : (n,) where it is known; else that under the load, of each draw. [m]
    errors : of the states given and of the forces that will be measured; all zero for the forces themselves.

    Returns
    -------
    Draws of the soil, of its contact, of the errors of measurement, and of the model's: a Student law with the tails of
    the residuals, for each force and state its own. What the model missed at like slips and side slips is taken off
    (`misfit_at`); its error grows away from those that taught it. Where the sinkage follows from the load, F_N is the
    load.

    Raises ParameterError for loads out of range.
    """
    states = np.column_stack(np.broadcast_arrays(slip_ratio, side_slip_deg, load_n)).astype(float)
    load, random = states[:, 2], np.random.default_rng(seed)
    check_each("least", {"load_n": float(load.min())}, {"load_n": POSITIVE})
    errors = errors or MeasurementErrors()
    best = values_of(posterior.prior, posterior.mode)
    soils = posterior.draws[random.choice(len(posterior.draws), draws, replace=len(posterior.draws) < draws)]
    misfit = misfit_at(posterior.verdict.model_error, posterior.lesson, best, posterior.model, states[:, :2])
    share = misfit.sigma
    sigma = np.column_stack([errors.of(name, states[:, k]) for k, name in enumerate(COLUMNS[1:3])])
    depth, forces = np.empty((draws, len(load))), []
    given = None if sinkage_m is None else np.broadcast_to(np.asarray(sinkage_m, dtype=float), load.shape)
    for k, soil in enumerate(soils):
        moved = states[:, :2] + random.standard_normal((len(load), 2)) * sigma
        missed = misfit.mean(soil)
        if given is None:
            missed_load = missed[:, 0] + share[:, 0] * random.standard_normal(load.shape)
            carried = load * np.maximum(1.0 - missed_load, 0.0)
            depth[k] = _under(soil, moved, carried, wheel, posterior)
        else:
            deep = given + errors.sinkage_m * random.standard_normal(load.shape)
            depth[k] = np.clip(deep, SHALLOWEST * wheel.radius_m, DEEPEST * wheel.radius_m)
        forces.append(_forces(soil, depth[k], moved, wheel, posterior) + missed * load[:, None])
    all_forces = np.stack(forces)
    missed = misfit.mean(best)
    carried = load * np.maximum(1.0 - missed[:, 0], 0.0)
    here = _under(best, states[:, :2], carried, wheel, posterior) if given is None else given
    value = _forces(best, here, states[:, :2], wheel, posterior) + missed * load[:, None]
    scale = np.sqrt((posterior.tail - 2) / posterior.tail)
    noise = scale * random.standard_t(posterior.tail, all_forces.shape) * share * load[:, None]
    noise += errors.force_relative * np.abs(value) * random.standard_normal(all_forces.shape)
    if given is None:
        noise[..., 0], all_forces[..., 0], value[:, 0] = 0.0, load, load
    return PredictedForces(value, all_forces + noise, depth)


def _forces(soil: FloatArray, z: FloatArray, motion: FloatArray, wheel: Wheel, posterior: SoilPosterior) -> FloatArray:
    """F_N, F_DP, F_L by the posterior's law, (n, 3) [N], at sinkages (n,) [m], slips and side slips (n, 2) [-, deg].

    `soil` (8,) or (12,) is in the order and units of `PARAMETERS` and `CONTACT`.
    """
    forces = forces_of_many(soil[None], np.column_stack([z, motion]), wheel, posterior.model)[0]
    return np.array(forces.T, dtype=np.float64)


def _under(
    soil: FloatArray, motion: FloatArray, load: FloatArray, wheel: Wheel, posterior: SoilPosterior
) -> FloatArray:
    """Sinkage under loads (n,) [N]; the deepest one where the soil carries less. (n,) [m] Arguments as of `_forces`."""
    low, high = np.full(load.shape, SHALLOWEST * wheel.radius_m), np.full(load.shape, DEEPEST * wheel.radius_m)
    for _ in range(STEPS):
        middle = np.sqrt(low * high)
        light = _forces(soil, middle, motion, wheel, posterior)[:, 0] < load
        low, high = np.where(light, middle, low), np.where(light, high, middle)
    return np.asarray(low)


NAMES = ("value", "low90", "high90", "low68", "high68")
"""Of the most probable soil, and the limits of intervals of 90 and 68 %."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictedStates:
    """Forces predicted for the states of a file.

    Attributes
    ----------
    ids : n names.
    quantiles : (5, n, 3) in the order of `NAMES`, of F_N, F_DP, F_L. [N]
    sinkage_m : (n,) median. [m]
    load_n : (n,) [N]
    measured : (n, 3) NaN where the file has none. [N]
    """

    ids: tuple[str, ...]
    quantiles: FloatArray
    sinkage_m: FloatArray
    load_n: FloatArray
    measured: FloatArray

    @property
    def records(self) -> list[dict[str, Any]]:
        """One for each state."""
        return [
            {"id": name, "sinkage_m": float(self.sinkage_m[i])}
            | {
                force: dict(zip(NAMES, map(float, self.quantiles[:, i, k]), strict=True))
                for k, force in enumerate(FORCES)
            }
            for i, name in enumerate(self.ids)
        ]

    def compared(self) -> dict[str, dict[str, float] | None]:
        """By force: root mean square of predicted less measured as a share of the load, and the share of 90 % intervals
        that hold what was measured; None where nothing was."""
        result: dict[str, dict[str, float] | None] = dict.fromkeys(FORCES)
        for k, force in enumerate(FORCES):
            rows = np.isfinite(self.measured[:, k])
            (value, low, high), measured = self.quantiles[:3, rows, k], self.measured[rows, k]
            if rows.any():
                result[force] = {
                    "rms_of_load": float(np.sqrt(np.mean(((value - measured) / self.load_n[rows]) ** 2))),
                    "held90": float(np.mean((low <= measured) & (measured <= high))),
                }
        return result

    def to_dict(self) -> dict[str, Any]:
        """For the result."""
        return {"states": self.records, "compared": self.compared()}

    def notes(self) -> list[str]:
        """How the prediction compares with what was measured, in words."""
        return [
            f"{force}: rms {row['rms_of_load']:.3f} of the load, 90 % intervals hold {100 * row['held90']:.0f} %"
            for force, row in self.compared().items()
            if row is not None
        ]


def predict_states(posterior: SoilPosterior, wheel: Wheel, source: InputFile, *, seed: int = 0) -> PredictedStates:
    """The forces on a wheel at the states of a CSV.

    Columns: `slip_ratio` and `normal_force_n` (the load) are required; `side_slip_deg` is 0 where it is missing; where
    there is no `sinkage_m` it is found under the load; `drawbar_pull_n` and `lateral_force_n` are compared. Rows whose
    sinkage no wheel above its axle can have are refused. Raises DataError.
    """
    table = read_state_table(source, wheel, needed=("slip_ratio", "normal_force_n"), every=True)
    columns, count = dict(zip(COLUMNS, table.values.T, strict=True)), len(table.values)
    load, slip = columns["normal_force_n"], columns["slip_ratio"]
    side = np.nan_to_num(columns["side_slip_deg"])
    depth = columns["sinkage_m"] if "sinkage_m" in table.table else None
    required = {"slip_ratio", "normal_force_n", *({"sinkage_m"} & {*table.table})}
    bad, text = impossible(source.name, table.values, np.arange(count), wheel, required)
    if bad.any():
        raise DataError(text)
    predicted = predict_forces(posterior, wheel, slip, side, load, depth, seed=seed)
    measured = np.column_stack([columns[name] for name in FORCES])
    if depth is None:
        measured[:, 0] = np.nan
    ids = tuple(table.table["id"].astype(str)) if "id" in table.table else tuple(str(n) for n in range(1, count + 1))
    rows = np.stack([predicted.value, *predicted.interval(0.9), *predicted.interval(0.68)])
    return PredictedStates(ids, rows, np.median(predicted.sinkage_m, axis=0), load, measured)


@dataclass(frozen=True, slots=True)
class WheelLaw:
    """A wheel-soil law as the joint inference takes it.

    Attributes
    ----------
    model : choices of the exact integrals, None for the closed form.
    contact : whether the parameters of `CONTACT` are unknown too.
    """

    model: ContactModel | None
    contact: bool

    @property
    def name(self) -> str:
        """See `law_name`."""
        return law_name(self.model, self.contact)


@dataclass(frozen=True, slots=True)
class WheelLawScore:
    """How a law predicts groups of states that were left out.

    Attributes
    ----------
    law : that was scored.
    score : sum over groups of the logarithm of the predictive density; None where it cannot be fitted.
    behind, behind_sigma : by how much the best law is better, and the standard error of that.
    model_error : share of the load by which the law misses F_N, F_DP, F_L; None where it cannot be fitted. [-]
    soil : its most probable soil, in the order and units of `PARAMETERS`; None where it cannot be fitted.
    """

    law: WheelLaw
    score: float | None
    behind: float | None
    behind_sigma: float | None
    model_error: tuple[float, float, float] | None
    soil: tuple[float, ...] | None

    def within(self, widths: float) -> bool:
        """Whether it is at most so many standard errors behind the best."""
        return self.behind is not None and self.behind <= widths * (self.behind_sigma or 0.0)


def disputed(posterior: SoilPosterior, scores: Sequence[WheelLawScore]) -> tuple[str, ...]:
    """Parameters whose 95 % interval leaves out the soil of another law that predicts within one standard error."""
    ends, others = posterior.intervals(), [score.soil for score in scores if score.soil and score.within(1)]
    return tuple(
        name
        for k, name in enumerate(PARAMETERS)
        if any(not ends[name][3] <= soil[k] <= ends[name][4] for soil in others)
    )


def candidates(
    states: WheelStates, density_kg_m3: float = DENSITY_KG_M3, gravity_m_s2: float = LUNAR_GRAVITY.value
) -> list[WheelLaw]:
    """Laws to compare, the simplest first; those that only matter to side slip where states have some."""
    plain = ContactModel(density_kg_m3=density_kg_m3, gravity_m_s2=gravity_m_s2)
    laws = [WheelLaw(None, False), WheelLaw(plain, False), WheelLaw(plain, True)]
    if (np.abs(np.nan_to_num(states.values[:, 2])) > 0).any():
        shared = [replace(plain, shear=law) for law in SHEAR_LAWS if law != "separate"]
        laws += [WheelLaw(model, True) for model in shared]
        laws += [WheelLaw(replace(model, bulldozing="hegedus"), True) for model in shared]
    return laws


def compare_laws(
    states: WheelStates,
    wheel: Wheel,
    laws: list[WheelLaw],
    prior: Mapping[str, Law] | None = None,
    *,
    model_error: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[WheelLaw, list[WheelLawScore]]:
    """The law to take, and the score of each, in the order given.

    The first, that is simplest, whose score is within one standard error of the best (Breiman, Friedman, Olshen & Stone
    1984, Classification and Regression Trees, 10.1201/9781315139470, ch. 3.4); but states that cannot tell the laws
    apart do not know the contact angles either, so that of laws within 1.96, 95 %, the first is taken that leaves these
    open.

    Parameters
    ----------
    states, wheel, prior, model_error : as `infer_soil` takes them.
    laws : to compare, the simplest first; on at most 200 states.
    progress : called with (done, total).

    Raises ParameterError where no law can be fitted.
    """
    usable = usable_states(states, wheel)
    if usable.sum() > MOST_STATES:
        some = np.random.default_rng(0).choice(np.flatnonzero(usable), MOST_STATES, replace=False)
        usable = np.isin(np.arange(len(usable)), some)
    groups = neighbours(states.values[usable], wheel.radius_m)
    parts: list[FloatArray | None] = []
    fits: list[tuple[tuple[float, float, float], tuple[float, ...]] | None] = []
    for number, law in enumerate(laws):
        try:
            priors = {**contact_prior(), **(prior or default_prior())}
            mode = fit_soil(states, usable, wheel, priors, law.model, law.contact, model_error)
            parts.append(predictive_densities(mode, groups))
            soil = values_of(priors, mode.point)[: len(PARAMETERS)]
            fits.append((mode.problem.model_error, tuple(map(float, soil))))
        except (ParameterError, np.linalg.LinAlgError):
            parts.append(None)
            fits.append(None)
        if progress is not None:
            progress(number + 1, len(laws))
    fitted = [part for part in parts if part is not None]
    if not fitted:
        raise ParameterError("no law can be fitted to these states; check them, and the wheel")
    best = max(fitted, key=lambda part: float(part.sum()))
    scores = [
        WheelLawScore(law, None, None, None, None, None) if part is None or of is None else _score(law, part, best, *of)
        for law, part, of in zip(laws, parts, fits, strict=True)
    ]

    def near(widths: float) -> list[WheelLaw]:
        return [score.law for score in scores if score.within(widths)]

    return next((law for law in (*near(1), *near(NINETY_FIVE)) if law.contact), near(1)[0]), scores


def _score(
    law: WheelLaw, part: FloatArray, best: FloatArray, error: tuple[float, float, float], soil: tuple[float, ...]
) -> WheelLawScore:
    """The score of a law whose groups of states have such ln densities, beside those of the best law. (groups,) each"""
    away = best - part
    sigma = float(np.sqrt(len(away)) * np.std(away, ddof=1)) if len(away) > 1 else 0.0
    return WheelLawScore(law, float(part.sum()), float(away.sum()), sigma, error, soil)
