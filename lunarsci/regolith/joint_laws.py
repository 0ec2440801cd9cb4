"""Which wheel-soil law do measured states want? Laws compared by how well each predicts states that it has not seen.

States are parted into groups of neighbours in slip, side slip and sinkage; each group is predicted from all others, by
taking its rows out of the normal approximation of the posterior (a linear step, so that no law is fitted anew). The
score is the logarithm of the density of the forces left out, summed over groups: higher is better.

Vehtari, Gelman & Gabry (2017), Stat. Comput. 27, 1413, 10.1007/s11222-016-9696-4 (predictive scores and their
differences); Roberts et al. (2017), Ecography 40, 913, 10.1111/ecog.02881 (why to leave out groups).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lunarsci.constants import LUNAR_GRAVITY
from lunarsci.errors import ParameterError
from lunarsci.regolith.contact import DENSITY_KG_M3, ContactModel
from lunarsci.regolith.joint import fit_soil, law_name, usable_states
from lunarsci.regolith.joint_mode import Mode, left_out
from lunarsci.regolith.joint_problem import error_covariance, neighbours
from lunarsci.regolith.prior import Law, contact_prior, default_prior
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import Wheel

__all__ = ["WheelLaw", "WheelLawScore", "candidates", "compare_laws"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WheelLaw:
    """A wheel-soil law as the joint inference takes it: choices of the integrals, whether the contact is unknown."""

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
    law : it.
    score : sum over groups of the logarithm of the predictive density; None where it cannot be fitted.
    behind, behind_sigma : by how much the best law is better, and the standard error of that.
    model_error : share of the load by which the law misses F_N, F_DP, F_L.
    """

    law: WheelLaw
    score: float | None
    behind: float | None
    behind_sigma: float | None
    model_error: tuple[float, float, float] | None


def candidates(
    states: WheelStates, density_kg_m3: float = DENSITY_KG_M3, gravity_m_s2: float = LUNAR_GRAVITY.value
) -> list[WheelLaw]:
    """Laws to compare, the simplest first; those that only matter to side slip where states have some."""
    plain = ContactModel(density_kg_m3=density_kg_m3, gravity_m_s2=gravity_m_s2)
    laws = [WheelLaw(None, False), WheelLaw(plain, False), WheelLaw(plain, True)]
    if (np.abs(np.nan_to_num(states.values[:, 2])) > 0).any():
        shared = [replace(plain, shear="combined"), replace(plain, shear="ellipse")]
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

    Taken is the first, that is simplest, whose score is within one standard error of the best.

    Parameters
    ----------
    states, wheel, prior, model_error : as `infer_soil` takes them.
    laws : to compare, the simplest first.
    progress : called with (done, total).

    Raises ParameterError where no law can be fitted.
    """
    usable = usable_states(states, wheel)
    groups = neighbours(states.values[usable], wheel.radius_m)
    parts: list[FloatArray | None] = []
    errors: list[tuple[float, float, float] | None] = []
    for number, law in enumerate(laws):
        try:
            priors = {**contact_prior(), **(prior or default_prior())}
            found = fit_soil(states, usable, wheel, priors, law.model, law.contact, model_error)
            parts.append(_densities(found, groups))
            errors.append(found.problem.model_error)
        except (ParameterError, np.linalg.LinAlgError):
            parts.append(None)
            errors.append(None)
        if progress is not None:
            progress(number + 1, len(laws))
    fitted = [part for part in parts if part is not None]
    if not fitted:
        raise ParameterError("no law can be fitted to these states; check them, and the wheel")
    best = max(fitted, key=lambda part: float(part.sum()))
    scores = [
        WheelLawScore(law, None, None, None, None) if part is None else _score(law, part, best, error)
        for law, part, error in zip(laws, parts, errors, strict=True)
    ]
    return next(s.law for s in scores if s.behind is not None and s.behind <= (s.behind_sigma or 0.0)), scores


def _score(
    law: WheelLaw, part: FloatArray, best: FloatArray, error: tuple[float, float, float] | None
) -> WheelLawScore:
    away = best - part
    sigma = float(np.sqrt(len(away)) * np.std(away, ddof=1)) if len(away) > 1 else 0.0
    return WheelLawScore(law, float(part.sum()), float(away.sum()), sigma, error)


def _densities(mode: Mode, groups: npt.NDArray[np.intp]) -> FloatArray:
    """Logarithm of the predictive density of each group given all others. (groups,)"""
    problem = mode.problem
    slopes = problem.residuals_and_slopes(mode.point[None])[1][0]
    sizes = 0.5 * np.linalg.slogdet(error_covariance(problem, slopes, np.array(problem.model_error)))[1]
    return np.array(
        [
            -0.5 * left.away @ np.linalg.solve(left.spread, left.away)
            - 0.5 * np.linalg.slogdet(left.spread)[1]
            - sizes[left.states].sum()
            for left in left_out(mode, groups)
        ]
    )
