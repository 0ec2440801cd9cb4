"""Roll and pitch of the rover: those of the ground it stands on, and how they move its origin."""

import numpy as np
import numpy.typing as npt

from lunarsci.twin.held import HeldForces
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.findings import Findings
from lunarsci.twin.telemetry.record import Telemetry

__all__ = ["check_attitude", "sway_m"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
ATTITUDE_DEG, FOLLOWS = 1.5, 0.6
"""Median difference of roll or pitch from the terrain's beyond which the terrain is not the ground [deg]; and, where it
slopes by more than 1 degree, as a share of the slope; assumed."""


def sway_m(rover: Rover, paths: FloatArray) -> FloatArray:
    """How far the rover's origin is from above the point that its wheels stand about, by roll and pitch. (n, 2) [m]

    The wheels carry that point; the origin sways above it, which is no slip.
    """
    height = rover.wheel.radius_m - float(rover.wheel_positions_m[:, 2].mean())
    roll, pitch, yaw = np.radians(np.nan_to_num(paths[:, 3:6])).T
    ahead, left = np.sin(pitch) * np.cos(roll), -np.sin(roll)
    return height * np.column_stack(
        [np.cos(yaw) * ahead - np.sin(yaw) * left, np.sin(yaw) * ahead + np.cos(yaw) * left]
    )


def check_attitude(telemetry: Telemetry, held: HeldForces, rows: IntArray, findings: Findings) -> None:
    """Roll and pitch must be those of a rover that stands on this terrain."""
    for column, name in ((3, "roll_deg"), (4, "pitch_deg")):
        measured, stood = getattr(telemetry, name)[rows], held.paths[:, column]
        known = np.isfinite(measured) & np.isfinite(stood)
        if known.sum() < 5:
            continue
        a, b = measured[known], stood[known]

        def off(values: FloatArray, wanted: FloatArray = b) -> float:
            return float(np.median(np.abs(values - wanted)))

        size = float(np.median(np.abs(b)))
        if off(a) <= max(ATTITUDE_DEG, FOLLOWS * size) and not (size > 1.0 and off(a) > FOLLOWS * size):
            continue
        hint = "; it has the other sign" if off(-a) < 0.4 * off(a) else ""
        hint = "; it looks like rad" if off(np.degrees(a)) < 0.4 * off(a) else hint
        what = f"{name} is {off(a):.3g} deg off the terrain's in the median{hint}: another terrain, frame or sign"
        findings.add("attitude against terrain", what, "the terrain's is taken", count=int(known.sum()), doubt=True)
