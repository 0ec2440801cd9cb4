"""Composition of pyroxene and olivine from the measured bands of a spectrum, and the picture of the band centres.

Wo and Fs of pyroxene are found by turns (Gaffey et al. 2002, Asteroids III, 183): which of three lines gives Wo from
the 1 um centre depends on Fs, and which of four gives Fs from the 2 um centre on Wo. One starts with the line for Fs
25-50 and goes to and fro until the lines no longer change.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from lunarsci.spectra.bands import BandResult, SpectrumBands
from lunarsci.spectra.chemistry.plane import OLIVINE_NM, Anchor, Regression, anchors, objection, regressions

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_START = "wo_gaffey_c"
_TURNS = 12
"""There are twelve pairs of lines: whoever has not arrived by then never will."""


@dataclass(frozen=True, slots=True)
class GaffeyPair:
    """The two lines arrived at; `settled` is False where they alternate, or where Fs exceeds all of them."""

    wo: Regression
    fs: Regression
    settled: bool


def gaffey_pair(bc1000_nm: float, bc2000_nm: float) -> GaffeyPair:
    """The lines for Wo and Fs that agree with each other at these centres. [nm]"""
    wo_lines, fs_lines = _lines("wo"), _lines("fs")
    wo_line = regressions()[_START]
    fs_line = fs_lines[0]
    for _ in range(_TURNS):
        wo = wo_line.value(bc1000_nm)
        fs_line = next(line for line in fs_lines if line.when[0] <= wo < line.when[1])
        fs = fs_line.value(bc2000_nm)
        following = next((line for line in wo_lines if line.when[0] <= fs < line.when[1]), None)
        if following is None or following is wo_line:
            return GaffeyPair(wo_line, fs_line, settled=following is not None)
        wo_line = following
    return GaffeyPair(wo_line, fs_line, settled=False)


def _lines(quantity: str) -> list[Regression]:
    return [line for key, line in regressions().items() if key.startswith(f"{quantity}_gaffey")]


@dataclass(frozen=True, slots=True, kw_only=True)
class CompositionEstimate:
    """A quantity by one regression.

    Attributes
    ----------
    quantity : `fs`, `wo`, `en`, `fo`, `fa`; `ol_share` and `opx_share` of olivine and pyroxene together.
    unit : `mol %`, or `-` for a share.
    value, sigma : with its standard deviation: error of the band and scatter of the regression. [unit]
    in_range : whether the regression may be used here, as far as the bands can tell.
    reason : why not; empty where it may.
    domain : rocks that the regression was made for, which bands cannot tell: nobody but the user knows.
    caveat : what is not in the error.
    source : entry of `sources.toml`.
    """

    quantity: str
    unit: str
    value: float
    sigma: float
    in_range: bool
    reason: str
    domain: str
    caveat: str
    source: str

    def to_dict(self) -> dict[str, Any]:
        """The attributes by name."""
        return asdict(self)


KEYS = (
    *("fs_gaffey", "wo_gaffey", "en_gaffey"),
    *("fs_burbine_bc1000", "fs_burbine_bc2000", "wo_burbine_bc1000", "wo_burbine_bc2000"),
    *("fs_trend_bc1000", "fs_trend_bc2000"),
    *("fs_dunn", "fa_dunn", "ol_dunn"),
    *("opx_cloutis", "fo_bc1000"),
)
"""What `chemistry` may hold, in this order."""
NM_PER_KELVIN = {"bc2000": 0.2, "bc1000": 0.0}
"""Shift of the band centres of ordinary chondrites with temperature, Sanchez et al. (2012), Icarus 220, 36,
10.1016/j.icarus.2012.04.008: BC2000 at 300 K is BC2000 + 60 nm - 0.2 nm/K T, BC1000 hardly moves."""
RATIO_PER_KELVIN = -0.00075
"""The same of the area ratio: at room temperature it is ratio + 0.00075 T - 0.23."""

Predictors = Mapping[str, tuple[float, float]]


def chemistry(measured: SpectrumBands) -> dict[str, CompositionEstimate]:
    """Estimates by key, of those regressions whose bands are there.

    The error of a centre is its standard error, half the spread over the continua and the calibration's share, added
    in quadrature. The kind of rock that a regression holds for, which bands cannot tell, is its domain.
    """
    one, two = measured.bands["1000"], measured.bands["2000"]
    if one.center_nm is None:
        return {}
    predictors = _predictors(one, two)
    ratio = (two.depth or 0.0) / one.depth if one.depth else 0.0
    found = from_centres(predictors, ratio)
    conic = {key for key, band in (("bc1000", one), ("bc2000", two)) if band.continuum == "conic"}
    return {key: _told(item, conic) if key in _CENTRED else item for key, item in found.items()}


_CENTRED = frozenset(key for key in KEYS if key not in ("ol_dunn", "opx_cloutis"))


def from_centres(predictors: Predictors, depth_ratio: float = 0.0) -> dict[str, CompositionEstimate]:
    """Estimates by key from (value, standard deviation) of `bc1000`, `bc2000` [nm], `bar` [-] or the olivine bands.

    `depth_ratio` is the depth of the 2 um band over that of the 1 um band.
    """
    found = {
        key: _estimate(line, predictors, depth_ratio)
        for key, line in regressions().items()
        if "gaffey" not in key and line.predictor in predictors
    }
    if {"bc1000", "bc2000"} <= predictors.keys():
        found = _gaffey(predictors, depth_ratio) | found
    return found


def error_nm(band: BandResult) -> float:
    """Standard error, half the spread over the continua and the calibration's share of a centre together. [nm]"""
    parts = (band.center_sigma_nm, band.center_systematic_nm, band.center_calibration_nm)
    return math.hypot(*(part or 0.0 for part in parts))


