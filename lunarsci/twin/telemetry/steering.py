"""How the wheels were steered: measured, else commanded, where the two agree."""

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.findings import Findings
from lunarsci.twin.telemetry.record import Telemetry

__all__ = ["steering_angles"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
OFF_DEG = 5.0
"""Difference of measured and commanded steering that no motor on its way makes; assumed. [deg]"""
SPIKES = 0.2
"""Share of rows up to which such differences are taken for bad readings; assumed."""
STUCK_DEG, STUCK_ROWS = 2.0, 4
"""Change of the command [deg] over so many equal readings from which on a sensor hangs; assumed."""


def steering_angles(telemetry: Telemetry, rover: Rover, findings: Findings) -> tuple[FloatArray, BoolArray]:
    """Steering of every row and wheel, and where it is known, not found from the rows beside. (n, wheels) [deg]

    Readings that hang or jump away from the command are replaced by it and said. Raises DataError for a wheel that has
    none, and for angles that are in rad or beyond 90 degrees.
    """
    measured, told = telemetry.steered_deg.copy(), telemetry.steering_deg
    _check_unit(telemetry.file, measured, told)
    for k, wheel in enumerate(rover.wheels):
        _mend(telemetry, k, wheel, measured, told, findings)
    angle = np.where(np.isfinite(measured), measured, told)
    known = np.isfinite(angle)
    for k, wheel in enumerate(rover.wheels):
        rows = known[:, k]
        if not rows.any():
            raise DataError(f"{telemetry.file}: no row has a steering angle of wheel {wheel}")
        if not rows.all():
            findings.add(
                "missing steering",
                f"rows without a steering angle of wheel {wheel}",
                "found from the rows beside; its states are not valid there",
                count=int((~rows).sum()),
                time_s=float(telemetry.time_s[int(np.argmin(rows))]),
            )
        angle[:, k] = np.interp(telemetry.time_s, telemetry.time_s[rows], angle[rows, k])
    if np.abs(angle).max() > 90.0:
        raise DataError(f"{telemetry.file}: steering angles reach {np.abs(angle).max():.4g} deg; give -90 to 90 deg")
    return angle, known


def _check_unit(file: str, measured: FloatArray, told: FloatArray) -> None:
    both = np.isfinite(measured) & np.isfinite(told)
    both &= np.maximum(np.abs(measured), np.abs(told)) > 1.0
    if both.sum() < 5:
        return
    a, b = measured[both], told[both]
    ratio = float((a * b).sum() / (b * b).sum())
    if ratio < -0.5:
        raise DataError(f"{file}: steered_W_deg and steering_W_deg have opposite signs; both are positive to the left")
    if 0.01 < ratio < 0.03 or 30 < ratio < 100:
        wrong = "steered_W_deg" if ratio < 1 else "steering_W_deg"
        raise DataError(f"{file}: {wrong} looks like rad beside the other; convert it to degrees")


def _mend(telemetry: Telemetry, k: int, wheel: str, measured: FloatArray, told: FloatArray, findings: Findings) -> None:
    """Put the command in the place of readings that hang or spike, in one wheel's column of `measured`."""
    both = np.isfinite(measured[:, k]) & np.isfinite(told[:, k])
    hung = np.zeros(len(both), dtype=bool)
    same = np.flatnonzero(np.append(True, np.diff(measured[:, k]) != 0))
    for begin, end in zip(same, [*same[1:], len(both)], strict=True):
        piece = told[begin:end, k]
        hung[begin + 1 : end] = end - begin >= STUCK_ROWS and bool(np.nan_to_num(np.ptp(piece)) > STUCK_DEG)
    off = both & ~hung & (np.abs(measured[:, k] - told[:, k]) > OFF_DEG)
    for kind, rows, what in (
        ("stuck", hung, f"the steering angle of wheel {wheel} stays the same while it is told to change"),
        ("odd steering", off, f"the steering angle of wheel {wheel} is over {OFF_DEG:g} deg off its command"),
    ):
        if rows.any():
            few = kind == "stuck" or bool(rows.sum() <= SPIKES * both.sum())
            done = "the command is taken there" if few else "the measured angle is taken"
            first = float(telemetry.time_s[int(np.argmax(rows))])
            findings.add(kind, what, done, count=int(rows.sum()), time_s=first, doubt=not few)
            if few:
                measured[rows, k] = told[rows, k]
