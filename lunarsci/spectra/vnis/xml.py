"""XML from strangers: no document types, no entities, no namespaces, any encoding, bounded size.

The standard library's expat does the parsing. Whatever could expand or fetch something needs a document type
declaration, and a product label has no use for one: it is refused.
"""

import codecs
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from lunarsci.errors import DataError
from lunarsci.inputs import InputFile

__all__ = ["LABEL_BYTES", "parse_xml"]

LABEL_BYTES = 2_000_000
_DEEPEST = 64
_REMEDY = "fetch it again"


def parse_xml(source: InputFile) -> Element:
    """The root element; tags in lower case, prefixes cut off.

    Raises DataError for a document type declaration, broken XML, more than 2 MB or 64 levels.
    """
    if len(source.data) > LABEL_BYTES:
        raise DataError(f"{source.name}: {len(source.data)} bytes are too many for a label; {_REMEDY}")
    builder = TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise DataError(f"{source.name}: elements nested more than {_DEEPEST} deep; {_REMEDY}")
        builder.start(_local(tag), {_local(key): value for key, value in attributes.items()})

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(_local(tag))

    def refuse(*_: object) -> None:
        raise DataError(f"{source.name}: has a document type declaration, which a label never has; do not trust it")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(_element_text(source).encode("utf-8"), True)
    except expat.ExpatError as error:
        where = f"line {error.lineno}, column {error.offset + 1}"
        reason = expat.errors.messages[error.code]
        raise DataError(f"{source.name}: broken XML at {where} ({reason}; truncated?); {_REMEDY}") from error
    return builder.close()


def _local(tag: str) -> str:
    return tag.rpartition(":")[2].lower()


def _element_text(source: InputFile) -> str:
    """Chinese descriptions come in UTF-8 or GB 18030, whatever the declaration says; numbers and names are ASCII."""
    if source.data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    else:
        encodings = ["utf-8-sig", "gb18030"]
    for encoding in encodings:
        try:
            return source.data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return source.data.decode("utf-8", errors="replace")
