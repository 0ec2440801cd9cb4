"""File names and labels of Chang'E spectrometer products, taken apart and checked."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.documents import xml_root
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.photometry import Geometry, phase_angle_deg
from lunarsci.spectra.rows import number

_NAME = re.compile(
    r"(?P<synthetic>SYNTHETIC_)?(?P<mission>CE\d)[A-Z0-9-]*_[A-Z0-9]+_(?P<instrument>VNIS|LMS)-(?P<kind>[A-Z]+)[A-Z0-9-]*"
    r"_(?P<role>SCI|AUX|CAL)_[A-Z]_(?P<start>\d{14})_(?P<stop>\d{14})_(?P<sequence>\d{4})_(?P<version>[A-Z])"
    r"\.(?P<level>\d[A-Z])(?P<label>L?)",
    re.IGNORECASE,
)
_LONGEST_NAME = 255


_ANGLES = ("incidence_angle", "azimuth_angle", "phase_angle")
SUN_DEG, WRONG_DEG = 0.3, 3.0
"""An incidence further than the first from the Sun's is in doubt, an angle further than the second from what others
give is wrong: the two labels of observation 136 agree with the Sun to 0.01 deg, which moves by 0.5 deg in an hour, and
with their own directions to 0.02 deg. 0.3 deg change the reflectance by 1 % at 64 deg, by 2 % at 77 deg. Assumed."""
_YEARS = (2013, 2100)
"""No VNIS flew before Chang'E-3."""
LONGEST = timedelta(days=1)
"""What belongs to one observation, which takes about eight minutes, lies nearer together; assumed."""
_WHOLE = re.compile(r"[0-9]{0,15}")
_PLAIN = {
    **{"scaling_factor": ("1", "1.0"), "value_offset": ("0", "0.0"), "offset": ("0", "0.0")},
    "axis_index_order": ("last index fastest",),
}
"""What elements of a label say, where they say something; values are radiances as they stand in the file."""


@dataclass(frozen=True, slots=True)
class ProductName:
    """A name taken apart, letters in upper case.

    Attributes
    ----------
    mission, instrument, kind, role : such as CE4, VNIS, VD (image cube) or SD (short-wave table), SCI or AUX.
    start, stop : session times, 14 digits. sequence : 4 digits, the same for the parts of one observation.
    version : letter of the processing. level : such as 2B. is_label : the detached label rather than the data.
    synthetic : made by `lunarsci spectra simulate`.
    """

    mission: str
    instrument: str
    kind: str
    role: str
    start: str
    stop: str
    sequence: str
    version: str
    level: str
    is_label: bool
    synthetic: bool

    @property
    def is_read(self) -> bool:
        """Whether it is a part of a Chang'E-4 level 2B observation."""
        part = self.role == "SCI" and self.kind in ("VD", "SD")
        return part and (self.mission, self.instrument, self.level) == ("CE4", "VNIS", "2B")

    @property
    def observation(self) -> str:
        """Id of the observation that the product is a part of, such as CE4-0136."""
        return f"{'SYNTHETIC-' if self.synthetic else ''}{self.mission}-{self.sequence}"


def product_name(path: str) -> ProductName | None:
    """The parts of a file's name, whatever the case of its letters; None for other names."""
    name = Path(path).name
    match = _NAME.fullmatch(name) if len(name) <= _LONGEST_NAME else None
    if match is None:
        return None
    part = {key: (value or "").upper() for key, value in match.groupdict().items()}
    texts = {
        key: part[key] for key in ("mission", "instrument", "kind", "role", "start", "stop", "sequence", "version")
    }
    return ProductName(**texts, level=part["level"], is_label=part["label"] == "L", synthetic=bool(part["synthetic"]))


