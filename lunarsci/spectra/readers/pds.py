"""Labels of the Planetary Data System: which tables and images are in which file, and how they are laid out.

PDS3 labels are `KEY = value` lines in nested objects (PDS Standards Reference 3.8, chapter 12), PDS4 labels XML (PDS4
Standards Reference, 1.22). No library reads both with their marks of no data and wavelengths of bands, and refuses what
is cut: `pdr` takes half a table and loads no image of real labels of M3, `pds4_tools` reads PDS4 alone
(`docs/validation/files.md`).
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from lunarsci.errors import DataError
from lunarsci.io import inputs
from lunarsci.io.documents import xml_root
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.spectra.readers.astropy_tables import spectrum_table
from lunarsci.spectra.readers.columns import is_wavelength
from lunarsci.spectra.readers.table import SpectrumTable, length_unit
from lunarsci.spectra.rows import number

LABELS = (".lbl", ".xml", ".lblx")
MOST_DEEP = 32
_ODL = re.compile(r"^\s*(\^?[A-Za-z][\w:]*)\s*=\s*(.*?)\s*$")
_POINTER = re.compile(r'"?([^",()<>\s][^",()<>]*?)"?\s*(?:,\s*(\d+)\s*(<BYTES>)?)?$', re.IGNORECASE)
_DELIMITERS = {"comma": ",", "horizontal tab": "\t", "semicolon": ";", "vertical bar": "|"}
_PDS3_ORDER = {"PC": "<", "LSB": "<", "VAX": "<", "MSB": ">", "IEEE": ">", "SUN": ">", "MAC": ">"}
_STORAGE = {"LINE_INTERLEAVED": "bil", "BAND_SEQUENTIAL": "bsq", "SAMPLE_INTERLEAVED": "bip"}
_AXES = {"band line sample": "bsq", "line band sample": "bil", "line sample band": "bip"}


@dataclass(frozen=True, slots=True)
class LabelField:
    """A column: its bytes in a record, from 0, or its place in a line with delimiters; `missing` mark no data."""

    name: str
    unit: str
    start: int
    length: int
    dtype: str = ""
    missing: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class TableObject:
    """A table: file, bytes before it, rows, bytes of a row, and what is between fields, '' where their places tell."""

    file: str
    offset: int
    rows: int
    row_bytes: int
    fields: tuple[LabelField, ...]
    delimiter: str = ""


@dataclass(frozen=True, slots=True)
class ImageObject:
    """An image: file, bytes before it, lines, samples, bands, type of its numbers, interleave, unit, and no-data marks.

    `wavelength` of the bands, empty where the label has none, in `wavelength_unit`.
    """

    name: str
    file: str
    offset: int
    lines: int
    samples: int
    bands: int
    dtype: str
    interleave: str
    unit: str = ""
    ignored: tuple[float, ...] = ()
    wavelength: tuple[float, ...] = ()
    wavelength_unit: str = ""


@dataclass(frozen=True, slots=True)
class PdsLabel:
    """Tables and images of a label."""

    file: str
    tables: tuple[TableObject, ...]
    images: tuple[ImageObject, ...]


@dataclass(slots=True)
class _Object:
    """An object of a PDS3 label: its name, its keys with their texts, and the objects within it."""

    name: str
    keys: dict[str, str] = field(default_factory=dict)
    parts: "list[_Object]" = field(default_factory=list)


def is_pds_label(source: InputFile, start: str = "") -> bool:
    """Whether a file is a label of either kind, by its first lines."""
    label = source.data[:4000]
    return b"PDS_VERSION_ID" in label or b"Product_Observational" in label


def read_pds_label(source: InputFile) -> PdsLabel:
    """What a label describes. Raises DataError for one that is broken, or describes neither table nor image."""
    if b"PDS_VERSION_ID" in source.data[:4000]:
        tables, images = _of_pds3(source)
    else:
        tables, images = _of_pds4(xml_root(source.name, source.data.lstrip()), source.name)
    if not tables and not images:
        raise DataError(f"{source.name}: a PDS label of neither a table nor an image; give the file of spectra")
    return PdsLabel(source.name, tuple(tables), tuple(images))


def label_beside(path: str) -> str | None:
    """The label of a data file: of the same name, beside it; None where there is none."""
    given = Path(path)
    names = {given.with_suffix(end).name for low in LABELS for end in (low, low.upper())}
    result = [str(given.with_name(name)) for name in sorted(names) if given.with_name(name).is_file()]
    return result[0] if result else None


def label_of_table(source: InputFile) -> InputFile | None:
    """The label that describes a table file `.tab`, beside it; None for other files and other labels."""
    name = label_beside(source.name) if Path(source.name).suffix.lower() == ".tab" else None
    if name is None or not is_pds_label(label := read_input(name)):
        return None
    file_name = Path(source.name).name.lower()
    return label if any(one.file.lower() == file_name for one in read_pds_label(label).tables) else None


def data_file(label: str, name: str) -> str:
    """Path of a file that a label names, beside it, in whatever case. Raises DataError where there is none."""
    plain = bool(name) and Path(name).name == name
    beside = Path(label).parent.iterdir() if plain else ()
    result = next((one for one in beside if one.name.lower() == name.lower()), None)
    if result is None:
        what = f"its data file {name} is missing" if plain else f"its data file {name[:60]!r} has no plain file name"
        raise DataError(f"{label}: {what}; put it beside the label")
    return str(result)


def _of_pds3(source: InputFile) -> tuple[list[TableObject], list[ImageObject]]:
    """Tables and images of a PDS3 label: objects that it points to, with columns as text or with lines and samples."""
    text = source.data.split(b"\nEND\r")[0].split(b"\nEND\n")[0]
    root = _objects(inputs.text(InputFile(source.name, text + b"\n")), source.name)
    file_name, tables, images = Path(source.name).name, list[TableObject](), list[ImageObject]()
    for holder, part in _walk(root):
        pointer = holder.keys.get(f"^{part.name}")
        if pointer is None:
            continue
        record = _whole(holder.keys.get("RECORD_BYTES") or root.keys.get("RECORD_BYTES"))
        file, offset = _pointed(pointer, file_name, record)
        columns = [one for one in part.parts if one.name == "COLUMN"]
        if columns and part.keys.get("INTERCHANGE_FORMAT", "ASCII").strip('"').upper() == "ASCII":
            spread = "SPREADSHEET" in part.name
            fields = tuple(_pds3_field(one, k) for k, one in enumerate(columns))
            rows, size = _whole(part.keys.get("ROWS")), _whole(part.keys.get("ROW_BYTES"))
            tables.append(TableObject(file, offset, rows, size, fields, "," if spread else ""))
        elif "LINE_SAMPLES" in part.keys:
            images.append(_pds3_image(part, root, file, offset))
    return tables, images


def _objects(text: str, file: str) -> _Object:
    """Nested objects of a PDS3 label; values over several lines are joined."""
    root = _Object("")
    open_objects, lines = [root], iter(re.sub(r"/\*.*?\*/", " ", text).splitlines())
    for line in lines:
        if line.strip().upper() in ("END_OBJECT", "END_GROUP"):
            open_objects = open_objects[:-1] or [root]
        if (match := _ODL.match(line)) is None:
            continue
        key, value = match[1].upper(), match[2]
        while (value.count("(") > value.count(")") or value.count('"') % 2) and (more := next(lines, None)) is not None:
            value += " " + more.strip()
        if key in ("OBJECT", "GROUP"):
            if len(open_objects) > MOST_DEEP:
                raise DataError(f"{file}: objects nested more than {MOST_DEEP} deep; fetch it again")
            open_objects[-1].parts.append(_Object(value.strip('"').upper()))
            open_objects.append(open_objects[-1].parts[-1])
        elif key in ("END_OBJECT", "END_GROUP"):
            open_objects = open_objects[:-1] or [root]
        else:
            open_objects[-1].keys[key] = value
    return root


def _walk(parent: _Object) -> Iterator[tuple[_Object, _Object]]:
    """Every object within one, at any depth, with the one that holds it."""
    for part in parent.parts:
        yield parent, part
        yield from _walk(part)


def _pointed(pointer: str, file_name: str, record: int) -> tuple[str, int]:
    """File and bytes before an object: ("x.tab", 3), "x.tab", or a record of the label's own file."""
    match = _POINTER.match(pointer.strip("() "))
    if match is None:
        return file_name, 0
    if match[1].isdigit() or match[1].upper().endswith("<BYTES"):
        return file_name, (int(match[1]) - 1) * (1 if "<BYTES>" in pointer.upper() else record)
    first = int(match[2] or 1) - 1
    return match[1].strip(), first * (1 if match[3] else record)


