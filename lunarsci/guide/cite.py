"""The sources of results, and lunarsci itself, as BibTeX, as a job."""

import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path, PurePath
from typing import Any, ClassVar

from lunarsci.io.tables import SPECTRA_DATA
from lunarsci.pages.documents import Document, read_results
from lunarsci.result import MadeFrom, Result

REFERENCE = re.compile(r"^(?P<authors>[^()]{2,120}?) \((?P<year>1[89]\d\d|20\d\d)\), (?P<rest>.+)$", re.DOTALL)
_OF_DOI = r"(?:[^\s:;,()]|:(?=\S))"
DOI = re.compile(rf"(?<![\w.])(?:doi:? )?(10\.\d{{4,9}}/(?:{_OF_DOI}|[()])+(?<![.)])(?:\)(?=[A-Z0-9]))?{_OF_DOI}*)")
PLACE = re.compile(
    r"^(?P<journal>[^,\d][^,]*?(?:, [^,\d][^,]*?)?) (?P<volume>\d+)(?:, (?P<page>[A-Z]?\d[\w-]*|e\d\w+))?(?=[,;:]|$)"
)
"""A reference as results name it: `Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8`."""
REMARK = re.compile(r": |;| \(|(?:doi:? )?\b10\.\d{4,9}/")
"""Where a reference that has no volume ends: a remark, or its DOI."""
LONGEST_PLACE = 80
"""Letters of a place without a volume, such as a conference or a book; more are a sentence."""
SEVERAL = re.compile(r"; (?=[A-Z][^();]{1,120}? \((?:1[89]|20)\d\d\), )")
"""Between two references of one source: `Wang & Han (2016), ...; Lim et al. (2021), ...`."""
LUNARSCI = "lunarsci"
"""Its own work in `references.toml`."""
BY_ROWS = ("reference_soils.csv", "band_chemistry.csv")
"""Tables of which a result names the sources of the rows that it used, so that no others are cited."""
NOT_FIELDS = ("type", "tables", "recalled")
"""Of a work: what is no field of its entry."""


