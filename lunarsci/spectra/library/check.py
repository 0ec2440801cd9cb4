"""Whether a library is fit for use: what must be mended, and what one should know.

What a user's table says of spectra by their ids: minerals, chemistry, grain sizes, modes.

Columns are `id` and any of `mineral`, `fo`, `fs`, `en`, `wo`, `an`, `min_um`, `max_um`, `source`; instead of `mineral`
the modes `vol_ol`, `vol_opx`, `vol_cpx`, `vol_plg`, and the chemistry of each pyroxene as `opx_fs`, `cpx_fs` and so on.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.library.end_member import CHEMISTRY, EndMember, mineral_named
from lunarsci.spectra.readers.columns import rows_by_id
from lunarsci.spectra.rows import number, quoted

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


FEWEST_CHANNELS = 20
"""As many as it takes to measure a band (`lunarsci.spectra.bands`)."""
HIGHEST = 1.2
"""Reflectance factors of bright powders exceed 1, hardly this; assumed."""
SUM_TOLERANCE = 0.02
"""Fs + En + Wo may differ from 1 by this: analyses leave out Mn, Na, Al; assumed."""
GAP_NM, GAP_STEPS = 50.0, 5.0
"""A step between channels is a gap if it is this wide and this many times the median step; assumed."""
NEEDED_NM = (700.0, 2400.0)
"""What a spectrum should cover to describe both bands; assumed."""


@dataclass(frozen=True, slots=True)
class LibraryFinding:
    """One thing found in one end member.

    `must_mend` is False where the spectrum can be used but with less than one might expect; `text` says what and where.
    """

    must_mend: bool
    text: str


def check_library(members: Sequence[EndMember]) -> list[tuple[LibraryFinding, ...]]:
    """What is found in each end member, in their order; first what must be mended."""
    counts = Counter(member.id for member in members)
    return [
        (
            *(LibraryFinding(True, text) for text in _duplicates(counts[member.id])),
            *(LibraryFinding(True, text) for text in _faults(member)),
            *(LibraryFinding(False, text) for text in _remarks(member)),
        )
        for member in members
    ]


def _duplicates(count: int) -> list[str]:
    return [f"{count} end members have this id; rename all but one"] if count > 1 else []


def _faults(member: EndMember) -> list[str]:
    texts = []
    size = member.wavelength_nm.size
    if size < FEWEST_CHANNELS:
        texts.append(f"{size} channels; {FEWEST_CHANNELS} are needed")
    outside = ~((member.reflectance > 0) & (member.reflectance < HIGHEST))
    if outside.any():
        first = int(np.flatnonzero(outside)[0])
        texts.append(
            f"{outside.sum()} channels not between 0 and {HIGHEST:g}, first {member.reflectance[first]:.4g} at "
            f"{member.wavelength_nm[first]:.6g} nm; delete them, or correct the unit"
        )
    if member.mineral is None:
        texts.append("no mineral; import it again with --mineral or --metadata")
        return texts
    return texts + _chemistry_faults(member)


def _chemistry_faults(member: EndMember) -> list[str]:
    wanted = CHEMISTRY.get(member.mineral or "", ())
    texts = [
        f"{key} = {getattr(member, key):g} in a mineral without it ({member.mineral}); delete it"
        for key in ("fo", "fs", "en", "wo", "an")
        if key not in wanted and getattr(member, key) is not None
    ]
    if "fs" in wanted:
        parts = [getattr(member, key) for key in ("fs", "en", "wo")]
        known = [part for part in parts if part is not None]
        if len(known) == len(parts) and abs(sum(known) - 1) > SUM_TOLERANCE:
            texts.append(f"fs + en + wo = {sum(known):.3f}, not 1; correct the analysis")
        elif sum(known) > 1 + SUM_TOLERANCE:
            texts.append(f"fs, en, wo, as far as known, add up to {sum(known):.3f}, more than 1; correct the analysis")
    return texts


def _remarks(member: EndMember) -> list[str]:
    wavelength = member.wavelength_nm
    texts = [f"no {key}" for key in CHEMISTRY.get(member.mineral or "", ()) if getattr(member, key) is None]
    texts = [f"{', '.join(texts)}: composition unknown"] if texts else []
    if wavelength[0] > NEEDED_NM[0] or wavelength[-1] < NEEDED_NM[1]:
        texts.append(
            f"covers {wavelength[0]:.6g}-{wavelength[-1]:.6g} nm, not all of {NEEDED_NM[0]:g}-{NEEDED_NM[1]:g} nm"
        )
    texts += [f"gap of {high - low:.4g} nm after {low:.6g} nm" for low, high in gaps(member)]
    if member.max_um is None:
        texts.append("grain size unknown")
    return texts


def gaps(member: EndMember) -> list[tuple[float, float]]:
    """Pairs of neighbouring channels that are too far apart. [nm]"""
    steps = np.diff(member.wavelength_nm)
    if steps.size < 2:
        return []
    wide = np.flatnonzero((steps > GAP_NM) & (steps > GAP_STEPS * np.median(steps)))
    return [(float(member.wavelength_nm[k]), float(member.wavelength_nm[k + 1])) for k in wide]
