"""Results as their files say them: the JSON documents of commands, the folders they fill, and pictures beside them."""

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile, read_input, read_json, text
from lunarsci.io.tables import as_csv, table_in
from lunarsci.provenance import sha256
from lunarsci.result import Doubt, Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = {".png": b"\x89PNG", ".svg": b"<"}
"""Suffixes of pictures that a page takes, and how they begin."""
LARGEST_PICTURE = 4_000_000
"""Bytes of a picture that a page takes; assumed, so that a page stays one that can be sent by mail."""
MOST_PAGES = 6
"""Pages of a plot that a page of results shows; assumed."""
MOST_ROWS = 200_000
"""Rows that are read of a table beside a result; assumed."""
NO_RESULTS = {
    "lunarsci/twin-prediction": "give the folder that it lies in",
}
"""Documents that commands read and that are no results, and what to give instead."""
DESCRIPTIONS = (".toml", ".csv", ".npz", ".ecsv")
"""Files that commands are given, not results."""
BELIEF = "lunarsci/soil-belief"
"""Schema, without its version, of a belief of the soil: the page shows what `twin history` tells of it."""
SOIL_MAP = "lunarsci/soil-map"
"""The same of a map of beliefs, as `twin update --save-map` writes it."""
REMEDY = "give a file that a command wrote with --json, the folder of its -o, or a picture of its --plot"


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """One result of a command.

    Attributes
    ----------
    name : of the file or folder, as it was given.
    schema : without what all share, such as `twin-predict/1`.
    result, provenance : of the document, in plain Python.
    folder : where the tables lie that were written with it; None where there are none.
    pictures : pictures that belong to it, by file name.
    cut : whether its plot has more pages than the `pictures`.
    sha256 : of the document.
    """

    name: str
    schema: str
    result: Mapping[str, Any]
    provenance: Mapping[str, Any]
    folder: Path | None = None
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    cut: bool = False
    sha256: str = ""

    @property
    def kind(self) -> str:
        """The schema without its version, such as `twin-predict`."""
        return self.schema.rpartition("/")[0]

    def table(self, name: str) -> list[dict[str, str]]:
        """Rows of a table beside the result, as text; none where it is not there."""
        path = table_in(self.folder, name) if self.folder is not None else None
        if path is None:
            return []
        rows = csv.DictReader(line for line in io.StringIO(text(as_csv(read_input(path)))) if line[:1] != "#")
        try:
            return [row for row, _ in zip(rows, range(MOST_ROWS), strict=False)]
        except csv.Error as error:
            raise DataError(f"{path}: no CSV table: {error}; is it complete?") from error


@dataclass(frozen=True, slots=True, eq=False)
class GivenPicture:
    """A picture that was given beside the results.

    Attributes
    ----------
    name : of its file.
    content : of its file.
    """

    name: str
    content: bytes


def read_results(
    given: Sequence[str | Path | Result], *, drawn: bool = False
) -> tuple[list[Document], list[GivenPicture]]:
    """Documents and pictures in the order given; a result of a function is what its file would be.

    `drawn`: the picture of its --plot, at most `MOST_PAGES` pages of it, belongs to a result of a function, and to that
    of `spectra map` where the map still lies where it was written, or beside the result.

    Raises DataError for what is none of them, ParameterError where no document is given.
    """
    if strange := [one for one in given if not isinstance(one, str | Path | Result)]:
        raise DataError(f"{strange[0]!r:.60} is no result; {REMEDY}")
    paths = [one for one in given if not isinstance(one, Result)]
    pictures = [_picture(Path(path)) for path in paths if Path(path).suffix.lower() in PICTURES]
    documents = [
        _in_memory(one, number, drawn) if isinstance(one, Result) else _read(one, drawn)
        for number, one in enumerate(given, 1)
        if isinstance(one, Result) or Path(one).suffix.lower() not in PICTURES
    ]
    if not documents:
        raise ParameterError(f"no result is given; {REMEDY}")
    return documents, pictures


