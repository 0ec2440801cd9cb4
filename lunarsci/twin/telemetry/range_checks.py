"""Whether states are where the twin holds: on the terrain, and within the range of the wheel model."""

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.simulation.contact_frame import VALID_SLIP
from lunarsci.twin.telemetry.reading import Findings

MOST_FAST = 0.05
"""Share of states that slip beyond the range of the wheel model from which on a soil learned from the others is in
doubt; assumed."""


def check_stands(stands: BoolArray, time_s: FloatArray, findings: Findings) -> None:
    """Say states at which the rover does not stand on the terrain."""
    if not stands.all():
        findings.add(
            "off the terrain",
            "the rover does not stand on the terrain there",
            "states there are left blank, not valid",
            count=int((~stands).sum()),
            time_s=float(time_s[int(np.argmin(stands))]),
            doubt=True,
        )


def check_fast(fast: BoolArray, measured: BoolArray, time_s: FloatArray, findings: Findings) -> None:
    """Say states, (m, wheels) of those that are measured, that slip beyond the range of the wheel model."""
    count, whole = int(fast.sum()), int(measured.sum())
    if count:
        what = f"{count} of {whole} states slip by more than {VALID_SLIP:g}, beyond what the wheel model holds for"
        done = "kept here, in medians and ranges too, but marked not valid: `twin update` learns no soil from them"
        first = float(time_s[int(np.argmax(fast.any(axis=1)))])
        findings.add("fast slip", what, done, count=count, time_s=first, doubt=count > MOST_FAST * whole)
