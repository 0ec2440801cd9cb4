"""What a map holds: the layers of each product, and how they are measured on many spectra of one cube.

A product takes spectra as rows of an array and gives an array for each layer. It is the function that the command of
its name calls with one spectrum, so that a pixel of a map and that command agree.
"""

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.constants import MGM, NBSR, PAPER, SMOOTHING
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import TABLE as END_MEMBERS
from lunarsci.spectra.abundance.end_members import StatedModes
from lunarsci.spectra.abundance.kinds import KINDS, kinds_of_rows
from lunarsci.spectra.abundance.kinds import TABLE as KIND_TABLE
from lunarsci.spectra.abundance.learned import TABLE as NETWORKS
from lunarsci.spectra.abundance.learned import foretell
from lunarsci.spectra.abundance.shares import TABLE as CALIBRATION
from lunarsci.spectra.abundance.shares import shares_of_rows
from lunarsci.spectra.band_status import BANDS, STATUSES
from lunarsci.spectra.bands import band_arrays
from lunarsci.spectra.continuum import CONTINUA
from lunarsci.spectra.cubes.output import NO_CODE, Layer, Product
from lunarsci.spectra.indices import INDICES, index_arrays
from lunarsci.spectra.indices import STATUSES as INDEX_STATUSES
from lunarsci.spectra.jobs.bands import bands
from lunarsci.spectra.jobs.fit import fit
from lunarsci.spectra.jobs.match import match
from lunarsci.spectra.jobs.requests import DEFAULT_ASSEMBLAGE, PRODUCTS, MapRequest, UnmixRequest
from lunarsci.spectra.jobs.unmix import LAWS, LEARNED, mixed_estimate, named_minerals
from lunarsci.spectra.mgm.assemblages import TABLES
from lunarsci.spectra.mgm.batch import NOT_FITTED
from lunarsci.spectra.mgm.fit import fit_arrays
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.region import fit_region
from lunarsci.spectra.mgm.result import UNLIKE_RMS
from lunarsci.spectra.origin.catalogue import TABLE, embedded_catalogue, read_catalogue
from lunarsci.spectra.origin.prior import CHANG_E_4
from lunarsci.spectra.spectrum import Smoothing, Spectrum

BAND_LAYERS = {
    "bc{}_nm": ("center_nm", "centre of the {} nm band", "nm"),
    "bc{}_sigma_nm": ("center_sigma_nm", "its standard error", "nm"),
    "bc{}_systematic_nm": ("center_systematic_nm", "half its range over continua", "nm"),
    "bc{}_gaussian_nm": ("center_gaussian_nm", "half its difference from the centre of a Gaussian", "nm"),
    "bc{}_method_nm": ("center_method_nm", "what methods differ by, the larger of these two", "nm"),
    "bd{}": ("depth", "depth of the {} nm band", "1"),
    "bd{}_sigma": ("depth_sigma", "its standard error", "1"),
    "ba{}_nm": ("area_nm", "area of the {} nm band", "nm"),
    "ba{}_sigma_nm": ("area_sigma_nm", "its standard error", "nm"),
    "bas{}": ("asymmetry", "asymmetry of the {} nm band", "1"),
    "bas{}_sigma": ("asymmetry_sigma", "its standard error", "1"),
}
"""Name of a layer of a band, with the attribute of `band_arrays` that it holds, its title and its unit."""


def products_of(request: MapRequest) -> list[Product]:
    """What is asked for, in the order of `PRODUCTS`. Raises ParameterError for settings that are impossible."""
    makers: dict[str, Callable[[MapRequest], Product]] = {
        "bands": BandsProduct.of,
        "indices": IndicesProduct.of,
        "fit": FitProduct.of,
        "unmix": UnmixProduct.of,
        "match": MatchProduct.of,
    }
    return [makers[name](request) for name in PRODUCTS if name in request.wanted and name in makers]


