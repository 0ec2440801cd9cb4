"""What every section of a page has: tables, the error budget, what was assumed, what is not known, what to cite."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from lunarsci.names import some_of
from lunarsci.pages.documents import Document
from lunarsci.pages.quantities import PARTS, SAID, Quantity, quantities
from lunarsci.pages.rock_answers import standing_of
from lunarsci.pages.sentences import MOST, heard_of
from lunarsci.pages.words import counted, number, percent, words
from lunarsci.regolith.jobs.identify import alone_title
from lunarsci.spectra.jobs.bands import METHODS, SHORT, regression

FIRST = (
    *("station", "wheel", "limit", "sense", "p50", "p95", "kept_by_95", "margin", "ok"),
    *("prior", "posterior", "log_bayes_factor"),
    *("band1000_status", "bc1000_nm", "bd1000", "band2000_status", "bc2000_nm", "bd2000"),
)
"""Columns that stand first in a table."""
SAYS = ("best", "sure", "open", "status")
"""Columns of what a result says of each thing in a table, before its numbers."""
STANDARD_ERROR = PARTS["sigma"]
OF_ONE = ("caveat", "reason")
NOTED = {"band1000_note": "1 µm band", "band2000_note": "2 µm band"}
SILENT = ("ok", "converged", "", "nothing")
SINGLE_STATES = ("agreement", "bearing", "draws", "lateral", "observations", "reading", "sensitivity", "shear")
"""Keys of `regolith infer` that are of each state by itself; what these assume, its answer does not."""
AGREEMENT = "whether states solved so agree: a test of what is assumed here, not of the answer"
MOST_ASSUMED = 6
"""Values of a rover that are listed one by one."""
MOST_CHOICES = 6
"""Spectra of which what is open is told one by one."""
MOST_ROWS, MOST_LINES, MOST_COLUMNS, MOST_NAMED = 48, 40, 12, 5
"""Of a table, of a list, across, and of names in a line, on the page; the files hold all."""


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table of ready-made cells; `note` is a line below it."""

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True, slots=True)
class PagePart:
    """Tables under a heading of their own, and what they should be read with."""

    title: str
    remarks: Sequence[str]
    tables: Sequence[PageTable]


def apart(document: Document) -> tuple[Document, PagePart | None]:
    """A soil of all states together without the numbers of single states, and these with what they assume.

    Any other result as it is.
    """
    result = document.result
    if not isinstance(result.get("joint"), Mapping):
        return document, None
    alone = {key: item for key, item in result.items() if key in SINGLE_STATES}
    values = {key: item for name in ("bearing", "shear", "lateral") for key, item in (alone.get(name) or {}).items()}
    taken = {k: v["value"] for k, v in values.items() if isinstance(v, Mapping) and v.get("assumed") and v.get("value")}
    if modulus := (document.provenance.get("options") or {}).get("shear_modulus"):
        taken["shear_modulus_mm"] = modulus
    single = replace(document, result=alone, provenance={})
    remarks = [*unknown(single), *(f"assumed: {line}" for line in assumed(single))]
    found = [replace(one, title=AGREEMENT if one.title == "agreement" else one.title) for one in tables(single)]
    main = {key: item for key, item in result.items() if key not in SINGLE_STATES}
    return replace(document, result=main), PagePart(alone_title(taken), remarks, found)


def tables(document: Document) -> list[PageTable]:
    """All numbers of a result: one table of single values, then one for each list of things alike."""
    single = _single(document.result)
    found = [PageTable("Single values", ["of", "quantity", "value"], single)] if single else []
    for key, items in _lists(document.result):
        found.append(_listed(words(key), items))
    return found


def _single(result: Mapping[str, Any]) -> list[list[str]]:
    """Rows of a table; what they are of is said where it changes."""
    groups: dict[str, list[Quantity]] = {"": []}
    for one in islice(quantities(result), 3 * MOST_ROWS):
        groups.setdefault(one.of, []).append(one)
    return [
        [of if place == 0 else "", one.name, _with_remark(one)]
        for of, own in groups.items()
        for place, one in enumerate(own)
    ]


def _with_remark(one: Quantity) -> str:
    return f"{one.text}: {one.remark}" if one.refused and one.remark else one.text


