"""TOML, JSON, YAML and XML from files that nobody vouches for: what no parser's own error covers becomes one.

The parsers are those of Python, PyYAML and expat; our own is what they let through, or refuse by another error: nesting
without end, numbers beyond 64 bits, document types in XML. Tables of a document become dataclasses.
"""

import codecs
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType
from typing import Any, TypeVar, get_args, get_type_hints
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from lunarsci.errors import DataError, ParameterError
from lunarsci.names import one_of

Record = TypeVar("Record")

LARGEST = 2**63
"""Whole numbers are smaller: those of 64 bits, as in TOML 1.0."""
TOO_DEEP = "nested too deeply"
DEEPEST = 256
"""Levels of elements: the limit of libxml2 (xmlParserMaxDepth)."""


def toml_document(content: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises tomllib.TOMLDecodeError, also for tables nested too deeply and whole numbers beyond 64 bits.
    """
    try:
        document = tomllib.loads(content)
    except tomllib.TOMLDecodeError:
        raise
    except (RecursionError, ValueError) as error:
        deep = isinstance(error, RecursionError)
        raise tomllib.TOMLDecodeError(TOO_DEEP if deep else "a number of thousands of digits") from error
    open_ones: list[Any] = [document]
    while open_ones:
        value = open_ones.pop()
        if isinstance(value, int) and abs(value) >= LARGEST:
            raise tomllib.TOMLDecodeError("a whole number beyond 64 bits")
        open_ones += value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return document


def toml_of(name: str, data: bytes | str) -> dict[str, Any]:
    """The tables of a TOML file of that name. Raises DataError for one that is none."""
    try:
        return toml_document(data if isinstance(data, str) else data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise DataError(f"{name}: not a readable TOML file") from error
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"{name}: not valid TOML: {error}") from error


def check_keys(table: Any, keys: Iterable[str], where: str) -> None:
    """Raises ParameterError for what is no table, and for a key that is not one of these."""
    if not isinstance(table, dict):
        raise ParameterError(f"{where} is missing, or no table; its keys are: {', '.join(keys)}")
    for key in table:
        if key not in keys:
            raise ParameterError(f"'{key}' is not a key of {where}; {one_of(key, keys)}")


def number_of(value: Any, name: str) -> float:
    """A number of a table. Raises ParameterError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{name} is {value!r}; give a number")
    return float(value)


def record_of(kind: type[Record], table: Any, where: str) -> Record:
    """A dataclass of numbers, texts and such dataclasses, from a table by its fields. Raises ParameterError."""
    kinds = get_type_hints(kind)
    check_keys(table, kinds, where)
    for one in fields(kind):  # type: ignore[arg-type]
        if one.name not in table and one.default is MISSING and one.default_factory is MISSING:
            raise ParameterError(f"{where} has no {one.name}")
    return kind(**{name: _value(value, kinds[name], name) for name, value in table.items()})


def records_of(kind: type[Record], tables: Any, name: str) -> tuple[Record, ...]:
    """The same of each of some tables in double brackets, whose number its error names. Raises ParameterError."""
    if not isinstance(tables, list):
        raise ParameterError(f"write each {name} as [[{name}]], in double brackets")
    records = []
    for number, table in enumerate(tables, 1):
        try:
            records.append(record_of(kind, table, f"[[{name}]]"))
        except ParameterError as error:
            raise ParameterError(f"{name} {number}: {error}") from error
    return tuple(records)


def _value(value: Any, hint: Any, name: str) -> Any:
    kind = next(one for one in (*get_args(hint), hint) if one is not NoneType)
    if is_dataclass(kind):
        return record_of(kind, value, name)  # type: ignore[arg-type]
    return str(value) if kind is str else number_of(value, name)


def json_document(content: str, parse_constant: Callable[[str], Any] | None = None) -> Any:
    """The value of a JSON text; `parse_constant` is called for NaN and infinities.

    Raises json.JSONDecodeError, also for values nested too deeply and numbers beyond 64 bits.
    """

    def number(digits: str) -> float:
        whole = digits.lstrip("-").isdigit()
        value = int(digits) if whole and len(digits) <= 20 else float(digits)
        if math.isinf(value) or (whole and abs(value) >= LARGEST):
            kind = "whole number" if whole else "number"
            raise json.JSONDecodeError(f"a {kind} beyond 64 bits", content, content.find(digits))
        return value

    try:
        return json.loads(content, parse_int=number, parse_float=number, parse_constant=parse_constant)
    except RecursionError as error:
        raise json.JSONDecodeError(TOO_DEEP, content, 0) from error


def geojson_feature(shape: str, coordinates: Any, properties: Mapping[str, Any]) -> dict[str, Any]:
    """A feature of GeoJSON (RFC 7946); properties that are not finite are null."""
    about = {key: None if isinstance(value, float) and not math.isfinite(value) else value
             for key, value in properties.items()}  # fmt: skip
    return {"type": "Feature", "geometry": {"type": shape, "coordinates": coordinates}, "properties": about}


def yaml_document(content: str) -> Any:
    """The first document of a YAML text, with text for numbers, whatever tags say; and of what OpenCV writes.

    Raises ValueError for what is no YAML, also for values nested too deeply.
    """
    import yaml

    try:
        # The head of OpenCV, %YAML:1.0, is none of YAML.
        documents = yaml.load_all(re.sub(r"\A\s*%YAML.*", "", content), Loader=yaml.BaseLoader)
        return next((one for one in documents if one), None)
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(TOO_DEEP if isinstance(error, RecursionError) else " ".join(str(error).split())) from error


def xml_root(name: str, data: bytes) -> Element:
    """The root element of an XML text; tags in lower case, prefixes cut off.

    Whatever could expand or fetch something needs a document type declaration, and the label of a data product has no
    use for one. Raises DataError for such a declaration, broken XML, and more than 256 levels.
    """
    builder = TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise DataError(f"{name}: elements nested more than {DEEPEST} deep; fetch it again")
        builder.start(_local(tag), {_local(key): value for key, value in attributes.items()})

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(_local(tag))

    def refuse(*_: object) -> None:
        raise DataError(f"{name}: has a document type declaration, which a label never has; do not trust it")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(_xml_text(data).encode("utf-8"), True)
    except expat.ExpatError as error:
        where = f"line {error.lineno}, column {error.offset + 1}"
        reason = expat.errors.messages[error.code]
        raise DataError(f"{name}: broken XML at {where} ({reason}; truncated?); fetch it again") from error
    return builder.close()


def _local(tag: str) -> str:
    return tag.rpartition(":")[2].lower()


def _xml_text(data: bytes) -> str:
    """Chinese descriptions come in UTF-8 or GB 18030, whatever the declaration says; numbers and names are ASCII."""
    utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in ["utf-16"] if utf16 else ["utf-8-sig", "gb18030"]:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return data.decode("utf-8", errors="replace")
