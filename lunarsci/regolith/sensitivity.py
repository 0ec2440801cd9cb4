"""Which measured quantity the errors of the identified parameters come from."""

from dataclasses import dataclass, replace

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.regolith.identify import Assumptions, Identification, identify
from lunarsci.regolith.states import COLUMNS, WheelStates
from lunarsci.regolith.wheel import ShearSign, Wheel

PARAMETERS = (
    "stiffness_kpa_m_n",
    "exponent",
    "friction_angle_deg",
    "cohesion_pa",
    "external_friction_angle_deg",
    "lateral_modulus_mm",
)
MOST_STATES = 50
"""Spread evenly over a longer file."""


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
    if not np.nan_to_num(states.sigmas).any():
        raise ParameterError("all errors are 0; there is nothing to divide among the measured quantities")
    few = _spread(states)

    def variances(sigmas: np.ndarray) -> dict[str, float]:
        found = identify(replace(few, sigmas=sigmas), wheel, assumptions, reading=reading, draws=draws, seed=seed)
        return {name: value for name in PARAMETERS if (value := _variance(found, name)) is not None}

    whole = variances(few.sigmas)
    shares = []
    for k, quantity in enumerate(COLUMNS):
        if not np.nan_to_num(few.sigmas[:, k]).any() or not np.isfinite(few.values[:, k]).any():
            continue
        only, rest = np.zeros_like(few.sigmas), few.sigmas.copy()
        only[:, k], rest[:, k] = few.sigmas[:, k], 0.0
        alone, without = variances(only), variances(rest)
        for name, total in whole.items():
            one, left = alone.get(name), without.get(name)
            shares.append(
                Sensitivity(
                    name,
                    quantity,
                    None if one is None or total == 0 else one / total,
                    None if left is None or total == 0 else 1 - left / total,
                )
            )
    return sorted(shares, key=lambda share: PARAMETERS.index(share.parameter))


def _spread(states: WheelStates) -> WheelStates:
    if len(states) <= MOST_STATES:
        return states
    at = np.linspace(0, len(states) - 1, MOST_STATES).astype(int)
    return WheelStates(tuple(states.id[k] for k in at), states.values[at], states.sigmas[at])


def _variance(found: Identification, name: str) -> float | None:
    """Mean over the states that have a solution; of several assumed K_y the first."""
    parts = [row[name] for row in found.observations if name in row]
    if name == "external_friction_angle_deg":
        parts = [row["corners"][0][name] for row in found.observations if row["corners"]]
    sigmas = [part.sigma for part in parts if part.sigma is not None]
    return float(np.mean(np.square(sigmas))) if sigmas else None
