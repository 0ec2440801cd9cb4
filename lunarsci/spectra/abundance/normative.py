"""Normative plagioclase, FeO and TiO2 of a weathered lunar soil, by a regression on two numbers of its spectrum each.

No mineral is seen: iron and opaques darken, and pyroxene absorbs at 2 um, so that these numbers go with the composition
over the few soils that were measured. The norm is what the oxides would crystallise to. Never a mode of minerals.

    y = c0 + sum_k c_k (x_k - mean_k) / scale_k,   error s sqrt(1 + a^T H a),  a = (1, (x - mean) / scale)
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.spectra.abundance.kinds import WINDOWS_NM, KindVerdict, spectral_features
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.tables import table_rows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

TABLE = "soil_normative.csv"
FEATURES = {"plagioclase_wt": ("darkness", "depth_2um"), "feo_wt": ("darkness", "depth_2um"),
            "tio2_wt": ("darkness", "blue")}  # fmt: skip
"""What each quantity, in per cent by weight of the soil, is regressed on."""
ORIGIN = 0.42
"""Of the angle `darkness`, after the titanium parameter of Lucey et al. (2000), whose ratio is at 415 nm."""
RIDGE = 0.3
"""In units of a mission's mean weight; assumed."""
FARTHEST = 1.5
"""How much farther from the mean, in a^T H a, a soil may lie than the farthest one learned from; assumed."""
SEEN_R750 = (0.072 / 1.25, 0.358 * 1.25)
"""Reflectance near 750 nm of the soils learned from, apollo-08 the brightest, luna-0 the darkest, widened by an assumed
quarter: the angle hardly changes below."""
LEVELS = {"": 0.6827, "95": 0.95}
MOLAR_MASS = {"sio2": 60.084, "tio2": 79.866, "al2o3": 101.961, "feo": 71.844, "mgo": 40.304, "cao": 56.077,
              "na2o": 61.979}  # fmt: skip
"""Of the oxides, from the atomic weights of the IUPAC: Meija et al. (2016), Pure Appl. Chem. 88, 265,
10.1515/pac-2015-0305. [g/mol]"""
DENSITY = {"plagioclase": 2.72, "diopside": 3.35, "hypersthene": 3.45, "olivine": 3.55}
"""g/cm3, of lunar compositions; assumed."""
SODA_WT, REST_WT = 0.45, 1.0
"""Na2O, and all other minor oxides together, of a soil where they are not stated; assumed. [wt %]"""


def plagioclase_norm_wt(al2o3_wt: FloatArray | float, na2o_wt: FloatArray | float = SODA_WT) -> FloatArray:
    """Plagioclase of the norm, all alumina in it and none in pyroxene. [wt % of the soil]

    An = Al2O3 - Na2O and Ab = 2 Na2O in mol, weighed: 2.73 Al2O3 + 3.97 Na2O.
    """
    soda = np.asarray(na2o_wt) / MOLAR_MASS["na2o"]
    anorthite = np.asarray(al2o3_wt) / MOLAR_MASS["al2o3"] - soda
    an = MOLAR_MASS["cao"] + MOLAR_MASS["al2o3"] + 2 * MOLAR_MASS["sio2"]
    ab = (MOLAR_MASS["na2o"] + MOLAR_MASS["al2o3"] + 6 * MOLAR_MASS["sio2"]) / 2
    return np.asarray(anorthite * an + 2 * soda * ab)


def silicate_norm(oxides_wt: Mapping[str, float], na2o_wt: float = SODA_WT) -> dict[str, float]:
    """Olivine, hypersthene, diopside and plagioclase of the norm, shares of 1 by volume of these silicates.

    In mol: ilmenite = TiO2; An = Al2O3 - Na2O; Di = CaO - An; FM = FeO - TiO2 + MgO - Di; S = SiO2 - 6 Na2O - 2 An -
    2 Di; with S >= FM all of FM is hypersthene, else FM - S olivine and 2 S - FM hypersthene. SiO2 is what is left of
    100 %. One per cent by weight less of it makes up to 4 % more olivine.

    Parameters
    ----------
    oxides_wt : feo, tio2, mgo, cao, al2o3. [wt %]
    na2o_wt : [wt %]
    """
    weights = dict(oxides_wt) | {"na2o": na2o_wt}
    weights["sio2"] = 100.0 - REST_WT - sum(weights.values())
    mol = {name: weights[name] / mass for name, mass in MOLAR_MASS.items()}
    anorthite = mol["al2o3"] - mol["na2o"]
    diopside = mol["cao"] - anorthite
    iron = mol["feo"] - mol["tio2"]
    mafic = iron + mol["mgo"] - diopside
    silica = mol["sio2"] - 6 * mol["na2o"] - 2 * anorthite - 2 * diopside
    olivine = max(0.0, mafic - silica)
    metal = (iron * MOLAR_MASS["feo"] + mol["mgo"] * MOLAR_MASS["mgo"]) / (iron + mol["mgo"])
    mass = {
        "plagioclase": float(plagioclase_norm_wt(weights["al2o3"], na2o_wt)),
        "diopside": diopside * (MOLAR_MASS["cao"] + metal + 2 * MOLAR_MASS["sio2"]),
        "hypersthene": (mafic - 2 * olivine) * (metal + MOLAR_MASS["sio2"]),
        "olivine": olivine * (2 * metal + MOLAR_MASS["sio2"]),
    }
    volume = {name: value / DENSITY[name] for name, value in mass.items()}
    total = sum(volume.values())
    return {name: value / total for name, value in volume.items()}


