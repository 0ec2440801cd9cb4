"""What a user's table says of spectra by their ids: minerals, chemistry, grain sizes, modes.

Columns are `id` and any of `mineral`, `fo`, `fs`, `en`, `wo`, `an`, `min_um`, `max_um`, `source`; instead of `mineral`
the modes `vol_ol`, `vol_opx`, `vol_cpx`, `vol_plg`, and the chemistry of each pyroxene as `opx_fs`, `cpx_fs` and so on.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.library.end_member import CHEMISTRY, EndMember, mineral_named
from lunarsci.spectra.readers.described import rows_by_id
from lunarsci.spectra.readers.rows import number
from lunarsci.spectra.readers.table import quoted

__all__ = ["MIXTURE", "PURE", "read_metadata", "with_description"]

MIXTURE = "mixture"
"""What stands for the mineral of a sample that is none."""
PURE = 0.95
"""Share of the volume from which a sample is taken as an end member of its mineral; assumed."""
_MODES = {"vol_ol": "olivine", "vol_opx": "orthopyroxene", "vol_cpx": "clinopyroxene", "vol_plg": "plagioclase"}
_PREFIXES = {"orthopyroxene": "opx_", "clinopyroxene": "cpx_"}
_NUMBERS = ("fo", "fs", "en", "wo", "an", "min_um", "max_um")


def read_metadata(source: InputFile) -> dict[str, dict[str, Any]]:
    """Description of each id, for `end_member`; `mineral` is `MIXTURE` where no mode reaches `PURE`.

    Chemistry that the mineral does not have is left out: tables often fill it with zeros. Raises DataError for a table
    without ids, an id that comes twice, or a cell that is no number.
    """
    return {id: _description(row, f"{source.name}: line {line}") for id, (line, row) in rows_by_id(source).items()}


def _description(row: Mapping[str, str], place: str) -> dict[str, Any]:
    mineral = _mineral(row, place)
    prefix = _PREFIXES.get(mineral or "", "")
    wanted = CHEMISTRY.get(mineral, ()) if mineral else ("fo", "fs", "en", "wo", "an")
    found: dict[str, Any] = {"mineral": mineral, "source": row.get("source", "")}
    for key in _NUMBERS:
        if key in wanted or key.endswith("_um"):
            cell = row.get(prefix + key) or row.get(key, "")
            found[key] = _value(cell, f"{place}, column {key}")
    if not found["max_um"]:  # no grain is 0 um: such tables mean that nobody knows
        found["min_um"] = found["max_um"] = None
    return found


def _mineral(row: Mapping[str, str], place: str) -> str | None:
    stated = row.get("mineral", "")
    if stated.casefold() == MIXTURE:
        return MIXTURE
    if stated:
        try:
            return mineral_named(stated)
        except DataError as error:
            raise DataError(f"{place}: {error}") from error
    modes = {
        mineral: _value(row[key], f"{place}, column {key}") or 0.0 for key, mineral in _MODES.items() if key in row
    }
    total = sum(modes.values())
    if not modes or total <= 0:
        return None
    mineral = max(modes, key=lambda name: modes[name])
    return mineral if modes[mineral] >= PURE * total else MIXTURE


def _value(cell: str, place: str) -> float | None:
    value = number(cell)
    if value is None or math.isinf(value):
        raise DataError(f"{place}: {quoted(cell)} is not a number; correct it, or leave it blank if unknown")
    return None if math.isnan(value) else value


def with_description(member: EndMember, told: Mapping[str, Any]) -> EndMember:
    """The end member with what a table says of it; what it leaves open stays. Raises DataError as `EndMember` does."""
    said = {key: value for key, value in told.items() if value not in (None, "")}
    if said.get("mineral") not in (None, member.mineral):
        # The chemistry of another mineral would contradict it.
        member = replace(member, fo=None, fs=None, en=None, wo=None, an=None)
    return replace(member, **said)
