"""Products of maps that work on one spectrum after the other: shares of minerals, and craters of like composition."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.errors import ParameterError
from lunarsci.spectra.cubes.output import NO_CODE, Layer
from lunarsci.spectra.jobs.map_products import BandsProduct, FitProduct, slug

if TYPE_CHECKING:
    from lunarsci.arrays import BoolArray, FloatArray
    from lunarsci.spectra.jobs.map import MapRequest
    from lunarsci.spectra.spectrum import Spectrum


@dataclass(frozen=True, slots=True)
class UnmixProduct:
    """Shares of minerals as the networks of `lunarsci.unmix` foretell them, in all pixels at once.

    `both` : whether mixtures of end members are fitted beside, pixel by pixel. `minerals` : those that there may be.
    """

    name: ClassVar[str] = "unmix"
    kind: Any
    minerals: tuple[str, ...]
    both: bool = False

    @classmethod
    def of(cls, request: "MapRequest") -> "UnmixProduct":
        from lunarsci.spectra.jobs.map import weighed

        return cls(request.kind, tuple(weighed(request)), request.both)

    @property
    def slow(self) -> bool:
        return self.both

    @property
    def methods(self) -> Mapping[str, str]:
        """End of the names of layers of each method."""
        return {"learned": ""} | ({"learned and mixtures": "_both"} if self.both else {})

    @property
    def layers(self) -> Sequence[Layer]:
        from lunarsci.spectra.abundance.kinds import KINDS

        found, domain = [], ("out_of_domain", "in_domain")
        for method, own in self.methods.items():
            for mineral in self.minerals:
                name = f"share_{mineral}{own}"
                found.append(Layer(name, f"share of {mineral} by volume, method: {method}"))
                found += [Layer(f"{name}_{end}", f"{end} end of its interval of 68 %") for end in ("low", "high")]
            if not own:
                found.append(Layer("kind", "kind of target", meanings=tuple(slug(name) for name in KINDS)))
            meaning = f"whether all shares are likely within 15 %, method: {method}"
            found.append(Layer(f"shares{own}_in_domain", meaning, meanings=domain))
        return found

    @property
    def tables(self) -> Sequence[str]:
        from lunarsci.spectra.abundance.end_members import TABLE as END_MEMBERS
        from lunarsci.spectra.abundance.kinds import TABLE as KIND_TABLE
        from lunarsci.spectra.abundance.learned import TABLE as NETWORKS
        from lunarsci.spectra.abundance.shares import TABLE as CALIBRATION

        return (NETWORKS, KIND_TABLE, CALIBRATION, *([END_MEMBERS] if self.both else ()))

    @property
    def sources(self) -> Sequence[str]:
        from lunarsci.spectra.jobs.unmix import LAWS, LEARNED

        return (LEARNED, *(LAWS["both"] if self.both else ()))

    def measure(self, wavelength_nm: "FloatArray", reflectance: "FloatArray", places: Any) -> Mapping[str, Any]:
        """Each layer of spectra; those with the same channels together."""
        import numpy as np

        from lunarsci.spectra.abundance.kinds import KINDS, kinds_of_rows

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
            for own in self.methods.values():
                values[f"shares{own}_in_domain"][rows] = 0
            if (kept := kind != KINDS.index("weathered-soil")).any():
                found = self._shares(channels, part[kept], dark[kept], weathered[kept])
                for name, numbers in found.items():
                    values[name][rows[kept]] = numbers
        return values

    def _shares(
        self, wavelength_nm: "FloatArray", reflectance: "FloatArray", dark: "FloatArray", weathered: "BoolArray"
    ) -> Mapping[str, Any]:
        """Layers of spectra of the same channels."""
        import numpy as np

        from lunarsci.spectra.abundance.known_modes import KnownModes
        from lunarsci.spectra.abundance.learned import MINERALS, foretell
        from lunarsci.spectra.abundance.shares import shares_of_rows
        from lunarsci.spectra.jobs.unmix import UnmixRequest, mixed_estimate

        allowed = np.tile([float(name in self.minerals) for name in MINERALS], (len(reflectance), 1))
        rock = np.full(len(reflectance), float(self.kind == "solid-rock"))
        foretold, values = foretell(wavelength_nm, reflectance, allowed), dict[str, Any]()
        for own in self.methods.values():
            mixed = None
            if own:
                spectra = _spectra(wavelength_nm, reflectance)
                mixed = mixed_estimate(spectra, foretold, allowed, KnownModes({}, {}), None, UnmixRequest(), None)
            mean, ends, inside = shares_of_rows(foretold, allowed, dark, rock, weathered, mixed)
            values[f"shares{own}_in_domain"] = inside
            for k in map(MINERALS.index, self.minerals):
                name = f"share_{MINERALS[k]}{own}"
                values |= {name: mean[:, k], f"{name}_low": ends[:, k, 0], f"{name}_high": ends[:, k, 1]}
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
