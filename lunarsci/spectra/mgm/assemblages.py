"""Which bands a mineral assemblage has, where composition puts them, and how far their priors reach.

Read from `mgm_bands.csv` and `mgm_compositions.csv`. A row may hold only `beside` another mineral: clinopyroxene alone
may be anything from pigeonite to augite, beside orthopyroxene it is the partner rich in calcium.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lunarsci.errors import ParameterError
from lunarsci.io.tables import table_rows
from lunarsci.minerals import MINERALS, abbreviated
from lunarsci.names import meant

GROUPS = {"pyroxene": ("OPX", "CPX")}
"""Minerals that stand for each other in a spectrum: that one of them is there may be sure where each alone is open."""
PYROXENES = ("pyroxene", *(MINERALS[key] for key in GROUPS["pyroxene"]))
"""Names that a pyroxene may have in an answer: of the group, and of its members."""
SURE = 0.93
"""Probability from which something is called sure, as of `Choice.family`. Measured: 92 % of the families of 156 spectra
are right with it, 90 % with 0.9 (`lunarsci.spectra.mgm.selection.choose`)."""
ALONE = "no second pyroxene"
"""What must hold for the composition of a pyroxene that was fitted alone (`Assemblage.domain`)."""
HIDDEN = {"orthopyroxene": 0.73, "clinopyroxene": 0.26}
"""Largest share of a pyroxene in RELAB mixtures of which the comparison called the other one sure, and not this one.
Measured: of 32 mixtures with 5 vol % or more of both, 12 were so fitted by clinopyroxene (MIX230: 73 vol %
orthopyroxene; five others 39 or more), 9 by orthopyroxene (XP-CMP-004 and -013: 26 vol % clinopyroxene), by
`tests/benchmarks/compositions.py`."""
WRONG_ONE = (4, 120)
"""In how many samples with one pyroxene, of which one alone was sure, that was the other one. By the same benchmark:
one clinopyroxene with the bands of an enstatite, and three orthopyroxenes fitted as clinopyroxenes of Wo 6 to 13."""
BIC_OF_CHOICE = (
    "BIC of all assemblages is of channels joined to 20 nm and of the comparison's own errors: it compares them and is "
    "another than that of the fit"
)
BANDS, COMPOSITIONS = "mgm_bands.csv", "mgm_compositions.csv"
TABLES = (BANDS, COMPOSITIONS)

MAFIC_FAMILIES = ("OL", "OPX", "CPX", "OL-OPX", "OL-CPX", "OPX-CPX", "OL-OPX-CPX")
FAMILIES = (*MAFIC_FAMILIES, "PLG", *(f"{family}-PLG" for family in MAFIC_FAMILIES))
"""Every assemblage: one to three mafic minerals, each with and without plagioclase, and plagioclase alone."""
COMPARED = [name for key, name in MINERALS.items() if any(key in family.split("-") for family in FAMILIES)]
"""Minerals that `auto` compares; of others it says nothing."""


@dataclass(frozen=True, slots=True)
class BandPrior:
    """Prior of one band: means and standard deviations of a normal law. The strength's mean is 0, its upper bound too.

    `region` is `uv`, `visible`, `um1` or `um2`; `composition` the key of a `CompositionPrior` or empty;
    `center_nm` holds at that composition's mean, `center_slope_nm` is its change per mol %, `center_sigma_nm` the
    scatter about that line; `source` a key of `sources.toml`; strengths in ln reflectance. [nm, -]
    `second_composition` and `second_slope_nm` are a second composition that moves the centre. The strengths of the
    bands of one mineral go together: `strength_loading` is the correlation of the strength with the mineral's amount.
    """

    name: str
    mineral: str
    region: str
    composition: str
    center_nm: float
    center_slope_nm: float
    center_sigma_nm: float
    fwhm_nm: float
    fwhm_sigma_nm: float
    strength_sigma: float
    source: str
    second_composition: str = ""
    second_slope_nm: float = 0.0
    strength_loading: float = 0.0

    @property
    def slopes_nm(self) -> dict[str, float]:
        """Change of the centre per mol % of each composition that moves it. [nm]"""
        slopes = {self.composition: self.center_slope_nm, self.second_composition: self.second_slope_nm}
        return {key: slope for key, slope in slopes.items() if key}

    @property
    def key(self) -> str:
        """The name as it stands in parameter names: lower case, underscores."""
        return self.name.lower().replace(" ", "_").replace("-", "_")


@dataclass(frozen=True, slots=True)
class CompositionPrior:
    """What is believed of a mineral's composition before its spectrum is seen. [mol %]

    `key` is `fo` of olivine, `fs` of orthopyroxene, `wo` and `fs_cpx` (iron) of clinopyroxene; `mean` and `sigma` those
    of a normal law; from `lowest` to `highest` the trend of the centres is known; `source` a key of `sources.toml`.
    """

    key: str
    mineral: str
    mean: float
    sigma: float
    lowest: float
    highest: float
    source: str


@dataclass(frozen=True, slots=True)
class Assemblage:
    """A named set of bands, in the order of their parameters, and the compositions that move them.

    `name` has abbreviations of minerals, joined by hyphens: `OL-OPX`.
    """

    name: str
    bands: tuple[BandPrior, ...]
    compositions: tuple[CompositionPrior, ...]

    @property
    def minerals(self) -> tuple[str, ...]:
        """Full names of the minerals."""
        return tuple(MINERALS[part] for part in self.name.split("-"))

    def domain(self, mineral: str) -> str:
        """What must hold for a composition from the bands of this mineral, '' for nothing.

        One pyroxene fits two as well, with centres between those of both.
        """
        others = others_of(mineral)
        return ALONE if others and not others & {band.mineral for band in self.bands} else ""


def assemblage(name: str) -> Assemblage:
    """The assemblage of one or more of OL, OPX, CPX, PLG joined by hyphens, such as `OL-OPX-CPX`.

    Raises ParameterError for anything else.
    """
    parts = abbreviated(name)
    unknown = [part for part in parts if part not in MINERALS]
    if unknown or len(set(parts)) != len(parts):
        near = meant(unknown[0], MINERALS) if unknown else ""
        raise ParameterError(
            f"assemblage '{name}' is unknown; {near}join some of {', '.join(MINERALS)} by '-', each once"
        )
    ordered = [key for key in MINERALS if key in parts]
    minerals = {"any", *(MINERALS[key] for key in ordered)}
    bands = tuple(_band(row) for row in _rows(BANDS, "band", minerals))
    moving = {key for band in bands for key in band.slopes_nm}
    rows = _rows(COMPOSITIONS, "composition", minerals)
    return Assemblage(
        "-".join(ordered), bands, tuple(_composition(row) for row in rows if row["composition"] in moving)
    )


def _rows(table: str, name: str, minerals: set[str]) -> list[Mapping[str, str]]:
    """Rows for these minerals. One that holds beside a mineral takes the place of the row of the same name."""
    chosen: dict[str, Mapping[str, str]] = {}
    for row in table_rows(table):
        if row["mineral"] in minerals and (not row["beside"] or row["beside"] in minerals):
            chosen[row[name]] = row
    return list(chosen.values())


def _band(row: Mapping[str, str]) -> BandPrior:
    texts = (row["band"], row["mineral"], row["region"], row["composition"])
    columns = "center_nm center_slope_nm center_prior_sigma_nm fwhm_nm fwhm_prior_sigma_nm strength_prior_sigma"
    center, slope, scatter, fwhm, fwhm_sigma, strength_sigma = (float(row[name]) for name in columns.split())
    second = (row["composition_2"], float(row["center_slope_2_nm"]), float(row["strength_loading"]))
    return BandPrior(*texts, center, slope, scatter, fwhm, fwhm_sigma, strength_sigma, row["source"], *second)


def _composition(row: Mapping[str, str]) -> CompositionPrior:
    mean, sigma, low, high = (float(row[f"{name}_percent"]) for name in ("mean", "sigma", "lowest", "highest"))
    return CompositionPrior(row["composition"], row["mineral"], mean, sigma, low, high, row["source"])


def others_of(mineral: str) -> set[str]:
    """Minerals that stand for this one in a spectrum; none for most.

    >>> others_of("orthopyroxene"), others_of("olivine")
    ({'clinopyroxene'}, set())
    """
    groups = [{MINERALS[key] for key in keys} for keys in GROUPS.values()]
    return set[str]().union(*(members - {mineral} for members in groups if mineral in members))


def chances(probabilities: Mapping[str, float]) -> dict[str, float]:
    """Probability that a fit needs each mineral, and one at least of each group, of the probabilities of assemblages.

    >>> chances({"OPX": 0.5, "OL-CPX": 0.25, "CPX": 0.25})["pyroxene"]
    1.0
    """
    wanted = {name: (key,) for key, name in MINERALS.items() if name in COMPARED} | GROUPS
    return {
        name: min(1.0, sum(p for one, p in probabilities.items() if not set(keys).isdisjoint(one.split("-"))))
        for name, keys in wanted.items()
    }


def standing(probabilities: Mapping[str, float], beyond: Sequence[str] = (), cause: str = "") -> dict[str, list[str]]:
    """Minerals that are `sure`, `open` and `not_needed` to fit, of the probabilities of assemblages.

    A group is sure where none of its minerals is alone; then all of these are open. Where one of a group is sure, the
    others are open: one pyroxene fits two (`HIDDEN`). What is not needed may be there. Minerals `beyond` any
    composition in the fit are open at best: of 11 such, else sure, in 389 laboratory spectra 3 were absent, of 279
    others 5. So are pyroxenes where their 2 um band may have another `cause`.

    >>> standing({"OPX": 0.5, "OL-CPX": 0.25, "CPX": 0.25})
    {'sure': ['pyroxene'], 'open': ['olivine', 'orthopyroxene', 'clinopyroxene'], 'not_needed': ['plagioclase']}
    >>> standing({"CPX": 1.0})["open"]
    ['orthopyroxene']
    """
    chance = chances(probabilities)
    beyond = (*beyond, *PYROXENES) if cause else beyond
    sure = [name for name in COMPARED if chance[name] >= SURE]
    absent = [name for name in COMPARED if chance[name] <= 1 - SURE]
    for group, keys in GROUPS.items():
        members = {MINERALS[key] for key in keys}
        if chance[group] >= SURE:
            absent = [name for name in absent if name not in members]
            sure += [group] if members.isdisjoint(sure) else []
    sure = [name for name in sure if name not in beyond]
    left = [name for name in COMPARED if name not in (*sure, *absent)]
    return {"sure": sure, "open": left, "not_needed": absent}


def verdict(probabilities: Mapping[str, float], beyond: Sequence[str] = (), cause: str = "") -> str:
    """The verdict on minerals, by words: `standing`, and what is known of a pyroxene that is sure alone.

    >>> verdict({"OL": 0.97, "OL-OPX": 0.03}).partition(";")[0]
    'sure: olivine'
    """
    chance, status = chances(probabilities), standing(probabilities, beyond, cause)
    left, parts = list(status["open"]), []
    pairs = [(one, other) for one in status["sure"] for other in others_of(one) & set(left)]
    alone = [one for one, _ in pairs]
    if sure := [name for name in status["sure"] if name not in (*GROUPS, *alone)]:
        parts.append(f"sure: {', '.join(sure)}")
    for one, other in pairs:
        left.remove(other)
        parts.append(
            f"a pyroxene is sure, and the fit takes {one}; {other} may be there, too, or instead "
            f"({100 * chance[other]:.0f} %), since laboratory mixtures that were fitted as well without it held up to "
            f"{100 * HIDDEN[other]:.0f} % of it, and for {WRONG_ONE[0]} of {WRONG_ONE[1]} samples with one pyroxene "
            "the fit took the wrong one"
        )
    for group in GROUPS.keys() & set(status["sure"]):
        members = [MINERALS[key] for key in GROUPS[group]]
        left = [name for name in left if name not in members]
        shown = ", ".join(f"{name} {100 * chance[name]:.0f} %" for name in members)
        parts.append(f"a {group} is sure, which one is open ({shown})")
    doubted = [name for name in left if name in beyond and not (cause and name in PYROXENES) and chance[name] >= SURE]
    left = [name for name in left if name not in doubted]
    parts += [f"{name} is fitted, but its centres are those of no {name}: open" for name in doubted]
    more = "also open" if len(left) < len(status["open"]) else "open"
    parts = parts or ["no mineral is sure"]
    parts += [f"pyroxene is fitted, but open: {cause}"] if cause and chance["pyroxene"] >= SURE else []
    parts += [f"{more}: {', '.join(f'{name} ({100 * chance[name]:.0f} %)' for name in left)}"] if left else []
    absent = ", ".join(status["not_needed"])
    return "; ".join([*parts, *([f"not needed to fit, but not ruled out: {absent}"] if absent else [])])
