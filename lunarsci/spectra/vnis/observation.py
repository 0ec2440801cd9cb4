"""One observation: image cube, short-wave table and their labels, found by sequence number and read together.

The cube of the VNIR detector is 100 bands of 256 x 256 pixels, 4-byte floats without a header; the tables hold
short-wave radiances (300 rows), and auxiliary rows of the cube (100 bands).

It is checked whether what a label says of time, place and Sun can be true together, and fits the name of its file. The
Sun's direction depends on nothing but time and place: an angle, a year, a hemisphere that is wrong shows, whatever
else agrees with it. What shows nowhere: a time off by whole synodic months (29.5 days), which moves the Sun by a degree
or two and changes its distance by up to 3 %, where names, labels and tables agree on it.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.spectra.rows import NamedTable, Row, split_lines
from lunarsci.spectra.vnis.channels import CUBE_SHAPE, SWIR_NM, VNIR_NM, equal_frames, repeated_rows
from lunarsci.spectra.vnis.label import (
    LONGEST,
    SUN_DEG,
    WRONG_DEG,
    Label,
    ProductName,
    check_supported,
    product_name,
    read_label,
)
from lunarsci.sun import sun_incidence_deg

LANDING_SITE = (177.5991, -45.4446)
"""Longitude and latitude of Chang'E-4, Liu et al. (2019), Nat. Commun. 10, 4229, 10.1038/s41467-019-12278-3, for labels
without a place of the rover; it has stayed within 0.1 deg. [deg]"""
_SLACK = timedelta(minutes=10)
"""Beyond the times of a label, or of the session in its name: the first row may precede its label; assumed."""


Cube = npt.NDArray[np.float32]
CUBE_BYTES = 4 * int(np.prod(CUBE_SHAPE))
_AXES = tuple(zip(("band", "line", "sample"), CUBE_SHAPE, strict=True))
_TYPES = {"ieee754lsbsingle": "<f4", "ieee754msbsingle": ">f4"}
_PLAUSIBLE = (1e-8, 1e3)
"""Radiance of sunlit ground is some 1e-4 to 1 W m-2 sr-1 nm-1; numbers far from it are not radiance. Assumed. [same]"""
_SWIR_COLUMNS = ("time", "band", "integration time", "solar elevation", "radiance", "quality")
_VNIR_COLUMNS = ("time", "band", "integration time", "solar elevation", "quality")
_CODE = re.compile(r"(0[xX])?[0-9a-fA-F]{1,8}", re.ASCII)


def doubts_of(label: Label) -> list[str]:
    """Why a label cannot be trusted, one sentence each; none for a sound one.

    Raises DataError where Sun or session are so far off that time, place or angles must be wrong.
    """
    return [doubt for doubt in (_of_sun(label), _of_session(label)) if doubt]


def _of_sun(label: Label) -> str:
    """That the label's incidence is not that of the Sun then and there; '' where it is."""
    stated = label.geometry.incidence_deg
    stated_place = math.isfinite(label.longitude_deg) and math.isfinite(label.latitude_deg)
    place = (label.longitude_deg, label.latitude_deg) if stated_place else LANDING_SITE
    true = sun_incidence_deg(label.start + (label.stop - label.start) / 2, *place)
    if abs(stated - true) <= SUN_DEG:
        return ""
    says = f"{label.file}: states the Sun {stated:.2f} deg from the vertical; then and there it stood {true:.2f} deg"
    if abs(stated - true) > WRONG_DEG:
        raise DataError(f"{says}: angle, time or place is wrong, fetch the label again")
    return f"{says} from it"


def _of_session(label: Label) -> str:
    """That the measurement lies outside the session of the label's name; '' where it lies within."""
    try:
        first, last = (
            datetime.strptime(text, "%Y%m%d%H%M%S").replace(tzinfo=UTC) for text in (label.name.start, label.name.stop)
        )
    except ValueError:
        return f"{label.file}: its name has {label.name.start} to {label.name.stop}, which are no times"
    outside = max(first - label.start, label.stop - last)
    if outside <= _SLACK:
        return ""
    says = f"{label.file}: was measured at {label.start:%Y-%m-%dT%H:%M}, outside the {first:%Y-%m-%dT%H:%M} to "
    says += f"{last:%Y-%m-%dT%H:%M} of its name"
    if outside > LONGEST:
        raise DataError(f"{says}; it belongs to another observation, or a time is wrong, fetch it again")
    return says


