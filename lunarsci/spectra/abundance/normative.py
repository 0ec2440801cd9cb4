"""Normative plagioclase, FeO and TiO2 of a weathered lunar soil, by a regression on two numbers of its spectrum each.

No mineral is seen: iron and opaques darken, and pyroxene absorbs at 2 um, so that these numbers go with the composition
over the few soils that were measured. The norm is what the oxides would crystallise to. Never a mode of minerals.

    y = c0 + sum_k c_k (x_k - mean_k) / scale_k,   error s sqrt(1 + a^T H a),  a = (1, (x - mean) / scale)
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import BLUE
from lunarsci.io.tables import table_rows
from lunarsci.spectra.abundance.kinds import WINDOWS_NM, KindVerdict, spectral_features
from lunarsci.spectra.abundance.result import Bar, BarPanel, bar_pages
from lunarsci.spectra.spectrum import Spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE = "soil_normative.csv"
FEATURES = {"plagioclase_wt": ("darkness", "depth_2um"), "feo_wt": ("darkness", "depth_2um"),
            "tio2_wt": ("darkness", "blue")}  # fmt: skip
"""What each quantity, in per cent by weight of the soil, is regressed on."""
ORIGIN = 0.42
"""Of the angle `darkness`, after the titanium parameter of Lucey et al. (2000), whose ratio is at 415 nm."""
LEVELS = {"": 0.6827, "95": 0.95}
"""Probability of each interval, by the end of its names `low` and `high`."""


@dataclass(frozen=True, slots=True)
class NormativeValue:
    """A quantity of a soil, with intervals of 68 and 95 %, and whether it lies `within` those learned from. [wt %]"""

    value: float
    low: float
    high: float
    low95: float
    high95: float
    within: bool

    def to_dict(self) -> dict[str, float]:
        """Keys of `--json`."""
        return {name: getattr(self, name) for name in ("value", "low", "high", "low95", "high95")}


@dataclass(frozen=True, slots=True)
class Normative:
    """What a soil's spectrum says of its composition.

    Attributes
    ----------
    values : by `plagioclase_wt`, `feo_wt`, `tio2_wt`; none of what is no soil.
    in_domain : whether the soil lies within those learned from.
    status : a sentence; why not, where they are not.
    """

    values: Mapping[str, NormativeValue]
    in_domain: bool
    status: str

    def to_dict(self) -> dict[str, Any]:
        """The key `normative` of `lunarsci spectra unmix --json`."""
        records = {name: value.to_dict() for name, value in self.values.items()}
        return {name: records.get(name) for name in FEATURES} | {"in_domain": self.in_domain, "status": self.status}


@dataclass(frozen=True, slots=True, eq=False)
class SoilRegression:
    """One quantity of a soil from its features.

    Attributes
    ----------
    features : their names; `mean`, `scale` of those learned from, (f,).
    coefficients, spread : (f + 1,) and (f + 1, f + 1), c and H of the module's equation. [wt %, -]
    sigma : s, from soils whose mission was left out. [wt %]
    freedom : missions less coefficients.
    farthest : largest a^T H a of the soils learned from.
    """

    features: tuple[str, ...]
    mean: FloatArray
    scale: FloatArray
    coefficients: FloatArray
    spread: FloatArray
    sigma: float
    freedom: float
    farthest: float

    def at(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value [wt %] and a^T H a, (n,) each, of features (n, f)."""
        design = np.column_stack([np.ones(len(features)), (features - self.mean) / self.scale])
        return design @ self.coefficients, np.einsum("ni,ij,nj->n", design, self.spread, design)

    def estimate(self, features: FloatArray) -> NormativeValue:
        """With intervals of Student's t, within 0 and 100, which widen beyond what was learned from."""
        from scipy.special import stdtrit

        value, far = (float(item[0]) for item in self.at(features[None]))
        error = self.sigma * np.sqrt(1.0 + far)
        halves = {name: error * float(stdtrit(self.freedom, 0.5 + level / 2)) for name, level in LEVELS.items()}
        ends = {f"{end}{name}": float(np.clip(value + sign * half, 0.0, 100.0))
                for name, half in halves.items() for end, sign in (("low", -1), ("high", 1))}  # fmt: skip
        return NormativeValue(float(np.clip(value, 0.0, 100.0)), **ends, within=far <= self.farthest)


