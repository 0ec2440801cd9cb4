"""Composition of pyroxene and olivine from the measured bands of a spectrum, and the picture of the band centres.

Wo and Fs of pyroxene are found by turns (Gaffey et al. 2002, Asteroids III, 183): which of three lines gives Wo from
the 1 um centre depends on Fs, and which of four gives Fs from the 2 um centre on Wo. One starts with the line for Fs
25-50 and goes to and fro until the lines no longer change.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, IntArray
from lunarsci.figure import AMBER, BLUE, GREEN, VERMILION, as_label, name_points, page
from lunarsci.io.tables import table_rows
from lunarsci.spectra.band_status import BandColumns, BandResult
from lunarsci.spectra.bands import SpectrumBands, columns_of
from lunarsci.spectra.chemistry.plane import (
    OLIVINE_NM,
    Anchor,
    CompositionEstimate,
    Estimates,
    Regression,
    Texts,
    anchors,
    objections,
    regressions,
)
from lunarsci.spectra.continuum import CONIC

if TYPE_CHECKING:
    from matplotlib.figure import Figure
_START = "wo_gaffey_c"
_TURNS = 12
"""There are twelve pairs of lines: whoever has not arrived by then never will."""


def gaffey_pairs(bc1000_nm: FloatArray, bc2000_nm: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
    """The lines for Wo and Fs that agree with each other at these centres, (m,) each. [nm]

    Returns
    -------
    Places of the lines among those for Wo and for Fs, and whether they were arrived at: not where the lines alternate,
    or where Fs exceeds all of them.
    """
    wo_lines, fs_lines = lines_of("wo"), lines_of("fs")
    wo = np.full(bc1000_nm.shape, [line.key for line in wo_lines].index(_START))
    fs, settled, open_ = np.zeros_like(wo), np.zeros(wo.shape, bool), np.ones(wo.shape, bool)
    wo_values = np.array([line.value(bc1000_nm) for line in wo_lines])
    fs_values = np.array([line.value(bc2000_nm) for line in fs_lines])
    each = np.arange(wo.size)
    for _ in range(_TURNS):
        fs = np.where(open_, _line_for(wo_values[wo, each], fs_lines), fs)
        following = _line_for(fs_values[fs, each], wo_lines)
        settled |= open_ & (following == wo)
        open_ &= (following >= 0) & (following != wo)
        wo = np.where(open_, following, wo)
    return wo, fs, settled


def lines_of(quantity: str) -> list[Regression]:
    """Gaffey's lines for `wo` or `fs`, in the order of their places."""
    return [line for key, line in regressions().items() if key.startswith(f"{quantity}_gaffey")]


def _line_for(values: FloatArray, lines: Sequence[Regression]) -> IntArray:
    """Place of the line that was made for a value of the other quantity, -1 for none, (m,)."""
    fits = np.array([(line.when[0] <= values) & (values < line.when[1]) for line in lines])
    return np.where(fits.any(axis=0), np.argmax(fits, axis=0), -1)


KEYS = (
    *("fs_gaffey", "wo_gaffey", "en_gaffey"),
    *("fs_burbine_bc1000", "fs_burbine_bc2000", "wo_burbine_bc1000", "wo_burbine_bc2000"),
    *("fs_trend_bc1000", "fs_trend_bc2000"),
    *("fs_dunn", "fa_dunn", "ol_dunn"),
    *("fs_chondrite", "fa_chondrite", "ol_chondrite"),
    *("opx_cloutis", "fo_bc1000"),
)
"""What `chemistry` may hold, in this order."""
NM_PER_KELVIN = {"bc2000": 0.2, "bc1000": 0.0}
"""Shift of the band centres of ordinary chondrites with temperature, Sanchez et al. (2012), Icarus 220, 36,
10.1016/j.icarus.2012.04.008: BC2000 at 300 K is BC2000 + 60 nm - 0.2 nm/K T, BC1000 hardly moves."""
RATIO_PER_KELVIN = -0.00075
"""The same of the area ratio, Sanchez et al. (2012): at room temperature it is ratio + 0.00075 T - 0.23."""
NO_AREAS = "needs the areas of both bands under hull or linear (--continuum)"
Predictors = Mapping[str, tuple[Any, Any]]


