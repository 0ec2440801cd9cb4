"""What the jobs of this part can be asked: every option with its meaning, its type and its default.

The command line reads it at every start: it imports no module that computes.
"""

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from lunarsci.errors import RequestError
from lunarsci.options import check_intervals
from lunarsci.ranges import POSITIVE
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM, MgmContinuum


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateRequest:
    """How to calibrate.

    Attributes
    ----------
    photometry : Disk function of the correction to i 30, e 0, g 30 deg; none keeps the measured angles.
    phase : Phase function: sp-low, sp-mid, sp-high, flat, or a CSV table.
    solar : Solar irradiance: e490, g173, or a table of nm and W m-2 nm-1.
    shadow : Pixels with less reflectance at 465 nm are shadows; 0 to below 1.
    vnir_steps : Steps at 632.5 and 757.5 nm between sub-bands of the imager: keep or remove.
    calibration : Channel factors for radiance from before the in-flight calibration (label version 1): CSV with
        detector (vnir, swir), wavelength_nm, factor.
    """

    photometry: Literal["lommel-seeliger", "akimov", "mcewen", "none"] = "lommel-seeliger"
    phase: str | Any = "sp-mid"
    solar: str | Any = "e490"
    shadow: float = 0.02
    vnir_steps: Literal["keep", "remove"] = "keep"
    calibration: str | Any | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulateVnisRequest:
    """A scene, its light and the instrument's noise.

    Attributes
    ----------
    soil : Fractions of ol, opx, cpx, plg that add up to 1.
    rock : The same for a rock in the image; none if left out.
    rock_radius : Radius of the rock in px; the SWIR detector sees 53.8.
    shadow : Share of the image in shadow, 0 to below 1.
    incidence : Angle of the Sun from the normal in deg.
    emission : Angle of the view from the normal in deg.
    phase_angle : Angle between Sun and view in deg.
    photometry : Disk function that the ground obeys; none for the same reflectance at all angles.
    phase : Phase function that the ground obeys.
    noise : Factor on the instrument's noise; 0 for none.
    time : UTC time of the short-wave scan, ISO 8601.
    sequence : Number of the observation.
    seed : Seed of texture, shadows and noise.
    """

    soil: str = "ol=0.05,opx=0.20,cpx=0.20,plg=0.55"
    rock: str | None = None
    rock_radius: float = 54.0
    shadow: float = 0.0
    incidence: float = 64.412
    emission: float = 45.557
    phase_angle: float = 54.505
    photometry: Literal["lommel-seeliger", "akimov", "mcewen", "none"] = "akimov"
    phase: Literal["sp-low", "sp-mid", "sp-high", "flat"] = "sp-high"
    noise: float = 1.0
    time: str = "2020-07-16T08:20:00"
    sequence: int = 1
    seed: int = 0


