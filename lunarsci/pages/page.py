"""The page: sections of results, what is on top of them, and the text of the HTML file."""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any

from lunarsci.errors import ParameterError
from lunarsci.pages import parts
from lunarsci.pages.answers import answer, as_written, namesakes, title_of
from lunarsci.pages.charts import Chart, charts
from lunarsci.pages.documents import Document, GivenPicture
from lunarsci.pages.relief import Ground, GroundView, Line, lines_of, relief
from lunarsci.pages.words import DOUBT, GO, STOP, ResultAnswer, of_first_page
from lunarsci.printable import printable
from lunarsci.provenance import installed_version

MARKS = {GO: "Go", STOP: "No-go", DOUBT: "Not to be trusted as it is"}
"""Words in front of an answer, by its tone."""
MIME = {".png": "image/png", ".svg": "image/svg+xml"}
"""Types of pictures, by the endings of their files."""


@dataclass(frozen=True, slots=True)
class PagePicture:
    """A picture as the page has it.

    Attributes
    ----------
    source : its content as a data address.
    title : what it is called.
    words : what it shows, for those who do not see it.
    """

    source: str
    title: str
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """One result on the page.

    Attributes
    ----------
    title : what it is called.
    answer : sentences of what was found, and whether they may be trusted.
    pictures : charts of the page, then the pages of the command's plot.
    cut : pages of that plot that are shown, where it has more; 0 where all are.
    tables : its numbers.
    budget : parts of their errors, None where none is stated.
    assumed, unknown : what was taken as given, and what the answer does not know, a line each.
    provenance : what it was made from.
    made_up : whether something in it is synthetic.
    alone : what single states say, apart from a soil of all together; None for any other result.
    """

    title: str
    answer: ResultAnswer
    pictures: Sequence[PagePicture]
    cut: int
    tables: Sequence[parts.PageTable]
    budget: parts.PageTable | None
    assumed: Sequence[str]
    unknown: Sequence[str]
    provenance: parts.PageTable
    made_up: bool
    alone: parts.PagePart | None

    @property
    def trust(self) -> str:
        """What the command says of it, where the answer does not say it already."""
        text = self.answer.trust
        return "" if text.rstrip(".").lower() in self.answer.text.lower() else text

    @property
    def mark(self) -> str:
        """The answer's tone in a word or two; '' for one that needs none."""
        named = next((word for word in (MARKS[GO], MARKS[STOP]) if self.answer.text.startswith(f"{word} ")), "")
        tone = MARKS.get(self.answer.tone, "")
        return named or (f"{tone}." if tone else "")

    @property
    def body(self) -> str:
        """The answer after its mark."""
        return self.answer.text.removeprefix(f"{self.mark} ") if self.mark else self.answer.text

    @property
    def synthetic(self) -> bool:
        """Whether the answer rests on something made up that it does not name."""
        return self.made_up and "synthetic" not in self.answer.text.lower()


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """A page of several results.

    Attributes
    ----------
    title : of the page.
    documents : the results, a section each, in their order.
    pictures : that were given beside them.
    ground : that can be turned, None where no terrain is known.
    ways : lines on the ground beside those that the results have.
    answers : of the documents, in their order; they follow from these.
    """

    title: str
    documents: Sequence[Document]
    pictures: Sequence[GivenPicture] = ()
    ground: Ground | None = None
    ways: Sequence[Line] = ()
    answers: Sequence[ResultAnswer] = field(init=False)

    def __post_init__(self) -> None:
        others = namesakes(self.documents)
        each = [(answer(one), others.get(one.name)) for one in self.documents]
        answers = [replace(one, trust=" ".join(filter(None, (one.trust, more)))) for one, more in each]
        object.__setattr__(self, "answers", answers)

    def section_title(self, document: Document) -> str:
        """What a section is called: its kind, and its file where several are alike."""
        title = title_of(document)
        alike = sum(one.kind == document.kind for one in self.documents)
        return f"{title}: {document.name}" if alike > 1 else title

    def html(self, *, time: bool = True) -> bytes:
        """The whole file; without `time` equal results give equal bytes.

        Raises ParameterError without jinja2.
        """
        ground = None if self.ground is None else relief(self.ground, [*lines_of(self.documents), *self.ways])
        sections = [self._section(one, given) for one, given in zip(self.documents, self.answers, strict=True)]
        first = next((place for place, one in enumerate(sections) if one.pictures), None)
        text = _template().render(
            title=printable(self.title),
            version=installed_version("lunarsci"),
            made=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC" if time else "",
            sections=sections,
            first=first,
            pictures=[_shown(one.name, one.content, first=self._is_first(one.name)) for one in self.pictures],
            ground=None if ground is None else _ground(ground),
            sources=parts.sources(self.documents),
            rest="All digits are in the files that it was made from.",
            **_style_and_script(),
        )
        return str(text).encode()

    def _is_first(self, picture: str) -> bool:
        """Whether a command that wrote a picture of this name has said that it is the first page of several."""
        heard = (str(text) for one in self.documents for text in one.provenance.get("warnings") or ())
        return any(of_first_page(text) and Path(text.partition(": ")[0]).name == picture for text in heard)

    def _section(self, document: Document, given: ResultAnswer) -> Section:
        with as_written(document):
            drawn = [_drawn(chart) for chart in charts(document)]
            plotted = document.pictures.items()
            drawn += [_shown(name, content, first=self._is_first(name)) for name, content in plotted]
            main, alone = parts.apart(document)
            return Section(
                printable(self.section_title(document)), given, drawn, document.cut * len(plotted),
                parts.tables(main), parts.budget(main),
                parts.assumed(main), parts.unknown(main), parts.provenance(document), _made_up(document.result), alone,
            )  # fmt: skip


