"""What comes out of a calibration, also as ECSV and FITS files, with units and provenance."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.provenance import plain
from lunarsci.spectra.photometry.geometry import STANDARD
from lunarsci.spectra.spectrum import FloatArray, Spectrum
from lunarsci.spectra.vnis.channels import SPLICED_NM
from lunarsci.spectra.vnis.detector import DetectorSpectrum
from lunarsci.spectra.vnis.footprint import Footprint
from lunarsci.spectra.vnis.splice import Splice

if TYPE_CHECKING:
    from astropy.table import Table

__all__ = ["Calibration", "CalibrationFailure", "columns", "to_ecsv", "to_fits"]


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
    photometry, phase, solar : names of the photometric functions (`none` without correction) and of the irradiance.
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
    photometry: str
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
            "photometry": {"disk": self.photometry, "phase": self.phase} | self._geometry(),
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

    def rows(self) -> list[dict[str, Any]]:
        """One a channel, for a table."""
        total = self.systematic_total
        return [
            {
                "id": self.id,
                "wavelength_nm": float(SPLICED_NM[k]),
                "reflectance": float(self.reflectance[k]),
                "reflectance_sigma": float(self.sigma[k]),
                "reflectance_systematic": float(total[k]),
                **{f"systematic_{name}": float(mode[k]) for name, mode in self.systematic.items()},
            }
            for k in range(SPLICED_NM.size)
        ]

    def at_nm(self, wavelength_nm: float) -> tuple[float, float, float]:
        """Reflectance factor of one channel, its independent and its shared error. [-]"""
        at = int(np.flatnonzero(wavelength_nm == SPLICED_NM)[0])
        return float(self.reflectance[at]), float(self.sigma[at]), float(self.systematic_total[at])

    def _geometry(self) -> dict[str, float | None]:
        """The angles that the reflectance factor is for; None where each detector keeps its own."""
        corrected = self.photometry != "none"
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


_PROVENANCE_HDU = "PROVENANCE"


def columns(calibrations: Sequence[Calibration]) -> dict[str, FloatArray]:
    """Column name to values: `wavelength_nm`, then ID, ID_sigma and ID_systematic_NAME of every observation.

    An id that comes twice gets the suffix -2, -3 and so on.
    """
    table: dict[str, FloatArray] = {"wavelength_nm": SPLICED_NM}
    seen: dict[str, int] = {}
    for item in calibrations:
        seen[item.id] = seen.get(item.id, 0) + 1
        name = item.id if seen[item.id] == 1 else f"{item.id}-{seen[item.id]}"
        table[name] = item.reflectance
        table[f"{name}_sigma"] = item.sigma
        table |= {f"{name}_systematic_{key}": mode for key, mode in item.systematic.items()}
    return table


def to_ecsv(calibrations: Sequence[Calibration], provenance: Mapping[str, Any]) -> bytes:
    """An ECSV table; the header holds the provenance and what is known of every observation."""
    table = _table(calibrations)
    table.meta.update(_description(calibrations) | {"provenance": plain(provenance)})
    buffer = io.StringIO()
    table.write(buffer, format="ascii.ecsv")
    return buffer.getvalue().encode()


def to_fits(calibrations: Sequence[Calibration], provenance: Mapping[str, Any]) -> bytes:
    """A FITS file: a binary table of the spectra, and one whose only cell is the same record as JSON."""
    from astropy.io import fits
    from astropy.table import Table

    spectra = fits.table_to_hdu(_table(calibrations))
    spectra.name = "SPECTRA"
    record = json.dumps(_description(calibrations) | {"provenance": plain(provenance)}, sort_keys=True)
    note = fits.table_to_hdu(Table({"json": [record]}))
    note.name = _PROVENANCE_HDU
    buffer = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), spectra, note]).writeto(buffer)
    return buffer.getvalue()


def _table(calibrations: Sequence[Calibration]) -> "Table":
    from astropy.table import Table

    table = Table(columns(calibrations))
    table["wavelength_nm"].unit = "nm"
    for name in table.colnames[1:]:
        table[name].unit = ""
    return table


def _description(calibrations: Sequence[Calibration]) -> dict[str, Any]:
    synthetic = any(item.synthetic for item in calibrations)
    title = "reflectance factor of Chang'E-4 VNIS observations"
    return {
        "title": f"SYNTHETIC {title}" if synthetic else title,
        "observations": [plain(item.summary()) for item in calibrations],
    }
