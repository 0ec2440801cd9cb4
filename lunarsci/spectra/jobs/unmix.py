"""`lunarsci.unmix`: shares of minerals by mixing end members, for the assemblage of a fit."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal

from lunarsci.constants import ABSORBANCE, HAPKE, WEATHERING
from lunarsci.errors import ParameterError
from lunarsci.names import some_of
from lunarsci.result import job, request_of
from lunarsci.spectra.jobs.fit import MgmFits, ModelRequest, Progress, fit_batch_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lunarsci.inputs import InputFile
    from lunarsci.spectra.abundance.kinds import Kind, KindVerdict
    from lunarsci.spectra.abundance.known_modes import KnownModes
    from lunarsci.spectra.abundance.normative import Normative
    from lunarsci.spectra.abundance.result import Abundance
    from lunarsci.spectra.library.end_member import EndMember
    from lunarsci.spectra.mgm.result import MgmFit
    from lunarsci.spectra.readers.batch import SpectraSource
    from lunarsci.spectra.spectrum import Spectrum


SOURCES = {"hapke": (HAPKE,), "absorbance": (ABSORBANCE,), "both": (HAPKE, ABSORBANCE), "auto": (HAPKE, ABSORBANCE)}
SOILS = (
    "Lucey, Blewett & Jolliff (2000), J. Geophys. Res. 105, 20297, 10.1029/1999JE001117",
    "Taylor, Pieters, Keller, Morris & McKay (2001), J. Geophys. Res. 106, 27985, 10.1029/2000JE001402",
)
LEAST_MINERALS, MOST_NAMED = 2, 5
ON_POWDERS = "its calibration is of mixed powders, and the kind stated is"
REFUSED = "a surface that space has weathered, whose glass and iron no mixture of powders stands for"


@dataclass(frozen=True, kw_only=True)
class UnmixRequest(ModelRequest):
    """The model that says which minerals are there, and how they are mixed.

    Attributes
    ----------
    kind : of the target; `auto`: found for each spectrum.
    method : mixing law, or both, weighted by their evidence; `auto`: both together, Hapke's one by one, where both were
        no better on measured suites.
    library : file of end members, instead of the embedded ones.
    together : whether all spectra are mixtures of the same powders.
    known : table of mixtures whose modes are known; implies `together`.
    opaque, iron : whether there surely is an opaque powder, or nanophase iron on all grains; one by one, these, others
        and none compete otherwise. With `together` they are allowed, else there is none.
    """

    kind: Literal["auto", "powder-mixture", "dark-rock-powder", "weathered-soil", "solid-rock"] = "auto"
    method: Literal["auto", "both", "hapke", "absorbance"] = "auto"
    library: str | None = None
    together: bool = False
    known: str | None = None
    opaque: bool = False
    iron: bool = False

    def _faults(self) -> tuple[tuple[Any, str], ...]:
        wrong = self.method == "absorbance" and self.iron
        return ((wrong, "`iron` needs `method` auto, hapke or both"), *ModelRequest._faults(self))


@dataclass(frozen=True, kw_only=True, eq=False)
class UnmixedSpectra(MgmFits):
    """Fits with the shares of the minerals that mixtures of end members give, and those of the band strengths.

    Attributes
    ----------
    kinds : of the target, by position, of each that was fitted.
    normatives : composition of those that are weathered, by position.
    """

    request: UnmixRequest
    kinds: "Mapping[int, KindVerdict]" = field(default_factory=dict)
    normatives: "Mapping[int, Normative]" = field(default_factory=dict)

    @property
    def untrusted(self) -> str:
        doubts = [text] if (text := MgmFits.untrusted.fget(self)) else []  # type: ignore[attr-defined]
        names: dict[str, list[str]] = {}
        for found in self.abundances.values():
            if found and not found[0].determined:
                names.setdefault(found[0].status.removeprefix("not determined: "), []).append(found[0].id)
        doubts += [
            f"shares of {some_of(own, MOST_NAMED)} are not determined: {reason}" for reason, own in names.items()
        ]
        return "; ".join(doubts)

    def _record(self, index: int, origin: str) -> dict[str, Any]:
        kind, soil = self.kinds.get(index), self.normatives.get(index)
        return MgmFits._record(self, index, origin) | {
            "kind": kind.to_dict() if kind else None,
            "normative": soil.to_dict() if soil else None,
        }

    def rows(self, *, bands: bool = True) -> list[dict[str, Any]]:
        own = {(record["source"], record["id"]): _kind_columns(record) for record in self.records}
        return [row | own[row["source"], row["id"]] for row in MgmFits.rows(self, bands=bands)]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.spectra.abundance.normative import normative_pages

        names = [self.records[index]["id"] for index in self.normatives]
        return chain(MgmFits.figures(self), normative_pages(names, list(self.normatives.values())))

    def _tables_and_sources(self) -> tuple[list[str], list[str]]:
        from lunarsci.spectra.abundance.end_members import TABLE
        from lunarsci.spectra.abundance.kinds import TABLE as KIND_TABLE
        from lunarsci.spectra.abundance.mixing import IRON_TABLE
        from lunarsci.spectra.abundance.normative import TABLE as SOIL_TABLE
        from lunarsci.spectra.abundance.posterior import TABLE as CALIBRATION_TABLE

        tables, sources = MgmFits._tables_and_sources(self)
        together = bool(self.request.together or self.request.known)
        iron = self.request.iron or not together
        used = {IRON_TABLE: iron, CALIBRATION_TABLE: not together, SOIL_TABLE: bool(self.normatives)}
        tables += [TABLE, KIND_TABLE, *(name for name, wanted in used.items() if wanted)]
        own = [*SOURCES[self.request.method], *([WEATHERING] if iron else []), *(SOILS if self.normatives else ())]
        return tables, [*sources, *own]


@job
def unmix(
    spectra: "SpectraSource", request: UnmixRequest | None = None, *, progress: Progress | None = None, **options: Any
) -> UnmixedSpectra:
    """Shares by volume of the minerals of each fit's assemblage, by mixing end members, with intervals.

    Parameters
    ----------
    spectra : files, patterns, tables, `Spectrum`s or (wavelength_nm, reflectance[, sigma]), one or a list.
    request, options : what is asked, and options of `UnmixRequest` that replace its own.
    progress : called with (done, total) of each step.

    Raises
    ------
    RequestError for options that exclude each other; ParameterError for modes of spectra that are not there; DataError
    where no spectrum can be read and fitted, and for end members or spectra that cannot be mixed.
    """
    from lunarsci.inputs import read_input
    from lunarsci.spectra.abundance.nbsr import nbsr_abundances
    from lunarsci.spectra.abundance.normative import normative
    from lunarsci.spectra.library.end_member import read_library
    from lunarsci.spectra.readers.batch import read_batch

    asked = request_of(UnmixRequest, request, options)
    batch = read_batch(spectra, asked.wavelength_unit, asked.reflectance_unit, asked.id)
    found = fit_batch_of(batch, asked, progress)
    shares = {index: list(one) for index, one in nbsr_abundances(found["fits"]).items()}
    fits: dict[int, MgmFit] = {index: found["fits"][index] for index in shares}
    library, known = (read_input(name) if name else None for name in (asked.library, asked.known))
    end_members = read_library(library) if library else None
    modes = _known_modes([fits[index].id for index in fits], known)
    kinds = _kinds({index: batch.spectra[index] for index in fits}, asked)
    _refuse(shares, fits, kinds, asked)
    soils = {index: normative(batch.spectra[index], kind) for index, kind in kinds.items() if kind.is_weathered}
    mixed_ones = [index for index in fits if known or not kinds[index].is_weathered]
    suites = [mixed_ones] if mixed_ones and (asked.together or known) else [[index] for index in mixed_ones]
    for done, suite in enumerate(suites, start=1):
        minerals = _minerals([fits[index] for index in suite], asked)
        if len(minerals) >= LEAST_MINERALS:
            may = [_minerals([fits[index]], asked) for index in suite]
            some = [batch.spectra[index] for index in suite]
            if asked.together or known:
                mixed = _unmixed(some, minerals, may, modes, end_members, asked)
                judged = [
                    one if modes.known.get(one.id) else _judged(one, kinds[k], batch.spectra[k])
                    for k, one in zip(suite, mixed, strict=True)
                ]
            else:
                judged = _one_by_one(some, minerals, [kinds[index] for index in suite], end_members, asked)
            for index, item in zip(suite, judged, strict=True):
                shares[index].insert(0, item)
        if progress:
            progress(done, len(suites))
    files = [*found.pop("files", ()), *(file for file in (library, known) if file)]
    return UnmixedSpectra(
        batch=batch, request=asked, abundances=shares, kinds=kinds, normatives=soils, files=files, **found
    )


def _kind_columns(record: Mapping[str, Any]) -> dict[str, Any]:
    """`kind`, `stranger`, and `normative_feo_wt` and the like."""
    kind, soil = record["kind"] or {}, record["normative"] or {}
    values = {f"normative_{name}": item for name, item in soil.items() if isinstance(item, Mapping)}
    columns = {"kind": kind.get("name"), "stranger": kind.get("stranger")}
    for name, item in values.items():
        stem = name.removesuffix("_wt")
        columns |= {name: item["value"], f"{stem}_low_wt": item["low"], f"{stem}_high_wt": item["high"]}
    return columns


def _kinds(spectra: "Mapping[int, Spectrum]", request: UnmixRequest) -> "dict[int, KindVerdict]":
    """As stated, or found."""
    from lunarsci.spectra.abundance.kinds import find_kinds

    stated: Kind | None = None if request.kind == "auto" else request.kind
    return dict(zip(spectra, find_kinds(list(spectra.values()), stated), strict=True))


def _refuse(
    shares: "dict[int, list[Abundance]]",
    fits: "Mapping[int, MgmFit]",
    kinds: "Mapping[int, KindVerdict]",
    request: UnmixRequest,
) -> None:
    """What is weathered is not unmixed, unless modes of spectra beside it are known; NBSR is of mixed powders alone."""
    from lunarsci.spectra.abundance.result import refused

    for index, fit in fits.items():
        if kinds[index].stated and kinds[index].kind != "powder-mixture":
            shares[index] = [
                refused(
                    one.id, one.method, [item.mineral for item in one.fractions], f"{ON_POWDERS} {kinds[index].kind}"
                )
                for one in shares[index]
            ]
        minerals = _minerals([fit], request)
        if kinds[index].is_weathered and not request.known and len(minerals) >= LEAST_MINERALS:
            shares[index].insert(0, refused(fit.id, _method(request), minerals, _reason(kinds[index])))


def _reason(kind: "KindVerdict") -> str:
    return "; ".join((REFUSED, *kind.reasons))


def _judged(found: "Abundance", kind: "KindVerdict", spectrum: "Spectrum") -> "Abundance":
    """With what its absorption and its kind say of it."""
    from lunarsci.spectra.abundance.band_depth import too_shallow
    from lunarsci.spectra.abundance.result import ROCKS_UNCALIBRATED, refused, without_centres

    if flat := too_shallow(spectrum):
        return refused(found.id, found.method, [item.mineral for item in found.fractions], flat)
    if kind.stranger or kind.is_weathered:
        return without_centres(found, "; ".join(kind.reasons) if kind.stranger else _reason(kind))
    if kind.kind == "solid-rock":
        return replace(found, in_domain=False, status=f"out of domain: {ROCKS_UNCALIBRATED}")
    return found


def _method(request: UnmixRequest) -> str:
    return "unmix" if request.method in ("auto", "both") else request.method


def _one_by_one(
    spectra: "Sequence[Spectrum]",
    minerals: Sequence[str],
    kinds: "Sequence[KindVerdict]",
    end_members: "Sequence[EndMember] | None",
    request: UnmixRequest,
) -> "list[Abundance]":
    """Shares of each spectrum by its kind; of a stranger intervals alone."""
    from lunarsci.spectra.abundance.end_members import OPAQUE
    from lunarsci.spectra.abundance.one_by_one import estimate_each
    from lunarsci.spectra.abundance.result import without_centres

    found = estimate_each(
        spectra,
        [name for name in minerals if name != OPAQUE],
        kinds=kinds,
        method="hapke" if request.method == "auto" else _method(request),
        end_members=end_members,
        opaque=request.opaque,
        iron=request.iron,
    )
    named = [replace(item, method=_method(request)) for item in found]
    return [
        without_centres(item, "; ".join(kind.reasons)) if kind.stranger else item
        for item, kind in zip(named, kinds, strict=True)
    ]


def _unmixed(
    suite: "Sequence[Spectrum]",
    minerals: Sequence[str],
    may: Sequence[Sequence[str]],
    modes: "KnownModes",
    end_members: "Sequence[EndMember] | None",
    request: UnmixRequest,
) -> "list[Abundance]":
    """Shares of spectra taken together; `may` names the minerals of each fit."""
    from lunarsci.spectra.abundance.estimate import estimate_series

    known = [modes.known.get(spectrum.id) for spectrum in suite]
    absent = [modes.absent.get(spectrum.id, ()) for spectrum in suite]
    present = [[name for name in own if name not in gone] for own, gone in zip(may, absent, strict=True)]
    found = estimate_series(
        suite,
        minerals,
        method=_method(request),
        end_members=end_members,
        iron=request.iron,
        present=[None if told else own for told, own in zip(known, present, strict=True)],
        known=known,
    )
    return [replace(item, status="modes as stated") if told else item for item, told in zip(found, known, strict=True)]


def _known_modes(names: Sequence[str], file: "InputFile | None") -> "KnownModes":
    """Modes stated of the spectra."""
    from lunarsci.spectra.abundance.known_modes import KnownModes, read_modes

    if file is None:
        return KnownModes({}, {})
    modes = read_modes(file)
    told = {*modes.known, *modes.absent}
    doubled = [name for name in names if name in told and names.count(name) > 1]
    if doubled:
        raise ParameterError(f"{file.name}: '{doubled[0]}' is the id of two spectra; give each its own")
    if names and not told & set(names):
        raise ParameterError(f"{file.name}: none of its ids is that of a spectrum, such as '{names[0]}'")
    return modes


def _minerals(fits: "Sequence[MgmFit]", request: UnmixRequest) -> list[str]:
    """Those of the fits' assemblages, in the order of `FAMILY_OF`, then the opaque one if allowed.

    Raises ParameterError for a mineral without end members.
    """
    from lunarsci.spectra.abundance.end_members import FAMILY_OF, OPAQUE

    named = {mineral for item in fits for mineral in item.model.assemblage.minerals}
    if strange := sorted(named - {*FAMILY_OF, "any"}):
        raise ParameterError(f"{strange[0]} has no end member to mix; leave it out of `assemblage`, or only fit")
    return [name for name in FAMILY_OF if name in named] + [OPAQUE] * request.opaque
