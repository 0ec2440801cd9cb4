"""Pictures of measured bands, of Modified Gaussian Model fits, several spectra to a page, and of indices."""

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.figure import BLUE, GREEN, PAGE_IN, PINK, VERMILION, as_label, headline, legend_below, page
from lunarsci.spectra.band_status import BANDS, with_errors
from lunarsci.spectra.bands import SpectrumBands
from lunarsci.spectra.indices import INDICES, OK, IndexColumn
from lunarsci.spectra.mgm.result import MgmFit, in_doubt
from lunarsci.spectra.spectrum import Spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONTINUUM_LOOKS = {
    "conic": {"color": BLUE, "linestyle": "--"},
    "hull": {"color": VERMILION, "linestyle": "-."},
    "linear": {"color": GREEN, "linestyle": ":"},
}
PER_PAGE, LONGEST, DOUBT_WIDTH = 6, 38, 52
"""Spectra of a page; letters of a name, and of a line about a doubt, that fit above a panel."""
INVISIBLE = 0.002
"""A band shallower than this in ln R is not drawn, so that the continuum stays visible."""
COLORS = {
    "olivine": GREEN,
    "orthopyroxene": BLUE,
    "clinopyroxene": VERMILION,
    "plagioclase": PINK,
    "any": "#999999",
}
"""Colours that remain distinct under colour-vision deficiency: Okabe & Ito (2008), Color Universal Design."""
DASHES: Any = {
    "olivine": "-.",
    "orthopyroxene": "--",
    "clinopyroxene": (0, (7, 2)),
    "plagioclase": ":",
    "any": (0, (6, 1, 1, 1, 1, 1)),
}
"""Lines of the same minerals, told apart in grey."""
OTHER = "0.3"
"""Colour of a mineral that has none of its own."""


def band_pages(measured: Sequence[SpectrumBands]) -> "Iterator[Figure]":
    """One page per six spectra: spectrum with continua above, continuum removed with the band centres below."""
    return _pages(measured, _draw_bands, heights=(1.0, 1.0))


def fit_pages(fits: Sequence[MgmFit], weak: Sequence[MgmFit] = ()) -> "Iterator[Figure]":
    """One page per six spectra: spectrum, model, continuum and each band above, the residual below.

    `weak` are those whose assemblage was taken by weak evidence.
    """
    doubtful = {id(fit) for fit in weak}

    def draw(upper: Any, lower: Any, fit: MgmFit) -> None:
        _draw_fit(upper, lower, fit)
        upper.set_title(_fit_title(fit, weak=id(fit) in doubtful))

    return _pages(fits, draw, heights=(3.0, 1.0))


