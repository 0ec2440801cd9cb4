"""One observation: image cube, short-wave table and their labels, found by sequence number and read together.

The cube of the VNIR detector is 100 bands of 256 x 256 pixels, 4-byte floats without a header; the tables hold
short-wave radiances (300 rows), and auxiliary rows of the cube (100 bands).

Whether what a label says of time, place and Sun can be true together, and fits the name of its file.

The Sun's direction depends on nothing but time and place: an angle, a year, a hemisphere that is wrong shows, whatever
else agrees with it. What shows nowhere: a time off by whole synodic months (29.5 days), which moves the Sun by a degree
or two and changes its distance by up to 3 %, where names, labels and tables agree on it.
"""

import math
import re
import stat
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.spectra.rows import NamedTable, Row, split_lines
from lunarsci.spectra.vnis.channels import CUBE_SHAPE, SWIR_NM, VNIR_NM, equal_frames, repeated_rows
from lunarsci.spectra.vnis.label import Label, ProductName, check_supported, product_name, read_label
from lunarsci.sun import sun_incidence_deg

LANDING_SITE = (177.5991, -45.4446)
"""Longitude and latitude of Chang'E-4, Liu et al. (2019), Nat. Commun. 10, 4229, 10.1038/s41467-019-12278-3, for labels
without a place of the rover; it has stayed within 0.1 deg. [deg]"""
SUN_DEG, WRONG_SUN_DEG = 0.3, 3.0
"""An incidence further than the first from the Sun's is in doubt, than the second is wrong: the two labels of
observation 136 agree with the Sun to 0.01 deg, which moves by 0.5 deg in an hour. 0.3 deg change the reflectance by 1 %
at 64 deg and by 2 % at 77 deg. Assumed. [deg]"""
_SLACK = timedelta(minutes=10)
_WRONG_SESSION = timedelta(days=1)
"""A product's name has the times of the session that it was measured in; the one public observation whose times are
known lies within it; the first row of a scan may precede its label. Slack and what is wrong are assumed."""


def doubts_of(label: Label) -> list[str]:
    """Why a label cannot be trusted, one sentence each; none for a sound one.

    Raises DataError where Sun or session are so far off that time, place or angles must be wrong.
    """
    return [doubt for doubt in (_of_sun(label), _of_session(label)) if doubt]


def _of_sun(label: Label) -> str:
    stated = label.geometry.incidence_deg
    stated_place = math.isfinite(label.longitude_deg) and math.isfinite(label.latitude_deg)
    place = (label.longitude_deg, label.latitude_deg) if stated_place else LANDING_SITE
    true = sun_incidence_deg(label.start + (label.stop - label.start) / 2, *place)
    if abs(stated - true) <= SUN_DEG:
        return ""
    says = f"{label.file}: states the Sun {stated:.2f} deg from the vertical; then and there it stood {true:.2f} deg"
    if abs(stated - true) > WRONG_SUN_DEG:
        raise DataError(f"{says}: angle, time or place is wrong, fetch the label again")
    return f"{says} from it"


def _of_session(label: Label) -> str:
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
    if outside > _WRONG_SESSION:
        raise DataError(f"{says}; it belongs to another observation, or a time is wrong, fetch it again")
    return says


Cube = npt.NDArray[np.float32]

CUBE_BYTES = 4 * int(np.prod(CUBE_SHAPE))
_AXES = tuple(zip(("band", "line", "sample"), CUBE_SHAPE, strict=True))
_TYPES = {"ieee754lsbsingle": "<f4", "ieee754msbsingle": ">f4"}
_PLAUSIBLE = (1e-8, 1e3)
"""Radiance of sunlit ground is some 1e-4 to 1 W m-2 sr-1 nm-1; numbers far from it are not radiance. Assumed. [same]"""
_WORST_SHARE = 0.5
"""Share of good values below which a channel is bad altogether; assumed."""


def read_cube(source: InputFile, label: Label) -> Cube:
    """Radiance as the file has it, shape (100, 256, 256); read-only and not copied. [W m-2 sr-1 nm-1]

    Raises DataError when size, axes, number type or byte order are not those of a VNIR cube.
    """
    described = next((file for file in label.files if file.axes), None)
    if described is None:
        raise DataError(f"{label.file}: describes no image array; fetch the label of the VD product again")
    axes = " x ".join(f"{elements} {name}" for name, elements in described.axes)
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
    """Whether most of a sample of the numbers is neither zero nor of a radiance's size, or absurd."""
    sample = cube[::9, ::8, ::8]
    with np.errstate(all="ignore"):
        size = np.abs(sample.astype(np.float64))
        good = (size == 0) | ((size > _PLAUSIBLE[0]) & (size < _PLAUSIBLE[1])) | np.isnan(size)
    return bool(good.mean() < _WORST_SHARE)


_SWIR_COLUMNS = ("time", "band", "integration time", "solar elevation", "radiance", "quality")
_VNIR_COLUMNS = ("time", "band", "integration time", "solar elevation", "quality")
_CODE = re.compile(r"(0[xX])?[0-9a-fA-F]{1,8}", re.ASCII)


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
    stated = [file.records for file in label.files if file.fields]
    if stated and stated[0] not in (None, SWIR_NM.size):
        raise DataError(f"{label.file}: states {stated[0]} rows, the table has {SWIR_NM.size}; fetch it again")
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


