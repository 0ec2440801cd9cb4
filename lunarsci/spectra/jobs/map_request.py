"""What `lunarsci spectra map` is asked: what to measure on which pixels of a cube."""

from dataclasses import dataclass
from typing import Literal

from lunarsci.errors import RequestError
from lunarsci.spectra.abundance.learned import MINERALS
from lunarsci.spectra.cubes.cube import Stated
from lunarsci.spectra.jobs.bands import SMOOTH_NM
from lunarsci.spectra.jobs.unmix import named_minerals
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM, MgmContinuum

PRODUCTS = ("bands", "indices", "fit", "unmix", "match")
ROWS, MOST_ROWS = 32, 64
"""Lines of a block: whole tiles of those that neighbours are looked for in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapRequest:
    """What to measure on which pixels.

    Attributes
    ----------
    products : of `PRODUCTS`, joined by commas.
    roi, mask, every : which pixels, see `lunarsci.spectra.cubes.regions.region_of`.
    band_continuum, smooth_nm : of bands, as `continuum` and `smooth_nm` of `lunarsci.bands`.
    assemblage : the minerals of fit, OL-OPX-CPX where it is left out, and those that unmix weighs, and no
        others; all four where it is left out.
    continuum, model_error, starts : of fit, as `lunarsci.fit` has them.
    neighbours, contest_every : whether a fit starts from those of its neighbours and takes theirs where they are
        lower; every how many lines and samples all starts are tried. Without, all are tried everywhere.
    kind : of unmix, as `lunarsci.unmix` has it.
    both : whether unmix mixes end members too, in further layers, as `lunarsci.unmix` does where minerals are named.
    craters : of match, as `lunarsci.match` has them.
    single_precision : whether values are written with 24 bits instead of 53.
    wavelengths, wavelength_unit, scale, ignore, saturated, locations : of the cube, where it does not say: a file of
        wavelengths, their unit, what reflectances were multiplied by, the number for no value, the number from which on
        a channel is saturated, a file of longitudes and latitudes.
    """

    products: str = "bands,indices,fit"
    roi: str | None = None
    mask: str | None = None
    every: int = 1
    band_continuum: Literal["conic", "hull", "linear"] = "conic"
    smooth_nm: float = SMOOTH_NM
    assemblage: str | None = None
    continuum: MgmContinuum = DEFAULT_CONTINUUM
    model_error: float | None = None
    starts: int = 4
    neighbours: bool = True
    contest_every: int = 8
    kind: Literal["auto", "powder-mixture", "dark-rock-powder", "weathered-soil", "solid-rock"] = "auto"
    both: bool = False
    craters: str | None = None
    single_precision: bool = False
    wavelengths: str | None = None
    wavelength_unit: Literal["nm", "um", "angstrom", "1/cm"] | None = None
    scale: float | None = None
    ignore: float | None = None
    saturated: float | None = None
    locations: str | None = None

    def __post_init__(self) -> None:
        if wrong := [name for name in self.wanted if name not in PRODUCTS]:
            raise RequestError(f"`products` {wrong[0]}: there are {', '.join(PRODUCTS)}")
        if not self.wanted:
            raise RequestError(f"`products` is empty; there are {', '.join(PRODUCTS)}")
        if self.scale is not None and not 0 < self.scale < float("inf"):
            raise RequestError(f"`scale` is {self.scale:g}; reflectances are numbers divided by it, so it is above 0")
        if not 1 <= self.contest_every <= ROWS:
            raise RequestError(f"`contest_every` is {self.contest_every}; give 1 to {ROWS}")
        if self.both and "unmix" not in self.wanted:
            raise RequestError("`both` is of unmix; name it in `products`")
        if self.every < 1:
            raise RequestError(f"`every` is {self.every}; give 1 or more")

    @property
    def wanted(self) -> list[str]:
        """Products, each once."""
        return list(dict.fromkeys(name for part in self.products.split(",") if (name := part.strip().lower())))

    def stated(self) -> Stated:
        """What is said of the cube."""

        return Stated(
            wavelength_unit=self.wavelength_unit,
            scale=self.scale,
            ignored=self.ignore,
            saturated=self.saturated,
            wavelengths=self.wavelengths,
            locations=self.locations,
        )

    @property
    def minerals(self) -> list[str]:
        """Those that unmix weighs."""

        return named_minerals(self.assemblage) if self.assemblage else list(MINERALS)
