"""From files to libraries, and from libraries to a `Report`."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lunarsci.errors import DataError, LunarSciError, LunarSciWarning, ParameterError
from lunarsci.inputs import read_input
from lunarsci.spectra.library import EndMember, read_library, to_ecsv
from lunarsci.spectra.library.check import MIXTURE, LibraryFinding, check_library, read_metadata, with_description
from lunarsci.spectra.readers.batch import expanded

from ..shared.report import Report, together
from ..shared.table import TextTable, plus_minus

__all__ = ["Imported", "check_report", "import_report", "imported", "list_report", "read_libraries"]

PICTURES = (".png", ".svg", ".pdf")


@dataclass(slots=True)
class Imported:
    """End members of all files with the file of each, what was left out and why, and what could not be read."""

    members: list[EndMember] = field(default_factory=list)
    origins: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    inputs: dict[str, str] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)


def read_libraries(
    files: Sequence[str], wavelength_unit: Any = None, reflectance_unit: Any = None, but: str | None = None
) -> Imported:
    """Read every file `but` one; what cannot be read is remembered. Raises DataError when nothing can."""
    found = Imported()
    for name in expanded(files, found.failures):
        if but is not None and Path(name).resolve() == Path(but).resolve():
            continue
        try:
            source = read_input(name)
            members = read_library(source, wavelength_unit=wavelength_unit, reflectance_unit=reflectance_unit)
            found.members += members
            found.origins += [source.name] * len(members)
            found.inputs[source.name] = source.sha256
        except LunarSciError as error:
            found.failures.append(str(error) if name in str(error) else f"{name}: {error}")
    if not found.members:
        raise DataError(together(found.failures) if found.failures else f"{files[0]}: holds no files of spectra")
    return found


def imported(
    files: Sequence[str],
    mineral: str | None,
    metadata: str | None,
    source: str,
    wavelength_unit: Any,
    reflectance_unit: Any,
) -> Imported:
    """Read spectra and describe them: the table first, then the options, for what is still unknown."""
    table = read_input(metadata) if metadata else None
    told = read_metadata(table) if table else {}
    found = read_libraries(files, wavelength_unit, reflectance_unit, but=metadata)
    if table:
        found.inputs[table.name] = table.sha256
    kept = []
    for member, origin in zip(found.members, found.origins, strict=True):
        description = told.get(member.id)
        if table and description is None:
            found.unknown.append(member.id)
        if description is not None and description["mineral"] == MIXTURE:
            found.left_out.append(member.id)
            continue
        kept.append((_described(member, description or {}, mineral, source, metadata), origin))
    if not kept:
        raise DataError(f"{metadata}: all {len(found.left_out)} spectra are mixtures by it; none is an end member")
    found.members, found.origins = [member for member, _ in kept], [origin for _, origin in kept]
    return found


def _described(
    member: EndMember, told: Mapping[str, Any], mineral: str | None, source: str, table: str | None
) -> EndMember:
    try:
        member = with_description(member, told)
    except DataError as error:
        raise DataError(f"{table}: {error}") from error
    return replace(member, mineral=member.mineral or mineral, source=member.source or source)


def import_report(found: Imported, path: Path | None) -> Report:
    """The report of `spectra library import`; to a file ending in .ecsv it writes the library itself."""
    if path is not None and path.suffix.lower() not in (".ecsv", ".json"):
        raise ParameterError(f"{path}: a library is written as .ecsv, its list as .json; give such a name")
    checked = zip(found.members, check_library(found.members), strict=True)
    bad = [member.id for member, findings in checked if any(finding.must_mend for finding in findings)]
    for ids, what in (
        (found.left_out, "mixtures, left out"),
        (found.unknown, "spectra of which --metadata says nothing"),
        (bad, "end members that must be mended (see library check)"),
    ):
        if ids:
            warnings.warn(_counted(ids, what), LunarSciWarning, stacklevel=2)
    report = _listing(found)
    return replace(
        report,
        result={**report.result, "left_out": found.left_out, "not_in_metadata": found.unknown},
        formats={".ecsv": lambda provenance: to_ecsv(found.members, provenance)},
    )


def list_report(found: Imported) -> Report:
    """The report of `spectra library list` and `plot`."""
    from lunarsci.figure import picture_bytes

    report = _listing(found)
    figures = report.figures

    def drawer(suffix: str) -> Callable[[Mapping[str, Any]], bytes]:
        return lambda _: picture_bytes(figures() if figures else (), Path(f"library{suffix}"))

    return replace(report, formats={suffix: drawer(suffix) for suffix in PICTURES})


def _counted(ids: Sequence[str], what: str) -> str:
    return f"{len(ids)} {what}: {', '.join(ids[:5])}{', …' if len(ids) > 5 else ''}"


def _listing(found: Imported) -> Report:
    records = [_record(member, origin) for member, origin in zip(found.members, found.origins, strict=True)]

    def figures() -> Any:
        from lunarsci.spectra.library.end_member import library_pages

        return library_pages(found.members)

    return Report(
        schema="spectra-library/1",
        result={"end_members": records},
        tables=[TextTable(HEADERS, [_row(record) for record in records])],
        rows=records,
        figures=figures,
        inputs=found.inputs,
        sources=sorted({member.source for member in found.members if member.source}),
        failures=found.failures,
    )


HEADERS = ("spectrum", "mineral", "Fo", "Fs", "En", "Wo", "An", "grains [µm]", "channels", "range [nm]", "source")


def _record(member: EndMember, origin: str) -> dict[str, Any]:
    return {
        "id": member.id,
        **member.sample(),
        "channels": member.wavelength_nm.size,
        "from_nm": float(member.wavelength_nm[0]),
        "to_nm": float(member.wavelength_nm[-1]),
        "file": origin,
    }


def _row(record: Mapping[str, Any]) -> list[str]:
    low, high = record["min_um"], record["max_um"]
    grains = "-" if high is None else f"< {high:g}" if not low else f"{low:g}-{high:g}"
    return [
        record["id"],
        record["mineral"] or "?",
        *(plus_minus(record[key], digits=2) for key in ("fo", "fs", "en", "wo", "an")),
        grains,
        str(record["channels"]),
        f"{record['from_nm']:g}-{record['to_nm']:g}",
        record["source"] or "-",
    ]


def check_report(found: Imported) -> Report:
    """The report of `spectra library check`."""
    records = [_checked(*pair) for pair in zip(found.members, check_library(found.members), strict=True)]
    bad = [record["id"] for record in records if record["must_mend"]]
    rows = [
        [record["id"], kind, text]
        for record in records
        for kind, key in (("mend", "must_mend"), ("know", "remarks"))
        for text in record[key]
    ]
    rest = sum(not record["must_mend"] and not record["remarks"] for record in records)
    notes = [f"{rest} of {len(records)} without a finding"] if rest else []
    return Report(
        schema="spectra-library-check/1",
        result={"end_members": records, "ok": not bad},
        tables=[TextTable(["spectrum", "", "finding"], rows, notes=notes)] if rows else [_nothing(records)],
        rows=[{"id": id, "must_mend": kind == "mend", "finding": text} for id, kind, text in rows],
        figures=_listing(found).figures,
        inputs=found.inputs,
        failures=found.failures,
        untrusted=f"not fit for use: mend {_counted(bad, 'end members')}" if bad else "",
    )


def _checked(member: EndMember, findings: Sequence[LibraryFinding]) -> dict[str, Any]:
    return {
        "id": member.id,
        "mineral": member.mineral,
        "must_mend": [finding.text for finding in findings if finding.must_mend],
        "remarks": [finding.text for finding in findings if not finding.must_mend],
    }


def _nothing(records: Sequence[Mapping[str, Any]]) -> TextTable:
    return TextTable(["library"], [[f"all {len(records)} end members are fit for use"]])