def read_cube(source: InputFile, label: Label) -> Cube:
    """Radiance as the file has it, shape (100, 256, 256); read-only and not copied. [W m-2 sr-1 nm-1]

    Raises DataError when size, axes, number type or byte order are not those of a VNIR cube.
    """
    described = next((file for file in label.files if file.axes), label.files[0])
    axes = " x ".join(f"{elements} {name}" for name, elements in described.axes) or "no array"
    expected = f"a cube has 100 band x 256 line x 256 sample, IEEE754LSBSingle, {CUBE_BYTES} bytes"
    alike = described.axes == _AXES and described.size in (None, CUBE_BYTES)
    if not alike or (described.data_type or "").lower() not in _TYPES:
        stated = f"{axes[:80]} of type {described.data_type!r}, {described.size} bytes"
        raise DataError(f"{label.file}: states {stated}; {expected}; fetch data and label again")
    if len(source.data) != CUBE_BYTES:
        short = "truncated; " if len(source.data) < CUBE_BYTES else ""
        raise DataError(f"{source.name}: {len(source.data)} bytes; {expected}; {short}fetch it again")
    kind = _TYPES[(described.data_type or "").lower()]
    cube = np.frombuffer(source.data, kind).reshape(CUBE_SHAPE)
    if _implausible(cube):
        swapped = not _implausible(cube.view(cube.dtype.newbyteorder()))
        why = "its byte order is not what the label says" if swapped else "its numbers are no radiances"
        raise DataError(f"{source.name}: {why}; fetch data and label again")
    if (equal := equal_frames(cube)) is not None:
        one, other = (f"{VNIR_NM[band]:g}" for band in equal)
        raise DataError(f"{source.name}: the images at {one} and {other} nm have the same numbers; fetch it again")
    return cube.astype(np.float32, copy=False)


def _implausible(cube: npt.NDArray[np.floating]) -> bool:
    """Whether the quartiles of a sample of the numbers, zeros apart, are of no radiance's size."""
    with np.errstate(all="ignore"):
        size = np.abs(cube[::9, ::8, ::8].astype(np.float64))
        size = size[(size != 0) & ~np.isnan(size)]
    low, high = np.quantile(size, (0.25, 0.75)) if size.size else _PLAUSIBLE
    return not _PLAUSIBLE[0] <= low <= high <= _PLAUSIBLE[1]


@dataclass(frozen=True, slots=True)
class SwirTable:
    """Radiance of the 300 short-wave channels, as the file has it, NaN where it has no number; [W m-2 sr-1 nm-1].

    `flagged` is True where the quality code is not zero.
    """

    radiance: FloatArray
    flagged: BoolArray


def read_swir_table(source: InputFile, label: Label) -> SwirTable:
    """Read the table of an SD product: six columns between blanks, one row per channel, wavelengths ascending.

    Raises DataError, with the line, for other counts, repeated or missing channels, or times outside the label's.
    """
    table = _table(source, label, SWIR_NM.size, _SWIR_COLUMNS)
    radiance = table.numbers("radiance")
    radiance[~np.isfinite(radiance)] = np.nan
    if (twice := repeated_rows(radiance)) is not None:
        first, again = (row + 1 for row in twice)
        raise DataError(f"{source.name}: three numbers from row {first} come again from row {again}; fetch it again")
    return SwirTable(radiance, _flags(table))


def read_vnir_flags(source: InputFile, label: Label) -> BoolArray:
    """True for the bands of the cube whose quality code is not zero, from its AUX table; shape (100,).

    Raises DataError as `read_swir_table` does.
    """
    return _flags(_table(source, label, VNIR_NM.size, _VNIR_COLUMNS))


