"""What a file is, what is in it, and which commands take it, as a job.

The kind is read from the content first, and from the name only where the content leaves it open; what is in the file is
what the readers of the commands say of it, so that a file that they would refuse is known to be one.
"""

import re
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np

from lunarsci.errors import DataError, LunarSciError, LunarSciWarning, ParameterError
from lunarsci.heights.grid import ERROR_LAYERS
from lunarsci.heights.grids import NETCDF, holds_heights, read_grid
from lunarsci.heights.texts import node_columns
from lunarsci.io.documents import toml_document
from lunarsci.io.inputs import (
    BEGINNING,
    InputFile,
    InputStream,
    beginning,
    csv_rows,
    expand_inputs,
    no_data,
    open_input,
    read_input,
    read_json,
    text,
)
from lunarsci.io.tables import as_csv, read_csv_table, separator_of
from lunarsci.memory import as_named, named_within, on_disk, toml_text
from lunarsci.names import some_of
from lunarsci.registry import FORMATS, KINDS, TAKEN_BY, WHEEL
from lunarsci.regolith.columns import QUANTITIES, of_name
from lunarsci.regolith.prior import UNITS, default_prior, read_prior
from lunarsci.regolith.soil import read_soil, soil_tables
from lunarsci.regolith.states import read_state_table
from lunarsci.regolith.wheel import left_to_defaults, read_wheel
from lunarsci.result import Doubt, MadeFrom, Result
from lunarsci.rovers import RoverDescription, read_rover, rover_names, wheel_names
from lunarsci.spectra.readers.arrangements import header_channels
from lunarsci.spectra.readers.columns import is_wavelength
from lunarsci.spectra.readers.dispatch import read_spectra, recognised
from lunarsci.spectra.readers.pds import is_pds_label, read_pds_label
from lunarsci.spectra.readers.table import MAX_PERCENT

