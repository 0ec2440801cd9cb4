"""Wheel states beside their predicted bands: bias, scatter and coverage."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.twin.comparison.ends import crps, predictive_rank
from lunarsci.twin.comparison.meeting import Meeting
from lunarsci.twin.comparison.surprise import correlation_length
from lunarsci.twin.inference.drive_record import OBSERVED
from lunarsci.twin.inference.misfit import MODEL_ERRORS

__all__ = ["ALL", "NOMINAL", "BandCheck", "check_bands", "half_band", "ranks", "standardised"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
ALL = "all"
NOMINAL = 0.9


@dataclass(frozen=True, slots=True)
class BandCheck:
    """One quantity of one wheel, or of all.

    Attributes
    ----------
    quantity, wheel : which; the wheel is `all` for all together.
    n, effective : values, and how many independent ones they are worth. [-]
    bias, rms : mean and root mean square of measured less predicted mean, in the quantity's unit.
    bias_standard : bias over the standard deviation that the prediction and the errors of measurement give it. [-]
    rms_standard : root mean square of the differences, each over its own standard deviation; 1 if all is right. [-]
    coverage_90 : share of the values in their predicted 90 % band, errors of measurement included. [-]
    crps : mean continuous ranked probability score, in the quantity's unit.
    """

    quantity: str
    wheel: str
    n: int
    effective: float
    bias: float
    rms: float
    bias_standard: float | None
    rms_standard: float | None
    coverage_90: float | None
    crps: float


def standardised(meeting: Meeting, column: int, rows: BoolArray) -> FloatArray:
    """Measured less predicted mean, over the root of the members' variance (1 + 1/M) and that of the error. (n,)"""
    members, sigma = meeting.predicted[:, rows, column], meeting.sigma[rows, column]
    count = len(members)
    variance = members.var(axis=0, ddof=1) * (1.0 + 1.0 / count) if count > 1 else 0.0
    off = meeting.record.values[rows, column] - members.mean(axis=0)
    return np.asarray(off / np.sqrt(variance + sigma**2))


def check_bands(meeting: Meeting) -> list[BandCheck]:
    """Each quantity that was measured, of all wheels together and of each that has values."""
    wheel = np.array(meeting.record.wheel)
    found = []
    for name in meeting.measured_quantities():
        known = meeting.known[:, OBSERVED.index(name)]
        found.append(_check(meeting, name, ALL, known))
        wheels = (w for w in meeting.forecast.wheels if known[wheel == w].any())
        found += [_check(meeting, name, w, known & (wheel == w)) for w in wheels]
    return found


def _check(meeting: Meeting, name: str, wheel: str, rows: BoolArray) -> BandCheck:
    column = OBSERVED.index(name)
    members, measured = meeting.predicted[:, rows, column], meeting.record.values[rows, column]
    off, several = measured - members.mean(axis=0), len(members) > 2
    bias = float(off.mean())
    own = members.mean(axis=1).var(ddof=1) * (1.0 + 1.0 / len(members)) if several else 0.0
    error = float((meeting.sigma[rows, column] ** 2).mean()) / len(off) + MODEL_ERRORS[name] ** 2
    standard = standardised(meeting, column, rows)
    return BandCheck(
        quantity=name,
        wheel=wheel,
        n=int(rows.sum()),
        effective=effective_values(meeting, column, rows) if several else float(len(off)),
        bias=bias,
        rms=float(np.sqrt((off**2).mean())),
        bias_standard=bias / float(np.sqrt(own + error)) if several else None,
        rms_standard=float(np.sqrt((standard**2).mean())) if several else None,
        coverage_90=float((np.abs(standard) <= half_band(len(members))).mean()) if several else None,
        crps=float(crps(measured, members).mean()),
    )


def half_band(members: int) -> float:
    """Half the 90 % band of a normal law whose mean and deviation are known from so many members. [sd]"""
    from scipy.stats import t

    return float(t.ppf(0.5 + NOMINAL / 2, members - 1))


def effective_values(meeting: Meeting, column: int, rows: BoolArray) -> float:
    """Independent values among standardised differences: those of each wheel over their correlation length, summed.

    Wheels count as independent of each other, as far as the length along each tells nothing else. [-]
    """
    total, wheel = 0.0, np.array(meeting.record.wheel)
    for one in sorted(set(wheel[rows])):
        own = rows & (wheel == one)
        order = np.argsort(meeting.record.time_s[own], kind="stable")
        series = standardised(meeting, column, own)[order]
        total += len(series) / correlation_length(series)
    return total


def ranks(meeting: Meeting, name: str) -> FloatArray:
    """Predictive rank of each value of a quantity, 0 to 1. (n,)"""
    column = OBSERVED.index(name)
    rows = meeting.known[:, column]
    return predictive_rank(
        meeting.record.values[rows, column], meeting.sigma[rows, column], meeting.predicted[:, rows, column]
    )
