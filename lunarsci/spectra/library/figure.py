"""Picture of a library: its spectra, one panel for each mineral."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from lunarsci.spectra.library.end_member import CHEMISTRY, MINERALS, EndMember

__all__ = ["library_pages"]

MOST_NAMES = 12


def library_pages(members: Sequence[EndMember]) -> Iterator[Figure]:
    """One page; colour runs with the first component of the chemistry, grey where it is unknown."""
    groups = {mineral: [m for m in members if m.mineral == mineral] for mineral in (*MINERALS, None)}
    groups = {mineral: group for mineral, group in groups.items() if group}
    columns = min(2, len(groups))
    rows = -(-len(groups) // columns)
    figure = Figure(figsize=(7.0 * columns, 4.2 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, (mineral, group) in zip(panels, groups.items(), strict=False):
        _draw(panel, mineral, group)
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    yield figure


def _draw(panel: Any, mineral: str | None, group: Sequence[EndMember]) -> None:
    key = CHEMISTRY.get(mineral or "", ("",))[0]
    for member in group:
        share = getattr(member, key) if key else None
        color = "0.5" if share is None else colormaps["viridis"](0.9 * share)
        label = member.id if share is None else f"{member.id}, {key.capitalize()} {100 * share:.0f}"
        panel.plot(member.wavelength_nm, member.reflectance, color=color, linewidth=1, label=label)
    by = f", dark to bright by {key.capitalize()}" if key else ""
    panel.set_title(f"{mineral or 'mineral not stated'}: {len(group)}{by}", fontsize=10)
    panel.set_xlabel("wavelength [nm]")
    panel.set_ylabel("reflectance")
    top = max(float(np.max(member.reflectance)) for member in group)
    panel.set_ylim(0, 1.05 * min(max(top, 0.05), 1.5))
    if len(group) <= MOST_NAMES:
        panel.legend(fontsize=7, frameon=False)