_APART = timedelta(hours=24)
"""The two scans follow each other within minutes; assumed wide."""
_SUN_DEG_PER_HOUR = 360.0 / (29.530589 * 24)
"""By the mean synodic month, 29.530589 days: Chapront et al. (2002), 10.1051/0004-6361:20020420. [deg/h]"""
LABEL_BYTES = 2_000_000
"""A label is smaller; assumed."""
_TABLE_BYTES = 1_000_000
_AWAY_DEG = 0.001
"""30 m on the Moon; assumed."""


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
    result = [(other, str(folder / other)) for other in _names(folder)]
    same = [(other, p) for p, other in ((p, product_name(o)) for o, p in result) if other and _same(other, name)]
    cube_label, cube = (_one(same, "VD", is_label, name, folder) for is_label in (True, False))
    table_label, table = (_one(same, "SD", is_label, name, folder) for is_label in (True, False))
    wanted = ("AUX", "VD", name.version, False)
    flags = [p for other, p in same if (other.role, other.kind, other.version, other.is_label) == wanted]
    if len(flags) > 1:
        both = " and ".join(Path(p).name for p in flags[:2])
        raise DataError(f"{name.observation}: {both} are both its auxiliary table; keep one of them in the folder")
    return Parts(name.observation, cube_label, cube, table_label, table, flags[0] if flags else None)


def _same(other: ProductName, name: ProductName) -> bool:
    return (other.observation, other.instrument, other.level) == (name.observation, name.instrument, name.level)


def _names(folder: Path) -> list[str]:
    try:
        return sorted(p.name for p in folder.iterdir())
    except OSError as error:
        raise DataError(f"{folder}: folder cannot be listed ({error.strerror}); check the path") from error


def _one(same: Sequence[tuple[ProductName, str]], kind: str, is_label: bool, name: ProductName, folder: Path) -> str:
    fits = [(o.version, p) for o, p in same if (o.role, o.kind, o.is_label) == ("SCI", kind, is_label)]
    right = [p for version, p in fits if version == name.version]
    what = f"{'label' if is_label else 'data file'} of its {kind} product"
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
    cube_label_file, table_label_file = _read(parts.cube_label, LABEL_BYTES), _read(parts.table_label, LABEL_BYTES)
    cube_label, table_label = read_label(cube_label_file), read_label(table_label_file)
    _check_pair(cube_label, table_label)
    _check_files(parts, cube_label, table_label)
    doubts = [*doubts_of(cube_label), *doubts_of(table_label)]
    table_file, cube_file = _read(parts.table, _TABLE_BYTES), _read(parts.cube, CUBE_BYTES)
    table = read_swir_table(table_file, table_label)
    cube = read_cube(cube_file, cube_label)
    read = [cube_label_file, cube_file, table_label_file, table_file]
    flags = None
    if parts.flags is not None:
        read.append(_read(parts.flags, _TABLE_BYTES))
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


def _read(path: str, most_bytes: int) -> InputFile:
    """A regular file of a plausible size: a link to a device or a download gone wild is not read at all."""
    try:
        status = Path(path).stat()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); check the path and its access rights") from error
    if not stat.S_ISREG(status.st_mode):
        raise DataError(f"{path}: is no regular file; put the product itself there")
    if status.st_size > most_bytes:
        raise DataError(
            f"{path}: {status.st_size} bytes, at most {most_bytes} are expected; another file, fetch it again"
        )
    return read_input(path)


def _check_pair(cube: Label, table: Label) -> None:
    if abs(cube.start - table.start) > _APART:
        days = abs(cube.start - table.start).total_seconds() / 86400
        raise DataError(
            f"{table.file}: was measured {days:.1f} days from {cube.file}; they are no pair, fetch them again"
        )
    _check_same_sun(cube, table)
    apart = max(abs(cube.latitude_deg - table.latitude_deg), abs(cube.longitude_deg - table.longitude_deg))
    if apart > _AWAY_DEG:
        warnings.warn(
            f"{table.file}: the rover's place differs by {apart:.4f} deg from that of the image", LunarSciWarning, 3
        )


def _check_same_sun(cube: Label, table: Label) -> None:
    """Both look the same way; the Sun moves on by half a degree an hour."""
    hours = abs(cube.start - table.start).total_seconds() / 3600
    for name, limit in (("incidence", SUN_DEG + _SUN_DEG_PER_HOUR * hours), ("emission", SUN_DEG)):
        one, other = (getattr(label.geometry, f"{name}_deg") for label in (cube, table))
        if abs(one - other) > limit:
            raise DataError(
                f"{table.file}: states {name} {other:g} deg, the image's label {one:g}, {60 * hours:.0f} min apart; "
                "one of them is wrong, fetch both labels again"
            )


def _check_files(parts: Parts, cube: Label, table: Label) -> None:
    """Each label describes the file beside it, by product and by the size it states."""
    for label, path in ((cube, parts.cube), (table, parts.table)):
        described = [file for file in label.files if product_name(file.name) is not None]
        names = [product_name(file.name) for file in described]
        wanted = product_name(path)
        fits = [file for file, name in zip(described, names, strict=True) if name is not None and name == wanted]
        if not fits:
            listed = ", ".join(file.name for file in label.files) or "no file"
            raise DataError(f"{label.file}: describes {listed[:120]}, not {Path(path).name}; fetch the label again")
        size = Path(path).stat().st_size if Path(path).is_file() else None
        if size is not None and fits[0].size is not None and size != fits[0].size:
            why = "truncated or another file" if size < fits[0].size else "another file"
            raise DataError(f"{path}: {size} bytes, its label states {fits[0].size}: {why}; fetch both again")