def chemistry(measured: SpectrumBands) -> dict[str, CompositionEstimate]:
    """Estimates by key, of those regressions whose bands are there; see `chemistries`."""
    result = chemistries(columns_of([measured]))
    return {key: item.of(0) for key, item in result.items() if item.present[0]}


def chemistries(bands: Mapping[str, BandColumns]) -> dict[str, Estimates]:
    """Estimates by key from the columns of both bands.

    The error of a centre is its standard error, half the spread over the continua and the calibration's share, added
    in quadrature. The kind of rock that a regression holds for, which bands cannot tell, is its domain.
    """
    one, two = bands["1000"], bands["2000"]
    there = np.isfinite(one.center_nm)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.nan_to_num(two.depth / one.depth, posinf=0.0, neginf=0.0)
    predictors = {
        "bc1000": (one.center_nm, errors_nm(one)),
        "bc2000": (np.where(there, two.center_nm, np.nan), errors_nm(two)),
        "bar": area_ratio(one, two),
    }
    result = estimates(predictors, ratio) | chondrites(bands)
    for line in regressions().values():
        if line.place == "chondrite":
            doubt, reason = result["fa_chondrite"].reason, result[line.key].reason
            reason[:] = np.where(doubt != "", doubt, reason)
            reason[np.isnan(bands_of_chondrites(bands)[0][:, 1])] = NO_AREAS
    used = (there & (one.continuum == CONIC)) | (np.isfinite(two.center_nm) & (two.continuum == CONIC))
    for key in _CENTRED & result.keys():
        result[key].caveat[used] += "; made under a continuum of straight lines, not under the conic as here"
    return {key: result[key] for key in KEYS if key in result}


_CENTRED = frozenset(KEYS) - {"ol_dunn", "opx_cloutis", "fs_chondrite", "fa_chondrite", "ol_chondrite"}


def errors_nm(band: BandColumns) -> FloatArray:
    """Standard error, half the spread over the continua and the calibration's share of centres together, (m,). [nm]"""
    parts = (band.center_sigma_nm, band.center_systematic_nm, band.center_calibration_nm)
    return np.asarray(np.sqrt(sum(np.nan_to_num(part) ** 2 for part in parts)))


def from_centres(predictors: Predictors, depth_ratio: float = 0.0) -> dict[str, CompositionEstimate]:
    """Estimates by key from (value, standard deviation) of `bc1000`, `bc2000` [nm], `bar` [-] or the olivine bands.

    `depth_ratio` is the depth of the 2 um band over that of the 1 um band.
    """
    rows = {key: (np.array([value], float), np.array([sigma], float)) for key, (value, sigma) in predictors.items()}
    return {key: item.of(0) for key, item in estimates(rows, np.array([depth_ratio])).items() if item.present[0]}


def estimates(predictors: Predictors, depth_ratio: FloatArray) -> dict[str, Estimates]:
    """`from_centres` of m spectra: (m,) each, NaN for a predictor that is not there."""
    places: dict[str, Texts] = {}
    nowhere = np.full(depth_ratio.shape, np.nan)
    first, second = (predictors.get(key, (nowhere, nowhere))[0] for key in ("bc1000", "bc2000"))

    def one(line: Regression) -> Estimates:
        if line.place not in places:
            places[line.place] = objections(line.place, first, second, depth_ratio)
        return _estimate(line, *predictors[line.predictor], places[line.place])

    made = {
        key: one(line) for key, line in regressions().items() if "gaffey" not in key and line.predictor in predictors
    }
    if {"bc1000", "bc2000"} <= predictors.keys():
        made = _gaffey(first, second, one) | made
    return made