def _pds3_field(column: _Object, place: int) -> LabelField:
    """A column of a table, the one after `place` others."""
    keys = column.keys
    marks = [keys.get(f"{what}_CONSTANT", "") for what in ("MISSING", "INVALID", "NOT_APPLICABLE", "NULL")]
    start = _whole(keys.get("START_BYTE"), place + 1) - 1
    return LabelField(_plain(keys.get("NAME", "")), _plain(keys.get("UNIT", "")), start, _whole(keys.get("BYTES")),
                 missing=_numbers(marks))  # fmt: skip


def _pds3_image(part: _Object, root: _Object, file: str, offset: int) -> ImageObject:
    """An image of a PDS3 label, `offset` bytes into `file`; its wavelengths may be anywhere in the label."""
    keys = part.keys
    kind, bits = keys.get("SAMPLE_TYPE", "").strip('"').upper(), _whole(keys.get("SAMPLE_BITS"), 8)
    order = next((sign for start, sign in _PDS3_ORDER.items() if kind.startswith(start)), ">")
    letter = "f" if "REAL" in kind or "FLOAT" in kind else "u" if "UNSIGNED" in kind else "i"
    bins = next((one for _, one in _walk(root) if "BAND_BIN_CENTER" in one.keys), None)
    centres = re.findall(r"[\d.eE+-]+", bins.keys["BAND_BIN_CENTER"]) if bins else []
    marks = [keys.get(key, "") for key in ("MISSING_CONSTANT", "CORE_NULL", "INVALID_CONSTANT", "MISSING")]
    return ImageObject(
        part.name, file, offset,
        _whole(keys.get("LINES")), _whole(keys.get("LINE_SAMPLES")), _whole(keys.get("BANDS"), 1),
        f"{order}{letter}{bits // 8}", _STORAGE.get(keys.get("BAND_STORAGE_TYPE", "").strip('"').upper(), "bsq"),
        _plain(keys.get("UNIT", "")), _numbers(marks), _numbers(centres),
        _plain(bins.keys.get("BAND_BIN_UNIT", "")) if bins else "",
    )  # fmt: skip


