"""What a map holds: the layers of each product, and how they are measured on many spectra of one cube.

A product takes spectra as rows of an array and gives an array for each layer. It is the function that the command of
its name calls with one spectrum, so that a pixel of a map and that command agree.
"""

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.spectra.cubes.output import NO_CODE, Layer
from lunarsci.spectra.jobs.fit import DEFAULT_ASSEMBLAGE

if TYPE_CHECKING:
    from lunarsci.arrays import FloatArray
    from lunarsci.spectra.cubes.blocks import Product
    from lunarsci.spectra.jobs.map import MapRequest
    from lunarsci.spectra.mgm.model import MgmModel


def products_of(request: "MapRequest") -> "list[Product]":
    """What is asked for, in the order of `PRODUCTS`. Raises ParameterError for settings that are impossible."""
    from lunarsci.spectra.jobs.map import PRODUCTS
    from lunarsci.spectra.jobs.map_shares import MatchProduct, UnmixProduct

    makers: dict[str, Callable[[MapRequest], Product]] = {
        "bands": BandsProduct.of,
        "indices": IndicesProduct.of,
        "fit": FitProduct.of,
        "unmix": UnmixProduct.of,
        "match": MatchProduct.of,
    }
    return [makers[name](request) for name in PRODUCTS if name in request.wanted and name in makers]