def check_supported(name: ProductName, file: str) -> None:
    """Raise DataError, with the reason, for products whose layout is not known well enough to read them."""
    why = ""
    if name.instrument == "LMS":
        why = "of the lunar mineralogical spectrometer (LMS), whose wavelengths are not published; convert it to CSV"
    elif name.mission != "CE4":
        why = f"VNIS of {name.mission}, whose labels do not describe it: only Chang'E-4 is read; convert it to CSV"
    elif name.level != "2B":
        why = f"level {name.level}, radiance is in level 2B; fetch the file ending in .2B"
    elif name.kind not in ("VD", "SD") or name.role == "CAL":
        why = f"the product {name.kind}, not an image cube VD or a table SD; name one of these"
    if why:
        raise DataError(f"{file}: is {why}")


@dataclass(frozen=True, slots=True)
class DataFile:
    """What a label says about one data file; None where it says nothing.

    Attributes
    ----------
    name : file name without folder. size : bytes.
    axes : (name, elements) from slowest to fastest, for an array. data_type : of the array's elements.
    fields : names of the columns, for a table.
    """

    name: str
    size: int | None
    axes: tuple[tuple[str, int], ...]
    data_type: str | None
    fields: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Label:
    """A label, checked.

    Attributes
    ----------
    file : of the label. name : what its product id says.
    calibration_version : `version_id`; 2.0 since the in-flight calibration of 2019-07-09.
    start, stop : of the measurement, UTC.
    geometry : incidence of sunlight, emission towards the instrument, phase. [deg]
    latitude_deg, longitude_deg : of the rover; NaN where not given.
    files : data files it describes.
    """

    file: str
    name: ProductName
    calibration_version: float
    start: datetime
    stop: datetime
    geometry: Geometry
    latitude_deg: float
    longitude_deg: float
    files: tuple[DataFile, ...]


def read_label(source: InputFile) -> Label:
    """Read and check a label. Raises DataError, one line with its name, for anything it lacks or contradicts."""
    root = xml_root(source.name, source.data)
    if root.tag != "product_observational":
        elements = root.tag[:40]
        raise DataError(f"{source.name}: is no PDS4 product label (root element '{elements}'); name the .2BL file")
    start, stop = (_time(root, f".//time_coordinates/{key}_date_time", source.name) for key in ("start", "stop"))
    if not timedelta() <= stop - start <= LONGEST:
        ends = f"from {start:%Y-%m-%dT%H:%M} to {stop:%Y-%m-%dT%H:%M}"
        raise DataError(f"{source.name}: was measured {ends}; it takes minutes, correct the label or fetch it again")
    return Label(
        file=source.name,
        name=_name(root, source.name),
        calibration_version=_number(root, ".//identification_area/version_id", source.name),
        start=start,
        stop=stop,
        geometry=_geometry(root, source.name),
        latitude_deg=_coordinate(root, "latitude", source.name),
        longitude_deg=_coordinate(root, "longitude", source.name),
        files=tuple(_data_file(area, source.name) for area in root.findall("file_area_observational")),
    )


def _name(root: Element, file: str) -> ProductName:
    """The product id, which must be that of the label's file name in mission, kind and sequence."""
    text = _text(root, ".//mission_area/product_id", file) or _text(
        root, ".//identification_area/logical_identifier", file
    )
    inside = product_name(text.rpartition(":")[2]) if text else None
    outside, sequence = product_name(file), _text(root, ".//mission_area/sequence_id", file)
    if inside is None:
        raise DataError(f"{file}: its product id {text[:80]!r} is no VNIS product name; fetch the label again")
    same = outside is None or replace(outside, is_label=False) == inside
    if not same or (sequence and sequence.zfill(4) != inside.sequence):
        number = f" in sequence {sequence[:20]}" if same else ""
        raise DataError(f"{file}: describes {text[:100]!r}{number}: swapped or another version; fetch it again")
    return inside


