"""Whether a library is fit for use: what must be mended, and what one should know."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.spectra.library.end_member import CHEMISTRY, EndMember

__all__ = ["Finding", "check_library"]

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
class Finding:
    """One thing found in one end member.

    `must_mend` is False where the spectrum can be used but with less than one might expect; `text` says what and where.
    """

    must_mend: bool
    text: str


def check_library(members: Sequence[EndMember]) -> list[tuple[Finding, ...]]:
    """What is found in each end member, in their order; first what must be mended."""
    counts = Counter(member.id for member in members)
    return [
        (
            *(Finding(True, text) for text in _duplicates(counts[member.id])),
            *(Finding(True, text) for text in _faults(member)),
            *(Finding(False, text) for text in _remarks(member)),
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
