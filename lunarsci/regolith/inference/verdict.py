"""Does a soil of the model explain the states? If not, which column would have to be otherwise?"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import FitVerdict
from lunarsci.regolith.inference.mode import ROUGH, Mode, find_mode, mode_with_errors
from lunarsci.regolith.inference.problem import LEAST_SHARE, JointProblem, error_covariance, part_of
from lunarsci.regolith.prior import strange
from lunarsci.regolith.states import WheelStates

CEILINGS = (0.35, 0.15, 0.15)
"""Share of the load by which the law may miss F_N, F_DP, F_L before no soil of it counts as an explanation; assumed. A
pull that errs by 0.15 is a slope of 8.5 deg; a normal force at a measured sinkage errs most, as it goes with a power of
it: 0.35 of the load is a fifth of the sinkage."""
REDUCED, RARE = (0.5, 2.0), 1e-3
"""Range of a reduced chi-square that agrees with the errors stated, and the chance at either end below which it must
lie too: few forces scatter more widely than the range. Assumed."""
MOST_LEFT_OUT = 0.1
"""Share of outliers beyond which a fit is doubted; assumed."""
GOOD, GOOD_REDUCED = 0.02, 1.5
"""A law that misses no force by more than this share of the load, without outliers, with such a reduced chi-square and
no parameter so many standard deviations off its prior, leaves nothing for another reading of a column to explain;
assumed."""
DECISIVE = 12.0
"""By how much -2 ln posterior must be better for another reading of a column to count: odds of 400. Assumed."""
SHIFTS = (-0.2, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.2)
"""By which the zero of a sinkage may be off, as shares of the wheel's radius; assumed."""
NEVER = 1e12
"""Stands for -2 ln posterior of what cannot be; assumed."""
HUBER, MOST_STATES = 3.0, 60
"""Whitened residuals beyond count linearly, and the most states that are tried with other readings; assumed."""
COLUMNS = ("sinkage_m", "slip_ratio", "side_slip_deg", "normal_force_n", "drawbar_pull_n", "lateral_force_n")
POUND, KILOGRAM = 4.44822, 9.80665
"""Newtons of a pound (0.45359237 kg) and of a kilogram of force, exact by definition, the first to six digits."""
OTHER_SIGNS: tuple[tuple[str, float, str], ...] = (
    ("slip_ratio", -1.0, "its sign turned: slip is positive where the rim is faster than the wheel travels"),
    ("drawbar_pull_n", -1.0, "its sign turned: a pull forward is positive, a resistance negative"),
    ("lateral_force_n", -1.0, "its sign (or that of side_slip_deg) turned: they have the same sign"),
    ("side_slip_deg", math.degrees(1.0), "degrees in place of radians"),
)
UNITS: tuple[tuple[str, float, str], ...] = (
    *((name, factor, f"newtons in place of {unit}") for name in COLUMNS[3:] for factor, unit in (
        (KILOGRAM, "kilograms"), (POUND, "pounds"), (1e-3, "millinewtons"))),
    ("slip_ratio", 0.01, "a share in place of per cent"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Suspect:
    """A column that would explain the states better if read otherwise, and by how much in -2 ln posterior."""

    column: str
    how: str
    gain: float


def suspects(mode: Mode, units: bool = False) -> list[Suspect]:
    """Columns whose sign, or with `units` unit, the states contradict, worst first.

    All states, or 60 of them spread evenly, are fitted anew as they are and with each column read otherwise, with the
    same errors; residuals beyond 3 standard errors count linearly, so that no few states decide. With `units`, as of
    states that the law misses by more than it may, the other reading must bring that to an end.
    """
    plain = _some(mode)
    before = _best(plain, mode.point)
    found: list[Suspect] = []
    for column, factor, how in (*OTHER_SIGNS, *(UNITS if units else ())):
        other = _read_otherwise(plain, column, factor)
        if other is None:
            continue
        gain = before - _best(other, plain.center) + _stretch(plain, column, factor)
        if gain > DECISIVE and not (units and _above(mode_with_errors(replace(other, huber=np.inf)))):
            found.append(Suspect(column, how, gain))
    return sorted(found, key=lambda suspect: -suspect.gain)


def _some(mode: Mode) -> JointProblem:
    """All states, or as many of them as are tried with other readings."""
    some = np.unique(np.linspace(0, len(mode.kept) - 1, MOST_STATES).astype(int))
    return replace(part_of(mode.problem, some), huber=HUBER)


def other_zero(mode: Mode) -> list[Suspect]:
    """The zero of the sinkage that explains the states better, if one does, as `suspects` compares."""
    from scipy.optimize import minimize_scalar

    plain, radius = _some(mode), mode.problem.wheel.radius_m

    def worse(share: float) -> float:
        other = _with_zero(plain, share * radius)
        return min(_best(other, plain.center), NEVER) if other else NEVER

    before, (worst, first) = _best(plain, mode.point), min((worse(share), share) for share in SHIFTS)
    if not before - worst > DECISIVE:
        return []
    span = 0.5 * abs(first)
    found = minimize_scalar(worse, bounds=(first - span, first + span), method="bounded", options={"maxiter": 12})
    bent = worse(found.x + span / 2) + worse(found.x - span / 2) - 2 * found.fun
    by, sigma = found.x * radius, radius * span * math.sqrt(0.5 / max(bent, 0.5))
    where = f"{abs(1e3 * by):.2g} ± {1e3 * sigma:.1g} mm {'higher' if by > 0 else 'lower'}"
    return [Suspect("sinkage_m", f"its zero {where} (--units sinkage_m={by:+.4f})", before - float(found.fun))]


def _with_zero(problem: JointProblem, by_m: float) -> JointProblem | None:
    """The problem with the sinkages so much larger; None where a wheel cannot have them."""
    inputs = problem.inputs.copy()
    inputs[:, 0] += by_m
    good = (inputs[:, 0] > 0).all() and (inputs[:, 0] < problem.wheel.radius_m).all()
    return replace(problem, inputs=inputs) if good else None


def _best(problem: JointProblem, start: FloatArray) -> float:
    """-2 ln posterior at its mode, from a start, with the determinant of the errors; infinite where there is none."""
    try:
        found = find_mode(problem, start, tolerance=ROUGH)[0]
        slopes = problem.residuals_and_slopes(found[None])[1][0]
        covariance = error_covariance(problem, slopes, np.array(problem.model_error))
        return problem.objective(found) + float(np.linalg.slogdet(covariance)[1].sum())
    except (ParameterError, np.linalg.LinAlgError):
        return math.inf


def _stretch(problem: JointProblem, column: str, factor: float) -> float:
    """What -2 ln of a density of measured forces owes to their unit."""
    measured = int(np.isfinite(problem.forces[:, COLUMNS.index(column) % 3]).sum())
    return 2 * measured * math.log(abs(factor)) if column in COLUMNS[3:] else 0.0


def _read_otherwise(problem: JointProblem, column: str, factor: float) -> JointProblem | None:
    """The problem with a column times a factor; None where no wheel could have such states, or nothing changes."""
    k = COLUMNS.index(column)
    name, errors = ("inputs", "input_sigma") if k < 3 else ("forces", "force_sigma")
    values, sigmas = getattr(problem, name).copy(), getattr(problem, errors).copy()
    values[:, k % 3] *= factor
    sigmas[:, k % 3] *= abs(factor)
    if not np.nan_to_num(values[:, k % 3]).any():
        return None
    if k < 3 and not (
        (np.abs(values[:, 1]) <= 1).all()
        and (np.abs(values[:, 2]) <= 90).all()
        and (values[:, 0] < problem.wheel.radius_m).all()
    ):
        return None
    return replace(problem, **{name: values, errors: sigmas})


def degrees(mode: Mode) -> float:
    """Forces of the states kept, less what the fit used up."""
    return int(np.isfinite(mode.problem.forces[mode.kept]).sum()) - mode.freedom


def reduced_chi_square(mode: Mode) -> float | None:
    """Of the states kept over the forces left after what the fit used up; None where none is left."""
    white = mode.problem.white(mode.point[None])[0][mode.kept]
    return float(np.sum(white**2) / degrees(mode)) if degrees(mode) >= 1 else None


def judge(mode: Mode, model: str, given: bool, states: WheelStates, unusable: float) -> FitVerdict:
    """The verdict of a fit.

    Parameters
    ----------
    model : the law's name.
    given : whether the model error was given, not found from the residuals.
    states : those that were fitted.
    unusable : share of all states that could not be used at all.
    """
    shares, reduced = mode.problem.model_error, reduced_chi_square(mode)
    reasons = [*map(str, states.questions), *_misfit(mode, reduced, given, states), *_ceilings(mode, given)]
    reasons += _left_out(mode, unusable) + _strange(mode)
    good = max(shares) <= GOOD and (reduced or 1.0) < GOOD_REDUCED and mode.kept.all() and not reasons
    turned = [] if good or states.questions else suspects(mode, units=bool(reasons))
    zero = [] if states.questions or states.alike else other_zero(mode)
    # Five published tests of real wheels agree better with another zero, too: alone it makes no doubt.
    turned = sorted([*turned, *(zero if reasons else ())], key=lambda suspect: -suspect.gain)
    if turned:
        first = turned[0]
        reasons.insert(0, f"column {first.column} agrees with the others only with {first.how}")
    elif reasons:
        reasons.append("look at the signs and units of slip_ratio, side_slip_deg, drawbar_pull_n and lateral_force_n, "
                       "at the wheel (`rover`), or let `law` auto look for a law that fits")  # fmt: skip
    return FitVerdict(
        trusted=not reasons,
        reason="; ".join(reasons),
        model=model,
        model_error=shares,
        model_error_from="given" if given else "residuals",
        reduced_chi_square=reduced,
        assumed=(
            *_assumed(mode, given, states, reduced),
            *(
                f"the zero of {one.column} as it is written, where the forces would agree better with {one.how}"
                for one in zero
            ),
        ),
    )


def _misfit(mode: Mode, reduced: float | None, given: bool, states: WheelStates) -> list[str]:
    from scipy.special import chdtri

    own, left = _of_stated_errors(mode, given, states)
    if states.stated and not states.alike and left >= 1 and own < (low := least_chi_square(left)):
        return [
            f"reduced chi-square {own / left:.2g} of the stated errors alone is below {low / left:.2g}: "
            "they are too large for these states"
        ]
    if reduced is None or reduced <= max(REDUCED[1], float(chdtri(degrees(mode), RARE)) / degrees(mode)):
        return []
    after = "model error " + ", ".join(f"{share:.3g}" for share in dict.fromkeys(mode.problem.model_error))
    return [f"no soil of the model explains the states: reduced chi-square {reduced:.3g} after a {after} of the load"]


def _strange(mode: Mode) -> list[str]:
    """Parameters that no soil or wheel of the priors has, whatever the states leave open of them."""
    laws = {name: mode.problem.prior[name] for name in mode.problem.names}
    return strange(laws, mode.point, np.sqrt(np.diag(mode.covariance)))


def least_chi_square(left: float) -> float:
    """Below which errors are too large for what so many degrees of freedom are left over."""
    from scipy.special import chdtri

    return min(REDUCED[0] * left, float(chdtri(left, 1 - RARE)))


def _of_stated_errors(mode: Mode, given: bool, states: WheelStates) -> tuple[float, float]:
    """Chi-square of the states kept with the errors that the file states, and the degrees of freedom left.

    Neither errors taken because the file has none nor a model error that was found are the user's to answer for.
    """
    problem, unstated = mode.problem, [COLUMNS.index(name) for name in states.unstated]
    errors, forces = problem.input_sigma.copy(), problem.forces.copy()
    errors[:, [k for k in unstated if k < 3]] = 0.0
    forces[:, [k - 3 for k in unstated if k > 2]] = np.nan
    shares = problem.model_error if given else (LEAST_SHARE,) * 3
    own = replace(problem, input_sigma=errors, forces=forces, model_error=shares)
    white = own.white(mode.point[None])[0][mode.kept]
    return float(np.sum(white**2)), float(np.isfinite(forces[mode.kept]).sum() - mode.freedom)


def _ceilings(mode: Mode, given: bool) -> list[str]:
    names = ("normal force", "drawbar pull", "lateral force")
    missed = [
        f"the {names[k]} by {mode.problem.model_error[k]:.2f} (at most {CEILINGS[k]:g})"
        for k in ([] if given else _above(mode))
    ]
    if not missed:
        return []
    return [f"no soil of the model explains the states: it misses, as a share of the load, {', '.join(missed)}"]


def _above(mode: Mode) -> list[int]:
    """Which of the forces that were measured the law misses by more than it may."""
    measured, shares = np.isfinite(mode.problem.forces), mode.problem.model_error
    return [k for k in range(3) if shares[k] > CEILINGS[k] and measured[:, k].any()]


def _left_out(mode: Mode, unusable: float) -> list[str]:
    share = float(np.mean(~mode.kept))
    reasons = [f"{100 * share:.0f} % of the states are outliers"] if share > MOST_LEFT_OUT else []
    return [*reasons, f"{100 * unusable:.0f} % of the states cannot be used"] if unusable > 0.5 else reasons


def _assumed(mode: Mode, given: bool, states: WheelStates, reduced: float | None) -> tuple[str, ...]:
    """What the fit had to assume, in sentences."""
    said = ["priors of priors.toml where none are given"]
    if not states.stated:
        said.append("errors of measurement as Ding et al. (2024) state them, where the file gives none")
    if not given:
        said.append(f"normal errors of the model, a share of the load; {mode.alike:.1f} neighbouring states "
                    "count as one independent state")  # fmt: skip
    if reduced is not None and reduced * degrees(mode) < least_chi_square(degrees(mode)):
        said.append(f"errors that the states do not show (reduced chi-square {reduced:.2g}), so intervals are wide")
    if not mode.problem.contact:
        said.append("contact angles of the wheel as known: where they are others, K_s, N and K_x are, too")
    if reduced is None:
        said.append("that the law holds: there are no more forces than parameters to test it")
    model = mode.problem.model
    if model is not None and model.bulldozing != "none":
        said.append(f"soil of {model.density_kg_m3:g} kg/m3 under {model.gravity_m_s2:g} m/s2 beside the wheel")
    if not np.isfinite(mode.problem.forces[:, 2]).any():
        said.append("nothing of lateral forces, which were not measured")
    return tuple(said)
