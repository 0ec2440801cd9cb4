"""What every section of a page has: tables, the error budget, what was assumed, what is not known, what to cite."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lunarsci.report.documents import Document
from lunarsci.report.words import number, words

PARTS = ("sigma", "random", "systematic", "calibration", "method", "continuum", "common_sigma", "model")
"""Ends of keys that are a part of an error, by what makes it."""
SAID = ("notes", "remarks", "reasons", "reason", "caveat", "status", "why_none", "refused", "must_mend", "not_compared")
"""Keys whose text says what an answer does not know."""
OF_ONE = ("caveat", "reason")
SILENT = ("ok", "converged", "", "nothing")
MOST_ASSUMED = 6
"""Values of a rover that are listed one by one."""
MOST_ROWS, MOST_LINES, MOST_COLUMNS = 40, 40, 12
"""Of a table, of a list and across, on the page; the files hold all."""


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table of ready-made cells; `note` is a line below it."""

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def tables(document: Document) -> list[PageTable]:
    """All numbers of a result: one table of single values, then one for each list of things alike."""
    single = [[words(key), number(value)] for key, value in _leaves(document.result)]
    found = [PageTable("Single values", ["quantity", "value"], single[: 2 * MOST_ROWS])] if single else []
    for key, items in _lists(document.result):
        found.append(_listed(words(key), items))
    return found


def _leaves(value: Mapping[str, Any], name: str = "") -> Iterator[tuple[str, Any]]:
    """Single values by joined keys; texts that say what is not known are left to `unknown`."""
    for key, item in value.items():
        inner = f"{name}.{key}" if name else key
        if isinstance(item, Mapping):
            yield from _leaves(item, inner)
        elif not isinstance(item, list) and item is not None and key not in SAID:
            yield inner, item
        elif isinstance(item, list) and 0 < len(item) <= 4 and not any(isinstance(one, dict | list) for one in item):
            yield inner, ", ".join(number(one) for one in item)


def _lists(value: Any, name: str = "") -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    """Lists of objects at any depth, by joined keys."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _lists(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        yield name, value
        if len(value) == 1:
            yield from _lists(value[0], name)


def _listed(title: str, items: Sequence[Mapping[str, Any]]) -> PageTable:
    if len(items) == 1:
        rows = [[words(key), number(value)] for key, value in _leaves(items[0])]
        return PageTable(title, ["quantity", "value"], rows)
    flat = [dict(_leaves(item)) for item in items[:MOST_ROWS]]
    names = list(dict.fromkeys(key for row in flat for key in row))
    shown = names[:MOST_COLUMNS]
    rows = [[number(row[name]) if name in row else "–" for name in shown] for row in flat]
    left = [f"{len(items) - MOST_ROWS} more rows"] if len(items) > MOST_ROWS else []
    left += [f"{len(names) - len(shown)} more columns"] if len(names) > len(shown) else []
    return PageTable(title, [words(name) for name in shown], rows, f"{' and '.join(left)}: in the file" if left else "")


def budget(document: Document) -> PageTable | None:
    """Parts of the errors: a row a quantity, a column for what makes the error; None where none is stated."""
    found = [*_shares(document.result), *_budgets(document.result, "")][: 2 * MOST_ROWS]
    if not found:
        return None
    columns = list(dict.fromkeys(key for _, _, parts in found for key in parts))
    valued = any(value != "–" for _, value, _ in found)
    rows = [[name, *([value] if valued else []), *(own.get(key, "–") for key in columns)] for name, value, own in found]
    note = "standard errors, unless a column says otherwise; –: not stated, which does not mean that it is 0"
    return PageTable("", ["quantity", *(["value"] if valued else []), *columns], rows, note)


def _budgets(value: Any, name: str) -> Iterator[tuple[str, str, dict[str, str]]]:
    if isinstance(value, list):
        for place, item in enumerate(value[:MOST_ROWS]):
            named = item.get("id", item.get("name", item.get("quantity"))) if isinstance(item, Mapping) else None
            own = f"{name} {named if named is not None else place + 1}".strip()
            yield from _budgets(item, own if len(value) > 1 or named else name)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            if isinstance(item, int | float) and not isinstance(item, bool) and (parts := _parts_of(value, key)):
                yield f"{name} {words(key)}".strip(), number(item), parts
            elif isinstance(item, Mapping | list):
                yield from _budgets(item, f"{name} {words(key)}".strip() if isinstance(item, Mapping) else name)


def _parts_of(record: Mapping[str, Any], key: str) -> dict[str, str]:
    """The parts of the error of a key that stand beside it: `center_sigma_nm` and `center_nm_sigma` of `center_nm`."""
    stem, _, end = key.rpartition("_")
    tries: dict[str, tuple[str, ...]] = {part: (f"{stem}_{part}_{end}", f"{key}_{part}") for part in PARTS}
    if key in ("value", "mean", "fraction", "median", "opx"):
        tries = {part: (part,) for part in (*PARTS, "low", "high")}
    found = {
        part: next((record[name] for name in names if record.get(name) is not None), None)
        for part, names in tries.items()
    }
    named = {"sigma": "standard error", "common_sigma": "common error"}
    return {named.get(part, part): number(value, 2) for part, value in found.items() if isinstance(value, int | float)}


def _shares(result: Mapping[str, Any]) -> Iterator[tuple[str, str, dict[str, str]]]:
    """What the spread of predicted ends is owed to, and the root mean square of each part of a spectrum's error."""
    for one in result.get("sensitivity") or ():
        yield (
            f"end of the drive, by {words(str(one.get('parameter')))}",
            "–",
            {"share of variance": number(one.get("share"), 2)},
        )
    physics = (result.get("physics") or {}).get("share_of_end_variance")
    if physics is not None:
        yield "end of the drive, by the physics of the twin", "–", {"share of variance": number(physics, 2)}
    if isinstance(result.get("step_error_m"), float):
        yield "end of the drive, by the time step [m]", "–", {"model": number(result["step_error_m"], 2)}
    for one in result.get("spectra") or ():
        for name, values in (one.get("systematic") or {}).items():
            known = [value for value in values if isinstance(value, float)]
            rms = (sum(value * value for value in known) / len(known)) ** 0.5 if known else None
            yield f"{one.get('id')} reflectance, {words(name)}", "–", {"root mean square": number(rms, 2)}