def _of_pds4(root: Element, file: str) -> tuple[list[TableObject], list[ImageObject]]:
    """Tables and images of a PDS4 label."""
    tables, images = list[TableObject](), list[ImageObject]()
    centres = [one for one in root.iter() if one.tag in ("center_wavelength", "center_value")]
    for area in root.iter("file_area_observational"):
        name = _text(area, "file/file_name")
        for part in area:
            if part.tag in ("table_character", "table_delimited", "table_binary"):
                tables.append(_pds4_table(part, name))
            elif part.tag.startswith(("array_2d", "array_3d")):
                images.append(_pds4_image(part, name, centres))
    return tables, images


def _pds4_table(part: Element, name: str) -> TableObject:
    """A table of a PDS4 label, in the file `name`."""
    fields = [one for one in part.iter() if one.tag in ("field_character", "field_delimited", "field_binary")]
    marks = ("missing_constant", "invalid_constant", "error_constant", "not_applicable_constant")
    return TableObject(
        name, _whole(_text(part, "offset")), _whole(_text(part, "records")), _whole(_text(part, ".//record_length")),
        tuple(
            LabelField(_text(one, "name"), _text(one, "unit"), _whole(_text(one, "field_location"), k + 1) - 1,
                  _whole(_text(one, "field_length")), _dtype(_text(one, "data_type")) if "binary" in one.tag else "",
                  _numbers([_text(one, f"special_constants/{mark}") for mark in marks]))
            for k, one in enumerate(fields)
        ),
        _DELIMITERS.get(_text(part, "field_delimiter").lower(), ",") if "delimited" in part.tag else "",
    )  # fmt: skip


