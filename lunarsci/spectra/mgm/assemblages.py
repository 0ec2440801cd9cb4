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
BELIEVED = "believe `spectra unmix`, which also sees minerals whose bands are hidden"
"""What to do where the fit and `unmix` differ (`standing`)."""
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


def standing(
    probabilities: Mapping[str, float],
    present: Mapping[str, float] | None = None,
    beyond: Sequence[str] = (),
    cause: str = "",
) -> dict[str, list[str]]:
    """Minerals that are `sure`, `open` and `not_needed`, of the probabilities of assemblages.

    What is there is answered by `present`, the probability of more than 5 % of each mineral by `unmix`, where there is
    one: of 409 laboratory spectra, by networks that knew nothing of their sample series, 482 minerals are sure and 96 %
    of them there, 548 not needed and 0.5 % of them there. By what the fit needs these were 295 and 96 %, 798 and 8 %
    (`tests/benchmarks/choices.py`). Where both differ in what is sure, 91 % of 204 minerals that are sure by `present`
    are there, and 35 % of 17 that are sure by the fit.

    Without `present`, a pyroxene that the fit needs may stand for the other one, and minerals `beyond` any composition
    in the fit are open at best, as are pyroxenes where their 2 um band may have another `cause`.

    >>> standing({"CPX": 1.0})["sure"], standing({"CPX": 1.0}, {"orthopyroxene": 1.0, "clinopyroxene": 0.2})["sure"]
    (['pyroxene'], ['orthopyroxene'])
    """
    need = chances(probabilities)
    chance, enough = ({**need, **present}, any) if present else (need, all)
    sure = [name for name in COMPARED if chance[name] >= SURE]
    absent = [name for name in COMPARED if chance[name] <= 1 - SURE]
    for group, keys in GROUPS.items():
        members = [MINERALS[key] for key in keys]
        if need[group] >= SURE and not enough(name in sure for name in members):
            sure = [name for name in sure if name not in members] + ([] if cause else [group])
            absent = [name for name in absent if name not in members]
    if not present:
        sure = [name for name in sure if name not in (*beyond, *(PYROXENES if cause else ()))]
    left = [name for name in COMPARED if name not in (*sure, *absent)]
    return {"sure": sure, "open": left, "not_needed": absent}


def verdict(
    probabilities: Mapping[str, float],
    present: Mapping[str, float] | None = None,
    beyond: Sequence[str] = (),
    cause: str = "",
) -> str:
    """The verdict on minerals, by words: `standing`, and where the fit alone would be sure of others.

    >>> verdict({"OL": 0.97, "OL-OPX": 0.03}).partition(";")[0]
    'sure: olivine'
    """
    need, status = chances(probabilities), standing(probabilities, present, beyond, cause)
    chance, left, parts = {**need, **(present or {})}, list(status["open"]), []
    if sure := [name for name in status["sure"] if name not in GROUPS]:
        parts.append(f"sure: {', '.join(sure)}")
    for group in GROUPS.keys() & set(status["sure"]):
        members = [MINERALS[key] for key in GROUPS[group]]
        left = [name for name in left if name not in members]
        parts.append(f"a {group} is sure, which one is open ({_listed(chance, members)})")
    doubted = [name for name in left if name in beyond and chance[name] >= SURE] if not (present or cause) else []
    left = [name for name in left if name not in doubted]
    parts += [f"{name} is fitted, but its centres are those of no {name}: open" for name in doubted]
    parts = parts or ["no mineral is sure"]
    if cause and need["pyroxene"] >= SURE and not set(PYROXENES) & set(sure):
        parts.append(f"pyroxene is fitted, but open: {cause}")
    parts += [f"open: {_listed(chance, left)}"] if left else []
    absence = "probably absent" if present else "not needed to fit, but not ruled out"
    parts += [f"{absence}: {', '.join(status['not_needed'])}"] if status["not_needed"] else []
    differ = [name for name in COMPARED if (chance[name] >= SURE) != (need[name] >= SURE)]
    return "; ".join([*parts, *([f"the fit alone gives {_listed(need, differ)}: {BELIEVED}"] if differ else [])])


def _listed(chance: Mapping[str, float], names: Sequence[str]) -> str:
    return ", ".join(f"{name} {100 * chance[name]:.0f} %" for name in names)