def _estimate(line: Regression, x: FloatArray, sigma: FloatArray, objection: Texts) -> Estimates:
    value = line.value(x)
    return Estimates(
        quantity=line.quantity,
        unit=line.unit,
        present=np.isfinite(x),
        value=value,
        sigma=line.sigma(x, sigma),
        reason=np.where(objection != "", objection, line.objections(value)),
        domain=np.full(x.shape, line.domain, object),
        caveat=_temperature(line, x),
        source=np.full(x.shape, line.source, object),
    )


def _temperature(line: Regression, x: FloatArray) -> Texts:
    """What 100 K do, which is not corrected."""
    rate = RATIO_PER_KELVIN if line.predictor == "bar" else NM_PER_KELVIN.get(line.predictor)
    if not rate:
        more = "" if rate is None else ", which hardly moves this band"
        return np.full(x.shape, f"not corrected for temperature{more}", object)
    unit = "" if line.unit == "-" else f" {line.unit}"
    text = "not corrected for temperature: 100 K above the laboratory's add about"
    texts = [f"{text} {change:+.2g}{unit}" for change in np.atleast_1d(100 * rate * line.slope(x)).tolist()]
    return np.broadcast_to(np.array(texts, object), x.shape).copy()


def _gaffey(
    bc1000_nm: FloatArray, bc2000_nm: FloatArray, one: Callable[[Regression], Estimates]
) -> dict[str, Estimates]:
    wo_place, fs_place, settled = gaffey_pairs(bc1000_nm, bc2000_nm)
    wo, fs = (_chosen([one(line) for line in lines_of(q)], p) for q, p in (("wo", wo_place), ("fs", fs_place)))
    both = wo.present & fs.present
    for item in (wo, fs):
        item.present[:] = both
        item.reason[(item.reason == "") & ~settled] = "its lines for Fs and Wo do not agree on a pair"
    value = 100 - fs.value - wo.value
    beyond = np.where((value >= 0) & (value <= 100), "", "beyond 0-100").astype(object)
    reason = np.where(fs.reason != "", fs.reason, np.where(wo.reason != "", wo.reason, beyond))
    caveat = "what Fs and Wo leave; " + fs.caveat
    sigma = np.hypot(fs.sigma, wo.sigma)
    enstatite = replace(fs, quantity="en", unit="mol %", value=value, sigma=sigma, reason=reason, caveat=caveat)
    return {"fs_gaffey": fs, "wo_gaffey": wo, "en_gaffey": enstatite}


def _chosen(items: Sequence[Estimates], place: IntArray) -> Estimates:
    """For each spectrum what the line at a place says."""
    each = np.arange(place.size)
    names = ("present", "value", "sigma", "reason", "domain", "caveat", "source")
    parts: dict[str, Any] = {name: np.array([getattr(item, name) for item in items])[place, each] for name in names}
    return replace(items[0], **parts)


X_NM, Y_NM = (890.0, 1100.0), (1740.0, 2400.0)
BELOW_NM = 1765.0
"""Height at which spectra without a 2 um band are drawn."""
MOST_NAMES = 25
FIELDS = (
    (
        "orthopyroxene, Wo ≤ 5",
        ((905, 1810), (915, 1810), (953, 2055), (948, 2075), (938, 2055), (905, 1850)),
        (918, 1805),
    ),
    (
        "pigeonite, Wo 5-25",
        ((940, 1960), (948, 1898), (958, 1905), (1010, 2130), (1022, 2235), (1000, 2205), (962, 2115), (938, 1990)),
        (962, 1910),
    ),
    (
        "augite, Wo > 25",
        ((982, 2040), (1000, 2030), (1062, 2230), (1058, 2315), (1034, 2315), (1010, 2270)),
        (1040, 2140),
    ),
)
"""Name, corners and place of the name of each field. Drawn around RELAB pyroxenes of known composition, upper hull; 30
of 31, 24 of 27 and 24 of 24 lie inside. After Adams (1974) and Cloutis & Gaffey (1991), whose tables were not at hand.
"""
COLORS = (BLUE, AMBER, VERMILION)
OLIVINE_COLOR = GREEN


