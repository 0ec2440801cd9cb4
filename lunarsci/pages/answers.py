"""The answer of a result in a sentence or two that can be read aloud, by the kind of the result."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any

from lunarsci.errors import DataError
from lunarsci.names import some_of
from lunarsci.pages import drive_answers, rock_answers
from lunarsci.pages.documents import Document
from lunarsci.pages.words import (
    DOUBT,
    GO,
    MOST,
    STOP,
    Result,
    ResultAnswer,
    counted,
    measured,
    number,
    quantity,
    trust,
    unit,
)


def answer(document: Document) -> ResultAnswer:
    """The answer of a result; of a kind that is not known here, what it is.

    Whether it is trusted is what its command said, with exit code 3 or inputs that failed; nothing is judged here.
    Raises DataError where a document lacks what its schema has.
    """
    made = ANSWERS.get(document.kind)
    with as_written(document):
        drafted = made(document.result) if made else _unknown(document)
        parts = (document.result, document.result.get("soil"))
        caution = next((str(one["caution"]) for one in parts if isinstance(one, Mapping) and one.get("caution")), "")
        trusted, trust_text = trust(document.provenance, caution)
        if trusted and drafted.trust:
            trust_text = f"{drafted.trust} {trust_text}" if document.provenance.get("failures") else drafted.trust
    tone = drafted.tone if trusted or drafted.tone == STOP else DOUBT
    text = f"{trust_text} Otherwise: {drafted.text}" if tone == DOUBT and drafted.tone == GO else drafted.text
    return ResultAnswer(text, tone, trust_text)


def contradictions(documents: Sequence[Document]) -> dict[str, str]:
    """What fits and shares of one spectrum say that cannot both be true, by the names of their documents."""
    spectra: dict[Any, list[tuple[Document, Result]]] = {}
    for document in (one for one in documents if one.kind in ("spectra-fit", "spectra-unmix")):
        with as_written(document):
            hashes = {one.get("path"): one.get("sha256") for one in document.provenance.get("inputs") or ()}
            for record in document.result["spectra"]:
                if digest := hashes.get(record.get("source")):
                    spectra.setdefault((digest, record["id"]), []).append((document, record))
    contrary: dict[str, dict[str, None]] = {}
    for records in spectra.values():
        for (fit, fitted), (mix, mixed) in product(records, records):
            with as_written(fit), as_written(mix):
                text = rock_answers.against(fitted, mixed)
            for name in (fit.name, mix.name) if text else ():
                contrary.setdefault(name, {})[text] = None
    return {name: some_of(list(text), MOST, " ") for name, text in contrary.items()}


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


def soil(result: Result) -> ResultAnswer:
    if isinstance(result.get("joint"), Mapping):
        return _inferred(result["joint"])
    values = [
        (name, aspect[name]) for aspect in _aspects(result) for name in aspect if isinstance(aspect[name], Mapping)
    ]
    determined = [(k, v) for k, v in values if v.get("value") is not None and not v.get("assumed")]
    lines = [f"{quantity(name)} {measured(item['value'], item.get('sigma'), _unit(name))}" for name, item in determined]
    lost = [
        quantity(name)
        for name, item in values
        if item.get("reason") and not item.get("assumed") and item.get("value") is None
    ]
    taken = [quantity(name) for name, item in values if item.get("assumed")]
    if not lines:
        return ResultAnswer("These wheel states do not determine the soil.")
    states = len(result.get("observations", ())) or result.get("states")
    of = f"From {counted(states, 'wheel state')}: " if isinstance(states, int) and states else "The soil: "
    rest = [f" Not determined: {', '.join(lost)}." if lost else "", f" Assumed: {', '.join(taken)}." if taken else ""]
    return ResultAnswer(f"{of}{'; '.join(lines)}.{''.join(rest)}")


def _inferred(joint: Result) -> ResultAnswer:
    determined = [(name, one) for name, one in joint["parameters"].items() if one["determined"]]
    lines = [
        f"{quantity(name)} {number(one['median'], 3)}, {number(one['low'], 3)} to "
        f"{number(one['high'], 3)} {_unit(name)}"
        for name, one in determined
    ]
    if not lines:
        return ResultAnswer("These wheel states hardly tell more of the soil than was believed before.")
    rest = " The rest is hardly known better than before." if len(determined) < len(joint["parameters"]) else ""
    return ResultAnswer(f"These wheel states determine, with 68 %: {'; '.join(map(str.strip, lines))}.{rest}")


def _aspects(result: Result) -> list[Mapping[str, Any]]:
    return [result[name] for name in ("bearing", "shear", "lateral") if isinstance(result.get(name), Mapping)]


def _unit(name: str) -> str:
    return "kPa/m^N" if name == "stiffness_kpa_m_n" else unit(name)


def wheel_forces(result: Result) -> ResultAnswer:
    if not isinstance(result.get("normal_force_n"), int | float):
        return ResultAnswer("Forces of a wheel over slip; the table has them.")
    return ResultAnswer(
        f"At {number(1e3 * result['sinkage_m'], 3)} mm sinkage and a slip of {number(result['slip_ratio'], 2)} a wheel "
        f"carries {number(result['normal_force_n'], 3)} N, pulls with {number(result['drawbar_pull_n'], 3)} N "
        f"and needs a torque of {number(result['resistance_torque_nm'], 3)} N m."
    )


def like(result: Result) -> ResultAnswer:
    near = [one for one in result["soils"] if one.get("strength_distance") is not None]
    best = min(near, key=lambda one: float(one["strength_distance"]), default=None)
    nearest = f"; nearest in strength is {best['name']}" if best else ""
    return ResultAnswer(f"The site is set beside {counted(len(result['soils']), 'soil')}{nearest}.")


def reproduced(result: Result) -> ResultAnswer:
    verdicts = "; ".join(f"{count} {verdict}" for verdict, count in result["verdicts"].items())
    return ResultAnswer(f"Of {counted(len(result['numbers']), 'published number')}: {verdicts}.")


SYMBOLS = {"-": "", "deg": "°"}


def shown(result: Result) -> ResultAnswer:
    firsts = {str(one["quantity"]).partition(":")[0]: one for one in reversed(result["findings"])}
    listed = [
        f"{one['quantity']}, {measured(one['value'], one.get('sigma'), SYMBOLS.get(one['unit'], one['unit']))}"
        for one in reversed(firsts.values())
    ]
    more = len(result["findings"]) - len(listed)
    rest = f" {more} more findings are below." if more else ""
    return ResultAnswer(f"Everything here is synthetic. Found, among others: {'; '.join(listed)}.{rest}")


ANSWERS: dict[str, Callable[[Result], ResultAnswer]] = {
    "demo": shown,
    "images-calibrate": drive_answers.calibrated_cameras,
    "images-cameras": drive_answers.cameras,
    "images-dem": drive_answers.heights,
    "images-locate": drive_answers.located,
    "images-merge": drive_answers.merged,
    "images-render": drive_answers.rendered,
    "images-rocks": drive_answers.rocks,
    "images-track": drive_answers.ruts,
    "regolith-compare": like,
    "regolith-forces": wheel_forces,
    "regolith-identify": soil,
    "regolith-infer": soil,
    "reproduce": reproduced,
    "soil-map": drive_answers.soil_by_place,
    "spectra-bands": rock_answers.bands,
    "spectra-calibrate": rock_answers.calibrated,
    "spectra-fit": rock_answers.fit,
    "spectra-indices": rock_answers.indices,
    "spectra-library": rock_answers.library,
    "spectra-library-check": rock_answers.library_checked,
    "spectra-map": rock_answers.mapped,
    "spectra-match": rock_answers.match,
    "spectra-pixel": rock_answers.pixel,
    "spectra-simulate": rock_answers.simulated,
    "spectra-unmix": rock_answers.unmixed,
    "twin-compare": drive_answers.compared,
    "twin-forces": drive_answers.loads,
    "twin-history": drive_answers.believed,
    "twin-mission": drive_answers.mission,
    "twin-plan": drive_answers.planned,
    "twin-predict": drive_answers.predicted,
    "twin-simulate": drive_answers.simulated,
    "twin-states": drive_answers.states,
    "twin-sweep": drive_answers.designs,
    "twin-terrain": drive_answers.ground,
    "twin-update": drive_answers.learned,
}
