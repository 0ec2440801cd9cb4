"""Photometry of the Moon: from the reflectance factor seen at some geometry to that at 30, 0, 30 deg."""

from lunarsci.spectra.photometry.correction import (
    DISKS,
    akimov,
    correction_factor,
    lommel_seeliger,
    mcewen,
    model_spread,
    remarks,
)
from lunarsci.spectra.photometry.geometry import STANDARD, Geometry, phase_angle_deg
from lunarsci.spectra.photometry.phase import (
    PHASE_FUNCTIONS,
    PhaseFunction,
    phase_function,
    read_phase_function,
)

__all__ = [
    "DISKS",
    "PHASE_FUNCTIONS",
    "STANDARD",
    "Geometry",
    "PhaseFunction",
    "akimov",
    "correction_factor",
    "lommel_seeliger",
    "mcewen",
    "model_spread",
    "phase_angle_deg",
    "phase_function",
    "read_phase_function",
    "remarks",
]
