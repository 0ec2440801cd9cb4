"""The rover that a plan or a terrain was made for, kept in its file."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from lunarsci.errors import ParameterError
from lunarsci.rovers.description import RoverDescription

__all__ = ["Kinship", "MadeFor", "made_for"]

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

    Raises ParameterError for what is no text or no finite number.
    """

    rover: str
    name: str
    sha256: str
    limits: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in ("rover", "name", "sha256"):
            if not isinstance(getattr(self, key), str):
                raise ParameterError(f"made_for {key} is {getattr(self, key)!r}; give a text")
        for key, value in self.limits.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ParameterError(f"made_for {key} is {value!r}; give a number")

    @classmethod
    def from_table(cls, table: Any) -> "MadeFor":
        """From a table with the keys `rover`, `name`, `sha256` and limits. Raises ParameterError."""
        texts = ("rover", "name", "sha256")
        if not isinstance(table, Mapping) or any(key not in table for key in texts):
            raise ParameterError(f"made_for must be a table with {', '.join(texts)}")
        limits = {str(key): value for key, value in table.items() if key not in texts}
        return cls(table["rover"], table["name"], table["sha256"], limits)

    def to_table(self) -> dict[str, str | float]:
        """The table that `from_table` reads."""
        return {"rover": self.rover, "name": self.name, "sha256": self.sha256, **self.limits}

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
    kept = {name: float(value) for name, value in limits.items() if value is not None}
    return MadeFor(description.origin, description.name, _sha256(description), kept)


def _sha256(description: RoverDescription) -> str:
    return hashlib.sha256(description.text.encode()).hexdigest()