def _table(source: InputFile, label: Label, count: int, columns: Sequence[str]) -> NamedTable:
    """A row for each channel, at times within the label's that do not go back: one is measured after the other."""
    rows = tuple(Row(n, tuple(line.split())) for n, line in split_lines(inputs.text(source))[0])
    if len(rows) != count or {len(row.fields) for row in rows} != {len(columns)}:
        odd = next((row for row in rows if len(row.fields) != len(columns)), None)
        what = f"line {odd.line} has {len(odd.fields)} columns" if odd else f"{len(rows)} rows"
        wanted = f"{count} rows of {len(columns)} columns ({', '.join(columns)})"
        raise DataError(f"{source.name}: {what}, a table has {wanted}; truncated? fetch it again")
    table = NamedTable(source.name, tuple(columns), rows, decimal_comma=False)
    band, moments = table.numbers("band"), np.array([_moment(cell) for cell in table.cells("time")])
    table.refuse(band != np.arange(count) + (band[0] == 1), "band", "channels count up from 0 or 1; fetch it again")
    low, high = (label.start - _SLACK).timestamp(), (label.stop + _SLACK).timestamp()
    span = f"a time of its label, {label.start:%Y-%m-%dT%H:%M} to {label.stop:%H:%M}"
    table.refuse(~((moments >= low) & (moments <= high)), "time", f"rows have {span}; fetch both again")
    table.refuse(np.diff(moments, prepend=low) < 0, "time", "times do not go back: rows are mixed, fetch it again")
    table.refuse(~(table.numbers("integration time") > 0), "integration time", "it is above 0; fetch it again")
    return table


def _moment(text: str) -> float:
    """Seconds of a time, UTC; NaN for none. [s]"""
    try:
        return datetime.fromisoformat(text if text[-1:] in "Zz" else text + "Z").timestamp()
    except ValueError:
        return math.nan


def _flags(table: NamedTable) -> BoolArray:
    codes = table.cells("quality")
    wrong = np.array([_CODE.fullmatch(code) is None for code in codes])
    table.refuse(wrong, "quality", "quality codes are hexadecimal; correct it or fetch it again")
    return np.array([int(code, 16) != 0 for code in codes])