def soil_features(spectrum: Spectrum) -> dict[str, float]:
    """`darkness`, `depth_2um` and `blue` of a spectrum; NaN where channels are missing. [rad, -, -]

    darkness = arctan((R475 / R750 - 0.42) / R750) grows with opaques and iron, and little with weathering; `depth_2um`
    is ln R near 1960 nm less the mean of ln R near 1525 and 2300 nm; `blue` is ln R475 / R750.

    References
    ----------
    Lucey, Blewett & Jolliff (2000), J. Geophys. Res. 105, 20297, 10.1029/1999JE001117 (the angle).
    """
    features = dict(zip(WINDOWS_NM, spectral_features(spectrum)[0], strict=True))
    return {
        "darkness": float(np.arctan2(np.exp(features["blue"]) - ORIGIN, np.exp(features["level"]))),
        "depth_2um": float(features["um1_96"] - 0.5 * (features["um1_52"] + features["um2_30"])),
        "blue": float(features["blue"]),
    }


@cache
def embedded_regressions() -> dict[str, SoilRegression]:
    """By quantity, from `soil_normative.csv`."""
    rows: dict[str, list[Mapping[str, str]]] = {}
    for row in table_rows(TABLE):
        rows.setdefault(row["quantity"], []).append(row)
    return {name: _from_rows(part) for name, part in rows.items()}


def _from_rows(rows: Sequence[Mapping[str, str]]) -> SoilRegression:
    """The first row is that of the constant."""
    mean, scale = (np.array([float(row[key]) for row in rows[1:]]) for key in ("mean", "scale"))
    coefficients = np.array([float(row["coefficient"]) for row in rows])
    spread = np.array([[float(row[f"spread_{k}"]) for k in range(len(rows))] for row in rows])
    last = (float(rows[0][key]) for key in ("sigma", "freedom", "farthest"))
    return SoilRegression(tuple(row["feature"] for row in rows[1:]), mean, scale, coefficients, spread, *last)


def normative(spectrum: Spectrum, kind: KindVerdict, laws: Mapping[str, SoilRegression] | None = None) -> Normative:
    """Plagioclase of the norm, FeO and TiO2 of a soil, each with its error over missions left out.

    Not determined for what is no weathered soil, and for outliers. Beyond the soils learned from errors widen, and it
    is out of domain. The level must be that of a laboratory at 30 deg incidence: 20 % more of it adds 5 to 10 wt % of
    plagioclase.

    `laws` are the regressions by quantity, those embedded where left out. The status speaks of the 11 soils that these
    were learned from (`soil_normative.csv`), whichever are given.

    References
    ----------
    Taylor, Pieters, Keller, Morris & McKay (2001), J. Geophys. Res. 106, 27985, 10.1029/2000JE001402 (soils).
    """
    if reason := _unfit(kind):
        return Normative({}, False, f"not determined: {reason}")
    features, laws = soil_features(spectrum), laws or embedded_regressions()
    if not np.isfinite(list(features.values())).all():
        return Normative({}, False, "not determined: too few channels")
    values = {name: law.estimate(np.array([features[key] for key in law.features])) for name, law in laws.items()}
    doubt = "" if kind.kind == "weathered-soil" else "; if it is a soil, and no rock"
    text = f"regression on 11 lunar soils in a laboratory, for its level; no modes of minerals{doubt}"
    if far := [CALLED[name] for name, value in values.items() if not value.within]:
        beyond = f"{'lie' if far[1:] else 'lies'} beyond the soils learned from"
        text = f"out of domain: its {' and '.join(far)} {beyond}, so that errors are wide; {text}"
    return Normative(values, not far, text)


def _unfit(kind: KindVerdict) -> str:
    """Why a kind of target is none that was learned from; '' where it is one."""
    if not kind.is_weathered:
        return f"no weathered soil ({kind.kind})"
    if kind.outlier:
        return "; ".join(kind.reasons)
    soil, rock = (kind.probabilities[name] for name in ("weathered-soil", "solid-rock"))
    return "it looks more like a solid rock than like a soil; state the kind" if rock > soil and not kind.stated else ""


CALLED = {"plagioclase_wt": "plagioclase", "feo_wt": "FeO", "tio2_wt": "TiO2"}
"""What sentences call the quantities."""
TITLES = {"plagioclase_wt": "normative plagioclase [wt %]", "feo_wt": "FeO [wt %]", "tio2_wt": "TiO$_2$ [wt %]"}
"""Of the panels, by quantity."""
COLOR = BLUE


def normative_pages(names: Sequence[str], soils: Sequence[Normative]) -> "Iterator[Figure]":
    """One panel a quantity, one row a soil; a soil that is not determined has an empty row."""
    panels = []
    for name, title in TITLES.items():
        values = [item.values.get(name) for item in soils]
        bars: list[Bar] = [(np.array([*value.to_dict().values()]), COLOR, COLOR) if value else None for value in values]
        panels.append(BarPanel({"xlabel": title, "xlim": (0.0, None)}, bars))
    text = (
        "weathered soils: composition by regression, no modes of minerals\n"
        "bars: 68 and 95 %; an empty row: not determined"
    )
    return bar_pages(names, panels, text)