_BAND_COLUMNS = {
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


@dataclass(frozen=True, slots=True)
class BandsProduct:
    """The 1 and 2 um bands, as `lunarsci.bands` measures them."""

    name: ClassVar[str] = "bands"
    slow: ClassVar[bool] = False
    continuum: Any
    smooth_nm: float

    @classmethod
    def of(cls, request: "MapRequest") -> "BandsProduct":
        from lunarsci.spectra.spectrum import Smoothing

        Smoothing(window_nm=request.smooth_nm)
        return cls(request.band_continuum, request.smooth_nm)

    @property
    def layers(self) -> Sequence[Layer]:
        from lunarsci.spectra.band_status import BANDS, STATUSES
        from lunarsci.spectra.continuum import CONTINUA

        found = []
        for band in BANDS:
            found += [
                Layer(name.format(band.key), text.format(band.key), unit)
                for name, (_, text, unit) in _BAND_COLUMNS.items()
            ]
            found.append(Layer(f"band{band.key}_continuum", "continuum that was used", meanings=tuple(CONTINUA)))
            found.append(Layer(f"band{band.key}_status", "whether there is a band, or why not", meanings=STATUSES))
            found.append(Layer(f"band{band.key}_note", "why the wanted continuum was not used", meanings=STATUSES))
        return found

    @property
    def tables(self) -> Sequence[str]:
        return ()

    @property
    def sources(self) -> Sequence[str]:
        from lunarsci.constants import PAPER, SMOOTHING

        return (PAPER, SMOOTHING)

    def measure(self, wavelength_nm: "FloatArray", reflectance: "FloatArray", places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        import numpy as np

        from lunarsci.spectra.bands import band_arrays
        from lunarsci.spectra.spectrum import Smoothing

        smoothing = Smoothing(window_nm=self.smooth_nm)
        found = band_arrays(wavelength_nm, reflectance, continuum_name=self.continuum, smoothing=smoothing)
        values: dict[str, Any] = {}
        for key, band in found.bands.items():
            values |= {name.format(key): getattr(band, attribute) for name, (attribute, _, _) in _BAND_COLUMNS.items()}
            values[f"band{key}_continuum"] = np.where(np.isfinite(band.center_nm), band.continuum, NO_CODE)
            values |= {f"band{key}_status": band.status, f"band{key}_note": band.note}
        return values


@dataclass(frozen=True, slots=True)
class IndicesProduct:
    """Spectral indices, as `lunarsci.indices` computes them."""

    name: ClassVar[str] = "indices"
    slow: ClassVar[bool] = False

    @classmethod
    def of(cls, request: "MapRequest") -> "IndicesProduct":
        return cls()

    @property
    def layers(self) -> Sequence[Layer]:
        from lunarsci.spectra.indices import INDICES, STATUSES

        found = []
        for name, index in INDICES.items():
            unit = {"-": "1", "wt %": "%", "1/µm": "um-1"}[index.unit]
            found += [Layer(name, index.title, unit), Layer(f"{name}_sigma", "its standard error", unit)]
            found.append(Layer(f"{name}_interpolation", "what another interpolation of channels differs by", unit))
            found.append(Layer(f"{name}_status", f"whether there is {index.title}", meanings=STATUSES))
        return found

    @property
    def tables(self) -> Sequence[str]:
        return ()

    @property
    def sources(self) -> Sequence[str]:
        from lunarsci.spectra.indices import INDICES

        return tuple(dict.fromkeys(index.source for index in INDICES.values()))

    def measure(self, wavelength_nm: "FloatArray", reflectance: "FloatArray", places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        from lunarsci.spectra.indices import index_arrays

        values: dict[str, Any] = {}
        for name, found in index_arrays(wavelength_nm, reflectance).items():
            values |= {name: found.value, f"{name}_sigma": found.sigma}
            values |= {f"{name}_interpolation": found.interpolation, f"{name}_status": found.status}
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
class FitProduct:
    """The Modified Gaussian Model, as `lunarsci.fit` fits it; with `contest_every` above 0 as `fit_region` does."""

    name: ClassVar[str] = "fit"
    slow: ClassVar[bool] = False
    assemblage: str
    continuum: Any
    model_error: float | None
    starts: int
    contest_every: int = 0

    @classmethod
    def of(cls, request: "MapRequest") -> "FitProduct":
        assemblage = request.assemblage or DEFAULT_ASSEMBLAGE
        model_of(assemblage, request.continuum)
        every = request.contest_every if request.neighbours else 0
        return cls(assemblage, request.continuum, request.model_error, request.starts, every)

    @property
    def layers(self) -> Sequence[Layer]:
        found = []
        for band in model_of(self.assemblage, self.continuum).assemblage.bands:
            stem, told = slug(band.name), f"of {band.name}"
            for name, text, unit in _BAND_PARTS:
                found.append(Layer(f"{stem}_{name.format('')}", f"{text} {told}", unit))
                found.append(Layer(f"{stem}_{name.format('_sigma')}", f"its standard error ({told})", unit))
        for region in ("um1", "um2"):
            found.append(
                Layer(f"nbsr_{region}_opx", f"normalised band strength ratio of orthopyroxene, {region[2]} um")
            )
            found.append(Layer(f"nbsr_{region}_sigma", "its standard error"))
        return [
            *found,
            Layer("fit_rms_ln", "root mean square of what the fit leaves of ln reflectance"),
            Layer("fit_reduced_chi2", "chi square over its degrees of freedom"),
            Layer("fit_flags", "what to know about the fit", meanings=FIT_FLAGS, bits=True),
            Layer("fit_origin", "where the minimum of the fit was found", meanings=ORIGINS),
        ]

    @property
    def tables(self) -> Sequence[str]:
        from lunarsci.spectra.mgm.assemblages import TABLES

        return TABLES

    @property
    def sources(self) -> Sequence[str]:
        from lunarsci.constants import MGM, NBSR

        return (MGM, NBSR)

    def measure(self, wavelength_nm: "FloatArray", reflectance: "FloatArray", places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        import numpy as np

        from lunarsci.spectra.mgm.batch import NOT_FITTED
        from lunarsci.spectra.mgm.result import UNLIKE_RMS

        model = model_of(self.assemblage, self.continuum)
        fits, origin, unsettled = self._fitted(wavelength_nm, reflectance, places)
        values: dict[str, Any] = {"fit_rms_ln": fits.rms_ln, "fit_reduced_chi2": fits.reduced_chi2}
        sigma = fits.sigma
        for k, band in enumerate(model.assemblage.bands):
            for part, (name, _, unit) in enumerate(_BAND_PARTS):
                column, factor = model.degrees + 3 * k + part, 1e3 if unit == "nm" else 1.0
                values[f"{slug(band.name)}_{name.format('')}"] = fits.values[:, column] * factor
                values[f"{slug(band.name)}_{name.format('_sigma')}"] = sigma[:, column] * factor
        for region, found in (("um1", fits.um1), ("um2", fits.um2)):
            values[f"nbsr_{region}_opx"], values[f"nbsr_{region}_sigma"] = found[:, 0], found[:, 2]
        missing = fits.status == NOT_FITTED
        with np.errstate(invalid="ignore"):
            told = (~fits.converged, fits.ambiguous, fits.strained.any(axis=1), fits.rms_ln > UNLIKE_RMS, unsettled)
        flags = sum(((one & ~missing) * np.uint8(2 << k) for k, one in enumerate(told)), missing.astype(np.uint8))
        return values | {"fit_flags": flags, "fit_origin": origin}

    def _fitted(self, wavelength_nm: "FloatArray", reflectance: "FloatArray", places: Any) -> tuple[Any, Any, Any]:
        """Fits, where their minima were found, and whether neighbours still disagree."""
        import numpy as np

        how: dict[str, Any] = {"model_error": self.model_error, "starts": self.starts}
        model = model_of(self.assemblage, self.continuum)
        if self.contest_every:
            from lunarsci.spectra.mgm.region import fit_region

            found = fit_region(wavelength_nm, reflectance, places, model, **how, contest_every=self.contest_every)
            return found.batch, found.origin, found.unsettled
        from lunarsci.spectra.mgm.fit import fit_arrays

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
def model_of(assemblage: str, continuum: Any) -> "MgmModel":
    """The model of an assemblage under a continuum. Raises ParameterError for one that is unknown."""
    from lunarsci.spectra.mgm.model import mgm_model

    return mgm_model(assemblage, continuum)