@dataclass(frozen=True, slots=True)
class Parts:
    """Paths of the files of one observation; `flags` (the AUX table) may be missing."""

    id: str
    cube_label: str
    cube: str
    table_label: str
    table: str
    flags: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What was measured, as the files have it.

    Attributes
    ----------
    id : such as CE4-0136. synthetic : made by `lunarsci spectra simulate`.
    cube_label, table_label : labels of the two products, each with its own time and angles.
    cube : radiance of the imager, shape (100, 256, 256). [W m-2 sr-1 nm-1]
    cube_flags : bands of the cube with a quality code; None where there is no AUX table.
    table : radiance of the short-wave channels.
    doubts : why its labels cannot be trusted, one sentence each.
    inputs : path to SHA-256 of every file read.
    """

    id: str
    synthetic: bool
    cube_label: Label
    table_label: Label
    cube: Cube
    cube_flags: BoolArray | None
    table: SwirTable
    inputs: dict[str, str]
    doubts: tuple[str, ...] = ()


def one_per_observation(paths: Sequence[str]) -> list[str]:
    """The paths with the parts of one observation, in one folder, reduced to one, of the latest version among them.

    Of products that are not read (other levels and kinds) one stands for the observation only where there is no other.
    """
    chosen: dict[tuple[str, str], tuple[tuple[bool, str], str]] = {}
    for path in paths:
        name = product_name(path)
        key = (str(Path(path).parent), name.observation) if name else (path, "")
        rank = (name.is_read, name.version) if name else (False, "")
        if key not in chosen or rank > chosen[key][0]:
            chosen[key] = (rank, path)
    return [path for _, path in chosen.values()]


def find_parts(path: str) -> Parts:
    """The files of the observation that a label or data file belongs to, all in its folder.

    Raises DataError where the name is none of VNIS, the layout is not known, or a part is missing.
    """
    name = product_name(path)
    if name is None:
        raise DataError(f"{path}: is no VNIS product name (such as CE4_GRAS_VNIS-SD_SCI_N_..._0136_B.2BL)")
    check_supported(name, path)
    folder = Path(path).parent
    every = [(other, str(p)) for p in sorted(folder.glob("*")) if (other := product_name(p.name)) is not None]
    same = [(other, path) for other, path in every if _same(other, name)]
    cube_label, cube, table_label, table = (
        _one(same, name, folder, kind, is_label) for kind in ("VD", "SD") for is_label in (True, False)
    )
    has_flags = any((other.role, other.version) == ("AUX", name.version) for other, _ in same)
    flags = _one(same, name, folder, "VD", False, "AUX") if has_flags else None
    return Parts(name.observation, cube_label, cube, table_label, table, flags)


def _same(other: ProductName, name: ProductName) -> bool:
    return (other.observation, other.instrument, other.level) == (name.observation, name.instrument, name.level)


def _one(
    same: Sequence[tuple[ProductName, str]],
    name: ProductName,
    folder: Path,
    kind: str,
    is_label: bool,
    role: str = "SCI",
) -> str:
    """Path of the one file of an observation that is of a kind and a role. Raises DataError for none or several."""
    fits = [(o.version, p) for o, p in same if (o.role, o.kind, o.is_label) == (role, kind, is_label)]
    right = [p for version, p in fits if version == name.version]
    what = f"{'label' if is_label else 'data file' if role == 'SCI' else 'auxiliary table'} of its {kind} product"
    if not right:
        other = f"; there is only {Path(fits[0][1]).name}" if fits else ""
        raise DataError(f"{name.observation}: no {what}, version {name.version}, in {folder}{other}; put it there")
    if len(right) > 1:
        both = " and ".join(Path(p).name for p in right[:2])
        raise DataError(f"{name.observation}: {both} are both the {what}; keep one of them in the folder")
    return right[0]


def read_observation(path: str) -> Observation:
    """Read the observation that a label or data file belongs to, and check its parts against each other.

    Raises DataError, one line: the file, what is wrong with it, what to do.
    """
    parts = find_parts(path)
    cube_label_file, table_label_file = _read(parts.cube_label), _read(parts.table_label)
    cube_label, table_label = read_label(cube_label_file), read_label(table_label_file)
    _check_pair(cube_label, table_label)
    _check_files(parts, cube_label, table_label)
    doubts = [*doubts_of(cube_label), *doubts_of(table_label)]
    angles = [label.geometry.emission_deg for label in (cube_label, table_label)]
    if abs(angles[0] - angles[1]) > SUN_DEG:
        says = f"states emission {angles[1]:g} deg, the image's label {angles[0]:g}: one of them is wrong"
        doubts.append(f"{table_label.file}: {says}")
    table_file, cube_file = _read(parts.table), _read(parts.cube)
    table = read_swir_table(table_file, table_label)
    cube = read_cube(cube_file, cube_label)
    read = [cube_label_file, cube_file, table_label_file, table_file]
    flags = None
    if parts.flags is not None:
        read.append(_read(parts.flags))
        flags = read_vnir_flags(read[-1], cube_label)
    return Observation(
        id=parts.id,
        synthetic=cube_label.name.synthetic,
        cube_label=cube_label,
        table_label=table_label,
        cube=cube,
        cube_flags=flags,
        table=table,
        inputs={file.name: file.sha256 for file in read},
        doubts=tuple(doubts),
    )


def _read(path: str) -> InputFile:
    """A regular file that is no larger than a cube: a link to a device or a download gone wild is not read at all."""
    if Path(path).exists() and not (Path(path).is_file() and Path(path).stat().st_size <= CUBE_BYTES):
        raise DataError(
            f"{path}: is no regular file of {CUBE_BYTES} bytes at most, as all products are; fetch it again"
        )
    return read_input(path)


def _check_pair(cube: Label, table: Label) -> None:
    if abs(cube.start - table.start) > LONGEST:
        days = abs(cube.start - table.start).total_seconds() / 86400
        raise DataError(
            f"{table.file}: was measured {days:.1f} days from {cube.file}; they are no pair, fetch them again"
        )


def _check_files(parts: Parts, cube: Label, table: Label) -> None:
    """Each label describes the file beside it, by product and by the size it states."""
    for label, path in ((cube, parts.cube), (table, parts.table)):
        described = {product_name(file.name): file for file in label.files}
        file = described.get(product_name(path))
        size = Path(path).stat().st_size if Path(path).is_file() else None
        if file is None or (size is not None and file.size not in (None, size)):
            listed = ", ".join(f"{one.name} of {one.size} bytes" for one in label.files) or "no file"
            raise DataError(
                f"{label.file}: describes {listed[:150]}, not {Path(path).name} of {size} bytes: truncated, or "
                "another file; fetch both again"
            )