SMOOTH_NM = 205.0
"""The 41 channels of 5 nm of Ding et al. (2024)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BandsRequest:
    """How to measure bands.

    Attributes
    ----------
    continuum : conic: through 700, 1345, 1580 nm, guarded; hull: upper convex hull; linear: between shoulders.
    smooth_nm : Savitzky-Golay window in nm, at most 300 (half of a band); 0 for none.
    smooth : Window as an odd number of channels of the median spacing, instead of `smooth_nm`.
    smooth_order : Order of the smoothing polynomial.
    wavelength_unit : Unit of the wavelengths.
    reflectance_unit : Unit of the reflectance.
    id : Take only these spectra of the files, by name or pattern (JB*), in this order. May be repeated.
    """

    continuum: Literal["conic", "hull", "linear"] = "conic"
    smooth_nm: float = SMOOTH_NM
    smooth: int | None = None
    smooth_order: int = 3
    wavelength_unit: Literal["nm", "um", "angstrom", "1/cm"] | None = None
    reflectance_unit: Literal["fraction", "percent"] | None = None
    id: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.smooth is not None and self.smooth_nm != SMOOTH_NM:
            raise RequestError("`smooth` is the window in channels, `smooth_nm` the same in nm; give one")


@dataclass(frozen=True, slots=True, kw_only=True)
class IndicesRequest:
    """Which indices, and of which spectra.

    Attributes
    ----------
    index : Only this one, such as ibd1000 or feo_zhang_wt. May be repeated.
    smooth_nm : Savitzky-Golay window in nm, of second order, before computing; 0 for none.
    wavelength_unit : Unit of the wavelengths.
    reflectance_unit : Unit of the reflectance.
    id : Take only these spectra of the files, by name or pattern (JB*), in this order. May be repeated.
    """

    index: tuple[str, ...] = ()
    smooth_nm: float = 0.0
    wavelength_unit: Literal["nm", "um", "angstrom", "1/cm"] | None = None
    reflectance_unit: Literal["fraction", "percent"] | None = None
    id: tuple[str, ...] = ()


DEFAULT_ASSEMBLAGE = "OL-OPX-CPX"


@dataclass(frozen=True, kw_only=True)
class ModelRequest:
    """The model that is fitted, and how.

    Attributes
    ----------
    assemblage : Minerals whose bands are fitted: OL, OPX, CPX, PLG, joined by hyphens. auto compares all assemblages,
        fits the most probable one, and names those that the spectrum does not distinguish.
    continuum : Polynomial inside the logarithm, in wavelength or wavenumber; log-quadratic: of the logarithm.
    composition : What is known of Fo, Fs, Wo in mol %, such as fo=70:5. It shifts the expected band centres.
    start : Bands, continuum and their uncertainties from a start or result file of the RELAB MGM program, instead of
        `assemblage` and `continuum`; all channels are fitted.
    band_minerals : Minerals of the bands of `start`, by their number, such as 2=OPX,3=CPX, for the ratios of
        strengths. A comment behind the values of a band in that file names its mineral, too.
    prior : map: priors count as measurements; damping: they only slow the iteration, as in the RELAB MGM program.
    model_error : Error of ln R for what the model cannot explain, added to the noise; above 0, below 1. By default
        0.003 and 4 % of the depth of the deepest absorption, in quadrature. The comparison of auto has another error.
    starts : Starting points, beside a search around the lowest minimum; 0 for a quick look, one descent without a
        search.
    fix : Hold a parameter, such as opx_1_center_nm=915; also …_fwhm_nm, …_strength, and c0, c1, … of the continuum,
        whose variable runs from -1 to 1 over 400-2600 nm. May be repeated.
    bound : Keep a parameter within a range, such as cpx_2_center_nm=2150:2350. May be repeated.
    tie : Make a parameter follow another, such as cpx_1_fwhm_nm=1.0*opx_1_fwhm_nm+10. May be repeated.
    wavelength_unit : Unit of the wavelengths.
    reflectance_unit : Unit of the reflectance.
    id : Take only these spectra of the files, by name or pattern (JB*), in this order. May be repeated.

    Raises
    ------
    RequestError for options that exclude each other.
    """

    assemblage: str = DEFAULT_ASSEMBLAGE
    continuum: MgmContinuum = DEFAULT_CONTINUUM
    composition: str | None = None
    start: str | None = None
    band_minerals: str | None = None
    prior: Literal["map", "damping"] = "map"
    model_error: float | None = None
    starts: int = 4
    fix: tuple[str, ...] = ()
    bound: tuple[str, ...] = ()
    tie: tuple[str, ...] = ()
    wavelength_unit: Literal["nm", "um", "angstrom", "1/cm"] | None = None
    reflectance_unit: Literal["fraction", "percent"] | None = None
    id: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for wrong, text in self._faults():
            if wrong:
                raise RequestError(text)

    @property
    def automatic(self) -> bool:
        """Whether the assemblage is to be chosen."""
        return self.assemblage.lower() == "auto"

    def _faults(self) -> tuple[tuple[Any, str], ...]:
        return (
            (self.automatic and (self.fix or self.bound or self.tie), "`fix`, `bound` and `tie` name bands of one "
             "assemblage; give it instead of auto"),
            (self.automatic and self.prior == "damping", "`assemblage` auto compares evidence, which `prior` damping "
             "does not have; use `prior` map"),
            (self.prior == "damping" and self.bound, "`prior` damping knows no bounds; use `fix` or `tie`, or `prior` "
             "map"),
            (self.band_minerals and not self.start, "`band_minerals` names bands of a file; give it as `start`"),
            (self.model_error is not None and not 0 < self.model_error < 1, "`model_error` is a standard deviation of "
             "ln R; give a number above 0 and below 1, such as 0.01"),
            *((self.start and given, f"`start` brings its own {what}; leave `{name}` out") for name, what, given in (
                ("composition", "bands", self.composition),
                ("assemblage", "bands", self.assemblage != DEFAULT_ASSEMBLAGE),
                ("continuum", "continuum", self.continuum != DEFAULT_CONTINUUM),
            )),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class FitRequest(ModelRequest):
    """The model, and which errors are wanted.

    Attributes
    ----------
    errors : laplace: from the curvature; profile, sample: 68 and 95 % intervals that need not be symmetric, by
        refitting or by drawing from the posterior; seconds per spectrum.
    continuum_spread : Fit under every continuum, and report the largest change of every value.
    seed : Seed of `errors` sample.
    to_fit_file : whether a file of the RELAB MGM program is to be made of the fit, which must be possible then.
    """

    errors: Literal["laplace", "profile", "sample"] = "laplace"
    continuum_spread: bool = False
    seed: int = 0
    to_fit_file: bool = False

    def _faults(self) -> tuple[tuple[Any, str], ...]:
        return (
            (self.to_fit_file and self.continuum == "log-quadratic", "-o FILE.fit has no letter for log-quadratic; "
             "take another `continuum`"),
            (self.prior == "damping" and self.errors != "laplace", "`prior` damping has no posterior; use `errors` "
             "laplace, or `prior` map"),
            (self.prior == "damping" and self.continuum_spread, "`continuum_spread` needs `prior` map"),
            (self.start and self.continuum_spread, "`start` brings its own continuum; leave `continuum_spread` out"),
            (self.continuum == "none" and self.continuum_spread, "`continuum` none is for spectra without one, which "
             "others are no rivals to; leave `continuum_spread` out"),
            *ModelRequest._faults(self),
        )  # fmt: skip


Target: TypeAlias = Literal["auto", "powder-mixture", "dark-rock-powder", "weathered-soil", "solid-rock"]


@dataclass(frozen=True, kw_only=True)
class UnmixRequest:
    """What is looked at, what is known of it, and how end members are mixed.

    Attributes
    ----------
    assemblage : The minerals that there are, and no others, joined by hyphens: OL, OPX, CPX, PLG. Shares are then
        better by a fifth, since mixtures of end members take part. Without it all four are weighed.
    kind : What is looked at: powder-mixture, minerals ground and mixed; dark-rock-powder, a rock with opaques, ground,
        such as a chondrite; weathered-soil, which is not unmixed; solid-rock, which must be stated, since a rock looks
        like the soil beside it. auto weighs each kind by its probability.
    method : How end members mix: hapke, in the albedo of single scattering; absorbance, in -ln R; both, by evidence.
    library : End members instead of the embedded ones; see `spectra library`. Minerals that it lacks count as absent.
    together : With `assemblage` or `library`: take all spectra as mixtures of the same powders. Several mixtures of a
        powder fix it far better than one. The shares of solid rocks stay as they are.
    known : Table of mixtures whose shares are known: id and one column per mineral, in shares of 1. An empty cell is
        solved for, 0 means that the mineral is absent. Implies `together`.
    opaque : There may be an opaque phase beside the end members, such as ilmenite.
    iron : There may be nanophase iron on all grains: space weathering.
    prior : What is expected before the spectrum is seen. powders: mixtures like those that the networks learned from.
        lunar-rocks: rocks like those that were returned from the Moon, for a target that is surely a lunar rock.
    wavelength_unit : Unit of the wavelengths.
    reflectance_unit : Unit of the reflectance.
    id : Take only these spectra of the files, by name or pattern (JB*), in this order. May be repeated.

    Raises
    ------
    RequestError for options that exclude each other.
    """

    assemblage: str | None = None
    kind: Target = "auto"
    method: Literal["both", "hapke", "absorbance"] = "both"
    library: str | None = None
    together: bool = False
    known: str | None = None
    opaque: bool = False
    iron: bool = False
    prior: Literal["powders", "lunar-rocks"] = "powders"
    wavelength_unit: Literal["nm", "um", "angstrom", "1/cm"] | None = None
    reflectance_unit: Literal["fraction", "percent"] | None = None
    id: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.method == "absorbance" and self.iron:
            raise RequestError("`iron` needs `method` hapke or both")
        if (self.opaque or self.iron) and not self.mixes:
            raise RequestError("`opaque` and `iron` are of mixtures of end members; name the minerals (`assemblage`)")

    @property
    def mixes(self) -> bool:
        """Whether end members are mixed: networks alone are better where nothing is known of the minerals."""
        return bool(self.assemblage or self.library or self.known)

    @property
    def in_series(self) -> bool:
        """Whether the spectra are taken together."""
        return bool(self.together or self.known)


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchRequest:
    """The rocks, the craters, and what the prior is made of.

    Attributes
    ----------
    modes : Modes of a rock without a file: two or more of OL, OPX, CPX, PLG, by abbreviation or name. Compared are the
        shares among those given.
    bands : Band centres of that rock, bc1000 and bc2000, in nm.
    kind : Kind of target. Of spectra it is that of `spectra unmix`, left out: weighed by their look. Of `modes` errors
        are raised to those measured of this kind, left out: errors as given.
    name : Name of that rock.
    site : Where the rock was found, in degrees, east positive. Left out: Chang'E-4, -45.44,177.56; `craters` need it.
    use : What is compared with a crater: modes, bands (centres), or both. What a crater lacks is not compared.
    systematic : Disagreement of two methods in the share of a mineral, one standard deviation.
    band_systematic : The same for band centres, in nm.
    craters : Candidates as CSV: name, latitude_deg, longitude_deg, diameter_km; also age_low_ma, age_high_ma, olivine,
        olivine_sigma, …, bc1000_nm, bc1000_sigma_nm, …, source. Left out: the craters around Chang'E-4.
    mineral_map : GeoTIFF of a mineral's mode: its values in the ring of ejecta replace a crater's modes. May be
        repeated. Or a file of `spectra map --products unmix`.
    annulus : Ring of ejecta in which a map is averaged, in rim radii.
    prior : Prior of the craters. ejecta: by what each left at the site; uniform: all alike.
    ejecta_law : Law of the ejecta's thickness, from the transient crater.
    thickness_factor : Spread of the thickness about the law, one standard deviation, as a factor; 1 for none.
    surface_age : Age of the site's surface in Ma: ejecta of older craters lie below it. Left out: 3600 at Chang'E-4,
        none elsewhere.
    other : Prior probability that the rock is from none of the craters.
    exposure : Rocks are destroyed at the surface.
    rock_life : Median life of a 2 m boulder, in Ma.
    rock_size : Size of the rock, in m.
    life_exponent : The life of a rock is proportional to this power of its size; assumed.
    re_excavation : Buried ejecta are brought up again.
    stirring : Factor on Oberbeck's ratio of the local ground that falling ejecta stir up to these ejecta.
    gardening : Thickness of buried rock that small local craters keep at the surface, in m; assumed.
    seed : Seed of the draws for the prior.
    id : Take only these rocks of the files, by name or pattern (JB*), in this order. May be repeated.
    """

    modes: str | None = None
    bands: str | None = None
    kind: Literal["powder-mixture", "dark-rock-powder", "solid-rock"] | None = None
    name: str = "rock"
    site: str | tuple[float, ...] | None = None
    use: Literal["both", "modes", "bands"] = "both"
    systematic: float = 0.10
    band_systematic: float = 10.0
    craters: str | Any | None = None
    mineral_map: tuple[str, ...] = ()
    annulus: str = "1:2"
    prior: Literal["ejecta", "uniform"] = "ejecta"
    ejecta_law: Literal["mcgetchin", "pike", "housen", "xie"] = "pike"
    thickness_factor: float = 3.0
    surface_age: float | None = None
    other: float = 0.1
    exposure: bool = True
    rock_life: str = "40:80"
    rock_size: float = 2.0
    life_exponent: float = 0.5
    re_excavation: bool = True
    stirring: float = 1.0
    gardening: str = "0.001:0.1"
    seed: int = 0
    id: tuple[str, ...] = ()


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
    neighbours : A fit starts from the fits of neighbouring pixels, and takes their minimum where it is lower. Without,
        each pixel is fitted alone, as by `spectra fit`.
    contest_every : Every Nth line and sample is fitted from all starting points, the others from their neighbours.
    kind : Kind of target of unmix; auto: found in each pixel.
    both : With unmix: fit mixtures of end members in every pixel, too. Layers such as share_olivine_both hold the
        shares by both methods. Name the minerals by `assemblage`: without names, networks alone are better. Slow: some
        20 pixels a second and core.
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
        if wrong := [name for name in self.wanted or [""] if name not in PRODUCTS]:
            raise RequestError(f"`products` {wrong[0] or 'is empty'}: there are {', '.join(PRODUCTS)}")
        check_intervals(self, {POSITIVE: "scale", f"[1, {ROWS}]": "contest_every", "[1, inf)": "every"})
        if self.both and "unmix" not in self.wanted:
            raise RequestError("`both` is of unmix; name it in `products`")

    @property
    def wanted(self) -> list[str]:
        """Products, each once."""
        return list(dict.fromkeys(name for part in self.products.split(",") if (name := part.strip().lower())))


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportRequest:
    """What is known of spectra that become end members.

    Attributes
    ----------
    mineral : Mineral of all spectra that `metadata` does not name.
    metadata : Table by id: mineral, fo, fs, en, wo, an (0 to 1), min_um, max_um, source; or, instead of the mineral,
        modes vol_ol, vol_opx, vol_cpx, vol_plg and opx_fs, cpx_fs and the like. Mixtures are left out.
    source : Where spectra come from whose source is unknown.
    wavelength_unit : Unit of the wavelengths.
    reflectance_unit : Unit of the reflectance.
    """

    mineral: Literal["olivine", "orthopyroxene", "clinopyroxene", "plagioclase", "opaque", "glass", "other"] | None = (
        None
    )
    metadata: str | Any | None = None
    source: str = ""
    wavelength_unit: Literal["nm", "um", "angstrom", "1/cm"] | None = None
    reflectance_unit: Literal["fraction", "percent"] | None = None