def _in_memory(result: Result, number: int, drawn: bool) -> Document:
    """A result of a function, named by its kind and its place among those given."""
    text = result.to_json()
    made = json.loads(text)
    schema = made["schema"].removeprefix("lunarsci/")
    kind = schema.rpartition("/")[0]
    pictures, cut = _picture_of(result, f"{kind}.png") if drawn else ({}, False)
    return Document(
        f"{kind} ({number})", schema, made["result"], made["provenance"], None, pictures, cut, sha256(text.encode())
    )


def _picture_of(result: Result, name: str) -> tuple[dict[str, bytes], bool]:
    """What --plot draws of a result, none where it has nothing to draw; and whether there are more pages."""
    try:
        return _first_pages(result.figures(), name)
    except ParameterError:
        return {}, False


def _first_pages(figures: "Iterator[Figure]", name: str) -> tuple[dict[str, bytes], bool]:
    """The first of some figures by names, and whether there are more.

    None that is, with those before it, more than a page takes. Raises ParameterError.
    """
    from lunarsci.figure import picture_bytes, styled

    contents: list[bytes] = []
    more, start, suffix = False, Path(name).stem, Path(name).suffix
    with styled():
        for figure in figures:
            content = picture_bytes([figure], Path(name))
            more = len(contents) == MOST_PAGES or sum(map(len, contents)) + len(content) > LARGEST_PICTURE
            if more:
                break
            contents.append(content)
    names = [name, *(f"{start}-{number}{suffix}" for number in range(2, len(contents) + 1))]
    return dict(zip(names, contents, strict=False)), more


def _map_picture(result: Mapping[str, Any], record: Mapping[str, Any], folder: Path) -> tuple[dict[str, bytes], bool]:
    """What --plot draws of a map, from its file, and whether there are more pages.

    None where the file is gone, or is not the one that was written.
    """
    from lunarsci.spectra.cubes.figure import is_map_of, map_pages

    try:
        named = Path(result["map"]["file"])
        for file in dict.fromkeys((named, folder / named.name)):
            if file.is_file() and is_map_of(file, result, record):
                return _first_pages(map_pages(file, result), f"{file.stem}.png")
    except (DataError, ParameterError, LookupError, TypeError, ValueError, AttributeError):
        return {}, False
    return {}, False


def _read(path: str | Path, drawn: bool) -> Document:
    folder = Path(path)
    if not folder.is_dir():
        return _document(str(path), path, None, drawn)
    if not (folder / "result.json").is_file():
        raise DataError(f"{folder}: a folder without result.json; {REMEDY}")
    return _document(str(path), folder / "result.json", folder, drawn)


def _document(name: str, path: str | Path, folder: Path | None, drawn: bool) -> Document:
    if Path(path).suffix.lower() in DESCRIPTIONS:
        raise DataError(f"{path}: an input or a table, no result; {REMEDY}")
    file = read_input(path)
    if file.data.lstrip()[:1] not in (b"{", b"["):
        raise DataError(f"{path}: text, no JSON result; run its command again with --json -o {Path(path).stem}.json")
    made = read_json(file, "a result", lambda value: value)
    if isinstance(made, dict) and str(made.get("schema", "")).startswith(f"{BELIEF}/"):
        return _belief(name, file)
    if isinstance(made, dict) and str(made.get("schema", "")).startswith(f"{SOIL_MAP}/"):
        return _soil_map(name, file)
    if not isinstance(made, dict) or not isinstance(made.get("result"), dict):
        raise DataError(f"{file.name}: no result of a lunarsci command{_instead(made)}; {_remedy(made)}")
    schema, record = made.get("schema"), made.get("provenance")
    if not isinstance(schema, str) or not schema.startswith("lunarsci/") or not isinstance(record, dict):
        raise DataError(f"{file.name}: its key `schema` does not name a lunarsci result; {REMEDY}")
    pictures, cut = {} if folder is None else _pictures_in(folder), False
    if drawn and schema.startswith("lunarsci/spectra-map/"):
        pages, cut = _map_picture(made["result"], record, Path(path).parent)
        pictures |= pages
    return Document(name, schema.removeprefix("lunarsci/"), made["result"], record, folder, pictures, cut, file.sha256)


