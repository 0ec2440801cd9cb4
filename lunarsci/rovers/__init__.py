"""Read rover description files: TOML tables whose values carry their source.

The rover that a plan or a terrain was made for, kept in its file.
"""

import hashlib
import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any, Literal

from lunarsci.errors import DataError
from lunarsci.io.documents import toml_of
from lunarsci.io.inputs import named_input
from lunarsci.ranges import refuse

WHEELS = "wheels.toml"
DEFAULT_ROVER = "yutu2"
"""Which is taken where none is named."""


@dataclass(frozen=True, slots=True)
class RoverDescription:
    """One rover file, parsed and not yet interpreted.

    `tables` maps table name to key to plain value; `assumed` lists the dotted keys that are guesses; `text` is the
    file as read, kept for provenance; `left` are dotted keys of numbers that are a template's, and whose they are;
    `sources` says by dotted key where a number is from, where the file does.
    """

    name: str
    tables: dict[str, dict[str, Any]]
    assumed: tuple[str, ...]
    origin: str
    text: str
    left: Mapping[str, str] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)

    def table(self, name: str) -> dict[str, Any]:
        """Return one table. Raises DataError when the file lacks it."""
        if name not in self.tables:
            raise DataError(f"{self.origin}: no [{name}] table; add one as in the yutu2 file")
        return self.tables[name]


def rover_names() -> tuple[str, ...]:
    """Names of the rovers that come with lunarsci."""
    tables = (path.name for path in files(__package__).iterdir() if path.name.endswith(".toml"))
    return tuple(sorted(name.removesuffix(".toml") for name in tables if name != WHEELS))


def wheel_names() -> tuple[str, ...]:
    """Names of the wheels that come with lunarsci without a rover."""
    return tuple(tomllib.loads(_file(WHEELS)))


def called(rover: str, name: str) -> str:
    """A rover or wheel for people: the name in its file, and the file; how to ask for those of lunarsci.

    >>> called("wheel.toml", "HIT rig"), called("yutu2", "Yutu-2 (Chang'E-4)"), called("wheel.toml", "")
    ('HIT rig (wheel.toml)', 'yutu2', 'wheel.toml')
    """
    alone = name in ("", rover) or rover in rover_names() or rover in wheel_names()
    return rover if alone else f"{name} ({rover})"


def read_rover(rover: str) -> RoverDescription:
    """Read a rover by name (`yutu2`) or from a TOML file. Raises DataError for anything else.

    The name of a wheel gives a description that has a wheel and nothing else.
    """
    if rover in rover_names():
        text = _file(f"{rover}.toml")
        return _described(toml_of(rover, text), rover, text)
    if rover in wheel_names():
        text = _file(WHEELS)
        return _described({"wheel": tomllib.loads(text)[rover]}, rover, text)
    names = f"a rover of lunarsci ({', '.join(rover_names())}; wheels: {', '.join(wheel_names())})"
    data = named_input(rover, names, (*rover_names(), *wheel_names()))
    return _described(toml_of(rover, data), rover, data.decode("utf-8"))


def _described(document: dict[str, Any], origin: str, text: str) -> RoverDescription:
    sections = {key: table for key, table in document.items() if isinstance(table, dict)}
    tables = {name: {key: _value(v) for key, v in table.items()} for name, table in sections.items()}
    entries = {f"{n}.{k}": v for n, t in sections.items() for k, v in t.items()}
    assumed = tuple(key for key, v in entries.items() if isinstance(v, dict) and v.get("assumed"))
    left = {key: of for key, v in entries.items() if (of := _placed(v))}
    sources = {key: str(v["source"]) for key, v in entries.items() if isinstance(v, dict) and v.get("source")}
    return RoverDescription(str(document.get("name", origin)), tables, assumed, origin, text, left, sources)


def _file(name: str) -> str:
    return (files(__package__) / name).read_text("utf-8")


PLACE_HOLDER = "replace it"
"""End of the source of a number in a template: it stays where nobody wrote one of one's own."""


def _placed(entry: Any) -> str:
    """The rover that a number of a template is of; '' of any other number."""
    of, _, end = str(entry.get("source", "") if isinstance(entry, dict) else "").rpartition("; ")
    return of if end == PLACE_HOLDER else ""


def _value(entry: Any) -> Any:
    return entry["value"] if isinstance(entry, dict) and "value" in entry else entry


Kinship = Literal["same", "changed", "other"]


@dataclass(frozen=True, slots=True)
class MadeFor:
    """The rover that a file was made for.

    Attributes
    ----------
    rover : name or file, as the option `--rover` took it.
    name : what its description calls it.
    sha256 : of the text of its description.
    limits : of the ground and of the path as they were then, by their names in a rover file.
    ground : that a plan was made on, as tables name it; empty where that is not known.

    Raises ParameterError for what is no text or no finite number.
    """

    rover: str
    name: str
    sha256: str
    limits: Mapping[str, float] = field(default_factory=dict)
    ground: str = ""

    def __post_init__(self) -> None:
        texts = {key: getattr(self, key) for key in ("rover", "name", "sha256", "ground")}
        refuse(f"made_for {key} is {it!r}; give a text" for key, it in texts.items() if not isinstance(it, str))
        refuse(
            f"made_for {key} is {it!r}; give a number"
            for key, it in self.limits.items()
            if not isinstance(it, int | float) or isinstance(it, bool) or not math.isfinite(it)
        )

    @classmethod
    def from_table(cls, table: Any) -> "MadeFor":
        """From a table with the keys `rover`, `name`, `sha256`, maybe `ground`, and limits. Raises ParameterError."""
        texts = ("rover", "name", "sha256")
        whole = isinstance(table, Mapping) and {*texts} <= {*table}
        refuse({f"made_for must be a table with {', '.join(texts)}": not whole})
        limits = {str(key): value for key, value in table.items() if key not in (*texts, "ground")}
        return cls(table["rover"], table["name"], table["sha256"], limits, table.get("ground", ""))

    def to_table(self) -> dict[str, str | float]:
        """The table that `from_table` reads."""
        ground = {"ground": self.ground} if self.ground else {}
        return {"rover": self.rover, "name": self.name, "sha256": self.sha256, **ground, **self.limits}

    def to_json(self) -> str:
        """The same as one line of JSON."""
        return json.dumps(self.to_table(), sort_keys=True, ensure_ascii=False)

    def kinship(self, description: RoverDescription) -> Kinship:
        """Whether a description is the `same`, has `changed` since under the same name of file, or is of an `other`."""
        if _sha256(description) == self.sha256:
            return "same"
        return "changed" if description.origin == self.rover else "other"


def made_for(description: RoverDescription, limits: Mapping[str, float | None]) -> MadeFor:
    """The record of a rover; limits that are None are left out."""
    given = {name: float(value) for name, value in limits.items() if value is not None}
    return MadeFor(description.origin, description.name, _sha256(description), given)


def _sha256(description: RoverDescription) -> str:
    return hashlib.sha256(description.text.encode()).hexdigest()
