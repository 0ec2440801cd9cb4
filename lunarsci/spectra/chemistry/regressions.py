"""The regressions of `band_chemistry.csv`: a quantity from a band centre or an area ratio."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from lunarsci.tables import table_rows

__all__ = ["TABLE", "Regression", "regressions"]

TABLE = "band_chemistry.csv"
_NM_PER_UNIT = {"um": 1e3, "nm": 1.0, "-": 1.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class Regression:
    """A quantity y from a predictor x.

    Attributes
    ----------
    key, quantity, unit : name of the row; y and its unit.
    predictor : `bc1000`, `bc2000`, `m1_1`, `m2`, `m1_2` [nm] or `bar`, area of the 2 um band over the 1 um band's.
    scale : x in the regression is the predictor divided by this.
    inverse : whether it was made the other way round: x = c0 + c1 y instead of y = c0 + c1 x + c2 x^2.
    coefficients : c0, c1, c2.
    error : standard deviation about it that its authors give, of y, or of x where it is inverse.
    error_relab : root mean square error of y on the RELAB minerals for which it says that it may be used; 0 where there
        are fewer than five.
    low, high : range of y it was made for.
    excluded : range of y within that where it does not hold, or None.
    when : range of another quantity it was made for, the upper end not included; infinite where open.
    place : where in the plane of the two centres it belongs (`lunarsci.spectra.chemistry.plane`).
    domain, source : what it was made on; entry of `sources.toml`.
    """

    key: str
    quantity: str
    unit: str
    predictor: str
    scale: float
    inverse: bool
    coefficients: tuple[float, float, float]
    error: float
    error_relab: float
    low: float
    high: float
    excluded: tuple[float, float] | None
    when: tuple[float, float]
    place: str
    domain: str
    source: str

    def value(self, predictor: float) -> float:
        """y at a predictor. [unit]"""
        c0, c1, c2 = self.coefficients
        x = predictor / self.scale
        return (x - c0) / c1 if self.inverse else c0 + c1 * x + c2 * x**2

    def slope(self, predictor: float) -> float:
        """dy by d predictor. [unit/nm, or unit for a ratio]"""
        _, c1, c2 = self.coefficients
        return (1 / c1 if self.inverse else c1 + 2 * c2 * predictor / self.scale) / self.scale

    def sigma(self, predictor: float, predictor_sigma: float) -> float:
        """Standard deviation of y: error of the predictor and scatter about the regression, independent. [unit]

        The scatter is the authors' or that on RELAB, whichever is larger.
        """
        published = self.error / abs(self.coefficients[1]) if self.inverse else self.error
        return math.hypot(self.slope(predictor) * predictor_sigma, max(published, self.error_relab))

    def objection(self, value: float) -> str:
        """Why a value is outside the range of the regression; empty where it is inside."""
        if not self.low <= value <= self.high:
            return f"beyond the {self.low:g}-{self.high:g} it was made for"
        if self.excluded is not None and self.excluded[0] < value < self.excluded[1]:
            return f"between {self.excluded[0]:g} and {self.excluded[1]:g}, which its authors exclude"
        return ""


@cache
def regressions() -> Mapping[str, Regression]:
    """All regressions by key."""
    return {row["key"]: _regression(row) for row in table_rows(TABLE)}


def _regression(row: Mapping[str, str]) -> Regression:
    excluded = (float(row["excluded_low"]), float(row["excluded_high"])) if row["excluded_low"] else None
    return Regression(
        key=row["key"],
        quantity=row["quantity"],
        unit=row["unit"],
        predictor=row["predictor"],
        scale=_NM_PER_UNIT[row["predictor_unit"]],
        inverse=row["form"] == "inverse",
        coefficients=(float(row["c0"]), float(row["c1"]), float(row["c2"])),
        error=float(row["error"]),
        error_relab=float(row["error_relab"] or 0),
        low=float(row["low"]),
        high=float(row["high"]),
        excluded=excluded,
        when=(float(row["when_low"] or -math.inf), float(row["when_high"] or math.inf)),
        place=row["place"],
        domain=row["domain"],
        source=row["source"],
    )