def _predictors(one: BandResult, two: BandResult) -> dict[str, tuple[float, float]]:
    predictors = {}
    for key, band in (("bc1000", one), ("bc2000", two)):
        if band.center_nm is not None:
            predictors[key] = (band.center_nm, error_nm(band))
    if one.area_nm and two.area_nm and one.area_nm > 0 and two.area_nm > 0:
        ratio = two.area_nm / one.area_nm
        shares = [
            (error or 0.0) / area
            for band, area in ((one, one.area_nm), (two, two.area_nm))
            for error in (band.area_sigma_nm, band.area_calibration_nm)
        ]
        predictors["bar"] = (ratio, ratio * math.hypot(*shares))
    return predictors


def _estimate(line: Regression, predictors: Predictors, depth_ratio: float, more: str = "") -> CompositionEstimate:
    x, sigma = predictors[line.predictor]
    value = line.value(x)
    centre = predictors.get("bc1000", (math.nan, 0.0))[0]
    second = predictors["bc2000"][0] if "bc2000" in predictors else None
    reason = objection(line.place, centre, second, depth_ratio) or line.objection(value) or more
    return CompositionEstimate(
        quantity=line.quantity,
        unit=line.unit,
        value=value,
        sigma=line.sigma(x, sigma),
        in_range=not reason,
        reason=reason,
        domain=line.domain,
        caveat=_temperature(line, x),
        source=line.source,
    )


def _temperature(line: Regression, x: float) -> str:
    """What 100 K do, which is not corrected."""
    rate = RATIO_PER_KELVIN if line.predictor == "bar" else NM_PER_KELVIN.get(line.predictor)
    if rate is None:
        return "not corrected for temperature"
    if rate == 0.0:
        return "not corrected for temperature, which hardly moves this band"
    change, unit = 100 * rate * line.slope(x), "" if line.unit == "-" else f" {line.unit}"
    return f"not corrected for temperature: 100 K above the laboratory's add about {change:+.2g}{unit}"


def _gaffey(predictors: Predictors, depth_ratio: float) -> dict[str, CompositionEstimate]:
    pair = gaffey_pair(predictors["bc1000"][0], predictors["bc2000"][0])
    more = "" if pair.settled else "its lines for Fs and Wo do not agree on a pair"
    fs, wo = (_estimate(line, predictors, depth_ratio, more) for line in (pair.fs, pair.wo))
    value = 100 - fs.value - wo.value
    beyond = "" if 0 <= value <= 100 else "beyond 0-100"
    reason = fs.reason or wo.reason or beyond
    enstatite = CompositionEstimate(
        quantity="en",
        unit="mol %",
        value=value,
        sigma=math.hypot(fs.sigma, wo.sigma),
        in_range=not reason,
        reason=reason,
        domain=fs.domain,
        caveat=f"what Fs and Wo leave; {fs.caveat}",
        source=fs.source,
    )
    return {"fs_gaffey": fs, "wo_gaffey": wo, "en_gaffey": enstatite}


