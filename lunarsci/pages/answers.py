"""The answer of a result in a sentence or two that can be read aloud, by the kind of the result."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from lunarsci.errors import DataError
from lunarsci.names import some_of
from lunarsci.pages.documents import Document
from lunarsci.pages.words import ANSWERED, DOUBT, GO, MOST, STOP, AnsweredKind, ResultAnswer, trust
from lunarsci.registry import result_of


def answered(kind: str) -> AnsweredKind | None:
    """Title and answer of results of a kind, such as `twin-history`; None of one that has neither.

    Those of `rock_answers` and `drive_answers`, or what the class of these results says of itself.
    """
    import_module(f"lunarsci.pages.{'rock' if kind.startswith('spectra-') else 'drive'}_answers")
    if kind in ANSWERED:
        return ANSWERED[kind]
    result = result_of(kind)
    if result is None or not result.page_title:
        return None
    return AnsweredKind(result.page_title, lambda content: ResultAnswer(result.page_answer(content)))


def title_of(document: Document) -> str:
    """What a result is, by its kind."""
    kind = answered(document.kind)
    return document.kind.replace("-", " ") if kind is None else kind.title


def answer(document: Document) -> ResultAnswer:
    """The answer of a result; of a kind that is not known here, what it is.

    Whether it is trusted is what its command said, with exit code 3 or inputs that failed; nothing is judged here.
    Raises DataError where a document lacks what its schema has.
    """
    kind = answered(document.kind)
    with as_written(document):
        drafted = _unknown(document) if kind is None else kind.answer(document.result)
        parts = (document.result, document.result.get("soil"))
        caution = next((str(one["caution"]) for one in parts if isinstance(one, Mapping) and one.get("caution")), "")
        trusted, trust_text = trust(document.provenance, caution)
        if trusted and drafted.trust:
            trust_text = f"{drafted.trust} {trust_text}" if document.provenance.get("failures") else drafted.trust
    tone = drafted.tone if trusted or drafted.tone == STOP else DOUBT
    text = f"{trust_text} Otherwise: {drafted.text}" if tone == DOUBT and drafted.tone == GO else drafted.text
    return ResultAnswer(text, tone, trust_text)


def namesakes(documents: Sequence[Document]) -> dict[str, str]:
    """Where a spectrum of another result has the same name and is of another file, by the names of their documents."""
    seen: dict[str, dict[Any, list[Document]]] = {}
    for document in documents:
        hashes = {one.get("path"): one.get("sha256") for one in document.provenance.get("inputs") or ()}
        with as_written(document):
            for record in document.result.get("spectra") or ():
                if isinstance(record, Mapping) and (digest := hashes.get(record.get("source"))):
                    seen.setdefault(str(record["id"]), {}).setdefault(digest, []).append(document)
    shared: dict[str, list[str]] = {}
    for name, by_data in seen.items():
        for digest, here in by_data.items() if len(by_data) > 1 else ():
            others = dict.fromkeys(one.name for key, rest in by_data.items() if key != digest for one in rest)
            for document in dict.fromkeys(here):
                if away := [other for other in others if other != document.name]:
                    shared.setdefault(document.name, []).append(f"{name} (of {', '.join(away)})")
    same = "has the name of a spectrum of other data here"
    return {document: f"This result {same}: {some_of(names, MOST)}." for document, names in shared.items()}


def _unknown(document: Document) -> ResultAnswer:
    return ResultAnswer(f"A result of {document.provenance.get('command', 'lunarsci')}; its numbers are below.")


@contextmanager
def as_written(document: Document) -> Iterator[None]:
    """DataError where a document, or a table beside it, lacks what its schema has."""
    try:
        yield
    except DataError:
        raise
    except (LookupError, TypeError, AttributeError, ValueError, ArithmeticError) as error:
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"{document.name}: not what a {document.schema} holds: {reason}; make it anew") from error