def plane_pages(measured: Sequence[SpectrumBands]) -> "Iterator[Figure]":
    """One page: 2 um centre over 1 um centre, fields and trend of the pyroxenes, olivine below, spectra with errors."""
    figure = page(5.6)
    axes = figure.subplots()
    _draw_fields(axes)
    _draw_trend(axes)
    shown = [item for item in measured if item.bands["1000"].center_nm is not None]
    centres = [_draw_spectrum(axes, item) for item in shown]
    axes.set_xlim(*X_NM)
    axes.set_ylim(*Y_NM)
    axes.set_xlabel("centre of the 1 µm band [nm]")
    axes.set_ylabel("centre of the 2 µm band [nm]")
    axes.set_title(f"{len(shown)} of {len(measured)} spectra; bars: noise, continuum and calibration")
    if len(shown) <= MOST_NAMES:
        named = [(as_label(item.id, 28), *centre) for item, centre in zip(shown, centres, strict=True)]
        name_points(figure, {axes: named})
    yield figure


def _draw_fields(axes: Any) -> None:
    from matplotlib.patches import Polygon

    for (name, corners, place), color in zip(FIELDS, COLORS, strict=True):
        axes.add_patch(Polygon(corners, closed=True, facecolor=color, alpha=0.12, edgecolor="none"))
        axes.annotate(name, place, color=color)
    low, high = OLIVINE_NM
    axes.axvspan(low, high, ymax=0.075, facecolor=OLIVINE_COLOR, alpha=0.2)
    axes.text((low + high) / 2, BELOW_NM + 30, "olivine\n(no 2 µm band)", ha="center", color=OLIVINE_COLOR)
    axes.axhline(Y_NM[0] + 0.075 * (Y_NM[1] - Y_NM[0]), color="0.8", linewidth=0.8)
    axes.text(X_NM[0] + 2, BELOW_NM, "no 2 µm band", va="center", color="0.35")


def _draw_trend(axes: Any) -> None:
    poor = [anchor for anchor in anchors() if anchor.wo == 0]
    rich = [anchor for anchor in anchors() if anchor.wo > 0]
    for items in (poor, rich):
        axes.plot(*_centres(items), "o-", color="0.55", markersize=4, linewidth=1, zorder=1)
        for anchor in items:
            text = f"Fs {anchor.fs:g}" if anchor.wo == 0 else f"Wo {anchor.wo:g}"
            axes.annotate(
                text, (anchor.bc1000_nm, anchor.bc2000_nm), xytext=(-6, 2), textcoords="offset points",
                ha="right", color="0.35",
            )  # fmt: skip


def _centres(items: Sequence[Anchor]) -> tuple[list[float], list[float]]:
    return [item.bc1000_nm for item in items], [item.bc2000_nm for item in items]


def _error_nm(band: BandResult) -> float:
    parts = (band.center_sigma_nm, band.center_systematic_nm, band.center_calibration_nm)
    return math.hypot(*(part or 0.0 for part in parts))


def _draw_spectrum(axes: Any, item: SpectrumBands) -> tuple[float, float]:
    """A dot with its errors; where it is."""
    one, two = item.bands["1000"], item.bands["2000"]
    has_second = two.center_nm is not None
    x, y = float(one.center_nm or np.nan), float(two.center_nm or BELOW_NM)
    axes.errorbar(
        x, y, xerr=_error_nm(one), yerr=_error_nm(two) if has_second else None, fmt="o" if has_second else "v",
        color="black", markersize=4, linewidth=0.8, zorder=3,
    )  # fmt: skip
    return x, y