def _belief(name: str, file: InputFile) -> Document:
    """What a belief says of the soil, as `twin history` tells it, with its picture. Raises DataError."""
    from lunarsci.figure import picture_bytes, styled
    from lunarsci.twin.jobs.history import history

    past = history(file)
    with styled():
        drawn = picture_bytes([past.plot()], Path("soil.svg"))
    record = {
        "command": "lunarsci twin history",
        "inputs": [{"path": file.name, "sha256": file.sha256}],
        "sources": list(past.made_from.sources),
        "untrusted": past.untrusted,
        "failures": [],
    }
    pictures = {"the soil before any drive and now.svg": drawn}
    return Document(name, past.schema, past.to_dict(), record, None, pictures, sha256=file.sha256)


def _soil_map(name: str, file: InputFile) -> Document:
    """What a soil map says of its zones, with the pictures of `twin update`. Raises DataError."""
    from lunarsci.figure import picture_bytes, styled
    from lunarsci.twin.figures.maps import soil_pages
    from lunarsci.twin.ground.soil_map import ground_about, map_record, read_soil_map, soil_layers

    soil_map = read_soil_map(file)
    summary, names = map_record(soil_map), ("median of the soil.svg", "what is left of the first spread.svg")
    pictures = dict[str, bytes]()
    if soil_map.zones:
        with styled():
            layers = soil_layers(soil_map, ground_about(soil_map, file.name))
            drawn = soil_pages(layers, soil_map)
            pictures = {one: picture_bytes([page], Path("soil.svg")) for one, page in zip(names, drawn, strict=True)}
    doubts = dict.fromkeys(f"{one['name']}: {one['doubt']}" for one in summary["zones"] if one["doubt"])
    record = {
        "command": "lunarsci twin update --save-map",
        "inputs": [{"path": file.name, "sha256": file.sha256}],
        "untrusted": str(Doubt.of(*doubts)),
        "failures": [],
    }
    pictures = {one: content for one, content in pictures.items() if len(content) <= LARGEST_PICTURE}
    return Document(name, "soil-map/1", summary, record, None, pictures, sha256=file.sha256)


def _remedy(document: Any) -> str:
    """What to give instead of a document that is no result."""
    schema = str(document.get("schema", "")) if isinstance(document, dict) else ""
    return NO_RESULTS.get(schema.rpartition("/")[0], REMEDY)


def _instead(document: Any) -> str:
    """What a document is that is no result, where it says so."""
    schema = document.get("schema") if isinstance(document, dict) else None
    return f" but {str(schema)[:60]}" if isinstance(schema, str) else ""


def _pictures_in(folder: Path) -> dict[str, bytes]:
    """Pictures of a result's folder, the small ones; `left.png` and `right.png` of a stereo pair are shown, too."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
    return {path.name: path.read_bytes() for path in files if path.stat().st_size <= LARGEST_PICTURE}


def _picture(path: Path) -> GivenPicture:
    file = read_input(path)
    if not file.data.lstrip().startswith(PICTURES[path.suffix.lower()]):
        raise DataError(f"{path}: no {path.suffix[1:].upper()} picture; {REMEDY}")
    if len(file.data) > LARGEST_PICTURE:
        raise DataError(f"{path}: {len(file.data) / 1e6:.1f} MB; a page takes pictures of up to 4 MB")
    return GivenPicture(path.name, file.data)


def document_of(schema: str, result: Mapping[str, Any], provenance: Mapping[str, Any], **more: Any) -> Document:
    """A result that is not in a file; `more` are other attributes of the document."""
    return Document("this run", schema, result, provenance, **{"sha256": sha256(schema.encode()), **more})