def _pages(
    items: Sequence[Any],
    draw: Callable[[Any, Any, Any], None],
    heights: tuple[float, float],
) -> "Iterator[Figure]":
    total = -(-len(items) // PER_PAGE)
    for number in range(total):
        part = items[number * PER_PAGE : (number + 1) * PER_PAGE]
        columns = min(2, len(part))
        rows = -(-len(part) // columns)
        figure = page(3.1 * rows + 0.3 if columns > 1 else 4.4, PAGE_IN if columns > 1 else 5.4)
        panels = figure.subfigures(rows, columns, squeeze=False).ravel()
        for panel, item in zip(panels, part, strict=False):
            upper, lower = panel.subplots(2, 1, sharex=True, height_ratios=heights)
            draw(upper, lower, item)
        legend_below(figure, [panel.axes[0] for panel in panels[: len(part)]], 4 if columns > 1 else 3)
        if total > 1:
            headline(figure, f"page {number + 1} of {total}")
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
        look: Any = CONTINUUM_LOOKS[name]
        x, level, color = wavelength[inside], continua[name][inside], look["color"]
        upper.plot(x, level, **look, label=f"{name} continuum")
        lower.plot(x, item.reflectance[inside] / level, ".", markersize=2, color=color, alpha=0.4)
        lower.plot(x, smoothed[inside] / level, **(look | {"linewidth": 0.7, "alpha": 0.6}))
    for nm, curve in item.curves().values():
        lower.plot(nm, curve, color="black", linewidth=1.8)
    upper.plot([], [], color="black", linewidth=1.8, label="polynomials of the centre (below)")
    top = float(np.max(smoothed))
    upper.set_ylim(max(0.0, float(np.min(smoothed)) - 0.15 * top), 1.2 * top)
    lower.axhline(1, color="0.8", linewidth=0.8, zorder=0)
    # The numbers below the deepest band need room.
    lower.set_ylim(1 - 1.9 * _deepest(item), 1 + 0.35 * _deepest(item))
    _mark_centres(lower, item)
    upper.set_title(as_label(item.id, LONGEST))
    upper.set_ylabel("reflectance [-]")
    lower.set_ylabel("reflectance /\ncontinuum [-]")
    lower.set_xlabel("wavelength [nm]; centres: ± noise ± method")


def _mark_centres(axes: Any, item: SpectrumBands) -> None:
    for band in item.bands.values():
        if band.center_nm is None or band.depth is None:
            continue
        axes.errorbar(band.center_nm, 1 - band.depth, xerr=band.center_sigma_nm, fmt="v", color="black", markersize=5)
        depth = " ± ".join(with_errors(band.depth, band.depth_sigma, most=3))
        text = f"{band.centre_text}\ndepth {depth}"
        axes.annotate(
            text, (band.center_nm, 1 - band.depth), xytext=(0, -8), textcoords="offset points",
            ha="center", va="top", bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
        )  # fmt: skip


def _deepest(item: SpectrumBands) -> float:
    depths = [band.depth for band in item.bands.values() if band.depth]
    return max([0.05, *depths])


def _draw_fit(upper: Any, lower: Any, fit: MgmFit) -> None:
    wavelength, model = fit.wavelength_nm, fit.ln_model()
    upper.plot(wavelength, fit.reflectance, ".", color="0.6", markersize=3, label="measured")
    upper.plot(wavelength, np.exp(model), color="black", linewidth=1.2, label="model")
    upper.plot(wavelength, fit.continuum_reflectance, color="0.6", linewidth=0.8, label="continuum")
    named: set[str] = set()
    for band in fit.bands:
        label = None if band.mineral in named else ("visible and UV" if band.mineral == "any" else band.mineral)
        named.add(band.mineral)
        depth = band.curve(wavelength)
        curve = np.where(depth < -INVISIBLE, fit.continuum_reflectance * np.exp(depth), np.nan)
        look: Any = {"color": COLORS.get(band.mineral, OTHER), "linestyle": DASHES.get(band.mineral, "-")}
        upper.plot(wavelength, curve, label=label, **look)
    residual = 100 * (np.log(fit.reflectance) - model)
    lower.plot(wavelength, residual, color="black", linewidth=0.7)
    lower.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    upper.set_ylabel("reflectance [-]")
    lower.set_ylabel("residual of\nln R [%]")
    lower.set_xlabel("wavelength [nm]")
    top = max(float(fit.reflectance.max()), float(fit.continuum_reflectance.max()))
    upper.set_ylim(0.75 * float(fit.reflectance.min()), 1.08 * top)


def _fit_title(fit: MgmFit, *, weak: bool) -> str:
    ratio = fit.nbsr.get("um2")
    strength = f"\nNBSR at 2 µm {ratio.opx:.2f} ± {ratio.sigma:.2f}" if ratio else ""
    minerals = f"{fit.model.assemblage.name}{' (weak evidence)' if weak else ''}"
    lines = textwrap.wrap(in_doubt(fit.status), DOUBT_WIDTH)
    title = f"{as_label(fit.id, LONGEST)}\n{as_label(minerals, LONGEST)}, rms {100 * fit.rms_ln:.2f} %{strength}"
    return "\n".join([title, *(as_label(line, DOUBT_WIDTH) for line in lines)])


def index_pages(spectra: Sequence[Spectrum], columns: Mapping[str, IndexColumn]) -> "Iterator[Figure]":
    """A page a spectrum: spectrum, lines of the integrated band depths, and what is found."""
    for number, spectrum in enumerate(spectra):
        figure = page(4.2)
        axes = figure.subplots()
        reflectance = np.where(spectrum.usable, spectrum.reflectance, np.nan)
        axes.plot(spectrum.wavelength_nm, reflectance, color="black", linewidth=1)
        for name in ("ibd1000", "ibd2000"):
            _draw_depth(axes, spectrum.wavelength_nm, reflectance, columns, name, number)
        axes.text(1.02, 1.0, "\n".join(_index_lines(columns, number)), transform=axes.transAxes, va="top")
        axes.set(title=as_label(spectrum.id, 60), xlabel="wavelength [nm]", ylabel="reflectance [-]")
        legend_below(figure, axes, 2)
        yield figure


def _draw_depth(axes: Any, wavelength: Any, reflectance: Any, columns: Any, name: str, number: int) -> None:
    """The line of an integrated band depth, and what lies between it and the spectrum."""
    if name not in columns or np.isnan(columns[name].value[number]):
        return
    ends = np.array(INDICES[name].wavelengths_nm[:2])
    heights = np.interp(ends, wavelength, reflectance)
    inside = (wavelength >= ends[0]) & (wavelength <= ends[1])
    line = np.interp(wavelength[inside], ends, heights)
    first = name == "ibd1000"
    look: Any = {"color": BLUE if first else VERMILION, "linestyle": "--" if first else ":"}
    axes.plot(ends, heights, marker="o" if first else "s", markersize=4, label=f"line of {INDICES[name].title}", **look)
    axes.fill_between(wavelength[inside], reflectance[inside], line, color=look["color"], alpha=0.2, linewidth=0)


def _index_lines(columns: Mapping[str, IndexColumn], number: int) -> Iterator[str]:
    for name, column in columns.items():
        unit = "" if INDICES[name].unit == "-" else f" {INDICES[name].unit}"
        determined = column.status[number] == OK
        value = f"{column.value[number]:.3g} ± {column.sigma[number]:.1g}{unit}" if determined else "-"
        yield f"{INDICES[name].title}: {value}"