TABLE = "chondrite_calibration.csv"
BANDS = ("bc2000_nm", "ln_area_ratio")
COMPOSITION = ("fa", "fs", "ol_share")
"""Of olivine and of orthopyroxene [mol %]; olivine in olivine and pyroxene, by volume [-]."""
SHRINKAGE = 0.3
"""Weight of no correlation in the covariance, for 15 rocks; with it errors of sample series left out are those stated:
measured, among 0, 0.15 and 0.3."""


@dataclass(frozen=True, slots=True, eq=False)
class ChondriteLaw:
    """Normal law of ordinary chondrites: mean (5,), covariance (5, 5) of `BANDS` and `COMPOSITION` in their units."""

    mean: FloatArray
    covariance: FloatArray

    def composition(self, bands: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of bands (m, 2) and their errors, NaN for none: `COMPOSITION` and its standard errors, (m, 3) each."""
        apart, inner = self._apart(bands, np.nan_to_num(errors))
        across = np.broadcast_to(self.covariance[:2, 2:], (len(bands), 2, len(COMPOSITION)))
        gain = np.asarray(np.linalg.solve(inner, across), np.float64).transpose(0, 2, 1)
        covariance = self.covariance[2:, 2:] - gain @ self.covariance[:2, 2:]
        value = self.mean[2:] + (gain @ apart[..., None])[..., 0]
        return value, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))

    def likeness(self, bands: FloatArray, olivine: FloatArray | None = None) -> FloatArray:
        """Share of ordinary chondrites whose bands lie farther from the mean than (m, 2), 1 of no bands, (m,).

        With `olivine`, its share in the mafic minerals by another way and the error of that, (m, 2), NaN for none, also
        by how far it lies from the share that the bands of an ordinary chondrite mean.
        """
        from scipy.special import chdtrc

        apart, inner = self._apart(bands, np.zeros_like(bands))
        square = np.sum(apart * np.linalg.solve(inner, apart[..., None])[..., 0], axis=1)
        count = np.maximum(np.isfinite(bands).sum(axis=1), 1)
        if olivine is not None:
            (value, sigma), place = self.composition(bands, np.zeros_like(bands)), COMPOSITION.index("ol_share")
            off = (olivine[:, 0] - value[:, place]) ** 2 / (olivine[:, 1] ** 2 + sigma[:, place] ** 2)
            square, count = square + np.nan_to_num(off), count + np.isfinite(off)
        return np.asarray(chdtrc(count, square))

    def _apart(self, bands: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x - m_x, (m, 2), and S_xx + E, (m, 2, 2); a band that is not there has an endless error."""
        there = np.isfinite(bands)
        errors_squared = np.where(there, errors**2, 1e12)[:, None, :] * np.eye(2)
        return np.where(there, bands - self.mean[:2], 0.0), self.covariance[:2, :2] + errors_squared


def learn_law(samples: FloatArray, rocks: Sequence[str], groups: Sequence[str]) -> ChondriteLaw:
    """Law of spectra (n, 5), NaN for what is not known.

    The spectra of a rock, the rocks of a group (H, L, LL) and the groups count alike: which of them a laboratory has
    measured most says nothing of the next.
    """
    weight = np.ones(len(samples))
    for names in (np.array(rocks), np.array(groups)):
        for name in np.unique(names):
            weight[names == name] /= weight[names == name].sum()
    there = np.isfinite(samples)
    part = weight[:, None] * there
    mean = np.sum(part * np.where(there, samples, 0.0), axis=0) / part.sum(axis=0)
    apart = np.where(there, samples - mean, 0.0)
    raw = (weight[:, None] * apart).T @ apart / (part.T @ there)
    return ChondriteLaw(mean, (1.0 - SHRINKAGE) * raw + SHRINKAGE * np.diag(np.diagonal(raw)))


@cache
def embedded_law() -> ChondriteLaw:
    """That of `chondrite_calibration.csv`."""
    rows = table_rows(TABLE)
    covariance = [[float(row[name]) for name in (*BANDS, *COMPOSITION)] for row in rows]
    return ChondriteLaw(np.array([float(row["mean"]) for row in rows]), np.array(covariance))


def area_ratio(one: BandColumns, two: BandColumns) -> tuple[FloatArray, FloatArray]:
    """Area of the 2 um band over that of the 1 um band, and its standard error; NaN where either is not above 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        good = (one.area_nm > 0) & (two.area_nm > 0)
        ratio = np.where(good, two.area_nm / one.area_nm, np.nan)
        parts = [np.nan_to_num(e / b.area_nm) for b in (one, two) for e in (b.area_sigma_nm, b.area_calibration_nm)]
    return ratio, ratio * np.sqrt(sum(part**2 for part in parts))


def bands_of_chondrites(bands: Mapping[str, BandColumns]) -> tuple[FloatArray, FloatArray]:
    """2 um centre [nm] and logarithm of the area ratio [-], and their standard errors, (m, 2) each; NaN for none.

    Areas under the conic are others, and count as none. What the centre differs by between continua is in the law.
    """
    one, two = bands["1000"], bands["2000"]
    ratio, error = area_ratio(one, two)
    ratio = np.where((one.continuum == CONIC) | (two.continuum == CONIC), np.nan, ratio)
    centre = np.hypot(np.nan_to_num(two.center_sigma_nm), np.nan_to_num(two.center_calibration_nm))
    return np.stack([two.center_nm, np.log(ratio)], axis=1), np.stack([centre, error / ratio], axis=1)


def chondrites(bands: Mapping[str, BandColumns], olivine: FloatArray | None = None) -> dict[str, Estimates]:
    """What the law of ordinary chondrites says: `fa_chondrite`, `fs_chondrite`, `ol_chondrite`.

    `olivine` : as of `ChondriteLaw.likeness`.
    """
    result, errors = bands_of_chondrites(bands)
    law = embedded_law()
    values, sigmas = law.composition(result, errors)
    whose = "bands" if olivine is None else "bands and the share of olivine"
    objection = f"the {whose} are not those of an ordinary chondrite"
    reason = np.where(law.likeness(result, olivine) < SIGNIFICANCE, objection, "")
    caveat = "not corrected for temperature: 100 K above the laboratory's add 20 nm to the 2 µm centre"
    texts = {"domain": "an ordinary chondrite", "caveat": caveat, "source": "chondrite-bands"}
    return {
        f"{key}_chondrite": Estimates(
            quantity=quantity,
            unit="-" if quantity == "ol_share" else "mol %",
            present=np.isfinite(result[:, 0]),
            value=values[:, place],
            sigma=sigmas[:, place],
            reason=reason.astype(object),
            **{name: np.full(reason.shape, text, object) for name, text in texts.items()},
        )
        for place, (key, quantity) in enumerate((("fa", "fa"), ("fs", "fs"), ("ol", "ol_share")))
    }


def chondrite_record(result: Mapping[str, Estimates], row: int) -> dict[str, Any] | None:
    """The key `chondrite` of `lunarsci spectra unmix --json`: what a spectrum says if it is an ordinary chondrite's.

    `fa`, `fs` [mol %] and `olivine_in_mafic` [-], each with intervals; None where there is no 2 um band.
    """
    first = result["fa_chondrite"]
    if not first.present[row]:
        return None
    most = {"fa": 100.0, "fs": 100.0, "olivine_in_mafic": 1.0}
    values = {name: _with_intervals(one.of(row), most[name]) for name, one in zip(most, result.values(), strict=True)}
    return values | {"in_domain": not first.reason[row], "status": first.reason[row] or "if an ordinary chondrite"}


def _with_intervals(one: CompositionEstimate, most: float) -> dict[str, float]:
    from scipy.special import ndtri

    wide = float(ndtri(0.975))
    ends = {"low": -1.0, "high": 1.0, "low95": -wide, "high95": wide}
    return {"value": one.value} | {key: min(max(one.value + k * one.sigma, 0.0), most) for key, k in ends.items()}