def assumed(document: Document) -> list[str]:
    """What was taken as known and not measured, one line each."""
    result = document.result
    lines = _of_rover(result.get("assumed_of_rover") or ())
    lines += [str(text) for text in result.get("assumptions") or ()]
    lines += _assumed_in(result, "")
    soil = result.get("soil")
    if isinstance(soil, Mapping) and isinstance(soil.get("parameters"), Mapping) and soil["parameters"]:
        taken = ", ".join(f"{words(key)} {number(value)}" for key, value in soil["parameters"].items())
        lines.append(f"the soil, {soil.get('name')}: {taken}")
    return list(dict.fromkeys(lines))[:MOST_LINES]


def _of_rover(keys: Sequence[Any]) -> list[str]:
    """What is assumed of a rover, by its parts."""
    parts: dict[str, list[str]] = {}
    for key in map(str, keys):
        part, _, own = key.rpartition(".")
        parts.setdefault(part, []).append(words(own).partition(" [")[0])
    if not parts:
        return []
    if len(keys) > MOST_ASSUMED:
        named = ", ".join(part.replace("_", " ") for part in parts if part)
        return [f"of the rover, {len(keys)} values, of {named or 'several parts'}; its description names each"]
    told = "; ".join(f"{part}: {', '.join(own)}" for part, own in parts.items())
    return [f"of the rover, {told}"]


def _assumed_in(value: Any, name: str) -> list[str]:
    if isinstance(value, list):
        return [line for item in value[:MOST_ROWS] for line in _assumed_in(item, name)]
    if not isinstance(value, Mapping):
        return []
    if value.get("assumed") is True:
        what = words(str(value.get("quantity", name)))
        bound = value.get("limit", value.get("value"))
        return [f"{what}: {number(bound)}" + (f" ({value['source']})" if value.get("source") else "")]
    skipped = ("observations", "curve", "corners")
    return [line for key, item in value.items() if key not in skipped for line in _assumed_in(item, key)]


def unknown(document: Document) -> list[str]:
    """What the answer does not know or should be read with, one line each."""
    lines = [*_said(document.result), *map(str, document.provenance.get("warnings") or ())]
    return list(dict.fromkeys(lines))[:MOST_LINES]


def _said(value: Any, name: str = "") -> Iterator[str]:
    """Texts of a result; a caveat or a reason with what it is of."""
    if isinstance(value, list):
        for item in value[:MOST_ROWS]:
            yield from _said(item, name)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            if key in SAID or key.endswith("_note"):
                of = f"{words(name)}: " if key in OF_ONE and name else ""
                yield from (f"{of}{text}" for text in _texts(item))
            elif key == "findings":
                yield from (f"{one.get('what', one.get('quantity'))}" for one in item if "what" in one)
            elif key != "observations":
                yield from _said(item, key)


def _texts(item: Any) -> Iterator[str]:
    if isinstance(item, str):
        if item not in SILENT:
            yield item
    elif isinstance(item, Mapping):
        yield from (f"{words(str(key))}: {text}" for key, text in item.items() if isinstance(text, str))
    elif isinstance(item, list):
        yield from (text for text in item if isinstance(text, str) and text not in SILENT)


def provenance(document: Document) -> PageTable:
    """Command, options, inputs, tables and versions of a result."""
    record = document.provenance
    options = record.get("options") or {}
    given = " ".join(f"{key}={value}" for key, value in options.items() if value not in (None, False, [], ""))
    rows = [["file", document.name], ["kind", document.schema], ["SHA-256", document.sha256]]
    rows += [
        [key, str(record[key])] for key in ("command", "version", "time_utc", "seed") if record.get(key) is not None
    ]
    rows += [["options", given]] if given else []
    for name in ("inputs", "tables"):
        rows += [[name[:-1], _hashed(one)] for one in record.get(name) or () if isinstance(one, Mapping)]
    versions = record.get("versions")
    rows += (
        [["with", ", ".join(f"{key} {value}" for key, value in versions.items())]]
        if isinstance(versions, Mapping)
        else []
    )
    return PageTable("", ["what", "which"], rows[: 2 * MOST_ROWS])


def _hashed(one: Mapping[str, Any]) -> str:
    return f"{one.get('path', one.get('name', ''))}, SHA-256 {one.get('sha256', '')}"


def sources(documents: Sequence[Document]) -> list[str]:
    """What to cite, each once."""
    listed = [str(text) for document in documents for text in document.provenance.get("sources") or ()]
    return list(dict.fromkeys(listed))