@dataclass(frozen=True, slots=True)
class BandsProduct(Product):
    """The 1 and 2 um bands, as `lunarsci.bands` measures them."""

    name: ClassVar[str] = "bands"
    reasons: ClassVar[Sequence[str]] = tuple(f"band{band.key}_status" for band in BANDS)
    continuum: Any
    smooth_nm: float

    @classmethod
    def of(cls, request: MapRequest) -> "BandsProduct":
        Smoothing(window_nm=request.smooth_nm)
        return cls(request.band_continuum, request.smooth_nm)

    @property
    def layers(self) -> Sequence[Layer]:
        result = []
        for band in BANDS:
            result += [
                Layer(name.format(band.key), text.format(band.key), unit)
                for name, (_, text, unit) in BAND_LAYERS.items()
            ]
            result.append(Layer(f"band{band.key}_continuum", "continuum that was used", meanings=tuple(CONTINUA)))
            result.append(Layer(f"band{band.key}_status", "whether there is a band, or why not", meanings=STATUSES))
            result.append(Layer(f"band{band.key}_note", "why the wanted continuum was not used", meanings=STATUSES))
        return result

    @property
    def sources(self) -> Sequence[str]:
        return (PAPER, SMOOTHING)

    def measure(self, wavelength_nm: FloatArray, reflectance: FloatArray, places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        smoothing = Smoothing(window_nm=self.smooth_nm)
        result = band_arrays(wavelength_nm, reflectance, continuum_name=self.continuum, smoothing=smoothing)
        values: dict[str, Any] = {}
        for key, band in result.bands.items():
            values |= {name.format(key): getattr(band, attribute) for name, (attribute, _, _) in BAND_LAYERS.items()}
            values[f"band{key}_continuum"] = np.where(np.isfinite(band.center_nm), band.continuum, NO_CODE)
            values |= {f"band{key}_status": band.status, f"band{key}_note": band.note}
        return values


@dataclass(frozen=True, slots=True)
class IndicesProduct(Product):
    """Spectral indices, as `lunarsci.indices` computes them."""

    name: ClassVar[str] = "indices"
    reasons: ClassVar[Sequence[str]] = tuple(f"{name}_status" for name in INDICES)

    @classmethod
    def of(cls, request: MapRequest) -> "IndicesProduct":
        return cls()

    @property
    def layers(self) -> Sequence[Layer]:
        result = []
        for name, index in INDICES.items():
            unit = {"-": "1", "wt %": "%", "1/µm": "um-1"}[index.unit]
            result += [Layer(name, index.title, unit), Layer(f"{name}_sigma", "its standard error", unit)]
            result.append(Layer(f"{name}_interpolation", "what another interpolation of channels differs by", unit))
            result.append(Layer(f"{name}_status", f"whether there is {index.title}", meanings=INDEX_STATUSES))
        return result

    @property
    def sources(self) -> Sequence[str]:
        return tuple(dict.fromkeys(index.source for index in INDICES.values()))

    def measure(self, wavelength_nm: FloatArray, reflectance: FloatArray, places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        values: dict[str, Any] = {}
        for name, result in index_arrays(wavelength_nm, reflectance).items():
            values |= {name: result.value, f"{name}_sigma": result.sigma}
            values |= {f"{name}_interpolation": result.interpolation, f"{name}_status": result.status}
        return values


_BAND_PARTS = (
    ("center{}_nm", "centre", "nm"),
    ("fwhm{}_nm", "full width at half strength", "nm"),
    ("strength{}", "strength, ln of reflectance", "1"),
)
FIT_FLAGS = ("not_fitted", "not_converged", "ambiguous", "strained", "unlike", "neighbours_disagree")
ORIGINS = ("single_descent", "from_neighbour", "contest", "not_fitted")
"""Those of `lunarsci.spectra.mgm.region`, which is too heavy to import for its names; a test compares them."""
CONTEST = ORIGINS.index("contest")


@dataclass(frozen=True, slots=True)
class FitProduct(Product):
    """The Modified Gaussian Model, as `lunarsci.fit` fits it; with `contest_every` above 0 as `fit_region` does."""

    name: ClassVar[str] = "fit"
    reasons: ClassVar[Sequence[str]] = ("fit_flags",)
    assemblage: str
    continuum: Any
    model_error: float | None
    starts: int
    contest_every: int = 0

    @classmethod
    def of(cls, request: MapRequest) -> "FitProduct":
        assemblage = request.assemblage or DEFAULT_ASSEMBLAGE
        model_of(assemblage, request.continuum)
        every = request.contest_every if request.neighbours else 0
        return cls(assemblage, request.continuum, request.model_error, request.starts, every)

    @property
    def layers(self) -> Sequence[Layer]:
        result = []
        for band in model_of(self.assemblage, self.continuum).assemblage.bands:
            stem, of_band = slug(band.name), f"of {band.name}"
            for name, text, unit in _BAND_PARTS:
                result.append(Layer(f"{stem}_{name.format('')}", f"{text} {of_band}", unit))
                result.append(Layer(f"{stem}_{name.format('_sigma')}", f"its standard error ({of_band})", unit))
        for region in ("um1", "um2"):
            result.append(
                Layer(f"nbsr_{region}_opx", f"normalised band strength ratio of orthopyroxene, {region[2]} um")
            )
            result.append(Layer(f"nbsr_{region}_sigma", "its standard error"))
        return [
            *result,
            Layer("fit_rms_ln", "root mean square of what the fit leaves of ln reflectance"),
            Layer("fit_reduced_chi2", "chi square over its degrees of freedom"),
            Layer("fit_flags", "what to know about the fit", meanings=FIT_FLAGS, bits=True),
            Layer("fit_origin", "where the minimum of the fit was found", meanings=ORIGINS),
        ]

    @property
    def tables(self) -> Sequence[str]:
        return TABLES

    @property
    def sources(self) -> Sequence[str]:
        return (MGM, NBSR)

    def lacking(self, wavelength_nm: FloatArray) -> str:
        """Why these channels are too few to fit, whatever a pixel has in them; '' where they are enough."""
        from lunarsci.spectra.mgm.data import fitted_channels

        try:
            fitted_channels(wavelength_nm)
        except DataError as error:
            return str(error)
        return ""

    def measure(self, wavelength_nm: FloatArray, reflectance: FloatArray, places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        model = model_of(self.assemblage, self.continuum)
        fits, origin, unsettled = self._fitted(wavelength_nm, reflectance, places)
        values: dict[str, Any] = {"fit_rms_ln": fits.rms_ln, "fit_reduced_chi2": fits.reduced_chi2}
        sigma = fits.sigma
        for k, band in enumerate(model.assemblage.bands):
            for part, (name, _, unit) in enumerate(_BAND_PARTS):
                column, factor = model.degrees + 3 * k + part, 1e3 if unit == "nm" else 1.0
                values[f"{slug(band.name)}_{name.format('')}"] = fits.values[:, column] * factor
                values[f"{slug(band.name)}_{name.format('_sigma')}"] = sigma[:, column] * factor
        for region, result in (("um1", fits.um1), ("um2", fits.um2)):
            values[f"nbsr_{region}_opx"], values[f"nbsr_{region}_sigma"] = result[:, 0], result[:, 2]
        missing = fits.status == NOT_FITTED
        with np.errstate(invalid="ignore"):
            flagged = (~fits.converged, fits.ambiguous, fits.strained.any(axis=1), fits.rms_ln > UNLIKE_RMS, unsettled)
        flags = sum(((one & ~missing) * np.uint8(2 << k) for k, one in enumerate(flagged)), missing.astype(np.uint8))
        return values | {"fit_flags": flags, "fit_origin": origin}

    def _fitted(self, wavelength_nm: FloatArray, reflectance: FloatArray, places: Any) -> tuple[Any, Any, Any]:
        """Fits, where their minima were found, and whether neighbours still disagree."""
        how: dict[str, Any] = {"model_error": self.model_error, "starts": self.starts}
        model = model_of(self.assemblage, self.continuum)
        if self.contest_every:
            result = fit_region(wavelength_nm, reflectance, places, model, **how, contest_every=self.contest_every)
            return result.batch, result.origin, result.unsettled

        fits = fit_arrays(wavelength_nm, reflectance, model, **how)
        origin = np.where(np.isfinite(fits.rms_ln), CONTEST, ORIGINS.index("not_fitted"))
        return fits, origin, np.zeros(len(fits), bool)


def slug(name: str) -> str:
    """A name as NetCDF takes it.

    >>> slug("OPX 1.2 um")
    'opx_1_2_um'
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", "_", plain.lower()).strip("_")


@lru_cache(maxsize=8)
def model_of(assemblage: str, continuum: Any) -> MgmModel:
    """The model of an assemblage under a continuum. Raises ParameterError for one that is unknown."""
    return mgm_model(assemblage, continuum)


@dataclass(frozen=True, slots=True)
class UnmixProduct(Product):
    """Shares of minerals as the networks of `lunarsci.unmix` foretell them, in all pixels at once.

    `both` : whether mixtures of end members are fitted beside, pixel by pixel. `minerals` : those that there may be.
    """

    name: ClassVar[str] = "unmix"
    reasons: ClassVar[Sequence[str]] = ("kind",)
    instead: ClassVar[str] = (
        "a weathered soil has no shares: `bands` and `indices` of `products` measure it, and `lunarsci spectra unmix` "
        "gives the composition of the soil in one pixel (--spectrum)"
    )
    kind: Any
    minerals: tuple[str, ...]
    both: bool = False

    @classmethod
    def of(cls, request: MapRequest) -> "UnmixProduct":
        return cls(request.kind, tuple(minerals_of(request)), request.both)

    @property
    def slow(self) -> bool:
        return self.both

    @property
    def methods(self) -> Mapping[str, str]:
        """End of the names of layers of each method."""
        return {"learned": ""} | ({"learned and mixtures": "_both"} if self.both else {})

    @property
    def layers(self) -> Sequence[Layer]:
        result, domain = [], ("out_of_domain", "in_domain")
        for method, ending in self.methods.items():
            for mineral in self.minerals:
                name = f"share_{mineral}{ending}"
                result.append(Layer(name, f"share of {mineral} by volume, method: {method}"))
                result += [Layer(f"{name}_{end}{level}", f"{end} end of its interval of {level or 68} %")
                          for level in ("", "95") for end in ("low", "high")]  # fmt: skip
            if not ending:
                result.append(Layer("kind", "kind of target", meanings=tuple(slug(name) for name in KINDS)))
            meaning = f"whether the shares are in domain, method: {method}"
            result.append(Layer(f"shares{ending}_in_domain", meaning, meanings=domain))
        return result

    @property
    def tables(self) -> Sequence[str]:
        return (NETWORKS, KIND_TABLE, CALIBRATION, *([END_MEMBERS] if self.both else ()))

    @property
    def sources(self) -> Sequence[str]:
        return (LEARNED, *(LAWS["both"] if self.both else ()))

    def measure(self, wavelength_nm: FloatArray, reflectance: FloatArray, places: Any) -> Mapping[str, Any]:
        """Each layer of spectra; those with the same channels together."""
        count = len(reflectance)
        values: dict[str, Any] = {
            layer.name: np.full(count, NO_CODE, np.int16) if layer.meanings else np.full(count, np.nan)
            for layer in self.layers
        }
        there = np.isfinite(reflectance) & (reflectance > 0)
        patterns, which = np.unique(there, axis=0, return_inverse=True)
        for number, usable in enumerate(patterns):
            rows = np.flatnonzero(which.ravel() == number)
            if not usable.any():
                continue
            channels, part = wavelength_nm[usable], reflectance[np.ix_(rows, usable)]
            kind, dark, weathered = kinds_of_rows(channels, part, None if self.kind == "auto" else self.kind)
            values["kind"][rows] = np.where(kind < 0, NO_CODE, kind)
            for ending in self.methods.values():
                values[f"shares{ending}_in_domain"][rows] = 0
            if (unmixed := kind != KINDS.index("weathered-soil")).any():
                result = self._shares(channels, part[unmixed], dark[unmixed], weathered[unmixed])
                for name, numbers in result.items():
                    values[name][rows[unmixed]] = numbers
        return values

    def _shares(
        self, wavelength_nm: FloatArray, reflectance: FloatArray, dark: FloatArray, weathered: BoolArray
    ) -> Mapping[str, Any]:
        """Layers of spectra of the same channels."""
        allowed = np.tile([float(name in self.minerals) for name in WEIGHED], (len(reflectance), 1))
        rock = np.full(len(reflectance), float(self.kind == "solid-rock"))
        foretold, values = foretell(wavelength_nm, reflectance, allowed), dict[str, Any]()
        for ending in self.methods.values():
            mixed = None
            if ending:
                spectra = _spectra(wavelength_nm, reflectance)
                mixed = mixed_estimate(spectra, foretold, allowed, StatedModes({}, {}), None, UnmixRequest(), None)
            mean, ends, inside = shares_of_rows(foretold, allowed, dark, rock, weathered, mixed)
            values[f"shares{ending}_in_domain"] = inside
            for k in map(WEIGHED.index, self.minerals):
                name = f"share_{WEIGHED[k]}{ending}"
                values[name] = mean[:, k]
                for number, end in enumerate(("low", "high", "low95", "high95")):
                    values[f"{name}_{end}"] = ends[:, k, number]
        return values


@dataclass(frozen=True, slots=True)
class MatchProduct(Product):
    """Which craters' composition a pixel has, as `lunarsci.match` compares its bands and its pyroxenes."""

    name: ClassVar[str] = "match"
    bands: BandsProduct
    fit: FitProduct
    craters: str | None

    @classmethod
    def of(cls, request: MapRequest) -> "MatchProduct":
        made = cls(BandsProduct.of(request), FitProduct.of(request), request.craters)
        if not made.names:
            raise ParameterError(
                "no candidate has a known composition that pixels could have; name a table of craters as `craters`"
            )
        return made

    @property
    def slow(self) -> bool:
        return True

    @property
    def names(self) -> Sequence[str]:
        """Of the craters whose composition is known."""
        result = embedded_catalogue() if self.craters is None else read_catalogue(read_input(self.craters))
        return [crater.name for crater in result if crater.composition.comparable]

    @property
    def layers(self) -> Sequence[Layer]:
        each = [
            Layer(f"ln_bayes_factor_{slug(name)}", f"ln Bayes factor of the composition of {name}, against any")
            for name in self.names
        ]
        names = ("none", *(slug(name) for name in self.names))
        return [*each, Layer("nearest_crater", "crater of the highest ln Bayes factor above 0", meanings=names)]

    @property
    def tables(self) -> Sequence[str]:
        return () if self.craters else (TABLE,)

    def measure(self, wavelength_nm: FloatArray, reflectance: FloatArray, places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        spectra, names = _spectra(wavelength_nm, reflectance), list(self.names)
        how: dict[str, Any] = {"assemblage": self.fit.assemblage, "continuum": self.fit.continuum}
        factors = np.full((len(spectra), len(names)), np.nan)
        results: list[Any] = []
        for job in (
            lambda: bands(spectra, continuum=self.bands.continuum, smooth_nm=self.bands.smooth_nm),
            lambda: fit(spectra, **how, model_error=self.fit.model_error, starts=self.fit.starts),
        ):
            with suppress(DataError):  # none of them has a result
                results.append(job())
        with suppress(DataError):
            site = ",".join(map(str, CHANG_E_4))  # moves the prior alone, and no factor
            how = {"craters": self.craters, "site": site, "exposure": False, "re_excavation": False}
            for result in (one for one in match(results, **how).matches if one.rock.composition.comparable):
                by_name = {item.crater.name: item.ln_bayes_factor for item in result.craters}
                factors[int(result.rock.id)] = [by_name[name] for name in names]
        finite = np.isfinite(factors).all(axis=1)
        best = np.where(np.max(factors, axis=1, initial=-np.inf) > 0, 1 + np.argmax(factors, axis=1), 0)
        values = {f"ln_bayes_factor_{slug(name)}": factors[:, k] for k, name in enumerate(names)}
        return values | {"nearest_crater": np.where(finite, best, NO_CODE)}


def _spectra(wavelength_nm: FloatArray, reflectance: FloatArray) -> list[Spectrum]:
    """Rows as spectra that are called by their number."""
    return [Spectrum(str(row), wavelength_nm, values) for row, values in enumerate(reflectance)]


def minerals_of(request: MapRequest) -> list[str]:
    """Those that unmix weighs."""
    return named_minerals(request.assemblage) if request.assemblage else list(WEIGHED)
