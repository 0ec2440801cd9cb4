"""Products of maps that work on one spectrum after the other: shares of minerals, and craters of like composition."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.errors import ParameterError
from lunarsci.spectra.cubes.output import NO_CODE, Layer
from lunarsci.spectra.jobs.map_products import BandsProduct, FitProduct, slug

if TYPE_CHECKING:
    from lunarsci.arrays import FloatArray
    from lunarsci.spectra.jobs.map import MapRequest
    from lunarsci.spectra.spectrum import Spectrum


@dataclass(frozen=True, slots=True)
class UnmixProduct:
    """Shares of minerals as the networks of `lunarsci.unmix` foretell them, in all pixels at once."""

    name: ClassVar[str] = "unmix"
    slow: ClassVar[bool] = False
    kind: Any

    @classmethod
    def of(cls, request: "MapRequest") -> "UnmixProduct":
        return cls(request.kind)

    @property
    def layers(self) -> Sequence[Layer]:
        from lunarsci.spectra.abundance.kinds import KINDS
        from lunarsci.spectra.abundance.learned import MINERALS

        found = []
        for mineral in MINERALS:
            found.append(Layer(f"share_{mineral}", f"share of {mineral} by volume"))
            found += [Layer(f"share_{mineral}_{end}", f"{end} end of its interval of 68 %") for end in ("low", "high")]
        domain = ("out_of_domain", "in_domain")
        return [
            *found,
            Layer("kind", "kind of target", meanings=tuple(slug(name) for name in KINDS)),
            Layer("shares_in_domain", "whether all shares are likely within 15 %", meanings=domain),
        ]

    @property
    def tables(self) -> Sequence[str]:
        from lunarsci.spectra.abundance.kinds import TABLE as KIND_TABLE
        from lunarsci.spectra.abundance.learned import TABLE as NETWORKS
        from lunarsci.spectra.abundance.shares import TABLE as CALIBRATION

        return (NETWORKS, KIND_TABLE, CALIBRATION)

    @property
    def sources(self) -> Sequence[str]:
        from lunarsci.spectra.jobs.unmix import LEARNED

        return (LEARNED,)

    def measure(self, wavelength_nm: "FloatArray", reflectance: "FloatArray", places: Any) -> Mapping[str, Any]:
        """Each layer of spectra; those with the same channels together."""
        import numpy as np

        from lunarsci.spectra.abundance.kinds import KINDS, kinds_of_rows
        from lunarsci.spectra.abundance.learned import MINERALS, foretell
        from lunarsci.spectra.abundance.shares import shares_of_rows

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
            allowed = np.ones((rows.size, len(MINERALS)))
            rock = np.full(rows.size, float(self.kind == "solid-rock"))
            mean, ends, inside = shares_of_rows(foretell(channels, part, allowed), allowed, dark, rock, weathered)
            soil = kind == KINDS.index("weathered-soil")
            for k, mineral in enumerate(MINERALS):
                for name, own in (("", mean[:, k]), ("_low", ends[:, k, 0]), ("_high", ends[:, k, 1])):
                    values[f"share_{mineral}{name}"][rows] = np.where(soil, np.nan, own)
            values["shares_in_domain"][rows] = inside
            values["kind"][rows] = np.where(kind < 0, NO_CODE, kind)
        return values


@dataclass(frozen=True, slots=True)
class MatchProduct:
    """Which craters' composition a pixel has, as `lunarsci.match` compares its bands and its pyroxenes."""

    name: ClassVar[str] = "match"
    slow: ClassVar[bool] = True
    bands: BandsProduct
    fit: FitProduct
    craters: str | None

    @classmethod
    def of(cls, request: "MapRequest") -> "MatchProduct":
        made = cls(BandsProduct.of(request), FitProduct.of(request), request.craters)
        if not made.names:
            raise ParameterError(
                "no candidate has a known composition that pixels could have; name a table of craters as `craters`"
            )
        return made

    @property
    def names(self) -> Sequence[str]:
        """Of the craters whose composition is known."""
        from lunarsci.inputs import read_input
        from lunarsci.spectra.origin.catalogue import embedded_catalogue, read_catalogue

        found = embedded_catalogue() if self.craters is None else read_catalogue(read_input(self.craters))
        return [crater.name for crater in found if crater.composition.known]

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
        from lunarsci.spectra.origin.catalogue import TABLE

        return () if self.craters else (TABLE,)

    @property
    def sources(self) -> Sequence[str]:
        return ()

    def measure(self, wavelength_nm: "FloatArray", reflectance: "FloatArray", places: Any) -> Mapping[str, Any]:
        """Each layer of spectra."""
        import numpy as np

        from lunarsci.errors import DataError
        from lunarsci.spectra.jobs.bands import bands
        from lunarsci.spectra.jobs.fit import fit
        from lunarsci.spectra.jobs.match import match
        from lunarsci.spectra.origin.prior import CHANG_E_4

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
            for found in match(results, **how).matches:
                by_name = {item.crater.name: item.ln_bayes_factor for item in found.craters}
                factors[int(found.rock.id)] = [by_name[name] for name in names]
        known = np.isfinite(factors).all(axis=1)
        best = np.where(np.max(factors, axis=1, initial=-np.inf) > 0, 1 + np.argmax(factors, axis=1), 0)
        values = {f"ln_bayes_factor_{slug(name)}": factors[:, k] for k, name in enumerate(names)}
        return values | {"nearest_crater": np.where(known, best, NO_CODE)}


def _spectra(wavelength_nm: "FloatArray", reflectance: "FloatArray") -> "list[Spectrum]":
    """Rows as spectra that are called by their number."""
    from lunarsci.spectra.spectrum import Spectrum

    return [Spectrum(str(row), wavelength_nm, values) for row, values in enumerate(reflectance)]