def _told(item: CompositionEstimate, conic: set[str]) -> CompositionEstimate:
    """The estimate with a word on the continuum where the conic was used."""
    if not conic:
        return item
    return replace(item, caveat=f"{item.caveat}; made under a continuum of straight lines, not under the conic as here")


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
COLORS = ("#0072B2", "#E69F00", "#D55E00")
OLIVINE_COLOR = "#009E73"


def plane_pages(measured: Sequence[SpectrumBands]) -> "Iterator[Figure]":
    """One page: 2 um centre over 1 um centre, fields and trend of the pyroxenes, olivine below, spectra with errors."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 7), layout="constrained")
    axes = figure.subplots()
    _draw_fields(axes)
    _draw_trend(axes)
    shown = [item for item in measured if item.bands["1000"].center_nm is not None]
    for item in shown:
        _draw_spectrum(axes, item, named=len(shown) <= MOST_NAMES)
    axes.set_xlim(*X_NM)
    axes.set_ylim(*Y_NM)
    axes.set_xlabel("centre of the 1 µm band [nm]")
    axes.set_ylabel("centre of the 2 µm band [nm]")
    axes.set_title(f"{len(shown)} of {len(measured)} spectra; bars: noise, continuum and calibration", fontsize=10)
    yield figure


def _draw_fields(axes: Any) -> None:
    from matplotlib.patches import Polygon

    for (name, corners, place), color in zip(FIELDS, COLORS, strict=True):
        axes.add_patch(Polygon(corners, closed=True, facecolor=color, alpha=0.12, edgecolor="none"))
        axes.annotate(name, place, fontsize=8, color=color)
    low, high = OLIVINE_NM
    axes.axvspan(low, high, ymax=0.075, facecolor=OLIVINE_COLOR, alpha=0.2)
    axes.text((low + high) / 2, BELOW_NM + 30, "olivine\n(no 2 µm band)", ha="center", fontsize=8, color=OLIVINE_COLOR)
    axes.axhline(Y_NM[0] + 0.075 * (Y_NM[1] - Y_NM[0]), color="0.8", linewidth=0.8)
    axes.text(X_NM[0] + 2, BELOW_NM, "no 2 µm band", va="center", fontsize=8, color="0.5")


def _draw_trend(axes: Any) -> None:
    poor = [anchor for anchor in anchors() if anchor.wo == 0]
    rich = [anchor for anchor in anchors() if anchor.wo > 0]
    for items in (poor, rich):
        axes.plot(*_centres(items), "o-", color="0.55", markersize=4, linewidth=1, zorder=1)
        for anchor in items:
            text = f"Fs {anchor.fs:g}" if anchor.wo == 0 else f"Wo {anchor.wo:g}"
            axes.annotate(
                text, (anchor.bc1000_nm, anchor.bc2000_nm), xytext=(-6, 2), textcoords="offset points",
                ha="right", fontsize=7, color="0.45",
            )  # fmt: skip


def _centres(items: Sequence[Anchor]) -> tuple[list[float], list[float]]:
    return [item.bc1000_nm for item in items], [item.bc2000_nm for item in items]


def _draw_spectrum(axes: Any, item: SpectrumBands, *, named: bool) -> None:
    one, two = item.bands["1000"], item.bands["2000"]
    has_second = two.center_nm is not None
    x, y = one.center_nm, two.center_nm if has_second else BELOW_NM
    axes.errorbar(
        x, y, xerr=error_nm(one), yerr=error_nm(two) if has_second else None, fmt="o" if has_second else "v",
        color="black", markersize=4, linewidth=0.8, zorder=3,
    )  # fmt: skip
    if named:
        axes.annotate(item.id, (x, y), xytext=(5, 4), textcoords="offset points", fontsize=7, clip_on=True)
