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
    products : What to measure, joined by commas: bands, indices, fit, unmix, match.
    roi : Samples and lines x0:x1,y0:y1 from 0, ends left out; or a GeoJSON file of polygons in degrees.
    mask : Image of the cube's size: pixels with 0 or no value are left out.
    every : Every n-th line and sample only.
    band_continuum : Continuum of the bands, as `continuum` of `spectra bands`.
    smooth_nm : Smoothing window of the bands in nm.
    assemblage : The minerals that there are, joined by hyphens: OL, OPX, CPX, PLG. unmix weighs these and no others,
        without it all four; fit has their bands, without it those of OL-OPX-CPX.
    continuum : Continuum of the fit, as `continuum` of `spectra fit`.
    model_error : Model error of ln R; left out: that expected of each spectrum.
    starts : Starting points of a fit.
    neighbours : Fits start from those of their neighbours, and take theirs where they are lower; without, each pixel is
        fitted alone, as `spectra fit` does it.
    contest_every : Every Nth line and sample is fitted from all starting points, the others from their neighbours.
    kind : Kind of target of unmix; auto: found in each pixel.
    both : Of unmix: mix end members too in every pixel, and write shares by both methods beside those that networks
        learned (share_olivine_both and so on), as `spectra unmix `assemblage`` gives them. Name the minerals: where
        nothing is known of them networks alone are better. Slow: some 20 pixels a second and core.
    craters : Table of craters of match, as `craters` of `spectra match`.
    single_precision : Write values with 24 bits instead of 53: half the size.
    wavelengths : Table of wavelengths, one a band; columns fwhm and good beside it.
    wavelength_unit : Unit of the wavelengths.
    scale : What reflectances were multiplied by, such as 10000; 100 for percent.
    ignore : Number that stands for no value.
    saturated : Number in the file from which on a channel is saturated.
    locations : ENVI file of longitude and latitude of each pixel (M3: found beside it).
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