@dataclass(frozen=True, slots=True)
class NormativeValue:
    """A quantity of a soil, with intervals of 68 and 95 %. [wt %]"""

    value: float
    low: float
    high: float
    low95: float
    high95: float

    def to_dict(self) -> dict[str, float]:
        """Keys of `--json`."""
        return {name: getattr(self, name) for name in ("value", "low", "high", "low95", "high95")}


@dataclass(frozen=True, slots=True)
class Normative:
    """What a soil's spectrum says of its composition.

    Attributes
    ----------
    values : by `plagioclase_wt`, `feo_wt`, `tio2_wt`; those that are not determined are missing.
    in_domain : whether all are determined.
    status : a sentence; why not, where they are not.
    """

    values: Mapping[str, NormativeValue]
    in_domain: bool
    status: str

    def to_dict(self) -> dict[str, Any]:
        """The key `normative` of `lunarsci spectra unmix --json`."""
        found = {name: value.to_dict() for name, value in self.values.items()}
        return {name: found.get(name) for name in FEATURES} | {"in_domain": self.in_domain, "status": self.status}


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

    def estimate(self, features: FloatArray) -> NormativeValue | None:
        """With intervals of Student's t, within 0 and 100; None beyond what was learned from."""
        from scipy.special import stdtrit

        value, far = (float(item[0]) for item in self.at(features[None]))
        if not far <= FARTHEST * self.farthest:
            return None
        error = self.sigma * np.sqrt(1.0 + far)
        halves = {name: error * float(stdtrit(self.freedom, 0.5 + level / 2)) for name, level in LEVELS.items()}
        ends = {f"{end}{name}": float(np.clip(value + sign * half, 0.0, 100.0))
                for name, half in halves.items() for end, sign in (("low", -1), ("high", 1))}  # fmt: skip
        return NormativeValue(float(np.clip(value, 0.0, 100.0)), **ends)


def soil_features(spectrum: Spectrum) -> dict[str, float]:
    """`darkness`, `depth_2um`, `blue`, and `r750`, of a spectrum; NaN where channels are missing. [rad, -, -, -]

    darkness = arctan((R475 / R750 - 0.42) / R750) grows with opaques and iron, and little with weathering; `depth_2um`
    is ln R near 1960 nm less the mean of ln R near 1525 and 2300 nm; `blue` is ln R475 / R750.

    References
    ----------
    Lucey, Blewett & Jolliff (2000), J. Geophys. Res. 105, 20297, 10.1029/1999JE001117 (the angle).
    """
    found = dict(zip(WINDOWS_NM, spectral_features(spectrum)[0], strict=True))
    return {
        "darkness": float(np.arctan2(np.exp(found["blue"]) - ORIGIN, np.exp(found["level"]))),
        "depth_2um": float(found["um1_96"] - 0.5 * (found["um1_52"] + found["um2_30"])),
        "blue": float(found["blue"]),
        "r750": float(np.exp(found["level"])),
    }


def learn_regression(features: FloatArray, values: FloatArray, missions: Sequence[str], names: Sequence[str]
                     ) -> SoilRegression:  # fmt: skip
    """Ridge regression of values (n,) on features (n, f); a mission of m soils counts as sqrt(m) of them.

    Its error is that of soils whose mission is left out.
    """
    own = np.array(missions)
    square = []
    for mission in np.unique(own):
        out = own == mission
        found, far = _ridge(features[~out], values[~out], own[~out], names).at(features[out])
        square.extend((values[out] - found) ** 2 / (1.0 + far))
    law = _ridge(features, values, own, names)
    freedom = np.unique(own).size - len(names) - 1.0
    parts = (law.features, law.mean, law.scale, law.coefficients, law.spread)
    return SoilRegression(*parts, float(np.sqrt(np.mean(square))), freedom, float(law.at(features)[1].max()))


