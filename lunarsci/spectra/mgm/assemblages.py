"""Which bands a mineral assemblage has, where composition puts them, and how far their priors reach.

Read from `mgm_bands.csv` and `mgm_compositions.csv`.
"""

from dataclasses import dataclass

from lunarsci.errors import ParameterError
from lunarsci.tables import table_rows

__all__ = ["FAMILIES", "MINERALS", "TABLES", "Assemblage", "BandPrior", "CompositionPrior", "assemblage"]

MINERALS = {"OL": "olivine", "OPX": "orthopyroxene", "CPX": "clinopyroxene", "PLG": "plagioclase"}
BANDS, COMPOSITIONS = "mgm_bands.csv", "mgm_compositions.csv"
TABLES = (BANDS, COMPOSITIONS)

MAFIC_FAMILIES = ("OL", "OPX", "CPX", "OL-OPX", "OL-CPX", "OPX-CPX", "OL-OPX-CPX")
FAMILIES = (*MAFIC_FAMILIES, "PLG", *(f"{family}-PLG" for family in MAFIC_FAMILIES))
"""Every assemblage: one to three mafic minerals, each with and without plagioclase, and plagioclase alone."""


@dataclass(frozen=True, slots=True)
class BandPrior:
    """Prior of one band: means and standard deviations of a normal law. The strength's mean is 0, its upper bound too.

    `region` is `uv`, `visible`, `um1` or `um2`; `composition` the key of a `CompositionPrior` or empty;
    `center_nm` holds at that composition's mean, `center_slope_nm` is its change per mol %, `center_sigma_nm` the
    scatter about that line; `source` a key of `sources.toml`; strengths in ln reflectance. [nm, -]
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

    @property
    def key(self) -> str:
        """The name as it stands in parameter names: lower case, underscores."""
        return self.name.lower().replace(" ", "_").replace("-", "_")


@dataclass(frozen=True, slots=True)
class CompositionPrior:
    """What is believed of a mineral's composition: Fo of olivine, Fs of orthopyroxene, Wo of clinopyroxene. [mol %]"""

    key: str
    mineral: str
    mean: float
    sigma: float
    lowest: float
    highest: float
    source: str


@dataclass(frozen=True, slots=True)
class Assemblage:
    """A named set of bands, and the compositions that move them."""

    name: str
    bands: tuple[BandPrior, ...]
    compositions: tuple[CompositionPrior, ...]

    @property
    def minerals(self) -> tuple[str, ...]:
        """Full names of the minerals."""
        return tuple(MINERALS[part] for part in self.name.split("-"))


def assemblage(name: str) -> Assemblage:
    """The assemblage of one or more of OL, OPX, CPX, PLG joined by hyphens, such as `OL-OPX-CPX`.

    Raises ParameterError for anything else.
    """
    parts = name.upper().split("-")
    unknown = [part for part in parts if part not in MINERALS]
    if unknown or len(set(parts)) != len(parts):
        raise ParameterError(f"assemblage '{name}' is unknown; join some of {', '.join(MINERALS)} by '-', each once")
    ordered = [key for key in MINERALS if key in parts]
    wanted = {"any", *(MINERALS[key] for key in ordered)}
    return Assemblage(
        "-".join(ordered),
        tuple(band for band in _bands() if band.mineral in wanted),
        tuple(composition for composition in _compositions() if composition.mineral in wanted),
    )


def _bands() -> list[BandPrior]:
    return [
        BandPrior(
            row["band"],
            row["mineral"],
            row["region"],
            row["composition"],
            float(row["center_nm"]),
            float(row["center_slope_nm"]),
            float(row["center_prior_sigma_nm"]),
            float(row["fwhm_nm"]),
            float(row["fwhm_prior_sigma_nm"]),
            float(row["strength_prior_sigma"]),
            row["source"],
        )
        for row in table_rows(BANDS)
    ]


def _compositions() -> list[CompositionPrior]:
    return [
        CompositionPrior(
            row["composition"],
            row["mineral"],
            float(row["mean_percent"]),
            float(row["sigma_percent"]),
            float(row["lowest_percent"]),
            float(row["highest_percent"]),
            row["source"],
        )
        for row in table_rows(COMPOSITIONS)
    ]
