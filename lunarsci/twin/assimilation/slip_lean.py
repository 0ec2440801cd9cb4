"""Whether the soil that was found makes wheels slip as they did: where it does not, predictions lean that way.

Slip and sinkage of a drive need not be those of one soil of the twin's law: another law, rover or terrain, or a track
that was measured wrong. The update then finds the soil in between, and allows for it as an error that all wheels share.
"""

from dataclasses import dataclass

import numpy as np

from lunarsci.twin.assimilation.drive_record import OBSERVED, DriveRecord, states_at
from lunarsci.twin.assimilation.residuals import SAMPLE_M, STEP_S
from lunarsci.twin.assimilation.update import SoilUpdate
from lunarsci.twin.simulation.ensemble import predict

LEAST_LEAN, LEAN_ERRORS, LEAN_SOILS = 0.02, 2.0, 64
"""Slip that a belief may lean by: so much, or so many standard errors where that is more; and soils that tell the
spread. Of 70 right beliefs the farthest lean by 0.017 and by 1.7 errors, measured by `tests/benchmarks/leaning.py`
(docs/validation/drive.md). [-]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipLean:
    """Median slip of a drive as measured, and on the soils that are believed after it.

    Attributes
    ----------
    stretch : of the way that it is about, such as `2.0 to 5.1 m: `; empty for the whole drive.
    measured, simulated : medians over the measured states, the latter the middle one of drives on soils of the belief,
        as a prediction of the same plan from it has them. [-]
    spread : standard deviation of the latter over these soils. [-]
    sigma : error of the former, that of a single state, as neighbours share their errors. [-]
    """

    measured: float
    simulated: float
    spread: float
    sigma: float
    stretch: str = ""

    @classmethod
    def of(cls, record: DriveRecord, found: SoilUpdate, stretch: str = "", least: int = 1) -> "SlipLean | None":
        """Of a record with the slips that positions tell, too; None for fewer slips than `least`."""
        column, best = OBSERVED.index("slip_ratio"), found.prediction
        known = np.isfinite(record.values[:, column])
        if known.sum() < least or found.refused:
            return None
        soils = found.belief.draws(LEAN_SOILS)
        driven = predict(
            best.rover, best.terrain, best.plan, samples=soils, time_step_s=STEP_S, sample_m=SAMPLE_M, ruts=best.ruts
        )

        states = states_at(record, driven.time_s, driven.states[driven.finished], best.rover.wheels)
        slips = np.median(states[:, known, column], axis=1)
        return cls(
            measured=float(np.median(record.values[known, column])),
            simulated=float(np.median(slips)),
            spread=float(slips.std(ddof=1)) if slips.size > 1 else 0.0,
            sigma=float(np.median(record.sigmas[known, column])),
            stretch=stretch,
        )

    @property
    def error(self) -> float:
        """Standard error of the difference. [-]"""
        return float(np.hypot(self.spread, self.sigma))

    @property
    def off(self) -> bool:
        """Whether the soil found surely makes wheels slip otherwise than they did."""
        return abs(self.simulated - self.measured) > max(LEAST_LEAN, LEAN_ERRORS * self.error)

    @property
    def doubt(self) -> str:
        """What it means, and what to do; empty where it is within its errors."""
        if not self.off:
            return ""
        more = "more" if self.simulated > self.measured else "less"
        errors = abs(self.simulated - self.measured) / self.error
        way_out = "" if self.stretch else ", or learn each stretch on its own (--save-map)"
        return (
            f"{self.stretch}median slip is {self.simulated:.3f} on the soil found, {self.measured:.3f} was measured "
            f"({errors:.1f} standard errors): predictions slip {more} than the rover does; look for a wrong rover, "
            f"track depth or terrain{way_out}"
        )

    @property
    def text(self) -> str:
        """Both medians and the error of their difference."""
        found = f"{self.measured:.3f} measured, {self.simulated:.3f} simulated on the soil found"
        return f"{self.stretch}median slip ratio: {found}; standard error of the difference {self.error:.3f}"

    def to_dict(self) -> dict[str, float | bool]:
        """For a result."""
        return {
            "measured": self.measured,
            "simulated": self.simulated,
            "spread": self.spread,
            "sigma": self.sigma,
            "off": self.off,
        }
