"""The joint posterior of `lunarsci regolith identify --joint`, as result keys and tables."""

from collections.abc import Sequence
from typing import Any

from lunarsci.regolith.joint import SoilPosterior
from lunarsci.regolith.prior import PARAMETERS

from .table import TextTable

__all__ = ["joint_record", "joint_tables"]

LABELS = {
    "stiffness_kpa_m_n": ("stiffness K_s", "kPa/m^N"),
    "sinkage_exponent": ("sinkage exponent n0", "-"),
    "sinkage_exponent_slip": ("its rise with slip n1", "-"),
    "cohesion_pa": ("cohesion c", "Pa"),
    "friction_angle_deg": ("internal friction angle φ", "deg"),
    "shear_modulus_mm": ("shear modulus K_x", "mm"),
    "external_friction_angle_deg": ("external friction angle φ_y", "deg"),
    "lateral_modulus_mm": ("lateral shear modulus K_y", "mm"),
}
HOW = {"normal": "of a normal law", "sample": "of draws from the posterior", "profile": "by profile"}
SHOWN_SHARE, SHOWN_WEIGHT, MOST_SHOWN = 0.5, 0.3, 3


def joint_record(found: SoilPosterior) -> dict[str, Any]:
    """The key `joint`."""
    ends = found.intervals()
    spread = found.sd
    correlation = found.covariance / spread[:, None] / spread
    return {
        "parameters": {
            name: dict(zip(("median", "low", "high", "low95", "high95"), ends[name], strict=True))
            | {
                "prior": {"of": found.prior[name].of, "median": found.prior[name].median, "sd": found.prior[name].sd},
                "shrinkage": found.shrinkage[name],
                "determined": name in found.determined,
            }
            for name in PARAMETERS
        },
        "order": list(PARAMETERS),
        "correlation": correlation.tolist(),
        "combinations": [{"left_of_prior": left, "weights": weights} for left, weights in found.combinations()],
        "outliers": list(found.outliers),
        "chi_square": found.chi_square,
        "degrees": found.degrees,
        "persistence": found.persistence,
        "intervals": found.how,
    }


def joint_tables(found: SoilPosterior) -> list[TextTable]:
    """Parameters with their intervals, and what is known of combinations."""
    ends = found.intervals()
    rows = []
    for name in PARAMETERS:
        label, unit = LABELS[name]
        median, low, high, low95, high95 = ends[name]
        known = "determined" if name in found.determined else f"{100 * (1 - found.shrinkage[name]):.0f} % of the prior"
        rows.append([label, _digits(median), f"{_digits(low)} to {_digits(high)}", f"{_digits(low95)} to "
                     f"{_digits(high95)}", unit, known])  # fmt: skip
    notes = [f"chi-square {found.chi_square:.1f} of {found.degrees} forces", *_combinations(found)]
    if found.outliers:
        notes.append(f"left out as outliers: {', '.join(found.outliers)}")
    headers = ["parameter", "median", "68 %", "95 %", "unit", "from the states"]
    return [TextTable(headers, rows, title=f"All states together, intervals {HOW[found.how]}", notes=notes)]


def _combinations(found: SoilPosterior) -> Sequence[str]:
    """The best known directions, in words."""
    lines = []
    for left, weights in found.combinations()[:MOST_SHOWN]:
        if left < SHOWN_SHARE:
            terms = [f"{value:+.1f} {name}" for name, value in weights.items() if abs(value) > SHOWN_WEIGHT]
            lines.append(f"known to {100 * left:.0f} % of the prior: {' '.join(terms)} (in units of the prior's sd)")
    return lines


def _digits(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
