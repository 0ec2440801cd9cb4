"""`lunarsci.unmix`: shares of minerals, by networks and by mixtures of end members.

The way of a spectrum: its kind is found; a soil that space has weathered has no shares (`normative` instead). Networks
foretell the probabilities of shares of all others. Where minerals, end members or modes are stated, mixtures of end
members give such probabilities as well (`mixed_estimate`). `abundances` weighs both, by what they were worth on
sample series left out, and calibrates the outcome.

Two estimates, since neither can do the other's work: networks have no end members that `library`, `together` and
`known` could replace, and mixtures are the worse where nothing is known of the minerals (`docs/science/shares.md`).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.constants import ABSORBANCE, HAPKE, WEATHERING
from lunarsci.errors import DataError, Failure, ParameterError, RequestError, warn
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.io.tables import table_hashes
from lunarsci.minerals import ABBREVIATIONS, WEIGHED, abbreviated
from lunarsci.names import some_of
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Progress, Result, job
from lunarsci.spectra.abundance.end_members import OPAQUE, StatedModes, reaches, read_modes
from lunarsci.spectra.abundance.end_members import TABLE as END_MEMBERS
from lunarsci.spectra.abundance.estimate import estimate_series
from lunarsci.spectra.abundance.kinds import TABLE as KINDS
from lunarsci.spectra.abundance.kinds import KindVerdict, find_kinds
from lunarsci.spectra.abundance.learned import TABLE as NETWORKS
from lunarsci.spectra.abundance.learned import Foretold, foretell_each
from lunarsci.spectra.abundance.mixing import IRON_TABLE
from lunarsci.spectra.abundance.normative import TABLE as SOIL
from lunarsci.spectra.abundance.normative import Normative, normative, normative_pages
from lunarsci.spectra.abundance.result import Abundance, MineralFraction, refused, share_pages
from lunarsci.spectra.abundance.shares import MAFIC, PRIOR, SOME, Mixed, abundances, answer, how_dark, solid_rock
from lunarsci.spectra.abundance.shares import ROCK_MODES as ROCKS
from lunarsci.spectra.abundance.shares import TABLE as CALIBRATION
from lunarsci.spectra.bands import measure_batch
from lunarsci.spectra.chemistry.bands import TABLE as CHONDRITES
from lunarsci.spectra.chemistry.bands import chondrite_record, chondrites
from lunarsci.spectra.jobs.requests import UnmixRequest
from lunarsci.spectra.origin.composition import ERRORS, Composition, measured_errors
from lunarsci.spectra.readers.batch import SpectraBatch, SpectraSource, read_batch
from lunarsci.spectra.readers.library import NEEDED_NM, EndMember, read_library
from lunarsci.spectra.spectrum import Spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LAWS = {"hapke": (HAPKE,), "absorbance": (ABSORBANCE,), "both": (HAPKE, ABSORBANCE)}
SOILS = (
    "Lucey, Blewett & Jolliff (2000), J. Geophys. Res. 105, 20297, 10.1029/1999JE001117",
    "Taylor, Pieters, Keller, Morris & McKay (2001), J. Geophys. Res. 106, 27985, 10.1029/2000JE001402",
)
LEARNED = "Korda et al. (2023), Astron. Astrophys. 669, A101, 10.1051/0004-6361/202243886 (spectra learned from)"
MODES = "Meyer (2012), Lunar Sample Compendium, NASA Johnson Space Center (modes of returned rocks)"
MOST_NAMED = 5
REFUSED = "a soil that space has weathered, whose glass and iron no mixture of powders stands for"


def named_minerals(assemblage: str) -> list[str]:
    """Full names of the minerals of an assemblage."""
    short = {ABBREVIATIONS[mineral]: mineral for mineral in WEIGHED}
    parts = abbreviated(assemblage)
    if strange := [part for part in parts if part not in short]:
        raise RequestError(
            f"`assemblage`: '{strange[0]}' is no mineral that is weighed; join some of {', '.join(short)}"
        )
    return [mineral for key, mineral in short.items() if key in parts]


def _minerals_of(end_members: Sequence[EndMember] | None) -> list[str]:
    """The weighed minerals of a library; all without one, and where it has none."""
    there = {one.mineral for one in end_members or ()}
    return [name for name in WEIGHED if name in there] or list(WEIGHED)


@dataclass(frozen=True, kw_only=True, eq=False)
class UnmixedSpectra(Result):
    """Shares of minerals of spectra, or the composition of those that space has weathered.

    Attributes
    ----------
    batch, request : the spectra, and what was asked.
    shares, kinds : of each spectrum.
    normatives : composition of those that are weathered, by position.
    chondrites : of powders of dark rocks, by position, what their bands say if they are ordinary chondrites.
    failures, files : inputs that gave no spectrum, one sentence each; what else was read beside the spectra.
    """

    schema: ClassVar[str] = "spectra-unmix/1"
    batch: SpectraBatch
    request: UnmixRequest
    shares: Sequence[Abundance]
    kinds: Sequence[KindVerdict]
    normatives: Mapping[int, Normative] = field(default_factory=dict)
    chondrites: Mapping[int, dict[str, Any] | None] = field(default_factory=dict)
    failures: Sequence[Failure] = ()
    files: Sequence[InputFile] = ()

    @property
    def made_from(self) -> MadeFrom:
        mixes, iron, soils = self.request.mixes, self.request.iron, bool(self.normatives)
        rocks = self.request.prior == PRIOR
        used = {KINDS: True, NETWORKS: True, CALIBRATION: True, END_MEMBERS: mixes, IRON_TABLE: iron, SOIL: soils,
                ROCKS: rocks, CHONDRITES: bool(self.chondrites), ERRORS: bool(self.chondrites)}  # fmt: skip
        sources = [LEARNED, *(LAWS[self.request.method] if mixes else ()), *([MODES] if rocks else ())]
        sources += [*([WEATHERING] if iron else ()), *(SOILS if soils else ())]
        return MadeFrom(
            inputs=self.batch.inputs | {file.name: file.sha256 for file in self.files},
            tables=self.batch.tables | table_hashes(*(name for name, wanted in used.items() if wanted)),
            sources=sources,
        )

    @property
    def doubt(self) -> Doubt:
        names: dict[str, list[str]] = {}
        for result in self.shares:
            if not result.determined:
                names.setdefault(result.status.removeprefix("not determined: "), []).append(result.id)
        return Doubt.of(*(
            f"shares of {some_of(ids, MOST_NAMED)} are not determined: {reason}" for reason, ids in names.items()
        ))  # fmt: skip

    def content(self) -> dict[str, Any]:
        return {**self.batch.remarks, "spectra": self.records}

    @cached_property
    def records(self) -> Sequence[dict[str, Any]]:
        """The keys of each spectrum in `--json`."""
        soils = self.normatives
        return [
            {"source": origin, "id": one.id, "kind": kind.to_dict(), "abundance": one.to_dict(),
             "normative": soils[index].to_dict() if index in soils else None,
             "chondrite": self.chondrites.get(index)}
            for index, (origin, one, kind) in enumerate(zip(self.batch.origins, self.shares, self.kinds, strict=True))
        ]  # fmt: skip

    def rows(self) -> list[dict[str, Any]]:
        """One a spectrum."""
        return [_row(record) for record in self.records]

    def figures(self) -> "Iterator[Figure]":
        names = [self.shares[index].id for index in self.normatives]
        return chain(share_pages(self.shares), normative_pages(names, list(self.normatives.values())))


def _row(record: Mapping[str, Any]) -> dict[str, Any]:
    """`olivine`, `olivine_low`, …, ratios of rocks, the kind, and `normative_feo_wt` and the like."""
    shares, soil = record["abundance"], record["normative"] or {}
    row = {key: record[key] for key in ("source", "id")} | {key: shares[key] for key in ("in_domain", "status")}
    for name, item in (shares | shares["ratios"]).items():
        if isinstance(item, Mapping) and "low95" in item:
            row |= {name: item["fraction"]} | {f"{name}_{end}": item[end] for end in ("low", "high", "low95", "high95")}
            row |= {f"{name}_present": item["present"]} if name in shares else {}
    row |= {"kind": record["kind"]["name"], "kind_stated": record["kind"]["stated"]}
    for name, item in soil.items():
        if isinstance(item, Mapping):
            stem = f"normative_{name.removesuffix('_wt')}"
            row |= {f"{stem}_wt": item["value"], f"{stem}_low_wt": item["low"], f"{stem}_high_wt": item["high"]}
    for name, item in (record["chondrite"] or {}).items():
        if isinstance(item, Mapping):
            row |= {f"chondrite_{name}": item["value"]} | {
                f"chondrite_{name}_{end}": item[end] for end in list(item)[1:]
            }
        elif name == "in_domain":
            row["chondrite_in_domain"] = item
    return row


@job
def unmix(
    spectra: "SpectraSource", request: UnmixRequest | None = None, *, progress: Progress | None = None, **options: Any
) -> UnmixedSpectra:
    """Shares by volume of olivine, both pyroxenes and plagioclase, with intervals, whatever the sampling.

    Parameters
    ----------
    spectra : files, patterns, tables, `Spectrum`s or (wavelength_nm (n,), reflectance (n,) or (spectra, n)[, sigma]),
        one or a list; reflectance and its standard deviation sigma are fractions of 1.
    request, options : what is asked, and options of `UnmixRequest` that replace its own.
    progress : called with (done, total) of each step.

    Raises
    ------
    RequestError for options that exclude each other; ParameterError for modes of spectra that are not there; DataError
    where no spectrum can be read, and for end members or spectra that cannot be mixed.

    Examples
    --------
    >>> shares = lunarsci.unmix("lunarsci-demo/rock.ecsv", kind="solid-rock")
    >>> figure = shares.plot()
    """
    asked = request_of(UnmixRequest, request, options)
    batch = read_batch(spectra, asked.wavelength_unit, asked.reflectance_unit, asked.id)
    library, modes_file = (read_input(name) if name else None for name in (asked.library, asked.known))
    end_members = read_library(library) if library else None
    modes = _stated_modes([one.id for one in batch.spectra], modes_file)
    kinds = find_kinds(batch.spectra, None if asked.kind == "auto" else asked.kind)
    if asked.together and not asked.mixes:
        warn("`together` needs the minerals by name (`assemblage`): each spectrum is answered by itself")
    named = named_minerals(asked.assemblage) if asked.assemblage else _minerals_of(end_members)
    if library and len(named) < len(WEIGHED) and not asked.assemblage:
        absent = ", ".join(name for name in WEIGHED if name not in named)
        warn(f"{library.name} has no {absent}: the shares are of {', '.join(named)} alone")
    shares = [refused(one.id, "unmix", named, REFUSED) for one in batch.spectra]
    mixed = [index for index, kind in enumerate(kinds) if modes_file or kind.kind != "weathered-soil"]
    unmixed = _shares([batch.spectra[k] for k in mixed], [kinds[k] for k in mixed], named, modes, end_members, asked,
                      progress)  # fmt: skip
    for index, one in zip(mixed, unmixed, strict=True):
        shares[index] = one
    weathered = [] if modes_file else [index for index, kind in enumerate(kinds) if kind.is_weathered]
    return UnmixedSpectra(
        batch=batch,
        request=asked,
        shares=shares,
        kinds=kinds,
        normatives={index: normative(batch.spectra[index], kinds[index]) for index in weathered},
        chondrites=_chondrites(batch.spectra, kinds, shares),
        failures=batch.failures_among({}),
        files=[file for file in (library, modes_file) if file],
    )


def presence(spectra: Sequence[Spectrum]) -> list[dict[str, float]]:
    """Of each spectrum the probability of more than 5 % of each mineral, as `unmix` without options gives it.

    Empty of what looks weathered: no such spectrum of known shares was there to test it.
    """
    kinds = find_kinds(spectra)
    mixed = [index for index, kind in enumerate(kinds) if not kind.is_weathered]
    shares = _shares([spectra[k] for k in mixed], [kinds[k] for k in mixed], WEIGHED, StatedModes({}, {}), None,
                     UnmixRequest(), None)  # fmt: skip
    there = {k: {item.mineral: item.present for item in one.fractions} for k, one in zip(mixed, shares, strict=True)}
    return [there.get(index, {}) for index in range(len(spectra))]


def _chondrites(
    spectra: Sequence[Spectrum], kinds: Sequence[KindVerdict], shares: Sequence[Abundance]
) -> dict[int, dict[str, Any] | None]:
    dark = [index for index, kind in enumerate(kinds) if kind.kind == "dark-rock-powder"]
    if not dark:
        return {}
    measured = measure_batch([spectra[index] for index in dark], continuum_name="hull")
    result = chondrites(measured.arrays.bands, np.array([_olivine_in_mafic(shares[index]) for index in dark]))
    return {index: chondrite_record(result, row) for row, index in enumerate(dark)}


def _olivine_in_mafic(shares: Abundance) -> tuple[float, float]:
    """The share of olivine in olivine and pyroxenes, and its error by those measured of powders of dark rocks."""
    errors = measured_errors("dark-rock-powder")
    modes = {one.mineral: (one.fraction, errors[one.mineral]) for one in shares.fractions if one.mineral in MAFIC}
    if not shares.determined or not sum(share for share, _ in modes.values()) > 0 or len(modes) < len(MAFIC):
        return np.nan, np.nan
    share, covariance = Composition(modes).shares(MAFIC)
    return float(share[0]), float(covariance[0, 0] ** 0.5)


def _shares(
    spectra: Sequence[Spectrum],
    kinds: Sequence[KindVerdict],
    named: Sequence[str],
    modes: StatedModes,
    end_members: Sequence[EndMember] | None,
    request: UnmixRequest,
    progress: Progress | None,
) -> list[Abundance]:
    """Shares of spectra that have some; minerals that are not `named`, or stated to be absent, have none."""
    if not spectra:
        return []
    allowed = np.tile([float(mineral in named) for mineral in WEIGHED], (len(spectra), 1))
    for row, spectrum in zip(allowed, spectra, strict=True):
        for mineral in modes.absent.get(spectrum.id, ()):
            row[WEIGHED.index(mineral)] = 0.0
        if mineral_shares := modes.shares.get(spectrum.id):
            row *= [float(mineral_shares.get(mineral, 0.0) > 0) for mineral in WEIGHED]
    foretold = foretell_each(spectra, allowed)
    mixed = mixed_estimate(spectra, foretold, allowed, modes, end_members, request, progress) if request.mixes else None
    free = None
    if request.assemblage and end_members is None:
        every = np.ones_like(allowed)
        free = answer(foretell_each(spectra, every), every, how_dark(kinds), solid_rock(kinds))
    result = abundances([one.id for one in spectra], "unmix", foretold, allowed, kinds, mixed, request.prior, free)
    return [_as_stated(one, modes.shares[one.id]) if one.id in modes.shares else one for one in result]


def _as_stated(result: Abundance, stated: Mapping[str, float]) -> Abundance:
    """A mixture whose shares are known."""
    total = sum(stated.values())
    shares = {mineral: share / total for mineral, share in stated.items()}
    values = [(one.mineral, shares.get(one.mineral, 0.0)) for one in result.fractions]
    fractions = tuple(MineralFraction(mineral, *[share] * 5, float(share > SOME)) for mineral, share in values)  # type: ignore[call-arg]
    result = replace(result, fractions=fractions, in_domain=True, status="modes as stated", ratios=())
    return replace(result, prior=None, returned=None)


def mixed_estimate(
    spectra: Sequence[Spectrum],
    foretold: Foretold,
    allowed: FloatArray,
    modes: StatedModes,
    end_members: Sequence[EndMember] | None,
    request: UnmixRequest,
    progress: Progress | None,
) -> Mixed:
    """What mixtures of end members say; the networks stand in where they say nothing.

    That is where a spectrum is too short, or has one mineral only. Raises DataError where no spectrum can be mixed.
    """
    method = "unmix" if request.method == "both" else request.method
    dark = [OPAQUE] * request.opaque
    there = [index for index, spectrum in enumerate(spectra) if reaches(spectrum)]
    if not there and end_members is not None:
        raise DataError(f"no spectrum reaches over {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm, as mixing needs")
    names = [[name for k, name in enumerate(WEIGHED) if row[k]] for row in allowed]
    groups = [[index] for index in there if len(names[index]) > 1]
    if request.in_series:
        groups = [there] if there else []
    count = len(spectra)
    result = Mixed(foretold.probabilities.copy(), np.ones(count), np.full(count, np.nan), request.in_series,
                  end_members is not None)  # fmt: skip
    for done, rows in enumerate(groups, start=1):
        given = [modes.shares.get(spectra[k].id) for k in rows]
        wanted = np.atleast_1d((allowed if request.in_series else allowed[rows]).any(axis=0))
        one = estimate_series(
            [spectra[k] for k in rows],
            [name for name, sought in zip(WEIGHED, wanted, strict=True) if sought] + dark,
            method=method,
            end_members=end_members,
            iron=request.iron,
            present=[None if stated else names[k] + dark for k, stated in zip(rows, given, strict=True)],
            given=given,
        )
        for name in ("probabilities", "strange", "rms_ln"):
            getattr(result, name)[rows] = getattr(one, name)
        if progress:
            progress(done, len(groups))
    return result


def _stated_modes(names: Sequence[str], file: InputFile | None) -> StatedModes:
    """Modes stated of the spectra."""
    if file is None:
        return StatedModes({}, {})
    modes = read_modes(file)
    stated = {*modes.shares, *modes.absent}
    doubled = [name for name in names if name in stated and names.count(name) > 1]
    if doubled or (names and not stated & set(names)):
        none = f"none of its ids is that of a spectrum, such as '{names[0]}'"
        two = f"'{doubled[0]}' is the id of two spectra; give each its own" if doubled else ""
        raise ParameterError(f"{file.name}: {two or none}")
    return modes