def _made_up(value: Any) -> bool:
    """Whether a result says that something in it is synthetic."""
    if isinstance(value, Mapping):
        return value.get("synthetic") is True or any(map(_made_up, value.values()))
    return isinstance(value, list) and any(_made_up(one) for one in value[: parts.MOST_ROWS] if isinstance(one, dict))


def _drawn(chart: Chart) -> PagePicture:
    return PagePicture(_address(chart.suffix, chart.content), chart.title, chart.words)


def _shown(name: str, content: bytes, *, first: bool = False) -> PagePicture:
    suffix = name[name.rfind(".") :].lower()
    title = f"{name}, the first page of several; --plot FILE.pdf has all" if first else name
    return PagePicture(_address(suffix, content), title, f"The picture {name}; what it shows is in its own labels.")


def _ground(ground: GroundView) -> Mapping[str, Any]:
    still = PagePicture(
        _address(".png", ground.still), "The same from above, north or y upwards", f"Seen from above: {ground.words}"
    )
    return {"data": ground.data, "note": ground.note, "words": ground.words, "still": still, "legend": ground.legend}


def _address(suffix: str, content: bytes) -> str:
    return f"data:{MIME[suffix]};base64,{base64.b64encode(content).decode()}"


def _style_and_script() -> dict[str, Any]:
    """Style and script of the page, and their hashes: nothing else may run in it."""
    from markupsafe import Markup

    style, script = (
        resources.files("lunarsci.pages").joinpath(name).read_text("utf-8") for name in ("page.css", "relief.js")
    )
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (style, script)]
    return {"style": Markup(style), "script": Markup(script), "style_hash": hashes[0], "script_hash": hashes[1]}


def _template() -> Any:
    try:
        from jinja2 import Environment, StrictUndefined
    except ImportError as error:
        raise ParameterError("a page needs jinja2; pip install 'lunarsci[report]'") from error
    text = resources.files("lunarsci.pages").joinpath("page.html.j2").read_text("utf-8")
    made = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, finalize=_clean)
    return made.from_string(text)


def _clean(value: Any) -> Any:
    """Text of a file without what would turn or hide it."""
    return printable(value) if type(value) is str else value
