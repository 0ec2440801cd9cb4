"""One page per observation: where was averaged, what was measured, what was corrected, and the spectrum with errors."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lunarsci.spectra.vnis.calibration import Calibration
from lunarsci.spectra.vnis.channels import FOOTPRINT, SPLICED_NM
from lunarsci.spectra.vnis.detector import DetectorSpectrum

__all__ = ["calibration_pages"]

COLORS = {"vnir": "#0072B2", "swir": "#D55E00"}
"""Okabe & Ito (2008), Color Universal Design."""
_SHADOW, _INVALID = (0.0, 0.62, 0.45, 0.8), (0.8, 0.47, 0.65, 0.9)


def calibration_pages(calibrations: Sequence[Calibration]) -> Iterator[Figure]:
    """Image with footprint and rejected pixels; radiance; reflectance before and after correction; the spectrum."""
    for item in calibrations:
        figure = Figure(figsize=(12, 9), layout="constrained")
        (image, radiance), (reflectance, spectrum) = figure.subplots(2, 2)
        _draw_image(image, item)
        _draw_radiance(radiance, item)
        _draw_reflectance(reflectance, item)
        _draw_spectrum(spectrum, item)
        synthetic = ": SYNTHETIC, not a measurement" if item.synthetic else ""
        figure.suptitle(f"{item.id}, {item.time_utc[:16]} UTC{synthetic}")
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
    turn = np.linspace(0, 2 * np.pi, 181)
    line, sample, radius = FOOTPRINT
    lit, inside = int(item.footprint.lit.sum()), int(item.footprint.inside.sum())
    label = f"SWIR field of view: {lit} of {inside} px used"
    axes.plot(sample + radius * np.cos(turn), line + radius * np.sin(turn), color="#F0E442", label=label)
    axes.set(xlabel="sample [px]", ylabel="line [px]", title="VNIR image at 750 nm")
    axes.legend(loc="lower left", fontsize=8)


def _draw_radiance(axes: Any, item: Calibration) -> None:
    for detector in (item.vnir, item.swir):
        axes.plot(detector.wavelength_nm, detector.radiance, color=COLORS[detector.detector], label=_name(detector))
    counted = item.footprint
    scale = np.divide(item.vnir.radiance, counted.mean, out=np.ones(counted.mean.size), where=counted.mean > 0)
    axes.fill_between(
        item.vnir.wavelength_nm,
        item.vnir.radiance - counted.scatter * scale,
        item.vnir.radiance + counted.scatter * scale,
        color=COLORS["vnir"],
        alpha=0.2,
        linewidth=0,
        label="scatter of its pixels",
    )
    axes.set(xlabel="wavelength [nm]", ylabel="radiance [W m$^{-2}$ sr$^{-1}$ nm$^{-1}$]", title="Radiance")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)


def _name(detector: DetectorSpectrum) -> str:
    g = detector.geometry
    angles = f"i {g.incidence_deg:.1f}°, e {g.emission_deg:.1f}°, g {g.phase_deg:.1f}°"
    return f"{detector.detector.upper()}: {angles}, Sun {detector.distance_au:.4f} AU"


def _draw_reflectance(axes: Any, item: Calibration) -> None:
    corrected = item.photometry != "none"
    for detector in (item.vnir, item.swir):
        color = COLORS[detector.detector]
        axes.plot(detector.wavelength_nm, detector.observed, color=color, alpha=0.45, linewidth=1)
        if corrected:
            axes.plot(detector.wavelength_nm, detector.corrected, color=color)
    axes.plot([], [], color="0.4", alpha=0.45, linewidth=1, label="at the angles of measurement")
    if corrected:
        axes.plot([], [], color="0.4", label=f"at i 30°, e 0°, g 30° ({item.photometry}, {item.phase})")
    splice = item.splice
    axes.text(
        0.02,
        0.02,
        f"VNIR × {splice.gain:.4f} ± {splice.gain_sigma:.4f}; SWIR below 1377.5 nm × {splice.step.factor:.4f} "
        f"± {splice.step.sigma:.4f}",
        transform=axes.transAxes,
        fontsize=8,
    )
    axes.set(xlabel="wavelength [nm]", ylabel="reflectance factor", title="Corrections, before joining")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8, loc="upper left")


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
    axes.set(xlabel="wavelength [nm]", ylabel="reflectance factor", title="Joined spectrum, 390 channels")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8, loc="upper left")
