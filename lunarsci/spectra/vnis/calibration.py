"""What comes out of a calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.spectra.photometry import STANDARD
from lunarsci.spectra.spectrum import FloatArray, Spectrum
from lunarsci.spectra.vnis.channels import SPLICED_NM
from lunarsci.spectra.vnis.detector import DetectorSpectrum
from lunarsci.spectra.vnis.footprint import Footprint
from lunarsci.spectra.vnis.splice import Splice

__all__ = ["Calibration", "CalibrationFailure"]


@dataclass(frozen=True, slots=True)
class CalibrationFailure:
    """An observation that gave no spectrum, and why in one line."""

    id: str
    status: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Calibration:
    """A calibrated observation.

    Attributes
    ----------
    id, synthetic : of the observation. time_utc : start of the short-wave measurement, ISO 8601.
    latitude_deg, longitude_deg : of the rover, NaN where the label has none.
    reflectance : shape (390,), reflectance factor, NaN where no channel could be used. [-]
    sigma : shape (390,), one standard deviation of what is independent between channels. [-]
    systematic : name to shift of every channel by one standard deviation of an error they share, shape (390,). [-]
    vnir, swir : the two detectors before joining. splice : how they were joined. footprint : pixels used.
    image : radiance of the frame at 750 nm, shape (256, 256). [W m-2 sr-1 nm-1]
    disk, phase, solar : names of the photometric functions (`none` without correction) and of the irradiance.
    notes : what the reader should know, one sentence each.
    inputs : path to SHA-256.
    """

    id: str
    synthetic: bool
    time_utc: str
    latitude_deg: float
    longitude_deg: float
    reflectance: FloatArray
    sigma: FloatArray
    systematic: Mapping[str, FloatArray]
    vnir: DetectorSpectrum
    swir: DetectorSpectrum
    splice: Splice
    footprint: Footprint
    image: npt.NDArray[np.float32]
    disk: str
    phase: str
    solar: str
    notes: Sequence[str]
    inputs: Mapping[str, str]

    @property
    def systematic_total(self) -> FloatArray:
        """Root sum square of the systematic shifts, shape (390,). [-]"""
        return np.sqrt(sum((mode**2 for mode in self.systematic.values()), np.zeros(SPLICED_NM.size)))

    def to_spectrum(self) -> Spectrum:
        """The spectrum that the other commands work on."""
        return Spectrum(
            self.id,
            SPLICED_NM,
            self.reflectance,
            self.sigma,
            metadata={key: value for key, value in self.summary().items() if key != "id"} | {"inputs": self.inputs},
            systematic=self.systematic,
        )

    def summary(self) -> dict[str, Any]:
        """Everything but the arrays, in plain Python, keys with their units."""
        return {
            "id": self.id,
            "source": next(iter(self.inputs), ""),
            "synthetic": self.synthetic,
            "status": "ok",
            "time_utc": self.time_utc,
            "latitude_deg": self.latitude_deg,
            "longitude_deg": self.longitude_deg,
            "vnir": _of_detector(self.vnir),
            "swir": _of_detector(self.swir),
            "photometry": {"disk": self.disk, "phase": self.phase} | self._geometry(),
            "solar": self.solar,
            "footprint": self._pixels(),
            "splice": {
                "step": self.splice.step.factor,
                "step_sigma": self.splice.step.sigma,
                "vnir_steps": [
                    {"at_nm": step.at_nm, "factor": step.factor, "sigma": step.sigma} for step in self.splice.vnir_steps
                ],
                "vnir_steps_removed": self.splice.vnir_steps_removed,
                "gain": self.splice.gain,
                "gain_sigma": self.splice.gain_sigma,
                "overlap_rms": self.splice.overlap_rms,
            },
            "channels": SPLICED_NM.size,
            "channels_masked": int((~np.isfinite(self.reflectance)).sum()),
            "notes": list(self.notes),
        }

    def to_dict(self) -> dict[str, Any]:
        """Everything, in plain Python, keys with their units; NaN where a channel is not used."""
        return self.summary() | {
            "wavelength_nm": SPLICED_NM.tolist(),
            "reflectance": self.reflectance.tolist(),
            "reflectance_sigma": self.sigma.tolist(),
            "reflectance_systematic": self.systematic_total.tolist(),
            "systematic": {name: mode.tolist() for name, mode in self.systematic.items()},
        }

    def _geometry(self) -> dict[str, float | None]:
        """The angles that the reflectance factor is for; None where each detector keeps its own."""
        corrected = self.disk != "none"
        return {
            "incidence_deg": STANDARD.incidence_deg if corrected else None,
            "emission_deg": STANDARD.emission_deg if corrected else None,
            "phase_deg": STANDARD.phase_deg if corrected else None,
        }

    def _pixels(self) -> dict[str, int | float]:
        return {
            "pixels": int(self.footprint.inside.sum()),
            "pixels_lit": int(self.footprint.lit.sum()),
            "pixels_shadowed": int(self.footprint.shadowed.sum()),
            "pixels_invalid": int(self.footprint.invalid.sum()),
            "shadow_dilution": self.footprint.dilution,
            "samples_clipped": int(self.footprint.clipped.sum()),
            "samples_negative": int(self.footprint.negative.sum()),
        }


def _of_detector(item: DetectorSpectrum) -> dict[str, Any]:
    return {
        "incidence_deg": item.geometry.incidence_deg,
        "emission_deg": item.geometry.emission_deg,
        "phase_deg": item.geometry.phase_deg,
        "sun_distance_au": item.distance_au,
        "noise_excess": float(item.excess.max()),
        "channels_masked": int((~np.isfinite(item.observed)).sum()),
    }
