"""What a result was made from: version, options, inputs and tables with their hashes, sources, seed, time.

The JSON document of every command is `{"schema", "result", "provenance"}` with sorted keys; numbers that are not finite
become null, so that any JSON reader takes it.
"""

import hashlib
import math
import platform
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import orjson

JSON = orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS
_MARK = r"\\u0000"
"""What JSON makes of the sign that stands before the number of some records; no text that is read has it."""
LONGEST_INTEGER = 63
"""Bits of a whole number that every reader of JSON takes; a longer one, such as a seed, is text."""
_PROJECT = Path(__file__).parents[1] / "pyproject.toml"
"""What says the version of lunarsci; it is there in a checkout, beside which another version may be installed."""
_PACKAGES = ("numpy", "scipy", "lmfit", "astropy", "pandas", "numba", "matplotlib")


def sha256(data: bytes) -> str:
    """Hexadecimal SHA-256 of some bytes."""
    return hashlib.sha256(data).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """The record that goes with a result.

    Attributes
    ----------
    command : the command as typed, without its options (`lunarsci spectra fit`).
    options : every option that shapes the result, resolved, defaults included.
    inputs, tables : name to SHA-256, of what the user gave and of what came with lunarsci.
    sources : what to cite.
    seed : of the random numbers, or None where none are drawn.
    warnings : what was said on the way.
    untrusted : one sentence, why the result should not be trusted or acted on; '' if it may be.
    failures : inputs that gave no result, one sentence each.
    """

    command: str
    options: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, str] = field(default_factory=dict)
    sources: Sequence[str] = ()
    seed: int | None = None
    warnings: Sequence[str] = ()
    untrusted: str = ""
    failures: Sequence[str] = ()

    def to_dict(self, *, time: bool = True) -> dict[str, Any]:
        """Plain Python only. Without `time`, two equal runs give equal documents."""
        record: dict[str, Any] = {
            "version": installed_version("lunarsci"),
            "command": self.command,
            "options": dict(self.options),
            "inputs": [{"path": path, "sha256": digest} for path, digest in self.inputs.items()],
            "tables": [{"name": name, "sha256": digest} for name, digest in self.tables.items()],
            "sources": list(dict.fromkeys(self.sources)),
            "seed": self.seed,
            "versions": {"python": platform.python_version(), **{name: installed_version(name) for name in _PACKAGES}},
            "warnings": list(self.warnings),
            "untrusted": self.untrusted,
            "failures": list(map(str, self.failures)),
        }
        if time:
            record["time_utc"] = datetime.now(UTC).isoformat(timespec="seconds")
        return record


@cache
def installed_version(package: str) -> str | None:
    """Version of an installed package, None when it is not installed."""
    try:
        if package == "lunarsci" and _PROJECT.is_file():
            project = tomllib.loads(_PROJECT.read_text("utf-8")).get("project", {})
            if project.get("name") == package:
                return str(project["version"])
        return version(package)
    except PackageNotFoundError:
        return None


def document(schema: str, result: Mapping[str, Any], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON document of a result; `schema` is such as `spectra-fit/1`."""
    return {"schema": f"lunarsci/{schema}", "result": result, "provenance": provenance}


def plain(value: Any) -> Any:
    """The value in plain Python: arrays and records as lists, numbers that are not finite as None."""
    if value is None or type(value) is str:
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, int) and value.bit_length() > LONGEST_INTEGER:
        return str(value)
    return value if isinstance(value, bool | int | float | str) else str(value)


def to_text(value: Any) -> str:
    """JSON of a value with sorted keys and no NaN."""
    return orjson.dumps(plain(value), option=JSON).decode()


def to_json(content: Any) -> str:
    """JSON text with sorted keys and no NaN, a line at its end."""
    return b"".join(json_chunks(content)).decode()


def json_chunks(content: Any) -> Iterator[bytes]:
    """The same in pieces, for what is kept as `Records` is written block by block and never made whole."""
    taken_out: list[tuple[Any, int]] = []
    skeleton = to_text(_without_records(content, 1, taken_out))
    for number, piece in enumerate(re.split(f'"{_MARK}([0-9]+)"', skeleton)):
        if number % 2 == 0:
            yield piece.encode()
        else:
            records, depth = taken_out[int(piece)]
            yield b"[\n" if len(records) else b"["
            yield from records.json_chunks(depth)
            yield f"\n{'  ' * (depth - 1)}]".encode() if len(records) else b"]"
    yield b"\n"


def _without_records(content: Any, depth: int, taken_out: list[tuple[Any, int]]) -> Any:
    """Each of the records replaced by a mark, and put into `taken_out` with the depth of its objects."""
    if isinstance(content, Mapping):
        return {key: _without_records(value, depth + 1, taken_out) for key, value in content.items()}
    if hasattr(content, "json_chunks"):
        taken_out.append((content, depth))
        return f"\0{len(taken_out) - 1}"
    return content
