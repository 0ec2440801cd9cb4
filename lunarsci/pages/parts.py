"""The numbers of a result, each with its error, the parts of it, and why it should not be used, if so."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

from lunarsci.names import counted, some_of
from lunarsci.pages.documents import Document
from lunarsci.pages.rock_answers import standing_of
from lunarsci.pages.words import MOST, heard_of, measured, number, percent, unit, words
from lunarsci.regolith.jobs.identify import alone_title
from lunarsci.result import AS_PRIOR, doubt_about, from_prior
from lunarsci.spectra.jobs.bands import METHODS, SHORT, regression
from lunarsci.spectra.mgm import PERCENT_OF, with_trend

PARTS = {
    "sigma": "standard error",
    "trend_sigma": "of the trend",
    "random": "random part",
    "systematic": "systematic part",
    "calibration": "calibration, shared",
    "method": "choice of method",
    "gaussian": "minimum or Gaussian",
    "continuum": "choice of continuum",
    "common_sigma": "common to all",
    "model": "of the model",
    "systematic_sigma": "systematic part",
    "low": "from",
    "high": "to",
}
"""Ends of keys that are a part of an error, and what each is."""
OF_CONTINUUM = re.compile(r"b[acd](1000|2000)(_nm)?")
"""Bands, whose systematic part is the spread over continua alone."""
VALUES = ("value", "mean", "fraction", "median")
"""Keys of a number that its object is named for."""
NOTES = (
    *("notes", "remarks", "reasons", "reason", "doubt", "caution", "caveat", "status", "why_none", "refused"),
    *("must_mend", "not_compared"),
)
"""Keys whose text says what an answer does not know."""
GROUPS = ("chemistry", "compositions", "spectra", "rocks", "parameters", "joint", "abundances", "end_members", "maps")
"""Keys that add nothing to a name."""
WITHIN = {
    "opx": (0.0, 1.0),
    "cpx": (0.0, 1.0),
    "fraction": (0.0, 1.0),
    "center_nm": (0.0, 3000.0),
    "fwhm_nm": (0.0, 3000.0),
    "strength": (-5.0, 5.0),
}
"""Lowest and highest value that can be; an error as wide says that nothing is known. Assumed."""
MANY = ("spectra", "rocks", "observations", "track", "stations", "designs", "drives", "soils", "numbers", "layers")
"""Lists that may be long; of others all are taken, up to `LONGEST`."""
LONGEST = 40
"""Entries of a list that are taken, where it is none of `MANY`."""
REFUSED = "not to be used"
"""Stands for a value that its command shows none of."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number or a short text of a result.

    Attributes
    ----------
    of : what it is of, in words.
    name : what it is, in words, with its unit.
    text : the value with its error; `not to be used` where the command shows none.
    parts : of the error, by what each is.
    remark : why it should not be used, or read with care.
    """

    of: str
    name: str
    text: str
    parts: Mapping[str, str] = field(default_factory=dict)
    remark: str = ""

    @property
    def refused(self) -> bool:
        return self.text == REFUSED


def quantities(record: Mapping[str, Any], of: tuple[str, ...] = (), most: int | None = None) -> Iterator[Quantity]:
    """All quantities of a record, in their order; of lists of objects those of one, or the first `most`.

    `of` are the keys that lead to the record.
    """
    spent = _keys_of_parts(record)
    named = next((key for key in VALUES if _is_number(record.get(key))), "")
    shared = doubt_about(record) if "in_domain" in record else ""
    alone = (bool(named) or "prior_sigma" in record) and any(key in record for key in ("in_range", "reason", "low"))
    for key, item in record.items():
        if key in spent or key in NOTES or item is None or key.endswith("_note") or (alone and key != named):
            continue
        if isinstance(item, Mapping):
            doubt = {"doubt": shared} if shared and _is_number(item.get("fraction")) else {}
            yield from quantities({**item, **doubt}, of if key in GROUPS else (*of, key), most)
        elif isinstance(item, list):
            yield from _of_list(key, item, of, most)
        elif _is_number(item):
            yield _quantity(record, key, of)
        elif key not in ("id", "key", "quantity", "unit", "in_range", "in_domain"):
            yield Quantity(_path(of), words(key), number(item))


def _of_list(key: str, items: list[Any], of: tuple[str, ...], most: int | None) -> Iterator[Quantity]:
    plain = not any(isinstance(one, dict | list) for one in items)
    if plain and 0 < len(items) <= 4 and most is None:
        yield Quantity(_path(of), words(key), ", ".join(number(one) for one in items))
    elif all(isinstance(one, Mapping) for one in items) and (len(items) == 1 or most is not None):
        for place, one in enumerate(items[: most if key in MANY else LONGEST]):
            named = next((str(one[name]) for name in ("id", "name", "quantity", "wheel") if one.get(name)), "")
            label = named or (key if len(items) == 1 else f"{words(key)} {place + 1}")
            yield from quantities(one, (*of, label), most)


def _quantity(record: Mapping[str, Any], key: str, of: tuple[str, ...]) -> Quantity:
    named = PARTS | ({"systematic": PARTS["continuum"]} if OF_CONTINUUM.fullmatch(key) else {})
    parts = {named[part]: record[name] for part, name in _parts_of(record, key).items()}
    name, symbol, above = _named(record, key, of)
    doubt = str(record.get("doubt") or ("" if "in_domain" in record else doubt_about(record)))
    if not doubt and _is_number(record.get("prior_sigma")) and from_prior(record.get("sigma"), record["prior_sigma"]):
        doubt = AS_PRIOR
    refused = bool(doubt)
    if not refused and record.get("domain") and isinstance(record["domain"], str):
        doubt = f"only if {record['domain']}"
    sigma = parts.get("standard error")
    if record.get("in_range") is False:
        return Quantity(_path(above), name, REFUSED, {}, doubt)
    within = WITHIN.get(key, (0.0, 100.0) if symbol == "mol %" else (-math.inf, math.inf))
    value = record[key]
    shown = measured(value, sigma, "", within) if sigma else number(value)
    if sigma and not refused and "trend_sigma" in record:
        shown = with_trend(shown, record["trend_sigma"])
    return Quantity(_path(above), name, shown, {part: number(float(size), 2) for part, size in parts.items()}, doubt)


def _named(record: Mapping[str, Any], key: str, of: tuple[str, ...]) -> tuple[str, str, tuple[str, ...]]:
    """Name with unit, the unit, and what it is of."""
    symbol = str(record.get("unit") or unit(key))
    if key not in VALUES or not of:
        return words(key), symbol, of
    last, above = of[-1], of[:-1]
    if record.get("quantity") in SHORT and any(part in last for part in METHODS):
        name = f"{SHORT[record['quantity']]} by {regression(last)}"
    elif last in PERCENT_OF:
        name, symbol = f"{PERCENT_OF[last]}, from band centres", "mol %"
    else:
        name, symbol = words(last), symbol if symbol != "-" and "[" not in words(last) else ""
    if key == "fraction":
        name = f"share of {name}"
    shown = name if not symbol or symbol == "-" else f"{name} [{symbol}]"
    return shown, symbol, above


def _path(of: Sequence[str]) -> str:
    return ", ".join(words(one).partition(" [")[0] for one in of)


def _is_number(item: Any) -> bool:
    return isinstance(item, int | float) and not isinstance(item, bool)


def _parts_of(record: Mapping[str, Any], key: str) -> dict[str, str]:
    """Keys of the parts of an error: `center_sigma_nm` and `center_nm_sigma` of `center_nm`, `sigma` of `value`."""
    stem, _, end = key.rpartition("_")
    keys = {}
    for part in PARTS:
        tries = [f"{key}_{part}", *([f"{stem}_{part}_{end}"] if stem else [])]
        tries += [part] if key in (*VALUES, "opx") else []
        name = next((one for one in tries if one != key and _is_number(record.get(one))), None)
        if name is not None:
            keys[part] = name
    return keys


def _keys_of_parts(record: Mapping[str, Any]) -> set[str]:
    return {name for key, item in record.items() if _is_number(item) for name in _parts_of(record, key).values()}


FIRST = (
    *("station", "wheel", "limit", "sense", "p50", "p95", "kept_by_95", "margin", "ok"),
    *("prior", "posterior", "log_bayes_factor"),
    *("band1000_status", "bc1000_nm", "bd1000", "band2000_status", "bc2000_nm", "bd2000"),
)
"""Columns that stand first in a table."""
SAYS = ("best", "sure", "open", "status")
"""Columns of what a result says of each thing in a table, before its numbers."""
STANDARD_ERROR = PARTS["sigma"]
"""The part of an error that is all of it."""
OF_ONE = ("caveat", "reason")
"""Notes that are of the one quantity of their object, whose name they get on the page."""
NOTED = {"band1000_note": "1 µm band", "band2000_note": "2 µm band"}
"""Further keys with notes, and what each is of."""
SILENT = ("ok", "converged", "", "nothing")
"""Notes that say nothing to be read."""
SINGLE_STATES = ("agreement", "bearing", "draws", "lateral", "observations", "reading", "sensitivity", "shear")
"""Keys of `regolith infer` that are of each state by itself; what these assume, its answer does not."""
AGREEMENT = "whether states solved so agree: a test of what is assumed here, not of the answer"
MOST_ASSUMED = 6
"""Values of a rover that are listed one by one."""
MOST_CHOICES = 6
"""Spectra of which what is open is stated one by one."""
MOST_ROWS, MOST_LINES, MOST_COLUMNS, MOST_NAMED = 48, 40, 12, 5
"""Of a table, of a list, across, and of names in a line, on the page; the files hold all."""


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table of ready-made cells.

    Attributes
    ----------
    title : what it is called, '' for none.
    headers : of its columns.
    rows : of cells, as many as headers.
    note : a line below it.
    """

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True, slots=True)
class PagePart:
    """Tables under a heading of their own.

    Attributes
    ----------
    title : the heading.
    remarks : what they should be read with, a line each.
    tables : the tables.
    """

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
    tested = [replace(one, title=AGREEMENT if one.title == "agreement" else one.title) for one in tables(single)]
    main = {key: item for key, item in result.items() if key not in SINGLE_STATES}
    return replace(document, result=main), PagePart(alone_title(taken), remarks, tested)