def _ridge(features: FloatArray, values: FloatArray, missions: FloatArray, names: Sequence[str]) -> SoilRegression:
    mean, scale = features.mean(axis=0), features.std(axis=0)
    _, place, count = np.unique(missions, return_inverse=True, return_counts=True)
    weight = count[place] ** -0.5
    weight /= weight.mean()
    design = np.column_stack([np.ones(len(values)), (features - mean) / scale])
    penalty = RIDGE * np.diag([0.0, *np.ones(features.shape[1])])
    spread = np.linalg.inv((design.T * weight) @ design + penalty)
    coefficients = spread @ (design.T * weight) @ values
    return SoilRegression(tuple(names), mean, scale, coefficients, spread, 0.0, 0.0, 0.0)


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

    Not determined for what is no weathered soil, for strangers, and beyond the soils learned from. The level must be
    that of a laboratory at 30 deg incidence: 20 % more of it adds 5 to 10 wt % of plagioclase.

    References
    ----------
    Taylor, Pieters, Keller, Morris & McKay (2001), J. Geophys. Res. 106, 27985, 10.1029/2000JE001402 (soils).
    """
    if reason := _unfit(kind):
        return Normative({}, False, f"not determined: {reason}")
    found = soil_features(spectrum)
    seen = SEEN_R750[0] <= found["r750"] <= SEEN_R750[1]
    values = {
        name: value
        for name, law in (laws or embedded_regressions()).items()
        if seen and (value := law.estimate(np.array([found[key] for key in law.features]))) is not None
    }
    if missing := [name for name in FEATURES if name not in values]:
        return Normative(values, False, f"not determined: {', '.join(missing)} lie beyond the soils learned from")
    doubt = "" if kind.kind == "weathered-soil" else "; if it is a soil, and no rock"
    return Normative(
        values, True, f"regression on 11 lunar soils in a laboratory, for its level; no modes of minerals{doubt}"
    )


def _unfit(kind: KindVerdict) -> str:
    if not kind.is_weathered:
        return f"no weathered soil ({kind.kind})"
    if kind.stranger:
        return "; ".join(kind.reasons)
    soil, rock = (kind.probabilities[name] for name in ("weathered-soil", "solid-rock"))
    told = f"solid rock {100 * rock:.0f} %, soil {100 * soil:.0f} %: not decided, state the kind"
    return told if rock > soil and not kind.stated else ""


PER_PAGE = 40
TITLES = {"plagioclase_wt": "normative plagioclase [wt %]", "feo_wt": "FeO [wt %]", "tio2_wt": "TiO$_2$ [wt %]"}


def normative_pages(names: Sequence[str], found: Sequence[Normative]) -> "Iterator[Figure]":
    """One panel a quantity, one row a soil; a soil that is not determined has an empty row."""
    from lunarsci.figure import as_label, headline, page

    for start in range(0, len(found), PER_PAGE):
        part, labels = found[start : start + PER_PAGE], names[start : start + PER_PAGE]
        figure = page(1.4 + 0.2 * len(part))
        panels = figure.subplots(1, len(TITLES), sharey=True)
        for panel, (name, title) in zip(panels, TITLES.items(), strict=True):
            for row, item in enumerate(part):
                _draw(panel, row, item.values.get(name))
            panel.set_xlabel(title)
            panel.set_xlim(left=0.0)
            panel.grid(axis="x", color="0.9")
        panels[0].set_yticks(np.arange(len(part)), [as_label(name, 28) for name in labels])
        panels[0].set_ylim(len(part) - 0.5, -0.5)
        headline(
            figure,
            "weathered soils: composition by regression, no modes of minerals\n"
            "bars: 68 and 95 %; an empty row: not determined",
        )
        yield figure


def _draw(panel: Any, row: int, value: NormativeValue | None) -> None:
    if value is not None:
        for low, high, width in ((value.low95, value.high95, 1.0), (value.low, value.high, 3.5)):
            panel.plot([low, high], [row, row], color="#0072B2", linewidth=width, solid_capstyle="butt")
        panel.plot(value.value, row, "o", color="#0072B2", markersize=5)
