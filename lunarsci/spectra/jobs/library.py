"""Libraries of end members: made of files of spectra, listed, and checked."""

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.errors import BatchError, DataError, Failure, LunarSciError, LunarSciWarning, named
from lunarsci.io.inputs import read_input
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Result
from lunarsci.spectra.jobs.requests import ImportRequest
from lunarsci.spectra.readers.batch import expanded
from lunarsci.spectra.readers.library import (
    MIXTURE,
    EndMember,
    LibraryFinding,
    library_pages,
    read_library,
    read_metadata,
    to_ecsv,
    with_description,
)
from lunarsci.spectra.readers.library import check_library as findings_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True)
class Library(Result):
    """End members of all files with the file of each, what could not be read, and what an import left out."""

    members: Sequence[EndMember]
    origins: Sequence[str]
    inputs: Mapping[str, str] = field(default_factory=dict)
    failures: Sequence[Failure] = ()
    schema = "spectra-library/1"

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(inputs=self.inputs, sources=sorted({member.source for member in self.members if member.source}))

    @property
    def minerals(self) -> Mapping[str | None, int]:
        """How many end members there are of each mineral, most first."""
        return dict(Counter(member.mineral for member in self.members).most_common())

    def to_dict(self) -> dict[str, Any]:
        return {"end_members": self.rows()}

    def rows(self) -> list[dict[str, Any]]:
        """One an end member."""
        return [
            {
                "id": member.id,
                **member.sample(),
                "channels": member.wavelength_nm.size,
                "from_nm": float(member.wavelength_nm[0]),
                "to_nm": float(member.wavelength_nm[-1]),
                "file": origin,
            }
            for member, origin in zip(self.members, self.origins, strict=True)
        ]

    def figures(self) -> "Iterator[Figure]":
        return library_pages(self.members)

    def to_ecsv(self, provenance: Mapping[str, Any] | None = None) -> bytes:
        """As `lunarsci.spectra.readers.library.to_ecsv`."""
        return to_ecsv(self.members, provenance)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedLibrary(Library):
    """A library just made; `left_out` are mixtures, `unknown` is what the metadata say nothing of."""

    left_out: Sequence[str] = ()
    unknown: Sequence[str] = ()

    def to_dict(self) -> dict[str, Any]:
        return {"end_members": self.rows(), "left_out": self.left_out, "not_in_metadata": self.unknown}


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedLibrary(Result):
    """A library with what was found in each end member."""

    library: Library
    findings: Sequence[Sequence[LibraryFinding]]
    schema = "spectra-library-check/1"

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(inputs=self.library.inputs)

    @property
    def failures(self) -> Sequence[Failure]:
        return self.library.failures

    @property
    def doubt(self) -> Doubt:
        bad = [record["id"] for record in self.to_dict()["end_members"] if record["must_mend"]]
        return Doubt.of(f"mend {_counted(bad, 'end members')}" if bad else "", verdict="not fit for use")

    def to_dict(self) -> dict[str, Any]:
        records = [
            {
                "id": member.id,
                "mineral": member.mineral,
                "must_mend": [finding.text for finding in result if finding.must_mend],
                "remarks": [finding.text for finding in result if not finding.must_mend],
            }
            for member, result in zip(self.library.members, self.findings, strict=True)
        ]
        return {"end_members": records, "ok": not any(record["must_mend"] for record in records)}

    def rows(self) -> list[dict[str, Any]]:
        """One a finding."""
        return [
            {"id": member.id, "must_mend": finding.must_mend, "finding": finding.text}
            for member, result in zip(self.library.members, self.findings, strict=True)
            for finding in result
        ]

    def figures(self) -> "Iterator[Figure]":
        return self.library.figures()


def open_library(
    files: Sequence[str], wavelength_unit: Any = None, reflectance_unit: Any = None, skipped: str | None = None
) -> Library:
    """Read every file but the `skipped` one; `failures` has what cannot be read. Raises DataError when nothing can."""
    members: list[EndMember] = []
    origins: list[str] = []
    inputs: dict[str, str] = {}
    failures: list[Failure] = []
    for name in expanded(files, failures):
        if skipped is not None and Path(name).resolve() == Path(skipped).resolve():
            continue
        try:
            source = read_input(name)
            result = read_library(source, wavelength_unit=wavelength_unit, reflectance_unit=reflectance_unit)
            members += result
            origins += [source.name] * len(result)
            inputs[source.name] = source.sha256
        except LunarSciError as error:
            failures.append(Failure.of(name, error))
    if not members:
        if failures:
            raise BatchError.of(failures)
        raise DataError(f"{files[0]}: holds no files of spectra")
    return Library(members=members, origins=origins, inputs=inputs, failures=failures)


def import_library(files: Sequence[str], request: ImportRequest | None = None, **options: Any) -> ImportedLibrary:
    """Read spectra and describe them: the metadata first, then the other options, for what is still unknown.

    What is left out, unknown or must be mended is a LunarSciWarning. Raises DataError when nothing is left.
    """
    asked = request_of(ImportRequest, request, options)
    table = read_input(asked.metadata) if asked.metadata is not None else None
    stated = read_metadata(table) if table else {}
    skipped = asked.metadata if isinstance(asked.metadata, str) else None
    result = open_library(files, asked.wavelength_unit, asked.reflectance_unit, skipped)
    unknown = [member.id for member in result.members if table and member.id not in stated]
    left_out = [member.id for member in result.members if stated.get(member.id, {}).get("mineral") == MIXTURE]
    retained = [
        (_described(member, stated.get(member.id, {}), asked, table.name if table else ""), origin)
        for member, origin in zip(result.members, result.origins, strict=True)
        if stated.get(member.id, {}).get("mineral") != MIXTURE
    ]
    if not retained:
        raise DataError(f"{skipped}: all {len(left_out)} spectra are mixtures by it; none is an end member")
    library = ImportedLibrary(
        members=[member for member, _ in retained],
        origins=[origin for _, origin in retained],
        inputs={**result.inputs, **({table.name: table.sha256} if table else {})},
        failures=result.failures,
        left_out=left_out,
        unknown=unknown,
    )
    _warn(library)
    return library


def _described(member: EndMember, stated: Mapping[str, Any], asked: ImportRequest, table: str) -> EndMember:
    with named(table):
        member = with_description(member, stated)
    return replace(member, mineral=member.mineral or asked.mineral, source=member.source or asked.source)


def _warn(library: ImportedLibrary) -> None:
    bad = [record["id"] for record in _checked(library).to_dict()["end_members"] if record["must_mend"]]
    for ids, what in (
        (library.left_out, "mixtures, left out"),
        (library.unknown, "spectra of which --metadata says nothing"),
        (bad, "end members that must be mended (see library check)"),
    ):
        if ids:
            warnings.warn(_counted(ids, what), LunarSciWarning, stacklevel=3)


def _counted(ids: Sequence[str], what: str) -> str:
    return f"{len(ids)} {what}: {', '.join(ids[:5])}{', …' if len(ids) > 5 else ''}"


def check_library(files: Sequence[str]) -> CheckedLibrary:
    """What must be mended before a library is used, and what one should know of it."""
    return _checked(open_library(files))


def _checked(library: Library) -> CheckedLibrary:
    return CheckedLibrary(library=library, findings=findings_of(library.members))
