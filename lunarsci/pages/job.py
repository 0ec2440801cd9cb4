"""A page of results, as a job."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from lunarsci.errors import DataError
from lunarsci.io.atomic import check_target, write_files
from lunarsci.options import request_of
from lunarsci.pages.answers import title_of
from lunarsci.pages.documents import Document, GivenPicture, read_results
from lunarsci.pages.page import Page
from lunarsci.pages.relief import Ground
from lunarsci.pages.requests import ReportRequest
from lunarsci.result import MadeFrom, Result, job

SYNTHETIC = "synthetic-longji"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportedResults(Result):
    """A page of results, and the answer of each."""

    schema: ClassVar[str] = "report/1"
    page: Page

    @property
    def made_from(self) -> MadeFrom:
        documents = self.page.documents
        inputs = {document.name: document.sha256 for document in documents}
        sources = dict.fromkeys(str(text) for one in documents for text in one.provenance.get("sources") or ())
        return MadeFrom(inputs=inputs, sources=list(sources))

    def to_dict(self) -> dict[str, Any]:
        return {"title": self.page.title, "sections": self.rows(), "ground": self.page.ground is not None}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a section: its file, title, tone and answer."""
        page = self.page
        return [
            {
                "file": one.name,
                "schema": one.schema,
                "title": page.section_title(one),
                "tone": answer.tone,
                "answer": answer.text,
                "trust": answer.trust,
            }
            for one, answer in zip(page.documents, page.answers, strict=True)
        ]

    def html(self, *, time: bool = True) -> bytes:
        """The page as one file."""
        return self.page.html(time=time)


@job
def report(
    results: Sequence[str | Path | Result] | str | Path | Result,
    path: str | Path | None = None,
    request: ReportRequest | None = None,
    *,
    force: bool = False,
    **options: Any,
) -> ReportedResults:
    """Make a page of results, and write it where a path is given.

    Parameters
    ----------
    results : of functions, JSON files of commands, folders of their -o, beliefs, and pictures (.png, .svg).
    path : of the page, as -o of `lunarsci report`; without, nothing is written.
    request, options : what the page shows, and options of `ReportRequest` that replace its own.
    force : whether a file of that name is replaced.

    Returns
    -------
    ReportedResults : its `rows()` are the answers of the page, `html()` the page.

    Raises
    ------
    DataError for what is no result; ParameterError where there is none; OutputError for a page that cannot be written.

    Examples
    --------
    >>> bands = lunarsci.bands("lunarsci-demo/rock.ecsv")
    >>> page = lunarsci.report([bands], "page.html", force=True)
    """
    wanted = request_of(ReportRequest, request, options)
    target = None if path is None else Path(path)
    if target is not None:
        check_target(target, force=force)
    given = [results] if isinstance(results, str | Path | Result) else list(results)
    documents, pictures = read_results(given, drawn=True)
    made = ReportedResults(page=page_of(documents, pictures, wanted))
    if target is not None:
        write_files({target: made.html()}, force=force)
    return made


def page_of(documents: Sequence[Document], pictures: Sequence[GivenPicture], wanted: ReportRequest) -> Page:
    """The page of some results, with the ground where one is known."""
    ground = _terrain(wanted.terrain) if wanted.terrain else _terrain_of(documents)
    names = {one.name for one in documents}
    title = wanted.title or (f"Results of {len(documents)} commands" if len(names) > 1 else title_of(documents[0]))
    return Page(title, documents, pictures, ground)


def _terrain(name: str, height_unit: str | None = None) -> Ground:
    """A terrain by its name or from its file, heights in a unit other than it states. Raises DataError."""
    from lunarsci.heights.grid import ERROR_LAYERS
    from lunarsci.heights.grids import read_grid
    from lunarsci.regolith.soil import read_soil
    from lunarsci.twin.ground.synthetic import synthetic_longji
    from lunarsci.twin.ground.terrain import SOIL_COLUMNS

    if name != SYNTHETIC:
        soil = (*SOIL_COLUMNS, *(f"{one}_left_of_prior" for one in SOIL_COLUMNS))
        return read_grid(name, (), (*soil, *ERROR_LAYERS), unit=height_unit)
    return synthetic_longji(read_soil("longji"))


def _terrain_of(documents: Sequence[Document]) -> Ground | None:
    """The first terrain that lies in a folder of the results, or that a drive names and that can be read."""
    for document in documents:
        if document.folder is not None and (file := document.folder / "terrain.npz").is_file():
            return _terrain(str(file))
    for document in documents:
        options = document.provenance.get("options") or {}
        name = options.get("terrain")
        if document.kind.startswith("twin-") and isinstance(name, str) and _is_unchanged(name, document):
            return _terrain(name, options.get("height_unit"))
    return None


def _is_unchanged(name: str, document: Document) -> bool:
    """Whether it is the embedded terrain, or a file that still is what the drive was made with."""
    from lunarsci.io.inputs import read_input

    hashes = {one.get("path"): one.get("sha256") for one in document.provenance.get("inputs") or ()}
    if name == SYNTHETIC or not hashes.get(name):
        return name == SYNTHETIC
    try:
        return bool(read_input(name).sha256 == hashes[name])
    except DataError:
        return False
