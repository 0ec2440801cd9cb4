"""Pictures of measured bands, of Modified Gaussian Model fits, several spectra to a page, and of indices."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lunarsci.spectra.band_status import BANDS
from lunarsci.spectra.bands import SpectrumBands
from lunarsci.spectra.indices import INDICES, OK, IndexColumn
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

CONTINUUM_COLORS = {"conic": "#0072B2", "hull": "#D55E00", "linear": "#009E73"}
PER_PAGE = 6
INVISIBLE = 0.002
"""A band shallower than this in ln R is not drawn, so that the continuum stays visible."""
COLORS = {
    "olivine": "#009E73",
    "orthopyroxene": "#0072B2",
    "clinopyroxene": "#D55E00",
    "plagioclase": "#CC79A7",
    "any": "#999999",
}
"""Colours that remain distinct under colour-vision deficiency: Okabe & Ito (2008), Color Universal Design."""
OTHER = "0.3"
"""Colour of a mineral that has none of its own."""


def band_pages(measured: Sequence[SpectrumBands]) -> Iterator[Figure]:
    """One page per six spectra: spectrum with continua above, continuum removed with the band centres below."""
    return _pages(measured, _draw_bands, heights=(1.0, 1.0), size=(7.5, 5.6))


def fit_pages(fits: Sequence[MgmFit]) -> Iterator[Figure]:
    """One page per six spectra: spectrum, model, continuum and each band above, the residual below."""
    return _pages(fits, _draw_fit, heights=(3.0, 1.0), size=(7.5, 5.6))


def _pages(
    items: Sequence[Any],
    draw: Callable[[Any, Any, Any], None],
    heights: tuple[float, float],
    size: tuple[float, float],
) -> Iterator[Figure]:
    total = -(-len(items) // PER_PAGE)
    for page in range(total):
        part = items[page * PER_PAGE : (page + 1) * PER_PAGE]
        columns = min(2, len(part))
        rows = -(-len(part) // columns)
        figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
        panels = figure.subfigures(rows, columns, squeeze=False).ravel()
        for panel, item in zip(panels, part, strict=False):
            upper, lower = panel.subplots(2, 1, sharex=True, height_ratios=heights)
            draw(upper, lower, item)
        if total > 1:
            figure.suptitle(f"page {page + 1} of {total}", fontsize=9, color="0.4")
        yield figure


def _draw_bands(upper: Any, lower: Any, item: SpectrumBands) -> None:
    wavelength, smoothed, continua = item.wavelength_nm, item.smoothed, item.continua
    upper.plot(wavelength, item.reflectance, ".", color="0.65", markersize=3, label="measured")
    upper.plot(wavelength, smoothed, color="black", linewidth=1, label="smoothed")
    for band in BANDS:
        name = item.bands[band.key].continuum
        if name not in continua:
            continue
        inside = (wavelength >= band.window_nm[0]) & (wavelength <= band.window_nm[1])
        x, level, color = wavelength[inside], continua[name][inside], CONTINUUM_COLORS[name]
        upper.plot(x, level, "--", linewidth=1.2, color=color, label=f"{name} continuum, {band.key} nm band")
        lower.plot(x, item.reflectance[inside] / level, ".", markersize=2, color=color, alpha=0.4)
        lower.plot(x, smoothed[inside] / level, linewidth=1, color=color)
    top = float(np.max(smoothed))
    upper.set_ylim(max(0.0, float(np.min(smoothed)) - 0.15 * top), 1.2 * top)
    lower.axhline(1, color="0.8", linewidth=0.8, zorder=0)
    lower.set_ylim(max(0.0, 1 - 1.4 * _deepest(item)), 1 + 0.35 * _deepest(item))
    _mark_centres(lower, item)
    upper.set_title(item.id, fontsize=10)
    upper.set_ylabel("reflectance")
    lower.set_ylabel("reflectance / continuum")
    lower.set_xlabel("wavelength [nm]")
    upper.legend(fontsize=8, loc="best", frameon=False)


def _mark_centres(axes: Any, item: SpectrumBands) -> None:
    for band in item.bands.values():
        if band.center_nm is None or band.depth is None:
            continue
        axes.errorbar(band.center_nm, 1 - band.depth, xerr=band.center_sigma_nm, fmt="v", color="black", markersize=5)
        text = f"{band.center_nm:.1f} ± {band.center_sigma_nm:.1f} nm\ndepth {band.depth:.3f} ± {band.depth_sigma:.3f}"
        axes.annotate(
            text, (band.center_nm, 1 - band.depth), xytext=(0, -8), textcoords="offset points",
            ha="center", va="top", fontsize=8, bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
        )  # fmt: skip


def _deepest(item: SpectrumBands) -> float:
    depths = [band.depth for band in item.bands.values() if band.depth]
    return max([0.05, *depths])


def _draw_fit(upper: Any, lower: Any, fit: MgmFit) -> None:
    wavelength, model = fit.wavelength_nm, fit.ln_model()
    upper.plot(wavelength, fit.reflectance, ".", color="0.6", markersize=3, label="measured")
    upper.plot(wavelength, np.exp(model), color="black", linewidth=1.2, label="model")
    upper.plot(wavelength, fit.continuum_reflectance, "--", color="0.3", linewidth=1, label="continuum")
    named: set[str] = set()
    for band in fit.bands:
        label = None if band.mineral in named else ("visible and UV" if band.mineral == "any" else band.mineral)
        named.add(band.mineral)
        depth = band.curve(wavelength)
        curve = np.where(depth < -INVISIBLE, fit.continuum_reflectance * np.exp(depth), np.nan)
        upper.plot(wavelength, curve, color=COLORS.get(band.mineral, OTHER), linewidth=1.2, label=label)
    residual = 100 * (np.log(fit.reflectance) - model)
    lower.plot(wavelength, residual, color="black", linewidth=0.7)
    lower.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    upper.set_title(_fit_title(fit), fontsize=10)
    upper.set_ylabel("reflectance")
    lower.set_ylabel("residual\nof ln R [%]")
    lower.set_xlabel("wavelength [nm]")
    top = max(float(fit.reflectance.max()), float(fit.continuum_reflectance.max()))
    upper.set_ylim(0.75 * float(fit.reflectance.min()), 1.25 * top)
    upper.legend(fontsize=8, ncol=4, loc="upper left", frameon=False)


def _fit_title(fit: MgmFit) -> str:
    ratio = fit.nbsr.get("um2")
    strength = f", NBSR(2 µm) OPX {ratio.opx:.2f} ± {ratio.sigma:.2f}" if ratio else ""
    return f"{fit.id}: rms {100 * fit.rms_ln:.2f} %{strength}"


def index_pages(spectra: Sequence[Spectrum], columns: Mapping[str, IndexColumn]) -> Iterator[Figure]:
    """A page a spectrum: spectrum, lines of the integrated band depths, and what is found."""
    for number, spectrum in enumerate(spectra):
        figure = Figure(figsize=(9, 4.8), layout="constrained")
        axes = figure.subplots()
        reflectance = np.where(spectrum.usable, spectrum.reflectance, np.nan)
        axes.plot(spectrum.wavelength_nm, reflectance, color="black", linewidth=1)
        for name in ("ibd1000", "ibd2000"):
            _draw_depth(axes, spectrum.wavelength_nm, reflectance, columns, name, number)
        axes.text(1.02, 1.0, "\n".join(_index_lines(columns, number)), transform=axes.transAxes, va="top", fontsize=8)
        axes.set(title=spectrum.id, xlabel="wavelength [nm]", ylabel="reflectance")
        axes.legend(fontsize=8, frameon=False)
        yield figure


def _draw_depth(axes: Any, wavelength: Any, reflectance: Any, columns: Any, name: str, number: int) -> None:
    """The line of an integrated band depth, and what lies between it and the spectrum."""
    if name not in columns or np.isnan(columns[name].value[number]):
        return
    ends = np.array(INDICES[name].wavelengths_nm[:2])
    heights = np.interp(ends, wavelength, reflectance)
    inside = (wavelength >= ends[0]) & (wavelength <= ends[1])
    line = np.interp(wavelength[inside], ends, heights)
    axes.plot(ends, heights, "o--", markersize=4, linewidth=1, label=f"line of {INDICES[name].title}")
    axes.fill_between(wavelength[inside], reflectance[inside], line, alpha=0.2)


def _index_lines(columns: Mapping[str, IndexColumn], number: int) -> Iterator[str]:
    for name, column in columns.items():
        unit = "" if INDICES[name].unit == "-" else f" {INDICES[name].unit}"
        known = column.status[number] == OK
        value = f"{column.value[number]:.3g} ± {column.sigma[number]:.1g}{unit}" if known else "-"
        yield f"{INDICES[name].title}: {value}"