CAMERA_LABEL = re.compile(r"\bMODEL_COMPONENT_1\s*=|_point_observe_vector>|<(?:\w+:)?CAHV\w*_Model>", re.IGNORECASE)
INSTRUMENT = re.compile(
    r"\bINSTRUMENT_ID\s*=\s*[\"']?([\w-]+)|<(?:\w+:)?(?:ops_instrument_key|instrument_id)>\s*([^<\s]+)"
)
"""Name of a camera in a label."""
MAP_LABEL = re.compile(r"^\s*OBJECT\s*=\s*\"?IMAGE_MAP_PROJECTION", re.MULTILINE)
HEIGHT_WORDS = re.compile(
    r"\bUNIT\s*=\s*\"?(?:KILO)?M(?:ET(?:ER|RE)S?)?\b|elevation|topograph|terrain|\bD[TE]M|radius", re.I
)
"""What a label of a map says of heights."""
LARGEST_WHEEL = "lrv"
"""Whose radius no sinkage passes, where the rover is not known."""
WHEEL_ALONE = "a wheel alone"
LABELLED = ("images dem", "images dem --rig", "images dem --pose", "images locate", "images cameras")
"""Commands that take a picture with a label of its camera."""
M3_IMAGES = {"LOC": "longitude, latitude and radius of each pixel", "OBS": "angles and distances of each pixel"}
"""Images of M3 that lie beside its spectra."""
NAMES_LISTED = 6
"""Names that are listed."""
LOOKS_LIKE = {
    r"rpm|heading|yaw|odomet|encoder|^[fmr][lr]_": "could be telemetry; `twin states` wants the columns of "
    "`lunarsci template telemetry`",
    r"slip|sink|drawbar|pull|torque|load|force|(^|_)f[xyz]($|_)": "could be wheel states; `regolith infer` wants "
    "sinkage_m, normal_force_n, drawbar_pull_n, and slip_ratio, see `lunarsci template states`",
}
"""Columns, two or more, that tell what a table of another kind could be."""
TOML_KEYS = {
    "plan": ("leg",),
    "mission": ("target",),
    "rover": ("wheel",),
    "soil": ("cohesion_pa",),
    "pose": ("position_m",),
    "rig": ("left", "right"),
}
CSV_COLUMNS = {
    "craters": ("latitude_deg", "longitude_deg", "diameter_km"),
    "terrain": ("x_m", "y_m", "height_m"),
    "track": ("x_m", "y_m", "rut_m"),
    "states": ("sinkage_m", "normal_force_n"),
    "slips": ("sinkage_m", "slip_ratio"),
    "motion": ("time_s", "x_m", "y_m", "yaw_deg"),
    "positions": ("time_s", "x_m", "y_m"),
    "soils": ("stiffness_kpa_m_n",),
}
"""Keys and columns that tell a kind, the first that fits; telemetry is a motion with what wheels did."""
MAGIC_BYTES = {
    b"\x89PNG": "picture",
    b"\xff\xd8\xff": "picture",
    b"PK\x03\x04": "terrain",
    b"\x89HDF": "cube",
    b"CDF": "cube",
    b"EHFA_HEADER_TAG": "terrain",
    b"DSAA": "terrain",
    b"DSBB": "terrain",
    b"DSRB": "terrain",
}
WAVELENGTH_NAME = re.compile(
    r"wave|wellenl|longueur|longitud|lunghezza|^wl|lambda|λ|(^|[^a-z])(nm|um|µm|μm|micron\w*)([^a-z]|$)|cm-1|channel",
    re.IGNORECASE,
)
"""Names of a first column that make a table one of spectra."""
WAVELENGTH_RANGES, FEWEST_ROWS, ROWS_READ = ((0.2, 5.0), (200.0, 5000.0)), 8, 200
"""Where a first column of another name may lie, in µm and nm; rows that it needs at least, and that are looked at;
assumed."""
STARTS_WITH_NUMBER = re.compile(r"\s*[+-]?[0-9]+([.,][0-9]*)?([eE][+-]?[0-9]+)?\s*[;,\t ]")
LONG_TELEMETRY_BYTES = 1 << 26
"""Bytes from which on telemetry is read in pieces."""
NAMED = 5
"""Files of a folder that are named."""
Description: TypeAlias = tuple[str, str, Mapping[str, Any], str]
"""Kind, SHA-256, contents and trouble."""
SUFFIXES = {
    ".tif": "terrain", ".tiff": "terrain", ".asc": "terrain", ".2b": "vnis", ".2bl": "vnis", ".img": "cube",
    ".geojson": "zones", ".flt": "terrain", ".bil": "terrain", ".vrt": "terrain",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FileInfo(Result):
    """What a file is.

    Attributes
    ----------
    file, sha256 : which.
    kind : one of `KINDS`; of a folder without a result `folder`, whose `contents` are its files by kind.
    contents : what its reader finds in it, by words.
    trouble : why its reader refuses it; '' if it does not.
    remarks : what its reader warns of.
    further : commands that take it beside those of its kind.
    stored : the document of a stored result, which `--field` reads; None of other files.
    """

    schema: ClassVar[str] = "info/1"
    file: str
    sha256: str
    kind: str
    contents: Mapping[str, Any]
    trouble: str = ""
    remarks: Sequence[str] = ()
    further: Sequence[str] = ()
    stored: Mapping[str, Any] | None = field(default=None, repr=False)

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(inputs={self.file: self.sha256} if self.sha256 else {})

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(self.trouble, verdict="not to be used as it is")

    @property
    def title(self) -> str:
        return KINDS[self.kind].title

    @property
    def commands(self) -> list[str]:
        """Those that take it; none of a file that its reader refuses."""
        if self.trouble:
            return []
        of_kind = WHEEL if self.contents.get("parts") == WHEEL_ALONE else KINDS[self.kind].commands
        of_kind = LABELLED if self.kind == "picture" and "camera" in self.contents else of_kind
        of_kind = of_kind if self.contents.get("shares_of", True) else ()
        return [f"lunarsci {one}" for one in (*self.further, *of_kind)]

    def to_dict(self) -> dict[str, Any]:
        return {
            "file": self.file,
            "kind": self.kind,
            "title": self.title,
            "contents": dict(self.contents),
            "commands": self.commands,
            "trouble": self.trouble or None,
            "remarks": list(self.remarks),
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a word of what is in it."""
        return [{"what": name, "value": value} for name, value in self.contents.items()]


def info(path: str | Path) -> FileInfo:
    """What a file, or the folder of a result, is. Raises DataError for one that is not there, is empty, or is no file.

    A file that its reader refuses has `trouble`.
    """
    name = str(path)
    folder = Path(path)
    if not folder.exists() and (kind := next((one for one, names in named_here().items() if name in names), "")):
        file = InputFile(name, named_here()[kind][name].encode())
        return FileInfo(file=name, sha256=file.sha256, kind=kind, contents=CONTENTS[kind](file))
    if name == "-":
        piped = read_input(name)
        of_file = info(file := on_disk("stdin", piped.data))
        *remarks, trouble = (
            as_named(one).replace(Path(file).name, piped.name) for one in (*of_file.remarks, of_file.trouble)
        )
        contents = named_within(of_file.contents)
        return replace(of_file, file=piped.name, contents=contents, remarks=remarks, trouble=trouble)
    if folder.is_dir():
        if not (folder / "result.json").is_file():
            return _folder(name)
        name = str(folder / "result.json")
    stored = None
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", LunarSciWarning)
        if not (described := _long_telemetry(name)):
            file = read_input(name)
            described = _read(file)
            stored = read_json(file, "a result", dict) if described[0] == "result" else None
    kind, sha256, contents, trouble = described
    remarks = [str(one.message) for one in heard if issubclass(one.category, LunarSciWarning)]
    remarks = [text for text in remarks if not text.endswith(f"read as: {contents.get('read as')}")]
    further = TAKEN_BY.get(str(contents.get("command", "")).removeprefix("lunarsci "), ()) if kind == "result" else ()
    return FileInfo(
        file=name, sha256=sha256, kind=kind, contents=contents, trouble=trouble, remarks=remarks, further=further,
        stored=stored,
    )  # fmt: skip


def named_here() -> dict[str, Mapping[str, str]]:
    """What comes with lunarsci and options take by name: kind, and name with its text as a file."""
    laws = {name: asdict(law) for name, law in default_prior().items()}
    return {
        "rover": {name: read_rover(name).text for name in (*rover_names(), *wheel_names())},
        "soil": {name: toml_text(table) for name, table in soil_tables().items()},
        "prior": {"priors": toml_text(laws)},
    }


def _folder(name: str) -> FileInfo:
    """What the files of a folder are, by kind. Raises NoFilesError for one that has none."""
    files: dict[str, list[str]] = {}
    for path in expand_inputs([name], all_files=True):
        try:
            kind = kind_of(read_input(path))
        except LunarSciError:
            kind = "unknown"
        kind = "unknown" if kind in ("spectra", "table") and no_data(path) else kind
        files.setdefault(kind, []).append(Path(path).name)
    contents = {kind: f"{len(names)}: {some_of(names, NAMED)}" for kind, names in sorted(files.items())}
    kinds = [kind for kind in files if kind in KINDS]
    further = KINDS[kinds[0]].commands if len(kinds) == 1 else ()
    return FileInfo(file=name, sha256="", kind="folder", contents=contents, further=further)


def _read(file: InputFile) -> Description:
    return kind_of(file), file.sha256, *_contents(kind_of(file), file)


def _long_telemetry(name: str) -> Description | None:
    """What there is in telemetry that is too long to be read whole; None for any other file."""
    if not Path(name).is_file() or Path(name).stat().st_size <= LONG_TELEMETRY_BYTES:
        return None
    with open_input(name) as stream:
        start = stream.file.read(1 << 16)
        stream.file.seek(0)
        if start.lstrip().startswith(b"{") or kind_of(InputFile(name, start)) != "telemetry":
            return None
        described = _contents("telemetry", stream)
        for _ in stream.pieces():
            pass
        return "telemetry", stream.sha256, *described


def _contents(kind: str, file: InputFile | InputStream) -> tuple[Mapping[str, Any], str]:
    read: Callable[[Any], Mapping[str, Any]] = CONTENTS.get(kind, lambda _: {})
    try:
        return read(file), ""
    except LunarSciError as error:
        return {}, str(error)


def kind_of(file: InputFile) -> str:
    """The kind of a file, one of `KINDS`. Raises DataError for content that is none of them."""
    suffix = Path(file.name).suffix.lower()
    if suffix in (".nc", ".tif") and _map_layers(file):
        return "map"
    if file.data.startswith(NETCDF) and holds_heights(Path(file.name)):
        return "terrain"
    if magic := next((kind for start, kind in MAGIC_BYTES.items() if file.data.startswith(start)), None):
        return (suffix == ".npz" and kind_of_cameras(file)) or magic
    if file.data.startswith(b"SIMPLE  ="):
        return "spectra"
    if kind := kind_of_product(file):
        return kind
    if suffix == ".img" and (is_image_of_heights(file.name) or is_envi_of_heights(file.name)):
        return "terrain"
    if suffix in SUFFIXES and not (suffix == ".asc" and not file.data[:5].lower().startswith(b"ncols")):
        return SUFFIXES[suffix]
    if suffix == ".hdr":
        return "cube" if not Path(file.name).with_suffix(".sli").is_file() else "spectra"
    if suffix == ".parquet":
        kind = _kind_of_table(file.name, beginning(as_csv(file)), suffix)
        return kind if kind in CSV_COLUMNS else "telemetry"
    if suffix in (".sli", ".xlsx"):
        return "spectra"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        text = beginning(file)
    if suffix == ".toml":
        return _kind_of_toml(file)
    of_json = text.lstrip().startswith(("{", "[{"))
    if not (of_json and b'"lunarsci/' in file.data) and (kind := kind_of_rover_file(file, text)):
        return kind
    if of_json:
        return _kind_of_json(file)
    if is_pds_label(file):
        return "cube" if read_pds_label(file).images else "spectra"
    if (format := recognised(file, text.lstrip())) and FORMATS[format].spectra_alone:
        return "spectra"
    return _kind_of_table(file.name, text, suffix)


def _kind_of_json(file: InputFile) -> str:
    document = read_json(file, "a file of lunarsci", lambda value: value[0] if isinstance(value, list) else value)
    schema = str(document.get("schema", ""))
    for kind, start in (
        ("belief", "lunarsci/soil-belief/"),
        ("soil map", "lunarsci/soil-map/"),
        ("result", "lunarsci/"),
    ):
        if schema.startswith(start):
            return kind
    if document.get("type") in ("FeatureCollection", "Feature", "Polygon", "LineString"):
        return "zones"
    if any(map(is_wavelength, document)):
        return "spectra"
    raise DataError(f"{file.name}: JSON without a schema of lunarsci; its kind is unknown")


def _kind_of_toml(file: InputFile) -> str:
    try:
        document = toml_document(file.data.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataError(f"{file.name}: not a readable TOML file: {error}") from error
    if any(isinstance(table, dict) and "median" in table for table in document.values()):
        return "prior"
    return next((kind for kind, keys in TOML_KEYS.items() if all(key in document for key in keys)), "config")


def _kind_of_table(name: str, text: str, suffix: str) -> str:
    if suffix == ".fit":
        return "mgm"
    whole = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    lines = _from_names(whole)
    columns = _cells(name, lines[:1])
    from lunarsci.twin.telemetry.log_names import named_otherwise

    columns += named_otherwise(columns)
    columns += states_named_otherwise(columns) or states_named_otherwise(_cells(name, whole[:1]))
    if {"time_s", "yaw_deg"} <= {*columns} and any(
        name.startswith(("angle_", "rate_", "steered_")) for name in columns
    ):
        return "telemetry"
    if kind := next((kind for kind, keys in CSV_COLUMNS.items() if all(key in columns for key in keys)), None):
        return kind.strip()
    if "%ECSV" in text[:20]:
        return "library" if "mineral" in text and "end_member" in text else "spectra"
    if any(name.endswith(("_m", "_s", "_deg", "_n")) for name in columns):
        return "table"
    if header_channels(columns) or (lines and header_channels(lines[0].split(";"))):
        return "spectra"
    if columns[0][:1].isdigit() and any(any(map(str.isalpha, cell)) and ":" in cell for cell in lines[0].split()):
        return "table"
    named = any(is_wavelength(column) for column in columns[1:])
    return "spectra" if named or len(columns) < 2 or _is_wavelength(columns[0], name, lines) else "table"


def _from_names(lines: list[str]) -> list[str]:
    """A table from the line above its first numbers on, which has their names; lines of text may be before it."""
    numeric = [STARTS_WITH_NUMBER.match(line) is not None for line in lines]
    begin = next((k for k in range(len(lines) - 2) if all(numeric[k : k + 3])), 0)
    return lines[max(begin - 1, 0) :]


def _cells(name: str, lines: Sequence[str], separator: str = "") -> list[str]:
    separator = separator or (separator_of(lines[0]) if lines else ",")
    return [cell.strip() for cell in next(csv_rows(name, lines, delimiter=separator), [])]


def _is_wavelength(column: str, name: str, lines: Sequence[str]) -> bool:
    """Whether the first column of a table is named as a wavelength or a number, or runs one way as one does."""
    try:
        float(column)
        return True
    except ValueError:
        if WAVELENGTH_NAME.search(column):
            return True
    try:
        separator = separator_of(lines[0])
        values = [float(_cells(name, [line], separator)[0].replace(",", ".")) for line in lines[1:ROWS_READ]]
    except (ValueError, IndexError):
        return False
    steps = {one < other for one, other in pairwise(values) if one != other}
    within = any(low <= min(values) and max(values) <= high for low, high in WAVELENGTH_RANGES) if values else False
    return within and len(values) >= FEWEST_ROWS and len(steps) == 1 and len({*values}) == len(values)


def kind_of_rover_file(file: InputFile, start: str) -> str:
    """`camera`, `rig` or `terrain`; '' of any other file. `start` are its first lines. Raises DataError."""
    if CAMERA_LABEL.search(start):
        return "camera"
    if is_map_of_heights(start) or is_table_of_heights(file, start):
        return "terrain"
    return kind_of_cameras(file)


def kind_of_cameras(file: InputFile) -> str:
    """`camera` or `rig`; '' of any other file. Raises DataError."""
    from lunarsci.images.rig_files import is_rig, tree_of

    return "" if tree_of(file) is None else "rig" if is_rig(file) else "camera"


def kind_of_product(file: InputFile) -> str:
    """`picture` for one with a label of its camera, in it or beside it; `camera` for such a label alone; else ''."""
    from lunarsci.images.cahv import LABEL_BYTES, label_of

    label = label_of(file)
    start = "" if label is None else label.data[:LABEL_BYTES].decode("latin-1")
    if not CAMERA_LABEL.search(start) or "VNIS" in Path(file.name).name.upper():
        return "picture" if file.data.startswith(b"LBLSIZE") else ""
    path = Path(file.name)
    numbers = (path.with_suffix(end) for end in (".IMG", ".img", ".DAT", ".dat", path.suffix[:-1]))
    beside = any(each != path and each.is_file() for each in numbers)
    return "picture" if label is not file or b"\0" in file.data or beside else "camera"


def is_map_of_heights(label: str) -> bool:
    """Whether a PDS3 label is of a map of heights."""
    return bool(MAP_LABEL.search(label) and HEIGHT_WORDS.search(label))


def is_image_of_heights(name: str) -> bool:
    """Whether an image has a label of a map of heights, at its begin or beside it."""
    labels = [Path(name).with_suffix(end) for end in (".lbl", ".LBL")]
    label = next((each for each in labels if each.is_file()), Path(name))
    with label.open("rb") as stream:
        return is_map_of_heights(stream.read(BEGINNING).decode("latin-1"))


def is_envi_of_heights(name: str) -> bool:
    """Whether an image has a header of ENVI beside it with one band on a map."""
    header = Path(name).with_suffix(".hdr")
    content = header.read_text("latin-1") if header.is_file() else ""
    return bool(
        content.startswith("ENVI") and re.search(r"^bands\s*=\s*1\s*$", content, re.M) and "map info" in content
    )


def is_table_of_heights(file: InputFile, start: str) -> bool:
    """Whether a text is a grid of heights, or has a row for each node."""

    if start[:6].lower().startswith(("ncols", "nrows")) or Path(file.name).suffix.lower() == ".xyz":
        return True
    whole = start if len(start) < BEGINNING // 2 else start.rpartition("\n")[0]
    # Telemetry and positions have x, y and z beside others.
    return node_columns(file, whole, above=MAX_PERCENT) is not None


def states_named_otherwise(columns: Sequence[str]) -> list[str]:
    """Columns of wheel states that are there by other names, or in other units, where there are two or more."""

    renamed = [what.target for name in columns if (what := of_name(name)) and what.target not in columns]
    present = [one.column for one in QUANTITIES if one.column in columns]
    return renamed if len(renamed) + len(present) > 1 else []


def camera_contents(file: InputFile) -> Mapping[str, Any]:
    """What `images cameras` finds of one camera."""
    from lunarsci.images.jobs.cameras import cameras

    (camera,) = cameras([file]).to_dict()["cameras"]
    contents = {
        "size_px": f"{camera['width_px']} x {camera['height_px']}",
        "focal length_px": f"{camera['fx_px']:.6g}",
        "view_deg": f"{camera['view_across_deg']:.1f} x {camera['view_down_deg']:.1f}",
    }
    if "down_deg" in camera:
        contents |= {"looks": f"heading {camera['heading_deg']:.2f}, down {camera['down_deg']:.2f} deg"}
    return contents | {"read as": "; ".join(camera["remarks"]) or "as written"}


def _picture(file: InputFile) -> Mapping[str, Any]:
    """Size, bits and camera of a picture with a label; nothing of any other one."""
    from lunarsci.images.cahv import LABEL_BYTES, label_of
    from lunarsci.images.pictures import PLAIN, read_picture

    if file.data.startswith(PLAIN):
        return {}
    picture, label = read_picture(file), label_of(file) or file
    contents: dict[str, Any] = {"size_px": "{} x {}".format(*picture.size), "bits": picture.bits}
    start = label.data[:LABEL_BYTES].decode("latin-1")
    if not CAMERA_LABEL.search(start):
        return contents
    named = INSTRUMENT.search(start)
    return {**contents, "camera": "unnamed" if named is None else named[1] or named[2], **camera_contents(file)}


class NamesOfSome(str):
    """The first of some names; `whole` has all."""

    whole: str


def _listed(names: Any) -> NamesOfSome:
    every = [str(name) for name in names]
    text = NamesOfSome(some_of(every, NAMES_LISTED))
    text.whole = ", ".join(every)
    return text


def _spectra(file: InputFile) -> Mapping[str, Any]:

    rows = read_spectra(file)
    first = rows[0]
    return {
        "spectra": len(rows),
        "names": _listed(one.id for one in rows),
        "channels": len(first.wavelength_nm),
        "from_nm": float(first.wavelength_nm[0]),
        "to_nm": float(first.wavelength_nm[-1]),
        "errors": first.uncertainty is not None,
    }


def _cube(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.spectra.cubes.rasters import M3_NAME, open_cube, open_pds

    if not is_pds_label(file):
        m3 = M3_NAME.search(file.name)
        if m3 and m3[2].upper() in ("RDN", "L1B"):
            raise DataError(f"{file.name}: radiance of M3, no reflectance; the _RFL.IMG of Level 2 has that")
        if m3 and (holds := M3_IMAGES.get(m3[2].upper(), "")):
            return {"bytes": len(file.data), "holds": holds}
        try:
            cube = open_cube(file.name)
        except ParameterError:  # without the extra
            return {"bytes": len(file.data)}
        (lines, samples), nm = cube.shape, cube.wavelength_nm
        return {"lines": lines, "samples": samples, "bands": nm.size, "from_nm": float(nm[0]), "to_nm": float(nm[-1])}
    images = read_pds_label(file).images
    open_pds(file.name)
    return {one.file: f"{one.lines} lines, {one.samples} samples, {one.bands} bands"
            f"{f' in {one.unit}' if one.unit else ''}" for one in images}  # fmt: skip


def _map_layers(file: InputFile) -> list[str]:
    """Layers of a file that `spectra map` wrote, without their errors; none of another."""
    from lunarsci.spectra.cubes.output import FLAG_LAYER
    from lunarsci.spectra.origin.mineral_map import layers_of

    try:
        layers = layers_of(file.name) if Path(file.name).is_file() else []
    except (LunarSciError, ImportError):
        return []
    return [name for name in layers if name != FLAG_LAYER] if FLAG_LAYER in layers else []


def _map(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.spectra.origin.mineral_map import minerals_of

    return {"layers": len(_map_layers(file)), "shares_of": _listed(minerals_of(file.name))}


def _craters(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.spectra.origin.catalogue import read_catalogue

    craters = read_catalogue(file)
    return {"craters": len(craters), "names": _listed(crater.name for crater in craters)}


def _plan(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.twin.plans.plan import LIMITS_RULE, read_plan

    plan = read_plan(file)
    return {
        "name": plan.name,
        "legs": len(plan.legs),
        "length_m": plan.length_m,
        "speed_m_s": plan.speed_m_s,
        "limits": "its own" if plan.has_limits else f"those of the rover that drives it: {LIMITS_RULE}",
        "sweeps": _listed(sweep.name for sweep in plan.sweep) or "none",
        "made for": "any rover" if plan.made_for is None else plan.made_for.name,
    }


def _mission(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.twin.mission.mission import read_mission

    mission = read_mission(file)
    return {
        "name": mission.name,
        "targets": _listed(target.name for target in mission.targets),
        "keep-out circles": len(mission.keep_outs),
        "hours of communication": len(mission.windows),
    }


def _rover(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.twin.rover import build_rover

    description = read_rover(file.name)
    wheel = read_wheel(description)
    contents = {"name": description.name, "wheel radius_m": wheel.radius_m, "wheel width_m": wheel.width_m}
    left = left_to_defaults(description)
    keys = [*description.assumed, *left]
    contents |= {"assumed numbers": f"{len(keys)}: {_listed(keys)}" if keys else 0}
    if left:
        contents["not in the file, taken as"] = ", ".join(f"{key} {getattr(wheel, key):g}" for key in left)
    if "suspension" not in description.tables:
        return contents | {"parts": WHEEL_ALONE}
    rover = build_rover(description)
    contents |= {"mass_kg": rover.mass_kg, "wheels": _listed(rover.wheels), "max_speed_m_s": rover.max_speed_m_s}
    return contents | _as_in_template(description)


def _as_in_template(rover: RoverDescription) -> dict[str, str]:
    """Numbers that a template had and that nobody replaced, by their table; none where all are."""

    numbers = {f"{name}.{key}": value for name, table in rover.tables.items() for key, value in table.items()}
    numbers = {key: value for key, value in numbers.items() if _is_numeric(value)}
    asked = dict[str, list[str]]()
    for key, of in rover.left.items():
        table, _, name = key.partition(".")
        template = read_rover(of).tables.get(table, {}) if of in rover_names() else {}
        if key in numbers and numbers[key] == template.get(name):
            asked.setdefault(f"[{table}] still as in {of}", []).append(name)
    if sum(map(len, asked.values())) == len(numbers):
        return {}
    whole = {title: len(keys) == sum(key.startswith(f"{title[1:].partition(']')[0]}.") for key in numbers)
             for title, keys in asked.items()}  # fmt: skip
    return {
        title: f"{'all' if whole[title] and len(keys) > 1 else ', '.join(keys)}; check that they are this rover's"
        for title, keys in asked.items()
    }


def _is_numeric(value: Any) -> bool:
    parts = value if isinstance(value, list) else [value]
    return all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts)


def _soil(file: InputFile) -> Mapping[str, Any]:

    about = soil_tables().get(file.name, {})
    assumed = {"assumed": ", ".join(about["assumed"]), "source": about["source"]} if about else {}
    return asdict(read_soil(file.name)) | assumed


def _prior(file: InputFile) -> Mapping[str, Any]:

    laws, given = read_prior(file, contact=True), toml_document(text(file))
    return {name: f"{laws[name].median:g} {UNITS[name]}, {laws[name].of} ± {laws[name].sd:g}" for name in given}


def _pose(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.images.rig_files import read_pose

    pose = read_pose(file)
    return {"position_m": _listed(f"{value:g}" for value in pose.center_m), "heading_deg": pose.angles_deg()[0]}


def _rig(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.images.rig_files import read_rig

    rig = read_rig(file)
    read_as = {"read as": "; ".join(rig.read_as)} if rig.read_as else {}
    return {"name": rig.name, "baseline_m": float(rig.baseline_m)} | read_as


def _terrain(file: InputFile) -> Mapping[str, Any]:

    from lunarsci.twin.ground.terrain import SOIL_COLUMNS

    soil = (*SOIL_COLUMNS, *(f"{one}_left_of_prior" for one in SOIL_COLUMNS))
    grid = read_grid(file.name, (), (*soil, *ERROR_LAYERS))
    heights = grid.height_m[np.isfinite(grid.height_m)]
    ny, nx = grid.height_m.shape
    return {
        "name": grid.name,
        "nodes": f"{nx} x {ny}",
        "spacing_m": grid.spacing_m,
        "x_m": f"{grid.x0_m:g} to {grid.x0_m + (nx - 1) * grid.spacing_m:g}",
        "y_m": f"{grid.y0_m:g} to {grid.y0_m + (ny - 1) * grid.spacing_m:g}",
        "height_m": f"{heights.min():.3f} to {heights.max():.3f}",
        "holes": f"{1 - heights.size / grid.height_m.size:.1%}",
        "coordinate system": "local" if not grid.crs else "projected",
        "read as": "; ".join(grid.read_as) or "as written",
    }


def _belief(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.regolith.belief import read_belief

    belief = read_belief(file)
    medians = {name: f"{ends[0]:.4g}" for name, ends in belief.intervals().items()}
    return {"drives": len(belief.history)} | {f"median {name}": value for name, value in medians.items()}


def _soil_map(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.twin.ground.soil_map import read_soil_map

    soil = read_soil_map(file)
    return {"zones": len(soil.zones), "correlation_m": soil.correlation_m}


def _rows(file: InputFile) -> Mapping[str, Any]:

    table = read_csv_table(file)
    contents: dict[str, Any] = {"rows": len(table), "columns": _listed(table.columns)}
    if "wheel" in table:
        contents["wheels"] = _listed(dict.fromkeys(table["wheel"]))
    return contents


def _other_table(file: InputFile) -> Mapping[str, Any]:
    """What `_rows` says; a remark where two columns or more tell what it could be meant for."""
    columns = [str(name) for name in read_csv_table(file).columns]
    for words, meant in LOOKS_LIKE.items():
        if len(alike := [name for name in columns if re.search(words, name, re.IGNORECASE)]) > 1:
            warnings.warn(f"columns {', '.join(alike[:4])}: {meant}", LunarSciWarning, stacklevel=2)
            break
    return _rows(file)


def _states(file: InputFile) -> Mapping[str, Any]:

    table = read_state_table(file, largest := read_wheel(LARGEST_WHEEL), any_wheel=True)
    read_as = {"read as": "; ".join(table.named.read_as)} if table.named.read_as else {}
    return read_as | {
        **_rows(file),
        "columns of no use": _listed(table.unused) or "none",
        "range checked for": f"wheels of up to {largest.radius_m:g} m",
    }


def _telemetry(file: InputFile | InputStream) -> Mapping[str, Any]:
    from lunarsci.twin.rover import build_rover
    from lunarsci.twin.telemetry.log_names import named_otherwise
    from lunarsci.twin.telemetry.reading import Findings, read_telemetry

    names = file.data if isinstance(file, InputFile) else _ends(file)
    columns = names.partition(b"\n")[0].decode("utf-8", "replace").split(",")
    six = b"_ML_" in names or any("_ML_" in name for name in named_otherwise(columns))
    rover = replace(build_rover("yutu2" if six else "small-four"), steered=())
    telemetry = read_telemetry(file, rover, Findings(file.name))
    time = telemetry.time_s
    return {
        "rows": telemetry.rows,
        "from_s": float(time.min()),
        "to_s": float(time.max()),
        "wheels": _listed(rover.wheels),
        "synthetic": telemetry.synthetic,
    }


def _ends(stream: InputStream, size: int = 1 << 16) -> bytes:
    """Begin and end of a file, where formats have the names of their columns."""
    start = stream.file.read(size)
    stream.file.seek(max(0, stream.file.seek(0, 2) - size))
    end = stream.file.read()
    stream.file.seek(0)
    return start + end


def _result(file: InputFile) -> Mapping[str, Any]:
    document = read_json(file, "a result", lambda value: value)
    record = document.get("provenance") or {}
    return {
        "schema": str(document["schema"]).removeprefix("lunarsci/"),
        "command": record.get("command"),
        "version": record.get("version"),
        "time_utc": record.get("time_utc"),
        "keys": _listed(document.get("result") or ()),
        "inputs": _listed(one.get("path") for one in record.get("inputs") or ()) or "none",
    }


CONTENTS: Mapping[str, Callable[[InputFile], Mapping[str, Any]]] = {
    "spectra": _spectra, "library": _spectra, "vnis": _spectra, "cube": _cube, "craters": _craters, "plan": _plan,
    "mission": _mission, "rover": _rover, "soil": _soil, "pose": _pose, "camera": camera_contents, "rig": _rig,
    "map": _map, "terrain": _terrain, "picture": _picture,
    "belief": _belief, "soil map": _soil_map, "telemetry": _telemetry, "states": _states, "slips": _states,
    "prior": _prior, "motion": _rows, "positions": _rows, "track": _rows, "soils": _rows, "table": _other_table,
    "result": _result,
}  # fmt: skip
"""What a reader says of a file, by its kind."""
