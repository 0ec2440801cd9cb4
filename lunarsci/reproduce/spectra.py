"""The rock of Ding et al. (2024): which of its numbers follow from what they publish, and their figures 5b and 5c.

Neither its spectrum nor the band centres, ratios and modes made from it are published as numbers. Without a measured
spectrum only what concerns minerals and places can be checked; with spectra of boulders of Chang'E-4, fitted as they
fitted theirs, the averages too.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.figure import BLUE, VERMILION, headline
from lunarsci.ranges import refuse
from lunarsci.reproduce.numbers import Answer, Number, judged, published_value
from lunarsci.spectra.abundance.end_members import TABLE as END_MEMBERS
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.bands import SpectrumBands, measure_bands
from lunarsci.spectra.chemistry.bands import plane_pages
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM
from lunarsci.spectra.mgm.figure import fit_pages
from lunarsci.spectra.mgm.fit import SPREAD_CONTINUA, fit_continua, fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit
from lunarsci.spectra.origin.catalogue import TABLE as CRATERS
from lunarsci.spectra.origin.catalogue import azimuth_deg, distance_km, embedded_catalogue
from lunarsci.spectra.origin.composition import Composition, Rock
from lunarsci.spectra.origin.match import MatchSettings, RockMatch, match_rocks
from lunarsci.spectra.origin.prior import CHANG_E_4, PriorSettings
from lunarsci.spectra.spectrum import Spectrum, savitzky_golay_operator

SMOOTHED_POINTS = 41
"""Savitzky-Golay points of Ding et al. (2024)."""
OLIVINE, PYROXENES = "OL M1-2", ("OPX 1", "CPX 1")


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """Boulders and what the Modified Gaussian Model (olivine and two pyroxenes) and the band centres say of them.

    Attributes
    ----------
    bands : per boulder, centres under the conic of Ding et al. (2024).
    fits : per boulder, the fit with the default continuum.
    over_continua : per continuum, the fits that converged, of any boulder.
    smoothed : per boulder, the fit to its spectrum smoothed over 41 points.
    """

    bands: tuple[SpectrumBands, ...]
    fits: tuple[MgmFit, ...]
    over_continua: dict[str, tuple[MgmFit, ...]]
    smoothed: tuple[MgmFit, ...]


def boulders(spectra: Sequence[Spectrum]) -> list[Spectrum]:
    """Those with "rock" in their name, or all where none has it. Raises DataError for none."""
    refuse({"no spectrum of a boulder; give at least one": not spectra}, kind=DataError)
    return [spectrum for spectrum in spectra if "rock" in spectrum.id.lower()] or list(spectra)


def fit_rocks(spectra: Sequence[Spectrum], progress: Callable[[int, int], None] | None = None) -> Rocks:
    """Fit boulders, as measured under every continuum and smoothed under the default one.

    Raises DataError where not one of them can be fitted.
    """
    rounds = len(SPREAD_CONTINUA) + 1

    def report(done: int, total: int) -> None:
        if progress:
            progress(done, total // len(SPREAD_CONTINUA) * rounds)

    by_rock = fit_continua(spectra, lambda name: mgm_model(continuum=name), progress=report)
    smoothed = fit_spectra([_smoothed(spectrum) for spectrum in spectra], mgm_model())
    by_name = {name: _good([fits[name] for fits in by_rock]) for name in SPREAD_CONTINUA}
    text = f"none of the {len(spectra)} spectra of boulders can be fitted; see lunarsci spectra fit"
    refuse({text: not (by_name[DEFAULT_CONTINUUM] and _good(smoothed))}, kind=DataError)
    return Rocks(
        bands=tuple(measure_bands(spectrum) for spectrum in spectra),
        fits=by_name[DEFAULT_CONTINUUM],
        over_continua={str(name): fits for name, fits in by_name.items()},
        smoothed=_good(smoothed),
    )


def _good(fits: Sequence[MgmFit | MgmFailure]) -> tuple[MgmFit, ...]:
    return tuple(fit for fit in fits if isinstance(fit, MgmFit) and fit.converged)


def _smoothed(spectrum: Spectrum) -> Spectrum:
    """Smoothed where it can be used; errors stay those of single channels, as a fit of the paper would have it."""
    usable = spectrum.usable
    values = np.array(spectrum.reflectance)
    values[usable] = savitzky_golay_operator(spectrum.wavelength_nm[usable], SMOOTHED_POINTS) @ values[usable]
    return replace(spectrum, reflectance=values)


def olivine_share(fit: MgmFit) -> float:
    """Strength of olivine's band near 1240 nm over that and the 1 um bands of the pyroxenes; NaN where all are 0. [-]

    Ding et al. (2024) do not say how their relative abundance of olivine is made; this one is assumed, and no fraction
    of the volume.
    """
    strength = {band.name: abs(band.strength) for band in fit.bands}
    total = strength[OLIVINE] + sum(strength[name] for name in PYROXENES)
    return strength[OLIVINE] / total if total > 0 else float("nan")


TABLES = (END_MEMBERS, CRATERS)
"""Embedded tables that the numbers rest on."""
LEAST_WO = 0.25
"""Wo from which a clinopyroxene counts as high in calcium: that of augites, above pigeonites and subcalcic augites
(Poldervaart & Hess 1951, J. Geol. 59, 472)."""
ZHINYU = (-45.34, 176.15)
"""Its place in the abstract of Ding et al. (2024). [deg]"""
MODE_SIGMA = 0.05
"""Of the modes made of the published averages: half of the published 20-30 % of olivine (Ding et al. 2024); assumed of
the others."""
LEAST_ROCKS = 6
"""Boulders from which an average or a range is held against the published one, which is that of six."""
NO_SPECTRUM = "needs measured spectra, which are not published with the paper; give spectra of boulders with --boulders"
MINERALS = "laboratory spectra of lunarsci, centres under the upper hull"


def _centres(mineral: str, least_wo: float = 0.0) -> FloatArray:
    """Centres of both bands of the embedded end members of a mineral, NaN where there is none. (n, 2) [nm]"""
    wavelength = np.arange(450.0, 2451.0, 5.0)
    members = [m for m in embedded_end_members(wavelength) if m.mineral == mineral and (m.wo or 0.0) >= least_wo]
    measured = [measure_bands(Spectrum(m.id, wavelength, m.reflectance), continuum_name="hull") for m in members]
    rows = [[item.bands[key].center_nm for key in ("1000", "2000")] for item in measured]
    return np.array(rows, dtype=float)


def low_calcium() -> FloatArray:
    """Band centres of the orthopyroxenes that come with lunarsci. (n, 2) [nm]"""
    return _centres("orthopyroxene")


def high_calcium() -> FloatArray:
    """Band centres of the clinopyroxenes with Wo 25 and more that come with lunarsci. (n, 2) [nm]"""
    return _centres("clinopyroxene", LEAST_WO)


def _minerals() -> dict[str, Answer]:
    def centre(values: FloatArray, name: str, more: str = "") -> Answer:
        finite = values[np.isfinite(values)]
        low, middle, high = (float(value) for value in np.percentile(finite, (2.5, 50, 97.5)))
        return Answer(value=middle, low=low, high=high, reason=f"median of {finite.size} {name}, {MINERALS}{more}")

    poor, rich = low_calcium(), high_calcium()
    names = "orthopyroxenes", f"clinopyroxenes with Wo {100 * LEAST_WO:.0f} and more"
    longest = f"; the longest is {np.nanmax(rich[:, 0]):.0f} nm, and centres beyond it are those of olivine"
    return {
        "lcp-1um": centre(poor[:, 0], names[0]),
        "lcp-2um": centre(poor[:, 1], names[0]),
        "hcp-1um": centre(rich[:, 0], names[1], longest),
        "hcp-2um": centre(rich[:, 1], names[1]),
    }


def _places() -> dict[str, Answer]:
    where = "great circle from the rock, 45.44 S 177.56 E, to 45.34 S 176.15 E"
    return {
        "zhinyu-distance": Answer(value=distance_km(CHANG_E_4, ZHINYU), reason=where),
        "zhinyu-azimuth": Answer(value=azimuth_deg(CHANG_E_4, ZHINYU), reason=where),
        "source-crater": _source(),
    }


def _published_rock() -> Rock:
    """The rock by the published averages: the middle of the range of olivine, pyroxenes as their mean ratio."""
    olivine = (published_value("olivine-low") + published_value("olivine-high")) / 200.0
    opx = published_value("opx-share") / 100.0
    modes = {
        "olivine": olivine,
        "orthopyroxene": (1.0 - olivine) * opx,
        "clinopyroxene": (1.0 - olivine) * (1.0 - opx),
    }
    return Rock("fin", Composition({name: (value, MODE_SIGMA) for name, value in modes.items()}))


def _source() -> Answer:
    def matched(prior: PriorSettings) -> RockMatch:
        return match_rocks([_published_rock()], embedded_catalogue(), CHANG_E_4, MatchSettings(prior=prior))[0]

    default, undisturbed = matched(PriorSettings()), matched(PriorSettings(re_excavation=False))
    posterior, alone = ({one.crater.name: one.posterior for one in match.craters} for match in (default, undisturbed))
    ranks = [sorted(each, key=lambda name: -each[name]).index("Zhinyu") + 1 for each in (posterior, alone)]
    factors = [item.ln_bayes_factor for item in default.craters if not item.contains_site]
    return Answer(
        value=float(ranks[0]),
        determined=False,
        low=float(min(ranks)),
        high=float(max(ranks)),
        reading="buried ejecta are dug up again",
        reason="the modes of Zhinyu's ejecta are in the supplement, and composition hardly decides (ln Bayes factors "
        f"within {max(factors) - min(factors):.1f}); posterior Zhinyu {posterior['Zhinyu']:.2f}, Finsen "
        f"{posterior['Finsen']:.2f}; if nothing buried came up again, Zhinyu {alone['Zhinyu']:.2f}",
    )


def _opx(fits: Sequence[MgmFit]) -> float | None:
    """Mean share of orthopyroxene in the strengths at 2 um, of the boulders that tell it. [%]"""
    ratios = [fit.nbsr["um2"].opx for fit in fits if fit.nbsr["um2"]]
    return 100.0 * float(np.mean(ratios)) if ratios else None


def _boulders(rocks: Rocks | None) -> dict[str, Answer]:
    if rocks is None:
        nothing = Answer(value=None, reason=NO_SPECTRUM)
        return dict.fromkeys(("mgm-rms", "opx-share", "olivine-low", "olivine-high"), nothing)
    return {
        "mgm-rms": _rms(rocks),
        "opx-share": _share(rocks),
        "olivine-low": _olivine(rocks, np.nanmin),
        "olivine-high": _olivine(rocks, np.nanmax),
    }


def _rms(rocks: Rocks) -> Answer:
    values = [100.0 * fit.rms_ln for fit in rocks.smoothed]
    raw = [100.0 * fit.rms_ln for fit in rocks.fits]
    holds = "holds" if min(values) <= published_value("mgm-rms") <= max(values) else "does not hold"
    several = len(raw) > 1
    given = f"the median of {_count(rocks)}, whose range {holds} the published value" if several else rocks.fits[0].id
    return Answer(
        value=float(np.median(values)),
        determined=False,
        low=min(values) if several else None,
        high=max(values) if several else None,
        reading=f"rms of ln R of spectra smoothed over {SMOOTHED_POINTS} points before the fit",
        reason=f"the spectrum, D41N240, is not published; the example is {given}; as measured, not smoothed, the fit "
        f"leaves {min(raw):.2f}" + (f"-{max(raw):.2f} %" if several else " %"),
    )


def _count(rocks: Rocks) -> str:
    count = len(rocks.fits)
    return "1 boulder that was given" if count == 1 else f"{count} boulders that were given"


def _share(rocks: Rocks) -> Answer:
    values = {name: _opx(fits) for name, fits in rocks.over_continua.items()}
    shares = [value for value in values.values() if value is not None]
    share = _opx(rocks.fits)
    if share is None:
        return Answer(value=None, reason="the 2 µm bands of no boulder tell its pyroxenes apart")
    published = published_value("opx-share")
    inside = "within" if min(shares) <= published <= max(shares) else "outside of"
    smoothed = _opx(rocks.smoothed)
    return Answer(
        value=share,
        low=min(shares),
        high=max(shares),
        determined=len(rocks.fits) >= LEAST_ROCKS,
        reading=f"mean NBSR at 2 µm of {_count(rocks)}, not of the six of the paper",
        reason=f"range over {len(shares)} continua; the published value lies {inside} it; which continuum and "
        f"boulders it rests on is not published" + (f"; smoothed spectra give {smoothed:.0f}" if smoothed else ""),
    )


def _olivine(rocks: Rocks, end: Callable[[FloatArray], float]) -> Answer:
    by_name = [
        [100.0 * olivine_share(fit) for fit in fits] for name, fits in rocks.over_continua.items() if fits and name
    ]
    values = [float(end(np.array(row))) for row in by_name if np.isfinite(row).any()]
    return Answer(
        value=float(end(np.array([100.0 * olivine_share(fit) for fit in rocks.fits]))),
        low=min(values),
        high=max(values),
        determined=len(rocks.fits) >= LEAST_ROCKS,
        reading=f"strength of olivine's 1.24 µm band over it and pyroxene's 1 µm bands, of {_count(rocks)}",
        reason=f"range over {len(values)} continua; how the published share is defined is in the supplement",
    )


def spectra_numbers(rocks: Rocks | None = None) -> list[Number]:
    """Every number of the rock beside ours, in the order of the table.

    Parameters
    ----------
    rocks : fits of measured boulders; without them what rests on measured spectra is not determined.
    """
    return judged("spectra", _minerals() | _boulders(rocks) | _places())


PYROXENE_MARKS = (
    ("low-calcium pyroxene", "lcp", low_calcium, BLUE, "o", "*"),
    ("high-calcium pyroxene", "hcp", high_calcium, VERMILION, "^", "P"),
)
PUBLISHED = "#c0392b"


def spectra_pages(rocks: Rocks | None) -> Iterator[Figure]:
    """The plane of the centres (Fig. 5b) and, with boulders, the fit of the one that fits best when smoothed (5c)."""
    yield _plane(rocks)
    if rocks is not None:
        best = min(rocks.smoothed, key=lambda fit: fit.rms_ln)
        measured = [fit for fit in rocks.fits if fit.id == best.id]
        smoothed = replace(best, id=f"{best.id} smoothed over {SMOOTHED_POINTS} points")
        for figure in fit_pages([smoothed, *measured]):
            headline(figure, "Olivine and two pyroxenes after Fig. 5c of Ding et al. (2024)")
            yield figure


def _plane(rocks: Rocks | None) -> Figure:
    """Fields and trend, the minerals behind them, what is published as about, and boulders where there are any."""
    figure = next(iter(plane_pages(rocks.bands if rocks else ())))
    axes = figure.axes[0]
    for name, key, centres, color, marker, star in PYROXENE_MARKS:
        plane = centres()
        axes.plot(*plane.T, marker, color=color, alpha=0.45, markersize=4, zorder=0.5, label=f"laboratory: {name}")
        about = published_value(f"{key}-1um"), published_value(f"{key}-2um")
        size = 15 if marker == "o" else 11
        label = f"published: about, {name}"
        axes.plot(*about, star, color=color, markeredgecolor=PUBLISHED, markersize=size, label=label)
    if rocks:
        axes.plot([], [], "o", color="black", markersize=4, label="boulders that were given")
    axes.set_xlim(885.0, np.nextafter(1110.0, 0))
    axes.legend(loc="upper left")
    given = (
        f"boulders' spectra given: {len(rocks.bands)}" if rocks else "no boulders: give their spectra with --boulders"
    )
    axes.set_title(f"Band centres after Fig. 5b of Ding et al. (2024); {given}")
    return figure
