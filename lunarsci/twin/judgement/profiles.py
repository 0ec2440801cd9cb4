"""How the quantities of a drive spread over the members at each distance."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.judgement.quantities import along

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["PROFILED", "available", "profile_table", "spread"]

FloatArray = npt.NDArray[np.float64]

PROFILED = {
    "tilt_deg": "deg",
    "roll_deg": "deg",
    "pitch_deg": "deg",
    "clearance_m": "m",
    "keep_out_m": "m",
    "miss_m": "m",
    "normal_force_n": "N",
    "slip_ratio": "-",
    "side_slip_deg": "deg",
    "sinkage_m": "m",
}
"""Quantities of the profiles, and their units."""
ALL = "all"


def spread(values: FloatArray, reached: npt.NDArray[np.bool_]) -> FloatArray:
    """p05, p50, p95, min and max over members (and wheels) at each sample, NaN where no member came. (5, samples)

    `values` is (members, samples) or (members, samples, wheels). Percentiles interpolate linearly; NaN is left out.
    """
    values = values if values.ndim == 3 else values[..., None]
    known = reached[..., None] & ~np.isnan(values)
    rows = np.full((5, values.shape[1]), np.nan)
    for sample in np.flatnonzero(known.any(axis=(0, 2))):
        rows[:, sample] = np.percentile(values[:, sample][known[:, sample]], (5, 50, 95, 0, 100))
    return rows


def available(prediction: Prediction) -> list[str]:
    """Those of the profiled quantities that rover and plan give."""
    lacking = {"clearance_m": prediction.rover.body is None, "keep_out_m": not prediction.plan.keep_out}
    return [name for name in PROFILED if not lacking.get(name, False)]


def profile_table(prediction: Prediction) -> "pd.DataFrame":
    """One row for each sample and quantity, wheels apart and together.

    Columns distance_m (as commanded), time_s, quantity, wheel (a name, `all`, or empty for the chassis), p05, p50, p95,
    min, max over the members that came so far, unit. Quantities as in `PROFILED`: without `clearance_m` for a rover
    without a body, without `keep_out_m` for a plan without such circles.
    """
    import pandas as pd

    parts = []
    for name in available(prediction):
        values = along(prediction, name)
        series = {"": values}
        if values.ndim == 3:
            series = {ALL: values} | {wheel: values[..., w] for w, wheel in enumerate(prediction.rover.wheels)}
        for wheel, own in series.items():
            rows = dict(zip(("p05", "p50", "p95", "min", "max"), spread(own, prediction.reached), strict=True))
            head = {"distance_m": prediction.distance_m, "time_s": prediction.time_s, "quantity": name, "wheel": wheel}
            parts.append(pd.DataFrame({**head, **rows, "unit": PROFILED[name]}))
    table = pd.concat(parts, ignore_index=True)
    return table[table["p50"].notna()].reset_index(drop=True)
