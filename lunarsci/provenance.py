"""What a result was made from: version, options, inputs and tables with their hashes, sources, seed, time.

The JSON document of every command is `{"schema", "result", "provenance"}` with sorted keys; numbers that are not finite
become null, so that any JSON reader takes it.
"""

import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from typing import Any

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
    """

    command: str
    options: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, str] = field(default_factory=dict)
    sources: Sequence[str] = ()
    seed: int | None = None
    warnings: Sequence[str] = ()

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
        }
        if time:
            record["time_utc"] = datetime.now(UTC).isoformat(timespec="seconds")
        return record


@cache
def installed_version(package: str) -> str | None:
    """Version of an installed package, None when it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return None


def document(schema: str, result: Mapping[str, Any], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON document of a result; `schema` is such as `spectra-fit/1`."""
    return {"schema": f"lunarsci/{schema}", "result": plain(result), "provenance": plain(provenance)}


def plain(value: Any) -> Any:
    """The value in plain Python: arrays as lists, numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)


def to_json(content: Any) -> str:
    """JSON text with sorted keys and no NaN."""
    return json.dumps(plain(content), sort_keys=True, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