def _pds4_image(part: Element, name: str, centres: Sequence[Element]) -> ImageObject:
    """An image of a PDS4 label, in the file `name`, with the wavelengths of all its bands."""
    axes = sorted((_whole(_text(one, "sequence_number")), _text(one, "axis_name").lower(),
                   _whole(_text(one, "elements"))) for one in part.iter("axis_array"))  # fmt: skip
    sizes = {axis: size for _, axis, size in axes}
    order = " ".join(axis for _, axis, _ in axes)
    marks = [one.text or "" for group in part.iter("special_constants") for one in group]
    return ImageObject(
        part.tag, name, _whole(_text(part, "offset")),
        sizes.get("line", 0), sizes.get("sample", 0), sizes.get("band", 1),
        _dtype(_text(part, ".//element_array/data_type")), _AXES.get(order, "bsq"),
        _text(part, ".//element_array/unit"), _numbers(marks), _numbers([one.text or "" for one in centres]),
        centres[0].get("unit", "") if centres else "",
    )  # fmt: skip


def _dtype(kind: str) -> str:
    """Type of numbers of PDS4, such as IEEE754LSBSingle, UnsignedMSB2; '' for text."""
    order = "<" if "LSB" in kind else ">"
    if kind.startswith("IEEE754"):
        return order + ("f4" if "Single" in kind else "f8")
    if match := re.fullmatch(r"(Un)?[Ss]igned(?:LSB|MSB|Byte)(\d?)", kind):
        return f"{order}{'u' if match[1] else 'i'}{match[2] or 1}"
    return ""


def _text(parent: Element, path: str) -> str:
    """Text of an element, '' where there is none."""
    result = parent.find(path)
    return "" if result is None else (result.text or "").strip()


def _plain(value: str) -> str:
    """A value of a PDS3 label without its quotes, on one line."""
    return " ".join(value.strip().strip('"').split())


def _whole(value: str | None, default: int = 0) -> int:
    """The whole number that a text begins with."""
    match = re.match(r"\s*\"?(\d{1,15})", value or "")
    return int(match[1]) if match else default


def _numbers(texts: Sequence[str]) -> tuple[float, ...]:
    """The numbers among texts, those of PDS3 in base 16 as IEEE single precision."""
    result = list[float]()
    for cell in texts:
        plain = cell.strip().strip('"')
        if match := re.fullmatch(r"16#([0-9A-Fa-f]{8})#", plain):
            result.append(float(np.frombuffer(bytes.fromhex(match[1]), ">f4")[0]))
        elif re.fullmatch(r"[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?|[+-]?\.\d+", plain):
            result.append(float(plain))
    return tuple(result)


_RADIANCE = ("W/", "W /", "RADIANCE", "MICROWATT", "WATT", "uW", "µW", "DN")
_NO_UNIT = ("N/A", "NONE", "UNITLESS", "I/F", "I_OVER_F", "DIMENSIONLESS", "UNK", "")
"""What labels have where no unit is named."""


def read_pds(source: InputFile) -> SpectrumTable:
    """The spectra of a label's first table with a wavelength by name or unit, else with two columns of numbers.

    Raises DataError where there is none, and for a label of an image.
    """
    label = read_pds_label(source)
    spectral = [one for one in label.tables if any(_is_spectral(column) for column in one.fields)]
    if not spectral and label.images:
        image = max(label.images, key=lambda one: (radiance(one.unit), one.bands))
        what = f"an image of {image.lines} lines, {image.samples} samples and {image.bands} bands"
        unit = f" in {image.unit}: radiance, no reflectance; {CALIBRATE}" if radiance(image.unit) else ""
        raise DataError(f"{source.name}: is the label of {what}{unit}; `lunarsci spectra map` takes images of spectra")
    for table in spectral or label.tables:
        data = read_input(data_file(source.name, table.file))
        result = _columns(data, table)
        if sum(np.asarray(column).dtype.kind == "f" for column in result.values()) > 1:
            read = spectrum_table(_as_table(result, table), source, "pds")
            about = {**read.metadata, "inputs": {source.name: source.sha256, data.name: data.sha256}}
            return replace(read, metadata=about)
    raise DataError(f"{source.name}: no table with two columns of numbers; give the label of spectra")


