"""The answer of a result in a sentence or two that can be read aloud, by the kind of the result."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from lunarsci.errors import DataError
from lunarsci.report import drive_answers, rock_answers
from lunarsci.report.documents import Document
from lunarsci.report.sentences import DOUBT, STOP, Result, ResultAnswer
from lunarsci.report.words import counted, measured, number, quantity, unit


def answer(document: Document) -> ResultAnswer:
    """The answer of a result; of a kind that is not known here, what it is.

    Raises DataError where a document lacks what its schema has.
    """
    made = ANSWERS.get(document.kind)
    if made is None:
        return ResultAnswer(f"A result of {document.provenance.get('command', 'lunarsci')}; its numbers are below.")
    with as_written(document):
        return _with_doubt(made(document.result), document.result)


def _with_doubt(said: ResultAnswer, result: Result) -> ResultAnswer:
    """An answer with why its soils are doubtful, or what was learned; a no-go stays one."""
    soil = result.get("soil")
    doubt = result.get("doubt") or (soil.get("doubt") if isinstance(soil, Mapping) else None)
    if not isinstance(doubt, str):
        return said
    return ResultAnswer(f"{said.text} Doubtful: {doubt}.", STOP if said.tone == STOP else DOUBT)


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
    found = [(k, v) for k, v in values if v.get("value") is not None and not v.get("assumed")]
    lines = [f"{quantity(name)} {measured(item['value'], item.get('sigma'), _unit(name))}" for name, item in found]
    if not lines:
        return ResultAnswer("These wheel states do not determine the soil.", DOUBT)
    states = len(result.get("observations", ())) or result.get("states")
    of = f"From {counted(states, 'wheel state')}: " if isinstance(states, int) and states else "The soil: "
    return ResultAnswer(f"{of}{'; '.join(lines)}.")


def _inferred(joint: Result) -> ResultAnswer:
    known = [(name, one) for name, one in joint["parameters"].items() if one["determined"]]
    lines = [
        f"{quantity(name)} {number(one['median'], 3)}, {number(one['low'], 3)} to "
        f"{number(one['high'], 3)} {_unit(name)}"
        for name, one in known
    ]
    if not lines:
        return ResultAnswer("These wheel states hardly tell more of the soil than was believed before.", DOUBT)
    return ResultAnswer(
        f"Of the soil these wheel states determine, median and 68 %: {'; '.join(map(str.strip, lines))}."
    )


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


def ruts(result: Result) -> ResultAnswer:
    depth = result["sinkage_m"]
    if depth.get("mean") is None:
        return ResultAnswer("The depth of the ruts is not determined.", DOUBT)
    return ResultAnswer(
        f"The wheels sank {measured(1e3 * depth['mean'], 1e3 * depth['sigma'], 'mm')}, "
        f"the mean of {result['determined']} of {result['places']} places."
    )


def reproduced(result: Result) -> ResultAnswer:
    verdicts = "; ".join(f"{count} {verdict}" for verdict, count in result["verdicts"].items())
    return ResultAnswer(f"Of {counted(len(result['numbers']), 'published number')}: {verdicts}.")


def shown(result: Result) -> ResultAnswer:
    found = [
        f"{one['quantity']} {measured(one['value'], one.get('sigma'), '' if one['unit'] == '-' else one['unit'])}"
        for one in result["findings"]
    ]
    return ResultAnswer(f"Everything here is synthetic. Found: {'; '.join(found)}.")


ANSWERS: dict[str, Callable[[Result], ResultAnswer]] = {
    "demo": shown,
    "images-rocks": rock_answers.rocks,
    "images-track": ruts,
    "regolith-compare": like,
    "regolith-forces": wheel_forces,
    "regolith-identify": soil,
    "regolith-infer": soil,
    "reproduce": reproduced,
    "spectra-bands": rock_answers.bands,
    "spectra-calibrate": rock_answers.calibrated,
    "spectra-fit": rock_answers.fit,
    "spectra-indices": rock_answers.indices,
    "spectra-match": rock_answers.match,
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
