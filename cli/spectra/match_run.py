"""From the options of `lunarsci spectra match` to rocks, site and candidate craters."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import typer

from lunarsci.errors import DataError, LunarSciError, ParameterError
from lunarsci.inputs import expand_inputs, read_input
from lunarsci.spectra.origin.catalogue import TABLE, Crater, Point, checked_point, embedded_catalogue, read_catalogue
from lunarsci.spectra.origin.composition import MINERALS, Composition, Rock, Value, joined, read_rocks
from lunarsci.spectra.origin.mineral_map import MapReport, with_maps
from lunarsci.spectra.origin.prior import Range
from lunarsci.tables import table_hashes

from ..shared.report import together

__all__ = ["Candidates", "MatchInputs", "candidates", "rocks_from", "span", "stated_site"]

SHORT = {"ol": "olivine", "opx": "orthopyroxene", "cpx": "clinopyroxene", "plg": "plagioclase"}
BAND_NAMES = {"bc1000": "bc1000_nm", "bc2000": "bc2000_nm", "bc1000_nm": "bc1000_nm", "bc2000_nm": "bc2000_nm"}


@dataclass(frozen=True, slots=True)
class MatchInputs:
    """The rocks, the inputs' hashes, and what could not be read."""

    rocks: list[Rock]
    inputs: dict[str, str] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Candidates:
    """The craters, the hashes of what they were read from, and what maps gave."""

    craters: Sequence[Crater]
    source: str
    inputs: dict[str, str] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)
    map_reports: Sequence[MapReport] = ()


def stated_site(text: str) -> Point:
    """`LAT,LON` in degrees."""
    parts = text.split(",")
    if len(parts) != 2:
        raise typer.BadParameter(f"--site {text}: give latitude and longitude, such as -45.44,177.56")
    numbers = [_number(part, f"--site {text}") for part in parts]
    try:
        return checked_point(*numbers)
    except ParameterError as error:
        raise typer.BadParameter(f"--site {text}: {error}") from error


def span(text: str, option: str) -> Range:
    """`LOW:HIGH`, or one number for both."""
    numbers = [_number(part, f"{option} {text}") for part in text.split(":")]
    if len(numbers) > 2:
        raise typer.BadParameter(f"{option} {text}: give LOW:HIGH")
    try:
        return Range(numbers[0], numbers[-1])
    except ParameterError as error:
        raise typer.BadParameter(f"{option} {text}: {error}") from error


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise typer.BadParameter(f"{where}: '{text.strip()}' is not a number") from None
    if value != value or abs(value) == float("inf"):
        raise typer.BadParameter(f"{where}: '{text.strip()}' is not a finite number")
    return value


def rocks_from(files: Sequence[str], modes: str | None, bands: str | None, name: str) -> MatchInputs:
    """The rocks of files, or the one that the options state. Raises DataError when no file can be read."""
    stated = modes is not None or bands is not None
    if stated == bool(files):
        raise typer.BadParameter("give results of `spectra fit --json`, or --modes or --bands for one rock, not both")
    if stated:
        composition = Composition(
            _pairs(modes, "--modes", SHORT | {mineral: mineral for mineral in MINERALS}),
            _pairs(bands, "--bands", BAND_NAMES),
        )
        return MatchInputs([Rock(name, composition)])
    return _read(files)


def _read(files: Sequence[str]) -> MatchInputs:
    rocks: list[Rock] = []
    hashes: dict[str, str] = {}
    failures: list[str] = []
    for file in files:
        try:
            for name in expand_inputs([file]):
                source = read_input(name)
                rocks += read_rocks(source)
                hashes[source.name] = source.sha256
        except LunarSciError as error:
            failures.append(str(error) if file in str(error) else f"{file}: {error}")
    if not rocks:
        raise DataError(together(failures))
    return MatchInputs(joined(rocks), hashes, failures)


def _pairs(text: str | None, option: str, names: dict[str, str]) -> dict[str, Value]:
    """`NAME=VALUE:ERROR,…` by full name."""
    found: dict[str, Value] = {}
    for part in text.split(",") if text else []:
        key, equals, numbers = part.partition("=")
        value, colon, sigma = numbers.partition(":")
        name = names.get(key.strip().lower())
        if not (equals and colon):
            raise typer.BadParameter(f"{option} '{part}': give NAME=VALUE:ERROR, such as {next(iter(names))}=…:…")
        if name is None:
            raise typer.BadParameter(f"{option} '{part}': '{key.strip()}' is unknown; there are {', '.join(names)}")
        if name in found:
            raise typer.BadParameter(f"{option}: {name} is there twice; give it once")
        found[name] = (_number(value, f"{option} {key}"), _number(sigma, f"{option} {key}"))
    return found


def candidates(file: str | None, maps: Sequence[str], annulus: str) -> Candidates:
    """The embedded craters or those of a file, with modes from maps where these are given."""
    if file is None:
        found = Candidates(embedded_catalogue(), f"embedded {TABLE}", tables=table_hashes(TABLE))
    else:
        source = read_input(file)
        found = Candidates(read_catalogue(source), source.name, {source.name: source.sha256})
    return _mapped(found, maps, annulus) if maps else found


def _mapped(found: Candidates, maps: Sequence[str], annulus: str) -> Candidates:
    names: dict[str, str] = {}
    for item in maps:
        key, equals, file = item.partition("=")
        mineral = SHORT.get(key.strip().lower(), key.strip().lower())
        if not equals or not file or mineral in names:
            raise typer.BadParameter(f"--map '{item}': give MINERAL=FILE.tif, each mineral once")
        names[mineral] = file
    ring = span_from_zero(annulus)
    craters, reports = with_maps(found.craters, names, ring)
    hashes = {file: _digest(file) for file in names.values()}
    return Candidates(craters, found.source, found.inputs | hashes, found.tables, reports)


def _digest(file: str) -> str:
    """SHA-256 of a map, which may not fit into memory."""
    with Path(file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def span_from_zero(text: str) -> tuple[float, float]:
    """`IN:OUT` of the ring, which may begin at 0."""
    numbers = [_number(part, f"--annulus {text}") for part in text.split(":")]
    if len(numbers) != 2:
        raise typer.BadParameter(f"--annulus {text}: give IN:OUT in rim radii, such as 1:2")
    return numbers[0], numbers[1]
