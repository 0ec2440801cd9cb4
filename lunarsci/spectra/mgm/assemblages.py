"""Which bands a mineral assemblage has, where they start and how far their priors reach; read from `mgm_bands.csv`."""

from dataclasses import dataclass

from lunarsci.errors import ParameterError
from lunarsci.tables import table_rows

__all__ = ["MINERALS", "TABLE", "Assemblage", "BandPrior", "assemblage"]

MINERALS = {"OL": "olivine", "OPX": "orthopyroxene", "CPX": "clinopyroxene"}
TABLE = "mgm_bands.csv"


@dataclass(frozen=True, slots=True)
class BandPrior:
    """Prior of one band: means and standard deviations of a normal law. The strength's mean is 0, its upper bound too.

    `region` is `uv`, `visible`, `um1` or `um2`; `source` a key of `sources.toml`; strengths in ln reflectance. [nm, -]
    """

    name: str
    mineral: str
    region: str
    center_nm: float
    center_sigma_nm: float
    fwhm_nm: float
    fwhm_sigma_nm: float
    strength_sigma: float
    source: str


@dataclass(frozen=True, slots=True)
class Assemblage:
    """A named set of bands."""

    name: str
    bands: tuple[BandPrior, ...]

    @property
    def minerals(self) -> tuple[str, ...]:
        """Full names of the minerals."""
        return tuple(MINERALS[part] for part in self.name.split("-"))


def assemblage(name: str) -> Assemblage:
    """The assemblage of one or more of OL, OPX, CPX joined by hyphens, such as `OL-OPX-CPX`.

    Raises ParameterError for anything else.
    """
    parts = name.upper().split("-")
    unknown = [part for part in parts if part not in MINERALS]
    if unknown or len(set(parts)) != len(parts):
        raise ParameterError(f"assemblage '{name}' is unknown; join some of {', '.join(MINERALS)} by '-', each once")
    ordered = [key for key in MINERALS if key in parts]
    wanted = {"any", *(MINERALS[key] for key in ordered)}
    return Assemblage("-".join(ordered), tuple(band for band in _read_table() if band.mineral in wanted))


def _read_table() -> list[BandPrior]:
    return [
        BandPrior(
            row["band"],
            row["mineral"],
            row["region"],
            float(row["center_nm"]),
            float(row["center_prior_sigma_nm"]),
            float(row["fwhm_nm"]),
            float(row["fwhm_prior_sigma_nm"]),
            float(row["strength_prior_sigma"]),
            row["source"],
        )
        for row in table_rows(TABLE)
    ]
