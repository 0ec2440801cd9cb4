"""What comes out of a calibration: also as ECSV and FITS files, with units and provenance, and as a page."""

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.figure import COLORS, as_label, headline, page
from lunarsci.provenance import plain
from lunarsci.spectra.photometry import STANDARD
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.channels import SPLICED_NM, footprint_ring
from lunarsci.spectra.vnis.detector import DetectorSpectrum
from lunarsci.spectra.vnis.footprint import Footprint
from lunarsci.spectra.vnis.splice import Splice

if TYPE_CHECKING:
    from astropy.table import Table
    from matplotlib.figure import Figure


_PROVENANCE_HDU = "PROVENANCE"
LOOKS: Any = {
    "vnir": {"color": COLORS[0], "linestyle": "-"},
    "swir": {"color": COLORS[1], "linestyle": (0, (5, 1.2))},
}
_SHADOW, _INVALID = (0.0, 0.62, 0.45, 0.8), (0.8, 0.47, 0.65, 0.9)


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
    notes : what the reader should know, one sentence each. doubts : those of them for which it should not be trusted.
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
    doubts: Sequence[str] = ()

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
            "status": "doubtful" if self.doubts else "ok",
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
            "doubts": list(self.doubts),
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
        """Counts of pixels and samples of the footprint, by their keys."""
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
    """The keys of one detector."""
    return {
        "incidence_deg": item.geometry.incidence_deg,
        "emission_deg": item.geometry.emission_deg,
        "phase_deg": item.geometry.phase_deg,
        "sun_distance_au": item.distance_au,
        "noise_excess": float(item.excess.max()),
        "channels_masked": int((~np.isfinite(item.observed)).sum()),
    }


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


def calibration_pages(calibrations: Sequence[Calibration]) -> "Iterator[Figure]":
    """Image with footprint and rejected pixels; radiance; reflectance before and after correction; the spectrum."""
    for item in calibrations:
        figure = page(7.4)
        (image, radiance), (reflectance, spectrum) = figure.subplots(2, 2)
        _draw_image(image, item)
        _draw_radiance(radiance, item)
        _draw_reflectance(reflectance, item)
        _draw_spectrum(spectrum, item)
        headline(figure, f"{as_label(item.id, 60)}, {item.time_utc[:16]} UTC", synthetic=item.synthetic)
        yield figure


def _draw_image(axes: Any, item: Calibration) -> None:
    finite = item.image[np.isfinite(item.image)]
    low, high = np.percentile(finite, [1, 99]) if finite.size else (0, 1)
    axes.imshow(item.image, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    for pixels, color, name in (
        (item.footprint.shadowed, _SHADOW, "shadow"),
        (item.footprint.invalid, _INVALID, "no value"),
    ):
        if pixels.any():
            overlay = np.zeros((*pixels.shape, 4))
            overlay[pixels] = color
            axes.imshow(overlay, interpolation="nearest")
            axes.plot([], [], "s", color=color, label=f"{name}, left out: {int(pixels.sum())} px")
    lit, inside = int(item.footprint.lit.sum()), int(item.footprint.inside.sum())
    draw_footprint(axes, f"SWIR field of view: {lit} of {inside} px used")
    axes.set(xlabel="sample [px]", ylabel="line [px]", title="VNIR image at 750 nm")
    _legend(axes)


def draw_footprint(axes: Any, label: str) -> None:
    """The SWIR field of view, as a ring that is seen on bright and on dark ground."""
    axes.plot(*footprint_ring(), color="black", linewidth=2.4)
    axes.plot(*footprint_ring(), color="#F0E442", linewidth=1.2, label=label)


def _draw_radiance(axes: Any, item: Calibration) -> None:
    for detector in (item.vnir, item.swir):
        axes.plot(detector.wavelength_nm, detector.radiance, label=_name(detector), **LOOKS[detector.detector])
    counted = item.footprint
    scale = np.divide(item.vnir.radiance, counted.mean, out=np.ones(counted.mean.size), where=counted.mean > 0)
    axes.fill_between(
        item.vnir.wavelength_nm,
        item.vnir.radiance - counted.scatter * scale,
        item.vnir.radiance + counted.scatter * scale,
        color=LOOKS["vnir"]["color"],
        alpha=0.2,
        linewidth=0,
        label="scatter of its pixels",
    )
    axes.set(xlabel="wavelength [nm]", ylabel="radiance [W m$^{-2}$ sr$^{-1}$ nm$^{-1}$]", title="radiance")
    axes.set_ylim(bottom=0)
    _legend(axes)


def _legend(axes: Any) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), frameon=False)


def _name(detector: DetectorSpectrum) -> str:
    g = detector.geometry
    angles = f"i {g.incidence_deg:.1f}°, e {g.emission_deg:.1f}°, g {g.phase_deg:.1f}°"
    return f"{detector.detector.upper()}: {angles}, Sun {detector.distance_au:.4f} AU"


def _draw_reflectance(axes: Any, item: Calibration) -> None:
    corrected = item.photometry != "none"
    for detector in (item.vnir, item.swir):
        look = LOOKS[detector.detector]
        axes.plot(detector.wavelength_nm, detector.observed, **look | {"alpha": 0.6, "linestyle": ":"})
        if corrected:
            axes.plot(detector.wavelength_nm, detector.corrected, **look)
    axes.plot([], [], color="0.4", alpha=0.6, linestyle=":", label="at the angles of measurement")
    if corrected:
        axes.plot([], [], color="0.4", label=f"at i 30°, e 0°, g 30° ({item.photometry}, {item.phase})")
    splice = item.splice
    joined = (
        f"VNIR × {splice.gain:.4f} ± {splice.gain_sigma:.4f};\n"
        f"SWIR below 1377.5 nm × {splice.step.factor:.4f} ± {splice.step.sigma:.4f}"
    )
    axes.text(0.98, 0.03, joined, transform=axes.transAxes, ha="right")
    axes.set(xlabel="wavelength [nm]", ylabel="reflectance factor [-]", title="corrections, before joining")
    axes.set_ylim(bottom=0)
    _legend(axes)


def _draw_spectrum(axes: Any, item: Calibration) -> None:
    total = np.hypot(item.sigma, item.systematic_total)
    for error, alpha, label in (
        (total, 0.15, "1 σ with shared errors (level, model)"),
        (item.sigma, 0.4, "1 σ independent between channels"),
    ):
        low, high = item.reflectance - error, item.reflectance + error
        axes.fill_between(SPLICED_NM, low, high, color="black", alpha=alpha, linewidth=0, label=label)
    axes.plot(SPLICED_NM, item.reflectance, color="black", linewidth=1)
    axes.axvline(900, color="0.7", linewidth=0.8, linestyle=":")
    axes.axvline(1377.5, color="0.7", linewidth=0.8, linestyle=":")
    axes.set(xlabel="wavelength [nm]", ylabel="reflectance factor [-]", title="joined spectrum, 390 channels")
    axes.set_ylim(bottom=0)
    _legend(axes)
