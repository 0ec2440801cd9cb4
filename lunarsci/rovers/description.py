"""Read rover description files: TOML tables whose values carry their source."""

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from lunarsci.errors import DataError

__all__ = ["RoverDescription", "known_rovers", "known_wheels", "read_rover"]

WHEELS = "wheels.toml"


@dataclass(frozen=True, slots=True)
class RoverDescription:
    """One rover file, parsed and not yet interpreted.

    `tables` maps table name to key to plain value; `assumed` lists the dotted keys that are guesses; `text` is the
    file as read, kept for provenance.
    """

    name: str
    tables: dict[str, dict[str, Any]]
    assumed: tuple[str, ...]
    origin: str
    text: str

    def table(self, name: str) -> dict[str, Any]:
        """Return one table. Raises DataError when the file lacks it."""
        if name not in self.tables:
            raise DataError(f"{self.origin}: no [{name}] table; add one as in the yutu2 file")
        return self.tables[name]


def known_rovers() -> tuple[str, ...]:
    """Names of the rovers that come with lunarsci."""
    tables = (path.name for path in files(__package__).iterdir() if path.name.endswith(".toml"))
    return tuple(sorted(name.removesuffix(".toml") for name in tables if name != WHEELS))


def known_wheels() -> tuple[str, ...]:
    """Names of the wheels that come with lunarsci without a rover."""
    return tuple(tomllib.loads(_own(WHEELS)))


def read_rover(rover: str) -> RoverDescription:
    """Read a rover by name (`yutu2`) or from a TOML file. Raises DataError for anything else.

    The name of a wheel gives a description that has a wheel and nothing else.
    """
    if rover in known_rovers():
        return _parse(_own(f"{rover}.toml"), origin=rover)
    if rover in known_wheels():
        text = _own(WHEELS)
        return _described({"wheel": tomllib.loads(text)[rover]}, rover, text)
    try:
        text = Path(rover).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        known = f"{', '.join(known_rovers())}; wheels: {', '.join(known_wheels())}"
        raise DataError(f"{rover}: not a rover lunarsci knows ({known}) nor a readable TOML file") from error
    return _parse(text, origin=rover)


def _parse(text: str, origin: str) -> RoverDescription:
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"{origin}: not valid TOML: {error}") from error
    return _described(document, origin, text)


def _described(document: dict[str, Any], origin: str, text: str) -> RoverDescription:
    sections = {key: table for key, table in document.items() if isinstance(table, dict)}
    tables = {name: {key: _value(v) for key, v in table.items()} for name, table in sections.items()}
    assumed = tuple(
        f"{n}.{k}" for n, t in sections.items() for k, v in t.items() if isinstance(v, dict) and v.get("assumed")
    )
    return RoverDescription(str(document.get("name", origin)), tables, assumed, origin, text)


def _own(name: str) -> str:
    return (files(__package__) / name).read_text("utf-8")


def _value(entry: Any) -> Any:
    return entry["value"] if isinstance(entry, dict) and "value" in entry else entry