def _is_spectral(column: LabelField) -> bool:
    return is_wavelength(column.name) or length_unit(_unit(column)) is not None


def _unit(column: LabelField) -> str:
    """As PDS3 writes it: NANOMETER <nm>."""
    return column.unit.split("<")[0].strip()


CALIBRATE = "take its reflectance: of M3 the _RFL.IMG of Level 2, of VNIS by `lunarsci spectra calibrate FOLDER`"
"""What to do with radiance."""


def radiance(unit: str) -> bool:
    """Whether a unit says radiance or numbers of a detector."""
    return any(word.lower() in unit.lower() for word in _RADIANCE)


def _columns(data: InputFile, table: TableObject) -> dict[str, Any]:
    """By name, numbers of each field with NaN for what is marked, or its text."""
    if any(one.dtype for one in table.fields):
        return _binary(data, table)
    if table.delimiter:
        lines = text(InputFile(data.name, data.data[table.offset :])).splitlines()[: table.rows or None]
        rows = [line.split(table.delimiter) for line in lines if line.strip()]
    else:
        size = table.row_bytes
        lines = _records(data, table)
        rows = [[line[one.start : one.start + one.length] for one in table.fields] for line in lines]
        if table.rows and size and len(rows) != table.rows:
            raise DataError(f"{data.name}: {len(rows)} rows, its label says {table.rows} (truncated?); fetch it again")
    result: dict[str, Any] = {}
    for k, one in enumerate(table.fields):
        cells = [row[k].strip().strip('"') if k < len(row) else "" for row in rows]
        values = [number(cell) for cell in cells]
        name = one.name if one.name not in result else f"{one.name}_{k + 1}"
        result[name] = cells if None in values else _unmarked(np.array(values, dtype=float), one.missing)
    return result


def _records(data: InputFile, table: TableObject) -> list[str]:
    """Lines of a table of fixed columns; where its bytes hold line ends elsewhere than the label says, as they are."""
    body = text(InputFile(data.name, data.data[table.offset :]))
    lines = [line for line in body.splitlines() if line.strip()]
    width = max(one.start + one.length for one in table.fields)
    if len(lines) == 1 and table.row_bytes >= width:
        lines = [body[k : k + table.row_bytes] for k in range(0, len(body), table.row_bytes)]
    return lines[: table.rows or None]


def _binary(data: InputFile, table: TableObject) -> dict[str, Any]:
    """Columns by name: numbers, NaN where a mark says so, and lists of texts."""
    formats = [np.dtype(one.dtype or f"S{max(one.length, 1)}") for one in table.fields]
    ends = [one.start + kind.itemsize for one, kind in zip(table.fields, formats, strict=True)]
    beyond = min(one.start for one in table.fields) < 0 or max(ends) > table.row_bytes
    if beyond or len(data.data) < table.offset + table.rows * table.row_bytes or not table.rows:
        what = "has fields beyond its rows" if beyond else "says more (truncated?)"
        raise DataError(f"{data.name}: {len(data.data)} bytes, its label {what}; fetch it again")
    names = [f"f{k}" for k in range(len(formats))]
    layout: Any = {"names": names, "formats": formats, "offsets": [one.start for one in table.fields]}
    layout["itemsize"] = table.row_bytes
    values: Any = np.frombuffer(data.data, np.dtype(layout), table.rows, table.offset)
    return {
        one.name: _unmarked(values[key].astype(float), one.missing)
        if one.dtype
        else [cell.decode("latin-1") for cell in values[key].tolist()]
        for key, one in zip(names, table.fields, strict=True)
    }


def _unmarked(values: Any, missing: tuple[float, ...]) -> Any:
    """NaN in place of marks of no data, in the same array."""
    values[np.isin(values, missing)] = np.nan
    return values


def _as_table(columns: dict[str, Any], table: TableObject) -> Any:
    from astropy.table import Table

    result = Table(columns)
    for name, one in zip(result.colnames, table.fields, strict=True):
        if np.asarray(result[name]).dtype.kind == "f" and _unit(one).upper() not in _NO_UNIT:
            result[name].unit = _unit(one)
    return result