def _lists(value: Any, name: str = "") -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    """Lists of several objects at any depth, by joined keys."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _lists(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        if len(value) > 1:
            yield name, value
        else:
            yield from _lists(value[0], name)


def _listed(title: str, items: Sequence[Mapping[str, Any]]) -> PageTable:
    if all("kept" in item and "sense" in item for item in items):
        # Limits: what 95 % of the drives keep is the upper end or the lower one, as the limit is.
        kept = "kept_by_95" if all(item.get("share") == 0.95 for item in items) else "kept"
        items = [{key.replace("kept", kept): item[key] for key in item if key not in ("p05", "p95")} for item in items]
    names = [key for key in ("id", "name", "quantity") if key in items[0]]
    flat = [
        {words(key): words(item[key]) if key == "quantity" else number(item[key]) for key in names}
        | _verdict(item)
        | {_column(one): one.text for one in quantities(item)}
        for item in items[:MOST_ROWS]
    ]
    first = [*(words(key) for key in names), *SAYS, *(words(key) for key in FIRST)]
    found = dict.fromkeys(key for row in flat for key in row)
    headers = [*(key for key in first if key in found), *(key for key in found if key not in first)]
    shown = headers[:MOST_COLUMNS]
    rows = [[row.get(name, "–") for name in shown] for row in flat]
    left = [f"{len(items) - MOST_ROWS} more rows"] if len(items) > MOST_ROWS else []
    left += [f"{len(headers) - len(shown)} more columns"] if len(headers) > len(shown) else []
    return PageTable(title, shown, rows, f"{' and '.join(left)}: in the file" if left else "")


def _verdict(item: Mapping[str, Any]) -> dict[str, str]:
    """What a result says of one thing, by columns of `SAYS`."""
    choice = item.get("choice") or {}
    found = {key: ", ".join(choice[key]) or "–" for key in ("sure", "open") if key in choice}
    if "best" in item:
        found["best"] = str(item["best"] or "not decided")
    return found | ({"status": str(item["status"])} if isinstance(item.get("status"), str) else {})


def _column(one: Quantity) -> str:
    return f"{one.of}: {one.name}" if one.of else one.name


def budget(document: Document) -> PageTable | None:
    """Parts of the errors: a row a quantity, a column for what makes the error; None where none is stated."""
    stated = list(_with_errors(document.result))
    several = [one for one in stated if one.parts.keys() - {STANDARD_ERROR}]
    every = [*_shares(document.result), *(several or stated)]
    found = every[:MOST_ROWS]
    if not found:
        return None
    columns = list(dict.fromkeys(key for one in found for key in one.parts if key != STANDARD_ERROR))
    valued, read_with = any(one.text for one in found), any(one.remark for one in found)
    rows = [
        [
            f"{one.of}: {one.name}" if one.of else one.name,
            *([one.text] if valued else []),
            *(one.parts.get(key, "–") for key in columns),
            *([one.remark] if read_with else []),
        ]
        for one in found
    ]
    headers = ["quantity", *(["value"] if valued else []), *columns, *(["read with"] if read_with else [])]
    note = "errors are in the unit of their quantity, one standard error each; –: not stated, which does not mean 0"
    note += f"; {len(every) - len(found)} more rows: in the file" if len(every) > len(found) else ""
    return PageTable("", headers, rows, note)


def _with_errors(result: Mapping[str, Any]) -> Iterator[Quantity]:
    """Numbers with errors that the command shows; of many spectra those of the first, and nothing that is refused."""
    for one in quantities(result, most=MOST):
        if one.parts and not one.refused and one.text != number(None):
            yield one


def _shares(result: Mapping[str, Any]) -> Iterator[Quantity]:
    """What the spread of predicted ends is owed to, and the root mean square of each part of a spectrum's error."""
    end = "end of the drive"
    for one in result.get("sensitivity") or ():
        if one.get("share") is not None:
            by = words(str(one.get("parameter"))).partition(" [")[0]
            yield Quantity(end, f"by {by}", "", {"share of variance": percent(one["share"])})
    physics = (result.get("physics") or {}).get("share_of_end_variance")
    if physics is not None:
        yield Quantity(end, "by the physics of the twin", "", {"share of variance": percent(physics)})
    if isinstance(result.get("step_error_m"), float):
        yield Quantity(end, "by the time step [m]", "", {"of the model": number(result["step_error_m"], 2)})
    for one in (result.get("spectra") or ())[:MOST]:
        for name, values in (one.get("systematic") or {}).items():
            known = [value for value in values if isinstance(value, float)]
            rms = (sum(value * value for value in known) / len(known)) ** 0.5 if known else None
            if rms is not None:
                yield Quantity(f"{one.get('id')} reflectance", words(name), "", {"root mean square": number(rms, 2)})


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
    if isinstance(value.get("assumed"), list):
        of = f"of {value.get('name')}: " if value.get("name") else ""
        return [f"{of}{text if ' ' in str(text) else words(str(text))}" for text in value["assumed"]]
    if value.get("assumed") is True:
        what = words(str(value.get("quantity", name)))
        bound = value.get("limit", value.get("value"))
        return [f"{what}: {number(bound)}" + (f" ({value['source']})" if value.get("source") else "")]
    skipped = ("observations", "curve", "corners")
    return [line for key, item in value.items() if key not in skipped for line in _assumed_in(item, key)]


