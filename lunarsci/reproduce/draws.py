"""Monte Carlo draws behind the published standard deviations, as the histograms of Ding et al. (2024), Fig. S13."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lunarsci.regolith import inversion
from lunarsci.regolith.forces import reading_code
from lunarsci.regolith.identify import DRAWS
from lunarsci.regolith.states import COLUMNS, MeasurementErrors
from lunarsci.regolith.wheel import Wheel
from lunarsci.reproduce.soil import COHESION_PA, MEAN_SINKAGE_M, SLIP, STIFFNESS, stand_in_forces

__all__ = ["Histogram", "histograms"]

FloatArray = npt.NDArray[np.float64]
SHEAR_MODULUS_M = 0.0178


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Draws of a quantity, with the ids of its published mean and standard deviation, and a label with its unit."""

    label: str
    mean_id: str
    sd_id: str
    draws: FloatArray


def histograms(wheel: Wheel, draws: int = DRAWS, seed: int = 0) -> tuple[Histogram, Histogram, Histogram]:
    """N at 5 mm and K_s = 1443, K_s at 15 mm and N = 1, phi at c = 520 Pa and a slip ratio of -0.075.

    Parameters
    ----------
    wheel : its lug height is not published and moves the last two a little.
    draws : Monte Carlo sample size, 2 or more; the paper's 1024 by default. [-]
    seed : of the random numbers, >= 0.

    Draws without a solution are left out. Errors are those of `MeasurementErrors`, for phi without the sinkage's.
    """
    rng = np.random.default_rng(seed)

    def stresses(sinkage_m: float, errors: MeasurementErrors, reading: str) -> FloatArray:
        forces = stand_in_forces(wheel)
        nominal = (sinkage_m, SLIP, np.nan, float(forces.normal_force_n), float(forces.drawbar_pull_n), np.nan)
        values = np.array([nominal])
        sigmas = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
        sample = values + sigmas * rng.standard_normal((draws, len(COLUMNS)))
        return np.asarray(inversion.invert_states(sample, wheel.vector(), SHEAR_MODULUS_M, reading_code(reading)))

    shallow = stresses(0.005, MeasurementErrors(), "signed")
    deep = stresses(0.015, MeasurementErrors(), "signed")
    sheared = stresses(MEAN_SINKAGE_M, MeasurementErrors(sinkage_m=0.0), "slip-branch")
    with np.errstate(all="ignore"):
        exponent = inversion.sinkage_exponent(shallow[:, 0], shallow[:, 3], STIFFNESS)
        stiffness = inversion.stiffness(deep[:, 0], deep[:, 3], 1.0)
        angle = inversion.friction_angle(sheared[:, 0], sheared[:, 1], sheared[:, 4], COHESION_PA)
    return (
        _histogram("sinkage exponent N at 5 mm [-]", "exponent-5mm", "exponent-sd", exponent),
        _histogram("stiffness K$_s$ at 15 mm [kPa m$^{-N}$]", "stiffness-15mm", "stiffness-sd-15mm", stiffness),
        _histogram("internal friction angle φ at c = 520 Pa [°]", "friction-angle", "friction-angle-sd", angle),
    )


def _histogram(label: str, mean_id: str, sd_id: str, values: FloatArray) -> Histogram:
    return Histogram(label, mean_id, sd_id, values[np.isfinite(values)])