def _geometry(root: Element, file: str) -> Geometry:
    """The angles of the label. Raises DataError where its directions of Sun and view give another phase angle."""
    sun = ".//angle_pointing_results/solar/{}"
    view = ".//angle_pointing_results/center_point/{}"
    incidence = _angle(root, sun.format("incidence_angle"), file)
    emission, azimuth, phase = (_angle(root, view.format(key), file) for key in _ANGLES)
    try:
        geometry = Geometry(incidence, emission, phase)
    except ParameterError as error:
        raise DataError(f"{file}: {error}") from error
    expected = phase_angle_deg(incidence, emission, azimuth - _angle(root, sun.format("azimuth_angle"), file))
    if abs(expected - phase) > WRONG_DEG:
        what = f"states a phase angle of {phase:g} deg, its directions of Sun and view give {expected:.1f}"
        raise DataError(f"{file}: {what}; one of them is wrong, correct the label")
    return geometry


def _coordinate(root: Element, key: str, file: str) -> float:
    """Of the rover, NaN where the label has none. [deg]"""
    path = f".//rover_location/{key}"
    return _angle(root, path, file) if _text(root, path, file) else math.nan


def _data_file(area: Element, file: str) -> DataFile:
    """A data file of the label. Raises DataError for number types and orders that are not read."""
    axes = sorted(
        (
            _count(axis, "sequence_number", file) or 0,
            _text(axis, "axis_name", file).lower()[:40],
            _count(axis, "elements", file) or 0,
        )
        for axis in area.iter("axis_array")
    )
    for element in area.iter():
        content = (element.text or "").strip().lower()
        if content and content not in _PLAIN.get(element.tag, (content,)):
            what = f"{element.tag} {content[:40]!r}, where only {_PLAIN[element.tag][0]!r} is read"
            raise DataError(f"{file}: states {what}; fetch the label again, or convert the file")
    return DataFile(
        name=_text(area, "file/file_name", file),
        size=_count(area, "file/file_size", file),
        axes=tuple((name, elements) for _, name, elements in axes),
        data_type=_text(area, ".//element_array/data_type", file) or None,
        fields=tuple(_text(field, "name", file) for field in area.iter("field_character")),
    )


def _text(root: Element, path: str, file: str) -> str:
    """Text of the only element at a path, '' where there is none; one that comes twice decides nothing."""
    elements = root.findall(path)
    if len(elements) > 1 or (elements and len(elements[0])):
        what = "holds other elements" if len(elements) == 1 else f"appears {len(elements)} times"
        raise DataError(f"{file}: {path.lstrip('./')} {what}; fetch the label again")
    return (elements[0].text or "").strip() if elements else ""


def _parsed(root: Element, path: str, file: str, parse: Callable[[str], Any], what: str) -> Any:
    """What the text at a path says. Raises DataError where `parse` gives None."""
    text = _text(root, path, file)
    if (value := parse(text)) is None:
        elements = f"is {text[:40]!r}, not {what}" if text else "is missing"
        raise DataError(f"{file}: {path.lstrip('./')} {elements}; correct the label or fetch it again")
    return value


def _count(root: Element, path: str, file: str) -> int | None:
    text = str(_parsed(root, path, file, lambda text: text if _WHOLE.fullmatch(text) else None, "a count"))
    return int(text) if text else None


def _number(root: Element, path: str, file: str) -> float:
    return float(_parsed(root, path, file, _finite, "a number"))


def _finite(text: str) -> float | None:
    value = number(text)
    return value if value is not None and math.isfinite(value) else None


def _angle(root: Element, path: str, file: str) -> float:
    value, element = _number(root, path, file), root.find(path)
    unit = "" if element is None else element.get("unit", "deg").strip().lower()
    if unit not in ("deg", "degree", "degrees", "°", ""):
        raise DataError(f"{file}: {path.lstrip('./')} is in {unit[:20]!r}, expected degrees; correct the label")
    return value


def _time(root: Element, path: str, file: str) -> datetime:
    moment: datetime = _parsed(root, path, file, _moment, "a time such as 2020-07-16T08:17:04Z")
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def _moment(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return moment if _YEARS[0] <= moment.year < _YEARS[1] else None