def tables(document: Document) -> list[PageTable]:
    """All numbers of a result: one table of single values, then one for each list of things alike."""
    single = _single(document.result)
    made = [PageTable("Single values", ["of", "quantity", "value"], single)] if single else []
    for key, items in _lists(document.result):
        made.append(_listed(words(key), items))
    return made


def _single(result: Mapping[str, Any]) -> list[list[str]]:
    """Rows of a table; what they are of is said where it changes."""
    groups: dict[str, list[Quantity]] = {"": []}
    for one in islice(quantities(result), 3 * MOST_ROWS):
        groups.setdefault(one.of, []).append(one)
    return [
        [of if place == 0 else "", one.name, _with_remark(one)]
        for of, members in groups.items()
        for place, one in enumerate(members)
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
        upper = "kept_by_95" if all(item.get("share") == 0.95 for item in items) else "kept"
        items = [{key.replace("kept", upper): item[key] for key in item if key not in ("p05", "p95")} for item in items]
    names = [key for key in ("id", "name", "quantity") if key in items[0]]
    flat = [
        {words(key): words(item[key]) if key == "quantity" else number(item[key]) for key in names}
        | _verdict(item)
        | {_column(one): one.text for one in quantities(item)}
        for item in items[:MOST_ROWS]
    ]
    first = [*(words(key) for key in names), *SAYS, *(words(key) for key in FIRST)]
    present = dict.fromkeys(key for row in flat for key in row)
    headers = [*(key for key in first if key in present), *(key for key in present if key not in first)]
    shown = headers[:MOST_COLUMNS]
    rows = [[row.get(name, "–") for name in shown] for row in flat]
    left = [f"{len(items) - MOST_ROWS} more rows"] if len(items) > MOST_ROWS else []
    left += [f"{len(headers) - len(shown)} more columns"] if len(headers) > len(shown) else []
    return PageTable(title, shown, rows, f"{' and '.join(left)}: in the file" if left else "")


def _verdict(item: Mapping[str, Any]) -> dict[str, str]:
    """What a result says of one thing, by columns of `SAYS`."""
    choice = item.get("choice") or {}
    cells = {key: ", ".join(choice[key]) or "–" for key in ("sure", "open") if key in choice}
    if "best" in item:
        cells["best"] = str(item["best"] or "not decided")
    return cells | ({"status": str(item["status"])} if isinstance(item.get("status"), str) else {})


def _column(one: Quantity) -> str:
    return f"{one.of}: {one.name}" if one.of else one.name


def budget(document: Document) -> PageTable | None:
    """Parts of the errors: a row a quantity, a column for what makes the error; None where none is stated."""
    stated = list(_with_errors(document.result))
    several = [one for one in stated if one.parts.keys() - {STANDARD_ERROR}]
    every = [*_shares(document.result), *(several or stated)]
    shown = every[:MOST_ROWS]
    if not shown:
        return None
    columns = list(dict.fromkeys(key for one in shown for key in one.parts if key != STANDARD_ERROR))
    valued, read_with = any(one.text for one in shown), any(one.remark for one in shown)
    rows = [
        [
            f"{one.of}: {one.name}" if one.of else one.name,
            *([one.text] if valued else []),
            *(one.parts.get(key, "–") for key in columns),
            *([one.remark] if read_with else []),
        ]
        for one in shown
    ]
    headers = ["quantity", *(["value"] if valued else []), *columns, *(["read with"] if read_with else [])]
    note = "errors are in the unit of their quantity, one standard error each; –: not stated, which does not mean 0"
    note += f"; {len(every) - len(shown)} more rows: in the file" if len(every) > len(shown) else ""
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
            numbers = [value for value in values if isinstance(value, float)]
            rms = (sum(value * value for value in numbers) / len(numbers)) ** 0.5 if numbers else None
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
        part, _, names = key.rpartition(".")
        parts.setdefault(part, []).append(words(names).partition(" [")[0])
    if not parts:
        return []
    if len(keys) > MOST_ASSUMED:
        named = ", ".join(part.replace("_", " ") for part in parts if part)
        return [f"of the rover, {len(keys)} values, of {named or 'several parts'}; its description names each"]
    text = "; ".join(f"{part}: {', '.join(names)}" for part, names in parts.items())
    return [f"of the rover, {text}"]


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
    notes = [("", str(text)) for text in (*(record.get("failures") or ()), *heard_of(record))]
    notes += [("", text) for text in _of_kind(document)]
    notes += _choices(document.result)
    notes += _notes_in(_without_choices(document.result))
    notes += [
        (one.name.partition(" [")[0], f"{one.text}: {one.remark}" if one.refused else one.remark)
        for one in quantities(document.result)
        if one.remark and one.text != number(None)
    ]
    names: dict[str, list[str]] = {}
    for of, text in notes:
        if any(other.endswith(f": {text}") for _, other in notes):
            continue  # a warning, which names its file, says it
        names.setdefault(text, []).append(of)
    return [_line(list(dict.fromkeys(filter(None, owners))), text) for text, owners in names.items()][:MOST_LINES]


def _chosen(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Spectra with a choice of the assemblage, where there are several; one alone has its own words."""
    spectra = result.get("spectra") or ()
    return [one for one in spectra if one.get("choice")] if len(spectra) > 1 else []


def _choices(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What was not decided of each spectrum; of many how many have which answer."""
    weak = [one for one in _chosen(result) if not one["choice"].get("strong")]
    open_ones = [(str(one.get("id")), f"by weak evidence, {standing_of(one['choice'])}") for one in weak]
    if len(open_ones) <= MOST_CHOICES:
        yield from open_ones
        return
    for text, count in Counter(text for _, text in open_ones).most_common():
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
    notes = (
        ("spectra-fit", BIC_OF_CHOICE, any(one.get("choice") for one in spectra)),
        ("twin-forces", TOGETHER, result.get("totals")),
        ("twin-states", DEEPEST, result.get("sinkages")),
    )
    return [text for kind, text, shown in notes if kind == document.kind and shown]


def _line(names: Sequence[str], text: str) -> str:
    return f"{some_of(names, MOST_NAMED, '; ')}: {text}" if names else text


def _notes_in(value: Any, name: str = "", one_of_many: bool = False) -> Iterator[tuple[str, str]]:
    """Texts of a result, and of a caveat or a reason what it is of; what is refused is stated with its value."""
    if isinstance(value, list):
        for item in value[:MOST_ROWS]:
            yield from _notes_in(item, name, len(value) > 1)
    elif isinstance(value, Mapping) and value.get("in_range") is not False:
        for key, item in value.items():
            if key in NOTES or key.endswith("_note"):
                of = NOTED.get(key, _what(value, name) if key in OF_ONE else "")
                of += f" of {value['id']}" if key in NOTED and one_of_many else ""
                yield from ((of, text) for text in _texts(item))
            elif key == "findings":
                yield from (("", f"{one.get('what', one.get('quantity'))}") for one in item if "what" in one)
            elif key != "observations":
                yield from _notes_in(item, key)


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
