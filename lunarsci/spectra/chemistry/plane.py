"""The regressions of `band_chemistry.csv`: a quantity from a band centre or an area ratio.

Each is used only where the two band centres lie in the part of their plane (Adams 1974, 10.1029/JB079i032p04829) that
it was made for. Answers are `Estimates` of many spectra, or a `CompositionEstimate` of one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.io.records import coded
from lunarsci.io.tables import table_rows

Texts: TypeAlias = npt.NDArray[np.object_]
"""Sentences, (m,)."""
TABLE = "band_chemistry.csv"
_NM_PER_UNIT = {"um": 1e3, "nm": 1.0, "-": 1.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class Regression:
    """A quantity y from a predictor x.

    Attributes
    ----------
    key, quantity, unit : name of the row; y and its unit.
    predictor : `bc1000`, `bc2000`, `m1_1`, `m2`, `m1_2` [nm] or `bar`, area of the 2 um band over the 1 um band's.
    scale : x in the regression is the predictor divided by this.
    inverse : whether it was made the other way round: x = c0 + c1 y instead of y = c0 + c1 x + c2 x^2.
    coefficients : c0, c1, c2.
    error : standard deviation about it that its authors give, of y, or of x where it is inverse.
    error_relab : root mean square error of y on the minerals of RELAB, or its ordinary chondrites, for which it says
        that it may be used; 0 where there are fewer than five.
    low, high : range of y it was made for.
    excluded : range of y within that where it does not hold, or None.
    when : range of another quantity it was made for, the upper end not included; infinite where open.
    place : where in the plane of the two centres it belongs (`lunarsci.spectra.chemistry.plane`).
    domain, source : what it was made on; entry of `sources.toml`.
    """

    key: str
    quantity: str
    unit: str
    predictor: str
    scale: float
    inverse: bool
    coefficients: tuple[float, float, float]
    error: float
    error_relab: float
    low: float
    high: float
    excluded: tuple[float, float] | None
    when: tuple[float, float]
    place: str
    domain: str
    source: str

    def value(self, predictor: Any) -> Any:
        """y at a predictor. [unit]"""
        c0, c1, c2 = self.coefficients
        x = predictor / self.scale
        return (x - c0) / c1 if self.inverse else c0 + c1 * x + c2 * x**2

    def slope(self, predictor: Any) -> Any:
        """dy by d predictor. [unit/nm, or unit for a ratio]"""
        _, c1, c2 = self.coefficients
        return (1 / c1 if self.inverse else c1 + 2 * c2 * predictor / self.scale) / self.scale

    def sigma(self, predictor: Any, predictor_sigma: Any) -> Any:
        """Standard deviation of y: error of the predictor and scatter about the regression, independent. [unit]

        The scatter is the authors' or that on RELAB, whichever is larger.
        """
        published = self.error / abs(self.coefficients[1]) if self.inverse else self.error
        return np.hypot(self.slope(predictor) * predictor_sigma, max(published, self.error_relab))

    def objections(self, value: FloatArray) -> Texts:
        """Why values, (m,), are outside the range of the regression; empty where they are inside."""
        beyond = ~((self.low <= value) & (value <= self.high))
        texts = np.where(beyond, f"beyond the {self.low:g}-{self.high:g} it was made for", "").astype(object)
        if self.excluded is not None:
            low, high = self.excluded
            within = ~beyond & (low < value) & (value < high)
            texts[within] = f"between {low:g} and {high:g}, which its authors exclude"
        return texts


@cache
def regressions() -> Mapping[str, Regression]:
    """All regressions by key."""
    return {row["key"]: _regression(row) for row in table_rows(TABLE)}


def _regression(row: Mapping[str, str]) -> Regression:
    excluded = (float(row["excluded_low"]), float(row["excluded_high"])) if row["excluded_low"] else None
    return Regression(
        key=row["key"],
        quantity=row["quantity"],
        unit=row["unit"],
        predictor=row["predictor"],
        scale=_NM_PER_UNIT[row["predictor_unit"]],
        inverse=row["form"] == "inverse",
        coefficients=(float(row["c0"]), float(row["c1"]), float(row["c2"])),
        error=float(row["error"]),
        error_relab=float(row["error_relab"] or 0),
        low=float(row["low"]),
        high=float(row["high"]),
        excluded=excluded,
        when=(float(row["when_low"] or -math.inf), float(row["when_high"] or math.inf)),
        place=row["place"],
        domain=row["domain"],
        source=row["source"],
    )


PLANE_TABLE = "pyroxene_plane.csv"
OLIVINE_NM = (1046.0, 1090.0)
"""Minimum of the 1 um band of 26 olivines, Fo 92-0; measured on RELAB and USGS spectra, upper hull."""
CPX_NM = 1016.0
"""From here on, Wo about 30, the centres no longer tell clinopyroxenes apart by calcium: they scatter about the end of
the trend; measured as the trend was."""
PYROXENE_TOLERANCE_NM = 30.0
"""How far the 1 um centre of a pyroxene may lie from the trend; measured in
`tests/spectra/chemistry/test_laboratory.py`."""
OPX_LINE = (5.81, -3425.0)
"""2 um centre of synthetic orthopyroxenes by that at 1 um: 5.81 BC1000 - 3425 nm; measured as the trend was."""
OPX_TOLERANCE_NM = 60.0
"""How far a 2 um centre may lie from that line; assumed."""
OPX_MOST_FS = 55.0
"""Fs of an orthopyroxene from which the lines of Gaffey et al. must not be used, which end at Fs 50; assumed."""
OPX_MOST_NM = 2065.0
"""2 um centre of synthetic ferrosilite, the most that an orthopyroxene has; measured as the line was."""
OLIVINE_SHIFT_NM = 8.0
"""Olivine moves the 1 um centre of a mixture above that of its pyroxene by at least this much; assumed."""
WEAK_SHARE = 0.1
"""Depth of the 2 um band over that of the 1 um band below which the rock may be olivine; assumed. Of 26 olivines one
exceeds it, by a trace of pyroxene."""


@dataclass(frozen=True, slots=True)
class Anchor:
    """Band centres of a synthetic pyroxene. [nm, mol %]"""

    bc1000_nm: float
    bc2000_nm: float
    fs: float
    wo: float


@cache
def anchors() -> tuple[Anchor, ...]:
    """The anchors of the trend, orthopyroxenes first."""
    names = ("bc1000_nm", "bc2000_nm", "fs", "wo")
    return tuple(Anchor(*(float(row[name]) for name in names)) for row in table_rows(PLANE_TABLE))


def objections(place: str, bc1000_nm: FloatArray, bc2000_nm: FloatArray, depth_ratio: FloatArray) -> Texts:
    """Why spectra do not lie where a regression was made; empty where they do. (m,)

    Parameters
    ----------
    place : `pyroxene`, `orthopyroxene`, `hed`, `olivine`, `mixture`, or `any`; of a `chondrite` the law of
        `lunarsci.spectra.chemistry.bands` judges.
    bc1000_nm, bc2000_nm : band centres, (m,); NaN where there is no such band. [nm]
    depth_ratio : depth of the 2 um band over that of the 1 um band, 0 where there is none, (m,). [-]
    """
    texts = np.full(bc1000_nm.shape, "", object)
    if place in ("any", "chondrite"):
        return texts
    if place == "olivine":
        low, high = OLIVINE_NM
        texts[~((low <= bc1000_nm) & (bc1000_nm <= high))] = f"the 1 µm centre is not between {low:g} and {high:g} nm"
        texts[depth_ratio > WEAK_SHARE] = "there is a 2 µm band: pyroxene"
        return texts
    there = ~np.isnan(bc2000_nm)
    texts[~there] = "there is no 2 µm band"
    texts[there] = _JUDGES[place](bc1000_nm[there], bc2000_nm[there])
    return texts


def _no_pyroxene(bc1000_nm: FloatArray, bc2000_nm: FloatArray) -> Texts:
    off = _off_trend(bc1000_nm, bc2000_nm)
    iron = regressions()["fs_trend_bc2000"].value(bc2000_nm)
    texts = np.full(off.shape, "", object)
    rich = (_no_orthopyroxene(bc1000_nm, bc2000_nm) == "") & (iron > OPX_MOST_FS)
    end = "and the lines end at 50"
    texts[rich] = [f"the centres are those of an orthopyroxene with Fs {share:.0f}, {end}" for share in iron[rich]]
    far = np.abs(off) > PYROXENE_TOLERANCE_NM
    texts[far] = [_where(one) for one in off[far]]
    return texts


def one_pyroxene(centres_nm: Sequence[float], errors_nm: Sequence[float]) -> bool:
    """Whether centres at 1 and 2 um, with standard errors, may be those of one pyroxene alone, of any iron and calcium.

    The 1 um centre must lie by the trend, at a 2 um centre within its error of that measured; both as near as pyroxenes
    do or as their errors let them. [nm]
    """
    (one, two), (error, second_error) = centres_nm, errors_nm
    seconds = two + second_error * np.array([-1.0, 0.0, 1.0])
    ends = [anchor.bc2000_nm for anchor in anchors()]
    beyond = two - min(max(two, min(ends)), max(ends))
    off = float(np.abs(_off_trend(np.full(3, one), seconds)).min())
    far = math.hypot(OPX_TOLERANCE_NM, second_error)
    return off <= math.hypot(PYROXENE_TOLERANCE_NM, error) and abs(beyond) <= far


def _no_orthopyroxene(bc1000_nm: FloatArray, bc2000_nm: FloatArray) -> Texts:
    off = bc2000_nm - OPX_LINE[0] * bc1000_nm - OPX_LINE[1]
    return _text_where(np.abs(off) > OPX_TOLERANCE_NM, "the two centres are not those of an orthopyroxene")


def _no_hed(bc1000_nm: FloatArray, bc2000_nm: FloatArray) -> Texts:
    """The regressions of both bands must agree, within three times their errors."""
    apart = np.zeros(bc1000_nm.shape, bool)
    for quantity in ("fs", "wo"):
        one, two = (regressions()[f"{quantity}_burbine_{key}"] for key in ("bc1000", "bc2000"))
        apart |= np.abs(one.value(bc1000_nm) - two.value(bc2000_nm)) > 3 * math.hypot(one.error, two.error)
    return _text_where(apart, "the two centres are not those of a howardite, eucrite or diogenite")


def _no_mixture(bc1000_nm: FloatArray, bc2000_nm: FloatArray) -> Texts:
    """What is no mixture of olivine and low-calcium pyroxene."""
    texts = _text_where(bc2000_nm > OPX_MOST_NM, "the 2 µm band is that of clinopyroxene")
    texts[bc1000_nm > OLIVINE_NM[0]] = "the 1 µm band is that of olivine or augite"
    texts[_off_trend(bc1000_nm, bc2000_nm) < OLIVINE_SHIFT_NM] = "the two centres are those of pyroxene without olivine"
    return texts


def _text_where(where: BoolArray, text: str) -> Texts:
    return np.where(where, text, "").astype(object)


_JUDGES = {
    "pyroxene": _no_pyroxene,
    "orthopyroxene": _no_orthopyroxene,
    "hed": _no_hed,
    "mixture": _no_mixture,
}


def _where(off_nm: float) -> str:
    if off_nm > 0:
        return f"the 1 µm centre lies {off_nm:.0f} nm above the pyroxenes: olivine or several pyroxenes"
    return f"the 1 µm centre lies {-off_nm:.0f} nm below the pyroxenes"


def _off_trend(bc1000_nm: FloatArray, bc2000_nm: FloatArray) -> FloatArray:
    """1 um centres less the nearest that a pyroxene with this 2 um centre has, (m,). [nm]"""
    lower, upper = (np.interp(bc2000_nm, *branch) for branch in _branches())
    upper = np.where(bc2000_nm > _end(), np.maximum(upper, OLIVINE_NM[0]), upper)
    return bc1000_nm - np.clip(bc1000_nm, np.minimum(lower, upper), np.maximum(lower, upper))


def _end() -> float:
    return min(anchor.bc2000_nm for anchor in anchors() if anchor.bc1000_nm >= CPX_NM) - PYROXENE_TOLERANCE_NM


def _branches() -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """(2 um, 1 um) centres of orthopyroxenes, and of the way from Fs 20 to the calcium-rich end. [nm]"""
    poor = [anchor for anchor in anchors() if anchor.wo == 0]
    rich = [poor[1], *(anchor for anchor in anchors() if anchor.wo > 0)]
    rich = sorted(rich, key=lambda anchor: anchor.bc2000_nm)
    return _curve(poor), _curve(rich)


def _curve(items: list[Anchor]) -> tuple[FloatArray, FloatArray]:
    return np.array([item.bc2000_nm for item in items]), np.array([item.bc1000_nm for item in items])


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimates:
    """A quantity of m spectra by one regression; as `CompositionEstimate`, with arrays (m,).

    `present` says where its bands are there; elsewhere the others mean nothing.
    """

    quantity: str
    unit: str
    present: BoolArray
    value: FloatArray
    sigma: FloatArray
    reason: Texts
    domain: Texts
    caveat: Texts
    source: Texts

    @property
    def in_range(self) -> BoolArray:
        """Whether the regression may be used."""
        return np.asarray(self.reason == "", bool)

    @property
    def first_usable(self) -> int | None:
        """The first spectrum of which it may be used, None for none."""
        rows = np.flatnonzero(self.present & self.in_range)
        return int(rows[0]) if rows.size else None

    def columns(self) -> dict[str, Any]:
        """The attributes of `CompositionEstimate` by name, as columns of records."""
        texts = {name: coded(getattr(self, name)) for name in ("reason", "domain", "caveat", "source")}
        numbers = {"quantity": self.quantity, "unit": self.unit, "value": self.value, "sigma": self.sigma}
        return numbers | {"in_range": self.in_range} | texts

    def of(self, row: int) -> CompositionEstimate:
        """That of one spectrum."""
        return CompositionEstimate(
            quantity=self.quantity,
            unit=self.unit,
            value=float(self.value[row]),
            sigma=float(self.sigma[row]),
            in_range=not self.reason[row],
            reason=self.reason[row],
            domain=self.domain[row],
            caveat=self.caveat[row],
            source=self.source[row],
        )