@dataclass(frozen=True, slots=True)
class Reference:
    """One source.

    Attributes
    ----------
    text : as the result has it.
    authors, year, journal, volume, page, doi : what follows from the text, '' for what does not.
    entry : its name in `references.toml`, '' where it is not there.
    work : its entry there, empty where it is not there.
    """

    text: str
    authors: str = ""
    year: str = ""
    journal: str = ""
    volume: str = ""
    page: str = ""
    doi: str = ""
    entry: str = ""
    work: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def key(self) -> str:
        """Such as ding2024; the same for two papers of one author and year, which `keyed` tells apart."""
        plain = unicodedata.normalize("NFKD", self.authors or self.text).encode("ascii", "ignore").decode()
        first = re.sub(r"[^a-z]", "", re.split(r"[\s,]", plain.lower())[0])
        return self.entry or f"{first or 'source'}{self.year}"

    @property
    def same(self) -> str:
        """What two texts that name one work have in common, whatever they say it is cited for."""
        place = " ".join([self.authors, self.year, self.journal, self.volume, self.page]) if self.journal else self.text
        return self.entry or self.doi or place

    @property
    def kind(self) -> str:
        """The kind of its entry, such as article; that of a work without a title is misc, as others need one."""
        return str(self.work.get("type", "article")) if self.title else "misc"

    @property
    def title(self) -> str:
        """Of the work, where it is known."""
        return str(self.work.get("title", ""))

    @property
    def fields(self) -> dict[str, str]:
        """Fields of its entry; the text of the result is a note only where the fields do not say where the work is."""
        if self.work:
            named = {name: str(value) for name, value in self.work.items() if name not in NOT_FIELDS}
            # Capitals of names stay as they are in any style.
            return named | ({"title": f"{{{self.title}}}"} if self.title else {})
        names = re.sub(r" & |, ", " and ", re.sub(r",? et al\.?", " and others", self.authors))
        where = ", ".join(part for part in (f"{self.journal} {self.volume}".strip(), self.page) if part)
        note = "" if names and self.year and (where or self.doi) else self.text
        named = {"author": names, "howpublished": where, "year": self.year, "doi": self.doi, "note": note}
        return {name: value for name, value in named.items() if value}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CitedSources(Result):
    """What to cite for some results.

    Attributes
    ----------
    references : each source once, in the order in which results name them.
    documents : the results.
    """

    schema: ClassVar[str] = "cite/1"
    references: Sequence[Reference]
    documents: Sequence[Document]

    def __str__(self) -> str:
        return self.bibtex()

    @property
    def made_from(self) -> MadeFrom:
        sources = [reference.text for reference in self.references]
        return MadeFrom(inputs={one.name: one.sha256 for one in self.documents}, sources=sources)

    @property
    def keyed(self) -> dict[str, Reference]:
        """The references by keys that are different: ding2024, ding2024b and so on."""
        by_key: dict[str, Reference] = {}
        for one in self.references:
            letters = (f"{one.key}{letter}" for letter in ("", *"bcdefghijklmnopqrstuvwxyz"))
            by_key[next(key for key in letters if key not in by_key)] = one
        return by_key

    @property
    def versions(self) -> list[str]:
        """Versions of lunarsci that made the results."""
        return sorted({str(one.provenance.get("version") or "") for one in self.documents} - {""})

    def to_dict(self) -> dict[str, Any]:
        return {"sources": self.rows(), "versions": self.versions, "bibtex": self.bibtex()}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a source."""
        keys = ("text", "authors", "title", "year", "journal", "volume", "page", "doi")
        return [{"key": key} | {name: getattr(one, name) or None for name in keys} for key, one in self.keyed.items()]

    def bibtex(self) -> str:
        """The entries, that of lunarsci first."""
        lunarsci = reference_to(LUNARSCI)
        version = {"note": f"version {', '.join(self.versions)}"} if self.versions else {}
        entries = [_entry(lunarsci.kind, LUNARSCI, lunarsci.fields | version)]
        for key, one in self.keyed.items():
            entries.append(_entry(one.kind, key, one.fields))
        return "\n".join(entries)


def _entry(kind: str, key: str, fields: Mapping[str, str]) -> str:
    """`@article{ding2024, ...}`; signs that TeX takes for commands are escaped."""
    lines = [f"  {name} = {{{_tex(name, value)}}}," for name, value in fields.items()]
    return "\n".join([f"@{kind}{{{key},", *lines, "}", ""])


def _tex(name: str, value: str) -> str:
    r"""`&` as `\&`, and an umlaut as `{\"o}`, which every program takes."""
    if name == "doi" or value.startswith("https://"):
        return value
    return re.sub("([a-zA-Z])\u0308", r'{\\"\1}', unicodedata.normalize("NFD", re.sub(r"([&%$#_])", r"\\\1", value)))


@cache
def works() -> Mapping[str, Mapping[str, Any]]:
    """The works of `references.toml` by their names."""
    return tomllib.loads((files(SPECTRA_DATA) / "references.toml").read_text("utf-8"))


def reference_to(name: str, text: str = "") -> Reference:
    """A work of `references.toml` by its name; `text` as a result has it, made of its fields if ''."""
    work = works()[name]
    who, where = str(work.get("author", work.get("editor", ""))), str(work.get("journal", ""))
    cells = {key: str(work.get(key, "")) for key in ("year", "volume", "pages", "doi")}
    parts = (
        work.get("title"),
        f"{where} {cells['volume']}".strip(),
        cells["pages"],
        cells["doi"],
        work.get("howpublished"),
    )
    place = ", ".join(part for part in parts if part)
    short = who.strip("{}") if who.count(" and ") < 4 else f"{who.split(' and ')[0]} and others"
    whole = f"{short} ({cells['year']}), {place}" if cells["year"] else f"{short}, {place}"
    return Reference(
        text or whole, who, cells["year"], where, cells["volume"], cells["pages"], cells["doi"], entry=name, work=work
    )


def _of_tables(names: Sequence[str]) -> Iterator[Reference]:
    """The works that tables of lunarsci rest on, but for those cited row by row."""
    whole = set(names) - {*BY_ROWS}
    for name, work in works().items():
        if not whole.isdisjoint(work.get("tables", ())):
            yield reference_to(name)


def _cited(text: str) -> Reference:
    """A source of a result: the work that has its DOI, or where the result has none, its number, title or author."""
    reference = reference_of(text)
    for name, work in works().items():
        if reference.doi and str(work.get("doi", "")).lower() == reference.doi.lower():
            return reference_to(name, text)
        if not reference.doi and (_is_report(work, text) or _is_titled(work, reference)):
            return reference_to(name, text)
    same = works().get(reference.key, {})
    alone = reference.journal == "" or reference.volume in ("", same.get("volume", reference.volume))
    return reference_to(reference.key, text) if same and not reference.doi and alone else reference


def _is_report(work: Mapping[str, Any], text: str) -> bool:
    """Whether the text has the number of this report, such as `JPL Technical Report 32-1023 (1966)`."""
    number = re.escape(str(work.get("number", "")))
    return work.get("type") == "techreport" and re.search(rf"(?<![\w-]){number}(?![\w-])", text) is not None


def _is_titled(work: Mapping[str, Any], cited: Reference) -> bool:
    """Whether a title stands where authors do, as in `Lunar Sourcebook (1991), ch. 9`."""
    start = f"{cited.authors}:"
    return bool(cited.authors) and cited.year == work.get("year") and str(work.get("title", "")).startswith(start)


def reference_of(text: str) -> Reference:
    """What follows from a source as results name it.

    >>> found = reference_of("Clark & Roush (1984), J. Geophys. Res. 89, 6329, 10.1029/JB089iB07p06329")
    >>> found.key, found.journal, found.volume, found.page, found.doi
    ('clark1984', 'J. Geophys. Res.', '89', '6329', '10.1029/JB089iB07p06329')
    """
    doi = DOI.search(text)
    parts = REFERENCE.match(text)
    if parts is None:
        year = re.search(r"\b(1[89]\d\d|20\d\d)\b", text)
        return Reference(text, year=year[1] if year else "", doi=doi[1] if doi else "")
    place = PLACE.match(parts["rest"])
    elsewhere = REMARK.split(parts["rest"])[0].strip(" ,")
    return Reference(
        text,
        authors=parts["authors"],
        year=parts["year"],
        journal=place["journal"].strip() if place else elsewhere if len(elsewhere) < LONGEST_PLACE else "",
        volume=place["volume"] if place else "",
        page=(place["page"] or "") if place else "",
        doi=doi[1] if doi else "",
    )


def cite(*results: Sequence[str | Path | Result] | str | Path | Result) -> CitedSources:
    """What to cite for results: those of functions, JSON files of commands, or folders of their -o; lists of them, too.

    The sources that a result names, and the works that its tables rest on, such as laboratory spectra, catalogues of
    craters and priors; of reference soils and regressions of bands only those that the result used. Sources that
    differ only in what follows the DOI are one. Raises DataError for what is no result.

    Examples
    --------
    >>> works = lunarsci.cite(lunarsci.bands("lunarsci-demo/rock.ecsv"))
    """
    given = [one for some in results for one in ([some] if isinstance(some, str | Path | Result) else some)]
    documents = read_results(given)[0] if given else []
    records = [document.provenance for document in documents]
    texts = [part for record in records for text in record.get("sources") or () for part in SEVERAL.split(str(text))]
    tables = [PurePath(str(one.get("name", one.get("path", "")))).name for record in records for one in _named(record)]
    by_work: dict[str, Reference] = {}
    for one in (*map(_cited, texts), *_of_tables(tables)):
        by_work.setdefault(one.same, one)
    return CitedSources(references=list(by_work.values()), documents=documents)


def _named(record: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The tables that a record names, where it does."""
    yield from (one for one in record.get("tables") or () if isinstance(one, Mapping))