def unknown(document: Document) -> list[str]:
    """What the answer does not know or should be read with, one line each; what several things share once."""
    record = document.provenance
    found = [("", str(text)) for text in (*(record.get("failures") or ()), *heard_of(record))]
    found += [("", text) for text in _of_kind(document)]
    found += _choices(document.result)
    found += _said(_without_choices(document.result))
    found += [
        (one.name.partition(" [")[0], f"{one.text}: {one.remark}" if one.refused else one.remark)
        for one in quantities(document.result)
        if one.remark and one.text != number(None)
    ]
    names: dict[str, list[str]] = {}
    for of, text in found:
        if any(other.endswith(f": {text}") for _, other in found):
            continue  # a warning, which names its file, says it
        names.setdefault(text, []).append(of)
    return [_line(list(dict.fromkeys(filter(None, own))), text) for text, own in names.items()][:MOST_LINES]


def _chosen(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Spectra with a choice of the assemblage, where there are several; one alone has its own words."""
    spectra = result.get("spectra") or ()
    return [one for one in spectra if one.get("choice")] if len(spectra) > 1 else []


def _choices(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What was not decided of each spectrum; of many how many have which answer."""
    weak = [one for one in _chosen(result) if not one["choice"].get("strong")]
    told = [(str(one.get("id")), f"by weak evidence: {standing_of(one['choice'])}") for one in weak]
    if len(told) <= MOST_CHOICES:
        yield from told
        return
    for text, count in Counter(text for _, text in told).most_common():
        yield counted(count, "spectrum"), text


def _without_choices(result: Mapping[str, Any]) -> Mapping[str, Any]:
    if not _chosen(result):
        return result
    return {**result, "spectra": [{k: v for k, v in one.items() if k != "choice"} for one in result["spectra"]]}


def _of_kind(document: Document) -> list[str]:
    """What the commands say below the tables of all results of a kind."""
    from lunarsci.spectra.mgm.assemblages import BIC_OF_CHOICE
    from lunarsci.twin.jobs.forces import TOGETHER
    from lunarsci.twin.jobs.states import DEEPEST

    result = document.result
    spectra = result.get("spectra") or ()
    found = (
        ("spectra-fit", BIC_OF_CHOICE, any(one.get("choice") for one in spectra)),
        ("twin-forces", TOGETHER, result.get("totals")),
        ("twin-states", DEEPEST, result.get("sinkages")),
    )
    return [text for kind, text, shown in found if kind == document.kind and shown]


def _line(names: Sequence[str], text: str) -> str:
    return f"{some_of(names, MOST_NAMED, '; ')}: {text}" if names else text


def _said(value: Any, name: str = "", one_of_many: bool = False) -> Iterator[tuple[str, str]]:
    """Texts of a result, and of a caveat or a reason what it is of; what is refused is told with its value."""
    if isinstance(value, list):
        for item in value[:MOST_ROWS]:
            yield from _said(item, name, len(value) > 1)
    elif isinstance(value, Mapping) and value.get("in_range") is not False:
        for key, item in value.items():
            if key in SAID or key.endswith("_note"):
                of = NOTED.get(key, _what(value, name) if key in OF_ONE else "")
                of += f" of {value['id']}" if key in NOTED and one_of_many else ""
                yield from ((of, text) for text in _texts(item))
            elif key == "findings":
                yield from (("", f"{one.get('what', one.get('quantity'))}") for one in item if "what" in one)
            elif key != "observations":
                yield from _said(item, key)


def _what(record: Mapping[str, Any], name: str) -> str:
    """What a caveat or a reason is of."""
    if record.get("quantity") in SHORT and any(part in name for part in METHODS):
        return f"{SHORT[record['quantity']]} by {regression(name)}"
    return words(name).partition(" [")[0]


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
