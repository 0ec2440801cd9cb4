"""Monte Carlo estimates: a value, its standard deviation and interval, or the reason why there is none."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["UNITS", "Estimate", "estimate"]

FloatArray = npt.NDArray[np.float64]

PERCENTILES = (2.5, 97.5)
MIN_SOLVED = 0.5
"""With a solution in fewer draws than this the rest is a selected sample, and no value is given."""
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


def estimate(samples: Sequence[FloatArray], name: str) -> Estimate:
    """Pool samples whose first entry is the value at the measured state and whose others are draws."""
    nominal = np.array([sample[0] for sample in samples])
    drawn = np.concatenate([sample[1:] for sample in samples])
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
